"""Heat transfer {a1, a2, a3} of eqns (6)-(7) and force β of a wire, by Secs. V-C1 and V-C2."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from scipy.linalg import expm
from scipy.optimize import OptimizeResult, least_squares

from calibration.estimate import Estimate, clustered_covariance, standard_error
from calibration.recordings.at_rest import first_readings
from calibration.recordings.kinds import bend_sensor_of, only_segment
from calibration.recordings.repair import at_sample_times, with_interpolated_gaps, without_spikes_in
from calibration.remarks import CalibrationError, Remark, remarks_on_estimate, remarks_on_start
from limb_systems import LimbParameters, LinearLaw, Recording, joint_angles_from_bend_angle
from limb_systems.files.signal_table import stretches
from limb_systems.low_pass import low_pass

RATE_UNITS = {"a1": "1/s", "a2": "°C/s", "a3": "1/s"}
MIN_EQUILIBRIUM_TIME = 2.0  # s, least duration of an equilibrium
RESIDUAL_BLOCK_TIME = 30.0  # s, after which residuals count as independent
MIN_BLOCKS = 5
READOUT_DELAY = 0.05, 0.03  # s, mean and deviation where anything up to 0.1 s is as likely
NUM_REWEIGHTINGS = 2
MAX_DELAY = 5.0  # s
# rad and °C of equal weight at first
ANGLE_SCALE = np.deg2rad(1.0)
TEMPERATURE_SCALE = 1.0

# Bounds of the logarithms of -a1, a2 and -a3 in a fit, and of its start.
_LOWEST, _HIGHEST = np.log([[1e-3, 0.1, 0.02], [2.0, 1000.0, 10.0]])
_INNER_LOWEST, _INNER_HIGHEST = np.log([[2e-3, 0.2, 0.05], [1.0, 500.0, 5.0]])
_SIGNS = np.array([-1.0, 1.0, -1.0])
BOUND_MARGIN = 0.01  # by which a logarithm may stay inside its bound and count as at it
# Of equilibria, and of the bend sensor.
BEND_DRIFT_TIME = 120.0  # s, within which a bend sensor's drift changes
STILL_BEND_RATE = np.deg2rad(0.5)  # rad/s, below which φ̇ ≈ 0
STEADY_HEATING_RATE = 0.5  # °C/s, below which Ṫ ≈ 0
MIN_TORQUE_RISE = 10.0  # °C above ambient, below which a torque is hidden by noise


@dataclasses.dataclass(frozen=True, eq=False)
class HeatFit:
    """Heat transfer of one wire, (6)-(7), with the course of its temperature.

    - ``wire``: name of the wire.
    - ``a1``, ``a2``, ``a3``: 1/s, °C/s and 1/s.
    - ``covariance``: covariance of a1, a2 and a3 (3, 3), in the products of their units.
    - ``delay``: time by which readings are later than the duty, s; None if it is
      not fitted. The model has none.
    - ``ambient``: T0 that was used, °C.
    - ``wire_temperature``: simulated T at the samples of the recording (K,), °C.
    - ``temperature_residual``, ``angle_residual``: root mean squares of V and φ, °C and rad.
    - ``remarks``: sentences on what the data lack.
    """

    wire: str
    a1: Estimate
    a2: Estimate
    a3: Estimate
    covariance: np.ndarray
    delay: Estimate | None
    ambient: float
    wire_temperature: np.ndarray
    temperature_residual: float
    angle_residual: float
    remarks: list[Remark]


def simulate_heat(
    law: LinearLaw,
    duty: np.ndarray,
    period: float,
    ambient: float,
    initial: tuple[float, float],
    delay: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return T and V of a wire (K,), °C, by eqns (6)-(7); exact for duty held between samples.

    Args:
        law: law of the wire.
        duty: D (K,), in force at each sample and since the sample before.
        period: s between samples.
        ambient: T0, °C.
        initial: T and V at the first sample, °C.
        delay: s by which duty takes effect later; there was none before the first sample.
    """
    if delay:
        # Its mean over each interval.
        total = np.cumsum(duty) - duty[0]
        ends = np.arange(-1, len(duty)) - delay / period
        duty = np.diff(np.interp(ends, np.arange(len(duty)), total))
    # Of T and V above T0, and D, over one interval.
    rates = np.array([[law.a1, 0.0, law.a2], [-law.a3, law.a3, 0.0], [0.0, 0.0, 0.0]])
    step = expm(rates * period)
    start = np.array(initial) - ambient
    wire = low_pass(np.append(start[0], step[0, 2] * duty[1:]), step[0, 0], 1.0)
    drive = step[1, 0] * wire[:-1] + step[1, 2] * duty[1:]
    reading = low_pass(np.append(start[1], drive), step[1, 1], 1.0)
    return ambient + wire, ambient + reading


