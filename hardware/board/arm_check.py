"""The check of sensors and wires, one by one, before a robot is trusted with a plan."""

from collections.abc import Callable, Sequence

import numpy as np

from hardware.board.heat_rates import HeatRates, fit_heat_rates, warmth, without_gaps
from hardware.board.link import BoardLink, check_fit, shares_of
from limb_systems import LimbError, LimbModel, LimbParameters, bend_angle_from_tip_tangent
from limb_systems.heat_bounds import RATE_FACTORS
from limb_systems.simulation import PERIOD

COLD = (5.0, 45.0)  # °C, that cold wires may have
MOST_REST = 30.0  # degrees, that a limb at rest may be bent
RISE = 3.0  # °C, at least, that is heat
# First any limb is warmed by some degrees, then as far as it takes to bend it.
CONTACT_DUTY, CONTACT_TIME, CONTACT_RISE, CONTACT_TOTAL = 0.1, 30.0, 10.0, 0.3  # s and °C
BEND_DUTY, BEND_TIME, BEND_RISE = 0.2, 20.0, 45.0
REST = 15.0  # s after each of these, for the thermocouple's lag, and to cool
MARGIN = 0.5  # share by which bounds are wider than what the first degrees showed
BEND, ENOUGH_BEND = np.deg2rad(1.0), np.deg2rad(6.0)  # at least, and to compare wires by
ALIKE = 0.75  # share of what another wire shows for its heat and its bend, at least
WHAT_TO_DO = (
    "Either its thermocouple shows a share of its rise, or its wire gets less heat or bends more "
    "than another. Bond the thermocouple anew, and compare resistances and thermocouples' types."
)

SAME_HEAT = (
    RATE_FACTORS["least_heating"],
    RATE_FACTORS["most_heating"],
)  # of a supply, by its voltage squared
CUT_OFF = (
    "only a thermal cut-off in series with the wires helps against two faults at once, such as "
    "twice the heat and a thermocouple that shows 60% of it, which the board cannot see "
    "(docs/robot.md)"
)

# Samples while a wire is heated: duty (K, W), V (K, W), °C, and the bend to its own side (K), rad.
Heating = tuple[np.ndarray, np.ndarray, np.ndarray]


def check_supply(
    parameters: LimbParameters,
    voltage: float | None,
    cut_off: bool | None,
    say: Callable[[bool, str], None],
) -> bool:
    """Return whether the supply may heat wires: a person has to say so, and no answer is a no.

    Args:
        parameters: the limb's description, whose ``supply_voltage`` it is compared with.
        voltage: measured voltage of the supply, V; None if nobody answered.
        cut_off: whether a thermal cut-off is in series with the wires; None if nobody answered.
        say: takes whether it is good, and a sentence.

    Raises:
        LimbError: if the voltage is no positive number.
    """
    # The voltage must be known, and that of the calibration, if there was one.
    if voltage is None:
        is_voltage_good = False
        say(
            False,
            "nobody has said which voltage the wires' supply has, and heat goes with its square: "
            "measure it, and give --supply VOLTS",
        )
    else:
        if not 0.1 <= voltage <= 1000.0:
            raise LimbError(
                f"The supply's voltage is {voltage:g} V; it must be from 0.1 to 1000 V."
            )
        is_voltage_good = _judge_voltage(voltage, parameters.supply_voltage, say)
    # A cut-off must be there.
    if cut_off:
        say(True, "a thermal cut-off is on the limb")
    elif cut_off is None:
        say(
            False,
            "nobody has said that a thermal cut-off is on the limb, in series with its wires; give "
            f"--cut-off if there is one: {CUT_OFF}",
        )
    else:
        say(False, f"no cut-off: {CUT_OFF}")
    return is_voltage_good and bool(cut_off)


def _judge_voltage(voltage: float, calibrated: float, say: Callable[[bool, str], None]) -> bool:
    """Return whether a supply gives the heat of the calibration, at whose voltage, V, it was."""
    measured = f"the supply has {voltage:.3g} V"
    if not calibrated:
        say(
            True,
            f"{measured}; write supply_voltage: {voltage:g} into the limb's file to compare",
        )
        return True
    heat = (voltage / calibrated) ** 2
    is_good = SAME_HEAT[0] <= heat <= SAME_HEAT[1]
    what = (
        f"{measured}, and {calibrated:.3g} V when the limb was calibrated: {heat:.0%} of its heat, "
        f"where {SAME_HEAT[0]:.0%} to {SAME_HEAT[1]:.0%} are accepted"
    )
    say(is_good, what if is_good else f"{what}; set it to {calibrated:.3g} V, or calibrate anew")
    return is_good


