"""Draws the pictures of ``docs/concepts.md``: ``python docs/pictures.py``.

Colours mean what they mean in films and reports: the ego is blue, others are grey, and sets go from
green (soon) over yellow to red (3 s ahead).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from dosplan.report import palette
from dosplan.report.palette import FAINT, INK, ROAD
from dosplan.report.palette import SET_COLOURS as SETS
from dosplan.types import Arm, Outcome, RoadUserKind

FOLDER: Final = Path(__file__).with_name("pictures")
EGO: Final = palette.ARM_COLOURS[Arm.WITH_DOS]
OTHER: Final = palette.KIND_COLOURS[RoadUserKind.CAR]
HIT: Final = palette.OUTCOME_COLOURS[Outcome.COLLISION]
FREE: Final = palette.OUTCOME_COLOURS[Outcome.SUCCESS]
Point = tuple[float, float]


class Drawing:
    """An SVG picture that grows from back to front; x to the right and y down, in pixels."""

    def __init__(self, width: float, height: float, title: str) -> None:
        self.size = (width, height)
        self.title = title
        self.parts: list[str] = []
        self.rectangle(0, 0, width, height, "#ffffff")

    def rectangle(
        self, x: float, y: float, width: float, height: float, fill: str, stroke: str = "none",
        corner: float = 0,
    ) -> None:  # fmt: skip
        """A rectangle, given by its corner at the top left."""
        self.parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="{corner:g}" '
            f'fill="{fill}" stroke="{stroke}" stroke-width="1.4"/>'
        )

    def text(
        self, x: float, y: float, text: str, size: float = 13, fill: str = INK,
        anchor: str = "middle", bold: bool = False,
    ) -> None:  # fmt: skip
        """A line of text; `anchor` says which part of it is at x."""
        weight = ' font-weight="bold"' if bold else ""
        self.parts.append(
            f'<text x="{x:g}" y="{y:g}" font-size="{size:g}" fill="{fill}" '
            f'text-anchor="{anchor}"{weight}>{text}</text>'
        )

    def line(
        self, points: Sequence[Point], stroke: str = FAINT, *, dashed: bool = False,
        arrow: bool = False, width: float = 1.6,
    ) -> None:  # fmt: skip
        """A line through points, with an arrow's head at its end if asked for."""
        path = " ".join(f"{x:g},{y:g}" for x, y in points)
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        self.parts.append(
            f'<polyline points="{path}" fill="none" stroke="{stroke}" '
            f'stroke-width="{width:g}"{dash}/>'
        )
        if arrow:
            (ax, ay), (bx, by) = points[-2:]
            along = math.atan2(by - ay, bx - ax)
            sides = [
                (bx - 9 * math.cos(along + turn), by - 9 * math.sin(along + turn))
                for turn in (0.45, -0.45)
            ]
            tip = " ".join(f"{x:.1f},{y:.1f}" for x, y in [(bx, by), *sides])
            self.parts.append(f'<polygon points="{tip}" fill="{stroke}"/>')

    def car(
        self, x: float, y: float, fill: str, degrees: float = 0, *, ghost: bool = False
    ) -> None:
        """A vehicle with its centre at (x, y); its nose is white."""
        look = f'fill="none" stroke="{fill}" stroke-width="1.3"' if ghost else f'fill="{fill}"'
        nose = "" if ghost else '<path d="M10 -6 L16 0 L10 6 z" fill="#ffffff"/>'
        self.parts.append(
            f'<g transform="translate({x:g} {y:g}) rotate({degrees:g})">'
            f'<rect x="-20" y="-9" width="40" height="18" rx="3" {look}/>{nose}</g>'
        )

    def ellipse(
        self, x: float, y: float, a: float, b: float, colour: str, degrees: float = 0
    ) -> None:
        """A set: semi-axes a and b, the first one turned by degrees."""
        self.parts.append(
            f'<ellipse cx="{x:g}" cy="{y:g}" rx="{a:g}" ry="{b:g}" fill="{colour}" '
            f'fill-opacity="0.18" stroke="{colour}" stroke-width="1.5" '
            f'transform="rotate({degrees:g} {x:g} {y:g})"/>'
        )

    def dot(self, x: float, y: float, fill: str, radius: float = 3.5) -> None:
        """A point."""
        self.parts.append(f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="{fill}"/>')

    def road(self, x: float, y: float, width: float, lanes: int = 2) -> None:
        """A road from left to right; each lane is 34 wide."""
        self.rectangle(x, y, width, 34 * lanes, ROAD)
        for lane in range(1, lanes):
            at = y + 34 * lane
            self.line([(x, at), (x + width, at)], "#ffffff", dashed=True, width=2)

    def svg(self) -> str:
        """The whole picture as a file's text."""
        width, height = self.size
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" '
            f'viewBox="0 0 {width:g} {height:g}" font-family="Helvetica, Arial, sans-serif" '
            f'role="img" aria-label="{self.title}">'
        )
        return "\n".join([head, *self.parts, "</svg>", ""])


