"""A dataclass comes back from its file as it was, or not at all."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import shapely

from dosplan.system.arrays_file import pack, unpack

ONE = np.ones(1, np.float32)


class Colour(StrEnum):
    RED = "red"


@dataclass(frozen=True)
class Part:
    values: npt.NDArray[np.float32]
    ragged: tuple[tuple[int, ...], ...] = ()
    shape: shapely.Geometry | None = None


@dataclass(frozen=True)
class Whole:
    name: str
    colour: Colour
    parts: tuple[Part, ...] = ()
    counts: npt.NDArray[np.int64] | None = None
    flags: npt.NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 3), np.bool_))
    tags: frozenset[str] = frozenset()
    bounds: tuple[float, float] | None = None


def test_every_kind_of_field_comes_back() -> None:
    square = shapely.box(0.0, 0.0, 1.0, 3.0)
    parts = (
        Part(np.array([[1.0, np.nan], [np.inf, -0.0]], np.float32), ((), (1, 2), (3,)), square),
        Part(np.array(0.1, np.float32)),
    )
    whole = Whole("é\ud800", Colour.RED, parts, np.arange(3)[::-1], tags=frozenset("ab"))
    back = unpack(pack(whole), Whole)
    assert (back.name, back.colour, back.tags) == (whole.name, Colour.RED, whole.tags)
    assert type(back.colour) is Colour
    assert back.bounds is None
    assert back.counts is not None
    assert back.counts.tolist() == [2, 1, 0]
    assert (back.flags.shape, back.flags.dtype.kind) == ((0, 3), "b")
    for one, other in zip(parts, back.parts, strict=True):
        assert one.values.tobytes() == other.values.tobytes()
        assert (one.values.dtype, one.values.shape) == (other.values.dtype, other.values.shape)
        assert one.ragged == other.ragged
    assert back.parts[0].shape == square
    assert back.parts[1].shape is None
    back.counts[0] = 7  # Its memory is its own.


def test_a_dataclass_without_arrays_is_kept_too() -> None:
    whole = unpack(pack(Whole("a", Colour.RED, flags=np.zeros(0, np.bool_))), Whole)
    assert whole.parts == ()


def test_objects_are_not_packed() -> None:
    part = Part(np.array([Path()], dtype=object))
    with pytest.raises(ValueError, match="Object arrays cannot be saved"):
        pack(part)
    with pytest.raises(TypeError, match="cannot hold ndarray"):
        pack(Whole("a", Colour.RED, (part,)))


def test_the_arrays_of_the_dataclass_itself_have_their_names_and_are_widened() -> None:
    content = pack(Whole("a", Colour.RED, counts=np.arange(3, dtype=np.int8)), compressed=True)
    with np.load(io.BytesIO(content)) as file:
        assert sorted(file.files) == ["counts", "data", "flags", "header"]
        assert file["counts"].tolist() == [0, 1, 2]
    back = unpack(content, Whole)
    assert back.counts is not None
    assert back.counts.dtype == np.int64
    broken = pack(Whole("a", Colour.RED, counts=np.ones(2)))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"Cannot cast .* - at `\$.counts`"):
        unpack(broken, Whole)


@pytest.mark.parametrize("name", ["header", "data"])
@pytest.mark.parametrize("content", [np.zeros(0, np.uint8), np.array([{}], dtype=object)])
def test_damaged_content_raises(name: str, content: Any) -> None:
    with np.load(io.BytesIO(pack(Whole("a", Colour.RED, (Part(ONE),))))) as file:
        arrays = dict(file)
    damaged = io.BytesIO()
    np.savez(damaged, allow_pickle=True, **(arrays | {name: content}))
    with pytest.raises(ValueError, match=r".+"):
        unpack(damaged.getvalue(), Whole)


def test_a_value_of_another_type_raises() -> None:
    with pytest.raises(ValueError, match=r"Expected `object`, got `null` - at `\$.parts\[0\]`"):
        unpack(pack(Whole("a", Colour.RED, (None,))), Whole)  # type: ignore[arg-type]