def fit_heat_transfer(
    recording: Recording,
    index: int,
    ambient: float,
    ambient_error: float = 0.0,
    *,
    rest_angle: float = 0.0,
) -> HeatFit:
    """Fit a1, a2, a3 of one wire by Sec. V-C1, with wire temperature from the bend.

    At the most promising equilibrium b = (V^eq - T0) / φ^eq, and T = b φ + T0
    throughout. A two-stage collocation gives a start: the smoothed records in
    the integrated (6), (7), which are linear in a1, a2, a3. The refinement
    simulates (6)-(7) and fits them to V and to φ = (T - T0) / b, with b free as
    well. If a recording has the applied duty and the age of its samples, as a
    robot's does, these are used (`at_sample_times`). If not, a pure delay of the
    readings is fitted, too, because it would otherwise be taken for lag. Its
    prior is a delay of up to 0.1 s, which sensors have that are read in turn.

    Args:
        recording: C^r or C^l, in which this wire alone is heated.
        index: index of the wire.
        ambient: T0, °C.
        ambient_error: standard error of T0, °C, as read by this wire's thermocouple.
        rest_angle: from which φ counts, rad.

    Raises:
        CalibrationError: if the wire was never warm or the limb never bent, or if a rate is at
            the bound of its fit, which any wire is within.
    """
    recording.check_plausible()
    # Take readings at their sample times, without spikes and gaps.
    fits_delay = recording.applied_duty is None or recording.sample_age is None
    is_read = ~recording.missing
    recording = with_interpolated_gaps(without_spikes_in(at_sample_times(recording)))
    duty = recording.duty[index]
    readings = recording.measured_temperature[index]
    recording.bend_angle = recording.bend_angle - bend_sensor_of(recording).gain * rest_angle
    bend = recording.bend_angle[0]
    period = 1 / recording.sample_rate
    name = recording.parameters.wire_names[index]
    if not duty.any():
        raise CalibrationError(f"The {name} wire was never heated in this recording.")
    rise = np.percentile(readings, 99) - ambient
    if rise < MIN_TORQUE_RISE:
        raise CalibrationError(
            f"The {name} wire was never warm: at most {rise:.1f} °C above ambient after "
            f"{duty.sum() * period:.1f} s of full duty in all."
        )
    # Estimate T from the bend by the best equilibrium, and start from it.
    angle_eq, measured_eq = _most_promising_equilibrium(recording, index, ambient)
    b = (measured_eq - ambient) / angle_eq
    if abs(angle_eq) < np.deg2rad(3.0):
        raise CalibrationError(
            f"The {name} wire bends the limb by {np.rad2deg(angle_eq):.1f}° where it is "
            f"{measured_eq:.0f} °C; that is too little to estimate its temperature."
        )
    wire_start = b * bend + ambient
    start = _collocate(duty, wire_start, readings, period, ambient)

    # Simulate T, V and φ with x: logarithms of the rates, 1/b, T and V at the start, delay.
    def simulated(x: np.ndarray, room: float):
        delay = x[6] if fits_delay else 0.0
        simulated_wire, simulated_readings = simulate_heat(
            LinearLaw(*_rates(x)), duty, period, room, (x[4], x[5]), delay
        )
        return simulated_wire, simulated_readings, (simulated_wire - room) * x[3]

    def residuals(x: np.ndarray, room: float, weights: tuple[float, float]) -> np.ndarray:
        _, simulated_readings, simulated_bend = simulated(x, room)
        prior = [(x[6] - READOUT_DELAY[0]) / READOUT_DELAY[1]] if fits_delay else []
        return np.concatenate(
            [
                weights[0] * (simulated_readings - readings)[is_read],
                weights[1] * (simulated_bend - bend)[is_read],
                prior,
            ]
        )

    # Fit from the two-stage start, within bounds.
    initial = [first_readings(recording)[index]] * 2
    guess = [*np.clip(np.log(np.abs(start)), _INNER_LOWEST, _INNER_HIGHEST), 1 / b, *initial]
    guess += [0.05] * fits_delay
    scale = [0.1, 0.1, 0.1, 0.1 / abs(b), 1.0, 1.0] + [0.1] * fits_delay
    bounds = (
        [*_LOWEST, -np.inf, -np.inf, -np.inf] + [0.0] * fits_delay,
        [*_HIGHEST, np.inf, np.inf, np.inf] + [MAX_DELAY] * fits_delay,
    )
    since = recording.time - recording.time[0]
    block_time = min(RESIDUAL_BLOCK_TIME, since[-1] / MIN_BLOCKS)
    blocks = (since / block_time).astype(int)[is_read]

    def fit_in(room: float, x: np.ndarray) -> OptimizeResult:
        """Return the fit with T0 at a temperature, °C, from a start."""
        weights = 1 / TEMPERATURE_SCALE, 1 / ANGLE_SCALE
        for _ in range(1 + NUM_REWEIGHTINGS):
            fit = least_squares(residuals, x, args=(room, weights), bounds=bounds, x_scale=scale)
            x = fit.x
            # Weight each signal by the standard deviation of its residuals. A sensor that drifts
            # gets less weight than one with the same noise that does not drift.
            _, heat, angle = simulated(x, room)
            heat_deviation = _independent_deviation((heat - readings)[is_read], blocks)
            angle_deviation = _independent_deviation((angle - bend)[is_read], blocks)
            weights = 1 / heat_deviation, 1 / angle_deviation
        return fit

    fit = fit_in(ambient, np.array(guess))
    simulated_wire, simulated_readings, simulated_bend = simulated(fit.x, ambient)
    # Standard errors by the jackknife over blocks, and by a fit with T0 off by its error.
    clusters = np.tile(blocks, 2)
    count = len(clusters)
    prior = fit.jac[-1] if fits_delay else None
    covariance = clustered_covariance(fit.jac[:count], fit.fun[:count], clusters, prior)
    if ambient_error:
        shift = fit_in(ambient + ambient_error, fit.x).x - fit.x
        covariance += np.outer(shift, shift)
    values = _rates(fit.x)
    value_covariance = covariance[:3, :3] * np.outer(values, values)
    errors = np.abs(values) * np.sqrt(np.diag(covariance)[:3])
    a1, a2, a3 = map(Estimate, values.tolist(), errors.tolist(), RATE_UNITS.values())
    delay = None
    if fits_delay:  # a delay at its bound ends just inside it
        delay = Estimate(round(fit.x[6], 6), float(np.sqrt(covariance[6, 6])), "s")
    return HeatFit(
        wire=name,
        a1=a1,
        a2=a2,
        a3=a3,
        covariance=(value_covariance + value_covariance.T) / 2,  # rounding is not symmetric
        delay=delay,
        ambient=ambient,
        wire_temperature=simulated_wire,
        temperature_residual=_rms((simulated_readings - readings)[is_read]),
        angle_residual=_rms((simulated_bend - bend)[is_read]),
        remarks=[
            *_remarks_on_rates(name, duty, readings - ambient, fit.x, covariance),
            *remarks_on_start(f"the {name} wire", simulated_wire[0], ambient, readings),
        ],
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _rates(x: np.ndarray) -> np.ndarray:
    """Return a1, a2, a3, whose logarithms come first in x."""
    return _SIGNS * np.exp(x[:3])


def _independent_deviation(residual: np.ndarray, blocks: np.ndarray) -> float:
    """Return the standard deviation of independent noise whose block means scatter as much."""
    means = np.array([residual[blocks == block].mean() for block in np.unique(blocks)])
    return max(_rms(residual), _rms(means) * np.sqrt(len(residual) / len(means)))


def _most_promising_equilibrium(recording, index: int, ambient: float) -> tuple[float, float]:
    """Return φ^eq, rad, and V^eq, °C, where V rests and is warm."""
    period = 1 / recording.sample_rate
    width = max(3, int(MIN_EQUILIBRIUM_TIME / period))
    kernel = np.ones(width) / width
    measured = np.convolve(recording.measured_temperature[index], kernel, "valid")
    angle = np.convolve(recording.bend_angle[0], kernel, "valid")
    slope = np.abs(np.gradient(measured, period))
    quality = np.maximum(measured - ambient, 0.0) / (0.1 + slope)
    best = int(np.argmax(np.convolve(quality, kernel, "same")))
    return float(angle[best]), float(measured[best])


def _collocate(duty, wire, measured, period: float, ambient: float) -> tuple[float, float, float]:
    """Return a1, a2, a3 by two-stage collocation: smooth, then least squares in (6), (7)."""
    # Smooth both temperatures, and integrate the equations over a second each, for less noise.
    from scipy.signal import savgol_filter  # takes long to import

    window = 2 * int(1.0 / period) + 1
    wire = savgol_filter(wire - ambient, window, 2)
    measured = savgol_filter(measured - ambient, window, 2)
    stride = max(1, int(1.0 / period))

    def integrate(values: np.ndarray) -> np.ndarray:
        return np.diff(np.cumsum(values)[::stride]) * period

    # Solve the integrated (6) for a1 and a2, and (7) for a3.
    heat = np.column_stack([integrate(wire), integrate(duty)])
    a1, a2 = np.linalg.lstsq(heat, np.diff(wire[::stride]), rcond=None)[0]
    lag = integrate(measured - wire)
    a3 = float(lag @ np.diff(measured[::stride]) / (lag @ lag)) if lag.any() else -1.0
    return min(a1, -1e-3), max(a2, 0.1), min(a3, -0.05)


def _remarks_on_rates(name: str, duty, rise, x, covariance) -> Iterator[Remark]:
    """Yield remarks on fitted rates; raise CalibrationError for a rate at a bound of the fit."""
    at_limit = (duty >= 0.99).mean()
    highest = np.percentile(rise, 99)
    if at_limit > 0.2:
        yield Remark(
            "range",
            f"The duty of the {name} wire is at its limit in {100 * at_limit:.0f}% of the "
            "recording: it says little about how heat depends on duty; record smaller bends as "
            "well.",
        )
    if highest < 30.0:
        yield Remark(
            "range",
            f"The {name} wire is never more than {highest:.0f} °C above ambient; its parameters "
            "hold for that range; record wider bends.",
        )
    for i, rate in enumerate(RATE_UNITS):
        error = np.sqrt(covariance[i, i])  # of the logarithm
        if rate == "a3" and x[i] > _HIGHEST[i] - BOUND_MARGIN:
            yield Remark(
                "lag",
                f"No lag of the {name} thermocouple is seen against the bend: a3 is at the fit's "
                "limit; expect measured temperatures to be late.",
            )
        elif not _LOWEST[i] + BOUND_MARGIN < x[i] < _HIGHEST[i] - BOUND_MARGIN:
            raise CalibrationError(
                f"{rate} of the {name} wire is at the fit's limit of {_rates(x)[i]:.3g}, as its "
                "temperature does not follow its duty; are both of this wire, and does the duty "
                "change often enough?"
            )
        elif error > 0.3:
            yield Remark(
                "unknown" if error > 1.0 else "uncertain",
                f"The recording {'does not determine' if error > 1.0 else 'hardly determines'} "
                f"{rate} of the {name} wire; record more equilibria.",
            )


@dataclasses.dataclass(frozen=True, eq=False)
class ForceFit:
    """Joint torque of one wire per degree, (4).

    - ``wire``: name of the wire.
    - ``beta``: β, N·m/°C, the mean of Γ (13) over the equilibria.
    - ``remarks``: sentences on what the data lack.
    """

    wire: str
    beta: Estimate
    remarks: list[Remark]


def fit_force(
    parameters: LimbParameters, recording: Recording, index: int, heat: HeatFit, stiffness: Estimate
) -> ForceFit:
    """Fit β of one wire, the mean of Γ = k θ^eq / (T^eq - T0) over equilibria, (13).

    Equilibria are where the bend angle and the simulated wire temperature
    rest, each averaged over as long as it rests. Where there are three or more
    above T_warm, only these count, as the model fits better there (Sec. VI).

    Args:
        parameters: the limb; its number of links and the wire's direction
            count.
        recording: C^r or C^l, in which this wire alone is heated.
        index: index of the wire.
        heat: heat transfer of the wire, whose simulated T is used.
        stiffness: k, N·m/rad.

    Raises:
        CalibrationError: if there are no equilibria in it.
    """
    recording.check_plausible()
    is_read = ~recording.missing
    recording = with_interpolated_gaps(without_spikes_in(recording))
    side = only_segment(parameters).wires[index].lever[0]
    # Find equilibria, above T_warm if there are enough.
    starts, ends = _equilibria(recording, is_read, heat, parameters.temperature_limits.warm)
    if len(starts) < 3:
        starts, ends = _equilibria(recording, is_read, heat, heat.ambient + MIN_TORQUE_RISE)
    if len(starts) == 0:
        raise CalibrationError(
            f"The limb never rests while the {heat.wire} wire is warm; hold it longer at each "
            "bend angle."
        )

    # Average over each equilibrium, and compute Γ.
    def means(signal: np.ndarray) -> np.ndarray:
        return np.array([signal[a:b].mean() for a, b in zip(starts, ends, strict=True)])

    times = means(recording.time)
    wire = means(heat.wire_temperature)
    bends = bend_sensor_of(recording).corrected_bends(means(recording.bend_angle[0])[np.newaxis])
    bends = bends - only_segment(parameters).rest_angle
    theta = joint_angles_from_bend_angle(parameters, bends)[0]
    ratios = stiffness.value * theta / (side * (wire - heat.ambient))
    if not ratios.mean() > 0:
        raise CalibrationError(
            f"The {heat.wire} wire bends the limb away from its own side; are the wires swapped or "
            "is the bend sensor reversed?"
        )
    # Errors that all ratios share: of k, and of T^eq - T0 = -a2 D / a1.
    log_slopes = np.array([-1 / heat.a1.value, 1 / heat.a2.value, 0.0])
    shared_variance = log_slopes @ heat.covariance @ log_slopes
    relative = np.sqrt((stiffness.standard_error / stiffness.value) ** 2 + shared_variance)
    mean = float(ratios.mean())
    count = len(ratios)
    # Add the scatter of the equilibria and the sensor's drift.
    remarks = []
    if count < 3:
        sentence = f"Of the {heat.wire} wire there are {count} equilibria; record at least five."
        remarks.append(Remark("few", sentence))
        error = mean * max(relative, 0.1)
    else:
        # The sensor's drift is much the same in equilibria that follow each other.
        shares = ratios / bends[0] / count
        drift_correlation = np.exp(-np.abs(times[:, None] - times) / BEND_DRIFT_TIME)
        drift = bend_sensor_of(recording).drift * np.sqrt(shares @ drift_correlation @ shares)
        error = np.hypot(max(standard_error(ratios), drift), relative * mean)
        if (scatter := ratios.std(ddof=1) / mean) > 0.15:
            sentence = (
                f"The {heat.wire} wire's torque is not proportional to its temperature: β scatters "
                f"by {100 * scatter:.0f}% between equilibria."
            )
            remarks.append(Remark("law", sentence))
    beta = Estimate(mean, float(error), "N·m/°C")
    remarks += remarks_on_estimate(f"β of the {heat.wire} wire", beta)
    return ForceFit(heat.wire, beta, remarks)


def _equilibria(
    recording: Recording, is_read: np.ndarray, heat: HeatFit, warm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and last sample of each stretch of rest, read, with the wire warm, °C."""
    period = 1 / recording.sample_rate
    width = max(3, int(MIN_EQUILIBRIUM_TIME / period))
    kernel = np.ones(width) / width
    angle = np.convolve(recording.bend_angle[0], kernel, "same")
    # The slope between averages over a window each, in which noise hardly counts.
    bend_rate = np.full_like(angle, np.inf)
    half = width // 2
    bend_rate[half:-half] = np.abs(angle[2 * half :] - angle[: -2 * half]) / (2 * half * period)
    heating = np.abs(np.gradient(heat.wire_temperature, period))
    # Rest is where bend and temperature stand still and the wire is warm.
    is_still = (bend_rate < STILL_BEND_RATE) & (heating < STEADY_HEATING_RATE)
    is_resting = is_still & (heat.wire_temperature > warm) & is_read
    is_resting[:width] = is_resting[-width:] = False
    starts, ends = stretches(is_resting).T
    is_long = ends - starts >= width
    return starts[is_long], ends[is_long]
