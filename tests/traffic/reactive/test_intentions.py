"""Other futures of the same past: what is drawn, from what, and what comes of it."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from dosplan_reactive import traffic as traffic_module
from dosplan_reactive.intentions import Minds, drawn, recorded_minds
from dosplan_reactive.settings import Intentions, ReactiveSettings
from dosplan_reactive.traffic import ReactiveTraffic

from dosplan.geometry import rectangles_overlap
from dosplan.scenario.synthetic import CAR_SIZE, LANE_WIDTH, busy_scenario, straight_scenario
from dosplan.simulation.traffic import RoadUsers
from dosplan.simulation.world import World
from dosplan.types import FloatArray, RoadUserKind, Scenario, Tracks
from tests.traffic.reactive.scenes import along, driven, scene, standing, state

NOTHING = Intentions(**{f.name: 0.0 for f in fields(Intentions) if f.name.endswith(
    ("_share", "_deviation", "_spread", "glances"))})  # fmt: skip
"""Drivers who are all alike."""


def crowd(count: int = 400) -> Scenario:
    """Many cars, far apart, that all drive at 10 m/s for 4 s."""
    return scene(*(along(np.full(41, 10.0), y=20.0 * i) for i in range(count)))


def later(traffic: ReactiveTraffic, scenario: Scenario, ego: FloatArray) -> list[FloatArray]:
    return [users.states for users in driven(scenario, ego, traffic)]


def test_the_past_is_one_and_the_futures_are_several() -> None:
    scenario, far = busy_scenario(), standing(-300.0, steps=41)
    begun = [ReactiveTraffic(seed=3, future=k).begin(scenario, 10) for k in range(3)]
    for past in begun:
        np.testing.assert_array_equal(past.states, scenario.tracks.states[:, :11])
    zero, one, two = (later(ReactiveTraffic(seed=3, future=k), scenario, far) for k in range(3))
    np.testing.assert_array_equal(zero[39], scenario.tracks.states[:, 40])
    assert not np.array_equal(one[39], two[39])
    assert not np.array_equal(zero[39], one[39])


def test_a_future_is_the_same_each_time_and_does_not_hang_on_the_ego_or_on_the_others() -> None:
    scenario, chosen = busy_scenario(), ReactiveSettings()
    minds, tracks = drawn(scenario, 0, chosen, 7, 2)
    again, _ = drawn(scenario, 0, chosen, 7, 2)
    kept = [0, *range(2, len(tracks.ids))]
    fewer = Tracks(
        ids=tracks.ids[kept],
        kinds=tuple(scenario.tracks.kinds[i] for i in kept),
        size=tracks.size[kept],
        states=scenario.tracks.states[kept],
        valid=scenario.tracks.valid[kept],
    )
    others, _ = drawn(replace(scenario, tracks=fewer), 0, chosen, 7, 2)
    np.testing.assert_array_equal(minds.pace, again.pace)
    np.testing.assert_array_equal(minds.away, again.away)
    np.testing.assert_array_equal(minds.pace[kept], others.pace)
    for seed, future, name in ((8, 2, scenario.id), (7, 3, scenario.id), (7, 2, "ZAM_Other-1")):
        different, _ = drawn(replace(scenario, id=name), 0, chosen, seed, future)
        assert not np.array_equal(minds.pace, different.pace)


def test_what_is_drawn_has_the_documented_distribution() -> None:
    chosen = ReactiveSettings()
    minds, _ = drawn(crowd(), 0, chosen, 1, 1)
    assert np.mean(minds.pace) == pytest.approx(1.0, abs=0.02)
    assert np.std(minds.pace) == pytest.approx(0.1, abs=0.015)
    assert np.abs(minds.pace - 1.0).max() <= 0.2
    assert np.mean(minds.reaction) == pytest.approx(1.25, abs=0.08)
    assert np.std(minds.reaction) == pytest.approx(0.43, abs=0.08)  # Its ends are cut off.
    assert np.median(minds.time_gap) == pytest.approx(1.0, abs=0.08)
    assert np.mean((minds.time_gap > 0.56) & (minds.time_gap < 1.8)) == pytest.approx(0.9, abs=0.05)
    assert np.mean(minds.courteous) == pytest.approx(0.2, abs=0.06)
    assert np.mean(minds.amber) == pytest.approx(3.0, abs=0.1)
    assert 0.06 < np.mean(minds.away) < 0.16


def test_a_faster_driver_gets_further_and_takes_up_its_speed_smoothly() -> None:
    scenario = scene(along(np.full(101, 10.0)))
    spread = replace(NOTHING, speed_deviation=0.2)
    ways = {}
    for future in range(1, 12):
        traffic = ReactiveTraffic(settings=ReactiveSettings(intentions=spread), future=future)
        x = np.array(
            [users.states[0, 0] for users in driven(scenario, standing(-300.0), traffic)[:70]]
        )
        ways[future] = x[-1]
        assert np.abs(np.diff(x, 2)).max() / 0.01 < 3.0  # m/s2
    recorded = scenario.tracks.states[0, 70, 0]
    assert min(ways.values()) < recorded - 2.0
    assert max(ways.values()) > recorded + 2.0


def test_whoever_looks_away_reacts_later() -> None:
    scenario = scene(along(np.full(101, 10.0)))
    ego = standing(45.0)
    stops = {}
    for name, spread in (
        ("looks", NOTHING),
        ("away", replace(NOTHING, glances=50.0, glance_median=1.0, glance_spread=0.1)),
    ):
        chosen = ReactiveSettings(intentions=replace(spread, reaction_mean=0.5))
        traffic = ReactiveTraffic(settings=chosen, future=1)
        states = later(traffic, scenario, ego)
        slower = [s[0, 3] < 9.9 for s in states]
        stops[name] = slower.index(True) if True in slower else len(slower)
    assert stops["away"] > stops["looks"] + 3


def test_somebody_may_take_the_way_of_another_who_was_in_the_same_lane() -> None:
    straight = along(np.full(101, 10.0), start=-20.0)
    turning = along(np.full(101, 10.0), start=0.0)
    angle = np.clip((turning[:, 0] - 30.0) / 15.0, 0.0, np.pi / 2.0)
    step = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    turning[:, :2] = np.concatenate([[[0.0, 0.0]], np.cumsum(step[1:], axis=0)])
    turning[:, 2] = angle
    scenario = scene(straight, turning)
    chosen = ReactiveSettings(intentions=replace(NOTHING, other_way_share=1.0))
    _, tracks = drawn(scenario, 0, chosen, 1, 1)
    end = tracks.states[0, tracks.valid[0]][-1]
    assert end[1] > 10.0  # It turns left as the other one does.
    assert end[2] == pytest.approx(np.pi / 2.0)
    np.testing.assert_array_equal(tracks.states[0, :20], scenario.tracks.states[0, :20])
    moves = np.hypot(*np.diff(tracks.states[0, tracks.valid[0], :2], axis=0).T)
    assert moves.max() < 1.3  # No jump from one path to the other.
    users = driven(scenario, standing(-300.0), ReactiveTraffic(settings=chosen, future=1))
    assert state(users[95], 100)[1] > 5.0


def walking() -> Scenario:
    """Somebody on foot comes to the kerb, stands there from 1 to 3 s, and steps onto the road."""
    speed = np.concatenate([np.full(10, 1.5), np.zeros(20), np.full(71, 1.5)])
    walk = along(speed, start=-3.6, y=-40.0, heading=np.pi / 2.0)
    return scene(walk, kinds=[RoadUserKind.PEDESTRIAN])


@pytest.mark.parametrize("share", ["waiting_share", "stepping_out_share"])
def test_people_on_foot_wait_before_the_road_or_step_out(share: str) -> None:
    scenario = walking()
    chosen = ReactiveSettings(intentions=replace(NOTHING, **{share: 1.0}))
    users = driven(scenario, standing(-300.0), ReactiveTraffic(settings=chosen, future=1))
    recorded = scenario.tracks.states[0, 60, 1]
    if share == "waiting_share":
        assert state(users[59], 100)[1] < recorded - 0.5
    else:
        assert state(users[59], 100)[1] > recorded + 1.0


def test_nobody_drives_through_another_in_any_future() -> None:
    queue = [along(np.full(101, 10.0), start=-9.0 * i) for i in range(4)]
    beside = [along(np.full(101, 12.0), start=-14.0 * i, y=LANE_WIDTH) for i in range(3)]
    across = [
        along(np.full(101, 8.0), start=-60.0 - 12.0 * i, y=-60.0, heading=np.pi / 2.0)
        for i in range(3)
    ]
    scenario = scene(*queue, *beside, *across)
    for future in range(1, 6):
        traffic = ReactiveTraffic(seed=5, future=future)
        for users in driven(scenario, standing(-300.0), traffic):
            one, other = np.triu_indices(len(users.ids), 1)
            states, size = users.states, users.size
            assert not rectangles_overlap(states[one], size[one], states[other], size[other]).any()


def merging() -> Scenario:
    """Two on foot whose ways merge at the origin; recorded, one is 8 m ahead of the other."""
    first = along(np.full(131, 1.5), start=0.0)
    second = along(np.full(131, 1.5), start=-8.0)
    beside = second[:, 0] < 0.0  # Until the origin it comes from the right, at 45 degrees.
    second[beside, 1] = second[beside, 0] * np.sqrt(0.5)
    second[beside, 0] *= np.sqrt(0.5)
    second[beside, 2] = np.pi / 4.0
    return scene(first, second, kinds=[RoadUserKind.PEDESTRIAN] * 2)


def paced(monkeypatch: pytest.MonkeyPatch, *paces: float) -> ReactiveTraffic:
    """Traffic of a future in which the road users have these shares of their recorded speeds."""

    def minds(
        scenario: Scenario, first_step: int, chosen: ReactiveSettings, seed: int, future: int
    ) -> tuple[Minds, Tracks]:
        del first_step, seed, future
        return replace(recorded_minds(len(paces), chosen), pace=np.array(paces)), scenario.tracks

    monkeypatch.setattr(traffic_module, "drawn", minds)
    return ReactiveTraffic(future=1)


def overlaps(users: RoadUsers) -> bool:
    states, size = users.states, users.size
    return bool(rectangles_overlap(states[:1], size[:1], states[1:], size[1:])[0])


def test_whoever_would_walk_into_another_is_held_behind_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """On foot nobody heeds others, so that ``_keep_apart`` alone can hold them.

    Their rectangles are 4.5 m long: 8 m apart, they have 3.5 m between them. At 1.2 and 1.8 m/s
    they lose 0.6 m/s * (10 s - half of the 2 s over which they take up their speeds) = 5.4 m.
    """
    far = standing(-300.0)
    users = driven(merging(), far, paced(monkeypatch, 0.8, 1.2))
    assert not any(overlaps(seen) for seen in users)
    # The one ahead is not held: 12 m in ten seconds, and 0.3 m more over the first two.
    assert state(users[-1], 100)[0] == pytest.approx(12.3, abs=0.05)
    # The one behind stands as close behind it as a step of 0.18 m lets it come.
    gap = state(users[-1], 100)[0] - state(users[-1], 101)[0] - CAR_SIZE[0]
    assert 0.0 <= gap < 0.31
    monkeypatch.setattr(ReactiveTraffic, "_keep_apart", lambda *_: None)
    users = driven(merging(), far, paced(monkeypatch, 0.8, 1.2))
    assert overlaps(users[-1])


def who_waits(
    one: FloatArray,
    other: FloatArray,
    *,
    clocks: tuple[float, float] = (4.0, 4.0),
    before: tuple[float, float] = (3.0, 3.0),
    kinds: tuple[RoadUserKind, RoadUserKind] = (RoadUserKind.CAR,) * 2,
    gap: int | None = None,
) -> list[int]:
    """Who is held of two that would overlap at these (4,) states: 0, 1, both or none."""
    states = [np.tile(pose, (9, 1)) for pose in (one, other)]
    if gap is not None:
        states[gap][6] = np.nan
    traffic = ReactiveTraffic()
    traffic.begin(scene(*states, kinds=kinds), 0)
    traffic._clock[:] = clocks
    rows, pair = np.arange(2), (np.array([0]), np.array([1]))
    held = traffic._who_waits(rows, np.stack([one, other]), np.array(before), *pair, 4)
    return [int(row) for row in held]


REAR, FRONT = np.array([0.0, 0.0, 0.0, 2.0]), np.array([4.0, 0.5, 0.3, 2.0])
"""Both drive to the right: the second is ahead of the first, the first behind the second."""

ONCOMING = np.array([4.0, 0.5, np.pi, 2.0])
"""Has the first ahead, as the first has it."""

AWAY = np.array([-4.0, 0.5, np.pi, 2.0])
"""Has the first behind, as the first has it."""


def test_of_two_that_would_overlap_the_one_behind_waits_whatever_their_clocks() -> None:
    for clocks in ((4.0, 4.0), (3.2, 4.0), (4.0, 3.2)):
        assert who_waits(REAR, FRONT, clocks=clocks) == [0]
        assert who_waits(FRONT, REAR, clocks=clocks) == [1]


@pytest.mark.parametrize("met", [ONCOMING, AWAY])
def test_of_two_of_which_neither_is_behind_the_later_one_waits(met: FloatArray) -> None:
    assert who_waits(REAR, met, clocks=(3.2, 4.0)) == [0]
    assert who_waits(REAR, met, clocks=(4.0, 3.2)) == [1]
    assert who_waits(REAR, met, clocks=(4.0, 4.0)) == [0]  # Equal: the first of the pair.


def test_who_cannot_be_held_does_not_wait_but_the_other_does() -> None:
    parked = (RoadUserKind.PARKED, RoadUserKind.CAR)
    assert who_waits(REAR, FRONT, kinds=parked) == [1]
    assert who_waits(REAR, FRONT, kinds=(RoadUserKind.PARKED,) * 2) == []
    # Whose clock did not move has nothing to be held back from; nor has who is recorded with gaps.
    assert who_waits(REAR, FRONT, before=(4.0, 3.0)) == [1]
    assert who_waits(REAR, FRONT, before=(4.0, 4.0)) == []
    assert who_waits(REAR, FRONT, gap=0) == [1]
    assert who_waits(FRONT, REAR, gap=1) == [0]


def test_a_future_can_be_watched_without_an_ego_that_drives() -> None:
    world = World(busy_scenario(), ReactiveTraffic(future=1), first_step=0)
    for _ in range(10):
        world.wait()
    assert world.now == 10


def test_an_empty_road_has_futures() -> None:
    users = driven(straight_scenario(), standing(0.0, steps=4), ReactiveTraffic(future=2))
    assert [len(u.ids) for u in users] == [0, 0, 0]


@pytest.mark.parametrize(
    "wrong", [{"courteous_share": 1.5}, {"speed_deviation": 0.5}, {"reaction_mean": 0.0}]
)
def test_intentions_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Intentions(**wrong)


@pytest.mark.parametrize("settings", [ReactiveSettings(), Intentions()])
def test_the_documentation_has_every_setting_with_its_default(settings: object) -> None:
    page = Path(__file__).parents[3] / "docs" / "traffic.md"
    rows = [line.split("|") for line in page.read_text(encoding="utf-8").splitlines()]
    shown = {row[1].split("`")[1]: row[3].strip() for row in rows if len(row) > 4 and "`" in row[1]}
    for field in fields(settings):  # type: ignore[arg-type]
        if field.name != "intentions":
            assert shown[field.name] == str(getattr(settings, field.name))
