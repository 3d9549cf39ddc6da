"""The controller, the schedule, and recordings collected with them."""

import copy
import dataclasses
import functools
import io
from unittest import mock

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.trajectories import PiecewisePolynomial

from calibration import (
    BendAngleController,
    CalibrationError,
    EquilibriumSchedule,
    Knowledge,
    LimitedDuty,
    collect_equilibria,
    collect_excitation,
    collect_first_contact,
    collect_from_robot,
    collect_from_twin,
    collect_ring_down,
    collect_sag,
    collect_warm_up,
    excitations,
    fit_law,
    fit_stiffness,
    kind_of,
    load_recordings,
)
from calibration.collecting.excitation import DutyUntilWarm, Excitation, held_levels, mountings
from calibration.collecting.measurement_protocol import planned_recordings
from calibration.prediction.heated_run import HeatedRun
from calibration.recordings.repair import select_samples
from controllers.reduced_model import ReducedModel
from hardware import LimbTwin
from limb_systems import (
    CalibrationRecord,
    ChordSensor,
    HystereticLaw,
    Limb,
    LimbError,
    LimbParameters,
    LinearLaw,
    Recording,
    RestMemory,
    SegmentParameters,
    TwoMassLaw,
    WireParameters,
    simulate,
)
from limb_systems.progress import Progress
from soft_limb.command import main


class Controlled:
    """A controller and what it sees: cold wires and a limb that stays straight."""

    def __init__(self, actuated, error_deg, limb=None):
        self.controller = BendAngleController(limb or LimbParameters(), actuated)
        self.context = self.controller.CreateDefaultContext()
        self.values = {
            name: self.controller.GetInputPort(name).FixValue(self.context, value)
            for name, value in (
                ("bend_angle", [0.0]),
                ("measured_temperature", [25.0, 25.0]),
                ("set_point", [np.deg2rad(error_deg)]),
            )
        }
        self.simulator = Simulator(self.controller, self.context)

    def duty(self, duration=0.0, **seen):
        """The duty after some time more, with other inputs from now on."""
        for name, value in seen.items():
            self.values[name].GetMutableData().set_value(np.array(value))
        self.simulator.AdvanceTo(self.context.get_time() + duration)
        return self.controller.get_output_port().Eval(self.context)


# Bend per duty is 3 * 4.7e-4 / 0.1246 * 20 / 0.07 = 3.233 rad, and the loop's gain is 1.5.
GAIN = 1.5 / (3 * 4.7e-4 / 0.1246 * 20 / 0.07)


def test_proportional_part_heats_the_wire_on_the_side_of_the_error():
    duty, less = GAIN * np.deg2rad(10.0), GAIN * np.deg2rad(4.0)
    for actuated, error, expected in (
        ("right", 10, [0, duty]),
        ("left", -10, [duty, 0]),
        ("right", -10, [0, 0]),
        ("left", 10, [0, 0]),
        ("both", 4, [0.08 - less, 0.08 + less]),
    ):
        np.testing.assert_allclose(Controlled(actuated, error).duty(), expected, rtol=0.05)


@pytest.mark.parametrize(
    ("law", "memory"),
    [(LinearLaw(), None), (TwoMassLaw(), None), (HystereticLaw(), RestMemory(shift=0.0))],
)
def test_gains_are_of_what_settled_wires_do(law, memory):
    """Of the torque at 62.5 °C on heating, and of wires and silicone in a lasting heat.

    The integral part grows at the pole of the wire.
    """
    limb, pole, bend = LimbParameters(), 0.07, 3 * 4.7e-4 / 0.1246 * 20 / 0.07
    limb.segments[0].rest_memory = memory
    for wire in limb.wires:
        wire.law = law
    if not isinstance(law, LinearLaw):
        slope, pole = 4.7e-4, 0.08
        if isinstance(law, HystereticLaw):
            share = np.exp((62.5 - 66.0) / 9.0)
            start = 1.0 + np.exp((25.0 - 66.0) / 9.0)
            slope = 0.038 * start * share / (1.0 + share) ** 2 / 9.0
        bend = 3 * slope / 0.1246 * 20 / 0.08 * (1 + 0.004 / 0.012)
    first = 1.5 / bend * np.deg2rad(5.0)
    controlled = Controlled("right", 5, limb)
    assert controlled.duty()[1] == pytest.approx(first, rel=0.02)
    assert controlled.duty(10.0)[1] == pytest.approx(first + first * pole * 10.0, rel=0.02)


