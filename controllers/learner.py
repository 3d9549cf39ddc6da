"""Learning over repetitions: the duty that brings a limb to the reference of its plan.

A plan is repeated. The errors of the model repeat in each repetition, the sensor's
noise and drift do not. `RepeatingError` separates them, and `DutyCorrection` finds
the duty for a limb with the repeating errors, within the limb's limits. This is
norm-optimal iterative learning control, with a gain that falls as repetitions add up.
"""

import dataclasses
import hashlib
import itertools
import json
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.linalg import block_diag
from scipy.ndimage import uniform_filter1d

from controllers.duty_correction import READING_MARGIN, DutyCorrection, Residuals
from controllers.estimator import DRIFT_TIME
from limb_systems import LimbError, LimbModel, Provenance, Recording, Trajectory
from limb_systems.errors import reraise_as
from limb_systems.files.csv_format import FileFormatError
from limb_systems.files.input import LARGEST_TABLE, FirstLine, first_line, read_bytes
from limb_systems.files.output import write_atomically
from limb_systems.plan_band import MEAN_TO_DEVIATION
from limb_systems.tracking import reference_distances, tracking_errors

READING_NOISE = 0.3  # °C, of a mean of some readings of a thermocouple
MEAN_VARIANCE_SHARE = 0.25  # of a sample's variance, left in the mean of those around a node
MIN_VARIANCE = 1e-10  # rad², so that sensors without noise leave no singular matrix
ERROR_CORRELATION_TIME = 2.0  # s, in which the correlation of the model's errors falls to 1/e
CHANGE_MEMORY_TIME = 10.0  # s, in which limbs forget a change of their duty
REST_ERROR = np.deg2rad(1.0)  # of the model's bend with cold wires
UNKNOWN_BEND = np.deg2rad(5.0)  # error of an uncalibrated model
UNKNOWN_TEMPERATURE = 10.0  # °C, error of an uncalibrated model
REST_CHANGE = np.deg2rad(0.1)  # by which a limb changes between repetitions
TEMPERATURE_CHANGE = 0.3  # °C, likewise
# Random errors of the model's changes, relative to them: for bends, one of these shares.
SHARES = np.geomspace(0.1, 1.6, 9)
TEMPERATURE_SHARE = 0.15
EXPECTED_SHARE = 0.3  # at least, of bends before the first repetition
SHARE_FACTOR = 2.0  # one standard deviation of the expected share
EVIDENCE_DECAY = 0.8  # weight of the evidence about the shares after another repetition
GAIN_DEVIATION = 0.5  # standard deviation of the limb's gains over the model
MIN_GAIN = 0.4
MAX_GAIN = 2.5
DEVIATION_TO_MEAN = 0.6  # of the mean of |x| over the standard deviation of x, if x is normal
SMOOTHING_NODES = 5  # over which the mean of readings has little noise
WORSE_DEVIATIONS = 0.1  # standard deviations; a repetition that seems worse by more is undone
IDENTICAL_SHARE = 0.25  # of the sensor's error; duties that change the bend less are nearly equal
OVERHEATING_MARGIN = 3.0  # °C, by which bounds are lowered after a wire was read too hot
MIN_CHANGE_SHARE = 0.05  # of the sensor's error; another repetition must change the bend by more
MAX_INTERRUPTED = 3  # in a row
MAX_FAILURES = 5  # in a row, interrupted or not better
MIN_STEP_SIZE = 0.25  # of a step, after repetitions that were not better
FORMAT_VERSION = 7  # of files of learners
_FIRST_LINE = f"{FirstLine('learning', FORMAT_VERSION)}, sha256 "


def ornstein_uhlenbeck(times: np.ndarray, deviation: ArrayLike, duration: float) -> np.ndarray:
    """Return the covariance (M, M) at times (M,) of an Ornstein-Uhlenbeck process.

    Args:
        deviation: standard deviation, one for all times or for each (M,).
        duration: time in which the correlation falls to 1/e, s.
    """
    deviation = np.broadcast_to(deviation, times.shape)
    separations = np.abs(np.subtract.outer(times, times))
    return np.outer(deviation, deviation) * np.exp(-separations / duration)


