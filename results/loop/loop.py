"""What occupancy sets are worth where the loop is slow, late or noisy, and who else is on the road.

    python results/loop/loop.py drive --out RUNS --data DATA/commonroad

`drive` makes a run folder of both arms for each cell: a traffic and a loop that differs from the
ideal one in one thing. The same command goes on where it was stopped, and one with larger samples
adds to what is there. Cells come in the order of what they tell, so that a part of them is of use.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

from dosplan.plugins.loops import choose_loop
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import read_manifest
from dosplan.running.config import RunConfig
from dosplan.running.progress import ProgressObserver
from dosplan.running.run import run
from dosplan.simulation.settings import REALISTIC, LoopSettings
from dosplan.system.errors import DosplanError

TRAFFICS: Final = ("replay", "reactive", "sumo")
SUITE: Final = "suite"
RECORDED: Final = "recorded"
ERRORS: Final = ("position", "speed", "heading", "size")


@dataclass(frozen=True)
class LoopCell:
    """A loop of the figure.

    Attributes:
        name: Name of its folders.
        options: What is changed of the ideal loop; of the realistic one where it is named so.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def base(self) -> str:
        """The loop that the options change."""
        return "realistic" if self.name == "realistic" else "ideal"

    @property
    def loop(self) -> LoopSettings:
        """The settings."""
        return choose_loop(self.base, self.options)


def _noise(share: float) -> dict[str, Any]:
    """The errors of the realistic sensors, times a factor; without drop-outs or hidden places."""
    errors = {name: share * getattr(REALISTIC.sensing, name) for name in ERRORS}
    return {
        f"sensing.{name}": value
        for name, value in (errors | {"correlation": REALISTIC.sensing.correlation}).items()
    }


FIRST: Final = (
    LoopCell("ideal"),
    LoopCell("latency-0.3", {"latency": 0.3}),
    LoopCell("period-0.5", {"period": 0.5}),
    LoopCell("realistic"),
)
"""The loops that tell most."""
THEN: Final = (
    LoopCell("noise-1", _noise(1.0)),
    LoopCell("latency-0.5", {"latency": 0.5}),
    LoopCell("period-1.0", {"period": 1.0}),
    LoopCell("noise-2", _noise(2.0)),
    LoopCell("latency-0.1", {"latency": 0.1}),
    LoopCell("period-0.2", {"period": 0.2}),
)
LOOPS: Final = (*FIRST, *THEN)


@dataclass(frozen=True)
class Cell:
    """A traffic and a loop.

    Attributes:
        traffic: Name of the traffic.
        loop: The loop.
    """

    traffic: str
    loop: LoopCell

    @property
    def sources(self) -> tuple[str, ...]:
        """Where its scenarios are from: SUMO needs a place's net, which recordings lack."""
        return (SUITE,) if self.traffic == "sumo" else (SUITE, RECORDED)

    def folder(self, runs: Path, source: str) -> Path:
        """The run folder of a source's scenarios."""
        return runs / self.traffic / self.loop.name / source


def cells(traffics: Sequence[str] = TRAFFICS) -> Iterator[Cell]:
    """All cells, those that tell most first: replay, then the loops of ``FIRST`` elsewhere."""
    yield from (Cell("replay", loop) for loop in LOOPS if "replay" in traffics)
    others = [traffic for traffic in traffics if traffic != "replay"]
    for loops in (FIRST, THEN):
        yield from (Cell(traffic, loop) for traffic in others for loop in loops)


def drive(
    runs: Path, data: Path | None, counts: Mapping[str, int], traffics: Sequence[str], workers: int
) -> None:
    """Drives all cells, or what is missing of them.

    Args:
        runs: Where the run folders go.
        data: Folder with the recordings: ``train`` and ``val``.
        counts: How many scenarios are drawn of each source; of 0, it is left out. A folder that
            holds more keeps them.
        traffics: Which traffics.
        workers: Number of worker processes.
    """
    started = time.monotonic()
    for cell in cells(traffics):
        for source in cell.sources:
            if counts[source]:
                place = cell.folder(runs, source)
                config = RunConfig(
                    out=place,
                    source=SUITE if source == SUITE else _recordings(data),
                    traffic=cell.traffic,
                    loop=cell.loop.base,
                    loop_options=cell.loop.options,
                    sample=max(counts[source], _sample(place)),
                    workers=workers,
                    cache=True,
                )
                title = f"{cell.traffic} {cell.loop.name} {source}"
                run(config, ProgressObserver(partial(_show, title, started)))
                print(file=sys.stderr)


def _recordings(data: Path | None) -> tuple[str, ...]:
    if data is None:
        raise SystemExit("loop.py: --data names the folder with train/ and val/, or --recorded 0")
    return tuple(str(data / part) for part in ("train", "val"))


def _sample(place: Path) -> int:
    """How many scenarios a folder was last asked for."""
    folder = RunFolder(place)
    if not folder.manifest.exists():
        return 0
    return read_manifest(folder).config.sample or 0


def _show(title: str, started: float, done: int, total: int) -> None:
    minutes = (time.monotonic() - started) / 60.0
    text = f"\r{minutes:5.1f} min  {title}: {done} of {total} episodes "
    print(text, end="", file=sys.stderr, flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command.

    Args:
        arguments: Of the command line; those of the process by default.

    Returns:
        The exit code.
    """
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    part = commands.add_parser("drive", help="drive the cells, or what is missing of them")
    part.add_argument("--out", type=Path, required=True, help="where the run folders go")
    part.add_argument("--data", type=Path, help="folder with the recordings' train/ and val/")
    part.add_argument("--suite", type=int, default=60, help="scenarios of the suite (60)")
    part.add_argument("--recorded", type=int, default=60, help="recorded scenarios (60)")
    part.add_argument("--traffic", nargs="+", choices=TRAFFICS, default=TRAFFICS)
    part.add_argument("--workers", type=int, default=2)
    options = parser.parse_args(arguments)
    try:
        counts = {SUITE: options.suite, RECORDED: options.recorded}
        drive(options.out, options.data, counts, options.traffic, options.workers)
    except DosplanError as error:
        print(f"loop.py: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nloop.py: stopped; the same command goes on from here", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
