"""``dosplan data`` and ``dosplan train``: what they make and how they complain."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest
from dosplan_dos.commands import TRAIN
from dosplan_dos.training import load_module
from dosplan_net.commands import DATA
from dosplan_net.training.cache import WindowCache

from dosplan.cli.command import Command, CommandError, offered_commands
from tests.predictors.conftest import CACHED
from tests.support.folds import save_folds
from tests.support.models import save_network, save_sets


def run(command: Command, *arguments: object) -> int:
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return command.run(parser.parse_args([str(argument) for argument in arguments]))


def train(what: str, config: Path, cache: Path, out: Path, *more: object) -> int:
    options = ("--config", config, "--data", cache, "--validation", cache, "--out", out)
    return run(TRAIN, what, *options, *more)


def test_the_commands_are_offered() -> None:
    assert {"data", "train"} <= offered_commands().keys()


def test_data_build_makes_a_cache_and_names_what_it_leaves_out(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for name in CACHED[:2]:
        file = recordings / f"{name}.xml.gz"
        (source / file.name).write_bytes(file.read_bytes())
    arguments = ("build", source, "--out", tmp_path / "cache", "--every", 20)
    assert run(DATA, *arguments) == 0
    cache = WindowCache.open(tmp_path / "cache")
    assert cache.recordings == tuple(f"{name}.xml.gz" for name in CACHED[:2])
    told = capsys.readouterr().out
    assert f"{len(cache.pose)} windows in {cache.scenes} scenes of 2 recordings" in told
    (source / "half.xml").write_text("<commonRoad")
    assert run(DATA, *arguments) == 1
    assert "left out: " in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--every", "--workers", "--futures"])
def test_data_build_wants_positive_numbers(tmp_path: Path, option: str) -> None:
    with pytest.raises(CommandError, match="must be 1 or more"):
        run(DATA, "build", tmp_path, "--out", tmp_path / "cache", option, 0)


@pytest.mark.parametrize(
    ("what", "text"),
    [
        ("net", "fods: 3"),
        ("net", "folds: many"),
        ("net", "fit: {learning_rate: quick}"),
        ("net", "fit: {learning_rate: [1.0]}"),
        ("net", "- folds"),
        ("net", "folds: ["),
        ("net", "\0"),
        ("lights", "response: {hiden: 8}"),
        ("dos", "modules: {a: {variant: square}}"),
        ("dos", "modules: {a: {loss: {name: papr}}}"),
        ("dos", "modules: {a: {base: magic}}"),
        ("dos", "modules: {a: {loss: {kk: 1}}}"),
    ],
)
def test_a_wrong_configuration_is_one_line(tmp_path: Path, what: str, text: str) -> None:
    path = tmp_path / "config.yaml"
    path.write_text(text)
    with pytest.raises(CommandError) as caught:
        train(what, path, tmp_path, tmp_path / "out")
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_what_is_missing_is_named(window_cache: Path, tmp_path: Path) -> None:
    absent, config = tmp_path / "absent", tmp_path / "config.yaml"
    with pytest.raises(CommandError, match="absent"):
        train("net", absent, window_cache, tmp_path)
    config.write_text("batch: 16")
    nothing = ("--config", config, "--validation", window_cache, "--out", tmp_path)
    with pytest.raises(CommandError, match="--data CACHE is needed, or for dos --unseen CACHE"):
        run(TRAIN, "dos", *nothing)
    with pytest.raises(CommandError, match="--network DIR is needed"):
        train("lights", config, window_cache, tmp_path)
    with pytest.raises(CommandError, match=r"absent/net\.safetensors: not readable as weights"):
        train("lights", config, window_cache, tmp_path, "--network", absent)
    save_network(tmp_path / "net.safetensors")
    with pytest.raises(CommandError, match="nobody has a traffic light ahead"):
        train("lights", config, window_cache, tmp_path, "--network", tmp_path)
    config.write_text("modules: {a: {features: 12, hidden: 8}}")
    with pytest.raises(CommandError, match="absent: not a complete cache"):
        train("dos", config, absent, tmp_path, "--network", tmp_path)
    with pytest.raises(CommandError, match=r"absent: holds no fold-0\.safetensors"):
        train("dos", config, window_cache, tmp_path, "--network", absent)
    with pytest.raises(CommandError, match="--network DIR is needed"):
        train("dos", config, window_cache, tmp_path)
    with pytest.raises(CommandError, match="--only b: there is no such part"):
        train("dos", config, window_cache, tmp_path, "--only", "b")


def test_numbers_may_be_written_as_yaml_likes(window_cache: Path, tmp_path: Path) -> None:
    """A training of sets, start to end, from a file in which 1e-3 is text and 1 an integer."""
    config = tmp_path / "config.yaml"
    config.write_text(
        "fit: {steps: 3, validate_every: 3, learning_rate: 1e-3, clip: 1}\n"
        "batch: 16\n"
        "modules:\n"
        "  a: {features: 12, hidden: 8, variant: v2, loss: {name: paper, alpha: 2}}\n"
        "  b: {features: 12, hidden: 8, base: constant-velocity}\n"
    )
    save_network(tmp_path / "net.safetensors")
    save_folds(tmp_path, [window_cache])
    assert train("dos", config, window_cache, tmp_path / "out", "--network", tmp_path) == 0
    module = load_module(tmp_path / "out" / "a.safetensors")
    assert (module.config.variant, module.config.loss.alpha) == ("v2", 2.0)
    assert load_module(tmp_path / "out" / "b.safetensors").config.base == "constant-velocity"


def test_calibration_is_for_the_loop_of_the_windows_and_leaves_the_others(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def windows(name: str, *loop: str) -> Path:
        source, out = ("build", recordings, "--every", 1), tmp_path / name
        assert run(DATA, *source, "--out", out, *loop) == 0
        return out

    true, noisy = windows("true"), windows("noisy", "--loop", "realistic")
    config, out = tmp_path / "config.yaml", tmp_path / "out"
    config.write_text("calibrated: [a]\nmodules: {a: {features: 12, hidden: 8}}")
    out.mkdir()
    save_network(tmp_path / "net.safetensors")
    save_sets(out / "a.safetensors")

    def calibrated(*caches: Path) -> int:
        data = [part for cache in caches for part in ("--data", cache)]
        options = ("--config", config, "--network", tmp_path, "--out", out)
        return run(TRAIN, "calibration", *data, *options)

    assert calibrated(true) == 0
    ideal = (out / "a.calibration.npz").read_bytes()
    assert "as calibrated" not in capsys.readouterr().out
    assert calibrated(noisy) == 0
    told = capsys.readouterr().out
    assert "a, for the loop realistic" in told
    assert "| 90 % |" in told
    assert "as calibrated for the loop ideal" in told
    assert (out / "a.realistic.calibration.npz").is_file()
    assert (out / "a.calibration.npz").read_bytes() == ideal
    with pytest.raises(CommandError, match="seen through ideal and realistic; sets are calibrated"):
        calibrated(true, noisy)
    with pytest.raises(CommandError, match="--validation CACHE is needed"):
        train("calibration", config, noisy, out, "--network", tmp_path)
    other = windows("other", "--loop", "realistic", "--set", "loop.sensing.size=0")
    with pytest.raises(CommandError, match=r"seen through realistic, sensing\.size=0\.0; sets"):
        calibrated(other)


def test_sets_are_not_calibrated_on_errors_of_a_network_that_knows_the_windows(
    window_cache: Path, tmp_path: Path
) -> None:
    config, out = tmp_path / "config.yaml", tmp_path / "out"
    save_network(tmp_path / "net.safetensors")
    text = (
        "fit: {steps: 1, validate_every: 1}\nbatch: 16\ncross_fitted: false\n"
        "modules: {a: {hidden: 8}, b: {hidden: 8}}\n"
    )
    config.write_text(f"{text}calibrated: [b]\n")
    with pytest.raises(CommandError, match="b cannot be calibrated on it, the network has") as told:
        train("dos", config, window_cache, out, "--network", tmp_path)
    assert str(told.value).startswith(f"{window_cache}: ")
    assert "\n" not in str(told.value)
    assert not out.exists()
    # What is not calibrated may learn from them.
    assert train("dos", config, window_cache, out, "--network", tmp_path, "--only", "a") == 0
    config.write_text(text)
    assert train("dos", config, window_cache, out, "--network", tmp_path) == 0


def test_training_goes_on_from_weights_with_more_windows(
    window_cache: Path, tmp_path: Path
) -> None:
    """The network first, then sets on its own errors on a cache that it has not seen."""
    shipped, out, config = tmp_path / "shipped", tmp_path / "out", tmp_path / "config.yaml"
    save_network(shipped / "net.safetensors")
    save_sets(shipped / "a.safetensors")
    fit = "fit: {steps: 2, validate_every: 2, learning_rate: 1e-3}\n"
    config.write_text(
        f"{fit}folds: 0\nbatch: 16\nshares: [3, 1]\n"
        "network: {history: 8, map: 8, hidden: 12, heads: 2, decoder: 16}\n"
    )
    more = ("--data", window_cache, "--validation", window_cache, "--init", shipped)
    assert train("net", config, window_cache, out, *more) == 0
    config.write_text(
        f"{fit}batch: 16\nshares: [1, 1]\ncalibrated: [a]\n"
        "modules: {a: {features: 12, hidden: 8}}\n"
    )
    save_folds(out, [window_cache])
    more = ("--unseen", window_cache, "--network", out, "--init", shipped)
    assert train("dos", config, window_cache, out, *more) == 0
    assert (out / "a.calibration.npz").is_file()
    # Again: nothing is trained. Without the unseen windows it would be another training.
    assert train("dos", config, window_cache, out, *more) == 0
    config.write_text(config.read_text().replace("shares: [1, 1]", "shares: [1]"))
    with pytest.raises(CommandError, match=r"a\.safetensors: was trained with other shares, un"):
        train("dos", config, window_cache, out, "--network", out, "--init", shipped)
    # Where nothing but unseen windows is learned from, no folds are needed.
    config.write_text(f"{fit}batch: 16\nmodules: {{a: {{features: 12, hidden: 8}}}}")
    alone = ("--network", shipped, "--validation", window_cache, "--out", tmp_path / "alone")
    assert run(TRAIN, "dos", "--config", config, "--unseen", window_cache, *alone) == 0
    config.write_text(f"{fit}shares: [1]\nmodules: {{b: {{features: 12, hidden: 8}}}}")
    with pytest.raises(CommandError, match="shares has 1 entries for 2 caches"):
        train("dos", config, window_cache, out, *more)
    with pytest.raises(CommandError, match="--unseen is for dos alone"):
        train("net", config, window_cache, out, "--unseen", window_cache)
    with pytest.raises(CommandError, match="--init is for net and dos"):
        train("lights", config, window_cache, out, "--init", shipped)
