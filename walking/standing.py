"""A robot that stands: balance of forces, and stability by the pivots of its stiffness.

A point p = [y, x, λ, s] has the configuration y of `Walker`, the states x of the wires, the
forces λ of the ground on each foot (tangential, normal), N, and the travel s of each foot, m, by
foot. The Lagrangian is

    L(p) = V(y) - λ · feet(y),    ∂L/∂y = [0, f(x, q)] at rest

with the torques f of wires and rubber (4). Feet with friction couple the coordinates in a way
that is not symmetric, and equilibria that are just stable fall when disturbed a little. So the
pivots of LDLᵀ = ∂²L/∂y² - ∂f/∂q + ρ JᵀJ, with the rows J of the directions in which the ground
holds feet, have to be more than positive. Joints are eliminated first: what is left are the
stiffnesses against motion of the body in x, then z, then θ, the others being free.

Balance alone does not share the load among more than two feet: heights of micrometres do, by which
feet sink into the ground. So the heights h of the ground below the feet are coordinates as well.
What is left for each, with all of y eliminated, is the load that a foot gains by ground that is
higher. It has to be small: else the load, and with it friction, is left to chance. `FrictionGain`
bounds what friction then makes of it.

A pivot is the stiffness vᵀ H v of the motion v that the eliminated coordinates follow. v is
stationary, so that the pivot's derivative is that of Φ(p, v) = vᵀ H(p) v at constant v, and its
curvature is Φ's less what the eliminated coordinates give way.
"""

import casadi as ca
import numpy as np

from limb_systems.smooth_function import SmoothFunction, build_once
from limb_systems.wires import Wires
from walking.walker import Walker

# Least pivots. With less, gaits tip over a slightly uneven ground or slip of a foot: at 10 N/m, a
# tenth of a limb's weight moves the body by 1.5 mm; at 0.1 N·m/rad, it turns it by 1°. Against
# pitch, which other limbs than planned make tip, `GaitProgram` asks for more.
LEAST_STIFFNESS = np.array([10.0, 10.0, 0.1])
LEAST_JOINT_STIFFNESS = 0.05  # of a joint's spring: limbs buckle at 0
MOST_LOAD_STIFFNESS = 1000.0  # N/m: ground that is higher by 0.1 mm adds a load of at most 0.1 N
LEAST_PIVOT = float(np.arcsinh(1.0))  # of `Stability.values`


