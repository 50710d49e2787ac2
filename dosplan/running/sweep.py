"""Many runs out of one file: every combination of planners, predictors, options, loops and so on.

A file of a sweep names what all runs share, and axes with their values::

    base: {source: suite, loop.latency: 0.3, futures: 3}
    axes:
      sets:
        union: {predictor.sets: union}
        free: {predictor.sets: free}
      predictor.coverage: [0.7, 0.9]
    without:
      - {sets: free, predictor.coverage: 0.9}

A value of an axis is a name with settings. Where the axis is itself a setting, a list of values
will do. Settings are those of ``config`` in ``run.json``; options of the planner, predictor,
traffic and loop are written as ``--set`` takes them. Each combination is a run in a folder of its
own, such as ``sets=union,predictor.coverage=0.7``, but for those that agree with an entry of
``without``. Several products stand in a list of ``grids``, each with a base and axes of its own, to
which those of the whole file are added. Where no arms are named, a predictor of points drives one.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any, Final

from dosplan.plugins.registry import find_predictor
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunManifest, RunSettings
from dosplan.results.rows import read_rows
from dosplan.results.sweeps import SweepFolder, SweepRun
from dosplan.running.config import FREE, RunConfig, RunError
from dosplan.running.executor import Executor, LocalExecutor
from dosplan.running.run import describe
from dosplan.system.errors import DosplanError, did_you_mean
from dosplan.system.typed import plain, typed
from dosplan.system.yaml_text import YamlError, read_yaml
from dosplan.types import Arm, Score

_OWNERS: Final = ("planner", "predictor", "traffic", "loop")
_MACHINE: Final = ("workers", "cluster", "cache")  # What the command says, and no file.
_SETTINGS: Final = tuple(
    f.name
    for f in fields(RunSettings)
    if f.name not in (*_MACHINE, *(f"{owner}_options" for owner in _OWNERS))
)
_KEYS: Final = ("base", "axes", "without", "grids")
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*")
_LONGEST: Final = 200  # Of a folder's name: file systems allow 255 bytes.

Settings = Mapping[str, Any]
"""Settings of a run by their names in a file of a sweep."""
_Axes = dict[str, dict[str, Settings]]


class SweepError(DosplanError, ValueError):
    """A sweep that cannot be driven as it is written down; the message is one line."""


@dataclass(frozen=True)
class SweepPart:
    """A run of a sweep, as far as it has come.

    Attributes:
        run: The run.
        config: Its configuration.
        manifest: What it drives.
        rows: Its rows so far.
    """

    run: SweepRun
    config: RunConfig
    manifest: RunManifest
    rows: tuple[Score, ...]

    @property
    def left(self) -> int:
        """Number of episodes that have no row yet."""
        return len(set(self.manifest.episodes) - {row.key for row in self.rows})

    @property
    def seconds(self) -> tuple[float, ...]:
        """How long predicting and planning took in each episode that was driven, s."""
        period = self.config.chosen_loop.period_steps
        return tuple(
            0.001 * row.cycle_ms_p50 * row.steps / period
            for row in self.rows
            if row.cycle_ms_p50 is not None
        )


def read_sweep(path: Path, changes: Settings | None = None) -> tuple[SweepRun, ...]:
    """Reads the file of a sweep.

    Args:
        path: The YAML file.
        changes: Settings that take the place of those of its bases, but not of its axes.

    Returns:
        The runs, in the order of the file, the last axis the quickest.

    Raises:
        SweepError: The file cannot be read or is not that of a sweep.
        RegistryError: A predictor cannot be found.
    """
    try:
        content = _mapping(read_yaml(path), str(path), _KEYS)
    except YamlError as error:
        raise SweepError(str(error)) from None
    base = _mapping(content.get("base"), f"{path}: base")
    axes = _axes(content.get("axes"), f"{path}: axes")
    grids = content.get("grids", [{}])
    if not isinstance(grids, list) or not grids:
        raise SweepError(f"{path}: grids must be a list of mappings of base and axes")
    found: list[tuple[dict[str, str], Settings]] = []
    known: dict[str, set[str]] = {}
    for number, entry in enumerate(grids, start=1):
        where = f"{path}: grid {number}" if "grids" in content else str(path)
        grid = _mapping(entry, where, _KEYS[:2])
        own = _axes(grid.get("axes"), f"{where}: axes")
        if both := sorted(own.keys() & axes.keys()):
            raise SweepError(f"{where}: the axis {both[0]!r} is one of the whole file, too")
        for axis, values in (axes | own).items():
            known.setdefault(axis, set()).update(values)
        shared = base | _mapping(grid.get("base"), f"{where}: base") | dict(changes or {})
        found += _product(shared, axes | own, where)
    left_out = _left_out(content.get("without"), f"{path}: without", known)
    kept = [one for one in found if not any(_agrees(one[0], entry) for entry in left_out)]
    if not kept:
        raise SweepError(f"{path}: without leaves no run")
    runs = tuple(_run(values, settings, str(path)) for values, settings in kept)
    name, count = Counter(run.name for run in runs).most_common(1)[0]
    if count > 1:
        raise SweepError(f"{path}: {count} runs are called {name}; give each its own values")
    return runs


def open_sweep(folder: SweepFolder, runs: tuple[SweepRun, ...]) -> None:
    """Makes the folder of a sweep, or checks that the one that is there is of the same sweep.

    A sweep may grow by runs, as a run may by scenarios and futures.

    Args:
        folder: The folder.
        runs: The runs.

    Raises:
        SweepError: The folder holds another sweep, or something else.
        FileError: It cannot be read or written.
    """
    check_sweep(folder, runs)
    folder.write(runs)


def check_sweep(folder: SweepFolder, runs: Sequence[SweepRun]) -> None:
    """Refuses a folder that holds another sweep; writes nothing.

    Args:
        folder: The folder; it need not exist.
        runs: The runs.

    Raises:
        SweepError: The folder holds another sweep, or something else.
        FileError: It cannot be read.
    """
    advice = "nothing was changed. Choose another --out, or undo the change of the file"
    if not folder.record.exists():
        if folder.path.is_dir() and any(folder.path.iterdir()):
            raise SweepError(f"{folder.path} is not empty and holds no sweep; choose another --out")
        return
    wanted = {run.name: run for run in runs}
    for old in folder.read():
        if old.name not in wanted:
            raise SweepError(
                f"{folder.path} holds a sweep with a run {old.name}, which this one leaves out: "
                f"a sweep may grow but not shrink; {advice}"
            )
        there, here = (_identity(run.settings) for run in (old, wanted[old.name]))
        if odd := next((key for key in here if there.get(key) != here[key]), None):
            raise SweepError(
                f"{folder.path} holds a sweep whose run {old.name} has another {odd}; {advice}"
            )


def describe_sweep(
    folder: SweepFolder, runs: Sequence[SweepRun], **machine: Any
) -> list[SweepPart]:
    """Tells what a sweep would drive, and finds what would keep a run of it from starting.

    Args:
        folder: Where it is to be.
        runs: Its runs.
        **machine: ``workers``, ``cluster`` and ``cache`` of ``RunConfig``.

    Returns:
        The runs, as far as they have come.

    Raises:
        SweepError: A run may not start.
        FileError: Rows cannot be read.
    """
    parts = []
    for one in runs:
        try:
            settings = replace(one.settings, **machine)
            config = RunConfig(out=folder.run(one), **vars(settings))
            manifest = describe(config)
        except DosplanError as error:
            raise SweepError(f"run {one.name}: {error}") from error
        rows = read_rows(RunFolder(config.out).rows)
        parts.append(SweepPart(one, config, manifest, tuple(rows)))
    return parts


@contextmanager
def one_executor(workers: int, cluster: str | None) -> Iterator[Executor]:
    """What drives all runs of a sweep: a cluster is connected to, or started, once.

    Args:
        workers: Worker processes on this machine.
        cluster: Address of a Dask scheduler, or ``local:N``; None drives on this machine.

    Yields:
        The executor.

    Raises:
        RunError: There is no such cluster.
    """
    if cluster is None:
        yield LocalExecutor(workers)
        return
    from dosplan.running.dask_cluster import DaskExecutor, kept_cluster  # Optional.

    with kept_cluster(cluster) as address:
        yield DaskExecutor(address)


def _mapping(value: Any, where: str, keys: Sequence[str] = ()) -> dict[str, Any]:
    """A mapping of texts; None is an empty one. With ``keys``, it has no others."""
    if value is None and not keys:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        names = f" of {', '.join(keys)}" if keys else " of names to values"
        raise SweepError(f"{where} is no mapping{names}")
    if keys and (odd := [key for key in value if key not in keys]):
        raise SweepError(
            f"{where} has the unknown key {odd[0]!r}{did_you_mean(odd[0], keys)} "
            f"(keys: {', '.join(keys)})"
        )
    return dict(value)


def _axes(value: Any, where: str) -> _Axes:
    """The settings of each value of each axis."""
    found: _Axes = {}
    for axis, values in _mapping(value, where).items():
        _check_name(axis, f"{where}: the axis")
        own = f"{where}: {axis}"
        if isinstance(values, list):
            _check_setting(axis, f"{own} is a list, and", "write NAME: {setting: value}")
            each: dict[str, Settings] = {_value_name(one, own): {axis: one} for one in values}
            if len(each) < len(values):
                raise SweepError(f"{own} has a value twice")
        else:
            names = values if isinstance(values, dict) else {}
            each = {
                _value_name(name, own): _mapping(settings, f"{own}: {name}")
                for name, settings in names.items()
            }
        if not each:
            raise SweepError(f"{own} has no values; give a list, or names with settings")
        found[axis] = each
    return found


def _value_name(value: Any, where: str) -> str:
    """The name of a value of an axis: a text, a number or a truth value as it is written."""
    if isinstance(value, list | dict) or value is None:
        raise SweepError(f"{where}: {value!r:.60} has no name; write NAME: {{setting: value}}")
    name = value if isinstance(value, str) else json.dumps(value, default=str)
    _check_name(name, f"{where}: the value", "; write NAME: {setting: value}")
    return name


def _check_name(name: str, what: str, advice: str = "") -> None:
    if not _NAME.fullmatch(name):
        raise SweepError(
            f"{what} {name!r:.60} makes no folder's name, which has letters, digits and any of "
            f"_ . + - after the first{advice}"
        )


def _check_setting(name: str, what: str, advice: str) -> None:
    owner, dot, option = name.partition(".")
    if name not in _SETTINGS and not (dot and owner in _OWNERS and option):
        raise SweepError(
            f"{what} {name!r} is no setting of a run{did_you_mean(name, _SETTINGS)}; {advice} "
            f"(settings: {', '.join(_SETTINGS)}, and {', '.join(f'{o}.NAME' for o in _OWNERS)})"
        )


def _product(
    shared: Settings, axes: _Axes, where: str
) -> Iterator[tuple[dict[str, str], Settings]]:
    """The names of the values of each combination, and its settings."""
    if not axes:
        raise SweepError(f"{where} has no axes; name some, each with its values")
    owner: dict[str, str] = {}
    for axis, values in axes.items():
        for name in {name for settings in values.values() for name in settings}:
            if owner.setdefault(name, axis) != axis:
                raise SweepError(f"{where}: the axes {owner[name]} and {axis} both set {name}")
    for chosen in product(*(values.items() for values in axes.values())):
        settings = dict(shared)
        for _, own in chosen:
            settings |= own
        yield dict(zip(axes, (name for name, _ in chosen), strict=True)), settings


def _left_out(
    value: Any, where: str, known: Mapping[str, set[str]]
) -> list[dict[str, frozenset[str]]]:
    """Combinations that are not driven: for some axes, the names of values."""
    if value is None:
        return []
    if not isinstance(value, list):
        raise SweepError(f"{where} must be a list of mappings of axes to values")
    found = []
    for number, entry in enumerate(value, start=1):
        one: dict[str, frozenset[str]] = {}
        for axis, names in _mapping(entry, f"{where} {number}").items():
            if axis not in known:
                raise SweepError(
                    f"{where} {number} names no axis: {axis!r}{did_you_mean(axis, known)}"
                )
            listed = names if isinstance(names, list) else [names]
            one[axis] = frozenset(_value_name(name, f"{where} {number}") for name in listed)
            if odd := sorted(one[axis] - known[axis]):
                raise SweepError(
                    f"{where} {number}: {axis} has no value {odd[0]!r}"
                    f"{did_you_mean(odd[0], known[axis])}"
                )
        if not one:
            raise SweepError(f"{where} {number} names no axis, so it would leave out everything")
        found.append(one)
    return found


def _agrees(values: Mapping[str, str], entry: Mapping[str, frozenset[str]]) -> bool:
    return all(values.get(axis) in names for axis, names in entry.items())


def _run(values: Mapping[str, str], settings: Settings, path: str) -> SweepRun:
    name = ",".join(f"{axis}={value}" for axis, value in values.items())
    where = f"{path}: run {name}"
    if len(name) > _LONGEST:
        raise SweepError(f"{where}: the name has {len(name)} characters, more than {_LONGEST}")
    own: dict[str, Any] = {}
    for key, value in settings.items():
        _check_setting(key, f"{where}:", "see `dosplan run --help`")
        owner, dot, option = key.partition(".")
        if dot:
            own.setdefault(f"{owner}_options", {})[option] = value
        else:
            own[key] = value
    try:
        # A default is no attribute of what ``typed`` makes; ``replace`` writes all of them down.
        settled = replace(typed(own, RunSettings))
        run = SweepRun(name=name, values=values, settings=settled)
        RunConfig(out=Path(name), **vars(run.settings))
    except (ValueError, RunError) as error:
        raise SweepError(f"{where}: {error}") from None
    if "arms" not in own and not find_predictor(run.settings.predictor).has_sets:
        run = replace(run, settings=replace(run.settings, arms=(Arm.WITHOUT_DOS,)))
    return run


def _identity(settings: RunSettings) -> dict[str, Any]:
    """What must agree for two invocations to be one run, as plain values."""
    names = (f.name for f in fields(RunSettings))
    return {name: plain(getattr(settings, name)) for name in names if name not in FREE}
