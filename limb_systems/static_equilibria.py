"""Joint angles and bends that wires hold at rest: K θ = f(T) + gravity, eqn (2) at rest."""

import functools

import casadi as ca
import numpy as np

from limb_systems.dynamics import Dynamics
from limb_systems.errors import LimbError
from limb_systems.smooth_function import SmoothFunction
from limb_systems.symbolic_chain import Chain

MAX_NEWTON_STEPS = 50
ANGLE_TOLERANCE = 1e-12  # rad; the derivatives there are as exact
FOLDED_CHORD_ANGLE = np.deg2rad(100.0)  # of a chord; with that, a limb hangs from a fold


class StaticEquilibria:
    """Joint angles θ and bends φ(θ) that wires hold at rest, where (2) has no motion.

    The equilibrium is exact. Where gravity and forces are no functions of θ, θ is linear in f.
    Arrays have any number of points before their last axis. φ(x) has the methods of a
    `SmoothFunction`.

    The equilibria of the last states are kept, so that values, slopes and curvature at the same
    states take one solution. All methods raise LimbError where the limb has no stable equilibrium.

    - ``wires``: the limb's `Wires`.
    - ``bends_of_angles``: φ (F,) of θ as a `SmoothFunction`.

    Args:
        dynamics: the limb's equation of motion.
        of_equal_angles: whether φ follows from the mean of the joints' angles, by (11), and not
            from the chord.
    """

    def __init__(self, dynamics: Dynamics, of_equal_angles: bool = False):
        mechanics = dynamics.mechanics
        self.wires = dynamics.wires
        q = ca.SX.sym("q", dynamics.num_joints)
        self._residual = dynamics.at_rest
        self._chords = SmoothFunction(Chain(mechanics, q).bends(), q)  # φ (F,) of θ
        self.bends_of_angles = self._chords
        if of_equal_angles:
            to_bends = np.linalg.pinv(mechanics.shape)
            self.bends_of_angles = SmoothFunction(ca.DM(to_bends) @ q, q)
        N, F = self.wires.num_states, self.bends_of_angles.num_values
        self.num_values = F
        self.slope_places = np.indices((F, N)).reshape(2, -1)
        self.curvature_places = np.array(np.tril_indices(N))
        self._kept: tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]] | None = None

    @functools.cached_property
    def _cold_rest(self) -> tuple[np.ndarray, np.ndarray]:
        """θ and ∂θ/∂f of wires that were never heated."""
        return self.at_rest(np.full(self.wires.num_wires, self.wires.ambient_temperature))

    @property
    def rest_angles(self) -> np.ndarray:
        """θ (n,), rad, with wires that were never heated."""
        return self._cold_rest[0]

    @property
    def compliance(self) -> np.ndarray:
        """∂θ/∂f (n, n) at the rest angles, rad/(N·m)."""
        return self._cold_rest[1]

    @functools.cached_property
    def _cold_forces(self) -> np.ndarray:
        return self.wires.forces(self.wires.cold_states, self.rest_angles)

    def at_rest(self, temperature: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """θ (n,), rad, where wires have settled at T (W,), °C, and ∂θ/∂f (n, n), rad/(N·m)."""
        straight = np.zeros(self._chords.num_variables)
        angles, by_point = self._solved(self.wires.settled_states(temperature), straight)
        return angles, np.linalg.inv(by_point[:, : len(angles)])

    def _solved(self, states: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """θ (..., n) at rest at states (..., N), and the residual's derivatives by [θ, x] there.

        Newton's method may miss the rest of a limb that is heavy for its springs. Steps that
        go downhill do not, but may end with a limb that hangs from a fold.

        Args:
            start: angles to start from (..., n).

        Raises:
            LimbError: if there is no stable equilibrium, or gravity folds a segment.
        """
        try:
            return self._newton(states, start)
        except (LimbError, np.linalg.LinAlgError):
            angles, by_point = self._newton(states, start, downhill=True)
        folded = (np.abs(self._chords.values(angles)) > FOLDED_CHORD_ANGLE).any(axis=-1)
        if folded.any():
            raise LimbError(f"Gravity folds the limb{_where(folded)}; is it too soft?")
        return angles, by_point

    def _newton(
        self, states: np.ndarray, start: np.ndarray, downhill: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        angles, n = start, start.shape[-1]
        for _ in range(MAX_NEWTON_STEPS):
            residual, by_point = self._residual.first(np.concatenate([angles, states], axis=-1))
            step = _step(by_point[..., :n], -residual, downhill)
            largest = np.abs(step).max(axis=-1, keepdims=True)
            # No step is so long that a joint turns over, nor, downhill, that the slope turns.
            angles = angles + step / np.maximum(1.0, largest / (0.2 if downhill else 1.0))
            if (largest < ANGLE_TOLERANCE).all():
                break
        else:
            raise LimbError(
                f"There is no static equilibrium that Newton's method finds"
                f"{_where(largest[..., 0] >= ANGLE_TOLERANCE)}; is the limb too soft?"
            )
        unstable = np.linalg.eigvalsh(by_point[..., :n])[..., 0] <= 0
        if unstable.any():
            raise LimbError(
                f"The limb's equilibrium{_where(unstable)} is unstable: gravity folds it; is it "
                "too soft?"
            )
        return angles, by_point

    def resting_state(self, readings: np.ndarray) -> np.ndarray:
        """[θ, θ̇, x, V] where wires rest that are read at V (W,), °C; see `resting_state`."""
        states = self.wires.rested_states(readings)
        angles = self.angles(states)
        return np.concatenate([angles, np.zeros_like(angles), states, readings])

    def angles(self, states: np.ndarray) -> np.ndarray:
        """θ (..., n), rad, at states x (..., N) of the wires."""
        return self._settled(states)[0]

    def expanded(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`angles` θ (..., n), and their derivatives by the states (..., n, N)."""
        angles, _, slopes = self._settled(states)
        return angles, slopes

    def values(self, states: np.ndarray) -> np.ndarray:
        """φ (..., F), rad, of the equilibria at states x (..., N)."""
        return self.bends_of_angles.values(self.angles(states))

    def first(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """φ (..., F), and its derivatives by the states (..., F, N)."""
        angles, slopes = self.expanded(states)
        bends, by_angle = self.bends_of_angles.first(angles)
        return bends, by_angle @ slopes

    def second(self, states: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · φ by the states (..., N, N), for weights (..., F).

        They are the second derivatives of φ(θ) - λ · r along [∂θ/∂x, 1], with the residual r of
        (2) and its adjoint λ.
        """
        angles, compliance, slopes = self._settled(states)
        n = angles.shape[-1]
        by_angle = self.bends_of_angles.first(angles)[1].swapaxes(-1, -2)
        adjoint = (compliance @ (by_angle @ weights[..., None]))[..., 0]
        residual = self._residual.second(np.concatenate([angles, states], -1), -adjoint)
        along = slopes.swapaxes(-1, -2)
        by_angles = residual[..., :n, :n] + self.bends_of_angles.second(angles, weights)
        mixed = along @ residual[..., :n, n:]
        return along @ by_angles @ slopes + mixed + mixed.swapaxes(-1, -2) + residual[..., n:, n:]

    def slopes(self, states: np.ndarray) -> np.ndarray:
        """Derivatives of φ by the states at the ``slope_places`` (..., F N)."""
        return self.first(states)[1].reshape(*states.shape[:-1], -1)

    def curvatures(self, states: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """`second` at the ``curvature_places``, of the lower triangle (..., N (N + 1) / 2)."""
        return self.second(states, weights)[..., *self.curvature_places]

    def _settled(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """θ (..., n), and its derivatives by forces (..., n, n) and by the states (..., n, N)."""
        kept = self._kept
        if kept is None or not np.array_equal(kept[0], states):
            at_rest = np.broadcast_to(self.rest_angles, (*states.shape[:-1], len(self.rest_angles)))
            moved = (self.wires.forces(states, at_rest) - self._cold_forces) @ self.compliance.T
            angles, by_point = self._solved(states, at_rest + moved)
            stiffness, by_state = np.split(by_point, [angles.shape[-1]], axis=-1)
            compliance = np.linalg.inv(stiffness)
            kept = states.copy(), (angles, compliance, -compliance @ by_state)
            self._kept = kept
        return kept[1]


def _step(stiffness: np.ndarray, forces: np.ndarray, downhill: bool) -> np.ndarray:
    """The Newton step (..., n) under forces (..., n), or one that forces do work along."""
    if downhill:
        values, axes = np.linalg.eigh(stiffness)
        along = axes.swapaxes(-1, -2) @ forces[..., None] / np.abs(values)[..., None]
        return (axes @ along)[..., 0]
    return np.linalg.solve(stiffness, forces[..., None])[..., 0]


def _where(refused: np.ndarray) -> str:
    """Says which of several points is refused."""
    if not refused.ndim:
        return ""
    return f" at point {int(np.argmax(refused))} of {refused.size} ({int(refused.sum())} in all)"
