"""The whole of Sec. V: recordings in, a calibrated limb out."""

import contextlib
import copy
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration.checks import check_recording, check_whole
from calibration.collect import WARM_UP
from calibration.damping import DampingFit, fit_damping
from calibration.errors import CalibrationError
from calibration.estimate import Estimate
from calibration.force import ForceFit, fit_force
from calibration.heat import (
    RATES,
    HeatFit,
    ambient_temperature,
    fit_heat_transfer,
    fit_heat_transfer_from_temperature,
)
from calibration.heat_bounds import fit_heat_bounds
from calibration.kinds import heated_kinds, kinds_of, only_segment
from calibration.remarks import Remark, remarks_on_validation, verdict
from calibration.stiffness import StiffnessFit, fit_stiffness
from calibration.validation import Validation, validate
from limb_systems import CalibrationRecord, LimbParameters, LinearLaw, NoBoard, Recording
from limb_systems.display import Shown
from limb_systems.errors import LimbError
from limb_systems.files.table_writer import is_unfinished
from limb_systems.progress import Progress

HEAT_METHODS = ("bend", "temperature")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Calibration(Shown):
    """A calibrated limb, and all that was learned on the way.

    - ``parameters``: the calibrated `LimbParameters`, with their `CalibrationRecord`.
    - ``ambient``: T0 of the recordings, °C.
    - ``stiffness``, ``damping``: the fits of Secs. V-A and V-B; None if there
      was no recording for them and the description's value was kept.
    - ``heat``: for each wire, the fit of Sec. V-C1 that was used.
    - ``heat_compared``: likewise, that by the other method.
    - ``force``: likewise, the fit of Sec. V-C2.
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

    def facts(self) -> dict[str, str]:
        """How many quantities there are, how well they predict, and how many remarks."""
        validated = "not validated"
        if self.validation:
            error = np.rad2deg(self.validation.mean)
            validated = f"validated to {error:.1f}° on average"
        number = len(self.remarks)
        return {
            "fitted": f"{len(self.estimates)} quantities",
            "validation": validated,
            "remarks": f"{number or 'no'} remark{'s' * (number != 1)}",
        }

    def details(self) -> dict[str, str]:
        """The quantities with their standard errors."""
        return {name: str(estimate) for name, estimate in self.estimates.items()}

    @property
    def estimates(self) -> dict[str, Estimate]:
        """All calibrated quantities by their names in the parameters."""
        estimates = {"ambient_temperature": self.ambient}
        if self.stiffness:
            estimates["stiffness"] = self.stiffness.stiffness
        if self.damping:
            estimates["damping"] = self.damping.damping
        for heat, force in zip(self.heat, self.force, strict=True):
            for name in RATES:
                estimates[f"{heat.wire}.{name}"] = getattr(heat, name)
            estimates[f"{heat.wire}.beta"] = force.beta
        return estimates

    @property
    def covariance(self) -> np.ndarray:
        """Of the estimates (P, P), in their order; see `CalibrationRecord`."""
        estimates = self.estimates
        rows = {name: row for row, name in enumerate(estimates)}
        covariance = np.zeros((len(rows), len(rows)))
        for fit in self.heat:
            of_wire = [rows[f"{fit.wire}.{name}"] for name in RATES]
            covariance[np.ix_(of_wire, of_wire)] = fit.covariance
        if self.stiffness:
            # Each β is a mean of k θ / (T - T0): relative to themselves, they err as k does.
            names = ["stiffness", *(f"{fit.wire}.beta" for fit in self.force)]
            multiples = [rows[name] for name in names]
            values = [estimates[name].value for name in names]
            k = self.stiffness.stiffness
            covariance[np.ix_(multiples, multiples)] = (k.standard_error / k.value) ** 2 * np.outer(
                values, values
            )
        np.fill_diagonal(covariance, [e.standard_error**2 for e in estimates.values()])
        return covariance

    @property
    def verdict(self) -> str:
        """Whether to plan with it, and why, in one line, by `calibration.remarks`."""
        return verdict(self.remarks, self.validation)

    @property
    def remarks(self) -> list[Remark]:
        """What the recordings lack, in sentences, worst first; none if they are good."""
        remarks = remarks_on_validation(self.validation)
        for kind in heated_kinds(self.parameters):
            if (count := len(self.sources.get(kind, []))) > 1:
                sentence = f"Of {count} recordings of the kind {kind} only the first was used."
                remarks.append(Remark("unused", sentence))
        for kind, fit in (("sag", self.stiffness), ("ring-down", self.damping)):
            if fit is None:
                sentence = f"There is no recording of {kind}: the description's value is kept."
                remarks.append(Remark("kept", sentence))
        fits = (self.stiffness, self.damping, *self.heat, *self.force)
        remarks += [remark for fit in fits if fit for remark in fit.remarks]
        return sorted(remarks, key=lambda remark: -remark.severity)


def load_recordings(folder: str | Path) -> dict[str, list[Recording]]:
    """The recordings in a folder, checked, by what they show.

    Files named after a kind (``right.csv``, ``sag_3.csv``), one of `kinds_of`
    the limb in their header, must show it; files with other names go by what
    they show. Unfinished ones (``right.unfinished.csv``) and the warm-up are ignored.

    Raises:
        CalibrationError: with one sentence naming the file and the trouble.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise CalibrationError(f"There is no folder {folder}.")
    recordings: dict[str, list[Recording]] = {}
    for path in sorted(folder.glob("*.csv")):
        if is_unfinished(path) or path.stem == WARM_UP:
            continue
        recording = Recording.load(path)
        try:
            check_whole(recording)
            named = [kind for kind in kinds_of(recording.parameters) if path.stem.startswith(kind)]
            kind = check_recording(recording, max(named, key=len, default=None))
            recordings.setdefault(kind, []).append(recording)
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
        recordings: a folder of files, or recordings by kind, which are those
            of `kinds_of`: "sag", "ring_down", the names of the wires and "both".
        parameters: the limb's description, whose geometry, mass and limits
            are kept; that in the recordings if None.
        heat: "bend" fits heat transfer as the paper does, with wire
            temperature from the bend; "temperature" uses duty and measured
            temperature alone. The other is fitted for comparison.

    Raises:
        CalibrationError: if recordings are missing or do not determine a parameter.
    """
    if heat not in HEAT_METHODS:
        raise CalibrationError(f"heat is {heat!r}; it must be one of {', '.join(HEAT_METHODS)}.")
    if isinstance(recordings, (str, Path)):
        recordings = load_recordings(recordings)
    described = parameters or _first(recordings).parameters
    _check_wire_names(recordings, described)
    _check_kinds(recordings, kinds_of(described))
    wires = [kind for kind in heated_kinds(described) if kind != "both"]
    for wire in wires:
        if not recordings.get(wire):
            raise CalibrationError(
                f"There is no recording with only the {wire} wire heated; its heat transfer and "
                "force cannot be told."
            )
    header = recordings[wires[0]][0].parameters
    limb = copy.deepcopy(parameters or header)
    if not isinstance(header.board, NoBoard):
        limb.board = header.board
    limb.gravity = [0.0, 0.0, 0.0]
    limb.calibration = None  # until this one is done
    segment = only_segment(limb)
    heated = {wire.name: recordings[wire.name][0] for wire in segment.wires}

    num_steps = 2 + 2 * len(heated)
    with Progress("calibrating", num_steps, "steps") as progress:
        _fit_heat_bounds(limb, recordings)
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
        for index, (name, recording) in enumerate(heated.items()):
            progress.update(2 + 2 * index, f"heat of the {name} wire")
            fits = {
                "bend": fit_heat_transfer(recording, index, ambient.value),
                "temperature": fit_heat_transfer_from_temperature(recording, index, ambient.value),
            }
            used.append(fits.pop(heat))
            compared += fits.values()
            forces.append(fit_force(limb, recording, index, used[-1], spring))
            rates = {name: getattr(used[-1], name).value for name in RATES}
            segment.wires[index].law = LinearLaw(**rates, beta=forces[-1].beta.value)
        limb.validate()
        progress.update(num_steps - 1, "validation")
        validation = validate(limb, recordings["both"][0]) if recordings.get("both") else None
    calibration = Calibration(
        limb,
        ambient,
        stiffness,
        damping,
        used,
        compared,
        forces,
        validation,
        {
            kind: [recording.source for recording in recordings[kind]]
            for kind in kinds_of(limb)
            if recordings.get(kind)
        },
    )
    limb.calibration = _record(calibration)
    return calibration


def _fit_heat_bounds(limb: LimbParameters, recordings: Mapping[str, Sequence[Recording]]) -> None:
    """Gives the wires bounds for the board; none to those of a kind that boards do not accept."""
    heated = [r for kind in heated_kinds(limb) for r in recordings.get(kind, [])]
    with contextlib.suppress(LimbError):
        for wire, bounds in zip(limb.wires, fit_heat_bounds(heated, limb), strict=True):
            wire.heat_bounds = bounds


def _first(recordings: Mapping[str, Sequence[Recording]]) -> Recording:
    for group in recordings.values():
        if group:
            return group[0]
    raise CalibrationError("There are no recordings.")


def _check_kinds(
    recordings: Mapping[str, Sequence[Recording]], kinds: Mapping[str, list[int]]
) -> None:
    """Raises CalibrationError unless all recordings are of the kinds they are said to be."""
    for kind, group in recordings.items():
        if kind not in kinds:
            raise CalibrationError(f"{kind!r} is no kind of recording: {', '.join(kinds)}.")
        for recording in group:
            try:
                check_whole(recording)
                check_recording(recording, kind)
            except LimbError as error:
                raise CalibrationError(f"{recording.source}: {error}") from error


def _check_wire_names(
    recordings: Mapping[str, Sequence[Recording]], described: LimbParameters
) -> None:
    """Raises CalibrationError unless all recordings are of wires of the described names."""
    for group in recordings.values():
        for recording in group:
            if recording.parameters.wire_names != described.wire_names:
                raise CalibrationError(
                    f"The recording of {recording.source} is of the wires "
                    f"{', '.join(recording.parameters.wire_names)}, but the limb is described with "
                    f"{', '.join(described.wire_names)}, in this order."
                )


def _record(calibration: Calibration) -> CalibrationRecord:
    estimates, validation = calibration.estimates, calibration.validation
    return CalibrationRecord(
        names=list(estimates),
        values=[estimate.value for estimate in estimates.values()],
        standard_errors=[estimate.standard_error for estimate in estimates.values()],
        covariance=calibration.covariance.tolist(),
        recordings=[
            f"{len(sources)} of {kind}: {', '.join(sorted(set(sources)))}"
            for kind, sources in calibration.sources.items()
        ],
        validation=_validated(validation) if validation else "",
    )


def _validated(validation: Validation) -> str:
    """In ASCII, as YAML files have all else escaped."""
    degrees = np.rad2deg([validation.mean, validation.median, validation.percentile_90])
    return (
        "bend angle off by {:.2f} deg on average, {:.2f} deg at the median, {:.2f} deg at the 90th "
        "percentile; ".format(*degrees)
        + f"measured temperature off by {validation.temperature_mean:.1f} deg C on average"
    )
