"""Wale-Net behind dosplan's interface: against its own class, and where that would fail."""

from __future__ import annotations

import gzip
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from shapely.geometry import box

from dosplan.api import Predictor
from dosplan.plugins.registry import RegistryError, create_predictor
from dosplan.scenario import load_scenario
from dosplan.scenario.synthetic import steady_tracks, straight_map, straight_scenario
from dosplan.simulation.world import World
from dosplan.types import FloatArray, Lanelet, Observation, RoadMap, RoadUserKind, Scenario
from tests.support.peers import is_missing
from tests.support.suite import SUITE

if is_missing("wale-net"):
    pytest.skip("needs wale-net: pip install 'dosplan[wale-net]'", allow_module_level=True)

from dosplan_wale.network import open_network, read_config, shipped, shipped_weights
from dosplan_wale.scene import RoadImages, facing

WEAVING = "ZAM_Weaving-1_1_T-1"  # Everybody is there from the first step; no lane against them.
STEP = 40  # WaleNet's history leaves the very first state out: late enough to look back 30 steps.
RADIUS = 64.0


def commonroad(name: str, folder: Path) -> Any:
    """The scenario as commonroad-io reads it."""
    from commonroad.common.file_reader import CommonRoadFileReader

    file = folder / f"{name}.xml"
    file.write_bytes(gzip.decompress((SUITE / "files" / f"{name}.xml.gz").read_bytes()))
    return CommonRoadFileReader(str(file)).open()[0]


def scenario(name: str) -> Scenario:
    return load_scenario(SUITE / "files" / f"{name}.xml.gz", cached=True)


def seen_at(drive: Scenario, step: int) -> Observation:
    return World(drive, first_step=step, history=31).observation()


def wale_net(drive: Scenario, **options: object) -> Predictor:
    predictor = create_predictor("wale-net", 0, options)
    predictor.reset(drive.task, drive.road_map)
    return predictor


def test_it_says_what_its_own_class_says(tmp_path: Path) -> None:
    from prediction import WaleNet

    args = json.loads(shipped("configs/online/default.json").read_text(encoding="utf-8"))
    theirs = WaleNet(commonroad(WEAVING, tmp_path), online_args={**args, "gpu": ""}, verbose=False)
    drive = scenario(WEAVING)
    seen = seen_at(drive, STEP)
    # WaleNet counts an obstacle's states from the one after its first: this is the same moment.
    wanted = theirs.step(STEP - 1, [int(name) for name in seen.ids])
    coverage = 0.5
    sets = wale_net(drive, coverage=coverage).predict(seen)
    assert len(wanted) == len(seen.ids) == 7
    for row, name in enumerate(seen.ids):
        found = wanted[int(name)]
        # Theirs moves the positions in single precision, some 3e-5 m at these coordinates.
        assert np.abs(sets.centre[row] - found["pos_list"]).max() < 1e-4
        cos, sin = np.cos(sets.angle[row]), np.sin(sets.angle[row])
        turn = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)
        squared = sets.semi_axes[row] ** 2 / (-2.0 * np.log(1.0 - coverage))
        spread = turn @ (squared[..., None] * turn.swapaxes(1, 2))
        assert np.abs(spread - found["cov_list"]).max() < 1e-4 * np.abs(spread).max()


def test_an_image_of_what_is_near_is_that_of_the_whole_map(tmp_path: Path) -> None:
    from prediction.utils.preprocessing import generate_self_rendered_sc_img

    whole = commonroad("ZAM_Roundabout-2_2_T-1", tmp_path)  # No opposite directions side by side.
    images = RoadImages(scenario("ZAM_Roundabout-2_2_T-1").road_map, RADIUS)
    rng = np.random.default_rng(0)
    lanelets = whole.lanelet_network.lanelets
    for lanelet in rng.choice(len(lanelets), 12, replace=False):
        position = lanelets[lanelet].left_vertices[0] + rng.uniform(-50.0, 50.0, 2)
        rotation = rng.uniform(-np.pi, np.pi)
        wanted = generate_self_rendered_sc_img(RADIUS, whole, position, rotation)
        assert wanted.any()
        assert np.array_equal(images.draw(position, rotation), wanted)


def way(y: float, *, back: bool = False, shift: float = 0.0) -> FloatArray:
    """A line along x from 0 to 100 m, or back."""
    x = np.linspace(0.0, 100.0, 11) + shift
    line = np.stack([x, np.full_like(x, y)], axis=1)
    return line[::-1] if back else line


