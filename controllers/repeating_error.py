"""The part of an error that is the same in every repetition, from noisy repetitions."""

import copy

import numpy as np
from numpy.typing import ArrayLike


def wandering(times: np.ndarray, deviation: ArrayLike, duration: float) -> np.ndarray:
    """Covariance (M, M) at times (M,) of what wanders with a standard deviation, () or (M,).

    Its correlation falls to 1/e over the duration, s.
    """
    deviation = np.broadcast_to(deviation, times.shape)
    apart = np.abs(np.subtract.outer(times, times))
    return np.outer(deviation, deviation) * np.exp(-apart / duration)


class RepeatingError:
    """A Kalman filter over repetitions, for a course d (M,) that nearly repeats.

    Repetition j shows H d + noise, and d changes a little between repetitions. Of
    each repetition's error, the filter believes what the covariances say: most of the
    first one's, ever less of later ones'.

    - ``mean``: the estimate of d (M,), zero at first.
    - ``covariance``: of its error (M, M).

    Args:
        covariance: of d before the first repetition (M, M).
        shows: H (R, M).
        noise: covariance of a repetition's noise (R, R).
    """

    def __init__(self, covariance: np.ndarray, shows: np.ndarray, noise: np.ndarray):
        self.mean, self.covariance = np.zeros(len(covariance)), covariance
        self._shows, self._noise = shows, noise

    def change(self, covariance: np.ndarray) -> None:
        """Between two repetitions d has changed by something of this covariance (M, M)."""
        self.covariance = self.covariance + covariance

    def observe(self, shown: np.ndarray) -> None:
        """A repetition has shown these errors (R,), NaN where it showed none."""
        seen = np.isfinite(shown)
        H = self._shows[seen]
        together = H @ self.covariance
        of_errors = together @ H.T + self._noise[np.ix_(seen, seen)]
        gain = np.linalg.solve(of_errors, together).T
        self.mean = self.mean + gain @ (shown[seen] - H @ self.mean)
        after = self.covariance - gain @ together
        self.covariance = 0.5 * (after + after.T)

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviation of the estimate's error (M,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def after_another(self, change: np.ndarray) -> "RepeatingError":
        """The estimate after a change and another whole repetition that shows what it expects."""
        other = copy.copy(self)
        other.change(change)
        other.observe(self._shows @ self.mean)
        return other
