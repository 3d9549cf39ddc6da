"""From a gait to a motion: so many cycles from cold wires, as a trajectory that can be replayed."""

import numpy as np
from scipy.interpolate import PchipInterpolator

from limb_systems import Gait, LimbError, PlanCheck, Provenance, Trajectory, Wires, bend_angle
from limb_systems.model.kinematics import rest_joint_angles
from limb_systems.model.statics import HeldAngles
from limb_systems.simulation import PERIOD
from planners.transcription.quasi_static import readings_along

SHORTEST_WARM_UP, LONGEST_WARM_UP = 1.0, 300.0  # s
NEAR = 0.1  # °C
LONGER = 1.25  # times, the next warm-up that is tried
TOLERANCE_DEG = 5.0  # by which heat may bend the limbs otherwise than in the gait


def walk(gait: Gait, cycles: int, *, from_cold: bool = True) -> Trajectory:
    """A warm-up, some cycles of a gait, and all wires off: a trajectory of all limbs together.

    In the warm-up, each wire has the constant duty that brings it from ambient to its temperature
    at the gait's first knot; it is as short as duty and its total allow. The heat follows from the
    wires' laws under the trajectory's duty. The joint angles are the gait's, in which the robot is
    in balance with the gait's heat; in the warm-up they grow with the heat.

    Args:
        gait: a gait; one that was checked must have passed.
        cycles: number of cycles.
        from_cold: whether there is a warm-up; else the wires begin as in the gait.

    Returns:
        A trajectory for `replay`, with knots at 20 Hz. Its check says how the gait was found; it
        is empty if the gait was never checked. The difference in the check is the largest one, in
        the cycles, between the bends that the two heats would hold without a ground.

    Raises:
        LimbError: if the gait failed its check, or its wires cannot be brought to its heat.
    """
    if not gait.check.is_missing and (failure := gait.check.failure()):
        raise LimbError(f"This gait failed its check and is not walked: {failure}")
    wires, limits = Wires(gait.parameters), gait.parameters.temperature_limits
    W, ambient = wires.num_wires, gait.parameters.ambient_temperature
    warm_up, level = _warm_up(gait, wires) if from_cold else (0.0, np.zeros(W))
    knots = np.arange(np.ceil((warm_up + cycles * gait.period) / PERIOD - 1e-6) + 1)
    times = PERIOD * knots
    # Each knot has the mean duty of the period about it, so that the heat is the same.
    edges = np.append(times - PERIOD / 2, times[-1] + PERIOD / 2).clip(min=0.0)
    duty = np.diff(_duty_time(gait, cycles, warm_up, level, edges), axis=0)
    duty /= np.diff(edges)[:, None]
    duty[-1] = 0.0
    since = times - warm_up
    walks, in_cycle = since >= 0, since % gait.period
    planned = PchipInterpolator(gait.time, gait.wire_states, axis=1)(in_cycle).T
    start = wires.cold_states if from_cold else gait.wire_states[:, 0]
    while (above := _heat(wires, start, duty, times)[:, :W].max() - limits.maximum) > 1e-7:
        duty *= 1 - 2 * above / (limits.maximum - ambient)  # of T_max by rounding
    heat = _heat(wires, start, duty, times)

    course = PchipInterpolator(gait.time, gait.joint_angles, axis=1)
    rest = rest_joint_angles(gait.parameters)[:, None]
    warmth = heat[:, :W].mean(axis=1) - ambient
    share = np.where(walks, 1.0, warmth / warmth[np.argmax(walks)])
    angles = rest + share * (course(np.where(walks, in_cycle, 0.0)) - rest)
    rates = np.gradient(angles, PERIOD, axis=1)
    check = PlanCheck()
    if not gait.check.is_missing:
        held = HeldAngles(gait.parameters)
        apart = bend_angle(
            gait.parameters, (held.angles(heat[walks, :-W]) - held.angles(planned[walks])).T
        )
        check = PlanCheck(
            solver=gait.check.solver,
            status=f"a gait that passed its check: {gait.check.status}",
            iterations=gait.check.iterations,
            solve_time=gait.check.solve_time,
            largest_defect=gait.check.violation,
            largest_difference_deg=float(np.rad2deg(np.abs(apart).max())),
            tolerance_deg=TOLERANCE_DEG,
        )
    states, readings = heat[:, :-W].T, heat[:, -W:].T
    return Trajectory(
        time=times,
        reference=bend_angle(gait.parameters, angles),
        duty=duty.T,
        joint_state=np.vstack([angles, rates]),
        wire_temperature=states[:W],
        measured_temperature=readings,
        parameters=gait.parameters,
        check=check,
        other_wire_state=states[W:] if len(states) > W else None,
        provenance=Provenance.now(gait.parameters),
    )


def _warm_up(gait: Gait, wires: Wires) -> tuple[float, np.ndarray]:
    """The shortest warm-up with constant duty, s, and its duty (W,)."""
    target, duration = gait.wire_temperature[:, 0], SHORTEST_WARM_UP
    cold, W = wires.cold_states[: wires.num_wires], wires.num_wires
    while duration < LONGEST_WARM_UP:
        duration = PERIOD * np.ceil(duration / PERIOD)
        times = np.linspace(0.0, duration, 11)
        level = np.full(W, 0.5)
        for _ in range(10):  # T rises with duty, in proportion where heat is linear
            reached = wires.under_duty(wires.cold_states, np.tile(level, (11, 1)), times)[-1, :W]
            if np.abs(reached - target).max() < NEAR and level.sum() <= gait.robot.total_duty:
                return duration, level
            level = np.clip(level * (target - cold) / (reached - cold), 0.0, 1.0)
        duration *= LONGER
    raise LimbError(
        f"The wires do not reach the gait's first temperatures within {LONGEST_WARM_UP:g} s from "
        "cold; has the air or the supply changed since it was planned?"
    )


def _duty_time(
    gait: Gait, cycles: int, warm_up: float, level: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Duty summed over time since the start (K, W), s, of warm-up, cycles and wires off."""
    lengths = [np.diff(gait.time)] * cycles
    levels = [gait.duty[:, :-1].T] * cycles
    steps = np.concatenate([[warm_up], *lengths])
    sums = np.cumsum(steps[:, None] * np.vstack([level, *levels]), axis=0)
    knots = np.append(0.0, np.cumsum(steps))
    return np.transpose([np.interp(times, knots, np.append(0.0, of_wire)) for of_wire in sums.T])


def _heat(wires: Wires, states: np.ndarray, duty: np.ndarray, times: np.ndarray) -> np.ndarray:
    """[x, V] (K, N + W) under duty (K, W) that is linear between times (K,), from V = T."""
    course = wires.under_duty(states, duty, times)
    return np.hstack([course, readings_along(wires, course, states[: wires.num_wires], times)])
