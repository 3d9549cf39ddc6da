"""Commands that record what calibration needs, fit a limb to it, and validate the limb."""

import argparse
import contextlib
import itertools
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from calibration import (
    calibrate,
    collect_from_robot,
    collect_from_twin,
    save_recordings,
    validate,
)
from calibration.calibrate import METHODS
from calibration.collecting.measurement_protocol import PROTOCOLS
from calibration.recordings.files import folder_of_limb, read_folder, usable_recordings
from calibration.recordings.recording_checks import check_recording, check_without_gaps
from calibration.wire_directions import WrongDescriptionError
from hardware import LimbTwin, SerialLimb
from hardware.board.link import BoardLink
from hardware.emulation.specimen import Specimen
from hardware.live_feed import LiveView
from limb_systems import LimbError, LimbParameters, Recording
from limb_systems.connected_limbs import ConnectedLimbs, connected, load_described
from limb_systems.files.output import OutputError, check_folder, check_outputs, free_path
from limb_systems.progress import part_of_work
from limb_systems.summary import Entry, Summary
from soft_limb.commands.logs import ASKED, fit_line, shell_line
from soft_limb.commands.options import (
    Command,
    Option,
    live_page,
    print_summary,
    save_panels,
    shared,
)
from soft_limb.reports.calibration_report import (
    validation_panels,
    write_report,
    write_validation_report,
)
from soft_limb.results.summaries import calibration_summary, validation_summary

ROBOT = "robot.yaml"  # description of the robot, in the folder with the folders of its limbs


def _collect(options: argparse.Namespace) -> int:
    check_folder(options.output)
    described = load_described(options.limb)
    robot: ConnectedLimbs | None = None
    if isinstance(described, ConnectedLimbs):
        robot = described
        limbs = _limbs_to_record(robot, options)
    else:
        limbs = {"": described}
    folders = {name: options.output / name for name in limbs}
    if not options.port and not options.force:
        recorded = [folder for folder in folders.values() if any(folder.glob("*.csv"))]
        if recorded:
            raise OutputError(
                f"{recorded[0]} holds recordings; give another folder, or --force to replace them."
            )
    for name, limb in limbs.items() if options.port else ():
        with BoardLink(_port(options, name), limb) as link:  # before it is mounted in vain
            link.sample()
    written: list[Path] = []
    if robot:
        robot.save(options.output / ROBOT)
        written.append(options.output / ROBOT)
    with live_page(options) as live:
        written += [
            path
            for name, limb in limbs.items()
            for path in _collect_limb(options, limb, robot, name, live)
        ]
    told = _fit_next(options.output, [*folders.values()])
    print_summary(options, told, None if options.port else written)
    return 0


def _collect_limb(
    options: argparse.Namespace,
    limb: LimbParameters,
    robot: ConnectedLimbs | None,
    name: str,
    live: LiveView | None,
) -> list[Path]:
    """Record one limb, of a robot if it has a name; return the files of an emulated limb."""
    about, folder = f"{name}: " if name else "", options.output / name
    chosen = {
        "seed": options.seed,
        "num_angles": options.angles,
        "protocol": options.protocol,
        "tell": lambda what: print(f"{about}{what}", flush=True),
        "live": live,
    }
    with part_of_work(name) if name else contextlib.nullcontext():
        if options.port:
            port = _port(options, name)
            collect_from_robot(
                lambda parameters: SerialLimb(port, parameters),
                limb,
                folder,
                lambda what: _ask(f"{about}{what}", live),
                **chosen,
            )
            return []
        if robot:
            specimen = connected("specimen")(robot, options.emulated, options.extra).limb(name)
            twin = LimbTwin(specimen=specimen)
        else:
            of_limb = {"extra": options.extra, "physics": options.physics}
            twin = LimbTwin(limb, seed=options.emulated, **of_limb)
        return save_recordings(collect_from_twin(twin, **chosen), folder)


def _port(options: argparse.Namespace, name: str) -> str:
    """The port of a limb, or of the only one, whose name is empty."""
    return options.port[name] if name else options.port


def _limbs_to_record(
    robot: ConnectedLimbs, options: argparse.Namespace
) -> dict[str, LimbParameters]:
    """The limbs of a robot that are recorded, one after the other: all, or those with a port.

    Raises:
        LimbError: if a port is not that of a limb, or the robot's emulation has no such choice.
    """
    names = [limb.name for limb in robot.limbs]
    if options.port and not isinstance(options.port, dict):
        raise LimbError(
            f"{options.port} is the port of one board, but the limbs of a robot are recorded each "
            f"on a board of its own; give --port NAME=PORT for {', '.join(names)}."
        )
    if others := set(options.port or ()) - {*names}:
        raise LimbError(
            f"This robot has no limb {', '.join(sorted(others))}, for which a port is given; it "
            f"has {', '.join(names)}."
        )
    if options.physics != Specimen.physics:
        raise LimbError(
            f"Robots are emulated with the physics {Specimen.physics}, not {options.physics}; "
            "leave --physics out."
        )
    return {name: robot.limb_alone(name) for name in names if name in (options.port or names)}