def check_wires(
    link: BoardLink, say: Callable[[bool, str], None], parameters: LimbParameters | None = None
) -> bool:
    """Whether sensors are alive and each wire does what it should.

    Each wire is warmed by some degrees, with a little duty and bounds for any limb. It must warm
    its own thermocouple, more than any other. Then, with bounds around what that showed, each
    is heated until the limb bends: it must do so to the wire's own side. What a thermocouple shows
    for the heat, and for the bend, must be like that of others in its segment. The board is
    disarmed at the end.

    Args:
        link: connection to the board.
        say: takes whether it was good, and a sentence, for each thing that was looked at.
        parameters: the limb's description; the nominal limb if None.

    Raises:
        HardwareError: if the board fails on the way.
        LimbError: if the board has not as many channels as the limb has wires.
    """
    passed, parameters = True, parameters or LimbParameters()
    names = parameters.wire_names

    def judge(good: bool, what: str) -> None:
        nonlocal passed
        good = bool(good)  # not numpy's
        passed = passed and good
        say(good, what)

    info = link.info()
    check_fit(parameters, info, link.port)
    judge(True, f"board {info.serial_number} answers, firmware {info.firmware_version}")
    samples = [link.next_sample() for _ in range(10)]
    for side, V in zip(names, np.nanmean([s.temperature for s in samples], axis=0), strict=True):
        is_cold = COLD[0] <= V <= COLD[1]
        what = (
            f"{side} thermocouple reads {V:.1f} °C; cold wires have {COLD[0]:g} to {COLD[1]:g} °C"
        )
        judge(is_cold, what if is_cold else f"{what}: let them cool, or look at its type and poles")
    bends = np.mean([bend_angle_from_tip_tangent(s.tip_tangent) for s in samples], axis=0)
    for bend in bends:
        degrees = np.rad2deg(bend)
        what = f"bend sensor reads {degrees:+.1f}° at rest, where {MOST_REST:g}° are accepted"
        judge(abs(degrees) <= MOST_REST, what)
    towards = shares_of(parameters).T

    def heat(*how: float) -> list[Heating]:
        return [_heat(link, wire, towards[wire], how) for wire in range(len(names))]

    if not passed:
        return False
    kinds = parameters.heat_bounds
    try:
        total = min(CONTACT_TOTAL, parameters.total_duty)
        link.arm([kind.widened_to_any_wire() for kind in kinds], total)
        contacts = heat(CONTACT_DUTY, CONTACT_TIME, CONTACT_RISE, np.inf)
        link.disarm()
        for wire, (side, (_, temperatures, _)) in enumerate(zip(names, contacts, strict=True)):
            rise = temperatures - temperatures[:5].mean(axis=0)
            warmest = np.argmax(rise[:, wire])
            own = rise[warmest, wire]
            other = np.delete(rise[warmest], wire).max(initial=0.0)
            judge(
                own > RISE and own > 2 * other,
                f"{side} wire warms its own thermocouple by {own:.1f} °C, another by "
                f"{other:.1f} °C",
            )
        if not passed:
            return False
        rates = [_rates([contact], wire) for wire, contact in enumerate(contacts)]
        hottest = max(rate.heating for rate in rates)
        for _ in range(round(REST / PERIOD)):
            link.next_sample()
        link.arm(
            [rate.bounds(kind, hottest, MARGIN) for rate, kind in zip(rates, kinds, strict=True)],
            parameters.total_duty,
        )
        bent = heat(BEND_DUTY, BEND_TIME, BEND_RISE, ENOUGH_BEND)
    finally:
        link.disarm()
    for side, (_, _, bend) in zip(names, bent, strict=True):
        degrees = np.rad2deg(_change(bend).max())
        judge(
            degrees > np.rad2deg(BEND),
            f"{side} wire bends the limb by {degrees:.1f}° to its own side",
        )
    rates = [
        _rates(heatings, wire) for wire, heatings in enumerate(zip(contacts, bent, strict=True))
    ]
    heating, most = [rate.heating for rate in rates], [kind.most_heating for kind in kinds]
    _judge_heat(names, heating, most, judge)
    if passed:
        for around in LimbModel.of(parameters).layout.wires_of:
            _judge_likeness(names[around], rates[around], bent[around], judge)
    return passed


