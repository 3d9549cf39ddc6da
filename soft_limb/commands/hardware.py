"""``python -m hardware``: the robot, and its emulation, from the shell."""

import argparse
import json
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from serial.tools import list_ports

from controllers.learner import Repetition
from hardware import BoardInfo, BoardLink, LimbTwin, ReplayError, Sample, SerialLimb, watch
from hardware.emulation.emulator import ORDERS, emulate
from hardware.emulation.specimen import EXTRA_EFFECTS, emulated_limb
from hardware.live.feed import board_reading
from hardware.live.messages import Reading, RunHeader
from hardware.robot import board_check
from hardware.robot.arm_check import check_wires
from hardware.robot.link import SerialPort
from limb_systems import (
    Limb,
    LimbError,
    LimbParameters,
    LimbSystem,
    Recording,
    Trajectory,
    bend_angle_from_tip_tangent,
)
from limb_systems.output import check_outputs
from limb_systems.simulation import PERIOD
from planners.distance import far_from_reference
from soft_limb.command import add_force_option, run_command
from soft_limb.live.options import add_live_options, live_page
from soft_limb.live.page import DONE, LivePage
from soft_limb.reports.drive import write_drive_report
from soft_limb.runs.drive import CONTROLLER_HELP, CONTROLLERS, OPEN, drive, trouble
from soft_limb.runs.follow import PICTURE, PLAN, RECORDING, REPORT, closed_loop_request, follow
from soft_limb.runs.repetitions import (
    STATE,
    draw_repetitions,
    learn,
    learner_in,
    rested_robots,
    rested_twins,
)


