"""The columns of a log: what their names say, and their numbers."""

import functools
import itertools
import operator
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from calibration.import_logs.evidence import MIN_VOTE, Steps, correlation
from calibration.import_logs.table import LogTable
from calibration.import_logs.words import TEMPERATURE, Name

MAX_DUTY = 65535.0  # that no number of a duty is beyond
MAX_NUMBER = 1e9  # that no number but a time's is beyond
MISSING_CODES = (-9999.0, -999.0, -127.0, 999.0, 9999.0)  # what loggers write for no reading
MIN_HEAT_CORRELATION = 0.5  # correlation of a column with the heat that it follows
MIN_NUMBERS = 6  # of a column that is looked at


class Column:
    """A column: its name, and its numbers (K,) in rows whose time increases."""

    def __init__(self, name: Name, values: np.ndarray, steps: Steps):
        self.name = name
        self.text = name.text
        self.values = values
        self.steps = steps
        self.is_number = name.quantity in ("", "counts")  # of no other quantity
        is_missing = np.isnan(values)
        self.present = values[~is_missing] if is_missing.any() else values
        self.lowest, self.low, self.high = np.quantile(self.present, [0.003, 0.02, 0.99])
        self.span = float(np.ptp(self.present))
        self.top = float(np.abs(self.present).max())
        self.first = float(np.median(self.present[:5]))
        # A duty is 0 at times, stands still mostly, and is not negative.
        self.looks_like_heat = False
        if self.span and self.present.min() >= 0 and self.present.max() <= MAX_DUTY:
            is_mostly_still = bool(np.mean(np.diff(self.present) == 0) > 0.5)
            self.looks_like_heat = is_mostly_still and bool((self.present == 0).mean() > 0.02)

    def __str__(self) -> str:
        return self.text

    @functools.cached_property
    def means(self) -> np.ndarray:
        """Its mean in each step (N,)."""
        return self.steps.means(self.values)

    def heat(self, sign: float = 1.0) -> np.ndarray:
        """Return the heat of a duty in each step (N,), by its positive or negative numbers."""
        return self.steps.heat(np.clip(sign * self.values, 0.0, None)) / (self.top or 1.0)

    def votes(self, heats: np.ndarray) -> np.ndarray:
        """Return its response to each heat (W,), in standard errors; 0 where it is weak."""
        gains, errors = self.steps.response(heats, self.means)
        votes = gains / errors
        for index, heat in enumerate(heats):
            votes[index] *= abs(correlation(heat, self.means)) > MIN_HEAT_CORRELATION
        return votes

    def follows(self, heats: np.ndarray) -> bool:
        """Return whether it clearly responds to one of some heats (W, N)."""
        return bool((np.abs(self.votes(heats)) > MIN_VOTE).any())


class ColumnList(list[Column]):
    """Some columns of a log."""

    def each(self, attribute: str) -> list[Any]:
        """Return an attribute of each column, such as "name.label"."""
        return list(map(operator.attrgetter(attribute), self))

    def where(self, is_chosen: Callable[[Column], object]) -> "ColumnList":
        """Return the columns for which a condition holds."""
        return ColumnList(filter(is_chosen, self))

    @property
    def moving(self) -> "ColumnList":
        """The columns whose numbers change."""
        return self.where(lambda column: column.span > 0)

    def having(self, attribute: str, value: object) -> "ColumnList":
        """Return the columns that have a value of an attribute."""
        return ColumnList(itertools.compress(self, [own == value for own in self.each(attribute)]))

    def labelled(self, label: str) -> "ColumnList":
        """Return the columns with a wire's label in their names; none if it is empty."""
        return self.having("name.label", label) if label else ColumnList()

    def without(self, columns: Iterable[object]) -> "ColumnList":
        """Return the columns that are not among some others."""
        others = list(columns)
        return self.where(lambda column: column not in others)


def read_columns(
    table: LogTable, names: list[Name], rows: np.ndarray | slice, steps: Steps
) -> tuple[ColumnList, list[float]]:
    """Return the columns with some names, in some rows, and the numbers that are no reading."""
    values_of_name = {}
    missing: set[float] = set()
    for name in names:
        values_of_name[name] = table.numbers(name.text)[rows]
        missing |= _missing_codes(values_of_name[name])
    # Leave out these numbers, and numbers that no signal has.
    columns = ColumnList()
    for name, values in values_of_name.items():
        is_left_out = np.abs(values) > MAX_NUMBER
        if missing:
            is_left_out |= np.isin(values, list(missing))
        if name.role == TEMPERATURE:
            is_left_out |= values == 0
        cleaned = np.where(is_left_out, np.nan, values) if is_left_out.any() else values
        if np.count_nonzero(~np.isnan(cleaned)) >= MIN_NUMBERS:
            columns.append(Column(name, cleaned, steps))
    return columns, sorted(missing)


def _missing_codes(values: np.ndarray) -> set[float]:
    """Return the `MISSING_CODES` in a column (K,) that are far from all readings there."""
    is_code = np.isin(values, MISSING_CODES)
    readings = values[~np.isnan(values) & ~is_code]
    if not is_code.any() or not len(readings):
        return set()
    low, high = np.quantile(readings, [0.01, 0.99])
    codes = np.unique(values[is_code])
    is_near = (codes > low - 2 * (high - low) - 1) & (codes < high + 2 * (high - low) + 1)
    return set(codes[~is_near].tolist())
