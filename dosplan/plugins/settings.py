"""Settings of a plug-in: from the options that a user wrote, and back to plain values.

Options are a mapping as YAML or JSON can hold it. A name may be dotted to reach into a part of the
settings: into a dataclass, or into the settings of another plug-in::

    {"z": 0.7, "base": "constant-turn-rate", "base.horizon": 50}
    {"z": 0.7, "base": {"predictor": "constant-turn-rate", "options": {"horizon": 50}}}
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

import msgspec

from dosplan.api import OraclePredictor, PluginSpec
from dosplan.system.errors import DosplanError, did_you_mean, one_line

Finder = Callable[[type[Any], str], type[Any]]
"""From ``Planner`` or ``Predictor`` and the name of a plug-in to its class."""

_EXPONENT: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")
"""Numbers such as 1e-3, which YAML takes for texts."""
_SHOWN: Final = 60
"""Characters of a wrong value that are shown."""


HOW_OPTIONS: Final = (
    "Options are the fields of a frozen dataclass, which the class names: settings = MySettings"
)
"""What to do about a plug-in whose options are declared otherwise."""


class SettingsError(DosplanError, ValueError):
    """An option that a plug-in does not take; the message is one line."""


def _no_plugins(base: type[Any], name: str) -> type[Any]:
    raise SettingsError(f"takes no {_word(base)} ({name!r})")


def apply_options(
    settings: Any, options: Mapping[str, Any], find: Finder = _no_plugins, inside: str = ""
) -> Any:
    """Changes settings as options say; every value is checked against its field's type.

    Args:
        settings: An instance of a frozen dataclass.
        options: New values by name.
        find: Finds the plug-ins that options name.
        inside: Dotted name of the settings within those of the outermost plug-in, with its last
            dot; it begins the names in messages.

    Returns:
        The changed settings.

    Raises:
        SettingsError: There is no such option, or its value has another type or is out of range.
        TypeError: The settings are no dataclass, or a type of theirs cannot be set.
    """
    try:
        hints = get_type_hints(type(settings))
    except Exception as error:  # Annotations may name something undefined.
        raise TypeError(f"types of {type(settings).__name__}: {one_line(error)}") from error
    taken = sorted(field.name for field in fields(settings) if field.init)
    own: dict[str, Any] = {}
    parts: dict[str, dict[str, Any]] = {}
    for name, value in options.items():
        head, dot, rest = name.partition(".")
        if head not in taken:
            raise SettingsError(
                f"takes no option {inside + head!r}{did_you_mean(head, taken)} "
                f"(options: {', '.join(inside + name for name in taken) or f'none. {HOW_OPTIONS}'})"
            )
        if dot:
            parts.setdefault(head, {})[rest] = value
        else:
            own[head] = value
    changes = {
        name: _changed(
            getattr(settings, name),
            hints[name],
            own.get(name, MISSING),
            parts.get(name, {}),
            find,
            inside + name,
        )
        for name in (*own, *(name for name in parts if name not in own))
    }
    try:
        return replace(settings, **changes)
    except ValueError as error:
        where = f"option {inside[:-1]!r}: " if inside else ""
        raise SettingsError(f"{where}{error}") from error


def _changed(
    present: Any, hint: Any, value: Any, parts: Mapping[str, Any], find: Finder, name: str
) -> Any:
    """A field's new value: ``value`` where one is given, with ``parts`` of it changed."""
    base = _plugin_kind(hint)
    if base is not None:
        if value is not MISSING and value is not None:
            present = _named_plugin(value, base, find, name)
        elif value is None:
            present = _plain_value(None, hint, name)
        if not parts:
            return present
        if present is None:
            raise SettingsError(f"option {name!r} names no {_word(base)}; set {name}=NAME as well")
        return PluginSpec(present.plugin, apply_options(present.settings, parts, find, f"{name}."))
    if is_dataclass(present):
        if value is not MISSING and not isinstance(value, Mapping):
            raise SettingsError(f"option {name!r} is {_show(value)}, expected a mapping")
        whole = {} if value is MISSING else _text_keys(value, name)
        return apply_options(present, {**whole, **parts}, find, f"{name}.")
    named = get_args(hint)[1] if get_origin(hint) is dict else None
    if is_dataclass(named) and isinstance(named, type) and isinstance(value, Mapping):
        return {
            key: _changed(named(), named, part, {}, find, f"{name}.{key}")
            for key, part in _text_keys(value, name).items()
        }
    if parts:
        raise SettingsError(f"takes no option {f'{name}.{next(iter(parts))}'!r}")
    return _plain_value(value, hint, name)


def _plugin_kind(hint: Any) -> type[Any] | None:
    """``Predictor`` for the type ``PluginSpec[Predictor] | None``; None for other types."""
    options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    found = [option for option in options if get_origin(option) is PluginSpec]
    if not found or any(option not in (*found, NoneType) for option in options):
        return None
    kind: type[Any] = get_args(found[0])[0]
    return kind


