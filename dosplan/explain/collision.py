"""A collision: the road user, where it came from, and whether its sets predicted it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from itertools import takewhile
from typing import Final

import numpy as np

from dosplan.evaluation.metrics import displacement
from dosplan.explain.sight import SightFacts, sight_facts
from dosplan.geometry import mahalanobis, to_body, wrap_angle
from dosplan.results.drive import Drive
from dosplan.results.recording import NEARBY_METRES
from dosplan.scoring.collision import Contact
from dosplan.scoring.fault import STOPPED_VELOCITY
from dosplan.system.files import FileError
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    Arm,
    CollisionClass,
    FloatArray,
    RoadUserKind,
)

LOOK_BACK: Final = 2.0
"""How long before the contact the road user's place is given, s."""

_MEANING: Final = {
    CollisionClass.STOPPED_EGO: "it ran into the standing ego",
    CollisionClass.STOPPED_TRACK: "the ego ran into it while it stood",
    CollisionClass.ACTIVE_REAR: "it ran into the ego from behind",
    CollisionClass.ACTIVE_FRONT: "the ego's front struck it",
    CollisionClass.ACTIVE_LATERAL: "they met sideways",
}


class Course(StrEnum):
    """How a road user moves, as the ego sees it."""

    STANDING = "standing"
    ALONG = "driving the same way"
    ONCOMING = "oncoming"
    FROM_LEFT = "crossing from the left"
    FROM_RIGHT = "crossing from the right"


@dataclass(frozen=True)
class SetCheck:
    """What was predicted of the struck road user for the step of the contact.

    Attributes:
        lead: How long before, s.
        inside: Whether its true centre was inside the set.
        error: Distance of the true centre to the predicted one, of a union's nearest component, m.
        reach: The same in multiples of the set, 1 on its boundary; None where the set has no
            extent.
    """

    lead: float
    inside: bool
    error: float
    reach: float | None

    def words(self) -> str:
        """The check in a few words."""
        size = "no extent" if self.reach is None else f"{self.reach:.1f} x"
        verdict = "in" if self.inside else "OUT"
        return f"{self.lead:.1f} s {verdict} ({self.error:.1f} m off, {size})"


@dataclass(frozen=True)
class CollisionFacts:
    """The collision that was scored.

    Attributes:
        step: Step of the contact.
        seconds: Since the start, s.
        road_user: Id.
        kind: What it is.
        collision_class: nuPlan's class.
        at_fault: Whether the ego is at fault.
        relative_speed: Of the two centres, m/s.
        ego_speed: m/s.
        road_user_speed: m/s.
        course: How the road user moved.
        seen_for: How long it had been on the scene, s, since the ego's start at most.
        before: How long before the contact ``ahead`` and ``left`` are given, s.
        ahead: Where it was then, m ahead of the ego's centre; negative behind.
        left: m to the left; negative to the right.
        arm: With sets or without.
        sets: What was predicted for this moment, the latest prediction first.
        held: Lead time, s, up to which every set held its centre; None where not even the
            latest did, or nothing was predicted.
        failed: Shortest lead time, s, at which its centre was outside; None where never.
        sight: How late the ego saw it; None where it saw everybody at once.
    """

    step: int
    seconds: float
    road_user: int
    kind: RoadUserKind
    collision_class: CollisionClass
    at_fault: bool
    relative_speed: float
    ego_speed: float
    road_user_speed: float
    course: Course
    seen_for: float
    before: float
    ahead: float
    left: float
    arm: Arm
    sets: tuple[SetCheck, ...]
    held: float | None
    failed: float | None
    sight: SightFacts | None = None

    def lines(self) -> list[str]:
        """The collision in plain words."""
        blame = "the ego is to blame" if self.at_fault else "the ego is not to blame"
        along = f"{abs(self.ahead):.1f} m {'ahead' if self.ahead >= 0.0 else 'behind'}"
        across = f"{abs(self.left):.1f} m to the {'left' if self.left >= 0.0 else 'right'}"
        return [
            f"with {self.kind} {self.road_user}: {_MEANING[self.collision_class]} "
            f"({self.collision_class}); {blame}",
            f"relative speed {self.relative_speed:.1f} m/s: the ego at {self.ego_speed:.1f}, "
            f"the {self.kind} at {self.road_user_speed:.1f}, {self.course}",
            f"{self.before:.1f} s before, the {self.kind} was {along} and {across} of the ego; "
            f"it had been on the scene for {self.seen_for:.1f} s of the drive",
            *([] if self.sight is None else self.sight.lines()),
            *self._set_lines(),
        ]

    def _set_lines(self) -> list[str]:
        if not self.sets:
            return [
                "no prediction of it for this moment was kept: there was none, or it was farther "
                f"than {NEARBY_METRES:g} m away"
            ]
        if self.arm is Arm.WITHOUT_DOS:
            off = ", ".join(f"{check.error:.1f} m at {check.lead:.1f} s" for check in self.sets)
            return [f"no sets in this arm; its centre was predicted, by lead time, off by {off}"]
        checks = ", ".join(check.words() for check in self.sets)
        return [
            f"true centre in the predicted set, by lead time (1 x is its edge): {checks}",
            self._verdict(),
        ]

    def _verdict(self) -> str:
        if self.failed is None:
            return "every set that was predicted for this moment held it"
        if self.held is None:
            return f"not even the set predicted {self.failed:.1f} s before held it"
        return (
            f"the sets held it up to {self.held:.1f} s ahead; the one predicted "
            f"{self.failed:.1f} s before the contact failed"
        )


