"""The differences between results, in origin, parameters and signals, ready to print or draw."""

import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.files.provenance import Provenance
from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory
from limb_systems.limb_model import LimbModel
from limb_systems.limb_parameters import CalibrationRecord
from limb_systems.tracking import ReferenceDistances, reference_distances
from limb_systems.views.colors import PLAN_COLOR, REFERENCE_COLOR, ROLLOUT_COLOR, wire_colors
from limb_systems.views.panels import SIGNALS, Curve, Panel, measured_panels
from planners import nearest_bend_angle
from soft_limb.reports import page
from soft_limb.results.read_result import LIMB, RECORDING, TRAJECTORY, ResultFile
from soft_limb.results.summaries import distances_summary

NO_VALUE = "-"  # in place of a value that a run does not have
ROUNDING_ERROR = 1e-9  # relative; solvers of equal problems end with such differences
MAX_TEXT_LENGTH = 60  # characters of a value in a table
_COLORS = (PLAN_COLOR, ROLLOUT_COLOR, *wire_colors(6))
_STYLES = tuple(itertools.product((1.5, 3.0), ("solid", "dashed", "dotted", "dashdot")))  # of wires
_RUN_KINDS = (RECORDING, TRAJECTORY)
_CONTAINERS = ("limbs", "parameters", "segments", "wires")  # fields that are no part of a name
_FIT_FIELDS = ("names", "values", "standard_errors", "covariance", "provenance")  # also in laws


class ComparisonError(LimbError):
    """Results cannot be compared."""


@dataclasses.dataclass(frozen=True)
class Change:
    """A value that differs between runs.

    - ``name``, ``unit``: name and unit of the value.
    - ``values``: number or text of each run; None where a run has no such value.
    """

    name: str
    unit: str
    values: list[Any]

    @property
    def relative(self) -> list[float | None]:
        """The relative difference of each run from the first; None if it is not defined."""
        first, *others = self.values
        # A seed is a name, not a size.
        has_relative = self.name.split(".")[-1] != "seed" and _is_number(first) and first != 0
        relative: list[float | None] = [None]
        for value in others:
            is_defined = has_relative and _is_number(value)
            relative.append(float((value - first) / abs(first)) if is_defined else None)
        return relative


@dataclasses.dataclass(frozen=True)
class Difference:
    """The absolute difference of a signal of run ``run``, counted from 0, from the first run."""

    run: int
    signal: str
    unit: str
    mean: float
    median: float
    percentile_90: float


@dataclasses.dataclass(frozen=True)
class RunSignals:
    """The signals of a run by name, in degrees and °C.

    - ``time``: times since the start of the plan (K,), s.
    - ``values``: signals (rows, K).
    - ``differences``: differences from the first run (rows, K), nan at times that the first run
      does not have; empty for the first run.
    """

    time: np.ndarray
    values: dict[str, np.ndarray]
    differences: dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """The differences between results of one kind, ready to print or draw.

    - ``results``: the results (R); the others are compared with the first.
    - ``changes``: values that differ between the results.
    - ``differences``: differences of the signals of the other runs from the first.
    - ``distances``: mean distances of each recording from the reference, by the number of the
      run; empty unless there is exactly one plan.
    - ``runs``: signals of each run; empty for limbs.
    """

    results: Sequence[ResultFile]
    changes: list[Change]
    differences: list[Difference]
    distances: dict[int, ReferenceDistances]
    runs: list[RunSignals]

    def to_json(self) -> dict[str, Any]:
        """Return all but the signals, for JSON."""
        return {
            "runs": [str(result.path) for result in self.results],
            "kinds": [result.kind for result in self.results],
            "changes": [
                {**dataclasses.asdict(change), "relative": change.relative}
                for change in self.changes
            ],
            "differences": list(map(dataclasses.asdict, self.differences)),
            "distances": [
                {"run": run, **distances_summary(distances).to_json()}
                for run, distances in self.distances.items()
            ],
        }

    @property
    def names(self) -> list[str]:
        """Names of the runs: the shortest ends of their paths that differ between the runs."""
        parts = [result.path.parts or (".",) for result in self.results]
        num_paths = len(set(parts))
        for length in range(1, max(map(len, parts)) + 1):
            names = ["/".join(part[-length:]).replace("//", "/") for part in parts]
            if len(set(names)) == num_paths:
                break
        return names

    def tables(self) -> dict[str, list[list[str]]]:
        """Return the tables of distances and differences by title, each with a header."""
        tables = {}
        # Distances of each recording from the reference.
        if self.distances:
            rows = [["run", "measured", "planned", "best possible within the limits"]]
            for run, distances in self.distances.items():
                rows.append([self.names[run], *map(_degrees, dataclasses.astuple(distances))])
            tables["mean distance from the plan's reference"] = rows
        # Statistics of the differences in each signal.
        if self.differences:
            rows = [["run", "", "mean", "median", "90th percentile"]]
            for item in self.differences:
                digits = 3 if item.signal == "duty" else 2
                unit = item.unit if item.unit in ("", "°") else f" {item.unit}"
                numbers = (item.mean, item.median, item.percentile_90)
                cells = [f"{number:.{digits}f}{unit}" for number in numbers]
                rows.append([self.names[item.run], f"|Δ{SIGNALS[item.signal].symbol}|", *cells])
            tables["absolute differences from the first"] = rows
        return tables

    def changes_table(self) -> list[list[str]]:
        """Return a header, and a row for each change: name, unit, and the values of all runs.

        A relative difference from the first run follows the value in brackets.
        """
        rows = [["", "unit", *self.names]]
        for change in self.changes:
            cells = []
            for text, relative in zip(_texts(change.values), change.relative, strict=True):
                cells.append(f"{text} ({100 * relative:+.3g}%)" if relative else text)
            rows.append([change.name, change.unit, *cells])
        return rows


