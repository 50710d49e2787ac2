"""Road users that drive along their recording, and wait where the ego is in their way."""

from __future__ import annotations

import numpy as np

from dosplan.api import NoSettings
from dosplan.simulation.traffic import Replay, RoadUsers, Traffic, empty_tracks
from dosplan.types import USER_HEADING, USER_VELOCITY, FloatArray, Scenario, Tracks

SIGHT = 12.0
"""How far ahead of its front a road user sees the ego in its way, m."""


class ReactiveTraffic(Traffic):
    """All drive along their recording by a clock of their own, which stands behind the ego."""

    name = "reactive-v1"

    def __init__(
        self, *, seed: int = 0, settings: NoSettings = NoSettings(), future: int = 0
    ) -> None:
        """Makes it; nothing is random yet.

        Args:
            seed: Seed of the run.
            settings: There are none.
            future: Which continuation is driven.
        """
        super().__init__(seed=seed, settings=settings, future=future)
        self._recording = empty_tracks(0)

    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        """Begins an episode.

        Args:
            scenario: What is driven.
            first_step: Step at which the ego starts.

        Returns:
            What is recorded until then.
        """
        self._recording, self._vehicle = scenario.tracks, scenario.task.vehicle
        self._held = np.zeros(len(scenario.tracks.ids), dtype=np.int64)  # Steps that each is late.
        return Replay().begin(scenario, first_step)

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        """Moves all on by a step of their recording, or by none.

        Args:
            step: The step that is reached.
            ego: Ego states until then; the one before the last is what the road users have seen.

        Returns:
            The road users on the scene.
        """
        tracks, rows = self._recording, np.arange(len(self._recording.ids))
        last = tracks.steps - 1
        before = np.clip(step - 1 - self._held, 0, last)
        seen = tracks.states[rows, before]
        heading = seen[:, USER_HEADING]
        apart = self._vehicle.centre(ego[-2]) - seen[:, :2]
        ahead = apart[:, 0] * np.cos(heading) + apart[:, 1] * np.sin(heading)
        beside = apart[:, 1] * np.cos(heading) - apart[:, 0] * np.sin(heading)
        reach = 0.5 * (tracks.size + np.asarray(self._vehicle.size))
        blocked = tracks.valid[rows, before] & (ahead > 0.0) & (ahead < reach[:, 0] + SIGHT)
        blocked &= np.abs(beside) < reach[:, 1]
        moves = np.array([kind.moves for kind in tracks.kinds], dtype=np.bool_)
        waits = blocked & moves
        self._held += waits
        at = step - self._held
        present = np.flatnonzero((at <= last) & tracks.valid[rows, np.clip(at, 0, last)])
        states = np.array(tracks.states[present, at[present]])
        states[waits[present], USER_VELOCITY] = 0.0
        return RoadUsers(
            ids=tracks.ids[present],
            kinds=tuple(tracks.kinds[i] for i in present),
            size=tracks.size[present],
            states=states,
            outlines=tuple(tracks.outlines[i] for i in present),
        )
