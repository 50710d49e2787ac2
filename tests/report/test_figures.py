"""The paper's figures: what they show is what the results hold, and what is missing is told."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure

from dosplan.cli.main import BAD_INPUT, FAILED, OK, main
from dosplan.evaluation.groups import SPEED_BINS
from dosplan.report.figures import (
    FIGURES,
    FRONTIER,
    calibration,
    coverage_by_speed,
    cycle_time,
    frontier,
    planning,
    representations,
    style,
    trade_off,
    upper_limits,
)
from dosplan.report.figures.sources import Z95, Published
from dosplan.report.figures.style import save
from dosplan.results.comparison import CompareError
from dosplan.results.intervals import metric_interval
from dosplan.results.manifest import RunSettings
from dosplan.results.paired import Difference
from dosplan.results.published import default_results
from dosplan.results.rows import read_rows, write_rows
from dosplan.results.sweeps import SweepFolder, SweepRun
from dosplan.results.table import Block, Row, Table
from dosplan.results.table import Figure as Figured
from dosplan.scenario import find_scenarios, load_scenario
from dosplan.scoring.metrics import find_metric
from dosplan.scoring.score import failed_score
from dosplan.system.files import FileError, read_json, write_json
from dosplan.types import Arm, EpisodeKey, FloatArray

SHIPPED = Path(__file__).parents[2] / "results"
LEVELS = (0.5, 0.9)
TIMES = {"predict": 5.0, "solver": 8.0, "plan_rest": 2.0, "cycle": 15.0, "cycle_p95": 30.0}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The published results; calibration and timings, which take a measurement, are made up."""
    folder = tmp_path_factory.mktemp("results")
    for part in ("prediction", *planning.RUNS):
        shutil.copytree(SHIPPED / part, folder / part)
    labels = {f"at {level:g}": {"coverage": level} for level in LEVELS}
    labels["at all steps"] = {"coverage": 0.9, "simultaneous": True}
    sets = [
        {"method": label, "group": "all", "horizon_s": t, "cr": options["coverage"] - 0.01 * t}
        | {"cr_se": 0.005 * t, "osa": t}
        for label, options in labels.items()
        for t in (1.0, 2.0, 3.0, 4.0)
    ]
    methods = [{"label": label, "options": options} for label, options in labels.items()]
    evaluation = {"sets": sets, "upper_limits": [], "data": {"methods": methods}}
    write_json(folder / "calibration" / "bench.json", evaluation)
    growth = {
        what: {str(n): {part: n * ms for part, ms in TIMES.items()} for n in (1, 2, 4)}
        for what in cycle_time.PANELS
    }
    write_json(folder / "cycle" / "bench.json", growth)
    return folder


@pytest.fixture
def published(results: Path) -> Iterator[Published]:
    with style.styled():
        yield Published(results)


