"""The examples and the README's script run as a newcomer runs them."""

import contextlib
import io
import re
import runpy
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from limb_systems import (
    Limb,
    LimbParameters,
    Recording,
    Trajectory,
    simulate,
)
from planners import plan, references

from ..hardware.conftest import VirtualBoard
from ..hardware.virtual_time import VirtualTime
from ..limb_systems.plant_links import link_positions

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
PNG = b"\x89PNG"


def run(arguments, folder):
    """Run a script in a folder and return its output; in this process, which has Drake."""
    said, words = io.StringIO(), list(map(str, arguments))
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(said),
        mock.patch.object(sys, "argv", words),
        mock.patch.object(sys, "path", [str(Path(words[0]).parent), *sys.path]),
    ):
        runpy.run_path(words[0], run_name="__main__")
    return said.getvalue()


def test_readme_lists_every_example():
    readme = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| \[(\w+\.py)\]\(\1\)", readme, re.MULTILINE)
    assert sorted(listed) == sorted(path.name for path in EXAMPLES.glob("*.py"))
    commands = re.findall(r"`python examples/(\w+\.py)", readme)
    assert set(listed) <= set(commands)


def test_own_limb(tmp_path):
    """Sag and first mode of small angles, and (12) with one wire at T_max."""
    said = run([EXAMPLES / "own_limb.py", "-o", tmp_path], tmp_path)
    sag, left, right, mode = map(float, re.findall(r"(-?\d+\.\d)(?:°| Hz)", said))
    limb = LimbParameters.load(EXAMPLES / "own_limb.yaml")
    (segment,) = limb.segments
    heat = limb.temperature_limits.maximum - limb.ambient_temperature
    for angle, beta in (
        (left, -segment.wire("left").law.beta),
        (right, segment.wire("right").law.beta),
    ):
        bend = (segment.links + 1) / 2 * beta * heat / segment.stiffness
        assert angle == pytest.approx(np.rad2deg(bend), abs=0.06)

    n = segment.links
    weight = segment.mass * 9.81 * segment.length
    joints = weight * np.arange(n, 0, -1) ** 2 / (2 * n**2 * segment.stiffness)
    ends = np.append(0.0, np.cumsum(np.cumsum(joints)) * segment.length / n)
    assert -sag == pytest.approx(np.rad2deg(ends[-1] / segment.length), rel=0.05)
    centres = (ends[1:] + ends[:-1]) / 2
    rayleigh = np.sqrt(9.81 * centres.sum() / (centres**2).sum()) / (2 * np.pi)
    assert mode == pytest.approx(rayleigh, rel=0.05)
    assert (tmp_path / "own_limb.png").read_bytes().startswith(PNG)


HEATED_DEG = 3 * 4.7e-4 / 0.1246 * 57.14 * 57.296  # (12) at T0 - a2/a1 D = 82 °C


def test_script_of_the_readme_heats_a_limb():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    names = {}
    exec(re.search(r"```python\n(.*?)```", readme, re.DOTALL)[1], names)
    angle = names["log"].FindLog(names["simulator"].get_context()).data()[0, -1]
    assert np.rad2deg(angle) == pytest.approx(HEATED_DEG, rel=0.02)


def test_yaml_to_recording(tmp_path, monkeypatch):
    """The heated wire alone gets hot, and bends the limb to its side."""
    board = VirtualBoard(VirtualTime(monkeypatch))
    monkeypatch.setattr("hardware.emulated_port", lambda: contextlib.nullcontext(board.port))
    said = run([EXAMPLES / "yaml_to_recording.py", "-o", tmp_path], tmp_path)
    assert float(re.search(r"60 s: (.*)°", said)[1]) == pytest.approx(HEATED_DEG, rel=0.02)
    assert re.search(r"recorded +limb twin0000 on .*, emulated: 281 samples", said)
    trajectory = Trajectory.load(tmp_path / "plan.csv")
    assert trajectory.parameters == LimbParameters()  # as the file describes it
    recording = Recording.load(tmp_path / "replay.csv")
    asked = [np.interp(recording.time, trajectory.time, duty) for duty in trajectory.duty]
    np.testing.assert_allclose(recording.duty, asked, atol=0.01)
    left, right = recording.measured_temperature
    assert np.ptp(left) < 3.0
    expected = np.ptp(trajectory.wire_temperature[1])
    assert 0.4 * expected < np.ptp(right) < expected  # it lags
    assert np.rad2deg(recording.bend_angle[0, -20:].mean()) > 6.0
    assert (tmp_path / "replay.png").read_bytes().startswith(PNG)


