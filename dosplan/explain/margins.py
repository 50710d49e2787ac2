"""A success: how much room and time was left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import shapely

from dosplan.geometry import rectangle_corners
from dosplan.results.drive import Drive
from dosplan.scoring.collision import shape_at
from dosplan.types import RoadUserKind


@dataclass(frozen=True)
class Clearance:
    """The closest that the ego came to a road user.

    Attributes:
        metres: Distance of the exact shapes, m.
        road_user: Id.
        kind: What it is.
        seconds: When, since the start, s.
    """

    metres: float
    road_user: int
    kind: RoadUserKind
    seconds: float


@dataclass(frozen=True)
class Margins:
    """What was left in an episode that went well.

    Attributes:
        reached: When the goal was reached, s since the start.
        spare: Time left then, s.
        clearance: To the road user that came closest at a step; None where there was none.
        road: Smallest distance of the ego's rectangle to the edge of the drivable area, m.
    """

    reached: float
    spare: float
    clearance: Clearance | None
    road: float

    def lines(self) -> list[str]:
        """The margins in a line."""
        near = "nobody else on the scene"
        if self.clearance is not None:
            close = self.clearance
            near = (
                f"closest to {close.kind} {close.road_user}: {close.metres:.2f} m, "
                f"{close.seconds:.1f} s after the start"
            )
        return [
            f"goal reached {self.reached:.1f} s after the start, {self.spare:.1f} s before the "
            f"deadline; {near}; {self.road:.2f} m to the edge of the road at least"
        ]


def margins(drive: Drive, goal_step: int) -> Margins:
    """Measures what was left.

    Args:
        drive: A success.
        goal_step: The row's step at which the goal was reached.

    Returns:
        The margins.
    """
    shapes = shapely.polygons(rectangle_corners(drive.ego[:, :3], drive.vehicle.size))
    road_map = drive.scenario.road_map
    edge = shapely.union(road_map.drivable, road_map.open_ends).boundary
    spare = drive.scenario.task.final_step - goal_step
    return Margins(
        reached=drive.seconds(goal_step),
        spare=spare * drive.scenario.dt,
        clearance=_clearance(drive, shapes),
        road=float(shapely.distance(shapes, edge).min()),
    )


def _clearance(drive: Drive, shapes: npt.NDArray[np.object_]) -> Clearance | None:
    tracks = drive.tracks
    window = slice(drive.start, drive.start + len(shapes))
    users, steps = np.nonzero(tracks.valid[:, window])
    if not len(users):
        return None
    others = np.array(
        [
            shape_at(tracks, user, tracks.states[user, drive.start + step])
            for user, step in zip(users.tolist(), steps.tolist(), strict=True)
        ]
    )
    distances = shapely.distance(shapes[steps], others)
    closest = int(distances.argmin())
    user = int(users[closest])
    return Clearance(
        metres=float(distances[closest]),
        road_user=int(tracks.ids[user]),
        kind=tracks.kinds[user],
        seconds=drive.seconds(drive.start + int(steps[closest])),
    )
