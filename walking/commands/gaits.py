"""Commands of robots that walk."""

import argparse
import dataclasses
import functools
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from controllers import PlanFeedback
from hardware import SerialLimb
from limb_systems import LimbError, LimbSystem, Recording
from limb_systems.files.output import check_outputs
from limb_systems.progress import Progress
from limb_systems.simulation import PERIOD
from limb_systems.summary import Entry, Summary
from limb_systems.views.panels import motion_panels
from planners import PlanningError
from soft_limb.commands.options import (
    Command,
    Option,
    checked_outputs,
    count,
    print_duration,
    print_summary,
    print_table,
    save_panels,
    shared,
)
from soft_limb.runs.jobs import run_each
from soft_limb.runs.rollout import OPEN_LOOP, record_replay
from walking.commands.gait_summaries import gait_summary, walk_summary
from walking.course import check_course
from walking.gait import Gait
from walking.gait_check import fall_of, simulate_gait, strides_of
from walking.gait_feedback import GaitFeedback
from walking.gait_planning import plan_gait
from walking.gait_program import STEADINESS, STEADINESS_CALIBRATED, STICKING_SHARE
from walking.gait_request import GaitRequest
from walking.gait_set import AHEAD, TURNING, gait_files, load_gaits, plan_gaits, save_gaits
from walking.heat_feedback import HeatFeedback
from walking.robot import Robot
from walking.robot_parameters import RobotParameters
from walking.robot_twin import RobotTwin
from walking.schedules import (
    Schedule,
    check_schedule,
    schedule_of,
    schedule_text,
    sensible_schedules,
)
from walking.strides import StridesFit, fit_strides
from walking.strides_in_space import fit_strides_in_space
from walking.views.robot_panels import way_panel
from walking.walk_trajectory import walk
from walking.walker import check_walker
from walking.wayfinder import LEAST_SHARE, STALLED_CYCLES, Wayfinder

STRIDES, BENDS, HEAT = "gait-feedback", "plan-feedback", "heat-feedback"
OF_ONE_GAIT = ("schedule", "turn", "stride", "speed", "steadiness", "quick", "plot", "report")
FIRST_STRIDES = 2  # after which the gait is planned again
WELL_MADE = 0.9  # of a stride in space, from which on the gait is kept
CAMERA_SLACK = 1.2  # times the tolerance, within which a camera sees a robot that has arrived
STALLS = (
    f"stopped, as {STALLED_CYCLES} cycles in a row made less than {LEAST_SHARE:.0%} of what was "
    "planned; does the robot slip, or is it another than the gait's?"
)
STANDING = 10.0  # s, that an emulated robot stands with its wires off while that is done
_Trial = tuple[Schedule, Gait | None, str]  # with its gait, or why it has none, if it was planned


def _turn(text: str) -> float:
    """A turn in a cycle, rad, of text such as left, right or 10."""
    sides = {"left": np.inf, "right": -np.inf}
    try:
        return sides[text] if text in sides else float(np.deg2rad(float(text)))
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"{text!r} is neither left, nor right, nor a number of degrees"
        ) from error


def _gait(options: argparse.Namespace) -> int:
    if options.set:
        return _gait_set(options)
    outputs = checked_outputs(options, options.robot)
    robot = RobotParameters.of(options.robot)
    check_walker(robot)
    stride = None if options.stride is None else 1e-3 * options.stride
    speed = None if options.speed is None else 1e-3 * options.speed
    request = GaitRequest(
        turn=options.turn,
        stride=stride,
        speed=speed,
        objective=options.objective,
        temperature_margin=options.margin,
        steadiness=options.steadiness,
        sticking_share=options.sticking,
    )
    check_course(robot, request.course)
    schedules = [schedule_of(text, len(robot.limbs)) for text in options.schedule]
    for schedule in schedules:
        check_schedule(schedule, robot)
    schedules = schedules or sensible_schedules(robot)
    request.validate(robot, schedules[0])
    print_duration(
        f"some seconds for each of {len(schedules)} schedules, and five to twenty to check one",
    )
    gait, refused = _best_gait(
        schedules,
        functools.partial(
            _planned, robot, dataclasses.replace(request, explain=len(schedules) == 1)
        ),
        spread=not options.quick,
    )
    if gait is None:
        raise LimbError(
            f"No schedule of {len(schedules)} gives a gait that walks as planned: "
            + "; ".join(f"{schedule!r}, {reason.rstrip('.')}" for schedule, reason in refused)
            + "."
        )
    if refused and not options.json:
        print_table("schedules that were not taken", refused)
    gait.save(options.output)
    save_panels(motion_panels(gait), options.plot)
    if options.report:
        from walking.commands.gait_report import gait_report

        gait_report(gait, options.report, {"gait": options.output})
    print_summary(options, gait_summary(gait), outputs)
    return 0