def test_duty_is_limited_and_the_integral_does_not_wind_up():
    controlled = Controlled("right", 85)
    assert controlled.duty()[1] == pytest.approx(0.5)
    controlled.duty(100.0)
    assert controlled.duty(0.2, set_point=[-0.02])[1] < 0.05


def test_a_hot_wire_gets_less_and_then_nothing_until_it_has_cooled():
    controlled = Controlled("right", 40)
    free = controlled.duty()[1]
    shares = [
        controlled.duty(0.1, measured_temperature=[25.0, measured])[1] / free
        for measured in (88.0, 96.0, 92.0, 89.0)
    ]
    assert 0.0 < shares[0] < 0.8
    assert shares[1:3] == [0.0, 0.0]
    assert shares[3] > 0.0
    assert Controlled("both", -40).duty(0.1, measured_temperature=[95.0, 25.0])[0] == 0.0


def test_a_wire_without_a_reading_gets_no_duty():
    """Until it is read again: a board may miss a reading."""
    controlled, wanted = Controlled("both", 2), PiecewisePolynomial([[0.3], [0.3]])
    before = controlled.duty(0.1)
    missed = controlled.duty(0.1, measured_temperature=[25.0, np.nan])
    assert (before > 0.0).all()
    assert missed[0] > 0.0
    assert missed[1] == 0.0
    assert (controlled.duty(0.1, measured_temperature=[25.0, 25.0]) > 0.0).all()
    limb = LimbParameters()
    names, covariance = ["left.a2", "right.a2"], np.diag([1.0, 1.0]).tolist()
    limb.calibration = CalibrationRecord(names, [20.0, 20.0], [1.0, 1.0], covariance)
    for system in (LimitedDuty(limb, wanted), DutyUntilWarm(wanted, 10.0)):
        context = system.CreateDefaultContext()
        measured = system.get_input_port().FixValue(context, [25.0, 25.0])
        simulator = Simulator(system, context)
        for readings in ([25.0, 25.0], [25.0, np.nan], [25.0, 25.0]):
            measured.GetMutableData().set_value(readings)
            simulator.AdvanceTo(context.get_time() + 0.1)
            duty = system.get_output_port().Eval(context)
            assert (duty == 0.0).tolist() == np.isnan(readings).tolist()
    schedule = EquilibriumSchedule([0.1], 60.0)
    context = schedule.CreateDefaultContext()
    schedule.GetInputPort("bend_angle").FixValue(context, [0.1])
    measured = schedule.GetInputPort("measured_temperature").FixValue(context, [25.0, np.nan])
    simulator = Simulator(schedule, context)
    simulator.AdvanceTo(20.0)
    assert not schedule.is_finished(context)  # no slope is known
    measured.GetMutableData().set_value([25.0, 25.0])
    simulator.AdvanceTo(40.0)
    assert schedule.is_finished(context)


