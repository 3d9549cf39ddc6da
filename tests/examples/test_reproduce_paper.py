"""The paper's evaluation: its numbers, counted again by hand, and the split of the error."""

import copy
import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.prediction import LawFit
from calibration.unknowns import unknowns_of
from hardware.emulation.specimen import Specimen
from limb_systems import Limb, LimbParameters, LinearLaw, Recording, Trajectory, simulate
from planners import plan, references

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The folder that the demo leaves, and what it said, with few and short recordings."""
    folder = tmp_path_factory.mktemp("demo") / "out"
    few = ["--protocol", "paper", "--angles", "2", "--rollouts", "1"]
    done = subprocess.run(
        [sys.executable, EXAMPLES / "reproduce_paper.py", folder, "--quick", *few],
        cwd=folder.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder, done.stdout, done.stderr


@pytest.fixture(scope="module")
def evaluation():
    """The modules beside the script, which are no package of the distribution."""
    sys.path.insert(0, str(EXAMPLES))
    try:
        from evaluation import error_split, experiment, tables

        yield SimpleNamespace(error_split=error_split, experiment=experiment, tables=tables)
    finally:
        sys.path.remove(str(EXAMPLES))


def test_demo_leaves_what_it_promises(demo):
    folder, said, complained = demo
    assert all(re.match("simulating|calibrating", line) for line in complained.splitlines())
    assert "These limbs are emulated." in said
    assert re.findall(r"^(\d)/6 .* \.\.\.$", said, re.MULTILINE) == list("123456")
    limb = LimbParameters.load(folder / "limb_0" / "limb.yaml")
    assert limb != LimbParameters()
    recordings = {path.stem for path in (folder / "limb_0" / "recordings").iterdir()}
    trials = {f"sag_{n}" for n in range(1, 11)} | {f"ring_down_{n}" for n in range(1, 4)}
    assert recordings == trials | {"right", "left", "both"}
    assert b"</html>" in (folder / "limb_0" / "calibration.html").read_bytes()
    for name in ("fig4", "fig5", "fig6a", "fig6b", "fig7"):
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    for name in ("replay", "report"):
        assert b"</html>" in (folder / f"{name}.html").read_bytes()


def test_table_1_is_that_of_the_files(demo):
    folder, said, _ = demo
    (summary,) = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert summary["seed"] == 0
    for motion, name in (("Validation", "validation"), ("T&R 1", "t_and_r_1")):
        trajectory = Trajectory.load(folder / "limb_0" / name / "trajectory.csv")
        assert trajectory.check.failure() is None
        (path,) = (folder / "limb_0" / name).glob("rollout_*.csv")
        rollout = Recording.load(path)
        assert rollout.time[-1] == pytest.approx(trajectory.duration)
        planned = np.interp(rollout.time, trajectory.time, trajectory.bend_angle[0])
        errors = np.rad2deg(np.abs(planned - rollout.bend_angle[0]))
        expected = [np.mean(errors), np.median(errors), np.percentile(errors, 90)]
        assert summary["tracking"][motion] == pytest.approx(expected, abs=0.01)
        assert " ".join(f"{value:.2f}" for value in summary["tracking"][motion]) in re.sub(
            " +", " ", said
        )


def test_taught_motions_are_what_the_paper_says(demo):
    """The first is faster and within a smaller range, the second has holds."""
    folder, *_ = demo
    first, second = (
        Recording.load(folder / "limb_0" / f"t_and_r_{number}" / "taught.csv") for number in (1, 2)
    )
    for taught in (first, second):
        assert (taught.duty == 0).all()
    assert np.ptp(first.bend_angle) < 0.7 * np.ptp(second.bend_angle)
    assert np.ptp(np.rad2deg(second.bend_angle)) == pytest.approx(50.0, rel=0.15)  # Sec. VIII

    def speed(taught):
        smooth = references.from_recording(taught, 1.0)
        return np.rad2deg(np.abs(smooth.MakeDerivative().vector_values(taught.time[20:-20])))

    assert np.median(speed(first)) > 2 * np.median(speed(second))


def test_interval_of_the_mean_is_students(evaluation):
    """Of 1, 2, 3, 4, 5: standard error sqrt(2.5 / 5), and t(97.5%, 4) = 2.776 in any table."""
    mean, margin = evaluation.tables.mean_and_margin([1.0, 2.0, 3.0, 4.0, 5.0])
    assert mean == 3.0
    assert margin == pytest.approx(2.776 * np.sqrt(0.5), rel=1e-3)


@pytest.fixture(scope="module")
def driven(evaluation):
    """A limb that is a model, which was calibrated with other parameters, and its motion."""
    calibrated = LimbParameters()
    times = np.linspace(0.0, 40.0, 401)
    swing = np.deg2rad(15.0) * np.sin(2 * np.pi * times / 15.0) * (times > 15.0)
    trajectory = plan(calibrated, references.from_samples(times, swing))
    truth = copy.deepcopy(calibrated)
    truth.segments[0].wire("left").law.a1, truth.segments[0].wire("right").law.a2 = -0.05, 23.0
    exact = simulate(Limb(truth), trajectory)
    unknowns = unknowns_of(LinearLaw, calibrated.segments[0])
    fitted = np.array([unknown.center for unknown in unknowns])
    covariance = np.eye(len(unknowns))
    fit = LawFit(LinearLaw, calibrated.segments[0], unknowns, fitted, covariance, 25.0, [])
    calibration = SimpleNamespace(
        parameters=calibrated,
        prediction=SimpleNamespace(fit=fit, best=SimpleNamespace(name="LinearLaw")),
    )

    def experiment(rollouts):
        motions = [
            evaluation.experiment.Motion(name, None, trajectory, recordings, exact)
            for name, recordings in rollouts.items()
        ]
        return evaluation.experiment.Experiment(
            Specimen(calibrated, 0), {}, calibration, motions, {}
        )

    return SimpleNamespace(
        trajectory=trajectory, calibrated=calibrated, exact=exact, experiment=experiment
    )


def test_split_of_a_limb_that_is_a_model_finds_its_parameters(evaluation, driven):
    """The limb is the model with other a1 and a2, so that its form makes no difference."""
    read = copy.deepcopy(driven.exact)
    read.bend_angle = read.bend_angle + np.deg2rad(0.5)
    steps = evaluation.error_split.error_split(driven.experiment({"swing": [read]}))["swing"]
    assert steps["collocation"][0] < 0.1
    assert steps["form of the model"][0] < 0.2
    assert steps["bend sensor"][0] == pytest.approx(0.5)
    model = simulate(Limb(driven.calibrated), driven.trajectory)
    difference = np.rad2deg(np.abs(driven.exact.bend_angle - model.bend_angle))
    assert difference.mean() > 0.9
    assert steps["parameters"][0] == pytest.approx(difference.mean(), abs=0.2)
    # Without the errors of calibration the sensor's half a degree would be left.
    assert steps["parameters"][1] == pytest.approx(0.5, abs=0.2)


def test_rollouts_that_were_aborted_are_counted_and_compared_up_to_then(evaluation, driven):
    exact = driven.exact
    whole = dataclasses.replace(exact, bend_angle=exact.bend_angle + np.deg2rad(0.5))
    signals = ("time", "duty", "measured_temperature", "bend_angle")
    signals += ("wire_temperature", "joint_state")
    half = {name: getattr(exact, name)[..., :401] for name in signals}
    half["bend_angle"] = half["bend_angle"] + np.deg2rad(2.5)
    aborted = dataclasses.replace(exact, **half, interrupted="too hot")
    names = list(evaluation.tables.PAPER_TABLE_1)
    rollouts = ([aborted, whole], [whole, whole], [aborted, aborted])
    experiment = driven.experiment(dict(zip(names, rollouts, strict=True)))
    summary = evaluation.tables.summarize(experiment)
    assert summary.rollouts == 2
    assert list(summary.aborted.values()) == [1, 0, 2]
    assert [row[3] for row in summary.approaches[evaluation.tables.PREDICTION].values()] == [
        0.5,
        0.0,
        1.0,
    ]
    planned = np.interp(exact.time, driven.trajectory.time, driven.trajectory.bend_angle[0])
    away = np.rad2deg(exact.bend_angle[0] - planned)
    errors = np.abs(np.concatenate([away[:401] + 2.5, away + 0.5]))
    expected = [np.mean(errors), np.median(errors), np.percentile(errors, 90)]
    assert summary.tracking[names[0]] == pytest.approx(expected, abs=0.02)
    assert summary.split[names[0]]["bend sensor"][0] == pytest.approx(2.5)
    rows = evaluation.tables.table_1([summary, summary])
    assert [row[-1] for row in rows] == ["2 of 4", "", "0 of 4", "", "4 of 4", ""]


def test_absences_are_compared_limb_by_limb(evaluation):
    def summary(seed, absent, error):
        motions = ("Validation", "T&R 1", "T&R 2")
        split = {m: dict.fromkeys(evaluation.error_split.STEPS, (1.0, 1.0)) for m in motions}
        first = dict.fromkeys(motions, error)
        return evaluation.tables.Summary(seed, absent, 1, {}, {}, first, split, {}, "LinearLaw")

    summaries = [summary(0, (), 2.0), summary(1, (), 6.0)]
    summaries += [summary(0, ("silicone",), 3.0), summary(1, ("silicone",), 7.2)]
    rows = evaluation.tables.absence_table(summaries)
    assert rows[0] == ["with all effects", "4.00", "4.00", "4.00"]
    # Changes of 1 and 1.2: mean 1.1, standard error 0.1, and t(97.5%, 1) = 12.706.
    assert rows[1] == ["without silicone"] + ["5.10 (+1.10 ± 1.27)"] * 3
    assert (
        "changes by +1.10 ± 1.27°, which may be chance" in evaluation.tables.findings(summaries)[1]
    )


def test_command_refuses_no_limbs():
    done = subprocess.run(
        [sys.executable, EXAMPLES / "reproduce_paper.py", "--limbs", "0"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "--limbs, --rollouts and --angles must be one or more" in done.stderr
    assert "Traceback" not in done.stderr


def test_hands_move_through_their_points(evaluation):
    """From rest to rest, and never farther than from one point to the next."""
    for name in evaluation.experiment.HANDS:
        file = evaluation.experiment.HANDS[name]
        times, degrees = np.loadtxt(EXAMPLES / "evaluation" / file, delimiter=",").T
        assert (times[0], times[-1]) == (0.0, 60.0)
        course = evaluation.experiment.hand_course(name)
        assert np.rad2deg(course.vector_values(times)[0]) == pytest.approx(degrees)
        rates = course.MakeDerivative().vector_values([0.0, 60.0])
        np.testing.assert_allclose(rates, 0.0, atol=1e-12)
        for start, end, *ends in zip(times, times[1:], degrees, degrees[1:], strict=False):
            between = np.rad2deg(course.vector_values(np.linspace(start, end, 50))[0])
            assert between.min() >= min(ends) - 1e-9
            assert between.max() <= max(ends) + 1e-9
