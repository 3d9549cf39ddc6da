"""Recordings: signals over time that were measured on a limb, model or robot."""

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
    sensor. Call `check_plausible` before calculating with them. A missing reading is nan, an
    empty cell in the file; time and duty are never missing.

    - ``time``: time of the samples (K,), s, increasing.
    - ``duty``: duty (W, K), in [0, 1], in force when the sample was taken; a command
      that changes at that very time appears in the next sample.
    - ``measured_temperature``: V (W, K), °C; nan where it is missing.
    - ``bend_angle``: φ (F, K), rad; nan where it is missing.
    - ``parameters``: parameters of the limb, as far as they are known.
    - ``source``: a line of text that names the recorded limb or system.
    - ``sample_rate``: nominal rate of the samples, Hz.
    - ``wire_temperature``: T (W, K), °C, of a model; else None.
    - ``joint_state``: [θ, θ̇] (2n, K), rad and rad/s, of a model; else None.
    - ``reference``: desired bend angles (F, K), rad; None if there were none.
    - ``applied_duty``: duty that was applied to the wires when the sample was
      taken (W, K), in [0, 1]; None if it is not known.
    - ``board_time``: time at which the sample was taken, by the board's clock (K,), s;
      None without a board.
    - ``sample_age``: time from the sample's arrival to ``time`` (K,), s; None
      without a board.
    - ``interrupted``: the reason why it ended early, in a line of text, such as the
      fault of a board; empty if it did not.
    - ``provenance``: its provenance; None if it is not known.
    - ``robot``: the connected limbs, such as a robot's, whose ``as_single_limb`` is
      ``parameters``; None if it is a limb.
    - ``body_pose``: pose of the robot's body, (3, K): x, z, m, and θ, rad, from +x towards +z; or
      (6, K): x, y, z, m, roll, pitch, yaw, rad; None if it is not known.
    - ``contact_force``: force from the ground on each foot, N, along x and z (2L, K), or along x,
      y and z (3L, K); None if it is not known.
    - ``kind``: kind of the experiment, as `calibration.kind_of` lists; empty if it is unknown.
    - ``title``: name in messages of calibration, which is in no file; its source if empty.

    Raises:
        LimbError: at construction, if shapes disagree or other values are not
            finite, if time does not increase or duty leaves [0, 1], or if the
            source cannot be printed.
    """

    KIND: ClassVar[str] = "recording"
    MEASURED: ClassVar[tuple[str, ...]] = ("measured_temperature", "bend_angle")
    source: str
    sample_rate: float = sample_rate(dataclasses.MISSING)
    parameters: LimbParameters = None  # type: ignore[assignment]  # by default the robot's
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
        """The applied duty (W, K) if it is known, else the commanded duty."""
        return self.duty if self.applied_duty is None else self.applied_duty

    @property
    def implausible(self) -> np.ndarray:
        """True at each sample (K,) where V is beyond -60 °C to 600 °C, or φ beyond -π to π."""
        return self._outside(self.MEASURED)

    @property
    def missing(self) -> np.ndarray:
        """True at each sample (K,) where a reading of V or φ is missing.

        A wire whose readings are all missing has no thermocouple, and does not count.
        """
        readings = self.measured_temperature[self.has_thermocouple]
        return np.isnan(np.vstack([readings, self.bend_angle])).any(axis=0)

    @property
    def has_thermocouple(self) -> np.ndarray:
        """True for each wire (W,) that has any reading."""
        return ~np.isnan(self.measured_temperature).all(axis=1)

    @property
    def usable(self) -> np.ndarray:
        """True at each sample (K,) where V and φ are present and plausible."""
        return ~(self.missing | self.implausible)

    @property
    def doubt(self) -> str:
        """The number of implausible samples and the time of the first; empty if there are none."""
        if not (count := int(self.implausible.sum())):
            return ""
        first = self.time[np.argmax(self.implausible)]
        return f"{count} of {len(self.time)} samples out of range, the first at {first:g} s"

    def check_plausible(self) -> None:
        """Raise LimbError, with the first value that is not plausible, if there is one."""
        if sentence := self._first_outside(self.MEASURED):
            raise LimbError(sentence)

    def summary(self) -> Summary:
        """Return source, duration, samples, bends, travel, largest temperature, and faults."""
        num_samples = len(self.time)
        entries = [Entry("source", self.source), Entry("kind", self.kind)]
        if num_samples:
            entries.append(Entry("duration", float(self.time[-1] - self.time[0]), "s"))
        entries.append(Entry("samples", num_samples, "", f"{num_samples or 'no'} samples"))
        # Add the motion and the heat.
        if not np.isnan(self.bend_angle).all():
            entries.append(self._bend_entry())
        if self.body_pose is not None and num_samples:
            moved = self.body_pose[:, -1] - self.body_pose[:, 0]
            is_in_space = len(moved) == 6
            travel = float(np.linalg.norm(moved[:2]) if is_in_space else moved[0])
            entries.append(Entry("travel", travel, "m", f"travel {1e3 * travel:.1f} mm"))
            if is_in_space:
                turn = float(np.diff(np.unwrap(self.body_pose[5])[[0, -1]])[0])
                entries.append(Entry("turn", turn, "rad", f"turn {np.rad2deg(turn):.1f}°"))
        if self.has_thermocouple.any():
            heat = float(np.nanmax(self.measured_temperature))
            entries.append(Entry("heat", heat, "°C", f"up to {heat:.0f} °C"))
        # Add the faults.
        if self.interrupted:
            entries.append(Entry("end", self.interrupted, "", f"interrupted: {self.interrupted}"))
        num_missing = int(self.missing.sum())
        if num_missing:
            sentence = f"{num_missing} of {num_samples} samples missing"
            entries.append(Entry("missing", num_missing, "", sentence))
        if self.doubt:
            entries.append(Entry("doubt", self.doubt))
        return Summary(entries)

    @property
    def how(self) -> str:
        """The origin in a word for labels: "simulated", "emulated" or "recorded"."""
        # An emulated limb behind a board is named limb twin.
        if self.source.startswith(("emulated limb", "emulated robot", "limb twin")):
            return "emulated"
        has_model_signals = self.joint_state is not None or self.wire_temperature is not None
        if self.source.startswith("model") or has_model_signals:
            return "simulated"
        return "recorded"

    @property
    def origin(self) -> str:
        """A caption: the source of the joint angles that a picture of the limb shows."""
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
        """Read a log of another program: the samples of one limb until the first gap.

        A warning names the samples that are left out; `calibration.import_logs` reads all.

        Args:
            mapping: a `LogMapping` of the log's columns, or its YAML file; guessed from the log
                if None.
            parameters: the limb's description; the nominal limb, with the wires of the mapping,
                if None.

        Raises:
            LogError: with one sentence, if it is no log, lacks a signal that a recording needs,
                or is ambiguous.
        """
        # This package does not depend on the calibration: the module is found by its name.
        importing = importlib.import_module(LOG_IMPORT)
        return importing.recording_from_log(path, mapping, parameters)
