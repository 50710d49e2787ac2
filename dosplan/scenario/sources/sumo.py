"""Files of SUMO beside a scenario, with which SUMO can drive its traffic.

They lie as CommonRoad ships its interactive scenarios: beside ``NAME.cr.xml`` a configuration
``NAME.sumo.cfg``, which names the others. Those of the embedded suite lie in a folder of their own.
A pickled configuration that may be there as well is never opened.

None of them is trusted. Of a configuration, the names of the inputs are taken, which have to lie in
its folder, and options that say how traffic is driven; what it wants to write is left out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dosplan.scenario.commonroad.document import ScenarioError, parse_xml, read_file, stem, unpacked

CONFIGURATIONS: Final = (".sumo.cfg", ".sumocfg")
_INPUTS: Final = tuple(
    f".{part}.xml{packed}" for part in ("net", "rou", "add") for packed in ("", ".gz")
)
ACTS: Final = ".futures.json.gz"
"""Ending of the file that says what happens in a scenario's futures, after the scenario's name."""
FOLDER: Final = "sumo-files"
"""Folder beside that of the scenario files in which the files of SUMO may lie."""
OPTIONS: Final = frozenset(
    {
        "begin",
        "collision.check-junctions",
        "collision.mingap-factor",
        "default.action-step-length",
        "default.speeddev",
        "extrapolate-departpos",
        "ignore-junction-blocker",
        "ignore-route-errors",
        "lanechange.duration",
        "lateral-resolution",
        "max-depart-delay",
        "pedestrian.model",
        "route-steps",
        "scale",
        "seed",
        "step-method.ballistic",
        "time-to-impatience",
    }
)
"""Options of a configuration that are taken over."""
_VALUE: Final = re.compile(r"(?=.{1,32}$)(-?[0-9.]|[A-Za-z])[A-Za-z0-9.+-]*")
"""A word or a number: what begins with a sign and a letter is another option of SUMO."""


@dataclass(frozen=True)
class SumoFiles:
    """What a configuration of SUMO names.

    Attributes:
        configuration: The configuration itself.
        net: The network.
        routes: Files of the demand.
        additional: Files with what else is in the network, such as types and stops.
        options: Options of ``OPTIONS``, as texts.
    """

    configuration: Path
    net: Path
    routes: tuple[Path, ...]
    additional: tuple[Path, ...]
    options: Mapping[str, str]

    @property
    def all(self) -> tuple[Path, ...]:
        """Every file, the configuration first."""
        return (self.configuration, self.net, *self.routes, *self.additional)


def is_of_sumo(name: str) -> bool:
    """Whether a file is SUMO's and no scenario, by its name.

    Args:
        name: Its name, without the folder.

    Returns:
        Whether it is.
    """
    return name.lower().endswith((*CONFIGURATIONS, *_INPUTS, ACTS))


def configuration_of(scenario: Path) -> Path | None:
    """Finds the configuration of SUMO for a scenario.

    Args:
        scenario: The scenario file.

    Returns:
        The file; None where there is none, and for a file behind a URL.
    """
    if not isinstance(scenario, Path) or "://" in str(scenario):
        return None
    name = stem(scenario).removesuffix(".cr")
    folders = (scenario.parent, scenario.parent.parent / FOLDER)
    places = (folder / f"{name}{ending}" for folder in folders for ending in CONFIGURATIONS)
    return next((place for place in places if place.is_file()), None)


def read_configuration(path: Path) -> SumoFiles:
    """Reads which files a configuration names, and how traffic is to be driven.

    Args:
        path: The configuration.

    Returns:
        Both; every file is there.

    Raises:
        ScenarioError: It cannot be read, names no network or no demand, or a file that is not
            there or not in its folder; or an option has no value that it can have.
    """
    root = parse_xml(path, read_file(path))
    values: dict[str, str] = {}
    for element in root.iter():
        # The value stands in an attribute, whose name may be one letter; sections have none.
        value = element.get("value", element.get("v"))
        if value is not None:
            values[element.tag] = value.strip()
    found = {
        option: _files(path, values.get(option, ""))
        for option in ("net-file", "route-files", "additional-files")
    }
    if len(found["net-file"]) != 1:
        raise ScenarioError(path, "names no <net-file>; SUMO needs one to drive on")
    if not found["route-files"]:
        raise ScenarioError(path, "names no <route-files>; SUMO needs them to know who drives")
    for option in OPTIONS & values.keys():
        begins = option != "begin" or _is_number(values[option])
        if not begins or not _VALUE.fullmatch(values[option]):
            raise ScenarioError(path, f"gives <{option}> no value that it can have; correct it")
    return SumoFiles(
        configuration=path,
        net=found["net-file"][0],
        routes=found["route-files"],
        additional=found["additional-files"],
        options={option: values[option] for option in sorted(OPTIONS & values.keys())},
    )


def read_xml(path: Path) -> bytes:
    """Reads a file of SUMO.

    Args:
        path: The file, compressed or not.

    Returns:
        The XML.

    Raises:
        ScenarioError: It cannot be read.
    """
    return unpacked(path, read_file(path))


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _files(configuration: Path, names: str) -> tuple[Path, ...]:
    folder = configuration.parent
    found = []
    for name in filter(None, re.split(r"[,\s]+", names)):
        try:
            place = (folder / name).resolve()
            inside = place.is_relative_to(folder.resolve())
            there = inside and place.is_file()
        except (OSError, ValueError):
            inside = there = False
        if not inside:
            raise ScenarioError(
                configuration, f"names {name[:80]}, which is not in its folder; do not trust it"
            )
        if not there:
            raise ScenarioError(
                configuration, f"names {name[:80]}, which is not there; put it beside it"
            )
        found.append(folder / name)
    return tuple(found)