@pytest.fixture
def rows(results: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = read_json(results / "prediction" / "bench.json")["sets"]
    return found


def _of(rows: list[dict[str, Any]], method: str, group: str = "all") -> list[dict[str, Any]]:
    return [row for row in rows if (row["method"], row["group"]) == (method, group)]


def _bars(axes: Axes) -> list[tuple[str, FloatArray, FloatArray]]:
    """Label, (P, 2) points and (P, 2, 2) ends of the bars of everything drawn with intervals."""
    found = []
    for drawn in axes.containers:
        assert isinstance(drawn, ErrorbarContainer)
        points, _, (bars,) = drawn.lines
        data = np.asarray(points.get_xydata())
        found.append((str(drawn.get_label()), data, np.array(bars.get_segments())))
    return found


def _matches(points: FloatArray, bars: FloatArray, column: list[dict[str, Any]]) -> bool:
    """Whether coverage in percent and its 95 % interval are drawn as the rows have them."""
    cr, error = (100.0 * np.array([row[key] for row in column]) for key in ("cr", "cr_se"))
    ends = np.column_stack([cr - Z95 * error, cr + Z95 * error])
    return np.allclose(points[:, 1], cr) and np.allclose(bars[..., 1], ends)


def test_upper_limits_are_the_areas_of_the_evaluation(published: Published) -> None:
    content = read_json(published.path / "prediction" / "bench.json")
    (axes,) = upper_limits.draw(published).axes
    lines = {str(line.get_label()): np.asarray(line.get_xydata()) for line in axes.lines}
    assert len(lines) == len(upper_limits.SHAPES) + 1
    for shape, (title, *_) in upper_limits.SHAPES.items():
        areas = [
            (row["horizon_s"], row["area"])
            for row in content["upper_limits"]
            if (row["model"], row["group"], row["representation"])
            == (upper_limits.MODEL, "all", shape)
        ]
        np.testing.assert_array_equal(lines[title], areas)
    beside = [(row["horizon_s"], row["osa"]) for row in _of(content["sets"], "PR z=1.0")]
    np.testing.assert_array_equal(lines["PR, z = 1 (as predicted)"], beside)


def test_every_method_with_sets_is_in_the_trade_off_where_it_was_measured(
    published: Published, rows: list[dict[str, Any]]
) -> None:
    figure = trade_off.draw(published)
    with_sets = {row["method"] for row in rows if row["osa"]}
    shown: list[set[str]] = [set() for _ in range(4)]
    assert len(figure.axes) == 2 * len(shown)  # The methods, and the paper's loss.
    for panel, axes in enumerate(figure.axes):
        h = panel % len(shown)
        at = {method: _of(rows, method)[h] for method in with_sets}
        by_point: dict[tuple[float, float], set[str]] = {}  # Two circles are one at 1 s.
        for method, row in at.items():
            by_point.setdefault((row["osa"], 100.0 * row["cr"]), set()).add(method)
        for _, points, bars in _bars(axes):
            methods = [by_point[x, y] for x, y in points.tolist()]  # Nothing is made up.
            assert _matches(points, bars, [at[min(same)] for same in methods])
            shown[h] |= set().union(*methods)
    assert shown == [with_sets] * 4


def test_curves_go_by_rising_parameter(published: Published) -> None:
    evaluation = published.evaluation("prediction")
    over_k = (
        "DOS ellipse k=0.01 alpha=3",
        "DOS ellipse k=0.05 alpha=3",
        "DOS ellipse",
        "DOS ellipse k=0.2 alpha=3",
        "DOS ellipse k=0.5 alpha=3",
    )
    curves = [curve.labels for curve in trade_off.methods(evaluation) if len(curve.labels) > 1]
    assert curves == [
        ("PR z=0.5", "PR z=1.0", "PR z=1.5", "PR z=2.0"),
        ("SA z=1.0", "SA z=1.5", "SA z=2.0"),
        ("circle r=1", "circle r=2"),
        ("circle v1 z=0.7", "circle v1 z=1.0"),
        ("circle v2 z=1.0", "circle v2 z=1.5"),
        over_k,
        (
            "DOS coverage, calibrated at 70 %",
            "DOS coverage, calibrated at 90 %",
            "DOS coverage, calibrated at 90 % over 4 s",
        ),
        (
            "DOS union, calibrated at 70 %",
            "DOS union, calibrated at 90 %",
            "DOS union, calibrated at 90 % over 4 s",
        ),
    ]
    curves = [curve.labels for curve in trade_off.of_paper(evaluation) if len(curve.labels) > 1]
    assert curves == [
        over_k,
        ("DOS ellipse k=0.1 alpha=1", "DOS ellipse k=0.1 alpha=2", "DOS ellipse"),
        ("DOS ellipse k=0.01 alpha=3", "DOS ellipse k=0.01 alpha=10"),
    ]


def test_coverage_by_speed_is_that_of_each_bin(
    published: Published, rows: list[dict[str, Any]]
) -> None:
    for h, axes in enumerate(coverage_by_speed.draw(published).axes):
        assert len(_bars(axes)) == len(coverage_by_speed.METHODS)
        for (_, points, bars), method in zip(_bars(axes), coverage_by_speed.METHODS, strict=True):
            assert _matches(points, bars, [_of(rows, method, name)[h] for name in SPEED_BINS])
            assert np.round(points[:, 0]).tolist() == list(range(len(SPEED_BINS)))


def test_calibration_is_drawn_over_the_level_that_was_asked_for(
    published: Published, rows: list[dict[str, Any]]
) -> None:
    (axes,) = calibration.draw(published).axes
    curves = _bars(axes)
    assert len(curves) == 2 * 4  # Two methods at four horizons; not the simultaneous one.
    for t, (_, points, bars) in enumerate(curves[:4], start=1):
        np.testing.assert_allclose(points[:, 0], [50.0, 90.0])
        np.testing.assert_allclose(points[:, 1], [50.0 - t, 90.0 - t])
        np.testing.assert_allclose(np.ptp(bars[..., 1], axis=1), 2.0 * Z95 * 0.5 * t)
    # What a Gaussian of two dimensions holds within 0.5, 1, 1.5 and 2 standard deviations.
    claimed = [11.750, 39.347, 67.535, 86.466]
    for h, (_, points, bars) in enumerate(curves[4:]):
        np.testing.assert_allclose(points[:, 0], claimed, atol=1e-3)
        column = [_of(rows, f"PR z={z}")[h] for z in (0.5, 1.0, 1.5, 2.0)]
        assert _matches(points, bars, column)


def test_planning_shows_the_shares_of_the_summaries(published: Published) -> None:
    panels = np.reshape(
        np.array(planning.draw(published).axes, dtype=object), (len(planning.RUNS), 3)
    )
    keys = (
        ("success_rate", "safe_rate"),
        (
            *("collision_rate", "at_fault_collision_rate"),
            *("out_of_bounds_rate", "goal_missed_rate"),
        ),
    )
    for run, (good, bad, speed) in zip(planning.RUNS, panels, strict=True):
        summary = read_json(published.path / run / "summary.json")
        for arm, *drawn in zip(Arm, _bars(good), _bars(bad), _bars(speed), strict=True):
            for names, (_, points, bars) in zip(keys, drawn, strict=False):
                for name, point, bar in zip(names, points, bars, strict=True):
                    assert point[0] == pytest.approx(100.0 * summary[arm.value][name])
                    metric = find_metric(name.removesuffix("_rate"))
                    rows = [row for row in published.rows(run) if row.arm is arm]
                    expected = metric_interval(metric, rows)
                    assert expected is not None
                    assert bar[:, 0] == pytest.approx(100.0 * np.array(expected[1:]), abs=1e-9)
            _, ((velocity, _),), (bar,) = drawn[2]
            assert velocity == pytest.approx(summary[arm.value]["velocity"])
            assert bar[0, 0] < velocity < bar[1, 0]


def test_cycle_time_shows_every_part_of_the_timings(published: Published) -> None:
    figure = cycle_time.draw(published)
    for axes, (_, _, left_out) in zip(figure.axes, cycle_time.PANELS.values(), strict=True):
        lines = {str(line.get_label()): np.asarray(line.get_xydata()) for line in axes.lines}
        for part, (title, *_) in cycle_time.PARTS.items():
            if part in left_out:
                assert title not in lines
            else:
                expected = [[n, n * TIMES[part]] for n in (1, 2, 4)]
                np.testing.assert_array_equal(lines[title], expected)


def test_representations_are_what_the_shipped_weights_predict(published: Published) -> None:
    figure = representations.draw(published)
    refs = find_scenarios("suite-1")
    scenario = load_scenario(next(ref for ref in refs if ref.id == representations.SCENE))
    panels = figure.axes[: len(representations.METHODS)]
    for axes, (title, options) in zip(panels, representations.METHODS.items(), strict=True):
        assert axes.get_title() == title
        sets, _, _ = representations.predicted_sets(scenario, options).by_component()
        shown = np.zeros_like(sets.valid)
        shown[:, representations.SHOWN] = sets.valid[:, representations.SHOWN]
        shown &= (sets.semi_axes > 0.0).all(axis=-1)
        (drawn,) = (c for c in axes.collections if isinstance(c, EllipseCollection))
        parts = (drawn.get_offsets(), drawn.get_widths(), drawn.get_heights())
        found = np.column_stack([np.asarray(part) for part in parts])
        wanted = np.column_stack([sets.centre[shown], 2.0 * sets.semi_axes[shown]])
        assert len(found) > 20
        np.testing.assert_allclose(_sorted(found), _sorted(wanted))


def _sorted(table: FloatArray) -> FloatArray:
    return table[np.lexsort(table.T)]


def test_every_figure_is_written_as_png_and_pdf_twice_the_same(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = [tmp_path / "one", tmp_path / "two"]
    assert main(["figures", "--out", str(out[0]), "--results", str(results)]) == OK
    shown = capsys.readouterr()
    assert shown.err == ""
    assert len(shown.out.splitlines()) == len(FIGURES)
    names = {f"{name}.{suffix}" for name in FIGURES for suffix in ("png", "pdf")}
    assert {path.name for path in out[0].iterdir()} == names
    assert all(
        (out[0] / f"{name}.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" for name in FIGURES
    )
    assert all((out[0] / f"{name}.pdf").read_bytes()[:5] == b"%PDF-" for name in FIGURES)

    chosen = ["planning", "upper-limits", "planning"]
    assert main(["figures", *chosen, "--out", str(out[1]), "--results", str(results)]) == OK
    again = {path.name: path.read_bytes() for path in out[1].iterdir()}
    assert again == {
        f"{name}.{suffix}": (out[0] / f"{name}.{suffix}").read_bytes()
        for name in ("planning", "upper-limits")
        for suffix in ("png", "pdf")
    }


def test_fonts_can_be_read_at_the_width_of_a_column(published: Published) -> None:
    for draw, width in ((upper_limits.draw, style.COLUMN), (trade_off.draw, style.PAGE)):
        figure = draw(published)
        assert figure.get_size_inches()[0] == width
        assert min(_font_sizes(figure)) >= 7.0


def _font_sizes(figure: Figure) -> list[float]:
    legends = [text for legend in figure.legends for text in legend.get_texts()]
    marks = [
        label
        for axes in figure.axes
        for label in (*axes.get_xticklabels(), *axes.get_yticklabels())
    ]
    names = [text for axes in figure.axes for text in (axes.title, axes.xaxis.label)]
    return [float(text.get_fontsize()) for text in (*legends, *marks, *names)]


def test_what_is_missing_costs_one_figure_and_is_one_line(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for run in ("suite", "suite-1"):
        shutil.copytree(results / run, tmp_path / run)
    names = ["planning", "calibration", "cycle-time"]
    options = ["--results", str(tmp_path), "--out", str(tmp_path / "out")]
    assert main(["figures", *names, *options]) == FAILED
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        f"dosplan: error: planning: {tmp_path}/recorded is not a run folder: it has no run.json",
        f"dosplan: error: calibration: {tmp_path}/calibration/bench.json is missing; "
        f"`dosplan evaluate ... --json {tmp_path}/calibration/bench.json` makes it, "
        "--results names another folder",
        f"dosplan: error: cycle-time: {tmp_path}/cycle/bench.json is missing; "
        f"`make bench BENCH_ARGS='--json {tmp_path}/cycle/bench.json'` makes it, "
        "--results names another folder",
    ]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["[]", "{}", '{"sets": 1, "data": {"methods": []}}', "nothing"])
def test_a_file_of_another_kind_is_a_file_error(tmp_path: Path, text: str) -> None:
    for part in ("prediction", "cycle"):
        (tmp_path / part).mkdir()
        (tmp_path / part / "bench.json").write_text(text)
    with pytest.raises(FileError, match=r"prediction/bench\.json is not"):
        Published(tmp_path).evaluation("prediction")
    with pytest.raises(FileError, match=r"cycle/bench\.json is not"):
        Published(tmp_path).growth()


@pytest.mark.parametrize("label", [7, None, ["PR"]])
def test_a_label_that_is_no_text_is_a_file_error(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], label: object
) -> None:
    content = read_json(results / "prediction" / "bench.json")
    content["data"]["methods"][0]["label"] = label
    path = tmp_path / "prediction" / "bench.json"
    write_json(path, content)
    out = str(tmp_path / "out")
    assert main(["figures", "trade-off", "--results", str(tmp_path), "--out", out]) == FAILED
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{path} is not what `dosplan evaluate` of this version writes" in line
    assert f"the label {label!r} is no text" in line


def test_sets_of_different_horizons_are_a_file_error(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = read_json(results / "prediction" / "bench.json")
    del content["sets"][-1]
    path = tmp_path / "prediction" / "bench.json"
    write_json(path, content)
    out = str(tmp_path / "out")
    assert main(["figures", "trade-off", "--results", str(tmp_path), "--out", out]) == FAILED
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{path} is not what `dosplan evaluate` of this version writes" in line
    assert "horizons" in line


def test_a_label_that_names_no_number_is_of_no_curve(results: Path, tmp_path: Path) -> None:
    content = read_json(results / "prediction" / "bench.json")
    before = Published(results).evaluation("prediction")
    odd = ("PR z=1.2.3", "PR z=.", "DOS ellipse k=. alpha=3", "DOS ellipse k=0.1 alpha=1.")
    content["data"]["methods"] += [{"label": label, "options": {}} for label in odd]
    write_json(tmp_path / "prediction" / "bench.json", content)
    after = Published(tmp_path).evaluation("prediction")
    for curves in (trade_off.methods, trade_off.of_paper):
        assert curves(after) == curves(before)


def test_a_method_that_was_not_evaluated_is_named(results: Path, tmp_path: Path) -> None:
    content = read_json(results / "prediction" / "bench.json")
    content["sets"] = [row for row in content["sets"] if row["method"] != "DOS circle"]
    write_json(tmp_path / "prediction" / "bench.json", content)
    with pytest.raises(FileError, match="has no sets 'DOS circle' in the group 'all'"):
        trade_off.draw(Published(tmp_path))


def test_an_arm_in_which_nobody_drove_is_told(results: Path, tmp_path: Path) -> None:
    for run in ("suite", "suite-1"):
        shutil.copytree(results / run, tmp_path / run)
    path = tmp_path / "suite-1" / "scenarios.jsonl"
    rows = [
        row
        if row.arm is Arm.WITH_DOS
        else failed_score(EpisodeKey(row.scenario, row.arm), "it broke")
        for row in read_rows(path)
    ]
    write_rows(path, rows)
    with pytest.raises(FileError, match=r"suite-1 holds an arm in which no step was driven"):
        planning.draw(Published(tmp_path))


def test_a_planner_without_a_horizon_has_no_such_panel(results: Path, tmp_path: Path) -> None:
    growth = read_json(results / "cycle" / "bench.json") | {"horizon_s": {}}
    write_json(tmp_path / "cycle" / "bench.json", growth)
    with pytest.raises(FileError, match="no times over horizon_s"):
        cycle_time.draw(Published(tmp_path))


def test_an_unknown_figure_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["figures", "trade-of", "--out", "x"])
    assert stop.value.code == BAD_INPUT
    assert "there is no figure 'trade-of'; choose from upper-limits" in capsys.readouterr().err


def test_the_shipped_results_are_found() -> None:
    assert default_results() == SHIPPED


def test_what_draws_nothing_does_not_pay_for_matplotlib() -> None:
    code = "import sys, dosplan.cli.main; dosplan.cli.main.main(['list', 'planners'])\n"
    code += "import dosplan.running.run, dosplan.report.progress, dosplan.report.tables\n"
    code += "import dosplan.explain, dosplan.results.comparison, dosplan.evaluation.evaluate\n"
    code += "assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


def test_the_manifest_of_figures_names_a_module_for_each() -> None:
    folder = Path(style.__file__).parent
    others = {"__init__", "sources", "style", "write"}
    modules = {path.stem for path in folder.glob("*.py")} - others
    assert modules == {name.replace("-", "_") for name in (*FIGURES, FRONTIER)}


def test_the_last_digits_of_a_layout_do_not_reach_the_file(tmp_path: Path) -> None:
    """The solver behind the layout rounds differently from one drawing to the next."""
    written = []
    for name, shift in (("one", 0.0), ("two", 3e-11)):
        figure = Figure(figsize=(2.0, 1.0))
        figure.add_axes((0.1 + shift, 0.2, 0.4123456789, 0.5)).plot([0.0, 1.0])
        figure.add_axes((0.6, 0.2 + shift, 0.3, 0.5)).plot([0.0, 1.0])
        written.append([path.read_bytes() for path in save(figure, tmp_path, name)])
    assert written[0] == written[1]


def _row(run: str, arm: Arm, collision: float, velocity: float, **values: str) -> Row:
    shares = {"collision": collision, "at_fault_collision": 0.5 * collision, "success": 0.8}
    figures = {name: Figured(value) for name, value in shares.items()}
    shift = Difference(n=10, places=3, a=0.2, b=0.1, difference=-0.1, low=-0.15, high=-0.02)
    return Row(
        run=run,
        arm=arm,
        values=values,
        planner="p-v1",
        predictor="q-v1",
        traffic="replay",
        loop="ideal",
        futures=1,
        seed=0,
        ranked=True,
        n=10,
        places=3,
        figures=figures | {"velocity": Figured(velocity)},
        differences=dict.fromkeys(frontier.COLUMNS, shift),
    )


def test_the_frontier_has_a_curve_for_each_method_and_points_without_coverage() -> None:
    made, without = Arm.WITH_DOS, Arm.WITHOUT_DOS
    rows = [
        _row("a", made, 0.10, 8.0, method="union", coverage="99"),
        _row("b", made, 0.20, 9.0, method="union", coverage="50"),
        _row("c", made, 0.15, 8.5, method="union", coverage="0.9"),
        _row("d", without, 0.30, 9.5, method="points"),
        _row("e", made, 0.25, 7.0),
        _row("e", without, 0.35, 7.5),
    ]
    table = Table(frontier.COLUMNS, (Block("suite", "d:without_dos", tuple(rows)),))
    found = frontier.methods(table)
    assert [(one.title, one.levels) for one in found] == [
        ("union", (50.0, 90.0, 99.0)),
        ("points", None),
        ("e, with DOS", None),
        ("e, without DOS", None),
    ]
    assert found[0].barred is rows[2]
    figure = frontier.draw(table)
    axes = figure.axes[0]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [o.title for o in found]
    corners = [line for line in axes.get_lines() if line.get_linestyle() == "-"]
    drawn = [xy for line in corners if len(xy := np.asarray(line.get_xydata())) == 2]
    np.testing.assert_allclose(drawn[0], [[9.0, 20.0], [8.5, 15.0]])
    np.testing.assert_allclose(drawn[1], [[8.5, 15.0], [8.0, 10.0]])
    bars = [part for part in axes.containers if isinstance(part, ErrorbarContainer)]
    ends = bars[0].lines[2][1].get_segments()[0]  # Of the point at 90 %, up and down.
    np.testing.assert_allclose(ends, [[8.5, 10.0], [8.5, 23.0]])
    other = Table(frontier.COLUMNS, (*table.blocks, Block("another", None, ())))
    with pytest.raises(CompareError, match=r"differ in world or scenarios \(suite; another\)"):
        frontier.methods(other)


def test_runs_whose_coverage_is_no_number_or_alone_are_in_the_frontier() -> None:
    made, without = Arm.WITH_DOS, Arm.WITHOUT_DOS
    rows = [
        _row("method=free", made, 0.4, 8.0, method="free"),
        _row("coverage=none", made, 0.3, 8.0, method="union", coverage="none"),
        _row("coverage=50", made, 0.2, 8.0, method="union", coverage="50"),
        _row("coverage=90", made, 0.1, 8.0, method="free", coverage="90"),
        _row("coverage=0.7", made, 0.1, 8.0, coverage="0.7"),
        _row("coverage=0.7", without, 0.1, 8.0, coverage="0.7"),
        _row("coverage=0.5", made, 0.1, 8.0, coverage="0.5"),
        _row("coverage=0.5", without, 0.1, 8.0, coverage="0.5"),
    ]
    table = Table(frontier.COLUMNS, (Block("suite", None, tuple(rows)),))
    assert {one.title: one.levels for one in frontier.methods(table)} == {
        "free": (90.0,),
        "method=free": None,
        "union, none": None,
        "union": (50.0,),
        "q-v1, with DOS": (50.0, 70.0),
        "q-v1, without DOS": None,
    }


def test_the_frontier_is_drawn_of_the_runs_after_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [str(SHIPPED / "recorded"), str(SHIPPED / "recorded") + ":with_dos"]
    out = ["--out", str(tmp_path)]
    assert main(["figures", "frontier", *runs, *out]) == OK
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frontier.pdf", "frontier.png"]
    assert "frontier.png and frontier.pdf" in capsys.readouterr().out
    sweep = SweepFolder(tmp_path / "sweep")
    names = ("method=union", "method=free")
    sweep.write(tuple(SweepRun(name=name, settings=RunSettings()) for name in names))
    shutil.copytree(SHIPPED / "recorded", tmp_path / "sweep" / names[0])
    assert main(["figures", "frontier", str(sweep.path), *out]) == OK
    assert "frontier: Not finished, so not here: method=free." in capsys.readouterr().err
    assert main(["figures", "frontier", "no/such", *out]) == BAD_INPUT
    assert "no/such is not a run folder" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        main(["figures", "planning", "frontier", *out])
    assert stop.value.code == BAD_INPUT
    assert "frontier is of runs: name their folders after it" in capsys.readouterr().err
