"""The file of one episode: what was driven, planned and predicted, for players and re-scoring.

A compressed ``.npz`` of plain arrays (nothing is pickled). What a row follows from is kept exactly:
the driven states and inputs, the road users as they were driven, cycle times and what the solver
said, so that an episode can be scored again. Plans and predictions, which are many, are kept
relative to the ego's start in single precision, rounded to 1/64 m and 1/64 rad, for the road users
near the ego and for every fifth predicted step.

Where the road users drove as recorded, their tracks are those of the scenario file and are not kept
a second time.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from dosplan.system.errors import one_line
from dosplan.system.files import FileError
from dosplan.types import (
    EGO_SIZE,
    Arm,
    BoolArray,
    Episode,
    EpisodeEnd,
    FloatArray,
    IntArray,
    Occupancy,
    RoadUserKind,
    Scenario,
    SolveReport,
    SolveStatus,
    Tracks,
)

KEPT_EVERY: Final = 5  # Predicted steps 5, 10, 15, ... are kept.
NEARBY_METRES: Final = 60.0  # Sets of road users farther from the ego than this are left out.
_GRAIN: Final = 64.0  # A power of two: rounding zeroes the mantissa's tail, which compresses.

_OF_A_CYCLE: Final = (
    "cycle_steps", "predict_seconds", "plan_seconds", "status", "iterations", "slack", "road_slack",
    "fallback",
)  # fmt: skip

_FloatArray32 = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Recording:
    """One episode as read back from its file; C planning cycles, K steps, M kept sets.

    Attributes:
        scenario_id: Id of the scenario.
        arm: Which arm was driven.
        start_step: Step of the first state.
        states: (K + 1, 5) driven ego states.
        inputs: (K, 2) inputs that were applied.
        traffic: Name of the traffic.
        tracks: The road users as they were driven; None where that is as recorded.
        end: Why the simulation stopped.
        error: What went wrong in a planner failure, or None.
        cycle_steps: (C,) step at which each cycle ran.
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
        exact: Whether times and slacks are kept exactly; in files of older versions they are in
            single precision.
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
    exact: bool = True

    @property
    def cycle_ms(self) -> FloatArray:
        """(C,) time of each full cycle, predict and plan, ms."""
        return 1e3 * (self.predict_seconds + self.plan_seconds)

    @property
    def reports(self) -> tuple[SolveReport, ...]:
        """What was said of each of the C plans; times inside the solver are not kept."""
        words = {status.word: status for status in SolveStatus}
        return tuple(
            SolveReport(
                status=words[self.status[i]],
                iterations=int(self.iterations[i]),
                slack=float(self.slack[i]),
                active_ids=self.active_ids[i],
                fallback=self.fallback[i] or None,
                road_slack=float(np.nan_to_num(self.road_slack[i])),
            )
            for i in range(len(self.cycle_steps))
        )

    def tracks_in(self, scenario: Scenario) -> Tracks:
        """The road users as they were driven.

        Args:
            scenario: What was driven.

        Returns:
            Their tracks, aligned with the scenario's steps.
        """
        return scenario.tracks if self.tracks is None else self.tracks


def pack_recording(scenario: Scenario, episode: Episode) -> bytes:
    """Packs what an episode's file holds.

    Args:
        scenario: What was driven.
        episode: The episode.

    Returns:
        Content of the ``.npz`` file.
    """
    origin = episode.states[0, :2]
    reports = [plan.report for plan in episode.plans]
    arrays: dict[str, Any] = {
        "scenario_id": np.array(episode.scenario_id),
        "arm": np.array(episode.arm.value),
        "start_step": np.array(episode.start_step),
        "states": episode.states,
        "inputs": episode.inputs,
        "traffic": np.array(episode.traffic),
        **({} if episode.tracks is scenario.tracks else _pack_tracks(episode.tracks)),
        "end": np.array(episode.end.value),
        "error": np.array(episode.error or ""),
        "cycle_steps": episode.cycle_steps,
        "predict_seconds": episode.predict_seconds,
        "plan_seconds": episode.plan_seconds,
        "status": np.array([report.status.word for report in reports], dtype=np.str_),
        "iterations": np.array([report.iterations for report in reports], dtype=np.int32),
        "slack": np.array([report.slack for report in reports], dtype=np.float64),
        "road_slack": np.array([report.road_slack for report in reports], dtype=np.float64),
        "active_ids": np.array([i for r in reports for i in r.active_ids], dtype=np.int64),
        "active_counts": np.array([len(r.active_ids) for r in reports], dtype=np.int32),
        "fallback": np.array([report.fallback or "" for report in reports], dtype=np.str_),
        "plan_centres": _grain(_planned_centres(scenario, episode) - origin),
        **_kept_sets(episode, origin),
    }
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **arrays)
    return file.getvalue()


