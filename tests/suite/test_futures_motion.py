"""Poses of scenes with several futures: what comes has no say in the past."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("sumo", reason="the generator needs dosplan[suite]")

from suitegen.futures.motion import motions
from suitegen.futures.scene import _check
from suitegen.futures.simulate import RejectedError
from suitegen.futures.staging import EGO, FIRST_BRANCH
from suitegen.motion import Motion
from suitegen.traffic import STEP, Trace

from dosplan.types import FloatArray

BRANCH = 40


def _trace(kind: str, after: float, name: str = "a") -> Trace:
    """A road user that goes 1 m a step until the branch, and from then on is led elsewhere."""
    along = np.arange(80.0)
    aside = np.where(along > BRANCH, after * (along - BRANCH), 0.0)
    front = np.column_stack([np.minimum(along, 200.0), aside])
    heading = np.where(along > BRANCH, np.arctan(after), 0.0)
    return Trace(name, kind, (4.5, 1.8), 0, front, heading)


@pytest.mark.parametrize("kind", ["car", "pedestrian"])
def test_no_pose_tells_what_comes_after_the_branch(kind: str) -> None:
    one, other = (motions([_trace(kind, after)])["a"].states for after in (0.0, 0.3))
    ahead = round(FIRST_BRANCH / STEP)
    np.testing.assert_array_equal(one[: BRANCH - ahead + 1], other[: BRANCH - ahead + 1])
    assert not np.array_equal(one[: BRANCH + 2], other[: BRANCH + 2])


def _motion(states: FloatArray, name: str = "a", kind: str = "car") -> Motion:
    heading = np.zeros(len(states))
    return Motion(Trace(name, kind, (4.5, 1.8), 0, states[:, :2], heading), states)


def _straight(speed: FloatArray, y: float = 0.0, name: str = "a", kind: str = "car") -> Motion:
    x = np.concatenate([[0.0], np.cumsum(speed[:-1]) * STEP])
    states = np.column_stack([x, np.full_like(x, y), np.zeros_like(x), speed])
    return _motion(states, name, kind)


def test_what_no_road_user_does_is_rejected_by_its_name() -> None:
    steady = np.full(30, 10.0)
    leaping = np.where(np.arange(30) < 15, 10.0, 8.0)
    turning = _straight(steady).states.copy()
    turning[:, 1], turning[:, 2] = 5.0, np.where(np.arange(30) < 15, 0.0, 0.5)
    ego = _straight(steady, name=EGO, kind=EGO)
    for other, reason in (
        (_straight(leaping, 5.0), "a car leaps"),
        (_motion(turning), "a car spins"),
        (_straight(steady, 1.0), "the stand-in collides"),
    ):
        with pytest.raises(RejectedError, match=reason):
            _check({EGO: ego, "a": other}, 0, 29)
    pair = {"a": _straight(steady, 5.0), "b": _straight(steady, 6.0, "b")}
    with pytest.raises(RejectedError, match="two others overlap"):
        _check({EGO: ego, **pair}, 0, 29)
    _check({EGO: ego, "a": _straight(steady, 5.0)}, 0, 29)
