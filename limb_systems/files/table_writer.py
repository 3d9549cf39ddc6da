"""Writing of tables row by row, while they are recorded."""

import contextlib
import os
import queue
import tempfile
import threading
import time
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from limb_systems.errors import reraise_as
from limb_systems.files.csv_format import TableText
from limb_systems.files.output import OutputError, raising_output_error

MOST_WAITING = 1000  # rows in the queue: 50 s of a robot's samples
SYNC_PERIOD = 1.0  # s
CHUNK = 1 << 20  # bytes
PATIENCE = 2.0  # s, for which the end waits for the disk
MAX_APPEND_WAIT = 30.0  # s, for which a row of a simulation waits for the disk

_UNFINISHED = ".unfinished"


def is_unfinished(path: Path) -> bool:
    """Return whether a file has the name of a table that a `TableWriter` did not finish."""
    return _UNFINISHED in path.name


def unfinished_files(path: str | Path) -> set[Path]:
    """Return the unfinished files of a table by the path of its finished file."""
    path = Path(path)
    return set(path.parent.glob(f"{path.stem}{_UNFINISHED}*{path.suffix}"))


class TableWriter:
    """A writer of a table in a thread of its own, so that a robot never waits for the disk.

    The table ``name.csv`` is in ``name.unfinished.csv`` until `finish` gives it its
    name, or in ``name.unfinished_2.csv`` and so on if that is taken: an existing file
    is never opened. `Recording.load` has an option to read unfinished files.

    The thread gives each row to the operating system at once, so that the death of this
    program costs no row. It forces rows to the disk about once a second and at the end; a
    power loss costs the rows since then. A file that was removed meanwhile, or whose folder
    was, is written again, in the folder for temporary files if need be.

    ``path`` is the path of the unfinished file.
    """

    def __init__(
        self,
        path: str | Path,
        kind: str,
        header: str,
        names: Sequence[str],
        *,
        may_wait: bool = False,
    ):
        """
        Args:
            path: path of the finished file; `finish` replaces an existing one.
            kind, header, names: as for `TableText`.
            may_wait: whether `append` may wait for the disk, as a simulation can, which is faster
                than a disk.

        Raises:
            OutputError: if no file can be made there.
        """
        self._target = Path(path)
        self._names = list(names)
        self._text = TableText(kind, header, names)
        self._rows: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._failure: OSError | None = None
        self._rename = False
        self._is_ended = False
        self._longest_wait = MAX_APPEND_WAIT if may_wait else 0.0
        with raising_output_error(path):
            self._target.parent.mkdir(parents=True, exist_ok=True)
            self.path, self._file = self._open(self._target.parent)
        self._rows.put(self._text.head)
        # A daemon, because a program must end even if the disk never answers.
        self._thread = threading.Thread(target=self._write, name="journal", daemon=True)
        self._thread.start()

    @property
    def num_rows(self) -> int:
        """The number of rows that were appended."""
        return self._text.num_rows

    def append(self, values: Sequence[float]) -> None:
        """Append a row of values, angles in rad.

        Raises:
            OutputError: if the disk is full, broken or stalled, or the file as
                large as can be read.
        """
        # Wait for the queue, if that is allowed.
        end = time.monotonic() + self._longest_wait
        while self._rows.qsize() >= MOST_WAITING and not self._failure and time.monotonic() < end:
            time.sleep(0.001)
        if self._failure:
            raise OutputError(f"Cannot write {self._target}: {self._failure}.")
        if self._rows.qsize() >= MOST_WAITING:
            raise OutputError(
                f"The disk is stalled: {MOST_WAITING} rows wait to be written to {self.path}."
            )
        # Hand the row to the thread.
        row = {}
        for name, value in zip(self._names, values, strict=True):
            row[name] = np.array([value])
        with reraise_as(OutputError, f"{self.path}: "):
            self._rows.put(self._text.rows(row))

    def finish(self, interrupted: str = "") -> None:
        """Write the end and give the file its name; a second call does nothing.

        Args:
            interrupted: the reason why the table is incomplete; empty if it is complete.

        Raises:
            OutputError: if writing failed, or the disk does not answer within 2 s.
        """
        if complaint := self._end(interrupted, rename=True):
            raise OutputError(complaint)

    def abandon(self, interrupted: str) -> None:
        """Write the end of an interrupted table, and warn with its path; remove an empty one.

        It warns as well if not all rows are on the disk.
        """
        if self._is_ended:
            return
        if complaint := self._end(interrupted, rename=False):
            warnings.warn(complaint, stacklevel=2)
        elif self.num_rows:
            warnings.warn(f"What was recorded until then is in {self.path}.", stacklevel=2)

    def _open(self, folder: Path) -> tuple[Path, int]:
        """Create the unfinished file in a folder, and return its path and descriptor."""
        number = 1
        while True:
            mark = _UNFINISHED if number == 1 else f"{_UNFINISHED}_{number}"
            path = folder / f"{self._target.stem}{mark}{self._target.suffix}"
            try:
                return path, os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
            except FileExistsError:
                number += 1

    def _end(self, interrupted: str, rename: bool) -> str | None:
        """End the file, and return a sentence on what failed; None if nothing did."""
        if self._is_ended:
            return None
        self._is_ended = True
        self._rename = rename
        # Queue the end, and wait for the thread.
        self._rows.put(self._text.end(interrupted))
        self._rows.put(None)
        self._thread.join(PATIENCE)
        if self._failure:
            return f"Cannot write {self._target}: {self._failure}."
        if self._thread.is_alive():
            missing = min(self.num_rows, max(1, self._rows.qsize() - 2))
            return f"The disk is stalled: the last {missing} rows of {self.path} are not on it."
        return None

    def _write(self) -> None:
        """Write the queued texts, in the thread, until the queue ends.

        Python's buffers are not used, because a stalled thread would lock them.
        """
        try:
            # Write each text, and force the file to the disk now and then.
            synced = time.monotonic()
            while (text := self._rows.get()) is not None:
                _write_all(self._file, text.encode())
                if time.monotonic() - synced >= SYNC_PERIOD:
                    self._restore()
                    os.fsync(self._file)
                    synced = time.monotonic()
            # Remove a file without rows, or finish it and give it its name.
            if not self.num_rows and not self._rename:
                self.path.unlink(missing_ok=True)
                return
            self._restore()
            os.fsync(self._file)
            if self._rename and not self._failure:
                os.replace(self.path, self._target)
            _sync_folder(self.path.parent)
        except OSError as error:
            self._failure = error
        finally:
            os.close(self._file)

    def _restore(self) -> None:
        """Write the whole file again if it was removed."""
        with contextlib.suppress(OSError):
            if os.path.samestat(os.stat(self.path), os.fstat(self._file)):
                return
        # Create a new file, in the temporary folder if need be.
        removed = self._file
        try:
            self._target.parent.mkdir(parents=True, exist_ok=True)
            self.path, self._file = self._open(self._target.parent)
        except OSError as error:
            self.path, self._file = self._open(Path(tempfile.gettempdir()))
            self._failure = OSError(f"{error}; what was recorded is in {self.path}")
        # Copy the removed file, which stays readable while it is open.
        size = 0
        while data := os.pread(removed, CHUNK, size):
            _write_all(self._file, data)
            size += len(data)
        os.close(removed)


def _write_all(file: int, data: bytes) -> None:
    """Write all bytes to a file descriptor."""
    while data:
        data = data[os.write(file, data) :]


def _sync_folder(folder: Path) -> None:
    """Force the names of a folder's files to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
