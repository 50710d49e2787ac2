"""Drives the baselines through a suite: ``python scenarios/baselines.py [SUITE]``.

Writes ``baselines.csv``, each baseline's outcome in each scenario and future, and the tables
between the markers in the suite's ``README.md``.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from dosplan.results.markdown import markdown
from dosplan.results.rows import read_rows
from dosplan.running.run import RunConfig, run
from dosplan.types import Arm, Outcome

HERE = Path(__file__).resolve().parent
PLANNERS = ("cruise", "brake", "idm")
PREDICTOR = "constant-velocity"
MARKERS = ("<!-- baselines: begin -->", "<!-- baselines: end -->")

Row = Mapping[str, str]
"""A row of ``manifest.csv``, or of ``baselines.csv``: id, future, the outcome of each planner."""


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(description="Drive the baselines through a suite.")
    parser.add_argument(
        "suite",
        type=Path,
        nargs="?",
        default=HERE / "suite",
        help="folder of manifest.csv (default: scenarios/suite)",
    )
    parser.add_argument("--workers", type=int, default=1, help="processes (default: 1)")
    options = parser.parse_args()
    with (options.suite / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        manifest = list(csv.DictReader(stream))
    rows = drive_baselines(options.suite, manifest, options.workers)
    with (options.suite / "baselines.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, ("id", "future", *PLANNERS), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    tables = baseline_tables(manifest, rows)
    print(tables)
    _write_between_markers(options.suite / "README.md", tables)


def drive_baselines(suite: Path, manifest: Sequence[Row], workers: int = 1) -> list[dict[str, str]]:
    """Drives every baseline through every future of a suite.

    Args:
        suite: The folder of the suite.
        manifest: Rows of its manifest; all have as many futures.
        workers: Number of processes.

    Returns:
        A row for each scenario and future, in the order of the manifest.
    """
    futures = max(map(_futures, manifest))
    rows = {
        (row["id"], future): {"id": row["id"], "future": str(future)}
        for row in manifest
        for future in range(futures)
    }
    with tempfile.TemporaryDirectory(prefix="dosplan-baselines-") as name:
        for planner in PLANNERS:
            config = RunConfig(
                out=Path(name) / planner,
                source=str(suite / "files"),
                planner=planner,
                predictor=PREDICTOR,
                arms=(Arm.WITHOUT_DOS,),
                futures=futures,
                workers=workers,
            )
            for row in read_rows(run(config).rows):
                rows[row.scenario, row.future][planner] = row.outcome.value
    return list(rows.values())


def baseline_tables(manifest: Sequence[Row], rows: Sequence[Row]) -> str:
    """Success and collisions of the baselines by kind, and every outcome over the whole suite.

    Args:
        manifest: Rows of the suite's manifest.
        rows: Rows of ``baselines.csv``.

    Returns:
        Two tables in Markdown. Where there are several futures, the first also counts the scenarios
        in which ``idm`` collides in some futures and succeeds in others.
    """
    kind_of = {row["id"]: row.get("kind") or row["road_kind"] for row in manifest}
    several = max(map(_futures, manifest)) > 1
    counted = (Outcome.SUCCESS, Outcome.COLLISION)
    headings = ["kind", "drives", *(f"{p}: {outcome}" for outcome in counted for p in PLANNERS)]
    lines = []
    for kind in dict.fromkeys(kind_of.values()):
        own = [row for row in rows if kind_of[row["id"]] == kind]
        counts = [_count(own, p, outcome) for outcome in counted for p in PLANNERS]
        lines.append([kind, str(len(own)), *map(str, counts)])
        if several:
            lines[-1].append(str(_decided(own)))
    if several:
        headings.append("decided for idm")
    shares = [
        [outcome, *(f"{100.0 * _count(rows, p, outcome) / len(rows):.1f}" for p in PLANNERS)]
        for outcome in Outcome
        if outcome.of_planner
    ]
    outcomes = markdown(["outcome", *(f"{p}, %" for p in PLANNERS)], shares)
    return f"{markdown(headings, lines)}\n\n{outcomes}"


def _futures(row: Row) -> int:
    return int(row.get("futures", "1"))


def _count(rows: Iterable[Row], planner: str, outcome: Outcome) -> int:
    return sum(row[planner] == outcome for row in rows)


def _decided(rows: Sequence[Row]) -> int:
    """Number of scenarios of which the future decides whether ``idm`` collides."""
    ends: dict[str, set[str]] = {}
    for row in rows:
        ends.setdefault(row["id"], set()).add(row["idm"])
    return sum({Outcome.COLLISION, Outcome.SUCCESS} <= each for each in ends.values())


def _write_between_markers(path: Path, text: str) -> None:
    """Puts text between the markers of a file; leaves a file without them alone."""
    if not path.is_file():
        return
    old = path.read_text(encoding="utf-8")
    begin, end = (old.find(marker) for marker in MARKERS)
    if 0 <= begin < end:
        head = old[: begin + len(MARKERS[0])]
        path.write_text(f"{head}\n{text}\n{old[end:]}", encoding="utf-8")


if __name__ == "__main__":
    main()
