"""The tracker's filter: the likeliest motion of each road user behind what was measured of it.

An extended Kalman filter of the plane motion of each road user. Its acceleration and the curvature
of its path are first-order Gauss-Markov processes, as in the model of Singer ("Estimating Optimal
Tracking Filter Performance for Manned Maneuvering Targets", 1970). So the heading of one that moves
follows the way that it goes, and one that stands keeps its heading. The errors of what is measured
go on from one moment to the next; their own processes are states of the filter, as an error that is
correlated in time asks for (Bryson, Johansen, "Linear Filtering for Time-Varying Systems Using
Measurements Containing Colored Noise", 1965). A size does not change: it is the mean of all that
was measured.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from dosplan.geometry import wrap_angle
from dosplan.simulation.settings import SensingSettings
from dosplan.types import (
    USER_HEADING,
    USER_SIZE,
    USER_VELOCITY,
    BoolArray,
    FloatArray,
    IntArray,
)

# States of the filter: those of a road user, its acceleration, curvature, and the four errors.
_ACCELERATION: Final = USER_SIZE
_CURVATURE: Final = USER_SIZE + 1
_ERRORS: Final = USER_SIZE + 2
_STATES: Final = _ERRORS + USER_SIZE

_ACCELERATION_DEVIATION: Final = 2.0  # m/s2
_ACCELERATION_TIME: Final = 1.0  # s
_LATERAL: Final = 3.0  # Deviation of the lateral acceleration, m/s2 ...
_CURVATURE_MOST: Final = 0.15  # ... where the path's curvature, 1/m, is not what bounds it.
_CURVATURE_TIME: Final = 1.0  # s
_SIDEWAYS: Final = 0.02  # What goes beside the heading, as a share of the way.
_STANDING: Final = 0.5  # Who was measured at less than this in the mean, m/s, is taken to stand ...
_STANDING_TIME: Final = 0.3  # ... over about this time, s.
_CREEPING: Final = 0.2  # Deviation of the speed of one that is taken to stand, m/s.
_ROUNDING: Final = 1e-8  # Variance that keeps the innovations' covariance regular.


class TrackFilter:
    """Filters of road users, one row each."""

    def __init__(self, settings: SensingSettings, dt: float) -> None:
        """Begins with no rows.

        Args:
            settings: The errors of what is measured, which the filter knows of.
            dt: Step, s.
        """
        self._dt = dt
        deviation = [settings.position, settings.position, settings.heading, settings.speed]
        self._variance = np.square(deviation)
        kept = np.exp(-dt / settings.correlation) if settings.correlation > 0.0 else 0.0
        self._error_kept = kept
        self._acceleration_kept = np.exp(-dt / _ACCELERATION_TIME)
        self._curvature_kept = np.exp(-dt / _CURVATURE_TIME)
        self._speed_kept = np.exp(-dt / _STANDING_TIME)
        self._mean = np.empty((0, _STATES))
        self._spread = np.empty((0, _STATES, _STATES))
        self._speed = np.empty(0)  # Recent mean of what was measured.
        self._moves = np.empty(0, dtype=np.bool_)
        self._begun = np.empty(0, dtype=np.bool_)

    def add(self, moves: BoolArray) -> None:
        """Makes room for more road users.

        Args:
            moves: (N,) whether each can move at all.
        """
        count = len(moves)
        self._mean = np.concatenate([self._mean, np.zeros((count, _STATES))])
        self._spread = np.concatenate([self._spread, np.zeros((count, _STATES, _STATES))])
        self._speed = np.concatenate([self._speed, np.zeros(count)])
        self._moves = np.concatenate([self._moves, moves])
        self._begun = np.concatenate([self._begun, np.zeros(count, dtype=np.bool_)])

    def measure(self, rows: IntArray, measured: FloatArray) -> FloatArray:
        """Goes on by a step, for everybody, and takes in what was measured.

        Args:
            rows: (M,) rows of those who were seen.
            measured: (M, 4) their states as measured.

        Returns:
            (M, 4) their states as estimated.
        """
        self._predict(np.flatnonzero(self._begun))
        new = ~self._begun[rows]
        self._begin(rows[new], measured[new])
        self._update(rows[~new], measured[~new])
        speed = measured[:, USER_VELOCITY]
        kept = np.where(new, 0.0, self._speed_kept)
        self._speed[rows] = kept * self._speed[rows] + (1.0 - kept) * speed
        self._stand(rows[(np.abs(self._speed[rows]) < _STANDING) & self._moves[rows]])
        return self._mean[rows, :USER_SIZE]

    def forget(self, lost: BoolArray) -> None:
        """Begins anew with some of them when they are seen again.

        Args:
            lost: (N,) who has been lost for too long.
        """
        self._begun[lost] = False

    def _begin(self, rows: IntArray, measured: FloatArray) -> None:
        """What is known at first: a state is as measured, less an error that is not known."""
        self._begun[rows] = True
        self._mean[rows, :USER_SIZE] = measured
        self._mean[rows, USER_SIZE:] = 0.0
        variance = np.tile(self._variance, (len(rows), 1))
        variance[~self._moves[rows], USER_VELOCITY] = 0.0
        state, error = np.arange(USER_SIZE), _ERRORS + np.arange(USER_SIZE)
        spread = np.zeros((len(rows), _STATES, _STATES))
        spread[:, state, state] = spread[:, error, error] = variance
        spread[:, state, error] = spread[:, error, state] = -variance
        moves = self._moves[rows]
        spread[:, _ACCELERATION, _ACCELERATION] = moves * _ACCELERATION_DEVIATION**2
        spread[:, _CURVATURE, _CURVATURE] = moves * _curvature(measured[:, USER_VELOCITY]) ** 2
        self._spread[rows] = spread

    def _predict(self, rows: IntArray) -> None:
        dt, before = self._dt, self._mean[rows]
        heading, velocity = before[:, USER_HEADING], before[:, USER_VELOCITY]
        acceleration, curvature = before[:, _ACCELERATION], before[:, _CURVATURE]
        stops = velocity * (velocity + dt * acceleration) < 0.0
        acceleration = np.where(stops, -velocity / dt, acceleration)  # Nobody brakes backwards.
        way = velocity * dt + 0.5 * acceleration * dt**2
        course = heading + 0.5 * curvature * way
        cos, sin = np.cos(course), np.sin(course)

        after = np.array(before)
        after[:, 0] += way * cos
        after[:, 1] += way * sin
        after[:, USER_HEADING] += curvature * way
        after[:, USER_VELOCITY] += acceleration * dt
        after[:, _ACCELERATION] = np.where(stops, 0.0, self._acceleration_kept * acceleration)
        after[:, _CURVATURE] *= self._curvature_kept
        after[:, _ERRORS:] *= self._error_kept
        self._mean[rows] = after

        step = np.tile(np.eye(_STATES), (len(rows), 1, 1))
        for column, by_way, by_course in (
            (USER_HEADING, 0.0, 1.0),
            (USER_VELOCITY, dt, 0.5 * curvature * dt),
            (_ACCELERATION, 0.5 * dt**2, 0.25 * curvature * dt**2),
            (_CURVATURE, 0.0, 0.5 * way),
        ):
            step[:, 0, column] = by_way * cos - way * sin * by_course
            step[:, 1, column] = by_way * sin + way * cos * by_course
            if column != USER_HEADING:
                step[:, USER_HEADING, column] = 2.0 * by_course
        step[:, USER_VELOCITY, _ACCELERATION] = dt
        step[:, _ACCELERATION, _ACCELERATION] = self._acceleration_kept
        step[:, _CURVATURE, _CURVATURE] = self._curvature_kept
        errors = _ERRORS + np.arange(USER_SIZE)
        step[:, errors, errors] = self._error_kept

        moves = self._moves[rows]
        noise = np.zeros_like(step)
        noise[:, _ACCELERATION, _ACCELERATION] = (
            moves * _ACCELERATION_DEVIATION**2 * (1.0 - self._acceleration_kept**2)
        )
        noise[:, _CURVATURE, _CURVATURE] = (
            moves * _curvature(velocity) ** 2 * (1.0 - self._curvature_kept**2)
        )
        sideways = (_SIDEWAYS * way) ** 2
        noise[:, 0, 0], noise[:, 1, 1] = sideways * sin**2, sideways * cos**2
        noise[:, 0, 1] = noise[:, 1, 0] = -sideways * sin * cos
        noise[:, errors, errors] = self._variance * (1.0 - self._error_kept**2)
        noise[~moves, errors[USER_VELOCITY], errors[USER_VELOCITY]] = 0.0
        self._spread[rows] = step @ self._spread[rows] @ step.transpose(0, 2, 1) + noise

    def _update(self, rows: IntArray, measured: FloatArray) -> None:
        mean, spread = self._mean[rows], self._spread[rows]
        surprise = measured - mean[:, :USER_SIZE] - mean[:, _ERRORS:]
        surprise[:, USER_HEADING] = wrap_angle(surprise[:, USER_HEADING])
        seen = spread[:, :USER_SIZE] + spread[:, _ERRORS:]  # (M, 4, 10) of what is measured.
        expected = seen[:, :, :USER_SIZE] + seen[:, :, _ERRORS:] + _ROUNDING * np.eye(USER_SIZE)
        gain = np.linalg.solve(expected, seen).transpose(0, 2, 1)
        self._mean[rows] = mean + (gain @ surprise[:, :, None])[:, :, 0]
        left = spread - gain @ seen
        self._spread[rows] = 0.5 * (left + left.transpose(0, 2, 1))

    def _stand(self, rows: IntArray) -> None:
        """Takes some for standing: a measurement of their speed, zero."""
        mean, spread = self._mean[rows], self._spread[rows]
        speed = spread[:, :, USER_VELOCITY]
        gain = speed / (speed[:, USER_VELOCITY, None] + _CREEPING**2)
        self._mean[rows] = mean - gain * mean[:, USER_VELOCITY, None]
        self._spread[rows] = spread - gain[:, :, None] * speed[:, None, :]


def _curvature(velocity: FloatArray) -> FloatArray:
    """(N,) deviation of the curvature of a path at a velocity, 1/m."""
    return np.minimum(_CURVATURE_MOST, _LATERAL / np.maximum(velocity**2, 1e-6))
