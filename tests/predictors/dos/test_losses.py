"""Losses: by hand on single windows, and by what training on a known law ends in."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from dosplan_dos.losses import (
    FARTHEST,
    CoverageLoss,
    GaussianLoss,
    LossConfig,
    PaperLoss,
    SetLoss,
    SizeLoss,
)
from dosplan_dos.shapes import Ellipses, grid_seconds
from torch import Tensor

torch.set_num_threads(1)

G = len(grid_seconds())
SIGMA = (0.1 + 0.5 * grid_seconds())[:, None] * torch.tensor([1.0, 0.5])
"""(G, 2) standard deviations of an error along and across, m."""


def upright(semi_axes: Tensor) -> Ellipses:
    along = torch.zeros_like(semi_axes)
    along[..., 0] = 1.0
    return Ellipses(semi_axes, along)


def learned(loss: SetLoss, sigma: Tensor, *, circle: bool = False, steps: int = 800) -> Tensor:
    """(G, 2) semi-axes that training by a loss ends in, on Gaussian errors; circles at first."""
    torch.manual_seed(0)
    size = sigma.mean(-1, keepdim=True).log()
    logarithm = size.repeat(1, 1 if circle else 2).requires_grad_()
    optimiser = torch.optim.SGD([logarithm], lr=0.5)
    average = torch.zeros(G, 2)
    loss.train()
    for step in range(steps):
        error = torch.randn(256, G, 2) * sigma
        sets = upright(logarithm.exp().expand(256, G, 2))
        optimiser.zero_grad()
        loss(sets, error, torch.ones(256, G)).backward()
        optimiser.step()
        if step >= steps // 2:
            average += logarithm.detach() / (steps - steps // 2)
    return average.exp()


def coverage(axes: Tensor, sigma: Tensor) -> Tensor:
    """(G,) share of fresh errors inside."""
    generator = torch.Generator().manual_seed(1)
    error = torch.randn(40_000, G, 2, generator=generator) * sigma
    return (upright(axes.expand(40_000, G, 2)).distance(error) <= 1).float().mean(0)


@pytest.mark.parametrize(
    ("k", "alpha", "beta"), [(0.1, 3.0, 0.0), (0.5, 1.0, 0.0), (0.01, 10.0, 2.0)]
)
def test_the_papers_loss_by_hand(k: float, alpha: float, beta: float) -> None:
    random = np.random.default_rng(0)
    axes = random.uniform(0.5, 3.0, (4, G, 2))
    turn = random.uniform(-3.0, 3.0, (4, G))
    error = random.normal(0.0, 2.0, (4, G, 2))
    valid = random.random((4, G)) < 0.7
    total, count = 0.0, 0
    for row, step in zip(*np.nonzero(valid), strict=True):
        a, b = axes[row, step]
        cosine, sine = np.cos(turn[row, step]), np.sin(turn[row, step])
        x, y = error[row, step]
        distance = math.hypot((x * cosine + y * sine) / a, (y * cosine - x * sine) / b)
        # L_a in the paper: pi / 4 times full length times full width.
        total += distance if distance <= 1 else distance**alpha + beta
        total += k * math.pi / 4 * (2 * a) * (2 * b)
        count += 1
    double = np.stack([np.cos(2 * turn), np.sin(2 * turn)], -1)
    sets = Ellipses(torch.from_numpy(axes), torch.from_numpy(double))
    loss = PaperLoss(k, alpha, beta)(
        sets, torch.from_numpy(error), torch.from_numpy(valid).double()
    )
    assert float(loss) == pytest.approx(total / count, rel=1e-9)


LOSSES = [LossConfig(name) for name in ("paper", "coverage", "gaussian", "size")]


@pytest.mark.parametrize("config", LOSSES, ids=lambda config: config.name)
def test_what_is_not_recorded_does_not_count(config: LossConfig) -> None:
    torch.manual_seed(0)
    sets, error = upright(torch.rand(6, G, 2) + 0.1), torch.randn(6, G, 2)
    valid = (torch.rand(6, G) < 0.5).float()
    reference = config.make().eval()(sets, error, valid)
    far = torch.where(valid[..., None] > 0, error, 1e6)
    assert torch.equal(config.make().eval()(sets, far, valid), reference)
    nothing = config.make()(sets, error, torch.zeros(6, G))
    assert float(nothing) == 0.0


@pytest.mark.parametrize("config", LOSSES, ids=lambda config: config.name)
def test_gradients_are_finite_on_the_centre_and_far_away(config: LossConfig) -> None:
    axes = torch.full((1, G, 2), 0.05, requires_grad=True)
    error = torch.zeros(1, G, 2)
    error[0, 1::2] = 1e4
    config.make()(upright(axes), error, torch.ones(1, G)).backward()
    assert axes.grad is not None
    assert torch.isfinite(axes.grad).all()


def test_an_outlier_pulls_no_harder_than_the_farthest() -> None:
    sets = upright(torch.ones(1, G, 2))
    near, far = (torch.full((1, G, 2), x) for x in (FARTHEST, 1e5))
    loss = PaperLoss()
    assert torch.equal(loss(sets, near, torch.ones(1, G)), loss(sets, far, torch.ones(1, G)))


def test_balanced_multipliers_neither_grow_nor_shrink_the_sets() -> None:
    torch.manual_seed(0)
    error, valid = torch.randn(4000, G, 2), (torch.rand(4000, G) < 0.7).float()
    # Each step has sets of another size.
    axes = torch.linspace(1.0, 3.0, G)[:, None].expand(G, 2).contiguous()
    loss = CoverageLoss(0.9).eval()

    def pull() -> torch.Tensor:
        factor = torch.ones(G, 1, requires_grad=True)
        loss(upright((factor * axes).expand(4000, G, 2)), error, valid).backward()
        assert factor.grad is not None
        return factor.grad[:, 0]

    before = pull()
    loss.balance(upright(axes.expand(4000, G, 2)), error, valid)
    assert torch.all(pull().abs() < 1e-3 * before.abs().max())


@pytest.mark.parametrize("wanted", [0.8, 0.9])
def test_coverage_loss_covers_what_is_wanted_by_the_least_area(wanted: float) -> None:
    axes = learned(CoverageLoss(wanted), SIGMA)
    assert torch.all((coverage(axes, SIGMA) - wanted).abs() < 0.02)
    # The highest-density region: semi-axes q sigma with exp(-q^2 / 2) = 1 - c, so that the area
    # is -2 ln(1 - c) pi sigma_x sigma_y.
    least = -2 * math.log(1 - wanted) * math.pi * SIGMA.prod(-1)
    area = math.pi * axes.prod(-1)
    # 2 points of coverage around 0.9 are 10 % of area, and no set of that coverage is smaller.
    assert torch.all(area < 1.12 * least)
    assert torch.all(area > 0.88 * least)
    torch.testing.assert_close(axes[:, 0] / axes[:, 1], torch.full((G,), 2.0), rtol=0.15, atol=0.0)


def test_multipliers_rise_where_too_little_is_covered_and_only_in_training() -> None:
    loss = CoverageLoss(0.9)
    small, error = upright(torch.full((8, G, 2), 0.1)), torch.ones(8, G, 2)
    loss.eval()(small, error, torch.ones(8, G))
    assert not loss.log_multiplier.any()
    loss.train()(small, error, torch.ones(8, G))
    # All are missed where a tenth may be: rate * (1 - 0.1) / 0.1.
    torch.testing.assert_close(loss.log_multiplier, torch.full((G,), 0.02 * 9.0))
    loss(upright(torch.full((8, G, 2), 9.0)), error, torch.ones(8, G))
    torch.testing.assert_close(loss.log_multiplier, torch.full((G,), 0.02 * 8.0))


def test_gaussian_loss_recovers_the_standard_deviations() -> None:
    axes = learned(GaussianLoss(), SIGMA)
    torch.testing.assert_close(axes, SIGMA, rtol=0.05, atol=0.0)


def test_size_loss_recovers_the_median_size() -> None:
    """Beyond its rounding of 0.1 m the loss is absolute; a Rayleigh's median is s sqrt(2 ln 2)."""
    sigma = SIGMA[:, :1].expand(G, 2)
    radius = learned(SizeLoss(), sigma, circle=True)[:, 0]
    expected = sigma[:, 0] * math.sqrt(2 * math.log(2))
    torch.testing.assert_close(radius[5:], expected[5:], rtol=0.05, atol=0.0)


def test_a_config_makes_the_loss_it_names() -> None:
    paper = LossConfig("paper", k=0.2, alpha=2.0, beta=1.0).make()
    assert isinstance(paper, PaperLoss)
    assert (paper.k, paper.alpha, paper.beta) == (0.2, 2.0, 1.0)
    coverage_loss = LossConfig("coverage", coverage=0.7).make()
    assert isinstance(coverage_loss, CoverageLoss)
    assert coverage_loss.coverage == 0.7
    assert isinstance(LossConfig("gaussian").make(), GaussianLoss)
    assert isinstance(LossConfig("size").make(), SizeLoss)
    with pytest.raises(ValueError, match="there is no loss 'papr'; choose paper"):
        replace(LossConfig(), name="papr").make()
