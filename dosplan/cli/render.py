"""``dosplan render``: a film or a picture of a scenario or of an episode."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from dosplan.cli.arguments import PLUGIN_HELP, add_seed, is_source
from dosplan.cli.command import FAILED, OK, Command, CommandError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dosplan.report.film.drives import Take, Takes
    from dosplan.scenario import ScenarioRef

_ENDINGS: Final = (".gif", ".mp4", ".png")
_ARMS: Final = ("with_dos", "without_dos")
_EXAMPLES: Final = """\
examples:
  dosplan render runs/mine:ZAM_Weaving-2_1_T-1 --out weaving.gif       both arms, side by side
  dosplan render runs/mine:ZAM_Weaving-2_1_T-1 --arm with_dos --out weaving.mp4
  dosplan render runs/mine:ZAM_Weaving-2_1_T-1 --out weaving.png       the moment of the outcome
  dosplan render runs/mine:ZAM_Weaving-2_1_T-1 --out frames/f.png --frames
  dosplan render ZAM_Weaving-2_1_T-1 --out traffic.gif                 the recorded traffic alone
  dosplan render my/map.xml --out map.png                              no planning problem needed
  dosplan render my/scenario.xml --planner idm --out idm.gif           drives it first
"""


class RenderCommand:
    """Draws a scenario or an episode."""

    summary = "draw an episode or a scenario: a GIF, a video or a picture"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _EXAMPLES
        parser.add_argument(
            "what",
            metavar="RUN:ID|SCENARIO",
            help="a scenario of a run folder; or a scenario file, or the id of one in --source",
        )
        parser.add_argument(
            "--out",
            type=Path,
            required=True,
            metavar="FILE",
            help="what to write: .gif, .mp4 (needs the extra `video`) or .png",
        )
        parser.add_argument(
            "--arm", choices=_ARMS, help="draw this arm only (default: both, side by side)"
        )
        parser.add_argument(
            "--future",
            type=int,
            metavar="K",
            help="draw this future of an episode of a run that has several (default: 0)",
        )
        moments = parser.add_mutually_exclusive_group()
        moments.add_argument(
            "--time",
            type=float,
            metavar="S",
            help="moment of a .png, seconds after the start (default: that of the outcome)",
        )
        moments.add_argument(
            "--frames", action="store_true", help="a .png for every step: NAME-000.png, ..."
        )
        parser.add_argument(
            "--source",
            metavar="SOURCE",
            help="where the scenarios lie (default: where the run found them; else the suites)",
        )
        parser.add_argument(
            "--planner", help=f"drive SCENARIO with this planner first: {PLUGIN_HELP}"
        )
        parser.add_argument(
            "--predictor", help="and with this predictor (default: dos); needs --planner"
        )
        add_seed(parser)

    def run(self, options: argparse.Namespace) -> int:
        """Draws.

        Returns:
            0; 1 where a planner that was to drive first failed, which is drawn as far as it came
            and which stderr has a line on.

        Raises:
            CommandError: The arguments do not fit each other.
            FileError: There is no such episode, or a file cannot be written.
            RegistryError: A plug-in cannot be found.
            ScenarioError: The scenario cannot be found or read.
        """
        ending = options.out.suffix.lower()
        if ending not in _ENDINGS:
            raise CommandError(f"{options.out}: name a file that ends in {', '.join(_ENDINGS)}")
        if ending != ".png" and (options.frames or options.time is not None):
            raise CommandError(f"{options.out}: --time and --frames are for a .png")
        if options.seed < 0:
            raise CommandError(f"seed is {options.seed}; it must not be negative")
        takes, title = _takes(options)
        print(_write(takes, title, options))
        # A run reports its own failures.
        return _print_failures(takes) if options.planner else OK


def _write(takes: Sequence[Take], title: str, options: argparse.Namespace) -> str:
    """Writes the picture or the pictures, and says where they are."""
    from dosplan.report.film import files as pictures

    if options.frames:
        number = pictures.write_pictures(takes, title, options.out)
        return f"{number} pictures in {options.out.parent}"
    ending = options.out.suffix.lower()
    if ending == ".gif":
        pictures.write_gif(takes, title, options.out)
    elif ending == ".mp4":
        pictures.write_video(takes, title, options.out)
    else:
        pictures.write_picture(takes, title, options.out, options.time)
    return f"picture in {options.out}"


def _print_failures(takes: Sequence[Take]) -> int:
    """Prints why planners failed."""
    from dosplan.report.tables import error_lines

    lines = error_lines(take.row for take in takes if take.row is not None)
    for line in lines:
        print(line, file=sys.stderr)
    return FAILED if lines else OK


def _takes(options: argparse.Namespace) -> Takes:
    from dosplan.report.film.drives import takes_of_drive, takes_of_run, takes_of_scenario
    from dosplan.types import Arm

    arms = (Arm(options.arm),) if options.arm else tuple(Arm)
    if (episode := _episode(options.what, options.source)) is not None:
        if options.planner or options.predictor or options.seed:
            raise CommandError(
                "--planner, --predictor and --seed are for a scenario, not for a run"
            )
        return takes_of_run(*episode, arms, options.source, options.future or 0)
    if options.future is not None:
        raise CommandError("--future is for an episode of a run: name it as RUN:ID")
    if options.planner:
        predictor = options.predictor or "dos"
        return takes_of_drive(_scenario(options), options.planner, predictor, arms, options.seed)
    if options.predictor or options.arm or options.seed:
        raise CommandError(
            f"{options.what} is a scenario, which was not driven: name a --planner, or an "
            "episode as RUN:ID"
        )
    return takes_of_scenario(_scenario(options))


def _episode(what: str, source: str | None) -> tuple[Path, str] | None:
    """Run folder and id where RUN:ID is meant; ids may hold colons, too."""
    if ":" not in what or "://" in what or Path(what).exists():
        return None
    for end in (index for index, letter in enumerate(what) if letter == ":"):
        if Path(what[:end]).is_dir():
            return Path(what[:end]), what[end + 1 :]
    run, _, scenario = what.rpartition(":")
    return (Path(run), scenario) if source is None else None


def _scenario(options: argparse.Namespace) -> ScenarioRef:
    """The scenario of a file, or of an id in a source."""
    from dosplan.results.drive import find_scenario
    from dosplan.scenario import find_scenarios
    from dosplan.scenario.sources.catalogue import suites_of

    what = options.what
    if (Path(what) / "run.json").is_file():
        raise CommandError(f"{what} is a run: name one of its scenarios, as in {what}:ID")
    if not ("://" in what or Path(what).exists()):
        if is_source(what):
            raise CommandError(
                f"{what} does not exist; name a scenario file, or the id of one in --source"
            )
        return find_scenario(what, options.source or suites_of([what]))
    refs = find_scenarios(what)
    if len(refs) > 1:
        raise CommandError(
            f"{what} holds {len(refs)} scenarios: name one, as in {refs[0].id} --source {what}"
        )
    return refs[0]


RENDER: Final[Command] = RenderCommand()
