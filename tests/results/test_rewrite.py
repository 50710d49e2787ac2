"""Summaries of runs of which the rows alone are kept."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from dosplan.results.rewrite import rewrite_summary
from dosplan.system.files import FileError, read_json, write_json

PUBLISHED = Path(__file__).parents[2] / "results"


@pytest.mark.parametrize("name", ["suite-1", "recorded"])
def test_published_summaries_follow_from_their_rows(name: str, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(PUBLISHED / name, copy)
    # Percentiles of cycles are kept, all else is computed.
    old = read_json(copy / "summary.json")
    kept = {key: old["with_dos"][key] for key in ("cycle_ms_p50", "cycle_ms_p99")}
    write_json(copy / "summary.json", {"with_dos": kept, "without_dos": old["without_dos"]})
    (copy / "summary.md").unlink()
    rewrite_summary(copy)
    for file in ("summary.json", "summary.md"):
        published = (PUBLISHED / name / file).read_text(encoding="utf-8")
        assert (copy / file).read_text(encoding="utf-8") == published


def test_no_summary_is_an_error_of_one_line(tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(PUBLISHED / "suite-1", copy)
    (copy / "summary.json").unlink()
    with pytest.raises(FileError, match=r"summary\.json"):
        rewrite_summary(copy)
