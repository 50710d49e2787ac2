"""The page of a run: what it holds, what it keeps out, and what it does without."""

from __future__ import annotations

import base64
import gzip
import json
import re
import shutil
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dosplan.cli import main as cli
from dosplan.cli.main import main
from dosplan.report.html import findings, page
from dosplan.report.html.cases import Case, change_of
from dosplan.report.html.codec import METRE, differences, pack, polyline
from dosplan.report.html.coverage import predictions_of, sets_met, total
from dosplan.report.html.figures import MOST_SIDES
from dosplan.report.html.player import encode_episode
from dosplan.report.html.predictions import prediction_blocks
from dosplan.report.html.scenarios import families, find_scenes
from dosplan.report.html.write import write_report, write_runs
from dosplan.report.palette import ARM_COLOURS, LAMP_COLOURS, SIGN_RED
from dosplan.results.comparison import compare_rows
from dosplan.results.drive import Drive
from dosplan.results.manifest import RunSettings
from dosplan.results.markdown import ARMS_SIDE_BY_SIDE, interval_text
from dosplan.results.recording import Recording
from dosplan.results.rows import row_line
from dosplan.results.sweeps import SweepFolder, SweepRun
from dosplan.scenario.synthetic import steady_tracks, straight_scenario
from dosplan.scoring.metrics import find_metric
from dosplan.scoring.score import failed_score
from dosplan.simulation.loop import run_episode
from dosplan.simulation.settings import LoopSettings, SensingSettings
from dosplan.simulation.traffic import Replay, Traffic
from dosplan.system.files import FileError, write_json
from dosplan.types import (
    COLOURS,
    Arm,
    EpisodeKey,
    FloatArray,
    Lanelet,
    LightColour,
    Outcome,
    Score,
)
from tests.support.factories import recording_of_sets
from tests.support.lights import STOP_X, TURNS_GREEN, regulated_scenario
from tests.support.plugins import PLUGINS, CoastPlanner, GrowingPredictor
from tests.support.scenes import (
    Goal,
    Problem,
    User,
    driving,
    rectangle,
    straight_road,
    write_scenario_xml,
)
from tests.support.suite import FUTURES_SUITE, manifest
from tests.support.traffic import ShyTraffic, braking_before, followed

COAST = ["--planner", f"{PLUGINS}:CoastPlanner", "--predictor", "constant-velocity"]
HOSTILE = "ZAM_</script><img src=x onerror=alert(1)>-1_1_T-1"


def _recording(arm: Arm, centres: FloatArray, semi_axes: FloatArray, angle: float) -> Recording:
    """one cycle at step 40 that predicts one road user 5 and 10 steps ahead."""
    return recording_of_sets(
        [100],
        centres[None],
        semi_axes[None],
        np.full((1, 2), angle),
        arm=arm,
        start_step=40,
        steps=2,
    )


def _row(scenario: str, arm: Arm, outcome: Outcome, **changes: Any) -> Score:
    safe = outcome in (Outcome.SUCCESS, Outcome.GOAL_MISSED)
    row = replace(
        failed_score(EpisodeKey(scenario, arm), ""), outcome=outcome, safe=safe, steps=2, error=None
    )
    return replace(row, **changes)


def _write_run(folder: Path, rows: list[Score], source: str = "nowhere") -> Path:
    """A run folder without recordings."""
    folder.mkdir()
    manifest = {
        "config": {"source": source, "arms": list(dict.fromkeys(row.arm for row in rows))},
        "planner": "mpc-v1",
        "predictor": "dos-v1",
        "scenarios": list(dict.fromkeys(row.scenario for row in rows)),
        "versions": {},
    }
    write_json(folder / "run.json", manifest)
    (folder / "scenarios.jsonl").write_text("".join(map(row_line, rows)), encoding="utf-8")
    return folder


def _arm_rows(arm: Arm, reached: str) -> list[Score]:
    """A row for each sign: ``+`` reached the goal, ``x`` collided, ``?`` could not be used."""
    outcomes = {"+": Outcome.SUCCESS, "x": Outcome.COLLISION, "?": Outcome.UNUSABLE}
    return [_row(f"ZAM_A-{i}_1_T-1", arm, outcomes[sign]) for i, sign in enumerate(reached)]


