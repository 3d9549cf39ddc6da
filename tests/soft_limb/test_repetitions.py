"""Learning over repetitions as a command, and what is on the disk whenever it ends."""

import dataclasses
import json
import re

import numpy as np
import pytest

from controllers import Learner
from hardware import HardwareError, LimbTwin, ReplayError
from limb_systems import Limb, LimbParameters, Recording, Trajectory
from limb_systems.progress import Progress
from planners import plan, references
from soft_limb.command import main
from soft_limb.runs.repetitions import PAUSE, repeat, rested_twins, wait_until_cool


@pytest.fixture(scope="module")
def short_plan() -> Trajectory:
    return plan(LimbParameters(), references.from_samples([0.0, 3.0], [0.0, 0.05]))


@pytest.fixture
def plan_file(short_plan, tmp_path):
    short_plan.save(tmp_path / "plan.csv")
    return str(tmp_path / "plan.csv")


def test_command_repeats_and_goes_on(plan_file, tmp_path, capsys, monkeypatch, look_at):
    monkeypatch.setattr("soft_limb.runs.repetitions.PAUSE", 1.0)  # of what takes longest to emulate
    folder = tmp_path / "learned"
    assert main(["learn", plan_file, "-n", "2", "-o", str(folder)]) == 0
    said = capsys.readouterr()
    assert re.match(r"takes about \d+ s for 2 repetitions of ", said.err)
    lines = said.out.splitlines()
    assert re.fullmatch(
        r"repetition  1: as read mean \|φ_ref - φ\| \d\.\d\d°, \|φ\* - φ\| \d\.\d\d°", lines[0]
    )
    assert lines[1].startswith("repetition  2: ")
    written = ["learning.txt", "learned.csv", "learning.png", "learning.html"]
    assert lines[2].startswith("reference   mean distance: measured ")
    assert lines[3].startswith("errors      mean |φ* - φ| ")
    assert lines[4] == f"written     {', '.join(str(folder / name) for name in written)}"
    made = {path.name for path in folder.iterdir()}
    assert made == {*written, "repetition_1.csv", "repetition_2.csv"}
    report = (folder / "learning.html").read_text(encoding="utf-8")
    for number, said in enumerate(lines[:2], 1):
        assert f'<a href="repetition_{number}.csv">' in report
        assert re.search(r"mean .* (\d\.\d\d)°", said)[1] in report
    look_at(folder / "learning.html")
    learned = Trajectory.load(folder / "learned.csv")
    assert learned.check.status == "learned"
    first, second = (Recording.load(folder / f"repetition_{n}.csv") for n in (1, 2))
    assert first.source == second.source == "emulated limb, seed 0"
    assert np.abs(first.duty - second.duty).max() > 1e-3  # the second had learned

    again = ["learn", plan_file, "-n", "3", "-o", str(folder), "--json"]
    assert main(again) == 0
    facts = json.loads(capsys.readouterr().out)
    assert len(facts["repetitions"]) == 3
    assert (folder / "repetition_3.csv").exists()
    third = Recording.load(folder / "repetition_3.csv")
    assert np.abs(third.bend_angle[:, :20] - first.bend_angle[:, :20]).min() > 0  # other noise
    # Nothing is left to do.
    before = (folder / "learning.txt").read_bytes()
    assert main(again) == 0
    assert (folder / "learning.txt").read_bytes() == before


def test_command_replaces_only_when_told_to(plan_file, short_plan, tmp_path, capsys):
    folder = tmp_path / "learned"
    folder.mkdir()
    (folder / "repetition_1.csv").write_text("of something else")
    order = ["learn", plan_file, "-n", "1", "-o", str(folder)]
    assert main(order) == 1
    assert "holds repetitions without learning.txt" in capsys.readouterr().err
    assert main([*order, "--force"]) == 0
    assert len(Recording.load(folder / "repetition_1.csv").time) == 61
    other = tmp_path / "other.csv"
    dataclasses.replace(short_plan, duty=short_plan.duty / 2).save(other)
    capsys.readouterr()
    assert main(["learn", str(other), "-n", "1", "-o", str(folder)]) == 1
    assert "is of another plan" in capsys.readouterr().err

    folder = tmp_path / "new"
    assert main(["learn", plan_file, "-n", "0", "-o", str(folder)]) == 1
    assert "--repetitions is 0; it must be 1 or more" in capsys.readouterr().err
    assert not folder.exists()


def test_recording_that_was_complete_is_learned_from_later(short_plan, tmp_path, monkeypatch):
    """Ctrl-C between a repetition and what is learned from it loses nothing."""

    def stop(*_):
        raise KeyboardInterrupt

    learner = Learner(short_plan)
    limbs = rested_twins(LimbTwin(seed=3), short_plan, learner)
    with monkeypatch.context() as patch:
        patch.setattr(Learner, "update", stop)
        with pytest.raises(KeyboardInterrupt):
            repeat(learner, limbs, 1, tmp_path)
    again = Learner.load(tmp_path / "learning.txt")
    assert not again.repetitions
    repeat(again, stop, 1, tmp_path)  # no limb is needed
    assert len(again.repetitions) == 1
    assert len(Learner.load(tmp_path / "learning.txt").repetitions) == 1


class Robot(Limb):
    """The model in place of a robot."""

    __slots__ = ()

    real_time = True

    def close(self):
        pass


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


def test_emulated_limbs_rest_between_repetitions(short_plan):
    rests = []

    class Twin:
        def again(self, pause):
            rests.append(pause)

    learner = Learner(short_plan)
    rested = rested_twins(Twin(), short_plan, learner)
    rested()
    rested()
    assert rests == [0.0, PAUSE]


def test_robots_rest_until_their_wires_are_cool(short_plan):
    start = short_plan.measured_temperature[:, 0]
    readings = iter(np.add(start, [[1.0, 20.0], [0.0, 5.0], [-8.0, 2.9], [0.0, 0.0]]))
    wait_until_cool(lambda: next(readings), short_plan, period=0.0)
    np.testing.assert_array_equal(next(readings), start)  # it did not look again
    with pytest.raises(ReplayError, match=r"the right wire is still at 45\.0 °C, but .* 25\.0 °C"):
        wait_until_cool(lambda: np.add(start, [0.0, 20.0]), short_plan, longest=0.0, period=1e-3)
