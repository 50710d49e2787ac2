"""The representations: the sets of each, and of PR, in one scene of the first suite."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from dosplan.evaluation.windows import STEPS
from dosplan.plugins.registry import create_predictor
from dosplan.report.figures import style
from dosplan.report.figures.sources import Published
from dosplan.report.film.layers import SET_RAMP, Sets, Users, on_scene
from dosplan.report.film.scene import draw_map
from dosplan.report.palette import INK, KIND_COLOURS
from dosplan.scenario import ScenarioRef, find_scenarios, load_scenario
from dosplan.simulation.world import World
from dosplan.types import STEP_SECONDS, Occupancy, RoadUserKind, Scenario

SCENE: Final = "ZAM_Roundabout-1_2_T-1"  # Bends, where a set's angle matters.
AT: Final = 5.0  # s of its recording
VIEW: Final = ((-30.0, 32.0), (-16.0, 30.0))
"""Bounds of x and of y, m."""
METHODS: Final[dict[str, dict[str, Any]]] = {
    "PR, z = 1": {"sets": "pr", "scale": 1.0},
    "DOS circle": {"sets": "circle", "scale": 1.0},
    r"DOS ellipse, $\theta$ = 0": {"sets": "theta-0", "scale": 1.0},
    r"DOS ellipse, $\theta$ = $\pi$/4": {"sets": "theta-45", "scale": 1.0},
    "DOS ellipse v1": {"sets": "v1", "scale": 1.0},
    "DOS ellipse v2": {"sets": "v2", "scale": 1.0},
    r"DOS ellipse, $\theta$ free": {"sets": "free", "scale": 1.0},
    "DOS, calibrated at 90 %": {"coverage": 0.9},
}
SHOWN: Final = np.arange(4, STEPS, 5)
"""Columns of the steps that are drawn: each half second."""
_COLUMNS: Final = 4
_BAR: Final = 10.0  # m
_FUTURE: Final[dict[str, Any]] = {
    "color": INK, "linewidth": 0.6, "marker": ".", "markersize": 2.5
}  # fmt: skip


def sources(published: Published) -> list[Path]:
    """The files that the figure shows: the scene, and the weights of every method."""
    del published
    predictors = [create_predictor("dos", 0, options) for options in METHODS.values()]
    weights = [path for predictor in predictors for path in predictor.weight_files()]
    return [_scene().path, *dict.fromkeys(weights)]


def draw(published: Published) -> Figure:
    """Draws the figure with the weights that are installed.

    Args:
        published: The results; not used in this figure.

    Returns:
        A figure of a page's width.

    Raises:
        ScenarioError: The suite cannot be read.
        RegistryError: The predictor cannot be built.
    """
    del published
    scenario = load_scenario(_scene())
    rows = -(-len(METHODS) // _COLUMNS)
    figure = style.new_figure(style.PAGE, 1.55 * rows + 0.35)
    panels = figure.subplots(rows, _COLUMNS)
    for axes, (title, options) in zip(panels.flat, METHODS.items(), strict=True):
        _draw_scene(axes, scenario)
        _draw_sets(axes, predicted_sets(scenario, options))
        axes.set_title(title)
    _draw_scale(panels[0, 0])
    colours = ScalarMappable(Normalize(0.0, STEPS * STEP_SECONDS), SET_RAMP)
    figure.colorbar(colours, ax=panels, aspect=30, pad=0.01, label="time ahead, s")
    keys = [
        Patch(facecolor=KIND_COLOURS[RoadUserKind.CAR], edgecolor=INK, label="car"),
        Line2D([], [], label="recorded future, a dot each second", **_FUTURE),
    ]
    figure.legend(handles=keys, loc="outside lower center", ncols=2)
    return figure


def predicted_sets(scenario: Scenario, options: dict[str, Any]) -> Occupancy:
    """The sets of a method in the figure's scene.

    Args:
        scenario: The scene.
        options: Options of the predictor ``dos``.

    Returns:
        What it predicts at the moment that is shown.
    """
    predictor = create_predictor("dos", 0, options)
    predictor.reset(scenario.task, scenario.road_map)
    return predictor.predict(World(scenario, first_step=_step(scenario)).observation())


def _scene() -> ScenarioRef:
    return next(ref for ref in find_scenarios("suite-1") if ref.id == SCENE)


def _step(scenario: Scenario) -> int:
    return round(AT / scenario.dt)


def _draw_scene(axes: Axes, scenario: Scenario) -> None:
    """The road, the road users on it, and their recorded paths."""
    draw_map(axes, scenario)
    tracks, now = scenario.tracks, _step(scenario)
    Users(axes, tracks, KIND_COLOURS, zorder=5).show_step(now)
    for user in on_scene(tracks, now):
        recorded = tracks.valid[user, now : now + STEPS + 1, None]
        path = np.where(recorded, tracks.states[user, now : now + STEPS + 1, :2], np.nan)
        axes.plot(*path.T, markevery=round(1.0 / scenario.dt), zorder=6, **_FUTURE)
    axes.set(xlim=VIEW[0], ylim=VIEW[1], aspect="equal", xticks=[], yticks=[])
    axes.spines[:].set_visible(True)


def _draw_sets(axes: Axes, occupancy: Occupancy) -> None:
    sets, _, weight = occupancy.by_component()
    shown = sets.valid[:, SHOWN]
    shares = np.broadcast_to((SHOWN + 1) / STEPS, shown.shape)
    Sets(axes, zorder=4).show(
        sets.centre[:, SHOWN][shown],
        sets.semi_axes[:, SHOWN][shown],
        sets.angle[:, SHOWN][shown],
        shares[shown],
        np.broadcast_to(weight[:, None], shown.shape)[shown],
    )


def _draw_scale(axes: Axes) -> None:
    x, y = VIEW[0][0] + 3.0, VIEW[1][0] + 3.0
    axes.plot([x, x + _BAR], [y, y], color=INK, linewidth=1.5)
    axes.text(x + 0.5 * _BAR, y + 1.0, f"{_BAR:g} m", ha="center", va="bottom", size=7)
