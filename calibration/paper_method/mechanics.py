"""Stiffness from the sag under gravity (Sec. V-A), and damping from a ring-down (Sec. V-B)."""

import copy
import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from calibration.estimate import Estimate, pooled_spread, standard_error
from calibration.recordings.kinds import bend_sensor_of, only_segment, title_of
from calibration.recordings.repair import fill_gaps, select_samples
from calibration.remarks import CalibrationError, Remark, remarks_on_estimate
from limb_systems import (
    BendSensor,
    ChordSensor,
    LimbError,
    LimbModel,
    LimbParameters,
    LinearLaw,
    Recording,
    TipTangentSensor,
    joint_angles_from_bend_angle,
)
from limb_systems.limb_mechanics import ANGLE_SCALE
from limb_systems.statics import static_equilibrium
from planners.radau import NODES, MotionSteps, solve_steps

RESTING_TIME = 5.0  # s at the end of a recording that count as equilibrium
MAX_STIFFNESS_RATIO = 10.0  # factor between the described stiffness and any such limb's
MAX_SENSOR_MISMATCH = 0.15  # logarithm of frequencies, beyond which the sensor is in doubt
MAX_RESTING_MOTION = np.deg2rad(1.0)  # by which the bend angle may move in that time
GRAVITY = 9.81  # m/s²
# Sag under a payload, if it grew in proportion; in truth it is some 15°, far beyond a sensor's
# drift, and rubber hardly stiffens.
LOADED_SAG = np.deg2rad(18.0)
MIN_OWN_SAG = 5.0  # times the drift of the bend sensor: ten trials then tell k to 6%
GAIN_ERROR = 0.02  # standard error of a bend sensor's gain, ours: two degrees at a right angle
# Share by which a limb is stiffer in a ring-down than in a sag, and its standard error, ours:
# silicones relax by some 5 to 15% within seconds, and cold wires need not follow fast motions.
FAST_STIFFENING = 0.10
FAST_STIFFENING_ERROR = 0.06
RING_DOWN_ERROR = 0.05  # standard error of k by a single ring-down
WELL_KNOWN_SHARE = 0.05  # share of k, to which gaits and loads need it
# Share of k by which trials may leave it unknown: as a mounting 2° off of 10° does.
MAX_SCATTER = 0.2
# Multiple of the described stiffness, at which limbs sag in proportion to their weight.
RIGID_STIFFNESS_RATIO = 100.0

MODEL_RATE = 200.0  # Hz, at least, of the model's ring-down
MIN_SAMPLES = 20  # samples of a ring-down
# Samples below which noise and an alias of the oscillation look alike.
MIN_SAMPLES_PER_PERIOD = 3.0
RELEASE_PACE_SHARE = 0.5  # of the fastest motion, from which on a limb counts as released
# robust standard deviations, and share of the swing, of a glitch
OUTLIER_DEVIATIONS = 6.0
OUTLIER_SWING_SHARE = 0.3
# decay rate over angular frequency of what rings
MIN_DECAY_RATIO = 1e-4
MAX_DECAY_RATIO = 1.0
# Factor between the frequencies of limb and model, beyond which one of them is wrong.
MAX_FREQUENCY_RATIO = 2.0
MAX_RELEASE_BEND = np.pi / 2  # rad, of the model's release
# of the search for σ, and relative difference of decays at its end
MAX_DAMPING_STEPS = 8
DECAY_TOLERANCE = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class StiffnessFit:
    """The spring constant of each joint, from a limb that sags.

    - ``stiffness``: k, N·m/rad; by sag and ring-down together after `with_ringing`.
    - ``by_sag``: k by the sag alone.
    - ``correction_factor``: λ of eqn (9), without unit, for φ^eq as the bend sensor shows it.
    - ``chord_factor``: λ of the same sag for φ^eq of the chord, which the paper has: 1.22 of a
      sag by 10° of five links. A tip tangent's α/2 is two thirds of the chord's angle.
    - ``sags``: φ^eq of each trial (K,), rad, signed as gravity, as recorded.
    - ``remarks``: sentences on what the data lack.
    """

    stiffness: Estimate
    by_sag: Estimate
    correction_factor: float
    chord_factor: float
    sags: np.ndarray
    remarks: list[Remark]

    @property
    def factor_in_words(self) -> str:
        """λ, and what it is by the chord, as in the paper, if the sensor shows another angle."""
        text = f"λ = {self.correction_factor:.3f}"
        if abs(self.chord_factor / self.correction_factor - 1) >= 0.02:
            text += (
                " of the bend that the sensor shows; of the chord's angle, as in the paper, the "
                f"same sag has {self.chord_factor:.2f}"
            )
        return text


