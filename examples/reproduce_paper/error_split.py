"""Split the tracking error into its sources.

Between the plan and the sensor's reading there are five bend angles. Each differs from the
previous angle in one source of error:

1. φ*, the plan;
2. the simulated model with the calibrated parameters, which differs by collocation;
3. the model with the parameters that describe this limb's motions best, which
   differs by the errors of calibration;
4. the limb, as a sensor without errors sees it, which differs by the model's form;
5. the limb as its bend sensor reads it.

All are compared at the samples that Table I counts. At each sample, the four differences add up
to the tracking error.
"""

from collections.abc import Mapping

import numpy as np

from calibration.calibrate import Calibration
from calibration.prediction.heated_run import HeatedRun
from calibration.prediction.law_fit import fit_law
from calibration.prediction.selection import rubber_options
from limb_systems import Limb, simulate
from limb_systems.tracking import true_bend
from reproduce_paper.driving import PlanWithRollouts

# For each of `STEPS`: its mean absolute difference, and its part of the error, degrees.
Split = dict[str, tuple[float, float]]
STEPS = {
    "collocation": "plan against the simulated model",
    "parameters": "calibrated model against the same law with this limb's best parameters",
    "form of the model": "that law with the best parameters against the limb",
    "bend sensor": "limb against what its sensor reads",
}


def error_split(
    calibration: Calibration, motions: Mapping[str, PlanWithRollouts]
) -> dict[str, Split]:
    """Split the error of the first open-loop rollout of each motion.

    The best parameters belong to the law that was calibrated. They are fitted in hindsight to
    the true bend and the readings of all motions.

    Args:
        calibration: the limb's calibration, by prediction error.
        motions: plan and rollouts by motion.

    Returns:
        The `Split` of each motion. In the part of a step, a difference is positive if it has the
        sign of the error, and negative otherwise. So the parts add up to the mean tracking error.
    """
    # Fit the best parameters in hindsight, to the true bend.
    assert calibration.prediction is not None
    fit = calibration.prediction.fit
    truths = [true_bend(way.rollouts[0]) for way in motions.values()]
    runs = [HeatedRun.of(truth) for truth in truths]
    best = fit_law(
        fit.law, runs, fit.segment, fit.ambient, rubber=rubber_options(fit), start=fit
    ).predicted
    result = {}
    for (name, way), truth, hindsight in zip(motions.items(), truths, best, strict=True):
        # Simulate the calibrated model, and take all angles at the counted samples.
        rollout = way.rollouts[0]
        trajectory = way.trajectory.since_start()
        counted = (rollout.time <= trajectory.duration) & ~rollout.implausible
        times = rollout.time[counted]
        start = trajectory.state[:, 0]
        model = simulate(Limb(calibration.parameters), trajectory, initial_state=start)
        angles = [
            trajectory.bend_angle_at(times)[0],
            np.interp(times, model.time, model.bend_angle[0]),
            np.interp(times, hindsight.run.times, hindsight.bend[:, 0]),
            truth.bend_angle[0, counted],
            rollout.bend_angle[0, counted],
        ]
        # Split the error between neighbouring angles.
        steps = np.rad2deg(np.diff(angles, axis=0))
        sign = np.sign(steps.sum(axis=0))
        sizes = np.abs(steps).mean(axis=1).tolist()
        parts = (sign * steps).mean(axis=1).tolist()
        result[name] = dict(zip(STEPS, zip(sizes, parts, strict=True), strict=True))
    return result
