"""Commands of robots and emulated limbs: runs along plans, teaching, and checks of the board."""

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from serial.tools import list_ports

from controllers.learner import Repetition
from hardware import BoardInfo, BoardLink, LimbTwin, ReplayError, Sample, SerialLimb, watch
from hardware.board import board_check
from hardware.board.arm_check import check_supply, check_wires
from hardware.board.link import SerialPort, check_fit
from hardware.emulation.emulator import ORDERS, emulate
from hardware.emulation.specimen import emulated_limb
from hardware.emulation.twin import EmulatedSystem
from hardware.live_feed import DONE, LiveView, Reading, RunHeader, board_reading
from limb_systems import (
    Limb,
    LimbError,
    LimbModel,
    LimbParameters,
    LimbSystem,
    Trajectory,
    bend_angle_from_tip_tangent,
)
from limb_systems.connected_limbs import ConnectedLimbs, connected
from limb_systems.files.output import check_outputs
from limb_systems.simulation import PERIOD
from limb_systems.summary import Summary
from limb_systems.views.panels import tracking_panels
from planners.plan_check import far_from_reference
from planners.references import from_samples
from soft_limb.commands.options import (
    TASK_HELP,
    Command,
    Option,
    checked_outputs,
    live_page,
    print_summary,
    save_panels,
    say_duration,
    shared,
)
from soft_limb.reports.plan_report import write_rollout_report
from soft_limb.results.summaries import repetitions_summary, troubles
from soft_limb.runs import repetitions
from soft_limb.runs.cooling import cool_down
from soft_limb.runs.plan_run import FOLLOWED, NAMED, reference_from_file, task_named, teach_and_go
from soft_limb.runs.rollout import NEAREST, Rollout, roll_out

if TYPE_CHECKING:  # Bokeh takes long to import
    from soft_limb.live_page import LivePage

SIMULATED = 20.0  # times real time, about, of an emulated limb on an idle computer
LONGEST_LESSON = 3600.0  # s, that a hand moves a limb


def _serial_ports() -> Summary:
    """Return the serial ports of this computer."""
    texts = {port.device: port.description for port in list_ports.comports()}
    values = [{"port": name, "description": text} for name, text in texts.items()]
    nothing = {"ports": "no serial ports; is the board plugged in?"}
    return Summary.of(texts or nothing, {"ports": values})


def _status(options: argparse.Namespace) -> int:
    if options.port is None:
        if options.clear or options.live:
            raise LimbError("--clear and --live need the PORT of a board.")
        print_summary(options, _serial_ports())
        return 0
    limb = LimbParameters.of(options.limb)
    with BoardLink(options.port, limb) as link:
        info = link.info()
        if options.clear:
            link.clear()
        print_summary(options, _state(info, link.sample(), limb))
        with live_page(options) as live:
            if live:
                check_fit(limb, info, options.port)
                _show_board(link, info, limb, live)
    return 0


def _state(info: BoardInfo, sample: Sample, limb: LimbParameters) -> Summary:
    bends = np.rad2deg(bend_angle_from_tip_tangent(sample.tip_tangent)).tolist()
    names = limb.wire_names
    if len(names) != info.channels:  # of another limb
        names = [f"wire {number + 1}" for number in range(info.channels)]
    read = [
        f"{name} {V:.2f} °C" if np.isfinite(V) else f"{name} has no reading"
        for name, V in zip(names, sample.temperature, strict=True)
    ]
    most = [f"{name} at most {T:.0f} °C" for name, T in zip(names, sample.warmest, strict=True)]
    texts = {
        "board": f"{info.serial_number}, firmware {info.firmware_version}",
        "state": "armed" if sample.armed else f"off: {sample.reason_text}",
        "last reset": info.reset_cause,
        "wires": f"{', '.join(read)}; off at {info.temperature_limit:g} °C",
        "heat": f"{', '.join(most)}, by their duty",
        "bend angle": ", ".join(f"{bend:.1f}°" for bend in bends),
    }
    values = {
        "serial_number": info.serial_number,
        "firmware_version": info.firmware_version,
        "temperature_limit_c": info.temperature_limit,
        "armed": sample.armed,
        "reason": sample.reason_text,
        "reset_cause": info.reset_cause,
        "highest_temperature_c": sample.warmest.tolist(),
        "measured_temperature_c": sample.temperature.tolist(),
        "bend_angle_deg": bends[0] if len(bends) == 1 else bends,
        "duty": sample.duty.tolist(),
    }
    return Summary.of(texts, values)


