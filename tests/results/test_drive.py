"""A drive belongs to a scenario, a row and a recording of one episode, wherever it comes from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dosplan.results.drive import Drive
from dosplan.results.recording import SAME_START
from dosplan.scenario.synthetic import straight_scenario
from dosplan.system.files import FileError
from dosplan.types import Scenario
from tests.support.traffic import ShyTraffic, braking_before, followed


@pytest.fixture(scope="module")
def drive() -> Drive:
    return Drive.of(followed(), braking_before(ShyTraffic()))


def _shifted(scenario: Scenario, metres: float, steps: int = 0) -> Scenario:
    task = scenario.task
    start = task.start + np.array([metres, 0.0, 0.0, 0.0, 0.0])
    return replace(scenario, task=replace(task, start=start, start_step=task.start_step + steps))


def test_a_drive_is_of_the_scenario_that_starts_where_it_did(drive: Drive) -> None:
    near = _shifted(drive.scenario, 0.5 * SAME_START)
    assert Drive(drive.row, drive.recording, near).scenario is near
    for other in (
        _shifted(drive.scenario, 2.0 * SAME_START),
        _shifted(drive.scenario, 0.0, steps=1),
        straight_scenario(velocity=1.0),
    ):
        assert not drive.recording.is_of(other)
        with pytest.raises(FileError, match="is not the scenario that the run drove"):
            Drive(drive.row, drive.recording, other)


@pytest.mark.parametrize("steps", [-1, 10**6])
def test_a_row_of_another_episode_is_refused(drive: Drive, steps: int) -> None:
    with pytest.raises(FileError, match=f"counts {steps} steps, its episode file holds"):
        Drive(replace(drive.row, steps=steps), drive.recording, drive.scenario)


def test_what_is_not_there_is_told(drive: Drive) -> None:
    assert drive.episode.tracks is drive.tracks
    alone = Drive(drive.row, drive.recording)
    assert alone.known_tracks is alone.tracks is drive.tracks  # It reacted: its file holds it.
    np.testing.assert_array_equal(alone.ego, drive.ego)
    replayed = Drive(drive.row, replace(drive.recording, tracks=None))
    assert replayed.known_tracks is None
    with pytest.raises(FileError, match="was not found; name its place with --source"):
        _ = replayed.tracks
    with pytest.raises(FileError, match="does not keep all that happened"):
        _ = alone.episode
