"""Find the files of a folder that may be results, by names and first bytes; quick to import."""

import collections
import dataclasses
import os
import re
from pathlib import Path

from limb_systems.connected_limbs import CONNECTED_FIELDS
from limb_systems.files.input import first_line

TABLE_KINDS = ("recording", "trajectory", "gait", "learning")  # kinds by the first line
RESULT_SUFFIXES = (".csv", ".html", ".txt", ".yaml", ".yml")
MAX_ENTRIES = 50_000
_HEAD = 4096  # bytes
_TAIL = 16384  # bytes of a page, whose provenance is at its end
# Fields at the top level of a limb.
_LIMB = {"ambient_temperature", "board", "calibration", "format", "gravity", "payload", "segments"}
_LIMB |= {"supply_voltage", "temperature_limits", "total_duty"}


@dataclasses.dataclass(frozen=True)
class ListedFile:
    """A file of a folder that may be a result.

    - ``key``: its path from the folder, with "/".
    - ``path``: the file.
    - ``changed``: time of its last change, s since 1970.
    - ``size``: bytes.
    """

    key: str
    path: Path
    changed: float
    size: int


def find_results(folder: Path) -> list[ListedFile]:
    """Return the files in a folder and below that may be results, newest first.

    Hidden folders, installed packages, and links that lead out of the folder are left out. The
    search ends after `MAX_ENTRIES` files and folders, and the deepest are left out then.

    Raises:
        OSError: if the folder cannot be read.
    """
    root = folder.resolve()
    files = []
    num_entries = 0
    # Search level by level.
    folders = collections.deque([folder])
    while folders and num_entries < MAX_ENTRIES:
        current = folders.popleft()
        try:
            entries = list(os.scandir(current))
        except OSError:
            if current is folder:
                raise
            continue
        num_entries += len(entries)
        for entry in entries:
            if not _is_visible(entry.name):
                continue
            path = current / entry.name
            try:
                if entry.is_dir(follow_symlinks=False):
                    folders.append(path)
                elif entry.is_file() and entry.name.endswith(RESULT_SUFFIXES):
                    if entry.is_symlink() and not path.resolve().is_relative_to(root):
                        continue
                    status = entry.stat()
                    key = path.relative_to(folder).as_posix()
                    files.append(ListedFile(key, path, status.st_mtime, status.st_size))
            except OSError:  # the file was deleted meanwhile
                continue
    return sorted(files, key=lambda file: (-file.changed, file.key))


def _is_visible(name: str) -> bool:
    """Return False for hidden files and folders, and for folders of installed packages."""
    return name[0] not in "._" and name.isprintable() and name not in ("node_modules", "venv")


def guess_file_kind(path: Path) -> str:
    """Return the kind of a file by its first and last bytes; see `ResultFile` for the kinds.

    The result is empty for other files, for tasks, and for references, as any table may be one.
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
    """Return the kind of a table, or "limb" or "robot" for a YAML file, or an empty text."""
    title = first_line(head)
    if title and title.kind in TABLE_KINDS:
        return title.kind
    fields = fields_of(head) if path.suffix in (".yaml", ".yml") else set()
    if fields & CONNECTED_FIELDS:
        return "robot"
    return "limb" if fields & _LIMB else ""


def fields_of(text: str) -> set[str]:
    """Return the names of the fields at the top level of a YAML text."""
    return set(re.findall(r"^\{?(\w+):", text, re.MULTILINE))


def is_html(head: str) -> bool:
    """Return True if a file that begins with this text is an HTML page."""
    return head.lstrip().lower().startswith("<!doctype html>")
