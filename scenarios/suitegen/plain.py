"""SUMO's plain-XML description of a road network, and netconvert, which compiles it."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

import sumo

Point = tuple[float, float]


class NetworkError(RuntimeError):
    """A network that netconvert refuses; its message is in the text, in one line."""


CAR_LANE_DISALLOWS = "pedestrian tram rail_urban rail rail_electric rail_fast ship"


@dataclass(frozen=True)
class Node:
    """A junction or the end of a road.

    Attributes:
        id: Unique name.
        position: m.
        kind: SUMO's node type (``priority``, ``traffic_light``, ``right_before_left``, ...).
        radius: Turning radius of the kerb, m, or None for SUMO's own.
    """

    id: str
    position: Point
    kind: str = "priority"
    radius: float | None = None


@dataclass(frozen=True)
class Lane:
    """One lane of an edge.

    Attributes:
        width: m.
        kind: ``car`` (everything motorised and bicycles), ``motor`` (no bicycles), ``bicycle`` or
            ``sidewalk``.
    """

    width: float
    kind: str = "car"

    def permission(self) -> dict[str, str]:
        """SUMO's attributes that say who may use the lane."""
        return {
            "car": {"disallow": CAR_LANE_DISALLOWS},
            "motor": {"disallow": f"{CAR_LANE_DISALLOWS} bicycle"},
            "bicycle": {"allow": "bicycle"},
            "sidewalk": {"allow": "pedestrian"},
        }[self.kind]


@dataclass(frozen=True)
class Edge:
    """A directed road between two nodes.

    Attributes:
        id: Unique name.
        source: Node at which it begins.
        target: Node at which it ends.
        lanes: From right to left.
        speed: Limit, m/s.
        shape: Reference line, m: the left edge of the leftmost lane.
        priority: The greater one goes first at a junction.
        lanelet_type: CommonRoad's lanelet type of its car lanes.
    """

    id: str
    source: str
    target: str
    lanes: tuple[Lane, ...]
    speed: float
    shape: tuple[Point, ...]
    priority: int = 1
    lanelet_type: str = "urban"


@dataclass(frozen=True)
class Connection:
    """An explicit lane-to-lane connection; an edge with one has no others."""

    source: str
    target: str
    source_lane: int
    target_lane: int


@dataclass(frozen=True)
class Crossing:
    """A pedestrian crossing at a node, over the named edges."""

    node: str
    edges: tuple[str, ...]
    width: float = 3.5


@dataclass(frozen=True)
class Network:
    """A road network."""

    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]
    connections: tuple[Connection, ...] = ()
    crossings: tuple[Crossing, ...] = ()


def two_way(
    name: str,
    source: str,
    target: str,
    shape: Sequence[Point],
    lanes: tuple[Lane, ...],
    speed: float,
    priority: int = 1,
) -> tuple[Edge, Edge]:
    """A road with the same lanes in both directions.

    Args:
        name: The edges are called ``{name}+`` (along the shape) and ``{name}-``.
        source: Node at which the shape begins.
        target: Node at which it ends.
        shape: Line between the two directions, m.
        lanes: Lanes of each direction, from right to left.
        speed: m/s.
        priority: See ``Edge``.

    Returns:
        The edge along the shape and the one against it.
    """
    forward = tuple(shape)
    return (
        Edge(f"{name}+", source, target, lanes, speed, forward, priority),
        Edge(f"{name}-", target, source, lanes, speed, forward[::-1], priority),
    )


def _shape(points: Iterable[Point]) -> str:
    return " ".join(f"{x:.3f},{y:.3f}" for x, y in points)


def _write(path: Path, root: Element) -> None:
    path.write_bytes(tostring(root))


def compile_network(network: Network, folder: Path) -> Path:
    """Compiles a network.

    Args:
        network: The network.
        folder: Where intermediate files and the result go.

    Returns:
        Path of the ``.net.xml``.

    Raises:
        NetworkError: netconvert refused the network.
    """
    nodes = Element("nodes")
    for node in network.nodes:
        element = SubElement(
            nodes,
            "node",
            id=node.id,
            x=f"{node.position[0]:.3f}",
            y=f"{node.position[1]:.3f}",
            type=node.kind,
        )
        if node.radius is not None:
            element.set("radius", f"{node.radius:.2f}")
    edges = Element("edges")
    for edge in network.edges:
        element = SubElement(
            edges,
            "edge",
            {"id": edge.id, "from": edge.source, "to": edge.target},
            numLanes=str(len(edge.lanes)),
            speed=f"{edge.speed:.3f}",
            priority=str(edge.priority),
            shape=_shape(edge.shape),
            type=edge.lanelet_type,
        )
        for index, lane in enumerate(edge.lanes):
            attributes = {"index": str(index), "width": f"{lane.width:.2f}"}
            SubElement(element, "lane", attributes | lane.permission())
    connections = Element("connections")
    for link in network.connections:
        SubElement(
            connections,
            "connection",
            {"from": link.source, "to": link.target},
            fromLane=str(link.source_lane),
            toLane=str(link.target_lane),
        )
    for crossing in network.crossings:
        SubElement(
            connections,
            "crossing",
            node=crossing.node,
            edges=" ".join(crossing.edges),
            priority="true",
            width=f"{crossing.width:.2f}",
        )
    for name, root in (("nod", nodes), ("edg", edges), ("con", connections)):
        _write(folder / f"plain.{name}.xml", root)
    out = folder / "road.net.xml"
    command = [
        str(Path(sumo.SUMO_HOME) / "bin" / "netconvert"),
        *("--node-files", "plain.nod.xml"),
        *("--edge-files", "plain.edg.xml"),
        *("--connection-files", "plain.con.xml"),
        *("--output-file", out.name),
        *("--offset.disable-normalization", "true"),
        *("--no-turnarounds", "true"),
        *("--rectangular-lane-cut", "true"),
        *("--junctions.internal-link-detail", "12"),
        *("--junctions.corner-detail", "8"),
        *("--walkingareas", "true"),
        *("--precision", "3"),
    ]
    done = subprocess.run(  # noqa: S603 - a fixed program with our own files
        command, cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise NetworkError(f"netconvert failed: {' '.join(done.stderr.split())}")
    return out
