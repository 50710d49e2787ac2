"""The harness of the fuzz tests finds what it is there to find."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from pebble import ProcessPool

from dosplan.scenario import ScenarioError
from dosplan.system.workers import worker_pool
from dosplan.types import Scenario
from tests.fuzz import scenarios
from tests.fuzz.configs import damaged_methods
from tests.fuzz.harness import Attempt, Case, judge, one_line_at_most, shell
from tests.fuzz.scenarios import damaged_archives, damaged_gzip, damaged_texts, damaged_trees

BAD = 3  # The seed of the case that does it.


@pytest.fixture(scope="module")
def worker() -> Iterator[ProcessPool]:
    """A worker of its own, which loads little and is soon replaced."""
    with worker_pool(1) as pool:
        yield pool


def _fine(case: Case) -> None:
    (case.folder / "file").write_text("a file of its own may be opened")


def _raises(case: Case) -> None:
    case.about = "a case that raises"
    with one_line_at_most():
        raise KeyError("no error of the project")


def _leaves(case: Case) -> None:
    sys.exit(3)


def _says_too_much(case: Case) -> None:
    with one_line_at_most():
        raise ScenarioError(case.folder, "long " * 1000)


def _says_nothing(case: Case) -> None:
    with one_line_at_most():
        raise OSError


def _names_no_file(case: Case) -> None:
    with one_line_at_most("scene.xml"):
        raise ScenarioError(case.folder / "other.xml", "something is wrong")


def _ran_out_of_memory(case: Case) -> None:
    with one_line_at_most():
        try:
            bytearray(2**40)
        except MemoryError as error:
            raise ScenarioError(case.folder, repr(error)) from None


def _prints(case: Case) -> None:
    print("Traceback", file=sys.stderr)


def _complains_at_length(case: Case) -> None:
    shell("run", "--limit", "-1", "--out", str(case.folder), codes=[0, 1])


def _reads_elsewhere(case: Case) -> None:
    (case.folder.parent / "elsewhere").read_text()


def _connects(case: Case) -> None:
    with socket.socket() as client, suppress(OSError):
        client.connect(("127.0.0.1", 9))


def _starts_a_program(case: Case) -> None:
    subprocess.run([sys.executable, "-c", ""], check=True)


def _hangs(case: Case) -> None:
    if case.seed == BAD:
        time.sleep(3600)


def _crashes(case: Case) -> None:
    if case.seed == BAD:
        os.kill(os.getpid(), signal.SIGSEGV)


@pytest.mark.parametrize(
    ("attempt", "complaint"),
    [
        (_fine, None),
        (_raises, r"\(a case that raises\)(.|\n)*KeyError"),
        (_leaves, "SystemExit: 3"),
        (_says_too_much, "a message of 50.. characters"),
        (_says_nothing, "an error without a message"),
        (_names_no_file, r"names none of \('scene.xml',\)"),
        (_ran_out_of_memory, "MemoryError"),
        (_prints, "on the console: Traceback"),
        (_complains_at_length, "exit code 2"),
        (_reads_elsewhere, "opened what was not named: .*elsewhere"),
        (_connects, "opened what was not named: .*socket.connect"),
        (_starts_a_program, "opened what was not named: .*subprocess.Popen"),
    ],
)
def test_what_a_case_does_wrong_is_found(
    worker: ProcessPool, tmp_path: Path, attempt: Attempt, complaint: str | None
) -> None:
    (tmp_path / "elsewhere").touch()
    found = judge(worker, attempt, [BAD], tmp_path)
    assert len(found) == (complaint is not None)
    for text in found:
        assert text.startswith(f"{attempt.__name__}, seed {BAD}: ")
        assert re.search(complaint or "", text)
        assert text.endswith(f"to repeat it alone: python -m tests.fuzz {attempt.__name__} {BAD}")


@pytest.mark.parametrize(
    ("attempt", "complaint"), [(_hangs, "still at it after 4 s"), (_crashes, "killed by SIGSEGV")]
)
def test_a_case_that_takes_the_worker_with_it_is_found_and_the_others_run(
    worker: ProcessPool, tmp_path: Path, attempt: Attempt, complaint: str
) -> None:
    (found,) = judge(worker, attempt, range(BAD - 1, BAD + 2), tmp_path, seconds=4.0)
    assert f"seed {BAD}" in found
    assert re.search(complaint, found)


# And the cases are what they are meant to be.


@pytest.mark.parametrize(
    "attempt", [damaged_trees, damaged_texts, damaged_gzip, damaged_archives, damaged_methods]
)
def test_a_case_follows_from_its_seed(tmp_path: Path, attempt: Attempt) -> None:
    def files(seed: int) -> tuple[str, list[bytes]]:
        case = Case(seed, tmp_path / "case")
        case.folder.mkdir()
        attempt(case)
        content = [path.read_bytes() for path in sorted(case.folder.iterdir()) if path.is_file()]
        shutil.rmtree(case.folder)
        return case.about, content

    once = [files(seed) for seed in range(3)]
    assert [files(seed) for seed in range(3)] == once
    assert once[0] != once[1] != once[2]


def test_some_of_the_damaged_files_are_driven_and_some_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driven: list[Scenario] = []
    monkeypatch.setattr(scenarios, "drive", driven.append)
    for seed in range(12):
        case = Case(seed, tmp_path / str(seed))
        case.folder.mkdir()
        damaged_trees(case)
    assert 2 <= len(driven) <= 10
