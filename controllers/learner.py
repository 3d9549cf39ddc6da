"""Learning over repetitions: the duty that brings a limb to the reference of its plan.

A plan is repeated. Errors of the model come again in each repetition, the sensor's
noise and drift do not. `RepeatingError` tells them apart, and `DutyCorrection` finds
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
from scipy.signal import detrend

from controllers.duty_correction import READING_MARGIN, DutyCorrection, Errors
from controllers.estimator import DRIFT_TIME
from limb_systems import LimbError, LimbModel, Provenance, Recording, Trajectory
from limb_systems.errors import reraise_as
from limb_systems.files.csv_format import FileFormatError
from limb_systems.files.input import LARGEST_TABLE, FirstLine, read_bytes
from limb_systems.files.output import write_atomically
from limb_systems.plan_band import MEAN_TO_DEVIATION
from limb_systems.tracking import reference_distances, tracking_errors

READING_NOISE = 0.3  # °C, of a mean of some readings of a thermocouple
MEANS = 0.25  # of a sample's variance, left in the mean of those around a node
ROUNDING = 1e-10  # rad², so that sensors without noise leave no singular matrix
SMOOTH = 2.0  # s, in which the correlation of the model's errors falls to 1/e
REMEMBERED = 10.0  # s, in which limbs forget a change of what they did
REST_ERROR = np.deg2rad(1.0)  # of the model's bend with cold wires
UNKNOWN_BEND, UNKNOWN_TEMPERATURE = np.deg2rad(5.0), 10.0  # errors of uncalibrated models
CHANGED_REST = np.deg2rad(0.1)  # by which a limb changes between repetitions
CHANGED_TEMPERATURE = 0.3  # °C, likewise
# Shares of a change of the model that may be wrong; the one of temperatures; the least that is
# expected of changes of the bend, and by what factor it is known, before anything was seen.
SHARES = np.geomspace(0.1, 1.6, 9)
TEMPERATURE_SHARE, EXPECTED_SHARE, KNOWN_TO = 0.15, 0.3, 2.0
LATELY = 0.8  # of what a repetition has shown of that share, in what is known after another one
GAIN, LEAST_GAIN, LARGEST_GAIN = 0.5, 0.4, 2.5  # of the limb over the model: deviation, bounds
SPREAD = 0.6  # of the mean of |x| over the standard deviation of x, if x is normal
NODES_OF_NOISE = 5  # over which the mean of readings has little of it
WORSE = 0.1  # standard deviations, by which a repetition that is kept may seem to be worse
ALIKE = 0.25  # of the sensor's error; duties that change the bend by less are nearly identical
COOLER = 3.0  # °C, by which bounds are lowered after a wire was read too hot
WORTH = 0.05  # of the sensor's error; by what another repetition must change the bend at least
MOST_INTERRUPTED, MOST_FAILURES = 3, 5  # in a row; the latter with those that were not better
SHORTEST = 0.25  # of a step, after repetitions that were not better
_FIRST_LINE = f"{FirstLine('learning', 6)}, sha256 "


def wandering(times: np.ndarray, deviation: ArrayLike, duration: float) -> np.ndarray:
    """Covariance (M, M) at times (M,) of a signal that wanders, an Ornstein-Uhlenbeck process.

    Args:
        deviation: standard deviation, one for all times or for each (M,).
        duration: time in which the correlation falls to 1/e, s.
    """
    deviation = np.broadcast_to(deviation, times.shape)
    apart = np.abs(np.subtract.outer(times, times))
    return np.outer(deviation, deviation) * np.exp(-apart / duration)


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


class RepeatingError:
    """Bayesian regression for an error d (M,) over time that nearly repeats.

    Repetition j shows H (d + Σ (g_w - 1) ψ_w + δ) + noise. ψ_w (M,) is the change of the model's
    bend when wire w has its duty of repetition j instead of the duty about which d is estimated.
    The limb responds g_w times as strongly as the model. δ is random, a share of the ψ_w.

    Args:
        times: (M,), s.
        covariance: covariance of d before the first repetition (M, M).
        shows: H (M, M).
        noise: covariance of the noise (M, M).
        changed: standard deviation of δ without any change of duty.
    """

    def __init__(
        self,
        times: np.ndarray,
        covariance: np.ndarray,
        shows: np.ndarray,
        noise: np.ndarray,
        changed: float,
    ):
        self._times, self._covariance, self._shows = times, covariance, shows
        self._noise = noise + shows @ wandering(times, changed, DRIFT_TIME) @ shows.T

    def estimate(self, shown: np.ndarray, changes: np.ndarray, share: float) -> Estimate:
        """The error and the gains that J repetitions have shown.

        Args:
            shown: (J, M), NaN where there was nothing to see.
            changes: ψ (J, M, W).
            share: share of them that is wrong at random.
        """
        M, W = changes.shape[1:]
        information = block_diag(np.linalg.inv(self._covariance), np.eye(W) / GAIN**2)
        known = np.zeros(M + W)
        for values, change in zip(shown, changes, strict=True):
            H, spread, seen = self._observation(values, change)
            weighted = np.linalg.solve(spread(share), H).T
            information += weighted @ H
            known += weighted @ values[seen]
        covariance = np.linalg.inv(information)
        mean = covariance @ known
        gains = np.clip(1 + mean[M:], LEAST_GAIN, LARGEST_GAIN)
        return Estimate(mean[:M], gains, covariance)

    def likelihoods(self, before: Estimate, shown: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Logarithms of how likely a repetition was before it was seen, for each of `SHARES`."""
        H, spread, seen = self._observation(shown, change)
        surprise = shown[seen] - H @ np.append(before.error, before.gains - 1)
        known, found = H @ before.covariance @ H.T, []
        for share in SHARES:
            factor = np.linalg.cholesky(known + spread(share))
            white = np.linalg.solve(factor, surprise)
            found.append(-np.log(np.diag(factor)).sum() - 0.5 * white @ white)
        return np.array(found)

    def _observation(self, shown: np.ndarray, change: np.ndarray):
        """What a repetition shows of d and g, the covariance beside it by the share, and where."""
        seen = np.isfinite(shown)
        H, noise = self._shows[seen], self._noise[np.ix_(seen, seen)]
        forgotten = np.exp(-self._times[-1] / max(1, len(change) - 1) / REMEMBERED)
        size = np.linalg.norm(change, axis=1)
        lasting = list(itertools.accumulate(size, lambda before, now: max(now, forgotten * before)))
        wrong = H @ wandering(self._times, np.array(lasting), SMOOTH) @ H.T
        return np.hstack([H, H @ change]), lambda share: noise + share**2 * wrong, seen


