"""Cases of files that say all that is needed, in ways that people's files have: they are driven."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from dosplan.scenario import load_scenario
from tests.fuzz.driving import check_usable, drive
from tests.fuzz.harness import Case
from tests.fuzz.originals import original


def odd_files(case: Case) -> None:
    """Units, steps, links, bounds, shapes and parts that nobody reads; nothing may be refused."""
    root = ElementTree.fromstring(original(case.random))
    chosen = case.random.sample(_ODDITIES, case.random.randint(1, 4))
    case.about = ", ".join(odd.__name__ for odd in chosen)
    for odd in chosen:
        odd(root, case.random)
    scenario = load_scenario(case.write("scene.xml", ElementTree.tostring(root)))
    check_usable(scenario)
    drive(scenario)


def _step(root: Element, generator: random.Random) -> None:
    root.set("timeStepSize", generator.choice(("0.04", "0.03", "0.0333333", "0.07", "0.25")))


def _units(root: Element, generator: random.Random) -> None:
    for value in root.iter("additionalValue"):
        value.text = generator.choice(("50kmh", "25 mph", "inf", "none", "fast", "8.33 m/s", ""))


def _one_sided_links(root: Element, generator: random.Random) -> None:
    gone = generator.choice(("successor", "predecessor", "adjacentLeft", "adjacentRight"))
    for lanelet in root.iterfind("lanelet"):
        for link in lanelet.findall(gone):
            lanelet.remove(link)


def _turned_bound(root: Element, generator: random.Random) -> None:
    bound = generator.choice(root.findall("lanelet/rightBound"))
    bound[:] = [*bound.findall("point")[::-1]]


def _fewer_points(root: Element, generator: random.Random) -> None:
    bound = generator.choice(root.findall("lanelet/leftBound"))
    for point in bound.findall("point")[1:-1:2]:
        bound.remove(point)


def _bay(root: Element, generator: random.Random) -> None:
    """A building with a bay, far off the road."""
    obstacle = Element("environmentObstacle", id="987654")
    SubElement(obstacle, "type").text = "building"
    polygon = SubElement(SubElement(obstacle, "shape"), "polygon")
    size = generator.uniform(1.0, 50.0)
    for x, y in ((0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)):
        point = SubElement(polygon, "point")
        SubElement(point, "x").text = repr(1e5 + size * x)
        SubElement(point, "y").text = repr(size * y)
    root.insert(len(root) - 1, obstacle)


def _unread(root: Element, generator: random.Random) -> None:
    for tag in generator.sample(("scenarioTags", "location", "trafficLight", "intersection"), 2):
        for part in root.findall(tag):
            root.remove(part)
    light = SubElement(root, "trafficLight", id=generator.choice(("x", "1", "")))
    place = SubElement(SubElement(light, "position"), "point")
    SubElement(place, "x").text = "inf"


def _any_heading(root: Element, _: random.Random) -> None:
    for goal in root.iterfind("planningProblem/goalState"):
        for old in goal.findall("orientation"):
            goal.remove(old)
        turned = SubElement(goal, "orientation")
        SubElement(turned, "intervalStart").text = "-3.141592653589793"
        SubElement(turned, "intervalEnd").text = "3.141592653589793"


_ODDITIES: Final[tuple[Callable[[Element, random.Random], None], ...]] = (
    _step, _units, _one_sided_links, _turned_bound, _fewer_points, _bay, _unread, _any_heading,
)  # fmt: skip
