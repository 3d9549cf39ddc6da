"""The quasi-static program: plans of heat and duty for a limb that is where its wires hold it.

The mechanics is fast (5 Hz) and the heat is slow (0.1 Hz), so the joint angles nearly are where the
wires' torques hold them: K θ + ∇V(θ) = f(x, θ). The variables are then heat, duty and the bends φ
alone, however many joints there are. The collocation (17) of the heat is the same as in the
trajectory program. φ = φ(θ(x)) has exact first and second derivatives by adjoints. (15) weighs a
bend as it weighs the joints of this bend at equal angles (11).

The trajectory program of a planar limb starts from it. Where torque or rates are not affine,
a few of the knots are enough for that.
"""

import copy
import dataclasses

import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike
from pydrake.solvers import (
    ClarabelSolver,
    LinearEqualityConstraint,
    MathematicalProgram,
    SolverOptions,
)
from pydrake.trajectories import PiecewisePolynomial

from limb_systems import LimbError, LimbModel, LimbParameters, LinearLaw
from limb_systems.static_equilibria import StaticEquilibria
from limb_systems.wires import Wires
from planners.task import Task
from planners.transcription.collocation import ANGLE_SCALE, heat_block
from planners.transcription.function_block import FunctionBlock
from planners.transcription.ipopt import ConstraintBlock
from planners.transcription.program import (
    PlanProgram,
    add_at_knots,
    reading_bounds,
)
from planners.transcription.solving import InfeasibleError, Solution, solve_program

SPACING = 0.5  # s, between the knots of a start
CHECK_STEP = 0.5  # s, of an integration that says whether limits can be met
LEAST_BETA = 1e-6  # N·m/°C, of wires that are taken to be linear


def check_temperature_limits(
    model: LimbModel,
    times: np.ndarray,
    initial_heat: np.ndarray,
    warm_up_time: float,
    task: Task,
    measured_margin: ArrayLike = 0.0,
) -> None:
    """Checks whether (19)-(20) can be met at all, wire by wire.

    More duty means more heat at all later times, so the temperatures at full
    and at zero duty enclose all others.

    Args:
        times: times of the knots (K,), s.
        initial_heat: x and V at the start (N + W,).
        warm_up_time: k_warm, s from the first knot.
        task: task whose margins count.
        measured_margin: margin of the readings, as for `PlanProgram`.

    Raises:
        InfeasibleError: names the wire, the constraint and the time from which
            it could be met.
    """
    wires = model.wires
    limits = model.parameters.temperature_limits
    initial_states, initial_readings = np.split(initial_heat, [wires.num_states])
    warm_knots = times > warm_up_time
    full, highest = 1.0 - task.duty_margin, limits.maximum - task.temperature_margin
    margins = f" less a margin of {task.temperature_margin:g} °C" if task.temperature_margin else ""
    if highest < limits.warm:
        raise InfeasibleError(
            f"T_max = {limits.maximum:g} °C{margins} is below T_warm = {limits.warm:g} °C; give "
            "the task a smaller temperature_margin."
        )

    def states_at(level: float, until: np.ndarray) -> np.ndarray:
        """x (K, N) at times (K,) with all wires at this duty."""
        duty = np.full((len(until) + 1, wires.num_wires), level)
        until = np.append(0.0, until)
        return wires.integrate_states(initial_states, duty, until, CHECK_STEP)[1:]

    first = times[np.argmax(warm_knots)]
    hottest = states_at(full, np.array([first]))[0]
    off = states_at(0.0, times[:2])
    cooled, cooled_readings = off[1], readings_along(wires, off, initial_readings, times[:2])[1]
    bounds = reading_bounds(model, measured_margin)
    ahead = np.linspace(0.0, _settling_time(wires), 1000)
    for index, name in enumerate(model.parameters.wire_names):
        start = initial_states[index]
        if cooled_readings[index] > bounds[index]:
            raise InfeasibleError(
                f"The {name} wire reads {cooled_readings[index]:.4g} °C at {times[1]:g} s without "
                f"duty, above the {bounds[index]:.4g} °C that measured_maximum and its margin "
                "allow; let it cool first."
            )
        if cooled[index] > highest:
            below = _first_time(ahead, states_at(0.0, ahead)[:, index], highest)
            raise InfeasibleError(
                f"The {name} wire starts at {start:.4g} °C, above T_max = {limits.maximum:g} °C"
                f"{margins} (19); let it cool for {below:.3g} s first."
            )
        if hottest[index] >= limits.warm or not warm_knots.any():
            continue
        course = states_at(full, ahead)[:, index]
        reached = _first_time(ahead, course, limits.warm)
        advice = (
            f"it could from {reached:.3g} s on, so set temperature_limits.warm_up_time to that"
            if np.isfinite(reached)
            else f"it never gets above {course[-1]:.4g} °C"
        )
        heating = "full duty" if full == 1.0 else f"a duty of {full:g}"
        raise InfeasibleError(
            f"The {name} wire cannot be at T_warm = {limits.warm:g} °C (20) by {first:g} s: at "
            f"{heating} from {start:.4g} °C it reaches {hottest[index]:.4g} °C by then; {advice}."
        )


