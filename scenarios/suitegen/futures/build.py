"""One scenario from start to finish: a pure function of the seed and its place in the suite."""

from __future__ import annotations

import hashlib
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from dosplan_sumo.script import rounded
from dosplan_sumo.simulator import SumoError

from dosplan.scenario.commonroad.drafts import Header
from dosplan.scenario.commonroad.writer import compress
from dosplan.scenario.sources.sumo import ACTS
from dosplan.scoring.usable import unusable
from dosplan.types import FloatArray
from suitegen.build import LICENCE, SPLITS, TRAIN_MAPS_FROM
from suitegen.futures.files import acts_json, write_scene
from suitegen.futures.kinds import KINDS
from suitegen.futures.scene import Scene, scene_of
from suitegen.futures.simulate import RejectedError, simulate
from suitegen.futures.staging import EGO, Act, Staging
from suitegen.futures.verdict import Rejected, judge
from suitegen.lanelets import convert
from suitegen.plain import NetworkError, compile_network
from suitegen.roads import Rng
from suitegen.sumo_inputs import sumo_inputs

FUTURES = 5
ATTEMPTS = 60
DRAWS = 50
"""How often the futures of a scene are drawn until they hold two intentions."""


@dataclass(frozen=True)
class Place:
    """A scenario's place in the suite.

    Attributes:
        split: A key of ``SPLITS``.
        kind: Code of its kind.
        number: Number among those of its kind, from 1.
    """

    split: str
    kind: str
    number: int

    @property
    def benchmark_id(self) -> str:
        """CommonRoad id."""
        first = TRAIN_MAPS_FROM if self.split == "train" else 0
        return f"ZAM_{self.kind}-{first + self.number}_1_T-1"

    def source(self, seed: int) -> str:
        """The arguments that make it."""
        return f"scenarios/suite.py --split {self.split} --seed {seed}"

    def rng(self, seed: int, attempt: int) -> Rng:
        """The generator of one attempt; other kinds have no say in it."""
        kind = zlib.crc32(self.kind.encode())
        return np.random.default_rng([seed, SPLITS[self.split], kind, self.number, attempt])


