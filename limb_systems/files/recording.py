"""What was measured on a limb, model or robot, over time."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from limb_systems.display import Shown
from limb_systems.errors import LimbError
from limb_systems.files.frames import frame_of
from limb_systems.files.samples import (
    bend_range,
    check_samples,
    columns_of,
    first_outside,
    group_columns,
    samples_outside,
    ungroup_columns,
)
from limb_systems.files.tables import FileFormatError, read_table, write_table
from limb_systems.model.parameters import LimbParameters
from limb_systems.provenance import Provenance
from limb_systems.schema import check_text, dump_typed, load_typed

if TYPE_CHECKING:  # not all who record have it
    import pandas

MEASURED = ("measured_temperature", "bend_angle")
LONGEST_PERIOD, HIGHEST_RATE = 10_000.0, 1e6  # s and Hz, of samples
OPTIONAL = (
    "wire_temperature",
    "joint_state",
    "reference",
    "applied_duty",
    "board_time",
    "sample_age",
)


@dataclasses.dataclass
class RecordingHeader:
    """The header of a recording's file.

    - ``source``: text that names what was recorded.
    - ``sample_rate_hz``: nominal rate of the samples, Hz.
    - ``parameters``: of the limb as it was known when it was recorded.
    - ``provenance``: what made the recording; None if it is not known.
    """

    source: str
    sample_rate_hz: float
    parameters: LimbParameters
    provenance: Provenance | None = None


@dataclasses.dataclass(eq=False, repr=False)
class Recording(Shown):
    """Samples from a limb with S segments, n joints and W wires.

    Measured values are kept whatever they are: a reading of 700 °C is a fact
    about its sensor. `check_plausible` is for who calculates with them. One that is
    missing is nan, an empty cell in the file; time and duty are known all the same.

    - ``time``: (K,), s, increasing.
    - ``duty``: (W, K), in [0, 1], in force when the sample was taken; a command
      that changes at that very time appears in the next sample.
    - ``measured_temperature``: V (W, K), °C; nan where it is missing.
    - ``bend_angle``: φ (S, K), rad; nan where it is missing.
    - ``parameters``: of the limb, as far as it is known.
    - ``source``: a line of text that names what was recorded.
    - ``sample_rate``: nominal, Hz.
    - ``wire_temperature``: T (W, K), °C, of a model; else None.
    - ``joint_state``: [θ, θ̇] (2n, K), rad and rad/s, of a model; else None.
    - ``reference``: the bend angle that was asked for (S, K), rad; None if none was.
    - ``applied_duty``: duty that was applied to the wires when the sample was
      taken (W, K), in [0, 1]; None if it is not known.
    - ``board_time``: when the sample was taken, by the board's clock (K,), s;
      None without a board.
    - ``sample_age``: time from the sample's arrival to ``time`` (K,), s; None
      without a board.
    - ``interrupted``: why it ended before its time, in a line of text, such as the
      fault of a board; empty if it did not.
    - ``provenance``: what made it; None if it is not known.

    Raises:
        LimbError: at construction, if shapes disagree or other values are not
            finite, if time does not increase or duty leaves [0, 1], or if the
            source cannot be printed.
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
    applied_duty: np.ndarray | None = None
    board_time: np.ndarray | None = None
    sample_age: np.ndarray | None = None
    interrupted: str = ""
    provenance: Provenance | None = None

    def __post_init__(self):
        self.parameters.validate()
        check_text(self.source, "source")
        check_text(self.interrupted, "interrupted")
        check_samples(self, optional=OPTIONAL, measured=MEASURED)
        if not 1 / LONGEST_PERIOD <= self.sample_rate <= HIGHEST_RATE:
            raise LimbError(
                f"sample_rate is {self.sample_rate!r} Hz; it must be from {1 / LONGEST_PERIOD:g} "
                f"to {HIGHEST_RATE:g} Hz."
            )

    @property
    def implausible(self) -> np.ndarray:
        """Whether V or φ is beyond what any limb does, at each sample (K,).

        That is, beyond -60 °C to 600 °C, or -π to π.
        """
        return samples_outside(self, MEASURED)

    @property
    def missing(self) -> np.ndarray:
        """Whether a reading of V or φ is missing, at each sample (K,)."""
        return np.isnan(np.vstack([self.measured_temperature, self.bend_angle])).any(axis=0)

    @property
    def usable(self) -> np.ndarray:
        """Whether V and φ are there and plausible, at each sample (K,)."""
        return ~(self.missing | self.implausible)

    @property
    def doubt(self) -> str:
        """How many samples are not plausible, and since when; empty if there are none."""
        if not (count := int(self.implausible.sum())):
            return ""
        first = self.time[np.argmax(self.implausible)]
        return f"{count} of {len(self.time)} samples out of range, the first at {first:g} s"

    def check_plausible(self) -> None:
        """Raises LimbError, with the first value that is not plausible, if there is one."""
        if self.implausible.any():
            raise LimbError(first_outside(self, MEASURED))

    def facts(self) -> dict[str, str]:
        """Source, duration, samples, range of the bend angle, largest temperature; its trouble."""
        trouble = {"end": f"interrupted: {self.interrupted}"} if self.interrupted else {}
        if missing := int(self.missing.sum()):
            trouble["missing"] = f"{missing} of {len(self.time)} samples missing"
        if doubt := self.doubt:
            trouble["doubt"] = doubt
        if self.missing.all():
            return {"source": self.source, "samples": "no samples", **trouble}
        return {
            "source": self.source,
            "duration": f"{self.time[-1] - self.time[0]:g} s",
            "samples": f"{len(self.time)} samples",
            "motion": bend_range(self.bend_angle),
            "heat": f"up to {np.nanmax(self.measured_temperature):.0f} °C",
            **trouble,
        }

    @property
    def how(self) -> str:
        """How it was made, in a word for labels: "simulated", "emulated" or "recorded".

        The source of an emulated limb says so, also if it was recorded through an
        emulated board, and so does that of the model. Only models have T and joints.
        """
        if self.source.startswith(("emulated limb", "limb twin")):
            return "emulated"
        known_to_a_model = (self.joint_state, self.wire_temperature)
        if self.source.startswith("model") or any(s is not None for s in known_to_a_model):
            return "simulated"
        return "recorded"

    @classmethod
    def load(cls, path: str | Path, *, unfinished: bool = False) -> "Recording":
        """Reads a recording's file.

        Args:
            unfinished: whether the file may lack its end, because the program
                that recorded was killed; it is then ``interrupted``.

        Raises:
            FileFormatError: one sentence that says what is wrong and where.
        """
        table = read_table(path, "recording", unfinished=unfinished)
        try:
            header = load_typed(RecordingHeader, table.header)
            header.parameters.validate()
            names = columns_of(cls, header.parameters)
            return cls(
                **group_columns(table.columns, names, optional=OPTIONAL),
                parameters=header.parameters,
                source=header.source,
                sample_rate=header.sample_rate_hz,
                interrupted=table.interrupted,
                provenance=header.provenance,
            )
        except LimbError as error:
            raise FileFormatError(f"{path}: {error}") from error

    def to_pandas(self) -> "pandas.DataFrame":
        """A table as in the file: a row per sample, indexed by time in s, angles in degrees.

        Its ``attrs`` have the unit of each column, the source and the provenance.

        Raises:
            LimbError: if pandas is not installed.
        """
        about = {"source": self.source, "interrupted": self.interrupted}
        return frame_of(self, "recording", about)

    def save(self, path: str | Path) -> None:
        """Writes the recording whole or not at all."""
        header = RecordingHeader(
            self.source, float(self.sample_rate), self.parameters, self.provenance
        )
        columns = ungroup_columns(self, columns_of(Recording, self.parameters))
        write_table(path, "recording", dump_typed(header), columns, self.interrupted)
