"""The summary of a result, once for terminals, JSON, pages, notebooks and `compare`."""

import dataclasses
import html
from typing import Any, NamedTuple


class Entry(NamedTuple):
    """One statement about a result.

    - ``name``: subject of the statement, such as "duration", and its key in JSON.
    - ``value``: number, text, or a list or dict of these; None if it is not known.
    - ``unit``: unit of all numbers in the value; empty for texts and bare numbers.
    - ``sentence``: the value in words; if empty, value and unit are printed, and nothing
      for a value that is None or empty. None for a value that only JSON has.

    An entry with a sentence and no value is not in JSON.
    """

    name: str
    value: Any = None
    unit: str = ""
    sentence: str | None = ""

    @property
    def text(self) -> str:
        """The statement for people, without its name; empty if it is only for JSON."""
        if self.sentence or self.sentence is None:
            return self.sentence or ""
        if self.value in (None, "", []):
            return ""
        # Print value and unit.
        values = self.value if isinstance(self.value, list) else [self.value]
        texts = [f"{value:g}" if isinstance(value, float) else str(value) for value in values]
        return ", ".join(texts) + {"": "", "°": "°"}.get(self.unit, f" {self.unit}")


@dataclasses.dataclass(frozen=True)
class Summary:
    """The statements about a result, in the order in which they are printed.

    - ``entries``: `Entry` for each.
    - ``details``: further entries, which a ``repr`` leaves out.
    """

    entries: list[Entry]
    details: list[Entry] = dataclasses.field(default_factory=list)

    @classmethod
    def of(cls, texts: dict[str, str], values: dict[str, Any]) -> "Summary":
        """Return a summary whose texts for people and values for JSON have different names."""
        entries = [Entry(name, sentence=text) for name, text in texts.items() if text]
        details = [Entry(name, value, "", None) for name, value in values.items()]
        return cls(entries, details)

    def __add__(self, other: "Summary") -> "Summary":
        return Summary(self.entries + other.entries, self.details + other.details)

    def texts(self) -> dict[str, str]:
        """Return the texts for people by their names."""
        texts = {}
        for entry in self.entries + self.details:
            if text := entry.text:
                texts[entry.name] = text
        return texts

    def line(self) -> str:
        """Return the statements in one line, without names and details."""
        return ", ".join(entry.text for entry in self.entries if entry.text)

    def __str__(self) -> str:
        """Return a line for each statement, its name in a column of 12 characters or more."""
        texts = self.texts()
        width = max(12, 1 + max(map(len, texts), default=0))
        margin = "\n" + " " * width  # of further lines of a text
        lines = [name.ljust(width) + text.replace("\n", margin) for name, text in texts.items()]
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Return the values by their names."""
        values = {}
        for entry in self.entries + self.details:
            if entry.value is not None or not entry.sentence:
                values[entry.name] = entry.value
        return values

    def to_html(self, caption: str) -> str:
        """Return a small table for notebooks."""
        rows = ""
        for name, text in self.texts().items():
            rows += f"<tr><th style='text-align:left'>{html.escape(name)}</th>"
            rows += f"<td style='text-align:left'>{html.escape(text)}</td></tr>"
        return f"<table><caption>{html.escape(caption)}</caption>{rows}</table>"


class Summarized:
    """A result with a summary, which is its ``repr`` and its table in notebooks."""

    def summary(self) -> Summary:
        """Return the summary of the result."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.summary().line()})"

    def _repr_html_(self) -> str:
        return self.summary().to_html(type(self).__name__)
