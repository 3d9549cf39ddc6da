"""The check of gaits: simulation with contact, as planned and with other robots or grounds."""

import copy
import dataclasses
import itertools
from collections.abc import Callable, Mapping

import numpy as np
from scipy.linalg import null_space

from limb_systems import LimbParameters, Recording, simulate
from limb_systems.simulation import PERIOD, SimulationError
from walking.gait import Gait, GaitVariation
from walking.in_mujoco import simulate_in_mujoco
from walking.robot import Robot
from walking.robot_parameters import RobotParameters

NUM_CYCLES = 3
MAX_CYCLES = 8
# Strides of most gaits agree to 0.03% from the second on. Robots whose strides differ by more than
# SETTLED_TOLERANCE do not repeat themselves, and are simulated for MAX_CYCLES.
SETTLED_TOLERANCE = 2e-3
SETTLED_TOLERANCE_IN_SPACE = 0.02  # there loads, and with them strides, depend on micrometres
SPREAD_CYCLES = 2  # of other robots
FRICTION_FACTORS = (0.7, 1.3)  # times the friction of the ground
PARAMETER_VARIATION = 0.1  # share by which parameters are varied
# Calibration finds the ratio of torque to stiffness to 2 to 5%, but each of them alone to 9% only.
# On calibrated limbs the ratio varies by this share of PARAMETER_VARIATION.
RATIO_VARIATION_SHARE = 0.5
NUM_DRAWS = 4  # of varied parameters
EXPECTED_WARP = 1e-3  # m, of four feet of a robot whose hips are within 1 mm
FALL_TILT = np.deg2rad(60.0)
UNLOADED_SHARE = 1e-3  # of the weight, on a foot that carries nothing
BODY_CONTACT_HEIGHT = 2e-3  # m, of a corner of a body that is on the ground
MAX_ENGINE_DIFFERENCE = 0.01  # of the planned stride, between MuJoCo and Drake
MIN_STRIDE_SHARE = 0.5  # of the planned stride, of gaits that are taken
DRAKE_NAME = "Drake in steps of 1 ms"
MUJOCO_NAME = "MuJoCo"
NOMINAL_IN_MUJOCO = "as planned, in MuJoCo"  # of the spread, to which the others compare


def check_gait(gait: Gait, cycles: int = NUM_CYCLES, spread: bool = True, seed: int = 0) -> Gait:
    """Simulate a gait with contact, open loop, and return it with its check.

    Simulated strides from the second on may agree with each other, but miss the planned stride by
    more than 1%. The gait then gets their travel, if it is at least half of the plan's: their
    travel in MuJoCo, or, in space, in Drake if Drake simulates more than one cycle.

    The simulation begins with the heat of the limit cycle. A gait that walks as planned in MuJoCo
    is simulated by Drake with steps of 1 ms, for one cycle, for two if the first differs from the
    others, or for as many as in MuJoCo if the strides are within 1% of the tolerance. For the
    spread, two cycles each are simulated in MuJoCo with 0.7 and 1.3 times the friction of the
    ground, and with four draws of the parameters, see `with_varied_parameters`. In space cooling
    and heating are not varied, because `HeatFeedback` holds the heat of the gait there; but four
    and more feet are warped by 1 mm, either way.

    Args:
        gait: as planned; the property ``passed`` of the returned gait is the result.
        cycles: number of cycles of the nominal robot; eight if strides after the first differ
            by more than 0.2%, in space 2%, of the planned stride.
        spread: whether to simulate it with varied friction and parameters, too.
        seed: seed of the draws.
    """
    # Simulate the nominal robot in MuJoCo, and correct the stride.
    first = simulate_gait(gait, "", gait.robot, cycles, max_cycles=MAX_CYCLES)
    gait = _announce_stride(gait, first)
    check = dataclasses.replace(gait.check, simulation=first, spread=[], checked_by=MUJOCO_NAME)
    errors = np.abs(np.array(first.strides) - 1)
    largest_error = errors[1:].max(initial=0.0)
    is_close = not first.fall and abs(largest_error - check.tolerance) < MAX_ENGINE_DIFFERENCE
    if check.failure() and not is_close:
        return dataclasses.replace(gait, check=check)
    # Let Drake decide.
    drake_cycles = 1 if errors[0] < check.tolerance - MAX_ENGINE_DIFFERENCE else 2
    if is_close:
        drake_cycles = len(errors)
    check.simulation = simulate_gait(
        gait, "", gait.robot, drake_cycles, simulator=simulate_in_drake
    )
    if gait.in_space:
        gait = _announce_stride(gait, check.simulation, first)
        check.made = gait.check.made
    check.checked_by = (
        f"{DRAKE_NAME} for {len(check.simulation.strides)} of the cycles, {MUJOCO_NAME}"
    )
    # Simulate robots with varied friction and parameters.
    if spread and not check.failure():
        check.spread = [dataclasses.replace(first, what=NOMINAL_IN_MUJOCO)]
        for change, robot in variations(gait.robot, seed):
            check.spread.append(simulate_gait(gait, change, robot, min(cycles, SPREAD_CYCLES)))
    return dataclasses.replace(gait, check=check)