def shape_factors(links: int, load: float = 0.0) -> np.ndarray:
    """Return the shares of the joints in a sag, b_i of eqn (9) (links,).

    The denominator is Σ (N - j + 1)², not Σ (N - j)² as printed.

    Args:
        load: payload at the tip over the mass of a link.
    """
    beyond = np.arange(links, 0, -1.0)
    torques = beyond**2 + 2 * load * beyond
    return torques / torques.sum()


def sag_payload(described: LimbParameters, min_own_sag: float = MIN_OWN_SAG) -> float:
    """Return the payload with which to record the sag of a planar limb, kg.

    It is zero if the limb's own sag is large enough, and else bends the limb by some 15°. It is
    hung to the tip in addition to the payload that is described.

    Args:
        described: the limb, of one segment, with the stiffness that is expected of it.
        min_own_sag: own sag over the drift of the bend sensor, from which on no payload is needed.
    """
    segment = only_segment(described)
    sensor = segment.bend_sensor
    k = segment.stiffness
    # Compute the sags of the limb alone and with its own mass at the tip.
    mounted = _mounted(described, [0.0, GRAVITY, 0.0], described.payload)
    own_sag = _compliance(mounted, sensor) / k / sensor.gain
    mounted.payload += segment.mass
    loaded_sag = _compliance(mounted, sensor) / k / sensor.gain
    if own_sag >= min(min_own_sag * sensor.drift / sensor.gain, LOADED_SAG):
        return 0.0
    return float(f"{(LOADED_SAG - own_sag) / (loaded_sag - own_sag) * segment.mass:.2g}")


def further_sag(limb: LimbParameters, stiffness: Estimate | None) -> str:
    """Return the most informative recording of a sag, in words; empty if k is known.

    Args:
        limb: the limb, with the stiffness that is known.
        stiffness: k as it was calibrated; None if there is no recording of the sag.
    """
    if stiffness and stiffness.standard_error <= WELL_KNOWN_SHARE * stiffness.value:
        return ""
    load = sag_payload(limb, np.inf if stiffness else MIN_OWN_SAG)
    total = limb.payload + load
    by = f" with {1000 * load:.3g} g at the tip (payload: {total:g} in its header)" if load else ""
    return f"record the sag under gravity{by}, to one side and to the other, which tells k"


