"""The base class of errors that a user can correct, and exceptions written in one line."""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Final

LONGEST_LINE: Final = 1000
"""Characters of an exception's message that are shown."""


class DosplanError(Exception):
    """An error that the caller can correct; the message is one line that says what and how.

    The command line prints it and exits with code 2.
    """


def one_line(error: BaseException) -> str:
    """Writes an exception on one line.

    Args:
        error: Any exception.

    Returns:
        ``Type: message``, line breaks turned into blanks; of a long one, the beginning.
    """
    try:
        text = f"{type(error).__name__}: {error}"
    except Exception:  # Its own __str__ raises.
        text = f"{type(error).__name__} without a message"
    line = " ".join(text.split())
    return line if len(line) <= LONGEST_LINE else f"{line[:LONGEST_LINE]} ..."


def failure_place(error: BaseException, plugin: object) -> str:
    """Names the place of a failure that helps a plug-in's author most.

    Args:
        error: What was raised.
        plugin: The plug-in's class, or the function that makes the plug-in.

    Returns:
        ``file:line`` of the innermost call in the plug-in's own file, or else of the innermost.
    """
    frames = traceback.extract_tb(error.__traceback__)
    try:
        own = inspect.getsourcefile(plugin)  # type: ignore[arg-type]
    except TypeError:  # Not made of Python source.
        own = None
    place = next((frame for frame in reversed(frames) if frame.filename == own), frames[-1])
    return f"{Path(place.filename).name}:{place.lineno}"


def did_you_mean(name: str, known: Iterable[str], count: int = 1) -> str:
    """Suggests existing names for one that does not exist.

    Args:
        name: The name that was given.
        known: The names that exist.
        count: How many to name at most.

    Returns:
        The end of a message, ``; did you mean 'mpc'?``; empty where nothing is alike.
    """
    close = get_close_matches(name, list(known), n=count)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""
