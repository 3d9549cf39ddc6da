"""Commands of robots that walk."""

import argparse
import dataclasses
import functools
import os
import sys
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
from walking.gait_check import find_fall, simulate_gait
from walking.gait_feedback import MIN_PACE, GaitFeedback
from walking.gait_planning import plan_gait
from walking.gait_program import (
    STEADINESS,
    STEADINESS_CALIBRATED,
    STICKING_SHARE,
    STICKING_SHARE_CALIBRATED,
    STICKING_SHARE_ON_THE_SPOT,
)
from walking.gait_request import GaitRequest
from walking.gait_set import AHEAD, TURNING_GAITS, gait_files, load_gaits, plan_gaits, save_gaits
from walking.heat_feedback import HeatFeedback
from walking.robot import Robot
from walking.robot_parameters import RobotParameters
from walking.robot_twin import RobotTwin
from walking.schedules import (
    Schedule,
    candidate_schedules,
    check_schedule,
    format_schedule,
    parse_schedule,
)
from walking.strides import StridesFit, fit_strides
from walking.views.robot_panels import body_path_panel
from walking.walk_trajectory import walk
from walking.walker import check_walker
from walking.wayfinder import MIN_CYCLE_SHARE, Wayfinder

STRIDE_FEEDBACK = "gait-feedback"
BEND_FEEDBACK = "plan-feedback"
HEAT_FEEDBACK = "heat-feedback"
SINGLE_GAIT_OPTIONS = (
    "schedule",
    "turn",
    "stride",
    "speed",
    "steadiness",
    "quick",
    "plot",
    "report",
)
FIRST_STRIDES = 2  # after which the gait is planned again
MIN_KEPT_STRIDE_SHARE = 0.9  # of the planned stride in space: robots that make it keep the gait
# Of the tolerance of a place: a camera sees robots that arrived within so many times as much.
CAMERA_TOLERANCE_FACTOR = 1.2
STALLED_MESSAGE = (
    f"stopped, as every gait makes less than {MIN_CYCLE_SHARE:.0%} of what was planned; does the "
    "robot slip, or is it another than the gait's?"
)
COOLING_TIME = 180.0  # s, for which an emulated robot stands with its wires off before it goes on
_Trial = tuple[Schedule, Gait | None, str]  # with its gait, or the reason why it has none


def _parse_turn(text: str) -> float:
    """Return a turn in a cycle, rad, from text such as left, right or 10."""
    sides = {"left": np.inf, "right": -np.inf}
    try:
        return sides[text] if text in sides else float(np.deg2rad(float(text)))
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"{text!r} is neither left, nor right, nor a number of degrees"
        ) from error


def _plan(options: argparse.Namespace) -> int:
    """Plan a gait of the first schedule that works, or of the best."""
    if options.set:
        return _plan_set(options)

    # Check the request before planning, which takes minutes.
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
    schedules = [parse_schedule(text, len(robot.limbs)) for text in options.schedule]
    for schedule in schedules:
        check_schedule(schedule, robot)
    schedules = schedules or candidate_schedules(robot)
    request.validate(robot, schedules[0])

    # Plan, and report schedules that gave no gait.
    print_duration(
        f"some seconds to plan a schedule ({len(schedules)} in all), five to twenty to check one"
    )
    request = dataclasses.replace(request, explain=len(schedules) == 1)
    try_schedule = functools.partial(_try_schedule, robot, request)
    gait, refused = _best_gait(schedules, try_schedule, spread=not options.quick)
    if gait is None:
        raise LimbError(
            f"No schedule of {len(schedules)} gives a gait that walks as planned: "
            + "; ".join(f"{schedule!r}, {reason.rstrip('.')}" for schedule, reason in refused)
            + "."
        )
    if refused and not options.json:
        print_table("schedules that were not taken", refused)

    # Save the gait, and describe it.
    gait.save(options.output)
    save_panels(motion_panels(gait), options.plot)
    if options.report:
        from walking.commands.gait_report import gait_report

        gait_report(gait, options.report, {"gait": options.output})
    print_summary(options, gait_summary(gait), outputs)
    return 0


