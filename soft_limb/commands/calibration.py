"""Commands that record what calibration needs, fit a limb to it, and validate the limb."""

import argparse
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
from calibration.collecting.protocol import PROTOCOLS
from calibration.recordings.checks import check_recording, check_without_gaps
from calibration.recordings.files import folder_of_limb, read_folder, usable
from hardware import LimbTwin, SerialLimb
from hardware.robot.text_link import open_link
from limb_systems import LimbError, LimbParameters, Recording
from limb_systems.output import OutputError, check_folder, check_outputs
from limb_systems.summary import Summary
from soft_limb.commands.logs import fit_line
from soft_limb.commands.options import (
    Command,
    Option,
    live_page,
    print_summary,
    shared,
    text_board,
)
from soft_limb.live.page import LivePage
from soft_limb.reports.calibration import (
    plot_validation,
    write_report,
    write_validation_report,
)
from soft_limb.results.summaries import calibration_summary, validation_summary


def _collect(options: argparse.Namespace) -> int:
    check_folder(options.output)
    limb = LimbParameters.of(options.limb)
    if board := text_board(options):
        board.check_measures(board.unmeasured, "Calibration")
    if options.port:
        with open_link(options.port, limb, board) as link:  # before anybody mounts the limb in vain
            link.sample()
        with live_page(options) as live:
            collect_from_robot(
                lambda parameters: SerialLimb(options.port, parameters, board=board),
                limb,
                options.output,
                lambda what: _ask(what, live),
                seed=options.seed,
                num_angles=options.angles,
                protocol=options.protocol,
                tell=print,
                live=live,
            )
        print_summary(options, _fit_next(options.output))
        return 0
    if not options.force and any(options.output.glob("*.csv")):
        raise OutputError(
            f"{options.output} holds recordings; give another folder, or --force to replace them."
        )
    with live_page(options) as live:
        recordings = collect_from_twin(
            LimbTwin(limb, seed=options.emulated, extra=options.extra, physics=options.physics),
            seed=options.seed,
            num_angles=options.angles,
            protocol=options.protocol,
            tell=print,
            live=live,
        )
    paths = save_recordings(recordings, options.output)
    print_summary(options, _fit_next(options.output), paths)
    return 0


def _fit_next(folder: Path) -> Summary:
    """The command that fits a limb to a folder, if it can."""
    recordings, _ = read_folder(folder)
    line = fit_line(folder) if usable(recordings).heated else ""
    return Summary.of({"next": line}, {})


def _ask(what: str, live: LivePage | None) -> None:
    """Asks the operator to do something, and waits until it is done."""
    if live:
        live.say(f"{what} Press Enter in the terminal when this is done.")
    try:
        input(f"{what}\nPress Enter when this is done. ")
    except EOFError:
        raise LimbError("There is no terminal to press Enter in; run this in one.") from None


def _fit(options: argparse.Namespace) -> int:
    folder, outputs = folder_of_limb(options.recordings), [options.output, options.report]
    recorded = sorted(folder.glob("*.csv"))
    check_outputs(outputs, inputs=[options.limb, *recorded], force=options.force)
    limb = LimbParameters.load(options.limb) if options.limb else None
    calibration = calibrate(
        folder,
        limb,
        method=options.method,
        announce=lambda said: print(said, file=sys.stderr, flush=True),
    )
    if options.report:
        recordings = {path.stem: path for path in recorded}
        write_report(calibration, options.report, {"calibrated limb": options.output, **recordings})
    calibration.parameters.save(options.output)  # last, so that Ctrl-C before leaves no limb
    print_summary(options, calibration_summary(calibration), outputs)
    return 0


def _validate(options: argparse.Namespace) -> int:
    outputs, inputs = [options.plot, options.report], [options.limb, options.recording]
    check_outputs(outputs, inputs=inputs, pictures=[options.plot], force=options.force)
    limb, recording = LimbParameters.load(options.limb), Recording.load(options.recording)
    check_recording(recording)
    check_without_gaps(recording)
    validation = validate(limb, recording)
    if options.plot:
        # Matplotlib takes as long to import as all the rest.
        from limb_systems.views.plots import save_figure

        save_figure(plot_validation(validation), options.plot)
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
        "270°, in place of sag, equilibria, pulses and ramps.",
        "folder limb port text emulated extra physics live address force",
        [
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
        examples=["soft-limb collect -o out/recordings/ -l limb.yaml"],
    ),
    "fit": Command(
        _fit,
        "Fits stiffness, damping and the wires' laws to recordings. What each is for is in its "
        "header, where collect and import write it; other files go by what they show, and where "
        "that is heat and their names begin so, are of the kind heated or motion. What cannot be "
        "used is left out, and a remark says why.",
        "report json force",
        [
            Option("recordings", type=Path, help="folder of recordings (.csv)"),
            shared("output", help="limb parameters to write (.yaml)"),
            shared(
                "limb",
                help="the limb's description (.yaml), whose geometry and mass are kept; that in "
                "the recordings if left out",
            ),
            Option(
                "--method",
                choices=METHODS,
                default="prediction",
                help="prediction: compares laws of the wires by how they predict recordings that "
                "were left out; paper: the paper's law by Sec. V (default %(default)s)",
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
