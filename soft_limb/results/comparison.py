"""The differences between results: what made them, their parameters, their signals; as a page."""

import dataclasses
import itertools
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from limb_systems.connected_limbs import ConnectedLimbs
from limb_systems.errors import LimbError
from limb_systems.files.provenance import Provenance
from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import Trajectory
from limb_systems.limb_model import LimbModel
from limb_systems.limb_parameters import CalibrationRecord, LimbParameters
from limb_systems.tracking import ReferenceDistances, reference_distances, tracking_errors
from limb_systems.views.colors import PLAN_COLOR, REFERENCE_COLOR, ROLLOUT_COLOR, wire_colors
from limb_systems.views.panels import SIGNALS, Curve, Panel
from planners import nearest_bend_angle
from soft_limb.reports import page
from soft_limb.results.read_result import LIMB, RECORDING, TRAJECTORY, ResultFile
from soft_limb.results.summaries import distances_summary

NO_VALUE = "-"  # for a value that one of the runs does not have
MAX_TEXT_LENGTH = 60  # characters of a value in a table
_COLORS = (PLAN_COLOR, ROLLOUT_COLOR, *wire_colors(6))
_STYLES = tuple(  # of wires
    (dash, width) for width in (1.5, 3.0) for dash in ("solid", "dashed", "dotted", "dashdot")
)
_RUN_KINDS = (RECORDING, TRAJECTORY)
_FIT_FIELDS = ("names", "values", "standard_errors", "covariance", "provenance")  # see the laws


class ComparisonError(LimbError):
    """Results cannot be compared."""


@dataclasses.dataclass(frozen=True)
class Change:
    """A value that is not the same in all runs.

    - ``name``, ``unit``: name and unit of the value.
    - ``values``: number or text of each run; None where a run has no such value.
    """

    name: str
    unit: str
    values: list[Any]

    @property
    def relative(self) -> list[float | None]:
        """The difference of each run from the first, over the first; None if it has none."""
        first, *others = self.values
        # A seed is a name rather than a size.
        known = self.name.split(".")[-1] != "seed" and _is_size(first) and first != 0

        def difference(value: Any) -> float | None:
            return float((value - first) / abs(first)) if known and _is_size(value) else None

        return [None, *map(difference, others)]


@dataclasses.dataclass(frozen=True)
class Difference:
    """How far a signal of a run is from the first run's, or from its plan's.

    - ``run``: number of the run, from 0 on.
    - ``signal``, ``unit``: name and unit, such as "bend_angle" in degrees.
    - ``mean``, ``median``, ``percentile_90``: statistics of the absolute difference.
    """

    run: int
    signal: str
    unit: str
    mean: float
    median: float
    percentile_90: float


