"""The quasi-static program: plans of heat and duty for a limb in static equilibrium.

The mechanics is fast (5 Hz) and the heat is slow (0.1 Hz), so the joint angles nearly are in the
equilibrium of the wires' torques: K θ + ∇V(θ) = f(x, θ). The variables are heat, duty and bends φ
alone, however many joints there are. The collocation (17) of the heat is the same as in the
trajectory program. φ = φ(θ(x)) has exact first and second derivatives by adjoints. (15) weighs a
bend as it weighs the joints of this bend at equal angles (11).

The trajectory program of a planar limb starts from its solution. Where torque or rates are not
affine, the quasi-static program is first solved at a few of the knots.
"""

import copy
import dataclasses
import functools

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import MathematicalProgram
from pydrake.trajectories import PiecewisePolynomial

from limb_systems import LimbError, LimbModel, LimbParameters, LinearLaw
from limb_systems.limb_mechanics import ANGLE_SCALE
from limb_systems.static_equilibria import StaticEquilibria
from limb_systems.wires import Wires
from planners.task import Task
from planners.transcription.function_block import FunctionBlock
from planners.transcription.ipopt import ConstraintBlock
from planners.transcription.linearized import LinearizedProgram
from planners.transcription.program import PlanProgram, add_at_knots, reading_bounds
from planners.transcription.solving import (
    COARSE_START_OPTIONS,
    START_OPTIONS,
    InfeasibleError,
    Solution,
    solve_program,
)

START_KNOT_SPACING = 0.5  # s, between the knots of a start
CHECK_STEP = 0.5  # s, of the integration that checks whether limits can be met
MIN_BETA = 1e-6  # N·m/°C, of wires that are taken to be linear


def check_temperature_limits(
    model: LimbModel,
    times: np.ndarray,
    initial_heat: np.ndarray,
    warm_up_time: float,
    task: Task,
    measured_margin: ArrayLike = 0.0,
) -> None:
    """Check that (19)-(20) can be met, wire by wire.

    More duty means more heat at all later times, so the temperatures at full
    and at zero duty enclose all others.

    Args:
        times: times of the knots (K,), s.
        initial_heat: x and V at the start (N + W,).
        warm_up_time: k_warm, s from the first knot.
        task: task with margins.
        measured_margin: margin of the readings, as for `PlanProgram`.

    Raises:
        InfeasibleError: names the wire, the constraint and the time from which it could be met.
    """
    wires = model.wires
    limits = model.parameters.temperature_limits
    full_duty = 1.0 - task.duty_margin
    highest = limits.maximum - task.temperature_margin
    margin = f" less a margin of {task.temperature_margin:g} °C" if task.temperature_margin else ""
    if highest < limits.warm:
        raise InfeasibleError(
            f"T_max = {limits.maximum:g} °C{margin} is below T_warm = {limits.warm:g} °C; give "
            "the task a smaller temperature_margin."
        )

    # Simulate the wires at zero and at full duty.
    initial_states, initial_readings = np.split(initial_heat, [wires.num_states])

    def states_at(level: float, until: np.ndarray) -> np.ndarray:
        """Return x (K, N) at times (K,) with all wires at this duty."""
        duty = np.full((len(until) + 1, wires.num_wires), level)
        until = np.append(0.0, until)
        return wires.integrate_states(initial_states, duty, until, CHECK_STEP)[1:]

    warm_knots = times > warm_up_time
    first_warm_knot = times[np.argmax(warm_knots)]
    heated = states_at(full_duty, np.array([first_warm_knot]))[0]
    off = states_at(0.0, times[:2])
    cooled = off[1]
    cooled_readings = integrate_readings(wires, off, initial_readings, times[:2])[1]
    bounds = reading_bounds(model, measured_margin)
    ahead = np.linspace(0.0, _settling_time(wires), 1000)
    for index, name in enumerate(model.parameters.wire_names):
        start = initial_states[index]
        # At zero duty the wire reads too hot, or is too hot (19).
        if cooled_readings[index] > bounds[index]:
            raise InfeasibleError(
                f"The {name} wire reads {cooled_readings[index]:.4g} °C at {times[1]:g} s without "
                f"duty, above the {bounds[index]:.4g} °C that measured_maximum and its margin "
                "allow; let it cool first."
            )
        if cooled[index] > highest:
            below = _first_crossing_time(ahead, states_at(0.0, ahead)[:, index], highest)
            duration = f" for {below:.3g} s" if np.isfinite(below) else ""
            raise InfeasibleError(
                f"The {name} wire starts at {start:.4g} °C, above T_max = {limits.maximum:g} °C"
                f"{margin} (19); let it cool{duration} first."
            )
        # At full duty the wire is too cold (20).
        if heated[index] >= limits.warm or not warm_knots.any():
            continue
        temperature = states_at(full_duty, ahead)[:, index]
        warm_from = _first_crossing_time(ahead, temperature, limits.warm)
        advice = f"it never gets above {temperature[-1]:.4g} °C"
        if np.isfinite(warm_from):
            advice = (
                f"it could from {warm_from:.3g} s on, so set temperature_limits.warm_up_time to "
                "that"
            )
        heating = "full duty" if full_duty == 1.0 else f"a duty of {full_duty:g}"
        raise InfeasibleError(
            f"The {name} wire cannot be at T_warm = {limits.warm:g} °C (20) by "
            f"{first_warm_knot:g} s: at {heating} from {start:.4g} °C it reaches "
            f"{heated[index]:.4g} °C by then; {advice}."
        )


