"""Heterogeneous traffic on a road, driven by SUMO's sublane model and recorded step by step."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from xml.etree.ElementTree import (
    Element,
    SubElement,
    iterparse,
    tostring,
)

import numpy as np
import sumo

from dosplan.types import FloatArray
from dosplan.vehicle import VehicleParameters

from .roads import Road

STEP = 0.1
RECORD_FROM = 60.0
RECORD_UNTIL = 180.0
LATERAL_RESOLUTION = "0.4"
"""Width of the sublanes, m."""

EGO_KIND = "ego"
"""A car with exactly the size of dosplan's ego: the only kind that can be taken out for it."""

EGO_SHARE = 0.55
"""Share of the cars that have that size."""

Rng = np.random.Generator


@dataclass(frozen=True)
class VehicleKind:
    """Ranges from which the vehicles of a kind are drawn.

    Attributes:
        v_class: SUMO's class.
        length: m.
        width: m.
        accel: Acceleration, m/s2.
        decel: Comfortable deceleration, m/s2.
        max_speed: m/s.
        speed_factor: Mean and standard deviation of the desired speed over the limit.
    """

    v_class: str
    length: tuple[float, float]
    width: tuple[float, float]
    accel: tuple[float, float]
    decel: tuple[float, float]
    max_speed: tuple[float, float]
    speed_factor: tuple[float, float]


_EGO = VehicleParameters()
KINDS: Mapping[str, VehicleKind] = MappingProxyType(
    {
        EGO_KIND: VehicleKind(
            "passenger",
            (_EGO.length, _EGO.length),
            (_EGO.width, _EGO.width),
            (1.8, 3.0),
            (3.5, 4.8),
            (55.0, 55.0),
            (1.0, 0.12),
        ),
        "car": VehicleKind(
            "passenger",
            (3.6, 4.9),
            (1.65, 1.90),
            (1.8, 3.0),
            (3.5, 4.8),
            (55.0, 55.0),
            (1.0, 0.12),
        ),
        "van": VehicleKind(
            "delivery", (5.2, 6.4), (1.95, 2.05), (1.5, 2.4), (3.5, 4.5), (45.0, 45.0), (0.98, 0.1)
        ),
        "truck": VehicleKind(
            "truck", (7.5, 12.0), (2.4, 2.5), (0.8, 1.3), (3.0, 4.0), (25.0, 25.0), (0.92, 0.06)
        ),
        "bus": VehicleKind(
            "bus", (11.5, 12.5), (2.5, 2.5), (0.9, 1.3), (3.0, 4.0), (27.0, 27.0), (0.92, 0.05)
        ),
        "motorcycle": VehicleKind(
            "motorcycle", (2.0, 2.3), (0.7, 0.9), (2.5, 4.0), (4.5, 6.0), (55.0, 55.0), (1.08, 0.12)
        ),
        "bicycle": VehicleKind(
            "bicycle", (1.7, 1.9), (0.55, 0.65), (0.9, 1.4), (2.5, 3.2), (4.0, 7.0), (1.0, 0.05)
        ),
    }
)
PEDESTRIAN_SIZE = (0.4, 0.5)


@dataclass(frozen=True)
class Recording:
    """A simulation: what was driven, and what SUMO was given for it besides the network.

    Attributes:
        traces: All road users seen between ``RECORD_FROM`` and ``RECORD_UNTIL``.
        demand: Root of the demand file.
        seed: Seed of SUMO.
    """

    traces: tuple[Trace, ...]
    demand: Element
    seed: int


@dataclass(frozen=True)
class Trace:
    """What SUMO reported of one road user.

    Attributes:
        id: SUMO's name.
        kind: A key of ``KINDS``, ``parked`` or ``pedestrian``.
        size: Length and width, m.
        first: Step of the recording at which it appears.
        front: (K, 2) middle of its front bumper, m.
        heading: (K,) rad, unwrapped.
    """

    id: str
    kind: str
    size: tuple[float, float]
    first: int
    front: FloatArray
    heading: FloatArray


