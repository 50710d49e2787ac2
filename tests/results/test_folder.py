"""The run folder keeps what it is given, and its summary is arithmetic that can be checked."""

from __future__ import annotations

import io
import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunManifest, RunSettings, write_manifest
from dosplan.results.recording import KEPT_EVERY, NEARBY_METRES, Recording, load_cycle_ms
from dosplan.results.rows import append_row, read_rows, read_run, row_line, write_rows
from dosplan.results.summary import pooled_cycle_ms, summarise
from dosplan.scenario.synthetic import straight_scenario
from dosplan.scoring.score import failed_score
from dosplan.simulation.traffic import Replay
from dosplan.system.files import (
    FileError,
    atomic_file,
    read_json,
    write_json,
    write_text,
)
from dosplan.system.provenance import git_revision
from dosplan.types import (
    Arm,
    CollisionClass,
    Episode,
    EpisodeEnd,
    EpisodeKey,
    FloatArray,
    Occupancy,
    Outcome,
    Plan,
    Score,
    SetUnion,
    SolveReport,
    SolveStatus,
)
from tests.support.old_files import save_as_version_0_4
from tests.support.traffic import ShyTraffic, braking_before, followed

SCENARIO = straight_scenario()


def _row(outcome: Outcome, velocity: float = 10.0, **changes: object) -> Score:
    safe = outcome in (Outcome.SUCCESS, Outcome.GOAL_MISSED)
    row = replace(
        failed_score(EpisodeKey("s", Arm.WITH_DOS), ""),
        outcome=outcome,
        safe=safe,
        velocity=velocity,
        steps=20,
        error=None,
    )
    return replace(row, **changes)  # type: ignore[arg-type]


def _sets(centres: FloatArray, horizon: int, radius: float = 1.5) -> Occupancy:
    n = len(centres)
    drift = np.linspace(0.0, 1.0, horizon)[None, :, None]
    return Occupancy(
        ids=10 + np.arange(n),
        centre=centres[:, None, :] + drift,
        semi_axes=np.full((n, horizon, 2), radius),
        angle=np.full((n, horizon), 0.3),
        valid=np.ones((n, horizon), dtype=np.bool_),
        footprint=np.tile([4.5, 1.8], (n, 1)),
        heading=np.zeros((n, horizon)),
    )


def _episode(cycles: int = 4, users: int = 3, horizon: int = 12, every: int = 2) -> Episode:
    """An ego at 10 m/s along +x from (5000, -3000), planning every second step."""
    steps = cycles * every
    x = 5000.0 + 1.0 * np.arange(steps + horizon + 2)
    states = np.stack([x, np.full_like(x, -3000.0), 0 * x, 0 * x + 10.0, 0 * x], axis=1)
    rng = np.random.default_rng(0)
    return Episode(
        scenario_id="ZAM_Test-1_1_T-1@7",
        arm=Arm.WITH_DOS,
        start_step=3,
        states=states[: steps + 1],
        inputs=np.zeros((steps, 2)),
        tracks=SCENARIO.tracks,
        end=EpisodeEnd.PLANNER_FAILURE,
        predict_seconds=0.001 * np.arange(cycles, dtype=np.float64),
        plan_seconds=0.01 * np.ones(cycles),
        plans=tuple(
            Plan(
                states=states[c * every : c * every + horizon - c + 1],
                inputs=np.zeros((horizon - c, 2)),
                report=SolveReport(
                    SolveStatus.MAX_ITERATIONS if c else SolveStatus.SOLVED,
                    iterations=10 + c,
                    slack=0.25 * c,
                    fallback="brake" if c else None,
                ),
            )
            for c in range(cycles)
        ),
        occupancies=tuple(
            _sets(states[c * every, :2] + rng.uniform(-30.0, 30.0, (users, 2)), horizon)
            for c in range(cycles)
        ),
        cycle_steps=3 + every * np.arange(cycles),
        error="planner p: ValueError: no (p.py:3)",
    )


def test_a_row_survives_its_file_with_its_types(tmp_path: Path) -> None:
    rows = [
        _row(
            Outcome.COLLISION,
            1.0 / 3.0,
            at_fault=True,
            collision_class=CollisionClass.ACTIVE_FRONT,
            collision_with=5,
            collision_step=17,
            cycle_ms_p50=0.1,
        ),
        failed_score(EpisodeKey("t", Arm.WITHOUT_DOS), 'a "quoted" line\nand another, ünïcode'),
    ]
    path = tmp_path / "scenarios.jsonl"
    write_rows(path, rows[:1])
    with path.open("ab", buffering=0) as file:
        append_row(file, rows[1])
        assert read_rows(path) == rows  # Written before the file is closed.
    assert type(read_rows(path)[0].collision_class) is CollisionClass


