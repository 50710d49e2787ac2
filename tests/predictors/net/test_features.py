"""What the network is told of a scene, on scenes whose answer is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from dosplan_net.features import (
    HISTORY,
    KINDS,
    NEIGHBOUR_RANGE,
    NEIGHBOURS,
    PIECE_LENGTH,
    PIECE_POINTS,
    PIECE_RANGE,
    PIECES,
    cut_map,
    describe,
    kinds_of,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon

from dosplan.scenario.synthetic import busy_scenario, crowded_scenario, steady_tracks, straight_map
from dosplan.types import FloatArray, Lanelet, RoadMap, RoadUserKind
from tests.support.models import moved, seen, seen_at, turned

EMPTY_MAP = RoadMap((), Polygon())


def chosen(rows: npt.NDArray[np.int64]) -> list[set[int]]:
    """Each row as a set: their order means nothing."""
    return [set(row.tolist()) for row in rows]


def bend(radius: float = 40.0, angle: float = 2.0) -> Lanelet:
    """A lane on an arc, with points close enough to be one."""
    turn = np.linspace(0.0, angle, 400)
    unit = np.stack([np.sin(turn), -np.cos(turn)], axis=-1)
    return Lanelet(1, left=(radius - 2.0) * unit, right=(radius + 2.0) * unit)


@settings(max_examples=20, deadline=None)
@given(
    angle=st.floats(-np.pi, np.pi),
    x=st.floats(-500.0, 500.0),
    y=st.floats(-500.0, 500.0),
)
def test_a_scene_looks_the_same_wherever_it_lies(angle: float, x: float, y: float) -> None:
    here = seen(crowded_scenario())
    there = moved(here, angle, np.array([x, y]))
    one, other = (describe(o, cut_map(o.road_map)) for o in (here, there))
    np.testing.assert_allclose(other.history, one.history, atol=1e-5)
    np.testing.assert_array_equal(other.static, one.static)
    assert chosen(other.neighbours) == chosen(one.neighbours)
    assert chosen(other.pieces) == chosen(one.pieces)
    np.testing.assert_allclose(
        other.pose[:, :2], turned(one.pose[:, :2], angle) + np.array([x, y]), atol=1e-9
    )
    shapes = [cut_map(o.road_map).shape for o in (here, there)]
    np.testing.assert_allclose(shapes[1], shapes[0], atol=1e-4)


def test_history_is_the_way_that_was_driven() -> None:
    # 8 m/s, whatever the heading: 0.8 m further back with every step.
    observation = seen_at(steady_tracks([[5.0, 3.0, 0.7, 8.0]]), 40)
    (history,) = describe(observation, cut_map(EMPTY_MAP)).history
    expected = np.zeros((HISTORY, 6))
    expected[:, 0] = -0.8 * np.arange(HISTORY)[::-1]
    expected[:, 2], expected[:, 4], expected[:, 5] = 1.0, 8.0, 1.0
    np.testing.assert_allclose(history, expected, atol=1e-5)


@pytest.mark.parametrize("steps", [1, 2, 30, 31, 45])
def test_history_may_have_any_length(steps: int) -> None:
    full = seen(crowded_scenario())
    observation = seen(crowded_scenario(), steps)
    features = describe(observation, cut_map(observation.road_map))
    known = min(steps, HISTORY)
    reference = describe(full, cut_map(full.road_map))
    np.testing.assert_array_equal(features.history[:, -known:], reference.history[:, -known:])
    assert not features.history[:, : HISTORY - known].any()
    np.testing.assert_allclose(features.static[:, -1], known / HISTORY, rtol=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_gap_in_a_history_leaks(seed: int) -> None:
    whole = seen(busy_scenario())
    valid = np.random.default_rng(seed).random(whole.valid.shape) < 0.5
    valid[:, -1] = True
    states = np.where(valid[..., None], whole.states, np.nan)
    gappy = replace(whole, states=states, valid=valid)
    pieces = cut_map(whole.road_map)
    features, reference = describe(gappy, pieces), describe(whole, pieces)
    for array in (features.pose, features.history, features.static):
        assert np.all(np.isfinite(array))
    np.testing.assert_array_equal(features.history[valid], reference.history[valid])
    assert not features.history[~valid].any()


def test_nobody_and_no_map() -> None:
    pieces = cut_map(EMPTY_MAP)
    assert (pieces.shape.shape, pieces.attributes.shape) == ((0, PIECE_POINTS, 3), (0, 5))
    nobody = seen_at(steady_tracks(), 40)
    features = describe(nobody, cut_map(nobody.road_map))
    assert features.history.shape == (0, HISTORY, 6)
    assert features.neighbours.shape == (0, NEIGHBOURS)
    assert features.pieces.shape == (0, PIECES)
    alone = describe(seen_at(steady_tracks([[0.0, 0.0, 0.0, 8.0]]), 40), pieces)
    assert np.all(alone.pieces == -1)
    assert np.all(alone.neighbours == -1)


def nearest(distance: FloatArray, count: int, limit: float) -> list[set[int]]:
    """The definition: the first ``count`` by distance, those within the limit; -1 fills up."""
    rows = []
    for row in distance:
        near = [int(i) for i in np.argsort(row)[:count] if row[i] < limit]
        rows.append({*near, *([-1] if len(near) < count else [])})
    return rows


def test_neighbours_are_the_nearest_others() -> None:
    observation = seen(crowded_scenario())
    now = observation.states[:, -1, :2]
    gap = np.linalg.norm(now[:, None] - now[None], axis=-1)
    np.fill_diagonal(gap, np.inf)
    found = describe(observation, cut_map(EMPTY_MAP)).neighbours
    assert chosen(found) == nearest(gap, NEIGHBOURS, NEIGHBOUR_RANGE)


def test_pieces_are_the_nearest_to_the_stretch_ahead() -> None:
    observation = seen(crowded_scenario())
    pieces = cut_map(observation.road_map)
    now = observation.states[:, -1]
    distance = []
    for x, y, heading, velocity in now:
        along = np.linspace(0.0, 4.0 * velocity, 4001)[:, None]
        stretch = np.array([x, y]) + along * np.array([np.cos(heading), np.sin(heading)])
        gaps = np.linalg.norm(pieces.pose[:, None, :2] - stretch[None], axis=-1)
        distance.append(gaps.min(axis=1))
    found = chosen(describe(observation, pieces).pieces)
    # Where there is room for all within the range, the order at equal distances does not matter.
    expected = nearest(np.array(distance), PIECES, PIECE_RANGE)
    roomy = [-1 in row for row in expected]
    assert sum(roomy) > 10
    assert [f for f, r in zip(found, roomy, strict=True) if r] == [
        e for e, r in zip(expected, roomy, strict=True) if r
    ]


def in_world(shape: FloatArray, pose: FloatArray) -> FloatArray:
    """(PIECE_POINTS, 2) points of a piece in the scenario's frame."""
    return turned(shape[:, :2].astype(np.float64), float(pose[2])) + pose[:2]


