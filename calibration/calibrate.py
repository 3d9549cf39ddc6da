"""Calibrate a limb from its recordings: by prediction error, or as Sec. V does."""

import contextlib
import copy
import dataclasses
import functools
import itertools
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from calibration.estimate import Estimate, record_of
from calibration.heat_bounds_fit import fit_heat_bounds
from calibration.paper_method.mechanics import (
    MAX_SCATTER,
    DampingFit,
    StiffnessFit,
    fit_damping,
    fit_stiffness,
    further_sag,
    remarks_on_sensor,
    with_ringing,
)
from calibration.paper_method.wire_fits import (
    RATE_UNITS,
    ForceFit,
    HeatFit,
    fit_force,
    fit_heat_transfer,
)
from calibration.prediction.expected_plan_error import (
    PlanMiss,
    next_recording,
    plan_miss,
    remarks_on_coverage,
)
from calibration.prediction.heated_run import HeatedRun
from calibration.prediction.law_fit import LawFit
from calibration.prediction.selection import LAWS, Prediction, fit_by_prediction
from calibration.recordings.at_rest import ambient_temperature, rest_angles
from calibration.recordings.files import left_out_remark, read_folder, select_usable
from calibration.recordings.kinds import FREE_KINDS, all_kinds, heated_kinds, only_segment, title_of
from calibration.recordings.repair import MIN_SAMPLES, before_missing, with_lost_rows
from calibration.remarks import CalibrationError, Remark, Severity, verdict
from calibration.validation import Validation, validate, validation_of
from calibration.wire_directions import check_directions, wire_directions
from limb_systems import LimbParameters, LinearLaw, NoBoard, Provenance, Recording, WireLaw
from limb_systems.errors import LimbError
from limb_systems.progress import Progress
from limb_systems.summary import Entry, Summarized, Summary

METHODS = ("prediction", "paper")
MAX_REST_ANGLE = np.deg2rad(8.0)  # beyond which Sec. V counts bends from the angle at rest
COLD_MARGIN = 4.0  # °C above ambient, within which a wire counts as not heated before
RecordingsByKind = Mapping[str, Sequence[Recording]]  # recordings by kind

