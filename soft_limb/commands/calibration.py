"""``python -m calibration``: collects recordings, fits a limb to them, validates it."""

import argparse
import json
from pathlib import Path
from typing import Any

from calibration import (
    calibrate,
    collect_from_robot,
    collect_from_twin,
    save_recordings,
    validate,
)
from calibration.calibrate import METHODS
from calibration.collecting.protocol import PROTOCOLS
from calibration.recordings.checks import check_recording
from hardware import BoardLink, LimbTwin, SerialLimb
from hardware.emulation.specimen import EXTRA_EFFECTS
from limb_systems import LimbError, LimbParameters, Recording
from limb_systems.output import OutputError, check_folder, check_outputs
from soft_limb.command import add_force_option, run_command
from soft_limb.live.options import add_live_options, live_page
from soft_limb.live.page import LivePage
from soft_limb.reports.calibration import (
    calibration_facts,
    calibration_summary,
    validation_facts,
    validation_summary,
    write_report,
    write_validation_report,
)
from soft_limb.reports.calibration_figures import plot_validation


def main(arguments: list[str] | None = None, prog: str = "python -m calibration") -> int:
    options = _parser(prog).parse_args(arguments)
    command = {"collect": _collect, "fit": _fit, "validate": _validate}[options.command]
    return run_command(
        lambda: command(options), "stopped; finished recordings are kept, and wires are off"
    )


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=prog,
        description="Calibrates a limb from recordings of its sag, its ring-down and heated "
        "equilibria.",
        epilog="exit status: 0 done, 1 it could not be done, 2 wrong usage, 130 stopped by Ctrl-C",
    )
    commands = parser.add_subparsers(dest="command", required=True)

    collect = commands.add_parser(
        "collect",
        help="record all that calibration needs, on a robot or an emulated limb",
        description="Records trials of the sag under gravity, ring-downs from 45°, equilibria "
        "held with one wire after the other and with all of them, and pulses, ramps, random "
        "levels and motions. After each of these it says how well it was predicted. A robot is "
        "recorded in real time, in some 65 minutes, or 30 without equilibria; the program says "
        "when to remount or hold the limb. Started again, it keeps recordings that are complete. "
        "An emulated limb takes a minute.",
    )
    collect.add_argument(
        "-o", "--output", required=True, type=Path, help="folder to write the recordings to"
    )
    collect.add_argument(
        "-l",
        "--limb",
        type=Path,
        help="description of the limb (.yaml); the nominal one if left out",
    )
    collect.add_argument(
        "-p", "--port", help="of the robot: a serial port or any URL that pyserial accepts"
    )
    collect.add_argument(
        "--emulated",
        type=int,
        default=0,
        metavar="SEED",
        help="seed of the emulated limb that is recorded without a port (default %(default)s)",
    )
    collect.add_argument(
        "--extra",
        action="append",
        default=[],
        choices=EXTRA_EFFECTS,
        help="an effect that the emulated limb has beside those of every limb",
    )
    collect.add_argument(
        "--angles", type=int, default=8, help="equilibria in each recording (default %(default)s)"
    )
    collect.add_argument(
        "--seed",
        type=int,
        default=0,
        help="of random equilibria, pulses and levels (default %(default)s)",
    )
    collect.add_argument(
        "--protocol",
        choices=PROTOCOLS,
        default="all",
        help="paper: sag, ring-downs and equilibria, as in Sec. V; excitation: in place of the "
        "equilibria pulses, ramps, random levels and motions; all of them (default %(default)s)",
    )
    add_live_options(collect)
    add_force_option(collect)

    fit = commands.add_parser(
        "fit",
        help="fit a limb to a folder of recordings",
        description="Fits stiffness, damping and the wires' laws to recordings. Files named sag*, "
        "ring_down*, both*, heated*, motion* or as a wire, such as right*, must contain what the "
        "name says; the kind of other files is taken from their data.",
    )
    fit.add_argument("recordings", type=Path, help="folder of recordings (.csv)")
    fit.add_argument(
        "-o", "--output", required=True, type=Path, help="limb parameters to write (.yaml)"
    )
    fit.add_argument(
        "--report",
        type=Path,
        help="page to write, with every fit over its data in charts to look into (.html)",
    )
    fit.add_argument(
        "-l",
        "--limb",
        type=Path,
        help="the limb's description (.yaml), whose geometry and mass are kept; that in the "
        "recordings if left out",
    )
    fit.add_argument(
        "--method",
        choices=METHODS,
        default="prediction",
        help="prediction: compares laws of the wires by how they predict recordings that were left "
        "out; paper: the paper's law by Sec. V (default %(default)s)",
    )
    fit.add_argument("--json", action="store_true", help="print JSON")
    add_force_option(fit)

    check = commands.add_parser(
        "validate",
        help="compare a calibrated limb with a recording, open loop",
        description="Simulates the duty of a recording open loop and compares bend angle and "
        "temperature.",
    )
    check.add_argument("limb", type=Path, help="limb parameters (.yaml)")
    check.add_argument("recording", type=Path, help="recording with heated wires (.csv)")
    check.add_argument("--plot", type=Path, help="picture of both to write (.png, .pdf, .svg)")
    check.add_argument(
        "--report", type=Path, help="page on both to write, with a chart to look into (.html)"
    )
    check.add_argument("--json", action="store_true", help="print JSON")
    add_force_option(check)
    return parser


