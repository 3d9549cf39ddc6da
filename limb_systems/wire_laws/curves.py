"""Smooth curves that laws are made of, for numbers, arrays and symbols."""

from typing import Any

import numpy as np


def logistic(z: Any) -> Any:
    """1 / (1 + exp(-z))."""
    return 0.5 * (1.0 + np.tanh(0.5 * z))


def softplus(z: Any) -> Any:
    """ln(1 + exp(z)), where exp(z) may be too large for a number, too."""
    size = np.sqrt(z**2 + 1e-12)  # |z|, whose derivative all scalar types have at 0
    return 0.5 * (z + size) + np.log(1.0 + np.exp(-size))
