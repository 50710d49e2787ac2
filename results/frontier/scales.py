"""By which factor sets without a calibration of their own cover a share of what comes.

The sets of ``dos`` that are not calibrated, and circles whose radius is a rule, have one factor
for all road users and all times: ``scale`` of ``dos``, ``z`` or ``r`` of the circles. This script
finds, on recordings, the factor with which they hold the true centre in a given share of the
windows. A window counts at 1, 2, 3 and 4 s, and these four count alike. Road users at rest do not
count: hardly any set fails to hold them, and with them half of all windows would be covered by
nearly nothing.

    python results/frontier/scales.py DATA/commonroad/val
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from dosplan.evaluation.evaluate import one_problem_each
from dosplan.evaluation.groups import MOVING
from dosplan.evaluation.methods import Method, build
from dosplan.evaluation.samples import FileSamples, sample_file
from dosplan.scenario import load_recording
from dosplan.system.files import write_json
from dosplan.types import FloatArray

HERE: Final = Path(__file__).parent
LEVELS: Final = (0.5, 0.7, 0.8, 0.9, 0.95, 0.99)
DIGITS: Final = 4  # That a factor is rounded to, significant ones.
EVERY: Final = 5
"""Steps from one look to the next."""

_NET: Final = {"predictor": "net"}
METHODS: Final = (
    Method("free-one-factor", "dos", {"sets": "free", "scale": 1.0}),
    *(
        Method(name, "dos", {"sets": name, "scale": 1.0})
        for name in ("circle", "theta-0", "v1", "v2", "pr", "sa")
    ),
    Method("circle-r", "fixed-circle", {"r": 1.0, "base": _NET}),
    Method("circle-growing", "growing-circle", {"z": 1.0, "base": _NET}),
    Method("circle-error", "error-circle", {"z": 1.0, "base": _NET}),
    Method("constant-velocity", "error-circle", {"z": 1.0}),
)
"""The methods by their names in ``frontier.yaml``, with sets of a factor of 1."""


def factor(distances: Sequence[FloatArray], level: float) -> float:
    """The factor on sets with which they hold a share of the truth.

    Args:
        distances: Of each horizon, the distances of the truth in its windows; 1 is the edge of the
            set.
        level: The share, of which each horizon has an equal part.

    Returns:
        The least factor whose mean coverage over the horizons is the level.
    """
    found = np.concatenate(distances)
    weight = np.concatenate([np.full(len(part), 1.0 / len(part)) for part in distances])
    order = np.argsort(found)
    held = np.cumsum(weight[order]) / len(distances)
    return float(found[order][min(int(np.searchsorted(held, level - 1e-12)), len(found) - 1)])


def scales(samples: Sequence[FileSamples]) -> dict[str, dict[str, float]]:
    """The factors of all methods.

    Args:
        samples: Of each recording, those of ``METHODS``.

    Returns:
        Factors by the method's name and the level in percent.
    """
    moving = np.concatenate([one.speed for one in samples]) >= MOVING
    recorded = np.concatenate([one.recorded for one in samples]) & moving[:, None]
    found = {}
    for i, method in enumerate(METHODS):
        distance = np.concatenate([one.sets[i].distance for one in samples]).astype(np.float64)
        each = [distance[recorded[:, h], h] for h in range(recorded.shape[1])]
        found[method.label] = {
            f"{100 * level:g}": float(f"{factor(each, level):.{DIGITS}g}") for level in LEVELS
        }
    return found


def measure(folder: Path, every: int) -> Mapping[str, Any]:
    """Measures the factors on a folder of recordings.

    Args:
        folder: The recordings.
        every: Steps between two observations.

    Returns:
        Content of ``scales.json``.
    """
    predictors = [(method.label, build(method, seed=0)) for method in METHODS]
    samples = [
        sample_file(load_recording(ref), predictors, every) for ref in one_problem_each(str(folder))
    ]
    return {
        "recordings": len(samples),
        "windows": int(sum(np.sum(one.speed >= MOVING) for one in samples)),
        "every": every,
        "predictors": sorted({predictor.name for _, predictor in predictors}),
        "factors": scales(samples),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Measures, and writes ``scales.json`` beside this file.

    Args:
        arguments: Of the command line; those of the process by default.

    Returns:
        The exit code.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recordings", type=Path, help="folder of CommonRoad recordings")
    parser.add_argument(
        "--every", type=int, default=EVERY, help=f"steps between two looks ({EVERY})"
    )
    parser.add_argument("--out", type=Path, default=HERE / "scales.json", help="file to write")
    options = parser.parse_args(arguments)
    write_json(options.out, measure(options.recordings, options.every))
    return 0


if __name__ == "__main__":
    sys.exit(main())
