"""Logs as labs write them, of emulated limbs that a lab's program drives.

Each is in the form of a lab's logger, with its quirks, and comes with the truth about its columns:
here of two limbs of shape-memory wires in series, watched by a camera, and of its successor with
pneumatic limbs; in `lab_tables` of anybody's tables. `lab_door` reads them all; tests take some.
"""

import dataclasses
import functools
import io
import os
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: a process for each core

import numpy as np
import witness  # noqa: F401 (its physics)
from pydrake.trajectories import PiecewisePolynomial

from hardware import LimbTwin
from limb_systems import LimbParameters, simulate
from limb_systems.files.output import write_atomically

RATE = 20.0  # Hz, of what is known of a limb
STEP = 0.5  # s, of a lab's programs
HOTTEST = 100.0  # °C, to which labs drive their limbs at most
DAY = 86_400_000  # ms
LENGTH = 0.094  # m, of each of two limbs in series
TAGS = range(101, 110)  # four links on each limb, and one tag where the second begins
SPACING = np.array([77, 64, 65, 73, 77, 65, 56, 60]) / 537  # of the tags, of the whole length
SIDES = ("left", "right")
CACHE = Path(__file__).parents[1] / "build" / "lab_logs"


@dataclasses.dataclass(frozen=True)
class Drive:
    """The duty, readings and true joint angles of an emulated limb, at 20 Hz.

    - ``time`` (K,), s; ``duty``, ``temperature`` (2, K), left and right, °C as thermocouples read.
    - ``bend`` (K,): as its bend sensor read it, φ, rad.
    - ``joints`` (n, K): the truth, rad.
    """

    time: np.ndarray
    duty: np.ndarray
    temperature: np.ndarray
    bend: np.ndarray
    joints: np.ndarray

    def at(self, times: np.ndarray) -> np.ndarray:
        """Return indices of the samples that a logger finds at some times, s."""
        return np.clip((times * RATE + 1e-6).astype(int), 0, len(self.time) - 1)


def program(kind: str, seed: int, duration: float, wires: Sequence[int] = (0, 1)) -> np.ndarray:
    """Return duty as labs program it, (2, K) for steps of 0.5 s: with pauses, each wire in turn.

    "pulses" fall in steps of a second and have long pauses, "steps" hold levels, "ramps" rise
    and fall, "bang-bang" switches, "dance" does all of it in haste, and "motion" swings.
    """
    draw = np.random.default_rng([seed, sum(map(ord, kind))])
    duty = np.zeros((2, int(duration / STEP)))
    if kind == "motion":
        periods = draw.uniform([17, 50], [25, 70])
        swing = np.array([0.3, 0.15]) @ np.sin(
            np.outer(2 * np.pi * STEP / periods, range(duty.shape[1]))
        )
        for wire in wires:
            duty[wire] = np.maximum(swing * (2 * wire - 1), 0.0)
        return duty
    at = 4
    turn = int(draw.integers(2))
    while kind != "rest" and at < duty.shape[1] - 20:
        pattern = str(draw.choice(["pulses", "steps", "ramps"])) if kind == "dance" else kind
        level = draw.choice([0.2, 0.25, 0.3])
        if pattern == "pulses":
            course = 2 * level * np.repeat([1, 0.9, 0.85, 0.7, 0.55, 0.4, 0.3, 0.15], 2)
        elif pattern == "steps":
            course = np.repeat(level, draw.integers(14, 36))
        elif pattern == "ramps":
            course = level * np.concatenate([np.linspace(0, 1.3, 30), np.linspace(1.3, 0, 16)])
        else:
            course = np.tile(np.repeat([2 * level, 0.0], [5, 12]), draw.integers(3, 6))
        course = np.round(course, 2)[: duty.shape[1] - at - 4]
        which = wires[turn % len(wires)]
        duty[which, at : at + len(course)] = course
        if draw.uniform() < 0.25 and len(wires) > 1:  # the other one holds against it
            duty[1 - which, at : at + len(course)] = np.round(0.5 * course, 2)
        longest = {"pulses": 120, "dance": 8}.get(kind, 50)
        at = at + len(course) + int(draw.integers(2, longest + 1))
        turn = turn + 1
    return duty


