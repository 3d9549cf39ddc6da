"""The directions in which wires bend a limb, by a regression that needs no law."""

import copy
import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from calibration.prediction.baselines import DELAYS, heat_by_duty
from calibration.prediction.heated_run import STEP, HeatedRun
from calibration.remarks import CalibrationError
from limb_systems import LimbParameters, SegmentParameters, WireParameters
from limb_systems.kinematics import wrap_angle

CHANGE_TIME = 4.0  # s, whose changes count: the angle at rest drifts more slowly
HEAT_POWERS = (1, 2, 3)  # of the heat, as torque sets in at a threshold
MIN_HEAT_SHARE = 1e-6  # share of the heat of all wires, below which a difference of wires is none
MAX_ANGLE_ERROR = np.deg2rad(45.0)  # from the description, beyond which a wire is a question
# Directions scatter by more than the regression says, as wires follow no power of their heat, and
# wires are placed within some degrees.
ERROR_WIDENING = 1.5
PLACEMENT_ERROR = np.deg2rad(8.0)
MAX_EXCHANGED_WIRES = 6  # wires, of which all exchanges are compared
MIN_CHI_SQUARE = 9.0  # χ² by which two wires are likelier as described than exchanged
SAME_TURN_ANGLE = np.deg2rad(20.0)  # within which all wires are off by the same turn of the sensor


class WrongDescriptionError(CalibrationError):
    """Recordings do not confirm where the description has wires or the sensor.

    - ``corrected``: the description as the recordings have it.
    """

    def __init__(self, sentence: str, corrected: LimbParameters):
        super().__init__(sentence)
        self.corrected = corrected


@dataclasses.dataclass(frozen=True)
class WireDirection:
    """The direction and size of a wire's bend.

    - ``name``: name of the wire.
    - ``angle``: direction of its bend from +E2 towards +E3, rad; 0 or π in a plane.
    - ``off``: the same from where the wire is described, rad.
    - ``error``: standard error of ``off``, rad.
    - ``delay``: time constant of the heat, s.
    - ``correlation``: r of the wire's own share of the bend with its heat.
    """

    name: str
    angle: float
    off: float
    error: float
    delay: float
    correlation: float

    def __str__(self) -> str:
        angle, off, error = np.rad2deg([self.angle, self.off, self.error])
        return (
            f"the {self.name} wire bends to {angle:.0f}° ({off:+.0f} ± {error:.0f}° from its "
            f"description), after {self.delay:.0f} s, r = {self.correlation:.2f}"
        )


def wire_directions(runs: Sequence[HeatedRun], segment: SegmentParameters) -> list[WireDirection]:
    """Return the directions of the wires that are heated, by the changes of the bend with heat."""
    # Compute changes of the bend, and of powers of each wire's heat.
    changes = np.concatenate([_changes(run, run.bend) for run in runs])
    is_read = ~np.isnan(changes).any(axis=1)
    changes = changes[is_read]
    heats = {}
    for delay, power in itertools.product(DELAYS, HEAT_POWERS):
        parts = [_changes(run, heat_by_duty(run, delay) ** power) for run in runs]
        heats[delay, power] = np.concatenate(parts)[is_read]
    heated = np.flatnonzero(heats[DELAYS[0], 1].any(axis=0)).tolist()
    if len(changes) <= len(heated) or not heated:
        return []

    # Take the delay and power with which the regression fits best.
    def misfit(chosen_heats: np.ndarray) -> float:
        gains = np.linalg.lstsq(chosen_heats, changes, rcond=None)[0]
        return float(((changes - chosen_heats @ gains) ** 2).sum())

    (delay, _), chosen_heats = min(heats.items(), key=lambda item: misfit(item[1]))
    chosen_heats = chosen_heats[:, heated]
    gains = np.linalg.lstsq(chosen_heats, changes, rcond=None)[0]
    residuals = changes - chosen_heats @ gains
    # Changes that overlap are not independent.
    variance = residuals.var() * CHANGE_TIME / STEP
    # Wires that are always heated together leave their own shares open.
    products = chosen_heats.T @ chosen_heats
    products += MIN_HEAT_SHARE * np.trace(products) * np.eye(len(products))
    errors = np.sqrt(variance * np.diag(np.linalg.inv(products)))
    # Turn each wire's gain into an angle, and compare it with the description.
    directions = []
    for wire, gain, error, wire_heat in zip(heated, gains, errors, chosen_heats.T, strict=True):
        size = float(np.linalg.norm(gain)) + 1e-12
        share = (residuals + np.outer(wire_heat, gain)) @ gain / size
        described = _described_angle(segment.wires[wire], segment)
        angle = 0.0 if gain[0] > 0 else np.pi
        if segment.axes > 1:
            angle = float(np.arctan2(gain[1], gain[0])) + segment.bend_sensor.roll
        directions.append(
            WireDirection(
                segment.wires[wire].name,
                wrap_angle(angle),
                wrap_angle(angle - described),
                float(np.hypot(ERROR_WIDENING * error / size, PLACEMENT_ERROR)),
                delay,
                float(np.corrcoef(share, wire_heat)[0, 1]) if share.any() else 0.0,
            )
        )
    return directions


