"""Writes the table of kinds in ``scenarios/suite/README.md``: ``python scenarios/kinds.py``.

It is made from what each kind says of itself, and from the manifest.
"""

from __future__ import annotations

import csv
import sys
from collections import Counter
from pathlib import Path

from suitegen.futures.kinds import KINDS

SUITE = Path(__file__).resolve().parent / "suite"
BEGIN, END = "<!-- kinds: begin -->\n", "<!-- kinds: end -->"


def table() -> str:
    """The table of kinds, with how many scenarios of each there are.

    Returns:
        Markdown.
    """
    with (SUITE / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        count = Counter(row["kind"] for row in csv.DictReader(stream))
    lines = [
        "| kind | n | what happens, and what the past does not tell | intentions |",
        "|---|--:|---|---|",
    ]
    lines += [
        f"| {kind.name} (`{kind.code}`) | {count[kind.name]} | {kind.description} "
        f"| {kind.intentions} |"
        for kind in KINDS.values()
    ]
    lines += ["", "| kind | what interPlan has of it | what is new |", "|---|---|---|"]
    lines += [f"| {kind.name} | {kind.interplan} | {kind.new} |" for kind in KINDS.values()]
    return "\n".join([*lines, ""])


def with_table(page: str) -> str:
    """A page with the table between its marks.

    Args:
        page: The page as it was.

    Returns:
        The page.
    """
    before, _, rest = page.partition(BEGIN)
    return before + BEGIN + table() + END + rest.partition(END)[2]


def main() -> int:
    """Writes the page.

    Returns:
        Exit status.
    """
    path = SUITE / "README.md"
    path.write_text(with_table(path.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
