"""Writes the tables of ``docs/run-folder.md`` from the dataclasses: ``python docs/schema.py``.

In the page, a table stands between ``<!-- RunManifest -->`` and ``<!-- end -->``, for each class.
"""

from __future__ import annotations

import inspect
import json
import re
import types
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

from dosplan.results.comparison import Change, Comparison, Difference
from dosplan.results.manifest import RunManifest, RunSettings
from dosplan.results.summary import ArmSummary, RunTitle, Summary
from dosplan.system.provenance import Machine
from dosplan.types import Score

PAGE: Final = Path(__file__).with_name("run-folder.md")
CLASSES: Final[tuple[type, ...]] = (
    RunManifest, RunSettings, Machine, Score, Summary, ArmSummary, RunTitle, Comparison,
    Difference, Change,
)  # fmt: skip
_NAMES: Final[dict[Any, str]] = {
    str: "text", bool: "true or false", int: "whole number", float: "number", Any: "anything",
    types.NoneType: "null",
}  # fmt: skip


def page_with_tables(page: str) -> str:
    """Puts the tables of all classes into a page.

    Args:
        page: Text of the page, with the marks of every class.

    Returns:
        The page with its tables as the classes are now.

    Raises:
        ValueError: A class has no marks in the page.
    """
    for kind in CLASSES:
        mark = re.compile(rf"(<!-- {kind.__name__} -->\n).*?(<!-- end -->)", re.DOTALL)
        if not mark.search(page):
            raise ValueError(f"{PAGE.name} has no place for the table of {kind.__name__}")
        page = mark.sub(lambda found: f"{found[1]}{_table(kind)}\n{found[2]}", page)  # noqa: B023
    return page


def _table(kind: type) -> str:
    hints = get_type_hints(kind)
    rows = [
        f"| `{field.name}` | {_type_name(hints[field.name])} | {_meaning(kind, field.name)} "
        f"| {_absent(field)} |"
        for field in fields(kind)
    ]
    head = ["| Key | Type | Meaning | Absent: read as |", "| --- | --- | --- | --- |"]
    return "\n".join([*head, *rows])


def _type_name(hint: Any) -> str:
    if hint in _NAMES:
        return _NAMES[hint]
    if get_origin(hint) in (Union, types.UnionType):
        return " or ".join(_type_name(part) for part in get_args(hint))
    if get_origin(hint) is tuple:
        return f"list of: {_type_name(get_args(hint)[0])}"
    if get_origin(hint) is Mapping:
        return f"object of: {_type_name(get_args(hint)[1])}"
    if is_dataclass(hint):
        return f"[object](#{hint.__name__.lower()})"  # type: ignore[union-attr]
    assert issubclass(hint, StrEnum), hint
    return ", ".join(f"`{member}`" for member in hint)


def _meaning(kind: type, name: str) -> str:
    """What the docstring of a class says of an attribute, on one line."""
    text = inspect.getdoc(kind) or ""
    found = re.search(rf"^( *){name}: (.*(?:\n\1 +\S.*)*)", text, re.MULTILINE)
    assert found, f"the docstring of {kind.__name__} says nothing of {name}"
    told = " ".join(found[2].split())
    return told.replace("``", "`").replace("|", "\\|").replace("None", "null")


def _absent(field: Field[Any]) -> str:
    if field.default is not MISSING:
        value = field.default
    elif field.default_factory is not MISSING:
        value = field.default_factory()
    else:
        return "never absent"
    return f"`{json.dumps(value)}`"


if __name__ == "__main__":
    PAGE.write_text(page_with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