@functools.lru_cache(maxsize=64)
def drive(
    seed: int,
    physics: str,
    kind: str,
    duration: float,
    length: float = LENGTH,
    wires: tuple[int, ...] = (0, 1),
) -> Drive:
    """Drive a new limb by a `program`; a file keeps the result, as a continuum limb is slow."""
    name = f"{physics}_{seed}_{kind}_{duration:g}_{length:g}_{''.join(map(str, wires))}.npz"
    if (path := CACHE / "drives" / name).is_file():
        return Drive(**np.load(path))
    description = LimbParameters()
    description.segments[0].length = length
    planned = program(kind, seed, duration, wires)
    hottest = np.random.default_rng([5, seed]).uniform(80, HOTTEST)
    for _ in range(4):  # which a lab tries before it writes a log
        duty = np.round(np.minimum(planned, 1.0), 2)
        breaks = STEP * np.arange(duty.shape[1] + 1)
        held = PiecewisePolynomial.ZeroOrderHold(breaks, np.column_stack([duty, duty[:, -1]]))
        limb = LimbTwin(description, seed=seed, physics=physics, truth=True)
        shown = simulate(limb, held, sample_rate=RATE)
        rise = shown.measured_temperature.max() - shown.measured_temperature.min()
        if not duty.any() or abs(rise / (hottest - 25.0) - 1) < 0.07:
            break
        planned = planned * (hottest - 25.0) / rise
    joints = shown.joint_state[: limb.parameters.num_joints]
    signals = (shown.time, shown.duty, shown.measured_temperature, shown.bend_angle[0], joints)
    done = Drive(*signals)
    packed = io.BytesIO()
    np.savez_compressed(packed, **dataclasses.asdict(done))
    write_atomically(path, packed.getvalue())
    return done


@dataclasses.dataclass(frozen=True)
class Truth:
    """The meaning of a log's columns, of one limb, as a mapping states it.

    - ``times``: columns of time that are right, and their units, the best one first.
    - ``wires``: for left and right the columns of duty and temperature, what full duty is, and
      the temperature's unit; a wire that is not there is left out.
    - ``bend``: column, degrees that one unit is, what they measure, and the number that stands
      for 0; no column for tags.
    - ``drive``: arguments of `drive` of the limb behind it.
    """

    times: tuple[tuple[str, str], ...]
    wires: dict[str, tuple[str, str, float, str]]
    bend: tuple[str, float, str, float]
    drive: tuple[Any, ...]


@dataclasses.dataclass(frozen=True)
class Log:
    """A log as a file, and the truth about each of its limbs; none if it has no heated limb."""

    name: str
    content: bytes
    truths: tuple[Truth, ...] = ()


def tags(joints: Sequence[np.ndarray], draw: np.random.Generator) -> np.ndarray:
    """Return pixels (K, 9, 2) of tags on limbs in series by their joint angles, x right, y down.

    Limbs are bent at rest, the camera is turned, and it may see them from below.
    """
    at = np.append(0.0, np.cumsum(SPACING))
    fine = np.linspace(0.0, 1.0, 401)
    direction = np.zeros((len(fine), joints[0].shape[1]))
    heading = 0.0
    for index, angles in enumerate(joints):
        part = (fine >= index / 2) & (fine <= (index + 1) / 2)
        middles = np.append(0.0, (np.arange(len(angles)) + 0.5) / len(angles))
        turned = np.vstack([0 * angles[:1], np.cumsum(angles, axis=0)])
        along = 2 * fine[part] - index
        bent = np.deg2rad(draw.uniform(-30, 30)) * along[:, None]
        cells = np.clip(np.searchsorted(middles, along) - 1, 0, len(angles) - 1)
        share = (along - middles[cells]) / (middles[cells + 1] - middles[cells])
        direction[part] = (
            heading + bent + turned[cells] + share[:, None] * np.diff(turned, axis=0)[cells]
        )
        heading = direction[part][-1]
    direction = draw.choice([-1, 1]) * direction + draw.uniform(-0.6, 0.6)
    steps = np.stack([np.cos(direction), np.sin(direction)], axis=-1) / (len(fine) - 1)
    line = np.cumsum(steps, axis=0)[np.round(at * (len(fine) - 1)).astype(int)]
    pixels = 540 * line + draw.uniform([30, 40], [60, 250])
    return np.moveaxis(pixels, 0, 1) + draw.normal(0.0, 0.15, (pixels.shape[1], len(TAGS), 2))