def _named_plugin(value: Any, base: type[Any], find: Finder, name: str) -> PluginSpec[Any]:
    """The plug-in of ``NAME`` or of ``{predictor: NAME, options: {...}}``."""
    word = _word(base)
    options: Any = {}
    keys = (word, "options")
    if isinstance(value, Mapping):
        for key in _text_keys(value, name):
            if key not in keys:
                raise SettingsError(
                    f"option {name!r} has the unknown key {key!r}{did_you_mean(key, keys)} "
                    f"(keys: {', '.join(keys)})"
                )
        value, options = value.get(word), value.get("options") or {}
        if not isinstance(options, Mapping):
            raise SettingsError(f"option {name!r}: options is no mapping of names to values")
    if not isinstance(value, str) or not value:
        raise SettingsError(
            f"option {name!r} names no {word}; give a name of `dosplan list {word}s`"
        )
    plugin = find(base, value)
    if issubclass(plugin, OraclePredictor):
        raise SettingsError(
            f"option {name!r}: {plugin.name} is shown the future, and only by itself"
        )
    return PluginSpec(
        plugin, apply_options(plugin.settings(), _text_keys(options, name), find, f"{name}.")
    )


def _word(base: type[Any]) -> str:
    return base.__name__.lower()


def _text_keys(value: Mapping[Any, Any], name: str) -> Mapping[str, Any]:
    if not all(isinstance(key, str) for key in value):
        raise SettingsError(f"option {name!r} is no mapping of names to values")
    return value


def _plain_value(value: Any, hint: Any, name: str) -> Any:
    def refuse(wanted: str) -> SettingsError:
        return SettingsError(f"option {name!r} is {_show(value)}, expected {wanted}")

    if isinstance(value, str) and _EXPONENT.fullmatch(value) and _takes(hint, float):
        value = float(value)
    if isinstance(hint, type) and issubclass(hint, Enum) and value not in [m.value for m in hint]:
        raise refuse(" or ".join(repr(member.value) for member in hint))
    try:
        found = msgspec.convert(value, hint, strict=True, dec_hook=_own_type)
    except UnicodeError:
        raise refuse("a text that can be written down") from None
    except msgspec.ValidationError as error:
        wanted = str(error).removeprefix("Expected ").partition(", got ")[0]
        raise refuse(wanted.replace("`", "").replace("null", "None")) from None
    if isinstance(found, float) and not math.isfinite(found):
        raise refuse("a finite number")
    return found


def _own_type(kind: type[Any], value: Any) -> Any:
    """For ``msgspec``: paths, which are texts."""
    if issubclass(kind, Path):
        if isinstance(value, str) and value:
            return kind(value)
        raise ValueError("Expected a path")
    raise TypeError(f"a setting of the type {kind.__name__} cannot be set")


def _takes(hint: Any, kind: type[Any]) -> bool:
    """Whether values of a type may be of that kind, but no texts."""
    options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    return kind in options and str not in options


def _show(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]} ..."


def plain_settings(
    settings: Any,
    target: Callable[[type[Any]], tuple[str, str]],
    path: Callable[[Path], Path] = lambda path: path,
) -> dict[str, Any]:
    """Writes settings as values that JSON can hold; ``apply_options`` gives them back.

    Args:
        settings: An instance of a frozen dataclass.
        target: From the class of a plug-in to what it is, ``predictor`` or ``planner``, and to the
            name by which it is found.
        path: What is done to a path before it is written.

    Returns:
        All of its fields.

    Raises:
        TypeError: A field holds something else than numbers, texts, lists and mappings, or a
            number that is not finite.
    """

    def plain(value: Any, name: str) -> Any:
        if isinstance(value, PluginSpec):
            word, found = target(value.plugin)
            return {word: found, "options": plain(value.settings, name)}
        if is_dataclass(value) and not isinstance(value, type):
            return {
                field.name: plain(getattr(value, field.name), f"{name}.{field.name}".strip("."))
                for field in fields(value)
                if field.init
            }
        if isinstance(value, Enum):
            return plain(value.value, name)
        if isinstance(value, Path):
            return str(path(value))
        if isinstance(value, Mapping):
            return {str(key): plain(part, f"{name}.{key}") for key, part in value.items()}
        if isinstance(value, list | tuple):
            return [plain(part, name) for part in value]
        if isinstance(value, float) and not math.isfinite(value):
            raise TypeError(f"{name} is {value}; write None where there is no limit")
        if value is None or isinstance(value, str | int | float):
            return value
        raise TypeError(f"{name} is a {type(value).__name__}, which run.json cannot hold")

    found: dict[str, Any] = plain(settings, "")
    return found