@pytest.mark.whole
def test_supervised_controller(tmp_path):
    """T_max is 100 °C, which the supervisor holds, and a board cuts out at 110 °C."""
    said = run([EXAMPLES / "supervised_controller.py", "-o", tmp_path], tmp_path)
    alone, supervised = map(float, re.findall(r"wires got (.*) °C hot", said))
    assert alone > 115.0
    assert 95.0 < supervised < 110.0
    assert said.count("ended early") == 1
    for name in ("alone", "supervised"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(PNG)


@pytest.mark.whole
def test_two_segments(tmp_path):
    said = run([EXAMPLES / "two_segments.py", "-o", tmp_path], tmp_path)
    errors = [float(error) for error in re.findall(r"simulated within (.*)° of the plan\n", said)]
    assert len(errors) == 2
    assert max(errors) < 0.1
    recording = Recording.load(tmp_path / "two_segments.csv")
    for time, angles in ((28.0, (15.0, -15.0)), (38.0, (15.0, 20.0))):
        now = np.searchsorted(recording.time, time)
        np.testing.assert_allclose(np.rad2deg(recording.bend_angle[:, now]), angles, atol=1.0)
    assert (tmp_path / "two_segments.png").read_bytes().startswith(PNG)
    assert b"</html>" in (tmp_path / "two_segments.html").read_bytes()


@pytest.mark.whole
def test_figure_in_space(tmp_path):
    trajectory = plan(LimbParameters.in_space(), references.circle(np.deg2rad(10.0), 40.0))
    trajectory.save(tmp_path / "plan.csv")
    simulate(Limb(trajectory.parameters), trajectory).save(tmp_path / "recording.csv")
    files = "plan.csv", "recording.csv"
    run([EXAMPLES / "figure_in_space.py", *files, "-o", "space.png"], tmp_path)
    assert (tmp_path / "space.png").read_bytes().startswith(PNG)


@pytest.mark.whole
def test_render_motion(tmp_path):
    """The hot wire is seen where the camera is said to see it, and a loop is as fast as asked."""
    from PIL import Image
    from render_motion import MotionScene

    motion = simulate(Limb(), [0.0, 0.3], 8.0)
    scene = MotionScene(motion, (640, 440))
    picture = scene.at(8.0).astype(int)
    rows, columns = np.nonzero(picture[..., 0] - picture[..., 2] > 60)  # red more than blue
    ends = link_positions(motion.parameters, motion.joint_state[:5, -1])
    right_wire = [0.0, motion.parameters.wires[1].e2, motion.parameters.segments[0].width / 2]
    x, y = scene.pixels((ends[[0, -1]] + right_wire).T)
    assert columns.min() == pytest.approx(x[0], abs=6)
    assert columns.max() == pytest.approx(x[1], abs=12)
    assert rows.min() == pytest.approx(y[1], abs=12)  # it bends up
    motion.save(tmp_path / "motion.csv")
    run([EXAMPLES / "render_motion.py", "motion.csv", "-o", "motion.png"], tmp_path)
    assert (tmp_path / "motion.png").read_bytes().startswith(PNG)
    arguments = [EXAMPLES / "render_motion.py", "motion.csv", "-o", "motion.gif", "--pace", "20"]
    run(arguments, tmp_path)
    with Image.open(tmp_path / "motion.gif") as loop:
        assert (loop.n_frames, loop.info["duration"]) == (4, 100)


@pytest.mark.whole
def test_own_cost(tmp_path):
    """The mean of 3 s stays at the limit of the fuse in the windows that are said to be active."""
    said = run([EXAMPLES / "own_cost.py"], tmp_path)
    plan = Trajectory.load(tmp_path / "out" / "own_cost.csv")
    means = np.convolve(plan.duty.sum(axis=0), np.full(30, 1 / 30), "valid")
    assert means.max() == pytest.approx(0.5, abs=1e-6)
    full = np.flatnonzero(means > 0.5 - 1e-4)
    cost = 50 * (np.diff(plan.duty) ** 2).sum()
    assert f"jumps (450 costs): {cost:.3g}\n" in said
    active = re.search(r"fuse \(422 constraints\): active at (.*?)-.*-(.*?) s\n", said).groups()
    first_and_last = plan.time[[full[0], full[-1] + 29]]
    np.testing.assert_allclose(list(map(float, active)), first_and_last, atol=0.2)
    assert (tmp_path / "out" / "own_cost.png").read_bytes().startswith(PNG)


def test_own_diagram(tmp_path):
    said = run([EXAMPLES / "own_diagram.py"], tmp_path)
    assert said.startswith("after 20 s the arm hangs by 90°")
    assert (tmp_path / "out" / "own_diagram.png").read_bytes().startswith(PNG)


@pytest.mark.whole
def test_gripper(tmp_path):
    """Contact, of which the plan knows the springs of the finger alone, confirms force and time."""
    said = run([EXAMPLES / "gripper" / "gripper.py"], tmp_path)
    planned, opens, force, free = (
        float(re.search(pattern, said)[1])
        for pattern in (
            r"grip +([\d.]+) N",
            r"open ([\d.]+) s after",
            r"simulation +([\d.]+) N",
            r"free after ([\d.]+) s",
        )
    )
    assert force == pytest.approx(planned, rel=0.05)
    assert free == pytest.approx(opens, abs=0.2)
    assert (tmp_path / "out" / "gripper.png").read_bytes().startswith(PNG)


def test_many_limbs_at_once_are_drawn(tmp_path):
    said = run([EXAMPLES / "thousand_limbs.py", "-n", "5", "-o", tmp_path], tmp_path)
    assert "95% of 5 limbs" in said
    assert (tmp_path / "thousand_limbs.png").exists()
