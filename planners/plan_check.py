"""The check of a plan: distances from its simulation and its reference, and active limits."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from limb_systems import (
    ActiveConstraint,
    LimbError,
    LimbModel,
    Trajectory,
    bend_angle,
    simulate,
)
from limb_systems.files.signal_table import stretches
from limb_systems.simulation import sample_count
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

# A limb swings about a quasi-static plan beyond these limits.
MIN_MODE_FREQUENCY = 1.5  # Hz, of its first mode
MAX_LAG = 0.02  # s, its damping over its stiffness
MAX_RINGING = np.deg2rad(0.3)  # rad, after jumps of its bend rate

# A plan is far from its reference beyond these shares of the reference's largest angle, and beyond
# the minimum.
MAX_SHORTFALL_SHARE = 0.15  # of a side's largest angle
MAX_MEAN_SHARE = 0.2  # of the mean distance
MIN_DEVIATION = np.deg2rad(1.0)


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
    except LimbError:  # the equations change too suddenly; Drake's error control handles this
        from limb_systems import Limb  # Drake's multibody takes long to import

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


def swing_warning(trajectory: Trajectory) -> str | None:
    """Return a warning that a limb may swing about its quasi-static plan, or None.

    Such a plan leaves out the inertia of the chain, and the damping except for its delay.
    """
    model = trajectory.model
    if model.layout.is_planar:
        return None
    # The first mode, the lag by damping, and the vibration after jumps of the bend rate.
    dynamics = model.dynamics
    at_rest = np.zeros(2 * dynamics.num_joints + dynamics.num_states)
    at_rest[: dynamics.num_joints] = model.statics.rest_angles
    mass = dynamics.mass_and_load(at_rest)[0]
    slowest = np.linalg.eigvals(model.statics.compliance @ mass).real.max()  # 1/ω², s²
    first_mode = 1 / (2 * np.pi * np.sqrt(slowest))  # Hz
    lag = (model.mechanics.damping / model.mechanics.stiffness).max()
    rates = np.diff(trajectory.bend_angle) / np.diff(trajectory.time)
    ringing = np.sqrt(slowest) * np.abs(np.diff(rates, prepend=0.0)).max()
    reasons = []
    if first_mode < MIN_MODE_FREQUENCY:
        reasons.append(f"its first mode is at {first_mode:.2g} Hz")
    if lag > MAX_LAG:
        reasons.append(f"its damping delays it by {1e3 * lag:.0f} ms")
    if ringing > MAX_RINGING:
        reasons.append(f"steps of duty make it ring by {np.rad2deg(ringing):.1f}°")
    if not reasons:
        return None
    return (
        "This limb may swing about its plan, which leaves out its inertia: "
        f"{', and '.join(reasons)}; its simulation is within "
        f"{trajectory.check.largest_difference_deg:.2f}° of the plan."
    )


def far_from_reference(trajectory: Trajectory) -> str | None:
    """Return a warning with distance, place and cause if a plan is far from its reference."""
    # Find out whether a side's largest angle is missed, or all angles on average.
    reference = trajectory.reference
    planned = trajectory.bend_angle
    largest = np.abs(reference).max()
    above = (reference - planned.max(axis=1, keepdims=True)).max(axis=1)
    below = (planned.min(axis=1, keepdims=True) - reference).max(axis=1)
    shortfall = np.array([above, below])
    distance = np.abs(reference - planned)
    mean = reference_distances(trajectory).planned
    is_short = shortfall.max() > max(MIN_DEVIATION, MAX_SHORTFALL_SHARE * largest)
    if not is_short and mean <= max(MIN_DEVIATION, MAX_MEAN_SHARE * largest):
        return None
    # Choose the bend and the knot to name.
    if is_short:
        side, bend = map(int, np.unravel_index(np.argmax(shortfall), shortfall.shape))
        sign = (1, -1)[side]
        target = sign * reference[bend]
        reached = sign * planned[bend]
        # The plan is nearest there to an angle that it never reaches.
        knot = int(np.argmax(np.where(target > reached.max(), reached, -np.inf)))
    else:
        bend, knot = map(int, np.unravel_index(np.argmax(distance), distance.shape))
    # Say the distance and the place.
    reference_deg, planned_deg = np.rad2deg([reference[bend, knot], planned[bend, knot]])
    mean_deg, largest_deg = np.rad2deg([mean, distance.max()])
    time = trajectory.time[knot]
    layout = trajectory.model.layout
    of_bend = f" of segment {layout.bend_segment[bend] + 1}" if len(layout.bends_of) > 1 else ""
    if not layout.is_planar:
        of_bend += f" towards {('E2', 'E3')[layout.bend_direction[bend]]}"
    warning = (
        f"The plan is far from its reference: {mean_deg:.1f}° on average, {largest_deg:.1f}° at "
        f"most. At {time:.1f} s, {reference_deg:.1f}°{of_bend} are asked for, and the plan has "
        f"{planned_deg:.1f}°"
    )
    # Add the limits that are active there, and the bends that the limb can hold.
    active = [
        constraint.bound
        for constraint in trajectory.check.active_constraints
        if constraint.start <= time <= constraint.end
    ]
    warning += (
        f", where limits are {', '.join(active)}." if active else ", where no limit is active."
    )
    bends_deg = _reachable_bends(trajectory.model, bend)
    if bends_deg is not None:
        warning += (
            f" With wires between T_warm and T_max, this limb can hold {bends_deg[0]:.1f}° to "
            f"{bends_deg[1]:.1f}°."
        )
    return warning + " Ask for less, or for a slower motion."


def _reachable_bends(model: LimbModel, bend: int) -> np.ndarray | None:
    """Return the smallest and largest bend that wires can hold (2,), °; None if the limb folds."""
    limits = model.parameters.temperature_limits
    sides = np.sign(model.mechanics.levers[model.layout.bend_joints[bend][0]])
    bends = []
    for side in (-1, 1):
        temperature = np.where(sides == side, limits.maximum, limits.warm)
        try:
            angles, _ = static_equilibrium(model, temperature)
        except LimbError:
            return None  # it folds
        bends.append(bend_angle(model, angles[:, None])[bend, 0])
    return np.rad2deg(bends)


def active_constraints(
    trajectory: Trajectory,
    task: Task,
    warm_up_time: float,
    measured_margin: ArrayLike,
    added: Mapping[str, np.ndarray],
) -> list[ActiveConstraint]:
    """Return the times in which bounds of (18)-(20), of readings, and added bounds are active.

    Args:
        warm_up_time: time after which wires are to be warm, s.
        measured_margin: how far readings stay below their maximum, °C, one number or (W,).
        added: whether constraints of ``customize`` are active at the knots (K,), by their names.
    """
    # Bounds and tolerances.
    limits = trajectory.parameters.temperature_limits
    is_warmed_up = trajectory.time > warm_up_time
    near_duty = 1e-4
    near_temperature = 1e-3 * TEMPERATURE_SCALE
    hottest = limits.maximum - task.temperature_margin
    fullest = 1.0 - task.duty_margin
    hottest_name = f"T_max - {task.temperature_margin:g} °C" if task.temperature_margin else "T_max"
    highest = reading_bounds(trajectory.model, measured_margin)
    # Find the knots at which each bound is active.
    is_active: dict[str, np.ndarray] = {}
    for index, name in enumerate(trajectory.parameters.wire_names):
        reading = trajectory.measured_temperature[index]
        duty = trajectory.duty[index]
        wire = trajectory.wire_temperature[index]
        is_active[f"duty {name} = 0"] = duty < near_duty
        is_active[f"duty {name} = {fullest:g}"] = duty > fullest - near_duty
        is_active[f"wire {name} = {hottest_name}"] = wire > hottest - near_temperature
        is_at_warm = wire < limits.warm + near_temperature
        is_active[f"wire {name} = T_warm"] = is_warmed_up & is_at_warm
        is_high = reading > highest[index] - near_temperature
        is_active[f"reading {name} = measured_maximum"] = is_high
    # Turn knots in a row into times.
    constraints = []
    for bound, knots in (*is_active.items(), *added.items()):
        for first, after in stretches(knots):
            start, end = trajectory.time[[first, after - 1]]
            constraints.append(ActiveConstraint(bound, float(start), float(end)))
    return constraints
