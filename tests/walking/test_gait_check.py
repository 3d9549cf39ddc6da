"""The check of gaits by simulation with contact, and walks from cold wires."""

import copy
import dataclasses

import numpy as np
import pytest

from limb_systems import LimbError, LinearLaw, Recording, RestMemory, simulate
from limb_systems.limb_parameters import CalibrationRecord
from walking import Gait, GaitVariation, Robot, RobotParameters, check_gait, walk
from walking.gait import STRIDE_TOLERANCE_IN_SPACE
from walking.gait_check import (
    find_fall,
    measure_strides,
    simulate_gait,
    simulate_in_drake,
    variations,
    with_varied_parameters,
)
from walking.in_mujoco import simulate_in_mujoco


@pytest.fixture
def gait(quick_crawl) -> Gait:
    return quick_crawl


@pytest.fixture
def checked(checked_crawl) -> Gait:
    return checked_crawl


def test_strides_are_as_planned(checked):
    assert np.array(checked.check.simulation.strides) == pytest.approx(1.0, abs=0.05)
    assert checked.passed


@pytest.mark.parametrize(
    ("strides", "announced", "said"),
    [
        ([0.97, 0.93, 0.95], 0.94, None),
        ([1.0, 0.995, 0.995], 1.0, None),
        ([0.8, 1.0, 1.0], 1.0, None),  # until its feet are where the motion has them
        ([0.9, 0.8, 0.95], 0.875, "more than 5%"),  # not steadily
        ([0.4, 0.4, 0.4], 1.0, "a stride is 40.0% of the planned one"),
    ],
)
def test_a_gait_that_walks_steadily_has_the_stride_that_it_makes(
    gait, monkeypatch, strides, announced, said
):
    def simulate_gait(walked, what, robot, cycles, **_):
        shares = [share * gait.stride / walked.stride for share in strides[-cycles:]]
        return GaitVariation(what, shares)

    monkeypatch.setattr("walking.gait_check.simulate_gait", simulate_gait)
    checked = check_gait(gait, spread=False)
    assert checked.stride == pytest.approx(announced * gait.stride)
    assert checked.check.made == pytest.approx(announced)
    if said:
        assert said in checked.check.failure()
    else:
        assert checked.passed
    assert (checked.duty == gait.duty).all()


@pytest.mark.parametrize(
    ("in_mujoco", "in_drake", "made"),
    [
        ([0.96, 1.0, 1.0], [0.98], 1.0),  # a cycle in Drake is enough
        ([0.7, 0.8, 0.8], [0.7, 0.84], 0.84),  # Drake simulates two, and announces the second
        ([0.86, 0.9, 0.9], [0.86], 0.9),  # shares of what MuJoCo has announced
    ],
)
def test_a_gait_in_space_has_the_turn_that_drake_makes(
    gait_in_space, monkeypatch, in_mujoco, in_drake, made
):
    simulated = []

    def simulate_gait(walked, what, robot, cycles, *, simulator=simulate_in_mujoco, **_):
        simulated.append(cycles)
        turns = in_mujoco if simulator is simulate_in_mujoco else in_drake
        share = gait_in_space.turn / walked.turn
        strides = [share * turn for turn in turns]
        return GaitVariation(what, strides, aside=[0.3 * share, *[0.05 * share] * (len(turns) - 1)])

    monkeypatch.setattr("walking.gait_check.simulate_gait", simulate_gait)
    check = dataclasses.replace(gait_in_space.check, tolerance=STRIDE_TOLERANCE_IN_SPACE)
    checked = check_gait(dataclasses.replace(gait_in_space, check=check), spread=False)
    assert simulated == [3, len(in_drake)]
    assert checked.turn == pytest.approx(made * gait_in_space.turn)
    assert checked.check.made == pytest.approx(made)
    strides = np.array(checked.check.simulation.strides)
    assert strides == pytest.approx(np.array(in_drake) / made)
    if len(in_drake) > 1:
        assert checked.check.simulation.aside == pytest.approx([0.3 / made, 0.05 / made])
        assert checked.passed


