"""Which peers can be tried here: they are not among what the tests install."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

import pytest

NEEDS: Final = {
    "reactive": ("commonroad_rp", "commonroad_dc"),
    "frenetix": ("frenetix", "commonroad_dc"),
}


def is_missing(planner: str) -> bool:
    """Whether a planner is a peer that is not installed."""
    return any(find_spec(module) is None for module in NEEDS.get(planner, ()))


def skip_where_missing(planner: str) -> pytest.MarkDecorator:
    """Skips the tests of a planner that is a peer and not installed."""
    reason = f"{planner} is not installed: pip install 'dosplan[peers]' in Python 3.11"
    return pytest.mark.skipif(is_missing(planner), reason=reason)
