"""Whether what was driven is feasible for commonroad-drivability-checker, drive by drive.

    dosplan run SOURCE --out RUN --solutions
    python results/planning/feasible.py RUN...

Reads the solutions of runs, `RUN/solutions/*.xml`, and asks the checker's `trajectory_feasibility`
for the kinematic single track KS and the car BMW 320i whether inputs within the car's limits lead
from each state to the next. Needs the extra `oracle`.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

from commonroad.common.solution import CommonRoadSolutionReader
from commonroad_dc.feasibility.feasibility_checker import trajectory_feasibility
from commonroad_dc.feasibility.vehicle_dynamics import VehicleDynamics

from dosplan.types import STEP_SECONDS


def feasible(solution: Path) -> bool:
    """Whether the trajectory of every planning problem of a solution is feasible."""
    return all(
        trajectory_feasibility(
            part.trajectory,
            VehicleDynamics.from_model(part.vehicle_model, part.vehicle_type),
            STEP_SECONDS,
        )[0]
        for part in CommonRoadSolutionReader.open(str(solution)).planning_problem_solutions
    )


def main() -> None:
    """Prints a line for each run, and the drives that are not feasible."""
    warnings.simplefilter("ignore")  # commonroad-io's protobuf
    for run in map(Path, sys.argv[1:]):
        solutions = sorted(run.glob("solutions/*.xml"))
        failed = [file for file in solutions if not feasible(file)]
        for file in failed:
            print(f"not feasible: {file.stem}")
        print(f"{run.name}: {len(solutions) - len(failed)} of {len(solutions)} drives are feasible")


if __name__ == "__main__":
    main()
