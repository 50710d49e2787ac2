"""Recordings in CommonRoad's format, whatever wrote them, as episodes for planners.

The converters of other data sets write such files, with a planning problem or without one. Of the
problems nothing is taken: the ego and its goal are chosen as for every other data set
(``dosplan.convert.episodes``). What else a file holds goes into the new ones as it stands, and so
does its step; only the time is cut to a window.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from gzip import compress
from itertools import pairwise
from pathlib import Path
from typing import Any, Final
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from dosplan.convert.episodes import RECORDINGS, SCENARIOS, find_episode, problem_of, write
from dosplan.convert.windows import EGO_KIND, Moment, Track
from dosplan.scenario import (
    INTERACTIVE,
    ScenarioError,
    ScenarioRef,
    find_scenarios,
    parse_scenario,
)
from dosplan.scenario.commonroad.document import read_document, read_file
from dosplan.scenario.commonroad.elements import (
    FaultError,
    child,
    identity,
    label,
    middle,
    naming,
    number,
    scalar,
    step,
    whole,
)
from dosplan.scenario.commonroad.obstacles import STANDING, Resampling, recorded
from dosplan.scenario.commonroad.writer import add_problem
from dosplan.types import FloatArray, IntArray

AGREEMENT: Final = (0.8, 1.25)
"""Ways between the recorded positions per way that the recorded velocities tell of."""
_LEAST_WAY: Final = 5.0
"""Ways that are shorter say nothing of that, m: people sway where they stand."""
_DYNAMIC: Final = ("dynamicObstacle", "obstacle")
_SIGNALS: Final = ("initialSignalState", "signalSeries")
_LONGEST_SCENE: Final = 200
"""Characters; files are named by it, and file systems allow 255 bytes."""
_SUFFIX: Final = re.compile(r"_[A-Z]-\d+(-\d+)*$")
"""End of a CommonRoad id, which says how the road users behave."""


@dataclass(frozen=True)
class _Recording:
    """A file of a recording.

    Attributes:
        root: Its root element.
        dt: Its step, s.
        scene: Its benchmark id without what follows the scene's number.
        first: Its first step at which anybody is recorded.
        last: Its last step at which anybody is.
        cars: Those that could become the ego, by obstacle id.
        counts: Number of road users by CommonRoad obstacle type.
        states: Steps and states of each road user in the order of time, by obstacle id.
    """

    root: Element
    dt: float
    scene: str
    first: int
    last: int
    cars: dict[int, Track]
    counts: Counter[str]
    states: dict[int, list[tuple[int, Element]]]

    def xml(self, benchmark_id: str, first: int, last: int, without: int | None = None) -> Element:
        """The file of a window.

        Args:
            benchmark_id: Its id.
            first: Step that becomes step 0.
            last: Last step that belongs to it.
            without: Id of an obstacle that is left out.

        Returns:
            Its root element, which shares parts with this recording's.
        """
        root = Element(self.root.tag, self.root.attrib | {"benchmarkID": benchmark_id})
        for part in self.root:
            if part.tag == "planningProblem":
                continue
            if part.tag == "trafficLight":
                root.append(_light(part, first))
            elif not _is_dynamic(part):
                root.append(part)
            elif (name := identity(part)) != without:
                root.extend(_cut(part, self.states[name], first, last))
        return root

    def episode(self, name: str, ego: int, moment: Moment) -> bytes:
        """The file of a moment, in which a car has become the ego."""
        root = self.xml(name, moment.first, moment.last, ego)
        ids = [int(part.get("id", "")) for part in root.iter() if part.get("id", "").isdecimal()]
        add_problem(root, problem_of(moment), max(ids, default=0) + 1, self.dt)
        return _text(root)


def convert_commonroad(
    source: str | Path,
    out: Path,
    step_seconds: float | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Makes episodes of recordings.

    Files that an earlier conversion of the same recordings left in ``out`` are replaced.

    Args:
        source: The recordings: what ``dosplan.scenario.find_scenarios`` takes.
        out: Folder for ``recordings/`` (each file without its planning problems, from its first
            step on) and ``scenarios/`` (an episode for each car that makes one).
        step_seconds: Length of a step, s, where the files give a wrong one. Velocities then follow
            from the positions.
        progress: Called with the number of files that were read and of all.

    Returns:
        What was made: ``files`` and ``unreadable`` (number of files, and a line for each that
        cannot be used, or is of the same scene as one before), ``tracks`` by CommonRoad obstacle
        type, ``seconds``, ``recordings`` and ``scenarios`` (numbers of files written), and
        ``refused``, the number of moments by why they make no scenario.

    Raises:
        ScenarioError: Nothing is found, or no file can be used.
        FileError: A file cannot be written.
    """
    paths = list(dict.fromkeys(ref.path for ref in find_scenarios(source)))
    tracks: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    scenes: dict[str, Path] = {}
    unreadable: list[ScenarioError] = []
    seconds, scenarios = 0.0, 0
    for done, path in enumerate(paths, start=1):
        try:
            recording = _read(path, step_seconds)
            _claim(scenes, recording.scene, path)
        except ScenarioError as error:
            unreadable.append(error)
        else:
            scenarios += _convert(recording, out, refused)
            tracks += recording.counts
            seconds += recording.dt * (recording.last - recording.first)
        progress(done, len(paths))
    if len(unreadable) == len(paths):
        raise unreadable[0]
    return {
        "files": len(paths),
        "unreadable": [str(error) for error in unreadable],
        "tracks": dict(sorted(tracks.items())),
        "seconds": round(seconds, 1),
        "recordings": len(scenes),
        "scenarios": scenarios,
        "refused": dict(sorted(refused.items())),
    }


