"""Recordings in, a calibrated limb out: by prediction error, or as Sec. V does."""

import contextlib
import copy
import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calibration.checks import FEWEST, check_recording, check_whole
from calibration.collect import FIRST_CONTACT, WARM_UP
from calibration.course import before_missing, with_lost_rows
from calibration.damping import DampingFit, fit_damping
from calibration.errors import CalibrationError
from calibration.estimate import Estimate
from calibration.excitation import NAMES
from calibration.force import ForceFit, fit_force
from calibration.heat import (
    RATES,
    HeatFit,
    ambient_temperature,
    check_rates,
    fit_heat_transfer,
    fit_heat_transfer_from_temperature,
)
from calibration.heat_bounds import fit_heat_bounds
from calibration.kinds import FREE_KINDS, heated_kinds, kinds_of, only_segment
from calibration.remarks import Remark, remarks_on_validation, verdict
from calibration.rest_angle import rest_angle
from calibration.selection import LAWS, Prediction, fit_by_prediction
from calibration.stiffness import StiffnessFit, fit_stiffness, remarks_on_sensor
from calibration.validation import Validation, as_validation, validate
from limb_systems import (
    CalibrationRecord,
    LimbParameters,
    LinearLaw,
    NoBoard,
    Provenance,
    Recording,
    WireLaw,
)
from limb_systems.errors import LimbError
from limb_systems.files.table_writer import is_unfinished
from limb_systems.progress import Progress
from limb_systems.summary import Entry, Summarized, Summary

METHODS = ("prediction", "paper")
HEAT_METHODS = ("bend", "temperature")
MOST_REST_ANGLE = np.deg2rad(8.0)  # beyond which Sec. V is of changes from rest
COLD = 4.0  # °C above ambient, within which a wire counts as not heated before


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Calibration(Summarized):
    """A calibrated limb, and all that was learned on the way.

    - ``parameters``: the calibrated `LimbParameters`, with their `CalibrationRecord`.
    - ``ambient``: T0 of the recordings, °C.
    - ``stiffness``, ``damping``: the fits of Secs. V-A and V-B; None if there
      was no recording for them and the description's value was kept.
    - ``prediction``: of the wires, by prediction error; None if by Sec. V.
    - ``heat``: else for each wire, the fit of Sec. V-C1 that was used.
    - ``heat_compared``: likewise, that by the other method.
    - ``force``: likewise, the fit of Sec. V-C2.
    - ``validation``: Sec. V-D, of a recording that was not fitted; None without one.
    - ``sources``: what was recorded, for each kind of recording.
    """

    parameters: LimbParameters
    ambient: Estimate
    stiffness: StiffnessFit | None
    damping: DampingFit | None
    prediction: Prediction | None
    heat: list[HeatFit]
    heat_compared: list[HeatFit]
    force: list[ForceFit]
    validation: Validation | None
    sources: dict[str, list[str]]

    def summary(self) -> Summary:
        """How many quantities there are, how well they predict, how many remarks; each of them."""
        validated = "not validated"
        if self.validation:
            error = np.rad2deg(self.validation.mean)
            validated = f"validated to {error:.1f}° on average"
        number = len(self.remarks)
        count = len(self.estimates)
        return Summary(
            [
                Entry("fitted", count, "", f"{count} quantities"),
                Entry("validation", validated),
                Entry("remarks", number, "", f"{number or 'no'} remark{'s' * (number != 1)}"),
            ],
            details=[
                Entry(name, estimate.value, estimate.unit, str(estimate))
                for name, estimate in self.estimates.items()
            ],
        )

    @property
    def estimates(self) -> dict[str, Estimate]:
        """All calibrated quantities by their names in the parameters."""
        return {
            name: dataclasses.replace(estimate, standard_error=float(np.sqrt(variance)))
            for (name, estimate), variance in zip(
                self._estimates.items(), np.diag(self.covariance), strict=True
            )
        }

    @property
    def _estimates(self) -> dict[str, Estimate]:
        """With standard errors that leave out that of k where it is a factor."""
        estimates = {"ambient_temperature": self.ambient}
        if self.stiffness:
            estimates["stiffness"] = self.stiffness.stiffness
        if self.damping:
            estimates["damping"] = self.damping.damping
        for heat, force in zip(self.heat, self.force, strict=True):
            for name in RATES:
                estimates[f"{heat.wire}.{name}"] = getattr(heat, name)
            estimates[f"{heat.wire}.beta"] = force.beta
        return estimates | (self.prediction.fit.estimates if self.prediction else {})

    @property
    def covariance(self) -> np.ndarray:
        """Of the estimates (P, P), in their order; see `CalibrationRecord`."""
        estimates = self._estimates
        rows = {name: row for row, name in enumerate(estimates)}
        covariance = np.diag([e.standard_error**2 for e in estimates.values()])
        for fit in self.heat:
            of_wire = [rows[f"{fit.wire}.{name}"] for name in RATES]
            covariance[np.ix_(of_wire, of_wire)] = fit.covariance
        if self.prediction:
            together = [rows[name] for name in self.prediction.fit.estimates]
            covariance[np.ix_(together, together)] = self.prediction.fit.value_covariance
        if self.stiffness:
            # Recordings of the bend tell torque over k: relative to themselves, torques err as k.
            k = self.stiffness.stiffness
            torques = [n for n, e in estimates.items() if "." in n and e.unit.startswith("N·m")]
            multiples = [rows[name] for name in ("stiffness", *torques)]
            shares = np.array([list(estimates.values())[row].value for row in multiples])
            common = (k.standard_error / k.value) ** 2 * np.outer(shares, shares)
            if not self.prediction:  # β's variance has it already
                np.fill_diagonal(common, covariance[multiples, multiples])
                covariance[np.ix_(multiples, multiples)] = common
            else:
                common[0, 0] = 0.0  # that of k itself is there
                covariance[np.ix_(multiples, multiples)] += common
        return covariance

    @property
    def verdict(self) -> str:
        """Whether to plan with it, and why, in one line, by `calibration.remarks`."""
        return verdict(self.remarks, self.validation)

    @property
    def remarks(self) -> list[Remark]:
        """What the recordings lack, in sentences, worst first; none if they are good."""
        remarks = remarks_on_validation(self.validation)
        for kind in () if self.prediction else heated_kinds(self.parameters):
            if (count := len(self.sources.get(kind, []))) > 1:
                sentence = f"Of {count} recordings of the kind {kind} only the first was used."
                remarks.append(Remark("unused", sentence))
        for kind, fit in (("sag", self.stiffness), ("ring-down", self.damping)):
            if fit is None:
                sentence = f"There is no recording of {kind}: the description's value is kept."
                remarks.append(Remark("kept", sentence))
        fits = (self.stiffness, self.damping, self.prediction, *self.heat, *self.force)
        remarks += [remark for fit in fits if fit for remark in fit.remarks]
        return sorted(remarks, key=lambda remark: -remark.severity)


