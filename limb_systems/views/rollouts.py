"""What pictures and charts say of several rollouts of a plan."""

from collections.abc import Sequence

import numpy as np

from limb_systems.files.recording import Recording

BAND = 1.96  # standard deviations that hold 95% of the rollouts


def how_recorded(recordings: Sequence[Recording]) -> str:
    """How recordings were made, in a word or two for labels."""
    return " and ".join(dict.fromkeys(recording.how for recording in recordings))


def mean_and_band(
    recordings: Sequence[Recording], samples: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, mean and half-width of the 95% band of rollouts; each as long as the shortest.

    Args:
        recordings: one or more, all with the same sample rate; times are the first's.
        samples: of one signal in each recording.
    """
    length = min(len(sample) for sample in samples)
    # What one of them misses is that of the others, and a gap where all do.
    stacked = np.ma.masked_invalid([sample[:length] for sample in samples])
    spread = stacked.std(axis=0, ddof=min(1, len(samples) - 1))
    return (
        recordings[0].time[:length],
        stacked.mean(axis=0).filled(np.nan),
        BAND * spread.filled(0.0),
    )
