"""Parameters of which every run of the tests takes a share, and ``make test-all`` all."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def every_other(values: Iterable[Any]) -> list[Any]:
    """Parameters of a test, of which the second, the fourth and so on are slow ones.

    Args:
        values: The parameters.

    Returns:
        All of them, as ``pytest.mark.parametrize`` takes them.
    """
    return [
        pytest.param(value, marks=pytest.mark.slow) if i % 2 else value
        for i, value in enumerate(values)
    ]