def _claim(scenes: dict[str, Path], scene: str, path: Path) -> None:
    """Keeps two files from being written over each other."""
    if scene in scenes:
        raise ScenarioError(
            path,
            f"is of the scene {scene}, as {scenes[scene]} is; convert them into two folders, or "
            "correct the benchmarkID of one",
        )
    scenes[scene] = path


def _convert(recording: _Recording, out: Path, refused: Counter[str]) -> int:
    """Writes the recording and its episodes; gives the number of those."""
    for old in (out / SCENARIOS).glob(f"{recording.scene}_T-*.xml.gz"):
        old.unlink()
    name = f"{recording.scene}_T-1"
    write(out / RECORDINGS, name, _text(recording.xml(name, recording.first, recording.last)))
    written = 0
    for ego, track in recording.cars.items():
        name = f"{recording.scene}_T-{ego}"
        xml = find_episode(track, recording.dt, partial(recording.episode, name, ego), refused)
        if xml is not None:
            write(out / SCENARIOS, name, xml)
            written += 1
    return written


def _read(path: Path, step_seconds: float | None) -> _Recording:
    root = read_document(path, read_file(path)).root
    try:
        if step_seconds is not None:
            root.set("timeStepSize", f"{step_seconds:g}")
        recording = _recording(root, corrected=step_seconds is not None)
        whole_file = recording.xml(recording.scene, recording.first, recording.last)
    except FaultError as error:
        raise ScenarioError(path, str(error)) from None
    # What cannot be driven in shall be told of the file, not of each of its moments.
    text = _text(whole_file)
    content = compress(text) if path.suffix.lower() == ".gz" else text
    if parse_scenario(ScenarioRef(path, ""), content, ego_optional=True).interactive:
        raise ScenarioError(path, INTERACTIVE)
    return recording


def _recording(root: Element, *, corrected: bool) -> _Recording:
    dt = number(root.get("timeStepSize"), "its timeStepSize")
    Resampling.of(dt)  # Which refuses what is no step.
    cars: dict[int, Track] = {}
    states: dict[int, list[tuple[int, Element]]] = {}
    counts = Counter[str]()
    ends: list[int] = []
    ways: list[float] = []
    for element in filter(_is_dynamic, root):
        with naming(label(element)):
            if corrected:
                _derive_velocities(element, dt)
            steps, rows = recorded(element, dt)
            name = identity(element)
            listed = ((step(state), state) for state in _states(element))
            states[name] = sorted(listed, key=lambda pair: pair[0])
            kind = (element.findtext("type") or "").strip()
            counts[kind] += 1
            ends += [int(steps[0]), int(steps[-1])]
            ways += _share(steps, rows, dt)
            if kind == EGO_KIND and (track := _track(element, kind, steps, rows)) is not None:
                cars[name] = track
    if not ends:
        raise FaultError("holds no dynamic obstacle; a recording has some")
    low, high = AGREEMENT
    if ways and not low <= (share := float(np.median(ways))) <= high:
        raise FaultError(
            f"its road users go {share:.2g} times as far as their velocities say at a step of "
            f"{dt:g} s; look up the data set's step and give it with --step SECONDS"
        )
    scene = re.sub(r"[^A-Za-z0-9_.-]", "-", _SUFFIX.sub("", root.get("benchmarkID", "")))
    if len(scene) > _LONGEST_SCENE:
        raise FaultError(f"has a benchmarkID of {len(scene)} characters; shorten it")
    return _Recording(root, dt, scene, min(ends), max(ends), cars, counts, states)


