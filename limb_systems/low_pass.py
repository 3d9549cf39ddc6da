"""The first-order low-pass filter: heat follows duty and a reading follows heat by it."""

import numpy as np
from numpy.typing import ArrayLike


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
    # scipy.signal takes longer to import than all the rest.
    from scipy.signal import lfilter

    return lfilter([1.0 - decay if gain is None else gain], [1.0, -decay], signal, axis=axis)
