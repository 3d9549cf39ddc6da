"""One limb through the whole paper: recordings, calibration, plans, rollouts."""

import copy
import dataclasses
import functools
import operator
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from calibration import Calibration, calibrate, collect_from_twin
from hardware import LimbTwin, present_readings, watch
from hardware.emulation.specimen import Specimen
from limb_systems import LimbParameters, Recording, Trajectory, resting_state
from planners import Task, plan, references
from reproduce_paper.error_split import Split, error_split
from reproduce_paper.ways import (
    CLOSED_LOOP,
    DISTURBANCES,
    FEEDBACK,
    FOLLOW,
    LEARNING,
    OPEN_LOOP,
    PAUSE,
    REGULATOR,
    Way,
    roll_out,
    roll_out_disturbed,
)
from soft_limb.runs.jobs import run_each

# Table I has the distance of each plan from its reference.
warnings.filterwarnings("ignore", "The plan is far from its reference")

AS_DESCRIBED = "as described, not calibrated"
PAPER = "LinearLaw, calibrated as in Sec. V"
NUM_ANGLES = 6  # equilibria of each calibration recording
NUM_ROLLOUTS = 5  # of each plan of the calibrated model in open loop
# Rollouts of a controller differ by the sensors' noise alone. Repetitions are those of learning.
COUNTS = {OPEN_LOOP: 1, FEEDBACK: 2, REGULATOR: 2, FOLLOW: 1, LEARNING: 10}
SMOOTHING_TIME = 0.5  # s, of taught bend angles

VALIDATION, RAMPS = "Validation", "Ramps"
# Files with the two motions of the hand, time in s and bend angle in degrees.
HANDS = {"T&R 1": "hand_1.csv", "T&R 2": "hand_2.csv"}
DRAWN = {VALIDATION: references.step_and_decaying_sine, RAMPS: references.ramps}
MOTIONS = (VALIDATION, *HANDS, RAMPS)


@dataclasses.dataclass(frozen=True)
class Settings:
    """What the evaluation does with one limb.

    - ``seed``, ``extra``, ``physics``: arguments of the emulated limb, see `LimbTwin`.
    - ``compare``: whether the paper's calibration and other laws make plans, too; each of these
      plans has one rollout. The limb as described always does.
    - ``disturb``: whether feedback drives the motion of Fig. 5 under `DISTURBANCES`.
    - ``quick``: whether a receding horizon alone drives each motion in closed loop, and only the
      ramps are learned, as in the demo; all of `CLOSED_LOOP` otherwise.
    """

    seed: int
    extra: tuple[str, ...] = ()
    physics: str = "lumped"
    compare: bool = True
    disturb: bool = True
    quick: bool = False

    def closed_loop(self, motion: str) -> tuple[str, ...]:
        """The ways of `CLOSED_LOOP` that drive a motion."""
        if not self.quick:
            return CLOSED_LOOP
        return (FOLLOW, LEARNING) if motion == RAMPS else (FOLLOW,)


@dataclasses.dataclass(frozen=True, eq=False)
class Experiment:
    """One limb, its calibration, and how it was driven.

    - ``specimen``: the emulation's truth, which nothing looks into.
    - ``recordings``: recordings for calibration, by kind.
    - ``calibration``: the model, fitted by prediction error.
    - ``taught``: recordings of the hand, with the wires off, by motion.
    - ``ways``: plan and rollouts of each way to drive the limb, by motion. A rollout ends when a
      wire is measured at the limit of the board.
    - ``disturbed``: ways that drove the motion of Fig. 5, by disturbance.
    - ``split``: parts of the first rollouts' error, see `error_split`.
    - ``compared``: open loop along the plans of other models, such as `AS_DESCRIBED` or `PAPER`, by
      model and motion.
    """

    specimen: Specimen
    recordings: dict[str, list[Recording]]
    calibration: Calibration
    taught: dict[str, Recording]
    ways: dict[str, dict[str, Way]]
    disturbed: dict[str, dict[str, Way]]
    split: dict[str, Split]
    compared: dict[str, dict[str, Way]]


def hand_course(name: str) -> PiecewisePolynomial:
    """The bend angle over time of a taught motion, rad; the hand rests at both ends."""
    times, angles = np.loadtxt(Path(__file__).with_name(HANDS[name]), delimiter=",").T
    return PiecewisePolynomial.CubicShapePreserving(
        times, np.deg2rad([angles]), zero_end_point_derivatives=True
    )