def test_opposite_lanes_share_a_line_and_not_an_edge() -> None:
    assert facing([way(0.0), way(0.0, back=True), way(3.5)]) == [True, True, False]
    assert facing([way(0.0), way(0.0)]) == [False, False]  # One beside the other, the same way.
    assert facing([way(0.0), way(0.0, back=True, shift=0.4)]) == [True, True]
    assert facing([way(0.0), way(0.0, back=True, shift=0.6)]) == [False, False]
    assert facing([]) == []
    lanes = (
        Lanelet(id=1, left=way(0.0), right=way(-3.5)),
        Lanelet(id=2, left=way(0.0, back=True), right=way(3.5, back=True)),
    )
    images = RoadImages(RoadMap(lanes, box(0.0, -3.5, 100.0, 3.5)), RADIUS)
    image = images.draw(np.array([50.0, 0.0]), 0.0)
    # A pixel is 0.5 m, the position is in the middle of 256: 3.5 m are seven rows.
    bright = {int(row): set(image[row]) - {0.0} for row in np.flatnonzero(image.any(axis=1))}
    assert bright == {121: {255.0}, 128: {127.0}, 135: {255.0}}


def test_a_road_user_far_from_any_road_is_predicted_all_the_same() -> None:
    from prediction.utils.preprocessing import generate_self_rendered_sc_img

    first = [[30.0, 0.0, 0.0, 8.0], [30.0, 1000.0, 0.0, 8.0]]
    drive = straight_scenario(steady_tracks(first))
    seen = seen_at(drive, STEP)
    far = seen.states[1, -1, :2]
    with pytest.raises(ValueError, match="concatenate"):  # As WaleNet itself does.
        generate_self_rendered_sc_img(RADIUS, _bare(drive.road_map), far, 0.0)
    assert not RoadImages(drive.road_map, RADIUS).draw(far, 0.0).any()
    sets = wale_net(drive).predict(seen)
    assert sets.valid.all()
    assert np.all(sets.centre[:, -1, 0] > seen.states[:, -1, 0] + 20.0)


def _bare(road_map: RoadMap) -> Any:
    from types import SimpleNamespace

    lines = [
        SimpleNamespace(left_vertices=x.left, right_vertices=x.right, adj_left=None, adj_right=None)
        for x in road_map.lanelets
    ]
    return SimpleNamespace(lanelet_network=SimpleNamespace(lanelets=lines))


def test_what_is_not_known_to_move_stays_and_is_nobodys_neighbour() -> None:
    first = [[30.0, 0.0, 0.0, 8.0], [70.0, -3.5, 0.0, 0.0]]
    kinds = (RoadUserKind.CAR, RoadUserKind.PARKED)
    drive = straight_scenario(steady_tracks(first, kinds=kinds))
    seen = seen_at(drive, STEP)
    sets = wale_net(drive).predict(seen)
    assert np.all(sets.centre[1] == seen.states[1, -1, :2])
    assert np.all(sets.semi_axes[1] == 0.0)
    assert np.all(sets.semi_axes[0] > 0.0)
    alone = straight_scenario(steady_tracks(first[:1]))
    assert np.array_equal(wale_net(alone).predict(seen_at(alone, STEP)).centre[0], sets.centre[0])


def test_the_road_is_looked_at_once_for_each_pose_and_told_alike() -> None:
    drive = straight_scenario(steady_tracks([[30.0, 0.0, 0.0, 0.0], [20.0, 3.5, 0.0, 8.0]]))
    kept = wale_net(drive)
    looked: list[int] = []
    kept._roads._layers.register_forward_hook(lambda *_: looked.append(1))  # type: ignore[attr-defined]
    steps = range(STEP, STEP + 3)
    first = [kept.predict(seen_at(drive, step)) for step in steps]
    assert len(looked) == 4  # One stands, the other one is in three places.
    kept.reset(drive.task, drive.road_map)  # Another arm.
    again = [kept.predict(seen_at(drive, step)) for step in steps]
    assert len(looked) == 4
    for step, *found in zip(steps, first, again, strict=True):
        fresh = wale_net(drive).predict(seen_at(drive, step))
        for sets in found:
            assert np.array_equal(sets.centre, fresh.centre)
            assert np.array_equal(sets.semi_axes, fresh.semi_axes)
    other = straight_map(length=60.0)
    kept.reset(drive.task, other)
    seen = seen_at(drive, STEP)
    assert not np.array_equal(kept.predict(seen).centre, first[0].centre)
    assert len(looked) == 6


