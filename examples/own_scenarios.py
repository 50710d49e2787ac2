"""Your own scenarios: choose some of a folder, list them, drive the list, take the solutions.

usage: python own_scenarios.py [SOURCE], where SOURCE is what `dosplan run` takes
"""

import itertools
import sys
from pathlib import Path

import dosplan


def busy(ref: dosplan.ScenarioRef, users: int = 5) -> bool:
    """Whether a scenario has that many road users that move."""
    tracks = dosplan.load_scenario(ref, cached=True).tracks
    return sum(kind.moves for kind in tracks.kinds) >= users


if __name__ == "__main__":
    source = sys.argv[1] if len(sys.argv) > 1 else "suite-1"
    found = dosplan.find_scenarios(source)
    chosen = list(itertools.islice(filter(busy, found), 2))
    Path("busy.txt").write_text("\n".join(str(ref.path.absolute()) for ref in chosen))
    results = dosplan.run_suite(
        "@busy.txt", "idm", "growing-circle", out="runs/busy", solutions=True
    )
    for row in results.rows:
        print(row.scenario, row.arm, row.outcome)
    for path in sorted((results.path / "solutions").iterdir()):
        print(path)
