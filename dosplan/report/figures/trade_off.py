"""Coverage over area of every method: the methods side by side, and the paper's loss by itself."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D

from dosplan.report.figures import style
from dosplan.report.figures.sources import Evaluation, Published
from dosplan.report.palette import CIRCLE, DOS, DOS_PAPER, FAINT, INK, PR, SA
from dosplan.system.files import FileError

_MAIN: Final = "DOS ellipse"  # The paper's main setting: k 0.1, alpha 3.
_MAIN_K, _MAIN_ALPHA = 0.1, 3.0
_NUMBER: Final = r"(\d+(?:\.\d+)?)"
_PARAMETERS: Final = re.compile(f"DOS ellipse k={_NUMBER} alpha={_NUMBER}")
_PAPER: Final[Mapping[str, Any]] = {"color": DOS_PAPER, "marker": "o"}
_BESIDE: Final[Mapping[str, Any]] = {"color": PR, "linewidth": 0.8, "alpha": 0.4}
_FEW_DECADES: Final = 60.0
_POINT: Final[Mapping[str, Any]] = {"linestyle": "none", "markerfacecolor": "none"}


@dataclass(frozen=True)
class Curve:
    """Methods that differ in one parameter, or one alone.

    Attributes:
        title: Their name in the legend.
        labels: Their labels, by rising parameter.
        look: How they are drawn.
    """

    title: str
    labels: tuple[str, ...]
    look: Mapping[str, Any]


# What the labels begin with, what the legend says, how it is drawn.
_SCALED: Final[tuple[tuple[str, str, Mapping[str, Any]], ...]] = (
    ("PR z=", "PR, z = {}", {"color": PR, "marker": "x"}),
    ("SA z=", "SA, z = {}", {"color": SA, "marker": "v"}),
    ("circle r=", "circle, r = {} m", {"color": CIRCLE, "marker": "s"}),
    ("circle v1 z=", "circle v1, z = {}", {"color": CIRCLE, "marker": "^", "linestyle": "--"}),
    ("circle v2 z=", "circle v2, z = {}", {"color": CIRCLE, "marker": "D", "linestyle": ":"}),
)
# Of those from here on, an evaluation may lack some.
_CALIBRATED: Final = (
    Curve(
        "DOS, coverage loss, calibrated at 70 %, 90 %, 90 % over 4 s",
        (
            "DOS coverage, calibrated at 70 %",
            "DOS coverage, calibrated at 90 %",
            "DOS coverage, calibrated at 90 % over 4 s",
        ),
        {"color": DOS, "marker": "p", "markerfacecolor": "white", "linestyle": "--"},
    ),
    Curve(
        "the same, as trained",
        ("DOS coverage",),
        {**_POINT, "color": DOS, "marker": "*", "markersize": 6},
    ),
    Curve(
        "DOS, union of three, calibrated at 70 %, 90 % (as driven), 90 % over 4 s",
        (
            "DOS union, calibrated at 70 %",
            "DOS union, calibrated at 90 %",
            "DOS union, calibrated at 90 % over 4 s",
        ),
        {"color": DOS, "marker": "P", "markersize": 4.5},
    ),
    Curve(
        "the same, as trained",
        ("DOS union",),
        {"color": DOS, "marker": "*", "markersize": 6, "linestyle": "none"},
    ),
)
_SHAPES: Final = tuple(
    Curve(title, (label,), {**_POINT, "color": INK, "marker": marker, "markersize": size})
    for label, title, marker, size in (
        ("DOS circle", "circle", "o", 6.0),
        ("DOS ellipse theta=pi/4", r"ellipse, $\theta$ = $\pi$/4", "D", 3.5),
        ("DOS ellipse theta=0", r"ellipse, $\theta$ = 0", "s", 6.0),
        ("DOS ellipse v1", "ellipse v1", "^", 4.5),
        ("DOS ellipse v2", "ellipse v2", "v", 4.5),
    )
)


def sources(published: Published) -> list[Path]:
    """The files that the figure shows."""
    return [published.evaluation_file("prediction")]


def draw(published: Published) -> Figure:
    """Draws the figure.

    Args:
        published: The results.

    Returns:
        A figure of a page's width, a panel for each horizon: in the upper row the methods, in the
        lower one what the parameters and the shape do to sets of the paper's loss.

    Raises:
        FileError: The evaluation is missing or lacks a method.
    """
    evaluation = published.evaluation("prediction")
    figure = style.new_figure(style.PAGE, 5.9)
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.08, 1.0))
    found = methods(evaluation)
    _row(upper, evaluation, found, "Methods")
    title = "DOS with the paper's loss: parameters, and shapes"
    beside = Line2D([], [], label="PR, as above", **_BESIDE)
    panels = _row(lower, evaluation, of_paper(evaluation), title, [beside])
    pr = found[0]
    for h, axes in enumerate(panels):
        sets = [evaluation.of(label) for label in pr.labels]
        points = [(one.area[h], one.coverage[h]) for one in sets]
        view = axes.get_xlim()
        axes.plot(*np.transpose(points), zorder=1, **_BESIDE)
        axes.set_xlim(view)
    return figure


def methods(evaluation: Evaluation) -> list[Curve]:
    """Finds what is drawn of every method.

    Args:
        evaluation: The evaluation.

    Returns:
        The curves: of every z and r, of k at the paper's alpha, and of the calibrated sets.

    Raises:
        FileError: A curve has no method at all.
    """
    found = []
    for prefix, title, look in _SCALED:
        values = {
            float(label.removeprefix(prefix)): label
            for label in evaluation.options
            if re.fullmatch(re.escape(prefix) + _NUMBER, label)
        }
        if not values:
            raise FileError(f"{evaluation.path} has no method {prefix}...")
        found.append(Curve(title.format(_listed(values)), _sorted(values), look))
    return [*found, _over_k(evaluation), *_there(evaluation, _CALIBRATED)]


def of_paper(evaluation: Evaluation) -> list[Curve]:
    """Finds what is drawn of the paper's loss.

    Args:
        evaluation: The evaluation.

    Returns:
        The curves: of k at the paper's alpha, of alpha at each k of which there are several, and
        the other shapes at the paper's setting.
    """
    found = [_over_k(evaluation)]
    for k, alphas in sorted(_settings(evaluation).items(), reverse=True):
        if len(alphas) > 1:
            title = rf"ellipse, k = {k:g}, $\alpha$ = {_listed(alphas)}"
            line = ":" if k == _MAIN_K else "--"
            found.append(Curve(title, _sorted(alphas), {**_PAPER, "linestyle": line}))
    return [*found, *_there(evaluation, _SHAPES)]


def _over_k(evaluation: Evaluation) -> Curve:
    ks = {
        k: alphas[_MAIN_ALPHA]
        for k, alphas in _settings(evaluation).items()
        if _MAIN_ALPHA in alphas
    }
    title = rf"DOS ellipse, the paper's loss, $\alpha$ = {_MAIN_ALPHA:g}, k = {_listed(ks)}"
    return Curve(title, _sorted(ks), _PAPER)


def _settings(evaluation: Evaluation) -> dict[float, dict[float, str]]:
    """Labels of the paper's loss by k, and by alpha."""
    by_k: dict[float, dict[float, str]] = {_MAIN_K: {_MAIN_ALPHA: _MAIN}}
    for label in evaluation.options:
        if match := _PARAMETERS.fullmatch(label):
            by_k.setdefault(float(match[1]), {})[float(match[2])] = label
    return by_k


