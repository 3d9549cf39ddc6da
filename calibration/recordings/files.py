"""A folder of recordings, and the recordings that a limb can be fitted to."""

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calibration.recordings.kinds import all_kinds, kind_of, title_of
from calibration.recordings.recording_checks import (
    check_recording,
    check_without_gaps,
    frozen_since,
)
from calibration.recordings.repair import in_pieces, select_samples
from calibration.remarks import CalibrationError, Remark
from limb_systems import LimbError, LimbParameters, Recording
from limb_systems.files.table_writer import is_unfinished
from limb_systems.progress import Progress


class UsableRecordings(NamedTuple):
    """Recordings that a limb can be fitted to.

    - ``recordings``: recordings by kind, each of them whole.
    - ``heated``: heated ones by kind, in pieces; pieces may heat any wires, and are of the kind
      "heated" unless they are of a motion.
    - ``left_out``: remarks on what was left out, and why.
    """

    recordings: dict[str, list[Recording]]
    heated: dict[str, list[Recording]]
    left_out: list[Remark]


def left_out_remark(recording_name: str, reason: object) -> Remark:
    """Return a remark on a recording that is not used."""
    return Remark("left out", f"{recording_name} is left out: {reason}")


def select_usable(
    recordings: Mapping[str, Sequence[Recording]],
    described: LimbParameters | None = None,
    *,
    whole: bool = False,
) -> UsableRecordings:
    """Check recordings by kind, and cut heated ones in pieces unless they stay ``whole``.

    Recordings that are not cut must be without gaps: unheated ones, and all if ``whole``.

    Args:
        described: the limb's description, whose wires recordings must be of; any wires if None.

    Raises:
        CalibrationError: if the described limb has no such kind of recording.
    """
    result = UsableRecordings({}, {}, [])
    names, kinds = (described.wire_names, all_kinds(described)) if described else ([], recordings)
    for kind, group in recordings.items():
        for recording in group:
            wire_names = recording.parameters.wire_names
            pieces = [recording] * bool(recording.duty.any())
            if kind not in kinds and wire_names == names:
                raise CalibrationError(f"{kind!r} is no kind of recording: {', '.join(kinds)}.")
            # Check the recording, and cut it before a frozen sensor and in pieces.
            try:
                if described and wire_names != names:
                    raise CalibrationError(
                        f"it is of the wires {', '.join(wire_names)}, but the limb is described "
                        f"with {', '.join(names)}, in this order."
                    )
                if recording.interrupted:  # its last equilibrium is none
                    reason = recording.interrupted.rstrip(".")
                    raise CalibrationError(f"this was interrupted ({reason}), so record it again.")
                if frozen := frozen_since(recording):
                    start, sentence = frozen
                    recording = select_samples(recording, np.arange(start))
                    pieces = [recording]
                    remark = f"Of {title_of(recording)}, the rest is left out: {sentence}."
                    result.left_out.append(Remark("left out", remark))
                check_recording(recording, kind)
                if whole or not pieces:
                    check_without_gaps(recording)
                else:
                    pieces, remarks = in_pieces(recording)
                    result.left_out.extend(remarks)
            except LimbError as error:
                result.left_out.append(left_out_remark(title_of(recording), error))
                continue
            result.recordings.setdefault(kind, []).append(recording)
            if pieces:
                piece_kind = "heated" if len(pieces) > 1 and kind != "motion" else kind
                result.heated.setdefault(piece_kind, []).extend(pieces)
    return result


def folder_of_limb(folder: str | Path) -> Path:
    """Return the folder that has recordings: the given folder, or the only such folder in it.

    Raises:
        CalibrationError: if there is no such folder, or if recordings are in several in it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise CalibrationError(f"There is no folder {folder}.")
    if any(folder.glob("*.csv")):
        return folder
    limbs = sorted({path.parent for path in folder.glob("*/*.csv")})
    if len(limbs) > 1:
        names = ", ".join(map(str, limbs))
        raise CalibrationError(f"{folder} has folders of several limbs; give one of {names}.")
    return limbs[0] if limbs else folder


def read_folder(folder: str | Path) -> tuple[dict[str, list[Recording]], list[Remark]]:
    """Return the recordings in a folder by kind, and remarks on files that are left out.

    See `folder_of_limb` and `kind_of`. Unfinished files (``right.unfinished.csv``) are ignored.

    Raises:
        CalibrationError: as `folder_of_limb`.
    """
    recordings: dict[str, list[Recording]] = {}
    remarks: list[Remark] = []
    # Read each file, and note why it is left out.
    paths = [p for p in sorted(folder_of_limb(folder).glob("*.csv")) if not is_unfinished(p)]
    with Progress("reading", len(paths), "recordings") as progress:
        for number, path in enumerate(paths):
            progress.update(number, path.name)
            try:
                recording = dataclasses.replace(Recording.load(path), title=path.name)
                kind = kind_of(recording, path.stem)
            except LimbError as error:
                remarks.append(left_out_remark(path.name, str(error).removeprefix(f"{path}: ")))
                continue
            recordings.setdefault(kind, []).append(recording)
    return recordings, remarks


def load_recordings(folder: str | Path) -> dict[str, list[Recording]]:
    """Return the recordings in a folder that a limb can be fitted to, by kind; see `read_folder`.

    A warning says what is left out.

    Raises:
        CalibrationError: as `folder_of_limb`.
    """
    recordings, remarks = read_folder(folder)
    usable_by_kind = select_usable(recordings)
    for remark in [*remarks, *usable_by_kind.left_out]:
        warnings.warn(str(remark), stacklevel=2)
    return usable_by_kind.recordings


def save_recordings(recordings: dict[str, list[Recording]], folder: str | Path) -> list[Path]:
    """Write recordings to files with their kinds in name and header; return their paths."""
    paths = []
    for kind, group in recordings.items():
        for number, recording in enumerate(group, 1):
            name = kind if len(group) == 1 else f"{kind}_{number}"
            paths.append(Path(folder) / f"{name}.csv")
            dataclasses.replace(recording, kind=kind).save(paths[-1])
    return paths
