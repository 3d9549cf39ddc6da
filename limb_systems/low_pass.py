"""The first-order low-pass filter: heat follows duty and a reading follows heat by it."""

from collections.abc import Sequence

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
    gained = (1.0 - decay if gain is None else gain) * np.asarray(signal, float)
    return feed_back(gained, [decay], axis)


def feed_back(signal: np.ndarray, shares: Sequence[float], axis: int = -1) -> np.ndarray:
    """Return y_k = x_k + Σ_i shares_i y_k-i of a signal x in equal steps, from y = 0 on.

    It solves these equations at once, as scipy.signal takes longer to import than all the rest.

    Args:
        signal: x, any shape.
        shares: the shares of y that is one step old, two steps old, and so on.
        axis: axis of time.
    """
    values = np.moveaxis(signal, axis, 0)
    if not values.size:
        return signal
    # The equations are triangular, with as many bands below the diagonal as there are shares.
    bands = np.ones((1 + len(shares), len(values)))
    bands[1:] = -np.array(shares)[:, None]
    solution, _ = dtbtrs(bands, values.reshape(len(values), -1), uplo="L", diag="U")
    return np.moveaxis(solution.reshape(values.shape), 0, axis)
