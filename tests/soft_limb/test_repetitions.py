"""Learning over repetitions as a command, and what is on the disk whenever it ends."""

import json
import re

import numpy as np
import pytest

from controllers import Learner
from hardware import HardwareError, ReplayError
from limb_systems import Limb, Recording, Trajectory
from limb_systems.progress import Progress
from soft_limb.command import main
from soft_limb.runs import repetitions
from soft_limb.runs.repetitions import REST_TIME, make_rested_twins, repeat, wait_for_cool_wires


@pytest.fixture
def plan_file(short_plan, tmp_path):
    short_plan.save(tmp_path / "plan.csv")
    return str(tmp_path / "plan.csv")


def test_command_repeats_and_goes_on(plan_file, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        "soft_limb.runs.repetitions.REST_TIME", 1.0
    )  # of what takes longest to emulate
    folder = tmp_path / "learned"
    assert main(["learn", plan_file, "-n", "2", "-o", str(folder)]) == 0
    said = capsys.readouterr()
    assert re.match(r"takes about \d+ s for 2 repetitions of ", said.err)
    lines = said.out.splitlines()
    distance = r"mean \|φ_ref - φ\| \d\.\d\d° as read, about (\d\.\d\d)° without the sensor's drift"
    error = r"mean \|φ\* - φ\| \d\.\d\d° as read"
    estimate = re.fullmatch(f"repetition  1: {distance}; {error}", lines[0])[1]
    assert lines[1].startswith("repetition  2: ")
    written = ["learning.txt", "learned.csv", "learning.html"]
    assert lines[2].startswith("reference   mean distance: measured ")
    without_drift = "estimated   mean |φ_ref - φ| without the sensor's drift: "
    assert lines[3].startswith(f"{without_drift}{estimate}°, ")
    assert lines[4].startswith("errors      mean |φ* - φ| ")
    assert lines[5] == f"written     {', '.join(str(folder / name) for name in written)}"
    made = {path.name for path in folder.iterdir()}
    assert made == {*written, "repetition_1.csv", "repetition_2.csv"}
    report = (folder / "learning.html").read_text(encoding="utf-8")
    for number, said in enumerate(lines[:2], 1):
        assert f'<a href="repetition_{number}.csv">' in report
        assert re.search(r"mean .* (\d\.\d\d)°", said)[1] in report
    learned = Trajectory.load(folder / "learned.csv")
    assert learned.check.status == "learned"
    first, second = (Recording.load(folder / f"repetition_{n}.csv") for n in (1, 2))
    assert first.source == second.source == "emulated limb, seed 0"
    assert np.abs(first.duty - second.duty).max() > 1e-3  # the second had learned

    again = ["learn", plan_file, "-n", "3", "-o", str(folder), "--json"]
    monkeypatch.setattr("soft_limb.runs.repetitions.write_learning_report", lambda *_: None)
    assert main(again) == 0
    facts = json.loads(capsys.readouterr().out)
    assert len(facts["repetitions"]) == 3
    assert (folder / "repetition_3.csv").exists()
    third = Recording.load(folder / "repetition_3.csv")
    difference = np.abs(third.bend_angle[:, :20] - first.bend_angle[:, :20])
    assert np.median(difference) > 2e-3  # rad: other noise
    # Nothing is left to do.
    before = (folder / "learning.txt").read_bytes()
    assert main(again) == 0
    assert (folder / "learning.txt").read_bytes() == before


class Robot(Limb):
    """The model in place of a robot."""

    __slots__ = ()

    real_time = True

    closed = False

    def close(self):
        self.closed = True


def test_robot_that_fails_leaves_an_interrupted_repetition(short_plan, tmp_path, monkeypatch):
    def fail(_, done, remark=""):
        if done >= 0.3:
            raise HardwareError("The board switched off.")

    learner = Learner(short_plan)
    with monkeypatch.context() as patch:
        patch.setattr(Progress, "update", fail)
        with (
            pytest.raises(HardwareError, match="switched off"),
            pytest.warns(UserWarning, match=r"repetition_1\.unfinished\.csv"),
        ):
            repeat(learner, lambda: Robot(short_plan.parameters), 2, tmp_path)
    again = Learner.load(tmp_path / "learning.txt")
    assert [r.interrupted for r in again.repetitions] == ["The board switched off."]
    assert (tmp_path / "repetition_1.unfinished.csv").exists()


def test_the_model_of_a_plan_repeats_it(short_plan, tmp_path):
    learner = Learner(short_plan)
    repeat(learner, lambda: Limb(short_plan.parameters), 1, tmp_path)
    (repetition,) = learner.repetitions
    assert repetition.interrupted == ""


def test_robot_is_closed_if_a_repetition_fails_before_it_starts(short_plan, tmp_path, monkeypatch):
    def fail(_):
        raise MemoryError

    robot = Robot(short_plan.parameters)
    monkeypatch.setattr(Learner, "source", fail)
    with pytest.raises(MemoryError):
        repeat(Learner(short_plan), lambda: robot, 1, tmp_path)
    assert robot.closed


def test_emulated_limbs_rest_between_repetitions(short_plan):
    rests = []

    class Twin:
        def after_rest(self, pause):
            rests.append(pause)

    learner = Learner(short_plan)
    rested = make_rested_twins(Twin(), short_plan, learner)
    rested()
    rested()
    assert rests == [0.0, REST_TIME]


def test_robots_rest_until_their_wires_are_cool(short_plan, monkeypatch):
    monkeypatch.setattr(repetitions, "READ_PERIOD", 1e-3)
    start = short_plan.measured_temperature[:, 0]
    readings = iter(np.add(start, [[1.0, 20.0], [0.0, 5.0], [-8.0, 2.9], [0.0, 0.0]]))
    wait_for_cool_wires(lambda: next(readings), short_plan)
    np.testing.assert_array_equal(next(readings), start)  # it did not look again
    monkeypatch.setattr(repetitions, "MAX_REST_TIME", 0.0)
    with pytest.raises(ReplayError, match=r"the right wire is still at 45\.0 °C, but .* 25\.0 °C"):
        wait_for_cool_wires(lambda: np.add(start, [0.0, 20.0]), short_plan)
