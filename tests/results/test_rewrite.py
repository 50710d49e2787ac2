"""Summaries of runs of which the rows alone are kept."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from dosplan.results.rewrite import rewrite_summary
from dosplan.system.files import FileError, read_json, write_json
from tests.support.close import assert_close

PUBLISHED = Path(__file__).parents[2] / "results"


RUNS = (
    *("suite", "suite/realistic", "suite/five-futures", "suite-1"),
    *("recorded", "recorded/realistic"),
    *("planning/reactive/suite-1", "planning/reactive/recorded"),
    *sorted(f"proof/runs/{path.name}" for path in (PUBLISHED / "proof/runs").glob("*/")),
    *sorted(f"frontier/runs/{path.name}" for path in (PUBLISHED / "frontier/runs").glob("*/")),
)


@pytest.mark.parametrize("name", RUNS)
def test_published_summaries_follow_from_their_rows(name: str, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    copy.mkdir()
    for file in ("run.json", "scenarios.jsonl", "summary.json"):
        shutil.copy(PUBLISHED / name / file, copy)
    # Percentiles of cycles are kept, all else is computed.
    old = read_json(copy / "summary.json")
    percentiles = ("cycle_ms_p50", "cycle_ms_p99")
    kept = {
        arm: {key: old[arm][key] for key in percentiles}
        for arm in ("with_dos", "without_dos")
        if arm in old
    }
    write_json(copy / "summary.json", kept)
    rewrite_summary(copy)
    assert_close(read_json(copy / "summary.json"), read_json(PUBLISHED / name / "summary.json"))
    # Of the many runs of the frontier, the figures alone are kept.
    if (text := PUBLISHED / name / "summary.md").exists():
        assert (copy / "summary.md").read_text(encoding="utf-8") == text.read_text(encoding="utf-8")


def test_no_summary_is_an_error_of_one_line(tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(PUBLISHED / "suite-1", copy)
    (copy / "summary.json").unlink()
    with pytest.raises(FileError, match=r"summary\.json"):
        rewrite_summary(copy)
