"""The fit of friction, stiffness, torque and heat to the strides of a robot in the plane.

The duty of a recording and the wires' laws give the heat, whose rates are fitted to the readings.
While a foot slides, its friction is μ times its load, and the balance of forces of `Balance`
determines all angles. The bends measured then identify μ and, of each limb, its stiffness and the
torques of its wires. The fit needs no pose of the body.
"""

import copy
import dataclasses

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import uniform_filter1d

from calibration.estimate import Estimate
from calibration.recordings.repair import fill_gaps
from calibration.remarks import CalibrationError
from limb_systems import LimbModel, Recording
from limb_systems.kinematics import joint_angles_from_bend_angle
from planners.transcription.quasi_static import integrate_readings
from walking.gait import Gait
from walking.gait_check import scale_limb, with_friction
from walking.gait_program import SLIDE_SIGNS
from walking.robot_parameters import RobotParameters
from walking.standing import make_balance
from walking.walker import Walker

MOMENT_SPACING = 0.25  # s, between the moments whose balance counts
SMOOTHING_TIME = 0.25  # s, of bends from which the speed of feet follows
SLIDING_SPEED_SHARE = 0.5  # share of its planned mean speed, from which on a foot counts as sliding
MIN_MOMENTS = 6  # moments
MAX_ITERATIONS = 8
# Relative errors that are expected of the description before the fit.
FRICTION_ERROR = 0.5
STIFFNESS_ERROR = 0.1
TORQUE_ERROR = 0.1
RATE_ERROR = 0.2
UNCALIBRATED_FACTOR = 2.0  # of errors of stiffness and torques, if a limb is not calibrated
BEND_ERROR = np.deg2rad(1.0)  # rad, deviation of bends from the laws in each phase of sliding
READING_ERROR = 2.0  # °C, deviation of readings from the laws
TORQUE_FIELDS = ("beta", "full_torque")  # of the wires' laws, as far as they have them
HEAT_RATE_FIELDS = ("a1", "a2")


@dataclasses.dataclass(frozen=True, eq=False)
class StridesFit:
    """A robot with values that were fitted to its strides.

    - ``robot``: its description with the fitted values.
    - ``estimates``: each fitted value as a multiple of the value before, by name.
    - ``heat``, ``bend``: [x, V] of the wires (N + W,) and φ (F,), rad, at the recording's end.
    - ``made``: share of the planned stride that the last one made; NaN if the body was not seen.
    """

    robot: RobotParameters
    estimates: dict[str, Estimate]
    heat: np.ndarray
    bend: np.ndarray
    made: float = np.nan

    def heat_after(self, pause: float) -> np.ndarray:
        """Return [x, V] of the wires after a pause without duty, s (N + W,)."""
        wires = LimbModel.of(self.robot.as_single_limb).wires
        times = np.linspace(0.0, pause, 2 + int(pause))
        state, reading = np.split(self.heat, [-wires.num_wires])
        states = wires.integrate_states(state, np.zeros((len(times), wires.num_wires)), times)
        return np.append(states[-1], integrate_readings(wires, states, reading, times)[-1])


def fit_strides(gait: Gait, recording: Recording, start: float, cycles: int) -> StridesFit:
    """Fit friction, and the stiffness, torques and rates of heat of each limb, to strides.

    Args:
        gait: the gait that the robot walks by, at the planned speed.
        recording: begins with cold wires.
        start: time at which the first cycle begins, s.
        cycles: number of cycles.

    Raises:
        CalibrationError: if the recording is of other wires, or no foot slides as planned.
    """
    robot = copy.deepcopy(gait.robot)
    if recording.parameters.wire_names != robot.as_single_limb.wire_names:
        raise CalibrationError(
            f"The recording is of the wires {', '.join(recording.parameters.wire_names)}, but the "
            f"gait is of {', '.join(robot.as_single_limb.wire_names)}."
        )

    # Fit the heat, and find the moments at which feet slide.
    heat, rate_estimates = fit_heat(robot, recording)
    moments, contacts = _sliding_moments(gait, recording, start, cycles)
    if len(moments) < MIN_MOMENTS:
        raise CalibrationError(
            "No foot slides as planned in this recording, so that friction cannot be fitted; does "
            "the robot stand on the ground, and are its wires heated?"
        )

    # Take states and bends at these moments.
    states = recording.interpolated(heat[:, : -len(recording.duty)].T, moments).T
    smooth = smooth_bends(recording)
    bends = recording.interpolated(smooth, moments).T
    balance = _SlidingBalance(robot, states, contacts, exact=recording.applied_duty is None)

    # Fit multiples of friction, stiffness and torques.
    names = ["friction"]
    prior_errors = [FRICTION_ERROR]
    for limb in robot.limbs:
        names += [f"{limb.name}.stiffness", f"{limb.name}.torque"]
        factor = 1.0 if limb.parameters.calibration else UNCALIBRATED_FACTOR
        prior_errors += [factor * STIFFNESS_ERROR, factor * TORQUE_ERROR]
    # Deviations within a phase are correlated: each phase counts as one moment.
    num_phases = 0
    for contacts_of_phase in gait.schedule:
        if "stick" in contacts_of_phase and set(contacts_of_phase) != {"stick"}:
            num_phases += cycles
    error = BEND_ERROR * np.sqrt(max(1.0, len(moments) / num_phases))
    logarithms, covariance = _fit_multiples(balance, bends, prior_errors, error)
    fitted = _scale_robot(robot, dict(zip(names, np.exp(logarithms), strict=True)))
    estimates = dict(zip(names, map(_make_estimate, logarithms, np.diag(covariance)), strict=True))
    return StridesFit(fitted, estimates | rate_estimates, heat[-1], smooth[:, -1])


