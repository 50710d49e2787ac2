"""Which peers can be tried here: they are not among what the tests install."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

import pytest

NEEDS: Final = {
    "reactive": ("commonroad_rp", "commonroad_dc"),
    "frenetix": ("frenetix", "commonroad_dc"),
}
PREDICTORS: Final = {"wale-net": ("prediction", "cv2")}


def is_missing(name: str) -> bool:
    """Whether a planner or predictor is a peer that is not installed."""
    needed = {**NEEDS, **PREDICTORS}.get(name, ())
    return any(find_spec(module) is None for module in needed)


def skip_where_missing(name: str) -> pytest.MarkDecorator:
    """Skips the tests of a planner or predictor that is a peer and not installed."""
    what = "dosplan[wale-net]'" if name in PREDICTORS else "dosplan[peers]' in Python 3.11"
    reason = f"{name} is not installed: pip install '{what}"
    return pytest.mark.skipif(is_missing(name), reason=reason)
