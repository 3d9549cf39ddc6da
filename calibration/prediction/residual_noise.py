"""The noise of residuals: white noise of the samples, and two processes with a memory."""

import numpy as np

from limb_systems.ragged_rows import RaggedRows


class ResidualNoise:
    """White noise and two Ornstein-Uhlenbeck processes in each of N signals of M samples in all.

    A Kalman filter of both processes takes from each residual what the residuals before it tell,
    and so it whitens them in a time that grows with their number alone.

    Args:
        rows: rows of the samples of all signals.
        times: times of the samples (M,), s.
        sample_variance: variance of the white noise (M,); inf where a sample is missing.
        sizes: standard deviations of the processes (2, N).
        memories: times within which the processes stay alike (2, N), s.
    """

    def __init__(
        self,
        rows: RaggedRows,
        times: np.ndarray,
        sample_variance: np.ndarray,
        sizes: np.ndarray,
        memories: np.ndarray,
    ):
        self._blocks = rows.blocks
        first = rows.blocks[0]  # of each signal, the longest first
        later = slice(first.stop, None)
        gaps = times[later] - times[rows.before]
        self._decays = np.ones((2, rows.count))  # since the sample before
        self._decays[:, later] = np.exp(-gaps / memories[:, rows.sequence[later]])
        self._gains = np.empty((2, rows.count))
        self._scales = np.empty(rows.count)
        variances = sizes[:, rows.sequence[first]] ** 2
        processes = np.arange(2)
        covariance = np.zeros((2, 2, first.stop))
        covariance[processes, processes] = variances
        for block in rows.blocks:
            # Forget since the sample before.
            num_signals = block.stop - block.start
            decay = self._decays[:, block]
            covariance = covariance[..., :num_signals] * decay[:, None] * decay
            covariance[processes, processes] += variances[:, :num_signals] * (1 - decay**2)
            # Learn from the sample.
            with_sum = covariance.sum(axis=0)
            variance = with_sum.sum(axis=0) + sample_variance[block]
            gain = with_sum / variance
            self._gains[:, block] = gain
            self._scales[block] = 1 / np.sqrt(variance)
            covariance -= gain[:, None] * with_sum

    def whiten(self, residuals: np.ndarray) -> np.ndarray:
        """Return residuals (M, B) as independent numbers of variance one; 0 where missing."""
        innovations = residuals.copy()
        gains = self._gains[..., None]
        decays = self._decays[..., None]
        means = np.zeros((2, self._blocks[0].stop, residuals.shape[1]))
        # Subtract from each residual what the residuals before it predict, and learn from the rest.
        for block in self._blocks:
            means = means[:, : block.stop - block.start] * decays[:, block]
            innovation = innovations[block]
            innovation -= means[0]
            innovation -= means[1]
            means += gains[:, block] * innovation
        innovations *= self._scales[:, None]
        return innovations