@dataclasses.dataclass(frozen=True, eq=False)
class Estimate:
    """The estimate of a repeating error from repetitions.

    - ``error``: d (M,), zero before the first repetition.
    - ``gains``: how many times as strongly as the model the limb responds to each wire (W,).
    - ``covariance``: covariance of both (M + W, M + W).
    """

    error: np.ndarray
    gains: np.ndarray
    covariance: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class RepeatingError:
    """Bayesian regression for an error d (M,) over time that nearly repeats.

    Repetition j observes H (d + Σ (g_w - 1) ψ_w + δ) + noise. ψ_w (M,) is the change of the model's
    bend when wire w has its duty of repetition j instead of the duty about which d is estimated.
    The limb responds g_w times as strongly as the model. δ is random, a share of the ψ_w.

    - ``times``: (M,), s.
    - ``covariance``: covariance of d before the first repetition (M, M).
    - ``observes``: H (M, M).
    - ``noise``: covariance of the noise (M, M), and of δ without any change of duty.
    """

    times: np.ndarray
    covariance: np.ndarray
    observes: np.ndarray
    noise: np.ndarray

    def estimate(self, observations: np.ndarray, changes: np.ndarray, share: float) -> Estimate:
        """Return the estimate of the error and of the gains from J repetitions.

        Args:
            observations: (J, M), NaN where there is none.
            changes: ψ (J, M, W).
            share: random error of the changes, relative to them.
        """
        M, W = changes.shape[1:]
        information = block_diag(np.linalg.inv(self.covariance), np.eye(W) / GAIN_DEVIATION**2)
        weighted_sum = np.zeros(M + W)
        for values, change in zip(observations, changes, strict=True):
            H, spread, is_seen = self._observation(values, change)
            weighted = np.linalg.solve(spread(share), H).T
            information += weighted @ H
            weighted_sum += weighted @ values[is_seen]
        covariance = np.linalg.inv(information)
        mean = covariance @ weighted_sum
        gains = np.clip(1 + mean[M:], MIN_GAIN, MAX_GAIN)
        return Estimate(mean[:M], gains, covariance)

    def likelihoods(
        self, before: Estimate, observation: np.ndarray, change: np.ndarray
    ) -> np.ndarray:
        """Return the log-likelihood of a repetition by the estimate before it, for all `SHARES`."""
        H, spread, is_seen = self._observation(observation, change)
        surprise = observation[is_seen] - H @ np.append(before.error, before.gains - 1)
        expected = H @ before.covariance @ H.T
        likelihoods = []
        for share in SHARES:
            factor = np.linalg.cholesky(expected + spread(share))
            white = np.linalg.solve(factor, surprise)
            likelihoods.append(-np.log(np.diag(factor)).sum() - 0.5 * white @ white)
        return np.array(likelihoods)

    def _observation(self, observation: np.ndarray, change: np.ndarray):
        """Return H of d and g, the covariance of the rest by the share, and where values are."""
        is_seen = np.isfinite(observation)
        H = self.observes[is_seen]
        noise = self.noise[np.ix_(is_seen, is_seen)]
        forgotten = np.exp(-self.times[-1] / max(1, len(change) - 1) / CHANGE_MEMORY_TIME)
        size = np.linalg.norm(change, axis=1)
        lasting = list(itertools.accumulate(size, lambda before, now: max(now, forgotten * before)))
        wrong = H @ ornstein_uhlenbeck(self.times, np.array(lasting), ERROR_CORRELATION_TIME) @ H.T
        return np.hstack([H, H @ change]), lambda share: noise + share**2 * wrong, is_seen


