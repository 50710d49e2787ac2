"""Films: what a picture shows where, read back from its pixels; and what the command refuses."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.colors import to_rgb
from numpy.typing import ArrayLike
from PIL import Image
from shapely.geometry import Point, Polygon, box

from dosplan.cli.main import BAD_INPUT, FAILED, OK, main
from dosplan.geometry import rectangle_corners
from dosplan.report import palette
from dosplan.report.film.drives import Take, takes_of_scenario
from dosplan.report.film.files import write_gif
from dosplan.report.film.film import Film, Picture
from dosplan.report.film.framing import frame_scene
from dosplan.report.film.layers import SET_RAMP
from dosplan.report.palette import ARM_COLOURS, EGO_COLOUR, KIND_COLOURS, LAMP_COLOURS
from dosplan.results.drive import Drive
from dosplan.results.folder import RunFolder
from dosplan.results.markdown import ARM_TITLES, ARMS_SIDE_BY_SIDE
from dosplan.scenario import ScenarioRef
from dosplan.scenario.synthetic import steady_tracks, straight_scenario
from dosplan.simulation.loop import run_episode
from dosplan.simulation.settings import IDEAL, LoopSettings, SensingSettings
from dosplan.system.files import FileError
from dosplan.types import (
    COLOURS,
    Arm,
    FloatArray,
    GoalState,
    Outcome,
    RoadUserKind,
    Scenario,
)
from dosplan.vehicle import VehicleParameters
from tests.support.lights import TURNS_GREEN, regulated_scenario
from tests.support.plugins import PLUGINS, CoastPlanner, GrowingPredictor
from tests.support.runs import (
    STEPS,
    configured,
    run_here,
    run_leaky,
    write_followed,
    write_scenes,
)
from tests.support.scenes import User, driving, write_scenario_xml
from tests.support.traffic import ShyTraffic, braking_before, followed

VEHICLE = VehicleParameters()
ROAD = np.array(to_rgb(palette.ROAD))
NAME = "ZAM_Test-0_1_T-1"


def driven(scenario: Scenario, arm: Arm = Arm.WITH_DOS, loop: LoopSettings = IDEAL) -> Take:
    """Drives, scores and records."""
    episode = run_episode(scenario, CoastPlanner(), GrowingPredictor(), arm, loop)
    drive = Drive.of(scenario, episode)
    return Take(ARM_TITLES[arm], ARM_COLOURS[arm], scenario, drive.row, drive)


def test_a_film_shows_road_users_as_they_were_driven() -> None:
    scenario, episode = followed(), braking_before(ShyTraffic())
    drive = Drive.of(scenario, episode)
    take = Take("", "#000000", scenario, drive.row, drive)
    assert take.tracks.ids.tolist() == [100, 900]
    np.testing.assert_array_equal(take.tracks.states, episode.tracks.states)
    assert take.verdict.startswith("success")
    film = Film([take], "")
    assert RoadUserKind.CAR in film.panels[0].kinds_in_view()
    film.panels[0].show(take.end)


def following(*, gap: float = 30.0, final_step: int = 20, velocity: float = 10.0) -> Scenario:
    """The ego behind a car at 8 m/s, whose centre is a gap before its rear axle; a far goal."""
    tracks = steady_tracks([[gap, 0.0, 0.0, 8.0]], steps=final_step + 1)
    goal = GoalState(first_step=0, last_step=final_step, region=box(380.0, -1.5, 390.0, 1.5))
    return straight_scenario(tracks, velocity=velocity, final_step=final_step, goals=[goal])


def pixel(film: Film, picture: Picture, point: ArrayLike, panel: int = 0) -> FloatArray:
    """(3,) colour, 0 to 1, at a place of the scene; the view is that of the picture."""
    x, y = film.panels[panel].axes.transData.transform(np.asarray(point))
    return np.asarray(picture[picture.shape[0] - 1 - int(y), int(x)] / 255.0)


def inside(film: Film, picture: Picture, panel: int) -> Picture:
    """The pixels of a panel."""
    (left, bottom), (right, top) = film.panels[panel].axes.bbox.get_points().astype(int)
    height = picture.shape[0]
    return picture[height - top : height - bottom, left:right]


def beside(take: Take, index: int) -> tuple[float, float]:
    """A place in the ego's body, off the driven line and the plan: 1.6 m back, 0.5 m left."""
    x, y, heading = take.ego[index, :3]
    back = np.array([np.cos(heading), np.sin(heading)]) * -1.6
    left = np.array([-np.sin(heading), np.cos(heading)]) * 0.5
    return tuple((np.array([x, y]) + back + left).tolist())