def load_recording(path: Path) -> Recording:
    """Reads an episode's file.

    Args:
        path: A file that holds what ``pack_recording`` gave.

    Returns:
        The recording, in the scenario's frame.

    Raises:
        FileError: The file is missing or is not such a file.
    """
    with _opened(path) as file:
        arrays = {name: file[name] for name in file.files}
        origin = arrays["states"][0, :2]
        cycles = len(arrays["cycle_steps"])
        exact = "predict_seconds" in arrays
        road_slack = arrays.get("road_slack", np.full(cycles, np.nan))
        active_ids = arrays.get("active_ids", np.empty(0, dtype=np.int64))
        active_counts = arrays.get("active_counts", np.zeros(cycles, dtype=np.int32))
        recording = Recording(
            scenario_id=str(arrays["scenario_id"]),
            arm=Arm(str(arrays["arm"])),
            start_step=int(arrays["start_step"]),
            states=arrays["states"],
            inputs=arrays["inputs"],
            traffic=str(arrays.get("traffic", "replay")),
            tracks=_unpack_tracks(arrays) if "user_ids" in arrays else None,
            end=EpisodeEnd(str(arrays["end"])),
            error=str(arrays["error"]) or None,
            cycle_steps=arrays["cycle_steps"],
            predict_seconds=_seconds(arrays, "predict"),
            plan_seconds=_seconds(arrays, "plan"),
            status=tuple(arrays["status"].tolist()),
            iterations=arrays["iterations"].astype(np.int64),
            slack=arrays["slack"].astype(np.float64),
            road_slack=road_slack.astype(np.float64),
            active_ids=tuple(
                tuple(ids.tolist())
                for ids in np.split(active_ids, np.cumsum(active_counts))[:cycles]
            ),
            fallback=tuple(arrays["fallback"].tolist()),
            plan_centres=arrays["plan_centres"].astype(np.float64) + origin,
            set_cycle=arrays["set_cycle"].astype(np.int64),
            set_ids=arrays["set_ids"],
            set_offsets=arrays["set_offsets"].astype(np.int64),
            set_centres=arrays["set_centres"].astype(np.float64) + origin,
            set_semi_axes=arrays["set_semi_axes"].astype(np.float64),
            set_angles=arrays["set_angles"].astype(np.float64),
            exact=exact,
        )
        _check(recording)
        return recording


