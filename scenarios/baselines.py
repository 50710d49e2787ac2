"""Drives the baselines through the first suite: ``python scenarios/baselines.py``.

Writes ``baselines.csv``, each baseline's outcome in each scenario, and prints the table of
success that stands in ``README.md``.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from dosplan.results.rows import read_rows
from dosplan.running.run import RunConfig, run
from dosplan.types import Arm, Outcome

HERE = Path(__file__).resolve().parent
PLANNERS = ("cruise", "brake", "idm")
PREDICTOR = "constant-velocity"

Outcomes = Mapping[str, Mapping[str, str]]
"""Outcome by planner, by scenario id."""


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(description="Drive the baselines through the suite.")
    parser.add_argument(
        "--suite", type=Path, default=HERE / "suite-1", help="folder of manifest.csv"
    )
    parser.add_argument("--workers", type=int, default=1, help="processes (default: 1)")
    options = parser.parse_args()
    with (options.suite / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        manifest = list(csv.DictReader(stream))
    outcomes = drive_baselines(options.suite / "files", options.workers)
    path = options.suite / "baselines.csv"
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(("id", *PLANNERS))
        writer.writerows(
            (row["id"], *(outcomes[row["id"]][planner] for planner in PLANNERS)) for row in manifest
        )
    print(success_table(manifest, outcomes))


def drive_baselines(source: Path, workers: int = 1) -> dict[str, dict[str, str]]:
    """Drives every baseline through scenarios.

    Args:
        source: A scenario file or a folder of them.
        workers: Number of processes.

    Returns:
        See ``Outcomes``.
    """
    outcomes: dict[str, dict[str, str]] = {}
    with tempfile.TemporaryDirectory(prefix="dosplan-baselines-") as name:
        for planner in PLANNERS:
            config = RunConfig(
                out=Path(name) / planner,
                source=str(source),
                planner=planner,
                predictor=PREDICTOR,
                arms=(Arm.WITHOUT_DOS,),
                workers=workers,
            )
            for row in read_rows(run(config).rows):
                outcomes.setdefault(row.scenario, {})[planner] = row.outcome.value
    return outcomes


def success_table(manifest: Sequence[Mapping[str, str]], outcomes: Outcomes) -> str:
    """Success of the baselines by road kind, and every outcome over the whole suite.

    Args:
        manifest: Rows of the suite's manifest.
        outcomes: See ``Outcomes``.

    Returns:
        Two tables in Markdown.
    """
    kinds = dict.fromkeys(row["road_kind"] for row in manifest)
    lines = [_line("success by road kind", "n", *PLANNERS), "|---" + "|--:" * 4 + "|"]
    for kind in kinds:
        ids = [row["id"] for row in manifest if row["road_kind"] == kind]
        lines.append(_line(kind, len(ids), *_counts(ids, outcomes, Outcome.SUCCESS)))
    ids = [row["id"] for row in manifest]
    lines += ["", _line("outcome", *(f"{planner}, %" for planner in PLANNERS))]
    lines.append("|---" + "|--:" * 3 + "|")
    for outcome in (outcome for outcome in Outcome if outcome.of_planner):
        counts = _counts(ids, outcomes, outcome)
        lines.append(_line(outcome.value, *(f"{100.0 * n / len(ids):.1f}" for n in counts)))
    return "\n".join(lines)


def _line(*cells: object) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def _counts(ids: Sequence[str], outcomes: Outcomes, outcome: Outcome) -> list[int]:
    return [sum(outcomes[i][planner] == outcome for i in ids) for planner in PLANNERS]


if __name__ == "__main__":
    main()
