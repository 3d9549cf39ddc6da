"""Limbs from their first contact to replays, some with a thermocouple that is wrong from then on.

Each limb stands behind the emulated board with the firmware's own files, in simulated time, is
described as the nominal limb, and goes through `soft-limb arm-check`, `collect` (first contact,
warm-up, equilibria), `calibrate` and replays of two plans. Limbs are `LimbTwin`, of both of its
physics, and `other_limbs.OtherLimb`. A share is that of its rise which the thermocouple of
one wire shows. Printed are, for each limb, what arm-check and the first contact said, why the board
switched off, the highest reading and true temperature of each step, and for how long the board
reduced the duty in replays. It is an emulation, not a measurement of wires.

    python benchmarks/first_day.py [--family other] [--shares 1.0 0.6] [--limbs 8] [--jobs 2]
"""

import argparse
import copy
import functools
import itertools
import os
import random
import sys
import types
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: a process for each core

import numpy as np
from board_faults import SIDES, SLOW, STEP, SimulatedRobot, prepare, set_bounds
from other_limbs import OtherLimb
from simulated_board import SimulatedBoard

from calibration import calibrate, collect_equilibria
from calibration.collecting.collect import (
    collect_first_contact,
    collect_warm_up,
    for_first_contact,
)
from calibration.collecting.measurement_protocol import CONTACT_MARGIN, WARM_UP_MARGIN
from calibration.heat_bounds_fit import check_first_contact, heat_remarks
from hardware import LimbTwin
from hardware.board.arm_check import check_wires
from hardware.board.link import Sample
from hardware.board.reasons import REASONS
from limb_systems import LimbError, LimbParameters, simulate
from planners import plan, references
from soft_limb.runs.jobs import run_each

PAUSE = 180.0  # s without heat before each recording
FAMILIES = {
    "twin": functools.partial(LimbTwin, extra=["memory", "bond"]),
    "continuum": functools.partial(LimbTwin, physics="continuum"),
    "other": OtherLimb,
}
HOTTEST = 130.0  # °C, true, that no wire should pass


class SimulatedLink:
    """What `check_wires` needs of a `BoardLink`, at a `SimulatedBoard`."""

    port = "simulated"

    def __init__(self, board: SimulatedBoard):
        self._board, self.hottest = board, -np.inf

    def info(self):
        channels, angles = self._board.duty, self._board.samples[-1].tip_tangent
        return types.SimpleNamespace(
            serial_number="simulated",
            firmware_version="",
            channels=len(channels),
            angles=len(angles),
        )

    def next_sample(self) -> Sample:
        count = len(self._board.samples)
        while len(self._board.samples) == count:
            self._board.run(0.025)
        self.hottest = max(self.hottest, *self._board.emulation.board.wire_temperature())
        return self._board.samples[-1]

    def arm(self, bounds, total_duty: float = 1.5) -> None:
        parameters = copy.deepcopy(self._board.parameters)
        parameters.total_duty = total_duty
        for wire, bound in zip(parameters.wires, bounds, strict=True):
            wire.heat_bounds = bound
        self._board.use(parameters)
        if not self._board.arm():
            raise LimbError(f"not armed: {REASONS[self._board.reason]}")

    def command(self, duty) -> None:
        if not self._board.newest.armed:
            raise LimbError(f"switched off: {REASONS[self._board.reason]}")
        self._board.command(duty)

    def disarm(self) -> None:
        self._board.send(4)
        self._board.run(0.06)


