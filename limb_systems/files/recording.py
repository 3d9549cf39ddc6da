"""What was measured on a limb, model or robot, over time."""

import dataclasses
import importlib
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from limb_systems.connected_limbs import ConnectedLimbs
from limb_systems.errors import LimbError
from limb_systems.files.provenance import Provenance
from limb_systems.files.schema import check_text, rare
from limb_systems.files.signal_table import Samples, not_saved, sample_rate, signal
from limb_systems.limb_parameters import LimbParameters
from limb_systems.summary import Entry, Summary

LONGEST_PERIOD, HIGHEST_RATE = 10_000.0, 1e6  # s and Hz, of samples
LOG_IMPORT = "calibration.import_logs.importing"  # module that reads logs of other programs


@dataclasses.dataclass(eq=False, repr=False, kw_only=True)
class Recording(Samples):
    """Samples from a limb with F bends, n joints and W wires.

    Measured values are kept whatever they are: a reading of 700 °C is a fact about its
    sensor. Whoever calculates with them calls `check_plausible`. A reading that is missing
    is nan, an empty cell in the file; time and duty are known all the same.

    - ``time``: time of the samples (K,), s, increasing.
    - ``duty``: duty (W, K), in [0, 1], in force when the sample was taken; a command
      that changes at that very time appears in the next sample.
    - ``measured_temperature``: V (W, K), °C; nan where it is missing.
    - ``bend_angle``: φ (F, K), rad; nan where it is missing.
    - ``parameters``: parameters of the limb, as far as they are known.
    - ``source``: a line of text that names what was recorded.
    - ``sample_rate``: nominal rate of the samples, Hz.
    - ``wire_temperature``: T (W, K), °C, of a model; else None.
    - ``joint_state``: [θ, θ̇] (2n, K), rad and rad/s, of a model; else None.
    - ``reference``: bend angles that were asked for (F, K), rad; None if none was.
    - ``applied_duty``: duty that was applied to the wires when the sample was
      taken (W, K), in [0, 1]; None if it is not known.
    - ``board_time``: time at which the sample was taken, by the board's clock (K,), s;
      None without a board.
    - ``sample_age``: time from the sample's arrival to ``time`` (K,), s; None
      without a board.
    - ``interrupted``: why it ended before its time, in a line of text, such as the
      fault of a board; empty if it did not.
    - ``provenance``: what made it; None if it is not known.
    - ``robot``: the connected limbs, such as a robot's, of which ``parameters`` is all together;
      None if it is a limb.
    - ``body_pose``: pose of the robot's body, (3, K): x, z, m, and θ, rad, from +x towards +z; or
      (6, K): x, y, z, m, roll, pitch, yaw, rad; None if it is not known.
    - ``contact_force``: force from the ground on each foot, N, along x and z (2L, K), or along x,
      y and z (3L, K); None if it is not known.
    - ``kind``: what calibration takes it for, as `calibration.kind_of` lists; empty if nobody has
      said so.
    - ``title``: what messages of calibration call it; no file has it. Its source if empty.

    Raises:
        LimbError: at construction, if shapes disagree or other values are not
            finite, if time does not increase or duty leaves [0, 1], or if the
            source cannot be printed.
    """

    KIND: ClassVar[str] = "recording"
    MEASURED: ClassVar[tuple[str, ...]] = ("measured_temperature", "bend_angle")
    source: str
    sample_rate: float = sample_rate(dataclasses.MISSING)
    parameters: LimbParameters = None  # type: ignore[assignment]  # those of the robot
    provenance: Provenance | None = None
    robot: ConnectedLimbs | None = None
    kind: str = rare("")
    time: np.ndarray = signal()
    duty: np.ndarray = signal()
    measured_temperature: np.ndarray = signal()
    bend_angle: np.ndarray = signal()
    wire_temperature: np.ndarray | None = signal(None)
    joint_state: np.ndarray | None = signal(None)
    reference: np.ndarray | None = signal(None)
    applied_duty: np.ndarray | None = signal(None)
    board_time: np.ndarray | None = signal(None)
    sample_age: np.ndarray | None = signal(None)
    body_pose: np.ndarray | None = signal(None)
    contact_force: np.ndarray | None = signal(None)
    interrupted: str = not_saved("")
    title: str = not_saved("")

    def __post_init__(self):
        check_text(self.source, "source")
        check_text(self.kind, "kind")
        check_text(self.interrupted, "interrupted")
        if self.parameters is None:
            if self.robot is None:
                raise LimbError("parameters is missing.")
            self.parameters = self.robot.as_single_limb
        self._check()
        if not 1 / LONGEST_PERIOD <= self.sample_rate <= HIGHEST_RATE:
            raise LimbError(
                f"sample_rate is {self.sample_rate!r} Hz; it must be from {1 / LONGEST_PERIOD:g} "
                f"to {HIGHEST_RATE:g} Hz."
            )

    @property
    def heating_duty(self) -> np.ndarray:
        """The duty that was applied, if it is known, else the one that was commanded (W, K)."""
        return self.duty if self.applied_duty is None else self.applied_duty

    @property
    def implausible(self) -> np.ndarray:
        """Whether V or φ is beyond -60 °C to 600 °C, or -π to π, at each sample (K,)."""
        return self._outside(self.MEASURED)

    @property
    def missing(self) -> np.ndarray:
        """Whether a reading of V or φ is missing, at each sample (K,).

        A wire whose readings are all missing has no thermocouple, and does not count.
        """
        readings = self.measured_temperature[self.has_thermocouple]
        return np.isnan(np.vstack([readings, self.bend_angle])).any(axis=0)

    @property
    def has_thermocouple(self) -> np.ndarray:
        """Whether there is any reading of each wire (W,)."""
        return ~np.isnan(self.measured_temperature).all(axis=1)

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
        if sentence := self._first_outside(self.MEASURED):
            raise LimbError(sentence)

    def summary(self) -> Summary:
        """Source, duration, samples, range of bends, travel, largest temperature; its trouble."""
        count, missing = len(self.time), self.missing
        entries = [Entry("source", self.source), Entry("kind", self.kind)]
        if count:
            entries.append(Entry("duration", float(self.time[-1] - self.time[0]), "s"))
        entries.append(Entry("samples", count, "", f"{count or 'no'} samples"))
        if not np.isnan(self.bend_angle).all():
            entries.append(self._bend_entry())
        if self.body_pose is not None and count:
            moved = self.body_pose[:, -1] - self.body_pose[:, 0]
            in_space = len(moved) == 6
            travel = float(np.linalg.norm(moved[:2]) if in_space else moved[0])
            entries.append(Entry("travel", travel, "m", f"travel {1e3 * travel:.1f} mm"))
            if in_space:
                turn = float(np.diff(np.unwrap(self.body_pose[5])[[0, -1]])[0])
                entries.append(Entry("turn", turn, "rad", f"turn {np.rad2deg(turn):.1f}°"))
        if self.has_thermocouple.any():
            heat = float(np.nanmax(self.measured_temperature))
            entries.append(Entry("heat", heat, "°C", f"up to {heat:.0f} °C"))
        if self.interrupted:
            entries.append(Entry("end", self.interrupted, "", f"interrupted: {self.interrupted}"))
        if number := int(missing.sum()):
            entries.append(Entry("missing", number, "", f"{number} of {count} samples missing"))
        if self.doubt:
            entries.append(Entry("doubt", self.doubt))
        return Summary(entries)

    @property
    def how(self) -> str:
        """How it was made, in a word for labels: "simulated", "emulated" or "recorded"."""
        if self.source.startswith(
            ("emulated limb", "emulated robot", "limb twin")
        ):  # the latter through a board
            return "emulated"
        known_to_a_model = (self.joint_state, self.wire_temperature)
        if self.source.startswith("model") or any(s is not None for s in known_to_a_model):
            return "simulated"
        return "recorded"

    @property
    def origin(self) -> str:
        """What the joints of the limb show, and how they came about, for a caption."""
        if self.joint_state is None:
            return f"{self.how} bend angle ({self.source}), drawn as constant curvature"
        return f"{self.how} joint angles ({self.source}), nothing measured"

    @classmethod
    def from_log(
        cls,
        path: str | Path,
        mapping: Any = None,
        parameters: LimbParameters | None = None,
    ) -> "Recording":
        """Reads a log of another program, as far as one limb goes without a gap.

        What was left out is said in a warning; `calibration.import_logs` has all of it.

        Args:
            mapping: a `LogMapping` of the log's columns, or its YAML file; what the log itself
                shows if None.
            parameters: the limb's description; the nominal limb, with the wires of the mapping,
                if None.

        Raises:
            LogError: with one sentence, if it is no log, lacks what a recording needs, or leaves
                something open.
        """
        # The import is above files, and files do not depend on it: it is found when it is called.
        importing = importlib.import_module(LOG_IMPORT)
        return importing.recording_from_log(path, mapping, parameters)
