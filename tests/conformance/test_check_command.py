"""``dosplan check`` says of every bad plug-in what is wrong with it and what to do about it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from dosplan.cli.command import BAD_INPUT, FAILED, OK
from dosplan.cli.main import main
from dosplan.system.files import read_json

BAD = Path(__file__).with_name("bad_plugins.py")
LIMIT = 5  # s; at which Hangs is given up.

# The check that fails first, and all that it says; lines of code are left out.
BROKEN = {
    "Writer": (
        "plans",
        "raised ValueError: output array is read-only (bad_plugins.py); "
        "copy the array before you write to it",
    ),
    "Dice": (
        "deterministic",
        "two instances with the same seed differ in Plan.inputs, Plan.states; draw every random "
        "number from a generator made from seed",
    ),
    "OneStateShort": (
        "plans",
        "raised ShapeError: Plan.states has shape (10, 5), expected (11, 5) (bad_plugins.py)",
    ),
    "PlansNan": (
        "plans",
        "raised ShapeError: Plan.inputs holds a NaN or an infinite value (bad_plugins.py)",
    ),
    "Hangs": ("plans", f"is not done after {LIMIT} s; give every loop and every wait an end"),
    "Dies": (
        "plans",
        "the worker process was killed by SIGABRT; "
        "raise an exception to give up, and look at its native code",
    ),
    "StartsElsewhere": (
        "plans",
        "raised PluginError: planner starts-elsewhere-v1: the plan starts 1 away from the ego's "
        "state, its x is 1, that of the ego 0; Plan.states[0] must be observation.ego: x and y of "
        "the rear axle, steering angle, velocity, heading (api.py)",
    ),
    "Teleporter": (
        "vehicle_model",
        "Plan.states are 1 away from what Plan.inputs lead to at step 1; "
        "make them with VehicleParameters.step",
    ),
    "NeedsCompany": (
        "no_road_users",
        "raised ValueError: zero-size array to reduction operation minimum which has no identity "
        "(bad_plugins.py); where no road user is on the scene, the arrays of road users have no "
        "rows",
    ),
    "Peeks": (
        "future_unseen",
        "with another future, the same past gives another Plan.inputs, Plan.states; use nothing "
        "but what it is handed, or be a dosplan.api.OraclePredictor",
    ),
    "StuckOnCompany": (
        "arms_agree_without_predictions",
        "with no road user predicted, the two arms differ in Plan.inputs, Plan.states; leave out "
        "road users and steps where Occupancy.valid is False",
    ),
    "Reorders": (
        "predicts",
        "raised PluginError: predictor reorders-v1: Occupancy.ids must be observation.ids, in "
        "their order; mark a road user that has no prediction with valid = False (api.py)",
    ),
    "ShortSighted": (
        "predicts",
        "raised PluginError: predictor short-sighted-v1: predicted 20 steps, asked for 40 (api.py)",
    ),
}


def test_no_two_say_the_same() -> None:
    assert len({message for _, message in BROKEN.values()}) == len(BROKEN) >= 10


@pytest.mark.parametrize("name", BROKEN)
def test_a_bad_plugin_is_told_what_to_fix(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "check.json"
    arguments = [f"{BAD}:{name}", "--json", str(path)]
    if name == "Hangs":  # Nobody else is held to it, since a busy machine makes anybody slow.
        arguments += ["--timeout", str(LIMIT)]
    assert main(["check", *arguments]) == FAILED
    assert "breaks the contract" in capsys.readouterr().out
    first = next(check for check in read_json(path)["checks"] if not check["ok"])
    message = re.sub(r"(\w+\.py):\d+\)", r"\1)", first["message"])
    assert (first["name"], message) == BROKEN[name]


def test_checks_go_on_after_one_that_harmed_its_process(tmp_path: Path) -> None:
    plugin, path = tmp_path / "touchy.py", tmp_path / "check.json"
    plugin.write_text(
        f"import os, sys\nsys.path.insert(0, {str(BAD.parent)!r})\n"
        "from bad_plugins import Planner, plan_of\n"
        "class Touchy(Planner):\n"
        "    name = 'touchy-v1'\n"
        "    def compute_plan(self, observation, occupancy):\n"
        "        if len(observation.ids) > 20:\n"
        "            os._exit(3)\n"
        "        return plan_of(observation)\n"
    )
    assert main(["check", f"{plugin}:Touchy", "--json", str(path)]) == FAILED
    results = {check["name"]: check for check in read_json(path)["checks"]}
    assert [name for name, check in results.items() if not check["ok"]] == ["many_road_users"]
    assert "ended with exit code 3" in results["many_road_users"]["message"]
    assert results["actuator_limits"]["ok"]


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (
            "class P(Planner):\n name = 'p-v1'\n def plan(self, o, s): ...",
            "cannot be imported: TypeError: P overrides Planner.plan, which belongs to the "
            "benchmark; override compute_plan instead",
        ),
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("class P(Planner): name = 'p-v1'", "does not implement compute_plan"),
    ],
)
def test_what_is_no_plugin_is_told_once(
    source: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plugin = tmp_path / "mine.py"
    plugin.write_text(f"from dosplan.api import Planner\n{source}\n")
    assert main(["check", f"{plugin}:P"]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.count(message) == 1


@pytest.mark.parametrize("limit", ["0", "-1", "nan", "inf"])
def test_a_time_out_that_is_none_is_refused(limit: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "cruise", f"--timeout={limit}"]) == BAD_INPUT
    assert f"--timeout is {limit}; it must be" in capsys.readouterr().err


def test_the_limit_does_not_trouble_the_good() -> None:
    assert main(["check", "constant-velocity", "--timeout", "60"]) == OK


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ("", "mine.py: name the class, too, as {}:Mine"),
        (":Min", "mine.py has no Min; did you mean 'Mine'?"),
        (":M", "mine.py has no M; it has Mine"),
        (":Tuning", "is not a subclass of dosplan.api.Planner; predictor "),
    ],
)
def test_a_class_that_is_not_there_is_told_once_and_who_is(
    named: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plugin = tmp_path / "mine.py"
    plugin.write_text(
        "from dosplan.api import Predictor\n"
        "class Tuning: pass\n"
        "class Mine(Predictor):\n"
        "    name = 'mine-v1'\n"
        "    def compute_occupancy(self, observation): ...\n"
    )
    assert main(["check", f"{plugin}{named}"]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.count(message.format(plugin)) == 1