def _collect(options) -> int:
    check_folder(options.output)
    limb = LimbParameters.load(options.limb) if options.limb else LimbParameters()
    if options.port:
        with BoardLink(options.port) as link:  # before anybody mounts the limb in vain
            link.sample()
        with live_page(options) as live:
            collect_from_robot(
                lambda parameters: SerialLimb(options.port, parameters),
                limb,
                options.output,
                lambda what: _ask(what, live),
                seed=options.seed,
                num_angles=options.angles,
                protocol=options.protocol,
                tell=print,
                live=live,
            )
        return 0
    if not options.force and any(options.output.glob("*.csv")):
        raise OutputError(
            f"{options.output} holds recordings; give another folder, or --force to replace them."
        )
    with live_page(options) as live:
        recordings = collect_from_twin(
            LimbTwin(limb, seed=options.emulated, extra=options.extra),
            seed=options.seed,
            num_angles=options.angles,
            protocol=options.protocol,
            tell=print,
            live=live,
        )
    for path in save_recordings(recordings, options.output):
        print(f"written     {path}")
    return 0


def _ask(what: str, live: LivePage | None) -> None:
    """Asks the operator to do something, and waits until it is done."""
    if live:
        live.say(f"{what} Press Enter in the terminal when this is done.")
    try:
        input(f"{what}\nPress Enter when this is done. ")
    except EOFError:
        raise LimbError("There is no terminal to press Enter in; run this in one.") from None


def _fit(options) -> int:
    check_outputs(
        [options.output, options.report],
        inputs=[options.limb, *options.recordings.glob("*.csv")],
        force=options.force,
    )
    limb = LimbParameters.load(options.limb) if options.limb else None
    calibration = calibrate(options.recordings, limb, method=options.method)
    calibration.parameters.save(options.output)
    if options.report:
        recordings = {path.stem: path for path in sorted(options.recordings.glob("*.csv"))}
        data = {"calibrated limb": options.output, **recordings}
        write_report(calibration, options.report, data)
    written = [path for path in (options.output, options.report) if path]
    _tell(options, calibration_facts(calibration), calibration_summary(calibration), written)
    return 0


def _validate(options) -> int:
    check_outputs(
        [options.plot, options.report],
        inputs=[options.limb, options.recording],
        pictures=[options.plot],
        force=options.force,
    )
    limb, recording = LimbParameters.load(options.limb), Recording.load(options.recording)
    check_recording(recording)
    validation = validate(limb, recording)
    if options.plot:
        # Matplotlib takes as long to import as all the rest.
        from limb_systems.views.plots import save_figure

        save_figure(plot_validation(validation), options.plot)
    if options.report:
        data = {"limb": options.limb, "recording": options.recording}
        write_validation_report(validation, options.report, data)
    written = [path for path in (options.plot, options.report) if path]
    _tell(options, validation_facts(validation), validation_summary(validation), written)
    return 0


def _tell(options, facts: dict[str, Any], summary: str, written: list[Path]) -> None:
    if options.json:
        print(json.dumps({**facts, "written": [str(path) for path in written]}))
        return
    print(summary)
    for path in written:
        print(f"written     {path}")
