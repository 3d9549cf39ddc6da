"""A motion of the limb in 3D as one HTML file, which any browser replays."""

import contextlib
import dataclasses
import gc
import html
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams

from limb_systems.errors import LimbError
from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory
from limb_systems.model.kinematics import bend_angle
from limb_systems.model.layout import Layout
from limb_systems.model.parameters import LimbParameters
from limb_systems.output import write_atomically
from limb_systems.views.colors import ROLLOUT_COLOR
from limb_systems.views.limb_view import (
    DUTY_COLOR,
    GHOST_OPACITY,
    WIRE_COLORS,
    Ghost,
    LimbView,
    ghost_of_reference,
    ghosts_of_plan,
    joint_angle_trajectory,
)
from limb_systems.views.template import template


def write_meshcat_replay(
    path: str | Path,
    motion: Recording | Trajectory,
    *,
    plan: Trajectory | None = None,
    title: str = "Soft limb",
    frames_per_second: float = 20.0,
) -> None:
    """Writes a page that replays a motion in 3D, over and over, in any browser.

    The page needs no other file; the browser runs it in real time. It has a
    button (or the space bar) to pause and a slider for the time, and shows φ,
    temperatures and duty at that time as numbers. If a recording has no joint
    angles, they follow from its bend angle by constant curvature, eqn (11). The
    wires' colour shows T, or V where T is not known, and bars beside the base
    show the duty. Translucent ghosts show the plan and its reference, or without
    a plan the reference in the motion. In space the paths of all tips are shown, the motion's
    own as far as it has come.

    Args:
        path: the HTML file, which is written whole or not at all.
        motion: recording or trajectory to replay.
        plan: trajectory to show as a ghost. A recording's time starts with the plan, as
            for `tracking_errors`; after its end the plan stays in its last
            pose.
        title: title of the page.
        frames_per_second: rate of the poses that are stored, about, Hz; the browser
            interpolates. 20 Hz and five links take 30 kB per second, and nearly as
            much again for two ghosts.

    Raises:
        LimbError: if the motion has fewer than two samples, the rate is not
            positive, or the plan is for a limb of another shape.
    """
    if ((~motion.missing).sum() if isinstance(motion, Recording) else len(motion.time)) < 2:
        raise LimbError("A replay needs at least two samples.")
    if not (np.isfinite(frames_per_second) and frames_per_second > 0):
        raise LimbError(f"frames_per_second is {frames_per_second!r}; it must be positive.")
    parameters, limits = motion.parameters, motion.parameters.temperature_limits
    start, end = motion.time[[0, -1]]
    ghosts = _ghosts_beside(motion, plan)
    times = np.linspace(start, end, 1 + max(1, round((end - start) * frames_per_second)))
    temperature, measured = motion.wire_temperature, motion.wire_temperature is None
    if temperature is None:
        temperature = motion.measured_temperature
    shown = ~np.isnan(temperature).any(axis=0)
    rate = (len(times) - 1) / (end - start)
    frames = _Frames(
        joint_angle_trajectory(motion).vector_values(times),
        np.array([np.interp(times, motion.time[shown], row[shown]) for row in temperature]),
        np.array([np.interp(times, motion.time, row) for row in motion.duty]),
        [ghost.joint_angles.vector_values(times - start) for ghost in ghosts],
    )
    page, aspect = _animate(parameters, frames, ghosts, rate)
    names = [suffix.strip("_").replace("_", " ") for suffix in Layout(parameters).bend_suffixes]
    how = "planned" if isinstance(motion, Trajectory) else motion.how
    caption = template("replay.html", Path(__file__).parent / "templates").render(
        title=title,
        motion=_motion_in_words(motion),
        poses=[(how, None)] + [(ghost.name, _css(ghost.color)) for ghost in ghosts],
        bends=names,
        in_space=not Layout(parameters).is_planar,
        tip_color=ROLLOUT_COLOR,
        wires=[name.replace("_", " ") for name in parameters.wire_names],
        values=_values(parameters, frames),
        frames_per_second=repr(float(rate)),
        last_frame=len(times) - 1,
        opacity=GHOST_OPACITY,
        provenance=motion.provenance and dataclasses.asdict(motion.provenance),
        signal="measured temperature" if measured else "wire temperature",
        low=f"{parameters.ambient_temperature:g}",
        high=f"{limits.maximum:g}",
        colors=[f"rgb({_css(color)})" for color in WIRE_COLORS],
        places=_places_in_words(parameters),
        duty_rgb=_css(DUTY_COLOR),
        aspect=aspect,
    )
    page = page.replace("<title>Drake MeshCat</title>", f"<title>{html.escape(title)}</title>")
    write_atomically(path, page.replace("</body>", f"{caption}</body>"))


