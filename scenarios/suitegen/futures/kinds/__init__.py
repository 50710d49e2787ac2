"""The kinds of scenes, a module for a few of them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from types import MappingProxyType

from suitegen.futures.staging import Kind

from . import crossings, entering, following, lanes, passing, people

MODULES = (following, lanes, passing, entering, crossings, people)
KINDS: Mapping[str, Kind] = MappingProxyType(
    {kind.code: kind for kind in chain.from_iterable(module.KINDS for module in MODULES)}
)
"""All kinds by their codes."""
