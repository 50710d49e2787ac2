"""Finds plug-ins, reads their options and builds them.

A plug-in is named by its entry point, as ``module:Class`` or as ``path/to/file.py:Class``. Listing
reads the metadata of installed distributions only; a plug-in is imported when it is named, so that
a broken or heavy one has no effect on those who do not use it.
"""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any, Final

from dosplan.api import (
    DeadlineSettings,
    NoSettings,
    Planner,
    PluginSpec,
    Predictor,
    PredictorSettings,
)
from dosplan.plugins.files import load_file, loaded_file, local_modules
from dosplan.plugins.settings import (
    HOW_OPTIONS,
    SettingsError,
    apply_options,
    plain_settings,
)
from dosplan.simulation.settings import LoopSettings
from dosplan.simulation.traffic import Traffic
from dosplan.system.errors import DosplanError, did_you_mean, failure_place, one_line
from dosplan.system.folders import folder_kept

_NO_OPTIONS: Final[Mapping[str, object]] = MappingProxyType({})
_PLANNERS_SHARE: Final = 0.8  # Of the loop's period; the rest is the predictor's.


class RegistryError(DosplanError, ValueError):
    """A plug-in that cannot be found, loaded or built; the message is one line."""


class OtherKindError(RegistryError):
    """What is named is no plug-in of the kind that is looked for; it may be one of another."""


class PluginKind(Enum):
    """What can be plugged in: the word for one and for many, and the base class."""

    PLANNER = ("planner", "planners", Planner)
    PREDICTOR = ("predictor", "predictors", Predictor)
    TRAFFIC = ("traffic", "traffic", Traffic)

    def __init__(self, word: str, plural: str, base: type[Any]) -> None:
        self.word = word
        self.plural = plural
        self.base = base

    @property
    def group(self) -> str:
        """The group of its entry points."""
        return f"dosplan.{self.plural}"


@dataclass(frozen=True)
class PluginInfo:
    """An installed plug-in, as its distribution declares it.

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
        kind: Planners, predictors or traffic.

    Returns:
        One entry per offer; a name that two distributions offer appears twice.
    """
    offers = [PluginInfo(e.name, e.value, _distribution(e)) for e in entry_points(group=kind.group)]
    return sorted(offers, key=lambda offer: (offer.name, offer.distribution))


def find_planner(spec: str) -> type[Planner]:
    """Imports the planner that ``spec`` names.

    Args:
        spec: Entry-point name, ``module:Class`` or ``path/to/file.py:Class``.

    Returns:
        Its class.

    Raises:
        RegistryError: There is no such planner, two distributions offer it, its import fails, or
            it is not a complete ``Planner``.
    """
    found: type[Planner] = find_plugin(PluginKind.PLANNER, spec)
    return found


def find_predictor(spec: str) -> type[Predictor]:
    """Imports the predictor that ``spec`` names.

    Args:
        spec: Entry-point name, ``module:Class`` or ``path/to/file.py:Class``.

    Returns:
        Its class.

    Raises:
        RegistryError: As for ``find_planner``.
    """
    found: type[Predictor] = find_plugin(PluginKind.PREDICTOR, spec)
    return found


def choose_planner(
    spec: str, options: Mapping[str, object] = _NO_OPTIONS, loop: LoopSettings | None = None
) -> PluginSpec[Planner]:
    """Finds a planner and checks its options, without building it.

    Args:
        spec: As for ``find_planner``.
        options: What its settings are to be, see ``dosplan.plugins.settings``.
        loop: The loop that it is to plan in: where that charges the time of plans, a planner that
            can keep a deadline and was given none gets a share of the period.

    Returns:
        Its class and settings.

    Raises:
        RegistryError: It cannot be found, takes no such option, or a value has another type or is
            out of range.
    """
    chosen: PluginSpec[Planner] = choose_plugin(PluginKind.PLANNER, spec, options)
    settings = chosen.settings
    if loop is None or not loop.real_time or not isinstance(settings, DeadlineSettings):
        return chosen
    if settings.deadline is None:
        settings = replace(settings, deadline=round(_PLANNERS_SHARE * loop.period, 3))
    return PluginSpec(chosen.plugin, settings)


