"""The arrays that values are made of: element types, columns, and the check that freezes them."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from dosplan.system.errors import DosplanError

_Value = TypeVar("_Value")

FloatArray = npt.NDArray[np.float64]
"""Array of 64-bit floats."""
BoolArray = npt.NDArray[np.bool_]
"""Array of truth values."""
IntArray = npt.NDArray[np.int64]
"""Array of 64-bit integers."""

EGO_X: Final = 0
"""Column of an ego state: x of the rear axle, m."""
EGO_Y: Final = 1
"""Column of an ego state: y of the rear axle, m."""
EGO_STEERING: Final = 2
"""Column of an ego state: angle of the front wheels, rad."""
EGO_VELOCITY: Final = 3
"""Column of an ego state: velocity of the rear axle, m/s."""
EGO_HEADING: Final = 4
"""Column of an ego state: heading, rad."""
EGO_SIZE: Final = 5
"""Number of columns of an ego state."""
EGO_COLUMNS: Final = "x and y of the rear axle, steering angle, velocity, heading"
"""The same in words, for messages."""

USER_X: Final = 0
"""Column of a road user's state: x of its centre, m."""
USER_Y: Final = 1
"""Column of a road user's state: y of its centre, m."""
USER_HEADING: Final = 2
"""Column of a road user's state: heading, rad."""
USER_VELOCITY: Final = 3
"""Column of a road user's state: velocity along the heading, m/s."""
USER_SIZE: Final = 4
"""Number of columns of a road user's state."""

MAX_NUMBER: Final = 1e9
"""Largest number of a scene or a plan: what is larger is no length, time or speed, and its powers
are no numbers."""


class ShapeError(DosplanError, ValueError):
    """An array that does not have the shape or the finiteness its field promises."""


def frozen(
    owner: object,
    field: str,
    dtype: Any,
    shape: Sequence[int | None],
    finite: bool = False,
    columns: str = "",
) -> None:
    """Replaces ``owner.field`` by a read-only copy after checking its shape.

    What is stored is a view of a copy that is read-only itself, so that ``setflags`` cannot make
    it writable again.

    Args:
        owner: A frozen dataclass instance.
        field: Name of the field.
        dtype: The numpy dtype that is wanted.
        shape: Expected shape; ``None`` stands for any length.
        finite: Whether NaN, infinity and what is larger than ``MAX_NUMBER`` are refused.
        columns: What the columns are, to be told where their number is wrong.

    Raises:
        ShapeError: The array has another shape or holds a value that is refused.
    """
    value = getattr(owner, field)
    where = f"{type(owner).__name__}.{field}"
    name = getattr(owner, "scenario_id", None)
    suffix = f" (scenario {name})" if name else ""
    try:
        if np.iscomplexobj(value):  # numpy would drop the imaginary part, and only warn.
            raise TypeError("it holds complex numbers")
        array = np.array(value, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{where} is not an array of {np.dtype(dtype)}: {error}{suffix}") from None
    if array.ndim != len(shape) or any(
        want is not None and have != want for have, want in zip(array.shape, shape, strict=True)
    ):
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        told = f"; columns: {columns}" if columns and array.shape[-1:] != (shape[-1],) else ""
        raise ShapeError(f"{where} has shape {array.shape}, expected {wanted}{told}{suffix}")
    if finite:
        check_finite(array, where, suffix)
    _hold(owner, field, array)


def check_finite(array: npt.NDArray[Any], where: str, suffix: str = "") -> None:
    """Refuses NaN, infinity and what is larger than ``MAX_NUMBER``.

    Args:
        array: Any numbers.
        where: What they are, for the message.
        suffix: What the message ends with.

    Raises:
        ShapeError: One of them is refused.
    """
    if np.all(np.abs(array) <= MAX_NUMBER):
        return
    large = np.all(np.isfinite(array))
    what = f"a number beyond {MAX_NUMBER:g}" if large else "a NaN or an infinite value"
    raise ShapeError(f"{where} holds {what}{suffix}")


def derived(owner: _Value, **fields: Any) -> _Value:
    """A copy of a frozen value in which some fields are made of what it holds.

    Parts of what was checked are not checked again: values are cut many times in a planning cycle.

    Args:
        owner: A frozen dataclass instance whose arrays went through ``frozen``.
        fields: The fields that differ: arrays of the element types of those in their place, which
            become read-only copies; values that are no arrays are taken as they are.

    Returns:
        The copy.
    """
    made = copy.copy(owner)
    for name, value in fields.items():
        if isinstance(value, np.ndarray):
            _hold(made, name, np.array(value))
        else:
            object.__setattr__(made, name, value)
    return made


def _hold(owner: object, field: str, array: npt.NDArray[Any]) -> None:
    """Sets a field of a frozen value to a read-only view of an array that nobody else holds."""
    array.setflags(write=False)
    object.__setattr__(owner, field, array.view())
