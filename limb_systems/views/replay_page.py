"""A motion of a limb or a robot in 3D as one HTML file, which any browser replays."""

import contextlib
import dataclasses
import gc
import html
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams

from limb_systems.connected_limbs import connected
from limb_systems.errors import LimbError
from limb_systems.files.output import write_atomically
from limb_systems.files.recording import Recording
from limb_systems.files.signal_table import Planned
from limb_systems.files.trajectory import Trajectory
from limb_systems.kinematics import bend_angle
from limb_systems.limb_model import LimbModel
from limb_systems.limb_parameters import LimbParameters
from limb_systems.views.colors import ROLLOUT_COLOR
from limb_systems.views.limb_view import (
    WIRE_COLORS,
    Ghost,
    LimbView,
    ghost_of_reference,
    joint_angle_trajectory,
    linear_wire_color,
)
from limb_systems.views.template import template


def write_meshcat_replay(path: str | Path, motion: Recording | Planned, **options: Any) -> None:
    """Write the page of `replay_page`, with its options, whole or not at all."""
    write_atomically(path, replay_page(motion, **options))


def replay_page(
    motion: Recording | Planned,
    *,
    plan: Trajectory | None = None,
    title: str = "",
    frames_per_second: float = 20.0,
) -> str:
    """Return a page, HTML, that replays a motion in 3D.

    The page needs no other file; the browser runs it in real time. It has a
    button (or the space bar) to pause and a slider for the time, and shows φ,
    temperatures and duty at that time as numbers. If a recording has no joint
    angles, they follow from its bend angle by constant curvature, eqn (11). The
    wires' colour shows T, or V where T is not known. Ghosts, lines along the axis, show
    the plan and its reference, or without a plan the reference in the motion. In space
    the paths of all tips are shown; the path of the motion ends at its current time.

    A robot is on its ground, with a mark each 10 mm, and the page shows the pose of its body. A
    gait is shown for some cycles.

    Args:
        motion: recording, trajectory or gait to replay.
        plan: trajectory to show as a ghost. A recording's time starts with the plan, as
            for `tracking_errors`; after its end the plan stays in its last
            pose.
        title: title of the page; "Robot" or "Soft limb" if empty.
        frames_per_second: rate of the poses that are stored, about, Hz; the browser
            interpolates. 20 Hz and five links take 30 kB per second, and nearly as
            much again for two ghosts.

    Raises:
        LimbError: if the motion has fewer than two samples, the rate is not
            positive, the plan is for a limb of another shape, or there is one for a robot.
    """
    # Check the arguments.
    num_samples = len(motion.time)
    if isinstance(motion, Recording):
        num_samples -= motion.missing.sum()
    if num_samples < 2:
        raise LimbError("A replay needs at least two samples.")
    if not (np.isfinite(frames_per_second) and frames_per_second > 0):
        raise LimbError(f"frames_per_second is {frames_per_second!r}; it must be positive.")

    # Interpolate the signals at the times of the frames.
    motion = motion.for_replay()
    parameters = motion.parameters
    robot = None if motion.robot is None or motion.robot.is_limb else motion.robot
    if robot and plan is not None:
        raise LimbError("A robot is shown without a plan; leave the plan out.")
    in_space = not (robot or motion.model.layout.is_planar)
    start, end = motion.time[[0, -1]]
    times = np.linspace(start, end, 1 + max(1, round((end - start) * frames_per_second)))
    rate = (len(times) - 1) / (end - start)
    temperature = motion.wire_temperature
    has_wire_temperature = temperature is not None
    if temperature is None:
        temperature = motion.measured_temperature
    heat = motion.interpolated(temperature, times)
    if isinstance(motion, Planned) and motion.HOLDS_DUTY:
        duty = motion.duty_trajectory().vector_values(times)
    else:
        duty = motion.interpolated(motion.duty, times)
    pose = getattr(motion, "body_pose", None)
    if pose is not None:
        pose = motion.interpolated(pose, times)
    angles = joint_angle_trajectory(motion).vector_values(times)
    ghosts = _ghosts_beside(motion, plan)
    ghost_angles = [ghost.joint_angles.vector_values(times - start) for ghost in ghosts]

    # Record the frames in a scene.
    with _drake_silenced():
        meshcat = Meshcat(MeshcatParams(host="localhost", port=0, show_stats_plot=False))
    view = connected("view")(meshcat, robot) if robot else LimbView(meshcat, parameters, ghosts)
    view.set_scene(np.hstack([angles, *ghost_angles]), pose)
    if in_space:
        view.add_tip_path(angles)
    meshcat.StartRecording(rate)
    animation = meshcat.get_mutable_recording()
    animation.set_repetitions(1_000_000)
    colors = linear_wire_color(parameters, heat)
    for frame in range(len(times)):
        time = (frame + 1e-6) / rate  # Drake rounds down
        frame_pose = None if pose is None else pose[:, frame]
        view.show(angles[:, frame], time, frame_pose)
        for paths, color in zip(view.wire_paths, colors[:, frame], strict=True):
            for path in paths:
                # Meshcat sets "color" on a path; an animation binds to its mesh.
                animation.SetProperty(frame, f"{path}/<object>", "material.color", color)
    meshcat.PublishRecording()
    page = meshcat.StaticHtml()
    del meshcat, animation, view
    gc.collect()  # a diagram is a cycle of references, and its Meshcat keeps a port open

    # Collect the numbers that the caption shows in each frame: bends, pose, heat and duty.
    pose_rows = robot.pose_rows() if robot and pose is not None else []
    values = []
    for joint_angles in (angles, *ghost_angles):
        values.append(np.rad2deg(bend_angle(parameters, joint_angles)).round(1))
    for (_, _, scale), row in zip(pose_rows, [] if pose is None else pose, strict=True):
        values.append((scale * row).round(1)[np.newaxis])
    for wire_heat, wire_duty in zip(heat, duty, strict=True):
        values.append(np.array([wire_heat.round(1), wire_duty.round(2)]))

    # Add the caption to the page.
    title = title or ("Robot" if motion.robot else "Soft limb")
    how = motion.how if isinstance(motion, Recording) else "planned"
    caption = template("replay.html", Path(__file__).parent / "templates").render(
        title=title,
        motion=motion.origin,
        poses=[(how, None)] + [(ghost.name, _css(ghost.color)) for ghost in ghosts],
        bends=[suffix.strip("_").replace("_", " ") for suffix in parameters.bend_suffixes],
        in_space=in_space,
        body=[(name, unit) for name, unit, _ in pose_rows],
        tip_color=ROLLOUT_COLOR,
        wires=[name.replace("_", " ") for name in parameters.wire_names],
        values=np.vstack(values).tolist(),
        frames_per_second=repr(float(rate)),
        last_frame=len(times) - 1,
        provenance=motion.provenance and dataclasses.asdict(motion.provenance),
        signal="wire temperature" if has_wire_temperature else "measured temperature",
        low=f"{parameters.ambient_temperature:g}",
        high=f"{parameters.temperature_limits.maximum:g}",
        colors=[f"rgb({_css(color)})" for color in WIRE_COLORS],
        places=robot.surroundings() if robot else _places_in_words(parameters),
    )
    page = page.replace("<title>Drake MeshCat</title>", f"<title>{html.escape(title)}</title>")
    return page.replace("</body>", f"{caption}</body>")


