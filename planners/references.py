"""Reference bend angles for the limb, feasible or not.

A reference is a Drake trajectory of φ_ref in rad, a row for each bend of the limb, that starts at
time zero. It may be any `pydrake.trajectories.Trajectory`; the functions here make the usual ones.
"""

import csv
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.trajectories import PiecewisePolynomial

from limb_systems import LimbError, LimbModel, LimbParameters, Recording
from limb_systems.errors import reraise_as
from limb_systems.files.input import LARGEST_TABLE, MOST_COLUMNS, first_line, read_text
from limb_systems.symbolic_chain import tip_position_function

IN_SPACE = (
    "If yours bends in space, write axes: 2 into its segments in its YAML file, and where its "
    "wires are, e2 and e3."
)
APPROACH_TIME = 5.0  # s, in which a limb gets to the beginning of a curve
CURVE_RATE = 20.0  # Hz, of the samples of a curve
LONGEST_GAP = 1.0  # s, of a recording, over which a reference is linear
MAX_TIP_STEPS = 50  # of Newton's method


def from_samples(times: ArrayLike, bend_angles: ArrayLike) -> PiecewisePolynomial:
    """Return a reference through samples, linear between them.

    Args:
        times: (K,), s, increasing; shifted so that the first is zero.
        bend_angles: φ_ref (K,) or (F, K), rad.

    Raises:
        LimbError: if shapes disagree or a value is not finite.
    """
    times = np.asarray(times, float)
    angles = np.atleast_2d(np.asarray(bend_angles, float))
    if times.ndim != 1 or angles.shape[1:] != times.shape or len(times) < 2:
        raise LimbError(
            "A reference needs two samples or more and an angle for each time; number of times: "
            f"{times.size}, of angles: {angles.shape[-1]}."
        )
    bad = ~np.isfinite(times) | ~np.isfinite(angles).all(axis=0)
    if bad.any():
        row = int(np.argmax(bad))
        numbers = [times[row], *np.rad2deg(angles[:, row])]
        texts = ", ".join(f"{number:g}" for number in numbers)
        raise LimbError(f"Row {row + 1} of the reference is {texts} (s, °); give numbers.")
    if (np.diff(times) <= 0).any():
        index = int(np.argmax(np.diff(times) <= 0))
        raise LimbError(
            f"The reference goes from {times[index]:g} s to {times[index + 1]:g} s; "
            "time must increase."
        )
    return PiecewisePolynomial.FirstOrderHold(times - times[0], angles)


def from_recording(recording: Recording, smoothing_time: float = 0.0) -> PiecewisePolynomial:
    """Return the bend of a recording, without the known errors of its sensors: teach and repeat.

    Args:
        smoothing_time: s; if it is not zero, a quadratic polynomial is fitted
            to a window of this length around each sample (Savitzky-Golay),
            which removes the sensor's noise and keeps the motion.

    Raises:
        LimbError: if the recording is shorter than the window, a value in it is not plausible, or
            bends are missing for more than 1 s; shorter gaps are bridged, with a warning.
    """
    recording.check_plausible()
    # Correct the readings of each segment's sensor.
    limb = recording.parameters
    bend_angle = _interpolate_gaps(recording)
    parts = []
    for segment, bends in zip(limb.segments, LimbModel.of(limb).layout.bends_of, strict=True):
        parts.append(segment.bend_sensor.unrolled_bends(bend_angle[bends]))
    angles = np.concatenate(parts)
    num_samples = angles.shape[1]
    if num_samples < 2:
        return from_samples(recording.time, angles)  # which refuses too few
    # Smooth them. Rounding nan or inf fails.
    is_number = 0 <= smoothing_time < np.inf
    window = 2 * round(smoothing_time * recording.sample_rate / 2) + 1 if is_number else np.inf
    if window > num_samples:
        raise LimbError(
            f"smoothing_time is {smoothing_time!r} s; it must be from 0 to the recording's "
            f"{recording.duration:g} s."
        )
    if window > 3:
        # Takes as long to import as all the rest, and few references are smoothed.
        from scipy.signal import savgol_filter

        angles = savgol_filter(angles, window, 2)
    return from_samples(recording.time, angles)


