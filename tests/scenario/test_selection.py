"""Choosing scenarios of a source: by id, by text or tag, by lot."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import pytest

from dosplan.scenario import ScenarioError, ScenarioRef, find_scenarios
from dosplan.scenario.commonroad.document import scan_tags
from dosplan.scenario.sources.catalogue import find_ids
from dosplan.scenario.sources.selection import SelectionError, matching, sampled
from tests.support.scenes import Problem, write_scenario_xml


def _write(folder: Path, name: str, tags: str = "", problems: int = 1) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}.xml"
    write_scenario_xml(
        path, problems=[Problem(id=100 + i) for i in range(problems)], benchmark_id=name
    )
    text = re.sub(r"<scenarioTags ?/>|<scenarioTags>.*?</scenarioTags>", "", path.read_text())
    listed = "".join(f"<{tag}/>" for tag in tags.split())
    before, lanelet, behind = text.partition("<lanelet ")
    path.write_text(f"{before}<scenarioTags>{listed}</scenarioTags>{lanelet}{behind}")
    return path


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "source"
    _write(folder, "DEU_Ring-1_1_T-1", "urban roundabout")
    _write(folder, "DEU_Ring-2_1_T-1", "urban merging_lanes")
    _write(folder, "USA_Way-1_1_T-1", "highway", problems=2)
    return folder


def _names(refs: list[ScenarioRef]) -> list[str]:
    return [ref.id for ref in refs]


@pytest.mark.parametrize(
    ("texts", "wanted"),
    [
        (["ring"], ["DEU_Ring-1_1_T-1", "DEU_Ring-2_1_T-1"]),
        (["Ring-2"], ["DEU_Ring-2_1_T-1"]),
        (["roundabout"], ["DEU_Ring-1_1_T-1"]),
        (["Merging Lanes"], ["DEU_Ring-2_1_T-1"]),
        (["highway"], ["USA_Way-1_1_T-1@100", "USA_Way-1_1_T-1@101"]),
        (["@101", "roundabout"], ["DEU_Ring-1_1_T-1", "USA_Way-1_1_T-1@101"]),
    ],
)
def test_a_text_is_part_of_the_id_or_a_tag(
    source: Path, texts: list[str], wanted: list[str]
) -> None:
    assert _names(matching(find_scenarios(source), texts)) == wanted


def test_a_tag_counts_as_a_whole_and_a_broken_file_has_none(source: Path) -> None:
    (source / "ZAM_Broken-1_1_T-1.xml").write_text("<commonRoad><scenarioTags><urban/>")
    refs = find_scenarios(source)
    with pytest.raises(SelectionError, match=r"--only round: none of 5 .* merging lanes, round"):
        matching(refs, ["round"])
    assert len(matching(refs, ["urban"])) == 2
    assert _names(matching(refs, ["broken"])) == ["ZAM_Broken-1_1_T-1"]


def test_the_suite_is_chosen_from_by_its_kinds_of_road() -> None:
    refs = find_scenarios("suite-1")
    rings = matching(refs, ["roundabout"])
    assert {ref.id.split("-")[0] for ref in rings} == {"ZAM_Roundabout"}
    assert {ref.id.split("-")[0] for ref in matching(refs, ["parked cars"])} == {"ZAM_Parked"}
    assert 0 < len(matching(refs, ["highway"])) < len(refs)  # A tag of its files.


def test_tags_are_read_as_either_version_writes_them(tmp_path: Path) -> None:
    old = tmp_path / "old.xml.gz"
    text = '<commonRoad commonRoadVersion="2018b" tags="urban  two_lane"><lanelet id="1"/>'
    old.write_bytes(gzip.compress(text.encode()))  # Nothing behind the root's start is read.
    assert scan_tags(old) == {"urban", "two_lane"}
    assert scan_tags(_write(tmp_path, "ZAM_A-1_1_T-1", "rural")) == {"rural"}
    assert scan_tags(_write(tmp_path, "ZAM_B-1_1_T-1")) == frozenset()


def test_a_sample_is_by_lot_and_stable(source: Path) -> None:
    refs = [ScenarioRef(Path(f"{i}.xml"), f"ZAM_A-{i}_1_T-1") for i in range(200)]
    sample = sampled(refs, 50, seed=0)
    assert len(sample) == 50
    assert sample == [ref for ref in refs if ref in sample]  # In the order of the source.
    assert sample != sampled(refs, 50, seed=1)
    assert sampled(refs[::-1], 50, seed=0)[::-1] == sample
    assert set(sampled(refs, 20, seed=0)) < set(sample) < set(sampled(refs, 80, seed=0))
    assert sampled(refs, 300, seed=0) == refs
    # Where the source was smaller, all that left the sample have made room for new ones.
    before = sampled(refs[:150], 50, seed=0)
    assert set(sample) - set(before) <= set(refs[150:])
    assert len(set(before) & set(sample)) >= 30


def test_ids_are_found_in_their_order(source: Path) -> None:
    wanted = ["USA_Way-1_1_T-1@101", "DEU_Ring-1_1_T-1", "USA_Way-1_1_T-1"]
    assert _names(find_ids(source, wanted)) == [
        "USA_Way-1_1_T-1@101",
        "DEU_Ring-1_1_T-1",
        "USA_Way-1_1_T-1@100",
    ]
    assert _names(find_ids("suite-1", ["ZAM_Zebra-7_1_T-1"])) == ["ZAM_Zebra-7_1_T-1"]
    with pytest.raises(ScenarioError, match=r"DEU_Rign-1_1_T-1; did you mean 'DEU_Ring-1"):
        find_ids(source, ["DEU_Rign-1_1_T-1"])


def test_several_sources_are_one(source: Path, tmp_path: Path) -> None:
    other = _write(tmp_path / "other", "DEU_Ring-1_1_T-1")
    listing = tmp_path / "list.txt"
    listing.write_text(f"{source}/USA_Way-1_1_T-1.xml\n")
    found = find_scenarios([f"@{listing}", source / "DEU_Ring-1_1_T-1.xml", other.parent])
    assert _names(found) == [
        "USA_Way-1_1_T-1@100",
        "USA_Way-1_1_T-1@101",
        # Those of one id are told apart, as within a source.
        f"DEU_Ring-1_1_T-1:{source}/DEU_Ring-1_1_T-1.xml",
        f"DEU_Ring-1_1_T-1:{other}",
    ]
    assert len(find_scenarios(["suite-1", other])) == len(find_scenarios("suite-1")) + 1
    assert _names(find_scenarios(["ZAM_Zebra-7_1_T-1", other])) == [
        "ZAM_Zebra-7_1_T-1",
        "DEU_Ring-1_1_T-1",
    ]
    with pytest.raises(ScenarioError, match="no-such: does not exist"):
        find_scenarios([other, "no-such"])
