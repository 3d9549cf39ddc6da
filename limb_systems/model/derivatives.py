"""Derivatives of functions of which it is known what depends on what.

First derivatives are complex steps, exact to rounding; second derivatives are
central differences of them, right to nine digits if the functions are smooth.
"""

from collections.abc import Callable

import numpy as np

_STEP = 1e-30  # imaginary, of a complex step
_DIFFERENCE = 2e-6  # of central differences, in typical changes


class Derivatives:
    """First and second derivatives of functions of one pattern, at any number of points.

    Functions take points (..., P), real or complex, and return values (..., Q).
    Variables that no value depends on together are moved at once.

    - ``pattern``: true where a value depends on a variable (Q, P).
    - ``curvature``: true where a pair of variables may have a second derivative (P, P).

    Args:
        scales: typical changes of the variables (P,).
    """

    def __init__(self, pattern: np.ndarray, curvature: np.ndarray, scales: np.ndarray):
        self.pattern, self.curvature, self._scales = pattern, curvature, scales
        self._sets = _apart(pattern, np.flatnonzero(pattern.any(axis=0)))
        self._curved_sets = _apart(pattern, np.flatnonzero(curvature.any(axis=0)))

    def first(self, function: Callable[[np.ndarray], np.ndarray], points: np.ndarray) -> np.ndarray:
        """Derivatives (..., Q, P) of a function's values at points (..., P)."""
        result = np.zeros((*points.shape[:-1], *self.pattern.shape))
        for variables in self._sets:
            change = _change(function, points, variables)
            for variable in variables:
                values = self.pattern[:, variable]
                result[..., values, variable] = change[..., values] / _STEP
        return result

    def second(
        self,
        function: Callable[[np.ndarray], np.ndarray],
        points: np.ndarray,
        weights: np.ndarray,
    ) -> np.ndarray:
        """Second derivatives (..., P, P) of weights · function, for weights (..., Q)."""
        result = np.zeros((*points.shape, points.shape[-1]))
        for number, moved in enumerate(self._curved_sets):
            distances = np.zeros(points.shape[-1])
            distances[moved] = _DIFFERENCE * self._scales[moved]
            for variables in self._curved_sets[: number + 1]:
                if not self.curvature[np.ix_(moved, variables)].any():
                    continue
                above, below = (
                    _change(function, points + side, variables) for side in (distances, -distances)
                )
                for i in moved:
                    for j in variables:
                        values = self.pattern[:, i] & self.pattern[:, j]
                        if not (self.curvature[i, j] and values.any()):
                            continue
                        slopes = [(weights * by)[..., values].sum(axis=-1) for by in (above, below)]
                        result[..., i, j] = (slopes[0] - slopes[1]) / (_STEP * 2 * distances[i])
                        result[..., j, i] = result[..., i, j]
        return result


def _apart(pattern: np.ndarray, variables: np.ndarray) -> list[list[int]]:
    """Sets of variables of which no two are in the same value."""
    sets: list[list[int]] = []
    for variable in variables.tolist():
        for others in sets:
            if not (pattern[:, others].any(axis=1) & pattern[:, variable]).any():
                others.append(variable)
                break
        else:
            sets.append([variable])
    return sets


def _change(function, points: np.ndarray, variables: list[int]) -> np.ndarray:
    """What a complex step of variables, all at once, changes (..., Q), times the step."""
    moved = points.astype(complex)
    moved[..., variables] += 1j * _STEP
    return np.imag(function(moved))
