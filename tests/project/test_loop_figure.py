"""The figure of the loop: it is drawn from its table, and its table is what the runs hold."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from dosplan.results.folder import RunFolder
from dosplan.results.summary import read_summary
from dosplan.running.config import RunConfig
from dosplan.simulation.settings import REALISTIC
from dosplan.system.files import read_json
from dosplan.types import Arm
from results.loop import loop
from tests.support.runs import STILL, run_here, write_reached_and_missed

TINY = ("ideal", "latency-0.3")


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Two loops under replay, of two scenarios of a second each."""
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    write_reached_and_missed(scenes)
    for cell in loop.cells(["replay"]):
        if cell.loop.name in TINY:
            run_here(
                RunConfig(
                    out=cell.folder(tmp_path / "runs", loop.SUITE),
                    source=str(scenes),
                    planner="cruise",
                    predictor=STILL,
                    loop=cell.loop.base,
                    loop_options=cell.loop.options,
                )
            )
    return tmp_path / "runs"


def test_published_figure_and_table_are_of_the_published_numbers() -> None:
    shown = loop.HERE / "loop.json"
    files = [loop.HERE / name for name in ("loop.md", "loop.png", "loop.pdf")]
    assert {file.exists() for file in files} == {shown.exists()}
    if shown.exists():
        assert loop.table_markdown(read_json(shown)) == files[0].read_text(encoding="utf-8")
        with Image.open(files[1]) as picture:
            assert picture.info["Description"] == loop.digest(shown)
        assert loop.digest(shown).encode() in files[2].read_bytes()


def test_table_and_figure_are_made_of_the_runs(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = runs.parent / "here"
    here.mkdir()
    monkeypatch.setattr(loop, "HERE", here)
    assert loop.main(["table", str(runs)]) == 0
    assert loop.main(["draw"]) == 0
    content = read_json(here / "loop.json")
    assert [cell["loop"] for cell in content["cells"]] == list(TINY)
    assert len(content["missing"]) == len(list(loop.cells())) - len(TINY)
    for cell, one in zip(content["cells"], loop.cells(), strict=False):
        summary = read_summary(RunFolder(one.folder(runs, loop.SUITE)))
        for arm, figures in summary.arms.items():
            own = cell["all"][arm.value]
            assert own["n"] == figures["n"] == 2
            assert own["success"]["value"] == figures["success_rate"] == 0.5
            assert own["velocity"]["value"] == pytest.approx(figures["velocity"], abs=1e-6)
        assert cell["all"]["difference"]["success"]["p"] == 1.0
    assert "| replay | ideal | suite | 2 | with sets | 50.0 [" in (here / "loop.md").read_text()
    with Image.open(here / "loop.png") as picture:
        assert picture.info["Description"] == loop.digest(here / "loop.json")


def test_a_cell_that_was_stopped_is_missing(runs: Path) -> None:
    rows = RunFolder(runs / "replay" / "latency-0.3" / "suite").rows
    rows.write_text("\n".join(rows.read_text().splitlines()[:-1]) + "\n")
    content = loop.table(runs)
    assert [cell["loop"] for cell in content["cells"]] == ["ideal"]
    assert {"traffic": "replay", "loop": "latency-0.3", "state": "not finished"} in content[
        "missing"
    ]
    assert "- replay, latency-0.3: not finished" in loop.table_markdown(content)


def test_drive_begins_with_what_tells_most_and_leaves_the_bench_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[RunConfig] = []
    monkeypatch.setattr(loop, "run", lambda config, observer: asked.append(config))
    command = ["drive", "--out", str(tmp_path), "--data", "data", "--suite", "3", "--recorded", "2"]
    assert loop.main(command) == 0
    order = [tuple(config.out.relative_to(tmp_path).parts) for config in asked]
    assert order[:3] == [
        ("replay", "ideal", "suite"),
        ("replay", "ideal", "recorded"),
        ("replay", "latency-0.3", "suite"),
    ]
    assert order.index(("sumo", "realistic", "suite")) < order.index(
        ("reactive", "noise-1", "suite")
    )
    assert ("sumo", "ideal", "recorded") not in order
    assert len(order) == len(set(order)) == 10 * 5
    recordings = (str(Path("data") / "train"), str(Path("data") / "val"))
    assert {config.source for config in asked} == {"suite-1", recordings}
    assert {config.arms for config in asked} == {tuple(Arm)}
    assert {(config.source == "suite-1", config.sample) for config in asked} == {
        (True, 3),
        (False, 2),
    }
    noisy = asked[order.index(("replay", "noise-2", "suite"))].chosen_loop
    real, sensing = REALISTIC.sensing, noisy.sensing
    assert sensing.position == 2 * real.position
    assert sensing.speed == 2 * real.speed
    assert sensing.correlation == real.correlation
    assert (noisy.latency, sensing.dropout_rate, sensing.occlusion) == (0.0, 0.0, False)


def test_drive_keeps_a_larger_sample(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = next(loop.cells(["replay"]))
    place = cell.folder(tmp_path / "more", loop.SUITE)
    scenes = str(tmp_path / "scenes")
    run_here(RunConfig(out=place, source=scenes, planner="cruise", predictor=STILL, sample=2))
    asked: list[RunConfig] = []
    monkeypatch.setattr(loop, "run", lambda config, observer: asked.append(config))
    loop.main(["drive", "--out", str(tmp_path / "more"), "--suite", "1", "--recorded", "0"])
    assert asked[0].sample == 2
    assert asked[1].sample == 1
