"""The files of a folder that may be results, by their names and first bytes; quick to import."""

import collections
import dataclasses
import os
import re
from pathlib import Path

from limb_systems.connected_limbs import CONNECTED_FIELDS
from limb_systems.files.input import first_line

TABLES = ("recording", "trajectory", "gait", "learning")  # kinds by the first line
SUFFIXES = (".csv", ".html", ".txt", ".yaml", ".yml")
MOST_NAMES = 50_000
_HEAD = 4096  # bytes
_TAIL = 16384  # bytes of a page, whose provenance is at its end
# Fields at the top level of a limb.
_LIMB = {"ambient_temperature", "board", "calibration", "format", "gravity", "payload", "segments"}
_LIMB |= {"supply_voltage", "temperature_limits", "total_duty"}


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
    """The kind that a file seems to be, as of `ResultFile`; empty for none, and for a task.

    A reference is none: any table may be one.
    """
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD).decode("utf-8", "replace").removeprefix("\ufeff")
            file.seek(max(0, path.stat().st_size - _TAIL))
            tail = file.read(_TAIL)
    except OSError:
        return ""
    if kind := kind_of_head(path, head):
        return kind
    return "report" if is_html(head) and b'id="provenance"' in tail else ""


def kind_of_head(path: Path, head: str) -> str:
    """The kind of a table, or of the limb or robot that a YAML file describes; else empty."""
    ours = first_line(head)
    if ours and ours.kind in TABLES:
        return ours.kind
    given = fields_of(head) if path.suffix in (".yaml", ".yml") else set()
    return "robot" if given & CONNECTED_FIELDS else "limb" if given & _LIMB else ""


def fields_of(text: str) -> set[str]:
    """The fields at the top level of a YAML file."""
    return set(re.findall(r"^\{?(\w+):", text, re.MULTILINE))


def is_html(head: str) -> bool:
    """Whether a file that begins so is a page."""
    return head.lstrip().lower().startswith("<!doctype html>")
