"""Writes ``docs/metrics.md`` and the tables of ``docs/run-folder.md``: ``python docs/schema.py``.

The tables are made from the table of metrics and from the dataclasses. In the page, a table stands
between ``<!-- RunManifest -->`` and ``<!-- end -->``, for each class.
"""

from __future__ import annotations

import inspect
import json
import re
import types
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

import numpy as np

from dosplan.results.comparison import Change, Comparison
from dosplan.results.manifest import RunManifest, RunSettings
from dosplan.results.markdown import markdown
from dosplan.results.paired import Difference
from dosplan.results.recording import Recording
from dosplan.results.rows import LATER
from dosplan.results.summary import ArmSummary, RunTitle, Summary
from dosplan.results.unusable import Unusable
from dosplan.scoring import (
    bounds,
    collision,
    comfort,
    commonroad_cost,
    fault,
    imposed,
    metrics,
    nuplan,
    progress,
    rules,
)
from dosplan.scoring.score import min_time_to_collision
from dosplan.system.provenance import Machine
from dosplan.types import Score, Sightings, Signals, Tracks

PAGE: Final = Path(__file__).with_name("run-folder.md")
METRICS_PAGE: Final = PAGE.with_name("metrics.md")
CLASSES: Final[tuple[type, ...]] = (
    RunManifest, RunSettings, Machine, Score, Recording, Tracks, Signals, Sightings, Summary,
    RunTitle, Comparison, Difference, Change, Unusable,
)  # fmt: skip
_FLATTENED: Final = {"measures": "name of a measured metric", "differences": "name of a metric"}
"""Fields whose entries are keys themselves."""
_METRICS_HEAD: Final = """# Metrics

Made from the table in `dosplan/scoring/metrics.py` by `python docs/schema.py`.

Each episode has a value or none. The values of an arm become one figure: a share (from 0 to 1), a
mean or the largest value (in files a fraction, too, where its unit is %), over the episodes that
have a value. An episode that crashed is an episode like any other, so the denominator of an
outcome's share is the number of episodes, which is scenarios times futures, of what is usable.
A scenario that nobody could drive has no value in any metric: it is counted in `n`, not in
`usable`, and listed in `summary.json`. Nor has an episode in which the traffic raised before
anything else had happened (outcome `traffic_failure`): no planner is judged by it. What a predictor
raises counts as the planner's, and so does a process that dies, as nobody can tell whose fault that
is. Percentiles of cycle times are over the planning cycles of all episodes pooled.

*Key* is the figure's key in `summary.json`; *name*, where it differs, its key in a comparison.

Arms and runs are compared scenario by scenario, and future by future where a run has several:
shares as paired proportions (Tango's score interval, an exact sign-flip test), all else by the mean
of the differences within the pairs (t interval and t test). What is largest over an arm, and cycle
times, have no difference. Intervals, and the test of means, take
into account that several futures are of one scenario and several scenarios of one place: of one
scene, as `USA_Lanker`, or of one map where the country is imaginary, as `ZAM_Zebra-3`. A share
has two p values: `p` takes scenarios as independent, and with one future each it is McNemar's exact
test; `p_places` takes places as independent. Both are exact however few groups differ; the
chi-square tests for pairs in groups (Obuchowski 1998, Durkalski 2003) need many. See
`dosplan/results/paired.py`."""
_MODULES: Final[dict[str, Any]] = {
    "Collisions": collision,
    "Fault": fault,
    "The road": bounds,
    "Rules of the road": rules,
    "Progress": progress,
    "nuPlan's score": nuplan,
    "Comfort": comfort,
    "Time to collision": min_time_to_collision,
    "Imposed braking and cut-ins": imposed,
    "CommonRoad's costs": commonroad_cost,
}
"""What says more of a metric than a line of the table: modules, or a function."""
_NAMES: Final[dict[Any, str]] = {
    str: "text", bool: "true or false", int: "whole number", float: "number", Any: "anything",
    types.NoneType: "null",
}  # fmt: skip


