"""The files of a folder that may be results, by their names and first bytes; quick to import."""

import collections
import dataclasses
import os
import re
from pathlib import Path

SUFFIXES = (".csv", ".html", ".txt", ".yaml", ".yml")
MOST_NAMES = 50_000
_HEAD = 4096  # bytes
_TAIL = 16384  # bytes of a page, whose provenance is at its end
_ROBOT = r"^(body|feet|ground|limbs):"
_LIMB = r"^(ambient_temperature|board|calibration|segments|temperature_limits):"


@dataclasses.dataclass(frozen=True)
class FoundFile:
    """A file of a folder.

    - ``key``: its path from the folder, with "/".
    - ``path``: the file.
    - ``changed``: time of its last change, s since 1970.
    - ``size``: bytes.
    """

    key: str
    path: Path
    changed: float
    size: int


def find(folder: Path) -> list[FoundFile]:
    """Files in a folder and below that may be results, newest first.

    Hidden folders, installed packages, and links that lead out of the folder are left out, and in
    a tree of more than `MOST_NAMES` what is farthest down.

    Raises:
        OSError: if the folder cannot be read.
    """
    root, found, looked = folder.resolve(), [], 0
    folders = collections.deque([folder])
    while folders and looked < MOST_NAMES:
        place = folders.popleft()
        try:
            entries = list(os.scandir(place))
        except OSError:
            if place is folder:
                raise
            continue
        looked += len(entries)
        for entry in entries:
            if not _is_theirs(entry.name):
                continue
            path = place / entry.name
            try:
                if entry.is_dir(follow_symlinks=False):
                    folders.append(path)
                elif entry.is_file() and entry.name.endswith(SUFFIXES):
                    if entry.is_symlink() and not path.resolve().is_relative_to(root):
                        continue
                    status, key = entry.stat(), path.relative_to(folder).as_posix()
                    found.append(FoundFile(key, path, status.st_mtime, status.st_size))
            except OSError:  # it has gone
                continue
    return sorted(found, key=lambda file: (-file.changed, file.key))


def _is_theirs(name: str) -> bool:
    """Whether a file or folder is one that people look at."""
    return name[0] not in "._" and name.isprintable() and name not in ("node_modules", "venv")


def glance(path: Path) -> str:
    """The kind that a file seems to be, as of `ResultFile`; empty for none, and for a task."""
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD).decode("utf-8", "replace").removeprefix("\ufeff")
            file.seek(max(0, path.stat().st_size - _TAIL))
            tail = file.read(_TAIL)
    except OSError:
        return ""
    if match := re.match(r"# limb (recording|trajectory|gait|learning), format ", head):
        return match[1]
    if head.lstrip().lower().startswith("<!doctype html>"):
        return "report" if b'id="provenance"' in tail else ""
    if path.suffix in (".yaml", ".yml"):
        for kind, field in (("robot", _ROBOT), ("limb", _LIMB)):
            if re.search(field, head, re.MULTILINE):
                return kind
    return ""