@pytest.mark.parametrize(
    ("collect", "message"),
    [
        (collect_sag, "the board is silent"),
        (collect_ring_down, "the board is silent"),
        (lambda limb: collect_equilibria(limb, "middle"), "middle"),
        (lambda limb: collect_equilibria(limb, "left", num_angles=0), "num_angles is 0"),
        (lambda limb: collect_excitation(limb, excitations(2)[0], limb.parameters), "calibrated"),
        (lambda limb: collect_first_contact(limb, jurnal="contact.csv"), "jurnal"),
        (lambda limb: collect_warm_up(limb, sample_rate=100.0), "sample_rate"),
    ],
)
def test_a_robot_is_closed_if_its_recording_fails(collect, message):
    limb = LimbTwin(seed=0)
    with (
        mock.patch.object(LimbTwin, "real_time", True),
        mock.patch.object(LimbTwin, "close", create=True) as close,
        mock.patch("hardware.replaying.record", side_effect=LimbError("the board is silent")),
        pytest.raises((LimbError, TypeError), match=message),
    ):
        collect(limb)
    close.assert_called()


def test_an_option_that_is_misspelt_is_refused():
    with pytest.raises(TypeError, match="num_angels"):
        collect_from_twin(LimbTwin(), num_angels=3)


def first_change(
    measured_slope: float, angle_error_deg: float, missed_share: float = 0.0
) -> tuple[float, bool]:
    """When a schedule of two angles goes on, s, with V that ramps; whether it ends by then."""
    random = np.random.default_rng(0)
    schedule = EquilibriumSchedule([0.1, 0.2], 60.0)
    context = schedule.CreateDefaultContext()
    bend = schedule.GetInputPort("bend_angle").FixValue(context, [0.0])
    measured = schedule.GetInputPort("measured_temperature").FixValue(context, [25.0, 25.0])
    simulator, times, set_points = Simulator(schedule, context), np.arange(0.0, 70.0, 0.05), []
    for time in times:
        set_points.append(schedule.get_output_port().Eval(context)[0])
        bend.GetMutableData().set_value([set_points[-1] + np.deg2rad(angle_error_deg)])
        ramp = 25.0 + measured_slope * time
        is_missed = random.uniform() < missed_share
        measured.GetMutableData().set_value([25.0, np.nan if is_missed else ramp])
        simulator.AdvanceTo(time)
    return times[np.argmax(np.array(set_points) != 0.1)], schedule.is_finished(context)


def test_schedule_goes_on_when_settled_and_not_before():
    for missed_share in (0.0, 0.2):
        time, finished = first_change(0.0, 0.0, missed_share)
        assert 5.0 <= time < 15.0
        assert finished
    assert first_change(0.3, 0.0)[0] == pytest.approx(60.0, abs=0.2)  # temperature moves
    assert first_change(0.3, 0.0, 0.2)[0] == pytest.approx(60.0, abs=0.2)
    assert first_change(0.0, 8.0)[0] == pytest.approx(60.0, abs=0.2)  # too far from the set point


def test_equilibria_are_reached_and_recorded_with_their_set_points(model_recordings):
    for kind, count, sides in (("right", 4, (0, 1)), ("left", 3, (-1, 0)), ("both", 3, (-1, 1))):
        (recording,) = model_recordings[kind]
        assert recording.duty.max() <= 0.5
        angles = np.unique(recording.reference)
        assert len(angles) == count
        assert (np.deg2rad(45) * sides[0] <= angles).all()
        assert (angles <= np.deg2rad(45) * sides[1]).all()
        ends = np.flatnonzero(np.diff(recording.reference[0]))
        error = (recording.bend_angle - recording.reference)[0, ends]
        assert np.rad2deg(np.abs(error)).max() < 3.5
    assert not model_recordings["right"][0].duty[0].any()
    assert not model_recordings["left"][0].duty[1].any()


def test_a_twin_is_never_hotter_than_its_limit(described):
    twin = LimbTwin(described, seed=3)
    recording = collect_equilibria(twin, "both", num_angles=2, longest=30.0, seed=0)
    assert (recording.provenance.limb_seed, recording.provenance.seed) == (3, 0)
    assert recording.measured_temperature.max() < 100.0


PROTOCOL = "calibration.collecting.measurement_protocol"


class Robot(Limb):
    """The model in place of a robot, which a context manager closes."""

    __slots__ = ()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


