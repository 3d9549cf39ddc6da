"""Commands to run next, which are named only if they take what was written."""

import shlex
from collections.abc import Iterable
from pathlib import Path

from calibration.recordings.files import Usable, usable
from limb_systems import Recording
from limb_systems.output import free_path


def shell_line(*words: str | Path) -> str:
    """A command of ``soft-limb`` as a shell takes it."""
    return shlex.join(["soft-limb", *map(str, words)])


def usable_of(recordings: Iterable[Recording]) -> Usable:
    """What a limb can be fitted to of recordings with their kinds in their headers."""
    by_kind: dict[str, list[Recording]] = {}
    for recording in recordings:
        by_kind.setdefault(recording.kind, []).append(recording)
    return usable(by_kind)


def fit_line(folder: Path, name: str = "limb") -> str:
    """The command that fits a limb to a folder of recordings, and writes a new file."""
    return shell_line("fit", folder, "-o", free_path(Path(f"{name}.yaml")))