def page_with_tables(page: str) -> str:
    """Puts the tables of all classes into a page.

    Args:
        page: Text of the page, with the marks of every class.

    Returns:
        The page with its tables as the classes are now.

    Raises:
        ValueError: A class has no marks in the page.
    """
    for kind in CLASSES:
        mark = re.compile(rf"(<!-- {kind.__name__} -->\n).*?(<!-- end -->)", re.DOTALL)
        if not mark.search(page):
            raise ValueError(f"{PAGE.name} has no place for the table of {kind.__name__}")
        page = mark.sub(lambda found: f"{found[1]}{_table(kind)}\n{found[2]}", page)  # noqa: B023
    return page


def metrics_page() -> str:
    """Writes down what each metric is.

    Returns:
        The text of ``docs/metrics.md``.
    """
    headings = ["metric", "unit", "key", "over the episodes", "better", "definition"]
    rows = [
        [
            metric.title,
            metric.unit or "-",
            f"`{metric.key}`" + (f" (name `{metric.name}`)" if metric.key != metric.name else ""),
            metric.aggregate.value,
            metric.better.value,
            metric.definition,
        ]
        for metric in metrics.METRICS
    ]
    table = markdown(headings, rows, numbers=False)
    sections = (f"## {title}\n\n{_page_text(told)}" for title, told in _MODULES.items())
    return "\n\n".join([_METRICS_HEAD, table, *sections]) + "\n"


def _page_text(told: Any) -> str:
    """What the docstring of a module or a function says, as Markdown."""
    text = (inspect.getdoc(told) or "").partition("\nArgs:")[0].rstrip()
    return text.replace(" ::\n", ":\n").replace("::\n", ":\n").replace("``", "`")


def _table(kind: type) -> str:
    hints = get_type_hints(kind)
    rows = [
        f"| {_key(field.name)} | {_value_type(hints, field.name)} | {_meaning(kind, field.name)} "
        f"| {_absent(kind, field)} |"
        for field in fields(kind)
    ]
    head = ["| Key | Type | Meaning | Absent: read as |", "| --- | --- | --- | --- |"]
    return "\n".join([*head, *rows])


def _key(name: str) -> str:
    return f"[{_FLATTENED[name]}](metrics.md)" if name in _FLATTENED else f"`{name}`"


def _value_type(hints: Mapping[str, Any], name: str) -> str:
    return _type_name(get_args(hints[name])[1] if name in _FLATTENED else hints[name])


def _type_name(hint: Any) -> str:
    if hint in _NAMES:
        return _NAMES[hint]
    if get_origin(hint) is np.ndarray:
        (dtype,) = get_args(get_args(hint)[1])
        return f"array of `{np.dtype(dtype)}`"
    if get_origin(hint) in (Union, types.UnionType):
        return " or ".join(_type_name(part) for part in get_args(hint))
    if get_origin(hint) is tuple:
        return f"list of: {_type_name(get_args(hint)[0])}"
    if hint == ArmSummary:
        return "[object](metrics.md)"
    if get_origin(hint) is Mapping:
        return f"object of: {_type_name(get_args(hint)[1])}"
    if is_dataclass(hint):
        return f"[object](#{hint.__name__.lower()})"  # type: ignore[union-attr]
    assert issubclass(hint, StrEnum), hint
    return ", ".join(f"`{member}`" for member in hint)


def _meaning(kind: type, name: str) -> str:
    """What the docstring of a class says of an attribute, on one line."""
    text = inspect.getdoc(kind) or ""
    found = re.search(rf"^( *){name}: (.*(?:\n\1 +\S.*)*)", text, re.MULTILINE)
    assert found, f"the docstring of {kind.__name__} says nothing of {name}"
    told = " ".join(found[2].split())
    return told.replace("``", "`").replace("|", "\\|").replace("None", "null")


def _absent(kind: type, field: Field[Any]) -> str:
    if field.name in _FLATTENED:
        return "`null`"
    if (
        kind is Score and field.name not in LATER
    ):  # Its defaults are those of an episode that was not driven.
        return "never absent"
    if field.default is not MISSING:
        value = field.default
    elif field.default_factory is not MISSING:
        value = field.default_factory()
    else:
        return "never absent"
    return f"`{json.dumps(value, default=np.ndarray.tolist)}`"


if __name__ == "__main__":
    PAGE.write_text(page_with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    METRICS_PAGE.write_text(metrics_page(), encoding="utf-8")
