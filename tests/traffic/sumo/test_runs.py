"""Runs in which SUMO drives the others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from dosplan_sumo.demand import read_demand, write_demand

from dosplan.results.manifest import read_manifest
from dosplan.running.config import RunConfig, RunError
from dosplan.running.run import run
from dosplan.scenario.sources.sumo import configuration_of, read_configuration
from dosplan.types import Arm, Outcome
from tests.support.runs import QUIET, run_here, untimed
from tests.support.sumo import ZEBRA, interactive_folder, suite_file

libsumo = pytest.importorskip("libsumo", reason="needs dosplan[sumo]")

CROSSING = "ZAM_Crossing-4_1_T-1"
TRAFFIC = "dosplan_sumo.traffic:SumoTraffic"


def _config(out: Path, source: Path | str, **changes: Any) -> RunConfig:
    config = RunConfig(
        out=out, source=str(source), planner="brake", predictor="none", traffic=TRAFFIC
    )
    return replace(config, **changes)


def test_folders_run_in_one_batch_and_the_broken_ones_are_a_line_each(tmp_path: Path) -> None:
    source = tmp_path / "interactive"
    for name in (ZEBRA, CROSSING):
        interactive_folder(source, name)
    no_net = interactive_folder(source / "no-net", ZEBRA)
    no_net.write_text(no_net.read_text().replace(ZEBRA, "ZAM_Broken-1_1_I-1"))
    no_net.with_name(f"{ZEBRA}.net.xml").unlink()
    no_demand = interactive_folder(source / "no-demand", ZEBRA)
    no_demand.write_text(no_demand.read_text().replace(ZEBRA, "ZAM_Broken-2_1_I-1"))
    no_demand.with_name(f"{ZEBRA}.rou.xml").write_text("<additional/>")
    folder = run(_config(tmp_path / "run", source, arms=(Arm.WITHOUT_DOS,)), QUIET)
    rows = {row["scenario"]: row for row in untimed(folder)}
    assert len(rows) == 4
    assert rows["ZAM_Broken-1_1_I-1"]["outcome"] == Outcome.UNUSABLE
    assert f"names {ZEBRA}.net.xml, which is not there" in rows["ZAM_Broken-1_1_I-1"]["error"]
    for name in (ZEBRA, CROSSING, "ZAM_Broken-2_1_I-1"):
        assert rows[name]["error"] is None
        assert rows[name]["traffic"] == "sumo-v1"
        assert rows[name]["steps"] > 30
    assert read_manifest(folder).versions["libsumo"] == libsumo.getVersion()[1].split()[-1]


def test_the_same_seed_gives_the_same_rows_in_one_process_and_in_others(tmp_path: Path) -> None:
    source = interactive_folder(tmp_path).parent
    here = run_here(_config(tmp_path / "here", source, seed=5, futures=2))
    there = run(_config(tmp_path / "there", source, seed=5, futures=2), QUIET)
    assert untimed(here) == untimed(there)
    assert [row["future"] for row in untimed(here)] == [0, 1, 0, 1]
    assert {row["outcome"] for row in untimed(here)} <= {"success", "collision", "goal_missed"}


def test_a_run_whose_network_has_changed_does_not_go_on(tmp_path: Path) -> None:
    scene = interactive_folder(tmp_path / "in")
    config = _config(tmp_path / "run", scene.parent, arms=(Arm.WITH_DOS,))
    run_here(config)
    run_here(config)
    net = scene.with_name(f"{ZEBRA}.net.xml")
    net.write_text(net.read_text() + "\n")
    with pytest.raises(RunError, match="content of its plug-in, weight or scenario files"):
        run_here(config)


def test_an_error_of_sumo_in_an_episode_is_its_row_and_the_next_one_is_driven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (demand,) = read_demand(read_configuration(configuration_of(suite_file(ZEBRA)) or Path()))
    start = write_demand([demand], tmp_path).start or 0.0
    step, torn = libsumo.simulationStep, False

    def failing() -> None:
        nonlocal torn
        if not torn and libsumo.simulation.getTime() > start + 2.0:
            torn = True
            raise libsumo.TraCIException("the net\nis torn")
        step()

    monkeypatch.setattr(libsumo, "simulationStep", failing)
    folder = run_here(_config(tmp_path / "run", "suite-1", ids=(ZEBRA,)))
    first, second = untimed(folder)
    assert first["outcome"] == Outcome.TRAFFIC_FAILURE
    assert first["steps"] == pytest.approx(20, abs=1)
    assert "traffic sumo-v1: SumoError: SUMO: the net is torn" in first["error"]
    assert second["error"] is None
    assert not libsumo.isLoaded()
