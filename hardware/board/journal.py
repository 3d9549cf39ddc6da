"""Recordings that are written to disk sample by sample."""

import contextlib
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort

from hardware.board.listener import Signals, listen, ports_of_run
from limb_systems import LimbSystem, Recording
from limb_systems.files.signal_table import clip_rounding, column_names
from limb_systems.files.table_writer import TableWriter
from limb_systems.simulation import RecordOptions

ROBOT_SIGNALS = ("applied_duty", "board_time", "sample_age", "body_pose")  # if the limb has them
STOPPED_BY_SIGNAL = "stopped by Ctrl-C or a signal"


def closing(limb: Any) -> contextlib.AbstractContextManager:
    """Return a context that closes a robot at its end, also after an error; other limbs stay."""
    return contextlib.closing(limb) if limb.real_time else contextlib.nullcontext()


@contextlib.contextmanager
def open_journal(
    builder: DiagramBuilder,
    path: str | Path | None,
    limb: LimbSystem,
    duty: OutputPort,
    options: RecordOptions,
    *,
    ended_by_hand: bool = False,
    kind: str = "",
    may_wait: bool = False,
) -> Iterator[TableWriter | None]:
    """Write a journal of a limb in a context in which its diagram is built and run.

    It yields the `TableWriter` of the file, or None. Each sample is written when it arrives. The
    file gets its name when the context ends. After an error the file says so and keeps its
    unfinished name. A robot is closed before waiting for the disk.

    Args:
        builder: builder of the diagram, to which the journal is added.
        path: file; no journal if None.
        limb: limb whose ``parameters`` and ``source`` go into the header.
        duty: port that drives the limb.
        options: sample rate, provenance and reference of the recording.
        ended_by_hand: whether Ctrl-C is a regular end, after which the file gets its name.
        kind: kind of the recording, see `Recording`.
        may_wait: as for `TableWriter`.

    Raises:
        OutputError: if the file cannot be made, or is not on the disk in the end.
    """
    if path is None:
        yield None
        return
    # Name the columns; the header comes from a recording without samples.
    ports = ports_of_run(limb, duty, ROBOT_SIGNALS, options.reference)
    robot = getattr(limb, "robot", None)
    names = column_names(limb.parameters, robot)
    columns = list(names["time"])
    for name in ports:
        columns += names[name]
    empty: dict[str, Any] = {}
    for name in ("duty", *Recording.MEASURED):
        empty[name] = np.empty((len(names[name]), 0))
    header = Recording(
        source=limb.source,
        sample_rate=options.sample_rate,
        parameters=limb.parameters,
        robot=robot,
        provenance=options.provenance,
        kind=kind,
        time=np.empty(0),
        **empty,
    ).header()
    writer = TableWriter(path, Recording.KIND, header, columns, may_wait=may_wait)

    def append(time: float, signals: Signals) -> None:
        duty, *others = signals.values()
        writer.append([time, *clip_rounding(duty), *np.concatenate(others)])

    try:
        with closing(limb):
            # Connect the journal to the limb, and let the caller run the diagram.
            listen(builder, ports, options.sample_rate, append)
            yield writer
    except BaseException as error:
        # Keep the samples, and why there are no more.
        is_interrupt = isinstance(error, KeyboardInterrupt)
        if is_interrupt and ended_by_hand and writer.num_rows:
            writer.finish(STOPPED_BY_SIGNAL)
            warnings.warn(f"The recording until then is in {path}.", stacklevel=3)
        else:
            reason = str(error) or type(error).__name__
            writer.abandon(STOPPED_BY_SIGNAL if is_interrupt else reason)
        raise
    writer.finish()
