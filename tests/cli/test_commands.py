"""Subcommands of other packages: offered, and left out where they cannot be used."""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from dosplan.cli import command as commands
from dosplan.cli.command import Command, offered_commands
from dosplan.cli.main import BAD_INPUT, main


class Greet:
    """Prints a word; a command as a stranger writes it."""

    summary = "greet, 100 % politely"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.epilog = "examples:\n  dosplan greet hello\n"
        parser.add_argument("word")

    def run(self, options: argparse.Namespace) -> int:
        print(options.word)
        return 7


class Silent(Greet):
    summary = ""


class Clumsy(Greet):
    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--twice")
        parser.add_argument("--twice")


GREET: Command = Greet()
SILENT: Command = Silent()
CLUMSY: Command = Clumsy()


def _offer(monkeypatch: pytest.MonkeyPatch, *offers: tuple[str, str]) -> None:
    found = EntryPoints(EntryPoint(name, value, commands.GROUP) for name, value in offers)
    monkeypatch.setattr(commands, "entry_points", lambda group: found.select(group=group))


def test_those_of_this_distribution_can_all_be_used() -> None:
    complaints: list[str] = []
    assert {"data", "train", "export"} <= offered_commands((), complaints.append).keys()
    assert not [line for line in complaints if "dosplan)" in line]


def test_a_strangers_command_is_run_and_helped(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _offer(monkeypatch, ("greet", f"{__name__}:GREET"))
    assert main(["greet", "hello"]) == 7
    assert capsys.readouterr().out == "hello\n"
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "greet greet, 100 % politely" in " ".join(capsys.readouterr().out.split())
    with pytest.raises(SystemExit):
        main(["greet", "--help"])
    assert "\nexamples:\n  dosplan greet hello\n\nexit codes:\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "target", "reason"),
    [
        ("bad", "no.such.module:COMMAND", "ModuleNotFoundError: No module named 'no'"),
        ("bad", f"{__name__}:NOBODY", "AttributeError: "),
        ("bad", f"{__name__}:Greet", "TypeError: "),  # The class in place of a command.
        ("bad", f"{__name__}:SILENT", "TypeError: its summary must be a line of text"),
        ("bad", f"{__name__}:CLUMSY", "ArgumentError: argument --twice: conflicting option"),
        ("bad", "os:sep", "AttributeError: 'str' object has no attribute 'summary'"),
        ("run", f"{__name__}:GREET", "a built-in command has that name"),
    ],
)
def test_one_that_cannot_be_used_costs_a_line_and_no_other_command(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    target: str,
    reason: str,
) -> None:
    _offer(monkeypatch, (name, target), ("greet", f"{__name__}:GREET"))
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    assert stop.value.code == 0
    shown = capsys.readouterr()
    (line,) = shown.err.splitlines()
    assert line.startswith(
        f"dosplan: warning: command '{name}' ({target} from unknown) is left out: {reason}"
    )
    assert "\n    bad" not in shown.out
    assert "\n    greet" in shown.out
    assert "\n    run drive and score" in re.sub(" +(?=drive)", " ", shown.out)


def test_a_name_offered_twice_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _offer(monkeypatch, ("greet", f"{__name__}:GREET"), ("greet", "another:GREET"))
    with pytest.raises(SystemExit) as stop:
        main(["greet", "hello"])
    assert stop.value.code == BAD_INPUT
    warning, error = capsys.readouterr().err.splitlines()
    assert warning == (
        f"dosplan: warning: command 'greet' ({__name__}:GREET from unknown, another:GREET from "
        "unknown) is left out: offered 2 times; uninstall all but one"
    )
    assert "invalid choice: 'greet'" in error


def test_an_installed_package_that_is_broken_breaks_nothing(tmp_path: Path) -> None:
    info = tmp_path / "stranger-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{commands.GROUP}]\nfly = stranger:FLY\n")
    (tmp_path / "stranger.py").write_text("raise SystemExit('no\\nlicence')\n")
    done = subprocess.run(
        [sys.executable, "-m", "dosplan", "list", "planners"],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "dosplan_mpc.planner:MpcPlanner" in done.stdout
    assert done.stderr == (
        "dosplan: warning: command 'fly' (stranger:FLY from stranger) is left out: "
        "SystemExit: no licence\n"
    )
