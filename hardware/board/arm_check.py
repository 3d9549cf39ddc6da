"""The check of sensors and wires, one by one, before a robot is trusted with a plan."""

from collections.abc import Callable, Sequence

import numpy as np

from hardware.board.heat_rates import (
    HeatRates,
    fit_heat_rates,
    interpolate_gaps,
    unit_temperature_rise,
)
from hardware.board.link import (
    BoardLink,
    Sample,
    check_fit,
    check_heat_is_measured,
    shares_of,
)
from limb_systems import LimbError, LimbModel, LimbParameters, bend_angle_from_tip_tangent
from limb_systems.heat_bounds import RATE_FACTORS
from limb_systems.simulation import PERIOD

COLD_RANGE = (5.0, 45.0)  # °C, readings of cold wires
MAX_REST_BEND_DEG = 30.0  # largest bend of a limb at rest
MIN_RISE = 3.0  # °C, smallest rise that counts as heat
# First each wire is warmed by some degrees, which any limb bears, then until the limb bends.
# The numbers are duty, longest time (s), rise (°C) and largest sum of duties.
CONTACT_DUTY, CONTACT_TIME, CONTACT_RISE, CONTACT_TOTAL = 0.1, 30.0, 10.0, 0.3
BEND_DUTY, BEND_TIME, BEND_RISE = 0.2, 20.0, 45.0
REST_TIME = 15.0  # s after each heating, to cool and for the thermocouple's lag
BOUNDS_MARGIN = 0.5  # share by which bounds are wider than the rates of the first heating
MIN_BEND = np.deg2rad(1.0)  # smallest bend that counts
COMPARISON_BEND = np.deg2rad(6.0)  # bend at which wires are compared
MIN_LIKENESS = 0.75  # smallest ratio between two thermocouples of a segment, for like heat
MISMATCH_ADVICE = (
    "Either its thermocouple shows a share of its rise, or its wire gets less heat or bends more "
    "than another. Bond the thermocouple anew, and compare resistances and thermocouples' types."
)

# Accepted heat of a supply, over its heat at the calibration; heat goes with voltage squared.
SAME_HEAT_RANGE = RATE_FACTORS["least_heating"], RATE_FACTORS["most_heating"]
CUT_OFF_ADVICE = (
    "only a thermal cut-off in series with the wires helps against two faults at once, such as "
    "twice the heat and a thermocouple that shows 60% of it, which the board cannot see "
    "(docs/robot.md)"
)

Report = Callable[[bool, str], None]  # takes whether something is good, and a sentence
# Samples while a wire is heated: duty (K, W), V (K, W), °C, and the bend to its own side (K), rad.
Heating = tuple[np.ndarray, np.ndarray, np.ndarray]


def check_supply(
    parameters: LimbParameters, voltage: float | None, cut_off: bool | None
) -> list[tuple[bool, str]]:
    """Check that the supply may heat wires: a person has to say so, and no answer is a no.

    Args:
        parameters: the limb's description, whose ``supply_voltage`` it is compared with.
        voltage: measured voltage of the supply, V; None if nobody answered.
        cut_off: whether a thermal cut-off is in series with the wires; None if nobody answered.

    Returns:
        For the voltage and for the cut-off, whether it is good, and a sentence. Wires may be heated
        if both are good.

    Raises:
        LimbError: if the voltage is no positive number.
    """
    # The voltage must be given. If the limb was calibrated, it must be the voltage from then.
    if voltage is None:
        voltage_check = (
            False,
            "nobody has said which voltage the wires' supply has, and heat goes with its square: "
            "measure it, and give --supply VOLTS",
        )
    elif not 0.1 <= voltage <= 1000.0:
        raise LimbError(f"The supply's voltage is {voltage:g} V; it must be from 0.1 to 1000 V.")
    else:
        voltage_check = _check_voltage(voltage, parameters.supply_voltage)
    # A cut-off must be there.
    sentence = "a thermal cut-off is on the limb"
    if cut_off is None:
        sentence = (
            "nobody has said that a thermal cut-off is on the limb, in series with its wires; give "
            f"--cut-off if there is one: {CUT_OFF_ADVICE}"
        )
    elif not cut_off:
        sentence = f"no cut-off: {CUT_OFF_ADVICE}"
    return [voltage_check, (bool(cut_off), sentence)]


