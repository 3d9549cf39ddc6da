"""The law that a limb's recordings call for: the simplest that predicts others best."""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from calibration.prediction.baselines import MEAN, baseline_errors
from calibration.prediction.expected_plan_error import next_recording
from calibration.prediction.heated_run import STEP, HeatedRun
from calibration.prediction.law_fit import (
    BEND_SCALE,
    KNOWN_SHARE,
    TEMPERATURE_SCALE,
    LawFit,
    Predicted,
    fit_law,
    fitting_time,
    mean_bend_error,
    mean_temperature_error,
)
from calibration.prediction.unknowns import LAG_FIELD, READING_FIELDS
from calibration.remarks import CalibrationError, Remark, remarks_on_start
from limb_systems import (
    CoupledLaw,
    HystereticLaw,
    LinearLaw,
    Recording,
    SaturatingLaw,
    SegmentParameters,
    ThresholdLaw,
    TwoMassLaw,
    WireLaw,
)
from limb_systems.progress import MIN_ANNOUNCED_TIME, TimeLeft

LAWS: tuple[type[WireLaw], ...] = (  # from the simplest on
    LinearLaw,
    TwoMassLaw,
    ThresholdLaw,
    SaturatingLaw,
    HystereticLaw,
    CoupledLaw,
)
# Options of the rubber, which are tried with the best law.
OPTIONS = ("stiffening", "rest_memory")
LEFT_OUT_SHARES = 0.12, 0.4  # of each recording, of its time and heat: least and most that judges
MAX_HEAT_SHARE = 0.6  # of a wire's heat, which judges at most
ERROR_BLOCK_TIME = 10.0  # s, after which errors of prediction count as independent
BOUND_MARGIN = 0.02  # by which a fitted value may stay inside its bound and count as at it
BASELINE_ALLOWANCE = 1.05, np.deg2rad(0.3)  # ratio, or rad, by which a law may be worse
MAX_FOLDS = 3  # of the validation, at most
MAX_TRIED_LAWS = 3  # laws that are judged by each part left out in turn
MIN_ERROR_REDUCTION = 0.1  # of a scale: laws that differ by less predict alike


@dataclasses.dataclass(frozen=True, eq=False)
class Candidate:
    """A law, and how well it predicts recordings that it was not fitted to.

    - ``fit``: to the other recordings.
    - ``judged``: these recordings as it predicts them.
    """

    fit: LawFit
    judged: list[Predicted]

    @property
    def name(self) -> str:
        """The law's, with what was fitted of the rubber besides the rest angle."""
        return " + ".join([self.fit.law.__name__, *rubber_options(self.fit)])

    @property
    def bend_error(self) -> float:
        """Mean |φ - φ_sim| over all, rad."""
        return mean_bend_error(self.judged)

    @property
    def temperature_error(self) -> float:
        """Mean |V - V_sim| over all, °C; 0 without thermocouples."""
        return mean_temperature_error(self.judged)


def _block_errors(recordings: Sequence[Predicted]) -> np.ndarray:
    """Return mean errors of bend and readings together in blocks of time, in their scales."""
    blocks = []
    for predicted in recordings:
        run = predicted.run
        bend = np.ma.masked_invalid(predicted.bend - run.bend) / BEND_SCALE
        reading = np.ma.masked_invalid(predicted.temperature - run.temperature) / TEMPERATURE_SCALE
        error = sum(np.abs(signal).mean(axis=1).filled(0.0) for signal in (bend, reading))
        # Average in blocks of time, which count as independent.
        _, numbers = np.unique((run.times / ERROR_BLOCK_TIME).astype(int), return_inverse=True)
        blocks.append(np.bincount(numbers, error) / np.bincount(numbers))
    return np.concatenate(blocks)


def error_reduction(better: Candidate, simple: Candidate) -> tuple[float, float]:
    """Return the error that another law saves, and its standard error, in their scales.

    What judges and what was fitted have the same weight: few motions tell laws apart badly, and
    what a law of few parameters leaves of its own recordings tells as much.
    """
    means = []
    variances = []
    simple_groups = simple.judged, simple.fit.predicted
    better_groups = better.judged, better.fit.predicted
    for simple_group, better_group in zip(simple_groups, better_groups, strict=True):
        differences = _block_errors(simple_group) - _block_errors(better_group)
        means.append(differences.mean())
        variances.append(differences.var() / max(len(differences) - 1, 1))
    return float(np.mean(means)), float(np.sqrt(np.sum(variances)) / 2)


