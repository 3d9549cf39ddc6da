"""The tables of a comparison as texts, for the terminal and for pages."""

from collections.abc import Sequence
from typing import Any

from soft_limb.results.comparison import NONE, Change, Comparison, Difference

LONGEST = 60  # characters of a value
_NAMES = {"bend_angle": "φ", "measured_temperature": "V", "duty": "D"}


def changes_table(comparison: Comparison, changes: Sequence[Change]) -> list[list[str]]:
    """A head, and a row for each change: name, unit, the values of all runs.

    Values of other runs than the first have the relative difference from it in brackets.
    """
    rows = [["", "unit", *run_names(comparison)]]
    for change in changes:
        cells = [
            f"{_text(value)} ({100 * relative:+.3g}%)" if relative else _text(value)
            for value, relative in zip(change.values, change.relative, strict=True)
        ]
        rows.append([change.name, change.unit, *cells])
    return rows


def motions_table(comparison: Comparison) -> list[list[str]]:
    """Table I side by side: a head, and a row for each number of it, with differences."""
    names = run_names(comparison)
    rows = [["motion, way", "", names[0]]]
    for name in names[1:]:
        rows[0] += [name, "difference"]
    for change in comparison.motions:
        first, *others = change.values
        cells = [_rounded(first)]
        for value in others:
            known = None not in (first, value)
            cells += [_rounded(value), f"{_rounded(value - first, '+')}" if known else NONE]
        rows.append([change.name, change.unit, *cells])
    return rows


def differences_table(
    comparison: Comparison, differences: Sequence[Difference], symbol: str
) -> list[list[str]]:
    """A head, and a row for each difference with its statistics.

    Args:
        symbol: of what differs, with "{}" for the signal's.
    """
    names = run_names(comparison)
    rows = [["run", "", "mean", "median", "90th percentile"]]
    for item in differences:
        digits = 3 if item.signal == "duty" else 2
        unit = item.unit if item.unit in ("", "°") else f" {item.unit}"
        numbers = (item.mean, item.median, item.percentile_90)
        rows.append(
            [
                names[item.run],
                symbol.format(_NAMES[item.signal]),
                *(f"{number:.{digits}f}{unit}" for number in numbers),
            ]
        )
    return rows


def run_names(comparison: Comparison) -> list[str]:
    """What the runs are called: the ends of their paths by which they can be told apart."""
    parts = [result.path.parts or (".",) for result in comparison.results]
    paths = len(set(parts))
    for length in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-length:]).replace("//", "/") for part in parts]
        if len(set(names)) == paths:
            break
    return names


def _rounded(value: Any, sign: str = "") -> str:
    if value is None:
        return NONE
    return f"{value:{sign}.2f}" if isinstance(value, float) else f"{value:{sign}d}"


def _text(value: Any) -> str:
    if value is None:
        return NONE
    if isinstance(value, float):
        return f"{value:.6g}"
    text = " ".join(str(value).split())
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."
