"""Solutions beside ``valid_solution`` of commonroad-drivability-checker, check by check.

CommonRoad's site takes a solution that passes all of them. Each check raises where it fails, so
they are called one by one. Its check of the road's edge needs the package ``triangle``, which is
not free; the checker's own triangulation without it stands in.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dosplan.plugins.registry import create_planner, create_predictor
from dosplan.scenario import ScenarioRef, find_scenarios, load_scenario
from dosplan.scenario.commonroad.document import read_file, unpacked
from dosplan.scenario.commonroad.solution import Trajectory, solution_xml
from dosplan.scoring.score import score
from dosplan.simulation.loop import run_episode
from dosplan.types import Arm, Score
from dosplan.vehicle import VehicleParameters
from tests.oracle.real_data import commonroad_root
from tests.support.scenes import Goal, Problem, rectangle, write_scenario_xml

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # commonroad-io's protobuf
VEHICLE = VehicleParameters()
CHECKS = ("solved_all", "goal", "start", "feasible", "obstacles", "boundary", "egos")
DATE = datetime(2026, 3, 1, tzinfo=UTC)


def verdicts(path: Path, xml: bytes) -> dict[str, bool]:
    """What each check of ``valid_solution`` says."""
    checker = pytest.importorskip(
        "commonroad_dc.feasibility.solution_checker",
        reason="install the extra `oracle` to run this",
    )
    from commonroad.common.file_reader import CommonRoadFileReader
    from commonroad.common.solution import CommonRoadSolutionReader
    from commonroad.common.util import FileFormat

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = unpacked(path, read_file(path))
        scenario, problems = CommonRoadFileReader(data, FileFormat.XML).open()
        solution = CommonRoadSolutionReader.fromstring(xml.decode())
        checks: dict[str, Callable[[], Any]] = {
            "solved_all": lambda: checker.solved_all_problems(problems, solution),
            "goal": lambda: checker.goal_reached(scenario, problems, solution),
            "start": lambda: checker.starts_at_correct_state(solution, problems),
            "feasible": lambda: all(
                feasible
                for feasible, *_ in checker.solution_feasible(
                    solution, scenario.dt, problems
                ).values()
            ),
            "obstacles": lambda: not checker.obstacle_collision(scenario, problems, solution),
            "boundary": lambda: not _leaves(checker, scenario, problems, solution),
            "egos": lambda: not checker.ego_collision(scenario, problems, solution),
        }
        return {name: _passes(checker, check) for name, check in checks.items()}


def _leaves(checker: Any, scenario: Any, problems: Any, solution: Any) -> bool:
    """``boundary_collision`` with the triangulation that needs no other package."""
    boundary = pytest.importorskip("commonroad_dc.boundary.boundary")
    _, edge = boundary.create_road_boundary_obstacle(scenario, method="aligned_triangulation")
    return any(
        edge.collide(checker._create_pp_solution_collision_object(problems, part, scenario.dt))
        for part in solution.planning_problem_solutions
    )


def _passes(checker: Any, check: Callable[[], Any]) -> bool:
    try:
        return bool(check())
    except checker.SolutionCheckerException:
        return False


def drive(ref: ScenarioRef, planner: str) -> tuple[Score, Trajectory]:
    scenario = load_scenario(ref, cached=True)
    predictor = create_predictor("constant-velocity", seed=0)
    episode = run_episode(scenario, create_planner(planner, seed=0), predictor, Arm.WITH_DOS)
    row = score(scenario, episode)
    return row, Trajectory(episode.start_step, episode.states, episode.inputs, 1.0)


def agrees(row: Score, said: dict[str, bool]) -> None:
    """Their verdicts are those of the row, whose drive ends at a contact or off the road.

    They count what touches and every crack of the road, the row what happens between two steps,
    but none of the drives here is so close.
    """
    assert all(said[check] for check in ("solved_all", "start", "feasible", "egos")), said
    if row.collision_step is not None:
        assert not said["obstacles"], row
    elif row.out_of_bounds_step is not None:
        assert not said["boundary"], row
    else:
        assert said["obstacles"], row
        assert said["boundary"], row
        assert said["goal"] == (row.goal_step is not None), row


@pytest.mark.parametrize(("planner", "good"), [("mpc", True), ("cruise", False)])
def test_verdicts_on_the_suite_are_those_of_the_score(planner: str, good: bool) -> None:
    seen = set()
    for ref in find_scenarios("suite-1")[::50]:
        row, driven = drive(ref, planner)
        agrees(row, said := verdicts(ref.path, solution_xml(ref.path, {None: driven}, DATE)))
        seen.add(all(said.values()))
    assert good in seen


def test_verdicts_on_recorded_traffic_are_those_of_the_score() -> None:
    for ref in find_scenarios(commonroad_root() / "val")[::24]:
        row, driven = drive(ref, "idm")
        agrees(row, verdicts(ref.path, solution_xml(ref.path, {None: driven}, DATE)))


def _two_egos(gap: float) -> Iterator[tuple[int | None, Trajectory]]:
    """Two egos of one file that coast side by side, ``gap`` m between their centres."""
    for name, y in ((5, 0.0), (3, gap)):
        inputs = np.zeros((10, 2))
        states = [VEHICLE.state_at(np.array([10.0, y]), 0.0, 10.0)]
        for u in inputs:
            states.append(VEHICLE.step(states[-1], u, 0.1))
        yield name, Trajectory(2, np.array(states), inputs, 1.0)


def _shared(path: Path, gap: float) -> Path:
    problems = [
        Problem(
            id=name,
            start=(10.0, y, 0.0, 10.0),
            start_step=2,
            goals=(Goal(2, 12, position=rectangle(4.0, 1.0, 20.0, y)),),
        )
        for name, y in ((5, 0.0), (3, gap))
    ]
    return write_scenario_xml(path, problems=problems)


def test_problems_of_one_file_are_solved_together(tmp_path: Path) -> None:
    path = _shared(tmp_path / "x.xml", gap=3.5)
    drives = dict(_two_egos(gap=3.5))
    assert all(verdicts(path, solution_xml(path, drives, DATE)).values())
    assert [ref.problem_id for ref in find_scenarios(path)] == [5, 3]
    for name in drives:  # One alone is no solution of the file.
        said = verdicts(path, solution_xml(path, {name: drives[name]}, DATE))
        assert [check for check in CHECKS if not said[check]] == ["solved_all"]


def test_each_check_fails_for_its_own_reason(tmp_path: Path) -> None:
    path = _shared(tmp_path / "x.xml", gap=1.0)
    drives = dict(_two_egos(gap=1.0))
    said = verdicts(path, solution_xml(path, drives, DATE))
    assert [check for check in CHECKS if not said[check]] == ["egos"]

    path = _shared(tmp_path / "y.xml", gap=3.5)
    drives = dict(_two_egos(gap=3.5))
    good = drives[5]
    late = Trajectory(3, good.states, good.inputs, 1.0)
    said = verdicts(path, solution_xml(path, {**drives, 5: late}, DATE))
    assert not said["start"]
    jumps = good.states.copy()
    jumps[5:, 0] += 0.1  # 10 cm in a step are beyond the 2 cm that the checker lets pass.
    said = verdicts(
        path, solution_xml(path, {**drives, 5: Trajectory(2, jumps, good.inputs, 1.0)}, DATE)
    )
    assert [check for check in CHECKS if not said[check]] == ["feasible"]
