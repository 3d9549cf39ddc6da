"""The map from the paper to the code points to what is there."""

import importlib
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "paper_to_code.md").read_text(encoding="utf-8")
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in TEXT.splitlines()
    if line.startswith("| ") and "`" in line
]


def test_symbols_and_tests_exist():
    for row in ROWS:
        module, _, name = re.search(r"`([\w.]+)`", row[2])[1].rpartition(".")
        assert hasattr(importlib.import_module(module), name), row[0]
        path, _, test = re.search(r"`(.+)`", row[3])[1].partition("::")
        assert f"def {test}(" in (ROOT / "tests" / path).read_text(encoding="utf-8"), row[0]


def test_every_equation_algorithm_figure_and_table_has_a_row():
    first = " ".join(row[0] for row in ROWS)
    assert {int(n) for n in re.findall(r"\((\d+)\)", first)} == set(range(1, 21))
    figures = {int(n) for n in re.findall(r"\d+", " ".join(re.findall(r"Figs?\. [\d, ]+", first)))}
    assert figures == set(range(1, 8))
    assert "Algorithm 1" in first
    assert "Table I" in first
