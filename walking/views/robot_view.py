"""A robot in 3D: seen from its right side, on a ground with marks that is tilted as it slopes.

It walks to the right; the camera shows all of its way if that is known and short, and else goes
with it.
"""

import numpy as np
from pydrake.geometry import Box, Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant

from limb_systems.limb_parameters import LimbParameters
from limb_systems.views.limb_view import LimbView, box_corners
from walking.robot import PLANE, add_robot, set_positions
from walking.robot_parameters import RobotParameters

MARK = 0.01  # m, from mark to mark on the ground
FIFTH = 5  # marks after which one is wider
_BESIDE = (0.0, 15.0)  # azimuth and elevation of the camera, °
_GROUND_COLOR, _MARK_COLOR = (0.97, 0.98, 0.96), (0.62, 0.64, 0.66)
_IN_SIGHT = 4.0  # lengths of a robot to go, to which the camera shows all of the way


class RobotView(LimbView):
    """A robot on its ground, with the bars of duty above its body; see `LimbView`.

    A robot whose pose is not given stands on straight limbs.
    """

    MODEL = "robot"
    LIGHT = (-4.0, -10.0, 5.0)

    def __init__(self, robot: RobotParameters, root: str = ""):
        """
        Args:
            robot: the robot.
            root: beginning of the paths in Meshcat; empty, or ends with a slash.
        """
        self._robot, self._follows = robot, True
        ends = [f"{limb.name}_{end}" for limb in robot.limbs for end in ("base", "foot")]
        self._bodies_beside = ["body", *ends]
        super().__init__(robot.together, root=root)
        self._body = [body.name() for body in self._bodies].index("body")

    def add_to(self, meshcat: Meshcat, base_pose: RigidTransform | None = None) -> None:
        """Put the robot into a scene, in place of one with the same root.

        Args:
            base_pose: pose of the robot's world on level ground; the world's origin if None.
        """
        base_pose = base_pose or RigidTransform()
        if self._robot.ground:
            slope = RotationMatrix.MakeYRotation(-self._robot.ground.slope)
            base_pose = base_pose @ RigidTransform(slope, np.zeros(3))
        meshcat.Delete(f"{self._root}ground")
        meshcat.SetTransform(f"{self._root}ground", base_pose)
        super().add_to(meshcat, base_pose)

    def _limbs(self) -> dict[str, LimbParameters]:
        return {f"{limb.name}_": limb.parameters for limb in self._robot.limbs}

    def _eye(self) -> tuple[float, float]:
        return _BESIDE

    def _bar_axes(self) -> np.ndarray:
        return PLANE.matrix()  # of the walk

    def _bar_foot(self) -> float:
        return self._robot.body.height / 2 + 1.5 * self._unit

    def _bar_positions(self) -> np.ndarray:
        """Positions of the bars along x about the middle of the body, m."""
        places = self._bar_steps()
        return self._unit * (places - (places[0] + places[-1]) / 2)

    def _largest_bend(self) -> float:
        return np.radians(30.0)

    def _add_model(self, plant: MultibodyPlant) -> None:
        add_robot(plant, self._robot)

    def _set_positions(self, joint_angles: np.ndarray, body_pose: np.ndarray | None) -> None:
        set_positions(self._plant, self._context, self._robot, body_pose, joint_angles)

    def _move_scene(self, meshcat: Meshcat, poses: list[RigidTransform], time: float) -> None:
        center = poses[self._body].translation()
        back = -center * [1.0, 1.0, 0.0] if self._follows else np.zeros(3)
        step = FIFTH * MARK  # the marks repeat
        for folder, moved in (("visualizer", back), ("ground", np.fmod(back, step))):
            pose = self._base_pose @ RigidTransform(moved)
            meshcat.SetTransform(f"{self._root}{folder}", pose, time)
        pose = self._base_pose @ RigidTransform(center + back) @ self._facing
        meshcat.SetTransform(f"{self._root}duty", pose, time)

    def _reach(
        self, meshcat: Meshcat, joint_angles: np.ndarray, body_pose: np.ndarray | None
    ) -> np.ndarray:
        """The corners (3, 8) of a box that the robot and its bars stay in, with a margin, m.

        From here on the camera goes with the robot if it goes far, or nobody knows how far. The
        ground is put below the box.
        """
        # Place the bodies at some moments of the motion.
        kept = np.unique(np.linspace(0, joint_angles.shape[1] - 1, 60).astype(int))
        bodies = []
        for k in kept:
            poses = self._poses(joint_angles[:, k], None if body_pose is None else body_pose[:, k])
            bodies.append([pose.translation() for pose in poses])
        places = np.array(bodies)  # (K, bodies, 3)
        centers = places[:, [self._body]]

        # Decide whether the camera goes with the robot.
        size = np.ptp(places - centers, axis=(0, 1)).max()
        far = np.ptp(centers, axis=(0, 1))[:2].max() > _IN_SIGHT * size
        self._follows = body_pose is None or bool(far)
        if self._follows:
            places = places - centers * [1.0, 1.0, 0.0]

        # Enclose bodies and bars, and put the ground below them.
        margin = np.array([4.0, 3.0, 1.0]) * self._unit
        low, high = places.min(axis=(0, 1)) - margin, places.max(axis=(0, 1)) + margin
        top = places[:, self._body, 2].max() + self._bar_foot() + 4.0 * self._unit
        high[2] = max(high[2], top)
        if self._robot.ground:
            self._add_ground(meshcat, low, high)
        return box_corners(low, high)

    def _add_ground(self, meshcat: Meshcat, low: np.ndarray, high: np.ndarray) -> None:
        """Put the ground below a box from low to high (3,), m, with a mark each 10 mm along x."""
        step, path = FIFTH * MARK, f"{self._root}ground"
        first, last = np.floor(low[0] / step) - 1, np.ceil(high[0] / step) + 1
        middle, depth = (low[1] + high[1]) / 2, 1.5 * (high[1] - low[1])
        size = (last - first) * step, depth, MARK / 5
        center = [(first + last) / 2 * step, middle, -size[2] / 2]
        meshcat.SetObject(f"{path}/plane", Box(*size), Rgba(*_GROUND_COLOR))
        meshcat.SetTransform(f"{path}/plane", RigidTransform(center))
        for number in range(round((last - first) * FIFTH) + 1):
            mark = Box(MARK * (0.05 if number % FIFTH else 0.15), depth, 1e-5)
            meshcat.SetObject(f"{path}/mark_{number}", mark, Rgba(*_MARK_COLOR))
            at = [first * step + number * MARK, middle, 1e-5]
            meshcat.SetTransform(f"{path}/mark_{number}", RigidTransform(at))
