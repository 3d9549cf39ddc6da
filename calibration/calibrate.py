"""Recordings in, a calibrated limb out: by prediction error, or as Sec. V does."""

import collections
import contextlib
import copy
import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from calibration.errors import CalibrationError
from calibration.estimate import Estimate, record_of
from calibration.heat_bounds import fit_heat_bounds
from calibration.next_recording import next_recording
from calibration.prediction.plan_miss import PlanMiss, plan_miss, remarks_on_coverage
from calibration.prediction.selection import LAWS, Prediction, fit_by_prediction
from calibration.recordings.at_rest import WARMEST_ROOM, ambient_temperature, rest_angle
from calibration.recordings.files import leaving_out, read_folder, usable
from calibration.recordings.kinds import FREE_KINDS, all_kinds, heated_kinds, only_segment, title_of
from calibration.recordings.pieces import FEWEST
from calibration.recordings.repair import before_missing, with_lost_rows
from calibration.remarks import Remark, verdict
from calibration.section_v.damping import DampingFit, fit_damping
from calibration.section_v.force import ForceFit, fit_force
from calibration.section_v.heat import RATES, HeatFit, fit_heat_transfer
from calibration.section_v.stiffness import StiffnessFit, fit_stiffness, remarks_on_sensor
from calibration.validation import Validation, validate, validation_of
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
from limb_systems.progress import Progress
from limb_systems.summary import Entry, Summarized, Summary

METHODS = ("prediction", "paper")
MOST_REST_ANGLE = np.deg2rad(8.0)  # beyond which Sec. V is of changes from rest
COLD = 4.0  # °C above ambient, within which a wire counts as not heated before

Fit = TypeVar("Fit")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Calibration(Summarized):
    """A calibrated limb, and all that was learned on the way.

    - ``parameters``: the calibrated `LimbParameters`, with their `CalibrationRecord`.
    - ``ambient``: T0 of the recordings, °C.
    - ``stiffness``, ``damping``: the fits of Secs. V-A and V-B; None if there
      was no recording for them and the description's value was kept.
    - ``prediction``: the fit of the wires by prediction error; None if by Sec. V.
    - ``heat``, ``force``: the fits of Secs. V-C1 and V-C2 for each wire; empty if by
      prediction.
    - ``validation``: Sec. V-D, of a recording that was not fitted; None without one.
    - ``sources``: names of what was recorded, for each kind of recording.
    - ``left_out``: remarks on recordings and parts of them that were not used.
    - ``plan_miss``: how far plans will miss, by prediction; None if by Sec. V.
    """

    parameters: LimbParameters
    ambient: Estimate
    stiffness: StiffnessFit | None
    damping: DampingFit | None
    prediction: Prediction | None
    heat: list[HeatFit]
    force: list[ForceFit]
    validation: Validation | None
    sources: dict[str, list[str]]
    left_out: list[Remark] = dataclasses.field(default_factory=list)
    plan_miss: PlanMiss | None = None

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
    def as_described(self) -> list[str]:
        """Names of the parameters that no recording tells, which stay as described."""
        untold = [unknown.name for unknown in self.prediction.fit.untold] if self.prediction else []
        fitted = self._estimates
        return [name for name in ("stiffness", "damping") if name not in fitted] + untold

    @property
    def next_recording(self) -> str:
        """The recording to make next and what it tells, in words; empty if none is needed."""
        return next_recording(self.prediction.fit if self.prediction else None, self.sources)

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
        """The quantities, with standard errors that leave out that of k where it is a factor."""
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
        """Covariance of the estimates (P, P), in their order; see `CalibrationRecord`."""
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
            values = np.array([estimates[name].value for name in ("stiffness", *torques)])
            common = (k.standard_error / k.value) ** 2 * np.outer(values, values)
            known = [0] if self.prediction else range(len(multiples))  # Sec. V's β has it already
            common[known, known] = 0.0
            covariance[np.ix_(multiples, multiples)] += common
        return covariance

    @property
    def verdict(self) -> str:
        """Whether to plan with it, and why, in one line, by `calibration.remarks`."""
        judged = self.plan_miss or self.validation
        return verdict(self.remarks, judged.in_words if judged else "")

    @property
    def remarks(self) -> list[Remark]:
        """What the recordings lack, in sentences, worst first; none if they are good."""
        kept = "the description's value is kept"
        lacking = {
            "both wires": (
                self.validation,
                "not validated",
                "the model is not validated; record one",
            ),
            "sag": (self.stiffness, "kept", kept),
            "ring-down": (self.damping, "kept", kept),
        }
        if "stiffness" in self._estimates:
            del lacking["sag"]  # sag and heat in several mountings tell k
        remarks = [
            Remark(kind, f"There is no recording of {what}: {meaning}.")
            for what, (fit, kind, meaning) in lacking.items()
            if fit is None
        ]
        for kind in () if self.prediction else heated_kinds(self.parameters):
            if (count := len(self.sources.get(kind, []))) > 1:
                sentence = f"Of {count} recordings of the kind {kind} only one was used."
                remarks.append(Remark("unused", sentence))
        judged = () if self.plan_miss else (self.validation,)
        fits = *judged, self.stiffness, self.damping, self.prediction, *self.heat, *self.force
        remarks += [r for fit in (*fits, self.plan_miss) if fit for r in fit.remarks]
        if self.prediction:
            remarks += remarks_on_coverage(self.parameters, self.prediction.fit.predicted)
        return sorted([*remarks, *self.left_out], key=lambda remark: -remark.severity)


