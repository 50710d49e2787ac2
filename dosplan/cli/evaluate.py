"""``dosplan evaluate``: predictors against the recorded future."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

from dosplan.cli.arguments import SOURCE_HELP, add_json, add_seed, add_workers, console, show
from dosplan.cli.command import FAILED, OK

_EXAMPLES: Final = """\
examples:
  dosplan evaluate my/scenarios --predictor constant-velocity --predictor growing-circle
  dosplan evaluate my/scenarios --methods predictors/simple.yaml --scale-on my/validation
"""


class EvaluateCommand:
    """Measures predictors on recordings, open loop."""

    summary = "measure how well predictors' sets hold the recorded future"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _EXAMPLES
        add_json(parser)
        parser.add_argument("source", metavar="SOURCE", help=SOURCE_HELP)
        parser.add_argument(
            "--methods",
            type=Path,
            action="append",
            default=[],
            metavar="FILE",
            help="YAML list of label, predictor and options; may be given again",
        )
        parser.add_argument(
            "--predictor",
            dest="predictors",
            action="append",
            default=[],
            metavar="NAME",
            help="a predictor as it is; may be given again",
        )
        parser.add_argument(
            "--scale-on",
            metavar="SOURCE",
            help="recordings on which the sets of OSA@90 are scaled (default: those evaluated)",
        )
        parser.add_argument(
            "--every",
            type=int,
            default=5,
            metavar="N",
            help="steps between two predictions (default: %(default)s)",
        )
        add_workers(parser)
        add_seed(parser)
        parser.add_argument(
            "--markdown", type=Path, metavar="PATH", help="write the tables there as Markdown"
        )

    def run(self, options: argparse.Namespace) -> int:
        """Measures; files that cannot be read are named on stderr.

        Returns:
            0; 1 where a file could not be evaluated.

        Raises:
            EvaluationError: The arguments make no sense, or nothing could be evaluated.
            MethodError: A method cannot be built.
            ScenarioError: There are no scenarios.
            FileError: A file cannot be written.
        """
        from dosplan.evaluation.evaluate import EvaluationConfig, evaluate
        from dosplan.evaluation.methods import Method, read_methods
        from dosplan.report.evaluation import evaluation_markdown, evaluation_tables
        from dosplan.report.progress import show_progress
        from dosplan.system.files import write_text

        listed = [method for path in options.methods for method in read_methods(path)]
        config = EvaluationConfig(
            source=options.source,
            methods=(*listed, *(Method(name, name) for name in options.predictors)),
            every=options.every,
            scale_on=options.scale_on,
            workers=options.workers,
            seed=options.seed,
        )
        with show_progress(console(stderr=True), "files") as progress:
            figures = evaluate(config, progress)
        for failure in figures["data"]["failed"]:
            print(failure["error"], file=sys.stderr)
        if options.markdown is not None:
            write_text(options.markdown, evaluation_markdown(figures))
        show([evaluation_tables(figures)], figures, options.json)
        return FAILED if figures["data"]["failed"] else OK
