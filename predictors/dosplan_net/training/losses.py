"""What the trajectories of a network are trained for."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dosplan_net.network import Prediction, step_seconds


@dataclass(frozen=True)
class TrajectoryLoss:
    """Winner takes all, with a share for the most likely one and for all of them.

    The trajectory that came closest is drawn to the truth, and the network learns to tell which one
    that will be. That alone leaves the most likely trajectory worse than a network has that
    foretells only one; hence the share ``likeliest``. ``everyone`` keeps trajectories that never
    come closest from staying where they are. With one trajectory all of them are the same.

    Attributes:
        likeliest: Share of the displacement of the most likely trajectory.
        everyone: Share of the mean displacement of all trajectories.
        choice: Weight of the likelihood of the one that came closest, m.
        early: How much more the first steps count: their weight falls from 1 + ``early`` to 1
            as 1 / (1 + t / 0.5 s).
    """

    likeliest: float = 0.4
    everyone: float = 0.05
    choice: float = 0.3
    early: float = 0.0

    def total(self, found: Prediction, future: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
        """Sums the loss.

        Args:
            found: Of T targets.
            future: (T, HORIZON, 2 or more) true centres, m.
            valid: (T, HORIZON) whether they are recorded.

        Returns:
            The sum over targets and steps, m, and the number of those that are recorded.
        """
        error = displacements(found.trajectory, future)
        weight = valid * (1.0 + self.early / (1.0 + step_seconds(error) / 0.5))
        cost = (error * weight[:, None]).sum(-1)
        best = best_of(error, valid)[:, None]
        top = found.log_weight.argmax(1, keepdim=True)
        chosen = found.log_weight.gather(1, best)[:, 0]
        total = (
            (1.0 - self.likeliest - self.everyone) * cost.gather(1, best).sum()
            + self.likeliest * cost.gather(1, top).sum()
            + self.everyone * cost.mean(1).sum()
            - self.choice * (chosen * valid.sum(1)).sum()
        )
        return total, valid.sum()


def displacements(trajectory: Tensor, future: Tensor) -> Tensor:
    """(T, M, HORIZON) distances, m, of (T, M, HORIZON, 2) trajectories to (T, HORIZON, 2 ...)."""
    return torch.sqrt((trajectory - future[:, None, :, :2]).square().sum(-1) + 1e-6)


def best_of(error: Tensor, valid: Tensor) -> Tensor:
    """(T,) number of the trajectory with the least error (T, M, HORIZON) where valid."""
    return (error * valid[:, None]).sum(-1).argmin(1)
