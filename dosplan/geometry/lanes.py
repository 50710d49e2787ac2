"""Lanes beside each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dosplan.types import Lanelet


def side_by_side(
    before: Sequence[Lanelet], after: Sequence[Lanelet], lanelets: Mapping[int, Lanelet]
) -> tuple[list[tuple[Lanelet, Lanelet]], int]:
    """Pairs of lanelets beside each other around a change of lanes, in driving order.

    Args:
        before: Lanelets of the lane that is left; the last one is where the change is.
        after: Those of the lane that is gone to; the first one is a neighbour of that.
        lanelets: All lanelets of the map by id.

    Returns:
        Pairs of a lanelet of the lane that is left and the one beside it, as far as both lanes go
        on without a break; and which pair the change is at.
    """
    to_left = before[-1].left_neighbour == after[0].id
    pairs = [(before[-1], after[0])]
    for lanelet in before[-2::-1]:
        beside = _neighbour(lanelet, lanelets, left=to_left)
        if beside is None or pairs[0][1].id not in beside.successors:
            break
        pairs.insert(0, (lanelet, beside))
    change = len(pairs) - 1
    for lanelet in after[1:]:
        beside = _neighbour(lanelet, lanelets, left=not to_left)
        if beside is None or beside.id not in pairs[-1][0].successors:
            break
        pairs.append((beside, lanelet))
    return pairs, change


def _neighbour(lanelet: Lanelet, lanelets: Mapping[int, Lanelet], *, left: bool) -> Lanelet | None:
    name = lanelet.left_neighbour if left else lanelet.right_neighbour
    return None if name is None else lanelets.get(name)  # Zero is an id, too.
