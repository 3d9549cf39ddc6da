"""Makes the measured tables of README and docs anew, from one evaluation: `make tables`.

python docs/tables.py FOLDER   FOLDER is what `examples/reproduce_paper` left

A table stands in a page between `<!-- table NAME -->` and `<!-- end -->`. Tables of the evaluation
come from its results.json, those of a benchmark from FOLDER/BENCHMARK.txt, what it printed.
"""

import argparse
import dataclasses
import json
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "examples"))

from reproduce_paper import tables  # noqa: E402
from reproduce_paper.tables import RolloutStatistics, Summary  # noqa: E402

BLOCK = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def read_summaries(path: Path) -> list[Summary]:
    """Return the summaries of a ``results.json``."""

    def followed(values: dict) -> object:
        return RolloutStatistics(**values) if "true_reference" in values else values

    limbs = json.loads(path.read_text(encoding="utf-8"), object_hook=followed)
    fields = [field.name for field in dataclasses.fields(Summary)]
    return [Summary(**{name: limb[name] for name in fields}) for limb in limbs]


TABLES: dict[str, Callable[[Sequence[Summary]], tables.Rows]] = {
    "distances": tables.distance_table,
    "distances_continuum": lambda limbs: tables.distance_table(limbs, "continuum"),
    "limbs": tables.law_table,
    "disturbances": tables.disturbance_table,
    "models": tables.approach_table,
    "split": tables.step_table,
}


def markdown(rows: tables.Rows) -> str:
    head, *body = rows
    lines = [head, ["---"] * len(head), *body]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="Writes the measured tables of the pages.")
    parser.add_argument("folder", type=Path, help="what examples/reproduce_paper left")
    folder = parser.parse_args().folder
    summaries = read_summaries(folder / "results.json")
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = page.read_text(encoding="utf-8")

        def made(block: re.Match) -> str:
            begin, name, end = block.groups()
            if name in TABLES:
                return begin + markdown(TABLES[name](summaries)) + end
            printed = (folder / f"{name}.txt").read_text(encoding="utf-8")
            return f"{begin}```text\n{printed}```\n{end}"

        if (new := BLOCK.sub(made, text)) != text:
            page.write_text(new, encoding="utf-8")
            print(page.relative_to(ROOT))


if __name__ == "__main__":
    main()
