"""Find the files of a folder that may be results, by names and first bytes; quick to import."""

import os
from pathlib import Path

from limb_systems.connected_limbs import CONNECTED_FIELDS, top_level_fields
from limb_systems.files.input import first_line

TABLE_KINDS = ("recording", "trajectory", "gait", "learning")  # kinds by the first line
RESULT_SUFFIXES = (".csv", ".html", ".txt", ".yaml", ".yml")
_HEAD = 4096  # bytes
_TAIL = 16384  # bytes of a page, whose provenance is at its end
# Fields at the top level of a limb.
_LIMB = {"ambient_temperature", "board", "calibration", "format", "gravity", "payload", "segments"}
_LIMB |= {"supply_voltage", "temperature_limits", "total_duty"}


def find_results(folder: Path) -> list[Path]:
    """Return the files in a folder and below that may be results.

    Hidden folders, installed packages, and links that lead out of the folder are left out.
    """
    files = []
    for parent, folders, names in os.walk(folder):
        folders[:] = filter(_is_visible, folders)
        # Keep files with the suffix of a result that are inside.
        for name in filter(_is_visible, names):
            path = Path(parent, name)
            is_inside = path.resolve().is_relative_to(folder.resolve())
            if name.endswith(RESULT_SUFFIXES) and is_inside and path.is_file():
                files.append(path)
    return files


def _is_visible(name: str) -> bool:
    """Return False for hidden files and folders, and for folders of installed packages."""
    return name[0] not in "._" and name.isprintable() and name not in ("node_modules", "venv")


def guess_file_kind(path: Path) -> str:
    """Return the kind of a file by its first and last bytes; see `ResultFile` for the kinds.

    The result is empty for other files.
    """
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD).decode("utf-8", "replace").removeprefix("\ufeff")
            file.seek(max(0, path.stat().st_size - _TAIL))
            tail = file.read(_TAIL)
    except OSError:
        return ""
    # Tables and descriptions are known by their beginnings, reports by their ends.
    if kind := kind_of_head(path, head):
        return kind
    return "report" if is_html(head) and b'id="provenance"' in tail else ""


def kind_of_head(path: Path, head: str) -> str:
    """Return the kind of a table, or "limb" or "robot" for a YAML file, or an empty text."""
    title = first_line(head)
    if title and title.kind in TABLE_KINDS:
        return title.kind
    fields = top_level_fields(head) if path.suffix in (".yaml", ".yml") else set()
    if fields & CONNECTED_FIELDS:
        return "robot"
    return "limb" if fields & _LIMB else ""


def is_html(head: str) -> bool:
    """Return True if a file that begins with this text is an HTML page."""
    return head.lstrip().lower().startswith("<!doctype html>")
