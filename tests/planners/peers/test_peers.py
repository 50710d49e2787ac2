"""The peers' adapters: what they hand over, what they make of the answer, and how they drive."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest
from dosplan_simple.predictors import NonePredictor
from shapely.geometry import box

from dosplan.api import NoPlanError, Planner
from dosplan.plugins.registry import RegistryError, create_planner, find_planner
from dosplan.scenario.synthetic import (
    LANE_WIDTH,
    growing_sets,
    steady_tracks,
    straight_map,
    straight_route,
    straight_scenario,
)
from dosplan.simulation.loop import run_episode
from dosplan.simulation.settings import REALISTIC, LoopSettings
from dosplan.simulation.world import World
from dosplan.types import (
    EGO_VELOCITY,
    EGO_X,
    Arm,
    FloatArray,
    GoalState,
    LightColour,
    Observation,
    Occupancy,
    Plan,
    Scenario,
    StopCause,
)
from dosplan.vehicle import VehicleParameters
from tests.support.factories import ruled_scenario, stop_at, union_of
from tests.support.peers import NEEDS, skip_where_missing

if find_spec("commonroad_dc") is None:
    pytest.skip("needs commonroad-drivability-checker (extra oracle)", allow_module_level=True)

from dosplan_peers.peer import BRAKING, Peer, PeerSettings, Stop, Trajectory, follow
from dosplan_peers.world import (
    commonroad_scenario,
    goal_on_way,
    moving_rectangles,
    reference_path,
    swept,
    wall,
)

VEHICLE = VehicleParameters()
PEERS = [pytest.param(name, marks=skip_where_missing(name)) for name in NEEDS]


def one_set(
    semi_axes: tuple[float, float], angle: float, heading: float, valid: tuple[bool, ...] = (True,)
) -> Occupancy:
    t = len(valid)
    return Occupancy(
        ids=np.array([7]),
        centre=np.zeros((1, t, 2)),
        semi_axes=np.tile(semi_axes, (1, t, 1)),
        angle=np.full((1, t), angle),
        valid=np.array([valid]),
        footprint=np.array([[4.0, 2.0]]),
        heading=np.full((1, t), heading),
    )


def test_each_stretch_on_the_scene_is_an_obstacle_of_its_own() -> None:
    sets = one_set((1.0, 0.0), 0.0, 0.0, (False, True, True, False, True))
    spans = [(o.time_start_idx(), o.time_end_idx()) for o in moving_rectangles(sets, 10, 5)]
    assert spans == [(12, 13), (15, 15)]  # The first column is one step after the present one.
    assert [o.time_end_idx() for o in moving_rectangles(sets, 10, 2)] == [12]
    assert moving_rectangles(replace(sets, valid=np.zeros((1, 5), dtype=np.bool_)), 10, 5) == []
    box = moving_rectangles(sets, 10, 5)[0].obstacle_at_time(12)
    assert (box.r_x(), box.r_y()) == pytest.approx((3.0, 1.0))


def test_each_component_of_a_union_is_an_obstacle_of_its_own() -> None:
    near = one_set((1.0, 0.5), 0.0, 0.0, (True, True))
    far = replace(near, centre=near.centre + np.array([0.0, 30.0]), semi_axes=2.0 * near.semi_axes)
    found = moving_rectangles(union_of([0.25, 0.75], near, far), 10, 2)
    boxes = [obstacle.obstacle_at_time(11) for obstacle in found]
    assert [(box.r_x(), box.r_y()) for box in boxes] == [(4.0, 2.0), (3.0, 1.5)]
    assert [box.center().tolist() for box in boxes] == [[0.0, 30.0], [0.0, 0.0]]


def test_what_is_swept_holds_both_poses() -> None:
    from commonroad_dc import pycrcc

    sets = one_set((0.0, 0.0), 0.0, 0.0, (True, True))
    sets = replace(sets, centre=np.array([[[0.0, 0.0], [20.0, 0.0]]]))
    (moving,) = moving_rectangles(sets, 0, 2)
    between = pycrcc.RectOBB(0.5, 0.5, 0.0, 10.0, 0.0)
    assert not moving.obstacle_at_time(1).collide(between)
    assert swept(moving).obstacle_at_time(1).collide(between)
    (standing,) = moving_rectangles(sets, 0, 1)
    assert swept(standing) is standing


@pytest.mark.parametrize("method", ["obb_rectangles", "aligned_triangulation"])
def test_the_road_has_edges_and_no_others(method: str) -> None:
    from commonroad_dc import pycrcc
    from commonroad_dc.boundary.boundary import create_road_boundary_obstacle

    scenario = commonroad_scenario(straight_map(), 0.1)
    _, edge = create_road_boundary_obstacle(
        scenario, method=method, **({"axis": 2} if method == "aligned_triangulation" else {})
    )
    low, high = -0.5 * LANE_WIDTH, 1.5 * LANE_WIDTH
    for y, hits in ((low + 1.0, False), (0.5 * LANE_WIDTH, False), (high - 1.0, False)):
        assert edge.collide(pycrcc.RectOBB(2.0, 0.9, 0.0, 50.0, y)) is hits
    for y in (low + 0.8, high - 0.8):
        assert edge.collide(pycrcc.RectOBB(2.0, 0.9, 0.0, 50.0, y))


def test_a_footway_is_no_road_for_a_peer() -> None:
    road_map = straight_map()
    lane = road_map.lanelets[0]
    beside = np.array([0.0, 20.0])
    footway = replace(
        lane, id=99, left=lane.left + beside, right=lane.right + beside, is_road=False
    )
    scenario = commonroad_scenario(replace(road_map, lanelets=(*road_map.lanelets, footway)), 0.1)
    names = {lanelet.lanelet_id for lanelet in scenario.lanelet_network.lanelets}
    assert names == {lanelet.id for lanelet in road_map.lanelets}


def test_the_goal_is_the_one_that_the_route_comes_by() -> None:
    aside, ahead, anywhere = (
        GoalState(0, 50, box(20.0, 40.0, 30.0, 50.0)),
        GoalState(0, 50, box(20.0, -1.0, 30.0, 1.0)),
        GoalState(0, 50),
    )
    for goals, wanted in (
        ([aside, ahead], ahead),
        ([anywhere, ahead], anywhere),
        ([ahead, aside], ahead),
        ([aside], aside),
    ):
        assert goal_on_way(straight_scenario(goals=goals).task) == wanted


def test_the_path_goes_on_straight_at_both_ends() -> None:
    route = straight_route()
    path = reference_path(route)
    assert np.allclose(np.diff(path, axis=0), [0.5, 0.0])
    assert path[0, 0] == pytest.approx(route.path[0, 0] - 29.5)
    assert path[-1, 0] == pytest.approx(route.path[-1, 0] + 29.5)


class Ramp(Peer):
    """Speeds up more and more, and remembers what it was told."""

    name = "ramp-v1"
    delay = 0.5

    def build(self, *anything: object) -> None:
        self.told: list[tuple[float, FloatArray | None]] = []

    def find(
        self,
        observation: Observation,
        occupancy: Occupancy,
        acceleration: float,
        frenet: FloatArray | None,
        stop: Stop | None,
    ) -> Trajectory:
        self.told.append((acceleration, frenet))
        self.stop = stop
        return trajectory(np.zeros(4), 10.0 + 0.1 * np.arange(4.0), fallback="ramp")


def trajectory(
    steering: FloatArray, velocity: FloatArray, fallback: str | None = None
) -> Trajectory:
    """A trajectory along the x axis; everything else counts the steps."""
    steps = np.arange(float(len(steering)))
    position = np.stack([steps, np.zeros_like(steps)], axis=1)
    return Trajectory(steering, velocity, steps, position, np.tile(steps[:, None], 6), fallback)


def test_what_was_foreseen_comes_back_until_the_next_episode() -> None:
    scenario, ramp = straight_scenario(), Ramp()
    for _ in range(2):
        ramp.reset(scenario.task, scenario.road_map, VEHICLE)
        for step, x in ((0, 0.0), (2, 2.008), (3, 1.012), (9, 3.0)):  # Foreseen: 2, 1, 3.
            seen = World(scenario, first_step=step, history=31).observation()
            history = np.array(seen.ego_history)
            history[-2] = seen.ego - [1.0, 0.0, 0.0, 0.05, 0.0]
            ego = seen.ego + np.array([x, 0.0, 0.0, 0.0, 0.0])
            plan = ramp.plan(replace(seen, ego=ego, ego_history=history), growing_sets(seen))
        accelerations, states = zip(*ramp.told, strict=True)
        # At first nothing was foreseen; 8 mm off the foreseen place is near, 12 mm is not: there
        # the acceleration is that of the step before.
        assert accelerations == pytest.approx((0.0, 2.0, 0.5, 3.0))
        assert [None if state is None else state.tolist() for state in states] == [
            None,
            [2.0] * 6,
            None,
            [3.0] * 6,
        ]
    assert plan.report.fallback == "ramp"


@pytest.mark.parametrize(
    ("colour", "rules", "stops"),
    [
        (LightColour.RED, True, True),
        (LightColour.RED, False, False),
        (LightColour.GREEN, True, False),
    ],
)
def test_a_wall_stands_where_a_rule_asks_for_a_stop(
    colour: LightColour, rules: bool, stops: bool
) -> None:
    line = VEHICLE.rear_to_centre + 0.5 * VEHICLE.length + 20.0
    light = stop_at(StopCause.LIGHT, line, line + 20.0, lights=(7,))
    scenario = ruled_scenario(light, lights={7: [colour]})
    ramp = Ramp(settings=PeerSettings(rules=rules))
    ramp.reset(scenario.task, scenario.road_map, VEHICLE)
    seen = World(scenario).observation()
    plan = ramp.plan(seen, growing_sets(seen))
    assert plan.report.fallback == "ramp"
    assert plan.report.waits_for == ("light 7" if stops else None)
    if not stops:
        assert ramp.stop is None
        return
    assert ramp.stop is not None  # Half a metre before the line, 20 m ahead; half a second is 5 m.
    assert ramp.stop.velocity == pytest.approx(np.sqrt(2.0 * BRAKING * 14.5))
    for wide in (wall(ramp.stop, 3, 2).obstacle_at_time(step) for step in (3, 5)):
        face = wide.center()[0] - wide.r_x(), wide.center()[1]
        assert face == pytest.approx((line - 0.5, 0.0))
        assert wide.r_y() > 3.0 + 0.5 * VEHICLE.width


def test_a_trajectory_that_can_be_driven_is_driven_as_it_is() -> None:
    ego = VEHICLE.state_at(np.zeros(2), 0.3, 8.0, 0.05)
    inputs = np.stack([np.linspace(-0.2, 0.2, 20), np.linspace(2.0, -3.0, 20)], axis=1)
    states = [ego]
    for u in inputs:
        states.append(VEHICLE.step(states[-1], u, 0.1))
    wanted = np.stack(states)
    plan = follow(ego, trajectory(wanted[:, 2], wanted[:, 3]), VEHICLE, 0.1)
    assert np.allclose(plan.states, wanted, atol=1e-9)
    assert np.allclose(plan.inputs, inputs, atol=1e-9)


def test_a_trajectory_that_cannot_be_driven_is_cut_to_what_can() -> None:
    ego = VEHICLE.state_at(np.zeros(2), 0.0, 8.0)
    plan = follow(ego, trajectory(np.full(3, 0.5), np.array([8.0, 0.0, 0.0])), VEHICLE, 0.1)
    assert plan.inputs[0, 0] == pytest.approx(VEHICLE.max_steering_rate)
    assert -VEHICLE.max_acceleration <= plan.inputs[0, 1] < -10.0


@pytest.mark.parametrize(("name", "module"), [(k, v[0]) for k, v in NEEDS.items()])
def test_a_peer_that_is_not_installed_says_what_to_do(
    name: str, module: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for loaded in [one for one in sys.modules if one.startswith(f"{module}.")]:
        monkeypatch.delitem(sys.modules, loaded)  # Found there, a part needs no whole.
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, f"dosplan_peers.{name}", raising=False)
    with pytest.raises(RegistryError, match=r"pip install 'dosplan\[peers\]'") as caught:
        find_planner(name)
    assert "\n" not in str(caught.value)


def first_plan(name: str, scenario: Scenario, semi_axis: float = 0.0) -> Plan:
    """The first plan; the sets are circles of a radius, m."""
    planner: Planner = create_planner(name, 0)
    planner.reset(scenario.task, scenario.road_map, VEHICLE)
    seen = World(scenario, first_step=scenario.task.start_step, history=31).observation()
    sets = growing_sets(seen)
    return planner.plan(seen, replace(sets, semi_axes=np.full(sets.semi_axes.shape, semi_axis)))


def behind(gap: float, *, velocity: float = 0.0, ego: float = 10.0) -> Scenario:
    """Cars side by side on both lanes, whose rears are so far ahead of the ego's front, m."""
    front = VEHICLE.rear_to_centre + 0.5 * VEHICLE.length
    x = front + gap + 0.5 * 4.5
    rows: list[FloatArray] = [np.array([x, y, 0.0, velocity]) for y in (0.0, LANE_WIDTH)]
    return straight_scenario(steady_tracks(np.stack(rows)), velocity=ego)