def main(arguments: list[str] | None = None, prog: str = "python -m hardware") -> int:
    options = _parser(prog).parse_args(arguments)
    return run_command(lambda: _COMMANDS[options.command](options), "stopped; wires are off")


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=prog,
        description="Replays plans on a limb, records motions that are taught, and checks the "
        "board; recordings for calibration are collected by soft-limb collect. A PORT is the name "
        "of a serial port or any URL of pyserial's.",
        epilog="exit status: 0 done, 1 it could not be done, 2 wrong usage, 130 stopped by Ctrl-C "
        "or a signal, with the wires off",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    ports = commands.add_parser("ports", help="list the serial ports of this computer")
    ports.add_argument("--json", action="store_true", help="print JSON")

    status = commands.add_parser("status", help="print the state of a board")
    status.add_argument("port", help="of the board")
    status.add_argument("--clear", action="store_true", help="clear a fault that is latched")
    status.add_argument("--json", action="store_true", help="print JSON")
    add_live_options(status)

    check = commands.add_parser(
        "arm-check",
        help="test sensors and wires one by one; heats each wire a little",
        description="Tests whether the sensors work, and whether each wire warms its own "
        "thermocouple and bends the limb to its own side, and whether both thermocouples show the "
        "like. Takes two minutes, and heats each wire until the limb has bent by 6 to 8°.",
    )
    check.add_argument("port", help="of the board")
    check.add_argument(
        "-l", "--limb", type=Path, help="limb parameters (.yaml); the nominal limb if left out"
    )
    check.add_argument("--json", action="store_true", help="print JSON")

    conform = commands.add_parser(
        "board-check",
        help="test a board's firmware against docs/protocol.md, rule by rule",
        description="Tests whether a board keeps the rules of docs/protocol.md, also one with "
        "firmware of your own. Takes three minutes, and wires reach 60 °C. Rules for faults "
        "of sensors need a hand at the robot, and are not run without one; with it, wires reach "
        "90 °C. Exit status 0 if all that ran passed.",
    )
    conform.add_argument("port", help="of the board")
    hands = conform.add_mutually_exclusive_group()
    hands.add_argument(
        "--by-hand", action="store_true", help="tell what to do at the robot, and wait for it"
    )
    hands.add_argument(
        "--by-order",
        action="store_true",
        help="tell what to type at soft-limb emulate, and wait for it",
    )
    conform.add_argument("--json", action="store_true", help="print JSON")

    run = commands.add_parser(
        "replay",
        help="replay a trajectory and record it",
        description="Drives a limb along a trajectory, open loop or by a controller: a robot in "
        "real time, or without a port an emulated limb or the plan's model in simulated time. On a "
        "robot every sample is written when it arrives, to NAME.unfinished.csv; it becomes "
        "NAME.csv when the plan has ended, and the report tells how many commands left more than 5 "
        "ms late.",
    )
    run.add_argument("trajectory", type=Path, help="trajectory file (.csv)")
    run.add_argument("--json", action="store_true", help="print JSON")
    run.add_argument(
        "-o", "--output", required=True, type=Path, help="recording file to write (.csv)"
    )
    _add_limb_options(run)
    _add_controller_option(run, OPEN)
    run.add_argument(
        "--plot", type=Path, help="picture of plan and recording to write (.png, .pdf, .svg)"
    )
    run.add_argument(
        "--report", type=Path, help="page on both to write, with a chart to look into (.html)"
    )
    add_live_options(run)
    add_force_option(run)

    go = commands.add_parser(
        "follow",
        help="plan what was taught, and follow it by feedback",
        description="Teach and go: plans what was taught, with margins for feedback, and drives a "
        "limb along the plan by a controller, a robot in real time. The folder has plan.csv, "
        "recording.csv, tracking.png and report.html.",
    )
    go.add_argument(
        "reference",
        help="a recording of teach; or a CSV of time in s and bend angle in degrees; or 'fig5'",
    )
    go.add_argument("-o", "--output", required=True, type=Path, help="folder to write to")
    go.add_argument(
        "-l", "--limb", type=Path, help="limb parameters (.yaml); the nominal limb if left out"
    )
    _add_limb_options(go)
    _add_controller_option(go, "pi")
    go.add_argument(
        "--smooth",
        type=float,
        default=0.5,
        help="window for smoothing a recording's bend angle, s (default %(default)g)",
    )
    add_live_options(go)
    go.add_argument("--json", action="store_true", help="print JSON")
    add_force_option(go)

    learn = commands.add_parser(
        "learn",
        help="repeat a trajectory, and learn from each repetition to follow it",
        description="Replays a trajectory again and again, a robot in real time, each time when "
        "its wires are cool. Corrects the duty after each repetition, so that the limb follows the "
        "plan. Ends early when another repetition does not pay. The folder has a recording of each "
        "repetition, a picture, a report and what was learned: started again, it goes on from "
        "there.",
    )
    learn.add_argument("trajectory", type=Path, help="trajectory file (.csv)")
    learn.add_argument("-o", "--output", required=True, type=Path, help="folder to write to")
    learn.add_argument(
        "-n",
        "--repetitions",
        type=int,
        default=10,
        help="in all, those before included (default %(default)s)",
    )
    _add_limb_options(learn)
    add_live_options(learn)
    learn.add_argument("--json", action="store_true", help="print JSON")
    add_force_option(learn)

    teach = commands.add_parser(
        "teach",
        help="record the bend while the limb is moved by hand, wires off",
        description="Records while the limb is moved by hand. The recording is a reference: "
        "python -m planners RECORDING -o plan.csv plans it.",
    )
    teach.add_argument("port", help="of the robot")
    teach.add_argument(
        "-o", "--output", required=True, type=Path, help="recording file to write (.csv)"
    )
    teach.add_argument(
        "-t", "--time", type=float, default=60.0, help="to record, s (default %(default)g)"
    )
    teach.add_argument("-l", "--limb", type=Path, help="parameters of the limb (.yaml)")
    add_live_options(teach)
    add_force_option(teach)

    recover = commands.add_parser(
        "recover", help="finish the recording of a program that was killed"
    )
    recover.add_argument("recording", type=Path, help="recording without its end (.unfinished.csv)")
    recover.add_argument(
        "-o", "--output", required=True, type=Path, help="recording file to write (.csv)"
    )
    add_force_option(recover)

    emulation = commands.add_parser(
        "emulate",
        help="emulate a board and a limb on a pseudo-terminal",
        description="Runs the board's firmware on an emulated board with an emulated limb, in real "
        "time, and prints the port to connect to. Reads orders for faults from standard input, one "
        f"in each line: {ORDERS}.",
    )
    emulation.add_argument(
        "--emulated",
        type=int,
        default=0,
        metavar="SEED",
        help="seed of the emulated limb (default %(default)s)",
    )
    emulation.add_argument(
        "--extra",
        action="append",
        default=[],
        choices=EXTRA_EFFECTS,
        help="an effect that it has beside those of every limb",
    )
    emulation.add_argument(
        "-l",
        "--limb",
        type=Path,
        help="description of the limb (.yaml); the nominal one if left out",
    )
    emulation.add_argument(
        "--do", action="append", default=[], metavar="ORDER", help="an order to start with"
    )
    emulation.add_argument(
        "--log", type=Path, help="file for changes of duty and orders, a line of JSON each"
    )
    add_force_option(emulation)
    return parser