def fit_stiffness(
    parameters: LimbParameters, recordings: Sequence[Recording], rest_error: float = 0.0
) -> StiffnessFit:
    """Fit k to the limb's recorded equilibria under gravity (Sec. V-A).

    Recordings of the same mounting are averaged. k and the rest angle are fitted by least
    squares to what the bend sensor shows in each mounting; of one mounting that is what the
    iteration of Sec. V-A leads to. λ of eqn (9) is of the first recording. The standard error
    contains the errors of the trials, of the rest angle and of the sensor's gain.

    Args:
        parameters: geometry, mass and rest angle of the limb; of one segment.
        recordings: recordings of the limb at rest, unheated, with E2 along the vertical
            or against it. Their parameters say how: ``gravity`` and ``payload``. At rest the
            last 5 s count.
        rest_error: standard error of the rest angle, rad.

    Raises:
        CalibrationError: if the limb does not rest, or sags against gravity; if its bend was
            read in several ways; if k is more than ten times the described one, or less than a
            tenth.
    """
    if not recordings:
        raise CalibrationError("There is no recording of the limb's sag under gravity.")
    # Read the sags, all by one sensor.
    sags = np.array([_resting_angle(recording) for recording in recordings])
    sensor = bend_sensor_of(recordings[0])
    for recording in recordings[1:]:
        if bend_sensor_of(recording) != sensor:
            raise CalibrationError(
                f"The sag was recorded with {sensor} and with {bend_sensor_of(recording)}; use "
                "the same bend sensor each time."
            )
    limbs = [_mounted(parameters, r.parameters.gravity, r.parameters.payload) for r in recordings]
    estimate, rest = _stiffness_of_sags(limbs, sensor, sags, rest_error)
    stiffness = estimate.value
    described = only_segment(parameters).stiffness
    if not described / MAX_STIFFNESS_RATIO < stiffness < described * MAX_STIFFNESS_RATIO:
        bends = sensor.corrected_bends(sags[np.newaxis])
        largest = np.abs(bends - only_segment(parameters).rest_angle).max()
        raise CalibrationError(
            f"A sag of {np.rad2deg(largest):.1f}° makes the stiffness {stiffness:.2g} N·m/rad, "
            f"where the description has {described:.2g} N·m/rad; look at mass, length and payload "
            "in the description, and at what the bend sensor reads while the limb is straight."
        )
    # Say what is missing.
    remarks = remarks_on_estimate("the stiffness", estimate)
    if len(sags) < 3:
        sentence = (
            f"Only {len(sags)} trial{'s' * (len(sags) > 1)} of the sag: mounting and sensor differ "
            "by about 2° from trial to trial, so record ten."
        )
        remarks.append(Remark("few", sentence))
    # Compute λ of eqn (9) from the fitted equilibrium.
    sagging_angles = _sag_of(limbs[0], sensor, stiffness, rest)[1]
    segment = only_segment(limbs[0])
    rest_joints = joint_angles_from_bend_angle(limbs[0], [rest])
    shape = shape_factors(segment.links, limbs[0].payload / segment.mass * segment.links)
    sensor_bend = float(sensor.exact_bends(segment.chain, sagging_angles)[0]) - rest
    chord_bend = float(segment.chain.bend_angle(sagging_angles)[0]) - rest
    correction = float(shape @ (sagging_angles - rest_joints) / (shape @ shape) / sensor_bend)
    chord_correction = correction * sensor_bend / chord_bend
    return StiffnessFit(estimate, estimate, correction, chord_correction, sags, remarks)


def _stiffness_of_sags(
    limbs: Sequence[LimbParameters], sensor: BendSensor, sags: np.ndarray, rest_error: float
) -> tuple[Estimate, float]:
    """Return k and the rest angle, rad, by the sags (K,), rad, of mounted limbs at a sensor."""
    # Average trials of the same mounting.
    loads = np.array([[*limb.gravity, limb.payload] for limb in limbs])
    _, first, group = np.unique(loads.round(9), axis=0, return_index=True, return_inverse=True)
    counts = np.bincount(group)
    # Of means: in a fit to each trial their scatter would count as sag, and k be too small.
    means = np.bincount(group, sags) / counts
    mounted_limbs = [limbs[index] for index in first]
    rest = only_segment(limbs[0]).rest_angle
    # Start from a limb that sags in proportion to its softness.
    compliances = np.array([_compliance(limb, sensor) for limb in mounted_limbs])
    sag_means = means - _rest_reading(limbs[0], sensor)
    if not (counts * compliances) @ sag_means > 0:
        heaviest = np.argmax(np.abs(compliances))
        raise CalibrationError(
            f"The limb sags by {np.rad2deg(sag_means[heaviest] / sensor.gain):.1f}° where gravity "
            f"along E2 is {mounted_limbs[heaviest].gravity[1]:g} m/s²: it bends upwards. Is the "
            "bend sensor reversed, or gravity in the header?"
        )
    softness = (counts * compliances) @ sag_means / ((counts * compliances) @ compliances)
    # Trials that are all the same say nothing of the sensor's drift.
    spread = sensor.drift
    if np.ptp(scatter := sags - means[group]) > 1e-9:
        spread = pooled_spread(scatter, len(counts))
    weights = np.sqrt(counts) / max(spread, 1e-9)

    # Fit log k and the rest angle to the means; a rest angle that is known moves no sag.
    @functools.cache
    def simulated_sags(k: float, angle: float) -> np.ndarray:
        return np.array([_sag_of(limb, sensor, k, angle)[0] for limb in mounted_limbs])

    def residuals(unknown: np.ndarray) -> np.ndarray:
        simulated = simulated_sags(np.exp(unknown[0]), rest + rest_error * unknown[1])
        return np.append(weights * (simulated - means), unknown[1])

    try:
        fit = least_squares(residuals, [-np.log(softness), 0.0], x_scale=[0.1, 1.0])
    except LimbError as error:
        raise CalibrationError(
            f"No spring constant explains a sag of {np.rad2deg(np.abs(sag_means).max()):.1f}° with "
            f"this mass and length: {error}"
        ) from error
    trial_variance = np.linalg.inv(fit.jac.T @ fit.jac)[0, 0]
    k = float(np.exp(fit.x[0]))
    angle = float(rest + rest_error * fit.x[1])
    return Estimate(k, k * float(np.hypot(np.sqrt(trial_variance), GAIN_ERROR)), "N·m/rad"), angle


