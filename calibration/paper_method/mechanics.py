"""Stiffness from the sag under gravity (Sec. V-A), and damping from a ring-down (Sec. V-B)."""

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from calibration.estimate import Estimate, pooled_spread, standard_error
from calibration.recordings.kinds import bend_sensor_of, only_segment, title_of
from calibration.recordings.repair import filled, part
from calibration.remarks import CalibrationError, Remark, remarks_on_estimate
from limb_systems import (
    BendSensor,
    ChordSensor,
    Limb,
    LimbError,
    LimbModel,
    LimbParameters,
    LinearLaw,
    Recording,
    TipTangentSensor,
    joint_angles_from_bend_angle,
    simulate,
)
from limb_systems.bend_sensor import chord_angle
from limb_systems.kinematics import rest_joint_angles
from limb_systems.simulation import swing_accuracy
from limb_systems.statics import static_equilibrium

RESTING_TIME = 5.0  # s at the end of a recording that count as equilibrium
MOST_OFF = 10.0  # factor between the described stiffness and that of any such limb
OFF_SENSOR = 0.15  # logarithm of frequencies, beyond which the sensor is in doubt
STILL = np.deg2rad(1.0)  # by which the bend angle may move in that time
GRAVITY = 9.81  # m/s²
# Sag under a payload, if it grew in proportion; in truth it is some 15°, far beyond a sensor's
# drift, and rubber hardly stiffens.
SAG = np.deg2rad(18.0)
OWN_SAG = 5.0  # times the drift of the bend sensor: ten trials then tell k to 6%
GAIN_ERROR = 0.02  # standard error of a bend sensor's gain, ours: two degrees at a right angle
# Share by which a limb is stiffer in a ring-down than in a sag, and its standard error, ours:
# silicones relax by some 5 to 15% within seconds, and cold wires need not follow fast motions.
FAST, FAST_ERROR = 0.10, 0.06
RING_DOWN_ERROR = 0.05  # standard error of k by a single ring-down
WELL_KNOWN = 0.05  # share of k, to which gaits and loads need it
SCATTER = 0.2  # share of k by which trials may leave it unknown: as a mounting 2° off of 10° does
RIGID = 100.0  # times the described stiffness, with which limbs sag in proportion to their weight

MODEL_RATE = 100.0  # Hz, at least, of the model's ring-down
FEWEST = 20  # samples of a ring-down
PER_PERIOD = 3.0  # samples, below which noise and an alias of the oscillation look alike
MOVING = 0.5  # of the fastest motion, from which on a limb counts as released
OUTLIER, UNLIKE = 6.0, 0.3  # robust standard deviations, and share of the swing, of a glitch
LEAST_DECAY, MOST_DECAY = 1e-4, 1.0  # decay rate over angular frequency of what rings
OFF = 2.0  # factor between the frequencies of limb and model, beyond which one of them is wrong
MOST_RELEASED = np.pi / 2  # rad, of the model's release
STEPS, ALIKE = 8, 1e-3  # of the search for σ, and relative difference of decays at its end


@dataclasses.dataclass(frozen=True, eq=False)
class StiffnessFit:
    """The spring constant of each joint, from a limb that sags.

    - ``stiffness``: k, N·m/rad; by sag and ring-down together after `with_ringing`.
    - ``by_sag``: k by the sag alone.
    - ``correction_factor``: λ of eqn (9), without unit, for φ^eq as the bend sensor shows it.
    - ``chord_factor``: λ of the same sag for φ^eq of the chord, which the paper has: 1.22 of a
      sag by 10° of five links. A tip tangent's α/2 is two thirds of the chord's angle.
    - ``sags``: φ^eq of each trial (K,), rad, signed as gravity, as recorded.
    - ``simulated_sags``: what its bend sensor would show of the limb with ``by_sag`` in each trial
      (K,), rad.
    - ``remarks``: sentences on what the data lack.
    """

    stiffness: Estimate
    by_sag: Estimate
    correction_factor: float
    chord_factor: float
    sags: np.ndarray
    simulated_sags: np.ndarray
    remarks: list[Remark]

    @property
    def factor_in_words(self) -> str:
        """λ, and what it is by the chord, as in the paper, if the sensor shows another angle."""
        said = f"λ = {self.correction_factor:.3f}"
        if abs(self.chord_factor / self.correction_factor - 1) < 0.02:
            return said
        return (
            f"{said} of the bend that the sensor shows; of the chord's angle, as in the paper, the "
            f"same sag has {self.chord_factor:.2f}"
        )