def _gait_set(options: argparse.Namespace) -> int:
    """Plan the gaits by which a robot in space gets anywhere, into a folder."""
    # Refuse what is about one gait.
    given = [f"--{name}" for name in OF_ONE_GAIT if getattr(options, name)]
    if given:
        raise LimbError(f"--set plans gaits of all directions; leave out {', '.join(given)}.")
    # Check the files before the gaits are planned, which takes minutes.
    check_outputs(gait_files(options.output), inputs=[options.robot], force=options.force)
    robot = RobotParameters.of(options.robot)
    num_processes = min(os.cpu_count() or 1, len(TURNING))
    gaits = plan_gaits(
        robot,
        map_function=functools.partial(run_each, num_processes=num_processes, in_order=True),
        temperature_margin=options.margin,
        sticking_share=options.sticking,
    )
    files = save_gaits(gaits, options.output, force=options.force)
    entries = [Entry(name, sentence=repr(gait)) for name, gait in gaits.items()]
    print_summary(options, Summary(entries), files)
    return 0


def _best_gait(
    schedules: Sequence[Schedule], plan: Callable[..., _Trial], spread: bool
) -> tuple[Gait | None, list[tuple[str, str]]]:
    """Plan a gait of each schedule, and check them, the best first, until one walks as planned.

    Args:
        plan: `_planned` for a robot and an objective.
        spread: whether the check varies ground and parameters.

    Returns:
        The gait that was taken, if any; and each other schedule with why it was not.
    """
    trials: list[_Trial] = [(schedule, None, "") for schedule in schedules]
    if len(schedules) > 1:
        num_processes = min(os.cpu_count() or 1, len(schedules))
        with Progress("planning", len(schedules), "schedules") as progress:
            trials = []
            for trial in run_each(plan, schedules, num_processes):
                trials.append(trial)
                done = [schedule for schedule, *_ in trials]
                left = [schedule_text(each) for each in schedules if each not in done]
                progress.update(len(trials), f"trying {left[0]}" if left else "")
        trials.sort(key=lambda trial: -trial[1].merit if trial[1] else np.inf)
    taken, refused = None, []
    for schedule, gait, reason in trials:
        if gait and taken:
            reason = f"{_pace(gait)}, and another is better"
        elif not reason:
            _, taken, reason = plan(schedule, check=True, spread=spread)
        if reason:
            refused.append((schedule_text(schedule), reason))
    return taken, refused


def _pace(gait: Gait) -> str:
    if gait.on_the_spot:
        return f"{np.rad2deg(gait.turn / gait.period):.2f} °/s"
    return f"{1e3 * gait.speed:.2f} mm/s"


def _planned(
    robot: RobotParameters,
    request: GaitRequest,
    schedule: Schedule,
    check: bool = False,
    spread: bool = True,
) -> _Trial:
    try:
        gait = plan_gait(robot, request, schedule=schedule, check=check, spread=spread)
        return schedule, gait, ""
    except PlanningError as error:
        return schedule, None, str(error)


def _place(text: str) -> list[float]:
    """A place x, y, m, and a heading, rad, if any, of text such as 0.5,0 or 0.5,0,90."""
    try:
        x, y, *heading = map(float, text.split(","))
        if len(heading) > 1 or not np.isfinite([x, y, *heading]).all():
            raise ValueError
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no place such as 0.5,0 (m), or 0.5,0,90 with a heading (°)"
        ) from error
    return [x, y, *np.deg2rad(heading)]