@dataclasses.dataclass(frozen=True)
class Curves:
    """The signals of a run over time, by their names, in degrees and °C.

    - ``time``, ``signals``: times since the start of the plan (K,), s, and values (rows, K).
    - ``common``, ``differences``: times (M,), s, and differences from the first run (rows, M);
      empty for the first.
    """

    time: np.ndarray
    signals: dict[str, np.ndarray]
    common: np.ndarray
    differences: dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """How results of one kind differ.

    - ``results``: R of them; the first is what the others are compared with.
    - ``changes``: values that are not the same in all of them.
    - ``differences``: differences of the signals of the other runs from the first.
    - ``distances``: mean distances from the reference by the number of the run, of each
      recording, if there is one plan.
    - ``tracking``: |φ* - φ| of each recording, if there is one plan.
    - ``curves``: signals of each run.
    """

    results: Sequence[ResultFile]
    changes: list[Change]
    differences: list[Difference]
    distances: dict[int, ReferenceDistances]
    tracking: list[Difference]
    curves: list[Curves]

    def to_json(self) -> dict[str, Any]:
        """All but the curves, for JSON."""
        return {
            "runs": [str(result.path) for result in self.results],
            "kinds": [result.kind for result in self.results],
            "changes": [{**dataclasses.asdict(c), "relative": c.relative} for c in self.changes],
            "differences": [dataclasses.asdict(item) for item in self.differences],
            "distances": [
                {"run": run, **distances_summary(distances).to_json()}
                for run, distances in self.distances.items()
            ],
            "tracking": [dataclasses.asdict(item) for item in self.tracking],
        }

    @property
    def names(self) -> list[str]:
        """Names of the runs: the ends of their paths by which they can be told apart."""
        parts = [result.path.parts or (".",) for result in self.results]
        paths = len(set(parts))
        for length in range(1, max(map(len, parts)) + 1):
            names = ["/".join(part[-length:]).replace("//", "/") for part in parts]
            if len(set(names)) == paths:
                break
        return names

    def tables(self) -> dict[str, list[list[str]]]:
        """How far runs are apart: tables with a head by their titles, as far as there are any."""
        tables = {}
        if self.distances:
            tables["mean distance from the plan's reference"] = [
                ["run", "measured", "planned", "best possible within the limits"],
                *(
                    [self.names[run], *map(_degrees, dataclasses.astuple(distances))]
                    for run, distances in self.distances.items()
                ),
            ]
        for title, differences, symbol in (
            ("tracking errors of the plan's recordings", self.tracking, "|{0}* - {0}|"),
            ("absolute differences from the first", self.differences, "|Δ{}|"),
        ):
            rows = [["run", "", "mean", "median", "90th percentile"]]
            for item in differences:
                digits = 3 if item.signal == "duty" else 2
                unit = item.unit if item.unit in ("", "°") else f" {item.unit}"
                numbers = (item.mean, item.median, item.percentile_90)
                cells = [f"{number:.{digits}f}{unit}" for number in numbers]
                what = symbol.format(SIGNALS[item.signal].symbol)
                rows.append([self.names[item.run], what, *cells])
            if differences:
                tables[title] = rows
        return tables

    def changes_table(self) -> list[list[str]]:
        """A head, and a row for each change: name, unit, the values of all runs.

        Values of other runs than the first have the relative difference from it in brackets.
        """
        rows = [["", "unit", *self.names]]
        for change in self.changes:
            cells = [
                f"{text} ({100 * relative:+.3g}%)" if relative else text
                for text, relative in zip(_texts(change.values), change.relative, strict=True)
            ]
            rows.append([change.name, change.unit, *cells])
        return rows


def compare(results: Sequence[ResultFile]) -> Comparison:
    """Compare plans and recordings, or calibrated limbs.

    Args:
        results: two or more of one kind; plans and recordings may be compared with each
            other, and a plan is then what recordings are tracked against.

    Raises:
        ComparisonError: with one sentence, if they are of different kinds or shapes.
    """
    if len(results) < 2:
        raise ComparisonError("There is one result; a comparison needs two or more.")
    first = results[0]
    for other in results:
        if other.kind not in (*_RUN_KINDS, LIMB):
            raise ComparisonError(
                f"{other.path} is a {other.kind}; plans, recordings and limbs are compared."
            )
        if (other.kind == LIMB) != (first.kind == LIMB):
            raise ComparisonError(
                f"{first.path} is a {first.kind} and {other.path} is a {other.kind}; compare "
                "results of one kind."
            )
    changes = [
        change
        for change in _changed([_about(result) for result in results])
        # What plans alone have says nothing of a plan beside its recordings.
        if len({str(value) for value in change.values if value is not None}) > 1
    ]
    limbs = [r.value if r.kind == LIMB else r.value.robot or r.value.parameters for r in results]
    changes += _changed([flattened(limb) for limb in limbs])
    if first.kind == LIMB:
        return Comparison(results, changes, [], {}, [], [])
    _check_shapes(results)
    curves = _curves([result.value for result in results])
    differences = []
    for run, of_run in enumerate(curves[1:], 1):
        for name, values in of_run.differences.items():
            size = np.abs(values)
            numbers = [size.mean(), np.median(size), np.percentile(size, 90)]
            differences.append(Difference(run, name, SIGNALS[name].unit, *map(float, numbers)))
    return Comparison(results, changes, differences, *_tracking(results), curves)


def flattened(parameters: LimbParameters | ConnectedLimbs) -> dict[str, tuple[Any, str]]:
    """All numbers and texts of a limb or robot with units, by names such as "right.law.a1".

    Wires go by their names, and segments by their numbers if there are several. Of a
    calibration it has how well it predicts, and not the fitted values, which the laws have.
    """
    return {
        re.sub(r"\b(limbs|parameters|segments|wires)\.", "", name): entry
        for name, entry in _leaves(parameters, "").items()
    }


