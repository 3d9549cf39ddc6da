"""The check of gaits: simulated with contact as planned, and where robot or ground are others."""

import copy
import dataclasses
import itertools
import os
import pickle
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed

import numpy as np

from limb_systems import LimbParameters, Recording, simulate
from limb_systems.limb_parameters import ParameterError
from limb_systems.progress import Progress
from limb_systems.simulation import PERIOD, SimulationError
from walking.gait import Gait, GaitVariation
from walking.robot import TIME_STEP, Robot
from walking.robot_parameters import RobotParameters

# Strides of most gaits agree to 0.03% from the second on. Robots whose strides do not agree to
# SETTLED do not repeat themselves, and are simulated for longer.
CYCLES, LONGER, SETTLED = 3, 8, 2e-3
SETTLED_IN_SPACE = 0.02  # where loads, and with them strides, hang on micrometres
SPREAD_CYCLES = 2  # of other robots
SPREAD_STEP = 4e-3  # s, of their mechanics: strides are 1% shorter, in a quarter of the time
FRICTION = (0.7, 1.3)  # times the friction of the ground
PARAMETERS = 0.1  # share by which parameters are others
DRAWS = 4  # of other parameters
MOST_TILT = np.deg2rad(60.0)
NO_LOAD = 1e-3  # of the weight, on a foot that carries nothing
LOWEST = 2e-3  # m, of a corner of a body that is on the ground
PROGRAM = "from walking.gait_check import answer; answer()"


def check_gait(gait: Gait, cycles: int = CYCLES, spread: bool = True, seed: int = 0) -> Gait:
    """Simulate a gait with contact, open loop, and return it with its check.

    The simulation begins with the heat of the limit cycle. For the spread, two cycles each are
    simulated with 0.7 and 1.3 times the friction of the ground, and with four draws of the
    parameters. In each draw the stiffness of each limb, and the cooling, heating and torque of its
    wires, are 10% larger or smaller. Each simulation has a process of its own; as many run at once
    as there are cores.

    Args:
        gait: as planned; whether it passed is then its ``passed``.
        cycles: number of cycles of the robot as it is; eight if strides after the first differ
            by more than 0.2% of the planned one.
        spread: whether to simulate it with other friction and parameters, too.
        seed: seed of the draws.
    """
    jobs: list[tuple] = [("", gait.robot, cycles, TIME_STEP, LONGER)]
    if spread:
        few = min(cycles, SPREAD_CYCLES)
        jobs += [(what, robot, few, SPREAD_STEP) for what, robot in variations(gait.robot, seed)]
        found = _simulate_all(gait, jobs)
    else:
        found = [simulate_gait(gait, *jobs[0])]
    check = dataclasses.replace(gait.check, simulation=found[0], spread=found[1:])
    return dataclasses.replace(gait, check=check)


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
    step: float = TIME_STEP,
    longer: int = 0,
) -> GaitVariation:
    """Some cycles of a gait's duty on a robot, which begins with the gait's first knot.

    Args:
        step: step of the mechanics, s; 1 ms if the limbs are too stiff for it.
        longer: number of cycles, if there are more, where the strides do not agree by the end.
    """
    try:
        system = Robot(robot, time_step=step)
    except ParameterError:
        system = Robot(robot)
    duration = cycles * gait.period + PERIOD  # with a sample after the last stride
    try:
        recording = simulate(
            system, gait.duty_trajectory(cycles), duration, initial_state=gait.initial_state
        )
    except SimulationError as error:
        return GaitVariation(what, fall=str(error).rstrip("."))
    assert recording.wire_temperature is not None
    fall, time = fall_of(recording, gait)
    completed = min(cycles, int(time / gait.period + 1e-6))
    strides, aside = strides_of(recording, gait, completed)
    changes = np.abs(np.diff(strides[1:])).max(initial=0.0)  # the first one is still settling
    settled = SETTLED_IN_SPACE if gait.in_space else SETTLED
    if not fall and cycles < longer and changes > settled:
        return simulate_gait(gait, what, robot, longer, step)
    return GaitVariation(
        what,
        strides=strides.tolist(),
        aside=aside.tolist() if gait.in_space else [],
        highest_temperature=float(recording.wire_temperature.max()),
        fall=fall,
    )


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


def _simulate_all(gait: Gait, jobs: list) -> list[GaitVariation]:
    """The variations of some jobs, each the further arguments of `simulate_gait`."""
    total = sum(job[2] for job in jobs)
    # Processes get their work as text: scripts need not be imported again in them, as
    # they would be by those of `multiprocessing`.
    with (
        ThreadPoolExecutor(os.cpu_count()) as pool,
        Progress("checking the gait", total, "cycles") as progress,
    ):
        futures = [pool.submit(_in_process, pickle.dumps((gait, *job))) for job in jobs]
        done = 0
        for future in as_completed(futures):
            done += jobs[futures.index(future)][2]
            progress.update(done)
            if futures[0].done():
                nominal = futures[0].result()
                if dataclasses.replace(gait.check, simulation=nominal).failure():
                    pool.shutdown(wait=False, cancel_futures=True)
                    return [nominal]  # it is no gait, and has no spread
    return [future.result() for future in futures]


def _in_process(job: bytes) -> GaitVariation:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], input=job, capture_output=True, check=False
    )
    if done.returncode:
        raise SimulationError("The process that simulates the gait ended before it was done.")
    return pickle.loads(done.stdout)


def answer() -> None:
    """Simulates the job on standard input, and writes its variation to standard output."""
    variation = simulate_gait(*pickle.load(sys.stdin.buffer))
    sys.stdout.buffer.write(pickle.dumps(variation))
