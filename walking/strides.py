"""What a robot's strides tell: friction of the ground, and stiffness, torque and heat of limbs.

The duty of a recording and the wires' laws give their heat, whose rates are fitted to the readings.
While a foot slides, its friction is known but for μ, and the balance of forces of `Balance`
determines all angles: the bends that are then measured tell μ and, of each limb, its stiffness
and the torques of its wires. Nobody needs to see the body.
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
from walking.gait_program import SLIDES
from walking.robot_parameters import RobotParameters
from walking.standing import balance_of
from walking.walker import Walker

SPACING = 0.25  # s, between the moments whose balance counts
SMOOTHING = 0.25  # s, of bends from which the speed of feet is told
SLIDING = 0.5  # share of its planned mean speed, from which on a foot counts as sliding
FEWEST = 6  # moments
ITERATIONS = 8
# Relative errors that are expected of what was described or calibrated before, and what bends and
# readings deviate from the laws: rad, in each phase of sliding, and °C.
FRICTION, STIFFNESS, TORQUE, RATES = 0.5, 0.1, 0.1, 0.2
UNCALIBRATED = 2.0  # times as much, of stiffness and torques of a limb that is only described
BEND_ERROR, READING_ERROR = np.deg2rad(1.0), 2.0
TORQUES = ("beta", "full_torque")  # of the wires' laws, as far as they have them
HEAT_RATES = ("a1", "a2")


@dataclasses.dataclass(frozen=True, eq=False)
class StridesFit:
    """A robot as its strides show it.

    - ``robot``: its description with the fitted values.
    - ``estimates``: each of them as a multiple of the value before, by name.
    - ``heat``, ``bend``: [x, V] of the wires (N + W,) and φ (F,), rad, at the recording's end.
    - ``made``: share of the planned stride that the last one made; NaN if the body was not seen.
    """

    robot: RobotParameters
    estimates: dict[str, Estimate]
    heat: np.ndarray
    bend: np.ndarray
    made: float = np.nan

    def heat_after(self, pause: float) -> np.ndarray:
        """[x, V] of the wires after a pause without duty, s (N + W,)."""
        wires, times = (
            LimbModel.of(self.robot.as_single_limb).wires,
            np.linspace(0.0, pause, 2 + int(pause)),
        )
        states, readings = np.split(self.heat, [-wires.num_wires])
        course = wires.integrate_states(states, np.zeros((len(times), wires.num_wires)), times)
        return np.append(course[-1], integrate_readings(wires, course, readings, times)[-1])


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
    heat, of_rates = fit_heat(robot, recording)
    states = heat[:, : -len(recording.duty)]
    moments, contacts = _sliding(gait, recording, start, cycles)
    if len(moments) < FEWEST:
        raise CalibrationError(
            "No foot slides as planned in this recording, so that its strides tell nothing of the "
            "ground; does the robot stand on it, and are its wires heated?"
        )
    states, smooth = recording.interpolated(states.T, moments).T, smoothed(recording)
    bends = recording.interpolated(smooth, moments).T
    balance = _Balance(robot, states, contacts, exact=recording.applied_duty is None)
    names, expected = ["friction"], [FRICTION]
    for limb in robot.limbs:
        names += [f"{limb.name}.stiffness", f"{limb.name}.torque"]
        known = 1.0 if limb.parameters.calibration else UNCALIBRATED
        expected += [known * STIFFNESS, known * TORQUE]
    # Deviations of one phase are alike: each phase counts as one moment.
    phases = cycles * sum("stick" in of and set(of) != {"stick"} for of in gait.schedule)
    error = BEND_ERROR * np.sqrt(max(1.0, len(moments) / phases))
    logarithms, covariance = _most_probable(balance, bends, expected, error)
    fitted = _changed(robot, dict(zip(names, np.exp(logarithms), strict=True)))
    estimates = dict(zip(names, map(_multiple, logarithms, np.diag(covariance)), strict=True))
    return StridesFit(fitted, estimates | of_rates, heat[-1], smooth[:, -1])


def fit_heat(
    robot: RobotParameters, recording: Recording
) -> tuple[np.ndarray, dict[str, Estimate]]:
    """[x, V] of the wires along a recording (K, N + W) with rates that fit its readings.

    The robot's laws get the rates.
    """
    together = robot.as_single_limb  # whose wires' laws are the robot's own
    laws, W = [wire.law for wire in together.wires], len(together.wires)
    given, rates = copy.deepcopy(laws), [r for r in HEAT_RATES if all(hasattr(w, r) for w in laws)]
    duty = recording.heating_duty
    duty, times = np.clip(duty, 0.0, 1.0).T, recording.time - recording.time[0]
    measured = recording.measured_temperature.T
    shown = ~np.isnan(measured)
    logarithms = np.zeros((len(rates), W))

    def course(changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        for rate, of_wires in zip(rates, changes, strict=True):
            for law, before, change in zip(laws, given, of_wires, strict=True):
                setattr(law, rate, float(getattr(before, rate) * np.exp(change)))
        wires = LimbModel.of(together).wires
        states = wires.integrate_states(wires.cold_states, duty, times)
        return states, integrate_readings(wires, states, wires.cold_states[:W], times)

    # Readings of a wire deviate for as long as it takes to cool: so many count as one.
    alike = recording.sample_rate / laws[0].typical_rates()["fastest_cooling"]
    weight = shown / (READING_ERROR**2 * alike)
    for _ in range(ITERATIONS // 2):
        readings = course(logarithms)[1]
        missed = np.where(shown, measured - readings, 0.0)
        slopes = np.zeros((len(rates), *readings.shape))
        for slope, change in zip(slopes, np.eye(len(rates)), strict=True):
            slope[:] = (course(logarithms + 1e-3 * change[:, None])[1] - readings) / 1e-3
        curvature = np.einsum("akw,bkw,kw->wab", slopes, slopes, weight)
        curvature += np.eye(len(rates)) / RATES**2
        uphill = np.einsum("akw,kw,kw->wa", slopes, weight, missed) - logarithms.T / RATES**2
        step = np.linalg.solve(curvature, uphill[..., None])[..., 0].T
        logarithms += np.clip(step, -0.3, 0.3)
    heat = np.hstack(course(logarithms))
    variances = np.diagonal(np.linalg.inv(curvature), axis1=1, axis2=2)
    return heat, {
        f"{wire}.{rate}": _multiple(logarithms[r, w], variances[w, r])
        for w, wire in enumerate(together.wire_names)
        for r, rate in enumerate(rates)
    }


def _multiple(logarithm: float, variance: float) -> Estimate:
    """A multiple of a value before, by the logarithm and its variance."""
    value = float(np.exp(logarithm))
    return Estimate(value, value * float(np.sqrt(variance)), "of before")


def smoothed(recording: Recording) -> np.ndarray:
    """Measured bends (F, K), rad, without gaps, and with little noise."""
    size = max(1, round(SMOOTHING * recording.sample_rate))
    bends = np.array([fill_gaps(recording.time, bend) for bend in recording.bend_angle])
    return uniform_filter1d(bends, size, axis=1)


def _sliding(
    gait: Gait, recording: Recording, start: float, cycles: int
) -> tuple[np.ndarray, np.ndarray]:
    """Moments at which feet slide as planned (M,), s, and the contact of each foot (M, F)."""
    walker, together = Walker(gait.robot), gait.robot.as_single_limb
    B = walker.pose_size
    times = start + np.arange(0.0, cycles * gait.period, SPACING)
    times = times[times < recording.time[-1]]
    starts = [phase.start for phase in gait.phases]
    in_cycle = (times - start) % gait.period
    contacts = np.array(gait.schedule)[np.searchsorted(starts, in_cycle, "right") - 1]
    signs = np.array([[SLIDES.get(foot, 0.0) for foot in feet] for feet in contacts])
    sticks = contacts == "stick"

    def speeds(motion: Gait | Recording, bends: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Speed of each foot (M, F), m/s, beside the mean of those that stick."""
        shown = motion.interpolated(np.gradient(bends, motion.time, axis=1), at)
        held = motion.interpolated(bends, at)
        y = np.zeros((len(at), B + together.num_joints))
        y[:, B:] = joint_angles_from_bend_angle(together, held).T
        rates = joint_angles_from_bend_angle(together, shown).T
        own = np.einsum("kfd,kd->kf", walker.feet_jacobian(y)[:, :, 0, B:], rates)
        return own - (own * sticks).sum(axis=1, keepdims=True) / np.maximum(
            1, sticks.sum(axis=1, keepdims=True)
        )

    planned = speeds(gait, gait.bend_angle, in_cycle)
    made = speeds(recording, smoothed(recording), times)
    mean = np.array([np.abs(planned[(signs == s).all(axis=1)]).mean(axis=0) for s in signs])
    slides = (signs * made > SLIDING * mean) | (signs == 0)
    at = slides.all(axis=1) & (signs != 0).any(axis=1) & ~(contacts == "swing").any(axis=1)
    return times[at], contacts[at]


