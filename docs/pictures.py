"""Makes the pictures of README and docs anew, from one evaluation: `make pictures`.

python docs/pictures.py FOLDER [NAME ...]   FOLDER is what `examples/reproduce_paper` left

Needs Graphviz's `dot` and a Chromium, and five minutes for all. `rooms.svg` and `wiring.svg` are
drawn by hand.
"""

import argparse
import contextlib
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
import threading
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Polygon, Rectangle
from matplotlib.transforms import Affine2D, Transform
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    Rgba,
    Role,
    RoleAssign,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Diagram, DiagramBuilder, InputPortIndex, OutputPortIndex
from pydrake.systems.sensors import CameraInfo
from scipy.interpolate import CubicSpline

from calibration import BendAngleController, EquilibriumSchedule
from controllers import PlanFeedback
from hardware import LimbTwin, Station, replay
from limb_systems import (
    Layout,
    Limb,
    LimbParameters,
    Recording,
    Trajectory,
    simulate,
    tip_position,
    wire_color,
)
from limb_systems.kinematics import Chain, link_positions
from limb_systems.tracking import reference_distances
from limb_systems.views.colors import (
    LEFT_RIGHT_COLORS,
    PLAN_COLOR,
    REFERENCE_COLOR,
    ROLLOUT_COLOR,
)
from limb_systems.views.limb_view import ghost_of_reference, joint_angle_trajectory
from limb_systems.views.plots import save_figure
from planners import Task, plan, references
from planners.diagnostics import plot_diagnostics
from soft_limb.command import main as main_command
from soft_limb.live_page import LivePage
from urdf import limb_urdf
from walking import Robot, RobotParameters, plan_gait
from walking.views.walk_drawing import animate_walk, draw_walk
from walking.walk_trajectory import walk

FOLDER = Path(__file__).parent
STYLE = """
bgcolor=white; nodesep=0.25; ranksep=0.35; fontname="Arial"; fontsize=13;
node [shape=box, style="rounded,filled", fillcolor="#eef2fb", color="#3b4a6b",
      fontname="Arial", fontsize=13, margin="0.1,0.06"];
edge [color="#3b4a6b", fontname="Arial", fontsize=12, arrowsize=0.7];
"""


def main() -> None:
    parser = argparse.ArgumentParser(description="Makes the pictures of the documentation.")
    parser.add_argument("folder", type=Path, help="what examples/reproduce_paper left")
    parser.add_argument("names", nargs="*", metavar="NAME", help="of " + ", ".join(PICTURES))
    options = parser.parse_args()
    if unknown := set(options.names) - set(PICTURES):
        parser.error(f"no picture is called {', '.join(sorted(unknown))}")
    for name in options.names or PICTURES:
        print(name, flush=True)
        PICTURES[name](options.folder)


def make_diagrams(_: Path) -> None:
    save_dot(diagram_dot(Limb(), LIMB), FOLDER / "limb.svg")
    twin = diagram_dot(LimbTwin(), LIMB | TWIN, hidden=["memory"], direction="TB")
    save_dot(twin, FOLDER / "limb_twin.svg")
    save_dot(diagram_dot(collecting_diagram(), COLLECTING), FOLDER / "collecting.svg")
    for name, dot in (("planning", PLANNING), ("calibration", CALIBRATION), ("robot", ROBOT)):
        save_dot(f"digraph {{ rankdir=LR; {STYLE} {dot} }}", FOLDER / f"{name}.svg")


def make_plan(_: Path) -> None:
    save_figure(draw_links(LimbParameters()), FOLDER / "links.png")
    trajectory = plan(LimbParameters(), references.step_and_decaying_sine())
    save_figure(plot_diagnostics(trajectory), FOLDER / "diagnostics.png")


def copy_evaluation(evaluation: Path) -> None:
    for name in ("fig4.png", "fig5.png", "ways.png"):
        shutil.copy(evaluation / name, FOLDER)


