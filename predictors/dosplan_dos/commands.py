"""``dosplan train`` and ``dosplan export``: from training windows to weights and ONNX files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from dosplan_net.commands import (
    chosen_parts,
    network_folder,
    read_training,
    say,
    say_best,
    train_network,
    train_response,
)

from dosplan.cli.command import CommandError


class TrainCommand:
    """``dosplan train``: the network, its response to lights, the sets or their calibration."""

    summary = "train the trajectory network, its response to traffic lights or the occupancy sets"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.add_argument(
            "what",
            choices=("net", "lights", "dos", "calibration"),
            help="the network, its response to traffic lights, sets on it, or nothing but the "
            "calibration of sets that are trained, for the loop of the windows",
        )
        parser.add_argument("--config", type=Path, required=True, metavar="FILE.yaml")
        parser.add_argument(
            "--data",
            type=Path,
            action="append",
            default=[],
            metavar="CACHE",
            help="windows to learn from; for calibration, of recordings that the network was not "
            "trained on (repeatable)",
        )
        parser.add_argument(
            "--validation",
            type=Path,
            action="append",
            metavar="CACHE",
            help="windows to select on; not for calibration (repeatable: they count the same)",
        )
        parser.add_argument(
            "--unseen",
            type=Path,
            action="append",
            default=[],
            metavar="CACHE",
            help="for dos: more windows to learn from, of recordings that the network was not "
            "trained on; its own errors count (repeatable)",
        )
        parser.add_argument(
            "--init",
            type=Path,
            metavar="DIR",
            help="for net and dos: begin from the weights of this folder, not from random ones",
        )
        parser.add_argument(
            "--out", type=Path, required=True, metavar="DIR", help="weights, logs, checkpoints"
        )
        parser.add_argument(
            "--network",
            type=Path,
            metavar="DIR",
            help="for lights, dos and calibration: the --out folder of the network's training",
        )
        parser.add_argument(
            "--only",
            action="append",
            metavar="NAME",
            help="only this part: net, fold-0, ...; for dos and calibration, a module (repeatable)",
        )
        parser.add_argument(
            "--threads", type=int, default=1, metavar="N", help="threads (default: %(default)s)"
        )
        parser.add_argument(
            "--device",
            default="cpu",
            metavar="NAME",
            help="where torch trains the network and the sets, such as cuda (default: %(default)s)",
        )

    def run(self, options: argparse.Namespace) -> int:
        """Trains what is not trained yet.

        Raises:
            CommandError: The configuration, a cache or weights cannot be used.
        """
        import torch
        from dosplan_net.training.cache import CacheError
        from dosplan_net.weights import WeightsError

        if (options.validation is None) != (options.what == "calibration"):
            raise CommandError("--validation CACHE is needed, but for calibration, which has none")
        if options.unseen and options.what != "dos":
            raise CommandError(
                "--unseen is for dos alone; give other trainings the cache as --data"
            )
        if not options.data + options.unseen:
            raise CommandError("--data CACHE is needed, or for dos --unseen CACHE")
        if options.init is not None and options.what not in ("net", "dos"):
            raise CommandError(f"--init is for net and dos; {options.what} begins anew")
        torch.set_num_threads(options.threads)
        train = {
            "net": train_network,
            "lights": train_response,
            "dos": _train_sets,
            "calibration": _calibrate_sets,
        }
        try:
            train[options.what](options)
        except (CacheError, WeightsError) as error:
            raise CommandError(str(error)) from None
        return 0


class ExportCommand:
    """``dosplan export``: writes weights as ONNX files, which onnxruntime runs without torch."""

    summary = "write trained weights as ONNX files, which run quicker"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
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

        Raises:
            CommandError: Weights cannot be read, or onnx is missing.
            FileError: A file cannot be written.
        """
        from dosplan_net.encoder import LIGHTS, MAP, SCENE, lights_beside, shipped_weights
        from dosplan_net.export import export

        from dosplan_dos.predictor import DEFAULT_SETS, SETS

        network, sets = options.network, options.sets
        if network is None and not sets:
            network, sets = shipped_weights(), list(DEFAULT_SETS.values())
        try:
            jobs = [(model, network) for model in (MAP, SCENE) if network is not None]
            if network is not None and lights_beside(network) is not None:
                jobs.append((LIGHTS, network))
            jobs += [(SETS, _sets_weights(name)) for name in sets]
            for model, weights in jobs:
                say(f"{export(model, weights, options.out or weights.parent)}: written")
        except ValueError as error:
            raise CommandError(str(error)) from None
        return 0


def _sets_weights(name: str) -> Path:
    from dosplan_dos.predictor import shipped_sets

    return Path(name) if name.endswith(".safetensors") else shipped_sets(name)


def _train_sets(options: argparse.Namespace) -> None:
    from dosplan_dos.training import SetTraining, train_sets

    config = read_training(options.config, SetTraining)
    names = chosen_parts(options.only, list(config.modules))
    network = network_folder(options)
    trained = train_sets(
        names,
        config,
        options.data,
        options.validation,
        network,
        options.out,
        say,
        options.device,
        unseen=options.unseen,
        init=options.init,
    )
    for name, figures in trained:
        say_best(name, figures)


def _calibrate_sets(options: argparse.Namespace) -> None:
    from dosplan_dos.training import SetTraining, calibrate_sets

    config = read_training(options.config, SetTraining)
    names = chosen_parts(options.only, list(config.modules)) if options.only else config.calibrated
    for told in calibrate_sets(names, options.data, network_folder(options), options.out):
        say(told)


TRAIN: Final = TrainCommand()
EXPORT: Final = ExportCommand()
