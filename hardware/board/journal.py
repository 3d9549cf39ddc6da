"""Recordings that are written to disk sample by sample."""

import contextlib
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort

from limb_systems import LimbSystem, Provenance, Recording
from limb_systems.drake_python import weak_method
from limb_systems.files.signal_table import clip_rounding, column_names
from limb_systems.files.table_writer import TableWriter

SIGNALS = ("measured_temperature", "bend_angle")
OF_ROBOTS = ("applied_duty", "board_time", "sample_age", "body_pose")  # where the limb has them
STOPPED = "stopped by Ctrl-C or a signal"


class Journal(LeafSystem):
    """Hands each sample of a limb to a `TableWriter` when it arrives.

    If the program dies, `Recording.load(journal.writer.path, unfinished=True)`
    reads the samples up to then.

    - input 0 ``duty``: D (2), in [0, 1]
    - input 1 ``measured_temperature``: V (2), °C
    - input 2 ``bend_angle``: φ (1), rad
    - from input 3 on, where the limb has such outputs: ``applied_duty`` (2),
      ``board_time`` and ``sample_age`` (1), s, and ``body_pose``; last, if there is one,
      ``reference`` (1), rad

    ``writer`` has the file, ``signals`` the names of the inputs.
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(
        self,
        path: str | Path,
        limb: LimbSystem,
        sample_rate: float,
        *,
        has_reference: bool = False,
        provenance: Provenance | None = None,
        kind: str = "",
        may_wait: bool = False,
    ):
        """
        Args:
            path: file, as it is named when it is finished.
            limb: limb whose ``parameters`` and ``source`` go into the header.
            sample_rate: Hz.
            has_reference: whether there is an input for the bend angle that is asked for.
            provenance: origin of the recording; None if it is not known.
            kind: kind of the recording, as of `Recording`.
            may_wait: as for `TableWriter`.

        Raises:
            OutputError: if no file can be made there.
        """
        super().__init__()
        robot = getattr(limb, "robot", None)
        names = column_names(limb.parameters, robot)
        signals: Any = {name: np.empty((len(names[name]), 0)) for name in ("duty", *SIGNALS)}
        empty = Recording(
            source=limb.source,
            sample_rate=sample_rate,
            parameters=limb.parameters,
            robot=robot,
            provenance=provenance,
            kind=kind,
            time=np.empty(0),
            **signals,
        )
        self.signals = ["duty", *SIGNALS, *filter(limb.HasOutputPort, OF_ROBOTS)]
        self.signals += ["reference"] * has_reference
        columns = [column for signal in ("time", *self.signals) for column in names[signal]]
        for signal in self.signals:
            self.DeclareVectorInputPort(signal, len(names[signal]))
        self.DeclarePeriodicPublishEvent(1 / sample_rate, 0.0, weak_method(self._append))
        self.writer = TableWriter(path, Recording.KIND, empty.header(), columns, may_wait=may_wait)

    def _append(self, context):
        duty, *others = (
            self.get_input_port(index).Eval(context) for index in range(self.num_input_ports())
        )
        self.writer.append([context.get_time(), *clip_rounding(duty), *np.concatenate(others)])


def closing(limb: Any) -> contextlib.AbstractContextManager:
    """A context at whose end a robot is closed, also after an error; no other limb has to be."""
    return contextlib.closing(limb) if limb.real_time else contextlib.nullcontext()


@contextlib.contextmanager
def journaled(
    builder: DiagramBuilder,
    path: str | Path | None,
    limb: LimbSystem,
    duty: OutputPort,
    sample_rate: float,
    *,
    reference: OutputPort | None = None,
    provenance: Provenance | None = None,
    ended_by_hand: bool = False,
    kind: str = "",
    may_wait: bool = False,
) -> Iterator[TableWriter | None]:
    """A context in which a diagram is built and run, with a journal of its limb.

    It yields the writer of the file, if there is one. The file gets its name when the
    context ends. If that is by an error, the file says so and keeps the name of an unfinished
    one. A robot is closed before the disk is waited for.

    Args:
        builder: builder of the diagram, to which the journal is added.
        path: file; there is no journal if it is None.
        duty: the port that drives the limb.
        reference: port of the bend angle that is asked for.
        provenance, kind, may_wait: as for `Journal`.
        ended_by_hand: whether what there is when Ctrl-C comes is a recording: the file then
            gets its name.

    Raises:
        OutputError: if the file cannot be made, or is not on the disk in the end.
    """
    if path is None:
        yield None
        return
    journal = Journal(
        path,
        limb,
        sample_rate,
        has_reference=reference is not None,
        provenance=provenance,
        kind=kind,
        may_wait=may_wait,
    )
    writer = journal.writer
    try:
        with closing(limb):
            builder.AddSystem(journal)
            ports = {"duty": duty, "reference": reference}
            for name in journal.signals:
                port = ports[name] if name in ports else limb.GetOutputPort(name)
                builder.Connect(port, journal.GetInputPort(name))
            yield writer
    except BaseException as error:
        stopped = isinstance(error, KeyboardInterrupt)
        if stopped and ended_by_hand and writer.num_rows:
            writer.finish(STOPPED)
            warnings.warn(f"What was recorded until then is in {path}.", stacklevel=3)
        else:
            writer.abandon(STOPPED if stopped else str(error) or type(error).__name__)
        raise
    writer.finish()
