"""The spring constant from the sag under gravity (Sec. V-A)."""

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration.errors import CalibrationError
from calibration.estimate import Estimate, standard_error
from calibration.recordings.kinds import bend_sensor_of, only_segment, title_of
from calibration.recordings.repair import part
from calibration.remarks import Remark, remarks_on_estimate
from calibration.section_v.damping import DampingFit
from limb_systems import (
    BendSensor,
    ChordSensor,
    LimbError,
    LimbParameters,
    Recording,
    TipTangentSensor,
    make_manipulator,
)
from limb_systems.model.bend_sensor import chord_angle
from limb_systems.model.kinematics import rest_joint_angles
from limb_systems.model.statics import static_equilibrium

RESTING_TIME = 5.0  # s at the end of a recording that count as equilibrium
MOST_OFF = 10.0  # factor between the described stiffness and that of any such limb
OFF_SENSOR = 0.15  # logarithm of frequencies, beyond which the sensor is in doubt
STILL = np.deg2rad(1.0)  # by which the bend angle may move in that time
SCATTER = 0.2  # share of k by which trials may leave it unknown: as a mounting 2° off of 10° does


@dataclasses.dataclass(frozen=True, eq=False)
class StiffnessFit:
    """The spring constant of each joint, from a limb that sags.

    - ``stiffness``: k, N·m/rad.
    - ``correction_factor``: λ of eqn (9), without unit, for φ^eq as the bend sensor shows it.
    - ``chord_factor``: λ of the same sag for φ^eq of the chord, which the paper has: 1.22 of a
      sag by 10° of five links. A tip tangent's α/2 is two thirds of the chord's angle.
    - ``sags``: φ^eq of each trial (K,), rad, signed as gravity, as recorded.
    - ``simulated_sag``: sag of the fitted limb, as its bend sensor would show it, rad.
    - ``remarks``: sentences on what the data lack.
    """

    stiffness: Estimate
    correction_factor: float
    chord_factor: float
    sags: np.ndarray
    simulated_sag: float
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


def shape_factors(links: int) -> np.ndarray:
    """b_i of eqn (9), (links,): the shares of the joints in a sag.

    The denominator is Σ (N - j + 1)², not Σ (N - j)² as printed.
    """
    squares = np.arange(links, 0, -1.0) ** 2
    return squares / squares.sum()


