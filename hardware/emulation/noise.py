"""Noise that lives in a Context: the number of the next draw is all there is to keep."""

import numpy as np


class Noise:
    """Standard normal numbers in the order in which a generator draws them.

    A system that keeps how many it has used in its state goes on alike from
    every copy of its Context, which one generator for all of them would not
    let it do: numbers that were drawn once are kept for the others.
    """

    def __init__(self, generator: np.random.Generator):
        self._generator = generator
        self._numbers = np.empty(0)

    def read(self, start: int, count: int) -> np.ndarray:
        """The numbers from ``start`` on, (count,)."""
        missing = start + count - len(self._numbers)
        if missing > 0:
            more = self._generator.standard_normal(max(missing, len(self._numbers), 1000))
            self._numbers = np.concatenate([self._numbers, more])
        return self._numbers[start : start + count]
