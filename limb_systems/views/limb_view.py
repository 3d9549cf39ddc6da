"""What Meshcat shows around a limb: its ghosts, bars of duty, and the camera.

If several limbs share a Meshcat, each has its own folders, below a ``root``
that is empty or ends with a slash.
"""

import dataclasses
import itertools
import weakref

import numpy as np
from pydrake.geometry import Box, Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.trajectories import PiecewisePolynomial

from limb_systems.errors import LimbError
from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory
from limb_systems.model.kinematics import joint_angles_from_bend_angle
from limb_systems.model.parameters import LimbParameters
from limb_systems.views.colors import PLAN_COLOR, REFERENCE_COLOR

GHOST_OPACITY = 0.5
DUTY_COLOR = (0.16, 0.18, 0.22)  # sRGB
_TRACK_COLOR, _OUTLINE_COLOR = (0.93, 0.94, 0.95), (0.45, 0.47, 0.5)
_ELEVATION = np.radians(65.0)  # of the camera above the bending plane
_FIELD_OF_VIEW = np.radians(25.0)  # from top to bottom; narrow, so that lengths compare

# What the camera of a Meshcat must see: corners (3, 8) for each root.
_in_view: weakref.WeakKeyDictionary[Meshcat, dict[str, np.ndarray]] = weakref.WeakKeyDictionary()


@dataclasses.dataclass(frozen=True)
class Ghost:
    """A translucent limb without wires, which shows how the limb should bend.

    - ``name``: ``reference`` or ``plan``.
    - ``course``: θ (n) over the time of the view, rad; held before and after.
    """

    name: str
    course: PiecewisePolynomial

    @property
    def color(self) -> tuple[float, float, float]:
        """That of the plots, sRGB."""
        # Matplotlib takes as long to import as all the rest, and few limbs have ghosts.
        from matplotlib.colors import to_rgb

        return to_rgb({"reference": REFERENCE_COLOR, "plan": PLAN_COLOR}[self.name])


def joint_angle_course(motion: Recording | Trajectory) -> PiecewisePolynomial:
    """θ over time: cubic between samples where rates are known, else linear."""
    if motion.joint_state is None:
        shown = ~np.isnan(motion.bend_angle).any(axis=0)
        return _bend_angle_course(
            motion.parameters, motion.time[shown], motion.bend_angle[:, shown]
        )
    angles, rates = np.split(motion.joint_state, 2)
    return PiecewisePolynomial.CubicHermite(motion.time, angles, rates)


def ghosts_of_plan(parameters: LimbParameters, plan: Trajectory, start: float = 0.0) -> list[Ghost]:
    """The reference and the plan, over the time since ``start``, s, after the plan's own start.

    Raises:
        LimbError: if the plan is for a limb of another shape than the parameters'.
    """
    planned, present = map(_shape_in_words, (plan.parameters, parameters))
    if planned != present:
        raise LimbError(
            f"The plan is for a limb of {planned}, but the motion is of one of {present}; they "
            "cannot be shown together."
        )
    plan = plan.since_start()
    ghosts = [ghost_of_reference(plan), Ghost("plan", joint_angle_course(plan))]
    for ghost in ghosts:
        ghost.course.shiftRight(-start)
    return ghosts


def ghost_of_reference(motion: Recording | Trajectory) -> Ghost:
    """The reference in a motion, by eqn (11), over the motion's time."""
    return Ghost("reference", _bend_angle_course(motion.parameters, motion.time, motion.reference))


def _bend_angle_course(parameters, time, bend_angle) -> PiecewisePolynomial:
    """θ over time for bend angles (S, K), rad, by eqn (11), linear between samples."""
    angles = joint_angles_from_bend_angle(parameters, bend_angle)
    return PiecewisePolynomial.FirstOrderHold(time, angles)


def _shape_in_words(parameters: LimbParameters) -> str:
    return " and ".join(
        f"{s.links} links, {1e3 * s.length:g} mm x {1e3 * s.thickness:g} mm x {1e3 * s.width:g} mm"
        for s in parameters.segments
    )


