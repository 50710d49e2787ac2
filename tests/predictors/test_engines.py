"""The trained predictors under onnxruntime: the same sets as under torch, from files that fit."""

from __future__ import annotations

import argparse
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from dosplan_dos.commands import EXPORT
from dosplan_dos.predictor import DosPredictor, DosSettings
from dosplan_dos.shapes import Variant
from dosplan_net.encoder import SCENE
from dosplan_net.engine import Engine, EngineError
from dosplan_net.predictor import NetPredictor, NetSettings
from shapely.geometry import box

from dosplan.cli.command import CommandError
from dosplan.plugins.registry import RegistryError, choose_predictor
from dosplan.scenario import ScenarioRef, find_scenarios, load_scenario
from dosplan.scenario.synthetic import steady_tracks
from dosplan.simulation.world import World
from dosplan.types import FloatArray, Observation, Occupancy, RoadMap, RoadUserKind
from tests.support.lights import regulated_scenario
from tests.support.models import (
    MODES,
    save_lights,
    save_network,
    save_sets,
    save_unions,
    seen_at,
)

pytest.importorskip("onnxruntime", reason='needs onnxruntime: pip install "dosplan[onnx]"')
onnx = pytest.importorskip("onnx", reason='needs onnx: pip install "dosplan[onnx]"')

CLOSE = 1e-3  # m
# One of each family.
REFS = {ref.id.partition("-")[0]: ref for ref in find_scenarios("suite-1")}.values()


