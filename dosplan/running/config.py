"""What a run is: the one value that the run loop, the executors and the workers share."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from dosplan.system.errors import DosplanError
from dosplan.types import Arm

FREE: Final = ("workers", "source", "cluster", "cache", "solutions")
"""Settings in which two invocations of one run may differ: they do not reach a row. (The source
is known by its scenarios: the same files by another path are the same source.)"""


class RunError(DosplanError, ValueError):
    """A run that cannot start or go on; the message is one line."""


@dataclass(frozen=True)
class RunConfig:
    """What a run is; two runs of one configuration have the same rows but for their timings.

    Attributes:
        out: The run folder.
        source: Where the scenarios are, as ``dosplan.scenario.find_scenarios`` takes it.
        planner: Planner, as ``dosplan.plugins.registry`` finds it.
        predictor: Predictor, likewise.
        planner_options: Keyword arguments of the planner's constructor besides the seed: what
            JSON can hold.
        predictor_options: Those of the predictor's.
        arms: Arms to drive.
        workers: Number of worker processes on this machine.
        limit: Number of scenarios to drive, the first ones; None drives all.
        seed: Seed of everything random.
        replan_every: Steps driven from each plan.
        episode_timeout: Seconds after which an episode counts as hung; the making of the
            planner, where a worker has none yet, is within them.
        memory_limit: Resident memory at which a worker process is ended, MB (10^6 bytes).
        ranked: Whether the run keeps the rules: a predictor that sees the future is refused.
        cluster: Dask scheduler (``tcp://host:port``) or ``local:N``; None drives on this machine.
        cache: Whether parsed scenarios are kept for the next run (``dosplan.scenario.cache``).
        solutions: Whether the run folder gets CommonRoad solutions (``dosplan.results.solutions``).
    """

    out: Path
    source: str = "suite"
    planner: str = "mpc"
    predictor: str = "dos"
    planner_options: Mapping[str, Any] = field(default_factory=dict, hash=False)
    predictor_options: Mapping[str, Any] = field(default_factory=dict, hash=False)
    arms: tuple[Arm, ...] = tuple(Arm)
    workers: int = 1
    limit: int | None = None
    seed: int = 0
    replan_every: int = 1
    episode_timeout: float = 600.0
    memory_limit: int = 4000
    ranked: bool = True
    cluster: str | None = None
    cache: bool = False
    solutions: bool = False

    def __post_init__(self) -> None:
        if not self.arms or len(set(self.arms)) != len(self.arms):
            raise RunError("arms must name one arm or both, each once")
        if not 0.0 < self.episode_timeout < math.inf:
            raise RunError(
                f"episode_timeout is {self.episode_timeout}; it must be more than 0 and finite"
            )
        for name in ("workers", "limit", "replan_every", "memory_limit"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise RunError(f"{name} is {value}; it must be more than 0")
        if self.seed < 0:
            raise RunError(f"seed is {self.seed}; it must not be negative")
        for name in ("planner_options", "predictor_options"):
            object.__setattr__(self, name, _plain(getattr(self, name), name))


def default_folder() -> Path:
    """Where a run goes that names no folder.

    Returns:
        ``runs/<date and time>``.
    """
    return Path("runs") / f"{datetime.now():%Y-%m-%d-%H%M%S}"


def _plain(options: Mapping[str, Any], where: str) -> dict[str, Any]:
    """A copy of options that ``run.json`` gives back as they are, so that a run can go on."""
    plain = {}
    for name, value in options.items():
        try:
            plain[name] = json.loads(json.dumps(value, allow_nan=False))
            if plain[name] != value:
                raise TypeError(f"{value} would come back as {plain[name]}")
        except (TypeError, ValueError, RecursionError) as error:
            raise RunError(
                f"{where}: {name} must be made of finite numbers, texts, lists and mappings of "
                f"texts: {error}"
            ) from None
    return plain
