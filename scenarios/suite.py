"""Builds the embedded scenario suite: ``python scenarios/suite.py --seed 1``.

The same seed gives the same bytes, whatever the folder, the number of processes and the hash
seed. Needs the extra ``dosplan[suite]`` (SUMO).
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

SUMO_VERSION = "1.28.0"
HERE = Path(__file__).resolve().parent


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command.

    Args:
        arguments: Command line; that of the process if None.

    Returns:
        Exit status.
    """
    parser = argparse.ArgumentParser(description="Build the embedded scenario suite.")
    parser.add_argument("--seed", type=int, default=1, help="seed of the suite (default: 1)")
    parser.add_argument("--count", type=int, default=150, help="number of scenarios (default: 150)")
    parser.add_argument(
        "--out", type=Path, default=HERE, help="folder for what is made (default: here)"
    )
    parser.add_argument(
        "--split",
        choices=("suite", "train"),
        default="suite",
        help="the suite itself, or other roads and traffic of the same families for training",
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: 1)")
    options = parser.parse_args(arguments)
    try:
        found = version("eclipse-sumo")
    except PackageNotFoundError:
        found = "none"
    if found != SUMO_VERSION:
        parser.exit(
            2,
            f"suite.py: the suite is made with SUMO {SUMO_VERSION}, found {found}; "
            f"pip install eclipse-sumo=={SUMO_VERSION} sumolib=={SUMO_VERSION}\n",
        )
    build_suite(options.seed, options.count, options.out, options.split, options.jobs)
    return 0


def build_suite(seed: int, count: int, out: Path, split: str, jobs: int) -> None:
    """Builds scenarios, their manifest and the table of their recorded drives.

    Args:
        seed: Seed of the suite.
        count: Number of scenarios.
        out: Folder for ``manifest.csv``, ``drives.csv.gz``, ``files/`` and ``sumo-files/``.
        split: ``suite`` or ``train``.
        jobs: Number of processes.
    """
    from suitegen.build import Place, build, drives_csv

    places = [Place(split, index) for index in range(count)]
    for folder in ("files", "sumo-files"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    suite = []
    with ProcessPoolExecutor(jobs) as pool:
        for built in pool.map(partial(build, seed=seed), places):
            (out / built.row["file"]).write_bytes(built.data)
            for name, content in built.sumo.items():
                (out / "sumo-files" / name).write_bytes(content)
            suite.append(built)
            print(f"{built.row['id']}  {len(built.data) / 1000:.0f} kB", flush=True)
    (out / "drives.csv.gz").write_bytes(drives_csv(suite))
    with (out / "manifest.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(suite[0].row), lineterminator="\n")
        writer.writeheader()
        writer.writerows(built.row for built in suite)


if __name__ == "__main__":
    sys.exit(main())
