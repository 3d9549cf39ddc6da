"""The controller, the schedule, and recordings collected with them."""

import dataclasses

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.trajectories import PiecewisePolynomial

from calibration import (
    BendAngleController,
    CalibrationError,
    EquilibriumSchedule,
    LimitedDuty,
    calibrate,
    collect_equilibria,
    collect_from_robot,
    excitations,
    load_recordings,
)
from hardware import LimbTwin
from limb_systems import (
    CalibrationRecord,
    HystereticLaw,
    Limb,
    LimbParameters,
    LinearLaw,
    Recording,
    RestMemory,
    TwoMassLaw,
)


def duty_after(actuated, error_deg, measured=(25.0, 25.0), duration=0.0, *, limb=None):
    """Duty for a constant error after some time."""
    controller = BendAngleController(limb or LimbParameters(), actuated)
    context = controller.CreateDefaultContext()
    controller.GetInputPort("bend_angle").FixValue(context, [0.0])
    controller.GetInputPort("measured_temperature").FixValue(context, measured)
    controller.GetInputPort("set_point").FixValue(context, [np.deg2rad(error_deg)])
    simulator = Simulator(controller, context)
    simulator.AdvanceTo(duration)
    return controller.get_output_port().Eval(context)


# Bend per duty is 3 * 4.7e-4 / 0.1246 * 20 / 0.07 = 3.233 rad, and the loop's gain is 1.5.
GAIN = 1.5 / (3 * 4.7e-4 / 0.1246 * 20 / 0.07)


def test_proportional_part_heats_the_wire_on_the_side_of_the_error():
    duty = GAIN * np.deg2rad(10.0)
    np.testing.assert_allclose(duty_after("right", 10), [0, duty], rtol=0.05)
    np.testing.assert_allclose(duty_after("left", -10), [duty, 0], rtol=0.05)
    np.testing.assert_allclose(duty_after("right", -10), [0, 0])
    np.testing.assert_allclose(duty_after("left", 10), [0, 0])
    duty = GAIN * np.deg2rad(4.0)
    np.testing.assert_allclose(duty_after("both", 4), [0.08 - duty, 0.08 + duty], rtol=0.05)


def test_integral_part_grows_at_the_pole_of_the_wire():
    rise = duty_after("right", 5, duration=10.0)[1] - duty_after("right", 5)[1]
    assert rise == pytest.approx(GAIN * 0.07 * np.deg2rad(5.0) * 10.0, rel=0.02)


@pytest.mark.parametrize(
    ("law", "memory"), [(TwoMassLaw(), None), (HystereticLaw(), RestMemory(shift=0.0))]
)
def test_wires_that_remember_are_controlled_by_what_they_do_once_they_are_settled(law, memory):
    """Of the torque at 62.5 °C on heating, and of wires and silicone in a lasting heat."""
    limb = LimbParameters()
    limb.segments[0].rest_memory = memory
    for wire in limb.wires:
        wire.law = law
    slope = 4.7e-4
    if isinstance(law, HystereticLaw):
        share = np.exp((62.5 - 66.0) / 9.0)
        start = 1.0 + np.exp((25.0 - 66.0) / 9.0)
        slope = 0.038 * start * share / (1.0 + share) ** 2 / 9.0
    gain = 1.5 / (3 * slope / 0.1246 * 20 / 0.08 * (1 + 0.004 / 0.012))
    error = np.deg2rad(5.0)
    first = duty_after("right", 5, limb=limb)[1]
    assert first == pytest.approx(gain * error, rel=0.02)
    rise = duty_after("right", 5, duration=10.0, limb=limb)[1] - first
    assert rise == pytest.approx(gain * 0.08 * error * 10.0, rel=0.02)


def test_duty_is_limited_and_the_integral_does_not_wind_up():
    assert duty_after("right", 85)[1] == pytest.approx(0.5)
    controller = BendAngleController(LimbParameters(), "right")
    context = controller.CreateDefaultContext()
    controller.GetInputPort("bend_angle").FixValue(context, [0.0])
    controller.GetInputPort("measured_temperature").FixValue(context, [25.0, 25.0])
    set_point = controller.GetInputPort("set_point").FixValue(context, [1.0])
    simulator = Simulator(controller, context)
    simulator.AdvanceTo(100.0)
    set_point.GetMutableData().set_value(np.array([-0.02]))
    simulator.AdvanceTo(100.2)
    assert controller.get_output_port().Eval(context)[1] < 0.05


