"""Folders that cannot be written, or hold what they should not: one line, nothing overwritten."""

from __future__ import annotations

import os
import resource
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dosplan.cli.main import BAD_INPUT, main
from dosplan.results.folder import RunFolder
from dosplan.running import run as runner
from dosplan.running.run import RunError
from dosplan.scenario import find_scenarios
from dosplan.system.files import FileError
from tests.support.runs import (
    command,
    configured,
    rows_in,
    run_here,
    untimed,
    write_scenes,
)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("scenes"), 2)


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 64 KiB, where one may be mounted."""
    mount = tmp_path / "disk"
    mount.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(mount)],
        capture_output=True,
        check=False,
    )
    if done.returncode != 0:
        pytest.skip("no file system may be mounted here")
    yield mount
    subprocess.run(["umount", "--lazy", str(mount)], check=True)


def test_a_disk_that_fills_up_is_one_line_and_the_run_resumes_when_there_is_room(
    scenes: Path, tiny_disk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    filler = tiny_disk / "filler"
    filler.write_bytes(bytes(40 * 1024))
    out = tiny_disk / "run"
    assert main(command(out, scenes, "CoastPlanner", "--in-process")[3:]) == BAD_INPUT
    shown = capsys.readouterr()
    assert shown.out == ""
    line = shown.err.splitlines()[-1]
    assert line.startswith(f"dosplan: error: cannot write {out}/")
    assert line.endswith("No space left on device")
    assert not (out / "summary.json").exists()

    filler.unlink()
    config = configured(out, scenes)
    undisturbed = untimed(run_here(configured(tmp_path / "run", scenes)))
    assert untimed(run_here(config)) == undisturbed


@pytest.mark.parametrize("room", range(200, 2200, 300))
def test_a_row_that_does_not_fit_is_one_line_and_is_driven_again(
    scenes: Path, tmp_path: Path, room: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # No file may grow beyond ``room`` bytes: what is cut is the rows, at another byte each time.
    config = configured(tmp_path / "run", scenes)
    monkeypatch.setattr(runner, "_write_files", lambda *_: None)  # Larger than a row.
    folder = RunFolder(config.out)
    refs = find_scenarios(scenes)
    runner._open_folder(folder, runner._manifest(config, refs), refs)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        with pytest.raises(FileError, match=r"cannot write .*scenarios\.jsonl: File too large"):
            run_here(config)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    kept = rows_in(config.out)
    assert kept <= room // 400
    monkeypatch.undo()
    undisturbed = untimed(run_here(configured(tmp_path / "other", scenes)))
    assert untimed(run_here(config)) == undisturbed


def test_a_folder_that_may_not_be_written_is_one_line(
    tiny_disk: Path, scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    subprocess.run(["mount", "-o", "remount,ro", str(tiny_disk)], check=True)
    out = tiny_disk / "run"
    assert main(command(out, scenes, "CoastPlanner")[3:]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"dosplan: error: cannot write {out}/run.json: Read-only file system"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_one_line(
    tmp_path: Path, scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tmp_path.chmod(0o500)
    out = tmp_path / "run"
    assert main(command(out, scenes, "CoastPlanner")[3:]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"dosplan: error: cannot write {out}/run.json: Permission denied"


def test_a_folder_of_another_configuration_is_left_as_it_is(scenes: Path, tmp_path: Path) -> None:
    config = configured(tmp_path / "run", scenes, limit=1)
    run_here(config)
    before = {path: path.read_bytes() for path in config.out.rglob("*.*")}
    changes: list[dict[str, Any]] = [
        {"seed": 1},
        {"memory_limit": 100},
        {"episode_timeout": 1.0},
    ]
    for change in changes:
        with pytest.raises(RunError, match=f"another {next(iter(change))}; nothing was changed"):
            run_here(configured(config.out, scenes, **{"limit": 1, **change}))
    assert {path: path.read_bytes() for path in config.out.rglob("*.*")} == before
    # What does not reach a row may change.
    run_here(configured(config.out, scenes, limit=1, workers=3, cache=True, cluster="local:1"))


def test_a_run_json_half_written_by_one_that_was_killed_is_no_obstacle(
    scenes: Path, tmp_path: Path
) -> None:
    config = configured(tmp_path / "run", scenes, limit=1)
    config.out.mkdir()
    (config.out / ".run.json.4711.part").write_text('{"config"')
    assert [path.name for path in run_here(config).path.glob(".*.part")] == []


def test_usage_errors_and_failures_have_their_exit_codes(scenes: Path, tmp_path: Path) -> None:
    # 0: all scored; 1: some failed; 2: bad input; 130 is in test_signals.
    codes = {"CoastPlanner": 0, "NoSuchPlanner": 2}
    for planner, code in codes.items():
        arguments = command(tmp_path / planner, scenes, planner, "--in-process", "--limit", "1")
        assert main(arguments[3:]) == code
    faulty = write_scenes(tmp_path / "scenes", 2)  # The second one raises.
    out = tmp_path / "failed"
    assert main(command(out, faulty, "FaultPlanner", "--in-process", "--with-dos")[3:]) == 1
    assert rows_in(out) == 2