def make_walk(_: Path) -> None:
    save_figure(draw_walk(plan_gait(RobotParameters(), spread=False)), FOLDER / "walk.png")


def make_walk_in_space(_: Path) -> None:
    """A robot of four limbs that walks ahead, heats its wires for a turn, and turns on the spot."""
    robot = RobotParameters.in_space()
    ahead, around = (plan_gait(robot, turn=turn, spread=False) for turn in (0.0, np.inf))
    save_figure(draw_walk(ahead), FOLDER / "robot_in_space.png")
    duty = ahead.duty_trajectory(3)
    turn = walk(around, 3, heat=ahead.initial_heat, bend=ahead.bend_angle[:, 0]).duty_trajectory()
    turn.shiftRight(duty.end_time())
    duty.ConcatenateInTime(turn)
    motion = simulate(Robot(robot), duty, initial_state=ahead.initial_state)
    animate_walk(motion, FOLDER / "walk_in_space.gif", pace=6.0)


def make_space(evaluation: Path) -> None:
    """The README's chain in space, which an emulated limb follows along a circle."""
    space, described = evaluation / "space", evaluation / "limb_in_space.yaml"
    calibrated = evaluation / "in_space.yaml"
    LimbParameters.in_space().save(described)
    for arguments in (
        ["collect", "-l", described, "-o", space / "recordings"],
        ["fit", space / "recordings", "-o", calibrated],
        ["follow", "circle", "-l", calibrated, "-o", space],
    ):
        if main_command([*map(str, arguments), "--force"]):
            raise SystemExit(1)
    files = Trajectory.load(space / "plan.csv"), Recording.load(space / "recording.csv")
    save_figure(draw_in_space(*files), FOLDER / "space.png")


