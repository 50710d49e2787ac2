"""Bad input that once raised, hung or passed: what the fuzz tests found, each by its name."""

from __future__ import annotations

import json
import re
import struct
import sys
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from dosplan_net.commands import read_training
from dosplan_net.training.train import NetTraining

from dosplan.cli.command import CommandError
from dosplan.cli.main import main
from dosplan.evaluation.methods import MethodError, read_methods
from dosplan.plugins.registry import RegistryError, create_planner, find_planner, find_predictor
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunSettings, read_manifest
from dosplan.results.recording import Recording, load_cycle_ms
from dosplan.results.rows import read_rows, row_line
from dosplan.scenario import ScenarioError, load_scenario
from dosplan.scenario.commonroad.obstacles import MAX_SIZE, MAX_STATES
from dosplan.scoring.score import failed_score
from dosplan.system.errors import LONGEST_LINE, one_line
from dosplan.system.files import FileError, file_name, write_text
from dosplan.system.yaml_text import MAX_DEPTH, YamlError, parse_yaml
from dosplan.types import Arm, EpisodeKey, Plan, ShapeError
from tests.support import scenes
from tests.support.runs import configured, run_here, write_scenes
from tests.support.scenes import Goal, Problem, User, scenario_xml

GOOD = scenario_xml(scenes.straight_road(), [User(7, scenes.driving(50.0, 0.0, 5.0, 5))])


