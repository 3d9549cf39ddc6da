"""Validation of a calibrated limb (Sec. V-D, Fig. 4)."""

import contextlib
import dataclasses
from collections.abc import Sequence

import numpy as np
from pydrake.trajectories import PiecewisePolynomial
from scipy.optimize import minimize_scalar

from calibration.prediction.heated_run import STEP, HeatedRun
from calibration.prediction.law_fit import Predicted
from calibration.recordings.at_rest import COLD_SPREAD, first_readings
from calibration.recordings.kinds import bend_sensor_of
from calibration.remarks import Remark, verdict
from limb_systems import Limb, LimbError, LimbModel, LimbParameters, Recording, simulate

# Mean |φ - φ_sim| as a fraction of the range of φ in the recording it is validated with.
GOOD_ERROR = 0.1  # 6° of 60°: the paper's robot is 3.4° to 5.3° from its plans in Table I
# s, and share of the silicone's warmth, to which it is found
WARM_START_TIME = 20.0
WARMTH_TOLERANCE = 0.03
LEAD_TIME = 1.0  # s, whose readings show how fast V changes at the start
WORST_ERROR = 0.25  # of a limb that stays in the middle of a range that φ fills evenly


@dataclasses.dataclass(frozen=True, eq=False)
class Validation:
    """The calibrated model, open loop, against a recording with both wires.

    - ``recording``, ``simulation``: the limb, and its model for the same
      duty, at the same times; the model's bend angle is what the limb's bend
      sensor would show.
    - ``mean``, ``median``, ``percentile_90``: size of |φ - φ_sim|, rad.
    - ``temperature_mean``: mean |V - V_sim|, °C; nan without thermocouples.
    """

    recording: Recording
    simulation: Recording
    mean: float
    median: float
    percentile_90: float
    temperature_mean: float

    @property
    def relative_error(self) -> float:
        """Mean |φ - φ_sim| as a fraction of the range of φ."""
        bend = self.recording.bend_angle
        span = (np.nanmax(bend, axis=1) - np.nanmin(bend, axis=1)).max()
        return self.mean / max(span, np.deg2rad(1.0))  # a limb at rest has sensor noise alone

    @property
    def in_words(self) -> str:
        """Return how far the model is from the limb, as part of a sentence."""
        degrees = np.rad2deg(self.mean)
        percent = 100 * self.relative_error
        return (
            f"the model is {degrees:.1f}° ({percent:.0f}% of its range) from the limb's bend on "
            "average"
        )

    @property
    def verdict(self) -> str:
        """Return whether to plan with the model, as far as this validation says."""
        return verdict(self.remarks, self.in_words)

    @property
    def remarks(self) -> list[Remark]:
        """A remark if the model misses the motion that it is validated with."""
        if self.relative_error <= GOOD_ERROR:
            return []
        sentence = (
            f"T{self.in_words[1:]}; look at both in the validation's picture, and record "
            "again what differs."
        )
        return [Remark("off" if self.relative_error <= WORST_ERROR else "far", sentence)]


def validate(parameters: LimbParameters, recording: Recording) -> Validation:
    """Simulate the duty of a recording, open loop, and compare the simulation with the recording.

    The model starts at rest with its wires at the first measured temperatures. If wires are warm at
    the start, the temperature of their silicone is fitted to the readings of the first seconds. An
    interrupted recording is compared up to its end, and samples without readings are left out. The
    times of the recording need not be even.

    Args:
        parameters: description of the limb, with the parameters to validate.
        recording: the recording to compare with.

    Raises:
        LimbError: if a value of the recording is not plausible.
    """
    recording.check_plausible()
    # Prepare the duty and the start of the simulation.
    times = recording.time - recording.time[0]
    # The duty at a sample was in force since the sample before.
    duty_in_force = np.column_stack([recording.duty[:, 1:], recording.duty[:, -1]])
    duty = PiecewisePolynomial.ZeroOrderHold(times, duty_in_force)
    first = first_readings(recording)
    initial_readings = np.nan_to_num(first, nan=parameters.ambient_temperature)  # V (W,), °C
    angles = LimbModel.of(parameters).mechanics.rest_angles

    def simulate_from(wire_states: np.ndarray, duration: float) -> Recording:
        """Simulate the duty for a duration, s, from states of the wires and their silicone."""
        at_rest = np.zeros_like(angles)
        state = np.concatenate([angles, at_rest, wire_states, initial_readings])
        rate = recording.sample_rate
        return simulate(Limb(parameters), duty, duration, sample_rate=rate, initial_state=state)

    def start_error(wire_states: np.ndarray) -> float:
        """Return the mean error of V in the first seconds, °C."""
        simulation = simulate_from(wire_states, min(WARM_START_TIME, times[-1]))
        is_early = times <= simulation.time[-1]
        measured = recording.measured_temperature[:, is_early]
        readings = simulation.interpolated(simulation.measured_temperature, times[is_early])
        return float(np.nanmean(np.abs(readings - measured)))

    # Find the temperature of the silicone at the start, from cold to as warm as its wires.
    cold, wire_states = _warm_starts(parameters, recording, initial_readings)
    if (cold != wire_states).any():
        warmth = wire_states - cold
        search = minimize_scalar(
            lambda share: start_error(cold + share * warmth),
            bounds=(0.0, 1.0),
            method="bounded",
            options={"xatol": WARMTH_TOLERANCE},
        )
        wire_states = cold + search.x * warmth
    # Simulate the whole recording, and read the bend as the limb's own sensor does.
    simulation = simulate_from(wire_states, times[-1])
    assert simulation.joint_state is not None  # simulations of a model have it
    mechanics = LimbModel.of(parameters).mechanics
    apparent_bends = []
    for segment, (chain, joints) in enumerate(mechanics.chains_with_joints):
        sensor = bend_sensor_of(recording, segment)
        apparent_bends.append(sensor.apparent_bends(chain, simulation.joint_state[joints]))
    simulated = Recording(
        time=recording.time,
        duty=recording.duty,
        measured_temperature=simulation.interpolated(simulation.measured_temperature, times),
        bend_angle=simulation.interpolated(np.concatenate(apparent_bends), times),
        parameters=parameters,
        source="model",
        sample_rate=recording.sample_rate,
    )
    return _compare(recording, simulated)


