"""The first suite as a whole."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from .build import Place, build, drives_csv
from .manifest import remove_left_over, write_manifest
from .networks import ROAD_KINDS


def build_suite(seed: int, count: int, out: Path, split: str, jobs: int) -> None:
    """Builds scenarios, their manifest and the table of their recorded drives.

    What a suite that was made in the folder before had besides is removed at the end.

    Args:
        seed: Seed of the suite.
        count: Number of scenarios.
        out: Folder for ``manifest.csv``, ``drives.csv.gz``, ``files/`` and ``sumo-files/``.
        split: ``suite`` or ``train``.
        jobs: Number of processes.
    """
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
    write_manifest(out, [built.row for built in suite])
    remove_left_over(out, {built.row["id"] for built in suite}, ROAD_KINDS)
