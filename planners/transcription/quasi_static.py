"""The quasi-static plan, from which the trajectory program starts.

The mechanics is fast (5 Hz) and the heat is slow (0.1 Hz), so the joint angles
nearly are where the wires' torques hold them: K θ = f(x). With this, the program has
heat and duty alone. Where torque and rates are affine it is convex: the cost (15)
is quadratic in the wires' states and duty, whose dynamics (6) and bounds (18)-(20)
are linear. Else it is solved with a few of the knots, by the collocation and the solver
of the whole program, and read between them.

That begins with a convex program, too: torque is replaced by its chord from T_warm
to T_max, which has a slope if the wire can move the limb at all, and then
by tangents, with steps that reduce the cost. If rates are not affine, as with
hysteresis, torque is that of wires heated from cold to T, and all states are
integrated under the duty that was found.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import (
    ClarabelSolver,
    IpoptSolver,
    LinearEqualityConstraint,
    MathematicalProgram,
    SolverOptions,
)
from pydrake.trajectories import PiecewisePolynomial

from limb_systems import LimbParameters, Wires, joint_angles_from_bend_angle
from limb_systems.model.statics import HeldAngles
from planners.task import Task
from planners.transcription.collocation import LimbDefects, linear_defect
from planners.transcription.descent import descend, first_that_reduces
from planners.transcription.ipopt import ExactHessianIpoptSolver
from planners.transcription.program import add_wires, reading_bounds, temperature_weights
from planners.transcription.solving import PlanningError

# Angles (K, n) at states (K, N) of the wires, and their derivatives (K, n, N).
AngleMap = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]

MAX_TANGENTS = 3
LITTLE = 0.02  # relative; a tangent that reduces the cost by less is the last
CHORD_POINTS = 9
TABLE_SIZE = 200  # of torque over temperature
CHECK_STEP = 0.5  # s, of an integration that says whether limits can be met
# s, between the knots of the program that is not convex: plans with half of it are as good a start.
SPACING = 0.3
CURVED_OPTIONS = {"mu_strategy": "monotone", "mu_init": 0.01, "tol": 1e-3, "max_iter": 100}


class InfeasibleError(PlanningError):
    """No duty within [0, 1] meets the temperature constraints (19)-(20)."""


def check_temperature_limits(
    parameters: LimbParameters,
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
        measured_margin: margin of the readings, as of `TrajectoryProgram`.

    Raises:
        InfeasibleError: names the wire, the constraint and the time from which
            it could be met.
    """
    limits, wires = parameters.temperature_limits, Wires(parameters)
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
        return wires.under_duty(initial_states, duty, until, CHECK_STEP)[1:]

    first = times[np.argmax(warm_knots)]
    hottest = states_at(full, np.array([first]))[0]
    off = states_at(0.0, times[:2])
    cooled, cooled_readings = off[1], readings_along(wires, off, initial_readings, times[:2])[1]
    bounds = reading_bounds(parameters, measured_margin)
    ahead = np.linspace(0.0, _settling_time(wires), 1000)
    for index, name in enumerate(parameters.wire_names):
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