def test_a_turned_and_moved_scene_gives_turned_and_moved_sets() -> None:
    drive = straight_scenario(steady_tracks([[30.0, 0.0, 0.0, 8.0], [20.0, 3.5, 0.1, 9.0]]))
    seen = seen_at(drive, STEP)
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    offset = np.array([500.0, -200.0])

    def moved(points: FloatArray) -> FloatArray:
        return np.asarray(points @ quarter.T + offset)

    states = np.array(seen.states)
    states[..., :2] = moved(states[..., :2])
    states[..., 2] += 0.5 * np.pi
    lanelets = tuple(
        replace(x, left=moved(x.left), right=moved(x.right)) for x in straight_map().lanelets
    )
    turned_map = replace(drive.road_map, lanelets=lanelets)
    before = wale_net(drive).predict(seen)
    after = wale_net(replace(drive, road_map=turned_map)).predict(
        replace(seen, states=states, road_map=turned_map)
    )
    # A line that lies on the border of two pixels may fall into the other: centimetres, no more.
    assert np.allclose(after.centre, moved(before.centre), atol=0.3)
    assert np.allclose(after.semi_axes, before.semi_axes, rtol=0.05)
    assert np.allclose(np.sin(after.angle - before.angle - 0.5 * np.pi), 0.0, atol=0.05)


def test_coverage_scales_the_sets_alone() -> None:
    drive = straight_scenario(steady_tracks([[30.0, 0.0, 0.0, 8.0]]))
    seen = seen_at(drive, STEP)
    half, most = (wale_net(drive, coverage=share).predict(seen) for share in (0.5, 0.99))
    # The quantiles are -2 ln 0.5 and -2 ln 0.01.
    factor = np.sqrt(np.log(0.01) / np.log(0.5))
    assert np.allclose(most.semi_axes, factor * half.semi_axes, rtol=1e-9)
    assert np.array_equal(most.centre, half.centre)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"coverage": 1.0}, "coverage is 1.0, expected a share between 0 and 1"),
        ({"coverage": 0}, "coverage is 0.0, expected"),
        ({"threads": 0}, "threads is 0, expected 1 or more"),
        ({"covrage": 0.9}, "did you mean 'coverage'"),
    ],
)
def test_options_that_make_no_sense_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(RegistryError, match=message):
        create_predictor("wale-net", 0, options)


def test_more_than_its_horizon_is_refused() -> None:
    from dosplan_wale.predictor import WaleNetPredictor, WaleNetSettings

    WaleNetPredictor()
    with pytest.raises(ValueError, match="horizon is 41, expected 40 or less"):
        WaleNetPredictor(settings=WaleNetSettings(horizon=41))


class Bomb:
    """What a weight file may try."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> Any:
        return Path.touch, (self.marker,)


def test_a_weight_file_runs_no_code(tmp_path: Path) -> None:
    marker, file = tmp_path / "exploded", tmp_path / "weights.tar"
    torch.save({"op.bias": Bomb(marker)}, file)
    with pytest.raises(ValueError, match="not the weights of Wale-Net") as caught:
        open_network(read_config(), file)
    assert "\n" not in str(caught.value)
    assert not marker.exists()
    torch.load(file, weights_only=False)
    assert marker.exists()  # It was no dud.


@pytest.mark.parametrize("content", [b"", b"no weights", None], ids=["empty", "text", "cut"])
def test_a_damaged_weight_file_is_named(content: bytes | None, tmp_path: Path) -> None:
    file = tmp_path / "weights.tar"
    file.write_bytes(shipped_weights().read_bytes()[:50_000] if content is None else content)
    with pytest.raises(ValueError, match=r"weights\.tar: not the weights of Wale-Net"):
        open_network(read_config(), file)


def test_weights_of_another_network_are_named(tmp_path: Path) -> None:
    file = tmp_path / "weights.tar"
    torch.save({"op.bias": torch.zeros(5)}, file)
    with pytest.raises(ValueError, match="not the weights of Wale-Net"):
        open_network(read_config(), file)


def test_opening_leaves_everybody_elses_random_numbers_alone() -> None:
    torch.manual_seed(7)
    before = torch.get_rng_state()
    open_network(read_config(), shipped_weights())
    assert torch.equal(torch.get_rng_state(), before)
