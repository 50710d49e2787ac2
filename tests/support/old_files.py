"""Files as earlier versions wrote them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dosplan.results.recording import Recording


def save_as_version_0_4(path: Path, recording: Recording, *, first: bool = False) -> None:
    """Writes an episode file of version 0.4; a ``first`` one has no slack of the road yet."""
    origin = recording.states[0, :2]
    arrays: dict[str, Any] = {
        name: np.array(getattr(recording, name))
        for name in (
            *("scenario_id", "start_step", "states", "inputs", "cycle_steps", "status", "fallback"),
            *("set_ids",),
        )
    }
    arrays |= {
        "arm": np.array(recording.arm.value),
        "end": np.array(recording.end.value),
        "error": np.array(recording.error or ""),
        "predict_ms": (1e3 * recording.predict_seconds).astype(np.float32),
        "plan_ms": (1e3 * recording.plan_seconds).astype(np.float32),
        "plan_centres": (recording.plan_centres - origin).astype(np.float32),
        "set_centres": (recording.set_centres - origin).astype(np.float32),
    }
    for name in ("iterations", "set_cycle", "set_offsets"):
        arrays[name] = getattr(recording, name).astype(np.int32)
    for name in ("slack", "set_semi_axes", "set_angles"):
        arrays[name] = getattr(recording, name).astype(np.float32)
    if not first:
        arrays |= {
            "road_slack": recording.road_slack.astype(np.float32),
            "active_ids": np.array([i for ids in recording.active_ids for i in ids], np.int64),
            "active_counts": np.array([len(ids) for ids in recording.active_ids], np.int32),
        }
    np.savez_compressed(path, allow_pickle=False, **arrays)
