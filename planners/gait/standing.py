"""A robot that stands: balance of forces, and stability by the pivots of its stiffness.

A point p = [y, x, λ, s] has the configuration y of `PlanarRobot`, the states x of the wires, the
forces λ of the ground on each foot (tangential, normal), N, and the travel s of each foot, m. The
Lagrangian is

    L(p) = V(y) - λ · feet(y),    ∂L/∂y = [0, f(x, q)] at rest

with the torques f of wires and rubber (4). Feet with friction couple the coordinates in a way
that is not symmetric, and equilibria that are just stable fall when disturbed a little. So the
pivots of LDLᵀ = ∂²L/∂y² - ∂f/∂q + ρ JᵀJ, with the rows J of the directions in which the ground
holds feet, have to be more than positive. Joints are eliminated first: what is left are the
stiffnesses against motion of the body in x, then z, then θ, the others being free.

A pivot is the stiffness vᵀ H v of the motion v that the eliminated coordinates follow. v is
stationary, so that the pivot's derivative is that of Φ(p, v) = vᵀ H(p) v at constant v, and its
curvature is Φ's less what the eliminated coordinates give way.
"""

from collections.abc import Iterator

import casadi as ca
import numpy as np

from limb_systems import Wires
from limb_systems.model.smooth_function import SmoothFunction
from planners.gait.planar_robot import POSE, PlanarRobot

# ρ, N/m: a hundred times what limbs are, so that more of it would change pivots by percents.
GROUND_STIFFNESS = 1e4
# Least pivots. With less, gaits tip over a slightly uneven ground or slip of a foot: at 10 N/m, a
# tenth of a limb's weight moves the body by 1.5 mm; at 0.1 N·m/rad, it turns it by 1°.
LEAST_STIFFNESS = np.array([10.0, 10.0, 0.1])
LEAST_JOINT_STIFFNESS = 0.05  # of a joint's spring: limbs buckle at 0
LEAST_PIVOT = float(np.arcsinh(1.0))  # of `Standing.values`


