"""Overlap and sweeps: against shapely, against fine sub-stepping, and for speed."""

from __future__ import annotations

import time

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from dosplan.geometry import rectangle_corners, wrap_angle
from dosplan.scoring.collision import (
    RESOLUTION,
    SWEPT_TOUCH,
    TOUCH,
    contacts,
    first_contacts,
    overlap_window,
    shape_at,
)
from dosplan.types import FloatArray, RoadUserKind, Tracks

EGO_SIZE = (4.508, 1.61)
SOLID = (EGO_SIZE[0] - 2 * TOUCH, EGO_SIZE[1] - 2 * TOUCH)
ARROW = np.array([[-2.0, -1.0], [2.0, 0.0], [-2.0, 1.0], [-1.0, 0.0]])

numbers = st.floats(-4.0, 4.0, allow_subnormal=False)
poses = st.tuples(numbers, numbers, numbers)
sizes = st.tuples(st.floats(0.3, 6.0), st.floats(0.3, 6.0))


def tracks_of(
    states: FloatArray,
    size: tuple[float, float] = (4.5, 1.8),
    outline: FloatArray | None = None,
) -> Tracks:
    """One road user per row of (N, K, 4) states."""
    n = len(states)
    return Tracks(
        ids=np.arange(n),
        kinds=(RoadUserKind.CAR,) * n,
        size=np.tile(size, (n, 1)),
        states=states,
        valid=np.isfinite(states[..., 0]),
        outlines=(outline,) * n,
    )


def state(pose: tuple[float, float, float], velocity: float = 1.0) -> FloatArray:
    return np.array([*pose, velocity])


def polygon(pose: tuple[float, float, float], size: tuple[float, float]) -> shapely.Polygon:
    return shapely.Polygon(rectangle_corners(np.array(pose), size))


@given(ego=poses, user=poses, size=sizes)
@settings(max_examples=300, deadline=None)
def test_boxes_overlap_where_shapely_says_so(
    ego: tuple[float, float, float],
    user: tuple[float, float, float],
    size: tuple[float, float],
) -> None:
    tracks = tracks_of(state(user)[None, None], size)
    other = polygon(user, size)
    depth = 1e-6  # Rounding of either library.
    smaller = polygon(ego, (SOLID[0] - depth, SOLID[1] - depth))
    larger = polygon(ego, (SOLID[0] + depth, SOLID[1] + depth))
    hit = bool(first_contacts(state(ego)[None], EGO_SIZE, tracks, 0))
    assert hit or not smaller.intersects(other)
    assert not hit or larger.intersects(other)


@given(ego=poses, user=poses)
@settings(max_examples=300, deadline=None)
def test_outlines_overlap_where_shapely_says_so(
    ego: tuple[float, float, float], user: tuple[float, float, float]
) -> None:
    tracks = tracks_of(state(user)[None, None], outline=ARROW)
    other = shape_at(tracks, 0, state(user))
    hit = bool(first_contacts(state(ego)[None], EGO_SIZE, tracks, 0))
    length, width = SOLID
    assert hit or not polygon(ego, (length - 1e-6, width - 1e-6)).intersects(other)
    assert not hit or polygon(ego, (length + 1e-6, width + 1e-6)).intersects(other)


