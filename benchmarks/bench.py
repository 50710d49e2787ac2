"""Times of a planning cycle and of its parts, and the ratios between them; `make bench` runs it.

Absolute times of one machine do not hold for another, and on a shared machine they change by the
minute. Hence there is one process on one core, drives that are compared follow one another, and
ratios are formed within a scenario, of medians and of processor time, which waiting for a busy
core does not count in. One drive is repeated at the end of its scenario: how far the ratio
``again`` is from one says how far the other ratios can be trusted.
"""

from __future__ import annotations

import os

# Numerical libraries read these once, when they are loaded.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from shutil import copy
from tempfile import TemporaryDirectory
from typing import Any, Final
from unittest.mock import patch

import numpy as np
from dosplan_dos.predictor import SETS, DosPredictor, DosSettings
from dosplan_mpc.compiled import CompileError, is_whole
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.nlp import Guess, MpcProblem, problems
from dosplan_mpc.obstacles import ForbiddenSets
from dosplan_mpc.stage import STATE_SIZE
from dosplan_net.encoder import MAP, SCENE, shipped_weights
from dosplan_net.engine import Engine
from dosplan_net.export import export
from dosplan_net.features import HISTORY, cut_map, describe
from rich.console import Console

from benchmarks.scenes import steady_flow, tiled
from dosplan.api import Planner, Predictor
from dosplan.plugins.registry import RegistryError, create_planner, create_predictor
from dosplan.report.tables import table
from dosplan.scenario import find_scenarios, load_scenario
from dosplan.scoring.score import score
from dosplan.simulation.loop import run_episode
from dosplan.simulation.world import World
from dosplan.system.files import write_json
from dosplan.system.provenance import describe_environment
from dosplan.types import (
    EGO_VELOCITY,
    EGO_X,
    STEP_SECONDS,
    Arm,
    EpisodeEnd,
    FloatArray,
    Scenario,
)
from dosplan.vehicle import VehicleParameters
from tests.planners.mpc.roads import straight_stages

PERCENTILES: Final = (50, 95, 99)
ROAD_USERS: Final = (5, 20, 50, 200)
HORIZONS: Final = (2, 4, 6, 8)  # s, of the planner.
MAPS: Final = (1, 4, 16, 64)  # Copies of a map, side by side.
PREDICTED: Final = (10, 30, 100)  # Road users of the scenes that the trained network predicts.
PREDICTION_PARTS: Final = ("features", "network", "sets", "total")
PREDICTIONS: Final = 60  # Of each of them.
ROUNDS: Final = 2  # Drives for each number of road users.
SOLVES: Final = 30  # Of the compiled problem and of its virtual machine.
REPEATS: Final = 3  # Of everything else that has no cycles.
VEHICLE: Final = VehicleParameters()

# ``cycle`` is predict + plan, ``plan_rest`` the plan but for the solver (sampling, references,
# sets), ``episode_rest`` what an episode spends outside its cycles, ``cpu`` processor time of
# the episode per cycle.
CYCLE_PARTS: Final = ("predict", "solver", "plan_rest", "cycle")
PARTS: Final = (*CYCLE_PARTS, "plan", "cpu", "episode", "episode_rest", "score")
Times = dict[str, FloatArray]  # ms for each part: one value per cycle, or one of the episode.
Figures = dict[str, float]


def main() -> None:
    """Measures, prints and writes."""
    options = _options()
    planner, idm = create_planner(options.planner, 0), create_planner("idm", 0)
    chosen = {} if options.engine is Engine.TORCH else {"engine": options.engine.value}
    predictor = create_predictor(options.predictor, 0, chosen)
    drives = {
        "with_dos": (planner, Arm.WITH_DOS),
        "without_dos": (planner, Arm.WITHOUT_DOS),
        "idm": (idm, Arm.WITH_DOS),
        "again": (planner, Arm.WITH_DOS),
    }
    refs = find_scenarios("suite-1")[: options.scenarios]
    # What is imported or built at the first use is not what a cycle costs.
    load_scenario(refs[0])
    for driver in (planner, idm):
        drive(steady_flow(5), driver, predictor, Arm.WITH_DOS)

    loads: list[float] = []
    scenarios: list[dict[str, Times]] = []
    for ref in refs:
        loads += [elapsed(partial(load_scenario, ref)) for _ in range(REPEATS)]
        scenario = load_scenario(ref)
        scenarios.append({k: drive(scenario, p, predictor, arm) for k, (p, arm) in drives.items()})
    pooled = {name: pool([times[name] for times in scenarios]) for name in drives}
    figures = {
        "planner": planner.name,
        "predictor": predictor.name,
        "scenarios": [ref.id for ref in refs],
        "engine": options.engine.value,
        "libraries": has_libraries(),
        "times_ms": {k: {part: spread(v[part]) for part in PARTS} for k, v in pooled.items()},
        "ratios": find_ratios(scenarios),
        "road_users": measure_road_users(planner, predictor),
        "horizon_s": measure_horizons(options.planner),
        "lanelets": measure_maps(planner, predictor, load_scenario(refs[0])),
        "engines": measure_engines(shipped_weights(), DosSettings().sets_file),
        "compiled": measure_compiled(),
        "startup_ms": {**measure_startup(), "load_scenario": spread(loads)},
        "environment": asdict(describe_environment()),
    }
    show(figures)
    if options.json is not None:
        write_json(options.json, figures)


