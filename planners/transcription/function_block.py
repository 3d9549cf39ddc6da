"""One smooth function at many points of a program, as a block of constraints."""

from collections.abc import Collection
from typing import Protocol

import numpy as np
from pydrake.solvers import Binding


class PointFunction(Protocol):
    """A function of points (..., P) with values (..., Q), such as a `SmoothFunction`."""

    num_values: int

    @property
    def slope_places(self) -> np.ndarray:
        """Indices of value and variable of each derivative that may not be zero (2, Z)."""

    @property
    def curvature_places(self) -> np.ndarray:
        """Indices i >= j of the variables of each second derivative that may not be zero (2, Z)."""

    def values(self, points: np.ndarray) -> np.ndarray:
        """Return the values (..., Q)."""

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """Return the derivatives at the ``slope_places`` (..., Z)."""

    def curvatures(self, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return second derivatives of weights (..., Q) · values at their places (..., Z)."""


class FunctionBlock:
    """A block of constraints: f(p_k) = y_k, or within bounds, at K points.

    It is a `planners.transcription.ipopt.ConstraintBlock`.

    Args:
        function: f.
        points: indices of the variables of each p_k among the variables of the program (K, P).
        targets: indices of y_k (K, Q); y_k is zero if None.
        scales: typical sizes of the values (Q,); rows are divided by them.
        bounds: lower and upper bounds of f(p_k) (K, Q); both are zero if None.
    """

    replaces: Collection[Binding] = ()

    def __init__(
        self,
        function: PointFunction,
        points: np.ndarray,
        targets: np.ndarray | None = None,
        scales: np.ndarray | float = 1.0,
        bounds: tuple[np.ndarray, np.ndarray] | None = None,
    ):
        self._function = function
        self._points = points
        self._targets = targets
        K = len(points)
        Q = function.num_values
        self._scales = np.broadcast_to(scales, Q)
        lower, upper = bounds or np.zeros((2, K, Q))
        self.lower = (lower / self._scales).ravel()
        self.upper = (upper / self._scales).ravel()
        # Places of the Jacobian's nonzeros, for all points, then for the targets.
        self._rows, columns = function.slope_places
        self.rows = (Q * np.arange(K) + self._rows[:, None]).ravel()
        self.columns = points.T[columns].ravel()
        if targets is not None:
            self.rows = np.append(self.rows, np.arange(K * Q))
            self.columns = np.append(self.columns, targets)
        # Places of the Hessian's nonzeros.
        rows, columns = function.curvature_places
        self.hessian_rows = points.T[rows].ravel()
        self.hessian_columns = points.T[columns].ravel()

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        values = self._function.values(x[self._points])
        if self._targets is not None:
            values = values - x[self._targets]
        return (values / self._scales).ravel()

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        slopes = self._function.slopes(x[self._points]).T / self._scales[self._rows, None]
        slopes = slopes.ravel()
        if self._targets is None:
            return slopes
        return np.append(slopes, np.tile(-1.0 / self._scales, len(self._points)))

    def hessian(self, x: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        weights = multipliers.reshape(len(self._points), -1) / self._scales
        return self._function.curvatures(x[self._points], weights).T.ravel()
