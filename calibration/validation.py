"""Validation of a calibrated limb (Sec. V-D, Fig. 4)."""

import dataclasses

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from calibration.bend_sensor import bend_sensor_of
from calibration.checks import check_values
from limb_systems import Limb, LimbParameters, Recording, Wires, simulate
from limb_systems.model.kinematics import rest_joint_angles


@dataclasses.dataclass(frozen=True, eq=False)
class Validation:
    """The calibrated model, open loop, against a recording with both wires.

    - ``recording``, ``simulation``: of the limb and of its model for the same
      duty, at the same times; the model's bend angle is what the limb's bend
      sensor would show.
    - ``mean``, ``median``, ``percentile_90``: of |φ - φ_sim|, rad.
    - ``temperature_mean``: of |V - V_sim|, °C.
    """

    recording: Recording
    simulation: Recording
    mean: float
    median: float
    percentile_90: float
    temperature_mean: float


def validate(parameters: LimbParameters, recording: Recording) -> Validation:
    """Simulates the duty of a recording, open loop, and compares.

    The model starts at rest with its wires at the first measured temperatures.
    An interrupted recording counts as far as it came.

    Raises:
        CalibrationError: if a value of the recording is not plausible.
    """
    check_values(recording)
    times = recording.time - recording.time[0]
    # The duty at a sample was in force since the sample before.
    held = np.column_stack([recording.duty[:, 1:], recording.duty[:, -1]])
    duty = PiecewisePolynomial.ZeroOrderHold(times, held)
    first = recording.measured_temperature[:, :20].mean(axis=1)
    warm = Wires(parameters).settled_states(first)
    angles = rest_joint_angles(parameters)
    state = np.concatenate([angles, np.zeros_like(angles), warm, first])
    simulation = simulate(
        Limb(parameters),
        duty,
        times[-1],
        sample_rate=recording.sample_rate,
        initial_state=state,
    )
    assert simulation.joint_state is not None  # a model's
    seen = [
        bend_sensor_of(recording, segment).apparent_bend_angle(simulation.joint_state[joints])
        for segment, joints in enumerate(parameters.joint_slices)
    ]
    simulation = dataclasses.replace(simulation, time=recording.time, bend_angle=np.array(seen))
    error = np.abs(simulation.bend_angle - recording.bend_angle)
    heat = np.abs(simulation.measured_temperature - recording.measured_temperature)
    return Validation(
        recording,
        simulation,
        mean=float(error.mean()),
        median=float(np.median(error)),
        percentile_90=float(np.percentile(error, 90)),
        temperature_mean=float(heat.mean()),
    )
