"""The first-order low-pass filter: heat follows duty and a reading follows heat by it."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dtbtrs


def low_pass(
    signal: ArrayLike, decay: float, gain: float | None = None, axis: int = -1
) -> np.ndarray:
    """Return y_k = decay y_k-1 + gain x_k of a signal x in equal steps, from y = 0 on.

    Args:
        signal: x, any shape.
        decay: share of y that is left after a step, such as exp(-step / time constant).
        gain: 1 - decay if None, so that y settles to x.
        axis: axis of time.
    """
    if gain is None:
        gain = 1.0 - decay
    driven = gain * np.moveaxis(np.asarray(signal, float), axis, 0)
    # All steps are one triangular system of equations with two diagonals: scipy.signal, which has
    # such filters, takes longer to import than all the rest.
    diagonals = np.ones((2, len(driven)))
    diagonals[1] = -decay
    columns = driven.reshape(len(driven), -1)
    filtered, _ = dtbtrs(diagonals, columns, uplo="L")
    return np.moveaxis(filtered.reshape(driven.shape), 0, axis)
