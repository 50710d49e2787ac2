"""Rows as a table of polars or pandas, which are optional: ``pip install 'dosplan[frames]'``."""

from __future__ import annotations

import types
from collections.abc import Iterable
from enum import StrEnum
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, get_args, get_type_hints

from dosplan.scoring import metrics
from dosplan.types import Score

if TYPE_CHECKING:
    import pandas
    import polars

# Of each library, the types of columns in which a value may be missing.
_POLARS: Final = {str: "String", bool: "Boolean", int: "Int64", float: "Float64"}
_PANDAS: Final = {str: "string", bool: "boolean", int: "Int64", float: "Float64"}


def to_polars(rows: Iterable[Score]) -> polars.DataFrame:
    """Makes a polars frame of rows.

    Args:
        rows: The rows of a run.

    Returns:
        A frame with the columns of ``Score``; what is None there is null.

    Raises:
        ImportError: polars is not installed.
    """
    library = _imported("polars")
    schema = {name: getattr(library, _POLARS[kind]) for name, kind in _columns().items()}
    frame: polars.DataFrame = library.DataFrame(_records(rows), schema=schema)
    return frame


def to_pandas(rows: Iterable[Score]) -> pandas.DataFrame:
    """Makes a pandas frame of rows.

    Args:
        rows: The rows of a run.

    Returns:
        A frame with the columns of ``Score``, of types that have a missing value.

    Raises:
        ImportError: pandas is not installed.
    """
    library = _imported("pandas")
    columns = _columns()
    frame = library.DataFrame(_records(rows), columns=list(columns))
    typed: pandas.DataFrame = frame.astype({name: _PANDAS[kind] for name, kind in columns.items()})
    return typed


def _imported(library: str) -> Any:
    try:
        return import_module(library)
    except ImportError as error:
        raise ImportError(
            f"a frame of {library} needs it installed ({error}); pip install 'dosplan[frames]'"
        ) from error


def _columns() -> dict[str, type]:
    """The plain type of each column: ``str`` for an enumeration, ``int`` for ``int | None``."""
    hints = get_type_hints(Score)
    del hints["measures"]
    return {name: _plain(hint) for name, hint in hints.items()} | metrics.measured_kinds()


def _plain(hint: Any) -> type:
    kinds = get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    (kind,) = (k for k in kinds if k is not types.NoneType)
    return str if issubclass(kind, StrEnum) else kind


def _records(rows: Iterable[Score]) -> list[dict[str, Any]]:
    return [
        {n: str(v) if isinstance(v, StrEnum) else v for n, v in row.columns().items()}
        for row in rows
    ]
