"""The leaderboard: what is in a block, in which order, and against what it is compared."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dosplan.results.comparison import compare_rows
from dosplan.results.leaderboard import (
    About,
    ArmResult,
    Submission,
    read_submissions,
    write_submission,
)
from dosplan.results.leaderboard_page import leaderboard_page
from dosplan.results.scenario_sets import known_sets
from dosplan.running.submission import FEWEST_FUTURES
from dosplan.running.sweep import read_sweep
from dosplan.scoring.score import failed_score
from dosplan.system.files import FileError
from dosplan.system.provenance import content_digest
from dosplan.types import Arm, EpisodeKey, Outcome, Score
from tests.support.peers import is_missing

ROOT = Path(__file__).parents[2]
HIT, MISS, CRASH, FAIL = (
    Outcome.SUCCESS,
    Outcome.GOAL_MISSED,
    Outcome.COLLISION,
    Outcome.PLANNER_FAILURE,
)
BUILT_IN = dict.fromkeys(("planner file", "predictor file"), content_digest([]))


def rows_of(
    outcomes: Sequence[Outcome], arm: Arm, speed: float = 5.0, *, blame: bool = True
) -> list[Score]:
    return [
        replace(
            failed_score(EpisodeKey(f"ZAM_P{i % 3}-{i}_1_T-1", arm), "", outcome),
            safe=outcome in (HIT, MISS),
            at_fault=blame and outcome is CRASH,
            velocity=0.0 if outcome is FAIL else speed + i / 7.0,
            steps=0 if outcome is FAIL else 30,
            error=None,
        )
        for i, outcome in enumerate(outcomes)
    ]


def row(
    name: str, outcomes: Sequence[Outcome], *, speed: float = 5.0, **changes: Any
) -> Submission:
    blame = changes.pop("blame", True)
    values: dict[str, Any] = {
        "about": About(name=name),
        "scenario_set": "suite",
        "set_digest": "a" * 64,
        "planner": "p-v1",
        "predictor": "q-v1",
        "traffic": "replay",
        "loop": "ideal",
        "futures": 1,
        "seed": 0,
        "digests": BUILT_IN,
        "dosplan": "0.4.0",
        "git_revision": None,
        "started": "",
        "arms": {
            arm: ArmResult.of(rows_of(outcomes, arm, speed, blame=blame)) for arm in (Arm.WITH_DOS,)
        },
    }
    return Submission(**{**values, **changes})


def names(page: str) -> list[str]:
    lines = [line for line in page.splitlines() if line.startswith("| ") and "DOS" in line]
    return [line.split("|")[1].partition(":")[0].strip() for line in lines]


def test_the_page_is_made_of_the_files() -> None:
    page = (ROOT / "docs" / "leaderboard.md").read_text(encoding="utf-8")
    rows = read_submissions(ROOT / "results" / "leaderboard")
    assert page == leaderboard_page(rows), "run: dosplan leaderboard"


def test_a_row_that_is_written_is_read_as_it_was(tmp_path: Path) -> None:
    rows = rows_of([HIT, CRASH, MISS, FAIL, Outcome.OUT_OF_BOUNDS], Arm.WITH_DOS)
    one = row("a", [], arms={Arm.WITH_DOS: ArmResult.of(rows)})
    write_submission(tmp_path, one)
    (found,) = read_submissions(tmp_path)
    assert found == one
    assert " ".join(found.arms[Arm.WITH_DOS].episodes.values()) == "S5.0 C5.1429 G5.2857 F B5.5714"
    again = found.arms[Arm.WITH_DOS].rows(Arm.WITH_DOS)
    for before, now in zip(rows, again, strict=True):
        assert (now.key, now.outcome, now.safe) == (before.key, before.outcome, before.safe)
        assert now.at_fault == before.at_fault
        assert now.velocity == pytest.approx(before.velocity, abs=1e-4)
        assert bool(now.steps) == bool(before.steps)
    assert found.arms[Arm.WITH_DOS].figures["success"].value == 0.2
    # The mean of the four episodes that drove.
    assert found.arms[Arm.WITH_DOS].figures["velocity"].value == pytest.approx(5.25)


@pytest.mark.parametrize("word", ["Snan", "Sinf"])
def test_a_velocity_that_is_no_number_is_refused(tmp_path: Path, word: str) -> None:
    path = write_submission(tmp_path, row("a", [HIT, HIT]))
    content = json.loads(path.read_text())
    arm = content["arms"]["with_dos"]
    arm["episodes"] = dict.fromkeys(arm["episodes"], word)
    arm["figures"]["velocity"] = {"value": 99.0, "low": None, "high": None}
    path.write_text(json.dumps(content))
    with pytest.raises(FileError, match="is no episode"):
        read_submissions(tmp_path)


@pytest.mark.parametrize(
    ("key", "value", "told"), [("arms", {}, "it has no arm"), ("set_digest", "<b>", "no SHA-256")]
)
def test_a_row_that_nobody_could_have_submitted_is_refused(
    tmp_path: Path, key: str, value: Any, told: str
) -> None:
    path = write_submission(tmp_path, row("a", [HIT, HIT]))
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(FileError, match=told):
        read_submissions(tmp_path)


def test_success_comes_first_then_safety_then_blame_then_velocity() -> None:
    page = leaderboard_page(
        [
            row("slow", [HIT, HIT, MISS], speed=2.0),
            row("fast", [HIT, HIT, MISS], speed=9.0),
            row("standing", [MISS, MISS, MISS], speed=0.1),
            row("blamed", [HIT, HIT, CRASH], speed=20.0),
            row("struck", [HIT, HIT, CRASH], speed=8.0, blame=False),
            row("best", [HIT, HIT, HIT], speed=1.0),
        ]
    )
    assert names(page) == ["best", "fast", "slow", "struck", "blamed", "standing"]


def test_each_set_and_world_has_a_block() -> None:
    outcomes = [HIT, MISS, HIT]
    page = leaderboard_page(
        [
            row("a", outcomes),
            row("late", outcomes, loop="ideal, latency=0.3"),
            row("reacting", outcomes, traffic="reactive-v2", traffic_options={"calm": 1}),
            row("seeded", outcomes, seed=3),
            row("older", outcomes, set_digest="b" * 64),
            row("first", outcomes, scenario_set="suite-1"),
            row("b", outcomes),
        ]
    )
    titles = [line for line in page.splitlines() if line.startswith("## ")]
    assert titles == [
        "## suite: traffic reactive-v2 (calm=1), loop ideal",
        "## suite: traffic replay, loop ideal",
        "## suite: traffic replay, loop ideal",
        "## suite: traffic replay, loop ideal",
        "## suite: traffic replay, loop ideal, latency=0.3",
        "## suite-1: traffic replay, loop ideal",
    ]
    assert names(page) == ["reacting", "a", "b", "older", "seeded", "late", "first"]
    assert "3 scenarios, 3 episodes in each row, seed 3; files `aaaaaaaa`" in page


def test_rows_are_compared_with_the_newest_built_in_mpc_over_the_same_episodes() -> None:
    ours: dict[str, Any] = {"planner": "mpc-v9", "predictor": "dos-v3"}
    base, other = [HIT, MISS, CRASH, HIT], [CRASH, HIT, CRASH, CRASH]
    newest = row("", base, **{**ours, "planner": "mpc-v10"})
    page = leaderboard_page(
        [
            row("old", [HIT] * 4, **ours),
            row("tuned", [HIT] * 4, planner_options={"headway": 2.0}, **ours),
            row("file", base, digests={**BUILT_IN, "planner file": "1"}, **ours),
            newest,
            row("mine", other, speed=7.0),
        ]
    )
    expected = compare_rows(
        rows_of(base, Arm.WITH_DOS), rows_of(other, Arm.WITH_DOS, 7.0)
    ).differences["success"]
    assert expected.p is not None
    (mine,) = (line for line in page.splitlines() if line.startswith("| mine"))
    assert f"| {100 * expected.difference:+.1f} [" in mine
    assert f"p {expected.p:.2g} |" in mine
    (shown,) = (line for line in page.splitlines() if line.startswith("| mpc-v10"))
    assert shown.endswith("| - | - |")
    assert "minus `mpc`" not in leaderboard_page([row("mine", other)])


def test_earlier_versions_stand_below_what_came_after_them() -> None:
    def drawn(planner: str, predictor: str, **changes: Any) -> Submission:
        return row("", [HIT, HIT], planner=planner, predictor=predictor, **changes)

    page = leaderboard_page(
        [
            drawn("p-v9", "q-v2"),
            drawn("p-v10", "q-v2"),
            drawn("p-v9", "q-v3"),
            drawn("p-v9", "other-v1"),
            drawn("p-v9", "q-v2", planner_options={"headway": 2.0}),
            drawn("p-v9", "q-v2", loop="late"),
            drawn("unnumbered", "q-v1"),
        ]
    )
    above, _, below = page.partition("## suite: traffic replay, loop late")[0].partition("above:")
    # Neither p-v10 with q-v2 nor p-v9 with q-v3 is later than the other.
    assert names(above) == [
        "p-v10 with q-v2",
        "p-v9 (headway=2.0) with q-v2",
        "p-v9 with other-v1",
        "p-v9 with q-v3",
        "unnumbered with q-v1",
    ]
    assert names(below) == ["p-v9 with q-v2"]


@pytest.mark.parametrize("name", ["built-in", "others"])
def test_the_sweeps_of_the_leaderboard_drive_whole_sets_ranked(name: str) -> None:
    if name == "others" and any(map(is_missing, ("reactive", "frenetix", "wale-net"))):
        pytest.skip("the extras peers and wale-net are not all installed")
    runs = read_sweep(ROOT / "results" / "leaderboard" / f"{name}.yaml")
    futures = {one.name: one.futures for one in known_sets()}
    for run in runs:
        config = run.settings
        assert config.ranked
        assert (config.ids, config.only, config.sample, config.limit) == ((), (), None, None)
        assert FEWEST_FUTURES <= config.futures <= futures[str(config.source)]
    assert {run.settings.loop for run in runs} == {"ideal", "realistic"}


def test_the_sets_are_the_suites_and_the_published_recordings() -> None:
    found = {one.name: one for one in known_sets()}
    assert set(found) == {"suite", "suite-1", "recorded"}
    assert found["suite"].futures == 5
    assert len(found["suite-1"].scenarios) == len(found["recorded"].scenarios) == 150
    assert found["recorded"].source is None
    assert len({one.digest for one in found.values()}) == 3