def test_a_hot_wire_gets_less_and_then_nothing():
    free = duty_after("right", 40, (25.0, 25.0))[1]
    assert duty_after("right", 40, (25.0, 88.0))[1] < 0.8 * free
    assert duty_after("right", 40, (25.0, 95.0))[1] == 0.0
    assert duty_after("both", 40, (95.0, 25.0))[0] == 0.0


def test_a_wire_that_was_cut_out_stays_off_until_it_has_cooled():
    controller = BendAngleController(LimbParameters(), "right")
    context = controller.CreateDefaultContext()
    controller.GetInputPort("bend_angle").FixValue(context, [0.0])
    controller.GetInputPort("set_point").FixValue(context, [0.6])
    measured = controller.GetInputPort("measured_temperature").FixValue(context, [25.0, 96.0])
    simulator = Simulator(controller, context)
    for temperature, is_on in ((96.0, False), (92.0, False), (89.0, True)):
        measured.GetMutableData().set_value(np.array([25.0, temperature]))
        simulator.AdvanceTo(context.get_time() + 0.1)
        assert (controller.get_output_port().Eval(context)[1] > 0) == is_on


def schedule_times(measured_slope, angle_error_deg, longest=60.0):
    """When the set point of a schedule changes, with inputs that ramp."""
    schedule = EquilibriumSchedule([0.1, 0.2], longest)
    context = schedule.CreateDefaultContext()
    bend = schedule.GetInputPort("bend_angle").FixValue(context, [0.0])
    measured = schedule.GetInputPort("measured_temperature").FixValue(context, [25.0, 25.0])
    simulator = Simulator(schedule, context)
    changes, before = [], 0.1
    for time in np.arange(0.0, 2 * longest + 1, 0.05):
        now = schedule.get_output_port().Eval(context)[0]
        bend.GetMutableData().set_value(np.array([now + np.deg2rad(angle_error_deg)]))
        measured.GetMutableData().set_value(np.array([25.0, 25.0 + measured_slope * time]))
        simulator.AdvanceTo(time)
        if schedule.get_output_port().Eval(context)[0] != before or schedule.is_finished(context):
            changes.append(time)
            before = schedule.get_output_port().Eval(context)[0]
        if schedule.is_finished(context):
            break
    return changes


def test_schedule_goes_on_when_settled_and_not_before():
    quick = schedule_times(0.0, 0.0)
    assert 5.0 <= quick[0] < 15.0
    assert schedule_times(0.3, 0.0)[0] == pytest.approx(60.0, abs=0.2)  # temperature moves
    assert schedule_times(0.0, 8.0)[0] == pytest.approx(60.0, abs=0.2)  # too far from the set point
    assert len(quick) == 2


def test_equilibria_are_reached_and_recorded_with_their_set_points(model_recordings):
    for kind, sides in (("right", (0, 1)), ("left", (-1, 0)), ("both", (-1, 1))):
        (recording,) = model_recordings[kind]
        assert recording.duty.max() <= 0.5
        angles = np.unique(recording.reference)
        assert len(angles) == 6
        assert (np.deg2rad(45) * sides[0] <= angles).all()
        assert (angles <= np.deg2rad(45) * sides[1]).all()
        ends = np.flatnonzero(np.diff(recording.reference[0]))
        error = (recording.bend_angle - recording.reference)[0, ends]
        assert np.rad2deg(np.abs(error)).max() < 3.5
    assert not model_recordings["right"][0].duty[0].any()
    assert not model_recordings["left"][0].duty[1].any()


def test_a_twin_is_never_hotter_than_its_limit(tmp_path):
    recording = collect_equilibria(LimbTwin(seed=3), "both", num_angles=2, longest=30.0, seed=0)
    assert (recording.provenance.limb_seed, recording.provenance.seed) == (3, 0)
    assert recording.measured_temperature.max() < 100.0
    recording.save(tmp_path / "both.csv")
    again = Recording.load(tmp_path / "both.csv")
    np.testing.assert_array_equal(again.reference, recording.reference)


@pytest.fixture
def short_excitations(monkeypatch):
    """The beginning of one of them, with both wires, and of a motion."""
    whole = excitations

    def few(num_wires, seed=0):
        chosen = [e for e in whole(num_wires, seed) if e.name in ("conditioning", "motion_1")]
        return [
            dataclasses.replace(e, pause=5.0, duty=e.duty.slice(0, segments))
            for e, segments in zip(chosen, (7, 3), strict=True)
        ]

    monkeypatch.setattr("calibration.collecting.protocol.excitations", few)
    monkeypatch.setattr("calibration.collecting.collect.WARM_UP_TIME", 25.0)
    monkeypatch.setattr("calibration.collecting.collect.WARM_UP_END", 40.0)
    monkeypatch.setattr("calibration.collecting.collect.CONTACT_TIME", 15.0)
    monkeypatch.setattr("calibration.collecting.collect.CONTACT_END", 50.0)
    return monkeypatch


