"""What a limb is calibrated from: which recordings, and which of its wires are heated in each."""

from calibration.errors import CalibrationError
from limb_systems import LimbError, LimbParameters, SegmentParameters


def only_segment(parameters: LimbParameters) -> SegmentParameters:
    """The limb's one segment; segments are calibrated one by one."""
    if len(parameters.segments) != 1:
        raise LimbError(
            f"This limb has {len(parameters.segments)} segments; calibrate each of them alone, as "
            "a limb of one segment."
        )
    return parameters.segments[0]


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
    for index in sorted(range(len(wires)), key=lambda i: wires[i].direction < 0):
        if wires[index].name in (*kinds, "both", *FREE_KINDS):
            raise CalibrationError(
                f"A wire is named {wires[index].name!r}, as is a kind of recording; name it "
                "otherwise."
            )
        kinds[wires[index].name] = [index]
    return kinds | ({"both": list(range(len(wires)))} if len(wires) > 1 else {})


FREE_KINDS = ("heated", "motion")  # of heated recordings of any wires


def heated_kinds(parameters: LimbParameters) -> dict[str, list[int]]:
    """Those of `kinds_of` in which wires are heated."""
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