def add_ghosts(
    meshcat: Meshcat, root: str, parameters: LimbParameters, ghosts: list[Ghost]
) -> None:
    """Puts ghosts into the scene, in place of those that are there.

    A ghost is a flat strip just below the limb's top and narrower than the limb.
    Where both coincide the limb hides it, so that nothing flickers; where they
    differ it is visible beside the limb. Its centre line is always visible: it
    runs above the limb and between the wires. The line of the next ghost is above
    that of the previous one, and narrower.
    """
    meshcat.Delete(f"{root}ghosts")
    for level, ghost in enumerate(ghosts):
        segments, paths = _segment_of_link(parameters), _link_paths(root, parameters, ghost)
        for segment, path in zip(segments, paths, strict=True):
            length = segment.length / segment.links
            thickness, width = segment.thickness, segment.width
            gap = 0.15 * thickness  # links that overlap would be seen twice
            flat = 0.02 * thickness
            strip = Box(max(length - gap, 0.5 * length), 0.96 * thickness, flat)
            line = Box(length, (0.26 - 0.16 * level) * thickness, flat)
            below = 0.5 * width - (0.08 - 0.04 * level) * thickness
            above = 0.5 * width + (0.14 + 0.04 * level) * thickness
            for part, shape, height, opacity in (
                ("strip", strip, below, GHOST_OPACITY),
                ("line", line, above, 1.0),
            ):
                meshcat.SetObject(f"{path}/{part}", shape, Rgba(*ghost.color, opacity))
                meshcat.SetTransform(f"{path}/{part}", RigidTransform([length / 2, 0.0, height]))
            # The strips are blended in this order, whichever is nearer, and hide none.
            meshcat.SetProperty(f"{path}/strip/<object>", "renderOrder", level + 1.0)
            meshcat.SetProperty(f"{path}/strip/<object>", "material.depthWrite", False)
            meshcat.SetProperty(f"{path}/strip/<object>", "material.side", 0.0)  # front only


def pose_ghost(
    meshcat: Meshcat, root: str, parameters: LimbParameters, ghost: Ghost, time: float
) -> None:
    """Bends a ghost as it is at a time, s; a recording by Meshcat shows it at this time, too."""
    origin = 0.0
    segments, paths = _segment_of_link(parameters), _link_paths(root, parameters, ghost)
    for segment, path, angle in zip(segments, paths, ghost.course.value(time)[:, 0], strict=True):
        pose = RigidTransform(RotationMatrix.MakeZRotation(angle), [origin, 0.0, 0.0])
        meshcat.SetTransform(path, pose, time)
        origin = segment.length / segment.links


def _segment_of_link(parameters: LimbParameters) -> list:
    return [segment for segment in parameters.segments for _ in range(segment.links)]


def _link_paths(root: str, parameters: LimbParameters, ghost: Ghost) -> list[str]:
    """Meshcat paths of a ghost's links, each below that of the link which it hangs on."""
    names = [f"link_{number}" for number in range(1, parameters.num_joints + 1)]
    base = f"{root}ghosts/{ghost.name}"
    return list(itertools.accumulate(names, "{}/{}".format, initial=base))[1:]


def add_duty_bars(meshcat: Meshcat, root: str, parameters: LimbParameters) -> None:
    """Draws a bar for each wire beside the base, in a track that is as long as duty 1."""
    unit = _bar_unit(parameters)
    meshcat.Delete(f"{root}duty")
    for name, x in zip(parameters.wire_names, _bar_positions(parameters), strict=True):
        path, thin = f"{root}duty/{name}", 0.02 * unit
        meshcat.SetTransform(path, RigidTransform([x, -1.5 * unit, 0.0]))
        for part, margin, layer, color in (
            ("outline", 0.12 * unit, 0, _OUTLINE_COLOR),
            ("track", 0.06 * unit, 1, _TRACK_COLOR),
            ("fill/bar", 0.0, 2, DUTY_COLOR),
        ):
            shape = Box(0.5 * unit + 2 * margin, 3 * unit + 2 * margin, thin)
            meshcat.SetObject(f"{path}/{part}", shape, Rgba(*color))
            center = RigidTransform([0.0, 1.5 * unit, layer * thin])
            meshcat.SetTransform(f"{path}/{part}", center)