def test_everybody_has_its_colour_where_the_recording_says(tmp_path: Path) -> None:
    takes = [driven(following(gap=20.0), arm) for arm in ARMS_SIDE_BY_SIDE]
    film = Film(takes, "title", scale=2.0)
    for step in (0, 7, 20):
        picture = film.picture(step)
        car = takes[0].scenario.tracks.states[0, step, :2] + (-1.5, 0.6)
        for panel, take in enumerate(takes):
            ego = pixel(film, picture, beside(take, step), panel)
            np.testing.assert_array_equal(ego, to_rgb(take.colour))
            other = pixel(film, picture, car, panel)
            np.testing.assert_allclose(other, to_rgb(KIND_COLOURS[RoadUserKind.CAR]), atol=3e-3)
            # Where the ego was at the start there is the road again, but for the driven line.
            gone = pixel(film, picture, beside(take, 0), panel)
            assert np.allclose(gone, ROAD, atol=3e-3) == (step > 0)


def test_sets_are_translucent_and_have_the_colour_of_their_step(tmp_path: Path) -> None:
    scene = following(gap=30.0, final_step=60)
    takes = [driven(scene, arm) for arm in ARMS_SIDE_BY_SIDE]
    film = Film(takes, "title", scale=2.0)
    picture = film.picture(0)
    # The car is at 30 m; 2.5 s ahead, the fifth of eight that are recorded, at 50 m. The set's
    # lateral semi-axis is 0.55 m there and its neighbours are 4 m away, so that it is seen alone.
    place = (50.0, 0.4)
    colour = 0.75 * ROAD + 0.25 * np.array(SET_RAMP(4.0 / 7.0)[:3])
    np.testing.assert_allclose(pixel(film, picture, place, 1), colour, atol=6e-3)
    np.testing.assert_allclose(pixel(film, picture, place, 0), ROAD, atol=3e-3)
    # The other arm has a point there, in the full colour.
    point = pixel(film, picture, (50.0, 0.0), 0)
    np.testing.assert_allclose(point, SET_RAMP(4.0 / 7.0)[:3], atol=6e-3)


def test_a_late_loop_shows_where_the_ego_saw_road_users() -> None:
    film = Film([driven(following(gap=30.0), loop=LoopSettings(latency=0.3))], "", scale=2.0)
    (panel,) = film.panels
    poses, rows = panel.seen_elsewhere(10)
    assert rows == [0]
    # What is driven at step 10 was planned from what was seen at step 7, 2.4 m before.
    np.testing.assert_allclose(poses, [[30.0 + 0.8 * 7, 0.0, 0.0]], atol=0.02)
    assert panel.unseen(10) == set()
    ghost = (35.6 - 0.5 * panel.take.tracks.size[0, 0], 0.0)  # Its back, off the car.
    colours = {
        tuple(pixel(film, film.picture(10), (ghost[0], y))) for y in np.arange(-0.8, 0.8, 0.05)
    }
    assert min(sum(colour) for colour in colours) < 1.2  # Dots of dark ink on the light road.
    assert len(Film([driven(following(gap=30.0))], "").panels[0].seen_elsewhere(10)[1]) == 0


