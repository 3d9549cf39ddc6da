"""Plans of the coming seconds, from the heat that a limb has towards its reference.

The chain swings at some hertz, and knots at 5 Hz cannot show that. So a horizon is planned by the
quasi-static program with `ReducedModel`, which has a fifth of the states of (17). Each plan takes
one or more convex programs:

- The model is linearized along its rollout under the better duty of two: of the previous plan, and
  of a plan of the whole motion. Where hysteresis makes a wire's torque flat, its slope is zero
  although heat would help, so that a plan from the previous plan would stay there.
- The program with the linear model is solved.
- Of some steps towards the solution, the step that costs least with the nonlinear model is taken.

T_max and T_warm may be passed at a cost, so that there is always a plan. Heat beyond a plan of the
whole motion costs, too: a wire that was too hot holds the limb for longer than a horizon.
"""

import dataclasses

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from pydrake import trajectories

from controllers.estimator import RESIDUAL_TIME
from controllers.reduced_model import ReducedModel
from limb_systems import LimbParameters, Trajectory
from limb_systems.smooth_function import SmoothFunction
from planners import Task, references
from planners.nearest import nearest_plan
from planners.transcription.function_block import FunctionBlock
from planners.transcription.ipopt import ConstraintBlock
from planners.transcription.program import add_soft_bounds
from planners.transcription.quasi_static import QuasiStaticProgram
from planners.transcription.sequential_convex import descend

DURATION = 10.0  # s
KNOT_RATE = 5.0  # Hz
ROUNDS = 1  # of linearizing and solving, from the previous plan; two are not better, and slower
FIRST_ROUNDS = 8  # from wires that are off
STEP_SIZES = np.array([1.0, 0.7, 0.4, 0.2, 0.1, 0.03])  # of the way to a program's solution
MIN_COST_REDUCTION = 1e-3  # relative; a round that reduces the cost by less is the last
EXCESS_TEMPERATURE = 3.0  # °C, that a wire may be warmer than in the plan of the whole motion
EXCESS_WEIGHT = 0.03  # 1/°C, of each knot beyond it
TASK_FIELDS = (  # fields of a task that a horizon uses
    "angle_weight",
    "duty_weight",
    "terminal_factor",
    "phases",
    "temperature_weight",
    "temperature_margin",
    "duty_margin",
)
LIMIT_WEIGHT = 1.0  # 1/°C, of each knot beyond T_max or T_warm; as much as 11° of bend


def horizon_task() -> Task:
    """Return the weights of a horizon: less duty than (15), as the next plan follows soon."""
    return Task(
        duty_weight=0.01, terminal_factor=1.0, temperature_weight=2e-4, temperature_margin=10.0
    )


@dataclasses.dataclass(frozen=True)
class HorizonPlan:
    """The coming seconds of a limb with F bends and W wires, whose heat has H numbers.

    Duty is constant between the K knots; each duty follows its knot.

    - ``time``: times of the knots (K + 1,), s.
    - ``duty``: D (K, W).
    - ``heat``: [x, V] at the knots (K + 1, H), as in `ReducedModel`.
    - ``bend_angle``: φ at the knots (K + 1, F), rad, offset included.
    - ``cost``: value of the cost, excess of limits included.
    - ``success``: whether a program was solved; else the duty is the previous plan's.
    """

    time: np.ndarray
    duty: np.ndarray
    heat: np.ndarray
    bend_angle: np.ndarray
    cost: float
    success: bool

    def duty_at(self, times: ArrayLike) -> np.ndarray:
        """Return D (..., W) at times (...), s; the last duty after the end."""
        index = np.searchsorted(self.time, np.asarray(times) + 1e-9, side="right") - 1
        return self.duty[np.clip(index, 0, len(self.duty) - 1)]

    def bend_angle_at(self, time: float) -> np.ndarray:
        """Return φ (F,) at a time, s, in rad; the last φ after the end."""
        return np.array([np.interp(time, self.time, bend) for bend in self.bend_angle.T])


