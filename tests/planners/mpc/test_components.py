"""Sets that are unions: which components the planner keeps out of, and what each costs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dosplan_mpc.components import Components
from dosplan_mpc.config import SetSettings
from dosplan_mpc.planner import MpcPlanner

from dosplan.scenario.synthetic import forking_sets, steady_tracks, straight_scenario
from dosplan.simulation.world import World
from dosplan.types import EGO_VELOCITY, FloatArray, Occupancy
from tests.support.factories import occupancy_at, union_of

STEPS = 30
WAY: FloatArray = np.stack([np.arange(STEPS, dtype=np.float64), np.zeros(STEPS)], axis=1)
SETTINGS = SetSettings()


def car(x: float, y: float, reach: float = 1.0) -> Occupancy:
    return occupancy_at(np.array([[x, y]]), 40, semi_axis=reach)


def near(occupancy: Occupancy, watched: int = SETTINGS.watched) -> Components:
    return Components.near(occupancy, WAY, replace(SETTINGS, watched=watched))


def test_without_unions_the_nearest_road_users_are_kept_at_their_full_price() -> None:
    places = np.array([[10.0, 30.0], [10.0, 5.0], [90.0, 90.0], [15.0, 1.0]])
    found = near(occupancy_at(places, 40, semi_axis=1.0), watched=3)
    assert found.keep.tolist() == [3, 1, 0]
    assert found.price.tolist() == [1.0, 1.0, 1.0]
    assert found.rows.tolist() == [0, 1, 2, 3]


def test_less_likely_components_cost_less_but_not_nothing() -> None:
    found = near(union_of([0.1, 0.6, 0.3], car(10.0, 3.0), car(10.0, 9.0), car(10.0, 6.0)))
    # The components are listed by their weight, and kept by their distance.
    assert found.keep.tolist() == [2, 1, 0]
    assert found.price.tolist() == pytest.approx([SETTINGS.least_price, 0.5, 1.0])
    assert found.sets.centre[found.keep, 0, 1].tolist() == [3.0, 6.0, 9.0]
    assert found.rows.tolist() == [0, 0, 0]


def test_a_component_that_is_never_near_is_left_out_unless_it_is_the_most_likely() -> None:
    beside, far = car(10.0, 4.0), car(10.0, 40.0)
    assert near(union_of([0.7, 0.3], beside, far)).keep.tolist() == [0]
    assert near(union_of([0.3, 0.7], beside, far)).keep.tolist() == [1, 0]
    # What counts is where its set begins.
    assert near(union_of([0.7, 0.3], beside, car(10.0, 40.0, 26.0))).keep.tolist() == [0, 1]


def test_a_component_inside_of_another_goes_over_to_it() -> None:
    small, large = car(10.0, 4.2, 1.0), car(10.0, 4.0, 2.0)
    for first, second, kept in ((small, large, 2.0), (large, small, 2.0)):
        found = near(union_of([0.5, 0.2, 0.3], first, car(10.0, 12.0), second))
        assert found.sets.semi_axes[found.keep, 0, 0].tolist() == [kept, 1.0]
        assert found.price.tolist() == pytest.approx([1.0, 0.25])
    assert len(near(union_of([0.5, 0.5], small, car(10.0, 6.0, 2.0))).keep) == 2
    across = replace(small, heading=small.heading + np.pi / 2.0)
    assert len(near(union_of([0.5, 0.5], across, large)).keep) == 2


def test_road_users_are_watched_not_components() -> None:
    three = [occupancy_at(np.array([[10.0, y], [12.0, y + 2.0]]), 40, 1.0) for y in (3.0, 6.0, 9.0)]
    found = near(union_of([0.4, 0.3, 0.3], *three), watched=1)
    assert found.rows[found.keep].tolist() == [0, 0, 0]


def planned(occupancy: Occupancy) -> FloatArray:
    """Planned speeds of an ego at 10 m/s on a straight road with a car 30 m ahead of it."""
    tracks = steady_tracks([[30.0, 0.0, 0.0, 10.0]])
    scenario = straight_scenario(tracks, velocity=10.0, final_step=80)
    planner = MpcPlanner()
    planner.reset(scenario.task, scenario.road_map, scenario.task.vehicle)
    plan = planner.plan(World(scenario).observation(), occupancy)
    assert not plan.report.status.failed
    return plan.states[:, EGO_VELOCITY]


def test_the_room_between_two_components_is_free() -> None:
    left, right = (car(25.0, y, 1.0) for y in (9.0, -9.0))
    forking = union_of([0.5, 0.5], left, right)
    assert planned(forking).min() > 9.5
    # Their cover bars the road.
    assert planned(replace(forking, union=None)).min() < 7.0


def test_what_is_unlikely_is_braked_for_too() -> None:
    away, ahead = car(25.0, 9.0, 1.0), car(25.0, 0.0, 3.0)
    assert planned(ahead).min() < 5.0
    assert planned(union_of([0.9, 0.1], away, ahead)).min() < 5.0


def test_sets_that_fork_are_planned_with() -> None:
    tracks = steady_tracks([[30.0, -3.5, 0.0, 6.0], [-10.0, -3.5, 0.0, 8.0]])
    scenario = straight_scenario(tracks, velocity=10.0, final_step=80)
    planner = MpcPlanner()
    planner.reset(scenario.task, scenario.road_map, scenario.task.vehicle)
    seen = World(scenario).observation()
    plan = planner.plan(seen, forking_sets(seen))
    assert not plan.report.status.failed
    # Neither branch reaches the ego's lane.
    assert plan.report.active_ids == ()
    np.testing.assert_allclose(plan.states[-1, :2], [30.0, 0.0], atol=0.05)
