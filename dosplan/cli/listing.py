"""``dosplan list``: plug-ins and scenarios."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from dosplan.cli.arguments import SOURCE_HELP, add_json, show
from dosplan.cli.command import OK

if TYPE_CHECKING:
    from rich.console import RenderableType


class ListCommand:
    """Lists what is there to run."""

    summary = "list plug-ins or scenarios"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        add_json(parser)
        parser.add_argument(
            "what",
            nargs="?",
            choices=("planners", "predictors", "traffic", "scenarios"),
            help="what to list (default: planners, predictors and traffic)",
        )
        parser.add_argument(
            "source",
            nargs="?",
            default="suite",
            metavar="SOURCE",
            help=f"for scenarios: {SOURCE_HELP} (default: %(default)s)",
        )

    def run(self, options: argparse.Namespace) -> int:
        """Lists.

        Raises:
            ScenarioError: There are no scenarios.
            FileError: A file cannot be written.
        """
        if options.what == "scenarios":
            _list_scenarios(options)
        else:
            _list_plugins(options)
        return OK


def _list_plugins(options: argparse.Namespace) -> None:
    from dataclasses import asdict

    from dosplan.plugins.registry import PluginKind, list_plugins
    from dosplan.report.tables import table

    kinds = [kind for kind in PluginKind if options.what in (None, kind.plural)]
    plugins = {kind.plural: list_plugins(kind) for kind in kinds}
    tables = [
        table(
            [title, "target", "from"],
            [[p.name, p.target, p.distribution] for p in found],
            numbers=False,
        )
        for title, found in plugins.items()
    ]
    figures = {title: [asdict(plugin) for plugin in found] for title, found in plugins.items()}
    show(tables, figures, options.json)


def _list_scenarios(options: argparse.Namespace) -> None:
    from dosplan.report.tables import table
    from dosplan.scenario import find_scenarios

    refs = find_scenarios(options.source)
    tables: list[RenderableType] = [
        table(["scenario", "file"], [[ref.id, ref.path.name] for ref in refs], numbers=False),
        f"{len(refs)} scenarios",
    ]
    figures = {"scenarios": [{"id": ref.id, "file": ref.path.name} for ref in refs]}
    show(tables, figures, options.json)