def solve_quasi_static(
    parameters: LimbParameters,
    times: np.ndarray,
    reference: np.ndarray,
    initial_heat: np.ndarray,
    held: HeldAngles,
    task: Task,
    warm_up_time: float,
    measured_margin: ArrayLike = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Heat and duty of the wires in the best quasi-static plan.

    Args:
        times, initial_heat, warm_up_time, measured_margin: as for `check_temperature_limits`.
        reference: φ_ref at the knots (S, K), rad.
        held: angles that the wires hold.

    Returns:
        [x, V] (N + W, K), of which the first W are T in °C, and D (W, K).

    Raises:
        InfeasibleError: if it has no solution.
    """
    wires = held.wires
    target = joint_angles_from_bend_angle(parameters, reference).T
    if wires.rates_are_affine and wires.torque_is_affine:
        program = _ConvexProgram(
            parameters, times, target, initial_heat, held, task, warm_up_time, measured_margin
        )
        limits = parameters.temperature_limits
        middle = 0.5 * (limits.warm + limits.maximum)
        at = np.tile(wires.settled_states(np.full(wires.num_wires, middle)), (len(times), 1))
        states, duty = program.solve(*held.expanded(at), at)
        readings = readings_along(wires, states, initial_heat[wires.num_states :], times)
        return np.hstack([states, readings]).T, duty.T
    num_intervals = max(1, round((times[-1] - times[0]) / SPACING))
    grid = np.linspace(times[0], times[-1], num_intervals + 1)
    few = np.unique(np.searchsorted(times, grid - 1e-9).clip(0, len(times) - 1))
    arguments = (
        *(parameters, times[few], target[few], initial_heat),
        *(held, task, warm_up_time, measured_margin),
    )
    _, duty = _ConvexProgram(*arguments).minimize(
        held.expanded if wires.rates_are_affine else _heated_angles(parameters, held)
    )
    heat, duty = _CurvedProgram(*arguments).solve(duty)
    course = PiecewisePolynomial.CubicHermite(times[few], heat.T, wires.heat_rates(heat, duty).T)
    duty = np.array([np.interp(times, times[few], of_wire) for of_wire in duty.T])
    return course.vector_values(times), duty


class _CurvedProgram:
    """The quasi-static program where torque or rates are not affine, of heat and duty alone.

    Args: as of `_ConvexProgram`.
    """

    def __init__(
        self, parameters, times, target, initial_heat, held, task, warm_up_time, measured_margin
    ):
        wires = held.wires
        self._wires, self._times, self._initial_heat = wires, times, initial_heat
        self._highest_duty = 1.0 - task.duty_margin
        self._prog = prog = MathematicalProgram()
        heat = prog.NewContinuousVariables(len(times), len(initial_heat), "y")
        duty = prog.NewContinuousVariables(len(times), wires.num_wires, "D")
        steps = prog.NewContinuousVariables(len(times) - 1, "h")
        self._heat, self._duty, self._steps = (
            np.array(prog.FindDecisionVariableIndices(variables.ravel())).reshape(variables.shape)
            for variables in (heat, duty, steps)
        )
        prog.AddBoundingBoxConstraint(np.diff(times), np.diff(times), steps)
        prog.AddBoundingBoxConstraint(initial_heat, initial_heat, heat[0])
        add_wires(prog, parameters, times, heat, duty, task, warm_up_time, measured_margin)
        for variables, scale in zip(heat.T, wires.heat_scales, strict=True):
            for variable in variables:
                prog.SetVariableScaling(variable, scale)
        typical = float(np.median(np.diff(times)))
        defects = LimbDefects(None, wires, self._heat, self._duty, self._steps, typical)
        angle_weights, _ = task.weights(times)
        cost = _HeldCost(held, self._heat[:, : wires.num_states], target, angle_weights)
        self._solver = ExactHessianIpoptSolver(exact=True, nonlinear=defects, cost=cost)

    def solve(self, duty: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The optimal [x, V] (K, N + W) and D (K, W), or what comes of this duty (K, W)."""
        N, start = self._wires.num_states, self._initial_heat
        states = self._wires.under_duty(start[:N], duty, self._times)
        readings = readings_along(self._wires, states, start[N:], self._times)
        guess = np.zeros(self._prog.num_vars())
        guess[self._heat], guess[self._duty] = np.hstack([states, readings]), duty
        guess[self._steps] = np.diff(self._times)
        options = SolverOptions()
        for option, value in CURVED_OPTIONS.items():
            options.SetOption(IpoptSolver.id(), option, value)
        result = self._solver.Solve(self._prog, guess, options)
        x = result.get_x_val() if result.is_success() else guess
        return x[self._heat], np.clip(x[self._duty], 0.0, self._highest_duty)


class _HeldCost:
    """(15) of the angles that wires hold, as a `planners.transcription.ipopt.CostBlock`.

    Args:
        held: angles that the wires hold.
        states: indices of x (K, N) among the program's variables.
        target: θ_ref (K, n), rad.
        weights: Q at the knots (K,).
    """

    def __init__(
        self, held: HeldAngles, states: np.ndarray, target: np.ndarray, weights: np.ndarray
    ):
        self._held, self._states, self._target = held, states, target
        self._weights = weights[:, None]
        self.columns = states.ravel()
        self._triangle = rows, columns = np.tril_indices(states.shape[1])
        self.hessian_rows = states[:, rows].ravel()
        self.hessian_columns = states[:, columns].ravel()

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        missed = self._held.angles(x[self._states]) - self._target
        return np.array([0.5 * (self._weights * missed**2).sum()])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        angles, slopes = self._held.expanded(x[self._states])
        weighted = self._weights * (angles - self._target)
        return (weighted[:, None, :] @ slopes).ravel()

    def hessian(self, x: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        states = x[self._states]
        angles, slopes = self._held.expanded(states)
        hessian = self._weights[:, None] * slopes.swapaxes(1, 2) @ slopes
        weighted = self._weights * (angles - self._target)
        hessian = hessian + self._held.curvature(states, weighted)
        rows, columns = self._triangle
        return hessian[:, rows, columns].ravel()


class _ConvexProgram:
    """The quasi-static program where angles are linear in the wires' states.

    Args:
        target: θ_ref (K, n), rad.
        initial_heat: x and V at the start (N + W,).
        held: angles that the wires hold.
        parameters, times, task, warm_up_time, measured_margin: as for
            `solve_quasi_static`.
    """

    def __init__(
        self, parameters, times, target, initial_heat, held, task, warm_up_time, measured_margin
    ):
        wires = self._wires = held.wires
        self._task, self._target = task, target
        self._limits = parameters.temperature_limits
        self._angle_weights, self._duty_weights = task.weights(times)
        self._energy = task.energy_weight * task.shares(times)
        self._temperature_weights = temperature_weights(parameters, times, task)
        num_knots, W = len(times), wires.num_wires
        bounds = reading_bounds(parameters, measured_margin)
        # Readings are needed only where they are bounded.
        size = wires.num_states + (W if np.isfinite(bounds).any() else 0)
        self._prog = prog = MathematicalProgram()
        heat = prog.NewContinuousVariables(num_knots, size, "y")
        self._states = heat[:, : wires.num_states]
        self._duty = duty = prog.NewContinuousVariables(num_knots, W, "D")
        A, B, c = _affine_heat(wires, size)
        # (6), with an input that is one
        B, one = np.column_stack([B, c]), np.array([size + W, 2 * (size + W) + 1])
        heating = {}
        for k, h in enumerate(np.diff(times)):
            if h not in heating:
                defect = linear_defect(A, B, h)
                heating[h] = LinearEqualityConstraint(
                    np.delete(defect, one, axis=1), -defect[:, one].sum(axis=1)
                )
            prog.AddConstraint(heating[h], np.r_[heat[k], duty[k], heat[k + 1], duty[k + 1]])
        none = np.zeros(wires.num_states)
        self._costs = [
            prog.AddQuadraticCost(np.diag(none + 1.0), none, x, is_convex=True)
            for x in self._states
        ]
        prog.AddBoundingBoxConstraint(initial_heat[:size], initial_heat[:size], heat[0])
        add_wires(prog, parameters, times, heat, duty, task, warm_up_time, measured_margin)

    def solve(
        self, angles: np.ndarray, slopes: np.ndarray, at: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The optimal x (K, N) and D (K, W) for these angles (K, n) at states (K, N).

        Args:
            slopes: derivatives of the angles by the states (K, n, N).

        Raises:
            InfeasibleError: if there is none.
        """
        offsets = angles - np.einsum("kij,kj->ki", slopes, at) - self._target
        for cost, weight, to_angles, offset in zip(
            self._costs, self._angle_weights, slopes, offsets, strict=True
        ):
            weighted = weight * to_angles.T
            cost.evaluator().UpdateCoefficients(
                weighted @ to_angles, weighted @ offset, is_convex=True
            )
        result = ClarabelSolver().Solve(self._prog, None, SolverOptions())
        if not result.is_success():
            also = " and the task's max_temperature_rate" if self._task.max_temperature_rate else ""
            raise InfeasibleError(
                "The temperature constraints (19)-(20) cannot all be met with duty between 0 and "
                f"{1.0 - self._task.duty_margin:g}{also} (the quasi-static program: "
                f"{result.get_solution_result().name})."
            )
        # Drake drops an axis of length one.
        duty = result.GetSolution(self._duty).reshape(self._duty.shape)
        duty = np.clip(duty, 0.0, 1.0 - self._task.duty_margin)
        return result.GetSolution(self._states).reshape(self._states.shape), duty

    def minimize(self, angles_at: AngleMap) -> tuple[np.ndarray, np.ndarray]:
        """x (K, N) and D (K, W) of about least cost where angles are not linear in x.

        Args:
            angles_at: the angles (K, n) at states (K, N), and their derivatives (K, n, N).
        """
        num_states = self._wires.num_states

        def split(point: np.ndarray) -> list[np.ndarray]:
            return np.split(point, [num_states], axis=1)

        def cost_of(point: np.ndarray) -> float:
            return self._cost(angles_at, *split(point))

        def solve(point: np.ndarray) -> np.ndarray:
            states, _ = split(point)
            return np.hstack(self.solve(*angles_at(states), states))

        found = np.hstack(self.solve(*self._chord(angles_at)))
        step = first_that_reduces((1.0, 0.5, 0.25, 0.125), cost_of)
        found, _, _ = descend(found, cost_of(found), solve, step, MAX_TANGENTS, LITTLE)
        states, duty = split(found)
        return states, duty

    def _chord(self, angles_at: AngleMap) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angles, their mean slope and states in the middle, between T_warm and T_max."""
        levels = np.linspace(self._limits.warm, self._limits.maximum, CHORD_POINTS)
        wires, num_knots = self._wires, len(self._target)
        at = np.array([wires.settled_states(np.full(wires.num_wires, T)) for T in levels])
        means = [values.mean(axis=0) for values in (*angles_at(at), at)]
        angles, slopes, middle = (np.broadcast_to(mean, (num_knots, *mean.shape)) for mean in means)
        return angles, slopes, middle

    def _cost(self, angles_at: AngleMap, states: np.ndarray, duty: np.ndarray) -> float:
        """(15), with the task's energy and temperatures."""
        missed = ((angles_at(states)[0] - self._target) ** 2).sum(axis=1)
        of_duty = 0.5 * self._duty_weights * (duty**2).sum(axis=1) + self._energy * duty.sum(axis=1)
        of_heat = (self._temperature_weights * states[:, : duty.shape[1]]).sum()
        return float(0.5 * (self._angle_weights * missed).sum() + of_duty[:-1].sum() + of_heat)


def _affine_heat(wires: Wires, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B and c of the first rows of ẏ = A y + B D + c, the tangent at cold wires."""
    W, N = wires.num_wires, wires.num_states
    cold, off = np.concatenate([wires.cold_states, wires.cold_states[:W]]), np.zeros(W)
    slopes = wires.heat_jacobian(cold, off).reshape(N + W, -1)
    A, B = slopes[:size, :size], slopes[:size, N + W :]
    return A, B, wires.heat_rates(cold, off)[:size] - A @ cold[:size]


def _heated_angles(parameters: LimbParameters, held: HeldAngles) -> AngleMap:
    """Angles that wires hold which were heated from cold to T, by a table."""
    wires, T0 = held.wires, parameters.ambient_temperature
    W, N = wires.num_wires, wires.num_states
    warmest = 2 * parameters.temperature_limits.maximum - T0
    grid = np.linspace(T0, warmest, TABLE_SIZE)
    laws = [wire.law for wire in parameters.wires]
    table = [
        np.array([law.torque(law.warm_states(float(T), T0), T0, 0.0) for T in grid]) for law in laws
    ]
    to_angles = held.compliance @ wires.directions

    def angles_at(states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        T = states[:, :W]
        torques = np.column_stack([np.interp(T[:, w], grid, table[w]) for w in range(W)])
        cold = np.array([torque[0] for torque in table])
        steps = np.clip((T - T0) / (grid[1] - grid[0]), 0, TABLE_SIZE - 2).astype(int)
        by_T = np.column_stack([np.diff(table[w])[steps[:, w]] for w in range(W)])
        slopes = np.zeros((len(states), len(to_angles), N))
        slopes[:, :, :W] = to_angles * (by_T / (grid[1] - grid[0]))[:, None, :]
        return held.rest_angles + (torques - cold) @ to_angles.T, slopes

    return angles_at


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
