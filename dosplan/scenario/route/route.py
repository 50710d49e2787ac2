"""The way to the goal: which lanelets to drive, and what surrounds the path along them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import networkx as nx
import numpy as np
import shapely
from shapely.geometry import LineString, Point

from dosplan.geometry import lanelet_polygon, wrap_angle
from dosplan.scenario.route.corridor import Corridor
from dosplan.scenario.route.path import BEYOND, SPACING, begun_beside, finished_path, raw_path
from dosplan.scenario.route.stops import stops_on
from dosplan.types import FloatArray, GoalState, Lanelet, RoadMap, Route
from dosplan.vehicle import VehicleParameters

CHANGE_COST: Final = 12.0
"""Cost of a lane change in addition to the metres driven, m."""
HORIZON: Final = 60.0
"""Length of path beyond what the episode can drive, for planning ahead, m."""
_CRUISE: Final = 15.0
_START_RADIUS: Final = 3.0
_WRONG_WAY: Final = 1.2
_MOST_LANELETS: Final = 1000
"""Number of lanelets of a route from which on a ring of lanelets is not driven again."""
_START: Final = "start"
_GOAL: Final = "goal"


@dataclass(frozen=True)
class LaneGraph:
    """A map prepared for searching: areas, centre lines and the graph of its lanelets."""

    road_map: RoadMap

    @cached_property
    def lanelets(self) -> dict[int, Lanelet]:
        """Lanelets by id."""
        return {lanelet.id: lanelet for lanelet in self.road_map.lanelets}

    @cached_property
    def ids(self) -> list[int]:
        """Ids in the order of ``tree``."""
        return list(self.lanelets)

    @cached_property
    def for_cars(self) -> list[int]:
        """Ids of the lanelets that a route may use."""
        return [name for name, lanelet in self.lanelets.items() if lanelet.for_cars]

    @cached_property
    def areas(self) -> dict[int, shapely.Geometry]:
        """Areas by id."""
        return {name: lanelet_polygon(x.left, x.right) for name, x in self.lanelets.items()}

    @cached_property
    def tree(self) -> shapely.STRtree:
        """Index of the areas."""
        return shapely.STRtree(list(self.areas.values()))

    @cached_property
    def centres(self) -> dict[int, LineString]:
        """Centre lines by id."""
        return {name: LineString(lanelet.centre) for name, lanelet in self.lanelets.items()}

    @cached_property
    def graph(self) -> nx.DiGraph:
        """Successors at the length of the lanelet, changes of lane at ``CHANGE_COST``."""
        graph = nx.DiGraph()
        graph.add_nodes_from(self.for_cars)
        for name in self.for_cars:
            lanelet = self.lanelets[name]
            for side in neighbours(lanelet):
                graph.add_edge(name, side, weight=CHANGE_COST)
            for later in lanelet.successors:
                graph.add_edge(name, later, weight=self.centres[name].length)
        return graph

    def near(self, place: shapely.Geometry, distance: float) -> list[int]:
        """Ids of the lanelets within a distance of a place, ascending in the map's order."""
        found = self.tree.query(place, predicate="dwithin", distance=distance)
        return [self.ids[i] for i in sorted(found)]

    def near_for_cars(self, place: shapely.Geometry, distance: float) -> list[int]:
        """The same of the lanelets that a route may use."""
        return [name for name in self.near(place, distance) if self.lanelets[name].for_cars]

    def nearest_for_cars(self, place: shapely.Geometry) -> int:
        """Id of the lanelet nearest to a place of those that a route may use."""
        return min(self.for_cars, key=lambda name: shapely.distance(self.areas[name], place))

    def along(self, name: int, point: Point) -> tuple[float, float, float]:
        """Arc length, m, distance, m, and heading, rad, of a lanelet's centre at a point."""
        line, centre = self.centres[name], self.lanelets[name].centre
        s = float(shapely.line_locate_point(line, point))
        steps = np.diff(centre, axis=0)
        ends = np.cumsum(np.hypot(*steps.T))
        i = min(int(np.searchsorted(ends, s, side="right")), len(steps) - 1)
        return s, float(shapely.distance(line, point)), float(np.arctan2(steps[i, 1], steps[i, 0]))

    def reach(self, limit: float) -> dict[int, float]:
        """Length of road, m, from each lanelet's start on, up to ``limit``.

        Where a lanelet ends without a successor, a neighbour's road counts.
        """
        lengths = {name: min(self.centres[name].length, limit) for name in self.ids}
        reach = {**lengths, **dict.fromkeys(self._endless(), limit)}
        changed = True
        while changed:
            changed = False
            for name, lanelet in self.lanelets.items():
                ahead = max((reach[n] for n in lanelet.successors), default=0.0)
                beside = 0.0
                if not lanelet.successors:
                    beside = max((reach[n] for n in neighbours(lanelet)), default=0.0)
                best = max(min(lengths[name] + ahead, limit), beside)
                if best > reach[name] + 1e-6:
                    reach[name], changed = best, True
        return reach

    def _endless(self) -> set[int]:
        """Ids of the lanelets that lead back to themselves, over a successor at least."""
        graph = nx.DiGraph()
        for name, lanelet in self.lanelets.items():
            graph.add_edges_from((name, n) for n in lanelet.successors or neighbours(lanelet))
        return {
            name
            for circle in nx.strongly_connected_components(graph)
            if any(not circle.isdisjoint(self.lanelets[name].successors) for name in circle)
            for name in circle
        }


