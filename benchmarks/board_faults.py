"""The board's fault table on many emulated limbs.

Everything is in simulated time: the firmware's own files, an emulated board and
limb, and a host that goes on commanding whatever happens. It is an emulation,
not a measurement of wires. It takes some hours; Ctrl-C shows what there is.

    python benchmarks/board_faults.py [--limbs 50] [--fitted] [--other] [--wires 4]

It prints for each fault the share of runs in which a wire got
above 130 °C, the hottest, and the time until the board was off; for a fault
that it bears, the duty goes on. The fault is there from the beginning, or comes
while the wire is hot. Half of the runs are with three times the noise of the
emulated thermocouples. The board has the bounds of the described kind, or those
fitted to a warm-up with the good thermocouple; limbs are emulated ones, or of
the physics "continuum". With more than two wires they bend about two axes.
"""

import argparse
import contextlib
import functools
import itertools
import random
import sys
import time
from collections.abc import Mapping

import numpy as np
import witness  # noqa: F401 (its physics)
from simulated_board import SimulatedBoard

from calibration.collecting.collect import collect_warm_up
from calibration.collecting.measurement_protocol import WARM_UP_MARGIN
from calibration.heat_bounds_fit import fit_heat_bounds
from hardware import LimbTwin
from hardware.emulation.sensors import THERMOCOUPLE_NOISE
from hardware.firmware import guard
from limb_systems import LimbParameters, Recording
from soft_limb.runs.jobs import run_each

STEP = 25  # ms, between two passes of the firmware's loop, a slow one
DUTIES = (0.1, 0.3, 0.5, 1.0)
NOISES = (1, 3)  # times the noise of the emulated thermocouples
HOTTEST = 130.0  # °C, true, that no wire should pass
WARM_TIME = 10.0  # s of the duty before a fault comes
LONGEST = 30.0  # s with the fault; by then the most that a wire can have was reached
SIDES = ("left", "right")
FROM_BEGINNING = "from the beginning"
WHEN_HOT = "when hot"

# Orders of `Emulation.inject_fault`, where {side} is the heated wire's.
FAULTS = {
    "thermocouple has come off": ["detach {side}"],
    "thermocouple reversed": ["reverse {side}"],
    "thermocouple reads 30% of the rise": ["share {side} 0.3"],
    "thermocouple reads 60% of the rise": ["share {side} 0.6"],
    "thermocouple reads 19 °C too little": ["offset {side} -19"],
    "thermocouple drifts by -0.5 °C/s": ["drift {side} -0.5"],
    "thermocouple frozen": ["freeze {side}"],
    "thermocouple open": ["open {side}"],
    "half of the heat arrives": ["weaken 0.5"],
    "no heat arrives": ["weaken 0"],
    "MOSFET shorted": ["short {side}"],
    "bend sensor stuck, with noise": ["stick bend"],
    "bend sensor frozen": ["freeze bend"],
    "clock stands still": ["stop clock"],
    "supply gives 30% more heat": ["weaken 1.3"],
    "supply gives 50% more heat": ["weaken 1.5"],
    "30% more heat, 80% of the rise read": ["weaken 1.3", "share {side} 0.8"],
    "100% more heat, 60% of the rise read": ["weaken 2", "share {side} 0.6"],
    "MOSFET shorted, 60% of the rise read": ["short {side}", "share {side} 0.6"],
    "amplifiers read 20 °C too little": ["chill 20"],
    "no fault, all wires hot": [],
}


# Faults whose detection has nothing to do with duty, which are tried at one.
WITHOUT_DUTY = ("thermocouple open", "bend sensor frozen", "clock stands still")


def fault_jobs(limbs: int, part: str) -> list[tuple[str, str, float, int, int]]:
    """Return fault, when, duty, noise and limb of each run, of faults by a part of their name."""
    jobs = []
    for fault, when in itertools.product(FAULTS, (FROM_BEGINNING, WHEN_HOT)):
        if part not in fault or (when == WHEN_HOT and not FAULTS[fault]):
            continue
        duties = DUTIES if when == FROM_BEGINNING else (0.3, 1.0)
        duties = (0.3,) if fault in WITHOUT_DUTY else duties
        jobs += list(itertools.product((fault,), (when,), duties, NOISES, range(limbs)))
    return sorted(jobs, key=lambda job: job[-1])


def prepare(board: SimulatedBoard, noise: int) -> None:
    """Add noise to the thermocouples, and wait until the board can be armed."""
    for name in board.parameters.wire_names:
        extra = THERMOCOUPLE_NOISE * np.sqrt(noise**2 - 1)
        board.emulation.inject_fault(f"jitter {name} {extra}")
    board.run(1.0)