def has_libraries() -> bool:
    """Whether the cache holds the compiled problems of `mpc`, which are taken then."""
    return all(
        is_whole(problem.formulation.library())
        for problem in problems(MpcConfig(), VEHICLE, STEP_SECONDS)
    )


def drive(scenario: Scenario, planner: Planner, predictor: Predictor, arm: Arm) -> Times:
    """Drives and scores one episode."""
    started, cpu_started = time.perf_counter(), time.process_time()
    episode = run_episode(scenario, planner, predictor, arm)
    wall, cpu = time.perf_counter() - started, time.process_time() - cpu_started
    if episode.end is EpisodeEnd.PLANNER_FAILURE:
        raise SystemExit(f"bench: {scenario.id}, {arm}: {episode.error}")
    solver = np.array([plan.report.seconds for plan in episode.plans])
    cycle = episode.predict_seconds + episode.plan_seconds
    seconds = {
        "predict": episode.predict_seconds,
        "solver": solver,
        "plan_rest": episode.plan_seconds - solver,
        "cycle": cycle,
        "plan": episode.plan_seconds,
        "cpu": np.array([cpu / len(cycle)]),
        "episode": np.array([wall]),
        "episode_rest": np.array([wall - cycle.sum()]),
    }
    times = {part: 1e3 * values for part, values in seconds.items()}
    times["score"] = np.array([elapsed(partial(score, scenario, episode))])
    return times


def find_ratios(scenarios: Sequence[dict[str, Times]]) -> dict[str, Figures]:
    """Ratios within each scenario: their median, lowest and highest."""
    pairs = {
        "with_dos / without_dos": ("with_dos", "without_dos"),
        "with_dos / idm": ("with_dos", "idm"),
        "again / with_dos": ("again", "with_dos"),
    }
    found = {
        f"{part}: {name}": [np.median(s[a][part]) / np.median(s[b][part]) for s in scenarios]
        for part in ("cycle", "cpu")
        for name, (a, b) in pairs.items()
    }
    found |= {
        f"solver / cycle: {a}": [s[a]["solver"].sum() / s[a]["cycle"].sum() for s in scenarios]
        for a in ("with_dos", "without_dos")
    }
    names = ("median", "lowest", "highest")
    return {
        ratio: dict(zip(names, np.percentile(values, (50, 0, 100)).tolist(), strict=True))
        for ratio, values in found.items()
    }


def measure_road_users(planner: Planner, predictor: Predictor) -> dict[str, Figures]:
    """Times with more and more road users."""
    return measure_growth({n: (steady_flow(n), planner, predictor) for n in ROAD_USERS})


def measure_horizons(planner: str) -> dict[str, Figures]:
    """Times of a planner that looks further and further ahead; nothing of one that cannot.

    The sets are circles around constant velocity: the trained ones end at 4 s.
    """
    steps = {seconds: round(seconds / STEP_SECONDS) for seconds in HORIZONS}
    try:
        planners = {s: create_planner(planner, 0, {"horizon": n}) for s, n in steps.items()}
    except RegistryError:
        return {}
    sets = {
        s: create_predictor("growing-circle", 0, {"horizon": n, "base.horizon": n})
        for s, n in steps.items()
    }
    scene = steady_flow(20)
    for driver, predictor in zip(planners.values(), sets.values(), strict=True):
        drive(scene, driver, predictor, Arm.WITH_DOS)  # Builds its problem.
    return measure_growth({s: (scene, planners[s], sets[s]) for s in HORIZONS})


def measure_maps(planner: Planner, predictor: Predictor, scenario: Scenario) -> dict[str, Figures]:
    """Times of a scenario whose map is larger and larger, by the number of its lanelets."""
    scenes = [replace(scenario, road_map=tiled(scenario.road_map, n)) for n in MAPS]
    return measure_growth({len(s.road_map.lanelets): (s, planner, predictor) for s in scenes})


