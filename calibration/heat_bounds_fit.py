"""Bounds for the board: the rates of heating and cooling that enclose all readings."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calibration.remarks import CalibrationError
from hardware.board.heat_rates import (
    HeatRates,
    detectable_bounds,
    first_order_lag,
    fit_heat_rates,
    interpolate_gaps,
)
from hardware.firmware import heat
from limb_systems import LimbError, LimbParameters, LinearLaw, Recording
from limb_systems.heat_bounds import ANY_WIRE_BOUNDS, RATE_FACTORS, HeatBounds

BOUNDS_MARGIN = 0.1  # share by which bounds are widened: other motions show somewhat more
READING_NOISE = 1.0  # °C that readings may be below their bounds
MIN_READING_RATE = 0.3  # 1/s, of a thermocouple that is badly bonded
MIN_HEAT_SHARE = 0.7  # share of another wire's heat, below which a thermocouple may be wrong
MIN_FULL_DUTY_TIME = 1.0  # s at full duty, from which on heat tells a rate


def fit_heat_bounds(
    recordings: Iterable[Recording], described: LimbParameters, margin: float = BOUNDS_MARGIN
) -> list[HeatBounds]:
    """Return the bounds of each wire (W) that readings allow, as the board looks at them.

    The least heating comes from the lowest readings. The other bounds are those around the
    rates with which the wire is seen to heat, cool and be read; see `HeatRates.bounds`.

    Args:
        recordings: heated ones, each of a limb that was cold at the beginning.
        described: the kind of limb; bounds that it was given by an earlier fit do not count.
        margin: share by which the fitted rates are widened.

    Returns:
        bounds; those described for a wire that was not heated.
    """
    wires = _wires(recordings, described)
    max_heating = max((wire.rates.heating for wire in wires if wire.rates), default=0.0)
    return [
        _fit_wire(wire, wire.rates, max_heating, margin) if wire.rates else wire.kind
        for wire in wires
    ]


def check_first_contact(recording: Recording, described: LimbParameters, path: Path) -> None:
    """Check that each thermocouple showed its wire's heat.

    Args:
        recording: a recording by `collect_first_contact`, in the file ``path``.
        described: the kind of limb.

    Raises:
        CalibrationError: if one did not.
    """
    for wire in _wires([recording], described):
        min_heating = min(wire.kind.least_heating, ANY_WIRE_BOUNDS.least_heating)
        if wire.rates and wire.rates.heating < min_heating:
            raise CalibrationError(
                f"The {wire.name} wire was heated, but its thermocouple shows "
                f"{wire.rates.heating:.1f} °C/s at full duty. Either it is off its wire, reversed "
                "or badly bonded, or the wire gets hardly any heat. Mend that or, if the limb is "
                f"like that, describe its wires by their a2; then delete {path} and collect again."
            )


def heat_remarks(recordings: Iterable[Recording], described: LimbParameters) -> list[str]:
    """Return sentences on wires or thermocouples that differ from the others or their kind.

    Args:
        recordings, described: as for `fit_heat_bounds`.
    """
    # Compute the heat of each wire as a share of the heat that its description says.
    heated_wires = []
    for wire in _wires(recordings, described):
        if wire.rates:
            share_of_most = wire.rates.heating / wire.kind.most_heating
            heated_wires.append((wire, wire.rates, share_of_most * RATE_FACTORS["most_heating"]))
    # Compare the wires with each other.
    largest_share = max((share for _, _, share in heated_wires), default=np.inf)
    remarks = []
    for wire, rates, share in heated_wires:
        if rates.reading < MIN_READING_RATE:
            remarks.append(
                f"the {wire.name} thermocouple lags by {1 / rates.reading:.0f} s: it is badly "
                "bonded, so bond it anew."
            )
        if share < MIN_HEAT_SHARE * largest_share:
            remarks.append(
                f"the {wire.name} wire shows {share / largest_share:.0%} of the heat of the wire "
                "that shows most. Either its thermocouple shows a share of its rise, or it gets "
                "less heat than the other: compare their resistances, and bond the thermocouple "
                "anew. The board heats it as if the thermocouple were wrong."
            )
    # Compare all wires with their description.
    if largest_share < RATE_FACTORS["least_heating"]:
        remarks.append(
            f"the wires show {largest_share:.0%} of the heat that their description says, at "
            "most. Either all thermocouples show a share of their rise, or the limb is unlike its "
            "description: the board will keep it cooler than it needs to be. If you are sure of "
            "the thermocouples, describe the wires by a2 "
            + " and ".join(f"{rates.heating:.3g}" for _, rates, _ in heated_wires)
            + " °C/s."
        )
    return remarks


class _Wire(NamedTuple):
    """A wire, bounds around its law, what it did in recordings, and its rates if it was heated."""

    name: str
    kind: HeatBounds
    courses: list["_WireHeat"]
    rates: HeatRates | None


def _wires(recordings: Iterable[Recording], limb: LimbParameters) -> list[_Wire]:
    """Return the wires of a limb (W) with their heat in recordings."""
    recordings = list(recordings)
    wires = []
    for index, wire in enumerate(limb.wires):
        try:
            kind = HeatBounds.around(LinearLaw() if limb.calibration else wire.law)
        except LimbError:
            if not wire.heat_bounds:
                raise
            kind = wire.heat_bounds
        courses = [_WireHeat(each, index) for each in recordings if each.has_thermocouple[index]]
        rates = fit_heat_rates([(course.duty, course.rise, course.interval) for course in courses])
        wires.append(_Wire(wire.name, kind, courses, rates))
    return wires


def _fit_wire(wire: _Wire, rates: HeatRates, max_heating: float, margin: float) -> HeatBounds:
    """Return the bounds of a wire; ``max_heating`` is the largest heating of all wires, °C/s."""
    kind = wire.kind
    bounds = rates.bounds(kind, max_heating, margin)
    # The least heating is low enough for all readings.
    share = rates.heating / kind.least_heating
    for course in wire.courses:
        # It is proportional to the least heating.
        least_rises = course.least(dataclasses.replace(bounds, least_heating=kind.least_heating))
        is_heated = least_rises > MIN_FULL_DUTY_TIME * kind.least_heating
        shares = (course.averaged + READING_NOISE)[is_heated] / least_rises[is_heated]
        share = min(share, float(shares.min(initial=np.inf)))
    # A limb that heats as it is described keeps that bound at least.
    share = max(share * (1 - margin), 1.0 if share > 1.0 else 0.0)
    low, high = HeatBounds.__dataclass_fields__["least_heating"].metadata["range"]
    heating = min(max(share * kind.least_heating, low), high, bounds.most_heating)
    return detectable_bounds(dataclasses.replace(bounds, least_heating=float(heating)))


class _WireHeat:
    """A recording of a wire in steps of the board's observer.

    - ``duty``: duty in each step (K).
    - ``rise``: reading above the cold wire's reading, after each step (K), °C.
    - ``averaged``: the rise as the board averages it (K), °C.
    - ``interval``: duration of a step, s.
    """

    def __init__(self, recording: Recording, wire: int):
        applied = recording.heating_duty
        readings = interpolate_gaps(recording.measured_temperature[wire])
        start = readings[recording.time < recording.time[0] + heat.AVERAGING_TIME].mean()
        stride = max(1, round(heat.LONGEST_STEP * recording.sample_rate))
        # What is applied from one sample to the next, and read at the end of a step.
        starts = np.arange(0, len(readings) - 1, stride)
        self.duty = np.add.reduceat(applied[wire, :-1], starts) / stride
        self.interval = stride / recording.sample_rate
        self.rise = readings[np.minimum(starts + stride, len(readings) - 1)] - start
        self.averaged = first_order_lag(self.rise, 1 / heat.AVERAGING_TIME, self.interval)

    def least(self, bounds: HeatBounds) -> np.ndarray:
        """Return the least rise that is read, averaged (K), °C."""
        observer = heat.WireObserver(0.0)
        observer.bounds = dataclasses.astuple(bounds)
        least = []
        for duty in self.duty.tolist():
            observer.advance(duty, self.interval, 0.0)
            least.append(observer.least_reading)
        return first_order_lag(np.array(least), 1 / heat.AVERAGING_TIME, self.interval)