def load_cycle_ms(path: Path) -> FloatArray:
    """Reads the times of an episode's planning cycles, and nothing else of its file.

    Args:
        path: A file that holds what ``pack_recording`` gave.

    Returns:
        (C,) time of each full cycle, predict and plan, ms.

    Raises:
        FileError: The file is missing or is not such a file.
    """
    with _opened(path) as file:
        times = 1e3 * (_seconds(file, "predict") + _seconds(file, "plan"))
        if times.ndim != 1 or not np.all(np.isfinite(times)):
            raise ValueError("predict_seconds and plan_seconds are no times")
        return times


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The arrays of a file; whatever is wrong with them in the block is told in one line."""
    try:
        with np.load(path, allow_pickle=False) as file:
            yield file
    except FileNotFoundError:
        raise FileError(f"{path} is missing") from None
    except Exception as error:  # What a damaged archive raises is not foreseeable.
        raise FileError(
            f"{path} is not an episode file of this version: {one_line(error)}"
        ) from None


def _seconds(arrays: Mapping[str, Any], part: str) -> FloatArray:
    """(C,) time of each prediction or plan, s; older versions kept them in ms."""
    if f"{part}_seconds" in arrays:
        return np.asarray(arrays[f"{part}_seconds"], dtype=np.float64)
    return np.asarray(arrays[f"{part}_ms"].astype(np.float64) / 1e3)


def _pack_tracks(tracks: Tracks) -> dict[str, npt.NDArray[Any]]:
    outlines = [np.empty((0, 2)) if outline is None else outline for outline in tracks.outlines]
    return {
        "user_ids": tracks.ids,
        "user_kinds": np.array([kind.value for kind in tracks.kinds], dtype=np.str_),
        "user_size": tracks.size,
        "user_states": tracks.states,
        "user_valid": tracks.valid,
        "user_outlines": np.concatenate([np.empty((0, 2)), *outlines]),
        "user_corners": np.array([len(outline) for outline in outlines], dtype=np.int64),
    }


def _unpack_tracks(arrays: Mapping[str, Any]) -> Tracks:
    corners = arrays["user_corners"]
    outlines = np.split(arrays["user_outlines"], np.cumsum(corners))[: len(corners)]
    return Tracks(
        ids=arrays["user_ids"],
        kinds=tuple(RoadUserKind(kind) for kind in arrays["user_kinds"].tolist()),
        size=arrays["user_size"],
        states=arrays["user_states"],
        valid=arrays["user_valid"],
        outlines=tuple(outline if len(outline) else None for outline in outlines),
    )


def _check(recording: Recording) -> None:
    """Raises where arrays do not fit each other, or what is no number is where one has to be."""
    steps, cycles = len(recording.inputs), len(recording.cycle_steps)
    sets, offsets = len(recording.set_ids), len(recording.set_offsets)
    shapes = {
        "states": (steps + 1, EGO_SIZE),
        "inputs": (steps, 2),
        **dict.fromkeys(_OF_A_CYCLE, (cycles,)),
        "plan_centres": (cycles, recording.plan_centres.shape[1], 2),
        "set_cycle": (sets,),
        "set_ids": (sets,),
        "set_offsets": (offsets,),
        "set_centres": (sets, offsets, 2),
        "set_semi_axes": (sets, offsets, 2),
        "set_angles": (sets, offsets),
    }
    for name, shape in shapes.items():
        if (found := np.shape(getattr(recording, name))) != shape:
            raise ValueError(f"{name} has shape {found}, expected {shape}")
    for name in ("states", "inputs", "predict_seconds", "plan_seconds"):
        if not np.all(np.isfinite(getattr(recording, name))):
            raise ValueError(f"{name} holds what is no number")
    driven = recording.cycle_steps - recording.start_step
    if np.any(np.diff(driven) <= 0) or np.any((driven < 0) | (driven > steps)):
        raise ValueError("cycle_steps are not steps of the episode, in their order")
    if np.any((recording.set_cycle < 0) | (recording.set_cycle >= cycles)):
        raise ValueError("set_cycle names cycles that are not there")


def _grain(values: FloatArray) -> _FloatArray32:
    return (np.round(values * _GRAIN) / _GRAIN).astype(np.float32)


def _planned_centres(scenario: Scenario, episode: Episode) -> FloatArray:
    longest = max((len(plan.states) for plan in episode.plans), default=0)
    centres = np.full((len(episode.plans), longest, 2), np.nan)
    for row, plan in zip(centres, episode.plans, strict=True):
        row[: len(plan.states)] = scenario.task.vehicle.centre(plan.states)
    return centres


def _kept_sets(episode: Episode, origin: FloatArray) -> dict[str, npt.NDArray[np.generic]]:
    horizon = max((occupancy.horizon for occupancy in episode.occupancies), default=0)
    columns = np.arange(KEPT_EVERY - 1, horizon, KEPT_EVERY)
    cycles: list[IntArray] = [np.empty(0, dtype=np.int64)]
    ids: list[IntArray] = [np.empty(0, dtype=np.int64)]
    centres: list[FloatArray] = [np.empty((0, len(columns), 2))]
    semi_axes: list[FloatArray] = [np.empty((0, len(columns), 2))]
    angles: list[FloatArray] = [np.empty((0, len(columns)))]
    for cycle, (step, occupancy) in enumerate(
        zip(episode.cycle_steps, episode.occupancies, strict=True)
    ):
        near = _nearby(occupancy, episode.states[step - episode.start_step, :2])
        kept = np.ix_(near, columns)
        hidden = ~occupancy.valid[kept]
        cycles.append(np.full(int(near.sum()), cycle))
        ids.append(occupancy.ids[near])
        centres.append(np.where(hidden[..., None], np.nan, occupancy.centre[kept] - origin))
        semi_axes.append(np.where(hidden[..., None], np.nan, occupancy.semi_axes[kept]))
        angles.append(np.where(hidden, np.nan, occupancy.angle[kept]))
    return {
        "set_cycle": np.concatenate(cycles).astype(np.int32),
        "set_ids": np.concatenate(ids),
        "set_offsets": (columns + 1).astype(np.int32),
        "set_centres": _grain(np.concatenate(centres)),
        "set_semi_axes": _grain(np.concatenate(semi_axes)),
        "set_angles": _grain(np.concatenate(angles)),
    }


def _nearby(occupancy: Occupancy, ego: FloatArray) -> BoolArray:
    """(N,) whether any predicted centre of a road user comes near the ego's present place."""
    distance = np.linalg.norm(occupancy.centre - ego, axis=-1)
    return np.asarray(np.any(occupancy.valid & (distance < NEARBY_METRES), axis=1))