@pytest.fixture
def short_excitations(monkeypatch):
    """A pulse of the last wire and of the first, and the beginning of a motion."""
    whole = excitations

    def few(num_wires, seed=0):
        (motion,) = [e for e in whole(num_wires, seed) if e.name == "motion_1"]
        first = np.eye(num_wires)[0]
        last = np.eye(num_wires)[-1]
        off = 0.0 * first
        parts = [(2.0, off), (6.0, 0.5 * last), (8.0, off), (6.0, 0.5 * first), (8.0, off)]
        pulses = held_levels(parts)
        return [
            Excitation("conditioning", "heated", 0.0, pulses),
            dataclasses.replace(motion, pause=5.0, duty=motion.duty.slice(0, 3)),
        ]

    for name, value in (
        (f"{PROTOCOL}.excitations", few),
        (f"{PROTOCOL}.NUM_SAG_TRIALS", 1),
        (f"{PROTOCOL}.NUM_RING_DOWNS", 1),
        (f"{PROTOCOL}._wait_with_progress", lambda pause, _: None),
        (f"{PROTOCOL}.Knowledge.LAW", LinearLaw),
        ("calibration.collecting.collect.SAMPLE_RATE", 10.0),
        ("calibration.collecting.collect.WARM_UP_TIME", 12.0),
        ("calibration.collecting.collect.WARM_UP_END", 18.0),
        ("calibration.collecting.collect.CONTACT_TIME", 8.0),
        ("calibration.collecting.collect.CONTACT_PAUSE", 7.0),
    ):
        monkeypatch.setattr(name, value)
    return monkeypatch


def test_robot_is_excited_and_goes_on_where_it_was_interrupted(
    short_excitations, tmp_path, described
):
    waited, asked, told = [], [], []
    limb = copy.deepcopy(described)
    limb.wires[1].law.a2 = 22.0
    short_excitations.setattr(
        f"{PROTOCOL}._wait_with_progress", lambda pause, _: waited.append(pause)
    )

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
    # 60 s each at first contact and in the warm-up, 12 s of conditioning, 16 s of the motion.
    said = "recordings are left, in which wires are heated for at most"
    assert told[0] == f"6 of 6 {said} 2.5 min in all"
    assert len(told) == 3
    (tmp_path / "motion_1.csv").unlink()
    collect()
    assert told[3] == f"1 of 6 {said} 0.27 min in all"
    assert asked == ["motion_1 and what follows"]
    runs = [HeatedRun.of(recording) for recording in load_recordings(tmp_path)["heated"]]
    estimates = fit_law(LinearLaw, runs, described.segments[0], 25.0).estimates
    assert estimates["right.a2"].value == pytest.approx(22.0, rel=0.03)


def test_a_motion_is_compared_with_its_repetitions(described):
    """As far as both go, if one is longer."""
    fit = mock.Mock()
    fit.predict.return_value = [mock.Mock(bend_error=0.0, temperature_error=0.0)]
    knowledge = Knowledge(described)
    first = simulate(Limb(described), [0.0, 0.1], 3.0)
    moved = dataclasses.replace(first, bend_angle=first.bend_angle + np.deg2rad(2.0))
    with mock.patch.object(Knowledge, "_fit", return_value=fit):
        knowledge.add(first, "motion")
        knowledge.add(select_samples(moved, slice(20)), "motion")
        sentence = knowledge.add(dataclasses.replace(moved), "motion")
    # 2° between the first and each other, nothing between these.
    assert sentence.endswith("; motions differ by 1.3° from each other")


