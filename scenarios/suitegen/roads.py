"""The pieces that the road kinds of ``networks`` are put together from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from .plain import Edge, Lane, Network, Node, Point, two_way

KMH = 1.0 / 3.6

Rng = np.random.Generator

URBAN_MIX: Mapping[str, float] = MappingProxyType(
    {
        "car": 0.68,
        "van": 0.10,
        "truck": 0.05,
        "bus": 0.04,
        "motorcycle": 0.05,
        "bicycle": 0.08,
    }
)
MOTORWAY_MIX: Mapping[str, float] = MappingProxyType(
    {"car": 0.72, "van": 0.10, "truck": 0.14, "bus": 0.02, "motorcycle": 0.02}
)
NO_BUS_MIX: Mapping[str, float] = MappingProxyType(
    {"car": 0.76, "van": 0.12, "motorcycle": 0.04, "bicycle": 0.08}
)


@dataclass(frozen=True)
class Flow:
    """Vehicles that appear at random on one edge and leave at another.

    Attributes:
        source: First edge.
        target: Last edge.
        per_hour: Mean number of vehicles per hour.
        mix: Share of each vehicle kind.
    """

    source: str
    target: str
    per_hour: float
    mix: Mapping[str, float]


@dataclass(frozen=True)
class Walk:
    """Pedestrians that walk from one edge's sidewalk to another's."""

    source: str
    target: str
    per_hour: float


@dataclass(frozen=True)
class Parked:
    """A vehicle that stands at the side of a lane.

    Attributes:
        edge: Edge.
        target: Edge at which it leaves once it drives.
        position: Front bumper along the lane, m.
        lateral: Its middle, to the left of the lane's middle, m.
        until: Time at which it pulls out, s, or None if it never does.
    """

    edge: str
    target: str
    position: float
    lateral: float
    until: float | None = None


@dataclass(frozen=True)
class Road:
    """A road network with the traffic it carries.

    Attributes:
        network: The network.
        flows: Vehicles.
        focus: Points of what the road kind is named after, m: a scenario happens near one.
        walks: Pedestrians.
        parked: Parked vehicles.
        tags: CommonRoad tags.
    """

    network: Network
    flows: tuple[Flow, ...]
    focus: tuple[Point, ...]
    walks: tuple[Walk, ...] = ()
    parked: tuple[Parked, ...] = ()
    tags: tuple[str, ...] = ()


def winding(
    start: Point, heading: float, pieces: Sequence[tuple[float, float]], spacing: float = 4.0
) -> tuple[Point, ...]:
    """A line made of straights and arcs.

    Args:
        start: First point, m.
        heading: Heading there, rad.
        pieces: Length, m, and curvature, 1/m, of each piece.
        spacing: Largest distance between points, m.

    Returns:
        Points from the first to the last, m.
    """
    points = [np.asarray(start, dtype=np.float64)]
    for length, curvature in pieces:
        count = max(1, int(np.ceil(length / spacing))) if curvature else 1
        step = length / count
        for _ in range(count):
            # A chord of an arc points along the heading at its middle.
            middle = heading + 0.5 * step * curvature
            points.append(points[-1] + step * np.array([np.cos(middle), np.sin(middle)]))
            heading += step * curvature
    return tuple((float(x), float(y)) for x, y in points)


def bezier(p0: Point, h0: float, p1: Point, h1: float, count: int = 16) -> tuple[Point, ...]:
    """A cubic Bezier curve between two poses.

    Args:
        p0: First point, m.
        h0: Heading there, rad.
        p1: Last point, m.
        h1: Heading there, rad.
        count: Number of points.

    Returns:
        Points, m.
    """
    a, d = np.asarray(p0), np.asarray(p1)
    reach = float(np.linalg.norm(d - a)) / 3.0
    b = a + reach * np.array([np.cos(h0), np.sin(h0)])
    c = d - reach * np.array([np.cos(h1), np.sin(h1)])
    t = np.linspace(0.0, 1.0, count)[:, None]
    curve = (1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * b + 3 * (1 - t) * t**2 * c + t**3 * d
    return tuple((float(x), float(y)) for x, y in curve)


def shifted(points: Sequence[Point], offset: float) -> tuple[Point, ...]:
    """A line beside a line.

    Args:
        points: Line, m.
        offset: To the left, m.

    Returns:
        Points, m.
    """
    line = np.asarray(points)
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    moved = line + offset * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    return tuple((float(x), float(y)) for x, y in moved)


def end_heading(points: Sequence[Point]) -> float:
    """Heading of the last segment of a line, rad."""
    (x0, y0), (x1, y1) = points[-2:]
    return float(np.arctan2(y1 - y0, x1 - x0))


@dataclass(frozen=True)
class Arm:
    """One road that meets at a junction.

    Attributes:
        angle: Direction in which it leaves the junction, rad.
        lanes: Lanes of each direction, from right to left.
        speed: m/s.
        priority: See ``Edge``.
        length: m.
        bend: Change of heading along it, rad.
    """

    angle: float
    lanes: tuple[Lane, ...]
    speed: float
    priority: int
    length: float
    bend: float

    def shape(self, centre: Point = (0.0, 0.0)) -> tuple[Point, ...]:
        """Points from the junction outwards, m."""
        straight = min(28.0, 0.3 * self.length)
        rest = self.length - straight
        return winding(centre, self.angle, [(straight, 0.0), (rest, self.bend / rest)])


def draw_angles(rng: Rng, directions: Iterable[float], jitter: float) -> list[float]:
    """Turns nominal directions by a common angle and jitters each, rad."""
    turn = rng.uniform(-np.pi, np.pi)
    return [float(turn + angle + rng.uniform(-jitter, jitter)) for angle in directions]


def star(centre: Node, arms: Sequence[Arm]) -> tuple[list[Node], list[Edge]]:
    """A junction with its arms, called ``a0``, ``a1``, ...

    Args:
        centre: The junction.
        arms: Its arms; ``a0-`` leads into the junction, ``a0+`` out of it.

    Returns:
        Nodes and edges.
    """
    nodes, edges = [centre], list[Edge]()
    for index, arm in enumerate(arms):
        shape = arm.shape(centre.position)
        nodes.append(Node(f"n{index}", shape[-1]))
        edges.extend(
            two_way(f"a{index}", centre.id, f"n{index}", shape, arm.lanes, arm.speed, arm.priority)
        )
    return nodes, edges


def all_pairs(
    sources: Sequence[str],
    targets: Sequence[str],
    per_hour: float,
    mix: Mapping[str, float] = URBAN_MIX,
) -> tuple[Flow, ...]:
    """Flows from every source to every target of another road, ``per_hour`` for each source."""
    flows: list[Flow] = []
    for source in sources:
        others = [target for target in targets if target[:-1] != source[:-1]]
        flows.extend(Flow(source, target, per_hour / len(others), mix) for target in others)
    return tuple(flows)


def urban_lanes(rng: Rng, count: int, sidewalk: bool = False, cycle: bool = False) -> list[Lane]:
    """Lanes of one direction of an urban street, from right to left."""
    width = round(float(rng.uniform(3.1, 3.5)), 2)
    lanes = [Lane(width, "motor" if cycle else "car")] * count
    if cycle:
        lanes.insert(0, Lane(round(float(rng.uniform(1.6, 2.0)), 2), "bicycle"))
    if sidewalk:
        lanes.insert(0, Lane(2.5, "sidewalk"))
    return lanes


def draw_arm(rng: Rng, angle: float, lanes: list[Lane], speed: float, priority: int) -> Arm:
    """An arm of random length and bend."""
    return Arm(
        angle,
        tuple(lanes),
        speed,
        priority,
        length=float(rng.uniform(130.0, 180.0)),
        bend=float(rng.uniform(-0.7, 0.7)),
    )


def ways(count: int) -> tuple[list[str], list[str]]:
    """Edges into and out of a ``star`` with so many arms."""
    return [f"a{i}-" for i in range(count)], [f"a{i}+" for i in range(count)]


def arclength(line: tuple[Point, ...], index: int) -> float:
    """Length of a line up to one of its points, m."""
    points = np.asarray(line[: index + 1])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
