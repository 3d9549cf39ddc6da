"""Calibration by prediction error: a law with which all recordings are best predicted from duty.

All heated recordings are simulated open loop, each from an initial state of its
own. What sensors add (noise, an offset, a slow drift) and what no law of a few
parameters has (the form of the model) is noise with a memory: residuals are
whitened by its covariance, so that they count for what they are worth.
"""

import copy
import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from calibration.estimate import Estimate, record_of
from calibration.prediction.heated_run import STEP, HeatedRun
from calibration.prediction.in_space import OpenLoopInSpace
from calibration.prediction.residual_noise import ResidualNoise
from calibration.prediction.unknowns import (
    ABSENT_VALUES,
    FORMER_FIELDS,
    Unknown,
    laws_before_fit,
    prior_factor,
    slopes_of,
    split_unknowns,
    unknowns_of,
    values_of,
)
from limb_systems import LimbParameters, RestMemory, SegmentParameters, WireLaw
from limb_systems.law_functions import with_fields
from limb_systems.monte_carlo import OpenLoop, parameter_owner, stack_laws
from limb_systems.ragged_rows import RaggedRows

AMBIENT_SPREAD = 1.5  # °C, between the rooms of two recordings
READING_SPREAD = 1.0  # °C, of a wire from its thermocouple while both rest
UNREAD_WARMTH = 10.0  # °C, by which wires without thermocouples may be warm at the start
COOLING_TIME = 3.0  # s, by which a thermocouple may be late at the start
COOLING_RATE = 0.1  # 1/s, at which a wire may cool where its slope is not known
MEMORY_SPREAD = 0.05  # of other states than temperatures, in typical changes, of a cold wire

# Of residuals: standard deviation in each sample; of what drifts, and within what time, s. In °C.
TEMPERATURE_NOISE = (0.3, 0.5, 300.0)
BEND_DRIFT_TIME = 120.0  # s
# What the law's form leaves of bends, rad, and of readings, °C: its least size; and its size and
# the time within which it stays alike, s, before they are fitted.
MIN_FORM_SIZES = (np.deg2rad(0.2), 0.3)
FORM_TIME = 8.0  # s
INITIAL_FORMS = ((np.deg2rad(0.7), FORM_TIME), (1.0, FORM_TIME))
FORM_TIMES = (0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)  # s, that are tried
MAX_LAG = 16.0  # s, of residuals that are compared
NUM_PASSES = 2, 4  # with thermocouples, and at most without, as residuals are weighed after each
SAME_SIZE_RATIO = 1.5  # ratio of sizes, within which another pass changes little
# rad and °C of error that weigh the same
BEND_SCALE = np.deg2rad(1.0)
TEMPERATURE_SCALE = 3.0
OUTLIER_DEVIATIONS = 6.0  # robust standard deviations
RELATIVE_STEP = 1e-4  # of finite differences, in spreads of the prior
TOLERANCE = 1e-4  # relative, at which iterations end
MAX_ITERATIONS = 40
NUM_FIT_STEPS = 10  # that take as long as its first, roughly
KNOWN_SHARE = 0.5  # share of what was unknown beforehand, below which more of it tells little
NUM_STARTS = 16  # of a fit, of which the best is taken


@dataclasses.dataclass(frozen=True, eq=False)
class Predicted:
    """A recording as a law predicts it from its duty.

    - ``run``: the recording.
    - ``temperature``, ``bend``: predicted V (M, W), °C, and φ (M, F), rad.
    """

    run: HeatedRun
    temperature: np.ndarray
    bend: np.ndarray

    @property
    def bend_error(self) -> float:
        """Mean |φ - φ_sim|, rad."""
        return float(np.nanmean(np.linalg.norm(self.bend - self.run.bend, axis=1)))

    @property
    def temperature_error(self) -> float:
        """Mean |V - V_sim|, °C; nan without thermocouples."""
        errors = np.abs(self.temperature - self.run.temperature)
        return float(np.nanmean(errors)) if self.run.is_read else np.nan