def evaluate(
    settings: Settings,
    num_processes: int = 1,
    tell: Callable[[str], object] = lambda step: None,
) -> Experiment:
    """Take a new limb through Secs. V to VII, and on to closed loop.

    Each way to drive each plan begins where the limb was left by the recordings, the hand
    and a rest.

    Args:
        settings: what is done.
        num_processes: as for `run_each`.
        tell: function that is called before each step, with its number of five and its name.

    """
    tell("1/5 recording the limb as calibration wants it")
    specimen, recordings = record(settings)
    tell("2/5 calibrating the model to the recordings, and teaching motions by hand")
    calls: list[Callable[[], Any]] = [
        functools.partial(fit, recordings, settings.compare),
        functools.partial(teach, specimen),
    ]
    (calibration, models), (rested, taught) = call_all(calls, num_processes)
    start = present_readings(LimbTwin(specimen=rested))
    # Motion, loop that the plan is made for, and name of the model, empty for the calibrated one.
    wanted = [(motion, OPEN_LOOP, model) for motion in MOTIONS for model in models]
    wanted += [(motion, FEEDBACK, "") for motion in MOTIONS]
    tell(f"3/5 planning motions: {len(wanted)}")
    calls = [
        functools.partial(plan_motion, models[model], motion, taught, loop, start)
        for motion, loop, model in wanted
    ]
    found = call_all(calls, num_processes)
    plans = dict(zip(wanted, found, strict=True))
    # Motion, way and model of each run, the longest first.
    runs = [
        (motion, way, "")
        for way in reversed(CLOSED_LOOP)
        for motion in MOTIONS
        if way in settings.closed_loop(motion)
    ]
    runs += [key for key in wanted if key[2]]
    num_runs = len(MOTIONS) + len(runs)
    tell(f"4/5 driving the limb along its plans in several ways: {num_runs}")
    opened = {motion: plans[motion, OPEN_LOOP, ""] for motion in MOTIONS}
    calls = [functools.partial(open_loop, rested, calibration, opened)]
    for motion, way, model in runs:
        trajectory = plans[motion, OPEN_LOOP if way == OPEN_LOOP else FEEDBACK, model]
        number = MOTIONS.index(motion)
        calls.append(functools.partial(roll_out, rested, trajectory, way, COUNTS[way], number))
    fig5 = {loop: plans[VALIDATION, loop, ""] for loop in (OPEN_LOOP, FEEDBACK)}
    disturbances = DISTURBANCES if settings.disturb else ()
    calls += [functools.partial(roll_out_disturbed, rested, fig5, each) for each in disturbances]
    (firsts, split), *driven = call_all(calls, num_processes)
    ways = {(motion, OPEN_LOOP, ""): way for motion, way in firsts.items()}
    ways |= zip(runs, driven, strict=False)
    return Experiment(
        specimen,
        recordings,
        calibration,
        taught,
        ways={
            motion: {
                way: ways[motion, way, ""] for way in (OPEN_LOOP, *settings.closed_loop(motion))
            }
            for motion in MOTIONS
        },
        disturbed=dict(zip(disturbances, driven[len(runs) :], strict=True)),
        split=split,
        compared={
            model: {motion: ways[motion, OPEN_LOOP, model] for motion in MOTIONS}
            for model in models
            if model
        },
    )


def call_all(calls: Sequence[Callable[[], Any]], num_processes: int) -> list[Any]:
    """Make calls in several processes, and return their results."""
    return list(run_each(operator.call, calls, num_processes, in_order=True))


def record(settings: Settings) -> tuple[Specimen, dict[str, list[Recording]]]:
    """Return a new limb, and its recordings for calibration."""
    twin = LimbTwin(seed=settings.seed, extra=settings.extra, physics=settings.physics)
    return twin.specimen, collect_from_twin(twin, seed=settings.seed, num_angles=NUM_ANGLES)


def fit(
    recordings: dict[str, list[Recording]], compare: bool
) -> tuple[Calibration, dict[str, LimbParameters]]:
    """Return the calibration of a limb, and models of it by name, the calibrated one as ""."""
    calibration = calibrate(recordings)
    models = {"": calibration.parameters, AS_DESCRIBED: LimbParameters()}
    if compare:
        models[PAPER] = calibrate(recordings, method="paper").parameters
        assert calibration.prediction is not None
        for candidate in calibration.prediction.candidates:
            models[candidate.name] = copy.deepcopy(calibration.parameters)
            models[candidate.name].calibration = None  # it is of the best law
            candidate.fit.apply(models[candidate.name])
    return calibration, models


def teach(specimen: Specimen) -> tuple[Specimen, dict[str, Recording]]:
    """Move a limb by hand, and let it rest; return the limb then, and what it recorded."""
    taught = {}
    for name in HANDS:
        hand = hand_course(name)
        taught[name] = watch(
            LimbTwin(specimen=specimen).after_rest(PAUSE, hand=hand), hand.end_time()
        )
    LimbTwin(specimen=specimen).after_rest(PAUSE)
    return specimen.with_noise(0), taught


def open_loop(
    rested: Specimen, calibration: Calibration, plans: dict[str, Trajectory]
) -> tuple[dict[str, Way], dict[str, Split]]:
    """Return rollouts of each motion's plan, and how the error of the first one is split."""
    ways = {
        motion: roll_out(rested, trajectory, OPEN_LOOP, NUM_ROLLOUTS, MOTIONS.index(motion))
        for motion, trajectory in plans.items()
    }
    return ways, error_split(calibration, ways)


def plan_motion(
    limb: LimbParameters,
    motion: str,
    taught: dict[str, Recording],
    loop: str,
    start: np.ndarray,
) -> Trajectory:
    """Plan one of `MOTIONS`, drawn or as it was taught, to be driven in a loop from readings on."""
    if motion in taught:
        reference = references.from_recording(taught[motion], SMOOTHING_TIME)
    else:
        reference = DRAWN[motion]()
    task = Task.paper() if loop == OPEN_LOOP else Task.closed_loop(limb)
    return plan(limb, reference, task=task, initial_state=resting_state(limb, start))