def is_beaten(simple: Candidate, better: Candidate) -> bool:
    """Return whether another law predicts better by one standard error, and enough to matter.

    The one-standard-error rule (Breiman et al., Classification and Regression Trees, 1984). Two
    would be too many: a few motions of a minute tell laws apart by little more than one, and a
    law that is too simple costs more than one that has a parameter too many.
    """
    difference, error = error_reduction(better, simple)
    return difference > max(error, MIN_ERROR_REDUCTION)


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """The wires and the rubber by prediction error.

    - ``candidates``: laws that were compared, each fitted without the judges.
    - ``best``: the simplest of them that no other beats.
    - ``fit``: the best law, fitted to all recordings.
    - ``judges``: recordings that the laws were judged by, in words.
    - ``rollouts``: parts that were left out, as this fit predicts them from their start, as plans.
    - ``parts``: parts that were left out in turn, as the best law predicts them from the others.
    - ``mean_error``: mean error of the mean bend in these parts, rad.
    """

    candidates: list[Candidate]
    best: Candidate
    fit: LawFit
    judges: str
    rollouts: list[Predicted]
    parts: list[Predicted]
    mean_error: float

    @property
    def bend_error(self) -> float:
        """Mean |φ - φ_sim| over the parts that were left out, rad."""
        return mean_bend_error(self.parts)

    @property
    def choice(self) -> str:
        """The reason for the best law, and for leaving a law with smaller errors, in sentences."""
        sentences = (
            "Used (*) is the simplest law that none after it beats: by more than a standard error "
            "of the difference, in blocks of 10 s, of the errors of bend and V together, those of "
            "what judged and those of what was fitted."
        )
        # Say why a law that is nearer to what judged is not used.
        nearest = min(self.candidates, key=lambda candidate: candidate.bend_error)
        if nearest.bend_error < self.best.bend_error:
            better, error = error_reduction(nearest, self.best)
            sentences += (
                f" {nearest.name} is nearer to what judged; with what was fitted, its errors are "
                f"{'smaller' if better > 0 else 'larger'} by {abs(better):.2f} ± {error:.2f} "
                "(1° and 3 °C count as 1)."
            )
        return sentences

    @property
    def remarks(self) -> list[Remark]:
        """Remarks on judges, mountings, impossible starts, wires not told of, and parameters."""
        on_limb = *self._remarks_on_wires(), *self._remarks_on_parameters()
        return [*self._remarks_on_data(), *self._remarks_on_starts(), *on_limb]

    def _remarks_on_data(self) -> Iterator[Remark]:
        # Gravity towards E2 and E3 must differ between recordings of a limb in space.
        loads = np.array([predicted.run.load for predicted in self.fit.predicted])
        if self.fit.segment.axes > 1 and np.ptp(loads[:, 1:3], axis=0).max() < 1.0:
            yield Remark(
                "mounted",
                "Gravity pulled in one direction in all recordings, so that the stiffness stays "
                "as described, and the wires' directions are those that the bend sensor shows, "
                "however it is rolled: record the limb turned about its axis by 0°, 90°, 180° and "
                "270° as well, as soft-limb collect does.",
            )
        # Compare the heat while laws are judged with the whole.
        judged_heat = 0.0
        total_heat = 0.0
        for predicted in self.best.judged:
            run = predicted.run
            judged_heat += run.duty[int(run.times[0] / STEP) :].sum()
            total_heat += run.duty.sum()
        if judged_heat < 0.5 * LEFT_OUT_SHARES[0] * total_heat:
            yield Remark(
                "not validated",
                "What judges the laws is a limb that cools, and shows no heat: how well motions "
                "are predicted is not known; heat it several times.",
            )

    def _remarks_on_wires(self) -> Iterator[Remark]:
        if not self.fit.measures_heat:
            yield Remark(
                "unmeasured",
                "No wire has a thermocouple: a2 stays as described, and temperatures are counted "
                "from the duty by it, not measured. Simulate, plan, and learn in emulation with "
                "this limb; boards refuse to heat without thermocouples.",
            )
        # Remark on each wire of which recordings tell nothing, or no lag.
        for index, wire in enumerate(self.fit.segment.wires):
            fields = {unknown.field for unknown in self.fit.unidentified if unknown.wire == index}
            if not self.fit.measures_heat and fields <= {*READING_FIELDS}:
                continue
            if fields == {LAG_FIELD}:
                yield Remark(
                    "unread",
                    f"The {wire.name} wire has no thermocouple: its {LAG_FIELD} stays as "
                    "described, and its heat is told by the bend alone, and by the other wires.",
                )
            elif fields:
                new_fields = ", ".join(sorted(fields - set(vars(wire.law))))
                law = f", and its {new_fields} as expected of such wires" if new_fields else ""
                yield Remark(
                    "unheated",
                    f"The {wire.name} wire is heated in no recording: it stays as described{law}.",
                )

    def _remarks_on_parameters(self) -> Iterator[Remark]:
        fit = self.fit
        estimates = fit.estimates.values()
        rows = zip(fit.unknowns, fit.fitted, estimates, fit.unknown_shares, strict=True)
        for unknown, x, estimate, share in rows:
            # A value at its bound, then a value that is known no better than before.
            may_be_absent = unknown.low == 0.0 and not unknown.form  # a part of a law
            low = -np.inf if may_be_absent else unknown.low
            if not low + BOUND_MARGIN < x < unknown.high - BOUND_MARGIN:
                yield Remark(
                    "bound",
                    f"{unknown.name} is at the fit's limit, {estimate.value:.3g} {unknown.unit}: "
                    "the recordings are not as the law would have it; look at their pictures.",
                )
            elif unknown.form and min(share, estimate.relative_error) > KNOWN_SHARE:
                yield Remark(
                    "uncertain",
                    f"The recordings hardly determine {unknown.name}: it is what is expected of "
                    f"such limbs, {estimate}.",
                )

    def _remarks_on_starts(self) -> Iterator[Remark]:
        fit = self.fit
        states = list(itertools.product(fit.law.states, fit.segment.wires))
        # Check each temperature of each wire at the start of each recording.
        for predicted, (room, *start) in zip(fit.predicted, fit.initial_conditions, strict=True):
            run = predicted.run
            readings = run.temperature if run.is_read else predicted.temperature
            for (state, wire), value in zip(states, start, strict=True):
                if fit.law.is_temperature(state):
                    name = f"the {wire.name} wire's {state} in the recording of {run.source}"
                    yield from remarks_on_start(name, value, room, readings)


