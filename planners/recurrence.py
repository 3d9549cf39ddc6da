"""Linear recurrences over the knots of a plan."""

import numpy as np


class LinearRecurrence:
    """x_(k+1) = F_k x_k + g_k from x_0 = 0, for many g.

    The knots are cut into chunks of √K knots. All chunks are followed at once from zero, and the
    products of F carry what the chunks before add.

    Args:
        factors: F_k (K, m, m).
    """

    def __init__(self, factors: np.ndarray):
        self._num_steps, size, _ = factors.shape
        self._length = length = max(1, int(np.ceil(np.sqrt(self._num_steps))))
        self._num_chunks = num_chunks = max(1, -(-self._num_steps // length))
        # Fill the last chunk with zeros.
        padded = np.zeros((num_chunks * length, size, size))
        padded[: self._num_steps] = factors
        self._factors = padded.reshape(num_chunks, length, size, size)
        # The products of all factors of a chunk up to each knot.
        self._products = np.empty_like(self._factors)
        self._products[:, 0] = self._factors[:, 0]
        for k in range(1, length):
            np.matmul(self._factors[:, k], self._products[:, k - 1], out=self._products[:, k])

    def solve(self, gains: np.ndarray) -> np.ndarray:
        """Return x_k (K + 1, m) for g_k (K, m)."""
        size = gains.shape[1]
        x = np.zeros((self._num_chunks * self._length, size, 1))
        x[: self._num_steps, :, 0] = gains
        x = x.reshape(self._num_chunks, self._length, size, 1)
        # Follow all chunks from zero.
        for k in range(1, self._length):
            x[:, k] += self._factors[:, k] @ x[:, k - 1]
        # Add what the ends of the chunks before bring.
        for chunk in range(1, self._num_chunks):
            x[chunk] += self._products[chunk] @ x[chunk - 1, -1]
        following = x.reshape(-1, size)[: self._num_steps]
        return np.vstack([np.zeros(size), following])
