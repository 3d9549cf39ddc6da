"""What the numbers of a log show: which thermocouple warms with which duty, what bends where."""

import itertools

import numpy as np

MEMORY = 15.0  # s, over which a wire keeps its heat, roughly
SOON = 8.0  # s, in which a limb follows its heat
SHOWN = 0.3  # correlation that shows a connection


def held(values: np.ndarray) -> np.ndarray:
    """A duty (K,) that holds where it is missing, as logs write it that do so when it changes."""
    last = np.maximum.accumulate(np.where(np.isnan(values), 0, np.arange(len(values))))
    return np.nan_to_num(values[last])


def heat_of(times: np.ndarray, duty: np.ndarray) -> np.ndarray:
    """Duty (..., K) through a low-pass filter, as wires keep heat: warmth and bend follow it."""
    heat = np.zeros_like(duty)
    added = duty[..., :-1] * -np.expm1(-np.diff(times) / MEMORY)
    span = 20 * MEMORY  # within which the sum below keeps its digits
    starts = np.flatnonzero(np.diff((times - times[0]) // span, prepend=-1.0))
    for start, end in itertools.pairwise([*starts, len(times)]):
        if start:
            kept = np.exp((times[start - 1] - times[start]) / MEMORY)
            heat[..., start] = kept * heat[..., start - 1] + added[..., start - 1]
        grown = np.exp((times[start + 1 : end] - times[start]) / MEMORY)
        since = np.cumsum(added[..., start : end - 1] * grown, axis=-1)
        heat[..., start + 1 : end] = (heat[..., start, None] + since) / grown
    return heat


def correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Correlation of two signals where both are there; 0 where one does not move."""
    shown = ~(np.isnan(one) | np.isnan(other))
    if shown.sum() < 5 or not np.ptp(one[shown]) or not np.ptp(other[shown]):
        return 0.0
    with np.errstate(all="ignore"):  # of numbers that are almost nothing
        found = float(np.corrcoef(one[shown], other[shown])[0, 1])
    return found if np.isfinite(found) else 0.0


def pairing(heats: np.ndarray, readings: np.ndarray) -> list[tuple[int | None, float]]:
    """The reading that belongs to each wire, by all correlations together, and its own.

    Args:
        heats: heat of W wires (W, K), as `heat_of` gives it; zero where a wire was never heated.
        readings: readings of M thermocouples (M, K).

    Returns:
        for each wire the index of its reading and their correlation; None for wires without heat,
        or if there are too few readings.
    """
    # Takes as long to import as all the rest, and few programs read logs.
    from scipy.optimize import linear_sum_assignment

    heated = [i for i, heat in enumerate(heats) if np.ptp(heat) > 0]
    found: list[tuple[int | None, float]] = [(None, 0.0)] * len(heats)
    if not heated or not len(readings):
        return found
    agreement = np.array([[correlation(heats[i], r) for r in readings] for i in heated])
    for wire, reading in zip(*linear_sum_assignment(agreement, maximize=True), strict=True):
        if agreement[wire, reading] > SHOWN:
            found[heated[wire]] = int(reading), float(agreement[wire, reading])
    return found


def bending(heats: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """How a bend follows the heat of each wire (W,), by least squares; 0 for wires without heat."""
    shown = ~np.isnan(bend)
    moving = np.ptp(heats, axis=1) > 0
    slopes = np.zeros(len(heats))
    if shown.sum() > 5 and moving.any():
        factors = np.vstack([heats[moving][:, shown], np.ones(shown.sum())]).T
        slopes[moving] = np.linalg.lstsq(factors, bend[shown], rcond=None)[0][:-1]
    return slopes


def following(times: np.ndarray, heats: np.ndarray, bend: np.ndarray) -> float:
    """How well the changes of a bend within some seconds follow those of the heat, 0 to 1."""
    late = np.searchsorted(times, times + SOON)
    late, early = late[late < len(times)], np.flatnonzero(late < len(times))
    if not len(late):
        return 0.0
    changes, change = heats[:, late] - heats[:, early], bend[late] - bend[early]
    return abs(correlation(bending(changes, change) @ changes, change))
