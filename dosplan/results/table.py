"""Many runs in one table: each arm of each with its figures, and against one of them.

What was driven in different worlds (traffic, loop, number of futures), or over other scenarios, is
in blocks of its own, since such figures differ for reasons that are not the planner's. In a block
all rows are over the same episodes, so each is compared with the baseline episode by episode, as
``dosplan.results.comparison`` does for two.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

from dosplan.results.comparison import CompareError, Side, compare_rows, named_arm
from dosplan.results.folder import RunFolder
from dosplan.results.intervals import Interval, metric_interval
from dosplan.results.manifest import SCENARIO_FILES, RunManifest
from dosplan.results.paired import Difference
from dosplan.results.rows import UnfinishedError, read_run
from dosplan.results.summary import read_summary
from dosplan.results.sweeps import SweepFolder
from dosplan.scenario.sources.catalogue import source_text
from dosplan.scoring import metrics
from dosplan.scoring.metrics import Metric
from dosplan.system.errors import did_you_mean
from dosplan.system.typed import plain
from dosplan.types import Arm, place_of

COLUMNS: Final = ("success", "collision", "at_fault_collision", "velocity")
"""Names of the metrics that a table shows where no others are asked for."""


class World(NamedTuple):
    """What an arm was driven in.

    Attributes:
        traffic: Who else was on the road, with its options.
        loop: The loop of the ego.
        futures: Number of futures of each scenario.
    """

    traffic: str
    loop: str
    futures: int

    @classmethod
    def of(cls, traffic: str, options: Mapping[str, Any], loop: str, futures: int) -> World:
        """Names the world of a run.

        Args:
            traffic: Name of the traffic.
            options: Its options.
            loop: Name of the loop.
            futures: Number of futures of each scenario.

        Returns:
            The world.
        """
        return cls(with_options(traffic, options), loop, futures)

    @property
    def title(self) -> str:
        """The world in a few words."""
        several = f", {self.futures} futures" if self.futures > 1 else ""
        return f"traffic {self.traffic}, loop {self.loop}{several}"


@dataclass(frozen=True)
class Entry:
    """An arm of a run that is to be a row.

    Attributes:
        name: The run, as a table calls it: its name in a sweep, or its folder.
        side: The arm and its rows.
        manifest: What the run is.
        values: Where it is one of a sweep, its values on the axes.
    """

    name: str
    side: Side
    manifest: RunManifest
    values: Mapping[str, str] = field(default_factory=dict)

    @property
    def spec(self) -> str:
        """How the row is named as a baseline: ``RUN:arm``."""
        return f"{self.name}:{self.side.arm.value}"

    @property
    def world(self) -> World:
        """What it was driven in."""
        run = self.manifest
        return World.of(run.traffic, run.config.traffic_options, run.loop, run.config.futures)

    @property
    def driver(self) -> tuple[Any, ...]:
        """What drives, whatever the world."""
        run = self.manifest
        options = (run.config.planner_options, run.config.predictor_options)
        return (self.side.arm, run.planner, run.predictor, run.config.seed, *options)

    @property
    def ranked(self) -> bool:
        """Whether it may be ranked."""
        return self.manifest.config.ranked and self.manifest.reproducible


@dataclass(frozen=True)
class Figure:
    """A figure of an arm.

    Attributes:
        value: The figure; None where no episode has one.
        low: Lower end of its 95 % interval; None where it has none.
        high: Upper end.
    """

    value: float | None
    low: float | None = None
    high: float | None = None

    @classmethod
    def of(cls, found: Interval) -> Figure:
        """Takes over a figure with its interval.

        Args:
            found: The interval, whose ends are NaN where there is none.

        Returns:
            The figure.
        """
        low, high = (None if math.isnan(end) else end for end in (found.low, found.high))
        return cls(found.value, low, high)


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row of a table.

    Attributes:
        run: The run: its name in a sweep, or its folder.
        arm: The arm.
        values: Where it is one of a sweep, the name of its value on each axis.
        planner: Name of the planner, with its version.
        predictor: Name of the predictor, likewise.
        traffic: The traffic, with its options.
        loop: The loop.
        futures: Number of futures of each scenario.
        seed: Seed of everything random.
        ranked: Whether the run may be ranked.
        n: Number of episodes that count.
        places: Number of places they are of.
        figures: The figure of each column, by the metric's name.
        differences: Of each column, this row minus the baseline over the same episodes; empty for
            the baseline itself, and where there is none.
    """

    run: str
    arm: Arm
    values: Mapping[str, str]
    planner: str
    predictor: str
    traffic: str
    loop: str
    futures: int
    seed: int
    ranked: bool
    n: int
    places: int
    figures: Mapping[str, Figure]
    differences: Mapping[str, Difference]

    @property
    def spec(self) -> str:
        """``RUN:arm``."""
        return f"{self.run}:{self.arm.value}"


