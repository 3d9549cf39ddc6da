"""What was measured on a limb, model or robot, over time."""

import dataclasses
from pathlib import Path

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.files.samples import check_samples, column_names, group_columns, ungroup_columns
from limb_systems.files.tables import FileFormatError, read_table, write_table
from limb_systems.model.parameters import LimbParameters
from limb_systems.schema import dump_typed, load_typed

OPTIONAL = ("wire_temperature", "joint_state", "reference")


@dataclasses.dataclass
class RecordingHeader:
    """What a recording's file says before its columns begin.

    - ``source``: what was recorded, in words.
    - ``sample_rate_hz``: nominal rate of the samples, Hz.
    - ``parameters``: of the limb as it was known when it was recorded.
    """

    source: str
    sample_rate_hz: float
    parameters: LimbParameters


@dataclasses.dataclass(eq=False)
class Recording:
    """Samples from a limb with S segments, n joints and W = 2 S wires.

    - ``time``: (K,), s, increasing.
    - ``duty``: (W, K), in [0, 1], in force when the sample was taken; a new
      command at that very time is seen one sample later.
    - ``measured_temperature``: V (W, K), °C.
    - ``bend_angle``: φ (S, K), rad.
    - ``parameters``: of the limb as it is known.
    - ``source``: what was recorded, in words.
    - ``sample_rate``: nominal, Hz.
    - ``wire_temperature``: T (W, K), °C; only a model can tell, else None.
    - ``joint_state``: [θ, θ̇] (2n, K), rad and rad/s; likewise.
    - ``reference``: the bend angle that was asked for (S, K), rad, if any was.

    Raises:
        LimbError: at construction, if shapes disagree or values are not
            finite, if time does not increase or duty leaves [0, 1].
    """

    time: np.ndarray
    duty: np.ndarray
    measured_temperature: np.ndarray
    bend_angle: np.ndarray
    parameters: LimbParameters
    source: str
    sample_rate: float
    wire_temperature: np.ndarray | None = None
    joint_state: np.ndarray | None = None
    reference: np.ndarray | None = None

    def __post_init__(self):
        self.parameters.validate()
        check_samples(self, optional=OPTIONAL)
        if not (np.isfinite(self.sample_rate) and self.sample_rate > 0):
            raise LimbError(f"sample_rate is {self.sample_rate!r} Hz; it must be positive.")

    @classmethod
    def load(cls, path: str | Path, *, unfinished: bool = False) -> "Recording":
        """Reads a recording's file.

        Args:
            unfinished: whether the file may lack its end, because the program
                that recorded was killed.

        Raises:
            FileFormatError: one sentence that says what is wrong and where.
        """
        header_text, columns = read_table(path, "recording", unfinished=unfinished)
        try:
            header = load_typed(RecordingHeader, header_text)
            header.parameters.validate()
            names = column_names(header.parameters)
            return cls(
                **group_columns(columns, names, optional=OPTIONAL),
                parameters=header.parameters,
                source=header.source,
                sample_rate=header.sample_rate_hz,
            )
        except LimbError as error:
            raise FileFormatError(f"{path}: {error}") from error

    def save(self, path: str | Path) -> None:
        """Writes the recording whole or not at all."""
        header = RecordingHeader(self.source, float(self.sample_rate), self.parameters)
        columns = ungroup_columns(self, column_names(self.parameters))
        write_table(path, "recording", dump_typed(header), columns)