def cycle() -> Drawing:
    """One cycle of the loop."""
    d = Drawing(760, 236, "One cycle: the world is seen, predicted, planned in and driven in")
    steps = (
        ("Observation", "past and present", "#eef2f6"),
        ("Predictor", "a plug-in", "#fff4e0"),
        ("Occupancy", "sets, or points", "#eef2f6"),
        ("Planner", "a plug-in", "#fff4e0"),
        ("Plan", "states and inputs", "#eef2f6"),
    )
    for k, (name, what, fill) in enumerate(steps):
        x = 20 + 148 * k
        d.rectangle(x, 30, 124, 54, fill, "#8a99a8", 6)
        d.text(x + 62, 54, name, 14, bold=True)
        d.text(x + 62, 72, what, 11.5, FAINT)
        if k:
            d.line([(x - 24, 57), (x - 3, 57)], arrow=True)
    d.rectangle(20, 150, 272, 60, "#e9f3ec", "#5f9c76", 6)
    d.text(156, 175, "World", 14, bold=True)
    d.text(156, 194, "map, lights, traffic: recorded or reacting", 11.5, FAINT)
    d.rectangle(464, 150, 272, 60, "#e9f3ec", "#5f9c76", 6)
    d.text(600, 175, "Ego", 14, bold=True)
    d.text(600, 194, "vehicle model, actuators", 11.5, FAINT)
    d.line([(82, 150), (82, 87)], arrow=True)
    d.text(90, 124, "sensors: exact, or with errors", 11.5, FAINT, "start")
    d.line([(674, 84), (674, 147)], arrow=True)
    d.text(666, 124, "at once, or later", 11.5, FAINT, "end")
    d.line([(464, 180), (295, 180)], arrow=True)
    d.text(380, 170, "moves, is seen", 11.5, FAINT)
    d.text(380, 202, "every 0.1 s, or period", 11.5, FAINT)
    return d


def sets() -> Drawing:
    """What the two arms are given, and a union."""
    d = Drawing(760, 226, "The same prediction as points, as ellipses, and as a union of ellipses")
    ways = (62.0, 122.0, 178.0)
    for panel, title in enumerate(("without DOS", "with DOS", "with DOS, three courses")):
        x = 10 + 250 * panel
        d.text(x + 120, 22, title, 14, bold=True)
        d.road(x, 50, 240, 2)
        d.rectangle(x, 118, 240, 50, "#f3f4f2")
        if panel < 2:
            for way, colour, a, b in zip(ways, SETS, (10.0, 22.0, 36.0), (4, 8, 12), strict=True):
                at = x + 216 - way
                if panel:
                    d.ellipse(at, 67, a, b, colour)
                d.dot(at, 67, colour)
        else:
            courses: tuple[Sequence[tuple[float, float, float]], ...] = (
                ((62, 0, 0), (122, 0, 0), (178, 0, 0)),
                ((58, 2, -6), (104, 18, -30), (134, 52, -55)),
                ((46, 0, 0), (74, 0, 0), (90, 0, 0)),
            )
            for course in courses:
                for (way, aside, turn), colour, a in zip(
                    course, SETS, (8.0, 13.0, 18.0), strict=True
                ):
                    d.ellipse(x + 216 - way, 67 + aside, a, 6 + a / 5, colour, turn)
        d.car(x + 216, 67, OTHER, 180)
        d.car(x + 26, 101, EGO)
    for k, (colour, when) in enumerate(zip(SETS, ("1 s", "2 s", "3 s"), strict=True)):
        d.dot(30 + 60 * k, 197, colour, 5)
        d.text(40 + 60 * k, 201, when, 12, FAINT, "start")
    d.text(215, 201, "ahead: where its centre may be. Its footprint is added in both arms.", 12,
           FAINT, "start")  # fmt: skip
    return d