def load_recordings(folder: str | Path) -> dict[str, list[Recording]]:
    """The recordings in a folder, checked, by what they show.

    Files named after a kind (``right.csv``, ``sag_3.csv``, ``motion_1.csv``), one of
    `kinds_of` the limb in their header, "heated" or "motion", must show it. First contact,
    warm-up and `excitations` are of the kind "heated". Files with other names go by what they
    show. Unfinished ones (``right.unfinished.csv``) are ignored.

    Raises:
        CalibrationError: with one sentence naming the file and the trouble.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise CalibrationError(f"There is no folder {folder}.")
    recordings: dict[str, list[Recording]] = {}
    for path in sorted(folder.glob("*.csv")):
        if is_unfinished(path):
            continue
        recording = Recording.load(path)
        try:
            check_whole(recording)
            named = [kind for kind in kinds_of(recording.parameters) if path.stem.startswith(kind)]
            named += [kind for kind in FREE_KINDS if path.stem.startswith(kind)]
            named += ["heated"] if path.stem in (FIRST_CONTACT, WARM_UP, *NAMES) else []
            kind = check_recording(recording, max(named, key=len, default=None))
            recordings.setdefault(kind, []).append(recording)
        except LimbError as error:
            raise CalibrationError(f"{path}: {error}") from error
    return recordings


def calibrate(
    recordings: str | Path | Mapping[str, Sequence[Recording]],
    parameters: LimbParameters | None = None,
    *,
    method: str = "prediction",
    laws: Sequence[type[WireLaw]] = LAWS,
    heat: str = "bend",
) -> Calibration:
    """Calibrates a limb from its recordings.

    Stiffness and damping are those of Secs. V-A and V-B. The wires are fitted
    by one of two methods:

    - "prediction": several laws are fitted to all heated recordings by their
      open-loop prediction, and compared by how they predict recordings that
      were left out. The simplest that no other beats is used.
    - "paper": the paper's law by Sec. V-C, to the first recording of each wire.

    Args:
        recordings: a folder of files, or recordings by kind: those of `kinds_of`,
            "sag", "ring_down", the names of the wires and "both"; by prediction
            also "heated", of any duty, and "motion", which are left out of the
            fit and judge it. Any of them may be missing, and any may be many.
        parameters: the limb's description, whose geometry, mass and limits
            are kept, and whose laws say what to expect; that in the recordings
            if None.
        method: see above.
        laws: that are compared by prediction, from the simplest on.
        heat: of the paper's method: "bend" fits heat transfer with wire
            temperature from the bend; "temperature" uses duty and measured
            temperature alone. The other is fitted for comparison.

    Raises:
        CalibrationError: if recordings are missing or do not determine a parameter.
    """
    if method not in METHODS:
        raise CalibrationError(f"method is {method!r}; it must be one of {', '.join(METHODS)}.")
    if heat not in HEAT_METHODS:
        raise CalibrationError(f"heat is {heat!r}; it must be one of {', '.join(HEAT_METHODS)}.")
    if isinstance(recordings, (str, Path)):
        recordings = load_recordings(recordings)
    described = parameters or _first(recordings).parameters
    _check_wire_names(recordings, described)
    _check_kinds(recordings, _all_kinds(described))
    recordings = {k: [with_lost_rows(r) for r in group] for k, group in recordings.items()}
    heated = {kind: recordings.get(kind, []) for kind in (*heated_kinds(described), *FREE_KINDS)}
    if method == "paper":
        heated = {kind: heated[kind] for kind in heated_kinds(described)}
        _check_each_wire(heated)
    elif not any(heated.values()):
        raise CalibrationError(
            "There is no recording with heat; the wires' laws cannot be told from others."
        )
    header = next(group[0] for group in heated.values() if group).parameters
    limb = copy.deepcopy(parameters or header)
    if not isinstance(header.board, NoBoard):
        limb.board = header.board
    limb.gravity = [0.0, 0.0, 0.0]
    limb.calibration = None  # until this one is done
    segment = only_segment(limb)

    with Progress("calibrating", None, "steps") as progress:
        done = itertools.count()

        def tell(remark: str) -> None:
            progress.update(next(done), remark)

        tell("bounds for the board")
        ambient = ambient_temperature([r for group in recordings.values() for r in group])
        limb.ambient_temperature = ambient.value
        _fit_heat_bounds(limb, heated, described)
        rest = rest_angle((r for group in recordings.values() for r in group), ambient.value)
        if method == "prediction" or abs(rest.value) > MOST_REST_ANGLE:
            segment.rest_angle = rest.value
        tell("stiffness")
        stiffness = damping = None
        if recordings.get("sag"):
            known = segment.rest_angle == rest.value
            stiffness = fit_stiffness(limb, recordings["sag"], known * rest.standard_error)
            segment.stiffness = stiffness.stiffness.value
        tell("damping")
        if recordings.get("ring_down"):
            damping = fit_damping(limb, recordings["ring_down"])
            segment.damping = damping.damping.value
            if stiffness:
                damping.remarks.extend(
                    remarks_on_sensor(limb, recordings["sag"], stiffness, damping)
                )
        prediction, validation = None, None
        wires = _PaperWires()
        if method == "paper":
            wires = _fit_as_paper(limb, heated, heat, ambient, stiffness, tell)
            if heated.get("both"):
                validation = validate(limb, heated["both"][0])
        else:
            prediction = fit_by_prediction(laws, heated, segment, ambient.value, tell=tell)
            prediction.fit.apply(segment)
            validation = as_validation(prediction.best.judged, limb)
        limb.validate()
    calibration = Calibration(
        limb,
        ambient,
        stiffness,
        damping,
        prediction,
        *wires,
        validation,
        {
            kind: [recording.source for recording in recordings[kind]]
            for kind in _all_kinds(limb)
            if recordings.get(kind)
        },
    )
    limb.calibration = _record(calibration)
    limb.calibration.provenance = Provenance.now(limb)
    return calibration


class _PaperWires(NamedTuple):
    """Of Sec. V-C: the fits of heat that are used, those by the other method, and of force."""

    heat: list[HeatFit] = []  # noqa: RUF012 - never changed
    heat_compared: list[HeatFit] = []  # noqa: RUF012
    force: list[ForceFit] = []  # noqa: RUF012


def _fit_as_paper(
    limb: LimbParameters,
    recordings: Mapping[str, Sequence[Recording]],
    heat: str,
    ambient: Estimate,
    stiffness: StiffnessFit | None,
    tell: Callable[[str], object],
) -> _PaperWires:
    """Sec. V-C for each wire, whose law the limb gets."""
    segment, result = only_segment(limb), _PaperWires([], [], [])
    spring = stiffness.stiffness if stiffness else Estimate(segment.stiffness, 0.0, "N·m/rad")
    for index, wire in enumerate(segment.wires):
        tell(f"heat of the {wire.name} wire")
        recording = recordings[wire.name][0]
        room = ambient.value, ambient.standard_error
        fits = {
            "bend": fit_heat_transfer(recording, index, *room, rest_angle=segment.rest_angle),
            "temperature": fit_heat_transfer_from_temperature(recording, index, *room),
        }
        result.heat.append(fits.pop(heat))
        check_rates(result.heat[-1])
        result.heat_compared.extend(fits.values())
        result.force.append(fit_force(limb, recording, index, result.heat[-1], spring))
        rates = {name: getattr(result.heat[-1], name).value for name in RATES}
        wire.law = LinearLaw(**rates, beta=result.force[-1].beta.value)
    return result


def _all_kinds(limb: LimbParameters) -> list[str]:
    return [*kinds_of(limb), *FREE_KINDS]


def _check_each_wire(heated: Mapping[str, Sequence[Recording]]) -> None:
    """Raises CalibrationError unless each wire was heated alone, as Sec. V-C has it."""
    for kind, group in heated.items():
        if kind != "both" and not group:
            raise CalibrationError(
                f"There is no recording with only the {kind} wire heated; its heat transfer and "
                "force cannot be told."
            )


def _fit_heat_bounds(
    limb: LimbParameters,
    recordings: Mapping[str, Sequence[Recording]],
    described: LimbParameters,
) -> None:
    """Gives the wires bounds for the board; none to those of a kind that boards do not accept."""
    room = limb.ambient_temperature
    heated = [
        beginning
        for group in recordings.values()
        for recording in group
        if len((beginning := before_missing(recording)).time) >= FEWEST
        and (recording.measured_temperature[:, :1] < room + COLD).all()
    ]
    with contextlib.suppress(LimbError):
        for wire, bounds in zip(limb.wires, fit_heat_bounds(heated, described), strict=True):
            wire.heat_bounds = bounds


def _first(recordings: Mapping[str, Sequence[Recording]]) -> Recording:
    for group in recordings.values():
        if group:
            return group[0]
    raise CalibrationError("There are no recordings.")


def _check_kinds(recordings: Mapping[str, Sequence[Recording]], kinds: Sequence[str]) -> None:
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
    judged = calibration.prediction and calibration.prediction.best
    covariance = calibration.covariance
    np.fill_diagonal(covariance, [estimate.standard_error**2 for estimate in estimates.values()])
    return CalibrationRecord(
        names=list(estimates),
        values=[estimate.value for estimate in estimates.values()],
        standard_errors=[estimate.standard_error for estimate in estimates.values()],
        covariance=covariance.tolist(),
        recordings=[
            f"{len(sources)} of {kind}: {', '.join(sorted(set(sources)))}"
            for kind, sources in calibration.sources.items()
        ],
        validation=_validated(validation) if validation else "",
        bend_error=judged.bend_error if judged else 0.0,
        temperature_error=judged.temperature_error if judged else 0.0,
    )


def _validated(validation: Validation) -> str:
    """In ASCII, as YAML files have all else escaped."""
    degrees = np.rad2deg([validation.mean, validation.median, validation.percentile_90])
    return (
        "bend angle off by {:.2f} deg on average, {:.2f} deg at the median, {:.2f} deg at the 90th "
        "percentile; ".format(*degrees)
        + f"measured temperature off by {validation.temperature_mean:.1f} deg C on average"
    )