def choose_predictor(
    spec: str, options: Mapping[str, object] = _NO_OPTIONS, loop: LoopSettings | None = None
) -> PluginSpec[Predictor]:
    """Finds a predictor and checks its options, without building it.

    Args:
        spec: As for ``find_predictor``.
        options: What its settings are to be, see ``dosplan.plugins.settings``.
        loop: The loop that it is to predict in: settings that are left to the loop, of the
            predictor and of those in its settings, get their values. None leaves them open.

    Returns:
        Its class and settings.

    Raises:
        RegistryError: As for ``choose_planner``.
    """
    chosen: PluginSpec[Predictor] = choose_plugin(PluginKind.PREDICTOR, spec, options)
    try:
        return chosen if loop is None else _settled(chosen, loop)
    except Exception as error:  # Settings of others may raise anything.
        raise RegistryError(
            f"{PluginKind.PREDICTOR.word} {spec!r}: its settings cannot be left to the loop: "
            f"{one_line(error)}"
        ) from error


def create_planner(
    spec: str,
    seed: int,
    options: Mapping[str, object] = _NO_OPTIONS,
    loop: LoopSettings | None = None,
) -> Planner:
    """Builds the planner that ``spec`` names.

    Args:
        spec: As for ``find_planner``.
        seed: Seed of the run.
        options: As for ``choose_planner``.
        loop: As for ``choose_planner``.

    Returns:
        The planner.

    Raises:
        RegistryError: As for ``choose_planner``, or its constructor raises.
    """
    planner: Planner = _built(choose_planner(spec, options, loop), PluginKind.PLANNER, spec, seed)
    return planner


def create_predictor(
    spec: str,
    seed: int,
    options: Mapping[str, object] = _NO_OPTIONS,
    loop: LoopSettings | None = None,
) -> Predictor:
    """Builds the predictor that ``spec`` names.

    Args:
        spec: As for ``find_predictor``.
        seed: Seed of the run.
        options: As for ``choose_predictor``.
        loop: As for ``choose_predictor``.

    Returns:
        The predictor.

    Raises:
        RegistryError: As for ``choose_predictor``, or its constructor raises.
    """
    predictor: Predictor = _built(
        choose_predictor(spec, options, loop), PluginKind.PREDICTOR, spec, seed
    )
    return predictor


def create_traffic(
    spec: str, seed: int, options: Mapping[str, object] = _NO_OPTIONS, *, future: int = 0
) -> Traffic:
    """Builds the traffic that ``spec`` names.

    Args:
        spec: As for ``find_planner``.
        seed: Seed of the run.
        options: As for ``choose_planner``.
        future: Which continuation of the same past it drives, 0 or more.

    Returns:
        The traffic.

    Raises:
        RegistryError: As for ``choose_planner``, or its constructor raises.
    """
    traffic: Traffic = create_plugin(PluginKind.TRAFFIC, spec, seed, options, future=future)
    return traffic


def find_plugin(kind: PluginKind, spec: str) -> Any:
    """Imports a plug-in; as ``find_planner``, of any kind."""
    in_a_place = ":" in spec or spec.endswith(".py")
    target = spec if in_a_place else _installed(spec, kind)
    location, _, attribute = target.rpartition(":")
    if target.endswith(".py"):
        location, attribute = target, ""
    elif not location or not attribute:
        raise RegistryError(
            f"{kind.word} {spec!r}: expected a name, module:Class or path/to/file.py:Class"
        )
    try:
        # What it prints does not belong to stdout, and where it goes is nobody else's matter.
        with redirect_stdout(sys.stderr), folder_kept():
            module = (
                load_file(location, _shared_packages())
                if location.endswith(".py")
                else importlib.import_module(location)
            )
        found = getattr(module, attribute, None)  # A module may define __getattr__.
    except (Exception, SystemExit) as error:  # A plug-in's import may raise anything.
        raise RegistryError(
            f"{kind.word} {spec!r} cannot be imported: {one_line(error)}"
        ) from error
    if found is None:
        raise _missing(module, location, attribute, kind)
    _check_class(found, spec, kind)
    return found


