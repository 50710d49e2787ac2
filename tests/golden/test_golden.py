"""Every golden scene scores as its file says."""

from __future__ import annotations

from pathlib import Path

import pytest

from dosplan.scoring.score import score
from dosplan.types import CollisionClass, Outcome
from tests.golden.scene import Case, read_cases

SCENES = sorted((Path(__file__).parent / "scenes").glob("*.toml"))
CASES = [case for path in SCENES for case in read_cases(path)]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_scene_scores_as_expected(case: Case) -> None:
    row = score(case.scenario, case.episode).columns()
    expected = {key: None if value == "none" else value for key, value in case.expected.items()}
    have = {key: row[key] for key in expected}
    assert have == pytest.approx(expected)


def test_every_outcome_and_every_class_of_collision_has_a_scene() -> None:
    outcomes = {case.expected["outcome"] for case in CASES}
    classes = {case.expected.get("collision_class", "none") for case in CASES} - {"none"}
    assert outcomes == {x.value for x in Outcome if x.of_planner}
    assert classes == {x.value for x in CollisionClass}
    blame = {
        case.expected["at_fault"]
        for case in CASES
        if case.expected.get("collision_class") == "active_lateral"
    }
    assert blame == {True, False}
