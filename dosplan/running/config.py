"""The configuration of a run, which the run loop, the executors and the workers share."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from dosplan.plugins.loops import choose_loop
from dosplan.plugins.settings import SettingsError
from dosplan.results.manifest import MOST_FUTURES, RunSettings
from dosplan.simulation.settings import LoopSettings
from dosplan.system.errors import DosplanError

SELECTION: Final = ("source", "ids", "only", "sample", "limit", "futures")
"""Settings that say which episodes are driven: a run may grow by scenarios and futures."""
FREE: Final = (*SELECTION, "workers", "cluster", "cache", "solutions")
"""Settings in which two invocations of one run may differ: they do not reach a row. (The same
files by another path are the same source.)"""


class RunError(DosplanError, ValueError):
    """A run that cannot start or go on; the message is one line."""


@dataclass(frozen=True, kw_only=True)
class RunConfig(RunSettings):
    """A run: its settings, and where it goes.

    Attributes:
        out: The run folder.
    """

    out: Path

    @property
    def settings(self) -> RunSettings:
        """What ``run.json`` says of the run; its folder is where that file is."""
        return RunSettings(**{f.name: getattr(self, f.name) for f in fields(RunSettings)})

    def __post_init__(self) -> None:
        if not self.arms or len(set(self.arms)) != len(self.arms):
            raise RunError("arms must name one arm or both, each once")
        if not 0.0 < self.episode_timeout < math.inf:
            raise RunError(
                f"episode_timeout is {self.episode_timeout}; it must be more than 0 and finite"
            )
        for name in ("workers", "limit", "sample", "futures", "memory_limit"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise RunError(f"{name} is {value}; it must be more than 0")
        if self.futures > MOST_FUTURES:
            raise RunError(f"futures is {self.futures}; it must be {MOST_FUTURES} or less")
        if self.seed < 0:
            raise RunError(f"seed is {self.seed}; it must not be negative")
        for name in ("planner_options", "predictor_options", "traffic_options", "loop_options"):
            object.__setattr__(self, name, _plain(getattr(self, name), name))
        try:
            choose_loop(self.loop, self.loop_options)
        except SettingsError as error:
            raise RunError(str(error)) from None

    @property
    def chosen_loop(self) -> LoopSettings:
        """The loop that ``loop`` and ``loop_options`` name."""
        return choose_loop(self.loop, self.loop_options)


def default_folder() -> Path:
    """The folder of a run that names none.

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