def held_motion(held: StaticEquilibria, states: np.ndarray, duty: np.ndarray) -> np.ndarray:
    """[θ, θ̇] (K, 2n) that wires hold, of states x (K, N) under duty (K, W)."""
    angles, slopes = held.expanded(states)
    rates = (slopes @ held.wires.rates(states, duty)[:, :, None])[:, :, 0]
    return np.hstack([angles, rates])


def solve_quasi_static(
    model: LimbModel,
    times: np.ndarray,
    reference: np.ndarray,
    initial_heat: np.ndarray,
    task: Task,
    warm_up_time: float,
    measured_margin: ArrayLike = 0.0,
    start: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple["QuasiStaticProgram", Solution]:
    """Solve the quasi-static program of a plan. It does not heed the task's limits of the motion.

    Args:
        times, initial_heat, warm_up_time, measured_margin: as for `check_temperature_limits`.
        reference: φ_ref at the knots (F, K), rad.
        start: heat [x, V] (N + W, K) and duty (W, K) of a plan from which the solver starts; those
            of wires that are about linear if None.

    Raises:
        InfeasibleError: if it has no solution.
    """
    task = dataclasses.replace(
        task,
        max_bend_rate=None,
        reach=False,
        final_hold=0.0,
        stretch=None,
        time_weight=0.0,
        customize=None,
    )

    def solved(
        knots: np.ndarray, start: tuple[np.ndarray, np.ndarray] | None, is_near: bool = False
    ) -> tuple[QuasiStaticProgram, Solution]:
        """Solve the program at some knots, from heat and duty at these knots."""
        program = QuasiStaticProgram(model, times[knots], model.statics, task, measured_margin)
        program.update(reference[:, knots], initial_heat, warm_up_time)
        guess = program.variables(*start) if start else program.guess()
        return program, solve_program(program, guess, starts_near=is_near)

    # A program that is not convex starts from its solution at fewer knots.
    every, wires = np.arange(len(times)), model.wires
    num_intervals = max(1, round((times[-1] - times[0]) / SPACING))
    is_convex = wires.rates_are_affine and wires.torque_is_affine
    if start is not None or is_convex or 2 * num_intervals > len(times):
        return solved(every, start)
    grid = np.linspace(times[0], times[-1], num_intervals + 1)
    some = np.unique(np.searchsorted(times, grid - 1e-9).clip(0, len(times) - 1))
    program, solution = solved(some, None)
    heat, duty = solution.x[program.heat], solution.x[program.duty]
    rates = wires.heat_rates(heat, duty)
    course = PiecewisePolynomial.CubicHermite(times[some], heat.T, rates.T)
    duty = np.array([np.interp(times, times[some], of_wire) for of_wire in duty.T])
    return solved(every, (course.vector_values(times), duty), is_near=True)


class QuasiStaticProgram(PlanProgram):
    """A `PlanProgram` of a limb that is always where its wires hold it.

    (17) of the heat and φ = φ(x) are not in ``prog``, but in ``blocks``.

    - ``held``: angles that the wires hold.
    - ``bends``: indices of φ (K, F) among the decision variables.

    Args:
        parameters, times, task, measured_margin: as for `PlanProgram`.
        held: angles that the wires hold.
        limit_weight: as for `PlanProgram`. V is left out if limits may be passed.
    """

    has_inertia = False

    def __init__(
        self,
        parameters: LimbParameters | LimbModel,
        times: np.ndarray,
        held: StaticEquilibria,
        task: Task,
        measured_margin: ArrayLike = 0.0,
        limit_weight: float | None = None,
    ):
        self.held, self._is_soft = held, limit_weight is not None
        super().__init__(parameters, times, task, measured_margin, limit_weight)
        self._tangent: tuple[MathematicalProgram, LinearEqualityConstraint] | None = None

    def _add_variables(self) -> None:
        K, wires = len(self.times), self.wires
        self._shares = (self.model.mechanics.shape**2).sum(axis=0)  # of (15) in the joints' angles
        self._to_bends = np.eye(len(self._shares))
        num_heat = wires.num_states if self._is_soft else len(wires.heat_scales)
        self.prog = prog = MathematicalProgram()
        self._heat = prog.NewContinuousVariables(K, num_heat, "y")
        self._duty = prog.NewContinuousVariables(K, wires.num_wires, "D")
        self._tracked = prog.NewContinuousVariables(K, len(self._shares), "b")
        self._time_steps = prog.NewContinuousVariables(K - 1, "h")
        prog.AddBoundingBoxConstraint(*self._shortest_and_longest_step(), self._time_steps)
        self.bends, self._start = self.indices(self._tracked), self._heat[0]
        self._of_knots = np.hstack([self._heat, self._tracked])
        angles = np.full(len(self._shares), ANGLE_SCALE)
        self._scales = np.append(wires.heat_scales[:num_heat], angles)

    def _make_blocks(self) -> list[ConstraintBlock]:
        states = self.heat[:, : self.wires.num_states]
        blocks = [self._heat_block(), FunctionBlock(self.held, states, self.bends)]
        self.cheap_blocks = blocks  # whose Hessian is whole
        return blocks

    def _heat_block(self) -> ConstraintBlock:
        return heat_block(self.model, self.heat, self.duty, self.time_steps)

    def _targets(self, reference: np.ndarray) -> np.ndarray:
        return reference.T

    def update(self, reference: np.ndarray, initial_state: np.ndarray, warm_up_time: float) -> None:
        super().update(reference, initial_state, warm_up_time)
        split = np.split(initial_state, [-len(self.wires.heat_scales)])
        self._initial_motion, self._initial_heat = split
        self._asked = reference, warm_up_time

    def _add_rate_limits(self, limits: np.ndarray) -> None:
        """Limit the mean bend rates of the intervals that begin at knots."""
        limits = np.append(limits[:-2], limits[-2:].min())
        for k in np.flatnonzero(np.isfinite(limits)):
            rows = np.array([[-1.0, 1.0, -limits[k]], [1.0, -1.0, -limits[k]]])
            steps = np.repeat(self._time_steps[k], len(self._to_bends))
            variables = np.column_stack([*self._tracked[k : k + 2], steps])
            add_at_knots(self.prog, rows, -np.inf, 0.0, variables)

    def guess(self) -> np.ndarray:
        """All decision variables under the best duty for wires that are about linear.

        If the wires are linear, or it is not known how, it is the duty that holds them between
        T_warm and T_max.
        """
        wires, N, start = self.wires, self.wires.num_states, self._initial_heat
        duty = self._duty_of_linear_wires()
        if duty is None:
            limits = self.parameters.temperature_limits
            middle = np.full(wires.num_wires, 0.5 * (limits.warm + limits.maximum))
            held = wires.holding_duty(wires.settled_states(middle))
            duty = np.tile(held, (len(self.times), 1))
        states = wires.integrate_states(start[:N], duty, self.times)
        readings = readings_along(wires, states, start[N:], self.times)
        return self.variables(np.hstack([states, readings]).T, duty.T)

    def variables(self, heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """All decision variables, from heat [x, V] (N + W, K) and duty (W, K)."""
        x = np.zeros(self.prog.num_vars())
        x[self.time_steps] = np.diff(self.times)
        x[self.heat], x[self.duty] = heat[: self.heat.shape[1]].T, duty.T
        x[self.bends] = self.held.values(heat[: self.wires.num_states].T)
        return x

    def tangent_solution(self, x: np.ndarray) -> np.ndarray | None:
        """The solution where ``blocks`` are linear about x, by Clarabel; None if there is none."""
        jacobian = scipy.sparse.vstack(
            [
                scipy.sparse.csc_matrix(
                    (block.jacobian(x), (block.rows, block.columns)), (len(block.lower), len(x))
                )
                for block in self.blocks
            ],
            "csc",
        )
        jacobian.eliminate_zeros()
        ends = jacobian @ x - np.concatenate([block.evaluate(x) for block in self.blocks])
        if self._tangent is None:
            prog = self.prog.Clone()  # it shares the costs and constraints with this one
            prog.ClearVariableScaling()  # Clarabel has its own
            rows = LinearEqualityConstraint(jacobian, ends)
            prog.AddConstraint(rows, prog.decision_variables())
            self._tangent = prog, rows
        prog, rows = self._tangent
        rows.UpdateCoefficients(jacobian, ends)
        result = ClarabelSolver().Solve(prog, None, SolverOptions())
        return result.get_x_val() if result.is_success() else None

    def _duty_of_linear_wires(self) -> np.ndarray | None:
        """The best duty (K, W) for `linear_limb`, of one optimum; None if there is none."""
        if self.wires.rates_are_affine and self.wires.torque_is_affine:
            return None
        reference, warm_up_time = self._asked
        task = dataclasses.replace(self.task, customize=None)
        try:
            linear = LimbModel.of(linear_limb(self.parameters))
            W = self.wires.num_wires
            program = QuasiStaticProgram(linear, self.times, linear.statics, task)
            heat = np.concatenate([self._initial_heat[:W], self._initial_heat[-W:]])
            program.update(reference, heat, warm_up_time)
            x = solve_program(program, program.guess()).x
        except LimbError:
            return None
        return np.clip(x[program.duty], 0.0, 1.0 - self.task.duty_margin)

    def signals(self, x: np.ndarray) -> dict[str, np.ndarray | None]:
        """The signals of a `Trajectory`, from all decision variables."""
        states, readings = np.split(x[self.heat].T, [self.wires.num_states])
        motion = held_motion(self.held, states.T, x[self.duty]).T
        angles, rates = np.split(motion, 2)
        mechanics = self.model.mechanics
        lag = mechanics.damping / mechanics.stiffness
        angles -= lag[:, None] * rates
        motion[:, 0] = self._initial_motion
        return {
            "duty": x[self.duty].T,
            "joint_state": motion,
            **self.wires.signals(states),
            "measured_temperature": readings,
        }


def linear_limb(parameters: LimbParameters) -> LimbParameters:
    """The limb with wires of the paper's law that are about its own, and with springs alone.

    The torque is the chord, from T_warm to T_max, of the torque of wires heated from cold.

    Raises:
        LimbError: if a law does not say how fast its wire heats and cools.
    """
    linear, limits = copy.deepcopy(parameters), parameters.temperature_limits
    T0 = parameters.ambient_temperature
    for segment in linear.segments:
        segment.stiffening, segment.rest_memory = 0.0, None
        for wire in segment.wires:
            law, rates = wire.law, wire.law.typical_rates()
            warm, hot = (
                law.torque(law.warm_states(T, T0), T0, 0.0) for T in (limits.warm, limits.maximum)
            )
            wire.law = LinearLaw(
                a1=-float(np.sqrt(rates["slowest_cooling"] * rates["fastest_cooling"])),
                a2=rates["heating"],
                a3=-rates["reading"],
                beta=max(float(hot - warm) / (limits.maximum - limits.warm), LEAST_BETA),
            )
    return linear


def readings_along(
    wires: Wires, states: np.ndarray, initial_readings: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """V (K, W) along states (K, N) at times (K,), s, by (7).

    It is the exact solution of V̇ = λ V + c(t) for c linear between the times.
    """
    none = np.zeros((len(states), wires.num_wires))
    c = wires.reading_rates(none, states)
    lag = wires.reading_rates(none + 1.0, states) - c
    measured = np.empty_like(none)
    measured[0] = initial_readings
    for k, step in enumerate(np.diff(times)):
        rate = 0.5 * (lag[k] + lag[k + 1])
        settled = -c[k : k + 2] / rate
        behind = (settled[1] - settled[0]) / step / rate
        offset = measured[k] - settled[0] - behind
        measured[k + 1] = settled[1] + behind + np.exp(rate * step) * offset
    return measured


def _settling_time(wires: Wires) -> float:
    """Time after which wires at constant duty have settled, s."""
    settling = wires.affine_rates()[0][np.ix_(wires.settles, wires.settles)]
    rates = np.abs(np.linalg.eigvals(settling))
    return 12.0 / rates[rates > 1e-7 * rates.max()].min()  # a memory may not be named as such


def _first_time(times: np.ndarray, course: np.ndarray, target: float) -> float:
    """When a course (K,) gets to a target for the first time, linear between times, or inf."""
    crossings = np.flatnonzero(np.diff(course > target))
    if not len(crossings):
        return np.inf
    first = crossings[0]
    share = (target - course[first]) / (course[first + 1] - course[first])
    return float(times[first] + share * (times[first + 1] - times[first]))
