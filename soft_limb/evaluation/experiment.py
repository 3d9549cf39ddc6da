"""One limb through the whole paper: recordings, calibration, plans, rollouts."""

import copy
import dataclasses
import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from calibration import Calibration, calibrate, collect_from_twin
from calibration.validation import Validation
from hardware import LimbTwin, watch
from hardware.emulation.specimen import Specimen
from limb_systems import LimbParameters, Recording, Trajectory
from planners import Task, plan, references
from soft_limb.evaluation.disturbances import DISTURBANCES
from soft_limb.evaluation.error_split import error_split
from soft_limb.evaluation.ways import (
    CLOSED_LOOP,
    FEEDBACK,
    FOLLOW,
    LEARNING,
    OPEN_LOOP,
    PAUSE,
    Way,
    roll_out,
    roll_out_disturbed,
)
from soft_limb.runs.jobs import Evaluation

# Table I has the distance of each plan from its reference.
warnings.filterwarnings("ignore", "The plan is far from its reference")

AS_DESCRIBED = "as described, not calibrated"
PAPER = "LinearLaw, calibrated as in Sec. V"
NUM_ROLLOUTS = 5
NUM_CLOSED_LOOP = 2
NUM_REPETITIONS = 10
NUM_ANGLES = 6  # equilibria of each calibration recording
SMOOTHING_TIME = 0.5  # s, of taught bend angles

# What the hand moves through for the two taught motions, time in s and bend angle in degrees.
HANDS = {"T&R 1": "hand_1.csv", "T&R 2": "hand_2.csv"}


VALIDATION, RAMPS = "Validation", "Ramps"
MOTIONS = (VALIDATION, *HANDS, RAMPS)
DRAWN = {VALIDATION: references.step_and_decaying_sine, RAMPS: references.ramps}
NUM_STEPS = 4  # that `evaluate` tells


@dataclasses.dataclass(frozen=True)
class Settings:
    """What is done with a limb.

    - ``seed``, ``extra``: arguments of the limb's `Specimen`.
    - ``physics``: family of the limb, as of `LimbTwin`.
    - ``rollouts``: how often each plan is driven open loop; twice with a controller, whose
      rollouts differ by the sensors' noise alone, and once with the receding horizon.
    - ``repetitions``: how often a plan that is learned is driven.
    - ``closed_loop``: ways of `CLOSED_LOOP` in which each motion is driven, too.
    - ``disturbances``: names in `DISTURBANCES` under which feedback drives the motion of Fig. 5.
    - ``compare``: whether to plan with the paper's calibration and with other laws, too, and not
      with the limb as it was described alone; these plans are rolled out once.
    - ``protocol``, ``num_angles``: "all" recordings or the "paper"'s alone, and how many
      equilibria each of Sec. V has; see `collect_from_twin`.
    """

    seed: int
    extra: tuple[str, ...] = ()
    rollouts: int = NUM_ROLLOUTS
    repetitions: int = NUM_REPETITIONS
    closed_loop: dict[str, tuple[str, ...]] = dataclasses.field(
        default_factory=lambda: dict.fromkeys(MOTIONS, CLOSED_LOOP)
    )
    disturbances: tuple[str, ...] = DISTURBANCES
    compare: bool = True
    protocol: str = "all"
    num_angles: int = NUM_ANGLES
    physics: str = "lumped"


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """One of the paper's three experiments, or `RAMPS`.

    - ``name``: as in Table I.
    - ``taught``: what the hand did, with the wires off; None if drawn.
    - ``ways``: plan and rollouts of each way to drive the limb, under its name; rollouts in
      which a wire was measured at the limit of the board end there.
    """

    name: str
    taught: Recording | None
    ways: dict[str, Way]

    @property
    def open_loop(self) -> Way:
        return self.ways[OPEN_LOOP]


@dataclasses.dataclass(frozen=True, eq=False)
class Experiment:
    """A limb, its calibration and its motions.

    - ``specimen``: the emulation's truth, which nothing looks into.
    - ``calibration``: its model, fitted by prediction error.
    - ``motions``: planned with it.
    - ``disturbed``: rollouts of the motion of Fig. 5 for each disturbance.
    - ``split``: parts of the first rollouts' error, see `error_split`.
    - ``compared``: motions that were planned with the limb `AS_DESCRIBED`, with the paper's
      calibration, by `PAPER`, and with other laws, by their names.
    """

    specimen: Specimen
    recordings: dict[str, list[Recording]]
    calibration: Calibration
    motions: list[Motion]
    disturbed: dict[str, dict[str, Way]]
    split: dict[str, dict[str, tuple[float, float]]]
    compared: dict[str, list[Motion]]

    @property
    def validation(self) -> Validation:
        """The calibration's; recordings of an emulated limb are enough for one."""
        assert self.calibration.validation is not None
        return self.calibration.validation


def hand_course(name: str) -> PiecewisePolynomial:
    """What the hand moves through for a taught motion, rad; it rests at both ends."""
    times, angles = np.loadtxt(Path(__file__).with_name(HANDS[name]), delimiter=",").T
    return PiecewisePolynomial.CubicShapePreserving(
        times, np.deg2rad([angles]), zero_end_point_derivatives=True
    )


