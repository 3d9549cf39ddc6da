"""One limb through the whole paper: recordings, calibration, plans, rollouts."""

import copy
import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from calibration import Calibration, calibrate, collect_from_twin
from hardware import LimbTwin, replay, watch
from hardware.emulation.specimen import Specimen
from limb_systems import Recording, Trajectory
from planners import Task, plan, references

PAPER = "LinearLaw, calibrated as in Sec. V"
NUM_ROLLOUTS = 5
NUM_ANGLES = 6  # equilibria of each calibration recording
PAUSE = 300.0  # s without heat before each rollout
SMOOTHING_TIME = 0.5  # s, of taught bend angles

# What the hand moves through for the two taught motions, time in s and bend angle in degrees.
HANDS = {"T&R 1": "hand_1.csv", "T&R 2": "hand_2.csv"}


NUM_STEPS = 3 + len(HANDS)  # recording, calibrating, the drawn motion and the taught ones


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """One of the paper's three experiments.

    - ``name``: as in Table I.
    - ``taught``: what the hand did, with the wires off; None if drawn.
    - ``trajectory``: the plan.
    - ``rollouts``: open loop, as the sensors saw them; those in which a wire was
      measured at the limit of the board end there.
    - ``exact``: the first rollout as a sensor without errors sees it.
    """

    name: str
    taught: Recording | None
    trajectory: Trajectory
    rollouts: list[Recording]
    exact: Recording


@dataclasses.dataclass(frozen=True, eq=False)
class Experiment:
    """A limb, its calibration and its motions.

    - ``specimen``: the emulation's truth, which nothing looks into.
    - ``calibration``: by prediction error.
    - ``motions``: planned with it.
    - ``compared``: motions that were planned with the paper's calibration, by `PAPER`, and
      with other laws, by their names.
    """

    specimen: Specimen
    recordings: dict[str, list[Recording]]
    calibration: Calibration
    motions: list[Motion]
    compared: dict[str, list[Motion]]


def hand_course(name: str) -> PiecewisePolynomial:
    """What the hand moves through for a taught motion, rad; it rests at both ends."""
    times, angles = np.loadtxt(Path(__file__).with_name(HANDS[name]), delimiter=",").T
    return PiecewisePolynomial.CubicShapePreserving(
        times, np.deg2rad([angles]), zero_end_point_derivatives=True
    )


def run_experiment(
    specimen: Specimen,
    num_rollouts: int = NUM_ROLLOUTS,
    tell: Callable[[str], object] = lambda step: None,
    *,
    compare: bool = True,
    protocol: str = "all",
    num_angles: int = NUM_ANGLES,
) -> Experiment:
    """Takes a new limb through Secs. V to VII.

    Args:
        specimen: the limb; it is used from then on.
        num_rollouts: of each plan; those with other laws are rolled out once.
        tell: is called before each of the `NUM_STEPS` steps, with what comes.
        compare: whether to plan with the paper's calibration and with other laws, too.
        protocol, num_angles: of the recordings, "all" or "paper", and how many equilibria each
            of Sec. V has; see `collect_from_twin`.
    """
    tell("recording it as calibration wants it")
    recordings = collect_from_twin(
        LimbTwin(specimen=specimen), seed=specimen.seed, num_angles=num_angles, protocol=protocol
    )
    tell("calibrating the model to the recordings")
    calibration = calibrate(recordings)
    limbs = {"": calibration.parameters}
    if compare:
        limbs[PAPER] = calibrate(recordings, method="paper").parameters
        assert calibration.prediction is not None
        for candidate in calibration.prediction.candidates:
            limbs[candidate.name] = copy.deepcopy(calibration.parameters)
            limbs[candidate.name].calibration = None  # it is of the best law
            candidate.fit.apply(limbs[candidate.name].segments[0])
    motions: dict[str, list[Motion]] = {name: [] for name in limbs}
    for name in ("Validation", *HANDS):
        tell(f"planning the motion {name}, and replaying it")
        taught, reference = None, references.step_and_decaying_sine()
        if name in HANDS:
            hand = hand_course(name)
            taught = watch(LimbTwin(specimen=specimen).again(PAUSE, hand=hand), hand.end_time())
            reference = references.from_recording(taught, SMOOTHING_TIME)
        for approach, limb in limbs.items():
            trajectory = plan(limb, reference, task=Task.paper())
            rollouts, exact = [], None
            for _ in range(num_rollouts if approach in ("", PAPER) else 1):
                rested = LimbTwin(specimen=specimen).again(PAUSE)
                if exact is None:
                    exact = replay(trajectory, LimbTwin(specimen=specimen.without("bend sensor")))
                rollouts.append(replay(trajectory, rested))
            motions[approach].append(Motion(name, taught, trajectory, rollouts, exact))
    return Experiment(specimen, recordings, calibration, motions.pop(""), motions)