def _mounted(
    parameters: LimbParameters, gravity: Sequence[float], payload: float
) -> LimbParameters:
    """Return a limb as it is mounted under gravity (3,), m/s², with a payload at its tip, kg."""
    return dataclasses.replace(copy.deepcopy(parameters), gravity=list(gravity), payload=payload)


def _sag_of(
    mounted: LimbParameters, sensor: BendSensor, stiffness: float, rest: float
) -> tuple[float, np.ndarray]:
    """Return what a sensor shows of a limb at rest, rad, and its joint angles (n,)."""
    limb = copy.deepcopy(mounted)
    segment = only_segment(limb)
    segment.stiffness = stiffness
    segment.rest_angle = rest
    joint_angles, _ = static_equilibrium(limb)
    return float(sensor.apparent_bends(segment.chain, joint_angles)[0]), joint_angles


def _compliance(mounted: LimbParameters, sensor: BendSensor) -> float:
    """Return sag times k of a limb that is almost rigid, as a sensor shows it, N·m."""
    segment = only_segment(mounted)
    rigid = RIGID_STIFFNESS_RATIO * segment.stiffness
    stiff_sag, _ = _sag_of(mounted, sensor, rigid, segment.rest_angle)
    return rigid * (stiff_sag - _rest_reading(mounted, sensor))


def _rest_reading(limb: LimbParameters, sensor: BendSensor) -> float:
    """Return what a sensor shows of a limb at its rest angle, rad."""
    chain = only_segment(limb).chain
    return float(sensor.apparent_bends(chain, LimbModel.of(limb).mechanics.rest_angles)[0])


def _resting_angle(recording: Recording) -> float:
    """Return the mean bend angle over the end of a recording, rad."""
    recording.check_plausible()
    recording = select_samples(recording, ~recording.missing)
    is_end = recording.time >= recording.time[-1] - RESTING_TIME
    angle = recording.bend_angle[0, is_end]
    first, second = np.array_split(angle, 2)
    drift = abs(first.mean() - second.mean())
    swing = np.median(np.abs(angle - np.median(angle)))
    max_swing = max(MAX_RESTING_MOTION, 2 * bend_sensor_of(recording).noise)
    if drift > MAX_RESTING_MOTION or swing > max_swing:
        raise CalibrationError(
            f"The limb does not rest at the end of {title_of(recording)}: its bend still moves by "
            f"{np.rad2deg(max(drift, swing)):.1f}°."
        )
    return float(angle.mean())


@dataclasses.dataclass(frozen=True, eq=False)
class DampedSinusoid:
    """A exp(-ζ ω t) sin(ω √(1 - ζ²) t + ϕ) + b, fitted to a signal from ``start`` on.

    - ``damping_ratio``: ζ.
    - ``natural_frequency``: ω, rad/s.
    - ``amplitude``, ``offset``: A at t = 0, the start, and b.
    - ``start``: time at which the fit starts, s.
    - ``decay_rate``: ζ ω with its standard error, 1/s.
    - ``residual``: root mean square of the deviations, in the unit of the signal.
    """

    damping_ratio: float
    natural_frequency: float
    amplitude: float
    offset: float
    start: float
    decay_rate: Estimate
    residual: float

    @property
    def frequency(self) -> float:
        """Frequency of the damped oscillation, Hz."""
        return self.natural_frequency * np.sqrt(1 - self.damping_ratio**2) / (2 * np.pi)


@dataclasses.dataclass(frozen=True, eq=False)
class DampingFit:
    """The damping constant of each joint.

    - ``damping``: σ, N·m·s/rad.
    - ``measured``: the sinusoid of each recording.
    - ``simulated``: the sinusoid of the model with this σ, for each recording, as the
      recording's bend sensor would show it.
    - ``remarks``: sentences on what the data lack.
    """

    damping: Estimate
    measured: Sequence[DampedSinusoid]
    simulated: Sequence[DampedSinusoid]
    remarks: list[Remark]


