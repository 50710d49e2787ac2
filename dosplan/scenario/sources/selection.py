"""Choosing scenarios of a source: by what they are called or tagged with, by lot, or the first."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from typing import Final

from dosplan.scenario.commonroad.document import ScenarioError, scan_tags
from dosplan.scenario.sources.catalogue import ScenarioRef, suite_kinds
from dosplan.system.errors import DosplanError

_SHOWN: Final = 20  # Tags and kinds that a message names.


class SelectionError(DosplanError, ValueError):
    """Nothing is left of a choice of scenarios; the message is one line."""


def matching(refs: Sequence[ScenarioRef], texts: Sequence[str]) -> list[ScenarioRef]:
    """Keeps the scenarios to which one of some texts applies.

    A text applies to a scenario where it is part of its id, one of the tags of its file, or part
    of what an embedded suite calls its kind. Capitals do not count, and neither does
    whether words are joined by ``_``, ``-`` or a blank.

    Args:
        refs: Scenarios.
        texts: Texts; none keeps all.

    Returns:
        Those to which one of them applies at least, in their order.

    Raises:
        SelectionError: To no scenario does one apply.
    """
    wanted = [_plain(text) for text in texts]
    if not wanted:
        return list(refs)
    kinds = suite_kinds()
    seen: set[str] = set()
    chosen = []
    for ref in refs:
        name, kind = _plain(ref.id), _plain(kinds.get(ref.id, ""))
        if any(text in name or text in kind for text in wanted):
            chosen.append(ref)
            continue
        tags = _tags(ref)
        seen |= tags | {kind}
        if tags.intersection(wanted):
            chosen.append(ref)
    if not chosen:
        told = ", ".join(sorted(seen - {""})[:_SHOWN])
        there = f"there are the tags and kinds {told}" if told else "no file has tags"
        raise SelectionError(
            f"--only {' --only '.join(texts)}: none of {len(refs)} scenarios has it in its id or "
            f"among its tags; {there}"
        )
    return chosen


def sampled(refs: Sequence[ScenarioRef], count: int, seed: int) -> list[ScenarioRef]:
    """Draws scenarios by lot.

    Each id has a lot of its own, from the seed, and the smallest lots win. So a larger sample
    holds the smaller one, and in a source that has grown a scenario leaves the sample only where
    a new one has taken its place.

    Args:
        refs: Scenarios.
        count: How many; of fewer, all are drawn.
        seed: Another seed, another sample.

    Returns:
        The sample, in the order of ``refs``.
    """
    lots = {ref: sha256(f"{seed} {ref.id}".encode()).digest() for ref in refs}
    drawn = set(sorted(refs, key=lots.__getitem__)[:count])
    return [ref for ref in refs if ref in drawn]


def _tags(ref: ScenarioRef) -> set[str]:
    try:
        return {_plain(tag) for tag in scan_tags(ref.path)}
    except ScenarioError:  # It is told when it is driven.
        return set()


def _plain(text: str) -> str:
    return " ".join(text.casefold().replace("_", " ").replace("-", " ").split())
