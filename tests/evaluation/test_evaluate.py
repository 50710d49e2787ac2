"""An evaluation end to end: windows, groups, samples, figures, workers and the command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dosplan_simple.predictors import ConstantVelocityPredictor

from dosplan.api import Predictor
from dosplan.cli import main as cli
from dosplan.cli.main import main
from dosplan.evaluation.evaluate import EvaluationConfig, EvaluationError, evaluate
from dosplan.evaluation.groups import (
    CELL_WINDOWS,
    KINDS,
    LIGHTS,
    family_of,
    group_windows,
    lights_of,
)
from dosplan.evaluation.methods import Method
from dosplan.evaluation.samples import FileSamples, PredictionError, sample_file
from dosplan.evaluation.summary import scales, summarise
from dosplan.evaluation.windows import HORIZON_COLUMNS, moments
from dosplan.geometry import NO_LIGHT, set_area
from dosplan.plugins.registry import create_predictor
from dosplan.scenario.synthetic import growing_sets, steady_tracks, straight_scenario
from dosplan.system.files import read_json
from dosplan.types import (
    COLOURS,
    FloatArray,
    LightColour,
    Observation,
    Occupancy,
    RoadUserKind,
    Scenario,
)
from tests.support.lights import LEFT, TURNS_GREEN, regulated_scenario
from tests.support.plugins import PLUGINS
from tests.support.scenes import User, driving, write_scenario_xml

CIRCLES = [("cv", "constant-velocity", {}), ("r=1", "fixed-circle", {"r": 1.0})]
SETS = {
    "method", "group", "horizon_s", "cr", "cr_se", "osa", "osa90", "cr90", "scale90",
    "cr_at_paper_area", "n"
}  # fmt: skip


def _accelerating(acceleration: float, steps: int = 42, velocity: float = 10.0) -> Scenario:
    """One car along x: constant velocity is off by a t^2 / 2 from any step."""
    tracks = steady_tracks([[0.0, 0.0, 0.0, velocity]], steps=steps)
    states = np.array(tracks.states)
    time = 0.1 * np.arange(steps)
    states[0, :, 0] = velocity * time + 0.5 * acceleration * time**2
    states[0, :, 3] = velocity + acceleration * time
    return straight_scenario(replace(tracks, states=states))


def _sample(scenario: Scenario, methods: list[tuple[str, str, dict[str, Any]]]) -> FileSamples:
    built = [(label, create_predictor(name, 0, options)) for label, name, options in methods]
    return sample_file(scenario, built, every=1)


def _of(rows: list[dict[str, Any]], **wanted: object) -> list[dict[str, Any]]:
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def _shown(scenario: Scenario, methods: list[tuple[str, str, dict[str, Any]]]) -> dict[str, Any]:
    samples = [_sample(scenario, methods)]
    return {**summarise(samples, [label for label, _, _ in methods], scales(samples))}


def test_windows_hold_the_recorded_future_and_nothing_else() -> None:
    first = [[0.0, 0.0, 0.0, 5.0], [0.0, 9.0, 0.0, 5.0], [50.0, 9.0, 0.0, 0.0]]
    kinds = (RoadUserKind.CAR, RoadUserKind.PEDESTRIAN, RoadUserKind.PARKED)
    tracks = steady_tracks(first, steps=61, kinds=kinds)
    valid, states = np.array(tracks.valid), np.array(tracks.states)
    valid[1, 12:], states[1, 12:] = False, np.nan
    scenario = straight_scenario(replace(tracks, valid=valid, states=states))
    found = list(moments(scenario, every=5))
    assert [moment.observation.step for moment in found] == list(range(0, 60, 5))
    # The pedestrian's last step is 11, so that it has a future at step 10 and none at 15.
    assert [len(moment.rows) for moment in found[:4]] == [2, 2, 2, 1]
    assert found[2].recorded[1].tolist() == [True] + [False] * 39
    assert found[2].truth[1, 0].tolist() == tracks.states[1, 11].tolist()
    assert np.array_equal(found[4].truth[0], tracks.states[0, 21:61])
    # At step 55 five steps are left.
    assert found[-1].recorded[0].tolist() == [True] * 5 + [False] * 35
    assert np.isnan(found[-1].truth[0, 5:]).all()
    assert HORIZON_COLUMNS == (9, 19, 29, 39)


def test_who_comes_back_counts_only_where_it_is_there() -> None:
    tracks = steady_tracks([[0.0, 0.0, 0.0, 5.0]], steps=45)
    valid, states = np.array(tracks.valid), np.array(tracks.states)
    valid[0, 5:15], states[0, 5:15] = False, np.nan
    scenario = straight_scenario(replace(tracks, valid=valid, states=states))
    samples = _sample(scenario, CIRCLES)
    assert samples.recorded[0].tolist() == [False, True, True, True]
    assert next(iter(samples.trajectories.values())).count[0] == 30
    assert np.isfinite(samples.sets[1].furthest).all()


def test_figures_of_a_car_that_accelerates() -> None:
    # a = 0.4 m/s2 from two windows with a 4 s future: errors 0.2, 0.8, 1.8, 3.2 m along x.
    figures = _shown(_accelerating(0.4), CIRCLES)
    rows = _of(figures["sets"], method="r=1", group="all")
    assert [row["horizon_s"] for row in rows] == [1.0, 2.0, 3.0, 4.0]
    assert [row["cr"] for row in rows] == [1.0, 1.0, 0.0, 0.0]
    assert [row["n"] for row in rows] == [32, 22, 12, 2]
    assert [row["cr_se"] for row in rows] == [None] * 4  # One scenario.
    assert [row["osa"] for row in rows] == pytest.approx([np.pi] * 4)
    squares = np.array([0.2, 0.8, 1.8, 3.2]) ** 2
    assert [row["osa90"] for row in rows] == pytest.approx(np.pi * squares, rel=1e-5)
    assert [row["scale90"] for row in rows] == pytest.approx([0.2, 0.8, 1.8, 3.2], rel=1e-5)
    assert min(row["cr90"] for row in rows) >= 0.9

    (row,) = _of(figures["trajectories"], group="all")
    assert row["displacement"] == pytest.approx([0.2, 0.8, 1.8, 3.2], rel=1e-5)
    assert row["fde"] == row["displacement"][-1]
    # Step k is recorded in 42 - k windows, so ADE = sum (42 - k) 0.002 k^2 / sum (42 - k), with
    # k to 40 only: the 41st future step of the first window is beyond 4 s.
    k = np.arange(1, 41)
    assert row["ade"] == pytest.approx(np.sum((42 - k) * 0.002 * k**2) / np.sum(42 - k))
    assert row["n"] == 41
    assert (row["model"], row["methods"]) == ("cv", ["cv", "r=1"])

    limits = _of(figures["upper_limits"], group="all", horizon_s=4.0)
    areas = {limit["representation"]: limit["area"] for limit in limits}
    # All of the error is along the heading: a circle of 3.2 m, or a quarter of its area.
    assert areas["circle"] == pytest.approx(np.pi * 3.2**2, rel=1e-5)
    assert [areas[x] / areas["circle"] for x in ("theta=0", "v1", "v2", "free")] == pytest.approx(
        [0.25] * 4, rel=1e-5
    )
    assert areas["theta=pi/4"] == pytest.approx(areas["circle"], rel=1e-5)


def test_simultaneous_coverage_takes_every_step_that_is_recorded() -> None:
    # 0.2 t^2 is 1 m at 2.236 s: windows with at most 22 steps ahead are inside all the way.
    figures = _shown(_accelerating(0.4), CIRCLES)
    (row,) = _of(figures["simultaneous"], method="r=1", group="all")
    assert row["coverage"] == pytest.approx(22 / 41)
    assert row["n"] == 41


def test_points_cover_what_they_hit_and_have_no_scaled_area() -> None:
    for acceleration, rate in ((0.0, 1.0), (0.4, 0.0)):
        tracks = _accelerating(acceleration, velocity=0.0)
        for row in _of(_shown(tracks, CIRCLES[:1])["sets"], group="all"):
            assert (row["cr"], row["osa"], row["osa90"]) == (rate, 0.0, None)


def test_who_predicts_nothing_covers_nothing() -> None:
    figures = _shown(_accelerating(0.0), [("none", "none", {})])
    for row in _of(figures["sets"], group="all"):
        assert (row["cr"], row["osa"], row["osa90"], row["n"] > 0) == (0.0, 0.0, None, True)
    (row,) = _of(figures["trajectories"], group="all")
    assert (row["ade"], row["fde"], row["n"]) == (None, None, 0)
    assert _of(figures["simultaneous"], group="all")[0]["coverage"] == 0.0


def test_a_predictor_that_sees_the_future_is_shown_it() -> None:
    figures = _shown(_accelerating(0.4), [("truth", "ground-truth", {})])
    assert [row["cr"] for row in _of(figures["sets"], group="all")] == [1.0] * 4
    assert _of(figures["trajectories"], group="all")[0]["ade"] == 0.0


def test_trajectories_are_shared_by_what_they_are_not_by_name() -> None:
    options: dict[str, Any] = {"base": "constant-turn-rate"}
    methods = [*CIRCLES, ("turn", "growing-circle", options)]
    straight, turning = _accelerating(0.0), _accelerating(0.0)
    states = np.array(turning.tracks.states)
    states[..., 2] = 0.03 * np.arange(states.shape[1])
    turning = replace(turning, tracks=replace(turning.tracks, states=states))
    samples = [_sample(straight, methods), _sample(turning, methods)]
    assert [len(set(s.digests)) for s in samples] == [1, 2]
    figures = summarise(samples, ["cv", "r=1", "turn"], scales(samples))
    shared = [row["methods"] for row in _of(figures["trajectories"], group="all")]
    assert shared == [["cv", "r=1"], ["turn"]]


def test_scales_come_from_the_reference() -> None:
    methods = CIRCLES[1:]
    reference, samples = (
        [_sample(_accelerating(0.8), methods)],
        [_sample(_accelerating(0.4), methods)],
    )
    (factor,) = scales(reference)
    assert factor == pytest.approx((0.4, 1.6, 3.6, 6.4), rel=1e-5)
    rows = _of(summarise(samples, ["r=1"], [factor])["sets"], group="all")
    areas = np.pi * np.array(factor, dtype=np.float64) ** 2
    assert [row["osa90"] for row in rows] == pytest.approx(areas, rel=1e-5)
    assert [row["cr90"] for row in rows] == [1.0] * 4


def _of_union(options: dict[str, Any] | None = None) -> tuple[str, str, dict[str, Any]]:
    return ("fork", f"{PLUGINS}:ForkPredictor", {"horizon": 40, **(options or {})})


def test_a_union_covers_what_any_of_its_components_does_and_counts_the_area_once() -> None:
    # The car of constant speed is at the centre of the first component; it turns in none.
    straight = _accelerating(0.0)
    figures = _shown(straight, [_of_union()])
    rows = _of(figures["sets"], group="all")
    assert [row["cr"] for row in rows] == [1.0] * 4
    time = np.array([1.0, 2.0, 3.0, 4.0])
    one = np.pi * 0.5 * (0.1 + 0.4 * time) ** 2
    # At 1 s the turn has brought the second component 1.5 m aside; from then on they are apart.
    assert [row["osa"] for row in rows] == pytest.approx(2.0 * one, rel=1e-3)
    assert _of(figures["simultaneous"], group="all")[0]["coverage"] == 1.0

    (turned,) = _sample(_turning(), [_of_union()]).sets
    assert (turned.distance[np.isfinite(turned.distance)] < 1e-3).all()


def _turning(rate: float = 0.3, steps: int = 42, velocity: float = 10.0) -> Scenario:
    """One car that turns left all the time."""
    scenario = _accelerating(0.0, steps, velocity)
    states = np.array(scenario.tracks.states)
    turn = 0.1 * rate * np.arange(steps)
    states[0, :, 0] = velocity / rate * np.sin(turn)
    states[0, :, 1] = velocity / rate * (1.0 - np.cos(turn))
    states[0, :, 2] = turn
    return replace(scenario, tracks=replace(scenario.tracks, states=states))


def test_displacements_are_those_of_the_most_likely_component_and_of_the_best() -> None:
    (row,) = _of(_shown(_turning(), [_of_union()])["trajectories"], group="all")
    assert row["components"] == 2
    assert row["min_ade"] == pytest.approx(0.0, abs=1e-6)
    assert row["min_fde"] == pytest.approx(0.0, abs=1e-5)
    turn, way = 0.3 * 4.0, 40.0
    end = way * np.array([np.sin(turn), 1.0 - np.cos(turn)]) / turn
    assert row["fde"] == pytest.approx(np.hypot(end[0] - way, end[1]), rel=1e-5)
    assert row["ade"] > 1.0

    (one,) = _of(_shown(_turning(), CIRCLES[:1])["trajectories"], group="all")
    assert (one["components"], one["min_ade"], one["min_fde"]) == (1, one["ade"], one["fde"])
    assert one["min_displacement"] == one["displacement"]


def test_limits_of_a_union_are_those_of_the_best_of_its_components() -> None:
    figures = _shown(_turning(), [_of_union(), CIRCLES[0]])
    limits = _of(figures["upper_limits"], group="all", horizon_s=4.0)
    area = {(row["model"], row["representation"]): row["area"] for row in limits}
    # The most likely one goes straight on, as constant velocity does.
    assert area["fork", "circle"] == pytest.approx(area["cv", "circle"], rel=1e-5)
    assert area["fork", "circle, best of 2"] == pytest.approx(0.0, abs=1e-9)
    assert area["fork", "v2"] > 1.0 > area["fork", "v2, best of 2"]
    assert ("cv", "circle, best of 2") not in area


def test_limits_are_of_the_headings_that_a_method_predicts() -> None:
    """Two methods foretell the same places with other headings."""

    class Turned(Predictor):
        name = "turned"
        by = 0.0

        def compute_occupancy(self, observation: Observation) -> Occupancy:
            sets = growing_sets(observation, self.horizon)
            heading = sets.heading + self.by
            return Occupancy.from_trajectory(
                observation, sets.centre, heading, sets.semi_axes, sets.angle
            )

    class MoreTurned(Turned):
        by = 0.7

    methods = [("straight", Turned()), ("turned", MoreTurned())]
    areas = []
    for chosen in (methods, methods[:1], methods[1:]):
        samples = [sample_file(_turning(), chosen, 10)]
        figures = summarise(samples, [label for label, _ in chosen], scales(samples))
        limits = _of(figures["upper_limits"], group="all", horizon_s=4.0)
        areas.append({x["model"]: x["area"] for x in limits if x["representation"] == "v2"})
    assert areas[0] == pytest.approx({**areas[1], **areas[2]})
    assert areas[0]["turned"] != pytest.approx(areas[0]["straight"], rel=0.05)


def test_a_union_scaled_to_a_level_or_an_area_has_that_level_or_area() -> None:
    # Slow, so that components overlap, and off by the acceleration.
    scenario = _accelerating(0.3, steps=61, velocity=0.5)
    samples = _sample(scenario, [_of_union()])
    rows = _of(summarise([samples], ["fork"], scales([samples]))["sets"], group="all")
    predictor = create_predictor(f"{PLUGINS}:ForkPredictor", 0, {"horizon": 40})
    for h, row in enumerate(rows):
        areas = [
            set_area(
                predictor.predict(m.observation).of_steps(np.array(HORIZON_COLUMNS[h : h + 1])),
                row["scale90"],
            )
            for m in moments(scenario, every=1)
            if m.recorded[0, HORIZON_COLUMNS[h]]
        ]
        assert row["osa90"] == pytest.approx(np.mean(areas), rel=0.01)
        assert row["cr90"] >= 0.9
    # Components have the more in common the larger they are made.
    assert any(row["osa90"] < 0.99 * row["osa"] * row["scale90"] ** 2 for row in rows)


def test_sets_of_one_component_are_judged_as_the_ellipses_they_are() -> None:
    names = {"fork": "StraightForkPredictor", "single": "SingleForkPredictor"}
    methods: list[tuple[str, str, dict[str, Any]]] = [
        (label, f"{PLUGINS}:{name}", {"horizon": 40}) for label, name in names.items()
    ]
    figures = _shown(_accelerating(0.2), methods)
    for part in ("sets", "simultaneous"):
        fork, single = ([dict(r) for r in _of(figures[part], method=m)] for m in ("fork", "single"))
        for a, b in zip(fork, single, strict=True):
            assert a.keys() == b.keys()
            for key in a.keys() - {"method"}:
                assert a[key] == b[key] or a[key] == pytest.approx(b[key], rel=1e-5), key


class GivingUpPredictor(ConstantVelocityPredictor):
    """Predicts nothing."""

    name = "giving-up-v1"

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        raise RuntimeError("enough")


def test_a_failing_predictor_is_named_with_its_place() -> None:
    scenario = _accelerating(0.0)
    base = f"{__name__}:GivingUpPredictor"
    told = r"method 'x' failed: RuntimeError: enough \(.*\.py:\d+\)"
    with pytest.raises(PredictionError, match=told):
        _sample(scenario, [("x", "fixed-circle", {"base": base})])


@pytest.mark.parametrize(
    ("name", "tags", "family"),
    [
        ("USA_US101-3_2_T-1", frozenset(), "USA_US101"),
        ("C-USA_Lanker-1_1_T-1", frozenset({"urban"}), "USA_Lanker"),
        ("USA_US101-3_2_T-1", frozenset({"simulated"}), "simulated"),
        ("straight", frozenset(), "other"),
        ("usa_us101-1", frozenset(), "other"),
    ],
)
def test_family(name: str, tags: frozenset[str], family: str) -> None:
    assert family_of(name, tags) == family


def test_groups_on_both_sides_of_their_edges() -> None:
    speed = np.array([0.0, 0.29, 0.3, 3.99, 4.0, 8.0, 15.9, 16.0, 60.0], dtype=np.float32)
    kind = np.array([KINDS.index(RoadUserKind.CAR)] * 8 + [KINDS.index(RoadUserKind.BUS)])
    where = np.array([0] * 8 + [1])
    dark = np.full(9, -1, dtype=np.int8)
    groups = group_windows(kind.astype(np.int8), speed, dark, ["A", "B"], where)
    shown = {name: indices.tolist() for name, indices in groups.items()}
    assert shown == {
        "all": list(range(9)),
        "moving": list(range(2, 9)),
        "car": list(range(8)),
        "bus": [8],
        "<0.3 m/s": [0, 1],
        "0.3-4 m/s": [2, 3],
        "4-8 m/s": [4],
        "8-16 m/s": [5, 6],
        ">=16 m/s": [7, 8],
        "A": list(range(8)),
        "B": [8],
    }


def test_colours_are_sorted_by_what_they_ask_of_a_driver() -> None:
    found = lights_of(np.array([*range(len(COLOURS)), NO_LIGHT]))
    names = {
        colour: LIGHTS[i] if i >= 0 else None for colour, i in zip(COLOURS, found, strict=False)
    }
    assert names == {
        LightColour.RED: "red light",
        LightColour.RED_YELLOW: "red light",
        LightColour.YELLOW: "yellow light",
        LightColour.GREEN: "green light",
        LightColour.INACTIVE: None,
    }
    assert found[-1] == -1


def test_windows_are_grouped_by_the_light_ahead_when_they_begin() -> None:
    # The light ahead of the first car is red until step 20; the second is past the lights.
    tracks = steady_tracks([[0.0, 0.0, 0.0, 2.0], [50.0, 0.0, 0.0, 2.0]], steps=41)
    scenario = regulated_scenario(tracks)
    own, *others = scenario.road_map.lanelets
    assert own.stop_line is not None
    own = replace(own, lights=(LEFT,), stop_line=replace(own.stop_line, lights=(LEFT,)))
    scenario = replace(scenario, road_map=replace(scenario.road_map, lanelets=(own, *others)))
    counts = {row["group"]: row["n"] for row in _of(_shown(scenario, CIRCLES[:1])["simultaneous"])}
    assert counts["red light"] == TURNS_GREEN
    assert counts["green light"] == 40 - TURNS_GREEN
    assert counts["no light"] == 40
    assert counts["all"] == 80
    dark = replace(scenario, road_map=replace(scenario.road_map, lights=()))
    groups = {row["group"] for row in _shown(dark, CIRCLES[:1])["simultaneous"]}
    assert not groups & {*LIGHTS, "no light"}


def test_a_cell_of_family_and_speed_needs_windows() -> None:
    for count, shown in ((CELL_WINDOWS - 1, False), (CELL_WINDOWS, True)):
        speed: FloatArray = np.full(count, 5.0)
        groups = group_windows(
            np.zeros(count, dtype=np.int8),
            speed.astype(np.float32),
            np.full(count, -1, dtype=np.int8),
            ["A"],
            np.zeros(count, dtype=np.int64),
        )
        assert ("A, 4-8 m/s" in groups) is shown


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings of 5 s; in the third, nobody moves."""
    folder = tmp_path_factory.mktemp("recordings")
    for index, velocity in enumerate((7.0, 12.0, 0.0)):
        name = f"ZAM_Test-{index}_1_T-1"
        bend = [(x, 0.01 * x * x, h, v) for x, _, h, v in driving(30.0, 0.0, velocity, 51)]
        users = [User(1, bend), User(2, driving(60.0, 3.5, velocity, 31), kind="truck")]
        write_scenario_xml(folder / f"{name}.xml", users=users, benchmark_id=name)
    return folder