def shape_factors(links: int, load: float = 0.0) -> np.ndarray:
    """b_i of eqn (9), (links,): the shares of the joints in a sag.

    The denominator is Σ (N - j + 1)², not Σ (N - j)² as printed.

    Args:
        load: payload at the tip over the mass of a link.
    """
    beyond = np.arange(links, 0, -1.0)
    torques = beyond**2 + 2 * load * beyond
    return torques / torques.sum()


def sag_payload(described: LimbParameters, enough: float = OWN_SAG) -> float:
    """Return the payload with which to record the sag of a planar limb, kg.

    It is zero if the limb's own sag is ``enough``, and else bends the limb by some 15°.

    Args:
        described: the limb, of one segment, with the stiffness that is expected of it.
        enough: own sag over the drift of the bend sensor, from which on no payload is needed.
    """
    segment = only_segment(described)
    sensor, k = segment.bend_sensor, segment.stiffness
    loads = (described.payload, described.payload + segment.mass)
    limbs = [_mounted(described, [0.0, GRAVITY, 0.0], load) for load in loads]
    own, loaded = (_compliance(limb, sensor) / k / sensor.gain for limb in limbs)
    if own >= min(enough * sensor.drift / sensor.gain, SAG):
        return 0.0
    return float(f"{(SAG - own) / (loaded - own) * segment.mass:.2g}")


def further_sag(limb: LimbParameters, stiffness: Estimate | None) -> str:
    """The recording of a planar limb's sag that tells most of k, in words; empty if k is known.

    Args:
        limb: the limb, with the stiffness that is known.
        stiffness: k as it was calibrated; None if there is no recording of the sag.
    """
    if stiffness and stiffness.standard_error <= WELL_KNOWN * stiffness.value:
        return ""
    load = sag_payload(limb, np.inf if stiffness else OWN_SAG)
    by = f" with {1000 * load:.3g} g at the tip (payload: {load:g} in its header)" if load else ""
    return f"record the sag under gravity{by}, to one side and to the other, which tells k"


