"""The error of this package, remarks on recordings and fits, and the verdict on a calibration.

The rules of the verdict, and their reasons:

- ``RULES`` has the severity of each kind of remark.
- The worst remark decides the verdict.
"""

import dataclasses
import enum
from collections.abc import Sequence

import numpy as np

from calibration.estimate import Estimate
from limb_systems import LimbError

# °C, beyond which nothing in a limb starts
MAX_BELOW_ROOM = 10.0
MAX_ABOVE_READINGS = 20.0


class CalibrationError(LimbError):
    """Recordings are missing, or a parameter cannot be estimated from them."""


class Severity(enum.IntEnum):
    """The effect of a remark on plans."""

    NOTE = 0  # good to know
    CARE = 1  # plans may be further off than the validation says
    STOP = 2  # plans would be wrong


# For each kind of remark: its severity, and the reason that the verdict gives.
RULES = {
    # If the uncertainty is larger than the value, the value could be anything.
    "unknown": (Severity.STOP, "a parameter is unknown"),
    # If a fit ends at its bound, the true value is beyond it by an unknown amount.
    "bound": (Severity.STOP, "a parameter is at its bound"),
    # All heat after a wrong start is wrong as well.
    "start": (Severity.STOP, "a recording starts at an impossible temperature"),
    # k is off by half, and what is under gravity with it.
    "sensor": (Severity.STOP, "the bend sensor seems to be another than the header says"),
    # For the validation; the verdict contains its error anyway.
    "far": (Severity.STOP, ""),
    "off": (Severity.CARE, ""),
    # Where gravity and wires pull is known as well as the sensor's axes, and k not at all.
    "mounted": (Severity.CARE, "the limb was mounted one way"),
    # It is unknown how well the model predicts data that it was not fitted to.
    "not validated": (Severity.CARE, "it is not validated"),
    # Standard errors come from few trials, each with errors of mounting and drift.
    "few": (Severity.CARE, "too few trials"),
    "scatter": (Severity.CARE, "trials scatter"),
    # The lag relates T to the measured temperature. Plans bound T, without using the lag.
    "lag": (Severity.CARE, "the thermocouples' lag is unknown"),
    # Uncertain by a third or more, and so is the temperature that a plan reaches.
    "uncertain": (Severity.CARE, "a parameter is uncertain"),
    # Such a wire's parameters are as described, or as expected of wires in general.
    "unheated": (Severity.CARE, "a wire was never heated"),
    # Its heat follows from the bend alone, and from the other wires'.
    "unread": (Severity.CARE, "a wire has no thermocouple"),
    # How hot wires are is counted by the description's a2.
    "unmeasured": (Severity.CARE, "heat was not measured"),
    # Motions beyond the recorded range are extrapolated.
    "range": (Severity.CARE, "the recordings span little"),
    # β is fitted as a multiple of k, so the bend is right in spite of k, except for gravity.
    "kept": (Severity.CARE, "mechanics is as described"),
    # The model's law is a line, the limb's is not. The validation shows the effect.
    "law": (Severity.NOTE, ""),
    # Heat is a hundred times slower than the ringing, so plans hardly excite it.
    "ringing": (Severity.NOTE, ""),
    # Bends are right in spite of k, and loads are wrong by as much.
    "stiffness": (Severity.NOTE, ""),
    "unused": (Severity.NOTE, ""),
    "left out": (Severity.NOTE, ""),
}
_VERDICTS = {
    Severity.NOTE: "Good enough to plan with",
    Severity.CARE: "Use with care",
    Severity.STOP: "Do not plan with this",
}


@dataclasses.dataclass(frozen=True)
class Remark:
    """A sentence on a weakness of recordings or fits and what to do; its kind has a rule."""

    kind: str
    sentence: str

    def __str__(self) -> str:
        return self.sentence

    @property
    def severity(self) -> Severity:
        """The severity of its kind."""
        return RULES[self.kind][0]


def remarks_on_estimate(name: str, estimate: Estimate) -> list[Remark]:
    """Return a remark if the data do not determine a quantity, which cannot be zero."""
    if estimate.is_determined:
        return []
    return [Remark("unknown", f"The data do not determine {name}; record more trials of it.")]


def remarks_on_start(name: str, value: float, room: float, readings: np.ndarray) -> list[Remark]:
    """Return a remark if a fitted initial temperature is implausible.

    It is implausible if it is far below T0 and all readings, or far above all of them.

    Args:
        name: the part of the limb that starts at this temperature, in words.
        value: fitted initial temperature, °C.
        room: T0, °C.
        readings: V in the recording, °C; nan where missing.
    """
    coldest = float(np.nanmin(readings, initial=room))
    hottest = float(np.nanmax(readings, initial=room))
    if coldest - MAX_BELOW_ROOM < value < hottest + MAX_ABOVE_READINGS:
        return []
    return [
        Remark(
            "start",
            f"The fit starts {name} at {value:.0f} °C in a room of {room:.0f} °C, which cannot "
            "be; let the limb rest, record some seconds before the first heat, and see that duty "
            "and readings are of the same time.",
        )
    ]


def verdict(remarks: Sequence[Remark], model_error: str) -> str:
    """Return whether to plan with a calibration, and why, in one line.

    Args:
        model_error: how far the model is off, in words; empty if it is not validated.
    """
    worst = max((remark.severity for remark in remarks), default=Severity.NOTE)
    reasons = [RULES[remark.kind][1] for remark in remarks if remark.severity == worst]
    reasons = list(dict.fromkeys(filter(None, [*reasons, model_error])))
    return f"{_VERDICTS[worst]}: {'; '.join(reasons)}."
