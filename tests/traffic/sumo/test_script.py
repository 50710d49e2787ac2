"""Scripts that tell SUMO's road users what to do."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator
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
DEMAND = f"""<routes>
<vType id="calm" sigma="0" speedDev="0" maxSpeed="{SPEED}" emergencyDecel="8"/>
<vType id="person" vClass="passenger" length="0.4" width="0.5" minGap="0.5" minGapLat="0.3"/>
<trip id="car" type="calm" from="{EDGE}" to="{EDGE}" depart="0" departPos="30" departLane="0"
      departSpeed="{SPEED}" insertionChecks="none"/>
<trip id="walker" type="person" from="{EDGE}" to="{EDGE}" depart="0" departPos="150"
      departLane="0" departSpeed="0" insertionChecks="none"/>
</routes>"""


class Stage:
    """A car on a motorway, 15 m/s fast, and somebody on foot 120 m ahead of it."""

    def __init__(self, folder: Path) -> None:
        (folder / "net.net.xml").write_bytes(gzip.decompress(NET.read_bytes()))
        (folder / "demand.rou.xml").write_text(DEMAND)
        options = {"lateral-resolution": "0.4", "seed": "1"}
        files = (folder / "net.net.xml", [folder / "demand.rou.xml"])
        self.simulation = Simulation(*files, DT, options, folder)
        self.sumo: Any = self.simulation.sumo
        self.executor = Executor(self.sumo)
        self.simulation.step()
        line = np.array(self.sumo.lane.getShape(f"{EDGE}_0"))
        self.ahead = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
        self.left = np.array([-self.ahead[1], self.ahead[0]])

    def play(self, script: Script, steps: int) -> dict[str, FloatArray]:
        """(steps, 3) place, m, and speed, m/s, of both."""
        self.executor.play(script, self.simulation.time)
        rows: dict[str, list[tuple[float, float, float]]] = {"car": [], "walker": []}
        vehicle = self.sumo.vehicle
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
    made = Stage(tmp_path)
    yield made
    made.simulation.close()


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