def mean_bend_error(group: Sequence[Predicted]) -> float:
    """Return the mean `Predicted.bend_error` of recordings, rad."""
    return float(np.mean([predicted.bend_error for predicted in group]))


def mean_temperature_error(group: Sequence[Predicted]) -> float:
    """Return the mean `Predicted.temperature_error` of recordings with thermocouples, °C, or 0."""
    errors = [predicted.temperature_error for predicted in group if predicted.run.is_read]
    return float(np.mean(errors)) if errors else 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class LawFit:
    """A law fitted to R recordings by P unknowns, of a segment of W wires.

    - ``law``: class of the law.
    - ``segment``: the segment as it was described.
    - ``unknowns``: quantities that were fitted (P).
    - ``fitted``: values of the unknowns (P), as `Unknown` has them.
    - ``covariance``: covariance of these values (P, P).
    - ``ambient``: T0, °C.
    - ``initial_conditions``: T0 and the Q - 1 initial states of the wires in each recording (R, Q).
    - ``predicted``: the recordings of the fit, as they are predicted from these conditions.
    - ``hottest``: highest T of each wire in these predictions (W,), °C.
    - ``unidentified``: quantities that recordings tell nothing of, which stay as expected.
    """

    law: type[WireLaw]
    segment: SegmentParameters
    unknowns: list[Unknown]
    fitted: np.ndarray
    covariance: np.ndarray
    ambient: float
    initial_conditions: np.ndarray
    predicted: list[Predicted]
    hottest: np.ndarray
    unidentified: list[Unknown] = dataclasses.field(default_factory=list)

    @property
    def measures_heat(self) -> bool:
        """Return whether any thermocouple was read; a2 stays as described if none was."""
        return any(predicted.run.is_read for predicted in self.predicted)

    @property
    def names(self) -> list[str]:
        """The names of the unknowns (P)."""
        return [unknown.name for unknown in self.unknowns]

    @property
    def estimates(self) -> dict[str, Estimate]:
        """The parameters by name, with their standard errors."""
        errors = np.sqrt(np.diag(self.value_covariance)).tolist()
        values = map(float, values_of(self.unknowns, self.fitted))
        return {
            unknown.name: Estimate(value, error, unknown.unit, may_be_zero=not unknown.form)
            for unknown, value, error in zip(self.unknowns, values, errors, strict=True)
        }

    def apply(self, limb: LimbParameters) -> None:
        """Give the segment of a limb these laws and this rubber."""
        (segment,) = limb.segments
        # Set the law and the memory first, then their numbers.
        for wire, law in zip(segment.wires, laws_before_fit(self.law, self.segment), strict=True):
            wire.law = law
        all_unknowns = [*self.unknowns, *self.unidentified]
        if any(unknown.field == "shift" for unknown in all_unknowns):
            segment.rest_memory = RestMemory()
        all_fitted = [*self.fitted, *(unknown.center for unknown in self.unidentified)]
        values = values_of(all_unknowns, all_fitted)
        for unknown, value in zip(all_unknowns, values, strict=True):
            owner, field = parameter_owner(limb, unknown.name)
            setattr(owner, field, float(value))

    def calibrated(self, described: LimbParameters) -> LimbParameters:
        """Return a limb with the fitted laws, rubber and ambient temperature, and their record.

        Its stiffness is the fit's, and its other mechanics are as described.
        """
        limb = copy.deepcopy(described)
        limb.ambient_temperature = self.ambient
        limb.segments[0].stiffness = self.segment.stiffness
        self.apply(limb)
        limb.calibration = record_of(self.estimates, self.value_covariance)
        return limb

    @property
    def misfit(self) -> float:
        """Mean error of bend and readings in the recordings of the fit, in their scales."""
        bend_misfit = mean_bend_error(self.predicted) / BEND_SCALE
        return bend_misfit + mean_temperature_error(self.predicted) / TEMPERATURE_SCALE

    @property
    def unknown_shares(self) -> np.ndarray:
        """Standard errors of the unknowns (P,), over what was expected of them beforehand."""
        before = [np.hypot(unknown.spread, unknown.wire_spread) for unknown in self.unknowns]
        return np.sqrt(np.diag(self.covariance)) / before

    @property
    def value_covariance(self) -> np.ndarray:
        """Covariance of the estimates, in the products of their units (P, P)."""
        slopes = slopes_of(self.unknowns, self.fitted)
        return slopes @ self.covariance @ slopes.T

    def predict(self, runs: Sequence[HeatedRun]) -> list[Predicted]:
        """Predict recordings open loop, each from the initial state that suits it best.

        That state is not recorded: a limb that is not quite cold has warm silicone.
        """
        problem = self._problem(runs)
        problem.num_moved = 0
        x = np.concatenate([self.fitted, problem.initial_center])
        return problem.predicted(problem.optimum(x, free=slice(len(self.fitted), None)))

    def roll_out(self, runs: Sequence[HeatedRun]) -> list[Predicted]:
        """Predict recordings open loop from what is read at their start, as a plan begins."""
        problem = self._problem(runs)
        return problem.predicted(np.concatenate([self.fitted, problem.initial_center]))

    def continued(self, runs: Sequence[HeatedRun]) -> list[Predicted]:
        """Predict other samples of the recordings of the fit, from the same initial states."""
        problem = self._problem(runs)
        return problem.predicted(np.concatenate([self.fitted, self.initial_conditions.ravel()]))

    def _problem(self, runs: Sequence[HeatedRun]) -> "_FitProblem":
        return _FitProblem(
            self.law, runs, self.segment, self.ambient, self.unknowns, self.unidentified
        )


