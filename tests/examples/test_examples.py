"""The examples and the README's script run as a newcomer runs them."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from limb_systems import LimbParameters, Recording, Trajectory

ROOT = Path(__file__).parents[2]


def run(arguments, folder):
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=True
    )


def test_compose_diagram(tmp_path):
    """(12): the bend of the equilibrium temperature, T0 - a2/a1 D = 82 °C."""
    said = run([ROOT / "examples/compose_diagram.py"], tmp_path).stdout
    angle = float(re.search(r"60 s: (.*)°", said)[1])
    assert angle == pytest.approx(3 * 4.7e-4 / 0.1246 * 57.14 * 57.296, rel=0.02)


def test_plan_and_replay(tmp_path):
    done = run([ROOT / "examples/plan_and_replay.py", tmp_path], tmp_path)
    assert "mean tracking error on the emulated limb" in done.stdout
    assert done.stderr == ""
    Trajectory.load(tmp_path / "my_trajectory.csv")
    Recording.load(tmp_path / "my_recording.csv")
    assert (tmp_path / "my_plan.png").stat().st_size > 10_000


def test_demo_leaves_what_it_promises(tmp_path):
    done = run([ROOT / "examples/demo.py", tmp_path / "out"], tmp_path)
    assert all(line.startswith("simulating: ") for line in done.stderr.splitlines())
    assert "emulated" in done.stdout
    out = tmp_path / "out"
    limb = LimbParameters.load(out / "limb.yaml")
    assert limb != LimbParameters()
    trajectory = Trajectory.load(out / "trajectory.csv")
    assert trajectory.parameters == limb
    assert len(list((out / "recordings").iterdir())) == 16
    assert b"</html>" in (out / "calibration.html").read_bytes()
    assert trajectory.check.failure() is None
    for number in range(1, 6):
        assert Recording.load(out / f"rollout_{number}.csv").time[-1] == pytest.approx(60.0)
    assert Recording.load(out / "serial.csv").time[-1] == pytest.approx(5.0)
    for name in ("fig4.png", "fig5.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    assert b"</html>" in (out / "replay.html").read_bytes()


def test_readme_script_is_the_example():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    example = (ROOT / "examples/compose_diagram.py").read_text(encoding="utf-8")
    script = re.search(r"```python\n(.*?)```", readme, re.DOTALL)[1]
    assert script in example
