"""How far a plan is from its simulation and from its reference, and which limits are active."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike
from pydrake.symbolic import Expression, MakeVectorContinuousVariable
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    LogVectorOutput,
    SymbolicVectorSystem,
    TrajectorySource,
)
from pydrake.trajectories import PiecewisePolynomial

from limb_systems import (
    ActiveConstraint,
    Layout,
    Limb,
    LimbError,
    LimbParameters,
    Trajectory,
    Wires,
    bend_angle,
    simulate,
    split_state,
)
from limb_systems.files.signal_table import stretches
from limb_systems.limb import make_manipulator
from limb_systems.simulation import (
    SimulationError,
    end_of_samples,
    failure_told,
    make_simulator,
)
from limb_systems.statics import HeldAngles, static_equilibrium
from limb_systems.tracking import reference_distances
from limb_systems.wire_laws.wire_law import TEMPERATURE_SCALE
from planners.task import Task
from planners.transcription.program import reading_bounds

# Accuracy of the simulation that a plan is checked with: its bend angle is
# within 0.002° of that at accuracy 1e-6, for the Fig. 5 reference and for
# steps to 170°. Ten times finer takes three times as long.
CHECK_ACCURACY = 3e-4
CHECK_RATE = 20.0  # Hz, of the comparison; the rate of the knots if that is higher
HEAT_STEP = 1 / 30  # s, of the wires alone, between which their forces are linear

# A limb swings about a quasi-static plan if its first mode is slower, its damping over its
# stiffness larger, or what a jump of its bend rate makes it ring larger than this.
SLOWEST_MODE, LONGEST_LAG, MOST_RINGING = 1.5, 0.02, np.deg2rad(0.3)  # Hz, s, rad

# A plan is far if a side's largest angle is missed by more than a share of the largest that is
# asked for, or the mean of the misses is more than another; but not by less than a degree.
SHARE_OF_LARGEST = 0.15
SHARE_ON_AVERAGE = 0.2
LITTLE = np.deg2rad(1.0)


def simulated_differences(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance between the bend angle of a plan and the simulation of its duty.

    An accurate integrator simulates the duty from the first state of the plan.

    Returns:
        Times (M,), s, and the largest difference of a segment (M,), rad.
    """
    rate = max(CHECK_RATE, 1 / np.diff(trajectory.time).min())
    wires = Wires(trajectory.parameters)
    runs_in_python = not (wires.rates_are_affine and wires.torque_is_affine)
    if runs_in_python and not wires.laws_need_angle:
        times, simulated = _heat_then_motion(trajectory, rate)
    else:
        recording = simulate(
            Limb(trajectory.parameters),
            trajectory,
            sample_rate=rate,
            accuracy=CHECK_ACCURACY,
            initial_state=trajectory.state[:, 0],
        )
        times, simulated = recording.time, recording.bend_angle
    planned = trajectory.since_start().bend_angle_at(np.minimum(times, trajectory.duration))
    return times, np.abs(simulated - planned).max(axis=0)


