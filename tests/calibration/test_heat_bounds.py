"""Bounds of heat that recordings show, as the board uses them."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial
from simulated_board import SimulatedBoard

from calibration import CalibrationError
from calibration.collecting.collect import (
    collect_first_contact,
    collect_warm_up,
    limb_for_first_contact,
)
from calibration.collecting.measurement_protocol import CONTACT_MARGIN, WARM_UP_MARGIN
from calibration.heat_bounds_fit import check_first_contact, fit_heat_bounds, heat_remarks
from hardware import LimbTwin
from hardware.board.heat_rates import HeatRates
from hardware.firmware import guard, heat
from limb_systems import Limb, LimbParameters, LinearLaw, SegmentParameters, TwoMassLaw, simulate
from limb_systems.heat_bounds import HeatBounds


def one_link(**rates) -> LimbParameters:
    """Return a limb with other rates of both wires, which is simulated fast."""
    limb = LimbParameters(segments=[SegmentParameters(links=1)])
    for wire in limb.wires:
        wire.law = LinearLaw(**rates)
    return limb


def test_host_and_board_have_the_same_ranges_and_nominal_bounds():
    """The board cannot import the host's."""
    ranges = [field.metadata["range"] for field in dataclasses.fields(HeatBounds)]
    assert ranges == list(heat.RANGES)
    nominal = HeatBounds.around(LimbParameters().wires[0].law)
    for bounds in (HeatBounds(), nominal):
        np.testing.assert_allclose(dataclasses.astuple(bounds), heat.NOMINAL_BOUNDS, rtol=3e-3)


def test_bounds_of_a_limb_contain_its_other_motions():
    """Of the nominal limb, in closed form: T - T0 = a2 D / a1 (1 - exp(-a1 t)), (6)."""
    limb = one_link()
    described = HeatBounds.around(limb.wires[0].law)
    recording = simulate(Limb(limb), [0.0, 0.3], 30.0)
    left, fitted = fit_heat_bounds([recording], limb)
    assert left == described  # which was not heated
    assert fitted.slowest_cooling > described.slowest_cooling
    assert fitted.least_heating > described.least_heating
    assert fitted.most_heating >= described.most_heating
    observer = heat.WireObserver(0.0)
    observer.bounds = dataclasses.astuple(fitted)
    for time in np.arange(0.05, 12.0, 0.05):
        observer.advance(0.45, 0.05, 0.0)
        wire = 20.0 * 0.45 / 0.07 * (1 - np.exp(-0.07 * time))
        assert observer.least_reading < wire < observer.most + 0.5
    _, wide = fit_heat_bounds([recording], limb, 0.25)
    assert wide.least_heating < fitted.least_heating
    assert wide.slowest_cooling < fitted.slowest_cooling


def test_bounds_around_a_law_contain_wires_in_warm_silicone():
    """From cold to a lasting heat, and while it cools."""
    limb = one_link()
    limb.wires[1].law = TwoMassLaw()
    duty = PiecewisePolynomial.ZeroOrderHold([0.0, 90.0, 180.0], [[0.0, 0.0, 0.0], [0.2, 0, 0]])
    recording = simulate(Limb(limb), duty, 180.0)
    observer = heat.WireObserver(0.0)
    observer.bounds = dataclasses.astuple(limb.heat_bounds[1])
    step = recording.time[1]
    for applied, wire in zip(recording.duty[1], recording.wire_temperature[1, 1:], strict=False):
        observer.advance(applied, step, 0.0)
        assert observer.least_reading < wire - 25.0 < observer.most + 0.5


def test_an_emulated_limb_is_warmed_up_and_then_hot_within_its_bounds():
    parameters = one_link()
    warm_up = collect_warm_up(LimbTwin(parameters, seed=7))
    assert warm_up.measured_temperature.max() < 100.0
    fitted = fit_heat_bounds([warm_up], parameters, WARM_UP_MARGIN)
    for wire, bounds in zip(parameters.wires, fitted, strict=True):
        wire.heat_bounds = bounds
    board = SimulatedBoard(LimbTwin(parameters, seed=7), parameters, step=25)
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
        assert board.reason == guard.NO_REASON
    assert hottest > 80.0


