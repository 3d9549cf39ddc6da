"""The board's fault table on many emulated limbs, and false alarms in ordinary use.

Everything is in simulated time: the firmware's own files, an emulated board and
limb, and a host that goes on commanding whatever happens. It is an emulation,
not a measurement of wires. It takes some hours; Ctrl-C shows what there is.

    python benchmarks/board_faults.py faults [--limbs 50] [--fitted] [--other] [--wires 4]
    python benchmarks/board_faults.py ordinary [--limbs 50] [--jobs 2]
    python benchmarks/board_faults.py feedback [--limbs 50] [--jobs 2]

``faults`` prints for each fault the share of runs in which a wire got
above 130 °C, the hottest, and the time until the board was off; for a fault
that it bears, the duty goes on. The fault is there from the beginning, or comes
while the wire is hot. Half of the runs are with three times the noise of the
emulated thermocouples. The board has the bounds of the described kind, or those
fitted to a warm-up with the good thermocouple; limbs are emulated ones, or of
another physics, those of other_limbs.py. With more than two wires they bend about two axes.

``ordinary`` collects, calibrates, plans, replays and teaches on each limb, every
other one with three times the noise, and counts what switched off.

``feedback`` calibrates each limb, plans Fig. 5 for feedback, and lets every controller
follow the plan while a sensor lies for 20 s. It prints the hottest that a wire truly
became, before and behind the board, how often the board was off for what, and by how much
the bend was off that without a fault, while the sensor lied and from 4 s after on.
"""

import argparse
import contextlib
import copy
import functools
import itertools
import random
import sys
import time
from collections.abc import Callable

import numpy as np
from other_limbs import OtherLimb
from pydrake.systems.framework import LeafSystem
from sensor_faults import SensorFault, with_faulty_sensors
from simulated_board import SimulatedBoard

from calibration import calibrate, collect_equilibria, collect_from_twin
from calibration.collecting.collect import collect_warm_up
from calibration.collecting.measurement_protocol import WARM_UP_MARGIN
from calibration.heat_bounds_fit import fit_heat_bounds
from hardware import LimbTwin, replay
from hardware.board.reasons import REASONS
from hardware.emulation.sensors import THERMOCOUPLE_NOISE
from hardware.emulation.specimen import Specimen
from hardware.firmware import guard
from limb_systems import (
    LimbModel,
    LimbParameters,
    LimbSystem,
    Recording,
    Trajectory,
    bend_angle_from_tip_tangent,
    simulate,
)
from limb_systems.drake_python import declare_part
from planners import Task, plan, references
from soft_limb.runs.jobs import run_each
from soft_limb.runs.rollout import CONTROLLERS, OPEN, controller_of

STEP = 25  # ms, between two passes of the firmware's loop, a slow one
DUTIES = (0.1, 0.3, 0.5, 1.0)
NOISES = (1, 3)  # times that of the emulated thermocouples
HOTTEST = 130.0  # °C, true, that no wire should pass
WARM_TIME = 10.0  # s of the duty before a fault comes
LONGEST = 30.0  # s with the fault; by then the most that a wire can have was reached
SIDES = ("left", "right")
FROM_BEGINNING, WHEN_HOT = "from the beginning", "when hot"

SLOW = references.from_samples([0.0, 15.0, 30.0, 60.0], np.deg2rad([0.0, 12.0, -12.0, 5.0]))

# Orders of `Emulation.misbehave`, where {side} is the heated wire's.
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
    """Fault, when, duty, noise and limb of each run, of faults whose name contains the part."""
    jobs = []
    for fault, when in itertools.product(FAULTS, (FROM_BEGINNING, WHEN_HOT)):
        if part not in fault or (when == WHEN_HOT and not FAULTS[fault]):
            continue
        duties = DUTIES if when == FROM_BEGINNING else (0.3, 1.0)
        duties = (0.3,) if fault in WITHOUT_DUTY else duties
        jobs += list(itertools.product((fault,), (when,), duties, NOISES, range(limbs)))
    return sorted(jobs, key=lambda job: job[-1])


def prepare(board: SimulatedBoard, noise: int) -> None:
    """Adds noise to the thermocouples, and waits until the board can be armed."""
    for name in board.parameters.wire_names:
        extra = THERMOCOUPLE_NOISE * np.sqrt(noise**2 - 1)
        board.emulation.misbehave(f"jitter {name} {extra}")
    board.run(1.0)


