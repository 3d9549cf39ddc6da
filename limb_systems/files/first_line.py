"""The first line of files of soft-limb, which says what a file is."""

import re
from typing import NamedTuple


class FirstLine(NamedTuple):
    """What the first line of a file says.

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
    """Return what the first line of a file's text says; None if the file is not of soft-limb."""
    match = re.match(r"\ufeff?# limb (\w+), format ([0-9]{1,9})(?![0-9])(.*)", text)
    return FirstLine(match[1], int(match[2]), match[3]) if match else None
