"""The commands, as the parser of the command line has them: for the page on the site."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator

from dosplan.cli.main import EXIT_CODES, make_parser


def commands_text() -> str:
    """Writes every command with its arguments.

    Returns:
        Markdown, a section for each command and one for the exit codes.
    """
    sections = [_section(parser) for parser in _commands(make_parser())]
    return "\n\n".join([*sections, f"## Exit codes\n\n{_block(EXIT_CODES.split(':', 1)[1])}"])


def _commands(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """The parsers of the commands in and below a parser, each before its own subcommands."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield command
                yield from _commands(command)


def _section(parser: argparse.ArgumentParser) -> str:
    usage = parser.format_usage().removeprefix("usage: ")
    parts = [f"## {parser.prog}", _sentence(parser.description or ""), _block(usage)]
    for group in parser._action_groups:
        rows = [
            f"| {_invocation(action)} | {_help(parser, action)} |"
            for action in group._group_actions
            if not isinstance(action, argparse._HelpAction) and action.help != argparse.SUPPRESS
        ]
        if rows:
            title = (group.title or "").capitalize()
            parts.append("\n".join([f"| {title} | |", "| --- | --- |", *rows]))
    examples = (parser.epilog or "").replace(EXIT_CODES, "").strip()
    if examples:
        parts.append(_block(examples))
    return "\n\n".join(part for part in parts if part)


def _invocation(action: argparse.Action) -> str:
    """How an argument is written: its names with what follows them."""
    if isinstance(action, argparse._SubParsersAction):
        return ", ".join(f"`{name}`" for name in action.choices)
    value = _value(action)
    if not action.option_strings:
        return f"`{value}`"
    return ", ".join(f"`{f'{name} {value}'.strip()}`" for name in action.option_strings)


def _value(action: argparse.Action) -> str:
    if action.nargs == 0:
        return ""
    metavar = action.metavar
    if metavar is None and action.choices is not None:
        metavar = "{" + ",".join(map(str, action.choices)) + "}"
    if isinstance(metavar, tuple):
        metavar = " ".join(metavar)
    name = metavar or (action.dest.upper() if action.option_strings else action.dest)
    shape = {"*": "[{} ...]", "+": "{} [{} ...]", "?": "[{}]"}.get(str(action.nargs), "{}")
    return shape.format(name, name) if shape.count("{}") == 2 else shape.format(name)


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    if not action.help:
        return ""
    text = parser._get_formatter()._expand_help(action)
    text = re.sub(r", here \d+", "", text)  # Of the machine that builds the site.
    return _escaped(" ".join(text.split()))


def _sentence(text: str) -> str:
    return "\n".join(_escaped(line) for line in text.strip().splitlines())


def _escaped(text: str) -> str:
    for character in "\\|<>*_[]`":
        text = text.replace(character, f"\\{character}" if character not in "<>" else character)
    return text.replace("<", "&lt;").replace(">", "&gt;")


def _block(text: str) -> str:
    lines = text.strip("\n").splitlines()
    return "\n".join(["```text", *lines, "```"])