def logger_head(draw: np.random.Generator, start: int, arrays: bool, nested: bool) -> list[str]:
    """Return the lines before the header: a date, ms into its day, and settings as in Python."""
    pairs = dict.fromkeys(("kp", "ki", "setpoint"), "array([{}, {}])" if arrays else "[{}, {}]")
    settings = ["'duty_min': -0.8", "'duty_max': 0.8", "'ctrl_period': 200", "'numsteps': 100.0"]
    settings += [
        f"'{n}': {form.format(*draw.uniform(0, 0.01, 2).round(5))}" for n, form in pairs.items()
    ]
    settings += ["'temp_constraint': [115.0, 115.0]", "'trajfilepath': None", "'read_u_traj': True"]
    if nested:
        rows = ",\n       ".join(f"[{a}., {b}., 0.]" for a, b in draw.integers(0, 9, (4, 2)))
        several = ", ".join(f"{{'gain': [{k}, {{'low': ({k}, None)}}]}}" for k in range(40))
        settings += [f"'K': array([{rows}])".replace("\n", ""), f"'stages': [{several}]"]
    clock = (datetime(2023, 4, 5) + timedelta(milliseconds=start)).strftime("%H%M%S")
    started = f"2023-{draw.integers(1, 13)}-{draw.integers(1, 29)}_{clock}"
    return [f"ezloophw-py logger started on:,{started}", f"ctrl_params:,{{{', '.join(settings)}}}"]


