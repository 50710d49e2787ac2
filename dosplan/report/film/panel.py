"""One drive, drawn from above, step by step."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline
from matplotlib.text import Annotation

from dosplan.report.film.drives import Take
from dosplan.report.film.framing import Framing
from dosplan.report.film.layers import (
    SEEN_DOTS,
    START_DASHES,
    Bodies,
    Ghosts,
    Lamps,
    Sets,
    Users,
    on_scene,
)
from dosplan.report.film.scene import draw_map, draw_task
from dosplan.report.palette import INK, KIND_COLOURS, OUTCOME_COLOURS, RULE, WHITE
from dosplan.report.road_paint import Lamp, Plate, lamps, plates
from dosplan.report.sight import is_elsewhere
from dosplan.types import FloatArray, Outcome, RoadUserKind

_GAP: Final = 0.6
_CROSS: Final = Outline(  # Open in the middle, wide enough for a car: the contact is seen.
    [(x * r, y * r) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for r in (1.0, _GAP)],
    [Outline.MOVETO, Outline.LINETO] * 4,
)
_SET_METRES: Final = 40.0  # Sets of road users that are farther from the ego are left out.
_BARS: Final = (20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0)  # m
_LEAST_BAR: Final = 60.0  # Pixels.
_AHEAD: Final = (
    0.4  # Share of the way to the border: more road is in view before the ego than behind.
)
_TEXT: Final = 11.0  # Points.


class Panel:
    """One drive, drawn from above.

    Attributes:
        take: What it shows.
        axes: Where; in metres of the scenario's frame.
        moving: What is drawn anew for every picture, from below to above.
    """

    def __init__(self, figure: Figure, take: Take, framing: Framing, index: int) -> None:
        """Draws what stands still.

        Args:
            figure: Where to draw.
            take: What to show.
            framing: What is in view, and where it goes.
            index: Which of the panels this is.
        """
        self.take, self._framing = take, framing
        width, height = framing.size
        left, bottom, wide, high = framing.panels[index]
        self.axes = figure.add_axes((left / width, bottom / height, wide / width, high / height))
        self.axes.set_xticks([])
        self.axes.set_yticks([])
        for spine in self.axes.spines.values():
            spine.set(color=RULE, linewidth=0.8)
        draw_map(self.axes, take.scenario)
        if take.has_task:
            draw_task(self.axes, take.scenario)
        self._aimed: FloatArray | None = None
        self.aim(take.start)
        self._draw_bar(wide, high)
        self._heading(0.0, take.name, color=take.colour, weight="bold", ha="left")
        self._make_layers()

    def aim(self, step: int) -> bool:
        """Turns the view to where it has to be.

        Args:
            step: A step.

        Returns:
            Whether it moved.
        """
        centre, reach = self._centre(step), self._framing.reach
        if self._aimed is not None and np.array_equal(centre, self._aimed):
            return False
        self._aimed = centre
        self.axes.set_xlim(centre[0] - reach[0], centre[0] + reach[0])
        self.axes.set_ylim(centre[1] - reach[1], centre[1] + reach[1])
        return True

    def show(self, step: int) -> None:
        """Updates what moves.

        Args:
            step: A step; a drive that is over stands still.
        """
        take = self.take
        now = min(max(step, take.start), take.end)
        index = self._index(now)
        pose, velocity = take.ego[index, :3], take.ego[index, 3]
        decided = take.row is not None and now >= take.moment
        struck = take.row.collision_with if take.row is not None and decided else None
        unseen = self._show_seen(now)
        self._users.show_step(now, faint=unseen)
        self._show_struck(now, struck)
        if take.row is not None:
            self._ego.show(pose[None], np.array([take.scenario.task.vehicle.size]), [take.colour])
            self._driven.set_data(*take.ego[: index + 1, :2].T)
        self._lamps.show_step(now)
        self._show_cycle(now, pose)
        speed = f"     {velocity:.1f} m/s" if take.row is not None else ""
        self._clock.set_text(f"{take.seconds(now):.1f} s{speed}")
        self._verdict.set_visible(decided)
        for mark in self._marks:
            mark.set_visible(decided)

    def kinds_in_view(self) -> set[RoadUserKind]:
        """Kinds of the road users that come into view."""
        tracks, reach = self.take.tracks, self._framing.reach
        found = set()
        for step in range(self.take.start, self.take.end + 1):
            here = on_scene(tracks, step)
            if len(here):
                away = np.abs(tracks.states[here, step, :2] - self._centre(step))
                found |= {tracks.kinds[user] for user in here[(away < reach).all(axis=-1)]}
        return found

    def unseen(self, step: int) -> set[int]:
        """Ids of the road users in view of which the plan that acts at a step knows nothing."""
        sighted = self._sighted(step)
        if sighted is None:
            return set()
        tracks = self.take.tracks
        here = on_scene(tracks, step)
        away = np.abs(tracks.states[here, min(step, tracks.steps - 1), :2] - self._centre(step))
        shown = here[(away < self._framing.reach).all(axis=-1)]
        return set(tracks.ids[shown].tolist()) - set(sighted)

    def seen_elsewhere(self, step: int) -> tuple[FloatArray, list[int]]:
        """Road users that are not where the plan that acts at a step was told.

        Args:
            step: A step.

        Returns:
            (N, 3) poses at which the ego saw them, and their rows in the tracks.
        """
        tracks = self.take.tracks
        rows = {name: row for row, name in enumerate(tracks.ids.tolist())}
        now = min(step, tracks.steps - 1)
        found = [
            (state[:3], rows[name])
            for name, state in (self._sighted(step) or {}).items()
            if name in rows and is_elsewhere(state, tracks.states[rows[name], now])
        ]
        return np.reshape([pose for pose, _ in found], (-1, 3)), [row for _, row in found]

    def lamps_in_view(self) -> list[Lamp]:
        """The traffic lights that come into view."""
        found = lamps(self.take.scenario.road_map, self.take.signals)
        return [lamp for lamp in found if self._comes_into_view(lamp.place)]

    def plates_in_view(self) -> list[Plate]:
        """The signs that come into view."""
        found = plates(self.take.scenario.road_map)
        return [plate for plate in found if self._comes_into_view(plate.place)]

    def _comes_into_view(self, place: FloatArray) -> bool:
        steps = range(self.take.start, self.take.end + 1) if self._framing.follows else (0,)
        centres = np.array([self._centre(step) for step in steps])
        return bool((np.abs(place - centres) < self._framing.reach).all(axis=-1).any())

    def _centre(self, step: int) -> FloatArray:
        """(2,) middle of the view, m."""
        if not self._framing.follows:
            return self._framing.centre
        pose = self.take.ego[self._index(step), :3]
        ahead = np.array([np.cos(pose[2]), np.sin(pose[2])])
        return np.asarray(pose[:2] + _AHEAD * self._framing.reach * ahead)

    def _index(self, step: int) -> int:
        """Row of ``take.ego`` at a step."""
        return min(max(step - self.take.start, 0), len(self.take.ego) - 1)

    def _cycle(self, step: int) -> int | None:
        """The planning cycle whose plan acts at a step; None before the first."""
        drive = self.take.drive
        if drive is None:
            return None
        cycle = int(np.searchsorted(drive.recording.cycle_steps, step, side="right")) - 1
        return None if cycle < 0 else cycle

    def _sighted(self, step: int) -> dict[int, FloatArray] | None:
        """What the plan that acts at a step was made of: (4,) states by id; None where of all."""
        drive, cycle = self.take.drive, self._cycle(step)
        seen = None if drive is None else drive.recording.sightings
        return None if seen is None or cycle is None else seen.of_cycle(cycle)

    def _show_seen(self, step: int) -> set[int]:
        """Shows where the ego saw road users; gives the ids of those that it did not see."""
        poses, rows = self.seen_elsewhere(step)
        tracks = self.take.tracks
        self._seen.show(poses, tracks.size[rows], INK, [tracks.outlines[row] for row in rows])
        return self.unseen(step)

    def _show_struck(self, step: int, struck: int | None) -> None:
        """Shows whom the ego meets, above the ego."""
        tracks = self.take.tracks
        rows = np.flatnonzero(tracks.ids == struck) if struck is not None else np.empty(0, int)
        rows = np.intersect1d(rows, on_scene(tracks, step))
        self._struck.show(
            tracks.states[rows, min(step, tracks.steps - 1), :3],
            tracks.size[rows],
            [KIND_COLOURS[tracks.kinds[row]] for row in rows],
            [tracks.outlines[row] for row in rows],
            dict.fromkeys(range(len(rows)), OUTCOME_COLOURS[Outcome.COLLISION]),
        )

    def _show_cycle(self, step: int, pose: FloatArray) -> None:
        """Shows the plan and the sets that held at a step."""
        drive, cycle = self.take.drive, self._cycle(step)
        if drive is None or cycle is None:
            return
        recording = drive.recording
        self._plan.set_data(*recording.plan_centres[cycle].T)
        tracks = self.take.tracks
        here = on_scene(tracks, step)
        near = np.linalg.norm(
            tracks.states[here, min(step, tracks.steps - 1), :2] - pose[:2], axis=-1
        )
        kept = (recording.set_cycle == cycle) & np.isin(
            recording.set_ids, tracks.ids[here[near < _SET_METRES]]
        )
        offsets = recording.set_offsets
        span = max(int(np.ptp(offsets)), 1) if len(offsets) else 1
        shares = np.broadcast_to((offsets - offsets[:1]) / span, (int(kept.sum()), len(offsets)))
        self._sets.show(
            recording.set_centres[kept].reshape(-1, 2),
            recording.set_semi_axes[kept].reshape(-1, 2),
            recording.set_angles[kept].reshape(-1),
            shares.reshape(-1),
            np.repeat(recording.weights[kept], len(offsets)),
        )

    def _make_layers(self) -> None:
        axes, take = self.axes, self.take
        self._sets = Sets(axes, zorder=4)
        self._users = Users(axes, take.tracks, KIND_COLOURS, zorder=6)
        (self._driven,) = axes.plot([], [], color=take.colour, linewidth=2.2, zorder=5)
        (self._plan,) = axes.plot(
            [],
            [],
            color=take.colour,
            linewidth=1.2,
            marker="o",
            markersize=2.2,
            markevery=5,
            zorder=7,
        )
        self._ego = Bodies(axes, zorder=8, line=1.0)
        self._struck = Bodies(axes, zorder=8)
        self._seen = Ghosts(axes, SEEN_DOTS, zorder=6)
        # Where nobody drives, the start is all there is of the ego: others drive through it.
        self._start = Ghosts(axes, START_DASHES, zorder=6, fill=0.35 if take.row is None else 0.0)
        if take.has_task:
            size = np.array([take.scenario.task.vehicle.size])
            self._start.show(take.ego[:1, :3], size, take.colour)
        # Above the bodies: whoever drives over a stop line does not hide its light.
        self._lamps = Lamps(axes, lamps(take.scenario.road_map, take.signals), zorder=8)
        outcome = Outcome.SUCCESS if take.row is None else take.row.outcome
        good, colour = outcome is Outcome.SUCCESS, OUTCOME_COLOURS[outcome]
        shape, extent = ("o", 26.0) if good else (_CROSS, 46.0)  # Points.
        self._marks = [
            axes.plot(
                *take.place[:, None],
                marker=shape,
                markersize=extent,
                color="none",
                markerfacecolor="none",
                markeredgecolor=edge,
                markeredgewidth=line,
                zorder=9,
            )[0]
            for edge, line in ((WHITE, 5.5), (colour, 3.0))
        ]
        self._clock = self._heading(1.0, "", color=INK, ha="right")
        self._verdict = axes.text(
            0.5,
            0.965,
            take.verdict,
            transform=axes.transAxes,
            ha="center",
            va="top",
            size=_TEXT,
            weight="bold",
            color=WHITE,
            bbox={"boxstyle": "round,pad=0.35", "facecolor": colour, "edgecolor": WHITE},
            zorder=10,
        )
        self.moving: list[Artist] = [
            *self._sets.artists,
            self._driven,
            *self._users.artists,
            *self._start.artists,
            *self._seen.artists,
            self._plan,
            *self._ego.artists,
            *self._struck.artists,
            *self._lamps.artists,
            *self._marks,
            self._clock,
            self._verdict,
        ]
        for artist in self.moving:
            artist.set_animated(True)

    def _heading(self, x: float, text: str, **style: Any) -> Annotation:
        return self.axes.annotate(
            text, (x, 1.0), xytext=(0, 4), xycoords="axes fraction", textcoords="offset points",
            va="bottom", size=_TEXT, annotation_clip=False, **style,
        )  # fmt: skip

    def _draw_bar(self, wide: float, high: float) -> None:
        """A scale in the lower left corner."""
        metre = 1.0 / (2.0 * self._framing.reach[0])
        bar = next((bar for bar in _BARS if bar * metre * wide >= _LEAST_BAR), _BARS[-1])
        long = bar * metre
        left, low = 12.0 / wide, 12.0 / high
        axes = self.axes
        axes.plot(
            [left, left + long], [low, low], color=INK, linewidth=1.6, zorder=9,
            transform=axes.transAxes, solid_capstyle="butt",
        )  # fmt: skip
        axes.text(
            left + 0.5 * long, low + 4.0 / high, f"{bar:.0f} m", ha="center", va="bottom",
            size=8.0, transform=axes.transAxes, zorder=9,
        )  # fmt: skip
