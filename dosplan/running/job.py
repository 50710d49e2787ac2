"""One episode as a worker drives it: a scenario and an arm in, a row and its files out.

Nothing is written here: the runner alone writes, so that an episode may be driven on a machine
that does not see the run folder.

Determinism: a row must not depend on which worker drove it or what that worker drove before.
Plug-ins are kept from episode to episode, as their making is costly, and made anew after a
failure; they are ``reset``, and the global random generators are seeded before plug-ins are made
and for each episode.
"""

from __future__ import annotations

import traceback
from dataclasses import dataclass
from functools import lru_cache

from dosplan.api import Planner, Predictor
from dosplan.plugins.registry import create_planner, create_predictor
from dosplan.results.recording import pack_recording
from dosplan.results.rows import row_line
from dosplan.running.config import RunConfig
from dosplan.scenario import ScenarioRef, load_scenario
from dosplan.scoring.score import failed_score, score
from dosplan.simulation.loop import SimulationConfig, run_episode
from dosplan.system.errors import one_line
from dosplan.system.workers import seed_globals
from dosplan.types import Arm, EpisodeEnd, Score


@dataclass(frozen=True)
class EpisodeResult:
    """What comes back from a worker.

    Attributes:
        row: The row.
        recording: Content of the episode's file, or None where nothing was driven.
        traceback: Traceback of what Python raised, or None where nothing did.
    """

    row: Score
    recording: bytes | None = None
    traceback: str | None = None


def drive_episode(ref: ScenarioRef, arm: Arm, config: RunConfig) -> EpisodeResult:
    """Drives, scores and records one episode.

    Args:
        ref: The scenario.
        arm: The arm.
        config: The run.

    Returns:
        Its row and files. Whatever a plug-in or a scenario file raises becomes a row, too.
    """
    raised: list[BaseException] = []
    try:
        seed_globals(config.seed)
        planner, predictor = _plugins(config)
        seed_globals(config.seed)
        scenario = load_scenario(ref, cached=config.cache)
        simulation = SimulationConfig(replan_every=config.replan_every)
        episode = run_episode(scenario, planner, predictor, arm, simulation, raised.append)
        row = score(scenario, episode)
        row_line(row)  # What is no number is told here, not by the runner when it appends the row.
        recording = pack_recording(scenario, episode)
    except BaseException as error:  # KeyboardInterrupt, too: only a plug-in raises it here.
        _plugins.cache_clear()
        return EpisodeResult(failed_score(ref.id, arm, one_line(error)), traceback=_text(error))
    if episode.end is EpisodeEnd.PLANNER_FAILURE:
        _plugins.cache_clear()
    return EpisodeResult(row, recording, _text(raised[0]) if raised else None)


@lru_cache(maxsize=1)
def _plugins(config: RunConfig) -> tuple[Planner, Predictor]:
    return (
        create_planner(config.planner, config.seed, config.planner_options),
        create_predictor(config.predictor, config.seed, config.predictor_options),
    )


def _text(error: BaseException) -> str:
    text = "".join(traceback.format_exception(error))
    return text.encode(errors="replace").decode()  # A message may hold what UTF-8 cannot.
