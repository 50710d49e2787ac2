"""JSON to dataclasses and back: types are checked, and a mismatch gives one line."""

from __future__ import annotations

from typing import Any, Final, TypeVar

import msgspec

_LONGEST: Final = 300  # A message quotes the value that does not fit, which may be long.
_PLACE: Final = " - at `$"

T = TypeVar("T")


def typed(value: Any, kind: type[T]) -> T:
    """Builds a dataclass from plain values.

    Args:
        value: What JSON holds: texts, numbers, lists and mappings.
        kind: A dataclass, or any type of its fields. A key that it does not have is left out.

    Returns:
        The value, of that type. A whole number may stand for a float.

    Raises:
        ValueError: A value is of another type or a key is missing; one line that names the key.
    """
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        message, _, place = str(error).rpartition(_PLACE)
        line = f"{place.strip('.`')}: {message}" if message else str(error)
        raise ValueError(f"{' '.join(line.split()):.{_LONGEST}}") from None


def plain(value: Any) -> Any:
    """Turns dataclasses into plain values.

    Args:
        value: A dataclass, or what its fields may hold.

    Returns:
        What JSON can hold: texts, numbers, lists and mappings.
    """
    return msgspec.to_builtins(value)
