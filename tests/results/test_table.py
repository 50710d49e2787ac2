"""The table of many runs: what is compared with what, and what never shares a block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest

import dosplan
from dosplan.results.comparison import CompareError, compare_runs
from dosplan.results.intervals import metric_interval
from dosplan.results.manifest import RunSettings
from dosplan.results.rows import write_rows
from dosplan.results.sweeps import SweepFolder, SweepRun
from dosplan.results.table import make_table
from dosplan.results.table_text import csv_table, latex_table, markdown_table, notes
from dosplan.scoring.metrics import find_metric
from dosplan.scoring.score import failed_score
from dosplan.system.files import FileError, write_json
from dosplan.types import Arm, EpisodeKey, Outcome, Score

HIT, MISS, CRASH = Outcome.SUCCESS, Outcome.GOAL_MISSED, Outcome.COLLISION


def _run(
    path: Path,
    outcomes: Sequence[Outcome],
    arms: Sequence[Arm] = tuple(Arm),
    *,
    futures: int = 1,
    seed: int = 0,
    config: Mapping[str, object] = MappingProxyType({}),
    **manifest: object,
) -> Path:
    """Writes a run; the outcomes are those of the arm with sets, without them all succeed."""
    count = len(outcomes) // futures
    scenarios = [f"USA_P{i % 3}-{i}_1_T-1" for i in range(count)]
    write_json(
        path / "run.json",
        {
            "scenarios": scenarios,
            "config": {"arms": list(arms), "futures": futures, "seed": seed, **config},
            "planner": "p-v1",
            "predictor": "q-v1",
            "versions": {},
            **manifest,
        },
    )
    rows: list[Score] = []
    for arm in arms:
        for i, outcome in enumerate(outcomes):
            key = EpisodeKey(scenarios[i // futures], arm, i % futures)
            own = outcome if arm is Arm.WITH_DOS else HIT
            row = failed_score(key, "")
            rows.append(replace(row, outcome=own, velocity=5.0 + i, steps=10, error=None))
    write_rows(path / "scenarios.jsonl", rows)
    return path


def test_rows_are_arms_with_the_intervals_and_tests_of_the_house(tmp_path: Path) -> None:
    a = _run(tmp_path / "a", [HIT, CRASH, CRASH, HIT, MISS, HIT])
    b = _run(tmp_path / "b", [HIT, HIT, CRASH, CRASH, CRASH, CRASH], [Arm.WITH_DOS])
    table = make_table([str(a), str(b)], baseline=f"{a}:with_dos")
    (block,) = table.blocks
    assert [row.spec for row in block.rows] == [
        f"{a}:with_dos",
        f"{a}:without_dos",
        f"{b}:with_dos",
    ]
    assert block.baseline == f"{a}:with_dos"
    assert block.rows[0].differences == {}
    (found,) = compare_runs([f"{a}:with_dos", f"{b}:with_dos"])
    assert block.rows[2].differences["collision"] == found.differences["collision"]
    # Scenarios 3, 4 and 5 collide on side B alone, 1 on side A alone: p = 2 (1 + 4) / 2^4.
    assert found.differences["collision"].p == pytest.approx(10.0 / 16.0)
    (read,) = (dosplan.open_run(b),)
    wilson = metric_interval(find_metric("collision"), read.rows)
    assert wilson is not None
    figure = block.rows[2].figures["collision"]
    assert (figure.value, figure.low, figure.high) == tuple(wilson)
    assert (block.rows[0].n, block.rows[0].places) == (6, 3)


def test_by_default_the_baseline_is_the_first_arm_without_sets(tmp_path: Path) -> None:
    a = _run(tmp_path / "a", [HIT, MISS], [Arm.WITH_DOS])
    b = _run(tmp_path / "b", [HIT, MISS])
    assert make_table([str(a)]).blocks[0].baseline == f"{a}:with_dos"
    assert make_table([str(a), str(b)]).blocks[0].baseline == f"{b}:without_dos"


def test_worlds_and_scenarios_never_share_a_block_unless_asked(tmp_path: Path) -> None:
    same = [HIT, MISS, HIT, HIT]
    a = _run(tmp_path / "a", same)
    late = _run(tmp_path / "late", same, loop="ideal, latency=0.3")
    traffic = _run(tmp_path / "traffic", same, traffic="reactive-v2")
    calm = {"traffic_options": {"courtesy": 1}}
    options = _run(tmp_path / "options", same, traffic="reactive-v2", config=calm)
    several = _run(tmp_path / "several", same, futures=2)
    fewer = _run(tmp_path / "fewer", same[:3])
    specs = [str(path) for path in (a, late, traffic, options, several, fewer)]
    table = make_table(specs, baseline=f"{late}:without_dos")
    assert [block.title.partition("), ")[2] for block in table.blocks] == [
        "traffic replay, loop ideal",
        "traffic replay, loop ideal, latency=0.3",
        "traffic reactive-v2, loop ideal",
        "traffic reactive-v2 (courtesy=1), loop ideal",
        "traffic replay, loop ideal, 2 futures",
        "traffic replay, loop ideal",
    ]
    # In each world the baseline is what drives alike there.
    assert [block.baseline for block in table.blocks] == [f"{spec}:without_dos" for spec in specs]
    mixed = make_table(specs, baseline=f"{late}:without_dos", across_worlds=True)
    assert [len(block.rows) for block in mixed.blocks] == [8, 2, 2]
    assert mixed.blocks[0].baseline == f"{late}:without_dos"
    assert mixed.blocks[0].title.endswith("4 worlds")
    text = markdown_table(mixed)
    assert "| Run | Arm | World | n |" in text
    assert "| reactive-v2 (courtesy=1), ideal |" in text


def test_what_drives_otherwise_has_no_baseline_in_another_world(tmp_path: Path) -> None:
    a = _run(tmp_path / "a", [HIT, MISS])
    b = _run(tmp_path / "b", [HIT, MISS], traffic="sumo-v1", planner="other-v1")
    table = make_table([str(a), str(b)], baseline=f"{a}:without_dos")
    assert [block.baseline for block in table.blocks] == [f"{a}:without_dos", None]
    assert all(not row.differences for row in table.blocks[1].rows)
    assert any(note.startswith("Without the baseline: suite (2 scen") for note in notes(table))


def test_futures_of_a_scenario_are_one_in_the_test(tmp_path: Path) -> None:
    # All four futures of scenario 0 collide: four pairs, one independent scenario.
    a = _run(tmp_path / "a", [CRASH] * 4 + [HIT] * 4, futures=4)
    (block,) = make_table([str(a)], baseline=f"{a}:without_dos").blocks
    difference = block.rows[0].differences["collision"]
    assert (difference.only_b, difference.only_a, difference.p) == (4, 0, 1.0)
    assert block.rows[0].n == 8


def test_runs_of_two_sweeps_may_have_one_name(tmp_path: Path) -> None:
    name = SweepRun(name="planner=p", values={"planner": "p"}, settings=RunSettings())
    runs = []
    for sweep, outcomes in (("a", [HIT, HIT]), ("b", [MISS, MISS])):
        folder = SweepFolder(tmp_path / sweep)
        folder.write((name,))
        runs.append(_run(folder.run(name), outcomes))
    sweeps = [str(tmp_path / "a"), str(tmp_path / "b")]
    table = make_table(sweeps, baseline=f"{runs[1]}:with_dos")
    assert [row.run for row in table.blocks[0].rows] == [str(run) for run in runs for _ in Arm]
    assert table.blocks[0].baseline == f"{runs[1]}:with_dos"
    assert [row.run for row in make_table(sweeps[:1]).blocks[0].rows] == ["planner=p"] * 2


def test_a_bar_in_the_name_of_a_run_begins_no_cell(tmp_path: Path) -> None:
    run = _run(tmp_path / "a|b", [HIT, MISS])
    lines = markdown_table(make_table([str(run)])).splitlines()
    cells = {line.replace(r"\|", "").count("|") for line in lines if line.startswith("| ")}
    assert len(cells) == 2  # Of the figures, and of the differences.


def test_a_sweep_gives_its_runs_and_tells_what_is_missing(tmp_path: Path) -> None:
    sweep = SweepFolder(tmp_path / "mine")
    runs = tuple(
        SweepRun(name=f"sets={name}", values={"sets": name, "planner": "p"}, settings=RunSettings())
        for name in ("union", "free", "late")
    )
    sweep.write(runs)
    for one in runs[:2]:
        _run(sweep.run(one), [HIT, MISS])
    _run(sweep.run(runs[2]), [HIT, MISS])
    rows = (sweep.run(runs[2]) / "scenarios.jsonl").read_text().splitlines()
    (sweep.run(runs[2]) / "scenarios.jsonl").write_text("\n".join(rows[:-1]) + "\n")
    table = make_table([str(sweep.path)], baseline="sets=free:with_dos")
    assert table.missing == ("sets=late",)
    assert [row.spec for row in table.blocks[0].rows] == [
        f"sets={name}:{arm}" for name in ("union", "free") for arm in Arm
    ]
    assert "Not finished, so not here: sets=late." in notes(table)
    by_folder = make_table([str(sweep.path)], baseline=f"{sweep.path}/sets=free:with_dos")
    assert by_folder == table
    headings = csv_table(table).splitlines()[0].split(",")
    assert len(set(headings)) == len(headings)
    twice = make_table([str(sweep.path), str(sweep.run(runs[0]))])
    assert len(twice.blocks[0].rows) == 4
    # What is damaged is not just unfinished.
    (sweep.run(runs[2]) / "run.json").write_text("{}")
    with pytest.raises(FileError, match="of this version"):
        make_table([str(sweep.path)])
    SweepFolder(tmp_path / "none").write(runs)
    with pytest.raises(CompareError, match=r"no run of .*none is finished"):
        make_table([str(tmp_path / "none")])


def test_what_is_not_ranked_is_marked_and_seeds_are_named(tmp_path: Path) -> None:
    a = _run(tmp_path / "a", [HIT, MISS], config={"ranked": False})
    b = _run(tmp_path / "b", [HIT, MISS], seed=3)
    table = make_table([str(a), str(b)])
    text = markdown_table(table)
    assert f"| {a} * | with DOS | 0 | 2 |" in text
    assert f"| {b} | with DOS | 3 | 2 |" in text
    assert any(note.startswith("*: not ranked") for note in notes(table))
    assert r"\%" in latex_table(table)
    assert "False" in csv_table(table).splitlines()[1]


def test_a_table_and_a_comparison_print_from_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    a = _run(Path("a"), [HIT, MISS, CRASH])
    found = dosplan.table(a, columns=("success",))
    assert found.blocks[0].rows[0].figures["success"].value == pytest.approx(1 / 3)
    lines = str(found).splitlines()
    assert lines[0] == "suite (3 scenarios), traffic replay, loop ideal"
    assert lines[2].split() == ["Run", "Arm", "n", "Success", "%"]
    assert "| Run | Arm | n | Success % |" in found._repr_markdown_()
    shown = repr(dosplan.compare(a))
    assert "Scenario whose outcome differs" in shown
    figures, counts = (x.split() for x in shown.splitlines() if x.startswith("Success %"))
    assert figures[2:6] == ["3", "100.0", "33.3", "-66.7"]
    assert counts[2:4] == ["2", "0"]


def test_other_files_or_versions_of_the_same_scenarios_are_told(tmp_path: Path) -> None:
    same = [HIT, MISS]
    a = _run(tmp_path / "a", same, digests={"scenario files": "1"}, versions={"dosplan": "0.4.0"})
    b = _run(tmp_path / "b", same, digests={"scenario files": "2"}, versions={"dosplan": "0.4.0"})
    c = _run(tmp_path / "c", same, digests={"scenario files": "1"}, versions={"dosplan": "0.5.0"})
    assert make_table([str(a)]).blocks[0].warnings == ()
    (files,) = make_table([str(a), str(b)]).blocks[0].warnings
    assert files.startswith(f"{b} and {a}: the scenarios have the same ids, and their files differ")
    table = make_table([str(a), str(c)])
    (versions,) = table.blocks[0].warnings
    assert versions.startswith(f"Scored by several versions of dosplan: 0.4.0 ({a}), 0.5.0 ({c})")
    assert versions in notes(table)
    both = make_table([str(a), str(b), str(c)]).blocks[0].warnings
    assert both == (files, versions.replace(f"({a})", f"({b})"))


def test_planner_and_predictor_are_named_where_runs_of_no_sweep_differ(tmp_path: Path) -> None:
    a = _run(tmp_path / "a", [HIT, MISS])
    b = _run(tmp_path / "b", [HIT, MISS], planner="other-v1")
    text = markdown_table(make_table([str(a), str(b)]))
    assert "| Run | Arm | Planner | n |" in text
    assert f"| {b} | with DOS | other-v1 | 2 |" in text
    assert r"\begin{tabular}{lllr" in latex_table(make_table([str(a), str(b)]))