def _fit_next(folder: Path, of_limbs: Sequence[Path]) -> Summary:
    """The command that fits a limb, or the limbs of a robot, to a folder, if it can."""
    usable_each = [usable_recordings(read_folder(own)[0]).heated for own in of_limbs]
    name = "limb" if list(of_limbs) == [folder] else "robot_calibrated"
    line = fit_line(folder, name) if all(usable_each) else ""
    return Summary.of({"next": line}, {})


def _ask(what: str, live: LiveView | None) -> None:
    """Asks the operator to do something, and waits until it is done."""
    if live:
        live.say(f"{what} Press Enter in the terminal when this is done.")
    try:
        input(f"{what}\nPress Enter when this is done. ")
    except EOFError:
        raise LimbError("There is no terminal to press Enter in; run this in one.") from None


def _fit(options: argparse.Namespace) -> int:
    robot = _robot_recorded(options)
    if robot:
        folders = {limb.name: options.recordings / limb.name for limb in robot.limbs}
        folders = {name: folder for name, folder in folders.items() if folder.is_dir()}
        if not folders:
            names = ", ".join(str(options.recordings / limb.name) for limb in robot.limbs)
            raise LimbError(
                f"There is no folder with recordings of a limb of this robot, such as {names}; "
                "make them by soft-limb collect."
            )
    else:
        folders = {"": folder_of_limb(options.recordings)}
    recorded = {name: sorted(folder.glob("*.csv")) for name, folder in folders.items()}
    report: Path | None = options.report
    reports = {
        name: report.with_stem(f"{report.stem}_{name}") if name else report
        for name in folders
        if report
    }
    outputs = [options.output, *reports.values()]
    every = itertools.chain(*recorded.values())
    check_outputs(outputs, inputs=[options.limb, *every], force=options.force)
    summaries, limbs = {}, {}
    forbidden: list[str] = []
    for name, folder in folders.items():
        described = None
        if options.limb:
            described = robot.limb_alone(name) if robot else LimbParameters.load(options.limb)
        try:
            with part_of_work(name) if name else contextlib.nullcontext():
                calibration = calibrate(
                    folder,
                    described,
                    method=options.method,
                    counted_limit=options.counted_limit,
                    as_described=options.as_described,
                    announce=lambda said: print(said, file=sys.stderr, flush=True),
                )
        except WrongDescriptionError as question:
            corrected = robot.with_limbs({name: question.corrected}) if robot else None
            path = free_path(options.output.with_stem(f"{options.output.stem}_described"))
            (corrected or question.corrected).save(path)
            line = shell_line("fit", options.recordings, "-o", options.output)
            confirmed = f"{line} --as-described"
            if options.limb:
                confirmed = f"{line} -l {shlex.quote(str(options.limb))} --as-described"
            print(
                f"question: {question} Is that so? See which output of the board is wired to which "
                "wire, and how the sensor is mounted. If it is, run: "
                f"{line} -l {shlex.quote(str(path))} --as-described\n"
                f"If the description is right, run: {confirmed}",
                file=sys.stderr,
            )
            return ASKED
        if name in reports:
            data = {path.stem: path for path in recorded[name]}
            write_report(calibration, reports[name], {"calibrated limb": options.output, **data})
        if not calibration.may_be_planned_with:
            forbidden.append(name)
        limbs[name], summaries[name] = calibration.parameters, calibration_summary(calibration)
    # Written last, so that Ctrl-C before leaves no limb.
    if robot is None:
        limbs[""].save(options.output)
        print_summary(options, summaries[""], outputs)
        return _exit_status(options.output, forbidden)
    robot.with_limbs(limbs).save(options.output)
    kept = [limb.name for limb in robot.limbs if limb.name not in limbs]
    told = [Entry(name, each.to_json(), "", f"{each}\n") for name, each in summaries.items()]
    told += [Entry("as_described", kept, sentence=", ".join(kept) or None)]
    told += [
        Entry("next", sentence=shell_line(*words))
        for words in robot.commands_after_fit(options.output)
    ]
    print_summary(options, Summary(told), outputs)
    return _exit_status(options.output, forbidden)


def _exit_status(output: Path, forbidden: list[str]) -> int:
    """Return 1, and print why, if there are limbs whose verdict forbids plans; 0 otherwise."""
    for name in forbidden:
        limb = f"the limb {name} in {output}" if name else str(output)
        print(
            f"error: Do not plan with {limb}: its remarks that begin with stop say why, and what "
            "to record or mend. The file is for looking at.",
            file=sys.stderr,
        )
    return 1 if forbidden else 0