@functools.cache
def with_fitted_bounds(make: Callable[..., LimbSystem], seed: int) -> LimbParameters:
    """A limb's parameters with the bounds that its warm-up shows."""
    limb = make(seed=seed)
    set_bounds(limb.parameters, [collect_warm_up(limb)], WARM_UP_MARGIN)
    return limb.parameters


def set_bounds(limb: LimbParameters, recordings: list[Recording], margin: float) -> None:
    """Gives wires the bounds that recordings show."""
    for wire, bounds in zip(limb.wires, fit_heat_bounds(recordings, limb, margin), strict=True):
        wire.heat_bounds = bounds


def run_fault(
    job: tuple[str, str, float, int, int], fitted: bool = False, other: bool = False, wires: int = 2
) -> dict:
    """One run; what became of it."""
    fault, when, duty, noise, seed = job
    random.seed(repr(job))
    wire = seed % wires
    make = OtherLimb if other else LimbTwin
    parameters = with_fitted_bounds(make, seed) if fitted else None
    limb = make(seed=seed) if wires == 2 else LimbTwin(LimbParameters.in_space(wires), seed=seed)
    board = SimulatedBoard(limb, parameters, step=STEP)
    orders = [order.format(side=board.parameters.wire_names[wire]) for order in FAULTS[fault]]
    duties = [duty * (wire == other or not orders) for other in range(wires)]
    if when == FROM_BEGINNING:
        for order in orders:
            board.emulation.misbehave(order)
    prepare(board, noise)
    hottest = -np.inf
    armed = board.arm()
    if armed and when == WHEN_HOT:
        for _ in range(round(WARM_TIME)):
            board.run(1.0, duties)
        for order in orders:
            board.emulation.misbehave(order)
        armed = board.newest.armed  # it may have been too hot already
    start, off = board.now, None
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
        reasons = sorted({r["reason"] for r in runs} - {guard.NONE})
        print(
            f"{fault:<38}{when:<20}{np.mean([h > HOTTEST for h in hot] or [0]):>6.0%}"
            f"{max(hot, default=np.nan):>9.1f}{max(times, default=np.nan):>11.2f}"
            f"{1 - len(times) / len(runs):>7.0%}  {', '.join(map(str, reasons))}"
        )


# For feedback: orders to the board, or what a sensor shows the controller
# alone, of the time since, the reading, that before and a random number.
LYING, MENDED = 20.0, 40.0  # s, from the start of the plan
RIGHT, BEND = 1, 2
FEEDBACK_FAULTS = {
    "none": None,
    "bend sensor frozen": "freeze bend",
    "bend sensor stuck, with noise": "stick bend",
    "bend sensor drifts by 1°/s": (BEND, lambda t, y, before, noise: y + np.deg2rad(t)),
    "bend sensor reads 15° too much": (BEND, lambda t, y, before, noise: y + np.deg2rad(15.0)),
    "bend sensor reads 45° too much": (BEND, lambda t, y, before, noise: y + np.deg2rad(45.0)),
    "bend sensor absent": (BEND, lambda t, y, before, noise: np.nan),
    "thermocouple frozen": "freeze right",
    "thermocouple reads 10 °C too little": "offset right -10",
    "thermocouple reads 19 °C too little": "offset right -19",
    "thermocouple drifts by -0.5 °C/s": "drift right -0.5",
    "thermocouple has come off": "detach right",
    "thermocouple absent": (RIGHT, lambda t, y, before, noise: np.nan),
}