def show_duty(
    meshcat: Meshcat, root: str, parameters: LimbParameters, duty: np.ndarray, time: float
) -> None:
    """Sets the bars to a duty (W); a recording by Meshcat shows it at the time, s."""
    for name, value in zip(parameters.wire_names, duty, strict=True):
        meshcat.SetProperty(f"{root}duty/{name}/fill", "scale", [1.0, float(value), 1.0], time)


def _bar_unit(parameters: LimbParameters) -> float:
    return 0.1 * sum(segment.length for segment in parameters.segments)


def _bar_positions(parameters: LimbParameters) -> np.ndarray:
    """Positions of the wires' bars along E1, m: left of the base, with gaps between segments."""
    unit = _bar_unit(parameters)
    steps = np.full(len(parameters.wires), 0.95)
    steps[[wires.start for wires in parameters.wire_slices]] = 1.25
    places = np.cumsum(steps)
    return unit * (places - places[-1] - 0.7) - 0.6 * parameters.segments[0].thickness


def set_scene(
    meshcat: Meshcat,
    root: str,
    parameters: LimbParameters,
    joint_angles: np.ndarray,
    base_pose: RigidTransform,
) -> float:
    """Sets the background, the lights, and a camera that shows a whole motion and the bars.

    The camera still shows what it was set to show of limbs with other roots.

    Args:
        joint_angles: θ, (n, K), rad.
        base_pose: of the limb, in the world.

    Returns:
        Width by height of the narrowest window that shows all of it.
    """
    for path in ("/Grid", "/Axes", "/Lights/PointLightNegativeX", "/Lights/PointLightPositiveX"):
        meshcat.SetProperty(path, "visible", False)
    for end in ("top_color", "bottom_color"):
        meshcat.SetProperty("/Background/<object>", end, [0.975, 0.98, 0.985])
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 1.5)
    meshcat.SetProperty("/Lights/FillLight/<object>", "intensity", 1.7)
    meshcat.SetProperty("/Lights/FillLight/<object>", "position", [-6.0, -2.0, 10.0])

    limbs = _in_view.setdefault(meshcat, {})
    limbs[root] = base_pose @ _reach(parameters, joint_angles)
    corners = np.hstack(list(limbs.values()))
    target = (corners.min(axis=1) + corners.max(axis=1)) / 2
    sine, cosine = np.sin(_ELEVATION), np.cos(_ELEVATION)
    to_camera = np.array([[1, 0, 0], [0, sine, cosine], [0, -cosine, sine]])
    right, up, near = to_camera @ (corners - target[:, np.newaxis])
    slope = np.tan(_FIELD_OF_VIEW / 2)
    distance = (np.abs(up) / slope + near).max()
    camera = "/Cameras/default/rotated/<object>"
    meshcat.SetProperty(camera, "fov", np.degrees(_FIELD_OF_VIEW))
    meshcat.SetProperty(camera, "near", 0.1 * distance)
    meshcat.SetProperty(camera, "far", 10.0 * distance)
    meshcat.SetCameraPose(target + distance * to_camera[2], target)
    return (np.abs(right) / (distance - near)).max() / slope


def _reach(parameters: LimbParameters, joint_angles: np.ndarray) -> np.ndarray:
    """The corners (3, 8) of a box that limb and bars stay in, with a margin, m."""
    lengths = np.array([s.length / s.links for s in _segment_of_link(parameters)])
    directions = np.cumsum(joint_angles, axis=0)
    steps = lengths[:, np.newaxis] * np.array([np.cos(directions), np.sin(directions)])
    ends = np.cumsum(steps, axis=1)
    margin = 0.15 * lengths.sum()
    unit = _bar_unit(parameters)
    low = np.minimum(ends.min(axis=(1, 2)) - margin, -1.8 * unit)
    high = np.maximum(ends.max(axis=(1, 2)) + margin, 1.8 * unit)
    half_width = max(s.width for s in parameters.segments) / 2
    left = min(low[0], _bar_positions(parameters)[0] - 0.6 * unit)
    ranges = [(left, high[0]), (low[1], high[1]), (-half_width, half_width)]
    return np.array(list(itertools.product(*ranges))).T
