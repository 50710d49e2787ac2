"""Methods from YAML: what is read, what is built, and what is refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from dosplan_simple.predictors import ConstantTurnRatePredictor
from dosplan_simple.sets import GrowingCirclePredictor

from dosplan.evaluation.methods import (
    Method,
    MethodError,
    build,
    check_labels,
    read_methods,
    settings,
)
from dosplan.plugins.registry import RegistryError, create_planner, create_predictor

SIMPLE = Path(__file__).parents[2] / "predictors" / "simple.yaml"


def _read(tmp_path: Path, text: str) -> list[Method]:
    file = tmp_path / "methods.yaml"
    file.write_text(text, encoding="utf-8")
    return read_methods(file)


def test_options_reach_the_predictor_and_nested_ones_are_built(tmp_path: Path) -> None:
    (method,) = _read(
        tmp_path,
        "- label: mine\n  predictor: growing-circle\n"
        "  options: {z: 0.7, base: {predictor: constant-turn-rate, options: {horizon: 40}}}\n",
    )
    predictor = build(method, seed=3)
    assert isinstance(predictor, GrowingCirclePredictor)
    assert isinstance(predictor.base, ConstantTurnRatePredictor)
    assert (predictor.z, predictor.seed, predictor.base.seed) == (0.7, 3, 3)
    told = settings(method)
    assert (told["z"], told["base"]["predictor"]) == (0.7, "constant-turn-rate")


def test_the_file_of_untrained_methods_can_be_built() -> None:
    methods = read_methods(SIMPLE)
    check_labels(methods)
    assert [method.label for method in methods] == [
        "constant velocity", "circle r=1", "circle r=2", "circle v1 z=0.7", "circle v1 z=1.0",
        "circle v2 z=1.0", "circle v2 z=1.5",
    ]  # fmt: skip
    assert len({build(method, seed=0).name for method in methods}) == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected a list of methods"),
        ("label: a", "expected a list of methods"),
        ("- a", "method 1 is no mapping"),
        ("- {label: a, predictor: none}\n- {predictor: none}", "method 2 has no label"),
        ("- {label: a, predicter: none}", "unknown key 'predicter'; did you mean 'predictor'?"),
        ("- {label: a, 5: none}", "unknown key 5 (keys: label, predictor, options)"),
        ("- {label: a}", "names no predictor"),
        ("- {label: a, predictor: none, options: [1]}", "options is no mapping"),
        ("- {label: a, predictor: none, options: {5: 1}}", "options is no mapping"),
        ("- {label: a, predictor: none, options: {z: .nan}}", "finite numbers"),
        ("- {label: a, predictor: none, options: {z: 2020-01-01}}", "finite numbers"),
        ("- [", "is not YAML"),
        ("- !!python/object/apply:os.getcwd []", "is not YAML"),
    ],
)
def test_a_file_that_is_no_list_of_methods_is_refused(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(MethodError) as caught:
        _read(tmp_path, text)
    assert message in str(caught.value)
    assert str(tmp_path / "methods.yaml") in str(caught.value)


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(MethodError, match=r"cannot read .*absent\.yaml: No such file"):
        read_methods(tmp_path / "absent.yaml")


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (Method("a", "growing-circel"), "did you mean 'growing-circle'?"),
        (Method("a", "growing-circle", {"y": 1.0}), "takes no option 'y'"),
        (Method("a", "growing-circle", {"bas": 1.0}), "did you mean 'base'? (options: base, "),
        (Method("a", "growing-circle", {"seed": 1}), "takes no option 'seed'"),
        (Method("a", "growing-circle", {"base": {"predictor": "nobody"}}), "called 'nobody'"),
        (
            Method("a", "growing-circle", {"base": {"predictor": "none", "optoins": {}}}),
            "option 'base' has the unknown key 'optoins'; did you mean 'options'?",
        ),
        (Method("a", "constant-velocity", {"horizon": 39}), "give it a horizon of 40"),
        (
            Method("a", "growing-circle", {"horizon": 41, "base": {"predictor": "none"}}),
            "raise base.horizon as well",
        ),
    ],
)
def test_a_method_that_cannot_be_built_is_named(method: Method, message: str) -> None:
    with pytest.raises(MethodError) as caught:
        build(method, seed=0)
    assert str(caught.value).startswith("method 'a'")
    assert message in str(caught.value)


def test_labels_tell_methods_apart() -> None:
    with pytest.raises(MethodError, match="2 methods have the label 'a'"):
        check_labels([Method("b", "none"), Method("a", "none"), Method("a", "fixed-circle")])
    with pytest.raises(MethodError, match="nothing to evaluate"):
        check_labels([])


def test_options_of_any_plugin_are_checked_by_the_registry(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "from dataclasses import dataclass\n"
        "from dosplan.api import PredictorSettings\n"
        "from dosplan_simple.predictors import ConstantVelocityPredictor\n"
        "@dataclass(frozen=True)\n"
        "class Settings(PredictorSettings):\n"
        "    gain: int = 1\n"
        "class Open(ConstantVelocityPredictor):\n"
        "    name = 'open-v1'\n"
        "    settings = Settings\n"
        "    def __init__(self, *, seed=0, settings=Settings()):\n"
        "        super().__init__(seed=seed, settings=settings)\n"
        "        self.gain = settings.gain\n"
    )
    predictor = create_predictor(f"{file}:Open", 5, {"gain": 2, "horizon": 50})
    assert (vars(predictor)["gain"], predictor.horizon, predictor.seed) == (2, 50, 5)
    with pytest.raises(RegistryError, match=r"'gian'; did you mean 'gain'\? \(options: gain, hor"):
        create_predictor(f"{file}:Open", 5, {"gian": 2})
    with pytest.raises(RegistryError, match="planner 'brake': takes no option 'x'"):
        create_planner("brake", 0, {"x": 1})
