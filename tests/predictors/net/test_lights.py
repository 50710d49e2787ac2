"""Traffic lights and the network: what it is told of them, and what that may change."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from dosplan_dos.predictor import DosPredictor, DosSettings
from dosplan_net.features import HISTORY
from dosplan_net.light_network import LightConfig, LightResponse, load_response
from dosplan_net.lights import MEMORY, describe_lights, find_lights, lit
from dosplan_net.predictor import NetPredictor, NetSettings
from dosplan_net.training.cache import CacheError, WindowCache, build_cache
from dosplan_net.training.lights import LightTraining, displacement, lit_windows, train_lights
from dosplan_net.training.optimise import FitSettings
from dosplan_net.weights import WeightsError, load_weights

from dosplan.scenario import find_scenarios, load_recording
from dosplan.scenario.synthetic import LANE_WIDTH, busy_scenario, steady_tracks
from dosplan.simulation.world import World, watch
from dosplan.types import (
    COLOURS,
    LightColour,
    LightStates,
    Observation,
    RoadUserKind,
    Scenario,
    Signals,
)
from tests.predictors.conftest import EVERY
from tests.support.lights import LEFT, OTHER, STOP_X, regulated_scenario
from tests.support.models import TINY, save_lights, save_network, save_sets, seen
from tests.support.suite import SUITE

LENGTH = 4.5  # m, of ``steady_tracks``
SIGNAL = "ZAM_Signal-1_1_T-1"


@pytest.fixture
def network(tmp_path: Path) -> Path:
    """A tiny network with a response to lights beside it."""
    path = save_network(tmp_path / "net.safetensors")
    save_lights(path)
    return path


def scene(*starts: list[float], kind: RoadUserKind = RoadUserKind.CAR) -> Scenario:
    """Road users on the road with lights; each begins at x, y, heading, velocity."""
    return regulated_scenario(steady_tracks(list(starts), kinds=[kind] * len(starts)))


def told(scenario: Scenario, lights: LightStates | None = None, step: int = 0) -> list[list[float]]:
    """What the network is told at a step."""
    observation = World(scenario, first_step=step).observation()
    if lights is not None:
        observation = replace(observation, lights=lights)
    index = find_lights(scenario.road_map)
    assert index is not None
    rows: list[list[float]] = describe_lights(observation, index).tolist()
    return rows


def shows(colour: LightColour, since: float = 1.0) -> LightStates:
    """All lights the same."""
    return LightStates(np.array([LEFT, 2, OTHER]), (colour,) * 3, np.full(3, since))


@pytest.mark.parametrize(
    ("colour", "column"),
    [
        (LightColour.RED, 0),
        (LightColour.RED_YELLOW, 0),
        (LightColour.YELLOW, 1),
        (LightColour.GREEN, 2),
    ],
)
def test_it_is_told_colour_distance_time_and_braking(colour: LightColour, column: int) -> None:
    (row,) = told(scene([10.0, LANE_WIDTH, 0.0, 6.0]), shows(colour, since=2.0))
    distance = STOP_X - 10.0 - LENGTH / 2
    expected = [0.0] * 3 + [distance / 20.0, 2.0 / 5.0, 6.0**2 / (2.0 * distance) / 5.0]
    expected[column] = 1.0
    assert row == pytest.approx(expected, abs=1e-6)


def test_time_is_told_up_to_a_bound_only() -> None:
    """How long it lasts until the next change could be learned from more."""
    place = scene([10.0, LANE_WIDTH, 0.0, 6.0])
    one, other = (told(place, shows(LightColour.RED, s)) for s in (MEMORY, 10.0 * MEMORY))
    assert one == other


def test_nothing_is_told_where_no_lit_light_is_ahead() -> None:
    drives, waits = [10.0, LANE_WIDTH, 0.0, 6.0], [10.0, 0.0, 0.0, 0.0]
    past, crosses = [STOP_X + 1.0, 0.0, 0.0, 6.0], [10.0, 0.0, 0.5 * np.pi, 1.0]
    nothing = [[0.0] * 6]
    assert told(scene(drives, waits), shows(LightColour.INACTIVE)) == 2 * nothing
    assert told(scene(past, crosses), shows(LightColour.RED)) == 2 * nothing
    walker = scene(drives, kind=RoadUserKind.PEDESTRIAN)
    assert told(walker, shows(LightColour.RED)) == nothing


def test_a_response_begins_as_nothing() -> None:
    response = LightResponse(LightConfig(hidden=8, features=12)).eval()
    random = torch.Generator().manual_seed(1)
    features, path = torch.rand(5, 12, generator=random), torch.rand(5, 3, 40, 2, generator=random)
    lights = torch.tensor([[1.0, 0.0, 0.0, 0.5, 0.2, 0.3]]).expand(5, 6)
    assert torch.equal(response(features, path, torch.full((5,), 7.0), lights), path)


def both(network: Path, observation: Observation) -> tuple[np.ndarray, np.ndarray]:
    """Centres with lights and without."""
    with_lights, without = (
        NetPredictor(settings=NetSettings(weights=network, lights=lights)).predict(observation)
        for lights in (True, False)
    )
    return with_lights.centre, without.centre


def test_who_has_no_light_ahead_is_predicted_the_same_to_the_last_bit(network: Path) -> None:
    ours, reference = both(network, seen(busy_scenario()))
    np.testing.assert_array_equal(ours, reference)
    place = scene([10.0, LANE_WIDTH, 0.0, 6.0], [STOP_X + 5.0, LANE_WIDTH, 0.0, 6.0])
    ours, reference = both(network, World(place, first_step=0).observation())
    assert np.abs(ours[0] - reference[0]).max() > 0.01
    np.testing.assert_array_equal(ours[1], reference[1])


def test_lights_that_hold_on_no_lane_are_nobodys(network: Path) -> None:
    place = scene([10.0, LANE_WIDTH, 0.0, 6.0])
    lanelets = tuple(
        replace(lanelet, lights=(), stop_line=None) for lanelet in place.road_map.lanelets
    )
    place = replace(place, road_map=replace(place.road_map, lanelets=lanelets))
    ours, reference = both(network, World(place, first_step=0).observation())
    np.testing.assert_array_equal(ours, reference)


def test_what_lights_will_show_changes_nothing(network: Path) -> None:
    place = scene([10.0, LANE_WIDTH, 0.0, 6.0])
    now = 5
    colours, since = np.array(place.signals.colours), np.array(place.signals.since)
    colours[:, now + 1 :] = COLOURS.index(LightColour.GREEN)
    since[:, now + 1 :] = 0.0
    turned = replace(place, signals=Signals(place.signals.ids, colours, since))
    predictor = NetPredictor(settings=NetSettings(weights=network))
    one, other = (
        predictor.predict(World(each, first_step=now).observation()) for each in (place, turned)
    )
    np.testing.assert_array_equal(one.centre, other.centre)
    colours[:, now] = COLOURS.index(LightColour.GREEN)
    now_green = replace(place, signals=Signals(place.signals.ids, colours, since))
    seen_green = predictor.predict(World(now_green, first_step=now).observation())
    assert np.abs(one.centre - seen_green.centre).max() > 0.01


def test_sets_lie_around_the_changed_trajectory(network: Path) -> None:
    observation = World(scene([10.0, LANE_WIDTH, 0.0, 6.0]), first_step=0).observation()
    sets = str(save_sets(network.with_name("free.safetensors")))
    found = [
        DosPredictor(settings=DosSettings(sets=sets, network=network, lights=lights))
        for lights in (True, False)
    ]
    for predictor, centre in zip(found, both(network, observation), strict=True):
        np.testing.assert_array_equal(predictor.predict(observation).centre, centre)
    names = [[path.name for path in predictor.weight_files()] for predictor in found]
    assert names == [
        ["net.safetensors", "free.safetensors", "net.lights.safetensors"],
        ["net.safetensors", "free.safetensors"],
    ]


def test_a_response_of_another_network_is_refused(network: Path) -> None:
    save_network(network, seed=5)
    line = re.escape(f"{network.with_suffix('.lights.safetensors')}: was not trained on")
    with pytest.raises(WeightsError, match=line):
        NetPredictor(settings=NetSettings(weights=network))


@pytest.fixture(scope="module")
def signals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Windows of a crossing with lights."""
    folder = tmp_path_factory.mktemp("signals")
    build_cache([SUITE / "files" / f"{SIGNAL}.xml.gz"], folder, every=EVERY)
    return folder


