"""``dosplan evaluate``: predictors against the recorded future."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from dosplan.cli.arguments import (
    SOURCE_HELP,
    add_json,
    add_loop,
    add_seed,
    add_workers,
    chosen_settings,
    console,
    show,
)
from dosplan.cli.command import FAILED, OK, CommandError

if TYPE_CHECKING:
    from dosplan.evaluation.evaluate import Progress
    from dosplan.evaluation.methods import Method

_EXAMPLES: Final = """\
examples:
  dosplan evaluate my/scenarios --predictor constant-velocity --predictor growing-circle
  dosplan evaluate my/scenarios --methods predictors/simple.yaml --scale-on my/validation
  dosplan evaluate my/scenarios --predictor dos --loop realistic --set loop.latency=0.5
  dosplan evaluate suite --predictor dos --traffic reactive --futures 20
  dosplan evaluate results/my-run
"""


class EvaluateCommand:
    """Measures predictors on recordings, open loop, or the sets of a run on its drives."""

    summary = "measure how well predictors' sets hold the recorded future, or that of a run"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _EXAMPLES
        add_json(parser)
        parser.add_argument(
            "source",
            metavar="SOURCE",
            help=f"{SOURCE_HELP}; or a run folder: how often road users near the ego left the sets "
            "that its planner had, and by how much",
        )
        parser.add_argument(
            "--source",
            dest="scenarios",
            metavar="SOURCE",
            help="for a run folder: where its scenarios lie now (default: where it found them)",
        )
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
            "--every", type=int, metavar="N", help="steps between two predictions (default: 5)"
        )
        add_loop(parser, "measure what a planner gets in that loop of dosplan run")
        parser.add_argument(
            "--futures",
            type=int,
            metavar="K",
            help="measure how often a set holds over K futures of the start of each scenario, not "
            "over the recorded one; needs --traffic",
        )
        parser.add_argument(
            "--traffic", metavar="NAME", help="traffic that has several futures, for --futures"
        )
        parser.add_argument(
            "--level",
            type=float,
            metavar="SHARE",
            help="what the sets are meant to cover, for --futures (default: 0.9)",
        )
        add_workers(parser)
        add_seed(parser)
        parser.add_argument(
            "--timeout",
            type=float,
            metavar="S",
            help="seconds after which a file counts as hung (default: 3600)",
        )
        parser.add_argument(
            "--markdown", type=Path, metavar="PATH", help="write the tables there as Markdown"
        )

    def run(self, options: argparse.Namespace) -> int:
        """Measures; files that cannot be read are named on stderr.

        Returns:
            0; 1 where a file could not be evaluated.

        Raises:
            CommandError: Options do not go together.
            EvaluationError: The arguments make no sense, or nothing could be evaluated.
            MethodError: A method cannot be built.
            RegistryError: There is no such traffic.
            ScenarioError: There are no scenarios.
            FileError: A file cannot be written, or a run folder cannot be read.
        """
        from dosplan.evaluation.methods import Method, read_methods
        from dosplan.report.evaluation import evaluation_markdown, evaluation_tables
        from dosplan.report.progress import show_progress
        from dosplan.system.files import write_text

        listed = [method for path in options.methods for method in read_methods(path)]
        methods = (*listed, *(Method(name, name) for name in options.predictors))
        if (Path(options.source) / "run.json").is_file():
            measure = _over_drives
        else:
            _refuse(options, ("scenarios",), "goes with a run folder only")
            measure = _over_recordings if options.futures is None else _over_futures
        with show_progress(console(stderr=True), "files") as progress:
            figures = measure(options, methods, progress)
        for failure in figures["data"]["failed"]:
            print(failure["error"], file=sys.stderr)
        if options.markdown is not None:
            write_text(options.markdown, evaluation_markdown(figures))
        show([evaluation_tables(figures)], figures, options.json)
        return FAILED if figures["data"]["failed"] else OK


def _over_recordings(
    options: argparse.Namespace, methods: tuple[Method, ...], progress: Progress
) -> dict[str, Any]:
    from dosplan.evaluation.evaluate import FILE_SECONDS, EvaluationConfig, evaluate

    _refuse(options, ("traffic", "level"), "goes with --futures only")
    config = EvaluationConfig(
        source=options.source,
        methods=methods,
        every=5 if options.every is None else options.every,
        loop=options.loop or "ideal",
        loop_options=chosen_settings(options.settings or (), "loop"),
        scale_on=options.scale_on,
        workers=options.workers,
        seed=options.seed,
        file_timeout=FILE_SECONDS if options.timeout is None else options.timeout,
    )
    return evaluate(config, progress)


def _over_drives(
    options: argparse.Namespace, methods: tuple[Method, ...], progress: Progress
) -> dict[str, Any]:
    from dosplan.evaluation.tails import evaluate_drives

    others = ("every", "scale_on", "loop", "settings", "futures", "traffic", "level", "timeout")
    _refuse(options, others, "does not go with a run folder: its sets are those it was driven with")
    if methods:
        raise CommandError("a run folder is measured with the sets that it was driven with")
    return evaluate_drives(Path(options.source), options.scenarios, progress)


def _over_futures(
    options: argparse.Namespace, methods: tuple[Method, ...], progress: Progress
) -> dict[str, Any]:
    from dosplan.evaluation.evaluate import FILE_SECONDS
    from dosplan.evaluation.futures import FuturesConfig, evaluate_futures
    from dosplan.evaluation.metrics import COVERAGE

    _refuse(options, ("every", "scale_on", "loop", "settings"), "does not go with --futures")
    if options.traffic is None:
        raise CommandError("--futures needs a --traffic that has several futures, as reactive")
    config = FuturesConfig(
        source=options.source,
        methods=methods,
        traffic=options.traffic,
        futures=options.futures,
        level=COVERAGE if options.level is None else options.level,
        workers=options.workers,
        seed=options.seed,
        file_timeout=FILE_SECONDS if options.timeout is None else options.timeout,
    )
    return evaluate_futures(config, progress)


def _refuse(options: argparse.Namespace, names: Sequence[str], why: str) -> None:
    for name in names:
        if getattr(options, name) is not None:
            renamed = {"settings": "set", "scenarios": "source"}
            option = renamed.get(name, name.replace("_", "-"))
            raise CommandError(f"--{option} {why}")
