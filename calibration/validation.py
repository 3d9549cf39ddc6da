"""Validation of a calibrated limb (Sec. V-D, Fig. 4)."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from calibration.bend_sensor import bend_sensor_of
from calibration.checks import check_values
from calibration.course import STEP, first_readings
from calibration.prediction import Predicted
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
    An interrupted recording counts as far as it came, and samples that are missing do not.
    Its times may be any, such as those of a clock that drifts.

    Raises:
        CalibrationError: if a value of the recording is not plausible.
    """
    check_values(recording)
    times = recording.time - recording.time[0]
    # The duty at a sample was in force since the sample before.
    held = np.column_stack([recording.duty[:, 1:], recording.duty[:, -1]])
    duty = PiecewisePolynomial.ZeroOrderHold(times, held)
    first = first_readings(recording)
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

    def at_samples(signals: np.ndarray) -> np.ndarray:
        return np.array([np.interp(times, simulation.time, signal) for signal in signals])

    simulated = Recording(
        time=recording.time,
        duty=recording.duty,
        measured_temperature=at_samples(simulation.measured_temperature),
        bend_angle=at_samples(np.array(seen)),
        parameters=parameters,
        source="model",
        sample_rate=recording.sample_rate,
    )
    return _compared(recording, simulated)


def as_validation(judged: Sequence[Predicted], parameters: LimbParameters) -> Validation:
    """Recordings, one after the other, and their prediction by a law, of a limb as given."""
    courses = [predicted.course for predicted in judged]
    spans = [course.times[-1] - course.times[0] + STEP for course in courses]
    starts = np.cumsum([0.0, *spans[:-1]])

    def recording(temperature: list[np.ndarray], bend: list[np.ndarray], source: str) -> Recording:
        steps = [np.minimum((c.times / STEP).astype(int), len(c.duty) - 1) for c in courses]
        return Recording(
            time=np.concatenate(
                [c.times - c.times[0] + start for c, start in zip(courses, starts, strict=True)]
            ),
            duty=np.concatenate([c.duty[s] for c, s in zip(courses, steps, strict=True)]).T,
            measured_temperature=np.concatenate(temperature).T,
            bend_angle=np.concatenate(bend)[np.newaxis],
            parameters=parameters,
            source=source,
            sample_rate=1 / STEP,
        )

    return _compared(
        recording(
            [c.temperature for c in courses],
            [c.bend for c in courses],
            ", ".join(dict.fromkeys(c.source for c in courses)),
        ),
        recording([p.temperature for p in judged], [p.bend for p in judged], "model"),
    )


def _compared(recording: Recording, simulation: Recording) -> Validation:
    shown = ~recording.missing
    error = np.abs(simulation.bend_angle - recording.bend_angle)[:, shown]
    heat = np.abs(simulation.measured_temperature - recording.measured_temperature)[:, shown]
    return Validation(
        recording,
        simulation,
        mean=float(error.mean()),
        median=float(np.median(error)),
        percentile_90=float(np.percentile(error, 90)),
        temperature_mean=float(heat.mean()),
    )
