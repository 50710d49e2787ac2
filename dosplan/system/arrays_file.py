"""Dataclasses that hold arrays as the bytes of a file; the types of their fields say how.

``pack`` and ``unpack`` take a dataclass with whatever dataclasses, tuples and mappings are in it.
The file is an ``.npz`` of plain arrays, whose checksums tell damage: each array of the dataclass
itself under the name of its field, ``header``, JSON with all the rest, and ``data``, the bytes of
the arrays and polygons farther inside, whose place stands for them in the header. Nothing is
pickled: a file that was tampered with can give a wrong value but cannot run code.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, TypeVar, get_args

import msgspec
import numpy as np
import numpy.typing as npt
import shapely

_HEADER: Final = "header"
_DATA: Final = "data"

T = TypeVar("T")


def pack(value: object, *, compressed: bool = False) -> bytes:
    """Packs a dataclass.

    Args:
        value: The dataclass; in it may be dataclasses, texts, numbers, enumerations, tuples, sets,
            mappings, paths, None, numpy arrays of numbers or truth values, and shapely's
            geometries.
        compressed: Whether to spend time on a smaller file.

    Returns:
        The file's content.

    Raises:
        TypeError: It holds something else.
    """
    data = io.BytesIO()

    def place(part: Any) -> list[Any] | str:
        begin = data.tell()
        if isinstance(part, np.ndarray) and part.dtype.kind in "biuf":
            data.write(part.tobytes())
            return [begin, part.nbytes, part.dtype.str, *part.shape]
        if isinstance(part, shapely.Geometry):
            return [begin, data.write(shapely.to_wkb(part))]
        if isinstance(part, Path):
            return str(part)
        raise TypeError(f"a file cannot hold {type(part).__name__}")

    fields = vars(value)
    arrays = {name: part for name, part in fields.items() if isinstance(part, np.ndarray)}
    rest = {name: part for name, part in fields.items() if name not in arrays}
    tree = msgspec.to_builtins(rest, enc_hook=place, order="deterministic")
    arrays[_HEADER] = np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8)
    arrays[_DATA] = np.frombuffer(data.getbuffer(), dtype=np.uint8)
    file = io.BytesIO()
    save = np.savez_compressed if compressed else np.savez
    save(file, allow_pickle=False, **arrays)
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
        return from_arrays({name: file[name] for name in file.files}, kind)


def from_arrays(arrays: Mapping[str, npt.NDArray[Any]], kind: type[T]) -> T:
    """Builds a dataclass from the arrays of a file.

    Args:
        arrays: The arrays by their names. One of fewer digits than its field has, such as single
            precision, is widened.
        kind: The dataclass.

    Returns:
        The value.

    Raises:
        Exception: Whatever numpy, json, msgspec or shapely raise at damaged content.
    """
    tree, data = json.loads(arrays[_HEADER].tobytes()), arrays[_DATA].tobytes()

    def part(hint: Any, place: Any) -> Any:
        if hint is Path:
            return Path(place)
        if isinstance(place, np.ndarray):
            array = place
        else:
            begin, size, *about = place
            if hint is shapely.Geometry:
                return shapely.from_wkb(data[begin : begin + size])
            dtype, *shape = about
            count = size // np.dtype(dtype).itemsize
            array = np.frombuffer(data, dtype, count, begin).reshape(shape).copy()
        (wanted,) = get_args(get_args(hint)[1])
        return array.astype(wanted, casting="safe", copy=False)

    members = {name: array for name, array in arrays.items() if name not in (_HEADER, _DATA)}
    return msgspec.convert(tree | members, kind, dec_hook=part)