def choose_plugin(
    kind: PluginKind, spec: str, options: Mapping[str, object] = _NO_OPTIONS
) -> PluginSpec[Any]:
    """Finds a plug-in and checks its options; as ``choose_planner``, of any kind."""
    found = find_plugin(kind, spec)
    try:
        settings = apply_options(found.settings(), options, _find_nested)
        record(PluginSpec(found, settings))
    except SettingsError as error:
        raise RegistryError(f"{kind.word} {spec!r}: {error}") from None
    except RegistryError as error:  # Of a plug-in that an option names.
        raise RegistryError(f"{kind.word} {spec!r}: {error}") from error
    except (Exception, SystemExit) as error:
        raise RegistryError(
            f"{kind.word} {spec!r}: its settings cannot be read: {one_line(error)}"
        ) from error
    return PluginSpec(found, settings)


def create_plugin(
    kind: PluginKind,
    spec: str,
    seed: int,
    options: Mapping[str, object] = _NO_OPTIONS,
    **others: int,
) -> Any:
    """Builds a plug-in; as ``create_planner``, of any kind; ``others`` go to its constructor."""
    return _built(choose_plugin(kind, spec, options), kind, spec, seed, **others)


def _built(chosen: PluginSpec[Any], kind: PluginKind, spec: str, seed: int, **others: int) -> Any:
    named = {"seed": seed, "settings": chosen.settings, **others}
    try:
        with redirect_stdout(sys.stderr):  # As where it is imported.
            return chosen.build(seed, **others)
    except (Exception, SystemExit) as error:  # A plug-in's constructor may raise anything.
        place = failure_place(error, chosen.plugin)
        hint = ""
        if not _can_take(chosen.plugin, named):
            hint = f"; its constructor must take {', '.join(named)}. {HOW_OPTIONS}"
        elif NoSettings.__name__ in str(error):
            hint = f". {HOW_OPTIONS}"
        raise RegistryError(
            f"{kind.word} {spec!r} cannot be built: {one_line(error)} ({place}){hint}"
        ) from error


def _can_take(constructor: Any, named: Mapping[str, object]) -> bool:
    """Whether arguments can be given; true where the constructor does not tell what it takes."""
    try:
        signature = inspect.signature(constructor)
    except (TypeError, ValueError):
        return True
    try:
        signature.bind(**named)
    except TypeError:
        return False
    return True


def record(chosen: PluginSpec[Any]) -> dict[str, Any]:
    """Writes down all settings of a plug-in, and of the plug-ins in them.

    Args:
        chosen: The plug-in.

    Returns:
        What JSON can hold; as options of the plug-in, it gives the same settings.
    """
    return plain_settings(chosen.settings, lambda plugin: (_kind_of(plugin).word, target(plugin)))


def portable_options(chosen: PluginSpec[Any]) -> dict[str, Any]:
    """Writes settings so that they mean the same in another folder of the file system.

    Args:
        chosen: The plug-in.

    Returns:
        As ``record``, with absolute paths.
    """
    return plain_settings(
        chosen.settings,
        lambda plugin: (_kind_of(plugin).word, target(plugin)),
        lambda path: path.absolute(),
    )


def target(plugin: type[Any]) -> str:
    """The name by which a plug-in is found, in another process as well.

    Args:
        plugin: Its class.

    Returns:
        Its entry point, ``file.py:Class`` or ``module:Class``.
    """
    file = loaded_file(plugin)
    if file is not None:
        return f"{file}:{plugin.__qualname__}"
    found = f"{plugin.__module__}:{plugin.__qualname__}"
    offers = list_plugins(_kind_of(plugin))
    return next((offer.name for offer in offers if offer.target == found), found)


def source_files(chosen: PluginSpec[Any]) -> list[Path]:
    """Names the files that a plug-in consists of where it is given by a file.

    Args:
        chosen: The plug-in.

    Returns:
        Its file and the modules beside it that it imports, and those of the plug-ins in its
        settings; nothing for what is installed.
    """
    files: list[Path] = []
    file = loaded_file(chosen.plugin)
    if file is not None:
        files += local_modules(file, _shared_packages())
    for nested in _nested(chosen.settings):
        files += source_files(nested)
    return files


def _nested(settings: Any) -> list[PluginSpec[Any]]:
    """The plug-ins in settings, in the order of their fields."""
    found: list[PluginSpec[Any]] = []
    for field in fields(settings):
        value = getattr(settings, field.name)
        if isinstance(value, PluginSpec):
            found.append(value)
        elif is_dataclass(value):
            found += _nested(value)
    return found