@dataclass(frozen=True)
class Block:
    """Rows over the same episodes, in one world unless worlds were to be mixed.

    Attributes:
        title: Scenarios and world.
        baseline: What the rows are compared with, ``RUN:arm``; None where nothing is.
        rows: The rows.
        warnings: What speaks against comparing them, each a line.
    """

    title: str
    baseline: str | None
    rows: tuple[Row, ...]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """Runs side by side.

    Attributes:
        columns: Names of the metrics.
        blocks: The rows, by what was driven.
        missing: Names of runs that have no rows here, as they are not finished.
    """

    columns: tuple[str, ...]
    blocks: tuple[Block, ...]
    missing: tuple[str, ...] = ()

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """The metrics of the columns."""
        return tuple(metrics.find_metric(name) for name in self.columns)

    def content(self) -> dict[str, Any]:
        """What JSON holds of it."""
        found: dict[str, Any] = plain(self)
        return found


def make_table(
    specs: Sequence[str],
    *,
    baseline: str | None = None,
    columns: Sequence[str] = COLUMNS,
    across_worlds: bool = False,
) -> Table:
    """Puts runs side by side.

    Args:
        specs: Run folders and folders of sweeps; a run folder may be followed by ``:with_dos`` or
            ``:without_dos``.
        baseline: What the others are compared with, ``RUN`` or ``RUN:arm``, a folder or the name of
            a run of a sweep. In a block that does not hold it, it is what drives alike in that
            world. By default it is in each block the first arm without sets, or the first row.
        columns: Names of metrics.
        across_worlds: Whether to put worlds into one block where the scenarios and futures agree.

    Returns:
        The table.

    Raises:
        CompareError: There is no such metric or baseline, or nothing to show.
        FileError: A folder is not that of a finished run, or of a sweep.
    """
    if odd := [name for name in columns if name not in _names()]:
        raise CompareError(
            f"there is no metric {odd[0]!r}{did_you_mean(odd[0], _names())}; "
            f"choose from {', '.join(_names())}"
        )
    entries, missing = read_entries(specs)
    if not entries:
        raise CompareError(f"no run of {', '.join(specs)} is finished")
    chosen = None if baseline is None else _baseline(entries, baseline)
    blocks = [
        make_block(members, tuple(columns), chosen)
        for members in by_driven(entries, across_worlds=across_worlds)
    ]
    return Table(tuple(columns), tuple(blocks), missing)


def by_driven(entries: Iterable[Entry], *, across_worlds: bool = False) -> list[list[Entry]]:
    """Sorts arms by what they drove.

    Args:
        entries: The arms.
        across_worlds: Whether worlds may mix.

    Returns:
        Those that drove the same scenarios and futures, in one world, together.
    """
    found: dict[Any, list[Entry]] = {}
    for entry in entries:
        driven = frozenset(row.scenario_future for row in entry.side.rows)
        world = () if across_worlds else entry.world
        found.setdefault((driven, world), []).append(entry)
    return list(found.values())


def read_entries(specs: Sequence[str]) -> tuple[list[Entry], tuple[str, ...]]:
    """Reads the arms of runs.

    Args:
        specs: As for ``make_table``.

    Returns:
        The arms, each once, in their order; and the names of runs of sweeps that are not finished.

    Raises:
        CompareError: A run does not hold an arm.
        FileError: A folder is not that of a finished run, or of a sweep.
    """
    found: dict[tuple[Path, Arm], Entry] = {}
    missing: list[str] = []
    for spec in specs:
        path, arm = named_arm(spec)
        sweep = SweepFolder(path)
        if not sweep.record.is_file():
            read = _entries(path, str(path), {})
            if arm is not None and all(entry.side.arm is not arm for entry in read):
                raise CompareError(f"{path} holds no episode of the arm {arm.value}")
        else:
            read = []
            for run in sweep.read():
                path = sweep.run(run)
                try:
                    begun = RunFolder(path).manifest.is_file()
                    own = _entries(path, run.name, run.values) if begun else []
                except UnfinishedError:
                    own = []
                read += own
                if not own:
                    missing.append(run.name)
        for entry in read:
            if arm in (None, entry.side.arm):
                found.setdefault((entry.side.path.resolve(), entry.side.arm), entry)
    # The name of a run of a sweep may be that of a run of another one.
    runs = Counter(name for _, name in {(path, entry.name) for (path, _), entry in found.items()})
    entries = [
        replace(entry, name=str(entry.side.path)) if runs[entry.name] > 1 else entry
        for entry in found.values()
    ]
    return entries, tuple(missing)


def _entries(path: Path, name: str, values: Mapping[str, str]) -> list[Entry]:
    """Each arm of a run."""
    manifest, rows = read_run(path)
    sides = [Side(path, arm, tuple(row for row in rows if row.arm is arm)) for arm in Arm]
    return [Entry(name, side, manifest, values) for side in sides if side.rows]


