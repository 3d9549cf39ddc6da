"""Recordings that are on disk while they are made."""

from pathlib import Path

from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort, System

from limb_systems.files.recording import RecordingHeader
from limb_systems.files.samples import column_names
from limb_systems.files.tables import TableWriter
from limb_systems.model.ownership import weak_method
from limb_systems.schema import dump_typed

SIGNALS = ("duty", "measured_temperature", "bend_angle")


class Journal(LeafSystem):
    """Writes each sample of a limb to a file as it comes.

    The file is a recording without its end until `close`; whatever happens to
    the program, `Recording.load(path, unfinished=True)` reads what is there.

    - input 0 ``duty``: D (2), in [0, 1]
    - input 1 ``measured_temperature``: V (2), °C
    - input 2 ``bend_angle``: φ (1), rad
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, path: str | Path, limb: System, sample_rate: float):
        """
        Args:
            path: of the file, which is written anew.
            limb: whose ``parameters`` and ``source`` go into the header.
            sample_rate: Hz.
        """
        super().__init__()
        names = column_names(limb.parameters)
        header = RecordingHeader(limb.source, sample_rate, limb.parameters)
        columns = [column for signal in ("time", *SIGNALS) for column in names[signal]]
        self._writer = TableWriter(path, "recording", dump_typed(header), columns)
        for signal in SIGNALS:
            self.DeclareVectorInputPort(signal, len(names[signal]))
        self.DeclarePeriodicPublishEvent(1 / sample_rate, 0.0, weak_method(self._append))
        self.set_name("journal")

    def close(self) -> None:
        """Ends the file."""
        self._writer.close()

    def _append(self, context):
        values = [context.get_time()]
        for index in range(len(SIGNALS)):
            values += self.get_input_port(index).Eval(context).tolist()
        self._writer.append(values)


def add_journal(
    builder: DiagramBuilder, path: str | Path, limb: System, duty: OutputPort, sample_rate: float
) -> Journal:
    """Adds a journal of a limb, driven by a port of duty, to a diagram."""
    journal = builder.AddSystem(Journal(path, limb, sample_rate))
    builder.Connect(duty, journal.GetInputPort("duty"))
    for name in SIGNALS[1:]:
        builder.Connect(limb.GetOutputPort(name), journal.GetInputPort(name))
    return journal