class SimulatedRobot(LeafSystem):
    """A `SimulatedBoard` with the ports of `Limb`, armed, as a limb of a diagram."""

    __slots__ = ()
    real_time, accuracy = False, 1e-2
    PERIOD = 0.05  # s

    def __init__(self, board: SimulatedBoard, parameters: LimbParameters):
        super().__init__()
        self.board, self.parameters, self.source = board, parameters, "emulated limb on its board"
        self.reduced, self.hottest = 0.0, -np.inf
        self.orders: list[tuple[float, str]] = []  # s, from when on, and what; in their order
        wires, angles = len(parameters.wires), LimbModel.of(parameters).layout.num_bends
        self.DeclareVectorInputPort("duty", wires)
        state = self.DeclareDiscreteState(2 * wires + angles)
        self.DeclareInitializationDiscreteUpdateEvent(self._read)
        self.DeclarePeriodicDiscreteUpdateEvent(self.PERIOD, 0.0, self._update)
        for name, part in (
            ("measured_temperature", slice(0, wires)),
            ("bend_angle", slice(wires, wires + angles)),
            ("applied_duty", slice(wires + angles, 2 * wires + angles)),
        ):
            declare_part(self, name, state, part)
        # As a robot's recordings have it, so that calibration counts the duty that was applied.
        self.DeclareVectorOutputPort(
            "sample_age", 1, lambda context, output: output.SetFromVector([0.0])
        )

    def _update(self, context, state):
        while self.orders and self.orders[0][0] <= context.get_time():
            self.board.emulation.misbehave(self.orders.pop(0)[1])
        duty = np.clip(self.get_input_port().Eval(context), 0.0, 1.0)
        self.board.run(self.PERIOD, duty)
        self.hottest = max(self.hottest, self.board.emulation.board.wire_temperature().max())
        self.reduced += self.PERIOD * bool(np.sum(self.board.duty) < np.sum(duty) - 0.02)
        self._read(context, state)

    def _read(self, context, state):
        sample = self.board.samples[-1]
        bends = bend_angle_from_tip_tangent(sample.tip_tangent)
        state.set_value([*sample.temperature, *bends, *sample.duty])


def run_ordinary(job: tuple[int, int]) -> dict:
    """A limb from its first collection to its plans, on one board; what switched off."""
    seed, noise = job
    random.seed(repr(job))
    twin = LimbTwin(seed=seed)
    parameters = twin.parameters
    board = SimulatedBoard(twin, step=STEP)
    prepare(board, noise)
    alarms: list[str] = []
    heated, reduced, hottest = 0.0, {"collect": 0.0, "plan": 0.0}, 0.0

    def drive(what, run, parameters):
        nonlocal heated, hottest
        if not board.arm():
            alarms.append(f"{what}: not armed: {REASONS[board.reason]}")
            return None
        robot, start = SimulatedRobot(board, parameters), board.now
        result = run(robot)
        heated += board.now - start
        reduced[what] += robot.reduced
        hottest = max(hottest, board.emulation.board.wire_temperature().max())
        if not board.newest.armed:
            alarms.append(f"{what}: {REASONS[board.reason]}")
            board.clear()
        return result

    def outcome() -> dict:
        return {
            "job": job,
            "hours": board.now / 3600,
            "alarms": alarms,
            "reduced": reduced,
            "heated": heated,
            "hottest": hottest,
        }

    warm_up = drive("collect", collect_warm_up, parameters)
    assert warm_up
    set_bounds(parameters, [warm_up], WARM_UP_MARGIN)
    board.use(parameters)
    board.run(240.0)
    recordings = {}
    for number, kind in enumerate(("left", "right", "both")):
        recordings[kind] = [
            drive(
                "collect",
                lambda robot, kind=kind, number=number: collect_equilibria(
                    robot, kind, seed=number
                ),
                parameters,
            )
        ]
        board.run(240.0)
    if None in (group[0] for group in recordings.values()):
        return outcome()
    calibrated = calibrate(recordings, method="paper").parameters
    board.use(calibrated)
    for reference in 2 * [references.step_and_decaying_sine(), SLOW]:
        trajectory = plan(calibrated, reference)
        drive("plan", lambda robot, t=trajectory: simulate(robot, t.duty_trajectory(), t.duration),
              calibrated)  # fmt: skip
        board.run(180.0)
    board.run(300.0)  # teaching: by hand, with the wires off
    if board.newest.latched:
        alarms.append(f"teach: {REASONS[board.reason]}")
    return outcome()


def print_ordinary(results: list[dict]) -> None:
    hours = sum(r["hours"] for r in results)
    heated = sum(r["heated"] for r in results) / 3600
    alarms = [(r["job"], alarm) for r in results for alarm in r["alarms"]]
    print(f"{hours:.1f} h on {len({r['job'][0] for r in results})} limbs, {heated:.1f} h armed")
    print(f"false alarms: {len(alarms)}")
    for job, alarm in alarms:
        print(f"  limb {job[0]}, noise x {job[1]}: {alarm}")
    for what in ("collect", "plan"):
        times = [r["reduced"][what] for r in results]
        print(f"duty reduced in {what}: {np.mean(times):.1f} s a limb, at most {max(times):.1f} s")
    print(f"hottest wire at the end of a run: {max(r['hottest'] for r in results):.1f} °C")


def calibrated_limb(seed: int) -> tuple[Specimen, LimbParameters]:
    """A limb, rested after it was calibrated, and what calibration found."""
    twin = LimbTwin(seed=seed)
    parameters = calibrate(collect_from_twin(twin, seed=seed)).parameters
    return twin.again(300.0).specimen, parameters


