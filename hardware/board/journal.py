"""Recordings that are written to disk sample by sample."""

import contextlib
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort

from limb_systems import LimbSystem, Recording
from limb_systems.drake_python import weak_method
from limb_systems.files.signal_table import clip_rounding, column_names
from limb_systems.files.table_writer import TableWriter
from limb_systems.simulation import RecordOptions

SIGNALS = ("measured_temperature", "bend_angle")
ROBOT_SIGNALS = ("applied_duty", "board_time", "sample_age", "body_pose")  # if the limb has them
STOPPED_BY_SIGNAL = "stopped by Ctrl-C or a signal"


class Journal(LeafSystem):
    """Writes each sample of a limb to disk when it arrives, through a `TableWriter`.

    If the program dies, `Recording.load(journal.writer.path, unfinished=True)`
    reads the samples that arrived before.

    For a limb of W wires and F bends:

    - input 0 ``duty``: D (W), in [0, 1]
    - input 1 ``measured_temperature``: V (W), °C
    - input 2 ``bend_angle``: φ (F), rad
    - from input 3 on, where the limb has such outputs: ``applied_duty`` (W), in [0, 1];
      ``board_time`` (1) and ``sample_age`` (1), s; ``body_pose`` (3 or 6), m and rad; last, if
      there is one, ``reference`` (F), rad

    ``writer`` has the file, ``signals`` the names of the inputs.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(
        self,
        path: str | Path,
        limb: LimbSystem,
        options: RecordOptions,
        *,
        kind: str = "",
        may_wait: bool = False,
    ):
        """
        Args:
            path: name of the finished file.
            limb: limb whose ``parameters`` and ``source`` go into the header.
            options: sample rate and provenance of the recording, and whether it has a reference.
            kind: kind of the recording, see `Recording`.
            may_wait: as for `TableWriter`.

        Raises:
            OutputError: if no file can be made there.
        """
        super().__init__()
        # The header comes from a recording without samples.
        robot = getattr(limb, "robot", None)
        names = column_names(limb.parameters, robot)
        signals: Any = {name: np.empty((len(names[name]), 0)) for name in ("duty", *SIGNALS)}
        empty = Recording(
            source=limb.source,
            sample_rate=options.sample_rate,
            parameters=limb.parameters,
            robot=robot,
            provenance=options.provenance,
            kind=kind,
            time=np.empty(0),
            **signals,
        )
        # Declare an input for each signal, whose columns follow the time.
        self.signals = ["duty", *SIGNALS, *filter(limb.HasOutputPort, ROBOT_SIGNALS)]
        if options.reference:
            self.signals.append("reference")
        columns = list(names["time"])
        for signal in self.signals:
            columns += names[signal]
            self.DeclareVectorInputPort(signal, len(names[signal]))
        self.DeclarePeriodicPublishEvent(1 / options.sample_rate, 0.0, weak_method(self._append))
        self.writer = TableWriter(path, Recording.KIND, empty.header(), columns, may_wait=may_wait)

    def _append(self, context):
        indices = range(self.num_input_ports())
        duty, *readings = [self.get_input_port(index).Eval(context) for index in indices]
        self.writer.append([context.get_time(), *clip_rounding(duty), *np.concatenate(readings)])


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

    It yields the writer of the file, or None. The file gets its name when the context ends. After
    an error the file says so and keeps its unfinished name. A robot is closed before waiting for
    the disk.

    Args:
        builder: builder of the diagram, to which the journal is added.
        path: file; no journal if None.
        limb, options, kind, may_wait: as for `Journal`.
        duty: port that drives the limb.
        ended_by_hand: whether Ctrl-C is a regular end, after which the file gets its name.

    Raises:
        OutputError: if the file cannot be made, or is not on the disk in the end.
    """
    if path is None:
        yield None
        return
    journal = Journal(path, limb, options, kind=kind, may_wait=may_wait)
    writer = journal.writer
    try:
        with closing(limb):
            # Connect the journal to the limb, and let the caller run the diagram.
            builder.AddSystem(journal)
            ports = {"duty": duty, "reference": options.reference}
            for name in journal.signals:
                port = ports[name] if name in ports else limb.GetOutputPort(name)
                builder.Connect(port, journal.GetInputPort(name))
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