def _show_board(link: BoardLink, info: BoardInfo, limb: LimbParameters, live: LiveView) -> None:
    """Shows a board, which is not armed, until a signal comes."""
    live.say("State of the board; this program does not arm it")
    live.begin(RunHeader(f"board {info.serial_number}", limb, info.temperature_limit))
    start = time.monotonic()
    while True:
        sample = link.sample()
        live.show(
            Reading(
                time.monotonic() - start,
                bend_angle_from_tip_tangent(sample.tip_tangent).tolist(),
                sample.temperature.tolist(),
                sample.duty.tolist(),
                board=board_reading(link),
            )
        )
        time.sleep(PERIOD)


def _say(options: argparse.Namespace, outcome: str, what: str) -> None:
    """Prints what came of a check at once, unless all is printed as JSON in the end."""
    if not options.json:
        print(f"{outcome:<9}{what}", flush=True)


def _arm_check(options: argparse.Namespace) -> int:
    checks = []
    parameters = LimbParameters.of(options.limb)

    def say(good: bool, what: str) -> None:
        checks.append({"passed": good, "what": what})
        _say(options, "ok" if good else "FAILED", what)

    voltage, cut_off = _supply(options)
    passed = check_supply(parameters, voltage, cut_off, say)
    if passed:
        with BoardLink(options.port, parameters) as link:
            passed = check_wires(link, say, parameters)
    if options.json:
        print_summary(options, Summary.of({}, {"passed": passed, "checks": checks}))
    return 0 if passed else 1


def _ask(question: str) -> str:
    """What a person types at the terminal; nothing at its end, Ctrl-D."""
    print(question, end="", flush=True)
    return sys.stdin.readline().strip()


def _supply(options: argparse.Namespace) -> tuple[float | None, bool | None]:
    """Return the supply's voltage, V, and whether there is a cut-off; None where nobody answers."""
    voltage, cut_off = options.supply, options.cut_off
    if sys.stdin.isatty() and not options.json:
        if voltage is None:
            said = _ask("Measured voltage of the wires' supply, V (Enter: not measured, no heat): ")
            try:
                voltage = float(said) if said else None
            except ValueError:
                raise LimbError(f"{said!r} is no voltage; measure it, and say it as 7.0.") from None
        if cut_off is None:
            said = _ask("A thermal cut-off on the limb, in series with its wires, y or n? ")
            cut_off = said.lower() in ("y", "yes")
    return voltage, cut_off


def _board_check(options: argparse.Namespace) -> int:
    checks, outcomes = [], (board_check.PASSED, board_check.FAILED, board_check.NOT_RUN)
    words = dict(zip(outcomes, ("ok", "FAILED", "not run"), strict=True))

    def say(result: board_check.Outcome) -> None:
        case, section = result.case, f"docs/protocol.md#{result.case.section}"
        checks.append(
            {
                "name": case.name,
                "rule": case.rule,
                "section": section,
                "outcome": result.outcome,
                "what": result.details,
            }
        )
        _say(
            options, words[result.outcome], case.name + f": {result.details}" * bool(result.details)
        )
        if result.outcome == board_check.FAILED:
            _say(options, "", f"rule: {case.rule} {section}")

    with SerialPort(options.port) as cable:
        board_check.check_board(board_check.Host(cable, LimbParameters.of(options.limb)), say)
    counts = {outcome: sum(check["outcome"] == outcome for check in checks) for outcome in outcomes}
    if options.json:
        values = {outcome.replace(" ", "_"): count for outcome, count in counts.items()}
        print_summary(options, Summary.of({}, {**values, "checks": checks}))
    else:
        print(", ".join(f"{outcome} {count}" for outcome, count in counts.items()))
    return 1 if counts[board_check.FAILED] else 0


def _replay(options: argparse.Namespace) -> int:
    outputs = checked_outputs(options, options.trajectory)
    trajectory = Trajectory.load(options.trajectory)
    with live_page(options) as live:
        if live:
            live.say(f"Replay of {options.trajectory}, controller {options.controller}")
        rollout = roll_out(
            trajectory,
            lambda: _limb(trajectory.parameters, options),
            options.output,
            controller=options.controller,
            real_time=bool(options.port),
            live=live,
        )
        summary = rollout.summary()
        save_panels(tracking_panels(trajectory, [rollout.recording]), options.plot)
        if options.report:
            data = {"plan": options.trajectory, "recording": options.output}
            write_rollout_report(rollout, summary, options.report, data)
        print_summary(options, summary, outputs)
        _end(live, rollout, options)
    return 1 if rollout.recording.interrupted else 0  # an emulated limb's that cut out