@given(
    ego=st.tuples(poses, poses),
    user=st.tuples(poses, poses),
    size=sizes,
    arrow=st.booleans(),
)
@settings(max_examples=150, deadline=None)
def test_a_sweep_finds_what_fine_steps_find_and_nothing_else(
    ego: tuple[tuple[float, float, float], tuple[float, float, float]],
    user: tuple[tuple[float, float, float], tuple[float, float, float]],
    size: tuple[float, float],
    arrow: bool,
) -> None:
    outline = ARROW if arrow else None
    ego_states = np.array([state(x) for x in ego])
    user_states = np.array([state(x) for x in user])
    tracks = tracks_of(user_states[None], size, outline)
    hits = list(contacts(ego_states, EGO_SIZE, tracks, 0))

    for hit in hits:  # Every contact is a true overlap of the poses that it names.
        touch = SWEPT_TOUCH if hit.fraction < 1.0 else TOUCH
        box = shapely.Polygon(
            rectangle_corners(hit.ego_state[:3], np.array(EGO_SIZE) - 2.0 * touch + 1e-6)
        )
        assert box.intersects(shape_at(tracks, 0, hit.user_state))

    # An overlap that lasts for RESOLUTION of motion is found: the shapes less that much overlap.
    turn_ego = wrap_angle(ego_states[1, 2] - ego_states[0, 2])
    turn_user = user_states[1, 2] - user_states[0, 2]
    period = 2.0 * np.pi if arrow else np.pi
    turn_user = (turn_user + period / 2) % period - period / 2
    shrunk = np.array(EGO_SIZE) - 2.0 * (SWEPT_TOUCH + RESOLUTION)
    f = np.linspace(0.0, 1.0, 101)[:, None]
    between = ego_states[0] + f * (ego_states[1] - ego_states[0])
    theirs = user_states[0] + f * (user_states[1] - user_states[0])
    between[:, 2] = ego_states[0, 2] + f[:, 0] * turn_ego
    theirs[:, 2] = user_states[0, 2] + f[:, 0] * turn_user
    boxes = shapely.polygons(rectangle_corners(between[:, :3], shrunk))
    seen = shapely.intersects(boxes, [shape_at(tracks, 0, pose) for pose in theirs]).any()
    assert not seen or hits


@pytest.mark.parametrize(("gap", "hit"), [(0.01, False), (0.0, False), (-0.01, True)])
@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0])
def test_touching_is_no_collision(gap: float, hit: bool, angle: float) -> None:
    # Bumper to bumper along the angle: half lengths 2.254 + 2.25.
    reach = 2.254 + 2.25 + gap
    tracks = tracks_of(state((reach * np.cos(angle), reach * np.sin(angle), angle))[None, None])
    found = first_contacts(state((0.0, 0.0, angle))[None], EGO_SIZE, tracks, 0)
    assert bool(found) is hit


@given(
    a=poses,
    b=poses,
    size=sizes,
    velocity=st.tuples(numbers, numbers),
)
@settings(max_examples=200, deadline=None)
def test_the_window_of_overlap_is_when_shapely_says_so(
    a: tuple[float, float, float],
    b: tuple[float, float, float],
    size: tuple[float, float],
    velocity: tuple[float, float],
) -> None:
    begin, end = overlap_window(
        np.array(a), np.array(EGO_SIZE), np.array(b), np.array(size), np.array(velocity)
    )
    times = np.linspace(0.0, 5.0, 21)
    moved = np.tile(np.array(b), (len(times), 1))
    moved[:, :2] += times[:, None] * np.array(velocity)
    ego, users = polygon(a, EGO_SIZE), shapely.polygons(rectangle_corners(moved, np.array(size)))
    inside = (begin <= times) & (times <= end)
    assert not np.any(inside[shapely.distance(ego, users) > 1e-6])
    assert np.all(inside[shapely.area(shapely.intersection(ego, users)) > 1e-6])


@pytest.mark.parametrize(("gap", "never"), [(1e-9, True), (-1e-9, False)])
def test_two_that_keep_their_distance_overlap_always_or_never(gap: float, never: bool) -> None:
    beside = np.array([0.0, 2.0 + gap, 0.0])
    size, still = np.array([4.0, 2.0]), np.zeros(2)
    begin, end = overlap_window(np.zeros(3), size, beside, size, still)
    assert begin == (np.inf if never else 0.0)
    assert end == np.inf


def test_a_rectangle_that_is_turned_around_has_not_swept_a_circle() -> None:
    # A standing car whose recorded heading flips by a half turn, 1.2 m beside the ego: were the
    # flip a motion, its front (2.25 m from its centre) would sweep through the ego.
    flip = np.array([[[0.0, 2.9, 0.0, 0.0], [0.0, 2.9, np.pi, 0.0]]])
    ego = np.tile(state((0.0, 0.0, 0.0)), (2, 1))
    assert not first_contacts(ego, EGO_SIZE, tracks_of(flip), 0)
    quarter = flip.copy()
    quarter[0, 1, 2] = np.pi / 2
    assert first_contacts(ego, EGO_SIZE, tracks_of(quarter), 0)


