"""What a worker in another folder is told: the same plug-ins, by absolute paths."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="Dask is an optional dependency")

from dosplan.plugins.registry import choose_predictor
from dosplan.running import dask_cluster as cluster
from dosplan.running.config import RunConfig
from tests.support.plugins import PLUGINS


def test_plugins_within_plugins_are_found_from_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(PLUGINS, tmp_path / "mine.py")
    (tmp_path / "net.safetensors").write_bytes(b"")
    monkeypatch.chdir(tmp_path)
    options = {"base": "mine.py:StillPredictor", "network": "net.safetensors", "threads": 2}
    config = RunConfig(out=Path("run"), planner="mine.py:CoastPlanner", predictor_options=options)
    wanted = choose_predictor("dos", options).settings
    sent = cluster._anywhere(config)
    assert (sent.planner, sent.predictor) == (f"{tmp_path}/mine.py:CoastPlanner", "dos")
    monkeypatch.chdir("/")
    found = choose_predictor(sent.predictor, sent.predictor_options).settings
    assert found.network == tmp_path / "net.safetensors"
    assert (found.base, found.threads, found.engine) == (wanted.base, 2, wanted.engine)