def _ghosts_beside(motion: Recording | Planned, plan: Trajectory | None) -> list[Ghost]:
    """Return ghosts of the plan and its reference, or of a motion's own reference.

    Their time counts from the motion's start. Raise LimbError if the plan is for another shape.
    """
    if plan is not None:
        if _shape(plan.parameters) != _shape(motion.parameters):
            raise LimbError(
                "The plan is for a limb of other segments than the motion's; they cannot be shown "
                "together."
            )
        # The time of a recording counts from the start of its plan.
        start = motion.time[0] if isinstance(motion, Recording) else 0.0
        plan = plan.since_start()
        ghosts = [ghost_of_reference(plan), Ghost("plan", joint_angle_trajectory(plan))]
    elif motion.robot or not isinstance(motion, Recording | Trajectory) or motion.reference is None:
        return []
    else:
        start = motion.time[0]
        ghosts = [ghost_of_reference(motion)]
    for ghost in ghosts:
        ghost.joint_angles.shiftRight(-start)
    return ghosts


def _shape(parameters: LimbParameters) -> list[tuple]:
    """Return the links and sizes of all segments."""
    names = ("links", "length", "thickness", "width", "axes", "twists", "centred_joints")
    return [tuple(getattr(segment, name) for name in names) for segment in parameters.segments]


def _places_in_words(parameters: LimbParameters) -> str:
    """Return the places of the wires in the view: from the top down, or around E1 in space."""
    if not LimbModel.of(parameters).layout.is_planar:
        places: list[str] = []
        for segment in parameters.segments:
            angles = [f"{wire.name} {np.rad2deg(wire.angle):.0f}°" for wire in segment.wires]
            places.append(", ".join(angles))
        return f"wires from +E2 towards +E3, which is up: {'; '.join(dict.fromkeys(places))}"
    orders: list[str] = []
    for segment in parameters.segments:
        downwards = sorted(segment.wires, key=lambda wire: -wire.e2)
        orders.append(", ".join(wire.name for wire in downwards))
    if set(orders) == {"right, left"}:
        return "upper wire: right, lower wire: left"
    return f"wires from top to bottom: {'; '.join(dict.fromkeys(orders))}"


def _css(color: Sequence[float]) -> str:
    """Return a colour as CSS has it, three numbers up to 255."""
    return " ".join(f"{255 * value:.0f}" for value in color)


@contextlib.contextmanager
def _drake_silenced() -> Iterator[None]:
    """Keep Drake from announcing a server that is not there to be visited."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(level)
