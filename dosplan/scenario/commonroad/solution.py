"""CommonRoad solution files: what was driven, as CommonRoad's site and tools read it.

A solution names its model, cost function, scenario and format version in its benchmark id,
``KS2:WX1:<scenario>:<version>``: the kinematic single track (KS) with the parameters of vehicle 2,
as ``dosplan.vehicle`` has them, and the cost function WX1. A scenario of several planning problems
has one solution with a trajectory for each, ``[KS2,KS2]:[WX1,WX1]:...``.

By CommonRoad's convention the position of a state is the **centre** of the ego's rectangle; tools
find the rear axle, which the model moves, behind it. States are those at the file's own steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import numpy as np

from dosplan.scenario.commonroad.document import ScenarioError, read_document, read_file
from dosplan.scenario.commonroad.elements import FaultError, child, identity, number, step
from dosplan.scenario.commonroad.obstacles import Resampling
from dosplan.types import EGO_HEADING, EGO_STEERING, EGO_VELOCITY, STEP_SECONDS, FloatArray
from dosplan.vehicle import VehicleParameters

MODEL: Final = "KS2"
COST_FUNCTION: Final = "WX1"
_VEHICLE: Final = VehicleParameters()  # Vehicle 2, which MODEL names.


@dataclass(frozen=True)
class Trajectory:
    """What was driven for one planning problem, in steps of 0.1 s.

    Attributes:
        start_step: Step of the first state.
        states: (K + 1, 5) driven ego states.
        inputs: (K, 2) inputs that were applied.
        seconds: Time that predicting and planning took, s.
    """

    start_step: int
    states: FloatArray
    inputs: FloatArray
    seconds: float


def solution_xml(
    path: Path,
    drives: Mapping[int | None, Trajectory],
    date: datetime,
    traffic: str | None = None,
) -> bytes:
    """Writes what was driven in a scenario file as a CommonRoad solution.

    The states are those at the file's own steps; between two steps of 0.1 s they follow from the
    vehicle model. Where the file's steps are longer, a drive is cut at the last of them.

    Args:
        path: The scenario file.
        drives: The drive of each planning problem that has one, by its id; None stands for the
            only problem of a file that holds one.
        date: When it was driven.
        traffic: Name of the traffic, where the road users did not drive as recorded. A comment in
            the solution says so: whoever checks it against the recorded ones judges another drive.

    Returns:
        The solution as XML.

    Raises:
        ScenarioError: The scenario file cannot be read or does not hold these problems.
    """
    scenario = read_document(path, read_file(path)).root
    try:
        problems = {identity(x): x for x in scenario.iterfind("planningProblem")}
        dt = number(scenario.get("timeStepSize"), "its timeStepSize")
        resamplings = {
            name: Resampling.of(dt, step(child(problem, "initialState")))
            for name, problem in problems.items()
        }
    except FaultError as error:
        raise ScenarioError(path, str(error)) from None
    by_id = {
        next(iter(problems)) if name is None and len(problems) == 1 else name: drive
        for name, drive in drives.items()
    }
    if unknown := by_id.keys() - problems.keys():
        raise ScenarioError(path, f"holds no planning problem {min(unknown, key=str)}")
    driven = [(name, by_id[name]) for name in problems if name in by_id]
    root = ElementTree.Element(
        "CommonRoadSolution",
        benchmark_id=":".join(
            (
                _listed(MODEL, len(driven)),
                _listed(COST_FUNCTION, len(driven)),
                scenario.get("benchmarkID", ""),
                scenario.get("commonRoadVersion", ""),
            )
        ),
        date=date.strftime("%Y-%m-%dT%H:%M:%S"),
    )
    if seconds := sum(drive.seconds for _, drive in driven):
        root.set("computation_time", f"{seconds:.3f}")
    if traffic is not None:
        who = traffic.replace("--", "- -")  # Which would end a comment.
        root.append(ElementTree.Comment(f" driven among {who}, not the recorded road users "))
    for name, drive in driven:
        root.append(_trajectory(name, drive, resamplings[name]))
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _listed(name: str, count: int) -> str:
    return name if count == 1 else f"[{','.join([name] * count)}]"


def _trajectory(problem: int, drive: Trajectory, resampling: Resampling) -> ElementTree.Element:
    element = ElementTree.Element("ksTrajectory", planningProblem=str(problem))
    states = _at_file_steps(drive, resampling)
    first = (drive.start_step * resampling.every + resampling.begin) // resampling.times
    centres = _VEHICLE.centre(states)
    for time, (state, centre) in enumerate(zip(states, centres, strict=True), first):
        row = ElementTree.SubElement(element, "ksState")
        for tag, value in (
            ("x", centre[0]),
            ("y", centre[1]),
            ("steeringAngle", state[EGO_STEERING]),
            ("velocity", state[EGO_VELOCITY]),
            ("orientation", state[EGO_HEADING]),
        ):
            ElementTree.SubElement(row, tag).text = repr(float(value))
        ElementTree.SubElement(row, "time").text = str(time)
    return element


def _at_file_steps(drive: Trajectory, resampling: Resampling) -> FloatArray:
    """(K', 5) states at the steps of the file."""
    shares = np.arange(1, resampling.every) / resampling.every
    between = [
        _VEHICLE.step(drive.states[:-1], drive.inputs, share * STEP_SECONDS) for share in shares
    ]
    rows = np.stack([drive.states[:-1], *between], axis=1).reshape(-1, drive.states.shape[1])
    return np.concatenate([rows, drive.states[-1:]])[:: resampling.times]
