"""A robot that stands: balance of forces, and stability by the pivots of its stiffness.

A point p = [y, x, λ] has the configuration y of `PlanarRobot`, the states x of the wires and the
forces λ of the ground on each foot (tangential, normal), N. The Lagrangian is

    L(p) = V(y) - λ · feet(y),    ∂L/∂y = [0, f(x, q)] at rest

with the torques f of wires and rubber (4). Feet with friction couple the coordinates in a way
that is not symmetric, and equilibria that are just stable fall when disturbed a little. So the
pivots of LDLᵀ = ∂²L/∂y² - ∂f/∂q + ρ JᵀJ, with the rows J of the directions in which the ground
holds feet, have to be more than positive. Joints are eliminated first: what is left are the
stiffnesses against motion of the body in x, then z, then θ, the others being free.
"""

from collections.abc import Iterator

import numpy as np

from limb_systems import Wires
from planners.gait.planar_robot import POSE, PlanarRobot, turned

# ρ, N/m: a hundred times what limbs are, so that more of it would change pivots by percents.
GROUND_STIFFNESS = 1e4
# Least pivots. With less, gaits tip over a slightly uneven ground or slip of a foot: at 10 N/m, a
# tenth of a limb's weight moves the body by 1.5 mm; at 0.1 N·m/rad, it turns it by 1°.
LEAST_STIFFNESS = np.array([10.0, 10.0, 0.1])
LEAST_JOINT_STIFFNESS = 0.05  # of a joint's spring: limbs buckle at 0
LEAST_PIVOT = float(np.arcsinh(1.0))  # of `Standing.values`
_DIFFERENCE = 1e-5  # of central differences, in rad or typical changes of states


