"""Joint angles and bends in static equilibrium: K θ = f(T) + gravity, eqn (2) at rest."""

import functools

import casadi as ca
import numpy as np

from limb_systems.dynamics import Dynamics
from limb_systems.errors import LimbError
from limb_systems.smooth_function import SmoothFunction
from limb_systems.symbolic_chain import Chain

MAX_NEWTON_STEPS = 50
DAMPED_STEP = 0.2  # rad, the longest step of a joint downhill, so that the slope does not turn
FULL_STEP = 1.0  # rad, the longest Newton step of a joint, so that it does not turn over
ANGLE_TOLERANCE = 1e-12  # rad; the derivatives there are as exact
FOLDED_CHORD_ANGLE = np.deg2rad(100.0)  # of a chord; with that, a limb hangs from a fold


class StaticEquilibria:
    """Joint angles θ and bends φ(θ) at rest under the forces of the wires, where (2) has no motion.

    The equilibrium is exact. Where gravity and forces are no functions of θ, θ is linear in f.
    Arrays have any number of points before their last axis. φ(x) has the methods of a
    `SmoothFunction`.

    The equilibria of the last states are kept, so that values, slopes and curvature at the same
    states take one solution. All methods raise LimbError where the limb has no stable equilibrium.

    - ``wires``: the limb's `Wires`.

    Args:
        dynamics: the limb's equation of motion.
        of_equal_angles: whether φ follows from the mean of the joints' angles, by (11), instead of
            the chord.
    """

    def __init__(self, dynamics: Dynamics, of_equal_angles: bool = False):
        self._mechanics = dynamics.mechanics
        self._residual = dynamics.at_rest
        self._of_equal_angles = of_equal_angles
        self.wires = dynamics.wires
        # The matrices of derivatives are dense.
        num_states = self.wires.num_states
        self.num_values = self._mechanics.layout.num_bends
        self.slope_places = np.indices((self.num_values, num_states)).reshape(2, -1)
        self.curvature_places = np.array(np.tril_indices(num_states))
        # The last states and their equilibria.
        self._last: tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]] | None = None

    # Limbs at rest do without their bends, which are stated when they are first used.
    @functools.cached_property
    def _chords(self) -> SmoothFunction:
        """The angles of the chords (F,), rad, of θ."""
        q = ca.SX.sym("q", self._mechanics.layout.num_joints)
        return SmoothFunction(Chain(self._mechanics, q).bends(), q)

    @functools.cached_property
    def bends_of_angles(self) -> SmoothFunction:
        """φ (F,), rad, of θ."""
        if not self._of_equal_angles:
            return self._chords
        q = ca.SX.sym("q", self._mechanics.layout.num_joints)
        return SmoothFunction(ca.DM(np.linalg.pinv(self._mechanics.shape)) @ q, q)

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
        """The forces (n,), N·m, of wires that were never heated."""
        return self.wires.forces(self.wires.cold_states, self.rest_angles)

    def at_rest(self, temperature: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return θ (n,), rad, after wires settled at T (W,), °C, and ∂θ/∂f (n, n), rad/(N·m)."""
        straight = np.zeros(self._mechanics.layout.num_joints)
        angles, derivatives = self._solve(self.wires.settled_states(temperature), straight)
        return angles, np.linalg.inv(derivatives[:, : len(angles)])

    def _solve(self, states: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve for θ (..., n) at rest at states (..., N).

        Newton's method may miss the equilibrium of a limb that is heavy for its springs. Steps that
        go downhill find one, but it may be of a limb that hangs from a fold.

        Args:
            start: angles to start from (..., n).

        Returns:
            θ, and the residual's derivatives by [θ, x] there (..., n, n + N).

        Raises:
            LimbError: if there is no stable equilibrium, or gravity folds a segment.
        """
        try:
            return self._newton(states, start)
        except (LimbError, np.linalg.LinAlgError):
            angles, derivatives = self._newton(states, start, downhill=True)
        is_folded = (np.abs(self._chords.values(angles)) > FOLDED_CHORD_ANGLE).any(axis=-1)
        if is_folded.any():
            raise LimbError(f"Gravity folds the limb{_place(is_folded)}; is it too soft?")
        return angles, derivatives

    def _newton(
        self, states: np.ndarray, start: np.ndarray, downhill: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Run Newton's method; arguments, results and errors as in `_solve`."""
        angles = start
        num_joints = start.shape[-1]
        longest_step = DAMPED_STEP if downhill else FULL_STEP
        for _ in range(MAX_NEWTON_STEPS):
            residual, derivatives = self._residual.first(np.concatenate([angles, states], axis=-1))
            step = _newton_step(derivatives[..., :num_joints], -residual, downhill)
            largest = np.abs(step).max(axis=-1, keepdims=True)
            angles = angles + step / np.maximum(1.0, largest / longest_step)
            if (largest < ANGLE_TOLERANCE).all():
                break
        else:
            raise LimbError(
                f"There is no static equilibrium that Newton's method finds"
                f"{_place(largest[..., 0] >= ANGLE_TOLERANCE)}; is the limb too soft?"
            )
        # The equilibrium is stable if the stiffness is positive definite.
        is_unstable = np.linalg.eigvalsh(derivatives[..., :num_joints])[..., 0] <= 0
        if is_unstable.any():
            raise LimbError(
                f"The limb's equilibrium{_place(is_unstable)} is unstable: gravity folds it; is it "
                "too soft?"
            )
        return angles, derivatives

    def resting_state(self, readings: np.ndarray) -> np.ndarray:
        """Return [θ, θ̇, x, V] of wires at rest with readings V (W,), °C; see `resting_state`."""
        states = self.wires.rested_states(readings)
        angles = self.angles(states)
        return np.concatenate([angles, np.zeros_like(angles), states, readings])

    def angles(self, states: np.ndarray) -> np.ndarray:
        """Return θ (..., n), rad, at states x (..., N) of the wires."""
        return self._settled(states)[0]

    def expanded(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `angles` θ (..., n), and their derivatives by the states (..., n, N)."""
        angles, _, slopes = self._settled(states)
        return angles, slopes

    def values(self, states: np.ndarray) -> np.ndarray:
        """Return φ (..., F), rad, of the equilibria at states x (..., N)."""
        return self.bends_of_angles.values(self.angles(states))

    def first(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return φ (..., F), and its derivatives by the states (..., F, N)."""
        angles, slopes = self.expanded(states)
        bends, by_angle = self.bends_of_angles.first(angles)
        return bends, by_angle @ slopes

    def second(self, states: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return second derivatives of weights · φ by states (..., N, N), for weights (..., F).

        They are the second derivatives of φ(θ) - λ · r along [∂θ/∂x, 1], with the residual r of
        (2) and its adjoint λ.
        """
        angles, compliance, slopes = self._settled(states)
        n = angles.shape[-1]
        # Find the adjoint of the residual.
        _, bend_by_angle = self.bends_of_angles.first(angles)
        weighted = bend_by_angle.swapaxes(-1, -2) @ weights[..., None]
        adjoint = (compliance @ weighted)[..., 0]
        # Add up the curvature by angles, by angles and states, and by states.
        residual = self._residual.second(np.concatenate([angles, states], -1), -adjoint)
        transposed_slopes = slopes.swapaxes(-1, -2)
        by_angles = residual[..., :n, :n] + self.bends_of_angles.second(angles, weights)
        mixed = transposed_slopes @ residual[..., :n, n:]
        by_states = residual[..., n:, n:]
        return transposed_slopes @ by_angles @ slopes + mixed + mixed.swapaxes(-1, -2) + by_states

    def slopes(self, states: np.ndarray) -> np.ndarray:
        """Return derivatives of φ by the states at the ``slope_places`` (..., F N)."""
        return self.first(states)[1].reshape(*states.shape[:-1], -1)

    def curvatures(self, states: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return `second` at the ``curvature_places`` of the lower triangle (..., N(N + 1)/2)."""
        return self.second(states, weights)[..., *self.curvature_places]

    def _settled(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return θ (..., n), ∂θ/∂f (..., n, n) and ∂θ/∂x (..., n, N) at states x (..., N)."""
        if self._last is not None and np.array_equal(self._last[0], states):
            return self._last[1]
        # Start from the angles of the linearized cold limb.
        rest = self.rest_angles
        cold_angles = np.broadcast_to(rest, (*states.shape[:-1], len(rest)))
        added_forces = self.wires.forces(states, cold_angles) - self._cold_forces
        start = cold_angles + added_forces @ self.compliance.T
        angles, derivatives = self._solve(states, start)
        # The implicit function theorem gives the slopes.
        stiffness, by_state = np.split(derivatives, [angles.shape[-1]], axis=-1)
        compliance = np.linalg.inv(stiffness)
        equilibria = (angles, compliance, -compliance @ by_state)
        self._last = (states.copy(), equilibria)
        return equilibria


def _newton_step(stiffness: np.ndarray, forces: np.ndarray, downhill: bool) -> np.ndarray:
    """Return the Newton step (..., n) under forces (..., n).

    Downhill, the stiffness has the absolute values of its eigenvalues, so that forces do work.
    """
    if downhill:
        values, axes = np.linalg.eigh(stiffness)
        modal_step = axes.swapaxes(-1, -2) @ forces[..., None] / np.abs(values)[..., None]
        return (axes @ modal_step)[..., 0]
    return np.linalg.solve(stiffness, forces[..., None])[..., 0]


def _place(refused: np.ndarray) -> str:
    """Return the number of the first refused point and their count; empty for a single point."""
    if not refused.ndim:
        return ""
    return f" at point {int(np.argmax(refused))} of {refused.size} ({int(refused.sum())} in all)"
