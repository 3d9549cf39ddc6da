"""Replans towards the reference, while a limb moves, and follows the newest plan."""

import concurrent.futures

import numpy as np
from pydrake.systems.framework import LeafSystem

from controllers.estimator import Estimate, Estimator
from controllers.horizon import HorizonPlan, HorizonPlanner
from controllers.reduced_model import PERIOD
from limb_systems import Trajectory
from limb_systems.model.ownership import weak_method
from planners import Task, references

TICKS = 5  # from one plan to the next
GAIN = 1.0  # 1/rad, of duty by the estimated bend's distance from the plan


class RecedingHorizon(LeafSystem):
    """Feedback that plans the coming seconds again and again, towards a plan's reference.

    At 20 Hz an `Estimator` corrects the heat and what bends the limb from outside;
    at 4 Hz `HorizonPlanner` plans from the estimate of the next tick, from which on
    the new plan is in force. Between plans, the estimated bend is held to the newest.

    In simulated time, a plan is made within its tick. In real time it is made in a
    thread of its own and the command never waits for it: the plan before stays in
    force until it is there. It is late if that is not so when the next one is due,
    which is then left out. If planning fails, the plan before stays in force, too.

    Ports of a limb with W wires and S segments:

    - input 0, ``measured_temperature`` (W), °C; NaN where there is no reading.
    - input 1, ``bend_angle`` (S), rad; NaN where there is no reading.
    - output 0, ``duty`` (W), in [0, 1].
    - output 1, ``replans`` (3): how many plans were begun, were late and failed.

    Discrete state 0 is the duty, 1 the replans, 2 the `Estimate`, NaN before the first
    readings, and 3 the plan in force.

    Args:
        trajectory: a plan, whose reference it follows, and whose duty is in force
            until the first plan of its own.
        task: as of `HorizonPlanner`.
        real_time: whether plans are made in a thread of their own.
    """

    __slots__ = ()

    def __init__(
        self, trajectory: Trajectory, *, task: Task | None = None, real_time: bool = False
    ):
        super().__init__()
        plan, parameters = trajectory.since_start(), trajectory.parameters
        self._estimator, self._total = Estimator(parameters), parameters.total_duty
        reference = references.from_samples(plan.time, plan.reference)
        self._planner = HorizonPlanner(parameters, reference, task)
        self._thread = concurrent.futures.ThreadPoolExecutor(1) if real_time else None
        self._pending: concurrent.futures.Future | None = None
        model = self._estimator.model
        self.DeclareVectorInputPort("measured_temperature", model.num_wires)
        self.DeclareVectorInputPort("bend_angle", model.num_segments)
        first = self._planner.beginning_of(plan)
        self._shapes = [array.shape for array in _arrays(first)]
        self._splits = np.cumsum([array.size for array in _arrays(first)])[:-1]
        duty = self.DeclareDiscreteState(first.duty[0])
        replans = self.DeclareDiscreteState(3)
        self.DeclareDiscreteState(np.full(self._estimator.size, np.nan))
        self.DeclareDiscreteState(_packed(first))
        self.DeclareStateOutputPort("duty", duty)
        self.DeclareStateOutputPort("replans", replans)
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))

    def _update(self, context, state) -> None:
        readings, bend = (self.get_input_port(index).Eval(context) for index in range(2))
        time, counts = context.get_time(), state.value(1).copy()
        plan = self._newest(self._unpacked(state.value(3)), counts)
        estimate = self._estimator.unpack(state.value(2))
        if np.isnan(estimate.heat).any():
            estimate = self._estimator.begin(readings, bend)
        duty = self._duty(time, plan, estimate)
        estimate = self._estimator.step(estimate, duty, readings, bend)
        if round(time / PERIOD) % TICKS == 0:
            plan = self._replan(time + PERIOD, estimate, plan, counts)
        state.set_value(0, duty)
        state.set_value(1, counts)
        state.set_value(2, self._estimator.pack(estimate))
        state.set_value(3, _packed(plan))

    def _duty(self, time: float, plan: HorizonPlan, estimate: Estimate) -> np.ndarray:
        """The plan's, with what holds the estimated bend to it, within the limb's bounds."""
        model = self._estimator.model
        bend = model.bend_angle(estimate.heat) + estimate.offset
        missed = plan.bend_angle_at(time) - bend
        duty = np.clip(plan.duty_at(time) + GAIN * missed @ model.sides, 0.0, 1.0)
        return duty * min(1.0, self._total / max(duty.sum(), 1e-9))

    def _replan(
        self, time: float, estimate: Estimate, plan: HorizonPlan, counts: np.ndarray
    ) -> HorizonPlan:
        """The plan that is in force from a time on, or the same if a thread makes it."""
        arguments = time, estimate.heat, estimate.offset, plan
        if self._thread is None:
            counts[0] += 1
            return _if_made(self._planner.plan(*arguments), plan, counts)
        if self._pending is None:
            counts[0] += 1
            self._pending = self._thread.submit(self._planner.plan, *arguments)
        else:
            counts[1] += 1
        return plan

    def _newest(self, plan: HorizonPlan, counts: np.ndarray) -> HorizonPlan:
        """The plan of the thread if it has one, else that in force."""
        if self._pending is None or not self._pending.done():
            return plan
        made, self._pending = self._pending.result(), None
        return _if_made(made, plan, counts)

    def _unpacked(self, vector: np.ndarray) -> HorizonPlan:
        """The inverse of `_packed`; cost and time of solving are not kept."""
        parts = np.split(vector, self._splits)
        time, duty, heat, bend_angle = (
            part.reshape(shape) for part, shape in zip(parts, self._shapes, strict=True)
        )
        return HorizonPlan(time, duty, heat, bend_angle, np.nan, np.nan, True)


def _packed(plan: HorizonPlan) -> np.ndarray:
    return np.concatenate([array.ravel() for array in _arrays(plan)])


def _arrays(plan: HorizonPlan) -> list[np.ndarray]:
    return [plan.time, plan.duty, plan.heat, plan.bend_angle]


def _if_made(made: HorizonPlan, plan: HorizonPlan, counts: np.ndarray) -> HorizonPlan:
    """A new plan, or the one before if it failed, which is counted."""
    counts[2] += not made.success
    return made if made.success else plan
