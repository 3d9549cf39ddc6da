"""Learning over repetitions: the duty with which a limb follows its plan.

A plan is repeated. Errors of the model come again in each repetition, the sensor's
noise and drift do not. `RepeatingError` tells them apart, and `DutyCorrection` finds
the duty for a limb with the repeating errors, within all bounds of the plan. This is
norm-optimal iterative learning control, with a gain that falls as repetitions add up.
"""

import copy
import dataclasses
import hashlib
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from controllers.duty_correction import READING_MARGIN, DutyCorrection, Errors
from controllers.estimator import DRIFT_TIME
from limb_systems import LimbError, Provenance, Recording, Trajectory
from limb_systems.band import MEAN_TO_DEVIATION
from limb_systems.files.csv_format import FileFormatError
from limb_systems.input import LARGEST_TABLE, read_bytes
from limb_systems.output import write_atomically
from limb_systems.tracking import reference_distances, tracking_errors

READING_NOISE = 0.3  # °C, of a mean of some readings of a thermocouple
MEANS = 0.25  # of a sample's variance, left in the mean of those around a node
ROUNDING = 1e-10  # rad², so that sensors without noise leave no singular matrix
SMOOTH = 2.0  # s, in which the correlation of the model's errors falls to 1/e
REST_ERROR = np.deg2rad(1.0)  # of the model's bend with cold wires
UNKNOWN_BEND, UNKNOWN_TEMPERATURE = np.deg2rad(5.0), 10.0  # errors of uncalibrated models
CHANGED_SHARE = 0.15  # of a change of bend or temperature, which the model has wrong
CHANGED_REST = np.deg2rad(0.1)  # by which a limb changes between repetitions
CHANGED_TEMPERATURE = 0.3  # °C, likewise
SPREAD = 0.6  # of the mean of |x| over the standard deviation of x, if x is normal
SURELY = 3.0  # standard deviations, by which a repetition must be worse to count as worse
COOLER = 3.0  # °C, by which bounds are lowered after a wire was read too hot
WORTH = 0.01  # of the sensor's error; what another repetition must promise at least
MOST_FAILURES = 3  # in a row
_FIRST_LINE = "# limb learning, format 3, sha256 "


def wandering(times: np.ndarray, deviation: ArrayLike, duration: float) -> np.ndarray:
    """Covariance (M, M) at times (M,) of a signal that wanders, an Ornstein-Uhlenbeck process.

    Args:
        deviation: standard deviation, one for all times or for each (M,).
        duration: time in which the correlation falls to 1/e, s.
    """
    deviation = np.broadcast_to(deviation, times.shape)
    apart = np.abs(np.subtract.outer(times, times))
    return np.outer(deviation, deviation) * np.exp(-apart / duration)


class RepeatingError:
    """A Kalman filter over repetitions, for an error d (M,) over time that nearly repeats.

    Repetition j shows H d + noise, and d changes a little between repetitions. Of
    each repetition's error, the filter believes what the covariances say: most of the
    first one's, ever less of later ones'.

    - ``mean``: estimate of d (M,), zero at first.
    - ``covariance``: covariance of the estimate's error (M, M).

    Args:
        covariance: covariance of d before the first repetition (M, M).
        shows: H (R, M).
        noise: covariance of a repetition's noise (R, R).
    """

    def __init__(self, covariance: np.ndarray, shows: np.ndarray, noise: np.ndarray):
        self.mean, self.covariance = np.zeros(len(covariance)), covariance
        self._shows, self._noise = shows, noise

    def change(self, covariance: np.ndarray) -> None:
        """Between two repetitions d has changed by something of this covariance (M, M)."""
        self.covariance = self.covariance + covariance

    def observe(self, shown: np.ndarray) -> None:
        """A repetition has shown these errors (R,), NaN where it showed none."""
        seen = np.isfinite(shown)
        H = self._shows[seen]
        together = H @ self.covariance
        of_errors = together @ H.T + self._noise[np.ix_(seen, seen)]
        gain = np.linalg.solve(of_errors, together).T
        self.mean = self.mean + gain @ (shown[seen] - H @ self.mean)
        after = self.covariance - gain @ together
        self.covariance = 0.5 * (after + after.T)

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviation of the estimate's error (M,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def after_another(self, change: np.ndarray) -> "RepeatingError":
        """The estimate after a change and another whole repetition that shows what it expects."""
        other = copy.copy(self)
        other.change(change)
        other.observe(self._shows @ self.mean)
        return other


