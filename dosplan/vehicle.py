"""The ego: its size, its limits, the kinematic single track, and what its actuators deliver.

The ego of an episode is part of its task: ``scenario.task.vehicle``, ``observation.task.vehicle``.
"""

from dosplan.types.vehicle import VehicleParameters

__all__ = ["VehicleParameters"]