def _interpolate_gaps(recording: Recording) -> np.ndarray:
    """Return the bend angles of a recording (F, K), linear over short gaps in them."""
    there = ~np.isnan(recording.bend_angle).any(axis=0)
    if there.all():
        return recording.bend_angle
    times = recording.time[there]
    count = (~there).sum()
    gap = np.diff(np.hstack([recording.time[:1], times, recording.time[-1:]])).max()
    if gap > LONGEST_GAP + 1e-9:
        raise LimbError(
            f"{count} of {len(there)} samples of the recording are missing, up to {gap:.3g} s in a "
            "row; the motion in the gap is not known, so teach it again."
        )
    warnings.warn(
        f"{count} of {len(there)} samples of the recording are missing, up to {gap:.3g} s in a "
        "row; the reference is linear there.",
        stacklevel=3,
    )
    return recording.interpolated(recording.bend_angle, recording.time)


def load(path: str | Path) -> PiecewisePolynomial:
    """Load a reference from a CSV: time in s, then a column of degrees for each bend.

    A segment that bends in space has two bends, towards E2 and E3 (`limb_systems.layout.Layout`).

    Files of spreadsheets are read: columns are separated by commas, semicolons or tabs (with
    semicolons or tabs, numbers may have a decimal comma); there may be lines of titles above the
    numbers, quotes, empty lines and empty last columns. Text after a ``#`` is a comment. The
    function warns of likely mistakes: radians, steps of more than 100°, and a start at another
    time than zero, which is shifted to zero.

    Raises:
        LimbError: if the file cannot be read as a reference.
    """
    table, reference = _load(
        path, lambda table: from_samples(table[:, 0], np.deg2rad(table[:, 1:].T))
    )
    for doubt in _likely_mistakes(table):
        warnings.warn(f"{path}: {doubt}", stacklevel=2)
    return reference


def load_tip_path(path: str | Path, parameters: LimbParameters) -> PiecewisePolynomial:
    """Load the path of a tip from a CSV, for `from_tip_path`: time in s, then E2 (and E3) in mm.

    Its format is as for `load`.

    Raises:
        LimbError: if the file cannot be read, or the tip does not reach a point.
    """

    def of_path(table: np.ndarray) -> PiecewisePolynomial:
        return from_tip_path(parameters, table[:, 0], table[:, 1:].T / 1e3)

    return _load(path, of_path)[1]


def _load(
    path: str | Path, reference_of: Callable[[np.ndarray], PiecewisePolynomial]
) -> tuple[np.ndarray, PiecewisePolynomial]:
    """Return a file's table, and the reference from it."""
    text = read_text(path, "reference", LimbError, LARGEST_TABLE)
    if foreign := _kind_of_other_file(text):
        raise LimbError(f"{path} {foreign}.")
    with reraise_as(LimbError, f"{path}: "):
        table = _table(text)
        return table, reference_of(table)


def _kind_of_other_file(text: str) -> str | None:
    """Return the kind of a file of ours that is no table of numbers; None for others."""
    ours = first_line(text)
    if ours and ours.kind == "trajectory":
        return "is a plan already, for soft-limb replay; a reference is a CSV or a recording"
    if ours and ours.kind == "recording":
        return "is a recording; references.from_recording makes a reference of it"
    if re.search(r"^segments:", text, re.MULTILINE):
        return "describes a limb, and is given with -l; a reference is a CSV or a recording"
    return None


def _table(text: str) -> np.ndarray:
    try:
        return _parse(text)
    except csv.Error as error:
        raise LimbError(f"this is no table: {error}.") from error


