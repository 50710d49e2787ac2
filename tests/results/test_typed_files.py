"""``run.json``, ``summary.json`` and the rows are dataclasses, in files of older versions, too."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from dosplan.results.comparison import compare_rows
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import read_manifest, write_manifest
from dosplan.results.rows import read_rows, read_run, row_line
from dosplan.results.summary import read_summary, write_summary
from dosplan.scoring.score import failed_score
from dosplan.system.files import FileError, read_json
from dosplan.types import Arm, EpisodeKey, Outcome
from tests.support.close import assert_close

PUBLISHED = Path(__file__).parents[2] / "results"


@pytest.mark.parametrize("name", ["suite-1", "recorded"])
def test_a_published_run_opens_and_is_written_back_as_it_was(name: str, tmp_path: Path) -> None:
    published = RunFolder(PUBLISHED / name)
    manifest, rows = read_run(published.path)
    assert len(manifest.scenarios) == 150
    assert manifest.config.arms == (Arm.WITH_DOS, Arm.WITHOUT_DOS)
    summary = read_summary(published)
    for arm, figures in summary.arms.items():
        mine = [row for row in rows if row.arm is arm]
        assert figures["n"] == len(mine) == 150
        assert figures["success_rate"] == sum(r.outcome is Outcome.SUCCESS for r in mine) / 150
    assert summary.comparison is not None
    a, b = ([row for row in rows if row.arm is arm] for arm in (Arm.WITHOUT_DOS, Arm.WITH_DOS))
    assert_close(compare_rows(a, b, "without_dos", "with_dos"), summary.comparison)
    copy = RunFolder(tmp_path)
    write_summary(copy, summary)
    assert read_json(copy.summary) == read_json(published.summary)
    write_manifest(copy, manifest)
    assert read_manifest(copy) == manifest
    old, new = read_json(published.manifest), read_json(copy.manifest)
    settings = old.pop("config")
    settings.pop("replan_every", None)  # It is the period of a loop now.
    assert settings.items() <= new.pop("config").items()  # It may have newer settings.
    assert old.items() <= new.items()


def test_a_key_that_is_absent_has_its_default(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    content = read_json(PUBLISHED / "suite-1" / "run.json")
    del content["started"], content["config"]["solutions"]
    content["config"]["of a newer version"] = 3
    folder.manifest.write_text(json.dumps(content))
    manifest = read_manifest(folder)
    assert manifest.started == ""
    assert manifest.config.solutions is False


@pytest.mark.parametrize(
    ("place", "value", "told"),
    [
        (["with_dos", "n"], "150", "with_dos.n: Expected `int`, got `str`"),
        (["run"], None, "run: Expected `object`, got `null`"),
        (["comparison", "changes"], [3], "comparison.changes[0]: Expected `object`, got `int`"),
    ],
)
def test_a_summary_of_another_type_is_one_line_that_names_the_key(
    tmp_path: Path, place: list[str], value: object, told: str
) -> None:
    folder = RunFolder(tmp_path)
    content: Any = read_json(PUBLISHED / "suite-1" / "summary.json")
    part = content
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    folder.summary.write_text(json.dumps(content))
    with pytest.raises(FileError) as caught:
        read_summary(folder)
    assert str(caught.value).startswith(f"{folder.summary} is not a summary.json of this version")
    assert f"({told})" in str(caught.value)


@pytest.mark.parametrize("text", ["\ud800", "a\nb", "é", 'with "quotes"'])
def test_a_row_may_hold_any_text(tmp_path: Path, text: str) -> None:
    row = failed_score(EpisodeKey(text, Arm.WITH_DOS), text)
    (tmp_path / "rows").write_text(row_line(row))
    assert read_rows(tmp_path / "rows") == [row]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('"steps": 0', '"steps": "0"', "steps: Expected `int`, got `str`"),
        ('"steps": 0', '"steps": true', "steps: Expected `int`, got `bool`"),
        ('"steps"', '"step"', "there is no column 'step'"),
        ('"steps": 0, ', "", "Object missing required field `steps`"),
        ('"velocity": 0.0', '"velocity": 1e999', "1e999 is not a finite number"),
        ('"velocity": 0.0', '"velocity": -Infinity', "-Infinity is not a finite number"),
        ('"with_dos"', '"both\\n"', "arm: Invalid enum value 'both\\n'"),
    ],
)
def test_a_line_that_is_no_row_says_what_is_wrong(
    tmp_path: Path, old: str, new: str, told: str
) -> None:
    path = tmp_path / "scenarios.jsonl"
    line = row_line(failed_score(EpisodeKey("s", Arm.WITH_DOS), ""))
    path.write_text(line + line.replace(old, new))
    with pytest.raises(FileError) as caught:
        read_rows(path)
    assert str(caught.value) == (
        f"{path}, line 2, is not a row of this version ({told}); "
        "delete the line to have its episode driven again"
    )


def test_a_whole_number_may_stand_for_a_float(tmp_path: Path) -> None:
    line = row_line(failed_score(EpisodeKey("s", Arm.WITH_DOS), "")).replace(
        '"velocity": 0.0', '"velocity": 3'
    )
    (tmp_path / "rows").write_text(line)
    (row,) = read_rows(tmp_path / "rows")
    assert type(row.velocity) is float
