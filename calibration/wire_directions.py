"""Where wires bend a limb to, by a regression that needs no law and no description."""

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration.prediction.baselines import DELAYS, heat_by_duty
from calibration.prediction.heated_run import STEP, HeatedRun
from calibration.remarks import CalibrationError
from limb_systems import LimbParameters, SegmentParameters

CHANGE = 8.0  # s, whose changes count: the angle at rest drifts more slowly
PASSES = 2  # over all wires, each with the best delay beside those of the others
MOST_OFF = np.deg2rad(45.0)  # from the description, beyond which a wire is a question
MOST_ERROR, LEAST_CORRELATION = np.deg2rad(20.0), 0.4  # of a direction that is told
ALIKE = np.deg2rad(20.0)  # within which all wires are off by the same turn of the sensor


class WrongDescriptionError(CalibrationError):
    """Recordings contradict where the description has wires or the sensor; ``corrected`` agrees."""

    def __init__(self, sentence: str, corrected: LimbParameters):
        super().__init__(sentence)
        self.corrected = corrected


@dataclasses.dataclass(frozen=True)
class WireDirection:
    """How a wire bends the limb.

    - ``name``: name of the wire.
    - ``angle``: direction of its bend from +E2 towards +E3, rad; 0 or π in a plane.
    - ``off``: the same from where the wire is described, rad.
    - ``error``: standard error of the direction, rad.
    - ``gain``: bend at lasting full duty, if the limb were linear, rad.
    - ``delay``: time constant, s.
    - ``correlation``: r of the wire's own share of the bend with its heat.
    """

    name: str
    angle: float
    off: float
    error: float
    gain: float
    delay: float
    correlation: float

    @property
    def is_told(self) -> bool:
        """Return whether the recordings determine the direction."""
        return self.error < MOST_ERROR and self.correlation > LEAST_CORRELATION

    def __str__(self) -> str:
        angle, off, gain = np.rad2deg([self.angle, self.off, self.gain])
        doubt = "" if self.is_told else "not determined, "
        return (
            f"the {self.name} wire bends to {angle:.0f}° ({doubt}{off:+.0f}° from its "
            f"description), by {gain:.0f}° at full duty, after {self.delay:.0f} s, "
            f"r = {self.correlation:.2f}"
        )


def wire_directions(runs: Sequence[HeatedRun], segment: SegmentParameters) -> list[WireDirection]:
    """Return the directions of the wires that are heated, by the changes of the bend with heat."""
    changes = np.concatenate([_changes(run, run.bend) for run in runs])
    heats = {
        delay: np.concatenate([_changes(run, heat_by_duty(run, delay)) for run in runs])
        for delay in DELAYS
    }
    shown = ~np.isnan(changes).any(axis=1)
    changes = changes[shown]
    heats = {delay: heat[shown] for delay, heat in heats.items()}
    heated = np.flatnonzero(heats[DELAYS[0]].any(axis=0)).tolist()
    if len(changes) <= len(heated) or not heated:
        return []

    def factors(delays: dict[int, float]) -> np.ndarray:
        return np.column_stack([heats[delay][:, wire] for wire, delay in delays.items()])

    def misfit(delays: dict[int, float]) -> float:
        gains = np.linalg.lstsq(factors(delays), changes, rcond=None)[0]
        return float(((changes - factors(delays) @ gains) ** 2).sum())

    # The best delay for all wires, then for each of them.
    delays = min((dict.fromkeys(heated, delay) for delay in DELAYS), key=misfit)
    for wire in heated * PASSES:
        delays = min((delays | {wire: delay} for delay in DELAYS), key=misfit)
    driven = factors(delays)
    gains = np.linalg.lstsq(driven, changes, rcond=None)[0]
    residuals = changes - driven @ gains
    # Changes that overlap are not independent.
    variance = residuals.var() * CHANGE / STEP
    errors = np.sqrt(variance * np.diag(np.linalg.pinv(driven.T @ driven)))
    found = []
    for wire, gain, error, own in zip(heated, gains, errors, driven.T, strict=True):
        size = float(np.linalg.norm(gain)) + 1e-12
        share = (residuals + np.outer(own, gain)) @ gain / size
        if segment.axes == 1:
            angle = 0.0 if gain[0] > 0 else np.pi
            described = 0.0 if segment.wires[wire].lever[0] > 0 else np.pi
        else:
            angle = float(np.arctan2(gain[1], gain[0])) + segment.bend_sensor.roll
            described = segment.wires[wire].angle
        found.append(
            WireDirection(
                segment.wires[wire].name,
                _wrapped(angle),
                _wrapped(angle - described),
                float(error / size),
                size,
                delays[wire],
                float(np.corrcoef(share, own)[0, 1]) if share.any() else 0.0,
            )
        )
    return found


def check_directions(directions: Sequence[WireDirection], limb: LimbParameters) -> None:
    """Refuse a description that recordings contradict.

    Raises:
        WrongDescriptionError: if a wire bends the limb more than 45° from its description.
    """
    told = [direction for direction in directions if direction.is_told]
    wrong = [d for d in told if abs(d.off) - 2 * d.error > MOST_OFF]
    if not wrong:
        return
    corrected = copy.deepcopy(limb)
    (segment,) = corrected.segments
    turn = float(np.angle(np.mean(np.exp(1j * np.array([d.off for d in told])))))
    alike = all(abs(_wrapped(d.off - turn)) < ALIKE for d in told)
    if segment.axes > 1 and len(told) > 1 and alike:
        segment.bend_sensor.roll = _wrapped(segment.bend_sensor.roll - turn)
        todo = (
            f"the bend sensor seems to be turned: bend_sensor.roll {segment.bend_sensor.roll:.2f}"
        )
    else:
        for direction in wrong:
            (wire,) = [wire for wire in segment.wires if wire.name == direction.name]
            if segment.axes == 1:
                wire.e2 = -wire.e2
            else:
                wire.angle = direction.angle
        names = " and ".join(direction.name for direction in wrong)
        todo = f"the description seems to have {names} on the wrong side"
    said = "; ".join(map(str, wrong))
    raise WrongDescriptionError(f"By the recordings {said}: {todo}.", corrected)


def _changes(run: HeatedRun, signal: np.ndarray) -> np.ndarray:
    """Changes of a signal (M, ...) within some seconds (L, ...)."""
    later = np.searchsorted(run.times, run.times + CHANGE - STEP / 2)
    early = np.flatnonzero(later < len(run.times))
    return signal[later[early]] - signal[early]


def _wrapped(angle: float) -> float:
    """Return an angle from -π to π."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
