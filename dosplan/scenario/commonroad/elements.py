"""Reads the values of a scenario file's elements, and names each one that cannot be read.

Code that reads a part names it (``naming``), so that a message leads from the part that a user
knows to the wrong value: ``obstacle 7: state 12: the <velocity> is 'fast', no number; correct it``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from dosplan.system.errors import DosplanError
from dosplan.types import FloatArray
from dosplan.types.arrays import MAX_NUMBER

_SHOWN: Final = 40
"""Characters of a text that a message shows."""
_LARGEST_ID: Final = 2**63 - 1
_NAMES: Final = {
    "planningProblem": "planning problem",
    "trafficSign": "traffic sign",
    "trafficLight": "traffic light",
    "dynamicObstacle": "obstacle",
    "staticObstacle": "obstacle",
    "environmentObstacle": "obstacle",
}


class FaultError(DosplanError, ValueError):
    """What is wrong with a part of a scenario file; the code that knows the file adds its name."""


@contextmanager
def naming(name: str) -> Iterator[None]:
    """Names the part that is read, in front of any fault that is found within.

    Args:
        name: What a user calls it: ``lanelet 101``.

    Raises:
        FaultError: The fault, with the name.
    """
    try:
        yield
    except FaultError as error:
        raise FaultError(f"{name}: {error}") from None


def quoted(text: str | None) -> str:
    """A text of the file for a message, cut where it is long."""
    plain = " ".join((text or "").split())
    return f"'{plain if len(plain) <= _SHOWN else plain[:_SHOWN] + '...'}'"


def label(element: Element) -> str:
    """How messages call an element that has an id: ``obstacle 7``."""
    return f"{_NAMES.get(element.tag, element.tag)} {element.get('id')}"


def number(text: str | None, what: str) -> float:
    """A finite number.

    Args:
        text: What the file holds.
        what: What it is, for messages: ``the <length>``.

    Returns:
        The number.

    Raises:
        FaultError: It is none, or larger than ``MAX_NUMBER``.
    """
    try:
        value = float(text or "")
    except ValueError:
        raise FaultError(f"{what} is {quoted(text)}, no number; correct it") from None
    if not abs(value) <= MAX_NUMBER:
        raise FaultError(
            f"{what} is {quoted(text)}, no finite number up to {MAX_NUMBER:g}; correct it"
        )
    return value


def whole(text: str | None, what: str) -> int:
    """A whole number, written as one or as ``3.0``.

    Args:
        text: What the file holds.
        what: What it is, for messages.

    Returns:
        The number.

    Raises:
        FaultError: It is none.
    """
    value = number(text, what)
    if not value.is_integer():
        raise FaultError(f"{what} is {quoted(text)}, no whole number; correct it")
    return int(value)


def identity(element: Element) -> int:
    """The id of an element.

    Args:
        element: The element.

    Returns:
        Its id.

    Raises:
        FaultError: It has none that is a whole number of 64 bits.
    """
    text = element.get("id")
    with suppress(ValueError):
        if abs(found := int(text or "")) <= _LARGEST_ID:
            return found
    raise FaultError(
        f"{_NAMES.get(element.tag, element.tag)} has the id {quoted(text)}; "
        "give it a whole number of 64 bits"
    )


def references(element: Element, tag: str) -> list[int]:
    """Ids to which the children of a tag refer, in the file's order, each once.

    Args:
        element: The element.
        tag: Tag of the children.

    Returns:
        The ids.

    Raises:
        FaultError: One refers to no whole number.
    """
    found = (whole(child.get("ref"), f"the ref of <{tag}>") for child in element.findall(tag))
    return list(dict.fromkeys(found))


def child(element: Element, tag: str) -> Element:
    """The first child of a tag.

    Args:
        element: The element.
        tag: The tag.

    Returns:
        The child.

    Raises:
        FaultError: There is none.
    """
    found = element.find(tag)
    if found is None:
        raise FaultError(f"it has no <{tag}>; add it")
    return found


def scalar(element: Element, tag: str) -> float:
    """The number in the first child of a tag.

    Args:
        element: The element.
        tag: The tag.

    Returns:
        The number.

    Raises:
        FaultError: There is no such child, or no number in it.
    """
    return number(child(element, tag).text, f"the <{tag}>")


def interval(element: Element) -> tuple[float, float]:
    """An ``<exact>`` value, as an interval of no width, or the interval that is given.

    Args:
        element: The element that holds them.

    Returns:
        Lower and upper bound.

    Raises:
        FaultError: It holds neither, or the bounds are in the wrong order.
    """
    what = f"the <{element.tag}>"
    exact = element.find("exact")
    if exact is not None:
        value = number(exact.text, what)
        return value, value
    low, high = element.find("intervalStart"), element.find("intervalEnd")
    if low is None or high is None:
        raise FaultError(f"{what} holds neither an <exact> value nor an interval; add one")
    bounds = number(low.text, what), number(high.text, what)
    if bounds[0] > bounds[1]:
        remedy = "add 2 pi to the end" if element.tag == "orientation" else "swap the two"
        raise FaultError(f"{what} goes from {bounds[0]:g} to {bounds[1]:g}; {remedy}")
    return bounds


def middle(element: Element) -> float:
    """The exact value of an element, or the middle of its interval.

    Args:
        element: The element that holds it.

    Returns:
        The number.

    Raises:
        FaultError: It holds neither.
    """
    low, high = interval(element)
    return low if low == high else 0.5 * (low + high)


def step(state: Element) -> int:
    """The time step of a state; of an interval of steps, its middle.

    Args:
        state: The state.

    Returns:
        The step.

    Raises:
        FaultError: It has none.
    """
    return int(middle(child(state, "time")))


def point(element: Element) -> tuple[float, float]:
    """The coordinates in a ``<point>`` or ``<center>``, m; a height is not read.

    Args:
        element: The element.

    Returns:
        x and y.

    Raises:
        FaultError: One is absent or no number.
    """
    return scalar(element, "x"), scalar(element, "y")


def points(element: Element) -> FloatArray:
    """The points in an element, in their order.

    Args:
        element: The element.

    Returns:
        (P, 2) m.

    Raises:
        FaultError: One cannot be read.
    """
    listed = element.findall("point")
    try:
        # A map is mostly points: they are read all at once, and one by one only to name a bad one.
        found = np.array([(float(p.find("x").text), float(p.find("y").text)) for p in listed])  # type: ignore[union-attr,arg-type]
        if len(found) and np.abs(found).max() <= MAX_NUMBER:
            return found
    except (AttributeError, TypeError, ValueError):
        pass
    return np.array([point(p) for p in listed], dtype=np.float64).reshape(-1, 2)