def test_who_is_hidden_from_the_ego_is_drawn_faintly() -> None:
    tracks = steady_tracks([[12.0, 0.0, 0.0, 10.0], [20.0, 0.0, 0.0, 10.0]], steps=21)
    goal = GoalState(first_step=0, last_step=20, region=box(380.0, -1.5, 390.0, 1.5))
    scene = straight_scenario(tracks, velocity=10.0, final_step=20, goals=[goal])
    film = Film(
        [driven(scene, loop=LoopSettings(sensing=SensingSettings(occlusion=True)))], "", 2.0
    )
    hidden = int(tracks.ids[1])
    assert film.panels[0].unseen(10) == {hidden}
    picture = film.picture(10)
    car = np.array(to_rgb(KIND_COLOURS[RoadUserKind.CAR]))
    for x, opacity in ((22.0, 1.0), (30.0, 0.25)):
        seen = pixel(film, picture, (x - 1.0, 0.6))
        np.testing.assert_allclose(seen, opacity * car + (1.0 - opacity) * ROAD, atol=6e-3)


def test_the_ego_does_not_hide_whom_it_meets() -> None:
    take = driven(following(gap=14.3, final_step=60))
    film = Film([take], "", scale=2.0)
    picture = film.picture(take.moment)
    assert not np.allclose(pixel(film, picture, take.place), to_rgb(take.colour), atol=0.02)


def test_the_lights_of_a_film_change_as_they_did(tmp_path: Path) -> None:
    scenario = regulated_scenario()
    film = Film([driven(scenario)], "")
    (panel,) = film.panels
    assert len(panel.lamps_in_view()) == 3
    red, green = (to_rgb(LAMP_COLOURS[COLOURS.index(c)][0]) for c in ("red", "green"))
    for step, wanted in ((TURNS_GREEN - 1, red), (TURNS_GREEN, green)):
        picture = film.picture(step)
        x, y = panel.axes.transData.transform(panel.lamps_in_view()[0].place)
        seen = picture[len(picture) - round(float(y)), round(float(x))] / 255.0
        np.testing.assert_allclose(seen, wanted, atol=0.03)


def test_a_gif_has_a_picture_for_each_step_and_plays_in_real_time(tmp_path: Path) -> None:
    takes = [driven(following(), arm) for arm in ARMS_SIDE_BY_SIDE]
    write_gif(takes, "title", tmp_path / "film.gif")
    film = Film(takes, "title")
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.size == film.size
        assert gif.n_frames == 21  # type: ignore[attr-defined]
        milliseconds = []
        for step in film.steps:
            gif.seek(step)
            milliseconds.append(gif.info["duration"])
            picture = np.asarray(gif.convert("RGB"))
            film.picture(step)  # Turns the view.
            for panel, take in enumerate(takes):
                ego = pixel(film, picture, beside(take, step), panel)
                np.testing.assert_array_equal(ego, to_rgb(take.colour))
    assert milliseconds == [100] * 20 + [2000]


def test_a_drive_that_is_over_stands_still_beside_the_other(tmp_path: Path) -> None:
    # The ego's front is 8.3 m from the car's back and 2 m/s faster: contact after some 4.2 s.
    ends = following(gap=14.3, final_step=60)
    goes_on = driven(following(gap=40.0, final_step=60))
    struck = driven(ends, Arm.WITHOUT_DOS)
    assert struck.row is not None
    assert struck.row.outcome is Outcome.COLLISION
    assert struck.end < goes_on.end
    film = Film([struck, goes_on], "title")
    assert film.moment == struck.moment == struck.row.collision_step
    before, at, later, last = (
        film.picture(step) for step in (struck.moment - 1, struck.moment, struck.end + 2, 60)
    )
    np.testing.assert_array_equal(inside(film, later, 0), inside(film, last, 0))
    assert np.any(inside(film, before, 0) != inside(film, at, 0))
    assert np.any(inside(film, later, 1) != inside(film, last, 1))


