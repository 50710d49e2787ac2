"""What SUMO needs to drive the traffic of a scenario again, this time around another ego.

SUMO of the version that recorded the traffic drives it the same way again from the same network,
demand and seed. The vehicle that became the ego has the name ``EGO`` in the demand, and a parameter
that says when it did.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, parse, tostring

from dosplan.scenario.commonroad.writer import compress

from .traffic import LATERAL_RESOLUTION, STEP

EGO = "egoVehicle"
START = "dosplan.start"
"""Parameter of the ego's vehicle: SUMO's time at which the ego starts, s."""


def sumo_inputs(
    benchmark_id: str, net: Path, demand: Element, seed: int, ego: str, start: float
) -> Mapping[str, bytes]:
    """The files of a scenario.

    Args:
        benchmark_id: Its id.
        net: Its network, which all scenarios of a geometry share.
        demand: Root of the demand that was driven.
        seed: SUMO's seed.
        ego: Name of the vehicle in it that became the ego.
        start: SUMO's time at which the ego starts, s.

    Returns:
        Configuration, demand and network, by the names of their files.
    """
    geometry = benchmark_id.partition("_T-")[0].rpartition("_")[0]
    net_name, demand_name = f"{geometry}.net.xml.gz", f"{benchmark_id}.rou.xml.gz"
    return {
        f"{benchmark_id}.sumo.cfg": tostring(_configuration(net_name, demand_name, seed)),
        demand_name: compress(tostring(_demand(demand, ego, start))),
        # Parsed for what netconvert writes besides: the date, and where it ran.
        net_name: compress(tostring(parse(net).getroot())),  # noqa: S314 - netconvert wrote it
    }


def _configuration(net: str, demand: str, seed: int) -> Element:
    root = Element("configuration")
    for section, options in (
        ("input", {"net-file": net, "route-files": demand}),
        ("time", {"begin": "0", "step-length": str(STEP)}),
        (
            "processing",
            {"lateral-resolution": LATERAL_RESOLUTION, "ignore-route-errors": "true"},
        ),
        ("random_number", {"seed": str(seed)}),
    ):
        parent = SubElement(root, section)
        for name, value in options.items():
            SubElement(parent, name, value=value)
    return root


def _demand(demand: Element, name: str, start: float) -> Element:
    root = deepcopy(demand)
    ego = root.find(f"trip[@id='{name}']")
    if ego is None:
        raise RuntimeError(f"{name} is not in the demand")
    ego.set("id", EGO)
    SubElement(ego, "param", key=START, value=f"{start:.1f}")
    return root
