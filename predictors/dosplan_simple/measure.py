"""``python -m dosplan_simple.measure DIR --out FILE``: how far a trajectory predictor is off.

Writes the table of mean displacement errors that ``error-circle-v1`` takes its radii from. The
mean is over every road user that can move, at every second of every recording, wherever its
true centre at the predicted step is recorded.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from dosplan.api import OraclePredictor, Predictor, PredictorSettings
from dosplan.plugins.registry import create_predictor
from dosplan.simulation.world import watch
from dosplan.types import Observation, Scenario
from dosplan_simple.predictors import (
    GroundTruthPredictor,
)
from dosplan_simple.sets import ErrorTable


def measure(
    scenarios: Iterable[Scenario], predictor: Predictor, *, every: int = 10, command: str = ""
) -> ErrorTable:
    """Measures a predictor's mean displacement error by step.

    Args:
        scenarios: Recordings; all of the same step.
        predictor: The predictor; its horizon is the table's length.
        every: Steps between two predictions.
        command: How the table is made, to be kept with it.

    Returns:
        The table.

    Raises:
        ValueError: A step of the horizon is recorded nowhere.
    """
    total, count, dt = np.zeros(predictor.horizon), np.zeros(predictor.horizon), 0.0
    truth: OraclePredictor = GroundTruthPredictor(
        settings=PredictorSettings(horizon=predictor.horizon)
    )
    for scenario in scenarios:
        dt = scenario.dt
        truth.reveal(scenario.tracks)
        predictor.reset(scenario.task, scenario.road_map)
        for observation in watch(scenario, every):
            errors = _errors(observation, predictor, truth)
            total += np.nansum(errors, axis=0)
            count += np.sum(np.isfinite(errors), axis=0)
    if not np.all(count):
        raise ValueError(
            f"no road user is recorded {int(np.argmin(count > 0)) + 1} steps on; "
            "give more recordings or a shorter horizon"
        )
    return ErrorTable(
        predictor=predictor.name,
        dt=dt,
        mean_error=tuple(float(x) for x in total / count),
        samples=tuple(int(x) for x in count),
        command=command,
    )


def _errors(
    observation: Observation, predictor: Predictor, truth: Predictor
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """(N, T) displacement errors, m; NaN where nothing is recorded or the kind does not move."""
    predicted, recorded = predictor.predict(observation), truth.predict(observation)
    counted = recorded.valid & predicted.valid & observation.moves[:, None]
    distance = np.linalg.norm(predicted.centre - recorded.centre, axis=-1)
    return np.where(counted, distance, np.nan)


def main(arguments: list[str] | None = None) -> int:
    """Measures a predictor on a folder of recordings.

    Args:
        arguments: Command line; that of the process by default.

    Returns:
        Exit status.
    """
    from dosplan.scenario import find_scenarios, load_recording

    parser = argparse.ArgumentParser(prog="python -m dosplan_simple.measure", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of CommonRoad recordings")
    parser.add_argument("--out", type=Path, required=True, help="table to write")
    parser.add_argument("--horizon", type=int, default=40, help="steps to measure")
    parser.add_argument(
        "--predictor",
        default="constant-velocity",
        help="a name of `dosplan list`, module:Class or path/to/file.py:Class",
    )
    parsed = parser.parse_args(arguments)

    # One planning problem per recording is enough: the road users are the same.
    first = {ref.path: ref for ref in reversed(find_scenarios(parsed.folder))}
    folder = f"{parsed.folder.parent.name}/{parsed.folder.name}"
    table = measure(
        (load_recording(ref) for ref in first.values()),
        create_predictor(parsed.predictor, 0, {"horizon": parsed.horizon}),
        command=(
            f"python -m dosplan_simple.measure {folder} --out {parsed.out.name} "
            f"--horizon {parsed.horizon} --predictor {parsed.predictor}"
        ),
    )
    table.dump(parsed.out)
    shown = ", ".join(f"{x:.2f}" for x in table.mean_error[9::10])
    print(f"{len(first)} recordings; mean error after 1, 2, ... s: {shown} m")
    return 0


if __name__ == "__main__":
    sys.exit(main())
