"""How far a plan is from its simulation and from its reference, and which limits are active."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from limb_systems import (
    ActiveConstraint,
    Limb,
    LimbError,
    LimbModel,
    Trajectory,
    bend_angle,
    simulate,
)
from limb_systems.files.signal_table import stretches
from limb_systems.simulation import (
    sample_count,
)
from limb_systems.statics import static_equilibrium
from limb_systems.tracking import reference_distances
from limb_systems.wire_laws.wire_law import TEMPERATURE_SCALE
from planners.radau import simulate_plan
from planners.task import Task
from planners.transcription.program import reading_bounds

# Accuracy of Drake's simulation, where a plan is checked with it: its bend angle is
# within 0.002° of that at accuracy 1e-6, for the Fig. 5 reference and for
# steps to 170°. Ten times finer takes three times as long.
CHECK_ACCURACY = 3e-4
CHECK_RATE = 20.0  # Hz, of the comparison; the rate of the knots if that is higher

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

    The limb's own equations are integrated under its duty from the first state of the plan: see
    `planners.radau`. A limb that this integrator cannot follow is simulated by Drake.

    Returns:
        Times (M,), s, and the largest difference of a segment (M,), rad.
    """
    rate = max(CHECK_RATE, 1 / np.diff(trajectory.time).min())
    plan = trajectory.since_start()
    times = np.arange(sample_count(plan.duration, rate)) / rate
    try:
        simulated = bend_angle(plan.model, simulate_plan(plan, times))
    except LimbError:  # the equations turn too suddenly; Drake's error control gets over that
        recording = simulate(
            Limb(plan.parameters),
            plan,
            sample_rate=rate,
            accuracy=CHECK_ACCURACY,
            initial_state=plan.state[:, 0],
        )
        simulated = recording.bend_angle
    planned = plan.bend_angle_at(np.minimum(times, plan.duration))
    return times, np.abs(simulated - planned).max(axis=0)


def swings(trajectory: Trajectory) -> str | None:
    """Return one sentence on why a limb may swing about its quasi-static plan, or None.

    Such a plan leaves out the inertia of the chain. Of the damping it keeps the delay alone.
    """
    model = trajectory.model
    if model.layout.is_planar:
        return None
    held = model.statics
    dynamics = model.dynamics
    mechanics = model.mechanics
    at_rest = np.zeros(2 * dynamics.num_joints + dynamics.num_states)
    at_rest[: dynamics.num_joints] = held.rest_angles
    mass = dynamics.mass_and_load(at_rest)[0]
    slowest = np.linalg.eigvals(held.compliance @ mass).real.max()
    first_mode = 1 / (2 * np.pi * np.sqrt(slowest))  # Hz
    lag = (mechanics.damping / mechanics.stiffness).max()
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
    time = trajectory.time[knot]
    layout = trajectory.model.layout
    of_bend = f" of segment {layout.bend_segment[bend] + 1}" if len(layout.bends_of) > 1 else ""
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
    reach = _reach(trajectory.model, bend)
    if reach is not None:
        said += (
            f" With wires between T_warm and T_max, this limb can hold {reach[0]:.1f}° to "
            f"{reach[1]:.1f}°."
        )
    return said + " Ask for less, or for a slower motion."


def _reach(model: LimbModel, bend: int) -> np.ndarray | None:
    """Return the least and the largest bend that wires can hold (2,), degrees; None if unknown."""
    limits = model.parameters.temperature_limits
    sides = np.sign(model.mechanics.levers[model.layout.bend_joints[bend][0]])
    held = []
    for side in (-1, 1):
        temperature = np.where(sides == side, limits.maximum, limits.warm)
        try:
            angles, _ = static_equilibrium(model, temperature)
        except LimbError:
            return None  # it folds
        held.append(bend_angle(model, angles[:, None])[bend, 0])
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
    highest = reading_bounds(trajectory.model, measured_margin)
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
