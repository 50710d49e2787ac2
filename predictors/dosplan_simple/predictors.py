"""Trajectories without training. Their sets are points: semi-axes of zero.

Road users of the kinds parked and static stay where they are, whatever their recorded velocity.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from dosplan.api import OraclePredictor, PluginError, Predictor, PredictorSettings
from dosplan.geometry import wrap_angle
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    BoolArray,
    FloatArray,
    Observation,
    Occupancy,
    RoadUserKind,
    Tracks,
)

WALKING_KINDS = frozenset({RoadUserKind.PEDESTRIAN})


def of_kind(observation: Observation, kinds: frozenset[RoadUserKind]) -> BoolArray:
    """Which road users are of some kinds.

    Args:
        observation: What is known now.
        kinds: The kinds that are looked for.

    Returns:
        (N,) mask.
    """
    return np.array([kind in kinds for kind in observation.kinds], dtype=np.bool_)


class NonePredictor(Predictor):
    """Predicts no road user: the planner drives as on an empty road."""

    name = "none-v1"
    has_sets = False

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        """Marks every road user as not predicted.

        Returns:
            An occupancy that is valid nowhere.
        """
        shape = (len(observation.ids), self.horizon)
        return Occupancy.from_trajectory(
            observation,
            np.full((*shape, 2), np.nan),
            np.full(shape, np.nan),
            valid=np.zeros(shape, dtype=np.bool_),
        )


class KinematicPredictor(Predictor):
    """Constant velocity on a circular arc; what differs is the turn rate."""

    has_sets = False

    @abstractmethod
    def turn_rate(self, observation: Observation) -> FloatArray:
        """How fast each road user turns.

        Returns:
            (N,) rad/s.
        """

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        """Follows each road user's arc.

        An arc of length v t through an angle w t has the chord v t sin(w t / 2) / (w t / 2)
        in the direction of its middle, heading + w t / 2; no case for w = 0 is needed.

        Returns:
            Points, valid everywhere.
        """
        now = observation.states[:, -1]
        time = observation.dt * np.arange(1, self.horizon + 1)
        moves = observation.moves
        velocity = np.where(moves, now[:, USER_VELOCITY], 0.0)
        turned = np.where(moves, self.turn_rate(observation), 0.0)[:, None] * time
        chord = velocity[:, None] * time * np.sinc(turned / (2.0 * np.pi))
        middle = now[:, USER_HEADING, None] + 0.5 * turned
        way = chord[..., None] * np.stack([np.cos(middle), np.sin(middle)], axis=-1)
        return Occupancy.from_trajectory(
            observation, now[:, None, :2] + way, now[:, USER_HEADING, None] + turned
        )


class ConstantVelocityPredictor(KinematicPredictor):
    """Every road user keeps its present heading and velocity."""

    name = "constant-velocity-v1"

    def turn_rate(self, observation: Observation) -> FloatArray:
        """Zero for every road user.

        Returns:
            (N,) zeros.
        """
        return np.zeros(len(observation.ids))


@dataclass(frozen=True)
class TurnRateSettings(PredictorSettings):
    """The options of the constant turn rate.

    Attributes:
        window: Number of steps whose headings give the turn rate; the default is half a second.
        least_headings: Number of valid headings that a turn rate needs; with fewer it is zero.
        tightest_radius: Least turning radius, m; a slow vehicle must not spin.
        lateral_acceleration: Largest lateral acceleration, m/s2; everyday traffic stays below.
    """

    window: int = 6
    least_headings: int = 3
    tightest_radius: float = 5.0
    lateral_acceleration: float = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("window", "least_headings"):
            if getattr(self, name) < 2:
                raise ValueError(f"{name} is {getattr(self, name)}, expected 2 or more")
        for name in ("tightest_radius", "lateral_acceleration"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name} is {getattr(self, name)}, expected more than 0")


class ConstantTurnRatePredictor(KinematicPredictor):
    """Every road user keeps its present velocity and the turn rate of the last half second.

    The rate is the slope of a straight line fitted to the headings by least squares. It is limited
    to what a road vehicle can do, in turning radius and in lateral acceleration, so that noise does
    not make a slow or a fast vehicle spin. Pedestrians, whose headings are noisier, are taken to
    walk straight on.
    """

    name = "constant-turn-rate-v1"
    settings = TurnRateSettings

    def __init__(self, *, seed: int = 0, settings: TurnRateSettings = TurnRateSettings()) -> None:
        """Keeps the settings.

        Args:
            seed: Seed of the run; nothing here is random.
            settings: The options.
        """
        super().__init__(seed=seed, settings=settings)
        self._settings = settings

    def turn_rate(self, observation: Observation) -> FloatArray:
        """Least-squares slope of the recent headings.

        Returns:
            (N,) rad/s.
        """
        settings = self._settings
        recent = observation.states[:, -settings.window :]
        weight = observation.valid[:, -settings.window :].astype(np.float64)
        time = observation.dt * np.arange(1 - recent.shape[1], 1)
        # Relative to the present heading: no jump of 2 pi can enter the fit.
        turned = wrap_angle(recent[..., USER_HEADING] - recent[:, -1:, USER_HEADING])
        turned = np.where(weight > 0, turned, 0.0)
        samples = weight.sum(axis=1)
        offset = time - (weight @ time / samples)[:, None]
        spread = (weight * offset**2).sum(axis=1)
        known = (samples >= settings.least_headings) & ~of_kind(observation, WALKING_KINDS)
        slope = np.divide(
            (weight * offset * turned).sum(axis=1),
            spread,
            out=np.zeros_like(spread),
            where=known,
        )
        speed = np.abs(observation.states[:, -1, USER_VELOCITY])
        tightest = speed / settings.tightest_radius
        gripping = settings.lateral_acceleration / np.maximum(speed, 1.0)
        limit = np.minimum(tightest, gripping)
        return np.asarray(np.clip(slope, -limit, limit))


class GroundTruthPredictor(OraclePredictor):
    """Predicts what is recorded: an upper bound for every predictor.

    A road user has no prediction where its recording has ended.
    """

    name = "ground-truth-v1"
    has_sets = False

    def __init__(self, *, seed: int = 0, settings: PredictorSettings = PredictorSettings()) -> None:
        """Begins without a recording.

        Args:
            seed: Seed of the run; nothing here is random.
            settings: The options.
        """
        super().__init__(seed=seed, settings=settings)
        self._tracks: Tracks | None = None

    def reveal(self, tracks: Tracks) -> None:
        """Keeps the recording.

        Args:
            tracks: Every road user at every step, future included.
        """
        self._tracks = tracks

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        """Looks the future up.

        Returns:
            The recorded centres and headings; NaN and not valid where there are none.

        Raises:
            PluginError: The recording was not revealed.
        """
        tracks = self._tracks
        if tracks is None:
            raise PluginError(f"predictor {self.name}: call reveal(tracks) before predict")
        order = np.argsort(tracks.ids)
        rows = order[np.searchsorted(tracks.ids, observation.ids, sorter=order)]
        columns = observation.step + 1 + np.arange(self.horizon)
        recorded = columns < tracks.steps
        index = np.ix_(rows, np.minimum(columns, tracks.steps - 1))
        valid = tracks.valid[index] & recorded
        future = np.where(valid[..., None], tracks.states[index], np.nan)
        return Occupancy.from_trajectory(
            observation, future[..., :2], future[..., USER_HEADING], valid=valid
        )