def showing(recording, share):
    """The recording, had the left thermocouple shown a share of its rise."""
    rise = recording.measured_temperature - 25.0
    shares = np.array([[share], [1.0]])
    return dataclasses.replace(recording, measured_temperature=25.0 + shares * rise)


@pytest.mark.parametrize("heating", [20.0, 40.0])
def test_a_thermocouple_that_shows_a_share_lets_no_wire_be_hotter(heating):
    """Also where the limb heats more than described: then the other wire tells by how much."""
    recording = simulate(Limb(one_link(a2=heating)), [0.1, 0.1], 60.0)
    for share in (0.5, 0.75):
        left, right = fit_heat_bounds([showing(recording, share)], LimbParameters())
        for bounds in (left, right):
            assert bounds.most_heating > heating
            assert bounds.slowest_cooling <= 0.07
        around = LimbParameters().heat_bounds[0]
        assert left.slowest_cooling <= 1.75 * around.slowest_cooling


@pytest.mark.parametrize(
    "rates", [{"a1": -0.03, "a2": 65.0, "a3": -0.3}, {"a1": -0.09, "a2": 10.0, "a3": -0.11}]
)
def test_first_contact_takes_in_any_limb(rates):
    """Of the published ends of all rates: it stays cool, within the bounds, then is known."""
    limb = Limb(one_link(**rates))
    recording = collect_first_contact(limb)
    careful = limb_for_first_contact(LimbParameters())
    assert careful.total_duty == 0.3
    check_first_contact(recording, LimbParameters(), Path("first_contact.csv"))
    fitted = fit_heat_bounds([recording], LimbParameters(), CONTACT_MARGIN)
    wires = zip(recording.duty, recording.wire_temperature, strict=True)
    for wire, (duty, temperature) in enumerate(wires):
        assert temperature.max() < 80.0
        observer = heat.WireObserver(0.0)
        observer.bounds = dataclasses.astuple(careful.heat_bounds[wire])
        for applied, true, read in zip(
            duty, temperature[1:], recording.measured_temperature[wire, 1:], strict=False
        ):
            observer.advance(applied, 0.05, read - 25.0)
            assert true - 25.0 < observer.most + 0.5
            assert observer.shortfall < guard.MAX_SHORTFALL
        assert fitted[wire].slowest_cooling < -rates["a1"] < fitted[wire].fastest_cooling
        assert fitted[wire].least_heating < rates["a2"] < fitted[wire].most_heating
        assert fitted[wire].slowest_reading < -rates["a3"]


def test_the_slowest_cooling_of_bounds_is_at_most_what_a_thermocouple_can_show():
    """A fifth of its own rate, if that is between the kind's slowest cooling and 1.75 times it."""
    kind = HeatBounds.around(LinearLaw())
    for reading, slowest in ((5.0, 1.75 * kind.slowest_cooling), (0.3, 0.3 / 5)):
        bounds = HeatRates(20.0, 0.4, reading).bounds(kind, max_heating=20.0, margin=0.0)
        assert bounds.slowest_cooling == pytest.approx(slowest)


def test_a_thermocouple_without_its_wire_is_found_at_first_contact():
    recording = showing(collect_first_contact(Limb(one_link())), 0.05)
    with pytest.raises(CalibrationError, match="left wire was heated, but its thermocouple shows"):
        check_first_contact(recording, LimbParameters(), Path("first_contact.csv"))


def test_what_is_unlike_the_other_wire_or_the_description_is_told():
    nominal = one_link()
    duty = [0.2, 0.2]
    recording = simulate(Limb(nominal), duty, 60.0)
    assert heat_remarks([recording], nominal) == []
    late = simulate(Limb(one_link(a3=-0.2)), duty, 60.0)
    for side, remark in zip(("left", "right"), heat_remarks([late], nominal), strict=True):
        assert remark.startswith(f"the {side} thermocouple lags by 5 s")
    (remark,) = heat_remarks([showing(recording, 0.5)], nominal)
    assert remark.startswith("the left wire shows 50% of the heat of the wire that shows most")
    weak = simulate(Limb(one_link(a2=10.0)), duty, 60.0)
    (remark,) = heat_remarks([weak], nominal)
    assert remark.startswith("the wires show 50% of the heat that their description says")
    assert remark.endswith("describe the wires by a2 10 and 10 °C/s.")