def _refused(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "bad.xml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=reason):
        load_scenario(path)


def _replaced(before: str, after: str) -> str:
    assert before in GOOD
    return GOOD.replace(before, after, 1)


# Scenarios.


@pytest.mark.parametrize("value", ["1e30", "-1e12"])
def test_an_orientation_without_measure_is_named(tmp_path: Path, value: str) -> None:
    text = GOOD.replace("<orientation><exact>0.0<", f"<orientation><exact>{value}<")
    assert text != GOOD
    _refused(tmp_path, text, "the <orientation> is .*no finite number")


def test_an_orientation_of_many_turns_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "good.xml"
    path.write_text(GOOD.replace("<orientation><exact>0.0<", "<orientation><exact>-99999.9<"))
    assert load_scenario(path).task.final_step == 50


@pytest.mark.parametrize("value", ["1e999", "-1.1e9", "1" + "0" * 400])
def test_a_number_without_measure_is_named(tmp_path: Path, value: str) -> None:
    text = _replaced("<x>50.0</x>", f"<x>{value}</x>")
    _refused(tmp_path, text, r"lanelet 100: the <x> is .*no finite number up to 1e\+09")


def test_a_step_far_away_takes_no_memory(tmp_path: Path) -> None:
    late = scenario_xml(
        scenes.straight_road(),
        [User(7, scenes.driving(50.0, 0.0, 5.0, 2), first_step=MAX_STATES + 1)],
    )
    _refused(tmp_path, late, f"more than {MAX_STATES} states")


@pytest.mark.parametrize("users", [(), (User(7, scenes.driving(50.0, 0.0, 5.0, 5)),)])
def test_an_episode_that_starts_far_away_takes_no_memory(
    tmp_path: Path, users: tuple[User, ...]
) -> None:
    step = 900_000_000
    problem = Problem(start_step=step, goals=(Goal(step + 1, step + 20),))
    late = scenario_xml(scenes.straight_road(), users, [problem])
    _refused(tmp_path, late, f"more than {MAX_STATES} states")


@pytest.mark.parametrize(
    ("width", "line"),
    [("0", "it is 4.5 m by 0 m"), ("-1.8", "a <rectangle> has the width -1.8; correct it")],
)
def test_a_road_user_without_a_size_is_named(tmp_path: Path, width: str, line: str) -> None:
    text = _replaced("<width>1.8</width>", f"<width>{width}</width>")
    _refused(tmp_path, text, f"obstacle 7: {line}")


@pytest.mark.parametrize("length", [MAX_SIZE, MAX_SIZE + 1.0])
def test_a_road_user_of_any_length_would_take_for_ever_to_score(
    tmp_path: Path, length: float
) -> None:
    # How finely the way between two steps is looked at grows with the size.
    text = _replaced("<length>4.5</length>", f"<length>{length}</length>")
    if length > MAX_SIZE:
        _refused(tmp_path, text, "obstacle 7: it is 10001 m by 1.8 m")
    else:
        path = tmp_path / "good.xml"
        path.write_text(text)
        assert load_scenario(path).tracks.size[0, 0] == length


@pytest.mark.parametrize("side", ["Left", "Right"])
def test_neighbours_that_go_round_are_refused(tmp_path: Path, side: str) -> None:
    text = scenario_xml(scenes.straight_road(speed_limit=9.0))
    ids = [x.id for x in scenes.straight_road()]
    link = f'<adjacent{side} ref="{ids[0]}" drivingDir="same"/>'
    _refused(
        tmp_path, text.replace("</rightBound>", f"</rightBound>{link}", 1), "lanelet 10. leads back"
    )


def test_a_tiny_lane_that_leads_back_to_itself_does_not_hang(tmp_path: Path) -> None:
    lane = scenes.straight_road()[0]
    # 1 mm of road that goes round, beside a drive that may reach kilometres.
    tiny = scenes.Lane(
        id=999,
        left=np.array([[500.0, 2.0], [500.001, 2.0]]),
        right=np.array([[500.0, -2.0], [500.001, -2.0]]),
        successors=(999,),
    )
    path = tmp_path / "round.xml"
    path.write_text(scenario_xml([lane, tiny], problems=[Problem(goals=(Goal(0, 30_000),))]))
    assert load_scenario(path).task.route.lanelet_ids == (lane.id,)


# YAML.

_LAUGHS = f"[&a0 [x, x], {', '.join(f'&a{i + 1} [' + f'*a{i}, ' * 9 + ']' for i in range(12))}]"


@pytest.mark.parametrize(
    "text",
    [
        "!!int ''", "!!float ''", "!!bool x", "!!timestamp x", "2020-13-45", "9" * 5000, "&a [*a]",
        _LAUGHS, "[" * 3000, "[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1),
        "!!python/name:os.system ''",
    ],
)  # fmt: skip
def test_yaml_that_is_no_plain_value_is_one_line(
    tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(YamlError, match="is not YAML"):
        parse_yaml(text)
    path = tmp_path / "methods.yaml"
    path.write_text(f"- {{label: a, predictor: none, options: {{a: {text} }} }}\n")
    with pytest.raises(MethodError, match="is not YAML"):
        read_methods(path)
    path.write_text(f"folds: {text}\n")
    with pytest.raises(CommandError, match="is not YAML"):
        read_training(path, NetTraining)
    with pytest.raises(SystemExit) as left:
        main(["run", "--set", f"planner.speed={text}"])
    assert left.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "'planner.speed': the value is not YAML" in line
    assert len(line) < 300


def test_yaml_as_deep_as_it_may_be_is_read() -> None:
    value = parse_yaml("[" * (MAX_DEPTH - 1) + "1" + "]" * (MAX_DEPTH - 1))
    assert json.dumps(value).count("[") == MAX_DEPTH - 1


@pytest.mark.parametrize("value", ["1" + "0" * 400, "{}", ".inf", "[1]"])
def test_a_training_with_an_odd_number_is_one_short_line(tmp_path: Path, value: str) -> None:
    path = tmp_path / "net.yaml"
    path.write_text(f"forgetting: {value}\nbatch: {value}\n")
    with pytest.raises(CommandError) as caught:
        read_training(path, NetTraining)
    assert len(str(caught.value)) < 400 + len(str(path))


# Run folders.


@pytest.mark.parametrize("value", ["1" + "0" * 400, "1e999", "-1e999"])
def test_a_number_too_large_for_a_row_is_named(tmp_path: Path, value: str) -> None:
    path = tmp_path / "scenarios.jsonl"
    line = row_line(failed_score(EpisodeKey("a", Arm.WITH_DOS), "broken"))
    path.write_text(line.replace('"velocity": 0.0', f'"velocity": {value}'))
    assert value in path.read_text()
    with pytest.raises(FileError, match="line 1, is not a row"):
        read_rows(path)


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("source", 10, "config.source: Expected `str | array`, got `int`"),
        ("planner_options", 1.5, "config.planner_options: Expected `object`, got `float`"),
        ("predictor_options", [], "config.predictor_options: Expected `object`, got `array`"),
        ("arms", ["with_dos", "both"], "config.arms[1]: Invalid enum value 'both'"),
        ("seed", True, "config.seed: Expected `int`, got `bool`"),
        ("futures", 10**9, "config.futures: Expected `int` <= 10000"),
    ],
)
def test_a_manifest_with_an_odd_configuration_is_named(
    tmp_path: Path, key: str, value: object, told: str
) -> None:
    folder = RunFolder(tmp_path)
    manifest: dict[str, Any] = {
        "config": {"arms": ["with_dos"]},
        **{"planner": "a", "predictor": "b", "scenarios": [], "versions": {}},
    }
    folder.manifest.write_text(json.dumps(manifest))
    assert read_manifest(folder).config == RunSettings(arms=(Arm.WITH_DOS,))
    manifest["config"][key] = value
    folder.manifest.write_text(json.dumps(manifest))
    line = re.escape(f"{folder.manifest} is not a run.json of this version ({told}")
    with pytest.raises(FileError, match=line):
        read_manifest(folder)