def _data(html: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(found[1])
    return data


def _unpacked(text: str) -> dict[str, Any]:
    payload: dict[str, Any] = json.loads(gzip.decompress(base64.b64decode(text)))
    return payload


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A free road, and one on which a car stands 18 m ahead."""
    folder = tmp_path_factory.mktemp("scenes")
    goal = Goal(first_step=0, last_step=20, position=rectangle(6.0, 3.0, 28.0, 0.0))
    for name, users in (
        ("ZAM_Free-1_1_T-1", [User(7, driving(60.0, 0.0, 10.0, 40))]),
        ("ZAM_Hit-1_1_T-1", [User(8, driving(28.0, 0.0, 0.0, 40))]),
    ):
        write_scenario_xml(
            folder / f"{name}.xml",
            users=users,
            problems=[Problem(goals=(goal,))],
            benchmark_id=name,
        )
    return folder


@pytest.fixture(scope="module")
def driven(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of both, with its report."""
    out = tmp_path_factory.mktemp("driven") / "run"
    assert main(["run", str(scenes), *COAST, "--in-process", "--out", str(out)]) == cli.OK
    return out


@given(st.lists(st.integers(-(10**6), 10**6)), st.integers(0, 3))
def test_cumulative_sums_undo_differences(values: list[int], order: int) -> None:
    series = np.array(differences(np.array(values) * METRE, METRE, order), dtype=np.int64)
    for _ in range(order):
        series = np.cumsum(series)
    assert series.tolist() == values


def test_a_line_is_its_first_point_and_steps() -> None:
    # In units of 5 cm: (20, 0), then (+20, +2); the point in between is no step at all.
    assert polyline([[1.0, 0.0], [1.01, 0.01], [2.0, 0.1]]) == [20, 0, 20, 2]


def test_packing_is_deterministic_and_undone() -> None:
    payload = {"a": [1, 2], "b": "ü"}
    assert pack(payload) == pack(payload)
    assert _unpacked(pack(payload)) == payload


def test_who_is_in_a_set_is_told_exactly() -> None:
    # The road user drives along x at 8 m/s from x = 30, so it is at 66 m at step 45 and at 70 m at
    # step 50. Ellipses of 2 m by 0.5 m, turned by 90 degrees: long across the road. They are taken
    # two centimetres larger, as a run rounds them.
    tracks = steady_tracks([[30.0, 0.0, 0.0, 8.0]])
    axes = np.tile([2.0, 0.5], (2, 1))
    for along, across, held in ((0.51, 0.0, True), (0.53, 0.0, False), (0.0, 2.01, True)):
        centres = np.array([[66.0 + along, across], [70.0, 2.03]])
        recording = _recording(Arm.WITH_DOS, centres, axes, np.pi / 2.0)
        met = sets_met(recording, tracks, driven=2)
        assert met.inside.tolist() == [[held, False]]
        assert [(one.offset, one.inside, one.counted) for one in total([met])] == [
            (5, int(held), 1),
            (10, 0, 1),
        ]
        (prediction,) = predictions_of(met, user=100, step=45)
        assert prediction.held is held
        assert prediction.miss == pytest.approx(np.hypot(along, across))


def _union_recording(first: FloatArray, second: FloatArray) -> Recording:
    """The same cycle with two components, at (2, 2) centres for the two steps ahead."""
    one = _recording(Arm.WITH_DOS, first, np.ones((2, 2)), 0.0)
    return replace(
        one,
        set_cycle=np.array([0, 0]),
        set_ids=np.array([100, 100]),
        set_centres=np.stack([first, second]),
        set_semi_axes=np.ones((2, 2, 2)),
        set_angles=np.zeros((2, 2)),
        set_weights=np.array([0.8, 0.2]),
    )


def test_a_union_holds_whom_any_of_its_components_does() -> None:
    tracks = steady_tracks([[30.0, 0.0, 0.0, 8.0]])  # At 66 m, then at 70 m.
    far = np.array([[66.0, 5.0], [70.0, 5.0]])
    recording = _union_recording(far, np.array([[66.0, 0.5], [72.0, 0.0]]))
    met = sets_met(recording, tracks, driven=2)
    assert met.ids.tolist() == [100]
    assert met.inside.tolist() == [[True, False]]
    assert met.counted.tolist() == [[True, True]]
    (prediction,) = predictions_of(met, user=100, step=45)
    assert prediction.miss == pytest.approx(5.0)  # Of the most likely component.


def test_components_of_a_union_are_drawn_by_their_weight() -> None:
    centres = np.array([[66.0, 0.0], [70.0, 0.0]])
    union = _union_recording(centres, centres + 4.0)
    points = _recording(Arm.WITHOUT_DOS, centres, np.zeros((2, 2)), 0.0)
    blocks, used = prediction_blocks([union, points], [2, 2], None, np.zeros(2))
    # The other arm was handed the most likely component: the same prediction.
    assert used == [{"block": 0, "points": False}, {"block": 0, "points": True}]
    likely, other = blocks[0]["runs"]
    assert (likely["component"], likely["weights"]) == (0, [80])
    assert (other["component"], other["weights"]) == (1, [20])
    blocks, _ = prediction_blocks([points], [2], None, np.zeros(2))
    assert blocks[0]["runs"][0].keys() == {"user", "from", "n", "sets"}


def test_points_are_no_sets_but_have_a_miss() -> None:
    tracks = steady_tracks([[30.0, 0.0, 0.0, 8.0]])
    centres = np.array([[67.0, 0.0], [70.0, 0.0]])
    met = sets_met(_recording(Arm.WITHOUT_DOS, centres, np.zeros((2, 2)), 0.0), tracks, 2)
    assert total([met]) == []
    (prediction,) = predictions_of(met, user=100, step=45)
    assert prediction.held is None
    assert prediction.miss == pytest.approx(1.0)


def test_what_was_predicted_after_the_drive_does_not_count() -> None:
    tracks = steady_tracks([[30.0, 0.0, 0.0, 8.0]])
    recording = _recording(Arm.WITH_DOS, np.zeros((2, 2)), np.ones((2, 2)), 0.0)
    assert total([sets_met(recording, tracks, driven=0)]) == []


def test_arms_that_see_the_same_share_their_predictions() -> None:
    centres = np.array([[66.0, 0.0], [70.0, 0.0]])
    sets = _recording(Arm.WITH_DOS, centres, np.ones((2, 2)), 0.0)
    points = _recording(Arm.WITHOUT_DOS, centres, np.zeros((2, 2)), 0.0)
    other = _recording(Arm.WITHOUT_DOS, centres + 1.0, np.zeros((2, 2)), 0.0)
    origin = np.zeros(2)
    blocks, used = prediction_blocks([points, sets], [2, 2], None, origin)
    assert len(blocks) == 1
    assert used == [{"block": 0, "points": True}, {"block": 0, "points": False}]
    blocks, used = prediction_blocks([other, sets], [2, 2], None, origin)
    assert len(blocks) == 2
    assert [one and one["block"] for one in used] == [1, 0]


def test_families_are_places_or_their_countries() -> None:
    ids = [*(f"DEU_Muc-{i}_1_T-1" for i in range(4)), "DEU_Ffb-1_1_T-1", "C-USA_US101-1_1_T-1"]
    found = families(ids)
    assert [found[i] for i in ids] == [*["DEU_Muc"] * 4, "DEU", "USA"]


def test_scenarios_of_several_suites_are_of_the_suites_kinds() -> None:
    ids = {row["kind"]: row["id"] for row in manifest(FUTURES_SUITE)}
    for source in ("suite", ("suite", "suite-1")):
        scenes = find_scenes(source, cached=True)
        assert {kind: scenes.kind(name, None) for kind, name in ids.items()} == {k: k for k in ids}
    assert scenes.kind("ZAM_Zebra-1_1_T-1", None) == "pedestrian crossing"


def test_changes_have_their_words() -> None:
    good, bad = (_row("s", Arm.WITH_DOS, o) for o in (Outcome.SUCCESS, Outcome.COLLISION))
    assert [change_of(pair) for pair in ([bad, good], [good, bad], [bad, bad], [good, good])] == [
        "fixed",
        "broken",
        "both failed",
        "both succeeded",
    ]
    assert change_of([bad]) == "failed"


def test_an_episode_without_its_scenario_is_the_drive_alone() -> None:
    recording = _recording(Arm.WITH_DOS, np.zeros((2, 2)), np.ones((2, 2)), 0.0)
    row = _row("s", Arm.WITH_DOS, Outcome.GOAL_MISSED)
    payload = encode_episode(None, [None, Drive(row, recording)])
    assert "road" not in payload
    assert payload["sides"][0] is None
    assert len(payload["sides"][1]["x"]) == row.steps + 1
    assert pack(payload)


def test_sides_whose_road_users_reacted_have_road_users_of_their_own() -> None:
    scenario = followed()

    def drive(traffic: Traffic) -> Drive:
        return Drive.of(scenario, braking_before(traffic))

    def last_x(user: dict[str, Any]) -> float:
        return float(np.cumsum(np.cumsum(user["x"]))[-1] * METRE)

    replayed, shy = drive(Replay()), drive(ShyTraffic())
    shared = encode_episode(scenario, [replayed, replayed])
    assert [(user["id"], "sides" in user) for user in shared["users"]] == [(100, False)]
    payload = encode_episode(scenario, [replayed, shy])
    assert [(user["id"], user["sides"]) for user in payload["users"]] == [
        (100, [0]),
        (100, [1]),
        (900, [1]),
    ]
    assert [side["touched"] for side in payload["sides"]] == [100, None]
    for user, drive_ in zip(payload["users"], (replayed, shy), strict=False):
        step, origin = user["to"], np.rint(replayed.ego[0, 0])
        wanted = drive_.tracks.states[0, step, 0] - origin
        assert last_x(user) == pytest.approx(wanted, abs=METRE)
    assert (
        encode_episode(None, [None, Drive(shy.row, shy.recording)])["users"][0]["id"] == 100
    )  # They are in its file.
    assert pack(payload)


def test_lanelets_that_are_no_road_are_drawn_apart() -> None:
    scenario = followed()
    lanelets = scenario.road_map.lanelets
    west, _, east, north = scenario.road_map.drivable.bounds
    left, right = ([[west, y], [east, y]] for y in (north + 3.0, north))
    walk = Lanelet(77, np.array(left), np.array(right), is_road=False)
    beside = replace(scenario, road_map=replace(scenario.road_map, lanelets=(*lanelets, walk)))
    drive = Drive.of(scenario, braking_before(Replay()))
    plain, drawn = (encode_episode(scene, [drive]) for scene in (scenario, beside))
    assert plain["offRoad"] == []
    assert len(drawn["offRoad"]) == 1
    assert drawn["road"] == plain["road"]


def test_what_regulates_is_in_the_page() -> None:
    scenario = regulated_scenario()
    drive = Drive.of(
        scenario, run_episode(scenario, CoastPlanner(), GrowingPredictor(), Arm.WITH_DOS)
    )
    payload = encode_episode(scenario, [drive, drive])
    x0 = np.rint(drive.ego[0, 0])
    assert {look: len(found) for look, found in payload["paint"].items()} == {
        "solid": 1,
        "dashed": 1,
    }
    assert len(payload["lines"]) == 1
    assert [line[0] * METRE + x0 for line in payload["stops"]] == pytest.approx([STOP_X] * 2)
    ((width, *_),) = payload["crosswalks"]
    assert width * METRE == pytest.approx(4.0)
    assert [(sign[0], *sign[3:]) for sign in payload["signs"]] == [
        ("speed_limit", "50", "km/h"),
        ("stop", "", ""),
    ]
    red, green = (COLOURS.index(colour) for colour in (LightColour.RED, LightColour.GREEN))
    # Only the steps of a change are written.
    assert [(lamp["from"], lamp["shown"]) for lamp in payload["lights"]] == [
        ([0, TURNS_GREEN], [red, green]),
        ([0], [green]),
        ([0], [red]),
    ]
    assert not any("sides" in lamp for lamp in payload["lights"])
    assert pack(payload)


def test_lights_that_were_others_for_a_side_are_its_own() -> None:
    scenario = regulated_scenario()
    episode = run_episode(scenario, CoastPlanner(), GrowingPredictor(), Arm.WITH_DOS)
    dark = replace(scenario.signals, colours=np.zeros_like(scenario.signals.colours))
    drives = [Drive.of(scenario, replace(episode, signals=signals)) for signals in (None, dark)]
    lights = encode_episode(scenario, drives)["lights"]
    assert [lamp["sides"] for lamp in lights] == [[0], [0], [0], [1], [1]]
    assert {tuple(lamp["shown"]) for lamp in lights if lamp["sides"] == [1]} == {(0,)}


def test_lamps_and_signs_have_one_colour_in_pages_and_films(driven: Path) -> None:
    data = _data((driven / "report.html").read_text(encoding="utf-8"))
    assert [tuple(pair) for pair in data["lamps"]] == list(LAMP_COLOURS)
    assert data["signs"]["red"] == SIGN_RED


def test_what_reading_put_right_stands_at_the_scenario(tmp_path: Path) -> None:
    name = "ZAM_Limit-1_1_T-1"
    path = write_scenario_xml(
        tmp_path / f"{name}.xml", straight_road(lanes=1, speed_limit=9.0), benchmark_id=name
    )
    path.write_text(path.read_text("utf-8").replace(">9.0<", ">fast<"), "utf-8")
    out = tmp_path / "run"
    assert main(["run", str(path), *COAST, "--in-process", "--out", str(out)]) == cli.OK
    ((case,),) = (s["cases"] for s in _data((out / "report.html").read_text("utf-8"))["sections"])
    (note,) = case["notes"]
    assert note.endswith("its speed limit 'fast' cannot be read; no limit is taken")


def test_a_run_writes_its_report(driven: Path) -> None:
    html = (driven / "report.html").read_text(encoding="utf-8")
    (section,) = _data(html)["sections"]
    assert section["names"] == ["without DOS", "with DOS"]
    hit, free = section["cases"]  # What failed comes first.
    assert [hit["id"], free["id"]] == ["ZAM_Hit-1_1_T-1", "ZAM_Free-1_1_T-1"]
    assert [side["outcome"] for side in hit["sides"]] == ["collision", "collision"]
    # From 10 m at 10 m/s, half a car's length before 28 m less the ego's own: some 1.3 s.
    assert re.match(r"ran into car 8, which stood after 1\.\d s; at fault", hit["sides"][0]["why"])
    payload = _unpacked(hit["episode"])
    assert [user["id"] for user in payload["users"]] == [8]
    assert payload["road"]
    assert payload["goals"]
    assert all(side["touched"] == 8 for side in payload["sides"])


def test_a_page_is_self_contained_and_allows_its_own_script_only(driven: Path) -> None:
    html = (driven / "report.html").read_text(encoding="utf-8")
    outside = set(re.findall(r"https?://[^\s\"'<]+", html))
    assert {address for address in outside if "www.w3.org" not in address} == set()
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]+)"', html)
    script = re.search(r"<script>(.*?)</script>", html, re.DOTALL)
    assert policy is not None
    assert script is not None
    digest = base64.b64encode(sha256(script[1].encode()).digest()).decode()
    assert "default-src 'none'" in policy[1].replace("&#39;", "'")
    assert f"script-src 'sha256-{digest}'".replace("=", "") in policy[1].replace(
        "&#39;", "'"
    ).replace("=", "")


