"""The table of planners x predictors: ``make peers`` writes it into ``results/peers``.

Every planner gets the same predictions: the trained sets, in both arms, the positions that constant
velocity gives, and the recorded future as the upper bound. The runs themselves stay in
``runs/peers``; where they were stopped, the same command goes on.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from dosplan.cli.arguments import console
from dosplan.report.progress import show_run
from dosplan.results.markdown import markdown
from dosplan.results.summary import read_summary
from dosplan.running.run import RunConfig, run
from dosplan.scoring.metrics import find_metric
from dosplan.system.files import write_json, write_text
from dosplan.system.provenance import describe_environment
from dosplan.types import Arm
from tests.support.peers import is_missing

RUNS: Final = Path("runs/peers")
RESULTS: Final = Path("results/peers")
PLANNERS: Final = ("mpc", "reactive", "frenetix", "idm")
# Without sets of its own a predictor has but one arm.
PREDICTORS: Final = {
    "dos": tuple(Arm),
    "constant-velocity": (Arm.WITHOUT_DOS,),
    "ground-truth": (Arm.WITHOUT_DOS,),
    "wale-net": tuple(Arm),
}
TIMEOUT: Final = 6.0 * 3600.0
"""Seconds for an episode: however busy the machine is, that is no failure of a planner."""
BY_DEFAULT: Final = ("dos", "constant-velocity", "ground-truth")  # Wale-Net takes hours.
COLUMNS: Final = (
    "success",
    "collision",
    "at_fault_collision",
    "out_of_bounds",
    "goal_missed",
    "planner_failure",
    "velocity",
    "cycle_ms_p50",
    "cycle_ms_p99",
)
"""Names of the metrics that are shown."""


def main() -> None:
    """Drives every pair and writes the table."""
    options = _options()
    missing = [name for name in (*options.planners, *options.predictors) if is_missing(name)]
    if missing:
        raise SystemExit(f"peers: {', '.join(missing)} not installed: see results/peers/README.md")
    rows: list[dict[str, Any]] = []
    for predictor in options.predictors:
        arms = PREDICTORS[predictor]
        for planner in options.planners:
            config = RunConfig(
                out=RUNS / options.name / f"{planner}-{predictor}",
                source=options.source,
                planner=planner,
                predictor=predictor,
                arms=arms,
                workers=options.workers,
                limit=options.limit,
                ranked=predictor != "ground-truth",
                cache=True,
                episode_timeout=TIMEOUT,
            )
            with show_run(console(stderr=True)) as observer:
                summary = read_summary(run(config, observer))
            rows += [
                {"planner": planner, "predictor": predictor, "arm": arm.value} | figures
                for arm, figures in summary.arms.items()
            ]
    table = markdown(
        ["Planner", "Predictor", "Arm", *(find_metric(name).heading for name in COLUMNS), "n"],
        [_cells(row) for row in rows],
    )
    figures = {"rows": rows, "environment": asdict(describe_environment())}
    RESULTS.mkdir(exist_ok=True)
    write_json(RESULTS / f"{options.name}.json", figures)
    write_text(RESULTS / f"{options.name}.md", table + "\n")
    print(table)


def _cells(row: dict[str, Any]) -> list[str]:
    shown = [metric.shown(row[metric.key]) for metric in map(find_metric, COLUMNS)]
    arm = str(row["arm"]).replace("_dos", " DOS")
    return [row["planner"], row["predictor"], arm, *shown, str(row["n"])]


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Drives planners and predictors against another.")
    parser.add_argument("source", nargs="?", default="suite-1", help="as for `dosplan run`")
    parser.add_argument("--name", default="suite-1", help="of the table (default: %(default)s)")
    parser.add_argument("--planners", nargs="+", default=PLANNERS, metavar="PLANNER")
    parser.add_argument(
        "--predictors",
        nargs="+",
        default=BY_DEFAULT,
        choices=PREDICTORS,
        help="default: all but wale-net",
        metavar="PREDICTOR",
    )
    parser.add_argument("--workers", type=int, default=1, metavar="N")
    parser.add_argument("--limit", type=int, metavar="N", help="the first N scenarios only")
    return parser.parse_args()


if __name__ == "__main__":
    main()
