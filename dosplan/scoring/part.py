"""The part of an episode that is scored, with what several metrics need to know of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dosplan.scoring.comfort import Comfort
from dosplan.scoring.lanes import DrivenLanes, lanes_of
from dosplan.types import (
    DrivenEpisode,
    FloatArray,
    IntArray,
    Outcome,
    Scenario,
    Signals,
    SolveReport,
    Tracks,
)


@dataclass(frozen=True)
class DrivenPart:
    """Where an ego drove, and what the lights showed.

    Attributes:
        scenario: The scenario.
        start_step: Step of the first state.
        ego: (K + 1, 4) x, y, heading, velocity of the ego's centre.
        signals: The traffic lights as they were, at the steps of the scenario.
    """

    scenario: Scenario
    start_step: int
    ego: FloatArray
    signals: Signals

    @property
    def drove(self) -> bool:
        """Whether a step was driven."""
        return len(self.ego) > 1

    @cached_property
    def lanes(self) -> DrivenLanes:
        """On which lanelets the ego drives."""
        return lanes_of(self.ego, self.scenario.road_map)


def scored_cycles(cycle_steps: IntArray, start_step: int, steps: int) -> IntArray:
    """Finds the planning cycles that a step of the scored drive follows; others may come later.

    Args:
        cycle_steps: (C,) step at which the plan of each cycle begins.
        start_step: Step at which the ego starts.
        steps: Steps of the drive that is scored.

    Returns:
        Their indices.
    """
    return np.flatnonzero(cycle_steps < start_step + steps).astype(np.int64)


@dataclass(frozen=True)
class ScoredPart(DrivenPart):
    """The part of an episode that is scored: from its start to contact, goal or end.

    Attributes:
        episode: The whole episode.
        tracks: The road users as they were driven.
        states: (K + 1, 5) ego states of the part.
        cycles: Indices of the planning cycles that a step of the part follows.
        outcome: Outcome of the episode.
        touched: Rows of the road users that the ego touches at the end.
        at_fault_with: Rows of those of them for whose collision the ego is to blame.
        ride: How comfortable the part is.
        progress: Distance driven along the reference path, m.
        needed_progress: What is expected of that, m (``dosplan.scoring.progress``).
    """

    episode: DrivenEpisode
    tracks: Tracks
    states: FloatArray
    cycles: IntArray
    outcome: Outcome
    touched: tuple[int, ...]
    at_fault_with: tuple[int, ...]
    ride: Comfort
    progress: float
    needed_progress: float

    @property
    def reports(self) -> list[SolveReport]:
        """The planner's reports of ``cycles``."""
        reports = self.episode.reports
        return [reports[cycle] for cycle in self.cycles]


def signals_of(scenario: Scenario, episode: DrivenEpisode) -> Signals:
    """The traffic lights as they were in an episode.

    Args:
        scenario: The scenario.
        episode: What was driven.

    Returns:
        The episode's own lights, or else those of the scenario, at the steps of the scenario.
    """
    return scenario.signals if episode.signals is None else episode.signals
