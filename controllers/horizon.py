"""Plans of the coming seconds, from the heat that a limb has towards its reference.

The chain swings at some hertz; knots at 5 Hz cannot tell it from one that is
always where its wires hold it. So a horizon is planned with `ReducedModel`, which
has a fifth of the states of (17), by sequential convex programs: the heat is
linearized along the best duty known, a program with linear dynamics is solved, and
the best of some steps towards its solution is taken, by the cost of the curved
model. What has to be feasible once, T_max and T_warm, costs here instead, so
that there is always a plan. So does heat beyond that of a plan of the whole motion,
which knows what comes after the horizon: a wire that was too hot holds the limb for
longer than that.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike
from pydrake import trajectories
from pydrake.solvers import ClarabelSolver, MathematicalProgram, SolverOptions

from controllers.plan_controller import bend_by_temperature, temperature_to_hold
from controllers.reduced_model import ReducedModel
from limb_systems import LimbParameters, Trajectory
from planners import Task, references
from planners.nearest import nearest_plan
from planners.transcription.descent import descend
from planners.transcription.program import temperature_weights

DURATION, KNOT_RATE = 10.0, 5.0  # s, Hz
ROUNDS = 1  # of linearizing and solving, from a plan before; two are not better, and slower
FIRST_ROUNDS = 8  # from wires that are off
SHARES = np.array([1.0, 0.7, 0.4, 0.2, 0.1, 0.03])  # of the way to a program's solution
LITTLE = 1e-3  # relative; a round that reduces the cost by less is the last
# °C, that a wire may be warmer than in the plan of the whole motion; 1/°C, of each knot beyond.
WARMER, WARMER_WEIGHT = 3.0, 0.03
LIMIT_WEIGHT = 1.0  # 1/°C, of each knot beyond T_max or T_warm; as much as 11° of bend


def horizon_task() -> Task:
    """What a horizon weighs: less duty than (15), as the next plan follows soon."""
    return Task(
        duty_weight=0.05,
        terminal_factor=1.0,
        temperature_weight=2e-3,
        temperature_margin=10.0,
    )


@dataclasses.dataclass(frozen=True)
class HorizonPlan:
    """The coming seconds of a limb with S segments and W wires, whose heat has H numbers.

    Duty is constant between the K knots, and each is that after its knot.

    - ``time``: times of the knots (K + 1,), s.
    - ``duty``: D (K, W).
    - ``heat``: [x, V] at the knots (K + 1, H), as of `ReducedModel`.
    - ``bend_angle``: φ at the knots (K + 1, S), rad, offset included.
    - ``cost``: value of the cost, excess of limits included.
    - ``success``: whether a program was solved; else the duty is that of the plan before.
    """

    time: np.ndarray
    duty: np.ndarray
    heat: np.ndarray
    bend_angle: np.ndarray
    cost: float
    success: bool

    def duty_at(self, times: ArrayLike) -> np.ndarray:
        """D (..., W) at times (...), s; the last after the end."""
        index = np.searchsorted(self.time, np.asarray(times) + 1e-9, side="right") - 1
        return self.duty[np.clip(index, 0, len(self.duty) - 1)]

    def bend_angle_at(self, time: float) -> np.ndarray:
        """φ (S,) at a time, s, in rad; the last after the end."""
        return np.array([np.interp(time, self.time, bend) for bend in self.bend_angle.T])


class HorizonPlanner:
    """Plans a horizon towards a reference, again and again, from any heat.

    The cost is (15), with limits that cost, too. It keeps nothing from plan to plan, so that
    one may be made in another thread; two at a time need two planners.

    Args:
        parameters: description of the limb.
        reference: φ_ref in rad, a row for each segment, over the time of the plan;
            its last angle is held.
        task: its weights of angles, duty, temperature and the end, and its margins
            count; `horizon_task()` if None. T_max and T_warm may be passed, at a cost.
        duration, knot_rate: length of the horizon, s, and rate of its knots, Hz.
        planned: times (L,), s, and temperatures of the wires (W, L), °C, of a plan of the whole
            motion, if there is one.
    """

    def __init__(
        self,
        parameters: LimbParameters,
        reference: trajectories.Trajectory,
        task: Task | None = None,
        *,
        duration: float = DURATION,
        knot_rate: float = KNOT_RATE,
        planned: tuple[np.ndarray, np.ndarray] | None = None,
    ):
        task, limits = task or horizon_task(), parameters.temperature_limits
        self._reference, self._limits, self._planned = reference, limits, planned
        self._times = times = np.arange(max(1, round(duration * knot_rate)) + 1) / knot_rate
        self._model = model = ReducedModel(parameters, 1.0 / knot_rate)
        self._bend_by_temperature = bend_by_temperature(model)
        self._num_states = model.size - model.num_wires
        self._scales = model.scales[: self._num_states]
        self._ambient, self._total = parameters.ambient_temperature, parameters.total_duty
        self._hottest = limits.maximum - task.temperature_margin
        self._fullest, self._duty_weight = 1.0 - task.duty_margin, task.duty_weight
        # (15) weighs the joints' distances from (11).
        links = np.array([segment.links for segment in parameters.segments])
        self._angle_weights = np.outer(task.weights(times[1:])[0], 4 * links / (links + 1) ** 2)
        self._heat_weights = temperature_weights(parameters, times[1:], task)
        self._build(len(times) - 1)

    @classmethod
    def of(cls, trajectory: Trajectory, task: Task | None = None) -> "HorizonPlanner":
        """A planner towards the reference of a `Planner`'s plan that starts at time 0.

        Its wires are to be hardly warmer than those of the plan that is nearest to the reference.
        """
        reference = references.from_samples(trajectory.time, trajectory.reference)
        nearest = nearest_plan(trajectory)
        planned = nearest and (trajectory.time, nearest[1])
        return cls(trajectory.parameters, reference, task, planned=planned)

    def plan(
        self,
        time: float,
        heat: np.ndarray,
        bend_offset: np.ndarray,
        previous: HorizonPlan | None = None,
    ) -> HorizonPlan:
        """A plan from a time on.

        Args:
            time: time since the start of the reference, s.
            heat: [x, V] at that time (H,).
            bend_offset: bend angle of the limb less that of the model (S,), rad.
            previous: a plan that begins before, to start from; wires that are off if None.
        """
        times = time + self._times
        reference = self._reference.vector_values(np.minimum(times, self._reference.end_time()))
        warm = np.where(times > self._limits.warm_up_time, self._limits.warm, -np.inf)
        warmest = self._warmest(times[1:], bend_offset)
        aims = reference.T[1:] - bend_offset, warm[1:], warmest
        if previous is None:
            duty = np.zeros((len(times) - 1, self._model.num_wires))
        else:
            duty = previous.duty_at(times[:-1])
        heats = self._model.rollout(heat, duty)

        def solve(point):
            duty, heats = point
            best = self._solve(heats, duty, *aims)
            return None if best is None else (best, heats)

        def step(point, best, _):
            """The best of all shares of the way."""
            tried = point[0] + SHARES[:, None, None] * (best[0] - point[0])
            start = np.broadcast_to(heat, (len(tried), len(heat)))
            rollouts = self._model.rollout(start, tried.swapaxes(0, 1))
            costs = self._costs(rollouts, tried, *aims)
            chosen = costs.argmin()
            return (tried[chosen], rollouts[:, chosen]), costs[chosen]

        cost = self._costs(heats[:, None], duty[None], *aims)[0]
        rounds = FIRST_ROUNDS if previous is None else ROUNDS
        (duty, heats), cost, success = descend((duty, heats), cost, solve, step, rounds, LITTLE)
        return HorizonPlan(
            time=times,
            duty=duty,
            heat=heats,
            bend_angle=self._model.bend_angle(heats) + bend_offset,
            cost=float(cost),
            success=success,
        )

    def beginning_of(self, trajectory: Trajectory) -> HorizonPlan:
        """The first horizon of a `Planner`'s plan that starts at time 0."""
        middles = np.minimum(self._times[:-1] + 0.5 * self._model.period, trajectory.duration)
        knots = np.minimum(self._times, trajectory.duration)
        heat = trajectory.state[2 * trajectory.parameters.num_joints :]
        return HorizonPlan(
            time=self._times,
            duty=trajectory.duty_trajectory().vector_values(middles).T,
            heat=np.column_stack([np.interp(knots, trajectory.time, row) for row in heat]),
            bend_angle=trajectory.bend_angle_at(knots).T,
            cost=np.nan,
            success=True,
        )

    def _warmest(self, times: np.ndarray, bend_offset: np.ndarray) -> np.ndarray:
        """How warm wires may be without a cost (K, W), °C, at times since the reference began."""
        if self._planned is None:
            return np.full((len(times), self._model.num_wires), np.inf)
        at, T = self._planned
        held = temperature_to_hold(self._bend_by_temperature, bend_offset)
        return WARMER + held + np.column_stack([np.interp(times, at, row) for row in T])

    def _costs(
        self,
        rollouts: np.ndarray,
        duty: np.ndarray,
        target: np.ndarray,
        warm: np.ndarray,
        warmest: np.ndarray,
    ) -> np.ndarray:
        """The cost (B,) of heats (K + 1, B, H) under duty (B, K, W).

        Args:
            target: bend of the model that is wanted at the knots but the first (K, S), rad.
            warm: T_warm at these knots, or -inf (K,), °C.
            warmest: temperatures of the plan, with what wires may be warmer (K, W), °C.
        """
        missed = self._model.bend_angle(rollouts[1:]) - target[:, None]
        T = self._model.temperatures(rollouts[1:])
        beyond = np.maximum(T - self._hottest, 0.0) + np.maximum(warm[:, None, None] - T, 0.0)
        return (
            0.5 * (self._angle_weights[:, None] * missed**2).sum(axis=(0, 2))
            + 0.5 * self._duty_weight * (duty**2).sum(axis=(1, 2))
            + (self._heat_weights[:, None] * (T - self._ambient)).sum(axis=(0, 2))
            + LIMIT_WEIGHT * beyond.sum(axis=(0, 2))
            + WARMER_WEIGHT * np.maximum(T - warmest[:, None], 0.0).sum(axis=(0, 2))
        )

    def _solve(
        self,
        heats: np.ndarray,
        duty: np.ndarray,
        target: np.ndarray,
        warm: np.ndarray,
        warmest: np.ndarray,
    ) -> np.ndarray | None:
        """The best duty (K, W) where the model is linear about heats (K + 1, H); None if none."""
        self._set_dynamics(heats, duty)
        self._set_bend(heats[1:], target)
        scales = self._scales[: self._model.num_wires]
        for cool, hot, least, most in zip(self._cool, self._warmer, warm, warmest, strict=True):
            cool.evaluator().UpdateLowerBound(least / scales)
            hot.evaluator().UpdateUpperBound(most / scales)
        result = ClarabelSolver().Solve(self._prog, None, SolverOptions())
        if not result.is_success():
            return None
        return np.clip(result.GetSolution(self._duty), 0.0, self._fullest)

    def _build(self, K: int) -> None:
        """The program; `_solve` fills in what depends on heats and aims.

        Its variables after each interval are the wires' states over their scales, what
        each bend misses, rad, and how far each T is above T_max and the plan's, and below
        T_warm, °C.
        """
        W, S, N = self._model.num_wires, self._model.num_bends, self._num_states
        prog = self._prog = MathematicalProgram()
        duty = self._duty = prog.NewContinuousVariables(K, W, "D")
        states = prog.NewContinuousVariables(K, N, "x")
        missed = prog.NewContinuousVariables(K, S, "e")
        hot = prog.NewContinuousVariables(K, W, "h")
        cool = prog.NewContinuousVariables(K, W, "c")
        for weights, variables in (
            (self._angle_weights.ravel(), missed.ravel()),
            (np.full(duty.size, self._duty_weight), duty.ravel()),
        ):
            prog.AddQuadraticCost(np.diag(weights), 0.0 * weights, variables, is_convex=True)
        T, scales = states[:, :W], self._scales[:W]
        prog.AddLinearCost((self._heat_weights * scales).ravel(), 0.0, T.ravel())
        warmer = prog.NewContinuousVariables(K, W, "m")
        for excess, weight in (
            (hot, LIMIT_WEIGHT),
            (cool, LIMIT_WEIGHT),
            (warmer, WARMER_WEIGHT),
        ):
            prog.AddLinearCost(np.full(excess.size, weight), 0.0, excess.ravel())
            prog.AddBoundingBoxConstraint(0.0, np.inf, excess.ravel())
        prog.AddBoundingBoxConstraint(0.0, self._fullest, duty.ravel())
        self._dynamics, self._bends, self._cool, self._warmer = [], [], [], []
        below, above = np.full(W, -np.inf), np.full(W, np.inf)
        same, per_degree = np.eye(W), np.diag(1.0 / scales)
        for k in range(K):
            before = states[k - 1] if k else states[0, :0]
            of_step = np.r_[before, states[k], duty[k]]
            self._dynamics.append(
                prog.AddLinearEqualityConstraint(np.zeros((N, len(of_step))), np.zeros(N), of_step)
            )
            self._bends.append(
                prog.AddLinearEqualityConstraint(
                    np.zeros((S, N + S)), np.zeros(S), np.r_[states[k], missed[k]]
                )
            )
            prog.AddLinearConstraint(
                np.hstack([same, -per_degree]), below, self._hottest / scales, np.r_[T[k], hot[k]]
            )
            self._warmer.append(
                prog.AddLinearConstraint(
                    np.hstack([same, -per_degree]), below, above, np.r_[T[k], warmer[k]]
                )
            )
            self._cool.append(
                prog.AddLinearConstraint(
                    np.hstack([same, per_degree]), below, above, np.r_[T[k], cool[k]]
                )
            )
            prog.AddLinearConstraint(np.ones((1, W)), [-np.inf], [self._total], duty[k])

    def _set_dynamics(self, heats: np.ndarray, duty: np.ndarray) -> None:
        """x' = A x + B D + c in each interval, about heats (K + 1, H) and duty (K, W)."""
        N, scales = self._num_states, self._scales
        after, by_heat, by_duty = self._model.linearized_step(heats[:-1], duty)
        A = by_heat[:, :N, :N] * (scales / scales[:, None])
        B = by_duty[:, :N] / scales[:, None]
        x, one = heats[:-1, :N] / scales, np.eye(N)
        c = after[:, :N] / scales - np.einsum("kij,kj->ki", B, duty)
        c[1:] -= np.einsum("kij,kj->ki", A[1:], x[1:])  # the first x is known
        for k, binding in enumerate(self._dynamics):
            row = [-A[k], one, -B[k]] if k else [one, -B[k]]
            binding.evaluator().UpdateCoefficients(np.hstack(row), c[k])

    def _set_bend(self, heats: np.ndarray, target: np.ndarray) -> None:
        """e = φ(x) - target (K, S) at each knot, about heats (K, H)."""
        bend, slopes = self._model.bend_slopes(heats)
        C = slopes[:, :, : self._num_states] * self._scales
        x = heats[:, : self._num_states] / self._scales
        rest = target - bend + np.einsum("kij,kj->ki", C, x)
        minus = -np.eye(self._model.num_bends)
        for binding, row, value in zip(self._bends, C, rest, strict=True):
            binding.evaluator().UpdateCoefficients(np.hstack([row, minus]), value)
