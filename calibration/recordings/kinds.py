"""Kinds of recordings: what a limb is calibrated from, and which wires are heated in each."""

import numpy as np

from calibration.remarks import CalibrationError
from limb_systems import (
    BendSensor,
    ChordSensor,
    LimbError,
    LimbParameters,
    Recording,
    SegmentParameters,
)

MIN_RING_DOWN_SWING = np.deg2rad(10.0)  # least, of a ring-down that nobody has named
GRAVITY_HINT = "; does its header's gravity say how the limb was mounted"
FREE_KINDS = ("heated", "motion")  # of heated recordings of any wires
# Names of recordings of the kind "heated" that collecting makes.
FIRST_CONTACT = "first_contact"
WARM_UP = "warm_up"
MOUNTING_ANGLES = (0, 90, 180, 270)  # degrees, of the mountings of a limb that bends in space
MOUNTINGS = tuple(f"mounting_{turned}" for turned in MOUNTING_ANGLES)
HEATED_NAMES = (FIRST_CONTACT, WARM_UP, "conditioning", "pulses", "ramps", "random", *MOUNTINGS)


def only_segment(parameters: LimbParameters) -> SegmentParameters:
    """Return the limb's one segment; segments are calibrated one by one."""
    if len(parameters.segments) != 1:
        raise LimbError(
            f"This limb has {len(parameters.segments)} segments; calibrate each of them alone, as "
            "a limb of one segment."
        )
    return parameters.segments[0]


def title_of(recording: Recording) -> str:
    """Return what messages call a recording: the name of its file, or else its source."""
    return recording.title or recording.source


def bend_sensor_of(recording: Recording, segment: int = 0) -> BendSensor:
    """Return the sensor that read the bend of a segment, as the recording's parameters say.

    A recording of the model itself, which has its joint states, was read by no
    sensor: its bend angle is the chord's.
    """
    if recording.joint_state is not None:
        return ChordSensor()
    return recording.parameters.segments[segment].bend_sensor


def kinds_of(parameters: LimbParameters) -> dict[str, list[int]]:
    """Return the kinds of recordings of a limb of one segment, in the order of collecting.

    Returns:
        for each kind the indices of the wires that are heated: none for
        "sag" and "ring_down"; one for each wire, by its name, those that bend
        towards +E2 first; and all for "both", if there are several.

    Raises:
        CalibrationError: if a wire has the name of another kind.
    """
    wires = only_segment(parameters).wires
    kinds: dict[str, list[int]] = {"sag": [], "ring_down": []}
    for index in sorted(range(len(wires)), key=lambda i: wires[i].lever[0] < 0):
        if wires[index].name in (*kinds, "both", *FREE_KINDS):
            raise CalibrationError(
                f"A wire is named {wires[index].name!r}, as is a kind of recording; name it "
                "otherwise."
            )
        kinds[wires[index].name] = [index]
    return kinds | ({"both": list(range(len(wires)))} if len(wires) > 1 else {})


def heated_kinds(parameters: LimbParameters) -> dict[str, list[int]]:
    """Return the kinds of `kinds_of` in which wires are heated."""
    return {kind: wires for kind, wires in kinds_of(parameters).items() if wires}


def heated_wires(parameters: LimbParameters, actuated: str) -> list[int]:
    """Return the indices of the wires that are heated in a kind; raise LimbError if none are."""
    kinds = heated_kinds(parameters)
    if actuated not in kinds:
        raise LimbError(f"actuated is {actuated!r}; it must be one of {', '.join(kinds)}.")
    return kinds[actuated]


def all_kinds(parameters: LimbParameters) -> list[str]:
    """Return the kinds of a limb's recordings: `kinds_of`, "heated" and "motion"."""
    return [*kinds_of(parameters), *FREE_KINDS]


def kind_of(recording: Recording, name: str = "") -> str:
    """Return the kind of a recording: what its header says, or else what it shows.

    Args:
        name: name of a file without its ending, by which heat is of the kind "heated" or
            "motion", and a limb that hardly moves rings down, where the header says nothing.

    Raises:
        LimbError: if its limb is one that is not calibrated, if its header's kind is none, or if
            it shows a limb at rest.
    """
    # Take the kind in the header, or else in the file's name.
    kinds = all_kinds(recording.parameters)
    if recording.kind:
        if recording.kind not in kinds:
            raise CalibrationError(
                f"its kind is {recording.kind!r}; it must be one of {', '.join(kinds)}."
            )
        return recording.kind
    named_kinds = [kind for kind in kinds if name.startswith(kind)]
    kind_by_name = "heated" if name in HEATED_NAMES else max(named_kinds, key=len, default="")
    if kind_by_name in FREE_KINDS and recording.duty.any():
        return kind_by_name
    # Take what it shows; a limb that hardly moves rings down only by name.
    shown_kind = kind_by_signals(recording)
    bends = recording.bend_angle[~np.isnan(recording.bend_angle)]
    if shown_kind == "ring_down" != kind_by_name and not (
        len(bends) and np.ptp(bends) >= MIN_RING_DOWN_SWING
    ):
        hint = GRAVITY_HINT * (kind_by_name == "sag")
        raise CalibrationError(f"it shows a limb at rest, which tells nothing{hint}.")
    return shown_kind


def content_in_words(parameters: LimbParameters, kind: str) -> str:
    """Return what a recording of a kind shows, in words."""
    if kind == "sag":
        return "the limb's sag under gravity, without heat"
    if kind == "ring_down":
        return "an unheated limb without gravity"
    if kind in FREE_KINDS:
        return "heated wires"
    wires = "both wires" if len(parameters.wires) == 2 else "all wires"
    return f"{wires} heated" if kind == "both" else f"only the {kind} wire heated"


def kind_by_signals(recording: Recording) -> str:
    """Return what a recording shows: one of `kinds_of` its limb, or "heated"."""
    parameters = recording.parameters
    heated = np.flatnonzero(recording.duty.max(axis=1) > 0).tolist()
    if not heated:
        return "sag" if gravity_bends(parameters) else "ring_down"
    kinds = kinds_of(parameters)
    return next((kind for kind, wires in kinds.items() if wires == heated), "heated")


def gravity_bends(parameters: LimbParameters) -> bool:
    """Return whether gravity bends the limb; a limb in space that hangs is straight."""
    gravity = parameters.gravity
    bending = gravity[:2] if only_segment(parameters).axes == 1 else gravity[1:]
    return bool(np.linalg.norm(bending) > 1.0)
