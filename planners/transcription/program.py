"""The trajectory program, eqns (15)-(20), on Drake's DirectCollocation."""

import functools
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike
from pydrake.solvers import Binding, LinearConstraint, MathematicalProgram

from limb_systems import LimbModel, LimbParameters, joint_angles_from_bend_angle, split_state
from limb_systems.files.trajectory import AddedTerms
from limb_systems.limb_mechanics import ANGLE_SCALE
from planners.task import Task, TaskError
from planners.transcription.collocation import MotionDefects, fixed_time_heat_blocks, heat_block
from planners.transcription.customized_terms import describe, group_by_name, variables_at_bounds
from planners.transcription.ipopt import ConstraintBlock, scales_of_variables

if TYPE_CHECKING:
    from limb_systems import Limb

REST_RATE = np.deg2rad(0.5)  # rad/s, largest bend rate at rest
REACH_TOLERANCE = np.deg2rad(0.1)  # rad
# Largest violation of constraints of ``customize``, relative to bounds larger than one.
ADDED_TOLERANCE = 1e-5
KNOTS_PER_COST = 20


class PlanProgram:
    """Eqns (15)-(20) for one limb, with the task's further costs and limits.

    `TrajectoryProgram` plans the motion of the chain and the heat, `QuasiStaticProgram` the heat
    alone. `update` sets the reference, the initial state and the warm-up.

    - ``prog``: the `MathematicalProgram`.
    - ``model``, ``wires``: the limb and its wires.
    - ``times``: times of the knots (K,), s, before they are stretched.
    - ``heat``, ``duty``, ``time_steps``: indices of [x, V] (K, M), u_k (K, W) and h_k (K - 1)
      among the decision variables.
    - ``blocks``: constraints that are evaluated together, in addition to those in ``prog``.
    - ``cheap_blocks``: the same constraints with a cheaper, incomplete Hessian, and without (7) of
      the ``free_readings``; None if the program needs the whole Hessian.
    - ``free_readings``: indices of V (K, W) if nothing else depends on V; (K, 0) if something does.
    - ``added``, ``added_costs``: the constraints and costs that the task's ``customize`` added.

    Args:
        parameters: the limb or its description.
        times: times of the knots (K,), s, from 0.
        task: weights and limits; `Task()` if None.
        measured_margin: how far readings V stay below ``measured_maximum``, °C, one number or
            one for each wire (W,).
        limit_weight: cost of each °C beyond (19)-(20), 1/°C; the bounds are hard if None.
    """

    has_inertia: bool  # whether the motion of the chain is planned, and not the heat alone

    prog: MathematicalProgram
    heat: np.ndarray
    duty: np.ndarray
    blocks: list[ConstraintBlock]
    cheap_blocks: list[ConstraintBlock] | None
    free_readings: np.ndarray
    _heat_block: ConstraintBlock  # (17) of all the heat, one of the ``blocks``
    _heat: np.ndarray  # the variables of [x, V] (K, M), of u (K, W) and of h (K - 1)
    _duty: np.ndarray
    _time_steps: np.ndarray
    _start: np.ndarray  # variables whose values (16) gives
    # Variables whose distance from the reference (15) weighs (K, A), with their weights (A,), and
    # the bends by these variables (F, A).
    _tracked: np.ndarray
    _shares: np.ndarray
    _to_bends: np.ndarray
    _of_knots: np.ndarray  # indices of the knots' variables but the duty (K, P)
    _scales: np.ndarray  # typical changes of the variables of a knot (P,)

    def __init__(
        self,
        parameters: LimbParameters | LimbModel,
        times: np.ndarray,
        task: Task | None = None,
        measured_margin: ArrayLike = 0.0,
        limit_weight: float | None = None,
    ):
        self.model = LimbModel.of(parameters)
        self.parameters = self.model.parameters
        self.times = times
        self.task = task or Task()
        self.wires = self.model.wires
        self._layout = self.model.layout
        # Add the variables, which set ``prog``, and the cost (15) of the angles.
        self._add_variables()
        self.heat = self.indices(self._heat)
        self.duty = self.indices(self._duty)
        self._add_time()
        self._add_cost()
        # Add the initial state (16), whose value `update` sets, and the bounds (18)-(20).
        prog = self.prog
        self._initial = prog.AddBoundingBoxConstraint(0.0, 0.0, self._start)
        self._warm_up = self._add_wires(measured_margin, limit_weight)
        # Limit the bend rates, and fix the last bends if the task asks to reach them.
        self._add_rate_limits(self._rate_limits())
        if self.task.reach:
            end = np.zeros(len(self._to_bends))
            self._end = prog.AddLinearConstraint(self._to_bends, end, end, self._tracked[-1])
        # Make the blocks of the dynamics (17).
        self._heat_block = self._make_heat_block()
        self.blocks = self._make_blocks()
        # Let the task add constraints and costs, and find which these are.
        terms_before = {*prog.GetAllConstraints(), *prog.GetAllCosts()}
        if self.task.customize:
            # Numpy would warn of Drake's expressions, which are NaNs in its arrays.
            with np.errstate(invalid="ignore"):
                self.task.customize(self)
        self.added = [b for b in prog.GetAllConstraints() if b not in terms_before]
        self.added_costs = [b for b in prog.GetAllCosts() if b not in terms_before]

    def _add_variables(self) -> None:
        """Add the decision variables, and set the attributes that select from them."""
        raise NotImplementedError

    def _make_blocks(self) -> list[ConstraintBlock]:
        """Return ``blocks``, ``_heat_block`` among them, and set ``cheap_blocks``."""
        raise NotImplementedError

    def _make_heat_block(self) -> ConstraintBlock:
        """Return (17) of the heat."""
        return heat_block(self.model, self.heat, self.duty, self.time_steps)

    def _fixed_heat_blocks(self) -> list[ConstraintBlock]:
        """Return (17) of the heat at fixed time steps, without the ``free_readings``."""
        num_free = self.free_readings.shape[1]
        heat = self.heat[:, : self.heat.shape[1] - num_free]
        return fixed_time_heat_blocks(self.model, heat, self.duty, self.time_steps)

    def _add_rate_limits(self, limits: np.ndarray) -> None:
        """Limit the bend rates at the knots (K,), rad/s, where the limits are finite."""
        raise NotImplementedError

    def _targets(self, reference: np.ndarray) -> np.ndarray:
        """Return the targets of the tracked variables (K, A) in (15), by φ_ref (F, K), rad."""
        raise NotImplementedError

    def update(self, reference: np.ndarray, initial_state: np.ndarray, warm_up_time: float) -> None:
        """Set the values that change from plan to plan.

        Args:
            reference: φ_ref at the knots (F, K), rad.
            initial_state: x_init, a state of `Limb`, or its heat [x, V] alone for a program
                without inertia.
            warm_up_time: k_warm, s from the first knot.
        """
        # The cost (15) of the angles.
        weights, _ = self.task.weights(self.times)
        self._angle_weights = np.outer(weights, self._shares)
        self._angle_targets = targets = self._targets(reference)
        for binding, knots in zip(self._angle_costs, self._groups_of_knots(), strict=True):
            Q = self._angle_weights[knots].ravel()
            target = targets[knots].ravel()
            constant = 0.5 * float((Q * target**2).sum())
            binding.evaluator().UpdateCoefficients(np.diag(Q), -Q * target, constant, True)
        # The initial state (16), the warm-up (20), and the last angle.
        heat = initial_state[-len(self.wires.heat_scales) :]
        start = initial_state if self.has_inertia else heat[: self._start.size]
        self._initial.evaluator().set_bounds(start, start)
        lower = warm_bounds(self.model, self.times, warm_up_time)
        self._warm_up.evaluator().UpdateLowerBound(lower)
        if self.task.reach:
            end = reference[:, -1]
            self._end.evaluator().set_bounds(end - REACH_TOLERANCE, end + REACH_TOLERANCE)

    @property
    def starts_near(self) -> bool:
        """True if the quasi-static plan is near the plan, so that a solver starts from it."""
        task = self.task
        limits_motion = task.customize or task.reach or task.final_hold or task.max_bend_rate
        return self.has_inertia and not limits_motion

    @property
    def scales(self) -> np.ndarray:
        """The typical changes of all decision variables (num_vars,)."""
        scales = np.ones(self.prog.num_vars())
        scales[self._of_knots] = self._scales
        return scales_of_variables(self.prog, scales)  # the task's ``customize`` may have set some

    @property
    def state_scales(self) -> np.ndarray:
        """The typical changes of a `Limb`'s states (2n + M,)."""
        n = self.parameters.num_joints
        return np.concatenate([np.full(n, ANGLE_SCALE), np.ones(n), self.wires.heat_scales])

    def indices(self, variables: np.ndarray) -> np.ndarray:
        """Return the indices of variables among all decision variables, in their shape."""
        flat = self.prog.FindDecisionVariableIndices(variables.ravel())
        return np.array(flat).reshape(variables.shape)

    def knots(self, x: np.ndarray) -> np.ndarray:
        """Return the times of the knots (K,), s, from all decision variables."""
        if self.task.stretch is None:
            return self.times
        return np.append(0.0, np.cumsum(x[self.time_steps]))

    def cost(self, x: np.ndarray) -> float:
        """Return the cost (15), with the task's further costs."""
        return float(self.prog.EvalBindings(self.prog.GetAllCosts(), x).sum())

    def cost_by_angles(self, x: np.ndarray) -> np.ndarray:
        """Return the gradient of the cost (15) of the angles by the tracked variables (K, A)."""
        return self._angle_weights * (x[self.indices(self._tracked)] - self._angle_targets)

    def set_free_readings(self, x: np.ndarray) -> None:
        """Set the ``free_readings`` so that their defects (17) are zero, from V at the first knot.

        The defect of an interval is affine in V at its first knot and V at its second knot.

        Args:
            x: values of all decision variables, which are changed in place.
        """
        num_knots, num_readings = self.free_readings.shape
        if not num_readings:
            return
        first_readings = x[self.free_readings[0]]

        def defects(readings: np.ndarray) -> np.ndarray:
            """Return the defects of V (K - 1, W), where all wires have the same V (K,)."""
            x[self.free_readings] = readings[:, None]
            rows = self._heat_block.evaluate(x)
            return rows.reshape(num_knots - 1, -1)[:, -num_readings:]

        # Find the derivatives of each defect by V at its first and at its second knot (K - 1, W):
        # set V to 1 °C at the odd knots, then at the even knots.
        is_odd = np.arange(num_knots) % 2
        at_zero = defects(np.zeros(num_knots))
        by_odd = defects(is_odd) - at_zero
        by_even = defects(1 - is_odd) - at_zero
        starts_odd = is_odd[:-1, None] == 1
        by_first = np.where(starts_odd, by_odd, by_even)
        by_second = np.where(starts_odd, by_even, by_odd)
        # Solve each defect for V at its second knot, knot by knot.
        offsets = -at_zero / by_second
        factors = -by_first / by_second
        readings = [first_readings]
        for offset, factor in zip(offsets, factors, strict=True):
            readings.append(offset + factor * readings[-1])
        x[self.free_readings] = readings

    def largest_defect(self, x: np.ndarray) -> float:
        """Return the largest violation of the ``blocks``, scaled: of (17), and of φ = φ(x), rad."""
        return max(float(np.abs(block.evaluate(x)).max()) for block in self.blocks)

    def broken_constraint(self, x: np.ndarray) -> str:
        """Return the ``added`` constraint with the largest violation, in words; "" if all hold."""
        worst = ""
        largest = ADDED_TOLERANCE
        for number, binding in enumerate(self.added, 1):
            # The violation of each row, relative to its bound.
            evaluator = binding.evaluator()
            values = self.prog.EvalBinding(binding, x)
            below = evaluator.lower_bound() - values
            above = values - evaluator.upper_bound()
            violation = np.maximum(below, above)
            bound = np.where(below > above, evaluator.lower_bound(), evaluator.upper_bound())
            relative = violation / np.maximum(1.0, np.abs(bound))
            row = int(np.argmax(relative))  # NaN if there is one
            if relative[row] <= largest:
                continue
            largest = np.nan_to_num(relative[row], nan=np.inf)
            worst = (
                f"'{describe(binding)}' (number {number} of {len(self.added)}"
                f"{self._when(binding)}) is missed by {violation[row]:.3g}"
            )
        return worst

    def added_terms(self, x: np.ndarray) -> list[AddedTerms]:
        """Return the terms of ``customize``, with the values of costs, by names."""
        terms = []
        for name, bindings in group_by_name(self.added_costs).items():
            value = float(self.prog.EvalBindings(bindings, x).sum())
            terms.append(AddedTerms(name, len(bindings), value))
        for name, bindings in group_by_name(self.added).items():
            terms.append(AddedTerms(name, len(bindings)))
        return terms

    def active_knots(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Return, by name, the knots (K,) at which constraints of ``customize`` are at a bound.

        Args:
            x: values of all decision variables of the plan.
        """
        scales = self.scales
        knot_of = self._knots_of_variables()  # index of the knot; -1 for none
        active = {}
        for name, bindings in group_by_name(self.added).items():
            active[name] = np.zeros(len(self.times), bool)
            for binding in bindings:
                indices = np.array(self.prog.FindDecisionVariableIndices(binding.variables()))
                at_bounds = variables_at_bounds(binding, x[indices], scales[indices])
                knots = knot_of[indices[at_bounds]]
                # Time steps belong to no knot: a limit of them alone, such as of the duration, is
                # active at all knots.
                is_about_all = len(knots) > 0 and knots.max() < 0
                active[name][slice(None) if is_about_all else knots[knots >= 0]] = True
        return active

    def _knots_of_variables(self) -> np.ndarray:
        """Return the number of the knot that each decision variable belongs to; -1 for none."""
        knots = np.full(self.prog.num_vars(), -1)
        of_knots = np.hstack([self._of_knots, self.duty])
        knots[of_knots] = np.arange(len(self.times))[:, None]
        return knots

    def _when(self, binding: Binding) -> str:
        """Return the times of the knots that a constraint is about, in words."""
        indices = self.prog.FindDecisionVariableIndices(binding.variables())
        knots = self._knots_of_variables()[indices]
        if not (knots >= 0).any():
            return ""
        first, last = self.times[[knots[knots >= 0].min(), knots.max()]]
        return f", at {first:g} s" if first == last else f", from {first:g} to {last:g} s"

    def _shortest_and_longest_step(self) -> tuple[float, float]:
        steps = np.diff(self.times)
        factors = self.task.stretch or (1.0, 1.0)
        return factors[0] * steps.min(), factors[1] * steps.max()

    def _add_time(self) -> None:
        """Add the times of the knots: fixed, or all stretched by one factor."""
        prog = self.prog
        steps = np.diff(self.times)
        time_steps = self._time_steps
        self.time_steps = self.indices(time_steps)
        if self.task.stretch is None:
            prog.AddBoundingBoxConstraint(steps, steps, time_steps)
            return
        if self.task.time_weight:
            prog.AddLinearCost(np.full(len(steps), self.task.time_weight), 0.0, time_steps)
        for k in range(1, len(steps)):
            prog.AddLinearEqualityConstraint(
                np.array([[1 / steps[0], -1 / steps[k]]]), [0.0], [time_steps[0], time_steps[k]]
            )

    def _add_cost(self) -> None:
        """Add (15) of the angles; `update` sets the reference."""
        self._angle_costs = []
        for knots in self._groups_of_knots():
            tracked = self._tracked[knots].ravel()
            none = np.zeros(len(tracked))
            cost = self.prog.AddQuadraticCost(np.diag(none), none, tracked, is_convex=True)
            self._angle_costs.append(cost)

    def _groups_of_knots(self) -> list[slice]:
        """Return the knots whose costs are one cost of the program: few calls, and small Q."""
        starts = range(0, len(self.times), KNOTS_PER_COST)
        return [slice(start, start + KNOTS_PER_COST) for start in starts]

    def _rate_limits(self) -> np.ndarray:
        """Return the largest bend rates at the knots (K,), rad/s; infinite without a limit."""
        task = self.task
        times = self.times
        rate = np.inf if task.max_bend_rate is None else task.max_bend_rate
        rests = times >= times[-1] - task.final_hold - 1e-9
        rests[-1] = task.reach or task.final_hold > 0
        return np.where(rests, min(rate, REST_RATE), rate)

    def _add_wires(self, measured_margin: ArrayLike, limit_weight: float | None) -> Binding:
        """Add the costs of duty and heat, (18)-(20), and limits of the wires.

        Returns:
            The binding of (19)-(20), whose lower bounds are `warm_bounds`.

        Raises:
            TaskError: if the temperature rate is limited and not affine.
        """
        prog, times, task = self.prog, self.times, self.task
        limits = self.parameters.temperature_limits
        W = self.wires.num_wires
        duty = self._duty
        x, readings = np.split(self._heat, [self.wires.num_states], axis=1)
        T = x[:, :W]

        # (15) of the duty, and the costs of energy and temperature.
        _, weights = task.weights(times)
        energy = task.energy_weight * task.shares(times)
        for knots in self._groups_of_knots():
            of_group = duty[:-1][knots].ravel()
            quadratic = np.diag(np.repeat(weights[:-1][knots], W))
            linear = np.repeat(energy[:-1][knots], W)
            if of_group.size:
                prog.AddQuadraticCost(quadratic, linear, of_group, is_convex=True)
        if task.temperature_weight:
            by_temperature = temperature_weights(self.parameters, times, task)
            constant = -self.parameters.ambient_temperature * by_temperature.sum()
            prog.AddLinearCost(by_temperature.ravel(), constant, T.ravel())

        # Duty is constant at the end, within its bounds (18) and within the total duty.
        if task.duty_hold:
            is_constant = times[:-1] >= times[-1] - task.duty_hold - 1e-9
            is_constant[-1] = True
            pairs = np.stack([duty[:-1][is_constant], duty[1:][is_constant]], axis=-1)
            add_at_knots(prog, np.array([[1.0, -1.0]]), 0.0, 0.0, pairs.reshape(-1, 2))
        prog.AddBoundingBoxConstraint(0.0, 1.0 - task.duty_margin, duty.ravel())
        if self.parameters.total_duty < W:
            add_at_knots(prog, np.ones((1, W)), -np.inf, self.parameters.total_duty, duty)

        # Wires are warm enough (20) and not too hot (19), except in the given initial state.
        warm = warm_bounds(self.model, times, limits.warm_up_time)
        hot = np.full(len(warm), limits.maximum - task.temperature_margin)
        hot[:W] = np.inf
        if limit_weight is None:
            warm_up = prog.AddBoundingBoxConstraint(warm, hot, T.ravel())
        else:
            warm_up = add_soft_bounds(prog, T.ravel(), warm, hot, limit_weight)

        # Readings stay below the board's maximum; without bounds, they follow from the heat.
        bounds = reading_bounds(self.model, measured_margin)
        bounded = readings[1:, np.isfinite(bounds)] if readings.size else readings
        if bounded.size:
            upper = np.tile(bounds[np.isfinite(bounds)], len(bounded))
            prog.AddBoundingBoxConstraint(np.full(len(upper), -np.inf), upper, bounded.ravel())
        are_free = not (bounded.size or task.customize or task.stretch)
        self.free_readings = self.heat[:, self.wires.num_states :] if are_free else self.heat[:, :0]

        # The temperature rate (6) is limited.
        if task.max_temperature_rate is not None:
            if not self.wires.rates_are_affine:
                raise TaskError(
                    "max_temperature_rate needs wires whose temperature rate is affine, as (6) is; "
                    "leave it out for this limb."
                )
            A, B, c = self.wires.affine_rates()
            rate = np.hstack([A, B])[:W]
            limit = task.max_temperature_rate
            add_at_knots(prog, rate, -limit - c[:W], limit - c[:W], np.hstack([x, duty]))
        return warm_up


class TrajectoryProgram(PlanProgram):
    """A `PlanProgram` of the chain's motion and the heat, on Drake's `DirectCollocation`.

    - ``collocation``: the `DirectCollocation` that built it; None without its constraints.
    - ``limb``: the `Limb`, whose dynamics are its constraints.
    - ``states``: indices of x_k (K, 2n + M) among the decision variables, in the order of
      `Limb`: θ (n), rad; θ̇ (n), rad/s; the wires' states x (N), which begin with T (W), °C; and
      V (W), °C. ``motion`` has the first 2n, ``heat`` the last M = N + W of them.
    - ``defects``: (17) of the motion as `MotionDefects`.

    Args:
        parameters, times, task, measured_margin: as for `PlanProgram`.
        with_constraints: whether ``prog`` has (17) as Drake's constraints, which building
            takes most of the time; ``defects`` stand for them anyway.
    """

    has_inertia = True

    def __init__(
        self,
        parameters: LimbParameters | LimbModel,
        times: np.ndarray,
        task: Task | None = None,
        *,
        measured_margin: ArrayLike = 0.0,
        with_constraints: bool = True,
    ):
        self._with_constraints = with_constraints
        super().__init__(parameters, times, task, measured_margin)

    @functools.cached_property
    def limb(self) -> "Limb":
        from limb_systems import Limb  # Drake's multibody takes long to import

        return Limb(self.parameters)

    def _add_variables(self) -> None:
        num_knots = len(self.times)
        n = self.parameters.num_joints
        num_states = 2 * n + len(self.wires.heat_scales)
        shortest, longest = self._shortest_and_longest_step()
        # States, duty and time steps, with or without Drake's constraints.
        self.collocation = None
        if self._with_constraints:
            from pydrake.planning import DirectCollocation  # takes long to import

            self.collocation = collocation = DirectCollocation(
                self.limb,
                self.limb.CreateDefaultContext(),
                num_time_samples=num_knots,
                minimum_time_step=shortest,
                maximum_time_step=longest,
                input_port_index=self.limb.GetInputPort("duty").get_index(),
            )
            self.prog = collocation.prog()
            self._states = np.array([collocation.state(k) for k in range(num_knots)])
            self._duty = np.array([collocation.input(k) for k in range(num_knots)])
            self._time_steps = np.array([collocation.time_step(k)[0] for k in range(num_knots - 1)])
            # Drake's solvers read the scales from the program.
            for variables, scale in zip(self._states.T, self.state_scales, strict=True):
                for variable in variables:
                    self.prog.SetVariableScaling(variable, scale)
        else:
            self.prog = prog = MathematicalProgram()
            self._time_steps = prog.NewContinuousVariables(num_knots - 1, "h")
            prog.AddBoundingBoxConstraint(shortest, longest, self._time_steps)
            W = self.wires.num_wires
            states = prog.NewContinuousVariables(num_knots * num_states, "x")
            duty = prog.NewContinuousVariables(num_knots * W, "u")
            self._states = states.reshape(num_knots, num_states)
            self._duty = duty.reshape(num_knots, W)
        self.states = self.indices(self._states)
        self.motion = self.states[:, : 2 * n]
        # Parts of the states for the rest of the program.
        self._start = self._states[0]
        self._of_knots = self.states
        self._scales = self.state_scales
        self._tracked = self._states[:, :n]
        self._heat = self._states[:, 2 * n :]
        # Each joint has the weight Q; a bend is the mean of its joints (11).
        self._shares = np.ones(n)
        self._to_bends = np.zeros((self._layout.num_bends, n))
        for row, joints, chain in zip(
            self._to_bends, self._layout.bend_joints, self.model.mechanics.chains, strict=True
        ):
            row[joints] = chain.bend_by_equal_angle / len(joints)

    def _targets(self, reference: np.ndarray) -> np.ndarray:
        return joint_angles_from_bend_angle(self.model, reference).T

    def _add_rate_limits(self, limits: np.ndarray) -> None:
        n = self.parameters.num_joints
        # The initial state is given, so its rate cannot be planned.
        limited = np.flatnonzero(np.isfinite(limits[1:])) + 1
        most = limits[limited, None]
        rates = self._states[limited, n : 2 * n]
        add_at_knots(self.prog, self._to_bends, -most, most, rates)

    def _make_blocks(self) -> list[ConstraintBlock]:
        is_free = self.task.stretch is not None
        self.defects = MotionDefects(
            self.model,
            self.states,
            self.duty,
            self.time_steps,
            typical_time_step=float(np.median(np.diff(self.times))),
            replaces=self.prog.generic_constraints(),  # Drake's constraints, if any
            free_duration=is_free,
        )
        self.cheap_blocks = None
        if not is_free:
            self.cheap_blocks = [self.defects.with_curvature_of_heat(), *self._fixed_heat_blocks()]
        return [self.defects, self._heat_block]

    def variables(self, states: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Return all decision variables, from states (2n + M, K) and duty (W, K)."""
        x = np.zeros(self.prog.num_vars())
        x[self.time_steps] = np.diff(self.times)
        x[self.states] = states.T
        x[self.duty] = duty.T
        return x

    def signals(self, x: np.ndarray) -> dict[str, np.ndarray | None]:
        """Return the signals of a `Trajectory`, from all decision variables."""
        angles, rates, states, measured = split_state(self.model, x[self.states].T)
        return {
            "duty": x[self.duty].T,
            "joint_state": np.vstack([angles, rates]),
            **self.wires.signals(states),
            "measured_temperature": measured,
        }


def add_at_knots(
    prog: MathematicalProgram,
    A: np.ndarray,
    lower: ArrayLike,
    upper: ArrayLike,
    variables: np.ndarray,
) -> None:
    """Add lower <= A v_k <= upper at some knots as one constraint.

    Args:
        A: (m, size).
        lower, upper: bounds (knots, m), or arrays that broadcast to this shape.
        variables: v (knots, size).
    """
    shape = len(variables), len(A)
    rows = scipy.sparse.kron(scipy.sparse.identity(shape[0]), A, "csc")
    bounds = [np.broadcast_to(bound, shape).ravel() for bound in (lower, upper)]
    if len(variables):
        prog.AddConstraint(LinearConstraint(rows, *bounds), variables.ravel())


def add_soft_bounds(
    prog: MathematicalProgram,
    variables: np.ndarray,
    lower: np.ndarray | None,
    upper: np.ndarray,
    weight: float,
) -> Binding:
    """Add soft bounds of variables (m,): the cost is a weight times the excess.

    Args:
        lower, upper: the bounds (m,); ``lower`` may be None.

    Returns:
        The binding of the bounds.
    """
    # Add an excess of at least 0 over each upper bound, then one below each lower bound.
    signs = [-1.0] if lower is None else [-1.0, 1.0]
    excess = prog.NewContinuousVariables(len(variables) * len(signs), "excess")
    prog.AddLinearCost(np.full(len(excess), weight), 0.0, excess)
    prog.AddBoundingBoxConstraint(0.0, np.inf, excess)
    # The bounds hold for the variables - upper excess + lower excess.
    A = scipy.sparse.kron([[1.0, *signs]], scipy.sparse.identity(len(variables)), "csc")
    if lower is None:
        lower = np.full(len(variables), -np.inf)
    return prog.AddConstraint(LinearConstraint(A, lower, upper), np.append(variables, excess))


def temperature_weights(parameters: LimbParameters, times: np.ndarray, task: Task) -> np.ndarray:
    """Return the weights of T (K, W) in the task's cost of the segments' means, 1/°C."""
    shares = [1 / len(segment.wires) for segment in parameters.segments for _ in segment.wires]
    return task.temperature_weight * np.outer(task.shares(times), shares)


def reading_bounds(model: LimbModel, margin: ArrayLike = 0.0) -> np.ndarray:
    """Return the upper bounds of the readings V (W,), °C: ``measured_maximum`` less a margin.

    They are infinite where V cannot rise beyond them because T is bounded (19).

    Args:
        margin: °C, a number or one for each wire (W,).
    """
    wires = model.wires
    limits = model.parameters.temperature_limits
    bounds = np.broadcast_to(limits.measured_maximum - np.asarray(margin, float), wires.num_wires)
    hottest = wires.settled_states(np.full(wires.num_wires, limits.maximum))
    return np.where(wires.reading_rates(bounds, hottest) > 0, bounds, np.inf)


def warm_bounds(model: LimbModel, times: np.ndarray, warm_up_time: float) -> np.ndarray:
    """Return the lower bounds (20) of the wire temperatures (K * W,), knot by knot, °C."""
    bounds = np.where(times > warm_up_time, model.parameters.temperature_limits.warm, -np.inf)
    return np.repeat(bounds, model.layout.num_wires)