def _end(live: "LivePage | None", rollout: Rollout, options: argparse.Namespace) -> None:
    """Ends a page, if there is one, when the wires have cooled as the command was asked."""
    if live:
        if rollout.limb:
            cool_down(rollout.limb, rollout.recording, live, options.cool_down)
        live.end(rollout.recording.interrupted or DONE)


def _limb(planned: LimbParameters, options: argparse.Namespace) -> LimbSystem:
    """The robot on a port, the model of the plan, or an emulated limb."""
    if options.port:
        return SerialLimb(options.port, planned)
    return Limb(planned) if options.model else _twin(planned, options)


def _twin(planned: LimbParameters, options: argparse.Namespace) -> LimbTwin:
    """The emulated limb that a plan is for, which must not be another than the one asked for."""
    board = emulated_limb(planned.board)
    if board and options.emulated not in (None, board.seed):
        raise ReplayError(
            f"This trajectory was planned with the calibration of the emulated limb {board.seed}, "
            f"not {options.emulated}; calibrate that one, or leave --emulated out."
        )
    twin = LimbTwin.of(planned, options.emulated or 0)
    if twin.specimen.around_calibrated:
        warnings.warn(
            "This plan's limb was not calibrated on an emulated one, so that an unrelated emulated "
            f"limb, seed {twin.specimen.seed}, follows the plan here, and its errors say nothing "
            "about yours; --model takes the calibrated model as the limb, -p PORT the robot.",
            stacklevel=2,
        )
    return twin


def _follow(options: argparse.Namespace) -> int:
    outputs = [options.output / name for name in FOLLOWED]
    inputs = [Path(options.reference), options.limb, options.task and Path(options.task)]
    check_outputs(outputs, inputs=inputs, force=options.force)
    limb = LimbParameters.of(options.limb)
    task = options.task and task_named(options.task, limb)
    with live_page(options) as live:
        rollout, summary = teach_and_go(
            options.reference,
            lambda planned: _limb(planned, options),
            options.output,
            limb=limb,
            task=task,
            knot_rate=options.knot_rate,
            smoothing_time=options.smooth,
            controller=options.controller,
            real_time=bool(options.port),
            live=live,
        )
        print_summary(options, summary, outputs)
        _end(live, rollout, options)
    return 1 if rollout.recording.interrupted else 0


def _learn(options: argparse.Namespace) -> int:
    if options.repetitions < 1:
        raise ReplayError(f"--repetitions is {options.repetitions}; it must be 1 or more.")
    trajectory, folder = Trajectory.load(options.trajectory), options.output
    learner = repetitions.learner_in(folder, trajectory, force=options.force)
    if far := far_from_reference(trajectory):
        warnings.warn(far, stacklevel=1)

    def say(number: int, repetition: Repetition) -> None:
        if options.json:
            return
        distance, error = np.rad2deg([repetition.reference_distance, repetition.mean_error])
        said = [f"as read mean |φ_ref - φ| {distance:.2f}°, |φ* - φ| {error:.2f}°"]
        said += filter(None, [repetition.interrupted, repetition.remark])
        print(f"repetition  {number}: {'; '.join(said)}", flush=True)

    count = options.repetitions
    each = f"{count} repetition{'s' * (count > 1)} of {trajectory.duration:g} s"
    if options.port:
        say_duration(f"{each}, and rests of some minutes, until the wires are cool")
    elif options.live:
        say_duration(f"{each}, in real time")
    else:
        about = count * trajectory.duration / SIMULATED
        say_duration(f"about {max(1.0, about):.0f} s for {each}")
    limbs: Callable[[], LimbSystem]
    try:
        with live_page(options) as live:
            if options.port:
                limbs = repetitions.rested_robots(options.port, trajectory, live)
            elif options.model:
                limbs = lambda: Limb(trajectory.parameters)  # noqa: E731 - before any heat
            else:
                twin = _twin(trajectory.parameters, options)
                limbs = repetitions.rested_twins(twin, trajectory, learner)
            repetitions.repeat(learner, limbs, options.repetitions, folder, tell=say, live=live)
    except LimbError:
        repetitions.draw_repetitions(learner, folder)
        raise
    drawn = repetitions.draw_repetitions(learner, folder)
    written = [folder / repetitions.STATE, folder / repetitions.LEARNED, *drawn]
    print_summary(options, repetitions_summary(learner), written)
    return 0


