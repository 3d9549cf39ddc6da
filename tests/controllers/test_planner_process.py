"""Horizons from another process are those of this one, and its end is told."""

import numpy as np
import pytest

from controllers.planner_process import PlannerProcess, planner_of
from limb_systems import LimbError, LimbParameters
from planners import Task, plan, references


def test_another_process_plans_alike_until_it_ends():
    parameters = LimbParameters()
    parameters.segments[0].links = 2
    reference = references.from_samples([0.0, 2.0], [0.0, 0.1])
    trajectory = plan(parameters, reference, knot_rate=5.0, tolerance_deg=0.5)
    task = Task(duty_weight=0.01, customize=lambda _: None)  # which cannot be sent
    here, there = planner_of(trajectory, task), PlannerProcess(trajectory, task)
    first = here.beginning_of(trajectory)
    question = 0.3, first.heat[1], np.array([0.02]), first
    ours, theirs = here.plan(*question), there.plan(*question)
    for name in ("time", "duty", "heat", "bend_angle"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    there._process.kill()
    with pytest.raises(LimbError, match="The process that plans the coming seconds has ended"):
        there.plan(*question)