@dataclasses.dataclass(frozen=True)
class _Frames:
    """What F frames show.

    - ``joint_angles``: θ (n, F), rad.
    - ``temperature``: shown by the wires' colour (W, F), °C.
    - ``duty``: D (W, F).
    - ``ghost_angles``: θ (n, F) of each ghost, rad.
    """

    joint_angles: np.ndarray
    temperature: np.ndarray
    duty: np.ndarray
    ghost_angles: list[np.ndarray]


def _ghosts_beside(motion: Recording | Trajectory, plan: Trajectory | None) -> list[Ghost]:
    """The ghosts of a motion, over the time since the motion's start."""
    if plan is not None:
        # The time of a recording is that since the start of its plan.
        start = motion.time[0] if isinstance(motion, Recording) else 0.0
        return ghosts_of_plan(motion.parameters, plan, start)
    if motion.reference is None:
        return []
    ghost = ghost_of_reference(motion)
    ghost.joint_angles.shiftRight(-motion.time[0])
    return [ghost]


def _motion_in_words(motion: Recording | Trajectory) -> str:
    """What the limb itself shows, and how it came about."""
    if isinstance(motion, Trajectory):
        return "planned motion, nothing measured"
    if motion.joint_state is None:
        return f"{motion.how} bend angle ({motion.source}), drawn as constant curvature"
    return f"{motion.how} joint angles ({motion.source}), nothing measured"


def _places_in_words(parameters: LimbParameters) -> str:
    """Where each wire is as one looks down on the limb, E2 being up, or at its tip in space."""
    if not Layout(parameters).is_planar:
        places = dict.fromkeys(
            ", ".join(
                f"{wire.name} {np.rad2deg(np.arctan2(wire.e3, wire.e2)):.0f}°"
                for wire in segment.wires
            )
            for segment in parameters.segments
        )
        return f"wires from +E2 towards +E3, which is up: {'; '.join(places)}"
    downwards = dict.fromkeys(
        ", ".join(wire.name for wire in sorted(segment.wires, key=lambda wire: -wire.e2))
        for segment in parameters.segments
    )
    if list(downwards) == ["right, left"]:
        return "upper wire: right, lower wire: left"
    return f"wires from top to bottom: {'; '.join(downwards)}"


def _values(parameters: LimbParameters, frames: _Frames) -> list[list[float]]:
    """What each output of the caption says in each frame: φ in degrees, °C, duty."""
    angles = [bend_angle(parameters, a) for a in (frames.joint_angles, *frames.ghost_angles)]
    rows = [np.round(np.rad2deg(row), 1) for row in np.vstack(angles)]
    for temperature, duty in zip(frames.temperature, frames.duty, strict=True):
        rows += [np.round(temperature, 1), np.round(duty, 2)]
    return [row.tolist() for row in rows]


def _css(color: Sequence[float]) -> str:
    return " ".join(f"{255 * value:.0f}" for value in color)


def _animate(
    parameters: LimbParameters, frames: _Frames, ghosts: list[Ghost], frames_per_second: float
) -> tuple[str, float]:
    """Meshcat's page.

    Returns:
        HTML, and what `LimbView.set_scene` returns.
    """
    with _drake_silenced():
        meshcat = Meshcat(MeshcatParams(host="localhost", port=0, show_stats_plot=False))
    view = LimbView(parameters, ghosts)
    view.add_to(meshcat)
    if not Layout(parameters).is_planar:
        view.add_tip_path(meshcat, frames.joint_angles)
    meshcat.StartRecording(frames_per_second)
    animation = meshcat.get_mutable_recording()
    animation.set_repetitions(1_000_000)
    colors = view.colors(frames.temperature)
    times = (np.arange(frames.duty.shape[1]) + 1e-6) / frames_per_second  # Drake rounds down
    for frame, time in enumerate(times):
        view.show(meshcat, frames.joint_angles[:, frame], frames.duty[:, frame], time)
        for paths, color in zip(view.wire_paths, colors[:, frame], strict=True):
            for path in paths:
                # Meshcat sets "color" on a path; an animation binds to its mesh.
                animation.SetProperty(frame, f"{path}/<object>", "material.color", color)
    meshcat.PublishRecording()
    aspect = view.set_scene(meshcat, np.hstack([frames.joint_angles, *frames.ghost_angles]))
    page = meshcat.StaticHtml()
    gc.collect()  # a diagram is a cycle of references, and its Meshcat keeps a port open
    return page, aspect


@contextlib.contextmanager
def _drake_silenced() -> Iterator[None]:
    """Keeps Drake from announcing a server that is not there to be visited."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(level)
