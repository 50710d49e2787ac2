"""What moves in a drawn scene: bodies, sets, lines, each of them set anew at every step.

A layer makes its artists once; to show another step is to change their data, which is what makes
drawing a film quick.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, PathCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, to_rgba

from dosplan.geometry import rectangle_corners, to_world
from dosplan.report.palette import INK, LAMP_COLOURS, LAMP_RIM, SET_COLOURS, WHITE
from dosplan.report.road_paint import Lamp
from dosplan.types import FloatArray, IntArray, RoadUserKind, Tracks

SET_RAMP: Final = LinearSegmentedColormap.from_list("sets", SET_COLOURS)
"""Colour of a set by the time at which it is to hold, from the soonest to the latest shown."""

_EDGE: Final = (1.0, 1.0, 1.0, 0.9)  # Sets are translucent, so that those below are seen.
_AREA: Final = (1.0, 1.0, 1.0, 0.25)
Dashes = tuple[float, tuple[float, float]]
"""Where they begin, the length of one and of the gap after it, in widths of the line."""
START_DASHES: Final[Dashes] = (0.0, (3.0, 1.8))
"""Of the outline of the ego at its start."""
SEEN_DOTS: Final[Dashes] = (0.0, (1.0, 1.0))
"""Of the outline of a road user where the ego saw it."""

_FAINTLY: Final = 0.25  # Opacity.
_LAMP: Final = 46.0  # Area of a traffic light, square points.
_POINT: Final = 14.0  # Area of a predicted position, square points.


class Bodies:
    """Bodies seen from above, each with an arrow head in the direction of its heading."""

    def __init__(self, axes: Axes, zorder: float, line: float = 0.4) -> None:
        """Makes the artists; nobody is shown yet.

        Args:
            axes: Where to draw.
            zorder: Height among the other layers.
            line: Width of an outline, points.
        """
        self._line = line
        self._bodies = PolyCollection([], zorder=zorder)
        self._noses = PolyCollection([], facecolors=WHITE, alpha=0.8, zorder=zorder)
        self.artists: tuple[Artist, ...] = (self._bodies, self._noses)
        axes.add_collection(self._bodies, autolim=False)
        axes.add_collection(self._noses, autolim=False)

    def show(
        self,
        poses: FloatArray,
        sizes: FloatArray,
        colours: Sequence[str],
        outlines: Sequence[FloatArray | None] | None = None,
        marked: Mapping[int, str] | None = None,
        faint: Collection[int] = (),
    ) -> None:
        """Shows bodies in the place of those before.

        Args:
            poses: (N, 3) x, y, m, and heading, rad.
            sizes: (N, 2) length and width, m.
            colours: N colours.
            outlines: N polygons in the body frame where a body is no rectangle, None where it is.
            marked: Colour of a thick outline, by index of the body.
            faint: Indices of the bodies that are drawn faintly.
        """
        corners = _corners(poses, sizes, outlines)
        edges, lines = [INK] * len(corners), [self._line] * len(corners)
        for index, colour in (marked or {}).items():
            edges[index], lines[index] = colour, 1.5
        self._bodies.set_verts(corners)
        opacity = [_FAINTLY if index in faint else 1.0 for index in range(len(corners))]
        self._bodies.set_facecolor(_with_opacity(colours, opacity))
        self._bodies.set_edgecolor(_with_opacity(edges, opacity))
        self._bodies.set_linewidth(lines)
        self._noses.set_verts([_nose(*body) for body in zip(poses, sizes, strict=True)])


class Ghosts:
    """Bodies where they are not now: broken outlines."""

    def __init__(self, axes: Axes, dashes: Dashes, zorder: float, fill: float = 0.0) -> None:
        """Makes the artists; nobody is shown yet.

        Args:
            axes: Where to draw.
            dashes: Of their outlines.
            zorder: Height among the other layers.
            fill: Opacity of their area.
        """
        self._fill = fill
        self._bodies = PolyCollection([], linewidths=1.0, linestyles=[dashes], zorder=zorder)
        self.artists: tuple[Artist, ...] = (self._bodies,)
        axes.add_collection(self._bodies, autolim=False)

    def show(
        self,
        poses: FloatArray,
        sizes: FloatArray,
        colour: str,
        outlines: Sequence[FloatArray | None] | None = None,
    ) -> None:
        """Shows outlines in the place of those before.

        Args:
            poses: (N, 3) x, y, m, and heading, rad.
            sizes: (N, 2) length and width, m.
            colour: Their colour.
            outlines: N polygons in the body frame where a body is no rectangle, None where it is.
        """
        self._bodies.set_verts(_corners(poses, sizes, outlines))
        self._bodies.set_facecolor(to_rgba(colour, self._fill))
        self._bodies.set_edgecolor(colour)


class Users(Bodies):
    """The recorded road users."""

    def __init__(
        self, axes: Axes, tracks: Tracks, colours: Mapping[RoadUserKind, str], zorder: float
    ) -> None:
        """Makes the artists; nobody is shown yet.

        Args:
            axes: Where to draw.
            tracks: The recording.
            colours: Colour of each kind.
            zorder: Height among the other layers.
        """
        super().__init__(axes, zorder)
        self._tracks, self._colours = tracks, colours

    def show_step(
        self,
        step: int,
        marked: Mapping[int, str] | None = None,
        faint: Collection[int] = (),
    ) -> None:
        """Shows the road users on the scene.

        Args:
            step: Step of the recording; after its end, the scene is empty.
            marked: Colour of a thick outline, by id of the road user.
            faint: Ids of the road users that are drawn faintly.
        """
        tracks = self._tracks
        here = on_scene(tracks, step)
        ids = tracks.ids[here].tolist()
        self.show(
            tracks.states[here, step, :3] if len(here) else np.empty((0, 3)),
            tracks.size[here],
            [self._colours[tracks.kinds[user]] for user in here],
            [tracks.outlines[user] for user in here],
            {ids.index(user): colour for user, colour in (marked or {}).items() if user in ids},
            {ids.index(user) for user in faint if user in ids},
        )


class Sets:
    """Predicted sets, coloured by their step; those without an extent are points."""

    def __init__(self, axes: Axes, zorder: float) -> None:
        """Makes the artists; there is no set yet.

        Args:
            axes: Where to draw.
            zorder: Height among the other layers.
        """
        self._ellipses = EllipseCollection(
            [],
            [],
            [],
            units="xy",
            offsets=np.empty((0, 2)),
            offset_transform=axes.transData,
            linewidths=0.8,
            zorder=zorder,
        )
        axes.add_collection(self._ellipses, autolim=False)
        self._points: PathCollection = axes.scatter([], [], s=_POINT, linewidths=0, zorder=zorder)
        self.artists: tuple[Artist, ...] = (self._ellipses, self._points)

    def show(
        self,
        centres: FloatArray,
        semi_axes: FloatArray,
        angles: FloatArray,
        shares: FloatArray,
        weights: FloatArray,
    ) -> None:
        """Shows sets in the place of those before; what is NaN is left out.

        Args:
            centres: (M, 2) m.
            semi_axes: (M, 2) m.
            angles: (M,) direction of the first semi-axis, rad.
            shares: (M,) place of each on ``SET_RAMP``, 0 to 1: higher, the later it is to hold.
            weights: (M,) how likely each is, 0 to 1: the less, the fainter.
        """
        # Sets grow with time: the far ones are drawn first, so that none hides another.
        order = np.argsort(-shares, kind="stable")
        order = order[np.isfinite(centres[order]).all(axis=-1)]
        extended = (semi_axes[order] > 0.0).all(axis=-1)
        sets, points = order[extended], order[~extended]
        colours = SET_RAMP(shares)
        colours[:, 3] *= np.sqrt(weights)  # The root, so that 0.1 is still drawn by a third.
        self._ellipses.set_offsets(centres[sets])
        self._ellipses.set_widths(2.0 * semi_axes[sets, 0])
        self._ellipses.set_heights(2.0 * semi_axes[sets, 1])
        self._ellipses.set_angles(np.rad2deg(angles[sets]))
        self._ellipses.set_edgecolor((colours[sets] * _EDGE).tolist())
        self._ellipses.set_facecolor((colours[sets] * _AREA).tolist())
        self._points.set_offsets(centres[points])
        self._points.set_facecolor(colours[points].tolist())


class Lamps:
    """Traffic lights: a disc in the colour that is shown, with a dark rim."""

    def __init__(self, axes: Axes, lamps: Sequence[Lamp], zorder: float) -> None:
        """Makes the artists; nothing is shown yet.

        Args:
            axes: Where to draw.
            lamps: The lights.
            zorder: Height among the other layers.
        """
        self._lamps = lamps
        places = np.reshape([lamp.place for lamp in lamps], (-1, 2))
        self._discs, self._cores = (
            axes.scatter(
                places[:, 0],
                places[:, 1],
                s=size,
                edgecolors=LAMP_RIM,
                linewidths=rim,
                zorder=zorder,
            )
            for size, rim in ((_LAMP, 1.1), (0.22 * _LAMP, 0.0))
        )
        self.artists: tuple[Artist, ...] = (self._discs, self._cores)

    def show_step(self, step: int) -> None:
        """Shows what the lights show.

        Args:
            step: A step.
        """
        shown = [LAMP_COLOURS[lamp.at(step)] for lamp in self._lamps]
        self._discs.set_facecolor([disc for disc, _ in shown])
        self._cores.set_facecolor([core for _, core in shown])


def on_scene(tracks: Tracks, step: int) -> IntArray:
    """Finds the road users on the scene.

    Args:
        tracks: The recording.
        step: A step; after the end of the recording, the scene is empty.

    Returns:
        Indices of the road users.
    """
    # A slice, which may be empty: an index past the end would be refused.
    return np.flatnonzero(tracks.valid[:, step : step + 1].any(axis=1)).astype(np.int64)


def _corners(
    poses: FloatArray, sizes: FloatArray, outlines: Sequence[FloatArray | None] | None
) -> list[FloatArray]:
    """N polygons, m."""
    shapes = outlines or [None] * len(poses)
    return [
        rectangle_corners(pose, size) if shape is None else to_world(shape, pose)
        for pose, size, shape in zip(poses, sizes, shapes, strict=True)
    ]


def _with_opacity(
    colours: Sequence[str], opacity: Sequence[float]
) -> list[tuple[float, float, float, float]]:
    return [to_rgba(colour, share) for colour, share in zip(colours, opacity, strict=True)]


def _nose(pose: FloatArray, size: FloatArray) -> FloatArray:
    """(3, 2) an arrow head in the front half of a body, m."""
    length, width = size
    head = np.array([[0.46 * length, 0.0], [0.18 * length, 0.36 * width]])
    return to_world(np.array([*head, head[1] * (1.0, -1.0)]), pose)
