"""Runs fuzz cases in a worker process that a hang, a crash or a memory bomb cannot leave.

A case is a function of a ``Case``: its random numbers, which follow from its seed alone, and an
empty folder of its own. It damages something, hands it to the package and returns, or raises
whatever it finds wrong. What the package may raise is what the command line turns into one line.
"""

from __future__ import annotations

import io
import random
import resource
import shutil
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pebble import ProcessExpired, ProcessPool

from dosplan.cli.command import BAD_INPUT
from dosplan.cli.main import main
from dosplan.system.errors import DosplanError
from dosplan.system.workers import cause_of_death
from tests.fuzz.watch import nothing_else_opened

CASE_SECONDS: Final = 60.0
"""Time after which a case counts as hung; most take a tenth of a second, on an idle machine."""
MAX_MEMORY: Final = 8 * 1024**3
"""Address space of the worker, bytes; torch alone reserves more than half of it."""
LONGEST_MESSAGE: Final = 2000


@dataclass
class Case:
    """One case.

    Attributes:
        seed: All of its random numbers follow from it.
        folder: An empty folder of its own, which is the working folder, too.
        about: What it does, for the message.
    """

    seed: int
    folder: Path
    about: str = ""

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)

    def write(self, name: str, data: bytes) -> Path:
        """Writes a file of its folder."""
        path = self.folder / name
        path.write_bytes(data)
        return path


Attempt = Callable[[Case], None]


def judge(
    worker: ProcessPool,
    attempt: Attempt,
    seeds: Iterable[int],
    folder: Path,
    seconds: float = CASE_SECONDS,
) -> list[str]:
    """Runs cases, each of which may end the worker.

    Args:
        worker: The worker.
        attempt: The cases' function.
        seeds: Their seeds.
        folder: An empty folder.
        seconds: Time that a case may take.

    Returns:
        What went wrong, a text for each case that found something.
    """
    futures = {
        seed: worker.schedule(run_case, [attempt, seed, folder / str(seed)], timeout=seconds)
        for seed in seeds
    }
    found = []
    for seed, future in futures.items():
        try:
            wrong = future.result()
        except TimeoutError:
            wrong = f"still at it after {seconds:g} s"
        except ProcessExpired as error:
            wrong = cause_of_death(error.exitcode)
        if wrong is not None:
            name = attempt.__name__
            again = f"to repeat it alone: python -m tests.fuzz {name} {seed}"
            found.append(f"{name}, seed {seed}: {wrong}\n{again}")
    return found


def run_case(attempt: Attempt, seed: int, folder: Path) -> str | None:
    """Runs a case in this process.

    Args:
        attempt: Its function.
        seed: Its seed.
        folder: A folder that is not there yet; it is removed afterwards.

    Returns:
        What went wrong, or None.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, hard))
    folder.mkdir()
    case = Case(seed, folder)
    shown = io.StringIO()
    try:
        with (
            chdir(folder),
            redirect_stdout(shown),
            redirect_stderr(shown),
            nothing_else_opened(folder),
        ):
            attempt(case)
        assert not shown.getvalue(), f"on the console: {shown.getvalue()[:1000]}"
    except (Exception, SystemExit):
        text = f"({case.about}) {traceback.format_exc(limit=-8)[-3000:]}"
        return text.encode(errors="replace").decode()  # So that it can be printed.
    finally:
        shutil.rmtree(folder)
    return None


@contextmanager
def one_line_at_most(*names: str) -> Iterator[None]:
    """Lets an error of the project's own kind pass, if it says something in a line.

    Args:
        names: Words of which the line has to hold one: what the error is about.
    """
    try:
        yield
    except (DosplanError, OSError) as error:
        check_message(str(error), *names)


def check_message(line: str, *names: str) -> None:
    """Raises where an error's message is no help."""
    assert line.strip(), "an error without a message"
    assert len(line) <= LONGEST_MESSAGE, f"a message of {len(line)} characters: {line[:200]} ..."
    assert "Traceback" not in line, line
    assert "MemoryError" not in line, line
    assert not names or any(name in line for name in names), f"names none of {names}: {line}"


def shell(*arguments: str, codes: Iterable[int]) -> None:
    """Calls a command; what it says on bad input must be one line for its user.

    Args:
        arguments: The arguments.
        codes: The exit codes that may come back.
    """
    out, complaints = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(complaints):
        try:
            code = main(arguments)
        except SystemExit as left:  # argparse's own way out.
            code = left.code if isinstance(left.code, int) else 1
    said = complaints.getvalue()
    assert code in codes, f"exit code {code}: {said[:500]}"
    assert "Traceback" not in out.getvalue() + said
    if code == BAD_INPUT:
        assert len(said.splitlines()) == 1, f"more than a line: {said[:1000]}"
        check_message(said)