def compare(results: Sequence[ResultFile]) -> Comparison:
    """Compare plans and recordings, or calibrated limbs.

    Args:
        results: two or more limbs, or two or more plans and recordings. With a plan as the first,
            the differences are tracking errors.

    Raises:
        ComparisonError: with one sentence, if they are of different kinds or shapes.
    """
    if len(results) < 2:
        raise ComparisonError("There is one result; a comparison needs two or more.")
    first = results[0]
    for result in results:
        if result.kind not in (*_RUN_KINDS, LIMB):
            raise ComparisonError(
                f"{result.path} is a {result.kind}; compare plans, recordings or limbs."
            )
        if (result.kind == LIMB) != (first.kind == LIMB):
            raise ComparisonError(
                f"{first.path} is a {first.kind} and {result.path} is a {result.kind}; compare "
                "results of one kind."
            )
    # Compare origin and key figures. A value that one result alone has is not a change.
    changes = []
    for change in _changed(list(map(_origin_values, results))):
        if len({*map(str, change.values)} - {"None"}) > 1:
            changes.append(change)
    # Compare the parameters of the limbs or robots.
    limbs = []
    for result in results:
        run = result.value
        limbs.append(run if result.kind == LIMB else run.robot or run.parameters)
    changes += _changed(list(map(flattened, limbs)))
    if first.kind == LIMB:
        return Comparison(results, changes, [], {}, [])
    # Compare the signals of plans and recordings.
    _check_shapes(results)
    runs = _signals_of_runs([result.value for result in results])
    differences = []
    for number, run in enumerate(runs):
        for name, values in run.differences.items():
            size = np.abs(values)
            if np.isnan(size).all():  # no thermocouples
                continue
            numbers = [np.nanmean(size), np.nanmedian(size), np.nanpercentile(size, 90)]
            differences.append(Difference(number, name, SIGNALS[name].unit, *map(float, numbers)))
    return Comparison(results, changes, differences, _distances(results), runs)


def flattened(value: Any, unit: str = "", name: str = "") -> dict[str, tuple[Any, str]]:
    """Return all numbers and texts of a limb or robot with units, by names like "right.law.a1".

    Wires go by their names, and segments by their numbers if there are several. A calibration
    contributes its prediction errors; its fitted values are those in the laws. A part of a limb has
    a unit and a name.
    """
    leaves: dict[str, tuple[Any, str]] = {}
    # Fields of a dataclass, without fitted values and without rare fields at their default.
    if dataclasses.is_dataclass(value):
        if name.rpartition(".")[2] in ("law", "bend_sensor", "board"):
            leaves[name] = (type(value).__name__, "")
        for field in dataclasses.fields(value):
            part = getattr(value, field.name)
            is_fit = isinstance(value, CalibrationRecord) and field.name in _FIT_FIELDS
            rare = field.metadata.get("rare") and part == field.default
            if is_fit or rare:
                continue
            inner = "" if field.name in _CONTAINERS else field.name
            leaves |= flattened(part, field.metadata.get("unit", unit), _joined(name, inner))
    # Items of a list, by name or number.
    elif isinstance(value, list):
        for number, item in enumerate(value, 1):
            inner = getattr(item, "name", "") or (str(number) if len(value) > 1 else "")
            leaves |= flattened(item, unit, _joined(name, inner))
    elif value not in (None, ""):
        leaves[name] = (value, unit)
    return leaves