def static_motion(statics: StaticEquilibria, states: np.ndarray, duty: np.ndarray) -> np.ndarray:
    """Return [θ, θ̇] (K, 2n) in equilibrium with the wires' states x (K, N) under duty (K, W)."""
    angles, slopes = statics.expanded(states)
    rates = (slopes @ statics.wires.rates(states, duty)[:, :, None])[:, :, 0]
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
    is_start: bool = False,
) -> tuple["QuasiStaticProgram", Solution]:
    """Solve the quasi-static program of a plan, without the task's limits of the motion.

    Args:
        times, initial_heat, warm_up_time, measured_margin: as for `check_temperature_limits`.
        reference: φ_ref at the knots (F, K), rad.
        start: heat [x, V] (N + W, K) and duty (W, K) of a plan from which the solver starts;
            the plan of wires that are taken to be linear if None.
        is_start: whether the solution is the start of another program, and need not be accurate.

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

    def solve(
        knots: np.ndarray,
        start: tuple[np.ndarray, np.ndarray] | None,
        is_near: bool = False,
        ipopt_options: dict[str, float] | None = START_OPTIONS if is_start else None,
    ) -> tuple[QuasiStaticProgram, Solution]:
        """Solve the program at some knots, from heat and duty at these knots."""
        program = QuasiStaticProgram(model, times[knots], model.statics, task, measured_margin)
        program.update(reference[:, knots], initial_heat, warm_up_time)
        linear = None if start else program.linear_start()
        if linear and is_start:
            program.free_last_duty(linear)
            return program, linear
        if linear:
            return program, solve_program(program, linear.x, linear.multipliers)
        guess = program.variables(*start) if start else program.guess()
        return program, solve_program(
            program, guess, starts_near=is_near, ipopt_options=ipopt_options
        )

    # Solve a convex program, or a program with a start, at once.
    every = np.arange(len(times))
    wires = model.wires
    num_intervals = max(1, round((times[-1] - times[0]) / START_KNOT_SPACING))
    if start is not None or wires.are_linear or 2 * num_intervals > len(times):
        return solve(every, start)
    # Start another program from its solution at fewer knots.
    grid = np.linspace(times[0], times[-1], num_intervals + 1)
    some = np.unique(np.searchsorted(times, grid - 1e-9).clip(0, len(times) - 1))
    program, solution = solve(some, None, ipopt_options=COARSE_START_OPTIONS)
    heat = solution.x[program.heat]
    duty = solution.x[program.duty]
    rates = wires.heat_rates(heat, duty)
    heat_trajectory = PiecewisePolynomial.CubicHermite(times[some], heat.T, rates.T)
    duty = np.array([np.interp(times, times[some], of_wire) for of_wire in duty.T])
    return solve(every, (heat_trajectory.vector_values(times), duty), is_near=True)


class QuasiStaticProgram(PlanProgram):
    """A `PlanProgram` of a limb that is always in equilibrium with its wires.

    (17) of the heat and φ = φ(x) are not in ``prog``, but in ``blocks``.

    - ``statics``: angles and bends in equilibrium.
    - ``bends``: indices of φ (K, F) among the decision variables.

    Args:
        parameters, times, task, measured_margin: as for `PlanProgram`.
        statics: angles and bends in equilibrium.
        limit_weight: as for `PlanProgram`. V is left out if limits may be passed.
    """

    has_inertia = False

    def __init__(
        self,
        parameters: LimbParameters | LimbModel,
        times: np.ndarray,
        statics: StaticEquilibria,
        task: Task,
        measured_margin: ArrayLike = 0.0,
        limit_weight: float | None = None,
    ):
        self.statics = statics
        self._is_soft = limit_weight is not None
        super().__init__(parameters, times, task, measured_margin, limit_weight)

    def _add_variables(self) -> None:
        K = len(self.times)
        wires = self.wires
        # A bend has the weight of its joints at equal angles.
        self._shares = (self.model.mechanics.shape**2).sum(axis=0)  # of (15) in the joints' angles
        self._to_bends = np.eye(len(self._shares))
        num_heat = wires.num_states if self._is_soft else len(wires.heat_scales)
        self.prog = prog = MathematicalProgram()
        self._heat = prog.NewContinuousVariables(K, num_heat, "y")
        self._duty = prog.NewContinuousVariables(K, wires.num_wires, "D")
        self._tracked = prog.NewContinuousVariables(K, len(self._shares), "b")
        self._time_steps = prog.NewContinuousVariables(K - 1, "h")
        prog.AddBoundingBoxConstraint(*self._shortest_and_longest_step(), self._time_steps)
        self.bends = self.indices(self._tracked)
        self._start = self._heat[0]
        self._of_knots = np.hstack([self.indices(self._heat), self.bends])
        angles = np.full(len(self._shares), ANGLE_SCALE)
        self._scales = np.append(wires.heat_scales[:num_heat], angles)

    def _make_blocks(self) -> list[ConstraintBlock]:
        states = self.heat[:, : self.wires.num_states]
        bends = FunctionBlock(self.statics, states, self.bends)
        blocks = [self._heat_block, bends]
        self.cheap_blocks = blocks if self.task.stretch else [*self._fixed_heat_blocks(), bends]
        return blocks

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
        """Return all decision variables under the best duty for linear wires like the limb's.

        If the wires are linear, or their laws state no rates, the duty holds them between T_warm
        and T_max.
        """
        wires = self.wires
        N = self.wires.num_states
        start = self._initial_heat
        duty = self._duty_of_linear_wires()
        if duty is None:
            duty = self._holding()[self.duty]
        states = wires.integrate_states(start[:N], duty, self.times)
        readings = integrate_readings(wires, states, start[N:], self.times)
        return self.variables(np.hstack([states, readings]).T, duty.T)

    def _holding(self) -> np.ndarray:
        """Return all decision variables of wires that are held between T_warm and T_max."""
        wires = self.wires
        limits = self.parameters.temperature_limits
        middle = np.full(wires.num_wires, 0.5 * (limits.warm + limits.maximum))
        states = wires.settled_states(middle)
        duty = wires.holding_duty(states)
        num_knots = len(self.times)
        heat = np.concatenate([states, middle])
        return self.variables(np.tile(heat, (num_knots, 1)).T, np.tile(duty, (num_knots, 1)).T)

    def variables(self, heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Return all decision variables, from heat [x, V] (N + W, K) and duty (W, K)."""
        x = np.zeros(self.prog.num_vars())
        x[self.time_steps] = np.diff(self.times)
        x[self.heat] = heat[: self.heat.shape[1]].T
        x[self.duty] = duty.T
        x[self.bends] = self.statics.values(heat[: self.wires.num_states].T)
        return x

    @functools.cached_property
    def linearized(self) -> LinearizedProgram:
        """The program with ``cheap_blocks`` linearized about a point."""
        return LinearizedProgram(self)

    def linear_start(self) -> Solution | None:
        """Return the solution about wires that are held, as a start.

        Only the bend is linearized if the wires are linear. It is None for other wires, and if
        there is no solution.
        """
        if self.task.customize or self.task.stretch or not self.wires.are_linear:
            return None
        solution = self.linearized.solve(self._holding(), is_start=True)
        if solution is None:
            return None
        # Let the initial heat, the readings and the bends be those of the program itself.
        x = solution.x
        x[self.heat[0]] = self._initial_heat
        self.set_free_readings(x)
        x[self.bends] = self.statics.values(x[self.heat[:, : self.wires.num_states]])
        return solution

    def free_last_duty(self, solution: Solution) -> None:
        """Move the last duty of a solution away from its bounds, if the task lets it jump.

        It moves the last bend of this program at once, but not the last bend of a limb with
        inertia. A solver that starts from bounds which are not active needs twice the iterations.
        """
        if self.task.duty_hold or solution.multipliers is None:
            return
        _, of_bounds = solution.multipliers
        last = self.duty[-1]
        most = min(1.0 - self.task.duty_margin, self.parameters.total_duty / len(last))
        solution.x[last] = 0.5 * most
        of_bounds[last] = 0.0

    def _duty_of_linear_wires(self) -> np.ndarray | None:
        """Return the best duty (K, W) for `linear_limb`, its only optimum; None if infeasible."""
        if self.wires.are_linear:
            return None
        reference, warm_up_time = self._asked
        task = dataclasses.replace(self.task, customize=None, stretch=None, time_weight=0.0)
        try:
            linear = LimbModel.of(linear_limb(self.parameters))
            W = self.wires.num_wires
            program = QuasiStaticProgram(linear, self.times, linear.statics, task)
            heat = np.concatenate([self._initial_heat[:W], self._initial_heat[-W:]])
            program.update(reference, heat, warm_up_time)
            solution = program.linear_start()
        except LimbError:
            return None
        if solution is None:
            return None
        return np.clip(solution.x[program.duty], 0.0, 1.0 - self.task.duty_margin)

    def signals(self, x: np.ndarray) -> dict[str, np.ndarray | None]:
        """Return the signals of a `Trajectory`, from all decision variables."""
        states, readings = np.split(x[self.heat].T, [self.wires.num_states])
        motion = static_motion(self.statics, states.T, x[self.duty]).T
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
    """Return a similar limb with wires of the paper's law, and with springs alone.

    The torque is the chord, from T_warm to T_max, of the torque of wires heated from cold.

    Raises:
        LimbError: if a law does not state how fast its wire heats and cools.
    """
    linear = copy.deepcopy(parameters)
    limits = parameters.temperature_limits
    T0 = parameters.ambient_temperature
    for segment in linear.segments:
        segment.stiffening = 0.0
        segment.rest_memory = None
        for wire in segment.wires:
            # The chord of the torque, and mean rates.
            law = wire.law
            rates = law.typical_rates()
            warm = law.torque(law.warm_states(limits.warm, T0), T0, 0.0)
            hot = law.torque(law.warm_states(limits.maximum, T0), T0, 0.0)
            wire.law = LinearLaw(
                a1=-float(np.sqrt(rates["slowest_cooling"] * rates["fastest_cooling"])),
                a2=rates["heating"],
                a3=-rates["reading"],
                beta=max(float(hot - warm) / (limits.maximum - limits.warm), MIN_BETA),
            )
    return linear


