"""Where the tracking error comes from, by swapping one thing for another.

From the plan to what the sensor reads of the limb there are five bend angles,
each with one thing swapped against the one before:

1. φ*, the plan;
2. the simulated model with the calibrated parameters, which differs by collocation;
3. the simulated model with the parameters that describe this limb best, which
   differs by the errors of calibration;
4. the limb, as a sensor without errors sees it, which differs by the model's form;
5. the limb as its bend sensor reads it.
"""

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lsim

from evaluation.experiment import Experiment, Motion
from limb_systems import Limb, LimbParameters, simulate

STEPS = {
    "collocation": "plan against the simulated model",
    "parameters": "calibrated model against the model with this limb's best parameters",
    "form of the model": "model with the best parameters against the limb",
    "bend sensor": "limb against what its sensor reads",
}


def error_split(experiment: Experiment) -> dict[str, dict[str, tuple[float, float]]]:
    """Splits the error of the first rollout of each motion.

    Returns:
        For each motion and each of `STEPS` the mean absolute difference that
        the step makes, and what would be left of the tracking error without
        it, degrees.
    """
    best = best_parameters(experiment)
    result = {}
    for motion in experiment.motions:
        trajectory, measured = motion.trajectory.since_start(), motion.rollouts[0]
        angles = [trajectory.bend_angle_at(measured.time)]
        for limb in (experiment.calibration.parameters, best):
            angles.append(simulate(Limb(limb), trajectory).bend_angle)
        angles += [motion.exact.bend_angle, measured.bend_angle]
        length = min(angle.shape[1] for angle in angles)  # one that was aborted counts up to then
        steps = np.rad2deg(np.diff([angle[0, :length] for angle in angles], axis=0))
        whole = steps.sum(axis=0)
        result[motion.name] = {
            name: (np.abs(step).mean(), np.abs(whole - step).mean())
            for name, step in zip(STEPS, steps, strict=True)
        }
    return result


def best_parameters(experiment: Experiment) -> LimbParameters:
    """The parameters with which the model of Sec. IV describes a limb best.

    Stiffness, damping, ambient temperature and the thermocouples' lag are the
    limb's true values. The limb has no true a1 and a2, so these are fitted in
    hindsight to the bend angle in all motions, by least squares. β stays as
    calibrated, because only the product of a2 and β matters.
    """
    limb = experiment.specimen.mechanics()
    (segment,) = limb.segments
    wires = segment.wires
    for wire, calibrated in zip(wires, experiment.calibration.parameters.wires, strict=True):
        wire.linear_law.a1, wire.linear_law.a2, wire.linear_law.beta = (
            calibrated.linear_law.a1,
            calibrated.linear_law.a2,
            calibrated.linear_law.beta,
        )

    def apply(logarithms: np.ndarray) -> None:
        for wire, (cooling, heating) in zip(wires, np.exp(logarithms).reshape(2, 2), strict=True):
            wire.linear_law.a1, wire.linear_law.a2 = -cooling, heating

    def residuals(logarithms: np.ndarray) -> np.ndarray:
        apply(logarithms)
        return np.concatenate(
            [
                _static_bend(limb, motion) - motion.exact.bend_angle[0]
                for motion in experiment.motions
            ]
        )

    start = np.log([[-wire.linear_law.a1, wire.linear_law.a2] for wire in wires]).ravel()
    apply(least_squares(residuals, start).x)
    return limb


def _static_bend(limb: LimbParameters, motion: Motion) -> np.ndarray:
    """φ (K,), rad, by (6) and (12): the limb follows its wires without delay."""
    (segment,) = limb.segments
    times = motion.exact.time
    duty = motion.trajectory.since_start().duty_trajectory().vector_values(times)
    torque = np.zeros_like(times)
    for wire, course in zip(segment.wires, duty, strict=True):
        _, rise, _ = lsim(
            ([[wire.linear_law.a1]], [[wire.linear_law.a2]], [[1.0]], [[0.0]]), course, times
        )
        torque += wire.direction * wire.linear_law.beta * rise
    return (segment.links + 1) / 2 * torque / segment.stiffness