def check_directions(directions: Sequence[WireDirection], limb: LimbParameters) -> None:
    """Refuse a description that recordings do not confirm.

    Raises:
        WrongDescriptionError: if a wire bends the limb more than 45° from its description, if
            all may be off by as much together, or if a wire may as well be on the other side.
    """
    corrected = copy.deepcopy(limb)
    (segment,) = corrected.segments
    angle_errors = np.array([direction.off for direction in directions])
    errors = np.array([direction.error for direction in directions])
    # All wires may be off by the same turn of the sensor.
    if segment.axes > 1 and len(directions) > 1:
        turn = float(np.angle(np.sum(np.exp(1j * angle_errors) / errors**2)))
        remaining_errors = np.abs(wrap_angle(angle_errors - turn))
        turn_error = float(1 / np.sqrt(np.sum(1 / errors**2)))
        is_same_turn = (remaining_errors < np.maximum(SAME_TURN_ANGLE, 2 * errors)).all()
        if is_same_turn and abs(turn) + turn_error > MAX_ANGLE_ERROR:
            segment.bend_sensor.roll = wrap_angle(segment.bend_sensor.roll - turn)
            roll = np.rad2deg(segment.bend_sensor.roll)
            raise WrongDescriptionError(
                f"By the recordings all wires are {np.rad2deg(turn):+.0f} ± "
                f"{np.rad2deg(turn_error):.0f}° from their description, as if the bend sensor "
                f"were turned: its roll would be {roll:.0f}°.",
                corrected,
            )
    # Ask about wires that are clearly wrong, or that may be exchanged.
    wrong_wires = [d for d in directions if abs(d.off) - 2 * d.error > MAX_ANGLE_ERROR]
    asked_wires = wrong_wires or _exchangeable_wires(directions, segment)
    if not asked_wires:
        return
    # Exchange places of wires if that explains where they bend the limb to.
    wires = [segment.wire(direction.name) for direction in directions]
    measured = np.array([direction.angle for direction in directions])
    described = np.array([_described_angle(wire, segment) for wire in wires])
    exchanged = described[np.newaxis]
    if len(wires) <= MAX_EXCHANGED_WIRES:
        exchanged = np.array(list(itertools.permutations(described)))
    angle_errors = np.abs(wrap_angle(measured - exchanged))
    best = int(np.argmin(((angle_errors / errors) ** 2).sum(axis=1)))
    places = exchanged[best]
    if (angle_errors[best] - errors > MAX_ANGLE_ERROR).any():
        is_asked = [direction in asked_wires for direction in directions]
        places = np.where(is_asked, measured, described)
    for wire, place in zip(wires, places, strict=True):
        if segment.axes > 1:
            wire.angle = float(place)
        elif np.cos(place) * wire.lever[0] < 0:
            wire.e2 = -wire.e2
    # Say what the recordings contradict.
    directions_text = "; ".join(map(str, asked_wires))
    names = " and ".join(direction.name for direction in asked_wires)
    if wrong_wires:
        advice = f"the description seems to have {names} on the wrong side"
    else:
        advice = (
            f"{names} may as well be exchanged; a recording with one wire heated after the "
            "other, each from cold, decides"
        )
    raise WrongDescriptionError(f"By the recordings {directions_text}: {advice}.", corrected)


def _exchangeable_wires(
    directions: Sequence[WireDirection], segment: SegmentParameters
) -> list[WireDirection]:
    """Return the wires that recordings do not distinguish from another wire."""
    by_name = {direction.name: direction for direction in directions}
    doubtful: dict[str, WireDirection] = {}
    for one, other in itertools.combinations(segment.wires, 2):
        # Compare how well both wires fit where they are described, and exchanged.
        between = wrap_angle(_described_angle(one, segment) - _described_angle(other, segment))
        chi_square = 0.0
        for wire, turn in ((one, between), (other, -between)):
            if direction := by_name.get(wire.name):
                squares = wrap_angle(direction.off + turn) ** 2 - direction.off**2
                chi_square += squares / direction.error**2
        if between and chi_square < MIN_CHI_SQUARE:
            doubtful |= {name: by_name[name] for name in (one.name, other.name) if name in by_name}
    return list(doubtful.values())


def _described_angle(wire: WireParameters, segment: SegmentParameters) -> float:
    """Return the direction in which a wire is described to bend the limb, rad."""
    if segment.axes > 1:
        return wire.angle
    return 0.0 if wire.lever[0] > 0 else np.pi


def _changes(run: HeatedRun, signal: np.ndarray) -> np.ndarray:
    """Return the changes of a signal (M, ...) within some seconds (L, ...)."""
    later = np.searchsorted(run.times, run.times + CHANGE_TIME - STEP / 2)
    early = np.flatnonzero(later < len(run.times))
    return signal[later[early]] - signal[early]
