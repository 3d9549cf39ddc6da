"""Commands that drive a robot or an emulated limb along plans, teach it, and check its board."""

import argparse
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from serial.tools import list_ports

from controllers.learner import Repetition
from hardware import (
    BoardInfo,
    BoardLink,
    LimbTwin,
    ReplayError,
    Sample,
    SerialLimb,
    present_readings,
    watch,
)
from hardware.board import board_check
from hardware.board.arm_check import check_supply, check_wires
from hardware.board.journal import closing
from hardware.board.link import SerialPort, check_port_exists
from hardware.emulation.emulator import ORDERS, emulate
from hardware.emulation.specimen import emulated_limb
from hardware.emulation.twin import EmulatedSystem
from hardware.live_feed import DONE
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
from limb_systems.limb_system import check_limb
from limb_systems.summary import Summary
from limb_systems.views.panels import tracking_panels
from planners.plan_check import far_from_reference
from planners.references import from_samples
from soft_limb.commands.options import (
    TASK_HELP,
    Command,
    Option,
    checked_outputs,
    count,
    live_page,
    print_duration,
    print_summary,
    save_panels,
    shared,
)
from soft_limb.commands.planners import NAMED_REFERENCES, load_task, plan_reference
from soft_limb.reports.plan_report import write_rollout_report
from soft_limb.results.summaries import repetitions_summary, troubles
from soft_limb.runs import repetitions
from soft_limb.runs.rollout import DEFAULT_FEEDBACK, roll_out

if TYPE_CHECKING:
    from soft_limb.live_page import LivePage

FOLLOW_FILES = ("plan.csv", "recording.csv", "report.html")
SIMULATION_SPEED = 20.0  # times real time, for an emulated limb on an idle computer
MAX_TEACHING_TIME = 3600.0  # s
NO_SUPPLY = 0.0  # V, the answer for a board whose supply heats no wire


def _serial_ports() -> Summary:
    """Return the serial ports of this computer."""
    texts = {}
    values = []
    for port in list_ports.comports():
        texts[port.device] = port.description
        values.append({"port": port.device, "description": port.description})
    if not texts:
        texts = {"ports": "no serial ports; is the board plugged in?"}
    return Summary.of(texts, {"ports": values})


def _status(options: argparse.Namespace) -> int:
    if options.port is None:
        if options.clear:
            raise LimbError("--clear needs the PORT of a board.")
        print_summary(options, _serial_ports())
        return 0
    # Print the state of the board.
    limb = LimbParameters.of(options.limb)
    with BoardLink(options.port, limb) as link:
        info = link.info()
        if options.clear:
            link.clear()
        print_summary(options, _board_summary(info, link.sample(), limb))
    return 0


