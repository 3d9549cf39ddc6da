"""Bounds of heat that recordings show, as the board uses them."""

import dataclasses

import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial

from calibration import calibrate
from calibration.collect import WARM_UP_MARGIN, collect_warm_up
from calibration.heat_bounds import fit_heat_bounds
from hardware import LimbTwin
from hardware.emulation.simulated_board import SimulatedBoard
from hardware.firmware import guard, heat
from limb_systems import Limb, LimbParameters, TwoMassLaw, simulate
from limb_systems.model.heat_bounds import HeatBounds


def assert_contains_another_motion(bounds):
    """Of the nominal limb, in closed form: T - T0 = a2 D / a1 (1 - exp(-a1 t)), (6)."""
    observer = heat.WireObserver(0.0)
    observer.bounds = dataclasses.astuple(bounds)
    for time in np.arange(0.05, 12.0, 0.05):
        observer.advance(0.45, 0.05, 0.0)
        wire = 20.0 * 0.45 / 0.07 * (1 - np.exp(-0.07 * time))
        assert observer.least_reading < wire < observer.most + 0.5


def test_host_and_board_have_the_same_ranges_and_nominal_bounds():
    """The board cannot import the host's."""
    ranges = [field.metadata["range"] for field in dataclasses.fields(HeatBounds)]
    assert ranges == list(heat.RANGES)
    nominal = HeatBounds.around(LimbParameters().wires[0].linear_law)
    for bounds in (HeatBounds(), nominal):
        np.testing.assert_allclose(dataclasses.astuple(bounds), heat.NOMINAL, rtol=3e-3)


def test_bounds_of_a_limb_contain_its_other_motions():
    limb = LimbParameters()
    described = HeatBounds.around(limb.wires[0].linear_law)
    for fitted in fit_heat_bounds([simulate(Limb(limb), [0.2, 0.3], 30.0)], limb):
        assert fitted.slowest_cooling > described.slowest_cooling
        assert fitted.least_heating > described.least_heating
        unfitted = {
            "least_heating": described.least_heating,
            "slowest_cooling": described.slowest_cooling,
        }
        assert dataclasses.replace(fitted, **unfitted) == described  # what readings do not tell
        assert_contains_another_motion(fitted)


def test_bounds_around_a_law_contain_wires_in_warm_silicone():
    """From cold to a lasting heat, and while it cools."""
    limb = LimbParameters()
    limb.wires[1].law = TwoMassLaw()
    duty = PiecewisePolynomial.ZeroOrderHold([0.0, 120.0, 240.0], [[0.0, 0.0, 0.0], [0.2, 0, 0]])
    recording = simulate(Limb(limb), duty, 240.0)
    observer = heat.WireObserver(0.0)
    observer.bounds = dataclasses.astuple(limb.heat_bounds[1])
    step = recording.time[1]
    for applied, wire in zip(recording.duty[1], recording.wire_temperature[1, 1:], strict=False):
        observer.advance(applied, step, 0.0)
        assert observer.least_reading < wire - 25.0 < observer.most + 0.5


def test_a_wire_that_was_not_heated_keeps_its_bounds():
    limb = LimbParameters()
    left, right = fit_heat_bounds([simulate(Limb(limb), [0.0, 0.3], 20.0)], limb)
    assert left == limb.heat_bounds[0]
    assert right != limb.heat_bounds[1]


def test_a_wider_margin_makes_wider_bounds():
    limb = LimbParameters()
    recording = simulate(Limb(limb), [0.2, 0.3], 20.0)
    for narrow, wide in zip(
        fit_heat_bounds([recording], limb, 0.05),
        fit_heat_bounds([recording], limb, 0.25),
        strict=True,
    ):
        assert wide.least_heating < narrow.least_heating
        assert wide.slowest_cooling < narrow.slowest_cooling


@pytest.mark.parametrize("seed", [2, 7])
def test_an_emulated_limb_is_warmed_up_and_then_hot_within_its_bounds(seed):
    warm_up = collect_warm_up(LimbTwin(seed=seed))
    assert warm_up.measured_temperature.max() < 100.0
    parameters = LimbParameters()
    fitted = fit_heat_bounds([warm_up], parameters, WARM_UP_MARGIN)
    for wire, bounds in zip(parameters.wires, fitted, strict=True):
        wire.heat_bounds = bounds
    board = SimulatedBoard(LimbTwin(seed=seed), parameters, step=10)
    board.run(1.0)
    assert board.arm()
    hottest = 0.0
    for duty in (0.5, 0.3, 1.0, 0.2):
        for _ in range(100):
            board.run(0.05, (0.0, duty))
            warmest = board.emulation.firmware.guard.warmest(1)
            temperature = board.emulation.board.wire_temperature()[1]
            hottest = max(hottest, temperature)
            assert temperature < warmest + 1.0
        assert board.reason == guard.NONE
    assert hottest > 80.0


@pytest.mark.parametrize("described", [10.0, 30.0])
def test_a_limb_that_is_not_as_described_has_wider_bounds(described):
    limb = LimbParameters()
    recording = simulate(Limb(limb), [0.2, 0.3], 30.0)  # of 20 °C/s
    for wire in limb.wires:
        wire.law.a2 = described
    for fitted, around in zip(fit_heat_bounds([recording], limb), limb.heat_bounds, strict=True):
        assert_contains_another_motion(fitted)
        if described < 20.0:
            assert fitted.most_heating > around.most_heating
        else:
            assert fitted.least_heating < around.least_heating


def test_calibration_has_bounds_and_keeps_them_in_its_file(model_recordings, tmp_path):
    calibrated = calibrate(model_recordings, method="paper").parameters
    calibrated.save(tmp_path / "limb.yaml")
    loaded = LimbParameters.load(tmp_path / "limb.yaml")
    for wire, bounds in zip(loaded.wires, calibrated.heat_bounds, strict=True):
        assert wire.heat_bounds == bounds
        assert bounds.slowest_cooling > 0.05  # around the nominal law it would be 0.042