def test_arms_have_the_colours_that_they_have_in_films(driven: Path) -> None:
    html = (driven / "report.html").read_text(encoding="utf-8")
    light = re.search(r"--side-0: (#\w+); --side-1: (#\w+);", html)
    assert light is not None
    assert light.groups() == tuple(ARM_COLOURS[arm] for arm in ARMS_SIDE_BY_SIDE)


def test_what_files_say_stays_text(tmp_path: Path) -> None:
    rows = [
        replace(_row(HOSTILE, arm, Outcome.PLANNER_FAILURE), error=HOSTILE, steps=0) for arm in Arm
    ]
    run = _write_run(tmp_path / "run", rows, source=HOSTILE)
    html = write_report(run).read_text(encoding="utf-8")
    assert "<img" not in html
    assert html.count("<script") == 2
    assert html.count("</script>") == 2
    ((case,),) = (section["cases"] for section in _data(html)["sections"])
    assert case["id"] == HOSTILE
    assert case["sides"][0]["why"] == HOSTILE


def test_a_run_whose_scenarios_are_gone_is_told_in_a_line(
    driven: Path, scenes: Path, tmp_path: Path
) -> None:
    html = write_report(driven, tmp_path / "a.html", "gone").read_text(encoding="utf-8")
    assert "scenario files were not found" in html
    (section,) = _data(html)["sections"]
    assert all("road" not in _unpacked(case["episode"]) for case in section["cases"])
    again = write_report(driven, tmp_path / "b.html", str(scenes)).read_text(encoding="utf-8")
    assert again == (driven / "report.html").read_text(encoding="utf-8")


