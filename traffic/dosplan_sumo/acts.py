"""What the cast of a scenario does in each of its futures, as a file beside SUMO's others."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dosplan.scenario import ScenarioError
from dosplan.scenario.commonroad.document import read_file, unpacked
from dosplan.scenario.commonroad.writer import compress
from dosplan.scenario.sources.sumo import ACTS, CONFIGURATIONS
from dosplan_sumo.script import Script, read_script, script_json


@dataclass(frozen=True)
class Act:
    """What happens in one future.

    Attributes:
        intention: In a word or two: what the road user who matters does.
        script: What the cast is told, from the branch on.
    """

    intention: str
    script: Script


@dataclass(frozen=True)
class Acts:
    """The futures of a scenario.

    Attributes:
        appearance: SUMO's time from which the prelude counts, s.
        prelude: What the cast is told before the futures part.
        branch: SUMO's time from which the scripts of the futures count, s.
        futures: What happens in each of them.
    """

    appearance: float
    prelude: Script
    branch: float
    futures: tuple[Act, ...]

    def json(self) -> bytes:
        """The content of a file, see ``read_acts``."""
        content = {
            "appearance": self.appearance,
            "prelude": script_json(self.prelude),
            "branch": self.branch,
            "futures": [
                {"intention": act.intention, "script": script_json(act.script)}
                for act in self.futures
            ],
        }
        text = json.dumps(content, separators=(",", ":"), allow_nan=False)
        return compress(text.encode())


def acts_file(configuration: Path) -> Path | None:
    """Finds the file for a configuration of SUMO.

    Args:
        configuration: The configuration.

    Returns:
        The file; None where there is none.
    """
    for ending in CONFIGURATIONS:
        if configuration.name.endswith(ending):
            path = configuration.with_name(configuration.name.removesuffix(ending) + ACTS)
            return path if path.is_file() else None
    return None


def read_acts(path: Path) -> Acts:
    """Reads such a file.

    Args:
        path: The file.

    Returns:
        What it holds.

    Raises:
        ScenarioError: It cannot be read, or does not hold the futures of a scenario.
    """
    data = unpacked(path, read_file(path))
    try:
        content: Mapping[str, Any] = json.loads(data)
        acts = Acts(
            appearance=float(content["appearance"]),
            prelude=read_script(content["prelude"]),
            branch=float(content["branch"]),
            futures=tuple(
                Act(str(future["intention"]), read_script(future["script"]))
                for future in content["futures"]
            ),
        )
        if not acts.futures:
            raise ValueError("it names no future")
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        text = " ".join(str(error).split())[:200]
        raise ScenarioError(
            path, f"tells no futures of a scenario ({text}); make it anew"
        ) from None
    return acts
