"""How far a limb may be from a plan: the limbs that its calibration cannot tell apart."""

import dataclasses

import numpy as np

from limb_systems.files.trajectory import Trajectory
from limb_systems.limb import split_state
from limb_systems.limb_parameters import LimbParameters
from limb_systems.monte_carlo import OpenLoop, draw_limbs, stack_limbs

MEMBERS = 64
STEP = 0.25  # s, of simulation
BEND_QUANTILE = 1.96  # standard deviations, of 95% of the limbs
READING_QUANTILE = 2.6  # of 995 of 1000 limbs, on one side, for each of two wires
DEVIATIONS = 2.0  # of predicted temperatures, by which calibrated limbs stay below T_max
# A thermocouple sits between its wire and colder silicone, and may show this share too little of
# the wire's excess over the room. No reading tells how much it is.
UNREAD_SHARE = 0.12
MAX_MARGIN = 15.0  # °C, as of plans of limbs that are not calibrated
MEAN_TO_DEVIATION = 1.25  # of the mean of |x| to the standard deviation of x, if x is normal


@dataclasses.dataclass(frozen=True, eq=False)
class Band:
    """Where a limb of one segment may be that is driven with a plan's duty, open loop.

    - ``time``: time since the start of the plan (M,), s.
    - ``bend_angle``: half-width of the band about φ* in which the true bend of 95% of all
      limbs stays (M,), rad.
    - ``bend_reading``: half-width of the band in which 95% of all bend sensors read, with
      noise and drift (M,), rad.
    - ``wire_temperature``, ``measured_temperature``: distance above the plan's T and V that
      995 of 1000 limbs keep within, for each wire (W, M), °C.
    - ``highest_readings``: highest V of each wire that 995 of 1000 limbs keep within (W,), °C.
    """

    time: np.ndarray
    bend_angle: np.ndarray
    bend_reading: np.ndarray
    wire_temperature: np.ndarray
    measured_temperature: np.ndarray
    highest_readings: np.ndarray


def temperature_margin(parameters: LimbParameters) -> float:
    """How far below T_max the model's wires stay, °C, so that those of the limb stay below it, too.

    It is twice the standard deviation of predicted temperatures, and what thermocouples do not
    show; zero if the limb is not calibrated, as nothing is known then.
    """
    record = parameters.calibration
    if record is None:
        return 0.0
    unshown = parameters.temperature_limits.maximum - parameters.ambient_temperature
    unshown *= UNREAD_SHARE / (1.0 + UNREAD_SHARE)
    margin = DEVIATIONS * MEAN_TO_DEVIATION * record.temperature_error + unshown
    return min(margin, MAX_MARGIN)


def band(trajectory: Trajectory) -> Band | None:
    """The band about a plan, from the covariance of its limb's calibration.

    What the form of the law leaves is in it as well: the errors with which the
    calibration predicted motions that it was not fitted to.

    Returns:
        None if the limb is not calibrated by prediction, or has several bends.
    """
    parameters, plan = trajectory.parameters, trajectory.since_start()
    record = parameters.calibration
    if record is None or not record.bend_error or plan.model.layout.num_bends > 1:
        return None
    num_steps = max(1, int(np.ceil(plan.duration / STEP)))
    ends = np.linspace(0.0, plan.duration, num_steps + 1)
    duty = plan.duty_trajectory().vector_values((ends[:-1] + ends[1:]) / 2).T
    limbs = [parameters, *draw_limbs(parameters, MEMBERS)]
    law, ambient, rubber = stack_limbs(limbs)
    states, readings = split_state(parameters, plan.state[:, 0])[2:]
    num_wires = len(parameters.wires)
    of_laws = len(law.states) * num_wires
    initial = [*states[:of_laws].reshape(-1, num_wires), readings]
    open_loop = OpenLoop(duty[:, np.newaxis], ends[1], parameters.segments[0])
    temperature, reading, bend = open_loop.simulate(
        law,
        ambient[:, np.newaxis],
        [np.broadcast_to(value, (len(limbs), 1, num_wires)) for value in initial],
        rubber,
    )
    temperature, reading, bend = temperature[:, :, 0], reading[:, :, 0], bend[:, :, 0]
    bend_form = MEAN_TO_DEVIATION * record.bend_error
    bend_deviation = np.hypot(bend[:, 1:].std(axis=1), bend_form)
    sensor = parameters.segments[0].bend_sensor
    heat_form = MEAN_TO_DEVIATION * record.temperature_error

    def above(signals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far limbs are above the first (.., W) on average, and their standard deviation."""
        mean = signals[..., 1:, :].mean(axis=-2) - signals[..., 0, :]
        return np.maximum(0.0, mean), np.hypot(signals[..., 1:, :].std(axis=-2), heat_form)

    def quantile(signals: np.ndarray) -> np.ndarray:
        mean, spread = above(signals)
        return mean + READING_QUANTILE * spread

    highest = reading.max(axis=0)
    return Band(
        time=ends,
        bend_angle=BEND_QUANTILE * bend_deviation,
        bend_reading=BEND_QUANTILE
        * np.linalg.norm(np.broadcast_arrays(bend_deviation, sensor.noise, sensor.drift), axis=0),
        wire_temperature=quantile(temperature).T,
        measured_temperature=quantile(reading).T,
        highest_readings=highest[0] + quantile(highest),
    )