def _is_dynamic(element: Element) -> bool:
    if element.tag not in _DYNAMIC:
        return False
    # In version 2018b an obstacle says so itself.
    return (element.findtext("role") or "dynamic").strip() == "dynamic"


def _states(element: Element) -> Iterator[Element]:
    """The states that count, as ``recorded`` takes them: none of before the initial one."""
    initial = child(element, "initialState")
    yield initial
    yield from (x for x in element.iterfind("trajectory/state") if step(x) > step(initial))


def _share(steps: IntArray, rows: FloatArray, dt: float) -> list[float]:
    """Way between the positions per way of the velocities; none where somebody hardly moves."""
    told = float(np.sum(0.5 * np.abs(rows[1:, 3] + rows[:-1, 3]) * np.diff(steps) * dt))
    gone = float(np.sum(np.hypot(*np.diff(rows[:, :2], axis=0).T)))
    return [gone / max(told, 1e-3)] if gone > _LEAST_WAY else []


def _track(element: Element, kind: str, steps: IntArray, rows: FloatArray) -> Track | None:
    """The longest stretch without a gap; None for a body that is no rectangle."""
    if element.find("shape/rectangle") is None:
        return None
    breaks = [0, *(np.flatnonzero(np.diff(steps) > 1) + 1), len(steps)]
    begin, end = max(pairwise(breaks), key=lambda stretch: stretch[1] - stretch[0])
    states = rows[begin:end].copy()
    states[:, 2] = np.unwrap(states[:, 2])
    size = (scalar(element, "shape/rectangle/length"), scalar(element, "shape/rectangle/width"))
    return Track(str(identity(element)), kind, kind, size, int(steps[begin]), states)


def _derive_velocities(element: Element, dt: float) -> None:
    """Replaces the velocities of an obstacle by what follows from its positions."""
    states = list(_states(element))
    for state in states:
        for old in [x for x in state if x.tag in ("velocity", "velocityY", "acceleration")]:
            state.remove(old)
    steps, rows = recorded(element, dt)
    speeds = dict(zip(steps.tolist(), rows[:, 3], strict=True))
    for state in states:
        SubElement(SubElement(state, "velocity"), "exact").text = f"{speeds[step(state)]:.4f}"


def _cut(
    element: Element, states: list[tuple[int, Element]], first: int, last: int
) -> Iterator[Element]:
    """An obstacle in a window; nothing where it has fewer than two states there.

    One with a single state stays in it where it stands, and else is there at that step alone.
    """
    within = [(at - first, state) for at, state in states if first <= at <= last]
    if len(states) == 1:
        at, state = states[0]
        within = [(max(at - first, 0), state)] if at <= last and _stands(state) else within
    elif len(within) < 2:
        return
    if not within:
        return
    cut = Element(element.tag, element.attrib)
    for part in element:
        if part.tag == "initialState":
            cut.append(_moved("initialState", *within[0]))
        elif part.tag == "trajectory":
            trajectory = SubElement(cut, "trajectory")
            trajectory.extend(_moved("state", at, state) for at, state in within[1:])
        elif part.tag not in _SIGNALS:
            cut.append(part)
    yield cut


def _stands(state: Element) -> bool:
    speed = state.find("velocity")
    return speed is None or abs(middle(speed)) <= STANDING


def _moved(tag: str, at: int, state: Element) -> Element:
    """A state at another step."""
    moved = Element(tag)
    for part in state:
        if part.tag == "time":
            SubElement(SubElement(moved, "time"), "exact").text = str(at)
        else:
            moved.append(part)
    return moved


def _light(element: Element, first: int) -> Element:
    """A traffic light that shows at step 0 what it showed at the first."""
    cycle = element.find("cycle")
    if cycle is None or not first:
        return element
    light = deepcopy(element)
    cycle = child(light, "cycle")
    period = sum(whole(x.text, "the <duration>") for x in cycle.iterfind("cycleElement/duration"))
    offset = cycle.find("timeOffset")
    if offset is None:
        offset = SubElement(cycle, "timeOffset")
        offset.text = "0"
    if period > 0:
        offset.text = str((whole(offset.text, "the <timeOffset>") - first) % period)
    return light


def _text(root: Element) -> bytes:
    return bytes(tostring(root, xml_declaration=True, encoding="utf-8"))