def make_gripper(_: Path) -> None:
    """The gripper of the example at four times, as it was simulated."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        example = runpy.run_path(str(FOLDER.parent / "examples" / "gripper.py"))
    seen, station = example["seen"], Station(example["FOLDER"] / "scenario.yaml")
    scene_graph, plant = station.GetSubsystemByName("scene_graph"), station.plant
    beams = [
        LightParameter(type="directional", frame="world", direction=direction, intensity=intensity)
        for direction, intensity in (([0.2, 0.8, -0.6], 0.8), ([-0.3, 0.3, -1.0], 0.5))
    ]
    white = RenderEngineVtkParams(default_clear_color=[1.0, 1.0, 1.0], lights=beams)
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(white))
    size, depth = CameraInfo(340, 480, 0.5), ClippingRange(0.01, 5.0)  # px, rad; m
    camera = ColorRenderCamera(RenderCameraCore("vtk", size, depth, RigidTransform()))
    right, ahead = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.98, -0.2]) / np.hypot(0.98, 0.2)
    axes = np.column_stack([right, np.cross(ahead, right), ahead])
    pose = RigidTransform(RotationMatrix(axes), [0.0, -0.4, 0.17])
    root = station.CreateDefaultContext()
    scene, positions = (s.GetMyMutableContextFromRoot(root) for s in (scene_graph, plant))
    shots = []
    for time in (11.0, 15.0, 18.0, 28.0):
        k = np.searchsorted(seen["time"], time)
        for name, signal in seen.items():
            model, _, what = name.partition(".")
            if what in ("state", "joint_state"):
                instance = plant.GetModelInstanceByName(model)
                state = signal[: plant.num_positions(instance), k]
                plant.SetPositions(positions, instance, state)
        for name, wires in station.limbs.items():
            color_wires(scene_graph, scene, plant, name, wires.parameters, seen, k)
        query = scene_graph.get_query_output_port().Eval(scene)
        shot = query.RenderColorImage(camera, scene_graph.world_frame_id(), pose)
        shots.append(shot.data[..., :3].copy())
    plt.imsave(FOLDER / "gripper.png", np.hstack(shots))


def color_wires(scene_graph, scene, plant, name: str, parameters, seen, k: int) -> None:
    """Give the wires of a simulated limb the colours of their temperatures at a sample."""
    colors = wire_color(parameters, seen[f"{name}.wire_temperature"][:, k])
    inspector, source = scene_graph.model_inspector(), plant.get_source_id()
    for body in plant.GetBodyIndices(plant.GetModelInstanceByName(name)):
        frame = plant.GetBodyFrameIdOrThrow(body)
        for geometry in inspector.GetGeometries(frame, Role.kPerception):
            for wire, color in zip(parameters.wire_names, colors, strict=True):
                if inspector.GetName(geometry).endswith(f"wire_{wire}"):
                    shown = PerceptionProperties()
                    shown.AddProperty("phong", "diffuse", Rgba(*color))
                    scene_graph.RemoveRole(scene, source, geometry, Role.kPerception)
                    scene_graph.AssignRole(scene, source, geometry, shown, RoleAssign.kNew)


def photograph_replay(evaluation: Path) -> None:
    """The 3D replay, at the moment at which the limb is bent the most."""
    with browser_page(1280, 660) as page:
        page.goto((evaluation / "replay.html").resolve().as_uri())
        page.wait_for_function("document.querySelector('#controls input').max > 0")
        page.wait_for_timeout(3000)  # until Meshcat has drawn
        slider = page.locator("#controls input")
        slider.evaluate("(e) => { e.value = 0.67 * e.max; e.oninput(); }")
        page.wait_for_timeout(3000)
        page.screenshot(path=FOLDER / "replay.png")


def photograph_runs(evaluation: Path) -> None:
    """The page of what the evaluation left of one motion."""
    folder = evaluation / "limb_0" / "ramps"
    command = [sys.executable, "-m", "soft_limb", "runs", folder, "-o", folder / "index.html"]
    subprocess.run([*command, "--force"], check=True)
    with browser_page(1280, 1050) as page:
        page.goto((folder / "index.html").resolve().as_uri())
        page.screenshot(path=FOLDER / "runs.png")


def save_dot(dot: str, path: Path) -> None:
    subprocess.run(["dot", "-Tsvg", "-o", path], input=dot, text=True, check=True)


# For each system: what is written below its type, and the signal at each output.
LIMB = {
    "joule_heating": ("(6)", ["T"]),
    "thermocouple_lag": ("(7)", ["V"]),
    "torque_map": ("(4)", ["f(T)"]),
    "manipulator": ("(2)", ["", "", "θ, θ̇ "]),
    "bend_angle": ("Sec. VI", ["φ"]),
}
TWIN = {
    "shape_memory_wires": ("(3), two thermal masses", ["torque", "T", "", "D"]),
    "rubber": ("stiffens, relaxes", ["f, q"]),
    "heater_cut_out": ("at 110 °C", ["D", ""]),
    "exact_bend": ("α/2 or chord", ["φ"]),
    "sensors": ("noise, drift, steps", ["V", "φ", "V, φ"]),
}
COLLECTING = {
    "limb_twin": ("or SerialLimb", ["V", "φ"]),
    "equilibrium_schedule": ("next angle when settled", ["φ_eq"]),
    "bend_angle_controller": ("PI", ["D"]),
}


def collecting_diagram() -> Diagram:
    """What `calibration.collect_equilibria` simulates, but for the recording."""
    builder = DiagramBuilder()
    limb = builder.AddNamedSystem("limb_twin", LimbTwin())
    schedule = builder.AddNamedSystem("equilibrium_schedule", EquilibriumSchedule([0.5]))
    controller = BendAngleController(limb.parameters, "right")
    builder.AddNamedSystem("bend_angle_controller", controller)
    for name in ("bend_angle", "measured_temperature"):
        for system in (schedule, controller):
            builder.Connect(limb.GetOutputPort(name), system.GetInputPort(name))
    builder.Connect(schedule.get_output_port(), controller.GetInputPort("set_point"))
    builder.Connect(controller.get_output_port(), limb.GetInputPort("duty"))
    return builder.Build()


def diagram_dot(
    diagram: Diagram,
    notes: Mapping[str, tuple[str, Sequence[str]]],
    hidden: Sequence[str] = (),
    direction: str = "LR",
) -> str:
    """A diagram as Drake knows it, without the ports that are not connected.

    Drake's own drawing has all ports of the plant, most of them unused, and is
    three times as wide as a page.

    Args:
        notes: for systems by name, what is said of them and of their outputs.
        hidden: names of systems that are left out.
        direction: in which signals run, "LR" or "TB".
    """
    lines, nodes = [], {}  # the names of systems that were given none change from run to run
    for system in diagram.GetSystems():
        name = system.get_name()
        nodes[name] = f"s{len(nodes)}"
        if name not in hidden:
            label = type(system).__name__.partition("_𝓣")[0]
            note = f"<br/>{notes[name][0]}" if name in notes else ""
            lines.append(f"{nodes[name]} [label=<<b>{label}</b>{note}>];")

    def signal(system, port) -> str:
        signals = notes.get(system.get_name(), ("", []))[1]
        return signals[int(port)] if int(port) < len(signals) else ""

    edges = []  # Drake has them in another order each time
    for (target, index), (source, port) in diagram.connection_map().items():
        if target.get_name() not in hidden:
            edge = f"{nodes[source.get_name()]} -> {nodes[target.get_name()]}"
            edges.append((edge, int(index), f'[label=" {signal(source, port)} "];'))
    lines += [f"{edge} {label}" for edge, _, label in sorted(edges)]
    plain = 'shape=plain, style="", fontsize=13, fontcolor='
    for index in range(diagram.num_input_ports()):
        name = diagram.get_input_port(index).get_name()
        lines.append(f'"in_{name}" [label="{name}", {plain}"#1f4fd8"];')
        for system, _ in diagram.GetInputPortLocators(InputPortIndex(index)):
            lines.append(f'"in_{name}" -> {nodes[system.get_name()]} [color="#1f4fd8"];')
    for index in range(diagram.num_output_ports()):
        name = diagram.get_output_port(index).get_name()
        source, port = diagram.get_output_port_locator(OutputPortIndex(index))
        lines.append(f'"out_{name}" [label="{name}", {plain}"#1a7f37"];')
        label = f'label=" {signal(source, port)} "'
        lines.append(f'{nodes[source.get_name()]} -> "out_{name}" [{label}, color="#1a7f37"];')
    return f"digraph {{ rankdir={direction}; {STYLE} {' '.join(lines)} }}"


PLANNING = """
reference [label="reference φ_ref\\nneed not be feasible", fillcolor=white];
feasible [label="check_temperature_limits\\nfull and zero duty:\\ncan (19), (20) be met?"];
guess [label="solve_quasi_static\\nheat and duty alone,\\nK θ = f(x)"];
program [label="TrajectoryProgram\\n(15)-(20) by\\nDirectCollocation"];
solve [label="solve_program\\nIPOPT, curvature of\\nthe wires; then its fallbacks"];
check [label="simulated_differences\\nthe duty again, radau3"];
trajectory [label="Trajectory\\nwith its PlanCheck", fillcolor=white];
refused [label="InfeasibleError:\\nwire, bound, from when", fillcolor="#fdecea"];
failed [label="PlanningError:\\nno file", fillcolor="#fdecea"];
reference -> feasible -> guess -> program;
program -> solve -> check [constraint=false];
{rank=same; feasible; refused} {rank=same; program; solve} {rank=same; guess; check}
{rank=same; reference; trajectory; }
feasible -> refused [label=" no"];
trajectory -> failed [style=invis];
trajectory -> check [dir=back, label="within\\ntolerance"];
program -> check [style=invis, constraint=false];
check -> program [label="add knots", constraint=false, style=dashed];
failed -> check [dir=back, label="not after\\n4 times"];
"""

CALIBRATION = """
node [fillcolor="#eef2fb"];
subgraph recordings { node [fillcolor=white];
  sag [label="sag under gravity\\n10 trials"]; ring [label="ring-down from 45°\\n3 times"];
  heated [label="one wire heated\\nC^l, C^r"]; both [label="both wires heated\\nC^m"]; }