def test_figures_do_not_depend_on_the_number_of_workers(recordings: Path) -> None:
    methods = tuple(Method(label, name, options) for label, name, options in CIRCLES)
    seen: list[tuple[int, int]] = []
    one = evaluate(EvaluationConfig(str(recordings), methods), lambda *count: seen.append(count))
    two = evaluate(EvaluationConfig(str(recordings), methods, workers=2))
    assert one == two
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert one["data"]["evaluated"] == 3
    base = {"predictor": "constant-velocity", "options": {"horizon": 40}}
    assert one["data"]["methods"][1] == {
        "label": "r=1", "predictor": "fixed-circle", "options": {"r": 1.0},
        "name": "fixed-circle-v1", "settings": {"horizon": 40, "base": base, "r": 1.0},
    }  # fmt: skip


def test_the_command_shows_and_writes_the_promised_names(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    methods = tmp_path / "methods.yaml"
    methods.write_text("- {label: small, predictor: fixed-circle, options: {r: 0.5}}\n")
    source = tmp_path / "source"
    source.mkdir()
    for file in recordings.iterdir():
        (source / file.name).write_bytes(file.read_bytes())
    (source / "ZAM_Bad-1_1_T-1.xml").write_text("<commonRoad")
    arguments = [
        str(source), "--methods", str(methods), "--predictor", "constant-velocity", "--scale-on",
        str(recordings), "--json", str(tmp_path / "x.json"), "--markdown", str(tmp_path / "x.md"),
        "--workers", "1",
    ]  # fmt: skip
    assert main(["evaluate", *arguments]) == cli.FAILED
    captured = capsys.readouterr()
    lines = captured.err.splitlines()
    assert "7 of 7 files" in lines
    assert lines[-1].startswith(str(source / "ZAM_Bad-1_1_T-1.xml"))
    for heading in ("CR % 1 s", "OSA@90 4 s", "CR % by speed", "Trajectories", "Upper limits"):
        assert heading in captured.out

    figures = read_json(tmp_path / "x.json")
    assert figures.keys() == {"sets", "trajectories", "upper_limits", "simultaneous", "data"}
    assert figures["sets"][0].keys() == SETS
    assert {"model", "group", "ade", "fde", "n"} <= figures["trajectories"][0].keys()
    assert {row["group"] for row in figures["sets"]} == {
        "all", "moving", "car", "truck", "<0.3 m/s", "4-8 m/s", "8-16 m/s", "ZAM_Test"
    }  # fmt: skip
    assert {row["method"] for row in figures["sets"]} == {"small", "constant-velocity"}
    data = figures["data"]
    assert (data["files"], data["evaluated"], len(data["failed"])) == (4, 3, 1)
    assert data["failed"][0]["file"] == "ZAM_Bad-1_1_T-1.xml"
    assert (data["scaled_on"], data["scaled_on_itself"]) == (str(recordings), False)
    text = (tmp_path / "x.md").read_text(encoding="utf-8")
    assert text.startswith("# Evaluation\n\n")
    assert f"of all windows of {recordings}\n" in text
    assert "| small |" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{recordings}"], "nothing to evaluate"),
        (["{recordings}", "--predictor", "none", "--every", "0"], "every is 0"),
        (["{recordings}", "--predictor", "none", "--workers", "0"], "workers is 0"),
        (["{recordings}", "--predictor", "none", "--seed", "-1"], "seed is -1"),
        (["{recordings}", "--predictor", "non"], "did you mean 'none'?"),
        (["{recordings}", "--predictor", "none", "--predictor", "none"], "have the label 'none'"),
        (["{recordings}", "--methods", "absent.yaml"], "cannot read absent.yaml"),
        (["{recordings}", "--predictor", f"{PLUGINS}:Missing"], "has no Missing"),
        (["no/such/folder", "--predictor", "none"], "no/such/folder"),
        (["{recordings}", "--predictor", "none", "--scale-on", "absent"], "absent: does not exist"),
    ],
)
def test_bad_input_is_one_line(
    recordings: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    given = [part.format(recordings=recordings) for part in arguments]
    assert main(["evaluate", *given]) == cli.BAD_INPUT
    captured = capsys.readouterr()
    assert captured.out == ""
    assert message in captured.err.splitlines()[-1]
    assert "Traceback" not in captured.err


def test_a_source_without_any_window_is_refused_with_its_first_failure(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text("<commonRoad")
    with pytest.raises(EvaluationError, match=r"recorded future; the first that failed: .*a\.xml"):
        evaluate(EvaluationConfig(str(tmp_path), (Method("none", "none"),)))


def test_a_method_that_hangs_costs_the_file(recordings: Path, tmp_path: Path) -> None:
    plugin = tmp_path / "mine.py"
    plugin.write_text(
        "import time\n"
        "from dosplan_simple.predictors import ConstantVelocityPredictor\n"
        "class Hanging(ConstantVelocityPredictor):\n"
        "    name = 'hanging-v1'\n"
        "    def compute_occupancy(self, observation):\n"
        "        if '_Test-0_' in observation.task.scenario_id:\n"
        "            time.sleep(3600.0)\n"
        "        return super().compute_occupancy(observation)\n"
    )
    methods = (Method("late", f"{plugin}:Hanging"),)
    figures = evaluate(EvaluationConfig(str(recordings), methods, file_timeout=20.0))
    (hung,) = (failure["error"] for failure in figures["data"]["failed"])
    assert hung.endswith("ZAM_Test-0_1_T-1.xml: timed out after 20 s; allow it more with --timeout")
    assert figures["data"]["evaluated"] == 2


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("inf"), float("nan")])
def test_a_time_that_no_file_can_take_is_refused(seconds: float) -> None:
    with pytest.raises(EvaluationError, match="file_timeout is"):
        EvaluationConfig("x", (Method("none", "none"),), file_timeout=seconds)


def test_a_worker_that_dies_or_a_method_that_raises_costs_the_file(
    recordings: Path, tmp_path: Path
) -> None:
    plugin = tmp_path / "mine.py"
    plugin.write_text(
        "import os\n"
        "from dosplan_simple.predictors import ConstantVelocityPredictor\n"
        "class Faulty(ConstantVelocityPredictor):\n"
        "    name = 'faulty-v1'\n"
        "    def compute_occupancy(self, observation):\n"
        "        if '_Test-0_' in observation.task.scenario_id:\n"
        "            os._exit(3)\n"
        "        if '_Test-1_' in observation.task.scenario_id:\n"
        "            raise ValueError('no\\nway')\n"
        "        return super().compute_occupancy(observation)\n"
    )
    figures = evaluate(EvaluationConfig(str(recordings), (Method("bad", f"{plugin}:Faulty"),)))
    dead, raised = (failure["error"] for failure in figures["data"]["failed"])
    assert dead.endswith("ZAM_Test-0_1_T-1.xml: the worker process ended with exit code 3")
    assert raised.endswith("_T-1.xml: method 'bad' failed: ValueError: no way (mine.py:9)")
    assert figures["data"]["evaluated"] == 1
