"""Ellipses by representation, and the distance of a point to them.

The representations are those of "Towards Safe and Reliable Autonomous Driving: Dynamic Occupancy
Set Prediction" (Shao, Xu, Yu, Li, Wang). Everything here is in the road user's own frame: origin
at its centre now, x axis along its heading now. An angle is kept as the cosine and sine of its
double, since an ellipse turned by half a turn is the same one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import torch
from dosplan_net.features import HORIZON
from dosplan_net.network import step_seconds
from torch import Tensor
from torch.nn import functional

from dosplan_dos.grid import GRID

LEAST_AXIS: Final = 0.05  # m; the shortest semi-axis.
MOTION_STEPS: Final = 5  # Steps whose displacement gives the direction of the present motion.
AREA_POINTS: Final = 32  # In each ellipse of a union, by which its area is found.
STEEPNESS: Final = 6.0  # Of the smooth step that stands for "not covered", in log distance.
LEAST_MOTION: Final = 0.3  # m; below this displacement the heading is taken for the direction.


class Variant(StrEnum):
    """How an ellipse is parametrised: which of its axes and angle are learned."""

    CIRCLE = "circle"
    THETA_0 = "theta-0"
    THETA_45 = "theta-45"
    V1 = "v1"
    V2 = "v2"
    FREE = "free"
    PATH = "path"


@dataclass(frozen=True)
class Ellipses:
    """Ellipses around predicted centres.

    Attributes:
        semi_axes: (B, T, 2) semi-axes a and b, m.
        double_angle: (B, T, 2) cosine and sine of twice the angle of the first semi-axis.
    """

    semi_axes: Tensor
    double_angle: Tensor

    @property
    def area(self) -> Tensor:
        """(B, T) area, pi a b, m2."""
        return math.pi * self.semi_axes.prod(-1)

    def at(self, columns: Sequence[int]) -> Ellipses:
        """Those of some columns."""
        return Ellipses(self.semi_axes[:, columns], self.double_angle[:, columns])

    def area_scaled(self, factor: Tensor) -> Tensor:
        """(B, T) areas with semi-axes times factors that broadcast to (B, T), m2."""
        return self.area * factor * factor

    def distance(self, error: Tensor) -> Tensor:
        """Mahalanobis distance: 1 on the boundary.

        Args:
            error: (B, T, 2) true minus predicted centre, m.

        Returns:
            (B, T) distance.
        """
        inverse = self.semi_axes.square().reciprocal()
        mean, half = inverse.mean(-1), 0.5 * (inverse[..., 0] - inverse[..., 1])
        x, y = error[..., 0], error[..., 1]
        turned = self.double_angle[..., 0] * (x * x - y * y) + 2 * self.double_angle[..., 1] * x * y
        return (mean * (x * x + y * y) + half * turned).clamp(min=1e-8).sqrt()


@dataclass(frozen=True)
class Unions:
    """Unions of M ellipses each.

    Attributes:
        semi_axes: (B, M, T, 2) see ``Ellipses``.
        double_angle: (B, M, T, 2) see ``Ellipses``.
        centre: (B, M, T, 2) centres, m; the axes are in the same frame.
    """

    semi_axes: Tensor
    double_angle: Tensor
    centre: Tensor

    def distances(self, point: Tensor) -> Tensor:
        """(B, M, T) Mahalanobis distance of (B, T, 2) points, m, to each ellipse."""
        every = Ellipses(self.semi_axes, self.double_angle)
        return every.distance(point[:, None] - self.centre)

    def distance(self, point: Tensor) -> Tensor:
        """(B, T) that to the nearest ellipse: 1 on the boundary of a union, less inside.

        Scaling all of a union's ellipses around their centres by this factor puts the point on its
        boundary.
        """
        return self.distances(point).amin(1)

    def at(self, columns: Sequence[int]) -> Unions:
        """Those of some columns."""
        parts = (self.semi_axes, self.double_angle, self.centre)
        return Unions(*(part[:, :, columns] for part in parts))

    def area_scaled(self, factor: Tensor) -> Tensor:
        """(B, T) areas with semi-axes times factors that broadcast to (B, T), m2."""
        broad = torch.broadcast_to(factor, self.semi_axes[:, 0, :, 0].shape)[:, None, :, None]
        return replace(self, semi_axes=self.semi_axes * broad).area

    @property
    def area(self) -> Tensor:
        """(B, T) areas, m2; see ``area_by``."""
        return self.area_by(AREA_POINTS)

    def area_by(self, points: int) -> Tensor:
        """Area of the unions, m2: where ellipses overlap it counts once.

        The union's area is the sum over its ellipses of the integral of 1 / (number of ellipses at
        that place). The integral is taken as the mean over points that are spread evenly over each
        ellipse. Whether another ellipse holds a point is a smooth step of its distance, of the
        same steepness as that of a coverage loss, so that the area has a gradient.

        Args:
            points: In each ellipse.

        Returns:
            (B, T) areas.
        """
        count = self.semi_axes.shape[1]
        alone = math.pi * self.semi_axes.prod(-1)
        if count == 1:
            return alone[:, 0]
        disc = sunflower(points).to(alone.device) * self.semi_axes[..., None, :]
        cosine, sine = half_angle(self.double_angle)
        x = disc[..., 0] * cosine[..., None] - disc[..., 1] * sine[..., None]
        y = disc[..., 0] * sine[..., None] + disc[..., 1] * cosine[..., None]
        spread = torch.stack([x, y], -1) + self.centre[..., None, :]  # (B, M, T, points, 2)
        held = torch.ones_like(x)
        for other in range(count):
            ellipse = Ellipses(
                self.semi_axes[:, other, None, :, None], self.double_angle[:, other, None, :, None]
            )
            distance = ellipse.distance(spread - self.centre[:, other, None, :, None])
            inside = torch.sigmoid(-STEEPNESS * distance.log())
            same = torch.arange(count, device=alone.device) == other
            held = held + torch.where(same[:, None, None], torch.zeros_like(x), inside)
        return (alone * held.reciprocal().mean(-1)).sum(1)


def sunflower(count: int) -> Tensor:
    """(count, 2) points spread evenly over the unit disc, by the golden angle."""
    number = torch.arange(count) + 0.5
    radius, angle = (number / count).sqrt(), number * (math.pi * (3.0 - math.sqrt(5.0)))
    return torch.stack([radius * torch.cos(angle), radius * torch.sin(angle)], -1)


def half_angle(double: Tensor) -> tuple[Tensor, Tensor]:
    """Cosine and sine of an angle between -90 and 90 degrees, of those (..., 2) of its double."""
    cosine = (0.5 * (1.0 + double[..., 0])).clamp(min=1e-6).sqrt()
    return cosine, 0.5 * double[..., 1] / cosine


def grid_steps() -> Tensor:
    """(G,) columns of a trajectory at which the module makes sets: 0.2 s, 0.4 s, ..., 4 s."""
    return torch.arange(GRID - 1, HORIZON, GRID)


def grid_seconds(like: Tensor | None = None) -> Tensor:
    """(G,) their times, s, where ``like`` is."""
    return step_seconds(like)[grid_steps()]


def legs(path: Tensor) -> Tensor:
    """(B, G, 2) way from each point of a path (B, G, 2) to the next, the first from the origin."""
    return path - functional.pad(path[:, :-1], (0, 0, 1, 0))  # ONNX knows no torch.diff.


def ellipses(variant: Variant, raw: Tensor, trajectory: Tensor, history: Tensor) -> Ellipses:
    """Makes ellipses of a representation from the decoder's output.

    Semi-axes are softplus values times a factor that grows with time, so that the decoder needs
    only to express how hard a road user is to predict, not how far ahead the step is.

    Args:
        variant: The representation.
        raw: (B, G, 4) the decoder's output: two lengths, cosine and sine of the double angle.
        trajectory: (B, G, 2) predicted centres, m.
        history: (B, HISTORY, 6) see ``dosplan_net.features.SceneFeatures``.

    Returns:
        Ellipses at the steps of the grid.
    """
    lengths = functional.softplus(raw[..., :2]) * (0.15 + 0.5 * grid_seconds(raw))[:, None]
    lengths = lengths + LEAST_AXIS
    if variant is Variant.CIRCLE:
        lengths = lengths[..., :1].expand(-1, -1, 2)
    along = _ahead(lengths)
    match variant:
        case Variant.CIRCLE | Variant.THETA_0:
            angle = along
        case Variant.THETA_45:
            angle = along.flip(-1)
        case Variant.V1:
            angle = _doubled(_present_motion(history))[:, None].expand_as(along)
        case Variant.V2:
            angle = _doubled(legs(trajectory), GRID / MOTION_STEPS)
        case Variant.FREE:
            # Next to the origin the direction is undefined; the offset starts it along the heading.
            angle = functional.normalize(raw[..., 2:4] + along, dim=-1, eps=1e-6)
        case Variant.PATH:
            # As free, but against the direction of the path instead of the present heading.
            offset = functional.normalize(raw[..., 2:4] + along, dim=-1, eps=1e-6)
            angle = _turned_by(offset, _doubled(legs(trajectory), GRID / MOTION_STEPS))
    return Ellipses(lengths, angle)


def _turned_by(first: Tensor, second: Tensor) -> Tensor:
    """Cosine and sine (..., 2) of the sum of two angles."""
    (a, b), (c, d) = first.unbind(-1), second.unbind(-1)
    return torch.stack([a * c - b * d, b * c + a * d], -1)


def _ahead(like: Tensor) -> Tensor:
    """Unit vectors along the heading, as many as ``like`` (..., 2) holds."""
    one = torch.ones_like(like[..., 0])
    return torch.stack([one, torch.zeros_like(one)], -1)


def _present_motion(history: Tensor) -> Tensor:
    """(B, 2) displacement over the last half second, m; zero where it is not known."""
    earlier = history[:, -1 - MOTION_STEPS]
    return -earlier[:, :2] * earlier[:, 5:]


def _doubled(motion: Tensor, share: float = 1.0) -> Tensor:
    """Cosine and sine of twice a motion's direction; along the heading where it is short."""
    length = motion.norm(dim=-1, keepdim=True)
    moves = length > LEAST_MOTION * share
    unit = torch.where(moves, motion / length.clamp(min=1e-6), _ahead(motion))
    x, y = unit[..., 0], unit[..., 1]
    return torch.stack([x * x - y * y, 2 * x * y], -1)