Fit = TypeVar("Fit")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Calibration(Summarized):
    """A calibrated limb, and the fits that lead to it.

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
    left_out: list[Remark]

    def summary(self) -> Summary:
        """The number of quantities, the validation, the number of remarks, and each quantity."""
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
        own = ("ambient_temperature", "stiffness", "damping")
        names = [name for name in own if name not in self.estimates]
        if self.prediction:
            names += [unknown.name for unknown in self.prediction.fit.unidentified]
        return names

    @property
    def next_recording(self) -> str:
        """The recording to make next and what it tells, in words; empty if none is needed."""
        fit = self.prediction.fit if self.prediction else None
        return next_recording(fit, self.sources, self._further_sag)

    @functools.cached_property
    def _further_sag(self) -> str:
        if only_segment(self.parameters).axes > 1:
            return ""
        return further_sag(self.parameters, self.stiffness.stiffness if self.stiffness else None)

    @functools.cached_property
    def plan_miss(self) -> PlanMiss | None:
        """Return how far plans will miss, by prediction; None if by Sec. V."""
        if self.prediction is None:
            return None
        errors = [part.bend_error for part in self.prediction.parts]
        fitted = self.prediction.fit.predicted
        mean_error = self.prediction.mean_error
        return plan_miss(self.parameters, self.prediction.rollouts, fitted, errors, mean_error)

    @property
    def estimates(self) -> dict[str, Estimate]:
        """All calibrated quantities by their names in the parameters."""
        errors = dict(zip(self._estimates, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))
        return {
            name: dataclasses.replace(estimate, standard_error=errors[name])
            for name, estimate in self._estimates.items()
        }

    @functools.cached_property
    def _estimates(self) -> dict[str, Estimate]:
        """The quantities; their standard errors leave out the error of k where k is a factor."""
        estimates = {}
        if not self.prediction or self.prediction.fit.measures_heat:
            estimates["ambient_temperature"] = self.ambient
        if self.stiffness:
            estimates["stiffness"] = self.stiffness.stiffness
        if self.damping:
            estimates["damping"] = self.damping.damping
        for heat, force in zip(self.heat, self.force, strict=True):
            for name in RATE_UNITS:
                estimates[f"{heat.wire}.{name}"] = getattr(heat, name)
            estimates[f"{heat.wire}.beta"] = force.beta
        return estimates | (self.prediction.fit.estimates if self.prediction else {})

    @functools.cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the estimates (P, P), in their order; see `CalibrationRecord`."""
        estimates = self._estimates
        rows = {name: row for row, name in enumerate(estimates)}
        covariance = np.diag([e.standard_error**2 for e in estimates.values()])
        for fit in self.heat:
            wire_rows = [rows[f"{fit.wire}.{name}"] for name in RATE_UNITS]
            covariance[np.ix_(wire_rows, wire_rows)] = fit.covariance
        if self.prediction:
            fitted_rows = [rows[name] for name in self.prediction.fit.estimates]
            covariance[np.ix_(fitted_rows, fitted_rows)] = self.prediction.fit.value_covariance
        if self.stiffness:
            # Recordings of the bend tell torque over k: relative to themselves, torques err as k.
            k = self.stiffness.stiffness
            torques = [n for n, e in estimates.items() if "." in n and e.unit.startswith("N·m")]
            multiple_rows = [rows[name] for name in ("stiffness", *torques)]
            values = np.array([estimates[name].value for name in ("stiffness", *torques)])
            common = (k.standard_error / k.value) ** 2 * np.outer(values, values)
            # k has its own error already, and so has β by Sec. V.
            known_rows = [0] if self.prediction else range(len(multiple_rows))
            common[known_rows, known_rows] = 0.0
            covariance[np.ix_(multiple_rows, multiple_rows)] += common
        return covariance

    @property
    def may_be_planned_with(self) -> bool:
        """Return whether no remark forbids plans with the calibrated limb."""
        return all(remark.severity < Severity.STOP for remark in self.remarks)

    @property
    def verdict(self) -> str:
        """Return whether to plan with it, and why, in one line, by `calibration.remarks`."""
        validation = self.plan_miss or self.validation
        return verdict(self.remarks, validation.in_words if validation else "")

    @property
    def remarks(self) -> list[Remark]:
        """Return what the recordings lack, in sentences, worst first; none if they are good."""
        kept_text = "the description's value is kept"
        not_validated_text = "the model is not validated; record one"
        possibly_lacking = [
            ("not validated", "both wires", not_validated_text, self.validation),
            # Sag and heat in several mountings tell k.
            ("kept", "sag", kept_text, self.stiffness or "stiffness" in self.estimates),
            ("kept", "ring-down", kept_text, self.damping),
        ]
        remarks = []
        for kind, motion, meaning, fit_or_none in possibly_lacking:
            if not fit_or_none:
                sentence = f"There is no usable recording of {motion}: {meaning}."
                remarks.append(Remark(kind, sentence))
        for kind in () if self.prediction else heated_kinds(self.parameters):
            if (count := len(self.sources.get(kind, []))) > 1:
                sentence = f"Of {count} recordings of the kind {kind} only one was used."
                remarks.append(Remark("unused", sentence))
        validation = None if self.plan_miss else self.validation
        fits = validation, self.stiffness, self.damping, self.prediction, *self.heat, *self.force
        for fit in (*fits, self.plan_miss):
            if fit:
                remarks += fit.remarks
        if self.stiffness and self._further_sag:
            k = self.stiffness.stiffness
            share = k.standard_error / k.value
            # The next recording says it, if it is that.
            hint = "" if self.next_recording == self._further_sag else f": {self._further_sag}"
            sentence = f"k is known to {share:.0%} only{hint}."
            remarks.append(Remark("scatter" if share > MAX_SCATTER else "stiffness", sentence))
        if self.prediction:
            remarks += remarks_on_coverage(self.parameters, self.prediction.fit.predicted)
        return sorted([*remarks, *self.left_out], key=lambda remark: -remark.severity)


