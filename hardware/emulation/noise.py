"""Noise whose state in a Context is only the number of the next draw."""

import numpy as np


class Noise:
    """Standard normal numbers in the order in which a generator draws them.

    A system keeps in its state how many numbers it has used. It therefore
    continues with the same numbers from every copy of its Context, because numbers
    that were drawn once are kept. With a plain generator it would not.
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