def _announce_stride(gait: Gait, simulation: GaitVariation, *others: GaitVariation) -> Gait:
    """Return a gait with the stride, turn included, that it makes from its second cycle on.

    Its feet slide the rest. The gait stays as it is if the robot falls, or makes less than half of
    the stride.

    Args:
        simulation: strides of the gait, which give the new stride.
        others: further strides of the gait. All become shares of the new stride, in place.
    """
    settled = simulation.strides[1:]
    made = float(np.mean(settled)) if settled and not simulation.fall else 0.0
    if made < MIN_STRIDE_SHARE or abs(made - 1) <= MAX_ENGINE_DIFFERENCE:
        return gait
    for variation in (simulation, *others):
        variation.strides = (np.array(variation.strides) / made).tolist()
        variation.aside = (np.array(variation.aside) / made).tolist()
    pose = gait.body_pose.copy()
    travel = (made - 1) * gait.displacement
    pose[[0, 1, 5] if gait.in_space else [0]] += np.outer(travel, gait.time / gait.period)
    check = dataclasses.replace(gait.check, made=made * gait.check.made)
    return dataclasses.replace(gait, body_pose=pose, check=check)


def variations(robot: RobotParameters, seed: int = 0) -> list[tuple[str, RobotParameters]]:
    """Return the varied robots of `check_gait`, each with its change in words."""
    rng = np.random.default_rng(seed)
    in_space = robot.body.mount == "free"
    varied = []
    for factor in FRICTION_FACTORS:
        varied.append((f"friction x {factor:g}", with_friction(robot, factor)))
    for number in range(1, NUM_DRAWS + 1):
        change = f"parameters +-{PARAMETER_VARIATION:.0%}, draw {number}"
        # In space feedback holds the heat.
        varied.append((change, with_varied_parameters(robot, rng, heat=not in_space)))
    # Three feet stand on any ground, and the feet of a plane's robot are in a line.
    if in_space and warp_pattern(robot).any():
        for warp in (-EXPECTED_WARP, EXPECTED_WARP):
            change = f"feet warped by {1e3 * warp:+g} mm"
            varied.append((change, with_warp_and_friction(robot, warp, 0.0)))
    return varied


def with_friction(robot: RobotParameters, factor: float) -> RobotParameters:
    """Return a copy of the robot with the ground's friction multiplied by a factor."""
    robot = copy.deepcopy(robot)
    assert robot.ground is not None  # of robots that walk
    robot.ground.friction *= factor
    return robot


def with_warp_and_friction(
    robot: RobotParameters, warp: float, logarithm: float
) -> RobotParameters:
    """Return a copy of a robot with other hips and friction.

    Args:
        warp: h1 - h2 - h3 + h4 of the heights of four hips, m, in the order of
            `RobotParameters.in_space`. Two hips across each other are raised, the others lowered.
        logarithm: logarithm of the multiple of friction.
    """
    robot = with_friction(robot, float(np.exp(logarithm)))
    for limb, raised in zip(robot.limbs, 0.25 * warp * warp_pattern(robot), strict=True):
        limb.position = [*limb.position[:2], limb.position[2] + float(raised)]
    return robot