def _add_limb_options(command: argparse.ArgumentParser) -> None:
    which = command.add_mutually_exclusive_group()
    which.add_argument("-p", "--port", help="of the robot; an emulated limb if left out")
    which.add_argument(
        "--emulated",
        type=int,
        metavar="SEED",
        help="seed of the emulated limb; if left out, the limb that the plan was calibrated on, "
        "or else 0",
    )
    which.add_argument(
        "--model",
        action="store_true",
        help="no other limb than the plan's own model: what it would do if it were exact",
    )


def _add_controller_option(command: argparse.ArgumentParser, default: str) -> None:
    command.add_argument(
        "--controller",
        choices=CONTROLLERS,
        default=default,
        help=f"{CONTROLLER_HELP} (default %(default)s)",
    )


def _ports(options) -> int:
    ports = list_ports.comports()
    if options.json:
        facts = [{"port": port.device, "description": port.description} for port in ports]
        print(json.dumps({"ports": facts}))
        return 0
    for port in ports:
        print(f"{port.device:<20}{port.description}")
    if not ports:
        print("no serial ports; is the board plugged in?")
    return 0


def _status(options) -> int:
    with BoardLink(options.port) as link:
        info = link.info()
        if options.clear:
            link.clear()
        _print_status(options, info, link.sample())
        with live_page(options) as live:
            if live:
                _show_board(link, info, live)
    return 0


def _print_status(options, info: BoardInfo, sample: Sample) -> None:
    bend_angle = np.rad2deg(bend_angle_from_tip_tangent(sample.tip_tangent))
    if options.json:
        print(
            json.dumps(
                {
                    "serial_number": info.serial_number,
                    "firmware_version": info.firmware_version,
                    "temperature_limit_c": info.temperature_limit,
                    "armed": sample.armed,
                    "reason": sample.reason_text,
                    "reset_cause": info.reset_cause,
                    "highest_temperature_c": sample.warmest.tolist(),
                    "measured_temperature_c": sample.temperature.tolist(),
                    "bend_angle_deg": float(bend_angle),
                    "duty": sample.duty.tolist(),
                }
            ),
            flush=True,
        )
        return
    print(f"board       {info.serial_number}, firmware {info.firmware_version}")
    print(f"state       {'armed' if sample.armed else 'off: ' + sample.reason_text}")
    print(f"last reset  {info.reset_cause}")
    left, right = sample.temperature
    print(
        f"wires       left {left:.2f} °C, right {right:.2f} °C; off at "
        f"{info.temperature_limit:g} °C"
    )
    left, right = sample.warmest
    print(f"heat        left at most {left:.0f} °C, right at most {right:.0f} °C, by their duty")
    print(f"bend angle  {bend_angle:.1f}°")


def _show_board(link: BoardLink, info: BoardInfo, live: LivePage) -> None:
    """Shows a board, which is not armed, until a signal comes."""
    live.say("State of the board; this program does not arm it")
    live.begin(RunHeader(f"board {info.serial_number}", LimbParameters(), info.temperature_limit))
    start = time.monotonic()
    while True:
        sample = link.sample()
        live.show(
            Reading(
                time.monotonic() - start,
                [float(bend_angle_from_tip_tangent(sample.tip_tangent))],
                sample.temperature.tolist(),
                sample.duty.tolist(),
                board=board_reading(link),
            )
        )
        time.sleep(PERIOD)


