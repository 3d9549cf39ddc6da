"""Plans of the coming seconds, from the heat that a limb has towards its reference.

The chain swings at some hertz; knots at 5 Hz cannot tell it from one that is
always where its wires hold it. So a horizon is planned with `ReducedModel`, which
has a fifth of the states of (17), by sequential convex programs: the heat is
linearized along the best duty known, a program with linear dynamics is solved, and
the best of some steps towards its solution is taken, by the cost of the curved
model. What has to be feasible once, T_max and T_warm, costs here instead, so
that there is always a plan.
"""

import dataclasses
import time as clock

import numpy as np
from pydrake import trajectories
from pydrake.solvers import ClarabelSolver, MathematicalProgram, SolverOptions

from controllers.reduced_model import ReducedModel
from limb_systems import LimbParameters
from planners import Task

DURATION, KNOT_RATE = 10.0, 5.0  # s, Hz
ROUNDS = 2  # of linearizing and solving, in a plan from one before
FIRST_ROUNDS = 8  # without one
SHARES = np.array([1.0, 0.7, 0.4, 0.2, 0.1, 0.03])  # of the way to a program's solution
LITTLE = 1e-3  # relative; a round that reduces the cost by less is the last
LEVELS = np.array([0.02, 0.05, 0.1, 0.2, 0.4])  # of constant duty, from which a first plan starts
# Cost of the time beyond a limit: of 1 °C at a knot, more than any angle is worth.
LIMIT_WEIGHT = 1.0


def horizon_task() -> Task:
    """What a horizon weighs: less duty than (15), as plans follow at once."""
    return Task(
        duty_weight=0.2,
        terminal_factor=1.0,
        temperature_weight=1e-3,
        temperature_margin=15.0,
        duty_margin=0.0,
    )


@dataclasses.dataclass(frozen=True)
class HorizonPlan:
    """The coming seconds of a limb with S segments and W wires, whose heat has H numbers.

    Duty is constant between the K knots, and each is that after its knot.

    - ``time``: of the knots (K + 1,), s.
    - ``duty``: D (K, W).
    - ``heat``: [x, V] at the knots (K + 1, H), as of `ReducedModel`.
    - ``bend_angle``: φ at the knots (K + 1, S), rad, offset included.
    - ``cost``: with what passing limits costs.
    - ``solve_time``: of all of it, s.
    - ``success``: whether each program was solved.
    """

    time: np.ndarray
    duty: np.ndarray
    heat: np.ndarray
    bend_angle: np.ndarray
    cost: float
    solve_time: float
    success: bool

    def duty_at(self, times: np.ndarray) -> np.ndarray:
        """D (..., W) at times (...), s; the last after the end."""
        index = np.searchsorted(self.time, np.asarray(times) + 1e-9, side="right") - 1
        return self.duty[np.clip(index, 0, len(self.duty) - 1)]