def warp_pattern(robot: RobotParameters) -> np.ndarray:
    """Return heights of hips (L,), of rms 1, that no plane has; zero of three hips."""
    places = robot.hips[:, :2]
    patterns = null_space(np.column_stack([np.ones(len(places)), places]).T)
    if not patterns.size:
        return np.zeros(len(places))
    return patterns[:, 0] * np.sqrt(len(places)) * np.sign(patterns[0, 0])


def with_varied_parameters(
    robot: RobotParameters, rng: np.random.Generator, *, heat: bool = True
) -> RobotParameters:
    """Return a robot with stiffness and wires' laws 10% larger or smaller, drawn per limb.

    Where a limb is calibrated, the ratio of torque to stiffness is 5% larger or smaller.

    Args:
        heat: whether cooling and heating of wires are varied, too.
    """
    robot = copy.deepcopy(robot)
    factors = [1 - PARAMETER_VARIATION, 1 + PARAMETER_VARIATION]
    for limb in robot.limbs:
        a1, a2, torque = rng.choice(factors, 3)
        stiffness = rng.choice(factors)
        if limb.parameters.calibration:
            torque = stiffness * (1 + RATIO_VARIATION_SHARE * (torque - 1))
        law_factors = {"beta": torque, "full_torque": torque}
        if heat:
            law_factors |= {"a1": a1, "a2": a2}
        scale_limb(limb.parameters, stiffness, law_factors)
    return robot


def scale_limb(
    limb: LimbParameters, stiffness_factor: float, law_factors: Mapping[str, float]
) -> None:
    """Multiply a limb's stiffness, and those fields that its wires' laws have, by factors."""
    for segment in limb.segments:
        segment.stiffness *= stiffness_factor
        for wire, (field, factor) in itertools.product(segment.wires, law_factors.items()):
            if hasattr(wire.law, field):
                setattr(wire.law, field, getattr(wire.law, field) * factor)


def simulate_gait(
    gait: Gait,
    change: str,
    robot: RobotParameters,
    cycles: int,
    *,
    max_cycles: int = 0,
    simulator: Callable[[Gait, RobotParameters, int], Recording] = simulate_in_mujoco,
) -> GaitVariation:
    """Simulate cycles of a gait's duty on a robot, open loop, from the gait's first knot.

    Args:
        gait: the gait, whose duty and planned stride are used.
        change: how the robot differs from the gait's robot, in words; "" if it does not.
        robot: the robot to simulate.
        cycles: number of cycles to simulate.
        max_cycles: number of cycles to simulate instead if strides after the first still differ.
        simulator: `simulate_in_mujoco` or `simulate_in_drake`.

    Returns:
        The strides as shares of the planned stride, the highest temperature, and how it falls.
    """
    try:
        recording = simulator(gait, robot, cycles)
    except SimulationError as error:
        return GaitVariation(change, fall=str(error).rstrip("."))
    assert recording.wire_temperature is not None
    # Measure the strides that end before the robot falls, as shares of the planned stride.
    fall, end_time = find_fall(recording, gait)
    num_completed = min(cycles, int(end_time / gait.period + 1e-6))
    starts = gait.period * np.arange(num_completed + 1)
    strides, aside = measure_strides(recording, gait, starts)
    # Simulate more cycles where strides still change.
    max_change = np.abs(np.diff(strides[1:])).max(initial=0.0)  # the first one is still settling
    tolerance = SETTLED_TOLERANCE_IN_SPACE if gait.in_space else SETTLED_TOLERANCE
    if not fall and cycles < max_cycles and max_change > tolerance:
        return simulate_gait(gait, change, robot, max_cycles, simulator=simulator)
    return GaitVariation(
        change,
        strides=strides.tolist(),
        aside=aside.tolist() if gait.in_space else [],
        highest_temperature=float(recording.wire_temperature.max()),
        fall=fall,
    )


