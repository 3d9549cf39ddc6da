"""Evaluate one limb: record, calibrate, plan and drive it, as in the paper."""

import copy
import dataclasses
import functools
import itertools
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
from reproduce_paper.driving import (
    CLOSED_LOOP,
    DISTURBANCES,
    FEEDBACK,
    FOLLOW,
    LEARNING,
    OPEN_LOOP,
    PAUSE,
    REGULATOR,
    PlanWithRollouts,
    roll_out,
    roll_out_disturbed,
)
from reproduce_paper.error_split import Split, error_split
from soft_limb.runs.jobs import run_each

# Table I has the distance of each plan from its reference.
warnings.filterwarnings("ignore", "The plan is far from its reference")

AS_DESCRIBED = "as described, not calibrated"
PAPER = "LinearLaw, calibrated as in Sec. V"
NUM_ANGLES = 6  # equilibria of each calibration recording
NUM_ROLLOUTS = 5  # of each plan of the calibrated model in open loop
# Rollouts of one controller differ only by sensor noise. For learning: number of repetitions.
COUNTS = {OPEN_LOOP: 1, FEEDBACK: 2, REGULATOR: 2, FOLLOW: 1, LEARNING: 10}
SMOOTHING_TIME = 0.5  # s, of taught bend angles

VALIDATION = "Validation"
RAMPS = "Ramps"
# Files of the two taught motions: time in s and bend angle in degrees.
HANDS = {"T&R 1": "hand_1.csv", "T&R 2": "hand_2.csv"}
DRAWN = {VALIDATION: references.step_and_decaying_sine, RAMPS: references.ramps}
MOTIONS = (VALIDATION, *HANDS, RAMPS)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Settings of the evaluation of one limb.

    - ``seed``, ``physics``: arguments of the emulated limb, see `LimbTwin`.
    - ``compare``: whether the paper's calibration and other laws make plans, too; each of these
      plans has one rollout. The limb as described always does.
    - ``disturb``: whether feedback drives the motion of Fig. 5 under `DISTURBANCES`.
    - ``quick``: whether a receding horizon alone drives each motion in closed loop, and only the
      ramps are learned, as in the demo; all of `CLOSED_LOOP` otherwise.
    """

    seed: int
    physics: str = "lumped"
    compare: bool = True
    disturb: bool = True
    quick: bool = False

    def closed_loop(self, motion: str) -> tuple[str, ...]:
        """Return the methods of `CLOSED_LOOP` that drive a motion."""
        if not self.quick:
            return CLOSED_LOOP
        return (FOLLOW, LEARNING) if motion == RAMPS else (FOLLOW,)


@dataclasses.dataclass(frozen=True, eq=False)
class Experiment:
    """One limb, its calibration, and its rollouts.

    - ``specimen``: the emulated limb with its hidden parameters.
    - ``recordings``: recordings for calibration, by kind.
    - ``calibration``: the model, fitted by prediction error.
    - ``taught``: recordings of the hand, with the wires off, by motion.
    - ``ways``: plan and rollouts by motion and method. A rollout ends early when a wire is
      measured at the limit of the board.
    - ``disturbed``: plan and rollouts of Fig. 5 by disturbance and method.
    - ``split``: parts of the first rollouts' error, see `error_split`.
    - ``compared``: open loop along the plans of other models, such as `AS_DESCRIBED` or `PAPER`, by
      model and motion.
    """

    specimen: Specimen
    recordings: dict[str, list[Recording]]
    calibration: Calibration
    taught: dict[str, Recording]
    ways: dict[str, dict[str, PlanWithRollouts]]
    disturbed: dict[str, dict[str, PlanWithRollouts]]
    split: dict[str, Split]
    compared: dict[str, dict[str, PlanWithRollouts]]


def taught_motion(name: str) -> PiecewisePolynomial:
    """Return the bend angle of a taught motion over time, rad; it is at rest at both ends."""
    times, angles = np.loadtxt(Path(__file__).with_name(HANDS[name]), delimiter=",").T
    return PiecewisePolynomial.CubicShapePreserving(
        times, np.deg2rad([angles]), zero_end_point_derivatives=True
    )


def evaluate(
    settings: Settings,
    num_processes: int = 1,
    announce: Callable[[str], object] = lambda step: None,
) -> Experiment:
    """Evaluate a new limb as in Secs. V to VII, and in closed loop.

    Each method drives each plan from the same state of the limb, after the recordings, the
    teaching and a rest.

    Args:
        settings: settings of the evaluation.
        num_processes: as for `run_each`.
        announce: function that is called with the name of each step.
    """
    announce("1/5 recording the limb for calibration")
    specimen, recordings = record(settings)
    announce("2/5 calibrating the model to the recordings, and teaching motions by hand")
    calls: list[Callable[[], Any]] = [
        functools.partial(fit, recordings, settings.compare),
        functools.partial(teach, specimen),
    ]
    calibrated, teaching = call_all(calls, num_processes)
    calibration, models = calibrated
    rested, taught = teaching
    start = present_readings(LimbTwin(specimen=rested))
    # List the plans: motion, loop of the plan, and name of the model, empty if calibrated.
    wanted = [
        *itertools.product(MOTIONS, [OPEN_LOOP], models),
        *itertools.product(MOTIONS, [FEEDBACK], [""]),
    ]
    announce(f"3/5 planning motions: {len(wanted)}")
    calls = []
    for motion, loop, model in wanted:
        calls.append(functools.partial(plan_motion, models[model], motion, taught, loop, start))
    plans = dict(zip(wanted, call_all(calls, num_processes), strict=True))
    # List the runs: motion, method and model, the longest first.
    others = [model for model in models if model]
    runs = []
    for way, motion in itertools.product(reversed(CLOSED_LOOP), MOTIONS):
        if way in settings.closed_loop(motion):
            runs.append((motion, way, ""))
    runs += itertools.product(MOTIONS, [OPEN_LOOP], others)
    num_runs = len(MOTIONS) + len(runs)
    announce(f"4/5 driving the limb along its plans in several ways: {num_runs}")
    # Drive the limb: open loop, by each method, and with disturbances.
    opened = {motion: plans[motion, OPEN_LOOP, ""] for motion in MOTIONS}
    calls = [functools.partial(open_loop, rested, calibration, opened)]
    for motion, way, model in runs:
        trajectory = plans[motion, OPEN_LOOP if way == OPEN_LOOP else FEEDBACK, model]
        number = MOTIONS.index(motion)
        calls.append(functools.partial(roll_out, rested, trajectory, way, COUNTS[way], number))
    fig5 = {loop: plans[VALIDATION, loop, ""] for loop in (OPEN_LOOP, FEEDBACK)}
    disturbances = DISTURBANCES if settings.disturb else ()
    for disturbance in disturbances:
        calls.append(functools.partial(roll_out_disturbed, rested, fig5, disturbance))
    (firsts, split), *driven = call_all(calls, num_processes)
    # Sort the rollouts by motion and method, and by other models.
    rollouts = dict(zip(runs, driven, strict=False))
    ways: dict[str, dict[str, PlanWithRollouts]] = {}
    compared: dict[str, dict[str, PlanWithRollouts]] = {model: {} for model in others}
    for motion in MOTIONS:
        ways[motion] = {OPEN_LOOP: firsts[motion]}
        for way in settings.closed_loop(motion):
            ways[motion][way] = rollouts[motion, way, ""]
        for model in others:
            compared[model][motion] = rollouts[motion, OPEN_LOOP, model]
    return Experiment(
        specimen,
        recordings,
        calibration,
        taught,
        ways,
        disturbed=dict(zip(disturbances, driven[len(runs) :], strict=True)),
        split=split,
        compared=compared,
    )


def call_all(calls: Sequence[Callable[[], Any]], num_processes: int) -> list[Any]:
    """Make calls in several processes, and return their results."""
    return list(run_each(operator.call, calls, num_processes, in_order=True))


def record(settings: Settings) -> tuple[Specimen, dict[str, list[Recording]]]:
    """Return a new limb, and its recordings for calibration."""
    twin = LimbTwin(seed=settings.seed, physics=settings.physics)
    return twin.specimen, collect_from_twin(twin, seed=settings.seed, num_angles=NUM_ANGLES)


def fit(
    recordings: dict[str, list[Recording]], compare: bool
) -> tuple[Calibration, dict[str, LimbParameters]]:
    """Return the calibration of a limb, and models of it by name, the calibrated one as ""."""
    calibration = calibrate(recordings)
    # Compare with the limb as described, the paper's method and each other law.
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
        hand = taught_motion(name)
        taught[name] = watch(
            LimbTwin(specimen=specimen).after_rest(PAUSE, hand=hand), hand.end_time()
        )
    LimbTwin(specimen=specimen).after_rest(PAUSE)
    return specimen.with_noise(0), taught


def open_loop(
    rested: Specimen, calibration: Calibration, plans: dict[str, Trajectory]
) -> tuple[dict[str, PlanWithRollouts], dict[str, Split]]:
    """Return rollouts of each motion's plan, and the split of the first rollout's error."""
    ways = {}
    for motion, trajectory in plans.items():
        number = MOTIONS.index(motion)
        ways[motion] = roll_out(rested, trajectory, OPEN_LOOP, NUM_ROLLOUTS, number)
    return ways, error_split(calibration, ways)


def plan_motion(
    limb: LimbParameters,
    motion: str,
    taught: dict[str, Recording],
    loop: str,
    start: np.ndarray,
) -> Trajectory:
    """Plan one of `MOTIONS` for a loop (open or feedback), starting at the readings ``start``."""
    if motion in taught:
        reference = references.from_recording(taught[motion], SMOOTHING_TIME)
    else:
        reference = DRAWN[motion]()
    task = Task.paper() if loop == OPEN_LOOP else Task.closed_loop(limb)
    return plan(limb, reference, task=task, initial_state=resting_state(limb, start))
