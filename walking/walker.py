"""Potential and feet of a robot that walks, in symbols of its configuration.

The configuration y = [pose, q] is of the body, m and rad, and of the joints, rad. The limbs are
`Chain`s whose bases the body carries. A body that moves in the vertical plane has the pose x, z, θ;
one that moves in space has x, y, z, roll, pitch, yaw.
"""

from typing import Any

import casadi as ca
import numpy as np

from limb_systems import LimbModel
from limb_systems.segment_chain import rotation
from limb_systems.smooth_function import SmoothFunction, build_once
from limb_systems.symbolic_chain import Chain
from planners.transcription.solving import PlanningError
from walking.robot_parameters import RobotParameters


class Walker:
    """Potential and feet of a robot.

    For d coordinates y, of which B are the body's pose, F feet, and τ directions along the ground,
    x in a plane, x and y in space:

    - ``configuration``: the symbols y (d,).
    - ``pose_size``, ``num_feet``, ``num_tangents``: B, F and τ.
    - ``potential``: V of gravity and of the joints' springs, J, of y, as a `SmoothFunction`;
      ``symbolic_potential`` is its expression.
    - ``symbolic_feet``: travel s of the point of contact and height z of the centre of each foot
      (τ + 1, F), m. The travel of a foot that rolls without slip is constant.
    - ``stiffness``: k of the joints' springs, zero for the body (d,), N·m/rad.
    - ``rest``: y at which springs are relaxed (d,), rad.
    - ``weight``: weight of the whole robot, N, along the world's axes (3,).
    - ``height``: place of z among y.
    - ``last_joints``: the joint of each limb that carries its foot, among the joints (F,).
    - ``radius``: radius of the feet, m.
    - ``friction``: μ of the ground.
    - ``contact_stiffness``: stiffness of a foot and the ground in series, N/m.
    - ``size``: the longest limb's length, m.
    - ``key``: the same for robots with the same description.

    Args:
        robot: description of the robot.

    Raises:
        PlanningError: if nothing like it can walk.
    """

    def __init__(self, robot: RobotParameters):
        check_walker(robot)
        laws = (type(wire.law) for wire in robot.as_single_limb.wires)
        self.key = Walker, repr(robot), *laws
        self.__dict__.update(build_once(self.key, lambda: self._build_expressions(robot)))

    def _build_expressions(self, robot: RobotParameters) -> dict[str, Any]:
        """Build the attributes that all `Walker`s of a description share."""
        mechanics = LimbModel.of(robot.as_single_limb).mechanics
        B = robot.pose_size
        self.pose_size = B
        self.num_tangents = B // 3
        self.num_feet = len(robot.limbs)
        self.height = self.num_tangents
        self.stiffness = np.append(np.zeros(B), mechanics.stiffness)
        self.rest = np.append(np.zeros(B), mechanics.rest_angles)
        self.radius = robot.feet.radius
        assert robot.ground is not None  # or it would not walk
        self.friction = robot.ground.friction
        self.contact_stiffness = robot.contact_stiffness
        self.last_joints = [joints.stop - 1 for joints in robot.joints_of]

        # Add the masses of body and limbs, and the feet, in symbols of the configuration.
        y = self.configuration = ca.SX.sym("y", len(self.stiffness))
        origin, frame = _body_frame(y[:B])
        masses = [robot.body.mass]
        places = [origin]
        feet = []
        for limb, joints in zip(robot.limbs, robot.joints_of, strict=True):
            limb_mechanics = LimbModel.of(limb.parameters).mechanics
            chain = Chain(limb_mechanics, y[B + joints.start : B + joints.stop])
            base = origin + frame @ ca.DM(limb.position)
            to_world = frame @ ca.DM(limb.axes)
            last = limb_mechanics.layout.num_joints - 1
            end = limb_mechanics.end_offset[-1]
            bodies = [
                *zip(
                    limb_mechanics.body_joints,
                    limb_mechanics.body_masses,
                    limb_mechanics.body_centres,
                    strict=True,
                ),
                (last, robot.feet.mass, end),
            ]
            for joint, mass, centre in bodies:
                place = ca.DM(centre) if joint < 0 else chain.position(int(joint), centre)
                masses.append(mass)
                places.append(base + to_world @ place)
            tip = base + to_world @ chain.position(last, end)
            along = to_world @ chain.frames[last] @ ca.DM(end / np.linalg.norm(end))
            travel = tip[: self.num_tangents] + self.radius * self._roll_travel(along)
            feet.append(ca.vertcat(travel, tip[2]))

        # Build the potential from weights and springs.
        self.size = robot.longest_limb
        self.weight = sum(masses) * robot.world_gravity
        self.symbolic_feet = ca.horzcat(*feet)
        moment = sum(mass * place for mass, place in zip(masses, places, strict=True))
        springs = 0.5 * ca.dot(ca.DM(self.stiffness), (y - ca.DM(self.rest)) ** 2)
        self.symbolic_potential = springs - ca.dot(ca.DM(robot.world_gravity), moment)
        self.potential = SmoothFunction(self.symbolic_potential, y)
        self._feet = SmoothFunction(ca.vec(self.symbolic_feet), y)
        # A copy: the collector of Python 3.13 takes what only an object's own dictionary holds for
        # garbage as soon as the object itself is, whoever else has the dictionary.
        return dict(vars(self))

    def _roll_travel(self, along: ca.SX) -> ca.SX:
        """Return the travel of a rolling foot of radius 1 (τ,) from upright to its limb's end.

        It is the angle between the limb's end and the vertical. In space, where the ground sees the
        sine of it, it is the series of arcsin, to 1e-3 up to 45°.
        """
        if self.num_tangents == 1:
            return ca.atan2(along[0], -along[2])
        squared = along[0] ** 2 + along[1] ** 2
        powers = (1.0, 1 / 6, 3 / 40, 5 / 112, 35 / 1152)
        share = sum(power * squared**number for number, power in enumerate(powers))
        return share * along[:2]

    def feet(self, y: np.ndarray) -> np.ndarray:
        """Return s and z of each foot (..., F, τ + 1), m, of y (..., d)."""
        return self._feet.values(y).reshape(*y.shape[:-1], self.num_feet, self.num_tangents + 1)

    def feet_jacobian(self, y: np.ndarray) -> np.ndarray:
        """Return derivatives of `feet` by y (..., F, τ + 1, d)."""
        slopes = self._feet.first(y)[1]
        return slopes.reshape(*y.shape[:-1], self.num_feet, self.num_tangents + 1, y.shape[-1])


def _body_frame(pose: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return place (3,), m, and frame (3, 3) of a body with a pose in the plane or in space."""
    if pose.numel() == 3:
        x = pose[0]
        z = pose[1]
        pitch = -pose[2]
        return ca.vertcat(x, 0, z), rotation(1, pitch)
    roll, pitch, yaw = ca.vertsplit(pose[3:])
    return pose[:3], rotation(2, yaw) @ rotation(1, pitch) @ rotation(0, roll)


def check_walker(robot: RobotParameters) -> None:
    """Raise PlanningError if a robot cannot walk with any gait."""
    if robot.body.mount == "welded":
        raise PlanningError(
            "The body is welded, so that it cannot walk; set body.mount to planar or free."
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
    for limb in robot.limbs:
        above = limb.straight_height + robot.body.height / 2  # of the body's bottom
        if above >= 0:
            raise PlanningError(
                f"The foot of limb {limb.name} is {1e3 * above:.0f} mm above the bottom "
                "of the body where the limb is straight, so that the body would be on the ground; "
                "let e1 point down."
            )
