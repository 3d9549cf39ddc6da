"""Open-loop simulation of a segment that bends in space, mounted in several ways under gravity.

Two torques act on all links alike: those that its wires make towards E2 and towards E3. The
bend that they hold is a smooth function of both. It is solved exactly, links, gravity and all, at
points on rings, and a polynomial through these is evaluated between them.
"""

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence

import casadi as ca
import numpy as np
from numpy.polynomial.chebyshev import chebvander

from limb_systems import LimbModel, LimbParameters, SegmentParameters
from limb_systems.bend_sensor import roll_bends
from limb_systems.monte_carlo import OpenLoop
from limb_systems.rubber import NonlinearRubber
from limb_systems.smooth_function import SmoothFunction
from limb_systems.symbolic_chain import Chain

DEGREE = 8  # of the polynomial, which is within 0.03° of equilibria in all plans
MAX_HELD_BEND = np.deg2rad(78.0)  # bend that both torques hold, at most; no tip tangent shows 90°
# of Newton's method, whose step after such a one is 1e-12, and rad
MAX_NEWTON_STEPS = 12
STEP_TOLERANCE = 1e-6


def _disc() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points in a unit disc, and how a polynomial follows from its values there.

    Returns:
        The points (P, 2), True for each term that the polynomial has (D + 1, D + 1), with D for
        `DEGREE`, and the coefficients of these N terms by the values at the points (N, P).
    """
    rings = np.cos(np.pi / (DEGREE + 2) * (np.arange(DEGREE // 2 + 1) + 0.5))
    turns = np.exp(2j * np.pi * np.arange(2 * DEGREE + 2) / (2 * DEGREE + 2))
    points = np.multiply.outer(rings, turns).ravel()
    points = np.stack([points.real, points.imag], axis=-1)
    terms = np.add.outer(*2 * [np.arange(DEGREE + 1)]) <= DEGREE
    series = chebvander(points, DEGREE)
    series = series[:, 0, :, None] * series[:, 1, None]
    return points, terms, np.linalg.pinv(series[:, terms])


class OpenLoopInSpace(OpenLoop):
    """`OpenLoop` of a segment of two axes, whose bends (S, 2, B) are as its sensor reads.

    Its `simulate` takes as ``rubber`` of each set: ``stiffness``, ``stiffness_ratio``,
    ``rest_angle``, ``rest_angle_e3``, the sensor's ``roll`` (B,), ``angle``, of each wire (B, W),
    all in SI, and optionally ``stiffening``, and ``shift`` and ``rate`` of the rest angle's memory
    (B,). Torques are those at straight links.

    Args:
        duty, step, segment, lengths: as for `OpenLoop`.
        loads: gravity in the base's frame, m/s², and payload, kg, of each run (R, 4).
    """

    def __init__(
        self,
        duty: np.ndarray,
        step: float,
        segment: SegmentParameters,
        loads: Sequence[np.ndarray],
        lengths: Sequence[int] | None = None,
    ):
        super().__init__(duty, step, segment, lengths)
        # A straight segment with k = 1 has the balance of all sets, scaled.
        unit = copy.deepcopy(segment)
        unit.stiffness = unit.stiffening = unit.stiffness_ratio = 1.0
        unit.rest_angle = unit.rest_angle_e3 = 0.0
        unit.rest_memory = None
        self._mechanics = LimbModel.of(LimbParameters(segments=[unit])).mechanics
        self._sensor = segment.bend_sensor
        self._disc = _disc()
        # Runs with the same gravity and payload share a balance.
        kinds, self._mounting = np.unique(np.round(loads, 9), axis=0, return_inverse=True)
        self._balances = [_balance(unit, gravity, payload) for *gravity, payload in kinds.tolist()]

    def _bends(
        self,
        torques: np.ndarray,
        rubber: Mapping[str, np.ndarray],
        torques_at_theta: Callable[[np.ndarray], np.ndarray] | None,
    ) -> np.ndarray:
        """Return the bends (S, 2, B), rad, under torques of the wires on straight links."""
        # Add the wires' torques, over k, towards E2 and E3.
        levers = np.stack([np.cos(rubber["angle"]), np.sin(rubber["angle"])]).T  # (W, B, 2)
        pulls = np.einsum("swb,wbf->bsf", torques, levers)
        pulls /= rubber["stiffness"][:, None, None]
        if "shift" in rubber:
            # The bend that each wire would hold alone.
            springs = rubber["stiffness"][:, None] * _springs(rubber)
            by_torque = np.linalg.norm(levers / springs, axis=-1)
            by_torque *= self._chain.bend_by_equal_angle
            shifts = self._rest_shifts(by_torque * torques, levers.swapaxes(1, 2), rubber)
            shifts = shifts.transpose(2, 0, 1) / self._chain.bend_by_equal_angle
            pulls += _springs(rubber)[:, None] * shifts
        # Find the bends in each mounting, and turn them as the sensor is rolled.
        bends = np.empty_like(pulls)
        mountings = self._mounting[self.rows.sequence]
        for number, balance in enumerate(self._balances):
            is_mounted = mountings == number
            bends[:, is_mounted] = self._interpolated(balance, pulls[:, is_mounted], rubber)
        return roll_bends(bends.transpose(2, 1, 0), rubber["roll"]).swapaxes(0, 1)

    def _interpolated(
        self, balance: SmoothFunction, pulls: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Return the bends (B, S, 2), rad, by torques over k towards E2 and E3 (B, S, 2)."""
        # Solve equilibria at points in the disc of torques that occur.
        sizes = np.linalg.norm(pulls, axis=-1, keepdims=True)
        max_pulls = (
            np.minimum(sizes.max(axis=(1, 2)), MAX_HELD_BEND * self._mechanics.shape.max()) + 1e-9
        )
        ranges = max_pulls[:, None, None]
        points, terms, weights = self._disc
        held_bends = self.held(balance, ranges * points, rubber)
        # Evaluate the polynomial through these points at all torques.
        coefficients = np.zeros((len(pulls), 2, *terms.shape))
        coefficients[:, :, terms] = (weights @ held_bends).swapaxes(1, 2)
        scaled_pulls = (pulls / np.maximum(sizes, ranges))[:, None]
        series = chebvander(scaled_pulls, DEGREE)
        bends = ((series[..., 0, :] @ coefficients) * series[..., 1, :]).sum(axis=-1)
        return bends.swapaxes(1, 2)

    def held(
        self, balance: SmoothFunction, pulls: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Return exact bends (B, P, 2), rad, for `_interpolated`; nan without an equilibrium."""
        mechanics = self._mechanics
        towards = (mechanics.shape > 0).astype(float)  # joints by bends (n, 2)
        # Set springs, rest angles and forces of all joints.
        k = rubber["stiffness"]
        ratio = _springs(rubber)
        # A twist joint keeps its own share of k.
        springs = ratio @ towards.T + mechanics.stiffness * (1 - towards.sum(axis=-1))
        rest_bends = np.stack([rubber["rest_angle"], rubber["rest_angle_e3"]], axis=-1)
        rest = rest_bends @ mechanics.shape.T
        stiffening = np.broadcast_to(rubber.get("stiffening", 0.0), k.shape)
        set_inputs = np.column_stack([springs, rest, k, stiffening])
        force = pulls @ towards.T
        balance_inputs = np.concatenate(
            [force, np.repeat(set_inputs[:, None], force.shape[1], axis=1)], axis=-1
        )
        angles = rest[:, None] + force / springs[:, None]
        # Solve for the joint angles by Newton's method, with limited steps.
        for _ in range(MAX_NEWTON_STEPS):
            residual, slopes = balance.first(angles, balance_inputs)
            step = -np.linalg.solve(slopes, residual[..., None])[..., 0]
            angles = angles + np.clip(step, -0.5, 0.5)
            if np.abs(step).max() < STEP_TOLERANCE:
                break
        angles = np.where(np.abs(step).max(axis=-1, keepdims=True) < STEP_TOLERANCE, angles, np.nan)
        read_bends = self._sensor.exact_bends(mechanics.chains[0], np.moveaxis(angles, -1, 0))
        return np.moveaxis(read_bends, 0, -1)


def _springs(rubber: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the bending stiffness towards E2 and E3, over that towards E2 (B, 2)."""
    ratio = rubber["stiffness_ratio"]
    return np.stack([np.ones_like(ratio), ratio], axis=-1)


def _balance(unit: SegmentParameters, gravity: Sequence[float], payload: float) -> SmoothFunction:
    """Return the torques on the joints over k (n,) of θ, which are zero at rest.

    Its parameters are the wires' force over k (n,), the springs over k (n,), their rest angles
    (n,), k and the stiffening.
    """
    limb = LimbParameters(segments=[dataclasses.replace(unit, stiffening=1.0)], payload=payload)
    mechanics = LimbModel.of(limb).mechanics
    n = mechanics.layout.num_joints
    q = ca.SX.sym("q", n)
    force = ca.SX.sym("f", n)
    springs = ca.SX.sym("K", n)
    rest = ca.SX.sym("r", n)
    k = ca.SX.sym("k")
    stiffening = ca.SX.sym("s")
    still = ca.SX(n, 1)
    weight = Chain(mechanics, q).inverse_dynamics(still, still, ca.DM(gravity)) / k
    cubic = NonlinearRubber(limb, mechanics).forces(ca.SX(0, 1), q - rest)
    residual = springs * (q - rest) + weight - stiffening * cubic - force
    return SmoothFunction(residual, q, ca.vertcat(force, springs, rest, k, stiffening))
