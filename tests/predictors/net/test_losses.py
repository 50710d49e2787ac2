"""What several trajectories are trained for."""

from __future__ import annotations

import pytest
import torch
from dosplan_net.features import HORIZON
from dosplan_net.network import Prediction
from dosplan_net.training.losses import TrajectoryLoss, best_of, displacements


def foretold(*aside: float, log_weight: torch.Tensor) -> Prediction:
    """One target whose trajectories stand still so many metres aside."""
    trajectory = torch.zeros(1, len(aside), HORIZON, 2)
    trajectory[0, :, :, 1] = torch.tensor(aside)[:, None]
    return Prediction(trajectory.requires_grad_(), log_weight.requires_grad_(), torch.zeros(1, 1))


def test_the_closest_one_is_drawn_to_the_truth_and_made_likelier() -> None:
    weight = torch.tensor([[0.5, 0.3, 0.2]]).log()
    found = foretold(-1.0, 2.0, 9.0, log_weight=weight)
    future, valid = torch.zeros(1, HORIZON, 2), torch.ones(1, HORIZON, dtype=torch.bool)
    future[..., 1] = 1.5
    error = displacements(found.trajectory, future)
    assert best_of(error, valid).tolist() == [1]
    total, count = TrajectoryLoss(likeliest=0.0, everyone=0.0, choice=0.3).total(
        found, future, valid
    )
    assert int(count) == HORIZON
    assert float(total) / HORIZON == pytest.approx(0.5 - 0.3 * float(weight[0, 1]), rel=1e-4)
    total.backward()  # type: ignore[no-untyped-call]
    assert found.trajectory.grad is not None
    assert found.log_weight.grad is not None
    moved = found.trajectory.grad[0].abs().amax((1, 2))
    assert moved[1] > 0
    assert moved[[0, 2]].max() == 0
    assert found.log_weight.grad[0].tolist() == [0.0, pytest.approx(-0.3 * HORIZON, rel=1e-5), 0.0]


def test_the_shares_of_the_likeliest_and_of_all_are_what_they_say() -> None:
    found = foretold(-1.0, 2.0, 9.0, log_weight=torch.tensor([[0.5, 0.3, 0.2]]).log())
    future, valid = torch.zeros(1, HORIZON, 2), torch.ones(1, HORIZON, dtype=torch.bool)
    future[..., 1] = 1.5
    total, _ = TrajectoryLoss(likeliest=0.4, everyone=0.1, choice=0.0).total(found, future, valid)
    expected = 0.5 * 0.5 + 0.4 * 2.5 + 0.1 * (2.5 + 0.5 + 7.5) / 3
    assert float(total) / HORIZON == pytest.approx(expected, rel=1e-4)


def test_steps_that_are_not_recorded_do_not_count() -> None:
    found = foretold(0.0, 2.0, log_weight=torch.tensor([[0.5, 0.5]]).log())
    valid = torch.zeros(1, HORIZON, dtype=torch.bool)
    valid[0, :5] = True
    near, far = torch.zeros(1, HORIZON, 2), torch.zeros(1, HORIZON, 2)
    far[:, 5:] = 100.0
    loss = TrajectoryLoss()
    assert float(loss.total(found, near, valid)[0]) == float(loss.total(found, far, valid)[0])
    assert int(loss.total(found, far, valid)[1]) == 5
