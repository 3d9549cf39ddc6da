"""Sequences of different lengths in one array, without rows that no sequence has."""

import itertools
from collections.abc import Sequence

import numpy as np


class RaggedRows:
    """The rows of sequences of different lengths in one array of S rows.

    The rows of the first time come first. Each time has a row of each sequence that has not ended,
    the longest sequence first. So the rows of a time continue the first rows of the time before.

    - ``count``: S.
    - ``blocks``: rows of each time.
    - ``sequence``, ``time``: sequence and time of each row (S,).
    - ``of_sequence``: rows of each sequence, in the order of time.
    - ``before``: the row one time before each row that is not of the first time.

    Args:
        lengths: number of times that each sequence has, at least 1.
    """

    def __init__(self, lengths: Sequence[int] | np.ndarray):
        lengths = np.asarray(lengths)
        order = np.argsort(-lengths, kind="stable")
        counts = (lengths > np.arange(lengths.max())[:, None]).sum(axis=1)
        starts = np.concatenate([[0], np.cumsum(counts)])
        self.count = int(starts[-1])
        self.blocks = [slice(*ends) for ends in itertools.pairwise(starts.tolist())]
        self.sequence = np.concatenate([order[:count] for count in counts])
        self.time = np.repeat(np.arange(len(counts)), counts)
        self.before = np.arange(counts[0], self.count) - np.repeat(counts[:-1], counts[1:])
        self.of_sequence = [starts[: lengths[0]]] * len(lengths)
        for position, sequence in enumerate(order.tolist()):
            self.of_sequence[sequence] = starts[: lengths[sequence]] + position
