"""``dosplan convert``: recorded traffic of other data sets as CommonRoad files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Final

from dosplan.cli.arguments import add_json, console, show
from dosplan.cli.command import FAILED, OK, Command, CommandError

_EXAMPLES: Final = """\
examples:
  dosplan convert sind Data/Tianjin/8_2_1 --out sind
  dosplan convert commonroad highD-commonroad --out highD
  dosplan evaluate highD/recordings --predictor constant-velocity
  dosplan run highD/scenarios

docs/data-sets.md leads from other data sets to CommonRoad's format.
"""
_SIND: Final = "sind"
_COMMONROAD: Final = "commonroad"
_SHOWN: Final = 5
"""Files that cannot be used and are shown one by one."""


class ConvertCommand:
    """Makes CommonRoad files of recorded traffic."""

    summary = "make scenarios of recorded traffic: SinD, or recordings in CommonRoad's format"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _EXAMPLES
        add_json(parser)
        parser.add_argument(
            "format", choices=(_SIND, _COMMONROAD), help="format in which the traffic is recorded"
        )
        parser.add_argument(
            "record",
            metavar="RECORD",
            help="sind: folder of the record; commonroad: a file, a folder or an archive of files, "
            "whose planning problems, if they have any, are left aside",
        )
        parser.add_argument(
            "--out",
            type=Path,
            required=True,
            metavar="DIR",
            help="folder for recordings/ (all of the record, for predictors) and scenarios/ "
            "(an episode for each car that makes one, for planners)",
        )
        parser.add_argument(
            "--map",
            type=Path,
            metavar="FILE",
            help="sind: Lanelet2 map (default: the one .osm file in RECORD or beside it)",
        )
        parser.add_argument(
            "--step",
            type=float,
            metavar="SECONDS",
            help="commonroad: length of a step, where the files give a wrong one; velocities then "
            "follow from the positions",
        )

    def run(self, options: argparse.Namespace) -> int:
        """Converts, and shows what was made.

        Returns:
            0, or 1 where some of the files cannot be used.

        Raises:
            CommandError: An option belongs to the other format.
            ScenarioError: The record or its map cannot be used.
            FileError: A file cannot be written.
        """
        return _sind(options) if options.format == _SIND else _commonroad(options)


def _sind(options: argparse.Namespace) -> int:
    from dosplan.convert.sind_files import convert_sind
    from dosplan.report.progress import show_progress

    if options.step is not None:
        raise CommandError("--step is for commonroad; a record of SinD has its times in its tables")
    with show_progress(console(stderr=True), "cars") as progress:
        figures = convert_sind(Path(options.record), options.out, options.map, progress)
    summary = (
        f"{figures['record']}: {_tracks(figures)} in {figures['seconds']:.0f} s on "
        f"{figures['lanelets']} lanelets with {figures['lights']} lights"
    )
    show([f"{summary}\n{_written(figures, options.out)}"], figures, options.json)
    return OK


def _commonroad(options: argparse.Namespace) -> int:
    from dosplan.convert.commonroad import convert_commonroad
    from dosplan.report.progress import show_progress

    if options.map is not None:
        raise CommandError("--map is for sind; CommonRoad files hold their map")
    with show_progress(console(stderr=True), "files") as progress:
        figures = convert_commonroad(options.record, options.out, options.step, progress)
    unreadable = figures["unreadable"]
    lines = [
        f"{figures['files'] - len(unreadable)} of {figures['files']} files: {_tracks(figures)} in "
        f"{figures['seconds']:.0f} s",
        _written(figures, options.out),
        *(f"cannot be used: {line}" for line in unreadable[:_SHOWN]),
    ]
    if len(unreadable) > _SHOWN:
        lines.append(f"and {len(unreadable) - _SHOWN} more; --json lists them")
    show(["\n".join(lines)], figures, options.json)
    return FAILED if unreadable else OK


def _tracks(figures: dict[str, Any]) -> str:
    return ", ".join(f"{number} {label}" for label, number in figures["tracks"].items())


def _written(figures: dict[str, Any], out: Path) -> str:
    refused = ", ".join(f"{number} {why}" for why, number in figures["refused"].items())
    return (
        f"wrote {figures['recordings']} to {out / 'recordings'}, "
        f"{figures['scenarios']} to {out / 'scenarios'}"
        + (f" (moments refused: {refused})" if refused else "")
    )


CONVERT: Final[Command] = ConvertCommand()