def fit_by_prediction(
    laws: Sequence[type[WireLaw]],
    recordings: Mapping[str, Sequence[Recording]],
    segment: SegmentParameters,
    ambient: float,
    *,
    report: Callable[[str], object] = lambda remark: None,
    announce: Callable[[str], object] = lambda text: None,
) -> Prediction:
    """Return the wires' law and its parameters from all heated recordings.

    Laws are judged by how they predict validation runs that they are not fitted to: the motions. If
    there are none, these are the recordings in which all wires are heated, else the last
    recordings, else the last part of each recording. Runs validate only if the other runs heat the
    same wires. The best law is fitted to all runs at the end.

    Args:
        laws: to be compared, from the simplest on.
        recordings: heated recordings by kind, such as "motion".
        segment: description of the segment, with its calibrated stiffness.
        ambient: T0, °C.
        report: is called with what is being done.
        announce: is called with the expected time in words, if it is long: estimated by one step of
            each fit, and once more after the first fits.

    Raises:
        CalibrationError: if no law predicts the validation runs as well as the baselines do.
    """
    # Split the recordings into folds, each with runs to fit and validation runs.
    runs: dict[str, list[HeatedRun]] = {}
    for kind, group in recordings.items():
        if group:
            runs[kind] = [HeatedRun.of(recording) for recording in group]
    all_runs, folds = _make_folds(runs)
    fitted_runs, judges = folds.folds[0]
    with threadpool_limits(1, "blas"):  # matrices are small; see README
        # Announce the time, s, estimated by a first step of each law.
        report("how long it takes")
        times = {law: fitting_time(law, fitted_runs, segment, ambient) for law in laws}
        # One law is fitted again with each option, for each further fold, and to all runs.
        num_further_fits = len(OPTIONS) + len(folds.folds)
        expected_time = sum(times.values()) + num_further_fits * float(np.mean([*times.values()]))
        if expected_time > MIN_ANNOUNCED_TIME:
            heated = sum(run.times[-1] for run in all_runs) / 60  # min
            announce(
                f"comparing {len(laws)} law{'s' * (len(laws) > 1)} of the wires by {heated:.0f} "
                f"min of heated recordings takes about {float(f'{expected_time:.1g}'):.0f} s"
            )
        time_left = TimeLeft(expected_time, announce)
        # Compare the laws by the first fold, and the best laws by all folds.
        candidates, best = compare_laws(
            laws,
            fitted_runs,
            judges,
            segment,
            ambient,
            continued=folds.continued,
            report=report,
            on_fitted=lambda law: time_left.add(times[law]),
        )
        baselines = [baseline_errors(others, left_out) for others, left_out in folds.folds]
        best, predictions = _best_law_by_folds(candidates, best, folds, baselines, runs, report)
        # Fit the best law to all runs, and predict the validation runs as plans are predicted.
        report(f"{best.name}, all recordings")
        rubber = rubber_options(best.fit)
        fit = fit_law(best.fit.law, all_runs, segment, ambient, rubber=rubber, start=best.fit)
        rollouts = fit.roll_out([predicted.run for predicted in predictions])
    mean_error = float(np.mean([errors[MEAN] for errors in baselines]))
    return Prediction(candidates, best, fit, folds.words, rollouts, predictions, mean_error)