def test_a_row_has_the_promised_names() -> None:
    row = json.loads(row_line(_row(Outcome.SUCCESS)))
    assert {
        "scenario", "arm", "outcome", "safe", "at_fault", "collision_class", "velocity", "steps",
        "cycle_ms_p50", "cycle_ms_p99", "error",
    } <= row.keys()  # fmt: skip
    assert (row["arm"], row["outcome"]) == ("with_dos", "success")


@pytest.mark.parametrize("cut", [1, 5, 60])
def test_a_line_that_was_cut_off_is_dropped(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "scenarios.jsonl"
    whole = row_line(_row(Outcome.SUCCESS))
    path.write_text(whole + whole[:-cut])
    assert read_rows(path) == [_row(Outcome.SUCCESS)]


def test_no_file_is_no_rows(tmp_path: Path) -> None:
    assert read_rows(tmp_path / "scenarios.jsonl") == []


@pytest.mark.parametrize(
    "line",
    [
        "not json",
        "[1, 2]",
        row_line(_row(Outcome.SUCCESS)).replace('"success"', '"triumph"').strip(),
        row_line(_row(Outcome.SUCCESS)).replace('"steps": 20, ', "").strip(),
        row_line(_row(Outcome.SUCCESS)).replace('"steps"', '"paces"').strip(),
        row_line(_row(Outcome.SUCCESS)).replace('"steps": 20', '"steps": "20"').strip(),
        row_line(_row(Outcome.SUCCESS)).replace('"safe": true', '"safe": null').strip(),
        row_line(_row(Outcome.SUCCESS)).replace('"velocity": 10.0', '"velocity": NaN').strip(),
        row_line(_row(Outcome.SUCCESS)).replace('"scenario": "s"', '"scenario": []').strip(),
    ],
)
def test_a_line_that_is_no_row_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "scenarios.jsonl"
    path.write_text(row_line(_row(Outcome.SUCCESS)) + line + "\n")
    with pytest.raises(FileError, match=r"scenarios\.jsonl, line 2, is not a row of this version"):
        read_rows(path)


def test_a_row_with_nan_is_refused() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        row_line(_row(Outcome.SUCCESS, float("nan")))


def test_the_summary_counts_every_row() -> None:
    rows = [
        _row(Outcome.SUCCESS, 12.0, progress=14.0, min_time_to_collision=1.0),
        _row(Outcome.SUCCESS, 8.0, progress=7.0, min_time_to_collision=2.0),
        _row(Outcome.COLLISION, 6.0, at_fault=True, comfortable=False),
        _row(Outcome.COLLISION, 6.0, at_fault=False),
        _row(Outcome.OUT_OF_BOUNDS, 4.0),
        _row(Outcome.GOAL_MISSED, 0.0),
        _row(Outcome.PLANNER_FAILURE, 6.0),
        _row(Outcome.PLANNER_FAILURE, 0.0, steps=0),
    ]
    times = np.arange(101.0)  # Percentiles of 0..100 are themselves.
    summary = summarise(rows, 8, {Arm.WITH_DOS: times})[Arm.WITH_DOS]
    assert {
        "n": 8,
        "success_rate": 0.25,
        "safe_rate": 0.375,  # 2 successes, 1 missed goal.
        "collision_rate": 0.25,
        "at_fault_collision_rate": 0.125,
        "out_of_bounds_rate": 0.125,
        "goal_missed_rate": 0.125,
        "planner_failure_rate": 0.25,
        "comfortable_rate": pytest.approx(6.0 / 7.0),  # Of those that drove.
        "progress": 3.0,  # 21 / 7.
        "min_time_to_collision": 1.5,  # Of the two that have one.
        "velocity": 6.0,  # 42 / 7: a standing ego counts, one that never drove does not.
        "cycle_ms_p50": 50.0,
        "cycle_ms_p99": 99.0,
    }.items() <= summary.items()


def test_outcome_rates_add_up_to_one() -> None:
    rows = [_row(outcome) for outcome in Outcome for _ in range(3)]
    summary = summarise(rows, 21, {Arm.WITH_DOS: np.empty(0)})[Arm.WITH_DOS]
    assert (summary["n"], summary["usable"]) == (21, 15)  # Of which each outcome is a fifth.
    assert summary["success_rate"] == summary["collision_rate"] == 0.2
    shares = ("success", "collision", "out_of_bounds", "goal_missed", "planner_failure")
    assert sum(summary[f"{name}_rate"] or 0.0 for name in shares) == pytest.approx(1.0)
    assert summary["cycle_ms_p50"] is None


@pytest.mark.parametrize("n", [1, 3])
def test_a_missing_or_surplus_row_is_an_error(n: int) -> None:
    rows = [_row(Outcome.SUCCESS), _row(Outcome.SUCCESS)]
    with pytest.raises(ValueError, match=f"2 rows for {n} episodes"):
        summarise(rows, n, {Arm.WITH_DOS: np.empty(0)})


def test_cycle_times_are_pooled_over_cycles_not_over_episodes(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    long, short = _episode(cycles=6), replace(_episode(cycles=2), scenario_id="short")
    for episode in (long, short):
        path = folder.recording(EpisodeKey(episode.scenario_id, episode.arm))
        Recording.of(SCENARIO, episode).save(path)
    rows = [
        _row(Outcome.SUCCESS, scenario=long.scenario_id, cycle_ms_p50=1.0),
        _row(Outcome.SUCCESS, scenario="short", cycle_ms_p50=1.0),
        failed_score(EpisodeKey("crashed", Arm.WITH_DOS), "no file"),
        _row(Outcome.SUCCESS, scenario="other arm", arm=Arm.WITHOUT_DOS, cycle_ms_p50=1.0),
    ]
    times = pooled_cycle_ms(folder, rows, Arm.WITH_DOS)
    # predict 0, 1, 2, ... ms and plan 10 ms.
    assert times == pytest.approx([10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 10.0, 11.0])
    with pytest.raises(FileError, match=r"other%20arm\.without_dos\.npz is missing"):
        pooled_cycle_ms(folder, rows, Arm.WITHOUT_DOS)


def test_a_recording_gives_the_episode_back(tmp_path: Path) -> None:
    episode = _episode()
    path = RunFolder(tmp_path).recording(EpisodeKey(episode.scenario_id, episode.arm))
    Recording.of(SCENARIO, episode).save(path)
    assert path.name == "ZAM_Test-1_1_T-1@7.with_dos.npz"
    back = Recording.load(path)

    assert (back.scenario_id, back.arm, back.end) == (episode.scenario_id, episode.arm, episode.end)
    assert (back.start_step, back.error) == (3, episode.error)
    # What decides the score is kept bit by bit.
    np.testing.assert_array_equal(back.states, episode.states)
    np.testing.assert_array_equal(back.inputs, episode.inputs)
    np.testing.assert_array_equal(back.cycle_steps, [3, 5, 7, 9])
    assert back.status == ("solved", "max_iterations", "max_iterations", "max_iterations")
    assert back.fallback == ("", "brake", "brake", "brake")
    assert back.iterations.tolist() == [10, 11, 12, 13]
    assert back.slack.tolist() == [0.0, 0.25, 0.5, 0.75]

    # Plans and sets are off by half a grain, 1/128 m, at most, however far from the frame's origin.
    for cycle, plan in enumerate(episode.plans):
        planned = back.plan_centres[cycle]
        expected = SCENARIO.task.vehicle.centre(plan.states)
        assert np.abs(planned[: len(expected)] - expected).max() <= 1.0 / 128.0 + 1e-4
        assert np.isnan(planned[len(expected) :]).all()
    assert back.set_offsets.tolist() == [5, 10]
    assert back.set_cycle.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3]
    assert back.set_ids.tolist() == [10, 11, 12] * 4
    kept = np.concatenate([o.centre[:, KEPT_EVERY - 1 :: KEPT_EVERY] for o in episode.occupancies])
    assert np.abs(back.set_centres - kept).max() <= 1.0 / 128.0 + 1e-4
    assert back.set_semi_axes.tolist() == np.full((12, 2, 2), 1.5).tolist()
    assert np.abs(back.set_angles - 0.3).max() <= 1.0 / 128.0


def _assert_same(one: Recording, other: Recording) -> None:
    for field in fields(Recording):
        mine, theirs = getattr(one, field.name), getattr(other, field.name)
        if isinstance(mine, np.ndarray):
            np.testing.assert_array_equal(mine, theirs, field.name, strict=True)
        else:
            assert mine == theirs, field.name


def test_a_recording_from_memory_is_that_of_the_file(tmp_path: Path) -> None:
    recording = Recording.of(SCENARIO, _episode())
    recording.save(tmp_path / "e.npz")
    _assert_same(Recording.load(tmp_path / "e.npz"), recording)
    Recording.load(tmp_path / "e.npz").save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "e.npz").read_bytes()


