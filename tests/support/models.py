"""Tiny models with random weights, and scenes that several tests of the models share."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from dosplan_dos.losses import LossConfig
from dosplan_dos.module import OccupancyModule, SetConfig, UnionModule
from dosplan_dos.shapes import Variant
from dosplan_dos.training import MODEL as SETS_MODEL
from dosplan_dos.training import describe_config
from dosplan_net.build import MODEL as NETWORK_MODEL
from dosplan_net.build import build_network
from dosplan_net.light_network import LightConfig, LightResponse, save_response
from dosplan_net.network import MODAL, NetworkConfig, TrajectoryNetwork
from dosplan_net.weights import save_weights
from shapely import affinity

from dosplan.scenario.synthetic import straight_scenario
from dosplan.simulation.world import World
from dosplan.types import FloatArray, Observation, RoadMap, Scenario, Tracks

torch.set_num_threads(1)  # For models this small more threads only cost time.

TINY = NetworkConfig(history=8, map=8, hidden=12, heads=2, decoder=16)
MODES = replace(TINY, architecture=MODAL, modes=3)


def tiny_network(seed: int = 0, config: NetworkConfig = TINY) -> TrajectoryNetwork:
    """A network whose decoder says more than a fresh one's, so that its inputs matter."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = build_network(config)
    last = "path.weight" if config.architecture == MODAL else "decoder.2.weight"
    with torch.no_grad():
        network.get_parameter(last).mul_(10.0)
    return network.eval()


def save_network(path: Path, seed: int = 0, config: NetworkConfig = TINY) -> Path:
    """Writes a tiny network as training would."""
    about = {"model": NETWORK_MODEL, "network": asdict(config), "validation": {"ade": 1.0}}
    save_weights(path, tiny_network(seed, config).state_dict(), about)
    return path


def save_lights(network: Path, seed: int = 0) -> Path:
    """Writes a tiny response to lights beside a tiny network, as training would."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        response = LightResponse(LightConfig(hidden=8, features=TINY.hidden))
        torch.nn.init.normal_(response.get_parameter("layers.6.weight"))
    path = network.with_suffix(".lights.safetensors")
    save_response(path, response, network, {"ade": 1.0})
    return path


def save_sets(path: Path, variant: Variant = Variant.FREE, seed: int = 0) -> Path:
    """Writes a tiny module on the features of a tiny network as training would."""
    config = SetConfig(variant, LossConfig(), features=TINY.hidden, hidden=8)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        module = OccupancyModule(config)
    with torch.no_grad():
        module.get_parameter("decoder.2.weight").mul_(5.0)
    about = {"model": SETS_MODEL, "module": describe_config(config), "validation": {"osa90": 1.0}}
    save_weights(path, module.state_dict(), about)
    return path


def save_unions(path: Path, *, shifted: bool = False, seed: int = 0) -> Path:
    """Writes a tiny module of unions on the features of a tiny network of several courses."""
    config = SetConfig(
        Variant.PATH, LossConfig(), features=TINY.hidden, hidden=8, modes=3, shifted=shifted
    )
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        module = UnionModule(config)
    about = {"model": SETS_MODEL, "module": describe_config(config), "validation": {"osa90": 1.0}}
    save_weights(path, module.state_dict(), about)
    return path


def seen(scenario: Scenario, history: int = 31) -> Observation:
    """What is known at the start of a scenario."""
    task = scenario.task
    return World(scenario, first_step=task.start_step, history=history).observation()


def seen_at(tracks: Tracks, step: int, history: int = 31) -> Observation:
    """What is known of some tracks on the straight road."""
    scenario = straight_scenario(tracks)
    return World(scenario, first_step=step, history=history).observation()


def turned(points: FloatArray, angle: float) -> FloatArray:
    """(..., 2) points turned about the origin."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[cosine, sine], [-sine, cosine]]))


def moved_states(states: FloatArray, angle: float, shift: FloatArray) -> FloatArray:
    """(..., 4) road-user states, turned about the origin and then shifted."""
    out = np.array(states)
    out[..., :2] = turned(states[..., :2], angle) + shift
    out[..., 2] += angle
    return out


def moved_map(road_map: RoadMap, angle: float, shift: FloatArray) -> RoadMap:
    """A map, turned about the origin and then shifted."""
    lanelets = tuple(
        replace(
            lanelet,
            left=turned(lanelet.left, angle) + shift,
            right=turned(lanelet.right, angle) + shift,
        )
        for lanelet in road_map.lanelets
    )
    drivable = affinity.rotate(road_map.drivable, angle, origin=(0.0, 0.0), use_radians=True)
    return RoadMap(lanelets, affinity.translate(drivable, *shift))


def moved(observation: Observation, angle: float, shift: FloatArray) -> Observation:
    """The same scene elsewhere: road users and map; the ego, whom nobody foresees, stays."""
    return replace(
        observation,
        states=moved_states(observation.states, angle, shift),
        road_map=moved_map(observation.road_map, angle, shift),
    )
