"""The leaderboard as a page: ``docs/leaderboard.md``, made of the files of its rows alone."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import le
from typing import Any, Final

from dosplan.results.comparison import compare_rows
from dosplan.results.leaderboard import COLUMNS, ArmResult, Submission
from dosplan.results.markdown import ARM_TITLES, escaped, markdown
from dosplan.results.paired import Difference
from dosplan.results.table_text import difference_text, figure_text
from dosplan.scoring.metrics import find_metric
from dosplan.types import Arm, Score

COMPARED: Final = ("success", "at_fault_collision")
"""Metrics whose paired difference from the baseline is shown."""
_VERSION: Final = re.compile(r"-v(\d{1,9})$")
"""What the name of a planner or predictor ends with."""
_HEAD: Final = """\
# Leaderboard

<!-- Made from results/leaderboard/*.json by `dosplan leaderboard`: do not edit. -->

Whole runs of known scenario sets. Each set and world (traffic, loop, futures) has a block, since
figures of different worlds differ for reasons that are not the planner's. How a planner or
predictor of yours comes in here: [submit.md](submit.md).

- **A row** is one arm of a run: *with DOS* the planner is handed the predictor's sets, *without
  DOS* its points alone.
- **Order**: by success; among equals by safety, then by fewer collisions that the ego is to blame
  for, then by velocity. Success comes first as no planner gets it by giving something else away: it
  asks for a safe drive *and* for the goal within its time. By safety alone a car that never starts
  would win, and by velocity one that looks at nobody.
- **Earlier versions** of a planner or predictor stand below the others: who changes one and
  submits it again is compared with what it was.
- **Intervals** in brackets are of 95 %; they take into account which episodes are of one scenario,
  and which scenarios of one place. Rows whose intervals overlap may stand the other way round in
  other scenarios; paired differences are the sharper test.
- **Minus `mpc`**: the difference from the built-in `mpc` with `dos`, with sets, over the same
  episodes, with its interval and the p of the exact sign-flip test by scenarios. Among many rows
  one small p proves little.
- [metrics.md](metrics.md) says what each figure is. Each run was scored again from its recordings
  when it was submitted; that the named planner drove it is its authors' word."""


def leaderboard_page(submissions: Sequence[Submission]) -> str:
    """Writes the page.

    Args:
        submissions: The rows.

    Returns:
        Its text: a block for each scenario set and world.
    """
    blocks: dict[tuple[Any, ...], list[Submission]] = {}
    for one in submissions:
        blocks.setdefault(_place(one), []).append(one)
    parts = [_HEAD]
    for place in sorted(blocks):
        parts += _block(blocks[place])
    if not blocks:
        parts.append("No run has been submitted yet.")
    return "\n\n".join(parts) + "\n"


@dataclass(frozen=True)
class _Line:
    """An arm of a submission."""

    of: Submission
    arm: Arm
    result: ArmResult

    @property
    def rows(self) -> list[Score]:
        return self.result.rows(self.arm)

    @property
    def rank(self) -> tuple[Any, ...]:
        """What the rows of a block are sorted by."""
        success, safe, blamed, velocity = (
            self.result.figures[name].value or 0.0 for name in COLUMNS
        )
        return (-success, -safe, blamed, -velocity, self.of.title, self.arm)

    @property
    def versions(self) -> tuple[int, ...]:
        """The versions of planner and predictor; 0 of a name without one."""
        found = map(_VERSION.search, (self.of.planner, self.of.predictor))
        return tuple(int(one[1]) if one else 0 for one in found)

    @property
    def drivers(self) -> tuple[str, ...]:
        """Planner and predictor, without their versions."""
        return tuple(_VERSION.sub("", name) for name in (self.of.planner, self.of.predictor))

    @property
    def is_baseline(self) -> bool:
        """Whether it is the built-in planner with its sets, in any version."""
        return self.arm is Arm.WITH_DOS and self.of.is_built_in and self.drivers == ("mpc", "dos")

    @property
    def kin(self) -> tuple[Any, ...]:
        """What all versions of it have in common."""
        options = (self.of.planner_options, self.of.predictor_options)
        return (self.arm, self.of.about, self.drivers, *options)

    def is_succeeded_by(self, other: _Line) -> bool:
        """Whether another line is the same but for a later version of what drives."""
        no_later = all(map(le, self.versions, other.versions))
        return self.kin == other.kin and self.versions != other.versions and no_later


def _place(one: Submission) -> tuple[Any, ...]:
    """What belongs into one block."""
    return (one.scenario_set, one.world, one.seed, one.set_digest)


def _block(members: Sequence[Submission]) -> Iterator[str]:
    lines = [_Line(one, arm, result) for one in members for arm, result in one.arms.items()]
    lines.sort(key=lambda line: line.rank)
    first = members[0]
    bases = [line for line in lines if line.is_baseline]
    base = max(bases, key=lambda line: line.versions, default=None)
    result = lines[0].result
    yield f"## {first.scenario_set}: {first.world.title}"
    episodes = sum(len(words.split()) for words in result.episodes.values())
    seed = f", seed {first.seed}" if first.seed else ""
    yield (
        f"{len(result.episodes)} scenarios, {episodes} episodes in each row{seed}; files "
        f"`{first.set_digest[:8]}`; scored by dosplan {' and '.join(_versions(members))}."
    )
    newest: list[_Line] = []
    earlier: list[_Line] = []
    for line in lines:
        (earlier if any(map(line.is_succeeded_by, lines)) else newest).append(line)
    yield _table(newest, base)
    if earlier:
        yield "Earlier versions of what is above:"
        yield _table(earlier, base)


def _table(lines: Sequence[_Line], base: _Line | None) -> str:
    shown = [find_metric(name) for name in COLUMNS]
    compared = [] if base is None else [find_metric(name) for name in COMPARED]
    headings = ["Run", "Arm", *(metric.heading for metric in shown)]
    headings += [f"{metric.short} minus `mpc`, points" for metric in compared]
    rows = []
    for line in lines:
        found = _differences(line, base)
        rows.append(
            [
                _named(line.of),
                ARM_TITLES[line.arm],
                *(figure_text(m, line.result.figures[m.name]) for m in shown),
                *(difference_text(m, found.get(m.name)) for m in compared),
            ]
        )
    return markdown(headings, rows)


def _differences(line: _Line, base: _Line | None) -> dict[str, Difference]:
    if base is None or line is base:
        return {}
    return dict(compare_rows(base.rows, line.rows, "mpc", line.of.title).differences)


def _versions(members: Sequence[Submission]) -> list[str]:
    return sorted({escaped(one.dosplan) for one in members})


def _named(one: Submission) -> str:
    """The name of a run as Markdown, with what drives where the name does not say it."""
    name = escaped(one.title)
    if one.about.url:
        name = f"[{name}]({one.about.url})"
    if one.about.name:
        name += f": {escaped(' with '.join(one.drivers))}"
    return f"{name}, {escaped(one.about.authors)}" if one.about.authors else name
