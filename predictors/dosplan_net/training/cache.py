"""A memory-mapped cache of training windows, made from recorded scenarios.

A cache is a folder: ``cache.json`` (what it holds, what was left out and why) and one ``.npy``
file for each array of ``WindowCache``. Every recording is first written to a file of its own
below ``shards/``, so that a build that was killed goes on where it stopped. ``cache.json`` is
written last and names the shards; their names are digests of what they were made from.
"""

from __future__ import annotations

import json
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from dosplan.evaluation.groups import SIMULATED
from dosplan.evaluation.met import DrivenPath, Drives, are_met, read_drives
from dosplan.geometry import to_body, wrap_angle
from dosplan.scenario import ScenarioError, ScenarioRef, find_scenarios, load_recording
from dosplan.scenario.futures import with_futures
from dosplan.scenario.sources.futures import futures_file
from dosplan.simulation.settings import IDEAL, LoopSettings, loop_name
from dosplan.simulation.world import watch
from dosplan.system.errors import DosplanError
from dosplan.system.files import write_json
from dosplan.types import Observation, Scenario, Tracks
from dosplan_net.features import HISTORY, HORIZON, cut_map, describe
from dosplan_net.lights import LIGHT_SIZE, describe_lights, find_lights

FORMAT: Final = 2
SEVERAL: Final = 3
"""Format of a cache with several futures of one past, whose scenes have weights."""
SAME_PLACE: Final = 0.05
"""Distance up to which a road user is in the same place in two futures, m."""
EMPTY: Final = ""  # Result of the extraction where no future is recorded.
MIN_FUTURE: Final = 5  # Steps of recorded future that a scene needs.


class CacheError(DosplanError, ValueError):
    """A cache that cannot be built or read; the message is one line."""


@dataclass(frozen=True)
class WindowCache:
    """Every window of a set of recordings; W windows in S scenes of R recordings, P map pieces.

    A scene is one step of a recording; its windows are its road users, row after row. Of a
    recording with several futures a step may be there several times, once for each future in which
    somebody is soon elsewhere than in future 0. Their weights sum to 1: one past counts once,
    however many of its futures are known.

    Attributes:
        scene_start: (S + 1,) first window of each scene, and W.
        scene_recording: (S,) recording of each scene.
        scene_weight: (S,) share of the recording's futures that each scene stands for; 1 where one
            future is recorded.
        pose: (W, 4) x, y relative to the recording's origin, m, heading, rad, velocity, m/s.
        history: (W, HISTORY, 6) see ``SceneFeatures``.
        static: (W, STATIC_SIZE) see ``SceneFeatures``.
        neighbours: (W, NEIGHBOURS) windows of the nearest others, -1 for none.
        pieces: (W, PIECES) map pieces, -1 for none.
        lights: (W, LIGHT_SIZE) the light ahead, see ``lights.describe_lights``.
        moves: (W,) whether the road user can move (it is neither parked nor static).
        future: (W, HORIZON, 3) x, y, m, and heading, rad, in the road user's frame.
        future_valid: (W, HORIZON) whether that is recorded.
        piece_shape: (P, PIECE_POINTS, 3) see ``MapPieces``.
        piece_attributes: (P, PIECE_ATTRIBUTES) see ``MapPieces``.
        piece_pose: (P, 3) see ``MapPieces``, relative to the recording's origin.
        recordings: R names of the files.
        groups: R names of what was recorded together: the place and the number of its map.
        simulated: R flags: whether the traffic is simulated.
        loop: Name of the loop through which the road users were seen.
        digest: SHA-256 of ``cache.json``: another one where the windows were made from anything
            else.
    """

    scene_start: npt.NDArray[np.int64]
    scene_recording: npt.NDArray[np.int64]
    scene_weight: npt.NDArray[np.float32]
    pose: npt.NDArray[np.float32]
    history: npt.NDArray[np.float32]
    static: npt.NDArray[np.float32]
    neighbours: npt.NDArray[np.int32]
    pieces: npt.NDArray[np.int32]
    lights: npt.NDArray[np.float32]
    moves: npt.NDArray[np.bool_]
    future: npt.NDArray[np.float32]
    future_valid: npt.NDArray[np.bool_]
    piece_shape: npt.NDArray[np.float32]
    piece_attributes: npt.NDArray[np.float32]
    piece_pose: npt.NDArray[np.float32]
    recordings: tuple[str, ...]
    groups: tuple[str, ...]
    simulated: tuple[bool, ...]
    loop: str
    digest: str
    _kept: dict[tuple[str, str], Tensor] = field(default_factory=dict, repr=False, compare=False)

    def tensor(self, name: str, device: str = "cpu") -> Tensor:
        """One of the arrays as a tensor; on another device it is kept for the next call.

        Args:
            name: The array.
            device: Where the tensor is to be, as torch names it.

        Returns:
            The tensor; on the CPU it is read from the disk where it is looked at.
        """
        if (name, device) not in self._kept:
            self._kept[name, device] = torch.from_numpy(getattr(self, name)).to(device)
        return self._kept[name, device]

    @property
    def scenes(self) -> int:
        """Number S of scenes."""
        return len(self.scene_recording)

    @classmethod
    def open(cls, folder: Path) -> WindowCache:
        """Maps a cache into memory.

        Args:
            folder: The cache.

        Returns:
            The cache; its arrays are read from the disk where they are looked at.

        Raises:
            CacheError: There is no such cache, it is incomplete or of another format.
        """
        try:
            text = (folder / "cache.json").read_bytes()
            content = json.loads(text)
            several = content["format"] == SEVERAL
            if not several and content["format"] != FORMAT:
                raise CacheError(
                    f"{folder}: cache of format {content['format']}, this version reads {FORMAT}; "
                    "build it again with dosplan data build"
                )
            if "shards" not in content:
                raise CacheError(
                    f"{folder}: not a complete cache of windows (cache.json does not name the "
                    "shards that they are from); build it again with dosplan data build"
                )
            layout = _LAYOUT | (_WEIGHTS if several else {})
            arrays: dict[str, Any] = {
                name: np.load(folder / f"{name}.npy", mmap_mode="c", allow_pickle=False)
                for name in ("scene_start", *layout)
            }
            lengths = {"scene_start": content["scenes"] + 1} | {
                name: content[f"{owner}s"] for name, (owner, _) in layout.items()
            }
            for name, length in lengths.items():
                if len(arrays[name]) != length:
                    raise CacheError(
                        f"{folder}: {name}.npy has {len(arrays[name])} rows where cache.json has "
                        f"{length}; build it again with dosplan data build"
                    )
            if not several:
                arrays["scene_weight"] = np.ones(len(arrays["scene_recording"]), np.float32)
            for name in ("recordings", "groups", "simulated"):
                arrays[name] = tuple(content[name])
            loop = str(content.get("loop", loop_name(IDEAL)))
            return cls(**arrays, loop=loop, digest=sha256(text).hexdigest())
        except CacheError:
            raise
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise CacheError(
                f"{folder}: not a complete cache of windows ({type(error).__name__}: "
                f"{' '.join(str(error).split())}); make one with dosplan data build DIR --out CACHE"
            ) from None