def calibrate(
    recordings: str | Path | Mapping[str, Sequence[Recording]],
    parameters: LimbParameters | None = None,
    *,
    method: str = "prediction",
    laws: Sequence[type[WireLaw]] = LAWS,
    announce: Callable[[str], object] = lambda said: None,
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
        laws: laws that are compared by prediction, from the simplest on.
        announce: is called with how long it will take, in words, if it takes long.

    Raises:
        CalibrationError: if recordings are missing or do not determine a parameter; its notes are
            on recordings that are left out, since something is wrong with them.
    """
    if method not in METHODS:
        raise CalibrationError(f"method is {method!r}; it must be one of {', '.join(METHODS)}.")
    left_out: list[Remark] = []
    try:
        return _calibrated(recordings, parameters, method, laws, announce, left_out)
    except LimbError as error:
        for remark in left_out:
            error.add_note(str(remark))
        raise


def _calibrated(
    given: str | Path | Mapping[str, Sequence[Recording]],
    parameters: LimbParameters | None,
    method: str,
    laws: Sequence[type[WireLaw]],
    announce: Callable[[str], object],
    left_out: list[Remark],
) -> Calibration:
    """The calibration, of which ``left_out`` gets the remarks on recordings that are not used."""
    if isinstance(given, (str, Path)):
        given, remarks = read_folder(given)
        left_out += remarks
    every = [recording for group in given.values() for recording in group]
    if not every:
        raise CalibrationError("There are no recordings.")
    described = parameters or _most_alike(every).parameters
    whole = method == "paper"
    if whole and only_segment(described).axes > 1:
        raise CalibrationError(
            "The paper's method is one for limbs that bend in a plane; calibrate this one with "
            "method prediction."
        )
    usable_ones = usable(_of_wires(given, described, left_out), whole=whole)
    left_out += usable_ones.left_out
    kinds = [*heated_kinds(described), *(() if whole else FREE_KINDS)]
    recordings, heated = (
        {kind: [with_lost_rows(r) for r in group] for kind, group in groups.items()}
        for groups in (usable_ones.recordings, usable_ones.heated)
    )
    heated = {kind: heated.get(kind, []) for kind in kinds}
    if whole:
        missing = [wire for wire in described.wire_names if not heated[wire]]
        if missing:
            raise CalibrationError(
                f"There is no recording with only the {missing[0]} wire heated; its heat transfer "
                "and force cannot be told."
            )
    elif not any(heated.values()):
        raise CalibrationError("There is no recording with heat, which tells the wires' laws.")
    header = next(group[0] for group in heated.values() if group).parameters
    limb = copy.deepcopy(parameters or header)
    if not isinstance(header.board, NoBoard):
        limb.board = header.board
    if in_space := only_segment(limb).axes > 1:
        mounting = parameters or _last(heated).parameters  # not the one with a weight at the tip
        limb.gravity, limb.payload = list(mounting.gravity), mounting.payload
    else:
        limb.gravity = [0.0, 0.0, 0.0]
    limb.calibration = None  # until this one is done
    segment = only_segment(limb)

    with Progress("calibrating", None, "steps") as progress:
        done = itertools.count()

        def tell(remark: str) -> None:
            progress.update(next(done), remark)

        tell("bounds for the board")
        every = [recording for group in recordings.values() for recording in group]
        ambient = ambient_temperature(every)
        _check_room(ambient.value, described.ambient_temperature)
        limb.ambient_temperature = ambient.value
        _fit_heat_bounds(limb, heated, described)
        if method == "prediction":
            every = [*recordings.get("ring_down", []), *itertools.chain(*heated.values())]
        rest = rest_angle(every, ambient.value)
        if method == "prediction" or abs(rest.value) > MOST_REST_ANGLE:
            segment.rest_angle = rest.value
        tell("stiffness")
        stiffness = damping = None
        if recordings.get("sag") and not in_space:
            error = rest.standard_error if segment.rest_angle == rest.value else 0.0
            fit_sags = functools.partial(fit_stiffness, limb, rest_error=error)
            stiffness, recordings["sag"] = _fit_possible(fit_sags, recordings["sag"], left_out)
            if stiffness:
                segment.stiffness = stiffness.stiffness.value

        def fit_laws(told: Mapping[str, Sequence[Recording]]) -> Prediction:
            known = copy.deepcopy(segment)  # which stays as described
            prediction = fit_by_prediction(
                laws, told, known, ambient.value, tell=tell, announce=announce
            )
            prediction.fit.apply(segment)
            return prediction

        prediction = validation = None
        if in_space:  # mountings tell k together with the wires' directions
            prediction = fit_laws({"sag": recordings.get("sag", []), **heated})
        tell("damping")
        if recordings.get("ring_down"):
            fit_swings = functools.partial(fit_damping, limb)
            damping, recordings["ring_down"] = _fit_possible(
                fit_swings, recordings["ring_down"], left_out
            )
        if damping:
            segment.damping = damping.damping.value
            if stiffness:
                sensor = remarks_on_sensor(limb, recordings["sag"], stiffness, damping)
                damping.remarks.extend(sensor)
        heat: list[HeatFit] = []
        force: list[ForceFit] = []
        if method == "paper":
            spring = stiffness.stiffness if stiffness else None
            heat, force = _fit_as_paper(limb, heated, ambient, spring, tell, left_out)
            if heated.get("both"):
                validation = validate(limb, heated["both"][0])
        else:
            prediction = prediction or fit_laws(heated)
            validation = validation_of(prediction.best.judged, limb)
        limb.validate()
    sources = {
        kind: [recording.source for recording in recordings[kind]]
        for kind in all_kinds(limb)
        if recordings.get(kind)
    }
    fits = stiffness, damping, prediction, heat, force, validation
    calibration = Calibration(limb, ambient, *fits, sources, left_out)
    limb.calibration = _record(calibration)
    limb.calibration.provenance = Provenance.now(limb)
    if prediction is None:
        return calibration
    miss = plan_miss(limb, prediction.foreseen, prediction.fit.predicted)
    return dataclasses.replace(calibration, plan_miss=miss)


def _most_alike(recordings: Sequence[Recording]) -> Recording:
    """The first recording of the wires that most recordings are of."""
    count = collections.Counter(tuple(r.parameters.wire_names) for r in recordings)
    return max(recordings, key=lambda r: count[tuple(r.parameters.wire_names)])


def _of_wires(
    recordings: Mapping[str, Sequence[Recording]], described: LimbParameters, left: list[Remark]
) -> dict[str, list[Recording]]:
    """The recordings of the described wires, by kind; others are ``left`` out.

    Raises:
        CalibrationError: if there is no such kind.
    """
    kinds, names = all_kinds(described), described.wire_names
    result: dict[str, list[Recording]] = {}
    for kind, group in recordings.items():
        for recording in group:
            if (own := recording.parameters.wire_names) != names:
                why = f"it is of the wires {', '.join(own)}, but the limb is described with "
                left.append(
                    leaving_out(title_of(recording), f"{why}{', '.join(names)}, in this order.")
                )
            elif kind not in kinds:
                raise CalibrationError(f"{kind!r} is no kind of recording: {', '.join(kinds)}.")
            else:
                result.setdefault(kind, []).append(recording)
    return result


def _check_room(ambient: float, described: float) -> None:
    """Raises CalibrationError if no room is as warm as the lowest readings."""
    if ambient > described + WARMEST_ROOM:
        raise CalibrationError(
            f"The lowest readings of all recordings are {ambient:.0f} °C, where ambient is "
            f"{described:g} °C: are they in degrees Fahrenheit? If not, record the limb from cold, "
            "or until it is cold."
        )


def _fit_possible(
    fit: Callable[[Sequence[Recording]], Fit], recordings: Sequence[Recording], left: list[Remark]
) -> tuple[Fit | None, list[Recording]]:
    """A fit to recordings, and the recordings that it takes; others are ``left`` out.

    One that cannot be fitted together with those before it is not taken.
    """
    with contextlib.suppress(CalibrationError):
        return fit(recordings), list(recordings)
    found: Fit | None = None
    taken: list[Recording] = []
    for recording in recordings:
        try:
            found = fit([*taken, recording])
        except CalibrationError as error:
            left.append(leaving_out(title_of(recording), error))
        else:
            taken.append(recording)
    return found, taken


def _last(recordings: Mapping[str, Sequence[Recording]]) -> Recording:
    """The last recording: a motion, if there is one."""
    return [recording for group in recordings.values() for recording in group][-1]


def _fit_as_paper(
    limb: LimbParameters,
    recordings: Mapping[str, Sequence[Recording]],
    ambient: Estimate,
    spring: Estimate | None,
    tell: Callable[[str], object],
    left: list[Remark],
) -> tuple[list[HeatFit], list[ForceFit]]:
    """Sec. V-C for each wire, whose law the limb gets: the fits of heat and of force.

    Of its recordings the first that can be fitted is; those before it are ``left`` out.
    """
    segment = only_segment(limb)
    spring = spring or Estimate(segment.stiffness, 0.0, "N·m/rad")
    heats, forces = [], []
    for index, wire in enumerate(segment.wires):
        room = ambient.value, ambient.standard_error
        for recording in recordings[wire.name]:
            tell(f"heat of the {wire.name} wire, {title_of(recording)}")
            try:
                heat = fit_heat_transfer(recording, index, *room, rest_angle=segment.rest_angle)
                force = fit_force(limb, recording, index, heat, spring)
                break
            except CalibrationError as error:
                if recording is recordings[wire.name][-1]:
                    raise
                left.append(leaving_out(title_of(recording), error))
        wire.law = LinearLaw(heat.a1.value, heat.a2.value, heat.a3.value, force.beta.value)
        heats.append(heat)
        forces.append(force)
    return heats, forces


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
        and not (recording.measured_temperature[:, :1] >= room + COLD).any()
    ]
    with contextlib.suppress(LimbError):
        for wire, bounds in zip(limb.wires, fit_heat_bounds(heated, described), strict=True):
            wire.heat_bounds = bounds


def _record(calibration: Calibration) -> CalibrationRecord:
    estimates, validation = calibration.estimates, calibration.validation
    judged = calibration.prediction and calibration.prediction.best
    covariance = calibration.covariance
    np.fill_diagonal(covariance, [estimate.standard_error**2 for estimate in estimates.values()])
    words = ""
    if validation:  # in ASCII, as YAML files have all else escaped
        degrees = np.rad2deg([validation.mean, validation.median, validation.percentile_90])
        words = (
            "bend angle off by {:.2f} deg on average, {:.2f} deg at the median, {:.2f} deg at the "
            "90th percentile; measured temperature off by {:.1f} deg C on average"
        ).format(*degrees, validation.temperature_mean)
    return record_of(
        estimates,
        covariance,
        recordings=[
            f"{len(sources)} of {kind}: {', '.join(sorted(set(sources)))}"
            for kind, sources in calibration.sources.items()
        ],
        validation=words,
        bend_error=judged.bend_error if judged else 0.0,
        temperature_error=judged.temperature_error if judged else 0.0,
    )