def integrate_readings(
    wires: Wires, states: np.ndarray, initial_readings: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Return the thermocouples' readings V (K, W), °C, by (7): K times, W wires.

    It is the exact solution of V̇ = λ V + c(t) for c linear between the times.

    Args:
        wires: the wires; their readings decay at rates λ below zero, never at zero.
        states: all N states of the wires at the times (K, N).
        initial_readings: V at the first time (W,), °C.
        times: (K,), s.
    """
    # λ and c at the times, as the rates are affine in V.
    zero = np.zeros((len(states), wires.num_wires))
    c = wires.reading_rates(zero, states)
    decay_rates = wires.reading_rates(zero + 1.0, states) - c  # λ, 1/s
    readings = np.empty_like(zero)
    readings[0] = initial_readings
    for k, step in enumerate(np.diff(times)):
        decay_rate = 0.5 * (decay_rates[k] + decay_rates[k + 1])
        # The particular solution is a constant offset, °C, behind the settled readings.
        settled = -c[k : k + 2] / decay_rate
        lag_offset = (settled[1] - settled[0]) / step / decay_rate
        transient = readings[k] - settled[0] - lag_offset
        readings[k + 1] = settled[1] + lag_offset + np.exp(decay_rate * step) * transient
    return readings


def _settling_time(wires: Wires) -> float:
    """Return the time after which wires at constant duty have settled, s."""
    settling = wires.affine_rates()[0][np.ix_(wires.settles, wires.settles)]
    rates = np.abs(np.linalg.eigvals(settling))
    return 12.0 / rates[rates > 1e-7 * rates.max()].min()  # a memory may not be named as such


def _first_crossing_time(times: np.ndarray, values: np.ndarray, target: float) -> float:
    """Return the first time when values (K,), linear between times, pass a target, or inf."""
    crossings = np.flatnonzero(np.diff(values > target))
    if not len(crossings):
        return np.inf
    first = crossings[0]
    share = (target - values[first]) / (values[first + 1] - values[first])
    return float(times[first] + share * (times[first + 1] - times[first]))
