"""Writes a record of SinD as CommonRoad files.

``recordings/`` holds the whole record in pieces without a planning problem: what predictors are
trained and evaluated on. ``scenarios/`` holds an episode for each car that makes one: what
planners drive. The two show the same traffic, so that neither belongs beside the other.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, Final

from dosplan.convert.episodes import RECORDINGS, SCENARIOS, find_episode, problem_of, write
from dosplan.convert.lanelet2 import FIRST_ID, Lanelet2Map, read_lanelet2
from dosplan.convert.sind import Record, find_map, read_record
from dosplan.convert.windows import EGO_KIND, Moment, pieces, present
from dosplan.scenario.commonroad.drafts import Header, LaneletMap, Light, UserDraft
from dosplan.scenario.commonroad.writer import scenario_xml
from dosplan.types import STEP_SECONDS

USER_IDS: Final = 100_001
"""CommonRoad id of the first track; those of the lights are 1, 2, ..., the columns of the table."""
EPISODES_FROM: Final = 1_001
"""Configuration number of the episode of the first track; pieces have lower ones."""
TAGS: Final = frozenset({"intersection", "urban"})


@dataclass(frozen=True)
class _Source:
    """A record with its map, and the name of the files that are made of it."""

    record: Record
    lanelet_map: Lanelet2Map
    scene: str

    def name(self, configuration: int | str) -> str:
        return f"CHN_{self.scene}-1_{configuration}_T-1"


def convert_sind(
    folder: Path,
    out: Path,
    map_file: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Makes CommonRoad files of a record of SinD.

    Files that an earlier conversion of the same record left in ``out`` are replaced; those of
    other records stay.

    Args:
        folder: The record's folder.
        out: Folder for ``recordings/`` and ``scenarios/``.
        map_file: Its Lanelet2 map; the one in the folder or beside it by default.
        progress: Called with the number of cars that were examined and of all.

    Returns:
        What was made: ``record``, ``map``, ``lanelets``, ``lights``, ``tracks`` by agent type,
        ``seconds``, ``recordings`` and ``scenarios`` (numbers of files), and ``refused``, the
        number of moments by why they make no scenario.

    Raises:
        ScenarioError: The record or its map cannot be used.
        FileError: A file cannot be written.
    """
    path = find_map(folder) if map_file is None else map_file
    lanelet_map = read_lanelet2(path)
    record = read_record(folder)
    source = _Source(record, lanelet_map, _scene(folder))
    for made in (RECORDINGS, SCENARIOS):
        for old in (out / made).glob(f"{source.name('*')}.xml.gz"):
            old.unlink()
    recordings = 0
    for number, first, last in pieces(record.tracks):
        write(out / RECORDINGS, source.name(number), _xml(source, number, first, last, None))
        recordings += 1
    refused: Counter[str] = Counter()
    scenarios = 0
    cars = [(i, track) for i, track in enumerate(record.tracks) if track.kind == EGO_KIND]
    for done, (index, track) in enumerate(cars, start=1):
        xml = find_episode(track, STEP_SECONDS, _episode(source, EPISODES_FROM + index), refused)
        if xml is not None:
            write(out / SCENARIOS, source.name(EPISODES_FROM + index), xml)
            scenarios += 1
        progress(done, len(cars))
    return {
        "record": folder.name,
        "map": path.name,
        "lanelets": len(lanelet_map.lanelets),
        "lights": len(record.lights.names),
        "tracks": dict(Counter(track.label for track in record.tracks)),
        "seconds": round(STEP_SECONDS * max(track.last for track in record.tracks), 1),
        "recordings": recordings,
        "scenarios": scenarios,
        "refused": dict(sorted(refused.items())),
    }


def _scene(folder: Path) -> str:
    """CommonRoad's name of the place: city and record, letters and digits alone."""
    place = folder.resolve()
    record, city = (re.sub(r"[^A-Za-z0-9]", "", name) for name in (place.name, place.parent.name))
    if record.casefold().startswith(city.casefold()):
        city = ""
    return f"{city}{record}" or "SinD"


def _episode(source: _Source, number: int) -> Callable[[Moment], bytes]:
    return lambda moment: _xml(source, number, moment.first, moment.last, moment)


def _xml(source: _Source, number: int, first: int, last: int, moment: Moment | None) -> bytes:
    """The file of a window, with a planning problem where there is a moment."""
    ego = None if moment is None else moment.ego
    users = [
        UserDraft(track.kind, track.size, begin - first, states, id=USER_IDS + index)
        for index, track, begin, states in present(source.record.tracks, first, last)
        if track is not ego
    ]
    return scenario_xml(
        Header(source.name(number), f"SinD, record {source.record.folder.name}", TAGS),
        _map(source, first, last),
        users,
        None if moment is None else problem_of(moment),
    )


def _map(source: _Source, first: int, last: int) -> LaneletMap:
    """The map with the lights as they were in the window.

    The record numbers its lights, but only a picture shows which lanes they are for. So no lanelet
    refers to them, and those without a place in the map are put in the middle of the stop lines.
    """
    lights, places = source.record.lights, source.lanelet_map.lights
    return LaneletMap(
        lanelets=source.lanelet_map.lanelets,
        lights=tuple(
            Light(
                id=number,
                position=places.get(number, source.lanelet_map.middle),
                direction=None,
                cycle=lights.cycle(number - 1, first, last),
            )
            for number in range(1, len(lights.names) + 1)
        ),
        intersections=(),
        free_ids=count(FIRST_ID + len(source.lanelet_map.lanelets)),
    )
