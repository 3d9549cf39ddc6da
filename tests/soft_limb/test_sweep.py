"""Sweeps, and calls in several processes, on this machine and on a cluster."""

import csv
import os
import sys
from unittest import mock

import numpy as np
import pytest

from hardware import LimbTwin, replay
from limb_systems import EmulatedLimb, LimbError, LimbParameters
from planners import plan, references
from soft_limb.command import main
from soft_limb.runs.jobs import load_module, run_each


@pytest.fixture
def sweep(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.csv").write_text("0,0\n1,0\n3,8\n5,8\n")
    limb = LimbParameters()
    limb.temperature_limits.warm_up_time = 1000.0
    limb.save(tmp_path / "limb.yaml")

    def run(*words):
        return main(["sweep", "mine.csv", "-l", "limb.yaml", "-j", "1", "-o", "sweep.csv", *words])

    return run


def rows(path):
    with (path / "sweep.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_row_agrees_with_plan_and_replay(sweep, tmp_path, capsys):
    vary = ("--vary", "segments.0.stiffness=0.11,0.12", "--seeds", "3")
    assert sweep(*vary) == 0
    assert "means over limbs" in capsys.readouterr().out
    only, second = rows(tmp_path)
    assert [row["segments.0.stiffness"] for row in (only, second)] == ["0.11", "0.12"]
    assert second["reference_deg"] != only["reference_deg"]
    assert sweep(*vary) == 1  # which does not replace the table
    assert sweep(*vary, "--vary", "segments.0.stiffness=0.2", "--force") == 1
    assert "--vary has a field twice" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        sweep("--seeds", "3-1", "--force")
    assert "'3-1' is no range of seeds; its end is below 3" in capsys.readouterr().err
    LimbParameters(board=EmulatedLimb(7)).save("calibrated.yaml")
    assert sweep("-l", "calibrated.yaml", "--seeds", "3", "--force") == 1
    assert "on the emulated limb 7, which the sweep drives" in capsys.readouterr().err
    limb = LimbParameters.load("limb.yaml")
    limb.segments[0].stiffness = 0.11
    trajectory = plan(limb, references.load("mine.csv"))
    recording = replay(trajectory, LimbTwin(limb, seed=3, truth=True))
    bend = 3 * recording.joint_state[:5].mean(axis=0)  # (11), of the true joints
    wanted = np.interp(recording.time, [1.0, 3.0], np.deg2rad([0.0, 8.0]))
    error = np.rad2deg(np.abs(wanted - bend).mean())
    assert float(only["reference_deg"]) == pytest.approx(error, abs=0.05)
    assert float(only["highest_wire_c"]) == pytest.approx(recording.wire_temperature.max(), abs=0.1)


def test_a_sweep_without_results_fails(sweep, tmp_path, capsys):
    LimbParameters().save("limb.yaml")
    (tmp_path / "mine.csv").write_text("0,0\n22,0\n24,20\n")
    assert sweep("--vary", "total_duty=0.01") == 1  # which cannot warm the wires
    assert "No run gave a result; the trouble of the first: The temp" in capsys.readouterr().err
    (tmp_path / "mine.csv").write_text("")
    assert sweep("--force") == 1
    assert "mine.csv: A reference needs two samples or more" in capsys.readouterr().err


def _square_or_fail(number):
    if number < 0:
        raise LimbError("this limb is broken")
    return number**2


def _driven(plan):
    return replay(plan, LimbTwin(seed=0))


def _process(name):
    """Return number and stderr of this process, and whether it has imported a module."""
    return os.getpid(), os.readlink("/proc/self/fd/2"), name in sys.modules


@pytest.fixture
def user_module(tmp_path, monkeypatch):
    """Return the name of a module that this process has imported from a folder."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr("soft_limb.runs.jobs._module_folders", {})
    (tmp_path / "user_limb.py").touch()
    load_module("user_limb", tmp_path)
    yield "user_limb"
    del sys.modules["user_limb"]


def test_processes_import_user_modules_and_print_nothing(user_module):
    for pid, errors, knows in run_each(_process, [user_module] * 4, 2):
        assert pid != os.getpid()
        assert errors == os.devnull
        assert knows
    assert list(run_each(_square_or_fail, range(20), 2, in_order=True)) == [n**2 for n in range(20)]
    with pytest.raises(LimbError, match="this limb is broken"):
        list(run_each(_square_or_fail, [1, -1, 2], 2))


@pytest.mark.whole
def test_runs_on_a_cluster_equal_runs_in_this_process(fig5_plan, user_module):
    distributed = pytest.importorskip(
        "distributed", reason="Dask is not installed: pip install -e '.[cluster]'"
    )
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        at = {"num_processes": 1, "cluster": cluster.scheduler_address}
        (there,) = run_each(_driven, [fig5_plan], **at)
        ((_, _, knows),) = run_each(_process, [user_module], **at)
    assert knows
    np.testing.assert_array_equal(there.bend_angle, _driven(fig5_plan).bend_angle)


def test_a_cluster_needs_dask():
    with (
        mock.patch.dict(sys.modules, {"distributed": None}),
        pytest.raises(LimbError, match="needs Dask, which is not installed"),
    ):
        next(run_each(_square_or_fail, [1], 1, cluster="tcp://somewhere:8786"))
