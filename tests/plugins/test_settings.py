"""Options become settings: by name, by type and in range, and back to plain values."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import pytest
from dosplan_dos.predictor import DosSettings
from dosplan_simple.predictors import (
    ConstantTurnRatePredictor,
    ConstantVelocityPredictor,
    TurnRateSettings,
)
from dosplan_simple.sets import FixedCirclePredictor, FixedCircleSettings, GrowingCircleSettings

from dosplan.api import PluginSpec, Predictor, PredictorSettings
from dosplan.plugins.registry import RegistryError, choose_planner, choose_predictor, record
from dosplan.plugins.settings import SettingsError, apply_options, plain_settings


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Style:
    lateral: float = 4.0
    colour: Colour = Colour.RED

    def __post_init__(self) -> None:
        if self.lateral < 0.0:
            raise ValueError(f"lateral is {self.lateral}, expected 0 or more")


@dataclass(frozen=True)
class Settings:
    steps: int = 3
    gap: float = 1.0
    limit: float | None = None
    fast: bool = False
    table: Path | None = None
    range: tuple[float, float] = (0.0, 1.0)
    weights: dict[str, float] | None = None
    calm: Style = Style()
    hurried: Style = Style(lateral=7.0)


@pytest.mark.parametrize(
    ("options", "changes"),
    [
        ({}, {}),
        ({"steps": 5, "gap": 2, "limit": 2.5}, {"steps": 5, "gap": 2.0, "limit": 2.5}),
        ({"gap": "1e-3", "limit": "-2.5E+2"}, {"gap": 0.001, "limit": -250.0}),
        ({"limit": None, "fast": True, "table": "a/b"}, {"fast": True, "table": Path("a/b")}),
        ({"range": [1, 2], "weights": {"a": 1}}, {"range": (1.0, 2.0), "weights": {"a": 1.0}}),
        ({"calm.lateral": 1}, {"calm": Style(lateral=1.0)}),
        ({"calm": {"colour": "blue"}}, {"calm": Style(colour=Colour.BLUE)}),
        # What is not named keeps the value that it has in this place.
        ({"hurried.colour": "blue"}, {"hurried": Style(7.0, Colour.BLUE)}),
        (
            {"hurried.colour": "blue", "hurried": {"lateral": 2}},
            {"hurried": Style(2.0, Colour.BLUE)},
        ),
    ],
)
def test_options_change_settings(options: dict[str, Any], changes: dict[str, Any]) -> None:
    wanted = replace(Settings(), **changes)
    found = apply_options(Settings(), options)
    assert found == wanted
    assert type(found.gap) is float
    plain = plain_settings(found, lambda plugin: ("", ""))
    assert apply_options(Settings(), plain) == wanted


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"step": 5}, "takes no option 'step'; did you mean 'steps'? (options: calm, fast, gap, "),
        ({"calm.latral": 5}, "takes no option 'calm.latral'; did you mean 'lateral'? (options: "),
        ({"steps.few": 5}, "takes no option 'steps.few'"),
        ({"steps": "many"}, "option 'steps' is 'many', expected int"),
        ({"steps": 5.0}, "option 'steps' is 5.0, expected int"),
        ({"steps": True}, "option 'steps' is True, expected int"),
        ({"steps": None}, "option 'steps' is None, expected int"),
        ({"gap": "1e400"}, "option 'gap' is inf, expected a finite number"),
        ({"gap": float("nan")}, "option 'gap' is nan, expected a finite number"),
        ({"gap": "\ud800"}, "option 'gap' is '\\ud800', expected a text that can be written down"),
        ({"gap": "1e"}, "option 'gap' is '1e', expected float"),
        ({"limit": "none"}, "option 'limit' is 'none', expected float | None"),
        ({"fast": 1}, "option 'fast' is 1, expected bool"),
        ({"table": 3}, "option 'table' is 3, expected a path"),
        ({"range": [1]}, "option 'range' is [1], expected array of length 2"),
        ({"calm": 3}, "option 'calm' is 3, expected a mapping"),
        ({"calm": {3: 4}}, "option 'calm' is no mapping of names to values"),
        ({"calm.colour": "green"}, "option 'calm.colour' is 'green', expected 'red' or 'blue'"),
        ({"calm.colour": [1]}, "option 'calm.colour' is [1], expected 'red' or 'blue'"),
        ({"calm.lateral": -1}, "option 'calm': lateral is -1.0, expected 0 or more"),
        ({"steps": "x" * 1000}, f"option 'steps' is '{'x' * 59} ..., expected int"),
    ],
)
def test_a_wrong_option_is_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError) as caught:
        apply_options(Settings(), options)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


TURNING = PluginSpec(ConstantTurnRatePredictor, TurnRateSettings(horizon=50))


@pytest.mark.parametrize(
    "options",
    [
        {"base": "constant-turn-rate", "base.horizon": 50},
        {"base.horizon": 50, "base": "constant-turn-rate"},
        {"base": {"predictor": "constant-turn-rate", "options": {"horizon": 50}}},
        {"base": {"predictor": "constant-turn-rate"}, "base.horizon": 50},
        {"base": "dosplan_simple.predictors:ConstantTurnRatePredictor", "base.horizon": 50},
    ],
)
@pytest.mark.parametrize(
    ("name", "kind"), [("growing-circle", GrowingCircleSettings), ("dos", DosSettings)]
)
def test_a_plugin_within_a_plugin_is_set_in_every_way(
    options: dict[str, Any], name: str, kind: type[Any]
) -> None:
    chosen = choose_predictor(name, options)
    assert chosen.settings == kind(base=TURNING)
    recorded = record(chosen)["base"]
    assert recorded["predictor"] == "constant-turn-rate"
    assert recorded["options"] == asdict(TurnRateSettings(horizon=50))
    assert choose_predictor(name, record(chosen)) == chosen


def test_plugins_nest_as_deep_as_one_likes() -> None:
    options = {"r": 2, "base": "growing-circle", "base.base": "constant-turn-rate", "base.z": 0}
    chosen = choose_predictor("fixed-circle", options)
    inner: PluginSpec[Predictor] = PluginSpec(ConstantTurnRatePredictor)
    assert chosen.settings.base.settings == GrowingCircleSettings(z=0.0, base=inner)
    circles = chosen.build(seed=5)
    assert isinstance(circles, FixedCirclePredictor)
    assert vars(circles.base)["base"].seed == 5
    assert choose_predictor("fixed-circle", record(chosen)) == chosen


def test_a_part_of_a_default_plugin_is_set_by_its_name_alone() -> None:
    chosen = choose_predictor("fixed-circle", {"base.horizon": 60, "horizon": 60})
    far: PluginSpec[Predictor] = PluginSpec(ConstantVelocityPredictor, PredictorSettings(60))
    assert chosen.settings == FixedCircleSettings(horizon=60, base=far)


def test_every_setting_is_recorded_defaults_included() -> None:
    assert record(choose_predictor("growing-circle", {"z": 0.7})) == {
        "horizon": 40,
        "base": {"predictor": "constant-velocity", "options": {"horizon": 40}},
        "z": 0.7,
    }
    assert record(choose_planner("cruise")) == {}


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("growing-circle", {"base": "nobody"}, "no predictor is called 'nobody'"),
        ("growing-circle", {"base": "idm"}, "no predictor is called 'idm'"),
        ("growing-circle", {"base": 3}, "option 'base' names no predictor; give a name of"),
        ("growing-circle", {"base": None}, "option 'base' is None, expected"),
        ("growing-circle", {"base": {"planner": "idm"}}, "option 'base' has the unknown key 'plan"),
        ("growing-circle", {"base": {"options": {}}}, "option 'base' names no predictor"),
        ("growing-circle", {"base": {"predictor": "none", "options": 3}}, "options is no mapping"),
        ("growing-circle", {"base.horizn": 3}, "no option 'base.horizn'; did you mean 'horizon'?"),
        ("growing-circle", {"base.horizon": "x"}, "option 'base.horizon' is 'x', expected int"),
        ("growing-circle", {"base.horizon": 0}, "option 'base': horizon is 0, expected 1 or more"),
        ("growing-circle", {"base.horizon": 30}, "base predicts 30 steps, horizon is 40; raise"),
        ("growing-circle", {"base": "ground-truth"}, "'base': ground-truth-v1 is shown the future"),
        ("dos", {"base.horizon": 40}, "option 'base' names no predictor; set base=NAME as well"),
        ("dos", {"threads": "many"}, "option 'threads' is 'many', expected int"),
        ("dos", {"threads": 0}, "threads is 0, expected 1 or more"),
        ("dos", {"sets": 3}, "option 'sets' is 3, expected str"),
    ],
)
def test_a_wrong_option_of_a_predictor_is_one_line(
    name: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(RegistryError) as caught:
        choose_predictor(name, options)
    assert str(caught.value).startswith(f"predictor {name!r}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
