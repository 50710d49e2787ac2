"""``dosplan check``: the conformance suite on a plug-in."""

from __future__ import annotations

import argparse
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from dosplan.cli.arguments import PLUGIN_HELP, add_json, show
from dosplan.cli.command import FAILED, OK, CommandError
from dosplan.system.errors import did_you_mean

if TYPE_CHECKING:
    from dosplan.plugins.conformance import Report


class CheckCommand:
    """Checks that a plug-in keeps the contract."""

    summary = "check that a planner, predictor or traffic keeps the contract"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        add_json(parser)
        parser.add_argument("name", metavar="NAME", help=PLUGIN_HELP)
        parser.add_argument(
            "--kind",
            choices=("planner", "predictor", "traffic"),
            help="what it is, where plug-ins of several kinds have the name",
        )
        parser.add_argument(
            "--scenario",
            type=Path,
            metavar="FILE",
            help="drive a traffic there, where it needs more than a scene built in code, such as "
            "the files of a simulator",
        )
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
            CommandError: The time-out is not positive, or the options do not go together.
            RegistryError: There is no such plug-in.
            ScenarioError: The scenario cannot be read.
            FileError: A file cannot be written.
        """
        from dosplan.report.tables import table

        if not 0.0 < options.timeout < threading.TIMEOUT_MAX:
            raise CommandError(f"--timeout is {options.timeout:g}; it must be a time above 0 s")
        report = _report(options)
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
        lines = [f"{report.plugin} {verdict}"]
        if report.ok:
            lines.append(
                "in a few scenes that are built for the checks; next, a real run of --limit 10"
            )
        show([checks, *lines], figures, options.json)
        return OK if report.ok else FAILED


def _report(options: argparse.Namespace) -> Report:
    """The checks of a planner, predictor or traffic, whichever has the name."""
    from dosplan.plugins.isolated import check_isolated
    from dosplan.plugins.registry import (
        OtherKindError,
        PluginKind,
        RegistryError,
        list_plugins,
    )

    spec, scenario = options.name, options.scenario
    word = options.kind or ("traffic" if scenario is not None else None)
    if scenario is not None and word != "traffic":
        raise CommandError(f"--scenario is for traffic, not for a {word}")
    kinds = [kind for kind in PluginKind if word in (None, kind.word)]
    installed = {kind: {plugin.name for plugin in list_plugins(kind)} for kind in kinds}
    named = [kind for kind in kinds if spec in installed[kind]]
    if len(named) > 1:
        words = " and ".join(f"a {kind.word}" for kind in named)
        raise CommandError(f"{spec} is {words}; say which one is meant, with --kind")
    if not named and ":" not in spec and not spec.endswith(".py"):
        hint = did_you_mean(spec, set().union(*installed.values()))
        raise RegistryError(
            f"no {' or '.join(kind.word for kind in kinds)} is called {spec!r}{hint}; "
            "`dosplan list` shows them all, FILE.py:CLASS is one of your own"
        )
    complaints = []
    for kind in named or kinds:
        try:
            return check_isolated(kind, spec, options.timeout, scenario)
        except OtherKindError as error:
            complaints.append(str(error))
    raise RegistryError("; ".join(dict.fromkeys(complaints)))