def standing(gait: Gait, body_pose=(0.0, 0.06, 0.0), force=0.25) -> Recording:
    """A recording, over two periods, of a robot that stands still."""
    times = np.arange(0.0, 2 * gait.period, 0.05)
    held = {"measured_temperature": 4, "bend_angle": 2, "duty": 4}
    return Recording(
        time=times,
        **{name: np.zeros((size, len(times))) for name, size in held.items()},
        body_pose=np.tile(np.reshape(body_pose, (3, 1)), len(times)),
        contact_force=np.tile([[0.0], [0.25], [0.0], [force]], len(times)),
        parameters=gait.parameters,
        robot=gait.robot,
        source="model",
        sample_rate=20.0,
    )


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ({}, ""),
        ({"body_pose": (0.0, 0.06, 1.2)}, "its body tilts by more than 60° after 0.0 s"),
        ({"body_pose": (0.0, 0.005, 0.0)}, "its body comes to the ground after 0.0 s"),
        ({"force": 0.0}, "its front foot carries nothing for half a period after"),
    ],
)
def test_find_fall_describes_each_kind_of_fall(gait, what, words):
    fall, _ = find_fall(standing(gait, **what), gait)
    assert fall.startswith(words)
    assert bool(fall) == bool(words)


def test_a_fall_before_the_cycles_begin_is_in_the_warm_up(gait):
    fallen = standing(gait, body_pose=(0.0, 0.005, 0.0))
    fall, time = find_fall(fallen, gait, start=2.0)
    assert fall == "its body comes to the ground in the warm-up"
    assert time == 0.0


def test_variations_are_of_friction_and_of_each_limb(gait):
    varied = dict(variations(gait.robot, seed=1))
    assert varied["friction x 0.7"].ground.friction == pytest.approx(0.7 * 0.3)
    drawn = [other for what, other in varied.items() if what.startswith("parameters")]
    for other in drawn:
        for limb, planned in zip(other.limbs, gait.robot.limbs, strict=True):
            share = limb.parameters.segments[0].stiffness / planned.parameters.segments[0].stiffness
            laws = [limbs.parameters.wires[0].law for limbs in (limb, planned)]
            shares = [share, *(getattr(laws[0], f) / getattr(laws[1], f) for f in ("a1", "beta"))]
            assert np.abs(np.array(shares) - 1) == pytest.approx(0.1)
    assert len({other.digest for other in drawn}) == len(drawn)


def test_heat_and_the_ratio_of_torque_to_stiffness_vary_less_where_they_are_known(gait):
    """Feedback holds the heat in space, and bends of calibrated limbs tell the ratio."""
    robot = copy.deepcopy(gait.robot)
    for limb in robot.limbs:
        limb.parameters.calibration = CalibrationRecord([], [], [], [])
    varied = with_varied_parameters(robot, np.random.default_rng(0), heat=False)
    for limb, planned in zip(varied.limbs, robot.limbs, strict=True):
        segment, described = (each.parameters.segments[0] for each in (limb, planned))
        stiffness = segment.stiffness / described.stiffness
        torque = segment.wires[0].law.beta / described.wires[0].law.beta
        assert abs(stiffness - 1) == pytest.approx(0.1)
        assert abs(torque / stiffness - 1) == pytest.approx(0.05)
        assert segment.wires[0].law.a1 == described.wires[0].law.a1


@pytest.mark.parametrize("robot", [RobotParameters(), RobotParameters.in_space(3)])
def test_cooling_and_heating_vary_in_a_plane_alone(robot):
    a1, a2 = robot.limbs[0].parameters.wires[0].law.a1, robot.limbs[0].parameters.wires[0].law.a2
    for change, varied in variations(robot):
        law = varied.limbs[0].parameters.wires[0].law
        varies = "parameters" in change and robot.body.mount != "free"
        assert (law.a1 != a1) == varies
        assert (law.a2 != a2) == varies