def neighbours(lanelet: Lanelet) -> Iterator[int]:
    """Adjacent lanelets in the same direction, left first."""
    for name in (lanelet.left_neighbour, lanelet.right_neighbour):
        if name is not None:
            yield name


def build_route(
    road_map: RoadMap,
    *,
    centre: FloatArray,
    heading: float,
    velocity: float,
    goals: Sequence[GoalState],
    seconds: float,
    vehicle: VehicleParameters,
    two_way: frozenset[int] = frozenset(),
) -> Route:
    """The way from the ego's start to the goal and on, as far as the episode can drive.

    The shortest way over the lanelets to the nearest goal, then the straightest road that is long
    enough; without a goal area, or where none can be reached, that road alone. An ego that starts
    on the oncoming lane beside its own, while it overtakes, has its path begin there; the oncoming
    lanelets that the path then uses are free.

    Args:
        road_map: The map.
        centre: (2,) centre of the ego's rectangle, m.
        heading: Of the ego, rad.
        velocity: Of the ego, m/s.
        goals: Alternative goals.
        seconds: Length of the episode, s.
        vehicle: The ego.
        two_way: Lanelets that may be driven against their direction.

    Returns:
        The route; its path begins 30 m behind the ego.
    """
    lanes = LaneGraph(road_map)
    to_goal = _way_to_goal(lanes, Point(centre), heading, goals)
    begun = lanes.along(to_goal[0], Point(centre))[0]
    drivable = max(velocity, 8.0) * seconds
    ahead = max(velocity, _CRUISE) * seconds + HORIZON
    ids = _continued(lanes, to_goal, drivable + begun, ahead + begun + BEYOND)
    chain = [lanes.lanelets[name] for name in ids]
    raw = raw_path(
        chain,
        lanes.lanelets,
        centre=centre,
        velocity=velocity,
        ahead=ahead,
        to_goal=len(to_goal),
    )
    driven = ids
    if _is_oncoming(lanes, Point(centre), heading, ids[0]):
        areas = [goal.region for goal in goals if goal.region is not None]
        raw, back = begun_beside(raw, centre, velocity, areas)
        driven = [*ids, *lanes.near_for_cars(LineString(raw[:back]), 0.5 * vehicle.width)]
    corridor = Corridor.along(
        raw, road_map, lanes.near(LineString(raw), Corridor.WIDTH), frozenset(driven) | two_way
    )
    path, path_heading, curvature = finished_path(raw, corridor.clearance(raw), vehicle.width)
    left, right = corridor.bounds(path, path_heading)
    outer_left, outer_right = Corridor.of_area(path, road_map).bounds(path, path_heading)
    arclength = np.arange(len(path), dtype=np.float64) * SPACING
    return Route(
        lanelet_ids=tuple(ids),
        arclength=arclength,
        path=path,
        heading=path_heading,
        curvature=curvature,
        left=left,
        right=right,
        outer_left=np.maximum(outer_left, left),
        outer_right=np.minimum(outer_right, right),
        speed_limit=_speed_limits(lanes, driven, path),
        stops=stops_on(path, arclength, ids, road_map),
    )


def _starts(lanes: LaneGraph, point: Point, heading: float) -> list[tuple[float, int, float]]:
    """Lanelets on which the ego may be: cost, id and arc length there.

    Those that run against the ego's heading count only where there is no other.
    """
    near = lanes.near_for_cars(point, _START_RADIUS) or [lanes.nearest_for_cars(point)]
    with_it: list[tuple[float, int, float]] = []
    against_it: list[tuple[float, int, float]] = []
    for name in near:
        s, aside, direction = lanes.along(name, point)
        off_road = float(shapely.distance(lanes.areas[name], point))
        turned = abs(float(wrap_angle(direction - heading)))
        ranked = against_it if turned > _WRONG_WAY else with_it
        ranked.append((5.0 * off_road + aside + 4.0 * turned, name, s))
    return sorted(with_it or against_it)


