"""The damping constant from a ring-down (Sec. V-B, Algorithm 1)."""

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, least_squares

from calibration.bend_sensor import bend_sensor_of
from calibration.checks import check_values
from calibration.errors import CalibrationError
from calibration.estimate import Estimate
from calibration.kinds import only_segment
from calibration.remarks import Remark, remarks_on_estimate
from limb_systems import (
    Limb,
    LimbParameters,
    Recording,
    Wires,
    joint_angles_from_bend_angle,
    simulate,
)
from limb_systems.model.kinematics import rest_joint_angles


@dataclasses.dataclass(frozen=True, eq=False)
class DampedSinusoid:
    """A exp(-ζ ω t) sin(ω √(1 - ζ²) t + ϕ) + b, fitted to a signal from ``start`` on.

    - ``damping_ratio``: ζ.
    - ``natural_frequency``: ω, rad/s.
    - ``amplitude``, ``phase``, ``offset``: A, ϕ, b at t = 0, the start.
    - ``start``: of the fit, s.
    - ``decay_rate``: ζ ω with its standard error, 1/s.
    - ``residual``: root mean square, in the unit of the signal.
    """

    damping_ratio: float
    natural_frequency: float
    amplitude: float
    phase: float
    offset: float
    start: float
    decay_rate: Estimate
    residual: float

    @property
    def frequency(self) -> float:
        """Of the damped oscillation, Hz."""
        return self.natural_frequency * np.sqrt(1 - self.damping_ratio**2) / (2 * np.pi)

    def __call__(self, times: ArrayLike) -> np.ndarray:
        """The sinusoid at times (K,), s."""
        since = np.asarray(times, float) - self.start
        turns = 2 * np.pi * self.frequency * since + self.phase
        decay = np.exp(-self.damping_ratio * self.natural_frequency * since)
        return self.amplitude * decay * np.sin(turns) + self.offset


@dataclasses.dataclass(frozen=True, eq=False)
class DampingFit:
    """The damping constant of each joint.

    - ``damping``: σ, N·m·s/rad.
    - ``measured``: the sinusoid of each recording.
    - ``simulated``: that of the model with this σ, for each recording, as the
      recording's bend sensor would show it.
    - ``time``, ``bend_angle``: of the first recording (K,), s and rad.
    - ``remarks``: sentences on what the data lack.
    """

    damping: Estimate
    measured: list[DampedSinusoid]
    simulated: list[DampedSinusoid]
    time: np.ndarray
    bend_angle: np.ndarray
    remarks: list[Remark]


