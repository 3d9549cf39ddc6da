"""Makes the measured tables of README and docs anew, from one evaluation: `make tables`.

python docs/tables.py FOLDER   FOLDER is what `examples/reproduce_paper.py` left

A table stands in a page between `<!-- table NAME -->` and `<!-- end -->`. Tables of the evaluation
come from its results.json, those of a benchmark from FOLDER/BENCHMARK.txt, what it printed.
"""

import argparse
import dataclasses
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from soft_limb.evaluation import tables
from soft_limb.evaluation.experiment import MOTIONS
from soft_limb.evaluation.tables import Followed, Summary

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
Rows = Sequence[Sequence[str]]


def read_summaries(path: Path) -> list[Summary]:
    """The summaries of a ``results.json``, whose ways of driving become `Followed` again."""

    def followed(values: dict) -> object:
        return Followed(**values) if "true_reference" in values else values

    limbs = json.loads(path.read_text(encoding="utf-8"), object_hook=followed)
    fields = [field.name for field in dataclasses.fields(Summary)]
    return [Summary(**{name: limb[name] for name in fields}) for limb in limbs]


def split_rows(summaries: Sequence[Summary], which: int) -> Rows:
    return [["", *MOTIONS], *tables.split_table(summaries, which)]


def law_rows(summaries: Sequence[Summary]) -> Rows:
    """For each limb its law, and open loop the mean true distance of each motion."""
    rows = [["limb", "law", *MOTIONS]]
    for limb in summaries:
        ways = [limb.ways[motion][tables.OPEN_LOOP] for motion in MOTIONS]
        kind = "" if limb.physics == "lumped" else f"{limb.physics}, "
        distances = [f"{way.true_reference:.2f}°, {way.true:.2f}°" for way in ways]
        rows.append([f"{kind}seed {limb.seed}", limb.law, *distances])
    return rows


TABLES: dict[str, Callable[[Sequence[Summary]], Rows]] = {
    "distances": lambda limbs: [tables.DISTANCE_HEADER, *tables.distance_table(limbs)],
    "distances_continuum": lambda limbs: [
        tables.DISTANCE_HEADER,
        *tables.distance_table(limbs, "continuum"),
    ],
    "table_1": lambda limbs: [tables.TABLE_1_HEADER, *tables.table_1(limbs)],
    "limbs": law_rows,
    "disturbances": lambda limbs: [tables.DISTURBANCE_HEADER, *tables.disturbance_table(limbs)],
    "models": lambda limbs: [tables.APPROACH_HEADER, *tables.approach_table(limbs)],
    "split": lambda limbs: split_rows(limbs, 0),
    "split_parts": lambda limbs: split_rows(limbs, 1),
}


def markdown(rows: Rows) -> str:
    head, *body = rows
    lines = [head, ["---"] * len(head), *body]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="Writes the measured tables of the pages.")
    parser.add_argument("folder", type=Path, help="what examples/reproduce_paper.py left")
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