def calibrate(
    recordings: str | Path | RecordingsByKind,
    parameters: LimbParameters | None = None,
    *,
    method: str = "prediction",
    laws: Sequence[type[WireLaw]] = LAWS,
    counted_limit: float | None = None,
    as_described: bool = False,
    announce: Callable[[str], object] = lambda text: None,
) -> Calibration:
    """Calibrate a limb from its recordings.

    Stiffness and damping are fitted as in Secs. V-A and V-B. The wires are fitted
    by one of two methods:

    - "prediction": several laws are fitted to all heated recordings by their
      open-loop prediction, and compared by how they predict recordings that
      were left out. The simplest that no other beats is used.
    - "paper": the paper's law by Sec. V-C, to the first recording of each wire.

    Args:
        recordings: a folder of files, or recordings by kind: the kinds of `kinds_of`,
            "sag", "ring_down", the names of the wires and "both"; by prediction
            also "heated", of any duty, and "motion", which are left out of the
            fit and judge it. Any of them may be missing, and any may be many.
        parameters: the limb's description, whose geometry, mass and limits
            are kept, and whose laws say what to expect; if None, the description in the
            recordings.
        method: see above.
        laws: laws that are compared by prediction, from the simplest on.
        counted_limit: T that plans may reach of a limb without thermocouples, as counted by the
            described a2, °C; the highest in the recordings if None.
        as_described: whether wires and bend sensor are where the description has them, even if the
            recordings do not confirm it.
        announce: is called with where each wire bends the limb to by the recordings, and with how
            long the fit will take, in words, if it takes long.

    Raises:
        CalibrationError: if recordings are missing or do not determine a parameter; its notes are
            on recordings that are left out, since something is wrong with them.
        WrongDescriptionError: if the recordings do not confirm on which sides wires are described.
    """
    if method not in METHODS:
        raise CalibrationError(f"method is {method!r}; it must be one of {', '.join(METHODS)}.")
    by_paper = method == "paper"
    left_out = list[Remark]()
    with _noting_left_out(left_out), Progress("calibrating", None, "steps") as progress:
        steps = itertools.count()

        def report_step(remark: str) -> None:
            progress.update(next(steps), remark)

        # Leave out unusable recordings and cut the others in pieces.
        by_kind, heated, limb, described = _load_usable(recordings, parameters, by_paper, left_out)
        segment = only_segment(limb)
        all_heated = list(itertools.chain(*heated.values()))
        # Ask if recordings contradict the described sides of the wires.
        if not by_paper:
            report_step("directions of the wires")
            directions = wire_directions(list(map(HeatedRun.of, all_heated)), segment)
            for direction in directions:
                announce(str(direction))
            if not as_described:
                check_directions(directions, limb)
        # Read the room, the bounds of the board and the angle at rest.
        report_step("bounds for the board")
        all_recordings = list(itertools.chain(*by_kind.values()))
        ambient = ambient_temperature(all_recordings)
        limb.ambient_temperature = ambient.value
        if with_readings := [each for each in all_heated if each.has_thermocouple.any()]:
            _fit_heat_bounds(limb, with_readings, described)
        resting = all_recordings if by_paper else [*by_kind.get("ring_down", []), *all_heated]
        rest, *rest_angles_e3 = rest_angles(resting, ambient.value)
        if not by_paper or abs(rest.value) > MAX_REST_ANGLE:
            segment.rest_angle = rest.value
        for estimate in rest_angles_e3:
            segment.rest_angle_e3 = estimate.value

        def predicted(given: RecordingsByKind) -> Prediction:
            known = copy.deepcopy(segment)  # which stays as described
            result = fit_by_prediction(
                laws, given, known, ambient.value, report=report_step, announce=announce
            )
            result.fit.apply(limb)
            if not result.fit.measures_heat:
                _limit_counted_heat(limb, result.fit, counted_limit)
            return result

        # Fit the mechanics; in space, mountings tell k together with the wires' directions.
        report_step("stiffness and damping")
        prediction = validation = None
        if segment.axes > 1:
            prediction = predicted({"sag": by_kind.get("sag", []), **heated})
        stiffness, damping = _fit_mechanics(limb, by_kind, rest, by_paper, left_out)
        # Fit the wires, and validate.
        heat = list[HeatFit]()
        force = list[ForceFit]()
        if by_paper:
            spring = stiffness.stiffness if stiffness else None
            for index, wire in enumerate(segment.wires):
                report_step(f"heat of the {wire.name} wire")
                transfer, torque = _fit_wire(limb, index, heated, ambient, spring, left_out)
                heat.append(transfer)
                force.append(torque)
            if heated.get("both"):
                validation = validate(limb, heated["both"][0])
        else:
            prediction = prediction or predicted(heated)
            validation = validation_of(prediction.parts, limb)
        limb.validate()
    # Put the result together, and refuse it if it is no better than the mean.
    sources = {}
    for kind in filter(by_kind.get, all_kinds(limb)):
        sources[kind] = [recording.source for recording in by_kind[kind]]
    calibration = Calibration(
        limb, ambient, stiffness, damping, prediction, heat, force, validation, sources, left_out
    )
    _record(calibration)
    with _noting_left_out(left_out):
        _check_better_than_mean(calibration)
    return calibration


