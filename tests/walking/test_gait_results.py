"""Gaits and what robots did are told by the commands on results, and on a page."""

import dataclasses
import html
import json
import re

import numpy as np
import pytest

from limb_systems import Recording
from soft_limb.command import main
from walking import GaitVariation, RobotParameters
from walking.commands.gait_report import gait_report, gait_verdict
from walking.commands.gait_summaries import gait_summary
from walking.gait_check import NOMINAL_IN_MUJOCO

from .conftest import quickened


@pytest.fixture
def folder(tmp_path, monkeypatch, gait):
    """A robot, its gait, checked, and two recordings of it that differ."""
    monkeypatch.chdir(tmp_path)
    gait.check.simulation = GaitVariation("", [0.99, 1.0, 1.002], 81.0)
    gait.check.spread = [GaitVariation("friction x 0.7", [0.5], 90.0, "its body is on the ground")]
    gait.robot.save("robot.yaml")
    gait.save("gait.csv")
    slow = RobotParameters()
    slow.ground.friction = 0.2
    for name, robot, share in (("walk", gait.robot, 1.0), ("slow", slow, 0.5)):
        Recording(
            time=gait.time,
            duty=gait.duty,
            measured_temperature=gait.measured_temperature,
            bend_angle=gait.bend_angle,
            parameters=gait.parameters,
            source="model",
            sample_rate=0.4,
            joint_state=gait.joint_state,
            robot=robot,
            body_pose=share * gait.body_pose,
            contact_force=gait.contact_force,
        ).save(f"{name}.csv")
    return tmp_path


def said(arguments: list[str], capsys) -> str:
    assert main(arguments) == 0
    return capsys.readouterr().out


def test_commands_on_results_take_gaits_and_robots(folder, capsys):
    shown = said(["show", "gait.csv", "walk.csv", "robot.yaml"], capsys)
    for words in (
        "stride 30.0 mm",
        "5.0 s  rear stick, front stick",
        "strides 50% to 50% of the planned one; falls with friction x 0.7",
        "travel 30.0 mm",
        "μ = 0.3, slope 0°",
    ):
        assert words in shown
    assert len(set(re.findall(r"digest (\w+)", shown))) == 1
    compared = json.loads(said(["compare", "walk.csv", "slow.csv", "--json"], capsys))
    changes = {change["name"]: change["values"] for change in compared["changes"]}
    assert changes["ground.friction"] == [0.3, 0.2]
    assert changes["travel"] == pytest.approx([0.03, 0.015])
    said(["runs", ".", "-o", "runs.html"], capsys)
    page = (folder / "runs.html").read_text(encoding="utf-8")
    led_to = page.partition("led to")[2][:400]
    assert {"#gait.csv", "#walk.csv"} <= set(re.findall(r'href="([^"]+)"', led_to))


def test_a_gait_s_page_has_its_verdict_its_check_and_the_robot_in_3d(folder, gait):
    gait = quickened(gait, 5.0)
    gait_report(gait, "gait.html", {"gait": "gait.csv"})
    page = (folder / "gait.html").read_text(encoding="utf-8")
    verdict = re.search(r'class="verdict">(.*?)</p>', page)[1]
    assert "30.0 mm in 3.0 s, 10.00 mm/s" in verdict
    assert "strides, from the second on, are 100.0% to 100.2% of the planned one" in verdict
    row = page.partition("friction x 0.7</td>")[2][:300]
    assert re.search(r"50\.0.*90<.*its body is on the ground", row)
    replay = html.unescape(re.search(r'<iframe [^>]*srcdoc="([^"]*)"', page)[1])
    hot = GaitVariation("parameters +-10%, draw 1", [1.1], 107.0)
    gait.check.spread.append(hot)
    assert "a wire reaches 107 °C, above its limit of 100 °C, with parameters +-10%, draw 1" in (
        gait_verdict(gait)
    )
    assert "On other robots or ground 1 of 2 fall; a gait of more steadiness" in gait_verdict(gait)
    gait.check.spread.insert(0, dataclasses.replace(gait.check.simulation, what=NOMINAL_IN_MUJOCO))
    assert "1 of 2 fall" in gait_verdict(gait)
    frames = int(re.search(r'type="range" min="0" max="(\d+)"', replay)[1])
    assert frames == pytest.approx(3 * 3.0 * 20)  # three cycles
    values = np.array(json.loads(re.search(r"const values = (\[\[.*?\]\]);", replay)[1]))
    x = values[2]  # after two bends
    np.testing.assert_allclose(x[[0, 60, 120, 180]], [0.0, 30.0, 60.0, 90.0], atol=0.051)
    assert 'href="gait.csv"' in page
    gait.check = dataclasses.replace(gait.check, violation=1e-3)
    assert "Not to be used: its constraints are violated" in gait_verdict(gait)


def test_a_page_of_a_robot_that_turns_on_the_spot_speaks_of_turns(
    gait_in_space, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("walking.commands.gait_report.replay_page", lambda _: "")
    gait = quickened(gait_in_space, 4.0)
    gait_report(gait, tmp_path / "gait.html")
    page = html.unescape((tmp_path / "gait.html").read_text(encoding="utf-8"))
    assert "Turns of 20.0° to the right in 2.0 s, 10.00 °/s, with wires up to 60 °C." in page
    assert "turns are 98.0% to 98.0% of the planned one" in page
    heads, cells = (re.findall(rf"<{tag}[^>]*>([^<]*)</{tag}>", page) for tag in ("th", "td"))
    shown = dict(zip(heads, cells[cells.index("as planned") :], strict=False))
    gait.check.simulation = GaitVariation(strides=[0.9, 0.99], aside=[0.3, 0.04])
    assert "at most 4.0% of it" in gait_verdict(gait)  # in the second cycle
    gait.check.sticking_share = 0.6
    gait.check.remark = "with less of friction used than the 0.8 planned first."
    assert "use at most 0.6 of μ; with less of friction used than" in str(gait_summary(gait))
    gait.check.spread = [GaitVariation("feet warped by +1 mm", fall="its body tilts")]
    assert "1 of 1 fall; a gait of a smaller sticking_share falls less" in gait_verdict(gait)
    assert (shown["mean turn, %"], shown["aside, %"], shown["T, °C"]) == ("98.0", "3.0", "61")
    Recording(
        time=gait.time,
        duty=gait.duty,
        measured_temperature=gait.wire_temperature,
        bend_angle=np.zeros((6, 5)),
        parameters=gait.parameters,
        source="model",
        sample_rate=2.0,
        robot=gait.robot,
        body_pose=gait.body_pose + np.outer([0.003, 0.004, 0, 0, 0, 0], np.linspace(0.0, 1.0, 5)),
    ).save(tmp_path / "walk.csv")
    shown = said(["show", str(tmp_path / "walk.csv")], capsys)
    assert "travel 5.0 mm" in shown
    assert "turn -20.0°" in shown
