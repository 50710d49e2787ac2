"""Paired differences against figures worked out by hand and by scipy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dosplan.results.comparison import Change, CompareError, compare_rows, compare_runs
from dosplan.results.rows import write_rows
from dosplan.scoring.score import failed_score
from dosplan.system.files import write_json
from dosplan.types import Arm, EpisodeKey, Outcome, Score

USABLE = [outcome for outcome in Outcome if outcome.of_planner]


def _rows(outcomes: list[Outcome], arm: Arm = Arm.WITH_DOS, velocity: float = 5.0) -> list[Score]:
    return [
        replace(
            failed_score(EpisodeKey(f"s{i}", arm), ""),
            outcome=outcome,
            safe=outcome is not Outcome.COLLISION,
            at_fault=outcome is Outcome.COLLISION and i % 2 == 0,
            velocity=velocity + i,
            steps=10,
            error=None,
        )
        for i, outcome in enumerate(outcomes)
    ]


def _pairs(both: int, only_a: int, only_b: int, neither: int) -> tuple[list[Score], list[Score]]:
    hit, miss = Outcome.SUCCESS, Outcome.COLLISION
    a = [hit] * (both + only_a) + [miss] * (only_b + neither)
    b = [hit] * both + [miss] * only_a + [hit] * only_b + [miss] * neither
    return _rows(a), _rows(b)


def test_mcnemar_is_the_two_sided_binomial_test() -> None:
    # 1 against 7 discordant scenarios: p = 2 (C(8,0) + C(8,1)) / 2^8 = 18 / 256.
    result = compare_rows(*_pairs(both=5, only_a=1, only_b=7, neither=2))
    assert result.n == 15
    assert (result.differences["success"].only_a, result.differences["success"].only_b) == (1, 7)
    assert result.differences["success"].p == pytest.approx(18.0 / 256.0)
    assert result.differences["success"].a == pytest.approx(6 / 15)
    assert result.differences["success"].difference == pytest.approx(6 / 15)
    # Safe mirrors success here, collision is its opposite.
    assert result.differences["collision"].difference == pytest.approx(-6 / 15)
    assert (result.differences["collision"].only_a, result.differences["collision"].only_b) == (
        7,
        1,
    )


def test_velocity_is_compared_where_both_drove() -> None:
    a = _rows([Outcome.SUCCESS] * 3, velocity=5.0)
    b = _rows([Outcome.SUCCESS] * 3, velocity=7.0)
    b[0] = replace(b[0], steps=0, velocity=0.0)
    result = compare_rows(a, b).differences["velocity"]
    assert (result.n, compare_rows(a, b).differences["success"].n) == (2, 3)
    # Scenarios 1 and 2: 6 and 7 m/s against 8 and 9.
    assert (result.a, result.b, result.difference) == (6.5, 8.5, 2.0)
    assert (result.low, result.high, result.p) == (2.0, 2.0, None)
    alone = compare_rows(a[:1], b[:1])
    assert "velocity" not in alone.differences
    assert alone.content()["velocity"] is None


def test_scenarios_whose_outcome_differs_are_listed() -> None:
    a = _rows([Outcome.SUCCESS, Outcome.GOAL_MISSED, Outcome.COLLISION])
    b = _rows([Outcome.SUCCESS, Outcome.SUCCESS, Outcome.OUT_OF_BOUNDS])
    assert compare_rows(a, b).changes == (
        Change("s1", Outcome.GOAL_MISSED, Outcome.SUCCESS),
        Change("s2", Outcome.COLLISION, Outcome.OUT_OF_BOUNDS),
    )


@settings(max_examples=25, deadline=None)
@given(st.lists(st.sampled_from(USABLE), min_size=1, max_size=30), st.randoms())
def test_pairing_ignores_the_order_and_sides_mirror(
    outcomes: list[Outcome], random: object
) -> None:
    a = _rows(outcomes)
    b = _rows(list(reversed(outcomes)))
    shuffled = list(b)
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    there = compare_rows(a, shuffled)
    assert there == compare_rows(a, b)
    forth, back = (found.differences["success"] for found in (there, compare_rows(b, a)))
    assert (forth.low, forth.high) == pytest.approx((-(back.high or 0.0), -(back.low or 0.0)))
    assert back.difference == pytest.approx(-forth.difference)
    assert back.p == forth.p
    same = compare_rows(a, a)
    none = same.differences["success"]
    assert (none.difference, none.p) == (0.0, 1.0)
    assert none.low == pytest.approx(-(none.high or 0.0))
    assert same.changes == ()


def test_what_is_unusable_on_a_side_is_left_out_and_counted() -> None:
    a = _rows([Outcome.SUCCESS, Outcome.TRAFFIC_FAILURE, Outcome.COLLISION, Outcome.UNUSABLE])
    b = _rows([Outcome.COLLISION, Outcome.UNUSABLE, Outcome.COLLISION, Outcome.SUCCESS])
    found = compare_rows(a, b)
    assert (found.n, found.unusable) == (2, 2)
    assert found.changes == (Change("s0", Outcome.SUCCESS, Outcome.COLLISION),)
    success = found.differences["success"]
    assert (success.n, success.a, success.b) == (2, 0.5, 0.0)
    none = compare_rows(a[1:2], b[1:2])
    assert (none.n, none.places, none.unusable, none.differences) == (0, 0, 1, {})


def test_other_scenarios_are_refused() -> None:
    rows = _rows([Outcome.SUCCESS] * 3)
    alone = "did not drive the same scenarios and futures: s2 is in A alone; drive it in B too"
    with pytest.raises(CompareError, match=alone):
        compare_rows(rows, rows[:2])
    with pytest.raises(CompareError, match="s2 is in B alone; drive it in A too"):
        compare_rows(rows[:2], rows)
    with pytest.raises(CompareError, match="hold no scenario"):
        compare_rows([], [])


def _write_run(path: Path, arms: dict[Arm, list[Outcome]]) -> Path:
    n = len(next(iter(arms.values())))
    manifest = {
        "scenarios": [f"s{i}" for i in range(n)],
        "config": {"arms": list(arms)},
        "planner": "p",
        "predictor": "q",
        "versions": {},
    }
    write_json(path / "run.json", manifest)
    rows = [row for arm, outcomes in arms.items() for row in _rows(outcomes, arm)]
    write_rows(path / "scenarios.jsonl", rows)
    return path


@pytest.fixture
def runs(tmp_path: Path) -> tuple[str, str]:
    """A run of both arms, where sets win; one of the arm with sets alone, where all is well."""
    good, bad = [Outcome.SUCCESS] * 2, [Outcome.COLLISION] * 2
    both = _write_run(tmp_path / "both", {Arm.WITH_DOS: good, Arm.WITHOUT_DOS: bad})
    single = _write_run(tmp_path / "single", {Arm.WITH_DOS: good})
    return str(both), str(single)


def test_the_arms_of_one_run(runs: tuple[str, str]) -> None:
    (result,) = compare_runs([runs[0]])
    assert (result.a, result.b) == (f"{runs[0]}:without_dos", f"{runs[0]}:with_dos")
    assert result.differences["success"].difference == 1.0
    with pytest.raises(CompareError, match="holds one arm"):
        compare_runs([runs[1]])


@pytest.mark.parametrize(
    ("specs", "arms", "difference"),
    [
        (("{0}", "{1}"), ["with_dos"], 0.0),
        (("{0}:without_dos", "{1}"), ["with_dos"], 1.0),
        (("{0}:with_dos", "{0}:without_dos"), ["without_dos"], -1.0),
        (("{0}", "{0}"), ["with_dos", "without_dos"], 0.0),
    ],
)
def test_two_runs(
    runs: tuple[str, str], specs: tuple[str, str], arms: list[str], difference: float
) -> None:
    results = compare_runs([spec.format(*runs) for spec in specs])
    assert [result.b.rpartition(":")[2] for result in results] == arms
    assert {result.differences["success"].difference for result in results} == {difference}


def test_an_arm_that_is_not_there(runs: tuple[str, str]) -> None:
    with pytest.raises(CompareError, match="holds no episode of the arm without_dos"):
        compare_runs([runs[0], f"{runs[1]}:without_dos"])
