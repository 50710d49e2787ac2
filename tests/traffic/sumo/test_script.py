"""Scripts that tell SUMO's road users what to do."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dosplan.types import FloatArray
from tests.support.suite import SUITE

pytest.importorskip("libsumo", reason="needs dosplan[sumo]")

from dosplan_sumo.script import (
    Action,
    Executor,
    Script,
    Verb,
    read_script,
    script_json,
)
from dosplan_sumo.simulator import Simulation

NET = SUITE / "sumo-files" / "ZAM_OnRamp-1.net.xml.gz"
EDGE = "main"
SPEED = 15.0
DT = 0.1
CALM = f'<vType id="calm" sigma="0" speedDev="0" maxSpeed="{SPEED}" emergencyDecel="8"/>'
DEMAND = f"""<routes>{CALM}
<vType id="person" vClass="passenger" length="0.4" width="0.5" minGap="0.5" minGapLat="0.3"/>
<trip id="car" type="calm" from="{EDGE}" to="{EDGE}" depart="0" departPos="30" departLane="0"
      departSpeed="{SPEED}" insertionChecks="none"/>
<trip id="walker" type="person" from="{EDGE}" to="{EDGE}" depart="0" departPos="150"
      departLane="0" departSpeed="0" insertionChecks="none"/>
</routes>"""


class Stage:
    """A car on a motorway, 15 m/s fast, and somebody on foot 120 m ahead of it.

    Or what else is put on a network of the suite; the car is there at any rate.
    """

    def __init__(self, folder: Path, demand: str = DEMAND, net: Path = NET) -> None:
        (folder / "net.net.xml").write_bytes(gzip.decompress(net.read_bytes()))
        (folder / "demand.rou.xml").write_text(demand)
        options = {"lateral-resolution": "0.4", "seed": "1"}
        files = (folder / "net.net.xml", [folder / "demand.rou.xml"])
        self.simulation = Simulation(*files, DT, options, folder)
        self.sumo: Any = self.simulation.sumo
        self.executor = Executor(self.sumo)
        self.simulation.step()
        line = np.array(self.sumo.lane.getShape(self.sumo.vehicle.getLaneID("car")))
        self.ahead = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
        self.left = np.array([-self.ahead[1], self.ahead[0]])

    def play(self, script: Script, steps: int) -> dict[str, FloatArray]:
        """(steps, 3) place, m, and speed, m/s, of all who are on the road from the beginning."""
        self.executor.play(script, self.simulation.time)
        vehicle = self.sumo.vehicle
        rows: dict[str, list[tuple[float, float, float]]] = {x: [] for x in vehicle.getIDList()}
        for _ in range(steps):
            self.executor.step(self.simulation.time, DT)
            self.simulation.step()
            for name, row in rows.items():
                row.append((*vehicle.getPosition(name), vehicle.getSpeed(name)))
        return {name: np.array(row) for name, row in rows.items()}

    def aside(self, metres: float) -> tuple[float, float]:
        """A place so far to the right of the walker's lane at its middle."""
        x, y = np.array(self.sumo.vehicle.getPosition("walker")) - metres * self.left
        return float(x), float(y)


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    """A stage that is cleared at the end."""
    with staged(tmp_path) as made:
        yield made


@contextmanager
def staged(folder: Path, *trips: str, net: str = "") -> Iterator[Stage]:
    """A stage that is cleared at the end: the usual one, or with these trips, on another net."""
    demand = f"<routes>{CALM}{''.join(trips)}</routes>" if trips else DEMAND
    path = SUITE / "sumo-files" / f"{net}.net.xml.gz" if net else NET
    made = Stage(folder, demand, path)
    try:
        yield made
    finally:
        made.simulation.close()


def trip(
    name: str,
    begin: str,
    end: str,
    place: float,
    speed: float = SPEED,
    inside: str = "",
    lane: str = "first",
) -> str:
    """Somebody who is at a place of an edge at the beginning, m; from its end where negative."""
    return (
        f'<trip id="{name}" type="calm" from="{begin}" to="{end}" depart="0" departPos="{place}" '
        f'departLane="{lane}" departSpeed="{speed}" insertionChecks="none">{inside}</trip>'
    )


def _away(stage: Stage) -> Action:
    return Action(0.0, "walker", Verb.WAIT, way=(stage.aside(5.0),))


def test_brakes_as_told_and_holds_it(stage: Stage) -> None:
    braking = Action(0.5, "car", Verb.BRAKE, 3.0, over=1.6)
    speed = stage.play((_away(stage), braking), 60)["car"][:, 2]
    np.testing.assert_allclose(speed[:5], SPEED, atol=1e-6)
    np.testing.assert_allclose(np.diff(speed[5:20]), -7.5 * DT, atol=1e-6)
    np.testing.assert_allclose(speed[22:], 3.0, atol=1e-6)


