"""Builds the scenario suites: ``python scenarios/suite.py --seed 1``.

The same seed gives the same bytes, whatever the folder, the number of processes and the hash
seed. Needs the extra ``dosplan[suite]`` (SUMO).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

SUMO_VERSION = "1.28.0"
PACKAGES = ("eclipse-sumo", "sumolib", "libsumo")
HERE = Path(__file__).resolve().parent
FOLDERS = {"suite": HERE / "suite", "suite-1": HERE / "suite-1"}
PUBLISHED = {"split": "suite", "seed": 1, "count": 150, "kinds": None}
"""What the suites in ``FOLDERS`` are made with."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command.

    Args:
        arguments: Command line; that of the process if None.

    Returns:
        Exit status.
    """
    parser = argparse.ArgumentParser(description="Build a scenario suite.")
    parser.add_argument(
        "--suite",
        choices=tuple(FOLDERS),
        default="suite",
        help="suite: several futures of each past; suite-1: the first suite (default: suite)",
    )
    parser.add_argument("--seed", type=int, help="seed of the suite (default: 1)")
    parser.add_argument("--count", type=int, help="number of scenarios (default: 150)")
    parser.add_argument(
        "--out",
        type=Path,
        help="folder for what is made (default: the published suite's, for that suite alone)",
    )
    parser.add_argument(
        "--split",
        choices=("suite", "train"),
        help="the suite itself, or other roads and traffic of the same families for training",
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: 1)")
    parser.add_argument(
        "--kinds", help="codes of the kinds to make, with commas between; suite only (default: all)"
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on with what was begun in the folder with the same split and seed; suite only",
    )
    parser.set_defaults(**PUBLISHED)
    options = parser.parse_args(arguments)
    if options.out is None and PUBLISHED.items() - vars(options).items():
        parser.exit(
            2,
            f"suite.py: {FOLDERS[options.suite]} holds the published suite, which is made without "
            "--split, --seed, --count and --kinds; name another folder with --out\n",
        )
    for package in PACKAGES:
        try:
            found = version(package)
        except PackageNotFoundError:
            found = "none"
        if found != SUMO_VERSION:
            parser.exit(
                2,
                f"suite.py: the suites are made with {package} {SUMO_VERSION}, found {found}; "
                f"pip install {' '.join(f'{name}=={SUMO_VERSION}' for name in PACKAGES)}\n",
            )
    out = options.out or FOLDERS[options.suite]
    if options.suite == "suite-1":
        if options.kinds or options.resume:
            parser.exit(2, "suite.py: suite-1 has neither --kinds nor --resume; leave them out\n")
        from suitegen.suite import build_suite as build_first

        build_first(options.seed, options.count, out, options.split, options.jobs)
        return 0
    from suitegen.futures.kinds import KINDS
    from suitegen.futures.suite import build_suite

    kinds = options.kinds.split(",") if options.kinds else list(KINDS)
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        parser.exit(2, f"suite.py: no kind {unknown[0]}; there are {', '.join(KINDS)}\n")
    whole = build_suite(
        options.seed, options.count, out, options.split, kinds, options.jobs, options.resume
    )
    return 0 if whole else 1


if __name__ == "__main__":
    sys.exit(main())