def _parse(text: str) -> np.ndarray:
    # Find the separator of the columns.
    lines = [line.partition("#")[0] for line in text.splitlines()]
    body = "\n".join(lines)
    separator = next((mark for mark in ";\t" if mark in body), ",")
    rows: list[list[float]] = []
    for number, cells in enumerate(csv.reader(lines, delimiter=separator), 1):
        # Leave out empty last columns, empty lines, and titles above the numbers.
        cells = [cell.strip() for cell in cells]
        while cells and not cells[-1]:
            cells.pop()
        if not cells:
            continue
        if len(cells) > MOST_COLUMNS:
            raise LimbError(
                f"line {number} has {len(cells)} columns; a reference has a time and an angle for "
                f"each bend, and no robot has more than {MOST_COLUMNS}. Is a table transposed?"
            )
        values = [_number(cell, separator) for cell in cells]
        if not rows and not any(value is not None for value in values):
            continue
        # All other lines have the same number of numbers.
        for cell, value in zip(cells, values, strict=True):
            if value is None:
                raise LimbError(f"line {number} has {cell!r}, which is not a number.")
        if len(values) < 2:
            raise LimbError(f"line {number} has one number; there must be a time and an angle.")
        if rows and len(values) != len(rows[0]):
            raise LimbError(
                f"line {number} has {len(values)} numbers, but those above have {len(rows[0])}."
            )
        rows.append([value for value in values if value is not None])
    return np.array(rows).reshape(len(rows), -1) if rows else np.zeros((0, 2))


def _number(cell: str, separator: str) -> float | None:
    if separator != ",":
        cell = cell.replace(",", ".")
    try:
        return float(cell)
    except ValueError:
        return None


def _likely_mistakes(table: np.ndarray) -> Iterator[str]:
    times = table[:, 0]
    angles = table[:, 1:]
    largest = np.abs(angles).max()
    steps = np.abs(np.diff(angles, axis=0)).max(axis=1)
    if 0.1 < largest < 3.2:
        yield f"the largest angle is {largest:.2g}; are these radians? Files must have degrees."
    if steps.max() > 100:
        at = times[int(steps.argmax()) + 1]
        yield f"the angle changes by {steps.max():.0f}° from one sample to the next at {at:g} s."
    if times[0] != 0:
        yield f"it starts at {times[0]:g} s, which is shifted to 0 s."


def circle(
    radius: float, period: float, *, turns: float = 1.0, wait: float = 20.0
) -> PiecewisePolynomial:
    """Return bends in a circle, from φ2 = radius towards φ3, for a segment that bends in space.

    Args:
        radius: rad.
        period: time of a turn, s.
        turns: number of turns.
        wait: time for which the limb stays straight before, while its wires get warm (20), s.
    """

    def on_circle(angle: np.ndarray) -> np.ndarray:
        return radius * np.array([np.cos(angle), np.sin(angle)])

    return _curve(on_circle, period, turns, wait)


def eight(
    width: float, height: float, period: float, *, turns: float = 1.0, wait: float = 20.0
) -> PiecewisePolynomial:
    """Return bends in a lying eight about zero: φ2 = width sin(a), φ3 = height sin(2 a).

    Args:
        width, height: rad.
        period, turns, wait: as for `circle`.
    """

    def on_eight(angle: np.ndarray) -> np.ndarray:
        return np.array([width * np.sin(angle), height * np.sin(2 * angle)])

    return _curve(on_eight, period, turns, wait)


def _curve(
    bends: Callable[[np.ndarray], np.ndarray], period: float, turns: float, wait: float
) -> PiecewisePolynomial:
    """Return a reference that waits, goes to the beginning of a closed curve, and follows it."""
    for name, value in (("period", period), ("turns", turns)):
        if not (np.isfinite(value) and value > 0):
            raise LimbError(f"{name} is {value!r}; it must be a positive number.")
    if not (np.isfinite(wait) and wait >= 0):
        raise LimbError(f"wait is {wait!r} s; it must be zero or more.")
    times = np.linspace(0.0, turns * period, max(2, round(turns * period * CURVE_RATE)) + 1)
    angles = bends(2 * np.pi * times / period)
    before = np.zeros((2, 2 if wait else 1))
    starts = [0.0, wait] if wait else [0.0]
    return from_samples(
        np.append(starts, wait + APPROACH_TIME + times), np.hstack([before, angles])
    )


