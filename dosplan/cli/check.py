"""``dosplan check``: the conformance suite on a plug-in."""

from __future__ import annotations

import argparse
import threading
from typing import TYPE_CHECKING

from dosplan.cli.arguments import PLUGIN_HELP, add_json, show
from dosplan.cli.command import FAILED, OK, CommandError

if TYPE_CHECKING:
    from dosplan.plugins.conformance import Report


class CheckCommand:
    """Checks that a plug-in keeps the contract."""

    summary = "check that a planner or predictor keeps the contract"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        add_json(parser)
        parser.add_argument("name", metavar="NAME", help=PLUGIN_HELP)
        parser.add_argument(
            "--timeout",
            type=float,
            default=300.0,
            metavar="S",
            help="seconds after which a check counts as hung (default: %(default)g)",
        )

    def run(self, options: argparse.Namespace) -> int:
        """Checks, and shows every check.

        Returns:
            0; 1 where a check failed.

        Raises:
            CommandError: The time-out is not positive.
            RegistryError: There is no such plug-in.
            FileError: A file cannot be written.
        """
        from dosplan.report.tables import table

        if not 0.0 < options.timeout < threading.TIMEOUT_MAX:
            raise CommandError(f"--timeout is {options.timeout:g}; it must be a time above 0 s")
        report = _report(options.name, options.timeout)
        rows = [
            [check.name, "ok" if check.ok else "FAILED", check.message] for check in report.checks
        ]
        figures = {
            "plugin": report.plugin,
            "ok": report.ok,
            "checks": [{"name": c.name, "ok": c.ok, "message": c.message} for c in report.checks],
        }
        verdict = "keeps the contract" if report.ok else "breaks the contract"
        checks = table(["check", "result", ""], rows, numbers=False)
        show([checks, f"{report.plugin} {verdict}"], figures, options.json)
        return OK if report.ok else FAILED


def _report(spec: str, limit: float) -> Report:
    """The checks of a planner or predictor, whichever has the name."""
    from dosplan.plugins.isolated import check_isolated
    from dosplan.plugins.registry import PluginKind, RegistryError, list_plugins

    kinds = (PluginKind.PLANNER, PluginKind.PREDICTOR)
    named = [k for k in kinds if spec in {plugin.name for plugin in list_plugins(k)}]
    complaints = []
    for kind in named or kinds:
        try:
            return check_isolated(kind, spec, limit)
        except RegistryError as error:
            if error.__cause__ is not None:  # What cannot be imported is no other kind, either.
                raise
            complaints.append(str(error))
    raise RegistryError("; ".join(complaints))
