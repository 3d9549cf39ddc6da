"""Commands that record the data for calibration, fit a limb to the data, and validate the limb."""

import argparse
import contextlib
import itertools
import shlex
import sys
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
from calibration.recordings.files import folder_of_limb, read_folder, select_usable
from calibration.recordings.recording_checks import check_recording, check_without_gaps
from calibration.wire_directions import WrongDescriptionError
from hardware import LimbTwin, SerialLimb
from hardware.board.link import BoardLink
from hardware.emulation.specimen import Specimen
from hardware.live_feed import LiveView
from limb_systems import LimbError, LimbParameters, Recording
from limb_systems.connected_limbs import ConnectedLimbs, connected, load_description
from limb_systems.files.output import OutputError, check_folder, check_outputs, free_path
from limb_systems.progress import progress_prefix
from limb_systems.summary import Entry, Summary
from soft_limb.commands.logs import EXIT_QUESTIONS, fit_command, shell_command
from soft_limb.commands.options import (
    Command,
    Option,
    checked_outputs,
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

ROBOT_FILE = "robot.yaml"  # description of the robot, beside the folders of its limbs


def _collect(options: argparse.Namespace) -> int:
    # Load the limb, or the limbs of a robot; a single limb has an empty name.
    check_folder(options.output)
    described = load_description(options.limb)
    robot: ConnectedLimbs | None = None
    if isinstance(described, ConnectedLimbs):
        robot = described
        limbs = _limbs_to_record(robot, options)
    else:
        limbs = {"": described}
    # Keep recordings that exist; an emulated limb would replace them.
    folders = {name: options.output / name for name in limbs}
    if not options.port and not options.force:
        for folder in folders.values():
            if any(folder.glob("*.csv")):
                raise OutputError(
                    f"{folder} holds recordings; give another folder, or --force to replace them."
                )
    # Check that all boards answer before the operator mounts a limb.
    if options.port:
        for name, limb in limbs.items():
            with BoardLink(_port(options, name), limb) as link:
                link.sample()
    # Record one limb after the other.
    written: list[Path] = []
    all_are_heated = True
    if robot:
        robot.save(options.output / ROBOT_FILE)
        written.append(options.output / ROBOT_FILE)
    with live_page(options) as live:
        for name, limb in limbs.items():
            recordings, paths = _collect_limb(options, limb, robot, name, live)
            written += paths
            if not select_usable(recordings).heated:
                all_are_heated = False
    # Print the command that fits the limbs, unless a limb has no heated wire.
    line = fit_command(options.output, "robot_calibrated" if robot else "limb")
    summary = Summary.of({"next": line if all_are_heated else ""}, {})
    print_summary(options, summary, None if options.port else written)
    return 0


def _collect_limb(
    options: argparse.Namespace,
    limb: LimbParameters,
    robot: ConnectedLimbs | None,
    name: str,
    live: LiveView | None,
) -> tuple[dict[str, list[Recording]], list[Path]]:
    """Record one limb, of a robot if it has a name.

    Returns:
        Its recordings by kind, and the files of an emulated limb.
    """
    prefix = f"{name}: " if name else ""
    folder = options.output / name
    settings = {
        "seed": options.seed,
        "num_angles": options.angles,
        "protocol": options.protocol,
        "tell": lambda step: print(f"{prefix}{step}", flush=True),
        "live": live,
    }
    with progress_prefix(name) if name else contextlib.nullcontext():
        # Record a robot's limb: the function saves each recording when it is complete.
        if options.port:
            port = _port(options, name)
            collect_from_robot(
                lambda parameters: SerialLimb(port, parameters),
                limb,
                folder,
                lambda request: _ask_operator(f"{prefix}{request}", live),
                **settings,
            )
            return read_folder(folder)[0], []
        # Record an emulated limb.
        if robot:
            specimen = connected("specimen")(robot, options.emulated, options.extra).limb(name)
            twin = LimbTwin(specimen=specimen)
        else:
            physics = {"extra": options.extra, "physics": options.physics}
            twin = LimbTwin(limb, seed=options.emulated, **physics)
        recordings = collect_from_twin(twin, **settings)
        return recordings, save_recordings(recordings, folder)


def _port(options: argparse.Namespace, name: str) -> str:
    """Return the port of a limb of a robot, or of a single limb, whose name is empty."""
    if not name and isinstance(options.port, dict):
        raise LimbError(
            f"Ports are given for {', '.join(options.port)}, but this is a single limb; give "
            "--port PORT, or the description of a robot by -l."
        )
    return options.port[name] if name else options.port


def _limbs_to_record(
    robot: ConnectedLimbs, options: argparse.Namespace
) -> dict[str, LimbParameters]:
    """Return the limbs of a robot to record, by name: all, or the limbs with a port."""
    # Check that each port belongs to a limb.
    names = [limb.name for limb in robot.limbs]
    if options.port and not isinstance(options.port, dict):
        raise LimbError(
            f"{options.port} is the port of one board, but each limb of a robot is recorded on its "
            f"own board; give --port NAME=PORT for {', '.join(names)}."
        )
    if unknown := set(options.port or ()) - {*names}:
        raise LimbError(
            f"A port is given for {', '.join(sorted(unknown))}, but the limbs of this robot are "
            f"{', '.join(names)}."
        )
    if options.physics != Specimen.physics:
        raise LimbError(
            f"Robots are emulated with the physics {Specimen.physics}, not {options.physics}; "
            "leave --physics out."
        )
    return {name: robot.limb_alone(name) for name in names if name in (options.port or names)}


def _ask_operator(request: str, live: LiveView | None) -> None:
    """Ask the operator to do something, and wait for the Enter key."""
    if live:
        live.say(f"{request} Press Enter in the terminal when this is done.")
    try:
        input(f"{request}\nPress Enter when this is done. ")
    except EOFError:
        raise LimbError(
            "collect asks for the Enter key, but there is no terminal; run it in a terminal."
        ) from None


def _fit(options: argparse.Namespace) -> int:
    # Find the folder of each limb; a single limb has an empty name.
    robot = _recorded_robot(options)
    if robot:
        all_folders = {limb.name: options.recordings / limb.name for limb in robot.limbs}
        folders = {name: folder for name, folder in all_folders.items() if folder.is_dir()}
        if not folders:
            missing = ", ".join(map(str, all_folders.values()))
            raise LimbError(
                f"No limb of this robot has a folder with recordings; {missing} are missing: "
                "record the limbs with soft-limb collect."
            )
    else:
        folders = {"": folder_of_limb(options.recordings)}
    recorded = {name: sorted(folder.glob("*.csv")) for name, folder in folders.items()}
    # Check the outputs before the fit, which takes minutes: each limb has its own report.
    report: Path | None = options.report
    reports: dict[str, Path] = {}
    for name in folders:
        if report:
            reports[name] = report.with_stem(f"{report.stem}_{name}") if name else report
    outputs = [options.output, *reports.values()]
    recordings = itertools.chain(*recorded.values())
    inputs = [options.limb, *recordings]
    check_outputs(outputs, inputs=inputs, pages=[report], force=options.force)
    # Fit one limb after the other.
    summaries = {}
    limbs = {}
    forbidden: list[str] = []
    for name, folder in folders.items():
        described = None
        if options.limb:
            described = robot.limb_alone(name) if robot else LimbParameters.load(options.limb)
        try:
            with progress_prefix(name) if name else contextlib.nullcontext():
                calibration = calibrate(
                    folder,
                    described,
                    method=options.method,
                    counted_limit=options.counted_limit,
                    as_described=options.as_described,
                    announce=lambda line: print(line, file=sys.stderr, flush=True),
                )
        except WrongDescriptionError as question:
            # Save the description that the data suggest, and let the user decide.
            corrected = robot.with_limbs({name: question.corrected}) if robot else None
            path = free_path(options.output.with_stem(f"{options.output.stem}_described"))
            (corrected or question.corrected).save(path)
            line = shell_command("fit", options.recordings, "-o", options.output)
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
            return EXIT_QUESTIONS
        if name in reports:
            data = {path.stem: path for path in recorded[name]}
            write_report(calibration, reports[name], {"calibrated limb": options.output, **data})
        # Note limbs that must not be planned with.
        if not calibration.may_be_planned_with:
            forbidden.append(name)
        limbs[name] = calibration.parameters
        summaries[name] = calibration_summary(calibration)
    # Write the limb last, so that Ctrl-C before leaves none.
    if robot is None:
        limbs[""].save(options.output)
        print_summary(options, summaries[""], outputs)
        return _exit_status(options.output, forbidden)
    robot.with_limbs(limbs).save(options.output)
    # Print the result of each limb, and the next commands.
    not_fitted = [limb.name for limb in robot.limbs if limb.name not in limbs]
    entries = []
    for name, each in summaries.items():
        entries.append(Entry(name, each.to_json(), "", f"{each}\n"))
    entries.append(Entry("as_described", not_fitted, sentence=", ".join(not_fitted) or None))
    for words in robot.commands_after_fit(options.output):
        entries.append(Entry("next", sentence=shell_command(*words)))
    print_summary(options, Summary(entries), outputs)
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


def _recorded_robot(options: argparse.Namespace) -> ConnectedLimbs | None:
    """Return the robot that the recordings or ``--limb`` describe; None for a single limb."""
    path = options.limb or options.recordings / ROBOT_FILE
    if not options.limb and not path.is_file():
        return None
    described = load_description(path)
    return described if isinstance(described, ConnectedLimbs) else None


def _validate(options: argparse.Namespace) -> int:
    # Check and load the files.
    outputs = checked_outputs(options, options.limb, options.recording)
    limb = LimbParameters.load(options.limb)
    recording = Recording.load(options.recording)
    check_recording(recording)
    check_without_gaps(recording)
    # Simulate the duty, and write the results.
    validation = validate(limb, recording)
    save_panels(validation_panels(validation), options.plot)
    if options.report:
        data = {"limb": options.limb, "recording": options.recording}
        write_validation_report(validation, options.report, data)
    # Print the errors.
    print_summary(options, validation_summary(validation), outputs)
    return 0


COMMANDS = {
    "collect": Command(
        _collect,
        "Record the data that calibration needs: the sag under gravity, ring-downs from 45°, "
        "equilibria with each wire and with all wires heated, and responses to pulses, ramps, "
        "random levels and motions. A limb that bends in space is mounted turned about its axis by "
        "0°, 90°, 180° and 270° in place of sag, equilibria, pulses and ramps.\n"
        "\n"
        "On a robot this takes about 65 minutes in real time, or 30 without equilibria; the "
        "program asks you to remount or hold the limb. After an interruption, run it again: "
        "complete recordings are kept. An emulated limb takes about a minute. The limbs of a robot "
        "are dismounted and recorded one after the other, each into a folder of its name.",
        "folder port emulated extra physics live force",
        [
            shared(
                "limb",
                help="parameters of a limb or of a robot (.yaml); the nominal limb if left out",
            ),
            Option(
                "--angles",
                type=int,
                default=8,
                help="number of equilibria in each recording (default %(default)s)",
            ),
            Option(
                "--seed",
                type=int,
                default=0,
                help="seed of the random equilibria, pulses and levels (default %(default)s)",
            ),
            Option(
                "--protocol",
                choices=PROTOCOLS,
                default="all",
                help="paper: sag, ring-downs and equilibria, as in Sec. V of the paper; "
                "excitation: pulses, ramps, random levels and motions in place of the equilibria; "
                "all: both (default %(default)s)",
            ),
        ],
        stopped="stopped; complete recordings of a robot are kept, and wires are off",
        examples=[
            "soft-limb collect -o out/recordings/ -l limb.yaml",
            "soft-limb collect -o out/robot/ -l robot.yaml",
        ],
    ),
    "fit": Command(
        _fit,
        "Fit stiffness, damping and the laws of the wires to recordings. The header of a recording "
        "names its kind, such as sag; collect and import write it. The kind of any other file is "
        "taken from its data, or, if wires are heated and the name of the file begins with heated "
        "or motion, from its name. Recordings that cannot be used are left out, with a remark that "
        "says why. The limbs of a robot, each in a folder of its name, are fitted one after the "
        "other, and the robot is saved with all of them.",
        "report json force",
        [
            Option(
                "recordings",
                type=Path,
                help="folder of recordings (.csv); for a robot, a folder with one such folder for "
                "each limb",
            ),
            shared("output", help="parameters of the limb or robot to write (.yaml)"),
            shared(
                "limb",
                help="description of the limb or robot (.yaml): its geometry and mass are kept; if "
                "left out, robot.yaml in the folder, or else the description in the recordings",
            ),
            Option(
                "--method",
                choices=METHODS,
                default="prediction",
                help="prediction: fit several laws and choose the law that best predicts "
                "recordings left out of its fit; paper: the law and the method of Sec. V of the "
                "paper (default %(default)s)",
            ),
            Option(
                "--as-described",
                action="store_true",
                help="trust the places of wires and bend sensor in the description, even if the "
                "recordings contradict them",
            ),
            Option(
                "--counted-limit",
                type=float,
                metavar="C",
                help="for a limb without thermocouples: highest wire temperature of plans, °C, "
                "computed from the duty with the described a2; the highest temperature in the "
                "recordings if left out",
            ),
        ],
        stopped="stopped; nothing was written",
        examples=[
            "soft-limb fit out/recordings/ -o out/calibrated.yaml --report out/calibration.html"
        ],
    ),
    "validate": Command(
        _validate,
        "Simulate a limb with the duty of a recording, open loop, and compare bend angle and "
        "temperature with the recording.",
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
