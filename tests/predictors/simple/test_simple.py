"""Kinematic predictors on motions with a closed form, and the specified sets around them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dosplan_simple.measure import measure
from dosplan_simple.predictors import (
    ConstantTurnRatePredictor,
    ConstantVelocityPredictor,
    GroundTruthPredictor,
    NonePredictor,
    TurnRateSettings,
)
from dosplan_simple.sets import (
    ErrorCirclePredictor,
    ErrorCircleSettings,
    ErrorTable,
    FixedCirclePredictor,
    FixedCircleSettings,
    GrowingCirclePredictor,
    GrowingCircleSettings,
    shipped_table,
)

from dosplan.api import PluginError, PluginSpec, Predictor, PredictorSettings
from dosplan.scenario.synthetic import (
    busy_scenario,
    crowded_scenario,
    steady_tracks,
    straight_scenario,
)
from dosplan.simulation.world import World
from dosplan.types import FloatArray, Observation, RoadUserKind, Tracks

SHORT = ConstantVelocityPredictor(settings=PredictorSettings(horizon=3))
CV_TABLE = ErrorTable("constant-velocity-v1", 0.1, (0.5, 1.0, 2.0), (9, 9, 9), "by hand")


def seen_at(tracks: Tracks, step: int) -> Observation:
    scenario = straight_scenario(tracks)
    return World(scenario, first_step=step, history=31).observation()


def circle_tracks(radius: float, velocity: float, *, first: float = 0.0) -> Tracks:
    """One car on a circle around the origin, counter-clockwise for a positive radius."""
    angle = first + velocity / radius * 0.1 * np.arange(101)
    position = radius * np.stack([np.sin(angle), -np.cos(angle)], axis=-1)
    states = np.concatenate([position, angle[:, None], np.full((101, 1), velocity)], axis=1)[None]
    return replace(steady_tracks([[0.0, 0.0, 0.0, 0.0]]), states=states)


def with_headings(tracks: Tracks, heading: FloatArray, velocity: float) -> Tracks:
    states = np.array(tracks.states)
    states[0, :, 2], states[0, :, 3] = heading, velocity
    return replace(tracks, states=states)


def test_constant_velocity_is_exact_on_a_straight_line() -> None:
    tracks = steady_tracks([[5.0, 3.0, 0.7, 8.0], [0.0, 0.0, -2.0, 1.0]])
    sets = ConstantVelocityPredictor().predict(seen_at(tracks, 20))
    np.testing.assert_allclose(sets.centre, tracks.states[:, 21:61, :2], atol=1e-9)
    np.testing.assert_allclose(sets.heading, tracks.states[:, 21:61, 2])
    assert not sets.semi_axes.any()


@pytest.mark.parametrize(("radius", "velocity"), [(20.0, 6.0), (-20.0, 6.0), (100.0, 15.0)])
def test_constant_turn_rate_is_exact_on_a_circle(radius: float, velocity: float) -> None:
    # 6 m/s on 20 m is 1.8 m/s2, 15 m/s on 100 m 2.25 m/s2: both below the limit.
    tracks = circle_tracks(radius, velocity)
    sets = ConstantTurnRatePredictor().predict(seen_at(tracks, 20))
    np.testing.assert_allclose(sets.centre, tracks.states[:, 21:61, :2], atol=1e-6)
    np.testing.assert_allclose(sets.heading, tracks.states[:, 21:61, 2], atol=1e-6)


def test_constant_turn_rate_is_not_upset_by_the_jump_of_a_wrapped_heading() -> None:
    tracks = circle_tracks(20.0, 6.0, first=math.pi - 0.6)  # It passes pi at step 20.
    states = np.array(tracks.states)
    states[..., 2] = (states[..., 2] + np.pi) % (2.0 * np.pi) - np.pi
    sets = ConstantTurnRatePredictor().predict(seen_at(replace(tracks, states=states), 21))
    np.testing.assert_allclose(sets.centre, tracks.states[:, 22:62, :2], atol=1e-6)


def turned(tracks: Tracks, step: int = 20) -> float:
    """Heading change that is predicted over 1 s, rad."""
    sets = ConstantTurnRatePredictor(settings=TurnRateSettings(horizon=10)).predict(
        seen_at(tracks, step)
    )
    return float(sets.heading[0, -1] - tracks.states[0, step, 2])


def test_standing_vehicles_do_not_spin() -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.5, 101)
    tracks = steady_tracks([[0.0, 0.0, 0.0, 0.0]])
    assert turned(with_headings(tracks, noise, 0.0)) == 0.0
    # At 0.5 m/s the tightest turn is 0.5 / 5 = 0.1 rad/s.
    assert abs(turned(with_headings(tracks, noise, 0.5))) <= 0.5 / 5.0 + 1e-12


def test_fast_vehicles_turn_no_faster_than_tyres_hold() -> None:
    tracks = with_headings(
        steady_tracks([[0.0, 0.0, 0.0, 20.0]]), np.linspace(0.0, 300.0, 101), 20.0
    )
    assert abs(turned(tracks)) <= 4.0 / 20.0 + 1e-12


def test_turn_rate_averages_noise_out() -> None:
    # Least squares over six headings with sigma 0.01: sd of the slope 0.01 / sqrt(0.175) = 0.024.
    rng = np.random.default_rng(1)
    rates = []
    for _ in range(200):
        heading = np.array(np.linspace(0.0, 2.0, 101) + rng.normal(0.0, 0.01, 101), np.float64)
        tracks = with_headings(steady_tracks([[0.0, 0.0, 0.0, 8.0]]), heading, 8.0)
        rates.append(turned(tracks))
    assert np.mean(rates) == pytest.approx(0.2, abs=3 * 0.024 / math.sqrt(200))
    assert np.std(rates) == pytest.approx(0.024, rel=0.25)


def test_turn_rate_needs_three_headings() -> None:
    tracks = circle_tracks(20.0, 6.0)
    for known, expected in ((1, 0.0), (2, 0.0), (3, 0.3)):
        valid = np.zeros((1, 101), dtype=np.bool_)
        valid[0, 21 - known :] = True
        states = np.where(valid[..., None], tracks.states, np.nan)
        assert turned(replace(tracks, states=states, valid=valid)) == pytest.approx(expected)


def test_pedestrians_walk_straight_on() -> None:
    tracks = circle_tracks(20.0, 6.0)
    assert turned(replace(tracks, kinds=(RoadUserKind.PEDESTRIAN,))) == 0.0


@pytest.mark.parametrize("kind", [RoadUserKind.PARKED, RoadUserKind.STATIC])
@pytest.mark.parametrize(
    "predictor",
    [
        ConstantVelocityPredictor(),
        ConstantTurnRatePredictor(),
        GrowingCirclePredictor(),
        FixedCirclePredictor(),
    ],
)
def test_what_is_parked_stays_and_has_no_set(predictor: Predictor, kind: RoadUserKind) -> None:
    tracks = steady_tracks([[5.0, 3.0, 0.7, 8.0]], kinds=[kind])
    observation = seen_at(tracks, 20)
    sets = predictor.predict(observation)
    np.testing.assert_array_equal(sets.centre[0], np.tile(observation.states[0, -1, :2], (40, 1)))
    assert not sets.semi_axes.any()
    assert sets.valid.all()


def test_none_predicts_nobody() -> None:
    sets = NonePredictor(settings=PredictorSettings(horizon=7)).predict(
        seen_at(busy_scenario().tracks, 40)
    )
    assert sets.valid.shape == (4, 7)
    assert not sets.valid.any()


def test_ground_truth_is_the_recording_and_ends_with_it() -> None:
    tracks = circle_tracks(20.0, 6.0)
    valid = np.array(tracks.valid)
    valid[0, 95:] = False
    tracks = replace(tracks, valid=valid, states=np.where(valid[..., None], tracks.states, np.nan))
    predictor = GroundTruthPredictor(settings=PredictorSettings(horizon=20))
    predictor.reveal(tracks)
    sets = predictor.predict(seen_at(tracks, 90))
    np.testing.assert_array_equal(sets.valid, [[True] * 4 + [False] * 16])
    np.testing.assert_array_equal(sets.centre[0, :4], tracks.states[0, 91:95, :2])


def test_ground_truth_finds_road_users_by_id() -> None:
    tracks = busy_scenario().tracks
    shuffled = replace(tracks, ids=np.array([7, 3, 9, 1]))
    valid = np.array(shuffled.valid)
    valid[0] = False
    predictor = GroundTruthPredictor(settings=PredictorSettings(horizon=5))
    predictor.reveal(shuffled)
    sets = predictor.predict(seen_at(replace(shuffled, valid=valid), 40))
    assert list(sets.ids) == [3, 9, 1]
    np.testing.assert_array_equal(sets.centre, tracks.states[1:, 41:46, :2])


def test_ground_truth_that_was_shown_nothing_says_so() -> None:
    with pytest.raises(PluginError, match="call reveal"):
        GroundTruthPredictor().predict(seen_at(busy_scenario().tracks, 40))


def test_fixed_circle_has_one_radius() -> None:
    sets = FixedCirclePredictor().predict(seen_at(crowded_scenario().tracks, 40))
    np.testing.assert_array_equal(sets.semi_axes, np.ones((50, 40, 2)))


def test_growing_circle_is_z_times_t() -> None:
    sets = GrowingCirclePredictor(settings=GrowingCircleSettings(z=0.7)).predict(
        seen_at(crowded_scenario().tracks, 40)
    )
    # 0.7 m after 1 s, 2.8 m after 4 s.
    np.testing.assert_allclose(sets.semi_axes[:, 9], 0.7)
    np.testing.assert_allclose(sets.semi_axes[:, 39], 2.8)


def test_growing_circles_leave_room_in_the_next_lane_by_default() -> None:
    # 0.5 m/s: 2 m after 4 s.
    sets = GrowingCirclePredictor().predict(seen_at(crowded_scenario().tracks, 40))
    np.testing.assert_allclose(sets.semi_axes[:, 39], 2.0)


def test_error_circle_is_z_times_the_measured_error(tmp_path: Path) -> None:
    observation = seen_at(crowded_scenario().tracks, 40)
    table = tmp_path / "table.json"
    CV_TABLE.dump(table)
    settings = ErrorCircleSettings(horizon=3, table=table)
    sets = ErrorCirclePredictor(settings=replace(settings, z=1.5)).predict(observation)
    np.testing.assert_allclose(sets.semi_axes[7, :, 0], [0.75, 1.5, 3.0])
    replace(CV_TABLE, dt=0.2).dump(table)  # After 0.1 s half of the first error.
    sets = ErrorCirclePredictor(settings=settings).predict(observation)
    np.testing.assert_allclose(sets.semi_axes[7, :, 0], [0.25, 0.5, 0.75])


def test_error_circle_wants_the_table_of_its_base(tmp_path: Path) -> None:
    table = tmp_path / "table.json"
    CV_TABLE.dump(table)
    turning: PluginSpec[Predictor] = PluginSpec(ConstantTurnRatePredictor)
    settings = ErrorCircleSettings(horizon=3, table=table)
    with pytest.raises(ValueError, match=r"that of constant-velocity-v1, the base is .*turn"):
        ErrorCirclePredictor(settings=replace(settings, base=turning))
    with pytest.raises(ValueError, match="ends at step 3, horizon is 4"):
        ErrorCirclePredictor(settings=replace(settings, horizon=4))


def test_circles_lie_around_any_trajectory() -> None:
    tracks = circle_tracks(20.0, 6.0)
    truth: PluginSpec[Predictor] = PluginSpec(GroundTruthPredictor, PredictorSettings(horizon=20))
    circles = FixedCirclePredictor(settings=FixedCircleSettings(horizon=20, base=truth))
    assert isinstance(circles.base, GroundTruthPredictor)
    circles.base.reveal(tracks)
    sets = circles.predict(seen_at(tracks, 90))
    np.testing.assert_array_equal(sets.centre[0, :10], tracks.states[0, 91:101, :2])
    np.testing.assert_array_equal(sets.valid[0], [True] * 10 + [False] * 10)
    with pytest.raises(ValueError, match="base predicts 20 steps, horizon is 40"):
        FixedCircleSettings(base=truth)


def test_the_shipped_table_grows_and_names_its_command() -> None:
    table = ErrorTable.load(shipped_table(ConstantVelocityPredictor.name))
    assert table.predictor == ConstantVelocityPredictor.name
    assert table.command.startswith("python -m dosplan_simple.measure")
    assert len(table.mean_error) == len(table.samples) == 50
    assert np.all(np.diff(table.mean_error) > 0.0)
    assert min(table.samples) > 1000


def test_measure_finds_a_known_error(tmp_path: Path) -> None:
    # A parked car that claims to drive counts for nothing. The other stands but claims 2 m/s:
    # constant velocity is 0.2 m off after a step, 0.6 m after three.
    tracks = steady_tracks(
        [[0.0, 0.0, 0.0, 0.0], [50.0, 9.0, 0.0, 0.0]],
        kinds=[RoadUserKind.CAR, RoadUserKind.PARKED],
    )
    states = np.array(tracks.states)
    states[..., 3] = 2.0
    scenario = straight_scenario(replace(tracks, states=states))
    table = measure([scenario], SHORT, command="test")
    np.testing.assert_allclose(table.mean_error, [0.2, 0.4, 0.6])
    assert table.samples == (10, 10, 10)  # Steps 0, 10, .. 90; at 100 the recording ends.
    table.dump(tmp_path / "table.json")
    back = ErrorTable.load(tmp_path / "table.json")
    assert back == replace(table, mean_error=(0.2, 0.4, 0.6))  # Kept to a tenth of a millimetre.


def test_measure_refuses_a_horizon_beyond_every_recording() -> None:
    scenario = straight_scenario(steady_tracks([[0.0, 0.0, 0.0, 1.0]], steps=3))
    with pytest.raises(ValueError, match="no road user is recorded 3 steps on"):
        measure([scenario], SHORT)


@pytest.mark.parametrize("text", ["{", "{}", json.dumps({"predictor": "a", "dt": 0.1})])
def test_a_broken_table_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "table.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"table.json: not a table of prediction errors"):
        ErrorTable.load(path)
