"""Directions of a limb by points in a picture, whose y points down."""

import numpy as np

STILL_ROWS = 5  # rows in which points of a picture are exactly where they were, and were not seen
MIN_FIRST_TURN = 0.85  # of the turn of a limb's first link, if it were bent evenly


def link_directions(coordinates: list[np.ndarray]) -> np.ndarray:
    """Return directions of the links between P points in a picture (P - 1, K), °.

    Directions are nan where a point is at 0, 0, or all have been where they are, to all digits,
    for some rows: so do trackers write that they have lost them. ``coordinates`` are x and y (K,)
    of each point.
    """
    columns = np.array(coordinates)
    x = columns[::2]
    y = columns[1::2]
    rows = np.arange(columns.shape[1])
    moved = np.append(True, (np.diff(columns, axis=1) != 0).any(axis=0))
    since = rows - np.maximum.accumulate(np.where(moved, rows, 0))
    is_lost = ((x == 0) & (y == 0)).any(axis=0) | (since >= STILL_ROWS)
    directions = np.rad2deg(np.arctan2(-np.diff(y, axis=0), np.diff(x, axis=0)))
    return np.where(is_lost, np.nan, directions)


def base_direction(coordinates: list[np.ndarray]) -> float:
    """Return the direction of a limb's base, °, by points of which it is the first; 0 if not seen.

    A link has the direction of the tangent at its middle, and the base is half a link before the
    first one, as for constant curvature. ``coordinates`` are x and y (K,) of two or more points.
    """
    links = link_directions(coordinates)
    links = np.unwrap(links[:, ~np.isnan(links).any(axis=0)], axis=0, period=360.0)
    base = links[0] if len(links) < 2 else 1.5 * links[0] - 0.5 * links[1]
    return round(float(np.median(base)), 2) if base.size else 0.0


def is_clamped_at_first_point(x: np.ndarray, y: np.ndarray) -> bool:
    """Return whether the limb seems to be clamped at the first of P points in a picture.

    A link joins two points. With constant curvature, its direction turns in proportion to the
    length from the base to its middle; limbs bend more near their base. The first link turns less
    than this if the first point lies before the base, on a part that does not bend. ``x`` and ``y``
    are in order from the base (P, N), in any unit.
    """
    # Measure the links, and the length from the first point to the middle of each (P - 1,).
    lengths = np.nanmedian(np.hypot(np.diff(x, axis=0), np.diff(y, axis=0)), axis=1)
    middles = np.cumsum(lengths) - lengths / 2
    # Measure how much each link turns: the standard deviation of its direction, rad.
    directions = np.arctan2(np.diff(y, axis=0), np.diff(x, axis=0))
    directions = np.unwrap(directions[:, ~np.isnan(directions).any(axis=0)], axis=1)
    turns = directions.std(axis=1)
    # Compare the first link with what constant curvature makes of the last link's turn.
    expected_first_turn = turns[-1] * middles[0] / middles[-1]
    return len(x) > 2 and bool(MIN_FIRST_TURN * expected_first_turn < turns[0])
