"""One episode, wherever it is driven: a scenario and an arm in, a row and its files out.

Nothing is written here: the runner alone writes, so that an episode may be driven on a machine
that does not see the run folder.

Determinism: a row must not depend on which worker drove it or what that worker drove before.
Plug-ins are kept from episode to episode, as their making is costly, and made anew after a
failure; they are ``reset``, and the global random generators are seeded before plug-ins are made
and for each episode.
"""

from __future__ import annotations

import traceback
from bdb import BdbQuit
from dataclasses import dataclass
from typing import NamedTuple

from dosplan.api import OraclePredictor, Planner, Predictor
from dosplan.plugins.registry import (
    PluginKind,
    choose_plugin,
    create_planner,
    create_predictor,
    create_traffic,
)
from dosplan.results.drive import Drive
from dosplan.results.rows import row_line
from dosplan.running.config import RunConfig, RunError
from dosplan.scenario import ScenarioError, ScenarioRef, load_scenario
from dosplan.scoring.score import failed_score
from dosplan.scoring.usable import unusable
from dosplan.simulation.loop import run_episode
from dosplan.simulation.traffic import Traffic
from dosplan.system.errors import one_line
from dosplan.system.folders import folder_kept
from dosplan.system.workers import seed_globals
from dosplan.types import Arm, EpisodeKey, Outcome, Score

Plugins = tuple[Planner, Predictor, Traffic]


class Task(NamedTuple):
    """An episode that is to be driven.

    Attributes:
        ref: The scenario.
        arm: The arm.
        future: Which continuation of the scenario's past.
    """

    ref: ScenarioRef
    arm: Arm
    future: int = 0

    @property
    def key(self) -> EpisodeKey:
        """Which episode of the run it is."""
        return EpisodeKey(self.ref.id, self.arm, self.future)


@dataclass(frozen=True)
class EpisodeResult:
    """What an episode gives.

    Attributes:
        row: The row.
        recording: Content of the episode's file, or None where nothing was driven.
        traceback: Traceback of what Python raised, or None where nothing did.
    """

    row: Score
    recording: bytes | None = None
    traceback: str | None = None


class Session:
    """What a process keeps from one episode of a run to the next: the plug-ins."""

    def __init__(self, config: RunConfig, *, attended: bool = False) -> None:
        """Makes no plug-in yet.

        Args:
            config: The run.
            attended: Whether a person may be at a debugger in this process; leaving it (``q``
                in ``pdb``) then ends the run, as Ctrl-C does.
        """
        self._config = config
        self._attended = attended
        self._plugins: Plugins | None = None

    def check(self, ref: ScenarioRef) -> str | None:
        """Tells whether a scenario can be driven; keeps it in the cache for its drives.

        Args:
            ref: The scenario.

        Returns:
            Its file and why nobody could drive it; None where somebody may.
        """
        try:
            scenario = load_scenario(ref, cached=self._config.cache)
            traffic: type[Traffic] = choose_plugin(
                PluginKind.TRAFFIC, self._config.traffic, self._config.traffic_options
            ).plugin
            found = unusable(scenario) or traffic.refuses(scenario)
        except ScenarioError as error:
            return str(error)
        except Exception as error:  # Caused by the file, not by a planner.
            return unreadable(ref, one_line(error))
        return None if found is None else str(ScenarioError(ref.path, found))

    def drive(self, task: Task) -> EpisodeResult:
        """Drives, scores and records one episode.

        Args:
            task: The episode.

        Returns:
            Its row and files. Whatever a plug-in or a scenario file raises becomes a row, too.

        Raises:
            KeyboardInterrupt: The user interrupts, or a plug-in raises it, which looks the same.
        """
        with folder_kept():
            return self._drive(task)

    def _drive(self, task: Task) -> EpisodeResult:
        config = self._config
        raised: list[BaseException] = []
        # Put back at the end of the episode, unless it failed.
        plugins, self._plugins = self._plugins, None
        try:
            seed_globals(config.seed)
            plugins = plugins or make_plugins(config)
            try:
                plugins = _with_future(plugins, config, task.future)
            except KeyboardInterrupt:
                raise
            except BaseException as error:
                self._end_if_quit(error)
                return failed_result(task.key, error, Outcome.TRAFFIC_FAILURE)
            planner, predictor, traffic = plugins
            seed_globals(config.seed)
            scenario = load_scenario(task.ref, cached=config.cache)
            loop = config.chosen_loop
            episode = run_episode(
                scenario, planner, predictor, task.arm, loop, traffic, raised.append
            )
            done = Drive.of(scenario, episode)
            # A value that is not a number fails here, not when the runner appends the row.
            row_line(done.row)
            recording = done.recording.pack()
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # Not all that a plug-in raises is an Exception.
            self._end_if_quit(error)
            return failed_result(task.key, error)
        for failure in raised:
            self._end_if_quit(failure)
        if not raised:
            self._plugins = plugins
        return EpisodeResult(done.row, recording, _text(raised[0]) if raised else None)

    def _end_if_quit(self, error: BaseException) -> None:
        """Ends the run where a person has left the debugger, whatever was raised from that."""
        cause: BaseException | None = error if self._attended else None
        while cause is not None:
            if isinstance(cause, BdbQuit):
                raise KeyboardInterrupt from error
            cause = cause.__cause__ or cause.__context__


