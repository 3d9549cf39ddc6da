"""The noise of residuals: white noise of the samples, and two processes with a memory."""

import numpy as np


class ResidualNoise:
    """White noise and two Ornstein-Uhlenbeck processes in each of N signals, of M samples at most.

    A Kalman filter of both processes takes from each residual what the residuals before it tell,
    and so it whitens them in a time that grows with their number alone.

    Args:
        times: times of the samples (M, N), s.
        sample_variance: variance of the white noise (M, N); inf where a sample is missing.
        sizes: standard deviations of the processes (2, N).
        memories: times within which the processes stay alike (2, N), s.
    """

    def __init__(
        self,
        times: np.ndarray,
        sample_variance: np.ndarray,
        sizes: np.ndarray,
        memories: np.ndarray,
    ):
        num_samples, num_signals = times.shape
        gaps = np.diff(times, axis=0, append=times[-1:])
        self._decays = np.exp(-gaps[:, None] / memories)
        self._gains = np.empty((num_samples, 2, num_signals))
        self._scales = np.empty((num_samples, num_signals))
        processes = np.arange(2)
        covariance = np.zeros((2, 2, num_signals))
        covariance[processes, processes] = sizes**2
        for number, decay in enumerate(self._decays):
            # Learn from the sample.
            with_sum = covariance.sum(axis=0)
            variance = with_sum.sum(axis=0) + sample_variance[number]
            gain = with_sum / variance
            self._gains[number] = gain
            self._scales[number] = 1 / np.sqrt(variance)
            covariance -= gain[:, None] * with_sum
            # Forget until the next sample.
            covariance *= decay[:, None] * decay
            covariance[processes, processes] += sizes**2 * (1 - decay**2)

    def whiten(self, residuals: np.ndarray) -> np.ndarray:
        """Return residuals (M, N, B) as independent numbers of variance one; 0 where missing."""
        whitened = np.empty_like(residuals)
        means = np.zeros((2, *residuals.shape[1:]))
        steps = zip(
            residuals,
            self._gains[..., None],
            self._scales[..., None],
            self._decays[..., None],
            whitened,
            strict=True,
        )
        # Subtract from each residual what the residuals before it predict, and learn from the rest.
        for residual, gain, scale, decay, result in steps:
            innovation = residual - means[0] - means[1]
            np.multiply(innovation, scale, out=result)
            means += gain * innovation
            means *= decay
        return whitened