class Standing:
    """Balance, feet and pivots of a robot at points p (..., P), with exact derivatives.

    Values are the d forces of the balance, N and N·m; s and z of each foot, m; and the pivots:
    of the last joint of each limb, N·m/rad, whose sign is the first to change, and of the body
    in x and z, N/m, and θ, N·m/rad. They are (..., m), with m = d + 2F + F + 3.

    Args:
        robot: mechanics of the robot.
        wires: wires of all its limbs.
        held: 1 where the ground holds a foot in (x, z), otherwise 0 (K, F, 2); any
            number of points before the last axis of p then has to be K.
    """

    def __init__(self, robot: PlanarRobot, wires: Wires, held: np.ndarray):
        self._least = np.append(LEAST_JOINT_STIFFNESS * robot.spring_of_tip, LEAST_STIFFNESS)
        self._robot, self._wires = robot, wires
        self._d, self._N, self._F = len(robot.stiffness), wires.num_states, robot.num_feet
        self.num_values = self._d + 3 * self._F + POSE
        self.held = held
        # Joints first, then the body; coordinates of the pivots that count.
        self._order = np.append(np.arange(POSE, self._d), np.arange(POSE))
        last = [int(np.flatnonzero(robot.turns[tip])[-1]) - POSE for tip in robot.tips]
        self._pivots = [*last, *range(self._d - POSE, self._d)]

    def split(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """y (..., d), x (..., N) and λ (..., F, 2) of points."""
        y, x, forces = np.split(points, [self._d, self._d + self._N], axis=-1)
        return y, x, forces.reshape(*forces.shape[:-1], self._F, 2)

    def values(self, points: np.ndarray) -> np.ndarray:
        """Balance, feet and pivots (..., m)."""
        y, x, forces = self.split(points)
        feet = self._robot.feet(y).swapaxes(-1, -2)
        pivots = [
            np.arcsinh(pivot[..., None] / least)
            for (pivot, _, _), least in zip(
                self._eliminated(self.stiffness(points)), self._least, strict=True
            )
        ]
        parts = [self._balance(y, x, forces), feet.reshape(*y.shape[:-1], -1), *pivots]
        return np.concatenate(parts, axis=-1)

    def stiffness(self, points: np.ndarray) -> np.ndarray:
        """∂²L/∂y² - ∂f/∂q + ρ JᵀJ (..., d, d)."""
        _, _, stiffness, arms = self._expanded(*self.split(points))
        return self._grounded(stiffness, arms)[1]

    def derivatives(self, points: np.ndarray) -> np.ndarray:
        """Derivatives of `values` by the points (..., m, P)."""
        y, x, forces = self.split(points)
        d, N, F = self._d, self._N, self._F
        _, torque, stiffness, arms = self._expanded(y, x, forces)
        jacobian = self._robot.feet_jacobian(arms)
        result = np.zeros((*points.shape[:-1], self.num_values, points.shape[-1]))
        result[..., :d, :d] = stiffness
        result[..., POSE:d, d : d + N] = -self._wires.force_derivatives(x, y[..., POSE:])[0]
        by_force = jacobian.reshape(*jacobian.shape[:-3], 2 * F, d)
        result[..., :d, d + N :] = -by_force.swapaxes(-1, -2)
        result[..., d : d + 2 * F, :d] = jacobian.swapaxes(-2, -3).reshape(by_force.shape)
        _, whole = self._grounded(stiffness, arms)
        for row, (pivot, v, _) in enumerate(self._eliminated(whole), start=d + 2 * F):
            w = v @ self._robot.turns.T
            along, slopes, _ = self._along_held(arms, v, w)
            by_angle = 2 * GROUND_STIFFNESS * np.einsum("...c,...ca", along, slopes) - torque * w**2
            result[..., row, :d] = by_angle @ self._robot.turns
            if self._wires.torque_needs_angle:
                curvature = self._torque_curvature(x, y, v)[..., : d - POSE, :]
                result[..., row, POSE : d + N] -= np.einsum("...i,...ij", v[..., POSE:], curvature)
            by_load = np.einsum("...fca,...a->...fc", arms, w**2)
            result[..., row, d + N :] = by_load.reshape(*by_load.shape[:-2], -1)
            least = self._least[row - d - 2 * F]
            result[..., row, :] /= np.hypot(pivot, least)[..., None]
        return result

    def curvature(self, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · `values` by the points (..., P, P).

        What is left out are the third derivatives of torques by angles.
        """
        y, x, forces = self.split(points)
        d, N, F, turns = self._d, self._N, self._F, self._robot.turns
        energy, torque, stiffness, arms = self._expanded(y, x, forces)
        on_balance, on_feet, on_pivots = np.split(weights, [d, d + 2 * F], axis=-1)
        on_feet = on_feet.reshape(*on_feet.shape[:-1], 2, F).swapaxes(-1, -2)
        on_arms = on_balance @ turns.T
        of_angles = _diagonal(-torque * on_arms - np.einsum("...fc,...fca->...a", on_feet, arms))
        by_load = arms * on_arms[..., None, None, :]
        result = np.zeros((*points.shape, points.shape[-1]))
        moved = slice(POSE, d + N)
        result[..., moved, moved] -= self._torque_curvature(x, y, on_balance)
        rows, whole = self._grounded(stiffness, arms)
        turn, directions = turned(arms), self._by_direction(arms)
        slopes_of_pivots = self.derivatives(points)[..., d + 2 * F :, :]
        for number, (pivot, v, before) in enumerate(self._eliminated(whole)):
            size = np.hypot(pivot, self._least[number])[..., None, None]
            weight, w = on_pivots[..., number, None, None] / size, v @ turns.T
            along, slopes, bends = self._along_held(arms, v, w)
            own = energy * w**2 + 2 * GROUND_STIFFNESS * np.einsum("...c,...ca", along, bends)
            crossed = 2 * GROUND_STIFFNESS * slopes.swapaxes(-1, -2) @ slopes
            of_angles += weight * (_diagonal(own) + crossed)
            by_load += (weight * w[..., None, :] ** 2)[..., None, :, :] * turn
            # Changes of the stiffness times v, to which the eliminated coordinates give way
            change = np.zeros((*points.shape[:-1], d, points.shape[-1]))
            turning = -torque * w - GROUND_STIFFNESS * np.einsum("...c,...ca", along, directions)
            change[..., :d] = turns.T @ (turning[..., None] * turns)
            change[..., :d] += GROUND_STIFFNESS * rows.swapaxes(-1, -2) @ (slopes @ turns)
            loads = self._by_direction(arms * w[..., None, None, :], held=False) @ turns
            change[..., d + N :] = loads.swapaxes(-1, -2)
            if self._wires.torque_needs_angle:
                change[..., POSE:d, moved] -= self._torque_curvature(x, y, v)[..., : d - POSE, :]
            change = change[..., before, :]
            kept = whole[..., before[:, None], before]
            result -= 2 * weight * (change.swapaxes(-1, -2) @ np.linalg.solve(kept, change))
            slope = slopes_of_pivots[..., number, :]
            bent = weight * pivot[..., None, None] * slope[..., :, None] * slope[..., None, :]
            result -= bent
        result[..., :d, :d] += turns.T @ of_angles @ turns
        mixed = by_load.reshape(*by_load.shape[:-3], 2 * F, -1) @ turns
        result[..., d + N :, :d] += mixed
        result[..., :d, d + N :] += mixed.swapaxes(-1, -2)
        return result

    def _balance(self, y: np.ndarray, x: np.ndarray, forces: np.ndarray) -> np.ndarray:
        by_feet = self._robot.feet_jacobian(self._robot.arms(y))
        balance = self._robot.gradient(y) - np.einsum("...fc,...fcd->...d", forces, by_feet)
        balance[..., POSE:] -= self._wires.forces(x, y[..., POSE:])
        return balance

    def _expanded(self, y: np.ndarray, x: np.ndarray, forces: np.ndarray) -> tuple:
        """Parts of L that turn with ψ and their derivatives (..., A), its second derivative by y
        less that of the torque by q (..., d, d), and the feet's arms."""
        arms = self._robot.arms(y)
        energy, torque = self._robot.potential_arms(y)
        energy = energy - np.einsum("...fc,...fca->...a", forces, arms)
        torque = torque - np.einsum("...fc,...fca->...a", forces, turned(arms))
        turns = self._robot.turns
        stiffness = np.diag(self._robot.stiffness) - turns.T @ (energy[..., None] * turns)
        by_angle = self._wires.force_derivatives(x, y[..., POSE:])[1]
        if by_angle is not None:
            stiffness[..., POSE:, POSE:] -= by_angle
        return energy, torque, stiffness, arms

    def _by_direction(self, of_feet: np.ndarray, held: bool = True) -> np.ndarray:
        """(..., F, 2, A) as (..., 2F, A), zero for what is not held if so asked."""
        if held:
            of_feet = of_feet * self.held[..., None]
        return of_feet.reshape(*of_feet.shape[:-3], 2 * self._F, -1)

    def _grounded(self, stiffness: np.ndarray, arms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """J (..., 2F, d), and the stiffness with ρ JᵀJ."""
        rows = self._by_direction(self._robot.feet_jacobian(arms))
        return rows, stiffness + GROUND_STIFFNESS * rows.swapaxes(-1, -2) @ rows

    def _along_held(self, arms: np.ndarray, v: np.ndarray, w: np.ndarray) -> tuple:
        """J v (..., 2F), and its first and second derivatives by each ψ (..., 2F, A)."""
        rows = self._by_direction(self._robot.feet_jacobian(arms))
        slopes, bends = (
            -self._by_direction(part) * w[..., None, :] for part in (arms, turned(arms))
        )
        return (rows @ v[..., None])[..., 0], slopes, bends

    def _eliminated(self, whole: np.ndarray) -> Iterator[tuple[np.ndarray, ...]]:
        """Each pivot (...), the motion v (..., d) whose stiffness vᵀ H v it is, and the
        coordinates that were eliminated before it."""
        for number in self._pivots:
            before, own = self._order[:number], self._order[number]
            way = np.linalg.solve(
                whole[..., before[:, None], before], whole[..., before, own, None]
            )
            v = np.zeros(whole.shape[:-1], whole.dtype)
            v[..., own], v[..., before] = 1.0, -way[..., 0]
            yield np.einsum("...i,...i->...", whole[..., own, :], v), v, before

    def _torque_curvature(self, x: np.ndarray, y: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · [0, f] by [q, x] (..., n + N, n + N)."""
        wires, q, weights = self._wires, y[..., POSE:], weights[..., POSE:]
        n = q.shape[-1]
        result = np.zeros((*q.shape[:-1], n + self._N, n + self._N))
        if wires.laws_need_angle:
            steps = _DIFFERENCE * np.append(np.ones(n), wires.heat_scales[: self._N])
            for number, step in enumerate(np.diag(steps)):
                ends: list[np.ndarray] = [
                    np.concatenate(
                        wires.force_derivatives(x + side[n:], q + side[:n])[::-1],  # type: ignore[arg-type]
                        axis=-1,
                    )
                    for side in (step, -step)
                ]
                change = (ends[0] - ends[1]) / (2 * steps[number])
                result[..., number, :] = np.einsum("...n,...nk->...k", weights, change)
            return result
        if wires.torque_needs_angle:
            result[..., :n, :n] = wires.force_hessian_by_angle(q, weights)
        if not wires.torque_is_affine:
            result[..., n:, n:] = wires.force_hessian(x, q, weights)
        return result


def _diagonal(values: np.ndarray) -> np.ndarray:
    return values[..., None] * np.eye(values.shape[-1])
