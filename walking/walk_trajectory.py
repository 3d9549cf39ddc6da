"""From a gait to a motion: so many cycles from cold wires, as a trajectory that can be replayed."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from limb_systems import LimbError, LimbModel, PlanCheck, Provenance, Trajectory, bend_angle
from limb_systems.files.signal_table import doses
from limb_systems.kinematics import joint_angles_from_bend_angle
from limb_systems.law_functions import check_affine
from limb_systems.simulation import PERIOD
from limb_systems.wire_laws.wire_law import duty_for_rate
from limb_systems.wires import Wires
from planners.transcription.quasi_static import integrate_readings
from walking.gait import Gait

MIN_WARM_UP = 1.0  # s
MAX_WARM_UP = 300.0  # s
TEMPERATURE_TOLERANCE = 0.1  # °C
WARM_UP_STEP = 0.25  # s, of a warm-up that begins warm
MAX_OVERHEATING = 3.0  # °C, of wires at its end: to cool by as much takes longer than it gains
DURATION_FACTOR = 1.25  # times, the next warm-up that is tried
# Allowed difference between the bends of the heat of walk and gait, after SETTLING_CYCLES. From
# cold, wires with memory bend limbs by up to 6° otherwise, and by less from cycle to cycle.
TOLERANCE_DEG = 5.0
SETTLING_CYCLES = 4


def walk(
    gait: Gait, cycles: int, *, heat: ArrayLike | None = None, bend: ArrayLike | None = None
) -> Trajectory:
    """Return a trajectory of all limbs: a warm-up, some cycles of a gait, and all wires off.

    The warm-up is as short as duty and total duty allow, and brings each wire to its temperature at
    the gait's first knot. Cold wires get a constant duty. Warm wires change temperature together
    along a line, so that standing limbs go from one posture to the other; wires that have to cool
    end at most 3 °C too warm. Wires that have the gait's first temperatures need no warm-up. The
    heat follows from the wires' laws under the trajectory's duty. The joint angles are the gait's,
    in which the robot is in balance with the gait's heat. In the warm-up they go there from the
    angles at the start, as the heat moves limbs without a ground.

    Args:
        gait: a gait; one that was checked must have passed.
        cycles: number of cycles.
        heat: [x, V] of the wires at the start (N + W,); cold if None.
        bend: φ of the limbs at the start (F,), rad; the equilibrium of the heat without a ground
            if None.

    Returns:
        A trajectory for `replay`, with knots at 20 Hz. Its check has the gait's solver and status;
        it is empty if the gait was never checked. The check's difference is the largest one between
        the bends that the walk's heat and the gait's heat would hold without a ground, in the last
        cycle of four or more.

    Raises:
        LimbError: if the gait failed its check, if the rates of a wire's law are not affine in the
            duty, if a wire begins above T_max, or if the wires cannot be brought to the gait's
            heat.
    """
    if not gait.check.is_missing and (failure := gait.check.failure()):
        raise LimbError(f"This gait failed its check and is not walked: {failure}")
    model = LimbModel.of(gait.parameters)
    check_affine(model.parameters)
    wires = model.wires
    W = wires.num_wires
    limits = gait.parameters.temperature_limits
    ambient = gait.parameters.ambient_temperature

    # Plan the warm-up from the heat at the start.
    cold = np.append(wires.cold_states, wires.cold_states[:W])
    start = cold if heat is None else np.asarray(heat, float)
    if (hottest := start[:W].max()) > limits.maximum:
        raise LimbError(
            f"A wire begins the walk at {hottest:.0f} °C, above its limit of {limits.maximum:g} "
            "°C; let it cool first."
        )
    plan_warm_up = _warm_up_from_cold if heat is None else _change_heat
    warm_up, levels = plan_warm_up(gait, wires, start[:-W])

    # Sample the duty. Each knot has the mean duty of the period about it, which keeps the heat.
    num_periods = np.ceil((warm_up + cycles * gait.period) / PERIOD - 1e-6)
    times = PERIOD * np.arange(num_periods + 1)
    edges = np.append(times - PERIOD / 2, times[-1] + PERIOD / 2).clip(min=0.0)
    steps = np.full(len(levels), warm_up / max(1, len(levels)))
    breaks = np.cumsum([0.0, *steps, *np.tile(np.diff(gait.time), cycles)])
    levels = np.hstack([levels.T, np.tile(gait.duty[:, :-1], cycles)])
    duty = (doses(levels, breaks, edges) / np.diff(edges)).T
    duty[-1] = 0.0

    # Integrate the heat; scale the duty if sampling brings T above T_max.
    along = _integrate_heat(wires, start, duty, times)
    while (above := along[:, :W].max() - limits.maximum) > 1e-7:
        duty *= 1 - 2 * above / (limits.maximum - ambient)
        along = _integrate_heat(wires, start, duty, times)

    # In the warm-up, add offsets to the equilibria of the heat without a ground, so that the joint
    # angles begin at the start and end at the gait's first knot. Then follow the gait.
    since = times - warm_up
    walks = since >= 0
    in_cycle = since % gait.period
    gait_angles = PchipInterpolator(gait.time, gait.joint_angles, axis=1)
    equilibria = model.statics.angles(along[:, :-W]).T
    first = equilibria[:, 0]
    if bend is not None:
        first = joint_angles_from_bend_angle(gait.parameters, bend)
    share = np.clip(times / max(warm_up, PERIOD), 0.0, 1.0)
    first_offset = first - equilibria[:, 0]
    last_offset = gait_angles(0.0) - equilibria[:, np.argmax(walks)]  # held by the ground
    offset = np.outer(first_offset, 1 - share) + np.outer(last_offset, share)
    in_gait = gait_angles(np.where(walks, in_cycle, 0.0))
    angles = np.where(walks, in_gait, equilibria + offset)
    rates = np.gradient(angles, PERIOD, axis=1)

    # Compare the bends of the walk's heat with the bends of the gait's heat in a settled cycle.
    check = PlanCheck()
    if not gait.check.is_missing and cycles < SETTLING_CYCLES:
        check = walk(gait, SETTLING_CYCLES, heat=heat, bend=bend).check
    elif not gait.check.is_missing:
        last = since >= (cycles - 1) * gait.period
        planned = PchipInterpolator(gait.time, gait.wire_states, axis=1)(in_cycle).T
        planned_angles = model.statics.angles(planned[last]).T
        difference = bend_angle(gait.parameters, equilibria[:, last] - planned_angles)
        check = PlanCheck(
            solver=gait.check.solver,
            status=f"a gait that passed its check: {gait.check.status}",
            iterations=gait.check.iterations,
            solve_time=gait.check.solve_time,
            largest_defect=gait.check.violation,
            largest_difference_deg=float(np.rad2deg(np.abs(difference).max())),
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


def _warm_up_from_cold(gait: Gait, wires: Wires, start: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the shortest warm-up with constant duty, s, and its duty (1, W).

    Args:
        start: states of cold wires (N,).
    """
    target = gait.wire_temperature[:, 0]
    W = wires.num_wires
    duration = MIN_WARM_UP
    while duration < MAX_WARM_UP:
        duration = PERIOD * np.ceil(duration / PERIOD)
        times = np.linspace(0.0, duration, 11)
        level = np.full(W, 0.5)
        cooled = wires.integrate_states(start, np.zeros((11, W)), times)[-1, :W]
        for _ in range(10):  # T rises with duty, in proportion where heat is linear
            reached = wires.integrate_states(start, np.tile(level, (11, 1)), times)[-1, :W]
            if (
                np.abs(reached - target).max() < TEMPERATURE_TOLERANCE
                and level.sum() <= gait.robot.total_duty
            ):
                return duration, level[None]
            rise = np.maximum(reached - cooled, TEMPERATURE_TOLERANCE)
            level = np.clip(np.maximum(level, 0.01) * (target - cooled) / rise, 0.0, 1.0)
        duration *= DURATION_FACTOR
    raise _unreachable_heat()


