"""``scenarios/suite.py``: the published suites are made over only as they were made."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("sumo", reason="needs dosplan[suite]")

import suite
from suitegen import suite as first
from suitegen.futures import suite as futures


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The folders that suites are built in, but nothing is built."""
    folders: list[Path] = []

    def build(seed: int, count: int, out: Path, *rest: object) -> bool:
        folders.append(out)
        return True

    monkeypatch.setattr(suite, "version", lambda package: suite.SUMO_VERSION)
    for module in (first, futures):
        monkeypatch.setattr(module, "build_suite", build)
    return folders


@pytest.mark.parametrize("name", ["suite", "suite-1"])
@pytest.mark.parametrize(
    "other",
    [("--split", "train"), ("--seed", "2"), ("--count", "10"), ("--kinds", "Door")],
)
def test_another_suite_needs_a_folder_of_its_own(
    name: str,
    other: tuple[str, str],
    built: list[Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ("--suite", name, *other)
    with pytest.raises(SystemExit) as ended:
        suite.main(arguments)
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert f"{suite.FOLDERS[name]} holds the published suite" in told
    assert not built
    if (name, other[0]) != ("suite-1", "--kinds"):
        assert suite.main((*arguments, "--out", str(tmp_path))) == 0
        assert built == [tmp_path]


@pytest.mark.parametrize("name", ["suite", "suite-1"])
def test_the_published_suite_goes_to_its_place(name: str, built: list[Path]) -> None:
    assert suite.main(("--suite", name)) == 0
    assert suite.main(("--suite", name, "--seed", "1", "--split", "suite", "--jobs", "2")) == 0
    assert built == [suite.FOLDERS[name]] * 2