k [label="fit_stiffness\\nλ, (9)"];
sigma [label="fit_damping\\nAlgorithm 1, (10)"];
heat [label="fit_heat_transfer\\nSec. V-C1, (6), (7), (12)"];
force [label="fit_force\\n(13)"];
limb [label="LimbParameters\\nlimb.yaml", fillcolor=white];
validation [label="validate\\nopen loop, Fig. 4"];
report [label="report\\ncalibration.html", fillcolor=white];
sag -> k; ring -> sigma; heated -> heat; both -> validation;
k -> sigma [label=" k"]; k -> force [label=" k"]; heat -> force [label=" T"];
k -> limb [label=" k"]; sigma -> limb [label=" σ"];
heat -> limb [label=" a1, a2, a3, T0"]; force -> limb [label=" β"];
limb -> validation -> report;
{rank=same; k; heat} {rank=same; sigma; force}
"""

ROBOT = """
rankdir=TB;
subgraph cluster_host { label="host"; labeljust=l; color="#999999"; style=rounded;
  source [label="TrajectorySource,\\nor a controller"];
  serial [label="SerialLimb\\na LeafSystem at 20 Hz"];
  journal [label="Journal\\neach sample to disk"];
  link [label="BoardLink\\nthreads read and write"];
  {rank=same; source -> serial [label=" D "]; serial -> journal [label=" V, φ "];}
  serial -> link [dir=both]; }