def test_an_interrupted_recording_is_kept_and_made_anew(short_excitations, tmp_path, described):
    """With the model in place of a robot, which a context manager closes alike."""
    short_excitations.setattr(f"{PROTOCOL}.NUM_SAG_TRIALS", 2)
    in_use, asked = [], []

    class Closing(Limb):
        __slots__ = ()

        def __enter__(self):
            in_use.append(self.parameters.gravity)
            return self

        def __exit__(self, *_):
            in_use.clear()

    def ask(what):
        assert not in_use  # nobody gets a hand on a limb that may be heated
        asked.append(what.split(":")[0])

    def collect():
        options = {"num_angles": 1, "longest": 10.0, "protocol": "paper"}
        collect_from_robot(Closing, described, tmp_path, ask, **options)

    def stop(_, done, remark=""):
        if asked[-1] == "ring_down_1" and done >= 3.0:
            assert in_use == [[0.0, 0.0, 0.0]]
            raise KeyboardInterrupt

    with short_excitations.context() as interrupted:
        interrupted.setattr(Progress, "update", stop)
        with pytest.raises(KeyboardInterrupt), pytest.warns(UserWarning, match="until then is in"):
            collect()
    assert not in_use
    assert asked == ["sag_1", "sag_2", "ring_down_1"]
    finished = {path: path.read_bytes() for path in tmp_path.iterdir()}
    left = tmp_path / "ring_down_1.unfinished.csv"
    assert sorted(finished) == [left, tmp_path / "sag_1.csv", tmp_path / "sag_2.csv"]
    assert Recording.load(left).time[-1] == pytest.approx(3.0)

    message = rf"{left} was interrupted; .* calibration ignores it, and ring_down_1 is recorded"
    with pytest.warns(UserWarning, match=message) as warned:
        collect()
    assert len(warned) == 1
    assert asked[3:] == ["ring_down_1", "first_contact", "warm_up", "right", "left", "both"]
    assert {path: path.read_bytes() for path in finished} == finished
    left.unlink()
    found = {path.stem: Recording.load(path) for path in tmp_path.iterdir()}
    assert sorted(found) == sorted({*asked})
    assert not any(recording.interrupted for recording in found.values())
    assert found["sag_1"].parameters.gravity == [0.0, -9.81, 0.0]
    assert found["right"].parameters.gravity == [0.0, 0.0, 0.0]
    # The board is told more and more of what to expect of these wires.
    contact, warm_up, right = (
        found[name].parameters.wires[0].heat_bounds
        for name in ("first_contact", "warm_up", "right")
    )
    assert contact.most_heating > warm_up.most_heating > right.most_heating
    assert contact.slowest_cooling < warm_up.slowest_cooling < right.slowest_cooling
    assert found["first_contact"].parameters.total_duty == 0.3
    collect()
    assert len(asked) == 9


def test_first_contact_warms_any_number_of_wires_one_after_the_other():
    limb = LimbParameters.in_space(wires=4, links=2)
    recording = collect_first_contact(Limb(limb))
    assert recording.time[-1] == pytest.approx(4 * (30.0 + 20.0))
    heated = recording.duty > 0
    assert heated.sum(axis=0).max() == 1
    assert np.diff(heated.argmax(axis=1)) == pytest.approx([50 * 20] * 3, abs=1)


def test_a_robot_whose_thermocouple_shows_no_heat_is_not_warmed_up(
    short_excitations, tmp_path, described
):
    """Nor is it ever told more than it needs: any wire, and little duty."""
    short_excitations.setattr(f"{PROTOCOL}.NUM_SAG_TRIALS", 0)
    short_excitations.setattr(f"{PROTOCOL}.NUM_RING_DOWNS", 0)
    limb = copy.deepcopy(described)
    limb.wires[0].law.a2 = 1.0
    connected = []

    def connect(known):
        connected.append(known)
        return Robot(limb)

    with pytest.raises(CalibrationError, match=r"left wire was heated, .*first_contact\.csv and"):
        collect_from_robot(connect, described, tmp_path, lambda what: None)
    (known,) = connected
    assert known.total_duty == 0.3
    assert known.heat_bounds[0].most_heating == 65.0