@pytest.mark.parametrize("name", PEERS)
def test_a_peer_keeps_its_speed_and_lane_where_nothing_is_in_the_way(name: str) -> None:
    states = first_plan(name, straight_scenario()).states
    # The reactive planner's samples are steps of 0.6 m/s, and 10 m/s need not be one of them.
    assert np.abs(states[:, EGO_VELOCITY] - 10.0).max() < 0.6
    assert np.abs(states[:, 1]).max() < 0.05


@pytest.mark.parametrize("name", PEERS)
def test_a_peer_stays_clear_of_a_wall_of_cars(name: str) -> None:
    plan = first_plan(name, behind(16.0))
    assert plan.report.fallback is None
    assert plan.states[:, 0].max() < 16.0


@pytest.mark.parametrize("name", PEERS)
def test_a_set_asks_for_room_that_a_position_does_not(name: str) -> None:
    wall = behind(19.0)
    alone, with_set = (first_plan(name, wall, radius) for radius in (0.0, 4.0))
    assert with_set.states[:, 0].max() < 15.0 < alone.states[:, 0].max() < 19.0


@pytest.mark.parametrize("name", PEERS)
def test_a_peer_in_a_hopeless_place_does_what_its_own_script_does(name: str) -> None:
    hopeless = behind(2.0, ego=15.0)
    if name == "reactive":
        with pytest.raises(NoPlanError):
            first_plan(name, hopeless)
    else:
        plan = first_plan(name, hopeless)
        assert plan.report.fallback == "stopping"
        assert plan.states[-1, EGO_VELOCITY] < 1.0


