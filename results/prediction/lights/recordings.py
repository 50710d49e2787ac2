"""Whole recordings of simulated traffic at lights, to train and to select on.

    python results/prediction/lights/recordings.py --seed 11 --count 60 --out lights-train

Roads and traffic are those of ``scenarios/suite.py --split train``, whose kinds with lights take
turns; every road is another one. A file holds everybody for 120 s, more than a cycle of the lights,
where a scenario of the suite holds the ten seconds that are worth driving. Needs SUMO, as the
suite does, and ``scenarios`` on the PYTHONPATH.
"""

from __future__ import annotations

import argparse
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Final

from suitegen.build import CONFIGS_PER_MAP, DENSITIES, Place
from suitegen.commonroad_xml import moment_xml
from suitegen.lanelets import convert
from suitegen.motion import motions
from suitegen.networks import ROAD_KINDS
from suitegen.plain import compile_network
from suitegen.selection import Moment
from suitegen.traffic import EGO_KIND, RECORD_FROM, RECORD_UNTIL, STEP, simulate

from dosplan.scenario.commonroad.drafts import Goal
from dosplan.scenario.commonroad.writer import compress

KINDS: Final = ("Signal", "Arterial", "Grid")
LAST: Final = round((RECORD_UNTIL - RECORD_FROM) / STEP) - 1


def record(place: Place, seed: int) -> bytes | None:
    """Simulates the traffic of a place and writes all of it.

    Args:
        place: The place.
        seed: Seed of the roads and of the traffic.

    Returns:
        The compressed file; None where the road has no lights.
    """
    rng = place.rng(seed, place.map, place.config)
    demand = float(rng.uniform(*DENSITIES[place.density]))
    with tempfile.TemporaryDirectory(prefix="dosplan-lights-") as name:
        folder = Path(name)
        road = ROAD_KINDS[place.kind][1](place.rng(seed, place.map), demand)
        net = compile_network(road.network, folder)
        lanelet_map = convert(net)
        if not lanelet_map.lights:
            return None
        users = motions(simulate(road, net, folder, rng))
    # A file needs a planning problem: the drive of a car that is in the recording as well.
    ego = next(user for user in users if user.trace.kind == EGO_KIND and len(user.states) > 1)
    whole = Moment(
        ego, users, "", first=0, start=ego.first, arrival=ego.last, last=LAST, goal_first=ego.first
    )
    source = f"generated with SUMO {version('eclipse-sumo')}, seed {seed}"
    goal = Goal(length=10.0, width=3.4, heading_window=None, velocity=None)
    return compress(moment_xml(place.benchmark_id, source, road.tags, lanelet_map, whole, goal))


def main() -> None:
    """Writes the recordings that are not there yet."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    kinds = list(ROAD_KINDS)
    number = 0
    while len(list(options.out.iterdir())) < options.count:
        cycle, kind = divmod(number, len(KINDS))
        number += 1
        index = kinds.index(KINDS[kind]) + len(kinds) * CONFIGS_PER_MAP * cycle
        place = Place("train", index)
        path = options.out / f"{place.benchmark_id}.xml.gz"
        if not path.exists() and (content := record(place, options.seed)) is not None:
            path.write_bytes(content)
            print(path.name, f"{len(content) / 1e6:.1f} MB", flush=True)


if __name__ == "__main__":
    main()
