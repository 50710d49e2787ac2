"""Dataclasses that hold arrays as the bytes of a file; the types of their fields say how.

``pack`` and ``unpack`` take a dataclass with whatever dataclasses, tuples and mappings are in it.
The file is an uncompressed ``.npz`` of two plain arrays, whose checksums tell damage: ``header``,
JSON in which the place of an array or a polygon stands for it, and ``data``, the bytes of them all.
Nothing is pickled: a file that was tampered with can give a wrong value but cannot run code.
"""

from __future__ import annotations

import io
import json
from typing import Any, TypeVar

import msgspec
import numpy as np
import shapely

T = TypeVar("T")


def pack(value: object) -> bytes:
    """Packs a dataclass.

    Args:
        value: The dataclass; in it may be dataclasses, texts, numbers, enumerations, tuples, sets,
            mappings, None, numpy arrays of numbers or truth values, and shapely's geometries.

    Returns:
        The file's content.

    Raises:
        TypeError: It holds something else.
    """
    data = io.BytesIO()

    def place(part: Any) -> list[Any]:
        begin = data.tell()
        if isinstance(part, np.ndarray) and part.dtype.kind in "biuf":
            data.write(part.tobytes())
            return [begin, part.nbytes, part.dtype.str, *part.shape]
        if isinstance(part, shapely.Geometry):
            return [begin, data.write(shapely.to_wkb(part))]
        raise TypeError(f"a file cannot hold {type(part).__name__}")

    tree = msgspec.to_builtins(value, enc_hook=place, order="deterministic")
    file = io.BytesIO()
    np.savez(
        file,
        allow_pickle=False,
        header=np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8),
        data=np.frombuffer(data.getbuffer(), dtype=np.uint8),
    )
    return file.getvalue()


def unpack(content: bytes, kind: type[T]) -> T:
    """Reads a dataclass back.

    Args:
        content: What ``pack`` gave.
        kind: The dataclass.

    Returns:
        The value, equal in every field to the one that was packed.

    Raises:
        Exception: Whatever numpy, zipfile, json, msgspec or shapely raise at damaged content.
    """
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        tree, data = json.loads(file["header"].tobytes()), file["data"].tobytes()

    def part(hint: Any, place: list[Any]) -> Any:
        begin, size, *array = place
        if hint is shapely.Geometry:
            return shapely.from_wkb(data[begin : begin + size])
        dtype, *shape = array
        count = size // np.dtype(dtype).itemsize
        return np.frombuffer(data, dtype, count, begin).reshape(shape).copy()

    return msgspec.convert(tree, kind, dec_hook=part)