def _heat_then_motion(trajectory: Trajectory, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Simulate a limb whose wires do not feel its angles: first the wires, then the chain.

    The implicit integrator of the chain evaluates its systems very often. Laws that run in Python
    are too slow for it, so the wires are simulated before it starts.

    Returns:
        Times (M,), s, and bend angles (S, M), rad.
    """
    parameters, plan = trajectory.parameters, trajectory.since_start()
    angles, rates, states, _ = split_state(parameters, plan.state[:, 0])
    duration, n, wires = plan.duration, parameters.num_joints, Wires(parameters)
    counts = np.ceil(np.diff(plan.time) / HEAT_STEP - 1e-9).astype(int)
    places = np.concatenate([k + np.arange(count) / count for k, count in enumerate(counts)])
    times = np.append(np.interp(places, np.arange(len(plan.time)), plan.time), duration)
    duty = plan.duty_trajectory().vector_values(times).T
    courses = wires.under_duty(states, duty, times)
    if (lost := ~np.isfinite(courses).all(axis=1)).any():
        raise SimulationError(
            f"The simulation stopped at {times[lost.argmax()]:.3g} s of {duration:g} s: the wires' "
            "states are no numbers from there on."
        )
    straight = np.zeros(n)
    forces = wires.forces(courses, np.zeros((1, n)))

    builder = DiagramBuilder()
    manipulator = builder.AddSystem(make_manipulator(parameters))
    course = PiecewisePolynomial.FirstOrderHold(times, forces.T)
    source = builder.AddSystem(TrajectorySource(course))
    if wires.torque_needs_angle:
        # What stiffens, as an expression that Drake evaluates in C++, with the state that it wants.
        state = MakeVectorContinuousVariable(2 * n, "q")
        cold = wires.cold_states
        with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
            more = wires.forces(cold, state[:n]) - wires.forces(cold, straight)
        unused = MakeVectorContinuousVariable(1, "unused")
        rubber = builder.AddSystem(
            SymbolicVectorSystem(state=unused, input=state, dynamics=[Expression(0.0)], output=more)
        )
        total = builder.AddSystem(Adder(2, n))
        builder.Connect(manipulator.get_state_output_port(), rubber.get_input_port())
        builder.Connect(rubber.get_output_port(), total.get_input_port(0))
        builder.Connect(source.get_output_port(), total.get_input_port(1))
        source = total
    builder.Connect(
        source.get_output_port(), manipulator.get_applied_generalized_force_input_port()
    )
    sink = LogVectorOutput(manipulator.get_state_output_port(), builder, 1 / rate)
    simulator = make_simulator(builder.Build(), CHECK_ACCURACY)
    context = simulator.get_mutable_context()
    manipulator.SetPositionsAndVelocities(
        manipulator.GetMyMutableContextFromRoot(context), np.concatenate([angles, rates])
    )
    with failure_told(simulator, duration):
        simulator.AdvanceTo(end_of_samples(duration, rate))
    log = sink.FindLog(context)
    return log.sample_times(), bend_angle(parameters, log.data()[:n])


def swings(trajectory: Trajectory) -> str | None:
    """Return one sentence on why a limb may swing about its quasi-static plan, or None.

    Such a plan leaves out the inertia of the chain. Of the damping it keeps the delay alone.
    """
    parameters, layout = trajectory.parameters, Layout(trajectory.parameters)
    if layout.is_planar:
        return None
    held, plant = HeldAngles(parameters), make_manipulator(parameters)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, held.rest_angles)
    slowest = np.linalg.eigvals(held.compliance @ plant.CalcMassMatrix(context)).real.max()
    first_mode = 1 / (2 * np.pi * np.sqrt(slowest))  # Hz
    lag = (layout.damping / layout.stiffness).max()
    rates = np.diff(trajectory.bend_angle) / np.diff(trajectory.time)
    ringing = np.sqrt(slowest) * np.abs(np.diff(rates, prepend=0.0)).max()
    reasons = [
        reason
        for reason, holds in (
            (f"its first mode is at {first_mode:.2g} Hz", first_mode < SLOWEST_MODE),
            (f"its damping delays it by {1e3 * lag:.0f} ms", lag > LONGEST_LAG),
            (f"steps of duty make it ring by {np.rad2deg(ringing):.1f}°", ringing > MOST_RINGING),
        )
        if holds
    ]
    if not reasons:
        return None
    return (
        "This limb may swing about its plan, which leaves out its inertia: "
        f"{', and '.join(reasons)}; its simulation is within "
        f"{trajectory.check.largest_difference_deg:.2f}° of the plan."
    )


def far_from_reference(trajectory: Trajectory) -> str | None:
    """Return how far, where and why a plan is far from its reference; None if it is near."""
    reference, planned = trajectory.reference, trajectory.bend_angle
    largest = np.abs(reference).max()
    short = np.array(
        [
            (reference - planned.max(axis=1, keepdims=True)).max(axis=1),
            (planned.min(axis=1, keepdims=True) - reference).max(axis=1),
        ]
    )
    is_short = short.max() > max(LITTLE, SHARE_OF_LARGEST * largest)
    distance, mean = np.abs(reference - planned), reference_distances(trajectory).planned
    if not is_short and mean <= max(LITTLE, SHARE_ON_AVERAGE * largest):
        return None
    if is_short:
        side, bend = map(int, np.unravel_index(np.argmax(short), short.shape))
        sign = (1, -1)[side]
        wanted, reached = sign * reference[bend], sign * planned[bend]
        # Where it comes nearest to what it never reaches.
        knot = int(np.argmax(np.where(wanted > reached.max(), reached, -np.inf)))
    else:
        bend, knot = map(int, np.unravel_index(np.argmax(distance), distance.shape))
    asked, has = np.rad2deg([reference[bend, knot], planned[bend, knot]])
    time, layout = trajectory.time[knot], Layout(trajectory.parameters)
    of_bend = f" of segment {layout.bend_segment[bend] + 1}" if len(layout.chains) > 1 else ""
    if not layout.is_planar:
        of_bend += f" towards {('E2', 'E3')[layout.bend_direction[bend]]}"
    average, most = np.rad2deg([mean, distance.max()])
    said = (
        f"The plan is far from its reference: {average:.1f}° on average, {most:.1f}° at most. "
        f"At {time:.1f} s, {asked:.1f}°{of_bend} are asked for, and the plan has {has:.1f}°"
    )
    active = [
        constraint.bound
        for constraint in trajectory.check.active_constraints
        if constraint.start <= time <= constraint.end
    ]
    said += f", where limits are {', '.join(active)}." if active else ", where no limit is active."
    reach = _reach(trajectory.parameters, bend)
    if reach is not None:
        said += (
            f" With wires between T_warm and T_max, this limb can hold {reach[0]:.1f}° to "
            f"{reach[1]:.1f}°."
        )
    return said + " Ask for less, or for a slower motion."


def _reach(parameters: LimbParameters, bend: int) -> np.ndarray | None:
    """Return the least and the largest bend that wires can hold (2,), degrees; None if unknown."""
    limits, layout = parameters.temperature_limits, Layout(parameters)
    sides = np.sign(layout.levers[layout.bend_joints[bend][0]])
    held = []
    for side in (-1, 1):
        temperature = np.where(sides == side, limits.maximum, limits.warm)
        try:
            angles, _ = static_equilibrium(parameters, temperature)
        except LimbError:
            return None  # it folds
        held.append(bend_angle(parameters, angles[:, None])[bend, 0])
    return np.rad2deg(held)


def active_constraints(
    trajectory: Trajectory,
    task: Task,
    warm_up_time: float,
    measured_margin: ArrayLike,
    added: Mapping[str, np.ndarray],
) -> list[ActiveConstraint]:
    """Return the times in which bounds of (18)-(20), of readings, and added ones are active.

    Args:
        added: whether constraints of one's own are active at the knots (K,), by their names.
    """
    limits, names = trajectory.parameters.temperature_limits, trajectory.parameters.wire_names
    warm = trajectory.time > warm_up_time
    near_duty, near_temperature = 1e-4, 1e-3 * TEMPERATURE_SCALE
    hottest, fullest = limits.maximum - task.temperature_margin, 1.0 - task.duty_margin
    hottest_name = f"T_max - {task.temperature_margin:g} °C" if task.temperature_margin else "T_max"
    highest = reading_bounds(trajectory.parameters, measured_margin)
    bounds: list[tuple[str, np.ndarray]] = []
    for index, name in enumerate(names):
        reading = trajectory.measured_temperature[index]
        duty, wire = trajectory.duty[index], trajectory.wire_temperature[index]
        bounds += (
            (f"duty {name} = 0", duty < near_duty),
            (f"duty {name} = {fullest:g}", duty > fullest - near_duty),
            (f"wire {name} = {hottest_name}", wire > hottest - near_temperature),
            (f"wire {name} = T_warm", warm & (wire < limits.warm + near_temperature)),
            (f"reading {name} = measured_maximum", reading > highest[index] - near_temperature),
        )
    return [
        ActiveConstraint(bound, float(trajectory.time[first]), float(trajectory.time[after - 1]))
        for bound, where in (*bounds, *added.items())
        for first, after in stretches(where)
    ]
