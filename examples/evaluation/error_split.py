"""Where the tracking error comes from, by swapping one thing for another.

From the plan to what the sensor reads of the limb there are five bend angles,
each with one thing swapped against the one before:

1. φ*, the plan;
2. the simulated model with the calibrated parameters, which differs by collocation;
3. the model with the parameters that describe this limb's motions best, which
   differs by the errors of calibration;
4. the limb, as a sensor without errors sees it, which differs by the model's form;
5. the limb as its bend sensor reads it.
"""

import numpy as np

from calibration.course import STEP, Course
from calibration.prediction import fit_law
from calibration.selection import rubber_of
from evaluation.experiment import Experiment
from limb_systems import Limb, simulate

STEPS = {
    "collocation": "plan against the simulated model",
    "parameters": "calibrated model against the same law with this limb's best parameters",
    "form of the model": "that law with the best parameters against the limb",
    "bend sensor": "limb against what its sensor reads",
}


def error_split(experiment: Experiment) -> dict[str, dict[str, tuple[float, float]]]:
    """Splits the error of the first rollout of each motion, planned by prediction.

    The best parameters are those of the law that was calibrated, fitted in hindsight to
    the bend and the readings of all motions.

    Returns:
        For each motion and each of `STEPS` the mean absolute difference that
        the step makes, and what would be left of the tracking error without
        it, degrees.
    """
    calibration = experiment.calibration
    assert calibration.prediction is not None
    fit = calibration.prediction.fit
    courses = [Course.of(motion.exact) for motion in experiment.motions]
    best = fit_law(
        fit.law, courses, fit.segment, fit.ambient, rubber=rubber_of(fit), start=fit
    ).predicted
    result = {}
    for motion, hindsight in zip(experiment.motions, best, strict=True):
        trajectory, measured = motion.trajectory.since_start(), motion.rollouts[0]
        times = measured.time[: motion.exact.bend_angle.shape[1]]
        times = times[times <= motion.exact.time[-1]]
        model = simulate(Limb(calibration.parameters), trajectory)
        angles = [trajectory.bend_angle_at(times)[0]]
        angles.append(np.interp(times, model.time, model.bend_angle[0]))
        angles.append(np.interp(times, hindsight.course.times, hindsight.bend))
        angles += [motion.exact.bend_angle[0, : len(times)], measured.bend_angle[0, : len(times)]]
        # The hindsight is in steps, which all are averaged over.
        numbers = (times / STEP).astype(int)
        counts = np.bincount(numbers)
        means = [np.bincount(numbers, angle)[counts > 0] / counts[counts > 0] for angle in angles]
        steps = np.rad2deg(np.diff(means, axis=0))
        whole = steps.sum(axis=0)
        result[motion.name] = {
            name: (float(np.abs(step).mean()), float(np.abs(whole - step).mean()))
            for name, step in zip(STEPS, steps, strict=True)
        }
    return result