def test_a_walk_from_cold_comes_to_the_gait(checked):
    walked = walk(checked, 2)
    begin = walked.duration - 2 * checked.period
    limits = checked.parameters.temperature_limits
    assert walked.check.failure() is None
    assert walk(checked, 1).check == walked.check  # which comes nearer to the gait
    assert walked.wire_temperature[:, 0] == pytest.approx(checked.parameters.ambient_temperature)
    assert walked.wire_temperature.max() <= limits.maximum
    assert walked.duty.sum(axis=0).max() <= checked.robot.total_duty + 1e-3
    assert (walked.duty[:, -1] == 0).all()
    recording = simulate(Robot(checked.robot, time_step=2e-3), walked)
    starts = begin + checked.period * np.arange(3)
    strides = measure_strides(recording, checked, starts)[0]
    assert strides[1] == pytest.approx(checked.check.simulation.strides[-1], abs=0.03)
    in_second = (recording.time - begin) - checked.period
    there = (in_second >= 0) & (in_second <= checked.period)
    planned = [np.interp(in_second[there], checked.time, T) for T in checked.wire_temperature]
    # Heat is not linear between knots of 0.17 s, in which wires warm by up to 14 °C.
    assert np.abs(recording.wire_temperature[:, there] - planned).mean() < 1.5


def test_no_walk_of_a_gait_that_failed_its_check(checked):
    fallen = dataclasses.replace(checked.check.simulation, fall="its body tilts")
    failed = dataclasses.replace(
        checked, check=dataclasses.replace(checked.check, simulation=fallen)
    )
    with pytest.raises(LimbError, match="failed its check and is not walked"):
        walk(failed, 1)


class SquareLaw(LinearLaw):
    """A linear law of wires that a board heats by the square of the duty."""

    def rates(self, x, D, T0):
        return LinearLaw.rates(self, x, D**2, T0)


def test_no_walk_of_wires_whose_heat_is_not_proportional_to_the_duty(gait):
    robot = copy.deepcopy(gait.robot)
    for limb in robot.limbs:
        for wire in limb.parameters.wires:
            wire.law = SquareLaw()
    with pytest.raises(LimbError, match="rates of SquareLaw are not affine in the duty"):
        walk(dataclasses.replace(gait, robot=robot), 1)


def test_mujoco_walks_as_drake_does(checked):
    """The check simulates a cycle in Drake after those in MuJoCo, and says so."""
    check = checked.check
    assert check.checked_by == "Drake in steps of 1 ms for 1 of the cycles, MuJoCo"
    drake = check.simulation.strides
    mujoco = simulate_gait(checked, "", checked.robot, 1)
    assert mujoco.strides == pytest.approx(drake, abs=0.01)
    assert mujoco.highest_temperature == pytest.approx(
        check.simulation.highest_temperature, abs=0.1
    )


def test_rubber_that_stiffens_and_remembers_walks_alike_in_both(gait):
    robot = copy.deepcopy(gait.robot)
    for limb in robot.limbs:
        segment = limb.parameters.segments[0]
        segment.stiffening, segment.rest_memory = 0.5, RestMemory()
    shifts = np.zeros((len(robot.limbs), len(gait.time)))
    gait = dataclasses.replace(gait, robot=robot, other_wire_state=shifts)
    recordings = [simulate(gait, robot, 1) for simulate in (simulate_in_mujoco, simulate_in_drake)]
    (in_mujoco, in_drake) = (recording.body_pose[:, -1] for recording in recordings)
    np.testing.assert_allclose(in_mujoco, in_drake, atol=5e-4)
    # At single samples a foot that lands has bounced in one engine and not yet in the other.
    in_mujoco, in_drake = (recording.contact_force for recording in recordings)
    assert np.median(np.abs(in_mujoco - in_drake), axis=1).max() < 5e-3


def test_a_gait_that_clearly_fails_in_mujoco_is_not_simulated_in_drake(gait, monkeypatch):
    monkeypatch.setattr("walking.gait_check.simulate_in_drake", None)
    for duty in (0.8 * gait.duty, gait.duty[[1, 0, 3, 2]]):
        check = check_gait(dataclasses.replace(gait, duty=duty), cycles=1, spread=False).check
        failure = check.failure()
        assert "falls in simulation" in failure or "misses it by more than 5%" in failure
        assert check.checked_by == "MuJoCo"
