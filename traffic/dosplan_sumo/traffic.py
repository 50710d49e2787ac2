"""``sumo-v1``: road users whom SUMO drives around the ego.

Until the ego starts, all is as the scenario's file says. SUMO is driven up to that moment, from the
files beside the scenario. Where it has come to the same scene, as it does where it recorded the
scenario itself, it goes on from it; otherwise the road users of the file are put where the file has
them. From then on the ego is moved in SUMO as it drives, and the others react to it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from dosplan.scenario import ScenarioError
from dosplan.scenario.sources.sumo import ACTS, SumoFiles, configuration_of, read_configuration
from dosplan.simulation.traffic import Replay, RoadUsers, Traffic
from dosplan.types import (
    EGO_VELOCITY,
    USER_HEADING,
    USER_SIZE,
    USER_VELOCITY,
    FloatArray,
    LightStates,
    RoadUserKind,
    Scenario,
    Tracks,
)
from dosplan.types.checks import check_numbers
from dosplan_sumo.acts import Acts, acts_file, read_acts
from dosplan_sumo.demand import Demand, read_demand, read_offset, write_demand
from dosplan_sumo.drivers import Drivers
from dosplan_sumo.lanes import Lanes
from dosplan_sumo.lights import Lights
from dosplan_sumo.scene import CLASS_OF, User, angle_of, front_of, kind_of, users
from dosplan_sumo.script import Executor
from dosplan_sumo.simulator import Simulation, SumoError, library

EGO: Final = "dosplan-ego"
"""Name of the ego in SUMO, where none of its vehicles stands for it."""
SAME_PLACE: Final = 1.0
"""Farthest that SUMO's road users are from those of the file where both are the same scene, m.

The suite's generator smooths what SUMO drives: by up to 0.4 m, and pedestrians, who leap sideways,
by more. The bodies of its vehicles follow their front wheels, which SUMO's do not in a bend.
"""
SAME_PLACE_PER_METRE: Final = 0.1
"""What is added to that for each metre of length, m."""
SAME_SIZE: Final = 0.02
"""Largest difference of their sizes, m."""
FADING_STEPS: Final = 20
"""Steps after which that difference of places has faded away."""
LONGEST_PAST: Final = 3600.0
"""Longest that SUMO is driven until the ego starts, s."""
LONGEST_SEARCH: Final = 600.0
"""Longest that SUMO is driven to find that moment, s."""
NEAREST: Final = 20.0
"""Nobody whom the file does not know is this near to the ego's start, m."""
SLIDING: Final = 1.0
"""Speed beyond its own at which somebody comes to where SUMO has it, m/s.

In SUMO pedestrians leap sideways, and so do vehicles where a lane ends on which they are not in the
middle, by a metre and more.
"""
SIDEWAYS: Final = 2.0
"""The same of vehicles across their heading, m/s."""
SIDEWAYS_PER_SPEED: Final = 0.2
"""What is added to that for each m/s of speed: the heading is that of the lane at two places."""
STANDING: Final = 0.1
"""Velocity up to which somebody stands, m/s."""
_EXACT: Final = 1e-3
"""Largest distance, m, between where somebody is put in SUMO and where they are then."""


@dataclass(frozen=True)
class SumoSettings:
    """The options of traffic that SUMO drives.

    Attributes:
        sight: Who has not been as near to the ego as this, and is not in the scenario's file, is
            not told of, m. Networks are larger than what a car sees.
    """

    sight: float = 150.0

    def __post_init__(self) -> None:
        check_numbers(self, positive={"sight"})


@dataclass(frozen=True)
class _Known:
    """What does not change of a road user.

    Attributes:
        id: Id that it is handed over with.
        kind: Its kind.
        size: Length and width, m.
        shift: (4,) difference of the file's state from SUMO's when the ego started.
        outline: (V, 2) polygon in the body frame, m, where the file gives it another shape than
            the rectangle of ``size``.
    """

    id: int
    kind: RoadUserKind
    size: tuple[float, float]
    shift: FloatArray
    outline: FloatArray | None = None


