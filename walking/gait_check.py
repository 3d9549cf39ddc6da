"""The check of gaits: simulated with contact as planned, and where robot or ground are others."""

import copy
import dataclasses
import itertools
from collections.abc import Callable, Mapping

import numpy as np

from limb_systems import LimbParameters, Recording, simulate
from limb_systems.simulation import PERIOD, SimulationError
from walking.gait import Gait, GaitVariation
from walking.in_mujoco import simulate_in_mujoco
from walking.robot import Robot
from walking.robot_parameters import RobotParameters

# Strides of most gaits agree to 0.03% from the second on. Robots whose strides do not agree to
# SETTLED do not repeat themselves, and are simulated for longer.
CYCLES, LONGER, SETTLED = 3, 8, 2e-3
SETTLED_IN_SPACE = 0.02  # where loads, and with them strides, hang on micrometres
SPREAD_CYCLES = 2  # of other robots
FRICTION = (0.7, 1.3)  # times the friction of the ground
PARAMETERS = 0.1  # share by which parameters are others
DRAWS = 4  # of other parameters
MOST_TILT = np.deg2rad(60.0)
NO_LOAD = 1e-3  # of the weight, on a foot that carries nothing
LOWEST = 2e-3  # m, of a corner of a body that is on the ground
DOUBT = 0.01  # of the planned stride, by which strides in MuJoCo and in Drake may differ
LEAST_MADE = 0.5  # of the planned stride, of gaits that are taken
DRAKE, MUJOCO = "Drake in steps of 1 ms", "MuJoCo"


def check_gait(gait: Gait, cycles: int = CYCLES, spread: bool = True, seed: int = 0) -> Gait:
    """Simulate a gait with contact, open loop, and return it with its check.

    In a plane, a gait whose strides in simulation agree from the second on, but miss the planned
    one by more than 1%, gets their travel, if it is at least half of that planned.

    The simulation begins with the heat of the limit cycle. A gait that walks as planned in MuJoCo
    is simulated by Drake with steps of 1 ms, for a cycle; for as many as in MuJoCo if strides
    there are within 1% of what is still accepted. For the spread, two cycles each are simulated in
    MuJoCo with 0.7 and 1.3 times the friction of the ground, and with four draws of the
    parameters. In each draw the stiffness of each limb, and the cooling, heating and torque of its
    wires, are 10% larger or smaller.

    Args:
        gait: as planned; whether it passed is then its ``passed``.
        cycles: number of cycles of the robot as it is; eight if strides after the first differ
            by more than 0.2% of the planned one.
        spread: whether to simulate it with other friction and parameters, too.
        seed: seed of the draws.
    """
    first = simulate_gait(gait, "", gait.robot, cycles, longer=LONGER)
    strides = np.array(first.strides)
    made = float(np.mean(strides[1:])) if len(strides) > 1 and not first.fall else 0.0
    if not gait.in_space and made >= LEAST_MADE and abs(made - 1) > DOUBT:
        gait = _with_stride(gait, made)
        strides /= made
        first.strides = strides.tolist()
    check = dataclasses.replace(gait.check, simulation=first, spread=[], checked_by=MUJOCO)
    misses = np.abs(strides - 1).max(initial=0.0)
    is_close = not first.fall and abs(misses - check.tolerance) < DOUBT
    if check.failure() and not is_close:
        return dataclasses.replace(gait, check=check)
    # Let Drake decide.
    check.simulation = simulate_gait(
        gait, "", gait.robot, len(strides) if is_close else 1, simulated=simulate_in_drake
    )
    check.checked_by = f"{DRAKE} for {len(check.simulation.strides)} of the cycles, {MUJOCO}"
    if spread and not check.failure():
        few = min(cycles, SPREAD_CYCLES)
        varied = variations(gait.robot, seed)
        check.spread = [dataclasses.replace(first, what="as planned, in MuJoCo")]
        check.spread += [simulate_gait(gait, what, robot, few) for what, robot in varied]
    return dataclasses.replace(gait, check=check)


def _with_stride(gait: Gait, share: float) -> Gait:
    """Return a gait in the plane whose body travels a share of its way; its feet slide the rest."""
    pose = gait.body_pose.copy()
    pose[0] += (share - 1) * gait.stride * gait.time / gait.period
    check = dataclasses.replace(gait.check, made=share * gait.check.made)
    return dataclasses.replace(gait, body_pose=pose, check=check)


def variations(robot: RobotParameters, seed: int = 0) -> list[tuple[str, RobotParameters]]:
    """What is varied, and the robots, of `check_gait`."""
    rng = np.random.default_rng(seed)
    varied = [(f"friction x {factor:g}", with_friction(robot, factor)) for factor in FRICTION]
    for number in range(1, DRAWS + 1):
        other = with_other_parameters(robot, rng)
        varied.append((f"parameters +-{PARAMETERS:.0%}, draw {number}", other))
    return varied


def with_friction(robot: RobotParameters, factor: float) -> RobotParameters:
    """Return a copy of the robot with the ground's friction multiplied by a factor."""
    robot = copy.deepcopy(robot)
    assert robot.ground is not None  # of robots that walk
    robot.ground.friction *= factor
    return robot


def with_other_parameters(robot: RobotParameters, rng: np.random.Generator) -> RobotParameters:
    """A robot with stiffness and wires' laws that are 10% larger or smaller, per limb."""
    robot, either = copy.deepcopy(robot), [1 - PARAMETERS, 1 + PARAMETERS]
    for limb in robot.limbs:
        a1, a2, beta = rng.choice(either, 3)
        factors = {"a1": a1, "a2": a2, "beta": beta, "full_torque": beta}
        scale_limb(limb.parameters, rng.choice(either), factors)
    return robot


