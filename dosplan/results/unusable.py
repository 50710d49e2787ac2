"""The scenarios of a run that nobody could drive: listed, and in no figure."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from dosplan.scenario.commonroad.document import SUFFIXES
from dosplan.types import Outcome, Score

_AFTER_FILE: Final = re.compile(
    "|".join(rf"(?<={re.escape(end)}): " for end in SUFFIXES), re.IGNORECASE
)
"""Between file and reason in a ``ScenarioError``: a folder's name may hold a colon, too."""
LISTED: Final = 10
"""How many are listed where there is no room for all."""


@dataclass(frozen=True)
class Unusable:
    """A scenario that nobody could drive.

    Attributes:
        scenario: Its id.
        file: Its file, as the run found it.
        reason: What is wrong, and what to do.
    """

    scenario: str
    file: str
    reason: str


def unusable_scenarios(rows: Iterable[Score]) -> tuple[Unusable, ...]:
    """Lists the scenarios of some rows that nobody could drive.

    Args:
        rows: Rows of a run; all arms say the same.

    Returns:
        Each once, in the order of the rows.
    """
    errors = {row.scenario: row.error or "" for row in rows if row.outcome is Outcome.UNUSABLE}
    return tuple(Unusable(name, *_file_and_reason(error)) for name, error in errors.items())


def _file_and_reason(error: str) -> tuple[str, str]:
    """The parts of a ``ScenarioError``; a file that is named by itself may have any ending."""
    if (found := _AFTER_FILE.search(error)) is not None:
        return error[: found.start()], error[found.end() :]
    file, _, reason = error.partition(": ")
    return file, reason


def unusable_title(found: Sequence[Unusable], total: int) -> str:
    """Says how many scenarios are unusable.

    Args:
        found: The unusable ones.
        total: Number of all.

    Returns:
        A line.
    """
    return (
        f"{len(found)} of {total} scenarios are unusable: nobody could drive them, and no figure "
        "counts them"
    )


def unusable_lines(found: Sequence[Unusable], total: int) -> list[str]:
    """Tells which scenarios are unusable, and why.

    Args:
        found: The unusable ones.
        total: Number of all scenarios.

    Returns:
        A line that counts them, and one each for the first ``LISTED``; none where there is none.
    """
    if not found:
        return []
    lines = [unusable_title(found, total)]
    lines += [f"  {one.file}: {one.reason}" for one in found[:LISTED]]
    if len(found) > LISTED:
        lines.append(f"  and {len(found) - LISTED} more; summary.json lists them all")
    return lines