def fit_damped_sinusoid(
    time: ArrayLike, signal: ArrayLike, band: tuple[float, float] = (0.0, np.inf)
) -> DampedSinusoid:
    """Fit a damped sinusoid with an offset by least squares, fitDS of Algorithm 1.

    The fit starts where the signal first passes its final level after the release,
    so that a hold by hand is left out, and the shock of the release, in which a limb
    has higher modes. In A cos ϕ, A sin ϕ and b the fit is linear, so these are
    eliminated and only ζ and ω are searched. Samples that are far off it, glitches
    of the sensor, are left out of a second fit.

    Args:
        time: (K,), s, evenly spaced.
        signal: (K,), in any unit; nan where it is missing.
        band: frequencies, Hz, between which the oscillation is searched. Below one period in the
            signal and above half the sampling rate there is none to be found.

    Raises:
        CalibrationError: if the signal does not oscillate, or if samples or times are missing.
    """
    time = np.asarray(time, float)
    signal = np.asarray(signal, float)
    if time.shape != signal.shape or len(time) < MIN_SAMPLES:
        raise CalibrationError(
            f"A ring-down needs at least {MIN_SAMPLES} samples, and a time for each."
        )
    is_read = ~np.isnan(signal)
    signal = fill_gaps(time, signal)
    if not np.ptp(signal) > 0:
        raise CalibrationError("The signal does not move; there is no ring-down in it.")
    # Start where the signal first passes its final level.
    period = (time[-1] - time[0]) / (len(time) - 1)
    release = _release_index(signal)
    level = np.median(signal[release + 3 * (len(signal) - release) // 4 :])
    side = np.sign(np.median(signal[max(0, release - 4) : release + 1]) - level)
    has_passed = side * (signal[release:] - level) < 0
    start = release + int(np.argmax(has_passed))
    since = time[start:] - time[start]
    values = signal[start:]
    if len(values) < MIN_SAMPLES:
        raise CalibrationError(
            f"The signal moves fastest at {time[start]:.2f} s, at its end; there is no ring-down "
            "after it."
        )
    is_read = is_read[start:]
    is_used = is_read.copy()

    lowest = max(band[0], 1.0 / since[-1])
    highest = min(band[1], 0.5 / period)
    if not lowest < highest:
        raise CalibrationError(
            f"The ring-down lasts {since[-1]:.2f} s at {1 / period:.3g} Hz, which shows no "
            f"oscillation of {band[0]:.3g} Hz to {band[1]:.3g} Hz."
        )

    # Amplitudes and offset are linear, so only ratio and frequency are searched.
    def basis(logarithms: np.ndarray) -> np.ndarray:
        ratio, omega = np.exp(logarithms)
        envelope = np.exp(-ratio * omega * since)
        waves = [envelope * np.sin(omega * since), envelope * np.cos(omega * since)]
        return np.column_stack([*waves, np.ones_like(since)])

    def weights(logarithms: np.ndarray) -> np.ndarray:
        return np.linalg.lstsq(basis(logarithms)[is_used], values[is_used], rcond=None)[0]

    def residuals(logarithms: np.ndarray) -> np.ndarray:
        return basis(logarithms)[is_used] @ weights(logarithms) - values[is_used]

    # Several starts around the peak of the spectrum; the best fit is taken.
    padded = 8 * len(values)
    spectrum = np.abs(np.fft.rfft(values - values[-len(values) // 4 :].mean(), padded))
    frequencies = np.fft.rfftfreq(padded, period)
    spectrum[(frequencies <= lowest) | (frequencies >= highest)] = 0.0
    peak = np.clip(frequencies[np.argmax(spectrum)], 1.001 * lowest, 0.999 * highest)
    starts = [np.log([ratio, 2 * np.pi * peak]) for ratio in (0.01, 0.03, 0.1, 0.3)]
    best = min(starts, key=lambda x: np.sum(residuals(x) ** 2))
    ends = np.log([(MIN_DECAY_RATIO, 2 * np.pi * lowest), (MAX_DECAY_RATIO, 2 * np.pi * highest)])
    fit = least_squares(residuals, best, x_scale=0.1, bounds=ends)
    # Leave out glitches, and fit again.
    residual_sizes = np.abs(fit.fun)
    envelope_now = np.hypot(*weights(fit.x)[:2])
    envelope_now = envelope_now * np.exp(-np.exp(fit.x.sum()) * since[is_read])
    # Where the limb swings far it differs from a sinusoid by more than noise.
    is_used[is_read] = (
        residual_sizes
        <= OUTLIER_DEVIATIONS * 1.48 * np.median(residual_sizes)
        + OUTLIER_SWING_SHARE * envelope_now
    )
    fit = least_squares(residuals, fit.x, x_scale=0.1, bounds=ends)

    ratio, omega = np.exp(fit.x)
    decay = ratio * omega
    sine, cosine, offset = weights(fit.x)
    amplitude = np.hypot(sine, cosine)
    rms = np.sqrt(np.mean(fit.fun**2))
    if not amplitude > 3 * rms or np.isclose(fit.x, ends, rtol=0.0, atol=1e-3).any():
        raise CalibrationError(
            f"No oscillation between {lowest:.3g} Hz and {highest:.3g} Hz stands out after "
            f"{time[start]:.2f} s: its amplitude would be {amplitude:.3g}, compared with residuals "
            f"of {rms:.3g}."
        )
    # Standard errors, and the parameters in the usual form.
    # Of the decay's logarithm, which is the sum of both.
    error = np.sqrt(np.linalg.pinv(fit.jac.T @ fit.jac).sum()) * rms
    natural = np.hypot(decay, omega)
    return DampedSinusoid(
        damping_ratio=float(decay / natural),
        natural_frequency=float(natural),
        amplitude=float(amplitude),
        offset=float(offset),
        start=float(time[start]),
        decay_rate=Estimate(float(decay), float(error * decay), "1/s"),
        residual=float(rms),
    )


def _release_index(signal: np.ndarray) -> int:
    """Return the first sample of fast motion; a glitch of one sample is none."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(signal, 1, mode="edge"), 3)
    pace = np.abs(np.diff(np.median(around, axis=1)))
    return int(np.argmax(pace > RELEASE_PACE_SHARE * pace.max()))


def fit_damping(parameters: LimbParameters, recordings: Sequence[Recording]) -> DampingFit:
    """Fit σ, with which the model rings down as the limb does, fitData of Algorithm 1.

    Args:
        parameters: the limb, with its calibrated stiffness.
        recordings: passive oscillation after a release from about 45°; the
            hold before may be part of them.

    Raises:
        CalibrationError: if there is no ring-down, or no σ explains it.
    """
    if not recordings:
        raise CalibrationError("There is no recording of a ring-down.")
    # Fit each trial; trials scatter.
    fits = [_fit_recording(parameters, recording) for recording in recordings]
    values, trial_errors, measured, simulated = zip(*fits, strict=True)
    # Trials scatter at least by the noise in each.
    error = float(np.sqrt(np.mean(np.square(trial_errors)) / len(values)))
    if len(values) > 1:
        error = max(error, standard_error(np.array(values)))
    estimate = Estimate(float(np.mean(values)), error, "N·m·s/rad")
    remarks = remarks_on_estimate("the damping", estimate)
    # Compare the frequencies of limb and model.
    ratios = [m.frequency / s.frequency for m, s in zip(measured, simulated, strict=True)]
    worst_index = int(np.argmax(np.abs(np.log(ratios))))
    if not 1 / MAX_FREQUENCY_RATIO < ratios[worst_index] < MAX_FREQUENCY_RATIO:
        raise CalibrationError(
            f"The limb rings at {measured[worst_index].frequency:.2f} Hz, but its model with this "
            f"stiffness at {simulated[worst_index].frequency:.2f} Hz; look at mass and length in "
            "the description, at the sag, and whether the ring-down's times are right."
        )
    if abs(np.mean(ratios) - 1) > 0.05:
        sentence = (
            f"The limb rings at {measured[0].frequency:.2f} Hz, its model with the spring constant "
            f"of the sag at {simulated[0].frequency:.2f} Hz: rubber is stiffer in fast motion, or "
            "mass or sag are off; weigh the limb."
        )
        remarks.append(Remark("ringing", sentence))
    if any(fit.residual > 0.15 * fit.amplitude for fit in measured):
        sentence = "The ring-down is far from a damped sinusoid; release the limb in one move."
        remarks.append(Remark("ringing", sentence))
    return DampingFit(estimate, measured, simulated, remarks)


def _fit_recording(parameters, recording: Recording):
    """Return σ and its standard error, and the sinusoids of limb and model."""
    recording.check_plausible()
    sensor = bend_sensor_of(recording)
    # The bend along the direction of the release, a unit vector (F,).
    direction = np.ones(1)
    gravity = [0.0, 0.0, 0.0]
    if len(recording.bend_angle) > 1:
        gravity = recording.parameters.gravity
        bends = np.array([fill_gaps(recording.time, bend) for bend in recording.bend_angle])
        deviations = bends - np.median(bends[:, -MIN_SAMPLES // 2 :], axis=1, keepdims=True)
        widest_deviation = deviations[:, np.argmax(np.linalg.norm(deviations, axis=0))]
        direction = widest_deviation / max(np.linalg.norm(widest_deviation), 1e-9)
    measured_bend = direction @ recording.bend_angle
    signal = fill_gaps(recording.time, measured_bend)
    if len(signal) < MIN_SAMPLES or not np.ptp(signal) > 0:
        fit_damped_sinusoid(recording.time, signal)  # which says so
    # Find the release, and how far the limb was bent.
    release = _release_index(signal)
    held_level = np.median(signal[max(0, release - 4) : release + 1])
    released = float(abs(held_level - np.median(signal[-MIN_SAMPLES // 2 :])) / sensor.gain)
    duration = recording.time[-1] - recording.time[release]
    rate = max(MODEL_RATE, recording.sample_rate)
    num_steps = max(1, round(duration * rate))

    # The model of the cold limb rings down with a given σ.
    def ring_down(damping: float, released: float) -> DampedSinusoid:
        # Mount the limb as it was recorded, with cold wires.
        limb = copy.deepcopy(parameters)
        limb.gravity = list(gravity)
        limb.segments[0].damping = float(damping)
        for wire in limb.wires:  # they stay cold, and laws with memory take four times as long
            wire.law = LinearLaw()
        # Release it at rest from where it was bent.
        swing = joint_angles_from_bend_angle(limb, released * direction)
        model = LimbModel.of(limb)
        start = np.append(model.mechanics.rest_angles + swing, np.zeros(len(swing)))
        times = np.arange(num_steps + 1) / rate
        still = MotionSteps(
            times, np.tile(start, (num_steps, 1)), np.zeros((num_steps, len(NODES), len(swing)))
        )
        dynamics = model.dynamics
        cold = np.tile(dynamics.wires.cold_states, (num_steps, len(NODES), 1))
        motion = solve_steps(
            dynamics.by_motion.values,
            dynamics.by_motion.dense_slopes,
            still,
            cold,
            np.repeat([ANGLE_SCALE, 1.0], len(swing)),
        )
        # Fit what the sensor shows of it.
        angles = motion.start[:, : len(swing)].T
        bends = sensor.apparent_bends(limb.segments[0].chain, angles)
        return fit_damped_sinusoid(times[:-1], direction @ bends)

    # Fit the sinusoid near the model's frequency.
    described = ring_down(only_segment(parameters).damping, released)
    if recording.sample_rate < MIN_SAMPLES_PER_PERIOD * described.frequency:
        raise CalibrationError(
            f"The ring-down was recorded at {recording.sample_rate:g} Hz, but the limb's model "
            f"rings at {described.frequency:.1f} Hz; record it at "
            f"{np.ceil(2 * MIN_SAMPLES_PER_PERIOD * described.frequency):.0f} Hz or more."
        )
    factor = np.sqrt(MAX_STIFFNESS_RATIO)  # of frequencies, for k
    band = described.frequency / factor, described.frequency * factor
    measured = fit_damped_sinusoid(recording.time, measured_bend, band)
    # Decay is about proportional to σ.
    logarithm = np.log(only_segment(parameters).damping)
    model = described
    step = 0.0
    slope = 1.0
    previous_mismatch = 0.0
    for _ in range(MAX_DAMPING_STEPS):
        mismatch = np.log(model.decay_rate.value / measured.decay_rate.value)
        if abs(step) > 10 * DECAY_TOLERANCE:
            slope = (mismatch - previous_mismatch) / step
        is_converged = (
            abs(mismatch) < DECAY_TOLERANCE and abs(measured.amplitude / model.amplitude - 1) < 0.01
        )
        if is_converged or not 0.2 < slope < 5.0:
            break
        step = -mismatch / slope
        previous_mismatch = mismatch
        logarithm += step
        released = min(released * measured.amplitude / model.amplitude, MAX_RELEASE_BEND)
        try:
            model = ring_down(np.exp(logarithm), released)
        except LimbError:
            break
    if abs(mismatch) >= DECAY_TOLERANCE:
        raise CalibrationError(
            f"No damping constant near {np.exp(logarithm):.2g} N·m·s/rad makes the model decay "
            f"with {measured.decay_rate.value:.2f} 1/s as the limb does."
        )
    damping = float(np.exp(logarithm))
    relative = measured.decay_rate.standard_error / measured.decay_rate.value / slope
    return damping, damping * relative, measured, model


def with_ringing(fit: StiffnessFit, damping: DampingFit) -> StiffnessFit:
    """Return a fit with k by sag and ring-down together, weighted by their variances.

    k follows from the square of the ring-down's frequency. Rubber is stiffer in a ring-down than in
    a sag by `FAST_STIFFENING` ± `FAST_STIFFENING_ERROR`. If the two estimates of k differ by more
    than chance, the standard error of k is larger by as much.

    Args:
        fit: k by the sag.
        damping: ring-downs of the limb, and of the model with this k.
    """
    # log k by the ring-down, relative to log k by the sag.
    pairs = zip(damping.measured, damping.simulated, strict=True)
    ratios = np.array([2 * np.log(m.natural_frequency / s.natural_frequency) for m, s in pairs])
    scatter = standard_error(ratios) if len(ratios) > 1 else RING_DOWN_ERROR
    error = fit.by_sag.standard_error / fit.by_sag.value
    # Weight both by their precisions, and widen if they disagree.
    precisions = 1 / np.array([error**2, FAST_STIFFENING_ERROR**2 + scatter**2])
    log_difference = float(ratios.mean() - np.log(1 + FAST_STIFFENING))  # of the logarithms of k
    total = precisions.sum()
    widening = max(1.0, abs(log_difference) / (1.96 * float(np.sqrt((1 / precisions).sum()))))
    k = float(fit.by_sag.value * np.exp(precisions[1] / total * log_difference))
    combined = Estimate(k, float(k * widening / np.sqrt(total)), fit.by_sag.unit)
    return dataclasses.replace(fit, stiffness=combined)


def remarks_on_sensor(
    limb: LimbParameters, sags: Sequence[Recording], stiffness: StiffnessFit, damping: DampingFit
) -> list[Remark]:
    """Return a remark if sag and ring-down agree with another bend sensor than the header names.

    The frequency follows from k and the mass, whatever the sensor. The sag gives k by what
    the sensor shows: a tip tangent that is taken for a chord makes k half as large again.

    Args:
        limb: the calibrated limb.
        sags: recordings of its sag.
        stiffness, damping: the fits.
    """
    header_sensor = bend_sensor_of(sags[0])
    alternatives = {TipTangentSensor: ChordSensor, ChordSensor: TipTangentSensor}
    if type(header_sensor) not in alternatives:
        return []
    alternative = alternatives[type(header_sensor)](**dataclasses.asdict(header_sensor))
    # k, and the frequency with it, if the sensor were the other kind.
    limbs = [_mounted(limb, r.parameters.gravity, r.parameters.payload) for r in sags]
    try:
        k = _stiffness_of_sags(limbs, alternative, stiffness.sags, 0.0)[0].value
    except CalibrationError:
        return []
    measured = damping.measured[0].frequency
    simulated = damping.simulated[0].frequency
    expected = simulated * np.sqrt(k / stiffness.by_sag.value)
    mismatch = abs(np.log(measured / simulated))
    alternative_mismatch = abs(np.log(measured / expected))
    if mismatch < MAX_SENSOR_MISMATCH or alternative_mismatch > mismatch / 2:
        return []
    return [
        Remark(
            "sensor",
            f"The limb rings at {measured:.2f} Hz; its sag makes that {simulated:.2f} Hz if the "
            f"bend was read by {type(header_sensor).__name__}, as the header says, and "
            f"{expected:.2f} Hz if by {type(alternative).__name__}: correct the header's "
            "bend_sensor, or else the mass and the length.",
        )
    ]
