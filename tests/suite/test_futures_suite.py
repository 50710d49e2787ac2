"""What happens to a suite where a scene cannot be drawn, and where making it was cut off."""

from __future__ import annotations

import csv
import os
import signal
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("sumo", reason="needs dosplan[suite]")
pytest.importorskip("libsumo", reason="needs dosplan[suite]")

from dosplan_sumo.simulator import SumoError
from suitegen.futures import build as building
from suitegen.futures import simulate as simulating
from suitegen.futures import suite as making
from suitegen.futures.build import Built, Place
from suitegen.futures.kinds import KINDS as KINDS_OF_SUITE
from suitegen.futures.simulate import RejectedError
from suitegen.futures.staging import Staging
from suitegen.futures.suite import UNFINISHED, build_suite
from suitegen.manifest import FOLDERS, remove_left_over
from suitegen.networks import ROAD_KINDS
from suitegen.plain import compile_network
from suitegen.roads import Rng

KINDS = ("Jaywalker", "Door", "CutIn")
SCENARIOS = Path(__file__).resolve().parents[2] / "scenarios"


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


def test_a_road_that_netconvert_refuses_is_rejected_with_its_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Another scene is drawn then: it is no end of the place."""
    kind = KINDS_OF_SUITE["Door"]

    def nowhere(rng: Rng) -> Staging:
        staging = kind.draw(rng)
        edges = [replace(edge, target="nowhere") for edge in staging.road.network.edges]
        network = replace(staging.road.network, edges=tuple(edges))
        return replace(staging, road=replace(staging.road, network=network))

    monkeypatch.setattr(building, "KINDS", {"Door": replace(kind, draw=nowhere)})
    with pytest.raises(RejectedError, match=r"^netconvert failed: .*nowhere") as caught:
        building.attempt_at(Place("suite", "Door", 1), 1, 0)
    assert "\n" not in str(caught.value)


def test_a_scene_of_two_pasts_is_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    staging = KINDS_OF_SUITE["Door"].draw(rng)
    starts = iter(range(5))

    def drives(*arguments: object) -> SimpleNamespace:
        return SimpleNamespace(start=next(starts), traces=())

    monkeypatch.setattr(simulating, "_run", drives)
    acts = [staging.futures(k, rng) for k in range(2)]
    net = compile_network(staging.road.network, tmp_path)
    with pytest.raises(RejectedError, match="two pasts"):
        simulating.simulate(staging, acts, net, tmp_path, rng)


def _with_files(place: Place, seed: int) -> Built:
    built = _built(place, seed, 0)
    name = place.benchmark_id
    names = (
        f"files/{name}.xml.gz",
        f"futures/{name}.npz",
        f"sumo-files/{name}.rou.xml.gz",
        f"sumo-files/{name.removesuffix('_1_T-1')}.net.xml.gz",
    )
    return replace(built, files=dict.fromkeys(names, b"scenario"))


def test_a_smaller_suite_leaves_nothing_of_a_larger_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(making, "_build_apart", _with_files)

    def made(count: int, kinds: Sequence[str], split: str = "suite") -> set[str]:
        assert build_suite(1, count, tmp_path, split, kinds, jobs=1, resume=False)
        return {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*z")}

    assert len(made(5, KINDS)) == 4 * 5 + 1
    # What is somebody's own stays, and so does all that lies elsewhere.
    own = {
        "files/notes.gz",
        "files/ZAM_Doors-1_1_T-1.xml.gz",
        "futures/DEU_A-1_1_T-1.npz",
        "ZAM_CutIn-1_1_T-1.xml.gz",
        "other/ZAM_CutIn-1_1_T-1.xml.gz",
    }
    for name in own:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"own")
    one = {
        "drives.csv.gz",
        "files/ZAM_Door-1_1_T-1.xml.gz",
        "futures/ZAM_Door-1_1_T-1.npz",
        "sumo-files/ZAM_Door-1_1_T-1.rou.xml.gz",
        "sumo-files/ZAM_Door-1.net.xml.gz",
    }
    assert made(1, ["Door"]) == own | one
    train = {name.replace("Door-1", "Door-501") for name in one}
    assert made(1, ["Door"], "train") == own | train


@pytest.mark.parametrize(("name", "of"), [("suite", KINDS_OF_SUITE), ("suite-1", ROAD_KINDS)])
def test_what_the_shipped_suites_name_is_kept_and_all_else_of_them_is_known(
    name: str, of: Mapping[str, object], tmp_path: Path
) -> None:
    """On empty files of the same names."""
    shipped = SCENARIOS / name
    with (shipped / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        ids = {row["id"] for row in csv.DictReader(stream)}
    for file in (file for part in FOLDERS for file in (shipped / part).glob("*")):
        (tmp_path / file.parent.name).mkdir(exist_ok=True)
        (tmp_path / file.parent.name / file.name).touch()
    before = sorted(tmp_path.rglob("*.*"))
    remove_left_over(tmp_path, ids, of)
    assert sorted(tmp_path.rglob("*.*")) == before
    remove_left_over(tmp_path, set(), of)
    assert not list(tmp_path.rglob("*.*"))


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