subgraph cluster_board { label="board: hardware/firmware"; labeljust=l; color="#999999";
  style=rounded;
  protocol [label="protocol.py\\nframes, CRC-32"];
  guard [label="guard.py\\nmay wires be heated?"];
  sensors [label="readings.py\\nMAX31855, bend"];
  {rank=same; protocol -> guard [dir=both, label=" COMMAND, SAMPLE "];
   guard -> sensors [dir=back, label=" V, α "];} }
limb [label="limb: MOSFETs, wires, sensors", fillcolor=white];
link -> protocol [dir=both, label=" serial port, 115200 baud"];
guard -> limb [label=" PWM "]; sensors -> limb [dir=back];
"""


def draw_links(parameters: LimbParameters) -> Figure:
    """Fig. 2 with the lengths, boxes and wires of the generated URDF."""
    robot = ElementTree.fromstring(limb_urdf(parameters.segments))
    theta = np.deg2rad(14.0)
    figure = Figure(figsize=(8, 6), layout="constrained")
    axis = figure.subplots()
    colors = dict(zip(("wire_left", "wire_right"), LEFT_RIGHT_COLORS, strict=True))
    frame = Affine2D()  # of a link, mm
    joints = robot.findall("joint")
    for number, joint in enumerate(joints, 1):
        link = robot.find(f"link[@name='{joint.find('child').get('link')}']")
        frame = Affine2D().rotate(theta).translate(*_millimetres(joint.find("origin"))) + frame
        for visual in link.findall("visual"):
            if (name := visual.get("name")) != "joint":
                outline = _outline(visual, frame + axis.transData)
                color = colors.get(name, "#e6e9f0")
                outline.set(facecolor=color, edgecolor="0.55", linewidth=0.6)
                axis.add_patch(outline)
        axis.plot(*frame.transform([0, 0]), "o", color="black", markersize=6, zorder=3)
        axis.annotate(f"joint_{number}", frame.transform([4, -10.5]), ha="center")
        mass = _millimetres(link.find("inertial/origin"))
        axis.plot(*frame.transform(mass), "x", color="0.25", markersize=7, zorder=3)
        axis.annotate(f"$r_{number}$", frame.transform(np.add(mass, [0, 6.5])), ha="center")
    length = 1000 * parameters.segments[0].length / parameters.segments[0].links
    tip, beyond = frame.transform([[length, 0], [length + 22, 0]])
    bracket = _outline(robot.find("link[@name='base']/visual"), axis.transData)
    bracket.set(facecolor="0.3", linewidth=0)
    axis.add_patch(bracket)

    arrow = {"arrowstyle": "-|>", "linewidth": 1.8, "color": "#1f4fd8"}
    for label, end, shift in (("E1", (32, 0), (3, -2)), ("E2", (0, 32), (-2, 3))):
        axis.annotate("", end, (0, 0), arrowprops=arrow)
        axis.annotate(label, np.add(end, shift), color="#1f4fd8", fontsize=13, weight="bold")
    axis.plot([0, 100], [0, 0], ":", color="0.5", linewidth=1)
    axis.plot(*np.transpose([[0, 0], tip]), "--", color="#c2268f", linewidth=1.4)
    axis.plot(*tip, "o", color="#c2268f", markersize=6)
    axis.annotate("tip t", np.add(tip, [2, 2]), color="#c2268f", fontsize=13)
    phi, alpha = np.arctan2(tip[1], tip[0]), len(joints) * theta
    axis.add_patch(Arc((0, 0), 124, 124, theta2=np.rad2deg(phi), color="#c2268f", linewidth=1.4))
    axis.annotate("φ", (66 * np.cos(phi / 3), 66 * np.sin(phi / 3)), color="#c2268f", fontsize=15)
    axis.plot(*np.transpose([tip, beyond]), color="0.35", linewidth=1.2)
    axis.plot([tip[0], tip[0] + 22], [tip[1], tip[1]], ":", color="0.5", linewidth=1)
    axis.add_patch(Arc(tip, 28, 28, theta2=np.rad2deg(alpha), color="0.35", linewidth=1.2))
    axis.annotate("α", np.add(tip, [15, 8]), fontsize=15, color="0.35")
    for (wire, color), x in zip(colors.items(), (0.60, 0.80), strict=True):
        axis.text(x, 0.02, wire, color=color, transform=axis.transAxes, fontsize=13)
    axis.set(xlim=(-14, 106), xlabel="along E1 (mm)", ylabel="along E2 (mm)", aspect="equal")
    axis.spines[["top", "right"]].set_visible(False)
    return figure


def _outline(visual, transform: Transform) -> Rectangle:
    """The outline of a link's box, or of a cylinder along the link, seen along E3."""
    shape = visual.find("geometry")[0]
    if shape.tag == "box":
        size = _millimetres(shape, "size")
    else:
        size = 1000 * np.array([float(shape.get("length")), 2 * float(shape.get("radius"))])
    corner = _millimetres(visual.find("origin")) - size / 2
    return Rectangle(corner, *size, transform=transform)