def _check_voltage(voltage: float, calibrated_voltage: float) -> tuple[bool, str]:
    """Return whether a supply heats as during the calibration, and a sentence; voltages in V."""
    measured = f"the supply has {voltage:.3g} V"
    if not calibrated_voltage:
        advice = f"write supply_voltage: {voltage:g} into the limb's file to compare"
        return True, f"{measured}; {advice}"
    heat_ratio = (voltage / calibrated_voltage) ** 2
    lowest, highest = SAME_HEAT_RANGE
    is_good = lowest <= heat_ratio <= highest
    sentence = (
        f"{measured}, and {calibrated_voltage:.3g} V when the limb was calibrated: "
        f"{heat_ratio:.0%} of its heat, where {lowest:.0%} to {highest:.0%} are accepted"
    )
    if not is_good:
        sentence += f"; set it to {calibrated_voltage:.3g} V, or calibrate anew"
    return is_good, sentence


def check_wires(link: BoardLink, report: Report, parameters: LimbParameters | None = None) -> bool:
    """Return whether sensors are alive and each wire does its job.

    Each wire is warmed by some degrees, with a little duty and bounds for any limb. It must warm
    its own thermocouple, more than any other. Then each wire is heated until the limb bends, with
    bounds around the rates of the first heating. The limb must bend to the wire's own side. The
    readings of a thermocouple, for the heat and for the bend, must be like those from the others
    in its segment. The board is disarmed at the end.

    Args:
        link: connection to the board.
        report: takes whether it was good, and a sentence, for each thing that was looked at.
        parameters: the limb's description; the nominal limb if None.

    Raises:
        HardwareError: if the limb was calibrated without thermocouples, or the board fails on
            the way.
        LimbError: if the board has not as many channels as the limb has wires.
    """
    parameters = parameters or LimbParameters()
    check_heat_is_measured(parameters)
    names = parameters.wire_names
    verdicts: list[bool] = []

    def add(is_good: bool, sentence: str) -> None:
        verdicts.append(bool(is_good))  # not numpy's
        report(verdicts[-1], sentence)

    # Look at the sensors of the cold limb.
    info = link.info()
    check_fit(parameters, info, link.port)
    add(True, f"board {info.serial_number} answers, firmware {info.firmware_version}")
    _check_cold_sensors(names, [link.next_sample() for _ in range(10)], add)
    if not all(verdicts):
        return False

    sides = shares_of(parameters).T  # (W, F), share of each wire's torque that turns each bend
    kinds = parameters.heat_bounds
    wires = range(len(names))
    try:
        # Warm each wire by some degrees.
        total_duty = min(CONTACT_TOTAL, parameters.total_duty)
        link.arm([kind.widened_to_any_wire() for kind in kinds], total_duty)
        contact_limits = CONTACT_DUTY, CONTACT_TIME, CONTACT_RISE, np.inf
        contacts = [_heat_wire(link, wire, sides[wire], contact_limits) for wire in wires]
        link.disarm()
        _check_contacts(names, contacts, add)
        if not all(verdicts):
            return False
        # Fit the bounds to this heating, and let the limb rest.
        rates = [_fit_rates([contact], wire) for wire, contact in enumerate(contacts)]
        max_heating = max(rate.heating for rate in rates)
        bounds = [rates[wire].bounds(kinds[wire], max_heating, BOUNDS_MARGIN) for wire in wires]
        for _ in range(round(REST_TIME / PERIOD)):
            link.next_sample()
        # Heat each wire until the limb bends.
        link.arm(bounds, parameters.total_duty)
        bend_limits = BEND_DUTY, BEND_TIME, BEND_RISE, COMPARISON_BEND
        bends = [_heat_wire(link, wire, sides[wire], bend_limits) for wire in wires]
    finally:
        link.disarm()

    # Judge direction and heat of each wire, then compare the wires of each segment.
    for name, (_, _, bend) in zip(names, bends, strict=True):
        largest = _bend_change(bend).max()
        sentence = f"{name} wire bends the limb by {np.rad2deg(largest):.1f}° to its own side"
        add(largest > MIN_BEND, sentence)
    rates = [_fit_rates([contacts[wire], bends[wire]], wire) for wire in wires]
    heating = [rate.heating for rate in rates]
    most_heating = [kind.most_heating for kind in kinds]
    _check_heat(names, heating, most_heating, add)
    if all(verdicts):
        for around in LimbModel.of(parameters).layout.wires_of:
            _check_likeness(names[around], rates[around], bends[around], add)
    return all(verdicts)


