"""The decision to pass what blocks the ego's lane, over the lane against it.

What stands on the road and never moves (a parked lorry, a construction site) and leaves no room in
the ego's own lane is passed on the side of the lane against it, while that is free for the time
that the ego needs, or waited for at a distance from which the ego can still swing out. A decision
to pass is kept until the ego is through; it is given up before the ego has left its lane, when
somebody comes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from dosplan.geometry import rectangle_corners
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    BoolArray,
    FloatArray,
    IntArray,
    Observation,
    Occupancy,
    Route,
)
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import PassingSettings
from dosplan_mpc.reference import EgoOnPath, LanePath

_ONCOMING: Final = -0.3  # Cosine of the angle to the path from which on somebody comes towards it.


@dataclass(frozen=True)
class Pass:
    """What blocks the lane, and the way round it.

    Attributes:
        users: (n,) rows of the observation that are passed.
        begin: Arc length at which the way round it begins, m.
        near: Arc length at which the blocked stretch begins, m.
        far: Arc length at which it ends, m.
        end: Arc length at which the way round it ends, m.
        offset: Lateral offset beside it, m.
        side: 1 where it is passed on the left, -1 on the right.
        waits_for: Id of the road user for whom the ego waits, or None where it goes.
    """

    users: IntArray
    begin: float
    near: float
    far: float
    end: float
    offset: float
    side: float
    waits_for: int | None = None

    def bent(self, arclength: FloatArray, offset: FloatArray) -> FloatArray:
        """Reference offsets that lead round the stretch.

        Args:
            arclength: (K,) m.
            offset: (K,) reference offsets without it, m.

        Returns:
            (K,) offsets, m: a smooth way aside before it, and back behind it.
        """
        rise = (arclength - self.begin) / max(self.near - self.begin, 1e-6)
        fall = (self.end - arclength) / max(self.end - self.far, 1e-6)
        part = np.clip(np.minimum(rise, fall), 0.0, 1.0)
        part = part**2 * (3.0 - 2.0 * part)
        return np.asarray(offset + part * (self.offset - offset))


@dataclass(frozen=True)
class _Stretch:
    """Part of the ego's lane that is blocked.

    Attributes:
        users: (n,) rows of the observation that block it.
        first: Arc length at which it begins, m.
        last: Arc length at which it ends, m.
        across: (n, 4) offsets of their corners from the path, m.
    """

    users: IntArray
    first: float
    last: float
    across: FloatArray


class PassingDecision:
    """Decides in every cycle of an episode."""

    def __init__(
        self,
        settings: PassingSettings,
        path: LanePath,
        route: Route,
        vehicle: VehicleParameters,
        half_width: float,
    ) -> None:
        """Begins an episode.

        Args:
            settings: How much room and time is wanted.
            path: Reference path, whose lanes against it are opened for a pass.
            route: The edges of all of the road beside it.
            vehicle: The ego.
            half_width: Distance that the ego's axis keeps from an edge, m.
        """
        self._settings = settings
        self._path = path
        self._route = route
        self._vehicle = vehicle
        self._half_width = half_width
        self._going: frozenset[int] = frozenset()
        self._stood: tuple[bytes, FloatArray, FloatArray] | None = None

    def decide(self, observation: Observation, occupancy: Occupancy, ego: EgoOnPath) -> Pass | None:
        """What the ego passes, or waits to pass, now.

        It opens the lane against the path where it passes.

        Args:
            observation: What is known now.
            occupancy: The sets of the road users, in the same order.
            ego: Where the ego is.

        Returns:
            The pass; None where nothing blocks the lane that can be passed.
        """
        found = self._blocked(observation, ego)
        if found is None:
            self._going = frozenset()
            self._path.close()
            return None
        names = frozenset(observation.ids[found.users].tolist())
        front = ego.position + 0.5 * self._vehicle.length
        committed = bool(names & self._going) and front > found.near - self._settings.commit
        comer = None if committed else self._who_comes(observation, occupancy, ego, found)
        if comer is not None:
            self._going = frozenset()
            self._path.close()
            return replace(found, waits_for=comer)
        self._going = names
        reach = self._vehicle.length
        self._path.open(found.begin - reach, found.end + reach, found.side)
        return found

    def _blocked(self, observation: Observation, ego: EgoOnPath) -> Pass | None:
        """The first stretch ahead that is blocked, if the lane against the path leads round it.

        A stretch that is being passed is the first one until the ego is back on its own lane.
        """
        settings, vehicle = self._settings, self._vehicle
        margin = 0.5 * vehicle.length
        way = max(settings.shortest_way, settings.seconds * ego.velocity)
        stretches = self._stretches(observation, ego.position - margin - way, ego.position)
        for i, stretch in enumerate(stretches):
            back = way
            if i + 1 < len(stretches):
                # Back so early that there is a way aside again before what blocks the lane next.
                room = stretches[i + 1].first - stretch.last - 2.0 * margin
                back = min(way, room - settings.shortest_way)
            far = stretch.last + margin
            going = not self._going.isdisjoint(observation.ids[stretch.users].tolist())
            if ego.position > (far + back if going else far):
                continue
            near = stretch.first - margin
            return self._round(stretch, begin=near - way, near=near, far=far, end=far + back)
        return None

    def _round(
        self, stretch: _Stretch, *, begin: float, near: float, far: float, end: float
    ) -> Pass | None:
        """The pass of a stretch on the side that has a lane against the path and room on it."""
        settings, half = self._settings, self._half_width
        for side in (1.0, -1.0):
            outer, own = self._edges(side, stretch.first, stretch.last)
            offset = float((side * stretch.across).max()) + settings.clearance + half
            if outer - own > settings.lane and offset + half <= outer:
                return Pass(stretch.users, begin, near, far, end, side * offset, side)
        return None

    def _stretches(self, observation: Observation, begin: float, ego: float) -> list[_Stretch]:
        """What blocks the ego's lane from an arc length on, in its order along the path.

        Those so close behind each other that the ego cannot go back in between are one.
        """
        settings = self._settings
        standing = np.flatnonzero(~observation.moves)
        if not len(standing):
            return []
        along, across = self._beside_path(
            rectangle_corners(observation.states[standing, -1, :3], observation.size[standing])
        )
        first, last = along.min(axis=1), along.max(axis=1)
        near = np.flatnonzero((last > begin) & (first < ego + settings.ahead))
        blocking = near[self._in_the_way(first[near], last[near], across[near])]
        apart = self._vehicle.length + 2.0 * settings.shortest_way
        groups: list[list[int]] = []
        far = -np.inf
        for row in blocking[np.argsort(first[blocking], kind="stable")].tolist():
            if first[row] - far > apart:
                groups.append([])
            groups[-1].append(row)
            far = max(far, last[row])
        return [
            _Stretch(
                users=standing[rows],
                first=float(first[rows].min()),
                last=float(last[rows].max()),
                across=across[rows],
            )
            for rows in groups
        ]

    def _beside_path(self, corners: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 4) arc lengths and offsets, m, of corners: the last ones, where they are the same."""
        key = corners.tobytes()
        if self._stood is None or self._stood[0] != key:
            along = self._path.locate(corners)
            self._stood = key, along, self._path.offset(corners, along)
        return self._stood[1:]

    def _in_the_way(self, first: FloatArray, last: FloatArray, across: FloatArray) -> BoolArray:
        """(n,) whether what stands there leaves no room for the ego in its own lane."""
        need = 2.0 * self._half_width + self._settings.clearance
        blocks = np.zeros(len(first), dtype=np.bool_)
        for i, (begin, end) in enumerate(zip(first, last, strict=True)):
            left, right = (self._edges(side, begin, end)[1] for side in (1.0, -1.0))
            low, high = float(across[i].min()), float(across[i].max())
            on_lane = high > -right and low < left
            blocks[i] = on_lane and left - high < need and low + right < need
        return blocks

    def _edges(self, side: float, begin: float, end: float) -> tuple[float, float]:
        """Distance of the road's edge and of the own lane's, m, to one side of a stretch."""
        route = self._route
        inside = (route.arclength >= begin - 1.0) & (route.arclength <= end + 1.0)
        if not inside.any():
            return 0.0, 0.0
        outer, own = (
            (route.outer_left, route.left) if side > 0.0 else (-route.outer_right, -route.right)
        )
        return float(outer[inside].min()), float(own[inside].min())

    def _who_comes(
        self, observation: Observation, occupancy: Occupancy, ego: EgoOnPath, found: Pass
    ) -> int | None:
        """Id of somebody who would meet the ego beside the stretch, or None.

        The ego needs the time to drive to its end; until then, and some more, nobody may reach it.
        """
        settings = self._settings
        now = observation.present
        along = self._path.locate(now[:, :2], ego.position)
        across = self._path.offset(now[:, :2], along)
        turn = now[:, USER_HEADING] - self._path.heading_at(along)
        comes = observation.moves & (np.cos(turn) < _ONCOMING)
        comes &= (along > ego.position) & (np.abs(across) < settings.beside)
        if not comes.any():
            return None
        way = found.end - ego.position
        speed = max(ego.velocity, settings.speed)
        seconds = way / speed + settings.reserve
        # The quickest of what a set allows: its far end at the horizon.
        sets, rows, _ = occupancy.by_component()
        t = sets.horizon - 1
        far = np.where(sets.valid[:, t, None], sets.centre[:, t], now[rows, :2])
        reach = self._path.locate(far, ego.position) - sets.semi_axes[:, t].max(axis=-1)
        ahead = (t + 1) * observation.dt
        allowed = np.where(sets.valid[:, t], (along[rows] - reach) / ahead, -np.inf)
        fastest = np.array(now[:, USER_VELOCITY])
        np.maximum.at(fastest, rows, allowed)
        until = along - 0.5 * observation.size[:, 0] - fastest * seconds
        meets = comes & (until < found.end)
        return int(observation.ids[np.argmax(meets)]) if meets.any() else None
