"""A folder of recordings, named after their kinds."""

import warnings
from pathlib import Path

import numpy as np

from calibration.errors import CalibrationError
from calibration.recordings.checks import check_recording, check_whole
from calibration.recordings.kinds import FREE_KINDS, HEATED_NAMES, MOUNTINGS, kinds_of
from limb_systems import LimbError, Recording
from limb_systems.files.table_writer import is_unfinished

SWING = np.deg2rad(10.0)  # least, of a ring-down


def folder_of_limb(folder: str | Path) -> Path:
    """The folder that has recordings: that one, or else the only one in it that has some.

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


def load_recordings(folder: str | Path) -> dict[str, list[Recording]]:
    """The recordings in a folder, checked, by what they show; see `folder_of_limb`.

    Files named after a kind (``right.csv``, ``sag_3.csv``, ``motion_1.csv``), one of
    `kinds_of` the limb in their header, "heated" or "motion", must show it. First contact,
    warm-up and `excitations` are of the kind "heated". Files with other names go by what they
    show, and are left out with a warning if that is a limb at rest. Unfinished ones
    (``right.unfinished.csv``) are ignored.

    Raises:
        CalibrationError: with one sentence naming the file and the trouble.
    """
    recordings: dict[str, list[Recording]] = {}
    folder = folder_of_limb(folder)
    for path in sorted(folder.glob("*.csv")):
        if is_unfinished(path):
            continue
        recording = Recording.load(path)
        try:
            check_whole(recording)
            kinds = [*kinds_of(recording.parameters), *FREE_KINDS]
            named = [kind for kind in kinds if path.stem.startswith(kind)]
            named += ["heated"] if path.stem in (*HEATED_NAMES, *MOUNTINGS) else []
            kind = check_recording(recording, max(named, key=len, default=None))
            bends = recording.bend_angle[~np.isnan(recording.bend_angle)]
            if not named and kind == "ring_down" and np.ptp(bends) < SWING:
                warnings.warn(f"{path} shows a limb at rest, which tells nothing.", stacklevel=2)
                continue
            recordings.setdefault(kind, []).append(recording)
        except LimbError as error:
            raise CalibrationError(f"{path}: {error}") from error
    return recordings


def save_recordings(recordings: dict[str, list[Recording]], folder: str | Path) -> list[Path]:
    """Writes recordings to files named after their kinds; returns their paths."""
    paths = []
    for kind, group in recordings.items():
        for number, recording in enumerate(group, 1):
            name = kind if len(group) == 1 else f"{kind}_{number}"
            paths.append(Path(folder) / f"{name}.csv")
            recording.save(paths[-1])
    return paths
