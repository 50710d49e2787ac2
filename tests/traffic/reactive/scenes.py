"""Small scenes for the tests of the reactive traffic."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dosplan_reactive.traffic import ReactiveTraffic

from dosplan.scenario.synthetic import CAR_SIZE, straight_scenario
from dosplan.simulation.traffic import RoadUsers
from dosplan.types import EGO_SIZE, FloatArray, RoadUserKind, Scenario, Tracks

DT = 0.1


def along(
    speeds: Sequence[float] | FloatArray, start: float = 0.0, y: float = 0.0, heading: float = 0.0
) -> FloatArray:
    """States of somebody who drives straight on, at the speed of each step."""
    speed = np.asarray(speeds, dtype=np.float64)
    way = start + DT * np.concatenate([[0.0], np.cumsum(speed[1:])])
    states = np.zeros((len(speed), 4))
    states[:, 0] = way * np.cos(heading) - y * np.sin(heading)
    states[:, 1] = way * np.sin(heading) + y * np.cos(heading)
    states[:, 2], states[:, 3] = heading, speed
    return states


def scene(*users: FloatArray, kinds: Sequence[RoadUserKind] | None = None) -> Scenario:
    """A scenario with these road users; NaN where they are not on the scene."""
    states = np.stack(users)
    valid = ~np.isnan(states[..., 0])
    return straight_scenario(
        Tracks(
            ids=100 + np.arange(len(users)),
            kinds=tuple(kinds or [RoadUserKind.CAR] * len(users)),
            size=np.tile(CAR_SIZE, (len(users), 1)),
            states=states,
            valid=valid,
        )
    )


def ego_at(scenario: Scenario, centres: FloatArray) -> FloatArray:
    """(K, 5) ego states whose rectangle has these (K, 4) centres, headings and velocities."""
    states = np.zeros((len(centres), EGO_SIZE))
    back = scenario.task.vehicle.rear_to_centre
    states[:, 0] = centres[:, 0] - back * np.cos(centres[:, 2])
    states[:, 1] = centres[:, 1] - back * np.sin(centres[:, 2])
    states[:, 3], states[:, 4] = centres[:, 3], centres[:, 2]
    return states


def driven(
    scenario: Scenario, centres: FloatArray, traffic: ReactiveTraffic | None = None
) -> list[RoadUsers]:
    """What is handed over at the steps 1, 2, ..., while the ego drives along its centres."""
    traffic = ReactiveTraffic() if traffic is None else traffic
    traffic.begin(scenario, 0)
    ego = ego_at(scenario, centres)
    return [traffic.step(step, ego[: step + 1]) for step in range(1, len(ego))]


def state(users: RoadUsers, name: int) -> FloatArray:
    """The state of a road user."""
    return np.asarray(users.states[users.ids.tolist().index(name)])


def standing(x: float, y: float = 0.0, heading: float = 0.0, steps: int = 101) -> FloatArray:
    """An ego that stands."""
    return np.tile([x, y, heading, 0.0], (steps, 1))