@pytest.mark.parametrize("loop", [LoopSettings(), LoopSettings(period=0.5), REALISTIC])
@pytest.mark.parametrize("name", PEERS)
def test_a_peer_stops_at_a_red_light_and_drives_on_when_it_turns_green(
    name: str, loop: LoopSettings
) -> None:
    line, front = 45.0, VEHICLE.rear_to_centre + 0.5 * VEHICLE.length
    light = stop_at(StopCause.LIGHT, line, line + 20.0, lights=(7,))
    colours = [LightColour.RED] * 100 + [LightColour.GREEN]
    ahead = box(120.0, -1.75, 160.0, 1.75)
    scenario = ruled_scenario(
        light,
        lights={7: colours},
        seconds=14.0,
        goals=(GoalState(first_step=100, last_step=140, region=ahead),),
    )
    planner = create_planner(name, 0)
    episode = run_episode(scenario, planner, NonePredictor(), Arm.WITH_DOS, loop)
    assert episode.error is None
    x, velocity = episode.states[:, EGO_X] + front, episode.states[:, EGO_VELOCITY]
    assert line - 2.5 < x[:101].max() <= line
    assert velocity[95:101].max() < 1.0  # It may creep on to the line.
    assert x[-1] > line + 5.0
    assert {plan.report.fallback for plan in episode.plans} == {None}


@skip_where_missing("frenetix")
def test_frenetix_sorts_by_the_whole_cost_and_asks_for_the_risk_of_few() -> None:
    from dosplan_peers.frenetix import _cheapest_first

    rng = np.random.default_rng(0)
    cheap, risk = rng.uniform(0.0, 10.0, (2, 60))
    samples = [SimpleNamespace(cost=cost, row=row) for row, cost in enumerate(cheap)]
    asked: list[int] = []

    def evaluate(sample: SimpleNamespace) -> None:
        asked.append(sample.row)
        sample.cost += risk[sample.row]

    ranked = _cheapest_first(samples, SimpleNamespace(evaluate_trajectory=evaluate))
    order = np.argsort(cheap + risk)
    assert next(ranked).row == order[0]
    assert sorted(asked) == sorted(np.flatnonzero(cheap < (cheap + risk)[order[0]]))
    assert [sample.row for sample in ranked] == list(order[1:])
    assert len(asked) == len(samples)