def _there(evaluation: Evaluation, curves: Sequence[Curve]) -> list[Curve]:
    """Curves with what was evaluated of them, if anything was."""
    kept = [
        Curve(one.title, tuple(x for x in one.labels if x in evaluation.options), one.look)
        for one in curves
    ]
    return [one for one in kept if one.labels]


def _row(
    figure: SubFigure,
    evaluation: Evaluation,
    curves: Sequence[Curve],
    title: str,
    more: Sequence[Line2D] = (),
) -> Sequence[Axes]:
    """Draws a row of panels, one for each horizon, with its legend, which may have more keys."""
    horizons = evaluation.of(_MAIN).horizon
    panels: Sequence[Axes] = figure.subplots(1, len(horizons), sharey=True, squeeze=False)[0]
    for h, (axes, horizon) in enumerate(zip(panels, horizons, strict=True)):
        for curve in curves:
            _points(axes, evaluation, curve.labels, h, label=curve.title, **curve.look)
        axes.set_xscale("log")
        axes.set(title=f"{horizon:g} s ahead", xlabel="mean area (OSA), m²", xmargin=0.08)
        low, high = axes.get_xlim()
        few = high < _FEW_DECADES * low
        style.mark_decades(axes.xaxis, (1.0, 2.0, 5.0) if few else (1.0,))
    axes = panels[0]
    axes.set_ylim(top=101.0)
    axes.set_ylabel("coverage (CR), %")
    axes.text(
        *(0.97, 0.04), "better: \N{NORTH WEST ARROW}", transform=axes.transAxes, ha="right",
        va="bottom", color=FAINT, fontsize=7,
    )  # fmt: skip
    figure.suptitle(title, x=0.01, ha="left", fontsize=8, weight="bold")
    handles, titles = axes.get_legend_handles_labels()
    figure.legend(
        [*handles, *more],
        [*titles, *(str(key.get_label()) for key in more)],
        loc="outside lower center",
        ncols=2,
    )
    return panels


def _points(
    axes: Axes, evaluation: Evaluation, labels: tuple[str, ...], h: int, **look: Any
) -> None:
    """Draws methods at one horizon."""
    sets = [evaluation.of(label) for label in labels]
    area, coverage, half = (
        np.array([getattr(one, name)[h] for one in sets]) for name in ("area", "coverage", "half")
    )
    style.plot_interval(axes, area, coverage, half, **look)


def _listed(values: Mapping[float, str]) -> str:
    return ", ".join(f"{value:g}" for value in sorted(values))


def _sorted(values: Mapping[float, str]) -> tuple[str, ...]:
    return tuple(values[value] for value in sorted(values))