def test_a_limb_in_space_is_mounted_by_hand_for_each_excitation(short_excitations, tmp_path):
    """The weight is hung to it, it is turned, and the weight is taken off for the motion."""
    short = [dataclasses.replace(e, duty=e.duty.slice(0, 2)) for e in mountings(3)[:2]]
    short_excitations.setattr(f"{PROTOCOL}.mountings", lambda num_wires: short)
    short_excitations.setattr(f"{PROTOCOL}.NUM_RING_DOWNS", 0)
    limb, asked, connected = LimbParameters.in_space(), {}, []
    limb.segments[0].links = 2

    def connect(known):
        connected.append((known.gravity, known.payload))
        return Robot(known)

    def ask(what):
        name, _, instruction = what.partition(": ")
        asked[name] = instruction

    collect_from_robot(connect, limb, tmp_path, ask)
    assert asked["warm_up"] == "Leave the limb as it hangs and alone until its wires are cold."
    assert asked["conditioning and what follows"].endswith("cold, and for 20 minutes after Enter.")
    mass = limb.segments[0].mass
    for name, side in (("mounting_0", "+E2"), ("mounting_90", "-E3")):
        assert asked[name].startswith(f"Hang {1000 * mass:.0f} g to the limb's tip, and mount it")
        assert f"so that its {side} side is up. Leave it alone" in asked[name]
    assert asked["motion_1"].startswith("Take the weight off its tip, and mount the limb so that")
    hanging = ([9.81, 0.0, 0.0], limb.payload)
    assert connected[0] == connected[2] == connected[5] == hanging
    for (gravity, payload), e2_e3 in zip(connected[3:5], ([-9.81, 0.0], [0.0, 9.81]), strict=True):
        assert gravity == pytest.approx([0.0, *e2_e3])
        assert payload == pytest.approx(limb.payload + mass)


def test_a_short_limb_sags_under_a_weight_to_both_sides(tmp_path, monkeypatch):
    """The operator is told the weight, the recordings say it, and together they tell k."""
    monkeypatch.setattr(f"{PROTOCOL}.NUM_SAG_TRIALS", 2)
    monkeypatch.setattr(f"{PROTOCOL}.NUM_RING_DOWNS", 1)
    segment = SegmentParameters(links=2, length=0.06, mass=0.015, stiffness=0.104)
    segment.bend_sensor = ChordSensor()  # what the model shows
    limb, asked = LimbParameters(segments=[segment]), []
    heavier = copy.deepcopy(limb)
    heavier.segments[0].stiffness *= 1.3

    class CollectedError(Exception):
        """Sag and ring-down are there."""

    def connect(known):
        return Robot(dataclasses.replace(heavier, gravity=known.gravity, payload=known.payload))

    def ask(what):
        asked.append(what)
        if what.startswith("first_contact"):
            raise CollectedError

    with pytest.raises(CollectedError):
        collect_from_robot(connect, limb, tmp_path, ask)
    one, other, swing = (
        Recording.load(tmp_path / f"{name}.csv") for name in ("sag_1", "sag_2", "ring_down_1")
    )
    grams = 1000 * one.parameters.payload
    assert other.parameters.payload == one.parameters.payload > 0.03
    assert swing.parameters.payload == 0.0
    hang = f"left wire. Hang {grams:.3g} g to its tip, and let it hang still."
    assert asked[0].endswith(f"bends it towards its {hang}")
    assert asked[1].endswith(f"bends it away from its {hang}")
    assert "Take the weight off the limb's tip. Mount the limb level." in asked[2]
    assert one.bend_angle[0, -1] < -0.15 < 0.15 < other.bend_angle[0, -1]
    found = fit_stiffness(limb, [one, other]).stiffness
    assert found.value == pytest.approx(heavier.segments[0].stiffness, rel=5e-3)


def test_collect_looks_for_the_board_first_and_needs_a_terminal(tmp_path, monkeypatch, capsys):
    arguments = ["collect", "-o", str(tmp_path / "new"), "-p", str(tmp_path / "no_port")]
    assert main(arguments) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert "no_port: No such file or directory; soft-limb status" in said.err
    monkeypatch.setattr("soft_limb.commands.calibration.BoardLink", mock.MagicMock())
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main(arguments) == 1
    assert "but there is no terminal; run it in a terminal" in capsys.readouterr().err