class HorizonPlanner:
    """A planner of horizons towards a reference, from any heat.

    The cost is (15), with limits that cost, too. A planner keeps nothing from plan to plan, and
    makes one plan at a time.

    Args:
        parameters: description of the limb.
        reference: φ_ref in rad, a row for each bend, over the time of the plan;
            its last angle is held.
        task: its weights of angles, duty, temperature and the end, and its margins
            count; `horizon_task()` if None. T_max and T_warm may be passed, at a cost.
        duration: length of the horizon, s.
        planned: a plan of the whole motion that starts at time 0, if there is one. Wires that are
            hotter than in the plan nearest to its reference cost.
    """

    def __init__(
        self,
        parameters: LimbParameters,
        reference: trajectories.Trajectory,
        task: Task | None = None,
        *,
        duration: float = DURATION,
        planned: Trajectory | None = None,
    ):
        self._reference = reference
        self._planned = planned
        self._planned_duty = planned.duty_trajectory() if planned else None
        nearest = nearest_plan(planned) if planned else None
        self._planned_temperature = nearest and nearest[1]
        self._limits = parameters.temperature_limits
        self._times = times = np.arange(max(1, round(duration * KNOT_RATE)) + 1) / KNOT_RATE
        self._model = model = ReducedModel(parameters, 1.0 / KNOT_RATE)
        self._program = HorizonProgram(model, times, task or horizon_task())
        self._decay = np.exp(-times / RESIDUAL_TIME)[:, None]

    @classmethod
    def of(cls, trajectory: Trajectory, task: Task | None = None) -> "HorizonPlanner":
        """Return a planner towards the reference of a `Planner`'s plan that starts at time 0."""
        reference = references.from_samples(trajectory.time, trajectory.reference)
        return cls(trajectory.parameters, reference, task, planned=trajectory)

    def plan(
        self,
        time: float,
        heat: np.ndarray,
        bend_offset: np.ndarray,
        previous: HorizonPlan | None = None,
        residual: np.ndarray | float = 0.0,
    ) -> HorizonPlan:
        """Return a plan from a time on.

        Args:
            time: time since the start of the reference, s.
            heat: [x, V] at that time (H,).
            bend_offset: lasting part of the limb's bend angle less the model's (F,), rad.
            previous: an earlier plan to start from; wires that are off if None.
            residual: fading part of the limb's bend angle less the model's, now (F,), rad.
        """
        # Aim the program at the reference from this heat.
        times = time + self._times
        reference = self._reference.vector_values(np.minimum(times, self._reference.end_time()))
        highest = self._max_temperatures(times[1:], bend_offset + residual)
        bend_offset = bend_offset + self._decay * residual
        warm_up_time = self._limits.warm_up_time - time
        self._program.set_target(reference.T - bend_offset, heat, warm_up_time, highest)
        # Collect duties to start from.
        duties = [] if previous is None else [previous.duty_at(times[:-1])]
        if self._planned_duty is not None:
            duties.append(self._mean_duty(self._planned_duty, times))
        duties = duties or [np.zeros((len(times) - 1, self._model.num_wires))]

        def cheapest(duties):
            """Return the best of some duties (B, K, W) with its rollout, and its cost."""
            start = np.broadcast_to(heat, (len(duties), len(heat)))
            rollouts = self._model.rollout(start, duties.swapaxes(0, 1))
            costs = self._program.costs(rollouts, duties)
            best = costs.argmin()
            return (duties[best], rollouts[:, best]), costs[best]

        def solve(point):
            duty, heats = point
            best = self._program.solve_for_duty(heats, duty)
            return None if best is None else (best, heats)

        def step(point, best, _):
            return cheapest(point[0] + STEP_SIZES[:, None, None] * (best[0] - point[0]))

        # Linearize, solve and step from the cheapest duty.
        point, cost = cheapest(np.array(duties))
        rounds = FIRST_ROUNDS if previous is None else ROUNDS
        (duty, heats), cost, success = descend(point, cost, solve, step, rounds, MIN_COST_REDUCTION)
        return HorizonPlan(
            time=times,
            duty=duty,
            heat=heats,
            bend_angle=self._model.bend_angle(heats) + bend_offset,
            cost=float(cost),
            success=success,
        )

    def first_horizon(self, trajectory: Trajectory) -> HorizonPlan:
        """Return the first horizon of a `Planner`'s plan that starts at time 0."""
        knots = np.minimum(self._times, trajectory.duration)
        heat = trajectory.state[2 * trajectory.parameters.num_joints :]
        return HorizonPlan(
            time=self._times,
            duty=self._mean_duty(trajectory.duty_trajectory(), self._times),
            heat=np.column_stack([np.interp(knots, trajectory.time, row) for row in heat]),
            bend_angle=trajectory.bend_angle_at(knots).T,
            cost=np.nan,
            success=True,
        )

    def _max_temperatures(self, times: np.ndarray, bend_offset: np.ndarray) -> np.ndarray:
        """Return the temperatures (K, W), °C, beyond which heat costs, at times (K,), s."""
        if self._planned is None or self._planned_temperature is None:
            return np.full((len(times), self._model.num_wires), np.inf)
        to_hold = self._model.temperature_to_hold(bend_offset)
        rows = [np.interp(times, self._planned.time, row) for row in self._planned_temperature]
        return EXCESS_TEMPERATURE + to_hold + np.column_stack(rows)

    def _mean_duty(self, duty: trajectories.Trajectory, times: np.ndarray) -> np.ndarray:
        """Return the duty of a plan in the steps (K, W) between knots at times (K + 1,), s."""
        middles = np.minimum(times[:-1] + 0.5 * self._model.period, duty.end_time())
        return duty.vector_values(middles).T


