"""Coverage over area of every method, and the trade-off between both along a parameter."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dosplan.report.figures import style
from dosplan.report.figures.sources import Evaluation, Published
from dosplan.system.files import FileError

_MAIN: Final = "DOS ellipse"  # The paper's main setting: k 0.1, alpha 3.
_MAIN_K, _MAIN_ALPHA = 0.1, 3.0
_NUMBER: Final = r"(\d+(?:\.\d+)?)"
_PARAMETERS: Final = re.compile(f"DOS ellipse k={_NUMBER} alpha={_NUMBER}")


@dataclass(frozen=True)
class Curve:
    """Methods that differ in one parameter.

    Attributes:
        title: Their name in the legend.
        labels: Their labels, by rising parameter.
        look: How they are drawn.
    """

    title: str
    labels: tuple[str, ...]
    look: Mapping[str, Any]


# What the labels begin with, what the legend says, how it is drawn.
_SCALED: Final = (
    ("PR z=", "PR, z = {}", style.INK, "x"),
    ("SA z=", "SA, z = {}", style.PURPLE, "v"),
    ("circle r=", "circle, r = {} m", style.GREEN, "s"),
    ("circle v1 z=", "circle v1, z = {}", style.SKY, "^"),
    ("circle v2 z=", "circle v2, z = {}", style.ORANGE, "D"),
)
# Single settings: label, what the legend says, marker.
# Of these, an evaluation may lack some.
_SINGLE: Final = (
    ("DOS circle", "DOS circle", "o"),
    ("DOS ellipse theta=0", r"DOS ellipse, $\theta$ = 0", "s"),
    ("DOS ellipse theta=pi/4", r"DOS ellipse, $\theta$ = $\pi$/4", "D"),
    ("DOS ellipse v1", "DOS ellipse v1", "^"),
    ("DOS ellipse v2", "DOS ellipse v2", "v"),
    ("DOS coverage", "DOS, coverage loss", "*"),
    ("DOS coverage, calibrated at 90 %", "DOS, calibrated at 90 %", "P"),
    ("DOS coverage, calibrated at 90 % over 4 s", "the same, over all steps at once", "X"),
    ("DOS coverage, calibrated at 70 %", "DOS, calibrated at 70 %", "p"),
    ("DOS union", "DOS, union of three", "1"),
    ("DOS union, calibrated at 90 %", "the union, calibrated at 90 %", "2"),
    ("DOS union, calibrated at 90 % over 4 s", "the same, over all steps at once", "3"),
    ("DOS union, as driven (calibrated at 70 %)", "the union, calibrated at 70 % (as driven)", "4"),
)


def draw(published: Published) -> Figure:
    """Draws the figure.

    Args:
        published: The results.

    Returns:
        A figure of a page's width, a panel for each horizon.

    Raises:
        FileError: The evaluation is missing or lacks a method.
    """
    evaluation = published.evaluation("prediction")
    lines = curves(evaluation)
    horizons = evaluation.of(_MAIN).horizon
    figure = style.new_figure(style.PAGE, 3.5)
    panels = figure.subplots(1, len(horizons), sharey=True, squeeze=False)[0]
    for h, (axes, horizon) in enumerate(zip(panels, horizons, strict=True)):
        for curve in lines:
            _points(axes, evaluation, curve.labels, h, label=curve.title, **curve.look)
        for label, title, marker in _SINGLE:
            if label not in evaluation.options:
                continue
            look = {"markerfacecolor": "none", "linestyle": "none", "color": style.BLUE}
            size = {"markersize": 4 if marker in "osD^v" else 6}
            _points(axes, evaluation, (label,), h, label=title, marker=marker, **look, **size)
        axes.set_xscale("log")
        style.mark_decades(axes.xaxis)
        axes.set(title=f"{horizon:g} s ahead", xlabel="OSA, m²", xmargin=0.08)
    panels[0].set_ylim(top=101.0)
    panels[0].set_ylabel("CR, %")
    handles, titles = panels[0].get_legend_handles_labels()
    figure.legend(handles, titles, loc="outside lower center", ncols=3)
    return figure


def curves(evaluation: Evaluation) -> list[Curve]:
    """Finds the methods that make a curve together.

    Args:
        evaluation: The evaluation.

    Returns:
        The curves: of every z and r, of k at the paper's alpha, and of alpha at each k of which
        there are several.

    Raises:
        FileError: A curve has no method at all.
    """
    found = []
    for prefix, title, colour, marker in _SCALED:
        values = {
            float(label.removeprefix(prefix)): label
            for label in evaluation.options
            if re.fullmatch(re.escape(prefix) + _NUMBER, label)
        }
        if not values:
            raise FileError(f"{evaluation.path} has no method {prefix}...")
        look = {"color": colour, "marker": marker, "linestyle": "-"}
        found.append(Curve(title.format(_listed(values)), _sorted(values), look))
    by_k: dict[float, dict[float, str]] = {_MAIN_K: {_MAIN_ALPHA: _MAIN}}
    for label in evaluation.options:
        if match := _PARAMETERS.fullmatch(label):
            by_k.setdefault(float(match[1]), {})[float(match[2])] = label
    ks = {k: alphas[_MAIN_ALPHA] for k, alphas in by_k.items() if _MAIN_ALPHA in alphas}
    look = {"color": style.VERMILION, "marker": "o"}
    title = rf"DOS ellipse, $\alpha$ = {_MAIN_ALPHA:g}, k = {_listed(ks)}"
    found.append(Curve(title, _sorted(ks), {**look, "linestyle": "-"}))
    for k, alphas in sorted(by_k.items(), reverse=True):
        if len(alphas) > 1:
            title = rf"DOS ellipse, k = {k:g}, $\alpha$ = {_listed(alphas)}"
            line = ":" if k == _MAIN_K else "--"
            found.append(Curve(title, _sorted(alphas), {**look, "linestyle": line}))
    return found


def _points(
    axes: Axes, evaluation: Evaluation, labels: tuple[str, ...], h: int, **look: Any
) -> None:
    """Draws methods at one horizon."""
    sets = [evaluation.of(label) for label in labels]
    area, coverage, half = (
        np.array([getattr(one, name)[h] for one in sets]) for name in ("area", "coverage", "half")
    )
    style.plot_interval(axes, area, coverage, half, **look)


def _listed(values: dict[float, str]) -> str:
    return ", ".join(f"{value:g}" for value in sorted(values))


def _sorted(values: dict[float, str]) -> tuple[str, ...]:
    return tuple(values[value] for value in sorted(values))
