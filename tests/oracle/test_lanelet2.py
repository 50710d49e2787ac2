"""Lanelet2's own reader beside dosplan's: the same lanelets, at the same places, in the same order.

It comes as Linux wheels only, so that it is no dependency: ``pip install lanelet2`` to run this.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import shapely

from dosplan.convert.lanelet2 import read_lanelet2
from tests.support.sind_record import write_map

lanelet2: Any = pytest.importorskip("lanelet2", reason="lanelet2 is not installed")

SAMPLE = ("Changchun_Pudong.osm", "NR_ll2.osm", "map_relink_law_save.osm", "Xi'an_Shanglin.osm")


def _file(name: str, tmp_path: Path) -> Path:
    if name == "road":
        return write_map(tmp_path / "road.osm")
    root = os.environ.get("DOSPLAN_DATA")
    if not root:
        pytest.skip("set DOSPLAN_DATA to the folder that holds sind/ to run this")
    (path,) = (Path(root) / "sind" / "Data").glob(f"*/{name}")
    return path


@pytest.mark.parametrize("name", ["road", *SAMPLE])
def test_bounds_and_order_are_those_of_lanelet2(name: str, tmp_path: Path) -> None:
    path = _file(name, tmp_path)
    origin = lanelet2.io.Origin(0.0, 0.0)
    theirs = lanelet2.io.load(str(path), lanelet2.projection.UtmProjector(origin))
    bounds = [[_points(side) for side in (x.leftBound, x.rightBound)] for x in theirs.laneletLayer]
    ours = read_lanelet2(path).lanelets
    assert len(ours) == len(bounds)
    for draft in ours:
        ends = _ends(draft.left, draft.right)
        left, right = min(bounds, key=lambda b: float(np.abs(_ends(*b) - ends).max()))
        assert np.abs(_ends(left, right) - ends).max() < 0.001
        assert _apart(draft.left, left) < 0.005
        assert _apart(draft.right, right) < 0.005
    follow = sum(
        lanelet2.geometry.follows(a, b) for a in theirs.laneletLayer for b in theirs.laneletLayer
    )
    assert sum(len(draft.successors) for draft in ours) == follow


def _points(bound: Any) -> npt.NDArray[np.float64]:
    return np.array([(point.x, point.y) for point in bound])


def _ends(left: npt.NDArray[np.float64], right: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.array([left[0], left[-1], right[0], right[-1]])


def _apart(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> float:
    return float(shapely.hausdorff_distance(shapely.LineString(a), shapely.LineString(b)))
