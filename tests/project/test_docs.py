"""What the documentation says of the code is made from the code."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dosplan.scoring.score
from docs.notebooks import notebook
from docs.pictures import PICTURES
from docs.schema import METRICS_PAGE, PAGE, metrics_page, page_with_tables
from dosplan.cli.main import main
from dosplan.plugins.loops import record_loop
from dosplan.results.rows import read_rows
from dosplan.results.scenario_sets import ScenarioSet
from dosplan.running import submission
from dosplan.scenario import find_scenarios
from dosplan.scoring.score import failed_score
from dosplan.simulation.settings import IDEAL, REALISTIC
from dosplan.system.files import read_json
from dosplan.system.provenance import content_digest
from dosplan.types import Arm, EpisodeKey
from tests.support.runs import write_scenes


def test_the_keys_of_a_run_folder_are_those_of_the_dataclasses() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert page == page_with_tables(page), "run: python docs/schema.py"
    links = set(re.findall(r"\]\(#([\w-]+)\)", page))
    assert links <= set(re.findall(r'<a id="([\w-]+)">', page))


def test_the_metrics_are_those_of_the_table() -> None:
    assert METRICS_PAGE.read_text(encoding="utf-8") == metrics_page(), "run: python docs/schema.py"


def test_the_page_of_the_loop_has_every_setting_and_its_realistic_value() -> None:
    page = Path(PAGE).with_name("loop.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w.]+)`: .*\| (\S+) \| (\S+) \|$", page, re.MULTILINE)
    told = {name: (ideal, realistic) for name, ideal, realistic in rows}
    words: dict[Any, str] = {True: "yes", False: "no", None: "all"}
    meant = [
        {
            name: f"{value:g}" if isinstance(value, float) else words[value]
            for name, value in _leaves(record_loop(loop))
        }
        for loop in (IDEAL, REALISTIC)
    ]
    assert told.keys() == meant[0].keys()
    for name, (ideal, realistic) in told.items():
        assert realistic == meant[1][name], name
        assert ideal in ("-", meant[0][name]), name


def test_the_commands_of_the_page_on_sweeps_do_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = PAGE.with_name("sweep.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    (file,), (commands,), (code,) = (
        re.findall(f"```{kind}\n(.*?)```", page, re.DOTALL) for kind in ("yaml", "sh", "python")
    )
    write_scenes(tmp_path / "scenes", 3)
    Path("mine.yaml").write_text(file.replace("source: suite", "source: scenes"))
    for line in commands.splitlines():
        command = shlex.split(line, comments=True)[1:]
        assert main(command) == 0, (command, capsys.readouterr().err)
        if "--dry-run" in command:
            assert "4 runs, 18 episodes left to drive" in capsys.readouterr().out
    names = [f"planner={a},sets={b}" for a in ("cruise", "idm") for b in ("points", "circles")]
    assert sorted(path.name for path in Path("runs/mine").iterdir() if path.is_dir()) == sorted(
        names
    )
    assert len(read_json(Path("table.json"))["blocks"][0]["rows"]) == 3
    shown = capsys.readouterr().out
    assert "| Minus planner=idm,sets=circles:with_dos | Arm |" in shown
    exec(code)
    assert "Figure(value=" in capsys.readouterr().out


def test_the_commands_of_the_page_on_submitting_end_with_a_leaderboard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = PAGE.with_name("submit.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    scenes = write_scenes(tmp_path / "scenes", 2)
    tiny = ScenarioSet("suite", tuple(ref.id for ref in find_scenarios(scenes)), 2, "", "scenes")
    tiny = replace(tiny, digest=content_digest(ref.path for ref in find_scenarios(scenes)))
    monkeypatch.setattr(submission, "known_sets", lambda: (tiny,))
    quick = ["--predictor", "growing-circle", "--in-process", "--traffic", "reactive"]
    quick += ["--set", "predictor.base=constant-velocity"]
    for line in "".join(re.findall("```sh\n(.*?)```", page, re.DOTALL)).splitlines():
        command = shlex.split(line.replace("run suite", "run scenes"), comments=True)[1:]
        if command[0] == "run":
            command = [part.replace("5", "2") for part in command] + quick
        assert main(command) == 0, (command, capsys.readouterr().err)
    text = Path("leaderboard.md").read_text(encoding="utf-8")
    assert text.count("## suite: traffic reactive-v") == 2
    assert text.count("| [Coast](https://example.org/coast): coast-v1 with growing-circle") == 4
    told = read_json(next(Path("results/leaderboard").iterdir())).keys()
    keys = PAGE.parents[1].joinpath("results/leaderboard/README.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1] for line in keys.splitlines() if line.startswith("| `")]
    assert {name.partition(".")[0] for row in rows for name in re.findall("`(.*?)`", row)} == told


def test_definitions_are_those_of_the_scorer() -> None:
    page = PAGE.with_name("definitions.md").read_text(encoding="utf-8")
    section = page[page.index("- **Two arms.**") :].strip()
    assert section in (dosplan.scoring.score.__doc__ or "")


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_what_the_script_draws(name: str) -> None:
    file = PAGE.with_name("pictures") / f"{name}.svg"
    assert file.read_text(encoding="utf-8") == PICTURES[name]().svg(), (
        "run: python docs/pictures.py"
    )


def test_the_first_steps_can_be_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = PAGE.with_name("first-steps.md").read_text(encoding="utf-8")
    commands = [
        shlex.split(line, comments=True)[1:]
        for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
        for line in block.splitlines()
        if line.startswith("dosplan ")
    ]
    told = {command[0] for command in commands}
    assert told == {"list", "run", "compare", "report", "explain", "render"}
    monkeypatch.chdir(tmp_path)
    driven = "ZAM_OnRamp-1_1_T-1"  # One of the four that the page drives.
    for command in commands:
        if command[0] == "run":
            if "--futures" not in command:
                command[1:2] = [driven, "--source", command[1]]
            command += ["--in-process", "--predictor", "constant-velocity"]
        command = ["2" if word == "5" else word for word in command]  # Two futures will do.
        assert main(command) == 0, (command, capsys.readouterr().err)
    assert Path("merge.png").stat().st_size > 10_000
    assert {row.future for row in read_rows(Path("runs/futures/scenarios.jsonl"))} == {0, 1}
    assert {row.loop for row in read_rows(Path("runs/late/scenarios.jsonl"))} == {"realistic"}


def test_the_notebook_on_reading_results_runs(tmp_path: Path) -> None:
    pieces = _pieces("reading-results")
    file, first, *_ = pieces
    assert file.startswith("%%writefile drive.py\n")
    assert first == "!python drive.py"
    (tmp_path / "drive.py").write_text(file.partition("\n")[2], encoding="utf-8")
    (tmp_path / "read.py").write_text("\n".join(pieces[2:]), encoding="utf-8")
    for script in ("drive.py", "read.py"):
        done = subprocess.run(
            [sys.executable, script], cwd=tmp_path, env={**os.environ, "MPLBACKEND": "agg"},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    assert "2 scenarios, seed 0" in done.stdout
    assert "sets of " in done.stdout
    assert (tmp_path / "episode.png").stat().st_size > 5_000


def test_a_notebook_has_the_text_and_the_code_of_its_page() -> None:
    page = PAGE.with_name("own-planner.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n# mine.py\n(.*?)```", page, re.DOTALL)
    commands = re.findall(r"```sh\n(.*?)```", page, re.DOTALL)
    file, *shell = _pieces("own-planner")
    assert file == f"%%writefile mine.py\n{code}".strip()
    lines = "".join(commands).splitlines()
    assert "\n".join(shell).splitlines() == [f"!{line}" for line in lines]
    text = json.loads(notebook("own-planner"))["cells"]
    assert text[0]["source"][0] == "# Your own planner\n"
    assert not any("](rules.md)" in line for cell in text for line in cell["source"])


def _pieces(page: str) -> list[str]:
    cells = json.loads(notebook(page))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


@pytest.mark.parametrize(
    ("page", "file"), [("own-planner", "mine.py"), ("own-predictor", "straight.py")]
)
def test_the_plugin_of_a_page_is_checked_and_does_what_the_page_says(
    page: str, file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    text = PAGE.with_name(f"{page}.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    Path(file).write_text(code, encoding="utf-8")
    scenes = write_scenes(tmp_path / "scenes", 2, name="ZAM_OnRamp-{:d}_1_T-1")
    for commands in re.findall(r"```sh\n(.*?)```", text, re.DOTALL):
        for line in commands.splitlines():
            _, command, *arguments = shlex.split(line, comments=True)
            if "suite-1" in arguments:
                arguments[arguments.index("suite-1")] = str(scenes)
            elif command == "run":
                arguments.insert(0, str(scenes))
            if command == "run":
                arguments += ["--in-process"]
                if "--predictor" not in arguments:
                    arguments += ["--predictor", "constant-velocity"]
            assert main([command, *arguments]) == 0, (line, capsys.readouterr().err)


def test_the_traffic_of_the_page_on_traffic_is_written_checked_and_driven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = PAGE.with_name("traffic.md").read_text(encoding="utf-8")
    (commands,) = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    scenes = write_scenes(tmp_path / "scenes", 1)
    for line in commands.splitlines():
        _, command, *arguments = shlex.split(line, comments=True)
        if command == "run":
            arguments = [str(scenes), *arguments, "--in-process", "--planner", "cruise"]
        assert main([command, *arguments]) == 0, (line, capsys.readouterr().err)


def test_the_metrics_of_the_page_on_metrics_measure() -> None:
    text = PAGE.with_name("own-metric.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(code, names)
    close = names["CLOSE_CALL"].value(failed_score(EpisodeKey("s", Arm.WITH_DOS), ""))
    assert close is False
    speeds = np.zeros((5, 4))
    speeds[:, 3] = (9.0, 0.05, 0.0, 3.0, 3.0)
    part = SimpleNamespace(drove=True, ego=speeds)
    assert names["STANDING"].measure(part) == 0.5
    assert names["STANDING"].measure(SimpleNamespace(drove=False)) is None


def _leaves(settings: dict[str, Any], inside: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in settings.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{inside}{name}.")
        else:
            yield f"{inside}{name}", value