def _plan_set(options: argparse.Namespace) -> int:
    """Plan a set of gaits by which a robot in space walks to any place, into a folder."""
    # Refuse options of a single gait.
    unsuitable = [f"--{name}" for name in SINGLE_GAIT_OPTIONS if getattr(options, name)]
    if unsuitable:
        raise LimbError(f"--set plans gaits of all directions; leave out {', '.join(unsuitable)}.")
    # Check the files before the gaits are planned, which takes minutes.
    check_outputs(gait_files(options.output), inputs=[options.robot], force=options.force)
    robot = RobotParameters.of(options.robot)
    num_processes = min(os.cpu_count() or 1, len(TURNING_GAITS))
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
        plan: `_try_schedule` for a robot and an objective.
        spread: whether the check varies ground and parameters.

    Returns:
        The gait that was taken, if any; and each rejected schedule with the reason.
    """
    # Plan a gait of each schedule, without checks, and sort them by merit.
    trials: list[_Trial] = [(schedule, None, "") for schedule in schedules]
    if len(schedules) > 1:
        num_processes = min(os.cpu_count() or 1, len(schedules))
        with Progress("planning", len(schedules), "schedules") as progress:
            trials = []
            untried = list(schedules)
            for trial in run_each(plan, schedules, num_processes):
                trials.append(trial)
                untried.remove(trial[0])
                message = f"trying {format_schedule(untried[0])}" if untried else ""
                progress.update(len(trials), message)
        trials.sort(key=lambda trial: -trial[1].merit if trial[1] else np.inf)

    # Check them until one passes.
    taken = None
    refused = []
    for schedule, gait, reason in trials:
        if gait and taken:
            reason = f"{_pace(gait)}, and another is better"
        elif not reason:
            _, taken, reason = plan(schedule, check=True, spread=spread)
        if reason:
            refused.append((format_schedule(schedule), reason))
    return taken, refused


def _pace(gait: Gait) -> str:
    """Return the speed of a gait, or its rate of turning on the spot, in words."""
    if gait.on_the_spot:
        return f"{np.rad2deg(gait.turn / gait.period):.2f} °/s"
    return f"{1e3 * gait.speed:.2f} mm/s"


def _try_schedule(
    robot: RobotParameters,
    request: GaitRequest,
    schedule: Schedule,
    check: bool = False,
    spread: bool = True,
) -> _Trial:
    """Plan a gait of a schedule; return it, or the reason why there is none."""
    try:
        gait = plan_gait(robot, request, schedule=schedule, check=check, spread=spread)
        return schedule, gait, ""
    except PlanningError as error:
        return schedule, None, str(error)


def _parse_place(text: str) -> list[float]:
    """Return x, y, m, and a heading, rad, if any, from text such as 0.5,0 or 0.5,0,90."""
    try:
        x, y, *heading = map(float, text.split(","))
        if len(heading) > 1 or not np.isfinite([x, y, *heading]).all():
            raise ValueError
    except ValueError as error:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no place such as 0.5,0 (m), or 0.5,0,90 with a heading (°)"
        ) from error
    return [x, y, *np.deg2rad(heading)]


def _walk_to_places(options: argparse.Namespace) -> int:
    """Walk to places, by the gaits of a folder."""
    # Refuse options that do not go with --to.
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
    robot = _make_robot(options, ahead)
    controller = Wayfinder(gaits, options.to)

    # Walk for at most three times as many strides as planned, and 80 cycles for turns by
    # arcs at each place.
    waypoints = np.vstack([[0.0, 0.0], *(goal[:2] for goal in options.to)])
    length = np.linalg.norm(np.diff(waypoints, axis=0), axis=1).sum()
    max_cycles = int(3 * length / ahead.stride) + 80 * len(options.to)
    longest_walk = walk(ahead, max_cycles)
    recording = record_replay(longest_walk, robot, options.output, controller=controller)
    save_panels([body_path_panel(recording, options.to)], options.plot)

    # Compare the last pose with the last place.
    pose = recording.body_pose
    assert pose is not None, "a Wayfinder sees the body"
    last_pose = pose[:, np.isfinite(pose).all(axis=0)][:, -1]
    distance = float(np.hypot(*(last_pose[:2] - waypoints[-1])))
    fall = find_fall(recording, ahead)[0]
    # The Wayfinder ends the walk at the last place, or when no gait moves the robot.
    ended = bool(recording.time[-1] < longest_walk.duration - PERIOD)
    last_goal = len(options.to) - 1
    last_place = last_pose[[0, 1, 5]]
    is_there = bool(controller.is_there(last_place, last_goal, slack=CAMERA_TOLERANCE_FACTOR))
    arrived = ended and is_there and not (fall or recording.interrupted)
    stalls = ended and not (arrived or fall or recording.interrupted)
    sentence = f"{1e3 * distance:.0f} mm from the last place, after {recording.time[-1]:.0f} s"
    entries = [
        Entry("arrived", arrived, sentence="yes" if arrived else "no"),
        Entry("missed", distance, "m", sentence),
        Entry("stalls", STALLED_MESSAGE if stalls else ""),
        Entry("fall", fall),
    ]
    print_summary(options, recording.summary() + Summary(entries), outputs)
    return 0 if arrived else 1


def _walk(options: argparse.Namespace) -> int:
    """Walk some cycles of a gait, after a new plan from the first strides if asked for."""
    if options.to:
        return _walk_to_places(options)
    if options.gait.is_dir():
        raise LimbError(
            f"{options.gait} is a folder of gaits, by which a robot walks to places; say where, "
            "with --to X,Y."
        )

    # Check files and gait before the robot moves.
    outputs = checked_outputs(options, options.gait)
    first_file = options.output.with_stem(f"{options.output.stem}_first")
    gait_file = options.output.with_stem(f"{options.output.stem}_gait")
    if options.replan:
        check_outputs([first_file, gait_file], inputs=[options.gait], force=options.force)
    gait = Gait.load(options.gait)
    if gait.check.is_missing:
        raise LimbError(
            f"{options.gait} was never checked and is not walked by; plan it again with soft-limb "
            "gait, which checks it by simulation."
        )
    if options.replan:
        _check_replan(options, gait)
    robot = _make_robot(options, gait)

    # Walk the first strides, and plan the gait again for the robot that they show.
    replan_summary = Summary([])
    if options.replan:
        assert isinstance(robot, RobotTwin)  # neither on a port nor the gait's model
        fit = _walk_first_strides(options, gait, robot, first_file)
        gait, replan_summary = _replan(gait, fit)
        robot = robot.after_rest(COOLING_TIME, truth=True)
        gait.save(gait_file)
        outputs += [first_file, gait_file]

    # Walk, and summarize the strides.
    controller = options.controller or _default_controller(options, gait)
    recording, starts = _walk_cycles(controller, gait, options.cycles, robot, options.output)
    save_panels(motion_panels(recording), options.plot)
    summary = replan_summary + walk_summary(gait, recording, starts)
    print_summary(options, summary, outputs)
    return 1 if recording.interrupted else 0


def _check_replan(options: argparse.Namespace, gait: Gait) -> None:
    """Refuse to plan a gait anew for robots whose strides cannot tell of their feet."""
    if not gait.in_space:
        raise LimbError(
            "--replan fits friction and the heights of feet of robots in space; leave it out for "
            "a gait in a plane, whose feedback corrects its strides."
        )
    if options.port:
        raise LimbError(
            "--replan needs a camera that sees the body, and there is none on a port; leave it "
            "out, or record strides with a camera in Python and call fit_strides."
        )
    if options.model:
        raise LimbError("--model is the robot as planned; leave out --replan, which fits it.")


def _make_robot(options: argparse.Namespace, gait: Gait) -> LimbSystem:
    """Return the robot of a command's options: on a port, the gait's model, or emulated."""
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
        return Robot(gait.robot)
    if options.emulated is None:
        return RobotTwin.of(gait.robot, truth=True)
    return RobotTwin(gait.robot, seed=options.emulated, truth=True)


def _default_controller(options: argparse.Namespace, gait: Gait) -> str:
    """Return the controller of a walk by a gait; on a port no camera sees the body."""
    if gait.in_space:
        return HEAT_FEEDBACK
    return BEND_FEEDBACK if options.port else STRIDE_FEEDBACK


def _walk_cycles(
    name: str, gait: Gait, cycles: int, robot: LimbSystem, output: Path
) -> tuple[Recording, np.ndarray]:
    """Walk some cycles by a controller, from cold wires.

    Returns:
        The recording, and the times at which cycles began, and the last one ended, s.
    """
    trajectory = walk(gait, cycles)
    start = trajectory.duration - cycles * gait.period
    starts = start + gait.period * np.arange(cycles + 1)
    controller: LeafSystem | None = None
    if name == STRIDE_FEEDBACK:
        controller = GaitFeedback(gait, cycles)
        # Its clock waits for the limbs, and it ends the walk.
        trajectory = walk(gait, int(np.ceil(cycles / MIN_PACE)))
    elif name == BEND_FEEDBACK:
        controller = PlanFeedback(trajectory)
    elif name == HEAT_FEEDBACK:
        controller = HeatFeedback(trajectory)
    recording = record_replay(trajectory, robot, output, controller=controller)
    if isinstance(controller, GaitFeedback):
        starts = np.array(controller.cycle_starts or starts[:1])
    return recording, starts


def _walk_first_strides(
    options: argparse.Namespace, gait: Gait, robot: LimbSystem, output: Path
) -> StridesFit:
    """Walk two strides, and fit the robot to them.

    Raises:
        LimbError: if the robot falls, or nothing can be fitted to its strides.
    """
    controller = options.controller or _default_controller(options, gait)
    recording, starts = _walk_cycles(controller, gait, FIRST_STRIDES, robot, output)
    start = float(starts[0])
    fall = find_fall(recording, gait, start)[0]
    if fall or recording.interrupted:
        raise LimbError(
            f"The robot does not make its first strides; see their recording {output}: "
            f"{fall or recording.interrupted}."
        )
    return fit_strides(gait, recording, start, FIRST_STRIDES)


def _replan(gait: Gait, fit: StridesFit) -> tuple[Gait, Summary]:
    """Plan the gait again for a fitted robot, unless the robot makes its strides.

    Returns:
        The gait, and a summary of the fit and the gait.
    """
    planned = gait
    sentence = f"the gait is kept, of whose stride the robot makes {fit.made:.0%}"
    if fit.made < MIN_KEPT_STRIDE_SHARE:
        planned, sentence = replan_gait(gait, fit.robot)
    values = {}
    lines = []
    for name, estimate in fit.estimates.items():
        values[name] = estimate.value
        lines.append(f"{name} {estimate}")
    entries = [Entry("strides_fit", values, "", "\n".join(lines)), Entry("replanned", sentence)]
    return planned, Summary(entries)


def replan_gait(gait: Gait, robot: RobotParameters) -> tuple[Gait, str]:
    """Return a gait in space of a fitted robot, or the former gait, and the reason in words.

    The former gait stays if no new gait walks as planned, or if the former gait is as fast as the
    new one on the fitted robot in MuJoCo.
    """
    margin = gait.parameters.temperature_limits.maximum - gait.wire_temperature.max()
    share = gait.check.sticking_share  # NaN in files of gaits that do not say
    objective: Any = gait.check.objective
    try:
        planned = plan_gait(
            robot,
            schedule=gait.schedule,
            objective=objective,
            temperature_margin=max(0.0, margin),
            turn=gait.turn / gait.check.made,  # as asked for, not as simulated
            stride=0.0 if gait.on_the_spot else None,
            sticking_share=share if np.isfinite(share) else None,
            intervals=sum(gait.intervals),
            near=gait,
            spread=False,
        )
    except PlanningError as error:
        return gait, f"the gait is kept: {error}"
    former = simulate_gait(gait, "", robot, FIRST_STRIDES)
    former_speed = 0.0 if former.fall else former.strides[-1] * gait.reach / gait.period
    if former_speed >= planned.reach / planned.period:
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
    metavar="SHARE",
    help="share of the friction that feet that stick may use: more is faster, but the robot "
    "stands still if friction or load differs from foot to foot (default "
    f"{STICKING_SHARE:g}; with four or more calibrated limbs in space "
    f"{STICKING_SHARE_CALIBRATED:g} ahead, and {STICKING_SHARE_ON_THE_SPOT:g} on the spot)",
)

COMMANDS = {
    "gait": Command(
        _plan,
        "Plan the gait of a robot of several limbs on the ground: a motion that repeats, heat "
        "included. The command tries schedules of contacts, and reports why each was rejected. It "
        "simulates the best gait with contact, also with varied friction and parameters, and "
        "writes it to a file for soft-limb walk.",
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
                help="plan the gaits by which a robot in space walks to any place: ahead, along "
                "arcs to the left and right, and on the spot; soft-limb walk --to takes their "
                "folder",
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
                type=_parse_turn,
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
                help="the fastest gait, or the gait that heats least for its distance (default "
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
                help="simulate the gait with the described friction and parameters alone",
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
        "Walk by a gait: warm the wires up, make some cycles, and stop. Without a port, an "
        "emulated robot walks. Its limbs, masses and friction differ from the description, and an "
        "emulated camera sees its body.",
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
                type=_parse_place,
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
                help="in space: walk two strides, fit friction and the heights of feet to the "
                "body's pose, plan the gait anew if it makes less than 90%% of a stride, and walk "
                "by it once the wires are cool; files *_first.csv and *_gait.csv have the strides "
                "and the gait",
            ),
            Option(
                "--controller",
                choices=[STRIDE_FEEDBACK, BEND_FEEDBACK, HEAT_FEEDBACK, OPEN_LOOP],
                help=f"{STRIDE_FEEDBACK}: hold the bends, wait for limbs that lag, and correct the "
                f"amplitude by each stride; {BEND_FEEDBACK}: hold the bends; {HEAT_FEEDBACK}: hold "
                f"the temperatures; {OPEN_LOOP}: the gait's duty (default: in space "
                f"{HEAT_FEEDBACK}, in a plane {STRIDE_FEEDBACK}, or {BEND_FEEDBACK} on a port, "
                "where no camera sees the body)",
            ),
        ],
        examples=["soft-limb walk out/gait.csv -n 4 -o out/walk.csv"],
    ),
}
