"""What nobody could drive is told by its reason; what somebody could is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dosplan.scenario import load_scenario
from dosplan.scoring.usable import unusable
from tests.support.scenes import (
    Goal,
    Problem,
    User,
    driving,
    rectangle,
    straight_road,
    write_scenario_xml,
)

LORRY = "<rectangle><length>12.0</length><width>2.5</width></rectangle>"


def verdict(folder: Path, problem: Problem, users: tuple[User, ...] = ()) -> str | None:
    """What is said of a file with a road of lanes of 3.5 m, the right one's middle at y = 0."""
    path = folder / "scene.xml"
    write_scenario_xml(path, straight_road(), users=users, problems=[problem])
    return unusable(load_scenario(path))


def at(x: float, y: float, heading: float = 0.0) -> Problem:
    return Problem(start=(x, y, heading, 10.0))


def reaching(*goals: Goal) -> Problem:
    return Problem(goals=goals)


@pytest.mark.parametrize("name", [7, 1000])  # Its own id, and the planning problem's.
def test_the_egos_own_recording_is_a_road_user_at_its_start(tmp_path: Path, name: int) -> None:
    line = verdict(tmp_path, Problem(), (User(name, driving(10.0, 0.0, 10.0, 20)),))
    assert line == (
        f"planning problem 1000: the ego's start overlaps road user {name} (car); remove that road "
        "user if it is the ego's own recording, otherwise correct one of the positions"
    )


@pytest.mark.parametrize(
    ("user", "overlaps"),
    [
        # The ego is 4.508 m long and 1.61 m wide; a car 4.5 m and 1.8 m.
        (User(7, driving(14.49, 0.0, 10.0, 20)), True),
        (User(7, driving(14.51, 0.0, 10.0, 20)), False),
        (User(7, driving(10.0, 1.70, 10.0, 20)), True),
        (User(7, driving(10.0, 1.71, 10.0, 20)), False),
        (User(7, [(18.0, 0.0, 0.0, None)], static=True, kind="parkedVehicle", shape=LORRY), True),
        # It comes when the ego has left the place.
        (User(7, driving(10.0, 0.0, 10.0, 20), first_step=30), False),
    ],
)
def test_an_overlap_at_the_start_is_exact(tmp_path: Path, user: User, overlaps: bool) -> None:
    line = verdict(tmp_path, Problem(), (user,))
    assert (line is not None) == overlaps
    assert line is None or "overlaps road user 7 (" in line


def test_a_later_start_is_judged_at_its_step(tmp_path: Path) -> None:
    # The recording of the ego from step 0 on, of which the problem begins at step 20.
    problem = Problem(start=(30.0, 0.0, 0.0, 10.0), start_step=20)
    twin = User(7, driving(10.0, 0.0, 10.0, 40))
    assert "overlaps road user 7" in (verdict(tmp_path, problem, (twin,)) or "")
    ended = User(7, driving(10.0, 0.0, 10.0, 10))
    assert verdict(tmp_path, problem, (ended,)) is None


@pytest.mark.parametrize(
    ("problem", "off"),
    [
        # The right edge of the road is at y = -1.75, half the ego's width 0.805.
        (at(60.0, -0.96), True),
        (at(60.0, -0.95), False),  # Within the hairline that scoring overlooks.
        (at(60.0, 0.0, 0.6), True),
        (at(60.0, 1.75, 0.6), False),
        (at(1.0, 0.0), False),  # Its rear hangs over the map's open end.
        (at(199.0, 0.0), False),
    ],
)
def test_a_start_off_the_road(tmp_path: Path, problem: Problem, off: bool) -> None:
    line = verdict(tmp_path, problem)
    told = "planning problem 1000: part of the ego is off the road at its start; correct "
    assert line is None if not off else (line or "").startswith(told)


BESIDE = Goal(position=rectangle(9.0, 3.0, 80.0, -4.0))
ON = Goal(position=rectangle(9.0, 3.0, 80.0, 0.0))


@pytest.mark.parametrize(
    ("problem", "said"),
    [
        (reaching(BESIDE), "planning problem 1000: its goal lies beside the road, or so near "),
        (reaching(BESIDE, BESIDE), "none of its goals can be reached: the first lies beside "),
        (reaching(Goal(velocity=(60.0, 70.0))), "its goal asks for a velocity that the ego cannot"),
        (reaching(Goal(velocity=(-5.0, -1.0))), "its goal asks for a velocity that the ego cannot"),
        (reaching(BESIDE, ON), None),
        (reaching(Goal()), None),
        (reaching(Goal(velocity=(-1.0, 0.0))), None),
        # Its edge reaches as far onto the road as the ego's middle can come to the road's edge.
        (reaching(Goal(position=rectangle(9.0, 3.0, 80.0, -2.46))), "lies beside the road"),
        (reaching(Goal(position=rectangle(9.0, 3.0, 80.0, -2.44))), None),
        (reaching(Goal(position=rectangle(0.1, 0.1, 80.0, 1.75))), None),
    ],
)
def test_a_goal_that_no_state_can_reach(tmp_path: Path, problem: Problem, said: str | None) -> None:
    line = verdict(tmp_path, problem)
    assert line is None if said is None else said in (line or "")


def test_a_goal_that_is_over_before_the_start_does_not_count(tmp_path: Path) -> None:
    over = Goal(first_step=0, last_step=15, position=rectangle(9.0, 3.0, 80.0, 0.0))
    problem = Problem(goals=(over, BESIDE), start_step=20)
    line = verdict(tmp_path, problem) or ""
    assert "none of its goals can be reached: the first counts at no step of the episode" in line


def test_a_goal_on_a_road_that_is_wide_enough_for_the_ego_alone(tmp_path: Path) -> None:
    for width, fits in ((1.62, True), (1.58, False)):
        path = tmp_path / "narrow.xml"
        goal = Goal(position=rectangle(9.0, 3.0, 80.0, 0.0))
        write_scenario_xml(path, straight_road(1, width=width), problems=[Problem(goals=(goal,))])
        line = unusable(load_scenario(path))
        assert (line is None) == fits
    assert np.isclose(load_scenario(path).task.vehicle.width, 1.61)
