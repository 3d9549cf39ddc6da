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
from limb_systems.rubber import NonlinearRubber, ramp
from limb_systems.smooth_function import SmoothFunction
from limb_systems.symbolic_chain import Chain

DEGREE = 8  # of the polynomial, which is within 0.03° of equilibria in all plans
MOST = np.deg2rad(78.0)  # bend that both torques hold, at most; no tip tangent shows 90°
STEPS, TOLERANCE = 12, 1e-6  # of Newton's method, whose step after such a one is 1e-12, and rad


def _disc() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points in a disc of radius 1 (P, 2), terms of polynomials, and their weights by values."""
    rings = np.cos(np.pi / (DEGREE + 2) * (np.arange(DEGREE // 2 + 1) + 0.5))
    turns = np.exp(2j * np.pi * np.arange(2 * DEGREE + 2) / (2 * DEGREE + 2))
    points = np.multiply.outer(rings, turns).ravel()
    points = np.stack([points.real, points.imag], axis=-1)
    terms = np.add.outer(*2 * [np.arange(DEGREE + 1)]) <= DEGREE
    e2, e3 = (chebvander(along, DEGREE) for along in points.T)
    series = e2[:, :, None] * e3[:, None]
    return points, terms, np.linalg.pinv(series[:, terms])


class OpenLoopInSpace(OpenLoop):
    """`OpenLoop` of a segment of two axes, whose bends (K + 1, B, R, 2) are as its sensor reads.

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
        unit = copy.deepcopy(segment)
        unit.stiffness = unit.stiffening = unit.stiffness_ratio = 1.0
        unit.rest_angle = unit.rest_angle_e3 = 0.0
        unit.rest_memory = None
        self._mechanics = LimbModel.of(LimbParameters(segments=[unit])).mechanics
        self._sensor, self._disc = segment.bend_sensor, _disc()
        kinds, self._mounting = np.unique(np.round(loads, 9), axis=0, return_inverse=True)
        self._balances = [_balance(unit, gravity, payload) for *gravity, payload in kinds.tolist()]

    def _bends(
        self,
        torques: np.ndarray,
        rubber: Mapping[str, np.ndarray],
        bent: Callable[[int, np.ndarray], np.ndarray] | None,
    ) -> np.ndarray:
        levers = np.stack([np.cos(rubber["angle"]), np.sin(rubber["angle"])], axis=-1)
        pulls = torques.swapaxes(0, 1) @ levers[:, None]
        pulls /= rubber["stiffness"][:, None, None, None]
        if "shift" in rubber:
            ratio = _springs(rubber)[:, None, None]
            shifts = self._rest_shifts(torques, levers, rubber).swapaxes(0, 1)
            pulls += ratio * shifts / self._chain.bend_by_equal_angle
        bends = np.empty_like(pulls)
        for number, balance in enumerate(self._balances):
            runs = np.flatnonzero(self._mounting == number)
            bends[:, :, runs] = self._interpolated(balance, pulls[:, :, runs], rubber)
        read = roll_bends(bends.transpose(3, 1, 0, 2), rubber["roll"][:, None])
        return np.moveaxis(read, 0, -1)

    def _rest_shifts(
        self, torques: np.ndarray, levers: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Return how far memory moves the rest angle (K + 1, B, R, 2), rad; see `NonlinearRubber`.

        Args:
            torques: torques of the wires (K + 1, B, R, W), N·m.
            levers: directions of the wires (B, W, 2).
        """
        # The bend that each wire would hold alone, as far as it grows in each step.
        springs = rubber["stiffness"][:, None] * _springs(rubber)
        by_torque = np.linalg.norm(levers / springs[:, None], axis=-1)
        by_torque *= self._chain.bend_by_equal_angle
        rates = np.diff(by_torque[:, None] * torques, axis=0) / self.step
        progress = self.step * ramp(rates) * rubber["rate"][:, None, None]
        # The implicit Euler method, as in the plane.
        towards = rubber["shift"][:, None, None] * (progress @ levers)
        remaining = 1 / (1 + progress.sum(axis=-1, keepdims=True))
        shifts = np.zeros((*torques.shape[:-1], 2))
        for number, (drawn, share) in enumerate(zip(towards, remaining, strict=True)):
            shifts[number + 1] = share * (shifts[number] + drawn)
        return shifts

    def _interpolated(
        self, balance: SmoothFunction, pulls: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Bends (B, ..., 2) held by torques towards E2 and E3 over k (B, ..., 2), rad."""
        sizes = np.linalg.norm(pulls, axis=-1, keepdims=True)
        most = np.minimum(sizes.max(axis=(1, 2, 3)), MOST * self._mechanics.shape.max()) + 1e-9
        ranges = most[:, None, None, None]
        points, terms, weights = self._disc
        held = self.held(balance, ranges[:, 0] * points, rubber)
        coefficients = np.zeros((len(pulls), 2, *terms.shape))
        coefficients[:, :, terms] = (weights @ held).swapaxes(1, 2)
        within = (pulls / np.maximum(sizes, ranges)).reshape(len(pulls), 1, -1, 2)
        series = chebvander(within, DEGREE)
        bends = ((series[..., 0, :] @ coefficients) * series[..., 1, :]).sum(axis=-1)
        return bends.swapaxes(1, 2).reshape(pulls.shape)

    def held(
        self, balance: SmoothFunction, pulls: np.ndarray, rubber: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Bends (B, P, 2), rad, as exact equilibria of `_interpolated`; nan where there is none."""
        mechanics = self._mechanics
        towards = (mechanics.shape > 0).astype(float)  # joints by bends (n, 2)
        k, ratio = rubber["stiffness"], _springs(rubber)
        # A twist joint keeps its own share of k.
        springs = ratio @ towards.T + mechanics.stiffness * (1 - towards.sum(axis=-1))
        rest_bends = np.stack([rubber["rest_angle"], rubber["rest_angle_e3"]], axis=-1)
        rest = rest_bends @ mechanics.shape.T
        stiffening = np.broadcast_to(rubber.get("stiffening", 0.0), k.shape)
        of_sets = np.column_stack([springs, rest, k, stiffening])
        force = pulls @ towards.T
        given = np.concatenate(
            [force, np.repeat(of_sets[:, None], force.shape[1], axis=1)], axis=-1
        )
        angles = rest[:, None] + force / springs[:, None]
        for _ in range(STEPS):
            residual, slopes = balance.first(angles, given)
            step = -np.linalg.solve(slopes, residual[..., None])[..., 0]
            angles = angles + np.clip(step, -0.5, 0.5)
            if np.abs(step).max() < TOLERANCE:
                break
        angles = np.where(np.abs(step).max(axis=-1, keepdims=True) < TOLERANCE, angles, np.nan)
        seen = self._sensor.exact_bends(mechanics.chains[0], np.moveaxis(angles, -1, 0))
        return np.moveaxis(seen, 0, -1)


def _springs(rubber: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the bending stiffness towards E2 and E3, over that towards E2 (B, 2)."""
    ratio = rubber["stiffness_ratio"]
    return np.stack([np.ones_like(ratio), ratio], axis=-1)


def _balance(unit: SegmentParameters, gravity: Sequence[float], payload: float) -> SmoothFunction:
    """Torques on the joints over k (n,) of θ, which are zero at rest.

    Its parameters are the wires' force over k (n,), the springs over k (n,), their rest angles
    (n,), k and the stiffening.
    """
    limb = LimbParameters(segments=[dataclasses.replace(unit, stiffening=1.0)], payload=payload)
    mechanics = LimbModel.of(limb).mechanics
    n = mechanics.layout.num_joints
    q, force, springs, rest = (ca.SX.sym(name, n) for name in ("q", "f", "K", "r"))
    k, stiffening, still = ca.SX.sym("k"), ca.SX.sym("s"), ca.SX(n, 1)
    weight = Chain(mechanics, q).inverse_dynamics(still, still, ca.DM(gravity)) / k
    cubic = NonlinearRubber(limb, mechanics).forces(ca.SX(0, 1), q - rest)
    residual = springs * (q - rest) + weight - stiffening * cubic - force
    return SmoothFunction(residual, q, ca.vertcat(force, springs, rest, k, stiffening))