def fit_damped_sinusoid(time: ArrayLike, signal: ArrayLike) -> DampedSinusoid:
    """fitDS of Algorithm 1: a damped sinusoid with an offset, by least squares.

    The fit starts where the signal moves fastest, so that a hold by hand before
    the release is left out. In A cos ϕ, A sin ϕ and b the fit is linear, so these
    are eliminated and only ζ and ω are searched.

    Args:
        time: (K,), s, evenly spaced.
        signal: (K,), in any unit.

    Raises:
        CalibrationError: if the signal does not oscillate.
    """
    time, signal = np.asarray(time, float), np.asarray(signal, float)
    if time.shape != signal.shape or len(time) < 20:
        raise CalibrationError("A ring-down needs at least 20 samples, and a time for each.")
    period = (time[-1] - time[0]) / (len(time) - 1)
    start = int(np.argmax(np.abs(np.gradient(signal))))
    since, values = time[start:] - time[start], signal[start:]
    if len(values) < 20:
        raise CalibrationError(
            f"The signal moves fastest at {time[start]:.2f} s, at its end; there is no ring-down "
            "after it."
        )

    if not np.ptp(values) > 0:
        raise CalibrationError("The signal does not move; there is no ring-down in it.")

    def basis(logarithms: np.ndarray) -> np.ndarray:
        decay, turning = np.exp(logarithms)
        envelope = np.exp(-decay * since)
        waves = [envelope * np.sin(turning * since), envelope * np.cos(turning * since)]
        return np.column_stack([*waves, np.ones_like(since)])

    def residuals(logarithms: np.ndarray) -> np.ndarray:
        columns = basis(logarithms)
        return columns @ np.linalg.lstsq(columns, values, rcond=None)[0] - values

    # Several starts around the peak of the spectrum; the best fit is taken.
    padded = 8 * len(values)
    spectrum = np.abs(np.fft.rfft(values - values[-len(values) // 4 :].mean(), padded))
    frequencies = np.fft.rfftfreq(padded, period)
    spectrum[frequencies < 1.0 / since[-1]] = 0.0
    peak = 2 * np.pi * frequencies[np.argmax(spectrum)]
    starts = [np.log([ratio * peak, peak]) for ratio in (0.01, 0.03, 0.1, 0.3)]
    best = min(starts, key=lambda x: np.sum(residuals(x) ** 2))
    fit = least_squares(residuals, best, x_scale=0.1)

    decay, turning = np.exp(fit.x)
    sine, cosine, offset = np.linalg.lstsq(basis(fit.x), values, rcond=None)[0]
    amplitude, rms = np.hypot(sine, cosine), np.sqrt(np.mean(fit.fun**2))
    if amplitude < 3 * rms or not 1.0 / since[-1] < turning / (2 * np.pi) < 0.5 / period:
        raise CalibrationError(
            f"No oscillation stands out after {time[start]:.2f} s: its amplitude would be "
            f"{amplitude:.3g}, compared with residuals of {rms:.3g}."
        )
    error = np.sqrt(np.linalg.inv(fit.jac.T @ fit.jac)[0, 0]) * rms  # of the logarithm
    natural = np.hypot(decay, turning)
    return DampedSinusoid(
        damping_ratio=float(decay / natural),
        natural_frequency=float(natural),
        amplitude=float(amplitude),
        phase=float(np.arctan2(cosine, sine)),
        offset=float(offset),
        start=float(time[start]),
        decay_rate=Estimate(float(decay), float(error * decay), "1/s"),
        residual=float(rms),
    )


def fit_damping(parameters: LimbParameters, recordings: Sequence[Recording]) -> DampingFit:
    """fitData of Algorithm 1: σ with which the model rings down like the limb.

    Args:
        parameters: of the limb, with its calibrated stiffness.
        recordings: of passive oscillation after a release from about 45°; the
            hold before may be part of them.

    Raises:
        CalibrationError: if there is no ring-down, or no σ explains it.
    """
    if not recordings:
        raise CalibrationError("There is no recording of a ring-down.")
    fits = [_fit_recording(parameters, recording) for recording in recordings]
    values = np.array([value for value, _, _, _ in fits])
    within = np.array([error for _, error, _, _ in fits])
    between = values.std(ddof=1) if len(values) > 1 else 0.0
    error = np.hypot(between, np.sqrt(np.mean(within**2))) / np.sqrt(len(values))
    measured, simulated = [fit[2] for fit in fits], [fit[3] for fit in fits]
    remarks = []
    ratio = np.mean([m.frequency / s.frequency for m, s in zip(measured, simulated, strict=True)])
    if abs(ratio - 1) > 0.05:
        remarks.append(
            Remark(
                "ringing",
                f"The limb rings at {measured[0].frequency:.2f} Hz, its model with the spring "
                f"constant of the sag at {simulated[0].frequency:.2f} Hz: rubber is stiffer in "
                "fast motion, or mass or sag are off; weigh the limb.",
            )
        )
    if any(fit.residual > 0.15 * fit.amplitude for fit in measured):
        remarks.append(
            Remark(
                "ringing",
                "The ring-down is far from a damped sinusoid; release the limb in one move.",
            )
        )
    estimate = Estimate(float(values.mean()), float(error), "N·m·s/rad")
    remarks += remarks_on_estimate("the damping", estimate)
    return DampingFit(
        estimate,
        measured,
        simulated,
        recordings[0].time,
        recordings[0].bend_angle[0],
        remarks,
    )


def _fit_recording(parameters, recording: Recording):
    """σ and its standard error, and the sinusoids of limb and model."""
    check_values(recording)
    sensor = bend_sensor_of(recording)
    measured = fit_damped_sinusoid(recording.time, recording.bend_angle[0])
    released = np.abs(recording.bend_angle[0] - measured.offset).max() / sensor.gain
    duration = recording.time[-1] - measured.start

    def ring_down(damping: float) -> DampedSinusoid:
        limb = copy.deepcopy(parameters)
        limb.gravity, limb.segments[0].damping = [0.0, 0.0, 0.0], float(damping)
        room = np.full(len(limb.wires), limb.ambient_temperature)
        angles = rest_joint_angles(limb) + joint_angles_from_bend_angle(limb, [released])
        cold = Wires(limb).cold_states
        state = np.concatenate([angles, np.zeros_like(angles), cold, room])
        model = simulate(
            Limb(limb), 0 * room, duration, sample_rate=recording.sample_rate, initial_state=state
        )
        assert model.joint_state is not None  # a model's
        seen = sensor.apparent_bend_angle(model.joint_state[: limb.num_joints])
        return fit_damped_sinusoid(model.time, seen)

    def mismatch(logarithm: float) -> float:
        return np.log(ring_down(np.exp(logarithm)).decay_rate.value / measured.decay_rate.value)

    # Decay is about proportional to σ, which gives a start and a bracket around it.
    guess = np.log(only_segment(parameters).damping)
    guess -= mismatch(guess)
    low, high = guess - 0.3, guess + 0.3
    try:
        logarithm = brentq(mismatch, low, high, xtol=1e-4)
    except (ValueError, CalibrationError) as error:
        raise CalibrationError(
            f"No damping constant near {np.exp(guess):.2g} N·m·s/rad makes the model decay with "
            f"{measured.decay_rate.value:.2f} 1/s as the limb does."
        ) from error
    damping = float(np.exp(logarithm))
    slope = (mismatch(logarithm + 0.05) - mismatch(logarithm)) / 0.05
    relative = measured.decay_rate.standard_error / measured.decay_rate.value / abs(slope)
    return damping, damping * relative, measured, ring_down(damping)
