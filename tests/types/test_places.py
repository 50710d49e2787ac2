"""Places of scenarios, as their ids tell."""

from __future__ import annotations

import pytest

from dosplan.types import place_of


@pytest.mark.parametrize(
    ("scenario", "place"),
    [
        ("USA_Lanker-2_25_T-1", "USA_Lanker"),
        ("C-USA_US101-1_1_T-1", "USA_US101"),
        ("ZAM_Test-1_1_T-1@7", "ZAM_Test-1"),
        ("C-ZAM_Zebra-12_2_T-1", "ZAM_Zebra-12"),
        ("ZAM_Test", "ZAM_Test"),
        ("unnamed", "unnamed"),
    ],
)
def test_a_place_is_a_scene_or_the_map_of_an_imaginary_one(scenario: str, place: str) -> None:
    assert place_of(scenario) == place