class _Balance:
    """The bends of a robot of which some feet slide, by friction, stiffness and torques.

    Args:
        robot: its description.
        states: states of the wires (M, N).
        contacts: contact of each foot (M, F).
        exact: whether bends are those of the chord, as of a model, and not of bend sensors.
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
        self._slides = np.vectorize(lambda foot: SLIDES.get(foot, 0.0))(contacts)
        self._balance = balance_of(self._walker, self._wires)
        M, d, F = len(states), len(self._walker.stiffness), self._walker.num_feet
        self._d, self._F = d, F
        load = float(np.linalg.norm(self._walker.weight)) / F
        self._points = np.hstack(
            [
                np.tile(self._walker.rest, (M, 1)),
                states,
                np.tile([0.0, load] * F, (M, 1)),
                np.tile(self._walker.feet(self._walker.rest)[:, 0], (M, 1)),
            ]
        )
        self._unknown = np.r_[:d, d + states.shape[1] + np.arange(2 * F)]
        self._load, self._cold = load, np.tile(self._wires.cold_states, (M, 1))

    def bends(self, logarithms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """φ (M, F), rad, and its derivatives by the logarithms (M, F, P), of multiples.

        Args:
            logarithms: of μ, and of stiffness and torques of each limb, as multiples (P,).
        """
        for _ in range(30):
            missed, slopes, by_multiples = self._equations(logarithms)
            step = np.linalg.solve(slopes, missed[..., None])[..., 0]
            largest = np.abs(step[:, 2 : self._d]).max(axis=1, keepdims=True)
            self._points[:, self._unknown] -= step / np.maximum(1.0, largest / 0.2)
            if largest.max() < 1e-9:
                break
        missed, slopes, by_multiples = self._equations(logarithms)
        moved = -np.linalg.solve(slopes, by_multiples)[:, self._walker.pose_size : self._d]
        q = self._points[:, self._walker.pose_size : self._d]
        shown = self._shown(q)
        by = [(self._shown(q + 1e-6 * step) - shown) / 1e-6 for step in np.moveaxis(moved, -1, 0)]
        return shown, np.stack(by, axis=-1)

    def _shown(self, angles: np.ndarray) -> np.ndarray:
        if self._exact:
            return self._mechanics.bend_angle(angles.T).T
        return self._mechanics.recorded_bend_angle(angles.T).T

    def _equations(self, logarithms: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What is not zero yet (M, U), and derivatives by the unknown [y, λ] and the multiples."""
        d, F, B, points = self._d, self._F, self._walker.pose_size, self._points
        missed, slopes = self._balance.first(points)
        by_unknown = slopes[:, :, self._unknown]
        missed[:, d + F :] -= self._walker.radius
        by_multiples = np.zeros((*missed.shape, len(logarithms)))
        q, states = points[:, B:d], self._balance.split(points)[1]
        torques = self._wires.forces(states, q) - self._wires.forces(self._cold, q)
        springs = self._walker.stiffness[B:] * (q - self._walker.rest[B:])
        for limb, joints in enumerate(self._robot.joints_of):
            rows = slice(B + joints.start, B + joints.stop)
            stiffer, stronger = np.exp(logarithms[1 + 2 * limb : 3 + 2 * limb])
            missed[:, rows] += (stiffer - 1) * springs[:, joints]
            missed[:, rows] -= (stronger - 1) * torques[:, joints]
            diagonal = np.arange(rows.start, rows.stop)
            by_unknown[:, diagonal, diagonal] += (stiffer - 1) * self._walker.stiffness[rows]
            by_multiples[:, rows, 1 + 2 * limb] = stiffer * springs[:, joints]
            by_multiples[:, rows, 2 + 2 * limb] = -stronger * torques[:, joints]
        forces = self._balance.split(points)[2]
        mu = self._walker.friction * np.exp(logarithms[0])
        for foot in range(F):
            slides, own = self._slides[:, foot], np.flatnonzero(self._slides[:, foot])
            row, scale = d + foot, self._walker.size / self._load
            missed[own, row] = scale * (
                forces[own, foot, 0] + slides[own] * mu * forces[own, foot, 1]
            )
            by_unknown[own, row] = 0.0
            by_unknown[own, row, d + 2 * foot] = scale
            by_unknown[own, row, d + 2 * foot + 1] = scale * slides[own] * mu
            by_multiples[own, row, 0] = scale * slides[own] * mu * forces[own, foot, 1]
        return missed, by_unknown, by_multiples


