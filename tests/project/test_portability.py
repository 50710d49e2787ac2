"""Nothing needs what Windows lacks; this cannot show that all is well on Windows itself."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from dosplan.results.rows import read_rows
from dosplan.types import Arm, Outcome
from tests.support.runs import alive, command, start, until, write_faults, write_scenes

# Python imports a module of this name before anything else, in worker processes as well. The
# modules are kept from dosplan and its plug-ins only: libraries have other ones on Windows.
LACKING = """
import builtins, os
plain = builtins.__import__

def without(name, globals=None, *rest, **named):
    lacking = name in ("fcntl", "grp", "pty", "pwd", "resource", "termios")
    if lacking and str((globals or {}).get("__name__")).startswith("dosplan"):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return plain(name, globals, *rest, **named)

builtins.__import__ = without
for name in ("getpgid", "getpgrp", "killpg", "setpgid", "setpgrp", "setsid"):
    delattr(os, name)
"""
IMPORT_ALL = """
import importlib, pkgutil, sys
for package in sys.argv[1:]:
    found = pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}.")
    for module in found:
        if module.name.endswith("__main__"):
            continue
        try:
            importlib.import_module(module.name)
        except Exception as error:  # Of an optional dependency that is not installed.
            cause = error.__cause__ or error
            if not isinstance(cause, ImportError) or cause.name in ("fcntl", "resource"):
                raise
print("all")
"""
PLUGINS = ("mpc", "baseline", "net", "dos", "simple", "wale", "peers", "reactive")


@pytest.fixture
def lacking(tmp_path: Path) -> dict[str, str]:
    """An environment whose Python lacks what Windows lacks."""
    folder = tmp_path / "lacking"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(LACKING)
    path = os.pathsep.join([str(folder), *sys.path])
    return os.environ | {"PYTHONPATH": path, "DOSPLAN_CACHE": str(tmp_path / "cache")}


def test_every_module_is_imported(lacking: dict[str, str]) -> None:
    packages = ["dosplan", *(f"dosplan_{name}" for name in PLUGINS)]
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL, *packages],
        env=lacking, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout == "all\n", done.stderr


@pytest.mark.parametrize("options", [("--in-process",), ("--workers", "1")])
def test_an_episode_is_driven(
    lacking: dict[str, str], tmp_path: Path, options: tuple[str, ...]
) -> None:
    scenes = write_scenes(tmp_path / "scenes", 1)
    arguments = command(tmp_path / "run", scenes, "CoastPlanner", *options)
    done = subprocess.run(arguments, env=lacking, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = read_rows(tmp_path / "run" / "scenarios.jsonl")
    assert [row.outcome for row in rows] == [Outcome.SUCCESS] * len(Arm)


def test_an_interrupted_run_leaves_no_process(lacking: dict[str, str], tmp_path: Path) -> None:
    scenes = write_faults(tmp_path / "scenes", ["hang-with-child"])
    child = tmp_path / "child"
    arguments = command(tmp_path / "run", scenes, "FaultPlanner", "--with-dos", "--workers", "1")
    process = start(arguments, env=lacking | {"CHILD_PID_FILE": str(child)})
    until(child.exists, "the planner to start a process")
    process.send_signal(signal.SIGINT)
    # The pipes end when the last process that holds them does.
    _, complaint = process.communicate(timeout=60.0)
    assert process.returncode == 130
    assert complaint.splitlines()[-1].startswith("dosplan: interrupted; the same command with")
    until(lambda: not alive(int(child.read_text())), "what the planner has started to end")
