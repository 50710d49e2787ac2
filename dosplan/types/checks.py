"""The check of numbers that settings share."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import fields
from typing import Any


def check_numbers(
    settings: Any, positive: Collection[str] = (), shares: Collection[str] = ()
) -> None:
    """Refuses numbers that are negative or not finite.

    Args:
        settings: An instance of a dataclass; what is no number in it is not looked at.
        positive: Names of the numbers that may not be zero either.
        shares: Names of those that may not be more than one.

    Raises:
        ValueError: A number is out of range.
    """
    for field in fields(settings):
        name, value = field.name, getattr(settings, field.name)
        if not isinstance(value, int | float):
            continue
        if not 0 <= value < math.inf:
            raise ValueError(f"{name} is {value}, expected 0 or more, and finite")
        if name in positive and value == 0:
            raise ValueError(f"{name} is 0, expected more")
        if name in shares and value > 1:
            raise ValueError(f"{name} is {value}, expected 1 or less")