def fit_stiffness(
    parameters: LimbParameters, recordings: Sequence[Recording], rest_error: float = 0.0
) -> StiffnessFit:
    """k of Sec. V-A, by which the limb's equilibria under gravity are those of the recordings.

    Recordings of the same mounting are averaged. k and the rest angle are fitted by least
    squares to what the bend sensor shows in each mounting; of one mounting that is what the
    iteration of Sec. V-A leads to. λ of eqn (9) is that of the first recording. The standard error
    contains that of the trials, of the rest angle and of the sensor's gain.

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
    for recording in recordings:
        recording.check_plausible()
    recordings = [part(recording, ~recording.missing) for recording in recordings]
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
    stiffness, described = estimate.value, only_segment(parameters).stiffness
    if not described / MOST_OFF < stiffness < described * MOST_OFF:
        largest = np.abs(sensor.corrected(sags) - only_segment(parameters).rest_angle).max()
        raise CalibrationError(
            f"A sag of {np.rad2deg(largest):.1f}° makes the stiffness {stiffness:.2g} N·m/rad, "
            f"where the description has {described:.2g} N·m/rad; look at mass, length and payload "
            "in the description, and at what the bend sensor reads while the limb is straight."
        )
    remarks = []
    if len(sags) < 3:
        sentence = (
            f"Only {len(sags)} trial{'s' * (len(sags) > 1)} of the sag: mounting and sensor differ "
            "by about 2° from trial to trial, so record ten."
        )
        remarks.append(Remark("few", sentence))
    remarks += remarks_on_estimate("the stiffness", estimate)
    simulated = np.array([_sag(limb, sensor, stiffness, rest)[0] for limb in limbs])
    held, segment = _sag(limbs[0], sensor, stiffness, rest)[1], only_segment(limbs[0])
    at_rest = joint_angles_from_bend_angle(limbs[0], [rest])
    shape = shape_factors(segment.links, limbs[0].payload / segment.mass * segment.links)
    shown, chord = (float(of(held)) - rest for of in (sensor.exact_bend_angle, chord_angle))
    correction = float(shape @ (held - at_rest) / (shape @ shape) / shown)
    return StiffnessFit(
        estimate, estimate, correction, correction * shown / chord, sags, simulated, remarks
    )


def _stiffness_of_sags(
    limbs: Sequence[LimbParameters], sensor: BendSensor, sags: np.ndarray, rest_error: float
) -> tuple[Estimate, float]:
    """k and the rest angle, rad, from the sags (K,), rad, that a sensor showed of mounted limbs."""
    loads = np.array([[*limb.gravity, limb.payload] for limb in limbs])
    _, first, group = np.unique(loads.round(9), axis=0, return_index=True, return_inverse=True)
    counts = np.bincount(group)
    # Of means: in a fit to each trial their scatter would count as sag, and k be too small.
    means = np.bincount(group, sags) / counts
    kinds, rest = [limbs[index] for index in first], only_segment(limbs[0]).rest_angle
    compliances = np.array([_compliance(limb, sensor) for limb in kinds])
    away = means - sensor.apparent_bend_angle(rest_joint_angles(limbs[0]))
    if not (counts * compliances) @ away > 0:
        heaviest = np.argmax(np.abs(compliances))
        raise CalibrationError(
            f"The limb sags by {np.rad2deg(away[heaviest] / sensor.gain):.1f}° where gravity along "
            f"E2 is {kinds[heaviest].gravity[1]:g} m/s²: it bends upwards. Is the bend sensor "
            "reversed, or gravity in the header?"
        )
    softness = (counts * compliances) @ away / ((counts * compliances) @ compliances)
    # Trials that are all the same say nothing of the sensor's drift.
    spread = sensor.drift
    if np.ptp(scatter := sags - means[group]) > 1e-9:
        spread = pooled_spread(scatter, len(counts))
    weights = np.sqrt(counts) / max(spread, 1e-9)

    def residuals(unknown: np.ndarray) -> np.ndarray:
        k, angle = np.exp(unknown[0]), rest + rest_error * unknown[1]
        shown = [_sag(limb, sensor, k, angle)[0] for limb in kinds]
        return np.append(weights * (shown - means), unknown[1])

    try:
        fit = least_squares(residuals, [-np.log(softness), 0.0], x_scale=[0.1, 1.0])
    except LimbError as error:
        raise CalibrationError(
            f"No spring constant explains a sag of {np.rad2deg(np.abs(away).max()):.1f}° with "
            f"this mass and length: {error}"
        ) from error
    of_trials = np.linalg.inv(fit.jac.T @ fit.jac)[0, 0]
    k, angle = float(np.exp(fit.x[0])), float(rest + rest_error * fit.x[1])
    return Estimate(k, k * float(np.hypot(np.sqrt(of_trials), GAIN_ERROR)), "N·m/rad"), angle


def _mounted(
    parameters: LimbParameters, gravity: Sequence[float], payload: float
) -> LimbParameters:
    mounted = copy.deepcopy(parameters)
    mounted.gravity, mounted.payload = list(gravity), payload
    return mounted


def _sag(
    mounted: LimbParameters, sensor: BendSensor, stiffness: float, rest: float | None = None
) -> tuple[float, np.ndarray]:
    """What a sensor shows of a limb at rest, rad, and its joint angles (n,)."""
    limb = copy.deepcopy(mounted)
    segment = only_segment(limb)
    segment.stiffness = stiffness
    segment.rest_angle = segment.rest_angle if rest is None else rest
    held, _ = static_equilibrium(limb)
    return float(sensor.apparent_bend_angle(held)), held


def _compliance(mounted: LimbParameters, sensor: BendSensor) -> float:
    """Sag times k of a limb that hardly sags, as a sensor shows it, N·m."""
    stiff = RIGID * only_segment(mounted).stiffness
    shown, _ = _sag(mounted, sensor, stiff)
    return stiff * (shown - float(sensor.apparent_bend_angle(rest_joint_angles(mounted))))


def _resting_angle(recording: Recording) -> float:
    """Mean bend angle over the end of a recording, rad."""
    last = recording.time >= recording.time[-1] - RESTING_TIME
    angle = recording.bend_angle[0, last]
    first, second = np.array_split(angle, 2)
    drifts = abs(first.mean() - second.mean())
    swings = np.median(np.abs(angle - np.median(angle)))
    if drifts > STILL or swings > max(STILL, 2 * bend_sensor_of(recording).noise):
        raise CalibrationError(
            f"The limb does not rest at the end of {title_of(recording)}: its bend still moves by "
            f"{np.rad2deg(max(drifts, swings)):.1f}°."
        )
    return float(angle.mean())


@dataclasses.dataclass(frozen=True, eq=False)
class DampedSinusoid:
    """A exp(-ζ ω t) sin(ω √(1 - ζ²) t + ϕ) + b, fitted to a signal from ``start`` on.

    - ``damping_ratio``: ζ.
    - ``natural_frequency``: ω, rad/s.
    - ``amplitude``, ``phase``, ``offset``: A, ϕ, b at t = 0, the start.
    - ``start``: time at which the fit starts, s.
    - ``decay_rate``: ζ ω with its standard error, 1/s.
    - ``residual``: root mean square of the deviations, in the unit of the signal.
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
        """Frequency of the damped oscillation, Hz."""
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
    - ``simulated``: the sinusoid of the model with this σ, for each recording, as the
      recording's bend sensor would show it.
    - ``time``, ``bend_angle``: the first recording (K,), s and rad.
    - ``remarks``: sentences on what the data lack.
    """

    damping: Estimate
    measured: list[DampedSinusoid]
    simulated: list[DampedSinusoid]
    time: np.ndarray
    bend_angle: np.ndarray
    remarks: list[Remark]


def fit_damped_sinusoid(
    time: ArrayLike, signal: ArrayLike, band: tuple[float, float] = (0.0, np.inf)
) -> DampedSinusoid:
    """fitDS of Algorithm 1: a damped sinusoid with an offset, by least squares.

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
        CalibrationError: if the signal does not oscillate.
    """
    time, signal = np.asarray(time, float), np.asarray(signal, float)
    if time.shape != signal.shape or len(time) < FEWEST:
        raise CalibrationError(f"A ring-down needs at least {FEWEST} samples, and a time for each.")
    shown = ~np.isnan(signal)
    signal = filled(time, signal)
    if not np.ptp(signal) > 0:
        raise CalibrationError("The signal does not move; there is no ring-down in it.")
    period = (time[-1] - time[0]) / (len(time) - 1)
    start = _passing(signal, _release(signal))
    since, values = time[start:] - time[start], signal[start:]
    if len(values) < FEWEST:
        raise CalibrationError(
            f"The signal moves fastest at {time[start]:.2f} s, at its end; there is no ring-down "
            "after it."
        )
    shown = shown[start:]
    good = shown.copy()

    lowest, highest = max(band[0], 1.0 / since[-1]), min(band[1], 0.5 / period)
    if not lowest < highest:
        raise CalibrationError(
            f"The ring-down lasts {since[-1]:.2f} s at {1 / period:.3g} Hz, which shows no "
            f"oscillation of {band[0]:.3g} Hz to {band[1]:.3g} Hz."
        )

    def basis(logarithms: np.ndarray) -> np.ndarray:
        ratio, turning = np.exp(logarithms)
        envelope = np.exp(-ratio * turning * since)
        waves = [envelope * np.sin(turning * since), envelope * np.cos(turning * since)]
        return np.column_stack([*waves, np.ones_like(since)])

    def weights(logarithms: np.ndarray) -> np.ndarray:
        return np.linalg.lstsq(basis(logarithms)[good], values[good], rcond=None)[0]

    def residuals(logarithms: np.ndarray) -> np.ndarray:
        return basis(logarithms)[good] @ weights(logarithms) - values[good]

    # Several starts around the peak of the spectrum; the best fit is taken.
    padded = 8 * len(values)
    spectrum = np.abs(np.fft.rfft(values - values[-len(values) // 4 :].mean(), padded))
    frequencies = np.fft.rfftfreq(padded, period)
    spectrum[(frequencies <= lowest) | (frequencies >= highest)] = 0.0
    peak = np.clip(frequencies[np.argmax(spectrum)], 1.001 * lowest, 0.999 * highest)
    starts = [np.log([ratio, 2 * np.pi * peak]) for ratio in (0.01, 0.03, 0.1, 0.3)]
    best = min(starts, key=lambda x: np.sum(residuals(x) ** 2))
    ends = np.log([(LEAST_DECAY, 2 * np.pi * lowest), (MOST_DECAY, 2 * np.pi * highest)])
    fit = least_squares(residuals, best, x_scale=0.1, bounds=ends)
    away, swing = np.abs(fit.fun), np.hypot(*weights(fit.x)[:2])
    swing = swing * np.exp(-np.exp(fit.x.sum()) * since[shown])
    # Where the limb swings far it differs from a sinusoid by more than noise.
    good[shown] = away <= OUTLIER * 1.48 * np.median(away) + UNLIKE * swing
    fit = least_squares(residuals, fit.x, x_scale=0.1, bounds=ends)

    ratio, turning = np.exp(fit.x)
    decay = ratio * turning
    sine, cosine, offset = weights(fit.x)
    amplitude, rms = np.hypot(sine, cosine), np.sqrt(np.mean(fit.fun**2))
    if not amplitude > 3 * rms or np.isclose(fit.x, ends, rtol=0.0, atol=1e-3).any():
        raise CalibrationError(
            f"No oscillation between {lowest:.3g} Hz and {highest:.3g} Hz stands out after "
            f"{time[start]:.2f} s: its amplitude would be {amplitude:.3g}, compared with residuals "
            f"of {rms:.3g}."
        )
    # Of the decay's logarithm, which is the sum of both.
    error = np.sqrt(np.linalg.pinv(fit.jac.T @ fit.jac).sum()) * rms
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


def _release(signal: np.ndarray) -> int:
    """The first sample of fast motion; a glitch of one sample is none."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(signal, 1, mode="edge"), 3)
    pace = np.abs(np.diff(np.median(around, axis=1)))
    return int(np.argmax(pace > MOVING * pace.max()))