def with_options(name: str, options: Mapping[str, Any]) -> str:
    """Names a plug-in with its options.

    Args:
        name: Its name.
        options: What was set of it.

    Returns:
        The name, and in brackets the options.
    """
    told = ", ".join(f"{key}={value}" for key, value in sorted(options.items()))
    return f"{name} ({told})" if told else name


def _names() -> list[str]:
    return [metric.name for metric in metrics.METRICS]


def _baseline(entries: Sequence[Entry], spec: str) -> Entry:
    """Finds the baseline among the arms."""
    path, arm = named_arm(spec)
    of_run = [e for e in entries if e.name == str(path) or e.side.path.resolve() == path.resolve()]
    found = [entry for entry in of_run if arm in (None, entry.side.arm)]
    if not found:
        specs = [entry.spec for entry in entries]
        raise CompareError(
            f"the baseline {spec} is none of the runs{did_you_mean(spec, specs)}; the first is "
            f"{specs[0]}"
        )
    if len({entry.side.path for entry in found}) == 1 and len(found) > 1:
        raise CompareError(
            f"the baseline {spec} has two arms; name one, as {spec}:{Arm.WITHOUT_DOS.value}"
        )
    return found[0]


def make_block(
    entries: Sequence[Entry], columns: tuple[str, ...] = COLUMNS, chosen: Entry | None = None
) -> Block:
    """Makes the block of arms that drove the same.

    Args:
        entries: The arms.
        columns: Names of metrics.
        chosen: What the others are compared with, or its like in this world; None for the first arm
            without sets, or the first one.

    Returns:
        The block.
    """
    base: Entry | None = next(
        (entry for entry in entries if entry.side.arm is Arm.WITHOUT_DOS), entries[0]
    )
    if chosen is not None:
        alike = (entry for entry in entries if entry.driver == chosen.driver)
        base = chosen if chosen in entries else next(alike, None)
    sources = _listed(source_text(entry.manifest.config.source) for entry in entries)
    worlds = list(dict.fromkeys(entry.world for entry in entries))
    scenarios = len({row.scenario for row in entries[0].side.rows})
    world = worlds[0].title if len(worlds) == 1 else f"{len(worlds)} worlds"
    return Block(
        title=f"{sources} ({scenarios} scenarios), {world}",
        baseline=None if base is None else base.spec,
        rows=tuple(_row(entry, base, columns) for entry in entries),
        warnings=tuple(_warnings(entries)),
    )


def _warnings(entries: Sequence[Entry]) -> Iterator[str]:
    """Tells of runs whose scenarios have the same ids and other files, or another dosplan."""
    by_traffic: dict[str, Entry] = {}
    for entry in entries:
        run = entry.manifest
        first = by_traffic.setdefault(run.traffic, entry)
        files, others = (one.manifest.digests.get(SCENARIO_FILES) for one in (entry, first))
        if files is not None and others is not None and files != others:
            yield (
                f"{entry.name} and {first.name}: the scenarios have the same ids, and their files "
                "differ or are in another order."
            )
            break
    versions = {entry.manifest.versions.get("dosplan"): entry for entry in entries}
    versions.pop(None, None)
    if len(versions) > 1:
        told = ", ".join(f"{version} ({entry.name})" for version, entry in versions.items())
        yield f"Scored by several versions of dosplan: {told}; see `dosplan score`."


def _row(entry: Entry, base: Entry | None, columns: tuple[str, ...]) -> Row:
    rows = entry.side.rows
    counted = [row for row in rows if row.outcome.of_planner]
    differences: Mapping[str, Difference] = {}
    if base is not None and entry is not base:
        differences = compare_rows(base.side.rows, rows, base.spec, entry.spec).differences
    run, world = entry.manifest, entry.world
    return Row(
        run=entry.name,
        arm=entry.side.arm,
        values=entry.values,
        planner=run.planner,
        predictor=run.predictor,
        traffic=world.traffic,
        loop=world.loop,
        futures=world.futures,
        seed=run.config.seed,
        ranked=entry.ranked,
        n=len(counted),
        places=len({place_of(row.scenario) for row in counted}),
        figures={name: _figure(metrics.find_metric(name), entry) for name in columns},
        differences={name: differences[name] for name in columns if name in differences},
    )


def _figure(metric: Metric, entry: Entry) -> Figure:
    found = metric_interval(metric, entry.side.rows)
    if found is not None:
        return Figure.of(found)
    folder = RunFolder(entry.side.path)  # What has no interval is read where it was summed up.
    return Figure(read_summary(folder).arms[entry.side.arm].get(metric.key))


def _listed(texts: Iterable[str]) -> str:
    return " and ".join(dict.fromkeys(texts))