def test_halts_stands_and_goes_on(stage: Stage) -> None:
    speed = stage.play((_away(stage), Action(0.0, "car", Verb.HALT, 6.0, over=1.0)), 60)["car"][
        :, 2
    ]
    assert np.flatnonzero(speed < 1e-6)[0] == pytest.approx(25, abs=1)
    assert np.count_nonzero(speed < 1e-6) == pytest.approx(10, abs=2)
    assert speed[-1] > 2.0


def test_speed_is_taken_up_and_freedom_given_back(stage: Stage) -> None:
    script = (Action(0.0, "car", Verb.SPEED, 10.0), Action(3.0, "car", Verb.FREE))
    speed = stage.play((_away(stage), *script), 60)["car"][:, 2]
    assert speed[28] == pytest.approx(10.0)
    assert speed[-1] > 13.0


def test_changes_lanes_whoever_is_there(stage: Stage) -> None:
    """It ends in the middle of the lane, and stays there."""
    stage.play((_away(stage), Action(0.0, "car", Verb.LANE, 1.0)), 60)
    assert stage.sumo.vehicle.getLaneIndex("car") == 1
    assert stage.sumo.vehicle.getLateralLanePosition("car") == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("keeps", [True, False])
def test_keeps_to_its_lane_behind_whoever_is_slow(tmp_path: Path, keeps: bool) -> None:
    """60 m ahead somebody drives at 5 m/s; the lane beside is free."""
    trips = (trip("car", EDGE, EDGE, 30.0), trip("tractor", EDGE, EDGE, 90.0, 5.0))
    script = (
        Action(0.0, "tractor", Verb.SPEED, 5.0),
        Action(0.0, "tractor", Verb.KEEP),
        *([Action(0.0, "car", Verb.KEEP)] if keeps else []),
    )
    with staged(tmp_path, *trips) as stage:
        speed = stage.play(script, 100)["car"][:, 2]
        lane = stage.sumo.vehicle.getLaneIndex("car")
        ahead = stage.sumo.vehicle.getLanePosition("car") > (
            stage.sumo.vehicle.getLanePosition("tractor")
        )
    assert ahead is not keeps
    assert lane == 0 or not keeps
    assert speed[-1] == pytest.approx(5.0 if keeps else SPEED, abs=1.0)


def test_goes_on_to_another_edge(stage: Stage) -> None:
    """Its route ends with the edge that it is on: 230 m ahead, which it drives in 15 s."""
    told = Action(0.0, "car", Verb.ROUTE, edge="out")
    stage.play((_away(stage), told), 2)
    assert stage.sumo.vehicle.getRoute("car") == (EDGE, "merge", "out")
    stage.play((), 170)
    assert stage.sumo.vehicle.getRoadID("car") == "merge"


@pytest.mark.parametrize("careless", [True, False])
def test_the_careless_run_a_red_light(tmp_path: Path, careless: bool) -> None:
    """It is red for 45 s, and 70 m away, which the car drives in less than 7 s."""
    car = trip("car", "a0-", "a2+", -70.0, 10.0, lane="best")  # The first is the sidewalk.
    with staged(tmp_path, car, net="ZAM_Signal-1") as stage:
        script = (Action(0.0, "car", Verb.CARELESS),) if careless else ()
        speed = stage.play(script, 100)["car"][:, 2]
        edge = stage.sumo.vehicle.getRoadID("car")
    assert edge == ("a2+" if careless else "a0-")
    assert speed[-1] == pytest.approx(13.89 if careless else 0.0, abs=0.1)  # Its limit.


@pytest.mark.parametrize("told", ["careless", "careless, then free", "nothing"])
def test_the_careless_do_not_give_way(tmp_path: Path, told: str) -> None:
    """The car comes from a side road; on the other one three drive past, 20 m apart."""
    others = (trip(f"other{i}", "a0-", "a1+", -78.0 - 20.0 * i) for i in range(3))
    car = trip("car", "a2-", "a0+", -60.0, 10.0)
    script = {
        "careless": (Action(0.0, "car", Verb.CARELESS),),
        "careless, then free": (
            Action(0.0, "car", Verb.CARELESS),
            Action(0.5, "car", Verb.FREE),
        ),
        "nothing": (),
    }[told]
    with staged(tmp_path, car, *others, net="ZAM_TJunction-1") as stage:
        speed = stage.play(script, 80)["car"][:, 2]
    if told == "careless":
        assert speed.min() > 9.0  # It slows down for the bend alone.
    else:
        assert speed.min() < 4.0