def _change_heat(gait: Gait, wires: Wires, start: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the shortest time along a line to the gait's T, s, and the duty (K, W) for it.

    Args:
        start: states of the wires (N,).
    """
    W = wires.num_wires
    total = gait.robot.total_duty
    states = start
    levels: list[np.ndarray] = []
    first = start[:W]
    way = gait.wire_temperature[:, 0] - first
    share = 0.0  # of the way that the wires have gone
    if np.abs(way).max() < TEMPERATURE_TOLERANCE:
        return 0.0, np.zeros((0, W))
    while share < 1.0:
        if WARM_UP_STEP * len(levels) > MAX_WARM_UP:
            raise _unreachable_heat()
        # Find the rates of T, °C/s, without duty and at full duty.
        rates_off = wires.rates(states, np.zeros(W))[:W]
        rates_full = wires.rates(states, np.ones(W))[:W]

        # Find the largest pace, 1/s, along the way that all wires and the total duty allow.
        fastest = np.where(way > 0, rates_full, rates_off) / np.where(way == 0, np.nan, way)
        lag_rate = (first + share * way - states[:W]) / WARM_UP_STEP
        duty_per_pace = way / (rates_full - rates_off)
        holding_duty = duty_for_rate(lag_rate, rates_off, rates_full)
        by_total = np.inf
        if duty_per_pace.sum() > 0:
            by_total = (total - holding_duty.sum()) / duty_per_pace.sum()
        pace = max(0.0, min(np.nanmin(fastest), by_total, (1.0 - share) / WARM_UP_STEP))

        # End in this step if wires need to cool by no more than 3 °C.
        rest = (1.0 - share) * way
        if (rest >= -MAX_OVERHEATING).all() and (rest <= rates_full * WARM_UP_STEP).all():
            pace = (1.0 - share) / WARM_UP_STEP

        # Take the step.
        share += pace * WARM_UP_STEP
        level = np.clip(duty_per_pace * pace + holding_duty, 0.0, 1.0)
        level *= min(1.0, total / max(level.sum(), 1e-9))
        states = wires.integrate_states(
            states, np.tile(level, (2, 1)), np.array([0.0, WARM_UP_STEP])
        )[-1]
        levels.append(level)
    return WARM_UP_STEP * len(levels), np.array(levels)


def _unreachable_heat() -> LimbError:
    return LimbError(
        f"The wires do not reach the gait's first temperatures within {MAX_WARM_UP:g} s; has "
        "the air or the supply changed since it was planned?"
    )


def _integrate_heat(
    wires: Wires, start: np.ndarray, duty: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Return [x, V] (K, N + W) from a start (N + W,), with duty (K, W) linear in time."""
    state, reading = np.split(start, [-wires.num_wires])
    states = wires.integrate_states(state, duty, times)
    return np.hstack([states, integrate_readings(wires, states, reading, times)])
