"""``dosplan new``: a plug-in to begin with."""

from __future__ import annotations

import argparse
import keyword
import re
import shlex
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import Final

from dosplan.cli.command import OK, Command, CommandError

_EXAMPLES: Final = """\
examples:
  dosplan new planner careful                    writes careful.py, with class CarefulPlanner
  dosplan new predictor straight --out mine      writes mine/straight.py
  dosplan new traffic hasty                      writes hasty.py, with class HastyTraffic
"""


class NewCommand:
    """Writes the template of a plug-in."""

    summary = "write a planner, predictor or traffic to begin with: one file that works"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _EXAMPLES
        parser.add_argument(
            "kind", choices=("planner", "predictor", "traffic"), help="what to write"
        )
        parser.add_argument("name", metavar="NAME", help="its name, such as careful or my_idea")
        parser.add_argument(
            "--out",
            type=Path,
            default=Path(),
            metavar="DIR",
            help="folder to write NAME.py to (default: the current one)",
        )

    def run(self, options: argparse.Namespace) -> int:
        """Writes the file, and shows what to do with it.

        Raises:
            CommandError: The name cannot be used, the file exists or cannot be written.
        """
        path = options.out / f"{options.name}.py"
        _check_name(options.name)
        class_name = _class_name(options.kind, options.name)
        template = files("dosplan.plugins").joinpath("templates", f"{options.kind}.py.txt")
        text = Template(template.read_text(encoding="utf-8")).substitute(
            file=path.name,
            class_name=class_name,
            plugin_name=f"{options.name.replace('_', '-')}-v1",
        )
        _write_new(path, text)
        spec = shlex.quote(f"{path}:{class_name}")
        print(f"wrote {path}; now:")
        print(f"  dosplan check {spec}")
        print(f"  dosplan run --{options.kind} {spec} --limit 1")
        return OK


def _check_name(name: str) -> None:
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        raise CommandError(
            f"the name {name!r} must be lower-case letters, digits and underscores, begin with a "
            "letter and be no word of Python's own, such as my_idea"
        )


def _class_name(kind: str, name: str) -> str:
    words = name.removesuffix(f"_{kind}").split("_")
    return "".join(word.capitalize() for word in [*words, kind])


def _write_new(path: Path, text: str) -> None:
    if path.exists():
        raise CommandError(f"{path} exists already; choose another name, or remove it first")
    if find_spec(path.stem) is not None:
        raise CommandError(
            f"Python has a module {path.stem} already, which {path} could hide; choose another name"
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise CommandError(f"cannot write {path}: {error.strerror or error}") from error


NEW: Final[Command] = NewCommand()