def export(*arguments: object) -> int:
    """``dosplan export``."""
    parser = argparse.ArgumentParser()
    EXPORT.add_arguments(parser)
    return EXPORT.run(parser.parse_args([str(argument) for argument in arguments]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network and a module of each variant, with their exported files."""
    made = tmp_path_factory.mktemp("weights")
    network = save_network(made / "net.safetensors")
    export(
        "--network", network, "--sets", *(save_sets(made / f"{v}.safetensors", v) for v in Variant)
    )
    several = save_network(made / "several.safetensors", config=MODES)
    export("--network", several, "--sets", save_unions(made / "unions.safetensors"))
    return made


def predictors(folder: Path, variant: Variant) -> list[DosPredictor]:
    """The same predictor under torch and under onnxruntime."""
    network, sets = folder / "net.safetensors", folder / f"{variant}.safetensors"
    return [
        DosPredictor(settings=DosSettings(sets=str(sets), network=network, engine=engine))
        for engine in Engine
    ]


def ellipses(occupancy: Occupancy) -> FloatArray:
    """(N, T, 2, 2) matrices that map the unit circle onto the ellipses.

    An angle says nothing of an ellipse that is nearly a circle; R diag(a, b) R^T always does.
    """
    cosine, sine = np.cos(occupancy.angle), np.sin(occupancy.angle)
    turn = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    return np.asarray((turn * occupancy.semi_axes[..., None, :]) @ np.swapaxes(turn, -1, -2))


def assert_same(ours: Occupancy, reference: Occupancy) -> None:
    """The two say the same within a millimetre."""
    np.testing.assert_allclose(ours.centre, reference.centre, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(ours.heading, reference.heading, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(ellipses(ours), ellipses(reference), rtol=0, atol=CLOSE)


@pytest.mark.parametrize("ref", REFS, ids=lambda ref: ref.id)
def test_both_engines_predict_the_same_sets(ref: ScenarioRef, folder: Path) -> None:
    scenario = load_scenario(ref, cached=True)
    reference, ours = predictors(folder, Variant.FREE)
    for predictor in (reference, ours):
        predictor.reset(scenario.task, scenario.road_map)
    moved = 0.0
    for step in range(scenario.task.start_step, scenario.task.final_step, 12):
        seen = World(scenario, first_step=step, history=31).observation()
        expected = reference.predict(seen)
        assert_same(ours.predict(seen), expected)
        moved = max(moved, float(expected.semi_axes.max(initial=0.0)))
    assert moved > 0.5  # There were sets to compare.


@pytest.mark.parametrize("variant", list(Variant))
def test_every_representation_is_exported(variant: Variant, folder: Path) -> None:
    first = [[30.0, 0.0, 0.3, 8.0], [60.0, 3.5, 2.0, 0.1], [-20.0, 0.0, 0.0, 12.0]]
    seen = seen_at(steady_tracks(first), 40)
    reference, ours = (p.predict(seen) for p in predictors(folder, variant))
    assert_same(ours, reference)


@pytest.mark.parametrize("ref", REFS, ids=lambda ref: ref.id)
def test_both_engines_predict_the_same_unions(ref: ScenarioRef, folder: Path) -> None:
    scenario = load_scenario(ref, cached=True)
    settings = DosSettings(
        sets=str(folder / "unions.safetensors"), network=folder / "several.safetensors"
    )
    seen = World(scenario, first_step=scenario.task.start_step, history=31).observation()
    reference, ours = (
        DosPredictor(settings=replace(settings, engine=engine)).predict(seen) for engine in Engine
    )
    assert ours.union is not None
    assert reference.union is not None
    assert ours.union.count == 3
    np.testing.assert_allclose(ours.union.weight, reference.union.weight, rtol=0, atol=CLOSE)
    assert_same(ours.by_component()[0], reference.by_component()[0])


def test_both_engines_make_a_union_around_the_one_course_of_another_predictor(
    folder: Path,
) -> None:
    seen = seen_at(steady_tracks([[30.0, 0.0, 0.3, 8.0], [-20.0, 0.0, 0.0, 12.0]]), 40)
    settings = DosSettings(
        sets=str(folder / "unions.safetensors"),
        network=folder / "several.safetensors",
        base=choose_predictor("constant-velocity"),
    )
    reference, ours = (
        DosPredictor(settings=replace(settings, engine=engine)).predict(seen) for engine in Engine
    )
    assert ours.union is not None
    assert ours.union.count == 1
    assert ours.semi_axes.min() > 0.0
    assert_same(ours, reference)


def _seen(first: Sequence[Sequence[float]], kind: RoadUserKind = RoadUserKind.CAR) -> Observation:
    return seen_at(steady_tracks(first, kinds=[kind] * len(first)), 0)


@pytest.mark.parametrize(
    "seen",
    [
        pytest.param(_seen([]), id="nobody"),
        pytest.param(_seen([[30.0, 0.0, 0.0, 0.0]], RoadUserKind.PARKED), id="only-parked"),
        pytest.param(_seen([[30.0, 0.0, 0.0, 5.0]]), id="one"),
        pytest.param(
            replace(
                _seen([[30.0, 0.0, 0.0, 5.0], [50.0, 3.5, 0.0, 5.0]]),
                road_map=RoadMap(lanelets=(), drivable=box(0.0, 0.0, 1.0, 1.0)),
            ),
            id="no-lanelets",
        ),
    ],
)
def test_both_engines_take_what_is_empty(seen: Observation, folder: Path) -> None:
    reference, ours = (p.predict(seen) for p in predictors(folder, Variant.FREE))
    assert_same(ours, reference)


def test_the_network_alone_runs_under_both(folder: Path) -> None:
    seen = _seen([[30.0, 0.0, 0.3, 8.0], [60.0, 3.5, 2.0, 0.1]])
    reference, ours = (
        NetPredictor(
            settings=NetSettings(weights=folder / "net.safetensors", engine=engine)
        ).predict(seen)
        for engine in Engine
    )
    assert_same(ours, reference)
    assert not np.any(ours.semi_axes)


def test_the_response_to_lights_runs_under_both(tmp_path: Path) -> None:
    weights = save_network(tmp_path / "net.safetensors")
    save_lights(weights)
    export("--network", weights)
    scenario = regulated_scenario(steady_tracks([[10.0, 3.5, 0.0, 6.0], [0.0, 0.0, 0.0, 5.0]]))
    seen = World(scenario, first_step=0).observation()
    reference, ours, without = (
        NetPredictor(settings=NetSettings(weights=weights, engine=engine, lights=lights)).predict(
            seen
        )
        for engine, lights in ((Engine.TORCH, True), (Engine.ONNX, True), (Engine.ONNX, False))
    )
    assert_same(ours, reference)
    assert np.abs(ours.centre - without.centre).max() > 0.01


def test_every_predictor_has_its_own_number_of_threads(folder: Path) -> None:
    before = torch.get_num_threads()
    weights = folder / "net.safetensors"
    two, one = (NetPredictor(settings=NetSettings(weights=weights, threads=n)) for n in (2, 1))
    seen = [_seen([[30.0, 0.0, 0.0, 5.0]]) for _ in range(3)]
    try:
        for predictor, observation, threads in zip((two, one, two), seen, (2, 1, 2), strict=True):
            predictor.predict(observation)
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)


def test_onnxruntime_needs_no_torch(folder: Path) -> None:
    code = (
        "import sys; from dosplan.plugins.registry import create_predictor; "
        f"f = {str(folder)!r}; "
        "create_predictor('dos', 0, {'network': f + '/net.safetensors', "
        "'sets': f + '/free.safetensors', 'engine': 'onnx'}); "
        "sys.exit('torch' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """Weights of a network with its exported files, to be spoiled."""
    weights = save_network(tmp_path / "net.safetensors")
    export("--network", weights)
    return weights


def refusal(weights: Path) -> str:
    """The line that tells why onnxruntime does not run some weights."""
    with pytest.raises(EngineError) as caught:
        NetPredictor(settings=NetSettings(weights=weights, engine=Engine.ONNX))
    line = str(caught.value)
    assert "\n" not in line
    return line


def _remove(weights: Path) -> None:
    weights.with_suffix(".onnx").unlink()


def _train_on(weights: Path) -> None:
    save_network(weights, seed=1)


def _export_with_an_older_version(weights: Path) -> None:
    file = weights.with_suffix(".onnx")
    content = onnx.load(file)
    onnx.helper.set_model_props(content, SCENE.origin(weights) | {"dosplan": "0.0.1"})
    onnx.save_model(content, file)


def _cut_off(weights: Path) -> None:
    file = weights.with_suffix(".onnx")
    file.write_bytes(file.read_bytes()[:5000])


def _point_elsewhere(weights: Path) -> None:
    file = weights.with_suffix(".onnx")
    content = onnx.load(file)
    onnx.save_model(
        content, file, save_as_external_data=True, location="other.bin", size_threshold=0
    )


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (_remove, r"net\.onnx: cannot be read \(No such file"),
        (_train_on, r"net\.map\.onnx: was not made from these weights"),
        (save_lights, r"net\.lights\.onnx: cannot be read \(No such file"),
        (_export_with_an_older_version, r"net\.onnx: was not made .* by this version"),
        (_cut_off, r"net\.onnx: not an ONNX model"),
        (_point_elsewhere, r"net\.onnx: not self-contained"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_until_it_is_exported_again(
    spoil: Callable[[Path], None], why: str, own: Path
) -> None:
    spoil(own)
    line = refusal(own)
    assert re.search(why, line)
    _, _, command = line.partition("make it with: dosplan export ")
    export(*shlex.split(command))
    NetPredictor(settings=NetSettings(weights=own, engine=Engine.ONNX))


def test_missing_packages_are_named(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    assert 'pip install "dosplan[onnx]"' in refusal(own)
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(CommandError, match=r'needs onnx: pip install "dosplan\[onnx\]"'):
        export("--network", own)


def test_an_unknown_engine_is_refused() -> None:
    with pytest.raises(RegistryError, match="'engine' is 'tensor', expected 'torch' or 'onnx'"):
        choose_predictor("net", {"engine": "tensor"})


def test_export_writes_where_it_is_told(own: Path, tmp_path: Path) -> None:
    out = tmp_path / "elsewhere"
    export("--out", out, "--network", own)
    assert sorted(file.name for file in out.iterdir()) == ["net.map.onnx", "net.onnx"]
    assert (out / "net.onnx").read_bytes() == own.with_suffix(".onnx").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--network", "missing.safetensors"], r"missing\.safetensors: not readable as weights"),
        (["--sets", "no-such"], "there are no sets called 'no-such'"),
    ],
)
def test_export_refuses_what_is_not_there(arguments: list[str], why: str) -> None:
    with pytest.raises(CommandError, match=why):
        export(*arguments)