def with_fitted_bounds(physics: str, seed: int) -> LimbParameters:
    """Return a limb's parameters with the bounds that its warm-up shows."""
    limb = LimbTwin(seed=seed, physics=physics)
    set_bounds(limb.parameters, [collect_warm_up(limb)], WARM_UP_MARGIN)
    return limb.parameters


def set_bounds(limb: LimbParameters, recordings: list[Recording], margin: float) -> None:
    """Give wires the bounds that recordings show."""
    for wire, bounds in zip(limb.wires, fit_heat_bounds(recordings, limb, margin), strict=True):
        wire.heat_bounds = bounds


def run_fault(
    job: tuple[str, str, float, int, int],
    physics: str = "lumped",
    wires: int = 2,
    fitted: Mapping[int, LimbParameters] | None = None,
) -> dict:
    """Run a fault once, and return its result.

    Args:
        fitted: parameters with bounds that were fitted, by seed; bounds of the kind if None.
    """
    fault, when, duty, noise, seed = job
    random.seed(repr(job))
    wire = seed % wires
    parameters = fitted[seed] if fitted else None
    described = LimbParameters() if wires == 2 else LimbParameters.in_space(wires)
    limb = LimbTwin(described, seed=seed, physics=physics)
    board = SimulatedBoard(limb, parameters, step=STEP)
    orders = [order.format(side=board.parameters.wire_names[wire]) for order in FAULTS[fault]]
    duties = [duty * (wire == other or not orders) for other in range(wires)]
    if when == FROM_BEGINNING:
        for order in orders:
            board.emulation.inject_fault(order)
    prepare(board, noise)
    hottest = -np.inf
    armed = board.arm()
    if armed and when == WHEN_HOT:
        for _ in range(round(WARM_TIME)):
            board.run(1.0, duties)
        for order in orders:
            board.emulation.inject_fault(order)
        armed = board.newest.armed  # it may have been too hot already
    start = board.now
    off = None
    while armed and board.now < start + LONGEST:
        board.run(0.05, duties)
        hottest = max(hottest, board.emulation.board.wire_temperature().max())
        if not any(board.duty) and board.emulation.firmware.guard.state == guard.DISARMED:
            off = board.duties[-1][0] - start
            break
    for _ in range(100 if off is not None else 0):  # it may go on to warm
        board.run(0.05, duties)
        hottest = max(hottest, board.emulation.board.wire_temperature().max())
    return {
        "job": job,
        "hottest": hottest,
        "off": off if armed else 0.0,
        "armed": armed,
        "reason": board.emulation.firmware.guard.reason,
    }


def print_faults(results: list[dict]) -> None:
    print(f"{'fault':<38}{'when':<20}hotter  hottest  off after  never  why")
    for fault, when in itertools.product(FAULTS, (FROM_BEGINNING, WHEN_HOT)):
        runs = [r for r in results if r["job"][:2] == (fault, when)]
        if not runs:
            continue
        times = [r["off"] for r in runs if r["off"] is not None]
        hot = [r["hottest"] for r in runs if r["armed"]]
        reasons = sorted({r["reason"] for r in runs} - {guard.NO_REASON})
        print(
            f"{fault:<38}{when:<20}{np.mean([h > HOTTEST for h in hot] or [0]):>6.0%}"
            f"{max(hot, default=np.nan):>9.1f}{max(times, default=np.nan):>11.2f}"
            f"{1 - len(times) / len(runs):>7.0%}  {', '.join(map(str, reasons))}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--limbs", type=int, default=50)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--fitted", action="store_true", help="bounds are fitted to a warm-up")
    parser.add_argument("--other", action="store_true", help="limbs are a continuum")
    parser.add_argument("--wires", type=int, default=2, help="of each limb")
    parser.add_argument("--fault", help="only faults whose name contains this")
    options = parser.parse_args()
    start = time.perf_counter()
    physics = "continuum" if options.other else "lumped"
    fitted = {}
    for seed in range(options.limbs if options.fitted else 0):
        fitted[seed] = with_fitted_bounds(physics, seed)
    run = functools.partial(run_fault, physics=physics, wires=options.wires, fitted=fitted)
    jobs = fault_jobs(options.limbs, options.fault or "")
    results = []
    with contextlib.suppress(KeyboardInterrupt):  # which shows what there is
        for number, result in enumerate(run_each(run, jobs, options.jobs), 1):
            results.append(result)
            print(f"\r{number} of {len(jobs)} runs", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print_faults(results)
    print(f"{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