def test_the_mark_of_a_collision_is_at_the_contact(tmp_path: Path) -> None:
    take = driven(following(gap=14.3, final_step=60))
    step = take.moment
    assert take.verdict == f"collision with car 100, {0.1 * step:.1f} s"
    tracks = take.scenario.tracks
    bodies = (
        rectangle_corners(take.ego[step, :3], VEHICLE.size),
        rectangle_corners(tracks.states[0, step, :3], tracks.size[0]),
    )
    for body in bodies:
        assert Polygon(body).distance(Point(take.place)) < 0.1


def test_a_row_that_is_not_of_the_drive_is_refused(tmp_path: Path) -> None:
    take = driven(following(gap=14.3, final_step=60))
    assert take.drive is not None
    row = take.drive.row
    assert row.collision_step is not None
    earlier = row.collision_step - 1
    for odd in (replace(row, collision_with=99), replace(row, collision_step=earlier)):
        other = replace(take, drive=replace(take.drive, row=odd))
        with pytest.raises(FileError, match="does not touch road user"):
            Film([other], "title")
    recorded = len(take.drive.recording.inputs)
    for steps in (-1, recorded + 1):
        with pytest.raises(FileError, match=f"{steps} steps, its episode file holds {recorded}"):
            replace(take.drive, row=replace(row, steps=steps))


def test_a_long_drive_is_followed(tmp_path: Path) -> None:
    take = driven(following(gap=300.0, final_step=100, velocity=30.0))
    film = Film([take], "title", scale=2.0)
    views = []
    for step in (0, 50, 100):
        picture = film.picture(step)
        np.testing.assert_array_equal(pixel(film, picture, beside(take, step)), to_rgb(take.colour))
        views.append(film.panels[0].axes.get_xlim())
    (low, high), *others = views
    for number, view in enumerate(others, start=1):
        np.testing.assert_allclose(view, (low + 150.0 * number, high + 150.0 * number))


def test_the_recording_alone_shows_the_start_and_the_goal(tmp_path: Path) -> None:
    scene = following(final_step=15)
    goal = replace(scene.task.goals[0], region=box(60.0, -1.5, 70.0, 1.5))
    scene = replace(scene, task=replace(scene.task, goals=(goal,)))
    film = Film([Take("recorded traffic", EGO_COLOUR, scene)], "title", scale=2.0)
    assert list(film.steps) == list(range(16))
    assert film.moment == 0
    for step in (0, 15):
        ego = pixel(film, film.picture(step), beside(film.panels[0].take, 0))
        ghost = 0.35 * np.array(to_rgb(EGO_COLOUR)) + 0.65 * ROAD  # Others may drive through it.
        np.testing.assert_allclose(ego, ghost, atol=6e-3)
    (left, right), (bottom, top) = film.panels[0].axes.get_xlim(), film.panels[0].axes.get_ylim()
    assert box(left, bottom, right, top).contains(goal.region)


@settings(deadline=None)
@given(st.integers(1, 2), st.floats(0.0, 900.0), st.floats(0.0, 900.0), st.floats(-1e5, 1e5))
def test_panels_fit_and_show_the_drives(count: int, wide: float, tall: float, where: float) -> None:
    drive = np.array([[where, where], [where + wide, where + tall]])
    framing = frame_scene([drive] * count)
    width, height = framing.size
    assert width % 2 == height % 2 == 0
    assert height <= 1200
    panels = [box(x, y, x + w, y + h) for x, y, w, h in framing.panels]
    assert len(panels) == count
    assert all(box(0, framing.legend, width, framing.title).contains(panel) for panel in panels)
    assert not any(a.intersects(b) for i, a in enumerate(panels) for b in panels[:i])
    # A metre is as long along either axis, and never shorter than four pixels.
    scale = np.array(framing.panels[0][2:]) / (2.0 * framing.reach)
    assert scale[0] == pytest.approx(scale[1])
    assert scale[0] >= 4.0
    if not framing.follows:
        assert np.all(np.abs(drive - framing.centre) < framing.reach)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_followed(tmp_path_factory.mktemp("scenes"))