def from_tip_path(
    parameters: LimbParameters, times: ArrayLike, path: ArrayLike
) -> PiecewisePolynomial:
    """Return the bends with which a limb's tip follows a path beside its axis.

    The limb's joints make equal parts of each bend (11), as without gravity. The bends of several
    segments are the smallest.

    Args:
        parameters: description of the limb.
        times: (K,), s, increasing; shifted so that the first is zero.
        path: coordinates of the tip in (E2, E3), m, (2, K), or in (E2,), (1, K), for a limb
            that bends in a plane.

    Raises:
        LimbError: if shapes disagree, or the tip does not reach a point.
    """
    # Refuse paths of another shape.
    mechanics = LimbModel.of(parameters).mechanics
    layout = mechanics.layout
    tip_of = tip_position_function(mechanics)
    path = np.atleast_2d(np.asarray(path, float))
    times = np.asarray(times, float)
    sideways = [1] if layout.is_planar else [1, 2]
    if layout.is_planar and len(path) == 2:
        raise LimbError(
            f"The path has two coordinates of the tip, and this limb bends in a plane. {IN_SPACE}"
        )
    if path.shape != (len(sideways), times.size) or not np.isfinite(path).all():
        raise LimbError(
            f"path has the shape {path.shape}; for this limb and {times.size} times it must be "
            f"finite numbers of the shape ({len(sideways)}, {times.size}), in m."
        )
    bends = np.zeros((times.size, layout.num_bends))
    if times.size < 2:
        return from_samples(times, bends.T)  # which refuses too few
    # Newton's method, in steps of at most 0.3 rad.
    for _ in range(MAX_TIP_STEPS):
        angles = bends @ mechanics.shape.T
        tip, slopes = tip_of.first(angles)
        error = path.T - tip[:, sideways]
        if np.abs(error).max() < 1e-10:
            return from_samples(times, mechanics.bend_angle(angles.T))
        inverse = np.linalg.pinv(slopes[:, sideways] @ mechanics.shape)
        step = (inverse @ error[..., None])[..., 0]
        bends = bends + step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / 0.3)
    # Name the point that is missed most.
    worst = int(np.abs(error).max(axis=1).argmax())
    place = " and ".join(f"{1e3 * value:.1f} mm" for value in path[:, worst])
    raise LimbError(
        f"The tip does not reach {place} beside the axis, where the path is at {times[worst]:g} s; "
        f"this limb is {1e3 * parameters.length:g} mm long."
    )


def ramps() -> PiecewisePolynomial:
    """Return a motion that the nominal limb can nearly follow: to 20° in 2 s, then to -15°.

    Heat builds up in the first 22 s, as in Fig. 5.
    """
    times = [0.0, 22.0, 24.0, 32.0, 34.0, 45.0]
    return from_samples(times, np.deg2rad([0.0, 0.0, 20.0, 20.0, -15.0, -15.0]))


def step_and_decaying_sine() -> PiecewisePolynomial:
    """Return the reference of the paper's Fig. 5: two steps and a decaying sinusoid, 60 s.

    The paper gives no numbers; these are ours. The limb rests while the wires warm up (20), steps
    to 25° at 22 s and to -20° at 30 s, and from 38 s swings about zero with a period of 8 s and an
    amplitude that starts at 25° and decays with a time constant of 10 s.
    """
    rate = 100.0  # samples per second
    times = np.arange(0.0, 60.0 + 0.5 / rate, 1 / rate)
    swinging = times - 38.0
    sine = 25.0 * np.exp(-swinging / 10.0) * np.sin(2 * np.pi * swinging / 8.0)
    degrees = np.select([times < 22.0, times < 30.0, times < 38.0], [0.0, 25.0, -20.0], sine)
    return from_samples(times, np.deg2rad(degrees))
