"""The timing script: that it runs, and that its figures fit together. Times themselves vary."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from dosplan.system.files import read_json

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_writes_figures_that_fit_together(tmp_path: Path) -> None:
    out = tmp_path / "bench.json"
    options = ["--scenarios", "1", "--planner", "brake", "--json", str(out)]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.bench", *options],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    figures = read_json(out)

    assert done.stdout.startswith(f"{figures['planner']} with {figures['predictor']}, ")
    solved = "compiled" if figures["libraries"] else "in the virtual machine"
    assert f"networks by torch, problems of mpc {solved}\n" in done.stdout
    for times in figures["times_ms"].values():
        for part in times.values():
            assert 0.0 <= part["p50"] <= part["p95"] <= part["p99"]
        assert times["cycle"]["n"] == times["plan"]["n"] > times["episode"]["n"] == 1
        assert times["cycle"]["p50"] >= times["plan"]["p50"]
        assert times["episode"]["p50"] > times["episode_rest"]["p50"]
        assert times["solver"]["p99"] == 0.0  # Neither brake nor idm has a solver.

    medians = {name: times["cycle"]["p50"] for name, times in figures["times_ms"].items()}
    ratio = figures["ratios"]["cycle: with_dos / without_dos"]
    assert ratio["lowest"] == ratio["median"] == ratio["highest"]  # There is one scenario.
    assert ratio["median"] == pytest.approx(medians["with_dos"] / medians["without_dos"])
    assert figures["ratios"]["solver / cycle: with_dos"]["highest"] == 0.0

    growth = figures["road_users"]
    assert list(growth) == ["5", "20", "50", "200"]
    assert growth["5"]["cycle_ratio"] == 1.0
    assert growth["200"]["predict"] > growth["5"]["predict"]  # Forty times the road users.
    assert figures["horizon_s"] == {}  # That of brake is fixed.
    few, *_, many = map(int, figures["lanelets"])
    assert many == 64 * few
    for grown in (growth, figures["lanelets"]):
        for row in grown.values():
            assert 0.0 < row["cycle"] <= row["cycle_p95"]
    for parts in figures["engines"].values():  # There are none without onnxruntime.
        for engine in ("torch", "onnx"):
            assert parts["total"][engine] > parts["features"][engine] > 0.0
        total = parts["total"]
        assert total["ratio"] == pytest.approx(total["onnx"] / total["torch"])
    if compiled := figures["compiled"]:  # There are none without a compiler.
        assert compiled["ratio"] == pytest.approx(
            compiled["compiled"] / compiled["virtual_machine"]
        )
    assert figures["startup_ms"]["dosplan_help"]["p50"] > figures["startup_ms"]["python"]["p50"]
