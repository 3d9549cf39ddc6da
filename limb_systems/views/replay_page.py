"""A motion of the limb in 3D as one HTML file, which any browser replays."""

import contextlib
import dataclasses
import gc
import html
import json
import logging
import string
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder

from limb_systems.errors import LimbError
from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory
from limb_systems.model.kinematics import bend_angle
from limb_systems.model.parameters import LimbParameters
from limb_systems.output import write_atomically
from limb_systems.views.limb_view import (
    DUTY_COLOR,
    GHOST_OPACITY,
    Ghost,
    ghost_of_reference,
    ghosts_of_plan,
    joint_angle_course,
    set_scene,
)
from limb_systems.views.limb_visualizer import (
    PUBLISH_PERIOD,
    WIRE_COLORS,
    add_view,
    linear,
    wire_color,
    wire_paths,
)


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
    a plan the reference in the motion.

    Args:
        path: of the HTML file, which is written whole or not at all.
        motion: what to replay.
        plan: to show as a ghost. A recording's time starts with the plan, as
            for `tracking_errors`; after its end the plan stays in its last
            pose.
        title: of the page.
        frames_per_second: about how many poses to store, Hz; the browser
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
    start, end = motion.time[[0, -1]]
    ghosts = _ghosts_beside(motion, plan)
    times = np.linspace(start, end, 1 + max(1, round((end - start) * frames_per_second)))
    temperature, measured = motion.wire_temperature, motion.wire_temperature is None
    if temperature is None:
        temperature = motion.measured_temperature
    shown = ~np.isnan(temperature).any(axis=0)
    rate = (len(times) - 1) / (end - start)
    frames = _Frames(
        joint_angle_course(motion).vector_values(times),
        np.array([np.interp(times, motion.time[shown], row[shown]) for row in temperature]),
        np.array([np.interp(times, motion.time, row) for row in motion.duty]),
        [ghost.course.vector_values(times - start) for ghost in ghosts],
    )
    page, aspect = _animate(motion.parameters, frames, ghosts, rate)
    gc.collect()  # a diagram is a cycle of references, and its Meshcat keeps a port open
    limits = motion.parameters.ambient_temperature, motion.parameters.temperature_limits.maximum
    caption = _CAPTION.substitute(
        title=html.escape(title),
        motion=html.escape(_motion_in_words(motion)),
        readouts=_readouts(motion, ghosts),
        values=json.dumps(_values(motion.parameters, frames), separators=(",", ":")),
        frames_per_second=repr(float(rate)),
        last_frame=len(times) - 1,
        opacity=GHOST_OPACITY,
        signal="measured temperature" if measured else "wire temperature",
        low=f"{limits[0]:g}",
        high=f"{limits[1]:g}",
        colors=", ".join(f"rgb({_css(color)})" for color in WIRE_COLORS),
        places=_places_in_words(motion.parameters),
        bars=html.escape(", ".join(_names(motion.parameters))),
        duty_rgb=_css(DUTY_COLOR),
        aspect=aspect,
    )
    write_atomically(path, page.replace("</body>", f"{caption}</body>"))


@dataclasses.dataclass(frozen=True)
class _Frames:
    """What F frames show.

    - ``joint_angles``: θ (n, F), rad.
    - ``temperature``: that the wires' colour shows (W, F), °C.
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
    ghost.course.shiftRight(-motion.time[0])
    return [ghost]


def _motion_in_words(motion: Recording | Trajectory) -> str:
    """What the limb itself shows, and how it came about."""
    if isinstance(motion, Trajectory):
        return "planned motion, nothing measured"
    if motion.joint_state is None:
        return f"{motion.how} bend angle ({motion.source}), drawn as constant curvature"
    return f"{motion.how} joint angles ({motion.source}), nothing measured"


def _readouts(motion: Recording | Trajectory, ghosts: list[Ghost]) -> str:
    """What the caption says of the moment that is shown, HTML; an output for each of `_values`."""
    segments = [suffix.strip("_") for suffix in motion.parameters.segment_suffixes]
    angles = ", ".join(f"φ{f'<sub>{s}</sub>' * bool(s)} <output></output>°" for s in segments)
    what = "planned" if isinstance(motion, Trajectory) else motion.how
    signs = [("limb", what)] + [(f'ghost" style="--rgb: {_css(g.color)}', g.name) for g in ghosts]
    parts = [f'<i class="{sign}"></i>{name} {angles}' for sign, name in signs]
    for name in _names(motion.parameters):
        parts.append(
            f'{html.escape(name)} <output></output> °C, duty <output class="duty"></output>'
        )
    return "\n      ".join(f"<span>{part}</span>" for part in parts)


def _places_in_words(parameters: LimbParameters) -> str:
    """Where each wire is as one looks down on the limb, E2 being up."""
    downwards = dict.fromkeys(
        ", ".join(wire.name for wire in sorted(segment.wires, key=lambda wire: -wire.e2))
        for segment in parameters.segments
    )
    if list(downwards) == ["right, left"]:
        return "upper wire: right, lower wire: left"
    return f"wires from top to bottom: {'; '.join(downwards)}"


def _names(parameters: LimbParameters) -> list[str]:
    """Of the wires, in words."""
    return [name.replace("_", " ") for name in parameters.wire_names]


def _values(parameters: LimbParameters, frames: _Frames) -> list[list[float]]:
    """What each output of `_readouts` says in each frame: φ in degrees, °C, duty."""
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
        HTML, and what `set_scene` returns.
    """
    with _drake_silenced():
        meshcat = Meshcat(MeshcatParams(host="localhost", port=0, show_stats_plot=False))
    builder = DiagramBuilder()
    for port in add_view(builder, meshcat, "", parameters, ghosts, PUBLISH_PERIOD):
        builder.ExportInput(port, port.get_name())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    meshcat.StartRecording(frames_per_second)
    animation = meshcat.get_mutable_recording()
    animation.set_repetitions(1_000_000)
    colors = linear(wire_color(parameters, frames.temperature))
    times = (np.arange(frames.duty.shape[1]) + 1e-6) / frames_per_second  # Drake rounds down
    for frame, (time, angles) in enumerate(zip(times, frames.joint_angles.T, strict=True)):
        context.SetTime(time)
        state = np.append(angles, np.zeros_like(angles))
        diagram.get_input_port(0).FixValue(context, state)
        diagram.get_input_port(1).FixValue(context, frames.duty[:, frame])
        diagram.ForcedPublish(context)
        for paths, color in zip(wire_paths("", parameters), colors[:, frame], strict=True):
            for path in paths:
                # Meshcat sets "color" on a path; an animation binds to its mesh.
                animation.SetProperty(frame, f"{path}/<object>", "material.color", color)
    meshcat.PublishRecording()
    seen = np.hstack([frames.joint_angles, *frames.ghost_angles])
    aspect = set_scene(meshcat, "", parameters, seen, RigidTransform())
    return meshcat.StaticHtml(), aspect


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