def _check_cold_sensors(names: Sequence[str], samples: Sequence[Sample], add: Report) -> None:
    """Check that wires are read as cold and the limb as nearly straight."""
    temperatures = np.nanmean(_stacked(samples, "temperature"), axis=0)
    lowest, highest = COLD_RANGE
    for name, temperature in zip(names, temperatures, strict=True):
        is_cold = lowest <= temperature <= highest
        accepted = f"cold wires have {lowest:g} to {highest:g} °C"
        advice = "" if is_cold else ": let them cool, or look at its type and poles"
        add(is_cold, f"{name} thermocouple reads {temperature:.1f} °C; {accepted}{advice}")
    bends = bend_angle_from_tip_tangent(_stacked(samples, "tip_tangent"))
    for bend_deg in np.rad2deg(bends.mean(axis=0)):
        accepted = f"{MAX_REST_BEND_DEG:g}° are accepted"
        sentence = f"bend sensor reads {bend_deg:+.1f}° at rest, where {accepted}"
        add(abs(bend_deg) <= MAX_REST_BEND_DEG, sentence)


def _check_contacts(names: Sequence[str], contacts: Sequence[Heating], add: Report) -> None:
    """Check that each wire warms its own thermocouple, and more than any other."""
    for wire, (name, (_, temperatures, _)) in enumerate(zip(names, contacts, strict=True)):
        rises = temperatures - temperatures[:5].mean(axis=0)
        warmest = np.argmax(rises[:, wire])
        own_rise = rises[warmest, wire]
        largest_other_rise = np.delete(rises[warmest], wire).max(initial=0.0)
        add(
            own_rise > MIN_RISE and own_rise > 2 * largest_other_rise,
            f"{name} wire warms its own thermocouple by {own_rise:.1f} °C, another by "
            f"{largest_other_rise:.1f} °C",
        )


def _check_heat(
    names: Sequence[str], heating: Sequence[float], most_heating: Sequence[float], report: Report
) -> None:
    """Check that each wire heats as its description says, °C/s at full duty.

    ``most_heating`` is the upper bound of each wire's kind, `RATE_FACTORS` above its description.
    """
    # Short, cool heatings measure heat no better than wires of one kind differ. The numbers are
    # rounded as they are printed, so that no verdict disagrees with its sentence.
    least_share, most_share = SAME_HEAT_RANGE
    lowest = [round(bound * least_share**2 / most_share, 1) for bound in most_heating]
    highest = [round(bound / least_share, 1) for bound in most_heating]
    heating = [round(float(rate), 1) for rate in heating]
    is_low = [rate < low for rate, low in zip(heating, lowest, strict=True)]
    # If one wire alone is low, its thermocouple is suspect; else the description is.
    for wire, name in enumerate(names):
        sentence = (
            f"{name} wire shows {heating[wire]:.1f} °C/s at full duty, where {lowest[wire]:.1f} to "
            f"{highest[wire]:.1f} are accepted for its description"
        )
        if lowest[wire] <= heating[wire] <= highest[wire]:
            report(True, sentence)
        elif is_low[wire] and not all(is_low):
            report(False, f"{sentence}, and another one shows that. {MISMATCH_ADVICE}")
        else:
            report(
                False,
                f"{sentence}: the limb is unlike its description, or all thermocouples are wrong; "
                f"if you are sure of them, describe the wire by a2: {heating[wire]:.1f}",
            )