def scale_limb(limb: LimbParameters, stiffness: float, of_laws: Mapping[str, float]) -> None:
    """Multiply a limb's stiffness, and fields of its wires' laws as far as these have them."""
    for segment in limb.segments:
        segment.stiffness *= stiffness
        for wire, (field, factor) in itertools.product(segment.wires, of_laws.items()):
            if hasattr(wire.law, field):
                setattr(wire.law, field, getattr(wire.law, field) * factor)


def simulate_gait(
    gait: Gait,
    what: str,
    robot: RobotParameters,
    cycles: int,
    *,
    longer: int = 0,
    simulated: Callable[[Gait, RobotParameters, int], Recording] = simulate_in_mujoco,
) -> GaitVariation:
    """Simulate cycles of a gait's duty on a robot, which begins with the gait's first knot.

    Args:
        longer: number of cycles, if there are more, where the strides do not agree by the end.
        simulated: `simulate_in_mujoco` or `simulate_in_drake`.
    """
    try:
        recording = simulated(gait, robot, cycles)
    except SimulationError as error:
        return GaitVariation(what, fall=str(error).rstrip("."))
    assert recording.wire_temperature is not None
    fall, time = fall_of(recording, gait)
    completed = min(cycles, int(time / gait.period + 1e-6))
    strides, aside = strides_of(recording, gait, completed)
    changes = np.abs(np.diff(strides[1:])).max(initial=0.0)  # the first one is still settling
    settled = SETTLED_IN_SPACE if gait.in_space else SETTLED
    if not fall and cycles < longer and changes > settled:
        return simulate_gait(gait, what, robot, longer, simulated=simulated)
    return GaitVariation(
        what,
        strides=strides.tolist(),
        aside=aside.tolist() if gait.in_space else [],
        highest_temperature=float(recording.wire_temperature.max()),
        fall=fall,
    )


def simulate_in_drake(gait: Gait, robot: RobotParameters, cycles: int) -> Recording:
    """Simulate cycles as `simulate_in_mujoco`, by Drake's SAP contact in steps of 1 ms."""
    duration = cycles * gait.period + PERIOD  # with a sample after the last stride
    duty = gait.duty_trajectory(cycles)
    return simulate(Robot(robot), duty, duration, initial_state=gait.initial_state)


def strides_of(
    recording: Recording, gait: Gait, cycles: int, start: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the travel of the body in each cycle (cycles,), as shares of the planned stride.

    Args:
        start: when the first cycle begins, s.

    Returns:
        What it went along what was planned, turn included, and what aside of it.
    """
    assert recording.body_pose is not None
    ends = start + gait.period * np.arange(cycles + 1)
    pose = np.unwrap(recording.body_pose, axis=1)
    return gait.progress(np.array([np.interp(ends, recording.time, row) for row in pose]))


def fall_of(recording: Recording, gait: Gait, start: float = 0.0) -> tuple[str, float]:
    """Return how a robot that walks falls, in words, and when, s; "" and the end if it does not.

    A robot has fallen when its body tilts by more than 60° or touches the ground. It has fallen,
    too, when a foot that does not swing in the gait carries nothing for half a period; this is
    checked where the forces are known, and not of four or more feet in space, of which any three
    can stand. The first cycle of the gait begins at ``start``, s.
    """
    assert recording.body_pose is not None
    body, times = gait.robot.body, recording.time
    height, upright = _height_and_upright(recording.body_pose)
    sizes = np.array([body.length, body.width, body.height])
    lowest = height - 0.5 * sizes @ np.abs(upright)
    falls = [
        (
            upright[2] < np.cos(MOST_TILT),
            f"its body tilts by more than {np.rad2deg(MOST_TILT):.0f}°",
        ),
        (lowest < LOWEST, "its body comes to the ground"),
    ]
    phases = np.searchsorted([p.start for p in gait.phases], (times - start) % gait.period, "right")
    size = gait.robot.force_size
    weight = gait.contact_force[size - 1 :: size].sum(axis=0).mean()
    forces = recording.contact_force
    loads = () if forces is None or _spare_feet(gait) else forces[size - 1 :: size]
    seen = list(zip(gait.robot.limbs, loads, strict=False))
    for limb, (named, force) in enumerate(seen):
        swings = np.array([phase.contacts[limb] == "swing" for phase in gait.phases])[phases - 1]
        idle = (force < NO_LOAD * weight) & ~swings & (times >= start)
        samples = round(0.5 * gait.period * recording.sample_rate)
        within = np.convolve(idle, np.ones(samples))[: len(idle)]
        falls.append(
            (within > samples - 0.5, f"its {named.name} foot carries nothing for half a period")
        )
    first = [(int(np.argmax(there)), words) for there, words in falls if there.any()]
    if not first:
        return "", float(times[-1])
    index, words = min(first)
    return f"{words} after {times[index] - start:.1f} s", float(times[index])


def _spare_feet(gait: Gait) -> bool:
    """Whether the robot may stand on fewer feet than it has: on three in space."""
    return gait.in_space and len(gait.robot.limbs) > 3


def _height_and_upright(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height of the body (K,), m, and how much its x, y and z point up (3, K), of its poses."""
    if len(pose) == 3:
        return pose[1], np.stack([np.sin(pose[2]), 0 * pose[2], np.cos(pose[2])])
    roll, pitch = pose[3:5]
    across = np.cos(pitch) * np.stack([np.sin(roll), np.cos(roll)])
    return pose[2], np.vstack([-np.sin(pitch), across])