# What a row of each array stands for, and how it is stored.
_SCENE, _WINDOW, _PIECE = "scene", "window", "piece"
_LAYOUT: Final[dict[str, tuple[str, Any]]] = {
    "scene_recording": (_SCENE, np.int64),
    "pose": (_WINDOW, np.float32),
    "history": (_WINDOW, np.float32),
    "static": (_WINDOW, np.float32),
    "neighbours": (_WINDOW, np.int32),
    "pieces": (_WINDOW, np.int32),
    "lights": (_WINDOW, np.float32),
    "moves": (_WINDOW, np.bool_),
    "future": (_WINDOW, np.float32),
    "future_valid": (_WINDOW, np.bool_),
    "piece_shape": (_PIECE, np.float32),
    "piece_attributes": (_PIECE, np.float32),
    "piece_pose": (_PIECE, np.float32),
}
# What a cache with several futures has beside.
_WEIGHTS: Final[dict[str, tuple[str, Any]]] = {"scene_weight": (_SCENE, np.float32)}


@dataclass(frozen=True)
class BuildReport:
    """What a build put into a cache.

    Attributes:
        recordings: Recordings in the cache.
        scenes: Scenes in it.
        windows: Windows in it.
        unreadable: A line for each file that could not be read: its name and why.
        empty: Names of the recordings that are too short for a window.
    """

    recordings: int
    scenes: int
    windows: int
    unreadable: tuple[str, ...]
    empty: tuple[str, ...]