def measure_growth(
    driven: Mapping[int, tuple[Scenario, Planner, Predictor]],
) -> dict[str, Figures]:
    """Medians, with DOS, the cycle's 95th percentile, and its median's ratio to the first."""
    rounds = [
        {n: drive(*parts, Arm.WITH_DOS) for n, parts in driven.items()} for _ in range(ROUNDS)
    ]
    pooled = {n: pool([drives[n] for drives in rounds]) for n in driven}
    found = {n: {k: float(np.median(pooled[n][k])) for k in CYCLE_PARTS} for n in driven}
    first = next(iter(found.values()))["cycle"]
    return {
        str(n): row
        | {
            "cycle_p95": float(np.percentile(pooled[n]["cycle"], 95)),
            "cycle_ratio": row["cycle"] / first,
        }
        for n, row in found.items()
    }


def measure_engines(network: Path, sets: Path) -> dict[str, dict[str, Figures]]:
    """Medians of the parts of a prediction, and the ratio of onnxruntime to torch, on one thread.

    ``network`` is what an encoding takes beyond the features, ``sets`` what a prediction takes
    beyond the encoding. All are processor time, ms. Nothing without onnxruntime.
    """
    if find_spec("onnxruntime") is None:
        return {}
    with TemporaryDirectory() as scratch:
        network, sets = Path(copy(network, scratch)), Path(copy(sets, scratch))
        for model, weights in ((MAP, network), (SCENE, network), (SETS, sets)):
            export(model, weights, Path(scratch))
        engines = {
            e: DosPredictor(settings=DosSettings(network=network, sets=str(sets), engine=e))
            for e in Engine
        }
    found: dict[str, dict[str, Figures]] = {}
    for n in PREDICTED:
        scenario = steady_flow(n)
        pieces = cut_map(scenario.road_map)
        times: dict[Engine, list[tuple[float, ...]]] = {engine: [] for engine in Engine}
        for _ in range(PREDICTIONS):
            for engine, predictor in engines.items():
                # An encoder remembers its last observation, hence one of its own for each.
                seen = [World(scenario, history=HISTORY).observation() for _ in range(2)]
                features = cpu_time(partial(describe, seen[0], pieces))
                encoded = cpu_time(partial(predictor.encoder.encode, seen[0]))
                total = cpu_time(partial(predictor.predict, seen[1]))
                times[engine].append((features, encoded - features, total - encoded, total))
        torch, onnx = (np.median(times[e], axis=0).tolist() for e in (Engine.TORCH, Engine.ONNX))
        found[str(n)] = {
            part: {"torch": a, "onnx": b, "ratio": b / a}
            for part, a, b in zip(PREDICTION_PARTS, torch, onnx, strict=True)
        }
    return found


def measure_compiled() -> Figures:
    """Medians of a solve, processor time in ms, and the ratio of machine code to virtual machine.

    Of one second and two road users, whose library is made in seconds. Nothing without a compiler.
    """
    config = replace(MpcConfig(), horizon=10, slots=2)
    with TemporaryDirectory() as scratch, patch.dict(os.environ, DOSPLAN_CACHE=scratch):
        interpreted = MpcProblem(config, VEHICLE, STEP_SECONDS)
        try:
            interpreted.formulation.compile(interpreted.formulation.library())
        except CompileError:
            return {}
        compiled = MpcProblem(config, VEHICLE, STEP_SECONDS)
    n = config.horizon
    states = np.zeros((n + 1, STATE_SIZE))
    states[:, EGO_X] = np.arange(n + 1)
    states[:, EGO_VELOCITY] = 10.0
    sets = ForbiddenSets(
        ids=np.array([1]),
        centre=np.tile([12.0, -0.5], (1, n, 1)),
        matrix=np.tile(np.diag([0.3, 0.5]), (1, n, 1, 1)),
        penalty=np.full((1, n), 1000.0),
    )
    stages = straight_stages(states[:, EGO_X], config.slots, sets, right=2.0)
    guess = Guess(states, np.zeros((n, 2)), np.zeros(n), states[:, EGO_X])
    solve = [
        partial(problem.solve, states[0], stages, guess, np.zeros((n, config.slots)))
        for problem in (interpreted, compiled)
    ]
    times = [[cpu_time(action) for action in solve] for _ in range(SOLVES)]
    slow, quick = np.median(times, axis=0).tolist()
    return {"virtual_machine": slow, "compiled": quick, "ratio": quick / slow}