def test_command_collects_three_wires_from_a_robot_as_four_kinds(
    short_excitations, tmp_path, described, capsys
):
    """With the model in place of the robot. Two of the wires are on one side."""
    monkeypatch = short_excitations
    ports, asked = [], []

    def connect(port, parameters, board=None):
        ports.append(port)
        return Robot(parameters)

    monkeypatch.setattr("soft_limb.commands.calibration.SerialLimb", connect)
    monkeypatch.setattr("soft_limb.commands.calibration.BoardLink", mock.MagicMock())
    monkeypatch.setattr("builtins.input", asked.append)
    shorter = functools.partial(collect_from_robot, longest=10.0)
    monkeypatch.setattr("soft_limb.commands.calibration.collect_from_robot", shorter)
    limb = described
    limb.ambient_temperature = 21.5
    limb.segments[0].wires = [
        WireParameters("low", -0.0034),
        WireParameters("near", 0.0034, 0.003),
        WireParameters("far", 0.0034, -0.003),
    ]
    limb.save(tmp_path / "limb.yaml")
    arguments = ["collect", "-p", "/dev/robot", "-o", str(tmp_path / "new"), "--seed", "3"]
    arguments += ["--protocol", "paper", "--angles", "1", "-l", str(tmp_path / "limb.yaml")]
    assert main(arguments) == 0
    assert "next" in capsys.readouterr().out
    names = ["sag_1", "ring_down_1", "first_contact", "warm_up", "near", "far", "low", "both"]
    assert ports == ["/dev/robot"] * len(names)
    assert [what.split(":")[0] for what in asked] == names
    assert "towards its low wire" in asked[0]
    assert all(what.endswith(".\nPress Enter when this is done. ") for what in asked)
    found = {path.stem: Recording.load(path) for path in (tmp_path / "new").iterdir()}
    assert sorted(found) == sorted(names)
    assert {recording.parameters.ambient_temperature for recording in found.values()} == {21.5}
    for name, heated in (("near", [1]), ("low", [0]), ("both", [0, 1, 2]), ("sag_1", [])):
        assert np.flatnonzero(found[name].duty.max(axis=1)).tolist() == heated
        assert kind_of(found[name]) == name.removesuffix("_1")
    # Each kind has random angles of its own, from the seed on.
    for name, seed, low in (("near", 3, 0), ("low", 5, -1)):
        angles = np.deg2rad(45.0) * np.random.default_rng(seed).uniform(low, low + 1, 1)
        assert np.unique(found[name].reference) == pytest.approx(np.sort(angles))
    # Nothing is to be fitted without heat.
    usable = mock.Mock(return_value=mock.Mock(heated={}))
    monkeypatch.setattr("soft_limb.commands.calibration.select_usable", usable)
    assert main(arguments) == 0
    assert "next" not in capsys.readouterr().out
    found["both"].duty[0] = 0.0
    assert kind_of(dataclasses.replace(found["both"], kind="")) == "heated"


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


@dataclasses.dataclass
class RootLaw(LinearLaw):
    """A law that is hotter at half duty than midway between off and on."""

    def rates(self, x, D, T0):
        return super().rates(x, np.sqrt(D), T0)


def test_a_law_that_is_not_affine_in_the_duty_is_refused():
    limb = LimbParameters()
    limb.wires[1].law = RootLaw()
    limited = functools.partial(LimitedDuty, duty=PiecewisePolynomial([[0.1], [0.1]]))
    Limb(limb)  # which is simulated as it is
    collected = functools.partial(planned_recordings, emulated=True)
    for make in (collected, limited, ReducedModel):
        with pytest.raises(LimbError, match="rates of RootLaw are not affine in the duty"):
            make(limb)