def test_a_recording_of_version_0_4_opens(tmp_path: Path) -> None:
    recording = Recording.of(SCENARIO, _episode())
    recording = replace(recording, active_ids=((), (3, 4), (), (5,)), tracks=None)
    save_as_version_0_4(tmp_path / "e.npz", recording)
    back = Recording.load(tmp_path / "e.npz")
    assert not back.exact
    for name in ("predict_seconds", "plan_seconds"):  # In single precision, and in ms.
        np.testing.assert_allclose(getattr(back, name), getattr(recording, name), rtol=1e-7)
    exact = ("exact", "predict_seconds", "plan_seconds")
    _assert_same(replace(back, **{name: getattr(recording, name) for name in exact}), recording)
    np.testing.assert_array_equal(load_cycle_ms(tmp_path / "e.npz", 2), back.scored_cycle_ms(2))


@pytest.mark.parametrize(("distance", "kept"), [(-0.1, True), (0.1, False)])
def test_sets_far_from_the_ego_are_left_out(tmp_path: Path, distance: float, kept: bool) -> None:
    episode = _episode(cycles=1, users=1)
    away = np.array([[0.0, NEARBY_METRES + distance]])
    ahead = _sets(episode.states[0, :2] + away, 12)
    Recording.of(SCENARIO, replace(episode, occupancies=(ahead,))).save(tmp_path / "e.npz")
    assert (len(Recording.load(tmp_path / "e.npz").set_ids) == 1) is kept