def _leaves(value: Any, unit: str, path: str = "") -> dict[str, tuple[Any, str]]:
    leaves: dict[str, tuple[Any, str]] = {}
    if dataclasses.is_dataclass(value):
        if path.endswith((".law", ".bend_sensor", "board")):
            leaves[path] = (type(value).__name__, "")
        for field in dataclasses.fields(value):
            is_fit = isinstance(value, CalibrationRecord) and field.name in _FIT_FIELDS
            rare = field.metadata.get("rare") and getattr(value, field.name) == field.default
            if is_fit or rare:
                continue
            inner = f"{path}.{field.name}" if path else field.name
            leaves |= _leaves(getattr(value, field.name), field.metadata.get("unit", unit), inner)
    elif isinstance(value, list):
        several = len(value) > 1
        for number, item in enumerate(value, 1):
            name = getattr(item, "name", "") or (str(number) if several else "")
            leaves |= _leaves(item, unit, f"{path}.{name}" if name else path)
    elif value not in (None, ""):
        leaves[path] = (value, unit)
    return leaves


def _about(result: ResultFile) -> dict[str, tuple[Any, str]]:
    """Values of a result's summary and provenance with their units, and its kind."""
    summary = result.summary
    if result.provenance:
        summary += result.provenance.summary()
    known = {entry.name: (entry.value, entry.unit) for entry in summary.entries + summary.details}
    return {"kind": (result.kind, "")} | {
        name: entry for name, entry in known.items() if entry[0] not in (None, "")
    }


def _changed(runs: Sequence[dict[str, tuple[Any, str]]]) -> list[Change]:
    """The values that are not the same in all runs."""
    changes = []
    for name in dict.fromkeys(itertools.chain.from_iterable(runs)):
        values = [run[name][0] if name in run else None for run in runs]
        first = values[0]
        # NaN is like NaN.
        if any(value != first and (value == value or first == first) for value in values):
            changes.append(Change(name, next(run[name][1] for run in runs if name in run), values))
    return changes


