"""Estimates with their uncertainty."""

import dataclasses
from typing import Any

import numpy as np
from scipy.special import ndtri, stdtrit

from limb_systems import CalibrationRecord


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A value and its standard error, in the unit.

    Standard errors from a few trials are widened, so that the truth is within
    1.96 of them in 95 of 100 cases as if there were many.
    """

    value: float
    standard_error: float
    unit: str
    may_be_zero: bool = False

    @property
    def is_determined(self) -> bool:
        """Whether the data determine it: its standard error is no larger than itself.

        What may be zero always counts as determined.
        """
        return self.may_be_zero or self.relative_error <= 1.0

    @property
    def relative_error(self) -> float:
        """Standard error over the size of the value."""
        return self.standard_error / max(abs(self.value), 1e-300)

    def __str__(self) -> str:
        if not self.is_determined:
            return f"{self.value:.4g} {self.unit} (the data do not determine it)"
        return f"{self.value:.4g} ± {self.standard_error:.2g} {self.unit}"


def record_of(
    estimates: dict[str, Estimate], covariance: np.ndarray, **more: Any
) -> CalibrationRecord:
    """Estimates as a limb's parameters have them, and what more their record has."""
    return CalibrationRecord(
        names=list(estimates),
        values=[estimate.value for estimate in estimates.values()],
        standard_errors=[estimate.standard_error for estimate in estimates.values()],
        covariance=covariance.tolist(),
        **more,
    )


def standard_error(values: np.ndarray) -> float:
    """Standard error of the mean of independent values (K,), widened for few by Student's t."""
    return pooled_spread(values - np.mean(values), 1) / float(np.sqrt(len(values)))


def pooled_spread(deviations: np.ndarray, num_groups: int) -> float:
    """Standard deviation of values, widened for few, from deviations from their groups' means (K,).

    There must be more values than groups.
    """
    free = len(deviations) - num_groups
    return float(np.sqrt(np.sum(deviations**2) / free) * _widening(free + 1))


def _widening(count: int) -> float:
    """Factor of standard errors that are estimated from so many samples, two or more."""
    return float(stdtrit(count - 1, 0.975) / ndtri(0.975))


def clustered_covariance(
    jacobian: np.ndarray,
    residuals: np.ndarray,
    clusters: np.ndarray,
    prior: np.ndarray | None = None,
) -> np.ndarray:
    """Covariance of a least-squares estimate whose residuals are correlated.

    By the jackknife over clusters, each left out in turn, to first order:

        (C - 1)/C Σ_c d_c d_cᵀ,   d_c = (JᵀJ - J_cᵀJ_c)⁻¹ J_cᵀ r_c

    Residuals may be correlated in any way within a cluster, as those of a
    drifting sensor are, but not between clusters (Cameron and Miller, A
    practitioner's guide to cluster-robust inference, 2015, "CR3"). Like other errors
    from few samples it is widened by Student's t, of C - 1 degrees of freedom.

    Args:
        jacobian: J of the residuals (K, P).
        residuals: r (K,).
        clusters: number of the cluster of each residual (K,).
        prior: Jacobian (P,) of a further residual of standard deviation 1,
            what was known beforehand.

    Returns:
        (P, P).
    """
    known = np.zeros((jacobian.shape[1],) * 2) if prior is None else np.outer(prior, prior)
    whole = jacobian.T @ jacobian + known
    numbers = np.unique(clusters)
    shifts = []
    for number in numbers:
        part, residual = jacobian[clusters == number], residuals[clusters == number]
        # A parameter at a bound that nothing depends on has no covariance, nor spoils the others'.
        shifts.append(np.linalg.pinv(whole - part.T @ part) @ (part.T @ residual))
    stacked, bread = np.array(shifts), np.linalg.pinv(whole)
    widening = _widening(len(numbers)) ** 2 * (len(numbers) - 1) / len(numbers)
    return widening * stacked.T @ stacked + bread @ known @ bread