def test_sets_that_are_not_valid_come_back_as_nan(tmp_path: Path) -> None:
    episode = _episode(cycles=1, users=2)
    (sets,) = episode.occupancies
    valid = np.array(sets.valid)
    valid[0, 7:] = False  # Seen at step 5, gone at step 10.
    valid[1] = False  # Never there: left out.
    hidden = replace(sets, valid=valid)
    Recording.of(SCENARIO, replace(episode, occupancies=(hidden,))).save(tmp_path / "e.npz")
    back = Recording.load(tmp_path / "e.npz")
    assert back.set_ids.tolist() == [10]
    assert np.isfinite(back.set_centres[0, 0]).all()
    assert np.isnan(back.set_centres[0, 1]).all()
    assert np.isnan(back.set_angles[0, 1])


def test_components_of_a_union_are_kept_one_by_one_the_most_likely_first(tmp_path: Path) -> None:
    episode = _episode(cycles=1, users=2)
    (sets,) = episode.occupancies
    # The first road user's second component is far away, and kept as the road user is near.
    centre = np.stack([sets.centre, sets.centre + 200.0], axis=1)
    union = SetUnion(
        weight=np.array([[0.25, 0.75], [1.0, 0.0]]),
        centre=centre,
        semi_axes=np.tile([[2.0, 1.0], [4.0, 3.0]], (2, sets.horizon, 1, 1)).swapaxes(1, 2),
        angle=np.repeat(sets.angle[:, None], 2, axis=1),
        heading=np.repeat(sets.heading[:, None], 2, axis=1),
    )
    occupancy = replace(sets, union=union)
    recording = Recording.of(SCENARIO, replace(episode, occupancies=(occupancy,)))
    recording.save(tmp_path / "e.npz")
    back = Recording.load(tmp_path / "e.npz")
    _assert_same(back, recording)
    assert back.set_ids.tolist() == [10, 10, 11]
    assert back.weights.tolist() == [0.75, 0.25, 1.0]
    assert back.first_components.tolist() == [0, 2]
    assert back.set_semi_axes[:, 0].tolist() == [[4.0, 3.0], [2.0, 1.0], [2.0, 1.0]]
    far, near = back.set_centres[:2, 0] - back.set_centres[1, 0]
    assert far == pytest.approx([200.0, 200.0], abs=0.02)
    assert near.tolist() == [0.0, 0.0]


def test_files_of_sets_that_are_no_unions_hold_no_weights(tmp_path: Path) -> None:
    recording = Recording.of(SCENARIO, _episode())
    recording.save(tmp_path / "e.npz")
    assert recording.set_weights is None
    assert (recording.weights == 1.0).all()
    assert recording.first_components.tolist() == list(range(12))
    with np.load(tmp_path / "e.npz") as file:
        assert "set_weights" not in file.files
    with pytest.raises(ValueError, match=r"set_weights has shape \(3,\), expected \(12,\)"):
        replace(recording, set_weights=np.ones(3))