def _most_probable(
    balance: _Balance, bends: np.ndarray, expected: ArrayLike, error: float
) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the multiples (P,) that explain bends (M, F), rad, and their covariance.

    Args:
        expected: standard deviations of the logarithms before (P,).
        error: standard deviation of a bend, rad.
    """
    precision = np.diag(1 / np.square(expected))
    logarithms = np.zeros(len(precision))
    for _ in range(ITERATIONS):
        shown, slopes = balance.bends(logarithms)
        slopes, missed = slopes.reshape(-1, len(precision)), (bends - shown).ravel()
        away = np.abs(missed) / error
        weights = 1 / np.maximum(1.0, away / 2) / error**2  # Huber's
        curvature = slopes.T @ (weights[:, None] * slopes) + precision
        step = np.linalg.solve(curvature, slopes.T @ (weights * missed) - precision @ logarithms)
        logarithms = logarithms + np.clip(step, -0.3, 0.3)
        if np.abs(step).max() < 1e-4:
            break
    return logarithms, np.linalg.inv(curvature)


def _changed(robot: RobotParameters, multiples: dict[str, float]) -> RobotParameters:
    """A robot with friction, stiffness and torques that are multiples of before."""
    robot = with_friction(robot, multiples["friction"])
    for limb in robot.limbs:
        torques = dict.fromkeys(TORQUES, multiples[f"{limb.name}.torque"])
        scale_limb(limb.parameters, multiples[f"{limb.name}.stiffness"], torques)
    return robot
