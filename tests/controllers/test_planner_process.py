"""Horizons from another process are those of this one, and its end is told."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from controllers.planner_process import PlannerProcess, planner_of
from limb_systems import LimbError, LimbParameters
from planners import Task, plan, references

ROOT = Path(__file__).parents[2]


def test_another_process_plans_alike_until_it_ends():
    parameters = LimbParameters()
    parameters.segments[0].links = 2
    reference = references.from_samples([0.0, 2.0], [0.0, 0.1])
    trajectory = plan(parameters, reference, knot_rate=5.0, tolerance_deg=0.5)
    task = Task(duty_weight=0.01, customize=lambda _: None)  # which cannot be sent
    here, there = planner_of(trajectory, task), PlannerProcess(trajectory, task)
    first = here.beginning_of(trajectory)
    question = 0.3, first.heat[1], np.array([0.02]), first
    there.begin(*question)
    ours = here.plan(*question)
    assert there._connection.poll(20.0)
    theirs = there.plan_if_made()
    assert there.plan_if_made() is None
    for name in ("time", "duty", "heat", "bend_angle"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    there._process.kill()
    assert there._connection.poll(20.0)
    with pytest.raises(LimbError, match="The process that plans the coming seconds has ended"):
        there.plan_if_made()


STOPPED = """
import os, signal
from controllers.planner_process import PlannerProcess
from limb_systems import LimbParameters
from planners import plan, references
trajectory = plan(
    LimbParameters(), references.from_samples([0.0, 2.0], [0.0, 0.1]), knot_rate=5.0,
    tolerance_deg=0.5,
)
process = PlannerProcess(trajectory)
print(process._process.pid, flush=True)
os.kill(process._process.pid, signal.SIGSTOP)
process.begin(0.3, None, None)
"""


def test_a_process_that_is_stopped_ends_with_its_program():
    done = subprocess.run(
        [sys.executable, "-c", STOPPED], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert not Path(f"/proc/{int(done.stdout)}").exists()