class HorizonPlanner:
    """Plans a horizon towards a reference, again and again, from any heat.

    It keeps nothing from plan to plan, so that one may be made in another thread;
    two at a time need two planners.

    Args:
        parameters: of the limb.
        reference: φ_ref in rad, a row for each segment, over the time of the plan;
            its last angle is held.
        task: its angle, duty, temperature and terminal weights and its margins
            count; `horizon_task()` if None.
        duration, knot_rate: of the horizon, s, and of its knots, Hz.
    """

    def __init__(
        self,
        parameters: LimbParameters,
        reference: trajectories.Trajectory,
        task: Task | None = None,
        *,
        duration: float = DURATION,
        knot_rate: float = KNOT_RATE,
    ):
        self.task = task = task or horizon_task()
        self._reference, self._limits = reference, parameters.temperature_limits
        self._ambient = parameters.ambient_temperature
        K = self._num_steps = max(1, round(duration * knot_rate))
        self._times = np.arange(K + 1) / knot_rate
        model = self._model = ReducedModel(parameters, 1.0 / knot_rate)
        self._hottest = self._limits.maximum - task.temperature_margin
        self._fullest, self._total = 1.0 - task.duty_margin, parameters.total_duty
        # (15) weighs each joint's distance from (11)
        links = np.array([segment.links for segment in parameters.segments])
        joints, _ = task.weights(self._times[1:])
        self._angle_weights = np.outer(joints, 4 * links / (links + 1) ** 2)
        shares = [1 / len(segment.wires) for segment in parameters.segments for _ in segment.wires]
        self._heat_weights = task.temperature_weight * np.array(shares)
        self._num_states = model.size - model.num_wires
        self._build()

    def plan(
        self,
        time: float,
        heat: np.ndarray,
        bend_offset: np.ndarray,
        previous: HorizonPlan | None = None,
    ) -> HorizonPlan:
        """A plan from a time on.

        Args:
            time: since the start of the reference, s.
            heat: [x, V] at that time (H,).
            bend_offset: by which the bend angle is off the model's (S,), rad.
            previous: a plan that begins before, to start from.
        """
        started = clock.perf_counter()
        times = time + self._times
        end = self._reference.end_time()
        target = self._reference.vector_values(np.minimum(times, end)).T[1:] - bend_offset
        warm = np.where(times[1:] > self._limits.warm_up_time, self._limits.warm, -np.inf)
        if previous is None:
            levels = np.broadcast_to(
                LEVELS[:, None, None], (len(LEVELS), self._num_steps, self._model.num_wires)
            )
            courses = self._courses(heat, levels)
            middle = 0.5 * (self._limits.warm + self._hottest)
            chosen = np.abs(self._model.temperatures(courses[-1]) - middle).sum(axis=-1).argmin()
            duty, course = levels[chosen], courses[:, chosen]
        else:
            duty = previous.duty_at(times[:-1])
            course = self._courses(heat, duty[None])[:, 0]
        cost = self._costs(course[:, None], duty[None], target, warm)[0]
        success = True
        for _ in range(ROUNDS if previous else FIRST_ROUNDS):
            best = self._solve(course, duty, target, warm)
            if best is None:
                success = False
                break
            tried = duty + SHARES[:, None, None] * (best - duty)
            courses = self._courses(heat, tried)
            costs = self._costs(courses, tried, target, warm)
            chosen = costs.argmin()
            if not costs[chosen] < cost:
                break
            reduction = 1.0 - costs[chosen] / cost
            duty, course, cost = tried[chosen], courses[:, chosen], costs[chosen]
            if reduction < LITTLE:
                break
        return HorizonPlan(
            time=times,
            duty=duty,
            heat=course,
            bend_angle=self._model.bend_angle(course) + bend_offset,
            cost=float(cost),
            solve_time=clock.perf_counter() - started,
            success=success,
        )

    def _courses(self, heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Heat at the knots (K + 1, B, H) from (H,) on, under duty (B, K, W)."""
        start = np.broadcast_to(heat, (len(duty), self._model.size))
        return self._model.course(start, duty.swapaxes(0, 1))

    def _costs(
        self, courses: np.ndarray, duty: np.ndarray, target: np.ndarray, warm: np.ndarray
    ) -> np.ndarray:
        """The cost (B,) of courses (K + 1, B, H) under duty (B, K, W)."""
        missed = self._model.bend_angle(courses[1:]) - target[:, None]
        T = self._model.temperatures(courses[1:])
        beyond = np.maximum(T - self._hottest, 0.0) + np.maximum(warm[:, None, None] - T, 0.0)
        return (
            0.5 * (self._angle_weights[:, None] * missed**2).sum(axis=(0, 2))
            + 0.5 * self.task.duty_weight * (duty**2).sum(axis=(1, 2))
            + ((T - self._ambient) * self._heat_weights).sum(axis=(0, 2))
            + LIMIT_WEIGHT * beyond.sum(axis=(0, 2))
        )

    def _build(self) -> None:
        """The convex program; `_solve` fills in dynamics, bend angles and what is warm."""
        K, W, S, N = self._num_steps, self._model.num_wires, self._model.num_segments, 0
        N = self._num_states
        self._scales = self._model.scales[:N]
        self._prog = prog = MathematicalProgram()
        self._duty = duty = prog.NewContinuousVariables(K, W, "D")
        states = prog.NewContinuousVariables(K, N, "x")  # over their scales, after each interval
        missed = prog.NewContinuousVariables(K, S, "e")
        beyond = prog.NewContinuousVariables(K, 2 * W, "s")
        every = self._angle_weights.ravel()
        prog.AddQuadraticCost(np.diag(every), 0 * every, missed.ravel(), is_convex=True)
        weights = np.full(duty.size, self.task.duty_weight)
        prog.AddQuadraticCost(np.diag(weights), 0 * weights, duty.ravel(), is_convex=True)
        heat = np.tile(self._heat_weights * self._scales[:W], K)
        prog.AddLinearCost(heat, 0.0, states[:, :W].ravel())
        prog.AddLinearCost(np.full(beyond.size, LIMIT_WEIGHT), 0.0, beyond.ravel())
        prog.AddBoundingBoxConstraint(0.0, self._fullest, duty.ravel())
        prog.AddBoundingBoxConstraint(0.0, np.inf, beyond.ravel())
        self._dynamics, self._angles, self._warm = [], [], []
        self._highest = self._hottest / self._scales[:W]
        none, never = np.full(W, -np.inf), np.full(W, np.inf)
        allowed = np.hstack([np.eye(W), -np.diag(1 / self._scales[:W])])
        needed = np.hstack([np.eye(W), np.diag(1 / self._scales[:W])])
        for k in range(K):
            before = states[k - 1] if k else []
            A = np.zeros((N, len(before) + N + W))
            self._dynamics.append(
                prog.AddLinearEqualityConstraint(A, np.zeros(N), np.r_[before, states[k], duty[k]])
            )
            C = np.zeros((S, N + S))
            self._angles.append(
                prog.AddLinearEqualityConstraint(C, np.zeros(S), np.r_[states[k], missed[k]])
            )
            T, hot, cold = states[k, :W], beyond[k, :W], beyond[k, W:]
            prog.AddLinearConstraint(allowed, none, self._highest, np.r_[T, hot])
            self._warm.append(prog.AddLinearConstraint(needed, none, never, np.r_[T, cold]))
            prog.AddLinearConstraint(np.ones((1, W)), [-np.inf], [self._total], duty[k])

    def _solve(
        self, course: np.ndarray, duty: np.ndarray, target: np.ndarray, warm: np.ndarray
    ) -> np.ndarray | None:
        """The best duty (K, W) where the model is linear about a course (K + 1, H)."""
        model, N, W = self._model, self._num_states, self._model.num_wires
        after, by_heat, by_duty = model.linearized_step(course[:-1], duty)
        scales = self._scales
        A = by_heat[:, :N, :N] * (scales / scales[:, None])
        B = by_duty[:, :N] / scales[:, None]
        x = course[:, :N] / scales
        rest = after[:, :N] / scales - np.einsum("kij,kj->ki", B, duty)
        rest[1:] -= np.einsum("kij,kj->ki", A[1:], x[1:-1])
        bend, slopes = model.bend_slopes(course[1:])
        C = slopes[:, :, :N] * scales
        offsets = bend - np.einsum("kij,kj->ki", C, x[1:]) - target
        one, unmissed = np.eye(N), -np.eye(model.num_segments)
        for k in range(self._num_steps):
            row = [-A[k], one, -B[k]] if k else [one, -B[k]]
            self._dynamics[k].evaluator().UpdateCoefficients(np.hstack(row), rest[k])
            self._angles[k].evaluator().UpdateCoefficients(np.hstack([C[k], unmissed]), -offsets[k])
            self._warm[k].evaluator().UpdateLowerBound(np.full(W, warm[k]) / scales[:W])
        result = ClarabelSolver().Solve(self._prog, None, SolverOptions())
        if not result.is_success():
            return None
        return np.clip(result.GetSolution(self._duty), 0.0, self._fullest)