@dataclasses.dataclass(frozen=True, eq=False)
class Repetition:
    """The readings and the duty of a repetition of a plan, of F bends and W wires.

    - ``reference_distance``, ``mean_error``: means of |φ_ref - φ| and of |φ* - φ| as it was
      read, rad; until it ended.
    - ``estimated_distance``: estimate of the mean of |φ_ref - φ| without the sensor's noise and
      drift, from the model and all repetitions so far, rad; until it ended.
    - ``interrupted``: why it ended before its time; empty if it did not.
    - ``remark``: the consequence, if it was interrupted or undone; else empty.
    - ``correction``: change of the plan's duty, at the M + 1 nodes of `DutyCorrection` (M + 1, W).
    - ``duty``: duty of the wires, in the model's L steps (L, W).
    - ``start``: readings at the start (W,), °C.
    - ``bend_angle``, ``measured_temperature``: readings around the nodes (M + 1, F), rad,
      and (M + 1, W), °C; NaN where there are none.
    """

    reference_distance: float
    mean_error: float
    estimated_distance: float
    interrupted: str
    remark: str
    correction: np.ndarray
    duty: np.ndarray
    start: np.ndarray
    bend_angle: np.ndarray
    measured_temperature: np.ndarray

    @property
    def failed(self) -> bool:
        """True if it was interrupted or undone."""
        return bool(self.remark)


@dataclasses.dataclass(frozen=True, eq=False)
class _Belief:
    """The estimates of the model's errors for the duty of a repetition.

    - ``bend``: `Estimate` of each bend (F).
    - ``errors``: the same errors for `DutyCorrection`, with the errors of the heat.
    - ``error``: mean distance of the bend from the reference, rad, without noise and drift.
    """

    bend: list[Estimate]
    errors: Residuals
    error: float


