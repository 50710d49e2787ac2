"""A metric is one entry: it comes out everywhere without another line of code."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs.schema import metrics_page
from dosplan.cli.main import OK, main
from dosplan.report.html.write import write_report
from dosplan.results.dataframes import to_pandas
from dosplan.results.rows import read_rows
from dosplan.running.config import RunConfig
from dosplan.scoring import metrics
from dosplan.scoring.metrics import Aggregate, Better, Group, Metric
from dosplan.system.files import read_json
from tests.support.plugins import PLUGINS
from tests.support.runs import STILL, run_here, write_reached_and_missed

STATES = Metric(
    name="scored_states",
    title="States of the scored part",
    short="States",
    unit="",
    definition="how many states are scored",
    aggregate=Aggregate.MEAN,
    group=Group.RIDE,
    better=Better.NEITHER,
    measure=lambda part: len(part.states),
    kind=int,
    digits=1,
    plotted=True,
)


def test_a_new_entry_reaches_rows_summary_comparison_tables_pages_and_docs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(metrics, "METRICS", (*metrics.METRICS, STATES))
    (tmp_path / "scenes").mkdir()
    scenes = write_reached_and_missed(tmp_path / "scenes")
    config = RunConfig(
        out=tmp_path / "run",
        source=str(scenes),
        planner=f"{PLUGINS}:CoastPlanner",
        predictor=STILL,
    )
    folder = run_here(config)

    rows = read_rows(folder.rows)
    counts = [row.steps + 1 for row in rows]
    assert [row.measures["scored_states"] for row in rows] == counts
    assert '"scored_states": 11' in folder.rows.read_text()
    mean = sum(counts) / len(counts)  # The arms drive the same.
    summary = read_json(folder.summary)
    assert summary["with_dos"]["scored_states"] == pytest.approx(mean)
    assert summary["comparison"]["scored_states"]["difference"] == 0.0
    # Last of the table of its group: both arms, no difference.
    line = f"| States | {mean:.1f} | {mean:.1f} | +0.0 |"
    text = folder.summary_text.read_text()
    assert text.index("| Cycle p99 ms |") < text.index(line) < text.index("| Largest of a drive |")
    assert main(["compare", str(folder.path)]) == OK
    assert " States " in capsys.readouterr().out
    page = write_report(folder.path).read_text(encoding="utf-8")
    assert '<th scope="row">States of the scored part</th>' in page
    assert "<figcaption>States of the scored part</figcaption>" in page
    assert "how many states are scored" in metrics_page()
    pandas = pytest.importorskip("pandas", reason="pandas is an optional dependency")
    assert isinstance(frame := to_pandas(rows), pandas.DataFrame)
    assert frame["scored_states"].tolist() == counts