def _millimetres(element, attribute: str = "xyz") -> np.ndarray:
    """The first two of an attribute's lengths, along E1 and E2."""
    return 1000 * np.array(element.get(attribute).split()[:2], float)


# From where limbs in space are seen: to the right, up, and to the eye, in the limb's frame.
TO_EYE = np.array([[0.707, 0.707, 0.0], [-0.299, 0.299, 0.906], [0.641, -0.641, 0.423]])


def draw_in_space(plan: Trajectory, recording: Recording) -> Figure:
    """A limb of one segment that draws with its tip: some poses, and the paths of tips."""
    parameters, plan = recording.parameters, plan.since_start()
    far = np.linalg.norm(plan.reference, axis=0)
    begin = plan.time[np.argmax(far > 0.9 * far.max())]  # it waited, and approached
    times = np.linspace(begin, recording.time[-1], 5)[:-1]
    figure = Figure(figsize=(6.2, 4.6), layout="constrained")
    axis = figure.subplots()
    bracket = 1000 * np.array([6e-3, 0.02, 0.02])
    for face in range(3):  # those that are seen end at +E1, -E2 and +E3
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        corners = np.insert(corners, face, (1, -1, 1)[face], axis=1) * bracket / 2
        corners = TO_EYE[:2] @ (corners - [bracket[0] / 2, 0.0, 0.0]).T
        axis.add_patch(Polygon(corners.T, facecolor=("0.30", "0.22", "0.42")[face]))
    motion = joint_angle_trajectory(recording)
    poses = [motion.value(time)[:, 0] for time in times]
    *tips, depth = 1000 * TO_EYE @ tip_position(parameters, np.transpose(poses))
    tips = np.transpose(tips)
    for pose in np.argsort(depth):
        state = recording.wire_temperature
        heat = recording.measured_temperature if state is None else state
        at = [np.interp(times[pose], recording.time, row) for row in heat]
        _draw_pose(axis, parameters, poses[pose], wire_color(parameters, at))
        outwards = tips[pose] - tips.mean(axis=0)
        beside = tips[pose] + 12 * outwards / np.linalg.norm(outwards)
        axis.text(*beside, f"{times[pose]:.0f} s", ha="center", va="center")
        axis.update_datalim([beside])
    for label, angles, color, style in (
        ("reference", ghost_of_reference(plan).joint_angles, REFERENCE_COLOR, "-"),
        ("plan", joint_angle_trajectory(plan), PLAN_COLOR, "--"),
        (f"limb ({recording.how})", motion, ROLLOUT_COLOR, "-"),
    ):
        along = angles.vector_values(np.linspace(0, recording.time[-1], 999))
        right, up, _ = 1000 * TO_EYE @ tip_position(parameters, along)
        axis.plot(right, up, style, color=color, linewidth=1.6, label=f"tip of the {label}")
    for name, end in zip(("E1", "E2", "E3"), TO_EYE[:2].T, strict=True):
        reach = 118 if name == "E1" else 36
        arrow = {"arrowstyle": "-|>", "color": "0.35", "linewidth": 1.0}
        axis.annotate("", reach * end, (0, 0), arrowprops=arrow, zorder=0.5)
        axis.text(*(reach + 6) * end, name, color="0.35", ha="center", va="center")
        axis.update_datalim([(reach + 6) * end])
    limits = parameters.temperature_limits
    values = np.linspace(parameters.ambient_temperature, limits.maximum, 100)
    colors = ListedColormap(wire_color(parameters, values))
    shades = ScalarMappable(Normalize(values[0], values[-1]), colors)
    scale = axis.inset_axes([-12, -58, 45, 2.5], transform=axis.transData)
    figure.colorbar(shades, scale, orientation="horizontal", label="wire temperature (°C)")
    axis.plot([-12, 8], [-42, -42], color="0.2", linewidth=2)
    axis.text(-2, -41, "20 mm", ha="center")
    axis.legend(loc="upper right", frameon=False)
    missed = np.rad2deg(reference_distances(plan, [recording]).done)
    axis.set_title(
        f"mean distance of the bend from the circle, as read: {missed:.1f}°", fontsize=10
    )
    axis.set(aspect="equal")
    axis.set_axis_off()
    return figure