def _judge_heat(
    names: Sequence[str],
    heating: Sequence[float],
    most: Sequence[float],
    judge: Callable[[bool, str], None],
) -> None:
    """Judge whether each wire heats as its description says, °C/s at full duty.

    Args:
        heating: what each thermocouple showed.
        most: upper bound of each wire's kind, which is `RATE_FACTORS` above its description.
    """
    # Short, cool heatings tell the heat no better than wires of one kind differ. Rounded as they
    # are said, so that no verdict disagrees with its sentence.
    lowest = [
        round(b * RATE_FACTORS["least_heating"] ** 2 / RATE_FACTORS["most_heating"], 1)
        for b in most
    ]
    highest = [round(bound / RATE_FACTORS["least_heating"], 1) for bound in most]
    heating = [round(float(value), 1) for value in heating]
    is_low = [shown < low for shown, low in zip(heating, lowest, strict=True)]
    for wire, side in enumerate(names):
        shown = (
            f"{side} wire shows {heating[wire]:.1f} °C/s at full duty, where {lowest[wire]:.1f} to "
            f"{highest[wire]:.1f} are accepted for its description"
        )
        if lowest[wire] <= heating[wire] <= highest[wire]:
            judge(True, shown)
        elif is_low[wire] and not all(is_low):
            judge(False, f"{shown}, and another one shows that. {WHAT_TO_DO}")
        else:
            judge(
                False,
                f"{shown}: the limb is unlike its description, or all thermocouples are wrong; "
                f"if you are sure of them, describe the wire by a2: {heating[wire]:.1f}",
            )


def _judge_likeness(
    names: Sequence[str],
    rates: Sequence[HeatRates],
    bends: Sequence[Heating],
    judge: Callable[[bool, str], None],
) -> None:
    """Whether the thermocouples of a segment show the like for the like heat and bend."""
    shown = np.array([rate.heating for rate in rates])
    risen = []
    for rate, (duty, _, bend) in zip(rates, bends, strict=True):
        rises = rate.heating * warmth(duty.sum(axis=1), rate.cooling, 0.3, PERIOD)
        reached = np.argmax(_change(bend) >= ENOUGH_BEND)
        risen.append(rises[reached] if reached else np.nan)
    # How warm a wire has to be for a bend is another, independent witness.
    bent = not np.isnan(risen).any()
    shown = np.sqrt(shown * risen) if bent else shown
    ratio = shown.min() / shown.max()
    least, most = (names[int(wire)] for wire in (shown.argmin(), shown.argmax()))
    what = (
        f"{least} thermocouple shows {ratio:.0%} of what the {most} one does for the same heat"
        + " and bend" * bent
    )
    judge(ratio > ALIKE, what if ratio > ALIKE else f"{what}. {WHAT_TO_DO}")


def _change(bend: np.ndarray) -> np.ndarray:
    """How far the limb has bent since a heating began (K), rad."""
    return bend - bend[:5].mean()


def _rates(heatings: Sequence[Heating], wire: int) -> HeatRates:
    rates = fit_heat_rates(
        [(duty[1:, wire], (V[:, wire] - V[:5, wire].mean())[1:], PERIOD) for duty, V, _ in heatings]
    )
    assert rates  # it was heated
    return rates


def _heat(link: BoardLink, wire: int, towards: np.ndarray, how: Sequence[float]) -> Heating:
    """Heats a wire until it reads so much more, or the limb has bent so far, and lets it rest.

    ``towards`` has how far each bend angle is to the wire's own side; ``how`` the duty, the
    longest time, the rise and the bend.
    """
    duty, longest, rise, bend = how
    samples = [link.next_sample()]
    cold = samples[0].temperature[wire]
    heated = duty * np.eye(len(samples[0].duty))[wire]
    while (now := len(samples) * PERIOD) < longest + REST:
        link.command(heated)
        samples.append(link.next_sample())
        turns = bend_angle_from_tip_tangent(samples[-1].tip_tangent - samples[0].tip_tangent)
        reading = samples[-1].temperature[wire]
        cold = reading if np.isnan(cold) else cold  # the first reading was bad
        risen = reading - cold
        if now >= longest or risen >= rise or abs(towards @ turns) >= 1.2 * bend:
            heated, longest = np.zeros_like(heated), min(longest, now)
    readings = np.array([sample.temperature for sample in samples])
    return (
        np.array([sample.duty for sample in samples]),
        np.apply_along_axis(without_gaps, 0, readings),
        np.array([bend_angle_from_tip_tangent(s.tip_tangent) for s in samples]) @ towards,
    )
