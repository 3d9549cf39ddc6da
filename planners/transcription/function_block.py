"""One smooth function at many points of a program, as a block of constraints."""

import functools
from collections.abc import Callable, Collection
from typing import Protocol

import numpy as np
from pydrake.solvers import Binding


class PointFunction(Protocol):
    """A function of points (..., P) with values (..., Q), such as a `SmoothFunction`.

    It may have parameters, by which there are no derivatives.
    """

    num_values: int

    @property
    def slope_places(self) -> np.ndarray:
        """Indices of value and variable of each derivative that may not be zero (2, Z)."""

    @property
    def curvature_places(self) -> np.ndarray:
        """Indices i >= j of the variables of each second derivative that may not be zero (2, Z)."""

    @property
    def values(self) -> Callable[..., np.ndarray]:
        """The function that returns the values (..., Q) for points and parameters."""

    @property
    def slopes(self) -> Callable[..., np.ndarray]:
        """The function that returns derivatives (..., Z) at the ``slope_places``, as ``values``."""

    @property
    def curvatures(self) -> Callable[..., np.ndarray]:
        """The function that returns second derivatives of weights · values at their places.

        Its arguments are points, weights (..., Q) and parameters.
        """


class FunctionBlock:
    """A block of constraints: f(p_k) = y_k, or within bounds, at K points.

    It is a `planners.transcription.ipopt.ConstraintBlock`.

    Args:
        function: f.
        points: indices of the variables of each p_k among the variables of the program (K, P).
        targets: indices of y_k (K, Q); y_k is zero if None.
        scales: typical sizes of the values (Q,); rows are divided by them.
        bounds: lower and upper bounds of f(p_k) (K, Q); both are zero if None.
        parameters: indices of variables that the program fixes (K, ...), f's parameters.
    """

    replaces: Collection[Binding] = ()

    def __init__(
        self,
        function: PointFunction,
        points: np.ndarray,
        targets: np.ndarray | None = None,
        scales: np.ndarray | float = 1.0,
        bounds: tuple[np.ndarray, np.ndarray] | None = None,
        parameters: np.ndarray | None = None,
    ):
        self._function = function
        self._points = points
        self._targets = targets
        self._parameters = [] if parameters is None else [parameters]
        num_points = len(points)
        num_values = function.num_values
        self._scales = np.broadcast_to(scales, num_values)
        lower, upper = bounds or np.zeros((2, num_points, num_values))
        self.lower = (lower / self._scales).ravel()
        self.upper = (upper / self._scales).ravel()

    @functools.cached_property
    def rows(self) -> np.ndarray:
        first_rows = self._function.num_values * np.arange(len(self._points))
        rows = (first_rows + self._function.slope_places[0][:, None]).ravel()
        return rows if self._targets is None else np.append(rows, np.arange(self._targets.size))

    @functools.cached_property
    def columns(self) -> np.ndarray:
        columns = self._points.T[self._function.slope_places[1]].ravel()
        return columns if self._targets is None else np.append(columns, self._targets)

    @functools.cached_property
    def hessian_rows(self) -> np.ndarray:
        return self._points.T[self._function.curvature_places[0]].ravel()

    @functools.cached_property
    def hessian_columns(self) -> np.ndarray:
        return self._points.T[self._function.curvature_places[1]].ravel()

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        values = self._function.values(*self._arguments(x))
        if self._targets is not None:
            values = values - x[self._targets]
        return (values / self._scales).ravel()

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        row_scales = self._scales[self._function.slope_places[0], None]
        slopes = (self._function.slopes(*self._arguments(x)).T / row_scales).ravel()
        if self._targets is None:
            return slopes
        return np.append(slopes, np.tile(-1.0 / self._scales, len(self._points)))

    def hessian(self, x: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        weights = multipliers.reshape(len(self._points), -1) / self._scales
        points, *parameters = self._arguments(x)
        return self._function.curvatures(points, weights, *parameters).T.ravel()

    def _arguments(self, x: np.ndarray) -> list[np.ndarray]:
        """Return the points (K, P) and the parameters, if there are any."""
        return [x[indices] for indices in (self._points, *self._parameters)]
