"""One scenario from start to finish: a pure function of the seed and its place in the suite."""

from __future__ import annotations

import hashlib
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from itertools import islice
from pathlib import Path

import numpy as np

from dosplan.scenario.commonroad.drafts import Goal
from dosplan.scenario.commonroad.writer import compress
from dosplan.types import FloatArray

from .commonroad_xml import moment_xml
from .lanelets import convert
from .motion import motions
from .networks import ROAD_KINDS
from .plain import compile_network
from .selection import Moment, moments
from .sumo_inputs import sumo_inputs
from .traffic import RECORD_FROM, STEP, simulate
from .verdict import collision_of_constant_speed

SPLITS = {"suite": 0, "train": 1}
CONFIGS_PER_MAP = 2
TRAIN_MAPS_FROM = 500
ATTEMPTS = 60
CANDIDATES = 4
"""Moments of one recording that are checked before the traffic is drawn anew."""
RARE = ("crossing", "merging")
ALL = (*RARE, "leading")
PATIENCE = 8
"""Simulations that are searched for the wanted conflicts before any conflict is accepted."""
DENSITIES = {"dense": (0.85, 1.1), "light": (0.4, 0.6)}
LICENCE = "CC0-1.0"


@dataclass(frozen=True)
class Place:
    """A scenario's place in the suite.

    Attributes:
        split: A key of ``SPLITS``.
        index: Number of the scenario, from 0; road kinds take turns.
    """

    split: str
    index: int

    @property
    def kind(self) -> str:
        """Key of ``ROAD_KINDS``."""
        return list(ROAD_KINDS)[self.index % len(ROAD_KINDS)]

    @property
    def map(self) -> int:
        """Number of the geometry among those of its kind."""
        first = TRAIN_MAPS_FROM if self.split == "train" else 0
        return first + self.index // len(ROAD_KINDS) // CONFIGS_PER_MAP + 1

    @property
    def config(self) -> int:
        """Number of the traffic on that geometry."""
        return self.index // len(ROAD_KINDS) % CONFIGS_PER_MAP + 1

    @property
    def density(self) -> str:
        """``dense`` or ``light``: two of three are dense."""
        return "light" if (self.index + self.index // len(ROAD_KINDS)) % 3 == 2 else "dense"

    @property
    def wants_rare(self) -> bool:
        """Whether conflicts with traffic from the side are searched first: two of three."""
        return (self.index + 2 * (self.index // len(ROAD_KINDS))) % 3 != 0

    @property
    def wants_hard(self) -> bool:
        """Whether moments that the Intelligent Driver Model solves are left out: two of five."""
        return (self.index + 2 * (self.index // len(ROAD_KINDS))) % 5 < 2

    @property
    def benchmark_id(self) -> str:
        """CommonRoad id."""
        return f"ZAM_{self.kind}-{self.map}_{self.config}_T-1"

    def rng(self, seed: int, *more: int) -> np.random.Generator:
        """A separate generator for this road kind and the given numbers."""
        kind = list(ROAD_KINDS).index(self.kind)
        return np.random.default_rng([seed, SPLITS[self.split], kind, *more])


@dataclass(frozen=True)
class Built:
    """A finished scenario.

    Attributes:
        data: The compressed file.
        row: Its row of the manifest.
        drive: (K, 4) states of the recorded drive of the vehicle that was taken out, see
            ``Moment.drive``.
        start: Step of the first of them.
        sumo: What SUMO drives the scenario's traffic from, by the names of the files.
    """

    data: bytes
    row: dict[str, str]
    drive: FloatArray
    start: int
    sumo: Mapping[str, bytes]


def build(place: Place, seed: int) -> Built:
    """Builds one scenario.

    Args:
        place: Its place in the suite.
        seed: Seed of the suite.

    Returns:
        The scenario.

    Raises:
        RuntimeError: No traffic gave an interactive scenario; another seed will.
    """
    road_kind, draw_road = ROAD_KINDS[place.kind]
    with tempfile.TemporaryDirectory(prefix="dosplan-suite-") as name:
        folder = Path(name)
        for attempt in range(ATTEMPTS):
            rng = place.rng(seed, place.map, place.config, attempt)
            demand = float(rng.uniform(*DENSITIES[place.density]))
            road = draw_road(place.rng(seed, place.map), demand)
            net = compile_network(road.network, folder)
            recording = simulate(road, net, folder, rng)
            driven = motions(recording.traces)
            choosy = attempt < PATIENCE
            conflicts = RARE if place.wants_rare and choosy else ALL
            for moment in islice(moments(driven, road.focus, conflicts, rng), CANDIDATES):
                xml = moment_xml(
                    place.benchmark_id,
                    f"generated with SUMO {version('eclipse-sumo')}, seed {seed}",
                    road.tags,
                    convert(net),
                    moment,
                    _goal(moment, rng),
                )
                path = folder / f"{place.benchmark_id}.xml"
                path.write_bytes(xml)
                collision = collision_of_constant_speed(
                    path, moment.drive(), hard=place.wants_hard and choosy
                )
                if collision is not None:
                    defeat = f"{moment.conflict} {collision}"
                    start = RECORD_FROM + (moment.first + moment.start) * STEP
                    sumo = sumo_inputs(
                        place.benchmark_id,
                        net,
                        recording.demand,
                        recording.seed,
                        moment.ego.trace.id,
                        start,
                    )
                    return _built(place, seed, road_kind, moment, compress(xml), defeat, sumo)
    raise RuntimeError(
        f"{place.benchmark_id}: no interactive moment in {ATTEMPTS} simulations; try another seed"
    )


def _goal(moment: Moment, rng: np.random.Generator) -> Goal:
    speed = float(moment.drive()[-1, 3])
    windows = rng.random(2) < (0.4, 0.3)
    return Goal(
        length=max(10.0, 0.8 * speed),
        width=3.4,
        heading_window=0.35 if windows[0] else None,
        velocity=(max(0.0, 0.6 * speed - 2.0), 1.4 * speed + 3.0) if windows[1] else None,
    )


def _built(
    place: Place,
    seed: int,
    road_kind: str,
    moment: Moment,
    data: bytes,
    defeat: str,
    sumo: Mapping[str, bytes],
) -> Built:
    users = Counter("car" if m.trace.kind == "ego" else m.trace.kind for m in moment.others)
    row = {
        "id": place.benchmark_id,
        "file": f"files/{place.benchmark_id}.xml.gz",
        "sha256": hashlib.sha256(data).hexdigest(),
        "road_kind": road_kind,
        "density": place.density,
        "road_users": " ".join(f"{kind}:{users[kind]}" for kind in sorted(users)),
        "duration_s": f"{0.1 * moment.last:.1f}",
        "defeats_constant_speed": defeat,
        "source": f"scenarios/suite.py --split {place.split} --seed {seed}",
        "licence": LICENCE,
    }
    return Built(data, row, moment.drive(), moment.start, sumo)


def drives_csv(suite: Iterable[Built]) -> bytes:
    """The recorded drives of a suite as a table, compressed.

    Args:
        suite: The scenarios.

    Returns:
        A row for each state: id, step, centre x and y, m, heading, rad, and velocity, m/s.
    """
    lines = ["id,step,x,y,heading,velocity"]
    for built in suite:
        for step, (x, y, heading, velocity) in enumerate(built.drive, built.start):
            lines.append(f"{built.row['id']},{step},{x:.3f},{y:.3f},{heading:.4f},{velocity:.3f}")
    return compress("\n".join([*lines, ""]).encode())