def run_feedback(seed: int) -> list[dict]:
    """A limb with all controllers and faults."""
    specimen, parameters = calibrated_limb(seed)
    trajectory = plan(
        parameters, references.step_and_decaying_sine(), task=Task.closed_loop(parameters)
    )
    return [
        result
        for name in CONTROLLERS
        if name != OPEN
        for result in run_feedback_faults(specimen, trajectory, name)
    ]


def run_feedback_faults(specimen: Specimen, trajectory: Trajectory, name: str) -> list[dict]:
    """A limb and a controller with all faults; what became of it."""
    results, good = [], None
    for fault, what in FEEDBACK_FAULTS.items():
        random.seed(repr((fault, name, specimen.seed)))
        board = SimulatedBoard(
            LimbTwin(specimen=copy.deepcopy(specimen)), trajectory.parameters, step=STEP
        )
        prepare(board, 1)
        controller = controller_of(name, trajectory)
        robot = SimulatedRobot(board, trajectory.parameters)
        if isinstance(what, str):
            robot.orders = [(LYING, what), (MENDED, "mend")]
        elif what:
            controller = with_faulty_sensors(controller, SensorFault(*what, LYING, MENDED))
        armed = board.arm()
        recording = replay(trajectory, robot, controller=controller)
        good = good or recording
        off = np.rad2deg(np.abs(recording.bend_angle - good.bend_angle))[0]
        lying = (recording.time > LYING) & (recording.time <= MENDED)
        results.append(
            {
                "controller": name,
                "fault": fault,
                "hottest": robot.hottest,
                "reason": board.emulation.firmware.guard.reason if armed else "not armed",
                "lying": off[lying].max(),
                "after": off[recording.time > MENDED + 4.0].max(),
                "reduced": robot.reduced,
            }
        )
    return results


def print_feedback(results: list[list[dict]]) -> None:
    runs = [run for limb in results for run in limb]
    print(f"{len(results)} limbs")
    print(
        "controller  fault                                hottest °C   bend off by, °: lying  "
        "after   reduced s   board off"
    )
    for name, fault in itertools.product(CONTROLLERS, FEEDBACK_FAULTS):
        these = [run for run in runs if (run["controller"], run["fault"]) == (name, fault)]
        if not these:
            continue
        ended = [run for run in these if run["reason"] != guard.NONE]
        went_on = [run for run in these if run["reason"] == guard.NONE]
        lying, after = (
            f"{max((run[key] for run in went_on), default=np.nan):.1f}"
            for key in ("lying", "after")
        )
        reasons = ", ".join(sorted({REASONS.get(r["reason"], r["reason"]) for r in ended}))
        print(
            f"{name:<12}{fault:<37}{max(run['hottest'] for run in these):>10.1f}"
            f"{lying:>25}{after:>7}{max(run['reduced'] for run in these):>12.1f}"
            f"   {len(ended)} of {len(these)} {reasons}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("faults", "ordinary", "feedback"))
    parser.add_argument("--limbs", type=int, default=50)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--fitted", action="store_true", help="bounds are fitted to a warm-up")
    parser.add_argument("--other", action="store_true", help="limbs are of another physics")
    parser.add_argument("--wires", type=int, default=2, help="of each limb, for faults")
    parser.add_argument("--fault", help="only faults whose name contains this")
    options = parser.parse_args()
    start = time.perf_counter()
    jobs: list
    if options.what == "faults":
        run = functools.partial(
            run_fault, fitted=options.fitted, other=options.other, wires=options.wires
        )
        show = print_faults
        jobs = fault_jobs(options.limbs, options.fault or "")
    elif options.what == "feedback":
        run, show = run_feedback, print_feedback
        jobs = list(range(options.limbs))
    else:
        run, show = run_ordinary, print_ordinary
        jobs = [(seed, NOISES[seed % 2]) for seed in range(options.limbs)]
    results = []
    with contextlib.suppress(KeyboardInterrupt):  # which shows what there is
        for number, result in enumerate(run_each(run, jobs, options.jobs), 1):
            results.append(result)
            for alarm in result.get("alarms", ()) if isinstance(result, dict) else ():
                print(f"\nlimb {result['job'][0]}: {alarm}", file=sys.stderr)
            print(f"\r{number} of {len(jobs)} runs", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    show(results)
    print(f"{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
