"""The recording to make next: the one that tells what is known least."""

from collections.abc import Collection

import numpy as np

from calibration.prediction.law_fit import LawFit
from calibration.prediction.unknowns import LAG, Unknown

KNOWN = 0.5  # share of what was unknown beforehand, below which more of it tells little

HEATED = "heat the {} wire alone from cold for 60 s and let it cool for 120 s"
TELL = {  # recordings, and the parameters that they tell best
    HEATED: ("a1", "a2", LAG, "silicone_warming", "silicone_cooling"),
    "raise the duty of the {} wire alone slowly until it is as hot as it may be, and lower it as "
    "slowly": (
        *("beta", "full_torque", "knee", "width", "middle", "heating_middle", "cooling_middle"),
    ),
    "mount the limb horizontally, turned about its axis by 0°, 90°, 180° and 270°, and in each "
    "mounting hold each wire at four levels, then neighbouring pairs": (
        *("stiffness", "stiffness_ratio", "roll", "angle", "rest_angle_e3"),
    ),
    "record the cold limb for 10 s, then heat it": ("rest_angle",),
    "bend the limb as far as it may be to one side, then to the other": ("stiffening",),
    "heat the wires in turn, each until it bends the limb to its side, three times": (
        *("shift", "rate"),
    ),
}
FURTHER = {
    "motion": "record a motion like those that you plan, named motion_1.csv, which judges the laws",
    "sag": "record the sag under gravity, named sag_1.csv, which tells k",
    "ring_down": "record a ring-down, named ring_down_1.csv, which tells σ",
}


def next_recording(fit: LawFit | None, kinds: Collection[str]) -> str:
    """The recording to make next and what it tells, in words; empty if none is needed.

    Args:
        fit: fit of the wires; None if not by prediction.
        kinds: kinds of the recordings that there are.
    """
    if fit is None:
        kinds = {*kinds, "motion"}
    elif fit.untold:
        of_wire = [u for u in fit.untold if u.wire == fit.untold[0].wire]
        bond = "with a thermocouple on it, " if len(of_wire) == 1 else ""  # else it was not heated
        return _said(fit, bond + HEATED, [u for u in of_wire if u.field in TELL[HEATED]])
    else:
        errors = np.sqrt(np.diag(fit.covariance))
        before = [np.hypot(u.spread, u.alike) for u in fit.unknowns]
        shares = dict(zip([u.name for u in fit.unknowns], errors / before, strict=True))
        unknown = [u for u in fit.unknowns if shares[u.name] > KNOWN]
        for least in sorted(unknown, key=lambda u: -shares[u.name]):
            for recording, fields in TELL.items():
                if least.field in fields:
                    alike = [u for u in unknown if u.field in fields and u.wire == least.wire]
                    return _said(fit, recording, alike)
    return next((recording for kind, recording in FURTHER.items() if kind not in kinds), "")


def _said(fit: LawFit, recording: str, told: list[Unknown]) -> str:
    names = [wire.name for wire in fit.segment.wires]
    said = recording if told[0].wire is None else recording.format(names[told[0].wire])
    return f"{said}, which tells {', '.join(unknown.name for unknown in told)}"
