"""Locks between processes, which the system releases however their holder ends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from filelock import lock_descriptor

# Symbolic links are not followed; a system without such links has no such flag.
_OPEN: Final = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)


@contextmanager
def exclusive(path: Path) -> Iterator[bool]:
    """Keeps other processes out for the length of the block.

    Args:
        path: The file that stands for the lock; made here, and removed at the end. One that a
            killed process left behind is no obstacle.

    Yields:
        Whether no other process holds the lock. True as well where the file system has no locks
        or the file cannot be made.
    """
    try:
        file = _locked(path)
    except OSError:
        yield True
        return
    if file is None:
        yield False
        return
    try:
        yield True
    finally:
        # Before it is closed, so that no other process can have locked the removed file.
        with suppress(OSError):  # Windows removes no file that is open.
            path.unlink()
        os.close(file)
        if os.name == "nt":
            with suppress(OSError):  # It does not do so either where another process has opened it.
                path.unlink()


def _locked(path: Path) -> int | None:
    """Opens and locks a file.

    Returns:
        Its descriptor, or None where another process holds the lock.

    Raises:
        OSError: It cannot be opened or locked.
    """
    while True:
        file = os.open(path, _OPEN, 0o666)
        try:
            if not lock_descriptor(file, blocking=False):
                os.close(file)
                return None
            if path.exists() and os.path.samestat(os.fstat(file), path.stat()):
                return file
        except OSError:
            os.close(file)
            raise
        os.close(file)  # Whoever held the lock has removed this file since it was opened here.