def test_robot_is_excited_and_goes_on_where_it_was_interrupted(
    short_excitations, tmp_path, monkeypatch
):
    monkeypatch.setattr("calibration.collecting.protocol.SAG_TRIALS", 1)
    monkeypatch.setattr("calibration.collecting.protocol.RING_DOWNS", 1)
    waited, asked, told = [], [], []
    limb, described = LimbParameters(), LimbParameters()
    for each in (limb, described):  # of two links, which are simulated fast
        each.segments[0].links, each.segments[0].stiffness = 2, 0.0623
    limb.wires[1].law.a2 = 22.0
    monkeypatch.setattr(
        "calibration.collecting.protocol._wait", lambda pause, _: waited.append(pause)
    )
    monkeypatch.setattr("calibration.collecting.protocol.Knowledge.LAW", TwoMassLaw)

    class Robot(Limb):
        __slots__ = ()

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

    def collect():
        asked.clear()
        collect_from_robot(
            lambda known: Robot(dataclasses.replace(limb, gravity=known.gravity)),
            described,
            tmp_path,
            lambda what: asked.append(what.split(":")[0]),
            protocol="excitation",
            tell=told.append,
        )

    collect()
    heated = ["first_contact", "warm_up", "conditioning and what follows"]
    assert asked == ["sag_1", "ring_down_1", *heated]
    assert waited == [5.0]
    # 60 s each at first contact and in the warm-up, 24 s of conditioning, 16 s of the motion.
    said = "recordings are left, in which wires are heated for at most"
    assert told[0] == f"6 of 6 {said} 2.7 min in all"
    assert len(told) == 3
    (tmp_path / "motion_1.csv").unlink()
    collect()
    assert told[3] == f"1 of 6 {said} 0.27 min in all"
    assert asked == ["motion_1 and what follows"]
    recordings = load_recordings(tmp_path)
    del recordings["sag"], recordings["ring_down"]  # the model's, which nobody has bent
    calibration = calibrate(recordings, laws=(LinearLaw,))
    assert calibration.prediction.judges == "1 motion left out of the fit"
    assert calibration.parameters.wires[1].law.a2 == pytest.approx(22.0, rel=0.03)


def test_a_robot_whose_thermocouple_shows_no_heat_is_not_warmed_up(short_excitations, tmp_path):
    """Nor is it ever told more than it needs: any wire, and little duty."""
    protocol = "calibration.collecting.protocol"
    short_excitations.setattr(f"{protocol}.SAG_TRIALS", 0)
    short_excitations.setattr(f"{protocol}.RING_DOWNS", 0)
    connected = []

    class Robot(Limb):
        __slots__ = ()

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

    def connect(known):
        connected.append(known)
        limb = LimbParameters()
        limb.segments[0].links = 2
        limb.wires[0].law.a2 = 1.0
        return Robot(limb)

    with pytest.raises(CalibrationError, match=r"left wire was heated, .*first_contact\.csv and"):
        collect_from_robot(connect, LimbParameters(), tmp_path, lambda what: None)
    (known,) = connected
    assert known.total_duty == 0.3
    assert known.heat_bounds[0].most_heating == 65.0


def test_the_hottest_of_the_limbs_that_cannot_be_told_apart_limits_the_duty():
    """Also while thermocouples show nothing."""
    limb = LimbParameters()
    covariance = np.diag([64.0, 64.0])
    names = ["left.a2", "right.a2"]
    limb.calibration = CalibrationRecord(names, [20.0, 20.0], [8.0, 8.0], covariance.tolist())
    wanted = PiecewisePolynomial.ZeroOrderHold([0.0, 30.0], np.full((2, 2), 0.9))
    limited = LimitedDuty(limb, wanted)
    context = limited.CreateDefaultContext()
    limited.get_input_port().FixValue(context, [25.0, 25.0])
    Simulator(limited, context).AdvanceTo(30.0)
    temperatures = context.get_discrete_state_vector().value()[:-2]
    assert temperatures.size == 2 * 16
    assert 95.0 < temperatures.max() < 100.5
    assert temperatures.min() < 70.0
