"""A folder is listed whole, whatever lies in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from dosplan.scenario import ScenarioError, find_scenarios, load_scenario
from dosplan.scenario.commonroad import document
from dosplan.scenario.sources.catalogue import Source
from tests.support.scenes import Problem, write_scenario_xml


def test_broken_files_of_one_name_are_told_apart_by_their_paths(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "broken.xml").write_text("<commonRoad")
    (tmp_path / "alone.xml").write_text("<commonRoad")
    (tmp_path / "ZAM_A-1_1_T-1.xml").write_text("<commonRoad")
    write_scenario_xml(tmp_path / "good.xml", benchmark_id="ZAM_A-1_1_T-1")
    assert [ref.id for ref in find_scenarios(tmp_path)] == [
        "ZAM_A-1_1_T-1.xml",  # The good file has the stem of this broken one for its id.
        "a/broken.xml",
        "alone",
        "b/broken.xml",
        "ZAM_A-1_1_T-1",
    ]


def test_a_file_is_read_again_only_when_it_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_scenario_xml(tmp_path / "a.xml", benchmark_id="ZAM_A-1_1_T-1")
    write_scenario_xml(tmp_path / "b.xml", benchmark_id="ZAM_B-1_1_T-1")
    first = find_scenarios(tmp_path)
    read: list[str] = []

    def read_file(path: Path) -> bytes:
        read.append(path.name)
        return path.read_bytes()

    monkeypatch.setattr(document, "read_file", read_file)
    assert find_scenarios(tmp_path) == first
    assert read == []
    path.write_text(path.read_text().replace("ZAM_A-1_1", "ZAM_C-1_1"))  # No byte longer.
    assert [ref.id for ref in find_scenarios(tmp_path)] == ["ZAM_C-1_1_T-1", "ZAM_B-1_1_T-1"]
    assert read == ["a.xml"]


def test_hidden_files_are_passed_over(tmp_path: Path) -> None:
    write_scenario_xml(tmp_path / "a.xml", benchmark_id="ZAM_A-1_1_T-1")
    (tmp_path / "._a.xml").write_bytes(b"\0\5\x16\7")  # What macOS leaves in archives.
    (tmp_path / ".trash").mkdir()
    write_scenario_xml(tmp_path / ".trash" / "a.xml", benchmark_id="ZAM_A-1_1_T-1")
    assert [ref.path.name for ref in find_scenarios(tmp_path)] == ["a.xml"]


def test_a_name_that_no_file_can_have_is_one_line() -> None:
    sources: tuple[Source, ...] = ("a" * 300, ["suite", "b" * 300])
    for source in sources:
        with pytest.raises(ScenarioError, match=r"[ab]{300}: does not exist"):
            find_scenarios(source)


def test_files_of_one_id_are_told_apart_by_their_paths(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    name = "ZAM_A-1_1_T-1"
    write_scenario_xml(tmp_path / "alone.xml", benchmark_id="ZAM_B-1_1_T-1")
    write_scenario_xml(tmp_path / "b" / "first.xml", benchmark_id=name)
    two = [Problem(id=100), Problem(id=101)]
    write_scenario_xml(tmp_path / "second.xml", problems=two, benchmark_id=name)
    refs = find_scenarios(tmp_path)
    assert [ref.id for ref in refs] == [
        "ZAM_B-1_1_T-1",
        f"{name}:b/first.xml",
        f"{name}:second.xml@100",
        f"{name}:second.xml@101",
    ]
    assert [ref.scenario for ref in refs[1:]] == [
        f"{name}:b/first.xml",
        *[f"{name}:second.xml"] * 2,
    ]
    assert [load_scenario(ref).id for ref in refs] == [ref.id for ref in refs]


def test_a_planning_problem_that_is_named_twice_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    write_scenario_xml(
        path, problems=[Problem(id=100), Problem(id=100)], benchmark_id="ZAM_A-1_1_T-1"
    )
    with pytest.raises(ScenarioError, match="names planning problem 100 twice; give one another"):
        load_scenario(*find_scenarios(path))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_problems_are_counted_whatever_surrounds_them(tmp_path: Path, encoding: str) -> None:
    """Files with one problem are listed by a shortcut, which must not be seen."""
    one, two = tmp_path / "one.xml", tmp_path / "two.xml"
    write_scenario_xml(one, benchmark_id="ZAM_A-1_1_T-1")
    problems = [Problem(id=100), Problem(id=101)]
    write_scenario_xml(two, problems=problems, benchmark_id="ZAM_B-1_1_T-1")
    for path in (one, two):
        text = path.read_text()
        head = f'<?xml version="1.0" encoding="{encoding}"?>'
        body = text.partition("?>")[2] if text.startswith("<?xml") else text
        commented = "<!-- <planningProblem id='7'> --><planningProblem"
        body = body.replace("<planningProblem", commented, 1)
        path.write_text(head + body, encoding=encoding)
    assert [ref.id for ref in find_scenarios(tmp_path)] == [
        "ZAM_A-1_1_T-1",
        "ZAM_B-1_1_T-1@100",
        "ZAM_B-1_1_T-1@101",
    ]


def test_a_folder_that_may_not_be_looked_into_is_not_called_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path) -> bool:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "is_dir", refuse)
    with pytest.raises(PermissionError):
        find_scenarios(str(tmp_path / "closed"))
