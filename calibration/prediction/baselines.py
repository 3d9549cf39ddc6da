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
    """Return by name the bends of runs (M, F), rad, as baselines that are fitted to others predict.

    The baselines are the mean bend, and a lag of each wire: the sum of what is proportional to the
    heat of each wire, after the delay that fits best.
    """
    mean = np.nanmean(np.concatenate([run.bend for run in fitted]), axis=0)
    # Take the time constant with which a lag fits best.
    by_lag = min((_fit_lag(fitted, delay) for delay in DELAYS), key=lambda lag: lag[0])
    _, delay, gains = by_lag
    return {
        MEAN: [mean] * len(judges),
        "a lag of each wire": [_lag_factors(run, delay) @ gains for run in judges],
    }


def baseline_errors(fitted: Sequence[HeatedRun], judges: Sequence[HeatedRun]) -> dict[str, float]:
    """Return by name how far `baselines` miss the bends of runs, rad."""
    return {name: _mean_error(judges, bends) for name, bends in baselines(fitted, judges).items()}


def _lag_factors(run: HeatedRun, delay: float) -> np.ndarray:
    """Return what a lag adds up at the samples (M, W + 1)."""
    return np.column_stack([heat_by_duty(run, delay), np.ones(len(run.times))])


def _fit_lag(runs: Sequence[HeatedRun], delay: float) -> tuple[float, float, np.ndarray]:
    """Return the misfit of a lag, its delay and its gains (W + 1, F), rad."""
    factors = np.concatenate([_lag_factors(run, delay) for run in runs])
    bends = np.concatenate([run.bend for run in runs])
    is_read = ~np.isnan(bends).any(axis=1)
    # The gains follow from linear least squares.
    gains = np.linalg.lstsq(factors[is_read], bends[is_read], rcond=None)[0]
    return float(((bends - factors @ gains)[is_read] ** 2).sum()), delay, gains


def _mean_error(runs: Sequence[HeatedRun], bends: Sequence[np.ndarray]) -> float:
    """Return the mean distance from the bends of runs, rad, as `Candidate.bend_error`."""
    distances = [
        np.linalg.norm(run.bend - bend, axis=1) for run, bend in zip(runs, bends, strict=True)
    ]
    return float(np.mean([np.nanmean(each) for each in distances]))
