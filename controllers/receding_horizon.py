"""Replans towards the reference, while a limb moves, and follows the newest plan."""

import numpy as np

from controllers.estimator import Estimate
from controllers.gains import mean_gains
from controllers.horizon import HorizonPlan
from controllers.plan_controller import PlanController, share, within_total
from controllers.planner_process import PlannerProcess, planner_of
from controllers.reduced_model import PERIOD
from limb_systems import Trajectory
from planners import Task

TICKS = 5  # from one plan to the next
PROPORTIONAL = 1.0  # 1/s; the next plan corrects what this does not


class RecedingHorizon(PlanController):
    """Feedback that plans the coming seconds again and again, towards a plan's reference.

    At 4 Hz `HorizonPlanner` plans from the estimate of the next tick, from which on the
    new plan is in force. Between plans, the estimated bend φ is held to that of the
    newest by a bend rate of k_p (φ* - φ), which the wires share as in `PlanFeedback`.

    In simulated time, a plan is made within its tick. In real time it is made in a
    process of its own and the command never waits for it: the plan before stays in
    force until it is there. It is late if that is not so when the next one is due,
    which is then left out. If planning fails, the plan before stays in force, too.

    Ports and state are those of `PlanController`, and

    - output 1 ``replans``: how many plans were begun, were late and failed (3)
    - state, discrete, at 20 Hz: 2: the replans; 3: the plan in force
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(
        self, trajectory: Trajectory, *, task: Task | None = None, real_time: bool = False
    ):
        """
        Args:
            trajectory: a plan, whose reference it follows, and whose duty is in force
                until the first plan of its own.
            task: as of `HorizonPlanner`.
            real_time: whether plans are made in a process of their own.
        """
        plan, parameters = trajectory.since_start(), trajectory.parameters
        planner = planner_of(plan, task)
        self._planner, self._process = planner, PlannerProcess(plan, task) if real_time else None
        first = planner.beginning_of(plan)
        super().__init__(parameters, first.duty[0])
        self._is_pending = False  # a plan of the process
        self._gains = mean_gains(self._estimator.model)
        self._shapes = [array.shape for array in _arrays(first)]
        self._splits = np.cumsum([array.size for array in _arrays(first)])[:-1]
        replans = self.DeclareDiscreteState(3)
        self.DeclareDiscreteState(_packed(first))
        self.DeclareStateOutputPort("replans", replans)
        self.set_name("receding_horizon")

    def _duty(self, time: float, estimate: Estimate, caps: np.ndarray, state) -> np.ndarray:
        counts, model = state.value(2).copy(), self._estimator.model
        plan = self._newest(self._unpacked(state.value(3)), counts)
        bend = model.bend_angle(estimate.heat) + estimate.offset
        missed = plan.bend_angle_at(time) - bend
        base = np.clip(plan.duty_at(time), 0.0, caps)
        duty = within_total(
            share(PROPORTIONAL * missed, base, self._gains, caps), self._parameters.total_duty
        )
        if round(time / PERIOD) % TICKS == 0:
            ahead = self._estimator.predicted(estimate, duty)
            plan = self._replan(time + PERIOD, ahead, plan, counts)
        state.set_value(2, counts)
        state.set_value(3, _packed(plan))
        return duty

    def _replan(
        self, time: float, estimate: Estimate, plan: HorizonPlan, counts: np.ndarray
    ) -> HorizonPlan:
        """The plan that is in force from a time on, or the same if the process makes it."""
        arguments = time, estimate.heat, estimate.offset, plan
        if self._process is None:
            counts[0] += 1
            return _if_made(self._planner.plan(*arguments), plan, counts)
        if self._is_pending:
            counts[1] += 1
        else:
            counts[0] += 1
            self._process.begin(*arguments)
            self._is_pending = True
        return plan

    def _newest(self, plan: HorizonPlan, counts: np.ndarray) -> HorizonPlan:
        """The plan of the process if it has made one, else that in force."""
        if not self._process or not self._is_pending:
            return plan
        if (made := self._process.plan_if_made()) is None:
            return plan
        self._is_pending = False
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
