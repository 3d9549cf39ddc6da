"""The simplest predictions of bends, which a law must not be worse than."""

from collections.abc import Sequence

import numpy as np

from calibration.prediction.heated_run import STEP, HeatedRun
from limb_systems.low_pass import low_pass

MEAN = "the mean"
DELAYS = (2.0, 4.0, 8.0, 16.0, 32.0)  # s, time constants that are tried


def heat_by_duty(run: HeatedRun, delay: float) -> np.ndarray:
    """Return the heat of wires by their duty alone at the samples (M, W), as a share of full duty.

    Args:
        delay: time constant of the heat, s.
    """
    heat = low_pass(run.duty, np.exp(-STEP / delay), axis=0)
    return run.interpolated(np.vstack([np.zeros_like(heat[:1]), heat]))


def baselines(
    fitted: Sequence[HeatedRun], judges: Sequence[HeatedRun]
) -> dict[str, list[np.ndarray]]:
    """Predict the F bends of runs, the judges, by baselines that are fitted to other runs.

    The baselines are the mean bend, and a lag of each wire: the sum of what is proportional to the
    heat of each wire, after the delay that fits best.

    Returns:
        The bends of each run, (F,) or (M, F), rad, by the baseline's name.
    """
    bends = np.concatenate([run.bend for run in fitted])
    is_read = ~np.isnan(bends).any(axis=1)

    def lag_factors(run: HeatedRun, delay: float) -> np.ndarray:
        """Return the heat of each wire by its duty, and a constant 1, at the samples (M, W + 1)."""
        return np.column_stack([heat_by_duty(run, delay), np.ones(len(run.times))])

    # Take the time constant with which a lag fits best; its gains follow from least squares.
    fits = []
    for delay in DELAYS:
        factors = np.concatenate([lag_factors(run, delay) for run in fitted])
        gains = np.linalg.lstsq(factors[is_read], bends[is_read], rcond=None)[0]
        misfit = float(((bends - factors @ gains)[is_read] ** 2).sum())
        fits.append((misfit, delay, gains))
    _, delay, gains = min(fits, key=lambda fit: fit[0])
    lagged_bends = [lag_factors(run, delay) @ gains for run in judges]
    return {MEAN: [np.nanmean(bends, axis=0)] * len(judges), "a lag of each wire": lagged_bends}


def baseline_errors(fitted: Sequence[HeatedRun], judges: Sequence[HeatedRun]) -> dict[str, float]:
    """Return the mean |φ - φ_predicted| of each of the `baselines` over runs, rad, by its name."""
    errors: dict[str, float] = {}
    for name, predicted_bends in baselines(fitted, judges).items():
        run_errors = []
        for run, bend in zip(judges, predicted_bends, strict=True):
            run_errors.append(np.nanmean(np.linalg.norm(run.bend - bend, axis=1)))
        errors[name] = float(np.mean(run_errors))
    return errors
