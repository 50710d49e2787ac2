"""Commands that any page shows are commands that there are, with arguments that they take."""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from dosplan.cli.main import make_parser

ROOT = Path(__file__).parents[2]
LEFT_OUT = ("CHANGELOG.md",)  # What was.
PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for pattern in ("*.md", "docs/**/*.md", "results/**/*.md", "scenarios/**/*.md",
                    "predictors/*.md", "tests/*.md")
    for path in ROOT.glob(pattern)
    if path.name not in LEFT_OUT
)  # fmt: skip


_FENCED = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", re.DOTALL | re.MULTILINE)


def _blocks(page: str) -> Iterator[str]:
    """Commands of the blocks of a page, a line each, with the variables that it sets filled in."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for _, language, block in _FENCED.findall(text):
        if language not in ("", "sh"):
            continue
        block = re.sub(r"\\\n\s*", " ", block)
        known = dict(re.findall(r"^\s*(\w+)=[\"\']?(.*?)[\"\']?$", block, re.MULTILINE))
        for line in re.split(r"\n| && ", block):
            line = re.sub(r"\$\(.*?\)", "made", line)
            for name, value in known.items():
                line = line.replace(f"${name}", value)
            if re.match(r"\s*(\S*/)?dosplan ", line):
                yield line


def _spans(page: str) -> Iterator[str]:
    """Commands within the sentences of a page."""
    text = _FENCED.sub("", (ROOT / page).read_text(encoding="utf-8"))
    yield from re.findall(r"`(dosplan [^`]+)`", text)


def _commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


@pytest.mark.parametrize("page", [page for page in PAGES if any(_blocks(page))])
def test_commands_in_blocks_are_understood(page: str) -> None:
    parser = make_parser()
    for line in _blocks(page):
        _, *arguments = shlex.split(line, comments=True)
        try:
            parser.parse_args(arguments)
        except SystemExit:
            pytest.fail(line)


@pytest.mark.parametrize("page", [page for page in PAGES if any(_spans(page))])
def test_commands_in_sentences_exist_with_their_options(page: str) -> None:
    for span in _spans(page):
        words = span.replace("\\|", "|").split()[1:]
        if words[0] == "COMMAND":
            continue
        parser = make_parser()
        while words and words[0] in _commands(parser):
            parser = _commands(parser)[words.pop(0)]
        assert parser.prog != "dosplan" or words[0].startswith("-"), span
        for word in words:
            name = word.strip("[]").partition("=")[0]
            if name.startswith("--"):
                assert name in parser._option_string_actions, span