# Below the picture. The script drives Meshcat's animation and tells what it shows, makes
# the limb fit what the caption leaves of the window, and turns off the tone mapping that
# makes Meshcat's oranges paler than the legend's.
_CAPTION = string.Template("""
  <meta name="viewport" content="width=device-width, initial-scale=1">
  <style>
    #caption {
      position: fixed; bottom: 0; width: 100%; box-sizing: border-box; padding: 0.8rem 1.2rem;
      pointer-events: none; font: 0.9rem/1.4 system-ui, sans-serif; color: #333;
    }
    #caption div { display: flex; flex-wrap: wrap; gap: 0.3rem 2rem; }
    #caption #controls {
      flex-wrap: nowrap; align-items: center; gap: 0.8rem; pointer-events: auto;
    }
    #controls button { font: inherit; width: 4.5rem; min-height: 2.2rem; cursor: pointer; }
    #controls input { flex: 1; min-width: 0; min-height: 2.2rem; cursor: pointer; }
    #readouts { margin: 0.3rem 0; font-size: 1rem; }
    #caption output {
      display: inline-block; min-width: 4.5ch; text-align: right; font-weight: 600;
      font-variant-numeric: tabular-nums;
    }
    #controls output { min-width: 6ch; }
    #caption i { display: inline-block; width: 2rem; height: 0.7em; margin-right: 0.5em; }
    #caption i.limb { background: #e3e8f0; outline: 1px solid #9aa0a6; }
    #caption i.heat {
      width: 5rem; margin: 0 0.5em; border-radius: 0.35em;
      background: linear-gradient(to right, $colors);
    }
    #caption i.ghost {
      background: linear-gradient(rgb(var(--rgb)), rgb(var(--rgb))) center / 100% 25% no-repeat,
        rgb(var(--rgb) / $opacity);
    }
    #caption i.duty {
      background: linear-gradient(to right, rgb($duty_rgb) 60%, #edeff1 60%);
      outline: 1px solid #73787f;
    }
    @media (max-width: 40rem) {
      #caption { padding: 0.5rem 0.7rem; font-size: 0.8rem; }
      #caption div { gap: 0.1rem 1rem; }
      #readouts { font-size: 0.9rem; }
    }
  </style>
  <div id="caption">
    <div id="controls">
      <button type="button" title="space bar">Pause</button>
      <input type="range" min="0" max="$last_frame" value="0" aria-label="moment">
      <output></output>
    </div>
    <div id="readouts">
      $readouts
    </div>
    <div>
      <b>$title</b>
      <span>$motion</span>
      <span>$signal: $low °C<i class="heat"></i>$high °C</span>
      <span>$places</span>
      <span><i class="duty"></i>duty from 0 to 1: $bars</span>
    </div>
  </div>
  <script>
    const values = $values;
    const rate = $frames_per_second;  // of the values, Hz
    const [button, slider, clock] = document.querySelector("#controls").children;
    const readouts = document.querySelectorAll("#readouts output");
    viewer.renderer.toneMapping = MeshCat.THREE.NoToneMapping;
    document.title = document.querySelector("#caption b").textContent;
    button.onclick = () => viewer.animator[viewer.animator.playing ? "pause" : "play"]();
    document.addEventListener("keydown", (event) => {
      if (event.code !== "Space" || event.target === button) return;  // a button clicks by itself
      event.preventDefault();
      button.click();
    });
    slider.oninput = () => {
      viewer.animator.pause();
      viewer.animator.seek(slider.value / rate);
      viewer.animator.display_progress(slider.value / rate);
    };
    (function tick() {
      const width = window.innerWidth, height = window.innerHeight;
      const below = document.querySelector("#caption").offsetHeight;
      viewer.camera.zoom = Math.min(1 - below / height, viewer.camera.aspect / $aspect);
      viewer.camera.setViewOffset(width, height, 0, below / 2, width, height);
      const time = viewer.animator.time, frame = Math.round(time * rate);
      button.textContent = viewer.animator.playing ? "Pause" : "Play";
      slider.value = frame;
      clock.value = time.toFixed(1) + " s";
      readouts.forEach((output, i) => {
        output.value = values[i][frame].toFixed(output.matches(".duty") ? 2 : 1);
      });
      requestAnimationFrame(tick);
    })();
  </script>
""")
