"""Ways to drive a limb along a plan: open loop, in closed loop, and learning over repetitions."""

import copy
import dataclasses
from collections.abc import Sequence

from controllers import Learner, PlanFeedback, PlanRegulator, RecedingHorizon
from hardware import LimbTwin, replay
from hardware.emulation.specimen import Specimen
from limb_systems import LimbParameters, Recording, Trajectory
from soft_limb.evaluation.disturbances import (
    LIMB_DISTURBANCES,
    SENSOR_DISTURBANCES,
    behind_bend_path,
)

OPEN_LOOP, FOLLOW, FEEDBACK, REGULATOR, LEARNING = (
    "open loop",
    "follow",
    "plan feedback",
    "plan regulator",
    "learning",
)
CONTROLLERS = {  # by `FOLLOW` a limb is driven as `soft-limb follow` does
    FOLLOW: RecedingHorizon,
    FEEDBACK: PlanFeedback,
    REGULATOR: PlanRegulator,
}
CLOSED_LOOP = (*CONTROLLERS, LEARNING)
PAUSE = 300.0  # s without heat, in which a limb rests


@dataclasses.dataclass(frozen=True, eq=False)
class Way:
    """A plan, and rollouts of it, whose recordings have the truth; by learning, in their order."""

    trajectory: Trajectory
    rollouts: Sequence[Recording]


def roll_out(
    specimen: Specimen, trajectory: Trajectory, way: str, count: int, motion: int = 0
) -> Way:
    """Rollouts of a plan on a limb, which has rested, each with noise of its own.

    The first one leaves the limb a little warm and not quite where it was, by some tenths of
    a degree, and further ones by some hundredths. So the limb rests after the first one, and
    the others begin there; repetitions of learning, whose duty changes, each begin where
    the one before has left it. Noise depends on the number of the motion, too, but not on
    the way. Of learning, each rollout is the best repetition so far, as the learner takes it.
    """
    rollouts: list[Recording] = []
    repetitions: list[Recording] = []
    learner = Learner(trajectory) if way == LEARNING else None
    for number in range(count):
        if learner:
            controller = learner.source()
        else:
            controller = CONTROLLERS[way](trajectory) if way in CONTROLLERS else None
        limb = specimen.with_noise(motion, number)
        driven = _run(limb, trajectory, controller)
        if learner:
            repetitions.append(driven)
            learner.update(_read(driven))
            driven = repetitions[learner.best or 0]
        rollouts.append(driven)
        if number == count - 1:
            break
        if learner or number == 0:
            LimbTwin(specimen=limb).again(PAUSE)
            specimen = limb
    return Way(trajectory, rollouts)


def roll_out_disturbed(
    specimen: Specimen, plans: dict[str, Trajectory], disturbance: str
) -> dict[str, Way]:
    """A rollout of feedback with a disturbance, and one in open loop if it is of the limb.

    Args:
        plans: the motion's plan for `OPEN_LOOP` and that for `FEEDBACK`.
        disturbance: one of `DISTURBANCES`.
    """
    limb = specimen.with_noise(0, 0).disturbed(**LIMB_DISTURBANCES.get(disturbance, {}))
    trajectory, ways = plans[FEEDBACK], {}
    if disturbance in SENSOR_DISTURBANCES:
        changes = SENSOR_DISTURBANCES[disturbance]
        start = trajectory.duration / 2
        controller = behind_bend_path(PlanFeedback(trajectory), start=start, **changes)
    elif disturbance in LIMB_DISTURBANCES:
        controller = PlanFeedback(trajectory)
        ways[OPEN_LOOP] = plans[OPEN_LOOP], None
    else:
        controller = PlanFeedback(trajectory, parameters=LimbParameters())
    ways[FEEDBACK] = trajectory, controller
    return {
        way: Way(plan, [_run(copy.deepcopy(limb), plan, system)])
        for way, (plan, system) in ways.items()
    }


def _run(limb: Specimen, trajectory: Trajectory, controller) -> Recording:
    return replay(trajectory, LimbTwin(specimen=limb, truth=True), controller=controller)


def _read(recording: Recording) -> Recording:
    """A recording without the truth, as one of a robot is."""
    return dataclasses.replace(recording, joint_state=None, wire_temperature=None)