def build_cache(
    sources: Iterable[str | Path],
    out: Path,
    *,
    every: int = 2,
    futures: int = 1,
    loop: LoopSettings = IDEAL,
    seed: int = 0,
    met: Path | None = None,
    workers: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> BuildReport:
    """Extracts the windows of every recording of some sources.

    Args:
        sources: Where the recordings are, as ``dosplan.scenario.find_scenarios`` takes it.
        out: The cache to make; what an interrupted build left there is used.
        every: Steps between two scenes of a recording.
        futures: How many of the recorded futures of a scenario are taken at most.
        loop: The loop through which the road users are seen; what comes is as recorded.
        seed: Seed of the errors of what is seen.
        met: A run of these recordings: only of road users that its ego met (``are_met``) is there
            a future to learn from; the others are there as their neighbours.
        workers: Processes.
        progress: Called with how many recordings are done, and of how many.

    Returns:
        What the cache holds.

    Raises:
        CacheError: Nothing could be extracted, or ``out`` cannot be written.
        FileError: The run ``met`` cannot be read, or is none in recorded traffic.
    """
    everyone = [ref for s in sources for ref in reversed(find_scenarios(s))]
    # One planning problem per recording is enough: the road users are the same.
    refs = sorted({ref.path: ref for ref in everyone}.values(), key=lambda ref: ref.path.name)
    driven = None if met is None else _by_recording(read_drives(met), everyone)
    if driven is not None:
        refs = [ref for ref in refs if ref.path in driven]
        if not refs:
            raise CacheError(f"{met} drove none of these recordings: name those that it drove")
    try:
        (out / "shards").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CacheError(f"{out}: cannot be written ({error.strerror}); name another") from None
    jobs, closed = [], []
    for ref in refs:
        drives = None if driven is None else driven[ref.path]
        try:
            name = _digest(ref.path, every, futures, loop, seed, drives)
        except OSError as error:
            closed.append(f"{ref.path}: cannot be read ({error.strerror}); leave it out")
            continue
        shard = out / "shards" / f"{name}.npz"
        jobs.append(_Job(ref, shard, every, futures, loop, seed, drives))
    answers: list[str | None] = []
    with ProcessPoolExecutor(max_workers=workers) as pool:
        for answer in pool.map(_extract_to, jobs, chunksize=4):
            answers.append(answer)
            progress(len(answers), len(jobs))
    done = list(zip(jobs, answers, strict=True))
    kept = [(job.ref, job.shard) for job, answer in done if answer is None]
    left_out = {
        "unreadable": closed + [answer for _, answer in done if answer],
        "empty": [job.ref.path.name for job, answer in done if answer == EMPTY],
    }
    if not kept:
        why = f"; the first: {left_out['unreadable'][0]}" if left_out["unreadable"] else ""
        raise CacheError(f"no windows in {len(refs)} recordings{why}")
    made: dict[str, Any] = {"every": every, "loop": loop_name(loop)}
    if met is not None:
        made["met"] = met.resolve().name
    return _join(kept, left_out, out, made | ({"futures": futures} if futures > 1 else {}))


class _Job(NamedTuple):
    """A recording whose windows go into a shard."""

    ref: ScenarioRef
    shard: Path
    every: int
    futures: int
    loop: LoopSettings
    seed: int
    drives: Drives | None


def _by_recording(
    drives: Mapping[str, Drives], refs: Iterable[ScenarioRef]
) -> dict[Path, dict[int, list[DrivenPath]]]:
    """The drives of a run by file: of all of a recording's planning problems together."""
    found: dict[Path, dict[int, list[DrivenPath]]] = {}
    for ref in refs:
        for future, paths in drives.get(ref.id, {}).items():
            found.setdefault(ref.path, {}).setdefault(future, []).extend(paths)
    return found


def _digest(
    path: Path, every: int, futures: int, loop: LoopSettings, seed: int, drives: Drives | None
) -> str:
    """Name of a shard: a digest of what its content depends on."""
    key = sha256(f"{FORMAT} {every} {loop} {seed} {path.name} ".encode())
    key.update(path.read_bytes())
    if futures > 1 and (others := futures_file(path)) is not None:
        key.update(f" {futures} ".encode() + others.read_bytes())
    for future, paths in sorted((drives or {}).items()):
        for start, centres in paths:
            key.update(f" {future} {start} ".encode() + centres.tobytes())
    return key.hexdigest()[:24]


def _extract_to(job: _Job) -> str | None:
    """Writes a recording's shard; returns None, why it cannot be read, or ``EMPTY``."""
    ref, shard = job.ref, job.shard
    if _readable(shard):
        return None
    try:
        scenario = load_recording(ref)
        if job.futures > 1 and (others := futures_file(ref.path)) is not None:
            scenario = with_futures(scenario, others)
    except ScenarioError as error:
        return str(error)
    arrays: dict[str, Any] | None = _extract(scenario, job)
    if arrays is None:
        return EMPTY
    part = shard.with_suffix(".part.npz")
    np.savez(part, **arrays)
    part.replace(shard)
    return None


def _readable(shard: Path) -> bool:
    try:
        with np.load(shard, allow_pickle=False) as content:
            return "simulated" in content.files
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return False


def _extract(scenario: Scenario, job: _Job) -> dict[str, npt.NDArray[Any]] | None:
    pieces, index = cut_map(scenario.road_map), find_lights(scenario.road_map)
    parts: dict[str, list[npt.NDArray[Any]]] = {
        name: [] for name, (owner, _) in _LAYOUT.items() if owner == _WINDOW
    }
    counts = [0]
    of: list[tuple[int, int]] = []  # Future and step of each scene.
    others: Counter[int] = Counter()  # Futures beyond 0 that go on by themselves from a step.
    origin = scenario.task.start[:2]
    for number, observation in _watched(scenario, job):
        tracks = scenario.recorded(number)
        row_of = {name: row for row, name in enumerate(tracks.ids.tolist())}
        rows = np.array([row_of[name] for name in observation.ids.tolist()], dtype=np.int64)
        future, future_valid = _future(observation, tracks, rows)
        if not np.any(future_valid[:, MIN_FUTURE - 1]):
            continue
        others[observation.step] += number > 0
        if job.drives is not None:
            paths = job.drives.get(number, ())
            future_valid &= are_met(observation.step, HORIZON, tracks, rows, paths)[:, None]
            if not np.any(future_valid):
                continue
        of.append((number, observation.step))
        features = describe(observation, pieces)
        parts["pose"].append(features.pose - np.array([*origin, 0.0, 0.0]))
        parts["history"].append(features.history)
        parts["static"].append(features.static)
        parts["neighbours"].append(
            np.where(features.neighbours < 0, -1, features.neighbours + counts[-1])
        )
        parts["pieces"].append(features.pieces)
        lights = describe_lights(observation, index) if index else np.zeros((len(rows), LIGHT_SIZE))
        parts["lights"].append(lights)
        parts["moves"].append(observation.moves)
        parts["future"].append(future)
        parts["future_valid"].append(future_valid)
        counts.append(counts[-1] + len(rows))
    if len(counts) == 1:
        return None
    arrays = {name: np.concatenate(part) for name, part in parts.items()}
    arrays["scene_start"] = np.array(counts)
    if job.futures > 1:
        arrays["scene_weight"] = _weights(of, others, _taken(scenario, job))
    arrays["piece_shape"] = pieces.shape
    arrays["piece_attributes"] = pieces.attributes
    arrays["piece_pose"] = pieces.pose - np.array([*origin, 0.0])
    arrays["simulated"] = np.array(SIMULATED in scenario.tags)
    return arrays


def _taken(scenario: Scenario, job: _Job) -> int:
    """How many futures of a scenario are taken."""
    return min(job.futures, 1 + len(scenario.futures))


def _watched(scenario: Scenario, job: _Job) -> Iterator[tuple[int, Observation]]:
    """What is seen in each future, with its number.

    Of a future beyond 0 only the steps after which somebody is soon elsewhere than in future 0:
    after the others the same comes.
    """
    for number in range(_taken(scenario, job)):
        apart = _apart(scenario.tracks, scenario.recorded(number)) if number else None
        for observation in watch(
            scenario, job.every, HISTORY, loop=job.loop, seed=job.seed, future=number
        ):
            soon = slice(observation.step + 1, observation.step + 1 + HORIZON)
            if apart is None or apart[soon].any():
                yield number, observation


def _apart(one: Tracks, other: Tracks) -> npt.NDArray[np.bool_]:
    """(K,) at which steps somebody is elsewhere in one of two futures than in the other."""
    ids = np.union1d(one.ids, other.ids)
    places = np.full((2, len(ids), one.steps, 2), np.inf)
    for place, tracks in zip(places, (one, other), strict=True):
        valid = tracks.valid[..., None]
        place[np.searchsorted(ids, tracks.ids)] = np.where(valid, tracks.states[..., :2], np.inf)
    with np.errstate(invalid="ignore"):
        # NaN, which is not larger, for who is on the scene in neither.
        distance = np.hypot(*np.moveaxis(places[0] - places[1], -1, 0))
    return np.asarray(np.any(distance > SAME_PLACE, axis=0))


def _weights(
    of: Sequence[tuple[int, int]], others: Mapping[int, int], futures: int
) -> npt.NDArray[np.float64]:
    """(S,) weights of the scenes of a recording, of which future and step are given.

    A future that is not one of the ``others`` at a step goes on as future 0 does, which stands for
    it as well.
    """
    return np.array([(1 if number else futures - others[step]) / futures for number, step in of])


def _future(
    observation: Observation, tracks: Tracks, rows: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """(N, HORIZON, 3) future in each road user's frame and (N, HORIZON) whether it is recorded.

    Those of the tracks' rows ``rows``; the frame is at their pose as it is seen.
    """
    columns = observation.step + 1 + np.arange(HORIZON)
    index = np.ix_(rows, np.minimum(columns, tracks.steps - 1))
    valid = tracks.valid[index] & (columns < tracks.steps)
    now = observation.states[:, -1]
    states = np.where(valid[..., None], tracks.states[index][..., :3], now[:, None, :3])
    turned = wrap_angle(states[..., 2] - now[:, None, 2])
    return np.concatenate((to_body(states[..., :2], now[:, :3]), turned[..., None]), axis=-1), valid


def _join(
    kept: list[tuple[ScenarioRef, Path]],
    left_out: dict[str, list[str]],
    out: Path,
    made: dict[str, Any],
) -> BuildReport:
    """Writes the shards one after another into the arrays of a cache."""
    # Where this is cut off, arrays of two builds may lie there: nothing is to be read then.
    (out / "cache.json").unlink(missing_ok=True)
    several = "futures" in made
    layout = _LAYOUT | (_WEIGHTS if several else {})
    writers = {name: _Writer(out / f"{name}.npy", dtype) for name, (_, dtype) in layout.items()}
    starts: list[npt.NDArray[np.int64]] = []
    simulated: list[bool] = []
    first = {_SCENE: 0, _WINDOW: 0, _PIECE: 0}
    for recording, (_, shard) in enumerate(kept):
        with np.load(shard, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
        simulated.append(bool(arrays["simulated"]))
        starts.append(arrays["scene_start"][:-1] + first[_WINDOW])
        arrays["scene_recording"] = np.full(len(starts[-1]), recording)
        for name, owner in (("neighbours", _WINDOW), ("pieces", _PIECE)):
            arrays[name] = np.where(arrays[name] < 0, -1, arrays[name] + first[owner])
        for name, writer in writers.items():
            writer.append(arrays[name])
        for owner, name in ((_SCENE, "scene_recording"), (_WINDOW, "pose"), (_PIECE, "piece_pose")):
            first[owner] += len(arrays[name])
    for writer in writers.values():
        writer.close()
    np.save(out / "scene_start.npy", np.append(np.concatenate(starts), first[_WINDOW]))
    names = [ref.path.name for ref, _ in kept]
    content = {
        "format": SEVERAL if several else FORMAT,
        **made,
        "scenes": first[_SCENE],
        "windows": first[_WINDOW],
        "pieces": first[_PIECE],
        "shards": [shard.stem for _, shard in kept],
        "recordings": names,
        "groups": [recorded_together(name) for name in names],
        "simulated": simulated,
        **left_out,
    }
    write_json(out / "cache.json", content)
    return BuildReport(
        recordings=len(kept),
        scenes=first[_SCENE],
        windows=first[_WINDOW],
        unreadable=tuple(left_out["unreadable"]),
        empty=tuple(left_out["empty"]),
    )


class _Writer:
    """Appends to a ``.npy`` file whose length is known at the end only."""

    def __init__(self, path: Path, dtype: Any) -> None:
        self._file = path.open("wb")
        self._dtype = np.dtype(dtype)
        self._rows = 0
        self._shape: tuple[int, ...] = ()

    def append(self, rows: npt.NDArray[Any]) -> None:
        if not self._rows:
            self._shape = rows.shape[1:]
            self._header()
        self._file.write(np.ascontiguousarray(rows, dtype=self._dtype).tobytes())
        self._rows += len(rows)

    def close(self) -> None:
        self._file.seek(0)
        self._header()
        self._file.close()

    def _header(self) -> None:
        """Writes the header; numpy pads it so that the first length may grow in place."""
        np.lib.format.write_array_header_1_0(
            self._file,
            {
                "descr": np.lib.format.dtype_to_descr(self._dtype),
                "fortran_order": False,
                "shape": (self._rows, *self._shape),
            },
        )


def recorded_together(name: str) -> str:
    """Names what a file was recorded with, from its CommonRoad name.

    Args:
        name: File name, ``USA_US101-10_2_T-1.xml``.

    Returns:
        Place and number of the map, ``USA_US101-10``: cuts of one recording share them.
    """
    return re.split(r"_\d+_|_\d+\.", name.removeprefix("C-"), maxsplit=1)[0]
