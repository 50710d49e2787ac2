"""Notes the files that Python opens, the addresses it connects to and the programs it starts."""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Final

from dosplan.system.folders import cache_folder

_PROJECT: Final = Path(__file__).resolve().parents[2]
_SYSTEM: Final = ("/proc/", "/dev/", "/sys/", "/etc/")


@contextmanager
def nothing_else_opened(folder: Path) -> Iterator[None]:
    """Raises where something was opened that is neither in a folder nor of Python's own places."""
    noted = _noted()
    noted.clear()
    yield
    allowed = (f"{folder.resolve()}{os.sep}", *_usual())
    strange = [
        text
        for event, text in sorted(noted)
        if event != "open" or not str(Path(text).resolve()).startswith(allowed)
    ]
    assert not strange, f"opened what was not named: {strange}"


@cache
def _noted() -> set[tuple[str, str]]:
    """What happened; an audit hook, which can never be taken off again, adds to it."""
    noted: set[tuple[str, str]] = set()

    def note(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(arguments[0], str | bytes):
            noted.add((event, os.fsdecode(arguments[0])))
        elif event in ("socket.connect", "subprocess.Popen", "os.system", "os.exec"):
            noted.add((event, f"{event} {arguments[1:]}"))

    sys.addaudithook(note)
    return noted


@cache
def _usual() -> tuple[str, ...]:
    """Places that the interpreter, the libraries and the project's own files are in."""
    python = [*sysconfig.get_paths().values(), *sys.path, sys.prefix, sys.base_prefix]
    bytecode = sys.pycache_prefix or ""
    places = [*map(Path, filter(None, (*python, bytecode))), _PROJECT, cache_folder()]
    return (*(str(place.resolve()) for place in places), *_SYSTEM)
