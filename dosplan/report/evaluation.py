"""Tables of an evaluation, in the layout of the paper's Table 1."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

from rich.console import Group, RenderableType

from dosplan.evaluation.groups import LIGHTS, NO_LIGHT, SPEED_BINS
from dosplan.evaluation.metrics import PAPER_AREAS
from dosplan.report.tables import table
from dosplan.results.markdown import markdown
from dosplan.types import ScenarioFuture

Block = tuple[str, list[str], list[list[str]]]
Row = Mapping[str, Any]

_MAIN_GROUPS: Final = ("all", "moving")


def evaluation_tables(figures: Mapping[str, Any]) -> RenderableType:
    """Lays an evaluation out for the terminal.

    Args:
        figures: What ``evaluate``, ``evaluate_futures`` or ``evaluate_drives`` returned.

    Returns:
        What it was measured on; sets of all and of moving road users; coverage by area, by speed
        and by the light ahead; trajectories; upper limits; or coverage over futures; or who left
        the sets of a run. Further groups are in the figures alone.
    """
    parts: list[RenderableType] = [_on(figures["data"])]
    for title, headings, rows in _blocks(figures):
        parts += [f"\n{title}", table(headings, rows)]
    return Group(*parts)


def evaluation_markdown(figures: Mapping[str, Any]) -> str:
    """Writes the same tables as Markdown.

    Args:
        figures: What ``evaluate``, ``evaluate_futures`` or ``evaluate_drives`` returned.

    Returns:
        The text.
    """
    blocks = ["# Evaluation", _on(figures["data"])]
    for title, headings, rows in _blocks(figures):
        blocks += [f"## {title}", markdown(headings, rows)]
    return "\n\n".join(blocks) + "\n"


def _on(data: Row) -> str:
    if "drives" in data:
        return (
            f"{data['drives']} drives of {data['planner']} with the sets of {data['predictor']} in "
            f"{data['run']}, traffic {data['traffic']}, loop {data['loop']}; near is within "
            f"{data['near_m']:g} m of the ego at the step that is compared"
        )
    if "futures" in data:
        return (
            f"{data['pasts']} road users at the start of {data['evaluated']} scenarios of "
            f"{data['source']} ({len(data['failed'])} failed), {data['futures']} futures of each "
            f"by the traffic {data['traffic']}, seed {data['seed']}"
        )
    itself = " (the data evaluated itself)" if data["scaled_on_itself"] else ""
    loop = "" if data.get("loop", "ideal") == "ideal" else f", seen in the loop: {data['loop']}"
    return (
        f"{data['windows']} windows of {data['evaluated']} files of {data['source']} "
        f"({len(data['failed'])} failed), one every {data['every']} steps{loop}.\n"
        f"OSA@90: sets scaled to cover {100 * data['scaled_to']:g} % of all windows of "
        f"{data['scaled_on']}{itself}"
    )


def _blocks(figures: Mapping[str, Any]) -> Iterator[Block]:
    """The tables: title, headings, cells."""
    if "tails" in figures:
        yield from _drive_blocks(figures)
        return
    if "futures" in figures:
        yield from _future_blocks(figures)
        return
    seconds = [f"{t:g}" for t in figures["data"]["horizons_s"]]
    sets = _by(figures["sets"], "method", "group")
    together = _by(figures["simultaneous"], "method", "group")
    groups = {row["group"] for row in figures["sets"]}
    methods = list(dict.fromkeys(row["method"] for row in figures["sets"]))
    shown = [group for group in _MAIN_GROUPS if group in groups]
    for group in shown:
        counts = ", ".join(str(row["n"]) for row in sets[methods[0], group])
        yield (
            f"Sets, {group} (n at {', '.join(seconds)} s: {counts})",
            [
                "Method",
                *(f"CR % {t} s" for t in seconds),
                "CR % all steps",
                *(f"{name} {t} s" for name in ("OSA m2", "OSA@90") for t in seconds),
            ],
            [
                [
                    method,
                    *(_share(row["cr"], row["cr_se"]) for row in sets[method, group]),
                    *(_share(r["coverage"], r["coverage_se"]) for r in together[method, group]),
                    *(_number(row["osa"]) for row in sets[method, group]),
                    *(_number(row["osa90"]) for row in sets[method, group]),
                ]
                for method in methods
            ],
        )
    yield (
        "CR % of sets scaled to the mean areas of the paper's, "
        f"{' / '.join(f'{area:g}' for area in PAPER_AREAS)} m2",
        ["Method", *(f"{group} {t} s" for group in shown for t in seconds)],
        [
            [
                method,
                *(_percent(r["cr_at_paper_area"]) for g in shown for r in sets[method, g]),
            ]
            for method in methods
        ],
    )
    for by, names in (("speed", SPEED_BINS), ("light ahead", (*LIGHTS, NO_LIGHT))):
        if found := [name for name in names if name in groups]:
            yield (
                f"CR % by {by}, at {', '.join(seconds)} s",
                ["Method", *found],
                [
                    [
                        method,
                        *(
                            " / ".join(_percent(r["cr"]) for r in sets[method, name])
                            for name in found
                        ),
                    ]
                    for method in methods
                ],
            )
    several = any(row.get("components", 1) > 1 for row in figures["trajectories"])
    yield (
        "Trajectories, m" + ("; min: of the best of M components" if several else ""),
        [
            "Model",
            "Group",
            "ADE",
            "FDE",
            *(f"{t} s" for t in seconds),
            *(("M", "minADE", "minFDE") if several else ()),
            "n",
        ],
        [
            [
                row["model"],
                row["group"],
                *(_number(x) for x in (row["ade"], row["fde"], *row["displacement"])),
                *(_best_of_components(row) if several else ()),
                str(row["n"]),
            ]
            for row in figures["trajectories"]
            if row["group"] in (*_MAIN_GROUPS, *SPEED_BINS, *LIGHTS, NO_LIGHT)
        ],
    )
    limits = _by(figures["upper_limits"], "model", "representation", "group")
    yield (
        f"Upper limits: mean area of the smallest set that touches the truth, m2 "
        f"(ellipses up to {figures['data']['max_ratio']:g} : 1)",
        ["Model", "Set", *(f"{group} {t} s" for group in shown for t in seconds)],
        [
            [
                model,
                representation,
                *(_number(r["area"]) for g in shown for r in limits[model, representation, g]),
            ]
            for model, representation in dict.fromkeys(key[:2] for key in limits)
        ],
    )


def _best_of_components(row: Row) -> list[str]:
    return [str(row["components"]), _number(row["min_ade"]), _number(row["min_fde"])]


def _future_blocks(figures: Mapping[str, Any]) -> Iterator[Block]:
    """Coverage over the futures of one past, and the pasts that are covered less often."""
    data, rows = figures["data"], _by(figures["futures"], "method", "group")
    seconds = [f"{t:g}" for t in data["horizons_s"]]
    level = f"{100 * data['level']:g} %"
    for group in _MAIN_GROUPS:
        found = {method: part for (method, there), part in rows.items() if there == group}
        if not found:
            continue
        counts = ", ".join(str(row["pasts"]) for row in next(iter(found.values())))
        yield (
            f"Sets over futures, {group} (pasts at {', '.join(seconds)} s: {counts})",
            ["Method", *(f"CR % {t} s" for t in seconds)],
            [
                [method, *(_share(row["cr"], row["cr_se"]) for row in part)]
                for method, part in found.items()
            ],
        )
        yield (
            f"Pasts that are covered below {level}, {group}, in %; in brackets those that would be "
            f"by chance if each were covered to {level}",
            ["Method", *(f"{t} s" for t in seconds)],
            [
                [
                    method,
                    *(f"{_percent(r['below'])} ({_percent(r['below_by_chance'])})" for r in part),
                ]
                for method, part in found.items()
            ],
        )


def _drive_blocks(figures: Mapping[str, Any]) -> Iterator[Block]:
    """Who left the sets of a run, the episodes in which nobody did, and who was struck."""
    for group, rows in _by(figures["tails"], "group").items():
        yield (
            f"Sets that did not hold, {group[0]}",
            [
                "After",
                "Sets",
                "Road users",
                "Left, %",
                "Distance, 50 / 90 / 99 %",
                "of those that left",
                "beyond the set, m",
            ],
            [
                [
                    f"{row['ahead_s']:g} s",
                    str(row["n"]),
                    str(row["road_users"]),
                    _percent(row["outside"]),
                    *(
                        " / ".join(_number(value) for value in row[name].values())
                        for name in ("distance", "distance_outside", "beyond_m")
                    ),
                ]
                for row in rows
            ],
        )
    yield (
        "Episodes in which nobody near left a set (95 % interval)",
        ["After", "Episodes", "Held, %"],
        [
            [
                "all of these" if row["ahead_s"] is None else f"{row['ahead_s']:g} s",
                str(row["n"]),
                f"{_percent(row['held'])} ({_percent(row['low'])} to {_percent(row['high'])})",
            ]
            for row in figures["episodes"]
        ],
    )
    struck = figures["struck"]
    known = [row["inside"] for row in struck if row["inside"] is not None]
    yield (
        f"Road users that were struck: {sum(known)} of {len(known)} inside the set of half a "
        f"second before ({len(struck) - len(known)} more had none)",
        ["Scenario", "Road user", "At fault", "Distance"],
        [
            [
                ScenarioFuture(row["scenario"], row["future"]).title,
                str(row["road_user"]),
                "yes" if row["at_fault"] else "no",
                _number(row["distance"]),
            ]
            for row in struck
        ],
    )


def _by(rows: Sequence[Row], *keys: str) -> dict[tuple[str, ...], list[Row]]:
    """Rows that agree on some keys, in their order."""
    found: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return found


def _or_dash(form: Callable[[float], str]) -> Callable[[float | None], str]:
    return lambda value: "-" if value is None else form(value)


_number = _or_dash(lambda value: f"{value:.3g}" if value < 10.0 else f"{value:.1f}")
_percent = _or_dash(lambda value: f"{100.0 * value:.1f}")


def _share(value: float | None, error: float | None) -> str:
    return _percent(value) if error is None else f"{_percent(value)} ±{_percent(error)}"