def _settled(chosen: PluginSpec[Predictor], loop: LoopSettings) -> PluginSpec[Predictor]:
    """A predictor whose settings, and those of predictors in them, are those for a loop."""
    settings = chosen.settings
    nested = {
        field.name: _settled(value, loop)
        for field in fields(settings)
        if isinstance(value := getattr(settings, field.name), PluginSpec)
        and issubclass(value.plugin, Predictor)
    }
    if nested:
        settings = replace(settings, **nested)
    return PluginSpec(chosen.plugin, settings.seen_by(exact=not loop.sensing.errs))


def _find_nested(base: type[Any], name: str) -> type[Any]:
    found: type[Any] = find_plugin(next(kind for kind in PluginKind if kind.base is base), name)
    return found


def _kind_of(plugin: type[Any]) -> PluginKind:
    return next(kind for kind in PluginKind if issubclass(plugin, kind.base))


def _shared_packages() -> frozenset[str]:
    """Packages that a file imports as installed, whatever lies beside it."""
    offers = (offer.target for kind in PluginKind for offer in list_plugins(kind))
    return frozenset({"dosplan", *(target.partition(".")[0] for target in offers)})


def _distribution(entry_point: EntryPoint) -> str:
    return entry_point.dist.name if entry_point.dist is not None else "unknown"


def _installed(name: str, kind: PluginKind) -> str:
    offers = [offer for offer in list_plugins(kind) if offer.name == name]
    if not offers:
        names = [offer.name for offer in list_plugins(kind)]
        raise RegistryError(
            f"no {kind.word} is called {name!r}{did_you_mean(name, names)}; "
            f"`dosplan list {kind.plural}` shows them all, FILE.py:CLASS is one of your own"
        )
    if len(offers) > 1:
        givers = ", ".join(f"{offer.target} from {offer.distribution}" for offer in offers)
        raise RegistryError(
            f"{kind.word} {name!r} is offered {len(offers)} times ({givers}); "
            "uninstall all but one or name it as module:Class"
        )
    return offers[0].target


def _missing(module: ModuleType, location: str, attribute: str, kind: PluginKind) -> RegistryError:
    """A class that a module does not have, or that was not named."""
    names = [
        name
        for name, value in vars(module).items()
        if _is_plugin(value, kind) and not inspect.isabstract(value)
    ]
    if not attribute:
        message = f"{location}: name the class, too, as {location}:{(*names, 'Class')[0]}"
    else:
        hint = did_you_mean(attribute, names) or (names and f"; it has {', '.join(names)}") or ""
        message = f"{location} has no {attribute}{hint}"
    return RegistryError(message) if names else OtherKindError(message)


def _is_plugin(value: object, kind: PluginKind) -> bool:
    return inspect.isclass(value) and issubclass(value, kind.base) and value is not kind.base


def _check_class(found: object, spec: str, kind: PluginKind) -> None:
    if not _is_plugin(found, kind):
        base = f"{kind.base.__module__}.{kind.base.__name__}"
        raise OtherKindError(f"{kind.word} {spec!r} is not a subclass of {base}")
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    if missing:
        raise RegistryError(f"{kind.word} {spec!r} does not implement {', '.join(missing)}")
    if not isinstance(getattr(found, "name", None), str):
        raise RegistryError(
            f"{kind.word} {spec!r} has no name; give its class a versioned one, "
            f'such as name = "my-{kind.word}-v1"'
        )
    try:
        problem = _objection(getattr(found, "settings", None), kind)
    except Exception as error:  # Its constructor may raise anything.
        problem = f"cannot be made without arguments ({one_line(error)})"
    if problem:
        raise RegistryError(f"{kind.word} {spec!r}: its settings {problem}")


def _objection(settings: Any, kind: PluginKind) -> str:
    """What is wrong with a class of settings; empty where nothing is."""
    if not inspect.isclass(settings) or not is_dataclass(settings):
        return f"are {settings!r}, expected a frozen dataclass"
    if not vars(settings)["__dataclass_params__"].frozen:
        return f"can be changed; write @dataclass(frozen=True) before {settings.__name__}"
    if kind is PluginKind.PREDICTOR and not issubclass(settings, PredictorSettings):
        return f"must have a horizon; let {settings.__name__} inherit from PredictorSettings"
    settings()
    return ""
