"""Loops by name, with options of their settings, as plug-ins are chosen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dosplan.plugins.settings import SettingsError, apply_options, plain_settings
from dosplan.simulation.settings import LOOPS, LoopSettings
from dosplan.system.errors import did_you_mean


def choose_loop(name: str, options: Mapping[str, Any]) -> LoopSettings:
    """Finds a loop and changes it as options say.

    Args:
        name: ``ideal`` or ``realistic``.
        options: New values by name, dotted for those in a part, such as ``sensing.position``.

    Returns:
        The loop.

    Raises:
        SettingsError: There is no such loop or option, or a value is wrong.
    """
    if name not in LOOPS:
        raise SettingsError(
            f"there is no loop {name!r}{did_you_mean(name, LOOPS)} (loops: {', '.join(LOOPS)})"
        )
    try:
        loop: LoopSettings = apply_options(LOOPS[name], options)
    except SettingsError as error:
        raise SettingsError(f"loop {name!r}: {error}") from None
    return loop


def record_loop(loop: LoopSettings) -> dict[str, Any]:
    """Writes down all settings of a loop.

    Args:
        loop: The loop.

    Returns:
        What JSON can hold; as options of any loop, it gives the same settings.
    """
    return plain_settings(loop, lambda plugin: ("", plugin.__name__))