def _check_likeness(
    names: Sequence[str], rates: Sequence[HeatRates], bends: Sequence[Heating], report: Report
) -> None:
    """Check that the thermocouples of a segment show the like for the like heat and bend."""
    heating = np.array([rate.heating for rate in rates])
    # The rise of each wire at the same bend is another, independent witness.
    rises_at_bend = np.full(len(rates), np.nan)
    for wire, (rate, (duty, _, bend)) in enumerate(zip(rates, bends, strict=True)):
        rise = rate.heating * unit_temperature_rise(duty.sum(axis=1), rate.cooling, 0.3, PERIOD)
        bent_at = np.argmax(_bend_change(bend) >= COMPARISON_BEND)  # 0 if never
        if bent_at:
            rises_at_bend[wire] = rise[bent_at]
    all_bent = not np.isnan(rises_at_bend).any()
    witness = np.sqrt(heating * rises_at_bend) if all_bent else heating
    # Compare the thermocouple that shows least with the thermocouple that shows most.
    ratio = witness.min() / witness.max()
    least = names[int(witness.argmin())]
    most = names[int(witness.argmax())]
    sentence = (
        f"{least} thermocouple shows {ratio:.0%} of what the {most} one does for the same heat"
        + " and bend" * all_bent
    )
    is_alike = ratio > MIN_LIKENESS
    report(is_alike, sentence if is_alike else f"{sentence}. {MISMATCH_ADVICE}")


def _bend_change(bend: np.ndarray) -> np.ndarray:
    """Return the change of a bend angle (K), rad, since a heating began."""
    return bend - bend[:5].mean()


def _fit_rates(heatings: Sequence[Heating], wire: int) -> HeatRates:
    """Return the rates of a wire that was heated one or several times."""
    wire_heatings = []
    for duty, temperature, _ in heatings:
        rise = temperature[:, wire] - temperature[:5, wire].mean()
        wire_heatings.append((duty[1:, wire], rise[1:], PERIOD))
    rates = fit_heat_rates(wire_heatings)
    assert rates  # it was heated
    return rates


def _heat_wire(link: BoardLink, wire: int, side: np.ndarray, limits: Sequence[float]) -> Heating:
    """Heat a wire until its reading has risen or the limb has bent, and let it rest.

    ``side`` (F,) is the share of the wire's torque that turns each bend angle. ``limits`` are the
    duty, the longest time, s, the rise, °C, and the bend, rad.
    """
    duty, longest, max_rise, max_bend = limits
    samples = [link.next_sample()]
    cold = samples[0].temperature[wire]
    commanded = duty * np.eye(len(samples[0].duty))[wire]
    while (elapsed := len(samples) * PERIOD) < longest + REST_TIME:
        link.command(commanded)
        samples.append(link.next_sample())
        turned = samples[-1].tip_tangent - samples[0].tip_tangent
        bend = side @ bend_angle_from_tip_tangent(turned)
        reading = samples[-1].temperature[wire]
        cold = reading if np.isnan(cold) else cold  # the first reading was bad
        # Switch off, and let it rest, as soon as a limit is reached.
        if elapsed >= longest or reading - cold >= max_rise or abs(bend) >= 1.2 * max_bend:
            commanded = np.zeros_like(commanded)
            longest = min(longest, elapsed)
    temperatures = np.apply_along_axis(interpolate_gaps, 0, _stacked(samples, "temperature"))
    bends = bend_angle_from_tip_tangent(_stacked(samples, "tip_tangent"))
    return _stacked(samples, "duty"), temperatures, bends @ side


def _stacked(samples: Sequence[Sample], name: str) -> np.ndarray:
    """Return an attribute of all samples, in rows."""
    return np.array([getattr(sample, name) for sample in samples])
