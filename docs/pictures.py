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

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Rectangle
from matplotlib.transforms import Affine2D, Transform
from pydrake.systems.framework import Diagram, DiagramBuilder, InputPortIndex, OutputPortIndex

from calibration import BendAngleController, EquilibriumSchedule
from controllers import PlanFeedback
from hardware import LimbTwin, Station, replay
from limb_systems import Limb, LimbParameters, Recording, Trajectory, simulate
from limb_systems.views.colors import LEFT_RIGHT_COLORS
from limb_systems.views.plots import save_figure
from planners import Task, plan, references
from soft_limb.command import main as main_command
from soft_limb.live_page import LivePage
from urdf import limb_urdf
from walking import Gait, Robot, RobotParameters, plan_gait
from walking.gait_set import schedules_on_the_spot
from walking.walk_trajectory import walk

FOLDER = Path(__file__).parent
EXAMPLES = FOLDER.parent / "examples"
sys.path[:0] = [str(EXAMPLES), str(EXAMPLES / "gripper")]

from figure_in_space import draw_in_space  # noqa: E402
from render_motion import Scene, animate, draw_moments  # noqa: E402

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


def make_links(_: Path) -> None:
    save_figure(draw_links(LimbParameters()), FOLDER / "links.png")


def copy_evaluation(evaluation: Path) -> None:
    for name in ("fig4.png", "fig5.png", "ways.png"):
        shutil.copy(evaluation / name, FOLDER)


def make_walk(_: Path) -> None:
    save_moments(plan_gait(RobotParameters(), spread=False), FOLDER / "walk.png")


def make_walk_in_space(_: Path) -> None:
    """A robot of four limbs that walks ahead, heats its wires for a turn, and turns on the spot."""
    robot = RobotParameters.in_space()
    ahead = plan_gait(robot, spread=False)
    schedule = schedules_on_the_spot(robot)[0]
    around = plan_gait(robot, turn=0.4, stride=0.0, schedule=schedule, spread=False)
    save_moments(ahead, FOLDER / "robot_in_space.png")
    duty = ahead.duty_trajectory(3)
    turn = walk(around, 3, heat=ahead.initial_heat, bend=ahead.bend_angle[:, 0]).duty_trajectory()
    turn.shiftRight(duty.end_time())
    duty.ConcatenateInTime(turn)
    motion = simulate(Robot(robot), duty, initial_state=ahead.initial_state)
    animate(motion, FOLDER / "walk_in_space.gif", pace=6.0)


def save_moments(gait: Gait, path: Path) -> None:
    """Draw a gait at six moments, of which the last one is the first a stride further."""
    save_figure(draw_moments(gait.repeated(2), np.linspace(0.0, gait.period, 6)), path)


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
        example = runpy.run_path(str(EXAMPLES / "gripper" / "gripper.py"))
    seen, station = example["seen"], Station(example["FOLDER"] / "scenario.yaml")
    scene_graph, plant = station.GetSubsystemByName("scene_graph"), station.plant
    center, to_eye, size = np.array([0.0, -0.008, 0.095]), [0.0, -0.98, 0.2], (340, 480)
    scene = Scene(station, plant, scene_graph, center, 0.1, to_eye, size)
    shots = []
    for time in (11.0, 15.0, 18.0, 28.0):
        k = np.searchsorted(seen["time"], time)
        for name, signal in seen.items():
            model, _, what = name.partition(".")
            if what in ("state", "joint_state"):
                instance = plant.GetModelInstanceByName(model)
                state = signal[: plant.num_positions(instance), k]
                plant.SetPositions(scene.context, instance, state)
        for name, wires in station.limbs.items():
            heat = seen[f"{name}.wire_temperature"][:, k]
            scene.color_wires(wires.parameters, heat, plant.GetModelInstanceByName(name))
        shots.append(scene.picture())
    plt.imsave(FOLDER / "gripper.png", np.hstack(shots))


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
    "shape_memory_wires": ("(3), two thermal masses", ["torque", "T", ""]),
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
    "links": make_links,
    "evaluation": copy_evaluation,
    "runs": photograph_runs,
    "live": photograph_live_page,
    "walk": make_walk,
    "walk_in_space": make_walk_in_space,
    "gripper": make_gripper,
    "space": make_space,
}

if __name__ == "__main__":
    main()