def _is_oncoming(lanes: LaneGraph, point: Point, heading: float, first: int) -> bool:
    """Whether the ego starts on lanes against it only, beside the first one of its route."""

    def turned(name: int) -> float:
        return abs(float(wrap_angle(lanes.along(name, point)[2] - heading)))

    under = [turned(name) for name in lanes.near_for_cars(point, 0.0)]
    return (
        min(under, default=0.0) > _WRONG_WAY
        and max(under) > np.pi - _WRONG_WAY
        and turned(first) <= _WRONG_WAY
    )


def _ends(lanes: LaneGraph, goals: Sequence[GoalState]) -> list[tuple[float, int, float]]:
    """Lanelets on which a goal lies: cost, id and arc length of the goal's middle.

    A lanelet that holds little of the goal or runs against its heading costs more; one that
    holds less than a tenth of what the best one holds does not count.
    """
    out = []
    for goal in goals:
        if goal.region is None:
            continue
        near = lanes.near_for_cars(goal.region, 0.0)
        shares = {n: float(shapely.intersection(lanes.areas[n], goal.region).area) for n in near}
        most = max(shares.values(), default=0.0)
        for name, area in shares.items():
            if most <= 0.0 or area < 0.1 * most:
                continue
            middle = shapely.intersection(lanes.areas[name], goal.region).centroid
            s, _, direction = lanes.along(name, middle)
            cost = 20.0 * (1.0 - area / most)
            if goal.heading is not None:
                turned = abs(float(wrap_angle(direction - 0.5 * sum(goal.heading))))
                cost += 100.0 if turned > _WRONG_WAY else 0.0
            out.append((cost, name, s))
    return out


def _way_to_goal(
    lanes: LaneGraph, point: Point, heading: float, goals: Sequence[GoalState]
) -> list[int]:
    """Ids of the lanelets to the goal; only the one the ego is on where there is no way."""
    starts, ends = _starts(lanes, point, heading), _ends(lanes, goals)
    farthest = max(s for _, _, s in starts)
    graph = lanes.graph.copy()
    for cost, name, s in starts:
        graph.add_edge(_START, name, weight=6.0 * cost + farthest - s)
    for cost, name, s in ends:
        weight = min(cost + s, graph.get_edge_data(name, _GOAL, {"weight": np.inf})["weight"])
        graph.add_edge(name, _GOAL, weight=weight)
    try:
        return list(nx.dijkstra_path(graph, _START, _GOAL))[1:-1]
    except (nx.NetworkXNoPath, nx.NodeNotFound):
        return [starts[0][1]]


def _continued(lanes: LaneGraph, ids: list[int], drivable: float, wanted: float) -> list[int]:
    """Goes on along the straightest road that lasts for what can be driven, up to ``wanted`` m."""
    reach = lanes.reach(drivable)
    out, length = list(ids), 0.0
    for here, after in zip(ids, [*ids[1:], None], strict=True):
        if after is None or after in lanes.lanelets[here].successors:
            length += lanes.centres[here].length
    while length < wanted:
        last = lanes.lanelets[out[-1]]
        later = [n for n in last.successors if n not in out]
        if later:
            enough = min(max(reach[n] for n in later), max(drivable - length, 0.0))
            lasting = [n for n in later if reach[n] >= enough - 1e-6]
            out.append(min(lasting, key=lambda n: _bend(last, lanes.lanelets[n])))
            length += lanes.centres[out[-1]].length
            continue
        beside = [n for n in neighbours(last) if n not in out and lanes.lanelets[n].successors]
        if beside:
            out.append(max(beside, key=lambda n: reach[n]))
        elif last.successors and len(out) < _MOST_LANELETS:  # A ring, which is driven again.
            out.append(min(last.successors, key=lambda n: _bend(last, lanes.lanelets[n])))
            length += lanes.centres[out[-1]].length
        else:
            break
    return out


def _bend(before: Lanelet, after: Lanelet) -> float:
    """How much a way turns at the join of two lanelets and over the second, rad."""
    ends = np.array([before.centre[-1] - before.centre[-2], *_ends_of(after.centre)])
    angles = np.arctan2(ends[:, 1], ends[:, 0])
    return float(np.sum(np.abs(wrap_angle(angles[1:] - angles[0]))))


def _ends_of(line: FloatArray) -> tuple[FloatArray, FloatArray]:
    return line[1] - line[0], line[-1] - line[-2]


def _speed_limits(lanes: LaneGraph, ids: list[int], path: FloatArray) -> FloatArray:
    """Limit at each path point: that of the first of the lanelets that holds it."""
    limits = np.full(len(path), np.inf)
    for name in reversed(ids):
        limit = lanes.lanelets[name].speed_limit
        limits[shapely.contains_xy(lanes.areas[name], path)] = np.inf if limit is None else limit
    return limits