def fit_stiffness(
    parameters: LimbParameters, recordings: Sequence[Recording], rest_error: float = 0.0
) -> StiffnessFit:
    """k by the iteration of Sec. V-A, eqn (9).

    In turn k is fitted to θ^eq = λ φ^eq b, as -θ^eq \\ f_g(θ^eq) by least squares,
    and λ to a simulated equilibrium of the limb with this k, of which φ^eq is what
    the bend sensor of the recordings would show.

    Args:
        parameters: geometry, mass and rest angle of the limb; of one segment.
        recordings: recordings of the limb at rest, unheated, with E2 along the vertical
            as their parameters' ``gravity`` says. At rest the last 5 s count.
        rest_error: standard error of the rest angle, rad.

    Raises:
        CalibrationError: if the limb does not rest, or sags against gravity; if it
            was mounted, or its bend read, in several ways; if k is more than ten times
            the described one, or less than a tenth.
    """
    if not recordings:
        raise CalibrationError("There is no recording of the limb's sag under gravity.")
    for recording in recordings:
        recording.check_plausible()
    recordings = [part(recording, ~recording.missing) for recording in recordings]
    sags = np.array([_resting_angle(recording) for recording in recordings])
    gravity = recordings[0].parameters.gravity
    sensor = bend_sensor_of(recordings[0])
    for recording in recordings[1:]:
        if bend_sensor_of(recording) != sensor:
            raise CalibrationError(
                f"The sag was recorded with {sensor} and with {bend_sensor_of(recording)}; use "
                "the same bend sensor each time."
            )
        if not np.allclose(recording.parameters.gravity, gravity):
            raise CalibrationError(
                f"The sag was recorded with gravity {gravity} and with "
                f"{recording.parameters.gravity} m/s²; mount the limb the same way each time."
            )
    sag = float(sensor.corrected(np.mean(sags))) - only_segment(parameters).rest_angle
    if not sag * gravity[1] > 0:
        raise CalibrationError(
            f"The limb sags by {np.rad2deg(sag):.1f}° where gravity along E2 is "
            f"{gravity[1]:g} m/s²: it bends upwards. Is the bend sensor reversed, or gravity in "
            "the header?"
        )
    # Of the mean: in a fit to each trial their scatter would count as sag, and k be too small.
    mounted, mean = _mounted(parameters, gravity), float(np.mean(sags))
    stiffness, correction = _iterate(mounted, sensor, mean)
    described = only_segment(parameters).stiffness
    if not described / MOST_OFF < stiffness < described * MOST_OFF:
        raise CalibrationError(
            f"A sag of {np.rad2deg(sag):.1f}° makes the stiffness {stiffness:.2g} N·m/rad, where "
            f"the description has {described:.2g} N·m/rad; look at mass and length in the "
            "description, and at what the bend sensor reads while the limb is straight."
        )
    # Trials that are all the same say nothing of the sensor's drift.
    spread = standard_error(sags) if np.ptp(sags) > 0 else sensor.drift
    spread = np.hypot(spread, sensor.gain * rest_error)
    change = 1e-3 * sensor.gain * sag
    slope = (_iterate(mounted, sensor, mean + change)[0] - stiffness) / change
    estimate = Estimate(stiffness, float(abs(slope * spread)), "N·m/rad")
    remarks = []
    if len(sags) < 3:
        sentence = (
            f"Only {len(sags)} trial{'s' * (len(sags) > 1)} of the sag: mounting and sensor differ "
            "by about 2° from trial to trial, so record ten."
        )
        remarks.append(Remark("few", sentence))
    elif estimate.standard_error > SCATTER * stiffness:
        sentence = (
            f"The sag differs by {np.rad2deg(np.ptp(sags)):.1f}° between {len(sags)} trials, of "
            f"{np.rad2deg(abs(sag)):.1f}°, so that k is known to "
            f"{estimate.standard_error / stiffness:.0%}; mount the limb alike and record more."
        )
        remarks.append(Remark("scatter", sentence))
    remarks += remarks_on_estimate("the stiffness", estimate)
    mounted.segments[0].stiffness = stiffness
    held, _ = static_equilibrium(mounted)
    shown, chord = sensor.exact_bend_angle(held), chord_angle(held)
    rest = only_segment(parameters).rest_angle
    by_chord = correction * float((shown - rest) / (chord - rest))
    simulated = float(sensor.apparent_bend_angle(held))
    return StiffnessFit(estimate, correction, by_chord, sags, simulated, remarks)


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
    mounted = _mounted(limb, sags[0].parameters.gravity)
    try:
        k, _ = _iterate(mounted, other, float(np.mean(stiffness.sags)))
    except CalibrationError:
        return []
    measured, simulated = damping.measured[0].frequency, damping.simulated[0].frequency
    expected = simulated * np.sqrt(k / stiffness.stiffness.value)
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


def _mounted(parameters: LimbParameters, gravity: Sequence[float]) -> LimbParameters:
    mounted = copy.deepcopy(parameters)
    mounted.gravity = list(gravity)
    return mounted


def _iterate(mounted: LimbParameters, sensor: BendSensor, sag: float) -> tuple[float, float]:
    """k and λ (9) for the bend angle of a sag, rad, as a sensor shows it."""
    limb = copy.deepcopy(mounted)
    segment = only_segment(limb)
    at_rest = rest_joint_angles(limb)
    bend = float(sensor.corrected(sag)) - segment.rest_angle
    shape = shape_factors(segment.links)
    plant = make_manipulator(limb)
    context = plant.CreateDefaultContext()
    correction, before = 1.0, np.inf
    for _ in range(100):
        angles = correction * bend * shape  # θ^eq, eqn (9)
        plant.SetPositions(context, at_rest + angles)
        forces = plant.CalcGravityGeneralizedForces(context)
        stiffness = float(angles @ forces / (angles @ angles))
        if abs(stiffness - before) < 1e-10 * stiffness:
            return stiffness, correction
        before = segment.stiffness = stiffness
        try:
            simulated, _ = static_equilibrium(limb)
        except LimbError as error:
            raise CalibrationError(
                f"No spring constant explains a sag of {np.rad2deg(sag):.1f}° with this "
                f"mass and length: {error}"
            ) from error
        expected = (sensor.exact_bend_angle(simulated) - segment.rest_angle) * shape
        correction = float(expected @ (simulated - at_rest) / (expected @ expected))
    raise CalibrationError("The iteration for the spring constant does not converge.")


def _resting_angle(recording: Recording) -> float:
    """Mean bend angle over the end of a recording, rad."""
    last = recording.time >= recording.time[-1] - RESTING_TIME
    angle = recording.bend_angle[0, last]
    first, second = np.array_split(angle, 2)
    if abs(first.mean() - second.mean()) > STILL:
        raise CalibrationError(
            f"The limb does not rest at the end of {title_of(recording)}: its bend still moves by "
            f"{np.rad2deg(abs(first.mean() - second.mean())):.1f}°."
        )
    return float(angle.mean())