def _draw_pose(axis, parameters: LimbParameters, joint_angles: np.ndarray, colors) -> None:
    """Wires as they run, the farthest first, in clear silicone."""
    (segment,) = parameters.segments
    ends = link_positions(parameters, joint_angles)
    layout = Layout(parameters)
    placed = Chain(layout, ca.SX(joint_angles)).frames
    frames = [ca.DM(placed[joint]).full() for joint in layout.last_joints]

    def seen(e2: float, e3: float) -> np.ndarray:
        """The curve of what runs at a place in the section, mm."""
        middles = (ends[:-1] + ends[1:]) / 2 + [frame @ [0, e2, e3] for frame in frames]
        first, last = ends[0] + [0, e2, e3], ends[-1] + frames[-1] @ [0, e2, e3]
        points = 1000 * TO_EYE @ np.vstack([first, middles, last]).T
        where = np.cumsum(np.append(0, np.linalg.norm(np.diff(points), axis=0)))
        return CubicSpline(where, points, axis=1)(np.linspace(0, where[-1], 60))

    def tube(curve: np.ndarray, radius: float, color, **style) -> None:
        along = np.gradient(curve[:2], axis=1)
        side = radius * np.array([-along[1], along[0]]) / np.linalg.norm(along, axis=0)
        outline = np.hstack([curve[:2] + side, (curve[:2] - side)[:, ::-1]])
        axis.add_patch(Polygon(outline.T, facecolor=color, linewidth=0, **style))

    curves = [seen(wire.e2, wire.e3) for wire in segment.wires]
    for wire in np.argsort([curve[2].mean() for curve in curves]):
        for share in np.linspace(1.0, 0.2, 9):  # lighter towards the middle
            shade = colors[wire] * (1.15 - 0.45 * share) + 0.12 * (1 - share)
            tube(curves[wire], 1.5 * share, shade.clip(0, 1))
    axial, radius = seen(0, 0), 500 * segment.thickness
    clear = (1.0, "#6f86ab", 0.22), (0.9, "#c3cfe2", 0.25), (0.3, "white", 0.2)
    for share, color, alpha in clear:
        tube(axial, share * radius, color, alpha=alpha)
    turn = np.linspace(0, 2 * np.pi, 60)
    rim = (TO_EYE[:2] @ frames[-1] @ [0 * turn, np.cos(turn), np.sin(turn)]).T
    ends_of = (axial, radius, "#e6ebf3"), *zip(curves, [1.5] * len(curves), colors, strict=True)
    for curve, size, color in ends_of:
        end = Polygon(curve[:2, -1] + size * rim, facecolor=color, edgecolor="#6f86ab", lw=0.6)
        axis.add_patch(end)