def _warm_starts(
    parameters: LimbParameters, recording: Recording, first: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the states of wires that are read at V (W,), °C, in cold and in warm silicone."""
    wires = LimbModel.of(parameters).wires
    warmth = first.copy()
    # Estimate T of warm wires from the rate at which V changes: it is ahead by the lag.
    warm = first > parameters.ambient_temperature + COLD_SPREAD
    is_early = recording.time <= recording.time[0] + max(LEAD_TIME, 2.5 / recording.sample_rate)
    for index in np.flatnonzero(warm):
        is_used = is_early & ~np.isnan(recording.measured_temperature[index])
        with contextlib.suppress(LimbError):  # of a law that does not say how late V is
            rate = parameters.wires[index].law.typical_rates()["reading"]
            readings = recording.measured_temperature[index, is_used]
            if len(readings) > 2:
                warmth[index] += np.polyfit(recording.time[is_used], readings, 1)[0] / rate
    # Silicone may be cold or as warm as its wire.
    settled = wires.rested_states(warmth)
    is_silicone = wires.settles & warm.any()  # and no memory
    is_silicone[: wires.num_wires] = False
    return np.where(is_silicone, wires.cold_states, settled), settled


def validation_of(predictions: Sequence[Predicted], parameters: LimbParameters) -> Validation:
    """Compare recordings, one after the other, with their prediction by a law.

    A sample without readings parts them, so that no picture draws a line from one to the next.
    """
    # Put the recordings one after the other.
    start = 0.0
    times = []
    duty = []
    for predicted in predictions:
        run = predicted.run
        # Each run ends with a sample without readings.
        span = run.times[-1] - run.times[0] + STEP
        step = np.minimum((run.times / STEP).astype(int), len(run.duty) - 1)
        times.append(np.append(run.times - run.times[0], span - STEP / 2) + start)
        duty.append(np.vstack([run.duty[step], np.zeros_like(run.duty[:1])]))
        start += span
    runs = [predicted.run for predicted in predictions]

    def recording(runs_or_predictions: Sequence[HeatedRun | Predicted], source: str) -> Recording:
        """Return what was recorded or predicted, with a sample without readings after each run."""

        def joined(signals: Sequence[np.ndarray]) -> np.ndarray:
            gap = np.full_like(signals[0][:1], np.nan)
            return np.concatenate([np.vstack([signal, gap]) for signal in signals]).T

        return Recording(
            time=np.concatenate(times),
            duty=np.concatenate(duty).T,
            measured_temperature=joined([item.temperature for item in runs_or_predictions]),
            bend_angle=joined([item.bend for item in runs_or_predictions]),
            parameters=parameters,
            source=source,
            sample_rate=1 / STEP,
        )

    # Compare what was recorded with what is predicted.
    sources = ", ".join(dict.fromkeys(run.source for run in runs))
    return _compare(recording(runs, sources), recording(predictions, "model"))


def _compare(recording: Recording, simulation: Recording) -> Validation:
    """Return the statistics of the differences between a recording and its simulation."""
    differences = simulation.bend_angle - recording.bend_angle
    is_planar = simulation.model.layout.is_planar
    bend = np.abs(differences) if is_planar else np.linalg.norm(differences, axis=0)
    heat = np.abs(simulation.measured_temperature - recording.measured_temperature)
    error = bend[~np.isnan(bend)]
    heat = heat[~np.isnan(heat)]
    return Validation(
        recording,
        simulation,
        mean=float(error.mean()),
        median=float(np.median(error)),
        percentile_90=float(np.percentile(error, 90)),
        temperature_mean=float(heat.mean()) if len(heat) else np.nan,
    )