def _board_summary(info: BoardInfo, sample: Sample, limb: LimbParameters) -> Summary:
    """Return the state of a board and its newest readings."""
    bends = np.rad2deg(bend_angle_from_tip_tangent(sample.tip_tangent)).tolist()
    # Number the wires if the board has the wires of another limb.
    names = limb.wire_names
    if len(names) != info.channels:
        names = [f"wire {number + 1}" for number in range(info.channels)]
    # Put the readings and the upper bounds of each wire into words.
    readings = []
    bounds = []
    for name, V, bound in zip(names, sample.temperature, sample.warmest, strict=True):
        readings.append(f"{name} {V:.2f} °C" if np.isfinite(V) else f"{name} has no reading")
        bounds.append(f"{name} at most {bound:.0f} °C")
    texts = {
        "board": f"{info.serial_number}, firmware {info.firmware_version}",
        "state": "armed" if sample.armed else f"off: {sample.reason_text}",
        "last reset": info.reset_cause,
        "wires": f"{', '.join(readings)}; off at {info.temperature_limit:g} °C",
        "heat": f"{', '.join(bounds)}, by their duty",
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


def _print_check(options: argparse.Namespace, outcome: str, sentence: str) -> None:
    """Print the outcome of a check at once, unless all checks are printed as JSON at the end."""
    if not options.json:
        print(f"{outcome:<9}{sentence}", flush=True)


def _arm_check(options: argparse.Namespace) -> int:
    checks = []
    parameters = LimbParameters.of(options.limb)

    def add_check(passed: bool, sentence: str) -> None:
        checks.append({"passed": passed, "what": sentence})
        _print_check(options, "ok" if passed else "FAILED", sentence)

    # Heat no wire before the supply and the thermal cut-off are confirmed.
    voltage, cut_off = _supply_answers(options)
    for is_good, sentence in check_supply(parameters, voltage, cut_off):
        add_check(is_good, sentence)
    passed = all(check["passed"] for check in checks)
    if passed:
        with BoardLink(options.port, parameters) as link:
            passed = check_wires(link, add_check, parameters)
    if options.json:
        print_summary(options, Summary.of({}, {"passed": passed, "checks": checks}))
    return 0 if passed else 1


def _read_answer(question: str) -> str:
    """Ask a question at the terminal and return the answer; empty for Enter or Ctrl-D."""
    print(question, end="", flush=True)
    return sys.stdin.readline().strip()


def _supply_answers(options: argparse.Namespace) -> tuple[float | None, bool | None]:
    """Return the supply's voltage, V, and whether there is a cut-off; None if nobody answers."""
    check_port_exists(options.port)  # else a person is asked in vain
    voltage = options.supply
    cut_off = options.cut_off
    # Ask at a terminal what the options do not say.
    if sys.stdin.isatty() and not options.json:
        if voltage is None:
            answer = _read_answer(
                "Measured voltage of the wires' supply, V (Enter: not measured, no heat): "
            )
            try:
                voltage = float(answer) if answer else None
            except ValueError:
                raise LimbError(
                    f"{answer!r} is not a voltage; measure it, and enter a number such as 7.0."
                ) from None
        if cut_off is None and voltage != NO_SUPPLY:
            answer = _read_answer("Is a thermal cut-off in series with the wires, y or n? ")
            cut_off = answer.lower() in ("y", "yes")
    return voltage, cut_off


def _board_check(options: argparse.Namespace) -> int:
    checks = []
    words = {
        board_check.PASSED: "ok",
        board_check.FAILED: "FAILED",
        board_check.NOT_RUN: "not run",
    }

    def add_result(result: board_check.Outcome) -> None:
        case = result.case
        section = f"docs/protocol.md#{case.section}"
        checks.append(
            {
                "name": case.name,
                "rule": case.rule,
                "section": section,
                "outcome": result.outcome,
                "what": result.details,
            }
        )
        _print_check(
            options, words[result.outcome], case.name + f": {result.details}" * bool(result.details)
        )
        if result.outcome == board_check.FAILED:
            _print_check(options, "", f"rule: {case.rule} {section}")

    # Heat no wire before the supply and the thermal cut-off are confirmed.
    parameters = LimbParameters.of(options.limb)
    voltage, cut_off = _supply_answers(options)
    if voltage != NO_SUPPLY:
        answers = check_supply(parameters, voltage, cut_off)
        if refusals := [sentence for is_good, sentence in answers if not is_good]:
            raise LimbError(f"The board is not checked: {'; '.join(refusals)}.")
    # Run all cases, and count the outcomes.
    with SerialPort(options.port) as cable:
        host = board_check.Host(cable, parameters)
        board_check.check_board(host, add_result)
    outcomes = [check["outcome"] for check in checks]
    counts = {outcome: outcomes.count(outcome) for outcome in words}
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
        data = {"plan": options.trajectory, "recording": options.output}
        return _drive(options, trajectory, data, options.report, outputs, live)


def _drive(
    options: argparse.Namespace,
    trajectory: Trajectory,
    data: dict[str, Path],
    report: Path | None,
    outputs: list[Path | None],
    live: "LivePage | None",
) -> int:
    """Drive a limb along a plan, write and print the results, and return the exit status.

    ``data`` has the files of the plan and of the recording to write.
    """
    rollout = roll_out(
        trajectory,
        lambda: _limb(trajectory.parameters, options),
        data["recording"],
        controller=options.controller,
        real_time=bool(options.port),
        live=live,
    )
    # Write picture and report while the page still shows the run.
    recording = rollout.recording
    summary = rollout.summary()
    save_panels(tracking_panels(trajectory, [recording]), vars(options).get("plot"))
    if report:
        write_rollout_report(rollout, summary, report, data)
    print_summary(options, summary, outputs)
    if live:
        live.end(recording.interrupted or DONE)
    return 1 if recording.interrupted else 0  # an emulated limb may cut out


def _limb(planned: LimbParameters, options: argparse.Namespace) -> LimbSystem:
    """Return the robot on a port, the model of the plan, or an emulated limb."""
    if options.port:
        return SerialLimb(options.port, planned)
    return Limb(planned) if options.model else _twin(planned, options)


def _twin(planned: LimbParameters, options: argparse.Namespace) -> LimbTwin:
    """Return the emulated limb to drive; ReplayError if the plan is for another one."""
    board = emulated_limb(planned.board)
    if board and options.emulated not in (None, board.seed):
        raise ReplayError(
            f"This trajectory was planned with the calibration of the emulated limb {board.seed}, "
            f"not {options.emulated}; calibrate limb {options.emulated}, or leave --emulated out."
        )
    # Warn that a plan for a calibrated robot says nothing about an emulated limb.
    twin = LimbTwin.of(planned, options.emulated or 0)
    if twin.specimen.around_calibrated:
        warnings.warn(
            "This plan was not made with the calibration of an emulated limb. An unrelated "
            f"emulated limb, seed {twin.specimen.seed}, follows the plan here, so its errors say "
            "nothing about your limb. Give --model to drive the plan's model, or -p PORT to drive "
            "the robot.",
            stacklevel=2,
        )
    return twin


def _follow(options: argparse.Namespace) -> int:
    # Check the files, and load limb and task.
    plan_file, recording_file, report = (options.output / name for name in FOLLOW_FILES)
    outputs = [plan_file, recording_file, report]
    inputs = [Path(options.reference), options.limb, options.task and Path(options.task)]
    check_outputs(outputs, inputs=inputs, force=options.force)
    limb = LimbParameters.of(options.limb)
    task = load_task(options.task or "closed-loop", limb)
    with live_page(options) as live:

        def begin_step(step: str) -> None:
            print(step, file=sys.stderr, flush=True)
            if live:
                live.say(step)

        # Plan from the present temperatures of the wires.
        begin_step(f"Planning {options.reference}")
        resting_limb = check_limb(_limb(limb, options))
        with closing(resting_limb):
            start = present_readings(resting_limb)
        trajectory = plan_reference(options, limb, task, start)
        trajectory.save(plan_file)
        # Drive the limb along the plan.
        duration = f"{trajectory.duration:g} s"
        begin_step(f"Following {options.reference} for {duration}, controller {options.controller}")
        data = {"plan": plan_file, "recording": recording_file}
        return _drive(options, trajectory, data, report, [*outputs], live)


def _learn(options: argparse.Namespace) -> int:
    # Continue an earlier run in this folder, or begin.
    trajectory = Trajectory.load(options.trajectory)
    folder = options.output
    learner = repetitions.load_or_create_learner(folder, trajectory, force=options.force)
    if warning := far_from_reference(trajectory):
        warnings.warn(warning, stacklevel=1)

    def print_repetition(number: int, repetition: Repetition) -> None:
        if options.json:
            return
        distance = f"{np.rad2deg(repetition.reference_distance):.2f}° as read"
        estimate = f"about {np.rad2deg(repetition.estimated_distance):.2f}°"
        error = f"{np.rad2deg(repetition.mean_error):.2f}° as read"
        parts = [f"mean |φ_ref - φ| {distance}, {estimate} without the sensor's drift"]
        parts += [f"mean |φ* - φ| {error}", repetition.interrupted, repetition.remark]
        parts = list(filter(None, parts))
        print(f"repetition  {number}: {'; '.join(parts)}", flush=True)

    # Say how long it takes.
    number = options.repetitions
    each = f"{number} repetition{'s' * (number > 1)} of {trajectory.duration:g} s"
    if options.port:
        print_duration(f"{each}, with a rest of some minutes after each, until the wires are cool")
    elif options.live:
        print_duration(f"{each}, in real time")
    else:
        about = number * trajectory.duration / SIMULATION_SPEED
        print_duration(f"about {max(1.0, about):.0f} s for {each}")
    # Repeat with a limb that has rested before each repetition.
    limbs: Callable[[], LimbSystem]
    try:
        with live_page(options) as live:
            if options.port:
                limbs = repetitions.make_rested_robots(options.port, trajectory, live)
            elif options.model:
                limbs = lambda: Limb(trajectory.parameters)  # noqa: E731 - the model keeps no heat
            else:
                twin = _twin(trajectory.parameters, options)
                limbs = repetitions.make_rested_twins(twin, trajectory, learner)
            repetitions.repeat(learner, limbs, number, folder, announce=print_repetition, live=live)
    except LimbError:
        repetitions.report_repetitions(learner, folder)
        raise
    # Report all repetitions, including earlier runs.
    reports = repetitions.report_repetitions(learner, folder)
    written = [folder / repetitions.STATE_FILE, folder / repetitions.LEARNED_FILE, *reports]
    print_summary(options, repetitions_summary(learner), written)
    return 0


def _limb_to_teach(options: argparse.Namespace) -> tuple[LimbSystem, float]:
    """Return the limb to move by hand, wires off, and the longest time to record it, s."""
    limb = LimbParameters.of(options.limb)
    # A robot is moved by the operator.
    if options.emulated is None:
        return SerialLimb(options.port, limb, heated=False), options.time
    # An emulated limb is moved along a reference.
    if LimbModel.of(limb).layout.is_planar:
        times = np.linspace(0.0, 60.0, 601)
        motion = from_samples(times, np.deg2rad(15.0) * np.sin(times / 4.0))
    else:
        motion = NAMED_REFERENCES["circle"]()
    twin = LimbTwin(limb, seed=options.emulated, hand=motion)
    return twin, min(options.time, motion.end_time())


def _teach(options: argparse.Namespace) -> int:
    output = checked_outputs(options, options.limb)
    if (options.port is None) == (options.emulated is None):
        raise LimbError("Give the PORT of a board, or --emulated SEED for an emulated limb.")
    if not 0 < options.time <= MAX_TEACHING_TIME:
        raise LimbError(
            f"--time is {options.time:g} s; it must be above 0 and at most {MAX_TEACHING_TIME:g} s."
        )
    # Record until Ctrl-C or the end of the time.
    with live_page(options) as live:
        limb, max_time = _limb_to_teach(options)
        instruction = "Move the limb by hand; Ctrl-C ends the recording."
        if options.emulated is not None:
            instruction = "An emulated hand moves the limb."
        print(instruction, flush=True)
        if live:
            live.say(instruction)
        recording = watch(limb, max_time, journal=options.output, live=live)
        if live:
            live.end(recording.interrupted or DONE)
    # Print the range of the motion, and how many samples are missing.
    low, high = np.rad2deg([np.nanmin(recording.bend_angle), np.nanmax(recording.bend_angle)])
    texts = {"taught": f"{recording.time[-1]:.1f} s, from {low:.1f}° to {high:.1f}°"}
    if num_missing := int(np.isnan(recording.bend_angle).any(axis=0).sum()):
        texts["missing"] = f"{num_missing} of {len(recording.time)} samples were not received"
    print_summary(options, Summary.of(texts, {}) + troubles(recording), output)
    return 0


def _emulate(options: argparse.Namespace) -> int:
    check_outputs([options.log], inputs=[options.limb, options.robot], force=options.force)
    if options.one_board and not options.robot:
        raise LimbError("--one-board is for a robot; give its description (.yaml), too.")
    twin: EmulatedSystem
    limbs = []
    # Emulate a robot, with a board for each limb or for all, or a limb.
    if options.robot:
        if options.limb or options.physics != "lumped":
            raise LimbError(
                "--limb and --physics describe one limb; leave them out, or leave ROBOT out."
            )
        robot = ConnectedLimbs.registered().of(options.robot)
        twin = connected("emulation")(robot, seed=options.emulated, extra=options.extra)
        limbs = [] if options.one_board else [limb.name for limb in robot.limbs]
    else:
        limb = LimbParameters.of(options.limb)
        twin = LimbTwin(limb, seed=options.emulated, extra=options.extra, physics=options.physics)
    emulate(twin, options.do, options.log, limbs=limbs)
    return 0


SUPPLY_OPTIONS = [
    Option(
        "--supply",
        type=float,
        metavar="VOLTS",
        help="measured voltage of the wires' supply; it must match supply_voltage in the limb's "
        "file, if that is set; without a voltage no wire is heated",
    ),
    Option(
        "--cut-off",
        action=argparse.BooleanOptionalAction,
        help="confirm that a thermal cut-off is on the limb, in series with its wires; without a "
        "cut-off no wire is heated",
    ),
]
COMMANDS = {
    "status": Command(
        _status,
        "Print the state of a board, or without PORT the serial ports of this computer.",
        "limb json",
        [
            shared("board", nargs="?"),
            Option("--clear", action="store_true", help="clear a latched fault of the board"),
        ],
        examples=["soft-limb status", "soft-limb status /dev/ttyACM0"],
    ),
    "arm-check": Command(
        _arm_check,
        "Test that the sensors work, that each wire warms its own thermocouple and bends the limb "
        "to its own side, and that both thermocouples agree. This takes two minutes and heats each "
        "wire until the limb has bent by 6 to 8°.\n"
        "\n"
        "First the command asks at the terminal for two facts that no board can measure: the "
        "voltage of the supply, and whether there is a thermal cut-off. Without an answer it opens "
        "no port and heats nothing.",
        "board limb json",
        SUPPLY_OPTIONS,
        examples=["soft-limb arm-check /dev/ttyACM0 -l limb.yaml --supply 7.0 --cut-off"],
    ),
    "board-check": Command(
        _board_check,
        "Test a board, also with your own firmware: that it answers, that its readings are "
        "plausible, that it refuses unsafe commands, and that it switches the wires off when this "
        "computer falls silent. This takes 15 s at a duty of 4%; the limb must be cold at the "
        "start. The exit status is 0 if no test failed.\n"
        "\n"
        "First the command asks for voltage and cut-off, as arm-check does. Enter 0 V for a supply "
        "that heats no wire: it is off, or there are lamps in place of the wires.",
        "board limb json",
        SUPPLY_OPTIONS,
        examples=[
            "soft-limb board-check /dev/ttyACM0 --supply 0",
            "soft-limb board-check /dev/ttyACM0 --supply 7.0 --cut-off",
        ],
    ),
    "replay": Command(
        _replay,
        "Drive a limb along a trajectory, open loop or with a controller: a robot in real time, or "
        "without a port an emulated limb or the plan's model in simulated time. Each sample is "
        "written when it arrives, to NAME.unfinished.csv, which becomes NAME.csv at the end of the "
        "plan. For a robot, the summary counts the commands that were sent more than 5 ms late.",
        "trajectory output driven controller plot report live json force",
        examples=[
            "soft-limb replay out/plan.csv -o out/recording.csv --plot out/tracking.png",
            "soft-limb replay out/plan.csv -o out/recording.csv -p /dev/ttyACM0",
        ],
    ),
    "follow": Command(
        _follow,
        "Teach and go: plan a taught motion from the present state of the limb, with margins for "
        "feedback, and drive the limb with a controller; a robot in real time. The default "
        "controller aims at the taught motion itself, the others at the plan. Writes plan.csv, "
        "recording.csv and report.html to the folder.",
        "reference folder limb driven smooth knot-rate live json force",
        [
            shared("controller", default=DEFAULT_FEEDBACK),
            shared("task", help=f"{TASK_HELP}; closed-loop if left out"),
        ],
        examples=["soft-limb follow mine.csv -o out/followed/"],
    ),
    "learn": Command(
        _learn,
        "Replay a trajectory repeatedly, a robot in real time, and let the wires cool in between. "
        "After each repetition the duty is corrected to bring the limb nearer to the reference; a "
        "correction that made it worse is undone. Learning ends early when further repetitions do "
        "not pay. Writes to the folder a recording of each repetition, a report, the "
        "best duty as a trajectory (learned.csv), and the state of learning: run the command again "
        "to continue.",
        "trajectory folder driven live json force",
        [
            Option(
                "-n",
                "--repetitions",
                type=count,
                default=10,
                help="repetitions in total, including earlier runs (default %(default)s)",
            ),
        ],
        examples=["soft-limb learn out/plan.csv -n 10 -o out/learned/"],
    ),
    "teach": Command(
        _teach,
        "Record the bend angle while you move the limb by hand, wires off. The recording is a "
        "reference for soft-limb plan RECORDING -o plan.csv.",
        "output limb live force",
        [
            shared("board", nargs="?"),
            Option(
                "-t",
                "--time",
                type=float,
                default=60.0,
                help="longest time to record, s (default %(default)g)",
            ),
            shared(
                "emulated",
                default=None,
                help="seed of an emulated limb, moved by an emulated hand, in place of a port",
            ),
        ],
        examples=[
            "soft-limb teach --emulated 1 -o out/taught.csv",
            "soft-limb teach /dev/ttyACM0 -o out/taught.csv -t 30",
        ],
    ),
    "emulate": Command(
        _emulate,
        "Run the board's firmware on an emulated board with an emulated limb, in real time. Prints "
        "the port to connect to, and the next command. Each limb of a robot has its own board, "
        "printed as NAME=PORT. Orders that cause faults are read from standard input, one on each "
        f"line: {ORDERS}. An order that begins with the name of a limb is for its board alone.",
        "emulated extra physics limb force",
        [
            Option(
                "robot",
                nargs="?",
                type=Path,
                help="robot parameters (.yaml), to emulate a robot in place of a limb",
            ),
            Option(
                "--one-board",
                action="store_true",
                help="emulate one board that drives all limbs of the robot",
            ),
            Option(
                "--do",
                action="append",
                default=[],
                metavar="ORDER",
                help="order to carry out at the start; may be repeated",
            ),
            Option(
                "--log",
                type=Path,
                help="file to write: each change of duty and each order as a line of JSON",
            ),
        ],
        examples=["soft-limb emulate --emulated 3 -l limb.yaml"],
    ),
}
