"""The file of one episode: what was driven, planned and predicted, for players and re-scoring.

A compressed ``.npz`` of plain arrays (nothing is pickled). These are kept exactly, for scoring:
the driven states and inputs, the road users as they were driven, cycle times and what the solver
said, so that an episode can be scored again. Plans and predictions, which are many, are kept
relative to the ego's start in single precision, rounded to 1/64 m and 1/64 rad, for the road users
near the ego and for every fifth predicted step.

Where the road users drove as recorded, their tracks are those of the scenario's recorded future and
are not kept a second time.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from dosplan.scoring.part import scored_cycles
from dosplan.system.arrays_file import from_arrays, pack
from dosplan.system.errors import one_line
from dosplan.system.files import FileError, write_bytes
from dosplan.types import (
    EGO_SIZE,
    Arm,
    BoolArray,
    Episode,
    EpisodeEnd,
    FloatArray,
    IntArray,
    Occupancy,
    Scenario,
    Sightings,
    Signals,
    SolveReport,
    SolveStatus,
    Tracks,
)

KEPT_EVERY: Final = 5  # Predicted steps 5, 10, 15, ... are kept.
NEARBY_METRES: Final = 60.0  # Sets of road users farther from the ego than this are left out.
SAME_START: Final = 1e-3  # m, rad and m/s; another version of the reader may round differently.
_GRAIN: Final = 64.0  # A power of two: rounding zeroes the mantissa's tail, which compresses.

_OF_A_CYCLE: Final = (
    "cycle_steps", "predict_seconds", "plan_seconds", "status", "iterations", "slack", "road_slack",
    "fallback",
)  # fmt: skip


@dataclass(frozen=True)
class Recording:
    """One episode as its file keeps it; C planning cycles, K steps, M kept sets.

    Attributes:
        scenario_id: Id of the scenario.
        arm: Which arm was driven.
        start_step: Step of the first state.
        states: (K + 1, 5) driven ego states.
        inputs: (K, 2) inputs that were applied.
        traffic: Name of the traffic.
        tracks: The road users as they were driven; None where that is as recorded in this future.
        end: Why the simulation stopped.
        error: What went wrong, where ``end`` is a failure; None otherwise.
        cycle_steps: (C,) step at which each plan begins; that of what the ego saw is earlier by
            the loop's latency.
        predict_seconds: (C,) time of each prediction, s.
        plan_seconds: (C,) time of each plan, s.
        status: C words of ``SolveStatus``.
        iterations: (C,) solver iterations.
        slack: (C,) largest slack of a set constraint.
        road_slack: (C,) how far the plan leaves the road, m; NaN in files of versions that did not
            keep it.
        active_ids: C tuples of the ids of the road users whose sets touch the plan; empty in
            those files.
        fallback: C names of the fallback driven, empty where none was.
        plan_centres: (C, T + 1, 2) planned centres of the ego's rectangle, m; NaN past the end
            of a plan that is shorter than the longest.
        set_cycle: (M,) index of the cycle a set belongs to.
        set_ids: (M,) id of the road user.
        set_offsets: (S,) steps after the cycle's own that were kept.
        set_centres: (M, S, 2) predicted centres, m; NaN where not valid.
        set_semi_axes: (M, S, 2) semi-axes, m.
        set_angles: (M, S) direction of the first semi-axis, rad.
        set_weights: (M,) where sets are unions of ellipses, the weight of each: those of one road
            user follow one another, the most likely one first. None where each set is one ellipse.
        exact: Whether times and slacks are kept exactly; in files of older versions they are in
            single precision.
        signals: The traffic lights as they were; None where that is as recorded.
        future: Which continuation of the scenario's past was driven; 0 where there is one.
        loop: Name of the loop.
        sightings: What the ego saw, rounded to 1/64 m, rad and m/s; None where that is all there
            was, at the step of each cycle.
        waits_for: C reasons why the ego stops for a rule, empty where there is none; none at all
            where no plan has one.
        unreachable: C reasons why no goal can be reached from there, empty where the plan names
            none; none at all where no plan does.
        decisions: C decisions of the planner, empty where there was nothing to decide; none at all
            where no plan has one.

    Raises:
        ValueError: Arrays do not fit each other, or what is no number is where one has to be.
    """

    scenario_id: str
    arm: Arm
    start_step: int
    states: FloatArray
    inputs: FloatArray
    traffic: str
    tracks: Tracks | None
    end: EpisodeEnd
    error: str | None
    cycle_steps: IntArray
    predict_seconds: FloatArray
    plan_seconds: FloatArray
    status: tuple[str, ...]
    iterations: IntArray
    slack: FloatArray
    road_slack: FloatArray
    active_ids: tuple[tuple[int, ...], ...]
    fallback: tuple[str, ...]
    plan_centres: FloatArray
    set_cycle: IntArray
    set_ids: IntArray
    set_offsets: IntArray
    set_centres: FloatArray
    set_semi_axes: FloatArray
    set_angles: FloatArray
    set_weights: FloatArray | None = None
    exact: bool = True
    signals: Signals | None = None
    future: int = 0
    loop: str = "ideal"
    sightings: Sightings | None = None
    waits_for: tuple[str, ...] = ()
    unreachable: tuple[str, ...] = ()
    decisions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        steps, cycles = len(self.inputs), len(self.cycle_steps)
        sets, offsets = len(self.set_ids), len(self.set_offsets)
        shapes = {
            "states": (steps + 1, EGO_SIZE),
            "inputs": (steps, 2),
            **dict.fromkeys(_OF_A_CYCLE, (cycles,)),
            "plan_centres": (cycles, self.plan_centres.shape[1], 2),
            "set_cycle": (sets,),
            "set_ids": (sets,),
            "set_offsets": (offsets,),
            "set_centres": (sets, offsets, 2),
            "set_semi_axes": (sets, offsets, 2),
            "set_angles": (sets, offsets),
        }
        if self.set_weights is not None:
            shapes["set_weights"] = (sets,)
        for name, shape in shapes.items():
            if (found := np.shape(getattr(self, name))) != shape:
                raise ValueError(f"{name} has shape {found}, expected {shape}")
        if len(self.active_ids) != cycles:
            raise ValueError(f"active_ids has {len(self.active_ids)} entries, expected {cycles}")
        for name in ("waits_for", "unreachable", "decisions"):
            if (count := len(getattr(self, name))) not in (0, cycles):
                raise ValueError(f"{name} has {count} entries, expected {cycles}")
        for name in ("states", "inputs", "predict_seconds", "plan_seconds"):
            if not np.all(np.isfinite(getattr(self, name))):
                raise ValueError(f"{name} holds what is no number")
        planned = np.asarray(np.isfinite(self.plan_centres).all(axis=-1))
        if np.any(~planned[:, :1]) or np.any(planned[:, 1:] & ~planned[:, :-1]):
            raise ValueError("plan_centres holds what is no number before the end of a plan")
        driven = self.cycle_steps - self.start_step
        if np.any(np.diff(driven) <= 0) or np.any((driven < 0) | (driven > steps)):
            raise ValueError("cycle_steps are not steps of the episode, in their order")
        if np.any((self.set_cycle < 0) | (self.set_cycle >= cycles)):
            raise ValueError("set_cycle names cycles that are not there")

    @property
    def cycle_ms(self) -> FloatArray:
        """(C,) time of each full cycle, predict and plan, ms."""
        return 1e3 * (self.predict_seconds + self.plan_seconds)

    def scored_cycle_ms(self, steps: int) -> FloatArray:
        """Times of the cycles that a step of the scored drive follows.

        Args:
            steps: Steps of that drive; a recording goes on after a collision.

        Returns:
            (C,) ms.
        """
        return self.cycle_ms[scored_cycles(self.cycle_steps, self.start_step, steps)]

    @property
    def weights(self) -> FloatArray:
        """(M,) how likely each kept set is; 1 where it is all of its road user's set."""
        return np.ones(len(self.set_ids)) if self.set_weights is None else self.set_weights

    @property
    def first_components(self) -> IntArray:
        """(U,) first row of the kept sets of each cycle and road user, which may have several."""
        names = np.stack([self.set_cycle, self.set_ids], axis=1)
        changes = np.any(names[1:] != names[:-1], axis=1)
        return np.flatnonzero(np.concatenate([[True], changes])[: len(names)])

    @property
    def reports(self) -> tuple[SolveReport, ...]:
        """The reports of the C plans; times inside the solver are not kept."""
        words = {status.word: status for status in SolveStatus}
        return tuple(
            SolveReport(
                status=words[self.status[i]],
                iterations=int(self.iterations[i]),
                slack=float(self.slack[i]),
                active_ids=self.active_ids[i],
                fallback=self.fallback[i] or None,
                road_slack=float(np.nan_to_num(self.road_slack[i])),
                waits_for=(self.waits_for[i] or None) if self.waits_for else None,
                unreachable=(self.unreachable[i] or None) if self.unreachable else None,
                decision=(self.decisions[i] or None) if self.decisions else None,
            )
            for i in range(len(self.cycle_steps))
        )

    def is_of(self, scenario: Scenario) -> bool:
        """Whether the episode was driven in this scenario: it starts where the task does.

        Args:
            scenario: A scenario of the same id, perhaps read from a file that has changed since.

        Returns:
            Whether step and state at the start agree, the state within ``SAME_START``.
        """
        task = scenario.task
        return self.start_step == task.start_step and bool(
            np.allclose(self.states[0], task.start, rtol=0.0, atol=SAME_START)
        )

    def tracks_in(self, scenario: Scenario) -> Tracks:
        """The road users as they were driven.

        Args:
            scenario: What was driven.

        Returns:
            Their tracks, aligned with the scenario's steps.

        Raises:
            ShapeError: They drove as recorded in a future that the scenario does not have.
        """
        return scenario.recorded(self.future) if self.tracks is None else self.tracks

    @classmethod
    def of(cls, scenario: Scenario, episode: Episode) -> Self:
        """Takes from an episode what its file keeps.

        Args:
            scenario: What was driven.
            episode: The episode.

        Returns:
            What ``load`` would give of it.
        """
        reports = [plan.report for plan in episode.plans]
        waits_for = tuple(str(report.waits_for or "") for report in reports)
        unreachable = tuple(str(report.unreachable or "") for report in reports)
        decisions = tuple(str(report.decision or "") for report in reports)
        recording = cls(
            scenario_id=episode.scenario_id,
            arm=episode.arm,
            start_step=episode.start_step,
            states=episode.states,
            inputs=episode.inputs,
            traffic=episode.traffic,
            future=episode.future,
            loop=episode.loop,
            sightings=episode.sightings,
            tracks=None if scenario.is_recorded(episode.tracks) else episode.tracks,
            end=episode.end,
            error=episode.error,
            cycle_steps=episode.cycle_steps,
            predict_seconds=episode.predict_seconds,
            plan_seconds=episode.plan_seconds,
            status=tuple(report.status.word for report in reports),
            iterations=np.array([report.iterations for report in reports], dtype=np.int64),
            slack=np.array([report.slack for report in reports], dtype=np.float64),
            road_slack=np.array([report.road_slack for report in reports], dtype=np.float64),
            active_ids=tuple(tuple(int(i) for i in report.active_ids) for report in reports),
            fallback=tuple(str(report.fallback or "") for report in reports),
            waits_for=waits_for if any(waits_for) else (),
            unreachable=unreachable if any(unreachable) else (),
            decisions=decisions if any(decisions) else (),
            signals=episode.signals,
            plan_centres=_planned_centres(scenario, episode),
            **_kept_sets(episode),
        )
        return recording._stored()._restored()

    def save(self, path: Path) -> None:
        """Writes the episode's file.

        Args:
            path: The file, ``.npz``.

        Raises:
            FileError: It cannot be written.
        """
        write_bytes(path, self.pack())

    def pack(self) -> bytes:
        """Packs the content of the episode's file."""
        return pack(self._stored(), compressed=True)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Reads an episode's file.

        Args:
            path: The file.

        Returns:
            The recording, in the scenario's frame.

        Raises:
            FileError: The file is missing or is not such a file.
        """
        with _opened(path) as file:
            arrays = {name: file[name] for name in file.files}
            if "header" not in arrays:
                arrays = _of_version_0_4(arrays)
            return from_arrays(arrays, cls)._restored()

    def _stored(self) -> Self:
        """With what was planned and predicted as the file holds it."""
        origin = self.states[0, :2]
        values: dict[str, Any] = {
            "plan_centres": self.plan_centres - origin,
            "set_centres": self.set_centres - origin,
            "set_semi_axes": self.set_semi_axes,
            "set_angles": self.set_angles,
        }
        for name, value in values.items():
            values[name] = (np.round(value * _GRAIN) / _GRAIN).astype(np.float32)
        seen = self.sightings
        if seen is not None:
            values["sightings"] = replace(seen, states=np.round(seen.states * _GRAIN) / _GRAIN)
        return replace(self, **values)

    def _restored(self) -> Self:
        """With what the file holds of it in the scenario's frame."""
        origin = self.states[0, :2]
        return replace(
            self,
            plan_centres=self.plan_centres.astype(np.float64) + origin,
            set_centres=self.set_centres.astype(np.float64) + origin,
            set_semi_axes=self.set_semi_axes.astype(np.float64),
            set_angles=self.set_angles.astype(np.float64),
        )