def test_road_users_that_reacted_are_in_the_file_and_recorded_ones_are_not(tmp_path: Path) -> None:
    path = tmp_path / "e.npz"
    scenario, episode = followed(), braking_before(ShyTraffic())
    triangle = np.array([[2.0, 0.0], [-1.0, 1.0], [-1.0, -1.0]])
    odd = replace(episode.tracks, outlines=(None, triangle))
    Recording.of(scenario, replace(episode, tracks=odd)).save(path)
    back = Recording.load(path)
    assert back.traffic == "shy-v1"
    tracks = back.tracks_in(scenario)
    for name in ("ids", "size", "states", "valid"):
        np.testing.assert_array_equal(getattr(tracks, name), getattr(odd, name))
    assert tracks.kinds == odd.kinds
    assert tracks.outlines[0] is None
    np.testing.assert_array_equal(tracks.outlines[1], triangle)

    long = path.stat().st_size
    Recording.of(scenario, braking_before(Replay())).save(path)
    back = Recording.load(path)
    assert (back.traffic, back.tracks) == ("replay", None)
    assert back.tracks_in(scenario) is scenario.tracks
    with np.load(path) as file:
        assert not file["data"].size
    assert path.stat().st_size < long


def test_times_and_slacks_are_kept_exactly_and_those_of_older_files_are_read(
    tmp_path: Path,
) -> None:
    path, third = tmp_path / "e.npz", 1.0 / 3.0
    episode = _episode(cycles=2)
    report = SolveReport(
        SolveStatus.SOLVED,
        slack=third,
        road_slack=third,
        active_ids=(7,),
        waits_for="light 31",
        unreachable="2.1 m short",
        decision="pass 12",
    )
    episode = replace(
        episode,
        plans=tuple(replace(plan, report=report) for plan in episode.plans),
        predict_seconds=np.full(2, third),
    )
    Recording.of(SCENARIO, episode).save(path)
    back = Recording.load(path)
    assert back.exact
    assert back.reports == (report, report)
    np.testing.assert_array_equal(back.predict_seconds, episode.predict_seconds)
    np.testing.assert_array_equal(load_cycle_ms(path, 99), back.cycle_ms)
    later = int(back.cycle_steps[1]) - back.start_step  # Of the second cycle; no step follows it.
    np.testing.assert_array_equal(load_cycle_ms(path, later), back.cycle_ms[:1])
    save_as_version_0_4(path, back)
    old = Recording.load(path)
    assert (old.exact, old.traffic) == (False, "replay")
    np.testing.assert_allclose(old.predict_seconds, third, rtol=1e-7)
    np.testing.assert_array_equal(load_cycle_ms(path, later), old.cycle_ms[:1])


def test_an_episode_without_a_cycle_is_kept(tmp_path: Path) -> None:
    Recording.of(SCENARIO, _episode(cycles=0)).save(tmp_path / "e.npz")
    back = Recording.load(tmp_path / "e.npz")
    assert (len(back.states), len(back.inputs), len(back.cycle_ms), back.status) == (1, 0, 0, ())


def test_a_recording_of_a_busy_scene_is_small(tmp_path: Path) -> None:
    # 10 s of planning at every step among 30 road users near by, all predicted anew each time.
    episode = _episode(cycles=100, users=30, horizon=120, every=1)
    path = tmp_path / "e.npz"
    Recording.of(SCENARIO, episode).save(path)
    plain = sum(o.centre.nbytes + o.semi_axes.nbytes + o.angle.nbytes for o in episode.occupancies)
    assert path.stat().st_size < plain / 20


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"not a zip"])
def test_a_broken_recording_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "e.npz").write_bytes(content)
    with pytest.raises(FileError, match=r"e\.npz is not an episode file"):
        Recording.load(tmp_path / "e.npz")


@pytest.mark.parametrize("step", [0, 1])
def test_a_plan_of_which_a_place_is_missing_is_named(tmp_path: Path, step: int) -> None:
    Recording.of(SCENARIO, _episode()).save(tmp_path / "e.npz")
    with np.load(tmp_path / "e.npz") as file:
        arrays = dict(file)
    arrays["plan_centres"][2, step] = np.nan
    np.savez(tmp_path / "e.npz", **arrays)
    with pytest.raises(FileError, match="plan_centres holds what is no number before the end of"):
        Recording.load(tmp_path / "e.npz")