def _fit_mechanics(
    limb: LimbParameters,
    by_kind: dict[str, list[Recording]],
    rest: Estimate,
    by_paper: bool,
    left_out: list[Remark],
) -> tuple[StiffnessFit | None, DampingFit | None]:
    """Fit k (Sec. V-A, in a plane only) and σ (Sec. V-B), and set in the limb what was fitted.

    A fit is None if there are no recordings for it; ``left_out`` gets what does not suit.
    """
    segment = only_segment(limb)
    stiffness = None
    if segment.axes == 1:
        error = rest.standard_error if segment.rest_angle == rest.value else 0.0
        fit_sag = functools.partial(fit_stiffness, limb, rest_error=error)
        stiffness = _fit_if_possible(fit_sag, "sag", by_kind, left_out)
    if stiffness:
        segment.stiffness = stiffness.stiffness.value
    fit_swing = functools.partial(fit_damping, limb)
    damping = _fit_if_possible(fit_swing, "ring_down", by_kind, left_out)
    if damping:
        segment.damping = damping.damping.value
    # Compare the sag with the ring-down; by prediction, both tell k.
    if stiffness and damping:
        damping.remarks.extend(remarks_on_sensor(limb, by_kind["sag"], stiffness, damping))
        if not by_paper:
            stiffness = with_ringing(stiffness, damping)
            segment.stiffness = stiffness.stiffness.value
    return stiffness, damping


def _check_better_than_mean(calibration: Calibration) -> None:
    """Raise CalibrationError if plans may miss by more than the mean bend would."""
    miss = calibration.plan_miss
    if miss and miss.high > miss.by_mean:
        further = calibration.next_recording or "record more motions like those you plan"
        raise CalibrationError(
            f"These recordings tell no model: {miss.in_words}, but the mean bend misses such a "
            f"motion by {np.rad2deg(miss.by_mean):.1f}°. Next, {further}."
        )


@contextlib.contextmanager
def _noting_left_out(left_out: list[Remark]) -> Iterator[None]:
    """Return a context whose errors get notes on recordings that were left out."""
    try:
        yield
    except LimbError as error:
        for remark in left_out:
            error.add_note(str(remark))
        raise


