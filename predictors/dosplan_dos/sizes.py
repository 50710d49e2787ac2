"""How large the sets are: the factors on their semi-axes, in an episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from dosplan_net.encoder import Encoded

from dosplan.types import USER_VELOCITY, FloatArray, Observation, RoadUserKind
from dosplan_dos.calibration import Calibration, group_index
from dosplan_dos.covariates import covariates


class Sizes(Protocol):
    """Factors on the semi-axes of sets as they were trained."""

    def factors(self, observation: Observation, encoded: Encoded) -> FloatArray:
        """Chooses the factors.

        Args:
            observation: What is known now.
            encoded: What the network made of it; M road users can move.

        Returns:
            (M, G) factors at the steps of the grid, or (1, 1) one for all.
        """
        ...


@dataclass(frozen=True)
class FixedSizes:
    """One factor for all.

    Attributes:
        scale: The factor.
    """

    scale: float

    def factors(self, observation: Observation, encoded: Encoded) -> FloatArray:
        """The factor; see ``Sizes``."""
        return np.full((1, 1), self.scale)


@dataclass(frozen=True, eq=False)
class GroupSizes:
    """Factors by groups of kind and speed.

    Attributes:
        table: (groups, G) the factors.
    """

    table: FloatArray

    def factors(self, observation: Observation, encoded: Encoded) -> FloatArray:
        """The factors; see ``Sizes``."""
        speed, kinds = _speed_and_kinds(observation, encoded)
        return np.asarray(self.table[group_index(speed, kinds, len(kinds))])


@dataclass(frozen=True, eq=False)
class ConditionalSizes:
    """Factors by what is known of each road user.

    Attributes:
        calibration: A calibration that depends on covariates.
        level: The wanted coverage.
    """

    calibration: Calibration
    level: float

    def factors(self, observation: Observation, encoded: Encoded) -> FloatArray:
        """The factors; see ``Sizes``."""
        known = covariates_of(encoded)
        return self.calibration.factors(self.level, *_speed_and_kinds(observation, encoded), known)


def covariates_of(encoded: Encoded) -> FloatArray:
    """What is known of the road users that can move.

    Args:
        encoded: What the network made of an observation; M road users can move.

    Returns:
        (M, F) see ``covariates``.
    """
    seen, rows = encoded.seen, encoded.moving
    return covariates(
        seen.pose,
        seen.history,
        seen.static,
        seen.neighbours,
        seen.pieces,
        encoded.piece_pose,
        rows,
    )


def _speed_and_kinds(
    observation: Observation, encoded: Encoded
) -> tuple[FloatArray, list[RoadUserKind]]:
    speed = np.abs(observation.states[encoded.moving, -1, USER_VELOCITY])
    return speed, [observation.kinds[row] for row in encoded.moving]
