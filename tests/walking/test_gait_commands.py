"""``soft-limb gait`` and ``soft-limb walk`` as a shell sees them."""

import copy
import json
from unittest.mock import create_autospec

import numpy as np
import pytest

from calibration import Calibration
from calibration.estimate import Estimate
from calibration.paper_method.mechanics import StiffnessFit
from calibration.remarks import CalibrationError, Remark
from limb_systems import CalibrationRecord, LimbParameters, Recording, SegmentParameters
from planners import PlanningError
from soft_limb.command import main
from walking import Gait, GaitVariation, RobotParameters, RobotTwin, gait_planning, walk
from walking.commands.gaits import replan_gait
from walking.gait_request import GaitRequest
from walking.schedules import candidate_schedules
from walking.strides import fit_strides

from .conftest import quickened


@pytest.fixture
def robot(tmp_path):
    RobotParameters().save(tmp_path / "robot.yaml")
    return tmp_path / "robot.yaml"


def test_a_gait_is_planned_as_requested_and_saved(
    robot, checked_crawl, tmp_path, capsys, monkeypatch
):
    output = tmp_path / "gait.csv"
    picture = tmp_path / "gait.png"
    plan_gait = create_autospec(gait_planning.plan_gait, return_value=checked_crawl)
    monkeypatch.setattr("walking.commands.gaits.plan_gait", plan_gait)
    words = ["gait", str(robot), "-o", str(output), "--quick", "--plot", str(picture), "--json"]
    assert main(words) == 0
    said = json.loads(capsys.readouterr().out)
    plan_gait.assert_called_once_with(
        RobotParameters(),
        GaitRequest(temperature_margin=5.0),
        schedule=candidate_schedules(RobotParameters())[0],
        check=True,
        spread=False,
    )
    gait = Gait.load(output)
    assert gait.passed
    assert said["stride"] == gait.stride == checked_crawl.stride
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_robot_walks_by_a_gait(crawl, tmp_path, capsys):
    gait = quickened(crawl, 8.0)
    gait.check.simulation = GaitVariation("", [1.0])  # as if it was checked
    gait.save(tmp_path / "gait.csv")
    recorded = tmp_path / "walk.csv"
    words = ["walk", str(tmp_path / "gait.csv"), "-n", "1", "-o", str(recorded), "--model"]
    assert main([*words, "--controller", "open-loop", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert not said["fall"]
    recording = Recording.load(recorded)
    start = walk(gait, 1).duration - gait.period
    begin, end = np.interp([start, recording.time[-1]], recording.time, recording.body_pose[0])
    assert said["strides"] == pytest.approx([end - begin], rel=1e-2)
    assert end - begin > 0.5 * gait.stride


def test_no_gait_is_planned_anew_without_strides_that_tell_of_feet(
    checked_crawl, gait_in_space, tmp_path, capsys
):
    checked_crawl.save(tmp_path / "planar.csv")
    gait_in_space.save(tmp_path / "space.csv")
    for words, said in {
        "planar.csv": "--replan fits friction and the heights of feet of robots in space",
        "space.csv --port /dev/no_board": "--replan needs a camera that sees the body",
        "space.csv --model": "--model is the robot as planned; leave out --replan",
    }.items():
        file, *options = words.split()
        output = str(tmp_path / "walk.csv")
        assert main(["walk", str(tmp_path / file), "-o", output, "--replan", *options]) == 1
        assert said in capsys.readouterr().err
    with pytest.raises(CalibrationError, match="in space alone, not in a plane"):
        fit_strides(checked_crawl, None, 0.0, 2)


def test_a_gait_is_planned_anew_with_the_turn_that_was_asked_for(gait_in_space, monkeypatch):
    """Though simulation makes, and the gait announces, a share of it."""
    plan_gait = create_autospec(gait_planning.plan_gait, side_effect=PlanningError("none"))
    monkeypatch.setattr("walking.commands.gaits.plan_gait", plan_gait)
    gait = copy.deepcopy(gait_in_space)
    gait.check.made = 0.8
    assert replan_gait(gait, gait.robot) == (gait, "the gait is kept: none")
    assert plan_gait.call_args.kwargs["turn"] == pytest.approx(np.deg2rad(-25.0))


@pytest.mark.parametrize(("share", "requested"), [(0.7, 0.7), (np.nan, None)])
def test_a_gait_is_planned_anew_with_its_share_of_friction_if_it_has_one(
    gait_in_space, monkeypatch, share, requested
):
    plan_gait = create_autospec(gait_planning.plan_gait, side_effect=PlanningError("none"))
    monkeypatch.setattr("walking.commands.gaits.plan_gait", plan_gait)
    gait = copy.deepcopy(gait_in_space)
    gait.check.sticking_share = share
    replan_gait(gait, gait.robot)
    assert plan_gait.call_args.kwargs["sticking_share"] == requested


def made_up_calibration() -> Calibration:
    """Return a calibration of the stiffness alone, with a remark that forbids plans."""
    stiffness = Estimate(0.11, 0.001, "N·m/rad")
    limb = LimbParameters(segments=[SegmentParameters(stiffness=0.11)])
    limb.calibration = CalibrationRecord(["stiffness"], [0.11], [0.001], [[1e-6]])
    return Calibration(
        parameters=limb,
        ambient=Estimate(25.0, 0.1, "°C"),
        stiffness=StiffnessFit(stiffness, stiffness, 1.22, 1.22, np.array([-0.17]), []),
        damping=None,
        prediction=None,
        heat=[],
        force=[],
        validation=None,
        sources={},
        left_out=[Remark("sensor", "The limb does not ring as its sag says.")],
    )


def test_limbs_of_a_robot_are_fitted_one_by_one_and_put_back(tmp_path, capsys, monkeypatch):
    """Each limb is described by itself; in the robot it has a foot of 2 g at its tip."""
    robot = RobotParameters()
    robot.feet.mass = 0.002
    robot.limbs[1].parameters.payload = 0.001
    for name in ("rear", "front"):
        (tmp_path / "rec" / name).mkdir(parents=True)
    robot.save(tmp_path / "rec" / "robot.yaml")
    commands, described, reports = "soft_limb.commands.calibration", [], []
    calibration = made_up_calibration()  # of either limb

    def fit(folder, limb, *, method, **_):
        described.append((folder.name, limb, method))
        return calibration

    monkeypatch.setattr(f"{commands}.calibrate", fit)
    monkeypatch.setattr(f"{commands}.write_report", lambda *given: reports.append(given[1].name))
    words = ["fit", str(tmp_path / "rec"), "-o", str(tmp_path / "robot.yaml"), "--method", "paper"]
    assert main([*words, "--report", str(tmp_path / "fit.html"), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert described == [("rear", None, "paper"), ("front", None, "paper")]
    fitted = RobotParameters.load(tmp_path / "robot.yaml")
    for limb in fitted.limbs:
        assert limb.parameters.segments == calibration.parameters.segments
        assert limb.parameters.calibration is not None
        assert limb.parameters.payload == 0.0  # the recordings' limb has no foot
        k = said[limb.name]["estimates"]["stiffness"]["value"]
        assert k == pytest.approx(calibration.parameters.segments[0].stiffness)
        assert f"fit_{limb.name}.html" in reports
    assert [limb.position for limb in fitted.limbs] == [limb.position for limb in robot.limbs]


def test_a_robot_is_not_recorded_on_one_port(tmp_path, capsys):
    RobotParameters().save(tmp_path / "robot.yaml")
    words = ["collect", "-l", str(tmp_path / "robot.yaml"), "-o", str(tmp_path / "rec")]
    for port, sentence in (
        ("loop://", "give --port NAME=PORT for rear, front"),
        ("left=loop://", "A port is given for left, but the limbs of this robot are rear, front"),
    ):
        assert main([*words, "-p", port]) == 1
        assert sentence in capsys.readouterr().err
    assert not (tmp_path / "rec").exists()


@pytest.mark.whole
def test_a_calibrated_robot_walks_as_planned(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    RobotParameters().save("robot.yaml")
    for line in (
        "collect -l robot.yaml -o rec --emulated 3 --protocol excitation",
        "fit rec -o calibrated.yaml",
        "gait calibrated.yaml -o gait.csv --quick",
        "walk gait.csv -n 3 -o walk.csv",
    ):
        assert main(line.split()) == 0
    gait = Gait.load("gait.csv")
    assert RobotTwin.of(gait.robot).specimen.drawn == RobotTwin(seed=3).specimen.drawn
    travel = Recording.load("walk.csv").body_pose[0]
    assert travel[-1] - travel[0] == pytest.approx(3 * gait.stride, rel=0.1)


def test_robot_that_cannot_walk_is_refused_in_a_sentence(robot, tmp_path, capsys):
    output = tmp_path / "gait.csv"
    for change, sentence in (
        (["--schedule", "fx ss"], "The schedule is 'fx ss'; it must have phases of 2 letters"),
        (["--schedule", "fs sf"], "so that nothing holds the body"),
        (["--margin", "-5"], "temperature_margin is -5 °C; it must be from 0"),
        (["--set", "--turn", "left"], "plans gaits of all directions; leave out --turn."),
    ):
        assert main(["gait", str(robot), "-o", str(output), *change]) == 1
        said = capsys.readouterr()
        assert sentence in said.out + said.err
        assert "Traceback" not in said.err
        assert not output.exists()