def _is_size(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and bool(np.isfinite(value))


def _check_shapes(results: Sequence[ResultFile]) -> None:
    limbs = [result.value.parameters for result in results]
    layouts = [LimbModel.of(one).layout for one in limbs]
    shapes = [(len(each.bends_of), each.num_wires, each.num_bends) for each in layouts]
    for result, shape in zip(results, shapes, strict=True):
        if shape != shapes[0]:
            raise ComparisonError(
                f"{results[0].path} is of {shapes[0][0]} segments and {shapes[0][1]} wires, but "
                f"{result.path} of {shape[0]} and {shape[1]}, with {shapes[0][2]} and {shape[2]} "
                "bends; compare runs of limbs alike."
            )
        if len(result.value.time) < 2:
            raise ComparisonError(f"{result.path} has fewer than two samples to compare.")


def _curves(runs: Sequence[Recording | Trajectory]) -> list[Curves]:
    """Signals of all runs, and at the samples of each their differences from the first."""
    runs = [run.since_start() if isinstance(run, Trajectory) else run for run in runs]
    curves: list[Curves] = []
    for number, run in enumerate(runs):
        time, signals = _signals(run)
        common = (time >= runs[0].time[0]) & (time <= runs[0].time[-1]) & (number > 0)
        if number and not common.any():
            raise ComparisonError(
                f"Run {number + 1} lasts from {time[0]:g} s to {time[-1]:g} s, and the first from "
                f"{runs[0].time[0]:g} s to {runs[0].time[-1]:g} s: they have no time in common."
            )
        first = _at(runs[0], time[common])
        differences = {
            # Without what is but rounding, which would look like a difference in a chart.
            name: np.round(values[:, common] - first[name], 9)
            for name, values in signals.items()
        }
        curves.append(Curves(time, signals, time[common], differences))
    return curves


def _signals(run: Recording | Trajectory) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times of the samples that are usable, and the signals at them, in degrees and °C."""
    good = run.usable if isinstance(run, Recording) else np.ones(len(run.time), bool)
    signals = {
        "bend_angle": np.rad2deg(run.bend_angle[:, good]),
        "measured_temperature": run.measured_temperature[:, good],
        "duty": run.duty[:, good],
    }
    return run.time[good], signals


def _at(run: Recording | Trajectory, times: np.ndarray) -> dict[str, np.ndarray]:
    """The signals of a run at other times."""
    time, signals = _signals(run)
    found = {
        name: np.array([np.interp(times, time, row) for row in values])
        for name, values in signals.items()
    }
    if isinstance(run, Trajectory) and len(times):
        found["bend_angle"] = np.rad2deg(run.bend_angle_at(times))  # cubic between knots
    return found


def _tracking(
    results: Sequence[ResultFile],
) -> tuple[dict[int, ReferenceDistances], list[Difference]]:
    """How near each recording is to the reference and to the plan, if there is one plan."""
    plans = [result.value for result in results if result.kind == TRAJECTORY]
    recordings = {n: result.value for n, result in enumerate(results) if result.kind == RECORDING}
    distances: dict[int, ReferenceDistances] = {}
    tracked: list[Difference] = []
    if len(plans) != 1 or not recordings:
        return distances, tracked
    (plan,) = plans
    nearest = nearest_bend_angle(plan)
    for number, recording in recordings.items():
        errors = dataclasses.astuple(tracking_errors(plan, [recording]))
        tracked.append(Difference(number, "bend_angle", "°", *np.rad2deg(errors).tolist()))
        distances[number] = reference_distances(plan, [recording], nearest)
    return distances, tracked


def _texts(values: Sequence[Any]) -> list[str]:
    """Values in words, numbers with three digits or with as many as it takes to tell them apart."""
    for digits in (3, 6, 9, 17):
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
    names, runs = comparison.names, []
    for name, result in zip(names, comparison.results, strict=True):
        made = result.provenance
        by = f"soft-limb {made.version} {made.commit}".strip() if made else "not known"
        runs.append([name, result.kind, by, made.time if made else ""])
    parts: list[page.Part] = [page.section("Runs", page.table(["", "kind", "made by", "at"], runs))]
    if comparison.curves:
        tables = [
            page.table(head, rows, f"{title[0].upper()}{title[1:]}.")
            for title, (head, *rows) in comparison.tables().items()
        ]
        said = f"Below each signal is its difference (Δ) from that of {names[0]}."
        chart = page.chart(_panels(comparison), f"All runs, and what differs from {names[0]}")
        parts.append(page.section("How far apart they are", *tables))
        parts.append(page.section("All runs", page.paragraph(said), chart))
    head, *rows = comparison.changes_table()
    caption = f"In brackets the difference from {names[0]}, over its size."
    changed = page.table(head, rows, caption) if rows else page.paragraph("Nothing changed.")
    parts.append(page.section("What changed", changed))
    others = names[1] if len(names) == 2 else f"{len(names) - 1} others"
    return page.make_page(f"{names[0]} compared with {others}", parts, Provenance.now())


def _panels(comparison: Comparison) -> list[Panel]:
    results, names = comparison.results, comparison.names
    parameters = results[0].value.parameters
    panels = []
    layout = LimbModel.of(parameters).layout
    drawn: list[tuple[str, list[int], str]] = []  # in each panel: a signal's rows, and where
    for bends, wires, suffix in zip(
        layout.bends_of, layout.wires_of, parameters.segment_suffixes, strict=True
    ):
        for bend in range(bends.start, bends.stop):
            drawn.append(("bend_angle", [bend], parameters.bend_suffixes[bend]))
        wired = list(range(wires.start, wires.stop))
        drawn += [("measured_temperature", wired, suffix), ("duty", wired, suffix)]
    for signal, rows, suffix in drawn:
        bends_alone = signal == "bend_angle"
        values, differences = _references(results, rows[0]) if bends_alone else [], []
        for number, curves in enumerate(comparison.curves):
            color = _COLORS[number % len(_COLORS)]
            for row, style in zip(rows, itertools.cycle(_STYLES), strict=False):
                wire = "" if bends_alone else parameters.wire_names[row]
                name = ", ".join(filter(None, [names[number], wire]))
                values.append(Curve(name, curves.time, curves.signals[signal][row], color, *style))
                if number:
                    apart = curves.common, curves.differences[signal][row]
                    differences.append(Curve(name, *apart, color, *style))
        kind = SIGNALS[signal]
        panels.append(kind.panel(values, suffix, y_range=None))
        unit = f" ({kind.unit})" * bool(kind.unit)
        panels.append(Panel(f"Δ{kind.symbol}{unit}", differences, height=170))
    return panels


def _references(results: Sequence[ResultFile], bend: int) -> list[Curve]:
    """What the plans are for; one that several share is drawn once."""
    drawn: list[Curve] = []
    for result in results:
        if result.kind == TRAJECTORY:
            plan = result.value.since_start()
            angle = np.rad2deg(plan.reference[bend])
            if not any(np.array_equal(curve.y, angle) for curve in drawn):
                drawn.append(Curve("reference φ_REF", plan.time, angle, REFERENCE_COLOR))
    return drawn
