"""From a gait to a motion: so many cycles from cold wires, as a trajectory that can be replayed."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from limb_systems import LimbError, LimbModel, PlanCheck, Provenance, Trajectory, bend_angle
from limb_systems.files.signal_table import doses
from limb_systems.kinematics import joint_angles_from_bend_angle
from limb_systems.simulation import PERIOD
from limb_systems.wires import Wires
from planners.transcription.quasi_static import integrate_readings
from walking.gait import Gait

SHORTEST_WARM_UP, LONGEST_WARM_UP = 1.0, 300.0  # s
NEAR = 0.1  # °C
STEP = 0.25  # s, of a warm-up that begins warm
TOO_WARM = 3.0  # °C, of wires at its end: to cool by as much takes longer than it gains
LONGER = 1.25  # times, the next warm-up that is tried
# By which heat may bend the limbs otherwise than in the gait, after the first cycles. From cold it
# bends those of wires with memory by up to 6° otherwise, and by less from cycle to cycle.
TOLERANCE_DEG, SETTLING = 5.0, 4


def walk(
    gait: Gait, cycles: int, *, heat: ArrayLike | None = None, bend: ArrayLike | None = None
) -> Trajectory:
    """A warm-up, some cycles of a gait, and all wires off: a trajectory of all limbs together.

    The warm-up is as short as duty and its total allow, and brings each wire to its temperature at
    the gait's first knot: cold wires by a constant duty; warm ones all along a line, so that limbs
    that stand go from one posture to the other, and to 3 °C above it if a wire has to cool. There
    is none for wires that have the gait's first temperatures. The heat follows from the wires' laws
    under the trajectory's duty. The joint angles are the gait's, in which the robot is in balance
    with the gait's heat. In the warm-up they go there from the angles at the start, as the heat
    moves limbs without a ground.

    Args:
        gait: a gait; one that was checked must have passed.
        cycles: number of cycles.
        heat: [x, V] of the wires at the start (N + W,); cold if None.
        bend: φ of the limbs at the start (F,), rad; as the heat holds them without a ground if
            None.

    Returns:
        A trajectory for `replay`, with knots at 20 Hz. Its check says how the gait was found; it
        is empty if the gait was never checked. The difference in the check is the largest one, in
        the last cycle of four or more, between the bends that the two heats would hold without a
        ground.

    Raises:
        LimbError: if the gait failed its check, if a wire begins above T_max, or if the wires
            cannot be brought to the gait's heat.
    """
    if not gait.check.is_missing and (failure := gait.check.failure()):
        raise LimbError(f"This gait failed its check and is not walked: {failure}")
    wires, limits = LimbModel.of(gait.parameters).wires, gait.parameters.temperature_limits
    W, ambient = wires.num_wires, gait.parameters.ambient_temperature
    cold = np.append(wires.cold_states, wires.cold_states[:W])
    start = cold if heat is None else np.asarray(heat, float)
    if (hottest := start[:W].max()) > limits.maximum:
        raise LimbError(
            f"A wire begins the walk at {hottest:.0f} °C, above its limit of {limits.maximum:g} "
            "°C; let it cool first."
        )
    warm_up, levels = (
        _warm_up(gait, wires, start[:-W]) if heat is None else _change(gait, wires, start[:-W])
    )
    knots = np.arange(np.ceil((warm_up + cycles * gait.period) / PERIOD - 1e-6) + 1)
    times = PERIOD * knots
    # Each knot has the mean duty of the period about it, so that the heat is the same.
    edges = np.append(times - PERIOD / 2, times[-1] + PERIOD / 2).clip(min=0.0)
    steps = np.full(len(levels), warm_up / max(1, len(levels)))
    breaks = np.cumsum([0.0, *steps, *np.tile(np.diff(gait.time), cycles)])
    levels = np.hstack([levels.T, np.tile(gait.duty[:, :-1], cycles)])
    duty = (doses(levels, breaks, edges) / np.diff(edges)).T
    duty[-1] = 0.0
    since = times - warm_up
    walks, in_cycle = since >= 0, since % gait.period
    planned = PchipInterpolator(gait.time, gait.wire_states, axis=1)(in_cycle).T
    while (above := _heat(wires, start, duty, times)[:, :W].max() - limits.maximum) > 1e-7:
        duty *= 1 - 2 * above / (limits.maximum - ambient)  # of T_max by rounding
    along = _heat(wires, start, duty, times)

    course = PchipInterpolator(gait.time, gait.joint_angles, axis=1)
    held = LimbModel.of(gait.parameters).statics.angles(along[:, :-W]).T
    share = np.clip(times / max(warm_up, PERIOD), 0.0, 1.0)
    first = held[:, 0] if bend is None else joint_angles_from_bend_angle(gait.parameters, bend)
    offsets = first - held[:, 0], course(0.0) - held[:, np.argmax(walks)]  # held by the ground
    offset = np.outer(offsets[0], 1 - share) + np.outer(offsets[1], share)
    angles = np.where(walks, course(np.where(walks, in_cycle, 0.0)), held + offset)
    rates = np.gradient(angles, PERIOD, axis=1)
    check = PlanCheck()
    if not gait.check.is_missing and cycles < SETTLING:  # whose heat would come to the gait's
        check = walk(gait, SETTLING, heat=heat, bend=bend).check
    elif not gait.check.is_missing:
        last = since >= (cycles - 1) * gait.period
        in_gait = LimbModel.of(gait.parameters).statics.angles(planned[last]).T
        apart = bend_angle(gait.parameters, held[:, last] - in_gait)
        check = PlanCheck(
            solver=gait.check.solver,
            status=f"a gait that passed its check: {gait.check.status}",
            iterations=gait.check.iterations,
            solve_time=gait.check.solve_time,
            largest_defect=gait.check.violation,
            largest_difference_deg=float(np.rad2deg(np.abs(apart).max())),
            tolerance_deg=TOLERANCE_DEG,
        )
    return Trajectory(
        time=times,
        reference=bend_angle(gait.parameters, angles),
        duty=duty.T,
        joint_state=np.vstack([angles, rates]),
        **wires.signals(along[:, :-W].T),
        measured_temperature=along[:, -W:].T,
        parameters=gait.parameters,
        check=check,
        provenance=Provenance.now(gait.parameters),
    )


def _warm_up(gait: Gait, wires: Wires, start: np.ndarray) -> tuple[float, np.ndarray]:
    """The shortest warm-up with constant duty, s, and its duty (1, W), from cold states (N,)."""
    target, duration, W = gait.wire_temperature[:, 0], SHORTEST_WARM_UP, wires.num_wires
    while duration < LONGEST_WARM_UP:
        duration = PERIOD * np.ceil(duration / PERIOD)
        times = np.linspace(0.0, duration, 11)
        level = np.full(W, 0.5)
        cooled = wires.integrate_states(start, np.zeros((11, W)), times)[-1, :W]
        for _ in range(10):  # T rises with duty, in proportion where heat is linear
            reached = wires.integrate_states(start, np.tile(level, (11, 1)), times)[-1, :W]
            if np.abs(reached - target).max() < NEAR and level.sum() <= gait.robot.total_duty:
                return duration, level[None]
            rise = np.maximum(reached - cooled, NEAR)
            level = np.clip(np.maximum(level, 0.01) * (target - cooled) / rise, 0.0, 1.0)
        duration *= LONGER
    raise _never_reached()


def _change(gait: Gait, wires: Wires, start: np.ndarray) -> tuple[float, np.ndarray]:
    """The shortest way along a line to the gait's T, s, and its duty (K, W), from states (N,)."""
    W, total, states = wires.num_wires, gait.robot.total_duty, start
    levels: list[np.ndarray] = []
    first, target = start[:W], gait.wire_temperature[:, 0]
    way, share = target - first, 0.0  # the share of the way, that the wires have gone
    if np.abs(way).max() < NEAR:
        return 0.0, np.zeros((0, W))
    while share < 1.0:
        if STEP * len(levels) > LONGEST_WARM_UP:
            raise _never_reached()
        none, full = (wires.rates(states, np.full(W, duty))[:W] for duty in (0.0, 1.0))
        # Rates of temperature are D of the way from none to full; those of cooling wires are none.
        behind = (first + share * way - states[:W]) / STEP
        fastest = np.where(way > 0, full, none) / np.where(way == 0, np.nan, way)
        by_pace, at_rest = way / (full - none), (behind - none) / (full - none)
        by_total = (total - at_rest.sum()) / by_pace.sum() if by_pace.sum() > 0 else np.inf
        pace = max(0.0, min(np.nanmin(fastest), by_total, (1.0 - share) / STEP))
        left = (1.0 - share) * way
        if (left >= -TOO_WARM).all() and (left <= full * STEP).all():
            pace = (1.0 - share) / STEP  # as far as wires that are off cool in the last step
        share += pace * STEP
        level = np.clip(by_pace * pace + at_rest, 0.0, 1.0)
        level *= min(1.0, total / max(level.sum(), 1e-9))
        states = wires.integrate_states(states, np.tile(level, (2, 1)), np.array([0.0, STEP]))[-1]
        levels.append(level)
    return STEP * len(levels), np.array(levels)


def _never_reached() -> LimbError:
    return LimbError(
        f"The wires do not reach the gait's first temperatures within {LONGEST_WARM_UP:g} s; has "
        "the air or the supply changed since it was planned?"
    )


def _heat(wires: Wires, start: np.ndarray, duty: np.ndarray, times: np.ndarray) -> np.ndarray:
    """[x, V] (K, N + W) under duty (K, W) that is linear between times (K,), from a start."""
    states, readings = np.split(start, [-wires.num_wires])
    course = wires.integrate_states(states, duty, times)
    return np.hstack([course, integrate_readings(wires, course, readings, times)])
