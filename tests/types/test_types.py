"""The value types refuse what they cannot hold, and what they hold cannot be changed."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from dosplan.scenario.synthetic import (
    busy_scenario,
    growing_sets,
    steady_tracks,
    straight_route,
    straight_scenario,
)
from dosplan.simulation.world import World
from dosplan.types import (
    Episode,
    GoalState,
    Observation,
    Occupancy,
    Plan,
    PlanningTask,
    SetUnion,
    ShapeError,
    SolveReport,
    SolveStatus,
    Tracks,
)
from tests.support.factories import occupancy_at, random_union, union_of


def test_arrays_are_read_only_and_the_given_ones_stay_writable() -> None:
    states = np.zeros((3, 5))
    plan = Plan(states=states, inputs=np.zeros((2, 2)))
    with pytest.raises(ValueError, match="read-only"):
        plan.states[0, 0] = 1.0
    with pytest.raises(ValueError, match="WRITEABLE"):
        plan.states.setflags(write=True)
    # A planner that uses its buffer again does not rewrite what was recorded.
    states[0, 0] = 1.0
    assert plan.states[0, 0] == 0.0


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("status", "solved"),
        ("iterations", 2.0),
        ("iterations", -1),
        ("iterations", True),
        ("seconds", np.nan),
        ("seconds", "fast"),
        ("slack", np.inf),
        ("active_ids", [1]),
        ("active_ids", (1.5,)),
        ("fallback", True),
        ("unreachable", False),
    ],
)
def test_report_names_the_field_that_is_no_such_thing(field: str, value: object) -> None:
    with pytest.raises(ShapeError, match=rf"SolveReport\.{field} is .*, expected"):
        SolveReport(**{field: value})  # type: ignore[arg-type]


def test_report_takes_the_numbers_of_numpy_and_a_plan_takes_only_reports() -> None:
    report = SolveReport(SolveStatus.SOLVED, np.int64(3), np.float64(0.1), 0, (np.int64(7),), "x")  # type: ignore[arg-type]
    assert Plan(np.zeros((2, 5)), np.zeros((1, 2)), report).report is report
    with pytest.raises(ShapeError, match=r"Plan\.report is None, expected a SolveReport"):
        Plan(np.zeros((2, 5)), np.zeros((1, 2)), None)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("states", "inputs", "message"),
    [
        (np.zeros((3, 5)), np.zeros((3, 2)), r"Plan.states has shape \(3, 5\), expected \(4, 5\)$"),
        (
            np.zeros((4, 4)),
            np.zeros((3, 2)),
            r"expected \(4, 5\); columns: x and y of the rear axle, steering angle, velocity, h",
        ),
        (np.zeros((3, 4)), np.zeros((2, 2)), r"expected \(3, 5\)"),
        (np.zeros((1, 5)), np.zeros((0, 2)), "needs one step"),
        (np.full((2, 5), np.nan), np.zeros((1, 2)), "Plan.states holds a NaN"),
        (np.zeros((2, 5)), np.full((1, 2), np.inf), "Plan.inputs holds a NaN or an infinite"),
        (np.full((2, 5), -1e200), np.zeros((1, 2)), "Plan.states holds a number beyond 1e\\+09"),
        (np.zeros((2, 5)), [["fast", 0.0]], "not an array of float64"),
    ],
)
def test_plan_names_the_field_and_the_shape(
    states: np.ndarray, inputs: np.ndarray, message: str
) -> None:
    with pytest.raises(ShapeError, match=message):
        Plan(states=states, inputs=inputs)


def test_occupancy_checks_only_what_is_valid() -> None:
    sets = occupancy_at(np.array([[10.0, 0.0]]), 3, semi_axis=1.0)
    centre, valid = np.array(sets.centre), np.array(sets.valid)
    centre[0, 2] = np.nan
    with pytest.raises(ShapeError, match=r"Occupancy\.centre"):
        replace(sets, centre=centre)
    valid[0, 2] = False
    assert replace(sets, centre=centre, valid=valid).horizon == 3


def test_occupancy_refuses_negative_semi_axes() -> None:
    with pytest.raises(ShapeError, match="negative"):
        occupancy_at(np.array([[10.0, 0.0]]), 3, semi_axis=-0.1)
    occupancy_at(np.array([[10.0, 0.0]]), 3, semi_axis=0.0)


def test_without_sets_keeps_everything_but_the_semi_axes() -> None:
    sets = growing_sets(World(busy_scenario(), first_step=40, history=5).observation())
    bare = sets.without_sets()
    assert isinstance(bare, Occupancy)
    assert not bare.semi_axes.any()
    assert sets.semi_axes.all()
    for field in ("ids", "centre", "angle", "valid", "footprint", "heading"):
        np.testing.assert_array_equal(getattr(bare, field), getattr(sets, field))


def with_union(count: int = 3, steps: int = 5) -> tuple[Occupancy, SetUnion]:
    """Two road users whose sets are unions; what they are covered by is of no matter here."""
    union = random_union(np.random.default_rng(0), 2, count, steps, spread=9.0, reach=2.0)
    return replace(occupancy_at(np.zeros((2, 2)), steps, semi_axis=99.0), union=union), union


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("weight", np.full((2, 3), 0.5), r"SetUnion\.weight sums to 1.5 in row 0, expected 1"),
        ("weight", np.tile([1.5, -0.5, 0.0], (2, 1)), r"SetUnion\.weight holds a negative"),
        ("weight", np.full((2, 3), np.nan), r"SetUnion\.weight holds a NaN"),
        ("weight", np.ones((2, 0)), r"SetUnion\.weight has shape \(2, 0\); .* one component"),
        (
            "centre",
            np.zeros((2, 5, 2)),
            r"SetUnion\.centre has shape \(2, 5, 2\), expected \(2, 3,",
        ),
        ("semi_axes", np.zeros((2, 3, 4, 2)), r"SetUnion\.semi_axes .* expected \(2, 3, 5, 2\)"),
        ("angle", np.zeros((2, 3, 5, 1)), r"SetUnion\.angle .* expected \(2, 3, 5\)"),
        ("heading", np.zeros((2, 2, 5)), r"SetUnion\.heading .* expected \(2, 3, 5\)"),
    ],
)
def test_a_union_names_the_field_and_the_shape(field: str, value: np.ndarray, message: str) -> None:
    union = with_union()[1]
    with pytest.raises(ShapeError, match=message):
        replace(union, **{field: value})


def test_occupancy_refuses_a_union_that_is_not_of_its_road_users_and_steps() -> None:
    sets, _ = with_union()
    with pytest.raises(ShapeError, match=r"union is of 2 road users and 4 steps, expected 2 and 5"):
        replace(sets, union=with_union(steps=4)[1])
    with pytest.raises(ShapeError, match=r"Occupancy\.union is 3, expected a SetUnion or None"):
        replace(sets, union=3)  # type: ignore[arg-type]


@pytest.mark.parametrize("field", ["centre", "semi_axes", "angle", "heading"])
def test_a_union_is_finite_where_it_is_valid_and_has_weight(field: str) -> None:
    sets, union = with_union()
    values = np.array(getattr(union, field))
    values[1, 2, 3] = np.nan
    broken = replace(union, **{field: values})
    with pytest.raises(ShapeError, match=rf"Occupancy\.union\.{field} holds a NaN"):
        replace(sets, union=broken)
    valid = np.array(sets.valid)
    valid[1, 3] = False
    assert replace(sets, union=broken, valid=valid).union is broken
    absent = replace(broken, weight=np.tile([0.5, 0.5, 0.0], (2, 1)))
    assert replace(sets, union=absent).union is absent
    with pytest.raises(ShapeError, match=r"Occupancy\.union\.semi_axes holds a negative"):
        replace(sets, union=replace(union, semi_axes=-union.semi_axes))


def test_steps_of_an_occupancy_are_those_of_its_union() -> None:
    sets, union = with_union(steps=5)
    for part, columns in ((sets.first_steps(3), [0, 1, 2]), (sets.later(2), [2, 3, 4])):
        assert part.union is not None
        assert part.horizon == part.union.horizon == 3
        for field in ("centre", "semi_axes", "angle", "heading"):
            wanted = getattr(union, field)[:, :, columns]
            np.testing.assert_array_equal(getattr(part.union, field), wanted)
        np.testing.assert_array_equal(part.union.weight, union.weight)
    assert sets.first_steps(9) is sets.later(0) is sets


def test_what_is_cut_out_of_an_occupancy_is_as_whole_and_as_read_only_as_one_that_is_made() -> None:
    """Parts are not checked again; a check of them finds nothing, and nobody can write to them."""
    union = random_union(np.random.default_rng(3), 4, 3, 6, spread=9.0, reach=2.0)
    whole = union_of([0.5, 0.3, 0.2], *(occupancy_at(np.ones((4, 2)), 6, a) for a in (1, 2, 3)))
    whole = replace(whole, union=union)
    parts = [
        whole.of_steps(np.array([0, 2])),
        whole.first_steps(3),
        whole.later(2),
        whole.of_users(np.array([3, 1])),
        whole.likeliest(),
        whole.without_sets(),
        whole.by_component()[0],
    ]
    for part in parts:
        again = replace(part, union=None if part.union is None else replace(part.union))
        for name in (f.name for f in fields(part) if f.name != "union"):
            array = getattr(part, name)
            np.testing.assert_array_equal(array, getattr(again, name))
            assert array.dtype == getattr(again, name).dtype
            with pytest.raises(ValueError, match="WRITEABLE"):
                array.setflags(write=True)
    assert parts[0].union is not None
    np.testing.assert_array_equal(parts[0].union.centre, union.centre[:, :, [0, 2]])
    with pytest.raises(ValueError, match="read-only"):
        parts[0].union.centre[0] = 0.0


def test_without_sets_the_most_likely_component_is_left() -> None:
    sets, union = with_union()
    union = replace(union, weight=np.array([[0.2, 0.7, 0.1], [0.1, 0.2, 0.7]]))
    sets = replace(sets, union=union)
    bare, likeliest = sets.without_sets(), sets.likeliest()
    assert bare.union is None
    assert not bare.semi_axes.any()
    for field in ("centre", "angle", "heading"):
        wanted = getattr(union, field)[[0, 1], [1, 2]]
        np.testing.assert_array_equal(getattr(bare, field), wanted)
        np.testing.assert_array_equal(getattr(likeliest, field), wanted)
    np.testing.assert_array_equal(likeliest.semi_axes, union.semi_axes[[0, 1], [1, 2]])


def test_each_component_is_a_road_user_of_its_own() -> None:
    sets, union = with_union()
    union = replace(union, weight=np.array([[0.25, 0.0, 0.75], [0.1, 0.2, 0.7]]))
    spread, rows, weight = replace(sets, union=union).by_component()
    assert rows.tolist() == [0, 0, 1, 1, 1]
    assert weight.tolist() == [0.75, 0.25, 0.7, 0.2, 0.1]
    assert spread.ids.tolist() == [100, 100, 101, 101, 101]
    assert spread.union is None
    which = [2, 0, 2, 1, 0]
    for field in ("centre", "semi_axes", "angle", "heading"):
        np.testing.assert_array_equal(getattr(spread, field), getattr(union, field)[rows, which])


def test_without_a_union_each_road_user_is_its_own_component() -> None:
    sets = occupancy_at(np.zeros((2, 2)), 3, semi_axis=1.0)
    spread, rows, weight = sets.by_component()
    assert spread is sets is sets.likeliest()
    assert rows.tolist() == [0, 1]
    assert weight.tolist() == [1.0, 1.0]


def test_tracks_refuse_two_of_the_same_id_and_holes_that_are_marked_valid() -> None:
    tracks = steady_tracks([[0.0, 0.0, 0.0, 1.0], [9.0, 0.0, 0.0, 1.0]], steps=4)
    with pytest.raises(ShapeError, match="twice"):
        replace(tracks, ids=np.array([5, 5]))
    with pytest.raises(ShapeError, match="kinds has 1"):
        replace(tracks, kinds=tracks.kinds[:1])
    states = np.array(tracks.states)
    states[1, 2] = np.nan
    with pytest.raises(ShapeError, match="marked valid"):
        replace(tracks, states=states)
    valid = np.array(tracks.valid)
    valid[1, 2] = False
    assert isinstance(replace(tracks, states=states, valid=valid), Tracks)


def test_observation_refuses_a_road_user_that_is_not_on_the_scene() -> None:
    seen = World(busy_scenario(), first_step=40, history=5).observation()
    valid = np.array(seen.valid)
    valid[0, -1] = False
    with pytest.raises(ShapeError, match="not on the scene now"):
        replace(seen, valid=valid)
    assert isinstance(seen, Observation)


def test_task_names_the_scenario_in_its_complaint() -> None:
    task = straight_scenario().task
    with pytest.raises(ShapeError, match=r"PlanningTask.start.*\(scenario straight\)"):
        replace(task, start=np.full(5, np.nan))
    with pytest.raises(ShapeError, match=r"goals is empty \(scenario straight\)"):
        replace(task, goals=())
    assert PlanningTask(
        "a", 0.1, 0, np.zeros(5), (GoalState(0, 1),), 1, straight_route()
    ).goals == (GoalState(0, 1),)


def test_route_needs_increasing_arc_lengths() -> None:
    route = straight_route()
    arclength = np.array(route.arclength)
    arclength[3] = arclength[2]
    with pytest.raises(ShapeError, match="increase strictly"):
        replace(route, arclength=arclength)


def test_episode_counts_its_occupancies() -> None:
    with pytest.raises(ShapeError, match=r"Episode.occupancies has 1.*expected 0"):
        Episode(
            scenario_id="a",
            arm="with_dos",  # type: ignore[arg-type]
            start_step=0,
            states=np.zeros((1, 5)),
            inputs=np.zeros((0, 2)),
            tracks=steady_tracks(),
            end="time_over",  # type: ignore[arg-type]
            predict_seconds=np.zeros(0),
            plan_seconds=np.zeros(0),
            plans=(),
            occupancies=(occupancy_at(np.zeros((1, 2)), 2),),
            cycle_steps=np.zeros(0, dtype=np.int64),
        )


def test_every_solve_status_says_what_to_do() -> None:
    words = [status.word for status in SolveStatus]
    assert len(set(words)) == len(words)
    assert all(status.advice.endswith(".") for status in SolveStatus)