def _load_usable(
    source: str | Path | RecordingsByKind,
    parameters: LimbParameters | None,
    by_paper: bool,
    left_out: list[Remark],
) -> tuple[dict[str, list[Recording]], RecordingsByKind, LimbParameters, LimbParameters]:
    """Return usable recordings by kind, heated ones by kind, the uncalibrated limb, and as given.

    Heated ones are in pieces unless ``by_paper``.
    """
    where = ""
    if isinstance(source, (str, Path)):
        where = f" in {source}; soft-limb collect or import writes them"
        source, remarks = read_folder(source)
        left_out += remarks
    # Take the description that most recordings have, unless one is given.
    all_recordings = list(itertools.chain(*source.values()))
    if not all_recordings:
        raise CalibrationError(f"There are no recordings{where}.")
    wire_names = [tuple(recording.parameters.wire_names) for recording in all_recordings]
    usual = wire_names.index(statistics.mode(wire_names))
    described = parameters or all_recordings[usual].parameters
    usable_by_kind = select_usable(source, described, whole=by_paper)
    left_out += usable_by_kind.left_out
    # Cut heated recordings in pieces, and restore rows that the logger lost.
    recordings = _with_lost_rows(usable_by_kind.recordings)
    pieces = _with_lost_rows(usable_by_kind.heated)
    heated = {}
    for kind in (*heated_kinds(described), *(() if by_paper else FREE_KINDS)):
        heated[kind] = pieces.get(kind, [])
    if by_paper:
        _check_suits_paper(heated, described)
    all_recordings = list(itertools.chain(*heated.values()))
    if not all_recordings:
        raise CalibrationError("There is no recording with heat, which tells the wires' laws.")
    # Start from the description, mounted as in the last recording.
    limb = copy.deepcopy(parameters or all_recordings[0].parameters)
    if not isinstance(all_recordings[0].parameters.board, NoBoard):
        limb.board = all_recordings[0].parameters.board
    limb.gravity = [0.0, 0.0, 0.0]
    if only_segment(limb).axes > 1:  # as in the last motion, not with a weight at the tip
        mounting = parameters or all_recordings[-1].parameters
        limb.gravity = list(mounting.gravity)
        limb.payload = mounting.payload
    limb.calibration = None  # until this one is done
    return recordings, heated, limb, described


def _check_suits_paper(heated: RecordingsByKind, described: LimbParameters) -> None:
    """Raise CalibrationError unless the paper's method suits limb and recordings.

    The limb must bend in a plane. Each wire needs a recording in which it alone is heated, and a
    thermocouple.
    """
    if only_segment(described).axes > 1:
        raise CalibrationError(
            "The paper's method is one for limbs that bend in a plane; calibrate this one with "
            "method prediction."
        )
    for index, wire in enumerate(described.wire_names):
        if not heated[wire]:
            raise CalibrationError(
                f"There is no recording with only the {wire} wire heated; its heat transfer "
                "and force cannot be told."
            )
        if not any(recording.has_thermocouple[index] for recording in heated[wire]):
            raise CalibrationError(
                f"No thermocouple reads the {wire} wire, as the paper's method needs; bond one "
                "to it, or calibrate with method prediction."
            )


def _with_lost_rows(recordings: RecordingsByKind) -> dict[str, list[Recording]]:
    """Return recordings by kind, each `with_lost_rows`."""
    return {kind: list(map(with_lost_rows, group)) for kind, group in recordings.items()}


def _fit_if_possible(
    fit: Callable[[Sequence[Recording]], Fit],
    kind: str,
    by_kind: dict[str, list[Recording]],
    left_out: list[Remark],
) -> Fit | None:
    """Return a fit to the recordings of a kind; None if there is none that can be fitted.

    Leave out each recording that cannot be fitted together with the recordings before it.
    """
    recordings = by_kind.get(kind, [])
    with contextlib.suppress(LimbError):
        return fit(recordings)
    best_fit: Fit | None = None
    by_kind[kind] = []
    for recording in recordings:
        try:
            best_fit = fit([*by_kind[kind], recording])
        except LimbError as error:
            left_out.append(left_out_remark(title_of(recording), error))
        else:
            by_kind[kind].append(recording)
    return best_fit


