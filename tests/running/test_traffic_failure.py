"""A traffic that raises: a row of its own outcome, in no figure, and told."""

from __future__ import annotations

from pathlib import Path

import pytest

from dosplan.cli import command as cli
from dosplan.cli.main import main
from dosplan.results.folder import RunFolder
from dosplan.results.rows import read_rows
from dosplan.results.summary import read_summary
from dosplan.types import Arm, Outcome
from tests.support.plugins import PLUGINS
from tests.support.runs import STILL, write_scenes

LOST = f"{Path(__file__).parents[1] / 'support' / 'traffic.py'}:LostTraffic"


def test_no_planner_is_judged_by_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenes = write_scenes(tmp_path / "scenes", 2)
    out = tmp_path / "out"
    plugins = ["--planner", f"{PLUGINS}:CoastPlanner", "--predictor", STILL, "--traffic", LOST]
    code = main(["run", str(scenes), *plugins, "--out", str(out), "--in-process", "--quiet"])
    told = capsys.readouterr()
    assert code == cli.FAILED
    assert "4 x traffic lost-v1: KeyError: 'way' (traffic.py:" in told.err
    folder = RunFolder(out)
    rows = read_rows(folder.rows)
    assert [(row.outcome, row.steps) for row in rows] == [(Outcome.TRAFFIC_FAILURE, 1)] * 4
    summary = read_summary(folder)
    for arm in Arm:
        figures = summary.arms[arm]
        assert (figures["n"], figures["usable"]) == (2, 0)
        assert figures["success_rate"] is None
        assert figures["planner_failure_rate"] is None
    assert summary.unusable == ()
    assert "| usable | 0 | 0 |" in folder.summary_text.read_text()
    assert "traffic failure" in folder.path.joinpath("report.html").read_text()
    assert main(["compare", str(out)]) == cli.OK
    assert "left out as unusable or failed by the traffic: 2" in capsys.readouterr().out
