"""What an occupancy set is trained for.

* ``PaperLoss``: small inside, steep outside, plus the area, with k, alpha and beta.
* ``CoverageLoss``: the least area that covers a wanted share at every step.
* ``GaussianLoss``: maximum likelihood, for the paper's baseline PR.
* ``SizeLoss``: regression of the error's size, for its baseline SA.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from dosplan_dos.shapes import STEEPNESS, Ellipses, Unions, grid_seconds

FARTHEST = 30.0  # Distances are clipped here, so that one outlier does not dominate a batch.


class SetLoss(ABC, nn.Module):
    """A loss of ellipses against the true positions."""

    @abstractmethod
    def forward(self, sets: Ellipses, error: Tensor, valid: Tensor) -> Tensor:
        """The loss.

        Args:
            sets: B x G ellipses.
            error: (B, G, 2) true minus predicted centre, m.
            valid: (B, G) 1 where the truth is recorded, 0 elsewhere.

        Returns:
            A scalar.
        """


class PaperLoss(SetLoss):
    """L = L_c + k L_a, section "Loss" of the paper.

    l_c is d_M inside and d_M^alpha + beta outside the set; L_a is the mean area. beta shifts the
    loss and has no gradient; it is here since the paper's L has it.
    """

    def __init__(self, k: float = 0.1, alpha: float = 3.0, beta: float = 0.0) -> None:
        super().__init__()
        self.k, self.alpha, self.beta = k, alpha, beta

    def forward(self, sets: Ellipses, error: Tensor, valid: Tensor) -> Tensor:
        """See ``SetLoss.forward``."""
        distance = sets.distance(error).clamp(max=FARTHEST)
        cost = torch.where(distance <= 1, distance, distance**self.alpha + self.beta)
        return _mean(cost + self.k * sets.area, valid)


class CoverageLoss(SetLoss):
    """Least area under the constraint that a share of the truths is covered at every step.

    The Lagrangian of: minimise E[area_t] subject to P(d_M <= 1) >= coverage. The indicator is
    smoothed in log distance; the multipliers, one a step, are raised where less than the wanted
    share of a batch is covered and lowered where more is (dual ascent). Areas count in units that
    grow with time, so that the late steps do not dominate the early ones.

    Unions can be trained for it as well: a truth is missed that is in none of a union's ellipses,
    and the area is that of the union, not the sum of those of its ellipses.
    """

    log_multiplier: Tensor
    unit: Tensor

    def __init__(self, coverage: float = 0.9, rate: float = 0.02) -> None:
        super().__init__()
        self.coverage, self.rate = coverage, rate
        steps = len(grid_seconds())
        self.register_buffer("log_multiplier", torch.zeros(steps))
        self.register_buffer("unit", 0.3 + 4.0 * grid_seconds() ** 2)

    def balance(self, sets: Ellipses | Unions, error: Tensor, valid: Tensor) -> None:
        """Sets the multipliers under which these sets are neither to grow nor to shrink.

        Trained sets are under such ones; the loss of a training that begins from them would
        otherwise begin by making them larger, as its first multipliers are those for small sets.

        Args:
            sets: B x G sets.
            error: See ``forward``.
            valid: See ``forward``.
        """
        distance = sets.distance(error).detach().clamp(max=FARTHEST)
        with torch.enable_grad():
            factor = torch.ones_like(self.unit, requires_grad=True)
            area = (sets.area_scaled(factor) / self.unit * valid).sum()
            missed = (torch.sigmoid(STEEPNESS * (distance / factor).log()) * valid).sum()
            (growth,) = torch.autograd.grad(area, factor)
            (gain,) = torch.autograd.grad(missed, factor)
        balanced = growth / (10.0 * -gain).clamp(min=1e-6)
        self.log_multiplier.copy_(balanced.clamp(min=1e-3).log())

    def forward(self, sets: Ellipses | Unions, error: Tensor, valid: Tensor) -> Tensor:
        """See ``SetLoss.forward``; of unions, ``error`` is the true centre itself, m."""
        logarithm = sets.distance(error).clamp(max=FARTHEST).log()
        missed = torch.sigmoid(STEEPNESS * logarithm)
        if self.training:
            with torch.no_grad():
                share = ((logarithm > 0) * valid).sum(0) / valid.sum(0).clamp(min=1)
                self.log_multiplier += self.rate * (share - (1 - self.coverage)) / 0.1
        multiplier = self.log_multiplier.exp() * 10.0
        return _mean(sets.area / self.unit + multiplier * missed, valid)


class GaussianLoss(SetLoss):
    """Negative log-likelihood of a Gaussian whose standard deviations are the semi-axes."""

    def forward(self, sets: Ellipses, error: Tensor, valid: Tensor) -> Tensor:
        """See ``SetLoss.forward``."""
        distance = sets.distance(error).clamp(max=FARTHEST)
        return _mean(sets.semi_axes.log().sum(-1) + 0.5 * distance.square(), valid)


class SizeLoss(SetLoss):
    """Smooth L1 distance between a circle's radius and the size of the error."""

    def forward(self, sets: Ellipses, error: Tensor, valid: Tensor) -> Tensor:
        """See ``SetLoss.forward``."""
        radius, size = sets.semi_axes[..., 0], error.norm(dim=-1)
        return _mean(functional.smooth_l1_loss(radius, size, reduction="none", beta=0.1), valid)


@dataclass(frozen=True)
class LossConfig:
    """Names a loss and its parameters.

    Attributes:
        name: ``paper``, ``coverage``, ``gaussian`` or ``size``.
        k: Weight of the area (paper).
        alpha: Exponent outside (paper).
        beta: Offset outside (paper).
        coverage: Wanted share (coverage).
    """

    name: str = "coverage"
    k: float = 0.1
    alpha: float = 3.0
    beta: float = 0.0
    coverage: float = 0.9

    def __post_init__(self) -> None:
        self.make()  # An unknown name is refused before anything is trained.

    def make(self) -> SetLoss:
        """Builds the loss.

        Returns:
            The loss.

        Raises:
            ValueError: There is no loss of that name.
        """
        match self.name:
            case "paper":
                return PaperLoss(self.k, self.alpha, self.beta)
            case "coverage":
                return CoverageLoss(self.coverage)
            case "gaussian":
                return GaussianLoss()
            case "size":
                return SizeLoss()
        raise ValueError(
            f"there is no loss {self.name!r}; choose paper, coverage, gaussian or size"
        )


def _mean(cost: Tensor, valid: Tensor) -> Tensor:
    return (cost * valid).sum() / valid.sum().clamp(min=1)