class SumoTraffic(Traffic):
    """All others are driven by SUMO and see the ego."""

    name = "sumo-v1"
    settings = SumoSettings
    has_futures = True

    def __init__(
        self, *, seed: int = 0, settings: SumoSettings = SumoSettings(), future: int = 0
    ) -> None:
        """Makes it; SUMO starts with an episode.

        Args:
            seed: Seed of the run.
            settings: The options.
            future: Which continuation is driven, see ``dosplan_sumo.drivers``.

        Raises:
            SumoError: SUMO is not installed.
        """
        super().__init__(seed=seed, settings=settings, future=future)
        library()
        self._sight = settings.sight
        self._simulation: Simulation | None = None
        self._folder: TemporaryDirectory[str] | None = None

    @classmethod
    def refuses(cls, scenario: Scenario) -> str | None:
        """Tells why a scenario cannot be driven.

        Args:
            scenario: The scenario.

        Returns:
            What is missing or broken of SUMO's files; None where nothing is.
        """
        if scenario.sumo is None:
            return (
                f"has no files of SUMO beside it; put {scenario.benchmark_id}.sumo.cfg there and "
                "what it names, or choose another traffic"
            )
        try:
            files = read_configuration(scenario.sumo)
            read_offset(files.net)
            read_demand(files)
            _acts_of(scenario, scenario.sumo)
        except ScenarioError as error:
            return f"cannot be driven by SUMO: {error}"
        return None

    @classmethod
    def reads(cls, scenario: Path) -> Iterable[Path]:
        """Names the files of SUMO.

        Args:
            scenario: The scenario file.

        Returns:
            The files; none where they cannot be used.
        """
        configuration = configuration_of(scenario)
        with suppress(ScenarioError):
            if configuration is not None:
                files, acts = read_configuration(configuration).all, acts_file(configuration)
                return files if acts is None else (*files, acts)
        return ()

    @classmethod
    def versions(cls) -> Mapping[str, str]:
        """Names the version of SUMO, which decides how its road users drive.

        Returns:
            The version; none where it is not installed.
        """
        with suppress(PackageNotFoundError):
            return {"libsumo": version("libsumo")}
        return {}

    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        """Drives SUMO up to the ego's start.

        Args:
            scenario: What is driven.
            first_step: Step at which the ego starts.

        Returns:
            What the file tells of the time until then, and who else is near in SUMO.

        Raises:
            ScenarioError: A file of SUMO cannot be used.
            SumoError: SUMO cannot go on, or does not take the scene as it is.
        """
        self.close()
        if scenario.sumo is None:
            raise SumoError(f"{scenario.id} {self.refuses(scenario)}")
        self._scenario, self._first_step = scenario, first_step
        files = read_configuration(scenario.sumo)
        net_offset = read_offset(files.net)
        self._folder = TemporaryDirectory(prefix="dosplan-sumo-")
        self._demand = write_demand(read_demand(files), Path(self._folder.name))
        self._acts = _acts_of(scenario, scenario.sumo)
        self._drivers = Drivers(self.seed, scenario.benchmark_id, self.future)
        self._known: dict[str, _Known] = {}
        self._others: list[tuple[_Known, FloatArray]] = []
        self._seen: set[str] = set()
        self._before: dict[int, FloatArray] = {}
        self._put: dict[str, FloatArray] = {}
        recording = scenario.tracks
        self._free_id: int = max([0, *recording.ids.tolist()]) + 1
        self._number: dict[str, int] = {name: i for i, name in enumerate(self._demand.users)}
        vehicle = scenario.task.vehicle
        self._centre = vehicle.centre(scenario.task.start)

        start, ego = self._begins(files, net_offset)
        past = Replay().begin(scenario, first_step)
        present = np.flatnonzero(past.valid[:, -1])
        self._drive_until(start, files, net_offset, ego)
        self._start_ego()
        if self._recognised(past, present):
            if self._acts is not None:
                futures = self._acts.futures
                script = futures[self.future % len(futures)].script
                self._executor.play(script, self._acts.branch)
                if self.future < len(futures):
                    # Who acts a script is driven as it was when the future was recorded.
                    self._drivers = Drivers(self.seed, scenario.benchmark_id, 0)
        else:
            self._running.close()  # For the step in which the file's scene is made.
            self._drive_until(start, files, net_offset, ego)
            self._rebuild(past, present)
        sumo = self._running.sumo
        for user in users(sumo, self._ego, self._offset):
            self._draw(sumo, user.name, user.walks)
        self._lights = Lights(sumo, self._lanes, scenario, self._offset, first_step)
        past = self._with_more(past)
        for row in np.flatnonzero(past.valid[:, -1]):
            self._before[int(past.ids[row])] = past.states[row, -1, :2]
        return past

    def _drive_until(
        self, start: float, files: SumoFiles, net_offset: FloatArray, ego: str
    ) -> None:
        """Drives a new simulation up to the step before the ego's start."""
        simulation = self._simulation = self._started(files)
        sumo = simulation.sumo
        self._executor = Executor(sumo)
        if self._acts is not None:
            self._executor.play(self._acts.prelude, self._acts.appearance)
        while simulation.time < start - 1.5 * self._scenario.dt:
            self._advance(simulation)
        self._lanes = Lanes(sumo)
        self._offset = self._lanes.offset(self._scenario.road_map, net_offset)
        self._ego = ego if ego in sumo.vehicle.getIDList() else EGO
        if self._ego != EGO:
            self._prepare_ego(sumo)

    def _start_ego(self) -> None:
        """Drives the step at whose end the ego is at its start."""
        simulation, start = self._running, self._scenario.task.start
        self._put_ego(simulation.sumo, start)
        self._advance(simulation)
        self._settle_ego(simulation.sumo, start)

    def _advance(self, simulation: Simulation) -> None:
        """Drives a step, in which the cast does what it is told."""
        with simulation.failures():
            self._executor.step(simulation.time, self._scenario.dt)
        simulation.step()

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        """Drives SUMO a step, in which nobody knows yet where the ego goes.

        Args:
            step: The step that is reached.
            ego: Ego states until then.

        Returns:
            The road users on the scene.

        Raises:
            SumoError: SUMO cannot go on, or does not take the ego where it is.
        """
        simulation = self._simulation
        if simulation is None:
            raise SumoError("no episode has begun")
        sumo = simulation.sumo
        self._centre = self._scenario.task.vehicle.centre(ego[-1])
        self._put_ego(sumo, ego[-1])
        self._advance(simulation)
        self._settle_ego(sumo, ego[-1])
        with simulation.failures():
            for name in sumo.simulation.getDepartedIDList():
                self._draw(sumo, name, False)
            for name in sumo.simulation.getDepartedPersonIDList():
                self._draw(sumo, name, True)
            found = self._near(sumo)
        elapsed = step - self._first_step
        weight = max(0.0, 1.0 - elapsed / FADING_STEPS)
        rows = []
        for user in found:
            if (put := self._put.pop(user.name, None)) is not None:
                # What SUMO made of it on its lane, beside where it would be by its own speed.
                way = user.state[USER_VELOCITY] * self._scenario.dt
                shift = _difference(_along(put, way), user.state)
                shift[USER_VELOCITY] = 0.0
                self._known[user.name] = replace(self._known[user.name], shift=shift)
            known = self._known[user.name]
            state = user.state + weight * known.shift
            state[USER_VELOCITY] = self._executor.led.get(user.name, state[USER_VELOCITY])
            state[:2] = self._slid(known.id, state, user.walks)
            rows.append((known, state))
        for known, state in self._others:
            rows.append((known, _along(state, state[USER_VELOCITY] * elapsed * self._scenario.dt)))
        return RoadUsers(
            ids=np.array([known.id for known, _ in rows], dtype=np.int64),
            kinds=tuple(known.kind for known, _ in rows),
            size=np.reshape([known.size for known, _ in rows], (-1, 2)),
            states=np.reshape([state for _, state in rows], (-1, USER_SIZE)),
            outlines=tuple(known.outline for known, _ in rows),
        )

    def lights(self, step: int) -> LightStates | None:
        """Tells what SUMO's lights show.

        Args:
            step: The present step.

        Returns:
            The states of the map's lights; None where SUMO has none of them.
        """
        return self._lights.at(step)

    def close(self) -> None:
        """Ends SUMO, so that another simulation can run in this process."""
        if self._simulation is not None:
            self._simulation.close()
            self._simulation = None
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _started(self, files: SumoFiles) -> Simulation:
        """SUMO before its first step."""
        key = f"{self.seed} {self._scenario.benchmark_id}"
        seed = int.from_bytes(sha256(key.encode()).digest()[:4], "big") >> 1
        if self._folder is None:
            raise SumoError("no episode has begun")
        return Simulation(
            files.net,
            self._demand.files,
            self._scenario.dt,
            {"seed": str(seed), **files.options},
            Path(self._folder.name),
        )

    def _begins(self, files: SumoFiles, net_offset: FloatArray) -> tuple[float, str]:
        """SUMO's time at which the ego starts, s, and the vehicle that stands for it."""
        egos = self._demand.egos
        if self._demand.start is not None:
            if self._demand.start > LONGEST_PAST:
                raise SumoError(f"the ego starts after {LONGEST_PAST:g} s; cut the demand short")
            return self._demand.start, egos[0]
        begin = float(files.options.get("begin", "0"))
        if not egos:
            return begin, ""
        simulation = self._simulation = self._started(files)
        offset = Lanes(simulation.sumo).offset(self._scenario.road_map, net_offset)
        pose = self._scenario.task.vehicle.poses(self._scenario.task.start[None])[0]
        place = front_of(pose[:2] + offset, pose[2], self._scenario.task.vehicle.length)
        best = (np.inf, begin, egos[0])
        with simulation.failures():
            while simulation.time < begin + LONGEST_SEARCH:
                simulation.step()
                there = set(simulation.sumo.vehicle.getIDList())
                away = np.inf
                for name in egos:
                    if name in there:
                        gap = np.array(simulation.sumo.vehicle.getPosition(name)) - place
                        away = min(away, float(np.hypot(*gap)))
                        best = min(best, (float(np.hypot(*gap)), simulation.time, name))
                if best[0] < np.inf and away > best[0] + 2.0 * NEAREST:
                    break
        simulation.close()
        self._simulation = None
        return best[1], best[2]

    def _prepare_ego(self, sumo: Any) -> None:
        """Makes a vehicle of SUMO the ego's: of its size, and driven by nobody else."""
        vehicle = self._scenario.task.vehicle
        sumo.vehicle.setLength(self._ego, vehicle.length)
        sumo.vehicle.setWidth(self._ego, vehicle.width)
        sumo.vehicle.setSpeedMode(self._ego, 0)
        sumo.vehicle.setLaneChangeMode(self._ego, 0)

    def _put_ego(self, sumo: Any, state: FloatArray) -> None:
        """Has SUMO put the ego into its exact pose in the coming step."""
        vehicle = self._scenario.task.vehicle
        x, y, heading = vehicle.poses(state[None])[0]
        front = front_of(np.array([x, y]) + self._offset, heading, vehicle.length)
        with self._running.failures():
            if self._ego not in sumo.vehicle.getIDList():  # Not yet, or it has left a road's end.
                self._add(sumo, self._ego, front, heading, "passenger", vehicle.size)
                self._prepare_ego(sumo)
            sumo.vehicle.moveToXY(self._ego, "", -1, *front, angle_of(heading), keepRoute=2)

    def _settle_ego(self, sumo: Any, state: FloatArray) -> None:
        """Sees to it that SUMO's vehicles see the ego as it is."""
        vehicle = self._scenario.task.vehicle
        x, y, heading = vehicle.poses(state[None])[0]
        front = front_of(np.array([x, y]) + self._offset, heading, vehicle.length)
        with self._running.failures():
            if self._ego not in sumo.vehicle.getIDList():
                return  # Beyond the end of a road; it is put back in the next step.
            sumo.vehicle.setPreviousSpeed(self._ego, float(state[EGO_VELOCITY]))
            if not _at(sumo, self._ego, front):
                raise SumoError("SUMO does not take the ego where it is")

    @property
    def _running(self) -> Simulation:
        if self._simulation is None:
            raise SumoError("no episode has begun")
        return self._simulation

    def _add(
        self,
        sumo: Any,
        name: str,
        front: FloatArray,
        heading: float,
        sumo_class: str,
        size: tuple[float, float],
    ) -> bool:
        """Adds a vehicle; tells whether there is a lane for it."""
        lane = self._lanes.at(front, heading)
        if lane is None and name != self._ego:
            return False
        demand: Demand = self._demand
        if lane is None:
            edges = demand.routes[0] if demand.routes else (sumo.edge.getIDList()[0],)
        else:
            edges = self._lanes.way_from(lane, sumo, demand.routes, demand.ends)
        number = sum(1 for route in sumo.route.getIDList() if route.startswith(name))
        route, kind = f"{name}-{number}", f"{name}-type"
        sumo.route.add(route, edges)
        if kind not in sumo.vehicletype.getIDList():
            sumo.vehicletype.copy(demand.types.get(sumo_class, "DEFAULT_VEHTYPE"), kind)
            sumo.vehicletype.setVehicleClass(kind, sumo_class)
            sumo.vehicletype.setLength(kind, size[0])
            sumo.vehicletype.setWidth(kind, size[1])
        sumo.vehicle.add(name, route, typeID=kind, depart="now")
        return True

    def _recognised(self, past: Tracks, present: Iterable[int]) -> bool:
        """Whether SUMO shows the file's scene; if so, who is who is kept."""
        sumo = self._running.sumo
        left = list(users(sumo, self._ego, self._offset))
        sizes = np.reshape([_size(sumo, user) for user in left], (-1, 2))
        fronts = np.reshape(
            [_front(user.state, size) for user, size in zip(left, sizes, strict=True)], (-1, 2)
        )
        found: dict[str, _Known] = {}
        for row in present:
            state, kind = past.states[row, -1], past.kinds[row]
            gaps = np.hypot(*(fronts - _front(state, past.size[row])).T)
            gaps[np.abs(sizes - past.size[row]).max(axis=1) > SAME_SIZE] = np.inf
            nearest = int(np.argmin(gaps)) if len(gaps) else -1
            reach = SAME_PLACE + SAME_PLACE_PER_METRE * past.size[row, 0]
            if nearest >= 0 and gaps[nearest] < reach and left[nearest].name not in found:
                shift = _difference(state, left[nearest].state)
                found[left[nearest].name] = replace(_of(past, row), shift=shift)
            elif kind is RoadUserKind.STATIC:
                self._others.append((_of(past, row), state))
            else:
                self._others = []
                return False
        self._known = found
        self._seen = set(found)
        return True

    def _rebuild(self, past: Tracks, present: Iterable[int]) -> None:
        """Puts the file's road users into SUMO, instead of those who are near in it."""
        simulation = self._running
        sumo = simulation.sumo
        away = np.hypot(*(past.states[list(present), -1, :2] - self._centre).T)
        radius = max(NEAREST, *away.tolist())
        with simulation.failures():
            for user in users(sumo, self._ego, self._offset):
                if np.hypot(*(user.state[:2] - self._centre)) <= radius:
                    (sumo.person if user.walks else sumo.vehicle).remove(user.name)
            placed = [row for row in present if self._place(sumo, past, row)]
        self._start_ego()
        with simulation.failures():
            for row in placed:
                name, state = f"cr-{past.ids[row]}", past.states[row, -1]
                front = front_of(state[:2] + self._offset, state[USER_HEADING], past.size[row, 0])
                if name not in sumo.vehicle.getIDList() or not _at(sumo, name, front):
                    raise SumoError(f"SUMO does not take road user {past.ids[row]} where it starts")
                sumo.vehicle.setPreviousSpeed(name, float(state[USER_VELOCITY]))
                self._known[name] = _of(past, row)
                self._put[name] = state
        self._seen = set(self._known)

    def _place(self, sumo: Any, past: Tracks, row: int) -> bool:
        """Puts a road user into SUMO; one that is none of the lanes' is kept beside it."""
        kind, state, size = past.kinds[row], past.states[row, -1], past.size[row]
        name, heading = f"cr-{past.ids[row]}", float(state[USER_HEADING])
        front = front_of(state[:2] + self._offset, heading, size[0])
        if kind in CLASS_OF and self._add(
            sumo, name, front, heading, CLASS_OF[kind], (float(size[0]), float(size[1]))
        ):
            sumo.vehicle.moveToXY(name, "", -1, *front, angle_of(heading), keepRoute=2)
            return True
        if kind in CLASS_OF and state[USER_VELOCITY] > STANDING:
            raise SumoError(
                f"the network of SUMO has no lane where road user {past.ids[row]} starts"
            )
        self._others.append((_of(past, row), state))
        return False

    def _draw(self, sumo: Any, name: str, walks: bool) -> None:
        if walks:
            self._drivers.draw_walker(sumo, name)
        elif name != self._ego:
            self._drivers.draw_vehicle(sumo, name)

    def _near(self, sumo: Any) -> list[User]:
        """Who is to be told of, and is known then."""
        found = []
        for user in users(sumo, self._ego, self._offset):
            near = np.hypot(*(user.state[:2] - self._centre)) <= self._sight
            if user.name in self._seen or near:
                self._seen.add(user.name)
                found.append(user)
                if user.name not in self._known:
                    group = sumo.person if user.walks else sumo.vehicle
                    self._known[user.name] = _Known(
                        self._id(user.name),
                        kind_of(group.getVehicleClass(user.name)),
                        _size(sumo, user),
                        np.zeros(USER_SIZE),
                    )
        return found

    def _slid(self, name: int, state: FloatArray, walks: bool) -> FloatArray:
        """(2,) where somebody is, that slides to where SUMO has it."""
        before = self._before.get(name, state[:2])
        way = state[:2] - before
        own, dt = state[USER_VELOCITY], self._scenario.dt
        if walks:
            length, reach = float(np.hypot(*way)), (own + SLIDING) * dt
            way = way if length <= reach else way * (reach / length)
        else:
            ahead = np.array([np.cos(state[USER_HEADING]), np.sin(state[USER_HEADING])])
            aside = np.array([-ahead[1], ahead[0]])
            most = (SIDEWAYS + SIDEWAYS_PER_SPEED * own) * dt
            way = ahead * np.clip(way @ ahead, -SLIDING * dt, (own + SLIDING) * dt) + (
                aside * np.clip(way @ aside, -most, most)
            )
        self._before[name] = before + way
        return np.asarray(before + way)

    def _id(self, name: str) -> int:
        """A number for somebody whom the file does not know, the same whatever the ego does.

        Only those of flows, whom no file names, are counted as they come.
        """
        number = self._number.setdefault(name, len(self._number))
        return self._free_id + number

    def _with_more(self, past: Tracks) -> Tracks:
        """The past, and who is near in SUMO besides, seen for the first time."""
        sumo = self._running.sumo
        given = set(past.ids.tolist())
        more = [user for user in self._near(sumo) if self._known[user.name].id not in given]
        known = [self._known[user.name] for user in more]
        states = np.full((len(more), past.steps, USER_SIZE), np.nan)
        for row, user in enumerate(more):
            states[row, -1] = user.state
        return Tracks(
            ids=np.concatenate([past.ids, np.array([k.id for k in known], dtype=np.int64)]),
            kinds=(*past.kinds, *(k.kind for k in known)),
            size=np.concatenate([past.size, np.reshape([k.size for k in known], (-1, 2))]),
            states=np.concatenate([past.states, states]),
            valid=np.concatenate([past.valid, np.isfinite(states[:, :, 0])]),
            outlines=(*past.outlines, *(None for _ in known)),
        )


