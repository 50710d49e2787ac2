"""However often a runner is killed, and whenever: the same command gives the same rows."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dosplan.results.folder import RunFolder
from dosplan.results.manifest import read_manifest
from dosplan.results.rows import row_line
from dosplan.running import run as runner
from dosplan.running.progress import ProgressObserver
from dosplan.running.run import RunConfig, RunError, run
from dosplan.types import Score
from tests.support.runs import (
    command,
    configured,
    rows_in,
    run_here,
    start,
    until,
    untimed,
    write_scenes,
)
from tests.support.shares import every_other

EPISODES = 4  # Two scenarios in both arms.


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("scenes"), 2)


@pytest.fixture(scope="module")
def undisturbed(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    return untimed(run_here(configured(tmp_path_factory.mktemp("undisturbed") / "run", scenes)))


def _run_and_die(config: RunConfig, moment: int) -> None:
    """Runs, and kills itself at the given one of the moments that leave another folder behind.

    Those are: before a finished file takes its name, after it has, and in the middle of a row.
    """
    passed = 0

    def maybe_die() -> None:
        nonlocal passed
        if passed == moment:
            os.kill(os.getpid(), signal.SIGKILL)
        passed += 1

    real_replace = Path.replace

    def dying_replace(self: Path, target: Path) -> Path:
        maybe_die()
        replaced = real_replace(self, target)
        maybe_die()
        return replaced

    def dying_append(file: Any, row: Score) -> None:
        line = row_line(row).encode()
        file.write(line[:50])
        maybe_die()
        file.write(line[50:])

    Path.replace = dying_replace  # type: ignore[method-assign,assignment]
    vars(runner)["append_row"] = dying_append
    run(config)


# run.json, the rows at the start and at the end, summary.json and summary.md take their names,
# and so does an episode's file for each episode, which is followed by its row.
MOMENTS = 2 * (5 + EPISODES) + EPISODES


@pytest.mark.parametrize("moment", every_other(range(MOMENTS + 1)))
def test_a_run_that_was_killed_at_any_moment_is_resumed(
    scenes: Path, tmp_path: Path, undisturbed: list[dict[str, Any]], moment: int
) -> None:
    config = configured(tmp_path / "run", scenes)
    child = multiprocessing.get_context("fork").Process(target=_run_and_die, args=(config, moment))
    child.start()
    child.join(300.0)
    # The last number stands for a run that passes every moment: the count above is right.
    assert child.exitcode == (0 if moment == MOMENTS else -signal.SIGKILL)

    driven: list[int] = []
    folder = run_here(config, ProgressObserver(lambda done, total: driven.append(done)))
    assert untimed(folder) == undisturbed
    assert not [path for path in folder.path.rglob(".*") if path.name != ".."]
    names = {path.name for path in folder.path.iterdir()}
    assert names == {"run.json", "scenarios.jsonl", "episodes", "summary.json", "summary.md"}


def test_kill_9_of_the_runner_again_and_again_loses_nothing(
    scenes: Path, tmp_path: Path, undisturbed: list[dict[str, Any]]
) -> None:
    out = tmp_path / "run"
    arguments = command(out, scenes, "SlowPlanner", "--workers", "2")
    moments: list[Callable[[], object]] = [
        (out / "run.json").exists,
        lambda: rows_in(out) >= 1,
        lambda: rows_in(out) >= 3,
    ]
    for moment in moments:
        process = start(arguments)
        until(moment, "a row")
        process.kill()
        process.communicate(timeout=120.0)  # Ends with the last worker: none is left behind.
    process = start(arguments)
    _, complaint = process.communicate(timeout=300.0)
    assert process.returncode == 0, complaint
    assert untimed(out) == undisturbed


# The run.json of an extension takes its name, and so do the rows at the start and the end, the two
# summaries and an episode's file for each of the two new episodes, which is followed by its row.
GROWN_MOMENTS = 2 * (5 + EPISODES // 2) + EPISODES // 2


@pytest.mark.parametrize("moment", every_other(range(GROWN_MOMENTS + 1)))
def test_a_run_that_was_killed_while_it_grew_is_resumed(
    scenes: Path, tmp_path: Path, undisturbed: list[dict[str, Any]], moment: int
) -> None:
    config = configured(tmp_path / "run", scenes)
    run_here(replace(config, limit=1))
    child = multiprocessing.get_context("fork").Process(target=_run_and_die, args=(config, moment))
    child.start()
    child.join(300.0)
    assert child.exitcode == (0 if moment == GROWN_MOMENTS else -signal.SIGKILL)

    driven: list[int] = []
    folder = run_here(config, ProgressObserver(lambda done, total: driven.append(done)))
    assert untimed(folder) == undisturbed
    assert driven[0] >= 2  # The rows of the first scenario were kept.
    assert len(read_manifest(folder).scenarios) == 2
    assert not [path for path in folder.path.rglob(".*") if path.name != ".."]


@pytest.fixture
def driving(scenes: Path, tmp_path: Path) -> Iterator[Path]:
    """A folder in which another process is driving."""
    out = tmp_path / "run"
    process = start(command(out, scenes, "FaultPlanner", "--workers", "1", "--timeout", "60"))
    until(lambda: (out / "scenarios.jsonl").exists(), "the run to begin")
    yield out
    process.kill()
    process.communicate(timeout=120.0)


def test_a_second_runner_is_kept_out(driving: Path, scenes: Path) -> None:
    before = (driving / "run.json").read_bytes()
    with pytest.raises(RunError, match=r"another process is driving the run in .*run; wait"):
        run(configured(driving, scenes, "FaultPlanner", episode_timeout=60.0))
    assert (driving / "run.json").read_bytes() == before


def test_rows_of_episodes_that_do_not_belong_are_dropped(
    scenes: Path, tmp_path: Path, undisturbed: list[dict[str, Any]]
) -> None:
    config = configured(tmp_path / "run", scenes)
    folder = run_here(config)
    lines = folder.rows.read_text().splitlines(keepends=True)
    alien = lines[0].replace("ZAM_Fault-00", "ZAM_Alien-00")
    folder.rows.write_text("".join([alien, lines[2], lines[2], lines[1], lines[3], lines[0]]))
    assert untimed(run_here(config)) == undisturbed


def test_a_line_that_is_no_row_is_named_and_nothing_overwritten(
    scenes: Path, tmp_path: Path
) -> None:
    config = configured(tmp_path / "run", scenes)
    folder = run_here(config)
    damaged = folder.rows.read_bytes().replace(b'"arm"', b"\x00\xff", 1)
    folder.rows.write_bytes(damaged)
    with pytest.raises(Exception, match=r"scenarios\.jsonl, line 1, is not a row") as caught:
        run_here(config)
    assert type(caught.value).__name__ == "FileError"
    assert RunFolder(config.out).rows.read_bytes() == damaged