def _go(options: argparse.Namespace) -> int:
    """Walk to places, by gaits of a folder."""
    if options.replan or options.controller:
        raise LimbError("--to chooses gaits stride by stride; leave out --replan and --controller.")
    if options.port:
        raise LimbError(
            "--to needs a camera that sees the body, and there is none on a port; walk there by "
            "one gait, without --to, or connect a Wayfinder and a camera in Python."
        )
    outputs = checked_outputs(options)
    gaits = load_gaits(options.gait)
    ahead = gaits[AHEAD]
    robot, controller = _robot(options, ahead), Wayfinder(gaits, options.to)
    way = np.vstack([[0.0, 0.0], *(goal[:2] for goal in options.to)])
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    # Turning takes cycles, too, and strides may be a third of those planned.
    cycles = int(3 * length / ahead.stride) + 30 * len(options.to)
    most = walk(ahead, cycles)
    recording = record_replay(most, robot, options.output, controller=controller)
    save_panels([way_panel(recording, options.to)], options.plot)
    pose = recording.body_pose
    assert pose is not None, "a Wayfinder sees the body"
    last = pose[:, np.isfinite(pose).all(axis=0)][:, -1]
    missed = float(np.hypot(*(last[:2] - way[-1])))
    fall = fall_of(recording, ahead)[0]
    # The Wayfinder ends the walk at the last place, and where the robot does not get on.
    ended = recording.time[-1] < most.duration - PERIOD
    is_there = controller.is_there(last[[0, 1, 5]], len(options.to) - 1, slack=CAMERA_SLACK)
    arrived = ended and is_there and not (fall or recording.interrupted)
    stalls = ended and not (arrived or fall or recording.interrupted)
    said = f"{1e3 * missed:.0f} mm from the last place, after {recording.time[-1]:.0f} s"
    told = [
        Entry("arrived", arrived, sentence="yes" if arrived else "no"),
        Entry("missed", missed, "m", said),
        Entry("stalls", STALLS if stalls else ""),
        Entry("fall", fall),
    ]
    print_summary(options, recording.summary() + Summary(told), outputs)
    return 0 if arrived else 1


def _walk(options: argparse.Namespace) -> int:
    if options.to:
        return _go(options)
    if options.gait.is_dir():
        raise LimbError(
            f"{options.gait} is a folder of gaits, by which a robot walks to places; say where, "
            "with --to X,Y."
        )
    outputs = checked_outputs(options, options.gait)
    parts = [
        options.output.with_stem(f"{options.output.stem}_{what}") for what in ("first", "gait")
    ]
    check_outputs(parts if options.replan else [], inputs=[options.gait], force=options.force)
    gait, heat, bend, told = Gait.load(options.gait), None, None, Summary([])
    if gait.check.is_missing:
        raise LimbError(
            f"{options.gait} was never checked and is not walked by; plan it again with soft-limb "
            "gait, which checks it by simulation."
        )
    robot = _robot(options, gait)
    if options.replan:
        fit = _first_strides(options, gait, robot, parts[0])
        gait, heat, told = _replanned(gait, fit, options)
        if isinstance(robot, RobotTwin):
            robot = robot.after_rest(STANDING, truth=True)
        else:  # its port was closed, with its wires off, after the first strides
            robot = _robot(options, gait)
        bend = fit.bend
        gait.save(parts[1])
        outputs += parts
    recording, start = _drive(options, gait, options.cycles, robot, options.output, heat, bend)
    save_panels(motion_panels(recording), options.plot)
    print_summary(options, told + walk_summary(gait, recording, options.cycles, start), outputs)
    return 1 if recording.interrupted else 0


def _robot(options: argparse.Namespace, gait: Gait) -> LimbSystem:
    """The robot that a command names: on a port, the gait's own model, or an emulated one."""
    limbs = gait.robot.limbs
    uncalibrated = [limb.name for limb in limbs if not limb.parameters.calibration]
    if uncalibrated and not options.model:
        print(
            f"not calibrated: {', '.join(uncalibrated)}; emulated robots of such limbs made a "
            "third of their strides in space, and some fell: calibrate them with soft-limb collect "
            "and soft-limb fit, and plan the gait again",
            file=sys.stderr,
            flush=True,
        )
    if options.port:
        return SerialLimb(options.port, gait.parameters)
    if options.model:
        if options.replan:
            raise LimbError("--model is the robot as planned, so --replan tells nothing of it.")
        return Robot(gait.robot)
    if options.emulated is None:
        return RobotTwin.of(gait.robot, truth=True)
    return RobotTwin(gait.robot, seed=options.emulated, truth=True)