def test_a_page_keeps_within_its_room(
    driven: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = len((driven / "report.html").read_bytes())
    # One byte less than the whole: the episode of the less urgent scenario has to stay out.
    for room, episodes in ((whole, 2), (whole - 1, 1), (1000, 0)):
        monkeypatch.setattr(page, "MOST_BYTES", room)
        html = write_report(driven, tmp_path / "page.html").read_text(encoding="utf-8")
        (section,) = _data(html)["sections"]
        assert [("episode" in case) for case in section["cases"]].count(True) == episodes
        assert "episode" in section["cases"][0] or not episodes
        assert len(html.encode()) <= room or not episodes


def test_one_arm_alone_has_a_page(tmp_path: Path) -> None:
    rows = [_row(f"ZAM_A-{i}_1_T-1", Arm.WITH_DOS, Outcome.SUCCESS, velocity=9.0) for i in (1, 2)]
    html = write_report(_write_run(tmp_path / "run", rows)).read_text(encoding="utf-8")
    assert "McNemar" not in html
    assert "Success with DOS in 2 of 2 scenarios." in html


@pytest.mark.parametrize(
    ("only_with", "only_without", "found"),
    # McNemar's exact test: of 6 against 0, p = 2 / 2^6 = 0.031; of 5 against 0, 0.063.
    [(6, 0, "Better with DOS"), (0, 6, "Worse with DOS"), (5, 0, "No clear difference")],
)
def test_the_answer_comes_first(
    only_with: int, only_without: int, found: str, tmp_path: Path
) -> None:
    good, bad = Outcome.SUCCESS, Outcome.COLLISION
    pairs = [(good, bad)] * only_with + [(bad, good)] * only_without + [(good, good)] * 10
    rows = [
        _row(f"ZAM_A-{i}_1_T-1", arm, outcome)
        for i, pair in enumerate(pairs)
        for arm, outcome in zip((Arm.WITH_DOS, Arm.WITHOUT_DOS), pair, strict=True)
    ]
    html = write_report(_write_run(tmp_path / "run", rows)).read_text(encoding="utf-8")
    n, both = len(pairs), 10
    answer = (
        f"{found}: success in {both + only_with} of {n} scenarios with DOS, in "
        f"{both + only_without} without DOS."
    )
    assert f'<p class="answer">{answer}</p>' in html
    failed = f"collision {only_with} (0 at fault)" if only_with else "none"
    assert f"Failed without DOS: {failed}." in html


def test_groups_that_fail_come_first(tmp_path: Path) -> None:
    places = {"ZAM_Good": Outcome.SUCCESS, "ZAM_Bad": Outcome.COLLISION}
    rows = [
        _row(f"{place}-{i}_1_T-1", Arm.WITH_DOS, outcome)
        for place, outcome in places.items()
        for i in range(4)
    ]
    html = write_report(_write_run(tmp_path / "run", rows)).read_text(encoding="utf-8")
    assert re.findall(r'data-text="(\w+)"', html) == ["other", "ZAM_Bad", "ZAM_Good"]


@pytest.mark.parametrize("arms", [tuple(Arm), (Arm.WITH_DOS,)])
def test_what_the_traffic_failed_in_is_in_no_share(tmp_path: Path, arms: tuple[Arm, ...]) -> None:
    rows = [
        _row(
            f"USA_A-{i}_1_T-1",
            arm,
            Outcome.SUCCESS if i else Outcome.TRAFFIC_FAILURE,
        )
        for i in range(10)
        for arm in arms
    ]
    html = write_report(_write_run(tmp_path / "run", rows)).read_text(encoding="utf-8")
    (told,) = re.findall(r"(?:success|Success)[^.]* in (\d+ of \d+) scenarios", html)
    assert told == "9 of 9"
    assert "100 %" in html or ">100<" in html


def test_groups_of_one_meaning_are_shown_once() -> None:
    def titles(pairs: list[tuple[str, str]]) -> list[str]:
        row = _row("s", Arm.WITH_DOS, Outcome.SUCCESS)
        rest: tuple[Any, ...] = ((row,), ("",), (None,), (np.empty(0),), {}, (), None)
        cases = [Case(row.scenario_future, family, road, *rest) for road, family in pairs]
        return [title for title, _ in page.group_tables(cases, 1)]

    assert titles([("urban", "DEU"), ("rural", "USA"), ("urban", "DEU")]) == ["Kind"]
    assert titles([("urban", "DEU"), ("urban", "USA")]) == ["Kind", "Family"]


def test_a_missed_goal_is_told_by_how_much(tmp_path: Path) -> None:
    # One second at 10 m/s does not reach a place that begins at x = 57 m.
    goal = Goal(first_step=0, last_step=10, position=rectangle(6.0, 3.0, 60.0, 0.0))
    name = "ZAM_Far-1_1_T-1"
    path = tmp_path / f"{name}.xml"
    write_scenario_xml(path, problems=[Problem(goals=(goal,))], benchmark_id=name)
    out = tmp_path / "run"
    assert main(["run", str(path), *COAST, "--in-process", "--out", str(out)]) == cli.OK
    ((case,),) = (s["cases"] for s in _data((out / "report.html").read_text("utf-8"))["sections"])
    told = r"position never reached: closest \d\d\.\d\d m, 1\.0 s after the start, at the last step"
    assert all(re.match(told, side["why"]) for side in case["sides"])


def test_intervals_are_wilsons(tmp_path: Path) -> None:
    # 8 of 10 (Wilson, 1927): centre (0.8 + z^2/20) / (1 + z^2/10) = 0.7168, half-width 0.2266.
    outcomes = [Outcome.SUCCESS] * 8 + [Outcome.COLLISION] * 2
    rows = [_row(f"ZAM_A-{i}_1_T-1", Arm.WITH_DOS, o) for i, o in enumerate(outcomes)]
    html = write_report(_write_run(tmp_path / "run", rows)).read_text(encoding="utf-8")
    assert re.search(r"Success, %</th>\s*<td><b>80.0</b></td><td[^>]*>49.0 to 94.3<", html)


def test_the_command_writes_where_it_is_told(
    driven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "deep" / "page.html"
    assert main(["report", str(driven), "--out", str(out)]) == cli.OK
    assert f"report in {out}" in capsys.readouterr().out
    assert out.is_file()
    assert main(["report", str(tmp_path)]) == cli.BAD_INPUT
    assert "is not a run folder" in capsys.readouterr().err


def test_a_report_that_fails_does_not_fail_the_run(
    scenes: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def refuse(*_: object) -> Path:
        raise FileError("cannot write report.html: no room")

    monkeypatch.setattr("dosplan.report.html.write.write_report", refuse)
    out = tmp_path / "run"
    arguments = [str(scenes / "ZAM_Free-1_1_T-1.xml"), *COAST, "--in-process"]
    for as_json in ([], ["--json"]):  # The second time nothing is left to drive.
        assert main(["run", *arguments, "--with-dos", "--out", str(out), *as_json]) == cli.OK
        told = capsys.readouterr()
        (line,) = (text for text in told.err.splitlines() if "no report" in text)
        assert "no room" in line
        assert "report" not in told.out or not as_json
    assert (out / "summary.json").is_file()


def test_comparisons_link_the_reports_by_relative_paths(driven: Path, tmp_path: Path) -> None:
    out = driven.parent / "pages" / "compare.html"
    assert main(["compare", str(driven), str(driven), "--html", str(out)]) == cli.OK
    html = out.read_text(encoding="utf-8")
    assert 'href="../run/report.html"' in html
    first, second = _data(html)["sections"]  # One for each arm.
    assert first["names"] == second["names"] == ["A", "B"]
    assert all("episode" in case for section in (first, second) for case in section["cases"])


def test_a_row_without_a_recording_tells_what_it_can(tmp_path: Path) -> None:
    row = _row("ZAM_A-1_1_T-1", Arm.WITH_DOS, Outcome.COLLISION, collision_with=3, at_fault=True)
    html = write_report(_write_run(tmp_path / "run", [row])).read_text(encoding="utf-8")
    ((case,),) = (section["cases"] for section in _data(html)["sections"])
    assert case["sides"][0]["why"] == "touched road user 3; at fault"
    assert "episode" not in case


def test_the_introduction_says_how_often_the_sets_held() -> None:
    tracks = steady_tracks([[30.0, 0.0, 0.0, 8.0]])  # At 66 m, then, a second after, at 70 m.
    far = np.array([[66.0, 0.0], [75.0, 0.0]])
    near = np.array([[66.0, 0.0], [70.5, 0.0]])
    row = _row("s", Arm.WITH_DOS, Outcome.SUCCESS)
    cases = []
    for centres in (near, near, near, far):
        recording = _recording(Arm.WITH_DOS, centres, np.ones((2, 2)), 0.0)
        met = (None, sets_met(recording, tracks, driven=2))
        cycle_ms = (np.empty(0), np.empty(0))
        cases.append(
            Case(row.scenario_future, "", "", (row, row), ("", ""), met, cycle_ms, {}, (), None)
        )
    assert findings.held(cases, ["without DOS", "with DOS"]) == [
        "Of moving road users near the ego, the sets with DOS held the true centre of 75.0 % "
        "1 s ahead."
    ]


def test_any_two_arms_of_several_runs_are_compared(tmp_path: Path) -> None:
    arms = {
        ("a", Arm.WITHOUT_DOS): _arm_rows(Arm.WITHOUT_DOS, "xxxxxxx+++"),
        ("a", Arm.WITH_DOS): _arm_rows(Arm.WITH_DOS, "x++++++++x"),
        ("b", Arm.WITH_DOS): _arm_rows(Arm.WITH_DOS, "++++++++++"),
    }
    runs = []
    for name in "ab":
        rows = [row for (run, _), found in arms.items() if run == name for row in found]
        runs.append(str(_write_run(tmp_path / name, rows)))
    html = write_runs(runs, tmp_path / "page.html").read_text("utf-8")
    (section,) = _data(html)["sections"]
    assert section["names"] == ["a without DOS", "a with DOS", "b with DOS"]
    assert section["views"] == [[0, 1], [0, 2], [1, 2]]
    sides = list(arms.values())
    for first, last in section["views"]:
        found = compare_rows(sides[first], sides[last]).differences["success"]
        shown = interval_text(find_metric("success"), found)
        cells = re.findall(rf'<td data-view="{first}-{last}"[^>]*>([^<]*)</td>', html)
        assert shown in cells
    answers = re.findall(r'<div data-view="([\d-]+)"( hidden)?>\s*<p class="answer">([^<]*)<', html)
    assert [(view, bool(hidden)) for view, hidden, _ in answers] == [
        ("0-1", False),
        ("0-2", True),
        ("1-2", True),
    ]
    assert answers[1][2] == (
        "Better on b with DOS: success in 10 of 10 scenarios on b with DOS, in 3 on a without DOS."
    )
    # The baseline is the arm without sets; the other two have a difference and its interval.
    assert html.count("Minus a:without_dos") == 1
    assert "+70.0 [" in html


def test_what_one_of_several_runs_could_not_use_is_listed_and_left_out(tmp_path: Path) -> None:
    for name, reached in (("a", "++x?"), ("b", "+xx+")):
        _write_run(tmp_path / name, _arm_rows(Arm.WITH_DOS, reached))
    runs = [str(tmp_path / name) for name in "ab"]
    html = write_runs(runs, tmp_path / "page.html").read_text("utf-8")
    (section,) = _data(html)["sections"]
    assert {case["id"] for case in section["cases"]} == {f"ZAM_A-{i}_1_T-1" for i in range(3)}
    assert "<tr><td>ZAM_A-3_1_T-1</td>" in html


def test_runs_of_other_scenarios_are_not_set_beside_each_other(tmp_path: Path) -> None:
    _write_run(tmp_path / "a", _arm_rows(Arm.WITH_DOS, "++x"))
    _write_run(tmp_path / "b", _arm_rows(Arm.WITH_DOS, "++x+"))
    runs = [str(tmp_path / name) for name in "ab"]
    sections = _data(write_runs(runs, tmp_path / "page.html").read_text("utf-8"))["sections"]
    assert [section["names"] for section in sections] == [["a with DOS"], ["b with DOS"]]


def test_arms_for_which_there_is_no_colour_are_in_the_table(tmp_path: Path) -> None:
    names = [f"run{i}" for i in range(MOST_SIDES + 2)]
    for name in names:
        _write_run(tmp_path / name, _arm_rows(Arm.WITH_DOS, "++x"))
    runs = [str(tmp_path / name) for name in names]
    html = write_runs(runs, tmp_path / "page.html").read_text("utf-8")
    (section,) = _data(html)["sections"]
    assert section["names"] == [f"{name} with DOS" for name in names[:MOST_SIDES]]
    assert all(f">{name}<" in html or f"</i>{name}<" in html for name in names)
    assert f"{MOST_SIDES} arms, those with a colour" in html
    colours = {int(side) for side in re.findall(r"--side-(\d+): #", html)}
    assert colours == set(range(MOST_SIDES))


def test_several_runs_share_the_predictions_that_they_share(driven: Path, tmp_path: Path) -> None:
    shutil.copytree(driven, tmp_path / "again")
    runs = [str(driven), str(tmp_path / "again")]
    html = write_runs(runs, tmp_path / "page.html").read_text("utf-8")
    (section,) = _data(html)["sections"]
    (alone,) = _data((driven / "report.html").read_text("utf-8"))["sections"]
    for both, one in zip(section["cases"], alone["cases"], strict=True):
        four, two = _unpacked(both["episode"]), _unpacked(one["episode"])
        assert four["sides"] == two["sides"] * 2
        assert four["predictions"] == two["predictions"]
    assert 'href="again/report.html"' in html


def test_the_command_takes_several_runs_or_one_arm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [*_arm_rows(Arm.WITHOUT_DOS, "x+"), *_arm_rows(Arm.WITH_DOS, "++")]
    a, b = (str(_write_run(tmp_path / name, rows)) for name in "ab")
    monkeypatch.chdir(tmp_path)
    for runs, names in (
        ([a, b], ["a without DOS", "a with DOS", "b without DOS", "b with DOS"]),
        ([f"{a}:with_dos"], ["a with DOS"]),
        ([f"{b}:with_dos", f"{a}:with_dos"], ["b with DOS", "a with DOS"]),
    ):
        assert main(["report", *runs]) == cli.OK
        (section,) = _data((tmp_path / "report.html").read_text("utf-8"))["sections"]
        assert section["names"] == names
    assert not (Path(a) / "report.html").exists()
    sweep = SweepFolder(tmp_path)
    sweep.write(tuple(SweepRun(name=name, settings=RunSettings()) for name in "ab"))
    monkeypatch.chdir(a)
    assert main(["report", f"{sweep.path}"]) == cli.OK
    assert "b with DOS" in (sweep.path / "report.html").read_text("utf-8")
    capsys.readouterr()
    assert main(["report", a, str(tmp_path / "none")]) == cli.BAD_INPUT
    assert "none is not a run folder" in capsys.readouterr().err


def test_what_the_ego_saw_of_late_is_in_the_payload_and_what_it_saw_at_once_is_not() -> None:
    scene = straight_scenario(
        steady_tracks([[12.0, 0.0, 0.0, 10.0], [20.0, 0.0, 0.0, 10.0]], steps=21),
        velocity=10.0,
        final_step=20,
    )
    sees = SensingSettings(occlusion=True)
    late, ideal = (
        Drive.of(scene, run_episode(scene, CoastPlanner(), GrowingPredictor(), Arm.WITH_DOS, loop))
        for loop in (LoopSettings(latency=0.3, sensing=sees), LoopSettings())
    )
    payload = encode_episode(scene, [late, ideal])
    assert "seen" not in payload["sides"][1]
    seen, users = payload["sides"][0]["seen"], payload["users"]
    assert len(seen["hidden"]) == len(seen["at"]) == len(late.recording.cycle_steps)
    near, hidden = ([user["id"] for user in users].index(name) for name in (100, 101))
    assert {tuple(cycle) for cycle in seen["hidden"]} == {(hidden,)}
    sightings = late.recording.sightings
    assert sightings is not None
    assert seen["at"][0] == []  # At the start nothing is late yet.
    for step, (user, x, y, heading) in zip(sightings.steps[1:], seen["at"][1:], strict=True):
        assert (user, y, heading) == (near, 0, 0)
        assert x * METRE == pytest.approx(12.0 + step - np.rint(late.ego[0, 0]), abs=METRE)


def test_the_mark_of_a_collision_is_at_the_contact() -> None:
    scene = straight_scenario(steady_tracks([[14.0, 0.0, 0.0, 0.0]], steps=41), velocity=10.0)
    episode = run_episode(scene, CoastPlanner(), GrowingPredictor(), Arm.WITH_DOS)
    drive = Drive.of(scene, episode)
    assert drive.contact is not None
    x, y = encode_episode(scene, [drive])["sides"][0]["place"]
    back = 14.0 - 0.5 * scene.tracks.size[0, 0] - np.rint(drive.ego[0, 0])
    assert x * METRE == pytest.approx(back, abs=1.0)  # Within a step of the touch.
    assert y == 0
