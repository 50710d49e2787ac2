"""Comparing figures that another machine computed."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import pytest


def assert_close(found: Any, published: Any) -> None:
    """Asserts that nested values are the same, but for the last digits of floats.

    Processors and versions of numpy do not all round sums alike.

    Args:
        found: Dictionaries, lists and dataclasses of values, computed here.
        published: The same, computed elsewhere.
    """
    if is_dataclass(published) and not isinstance(published, type):
        assert type(found) is type(published)
        for field in fields(published):
            assert_close(getattr(found, field.name), getattr(published, field.name))
    elif isinstance(published, dict):
        assert list(found) == list(published)
        for key, value in published.items():
            assert_close(found[key], value)
    elif isinstance(published, (list, tuple)):
        assert len(found) == len(published)
        for pair in zip(found, published, strict=True):
            assert_close(*pair)
    elif isinstance(published, float):
        assert found == pytest.approx(published, rel=1e-9, abs=1e-12)
    else:
        assert found == published
