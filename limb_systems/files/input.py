"""Reading of files, and the first line of soft-limb's files, which names their kind and format."""

import contextlib
import os
import re
import stat
from collections.abc import Iterator
from typing import NamedTuple

from limb_systems.errors import LimbError

LARGEST_TABLE = 200_000_000  # bytes: at 20 Hz a robot's samples of about 18 hours
MOST_COLUMNS = 50_000  # of a table: a robot of 20 limbs with 500 joints each has fewer
LARGEST_TEXT = 1_000_000  # bytes of YAML, some 3 s: a calibrated robot of four limbs has 380,000


def read_bytes(
    path: str | os.PathLike, file_kind: str, largest: int, error_type: type[LimbError]
) -> bytes:
    """Read an input file whole, but no device, no pipe and no file beyond a limit.

    Args:
        file_kind: kind of the file, such as "recording", for the error.
        largest: largest size that is read, bytes.
        error_type: type of the error.

    Raises:
        LimbError: of that type, with one sentence naming the file.
    """
    check_file(path, file_kind, largest, error_type)
    with _raising_read_error(path, file_kind, error_type), open(path, "rb") as file:
        data = file.read(largest + 1)
    _check_size(len(data), path, file_kind, largest, error_type)  # it may have grown
    return data


def check_file(
    path: str | os.PathLike, file_kind: str, largest: int, error_type: type[LimbError]
) -> None:
    """Refuse a path that is no file, or a file beyond a limit, before it is opened.

    Arguments and errors as in `read_bytes`.
    """
    with _raising_read_error(path, file_kind, error_type):
        # Opening a pipe waits, and opening a port resets its board.
        status = os.stat(path)
        if stat.S_ISREG(status.st_mode):
            open(path, "rb").close()
    # Refuse other things than files, and files that are too large.
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a device or a pipe"
        raise error_type(f"Cannot read the {file_kind}: {path} is {kind}, but must be a file.")
    _check_size(status.st_size, path, file_kind, largest, error_type)


@contextlib.contextmanager
def _raising_read_error(
    path: str | os.PathLike, file_kind: str, error_type: type[LimbError]
) -> Iterator[None]:
    """Turn errors of the file system into one sentence naming the file."""
    try:
        yield
    except (OSError, ValueError) as error:  # the latter for a path that no file can have
        reason = f"{path}: {error.strerror}" if isinstance(error, OSError) else error
        raise error_type(f"Cannot read the {file_kind}: {reason}.") from error


def _check_size(
    size: int, path: str | os.PathLike, file_kind: str, largest: int, error_type: type[LimbError]
) -> None:
    """Refuse a file that is larger than the limit, bytes."""
    if size > largest:
        raise error_type(
            f"Cannot read the {file_kind}: {path} is larger than the {largest / 1e6:g} MB that are "
            "read."
        )


def read_text(
    path: str | os.PathLike,
    file_kind: str,
    error_type: type[LimbError],
    largest: int = LARGEST_TEXT,
) -> str:
    """Read a text file in UTF-8, with or without a byte order mark; see `read_bytes`."""
    try:
        return read_bytes(path, file_kind, largest, error_type).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise error_type(f"{path}: this is not a text file.") from error


class FirstLine(NamedTuple):
    """The contents of a file's first line.

    - ``kind``: such as "recording".
    - ``format``: version of the file's format.
    - ``more``: text after these, such as a checksum; empty if there is none.
    """

    kind: str
    format: int
    more: str = ""

    def __str__(self) -> str:
        return f"# limb {self.kind}, format {self.format}{self.more}"


def first_line(text: str) -> FirstLine | None:
    """Parse the first line of a file's text; return None if the file is not of soft-limb."""
    match = re.match(r"\ufeff?# limb (\w+), format ([0-9]{1,9})(?![0-9])(.*)", text)
    return FirstLine(match[1], int(match[2]), match[3]) if match else None