def loop() -> Drawing:
    """From seeing to acting, at once and late."""
    d = Drawing(760, 250, "In the ideal loop a plan acts at the step that it was made from")

    def at(step: float) -> float:
        return 130 + 66 * step

    for tick in range(10):
        d.line([(at(tick), 40), (at(tick), 216)], "#e3e6ea", width=1)
        d.text(at(tick), 30, f"{0.1 * tick:.1f} s", 11.5, FAINT)
    d.text(64, 82, "ideal", 14, bold=True)
    for step in range(9):
        d.dot(at(step), 66, SETS[0], 4.5)
        d.rectangle(at(step), 80, 62, 16, EGO, corner=3)
    d.text(64, 168, "0.3 s late", 14, bold=True)
    for k in range(3):
        step, y = k, 126 + 28 * k
        d.dot(at(step), y + 8, SETS[0], 4.5)
        d.line([(at(step) + 7, y + 8), (at(step + 3) - 2, y + 8)], FAINT, dashed=True, arrow=True)
        d.rectangle(at(step + 3), y, 62, 16, EGO, corner=3)
        d.rectangle(at(step + 4), y, 66 * (5 - step), 16, "none", EGO, corner=3)
    d.dot(34, 238, SETS[0], 4.5)
    d.text(44, 242, "seen", 12, FAINT, "start")
    d.rectangle(96, 230, 28, 14, EGO, corner=3)
    d.text(130, 242, "driven from this plan", 12, FAINT, "start")
    d.rectangle(276, 230, 28, 14, "none", EGO, corner=3)
    d.text(310, 242, "planned, and replaced by the next", 12, FAINT, "start")
    d.line([(530, 238), (566, 238)], FAINT, dashed=True, arrow=True)
    d.text(572, 242, "the plans before it are driven", 12, FAINT, "start")
    return d


def futures() -> Drawing:
    """One past and what may come of it."""
    d = Drawing(760, 268, "One past, three futures: stays, cuts in, cuts in and brakes")
    d.text(120, 22, "past, the same in all", 14, bold=True)
    d.road(10, 96, 220, 2)
    d.car(52, 147, EGO)
    for x in (96, 132):
        d.car(x, 113, OTHER, ghost=True)
    d.car(168, 113, OTHER)
    d.text(120, 190, "nothing in it tells what comes", 12, FAINT)
    for k, (name, y) in enumerate((("stays", 10), ("cuts in", 98), ("cuts in and brakes", 186))):
        d.line([(236, 130), (316, y + 34)], FAINT, arrow=True)
        d.road(324, y, 426, 2)
        d.car(364 + 10, y + 51, EGO)
        if k == 0:
            d.line([(430, y + 17), (700, y + 17)], OTHER, dashed=True)
            d.car(700, y + 17, OTHER)
        else:
            end = 640 if k == 1 else 520
            d.line([(430, y + 17), (470, y + 20), (510, y + 47), (end, y + 51)], OTHER, dashed=True)
            d.car(end, y + 51, OTHER)
        d.text(744, y + (56 if k == 0 else 22), f"future {k}: {name}", 12, INK, "end")
    return d


def fault() -> Drawing:
    """The classes of collisions, which are nuPlan's."""
    d = Drawing(760, 176, "Five classes of collisions, and in which the ego is to blame")
    classes = (
        ("stopped ego", "not to blame", FREE, (92, 60, 0), (52, 60, 0)),
        ("stopped track", "to blame", HIT, (52, 60, 0), (92, 60, 0)),
        ("active rear", "not to blame*", FREE, (92, 60, 0), (52, 60, 0)),
        ("active front", "to blame", HIT, (48, 60, 0), (81, 62, 90)),
        ("active lateral", "if out of its lane", "#a06a00", (64, 67, -8), (74, 49, 0)),
    )
    moving = ((False, True), (True, False), (True, True), (True, True), (True, True))
    for k, (name, verdict, colour, ego, other) in enumerate(classes):
        x = 6 + 151 * k
        d.road(x, 34, 144, 2 if k == 4 else 1)
        if k < 4:
            d.rectangle(x, 68, 144, 34, "#f3f4f2")
            ego, other = (ego[0], ego[1] - 9, ego[2]), (other[0], other[1] - 9, other[2])
        cars = tuple(zip((ego, other), (EGO, OTHER), moving[k], strict=True))
        for (px, py, turn), fill, _ in cars:
            d.car(x + px, py, fill, turn)
        for (px, py, turn), _, moves in cars:
            along = (math.cos(math.radians(turn)), math.sin(math.radians(turn)))
            if moves:
                ends = [(x + px + way * along[0], py + way * along[1]) for way in (6, 34)]
                d.line(ends, INK, arrow=True)
        d.text(x + 72, 20, name, 14, bold=True)
        d.text(x + 72, 124, verdict, 13, colour, bold=True)
    d.text(10, 154, "* but for a cut-in that asks a follower who reacts for more than 5 m/s².", 12,
           FAINT, "start")  # fmt: skip
    return d


PICTURES: Final[Mapping[str, Callable[[], Drawing]]] = {
    "cycle": cycle,
    "sets": sets,
    "loop": loop,
    "futures": futures,
    "fault": fault,
}

if __name__ == "__main__":
    for name, draw in PICTURES.items():
        (FOLDER / f"{name}.svg").write_text(draw().svg(), encoding="utf-8")