class _Folds(NamedTuple):
    """Folds of a cross-validation: the runs to fit, and the runs left out for validation.

    - ``folds``: (fitted runs, validation runs) each; laws are compared by the first fold.
    - ``continued``: whether validation runs are other samples of the same recordings.
    - ``words``: the validation runs of the first fold, in words.
    """

    folds: list[tuple[list[HeatedRun], list[HeatedRun]]]
    continued: bool
    words: str


def _make_folds(runs: Mapping[str, list[HeatedRun]]) -> tuple[list[HeatedRun], _Folds]:
    """Return all runs, and the folds of the validation.

    Each wire that validation runs heat is heated in the fitted runs, too.
    """
    motions = runs.get("motion", [])
    heated = list(itertools.chain(*(group for kind, group in runs.items() if kind != "motion")))
    fitted = [*heated, *motions]
    # Validate by the motions, or else by the runs with all wires.
    for judges, words in (
        (motions, f"{len(motions)} motion{'s' * (len(motions) != 1)}, fitted last"),
        (runs.get("both", []), "what shows all wires heated, fitted last"),
    ):
        others = _without(fitted, judges)
        if judges and _heated_wires(judges) <= _heated_wires(others):
            return fitted, _Folds([(others, judges)], continued=False, words=words)
    # Or else by the last recordings, then by others in turn.
    if latest := _latest_runs(fitted):
        folds = []
        for group in [latest, *([run] for run in _without(reversed(fitted), latest))]:
            rest = _without(fitted, group)
            if _heated_wires(group) <= _heated_wires(rest):
                folds.append((rest, group))
        count = f"{len(latest)} " * (len(latest) > 1)
        words = f"the last {count}of {len(fitted)} heated recordings or pieces, fitted last"
        return fitted, _Folds(folds[:MAX_FOLDS], continued=False, words=words)
    # Or else by the last part of each recording, then by spans of the time before it.
    # Spans in multiples of the start of the last part: 1 to inf is the last part itself.
    spans = [(1.0, np.inf), *itertools.pairwise(np.linspace(0.0, 1.0, MAX_FOLDS))]
    folds = []
    for span_start, span_end in spans:
        fold: tuple[list[HeatedRun], list[HeatedRun]] = ([], [])
        for run in fitted:
            start = run.last_part_start(*LEFT_OUT_SHARES)
            rest_of_run, left_out = run.without(span_start * start, span_end * start)
            fold[0].append(rest_of_run)
            fold[1].append(left_out)
        folds.append(fold)
    words = "the last part of each recording, fitted last"
    return fitted, _Folds(folds, continued=True, words=words)


def _best_law_by_folds(
    candidates: Sequence[Candidate],
    best: Candidate,
    folds: _Folds,
    baselines: Sequence[Mapping[str, float]],
    kinds: Iterable[str],
    report: Callable[[str], object],
) -> tuple[Candidate, list[Predicted]]:
    """Return the best law that predicts the folds as well as baselines do, and its predictions.

    Errors count by their root mean square over the folds, as one fold that is far off matters.

    Raises:
        CalibrationError: if no law predicts the folds as well as the best baseline.
    """
    squares = {
        name: float(np.mean([errors[name] ** 2 for errors in baselines])) for name in baselines[0]
    }
    baseline = min(squares, key=lambda name: squares[name])
    error = np.sqrt(squares[baseline])
    allowed = max(BASELINE_ALLOWANCE[0] * error, error + BASELINE_ALLOWANCE[1])
    # Try the best law, then the laws with the smallest errors, each fitted in each further fold.
    by_error = sorted(candidates, key=lambda candidate: candidate.bend_error)
    by_error.remove(best)
    least_error = np.inf
    for candidate in [best, *by_error][:MAX_TRIED_LAWS]:
        fit = candidate.fit
        predictions = list(candidate.judged)
        law_errors = [candidate.bend_error]
        for number, (fitted_runs, judges) in enumerate(folds.folds[1:], 1):
            report(f"{candidate.name}, part {number} left out")
            rubber = rubber_options(fit)
            refit = fit_law(
                fit.law, fitted_runs, fit.segment, fit.ambient, rubber=rubber, start=fit
            )
            judged = refit.continued(judges) if folds.continued else refit.predict(judges)
            law_errors.append(mean_bend_error(judged))
            predictions += judged
        law_error = float(np.sqrt(np.mean(np.square(law_errors))))
        if law_error <= allowed:
            return candidate, predictions
        least_error = min(least_error, law_error)
    # None is as good: say what to record.
    by_law, by_baseline = np.rad2deg([least_error, error])
    next_step = next_recording(best.fit, [*kinds]) or "record more motions like those you plan"
    raise CalibrationError(
        f"These recordings tell no model: {baseline} misses the bend by {by_baseline:.0f}° "
        f"in parts that are left out in turn, and the best law by {by_law:.0f}°. Next, {next_step}."
    )


