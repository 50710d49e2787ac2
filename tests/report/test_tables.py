"""What commands print has room in a line, on terminals wide and narrow and in a pipe."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console, RenderableType

from dosplan.report.tables import Prose, comparison_tables, summary_tables, table
from dosplan.results.folder import RunFolder
from dosplan.results.markdown import LINE, comparison_text, folded, parted
from dosplan.results.summary import Summary, read_summary

SUITE = Path(__file__).parents[2] / "results" / "suite"


@pytest.fixture(scope="module")
def summary() -> Summary:
    return read_summary(RunFolder(SUITE))


def _lines(shown: RenderableType, width: int) -> list[str]:
    console = Console(width=width)
    with console.capture() as captured:
        console.print(shown, highlight=False, markup=False)
    return [line.rstrip() for line in captured.get().splitlines()]


@pytest.mark.parametrize("width", [80, 200])
def test_figures_of_a_run_and_of_its_arms_are_whole_and_below_100_characters(
    summary: Summary, width: int
) -> None:
    assert summary.comparison is not None
    for shown in (summary_tables(summary), comparison_tables(summary.comparison)):
        lines = _lines(shown, width)
        assert max(map(len, lines)) <= min(width, LINE)
        assert not any("…" in line for line in lines)  # Nothing was cut off.


def test_a_comparison_prints_as_text_below_100_characters(summary: Summary) -> None:
    assert summary.comparison is not None
    lines = comparison_text(summary.comparison).splitlines()
    assert max(map(len, lines)) <= LINE
    # All there is of collisions: figures and their p in one table, counts and places in the other.
    rows = [line.split() for line in lines if line.startswith("Collision %")]
    found = summary.comparison.differences["collision"]
    assert [row[2] for row in rows] == [str(found.n), str(found.only_a)]
    assert rows[0][-1] == rows[1][-2] == f"{found.p:.3g}"


def test_columns_without_room_go_below_with_the_names_of_the_rows() -> None:
    cells = (["run", "a", "b", "c"], [["one", "1111", "2222", "3333"]])
    assert parted([cells], width=22, gap=2) == [
        [(["run", "a", "b"], [["one", "1111", "2222"]])],
        [(["run", "c"], [["one", "3333"]])],
    ]
    assert parted([cells], width=23, gap=2) == [[cells]]
    assert parted([cells], width=8, gap=2) == [[cells]]  # The names leave no room for any column.
    assert [line.split() for line in _lines(table(*cells), 24) if "1" in line or "3" in line] == [
        ["one", "1111", "2222"],
        ["one", "3333"],
    ]


def test_prose_is_broken_between_words_and_shows_brackets() -> None:
    path = "/a/path-of/" + "x" * 100
    assert folded(f"results in {path}", 40) == f"results in\n{path}"
    assert folded("one two\nthree four", 7, indent="  ") == "one two\nthree\n  four"
    assert _lines(Prose("[red] is no colour here"), 12) == ["[red] is no", "colour here"]
