"""Plans of limbs that bend about two axes, by the quasi-static program."""

import dataclasses
import warnings

import numpy as np
import pytest

from limb_systems import LimbParameters, simulate
from limb_systems.layout import Layout
from limb_systems.limb import Limb
from planners import Task, plan, references

TIMES = np.linspace(0.0, 40.0, 401)


def circle(degrees, num_bends=2, times=TIMES):
    """A turn in the time that wires take to cool, after they warmed up."""
    phases = 2 * np.pi * times / 40.0 + np.pi / 2 * np.arange(num_bends)[:, None]
    return references.from_samples(
        times, np.deg2rad(degrees) * np.minimum(times / 20.0, 1.0) * np.sin(phases)
    )


def limb_in_space(wires=3, gravity=(2.0, -6.0, 7.0), **changes):
    parameters = LimbParameters.in_space(wires=wires, links=3)
    parameters.segments[0].stiffness *= 4 / 6  # to bend as five links do
    return dataclasses.replace(parameters, gravity=list(gravity), **changes)


@pytest.fixture(scope="module")
def circle_plan():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return plan(limb_in_space(), circle(12.0))


def test_a_plan_is_followed_by_an_accurate_simulation_of_its_duty(circle_plan):
    recording = simulate(
        Limb(circle_plan.parameters), circle_plan, duration=12.0, accuracy=1e-4,
        initial_state=circle_plan.state[:, 0],
    )  # fmt: skip
    missed = np.rad2deg(recording.bend_angle - circle_plan.bend_angle_at(recording.time))
    settled = recording.time >= 2.0
    assert np.abs(missed[:, ~settled]).max() < 0.3
    assert np.abs(missed[:, settled]).max() < 0.06
    assert np.sqrt((missed**2).mean()) < 0.025
    check = circle_plan.check
    assert check.largest_difference_deg == pytest.approx(np.abs(missed).max(), abs=0.01)
    assert (check.solver, check.tolerance_deg) == ("IPOPT, quasi-static", 1.0)


def test_a_plan_keeps_the_limits_and_nears_its_reference(circle_plan):
    T, warm = circle_plan.wire_temperature, circle_plan.time > 20.0
    assert T.max() <= 100.0 + 1e-4
    assert T[:, warm].min() >= 45.0 - 1e-4
    missed = np.rad2deg(np.abs(circle_plan.bend_angle - circle_plan.reference))
    assert np.median(missed[:, warm]) < 0.25
    np.testing.assert_allclose(circle_plan.joint_rates[:, 0], 0.0)


def test_both_programs_give_a_planar_limb_the_same_plan(monkeypatch):
    parameters, reference = LimbParameters(), circle(15.0, 1)
    planar = plan(parameters, reference)
    monkeypatch.setattr(Layout, "is_planar", False)
    quasi_static = plan(parameters, reference)
    assert "quasi-static" in quasi_static.check.solver
    apart = np.rad2deg(np.abs(quasi_static.bend_angle - planar.bend_angle))
    assert apart.max() < 0.05


def test_limits_of_the_task_and_of_the_supply_hold():
    step = references.from_samples([0.0, 3.0, 3.1, 12.0], np.deg2rad([[0, 0, 15, 15], [0] * 4]))
    parameters = limb_in_space(4, total_duty=0.7)
    parameters.temperature_limits.warm_up_time = 100.0
    task = Task(max_bend_rate=0.06, reach=True, max_temperature_rate=7.0)
    free, limited = (plan(parameters, step, task=task) for task in (None, task))
    rates = [np.abs(np.diff(found.bend_angle)).max() * 10.0 for found in (free, limited)]
    assert rates[0] > 0.12
    assert rates[1] < 0.061  # the plan follows its heat with a delay
    end = np.rad2deg(limited.bend_angle[:, limited.time >= 10.0])
    assert np.abs(end[:, -1] - [15.0, 0.0]).max() < 0.11
    ramp = references.from_samples([0.0, 12.0], np.deg2rad([[0.0, 15.0], [0.0, 0.0]]))
    held = plan(parameters, ramp, task=Task(final_hold=2.0))
    assert np.rad2deg(np.abs(np.diff(held.bend_angle[:, held.time >= 10.0]))).max() <= 0.051
    assert np.abs(np.diff(limited.wire_temperature)).max() < 0.7001
    assert free.duty.sum(axis=0).max() == pytest.approx(0.7, abs=1e-4)
    planar = LimbParameters(total_duty=0.7, temperature_limits=parameters.temperature_limits)
    in_plane = plan(planar, references.from_samples([0.0, 3.0, 3.1, 12.0], [0.0, 0.0, 0.6, 0.6]))
    assert in_plane.duty.sum(axis=0).max() == pytest.approx(0.7, abs=1e-4)
    shortest = Task(stretch=(0.5, 2.0), time_weight=10.0, reach=True)
    assert plan(parameters, step, task=shortest).duration < 11.0