def places(split: str, count: int, kinds: Sequence[str]) -> list[Place]:
    """The first places of a suite; kinds take turns.

    Args:
        split: A key of ``SPLITS``.
        count: How many.
        kinds: Codes of kinds.

    Returns:
        The places.
    """
    return [Place(split, kinds[i % len(kinds)], i // len(kinds) + 1) for i in range(count)]


@dataclass(frozen=True)
class Built:
    """A finished scenario.

    Attributes:
        files: Contents by the names of the files, folders included.
        row: Its row of the manifest.
        drives: For each future (K, 4) states of a drive that solves it: centre x, y, m, heading,
            rad, velocity, m/s.
        start: Step of the first of them.
        rejected: Scenes that were rejected before, by reason.
    """

    files: Mapping[str, bytes]
    row: dict[str, str]
    drives: tuple[FloatArray, ...]
    start: int
    rejected: Counter[str]


def attempt_at(place: Place, seed: int, attempt: int) -> Built:
    """Draws one scene for a scenario.

    Args:
        place: The scenario's place in the suite.
        seed: Seed of the suite.
        attempt: Number of the scene among those of this place, from 0.

    Returns:
        The scenario, with no rejections before it.

    Raises:
        RejectedError: The scene is of no use, or SUMO cannot compile its road or drive it.
    """
    with tempfile.TemporaryDirectory(prefix="dosplan-suite-") as name:
        try:
            return _attempt(place, seed, attempt, Path(name))
        except (NetworkError, SumoError) as error:
            raise RejectedError(str(error)) from None


def build(
    place: Place, seed: int, attempt_at: Callable[[Place, int, int], Built] = attempt_at
) -> Built:
    """Builds one scenario.

    Args:
        place: Its place in the suite.
        seed: Seed of the suite.
        attempt_at: Draws a scene, see the function of that name.

    Returns:
        The scenario.

    Raises:
        RuntimeError: Every scene was rejected; another seed will have others.
    """
    rejected: Counter[str] = Counter()
    for attempt in range(ATTEMPTS):
        try:
            return replace(attempt_at(place, seed, attempt), rejected=rejected)
        except RejectedError as reason:
            rejected[str(reason)] += 1
    reasons = ", ".join(f"{reason} ({count})" for reason, count in rejected.most_common())
    raise RuntimeError(f"{place.benchmark_id}: {ATTEMPTS} scenes were rejected: {reasons}")


def _attempt(place: Place, seed: int, attempt: int, folder: Path) -> Built:
    rng = place.rng(seed, attempt)
    staging = KINDS[place.kind].draw(rng)
    acts = _acts(staging, rng)
    net = compile_network(staging.road.network, folder)
    simulated = simulate(staging, acts, net, folder, rng)
    scene = scene_of(simulated, staging.goal_size, rng)
    header = Header(
        place.benchmark_id,
        f"generated with SUMO {version('eclipse-sumo')}, seed {seed}",
        frozenset({*staging.road.tags, "simulated"}),
    )
    scenario = write_scene(folder, header, convert(net), staging, simulated, scene)
    if unusable(scenario) is not None:
        raise RejectedError("nobody could drive it")
    verdict = judge(scenario, scene.drives)
    if isinstance(verdict, Rejected):
        raise RejectedError(verdict.reason)
    name = place.benchmark_id
    files = {
        f"files/{name}.xml.gz": compress((folder / "files" / f"{name}.xml").read_bytes()),
        f"futures/{name}.npz": (folder / "futures" / f"{name}.npz").read_bytes(),
        f"sumo-files/{name}{ACTS}": acts_json(staging, simulated, acts),
    }
    sumo = sumo_inputs(name, net, simulated.demand.root, simulated.seed, EGO, simulated.start_time)
    row = _row(place, seed, acts, scene, verdict.defeats, files)
    files |= {f"sumo-files/{file}": content for file, content in sumo.items()}
    return Built(files, row, verdict.drives, scene.start, Counter())


def _acts(staging: Staging, rng: Rng) -> list[Act]:
    """The futures of a scene: as they are drawn, given that there are two intentions or more."""
    for _ in range(DRAWS):
        acts = [staging.futures(k, rng) for k in range(FUTURES)]
        if len({act.intention for act in acts}) > 1:
            return [replace(act, script=rounded(act.script)) for act in acts]
    raise RejectedError("all futures have one intention")


def _row(
    place: Place,
    seed: int,
    acts: Sequence[Act],
    scene: Scene,
    defeats: str,
    files: Mapping[str, bytes],
) -> dict[str, str]:
    kinds = (motion.trace.kind for name, motion in scene.futures[0].items() if name != EGO)
    users = Counter("car" if kind == EGO else kind for kind in kinds)
    file, futures = (next(name for name in files if name.startswith(f)) for f in ("files", "fut"))
    return {
        "id": place.benchmark_id,
        "file": file,
        "sha256": hashlib.sha256(files[file]).hexdigest(),
        "futures_file": futures,
        "futures_sha256": hashlib.sha256(files[futures]).hexdigest(),
        "kind": KINDS[place.kind].name,
        "futures": str(len(acts)),
        "intentions": "; ".join(act.intention for act in acts),
        "defeats": defeats,
        "duration_s": f"{0.1 * scene.last:.1f}",
        "road_users": " ".join(f"{kind}:{users[kind]}" for kind in sorted(users)),
        "source": place.source(seed),
        "licence": LICENCE,
    }


def drives_csv(suite: Iterable[Built]) -> bytes:
    """The drives that solve a suite as a table, compressed.

    Args:
        suite: The scenarios.

    Returns:
        A row for each state: id, future, step, centre x and y, m, heading, rad, and velocity, m/s.
    """
    lines = ["id,future,step,x,y,heading,velocity"]
    for built in suite:
        for future, drive in enumerate(built.drives):
            lines.extend(
                f"{built.row['id']},{future},{step},{x:.3f},{y:.3f},{heading:.4f},{velocity:.3f}"
                for step, (x, y, heading, velocity) in enumerate(drive, built.start)
            )
    return compress("\n".join([*lines, ""]).encode())