class Learner:
    """Learns from repetitions of a plan the duty that brings a limb nearest to its reference.

    Use::

        learner = Learner(trajectory)
        while not learner.finished:
            limb = ...  # rested, where the plan starts
            recording = replay(learner.trajectory, limb, controller=learner.source())
            learner.update(recording)
        learner.save("learning.txt")

    It uses readings and duty alone, of any `Recording` of the plan: also of one with another
    controller, such as a feedback for which ``duty_trajectory()`` is the feed-forward.

    - ``trajectory``: the plan.
    - ``repetitions``: all `Repetition` so far.
    - ``correction``: change of the plan's duty in the next repetition (M + 1, W), at
      ``nodes`` (M + 1,), s since the start of the plan.
    - ``provenance``: version and time of the learner.
    """

    def __init__(self, trajectory: Trajectory):
        """
        Args:
            trajectory: the plan.

        Raises:
            LimbError: if the plan failed its check.
        """
        if not trajectory.check.is_missing and (failure := trajectory.check.failure()):
            raise LimbError(f"This trajectory failed its check and is not learned: {failure}")
        self.trajectory = trajectory
        self.provenance: Provenance | None = Provenance.now(trajectory.parameters)
        self.repetitions: list[Repetition] = []
        self._program = DutyCorrection(trajectory)
        self.nodes = self._program.nodes
        self.correction = self._program.none
        self._start = self._program.start()
        self._belief: _Belief
        self._reset_estimates()

    def duty_trajectory(self) -> PiecewisePolynomial:
        """Return the duty of the next repetition (W), since its start, linear between breaks."""
        return self._program.duty_trajectory(self.correction)

    def source(self) -> Diagram:
        """Return a system whose output ``duty`` (W) drives the next repetition, for `replay`."""
        builder = DiagramBuilder()
        source = builder.AddSystem(TrajectorySource(self.duty_trajectory()))
        builder.ExportOutput(source.get_output_port(), "duty")
        return builder.Build()

    def learned_trajectory(self) -> Trajectory:
        """Return the plan with the duty of the best repetition, and the motion under it.

        Feedback that holds the limb to it is `PlanFeedback(learner.learned_trajectory())`. The
        learner learns from the feedback's duty, too, as recordings have the applied duty.
        """
        errors = self._belief.errors
        return self._program.corrected_plan(errors.about, self._start, errors)

    def expected_bend_angle(self) -> np.ndarray:
        """Return the φ that is expected of the next repetition, at ``nodes`` (M + 1, F), rad.

        It is the reference where the limb can follow it, and else the nearest bend within the
        bounds. A feedback should hold the limb to it.
        """
        return self._program.expected_bend(self.correction, self._start, self._belief.errors)

    @property
    def expected_error(self) -> float:
        """The mean distance from the reference, rad, that is expected of the next repetition."""
        return self._program.distance(self.expected_bend_angle())

    @property
    def finished(self) -> str:
        """The reason, in a sentence, why another repetition does not pay; empty if it does."""
        # Repetitions fail.
        last = self.repetitions[-MAX_INTERRUPTED:]
        if len(last) == MAX_INTERRUPTED and all(repetition.interrupted for repetition in last):
            return f"The last {MAX_INTERRUPTED} repetitions were interrupted."
        last = self.repetitions[-MAX_FAILURES:]
        if len(last) == MAX_FAILURES and all(repetition.failed for repetition in last):
            return f"The last {MAX_FAILURES} repetitions were interrupted or not better."
        if self.best is None:
            return ""
        # The bend would not change.
        errors = self._belief.errors
        best_bend = self._program.expected_bend(errors.about, self._start, errors)
        min_change = MIN_CHANGE_SHARE * self._sensor_error
        if np.abs(self.expected_bend_angle() - best_bend).mean() > min_change:
            return ""
        sentence = (
            "Another repetition would change the bend by less than "
            f"{np.rad2deg(min_change):.2g}°, as the sensor has noise and drift."
        )
        if self.expected_error > self._sensor_error / 4:
            distance_deg = np.rad2deg(self.expected_error)
            sentence += f" The bounds of duty and temperature leave {distance_deg:.2f}°."
        return sentence

    @property
    def best(self) -> int | None:
        """The index of the best repetition; None before there is one."""
        kept = [index for index, each in enumerate(self.repetitions) if not each.failed]
        return kept[-1] if kept else None

    def update(self, recording: Recording) -> Repetition:
        """Learn from a repetition that was driven by ``source()``, or from its beginning.

        A repetition is undone if it was interrupted, or if it was read to be farther from the
        reference than an earlier one by more than the sensor's errors explain. The next repetition
        then begins with the duty of the best one again. Its step is half as long, if the bend was
        to change by more than by chance.

        Raises:
            LimbError: if the recording is of a limb of another shape, or has no
                plausible samples during the plan; nothing is learned then.
        """
        repetition = self._repetition_from(recording)
        best = self.best
        self._append(repetition)
        # Learn the shares from the change of the bend since the best repetition.
        if best is not None and not repetition.interrupted:
            about = self.repetitions[best].duty
            changes = self._program.bend_changes(self._start, about, repetition.duty)
            for bend, regression in enumerate(self._bend_regressions):
                before = self._belief.bend[bend]
                residual = self._residuals[-1][0][:, bend]
                evidence = regression.likelihoods(before, residual, changes[:, bend])
                decayed = EVIDENCE_DECAY * self._evidence[bend]
                self._evidence[bend] = decayed + evidence - evidence.max()
        # Keep the repetition, or go back to the best one.
        remark = ""
        back = "back to the best repetition"
        best_belief = None if best is None else self._belief_about(best)
        belief = self._belief_about(len(self.repetitions) - 1)
        if repetition.interrupted:
            remark = f"interrupted; {back if best_belief else 'its readings were learned'}"
        elif best_belief and belief.error > best_belief.error + self._error_tolerance:
            remark = f"farther from the reference than the sensor's errors explain; {back}"
        self._belief = best_belief if remark and best_belief else belief
        repetition = dataclasses.replace(repetition, remark=remark, estimated_distance=belief.error)
        self.repetitions[-1] = repetition
        # Improve the correction, with a shorter step after repetitions that were undone.
        errors = self._belief.errors
        if best is not None and repetition.interrupted:
            self.correction = errors.about
            return repetition
        highest = self.trajectory.parameters.temperature_limits.measured_maximum - READING_MARGIN
        interrupted = [each for each in self.repetitions if each.interrupted]
        num_hot = sum(np.nanmax(each.measured_temperature) > highest for each in interrupted)
        margin = OVERHEATING_MARGIN * num_hot
        improved = self._program.improve(errors.about, self._start, errors, margin)
        step_size = max(MIN_STEP_SIZE, 0.5 ** self._num_undone())
        self.correction = errors.about + step_size * (improved - errors.about)
        return repetition

    def _num_undone(self) -> int:
        """Count the repetitions since the best one whose duty is not nearly equal to it."""
        if self.best is None:
            return 0
        about, *undone = self.repetitions[self.best :]
        count = 0
        for repetition in undone:
            changes = self._program.bend_changes(self._start, about.duty, repetition.duty)
            mean_change = np.abs(changes.sum(axis=-1)).mean()
            count += mean_change > IDENTICAL_SHARE * self._sensor_error
        return count

    def _repetition_from(self, recording: Recording) -> Repetition:
        """Return the repetition of a recording."""
        # Refuse recordings of limbs of another shape.
        limbs = self.trajectory.parameters, recording.parameters
        layouts = [LimbModel.of(limb).layout for limb in limbs]
        planned, recorded = ((layout.num_bends, layout.num_wires) for layout in layouts)
        if planned != recorded:
            raise LimbError(
                f"The recording is of {recorded[0]} bends and {recorded[1]} wires, but the "
                f"plan of {planned[0]} and {planned[1]}; give a recording of this plan."
            )
        # Find out whether it ended before its time.
        spacing = self.nodes[1] - self.nodes[0]
        interrupted = recording.interrupted
        if not interrupted and recording.time[-1] < self.nodes[-1] - spacing:
            interrupted = f"the recording ends at {recording.time[-1]:g} s"
        # Reduce duty to the steps of the model, and usable readings to the nodes.
        program = self._program
        duty = [np.interp(program.middles, recording.time, row) for row in recording.heating_duty]
        applied = np.array(duty).T
        usable = recording.usable
        time = recording.time[usable]
        bend = recording.bend_angle[:, usable]
        readings = recording.measured_temperature[:, usable]
        distances = reference_distances(self.trajectory, [recording])
        assert distances.measured is not None  # of recordings
        return Repetition(
            reference_distance=distances.measured,
            mean_error=tracking_errors(self.trajectory, [recording]).mean,
            estimated_distance=np.nan,  # until it is learned
            interrupted=interrupted,
            remark="",
            correction=program.correction_of(applied, self.correction),
            duty=applied,
            start=readings[:, :3].mean(axis=1),
            bend_angle=_node_means(self.nodes, spacing, time, bend),
            measured_temperature=_node_means(self.nodes, spacing, time, readings),
        )

    def _reset_estimates(self) -> None:
        """Set the estimates before the first repetition."""
        parameters = self.trajectory.parameters
        nodes = self.nodes
        program = self._program
        # Errors of the model, as far as its calibration knows them, and of the bend sensors.
        record = parameters.calibration
        bend_error = UNKNOWN_BEND
        heat_error = UNKNOWN_TEMPERATURE
        if record is not None and record.bend_error > 0:
            bend_error = MEAN_TO_DEVIATION * record.bend_error
            heat_error = MEAN_TO_DEVIATION * record.temperature_error
        sensors = [parameters.segments[s].bend_sensor for s in program.layout.bend_segment]
        self._sensor_error = max(np.hypot(sensor.noise, sensor.drift) for sensor in sensors)
        # The difference of two mean distances that is not by chance.
        difference = DEVIATION_TO_MEAN * np.sqrt(2) * self._sensor_error
        self._error_tolerance = WORSE_DEVIATIONS * difference

        # The torque's error is about in proportion to the heat, which no wire has at first.
        heat = program.rollout(self._start, program.steps(self.correction))
        ambient = parameters.ambient_temperature
        range_ = parameters.temperature_limits.maximum - ambient
        share = np.clip((program.model.temperatures(heat) - ambient) / range_, 0.0, 1.0)
        deviation = bend_error * share.max(axis=1)
        covariance = ornstein_uhlenbeck(nodes, deviation, ERROR_CORRELATION_TIME)
        covariance += ornstein_uhlenbeck(nodes, REST_ERROR, 60.0)
        one = np.eye(len(nodes))
        self._bend_regressions = []
        for sensor in sensors:
            noise = (MEAN_VARIANCE_SHARE * sensor.noise**2 + MIN_VARIANCE) * one
            noise += ornstein_uhlenbeck(nodes, np.hypot(sensor.drift, REST_CHANGE), DRIFT_TIME)
            self._bend_regressions.append(RepeatingError(nodes, covariance, one, noise))
        self._lag = program.lag()
        self._heat_regressions = []
        for wire, lag in enumerate(self._lag):
            deviation = heat_error * np.maximum(share[:, wire], 0.1)
            covariance = ornstein_uhlenbeck(nodes, deviation, ERROR_CORRELATION_TIME)
            changed = ornstein_uhlenbeck(nodes, TEMPERATURE_CHANGE, DRIFT_TIME)
            noise = READING_NOISE**2 * one + lag @ changed @ lag.T
            self._heat_regressions.append(RepeatingError(nodes, covariance, lag, noise))

        # Changes of the bend are expected to be as wrong as the calibration's predictions, or more.
        bend = np.sqrt(np.mean(program.reference**2)) + MIN_VARIANCE
        expected = np.clip(bend_error / bend, EXPECTED_SHARE, SHARES[-1])
        unlikely = np.log(SHARES / expected) / np.log(SHARE_FACTOR)
        self._evidence = np.tile(-0.5 * unlikely**2, (len(sensors), 1))
        self._residuals: list[tuple[np.ndarray, ...]] = []
        errors = Residuals(
            np.zeros_like(program.reference),
            program.none,
            program.none,
            self.correction,
            np.ones((len(sensors), len(parameters.wires))),
            self._wrong_shares(),
        )
        self._belief = _Belief([], errors, 0.0)

    def _wrong_shares(self) -> np.ndarray:
        """Return the random error of changes of each bend, relative to them (F,)."""
        weights = np.exp(self._evidence - self._evidence.max(axis=1, keepdims=True))
        return np.sqrt(weights @ SHARES**2 / weights.sum(axis=1))

    def _append(self, repetition: Repetition) -> None:
        """Append a repetition, and its residuals of the model."""
        program = self._program
        self._start = program.start(repetition.start)
        heat = program.rollout(self._start, repetition.duty)
        bend = program.model.bend_angle(heat)
        readings = repetition.measured_temperature - program.model.readings(heat)
        self.repetitions.append(repetition)
        temperatures = program.model.temperatures(heat)
        self._residuals.append((repetition.bend_angle - bend, readings, temperatures))

    def _belief_about(self, index: int) -> _Belief:
        """Return the belief about the duty of a repetition, from all repetitions."""
        program = self._program
        about = self.repetitions[index]
        residuals, readings, temperatures = map(np.array, zip(*self._residuals, strict=True))
        # Estimate the errors of the bends, by the model's changes since this duty.
        duty = np.stack([repetition.duty for repetition in self.repetitions], axis=1)
        changes = np.moveaxis(program.bend_changes(self._start, about.duty, duty), 1, 0)
        shares = self._wrong_shares()
        bend = []
        for number, regression in enumerate(self._bend_regressions):
            observed = residuals[..., number]
            bend.append(regression.estimate(observed, changes[:, :, number], shares[number]))
        # Estimate the errors of the wires' heat likewise.
        warmer = temperatures - temperatures[index]
        heat = []
        for wire, regression in enumerate(self._heat_regressions):
            change = warmer[..., wire : wire + 1]
            estimate = regression.estimate(readings[..., wire], change, TEMPERATURE_SHARE)
            heat.append(estimate.error)
        errors = Residuals(
            bend_angle=np.array([part.error for part in bend]).T,
            wire_temperature=np.array(heat).T,
            measured_temperature=np.einsum("wij,wj->iw", self._lag, heat),
            about=about.correction,
            gains=np.array([part.gains for part in bend]),
            doubt=shares,
        )
        # Remove drift, which is a line in the unexpected readings, and noise, which is not smooth.
        unexpected = residuals[index] - errors.bend_angle
        bend_angle = about.bend_angle - unexpected
        seen = np.isfinite(unexpected).all(axis=1)
        from scipy.signal import detrend  # takes seconds to import

        detrended = detrend(unexpected[seen], axis=0)
        bend_angle[seen] += uniform_filter1d(detrended, SMOOTHING_NODES, axis=0)
        return _Belief(bend, errors, program.distance(bend_angle))

    def save(self, path: str | Path) -> None:
        """Save plan and repetitions, whole or not at all; `load` goes on from there."""
        state = {
            "plan": self.trajectory.to_text(),
            "repetitions": [vars(repetition) for repetition in self.repetitions],
            "correction": self.correction,
            "evidence": self._evidence,
            "provenance": self.provenance and dataclasses.asdict(self.provenance),
        }
        body = json.dumps(state, default=np.ndarray.tolist) + "\n"
        write_atomically(path, _FIRST_LINE + _digest(body) + "\n" + body)

    @classmethod
    def load(cls, path: str | Path) -> "Learner":
        """Return the learner that `save` wrote.

        Raises:
            FileFormatError: one sentence with the fault.
        """
        # Check the first line.
        data = read_bytes(path, "learning", LARGEST_TABLE, FileFormatError)
        first, _, body = data.decode("utf-8", errors="replace").partition("\n")
        actual = first_line(first)
        if actual and actual.kind == "learning" and actual.format != FORMAT_VERSION:
            raise FileFormatError(
                f"{path}: this file of a learner has format {actual.format}, but this program "
                f"reads format {FORMAT_VERSION}; learn the plan again in another folder."
            )
        if not first.startswith(_FIRST_LINE):
            raise FileFormatError(
                f"{path}: this is no file of a learner: its first line is not '{_FIRST_LINE}...'."
            )
        if first != _FIRST_LINE + _digest(body):
            raise FileFormatError(
                f"{path}: the content does not match the checksum in the first line; the file is "
                "truncated or was changed after it was written."
            )
        # Make the learner of the plan, and give it the repetitions.
        state = json.loads(body)
        with reraise_as(FileFormatError, f"{path}: "):  # such as a law whose module is not imported
            learner = cls(Trajectory.from_text(state["plan"]))
        for saved in state["repetitions"]:
            for name, item in saved.items():
                saved[name] = np.array(item) if isinstance(item, list) else item
            learner._append(Repetition(**saved))
        learner.provenance = Provenance.from_json(state["provenance"])
        learner.correction = np.array(state["correction"])
        learner._evidence = np.array(state["evidence"])
        if learner.repetitions:
            learner._belief = learner._belief_about(-1 if learner.best is None else learner.best)
        return learner


def _node_means(
    nodes: np.ndarray, spacing: float, times: np.ndarray, signals: np.ndarray
) -> np.ndarray:
    """Return means of signals (R, K) around the nodes (M + 1, R); NaN where none are."""
    # Samples lie symmetrically about a node, so that the first and the last node have only one.
    to_end = np.minimum(nodes - nodes[0], nodes[-1] - nodes)
    half_width = np.minimum(0.5 * spacing, to_end) + 1e-6
    low = np.searchsorted(times, nodes - half_width)
    high = np.searchsorted(times, nodes + half_width)
    sums = np.cumsum(np.pad(signals, ((0, 0), (1, 0))), axis=1)
    counts = np.where(high > low, high - low, np.nan)
    return ((sums[:, high] - sums[:, low]) / counts).T


def _digest(body: str) -> str:
    return hashlib.sha256(body.encode()).hexdigest()
