"""The suite as a whole: its scenarios, manifest and drives."""

from __future__ import annotations

import json
import shutil
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from pathlib import Path
from threading import Lock
from typing import Final

import numpy as np

from dosplan.system.files import write_json
from suitegen.futures.build import Built, Place, attempt_at, build, drives_csv, places
from suitegen.futures.kinds import KINDS
from suitegen.futures.simulate import RejectedError
from suitegen.manifest import remove_left_over, write_manifest

UNFINISHED = "unfinished"
"""Folder for what is kept of each scenario until all are there."""
_FORKS: Final = Lock()
"""Held while a process begins, so that no other one gets hold of its pipes and hides its end."""


def build_suite(
    seed: int,
    count: int,
    out: Path,
    split: str,
    kinds: Sequence[str],
    jobs: int,
    resume: bool,
) -> bool:
    """Builds scenarios, their manifest and the table of their drives.

    What a suite that was made in the folder before had besides is removed at the end.

    Args:
        seed: Seed of the suite.
        count: Number of scenarios.
        out: Folder for ``manifest.csv``, ``drives.csv.gz``, ``files/``, ``futures/`` and
            ``sumo-files/``.
        split: ``suite`` or ``train``.
        kinds: Codes of the kinds, which take turns.
        jobs: Number of processes.
        resume: Whether to keep scenarios that an earlier run made in the folder and was cut off.

    Returns:
        Whether all were made. A place is a function of the seed alone: one at which every scene was
        rejected is made by no later run, only with another seed.
    """
    unfinished = out / UNFINISHED
    if not resume:
        shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(parents=True, exist_ok=True)
    wanted = places(split, count, kinds)
    made = {place: built for place in wanted if (built := _kept(unfinished, place, seed))}
    failed = 0
    left = [place for place in wanted if place not in made]
    for place, result in _built(left, seed, jobs):
        try:
            built = result.result()
        except RuntimeError as error:
            failed += 1
            print(f"{error}", flush=True)
            continue
        for name, content in built.files.items():
            (out / name).parent.mkdir(exist_ok=True)
            (out / name).write_bytes(content)
        _keep(unfinished, built)
        made[place] = built
        size = sum(len(content) for content in built.files.values())
        rejected = sum(built.rejected.values())
        print(f"{place.benchmark_id}  {size / 1000:.0f} kB  {rejected} rejected", flush=True)
    _print_rejections(made)
    if failed:
        return False
    suite = [made[place] for place in wanted]
    (out / "drives.csv.gz").write_bytes(drives_csv(suite))
    write_manifest(out, [built.row for built in suite])
    remove_left_over(out, {built.row["id"] for built in suite}, KINDS)
    shutil.rmtree(unfinished)
    return True


def _built(wanted: Sequence[Place], seed: int, jobs: int) -> Iterator[tuple[Place, Future[Built]]]:
    """Scenarios as they are finished."""
    threads = ThreadPoolExecutor(jobs)
    try:
        running = {threads.submit(_build_apart, place, seed): place for place in wanted}
        for result in as_completed(running):
            yield running[result], result
    finally:
        threads.shutdown(cancel_futures=True)


def _build_apart(place: Place, seed: int) -> Built:
    """Builds a scenario in a process of its own."""
    with closing(_Process()) as process:
        return build(place, seed, process.attempt_at)


class _Process:
    """Draws scenes in a process of its own: where SUMO takes it down, that scene is rejected.

    It is tried twice, since a process may also be killed for what is not the scene's fault, and
    the same seed has to give the same suite.
    """

    def __init__(self) -> None:
        self._pool = ProcessPoolExecutor(1)

    def attempt_at(self, place: Place, seed: int, attempt: int) -> Built:
        """See ``build.attempt_at``."""
        for _ in range(2):
            try:
                with _FORKS:
                    result = self._pool.submit(attempt_at, place, seed, attempt)
                return result.result()
            except BrokenProcessPool:
                self._pool.shutdown()
                self._pool = ProcessPoolExecutor(1)
        raise RejectedError("SUMO takes its process down")

    def close(self) -> None:
        """Ends the process."""
        self._pool.shutdown()


def _keep(folder: Path, built: Built) -> None:
    """Keeps what the manifest and the table of drives need of a scenario."""
    content = {
        "row": built.row,
        "drives": [drive.tolist() for drive in built.drives],
        "start": built.start,
        "rejected": built.rejected,
    }
    write_json(folder / f"{built.row['id']}.json", content)


def _kept(folder: Path, place: Place, seed: int) -> Built | None:
    """What was kept of a scenario, without its files; None where it was not made."""
    path = folder / f"{place.benchmark_id}.json"
    if not path.is_file():
        return None
    content = json.loads(path.read_text(encoding="utf-8"))
    if content["row"]["source"] != place.source(seed):
        return None
    drives = tuple(np.array(drive) for drive in content["drives"])
    return Built({}, content["row"], drives, content["start"], Counter(content["rejected"]))


def _print_rejections(made: dict[Place, Built]) -> None:
    """Prints how many scenes were rejected, by kind and reason."""
    reasons: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for place, built in made.items():
        reasons[place.kind] += built.rejected
    for kind, counts in reasons.items():
        total = sum(counts.values())
        print(f"{kind}: {total} rejected")
        for reason, number in counts.most_common():
            print(f"  {number:5d}  {reason}")
