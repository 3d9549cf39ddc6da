"""``soft-limb gait`` and ``soft-limb walk`` as a shell sees them."""

import json

import pytest

from limb_systems import Gait, Recording, RobotParameters
from soft_limb.command import main


@pytest.fixture
def robot(tmp_path):
    """A crawler whose wires heat and cool four times as fast, so that it walks in little time."""
    parameters = RobotParameters()
    for wire in (wire for limb in parameters.limbs for wire in limb.parameters.wires):
        wire.law.a1, wire.law.a2, wire.law.a3 = 4 * wire.law.a1, 4 * wire.law.a2, 4 * wire.law.a3
    parameters.body.mass = 0.021
    parameters.save(tmp_path / "robot.yaml")
    return tmp_path / "robot.yaml"


def test_a_robot_gets_a_gait_and_walks_by_it(robot, tmp_path, capsys):
    output, picture = tmp_path / "gait.csv", tmp_path / "gait.png"
    words = ["gait", str(robot), "-o", str(output), "--quick", "--plot", str(picture), "--json"]
    assert main(words) == 0
    said = json.loads(capsys.readouterr().out)
    gait = Gait.load(output)
    assert gait.passed
    assert said["stride"] == gait.stride
    assert gait.wire_temperature.max() < 95.0 + 1e-6  # T_max less the margin
    assert gait.robot == RobotParameters.load(robot)
    assert picture.read_bytes().startswith(b"\x89PNG")

    recorded = tmp_path / "walk.csv"
    words = ["walk", str(output), "-n", "2", "-o", str(recorded), "--model"]
    assert main([*words, "--controller", "open-loop", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["strides"][1] == pytest.approx(gait.stride, rel=0.02)
    assert not said["fall"]
    walked = Recording.load(recorded).body_pose[0]
    assert walked[-1] - walked[0] == pytest.approx(1.9 * gait.stride, rel=0.1)


def test_what_cannot_walk_is_said_in_a_sentence(robot, tmp_path, capsys):
    output = tmp_path / "gait.csv"
    for change, sentence in (
        (["--schedule", "fx ss"], "The schedule is 'fx ss'; it must have phases of 2 letters"),
        (["--schedule", "fs sf"], "so that nothing holds the body"),
        (["--margin", "-5"], "temperature_margin is -5 °C; it must be from 0"),
    ):
        assert main(["gait", str(robot), "-o", str(output), *change]) == 1
        said = capsys.readouterr()
        assert sentence in said.out + said.err
        assert "Traceback" not in said.err
        assert not output.exists()