def test_a_cache_keeps_the_lights(signals: Path, window_cache: Path) -> None:
    cache = WindowCache.open(signals)
    assert 0.1 < lit(np.asarray(cache.lights)).mean() < 0.9
    place = load_recording(find_scenarios(SUITE / "files" / f"{SIGNAL}.xml.gz")[0])
    index = find_lights(place.road_map)
    assert index is not None
    for number, observation in enumerate(watch(place, EVERY, HISTORY)):
        if number in (0, cache.scenes - 1):
            rows = slice(*cache.scene_start[number : number + 2])
            np.testing.assert_array_equal(cache.lights[rows], describe_lights(observation, index))
    assert not WindowCache.open(window_cache).lights.any()


def test_training_lessens_the_error_and_is_the_same_again(signals: Path, tmp_path: Path) -> None:
    network = save_network(tmp_path / "net.safetensors")
    config = LightTraining(LightConfig(hidden=8), FitSettings(steps=40, validate_every=20), 64)
    for name in ("one", "other"):
        train_lights(config, [signals], [signals], tmp_path, tmp_path / name, lambda line: None)
    one, other = (tmp_path / name / "net.lights.safetensors" for name in ("one", "other"))
    assert one.read_bytes() == other.read_bytes()
    expected = LightConfig(hidden=8, features=TINY.hidden)
    assert load_response(one, network).config == expected
    windows = lit_windows(network, [signals])
    figures = load_weights(one, "light-response")[1]["validation"]
    assert figures["ade"] < displacement(windows.trajectory, windows)["ade"]


def test_a_response_of_other_settings_or_another_network_is_no_result(
    signals: Path, tmp_path: Path
) -> None:
    network = save_network(tmp_path / "net.safetensors")
    config = LightTraining(LightConfig(hidden=8), FitSettings(steps=2, validate_every=2), 64)
    out = tmp_path / "out"

    def train(config: LightTraining) -> dict[str, float]:
        return train_lights(config, [signals], [signals], tmp_path, out, lambda line: None)

    assert train(config) == train(config)
    line = rf"{out}/net\.lights\.safetensors: was trained with other {{}}; name another --out"
    with pytest.raises(WeightsError, match=line.format(r"response\.hidden")):
        train(replace(config, response=LightConfig(hidden=16)))
    save_network(network, seed=3)
    with pytest.raises(WeightsError, match=line.format("network")):
        train(config)
    (out / "net.lights.safetensors").unlink()
    with pytest.raises(WeightsError, match=r"checkpoint\.pt: was trained with other network;"):
        train(config)


def test_a_cache_without_lights_trains_no_response(window_cache: Path, tmp_path: Path) -> None:
    network = save_network(tmp_path / "net.safetensors")
    with pytest.raises(CacheError, match="nobody has a traffic light ahead"):
        lit_windows(network, [window_cache])
