"""What of the road is no way for the ego: the other branches behind the forks of its route.

All of the drivable area beside a path is free road to a plan. Where the road forks, that would be
the wrong branch too: an ego that gives way into it does not come back.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import shapely
from shapely import Geometry, Polygon

from dosplan.geometry import lanelet_polygon, rectangle_corners
from dosplan.types import Lanelet, PlanningTask, RoadMap

_DEPTH: Final = 3  # Lanelets of a branch that are taken out; what follows is far from the path.
_SHARE: Final = 1.0  # m2; a smaller piece is none.


def other_branches(
    task: PlanningTask, road_map: RoadMap, mouth: float, half_width: float
) -> Geometry:
    """The area of the branches that a route does not take.

    Lanes beside the route's, in either direction, are no branches, nor is what lies on any other
    lanelet as well, as in the middle of a crossing. A branch in which the ego starts, or its goal
    lies, is none either.

    Args:
        task: The route, its start and its goals.
        road_map: The map.
        mouth: How far the ego may swing out into a branch, m.
        half_width: Distance from the path up to which the road is always the ego's, m.

    Returns:
        The area, m; empty where the road does not fork.
    """
    lanelets = {lanelet.id: lanelet for lanelet in road_map.lanelets if lanelet.is_road}
    chain = [name for name in task.route.lanelet_ids if name in lanelets]
    own = _with_lanes_beside(chain, lanelets)
    begun = [lanelets[name].successors for name in chain[:-1]]
    names = {name for after in begun for name in after if name in lanelets} - own
    branches: set[int] = set()
    for _ in range(_DEPTH):
        branches |= names
        after = {name for one in names for name in lanelets[one].successors}
        names = {name for name in after if name in lanelets} - own - branches
    if not branches:
        return Polygon()
    closed = shapely.union_all([_area(lanelets[name]) for name in branches])
    box = closed.bounds
    others = [
        _area(one) for one in lanelets.values() if one.id not in branches and _reaches(one, box)
    ]
    path = shapely.LineString(task.route.path).buffer(half_width)
    closed = closed.difference(shapely.union_all([path, *others]).buffer(mouth))
    start = Polygon(rectangle_corners(task.vehicle.poses(task.start[None]), task.vehicle.size)[0])
    held = [start, *(goal.region for goal in task.goals if goal.region is not None)]
    pieces = [
        piece
        for piece in shapely.get_parts(closed)
        if piece.area > _SHARE and not shapely.intersects(piece, held).any()
    ]
    return shapely.union_all(pieces) if pieces else Polygon()


def _with_lanes_beside(chain: list[int], lanelets: dict[int, Lanelet]) -> set[int]:
    """Ids of some lanelets and of all lanes beside them, in either direction."""
    found, new = set(chain), list(chain)
    while new:
        one = lanelets[new.pop()]
        sides = one.left_neighbour, one.right_neighbour, one.left_opposite, one.right_opposite
        beside = {name for name in sides if name in lanelets} - found
        found |= {name for name in beside if name is not None}
        new += [name for name in beside if name is not None]
    return found


def _area(lanelet: Lanelet) -> Geometry:
    return lanelet_polygon(lanelet.left, lanelet.right)


def _reaches(lanelet: Lanelet, box: tuple[float, float, float, float]) -> bool:
    """Whether a lanelet's own box meets another one."""
    points = np.concatenate([lanelet.left, lanelet.right])
    low, high = points.min(axis=0), points.max(axis=0)
    return bool(np.all(low <= box[2:]) and np.all(high >= box[:2]))