def collision_facts(drive: Drive, contact: Contact) -> CollisionFacts:
    """Gathers what is known of the collision that a row names.

    Args:
        drive: A drive that ends in a collision.
        contact: Its contact.

    Returns:
        The facts.

    Raises:
        FileError: The row does not name the collision's class.
    """
    row, dt = drive.row, drive.scenario.dt
    tracks, step = drive.tracks, contact.step
    ego, user = contact.ego_state, contact.user_state
    present = tracks.valid[contact.user, drive.start : step + 1][::-1]
    seen = sum(1 for _ in takewhile(bool, present)) - 1
    back = min(seen, round(LOOK_BACK / dt))
    then = step - back
    place = to_body(tracks.states[contact.user, then, None, :2], drive.ego[then - drive.start, :3])[
        0
    ]
    sets = _set_checks(drive, contact.user, step)
    held = [check.lead for check in takewhile(lambda check: check.inside, sets)]
    if row.collision_class is None:
        raise FileError(f"the row of {row.scenario} names a collision without its class")
    return CollisionFacts(
        step=step,
        seconds=drive.seconds(step),
        road_user=int(tracks.ids[contact.user]),
        kind=tracks.kinds[contact.user],
        collision_class=row.collision_class,
        at_fault=row.at_fault,
        relative_speed=float(np.hypot(*(_velocity(user) - _velocity(ego)))),
        ego_speed=float(abs(ego[USER_VELOCITY])),
        road_user_speed=float(abs(user[USER_VELOCITY])),
        course=_course(ego, user),
        seen_for=seen * dt,
        before=back * dt,
        ahead=float(place[0]),
        left=float(place[1]),
        arm=row.arm,
        sets=sets,
        held=held[-1] if held else None,
        failed=next((check.lead for check in sets if not check.inside), None),
        sight=sight_facts(drive, contact.user, step, step - seen),
    )


def _set_checks(drive: Drive, user: int, step: int) -> tuple[SetCheck, ...]:
    """Every kept set of a road user for a step, by lead time."""
    recording, tracks = drive.recording, drive.tracks
    made = recording.cycle_steps[recording.set_cycle]
    of_user = recording.set_ids == tracks.ids[user]
    for_step = made[:, None] + recording.set_offsets == step
    rows, columns = np.nonzero(of_user[:, None] & for_step)
    truth = tracks.states[user, step, :2]
    centres = recording.set_centres[rows, columns]
    errors = displacement(centres, truth)
    reaches = mahalanobis(
        truth,
        centres,
        recording.set_semi_axes[rows, columns],
        recording.set_angles[rows, columns],
    )
    checks: dict[float, SetCheck] = {}
    # Of a union, the nearest component is what holds, or fails by the least: it comes last.
    for i in np.argsort(-reaches, kind="stable"):
        if np.isfinite(errors[i]):
            lead = int(recording.set_offsets[columns[i]]) * drive.scenario.dt
            checks[lead] = SetCheck(
                lead=lead,
                inside=bool(reaches[i] <= 1.0),
                error=float(errors[i]),
                reach=float(reaches[i]) if np.isfinite(reaches[i]) else None,
            )
    return tuple(checks[lead] for lead in sorted(checks))


def _course(ego: FloatArray, user: FloatArray) -> Course:
    if abs(user[USER_VELOCITY]) <= STOPPED_VELOCITY:
        return Course.STANDING
    reversing = np.pi if user[USER_VELOCITY] < 0.0 else 0.0
    turned = np.rad2deg(wrap_angle(user[USER_HEADING] + reversing - ego[USER_HEADING]))
    if abs(turned) <= 45.0:
        return Course.ALONG
    if abs(turned) >= 135.0:
        return Course.ONCOMING
    return Course.FROM_LEFT if turned < 0.0 else Course.FROM_RIGHT


def _velocity(state: FloatArray) -> FloatArray:
    heading, speed = state[USER_HEADING], state[USER_VELOCITY]
    return np.array([speed * np.cos(heading), speed * np.sin(heading)])
