"""Sequential convex programming: steps towards the solutions of programs linearized at a point."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

Point = TypeVar("Point")


def descend(
    point: Point,
    cost: float,
    solve: Callable[[Point], Point | None],
    step: Callable[[Point, Point, float], tuple[Point, float]],
    rounds: int,
    least_reduction: float,
) -> tuple[Point, float, bool]:
    """Solve the convex program at a point and step towards its solution, repeatedly.

    Args:
        point, cost: the start, and its cost.
        solve: returns the solution of the convex program at a point; None if there is none.
        step: returns a point between a point of some cost and a solution, and its cost.
        rounds: the largest number of steps.
        least_reduction: relative; a round that reduces the cost by less is the last.

    Returns:
        The last point that reduced the cost; its cost; whether a program was solved.
    """
    solved = False
    for _ in range(rounds):
        best = solve(point)
        if best is None:
            break
        solved = True
        tried, new_cost = step(point, best, cost)
        if not new_cost < cost:
            break
        reduction = 1.0 - new_cost / cost
        point = tried
        cost = new_cost
        if reduction < least_reduction:
            break
    return point, cost, solved


def backtracking_step(
    shares: Sequence[float], cost_of: Callable[[np.ndarray], float]
) -> Callable[[np.ndarray, np.ndarray, float], tuple[np.ndarray, float]]:
    """Return a `step` by the first of some shares of the way that reduces the cost."""

    def step(point: np.ndarray, best: np.ndarray, cost: float) -> tuple[np.ndarray, float]:
        for share in shares:
            tried = point + share * (best - point)
            if (new_cost := cost_of(tried)) < cost:
                return tried, new_cost
        return point, cost

    return step
