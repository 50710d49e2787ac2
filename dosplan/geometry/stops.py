"""Where the ego has to stop now: red lights, stop signs, giving way, crosswalks.

``Route.stops`` names the places at which a rule may ask for a stop; ``StopRules`` decides at every
step which of them does. It is what the built-in planners keep, and any planner may use it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import shapely

from dosplan.geometry.ellipse import set_sizes
from dosplan.geometry.path import ReferencePath
from dosplan.geometry.plane import rectangle_corners
from dosplan.types import (
    EGO_VELOCITY,
    USER_HEADING,
    USER_VELOCITY,
    BoolArray,
    FloatArray,
    IntArray,
    LightColour,
    Observation,
    Occupancy,
    PlanningTask,
    RoadUserKind,
    RouteStop,
    StopCause,
)
from dosplan.types.checks import check_numbers

_ALIGNED: Final = 0.7  # Cosine of the angle to the path up to which somebody drives along it.
_IN_LANE: Final = 1.75  # Distance from the path within which somebody is in the ego's lane, m.
_LOOK_BEYOND: Final = 20.0  # A place matters this far beyond the ego's braking distance, m.
_LEAST_WAY: Final = 0.1  # m; keeps the braking that a line asks for finite.


@dataclass(frozen=True)
class StopSettings:
    """When the ego stops, and how.

    Attributes:
        margin: How far before the line the ego's front comes to stand, m. Once it stops for a line,
            it is not past it until it is over it by as much.
        comfortable: Braking up to which it stops at a yellow light, m/s2.
        hardest: Braking up to which it stops at all, m/s2; where a line asks for more, it is too
            late, and the ego drives on rather than to stand in the crossing.
        standing: Velocity up to which somebody stands, m/s.
        stand_within: The ego has stopped at a stop sign where it stands with its front this near to
            the line, m.
        pull_away: Acceleration with which the ego is taken to drive through, m/s2.
        through: Velocity, m/s, up to which it is taken to accelerate, where it is not faster.
        before: The way of others has to be free for this long before the ego is on it, s.
        after: And for this long after it has left it, s.
        settle: Once the ego waits, both are longer by this, so that it does not waver, s.
        stepping: Time within which somebody on foot steps on a crosswalk that counts as before
            it, s.
        side: Distance beside the ego that it leaves to somebody on a crosswalk, m.
        courtesy: Somebody on a crosswalk goes first who comes up to this long after the ego, s.
        kerb: Who stands this near to a crosswalk without lights waits to cross, m.
        patience: For who only stands there the ego waits for this long, s.
    """

    margin: float = 0.5
    comfortable: float = 3.0
    hardest: float = 8.0
    standing: float = 0.3
    stand_within: float = 2.5
    pull_away: float = 2.0
    through: float = 8.0
    before: float = 0.5
    after: float = 0.5
    settle: float = 0.5
    stepping: float = 1.5
    side: float = 0.5
    courtesy: float = 1.5
    kerb: float = 1.0
    patience: float = 2.0

    def __post_init__(self) -> None:
        check_numbers(self, positive={"comfortable", "hardest", "pull_away", "through"})


@dataclass(frozen=True)
class Wait:
    """A line that the ego must not pass now.

    Attributes:
        cause: Why.
        line: Arc length of the line along the route's path, m.
        place: Arc length at which the ego's front should come to stand, m.
        reason: The same in words: ``light 31``, ``stop sign``, ``give way to 12``,
            ``crosswalk, for 12``.
    """

    cause: StopCause
    line: float
    place: float
    reason: str


@dataclass(frozen=True)
class _Place:
    """A stop of the route, with what does not change during an episode.

    Attributes:
        stop: The stop.
        begin: Arc length at which its area begins, m.
        end: Arc length at which it ends, m.
        strip: The part of a crosswalk that the ego drives over, m.
    """

    stop: RouteStop
    begin: float
    end: float
    strip: shapely.Geometry

    @classmethod
    def of(cls, stop: RouteStop, path: ReferencePath, corridor: float) -> Self:
        """Looks where the area of a stop is.

        Args:
            stop: The stop.
            path: The route's path.
            corridor: Half of the width that the ego drives over, m.
        """
        corners = shapely.get_coordinates(stop.conflict)
        along = path.locate(corners) if len(corners) else np.array([stop.arclength, stop.until])
        over = path.points[(path.arclength >= along.min()) & (path.arclength <= along.max())]
        strip = stop.conflict
        if stop.cause is StopCause.CROSSWALK and len(over) > 1:
            lane = shapely.LineString(over).buffer(corridor, cap_style="square")
            strip = shapely.intersection(stop.conflict, lane)
        return cls(stop, float(along.min()), float(along.max()), strip)


@dataclass(frozen=True)
class _Scene:
    """What one decision is made from.

    Attributes:
        observation: What is known now.
        occupancy: The sets of the road users.
        front: Arc length of the ego's front, m.
        velocity: Velocity of the ego, m/s.
    """

    observation: Observation
    occupancy: Occupancy
    front: float
    velocity: float


@dataclass(frozen=True)
class _Forecast:
    """Where the road users are now (column 0) and at the next steps.

    Attributes:
        corners: (R, S, 4, 2) corners of the rectangles that hold them, one for each component of
            a set, m.
        valid: (R, S) whether they are there.
        rows: (R,) rows of the N road users.
        count: Their number N.
    """

    corners: FloatArray
    valid: BoolArray
    rows: IntArray
    count: int

    @classmethod
    def of(cls, scene: _Scene, steps: int) -> Self:
        """Looks ahead; beyond the horizon of the sets they move on as they moved last.

        Args:
            scene: The present.
            steps: Number of steps.
        """
        observation = scene.observation
        sets, rows, _ = scene.occupancy.by_component()
        known, now = min(steps, sets.horizon), observation.present[rows]
        centre = np.concatenate([now[:, None, :2], sets.centre[:, :known]], axis=1)
        heading = np.concatenate([now[:, None, USER_HEADING], sets.heading[:, :known]], axis=1)
        size = np.concatenate([observation.size[rows, None], set_sizes(sets, known)], axis=1)
        valid = np.concatenate([observation.valid[rows, -1:], sets.valid[:, :known]], axis=1)
        if steps > known:
            later = np.arange(1, steps - known + 1)[:, None]
            moved = centre[:, -1:] + later * (centre[:, -1:] - centre[:, -2:-1])
            centre = np.concatenate([centre, moved], axis=1)
            heading, size, valid = (
                np.concatenate([part, np.repeat(part[:, -1:], steps - known, axis=1)], axis=1)
                for part in (heading, size, valid)
            )
        poses = np.concatenate([centre, heading[..., None]], axis=-1)
        corners = rectangle_corners(np.where(valid[..., None], poses, 0.0), size)
        return cls(corners, valid, rows, len(observation.ids))

    def meets(self, area: shapely.Geometry, first: int, last: int) -> BoolArray:
        """(N,) whether a road user is in an area at any of the steps ``first .. last``."""
        corners, valid = self.corners[:, first : last + 1], self.valid[:, first : last + 1]
        found = np.zeros(self.count, dtype=np.bool_)
        if area.is_empty or corners.size == 0:
            return found
        west, south, east, north = area.bounds
        low, high = corners.min(axis=-2), corners.max(axis=-2)
        near = valid & (low <= [east, north]).all(axis=-1) & (high >= [west, south]).all(axis=-1)
        meets = np.zeros(near.shape, dtype=np.bool_)
        meets[near] = shapely.intersects(area, shapely.polygons(corners[near]))
        found[self.rows[meets.any(axis=1)]] = True
        return found


class StopRules:
    """Decides in every cycle of an episode whether, and where, the ego has to stop.

    - **Light**: red, or red with yellow: stop. Yellow: stop where comfortable braking is enough,
      and go on otherwise. Green: go. A light that is not lit rules nothing; the signs do.
    - **Stop sign**: stand once, just before the line; then as giving way.
    - **Giving way**: stop while somebody's set meets the others' way in the time in which the ego
      would be on it.
    - **Crosswalk**: stop for who is on it, or about to step on it, and in whose way the ego would
      be; and, where no light is lit, for who stands at its edge, until the ego has stood.

    Lights that are lit overrule signs. A line that the ego's front has passed, and one before which
    it cannot stop any more, do not count. Who drives in the ego's own lane is no cause: it is a
    leader or a follower. Who stands does not come.

    Sets are those of the occupancy; beyond its horizon, they move on as they moved last.
    """

    def __init__(self, task: PlanningTask, settings: StopSettings = StopSettings()) -> None:
        """Begins an episode.

        Args:
            task: The route with its stops, and the ego.
            settings: When it stops.
        """
        self._settings = settings
        self._length = task.vehicle.length
        self._path = ReferencePath.of(task.route)
        corridor = 0.5 * task.vehicle.width + settings.side
        self._places = [_Place.of(stop, self._path, corridor) for stop in task.route.stops]
        self._stood: dict[int, int] = {}
        self._waiting: float | None = None  # The line that the ego waits for.

    def wait(self, observation: Observation, occupancy: Occupancy, front: float) -> Wait | None:
        """The first line before which the ego has to stop now.

        It is to be asked once in each cycle, in the order of the steps: it keeps in mind before
        which lines the ego has stood.

        Args:
            observation: What is known now.
            occupancy: The sets of the road users of ``observation``, in the same order.
            front: Arc length of the ego's front along the route's path, m.

        Returns:
            The line, or None where nothing asks for a stop.
        """
        settings = self._settings
        scene = _Scene(observation, occupancy, front, float(observation.ego[EGO_VELOCITY]))
        for number, place in enumerate(self._places):
            way = place.stop.arclength - front
            over = settings.margin if place.stop.arclength == self._waiting else 0.0
            if way + over < 0.0:
                continue
            if scene.velocity <= settings.standing and way <= settings.stand_within:
                self._stood.setdefault(number, observation.step)
            braking = scene.velocity**2 / (2.0 * max(way + over, _LEAST_WAY))
            if braking > settings.hardest:
                continue
            reason = self._reason(number, scene, braking)
            if reason is not None:
                self._waiting = line = place.stop.arclength
                return Wait(place.stop.cause, line, line - settings.margin, reason)
        self._waiting = None
        return None

    def _reason(self, number: int, scene: _Scene, braking: float) -> str | None:
        """Why the ego has to stop at a place, if it has to."""
        stop, lights = self._places[number].stop, scene.observation.lights
        shown = lights.shown(stop.lights)
        if stop.cause is StopCause.LIGHT:
            gently = braking <= self._settings.comfortable or stop.arclength == self._waiting
            if not (shown.forbids or (shown is LightColour.YELLOW and gently)):
                return None
            return f"light {next(i for i in stop.lights if lights.colour(i) is shown)}"
        lit = shown is not LightColour.INACTIVE
        if stop.cause is not StopCause.CROSSWALK and lit:
            return None
        if stop.cause is StopCause.STOP_SIGN and number not in self._stood:
            return "stop sign"
        braking_way = scene.velocity**2 / (2.0 * self._settings.comfortable)
        far = stop.arclength - scene.front > braking_way + _LOOK_BEYOND
        if far or stop.conflict.is_empty or len(scene.observation.ids) == 0:
            return None
        if stop.cause is StopCause.CROSSWALK:
            user = self._on_crosswalk(number, scene, lit)
            return None if user is None else f"crosswalk, for {user}"
        user = self._with_priority(number, scene)
        return None if user is None else f"give way to {user}"

    def _with_priority(self, number: int, scene: _Scene) -> int | None:
        """Id of a road user whose way the ego would be in, or None."""
        stop, settings = self._places[number].stop, self._settings
        first, last = self._steps(number, scene, settings.after)
        users = scene.observation.moves & ~self._in_own_lane(scene, stop)
        forecast = _Forecast.of(scene, last)
        return _first(scene, users & self._comes(scene, forecast, stop.conflict, first, last))

    def _on_crosswalk(self, number: int, scene: _Scene, lit: bool) -> int | None:
        """Id of somebody to whom the ego gives way at a crosswalk, or None."""
        place, settings = self._places[number], self._settings
        observation, crosswalk = scene.observation, place.stop.conflict
        on_foot = self._on_foot(observation)
        if not on_foot.any():
            return None
        first, last = self._steps(number, scene, settings.courtesy)
        soon = round(settings.stepping / observation.dt)
        forecast = _Forecast.of(scene, max(last, soon))
        crosses = forecast.meets(crosswalk, 0, soon)
        crosses &= self._comes(scene, forecast, place.strip, first, last)
        since = self._stood.get(number, observation.step)
        if not lit and (observation.step - since) * observation.dt < settings.patience:
            at_edge = forecast.meets(crosswalk.buffer(settings.kerb), 0, 0)
            crosses |= at_edge & self._stands(observation)
        return _first(scene, on_foot & crosses)

    def _steps(self, number: int, scene: _Scene, after: float) -> tuple[int, int]:
        """First and last step from now at which others have to be away from a place."""
        place, settings = self._places[number], self._settings
        longer = settings.settle if place.stop.arclength == self._waiting else 0.0
        enters = self._time(place.begin - scene.front, scene.velocity)
        leaves = self._time(place.end - scene.front + self._length, scene.velocity)
        dt = scene.observation.dt
        first = int(np.floor((enters - settings.before - longer) / dt))
        return max(first, 0), int(np.ceil((leaves + after + longer) / dt))

    def _time(self, way: float, velocity: float) -> float:
        """Time for a way, s: the ego pulls away up to a velocity and holds it."""
        if way <= 0.0:
            return 0.0
        rate, most = self._settings.pull_away, max(self._settings.through, velocity)
        run_up = (most**2 - velocity**2) / (2.0 * rate)
        if way <= run_up:
            return float(np.sqrt(velocity**2 + 2.0 * rate * way) - velocity) / rate
        return (most - velocity) / rate + (way - run_up) / most

    def _comes(
        self, scene: _Scene, forecast: _Forecast, area: shapely.Geometry, first: int, last: int
    ) -> BoolArray:
        """(N,) whether a road user is in an area at those steps; who stands, if it is there now."""
        stands = self._stands(scene.observation)
        there = forecast.meets(area, first, last)
        return np.where(stands, forecast.meets(area, 0, 0), there)

    def _stands(self, observation: Observation) -> BoolArray:
        speed = np.abs(observation.states[:, -1, USER_VELOCITY])
        return np.asarray(speed <= self._settings.standing)

    def _in_own_lane(self, scene: _Scene, stop: RouteStop) -> BoolArray:
        """(N,) whether a road user drives along the path, not beyond the place of a stop."""
        now = scene.observation.present
        along = self._path.locate(now[:, :2], scene.front)
        turn = now[:, USER_HEADING] - self._path.heading_at(along)
        beside = np.abs(self._path.offset(now[:, :2], along)) < _IN_LANE
        return np.asarray(beside & (np.cos(turn) > _ALIGNED) & (along < stop.until))

    def _on_foot(self, observation: Observation) -> BoolArray:
        """(N,) whether somebody may cross on a crosswalk; a bicycle along the road does not."""
        now = observation.present
        turn = now[:, USER_HEADING] - self._path.heading_at(self._path.locate(now[:, :2]))
        across = np.abs(np.cos(turn)) < _ALIGNED
        kinds = observation.kinds
        walks = np.array([kind is RoadUserKind.PEDESTRIAN for kind in kinds], dtype=np.bool_)
        rides = np.array([kind is RoadUserKind.BICYCLE for kind in kinds], dtype=np.bool_)
        return np.asarray(walks | (rides & across))


def _first(scene: _Scene, chosen: BoolArray) -> int | None:
    """Id of the first road user that is chosen, or None."""
    return int(scene.observation.ids[np.argmax(chosen)]) if chosen.any() else None