def measure_startup() -> dict[str, Figures]:
    """Times of what is paid before the first cycle, ms."""
    actions: dict[str, Callable[[], object]] = {
        "python": partial(_start, "-c", "pass"),
        "dosplan_help": partial(_start, "-m", "dosplan", "--help"),
        "build_mpc": partial(MpcProblem, MpcConfig(), VEHICLE, STEP_SECONDS),
    }
    times = [{name: elapsed(action) for name, action in actions.items()} for _ in range(REPEATS)]
    return {name: spread([found[name] for found in times]) for name in actions}


def _start(*arguments: str) -> None:
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)


def elapsed(action: Callable[[], object]) -> float:
    """Times an action, ms."""
    started = time.perf_counter()
    action()
    return 1e3 * (time.perf_counter() - started)


def cpu_time(action: Callable[[], object]) -> float:
    """Processor time of an action, ms."""
    started = time.process_time()
    action()
    return 1e3 * (time.process_time() - started)


def pool(drives: Sequence[Times]) -> Times:
    """Puts the times of several drives together."""
    return {part: np.concatenate([times[part] for times in drives]) for part in PARTS}


def spread(values: Sequence[float] | FloatArray) -> Figures:
    """Number and percentiles of times."""
    found = np.percentile(values, PERCENTILES).tolist()
    return {"n": len(values)} | {f"p{p}": v for p, v in zip(PERCENTILES, found, strict=True)}


def show(figures: dict[str, Any]) -> None:
    """Prints the tables."""
    percentiles = [f"p{p}" for p in PERCENTILES]
    drives = ("with_dos", "without_dos", "idm")
    columns = [key.replace("_", "\n") for key in figures["road_users"][str(ROAD_USERS[0])]]

    def triple(found: Figures) -> str:
        return " ".join(f"{_number(found[p]):>5}" for p in percentiles)

    def rows(found: dict[str, Figures]) -> list[list[str]]:
        return [[name, *map(_number, row.values())] for name, row in found.items()]

    engines = {f"{n} {k}": v for n, parts in figures["engines"].items() for k, v in parts.items()}
    engine_table = (
        table(["prediction\nroad users, part", "torch", "onnx", "ratio"], rows(engines))
        if engines
        else 'torch and onnxruntime are not compared: pip install "dosplan[onnx]"'
    )
    compiled = figures["compiled"]
    compiled_table = (
        table(["solve, ms", *map(str, compiled)], rows({"10 steps, 2 road users": compiled}))
        if compiled
        else "compiled problems are not measured: there is no C compiler"
    )
    solved = "compiled" if figures["libraries"] else "in the virtual machine"
    under = " ".join(f"{p:>5}" for p in percentiles)
    times = [[part, *(triple(figures["times_ms"][d][part]) for d in drives)] for part in PARTS]
    for built in (
        f"{figures['planner']} with {figures['predictor']}, {len(figures['scenarios'])} scenarios",
        f"networks by {figures['engine']}, problems of mpc {solved}",
        table(["ms", *(f"{name}\n{under}" for name in drives)], times),
        table(["ratio within a scenario", "median", "lowest", "highest"], rows(figures["ratios"])),
        table(["road\nusers", *columns], rows(figures["road_users"])),
        table(["horizon, s", *columns], rows(figures["horizon_s"])),
        table(["lanelets", *columns], rows(figures["lanelets"])),
        engine_table,
        compiled_table,
        table(["before the first cycle, ms", "n", *percentiles], rows(figures["startup_ms"])),
    ):
        Console().print(built, highlight=False, markup=False)


def _number(value: float) -> str:  # Three significant figures are enough for a time.
    if isinstance(value, int) or value >= 100.0:
        return f"{value:.0f}"
    return f"{value:.2f}" if value < 10.0 else f"{value:.1f}"


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Measures times of dosplan and their ratios.")
    parser.add_argument("--scenarios", type=int, default=4, metavar="N", help="of suite-1")
    parser.add_argument("--planner", default="mpc", help="as for `dosplan run`")
    parser.add_argument("--predictor", default="growing-circle", help="as for `dosplan run`")
    parser.add_argument(
        "--engine",
        type=Engine,
        choices=[*Engine],
        default=Engine.TORCH,
        help="of the trained networks; onnx needs `dosplan export` first",
    )
    parser.add_argument("--json", type=Path, metavar="PATH", help="write the same figures there")
    options = parser.parse_args()
    if options.scenarios < 1:
        parser.error("--scenarios must be 1 or more")
    return options


if __name__ == "__main__":
    main()
