"""Potential and feet of a planar robot, in symbols of its configuration.

The configuration y = [x, z, θ, q] is of the body in the vertical plane, m and rad, and of the
joints, rad. The limbs are `Chain`s whose bases the body carries.
"""

from typing import Any

import casadi as ca
import numpy as np

from limb_systems import Layout, RobotParameters
from limb_systems.model.kinematics import Chain, rest_joint_angles
from limb_systems.model.smooth_function import SmoothFunction, stated_once
from planners.transcription.solving import PlanningError

POSE = 3  # x, z and θ of the body, before the joints


class PlanarRobot:
    """Potential and feet of a robot whose limbs move in the plane of its body.

    For d coordinates y and F feet:

    - ``configuration``: the symbols y (d,).
    - ``potential``: V of gravity and of the joints' springs, J, of y, as a `SmoothFunction`;
      ``symbolic_potential`` is its expression.
    - ``symbolic_feet``: travel s of the point of contact and height z of the centre of each foot
      (2, F), m. A foot that rolls without slip has a constant s = x + r ψ, with x of its centre and
      ψ of its link.
    - ``stiffness``: k of the joints' springs, zero for the body (d,), N·m/rad.
    - ``rest``: y at which springs are relaxed (d,), rad.
    - ``weight``: weight of the whole robot along the world's (x, z), N.
    - ``last_joints``: the joint of each limb that carries its foot, among the joints (F,).
    - ``radius``: radius of the feet, m.
    - ``size``: the longest limb's length, m.
    - ``key``: the same for robots with the same description.

    Args:
        robot: description of the robot, on a planar body.

    Raises:
        PlanningError: if nothing like it can walk.
    """

    def __init__(self, robot: RobotParameters):
        check_walker(robot)
        laws = (type(wire.law) for wire in robot.together.wires)
        self.key = PlanarRobot, repr(robot), *laws
        self.__dict__.update(stated_once(self.key, lambda: self._stated(robot)))

    def _stated(self, robot: RobotParameters) -> dict[str, Any]:
        """The attributes of all `PlanarRobot`s of a description."""
        layout = Layout(robot.together)
        self.stiffness = np.append(np.zeros(POSE), layout.stiffness)
        self.rest = np.append(np.zeros(POSE), rest_joint_angles(robot.together))
        self.radius, self.num_feet = robot.feet.radius, len(robot.limbs)
        self.last_joints = [joints.stop - 1 for joints in robot.joints_of]
        y = self.configuration = ca.SX.sym("y", len(self.stiffness))
        masses, places, feet, lengths = [robot.body.mass], [y[:2]], [], []
        for limb, joints in zip(robot.limbs, robot.joints_of, strict=True):
            of_limb = Layout(limb.parameters)
            q = y[POSE + joints.start : POSE + joints.stop]
            chain, to_body = Chain(of_limb, q), ca.DM(limb.axes)
            along, across = limb.axes[[0, 2], 0], limb.axes[[0, 2], 1]
            last, end = of_limb.num_joints - 1, of_limb.end_offset[-1]
            bodies = [
                *zip(of_limb.body_joints, of_limb.body_masses, of_limb.body_centres, strict=True),
                (last, robot.feet.mass, end),
            ]
            for joint, mass, centre in bodies:
                place = ca.DM(centre) if joint < 0 else chain.position(int(joint), centre)
                masses.append(mass)
                places.append(self._in_world(limb.position, to_body @ place))
            tip = self._in_world(limb.position, to_body @ chain.position(last, end))
            sense = np.sign(along[0] * across[1] - along[1] * across[0])
            turned = y[2] + sense * ca.sum(q)
            feet.append(ca.vertcat(tip[0] + self.radius * turned, tip[1]))
            lengths.append((of_limb.offsets[1:, 0].sum() + end[0]) * np.abs(along).max())
        self.size = float(max(lengths))
        gravity = np.array([robot.world_gravity[0], robot.world_gravity[2]])
        self.weight = sum(masses) * gravity
        self.symbolic_feet = ca.horzcat(*feet)
        moment = sum(mass * place for mass, place in zip(masses, places, strict=True))
        springs = 0.5 * ca.dot(ca.DM(self.stiffness), (y - ca.DM(self.rest)) ** 2)
        self.symbolic_potential = springs - ca.dot(ca.DM(gravity), moment)
        self.potential = SmoothFunction(self.symbolic_potential, y)
        self._feet = SmoothFunction(ca.vec(self.symbolic_feet), y)
        # A copy: the collector of Python 3.13 takes what only an object's own dictionary holds for
        # garbage as soon as the object itself is, whoever else has the dictionary.
        return dict(vars(self))

    def feet(self, y: np.ndarray) -> np.ndarray:
        """s and z of each foot (..., F, 2), m, of y (..., d)."""
        return self._feet.values(y).reshape(*y.shape[:-1], self.num_feet, 2)

    def feet_jacobian(self, y: np.ndarray) -> np.ndarray:
        """Derivatives of `feet` by y (..., F, 2, d)."""
        slopes = self._feet.first(y)[1]
        return slopes.reshape(*y.shape[:-1], self.num_feet, 2, y.shape[-1])

    def _in_world(self, base: list[float], place: ca.SX | ca.DM) -> ca.SX:
        """(x, z) of a place (3,) from a limb's base (3,), in the body's frame."""
        y, (a, _, b) = self.configuration, ca.vertsplit(ca.DM(base) + place)
        cosine, sine = ca.cos(y[2]), ca.sin(y[2])
        return ca.vertcat(y[0] + a * cosine - b * sine, y[1] + a * sine + b * cosine)


def check_walker(robot: RobotParameters) -> None:
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
