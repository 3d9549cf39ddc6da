"""A robot in 3D: seen from its right side, on a ground with marks that is tilted as it slopes."""

import numpy as np
from pydrake.geometry import Box, Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant

from limb_systems.limb_parameters import LimbParameters
from limb_systems.views.limb_view import LimbView
from walking.robot import add_robot, set_positions
from walking.robot_parameters import RobotParameters

MARK_SPACING = 0.01  # m, from mark to mark on the ground
MARKS_PER_WIDE_MARK = 5  # marks after which one is wider
_CAMERA_DIRECTION = (0.0, -0.97, 0.26)  # direction to the camera
_GROUND_COLOR = (0.97, 0.98, 0.96)
_MARK_COLOR = (0.62, 0.64, 0.66)


class RobotView(LimbView):
    """A robot on its ground; see `LimbView`. Without a pose it stands on straight limbs."""

    MODEL = "robot"
    LIGHT = (-4.0, -10.0, 5.0)

    def __init__(self, meshcat: Meshcat, robot: RobotParameters):
        """
        Args:
            meshcat: scene that the robot is put into.
            robot: the robot.
        """
        self._robot = robot
        super().__init__(meshcat, robot.as_single_limb)

    def _base_pose(self) -> RigidTransform:
        slope = self._robot.ground.slope if self._robot.ground else 0.0
        return RigidTransform(RotationMatrix.MakeYRotation(-slope), np.zeros(3))

    def _limbs(self) -> dict[str, LimbParameters]:
        return {f"{limb.name}_": limb.parameters for limb in self._robot.limbs}

    def _to_eye(self) -> tuple[float, float, float]:
        return _CAMERA_DIRECTION

    def _add_model(self, plant: MultibodyPlant) -> None:
        add_robot(plant, self._robot)

    def _set_positions(self, joint_angles: np.ndarray, body_pose: np.ndarray | None) -> None:
        set_positions(self._plant, self._context, self._robot, body_pose, joint_angles)

    def _add_surroundings(self, low: np.ndarray, high: np.ndarray) -> None:
        """Put the ground below the bodies, with a mark each 10 mm along x."""
        if not self._robot.ground:
            return
        step = MARKS_PER_WIDE_MARK * MARK_SPACING
        path = "ground"
        first = np.floor(low[0] / step) - 1
        last = np.ceil(high[0] / step) + 1
        middle = (low[1] + high[1]) / 2
        depth = high[1] - low[1] + 2.0 * self._robot.body.width
        size = (last - first) * step, depth, MARK_SPACING / 5
        center = [(first + last) / 2 * step, middle, -size[2] / 2]
        self._meshcat.SetObject(f"{path}/plane", Box(*size), Rgba(*_GROUND_COLOR))
        self._meshcat.SetTransform(f"{path}/plane", RigidTransform(center))
        for number in range(round((last - first) * MARKS_PER_WIDE_MARK) + 1):
            mark = Box(MARK_SPACING * (0.05 if number % MARKS_PER_WIDE_MARK else 0.15), depth, 1e-5)
            self._meshcat.SetObject(f"{path}/mark_{number}", mark, Rgba(*_MARK_COLOR))
            at = [first * step + number * MARK_SPACING, middle, 1e-5]
            self._meshcat.SetTransform(f"{path}/mark_{number}", RigidTransform(at))
