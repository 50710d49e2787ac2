"""A planner of your own beside a built-in one, on the first scenarios of the suite."""

import numpy as np

import dosplan
from dosplan.api import Planner
from dosplan.types import Observation, Occupancy, Plan


class Coast(Planner):
    """Keeps its speed and brakes for road users that are predicted within ten metres."""

    name = "coast-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        vehicle = observation.task.vehicle
        gap = occupancy.centre[:, :10] - vehicle.centre(observation.ego)
        near = occupancy.valid[:, :10] & (np.hypot(gap[..., 0], gap[..., 1]) < 10.0)
        wanted = np.array([0.0, -4.0 if near.any() else 0.0])
        states, inputs = [observation.ego], []
        for _ in range(20):
            inputs.append(vehicle.clip_input(states[-1], wanted, observation.dt))
            states.append(vehicle.step(states[-1], inputs[-1], observation.dt))
        return Plan(states=np.array(states), inputs=np.array(inputs))


if __name__ == "__main__":
    idm = dosplan.run_suite("suite", "idm", "growing-circle", limit=2, out="runs/example-idm")
    coast = dosplan.run_suite("suite", Coast, "growing-circle", limit=2, out="runs/example-coast")
    for row in coast.rows:
        print(f"{row.scenario:24} {row.arm:12} {row.outcome:14} {row.velocity:5.1f} m/s")
    for c in dosplan.compare(idm, coast):
        success = c.differences["success"].difference
        print(f"{c.b} against {c.a}: success {success:+.0%} in {c.n} scenarios")
