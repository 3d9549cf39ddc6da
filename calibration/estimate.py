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
        """Return whether its standard error is no larger than itself, or it may be zero."""
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
    estimates: dict[str, Estimate], covariance: np.ndarray, **further_fields: Any
) -> CalibrationRecord:
    """Return estimates, their covariance and further fields as a `CalibrationRecord`."""
    return CalibrationRecord(
        names=list(estimates),
        values=[estimate.value for estimate in estimates.values()],
        standard_errors=[estimate.standard_error for estimate in estimates.values()],
        covariance=covariance.tolist(),
        **further_fields,
    )


def standard_error(values: np.ndarray) -> float:
    """Return the standard error of the mean of values (K,), widened for few by Student's t."""
    return pooled_spread(values - np.mean(values), 1) / float(np.sqrt(len(values)))


def pooled_spread(deviations: np.ndarray, num_groups: int) -> float:
    """Return the standard deviation of values from their groups' means (K,), widened for few.

    There must be more values than groups.
    """
    free = len(deviations) - num_groups
    return float(np.sqrt(np.sum(deviations**2) / free) * _widening(free))


def _widening(degrees_of_freedom: int) -> float:
    """Return the factor of standard errors from so many degrees of freedom, by Student's t."""
    return float(stdtrit(degrees_of_freedom, 0.975) / ndtri(0.975))


def clustered_covariance(
    jacobian: np.ndarray,
    residuals: np.ndarray,
    clusters: np.ndarray,
    prior: np.ndarray | None = None,
) -> np.ndarray:
    """Return the covariance of a least-squares estimate whose residuals are correlated.

    By the jackknife over clusters, each left out in turn, to first order:

        (C - 1)/C Σ_c d_c d_cᵀ,   d_c = (JᵀJ - J_cᵀJ_c)⁻¹ J_cᵀ r_c

    Residuals may be correlated in any way within a cluster, as a drifting
    sensor's are, but not between clusters (Cameron and Miller, A
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
    prior = np.zeros(jacobian.shape[1]) if prior is None else prior
    prior_information = np.outer(prior, prior)
    information = jacobian.T @ jacobian + prior_information
    numbers = np.unique(clusters)
    # Shift of the estimate when each cluster is left out.
    shifts = []
    for number in numbers:
        part = jacobian[clusters == number]
        residual = residuals[clusters == number]
        # A parameter at a bound that nothing depends on has no covariance, nor spoils the others'.
        shifts.append(np.linalg.pinv(information - part.T @ part) @ (part.T @ residual))
    stacked_shifts = np.array(shifts)
    inverse_information = np.linalg.pinv(information)
    # Add the scatter of these shifts and the error of the prior.
    widening = _widening(len(numbers) - 1) ** 2 * (len(numbers) - 1) / len(numbers)
    return (
        widening * stacked_shifts.T @ stacked_shifts
        + inverse_information @ prior_information @ inverse_information
    )
