"""Finds plug-ins: by entry-point name, as ``module:Class`` or as ``path/to/file.py:Class``.

Listing reads the metadata of installed distributions only; a plug-in is imported when it is
named, so that a broken or heavy one costs those who do not use it nothing.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from enum import Enum
from hashlib import sha256
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from dosplan.api import Planner, Predictor
from dosplan.system.errors import DosplanError, did_you_mean, one_line


class RegistryError(DosplanError, ValueError):
    """A plug-in that cannot be found, loaded or built; the message is one line."""


class PluginKind(Enum):
    """What can be plugged in: the word for messages, the entry-point group and the base class."""

    PLANNER = ("planner", "dosplan.planners", Planner)
    PREDICTOR = ("predictor", "dosplan.predictors", Predictor)

    def __init__(self, word: str, group: str, base: type[Any]) -> None:
        self.word = word
        self.group = group
        self.base = base


@dataclass(frozen=True)
class PluginInfo:
    """An installed plug-in, as its distribution announces it.

    Attributes:
        name: The name to call it by.
        target: ``module:Class``.
        distribution: The distribution that offers it.
    """

    name: str
    target: str
    distribution: str


def list_plugins(kind: PluginKind) -> list[PluginInfo]:
    """Lists the installed plug-ins by name, without importing any.

    Args:
        kind: Planners or predictors.

    Returns:
        One entry per offer; a name that two distributions offer appears twice.
    """
    offers = [PluginInfo(e.name, e.value, _distribution(e)) for e in entry_points(group=kind.group)]
    return sorted(offers, key=lambda offer: (offer.name, offer.distribution))


def find_planner(spec: str, options: Collection[str] = ()) -> type[Planner]:
    """Imports the planner that ``spec`` names.

    Args:
        spec: Entry-point name, ``module:Class`` or ``path/to/file.py:Class``.
        options: Names of further keyword arguments that its constructor has to take.

    Returns:
        Its class.

    Raises:
        RegistryError: There is no such planner, two distributions offer it, its import fails, it
            is not a complete ``Planner`` or takes no such option.
    """
    found: type[Planner] = _find(spec, PluginKind.PLANNER, options)
    return found


def find_predictor(spec: str, options: Collection[str] = ()) -> type[Predictor]:
    """Imports the predictor that ``spec`` names.

    Args:
        spec: Entry-point name, ``module:Class`` or ``path/to/file.py:Class``.
        options: Names of further keyword arguments that its constructor has to take.

    Returns:
        Its class.

    Raises:
        RegistryError: As for ``find_planner``.
    """
    found: type[Predictor] = _find(spec, PluginKind.PREDICTOR, options)
    return found


def create_planner(
    spec: str, seed: int, options: Mapping[str, object] = MappingProxyType({})
) -> Planner:
    """Builds the planner that ``spec`` names.

    Args:
        spec: As for ``find_planner``.
        seed: Seed of the run.
        options: Further keyword arguments of its constructor.

    Returns:
        The planner.

    Raises:
        RegistryError: It cannot be found, takes no such option or its constructor raises.
    """
    planner: Planner = _create(spec, seed, options, PluginKind.PLANNER)
    return planner


def create_predictor(
    spec: str, seed: int, options: Mapping[str, object] = MappingProxyType({})
) -> Predictor:
    """Builds the predictor that ``spec`` names.

    Args:
        spec: As for ``find_predictor``.
        seed: Seed of the run.
        options: Further keyword arguments of its constructor.

    Returns:
        The predictor.

    Raises:
        RegistryError: It cannot be found, takes no such option or its constructor raises.
    """
    predictor: Predictor = _create(spec, seed, options, PluginKind.PREDICTOR)
    return predictor


def source_files(spec: str) -> list[Path]:
    """Names the file of a plug-in that is given by one.

    Args:
        spec: As for ``find_planner``.

    Returns:
        The file of ``path/to/file.py:Class``; nothing for what is installed.
    """
    location = spec.rpartition(":")[0]
    return [Path(location)] if location.endswith(".py") else []


def _distribution(entry_point: EntryPoint) -> str:
    return entry_point.dist.name if entry_point.dist is not None else "unknown"


def _find(spec: str, kind: PluginKind, options: Collection[str]) -> Any:
    target = spec if ":" in spec else _installed(spec, kind)
    location, _, attribute = target.rpartition(":")
    if not location or not attribute:
        raise RegistryError(
            f"{kind.word} {spec!r}: expected a name, module:Class or path/to/file.py:Class"
        )
    try:
        module = (
            _load_file(location) if location.endswith(".py") else importlib.import_module(location)
        )
        found = getattr(module, attribute, None)  # A module may have its own way to answer this.
    except (Exception, SystemExit) as error:  # A plug-in's import may raise anything.
        raise RegistryError(
            f"{kind.word} {spec!r} cannot be imported: {one_line(error)}"
        ) from error
    if found is None:
        names = [name for name, value in vars(module).items() if _is_plugin(value, kind)]
        hint = did_you_mean(attribute, names)
        raise RegistryError(f"{kind.word} {spec!r}: {location} has no {attribute}{hint}")
    _check_class(found, spec, kind)
    _check_options(found, options, spec, kind)
    return found


def _installed(name: str, kind: PluginKind) -> str:
    offers = [offer for offer in list_plugins(kind) if offer.name == name]
    if not offers:
        names = [offer.name for offer in list_plugins(kind)]
        raise RegistryError(
            f"no {kind.word} is called {name!r}{did_you_mean(name, names)}; "
            f"`dosplan list {kind.word}s` shows them all"
        )
    if len(offers) > 1:
        givers = ", ".join(f"{offer.target} from {offer.distribution}" for offer in offers)
        raise RegistryError(
            f"{kind.word} {name!r} is offered {len(offers)} times ({givers}); "
            "uninstall all but one or name it as module:Class"
        )
    return offers[0].target


def _load_file(path: str) -> ModuleType:
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    digest = sha256(str(file.resolve()).encode()).hexdigest()[:12]
    name = f"dosplan_plugin_{file.stem}_{digest}"
    module_spec = importlib.util.spec_from_file_location(name, file)
    if module_spec is None or module_spec.loader is None:
        raise ImportError(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(module_spec)
    sys.modules[name] = module  # dataclasses and pickle look a class's module up here.
    try:
        module_spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _is_plugin(value: object, kind: PluginKind) -> bool:
    return inspect.isclass(value) and issubclass(value, kind.base) and value is not kind.base


def _check_class(found: object, spec: str, kind: PluginKind) -> None:
    base = kind.base.__name__
    if not _is_plugin(found, kind):
        raise RegistryError(f"{kind.word} {spec!r} is not a subclass of dosplan.api.{base}")
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    if missing:
        raise RegistryError(f"{kind.word} {spec!r} does not implement {', '.join(missing)}")
    if not isinstance(getattr(found, "name", None), str):
        raise RegistryError(
            f"{kind.word} {spec!r} has no name; give its class a versioned one, "
            f'such as name = "my-{kind.word}-v1"'
        )


def _check_options(found: Any, options: Collection[str], spec: str, kind: PluginKind) -> None:
    try:
        taken = _options(found)
    except (TypeError, ValueError) as error:  # Settings or a constructor that are none.
        raise RegistryError(
            f"{kind.word} {spec!r} does not tell its options: {one_line(error)}"
        ) from error
    for name in options:
        if taken is not None and name not in taken:
            raise RegistryError(
                f"{kind.word} {spec!r} takes no option {name!r}{did_you_mean(name, taken)} "
                f"(options: {', '.join(taken) or 'none'})"
            )


def _create(spec: str, seed: int, options: Mapping[str, object], kind: PluginKind) -> Any:
    found = _find(spec, kind, options)
    try:
        if found.settings is not None:
            return found(seed=seed, settings=_settings(found.settings, options))
        return found(seed=seed, **options)
    except (Exception, SystemExit) as error:  # A plug-in's constructor may raise anything.
        raise RegistryError(f"{kind.word} {spec!r} cannot be built: {one_line(error)}") from error


def _settings(kind: type[Any], options: Mapping[str, object]) -> Any:
    """The plug-in's dataclass with these values, checked against its types."""
    import dacite  # Only for plug-ins with settings.

    config = dacite.Config(strict=True, type_hooks={float: _number})
    try:
        return dacite.from_dict(kind, options, config)
    except dacite.WrongTypeError as error:
        raise ValueError(
            f"option {error.field_path} is {error.value!r}, expected {error.field_type.__name__}"
        ) from None


def _number(value: object) -> object:
    """An integer where a float is wanted is one."""
    return float(value) if type(value) is int else value


def _options(plugin: type[Any]) -> list[str] | None:
    """Names of the options a class can be built with besides the seed.

    They are the fields of its settings or the keyword arguments of its constructor, and of the
    next class's where that hands ``**options`` on.

    Returns:
        The names, sorted; None where the constructors do not say.
    """
    if plugin.settings is not None:
        return sorted(field.name for field in fields(plugin.settings))
    names: set[str] = set()
    for owner in plugin.__mro__:
        if "__init__" not in vars(owner) or owner is object:
            continue
        parameters = list(inspect.signature(vars(owner)["__init__"]).parameters.values())[1:]
        names |= {p.name for p in parameters if p.kind in (p.KEYWORD_ONLY, p.POSITIONAL_OR_KEYWORD)}
        if not any(p.kind is p.VAR_KEYWORD for p in parameters):
            return sorted(names - {"seed"})
    return None
