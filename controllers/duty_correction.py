"""The correction of a plan's duty for a limb with estimated residuals of its model.

The duty is the plan's plus a correction, linear between nodes. A `ReducedModel`
predicts the limb's motion, and the residuals of the model are added. A convex program
along the linearized prediction finds the correction that brings the limb nearest to the plan's
reference, within the bounds of duty and temperature.
"""

import dataclasses

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from pydrake.trajectories import PiecewisePolynomial

from controllers.plan_controller import limit_total_duty
from controllers.reduced_model import ReducedModel
from limb_systems import Trajectory
from limb_systems.kinematics import bend_angle, joint_angles_from_bend_angle
from limb_systems.low_pass import low_pass
from limb_systems.plan_band import temperature_margin
from planners.transcription.sequential_convex import backtracking_step, descend

TIME_ROUNDING = 1e-9  # s, of knots and nodes at the same time
STEPS_PER_NODE = 2  # of the model, from a node to the next
NODE_SPACING = 0.2  # s, about
READING_MARGIN = 5.0  # °C, of expected readings below the limit at which a board switches off
LEVEL_COST = 0.3  # (1°)², of the correction of a duty
CHANGE_COST = 1.0  # (1°)², of its change between nodes
HUBER_WIDTH = 1.0  # degrees, within which a distance costs its square, and beyond in proportion
EXCESS_COST = 300.0  # (1°)²/°C beyond a temperature bound at a node; more than tracking pays
MAX_TANGENTS = 5
MIN_DUTY_CHANGE = 0.02  # at a node; a duty that differs by less is the correction's
MIN_COST_REDUCTION = 0.01  # relative; a tangent that reduces the cost by less is the last


@dataclasses.dataclass(frozen=True, eq=False)
class Residuals:
    """The residuals of the model at the M + 1 nodes: the limb less the model.

    - ``bend_angle``: residual of φ (M + 1, F), rad.
    - ``wire_temperature``, ``measured_temperature``: residuals of T and V (M + 1, W), °C.
    - ``about``: the correction for which the residuals are estimated (M + 1, W).
    - ``gains``: response of each bend to the duty of each wire, relative to the model (F, W).
    - ``doubt``: random error of `DutyCorrection.bend_changes`, relative to them (F,).
    """

    bend_angle: np.ndarray
    wire_temperature: np.ndarray
    measured_temperature: np.ndarray
    about: np.ndarray
    gains: np.ndarray
    doubt: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class _Prediction:
    """The motion and heat that are expected of a limb under a correction.

    - ``duty``, ``heat``: in the model's steps (L, W) and (L + 1, H).
    - ``missed``: φ_ref - φ (M + 1, F), degrees.
    - ``unsure``: standard deviation of φ by the change of each wire's duty (M + 1, F, W), degrees.
    """

    duty: np.ndarray
    heat: np.ndarray
    missed: np.ndarray
    unsure: np.ndarray


