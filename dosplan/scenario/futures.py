"""Recorded futures of a scenario: what else may happen after one and the same past.

A scenario file holds one recording, which is future 0. A file of its name, ``futures/NAME.npz``,
holds the others: of each only the road users that are not where future 0 has them, and only from
the step after the ego's start on, as up to it all futures are the same to the last bit. Positions
are kept to 1 mm, headings to 1e-4 rad and velocities to 1 mm/s, as dosplan's own scenario files
keep them, so that nobody can tell futures apart by their digits. The numbers are second
differences, which are small where road users move smoothly, and nothing is pickled.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from dosplan.geometry import wrap_angle
from dosplan.scenario.commonroad.document import ScenarioError, read_file
from dosplan.scenario.commonroad.obstacles import MAX_STATES
from dosplan.scenario.sources.futures import futures_file
from dosplan.system.arrays_file import pack, unpack
from dosplan.system.errors import one_line
from dosplan.system.files import write_bytes
from dosplan.types import (
    USER_HEADING,
    USER_SIZE,
    BoolArray,
    FloatArray,
    IntArray,
    RoadUserKind,
    Scenario,
    ShapeError,
    Tracks,
)

MAX_BYTES: Final = 256 * 1024 * 1024
"""Most bytes that such a file may hold when it is unpacked."""
MAX_FUTURES: Final = 1000
"""Most futures that a file may hold."""
_FORMAT: Final = 1
_GRAINS: Final = np.array([1e3, 1e3, 1e4, 1e3])
"""Grains in a unit of each part of a state: m, m, rad, m/s."""
_TURNED: Final = 0.9e-4
"""Angle up to which two headings in grains are the same, be it a full turn further, rad."""
_NO_SIZE: Final = np.zeros(2, dtype=np.int64)


@dataclass(frozen=True)
class _Content:
    """What a file of futures holds.

    Attributes:
        format: Version of this layout.
        recording: Fingerprint of future 0, from which the others are told.
        futures: Number of futures beyond future 0.
        start: The ego's start step; all futures are the same up to it.
        new_ids: (Q,) ids of road users that are not in future 0.
        new_kinds: Their Q kinds.
        new_sizes: (Q, 2) their sizes, mm.
        rows: (R, 4) a row for each road user that a future has elsewhere than future 0: number of
            the future, id, its first step after the start, and for how many steps it is there.
        begins: (R, 2, 4) its state at the first of them, in grains, and the change to the next.
        bends: (4, B) the changes of that change at all further steps, of all rows.
    """

    format: int
    recording: str
    futures: int
    start: int
    new_ids: IntArray
    new_kinds: tuple[RoadUserKind, ...]
    new_sizes: IntArray
    rows: IntArray
    begins: IntArray
    bends: IntArray

    def __post_init__(self) -> None:
        if self.format != _FORMAT:
            raise ShapeError(f"it is of format {self.format}, expected {_FORMAT}")
        if not 1 <= self.futures <= MAX_FUTURES:
            raise ShapeError(f"it holds {self.futures} futures, expected 1 to {MAX_FUTURES}")
        q, r = len(self.new_kinds), len(self.rows)
        shapes = {"new_ids": (q,), "new_sizes": (q, 2), "rows": (r, 4), "begins": (r, 2, USER_SIZE)}
        for name, shape in shapes.items():
            if (found := np.shape(getattr(self, name))) != shape:
                raise ShapeError(f"its {name} has shape {found}, expected {shape}")
        future, _, first, count = self.rows.T
        bent = int(_bent(count).sum())
        if self.bends.shape != (USER_SIZE, bent):
            raise ShapeError(f"its bends has shape {self.bends.shape}, expected {USER_SIZE, bent}")
        if len(np.unique(self.new_ids)) != q or np.any(self.new_sizes <= 0):
            raise ShapeError("it names a new road user twice, or gives it no size")
        if len(np.unique(self.rows[:, :2], axis=0)) != r:
            raise ShapeError("it names a road user twice in one future")
        if np.any((future < 1) | (future > self.futures)):
            raise ShapeError("it names a future beyond those that it holds")
        if np.any((first <= self.start) | (count < 0)):
            raise ShapeError("it holds steps that are not after the start")


def count_futures(scenario: Path) -> int:
    """Counts the recorded futures of a scenario, without reading its recording.

    Args:
        scenario: The scenario file.

    Returns:
        How many there are; 1 where it has no other than its recording.

    Raises:
        ScenarioError: The file of futures is damaged.
    """
    path = futures_file(scenario)
    return 1 if path is None else 1 + _read(path).futures


def with_futures(scenario: Scenario, path: Path) -> Scenario:
    """Reads the other futures of a scenario.

    Args:
        scenario: The scenario as its file has it.
        path: The file of futures.

    Returns:
        The scenario with ``futures``.

    Raises:
        ScenarioError: The file is damaged, or was made for another recording.
    """
    content = _read(path)
    if content.recording != _fingerprint(scenario.tracks):
        raise ScenarioError(
            path,
            f"was made for another recording than the one in the file of {scenario.id}; fetch both "
            "files again, or make them anew together",
        )
    if content.start < scenario.task.start_step:
        raise ScenarioError(
            path,
            f"holds futures that differ from step {content.start + 1} on, before the ego's start "
            f"at step {scenario.task.start_step}; make it anew for this planning problem",
        )
    try:
        return replace(scenario, futures=tuple(_decoded(content, scenario.tracks)))
    except ShapeError as error:
        raise _damaged(path, error) from None


def write_futures(path: Path, scenario: Scenario, futures: Sequence[Tracks]) -> None:
    """Writes the file of a scenario's other futures.

    Args:
        path: The file: ``futures/NAME.npz`` beside the scenario file ``NAME.xml``, or beside its
            folder.
        scenario: The scenario, read from its file.
        futures: See ``pack_futures``.

    Raises:
        ShapeError: See ``pack_futures``.
        FileError: It cannot be written.
    """
    write_bytes(path, pack_futures(scenario, futures))


def pack_futures(scenario: Scenario, futures: Sequence[Tracks]) -> bytes:
    """Packs the other futures of a scenario; equal content gives equal bytes.

    Args:
        scenario: The scenario, read from its file, whose recording is future 0.
        futures: Futures 1, 2, ..., each with all its road users at all steps of the recording. A
            road user has one id, kind and size in all of them; who is in one future only has an id
            of its own.

    Returns:
        The file's content.

    Raises:
        ShapeError: There is no future, one has another number of steps or another past than the
            recording, or a road user changes its kind or size, moves though it is parked, or
            leaves and comes back after the ego's start.
    """
    recording, start = scenario.tracks, scenario.task.start_step
    base = _Grains.of(recording)
    known = {int(name): row for row, name in enumerate(recording.ids)}
    new: dict[int, tuple[RoadUserKind, IntArray]] = {}
    rows: list[tuple[int, int, int, int]] = []
    begins: list[IntArray] = []
    bends = [np.empty((USER_SIZE, 0), dtype=np.int64)]
    for number, tracks in enumerate(futures, start=1):
        if tracks.steps != recording.steps:
            raise ShapeError(
                f"future {number} has {tracks.steps} steps, and the recording {recording.steps}"
            )
        own, there = _Grains.of(tracks), {int(name): i for i, name in enumerate(tracks.ids)}
        for name in dict.fromkeys((*known, *there)):
            was, now = base.user(known.get(name)), own.user(there.get(name))
            same = was.same(now)
            if same.all():
                continue
            if not same[: start + 1].all():
                raise ShapeError(
                    f"road user {name} is elsewhere in future {number} at step "
                    f"{int(np.argmin(same))}; futures differ after the start step {start} only"
                )
            steps = start + 1 + np.flatnonzero(now.valid[start + 1 :])
            if len(steps):
                about = (tracks.kinds[there[name]], now.size)
                if name in known:
                    first = (recording.kinds[known[name]], was.size)
                else:
                    first = new.setdefault(name, about)
                _check_user(f"road user {name}", number, about, first, steps)
            rows.append((number, name, int(steps[0]) if len(steps) else start + 1, len(steps)))
            begin, bend = _encoded(now.states[steps])
            begins.append(begin)
            bends.append(bend)
    names = sorted(new)
    content = _Content(
        format=_FORMAT,
        recording=_fingerprint(recording),
        futures=len(futures),
        start=start,
        new_ids=np.array(names, dtype=np.int64),
        new_kinds=tuple(new[name][0] for name in names),
        new_sizes=_narrowed(np.reshape([new[name][1] for name in names], (-1, 2))),
        rows=np.array(rows, dtype=np.int64).reshape(-1, 4),
        begins=_narrowed(np.reshape(begins, (-1, 2, USER_SIZE))),
        bends=_narrowed(np.concatenate(bends, axis=1)),
    )
    return pack(content, compressed=True)


@dataclass(frozen=True)
class _Grains:
    """Road users in whole grains, as a file keeps them; headings go on over a full turn.

    Attributes:
        states: (..., K, 4) zero where not ``valid``.
        valid: (..., K).
        size: (..., 2) mm.
    """

    states: IntArray
    valid: BoolArray
    size: IntArray

    @classmethod
    def of(cls, tracks: Tracks) -> Self:
        """Those of tracks."""
        return cls(
            states=np.rint(np.where(tracks.valid[..., None], tracks.states, 0.0) * _GRAINS).astype(
                np.int64
            ),
            valid=tracks.valid,
            size=np.rint(1e3 * tracks.size).astype(np.int64),
        )

    def user(self, row: int | None) -> Self:
        """One road user; one that is never there for None."""
        if row is None:
            nowhere = np.zeros(self.valid.shape[1:], dtype=np.bool_)
            return replace(self, states=self.states[:0].sum(axis=0), valid=nowhere, size=_NO_SIZE)
        return replace(self, states=self.states[row], valid=self.valid[row], size=self.size[row])

    def same(self, other: Self) -> BoolArray:
        """(K,) at which steps two road users are in the same place, or both nowhere."""
        apart = self.states - other.states
        turned = wrap_angle(apart[:, USER_HEADING] / _GRAINS[USER_HEADING])
        there = ~np.delete(apart, USER_HEADING, axis=1).any(axis=1) & (np.abs(turned) < _TURNED)
        return np.asarray((self.valid == other.valid) & (there | ~self.valid))


def _check_user(
    name: str,
    future: int,
    about: tuple[RoadUserKind, IntArray],
    known: tuple[RoadUserKind, IntArray],
    steps: IntArray,
) -> None:
    """Checks what holds for a road user in all futures.

    Args:
        name: It in words.
        future: Number of the future.
        about: Its kind and size there.
        known: The same in the futures before.
        steps: Steps after the start at which it is there.
    """
    if about[0] is not known[0] or not np.array_equal(about[1], known[1]):
        raise ShapeError(f"{name} has another kind or size in future {future} than before")
    if not about[0].moves:
        raise ShapeError(f"{name} is {about[0]} and moves in future {future}; call it a car")
    if steps[-1] - steps[0] >= len(steps):
        raise ShapeError(f"{name} leaves and comes back in future {future}")


def _encoded(states: IntArray) -> tuple[IntArray, IntArray]:
    """(2, 4) first state and first change, and (4, M - 2) changes of the change, of M states."""
    begin = np.zeros((2, USER_SIZE), dtype=np.int64)
    if len(states):
        heading = np.unwrap(states[:, USER_HEADING] / _GRAINS[USER_HEADING])
        states = states.copy()
        states[:, USER_HEADING] = np.rint(heading * _GRAINS[USER_HEADING])
        begin[: min(len(states), 2)] = states[0], *np.diff(states[:2], axis=0)
    return begin, np.diff(states, n=2, axis=0).T


def _decoded(content: _Content, recording: Tracks) -> Iterator[Tracks]:
    """The futures of a file, 1 first."""
    steps, known = recording.steps, {int(name): i for i, name in enumerate(recording.ids)}
    ids = np.concatenate([recording.ids, content.new_ids])
    if len(np.unique(ids)) != len(ids):
        raise ShapeError("a new road user has the id of another one")
    if content.futures * len(ids) * steps > MAX_STATES:
        raise ShapeError(f"it holds more than {MAX_STATES} states")
    kinds = (*recording.kinds, *content.new_kinds)
    outlines = (*recording.outlines, *(None for _ in content.new_ids))
    size = np.concatenate([recording.size, content.new_sizes / 1e3])
    place = known | {int(name): len(known) + i for i, name in enumerate(content.new_ids)}
    room = ((0, len(content.new_ids)), (0, 0))
    ends = np.cumsum(_bent(content.rows[:, 3]))
    for number in range(1, content.futures + 1):
        states = np.pad(recording.states, (*room, (0, 0)), constant_values=np.nan)
        valid = np.pad(recording.valid, room)
        for i in np.flatnonzero(content.rows[:, 0] == number):
            _, name, first, count = content.rows[i].tolist()
            if name not in place:
                raise ShapeError(f"road user {name} is not in the recording")
            row, end = place[name], int(ends[i])
            if first + count > steps or (count and not kinds[row].moves):
                raise ShapeError(f"road user {name} moves where it cannot")
            states[row, content.start + 1 :], valid[row, content.start + 1 :] = np.nan, False
            bends = content.bends[:, end - max(count - 2, 0) : end]
            states[row, first : first + count] = _unbent(content.begins[i], bends, count)
            valid[row, first : first + count] = True
        here = np.flatnonzero(valid.any(axis=1))
        yield Tracks(
            ids=ids[here],
            kinds=tuple(kinds[row] for row in here),
            size=size[here],
            states=states[here],
            valid=valid[here],
            outlines=tuple(outlines[row] for row in here),
        )


def _unbent(begin: IntArray, bends: IntArray, count: int) -> FloatArray:
    """(M, 4) states of what ``_encoded`` gave of ``count`` states, headings in [-pi, pi)."""
    changes = np.cumsum(np.concatenate([begin[1:], bends.T]), axis=0)
    states = np.cumsum(np.concatenate([begin[:1], changes]), axis=0)[:count] / _GRAINS
    states[:, USER_HEADING] = wrap_angle(states[:, USER_HEADING])
    return np.asarray(states)


def _bent(count: IntArray) -> IntArray:
    """How many numbers ``bends`` has for each row of so many steps."""
    return np.maximum(count - 2, 0)


def _narrowed(values: npt.ArrayLike) -> IntArray:
    """Whole numbers in as few bytes as all of them fit in, of 2, 4 and 8."""
    array = np.asarray(values, dtype=np.int64)
    widest = int(np.abs(array).max(initial=0))
    fits = next(kind for kind in (np.int16, np.int32, np.int64) if widest <= np.iinfo(kind).max)
    return array.astype(fits)


def _fingerprint(tracks: Tracks) -> str:
    """Fingerprints a recording, whose figures are whole grains where its file has as many."""
    grains = _Grains.of(tracks)
    total = sha256(repr([str(kind) for kind in tracks.kinds]).encode())
    for part in (tracks.ids, grains.size, grains.states, grains.valid):
        total.update(np.ascontiguousarray(part, dtype="<i8").tobytes())
    return total.hexdigest()


def _read(path: Path) -> _Content:
    """What a file of futures holds."""
    data = read_file(path)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > MAX_BYTES:
            raise ShapeError(f"it holds {size} bytes, expected {MAX_BYTES} at most")
        return unpack(data, _Content)
    except Exception as error:  # A damaged archive can raise almost anything.
        raise _damaged(path, error) from None


def _damaged(path: Path, error: Exception) -> ScenarioError:
    return ScenarioError(
        path, f"is no file of futures of this version ({one_line(error)}); fetch it again"
    )