def take(job: tuple[str, int, float]) -> dict:
    """A limb through all steps, or until one of them says that a thermocouple is wrong."""
    family, seed, share = job
    random.seed(repr(job))
    limb = FAMILIES[family](seed=seed)
    described = LimbParameters()
    board = SimulatedBoard(limb, described, step=STEP)
    result: dict = {"job": job, "found": [], "steps": {}, "reduced": 0.0, "replayed": 0.0}
    if share != 1.0:
        board.emulation.misbehave(f"share {SIDES[seed % 2]} {share}")
    prepare(board, 1)

    def note(step: str, V: float, T: float) -> None:
        before = result["steps"].get(step, (0.0, 0.0))
        result["steps"][step] = (max(before[0], V), max(before[1], T))

    def drive(step, run, parameters):
        board.run(PAUSE)
        board.use(parameters)
        if not board.arm():
            result["found"].append(f"{step}: not armed: {REASONS[board.reason]}")
            return None
        robot, first = SimulatedRobot(board, parameters), len(board.samples)
        recording = run(robot)
        note(step, max(s.temperature.max() for s in board.samples[first:]), robot.hottest)
        if not board.newest.armed:
            result["found"].append(f"{step}: {REASONS[board.reason]}")
            board.clear()
        if step == "replay":
            result["reduced"] += robot.reduced
            result["replayed"] += recording.time[-1]
        return recording

    link = SimulatedLink(board)
    try:
        check_wires(link, lambda good, what: good or result["found"].append(f"arm-check: {what}"))
    except LimbError as error:
        result["found"].append(f"arm-check: {error}")
        board.clear()
    note("arm-check", 0.0, link.hottest)

    recordings = []
    known = described
    for step, run, margin in (
        ("first contact", collect_first_contact, CONTACT_MARGIN),
        ("warm-up", collect_warm_up, WARM_UP_MARGIN),
    ):
        recordings.append(drive(step, run, known if recordings else for_first_contact(described)))
        if recordings[-1] is None:
            return result
        if step == "first contact":
            try:
                check_first_contact(recordings[-1], described, Path("first_contact.csv"))
            except LimbError as error:
                result["found"].append(f"{step}: {error}")
                return result
            result["remarks"] = heat_remarks(recordings, described)
        known = LimbParameters()
        set_bounds(known, recordings, margin)
    held: dict = {}
    for number, kind in enumerate(("right", "left", "both")):
        held[kind] = [
            drive(
                "collect",
                lambda robot, k=kind, n=number: collect_equilibria(robot, k, seed=n, num_angles=4),
                known,
            )
        ]
        if held[kind][0] is None:
            return result
    try:
        calibrated = calibrate(held, described, method="paper").parameters
        result["bounds"] = [str(wire.heat_bounds) for wire in calibrated.wires]
        for reference in (references.step_and_decaying_sine(), SLOW):
            trajectory = plan(calibrated, reference)
            drive(
                "replay",
                lambda robot, t=trajectory: simulate(robot, t.duty_trajectory(), t.duration),
                calibrated,
            )
    except LimbError as error:
        result["found"].append(f"calibrate and plan: {error}")
    return result


def show(result: dict) -> None:
    family, seed, share = result["job"]
    temperatures = ", ".join(f"{step} {V:.0f}/{T:.0f}" for step, (V, T) in result["steps"].items())
    print(f"{family} {seed}, share {share:g}: V/T °C {temperatures}", end="")
    print(f"; reduced for {result['reduced']:.0f} of {result['replayed']:.0f} s in replays")
    for sentence in result["found"] + result.get("remarks", []):
        print(f"    {sentence}")
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--family", nargs="*", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--shares", nargs="*", type=float, default=[1.0])
    parser.add_argument("--limbs", type=int, default=8)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.limbs)
    jobs = [
        (family, seed, share)
        for seed, share, family in itertools.product(seeds, options.shares, options.family)
    ]
    results = []
    for result in run_each(take, jobs, options.jobs):
        results.append(result)
        show(result)
    for family, share in itertools.product(options.family, options.shares):
        these = [r for r in results if (r["job"][0], r["job"][2]) == (family, share)]
        hottest = [max(T for _, T in r["steps"].values()) for r in these]
        highest = max(V for r in these for V, _ in r["steps"].values())
        caught = [r["found"][0].split(":")[0] for r in these if r["found"]]
        print(
            f"{family}, share {share:g}: {len(these)} limbs, {len(caught)} found "
            f"({', '.join(f'{step} {caught.count(step)}' for step in dict.fromkeys(caught))}); "
            f"V up to {highest:.1f} °C, T up to {max(hottest):.1f} °C, "
            f"{sum(T > HOTTEST for T in hottest)} above {HOTTEST:g} °C"
        )


if __name__ == "__main__":
    main()
