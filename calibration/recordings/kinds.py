"""Kinds of recordings: what a limb is calibrated from, and which wires are heated in each."""

import numpy as np

from calibration.errors import CalibrationError
from limb_systems import (
    BendSensor,
    ChordSensor,
    LimbError,
    LimbParameters,
    Recording,
    SegmentParameters,
)

FREE_KINDS = ("heated", "motion")  # of heated recordings of any wires
# Names of recordings of the kind "heated" that collecting makes.
FIRST_CONTACT, WARM_UP = "first_contact", "warm_up"
HEATED_NAMES = (FIRST_CONTACT, WARM_UP, "conditioning", "pulses", "ramps", "random")
TURNS = (0, 90, 180, 270)  # degrees, of the mountings of a limb that bends in space
MOUNTINGS = tuple(f"mounting_{turned}" for turned in TURNS)


def only_segment(parameters: LimbParameters) -> SegmentParameters:
    """The limb's one segment; segments are calibrated one by one."""
    if len(parameters.segments) != 1:
        raise LimbError(
            f"This limb has {len(parameters.segments)} segments; calibrate each of them alone, as "
            "a limb of one segment."
        )
    return parameters.segments[0]


def bend_sensor_of(recording: Recording, segment: int = 0) -> BendSensor:
    """The sensor that read the bend of a segment, as the recording's parameters say.

    A recording of the model itself, which has its joint states, was read by no
    sensor: its bend angle is that of the chord.
    """
    if recording.joint_state is not None:
        return ChordSensor()
    return recording.parameters.segments[segment].bend_sensor


def kinds_of(parameters: LimbParameters) -> dict[str, list[int]]:
    """The kinds of recordings of a limb of one segment, in the order of collecting.

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
    """The kinds of `kinds_of` in which wires are heated."""
    return {kind: wires for kind, wires in kinds_of(parameters).items() if wires}


def heated_wires(parameters: LimbParameters, actuated: str) -> list[int]:
    """Indices of the wires that are heated in recordings of a kind.

    Raises:
        LimbError: if there is no such kind.
    """
    kinds = heated_kinds(parameters)
    if actuated not in kinds:
        raise LimbError(f"actuated is {actuated!r}; it must be one of {', '.join(kinds)}.")
    return kinds[actuated]


def kind_of(recording: Recording) -> str:
    """The kind that a recording shows: one of `kinds_of` its limb, or "heated".

    Raises:
        LimbError: if its limb is one that is not calibrated.
    """
    parameters = recording.parameters
    heated = np.flatnonzero(recording.duty.max(axis=1) > 0).tolist()
    if not heated:
        return "sag" if gravity_bends(parameters) else "ring_down"
    for kind, wires in kinds_of(parameters).items():
        if wires == heated:
            return kind
    return "heated"


def gravity_bends(parameters: LimbParameters) -> bool:
    """Whether the limb is mounted so that gravity bends it; one in space that hangs is straight."""
    gravity = parameters.gravity
    bending = gravity[:2] if only_segment(parameters).axes == 1 else gravity[1:]
    return bool(np.linalg.norm(bending) > 1.0)
