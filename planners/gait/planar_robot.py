"""Statics of a planar robot on its feet, in closed form over any number of knots.

Every link has an absolute angle ψ = C y from +x towards +z, linear in the configuration
y = [x, z, θ, q] of body and joints, and every position is that of the body and a sum of arms
turned by these angles. Potential, feet and their derivatives are then sums of sines and cosines:
an arm (a, b) has the position (a cos ψ - b sin ψ, a sin ψ + b cos ψ), whose derivative by ψ is
(-z, x), and whose second derivative is itself with the other sign.
"""

import numpy as np

from limb_systems import Layout, RobotParameters
from limb_systems.model.kinematics import rest_joint_angles
from planners.transcription.solving import PlanningError

POSE = 3  # x, z and θ of the body, before the joints


class PlanarRobot:
    """Potential and feet of a robot whose limbs move in the plane of its body.

    Arrays have the coordinates along their last axis and any number of knots before it; for d
    coordinates, A angles ψ and F feet.

    - ``turns``: C, derivative of ψ by y (A, d).
    - ``stiffness``: k of the joints' springs, zero for the body (d,), N·m/rad.
    - ``rest``: y at which springs are relaxed (d,), rad.
    - ``weight``: weight of the whole robot along the world's (x, z), N.
    - ``tips``: angle of the last link of each limb, among ψ (F,).
    - ``radius``: radius of the feet, m.

    Args:
        robot: description of the robot, on a planar body.

    Raises:
        PlanningError: if nothing like it can walk.
    """

    def __init__(self, robot: RobotParameters):
        _check(robot)
        num_joints = robot.together.num_joints
        turns = [np.eye(POSE + num_joints)[2]]  # ψ of the body itself
        moments = [np.zeros(2)]  # Σ m (a, b) of each arm
        arms: list[np.ndarray] = []  # of each foot (A, 2)
        mass = robot.body.mass
        tips = []
        self.radius = robot.feet.radius
        for limb, joints in zip(robot.limbs, robot.joints_of, strict=True):
            layout = Layout(limb.parameters)
            base = np.array([limb.position[0], limb.position[2]])
            along, across = limb.axes[[0, 2], 0], limb.axes[[0, 2], 1]
            sign = np.sign(along[0] * across[1] - along[1] * across[0])
            n, first = layout.num_joints, len(turns)
            ends = np.append(layout.offsets[1:, 0], layout.end_offset[-1, 0])
            bodies = [
                *zip(layout.body_joints, layout.body_masses, layout.body_centres, strict=True)
            ]
            bodies.append((n - 1, robot.feet.mass, [ends[-1]]))
            carried = np.zeros((n + 1, 2))  # by the body, then by each link
            hip = base + layout.offsets[0, 0] * along
            for joint, of_body, centre in bodies:
                mass += of_body
                if joint < 0:  # what is before the first joint
                    carried[0] += of_body * (base + centre[0] * along)
                    continue
                carried[0] += of_body * hip
                carried[1 : joint + 1] += np.outer(of_body * ends[:joint], along)
                carried[joint + 1] += of_body * centre[0] * along
            moments[0] = moments[0] + carried[0]
            for joint in range(n):
                turn = turns[0].copy()
                turn[POSE + joints.start : POSE + joints.start + joint + 1] = sign
                turns.append(turn)
                moments.append(carried[joint + 1])
            of_foot = np.zeros((len(moments), 2))
            of_foot[0], of_foot[first:] = hip, np.outer(ends, along)
            arms.append(of_foot)
            tips.append(len(turns) - 1)
        self.turns, self.tips = np.array(turns), np.array(tips)
        layout = Layout(robot.together)
        self.stiffness = np.append(np.zeros(POSE), layout.stiffness)
        self.rest = np.append(np.zeros(POSE), rest_joint_angles(robot.together))
        gravity = np.array([robot.world_gravity[0], robot.world_gravity[2]])
        self.weight = mass * gravity
        self._fixed = np.zeros((len(tips), 2, len(self.stiffness)))  # part of feet linear in y
        self._fixed[:, 0, 0] = self._fixed[:, 1, 1] = 1.0
        self._fixed[:, 0] += self.radius * self.turns[tips]
        self._arms = np.zeros((len(tips), len(turns), 2))
        for of_foot, known in zip(self._arms, arms, strict=True):
            of_foot[: len(known)] = known
        # Potential of an arm, as components of it along cos ψ and sin ψ
        (gx, gz), (a, b) = gravity, np.array(moments).T
        self.spring_of_tip = np.array(
            [self.stiffness[np.flatnonzero(self.turns[tip])[-1]] for tip in tips]
        )
        self._heights = -np.array([gx * a + gz * b, gz * a - gx * b])

    @property
    def size(self) -> float:
        """The longest limb's length, m."""
        return float(self._arms[:, 1:].sum(axis=1).__abs__().max())

    @property
    def num_feet(self) -> int:
        """F, one for each limb."""
        return len(self.tips)

    def potential(self, y: np.ndarray) -> np.ndarray:
        """V (...), J, of gravity and of the joints' springs."""
        cosine, sine = self._directions(y)
        springs = 0.5 * self.stiffness * (y - self.rest) ** 2
        along, across = self._heights
        arms = (along * cosine + across * sine).sum(axis=-1)
        return arms + springs.sum(axis=-1) - y[..., :2] @ self.weight

    def feet(self, y: np.ndarray) -> np.ndarray:
        """Travel s of the point of contact and height z of the centre of each foot (..., F, 2), m.

        A foot that rolls without slip has a constant s = x + r ψ, with x of its centre.
        """
        return np.einsum("fcd,...d->...fc", self._fixed, y) + self.arms(y).sum(axis=-1)

    def feet_jacobian(self, arms: np.ndarray) -> np.ndarray:
        """Derivative of `feet` by y (..., F, 2, d), from their `arms`."""
        return self._fixed + turned(arms) @ self.turns

    def arms(self, y: np.ndarray) -> np.ndarray:
        """Parts of x and z of each foot that turn with each ψ (..., F, 2, A), m."""
        cosine, sine = (part[..., None, :] for part in self._directions(y))
        a, b = self._arms[..., 0], self._arms[..., 1]
        return np.stack([a * cosine - b * sine, a * sine + b * cosine], axis=-2)

    def gradient(self, y: np.ndarray) -> np.ndarray:
        """dV/dy (..., d), N and N·m."""
        gradient = self.potential_arms(y)[1] @ self.turns + self.stiffness * (y - self.rest)
        gradient[..., :2] -= self.weight
        return gradient

    def potential_arms(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Parts of V that turn with each ψ, and their derivatives by it, (..., A), J."""
        cosine, sine = self._directions(y)
        along, across = self._heights
        return along * cosine + across * sine, across * cosine - along * sine

    def _directions(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        angles = y @ self.turns.T
        return np.cos(angles), np.sin(angles)


def turned(arms: np.ndarray) -> np.ndarray:
    """Derivative of (x, z) (..., 2, A) by the angle of each arm, (-z, x)."""
    return np.stack([-arms[..., 1, :], arms[..., 0, :]], axis=-2)


def _check(robot: RobotParameters) -> None:
    """Raises PlanningError if a robot cannot walk, whatever it does."""
    if robot.body.mount != "planar":
        raise PlanningError(
            f"The body is {robot.body.mount}, but gaits are planned in the vertical plane; set "
            "body.mount to planar."
        )
    if robot.ground is None:
        raise PlanningError("The robot has no ground to walk on; give it one.")
    if len(robot.limbs) < 2:
        raise PlanningError(
            "The robot has one limb, and so one foot, which cannot slide while another sticks; a "
            "gait needs two or more."
        )
    if not robot.ground.friction:
        raise PlanningError(
            "The ground has no friction (ground.friction is 0), so that no foot can push the body."
        )
    if abs(np.tan(robot.ground.slope)) >= robot.ground.friction:
        raise PlanningError(
            f"The ground slopes by {np.rad2deg(robot.ground.slope):.3g}°, where a robot slides "
            f"down with a friction of {robot.ground.friction:g} whatever it does."
        )
    lowest = -robot.body.height / 2
    for limb in robot.limbs:
        length = sum(segment.length for segment in limb.parameters.segments)
        tip = limb.position[2] + limb.axes[2, 0] * length
        if tip >= lowest:
            raise PlanningError(
                f"The foot of limb {limb.name} is {1e3 * (tip - lowest):.0f} mm above the bottom "
                "of the body where the limb is straight, so that the body would be on the ground; "
                "let e1 point down."
            )
