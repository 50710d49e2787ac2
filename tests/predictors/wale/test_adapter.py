"""What of Wale-Net's adapter needs no Wale-Net: ellipses, and what it says where it is missing."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from dosplan_wale.gaussians import ellipses
from hypothesis import given, settings
from hypothesis import strategies as st

from dosplan.plugins.registry import RegistryError, find_predictor
from dosplan.types import FloatArray


def covariance(x: float, y: float, correlation: float) -> FloatArray:
    both = correlation * x * y
    return np.array([[x * x, both], [both, y * y]])


def spread(x: float, y: float, correlation: float) -> FloatArray:
    return np.array([1.0 / x, 1.0 / y, correlation])


@pytest.mark.parametrize(
    ("x", "y", "direction"), [(3.0, 1.0, 0.0), (1.0, 3.0, 0.5 * np.pi)], ids=["along", "across"]
)
def test_an_ellipse_of_independent_errors_lies_along_the_axes(
    x: float, y: float, direction: float
) -> None:
    # 1 - exp(-q / 2) is the share within q; that of one standard deviation is 39.3 %.
    semi_axes, angle = ellipses(spread(x, y, 0.0), 1.0 - np.exp(-0.5))
    assert semi_axes == pytest.approx([3.0, 1.0])
    assert np.sin(angle - direction) == pytest.approx(0.0, abs=1e-12)


@given(st.floats(0.05, 20.0), st.floats(0.05, 20.0), st.floats(-0.99, 0.99), st.floats(0.01, 0.999))
@settings(max_examples=100, deadline=None)
def test_the_boundary_is_a_line_of_equal_density(
    x: float, y: float, correlation: float, coverage: float
) -> None:
    semi_axes, angle = ellipses(spread(x, y, correlation), coverage)
    assert semi_axes[0] >= semi_axes[1]
    around = np.linspace(0.0, 2.0 * np.pi, 9)
    own = np.stack([semi_axes[0] * np.cos(around), semi_axes[1] * np.sin(around)])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = turn @ own
    distance = np.sum(points * np.linalg.solve(covariance(x, y, correlation), points), axis=0)
    assert np.allclose(distance, -2.0 * np.log(1.0 - coverage), rtol=1e-6)


def test_an_ellipse_holds_the_share_it_promises() -> None:
    drawn = np.random.default_rng(0).multivariate_normal(
        [0.0, 0.0], covariance(2.0, 0.5, 0.7), 20_000
    )
    semi_axes, angle = ellipses(spread(2.0, 0.5, 0.7), 0.9)
    along = drawn @ np.array([np.cos(angle), np.sin(angle)])
    across = drawn @ np.array([-np.sin(angle), np.cos(angle)])
    inside = np.hypot(along / semi_axes[0], across / semi_axes[1]) <= 1.0
    # The standard error of a share of 0.9 in 20 000 draws is 0.002.
    assert inside.mean() == pytest.approx(0.9, abs=0.008)


def test_complete_correlation_leaves_a_line() -> None:
    semi_axes, angle = ellipses(spread(1.0, 1.0, 1.0), 0.5)
    assert semi_axes == pytest.approx([np.sqrt(4.0 * np.log(2.0)), 0.0], abs=1e-7)
    assert np.tan(angle) == pytest.approx(1.0)


def test_where_it_is_not_installed_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("prediction", "prediction.utils.model"):
        monkeypatch.setitem(sys.modules, name, None)
    for name in ("predictor", "network", "scene"):
        monkeypatch.delitem(sys.modules, f"dosplan_wale.{name}", raising=False)
    with pytest.raises(RegistryError, match=r"pip install 'dosplan\[wale-net\]'") as caught:
        find_predictor("wale-net")
    assert "\n" not in str(caught.value)