def two_limbs(
    seed: int,
    *,
    physics: str = "continuum",
    kind: str = "pulses",
    duration: float = 208.0,
    rate: float = 5.0,
    heated: Sequence[int] = (0, 1),
    swapped: bool = False,
    forward: Sequence[str] = ("right", "right"),
    flex: bool = False,
    camera: bool = True,
    midnight: bool = False,
    arrays: bool = False,
    nested: bool = False,
) -> Log:
    """Return a log of two limbs in series as `ezloophw-py` writes it: 37 columns below settings.

    Args:
        heated: limbs that are heated.
        swapped: whether thermocouples are not where they were in 2023.
        forward: wire of each limb that ``fwd`` heats.
        flex, camera: whether the flex sensors and the camera show anything.
        midnight: whether it runs over midnight.
        arrays, nested: of the settings, see `logger_head`.
    """
    draw = np.random.default_rng([1, seed])
    kinds = [kind if limb in heated else "rest" for limb in (0, 1)]
    arguments = [(2 * seed + limb, physics, kinds[limb], duration) for limb in (0, 1)]
    drives = [drive(*a) for a in arguments]
    count = int(duration * rate) - 2
    times = _irregular(count, rate, draw)
    rows = drives[0].at(times)
    start = DAY - 60_000 if midnight else int(draw.integers(30_000_000, 70_000_000))
    stamps = (start + np.round(1000 * np.append(0.0, times[1:] + 1 / rate)).astype(int)) % DAY
    duty = {
        (limb, way): drives[limb].duty[SIDES.index(forward[limb]) ^ (way == "rev")][rows]
        for limb in (0, 1)
        for way in ("fwd", "rev")
    }
    places = {(0, "rev"): 0, (0, "fwd"): 1, (1, "rev"): 3, (1, "fwd"): 2}
    if swapped:
        places = dict(zip(places, draw.permutation(4).tolist(), strict=True))
    held = rows[np.arange(count) // 3 * 3]  # thermocouples are slow to read
    readings = np.empty((4, count))
    for (limb, way), place in places.items():
        wire = SIDES.index(forward[limb]) ^ (way == "rev")
        readings[place] = np.round(drives[limb].temperature[wire][held] * 16) / 16
    names = ["Timestamp (millisec since midnight today)", "Test time"]
    columns: list[Sequence[Any]] = [stamps, [f"{t:.6f}" for t in times]]
    for before in ("pwm_duty_limb", "unconstrained_pwm_duty_lim"):
        for (limb, way), values in duty.items():
            limited = (before[0] == "u") & (values > 0) & (readings.max(axis=0) > 80)
            names.append(f"{before}{limb}_{way}")
            columns.append([f"{v:.6f}" for v in values + 0.2 * limited])
    for limb in (0, 1):
        names.append(f"u_setpoint_limb{limb}")
        columns.append([f"{v:.6f}" for v in duty[limb, "fwd"] - duty[limb, "rev"]])
    names += ["temp_limit", "Bendlabs_0", "Bendlabs_1", *(f"MCPtemp_{i}" for i in range(4))]
    signs = draw.choice([-1, 1], 2)
    alpha = [
        sign * np.rad2deg(2 * d.bend[rows]) * flex for sign, d in zip(signs, drives, strict=True)
    ]
    columns += [["115.000000"] * count, *(np.round(a, 2) + 0.0 for a in alpha)]
    columns += [np.round(r, 2) for r in readings]
    pixels = tags([d.joints[:, rows] for d in drives], draw) * camera
    pixels[:6] = 0.0
    pixels[6, draw.permutation(9)[:4]] = 0.0
    pixels[-3:] = pixels[-4]  # the last picture stays
    names += [f"tagid_{axis}_{tag}" for tag in TAGS for axis in "xy"]
    columns += list(pixels.reshape(count, -1).T)
    lines = [*logger_head(draw, start, arrays, nested), ",".join(names)]
    lines += [
        ",".join(map(str, row))
        for row in zip(*map(np.ndarray.tolist, map(np.asarray, columns)), strict=True)
    ]
    truths = []
    for limb in heated:
        wires = {}
        for way in ("fwd", "rev"):
            side = SIDES[SIDES.index(forward[limb]) ^ (way == "rev")]
            wires[side] = (f"pwm_duty_limb{limb}_{way}", f"MCPtemp_{places[limb, way]}", 1.0, "C")
        bend = ("", 0.0, "", 0.0)
        if flex:
            bend = (f"Bendlabs_{limb}", float(signs[limb]), "tip_tangent", 0.0)
        truths.append(Truth(((names[0], "ms"), (names[1], "s")), wires, bend, arguments[limb]))
    return Log(f"two_limbs_{seed}", "\n".join([*lines, ""]).encode(), tuple(truths))


def _irregular(count: int, rate: float, draw: np.random.Generator) -> np.ndarray:
    """Return times of a logger of that rate (count,), s, of which the first two are 0."""
    late = np.round(draw.normal(0, 0.0015, count).clip(-0.004, 0.004), 3)
    times = np.maximum((np.arange(count) - 1) / rate + late, 0.0)
    times[:2] = 0.0
    return np.round(times, 3)


def pneumatic(seed: int) -> Log:
    """Return a log of the successor: valves, pressures, and half of each limb's angle."""
    draw = np.random.default_rng([2, seed])
    count = 900
    start = int(draw.integers(30_000_000, 70_000_000))
    times = _irregular(count, 10.0, draw)
    swing = np.sin(2 * np.pi * np.outer([0.05, 0.08], times)) * (times > 2)
    angles = 18 * swing + draw.normal(0, 0.1, swing.shape)  # degrees, of the chord
    names = ["Timestamp (millisec since midnight today)", "Test time"]
    columns = [start + np.round(1000 * times).astype(int), times]
    pushes = [np.maximum(sign * s, 0) for s in swing for sign in (1, -1)]
    for form, values in (
        ("u_t({})", list(3 * swing)),
        ("ValveOpening_{}", [np.round(p, 3) for p in pushes]),
        ("MPRpressure_{}", [14.6 + 3 * p + draw.normal(0, 0.01, count) for p in pushes]),
        ("FILpressure_{}", [14.6 + 3 * p for p in pushes]),
        ("theta_{}", list(angles)),
    ):
        names += [form.format(i) for i in range(len(values))]
        columns += values
    for tag in TAGS:
        names += [f"tagid_x_{tag}", f"tagid_y_{tag}", f"tagid_rotation{tag}"]
        turned = 2 * angles[int(tag > 105)] * (tag - 101) / 8
        columns += [50 + 60 * (tag - 101) + 0 * times, 200 + turned, turned]
    for column in columns[-3 * len(TAGS) :]:
        column[:6] = 0.0
    lines = [*logger_head(draw, start, True, True), ",".join(names)]
    lines += [",".join(map(str, row)) for row in zip(*(c.tolist() for c in columns), strict=True)]
    return Log(f"pneumatic_{seed}", "\n".join([*lines, ""]).encode())