def _fit_wire(
    limb: LimbParameters,
    index: int,
    recordings: RecordingsByKind,
    ambient: Estimate,
    stiffness: Estimate | None,
    left_out: list[Remark],
) -> tuple[HeatFit, ForceFit]:
    """Fit one wire by Sec. V-C to the first recording that can be fitted, and set its law."""
    segment = only_segment(limb)
    room = (ambient.value, ambient.standard_error)
    wire = segment.wires[index]
    stiffness = stiffness or Estimate(segment.stiffness, 0.0, "N·m/rad")
    for recording in recordings[wire.name]:
        try:
            heat = fit_heat_transfer(recording, index, *room, rest_angle=segment.rest_angle)
            force = fit_force(limb, recording, index, heat, stiffness)
            break
        except CalibrationError as error:
            if recording is recordings[wire.name][-1]:
                raise
            left_out.append(left_out_remark(title_of(recording), error))
    wire.law = LinearLaw(heat.a1.value, heat.a2.value, heat.a3.value, force.beta.value)
    return heat, force


def _fit_heat_bounds(
    limb: LimbParameters, recordings: Sequence[Recording], described: LimbParameters
) -> None:
    """Give the wires bounds for the board; none to wires of a kind that boards do not accept."""
    highest_cold = limb.ambient_temperature + COLD_MARGIN
    # Take the beginnings of recordings whose wires were cold at the start.
    cold_starts = []
    for beginning in map(before_missing, recordings):
        is_warm = (beginning.measured_temperature[:, 0] >= highest_cold).any()
        if len(beginning.time) >= MIN_SAMPLES and not is_warm:
            cold_starts.append(beginning)
    with contextlib.suppress(LimbError):
        for wire, bounds in zip(limb.wires, fit_heat_bounds(cold_starts, described), strict=True):
            wire.heat_bounds = bounds


def _limit_counted_heat(limb: LimbParameters, fit: LawFit, limit: float | None) -> None:
    """Limit T to what was counted: of each wire the most, of these the least; or to a given one."""
    heated = np.any([predicted.run.duty.any(axis=0) for predicted in fit.predicted], axis=0)
    limits = limb.temperature_limits
    room = limb.ambient_temperature
    limits.maximum = float(fit.hottest[heated].min()) if limit is None else limit
    limits.warm = min(limits.warm, (room + limits.maximum) / 2)


def _record(calibration: Calibration) -> None:
    """Write estimates, errors and sources of a calibration into its limb."""
    validation = calibration.validation
    prediction = calibration.prediction
    heat_measured = not prediction or prediction.fit.measures_heat
    text = ""
    if validation:  # in ASCII, as YAML files have all else escaped
        text = (
            f"bend angle off by {np.rad2deg(validation.mean):.2f} deg on average, "
            f"{np.rad2deg(validation.median):.2f} deg at the median, "
            f"{np.rad2deg(validation.percentile_90):.2f} deg at the 90th percentile; "
        )
        heat = f"measured temperature off by {validation.temperature_mean:.1f} deg C on average"
        text += heat if heat_measured else "temperature was not measured"
    limb = calibration.parameters
    limb.calibration = record_of(
        calibration.estimates,
        calibration.covariance,
        recordings=[
            f"{len(sources)} of {kind}: {', '.join(sorted(set(sources)))}"
            for kind, sources in calibration.sources.items()
        ],
        validation=text,
        bend_error=prediction.bend_error if prediction else 0.0,
        temperature_error=prediction.best.temperature_error if prediction else 0.0,
        heat_measured=heat_measured,
    )
    limb.calibration.provenance = Provenance.now(limb)
