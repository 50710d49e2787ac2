"""One process at a time holds a lock, and no way of ending leaves it held."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dosplan.system import locks
from dosplan.system.locks import exclusive

HOLD = (
    "import sys, time; from pathlib import Path; from dosplan.system.locks import exclusive\n"
    "with exclusive(Path(sys.argv[1])) as alone:\n"
    "    print(alone, flush=True); time.sleep(60)"
)


def _holder(path: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "True\n"
    return process


def test_another_process_is_kept_out_until_the_first_is_killed(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    holder = _holder(path)
    with exclusive(path) as alone:
        assert not alone
    assert path.exists()  # Whoever was kept out removes nothing.
    holder.kill()
    holder.communicate()
    assert path.exists()
    with exclusive(path) as alone:
        assert alone
        with exclusive(path) as again:
            assert not again
    assert not path.exists()


def test_a_lock_that_was_removed_before_it_is_had_is_no_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / ".lock"
    opened: list[int] = []

    def lock_after_its_holder_has_left(file: int, *, blocking: bool) -> bool:
        opened.append(file)
        if len(opened) == 1:
            path.unlink()
            with path.open("x"):  # Of somebody who came in between.
                pass
        return True

    monkeypatch.setattr(locks, "lock_descriptor", lock_after_its_holder_has_left)
    with exclusive(path) as alone:
        assert alone
        assert len(opened) == 2
        assert os.path.samestat(os.fstat(opened[-1]), path.stat())


def test_where_there_are_no_locks_everybody_is_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(file: int, *, blocking: bool) -> bool:
        raise OSError(errno.ENOLCK, "no locks available")

    monkeypatch.setattr(locks, "lock_descriptor", refuse)
    for _ in range(2):
        with exclusive(tmp_path / ".lock") as alone:
            assert alone


def test_a_link_in_its_place_is_not_followed(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    (tmp_path / ".lock").symlink_to(outside)
    with exclusive(tmp_path / ".lock") as alone:
        assert alone
    assert not outside.exists()


def test_what_the_block_raises_gives_the_lock_back(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    with pytest.raises(KeyError), exclusive(path):
        raise KeyError
    assert not path.exists()