def simulate_in_drake(gait: Gait, robot: RobotParameters, cycles: int) -> Recording:
    """Simulate cycles like `simulate_in_mujoco`, by Drake's SAP contact in steps of 1 ms."""
    duration = cycles * gait.period + PERIOD  # with a sample after the last stride
    duty = gait.duty_trajectory(cycles)
    return simulate(Robot(robot), duty, duration, initial_state=gait.initial_state)


def measure_strides(
    recording: Recording, gait: Gait, starts: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the travel of the body in each cycle (C,), as shares of the planned stride.

    Args:
        starts: times at which the cycles begin, and the last one ends (C + 1,), s.

    Returns:
        The travel along the planned stride, turn included, and the travel perpendicular to it.
    """
    assert recording.body_pose is not None
    # Angles go on beyond π; positions, in m, never jump by so much.
    pose = np.unwrap(recording.body_pose, axis=1)
    return gait.progress(np.array([np.interp(starts, recording.time, row) for row in pose]))


def find_fall(recording: Recording, gait: Gait, start: float = 0.0) -> tuple[str, float]:
    """Return how a robot that walks falls, in words, and when, s; "" and the end if it does not.

    A robot has fallen when its body tilts by more than 60° or touches the ground. It has fallen,
    too, when a foot that does not swing in the gait carries nothing for half a period. Loads are
    checked where the recording has forces, but not in space with four or more feet, as any three of
    them can stand. The first cycle of the gait begins at ``start``, s.
    """
    assert recording.body_pose is not None
    body = gait.robot.body
    times = recording.time

    # Find samples at which the body tilts or touches the ground.
    height, upright = _height_and_upright(recording.body_pose)
    sizes = np.array([body.length, body.width, body.height])
    lowest = height - 0.5 * sizes @ np.abs(upright)
    falls = [
        (
            upright[2] < np.cos(FALL_TILT),
            f"its body tilts by more than {np.rad2deg(FALL_TILT):.0f}°",
        ),
        (lowest < BODY_CONTACT_HEIGHT, "its body comes to the ground"),
    ]

    # Find samples before which a foot carried nothing for half a period.
    phases = np.searchsorted(gait.phase_starts, (times - start) % gait.period, "right") - 1
    size = gait.robot.force_size
    weight = gait.contact_force[size - 1 :: size].sum(axis=0).mean()
    forces = recording.contact_force
    loads = () if forces is None or _has_spare_feet(gait) else forces[size - 1 :: size]
    half_period = round(0.5 * gait.period * recording.sample_rate)  # in samples
    for foot, load in enumerate(loads):
        swings = np.array([phase.contacts[foot] == "swing" for phase in gait.phases])[phases]
        is_unloaded = (load < UNLOADED_SHARE * weight) & ~swings & (times >= start)
        num_unloaded = np.convolve(is_unloaded, np.ones(half_period))[: len(is_unloaded)]
        name = gait.robot.limbs[foot].name
        reason = f"its {name} foot carries nothing for half a period"
        falls.append((num_unloaded > half_period - 0.5, reason))

    # Report the first of them.
    first = [(int(np.argmax(has_fallen)), words) for has_fallen, words in falls if has_fallen.any()]
    if not first:
        return "", float(times[-1])
    index, words = min(first)
    elapsed = times[index] - start
    when = f"after {elapsed:.1f} s" if elapsed >= 0 else "in the warm-up"
    return f"{words} {when}", float(times[index])


def _has_spare_feet(gait: Gait) -> bool:
    """Return whether the robot may stand on fewer feet than it has: on three in space."""
    return gait.in_space and len(gait.robot.limbs) > 3


def _height_and_upright(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the body's height (K,), m, and the upward parts of its x, y and z axes (3, K)."""
    if len(pose) == 3:
        return pose[1], np.stack([np.sin(pose[2]), 0 * pose[2], np.cos(pose[2])])
    roll, pitch = pose[3:5]
    across = np.cos(pitch) * np.stack([np.sin(roll), np.cos(roll)])
    return pose[2], np.vstack([-np.sin(pitch), across])