def test_settings_of_a_manifest_that_are_none_are_named(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    manifest = {"config": {}, **{"planner": "a", "predictor": "b", "scenarios": [], "versions": {}}}
    folder.manifest.write_text(json.dumps({**manifest, "settings": {"predictor": 1.5}}))
    with pytest.raises(FileError, match=r"settings\[\.\.\.\]: Expected `object`, got `float`"):
        read_manifest(folder)


def test_a_long_value_of_a_row_is_shortened(tmp_path: Path) -> None:
    path = tmp_path / "scenarios.jsonl"
    line = row_line(failed_score(EpisodeKey("a", Arm.WITH_DOS), "broken"))
    path.write_text(line.replace('"planner_failure"', f'"{"a" * 5000}"'))
    with pytest.raises(FileError, match="outcome: Invalid enum value 'aaa") as caught:
        read_rows(path)
    assert len(str(caught.value)) < 450 + len(str(path))


def test_a_text_that_utf8_cannot_hold_is_still_written_and_named(tmp_path: Path) -> None:
    write_text(tmp_path / "a", "x\ud800y")
    assert (tmp_path / "a").read_text() == "x?y"
    assert file_name("\ud800") != file_name("\ud801")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The file of an episode."""
    place = tmp_path_factory.mktemp("run")
    folder = run_here(configured(place / "run", write_scenes(place / "scenes", 1)))
    return folder.recording(EpisodeKey("ZAM_Fault-00_1_T-1", Arm.WITH_DOS)).read_bytes()


def _not_an_episode(path: Path, load: Callable[[Path], object]) -> None:
    with pytest.raises(FileError, match="is not an episode file of this version"):
        load(path)


def test_damage_within_a_recording_is_one_line(recording: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(recording)
    with zipfile.ZipFile(path) as file:
        header = file.getinfo("predict_seconds.npy").header_offset
    data = bytearray(recording)
    # A local header has 30 bytes; the last four of them are the lengths of what follows it.
    start = header + 30 + sum(struct.unpack_from("<HH", data, header + 26))
    data[start : start + 8] = b"\xff" * 8  # No beginning of a compressed stream: zlib.error.
    path.write_bytes(data)
    _not_an_episode(path, Recording.load)
    _not_an_episode(path, partial(load_cycle_ms, steps=10))


def test_an_array_in_place_of_a_recording_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    _not_an_episode(path, Recording.load)
    _not_an_episode(path, partial(load_cycle_ms, steps=10))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("states", np.zeros((0, 5))),
        ("states", np.array(3.0)),
        ("inputs", np.zeros((3, 2))),
        ("predict_seconds", np.array([np.nan])),
        ("cycle_steps", np.array([0, 0])),
        ("header", np.frombuffer(b"{}", dtype=np.uint8)),
        ("slack", np.array(["much"])),
        ("set_cycle", np.array([10**9])),
        ("set_centres", np.zeros(2)),
        ("plan_centres", np.zeros((1, 1))),
        ("end", np.array("somewhere")),
    ],
)
def test_a_recording_whose_arrays_do_not_fit_is_one_line(
    recording: bytes, tmp_path: Path, name: str, value: npt.NDArray[np.generic]
) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(recording)
    Recording.load(path)
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, allow_pickle=False, **{**arrays, name: value})
    _not_an_episode(path, Recording.load)


# Plug-ins.


def test_a_module_that_answers_for_its_names_may_fail(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("def __getattr__(name): raise RuntimeError('no')\n")
    with pytest.raises(RegistryError, match="RuntimeError: no"):
        find_planner(f"{file}:Mine")


_GREEDY = "Greedy = dataclasses.make_dataclass('Greedy', ['gap'], frozen=True)"
_LOOSE = "Loose = dataclasses.make_dataclass('Loose', [('gap', int, 1)])"


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["settings = 3"], "its settings are 3, expected a frozen dataclass"),
        (["settings = int"], "its settings are <class 'int'>, expected a frozen dataclass"),
        ([_LOOSE, "settings = Loose"], "write @dataclass(frozen=True) before Loose"),
        ([_GREEDY, "settings = Greedy"], "its settings cannot be made without arguments (TypeErr"),
        (["__init__ = None"], "cannot be built: TypeError"),
        (["def __init__(self, seed): pass"], "got an unexpected keyword argument 'settings'"),
    ],
)
def test_a_planner_without_proper_settings_is_refused(
    tmp_path: Path, lines: list[str], message: str
) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "import dataclasses\nfrom dosplan.api import Planner\n\n\n"
        "class Mine(Planner):\n    name = 'mine-v1'\n"
        + "".join(f"    {line}\n" for line in lines)
        + "    def compute_plan(self, observation, occupancy):\n        return None\n"
    )
    with pytest.raises(RegistryError) as caught:
        create_planner(f"{file}:Mine", 0)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_predictor_whose_settings_have_no_horizon_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "from dosplan.api import NoSettings, Predictor\n\n\n"
        "class Mine(Predictor):\n    name = 'mine-v1'\n    settings = NoSettings\n"
        "    def compute_occupancy(self, observation):\n        return None\n"
    )
    with pytest.raises(RegistryError, match="let NoSettings inherit from PredictorSettings"):
        find_predictor(f"{file}:Mine")


def test_an_exception_without_a_message_is_still_a_line() -> None:
    class MuteError(Exception):
        def __str__(self) -> str:
            raise ValueError(sys.platform)

    assert one_line(MuteError()) == "MuteError without a message"


def test_a_message_of_any_length_is_cut() -> None:
    fits, long = (ValueError("a" * (LONGEST_LINE - len("ValueError: ") + n)) for n in (0, 1))
    assert one_line(fits) == f"ValueError: {fits}"
    assert one_line(long) == f"{one_line(fits)} ..."


def test_complex_numbers_are_refused_and_not_halved() -> None:
    states, inputs = np.zeros((3, 5)), np.zeros((2, 2))
    assert len(Plan(states, inputs).inputs) == 2
    with pytest.raises(ShapeError, match=r"Plan\.inputs .* complex numbers"):
        Plan(states, inputs + 1j)  # type: ignore[arg-type]