class HorizonProgram(QuasiStaticProgram):
    """`QuasiStaticProgram` of the coming seconds, in steps of a `ReducedModel`.

    T_max and T_warm may be passed at a cost, and so may the temperatures of a plan of the whole
    motion. Duty is constant between knots; the duty at the last knot has no effect.

    Args:
        model: limb in steps from knot to knot.
        times: times of the knots (K + 1,), s, from 0.
        task: its weights of angles, duty, temperature and the end, and its margins count.
    """

    def __init__(self, model: ReducedModel, times: np.ndarray, task: Task):
        self._model = model
        counted = Task(**{name: getattr(task, name) for name in TASK_FIELDS}, duty_hold=0.0)
        super().__init__(model.limb, times, model.statics, counted, limit_weight=LIMIT_WEIGHT)
        T = self.prog.decision_variables()[self.heat[1:, : model.num_wires]].ravel()
        free = np.full(len(T), np.inf)
        self._max_temperatures = add_soft_bounds(self.prog, T, None, free, EXCESS_WEIGHT)
        self._soft_bounds = [
            (b, self.indices(b.variables())) for b in (self._warm_up, self._max_temperatures)
        ]

    def set_target(
        self, target: np.ndarray, heat: np.ndarray, warm_up_time: float, warmest: np.ndarray
    ) -> None:
        """Set what changes from plan to plan.

        Args:
            target: desired bend of the model at the knots (K + 1, F), rad.
            heat: [x, V] at the first knot (H,).
            warm_up_time: k_warm, s from the first knot.
            warmest: temperatures beyond which heat costs, at the knots but the first (K, W), °C.
        """
        self.update(target.T, heat, warm_up_time)
        self._max_temperatures.evaluator().UpdateUpperBound(warmest.ravel())

    def solve_for_duty(self, heats: np.ndarray, duty: np.ndarray) -> np.ndarray | None:
        """Return the best duty (K, W) of the model linearized along heats (K + 1, H) and duty."""
        point = self._points(heats[:, None], duty[None])[:, 0]
        solution = self.linearized.solve(point, with_multipliers=False)
        if solution is None:
            return None
        return np.clip(solution.x[self.duty[:-1]], 0.0, 1.0 - self.task.duty_margin)

    def costs(self, rollouts: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Return the costs (B,) of B rollouts (K + 1, B, H) under duty (B, K, W)."""
        x = self._points(rollouts, duty)
        for bounds, indices in self._soft_bounds:
            lower = bounds.evaluator().lower_bound()
            upper = bounds.evaluator().upper_bound()
            T = x[indices[: len(lower)]].T
            excess = indices[len(lower) :]
            beyond = np.hstack([T - upper, lower - T])[:, : len(excess)]
            x[excess] = np.maximum(beyond, 0.0).T
        costs = self.prog.GetAllCosts()
        return np.sum([self.prog.EvalBindingVectorized(cost, x)[0] for cost in costs], axis=0)

    def _points(self, rollouts: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Return the decision variables (num_vars, B) of rollouts; arguments as for `costs`."""
        x = np.zeros((self.prog.num_vars(), len(duty)))
        x[self.heat] = np.moveaxis(rollouts[..., : self.heat.shape[1]], 1, -1)
        x[self.duty[:-1]] = np.moveaxis(duty, 0, -1)
        x[self.bends] = np.moveaxis(self._model.bend_angle(rollouts), 1, -1)
        return x

    def _fixed_heat_blocks(self) -> list[ConstraintBlock]:
        """Return the steps of the model, in place of (17)."""
        return [self._heat_block]

    def _make_heat_block(self) -> ConstraintBlock:
        """Return the steps of the model without readings, on which nothing here depends."""
        N = self.heat.shape[1]
        W = self._model.num_wires
        x = ca.SX.sym("x", N)
        D = ca.SX.sym("D", W)
        after = self._model.symbolic_step(ca.vertcat(x, ca.SX.zeros(W)), D)[:N]
        points = np.hstack([self.heat[:-1], self.duty[:-1]])
        return FunctionBlock(SmoothFunction(after, ca.vertcat(x, D)), points, self.heat[1:])
