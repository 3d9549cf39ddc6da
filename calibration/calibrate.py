"""The whole of Sec. V: recordings in, a calibrated limb out."""

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from calibration.checks import check_recording
from calibration.controller import only_segment
from calibration.damping import DampingFit, fit_damping
from calibration.errors import CalibrationError
from calibration.estimate import Estimate
from calibration.force import ForceFit, fit_force
from calibration.heat import (
    HeatFit,
    ambient_temperature,
    fit_heat_transfer,
    fit_heat_transfer_from_temperature,
)
from calibration.stiffness import StiffnessFit, fit_stiffness
from calibration.validation import Validation, validate
from limb_systems import LimbParameters, LinearLaw, NoBoard, Recording
from limb_systems.errors import LimbError
from limb_systems.progress import Progress

KINDS = ("sag", "ring_down", "left", "right", "both")
HEAT_METHODS = ("bend", "temperature")


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated limb, and all that was learned on the way.

    - ``parameters``: the calibrated `LimbParameters`.
    - ``ambient``: T0 of the recordings, °C.
    - ``stiffness``, ``damping``: the fits of Secs. V-A and V-B; None if there
      was no recording for them and the description's value was kept.
    - ``heat``: [left, right], the fits of Sec. V-C1 that were used.
    - ``heat_compared``: [left, right], those by the other method.
    - ``force``: [left, right], the fits of Sec. V-C2.
    - ``validation``: Sec. V-D, or None without a recording of both wires.
    - ``sources``: what was recorded, for each kind of recording.
    """

    parameters: LimbParameters
    ambient: Estimate
    stiffness: StiffnessFit | None
    damping: DampingFit | None
    heat: list[HeatFit]
    heat_compared: list[HeatFit]
    force: list[ForceFit]
    validation: Validation | None
    sources: dict[str, list[str]]

    @property
    def estimates(self) -> dict[str, Estimate]:
        """All calibrated quantities by their names in the parameters."""
        estimates = {"ambient_temperature": self.ambient}
        if self.stiffness:
            estimates["stiffness"] = self.stiffness.stiffness
        if self.damping:
            estimates["damping"] = self.damping.damping
        for heat, force in zip(self.heat, self.force, strict=True):
            for name in ("a1", "a2", "a3"):
                estimates[f"{heat.wire}.{name}"] = getattr(heat, name)
            estimates[f"{heat.wire}.beta"] = force.beta
        return estimates

    @property
    def remarks(self) -> list[str]:
        """What the recordings lack, in sentences; none if they are good."""
        remarks = []
        for kind in ("left", "right", "both"):
            if (count := len(self.sources.get(kind, []))) > 1:
                remarks.append(f"Of {count} recordings of the kind {kind} only the first was used.")
        for kind, fit in (("sag", self.stiffness), ("ring-down", self.damping)):
            if fit is None:
                remarks.append(f"There is no recording of {kind}: the description's value is kept.")
        fits = (self.stiffness, self.damping, *self.heat, *self.force)
        remarks += [remark for fit in fits if fit for remark in fit.remarks]
        if self.validation is None:
            remarks.append("There is no recording of both wires: the model is not validated.")
        return remarks


def load_recordings(folder: str | Path) -> dict[str, list[Recording]]:
    """The recordings in a folder, checked, by what they show.

    Files named after a kind (``right.csv``, ``sag_3.csv``) must show it; files
    with other names go by what they show.

    Raises:
        CalibrationError: with one sentence naming the file and the trouble.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise CalibrationError(f"There is no folder {folder}.")
    recordings: dict[str, list[Recording]] = {kind: [] for kind in KINDS}
    for path in sorted(folder.glob("*.csv")):
        recording = Recording.load(path)
        expected = next((kind for kind in KINDS if path.stem.startswith(kind)), None)
        try:
            recordings[check_recording(recording, expected)].append(recording)
        except LimbError as error:
            raise CalibrationError(f"{path}: {error}") from error
    return recordings


def calibrate(
    recordings: str | Path | Mapping[str, Sequence[Recording]],
    parameters: LimbParameters | None = None,
    *,
    heat: str = "bend",
) -> Calibration:
    """Calibrates a limb from its recordings, by Sec. V.

    Args:
        recordings: a folder of files, or recordings by kind: "sag",
            "ring_down", "left", "right" and "both".
        parameters: the limb's description, whose geometry, mass and limits
            are kept; that in the recordings if None.
        heat: "bend" fits heat transfer as the paper does, with wire
            temperature from the bend; "temperature" uses duty and measured
            temperature alone. The other is fitted for comparison.

    Raises:
        CalibrationError: if recordings are missing or tell too little.
    """
    if heat not in HEAT_METHODS:
        raise CalibrationError(f"heat is {heat!r}; it must be one of {', '.join(HEAT_METHODS)}.")
    if isinstance(recordings, (str, Path)):
        recordings = load_recordings(recordings)
    else:
        for kind, group in recordings.items():
            if kind not in KINDS:
                raise CalibrationError(f"{kind!r} is no kind of recording: {', '.join(KINDS)}.")
            for recording in group:
                try:
                    check_recording(recording, kind)
                except LimbError as error:
                    raise CalibrationError(f"{recording.source}: {error}") from error
    for side in ("left", "right"):
        if not recordings.get(side):
            raise CalibrationError(
                f"There is no recording with only the {side} wire heated; its heat transfer and "
                "force cannot be told."
            )
    heated = {side: recordings[side][0] for side in ("left", "right")}
    limb = copy.deepcopy(parameters or heated["right"].parameters)
    if not isinstance(heated["right"].parameters.board, NoBoard):
        limb.board = heated["right"].parameters.board
    limb.gravity = [0.0, 0.0, 0.0]
    segment = only_segment(limb)

    with Progress("calibrating", 6, "steps") as progress:
        ambient = ambient_temperature(heated.values())
        limb.ambient_temperature = ambient.value
        progress.update(0, "stiffness")
        stiffness = damping = None
        if recordings.get("sag"):
            stiffness = fit_stiffness(limb, recordings["sag"])
            segment.stiffness = stiffness.stiffness.value
        progress.update(1, "damping")
        if recordings.get("ring_down"):
            damping = fit_damping(limb, recordings["ring_down"])
            segment.damping = damping.damping.value
        used: list[HeatFit] = []
        compared: list[HeatFit] = []
        forces: list[ForceFit] = []
        spring = stiffness.stiffness if stiffness else Estimate(segment.stiffness, 0.0, "N·m/rad")
        for index, side in enumerate(("left", "right")):
            progress.update(2 + 2 * index, f"heat of the {side} wire")
            fits = {
                "bend": fit_heat_transfer(heated[side], index, ambient.value),
                "temperature": fit_heat_transfer_from_temperature(
                    heated[side], index, ambient.value
                ),
            }
            used.append(fits.pop(heat))
            compared += fits.values()
            forces.append(fit_force(limb, heated[side], index, used[-1], spring))
            rates = {name: getattr(used[-1], name).value for name in ("a1", "a2", "a3")}
            segment.wire(side).law = LinearLaw(**rates, beta=forces[-1].beta.value)
        limb.validate()
        progress.update(5, "validation")
        validation = validate(limb, recordings["both"][0]) if recordings.get("both") else None
    return Calibration(
        limb,
        ambient,
        stiffness,
        damping,
        used,
        compared,
        forces,
        validation,
        {kind: [r.source for r in group] for kind, group in recordings.items() if group},
    )