def load_cycle_ms(path: Path, steps: int) -> FloatArray:
    """Reads the times of an episode's planning cycles, and little else of its file.

    Args:
        path: An episode's file.
        steps: Steps of the drive that is scored; the file goes on after a collision.

    Returns:
        (C,) time of each full cycle, predict and plan, that a step of that drive follows, ms.

    Raises:
        FileError: The file is missing or is not such a file.
    """
    with _opened(path) as file:
        times = 1e3 * (_seconds(file, "predict") + _seconds(file, "plan"))
        if times.ndim != 1 or not np.all(np.isfinite(times)):
            raise ValueError("predict_seconds and plan_seconds are no times")
        if "header" in file:
            start = json.loads(bytes(file["header"]))["start_step"]
        else:
            start = int(file["start_step"])
        return times[scored_cycles(file["cycle_steps"], start, steps)]


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The arrays of a file; any error with them in the block becomes one line."""
    try:
        with np.load(path, allow_pickle=False) as file:
            yield file
    except FileNotFoundError:
        raise FileError(f"{path} is missing") from None
    except Exception as error:  # A damaged archive can raise almost anything.
        raise FileError(
            f"{path} is not an episode file of this version: {one_line(error)}"
        ) from None


def _seconds(arrays: Mapping[str, Any], part: str) -> FloatArray:
    """(C,) time of each prediction or plan, s; older versions kept them in ms."""
    if f"{part}_seconds" in arrays:
        return np.asarray(arrays[f"{part}_seconds"], dtype=np.float64)
    return np.asarray(arrays[f"{part}_ms"].astype(np.float64) / 1e3)


def _of_version_0_4(arrays: dict[str, Any]) -> dict[str, Any]:
    """The arrays of a file of version 0.4 as they are named now: it had one for each text, too."""
    texts = ("scenario_id", "arm", "end", "error", "status", "fallback")
    header = {name: arrays.pop(name).tolist() for name in (*texts, "start_step")}
    cycles = len(arrays["cycle_steps"])
    ids, counts = (arrays.pop(name, None) for name in ("active_ids", "active_counts"))
    active = [] if ids is None else np.split(ids, np.cumsum(counts))
    header |= {
        "error": header["error"] or None,
        "active_ids": [part.tolist() for part in active][:cycles] or [[]] * cycles,
        "traffic": "replay",
        "tracks": None,
        "exact": False,
    }
    for part in ("predict", "plan"):
        arrays[f"{part}_seconds"] = _seconds(arrays, part)
        del arrays[f"{part}_ms"]
    arrays.setdefault("road_slack", np.full(cycles, np.nan))
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    arrays["data"] = np.empty(0, dtype=np.uint8)
    return arrays


def _planned_centres(scenario: Scenario, episode: Episode) -> FloatArray:
    longest = max((len(plan.states) for plan in episode.plans), default=0)
    centres = np.full((len(episode.plans), longest, 2), np.nan)
    for row, plan in zip(centres, episode.plans, strict=True):
        row[: len(plan.states)] = scenario.task.vehicle.centre(plan.states)
    return centres


def _kept_sets(episode: Episode) -> dict[str, Any]:
    """Selects the predicted sets that are kept."""
    horizon = max((occupancy.horizon for occupancy in episode.occupancies), default=0)
    columns = np.arange(KEPT_EVERY - 1, horizon, KEPT_EVERY)
    cycles: list[IntArray] = [np.empty(0, dtype=np.int64)]
    ids: list[IntArray] = [np.empty(0, dtype=np.int64)]
    centres: list[FloatArray] = [np.empty((0, len(columns), 2))]
    semi_axes: list[FloatArray] = [np.empty((0, len(columns), 2))]
    angles: list[FloatArray] = [np.empty((0, len(columns)))]
    weights: list[FloatArray] = [np.empty(0)]
    for cycle, (step, occupancy) in enumerate(
        zip(episode.cycle_steps, episode.occupancies, strict=True)
    ):
        sets, row, weight = occupancy.by_component()
        near = _nearby(sets, episode.states[step - episode.start_step, :2])
        near = np.isin(row, row[near])  # All components of a road user, or none.
        kept = np.ix_(near, columns)
        hidden = ~sets.valid[kept]
        cycles.append(np.full(int(near.sum()), cycle))
        ids.append(sets.ids[near])
        centres.append(np.where(hidden[..., None], np.nan, sets.centre[kept]))
        semi_axes.append(np.where(hidden[..., None], np.nan, sets.semi_axes[kept]))
        angles.append(np.where(hidden, np.nan, sets.angle[kept]))
        weights.append(weight[near])
    unions = any(occupancy.union is not None for occupancy in episode.occupancies)
    return {
        "set_weights": np.concatenate(weights) if unions else None,
        "set_cycle": np.concatenate(cycles),
        "set_ids": np.concatenate(ids),
        "set_offsets": columns + 1,
        "set_centres": np.concatenate(centres),
        "set_semi_axes": np.concatenate(semi_axes),
        "set_angles": np.concatenate(angles),
    }


def _nearby(occupancy: Occupancy, ego: FloatArray) -> BoolArray:
    """(N,) whether any predicted centre of a road user comes near the ego's present place."""
    distance = np.linalg.norm(occupancy.centre - ego, axis=-1)
    return np.asarray(np.any(occupancy.valid & (distance < NEARBY_METRES), axis=1))
