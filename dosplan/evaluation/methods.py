"""What is evaluated: predictors with their options, from a YAML file or by name.

A file holds a list; ``options`` are those of the predictor, as ``dosplan run --set`` takes them::

    - label: circle v1 z=0.7
      predictor: growing-circle
      options: {z: 0.7, base: {predictor: constant-turn-rate}}
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from dosplan.api import Predictor
from dosplan.evaluation.windows import STEPS
from dosplan.plugins.registry import RegistryError, choose_predictor, create_predictor, record
from dosplan.simulation.settings import IDEAL, LoopSettings
from dosplan.system.errors import DosplanError, did_you_mean
from dosplan.system.yaml_text import YamlError, read_yaml

_KEYS: Final = ("label", "predictor", "options")


class MethodError(DosplanError, ValueError):
    """A method that cannot be evaluated as it is written down; the message is one line."""


@dataclass(frozen=True)
class Method:
    """A predictor under the name it has in the tables.

    Attributes:
        label: That name.
        predictor: The predictor, as ``dosplan.plugins.registry`` finds it.
        options: Its options: numbers, texts, lists and mappings.
    """

    label: str
    predictor: str
    options: Mapping[str, Any] = field(default_factory=dict)


def read_methods(path: Path) -> list[Method]:
    """Reads a file of methods.

    Args:
        path: The YAML file.

    Returns:
        The methods, in its order.

    Raises:
        MethodError: It cannot be read or is not such a list.
    """
    try:
        content = read_yaml(path)
    except YamlError as error:
        raise MethodError(str(error)) from None
    if not isinstance(content, list) or not content:
        raise MethodError(f"{path}: expected a list of methods, each with {', '.join(_KEYS)}")
    return [_method(entry, f"{path}: method {i}") for i, entry in enumerate(content, start=1)]


def check_labels(methods: Sequence[Method]) -> None:
    """Refuses two methods with one label, which a table could not tell apart.

    Args:
        methods: All that are to be evaluated.

    Raises:
        MethodError: There are none, or a label is there twice.
    """
    if not methods:
        raise MethodError("nothing to evaluate; name a --methods file or a --predictor")
    label, count = Counter(method.label for method in methods).most_common(1)[0]
    if count > 1:
        raise MethodError(f"{count} methods have the label {label!r}; give each its own")


def build(method: Method, seed: int, loop: LoopSettings = IDEAL) -> Predictor:
    """Makes the predictor of a method.

    Args:
        method: The method.
        seed: Seed of the run.
        loop: The loop that it is to predict in.

    Returns:
        The predictor.

    Raises:
        MethodError: It cannot be built, or does not predict far enough.
    """
    try:
        predictor = create_predictor(method.predictor, seed, method.options, loop)
    except RegistryError as error:
        raise MethodError(f"method {method.label!r}: {error}") from error
    if predictor.horizon < STEPS:
        raise MethodError(
            f"method {method.label!r} predicts {predictor.horizon} steps; "
            f"give it a horizon of {STEPS}"
        )
    return predictor


def settings(method: Method, loop: LoopSettings = IDEAL) -> dict[str, Any]:
    """All settings of a method's predictor, defaults included.

    Args:
        method: The method.
        loop: The loop that it is to predict in.

    Returns:
        What JSON can hold.

    Raises:
        RegistryError: There is no such predictor, or an option is wrong.
    """
    return record(choose_predictor(method.predictor, method.options, loop))


def _method(entry: Any, where: str) -> Method:
    if not isinstance(entry, Mapping):
        raise MethodError(f"{where} is no mapping of {', '.join(_KEYS)}")
    for key in entry:
        if key not in _KEYS:
            raise MethodError(
                f"{where} has the unknown key {key!r}{did_you_mean(str(key), _KEYS)} "
                f"(keys: {', '.join(_KEYS)})"
            )
    spec, options = entry.get("predictor"), entry.get("options")
    if not isinstance(spec, str) or not spec:
        raise MethodError(f"{where} names no predictor; give one of `dosplan list predictors`")
    options = {} if options is None else options
    if not isinstance(options, Mapping) or not all(isinstance(key, str) for key in options):
        raise MethodError(f"{where}: options is no mapping of names to values")
    label = entry.get("label")
    if not isinstance(label, str) or not label:
        raise MethodError(f"{where} has no label; give it a text")
    try:
        json.dumps(options, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise MethodError(
            f"{where} ({label}): options must be finite numbers, texts, lists and mappings: {error}"
        ) from None
    return Method(label, spec, options)
