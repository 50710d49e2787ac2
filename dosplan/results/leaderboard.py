"""Rows of the leaderboard: a file for each run that was submitted.

A file holds what drove and in what world, the figures with their intervals, and each episode's
outcome and velocity, from which the figures follow and by which rows are compared in pairs. It is
written by ``dosplan submit``, and is small enough to be read.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from dosplan.results.intervals import metric_interval
from dosplan.results.table import Figure, World, with_options
from dosplan.scoring.metrics import find_metric
from dosplan.scoring.score import failed_score
from dosplan.system.errors import DosplanError
from dosplan.system.files import FileError, read_json, write_json
from dosplan.system.provenance import content_digest
from dosplan.system.typed import plain, typed
from dosplan.types import Arm, EpisodeKey, Outcome, Score

_DIGEST: Final = re.compile("[0-9a-f]{64}")

COLUMNS: Final = ("success", "safe", "at_fault_collision", "velocity")
"""Names of the metrics that the leaderboard shows."""
_DIGITS: Final = 4  # Decimals of an episode's velocity, m/s.
_ROUNDING: Final = 2e-4  # What a figure may differ by from that of rounded velocities.
_LONGEST: Final = 100  # Characters of a name.

_LETTERS: Final = {
    "S": (Outcome.SUCCESS, False),
    "G": (Outcome.GOAL_MISSED, False),
    "C": (Outcome.COLLISION, True),
    "c": (Outcome.COLLISION, False),
    "B": (Outcome.OUT_OF_BOUNDS, False),
    "F": (Outcome.PLANNER_FAILURE, False),
}
"""Of each letter: the outcome, and whether the ego is to blame for a collision."""


class SubmissionError(DosplanError, ValueError):
    """A run that the leaderboard does not take.

    Attributes:
        reasons: Why not, each a line.
    """

    def __init__(self, reasons: Sequence[str]) -> None:
        super().__init__("; ".join(reasons))
        self.reasons = tuple(reasons)


@dataclass(frozen=True, kw_only=True)
class About:
    """What a person says of a run.

    Attributes:
        name: What the leaderboard calls it; planner and predictor by default.
        authors: Whose it is.
        url: Page about it, or its code.

    Raises:
        SubmissionError: A text is too long or has a line break, or the URL is none.
    """

    name: str = ""
    authors: str = ""
    url: str = ""

    def __post_init__(self) -> None:
        reasons = [
            f"{what} must be one line of at most {_LONGEST} characters"
            for what, text in (("name", self.name), ("authors", self.authors))
            if len(text) > _LONGEST or not text.isprintable()
        ]
        if self.url and not re.fullmatch(r"https?://[^\s<>()\[\]|\"'`\\]{1,300}", self.url):
            reasons.append(f"url {self.url!r:.100} is not of the form https://...")
        if reasons:
            raise SubmissionError(reasons)


@dataclass(frozen=True, kw_only=True)
class ArmResult:
    """One arm of a submission.

    Attributes:
        figures: The figure of each metric, with its 95 % interval.
        episodes: By scenario, a word for each future: a letter for the outcome (S success, G goal
            missed, C collision that the ego is to blame for, c another collision, B out of bounds,
            F planner failure) and the mean velocity in m/s, where a step was driven.
    """

    figures: Mapping[str, Figure]
    episodes: Mapping[str, str]

    @classmethod
    def of(cls, rows: Sequence[Score]) -> ArmResult:
        """Writes down rows of one arm.

        Args:
            rows: The rows, of which every outcome is the planner's.

        Returns:
            The arm.
        """
        words: dict[str, list[str]] = {}
        for row in sorted(rows, key=lambda row: row.future):
            words.setdefault(row.scenario, []).append(_word(row))
        order = dict.fromkeys(row.scenario for row in rows)
        return cls(
            figures={name: _figure(name, rows) for name in COLUMNS},
            episodes={scenario: " ".join(words[scenario]) for scenario in order},
        )

    def rows(self, arm: Arm) -> list[Score]:
        """The rows, with what the file says of them.

        Args:
            arm: The arm.

        Returns:
            A row for each episode.

        Raises:
            ValueError: A word is none.
        """
        return [
            _row(EpisodeKey(scenario, arm, future), word)
            for scenario, words in self.episodes.items()
            for future, word in enumerate(words.split())
        ]


@dataclass(frozen=True, kw_only=True)
class Submission:
    """A run as the leaderboard keeps it.

    Attributes:
        about: What a person says of it.
        scenario_set: Name of the scenario set.
        set_digest: SHA-256 of the files of that set.
        planner: Name of the planner, with its version.
        predictor: Name of the predictor, likewise.
        traffic: Name of the traffic, likewise.
        loop: Name of the loop, with what was changed of it.
        futures: Number of futures of each scenario.
        seed: Seed of everything random.
        planner_options: What was set of the planner.
        predictor_options: Likewise of the predictor.
        traffic_options: Likewise of the traffic.
        digests: SHA-256 of the plug-ins' files and of the weights.
        dosplan: Version of dosplan that drove and scored it.
        git_revision: Commit of dosplan's source; null where it was not a checkout.
        started: When the run began, UTC.
        arms: The arms that were driven.
    """

    about: About
    scenario_set: str
    set_digest: str
    planner: str
    predictor: str
    traffic: str
    loop: str
    futures: int
    seed: int
    planner_options: Mapping[str, Any] = field(default_factory=dict)
    predictor_options: Mapping[str, Any] = field(default_factory=dict)
    traffic_options: Mapping[str, Any] = field(default_factory=dict)
    digests: Mapping[str, str]
    dosplan: str
    git_revision: str | None
    started: str
    arms: Mapping[Arm, ArmResult]

    @property
    def world(self) -> World:
        """What it was driven in."""
        return World.of(self.traffic, self.traffic_options, self.loop, self.futures)

    @property
    def is_built_in(self) -> bool:
        """Whether nothing of it lies in a file of its own, and nothing was set."""
        files = {self.digests.get(f"{part} file") for part in ("planner", "predictor")}
        return files == {content_digest([])} and not (
            self.planner_options or self.predictor_options
        )

    @property
    def title(self) -> str:
        """What it is called."""
        return self.about.name or " with ".join(self.drivers)

    @property
    def drivers(self) -> tuple[str, str]:
        """Planner and predictor, each with its options."""
        return (
            with_options(self.planner, self.planner_options),
            with_options(self.predictor, self.predictor_options),
        )

    @property
    def file_name(self) -> str:
        """Name of its file: the same whenever the same is submitted."""
        options = [self.planner_options, self.predictor_options]
        name = self.about.name or f"{self.planner} {self.predictor}"
        if not self.about.name and any(options):
            name += f" {_short(options)}"
        traffic = self.traffic
        if self.traffic_options:
            traffic += f" {_short(self.traffic_options)}"
        world = [traffic, self.loop, f"{self.futures} futures"]
        if self.seed:
            world.append(f"seed {self.seed}")
        return f"{'_'.join(map(_slug, [self.scenario_set, *world, name]))}.json"


def read_submissions(folder: Path) -> list[Submission]:
    """Reads all rows.

    Args:
        folder: Where they lie; one that is not there holds none.

    Returns:
        The submissions, by the names of their files.

    Raises:
        FileError: A file is not what ``dosplan submit`` writes.
    """
    return [read_submission(path) for path in sorted(folder.glob("*.json"))]


def read_submission(path: Path) -> Submission:
    """Reads one row, and checks that its figures are those of its episodes.

    Args:
        path: The file.

    Returns:
        The submission.

    Raises:
        FileError: It is not what ``dosplan submit`` writes.
    """
    try:
        found = typed(read_json(path), Submission)
        if not found.arms:
            raise ValueError("it has no arm")
        if not _DIGEST.fullmatch(found.set_digest):
            raise ValueError("set_digest is no SHA-256")
        for arm, result in found.arms.items():
            _check(result, result.rows(arm), found.futures)
    except (ValueError, SubmissionError) as error:
        raise FileError(
            f"{path} is no row of the leaderboard ({error}); submit its run again"
        ) from None
    if path.name != found.file_name:
        raise FileError(f"{path} is called {found.file_name}, by what it holds; rename it")
    return found


def write_submission(folder: Path, submission: Submission) -> Path:
    """Writes a row.

    Args:
        folder: Where the rows lie; made.
        submission: The row.

    Returns:
        Its file.

    Raises:
        SubmissionError: The file is another submission's.
        FileError: It cannot be written, or what is there is no row.
    """
    path = folder / submission.file_name
    if path.exists():
        there = read_submission(path)
        if not _is_same(there, submission):
            by = f" by {there.about.authors}" if there.about.authors else ""
            raise SubmissionError(
                [f"{path} holds another submission{by} ({there.title}); choose another --name"]
            )
    folder.mkdir(parents=True, exist_ok=True)
    write_json(path, plain(submission))
    return path


def _is_same(there: Submission, new: Submission) -> bool:
    """Whether a submission may take the place of one: it is of the same people, or drives alike."""
    if there.about.authors != new.about.authors:
        return False
    if there.about.authors:
        return True
    alike = (
        replace(one, started="", git_revision=None, dosplan="", arms={}) for one in (there, new)
    )
    return next(alike) == next(alike)


def _check(result: ArmResult, rows: Sequence[Score], futures: int) -> None:
    """Raises ``ValueError`` where the figures of an arm are not those of its episodes."""
    if any(len(words.split()) != futures for words in result.episodes.values()):
        raise ValueError(f"not every scenario has {futures} episodes")
    for name in COLUMNS:
        told, found = result.figures.get(name), _figure(name, rows)
        if told is None or any(
            (one is None) is not (other is None)
            or (one is not None and other is not None and not abs(one - other) <= _ROUNDING)
            for one, other in zip(_ends(told), _ends(found), strict=True)
        ):
            raise ValueError(f"{name} does not follow from its episodes")


def _ends(figure: Figure) -> Iterable[float | None]:
    return (figure.value, figure.low, figure.high)


def _figure(name: str, rows: Sequence[Score]) -> Figure:
    found = metric_interval(find_metric(name), rows)
    return Figure(None) if found is None else Figure.of(found)


def _word(row: Score) -> str:
    blame = row.at_fault and row.outcome is Outcome.COLLISION
    (letter,) = (x for x, meant in _LETTERS.items() if meant == (row.outcome, blame))
    return f"{letter}{round(row.velocity, _DIGITS)}" if row.steps else letter


def _row(key: EpisodeKey, word: str) -> Score:
    if word[:1] not in _LETTERS:
        raise ValueError(f"{word!r:.20} is no episode")
    outcome, at_fault = _LETTERS[word[0]]
    velocity = float(word[1:]) if word[1:] else 0.0
    if not math.isfinite(velocity):
        raise ValueError(f"{word!r:.20} is no episode")
    return replace(
        failed_score(key, ""),
        outcome=outcome,
        safe=outcome in (Outcome.SUCCESS, Outcome.GOAL_MISSED),
        at_fault=at_fault,
        velocity=velocity,
        steps=int(len(word) > 1),
        error=None,
        measures={},
    )


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9.=]+", "-", text.lower()).strip("-.") or _short(text)


def _short(value: Any) -> str:
    return sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:8]