def test_headings_turn_the_shorter_way() -> None:
    # From 179 to -179 degrees is a turn by 2 degrees, for both of them.
    angle = np.deg2rad(179.0)
    ego = np.array([state((0.0, 0.0, angle)), state((0.0, 0.0, -angle))])
    users = np.array([[state((0.0, 1.9, angle)), state((0.0, 1.9, -angle))]])
    assert not first_contacts(ego, EGO_SIZE, tracks_of(users), 0)
    assert not first_contacts(ego, EGO_SIZE, tracks_of(users, outline=ARROW), 0)


def test_a_thin_post_cannot_slip_through() -> None:
    # 4 cm wide, 4 m from one step to the next, straight across the ego's 1.61 m.
    posts = np.array([[state((0.3, -2.0, 1.57)), state((0.3, 2.0, 1.57))]])
    ego = np.tile(state((0.0, 0.0, 0.0)), (2, 1))
    (hit,) = first_contacts(ego, EGO_SIZE, tracks_of(posts, (0.04, 0.04)), 0)
    # It touches after 2 - 0.805 - 0.02 = 1.175 of 4 m, counts from 0.025 m deeper on and is found
    # within 0.01 m of that.
    assert 1.200 / 4.0 <= hit.fraction <= 1.211 / 4.0


@pytest.mark.parametrize(("depth", "hit"), [(0.02, False), (0.04, True)])
def test_a_graze_between_steps_must_be_deeper_than_the_poses_are_known(
    depth: float, hit: bool
) -> None:
    # A car passes the ego's corner across: inside by the depth halfway, clear at both steps.
    x = 2.254 + 0.9 - depth
    crossing = np.array([[state((x, -4.0, np.pi / 2)), state((x, 4.0, np.pi / 2))]])
    ego = np.tile(state((0.0, 0.0, 0.0)), (2, 1))
    assert bool(first_contacts(ego, EGO_SIZE, tracks_of(crossing), 0)) is hit


def test_the_first_contacts_are_those_of_one_step_in_their_order() -> None:
    # Three cars ahead of an ego at 10 m/s: two in reach of the first step, one of the second.
    cars = np.array([state((x, y, 0.0), 0.0) for x, y in ((4.9, 0.9), (4.7, -0.9), (6.1, 0.0))])
    tracks = tracks_of(np.repeat(cars[:, None], 3, axis=1), (0.5, 0.5))
    ego = np.array([state((x, 0.0, 0.0), 10.0) for x in (2.0, 3.0, 4.0)])
    hits = first_contacts(ego, EGO_SIZE, tracks, 0)
    assert [hit.user for hit in hits] == [1, 0]
    assert {hit.step for hit in hits} == {1}
    assert [hit.step for hit in contacts(ego, EGO_SIZE, tracks, 0) if hit.user == 2] == [2]


def test_steps_count_from_the_start_step_and_nobody_is_there_after_the_recording() -> None:
    ego = np.tile(state((0.0, 0.0, 0.0)), (6, 1))
    states = np.tile(state((0.0, 0.0, 0.0)), (1, 5, 1))
    states[:, :3] = np.nan
    assert first_contacts(ego, EGO_SIZE, tracks_of(states), 2)[0].step == 3
    assert not first_contacts(ego, EGO_SIZE, tracks_of(states), 5)
    assert not first_contacts(ego, EGO_SIZE, tracks_of(np.empty((0, 9, 4))), 0)


@pytest.mark.slow
def test_a_crowded_episode_takes_little_time() -> None:
    # 100 steps beside 100 cars in dense lanes at other speeds, none of them in the ego's lane.
    rng = np.random.default_rng(1)
    lane = rng.choice([-7.0, -3.5, 3.5, 7.0], 100)
    speed = np.where(lane > 0, -20.0, 15.0)
    x = rng.uniform(-100, 300, 100)[:, None] + 0.1 * speed[:, None] * np.arange(101)
    users = np.stack(
        [x, x * 0 + lane[:, None], x * 0 + np.pi * (lane > 0)[:, None], np.abs(x * 0 + 20.0)],
        axis=-1,
    )
    ego = np.stack([2.0 * np.arange(101), np.zeros(101), np.zeros(101), np.full(101, 20.0)], -1)
    tracks = tracks_of(users)
    best = np.inf
    for _ in range(3):
        begun = time.perf_counter()
        assert not first_contacts(ego, EGO_SIZE, tracks, 0)
        best = min(best, time.perf_counter() - begun)
    assert best < 0.05
