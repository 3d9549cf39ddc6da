"""The emulated limb as a whole: the ports of `Limb`, its sensors, its memory."""

import copy
import dataclasses
from pathlib import Path

import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial
from simulated_board import SimulatedBoard

from hardware import LimbTwin
from hardware.emulation.emulated_board import EmulatedBoard
from hardware.emulation.specimen import Specimen
from hardware.firmware import guard
from limb_systems import (
    ChordSensor,
    LimbError,
    LimbParameters,
    SegmentParameters,
    TipTangentSensor,
    simulate,
)
from limb_systems.limb_parameters import EmulatedLimb

from .conftest import small_twin


def test_each_wire_warms_and_bends_its_own_segment_to_its_side(two_segments):
    for wire in range(4):
        duty = 0.3 * np.eye(4)[wire]
        recording = simulate(LimbTwin(two_segments, seed=4), duty, 8.0)
        rise = recording.measured_temperature[:, -1] - recording.measured_temperature[:, 0]
        assert np.argmax(rise) == wire
        assert rise[wire] > 20.0
        bent = recording.bend_angle[:, -20:].mean(axis=1)
        assert np.argmax(np.abs(bent)) == wire // 2
        assert np.sign(bent[wire // 2]) == (1.0 if wire % 2 else -1.0)


def test_readings_of_a_limb_at_rest_have_the_stated_noise():
    at_rest = simulate(small_twin(seed=3), [0.0, 0.0], 60.0, sample_rate=5.0)
    error = np.rad2deg(at_rest.bend_angle)[0]
    # White noise of 0.5°, on top of a drift that hardly moves from sample to sample.
    assert np.diff(error).std() / np.sqrt(2) == pytest.approx(0.5, rel=0.1)
    assert 0.5 < error[50:].std() < 2.5
    # Noise of 0.25 °C and steps of 0.25 °C, whose variance is a twelfth of their square.
    expected = 0.25 * np.sqrt(1 + 1 / 12)
    assert at_rest.measured_temperature[0].std() == pytest.approx(expected, rel=0.1)


def test_a_limb_that_was_hot_is_still_warm():
    twin = small_twin(seed=2)
    cold = simulate(twin, [0.0, 0.3], 30.0)
    now = simulate(twin.after_rest(), [0.0, 0.0], 5.0)
    later = simulate(twin.after_rest(300.0), [0.0, 0.0], 5.0)
    end, start = cold.measured_temperature[1, -1], now.measured_temperature[1, 0]
    assert abs(start - end) < 2.0
    assert abs(now.bend_angle[0, 0] - cold.bend_angle[0, -1]) < np.deg2rad(5.0)
    first = np.rad2deg(now.bend_angle[0, :20])  # it goes on bending back, and does not swing
    assert np.abs(np.diff(first)).max() < 4.0
    assert np.ptp(first) < 6.0
    room = cold.measured_temperature[1, 0]
    assert room + 0.5 < later.measured_temperature[1].mean() < room + 10.0
    # Another limb of the same kind has not been heated.
    assert simulate(small_twin(seed=2), [0.0, 0.0], 1.0).measured_temperature[1, 0] < room + 1.5


def test_a_sagging_limb_shows_what_its_sensor_is_made_for():
    """By beam theory α/2 is two thirds of the chord's angle; rest and noise are alike."""
    sags = []
    for sensor in (TipTangentSensor(), ChordSensor(), ChordSensor(gain=1.2, offset=0.1)):
        limb = LimbParameters(gravity=[0.0, -9.81, 0.0])
        limb.segments[0].bend_sensor = dataclasses.replace(sensor, noise=0.0, drift=0.0)
        sags.append(simulate(LimbTwin(limb), [0.0, 0.0], 6.0).bend_angle[0, -20:].mean())
    half_tangent, chord, wrong = np.rad2deg(sags)
    assert chord < -6.0
    # The emulated rubber's angle at rest, of 2° at most, is the same for both.
    assert half_tangent == pytest.approx(chord / 1.5, abs=0.8)
    assert half_tangent > chord + 2.0
    assert wrong == pytest.approx(1.2 * chord + np.rad2deg(0.1), abs=0.2)


def test_readings_are_those_they_have_always_been():
    """The limbs of the evaluation stay what they were, to the digit; their chords were kept."""
    limb = LimbParameters()
    limb.segments[0].bend_sensor = ChordSensor()
    kept = np.loadtxt(Path(__file__).parents[1] / "data" / "twin_readings.csv", delimiter=",")
    for seed in (0, 3, 7):
        twin = LimbTwin(limb, seed=seed)
        runs = [simulate(twin, [0.1, 0.4], 3.0)]
        rested = twin.after_rest(2.0, bend_rate=100.0)
        runs.append(simulate(rested, [0.0, 0.0], 0.5, sample_rate=100.0))
        for number, run in enumerate(runs):
            expected = kept[(kept[:, 0] == seed) & (kept[:, 1] == number), 2:].T
            degrees = np.rad2deg(run.bend_angle)
            np.testing.assert_allclose(4 * run.measured_temperature, expected[:2], atol=1e-6)
            np.testing.assert_allclose(10 * degrees, expected[2:], atol=1e-6)


def test_an_emulated_limb_is_made_again_from_its_identity():
    wide = LimbParameters(segments=[SegmentParameters(links=2, width=0.03)])
    for twin in (
        LimbTwin(seed=3),
        LimbTwin(wide, seed=4),
        LimbTwin(specimen=Specimen(LimbParameters(), 5).without("hysteresis", "bend sensor")),
        LimbTwin(seed=7, extra=("memory", "bond")),
    ):
        recording = simulate(twin, [0.1, 0.4], 1.0)
        used = twin.after_rest(gravity=(0.0, -9.81, 0.0))
        assert recording.parameters.board == used.parameters.board
        calibrated = copy.deepcopy(recording.parameters)
        calibrated.segments[0].stiffness *= 1.1
        made_again = LimbTwin.of(LimbParameters.from_yaml(calibrated.to_yaml()), seed=9)
        assert made_again.source == twin.source
        rerun = simulate(made_again, [0.1, 0.4], 1.0)
        np.testing.assert_array_equal(rerun.bend_angle, recording.bend_angle)
        np.testing.assert_array_equal(rerun.measured_temperature, recording.measured_temperature)
    assert LimbTwin.of(LimbParameters(), seed=9).source == "emulated limb, seed 9"


def test_a_limb_that_is_measured_too_hot_cuts_out_until_its_next_use():
    twin = small_twin()
    recording = simulate(twin, [0.0, 1.0], 20.0)
    hot = np.argmax(recording.measured_temperature[1] >= guard.TEMPERATURE_LIMIT)
    assert hot > 0
    assert (recording.applied_duty[1, :hot] == 1.0).all()
    assert (recording.applied_duty[1, hot + 1 :] == 0.0).all()  # also when it has cooled
    assert recording.measured_temperature[1, -1] < 100.0
    assert (recording.duty[1] == 1.0).all()  # what was commanded
    assert not recording.interrupted
    again = simulate(twin.after_rest(), [0.0, 1.0], 0.5)
    assert (again.applied_duty[1] == 1.0).all()


def test_an_emulated_board_s_limb_leaves_the_cut_out_to_the_firmware():
    """With a shorted MOSFET the wire gets hotter than any limit."""
    board = SimulatedBoard(LimbTwin(seed=0)).emulation.board
    for end in (12.0, 24.0):  # new and cooled
        board._running.duty[:] = [0.0, 1.0]
        board._running.advance(end)
        assert board.wire_temperature()[1] > 130.0
        board.cool()


def test_an_emulated_board_that_comes_late_still_has_its_limb():
    """Each time 3 ms after a step of the wires, which is how the integrator once got to NaN."""
    now = 0.0
    board = EmulatedBoard(LimbTwin(seed=0), lambda _: None, lambda: now)
    for turn in range(200):
        board.set_duty(0, 0.3 * (turn % 3 == 0))
        board.keep_supply()
        now = 0.05 * (turn + 1) + 0.003
        board.advance()
    on_time = LimbTwin(seed=0)
    duty = PiecewisePolynomial.ZeroOrderHold(
        0.05 * np.arange(201), 0.3 * np.array([np.arange(201) % 3 == 0, np.zeros(201)])
    )
    expected = simulate(on_time, duty, 10.0).measured_temperature[0, -1]
    assert board.reading("measured_temperature")[0] == pytest.approx(expected, abs=0.5)


def test_a_limb_of_physics_that_no_loaded_module_defines_is_named():
    """Such a file loads without the module, but the limb cannot be made again."""
    parameters = LimbParameters(board=EmulatedLimb(seed=3, physics="rods"))
    read = LimbParameters.from_yaml(parameters.to_yaml())
    known = r"physics 'rods' is known here, only .*lumped.*: soft-limb --import MODULE"
    with pytest.raises(LimbError, match=known):
        LimbTwin.of(read)