class Standing:
    """Balance, feet and pivots of a robot at points p (..., P), with exact derivatives.

    Values are the d forces of the balance, N and N·m; the travel of each foot less s, m, and its
    height z, m; and asinh of the pivots over the least ones: of the last joint of each limb, whose
    sign is the first to change, and of the body in x, z and θ. They are (..., m), with
    m = d + 2F + F + 3. The class is a `planners.transcription.function_block.PointFunction`.

    Args:
        robot: mechanics of the robot.
        wires: wires of all its limbs.
        held: 1 where the ground holds a foot in (x, z), otherwise 0 (K, F, 2); any
            number of points before the last axis of p then has to be K.
    """

    def __init__(self, robot: PlanarRobot, wires: Wires, held: np.ndarray):
        d, N, F = len(robot.stiffness), wires.num_states, robot.num_feet
        self._d, self._N, self._F = d, N, F
        self.num_values = d + 3 * F + POSE
        self._held = held.reshape(*held.shape[:-2], 2 * F)
        self._least = np.append(
            LEAST_JOINT_STIFFNESS * robot.stiffness[POSE:][robot.last_joints], LEAST_STIFFNESS
        )
        # Joints first, then the body; coordinates of the pivots that count.
        self._order = np.append(np.arange(POSE, d), np.arange(POSE))
        self._pivots = [*robot.last_joints, *range(d - POSE, d)]

        y, feet = robot.configuration, ca.vec(robot.symbolic_feet)
        x, forces, travel = ca.SX.sym("x", N), ca.SX.sym("f", 2 * F), ca.SX.sym("s", F)
        v, on_ground = ca.SX.sym("v", d), ca.SX.sym("held", 2 * F)
        lagrangian = robot.symbolic_potential - ca.dot(forces, feet)
        torques = ca.vertcat(ca.SX(POSE, 1), wires.symbolic_force(x, y[POSE:]))
        balance = ca.gradient(lagrangian, y) - torques
        s, z = robot.symbolic_feet[0, :].T, robot.symbolic_feet[1, :].T
        point = ca.vertcat(y, x, forces, travel)
        self._of_point = SmoothFunction(ca.vertcat(balance, s - travel, z), point)
        along = ca.jtimes(feet, y, v)
        own = ca.jtimes(balance, y, v)
        energy = ca.dot(v, own) + GROUND_STIFFNESS * ca.dot(on_ground, along**2)
        self._energy = SmoothFunction(energy, ca.vertcat(point, v), on_ground)
        stiffness = ca.vec(ca.hessian(energy, v)[0] / 2)
        self._stiffness = SmoothFunction(stiffness, point, on_ground)
        self.slope_places, self.curvature_places = self._places()

    def split(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """y (..., d), x (..., N) and λ (..., F, 2) of points."""
        y, x, forces, _ = np.split(points, np.cumsum([self._d, self._N, 2 * self._F]), axis=-1)
        return y, x, forces.reshape(*forces.shape[:-1], self._F, 2)

    def values(self, points: np.ndarray) -> np.ndarray:
        """Balance, feet and pivots (..., m)."""
        pivots = np.stack([pivot for pivot, _, _, _ in self._eliminated(points)], axis=-1)
        return np.concatenate(
            [self._of_point.values(points), np.arcsinh(pivots / self._least)], axis=-1
        )

    def stiffness(self, points: np.ndarray) -> np.ndarray:
        """∂²L/∂y² - ∂f/∂q + ρ JᵀJ (..., d, d)."""
        return self._stiffness.values(points, self._held).reshape(
            *points.shape[:-1], self._d, self._d
        )

    def derivatives(self, points: np.ndarray) -> np.ndarray:
        """Derivatives of `values` by the points (..., m, P)."""
        _, of_point = self._of_point.first(points)
        of_pivots = [slope[..., None, :] for _, slope in self._expanded(points)]
        return np.concatenate([of_point, *of_pivots], axis=-2)

    def second(self, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · `values` by the points (..., P, P)."""
        P, first_pivot = points.shape[-1], self.num_values - len(self._pivots)
        result = self._of_point.second(points, weights[..., :first_pivot])
        for number, ((pivot, v, before, kept), slope) in enumerate(self._expanded(points)):
            size = np.hypot(pivot, self._least[number])
            weight = weights[..., first_pivot + number] / size
            both = self._energy.second(
                np.concatenate([points, v], axis=-1), weight[..., None], self._held
            )
            change = 0.5 * both[..., P + before, :P]  # of H v, times the weight
            gives_way = change.swapaxes(-1, -2) @ np.linalg.solve(kept, change)
            by_weight = np.divide(1.0, weight, out=np.zeros_like(weight), where=weight != 0)
            result += both[..., :P, :P] - 2 * by_weight[..., None, None] * gives_way
            bent = (weight * pivot)[..., None, None] * slope[..., :, None] * slope[..., None, :]
            result -= bent
        return result

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """`derivatives` at the ``slope_places`` (..., Z)."""
        return self.derivatives(points)[..., *self.slope_places]

    def curvatures(self, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """`second` at the ``curvature_places`` (..., Z)."""
        return self.second(points, weights)[..., *self.curvature_places]

    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Where first and second derivatives may not be zero."""
        of_energy = self._energy
        P, m = of_energy.num_variables - self._d, self.num_values
        slopes, curved = np.zeros((m, P), bool), np.zeros((P, P), bool)
        slopes[tuple(self._of_point.slope_places)] = True
        counts = np.unique(of_energy.slope_places[1])
        counts = counts[counts < P]
        slopes[m - len(self._pivots) :, counts] = True
        curved[np.ix_(counts, counts)] = True
        curved[tuple(self._of_point.curvature_places)] = True
        return np.array(slopes.nonzero()), np.array(np.tril(curved | curved.T).nonzero())

    def _expanded(self, points: np.ndarray) -> Iterator[tuple[tuple, np.ndarray]]:
        """What `_eliminated` says of each pivot, and the derivative of its asinh (..., P)."""
        for least, found in zip(self._least, self._eliminated(points), strict=True):
            pivot, v, _, _ = found
            _, slopes = self._energy.first(np.concatenate([points, v], axis=-1), self._held)
            yield found, slopes[..., 0, : points.shape[-1]] / np.hypot(pivot, least)[..., None]

    def _eliminated(self, points: np.ndarray) -> Iterator[tuple[np.ndarray, ...]]:
        """Each pivot (...) and what belongs to it.

        These are the motion v (..., d) whose stiffness vᵀ H v the pivot is, the coordinates that
        were eliminated before it, and their stiffness.
        """
        whole = self.stiffness(points)
        for number in self._pivots:
            before, own = self._order[:number], self._order[number]
            kept = whole[..., before[:, None], before]
            v = np.zeros(whole.shape[:-1])
            v[..., own] = 1.0
            v[..., before] = -np.linalg.solve(kept, whole[..., before, own, None])[..., 0]
            yield np.einsum("...i,...i->...", whole[..., own, :], v), v, before, kept
