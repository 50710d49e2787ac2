"""``dosplan data``, ``train`` and ``export``: from recordings to weights and ONNX files."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from textwrap import shorten
from typing import Any, Final

from dosplan.cli.arguments import SOURCE_HELP
from dosplan.cli.command import CommandError

SET_EVERY: Final = 2


class DataCommand:
    """``dosplan data build``: extracts training windows from recordings."""

    summary = "extract training windows from recordings"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments.

        Args:
            parser: The subcommand's parser.
        """
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
            "--workers", type=int, default=1, metavar="N", help="processes (default: %(default)s)"
        )

    def run(self, options: argparse.Namespace) -> int:
        """Builds the cache; an interrupted build goes on where it stopped.

        Args:
            options: The arguments.

        Returns:
            0; 1 where a recording was left out because it cannot be read.

        Raises:
            CommandError: Nothing could be extracted.
        """
        from dosplan_net.cache import CacheError, build_cache
        from rich.console import Console

        from dosplan.report.progress import show_progress

        if options.every < 1 or options.workers < 1:
            raise CommandError("--every and --workers must be 1 or more")
        try:
            with show_progress(Console(stderr=True), "recordings") as progress:
                report = build_cache(
                    options.sources,
                    options.out,
                    every=options.every,
                    workers=options.workers,
                    progress=progress,
                )
        except CacheError as error:
            raise CommandError(str(error)) from None
        for line in (*report.unreadable, *report.empty):
            print(f"left out: {line}", file=sys.stderr)
        print(
            f"{options.out}: {report.windows} windows in {report.scenes} scenes of "
            f"{report.recordings} recordings; {len(report.unreadable)} unreadable, "
            f"{len(report.empty)} without a future"
        )
        return 1 if report.unreadable else 0


class TrainCommand:
    """``dosplan train net|dos``: trains the network or the sets."""

    summary = "train the trajectory network or the occupancy sets"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments.

        Args:
            parser: The subcommand's parser.
        """
        parser.add_argument("what", choices=("net", "dos"), help="the network, or sets on it")
        parser.add_argument("--config", type=Path, required=True, metavar="FILE.yaml")
        parser.add_argument(
            "--data",
            type=Path,
            action="append",
            required=True,
            metavar="CACHE",
            help="windows to learn from (repeatable)",
        )
        parser.add_argument(
            "--validation", type=Path, required=True, metavar="CACHE", help="windows to select on"
        )
        parser.add_argument(
            "--out", type=Path, required=True, metavar="DIR", help="weights, logs, checkpoints"
        )
        parser.add_argument(
            "--network",
            type=Path,
            metavar="DIR",
            help="for dos: the --out folder of the network's training",
        )
        parser.add_argument(
            "--only",
            action="append",
            metavar="NAME",
            help="only this part: net, fold-0, ...; for dos, a module (repeatable)",
        )
        parser.add_argument(
            "--threads", type=int, default=1, metavar="N", help="threads (default: %(default)s)"
        )

    def run(self, options: argparse.Namespace) -> int:
        """Trains what is not trained yet.

        Args:
            options: The arguments.

        Returns:
            0.

        Raises:
            CommandError: The configuration, a cache or weights cannot be used.
        """
        import torch
        from dosplan_net.cache import CacheError
        from dosplan_net.weights import WeightsError

        torch.set_num_threads(options.threads)
        train = _train_network if options.what == "net" else _train_sets
        try:
            train(options)
        except (CacheError, WeightsError) as error:
            raise CommandError(str(error)) from None
        return 0


class ExportCommand:
    """``dosplan export``: writes weights as ONNX files, which onnxruntime runs without torch."""

    summary = "write trained weights as ONNX files, which run quicker"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments.

        Args:
            parser: The subcommand's parser.
        """
        parser.description = (
            "Without --network and --sets, the shipped network and the default sets are written."
        )
        parser.add_argument(
            "--out",
            type=Path,
            metavar="DIR",
            help="default: beside the weights, where the predictors look",
        )
        parser.add_argument("--network", type=Path, metavar="WEIGHTS", help="a trajectory network")
        parser.add_argument(
            "--sets",
            nargs="+",
            default=[],
            metavar="NAME",
            help="occupancy sets: shipped ones by name, others by their weight file",
        )

    def run(self, options: argparse.Namespace) -> int:
        """Exports, and says what was written.

        Args:
            options: The arguments.

        Returns:
            0.

        Raises:
            CommandError: Weights cannot be read, or onnx is missing.
            FileError: A file cannot be written.
        """
        from dosplan_net.encoder import MAP, SCENE, shipped_weights
        from dosplan_net.graphs import export

        from dosplan_dos.predictor import DEFAULT_SETS, SETS

        network, sets = options.network, options.sets
        if network is None and not sets:
            network, sets = shipped_weights(), [DEFAULT_SETS]
        try:
            jobs = [(model, network) for model in (MAP, SCENE) if network is not None]
            jobs += [(SETS, _sets_weights(name)) for name in sets]
            for model, weights in jobs:
                _say(f"{export(model, weights, options.out or weights.parent)}: written")
        except ValueError as error:
            raise CommandError(str(error)) from None
        return 0


def _sets_weights(name: str) -> Path:
    from dosplan_dos.predictor import shipped_sets

    return Path(name) if name.endswith(".safetensors") else shipped_sets(name)


def _train_network(options: argparse.Namespace) -> None:
    from dosplan_net.training import NetTraining, stages, train_stage

    config = _read(options.config, NetTraining)
    for name in _chosen(options.only, stages(config)):
        figures = train_stage(name, config, options.data, options.validation, options.out, _say)
        _say(f"{name}: best " + _figures(figures))


def _train_sets(options: argparse.Namespace) -> None:
    from dosplan_dos.training import SetTraining, train_sets

    config = _read(options.config, SetTraining)
    names = _chosen(options.only, list(config.modules))
    if options.network is None:
        raise CommandError("--network DIR is needed: the folder of the network's training")
    trained = train_sets(
        names, config, options.data, options.validation, options.network, options.out, _say
    )
    for name, figures in trained:
        _say(f"{name}: best " + _figures(figures))


def _chosen(asked: list[str] | None, known: list[str]) -> list[str]:
    for name in asked or []:
        if name not in known:
            raise CommandError(f"--only {name}: there is no such part; choose from {known}")
    return asked or known


def _figures(figures: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in figures.items())


def _say(line: str) -> None:
    print(line, flush=True)


def _read(path: Path, kind: Any) -> Any:
    """A configuration file as a dataclass."""
    import dacite

    from dosplan.system.yaml_text import parse_yaml
    from dosplan_dos.shapes import Variant

    try:
        content = parse_yaml(path.read_text(encoding="utf-8")) or {}
        if not isinstance(content, dict):
            raise ValueError("not a list of options and their values")
        # YAML reads 1e-3 as text, and 1 is a fine value where 1.0 is meant.
        config = dacite.Config(strict=True, cast=[Variant], type_hooks={float: float})
        return dacite.from_dict(kind, content, config)
    except (OSError, dacite.DaciteError, ValueError, TypeError, OverflowError) as error:
        raise CommandError(f"{path}: {shorten(str(error), 300, placeholder=' ...')}") from None


DATA: Final = DataCommand()
TRAIN: Final = TrainCommand()
EXPORT: Final = ExportCommand()
