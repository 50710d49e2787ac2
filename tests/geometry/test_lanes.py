"""Lanes beside each other around a change of lanes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dosplan.geometry import side_by_side
from dosplan.types import Lanelet


def lanelet(name: int, x: float, y: float, **links: object) -> Lanelet:
    """20 m of lane along +x."""
    along = np.array([x, x + 20.0])
    left, right = (np.column_stack([along, np.full(2, y + side)]) for side in (1.75, -1.75))
    plain = Lanelet(id=name, left=left, right=right)
    return replace(plain, **links)  # type: ignore[arg-type]


def test_pairs_go_as_far_as_both_lanes_do() -> None:
    lower = [
        lanelet(0, 0.0, 0.0, left_neighbour=10, successors=(1,)),
        lanelet(1, 20.0, 0.0, left_neighbour=11, successors=(2,)),
        lanelet(2, 40.0, 0.0, left_neighbour=12, successors=()),
    ]
    upper = [
        lanelet(10, 0.0, 3.5, right_neighbour=0, successors=(11,)),
        lanelet(11, 20.0, 3.5, right_neighbour=1, successors=(12,)),
        lanelet(12, 40.0, 3.5, right_neighbour=2, successors=()),
    ]
    everything = {one.id: one for one in (*lower, *upper)}
    pairs, change = side_by_side(lower[:2], upper[1:], everything)
    assert [(a.id, b.id) for a, b in pairs] == [(0, 10), (1, 11), (2, 12)]
    assert change == 1
    # Back from the upper lane, beside a lanelet whose id is zero.
    pairs, change = side_by_side([upper[0]], [lower[0], lower[1]], everything)
    assert [(a.id, b.id) for a, b in pairs] == [(10, 0), (11, 1)]
    assert change == 0
    # Where the neighbours do not go on, there is no lane to change to before.
    everything[10] = replace(upper[0], successors=())
    pairs, change = side_by_side(lower[:2], upper[1:], everything)
    assert [(a.id, b.id) for a, b in pairs] == [(1, 11), (2, 12)]
    assert change == 0
