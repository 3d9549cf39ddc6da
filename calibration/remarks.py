"""What recordings lack, how much that matters, and whether to plan with what came of them.

The rules that a calibration is judged by, and why:

- ``RULES`` says for each kind of remark how much it matters.
- ``GOOD_ERROR`` and ``WORST_ERROR`` say what the validation must show.
- The verdict is that of the worst remark.
"""

import dataclasses
import enum
from collections.abc import Sequence

import numpy as np

from calibration.estimate import Estimate
from calibration.validation import Validation


class Severity(enum.IntEnum):
    """How much a remark matters to plans."""

    NOTE = 0  # good to know
    CARE = 1  # plans may be further off than the validation says
    STOP = 2  # plans would be wrong


# Mean |φ - φ_sim| as a fraction of the range of φ in the recording it is validated with.
GOOD_ERROR = 0.1  # 6° of 60°: the paper's robot is 3.4° to 5.3° from its plans in Table I
WORST_ERROR = 0.25  # that of a limb which stays in the middle of a range that φ fills evenly

# Kind of remark: how much it matters, and what the verdict says of it.
RULES = {
    # What is uncertain by more than itself could be anything, and so could every plan.
    "untold": (Severity.STOP, "a parameter is unknown"),
    # Of a fit that ends at its bound nobody knows where it would have ended.
    "bound": (Severity.STOP, "a parameter is at its bound"),
    # Of the validation, whose error the verdict has anyway.
    "far": (Severity.STOP, ""),
    "off": (Severity.CARE, ""),
    # Nothing says how well the model predicts what it was not fitted to.
    "not validated": (Severity.CARE, "it is not validated"),
    # Standard errors are of the few trials; mounting and drift are in each of them.
    "few": (Severity.CARE, "too few trials"),
    "scatter": (Severity.CARE, "trials scatter"),
    # The lag relates T to what is measured. Plans bound T, which they go by without it.
    "lag": (Severity.CARE, "the thermocouples' lag is unknown"),
    # Uncertain by a third and more: so is the temperature that a plan reaches.
    "hardly told": (Severity.CARE, "a parameter is uncertain"),
    # Whatever is beyond the recorded range is extrapolated.
    "range": (Severity.CARE, "the recordings span little"),
    # β is fitted as a multiple of k: the bend follows all the same, but not what gravity adds.
    "kept": (Severity.CARE, "mechanics is that of the description"),
    # The model's law is a line; what the limb does is not. The validation says what that costs.
    "law": (Severity.NOTE, ""),
    # Heat is a hundred times slower than the ringing, which plans hardly excite.
    "ringing": (Severity.NOTE, ""),
    # Both together predict V, whichever is which.
    "alike": (Severity.NOTE, ""),
    "unused": (Severity.NOTE, ""),
}
_VERDICTS = {
    Severity.NOTE: "Good enough to plan with",
    Severity.CARE: "Use with care",
    Severity.STOP: "Do not plan with this",
}


@dataclasses.dataclass(frozen=True)
class Remark:
    """A sentence on what recordings lack and what to do, of a kind that has a rule."""

    kind: str
    sentence: str

    def __str__(self) -> str:
        return self.sentence

    @property
    def severity(self) -> Severity:
        """How much it matters."""
        return RULES[self.kind][0]


def remarks_on_estimate(name: str, estimate: Estimate) -> list[Remark]:
    """Whether the data tell a quantity, which cannot be zero, at all."""
    if estimate.told:
        return []
    return [Remark("untold", f"The data do not tell {name}; record more trials of it.")]


def remarks_on_validation(validation: Validation | None) -> list[Remark]:
    """Whether the model misses the motion that it is validated with."""
    if validation is None:
        return [
            Remark(
                "not validated",
                "There is no recording of both wires: the model is not validated; record one.",
            )
        ]
    fraction = _error(validation)
    if fraction <= GOOD_ERROR:
        return []
    return [
        Remark(
            "off" if fraction <= WORST_ERROR else "far",
            f"The model is {_error_in_words(validation)}; look at both in the validation's "
            "picture, and record again what differs.",
        )
    ]


def verdict(remarks: Sequence[Remark], validation: Validation | None) -> str:
    """Whether to plan with a calibration, and why, in one line."""
    worst = max((remark.severity for remark in remarks), default=Severity.NOTE)
    reasons = [RULES[remark.kind][1] for remark in remarks if remark.severity == worst]
    if validation:
        reasons.append(f"the model is {_error_in_words(validation)}")
    return f"{_VERDICTS[worst]}: {'; '.join(dict.fromkeys(filter(None, reasons)))}."


def _error(validation: Validation) -> float:
    """Mean |φ - φ_sim| as a fraction of the range of φ."""
    span = np.ptp(validation.recording.bend_angle, axis=1).max()
    return validation.mean / max(span, np.deg2rad(1.0))  # a limb at rest has sensor noise alone


def _error_in_words(validation: Validation) -> str:
    return (
        f"{np.rad2deg(validation.mean):.1f}° ({100 * _error(validation):.0f}% of its range) from "
        "the limb's bend on average"
    )
