"""Nothing in a scenario, a configuration or a run folder runs code or writes outside its folder."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest

from dosplan.cli.main import main
from dosplan.running.run import RunError
from dosplan.scenario import find_scenarios
from dosplan.system.files import FileError
from dosplan.types import Outcome
from tests.support.runs import configured, run_here, untimed, write_scenes


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    return write_scenes(tmp_path / "scenes", 1)


def _files(folder: Path) -> set[Path]:
    return {path for path in folder.rglob("*") if not path.is_dir()}


EVIL_IDS = [
    "../../evil",
    "../" * 40 + "evil",
    "/absolute/evil",
    "..",
    ".",
    "~/evil",
    "a/b/c",
    "%2e%2e%2fevil",
    "C:\\evil",
    "-rf",
    "$(touch evil)",
    "evil\u202egpj",
    "x" * 5000,
    "\u00e4" * 300,
    "[red]evil[/red]",
]


@pytest.mark.parametrize("name", EVIL_IDS)
def test_the_id_of_a_scenario_names_files_in_the_run_folder_only(
    scenes: Path, tmp_path: Path, name: str
) -> None:
    (file,) = scenes.iterdir()
    text = re.sub(
        r'benchmarkID="[^"]*"', lambda _: f"benchmarkID={quoteattr(name)}", file.read_text()
    )
    file.write_text(text)
    before = _files(tmp_path)
    folder = run_here(configured(tmp_path / "deep" / "run", scenes, cache=True))
    new = _files(tmp_path) - before
    assert all(path.resolve().is_relative_to(folder.path.resolve()) for path in new)
    assert len([path for path in new if path.parent == folder.path / "episodes"]) == 2
    rows = untimed(folder)
    assert [row["scenario"] for row in rows] == [name, name]
    assert {row["outcome"] for row in rows} == {"success"}


def test_names_of_files_that_are_no_text_are_rows(scenes: Path, tmp_path: Path) -> None:
    evil = os.fsencode(scenes) + b"/\xff\x1b[31m\n.xml"
    with open(evil, "wb") as file:  # noqa: PTH123 - a name in bytes
        file.write(b"<commonRoad")
    folder = run_here(configured(tmp_path / "run", scenes))
    assert len(untimed(folder)) == 4
    assert main(["list", "scenarios", str(scenes)]) == 0


def test_what_is_no_regular_file_is_a_row_and_waits_for_nobody(
    scenes: Path, tmp_path: Path
) -> None:
    os.mkfifo(scenes / "pipe.xml")
    (scenes / "endless.xml").symlink_to("/dev/zero")
    (scenes / "nowhere.xml").symlink_to("/no/such/file")
    rows = untimed(run_here(configured(tmp_path / "run", scenes)))
    errors = {row["scenario"]: str(row["error"]) for row in rows}
    assert "is not a regular file" in errors["pipe"]
    assert "is not a regular file" in errors["endless"]
    assert "cannot be read" in errors["nowhere"]
    assert errors["ZAM_Fault-00_1_T-1"] == "None"


def test_a_link_in_place_of_the_episodes_is_refused(scenes: Path, tmp_path: Path) -> None:
    config = configured(tmp_path / "run", scenes)
    folder = run_here(config)
    outside = tmp_path / "outside"
    (folder.path / "episodes").rename(outside)
    (folder.path / "episodes").symlink_to(outside)
    for file in outside.iterdir():
        file.unlink()
    with pytest.raises(RunError, match="episodes is a link"):
        run_here(config)
    assert not _files(outside)


@pytest.mark.parametrize("name", ["scenarios.jsonl", "summary.json", "summary.md"])
def test_a_link_in_place_of_a_file_is_replaced_and_not_followed(
    scenes: Path, tmp_path: Path, name: str
) -> None:
    config = configured(tmp_path / "run", scenes)
    folder = run_here(config)
    rows = untimed(folder)
    outside = tmp_path / "outside"
    (folder.path / name).rename(outside)
    kept = outside.read_bytes()
    (folder.path / name).symlink_to(outside)
    next((folder.path / "episodes").iterdir()).unlink()  # So that there is something to drive.
    assert untimed(run_here(config)) == rows
    assert outside.read_bytes() == kept
    assert not (folder.path / name).is_symlink()


def test_a_link_where_a_file_is_being_written_is_not_followed(scenes: Path, tmp_path: Path) -> None:
    config = configured(tmp_path / "run", scenes)
    folder = run_here(config)
    outside = tmp_path / "outside"
    outside.write_text("precious")
    for name in ("scenarios.jsonl", "summary.json"):
        (folder.path / f".{name}.{os.getpid()}.part").symlink_to(outside)
    run_here(config)
    assert outside.read_text() == "precious"


class _Bomb:
    def __reduce__(self) -> Any:
        return Path.touch, (Path("bomb"),)


def test_an_episode_file_runs_no_code(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    config = configured(tmp_path / "run", scenes)
    folder = run_here(config)
    for file in (folder.path / "episodes").iterdir():
        np.savez(file, allow_pickle=True, states=np.array([_Bomb()], dtype=object))
    with pytest.raises(FileError, match="is not an episode file"):
        run_here(config)
    assert not (tmp_path / "bomb").exists()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("planner", "evil.py:Evil"),
        ("predictor", "evil.py:Evil"),
        ("cluster", "tcp://evil:8786"),
        ("source", "https://evil/"),
    ],
)
def test_what_a_run_folder_names_is_not_loaded(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str, value: str
) -> None:
    """A resumed run takes its plug-ins and places from the command, never from ``run.json``."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.py").write_text("from pathlib import Path\nPath('bomb').touch()\n")
    config = configured(tmp_path / "run", scenes)
    folder = run_here(config)
    manifest = json.loads(folder.manifest.read_text())
    manifest["config"][key] = value
    folder.manifest.write_text(json.dumps(manifest))
    if key in ("planner", "predictor"):
        with pytest.raises(RunError, match=f"another {key}"):
            run_here(config)
    else:
        run_here(config)
    assert main(["compare", str(folder.path)]) == 0
    assert not (tmp_path / "bomb").exists()


def test_ids_of_a_manifest_lead_nowhere(scenes: Path, tmp_path: Path) -> None:
    folder = run_here(configured(tmp_path / "run", scenes))
    for path in (folder.manifest, folder.rows):
        path.write_text(path.read_text().replace("ZAM_Fault-00_1_T-1", "../../outside"))
    before = _files(tmp_path)
    assert main(["compare", str(folder.path)]) == 0
    assert _files(tmp_path) == before


def test_deeply_nested_files_are_one_line(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = run_here(configured(tmp_path / "run", scenes))
    capsys.readouterr()
    for path in (folder.rows, folder.manifest):
        path.write_text("[" * 200_000 + "\n")
        assert main(["compare", str(folder.path)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert str(path) in line
    (scenes / "deep.xml").write_text("<a>" * 200_000)
    ref = next(ref for ref in find_scenarios(scenes) if ref.id == "deep")
    rows = untimed(run_here(configured(tmp_path / "other", scenes)))
    assert {r["outcome"] for r in rows if r["scenario"] == ref.id} == {Outcome.UNUSABLE}
