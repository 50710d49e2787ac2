"""What can become of an XML tree: parts of it are absent, doubled, moved or nonsense."""

from __future__ import annotations

import copy
import random
from collections import defaultdict
from collections.abc import Callable
from typing import Final
from xml.etree import ElementTree

Element = ElementTree.Element

NUMBERS: Final = (
    "nan", "NaN", "-NAN", "inf", "-inf", "Infinity", "1e999", "-1e999", "1e308", "-1e308", "1e-320",
    "1e30", "-1e30", "1e9", "-1e9", "1e6", "0", "-0.0", "-1", "-1.5", "0.5", "1", "2", "3", "1e-12",
    "36000", "36001", "2147483648", "-2147483649", "9223372036854775808", "1" + "0" * 30,
    "1" + "0" * 400, "9" * 5000, "0x10", "1_000", "1,5", "1.5.2", "--1", "+-1", "1e", "\u0663",
)  # fmt: skip
WORDS: Final = (
    "", " ", "\n", "car", "true", "None", "null", "[]", "<b/>", "a" * 10_000,
    "\u00e4\u4e2d\U0001f697", "../../etc/passwd", "$(id)", "%s%n", "{0}", "\u202e", "-", ".", "0 0",
)  # fmt: skip


def damage_tree(rng: random.Random, root: Element, times: int) -> str:
    """Damages a tree in place, and says how."""
    return "; ".join(rng.choice(_TREE)(rng, root) for _ in range(times))


# An element is drawn by its tag first, so that those that are rare are drawn as often.


def _any(rng: random.Random, root: Element, leaves: bool = False) -> Element:
    by_tag = defaultdict(list)
    for element in root.iter():
        if element is not root and not (leaves and len(element)):
            by_tag[element.tag].append(element)
    return rng.choice(by_tag[rng.choice(sorted(by_tag))]) if by_tag else root


def _parent(root: Element, child: Element) -> Element:
    return next((element for element in root.iter() if child in list(element)), root)


def _delete(rng: random.Random, root: Element) -> str:
    element = _any(rng, root)
    parent = _parent(root, element)
    if element in list(parent):
        parent.remove(element)
    return f"without a <{element.tag}>"


def _delete_all(rng: random.Random, root: Element) -> str:
    tag = _any(rng, root).tag
    for parent in list(root.iter()):
        for element in parent.findall(tag):
            parent.remove(element)
    return f"without any <{tag}>"


def _duplicate(rng: random.Random, root: Element) -> str:
    element = _any(rng, root)
    parent = _parent(root, element)
    times = rng.choice((1, 1, 1, 2, 30))
    for _ in range(times):
        parent.insert(rng.randint(0, len(parent)), copy.deepcopy(element))
    return f"<{element.tag}> {times} times more"


def _shuffle(rng: random.Random, root: Element) -> str:
    element = rng.choice((root, _parent(root, _any(rng, root))))
    children = list(element)
    rng.shuffle(children)
    element[:] = children
    return f"children of <{element.tag}> in another order"


def _move(rng: random.Random, root: Element) -> str:
    element, place = _any(rng, root), _any(rng, root)
    if place in list(element.iter()):
        return "nothing"
    parent = _parent(root, element)
    if element in list(parent):
        parent.remove(element)
    place.append(element)
    return f"<{element.tag}> in <{place.tag}>"


def _number(rng: random.Random, root: Element) -> str:
    element = _any(rng, root, leaves=True)
    element.text = rng.choice(NUMBERS)
    return f"<{element.tag}>{element.text[:20]}"


def _every_number(rng: random.Random, root: Element) -> str:
    tag, text = _any(rng, root, leaves=True).tag, rng.choice(NUMBERS)
    for element in root.iter(tag):
        element.text = text
    return f"every <{tag}>{text[:20]}"


def _scaled(rng: random.Random, root: Element) -> str:
    tag, factor = _any(rng, root, leaves=True).tag, rng.choice((0.0, -1.0, 1e-9, 1e3, 1e9, 1e150))
    for element in root.iter(tag):
        try:
            element.text = repr(float(element.text or "") * factor)
        except ValueError:
            return "nothing"
    return f"every <{tag}> times {factor:g}"


def _word(rng: random.Random, root: Element) -> str:
    element = _any(rng, root)
    element.text = rng.choice(WORDS)
    return f"<{element.tag}>{element.text[:20]!r}"


def _exchange(rng: random.Random, root: Element) -> str:
    one, other = _any(rng, root, leaves=True), _any(rng, root, leaves=True)
    one.text, other.text = other.text, one.text
    return f"texts of <{one.tag}> and <{other.tag}> exchanged"


def _rename(rng: random.Random, root: Element) -> str:
    element, tag = _any(rng, root), rng.choice((_any(rng, root).tag, "unknown", "x:y"))
    before, element.tag = element.tag, tag.replace(":", "_")
    return f"<{before}> as <{tag}>"


def _attribute(rng: random.Random, root: Element) -> str:
    with_some = [element for element in root.iter() if element.attrib]
    element = root if not with_some or rng.random() < 0.3 else rng.choice(with_some)
    name = rng.choice(sorted(element.attrib) or ["id"])
    if rng.random() < 0.3:
        element.attrib.pop(name, None)
        return f"<{element.tag}> without {name}"
    other = rng.choice(with_some or [root]).get("id", "1")
    element.set(name, rng.choice((*NUMBERS, *WORDS, other, other, other, other)))
    return f"<{element.tag} {name}={element.get(name, '')[:20]!r}>"


def _nest(rng: random.Random, root: Element) -> str:
    element, deep = _any(rng, root), rng.choice((10, 500, 5000))
    for _ in range(deep):
        element = ElementTree.SubElement(element, "deeper")
    return f"{deep} levels deep"


def _crush(rng: random.Random, root: Element) -> str:
    """All points of a line are the same, or few are left."""
    lines = [*root.iter("leftBound"), *root.iter("rightBound"), *root.iter("polygon")]
    if not lines:
        return "nothing"
    line, kept = rng.choice(lines), rng.choice((0, 1, 2))
    points = line.findall("point")
    for i, point in enumerate(points):
        line.remove(point)
        if kept == 0 and points:
            line.append(copy.deepcopy(points[0]))
        elif i < kept:
            line.append(point)
    return f"a <{line.tag}> of {kept or 'equal'} points"


def _loop(rng: random.Random, root: Element) -> str:
    """A lanelet that follows another, itself perhaps."""
    lanelets = root.findall("lanelet")
    if not lanelets:
        return "nothing"
    one, other = rng.choice(lanelets), rng.choice(lanelets)
    tag = rng.choice(("successor", "predecessor", "adjacentLeft", "adjacentRight"))
    link = ElementTree.SubElement(one, tag, ref=other.get("id", ""))
    if tag.startswith("adjacent"):
        link.set("drivingDir", rng.choice(("same", "opposite", "up")))
    return f"another <{tag}>"


_TREE: Final[tuple[Callable[[random.Random, Element], str], ...]] = (
    _delete, _delete, _delete_all, _duplicate, _duplicate, _shuffle, _move, _number, _number,
    _number, _every_number, _every_number, _scaled, _word, _exchange, _rename, _attribute,
    _attribute, _nest, _crush, _loop,
)  # fmt: skip
