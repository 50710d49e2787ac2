"""What the ego decides before its plan is optimised.

The optimal control problem finds the best plan near its guess. What is no matter of degree is
decided here, in the words that the plan's report repeats:

* ``StopAtLine``: wait or go at a light, a stop sign, a crossing or a crosswalk;
* ``PassStanding`` and ``WaitToPass``: go round what stands on the lane, or wait until that is free;
* ``TakeGap``: in front of whom, behind whom and when the ego changes lanes.

Each alternative is a class of plans: a place where the ego stops, or a reference of speed and
offset. The reference leads the samples and the optimisation into the class; the sets still bound
what is driven. Each decision is kept until something speaks against it: a line that the ego waits
for, a pass that has begun and a gap that was chosen weigh more than one that would be new.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dosplan.geometry import StopRules, Wait
from dosplan.types import IntArray, Observation, Occupancy
from dosplan_mpc.lane_change import Gap, GapDecision, OnLane
from dosplan_mpc.passing import Pass, PassingDecision
from dosplan_mpc.reference import EgoOnPath
from dosplan_mpc.speed_profile import SpeedLimit, SpeedProfile

Kind = tuple[str | float | None, ...]
"""What tells one class of plans from another; the same from cycle to cycle while it is kept."""


@dataclass(frozen=True)
class StopAtLine:
    """The ego stops before a line.

    Attributes:
        wait: The line, and why.
        stop: Arc length at which the ego's centre comes to stand, m.
    """

    wait: Wait
    stop: float

    @property
    def kind(self) -> Kind:
        """What tells its class of plans from others: the line, whatever the reason."""
        return ("stop", self.wait.line)

    @property
    def words(self) -> str:
        """The decision in a few words."""
        return f"stop: {self.wait.reason}"

    @property
    def reason(self) -> str:
        """Why the ego stops."""
        return self.wait.reason

    def lead(self, profile: SpeedProfile) -> SpeedProfile:
        """The reference of this class of plans: its stop is in the speed already."""
        return profile


@dataclass(frozen=True)
class WaitToPass:
    """The ego waits until the way round what blocks its lane is free.

    Attributes:
        user: Id of the road user for whom it waits.
        standing: Id of what blocks the lane.
        stop: Arc length at which the ego's centre comes to stand, m.
    """

    user: int
    standing: int
    stop: float

    @property
    def kind(self) -> Kind:
        """What tells its class of plans from others: what it waits before, for whomever."""
        return ("wait", self.standing)

    @property
    def words(self) -> str:
        """The decision in a few words."""
        return f"wait for {self.reason}"

    @property
    def reason(self) -> str:
        """Why the ego stops."""
        return f"{self.user}, to pass {self.standing}"

    def lead(self, profile: SpeedProfile) -> SpeedProfile:
        """The reference of this class of plans: its stop is in the speed already."""
        return profile


@dataclass(frozen=True)
class PassStanding:
    """The ego goes round what blocks its lane.

    Attributes:
        way: The way round it.
        standing: Id of what blocks the lane.
        stop: None: it does not stop.
        reason: None.
    """

    way: Pass
    standing: int
    stop: None = None
    reason: None = None

    @property
    def kind(self) -> Kind:
        """What tells its class of plans from others: what is passed."""
        return ("pass", self.standing)

    @property
    def words(self) -> str:
        """The decision in a few words."""
        return f"pass {self.standing}"

    def lead(self, profile: SpeedProfile) -> SpeedProfile:
        """The reference of this class of plans: aside along the stretch."""
        return replace(profile, offset=self.way.bent(profile.arclength, profile.offset))


@dataclass(frozen=True)
class TakeGap:
    """The ego changes lanes into a gap.

    Attributes:
        gap: The gap, or that the ego has changed into it.
        stop: None: it does not stop.
        reason: None.
    """

    gap: Gap | OnLane
    stop: None = None
    reason: None = None

    @property
    def kind(self) -> Kind:
        """What tells its class of plans from others: between whom, or that the ego is through."""
        if isinstance(self.gap, OnLane):
            return ("on lane",)
        return ("gap", self.gap.behind, self.gap.front)

    @property
    def words(self) -> str:
        """The decision in a few words; none once the ego has changed."""
        return self.gap.words if isinstance(self.gap, Gap) else ""

    def lead(self, profile: SpeedProfile) -> SpeedProfile:
        """The reference of this class of plans: to the gap, and into it."""
        return self.gap.lead(profile)


Alternative = StopAtLine | WaitToPass | PassStanding | TakeGap


@dataclass(frozen=True)
class Decision:
    """What was decided in a cycle.

    Attributes:
        chosen: The alternatives; none where the ego just goes on.
        passed: Rows of the observation that the ego goes round, or waits to.
    """

    chosen: tuple[Alternative, ...]
    passed: IntArray

    @property
    def stop(self) -> float | None:
        """Arc length at which the ego's centre has to come to stand, m, or None."""
        return min((one.stop for one in self.chosen if one.stop is not None), default=None)

    @property
    def wait(self) -> Wait | None:
        """The line before which the ego has to stop, or None."""
        return next((one.wait for one in self.chosen if isinstance(one, StopAtLine)), None)

    @property
    def reason(self) -> str | None:
        """Why the ego stops, or None."""
        return next((one.reason for one in self.chosen if one.reason is not None), None)

    @property
    def kind(self) -> tuple[Kind, ...]:
        """What tells its class of plans from others."""
        return tuple(one.kind for one in self.chosen)

    @property
    def leads(self) -> bool:
        """Whether the reference leads aside: what just follows the path is not in the class."""
        return any(isinstance(one, PassStanding | TakeGap) for one in self.chosen)

    @property
    def words(self) -> str | None:
        """The decision in a few words; None where the ego just goes on."""
        return "; ".join(one.words for one in self.chosen if one.words) or None

    @property
    def entry(self) -> float:
        """Time from now until which the ego stays where it is between two lanes, s."""
        gaps = (one.gap for one in self.chosen if isinstance(one, TakeGap))
        return max((gap.entry for gap in gaps if isinstance(gap, Gap)), default=0.0)

    def lead(self, profile: SpeedProfile) -> SpeedProfile:
        """The reference that leads into the classes of plans that were chosen.

        Args:
            profile: The reference of a plan that goes on, and stops at ``stop``.

        Returns:
            The reference.
        """
        for one in self.chosen:
            profile = one.lead(profile)
        return profile

    def joined(self, one: Alternative | None) -> Decision:
        """This decision and one alternative more, where there is one."""
        return self if one is None else replace(self, chosen=(*self.chosen, one))


