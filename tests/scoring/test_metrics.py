"""The table of metrics: what each entry says, and how values become a figure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dosplan.scoring.metrics import METRICS, Aggregate, Better, Metric, find_metric, measured_kinds
from dosplan.scoring.score import failed_score
from dosplan.types import Arm, EpisodeKey, Outcome, Score

NO_TIMES = np.empty(0)


def _row(**changes: object) -> Score:
    return replace(failed_score(EpisodeKey("s", Arm.WITH_DOS), ""), **changes)  # type: ignore[arg-type]


def test_names_and_keys_are_unique_and_no_measure_hides_a_column() -> None:
    assert len({metric.name for metric in METRICS}) == len(METRICS)
    assert len({metric.key for metric in METRICS}) == len(METRICS)
    columns = failed_score(EpisodeKey("s", Arm.WITH_DOS), "").columns()
    assert len(columns) == len(vars(failed_score(EpisodeKey("s", Arm.WITH_DOS), ""))) - 1 + len(
        measured_kinds()
    )


@pytest.mark.parametrize("metric", METRICS, ids=lambda metric: metric.name)
def test_an_episode_that_never_drove_is_a_failure_and_has_no_other_figure(metric: Metric) -> None:
    value = metric.value(failed_score(EpisodeKey("s", Arm.WITH_DOS), "it broke"))
    if metric.name == "planner_failure":
        assert value is True
    elif metric.is_share and metric.name not in ("comfortable", "off_commonroad_road"):
        assert value is False  # It counts in the denominator.
    elif metric.name == "nuplan_score":
        assert value == 0.0
    else:
        assert value is None


@pytest.mark.parametrize("metric", METRICS, ids=lambda metric: metric.name)
@pytest.mark.parametrize("outcome", [Outcome.UNUSABLE, Outcome.TRAFFIC_FAILURE])
def test_what_no_planner_is_judged_by_has_no_figure(metric: Metric, outcome: Outcome) -> None:
    assert metric.value(failed_score(EpisodeKey("s", Arm.WITH_DOS), "broken", outcome)) is None
    driven = _row(outcome=outcome, safe=True, velocity=3.0, steps=5, goal_step=5)
    assert metric.value(driven) is None


@pytest.mark.parametrize("metric", METRICS, ids=lambda metric: metric.name)
def test_better_is_better(metric: Metric) -> None:
    good = (
        "success",
        "safe",
        "comfortable",
        "velocity",
        "progress",
        "min_time_to_collision",
        "nuplan_score",
        "making_progress",
        "route_progress",
        "driving_direction_compliance",
        "speed_limit_compliance",
    )
    assert metric.better is (Better.HIGHER if metric.name in good else Better.LOWER)


def test_each_way_to_one_figure() -> None:
    rows = [_row(measures={"max_slack": value}) for value in (0.5, 2.0, None)]
    assert find_metric("max_slack").summarise(rows, NO_TIMES) == 2.0
    assert find_metric("solver_failures").summarise(rows, NO_TIMES) is None
    rows = [_row(outcome=Outcome.SUCCESS), _row(), _row(), _row()]
    assert find_metric("success").summarise(rows, NO_TIMES) == 0.25
    rows = [_row(steps=3, velocity=4.0), _row(steps=1, velocity=6.0), _row(velocity=100.0)]
    assert find_metric("velocity").summarise(rows, NO_TIMES) == 5.0
    times = np.arange(101.0)
    assert find_metric("cycle_ms_p50").summarise(rows, times) == 50.0
    assert find_metric("cycle_ms_p99").summarise(rows, times) == 99.0
    assert find_metric("cycle_ms_p99").summarise(rows, NO_TIMES) is None


@pytest.mark.parametrize(
    ("name", "value", "sign", "text"),
    [
        ("success", 0.9567, "", "95.7"),
        ("success", 0.0067, "+", "+0.7"),
        ("velocity", 8.503, "", "8.50"),
        ("velocity", -0.05, "+", "-0.05"),
        ("iterations_max", 122.0, "", "122"),
        ("min_time_to_collision", None, "", "-"),
    ],
)
def test_figures_are_shown_in_their_unit(
    name: str, value: float | None, sign: str, text: str
) -> None:
    assert find_metric(name).shown(value, sign) == text


@pytest.mark.parametrize("aggregate", list(Aggregate))
def test_only_cycle_times_are_percentiles(aggregate: Aggregate) -> None:
    assert (aggregate.percentile is not None) == aggregate.name.startswith("CYCLES")


def _nothing(row: Score) -> None:
    return None


@pytest.mark.parametrize("both", [(None, None), (_nothing, lambda part: None)])
def test_a_metric_is_either_read_or_measured(
    both: tuple[Callable[[Score], None] | None, Callable[[object], None] | None],
) -> None:
    read, measure = both
    with pytest.raises(ValueError, match="metric velocity: give either read or measure"):
        replace(find_metric("velocity"), read=read, measure=measure)