class Balance(SmoothFunction):
    """Balance and feet of a robot at points p (..., P).

    Values are the d forces of the balance, N and N·m; the travel of the point of contact of each
    foot less s, m (τF); and the height of each foot above where its load presses the ground to,
    z + f_n / ρ, m (F), or z if the ground is rigid.

    Args:
        walker: mechanics of the robot.
        wires: wires of all its limbs.
        ground_gives: whether loads press feet into the ground.
    """

    def __init__(self, walker: Walker, wires: Wires, ground_gives: bool):
        self._walker, self._num_states = walker, wires.num_states
        y, feet = walker.configuration, walker.symbolic_feet
        x, travel = ca.SX.sym("x", wires.num_states), ca.SX.sym("s", feet[:-1, :].numel())
        forces = ca.SX.sym("f", *feet.shape)
        balance = _balance(walker, wires, x, forces)
        heights = feet[-1, :].T + ground_gives * forces[-1, :].T / walker.contact_stiffness
        values = ca.vertcat(balance, ca.vec(feet[:-1, :]) - travel, heights)
        super().__init__(values, ca.vertcat(y, x, ca.vec(forces), travel))

    def split(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """y (..., d), x (..., N) and λ (..., F, τ + 1) of points."""
        shape = self._walker.num_feet, self._walker.num_tangents + 1
        sizes = [len(self._walker.stiffness), self._num_states, shape[0] * shape[1]]
        y, x, forces, _ = np.split(points, np.cumsum(sizes), axis=-1)
        return y, x, forces.reshape(*forces.shape[:-1], *shape)


def balance_of(walker: Walker, wires: Wires, ground_gives: bool = True) -> Balance:
    """The `Balance` of a robot, stated once."""
    key = Balance, walker.key, ground_gives
    return build_once(key, lambda: Balance(walker, wires, ground_gives))


def _balance(walker: Walker, wires: Wires, states: ca.SX, forces: ca.SX) -> ca.SX:
    """∂L/∂y - [0, f(x, q)] (d,), N and N·m, under the ground's forces (τ + 1, F), by (4)."""
    y, B = walker.configuration, walker.pose_size
    lagrangian = walker.symbolic_potential - ca.dot(forces, walker.symbolic_feet)
    torques = wires.symbolic_force(states, y[B:])
    return ca.gradient(lagrangian, y) - ca.vertcat(ca.SX(B, 1), torques)


class Stability:
    """Pivots of the stiffness of a robot in the plane at points p (..., P), with derivatives.

    Values are asinh of the pivots over the least ones: of the last joint of each limb, whose sign
    is the first to change, and of the body in x, z and θ; and of the load by each height of the
    ground over the most. They are (..., m), with m = F + 3 + F. The class is a
    `planners.transcription.function_block.PointFunction`.

    Args:
        walker: mechanics of the robot, on a planar body.
        wires: wires of all its limbs.
        held: 1 where the ground holds a foot in (x, z), otherwise 0 (K, F, 2); any
            number of points before the last axis of p then has to be K.
    """

    def __init__(self, walker: Walker, wires: Wires, held: np.ndarray):
        d, B, F = len(walker.stiffness), walker.pose_size, walker.num_feet
        self._d, self._F = d, F
        self._held = held.reshape(*held.shape[:-2], 2 * F)
        of_joints = LEAST_JOINT_STIFFNESS * walker.stiffness[B:][walker.last_joints]
        self._least = np.concatenate([of_joints, LEAST_STIFFNESS, np.full(F, MOST_LOAD_STIFFNESS)])
        # Joints first, then the body, then each height of the ground; the pivots that count, by how
        # many coordinates are eliminated, and by their own.
        self._order = np.append(np.arange(B, d), np.arange(B))
        kept = [*walker.last_joints, *range(d - B, d)]
        self._pivots = [*zip(kept, self._order[kept], strict=True), *((d, d + f) for f in range(F))]
        self.num_values = len(self._pivots)

        functions = build_once((Stability, walker.key), lambda: self._stated(walker, wires))
        self._energy, self._stiffness, self.gain = functions
        self.slope_places, self.curvature_places = self._places()

    def _stated(self, walker: Walker, wires: Wires) -> tuple[SmoothFunction, ...]:
        """Φ; the stiffness, column by column; and Φ of `FrictionGain`."""
        d, F = self._d, self._F
        y, feet = walker.configuration, ca.vec(walker.symbolic_feet)
        ground = walker.contact_stiffness  # a hundred times what limbs are, if feet are hard
        x, forces = ca.SX.sym("x", wires.num_states), ca.SX.sym("f", 2, F)
        v, on_ground = ca.SX.sym("v", d + F), ca.SX.sym("held", 2 * F)
        balance = _balance(walker, wires, x, forces)
        point = ca.vertcat(y, x, ca.vec(forces), ca.SX.sym("s", F))
        raised = ca.vec(ca.horzcat(ca.SX(F, 1), v[d:]).T)
        turned = ca.jtimes(feet, y, v[:d])
        along = turned - raised
        own = ca.jtimes(balance, y, v[:d])
        energy = ca.dot(v[:d], own) + ground * ca.dot(on_ground, along**2)
        w, drag = ca.SX.sym("w", d), ca.SX.sym("drag", 2 * F)
        pushed = ca.jtimes(feet, y, w)
        coupled = ca.dot(w, own) + ground * ca.dot(on_ground * turned, pushed)
        gain = ca.dot(drag[::2], pushed[::2]) + ca.dot(drag[1::2], turned[1::2]) - coupled
        return (
            SmoothFunction(energy, ca.vertcat(point, v), on_ground),
            SmoothFunction(ca.vec(ca.hessian(energy, v)[0] / 2), point, on_ground),
            SmoothFunction(gain, ca.vertcat(point, v[:d], w), ca.vertcat(on_ground, drag)),
        )

    def values(self, points: np.ndarray) -> np.ndarray:
        """The pivots' asinh (..., m)."""
        pivots = np.moveaxis(self._eliminated(points)[0], 0, -1)
        return np.arcsinh(pivots / self._least)

    def stiffness(self, points: np.ndarray) -> np.ndarray:
        """∂²L/∂y² - ∂f/∂q + ρ JᵀJ (..., d, d)."""
        return self._with_heights(points)[..., : self._d, : self._d]

    def _with_heights(self, points: np.ndarray) -> np.ndarray:
        """The stiffness with the heights of the ground as coordinates (..., d + F, d + F)."""
        size = self._d + self._F
        return self._stiffness.values(points, self._held).reshape(*points.shape[:-1], size, size)

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """Derivatives at the ``slope_places`` (..., Z)."""
        pivots, motions, _ = self._eliminated(points)
        slopes = np.moveaxis(self._pivot_slopes(points, pivots, motions), 0, -2)
        return slopes[..., *self.slope_places]

    def curvatures(self, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · `values` at the ``curvature_places`` (..., Z)."""
        P = points.shape[-1]
        result = np.zeros((*points.shape, P))
        pivots, motions, stiffness = self._eliminated(points)
        slopes = self._pivot_slopes(points, pivots, motions)
        one = np.ones((*pivots.shape, 1))
        curved = self._energy.second(self._with(points, motions), one, self._held)
        sizes = np.hypot(pivots, self._of_pivots(self._least, pivots))
        on_pivots = np.moveaxis(weights, -1, 0) / sizes
        for (number, _), pivot, slope, both, weight in zip(
            self._pivots, pivots, slopes, curved, on_pivots, strict=True
        ):
            before = self._order[:number]
            change = 0.5 * both[..., P + before, :P]  # of H v, to which they give way
            kept = stiffness[..., before[:, None], before]
            both = both[..., :P, :P] - 2 * change.swapaxes(-1, -2) @ np.linalg.solve(kept, change)
            both -= pivot[..., None, None] * slope[..., :, None] * slope[..., None, :]
            result += weight[..., None, None] * both
        return result[..., *self.curvature_places]

    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Where first and second derivatives may not be zero."""
        P = self._energy.num_variables - self._d - self._F
        counts = np.unique(self._energy.slope_places[1])
        counts = counts[counts < P]
        rows = np.repeat(np.arange(self.num_values), len(counts))
        lower = np.array(np.tril_indices(len(counts)))
        return np.array([rows, np.tile(counts, self.num_values)]), counts[lower]

    def _pivot_slopes(
        self, points: np.ndarray, pivots: np.ndarray, motions: np.ndarray
    ) -> np.ndarray:
        """Derivatives of the pivots' asinh by the points (V, ..., P)."""
        _, slopes = self._energy.first(self._with(points, motions), self._held)
        sizes = np.hypot(pivots, self._of_pivots(self._least, pivots))
        return slopes[..., 0, : points.shape[-1]] / sizes[..., None]

    @staticmethod
    def _with(points: np.ndarray, motions: np.ndarray) -> np.ndarray:
        """Arguments [p, v] of Φ for each pivot (V, ..., P + d)."""
        return np.concatenate([np.broadcast_to(points, (len(motions), *points.shape)), motions], -1)

    @staticmethod
    def _of_pivots(values: np.ndarray, pivots: np.ndarray) -> np.ndarray:
        """Values of the V pivots (V,) as an array (V, 1, ...) beside the pivots."""
        return values.reshape(-1, *[1] * (pivots.ndim - 1))

    def _eliminated(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The V pivots (V, ...), their motions v (V, ..., d + F), and `_with_heights`."""
        whole = self._with_heights(points)
        motions = np.zeros((len(self._pivots), *whole.shape[:-1]))
        for (number, own), v in zip(self._pivots, motions, strict=True):
            before = self._order[:number]
            kept = whole[..., before[:, None], before]
            v[..., own] = 1.0
            v[..., before] = -np.linalg.solve(kept, whole[..., before, own, None])[..., 0]
        own = [own for _, own in self._pivots]
        pivots = np.einsum("...ji,j...i->j...", whole[..., own, :], motions)
        return pivots, motions, whole


class FrictionGain:
    """What friction on a foot that slides does to itself, at points p (..., P) of `Stability`.

    If friction drags a foot back by 1 N, the load on it changes, and so the friction, by g N. Where
    g reaches 1, the foot jams, or jumps, however stable the robot is without friction. With the
    stiffness H of `Stability`, and the directions t and n in which the foot slides and is held, it
    is g = μ ρ nᵀH⁻¹t. This is the stationary value over motions v and w of

        Φ(p, v, w) = μ tᵀw + ρ nᵀv - vᵀH w,

    whose derivatives at constant v and w are those of g. The class is a
    `planners.transcription.function_block.PointFunction` of one value.

    Args:
        walker: mechanics of the robot, on a planar body.
        wires: wires of all its limbs.
        held: 1 where the ground holds a foot in (x, z), otherwise 0 (K, F, 2).
        sliding: μ of the foot that is looked at, -μ if it slides backward, and 0 of the other feet
            (K, F).
    """

    num_values = 1

    def __init__(self, walker: Walker, wires: Wires, held: np.ndarray, sliding: np.ndarray):
        self._walker, self._standing = walker, Stability(walker, wires, held)
        self._gain, self._d = self._standing.gain, len(walker.stiffness)
        self._drag = np.stack([sliding, walker.contact_stiffness * (sliding != 0)], axis=-1)
        both = np.stack([held, self._drag], axis=1)
        self._parameters = both.reshape(len(held), 4 * walker.num_feet)
        self._P = self._gain.num_variables - 2 * self._d
        counts = np.unique(self._gain.slope_places[1])
        self._counts = counts[counts < self._P]
        self.slope_places = np.array([np.zeros_like(self._counts), self._counts])
        self.curvature_places = self._counts[np.array(np.tril_indices(len(self._counts)))]

    def values(self, points: np.ndarray) -> np.ndarray:
        """The gain (..., 1)."""
        return self._gain.values(self._with_motions(points), self._parameters)

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """Derivatives at the ``slope_places`` (..., Z)."""
        _, slopes = self._gain.first(self._with_motions(points), self._parameters)
        return slopes[..., 0, self._counts]

    def curvatures(self, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · `values` at the ``curvature_places`` (..., Z)."""
        P, one = self._P, np.ones_like(weights)
        whole = self._gain.second(self._with_motions(points), one, self._parameters)
        change = whole[..., P:, :P]  # of the slopes of Φ by the motions, to which they give way
        given = change.swapaxes(-1, -2) @ np.linalg.solve(whole[..., P:, P:], change)
        return (weights[..., None] * (whole[..., :P, :P] - given))[..., *self.curvature_places]

    def _with_motions(self, points: np.ndarray) -> np.ndarray:
        """Arguments [p, v, w] of Φ (..., P + 2d)."""
        stiffness = self._standing.stiffness(points)
        by_feet = self._walker.feet_jacobian(points[..., : self._d])
        directions = np.einsum("...fc,...fcd->...dc", self._drag, by_feet)
        motions = np.linalg.solve(stiffness, directions)
        return np.concatenate([points, motions[..., 0], motions[..., 1]], axis=-1)