@dataclasses.dataclass(frozen=True, eq=False)
class Repetition:
    """What a repetition of a plan has shown, of S segments and W wires.

    - ``reference_distance``, ``mean_error``: means of |φ_ref - φ| and of |φ* - φ| as it was
      read, rad; as far as it came.
    - ``interrupted``: why it ended before its time; empty if it did not.
    - ``remark``: what was done about it, if it was interrupted or undone; else empty.
    - ``correction``: change of the plan's duty, at the M + 1 nodes of `DutyCorrection`
      (M + 1, W).
    - ``duty``: duty that the wires got, in the model's L steps (L, W).
    - ``start``: readings at the start (W,), °C.
    - ``bend_angle``, ``measured_temperature``: readings around the nodes (M + 1, S), rad,
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


class Learner:
    """Learns from repetitions of a plan the duty with which a limb follows it.

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

    - ``trajectory``: the plan, which stays what is to be followed.
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
        self._estimate_afresh()

    def duty_trajectory(self) -> PiecewisePolynomial:
        """Duty of the next repetition (W), since its start, linear between its breaks."""
        return self._program.duty_trajectory(self.correction)

    def source(self) -> Diagram:
        """A system whose output ``duty`` (W) is that of the next repetition, for `replay`."""
        builder = DiagramBuilder()
        source = builder.AddSystem(TrajectorySource(self.duty_trajectory()))
        builder.ExportOutput(source.get_output_port(), "duty")
        diagram = builder.Build()
        diagram.set_name("learned_duty")
        return diagram

    def expected_bend_angle(self) -> np.ndarray:
        """φ that is expected of the next repetition, at ``nodes`` (M + 1, S), rad.

        It is the plan's where the limb can follow it, and else what it can do
        within the bounds: what a feedback should hold it to.
        """
        return self._program.expected_bend(self.correction, self._start, self._errors())

    @property
    def expected_error(self) -> float:
        """Mean of |φ* - φ| that is expected of the next repetition, but for what is unknown."""
        return float(np.abs(self._program.target - self.expected_bend_angle()).mean())

    @property
    def finished(self) -> str:
        """Why another repetition does not pay, in a sentence; empty if it does."""
        failures = len(list(itertools.takewhile(lambda r: r.failed, reversed(self.repetitions))))
        if failures >= MOST_FAILURES:
            return f"The last {failures} repetitions were interrupted or got worse."
        if not self.repetitions or self.repetitions[-1].failed:
            return ""
        rest, worth = self.expected_error, WORTH * self._sensor_error
        change = wandering(self.nodes, CHANGED_REST, DRIFT_TIME)
        next_time = [part.after_another(change) for part in self._bend]
        now, after = (
            np.mean([np.hypot(part.deviation, rest).mean() for part in parts])
            for parts in (self._bend, next_time)
        )
        if now - after > worth:
            return ""
        left = (
            f" The bounds of duty and temperature leave {np.rad2deg(rest):.2f}°."
            if rest > self._sensor_error / 4
            else ""
        )
        return (
            f"Another repetition is expected to make the error smaller by less than "
            f"{np.rad2deg(worth):.2g}°, as the sensor has noise and drift.{left}"
        )

    def update(self, recording: Recording) -> Repetition:
        """Learns from a repetition that was driven by ``source()``, or from its beginning.

        A repetition that was interrupted, or that was worse than the best one by more
        than noise and drift explain, is undone: the next one has the best one's duty,
        and steps are half as long from then on.

        Raises:
            LimbError: if the recording is of a limb of another shape, or has no
                plausible samples during the plan; nothing is learned then.
        """
        repetition = self._seen(recording)
        good = [other for other in self.repetitions if not other.failed]
        best = min(good, key=lambda other: other.mean_error, default=None)
        by_chance = SURELY * SPREAD * np.sqrt(2) * self._sensor_error  # a difference of two
        if repetition.interrupted:
            back = "back to the best repetition" if best else "its readings were learned"
            repetition = dataclasses.replace(repetition, remark=f"interrupted; {back}")
        elif best and repetition.mean_error > best.mean_error + by_chance:
            repetition = dataclasses.replace(
                repetition,
                remark=f"worse than {np.rad2deg(best.mean_error):.2f}°, by more than noise; back "
                "to that repetition, with shorter steps",
            )
        self._learn(repetition)
        self.repetitions.append(repetition)
        if repetition.failed and best:
            self.correction = best.correction
            return repetition
        gain = 0.5 ** sum(other.failed and not other.interrupted for other in self.repetitions)
        found = self._program.improve(
            repetition.correction, self._start, self._errors(), self._cooler()
        )
        self.correction = repetition.correction + gain * (found - repetition.correction)
        return repetition

    def _seen(self, recording: Recording) -> Repetition:
        """What a recording says about a repetition."""
        limbs = self.trajectory.parameters, recording.parameters
        planned, recorded = ((len(limb.segments), len(limb.wires)) for limb in limbs)
        if planned != recorded:
            raise LimbError(
                f"The recording is of {recorded[0]} segments and {recorded[1]} wires, but the "
                f"plan of {planned[0]} and {planned[1]}; give a recording of this plan."
            )
        program = self._program
        spacing = self.nodes[1] - self.nodes[0]
        interrupted = recording.interrupted
        if not interrupted and recording.time[-1] < self.nodes[-1] - spacing:
            interrupted = f"the recording ends at {recording.time[-1]:g} s"
        duty = recording.duty if recording.applied_duty is None else recording.applied_duty
        seen = recording.usable
        time = recording.time[seen]
        bend, readings = (
            _around(self.nodes, spacing, time, signals[:, seen])
            for signals in (recording.bend_angle, recording.measured_temperature)
        )
        distances = reference_distances(self.trajectory, [recording])
        assert distances.done is not None  # of recordings
        return Repetition(
            reference_distance=distances.done,
            mean_error=tracking_errors(self.trajectory, [recording]).mean,
            interrupted=interrupted,
            remark="",
            correction=self.correction,
            duty=np.array([np.interp(program.middles, recording.time, row) for row in duty]).T,
            start=recording.measured_temperature[:, seen][:, :3].mean(axis=1),
            bend_angle=bend,
            measured_temperature=readings,
        )

    def _estimate_afresh(self) -> None:
        """Estimates before the first repetition."""
        parameters, nodes = self.trajectory.parameters, self.nodes
        record, limits = parameters.calibration, parameters.temperature_limits
        of_bend, of_heat = UNKNOWN_BEND, UNKNOWN_TEMPERATURE
        if record is not None and record.bend_error > 0:
            of_bend = MEAN_TO_DEVIATION * record.bend_error
            of_heat = MEAN_TO_DEVIATION * record.temperature_error
        sensors = [segment.bend_sensor for segment in parameters.segments]
        self._sensor_error = max(np.hypot(sensor.noise, sensor.drift) for sensor in sensors)
        # The torque's error is about in proportion to the heat, which no wire has at first.
        heat = self._program.model.temperatures(
            self._program.rollout(self._start, self._program.steps(self.correction))
        )
        ambient = parameters.ambient_temperature
        share = np.clip((heat - ambient) / (limits.maximum - ambient), 0.0, 1.0)
        bend_error = wandering(nodes, of_bend * share.max(axis=1), SMOOTH)
        bend_error += wandering(nodes, REST_ERROR, 60.0)
        one = np.eye(len(nodes))
        self._bend = [
            RepeatingError(
                bend_error,
                one,
                (MEANS * sensor.noise**2 + ROUNDING) * one
                + wandering(nodes, sensor.drift, DRIFT_TIME),
            )
            for sensor in sensors
        ]
        self._lag = self._program.lag()
        self._heat = [
            RepeatingError(
                wandering(nodes, of_heat * np.maximum(share[:, wire], 0.1), SMOOTH),
                lag,
                READING_NOISE**2 * one,
            )
            for wire, lag in enumerate(self._lag)
        ]
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # φ and T of the model

    def _learn(self, repetition: Repetition) -> None:
        """Updates the estimates of the repeating errors."""
        program = self._program
        self._start = program.start(repetition.start)
        heat = program.rollout(self._start, repetition.duty)
        model, nodes = program.model, self.nodes
        bend, temperatures = model.bend_angle(heat), model.temperatures(heat)
        if self._last is not None and not repetition.interrupted:
            for parts, now, before, anyway in (
                (self._bend, bend, self._last[0], CHANGED_REST),
                (self._heat, temperatures, self._last[1], CHANGED_TEMPERATURE),
            ):
                changes = CHANGED_SHARE * np.abs(now - before)
                for part, change in zip(parts, changes.T, strict=True):
                    part.change(wandering(nodes, change, SMOOTH))
                    part.change(wandering(nodes, anyway, DRIFT_TIME))
        if not repetition.interrupted:
            self._last = bend, temperatures
        for part, shown in zip(self._bend, (repetition.bend_angle - bend).T, strict=True):
            part.observe(shown)
        readings = model.readings(heat)
        for part, shown in zip(
            self._heat, (repetition.measured_temperature - readings).T, strict=True
        ):
            part.observe(shown)

    def _errors(self) -> Errors:
        """The repeating errors, as far as they are known."""
        heat = np.array([part.mean for part in self._heat])
        return Errors(
            bend_angle=np.array([part.mean for part in self._bend]).T,
            wire_temperature=heat.T,
            measured_temperature=np.einsum("wij,wj->iw", self._lag, heat),
        )

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
        """Writes plan and repetitions whole or not at all; `load` goes on from there."""
        state = {
            "plan": self.trajectory.to_text(),
            "repetitions": [
                {
                    name: _listed(value) if isinstance(value, np.ndarray) else value
                    for name, value in vars(repetition).items()
                }
                for repetition in self.repetitions
            ],
            "correction": self.correction.tolist(),
            "provenance": self.provenance and dataclasses.asdict(self.provenance),
        }
        body = json.dumps(state, allow_nan=False)
        write_atomically(path, f"{_FIRST_LINE}{_digest(body)}\n{body}\n")

    @classmethod
    def load(cls, path: str | Path) -> "Learner":
        """Reads what `save` wrote.

        Raises:
            FileFormatError: one sentence that says what is wrong.
        """
        data = read_bytes(path, "learning", LARGEST_TABLE, FileFormatError)
        try:
            state = _parse(data)
            learner = cls(Trajectory.from_text(state["plan"]))
            for item in state["repetitions"]:
                repetition = Repetition(**learner._with_arrays(item))
                learner._learn(repetition)
                learner.repetitions.append(repetition)
            learner.provenance = Provenance.from_json(state["provenance"])
            learner.correction = learner._with_arrays(state)["correction"]
        except (KeyError, TypeError, ValueError) as error:
            raise FileFormatError(
                f"{path}: this is not what a learner saved, though its checksum is right: {error}"
            ) from error
        except LimbError as error:
            raise FileFormatError(f"{path}: {error}") from error
        return learner

    def _with_arrays(self, item: dict[str, Any]) -> dict[str, Any]:
        """Fields in a file, lists as arrays, whose shapes are checked."""
        nodes, wires = self.correction.shape
        shapes = {
            "correction": (nodes, wires),
            "duty": (len(self._program.middles), wires),
            "start": (wires,),
            "bend_angle": (nodes, len(self.trajectory.parameters.segments)),
            "measured_temperature": (nodes, wires),
        }
        arrays = {name: np.array(item[name], float) for name in shapes if name in item}
        for name, array in arrays.items():
            if array.shape != shapes[name]:
                raise ValueError(f"{name} has the shape {array.shape}, not {shapes[name]}.")
        return item | arrays


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


def _listed(values: np.ndarray) -> list:
    """As lists, None for NaN."""
    listed = values.astype(object)
    listed[np.isnan(values)] = None
    return listed.tolist()


def _parse(data: bytes) -> dict[str, Any]:
    """The state in a file."""
    first, _, body = data.decode("utf-8", errors="replace").partition("\n")
    if not first.startswith(_FIRST_LINE):
        raise FileFormatError(
            f"this is not what a learner saved: its first line is not '{_FIRST_LINE}...'."
        )
    if not body.endswith("\n") or first != _FIRST_LINE + _digest(body[:-1]):
        raise FileFormatError(
            "the content does not match the checksum in the first line; the file is truncated or "
            "was changed after it was written."
        )
    return json.loads(body)
