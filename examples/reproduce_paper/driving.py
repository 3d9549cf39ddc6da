"""Drive a limb along a plan: open loop, in closed loop, with learning, and with disturbances."""

import copy
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem, System

from controllers import Learner, PlanFeedback, PlanRegulator, RecedingHorizon
from hardware import LimbTwin, replay
from hardware.emulation.specimen import Specimen
from limb_systems import LimbParameters, Recording, Trajectory
from limb_systems.drake_python import weak_method
from limb_systems.limb_system import wrap_controller
from limb_systems.simulation import PERIOD

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

# Disturbances of the limb, see `Specimen.disturbed`.
LIMB_DISTURBANCES: dict[str, dict[str, float]] = {
    "none": {},
    "room +5 °C": {"ambient": 5.0},
    "room -5 °C": {"ambient": -5.0},
    "payload +5°": {"payload": np.deg2rad(5.0)},
    "payload -5°": {"payload": np.deg2rad(-5.0)},
    "stiffness +20%": {"stiffness": 1.2},
    "stiffness -20%": {"stiffness": 0.8},
    "fan, cooling +30%": {"cooling": 1.3},
    "supply +10%": {"supply": 1.1},
    "supply -10%": {"supply": 0.9},
    "twice the bend sensor's noise": {"noise": 2.0},
}
# Disturbances of the bend reading, see `BendPath`; an absence is in mid motion.
SENSOR_DISTURBANCES: dict[str, dict[str, Any]] = {
    "bend read 0.1 s later": {"delay": 0.1},
    "no bend for 2 s": {"absence": 2.0},
    "bend held for 2 s": {"absence": 2.0, "hold_last": True},
}
WRONG_CALIBRATION = "gains of the nominal limb"
DISTURBANCES = (*LIMB_DISTURBANCES, *SENSOR_DISTURBANCES, WRONG_CALIBRATION)


@dataclasses.dataclass(frozen=True, eq=False)
class PlanWithRollouts:
    """A plan and its rollouts, whose recordings have the limb's true state.

    Rollouts of learning are in the order of the repetitions.
    """

    trajectory: Trajectory
    rollouts: Sequence[Recording]


def roll_out(
    specimen: Specimen, trajectory: Trajectory, way: str, count: int, motion: int = 0
) -> PlanWithRollouts:
    """Drive a rested limb along a plan several times, each time with new sensor noise.

    The first rollout changes the limb's rest angle by some tenths of a degree, further rollouts
    by some hundredths. So the limb rests after the first rollout, and all others begin from that
    state. With learning the duty changes, and each repetition begins from the state that the
    previous repetition has left. The noise depends on the number of the motion, but not on the
    method. With learning, each rollout is the best repetition so far, as the learner selects it.

    Args:
        way: `OPEN_LOOP`, a key of `CONTROLLERS`, or `LEARNING`.
        count: number of rollouts.
        motion: number of the motion.
    """
    rollouts: list[Recording] = []
    repetitions: list[Recording] = []
    learner = Learner(trajectory) if way == LEARNING else None
    for number in range(count):
        # Choose the controller, and drive the limb.
        if learner:
            controller = learner.source()
        else:
            controller = CONTROLLERS[way](trajectory) if way in CONTROLLERS else None
        limb = specimen.with_noise(motion, number)
        driven = _run(limb, trajectory, controller)
        # Learn from the readings alone.
        if learner:
            repetitions.append(driven)
            learner.update(_without_truth(driven))
            driven = repetitions[learner.best or 0]
        rollouts.append(driven)
        if number == count - 1:
            break
        # Let the limb rest.
        if learner or number == 0:
            LimbTwin(specimen=limb).after_rest(PAUSE)
            specimen = limb
    return PlanWithRollouts(trajectory, rollouts)


