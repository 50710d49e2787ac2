"""Lanelet2 maps against a road whose lanelets are known, and damaged ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dosplan.convert.lanelet2 import read_lanelet2
from dosplan.scenario import ScenarioError
from dosplan.scenario.commonroad.drafts import LaneletDraft
from tests.support.sind_record import Osm, road, write_map


def _read(tmp_path: Path, text: str) -> dict[int, LaneletDraft]:
    path = tmp_path / "map.osm"
    path.write_text(text, encoding="utf-8")
    return {lanelet.id: lanelet for lanelet in read_lanelet2(path).lanelets}


@pytest.fixture
def lanelets(tmp_path: Path) -> dict[int, LaneletDraft]:
    return _read(tmp_path, str(road()))


def test_positions_are_those_of_lanelet2(tmp_path: Path) -> None:
    """Lanelet2 1.2.3 puts these latitudes and longitudes there, with its origin at (0, 0)."""
    osm = Osm()
    places = {  # latitude, longitude -> x, y
        (0.001, 0.001): (111.42870136495912, 110.68265408006413),
        (-0.002, 0.0005): (55.71454065502621, -221.36541005969048),
        (0.0005, -0.002): (-222.8575967262732, 55.341479952238785),
    }
    for name, (lat, lon) in enumerate(places, start=1):
        osm.parts.append(f'<node id="{name}" lat="{lat}" lon="{lon}"/>')
        osm.node(name + 10, 300.0 + name, 0.0)
    osm.way(1, (1, 2))
    osm.way(2, (11, 12))
    osm.way(3, (2, 3))
    osm.lanelet(1, 1, 2)
    osm.lanelet(2, 3, 2)
    read = _read(tmp_path, str(osm)).values()
    ends = np.concatenate([(x.left[0], x.left[-1]) for x in read])
    for place in places.values():
        assert np.hypot(*(ends - place).T).min() < 1e-3


def test_bounds_run_in_the_direction_of_the_lane_however_they_are_drawn(
    lanelets: dict[int, LaneletDraft],
) -> None:
    for name, (y_left, y_right, begin, end) in {
        101: (1.75, -1.75, -100.0, 0.0),
        102: (1.75, -1.75, 0.0, 100.0),
        103: (5.25, 1.75, -100.0, 0.0),
        105: (5.25, 8.75, 0.0, -100.0),
        106: (5.25, 8.75, 100.0, 0.0),
    }.items():
        for bound, y in ((lanelets[name].left, y_left), (lanelets[name].right, y_right)):
            np.testing.assert_allclose(bound[:, 1], y, atol=1e-3)
            np.testing.assert_allclose(bound[[0, -1], 0], (begin, end), atol=1e-3)


def test_lanelets_follow_each_other_and_lie_side_by_side(
    lanelets: dict[int, LaneletDraft],
) -> None:
    after = {name: lanelet.successors for name, lanelet in lanelets.items()}
    assert after == {101: [102], 102: [], 103: [104], 104: [], 105: [], 106: [105], 107: []}
    for name, lanelet in lanelets.items():
        assert all(name in lanelets[other].predecessors for other in lanelet.successors)
    left = {name: lanelet.adjacent_left for name, lanelet in lanelets.items()}
    right = {name: lanelet.adjacent_right for name, lanelet in lanelets.items()}
    assert left[101] == (103, True)
    assert right[103] == (101, True)
    assert left[103] == (105, False)
    assert left[105] == (103, False)
    assert right[101] is right[105] is left[107] is None


def test_both_bounds_have_a_point_beside_each_vertex_of_the_other(tmp_path: Path) -> None:
    osm = Osm()
    for name, (x, y) in enumerate([(0, 4), (20, 4), (0, 0), (5, 0.5), (10, 0), (20, 0)], start=1):
        osm.node(name, x, y)
    osm.way(1, (1, 2))
    osm.way(2, (3, 4, 5, 6))
    osm.lanelet(1, 1, 2)
    lanelet = _read(tmp_path, str(osm))[101]
    np.testing.assert_allclose(lanelet.right, [(0, 0), (5, 0.5), (10, 0), (20, 0)], atol=1e-6)
    # The right bound is 2 sqrt(25.25) + 10 m long; its vertices lie at these shares of it.
    shares = np.array([0.0, 25.25**0.5, 2 * 25.25**0.5, 2 * 25.25**0.5 + 10.0])
    np.testing.assert_allclose(lanelet.left[:, 0], 20.0 * shares / shares[-1], atol=1e-6)


def test_three_lanelets_at_one_line_are_no_neighbours(tmp_path: Path) -> None:
    """Ways through a junction share lines; CommonRoad has one neighbour on a side."""
    osm = Osm()
    for name, (x, y) in enumerate([(0, 0), (20, 0), (0, 4), (20, 4), (0, 5), (20, 5)], start=1):
        osm.node(name, x, y)
    osm.node(7, 0, -4)
    osm.node(8, 20, -4)
    for way, nodes in enumerate(((1, 2), (3, 4), (5, 6), (7, 8)), start=1):
        osm.way(way, nodes)
    osm.lanelet(1, 2, 1)
    osm.lanelet(2, 3, 1)
    osm.lanelet(3, 1, 4)
    read = _read(tmp_path, str(osm))
    assert all(x.adjacent_left is None and x.adjacent_right is None for x in read.values())


def test_kinds_and_users(lanelets: dict[int, LaneletDraft]) -> None:
    crossing = lanelets[107]
    assert (crossing.kind, crossing.users, crossing.both_ways) == (
        "crosswalk", (), ("pedestrian",),
    )  # fmt: skip
    assert all(lanelets[name].users == ("vehicle",) for name in range(101, 107))


def test_lights_that_the_map_names_have_a_place(tmp_path: Path) -> None:
    found = read_lanelet2(write_map(tmp_path / "map.osm"))
    assert set(found.lights) == {2}
    np.testing.assert_allclose(found.lights[2], (102.0, 2.0), atol=1e-3)
    np.testing.assert_allclose(found.middle, (0.0, 0.0), atol=1e-3)  # Of the stop line.


GOOD = str(road())
DAMAGE = {
    "cut": (GOOD[:300], "is not complete XML"),
    "entity": (
        GOOD.replace("<osm", '<!DOCTYPE osm [<!ENTITY a "b">]><osm', 1),
        "it has a document type",
    ),
    "something else": ("<commonRoad/>", "is a <commonRoad>, not a Lanelet2 map"),
    "no lanelet": ("<osm/>", "holds no lanelet"),
    "only deleted lanelets": (
        GOOD.replace("<relation ", '<relation action="delete" '), "holds no lanelet",
    ),
    "lost node": (GOOD.replace('<node id="-12"', '<node id="-9912"'), "names node -12, which"),
    "lost way": (
        GOOD.replace('<way id="-101"', '<way id="-9901"'),
        "lanelet -1 has no left bound of two points",
    ),
    "no right bound": (
        GOOD.replace('ref="-100" role="right"', 'ref="-100" role="rihgt"'),
        "lanelet -1 has no right bound",
    ),
    "text for a latitude": (GOOD.replace('lat="', 'lat="x', 1), "node -1 has no latitude"),
    "NaN": (GOOD.replace('lat="', 'lat="nan" l="', 1), "node -1 has no latitude"),
    "far away": (
        GOOD.replace('lat="', 'lat="48.1" l="', 1),
        "node -1 has no latitude and longitude within 0.01 degrees",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_map_gets_one_line(name: str, tmp_path: Path) -> None:
    text, message = DAMAGE[name]
    with pytest.raises(ScenarioError, match=message) as raised:
        _read(tmp_path, text)
    assert str(tmp_path / "map.osm") in str(raised.value)
    assert "\n" not in str(raised.value)