@pytest.fixture(scope="module")
def run(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of them; in the second, the planner raises."""
    return run_leaky(tmp_path_factory.mktemp("run") / "mine", scenes).path


def _size(path: Path) -> tuple[int, int]:
    with Image.open(path) as image:
        return image.size


def test_the_command_draws_both_arms_or_one(run: Path, tmp_path: Path) -> None:
    asked = ["render", f"{run}:{NAME}", "--out"]
    assert main([*asked, str(tmp_path / "both.gif")]) == OK
    assert main([*asked, str(tmp_path / "one.gif"), "--arm", "with_dos"]) == OK
    both, one = _size(tmp_path / "both.gif"), _size(tmp_path / "one.gif")
    assert (both[0], one[0]) == (960, 800)
    with Image.open(tmp_path / "both.gif") as gif:
        assert gif.n_frames == 11  # type: ignore[attr-defined]


def test_a_picture_is_of_the_outcome_or_of_a_moment(run: Path, tmp_path: Path) -> None:
    asked = ["render", f"{run}:{NAME}", "--arm", "with_dos", "--out"]
    for name, more in (("end", []), ("last", ["--time", "1"]), ("first", ["--time", "0"])):
        assert main([*asked, str(tmp_path / f"{name}.png"), *more]) == OK
    end, last, first = ((tmp_path / f"{n}.png").read_bytes() for n in ("end", "last", "first"))
    assert end == last != first
    assert main([*asked, str(tmp_path / "all" / "f.png"), "--frames"]) == OK
    written = sorted((tmp_path / "all").iterdir())
    assert [path.name for path in written] == [f"f-{i:03d}.png" for i in range(11)]
    assert written[0].read_bytes() == first
    assert written[-1].read_bytes() == last


def test_a_planner_that_raises_is_drawn_to_where_it_did(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "failed.gif"
    assert main(["render", f"{run}:ZAM_Test-1_1_T-1", "--out", str(out)]) == OK
    with Image.open(out) as gif:
        assert gif.n_frames == 1  # type: ignore[attr-defined]


def test_why_a_planner_failed_that_drove_first_is_told(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plugins = ["--planner", f"{PLUGINS}:LeakyPlanner", "--predictor", f"{PLUGINS}:StillPredictor"]
    for name, code in (("ZAM_Test-0_1_T-1", OK), ("ZAM_Test-1_1_T-1", FAILED)):
        out = tmp_path / f"{name}.png"
        asked = ["render", name, "--source", str(scenes), *plugins, "--out", str(out)]
        assert main(asked) == code
        shown = capsys.readouterr()
        assert shown.out == f"picture in {out}\n"
        assert out.is_file()
        if code == OK:
            assert shown.err == ""
        else:  # Once for both arms, as a run tells it.
            (line,) = shown.err.splitlines()
            assert line.startswith("2 x planner leaky-v1: RuntimeError: broken for good")
            assert line.endswith(f"[{name}, without_dos]")


@pytest.mark.parametrize("what", [f"SCENES/{NAME}.xml", NAME])
def test_a_scenario_is_drawn_as_recorded_or_driven_first(
    scenes: Path, tmp_path: Path, what: str
) -> None:
    asked = ["render", what.replace("SCENES", str(scenes)), "--source", str(scenes)]
    assert main([*asked, "--out", str(tmp_path / "traffic.gif")]) == OK
    with Image.open(tmp_path / "traffic.gif") as gif:
        assert gif.n_frames == 11  # type: ignore[attr-defined]
    plugins = ["--planner", "cruise", "--predictor", "constant-velocity"]
    assert main([*asked, *plugins, "--out", str(tmp_path / "driven.png")]) == OK
    assert _size(tmp_path / "traffic.gif")[0] == 800
    assert _size(tmp_path / "driven.png")[0] == 2 * 960


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["RUN:ZAM_Test-9_1_T-1"], "did you mean 'ZAM_Test-"),
        (["SCENES:other"], "is not a run folder: it has no run.json"),
        (["BARE:ZAM_Test-0_1_T-1"], "BARE/episodes"),
        (["RUN"], "is a run: name one of its scenarios, as in"),
        (["ZAM_Test-9_1_T-1", "--source", "SCENES"], "did you mean 'ZAM_Test-"),
        (["my/scene"], "my/scene does not exist; name a scenario file, or the id"),
        (["scene.xml", "--source", "SCENES"], "scene.xml does not exist"),
        (["scene.xml.gz"], "scene.xml.gz does not exist"),
        (["ZAM_Test-0_1_T-1", "--seed", "-1"], "seed is -1; it must not be negative"),
        (["SCENES"], "holds 2 scenarios: name one, as in ZAM_Test-0_1_T-1 --source"),
        (["RUN:ZAM_Test-0_1_T-1", "--planner", "idm"], "are for a scenario, not for a run"),
        (["RUN:ZAM_Test-0_1_T-1", "--seed", "1"], "are for a scenario, not for a run"),
        (["http://127.0.0.1:9/x.xml"], "http://127.0.0.1:9/x.xml: cannot be fetched"),
        (["ZAM_Test-0_1_T-1", "--arm", "with_dos"], "which was not driven"),
        (["RUN:ZAM_Test-0_1_T-1", "--time", "1.5"], "no picture at 1.5 s: it lasts 1.0 s"),
        (["RUN:ZAM_Test-0_1_T-1", "--time", "-1"], "no picture at -1 s"),
        (["RUN:ZAM_Test-0_1_T-1", "--time", "nan"], "no picture at nan s"),
        (["RUN:ZAM_Test-0_1_T-1", "--out", "x.avi"], "x.avi: name a file that ends in .gif"),
        (["RUN:ZAM_Test-0_1_T-1", "--out", "x.gif", "--frames"], "are for a .png"),
        (["RUN:ZAM_Test-0_1_T-1", "--out", "SCENES/ZAM_Test-0_1_T-1.xml/x.gif"], "cannot write"),
        (["RUN:ZAM_Test-0_1_T-1", "--out", "TMP/x.mp4"], "pip install 'dosplan[video]'"),
    ],
)
def test_bad_input_is_one_line(
    run: Path,
    scenes: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    complaint: str,
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # As if it were not installed.
    bare, folder = RunFolder(tmp_path / "BARE"), RunFolder(run)
    bare.path.mkdir()
    for ours, theirs in ((bare.manifest, folder.manifest), (bare.rows, folder.rows)):
        ours.write_bytes(theirs.read_bytes())
    places = {"RUN": run, "SCENES": scenes, "BARE": bare.path, "TMP": tmp_path}
    words = ["render", *arguments]
    if "--out" not in arguments:
        words += ["--out", "TMP/x.png"]
    for name, place in places.items():
        words = [str(place) + w.removeprefix(name) if w.startswith(name) else w for w in words]
    before = sorted(tmp_path.iterdir())
    assert main(words) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert complaint in line
    assert sorted(tmp_path.iterdir()) == before


def test_a_video_lasts_as_long_as_the_drive_and_the_last_picture(run: Path, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="videos need the extra `video`")
    out = tmp_path / "film.mp4"
    assert main(["render", f"{run}:{NAME}", "--arm", "with_dos", "--out", str(out)]) == OK
    frames, seconds = ffmpeg.count_frames_and_secs(str(out))
    assert frames == 11 + 20
    assert seconds == pytest.approx(3.1, abs=0.1)


def _without_problem(folder: Path, name: str, users: bool) -> Path:
    """A recording, or a map alone, as a file without a planning problem."""
    path = folder / f"{name}.xml"
    moving = [User(7, driving(60.0, 0.0, 5.0, STEPS + 1))] if users else []
    write_scenario_xml(path, users=moving, problems=[], benchmark_id=name)
    return path


@pytest.mark.parametrize("users", [True, False])
@pytest.mark.parametrize("ending", ["png", "gif", "mp4"])
def test_a_map_or_a_recording_is_drawn_without_a_planning_problem(
    tmp_path: Path, users: bool, ending: str
) -> None:
    if ending == "mp4":
        pytest.importorskip("imageio_ffmpeg")
    path = _without_problem(tmp_path, "ZAM_Bare-1_1_T-1", users)
    out = tmp_path / f"x.{ending}"
    assert main(["render", str(path), "--out", str(out)]) == OK
    if ending == "gif":
        with Image.open(out) as gif:
            assert getattr(gif, "n_frames", 1) == (STEPS + 1 if users else 2)
    assert out.stat().st_size > 1000
    # Nobody drives it, and that is one line.
    complaint = main(["render", str(path), "--planner", "idm", "--out", str(out)])
    assert complaint == BAD_INPUT


def test_without_a_planning_problem_there_is_no_ego_and_all_is_in_view(tmp_path: Path) -> None:
    path = _without_problem(tmp_path, "ZAM_Bare-1_1_T-1", users=True)
    (take,), _ = takes_of_scenario(ScenarioRef(path, "ZAM_Bare-1_1_T-1"))
    film = Film([take], "title", scale=2.0)
    shown = film.panels[0].axes
    picture = film.picture(0)
    assert not (picture == np.round(255.0 * np.array(to_rgb(EGO_COLOUR)))).all(axis=-1).any()
    here = np.array([60.0, 0.0])
    np.testing.assert_array_equal(
        pixel(film, picture, here), to_rgb(KIND_COLOURS[take.tracks.kinds[0]])
    )
    assert film.panels[0].kinds_in_view() == {take.tracks.kinds[0]}
    assert len(film.steps) == STEPS + 1

    path = _without_problem(tmp_path, "ZAM_Bare-2_1_T-1", users=False)
    (take,), _ = takes_of_scenario(ScenarioRef(path, "ZAM_Bare-2_1_T-1"))
    assert take.name == "map"
    shown = Film([take], "title").panels[0].axes
    (left, right), (bottom, top) = shown.get_xlim(), shown.get_ylim()
    assert box(left, bottom, right, top).contains(take.scenario.road_map.drivable)


def test_a_planning_problem_without_a_road_user_is_drawn(tmp_path: Path) -> None:
    path = tmp_path / "ZAM_Empty-1_1_T-1.xml"
    write_scenario_xml(path, benchmark_id="ZAM_Empty-1_1_T-1")
    assert main(["render", str(path), "--out", str(tmp_path / "x.png")]) == OK
    assert main(["render", str(path), "--planner", "idm", "--out", str(tmp_path / "y.gif")]) == OK


def test_an_episode_whose_id_names_its_file_is_drawn(tmp_path: Path) -> None:
    for place in ("a", "b"):
        write_scenes(tmp_path / "source" / place, 1, "ZAM_Twin-{}_1_T-1")
    folder = run_here(configured(tmp_path / "run", tmp_path / "source"))
    name = f"ZAM_Twin-0_1_T-1:b{os.sep}ZAM_Twin-0_1_T-1.xml"
    assert main(["render", f"{folder.path}:{name}", "--out", str(tmp_path / "x.png")]) == OK
    asked = ["render", name, "--source", str(tmp_path / "source"), "--out"]
    assert main([*asked, str(tmp_path / "y.png")]) == OK