def fit_law(
    law: type[WireLaw],
    runs: Sequence[HeatedRun],
    segment: SegmentParameters,
    ambient: float,
    *,
    rubber: tuple[str, ...] = (),
    start: LawFit | None = None,
) -> LawFit:
    """Fit a law to recordings by their open-loop prediction.

    A law that contains the start's law predicts the same recordings no worse.

    Args:
        law: class of the law of all wires.
        runs: the recordings.
        segment: the described one; its stiffness counts, and its wires' laws as what
            is expected.
        ambient: T0, °C, about which each recording has its own.
        rubber: as for `unknowns_of`.
        start: a fit of this or another law, of which values of the same name are taken.
    """
    # Fit the unknowns that the recordings can identify.
    heated = np.zeros(len(segment.wires), bool)
    read = np.zeros(len(segment.wires), bool)
    for run in runs:
        heated |= run.duty.any(axis=0)
        read |= run.counts[:, segment.axes :].any(axis=0)
    unknowns, unidentified = split_unknowns(unknowns_of(law, segment, rubber), heated, read)
    problem = _FitProblem(law, runs, segment, ambient, unknowns, unidentified)
    # Start from the optimum of this law, of a law that it contains, or from a likelier start.
    start_values: dict[str, float] = {}
    start_in_law = None
    if start is not None:
        start_values = dict(zip(start.names, start.fitted, strict=True))
        start_in_law = problem.contained(start)
    if start_in_law is not None and start is not None and start.law is law:
        x = start_in_law
    else:
        x = problem.best_start([start_values.get(u.name, u.center) for u in unknowns], start_in_law)
    for number in range(NUM_PASSES[1]):
        # Fit, then weight residuals by what the law's form leaves, and fit again.
        x = problem.optimum(x, tolerance=TOLERANCE if number else 10 * TOLERANCE)
        changed = problem.reweigh(x)
        if number + 1 >= NUM_PASSES[0] and (problem.reads_heat or changed < SAME_SIZE_RATIO):
            break
    fit = problem.fit_at(x)
    # Return the start in place of a fit to the same recordings that is worse.
    if start_in_law is not None and start is not None:
        is_to_these_runs = [id(each.run) for each in start.predicted] == [*map(id, runs)]
        if is_to_these_runs and fit.misfit > start.misfit:
            return problem.fit_at(start_in_law)
    return fit