@pytest.mark.parametrize("lanelet", [bend(), *straight_map().lanelets])
def test_pieces_join_up_along_the_centre_line(lanelet: Lanelet) -> None:
    pieces = cut_map(RoadMap((lanelet,), Polygon()))
    lines = [in_world(s, p) for s, p in zip(pieces.shape, pieces.pose, strict=True)]
    for before, after in pairwise(lines):
        np.testing.assert_allclose(before[-1], after[0], atol=1e-4)
    np.testing.assert_allclose(lines[0][0], lanelet.centre[0], atol=1e-4)
    np.testing.assert_allclose(lines[-1][-1], lanelet.centre[-1], atol=1e-4)
    length = np.sum(np.linalg.norm(np.diff(lanelet.centre, axis=0), axis=1))
    share = pieces.attributes[:, 0].astype(np.float64)
    assert np.all(share <= 1.0 + 1e-6)
    assert share.sum() * PIECE_LENGTH == pytest.approx(length, rel=1e-5)
    assert len(lines) == int(np.ceil(length / PIECE_LENGTH))
    half = 0.5 * np.linalg.norm(lanelet.left[0] - lanelet.right[0])
    np.testing.assert_allclose(pieces.shape[..., 2], half, rtol=1e-4)


def test_piece_attributes_name_neighbours_limit_and_who_may_drive() -> None:
    first, second = straight_map().lanelets
    lanelets = (replace(first, speed_limit=15.0), replace(second, for_cars=False))
    attributes = cut_map(RoadMap(lanelets, Polygon())).attributes
    count = len(attributes) // 2
    np.testing.assert_allclose(attributes[:count, 1:], np.tile([1.0, 1.0, 0.0, 0.5], (count, 1)))
    np.testing.assert_allclose(attributes[count:, 1:], np.tile([0.0, 0.0, 1.0, 0.0], (count, 1)))


@pytest.mark.parametrize("kinds", [KINDS, (RoadUserKind.TRAIN, RoadUserKind.CAR)])
def test_kinds_can_be_read_back(kinds: Sequence[RoadUserKind]) -> None:
    tracks = steady_tracks([[0.0, 0.0, 0.0, 1.0]] * len(kinds), kinds=kinds)
    static = describe(seen_at(tracks, 5), cut_map(EMPTY_MAP)).static
    expected = [kind if kind in KINDS else RoadUserKind.UNKNOWN for kind in kinds]
    assert kinds_of(static) == expected