def _drive(
    options: argparse.Namespace,
    gait: Gait,
    cycles: int,
    robot: LimbSystem,
    output: Path,
    heat: np.ndarray | None = None,
    bend: np.ndarray | None = None,
) -> tuple[Recording, float]:
    """Walks some cycles from a heat and bends; returns the walk, and when the first begins, s."""
    trajectory = walk(gait, cycles, heat=heat, bend=bend)
    on_a_plane = BENDS if options.port else STRIDES
    name = options.controller or (HEAT if gait.in_space else on_a_plane)
    controller: LeafSystem | None = None
    if name == STRIDES:
        controller = GaitFeedback(gait, cycles, heat=heat, bend=bend)
    elif name == BENDS:
        controller = PlanFeedback(trajectory, known_start=heat is not None)
    elif name == HEAT:
        controller = HeatFeedback(trajectory)
    recording = record_replay(trajectory, robot, output, controller=controller)
    return recording, trajectory.duration - cycles * gait.period


def _first_strides(
    options: argparse.Namespace, gait: Gait, robot: LimbSystem, output: Path
) -> StridesFit:
    """Walk two strides, and return what they tell.

    Raises:
        LimbError: if the robot falls, or its strides tell nothing.
    """
    recording, start = _drive(options, gait, FIRST_STRIDES, robot, output)
    fall = fall_of(recording, gait, start)[0] if recording.body_pose is not None else ""
    if fall or recording.interrupted:
        raise LimbError(
            f"The robot does not make its first strides, which are in {output}: "
            f"{fall or recording.interrupted}."
        )
    if not gait.in_space:
        return fit_strides(gait, recording, start, FIRST_STRIDES)
    fit = fit_strides_in_space(gait, recording, start, FIRST_STRIDES)
    made = strides_of(recording, gait, FIRST_STRIDES, start)[0][-1]
    return dataclasses.replace(fit, made=float(made))


def _replanned(
    gait: Gait, fit: StridesFit, options: argparse.Namespace
) -> tuple[Gait, np.ndarray, Summary]:
    """The gait for what strides told, the wires' heat when it is planned, and what is to be said.

    The gait stays as it was where none walks for what they told.
    """
    began = time.monotonic()
    if gait.in_space and fit.made >= WELL_MADE:
        planned, said = gait, f"the gait is kept, of whose stride the robot makes {fit.made:.0%}"
    else:
        planned, said = planned_anew(gait, fit)
    pause = time.monotonic() - began if options.port else STANDING
    told = {name: estimate.value for name, estimate in fit.estimates.items()}
    shown = "\n".join(f"{name} {estimate}" for name, estimate in fit.estimates.items())
    entries = [Entry("strides_fit", told, "", shown), Entry("replanned", said)]
    return planned, fit.heat_after(pause), Summary(entries)


def planned_anew(gait: Gait, fit: StridesFit) -> tuple[Gait, str]:
    """The gait for the fitted robot if it walks there, and else the gait as it was; and why.

    In space it must be faster there than the gait as it was, in MuJoCo.
    """
    margin = gait.parameters.temperature_limits.maximum - gait.wire_temperature.max()
    objective: Any = gait.check.objective
    try:
        planned = plan_gait(
            fit.robot,
            schedule=gait.schedule,
            objective=objective,
            temperature_margin=max(0.0, margin),
            turn=gait.turn,
            stride=0.0 if gait.on_the_spot else None,
            steadiness=None if gait.in_space else gait.check.steadiness,
            sticking_share=gait.check.sticking_share,
            intervals=sum(gait.intervals),
            near=gait,
            spread=False,
        )
    except PlanningError as error:
        return gait, f"the gait is kept: {error}"
    if gait.in_space:
        as_it_was = simulate_gait(gait, "", fit.robot, FIRST_STRIDES)
        makes = 0.0 if as_it_was.fall else as_it_was.strides[-1] * gait.reach / gait.period
        if makes >= planned.reach / planned.period:
            return gait, "the gait is kept, as a new one is no faster on such feet"
    return planned, f"{1e3 * planned.speed:.2f} mm/s, after {1e3 * gait.speed:.2f} mm/s"


MARGIN = Option(
    "--margin",
    type=float,
    default=5.0,
    metavar="DEGREES",
    help="how far wires stay below T_max, °C, which feedback needs (default %(default)g)",
)
STICKING = Option(
    "--sticking",
    type=float,
    default=STICKING_SHARE,
    metavar="SHARE",
    help="share of the friction that feet that stick may use: more is faster, but the "
    "robot stands still if friction differs from foot to foot (default %(default)g)",
)