@dataclasses.dataclass(frozen=True, eq=False)
class Repetition:
    """What a repetition of a plan has shown, of F bends and W wires.

    - ``reference_distance``, ``mean_error``: means of |φ_ref - φ| and of |φ* - φ| as it was
      read, rad; as far as it came.
    - ``interrupted``: why it ended before its time; empty if it did not.
    - ``remark``: what was done about it, if it was interrupted or undone; else empty.
    - ``correction``: change of the plan's duty, at the M + 1 nodes of `DutyCorrection`
      (M + 1, W).
    - ``duty``: duty that the wires got, in the model's L steps (L, W).
    - ``start``: readings at the start (W,), °C.
    - ``bend_angle``, ``measured_temperature``: readings around the nodes (M + 1, F), rad,
      and (M + 1, W), °C; NaN where there are none.
    """

    reference_distance: float
    mean_error: float
    interrupted: str
    remark: str
    correction: np.ndarray
    duty: np.ndarray
    start: np.ndarray
    bend_angle: np.ndarray
    measured_temperature: np.ndarray

    @property
    def failed(self) -> bool:
        """Whether it was interrupted or undone."""
        return bool(self.remark)


@dataclasses.dataclass(frozen=True, eq=False)
class _Belief:
    """What is known about the duty of a repetition.

    - ``bend``: `Estimate` of each bend (F).
    - ``errors``: the same for `DutyCorrection`.
    """

    bend: list[Estimate]
    errors: Errors
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

    It sees readings and duty only, of any `Recording` of the plan: with another
    controller as well, such as a feedback for which ``duty_trajectory()`` is what is
    fed forward.

    - ``trajectory``: the plan.
    - ``repetitions``: all `Repetition` so far.
    - ``correction``: change of the plan's duty in the next repetition (M + 1, W), at
      ``nodes`` (M + 1,), s since the start of the plan.
    - ``provenance``: what made the learner.
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
        self.nodes, self.correction = self._program.nodes, self._program.none
        self._start = self._program.start()
        self._belief: _Belief
        self._estimate_afresh()

    def duty_trajectory(self) -> PiecewisePolynomial:
        """Duty of the next repetition (W), since its start, linear between its breaks."""
        return self._program.duty_trajectory(self.correction)

    def source(self) -> Diagram:
        """A system whose output ``duty`` (W) is that of the next repetition, for `replay`."""
        builder = DiagramBuilder()
        source = builder.AddSystem(TrajectorySource(self.duty_trajectory()))
        builder.ExportOutput(source.get_output_port(), "duty")
        return builder.Build()

    def learned_trajectory(self) -> Trajectory:
        """The plan with the duty of the best repetition, and what the limb does under it.

        Feedback that holds the limb to it is `PlanFeedback(learner.learned_trajectory())`:
        what it adds to the duty is learned, too, as recordings have the duty that was applied.
        """
        errors = self._belief.errors
        return self._program.corrected(errors.about, self._start, errors)

    def expected_bend_angle(self) -> np.ndarray:
        """φ that is expected of the next repetition, at ``nodes`` (M + 1, F), rad.

        It is the reference where the limb can follow it, and else what it can do
        within the bounds: what a feedback should hold it to.
        """
        return self._program.expected_bend(self.correction, self._start, self._belief.errors)

    @property
    def expected_error(self) -> float:
        """Mean distance of the bend from the reference that is expected of the next repetition."""
        return self._program.distance(self.expected_bend_angle())

    @property
    def finished(self) -> str:
        """Why another repetition does not pay, in a sentence; empty if it does."""
        for most, what, has_failed in (
            (MOST_INTERRUPTED, "interrupted", lambda repetition: repetition.interrupted),
            (MOST_FAILURES, "interrupted or not better", lambda repetition: repetition.failed),
        ):
            if len(self.repetitions) >= most and all(map(has_failed, self.repetitions[-most:])):
                return f"The last {most} repetitions were {what}."
        if self.best is None:
            return ""
        before = self._program.expected_bend(
            self._belief.errors.about, self._start, self._belief.errors
        )
        worth = WORTH * self._sensor_error
        if np.abs(self.expected_bend_angle() - before).mean() > worth:
            return ""
        rest = self.expected_error
        left = (
            f" The bounds of duty and temperature leave {np.rad2deg(rest):.2f}°."
            if rest > self._sensor_error / 4
            else ""
        )
        return (
            f"Another repetition would change the bend by less than {np.rad2deg(worth):.2g}°, as "
            f"the sensor has noise and drift.{left}"
        )

    @property
    def best(self) -> int | None:
        """The index of the best repetition; None before there is one."""
        kept = [n for n, repetition in enumerate(self.repetitions) if not repetition.failed]
        return kept[-1] if kept else None

    def update(self, recording: Recording) -> Repetition:
        """Learn from a repetition that was driven by ``source()``, or from its beginning.

        A repetition that was interrupted, or that was read to be farther from the reference than
        one before by more than the sensor's errors explain, is undone: the next one begins with
        the best one's duty again. Its step is half as long, if the bend was to change by more than
        by chance.

        Raises:
            LimbError: if the recording is of a limb of another shape, or has no
                plausible samples during the plan; nothing is learned then.
        """
        repetition = self._seen(recording)
        number, best = len(self.repetitions), self.best
        self._learn(repetition)
        if best is not None and not repetition.interrupted:
            # The shares, by how the bend has changed from the best repetition.
            about = self.repetitions[best].duty
            changes = self._program.changes(self._start, about, repetition.duty)
            for bend, part in enumerate(self._bend):
                before, shown = self._belief.bend[bend], self._shown[-1][0][:, bend]
                found = part.likelihoods(before, shown, changes[:, bend])
                self._evidence[bend] = LATELY * self._evidence[bend] + found - found.max()
        remark, back = "", "back to the best repetition"
        kept = None if best is None else self._about(best)
        belief = self._about(number)
        if repetition.interrupted:
            remark = f"interrupted; {back if kept else 'its readings were learned'}"
        elif kept and belief.error > kept.error + self._by_chance:
            remark = f"farther from the reference than the sensor's errors explain; {back}"
        self._belief = kept if remark and kept else belief
        self.repetitions[-1] = repetition = dataclasses.replace(repetition, remark=remark)
        errors = self._belief.errors
        if best is not None and repetition.interrupted:
            self.correction = errors.about
            return repetition
        found = self._program.improve(errors.about, self._start, errors, self._cooler())
        step = max(SHORTEST, 0.5 ** self._undone())
        self.correction = errors.about + step * (found - errors.about)
        return repetition

    def _undone(self) -> int:
        """Number of repetitions since the best one, without those of a nearly identical duty."""
        if self.best is None:
            return 0
        about, later = self.repetitions[self.best].duty, self.repetitions[self.best + 1 :]
        moved = [
            np.abs(self._program.changes(self._start, about, other.duty).sum(axis=-1)).mean()
            for other in later
        ]
        return sum(change > ALIKE * self._sensor_error for change in moved)

    def _seen(self, recording: Recording) -> Repetition:
        """Return what a recording says about a repetition."""
        limbs = self.trajectory.parameters, recording.parameters
        layouts = [LimbModel.of(limb).layout for limb in limbs]
        planned, recorded = ((layout.num_bends, layout.num_wires) for layout in layouts)
        if planned != recorded:
            raise LimbError(
                f"The recording is of {recorded[0]} bends and {recorded[1]} wires, but the "
                f"plan of {planned[0]} and {planned[1]}; give a recording of this plan."
            )
        program = self._program
        spacing = self.nodes[1] - self.nodes[0]
        interrupted = recording.interrupted
        if not interrupted and recording.time[-1] < self.nodes[-1] - spacing:
            interrupted = f"the recording ends at {recording.time[-1]:g} s"
        duty = recording.heating_duty
        seen = recording.usable
        time = recording.time[seen]
        bend, readings = (
            _around(self.nodes, spacing, time, signals[:, seen])
            for signals in (recording.bend_angle, recording.measured_temperature)
        )
        applied = np.array([np.interp(program.middles, recording.time, row) for row in duty]).T
        distances = reference_distances(self.trajectory, [recording])
        assert distances.measured is not None  # of recordings
        return Repetition(
            reference_distance=distances.measured,
            mean_error=tracking_errors(self.trajectory, [recording]).mean,
            interrupted=interrupted,
            remark="",
            correction=program.correction_of(applied, self.correction),
            duty=applied,
            start=recording.measured_temperature[:, seen][:, :3].mean(axis=1),
            bend_angle=bend,
            measured_temperature=readings,
        )

    def _estimate_afresh(self) -> None:
        """Set the estimates before the first repetition."""
        parameters, nodes, program = self.trajectory.parameters, self.nodes, self._program
        record, limits = parameters.calibration, parameters.temperature_limits
        of_bend, of_heat = UNKNOWN_BEND, UNKNOWN_TEMPERATURE
        if record is not None and record.bend_error > 0:
            of_bend = MEAN_TO_DEVIATION * record.bend_error
            of_heat = MEAN_TO_DEVIATION * record.temperature_error
        sensors = [parameters.segments[s].bend_sensor for s in program.layout.bend_segment]
        self._sensor_error = max(np.hypot(sensor.noise, sensor.drift) for sensor in sensors)
        self._by_chance = WORSE * SPREAD * np.sqrt(2) * self._sensor_error  # a difference of two
        # The torque's error is about in proportion to the heat, which no wire has at first.
        heat = program.model.temperatures(
            program.rollout(self._start, program.steps(self.correction))
        )
        ambient = parameters.ambient_temperature
        share = np.clip((heat - ambient) / (limits.maximum - ambient), 0.0, 1.0)
        bend_error = wandering(nodes, of_bend * share.max(axis=1), SMOOTH)
        bend_error += wandering(nodes, REST_ERROR, 60.0)
        one = np.eye(len(nodes))
        self._bend = [
            RepeatingError(
                nodes,
                bend_error,
                one,
                (MEANS * sensor.noise**2 + ROUNDING) * one
                + wandering(nodes, sensor.drift, DRIFT_TIME),
                CHANGED_REST,
            )
            for sensor in sensors
        ]
        self._lag = program.lag()
        self._heat = [
            RepeatingError(
                nodes,
                wandering(nodes, of_heat * np.maximum(share[:, wire], 0.1), SMOOTH),
                lag,
                READING_NOISE**2 * one,
                CHANGED_TEMPERATURE,
            )
            for wire, lag in enumerate(self._lag)
        ]
        # What the calibration's predictions missed of the bend is expected of changes at least.
        bend = np.sqrt(np.mean(program.reference**2)) + ROUNDING
        expected = np.clip(of_bend / bend, EXPECTED_SHARE, SHARES[-1])
        unlikely = np.log(SHARES / expected) / np.log(KNOWN_TO)
        self._evidence = np.tile(-0.5 * unlikely**2, (len(sensors), 1))
        self._shown: list[tuple[np.ndarray, ...]] = []
        errors = Errors(
            np.zeros_like(program.reference),
            program.none,
            program.none,
            self.correction,
            np.ones((len(sensors), len(parameters.wires))),
            self._shares(),
        )
        self._belief = _Belief([], errors, 0.0)

    def _shares(self) -> np.ndarray:
        """Share of a change of each bend which is wrong at random (F,)."""
        weights = np.exp(self._evidence - self._evidence.max(axis=1, keepdims=True))
        return np.sqrt(weights @ SHARES**2 / weights.sum(axis=1))

    def _learn(self, repetition: Repetition) -> None:
        """Append a repetition, and its residuals of the model."""
        program = self._program
        self._start = program.start(repetition.start)
        heat = program.rollout(self._start, repetition.duty)
        bend = program.model.bend_angle(heat)
        readings = repetition.measured_temperature - program.model.readings(heat)
        self.repetitions.append(repetition)
        temperatures = program.model.temperatures(heat)
        self._shown.append((repetition.bend_angle - bend, readings, temperatures))

    def _about(self, index: int) -> "_Belief":
        """Return what all repetitions have shown about the duty of one of them."""
        program, about = self._program, self.repetitions[index]
        duty = np.stack([other.duty for other in self.repetitions], axis=1)
        changes = np.moveaxis(program.changes(self._start, about.duty, duty), 1, 0)
        shown, readings, temperatures = (np.array(part) for part in zip(*self._shown, strict=True))
        bend = [
            part.estimate(shown[..., f], changes[:, :, f], share)
            for f, (part, share) in enumerate(zip(self._bend, self._shares(), strict=True))
        ]
        warmer = temperatures - temperatures[index]
        heat = []
        for part, seen, change in zip(
            self._heat, np.moveaxis(readings, -1, 0), np.moveaxis(warmer, -1, 0), strict=True
        ):
            heat.append(part.estimate(seen, change[..., np.newaxis], TEMPERATURE_SHARE).error)
        errors = Errors(
            bend_angle=np.array([part.error for part in bend]).T,
            wire_temperature=np.array(heat).T,
            measured_temperature=np.einsum("wij,wj->iw", self._lag, heat),
            about=about.correction,
            gains=np.array([part.gains for part in bend]),
            doubt=self._shares(),
        )
        # Of what was read to be unlike what is expected, a line is drift, and the rest the limb
        # but for noise.
        unlike = shown[index] - errors.bend_angle
        expected = about.bend_angle - unlike
        seen = np.isfinite(unlike).all(axis=1)
        expected[seen] += uniform_filter1d(detrend(unlike[seen], axis=0), NODES_OF_NOISE, axis=0)
        return _Belief(bend, errors, program.distance(expected))

    def _cooler(self) -> float:
        """Margin of temperature, °C, as interrupted repetitions were read too hot."""
        highest = self.trajectory.parameters.temperature_limits.measured_maximum
        hot = [
            np.nanmax(repetition.measured_temperature) > highest - READING_MARGIN
            for repetition in self.repetitions
            if repetition.interrupted
        ]
        return COOLER * sum(hot)

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
            FileFormatError: one sentence that says what is wrong.
        """
        data = read_bytes(path, "learning", LARGEST_TABLE, FileFormatError)
        first, _, body = data.decode("utf-8", errors="replace").partition("\n")
        if not first.startswith(_FIRST_LINE):
            raise FileFormatError(
                f"{path}: this is not what a learner saved: its first line is not "
                f"'{_FIRST_LINE}...'."
            )
        if first != _FIRST_LINE + _digest(body):
            raise FileFormatError(
                f"{path}: the content does not match the checksum in the first line; the file is "
                "truncated or was changed after it was written."
            )
        state = json.loads(body)
        with reraise_as(FileFormatError, f"{path}: "):  # such as a law whose module is not imported
            learner = cls(Trajectory.from_text(state["plan"]))
        for saved in state["repetitions"]:
            arrays = {name: np.array(v) for name, v in saved.items() if isinstance(v, list)}
            learner._learn(Repetition(**(saved | arrays)))
        learner.provenance = Provenance.from_json(state["provenance"])
        learner.correction = np.array(state["correction"])
        learner._evidence = np.array(state["evidence"])
        if learner.repetitions:
            learner._belief = learner._about(-1 if learner.best is None else learner.best)
        return learner


def _around(
    nodes: np.ndarray, spacing: float, times: np.ndarray, signals: np.ndarray
) -> np.ndarray:
    """Means of signals (R, K) around the nodes (M + 1, R); NaN where there are no samples.

    Samples lie alike on both sides of a node, so that the first and the last have only one.
    """
    reach = np.minimum(0.5 * spacing, np.minimum(nodes - nodes[0], nodes[-1] - nodes)) + 1e-6
    low, high = np.searchsorted(times, nodes - reach), np.searchsorted(times, nodes + reach)
    sums = np.cumsum(np.pad(signals, ((0, 0), (1, 0))), axis=1)
    counts = np.where(high > low, high - low, np.nan)
    return ((sums[:, high] - sums[:, low]) / counts).T


def _digest(body: str) -> str:
    return hashlib.sha256(body.encode()).hexdigest()
