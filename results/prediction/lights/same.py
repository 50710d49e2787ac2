"""Whether predictions of recordings without lights are the same to the last bit.

    python results/prediction/lights/same.py commonroad/val

An observation every 20 steps, the default sets around the trajectories.
"""

from __future__ import annotations

import sys

import numpy as np
from dosplan_dos.predictor import DosPredictor, DosSettings

from dosplan.evaluation.evaluate import one_problem_each
from dosplan.scenario import load_recording
from dosplan.simulation.world import watch

EVERY = 20


def main() -> None:
    """Counts the observations, and those whose sets differ."""
    predictors = [DosPredictor(settings=DosSettings(lights=lights)) for lights in (True, False)]
    seen = differ = 0
    refs = one_problem_each(sys.argv[1])
    for ref in refs:
        for observation in watch(load_recording(ref), EVERY):
            ours, reference = (predictor.predict(observation) for predictor in predictors)
            same = all(
                np.array_equal(mine, value, equal_nan=True)
                for mine, value in zip(vars(ours).values(), vars(reference).values(), strict=True)
            )
            seen, differ = seen + 1, differ + (not same)
    print(f"{seen} observations in {len(refs)} recordings, {differ} differ")


if __name__ == "__main__":
    main()