COMMANDS = {
    "gait": Command(
        _gait,
        "Plans the gait of a robot of several limbs on the ground: a motion that repeats, heat "
        "included. Tries the schedules of contacts that are worth it and says why others were not "
        "taken; simulates the best with contact, and with other friction and "
        "parameters; and writes it to a file that soft-limb walk drives a robot by.",
        "plot report json force",
        [
            Option(
                "robot",
                nargs="?",
                type=Path,
                help="robot parameters (.yaml); a crawler of two limbs if left out",
            ),
            shared("output", help="gait file to write (.csv); with --set a folder"),
            Option(
                "--set",
                action="store_true",
                help="plan the gaits by which a robot in space gets anywhere: ahead, along arcs to "
                "the left and right, and on the spot; soft-limb walk --to takes their folder",
            ),
            Option(
                "--schedule",
                action="append",
                default=[],
                metavar="TEXT",
                help="what each foot does in each phase, such as 'fs ss sf ss': s sticks, f or b "
                "slides forward or backward in a plane, d is dragged in space, l is lifted; once "
                "for each schedule to try",
            ),
            Option(
                "--turn",
                type=_turn,
                default=0.0,
                metavar="DEGREES",
                help="turn to the left in a cycle, °, negative to the right; or left or right, as "
                "far as it can (default: none)",
            ),
            Option(
                "--stride",
                type=float,
                metavar="MM",
                help="travel in a cycle, mm, 0 to turn on the spot (default: the fastest)",
            ),
            Option(
                "--speed",
                type=float,
                metavar="MM_S",
                help="speed, mm/s, at the least heat (default: as fast as it can)",
            ),
            Option(
                "--objective",
                choices=["speed", "energy"],
                default="speed",
                help="the fastest gait, or the one that heats least for its distance (default "
                "%(default)s)",
            ),
            MARGIN,
            Option(
                "--steadiness",
                type=float,
                metavar="N",
                help="least stiffness against pitch, as a multiple of weight times limb length: "
                "less is faster, but more robots that are not quite as described fall (default "
                f"{STEADINESS:g}, or {STEADINESS_CALIBRATED:g} if all limbs are calibrated)",
            ),
            STICKING,
            Option(
                "--quick",
                action="store_true",
                help="simulate it on the described ground alone, not on others",
            ),
        ],
        stopped="stopped; nothing was written",
        examples=[
            "soft-limb gait -o out/gait.csv --schedule 'fs ss sf ss'",
            "soft-limb gait robot.yaml --set -o out/gaits/",
        ],
    ),
    "walk": Command(
        _walk,
        "Walks by a gait: warms the wires up, makes so many cycles, and stops. Without a port it "
        "is an emulated robot that walks, whose limbs, masses and friction are not as described; "
        "its body is seen by an emulated camera.",
        "output driven plot json force",
        [
            Option(
                "gait",
                type=Path,
                help="gait file (.csv), as soft-limb gait writes it; with --to, the folder of "
                "soft-limb gait --set",
            ),
            Option(
                "--to",
                type=_place,
                action="append",
                default=[],
                metavar="X,Y[,DEGREES]",
                help="place to walk to, m from where the body begins, and the heading there, °; "
                "once for each place, in their order",
            ),
            Option(
                "-n",
                "--cycles",
                type=count,
                default=8,
                help="number of cycles (default %(default)s)",
            ),
            Option(
                "--replan",
                action="store_true",
                help="walk two strides, fit friction, stiffness, torques and heat to them (in "
                "space friction and the heights of feet, to the body's pose), plan the gait anew "
                "while the robot stands, in space if it makes less than 90%% of a stride, and go "
                "on by it; files *_first.csv and *_gait.csv have the strides and the gait",
            ),
            Option(
                "--controller",
                choices=[STRIDES, BENDS, HEAT, OPEN_LOOP],
                help=f"{STRIDES}: hold the bends, and correct their amplitude and duration by each "
                f"stride; {BENDS}: hold the bends; {HEAT}: hold the temperatures; {OPEN_LOOP}: the "
                f"gait's duty (default in space {HEAT}; in a plane {STRIDES}, or {BENDS} on a "
                "port, where no camera sees the body)",
            ),
        ],
        examples=["soft-limb walk out/gait.csv -n 4 -o out/walk.csv"],
    ),
}