class Decisions:
    """Decides in every cycle of an episode: about stops first, then about gaps."""

    def __init__(
        self, rules: StopRules, passing: PassingDecision, gaps: GapDecision, half_length: float
    ) -> None:
        """Begins an episode.

        Args:
            rules: Say when the ego stops for lights, signs and crosswalks.
            passing: Decides about what blocks the lane.
            gaps: Decides about changes of lanes.
            half_length: Half of the ego's length, m.
        """
        self._rules = rules
        self._passing = passing
        self._gaps = gaps
        self._half_length = half_length

    def about_stops(
        self, observation: Observation, occupancy: Occupancy, ego: EgoOnPath
    ) -> Decision:
        """Where the ego stops, and what it passes.

        Args:
            observation: What is known now.
            occupancy: The sets of the road users, in the same order.
            ego: Where the ego is.

        Returns:
            The decision.
        """
        decision = Decision((), np.empty(0, dtype=np.int64))
        wait = self._rules.wait(observation, occupancy, ego.position + self._half_length)
        if wait is not None:
            decision = decision.joined(StopAtLine(wait, wait.place - self._half_length))
        way = self._passing.decide(observation, occupancy, ego)
        if way is None:
            return decision
        standing = int(observation.ids[way.users[0]])
        one: Alternative = PassStanding(way, standing)
        if way.waits_for is not None:
            one = WaitToPass(way.waits_for, standing, way.begin)
        return replace(decision.joined(one), passed=way.users)

    def about_gaps(
        self,
        decision: Decision,
        observation: Observation,
        occupancy: Occupancy,
        ego: EgoOnPath,
        profile: SpeedProfile,
        limit: SpeedLimit,
    ) -> Decision:
        """Adds the gap into which the ego changes lanes, where nothing else was decided.

        Where something else was, a gap that was chosen before is given up: others drive on while
        the ego stops, and what was a gap is none any more, or another one is better.

        Args:
            decision: What was decided about stops.
            observation: What is known now.
            occupancy: The sets of the road users, in the same order.
            ego: Where the ego is.
            profile: The reference without a gap.
            limit: How fast the ego may be ahead.

        Returns:
            The decision.
        """
        if decision.chosen:
            self._gaps.give_up()
            return decision
        gap = self._gaps.decide(observation, occupancy, ego, profile, limit)
        return decision if gap is None else decision.joined(TakeGap(gap))