def _taught_limb(options: argparse.Namespace) -> tuple[LimbSystem, float]:
    """The limb that is moved by hand, wires off, and how long it is recorded, s."""
    limb = LimbParameters.of(options.limb)
    if options.emulated is None:
        if options.hand:
            raise LimbError("--hand moves an emulated limb; give its seed: --emulated SEED.")
        return SerialLimb(options.port, limb, heated=False), options.time
    if options.hand:
        motion = reference_from_file(options.hand, 0.5)
    elif LimbModel.of(limb).layout.is_planar:
        times = np.linspace(0.0, 60.0, 601)
        motion = from_samples(times, np.deg2rad(15.0) * np.sin(times / 4.0))
    else:
        motion = NAMED["circle"]()
    twin = LimbTwin(limb, seed=options.emulated, hand=motion)
    return twin, min(options.time, motion.end_time())


def _teach(options: argparse.Namespace) -> int:
    output = checked_outputs(options, options.limb)
    if (options.port is None) == (options.emulated is None):
        raise LimbError("Give the PORT of a board, or --emulated SEED for an emulated limb.")
    if not 0 < options.time <= LONGEST_LESSON:
        raise LimbError(
            f"--time is {options.time:g} s; it must be above 0 and at most {LONGEST_LESSON:g} s."
        )
    with live_page(options) as live:
        limb, longest = _taught_limb(options)
        what = "Move the limb by hand; Ctrl-C ends the recording."
        if options.emulated is not None:
            what = "An emulated hand moves the limb."
        print(what, flush=True)
        if live:
            live.say(what)
        recording = watch(limb, longest, journal=options.output, live=live)
        if live:
            live.end(recording.interrupted or DONE)
    low, high = np.rad2deg([np.nanmin(recording.bend_angle), np.nanmax(recording.bend_angle)])
    said = {"taught": f"{recording.time[-1]:.1f} s, from {low:.1f}° to {high:.1f}°"}
    if count := int(np.isnan(recording.bend_angle).any(axis=0).sum()):
        said["missing"] = f"{count} of {len(recording.time)} samples, which did not come"
    print_summary(options, Summary.of(said, {}) + troubles(recording), output)
    return 0


def _emulate(options: argparse.Namespace) -> int:
    check_outputs([options.log], inputs=[options.limb, options.robot], force=options.force)
    twin: EmulatedSystem
    limbs = []
    if options.robot:
        if options.limb or options.physics != "lumped":
            raise LimbError("--limb and --physics are for a limb; leave ROBOT out.")
        robot = ConnectedLimbs.registered().of(options.robot)
        twin = connected("emulation")(robot, seed=options.emulated, extra=options.extra)
        limbs = [] if options.one_board else [limb.name for limb in robot.limbs]
    else:
        limb = LimbParameters.of(options.limb)
        twin = LimbTwin(limb, seed=options.emulated, extra=options.extra, physics=options.physics)
    emulate(twin, options.do, options.log, limbs=limbs)
    return 0


