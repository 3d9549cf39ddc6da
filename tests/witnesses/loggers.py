"""Recordings as loggers of other rates would have made them."""

import dataclasses

import numpy as np

from limb_systems import Recording


def logged(recording: Recording, rate: float) -> Recording:
    """A recording at a lower rate, Hz; duty is the mean in between."""
    every = round(recording.sample_rate / rate)
    duty = [np.add.reduceat(d[1:], np.arange(0, len(d) - 1, every)) / every for d in recording.duty]
    count = (len(recording.time) - 1) // every
    rows = np.array(duty)[:, :count]
    signals = {
        name: getattr(recording, name)[..., : count * every + 1 : every]
        for name in ("time", *Recording.MEASURED)
    }
    return dataclasses.replace(
        recording,
        duty=np.concatenate([rows[:, :1], rows], axis=1),
        sample_rate=rate,
        **dict.fromkeys(Recording.optional()),
        **signals,
    )
