"""Every kind draws scenes that SUMO drives, with one past each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sumo", reason="needs dosplan[suite]")
pytest.importorskip("libsumo", reason="needs dosplan[suite]")

from suitegen.futures.kinds import KINDS
from suitegen.futures.motion import motions
from suitegen.futures.scene import scene_of
from suitegen.futures.simulate import RejectedError, simulate
from suitegen.plain import compile_network

pytestmark = pytest.mark.slow

DRAWS = 40
"""Futures that are drawn to see all intentions of a scene."""
TRIES = 12


@pytest.mark.parametrize("code", KINDS)
def test_intentions_part_after_the_branch_and_not_before(code: str, tmp_path: Path) -> None:
    for number in range(TRIES):
        rng = np.random.default_rng([4, number])
        staging = KINDS[code].draw(rng)
        acts = {act.intention: act for act in (staging.futures(k, rng) for k in range(DRAWS))}
        assert len(acts) > 1
        net = compile_network(staging.road.network, tmp_path)
        try:
            simulated = simulate(staging, list(acts.values()), net, tmp_path, rng)
            scene_of(simulated, staging.goal_size, rng)
        except RejectedError:
            continue
        break
    else:
        pytest.fail(f"{TRIES} scenes in a row were rejected")
    futures = [motions(traces) for traces in simulated.futures]
    actors = {actor.id for actor in staging.cast}
    until = simulated.start
    for future in futures[1:]:
        for name in actors:
            np.testing.assert_allclose(
                future[name].window(future[name].first, until),
                futures[0][name].window(future[name].first, until),
                rtol=0.0,
                atol=1e-9,
            )
    others = actors - {"ego"}
    apart = [
        max(_apart(one[name].states, other[name].states) for name in others)
        for i, one in enumerate(futures)
        for other in futures[:i]
    ]
    assert min(apart) > 0.5


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    steps = min(len(one), len(other))
    return float(np.hypot(*(one[:steps, :2] - other[:steps, :2]).T).max())
