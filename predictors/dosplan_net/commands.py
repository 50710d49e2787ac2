"""``dosplan data``, and what ``dosplan train`` does for the network and its response to lights."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from textwrap import shorten
from typing import Any, Final

from dosplan.cli.arguments import SOURCE_HELP, add_loop, add_seed, chosen_settings
from dosplan.cli.command import CommandError
from dosplan.system.files import FileError

SET_EVERY: Final = 2


class DataCommand:
    """``dosplan data build``: extracts training windows from recordings."""

    summary = "extract training windows from recordings"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.add_argument("action", choices=("build",), help="make a cache")
        parser.add_argument("sources", nargs="+", metavar="SOURCE", help=SOURCE_HELP)
        parser.add_argument("--out", type=Path, required=True, metavar="CACHE", help="the cache")
        parser.add_argument(
            "--every",
            type=int,
            default=SET_EVERY,
            metavar="N",
            help="steps between two scenes of a recording (default: %(default)s)",
        )
        parser.add_argument(
            "--futures",
            type=int,
            default=1,
            metavar="K",
            help="take so many recorded futures of each scenario, where it has them; together they "
            "count as one (default: %(default)s)",
        )
        parser.add_argument(
            "--met",
            type=Path,
            metavar="RUN",
            help="learn only from road users that the ego of that run came near within the horizon",
        )
        add_loop(parser, "have the road users seen as in that loop of dosplan run")
        add_seed(parser)
        parser.add_argument(
            "--workers", type=int, default=1, metavar="N", help="processes (default: %(default)s)"
        )

    def run(self, options: argparse.Namespace) -> int:
        """Builds the cache; an interrupted build goes on where it stopped.

        Returns:
            0; 1 where a recording was left out because it cannot be read.

        Raises:
            CommandError: Nothing could be extracted.
        """
        from rich.console import Console

        from dosplan.plugins.loops import choose_loop
        from dosplan.report.progress import show_progress
        from dosplan_net.training.cache import CacheError, build_cache

        if min(options.every, options.workers, options.futures) < 1:
            raise CommandError("--every, --workers and --futures must be 1 or more")
        try:
            with show_progress(Console(stderr=True), "recordings") as progress:
                report = build_cache(
                    options.sources,
                    options.out,
                    every=options.every,
                    futures=options.futures,
                    loop=choose_loop(
                        options.loop or "ideal", chosen_settings(options.settings or (), "loop")
                    ),
                    seed=options.seed,
                    met=options.met,
                    workers=options.workers,
                    progress=progress,
                )
        except (CacheError, FileError) as error:
            raise CommandError(str(error)) from None
        for line in (*report.unreadable, *report.empty):
            print(f"left out: {line}", file=sys.stderr)
        print(
            f"{options.out}: {report.windows} windows in {report.scenes} scenes of "
            f"{report.recordings} recordings; {len(report.unreadable)} unreadable, "
            f"{len(report.empty)} without a future"
        )
        return 1 if report.unreadable else 0


def train_network(options: argparse.Namespace) -> None:
    """Trains the network's parts that are not trained yet: ``dosplan train net``.

    Args:
        options: The arguments of ``dosplan train``.

    Raises:
        CacheError: A cache cannot be read.
        CommandError: The configuration cannot be used, or ``--only`` names no part.
        WeightsError: Weights that are there cannot be read.
    """
    from dosplan_net.training.train import NET, NetTraining, stages, train_stage

    config = read_training(options.config, NetTraining)
    init = None if options.init is None else options.init / f"{NET}.safetensors"
    for name in chosen_parts(options.only, stages(config)):
        figures = train_stage(
            name,
            config,
            options.data,
            options.validation,
            options.out,
            say,
            options.device,
            init,
        )
        say_best(name, figures)


def train_response(options: argparse.Namespace) -> None:
    """Trains the response to lights, unless it is trained already: ``dosplan train lights``.

    Args:
        options: The arguments of ``dosplan train``.

    Raises:
        CacheError: A cache cannot be read, or nobody has a light ahead in it.
        CommandError: The configuration cannot be used, or no network is named.
        WeightsError: Weights that are there cannot be read.
    """
    from dosplan_net.training.lights import LightTraining, train_lights

    config = read_training(options.config, LightTraining)
    chosen_parts(options.only, ["lights"])
    folder = network_folder(options)
    figures = train_lights(config, options.data, options.validation, folder, options.out, say)
    say_best("lights", figures)


def network_folder(options: argparse.Namespace) -> Path:
    """Reads ``--network``.

    Args:
        options: The arguments of ``dosplan train``.

    Returns:
        The folder of the network's training.

    Raises:
        CommandError: It is not given.
    """
    if options.network is None:
        raise CommandError("--network DIR is needed: the folder of the network's training")
    folder: Path = options.network
    return folder


def read_training(path: Path, kind: Any) -> Any:
    """Reads the configuration of a training.

    Args:
        path: A YAML file.
        kind: The dataclass that it holds the fields of.

    Returns:
        An object of that class.

    Raises:
        CommandError: The file cannot be read, or does not hold such fields.
    """
    from dosplan.plugins.settings import apply_options
    from dosplan.system.yaml_text import parse_yaml

    try:
        content = parse_yaml(path.read_text(encoding="utf-8")) or {}
        if not isinstance(content, dict):
            raise ValueError("not a list of options and their values")
        return apply_options(kind(), content)
    except (OSError, ValueError) as error:
        raise CommandError(f"{path}: {shorten(str(error), 300, placeholder=' ...')}") from None


def chosen_parts(asked: list[str] | None, known: list[str]) -> list[str]:
    """Reads ``--only``.

    Args:
        asked: The parts that it names; None for all.
        known: Every part of the training.

    Returns:
        The parts to train.

    Raises:
        CommandError: There is no part of that name.
    """
    for name in asked or []:
        if name not in known:
            raise CommandError(f"--only {name}: there is no such part; choose from {known}")
    return asked or known


def say(line: str) -> None:
    """Prints a line at once, also where the output is not a terminal.

    Args:
        line: The line.
    """
    print(line, flush=True)


def say_best(part: str, figures: Mapping[str, float]) -> None:
    """Prints the figures of a part that is trained.

    Args:
        part: Its name.
        figures: Those of its best validation.
    """
    say(f"{part}: best " + ", ".join(f"{name} {value:.4g}" for name, value in figures.items()))


DATA: Final = DataCommand()