def fitting_time(
    law: type[WireLaw], runs: Sequence[HeatedRun], segment: SegmentParameters, ambient: float
) -> float:
    """Estimate the time that `fit_law` takes on this machine, s, by its first step."""
    start = time.monotonic()
    problem = _FitProblem(law, runs, segment, ambient, unknowns_of(law, segment), [])
    problem.residuals(problem.center)
    return NUM_FIT_STEPS * (time.monotonic() - start)


class _FitProblem:
    """The whitened residuals of all recordings and of the prior, and their Jacobian.

    The parameter vector x (P + R Q,) is the unknowns (P), then for each of R recordings its initial
    conditions (Q): its T0, and the states of its W wires at the start, all wires for each state in
    turn. Signals of a recording are its F bends φ, then its W readings V, at M samples. B vectors x
    are simulated at once. The Jacobian is zero for unknowns from ``num_moved`` on.
    """

    def __init__(
        self,
        law: type[WireLaw],
        runs: Sequence[HeatedRun],
        segment: SegmentParameters,
        ambient: float,
        unknowns: list[Unknown],
        unidentified: list[Unknown],
    ):
        self._law = law
        self._described_laws = laws_before_fit(law, segment)
        self._runs = runs
        self._unknowns = unknowns
        self._ambient = ambient
        self._segment = segment
        self._unidentified = unidentified
        self._num_wires = len(segment.wires)
        self._stiffness = segment.stiffness
        self.num_moved = len(unknowns)
        # Simulate all runs at once, in arrays as long as the longest run.
        lengths = [len(run.duty) for run in runs]
        duty = np.zeros((max(lengths), len(runs), self._num_wires))
        for number, run in enumerate(runs):
            duty[: len(run.duty), number] = run.duty
        self._first_readings = np.nan_to_num([run.first for run in runs], nan=ambient)
        self._open_loop = (
            OpenLoop(duty, STEP, segment, lengths)
            if segment.axes == 1
            else OpenLoopInSpace(duty, STEP, segment, [run.load for run in runs], lengths)
        )
        self._num_bends = segment.axes
        # Center, spread and bounds of x: of the unknowns, then of the initial conditions, which
        # have centers and spreads in each recording (R, 2, Q).
        self._prior = prior_factor(unknowns)
        initial_priors = np.array([*map(self._initial_prior, runs, self._first_readings)])
        self.initial_center = initial_priors[:, 0].ravel()
        self._initial_spread = initial_priors[:, 1].ravel()
        self._num_initial = initial_priors.shape[-1]
        priors = np.array([(u.center, u.spread, u.low, u.high) for u in unknowns])
        centers, spreads, low, high = priors.T
        self.center = np.concatenate([centers, self.initial_center])
        self.spread = np.concatenate([spreads, self._initial_spread])
        unbounded = np.full(len(self.initial_center), np.inf)
        self.bounds = np.array([[*low, *-unbounded], [*high, *unbounded]])
        # Signals that each recording has, and means that are outliers.
        self.reads_heat = any(run.is_read for run in runs)
        self.num_readings = sum(int((run.counts > 0).sum()) for run in runs)
        self._outliers = [np.zeros(run.counts.T.shape, bool) for run in runs]
        self._arrange_samples()
        # Noise of the sensors, and errors of the law's form, by which residuals are whitened.
        sensor = segment.bend_sensor
        self._noises = ((sensor.noise, sensor.drift, BEND_DRIFT_TIME), TEMPERATURE_NOISE)
        self._forms = [*INITIAL_FORMS]
        self._simulated: tuple[np.ndarray, np.ndarray] = np.empty(0), np.empty(0)
        self._whiten()

    def _arrange_samples(self) -> None:
        """Set rows of the samples of all signals that recordings have, one sequence a signal."""
        self._columns: list[tuple[int, int]] = []  # index of the run, and of its signal
        for number, run in enumerate(self._runs):
            signals = np.flatnonzero(run.counts.any(axis=0)).tolist()
            self._columns += [(number, signal) for signal in signals]
        self._samples = RaggedRows([len(self._runs[number].times) for number, _ in self._columns])
        # The reading of each sample, and the simulated rows before and after it.
        count = self._samples.count
        self._readings = np.empty(count)
        self._counts = np.empty(count)
        self._rows_before = np.empty(count, int)
        self._rows_after = np.empty(count, int)
        self._shares_after = np.empty((count, 1))
        self._signals = np.empty(count, int)
        self._rows_of_run: list[list[np.ndarray]] = [[] for _ in self._runs]
        for (number, signal), rows in zip(self._columns, self._samples.of_sequence, strict=True):
            run = self._runs[number]
            before, share = run.steps_before()
            self._readings[rows] = run.signals[:, signal]
            self._counts[rows] = run.counts[:, signal]
            self._rows_before[rows] = self._open_loop.rows.of_sequence[number][before]
            self._rows_after[rows] = self._open_loop.rows.of_sequence[number][before + 1]
            self._shares_after[rows, 0] = share
            self._signals[rows] = signal
            self._rows_of_run[number].append(rows)

    def _initial_prior(self, run: HeatedRun, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return expected initial conditions (Q,) and spreads (Q,) of a run with first V (W,)."""
        centers = [np.array([self._ambient])]
        spreads = [np.array([AMBIENT_SPREAD])]
        # Wires without a thermocouple may be as warm as the warmest.
        warmth = np.abs(first - self._ambient)
        warmth[np.isnan(run.first)] = warmth.max()  # as warm as another is, or not at all
        unread_warmth = 0.0
        if not run.is_read:
            unread_warmth = UNREAD_WARMTH
            warmth += unread_warmth
        # The initial state is the less certain the faster a wire cools.
        slope = np.where(np.isnan(run.slope), COOLING_RATE * warmth, np.abs(run.slope))
        change = COOLING_TIME * slope
        cold_states = self._described_laws[0].cold_states(0.0)
        for cold, (name, scale) in zip(cold_states, self._law.states.items(), strict=True):
            if self._law.is_temperature(name):
                is_of_wire = len(centers) == 1  # the first state; others are of what surrounds it
                unknown_warmth = unread_warmth if is_of_wire else 0.3 * warmth
                centers.append(first)
                spreads.append(READING_SPREAD + change + unknown_warmth)
            else:
                centers.append(np.full(self._num_wires, cold))
                spreads.append(scale * (MEMORY_SPREAD + warmth / 100.0))
        return np.concatenate(centers), np.concatenate(spreads)

    def _whiten(self) -> None:
        """Set the noise of the residuals, of each signal of each recording that has samples."""
        self._evaluated: tuple[np.ndarray, Any] = np.empty(0), None  # by this noise
        times = np.empty(self._samples.count)
        sample_variance = np.empty(self._samples.count)
        sizes = np.empty((2, len(self._columns)))
        memories = np.empty((2, len(self._columns)))
        for column, (number, signal) in enumerate(self._columns):
            # Variance of each mean; outliers count for almost nothing.
            run = self._runs[number]
            is_reading = int(signal >= self._num_bends)
            sample, drift, drift_time = self._noises[is_reading]
            counts = run.counts[:, signal]
            variance = sample**2 / np.maximum(counts, 1) + 1e-12
            variance += (100 * sample * self._outliers[number][signal]) ** 2
            rows = self._samples.of_sequence[column]
            times[rows] = run.times
            sample_variance[rows] = np.where(counts > 0, variance, np.inf)
            form, form_time = self._forms[is_reading]
            sizes[:, column] = drift, form
            memories[:, column] = drift_time, form_time
        self._noise = ResidualNoise(self._samples, times, sample_variance, sizes, memories)

    def reweigh(self, x: np.ndarray) -> float:
        """Fit the size and the memory of the form's errors to the residuals at x; mark outliers.

        Returns:
            The largest ratio of their sizes before and after, either way; at least 1.
        """
        # Sum products of residuals that are apart by each lag.
        lags = np.arange(round(MAX_LAG / STEP))
        sums = np.zeros((2, 2, len(lags)))  # of bends and readings: products, and their number
        for predicted, outliers in zip(self.predicted(x), self._outliers, strict=True):
            errors = np.column_stack([predicted.bend, predicted.temperature])
            for signal, error in enumerate((errors - predicted.run.signals).T):
                if np.isnan(error).all():
                    continue
                around = error - np.nanmedian(error)
                spread = 1.48 * np.nanmedian(np.abs(around)) + 1e-9
                outliers[signal] = ~(np.abs(around) <= OUTLIER_DEVIATIONS * spread)
                steps = (predicted.run.times / STEP).astype(int)
                even_residuals = np.full(steps[-1] + 1, np.nan)
                even_residuals[steps] = np.where(outliers[signal], np.nan, around)
                even_residuals -= np.nanmean(even_residuals)
                kind_sums = sums[int(signal >= self._num_bends)]
                for lag in lags[: len(even_residuals)]:
                    products = even_residuals[lag:] * even_residuals[: len(even_residuals) - lag]
                    kind_sums[0, lag] += np.nansum(products)
                    kind_sums[1, lag] += (~np.isnan(products)).sum()
        change = 1.0
        for kind, (products, counts) in enumerate(sums):
            if not counts[0]:
                continue
            # The size, and the memory: the exponential nearest to the covariances of all lags.
            covariances = products / np.maximum(counts, 1)
            shapes = np.exp(-STEP * lags / np.array(FORM_TIMES)[:, None])
            scales = (shapes * counts) @ covariances / ((shapes**2) @ counts)
            misfits = ((covariances - scales[:, None] * shapes) ** 2) @ counts
            size = max(float(np.sqrt(covariances[0])), MIN_FORM_SIZES[kind])
            change = max(change, size / self._forms[kind][0], self._forms[kind][0] / size)
            # With thermocouples the memory is kept: fitted ones made feedback follow the drift.
            memory = FORM_TIME if self.reads_heat else FORM_TIMES[int(np.argmin(misfits))]
            self._forms[kind] = (size, memory)
        self._whiten()
        return change

    def fit_at(self, x: np.ndarray) -> LawFit:
        """Return the fit whose unknowns and initial conditions are x."""
        # The covariance follows from the Jacobian, widened by the misfit.
        residuals, jacobian = self.residuals(x)
        misfit = max(1.0, float((residuals[: -len(x)] ** 2).sum() / self.num_readings))
        covariance = misfit * np.linalg.pinv(jacobian.T @ jacobian)
        size = len(self._unknowns)
        return LawFit(
            self._law,
            self._segment,
            self._unknowns,
            x[:size],
            covariance[:size, :size],
            self._ambient,
            x[size:].reshape(len(self._runs), -1),
            self.predicted(x),
            self._simulate_states(x[None])[0].max(axis=(0, 2)),
            self._unidentified,
        )

    def contained(self, fit: LawFit) -> np.ndarray | None:
        """Return x with which this law predicts as the law of a fit does; None if there is none."""
        # Take each unknown from the fit, or the value with which it has no effect.
        former_unknowns = dict(zip(fit.names, fit.fitted, strict=True))
        x = self.center.copy()
        for index, unknown in enumerate(self._unknowns):
            name = unknown.name
            owner, _, field = name.rpartition(".")
            if name not in former_unknowns and field in FORMER_FIELDS:
                name = f"{owner}.{FORMER_FIELDS[field]}"
            x[index] = former_unknowns.pop(name, ABSENT_VALUES.get(field, x[index]))
        if former_unknowns:
            return None
        size = len(self._unknowns)
        x[:size] = self._inside_bounds(x[:size])
        # The initial conditions of each recording, or of another part of it, that the fit has: the
        # ambient temperature, the states that both laws have, and others of cold wires.
        for run, values in zip(self._runs, x[size:].reshape(len(self._runs), -1), strict=True):
            for predicted, former_values in zip(fit.predicted, fit.initial_conditions, strict=True):
                if predicted.run.duty is not run.duty:
                    continue
                values[0] = former_values[0]
                states = values[1:].reshape(-1, self._num_wires)
                former = former_values[1:].reshape(-1, self._num_wires)
                states[:] = np.array(self._described_laws[0].cold_states(values[0]))[:, None]
                for row, state in enumerate(self._law.states):
                    if state in fit.law.states:
                        states[row] = former[list(fit.law.states).index(state)]
        return x

    def _inside_bounds(self, values: np.ndarray) -> np.ndarray:
        """Return values of the unknowns (..., P), moved inside their bounds."""
        low, high = self.bounds[:, : len(self._unknowns)]
        margin = 1e-6 * (high - low)
        return np.clip(values, low + margin, high - margin)

    def _simulate_states(
        self, x: np.ndarray, *, near_first: bool = False
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Simulate parameter sets x (B, P + R Q), in the S rows of the open loop.

        Returns:
            T and V (S, W, B), °C, and φ (S, F, B), rad.
        """
        size = len(self._unknowns)
        num_wires = self._num_wires
        num_sets = len(x)
        fields = vars(stack_laws([self._described_laws] * num_sets))
        rubber = {"stiffness": np.full(num_sets, self._stiffness)}
        # Sort the values into fields of the laws and of the rubber.
        columns = [*x.T[:size]]
        for unknown in self._unidentified:
            columns.append(np.full(num_sets, unknown.center))
        all_unknowns = [*self._unknowns, *self._unidentified]
        for unknown, value in zip(all_unknowns, values_of(all_unknowns, columns), strict=True):
            if unknown.wire is None:
                rubber[unknown.field] = value
            elif unknown.field == "angle":
                rubber.setdefault("angle", np.empty((num_sets, num_wires)))[:, unknown.wire] = value
            else:
                fields[unknown.field][:, 0, unknown.wire] = value
        initial_conditions = x[:, size:].reshape(num_sets, len(self._runs), self._num_initial)
        states = np.moveaxis(
            initial_conditions[:, :, 1:].reshape(num_sets, len(self._runs), -1, num_wires), 2, 0
        )
        initial = [*states, np.broadcast_to(self._first_readings, states[0].shape)]
        law = with_fields(self._law, fields)
        return self._open_loop.simulate(
            law, initial_conditions[:, :, 0], initial, rubber, near_first=near_first
        )

    def _simulate(self, x: np.ndarray, **options: bool) -> np.ndarray:
        """Simulate φ and V (S, F + W, B) for parameter sets x (B, P + R Q)."""
        _, readings, bends = self._simulate_states(x, **options)
        return np.concatenate([bends, readings], axis=1)

    def predicted(self, x: np.ndarray) -> list[Predicted]:
        """Return all recordings as they are predicted with one x."""
        simulated_x, signals = self._simulated
        if not np.array_equal(simulated_x, x):
            signals = self._simulate(x[None])
        result = []
        for run, rows in zip(self._runs, self._open_loop.rows.of_sequence, strict=True):
            run_signals = run.interpolated(signals[rows, :, 0])
            bends, readings = np.split(run_signals, [self._num_bends], axis=1)
            result.append(Predicted(run, readings, bends))
        return result

    def _whitened(self, simulated: np.ndarray) -> np.ndarray:
        """Return the whitened residuals of all samples (all M, B), zero where missing."""
        # Interpolate between the ends of steps.
        before = simulated[self._rows_before, self._signals]
        residuals = simulated[self._rows_after, self._signals]
        residuals -= before
        residuals *= self._shares_after
        residuals += before
        residuals -= self._readings[:, None]
        residuals[self._counts == 0] = 0.0
        return self._noise.whiten(residuals)

    def _beforehand(self, x: np.ndarray) -> np.ndarray:
        """Return the residuals of the prior at x (P + R Q,)."""
        size = len(self._unknowns)
        offset = x - self.center
        return np.concatenate([self._prior @ offset[:size], offset[size:] / self._initial_spread])

    def best_start(self, values: Sequence[float], contained: np.ndarray | None) -> np.ndarray:
        """Return the x with the least cost: of values (P), of a former fit's x, or random draws."""
        size = len(self._unknowns)
        num_starts = NUM_STARTS if contained is None else 3
        starts = np.tile(self.center, (num_starts, 1))
        starts[0, :size] = values
        if contained is not None:
            starts[-1] = contained
        else:
            random = np.random.default_rng(0).standard_normal((num_starts - 2, size))
            starts[2:, :size] += random * self.spread[:size]
        starts[:, :size] = self._inside_bounds(starts[:, :size])
        # Simulate all starts at once, and take the start with the least cost.
        with np.errstate(all="ignore"):  # of values that nobody has
            costs = np.array([(self._beforehand(x) ** 2).sum() for x in starts])
            costs += (self._whitened(self._simulate(starts)) ** 2).sum(axis=0)
        return starts[int(np.argmin(np.nan_to_num(costs, nan=np.inf)))]

    def optimum(
        self,
        x: np.ndarray,
        *,
        free: slice = slice(None),
        tolerance: float = 10 * TOLERANCE,
    ) -> np.ndarray:
        """Return the x with the least cost, by a trust region from x, of which a part is free."""
        # Count in spreads from the center, as the trust region and its tolerance do not scale.
        center = self.center[free]
        spread = self.spread[free]

        def full_vector(distances: np.ndarray) -> np.ndarray:
            result = x.copy()
            result[free] = center + spread * distances
            return result

        solution = least_squares(
            lambda z: self.residuals(full_vector(z))[0],
            (x[free] - center) / spread,
            lambda z: self.residuals(full_vector(z))[1][:, free] * spread,
            bounds=(self.bounds[:, free] - center) / spread,
            ftol=tolerance,
            xtol=TOLERANCE,
            gtol=1e-10,
            max_nfev=MAX_ITERATIONS,
        )
        return full_vector(solution.x)

    def residuals(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals at x (all,), and their Jacobian by differences (all, P + R Q).

        The residuals are of the recordings, then of the prior. One set of parameters takes more
        than half of the time of all, and nearly every x is evaluated for both. An initial condition
        is moved in all recordings at once, as it acts on its own recording alone.
        """
        evaluated_x, values = self._evaluated
        if np.array_equal(evaluated_x, x):
            return values
        size = len(self._unknowns)
        count = self._num_initial
        num_moved = self.num_moved
        # Simulate x and a small step along each unknown.
        step = RELATIVE_STEP * self.spread
        if not np.array_equal(self._simulated[0], x):
            moved_x = np.tile(x, (1 + num_moved + count, 1))
            for index in range(num_moved):
                moved_x[1 + index, index] += step[index]
            for index in range(count):
                moved_x[1 + num_moved + index, size + index :: count] += step[size + index :: count]
            self._simulated = x.copy(), self._simulate(moved_x, near_first=True)
        # Steps into what cannot be simulated are refused by the solver if they are far off.
        with np.errstate(over="ignore", invalid="ignore"):
            whitened = self._whitened(self._simulated[1])
        # Rotate each run's residuals into as many rows as it has unknowns, and one. The sum of
        # their squares stays, and so do its slopes.
        errors = []
        rows = []
        column = size
        for run_rows in self._rows_of_run:
            run_residuals = whitened[np.concatenate(run_rows)]
            columns = slice(column, column := column + count)
            changes = run_residuals[:, 1:] - run_residuals[:, :1]
            slopes = changes / np.concatenate([step[:num_moved], step[columns]])
            readings = np.nan_to_num(run_residuals[:, 0], nan=1e6, posinf=1e6, neginf=-1e6)
            stacked_residuals = np.column_stack([slopes, readings])
            rotated = np.asarray(np.linalg.qr(stacked_residuals, mode="r"))
            block = np.zeros((len(rotated), len(x)))
            block[:, :num_moved] = rotated[:, :num_moved]
            block[:, columns] = rotated[:, num_moved:-1]
            rows.append(block)
            errors.append(rotated[:, -1])
        # Append the residuals of the prior.
        prior_rows = np.zeros((len(x), len(x)))
        prior_rows[:size, :size] = self._prior
        prior_rows[size:, size:] = np.diag(1 / self._initial_spread)
        result = np.concatenate([*errors, self._beforehand(x)]), np.vstack([*rows, prior_rows])
        self._evaluated = x.copy(), result
        return result
