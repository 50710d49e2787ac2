"""Places of scenarios, as their ids tell."""

from __future__ import annotations

import pytest

from dosplan.types import place_of


@pytest.mark.parametrize(
    ("scenario", "place"),
    [
        ("USA_Lanker-2_25_T-1", "USA_Lanker"),
        ("C-USA_US101-1_1_T-1", "USA_US101"),
        ("ZAM_Test-1_1_T-1@7", "ZAM_Test"),
        ("unnamed", "unnamed"),
    ],
)
def test_the_place_is_what_stands_before_the_map_number(scenario: str, place: str) -> None:
    assert place_of(scenario) == place