def photograph_live_page(evaluation: Path) -> None:
    """The page of an emulated limb that follows a plan, shortly before the end."""
    parameters = LimbParameters.load(evaluation / "limb_0" / "limb.yaml")
    times = np.linspace(0.0, 12.0, 61)
    reference = references.from_samples(times, np.deg2rad(25.0) * np.sin(times / 2.0))
    trajectory = plan(parameters, reference, task=Task.closed_loop(parameters))
    # Playwright's functions belong to one thread, as do the signals of a run.
    with browser_page(1280, 860) as page, LivePage(open_browser=False) as live:
        page.goto(live.url)
        live.say("Replay of plan.csv, controller plan-feedback")
        controller = PlanFeedback(trajectory)
        run = threading.Thread(
            target=replay,
            args=(trajectory, LimbTwin.of(parameters)),
            kwargs={"controller": controller, "live": live},
        )
        run.start()
        page.get_by_text(re.compile(r"^10\.\d s of 12 s")).wait_for()
        page.screenshot(path=FOLDER / "live.png")
        run.join()


@contextlib.contextmanager
def browser_page(width: int, height: int):
    """A page in the Chromium that is installed, or in Playwright's."""
    # Only photographs need a browser.
    from playwright.sync_api import sync_playwright

    installed = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
    arguments = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=installed, args=arguments)
        yield browser.new_page(viewport={"width": width, "height": height})
        browser.close()


PICTURES: dict[str, Callable[[Path], None]] = {
    "diagrams": make_diagrams,
    "plan": make_plan,
    "evaluation": copy_evaluation,
    "replay": photograph_replay,
    "runs": photograph_runs,
    "live": photograph_live_page,
    "walk": make_walk,
    "walk_in_space": make_walk_in_space,
    "gripper": make_gripper,
    "space": make_space,
}

if __name__ == "__main__":
    main()