def _draw(rng: Rng, bounds: tuple[float, float]) -> float:
    return float(rng.uniform(*bounds))


def vehicle_type(rng: Rng, root: Element, name: str, kind: str) -> tuple[float, float]:
    """Adds a vehicle type of its own for one driver and returns its size, m."""
    family = KINDS[kind]
    size = (round(_draw(rng, family.length), 3), round(_draw(rng, family.width), 3))
    speed_factor = float(np.clip(rng.normal(*family.speed_factor), 0.75, 1.3))
    SubElement(
        root,
        "vType",
        id=name,
        vClass=family.v_class,
        length=f"{size[0]:.3f}",
        width=f"{size[1]:.3f}",
        accel=f"{_draw(rng, family.accel):.2f}",
        decel=f"{_draw(rng, family.decel):.2f}",
        maxSpeed=f"{_draw(rng, family.max_speed):.2f}",
        speedFactor=f"{speed_factor:.3f}",
        sigma=f"{rng.uniform(0.05, 0.45):.2f}",
        tau=f"{np.clip(rng.normal(1.15, 0.25), 0.7, 1.9):.2f}",
        minGap=f"{rng.uniform(1.5, 2.8):.2f}",
        minGapLat=f"{rng.uniform(0.4, 0.8):.2f}",
        maxSpeedLat=f"{rng.uniform(0.9, 1.4):.2f}",
        lcMaxSpeedLatStanding="0.0",
        lcMaxSpeedLatFactor="0.15",
        lcAssertive=f"{rng.uniform(0.8, 1.8):.2f}",
        lcSpeedGain=f"{rng.uniform(0.5, 2.0):.2f}",
        latAlignment="-0.45" if kind == "bicycle" else "center",
        jmTimegapMinor=f"{rng.uniform(0.6, 1.3):.2f}",
        impatience=f"{rng.uniform(0.0, 0.4):.2f}",
    )
    return size


def demand_of(
    road: Road, rng: Rng, until: float
) -> tuple[Element, dict[str, tuple[str, float, float]]]:
    """SUMO's demand of a road.

    Args:
        road: Road and demand.
        rng: Draws departures and drivers.
        until: Time after which nobody departs any more, s.

    Returns:
        Root of the demand file, and kind, length and width, m, of each road user in it.
    """
    root = Element("routes")
    users: dict[str, tuple[str, float, float]] = {}
    departures: list[tuple[float, Element]] = []
    for index, spot in enumerate(road.parked):
        name = f"p{index}"
        users[name] = ("parked", *vehicle_type(rng, root, f"t{name}", "car"))
        vehicle = Element(
            "trip",
            {"from": spot.edge, "to": spot.target},
            id=name,
            type=f"t{name}",
            depart="0.00",
            departPos=f"{spot.position:.2f}",
            departPosLat=f"{spot.lateral:.2f}",
            departSpeed="0",
        )
        SubElement(
            vehicle,
            "stop",
            lane=f"{spot.edge}_0",
            startPos=f"{spot.position - 0.5:.2f}",
            endPos=f"{spot.position:.2f}",
            posLat=f"{spot.lateral:.2f}",
            duration=f"{spot.until if spot.until is not None else 10 * until:.1f}",
        )
        departures.append((0.0, vehicle))
    for index, flow in enumerate(road.flows):
        kinds, shares = list(flow.mix), np.array(list(flow.mix.values()))
        time = float(rng.exponential(3600.0 / flow.per_hour))
        serial = 0
        while time < until:
            name = f"v{index}.{serial}"
            kind = str(rng.choice(kinds, p=shares / shares.sum()))
            if kind == "car" and rng.random() < EGO_SHARE:
                kind = EGO_KIND
            users[name] = (kind, *vehicle_type(rng, root, f"t{name}", kind))
            vehicle = Element(
                "trip",
                {"from": flow.source, "to": flow.target},
                id=name,
                type=f"t{name}",
                depart=f"{time:.2f}",
                departLane="free",
                departSpeed="max",
            )
            departures.append((time, vehicle))
            time += float(rng.exponential(3600.0 / flow.per_hour))
            serial += 1
    SubElement(
        root,
        "vType",
        id="walker",
        vClass="pedestrian",
        length=str(PEDESTRIAN_SIZE[0]),
        width=str(PEDESTRIAN_SIZE[1]),
        speedFactor="normc(1,0.15,0.6,1.4)",
    )
    for index, walk in enumerate(road.walks):
        time = float(rng.exponential(3600.0 / walk.per_hour))
        serial = 0
        while time < until:
            name = f"w{index}.{serial}"
            users[name] = ("pedestrian", *PEDESTRIAN_SIZE)
            person = Element("person", id=name, type="walker", depart=f"{time:.2f}")
            SubElement(person, "walk", {"from": walk.source, "to": walk.target})
            departures.append((time, person))
            time += float(rng.exponential(3600.0 / walk.per_hour))
            serial += 1
    for _, element in sorted(departures, key=lambda pair: pair[0]):
        root.append(element)
    return root, users


