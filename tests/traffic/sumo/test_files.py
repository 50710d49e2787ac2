"""Files of SUMO beside a scenario: found, and not trusted."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import pytest
from dosplan_sumo.demand import read_demand, read_offset, write_demand
from dosplan_sumo.traffic import SumoTraffic

from dosplan.scenario import ScenarioError, find_scenarios, load_scenario
from dosplan.scenario.sources.sumo import read_configuration
from dosplan.simulation.traffic import Replay
from tests.support.sumo import ZEBRA, interactive_folder, suite_file


def _configured(folder: Path, text: str) -> Path:
    for name in ("a.net.xml", "a.rou.xml"):
        (folder / name).write_text("<net/>" if "net" in name else "<routes/>")
    path = folder / "a.sumo.cfg"
    path.write_text(f"<configuration>{text}</configuration>")
    return path


INPUTS = '<net-file value="a.net.xml"/><route-files value="a.rou.xml"/>'


def test_every_scenario_of_the_suite_has_files_of_sumo() -> None:
    for ref in find_scenarios("suite-1"):
        assert len(list(SumoTraffic.reads(ref.path))) == 3, ref.id


def test_of_a_configuration_inputs_and_how_to_drive_are_taken(tmp_path: Path) -> None:
    path = _configured(
        tmp_path,
        f"<input>{INPUTS}</input><output><fcd-output value='/tmp/x'/></output>"
        "<processing><lateral-resolution v='0.4'/><collision.action value='remove'/></processing>"
        "<random_number><seed value='7'/></random_number><log value='log.txt'/>",
    )
    assert read_configuration(path).options == {"lateral-resolution": "0.4", "seed": "7"}


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "names no <net-file>"),
        ('<net-file value="a.net.xml"/>', "names no <route-files>"),
        (INPUTS.replace("a.rou", "b.rou"), "names b.rou.xml, which is not there"),
        (INPUTS.replace("a.net", "../a.net"), "not in its folder"),
        (INPUTS.replace("a.net.xml", "/etc/passwd"), "not in its folder"),
        (INPUTS.replace("a.rou.xml", "a.rou.xml,link.rou.xml"), "not in its folder"),
        (INPUTS + '<additional-files value="x\x7f/../../y"/>', "not in its folder"),
        (INPUTS + '<seed value="1 --fcd-output x"/>', "<seed> no value that it can have"),
        (INPUTS + '<ignore-route-errors value="--fcd-output"/>', "<ignore-route-errors> no value"),
        (INPUTS + '<lateral-resolution value="-v"/>', "<lateral-resolution> no value"),
        (INPUTS + '<begin value="soon"/>', "<begin> no value that it can have"),
        ("<net-file", "is not complete XML"),
    ],
)
def test_a_configuration_without_sense_is_one_line(tmp_path: Path, text: str, line: str) -> None:
    (tmp_path / "inside").mkdir()
    (tmp_path / "secret.rou.xml").write_text("<routes/>")
    (tmp_path / "inside" / "link.rou.xml").symlink_to(tmp_path / "secret.rou.xml")
    path = _configured(tmp_path / "inside", text)
    with pytest.raises(ScenarioError, match=line) as raised:
        read_configuration(path)
    assert "\n" not in str(raised.value)
    assert str(path) in str(raised.value)


LANE = '<edge id="a"><lane id="a_0"/></edge>'


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("<net/>", "without <location> or lanes"),
        ("<routes/>", "is a <routes>, not a network"),
        (f"<net><location netOffset='0,0'/>{LANE}<include href='/etc/passwd'/></net>", "includes"),
        (f"<net><location netOffset='0'/>{LANE}</net>", "no netOffset of two numbers"),
        (
            f"<net><location netOffset='0,0'/>{LANE}<tlLogic id='t' type='actuated'>"
            "<param key='file' value='/tmp/x'/></tlLogic></net>",
            "has traffic light t write a file",
        ),
        ("<!DOCTYPE net [<!ENTITY e 'x'>]><net/>", "DOCTYPE"),
    ],
)
def test_a_network_that_sumo_must_not_see_is_one_line(tmp_path: Path, text: str, line: str) -> None:
    path = tmp_path / "a.net.xml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=line):
        read_offset(path)


def test_what_is_no_traffic_is_left_out_of_a_demand(tmp_path: Path) -> None:
    path = _configured(tmp_path, INPUTS)
    (tmp_path / "a.rou.xml").write_text(
        "<routes><e1Detector id='d' lane='a_0' pos='1' file='/tmp/x'/><include href='/etc/passwd'/>"
        "<vType id='t' vClass='truck'><param key='has.ssm.device' value='true'/></vType>"
        "<vehicle id='v' depart='0'><route edges='a b'/><param key='device.ssm.file' value='/x'/>"
        "<param key='colour' value='red'/></vehicle><edgeData id='e' file='/tmp/x'/></routes>"
    )
    (tmp_path / "out").mkdir()
    demand = write_demand(read_demand(read_configuration(path)), tmp_path / "out")
    (written,) = demand.files
    text = written.read_text()
    assert "colour" in text
    for word in ("e1Detector", "include", "ssm", "edgeData", "/tmp/x"):
        assert word not in text
    assert (demand.users, demand.routes, demand.types) == (("v",), (("a", "b"),), {"truck": "t"})


def test_an_interactive_folder_is_one_scenario_whose_pickle_nobody_opens(tmp_path: Path) -> None:
    scene = interactive_folder(tmp_path)
    # Whoever opens a pipe that nobody writes to waits for ever.
    os.mkfifo(scene.with_name("simulation_config.p"))
    (ref,) = find_scenarios(tmp_path)
    scenario = load_scenario(ref)
    assert scenario.sumo == scene.with_name(f"{ZEBRA}.sumo.cfg")
    assert SumoTraffic.refuses(scenario) is None
    assert "--traffic sumo" in (Replay.refuses(scenario) or "")


def test_a_broken_file_of_sumo_is_no_scenario_of_its_own(tmp_path: Path) -> None:
    scene = interactive_folder(tmp_path)
    scene.with_name(f"{ZEBRA}.net.xml").write_text("<net")
    (ref,) = find_scenarios(tmp_path)
    line = SumoTraffic.refuses(load_scenario(ref)) or ""
    assert f"{ZEBRA}.net.xml: is not complete XML" in line


def test_an_archive_brings_the_files_of_sumo_and_no_pickle(tmp_path: Path) -> None:
    scene = interactive_folder(tmp_path / "in")
    scene.with_name("simulation_config.p").write_bytes(b"cos\nsystem\n(S'false'\ntR.")
    with zipfile.ZipFile(tmp_path / "all.zip", "w") as archive:
        for file in sorted((tmp_path / "in").rglob("*")):
            archive.write(file, file.relative_to(tmp_path / "in"))
    (ref,) = find_scenarios(tmp_path / "all.zip")
    assert SumoTraffic.refuses(load_scenario(ref)) is None
    assert not list(ref.path.parent.glob("*.p"))


def test_the_cache_does_not_keep_where_the_files_of_sumo_are(tmp_path: Path) -> None:
    scene = interactive_folder(tmp_path)
    assert load_scenario(scene, cached=True).sumo is not None
    scene.with_name(f"{ZEBRA}.sumo.cfg").unlink()
    assert load_scenario(scene, cached=True).sumo is None
    line = SumoTraffic.refuses(load_scenario(scene, cached=True)) or ""
    assert f"put {ZEBRA}.sumo.cfg there" in line


def test_a_scenario_of_the_suite_knows_its_files_in_every_folder() -> None:
    scenario = load_scenario(suite_file(ZEBRA))
    assert not scenario.interactive
    assert scenario.sumo is not None
    assert Replay.refuses(scenario) is None