def _passing(signal: np.ndarray, release: int) -> int:
    """The first sample after the release on the other side of the final level than before."""
    level = np.median(signal[release + 3 * (len(signal) - release) // 4 :])
    side = np.sign(np.median(signal[max(0, release - 4) : release + 1]) - level)
    beyond = np.flatnonzero(side * (signal[release:] - level) < 0)
    return release + int(beyond[0]) if len(beyond) else release


def fit_damping(parameters: LimbParameters, recordings: Sequence[Recording]) -> DampingFit:
    """fitData of Algorithm 1: σ with which the model rings down like the limb.

    Args:
        parameters: the limb, with its calibrated stiffness.
        recordings: passive oscillation after a release from about 45°; the
            hold before may be part of them.

    Raises:
        CalibrationError: if there is no ring-down, or no σ explains it.
    """
    if not recordings:
        raise CalibrationError("There is no recording of a ring-down.")
    fits = [_fit_recording(parameters, recording) for recording in recordings]
    values = np.array([value for value, _, _, _ in fits])
    within = np.array([error for _, error, _, _ in fits])
    # Trials scatter at least by the noise in each.
    error = float(np.sqrt(np.mean(within**2) / len(values)))
    if len(values) > 1:
        error = max(error, standard_error(values))
    measured, simulated = [fit[2] for fit in fits], [fit[3] for fit in fits]
    remarks = []
    ratios = [m.frequency / s.frequency for m, s in zip(measured, simulated, strict=True)]
    worst = int(np.argmax(np.abs(np.log(ratios))))
    if not 1 / OFF < ratios[worst] < OFF:
        raise CalibrationError(
            f"The limb rings at {measured[worst].frequency:.2f} Hz, but its model with this "
            f"stiffness at {simulated[worst].frequency:.2f} Hz; look at mass and length in the "
            "description, at the sag, and whether the ring-down's times are right."
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
    estimate = Estimate(float(values.mean()), error, "N·m·s/rad")
    remarks += remarks_on_estimate("the damping", estimate)
    first = recordings[0]
    return DampingFit(estimate, measured, simulated, first.time, _swing(first)[1], remarks)


def _swing(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Direction in which the limb was released, unit (F,), and the bend along it (K,), rad."""
    if len(recording.bend_angle) == 1:
        return np.ones(1), recording.bend_angle[0]
    bends = np.array([filled(recording.time, bend) for bend in recording.bend_angle])
    away = bends - np.median(bends[:, -FEWEST // 2 :], axis=1, keepdims=True)
    widest = away[:, np.argmax(np.linalg.norm(away, axis=0))]
    towards = widest / max(np.linalg.norm(widest), 1e-9)
    return towards, towards @ recording.bend_angle


def _fit_recording(parameters, recording: Recording):
    """σ and its standard error, and the sinusoids of limb and model."""
    recording.check_plausible()
    sensor, (towards, seen_angle) = bend_sensor_of(recording), _swing(recording)
    signal = filled(recording.time, seen_angle)
    gravity = recording.parameters.gravity if len(towards) > 1 else [0.0, 0.0, 0.0]
    if len(signal) < FEWEST or not np.ptp(signal) > 0:
        fit_damped_sinusoid(recording.time, signal)  # which says so
    release = _release(signal)
    held = np.median(signal[max(0, release - 4) : release + 1])
    released = float(abs(held - np.median(signal[-FEWEST // 2 :])) / sensor.gain)
    duration = recording.time[-1] - recording.time[release]
    rate = max(MODEL_RATE, recording.sample_rate)

    def ring_down(damping: float, released: float) -> DampedSinusoid:
        limb = copy.deepcopy(parameters)
        limb.gravity, limb.segments[0].damping = list(gravity), float(damping)
        for wire in limb.wires:  # they stay cold, and laws with memory take four times as long
            wire.law = LinearLaw()
        room = np.full(len(limb.wires), limb.ambient_temperature)
        swing = joint_angles_from_bend_angle(limb, released * towards)
        angles = rest_joint_angles(limb) + swing
        cold = LimbModel.of(limb).wires.cold_states
        state = np.concatenate([angles, np.zeros_like(angles), cold, room])
        model = simulate(
            Limb(limb),
            0 * room,
            duration,
            sample_rate=rate,
            accuracy=swing_accuracy(np.abs(swing).max()),
            initial_state=state,
        )
        assert model.joint_state is not None  # a model's
        seen = sensor.apparent_bends(limb.segments[0].chain, model.joint_state[: limb.num_joints])
        return fit_damped_sinusoid(model.time, towards @ seen)

    described = ring_down(only_segment(parameters).damping, released)
    if recording.sample_rate < PER_PERIOD * described.frequency:
        raise CalibrationError(
            f"The ring-down was recorded at {recording.sample_rate:g} Hz, but the limb's model "
            f"rings at {described.frequency:.1f} Hz; record it at "
            f"{np.ceil(2 * PER_PERIOD * described.frequency):.0f} Hz or more."
        )
    factor = np.sqrt(MOST_OFF)  # of frequencies, for k
    band = described.frequency / factor, described.frequency * factor
    measured = fit_damped_sinusoid(recording.time, seen_angle, band)
    # Decay is about proportional to σ.
    logarithm, model = np.log(only_segment(parameters).damping), described
    moved, slope, last = 0.0, 1.0, 0.0
    for _ in range(STEPS):
        mismatch = np.log(model.decay_rate.value / measured.decay_rate.value)
        if abs(moved) > 10 * ALIKE:
            slope = (mismatch - last) / moved
        alike = abs(mismatch) < ALIKE and abs(measured.amplitude / model.amplitude - 1) < 0.01
        if alike or not 0.2 < slope < 5.0:
            break
        moved, last = -mismatch / slope, mismatch
        logarithm += moved
        released = min(released * measured.amplitude / model.amplitude, MOST_RELEASED)
        try:
            model = ring_down(np.exp(logarithm), released)
        except LimbError:
            break
    if abs(mismatch) >= ALIKE:
        raise CalibrationError(
            f"No damping constant near {np.exp(logarithm):.2g} N·m·s/rad makes the model decay "
            f"with {measured.decay_rate.value:.2f} 1/s as the limb does."
        )
    damping = float(np.exp(logarithm))
    relative = measured.decay_rate.standard_error / measured.decay_rate.value / slope
    return damping, damping * relative, measured, model


def with_ringing(fit: StiffnessFit, damping: DampingFit) -> StiffnessFit:
    """Return a fit with k by sag and ring-down together, weighted by their variances.

    The ring-down tells k by the square of its frequency, of rubber that is stiffer than in a sag by
    `FAST` ± `FAST_ERROR`. If the two differ by more than chance, the standard error of k is larger
    by as much.

    Args:
        fit: k by the sag.
        damping: ring-downs, with those of the model with this k.
    """
    pairs = zip(damping.measured, damping.simulated, strict=True)
    ratios = np.array([2 * np.log(m.natural_frequency / s.natural_frequency) for m, s in pairs])
    scatter = standard_error(ratios) if len(ratios) > 1 else RING_DOWN_ERROR
    k, error = fit.by_sag.value, fit.by_sag.standard_error / fit.by_sag.value
    precisions = 1 / np.array([error**2, FAST_ERROR**2 + scatter**2])
    away = float(ratios.mean() - np.log(1 + FAST))  # of the logarithms of k
    weight, total = precisions[1] / precisions.sum(), precisions.sum()
    beyond = max(1.0, abs(away) / (1.96 * float(np.sqrt((1 / precisions).sum()))))
    k = float(k * np.exp(weight * away))
    both = Estimate(k, float(k * beyond / np.sqrt(total)), fit.by_sag.unit)
    return dataclasses.replace(fit, stiffness=both)


def remarks_on_sensor(
    limb: LimbParameters,
    sags: Sequence[Recording],
    stiffness: StiffnessFit,
    damping: DampingFit,
) -> list[Remark]:
    """A remark if sag and ring-down agree with another bend sensor than the header names.

    The frequency is that of k and the mass, whatever the sensor, and the sag gives k by what
    the sensor shows: a tip tangent that is taken for a chord makes k half as large again.

    Args:
        limb: the calibrated limb.
        sags: recordings of its sag.
        stiffness, damping: the fits.
    """
    named = bend_sensor_of(sags[0])
    others = {TipTangentSensor: ChordSensor, ChordSensor: TipTangentSensor}
    if type(named) not in others:
        return []
    other = others[type(named)](**dataclasses.asdict(named))
    limbs = [_mounted(limb, r.parameters.gravity, r.parameters.payload) for r in sags]
    try:
        k = _stiffness_of_sags(limbs, other, stiffness.sags, 0.0)[0].value
    except CalibrationError:
        return []
    measured, simulated = damping.measured[0].frequency, damping.simulated[0].frequency
    expected = simulated * np.sqrt(k / stiffness.by_sag.value)
    away, less = abs(np.log(measured / simulated)), abs(np.log(measured / expected))
    if away < OFF_SENSOR or less > away / 2:
        return []
    return [
        Remark(
            "sensor",
            f"The limb rings at {measured:.2f} Hz; its sag makes that {simulated:.2f} Hz if the "
            f"bend was read by {type(named).__name__}, as the header says, and {expected:.2f} Hz "
            f"if by {type(other).__name__}: correct the header's bend_sensor, or else the mass "
            "and the length.",
        )
    ]
