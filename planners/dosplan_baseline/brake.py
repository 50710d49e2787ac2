"""``brake-v1``: brakes to a standstill on the path and ignores the road users."""

from __future__ import annotations

from dataclasses import dataclass

from dosplan.types.checks import check_numbers
from dosplan_baseline.constant import ConstantAccelerationPlanner


@dataclass(frozen=True)
class BrakeSettings:
    """The options of full braking.

    Attributes:
        deceleration: m/s2; the default is what tyres give on a dry road.
    """

    deceleration: float = 8.0

    def __post_init__(self) -> None:
        check_numbers(self, positive={"deceleration"})


class BrakePlanner(ConstantAccelerationPlanner):
    """Full braking along the route; the lower bound of every comparison."""

    name = "brake-v1"
    settings = BrakeSettings

    def __init__(self, *, seed: int = 0, settings: BrakeSettings = BrakeSettings()) -> None:
        """Keeps the deceleration.

        Args:
            seed: Seed of the run; nothing here is random.
            settings: The options.
        """
        super().__init__(seed=seed, settings=settings)
        self.acceleration = -settings.deceleration
