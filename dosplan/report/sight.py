"""Where the ego saw road users, for whoever draws it: films and pages."""

from __future__ import annotations

from typing import Final

import numpy as np

from dosplan.types import FloatArray

ELSEWHERE: Final = 0.3
"""Road users that the ego sees within so many m of where they are have no outline there."""


def is_elsewhere(seen: FloatArray, state: FloatArray) -> bool:
    """Whether a road user is drawn where the ego saw it, too.

    Args:
        seen: (2 or more,) x, y, m, where the ego saw it; further values are not read.
        state: (2 or more,) the same where it is; NaN where it is not on the scene.

    Returns:
        Whether it is not there, or off the scene.
    """
    return not np.linalg.norm(seen[:2] - state[:2]) < ELSEWHERE
