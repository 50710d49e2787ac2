"""Folders that cannot be written, or hold what they should not: one line, nothing overwritten."""

from __future__ import annotations

import errno
import json
import os
import resource
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dosplan.cli.main import BAD_INPUT, OK, main
from dosplan.report.html.write import write_report
from dosplan.results.folder import RunFolder
from dosplan.results.rescore import rescore
from dosplan.running import run as runner
from dosplan.running.run import RunError
from dosplan.scenario import ScenarioError, find_scenarios
from dosplan.system.files import FileError
from dosplan.system.locks import exclusive
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


def test_what_is_no_file_is_written_straight(scenes: Path, tmp_path: Path) -> None:
    """A pipe and the standard output stay what they are."""
    out = tmp_path / "run"
    assert main(command(out, scenes, "CoastPlanner", "--in-process")[3:]) == OK
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with subprocess.Popen(["cat", str(pipe)], stdout=subprocess.PIPE, text=True) as reader:
        assert main(["table", str(out), "--json", str(pipe)]) == OK
        assert reader.stdout is not None
        assert json.load(reader.stdout)
    assert pipe.is_fifo()
    table = [sys.executable, "-m", "dosplan", "table", str(out), "--json", "/dev/stdout"]
    shown = tmp_path / "shown.txt"
    with shown.open("wb") as file:
        subprocess.run(table, stdout=file, check=True)
    assert os.path.islink("/dev/stdout")  # noqa: PTH114 - Path.is_symlink is the same
    assert json.loads(shown.read_text())


def test_closed_streams_and_closed_pipes_are_no_failure(scenes: Path, tmp_path: Path) -> None:
    for closed in (">&-", "2>&-", "<&- >&- 2>&-"):
        out = tmp_path / str(len(closed))
        run = command(out, scenes, "CoastPlanner", "--workers", "1")
        done = subprocess.run(["sh", "-c", f"{shlex.join(run)} {closed}"], check=False)
        assert done.returncode == OK
        assert {row["outcome"] for row in untimed(out)} & {"success", "goal_missed"}
        assert not {row["outcome"] for row in untimed(out)} & {"unusable", "planner_failure"}
    for show in (["table", str(out)], ["compare", str(out)], ["table", str(out), "--json"]):
        shown = [sys.executable, "-m", "dosplan", *show]
        with subprocess.Popen(shown, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stderr is not None
            process.stdout.close()
            told = process.stderr.read()
        assert (process.returncode, told) == (OK, b"")


def test_a_terminal_of_few_characters_gets_the_others_escaped(scenes: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert main(command(out, scenes, "CoastPlanner", "--in-process")[3:]) == OK
    shown = subprocess.run(
        [sys.executable, "-m", "dosplan", "compare", str(out)],
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert r"Acceleration m/s\xb2" in shown.stdout


def test_what_a_plug_in_prints_is_no_part_of_the_json(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (
        "from tests.support.plugins import CoastPlanner",
        "print('imported')",
        "class Chatty(CoastPlanner):",
        "    name = 'chatty-v1'",
        "    def __init__(self, **given):",
        "        super().__init__(**given)",
        "        print('built')",
        "    def compute_plan(self, observation, occupancy):",
        "        print('plans')",
        "        return super().compute_plan(observation, occupancy)",
    )
    (tmp_path / "chatty.py").write_text("\n".join(lines))
    planner = f"{tmp_path / 'chatty.py'}:Chatty"
    run = command(tmp_path / "run", scenes, "CoastPlanner", "--in-process", "--json=/dev/stdout")
    given = [planner if "CoastPlanner" in word else word for word in run[3:]]
    assert main(given) == OK
    told = capsys.readouterr()
    assert json.loads(told.out) == json.loads((tmp_path / "run" / "summary.json").read_text())
    assert {"imported", "built", "plans"} <= set(told.err.split())


def test_a_plug_in_that_leaves_the_working_folder_takes_no_result_along(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    lines = (
        "import os",
        f"os.chdir({str(elsewhere)!r})",
        "from tests.support.plugins import CoastPlanner",
        "class Wanderer(CoastPlanner):",
        "    name = 'wanderer-v1'",
        "    def compute_plan(self, observation, occupancy):",
        f"        os.chdir({str(elsewhere)!r})",
        "        return super().compute_plan(observation, occupancy)",
    )
    (tmp_path / "wanderer.py").write_text("\n".join(lines))
    for number, where in enumerate((["--in-process"], ["--workers", "1"])):
        asked = command(Path(f"run{number}"), Path(os.path.relpath(scenes)), "Wanderer", *where)[3:]
        asked[asked.index("--planner") + 1] = "wanderer.py:Wanderer"
        assert main(asked) == OK
        assert len(untimed(tmp_path / f"run{number}")) == 2 * len(list(scenes.glob("*.xml")))
    assert not list(elsewhere.iterdir())
    assert Path.cwd() == tmp_path


def test_a_folder_that_cannot_be_opened_is_told(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "places"
    shutil.copytree(scenes, place)
    shut = place / "shut"
    shut.mkdir()
    scan = os.scandir

    def scandir(path: Any) -> Any:  # Tests may run as root, who may open everything.
        if Path(path) == shut:
            raise PermissionError(errno.EACCES, "Permission denied", str(shut))
        return scan(path)

    monkeypatch.setattr(os, "scandir", scandir)
    with pytest.raises(ScenarioError, match=r"shut: cannot be opened \(Permission denied\)"):
        find_scenarios(place)


def test_an_episode_file_that_was_cut_off_is_driven_again(scenes: Path, tmp_path: Path) -> None:
    config = configured(tmp_path / "run", scenes)
    folder = run_here(config)
    before = untimed(folder)
    (damaged, *_) = sorted((folder.path / "episodes").glob("*.npz"))
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileError, match=damaged.name):
        write_report(folder.path)
    assert untimed(run_here(config)) == before
    write_report(folder.path)


def test_rows_are_not_written_over_those_of_a_run_that_goes_on(
    scenes: Path, tmp_path: Path
) -> None:
    folder = run_here(configured(tmp_path / "run", scenes, limit=1))
    scored = rescore(folder.path)
    with exclusive(folder.lock), pytest.raises(FileError, match="another process is driving"):
        scored.write()
    run_here(configured(tmp_path / "run", scenes))
    with pytest.raises(FileError, match="has changed since it was scored"):
        scored.write()
    rescore(folder.path).write()