COMMANDS = {
    "status": Command(
        _status,
        "Prints the state of a board, or without PORT the serial ports of this computer.",
        "limb json live",
        [
            shared("board", nargs="?"),
            Option("--clear", action="store_true", help="clear a fault that is latched"),
        ],
        examples=["soft-limb status", "soft-limb status /dev/ttyACM0"],
    ),
    "arm-check": Command(
        _arm_check,
        "Tests whether the sensors work, and whether each wire warms its own thermocouple and "
        "bends the limb to its own side, and whether both thermocouples show the like. Takes two "
        "minutes, and heats each wire until the limb has bent by 6 to 8°. Before that it asks at a "
        "terminal for what no board can see: the supply's voltage, and a thermal cut-off. Where "
        "nobody answers, it opens no port and heats nothing.",
        "board limb json",
        [
            Option(
                "--supply",
                type=float,
                metavar="VOLTS",
                help="measured voltage of the wires' supply, which must be the limb's "
                "supply_voltage if its file has one; without it nothing is heated",
            ),
            Option(
                "--cut-off",
                action=argparse.BooleanOptionalAction,
                help="whether a thermal cut-off is on the limb, in series with its wires; without "
                "one nothing is heated",
            ),
        ],
        examples=["soft-limb arm-check /dev/ttyACM0 -l limb.yaml --supply 7.0 --cut-off"],
    ),
    "board-check": Command(
        _board_check,
        "Tests a board, also one with firmware of your own: it answers, its sensors read what is "
        "plausible, it refuses what it must, and duty ends when this computer falls silent. Takes "
        "15 s at a duty of 4%; start it with a cold limb. Exit status 0 if all passed.",
        "board limb json",
        examples=["soft-limb board-check /dev/ttyACM0"],
    ),
    "replay": Command(
        _replay,
        "Drives a limb along a trajectory, open loop or by a controller: a robot in real time, or "
        "without a port an emulated limb or the plan's model in simulated time. Every sample is "
        "written when it arrives, to NAME.unfinished.csv; it becomes NAME.csv when the plan has "
        "ended. Of a robot, the report tells how many commands left more than 5 ms late.",
        "trajectory output driven controller plot report live cool json force",
        examples=[
            "soft-limb replay out/plan.csv -o out/recording.csv --plot out/tracking.png",
            "soft-limb replay out/plan.csv -o out/recording.csv -p /dev/ttyACM0",
        ],
    ),
    "follow": Command(
        _follow,
        "Teach and go: plans what was taught from where the limb is read to be, with margins for "
        "feedback, and drives it as near to that as it can, or by another controller along the "
        "plan; a robot in real time. The folder has plan.csv, recording.csv, tracking.png and "
        "report.html.",
        "reference folder limb driven smooth knot-rate live cool json force",
        [
            shared("controller", default=NEAREST),
            shared("task", help=f"{TASK_HELP}; closed-loop if left out"),
        ],
        examples=["soft-limb follow mine.csv -o out/followed/"],
    ),
    "learn": Command(
        _learn,
        "Replays a trajectory again and again, a robot in real time, each time when its wires are "
        "cool. Corrects the duty after each repetition, so that the limb comes nearer to the "
        "reference, and goes back where it was farther away. Ends early when another repetition "
        "does not pay. The folder has a recording of each repetition, a picture, a report, the "
        "best duty as a trajectory, learned.csv, and what was learned: started again, it goes on "
        "from there.",
        "trajectory folder driven live json force",
        [
            Option(
                "-n",
                "--repetitions",
                type=int,
                default=10,
                help="in all, those before included (default %(default)s)",
            ),
        ],
        examples=["soft-limb learn out/plan.csv -n 10 -o out/learned/"],
    ),
    "teach": Command(
        _teach,
        "Records while the limb is moved by hand. The recording is a reference: soft-limb plan "
        "RECORDING -o plan.csv plans it.",
        "output limb live force",
        [
            shared("board", nargs="?"),
            Option(
                "-t", "--time", type=float, default=60.0, help="to record, s (default %(default)g)"
            ),
            shared(
                "emulated",
                default=None,
                help="in place of a port: seed of an emulated limb, which an emulated hand moves",
            ),
            Option(
                "--hand",
                metavar="REFERENCE",
                help="what the emulated hand moves it through, as soft-limb plan takes it; a "
                "motion of 60 s within 15° if left out",
            ),
        ],
        examples=[
            "soft-limb teach --emulated 1 -o out/taught.csv",
            "soft-limb teach /dev/ttyACM0 -o out/taught.csv -t 30",
        ],
    ),
    "emulate": Command(
        _emulate,
        "Runs the board's firmware on an emulated board with an emulated limb, in real time, and "
        "prints the port to connect to, and the next command. Of a robot, each limb has a board of "
        "its own; NAME=PORT is printed for each. Reads orders for faults from standard input, one "
        f"in each line: {ORDERS}. Orders for the board of one limb begin with its name.",
        "emulated extra physics limb force",
        [
            Option(
                "robot",
                nargs="?",
                type=Path,
                help="robot parameters (.yaml), to emulate a robot in place of a limb",
            ),
            Option("--one-board", action="store_true", help="with all limbs of the robot"),
            Option(
                "--do", action="append", default=[], metavar="ORDER", help="an order to start with"
            ),
            Option(
                "--log", type=Path, help="file for changes of duty and orders, a line of JSON each"
            ),
        ],
        examples=["soft-limb emulate --emulated 3 -l limb.yaml"],
    ),
}
