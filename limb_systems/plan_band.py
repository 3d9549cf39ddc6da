"""The band about a plan: the deviations of the limbs that a calibration cannot distinguish."""

import dataclasses

import numpy as np

from limb_systems.files.trajectory import Trajectory
from limb_systems.limb_model import split_state
from limb_systems.limb_parameters import LimbParameters
from limb_systems.monte_carlo import OpenLoop, draw_limbs, stack_limbs

NUM_LIMBS = 64
SIMULATION_STEP = 0.25  # s
BEND_QUANTILE = 1.96  # standard deviations, of 95% of the limbs
READING_QUANTILE = 2.6  # of 995 of 1000 limbs, on one side, for each of two wires
TEMPERATURE_QUANTILE = 2.0  # standard deviations by which calibrated limbs stay below T_max
# A thermocouple sits between its wire and colder silicone. Its reading may miss this share of the
# wire's excess over the room; no reading identifies the share.
UNREAD_SHARE = 0.12
MAX_MARGIN = 15.0  # °C, the margin of plans for limbs that are not calibrated
MEAN_TO_DEVIATION = 1.25  # of the mean of |x| to the standard deviation of x, if x is normal


@dataclasses.dataclass(frozen=True, eq=False)
class Band:
    """The band in which limbs of one segment stay that are driven with a plan's duty, open loop.

    - ``time``: time since the start of the plan (M,), s.
    - ``bend_reading``: half-width of the band about φ* in which 95% of all bend sensors read, with
      noise and drift (M,), rad.
    - ``measured_temperature``: distance above the plan's V that 995 of 1000 limbs keep within, for
      each wire (W, M), °C.
    - ``highest_readings``: highest V of each wire that 995 of 1000 limbs keep within (W,), °C.
    """

    time: np.ndarray
    bend_reading: np.ndarray
    measured_temperature: np.ndarray
    highest_readings: np.ndarray


def temperature_margin(parameters: LimbParameters) -> float:
    """Return the margin below T_max, °C, with which plans keep a real limb's wires below T_max.

    It is twice the standard deviation of predicted temperatures, and the share of the heat that
    thermocouples do not read. It is zero if the limb is not calibrated, as nothing is known then.
    """
    record = parameters.calibration
    if record is None:
        return 0.0
    largest_rise = parameters.temperature_limits.maximum - parameters.ambient_temperature
    unread = largest_rise * (UNREAD_SHARE / (1.0 + UNREAD_SHARE))
    deviation = MEAN_TO_DEVIATION * record.temperature_error
    return min(TEMPERATURE_QUANTILE * deviation + unread, MAX_MARGIN)


def band(trajectory: Trajectory) -> Band | None:
    """Return the band about a plan, from the covariance of its limb's calibration.

    The band includes the error of the law's form: the errors with which the
    calibration predicted motions that it was not fitted to.

    Returns:
        None if the limb is not calibrated by prediction, or has several bends.
    """
    parameters = trajectory.parameters
    plan = trajectory.since_start()
    record = parameters.calibration
    if record is None or not record.bend_error or plan.model.layout.num_bends > 1:
        return None
    # Simulate the plan's limb, and limbs that are drawn around it.
    num_steps = max(1, int(np.ceil(plan.duration / SIMULATION_STEP)))
    ends = np.linspace(0.0, plan.duration, num_steps + 1)
    duty = plan.duty_trajectory().vector_values((ends[:-1] + ends[1:]) / 2).T
    limbs = [parameters, *draw_limbs(parameters, NUM_LIMBS)]
    law, ambient, rubber = stack_limbs(limbs)
    num_wires = len(parameters.wires)
    _, _, states, readings = split_state(parameters, plan.state[:, 0])
    law_states = states[: len(law.states) * num_wires].reshape(-1, num_wires)
    initial = []
    for values in (*law_states, readings):
        initial.append(np.broadcast_to(values, (len(limbs), 1, num_wires)))
    open_loop = OpenLoop(duty[:, np.newaxis], ends[1], parameters.segments[0])
    _, reading, bend = open_loop.simulate(law, ambient[:, np.newaxis], initial, rubber)

    # Find the spread of the bends, with the error of the law's form.
    form_bend_deviation = MEAN_TO_DEVIATION * record.bend_error
    bend_deviation = np.hypot(bend[:, 0, 1:].std(axis=1), form_bend_deviation)
    sensor = parameters.segments[0].bend_sensor
    deviations = np.broadcast_arrays(bend_deviation, sensor.noise, sensor.drift)
    form_heat_deviation = MEAN_TO_DEVIATION * record.temperature_error

    def upper_quantile(signals: np.ndarray) -> np.ndarray:
        """Return the quantile of the drawn limbs above the first limb, °C, of (.., W, limbs)."""
        mean = signals[..., 1:].mean(axis=-1) - signals[..., 0]
        deviation = np.hypot(signals[..., 1:].std(axis=-1), form_heat_deviation)
        return np.maximum(0.0, mean) + READING_QUANTILE * deviation

    highest = reading.max(axis=0)
    return Band(
        time=ends,
        bend_reading=BEND_QUANTILE * np.linalg.norm(deviations, axis=0),
        measured_temperature=upper_quantile(reading).T,
        highest_readings=highest[:, 0] + upper_quantile(highest),
    )
