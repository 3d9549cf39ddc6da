"""The correction of a plan's duty for a limb whose errors are known.

The duty is the plan's plus a correction, linear between nodes. A `ReducedModel`
predicts the limb's motion, and the known residuals of the model are added. A convex program
along the linearized prediction finds the correction that brings the limb nearest to the plan's
reference, within the bounds of duty and temperature.
"""

import dataclasses

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram
from pydrake.trajectories import PiecewisePolynomial

from controllers.plan_controller import within_total
from controllers.reduced_model import ReducedModel
from limb_systems import Trajectory
from limb_systems.kinematics import bend_angle, joint_angles_from_bend_angle
from limb_systems.low_pass import low_pass
from limb_systems.plan_band import temperature_margin
from planners.transcription.sequential_convex import descend, first_that_reduces

ROUNDING = 1e-9  # s, of knots and nodes at the same time
STEPS = 2  # of the model, from a node to the next
NODES_APART = 0.2  # s, about
READING_MARGIN = 5.0  # °C, of what is expected below the reading at which a board switches off
LEVEL_COST, CHANGE_COST = 0.3, 1.0  # of a duty, and of its change between nodes: (1°)²
NEAR = 1.0  # degrees, within which a distance costs its square, and beyond in proportion
EXCESS_COST = 300.0  # (1°)²/°C beyond a temperature bound at a node; more than tracking pays
TANGENTS = 5  # at most
ANOTHER_DUTY = 0.02  # at a node, by which a duty is not that of a correction
LITTLE = 0.01  # relative; a tangent that reduces the cost by less is the last


