"""The part of an error that is the same in every repetition, from noisy repetitions."""

import numpy as np


def wandering(times: np.ndarray, deviation, duration: float) -> np.ndarray:
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
        gain, H = self._gain(seen)
        self.mean = self.mean + gain @ (shown[seen] - H @ self.mean)
        self.covariance = self._after(gain, H)

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviation of the estimate's error (M,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def next_deviation(self) -> np.ndarray:
        """``deviation`` after another whole repetition (M,), whatever it shows."""
        after = self._after(*self._gain(np.ones(len(self._noise), bool)))
        return np.sqrt(np.maximum(np.diag(after), 0.0))

    def _gain(self, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        H = self._shows[seen]
        of_errors = H @ self.covariance @ H.T + self._noise[np.ix_(seen, seen)]
        return np.linalg.solve(of_errors, H @ self.covariance).T, H

    def _after(self, gain: np.ndarray, H: np.ndarray) -> np.ndarray:
        after = self.covariance - gain @ H @ self.covariance
        return 0.5 * (after + after.T)
