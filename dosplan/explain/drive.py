"""The drive that is explained: what was recorded of it beside what was scored."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dosplan.results.recording import Recording
from dosplan.scoring.collision import Contact, first_contacts
from dosplan.system.files import FileError
from dosplan.types import EGO_VELOCITY, FloatArray, Outcome, Scenario, Score, Tracks
from dosplan.vehicle import VehicleParameters

_SAME_START = 1e-6  # How far the start of the same file may be off by rounding.


@dataclass(frozen=True)
class Drive:
    """One episode, as far as it was scored.

    Attributes:
        scenario: What was driven.
        row: Its row.
        recording: Its file.

    Raises:
        FileError: The episode was not driven in this scenario, or ended before its row says so.
    """

    scenario: Scenario
    row: Score
    recording: Recording

    def __post_init__(self) -> None:
        start = self.scenario.task.start
        if not np.allclose(self.recording.states[0], start, rtol=0.0, atol=_SAME_START):
            raise FileError(
                f"{self.row.scenario} is not the scenario that the run drove: its ego starts "
                "elsewhere; name the right one with --source"
            )
        recorded = len(self.recording.inputs)
        if not 0 <= self.row.steps <= recorded:
            raise FileError(
                f"the row of {self.row.scenario} counts {self.row.steps} steps, its episode file "
                f"holds {recorded}: one of them is not of this run"
            )

    @property
    def vehicle(self) -> VehicleParameters:
        """The ego."""
        return self.scenario.task.vehicle

    @cached_property
    def tracks(self) -> Tracks:
        """The road users as they were driven."""
        return self.recording.tracks_in(self.scenario)

    @cached_property
    def states(self) -> FloatArray:
        """(K + 1, 5) ego states of the drive that was scored."""
        return self.recording.states[: self.row.steps + 1]

    @cached_property
    def ego(self) -> FloatArray:
        """(K + 1, 4) x, y, heading, velocity of the ego's centre."""
        return np.column_stack([self.vehicle.poses(self.states), self.states[:, EGO_VELOCITY]])

    @property
    def start(self) -> int:
        """Step of the first state."""
        return self.recording.start_step

    @property
    def decisive_step(self) -> int:
        """The step that decided the outcome: of the contact, off the road, or the last one."""
        decided = {
            Outcome.COLLISION: self.row.collision_step,
            Outcome.OUT_OF_BOUNDS: self.row.out_of_bounds_step,
        }.get(self.row.outcome)
        return self.start + self.row.steps if decided is None else decided

    @cached_property
    def contact(self) -> Contact | None:
        """The collision that the row names; None where it names none.

        Raises:
            FileError: The recorded drive does not meet that road user in this scenario.
        """
        step, tracks = self.row.collision_step, self.tracks
        if step is None:
            return None
        for contact in first_contacts(self.ego, self.vehicle.size, tracks, self.start):
            if contact.step == step and int(tracks.ids[contact.user]) == self.row.collision_with:
                return contact
        raise FileError(
            f"the drive that was recorded of {self.row.scenario} does not touch road user "
            f"{self.row.collision_with} at step {step} of the scenario: the file, or dosplan's "
            "scoring, has changed since the run"
        )

    def seconds(self, step: int) -> float:
        """Time of a step since the start, s."""
        return (step - self.start) * self.scenario.dt