def _arm_check(options) -> int:
    checks = []
    parameters = LimbParameters.of(options.limb)

    def say(good: bool, what: str) -> None:
        checks.append({"passed": good, "what": what})
        if not options.json:
            print(f"{'ok    ' if good else 'FAILED'}  {what}", flush=True)

    with BoardLink(options.port) as link:
        passed = check_wires(link, say, parameters)
    if options.json:
        print(json.dumps({"passed": passed, "checks": checks}))
    return 0 if passed else 1


def _board_check(options) -> int:
    words = {board_check.PASSED: "ok", board_check.FAILED: "FAILED"}
    stream = sys.stderr if options.json else sys.stdout

    def say(result: board_check.Outcome) -> None:
        if not options.json:
            what = f": {result.what}" if result.what else ""
            print(f"{words.get(result.outcome, result.outcome):<9}{result.rule.name}{what}")
            if result.outcome == board_check.FAILED:
                print(
                    f"         rule: {result.rule.sentence} docs/protocol.md#{result.rule.section}"
                )
            sys.stdout.flush()

    def ask(order: str, by_hand: str) -> bool:
        if options.by_order:
            by_hand = f'Type "{order}" at soft-limb emulate'
        print(
            f"         {by_hand}, then press Enter here (s and Enter: skip) ", end="", file=stream
        )
        stream.flush()
        return sys.stdin.readline() == "\n"

    with SerialPort(options.port) as cable:
        results = board_check.check_board(
            cable, say, ask if options.by_hand or options.by_order else None, board_check.RULES
        )
    counts = {
        outcome: sum(result.outcome == outcome for result in results)
        for outcome in (board_check.PASSED, board_check.FAILED, board_check.NOT_RUN)
    }
    if options.json:
        checks = [
            {
                "name": result.rule.name,
                "rule": result.rule.sentence,
                "section": f"docs/protocol.md#{result.rule.section}",
                "outcome": result.outcome,
                "what": result.what,
            }
            for result in results
        ]
        facts = {outcome.replace(" ", "_"): count for outcome, count in counts.items()}
        print(json.dumps({**facts, "checks": checks}))
    else:
        print(", ".join(f"{outcome} {count}" for outcome, count in counts.items()))
    return 1 if counts[board_check.FAILED] else 0


def _replay(options) -> int:
    check_outputs(
        [options.output, options.plot, options.report],
        inputs=[options.trajectory],
        pictures=[options.plot],
        tables=[options.output],
        force=options.force,
    )
    trajectory = Trajectory.load(options.trajectory)
    with live_page(options) as live:
        if live:
            live.say(f"Replay of {options.trajectory}, controller {options.controller}")
        driven = drive(
            trajectory,
            _limb_maker(trajectory.parameters, options),
            options.output,
            controller=options.controller,
            real_time=bool(options.port),
            live=live,
        )
        if live:
            live.end(driven.recording.interrupted or DONE)
    written = [str(path) for path in (options.output, options.plot, options.report) if path]
    if options.plot:
        # Matplotlib takes as long to import as all the rest.
        from limb_systems.views.plots import plot_tracking, save_figure

        save_figure(plot_tracking(trajectory, [driven.recording]), options.plot)
    if options.report:
        data = {"plan": options.trajectory, "recording": options.output}
        write_drive_report(driven, driven.lines(), options.report, data)
    return _report(options, driven.facts(), driven.lines(), written)


def _report(options, facts: dict, lines: list[str], written: list[str]) -> int:
    """Says how a limb was driven; the exit status."""
    if options.json:
        print(json.dumps({**facts, "written": written}))
    else:
        print("\n".join([*lines, f"written     {', '.join(written)}"]))
    return 1 if facts["interrupted"] else 0  # an emulated limb's that cut out


def _limb_maker(planned: LimbParameters, options) -> Callable[[], LimbSystem]:
    """Makes the robot on a port, the model of the plan, or an emulated limb."""
    if options.port:
        return lambda: SerialLimb(options.port, planned)
    return lambda: Limb(planned) if options.model else _twin(planned, options)


def _twin(planned: LimbParameters, options) -> LimbTwin:
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