def unreadable(ref: ScenarioRef, what: str) -> str:
    """Says that a file cannot be read, as nobody foresaw it.

    Args:
        ref: The scenario.
        what: What became of it.

    Returns:
        A line as of ``Session.check``.
    """
    return str(ScenarioError(ref.path, f"cannot be read ({what}); leave it out"))


def failed_result(
    key: EpisodeKey, error: BaseException, outcome: Outcome = Outcome.PLANNER_FAILURE
) -> EpisodeResult:
    """The result of an episode that an exception has ended.

    Args:
        key: The episode.
        error: What was raised.
        outcome: Whose failure it is.

    Returns:
        A failed row and the traceback.
    """
    return EpisodeResult(failed_score(key, one_line(error), outcome), traceback=_text(error))


def make_plugins(config: RunConfig) -> Plugins:
    """Makes the plug-ins of a run.

    Args:
        config: The run.

    Returns:
        The planner, the predictor and the traffic.

    Raises:
        RegistryError: One of them cannot be built.
        RunError: The predictor does not predict as far as the planner looks ahead, or is shown a
            recording that the traffic does not follow; or the loop drives further from a plan than
            the planner plans; or the traffic has one future, and several are asked for.
    """
    planner = create_planner(
        config.planner, config.seed, config.planner_options, config.chosen_loop
    )
    predictor = create_predictor(
        config.predictor, config.seed, config.predictor_options, config.chosen_loop
    )
    loop = config.chosen_loop
    period, late = loop.period_steps, loop.latency_steps
    if planner.plan_steps is not None and planner.plan_steps < period + late:
        raise RunError(
            f"planner {planner.name} plans {planner.plan_steps} steps, the loop drives "
            f"{period + late} from the first plan (period {loop.period:g} s, latency "
            f"{loop.latency:g} s); lower loop.period or loop.latency, or plan further"
        )
    if predictor.horizon < planner.look_ahead + late:
        lost = f", of which the loop's latency takes {late}" if late else ""
        raise RunError(
            f"planner {planner.name} looks {planner.look_ahead} steps ahead, predictor "
            f"{predictor.name} predicts {predictor.horizon}{lost}; raise predictor.horizon"
        )
    traffic = create_traffic(config.traffic, config.seed, config.traffic_options)
    if isinstance(predictor, OraclePredictor) and not traffic.as_recorded:
        raise RunError(
            f"predictor {predictor.name} is shown the recording, which the traffic {traffic.name} "
            "departs from; choose another predictor, or the traffic replay"
        )
    if config.futures > 1 and not traffic.has_futures:
        raise RunError(
            f"futures is {config.futures}, and the traffic {traffic.name} has one future only; "
            "leave --futures out, or choose a traffic that has several"
        )
    return planner, predictor, traffic


def _with_future(plugins: Plugins, config: RunConfig, future: int) -> Plugins:
    """The plug-ins with a traffic that drives that future; it is made anew where it is another."""
    planner, predictor, traffic = plugins
    if traffic.future != future:
        traffic = create_traffic(config.traffic, config.seed, config.traffic_options, future=future)
    if traffic.future != future:
        raise RunError(
            f"traffic {traffic.name} was told future {future} and keeps {traffic.future}; have its "
            "constructor hand the future to that of Traffic"
        )
    return planner, predictor, traffic


def _text(error: BaseException) -> str:
    text = "".join(traceback.format_exception(error))
    return text.encode(errors="replace").decode()  # A message may hold what UTF-8 cannot.