def fit_heat(
    robot: RobotParameters, recording: Recording
) -> tuple[np.ndarray, dict[str, Estimate]]:
    """Fit the rates of the wires' laws to readings, and set them in the robot.

    Returns:
        [x, V] of the wires along the recording (K, N + W), and the estimates of the rates.
    """
    single_limb = robot.as_single_limb  # its wires' laws are the robot's
    laws = [wire.law for wire in single_limb.wires]
    W = len(laws)
    described_laws = copy.deepcopy(laws)
    rates = [r for r in HEAT_RATE_FIELDS if all(hasattr(w, r) for w in laws)]
    duty = np.clip(recording.heating_duty, 0.0, 1.0).T
    times = recording.time - recording.time[0]
    measured = recording.measured_temperature.T
    is_measured = ~np.isnan(measured)

    def simulate_heat(changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states x (K, N) and readings V (K, W) with changed rates."""
        for rate, wire_changes in zip(rates, changes, strict=True):
            for law, before, change in zip(laws, described_laws, wire_changes, strict=True):
                setattr(law, rate, float(getattr(before, rate) * np.exp(change)))
        wires = LimbModel.of(single_limb).wires
        states = wires.integrate_states(wires.cold_states, duty, times)
        return states, integrate_readings(wires, states, wires.cold_states[:W], times)

    # Deviations of a reading last as long as cooling: so many samples count as one.
    correlated_samples = recording.sample_rate / laws[0].typical_rates()["fastest_cooling"]
    weight = is_measured / (READING_ERROR**2 * correlated_samples)

    # Fit the logarithms of the rates by Gauss-Newton steps, each wire by itself.
    logarithms = np.zeros((len(rates), W))
    for _ in range(MAX_ITERATIONS // 2):
        readings = simulate_heat(logarithms)[1]
        residual = np.where(is_measured, measured - readings, 0.0)
        slopes = np.zeros((len(rates), *readings.shape))
        for slope, change in zip(slopes, np.eye(len(rates)), strict=True):
            changed = logarithms + 1e-3 * change[:, None]
            slope[:] = (simulate_heat(changed)[1] - readings) / 1e-3
        curvature = np.einsum("akw,bkw,kw->wab", slopes, slopes, weight)
        curvature += np.eye(len(rates)) / RATE_ERROR**2
        gradient = np.einsum("akw,kw,kw->wa", slopes, weight, residual)
        gradient -= logarithms.T / RATE_ERROR**2
        step = np.linalg.solve(curvature, gradient[..., None])[..., 0].T
        logarithms += np.clip(step, -0.3, 0.3)

    # Set the fitted rates, and estimate their errors.
    heat = np.hstack(simulate_heat(logarithms))
    variances = np.diagonal(np.linalg.inv(curvature), axis1=1, axis2=2)
    estimates = {}
    for w, wire in enumerate(single_limb.wire_names):
        for r, rate in enumerate(rates):
            estimates[f"{wire}.{rate}"] = _make_estimate(logarithms[r, w], variances[w, r])
    return heat, estimates


def _make_estimate(logarithm: float, variance: float) -> Estimate:
    """Return the estimate of a multiple from its logarithm and variance."""
    value = float(np.exp(logarithm))
    return Estimate(value, value * float(np.sqrt(variance)), "of before")


def smooth_bends(recording: Recording) -> np.ndarray:
    """Return the measured bends (F, K), rad, with gaps filled and noise averaged."""
    size = max(1, round(SMOOTHING_TIME * recording.sample_rate))
    bends = np.array([fill_gaps(recording.time, bend) for bend in recording.bend_angle])
    return uniform_filter1d(bends, size, axis=1)


def _sliding_moments(
    gait: Gait, recording: Recording, start: float, cycles: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return moments at which feet slide as planned (M,), s, and each foot's contact (M, F)."""
    walker = Walker(gait.robot)
    single_limb = gait.robot.as_single_limb
    B = walker.pose_size

    # Take the planned contacts at evenly spaced moments.
    times = start + np.arange(0.0, cycles * gait.period, MOMENT_SPACING)
    times = times[times < recording.time[-1]]
    starts = [phase.start for phase in gait.phases]
    in_cycle = (times - start) % gait.period
    contacts = np.array(gait.schedule)[np.searchsorted(starts, in_cycle, "right") - 1]
    signs = np.array([[SLIDE_SIGNS.get(foot, 0.0) for foot in feet] for feet in contacts])
    sticks = contacts == "stick"

    def speeds(motion: Gait | Recording, bends: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Return each foot's speed (M, F), m/s, relative to the mean of the feet that stick."""
        bend_rates = motion.interpolated(np.gradient(bends, motion.time, axis=1), at)
        y = np.zeros((len(at), B + single_limb.num_joints))
        y[:, B:] = joint_angles_from_bend_angle(single_limb, motion.interpolated(bends, at)).T
        joint_rates = joint_angles_from_bend_angle(single_limb, bend_rates).T
        speed = np.einsum("kfd,kd->kf", walker.feet_jacobian(y)[:, :, 0, B:], joint_rates)
        num_sticking = np.maximum(1, sticks.sum(axis=1, keepdims=True))
        return speed - (speed * sticks).sum(axis=1, keepdims=True) / num_sticking

    # Keep moments at which all feet that should slide are at least half as fast as planned.
    planned = speeds(gait, gait.bend_angle, in_cycle)
    measured = speeds(recording, smooth_bends(recording), times)
    mean = np.array([np.abs(planned[(signs == s).all(axis=1)]).mean(axis=0) for s in signs])
    slides = (signs * measured > SLIDING_SPEED_SHARE * mean) | (signs == 0)
    swings = (contacts == "swing").any(axis=1)
    is_sliding = slides.all(axis=1) & (signs != 0).any(axis=1) & ~swings
    return times[is_sliding], contacts[is_sliding]


class _SlidingBalance:
    """The bends of a robot some of whose feet slide, by friction, stiffness and torques.

    Args:
        robot: its description.
        states: states of the wires (M, N).
        contacts: contact of each foot (M, F).
        exact: whether bends are exact, as a model's, and not read by bend sensors.
    """

    def __init__(
        self, robot: RobotParameters, states: np.ndarray, contacts: np.ndarray, *, exact: bool
    ):
        model = LimbModel.of(robot.as_single_limb)
        self._walker = Walker(robot)
        self._wires = model.wires
        self._robot = robot
        self._mechanics = model.mechanics
        self._exact = exact
        self._slides = np.vectorize(lambda foot: SLIDE_SIGNS.get(foot, 0.0))(contacts)
        self._balance = make_balance(self._walker, self._wires)
        M = len(states)
        d = self._d = len(self._walker.stiffness)
        F = self._F = self._walker.num_feet

        # Begin at straight limbs, each of which carries the same load.
        self._load = float(np.linalg.norm(self._walker.weight)) / F
        self._points = np.hstack(
            [
                np.tile(self._walker.rest, (M, 1)),
                states,
                np.tile([0.0, self._load] * F, (M, 1)),
                np.tile(self._walker.feet(self._walker.rest)[:, 0], (M, 1)),
            ]
        )
        self._unknown = np.r_[:d, d + states.shape[1] + np.arange(2 * F)]
        self._cold = np.tile(self._wires.cold_states, (M, 1))

    def bends(self, logarithms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return φ (M, F), rad, and its derivatives by the logarithms of multiples (M, F, P).

        Args:
            logarithms: of μ, and of stiffness and torques of each limb, as multiples (P,).
        """
        # Solve for configuration and forces by Newton's method.
        for _ in range(30):
            residual, slopes, _ = self._equations(logarithms)
            step = np.linalg.solve(slopes, residual[..., None])[..., 0]
            largest = np.abs(step[:, 2 : self._d]).max(axis=1, keepdims=True)
            self._points[:, self._unknown] -= step / np.maximum(1.0, largest / 0.2)
            if largest.max() < 1e-9:
                break

        # Differentiate the joint angles implicitly, and the bends by differences.
        _, slopes, by_multiples = self._equations(logarithms)
        joints = slice(self._walker.pose_size, self._d)
        angle_slopes = -np.linalg.solve(slopes, by_multiples)[:, joints]
        angles = self._points[:, joints]
        bends = self._observed_bends(angles)
        bend_slopes = []
        for slope in np.moveaxis(angle_slopes, -1, 0):
            bend_slopes.append((self._observed_bends(angles + 1e-6 * slope) - bends) / 1e-6)
        return bends, np.stack(bend_slopes, axis=-1)

    def _observed_bends(self, angles: np.ndarray) -> np.ndarray:
        """Return φ (M, F), rad, of joint angles (M, n), rad."""
        if self._exact:
            return self._mechanics.bend_angle(angles.T).T
        return self._mechanics.recorded_bend_angle(angles.T).T

    def _equations(self, logarithms: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return residuals (M, U) and their derivatives by the unknown [y, λ] and multiples."""
        d = self._d
        F = self._F
        B = self._walker.pose_size
        points = self._points

        # Evaluate the balance as described.
        residual, slopes = self._balance.first(points)
        by_unknown = slopes[:, :, self._unknown]
        residual[:, d + F :] -= self._walker.radius
        by_multiples = np.zeros((*residual.shape, len(logarithms)))

        # Add the moments of stiffer springs and stronger wires.
        q = points[:, B:d]
        _, states, forces = self._balance.split(points)
        torques = self._wires.forces(states, q) - self._wires.forces(self._cold, q)
        springs = self._walker.stiffness[B:] * (q - self._walker.rest[B:])
        for limb, joints in enumerate(self._robot.joints_of):
            rows = slice(B + joints.start, B + joints.stop)
            stiffer, stronger = np.exp(logarithms[1 + 2 * limb : 3 + 2 * limb])
            residual[:, rows] += (stiffer - 1) * springs[:, joints]
            residual[:, rows] -= (stronger - 1) * torques[:, joints]
            diagonal = np.arange(rows.start, rows.stop)
            by_unknown[:, diagonal, diagonal] += (stiffer - 1) * self._walker.stiffness[rows]
            by_multiples[:, rows, 1 + 2 * limb] = stiffer * springs[:, joints]
            by_multiples[:, rows, 2 + 2 * limb] = -stronger * torques[:, joints]

        # Where a foot slides, Coulomb's law replaces its given travel.
        mu = self._walker.friction * np.exp(logarithms[0])
        scale = self._walker.size / self._load
        for foot in range(F):
            row = d + foot
            moments = np.flatnonzero(self._slides[:, foot])
            signs = self._slides[moments, foot]
            tangential, normal = forces[moments, foot].T
            residual[moments, row] = scale * (tangential + signs * mu * normal)
            by_unknown[moments, row] = 0.0
            by_unknown[moments, row, d + 2 * foot] = scale
            by_unknown[moments, row, d + 2 * foot + 1] = scale * signs * mu
            by_multiples[moments, row, 0] = scale * signs * mu * normal
        return residual, by_unknown, by_multiples


def _fit_multiples(
    balance: _SlidingBalance, bends: np.ndarray, prior_errors: ArrayLike, error: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the most probable logarithms of multiples (P,) and their covariance (P, P).

    Args:
        bends: measured bends (M, F), rad.
        prior_errors: standard deviations of the logarithms before the fit (P,).
        error: standard deviation of a bend, rad.
    """
    precision = np.diag(1 / np.square(prior_errors))
    logarithms = np.zeros(len(precision))
    for _ in range(MAX_ITERATIONS):
        predicted, slopes = balance.bends(logarithms)
        slopes = slopes.reshape(-1, len(precision))
        residual = (bends - predicted).ravel()
        # Huber's weights limit the effect of outliers.
        weights = 1 / np.maximum(1.0, np.abs(residual) / error / 2) / error**2
        curvature = slopes.T @ (weights[:, None] * slopes) + precision
        gradient = slopes.T @ (weights * residual) - precision @ logarithms
        step = np.linalg.solve(curvature, gradient)
        logarithms = logarithms + np.clip(step, -0.3, 0.3)
        if np.abs(step).max() < 1e-4:
            break
    return logarithms, np.linalg.inv(curvature)


def _scale_robot(robot: RobotParameters, multiples: dict[str, float]) -> RobotParameters:
    """Return a robot whose friction, stiffness and torques are multiplied."""
    robot = with_friction(robot, multiples["friction"])
    for limb in robot.limbs:
        torques = dict.fromkeys(TORQUE_FIELDS, multiples[f"{limb.name}.torque"])
        scale_limb(limb.parameters, multiples[f"{limb.name}.stiffness"], torques)
    return robot
