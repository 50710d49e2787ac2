"""The renderer: what it draws where, read back from matplotlib's artists."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import (
    EllipseCollection,
    LineCollection,
    PathCollection,
    PolyCollection,
)
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.image import imread
from shapely.geometry import box

from dosplan.geometry import lanelet_union, rectangle_corners
from dosplan.report.film.layers import Lamps, Sets
from dosplan.report.film.paint import LAMP_HANDLER
from dosplan.report.film.scene import draw_scene, legend_handles
from dosplan.report.palette import EGO_COLOUR, KIND_COLOURS, LAMP_COLOURS
from dosplan.report.road_paint import lamps
from dosplan.scenario.synthetic import busy_scenario
from dosplan.types import COLOURS, GoalState, LightColour, RoadMap, Scenario
from dosplan.vehicle import VehicleParameters
from tests.support.lights import STOP_X, TURNS_GREEN, regulated_scenario

GOAL = box(60.0, -1.5, 72.0, 1.5)
VEHICLE = VehicleParameters()


@pytest.fixture
def scenario() -> Scenario:
    """A car, a truck, a pedestrian and a parked car; the goal lies 60 m ahead."""
    scene = busy_scenario()
    goal = GoalState(first_step=80, last_step=90, region=GOAL)
    return replace(scene, task=replace(scene.task, goals=(goal,)))


@pytest.fixture
def axes() -> Axes:
    return Figure().add_subplot()


def _bodies(axes: Axes) -> dict[str, list[np.ndarray]]:
    """Corners of the rectangles that are drawn, by colour."""
    found: dict[str, list[np.ndarray]] = {}
    for collection in axes.collections:
        if not isinstance(collection, PolyCollection):
            continue
        outlines = [np.asarray(path.vertices) for path in collection.get_paths()]
        colours = np.resize(collection.get_facecolor(), (len(outlines), 4))
        for outline, colour in zip(outlines, colours, strict=True):
            if len(outline) == 5:  # A closed rectangle; a heading is a triangle.
                found.setdefault(to_hex(tuple(colour)), []).append(outline[:4])
    return found


def test_everybody_is_where_the_recording_says(axes: Axes, scenario: Scenario) -> None:
    draw_scene(axes, scenario, 40)
    bodies, tracks = _bodies(axes), scenario.tracks
    for user, kind in enumerate(tracks.kinds):
        (drawn,) = bodies[KIND_COLOURS[kind]]
        expected = rectangle_corners(tracks.states[user, 40, :3], tracks.size[user])
        np.testing.assert_allclose(drawn, expected)


def test_who_is_not_there_is_not_drawn(axes: Axes, scenario: Scenario) -> None:
    valid = scenario.tracks.valid.copy()
    valid[0, 40] = False
    gone = replace(scenario, tracks=replace(scenario.tracks, valid=valid))
    draw_scene(axes, gone, 40)
    assert KIND_COLOURS[scenario.tracks.kinds[0]] not in _bodies(axes)


def test_past_the_recording_only_the_ego_is_left(axes: Axes, scenario: Scenario) -> None:
    draw_scene(axes, scenario, scenario.tracks.steps + 5)
    assert set(_bodies(axes)) == {EGO_COLOUR}


def test_ego_stands_at_its_start(axes: Axes, scenario: Scenario) -> None:
    draw_scene(axes, scenario, 43)
    (drawn,) = _bodies(axes)[EGO_COLOUR]
    np.testing.assert_allclose(drawn.mean(axis=0), VEHICLE.centre(scenario.task.start))


def test_sets_have_their_full_axes_and_the_latest_is_below(axes: Axes) -> None:
    centres = np.array([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [np.nan, 0.0]])
    semi_axes = np.array([[2.0, 1.0], [0.0, 0.0], [4.0, 2.0], [1.0, 1.0]])
    shares = np.array([0.0, 0.5, 1.0, 0.2])
    Sets(axes, zorder=4).show(centres, semi_axes, np.zeros(4), shares, np.ones(4))
    (ellipses,) = (c for c in axes.collections if isinstance(c, EllipseCollection))
    (points,) = (c for c in axes.collections if isinstance(c, PathCollection))
    # The latest is drawn first, so that none hides another; what has no extent is a point.
    np.testing.assert_array_equal(np.asarray(ellipses.get_offsets()), centres[[2, 0]])
    np.testing.assert_array_equal(np.asarray(ellipses.get_widths()), [8.0, 4.0])
    np.testing.assert_array_equal(np.asarray(ellipses.get_heights()), [4.0, 2.0])
    np.testing.assert_array_equal(np.asarray(points.get_offsets()), centres[[1]])


def test_a_component_of_little_weight_is_fainter(axes: Axes) -> None:
    weights = np.array([1.0, 0.25, 0.0])
    flat = np.zeros(3)
    Sets(axes, zorder=4).show(np.zeros((3, 2)), np.ones((3, 2)), flat, flat, weights)
    (ellipses,) = (c for c in axes.collections if isinstance(c, EllipseCollection))
    for colours in (ellipses.get_facecolor(), ellipses.get_edgecolor()):
        alpha = np.asarray(colours)[:, 3]
        assert alpha / alpha[0] == pytest.approx([1.0, 0.5, 0.0])


def test_view_is_square_and_shows_start_and_goal(axes: Axes, scenario: Scenario) -> None:
    draw_scene(axes, scenario, 40)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert right - left == pytest.approx(top - bottom)
    view = box(left, bottom, right, top)
    assert view.contains(GOAL)
    assert view.contains(box(0.0, -1.0, 4.0, 1.0))


def test_islands_stay_open(scenario: Scenario, tmp_path: Path) -> None:
    figure = Figure()
    axes = figure.add_subplot()
    island = box(18.0, 2.2, 28.0, 4.8)
    road_map = scenario.road_map
    pierced = RoadMap(road_map.lanelets, road_map.drivable.difference(island))
    draw_scene(axes, replace(scenario, road_map=pierced), 40)
    figure.savefig(tmp_path / "scene.png", dpi=figure.dpi)
    pixels = imread(tmp_path / "scene.png")
    points = axes.transData.transform([(23.0, 3.5), (40.0, 3.5)]).round().astype(int)
    inside, beside = (pixels[len(pixels) - y, x, :3] for x, y in points)
    np.testing.assert_array_equal(inside, 1.0)
    assert np.all(beside < 1.0)


def test_a_sidewalk_is_hatched_beside_the_road(scenario: Scenario, axes: Axes) -> None:
    lanelets = scenario.road_map.lanelets
    lane, sidewalk = lanelets[0], replace(lanelets[1], is_road=False)
    both = (lane, sidewalk)
    mixed = replace(scenario, road_map=RoadMap(both, lanelet_union([lane])))
    draw_scene(axes, mixed, 40)
    (hatched,) = (patch for patch in axes.patches if patch.get_hatch())
    middle = sidewalk.centre[len(sidewalk.centre) // 2]
    assert hatched.get_path().contains_point(middle)
    assert not hatched.get_path().contains_point(lane.centre[len(lane.centre) // 2])
    labels = [str(handle.get_label()) for handle in legend_handles(mixed)]
    assert labels[:3] == ["ego", "goal", "no road for cars"]


def test_legend_names_what_occurs(scenario: Scenario) -> None:
    labels = [str(handle.get_label()) for handle in legend_handles(scenario)]
    assert labels == ["ego", "goal", "car", "truck", "pedestrian", "parked"]


def test_what_is_painted_and_what_stands_beside_is_drawn(axes: Axes) -> None:
    draw_scene(axes, regulated_scenario(), 0)
    drawn = {str(artist.get_label()): artist for artist in (*axes.collections, *axes.lines)}
    assert {"solid", "dashed", "lines", "crosswalk", "stop line", "speed_limit", "stop"} <= set(
        drawn
    )
    stops = drawn["stop line"]
    assert isinstance(stops, LineCollection)
    assert sorted(segment[:, 0].mean() for segment in stops.get_segments()) == [STOP_X, STOP_X]
    dashes: Any = drawn["dashed"]
    assert [pattern is not None for _, pattern in dashes.get_linestyle()] == [True]
    assert [text.get_text() for text in axes.texts][:1] == ["50"]
    stripes = drawn["crosswalk"]
    assert isinstance(stripes, PolyCollection)
    assert len(stripes.get_paths()) == 7  # 7 m of road, half a metre each, and gaps between.


def test_lights_have_the_colour_of_the_step(axes: Axes) -> None:
    scenario = regulated_scenario()
    layer = Lamps(axes, lamps(scenario.road_map, scenario.signals), zorder=8)
    discs = layer.artists[0]
    assert isinstance(discs, PathCollection)
    red, green = (LAMP_COLOURS[COLOURS.index(c)][0] for c in (LightColour.RED, LightColour.GREEN))
    for step, wanted in ((0, [red, green, red]), (TURNS_GREEN, [green, green, red])):
        layer.show_step(step)
        assert [to_hex(tuple(c)) for c in np.asarray(discs.get_facecolor())] == wanted
    places = np.asarray(discs.get_offsets())
    np.testing.assert_allclose(places[:, 0], STOP_X)


def test_the_legend_names_lights_and_the_unit_of_limits(axes: Axes) -> None:
    keys = legend_handles(regulated_scenario())
    axes.legend(handles=keys, handler_map=dict(LAMP_HANDLER))
    legend = axes.get_legend()
    assert legend is not None
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == ["ego", "goal", "no road for cars", "traffic light", "limit, km/h"]
