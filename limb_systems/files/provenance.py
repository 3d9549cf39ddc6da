"""What made a result: version, commit, command, parameters, seeds and time.

A result is stamped when it is made, and keeps its stamp in every file it is written to:
recordings and trajectories in their headers, calibrated limbs in their
`CalibrationRecord`, what was learned, results of evaluations and pages.
"""

import dataclasses
import datetime
import functools
import importlib.metadata
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from limb_systems.files.schema import load_typed
from limb_systems.summary import Entry, Summary

_ROOT = Path(__file__).parents[1]
_PATIENCE = 5.0  # s, for git
_LONGEST_COMMAND = 1000  # characters
_SECRET = r"(?:token|password|passwd|secret|api.?key)"


@dataclasses.dataclass(frozen=True)
class Provenance:
    """What made a result.

    - ``version``: version of soft-limb.
    - ``commit``: commit of git, if soft-limb ran from a checkout of its repository, with
      "-dirty" if there were changes that are not in it; else empty.
    - ``command``: command line of the program, as it can be typed again in a shell.
    - ``parameters``: `LimbParameters.digest` of the limb; empty if there is none.
    - ``time``: UTC, ISO 8601, such as "2030-01-31T12:00:00Z".
    - ``limb_seed``: seed of the emulated limb; None if there is none.
    - ``seed``: seed of the random numbers in what was done to the limb; None if there are none.
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
        """The provenance of what is being made by this program.

        The first call in a process asks git, which takes some milliseconds: it is no
        call for a loop that has to keep time.

        Args:
            parameters: `LimbParameters` of the limb, which know the seed of an emulated
                one; None if there is no limb.
            seed: seed of the random numbers in what is done to the limb, if there are any.
        """
        now = datetime.datetime.now(datetime.UTC)
        return cls(
            version=_version(),
            commit=_commit(),
            command=command_line(sys.argv),
            parameters=parameters.digest if parameters else "",
            time=now.strftime("%Y-%m-%dT%H:%M:%SZ"),
            limb_seed=getattr(parameters.board, "seed", None) if parameters else None,
            seed=seed,
        )

    @classmethod
    def from_json(cls, value: Any) -> "Provenance | None":
        """The inverse of `dataclasses.asdict` for a JSON file; None from None.

        Raises:
            SchemaError: with one sentence naming the field.
        """
        return None if value is None else load_typed(cls, json.dumps(value, ensure_ascii=False))

    def summary(self) -> Summary:
        """All that is known."""
        return Summary(
            [
                Entry("made by", f"soft-limb {self.version}"),
                Entry("commit", self.commit),
                Entry("command", self.command),
                Entry("made at", self.time),
                Entry("parameters", self.parameters),
                Entry("limb seed", self.limb_seed),
                Entry("seed", self.seed),
            ]
        )


def command_line(arguments: Sequence[str]) -> str:
    """A program's arguments as one line for a shell, without what looks like a secret.

    Args:
        arguments: such as `sys.argv`.
    """
    program, *words = arguments or [""]
    path = Path(program)
    if path.name == "__main__.py":
        said = ["python", "-m", path.parent.name]
    elif path.suffix == ".py":
        said = ["python", program]
    elif program in ("", "-c", "-"):
        said = ["python"]
    else:
        said = [path.name]  # an installed command, whose folder nobody types
    secret = False
    for word in words:
        hidden = re.sub(r"(?<=://)[^/@\s]*@", "***@", word)
        hidden = re.sub(rf"(?i)({_SECRET}[\w-]*=)[^&\s]*", r"\1***", hidden)
        said.append("***" if secret else hidden)
        secret = bool(re.fullmatch(rf"(?i)-+[\w-]*{_SECRET}[\w-]*", word))
    line = "".join(c if c.isprintable() else "?" for c in shlex.join(said))
    return line if len(line) <= _LONGEST_COMMAND else f"{line[: _LONGEST_COMMAND - 3]}..."


@functools.cache
def _version() -> str:
    try:
        return importlib.metadata.version("soft-limb")
    except importlib.metadata.PackageNotFoundError:  # a copy that was never installed
        return "unknown"


@functools.cache
def _commit() -> str:
    if not (_ROOT / ".git").exists():
        return ""
    # Those of a hook would lead to the repository that is committed to.
    environment = {name: value for name, value in os.environ.items() if name[:4] != "GIT_"}
    describe = ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        done = subprocess.run(
            describe,
            cwd=_ROOT,
            env=environment | {"GIT_OPTIONAL_LOCKS": "0"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_PATIENCE,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