def simulate(road: Road, net: Path, folder: Path, rng: Rng) -> Recording:
    """Drives the traffic of a road.

    SUMO runs in a process of its own: it can crash on demand it cannot route.

    Args:
        road: Road and demand.
        net: Its compiled network.
        folder: For intermediate files.
        rng: Draws departures and drivers.

    Returns:
        What was driven; step 0 is ``RECORD_FROM``.

    Raises:
        RuntimeError: SUMO failed; its message is in the text.
    """
    root, users = demand_of(road, rng, RECORD_UNTIL)
    (folder / "demand.rou.xml").write_bytes(tostring(root))
    seed = int(rng.integers(1, 2**31 - 1))
    command = [
        str(Path(sumo.SUMO_HOME) / "bin" / "sumo"),
        *("--net-file", net.name),
        *("--route-files", "demand.rou.xml"),
        *("--fcd-output", "fcd.xml"),
        *("--fcd-output.attributes", "x,y,angle"),
        *("--device.fcd.begin", f"{RECORD_FROM:.1f}"),
        *("--precision", "4"),
        *("--step-length", str(STEP)),
        *("--end", f"{RECORD_UNTIL:.1f}"),
        *("--lateral-resolution", LATERAL_RESOLUTION),
        *("--seed", str(seed)),
        *("--time-to-teleport", "-1"),
        *("--collision.action", "none"),
        *("--ignore-route-errors", "true"),
        *("--no-step-log", "true"),
        *("--no-warnings", "true"),
        *("--xml-validation", "never"),
        *("--xml-validation.net", "never"),
    ]
    done = subprocess.run(  # noqa: S603 - a fixed program with our own files
        command, cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"sumo failed: {done.stderr.strip()}")
    return Recording(_read(folder / "fcd.xml", users), root, seed)


def _read(path: Path, users: Mapping[str, tuple[str, float, float]]) -> tuple[Trace, ...]:
    rows: dict[str, list[tuple[float, float, float]]] = {}
    first: dict[str, int] = {}
    step = -1
    events = iterparse(str(path), events=("start", "end"))  # noqa: S314 - SUMO wrote it
    for event, element in events:
        if element.tag == "timestep":
            if event == "start":
                step += 1
            else:
                element.clear()
        elif event == "end" and element.tag in ("vehicle", "person"):
            name = element.attrib["id"]
            first.setdefault(name, step)
            x, y, angle = (float(element.attrib[key]) for key in ("x", "y", "angle"))
            rows.setdefault(name, []).append((x, y, angle))
    traces = []
    for name, row in rows.items():
        kind, length, width = users[name]
        values = np.array(row)
        # SUMO counts angles in degrees, clockwise from north.
        heading = np.unwrap(np.deg2rad(90.0 - values[:, 2]))
        traces.append(Trace(name, kind, (length, width), first[name], values[:, :2], heading))
    return tuple(traces)
