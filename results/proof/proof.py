"""The arithmetic of the protocol: its power, and what became of its hypotheses.

    python results/proof/proof.py power PILOT
    python results/proof/proof.py judge RUNS

PILOT is the folder of a run of both arms over pilot scenarios; `power` writes ``power.json`` and
prints a table. RUNS is the folder of `dosplan sweep results/proof/worlds.yaml`; `judge` writes
``proof.json`` and ``proof.md``, every cell that is driven whole, whatever it shows.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np

from dosplan.results.comparison import compare_rows
from dosplan.results.markdown import markdown
from dosplan.results.paired import Difference, sign_flip_p
from dosplan.results.rows import read_run
from dosplan.results.sweeps import SweepFolder
from dosplan.system.files import FileError, write_json, write_text
from dosplan.types import Arm, FloatArray, Outcome, Score

HERE: Final = Path(__file__).parent
PRIMARY: Final = (("fresh", "replay", "late"), ("fresh", "replay", "realistic"))
"""Scenarios, traffic and loop of the two hypotheses; all other cells are reported beside them."""
LEVEL: Final = 0.05
HALVED: Final = 0.5
SUCCESS_MARGIN: Final = 0.02
VELOCITY_MARGIN: Final = 0.03  # Share of the velocity without sets.
DRAWS: Final = 4000
SEED: Final = 20261127


@dataclass(frozen=True)
class Cell:
    """One world over one set of scenarios.

    Attributes:
        scenarios: ``fresh`` or ``bench``.
        traffic: Who else is on the road.
        loop: ``late`` or ``realistic``.
        n: Pairs of episodes.
        places: What is taken as independent: places of recordings, scenarios of the generator.
        without: Collisions without the sets.
        with_sets: Collisions with them.
        ratio: Collisions with the sets over those without; None where there are none without.
        ratio_low: Lower end of its 95 % interval, of scenarios drawn anew.
        ratio_high: Upper end.
        collision: Difference of the shares of collisions, with minus without.
        at_fault: The same of those that the ego is to blame for.
        out_of_bounds: The same of drives off the road.
        success: The same of successes.
        velocity: Difference of the mean velocities, m/s.
        p: Of the collisions, by scenarios.
        p_holm: The same after Holm's correction over the primary cells; None elsewhere, where
            nothing is decided.
    """

    scenarios: str
    traffic: str
    loop: str
    n: int
    places: int
    without: int
    with_sets: int
    ratio: float | None
    ratio_low: float | None
    ratio_high: float | None
    collision: Difference
    at_fault: Difference
    out_of_bounds: Difference
    success: Difference
    velocity: Difference
    p: float
    p_holm: float | None = None

    @property
    def key(self) -> tuple[str, str, str]:
        """Scenarios, traffic and loop."""
        return self.scenarios, self.traffic, self.loop

    @property
    def is_safer(self) -> bool:
        """Hypothesis 1: significantly fewer collisions, and half of them at most."""
        found = 1.0 if self.p_holm is None else self.p_holm
        return found < LEVEL and self.ratio is not None and self.ratio <= HALVED

    @property
    def keeps_success(self) -> bool:
        """Hypothesis 2: success is lower by less than the margin."""
        return self.success.low is not None and self.success.low > -SUCCESS_MARGIN

    @property
    def keeps_velocity(self) -> bool:
        """Hypothesis 3: velocity is lower by less than the margin."""
        low = self.velocity.low
        return low is not None and low > -VELOCITY_MARGIN * self.velocity.a


def arm_rows(rows: Sequence[Score], arm: Arm) -> list[Score]:
    """The rows of an arm."""
    return [row for row in rows if row.arm is arm]


def collisions_by_scenario(rows: Sequence[Score]) -> FloatArray:
    """Collisions of each scenario, over its futures.

    Args:
        rows: Rows of both arms.

    Returns:
        (S, 2) without and with the sets, of the scenarios whose pairs are all of the planner.
    """
    counts: dict[str, list[float]] = {}
    odd = {row.scenario_future for row in rows if not row.outcome.of_planner}
    for row in rows:
        if row.scenario_future not in odd:
            pair = counts.setdefault(row.scenario, [0.0, 0.0])
            pair[row.arm is Arm.WITH_DOS] += row.outcome is Outcome.COLLISION
    return np.array(list(counts.values()))


def ratio_interval(counts: FloatArray) -> tuple[float | None, float | None]:
    """95 % interval of the ratio of collisions, by scenarios drawn with replacement.

    Args:
        counts: (S, 2) collisions without and with the sets.

    Returns:
        Percentiles; an end is None where a draw at it holds no collision without sets.
    """
    rng = np.random.default_rng(SEED)
    sums = counts[rng.integers(0, len(counts), (DRAWS, len(counts)))].sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.sort(np.where(sums[:, 0] > 0.0, sums[:, 1] / sums[:, 0], np.inf))
    low, high = float(ratios[int(0.025 * DRAWS)]), float(ratios[-int(0.025 * DRAWS) - 1])
    return low if np.isfinite(low) else None, high if np.isfinite(high) else None


def judge_cell(scenarios: str, traffic: str, loop: str, rows: Sequence[Score]) -> Cell:
    """Compares the arms of a cell.

    Args:
        scenarios: ``fresh`` or ``bench``.
        traffic: Who else is on the road.
        loop: ``late`` or ``realistic``.
        rows: Rows of both arms.

    Returns:
        The cell.
    """
    found = compare_rows(arm_rows(rows, Arm.WITHOUT_DOS), arm_rows(rows, Arm.WITH_DOS))
    counts = collisions_by_scenario(rows)
    without, with_sets = (int(total) for total in counts.sum(axis=0))
    low, high = ratio_interval(counts)
    return Cell(
        scenarios,
        traffic,
        loop,
        n=found.n,
        places=found.places,
        without=without,
        with_sets=with_sets,
        ratio=with_sets / without if without else None,
        ratio_low=low,
        ratio_high=high,
        collision=found.differences["collision"],
        at_fault=found.differences["at_fault_collision"],
        out_of_bounds=found.differences["out_of_bounds"],
        success=found.differences["success"],
        velocity=found.differences["velocity"],
        p=sign_flip_p(counts[:, 1] - counts[:, 0]),
    )


def holm(p: Sequence[float]) -> list[float]:
    """Values of p that hold for several tests together (Holm, 1979)."""
    corrected, least = [0.0] * len(p), 0.0
    for rank, index in enumerate(np.argsort(p)):
        least = max(least, min(1.0, (len(p) - rank) * p[index]))
        corrected[index] = least
    return corrected


def power(counts: FloatArray, scenarios: int) -> dict[str, float]:
    """How likely the test is to find what the pilot saw, and a halving of what it saw.

    Scenarios of the pilot are drawn with replacement, with all their futures: what the futures of a
    scenario have in common is kept. For the halving each collision without sets is prevented with
    a probability of a half, and no other comes about.

    Args:
        counts: (S, 2) collisions of the pilot's scenarios without and with the sets.
        scenarios: Number of scenarios of the experiment.

    Returns:
        Shares of draws with p below the level of each of two tests, by what is assumed.
    """
    rng = np.random.default_rng(SEED)
    found = {"as the pilot": 0, "halved": 0}
    draws = DRAWS // 8
    for _ in range(draws):
        drawn = counts[rng.integers(0, len(counts), scenarios)].astype(np.int64)
        halved = rng.binomial(drawn[:, 0], 0.5) - drawn[:, 0]
        for name, sums in (("as the pilot", drawn[:, 1] - drawn[:, 0]), ("halved", halved)):
            total = float(sums.sum())
            found[name] += total < 0.0 and sign_flip_p(sums.astype(np.float64)) < 0.5 * LEVEL
    return {name: count / draws for name, count in found.items()}


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=("power", "judge"))
    parser.add_argument("runs", type=Path)
    options = parser.parse_args()
    if options.what == "power":
        write_power(options.runs)
    else:
        write_judgement(options.runs)


def write_power(pilot: Path) -> None:
    """Writes ``power.json`` and prints its table."""
    _, rows = read_run(pilot)
    counts = collisions_by_scenario(rows)
    futures = len({row.future for row in rows})
    found = {str(n): power(counts, n) for n in (50, 100, 150, 200, 300)}
    seen = {
        "scenarios": len(counts),
        "futures": futures,
        "collisions_without": int(counts[:, 0].sum()),
        "collisions_with": int(counts[:, 1].sum()),
    }
    write_json(HERE / "power.json", {"pilot": seen, "power": found})
    print(
        markdown(
            ["Scenarios", "as the pilot", "halved"],
            [
                [n, *(f"{100.0 * share:.0f} %" for share in shares.values())]
                for n, shares in found.items()
            ],
        )
    )


def write_judgement(runs: Path) -> None:
    """Writes ``proof.json`` and ``proof.md``."""
    folder = SweepFolder(runs)
    cells = []
    for one in folder.read():
        try:
            _, rows = read_run(folder.run(one))
        except FileError as error:
            print(f"left out: {error}")
            continue
        values = one.values
        cells.append(judge_cell(values["scenarios"], values["traffic"], values["loop"], rows))
    found = {cell.key: cell.p for cell in cells}
    # A primary cell that is not driven counts as one that shows nothing.
    corrected = dict(zip(PRIMARY, holm([found.get(key, 1.0) for key in PRIMARY]), strict=True))
    judged = [Cell(**(vars(cell) | {"p_holm": corrected.get(cell.key)})) for cell in cells]
    write_json(HERE / "proof.json", {"cells": [asdict(cell) for cell in judged]})
    write_text(HERE / "proof.md", table(judged) + "\n")
    print(table(judged))


def table(cells: Sequence[Cell]) -> str:
    """The figures of all cells, without and with the sets, and whether the hypotheses hold."""
    return markdown(
        [
            *("Scenarios, traffic, loop", "Pairs", "Collisions", "Ratio", "p", "At fault, %"),
            *("Off the road, %", "Success, % (points)", "Velocity, m/s (%)", "1", "2", "3"),
        ],
        [
            [
                ", ".join(cell.key),
                str(cell.n),
                f"{cell.without} → {cell.with_sets}",
                _ratio(cell),
                f"{cell.p if cell.p_holm is None else cell.p_holm:.2g}",
                _shares(cell.at_fault),
                _shares(cell.out_of_bounds),
                f"{_shares(cell.success)} {_ends(cell.success, 100.0)}",
                f"{cell.velocity.a:.2f} → {cell.velocity.b:.2f} "
                f"{_ends(cell.velocity, 100.0 / cell.velocity.a)}",
                *(
                    "" if cell.p_holm is None else "yes" if holds else "no"
                    for holds in (cell.is_safer, cell.keeps_success, cell.keeps_velocity)
                ),
            ]
            for cell in cells
        ],
    )


def _ratio(cell: Cell) -> str:
    if cell.ratio is None:
        return "-"
    ends = ("-" if end is None else f"{end:.2f}" for end in (cell.ratio_low, cell.ratio_high))
    return f"{cell.ratio:.2f} ({' to '.join(ends)})"


def _shares(difference: Difference) -> str:
    return f"{100.0 * difference.a:.1f} → {100.0 * difference.b:.1f}"


def _ends(difference: Difference, scale: float) -> str:
    """The interval of the difference."""
    if difference.low is None or difference.high is None:
        return "(-)"
    return f"({scale * difference.low:+.1f} to {scale * difference.high:+.1f})"


if __name__ == "__main__":
    main()
