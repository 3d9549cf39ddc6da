"""Derivatives of functions that work element by element on arrays.

First derivatives are complex steps, exact to rounding; second derivatives are
central differences of them, right to nine digits if the functions are smooth.
"""

from collections.abc import Callable

import numpy as np

_STEP = 1e-30  # imaginary, of a complex step
_DIFFERENCE = 2e-6  # of central differences, in typical changes


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

    rows = [[np.zeros(1)] * len(arguments) for _ in arguments]
    for i, scale in enumerate(scales):
        distance = _DIFFERENCE * scale
        for j in range(i + 1):
            sides = []
            for side in (distance, -distance):
                moved = list(arguments)
                moved[i] = moved[i] + side
                moved[j] = moved[j] + 1j * _STEP
                sides.append(
                    np.broadcast_arrays(*map(np.imag, function(moved)), *arguments)[
                        : -len(arguments)
                    ]
                )
            above, below = (np.array(side) for side in sides)
            rows[i][j] = rows[j][i] = (above - below) / (_STEP * 2 * distance)
    return np.moveaxis(np.array(rows), 2, 0)
