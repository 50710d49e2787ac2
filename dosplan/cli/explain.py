"""``dosplan explain``: why an episode of a run ended as it did."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from dosplan.cli.arguments import add_json, add_moved_source, show
from dosplan.cli.command import OK, Command

_EXAMPLES: Final = """\
examples:
  dosplan explain runs/mine ZAM_Parked-1_1_T-1 --arm with_dos
  dosplan explain runs/mine DEU_Muc-1_2_T-1 --source where/the/files/are/now
"""


class ExplainCommand:
    """Explains the episodes of a scenario."""

    summary = "say why an episode of a run ended as it did"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _EXAMPLES
        add_json(parser)
        parser.add_argument("run_folder", type=Path, metavar="RUN", help="a run folder")
        parser.add_argument("scenario", metavar="SCENARIO", help="id of one of its scenarios")
        parser.add_argument(
            "--arm",
            choices=("with_dos", "without_dos"),
            help="explain this arm only (default: those that the run holds)",
        )
        parser.add_argument(
            "--future",
            type=int,
            metavar="K",
            help="explain this future only, from 0 (default: those that the run holds)",
        )
        add_moved_source(parser)

    def run(self, options: argparse.Namespace) -> int:
        """Explains.

        Raises:
            FileError: The run folder holds no such episode, its scenario cannot be found, or a
                file cannot be written.
        """
        from dataclasses import asdict

        from dosplan.explain import explain
        from dosplan.types import Arm

        arms = (Arm(options.arm),) if options.arm else tuple(Arm)
        found = explain(options.run_folder, options.scenario, arms, options.source, options.future)
        figures = {"explanations": [asdict(explanation) for explanation in found]}
        show([line for e in found for line in e.lines()], figures, options.json)
        return OK


EXPLAIN: Final[Command] = ExplainCommand()
