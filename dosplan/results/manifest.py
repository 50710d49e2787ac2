"""What a run is: ``run.json``.

A key that is absent from a file has the default of its field: a file of an older version does not
have the keys of a newer one. A key that is not known is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Annotated, Any, Final, Protocol

from msgspec import Meta

from dosplan.results.folder import RunFolder
from dosplan.system.files import FileError, read_json, write_json
from dosplan.system.provenance import Machine
from dosplan.system.typed import plain, typed
from dosplan.types import Arm, EpisodeKey, Score

MOST_FUTURES: Final = 10_000
"""Futures of each scenario that a run may have: a slip of the key shall not fill the memory."""
SCENARIO_FILES: Final = "scenario files"
"""Key of the digest of the scenario files, in the order of the scenarios."""


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """The settings of a run; two runs of the same settings have the same rows except for timings.

    Attributes:
        source: Where the scenarios are, as ``dosplan.scenario.find_scenarios`` takes it; several
            are a list.
        planner: Planner, as ``dosplan.plugins.registry`` finds it.
        predictor: Predictor, likewise.
        traffic: Traffic, likewise.
        planner_options: What was set of the planner's settings: what JSON can hold, see
            ``dosplan.plugins.settings``.
        predictor_options: Likewise of the predictor's.
        traffic_options: Likewise of the traffic's.
        loop: Loop of the ego: ``ideal`` or ``realistic``, see ``loop.md``.
        loop_options: What was set of the loop's settings.
        arms: Arms to drive.
        futures: Number of continuations of each scenario's past that are driven, at most
            10,000.
        workers: Number of worker processes on this machine.
        ids: Ids of the source's scenarios that are driven; none drives all.
        only: Of those, the ones with one of these texts in their id or among their tags
            (``dosplan.scenario.sources.selection``); none drives all.
        sample: Of those, so many by lot, which the seed decides; None drives all.
        limit: Of those, the first ones; None drives all.
        seed: Seed of everything random.
        episode_timeout: Seconds after which an episode counts as hung; the making of the
            planner, where a worker has none yet, is within them.
        memory_limit: Resident memory at which a worker process is ended, MB (10^6 bytes).
        ranked: Whether the run may be ranked: a predictor that sees the future is refused.
        cluster: Dask scheduler (``tcp://host:port``) or ``local:N``; None drives on this machine.
        cache: Whether parsed scenarios are kept for the next run (``dosplan.scenario.cache``).
        solutions: Whether the run folder gets CommonRoad solutions (``dosplan.results.solutions``).
    """

    source: str | tuple[str, ...] = "suite"
    planner: str = "mpc"
    predictor: str = "dos"
    traffic: str = "replay"
    planner_options: Mapping[str, Any] = field(default_factory=dict, hash=False)
    predictor_options: Mapping[str, Any] = field(default_factory=dict, hash=False)
    traffic_options: Mapping[str, Any] = field(default_factory=dict, hash=False)
    loop: str = "ideal"
    loop_options: Mapping[str, Any] = field(default_factory=dict, hash=False)
    arms: tuple[Arm, ...] = tuple(Arm)
    futures: Annotated[int, Meta(ge=1, le=MOST_FUTURES)] = 1
    workers: int = 1
    ids: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    sample: int | None = None
    limit: int | None = None
    seed: int = 0
    episode_timeout: float = 600.0
    memory_limit: int = 4000
    ranked: bool = True
    cluster: str | None = None
    cache: bool = False
    solutions: bool = False


class _HasOptions(Protocol):
    @property
    def planner_options(self) -> Mapping[str, Any]: ...
    @property
    def predictor_options(self) -> Mapping[str, Any]: ...
    @property
    def traffic_options(self) -> Mapping[str, Any]: ...


def named_options(run: _HasOptions) -> dict[str, Any]:
    """What was set of a run's plug-ins.

    Args:
        run: What holds their options.

    Returns:
        Values by dotted names, as ``planner.deadline``.
    """
    plugins = {
        "planner": run.planner_options,
        "predictor": run.predictor_options,
        "traffic": run.traffic_options,
    }
    return {f"{plugin}.{name}": v for plugin, own in plugins.items() for name, v in own.items()}


@dataclass(frozen=True, kw_only=True)
class RunManifest:
    """Content of ``run.json``.

    Attributes:
        config: The settings of the run.
        planner: Name of the planner, with its version.
        predictor: Name of the predictor, likewise.
        traffic: Name of the traffic.
        loop: Name of the loop, with what was changed of it.
        reproducible: Whether the run can be repeated: false where it depends on the
            time that plans took.
        settings: All settings of ``planner``, ``predictor``, ``traffic`` and ``loop``, defaults
            and the plug-ins within them included; as options, they give the same one.
        scenarios: Ids of the scenarios, in their order: with the arms and the futures,
            every episode of the run.
        digests: SHA-256 of the content of the plug-ins' files, weights and scenario files; what
            tells that a run cannot be resumed since they changed.
        started: When the run began, UTC, as ISO 8601.
        versions: Versions of Python, dosplan and the packages that decide figures.
        git_revision: Commit of dosplan's source, with ``-dirty`` where it was changed; null where
            it was not a checkout.
        machine: The machine of the runner.
    """

    config: RunSettings
    planner: str
    predictor: str
    traffic: str = "replay"
    loop: str = "ideal"
    reproducible: bool = True
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    scenarios: tuple[str, ...]
    digests: Mapping[str, str] = field(default_factory=dict)
    started: str = ""
    versions: Mapping[str, str]
    git_revision: str | None = None
    machine: Machine | None = None

    def row(self, found: Score) -> Score:
        """Completes a row by what is the run's: an episode that never began knows nothing of it.

        Args:
            found: The row.

        Returns:
            The row with the run's traffic and loop.
        """
        return replace(found, traffic=self.traffic, loop=self.loop)

    @property
    def episodes(self) -> tuple[EpisodeKey, ...]:
        """Every episode of the run, in the order of its rows."""
        parts = (self.scenarios, self.config.arms, range(self.config.futures))
        return tuple(EpisodeKey(*part) for part in product(*parts))

    @property
    def episodes_per_arm(self) -> int:
        """Number of episodes of each arm."""
        return len(self.scenarios) * self.config.futures


def write_manifest(folder: RunFolder, manifest: RunManifest) -> None:
    """Writes ``run.json``.

    Args:
        folder: The run folder.
        manifest: Its content.

    Raises:
        FileError: It cannot be written.
    """
    write_json(folder.manifest, plain(manifest))


def read_manifest(folder: RunFolder) -> RunManifest:
    """Reads ``run.json``.

    Args:
        folder: The run folder.

    Returns:
        Its content.

    Raises:
        FileError: It is missing, cannot be read or does not describe a run.
    """
    if not folder.manifest.is_file():
        raise FileError(f"{folder.path} is not a run folder: it has no run.json")
    try:
        return typed(read_json(folder.manifest), RunManifest)
    except ValueError as error:
        raise FileError(
            f"{folder.manifest} is not a run.json of this version ({error}); "
            "name another folder, or delete this one"
        ) from None