def _joined(*names: str) -> str:
    return ".".join(filter(None, names))


def _origin_values(result: ResultFile) -> dict[str, tuple[Any, str]]:
    """Return the kind, and the values of summary and provenance with their units, by name."""
    summary = result.summary
    if result.provenance:
        summary += result.provenance.summary()
    values = {"kind": (result.kind, "")}
    for entry in summary.entries + summary.details:
        if entry.value not in (None, ""):
            values[entry.name] = (entry.value, entry.unit)
    return values


def _changed(runs: Sequence[dict[str, tuple[Any, str]]]) -> list[Change]:
    """Return the values that differ between runs."""
    changes = []
    for name in dict.fromkeys(itertools.chain.from_iterable(runs)):
        values = [run[name][0] if name in run else None for run in runs]
        if not all(_is_equal(value, values[0]) for value in values):
            unit = next(run[name][1] for run in runs if name in run)
            changes.append(Change(name, unit, values))
    return changes


def _is_equal(value: Any, other: Any) -> bool:
    """Return True for equal values; floats are equal up to rounding, and NaN equals NaN."""
    if isinstance(value, float) and isinstance(other, float) and value == value:
        return math.isclose(value, other, rel_tol=ROUNDING_ERROR)
    if isinstance(value, list) and isinstance(other, list) and len(value) == len(other):
        return all(map(_is_equal, value, other))
    return value == other or (value != value and other != other)