def evaluate(settings: Settings, tell: Callable[[str], object] = lambda step: None) -> Evaluation:
    """Takes a new limb through Secs. V to VII, and on to closed loop, for `run_all`.

    Each way to drive each plan begins where the limb was left by the recordings, the hand
    and a rest.

    Args:
        settings: what is done.
        tell: is called before each of the `NUM_STEPS` steps, with what comes.

    Returns:
        An `Experiment`.
    """
    tell("recording the limb as calibration wants it")
    ((specimen, recordings),) = yield [functools.partial(record, settings)]
    tell("calibrating the model to the recordings, and teaching motions by hand")
    (calibration, limbs), (rested, taught) = yield [
        functools.partial(fit, recordings, settings.compare),
        functools.partial(teach, specimen),
    ]
    closed = [motion for motion in MOTIONS if settings.closed_loop.get(motion)]
    wanted = [(motion, OPEN_LOOP, limb) for motion in MOTIONS for limb in limbs]
    wanted += [(motion, FEEDBACK, "") for motion in closed]
    tell(f"planning motions: {len(wanted)}")
    found = yield [
        functools.partial(plan_motion, limbs[limb], motion, taught, loop)
        for motion, loop, limb in wanted
    ]
    plans = dict(zip(wanted, found, strict=True))
    # What is done with each plan, the longest first.
    runs = [
        (motion, way, "")
        for way in reversed(CLOSED_LOOP)
        for motion in MOTIONS
        if way in settings.closed_loop.get(motion, ())
    ]
    runs += [key for key in wanted if key[2]]
    num_runs = len(MOTIONS) + len(runs)
    tell(f"driving the limb along its plans in several ways, and splitting the error: {num_runs}")
    opened = {motion: plans[motion, OPEN_LOOP, ""] for motion in MOTIONS}
    counts = dict.fromkeys(CLOSED_LOOP, min(NUM_CLOSED_LOOP, settings.rollouts))
    counts |= {LEARNING: settings.repetitions, FOLLOW: 1}
    calls: list[Callable[[], Any]] = [
        functools.partial(open_loop, rested, calibration, opened, settings.rollouts)
    ]
    for motion, way, limb in runs:
        count = counts.get(way, 1)
        trajectory = plans[motion, OPEN_LOOP if way == OPEN_LOOP else FEEDBACK, limb]
        number = MOTIONS.index(motion)
        calls.append(functools.partial(roll_out, rested, trajectory, way, count, number))
    first = {
        loop: plan
        for (motion, loop, limb), plan in plans.items()
        if motion == VALIDATION and not limb
    }
    calls += [
        functools.partial(roll_out_disturbed, rested, first, disturbance)
        for disturbance in settings.disturbances
    ]
    (firsts, split), *driven = yield calls
    ways = {(motion, OPEN_LOOP, ""): way for motion, way in firsts.items()}
    ways |= zip(runs, driven, strict=False)
    motions = {
        limb: [
            Motion(
                motion,
                taught.get(motion),
                {
                    way: ways[motion, way, limb]
                    for way in (OPEN_LOOP, *CLOSED_LOOP)
                    if (motion, way, limb) in ways
                },
            )
            for motion in MOTIONS
        ]
        for limb in limbs
    }
    disturbed = dict(zip(settings.disturbances, driven[len(runs) :], strict=True))
    return Experiment(specimen, recordings, calibration, motions.pop(""), disturbed, split, motions)


def record(settings: Settings) -> tuple[Specimen, dict[str, list[Recording]]]:
    """A new limb, and its recordings for calibration."""
    specimen = LimbTwin(seed=settings.seed, extra=settings.extra, physics=settings.physics).specimen
    recordings = collect_from_twin(
        LimbTwin(specimen=specimen),
        seed=settings.seed,
        num_angles=settings.num_angles,
        protocol=settings.protocol,
    )
    return specimen, recordings


def fit(
    recordings: dict[str, list[Recording]], compare: bool
) -> tuple[Calibration, dict[str, LimbParameters]]:
    """The calibration of a limb, and the limb as calibrated, also otherwise, by its name."""
    calibration = calibrate(recordings)
    limbs = {"": calibration.parameters, AS_DESCRIBED: LimbParameters()}
    if compare:
        limbs[PAPER] = calibrate(recordings, method="paper").parameters
        assert calibration.prediction is not None
        for candidate in calibration.prediction.candidates:
            limbs[candidate.name] = copy.deepcopy(calibration.parameters)
            limbs[candidate.name].calibration = None  # it is of the best law
            candidate.fit.apply(limbs[candidate.name])
    return calibration, limbs


def teach(specimen: Specimen) -> tuple[Specimen, dict[str, Recording]]:
    """Moves a limb by hand, and lets it rest; the limb then, and what it recorded."""
    taught = {}
    for name in HANDS:
        hand = hand_course(name)
        taught[name] = watch(LimbTwin(specimen=specimen).again(PAUSE, hand=hand), hand.end_time())
    LimbTwin(specimen=specimen).again(PAUSE)
    return specimen.with_noise(0), taught


def open_loop(
    rested: Specimen, calibration: Calibration, plans: dict[str, Trajectory], count: int
) -> tuple[dict[str, Way], dict[str, dict[str, tuple[float, float]]]]:
    """Rollouts of each motion's plan, and how the error of the first one is split."""
    ways = {
        motion: roll_out(rested, trajectory, OPEN_LOOP, count, MOTIONS.index(motion))
        for motion, trajectory in plans.items()
    }
    firsts = {motion: Way(way.trajectory, way.rollouts[:1]) for motion, way in ways.items()}
    return ways, error_split(calibration, firsts)


def plan_motion(
    limb: LimbParameters, motion: str, taught: dict[str, Recording], loop: str
) -> Trajectory:
    """A plan of one of `MOTIONS`, drawn or as it was taught, to be driven in a loop."""
    if motion in taught:
        reference = references.from_recording(taught[motion], SMOOTHING_TIME)
    else:
        reference = DRAWN[motion]()
    task = Task.paper() if loop == OPEN_LOOP else Task.closed_loop(limb)
    return plan(limb, reference, task=task)
