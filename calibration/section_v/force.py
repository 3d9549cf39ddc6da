"""Force coefficients of the wires (Sec. V-C2, eqn (13))."""

import dataclasses

import numpy as np

from calibration.errors import CalibrationError
from calibration.estimate import Estimate, standard_error
from calibration.recordings.kinds import bend_sensor_of, only_segment
from calibration.recordings.repair import despiked, interpolated
from calibration.remarks import Remark, remarks_on_estimate
from calibration.section_v.heat import HeatFit
from limb_systems import LimbParameters, Recording, joint_angles_from_bend_angle

BEND_DRIFT_TIME = 120.0  # s, within which a bend sensor's drift changes
WINDOW = 2.0  # s, shortest duration of an equilibrium
STILL = np.deg2rad(0.5)  # rad/s, below which φ̇ ≈ 0
STEADY = 0.5  # °C/s, below which Ṫ ≈ 0
LUKEWARM = 10.0  # °C above ambient, below which a torque is hidden by noise


@dataclasses.dataclass(frozen=True, eq=False)
class ForceFit:
    """Joint torque of one wire per degree, (4).

    - ``wire``: name of the wire.
    - ``beta``: β, N·m/°C.
    - ``times``: times of the equilibria that β was taken from (M,), s.
    - ``wire_temperature``: T^eq (M,), °C.
    - ``bend_angle``: φ^eq (M,), rad.
    - ``ratios``: Γ of (13), a β for each equilibrium (M,), N·m/°C.
    - ``remarks``: sentences on what the data lack.
    """

    wire: str
    beta: Estimate
    times: np.ndarray
    wire_temperature: np.ndarray
    bend_angle: np.ndarray
    ratios: np.ndarray
    remarks: list[Remark]


def fit_force(
    parameters: LimbParameters,
    recording: Recording,
    index: int,
    heat: HeatFit,
    stiffness: Estimate,
) -> ForceFit:
    """β of one wire: the mean of Γ = k θ^eq / (T^eq - T0) over equilibria, (13).

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
    shown = ~recording.missing
    recording = interpolated(despiked(recording))
    side = only_segment(parameters).wires[index].lever[0]
    starts, ends = _equilibria(recording, shown, heat, parameters.temperature_limits.warm)
    if len(starts) < 3:
        starts, ends = _equilibria(recording, shown, heat, heat.ambient + LUKEWARM)
    if len(starts) == 0:
        raise CalibrationError(
            f"The limb never rests while the {heat.wire} wire is warm; hold it longer at each "
            "bend angle."
        )
    spans = list(zip(starts, ends, strict=True))
    wire = np.array([heat.wire_temperature[a:b].mean() for a, b in spans])
    angle = np.array([recording.bend_angle[0, a:b].mean() for a, b in spans])
    times = np.array([recording.time[a:b].mean() for a, b in spans])
    bent = bend_sensor_of(recording).corrected(angle) - only_segment(parameters).rest_angle
    theta = joint_angles_from_bend_angle(parameters, bent[np.newaxis])[0]
    ratios = stiffness.value * theta / (side * (wire - heat.ambient))
    if not ratios.mean() > 0:
        raise CalibrationError(
            f"The {heat.wire} wire bends the limb away from its own side; are the wires swapped or "
            "is the bend sensor reversed?"
        )
    # Errors that all ratios share: of k, and of T^eq - T0 = -a2 D / a1.
    log_slopes = np.array([-1 / heat.a1.value, 1 / heat.a2.value, 0.0])
    shared = log_slopes @ heat.covariance @ log_slopes
    relative = np.sqrt((stiffness.standard_error / stiffness.value) ** 2 + shared)
    mean, count = float(ratios.mean()), len(ratios)
    remarks = []
    if count < 3:
        sentence = f"Of the {heat.wire} wire there are {count} equilibria; record at least five."
        remarks.append(Remark("few", sentence))
        error = mean * max(relative, 0.1)
    else:
        # The sensor's drift is much the same in equilibria that follow each other.
        shares = ratios / bent / count
        alike = np.exp(-np.abs(times[:, None] - times) / BEND_DRIFT_TIME)
        drift = bend_sensor_of(recording).drift * np.sqrt(shares @ alike @ shares)
        error = np.hypot(max(standard_error(ratios), drift), relative * mean)
        if (scatter := ratios.std(ddof=1) / mean) > 0.15:
            sentence = (
                f"The {heat.wire} wire's torque is not proportional to its temperature: β scatters "
                f"by {100 * scatter:.0f}% between equilibria."
            )
            remarks.append(Remark("law", sentence))
    beta = Estimate(mean, float(error), "N·m/°C")
    remarks += remarks_on_estimate(f"β of the {heat.wire} wire", beta)
    return ForceFit(heat.wire, beta, times, wire, angle, ratios, remarks)


def _equilibria(
    recording: Recording, shown: np.ndarray, heat: HeatFit, warm: float
) -> tuple[np.ndarray, np.ndarray]:
    """First and last sample of each stretch of rest with the wire above ``warm``, °C.

    None is missing in it, as ``shown`` (K,) has it.
    """
    period = 1 / recording.sample_rate
    width = max(3, int(WINDOW / period))
    kernel = np.ones(width) / width
    angle = np.convolve(recording.bend_angle[0], kernel, "same")
    # The slope between averages over a window each, in which noise hardly counts.
    moving = np.full_like(angle, np.inf)
    half = width // 2
    moving[half:-half] = np.abs(angle[2 * half :] - angle[: -2 * half]) / (2 * half * period)
    heating = np.abs(np.gradient(heat.wire_temperature, period))
    rest = (moving < STILL) & (heating < STEADY) & (heat.wire_temperature > warm)
    rest &= shown
    rest[:width] = rest[-width:] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rest, [False]]).astype(int)))
    starts, ends = edges[::2], edges[1::2]
    long = ends - starts >= width
    return starts[long], ends[long]
