"""Who left the sets of a run: comparisons whose answer is known, and the command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dosplan.cli.main import main
from dosplan.evaluation.tails import NEARBY, compare_sets, evaluate_drives
from dosplan.results.recording import Recording
from dosplan.scenario.synthetic import steady_tracks
from dosplan.system.files import FileError, read_json
from tests.support.factories import recording_of_sets
from tests.support.runs import configured, run_here
from tests.support.scenes import Goal, Problem, User, driving, rectangle, write_scenario_xml

STEPS = 10
CENTRES = np.array([[[2.5, 0.0], [5.0, 0.0]], [[2.5, 0.0], [5.0, 0.0]], [[2.5, 0.0], [5.0, 0.0]]])


def kept(ids: list[int], centres: Any, axes: Any, *, steps: int = STEPS) -> Recording:
    """One cycle at step 0 with sets 5 and 10 steps ahead; the ego stands in the origin."""
    return recording_of_sets(
        ids,
        np.asarray(centres, dtype=np.float64),
        np.asarray(axes, dtype=np.float64),
        np.zeros((len(ids), 2)),
        steps=steps,
    )


def test_a_distance_is_that_of_the_true_centre_and_near_is_where_it_is_then() -> None:
    # 100 drives at 5 m/s from the origin, as foretold but for 1 m aside; 101 starts 16 m ahead,
    # where near is within 20 m.
    tracks = steady_tracks([[0.0, 1.0, 0.0, 5.0], [16.0, 0.0, 0.0, 5.0]])
    centres = [[[2.5, 0.0], [5.0, 0.0]], [[18.5, 0.0], [21.0, 0.0]]]
    axes = [[[1.0, 0.48], [1.0, 1.98]], [[1.0, 1.0], [1.0, 1.0]]]
    found = compare_sets(kept([100, 101], centres, axes), tracks, np.zeros((STEPS + 1, 2)))
    np.testing.assert_array_equal(found.ids, [100, 100, 101, 101])
    np.testing.assert_array_equal(found.ahead, [5, 10, 5, 10])
    # Sets are taken two centimetres larger, as a run rounds them.
    np.testing.assert_allclose(found.distance, [2.0, 0.5, 0.0, 0.0])
    np.testing.assert_allclose(found.beyond, [0.5, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(found.near, [True, True, True, False])


def test_of_several_ellipses_the_nearest_counts() -> None:
    tracks = steady_tracks([[0.0, 1.0, 0.0, 5.0]])
    axes = [[[1.0, 0.08], [1.0, 0.08]], [[1.0, 1.98], [1.0, 0.48]]]
    found = compare_sets(kept([100, 100], CENTRES[:2], axes), tracks, np.zeros((STEPS + 1, 2)))
    np.testing.assert_allclose(found.distance, [0.5, 2.0])
    np.testing.assert_allclose(found.beyond, [0.0, 0.5])


def test_points_and_what_was_not_driven_are_not_compared() -> None:
    tracks = steady_tracks([[0.0, 0.0, 0.0, 5.0]] * 3)
    centres = CENTRES.copy()
    centres[1, 0] = np.nan  # No prediction there.
    axes = np.ones((3, 2, 2))
    axes[2, 0] = 0.0
    drive = kept([100, 101, 102], centres, axes, steps=STEPS - 1)
    found = compare_sets(drive, tracks, np.zeros((STEPS, 2)))
    np.testing.assert_array_equal(found.ids, [100])
    np.testing.assert_array_equal(found.ahead, [5])


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives of an ego that coasts at 10 m/s: behind a car at 5 m/s, and into one.

    The predictor puts a circle of 1 m around where everybody is, which a car at 5 m/s leaves.
    """
    folder = tmp_path_factory.mktemp("tails")
    (folder / "scenes").mkdir()
    for name, ahead in (("ZAM_Tail-1_1_T-1", 27.0), ("ZAM_Tail-2_1_T-1", 18.0)):
        goal = Goal(first_step=0, last_step=STEPS, position=rectangle(4.0, 3.0, 60.0, 0.0))
        write_scenario_xml(
            folder / "scenes" / f"{name}.xml",
            users=[User(7, driving(ahead, 0.0, 5.0, STEPS + 1))],
            problems=[Problem(goals=(goal,))],
            benchmark_id=name,
        )
    return run_here(configured(folder / "run", folder / "scenes")).path


def test_a_run_tells_who_left_and_by_how_much(run_folder: Path) -> None:
    found = evaluate_drives(run_folder)
    half, second, *_ = (row for row in found["tails"] if row["group"] == NEARBY)
    # 2.5 m ahead of the centre of a circle of 1.02 m.
    assert (half["ahead_s"], half["road_users"], half["outside"]) == (0.5, 2, 1.0)
    assert half["distance"]["0.5"] == pytest.approx(2.5 / 1.02, abs=0.05)
    assert half["beyond_m"]["0.9"] == pytest.approx(1.48, abs=0.05)
    assert (second["n"], second["distance"]["0.5"]) == (1, pytest.approx(5.0 / 1.02, abs=0.1))
    together = found["episodes"][-1]
    assert (together["ahead_s"], together["n"], together["held"]) == (None, 2, 0.0)
    assert together["high"] < 0.75
    (struck,) = found["struck"]
    assert (struck["scenario"], struck["road_user"]) == ("ZAM_Tail-2_1_T-1", 7)
    assert struck["inside"] is False
    assert struck["distance"] == pytest.approx(2.5 / 1.02, abs=0.05)


def test_the_command_measures_a_run_folder(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    json, markdown = tmp_path / "tails.json", tmp_path / "tails.md"
    arguments = ["evaluate", str(run_folder), "--json", str(json), "--markdown", str(markdown)]
    assert main(arguments) == 0
    assert read_json(json)["data"]["drives"] == 2
    text = markdown.read_text()
    assert "0 of 1 inside the set of half a second before" in text
    assert "Episodes in which nobody near left a set" in text
    capsys.readouterr()
    assert main(["evaluate", str(run_folder), "--predictor", "constant-velocity"]) == 2
    assert "with the sets that it was driven with" in capsys.readouterr().err
    assert main(["evaluate", str(run_folder), "--every", "2"]) == 2
    assert main(["evaluate", str(tmp_path), "--source", "x", "--predictor", "dos"]) == 2
    assert "--source goes with a run folder only" in capsys.readouterr().err


def test_a_run_without_sets_is_refused(run_folder: Path, tmp_path: Path) -> None:
    scenes = run_folder.parent / "scenes"
    points = run_here(configured(tmp_path / "points", scenes, predictor="constant-velocity"))
    with pytest.raises(FileError, match="no drive in which a road user had a set"):
        evaluate_drives(points.path)