def _robot_recorded(options: argparse.Namespace) -> ConnectedLimbs | None:
    """The robot whose limbs were recorded in the folders of a folder; None if it is of a limb."""
    path = options.limb or options.recordings / ROBOT
    if not options.limb and not path.is_file():
        return None
    described = load_described(path)
    return described if isinstance(described, ConnectedLimbs) else None


def _validate(options: argparse.Namespace) -> int:
    outputs, inputs = [options.plot, options.report], [options.limb, options.recording]
    check_outputs(outputs, inputs=inputs, pictures=[options.plot], force=options.force)
    limb, recording = LimbParameters.load(options.limb), Recording.load(options.recording)
    check_recording(recording)
    check_without_gaps(recording)
    validation = validate(limb, recording)
    save_panels(validation_panels(validation), options.plot)
    if options.report:
        data = {"limb": options.limb, "recording": options.recording}
        write_validation_report(validation, options.report, data)
    print_summary(options, validation_summary(validation), outputs)
    return 0


COMMANDS = {
    "collect": Command(
        _collect,
        "Records trials of the sag under gravity, ring-downs from 45°, equilibria held with one "
        "wire after the other and with all of them, and pulses, ramps, random levels and motions. "
        "After each of these it says how well it was predicted. A robot is recorded in real time, "
        "in some 65 minutes, or 30 without equilibria; the program says when to remount or hold "
        "the limb. Started again, it keeps recordings that are complete. An emulated limb takes a "
        "minute. A limb that bends in space is mounted turned about its axis by 0°, 90°, 180° and "
        "270°, in place of sag, equilibria, pulses and ramps. The limbs of a robot are taken off "
        "and recorded one after the other, each into the folder of its name.",
        "folder port emulated extra physics live force",
        [
            shared(
                "limb",
                help="limb parameters (.yaml), or those of a robot, whose limbs are recorded in "
                "turn; the nominal limb if left out",
            ),
            Option(
                "--angles",
                type=int,
                default=8,
                help="equilibria in each recording (default %(default)s)",
            ),
            Option(
                "--seed",
                type=int,
                default=0,
                help="of random equilibria, pulses and levels (default %(default)s)",
            ),
            Option(
                "--protocol",
                choices=PROTOCOLS,
                default="all",
                help="paper: sag, ring-downs and equilibria, as in Sec. V; excitation: in place of "
                "the equilibria pulses, ramps, random levels and motions; all of them (default "
                "%(default)s)",
            ),
        ],
        stopped="stopped; finished recordings are kept, and wires are off",
        examples=[
            "soft-limb collect -o out/recordings/ -l limb.yaml",
            "soft-limb collect -o out/robot/ -l robot.yaml",
        ],
    ),
    "fit": Command(
        _fit,
        "Fits stiffness, damping and the wires' laws to recordings. What each is for is in its "
        "header, where collect and import write it; other files go by what they show, and where "
        "that is heat and their names begin so, are of the kind heated or motion. What cannot be "
        "used is left out, and a remark says why. The limbs of a robot, each in the folder of its "
        "name, are fitted one after the other and put back to the robot.",
        "report json force",
        [
            Option(
                "recordings",
                type=Path,
                help="folder of recordings (.csv), or with a folder of recordings for each limb of "
                "a robot",
            ),
            shared("output", help="parameters of the limb or robot to write (.yaml)"),
            shared(
                "limb",
                help="description of the limb or robot (.yaml), whose geometry and mass are kept; "
                "that in the recordings if left out, and of a robot also robot.yaml beside them",
            ),
            Option(
                "--method",
                choices=METHODS,
                default="prediction",
                help="prediction: compares laws of the wires by how they predict recordings that "
                "were left out; paper: the paper's law by Sec. V (default %(default)s)",
            ),
            Option(
                "--as-described",
                action="store_true",
                help="wires and bend sensor are where the description has them, even if the "
                "recordings do not confirm it",
            ),
            Option(
                "--counted-limit",
                type=float,
                metavar="C",
                help="without thermocouples: the highest wire temperature of plans, °C, as counted "
                "from the duty by a2 as described; the highest of the recordings if left out",
            ),
        ],
        stopped="stopped; nothing was written",
        examples=[
            "soft-limb fit out/recordings/ -o out/calibrated.yaml --report out/calibration.html"
        ],
    ),
    "validate": Command(
        _validate,
        "Simulates the duty of a recording open loop and compares bend angle and temperature.",
        "plot report json force",
        [
            Option("limb", type=Path, help="limb parameters (.yaml)"),
            Option("recording", type=Path, help="recording with heated wires (.csv)"),
        ],
        stopped="stopped; nothing was written",
        examples=[
            "soft-limb validate out/calibrated.yaml out/recording.csv --plot out/validation.png"
        ],
    ),
}