@dataclasses.dataclass(frozen=True, eq=False)
class Errors:
    """The residuals of the model at the M + 1 nodes: what a limb does beyond it.

    - ``bend_angle``: residual of φ (M + 1, F), rad.
    - ``wire_temperature``, ``measured_temperature``: residuals of T and V (M + 1, W), °C.
    - ``about``: the correction under which the residuals are known (M + 1, W).
    - ``gains``: changes of each bend over those of the model, as the duty of each wire changes from
      there (F, W).
    - ``doubt``: share of `DutyCorrection.changes` that is wrong at random (F,).
    """

    bend_angle: np.ndarray
    wire_temperature: np.ndarray
    measured_temperature: np.ndarray
    about: np.ndarray
    gains: np.ndarray
    doubt: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class _Prediction:
    """What a limb is expected to do under a correction.

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
        num_nodes = max(2, round(plan.duration / NODES_APART)) + 1
        self.nodes = np.linspace(0.0, plan.duration, num_nodes)
        period = plan.duration / (STEPS * (num_nodes - 1))
        self.model = ReducedModel(plan.model, period)
        self.layout = plan.model.layout
        self.middles = (np.arange(STEPS * (num_nodes - 1)) + 0.5) * period
        # Share of each node in the correction of each step (L, M + 1).
        self._shares = np.array(
            [np.interp(self.middles, self.nodes, o) for o in np.eye(num_nodes)]
        ).T
        self.reference = np.array([np.interp(self.nodes, plan.time, r) for r in plan.reference]).T
        self._planned = plan.duty_trajectory().vector_values(self.nodes).T
        self.none = np.zeros_like(self._planned)
        limits = plan.parameters.temperature_limits
        warm = self.nodes > limits.warm_up_time
        self._coolest = np.where(warm, limits.warm, -np.inf)
        self._hottest = limits.maximum - temperature_margin(plan.parameters)

    def distance(self, bend: np.ndarray) -> float:
        """Mean distance of bends at the nodes (M + 1, F) from the reference, rad; without NaN."""
        return float(np.nanmean(self.layout.distances((self.reference - bend).T)))

    def duty_trajectory(self, correction: np.ndarray) -> PiecewisePolynomial:
        """Return the corrected duty since the plan's start, in [0, 1] and within the total duty."""
        times = np.union1d(self.plan.time, self.nodes)
        times = times[np.append(True, np.diff(times) > ROUNDING)]
        duty = self.plan.duty_trajectory().vector_values(times)
        duty = duty + [np.interp(times, self.nodes, column) for column in correction.T]
        duty = within_total(np.clip(duty, 0.0, 1.0), self.plan.parameters.total_duty)
        return PiecewisePolynomial.FirstOrderHold(times, duty)

    def start(self, readings: np.ndarray | None = None) -> np.ndarray:
        """Return the heat (H,) at the start of the plan, or with other readings (W,), °C."""
        plan, model = self.plan, self.model
        heat = plan.state[2 * plan.parameters.num_joints :, 0]
        if readings is None:
            return heat
        return heat + model.rested(readings) - model.rested(model.readings(heat))

    def rollout(self, start: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Heat at the nodes (M + 1, H) under duty (L, W) of the model's steps."""
        return self.model.rollout(start, duty)[::STEPS]

    def steps(self, correction: np.ndarray) -> np.ndarray:
        """The corrected duty of the model's steps (L, W)."""
        return self.duty_trajectory(correction).vector_values(self.middles).T

    def correction_of(self, duty: np.ndarray, correction: np.ndarray) -> np.ndarray:
        """Return the correction (M + 1, W) that was applied, from the duty of the steps (L, W).

        Args:
            duty: duty that the wires got; feedback or a board may have changed it.
            correction: the correction that was asked for (M + 1, W).
        """
        shares = self._shares.T
        changed = shares @ (duty - self.steps(correction)) / shares.sum(axis=1, keepdims=True)
        return correction + np.where(np.abs(changed) > ANOTHER_DUTY, changed, 0.0)

    def corrected(self, correction: np.ndarray, start: np.ndarray, errors: Errors) -> Trajectory:
        """Return the plan with corrected duty, and the motion that is expected of the limb."""
        plan, predicted = self.plan, self._predict(correction, start, errors)
        heat = predicted.heat[::STEPS]
        angles = self.model.joint_angles(heat).T
        missed = (
            self.reference.T - np.deg2rad(predicted.missed.T) - bend_angle(plan.parameters, angles)
        )
        angles += joint_angles_from_bend_angle(plan.parameters, missed)  # (11)
        at_knots = PiecewisePolynomial.CubicShapePreserving(self.nodes, angles, True)
        rates = at_knots.derivative()
        knots = plan.time
        T, V = self.model.temperatures(heat), self.model.readings(heat)
        states = [
            np.array([np.interp(knots, self.nodes, row) for row in rows.T])
            for rows in (
                T + errors.wire_temperature,
                V + errors.measured_temperature,
                heat[:, T.shape[1] : -T.shape[1]],
            )
        ]
        return dataclasses.replace(
            plan,
            duty=self.duty_trajectory(correction).vector_values(knots),
            joint_state=np.vstack([at_knots.vector_values(knots), rates.vector_values(knots)]),
            wire_temperature=states[0],
            measured_temperature=states[1],
            other_wire_state=states[2] if len(states[2]) else None,
            check=dataclasses.replace(
                plan.check, status="learned", active_constraints=[], added=[]
            ),
        )

    def lag(self) -> np.ndarray:
        """Matrix from errors of T at the nodes to errors of V there (W, M + 1, M + 1)."""
        W = self.model.num_wires
        _, by_heat, _ = self.model.linearized_step(self.model.cold, np.zeros(W))
        lags = []
        for row, wire in zip(by_heat[-W:], range(W), strict=True):
            shown = low_pass(self._shares, row[wire - W], row[wire], axis=0)
            lags.append(np.pad(shown, ((1, 0), (0, 0)))[::STEPS])
        return np.array(lags)

    def improve(
        self, correction: np.ndarray, start: np.ndarray, errors: Errors, cooler: float = 0.0
    ) -> np.ndarray:
        """Return a correction (M + 1, W) of less cost, or the given one if none is found.

        Args:
            start: heat at the start (H,).
            errors: residuals of the model.
            cooler: margin of temperature below the bounds, °C.
        """

        def cost_of(tried: np.ndarray) -> float:
            return self._cost(tried, self._predict(tried, start, errors), errors, cooler)

        def solve(tried: np.ndarray) -> np.ndarray | None:
            return self._solve(tried, self._predict(tried, start, errors), errors, cooler)

        step = first_that_reduces((1.0, 0.5, 0.25, 0.1), cost_of)
        return descend(correction, cost_of(correction), solve, step, TANGENTS, LITTLE)[0]

    def expected_bend(
        self, correction: np.ndarray, start: np.ndarray, errors: Errors
    ) -> np.ndarray:
        """φ of the limb at the nodes (M + 1, F), rad, under a correction."""
        return self.reference - np.deg2rad(self._predict(correction, start, errors).missed)

    def _predict(self, correction: np.ndarray, start: np.ndarray, errors: Errors) -> "_Prediction":
        duty = self.steps(correction)
        heat, changes = self._one_by_one(start, self.steps(errors.about), duty)
        bend = self.model.bend_angle(heat[::STEPS]) + errors.bend_angle
        bend = bend + ((errors.gains - 1) * changes).sum(axis=-1)
        unsure = errors.doubt[:, np.newaxis] * errors.gains * changes
        return _Prediction(duty, heat, np.rad2deg(self.reference - bend), np.rad2deg(unsure))

    def changes(self, start: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Changes of the model's φ as the duty of one wire after the other changes, rad.

        Args:
            start: heat at the start (H,).
            before, after: duty of the model's steps (L, W) and (L, ..., W).

        Returns:
            (M + 1, ..., F, W).
        """
        return self._one_by_one(start, before, after)[1]

    def _one_by_one(
        self, start: np.ndarray, before: np.ndarray, after: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Heat under the duty after, at the model's steps (L + 1, ..., H), and `changes`."""
        W = before.shape[1]
        before = np.broadcast_to(before.reshape(-1, *[1] * (after.ndim - 2), W), after.shape)
        one = np.eye(W, dtype=bool)
        some = np.where(one, after[..., np.newaxis, :], before[..., np.newaxis, :])
        duty = np.concatenate([some, before[..., np.newaxis, :], after[..., np.newaxis, :]], -2)
        heat = self.model.rollout(np.broadcast_to(start, (*duty.shape[1:-1], len(start))), duty)
        bend = self.model.bend_angle(heat[::STEPS, ..., :-1, :])  # (M + 1, ..., W + 1, F)
        changes = bend[..., :W, :] - bend[..., W:, :]
        return heat[..., -1, :], np.swapaxes(changes, -1, -2)

    def _bounds(self, errors: Errors, cooler: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bounds of the model's T, from below and above, and of its V, at the nodes (M + 1, W)."""
        limits = self.plan.parameters.temperature_limits
        highest = limits.measured_maximum - READING_MARGIN - cooler
        hottest = self._hottest - cooler - errors.wire_temperature
        coolest = self._coolest[:, np.newaxis] - errors.wire_temperature
        return np.minimum(coolest, hottest), hottest, highest - errors.measured_temperature

    def _squares(self, predicted: "_Prediction") -> np.ndarray:
        """Expected squares of the distances from the reference (S, M + 1), degrees squared."""
        parts = np.dstack([predicted.missed, *np.moveaxis(predicted.unsure, -1, 0)])
        return (self.layout.distances(np.swapaxes(parts, 0, 1)) ** 2).sum(axis=-1)

    def _cost(self, correction, predicted: "_Prediction", errors: Errors, cooler: float) -> float:
        heat = predicted.heat[::STEPS]
        coolest, hottest, highest = self._bounds(errors, cooler)
        T, V = self.model.temperatures(heat), self.model.readings(heat)
        excess = np.maximum(0.0, np.maximum.reduce([T - hottest, coolest - T, V - highest]))
        far = np.sqrt(NEAR**2 + self._squares(predicted)) - NEAR
        return float(
            2 * NEAR * far.sum()
            + LEVEL_COST * (correction**2).sum()
            + CHANGE_COST * (np.diff(correction, axis=0) ** 2).sum()
            + EXCESS_COST * excess[1:].sum()
        )

    def _solve(
        self, correction, predicted: "_Prediction", errors: Errors, cooler: float
    ) -> np.ndarray | None:
        """Return the best correction for the model linearized along the rollout of this one."""
        model, missed, unsure = self.model, predicted.missed, predicted.unsure
        L, M, H, W = len(self.middles), len(missed) - 1, model.size, model.num_wires
        _, by_heat, by_duty = model.linearized_step(predicted.heat[:-1], predicted.duty)
        prog = MathematicalProgram()
        x = prog.NewContinuousVariables(L + 1, H, "x")  # change of heat by scale, at the steps
        c = prog.NewContinuousVariables(M + 1, W, "c")
        excess = prog.NewContinuousVariables(M, W, "s")
        lowest = np.minimum(-self._planned, correction)
        largest = np.maximum(1.0 - self._planned, correction)
        prog.AddBoundingBoxConstraint(lowest, largest, c)
        room = self.plan.parameters.total_duty - self._planned.sum(axis=1)
        one = np.eye(W)
        for k in range(M + 1):
            prog.AddLinearConstraint(np.ones((1, W)), [-np.inf], room[k : k + 1], c[k])
            prog.AddQuadraticCost(2 * LEVEL_COST * one, np.zeros(W), c[k], is_convex=True)
        change = 2 * CHANGE_COST * np.block([[one, -one], [-one, one]])
        for pair in np.hstack([c[:-1], c[1:]]):
            prog.AddQuadraticCost(change, np.zeros(2 * W), pair, is_convex=True)

        scales, nothing = model.scales, np.zeros(H)
        prog.AddBoundingBoxConstraint(nothing, nothing, x[0])
        A, B = by_heat * scales / scales[:, None], by_duty / scales[:, None]
        for step in range(L):
            k = step // STEPS
            ends = slice(k, k + 2)  # nodes between which the correction is linear
            by_ends = np.hstack([share * B[step] for share in self._shares[step, ends]])
            prog.AddLinearEqualityConstraint(
                np.hstack([A[step], by_ends, -np.eye(H)]),
                by_ends @ correction[ends].ravel(),
                np.concatenate([x[step], c[ends].ravel(), x[step + 1]]),
            )

        heat, x = predicted.heat[::STEPS][1:], x[::STEPS][1:]
        # Shares of wires in the changes of a state: of one wire, or of all whose duty changes it.
        heated_by = (np.abs(by_heat[1:] @ by_duty[:-1]).max(axis=0) > 0).astype(float)  # (H, W)
        heated_by /= np.maximum(heated_by.sum(axis=1, keepdims=True), 1.0)
        slopes = np.rad2deg(model.bend_slopes(heat)[1]) * scales
        of_wires = slopes[:, :, np.newaxis] * errors.gains[..., np.newaxis] * heated_by.T
        doubted = errors.doubt[:, np.newaxis, np.newaxis] * of_wires  # (M, F, W, H)
        rows = np.concatenate([of_wires.sum(axis=2), doubted.reshape(M, -1, H)], axis=1)
        wanted = np.hstack([missed[1:], -unsure[1:].reshape(M, -1)])
        # The squares whose cost touches that of the distances from above, where they are now.
        weights = 1 / np.sqrt(1 + self._squares(predicted)[:, 1:].T / NEAR**2)  # (M, S)
        weights = weights[:, self.layout.bend_segment]
        weights = np.hstack([weights, np.repeat(weights, W, axis=1)])
        of_T, of_V = np.diag(scales)[:W], np.diag(scales)[-W:]
        bounded = np.hstack([np.vstack([of_T, of_V, -of_T]), -np.tile(one, (3, 1))])
        coolest, hottest, highest = (bound[1:] for bound in self._bounds(errors, cooler))
        T, V = model.temperatures(heat), model.readings(heat)
        most = np.hstack([hottest - T, highest - V, T - coolest])
        prog.AddBoundingBoxConstraint(0.0, np.inf, excess)
        prog.AddLinearCost(np.full(excess.size, EXCESS_COST), 0.0, excess.ravel())
        for k in range(M):
            towards = 2 * rows[k].T * weights[k]
            quadratic, linear = towards @ rows[k], -towards @ wanted[k]
            prog.AddQuadraticCost(quadratic, linear, x[k], is_convex=True)
            variables = np.append(x[k], excess[k])
            prog.AddLinearConstraint(bounded, np.full(len(bounded), -np.inf), most[k], variables)
        result = ClarabelSolver().Solve(prog)
        # Drake returns a vector for the matrix of one wire.
        return result.GetSolution(c).reshape(c.shape) if result.is_success() else None
