"""Recordings that are written to disk sample by sample."""

from pathlib import Path

from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort

from limb_systems import LimbSystem
from limb_systems.files.recording import RecordingHeader
from limb_systems.files.samples import column_names
from limb_systems.files.tables import TableWriter
from limb_systems.model.ownership import weak_method
from limb_systems.schema import dump_typed

SIGNALS = ("measured_temperature", "bend_angle")
OF_ROBOTS = ("applied_duty", "board_time", "sample_age")  # where the limb has them


class Journal(LeafSystem):
    """Writes each sample of a limb to a file when it arrives.

    Until `close`, the file is a recording without its end line. If the program
    dies, `Recording.load(path, unfinished=True)` reads the samples up to then.

    - input 0 ``duty``: D (2), in [0, 1]
    - input 1 ``measured_temperature``: V (2), °C
    - input 2 ``bend_angle``: φ (1), rad
    - from input 3 on, where the limb has such outputs: ``applied_duty`` (2),
      ``board_time`` and ``sample_age`` (1), s
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, path: str | Path, limb: LimbSystem, sample_rate: float):
        """
        Args:
            path: of the file, which is written anew.
            limb: whose ``parameters`` and ``source`` go into the header.
            sample_rate: Hz.
        """
        super().__init__()
        names = column_names(limb.parameters)
        header = RecordingHeader(limb.source, sample_rate, limb.parameters)
        signals = ["duty", *journaled(limb)]
        columns = [column for signal in ("time", *signals) for column in names[signal]]
        self._writer = TableWriter(path, "recording", dump_typed(header), columns)
        for signal in signals:
            self.DeclareVectorInputPort(signal, len(names[signal]))
        self.DeclarePeriodicPublishEvent(1 / sample_rate, 0.0, weak_method(self._append))
        self.set_name("journal")

    def close(self) -> None:
        """Writes the end line and closes the file."""
        self._writer.close()

    def _append(self, context):
        values = [context.get_time()]
        for index in range(self.num_input_ports()):
            values += self.get_input_port(index).Eval(context).tolist()
        self._writer.append(values)


def journaled(limb: LimbSystem) -> list[str]:
    """Names of the limb's outputs that are written to its journal."""
    return [*SIGNALS, *(name for name in OF_ROBOTS if limb.HasOutputPort(name))]


def add_journal(
    builder: DiagramBuilder,
    path: str | Path,
    limb: LimbSystem,
    duty: OutputPort,
    sample_rate: float,
) -> Journal:
    """Adds a journal of a limb, driven by a port of duty, to a diagram."""
    journal = builder.AddSystem(Journal(path, limb, sample_rate))
    builder.Connect(duty, journal.GetInputPort("duty"))
    for name in journaled(limb):
        builder.Connect(limb.GetOutputPort(name), journal.GetInputPort(name))
    return journal
