"""A predictor of your own: drive one scenario in both arms, and look at what was predicted."""

import numpy as np

import dosplan
from dosplan.api import Predictor
from dosplan.types import USER_HEADING, USER_VELOCITY, Observation, Occupancy


class Straight(Predictor):
    """Constant velocity; the sets grow with the distance driven."""

    name = "straight-v1"

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        now = observation.states[:, -1]
        heading = np.repeat(now[:, USER_HEADING, None], self.horizon, axis=1)
        driven = now[:, USER_VELOCITY, None] * observation.dt * np.arange(1, self.horizon + 1)
        along = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        return Occupancy.from_trajectory(
            observation,
            centre=now[:, None, :2] + driven[..., None] * along,
            heading=heading,
            semi_axes=np.stack([0.2 * driven, 0.05 * driven], axis=-1),  # Along it and across.
        )


if __name__ == "__main__":
    scenario = dosplan.load_scenario(dosplan.find_scenarios("suite")[1])
    for arm in dosplan.Arm:
        driven = dosplan.run_episode(scenario, "idm", Straight(), arm)
        widest = max(float(o.semi_axes.max(initial=0.0)) for o in driven.episode.occupancies)
        print(f"{scenario.id} {arm}: {driven.row.outcome}, widest set {2.0 * widest:.1f} m")
