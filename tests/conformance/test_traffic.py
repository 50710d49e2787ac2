"""The checks of traffic: what is installed passes, what is bad fails at its own rule."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dosplan.cli.command import BAD_INPUT, FAILED, OK
from dosplan.cli.main import main
from dosplan.plugins import traffic_conformance
from dosplan.plugins.traffic_conformance import check_traffic
from dosplan.scenario.synthetic import busy_scenario
from dosplan.simulation.traffic import Replay, RoadUsers, Traffic
from dosplan.types import FloatArray, Scenario, Tracks
from tests.support.futures import stopped
from tests.support.traffic import ShyTraffic

FILE_BOUND = "sumo"  # It drives what has files of SUMO; its own tests check it there.


@pytest.mark.parametrize(
    "offer",
    [x for x in entry_points(group="dosplan.traffic") if x.name != FILE_BOUND],
    ids=lambda offer: offer.name,
)
def test_every_installed_traffic_conforms(offer: EntryPoint) -> None:
    assert check_traffic(offer.load()).failures == ()


class Good(Replay):
    """A replay that does not say that it is one; the bad ones below each break one rule."""

    name = "good-v1"

    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        both = replace(scenario, futures=(scenario.tracks,))  # As a replay of either future.
        return super().begin(both, first_step)


class NoFuture(Good):
    def __init__(self, *, seed: int = 0, settings: Any = None) -> None:
        super().__init__(seed=seed)


class NeedsFiles(Good):
    @classmethod
    def refuses(cls, scenario: Scenario) -> str | None:
        return "has no files beside it"


class Elsewhere(Good):
    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        return scenario.tracks


class Nameless(Good):
    name = "mine"


class Dice(Good):
    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        users = super().step(step, ego)
        return replace(users, states=users.states + np.random.default_rng().normal())


class DicedFutures(Good):
    has_futures = True

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        users = super().step(step, ego)
        noise = np.random.default_rng().normal() if self.future else 0.0
        return replace(users, states=users.states + noise)


class Remembers(Good):
    met = 0

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        self.met += 1
        users = super().step(step, ego)
        return replace(users, states=users.states + 0.001 * self.met)


class OtherPasts(Good):
    has_futures = True

    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        past = super().begin(scenario, first_step)
        return replace(past, states=past.states + 0.1 * self.future)


class MovesTheEgo(Good):
    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        ego[-1] += 1.0
        return super().step(step, ego)


class Leaps(Good):
    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        users = super().step(step, ego)
        return replace(users, states=users.states + 50.0 * (step % 2))


class Grows(Good):
    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        users = super().step(step, ego)
        return replace(users, size=users.size + 0.01 * step)


class SaysItReplays(Replay):
    name = "says-it-replays-v1"
    as_recorded = True

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        users = super().step(step, ego)
        return replace(users, states=users.states + 0.1 * (len(ego) > 10))


class FearsTheVoid(Good):
    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        users = super().step(step, ego)
        users.states[:, 0].max()
        return users


class HatesCrowds(Good):
    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        if len(scenario.tracks.ids) > 20:
            raise MemoryError("at most 20 road users")
        return super().begin(scenario, first_step)


class CannotBeginAgain(Good):
    closed = False

    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        if self.closed:
            raise OSError("the simulator is gone")
        return super().begin(scenario, first_step)

    def close(self) -> None:
        self.closed = True


BAD: list[tuple[type[Any], str, str]] = [
    (NoFuture, "constructs", "unexpected keyword argument 'future'"),
    (
        NeedsFiles,
        "drives",
        "name one that it drives with --scenario FILE (it says that the scene has",
    ),
    (Elsewhere, "drives", "begin must return Tracks of the steps 0 to"),
    (Grows, "drives", "has another kind, size or outline than before"),
    (Nameless, "versioned_name", "give it a version"),
    (Dice, "deterministic", "differ in future 0"),
    (DicedFutures, "deterministic", "differ in future 1"),
    (Remembers, "begin_forgets", "begin() must clear what an episode left behind"),
    (CannotBeginAgain, "begin_forgets", "the simulator is gone"),
    (OtherPasts, "one_past", "gives futures another past"),
    (MovesTheEgo, "input_untouched", "changed the ego's states"),
    (Leaps, "ids_kept", "an id belongs to one road user"),
    (SaysItReplays, "as_recorded", "leave as_recorded out"),
    (FearsTheVoid, "no_road_users", "zero-size array"),
    (HatesCrowds, "many_road_users", "at most 20 road users"),
]
ALSO = {"deterministic": {"begin_forgets"}}


@pytest.mark.parametrize(("traffic", "name", "message"), BAD, ids=[bad[0].__name__ for bad in BAD])
def test_a_bad_traffic_fails_at_its_own_rule(
    traffic: type[Traffic], name: str, message: str
) -> None:
    found = {check.name: check.message for check in check_traffic(traffic).failures}
    assert message in found[name]
    assert "\n" not in found[name]
    assert set(found) - ALSO.get(name, set()) == {name}


def test_a_slow_one_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(traffic_conformance, "SLOW_SECONDS", 0.0)
    (failure,) = check_traffic(Good).failures
    assert failure.name == "time"
    assert "move what does not change to begin()" in failure.message


def test_one_that_reacts_passes_on_scenes_in_code_and_on_a_scenario_of_ones_own() -> None:
    assert check_traffic(ShyTraffic).ok
    own = check_traffic(ShyTraffic, busy_scenario(velocity=4.0))
    assert own.ok
    assert "no_road_users" not in {check.name for check in own.checks}


def test_the_command_says_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec = f"{Path(__file__)}:{Grows.__name__}"
    assert main(["check", spec]) == FAILED
    shown = capsys.readouterr().out
    assert "has another kind, size or outline than before" in " ".join(shown.split())
    assert main(["check", "replay"]) == OK
    assert main(["check", "replay", "--scenario", str(tmp_path / "none.xml")]) == BAD_INPUT
    assert main(["check", "cruise", "--kind", "planner", "--scenario", "x.xml"]) == BAD_INPUT
    assert "--scenario is for traffic" in capsys.readouterr().err


def test_a_name_of_two_kinds_has_to_be_told_apart(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "reactive"]) == BAD_INPUT
    assert "reactive is a planner and a traffic" in capsys.readouterr().err
    assert main(["check", "reactive", "--kind", "traffic"]) == OK


def test_a_replay_is_checked_in_all_futures_of_a_scenario() -> None:
    scene = busy_scenario()
    scene = replace(scene, futures=(stopped(scene.tracks, 100, scene.task.start_step),))
    assert check_traffic(Replay, scene).failures == ()

    class FirstOnly(Replay):
        """It says that it has futures, and drives the first one always."""

        name = "first-only-v1"
        as_recorded = True
        has_futures = True

        def begin(self, scenario: Scenario, first_step: int) -> Tracks:
            return super().begin(replace(scenario, futures=(scenario.tracks,)), first_step)

    found = {check.name: check.message for check in check_traffic(FirstOnly, scene).failures}
    assert "departs from the recording" in found["as_recorded"]