def test_the_careless_keep_the_other_rules_as_they_were(stage: Stage) -> None:
    """Of SUMO's bits, 1 and 2 are safe speeds, 4 bounds braking; 32 frees it of foes inside."""
    mode = stage.sumo.vehicle.getSpeedMode
    stage.play((_away(stage), Action(0.0, "car", Verb.CARELESS)), 1)
    assert mode("car") == 1 + 2 + 4 + 32
    stage.play((Action(0.0, "car", Verb.BRAKE, 5.0, over=1.0),), 1)
    stage.play((Action(0.0, "car", Verb.CARELESS),), 1)
    assert mode("car") == 1 + 2 + 32
    stage.play((Action(0.0, "car", Verb.FREE),), 1)
    assert mode("car") == 1 + 2 + 4 + 8 + 16


@pytest.mark.parametrize("starts", [True, False])
def test_leaves_the_place_where_it_stops(tmp_path: Path, starts: bool) -> None:
    """It stops for 1000 s at 80 m, where it stands after 5 s, and is told to start after 8 s."""
    stop = f'<stop lane="{EDGE}_0" endPos="80" duration="1000"/>'
    script = (Action(8.0, "car", Verb.START),) if starts else ()
    with staged(tmp_path, trip("car", EDGE, EDGE, 30.0, inside=stop)) as stage:
        speed = stage.play(script, 120)["car"][:, 2]
        place = stage.sumo.vehicle.getLanePosition("car")
    stands = np.flatnonzero(speed < 1e-6)
    assert stands[0] == pytest.approx(50, abs=3)
    assert stands[-1] == (79 if starts else 119)
    assert place > 90.0 if starts else place == pytest.approx(80.0, abs=0.5)


def test_drives_aside_of_the_middle(stage: Stage) -> None:
    stage.play((_away(stage), Action(0.0, "car", Verb.ASIDE, 0.5)), 40)
    assert stage.sumo.vehicle.getLateralLanePosition("car") == pytest.approx(0.5, abs=0.05)


def test_who_steps_onto_the_road_is_seen(stage: Stage) -> None:
    begin = stage.aside(5.0)
    waiting = stage.play((Action(0.0, "walker", Verb.WAIT, way=(begin,)),), 20)
    np.testing.assert_allclose(waiting["walker"][1:, :2], [begin] * 19, atol=1e-6)
    assert waiting["car"][-1, 2] == pytest.approx(SPEED)
    end = stage.aside(-20.0)
    walking = Action(0.0, "walker", Verb.WALK, 1.5, way=(end,))
    driven = stage.play((walking,), 60)
    way = np.linalg.norm(driven["walker"][:, :2] - begin, axis=1)
    np.testing.assert_allclose(way, 1.5 * DT * np.arange(1, 61), atol=1e-6)
    assert driven["car"][:, 2].min() < SPEED - 2.0


def test_walks_along_its_line_as_fast_as_it_gets(stage: Stage) -> None:
    begin = np.array(stage.aside(5.0))
    corner, end = begin + 1.0 * stage.ahead, begin + 1.0 * stage.ahead + 2.0 * stage.left
    script = (
        Action(0.0, "walker", Verb.WAIT, way=(tuple(begin.tolist()),)),
        Action(
            0.1,
            "walker",
            Verb.WALK,
            2.0,
            over=1.0,
            way=(tuple(corner.tolist()), tuple(end.tolist())),
        ),
    )
    places = stage.play(script, 40)["walker"][:, :2]
    pace = np.linalg.norm(np.diff(places, axis=0), axis=1) / DT
    np.testing.assert_allclose(pace[:5], 0.2 * np.arange(1, 6), atol=1e-6)
    np.testing.assert_allclose(places[-1], end, atol=1e-6)
    assert np.min(np.linalg.norm(places - corner, axis=1)) < 0.2


def test_nobody_is_told_who_is_not_there(stage: Stage) -> None:
    stage.play((Action(0.0, "nobody", Verb.SPEED, 1.0),), 2)


def test_a_script_is_kept_as_text() -> None:
    script = (
        Action(0.0, "car", Verb.BRAKE, 3.0, over=1.5),
        Action(1.2, "car", Verb.ROUTE, edge="out"),
        Action(0.0, "walker", Verb.WALK, 1.4, way=((0.0, 1.0), (2.0, 3.5))),
    )
    assert read_script(json.loads(json.dumps(script_json(script)))) == script


@pytest.mark.parametrize(
    "row",
    [{}, {"at": 0, "actor": "car", "verb": "fly"}, {"at": "soon", "actor": "a", "verb": "free"}],
)
def test_what_is_no_action_is_named(row: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="no action of a script"):
        read_script([row])
