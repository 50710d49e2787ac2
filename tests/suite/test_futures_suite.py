"""What happens to a suite where a scene cannot be drawn, and where making it was cut off."""

from __future__ import annotations

import csv
import os
import signal
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sumo", reason="needs dosplan[suite]")
pytest.importorskip("libsumo", reason="needs dosplan[suite]")

from dosplan_sumo.simulator import SumoError
from suitegen.futures import build as building
from suitegen.futures import suite as making
from suitegen.futures.build import Built, Place
from suitegen.futures.simulate import RejectedError
from suitegen.futures.suite import UNFINISHED, build_suite

KINDS = ("Jaywalker", "Door", "CutIn")


def _built(place: Place, seed: int, attempt: int) -> Built:
    name = place.benchmark_id
    row = {"id": name, "source": place.source(seed), "attempt": str(attempt)}
    drive = np.full((2, 4), 0.1 + attempt)
    return Built({f"files/{name}": b"scenario"}, row, (drive,), 3, Counter())


def _crashes_at_first(place: Place, seed: int, attempt: int) -> Built:
    """As SUMO does it: the process is gone, and nothing is raised."""
    if place.kind == "Door" and attempt == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return _built(place, seed, attempt)


def _killed_once(place: Place, seed: int, attempt: int) -> Built:
    mark = Path(f"{os.environ['MARKS']}/{place.kind}")
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return _built(place, seed, attempt)


def _never_door(place: Place, seed: int, attempt: int) -> Built:
    if place.kind == "Door":
        raise RejectedError("no door opens")
    return _built(place, seed, attempt)


def _attempts(out: Path) -> dict[str, str]:
    with (out / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        return {row["id"]: row["attempt"] for row in csv.DictReader(stream)}


def test_a_crash_of_sumo_costs_one_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(making, "attempt_at", _crashes_at_first)
    assert build_suite(1, 3, tmp_path, "suite", KINDS, jobs=2, resume=False)
    attempts = {
        name.split("-")[0].removeprefix("ZAM_"): n for name, n in _attempts(tmp_path).items()
    }
    assert attempts == {"Jaywalker": "0", "Door": "1", "CutIn": "0"}
    assert "1  SUMO takes its process down" in capsys.readouterr().out


def test_a_process_that_is_killed_by_chance_changes_no_suite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "marks").mkdir()
    monkeypatch.setenv("MARKS", str(tmp_path / "marks"))
    monkeypatch.setattr(making, "attempt_at", _killed_once)
    assert build_suite(1, 3, tmp_path / "out", "suite", KINDS, jobs=1, resume=False)
    assert set(_attempts(tmp_path / "out").values()) == {"0"}


def test_what_sumo_cannot_drive_is_rejected_with_its_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(place: Place, seed: int, attempt: int, folder: Path) -> Built:
        raise SumoError("SUMO: Vehicle 'other' has no valid route.")

    monkeypatch.setattr(building, "_attempt", fails)
    with pytest.raises(RejectedError, match="no valid route"):
        building.attempt_at(Place("suite", "Door", 1), 1, 0)


def test_a_suite_that_was_cut_off_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(making, "attempt_at", _never_door)
    assert not build_suite(1, 3, tmp_path, "suite", KINDS, jobs=1, resume=False)
    assert not (tmp_path / "manifest.csv").exists()
    assert len(list((tmp_path / UNFINISHED).iterdir())) == 2

    drawn = []

    def draws(place: Place, seed: int) -> Built:
        drawn.append(place.kind)
        return _built(place, seed, 7)

    monkeypatch.setattr(making, "_build_apart", draws)
    assert build_suite(1, 3, tmp_path, "suite", KINDS, jobs=1, resume=True)
    assert drawn == ["Door"]
    assert list(_attempts(tmp_path).values()) == ["0", "7", "0"]
    assert not (tmp_path / UNFINISHED).exists()


def test_nothing_of_another_seed_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(making, "attempt_at", _never_door)
    assert not build_suite(1, 3, tmp_path, "suite", KINDS, jobs=1, resume=False)
    monkeypatch.setattr(making, "_build_apart", lambda place, seed: _built(place, seed, 7))
    assert build_suite(2, 3, tmp_path, "suite", KINDS, jobs=1, resume=True)
    assert set(_attempts(tmp_path).values()) == {"7"}