def _follow(options) -> int:
    outputs = [options.output / name for name in (PLAN, RECORDING, PICTURE, REPORT)]
    check_outputs(outputs, inputs=[Path(options.reference), options.limb], force=options.force)
    if options.port:
        with BoardLink(options.port) as link:  # before the plan is made in vain
            link.sample()
    with live_page(options) as live:
        followed = follow(
            closed_loop_request(options.reference, options.limb, options.smooth),
            lambda planned: _limb_maker(planned, options)(),
            options.output,
            controller=options.controller,
            real_time=bool(options.port),
            live=live,
        )
        if live:
            live.end(followed.driven.recording.interrupted or DONE)
    return _report(options, followed.facts(), followed.lines(), [str(path) for path in outputs])


def _learn(options) -> int:
    if options.repetitions < 1:
        raise ReplayError(f"--repetitions is {options.repetitions}; it must be 1 or more.")
    trajectory = Trajectory.load(options.trajectory)
    learner = learner_in(options.output, trajectory, force=options.force)
    if far := far_from_reference(trajectory):
        warnings.warn(far, stacklevel=1)

    def tell(number: int, repetition: Repetition) -> None:
        if options.json:
            return
        said = [f"mean |φ* - φ| {np.rad2deg(repetition.mean_error):.2f}° as read"]
        said += filter(None, [repetition.interrupted, repetition.remark])
        print(f"repetition  {number}: {'; '.join(said)}", flush=True)

    try:
        with live_page(options) as live:
            if options.port:
                limbs = rested_robots(options.port, trajectory, live)
            elif options.model:
                limbs = _limb_maker(trajectory.parameters, options)  # as it is before any heat
            else:
                limbs = rested_twins(_twin(trajectory.parameters, options), trajectory, learner)
            learn(learner, limbs, options.repetitions, options.output, tell=tell, live=live)
    except LimbError:
        draw_repetitions(learner, options.output)
        raise
    drawn = draw_repetitions(learner, options.output)
    written = [str(path) for path in (options.output / STATE, *drawn)]
    if options.json:
        repetitions = [
            {
                "mean_deg": float(np.rad2deg(repetition.mean_error)),
                "interrupted": repetition.interrupted,
                "remark": repetition.remark,
            }
            for repetition in learner.repetitions
        ]
        facts = {"repetitions": repetitions, "finished": learner.finished, "written": written}
        print(json.dumps(facts))
        return 0
    if learner.finished:
        print(f"finished    {learner.finished}")
    print(f"written     {', '.join(written)}")
    return 0


def _teach(options) -> int:
    output = [options.output]
    check_outputs(output, inputs=[options.limb], tables=output, force=options.force)
    limb = LimbParameters.load(options.limb) if options.limb else LimbParameters()
    with live_page(options) as live:
        robot = SerialLimb(options.port, limb, heated=False)
        what = "Move the limb by hand; Ctrl-C ends the recording."
        print(what, flush=True)
        if live:
            live.say(what)
        recording = watch(robot, options.time, journal=options.output, live=live)
        if live:
            live.end(recording.interrupted or DONE)
    low, high = np.rad2deg([recording.bend_angle.min(), recording.bend_angle.max()])
    print(f"taught      {recording.time[-1]:.1f} s, from {low:.1f}° to {high:.1f}°")
    for line in trouble(recording):
        print(line)
    print(f"written     {options.output}")
    return 0


def _recover(options) -> int:
    output = [options.output]
    check_outputs(output, inputs=[options.recording], tables=output, force=options.force)
    recording = Recording.load(options.recording, unfinished=True)
    if not len(recording.time):
        raise LimbError(f"{options.recording} has no samples; there is nothing to recover.")
    recording.save(options.output)
    print(f"recovered   {len(recording.time)} samples, {recording.time[-1]:.2f} s")
    for line in trouble(recording):
        print(line)
    print(f"written     {options.output}")
    return 0


def _emulate(options) -> int:
    check_outputs([options.log], inputs=[options.limb], force=options.force)
    limb = LimbParameters.load(options.limb) if options.limb else LimbParameters()
    twin = LimbTwin(limb, seed=options.emulated, extra=options.extra)
    emulate(twin, options.do, options.log)
    return 0


_COMMANDS = {
    "ports": _ports,
    "status": _status,
    "arm-check": _arm_check,
    "board-check": _board_check,
    "replay": _replay,
    "follow": _follow,
    "learn": _learn,
    "teach": _teach,
    "recover": _recover,
    "emulate": _emulate,
}