def _is_number(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and bool(np.isfinite(value))


def _check_shapes(results: Sequence[ResultFile]) -> None:
    """Raise ComparisonError if limbs differ in segments, wires or bends, or a run is empty."""
    first_shape = ""
    for result in results:
        layout = LimbModel.of(result.value.parameters).layout
        num_segments = len(layout.bends_of)
        shape = f"{num_segments} segments, {layout.num_wires} wires and {layout.num_bends} bends"
        first_shape = first_shape or shape
        if shape != first_shape:
            raise ComparisonError(
                f"The limb of {results[0].path} has {first_shape}, but the limb of {result.path} "
                f"has {shape}; compare runs of limbs with the same segments and wires."
            )
        if len(result.value.time) < 2:
            raise ComparisonError(f"{result.path} has fewer than two samples to compare.")


def _signals_of_runs(runs: Sequence[Recording | Trajectory]) -> list[RunSignals]:
    """Return the signals of all runs, and their differences from the first."""
    runs = [run.since_start() if isinstance(run, Trajectory) else run for run in runs]
    start, end = runs[0].time[[0, -1]]
    signals = []
    for number, run in enumerate(runs):
        time, values = _usable_signals(run)
        differences = {}
        if number:
            # Find the samples in the time of the first run.
            is_common = (time >= start) & (time <= end)
            if not is_common.any():
                raise ComparisonError(
                    f"Run {number + 1} lasts from {time[0]:g} s to {time[-1]:g} s, and the first "
                    f"from {start:g} s to {end:g} s: they have no time in common."
                )
            # Round, so that rounding errors do not look like differences in a chart.
            for name, first_values in _interpolated_signals(runs[0], time).items():
                difference = np.round(values[name] - first_values, 9)
                differences[name] = np.where(is_common, difference, np.nan)
        signals.append(RunSignals(time, values, differences))
    return signals


def _usable_signals(run: Recording | Trajectory) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the times of the usable samples, and the signals there, in degrees and °C."""
    usable = run.usable if isinstance(run, Recording) else np.ones(len(run.time), bool)
    signals = {
        "bend_angle": np.rad2deg(run.bend_angle[:, usable]),
        "measured_temperature": run.measured_temperature[:, usable],
        "duty": run.duty[:, usable],
    }
    return run.time[usable], signals


def _interpolated_signals(run: Recording | Trajectory, times: np.ndarray) -> dict[str, np.ndarray]:
    """Return the signals of a run at given times, in degrees and °C."""
    time, signals = _usable_signals(run)
    interpolated = {}
    for name, values in signals.items():
        interpolated[name] = np.array([np.interp(times, time, row) for row in values])
    if isinstance(run, Trajectory):
        # A plan is cubic between knots.
        interpolated["bend_angle"] = np.rad2deg(run.bend_angle_at(times))
    return interpolated


def _distances(results: Sequence[ResultFile]) -> dict[int, ReferenceDistances]:
    """Return the distances of each recording from the reference; none unless there is one plan."""
    plans = [result.value for result in results if result.kind == TRAJECTORY]
    distances: dict[int, ReferenceDistances] = {}
    if len(plans) != 1:
        return distances
    nearest = nearest_bend_angle(plans[0])
    for number, result in enumerate(results):
        if result.kind == RECORDING:
            distances[number] = reference_distances(plans[0], [result.value], nearest)
    return distances


def _texts(values: Sequence[Any]) -> list[str]:
    """Return values as texts, numbers with three digits, or more if different values need more."""
    for digits in (3, 6, 9, 12):
        texts = [_text(value, digits) for value in values]
        if len(set(texts)) == len(set(map(str, values))):
            break
    return texts


def _text(value: Any, digits: int) -> str:
    if value is None:
        return NO_VALUE
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    if isinstance(value, list):
        text = ", ".join(_text(item, digits) for item in value)
    else:
        text = " ".join(str(value).split())
    return text if len(text) <= MAX_TEXT_LENGTH else f"{text[: MAX_TEXT_LENGTH - 3]}..."


def _degrees(angle: float | None) -> str:
    return NO_VALUE if angle is None else f"{np.rad2deg(angle):.2f}°"


def comparison_page(comparison: Comparison) -> str:
    """Return the comparison as a page, HTML, with all runs in one chart."""
    # List the runs with their origin.
    names = comparison.names
    runs = []
    for name, result in zip(names, comparison.results, strict=True):
        made = result.provenance
        by = f"soft-limb {made.version} {made.commit}".strip() if made else "not known"
        runs.append([name, result.kind, by, made.time if made else ""])
    parts: list[page.Part] = [page.section("Runs", page.table(["", "kind", "made by", "at"], runs))]
    # Add the differences of their signals.
    if comparison.runs:
        tables = []
        for title, (header, *rows) in comparison.tables().items():
            tables.append(page.table(header, rows, f"{title[0].upper()}{title[1:]}."))
        text = f"Below each signal is its difference Δ from {names[0]}."
        chart = page.chart(_panels(comparison), f"All runs, and their differences from {names[0]}")
        parts.append(page.section("Distances and differences", *tables))
        parts.append(page.section("All runs", page.paragraph(text), chart))
    # Add the changes of single values.
    header, *rows = comparison.changes_table()
    caption = f"In brackets: the relative difference from {names[0]}."
    changed = page.table(header, rows, caption) if rows else page.paragraph("Nothing changed.")
    parts.append(page.section("Changes", changed))
    others = names[1] if len(names) == 2 else f"{len(names) - 1} others"
    return page.make_page(f"{names[0]} compared with {others}", parts, Provenance.now())


def _panels(comparison: Comparison) -> list[Panel]:
    """Return the panels of all runs, each above a panel of the differences from the first run."""

    def curves(kind: str, signal: str, row: int, wire: str, _color: str) -> list[Curve]:
        """Return the curves of a signal's row: runs have colours, and wires have styles."""
        is_bend = signal == "bend_angle"
        width, dash = _STYLES[0 if is_bend else row % len(_STYLES)]
        drawn = _references(comparison.results, row) if is_bend and kind == "values" else []
        for number, run in enumerate(comparison.runs):
            if rows := getattr(run, kind):
                name = f"{wire}{comparison.names[number]}"
                color = _COLORS[number % len(_COLORS)]
                drawn.append(Curve(name, run.time, rows[signal][row], color, dash, width))
        return drawn

    parameters = comparison.results[0].value.parameters
    values = measured_panels(parameters, functools.partial(curves, "values"), None)
    differences = measured_panels(parameters, functools.partial(curves, "differences"), None)
    panels = []
    for above, below in zip(values, differences, strict=True):
        label = f"Δ {below.label}"
        panels.append(dataclasses.replace(above, y_range=None))
        panels.append(dataclasses.replace(below, label=label, height=170, y_range=None))
    return panels


def _references(results: Sequence[ResultFile], bend: int) -> list[Curve]:
    """Return the references of the plans; equal references are drawn once."""
    drawn: list[Curve] = []
    for result in results:
        if result.kind == TRAJECTORY:
            plan = result.value.since_start()
            angle = np.rad2deg(plan.reference[bend])
            if not any(np.array_equal(curve.y, angle) for curve in drawn):
                drawn.append(Curve("reference φ_REF", plan.time, angle, REFERENCE_COLOR))
    return drawn
