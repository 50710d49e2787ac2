"""Settings of the planner: their ranges, and that every one of them is a value of its own."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass, replace
from typing import Any

import pytest
from dosplan_mpc.config import (
    ArrivalSettings,
    BarrierSettings,
    ComfortSettings,
    GapSettings,
    GoalSettings,
    MpcConfig,
    PassingSettings,
    PathSettings,
    SamplerSettings,
    SetSettings,
    SpeedSettings,
    Style,
    TrafficSettings,
)

PARTS = (
    MpcConfig(),
    Style(lateral=4.0, longitudinal=2.5, comfort=1.0),
    ArrivalSettings(),
    BarrierSettings(),
    ComfortSettings(),
    GapSettings(),
    GoalSettings(),
    PassingSettings(),
    PathSettings(),
    SamplerSettings(),
    SetSettings(),
    SpeedSettings(),
    TrafficSettings(),
)


@pytest.mark.parametrize("part", PARTS, ids=lambda part: type(part).__name__)
def test_no_number_is_negative_or_not_finite(part: Any) -> None:
    numbers = [f.name for f in fields(part) if isinstance(getattr(part, f.name), int | float)]
    assert numbers
    said = "expected 0 or more, and finite"
    for name in numbers:
        for wrong in (-1.0, math.nan, math.inf):
            with pytest.raises(ValueError, match=f"^{name} is {wrong}, {said}$"):
                replace(part, **{name: wrong})


@pytest.mark.parametrize(
    ("part", "change", "said"),
    [
        (MpcConfig(), {"horizon": 0}, "horizon is 0, expected more"),
        (MpcConfig(), {"cycle_iterations": 0}, "cycle_iterations is 0, expected more"),
        (MpcConfig(), {"grip": 1.5}, "grip is 1.5, expected 1 or less"),
        (MpcConfig(), {"far_penalty": 2.0}, "far_penalty is 2.0, expected 1 or less"),
        (GoalSettings(), {"spacing": 0.0}, "spacing is 0, expected more"),
        (SpeedSettings(), {"approach_end": 0.0}, "approach_end is 0, expected more"),
        (SetSettings(), {"smallest_release": 1.1}, "smallest_release is 1.1, expected 1 or less"),
        (SamplerSettings(), {"steepest": 1.6}, "steepest is 1.6, expected less than pi / 2"),
        (SamplerSettings(), {"manoeuvre_seconds": ()}, r"manoeuvre_seconds are \(\), expected"),
        (SamplerSettings(), {"manoeuvre_seconds": (1.0, 0.0)}, "expected one or more above 0"),
        (SamplerSettings(), {"accelerations": (math.nan,)}, "expected finite numbers"),
    ],
)
def test_what_is_out_of_range_is_named(part: Any, change: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said) as caught:
        replace(part, **change)
    assert "\n" not in str(caught.value)


def test_settings_are_values() -> None:
    """They are the key of the problems that a process shares."""
    assert hash(MpcConfig()) == hash(MpcConfig())
    assert MpcConfig() == MpcConfig()
    changed = replace(MpcConfig(), sampler=SamplerSettings(lane=3.0))
    assert changed != MpcConfig()
    nested = [f.name for f in fields(MpcConfig) if is_dataclass(getattr(MpcConfig(), f.name))]
    assert {"path", "goal", "speed", "traffic", "sets", "sampler"} <= set(nested)