def _without(runs: Iterable[HeatedRun], left_out: Sequence[HeatedRun]) -> list[HeatedRun]:
    """Return the runs, in their order, that are not left out."""
    return [run for run in runs if run not in left_out]


def _latest_runs(runs: Sequence[HeatedRun]) -> list[HeatedRun]:
    """Return the last runs that heat each wire; none if too little heat is left to fit."""
    latest: list[HeatedRun] = []
    for wire in _heated_wires(runs):
        if wire not in _heated_wires(latest):
            latest.append(next(run for run in reversed(runs) if run.duty[:, wire].any()))
    is_too_much = _heat(latest) > MAX_HEAT_SHARE * _heat(runs)
    return [] if np.any(is_too_much) else latest


def _heat(runs: Sequence[HeatedRun]) -> np.ndarray:
    """Return the duty of each wire summed over all steps of all runs (W,); 0 without runs."""
    return np.sum([run.duty.sum(axis=0) for run in runs], axis=0)


def _heated_wires(runs: Sequence[HeatedRun]) -> set[int]:
    """Return the indices of the wires that are heated in recordings."""
    return set(np.flatnonzero(_heat(runs)).tolist())


def compare_laws(
    laws: Sequence[type[WireLaw]],
    runs: Sequence[HeatedRun],
    judges: Sequence[HeatedRun],
    segment: SegmentParameters,
    ambient: float,
    *,
    options: Sequence[str] = OPTIONS,
    continued: bool = False,
    report: Callable[[str], object] = lambda remark: None,
    on_fitted: Callable[[type[WireLaw]], object] = lambda law: None,
) -> tuple[list[Candidate], Candidate]:
    """Fit laws, then the best of them with options of the rubber, and predict the judges by each.

    Args:
        laws, segment, ambient, report: as for `fit_by_prediction`; each law starts from the last.
        runs, judges: recordings to fit to, and to predict.
        options: options of the rubber that are tried.
        continued: True if the judges are other samples of the same recordings, in their order.
        on_fitted: is called with each law when it is fitted and judged.

    Returns:
        All candidates, and the simplest that no other beats.
    """
    candidates: list[Candidate] = []

    def add(law: type[WireLaw], rubber: tuple[str, ...], start: LawFit | None) -> Candidate:
        report(" + ".join([law.__name__, *rubber]))
        fit = fit_law(law, runs, segment, ambient, rubber=rubber, start=start)
        judged_runs = fit.continued(judges) if continued else fit.predict(judges)
        candidates.append(Candidate(fit, judged_runs))
        on_fitted(law)
        return candidates[-1]

    # Fit the laws, each from the law before, then the best with options of the rubber.
    for law in laws:
        add(law, (), candidates[-1].fit if candidates else None)
    best = simplest_unbeaten_law(candidates)
    for option in options:
        rubber = (*rubber_options(best.fit), option)
        with_option = add(best.fit.law, rubber, best.fit)
        if is_beaten(best, with_option):
            best = with_option
    return candidates, best


def simplest_unbeaten_law(candidates: Sequence[Candidate]) -> Candidate:
    """Return the first of the candidates, from the simplest on, that no later candidate beats."""
    *simpler, last = candidates
    for index, candidate in enumerate(simpler):
        if not any(is_beaten(candidate, later) for later in candidates[index + 1 :]):
            return candidate
    return last


def rubber_options(fit: LawFit) -> tuple[str, ...]:
    """Return the options of the rubber that were fitted."""
    names = " ".join(fit.names)
    return tuple(option for option in OPTIONS if option in names)