def _acts_of(scenario: Scenario, configuration: Path) -> Acts | None:
    """What the cast of a scenario does; None where it has no file that tells it, and needs none.

    Without the file, SUMO would drive other futures than those that are recorded.
    """
    path = acts_file(configuration)
    if path is not None:
        return read_acts(path)
    if scenario.futures:
        raise ScenarioError(
            configuration,
            f"has no file *{ACTS} beside it, which says what happens in the recorded futures; put "
            "it there, or choose another traffic",
        )
    return None


def _at(sumo: Any, name: str, front: FloatArray) -> bool:
    """Whether SUMO has a vehicle at a place."""
    return bool(np.hypot(*(np.array(sumo.vehicle.getPosition(name)) - front)) <= _EXACT)


def _front(state: FloatArray, size: FloatArray) -> FloatArray:
    """(2,) the middle of the front of who is in a state, m.

    It is what SUMO leads along its lanes; how the body follows is another matter.
    """
    return front_of(state[:2], float(state[USER_HEADING]), float(size[0]))


def _along(state: FloatArray, way: float) -> FloatArray:
    """A state so many metres ahead."""
    moved = state.copy()
    moved[:2] += way * np.array([np.cos(state[USER_HEADING]), np.sin(state[USER_HEADING])])
    return moved


def _difference(one: FloatArray, other: FloatArray) -> FloatArray:
    """(4,) what is added to a state to get another, the short way round."""
    shift = one - other
    shift[USER_HEADING] = (shift[USER_HEADING] + np.pi) % (2.0 * np.pi) - np.pi
    return np.asarray(shift)


def _of(past: Tracks, row: int) -> _Known:
    """What the file tells of somebody who is where it says."""
    size = (float(past.size[row, 0]), float(past.size[row, 1]))
    return _Known(
        int(past.ids[row]), past.kinds[row], size, np.zeros(USER_SIZE), past.outlines[row]
    )


def _size(sumo: Any, user: User) -> tuple[float, float]:
    group = sumo.person if user.walks else sumo.vehicle
    return float(group.getLength(user.name)), float(group.getWidth(user.name))
