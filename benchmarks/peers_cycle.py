"""Cycle times of a planner against its peers on the same scenarios, in one process.

Run with ``python -m benchmarks.peers_cycle`` where the extra ``peers`` is installed. As in
``bench.py``, drives that are compared follow one another, and ratios are formed within a scenario,
of medians and of processor time, which waiting for a busy core does not count in. A peer that
fails counts with the cycles that it planned until then. The planner is driven again at the end of
each scenario: how far its ratio to itself is from one says how far the other ratios can
be trusted.
"""

from __future__ import annotations

import os

# Numerical libraries read these once, when they are loaded.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import time
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console

from dosplan.api import Planner, Predictor
from dosplan.plugins.registry import create_planner, create_predictor
from dosplan.report.tables import table
from dosplan.scenario import find_scenarios, load_scenario
from dosplan.simulation.loop import run_episode
from dosplan.system.files import write_json
from dosplan.system.provenance import describe_environment
from dosplan.types import Arm, FloatArray, Scenario
from tests.support.peers import NEEDS, is_missing

AGAIN: Final = "again"
PERCENTILES: Final = (50, 95, 99)
MEASURES: Final = ("plan", "cpu")
Times = dict[str, FloatArray]  # ms of every cycle: wall-clock and processor time of the planner.


class _Clock:
    """Takes the processor time of a planner's calls."""

    def __init__(self, planner: Planner) -> None:
        self.seconds: list[float] = []
        self._compute = planner.compute_plan
        planner.compute_plan = self  # type: ignore[method-assign, assignment]

    def __call__(self, *arguments: Any) -> Any:
        started = time.process_time()
        plan = self._compute(*arguments)  # A call that raises is no cycle.
        self.seconds.append(time.process_time() - started)
        return plan


def main() -> None:
    """Measures, prints and writes."""
    options = _options()
    peers = [name for name in NEEDS if not is_missing(name)]
    if not peers:
        raise SystemExit("bench_peers: no peer is installed: pip install 'dosplan[peers]'")
    warnings.simplefilter("ignore")
    predictor = create_predictor(options.predictor, 0)
    names = {options.planner: options.planner, **{p: p for p in peers}, AGAIN: options.planner}
    refs = [ref for source in options.sources for ref in find_scenarios(source)]
    scenarios = []
    for ref in refs[: options.scenarios]:
        scenario = load_scenario(ref)
        scenarios.append(
            {k: drive(scenario, create_planner(v, 0), predictor) for k, v in names.items()}
        )
    figures = {
        "predictor": predictor.name,
        "scenarios": [ref.id for ref in refs[: options.scenarios]],
        "times_ms": {name: _spread(scenarios, name) for name in names},
        "ratios": {
            f"{measure}: {name} / {options.planner}": _ratio(
                scenarios, measure, name, options.planner
            )
            for measure in MEASURES
            for name in (*peers, AGAIN)
        },
        "environment": asdict(describe_environment()),
    }
    _show(figures)
    if options.json is not None:
        write_json(options.json, figures)


def drive(scenario: Scenario, planner: Planner, predictor: Predictor) -> Times:
    """Drives an episode until it ends or the planner fails."""
    clock = _Clock(planner)
    episode = run_episode(scenario, planner, predictor, Arm.WITHOUT_DOS)
    return {
        "plan": 1e3 * episode.plan_seconds[1:],  # What is built at the first use is not a cycle.
        "cpu": 1e3 * np.array(clock.seconds)[1 : len(episode.plans)],
    }


def _spread(scenarios: Sequence[dict[str, Times]], name: str) -> dict[str, float]:
    pooled = np.concatenate([times[name]["plan"] for times in scenarios])
    found = np.percentile(pooled, PERCENTILES).tolist()
    return {"n": len(pooled)} | {f"p{p}": v for p, v in zip(PERCENTILES, found, strict=True)}


def _ratio(
    scenarios: Sequence[dict[str, Times]], measure: str, name: str, planner: str
) -> dict[str, float]:
    """Ratio of medians within each scenario in which both planned: median and range."""
    pairs = [(times[name][measure], times[planner][measure]) for times in scenarios]
    found = [float(np.median(a) / np.median(b)) for a, b in pairs if len(a) and len(b)]
    values = np.percentile(found, (50, 0, 100)).tolist() if found else [float("nan")] * 3
    return dict(zip(("median", "lowest", "highest"), values, strict=True)) | {"n": len(found)}


def _show(figures: dict[str, Any]) -> None:
    def rows(found: dict[str, dict[str, float]]) -> list[list[str]]:
        return [[name, *(f"{value:.3g}" for value in row.values())] for name, row in found.items()]

    for part in (
        f"with {figures['predictor']}, {len(figures['scenarios'])} scenarios",
        table(["plan, ms", "n", "p50", "p95", "p99"], rows(figures["times_ms"])),
        table(["ratio", "median", "lowest", "highest", "scenarios"], rows(figures["ratios"])),
    ):
        Console().print(part, highlight=False, markup=False)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Compares cycle times with those of the peers.")
    parser.add_argument("sources", nargs="*", default=["suite-1"], help="default: suite-1")
    parser.add_argument("--scenarios", type=int, default=4, metavar="N", help="the first N")
    parser.add_argument("--planner", default="mpc", help="as for `dosplan run`")
    parser.add_argument("--predictor", default="constant-velocity", help="as for `dosplan run`")
    parser.add_argument("--json", type=Path, metavar="PATH", help="write the same figures there")
    options = parser.parse_args()
    if options.scenarios < 1:
        parser.error("--scenarios must be 1 or more")
    return options


if __name__ == "__main__":
    main()