def roll_out_disturbed(
    specimen: Specimen, plans: dict[str, Trajectory], disturbance: str
) -> dict[str, PlanWithRollouts]:
    """Drive a limb with a disturbance: with feedback, and if the limb is disturbed in open loop.

    Args:
        plans: the plan of the motion for `OPEN_LOOP` and the plan for `FEEDBACK`.
        disturbance: one of `DISTURBANCES`.
    """
    limb = specimen.with_noise(0, 0).disturbed(**LIMB_DISTURBANCES.get(disturbance, {}))
    trajectory = plans[FEEDBACK]
    driven: dict[str, tuple[Trajectory, System | None]] = {}
    controller: System
    if disturbance in SENSOR_DISTURBANCES:
        # Disturb the reading between limb and controller.
        feedback = PlanFeedback(trajectory)
        changes = SENSOR_DISTURBANCES[disturbance]
        size = feedback.GetInputPort("bend_angle").size()
        path = BendPath(size, start=trajectory.duration / 2, **changes)
        controller = wrap_controller(path, feedback)
    elif disturbance in LIMB_DISTURBANCES:
        controller = PlanFeedback(trajectory)
        driven[OPEN_LOOP] = plans[OPEN_LOOP], None
    else:
        controller = PlanFeedback(trajectory, parameters=LimbParameters())
    driven[FEEDBACK] = trajectory, controller
    rollouts = {}
    for way, (plan, system) in driven.items():
        rollouts[way] = PlanWithRollouts(plan, [_run(copy.deepcopy(limb), plan, system)])
    return rollouts


def _run(limb: Specimen, trajectory: Trajectory, controller) -> Recording:
    return replay(trajectory, LimbTwin(specimen=limb, truth=True), controller=controller)


def _without_truth(recording: Recording) -> Recording:
    """Return a recording without the true state, like the recording of a robot."""
    return dataclasses.replace(recording, joint_state=None, wire_temperature=None)


class BendPath(LeafSystem):
    """A system between bend sensor and controller that delays or interrupts the reading.

    - input 0 ``bend_angle``: φ (F), rad
    - output 0 ``bend_angle``: φ (F), rad, some periods later; while it is absent NaN, or the
      last reading
    - state, discrete: readings on their way (L F), the oldest first, and the last one that
      is not absent (F); updated each `PERIOD`
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(
        self,
        size: int,
        *,
        delay: float = 0.0,
        start: float = 0.0,
        absence: float = 0.0,
        hold_last: bool = False,
    ):
        """
        Args:
            size: S.
            delay: s, in multiples of `PERIOD`.
            start, absence: start and duration of the absence, s.
            hold_last: whether the output is the last reading in the absence; NaN if not.
        """
        super().__init__()
        # Keep the settings; the delay is a number of periods.
        self._start = start
        self._end = start + absence
        self._hold_last = hold_last
        self._num_late = round(delay / PERIOD)
        self._size = size
        # Declare ports and state: the delayed readings and the last present reading.
        self.DeclareVectorInputPort("bend_angle", size)
        self.DeclareDiscreteState((self._num_late + 1) * size)
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._fill))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))
        self.DeclareVectorOutputPort("bend_angle", size, weak_method(self._calc))

    def _is_absent(self, context) -> bool:
        return self._start <= context.get_time() < self._end

    def _fill(self, context, discrete_state):
        reading = self.get_input_port().Eval(context)
        discrete_state.set_value(np.tile(reading, self._num_late + 1))

    def _update(self, context, discrete_state):
        on_the_way, last = self._readings(context)
        if not self._is_absent(context):
            last = on_the_way[0]
        discrete_state.set_value(np.concatenate([*on_the_way[1:], last]))

    def _readings(self, context) -> tuple[np.ndarray, np.ndarray]:
        """Return the delayed readings and the newest (L + 1, F), and the last present one (F,)."""
        kept = context.get_discrete_state_vector().value().reshape(-1, self._size)
        return np.vstack([kept[:-1], self.get_input_port().Eval(context)]), kept[-1]

    def _calc(self, context, output):
        on_the_way, last = self._readings(context)
        reading = on_the_way[0]
        if self._is_absent(context):
            reading = last if self._hold_last else np.full(self._size, np.nan)
        output.SetFromVector(reading)
