"""Derivatives of functions that work element by element on arrays.

First derivatives are complex steps, exact to rounding; second derivatives are
those of the Taylor polynomial through points on a small circle in the complex
plane, which are equally accurate if the functions are smooth.
"""

from collections.abc import Callable

import numpy as np

_STEP = 1e-30  # imaginary, of a complex step
_RADIUS = 0.01  # of the circle, in typical changes
_CIRCLE = np.exp(1j * np.pi / 8 * np.arange(9))  # its upper half; the other is complex conjugate


def gradients(
    function: Callable[[list], list], arguments: list[np.ndarray], scales: np.ndarray
) -> np.ndarray:
    """First derivatives at each element.

    Args:
        function: takes a list of P arrays and returns a list of Q arrays,
            whose elements only depend on the same elements of the arguments.
        arguments: arrays that broadcast to one shape. If they have
            infinitesimal imaginary parts, the result has them, too.
        scales: a typical change of each argument (P,).

    Returns:
        (Q, P, ...) of each output by each argument.
    """
    real = [argument.real for argument in arguments]
    rows = []
    for index in range(len(real)):
        moved = list(real)
        moved[index] = moved[index] + 1j * _STEP
        rows.append(
            np.broadcast_arrays(*[np.imag(o) / _STEP for o in function(moved)], *real)[: -len(real)]
        )
    first = np.array(rows).swapaxes(0, 1)
    if not any(np.iscomplexobj(argument) for argument in arguments):
        return first
    imaginary = np.array(np.broadcast_arrays(*[np.imag(argument) for argument in arguments]))
    return first + 1j * (hessians(function, real, scales) * imaginary).sum(axis=2)


def hessians(
    function: Callable[[list], list], arguments: list[np.ndarray], scales: np.ndarray
) -> np.ndarray:
    """Second derivatives at each element, (Q, P, P, ...); arguments as of `gradients`, but real."""

    def curvature(direction: np.ndarray) -> np.ndarray:
        """Second derivative along a direction in scaled arguments, for each output."""
        total = np.zeros(1)
        for number, turn in enumerate(_CIRCLE):
            moved = [
                argument + _RADIUS * turn * share
                for argument, share in zip(arguments, direction * scales, strict=True)
            ]
            values = np.array(np.broadcast_arrays(*function(moved), *arguments)[: -len(arguments)])
            weight = 1.0 if number in (0, 8) else 2.0
            total = total + weight * (values * turn**-2).real
        return total / (8 * _RADIUS**2)

    size = len(arguments)
    one = np.eye(size)
    rows = [[np.zeros(1)] * size for _ in range(size)]
    for i in range(size):
        rows[i][i] = curvature(one[i]) / scales[i] ** 2
        for j in range(i):
            mixed = (curvature(one[i] + one[j]) - curvature(one[i] - one[j])) / 4
            rows[i][j] = rows[j][i] = mixed / (scales[i] * scales[j])
    return np.moveaxis(np.array(rows), 2, 0)