class DutyCorrection:
    """Corrections of the duty of a plan, at M + 1 nodes.

    - ``model``: `ReducedModel` of the limb, whose period divides the time between nodes.
    - ``layout``: the limb's `Layout`.
    - ``nodes``: times of the nodes (M + 1,), s since the start of the plan.
    - ``middles``: times of the middles of the model's steps (L,), s.
    - ``reference``: φ_ref at the nodes (M + 1, F), rad.
    - ``none``: no correction (M + 1, W).
    """

    def __init__(self, trajectory: Trajectory):
        self.plan = plan = trajectory.since_start()
        # Nodes of the correction, and steps of the model between them.
        num_nodes = max(2, round(plan.duration / NODE_SPACING)) + 1
        self.nodes = np.linspace(0.0, plan.duration, num_nodes)
        period = plan.duration / (STEPS_PER_NODE * (num_nodes - 1))
        self.model = ReducedModel(plan.model, period)
        self.layout = plan.model.layout
        self.middles = (np.arange(STEPS_PER_NODE * (num_nodes - 1)) + 0.5) * period
        # Share of each node in the correction of each step (L, M + 1).
        self._shares = np.array(
            [np.interp(self.middles, self.nodes, node) for node in np.eye(num_nodes)]
        ).T
        self.reference = plan.interpolated(plan.reference, self.nodes).T
        self._planned = plan.duty_trajectory().vector_values(self.nodes).T
        self.none = np.zeros_like(self._planned)
        # Bounds of the wires' temperatures.
        limits = plan.parameters.temperature_limits
        warm = self.nodes > limits.warm_up_time
        self._coolest = np.where(warm, limits.warm, -np.inf)
        self._hottest = limits.maximum - temperature_margin(plan.parameters)

    def distance(self, bend: np.ndarray) -> float:
        """Return the mean distance of bends at the nodes (M + 1, F) from the reference, rad."""
        return float(np.nanmean(self.layout.distances((self.reference - bend).T)))

    def duty_trajectory(self, correction: np.ndarray) -> PiecewisePolynomial:
        """Return the corrected duty since the plan's start, in [0, 1] and within the total duty."""
        times = np.union1d(self.plan.time, self.nodes)
        times = times[np.append(True, np.diff(times) > TIME_ROUNDING)]
        duty = self.plan.duty_trajectory().vector_values(times)
        duty = duty + [np.interp(times, self.nodes, column) for column in correction.T]
        duty = limit_total_duty(np.clip(duty, 0.0, 1.0), self.plan.parameters.total_duty)
        return PiecewisePolynomial.FirstOrderHold(times, duty)

    def start(self, readings: np.ndarray | None = None) -> np.ndarray:
        """Return the heat (H,) at the start of the plan, moved to readings (W,), °C, if given."""
        plan = self.plan
        model = self.model
        heat = plan.state[2 * plan.parameters.num_joints :, 0]
        if readings is None:
            return heat
        return heat + model.rested(readings) - model.rested(model.readings(heat))

    def rollout(self, start: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Return the heat at the nodes (M + 1, H) under duty (L, W) of the model's steps."""
        return self.model.rollout(start, duty)[::STEPS_PER_NODE]

    def steps(self, correction: np.ndarray) -> np.ndarray:
        """Return the corrected duty of the model's steps (L, W)."""
        return self.duty_trajectory(correction).vector_values(self.middles).T

    def correction_of(self, duty: np.ndarray, correction: np.ndarray) -> np.ndarray:
        """Return the correction (M + 1, W) that was applied, from the duty of the steps (L, W).

        Args:
            duty: duty of the wires; feedback or a board may have changed it.
            correction: the correction that was sent (M + 1, W).
        """
        shares = self._shares.T
        changed = shares @ (duty - self.steps(correction)) / shares.sum(axis=1, keepdims=True)
        return correction + np.where(np.abs(changed) > MIN_DUTY_CHANGE, changed, 0.0)

    def corrected_plan(
        self, correction: np.ndarray, start: np.ndarray, errors: Residuals
    ) -> Trajectory:
        """Return the plan with corrected duty, and the motion that is expected of the limb."""
        plan = self.plan
        knots = plan.time
        # The joint angles make the expected bend (11).
        predicted = self._predict(correction, start, errors)
        heat = predicted.heat[::STEPS_PER_NODE]
        angles = self.model.joint_angles(heat).T
        expected = self.reference.T - np.deg2rad(predicted.missed.T)
        residual = expected - bend_angle(plan.parameters, angles)
        angles += joint_angles_from_bend_angle(plan.parameters, residual)
        motion = PiecewisePolynomial.CubicShapePreserving(self.nodes, angles, True)
        rates = motion.derivative()
        # The heat has its residuals, too.
        W = self.model.num_wires

        def at_knots(values: np.ndarray) -> np.ndarray:
            return np.array([np.interp(knots, self.nodes, row) for row in values.T])

        others = at_knots(heat[:, W:-W])
        check = dataclasses.replace(plan.check, status="learned", active_constraints=[], added=[])
        return dataclasses.replace(
            plan,
            duty=self.duty_trajectory(correction).vector_values(knots),
            joint_state=np.vstack([motion.vector_values(knots), rates.vector_values(knots)]),
            wire_temperature=at_knots(self.model.temperatures(heat) + errors.wire_temperature),
            measured_temperature=at_knots(self.model.readings(heat) + errors.measured_temperature),
            other_wire_state=others if len(others) else None,
            check=check,
        )

    def lag(self) -> np.ndarray:
        """Return the matrices from errors of T to errors of V at the nodes (W, M + 1, M + 1)."""
        W = self.model.num_wires
        _, by_heat, _ = self.model.linearized_step(self.model.cold, np.zeros(W))
        lags = []
        for row, wire in zip(by_heat[-W:], range(W), strict=True):
            lagged = low_pass(self._shares, row[wire - W], row[wire], axis=0)
            lags.append(np.pad(lagged, ((1, 0), (0, 0)))[::STEPS_PER_NODE])
        return np.array(lags)

    def improve(
        self, correction: np.ndarray, start: np.ndarray, errors: Residuals, cooler: float = 0.0
    ) -> np.ndarray:
        """Return a correction of the duty with a lower cost, or the given one if there is none.

        Args:
            correction: duty to add at the nodes (M + 1, W).
            start: state of the wires at the start (H,).
            errors: residuals of the model.
            cooler: margin of temperature below the bounds, °C.
        """

        def cost_of(candidate: np.ndarray) -> float:
            return self._cost(candidate, self._predict(candidate, start, errors), errors, cooler)

        def solve(candidate: np.ndarray) -> np.ndarray | None:
            predicted = self._predict(candidate, start, errors)
            return self._solve_program(candidate, predicted, errors, cooler)

        # Solve linearized programs, and step towards their solutions while the cost falls.
        step = backtracking_step((1.0, 0.5, 0.25, 0.1), cost_of)
        return descend(
            correction, cost_of(correction), solve, step, MAX_TANGENTS, MIN_COST_REDUCTION
        )[0]

    def expected_bend(
        self, correction: np.ndarray, start: np.ndarray, errors: Residuals
    ) -> np.ndarray:
        """Return φ of the limb at the nodes (M + 1, F), rad, under a correction."""
        return self.reference - np.deg2rad(self._predict(correction, start, errors).missed)

    def _predict(self, correction: np.ndarray, start: np.ndarray, errors: Residuals) -> _Prediction:
        duty = self.steps(correction)
        heat, bend_changes = self._change_wires_in_turn(start, self.steps(errors.about), duty)
        bend = self.model.bend_angle(heat[::STEPS_PER_NODE]) + errors.bend_angle
        bend = bend + ((errors.gains - 1) * bend_changes).sum(axis=-1)
        unsure = errors.doubt[:, np.newaxis] * errors.gains * bend_changes
        return _Prediction(duty, heat, np.rad2deg(self.reference - bend), np.rad2deg(unsure))

    def bend_changes(self, start: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Return the changes of the model's φ, rad, by a change of the duty of each wire alone.

        Args:
            start: heat at the start (H,).
            before, after: duty of the model's steps (L, W) and (L, ..., W).

        Returns:
            (M + 1, ..., F, W).
        """
        return self._change_wires_in_turn(start, before, after)[1]

    def _change_wires_in_turn(
        self, start: np.ndarray, before: np.ndarray, after: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the heat (L + 1, ..., H) under the duty ``after``, and the `bend_changes`.

        Arguments are as for `bend_changes`.
        """
        W = before.shape[1]
        before = np.broadcast_to(before.reshape(-1, *[1] * (after.ndim - 2), W), after.shape)
        # Simulate W + 2 duties at once: each wire alone changed (W), none, and all.
        none_changed = before[..., np.newaxis, :]
        all_changed = after[..., np.newaxis, :]
        one_changed = np.where(np.eye(W, dtype=bool), all_changed, none_changed)
        duty = np.concatenate([one_changed, none_changed, all_changed], axis=-2)
        heat = self.model.rollout(np.broadcast_to(start, (*duty.shape[1:-1], len(start))), duty)
        bend = self.model.bend_angle(heat[::STEPS_PER_NODE, ..., :-1, :])  # (M + 1, ..., W + 1, F)
        bend_changes = bend[..., :W, :] - bend[..., W : W + 1, :]
        return heat[..., -1, :], np.swapaxes(bend_changes, -1, -2)

    def _bounds(self, errors: Residuals, cooler: float) -> tuple[np.ndarray, ...]:
        """Return the bounds at the nodes (M + 1, W): of T below and above, and of V above, °C."""
        limits = self.plan.parameters.temperature_limits
        highest = limits.measured_maximum - READING_MARGIN - cooler
        hottest = self._hottest - cooler - errors.wire_temperature
        coolest = self._coolest[:, np.newaxis] - errors.wire_temperature
        return np.minimum(coolest, hottest), hottest, highest - errors.measured_temperature

    def _expected_squares(self, predicted: _Prediction) -> np.ndarray:
        """Return the expected squares of the distances from the reference (S, M + 1), degrees²."""
        parts = np.dstack([predicted.missed, *np.moveaxis(predicted.unsure, -1, 0)])
        return (self.layout.distances(np.swapaxes(parts, 0, 1)) ** 2).sum(axis=-1)

    def _cost(self, correction, predicted: _Prediction, errors: Residuals, cooler: float) -> float:
        heat = predicted.heat[::STEPS_PER_NODE]
        coolest, hottest, highest = self._bounds(errors, cooler)
        T = self.model.temperatures(heat)
        V = self.model.readings(heat)
        excess = np.maximum(0.0, np.maximum.reduce([T - hottest, coolest - T, V - highest]))
        far = np.sqrt(HUBER_WIDTH**2 + self._expected_squares(predicted)) - HUBER_WIDTH
        return float(
            2 * HUBER_WIDTH * far.sum()
            + LEVEL_COST * (correction**2).sum()
            + CHANGE_COST * (np.diff(correction, axis=0) ** 2).sum()
            + EXCESS_COST * excess[1:].sum()
        )

    def _solve_program(
        self, correction, predicted: _Prediction, errors: Residuals, cooler: float
    ) -> np.ndarray | None:
        """Return the best correction for the model linearized along the rollout of this one."""
        model = self.model
        num_steps = len(self.middles)
        num_intervals = len(self.nodes) - 1
        num_wires = model.num_wires
        prog = MathematicalProgram()
        x = prog.NewContinuousVariables(num_steps + 1, model.size, "x")  # change of heat by scale
        c = prog.NewContinuousVariables(num_intervals + 1, num_wires, "c")
        excess = prog.NewContinuousVariables(num_intervals, num_wires, "s")
        _, by_heat, by_duty = model.linearized_step(predicted.heat[:-1], predicted.duty)
        self._add_correction(prog, c, correction)

        # The heat follows from step to step; the correction is linear between two nodes.
        prog.AddBoundingBoxConstraint(0.0, 0.0, x[0])
        A = by_heat * model.scales / model.scales[:, None]
        B = by_duty / model.scales[:, None]
        for step in range(num_steps):
            node = step // STEPS_PER_NODE
            ends = slice(node, node + 2)
            by_ends = np.hstack([share * B[step] for share in self._shares[step, ends]])
            prog.AddLinearEqualityConstraint(
                np.hstack([A[step], by_ends, -np.eye(model.size)]),
                by_ends @ correction[ends].ravel(),
                np.concatenate([x[step], c[ends].ravel(), x[step + 1]]),
            )

        # Distances from the reference, and their deviations by each wire, at the nodes.
        # A state changes with the duty of one wire, or with all wires that heat it, in equal parts.
        at_nodes = x[::STEPS_PER_NODE][1:]
        heat = predicted.heat[::STEPS_PER_NODE][1:]
        heated_by = (np.abs(by_heat[1:] @ by_duty[:-1]).max(axis=0) > 0).astype(float)  # (H, W)
        heated_by /= np.maximum(heated_by.sum(axis=1, keepdims=True), 1.0)
        slopes = np.rad2deg(model.bend_slopes(heat)[1]) * model.scales
        of_wires = slopes[:, :, np.newaxis] * errors.gains[..., np.newaxis] * heated_by.T
        doubted = errors.doubt[:, np.newaxis, np.newaxis] * of_wires  # (M, F, W, H)
        doubted = doubted.reshape(num_intervals, -1, model.size)
        rows = np.concatenate([of_wires.sum(axis=2), doubted], axis=1)
        unsure = predicted.unsure[1:].reshape(num_intervals, -1)
        targets = np.hstack([predicted.missed[1:], -unsure])

        # Weights of squares whose cost touches the cost of the distances from above, here.
        squares = self._expected_squares(predicted)[:, 1:].T
        weights = 1 / np.sqrt(1 + squares / HUBER_WIDTH**2)  # (M, S)
        weights = weights[:, self.layout.bend_segment]
        weights = np.hstack([weights, np.repeat(weights, num_wires, axis=1)])
        for k in range(num_intervals):
            towards = 2 * rows[k].T * weights[k]
            prog.AddQuadraticCost(
                towards @ rows[k], -towards @ targets[k], at_nodes[k], is_convex=True
            )

        # Bounds of T and V, which may be passed at a cost.
        of_T = np.diag(model.scales)[:num_wires]
        of_V = np.diag(model.scales)[-num_wires:]
        bounded = np.hstack([np.vstack([of_T, of_V, -of_T]), -np.tile(np.eye(num_wires), (3, 1))])
        coolest, hottest, highest = (bound[1:] for bound in self._bounds(errors, cooler))
        T = model.temperatures(heat)
        most = np.hstack([hottest - T, highest - model.readings(heat), T - coolest])
        prog.AddBoundingBoxConstraint(0.0, np.inf, excess)
        prog.AddLinearCost(np.full(excess.size, EXCESS_COST), 0.0, excess.ravel())
        for k in range(num_intervals):
            variables = np.append(at_nodes[k], excess[k])
            prog.AddLinearConstraint(bounded, np.full(len(bounded), -np.inf), most[k], variables)

        result = ClarabelSolver().Solve(prog)
        # Drake returns a vector for the matrix of one wire.
        return result.GetSolution(c).reshape(c.shape) if result.is_success() else None

    def _add_correction(self, prog: MathematicalProgram, c: np.ndarray, correction) -> None:
        """Add the bounds and the costs of a correction c (M + 1, W), and of its changes."""
        num_wires = self.model.num_wires
        lowest = np.minimum(-self._planned, correction)
        largest = np.maximum(1.0 - self._planned, correction)
        prog.AddBoundingBoxConstraint(lowest, largest, c)
        room = self.plan.parameters.total_duty - self._planned.sum(axis=1)
        one = np.eye(num_wires)
        for k, node in enumerate(c):
            prog.AddLinearConstraint(np.ones((1, num_wires)), [-np.inf], room[k : k + 1], node)
            prog.AddQuadraticCost(2 * LEVEL_COST * one, np.zeros(num_wires), node, is_convex=True)
        change = 2 * CHANGE_COST * np.block([[one, -one], [-one, one]])
        for pair in np.hstack([c[:-1], c[1:]]):
            prog.AddQuadraticCost(change, np.zeros(2 * num_wires), pair, is_convex=True)
