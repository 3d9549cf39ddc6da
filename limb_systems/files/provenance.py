"""Provenance of a result: version, commit, command, parameters, seeds and time.

A result is stamped when it is made, and keeps its stamp in every file that it is written to.
"""

import dataclasses
import datetime
import functools
import importlib.metadata
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

from limb_systems.files.schema import load_typed
from limb_systems.summary import Entry, Summary

_ROOT = Path(__file__).parents[2]
_LONGEST_COMMAND = 1000  # characters


@dataclasses.dataclass(frozen=True)
class Provenance:
    """The program, command, parameters and time that made a result.

    - ``version``: version of soft-limb.
    - ``commit``: commit of git, if soft-limb ran from a checkout of its repository, with
      "-dirty" if there were changes that are not in it; else empty.
    - ``command``: command line of the program, as it can be typed again in a shell.
    - ``parameters``: `LimbParameters.digest` of the limb; empty if there is none.
    - ``time``: UTC, ISO 8601, such as "2030-01-31T12:00:00Z".
    - ``limb_seed``: seed of the emulated limb; None if there is none.
    - ``seed``: seed of the random numbers in the experiment; None if there are none.
    """

    version: str
    commit: str
    command: str
    parameters: str
    time: str
    limb_seed: int | None = None
    seed: int | None = None

    @classmethod
    def now(cls, parameters: Any = None, seed: int | None = None) -> "Provenance":
        """Return the provenance of a result that this program is making.

        The first call in a process asks git, which takes some milliseconds: make it before a
        loop that has to keep time.

        Args:
            parameters: `LimbParameters` of the limb; None if there is no limb.
            seed: seed of the random numbers in the experiment, if there are any.
        """
        version, commit = version_and_commit()
        return cls(
            version=version,
            commit=commit,
            command=command_line(sys.argv),
            parameters=parameters.digest if parameters else "",
            time=datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            limb_seed=getattr(parameters.board, "seed", None) if parameters else None,
            seed=seed,
        )

    @classmethod
    def from_json(cls, value: Any) -> "Provenance | None":
        """Invert `dataclasses.asdict` for a JSON file; None stays None.

        Raises:
            SchemaError: with one sentence naming the field.
        """
        return None if value is None else load_typed(cls, json.dumps(value, ensure_ascii=False))

    def summary(self) -> Summary:
        """Return all fields as a summary."""
        entries = [Entry("made by", f"soft-limb {self.version}")]
        labels = {"time": "made at", "limb_seed": "limb seed"}
        for name in ("commit", "command", "time", "parameters", "limb_seed", "seed"):
            entries.append(Entry(labels.get(name, name), getattr(self, name)))
        return Summary(entries)


@functools.cache
def version_and_commit() -> tuple[str, str]:
    """Return the version of soft-limb and the commit of its checkout, see `Provenance`."""
    # Find the version.
    try:
        version = importlib.metadata.version("soft-limb")
    except importlib.metadata.PackageNotFoundError:  # a copy that was never installed
        version = "unknown"
    # Find the commit, if this is a checkout.
    if not (_ROOT / ".git").exists():
        return version, ""
    # In a git hook, git's variables name the repository of the hook.
    environment = {name: value for name, value in os.environ.items() if name[:4] != "GIT_"}
    try:
        commit = subprocess.check_output(
            ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"],
            cwd=_ROOT,
            env=environment | {"GIT_OPTIONAL_LOCKS": "0"},
            stdin=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            text=True,
            timeout=5.0,
        )
    except (OSError, subprocess.SubprocessError):
        return version, ""
    return version, commit.strip()


def command_line(arguments: list[str]) -> str:
    """Return a program's arguments, such as `sys.argv`, as one line for a shell."""
    # Name the program as a user would type it.
    path = Path(arguments[0] if arguments else "")
    if path.name == "__main__.py":
        program = ["python", "-m", path.parent.name]
    elif path.suffix == ".py":
        program = ["python", str(path)]
    elif path.name in ("", "-", "-c"):
        program = ["python"]
    else:
        program = [path.name]  # an installed command, whose folder nobody types
    # Quote its arguments, printable and not too long.
    line = shlex.join([*program, *arguments[1:]])
    line = "".join(c if c.isprintable() else "?" for c in line)
    return line if len(line) <= _LONGEST_COMMAND else f"{line[: _LONGEST_COMMAND - 3]}..."
