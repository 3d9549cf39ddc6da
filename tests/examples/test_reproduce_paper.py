"""The paper's evaluation: its numbers, counted again by hand, and the split of the error."""

import contextlib
import copy
import dataclasses
import functools
import io
import json
import re
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from reproduce_paper import error_split, tables
from reproduce_paper import experiment as experiments
from reproduce_paper.driving import LEARNING, BendPath, PlanWithRollouts
from scipy.interpolate import CubicSpline

from calibration import calibrate, collect_from_twin
from calibration.prediction.law_fit import LawFit
from calibration.prediction.unknowns import unknowns_of
from hardware.emulation.specimen import Specimen
from limb_systems import (
    Limb,
    LimbParameters,
    LinearLaw,
    Recording,
    Trajectory,
    simulate,
)
from planners import plan, references

EXAMPLES = Path(__file__).parents[2] / "examples"
LAWS = (LinearLaw,)  # plans for the others take several times as long


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The folder that the demo leaves, and what it said, with few and short recordings."""
    folder = tmp_path_factory.mktemp("demo") / "out"
    shorter = {"longest": 30.0, "cooling_time": 60.0, "sag_trials": 2, "ring_downs": 1}
    collect = functools.partial(collect_from_twin, protocol="paper", **shorter)
    said, complained = io.StringIO(), io.StringIO()
    with (
        # In this process, where recordings, fits and rests can be kept short, which take most of
        # the time.
        mock.patch("os.cpu_count", return_value=1),
        mock.patch.multiple(
            experiments,
            collect_from_twin=collect,
            calibrate=functools.partial(calibrate, laws=LAWS),
            NUM_ANGLES=2,
            NUM_ROLLOUTS=1,
            COUNTS=experiments.COUNTS | {LEARNING: 2},
            PAUSE=20.0,
        ),
        mock.patch("calibration.prediction.law_fit.MAX_ITERATIONS", 4),
        mock.patch("reproduce_paper.driving.PAUSE", 20.0),
        mock.patch.object(sys, "argv", ["demo.py", str(folder)]),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(complained),
        pytest.raises(SystemExit) as ended,
    ):
        runpy.run_path(str(EXAMPLES / "demo.py"), run_name="__main__")
    assert ended.value.code == 0, complained.getvalue()
    return folder, said.getvalue(), complained.getvalue()


@pytest.mark.whole
def test_demo_writes_all_files(demo, look_at):
    folder, said, complained = demo
    assert all(
        re.match("simulating|calibrating|planning", line) for line in complained.splitlines()
    )
    assert "These limbs are emulated, with physics that the model leaves out" in said
    assert re.findall(r"^(\d)/5 .* \.\.\.$", said, re.MULTILINE) == list("12345")
    assert LimbParameters.load(folder / "limb_0" / "limb.yaml") != LimbParameters()
    recordings = {path.stem for path in (folder / "limb_0" / "recordings").iterdir()}
    assert recordings == {"sag_1", "sag_2", "ring_down", "right", "left", "both"}
    for name in ("fig4", "fig5", "fig6a", "fig6b", "fig7", "ways"):
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    links = re.findall(r'<a href="([^"#]+)">', (folder / "report.html").read_text(encoding="utf-8"))
    assert {"replay.html", "results.json", "limb_0/limb.yaml", "limb_0/calibration.html"} < {*links}
    assert "limb_0/t_and_r_1/taught.csv" in links
    assert (Recording.load(folder / "limb_0" / "t_and_r_1" / "taught.csv").duty == 0).all()
    assert all((folder / link).is_file() for link in links)
    look_at(folder / "report.html")


@pytest.mark.whole
def test_table_1_agrees_with_the_files(demo):
    folder, said, _ = demo
    (summary,) = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert summary["seed"] == 0
    for motion, name in (("Validation", "validation"), ("T&R 1", "t_and_r_1")):
        trajectory = Trajectory.load(folder / "limb_0" / name / "trajectory.csv")
        assert trajectory.check.failure() is None
        (path,) = (folder / "limb_0" / name).glob("rollout_*.csv")
        assert_followed(summary["ways"][motion]["open loop"], trajectory, path)
    trajectory = Trajectory.load(folder / "limb_0" / "ramps" / "follow_trajectory.csv")
    assert trajectory.wire_temperature.max() < 90.0  # it leaves room for feedback
    ways = summary["ways"]["Ramps"]
    names = {"follow_rollout_1": ways["follow"]}
    for number, followed in enumerate(summary["repetitions"]["Ramps"], 1):
        names[f"learning_rollout_{number}"] = followed
    assert len(names) == 3
    for name, followed in names.items():
        path = folder / "limb_0" / "ramps" / f"{name}.csv"
        assert_followed(followed, trajectory, path)
    shown = [
        summary["nearest"]["Ramps"],
        summary["approaches"]["as described, not calibrated"]["Ramps"]["true_reference"],
        ways["open loop"]["true_reference"],
        ways["follow"]["true_reference"],
        summary["repetitions"]["Ramps"][-1]["true_reference"],
    ]
    row = " ".join(f"{distance:.2f}°" for distance in shown)
    assert f"ramps that the limb can follow {row}" in re.sub(" +", " ", said)


def assert_followed(followed, trajectory, path):
    """The numbers of a rollout, from its file."""
    rollout = Recording.load(path)
    assert rollout.time[-1] == pytest.approx(trajectory.duration)
    planned = CubicSpline(trajectory.time, trajectory.bend_angle[0])(rollout.time)
    errors = np.rad2deg(np.abs(planned - rollout.bend_angle[0]))
    expected = [np.mean(errors), np.median(errors), np.percentile(errors, 90)]
    assert followed["tracking"] == pytest.approx(expected, abs=0.01)
    # α/2 of the tip's tangent, which is half a joint's angle beyond the last link.
    joints = rollout.joint_state[:5]
    true = 6 / 11 * (joints.sum(axis=0) + joints[-1] / 2)
    assert followed["true"] == pytest.approx(np.rad2deg(np.abs(planned - true)).mean(), abs=0.01)
    wanted = np.interp(rollout.time, trajectory.time, trajectory.reference[0])
    for name, bend in (
        ("true_reference", true),
        ("reference", rollout.bend_angle[0]),
        ("planned", planned),
    ):
        away = np.rad2deg(np.abs(wanted - bend)).mean()
        assert followed[name] == pytest.approx(away, abs=0.01), name
    assert followed["highest_reading"] == pytest.approx(rollout.measured_temperature.max())
    assert followed["highest_temperature"] == pytest.approx(rollout.wire_temperature.max())


def test_bend_is_read_late_absent_or_held():
    """A ramp of one unit in a second, seen where a controller would update, every 0.05 s."""

    def seen(**changes):
        builder = DiagramBuilder()
        ramp = PiecewisePolynomial.FirstOrderHold([0.0, 9.0], [[1.0, 10.0]])
        source = builder.AddSystem(TrajectorySource(ramp))
        path = builder.AddSystem(BendPath(1, **changes))
        builder.Connect(source.get_output_port(), path.get_input_port())
        log = LogVectorOutput(path.get_output_port(), builder, 0.05)
        simulator = Simulator(builder.Build())
        simulator.AdvanceTo(2.0)
        return log.FindLog(simulator.get_context()).data()[0]

    time = 0.05 * np.arange(41)
    np.testing.assert_allclose(seen(), 1 + time)
    np.testing.assert_allclose(seen(delay=0.1), np.maximum(1.0, 0.9 + time), atol=1e-9)
    absent = seen(start=1.0, absence=0.5)
    assert np.flatnonzero(np.isnan(absent)).tolist() == list(range(20, 30))
    held = seen(start=1.0, absence=0.5, hold_last=True)
    np.testing.assert_allclose(held[20:30], 1.95)  # the last reading before
    np.testing.assert_allclose(np.delete(held, np.s_[20:30]), np.delete(1 + time, np.s_[20:30]))


def test_interval_of_the_mean_is_students():
    """Of 1, 2, 3, 4, 5: standard error sqrt(2.5 / 5), and t(97.5%, 4) = 2.776 in any table."""
    assert tables.mean_and_margin([1, 2, 3, 4, 5]) == f"3.00 ± {2.776 * np.sqrt(0.5):.2f}"
    assert tables.mean_and_margin([-0.001]) == "0.00"


@pytest.fixture(scope="module")
def driven():
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
    segment, nobody = calibrated.segments[0], np.empty((0, 3))
    fit = LawFit(
        LinearLaw, segment, unknowns, fitted, covariance, 25.0, nobody, [], np.full(2, 100.0)
    )
    calibration = SimpleNamespace(
        parameters=calibrated,
        prediction=SimpleNamespace(fit=fit, best=SimpleNamespace(name="LinearLaw")),
    )

    def experiment(rollouts):
        ways = {
            name: PlanWithRollouts(trajectory, recordings) for name, recordings in rollouts.items()
        }
        split = error_split.error_split(calibration, ways)
        driven = {name: {"open loop": way} for name, way in ways.items()}
        return experiments.Experiment(
            Specimen(calibrated, 0), {}, calibration, {}, driven, {}, split, {}
        )

    return SimpleNamespace(
        trajectory=trajectory, calibrated=calibrated, exact=exact, experiment=experiment
    )


def test_split_of_a_limb_that_is_a_model_finds_its_parameters(driven):
    """The limb is the model with other a1 and a2, so that its form makes no difference."""
    read = copy.deepcopy(driven.exact)
    noise = np.random.default_rng(0).normal(0.0, 1.0, read.bend_angle.shape)
    read.bend_angle = read.bend_angle + np.deg2rad(0.5 + noise)
    steps = driven.experiment({"swing": [read]}).split["swing"]
    assert steps["collocation"][0] < 0.1
    assert steps["form of the model"][0] < 0.2
    assert steps["bend sensor"][0] == pytest.approx(np.abs(0.5 + noise).mean(), abs=1e-3)
    model = simulate(Limb(driven.calibrated), driven.trajectory)
    difference = np.rad2deg(np.abs(driven.exact.bend_angle - model.bend_angle))
    assert difference.mean() > 0.9
    assert steps["parameters"][0] == pytest.approx(difference.mean(), abs=0.2)
    # The parts add up to the error, counted by hand at every sample; none is more than its step.
    planned = np.interp(read.time, driven.trajectory.time, driven.trajectory.bend_angle[0])
    error = np.rad2deg(np.abs(read.bend_angle[0] - planned)).mean()
    assert sum(part for _, part in steps.values()) == pytest.approx(error, abs=0.01)
    assert all(abs(part) <= difference for difference, part in steps.values())


def test_rollouts_that_were_aborted_are_counted_and_compared_up_to_then(driven):
    exact = driven.exact
    whole = dataclasses.replace(exact, bend_angle=exact.bend_angle + np.deg2rad(0.5))
    signals = ("time", "duty", "measured_temperature", "bend_angle")
    signals += ("wire_temperature", "joint_state")
    half = {name: getattr(exact, name)[..., :401] for name in signals}
    half["bend_angle"] = half["bend_angle"] + np.deg2rad(2.5)
    aborted = dataclasses.replace(exact, **half, interrupted="too hot")
    names = list(experiments.MOTIONS)
    rollouts = ([aborted, whole], [whole, whole], [aborted, aborted], [whole, whole])
    experiment = driven.experiment(dict(zip(names, rollouts, strict=True)))
    summary = tables.summarize(experiment)
    followed = [ways["open loop"] for ways in summary.ways.values()]
    assert [(way.aborted, way.rollouts) for way in followed] == [(1, 2), (0, 2), (2, 2), (0, 2)]
    assert list(summary.approaches[tables.PREDICTION].values()) == followed
    _, row = tables.approach_table([summary])
    assert row[-1] == "38%"  # 3 of 8
    planned = np.interp(exact.time, driven.trajectory.time, driven.trajectory.bend_angle[0])
    away = np.rad2deg(exact.bend_angle[0] - planned)
    errors = np.abs(np.concatenate([away[:401] + 2.5, away + 0.5]))
    expected = [np.mean(errors), np.median(errors), np.percentile(errors, 90)]
    assert followed[0].tracking == pytest.approx(expected, abs=0.02)
    true = np.abs(np.concatenate([away[:401], away])).mean()
    assert followed[0].true == pytest.approx(true, abs=0.02)
    assert summary.split[names[0]]["bend sensor"][0] == pytest.approx(2.5, abs=1e-3)
    # The parts of the first rollouts' errors add up, by hand in the first column of the last row.
    whole_error = np.abs(away[:401] + 2.5).mean()
    for table in (tables.step_table, tables.part_table):
        assert float(table([summary])[-1][1]) == pytest.approx(whole_error, abs=0.02)
    rows = tables.table_1([summary, summary])
    aborted = [row[-1] for row in rows if row[1].endswith("open loop")]
    assert aborted == ["2 of 4", "0 of 4", "4 of 4", "0 of 4"]


def test_hands_move_through_their_points_as_the_paper_says():
    """From rest to rest; the first is faster and within a smaller range, the second has holds."""
    fine, ranges, speeds = np.linspace(0.0, 60.0, 1201), [], []
    for name, file in experiments.HANDS.items():
        times, degrees = np.loadtxt(Path(experiments.__file__).with_name(file), delimiter=",").T
        assert (times[0], times[-1]) == (0.0, 60.0)
        course = experiments.taught_motion(name)
        assert np.rad2deg(course.vector_values(times)[0]) == pytest.approx(degrees)
        rates = course.MakeDerivative().vector_values(fine)[0]
        np.testing.assert_allclose(rates[[0, -1]], 0.0, atol=1e-12)
        # Never farther than from one point to the next.
        between = np.searchsorted(times, fine[1:-1])
        ends = np.sort([degrees[between - 1], degrees[between]], axis=0)
        passed = np.rad2deg(course.vector_values(fine)[0, 1:-1])
        assert ((ends[0] - 1e-9 <= passed) & (passed <= ends[1] + 1e-9)).all()
        ranges.append(np.ptp(degrees))
        speeds.append(np.median(np.abs(rates)))
    assert ranges[0] < 0.7 * ranges[1]
    assert ranges[1] == pytest.approx(50.0, rel=0.15)  # Sec. VIII
    assert speeds[1] < 1e-9 < np.deg2rad(2.0) < speeds[0]  # rad/s; it holds half of the time