def test_a_pickle_in_a_recording_is_never_opened(tmp_path: Path) -> None:
    np.savez(tmp_path / "e.npz", states=np.array([{"code": 1}], dtype=object))
    with pytest.raises(FileError, match="is not an episode file"):
        Recording.load(tmp_path / "e.npz")


@pytest.mark.parametrize("scenario", ["../../up", "a/b", "..", "a b:c"])
def test_an_episode_file_stays_in_its_folder(tmp_path: Path, scenario: str) -> None:
    path = RunFolder(tmp_path).recording(EpisodeKey(scenario, Arm.WITH_DOS))
    assert path.resolve().parent == (tmp_path / "episodes").resolve()


def test_a_write_that_fails_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "f.json"
    write_json(path, {"a": 1})
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(path, {"a": float("nan")})
    with pytest.raises(TypeError, match="bytes-like"), atomic_file(path) as file:
        file.writelines([b"half", "way"])  # type: ignore[list-item]
    assert read_json(path) == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["f.json"]


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match=r"cannot write .*/file/summary\.md: "):
        write_text(tmp_path / "file" / "summary.md", "")


FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="only Linux has a device that is always full")
def test_a_row_that_does_not_fit_the_disk_is_an_error_that_closing_does_not_hide() -> None:
    with (
        pytest.raises(FileError, match=r"cannot write /dev/full: No space left"),
        FULL.open("ab", buffering=0) as file,
    ):
        append_row(file, _row(Outcome.SUCCESS))


class _Sipping(io.BytesIO):
    """Takes seven bytes at a time, as a write without a buffer may."""

    def write(self, data: Any) -> int:
        return super().write(data[:7])


def test_a_row_that_is_taken_in_parts_is_whole() -> None:
    file = _Sipping()
    append_row(file, _row(Outcome.SUCCESS))
    assert file.getvalue().decode() == row_line(_row(Outcome.SUCCESS))


def test_a_long_id_has_a_file_of_its_own(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    long = "ä" * 240  # Six characters each when quoted.
    paths = [
        folder.recording(EpisodeKey(name, Arm.WITH_DOS)) for name in (long, long + "x", "ä" * 33)
    ]
    assert len(set(paths)) == 3
    for path in paths:
        Recording.of(SCENARIO, _episode(cycles=1)).save(path)
    assert "-" not in paths[2].name  # 198 characters are short enough.


@pytest.mark.parametrize("content", [None, "{", "\xff"])
def test_json_that_cannot_be_read_is_named(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / "run.json"
    if content is not None:
        path.write_text(content, encoding="latin-1")
    with pytest.raises(FileError, match=r"run\.json is (missing|not JSON)"):
        read_json(path)


def test_a_run_that_is_not_finished_is_not_read(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="is not a run folder"):
        read_run(tmp_path)
    manifest = RunManifest(
        config=RunSettings(arms=(Arm.WITH_DOS,)),
        planner="p",
        predictor="q",
        scenarios=("s", "t"),
        versions={},
    )
    write_manifest(RunFolder(tmp_path), manifest)
    write_rows(tmp_path / "scenarios.jsonl", [_row(Outcome.SUCCESS)])
    with pytest.raises(FileError, match="lacks 1 episodes: run the same command again"):
        read_run(tmp_path)
    # As many rows as episodes, but not theirs.
    write_rows(tmp_path / "scenarios.jsonl", [_row(Outcome.SUCCESS), _row(Outcome.SUCCESS)])
    with pytest.raises(FileError, match="lacks 1 episodes"):
        read_run(tmp_path)
    both = [_row(Outcome.SUCCESS), _row(Outcome.SUCCESS, scenario="t")]
    write_rows(tmp_path / "scenarios.jsonl", [*both, both[0]])
    with pytest.raises(FileError, match="holds 1 rows too many"):
        read_run(tmp_path)
    write_rows(tmp_path / "scenarios.jsonl", both)
    assert read_run(tmp_path) == (manifest, both)


@pytest.mark.parametrize("content", [{}, [], {"config": {"arms": ["both"]}}, 3])
def test_a_run_json_of_another_kind_is_named(tmp_path: Path, content: Any) -> None:
    write_json(tmp_path / "run.json", content)
    with pytest.raises(FileError, match=r"is not a run\.json of this version"):
        read_run(tmp_path)


def test_the_revision_is_that_of_the_source_itself(tmp_path: Path) -> None:
    assert git_revision(tmp_path) is None
