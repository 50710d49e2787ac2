"""The arithmetic of the protocol, against cases whose answer is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dosplan.running.sweep import read_sweep
from dosplan.scoring.score import failed_score
from dosplan.system.files import read_json
from dosplan.types import Arm, EpisodeKey, Outcome, Score
from results.proof import proof
from tests.support.close import assert_close


def _row(scenario: int, future: int, arm: Arm, collides: bool, velocity: float) -> Score:
    key = EpisodeKey(f"ZAM_Kind-{scenario}_1_T-1", arm, future)
    outcome = Outcome.COLLISION if collides else Outcome.SUCCESS
    return replace(failed_score(key, "", outcome), velocity=velocity, steps=10, error=None)


def _rows(without: int, with_sets: int, *, scenarios: int = 60, slower: float = 0.0) -> list[Score]:
    """Both arms over two futures of each scenario; the first few collide, in one future each."""
    return [
        _row(i, future, arm, future == 0 and i < hit, 8.0 - slower * (arm is Arm.WITH_DOS))
        for arm, hit in ((Arm.WITHOUT_DOS, without), (Arm.WITH_DOS, with_sets))
        for i in range(scenarios)
        for future in range(2)
    ]


def _primary(rows: list[Score]) -> proof.Cell:
    cell = proof.judge_cell("fresh", "replay", "late", rows)
    return replace(cell, p_holm=cell.p)


def test_a_clear_halving_is_found_and_none_where_there_is_none() -> None:
    clear = _primary(_rows(20, 5))
    assert (clear.n, clear.places, clear.without, clear.with_sets) == (120, 60, 20, 5)
    assert clear.ratio == 0.25
    # Fifteen scenarios that differ, all in one direction.
    assert clear.p == pytest.approx(2.0 * 0.5**15)
    assert clear.is_safer
    assert clear.keeps_success
    assert clear.keeps_velocity
    assert not _primary(_rows(20, 20)).is_safer
    # Significant, and no halving.
    less = _primary(_rows(30, 20))
    assert less.p < proof.LEVEL
    assert not less.is_safer


def test_a_cell_that_is_not_primary_decides_nothing() -> None:
    assert not proof.judge_cell("fresh", "reactive", "late", _rows(20, 5)).is_safer


def test_what_the_sets_cost_is_held_against_the_margins() -> None:
    slow = proof.judge_cell("fresh", "replay", "late", _rows(20, 5, slower=0.3))
    assert not slow.keeps_velocity
    worse = _primary(_rows(5, 20))
    assert not worse.keeps_success
    assert not worse.is_safer


def test_the_interval_of_the_ratio_holds_the_ratio() -> None:
    cell = proof.judge_cell("fresh", "replay", "late", _rows(20, 10))
    assert cell.ratio_low is not None
    assert cell.ratio_high is not None
    assert cell.ratio_low < 0.5 < cell.ratio_high
    # Without a collision in the other arm there is no ratio, and no end of it.
    none = proof.judge_cell("fresh", "replay", "late", _rows(0, 0))
    assert (none.ratio, none.ratio_low, none.ratio_high) == (None, None, None)


def test_a_pair_that_the_traffic_failed_counts_on_neither_side() -> None:
    rows = _rows(3, 1)
    rows[0] = replace(rows[0], outcome=Outcome.TRAFFIC_FAILURE)
    counts = proof.collisions_by_scenario(rows)
    assert counts[0].tolist() == [0.0, 0.0]
    assert counts.sum(axis=0).tolist() == [2.0, 0.0]


def test_holm_by_hand() -> None:
    assert proof.holm([0.01, 0.04]) == [0.02, 0.04]
    assert proof.holm([0.04, 0.03]) == [0.06, 0.06]
    assert proof.holm([0.9, 0.8]) == [1.0, 1.0]


def test_power_is_small_without_an_effect_and_grows_with_the_scenarios() -> None:
    counts = np.zeros((40, 2))
    counts[:8] = 1.0
    same = proof.power(counts, 100)
    assert same["as the pilot"] == 0.0
    few, many = (proof.power(counts, n)["halved"] for n in (20, 200))
    assert few < 0.3 < 0.9 < many


def test_the_sweep_drives_the_cells_of_the_hypotheses() -> None:
    runs = read_sweep(proof.HERE / "worlds.yaml")
    keys = {(r.values["scenarios"], r.values["traffic"], r.values["loop"]) for r in runs}
    assert len(keys) == len(runs) == 10
    assert set(proof.PRIMARY) <= keys
    late = [r.settings for r in runs if r.values["loop"] == "late"]
    assert all(dict(settings.loop_options) == {"latency": 0.3} for settings in late)
    assert all(settings.arms == tuple(Arm) for settings in late)


def test_the_judgement_follows_from_the_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    published = proof.HERE
    monkeypatch.setattr(proof, "HERE", tmp_path)
    proof.write_judgement(published / "runs")
    assert_close(read_json(tmp_path / "proof.json"), read_json(published / "proof.json"))
    assert (tmp_path / "proof.md").read_text("utf-8") == (published / "proof.md").read_text("utf-8")
