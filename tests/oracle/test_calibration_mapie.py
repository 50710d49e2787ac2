"""The factor beside MAPIE's split-conformal regressor on the same scores.

A regressor that always says 0 has the score itself as absolute residual, so that the half width of
MAPIE's interval is the conformal quantile of the scores.
"""

from __future__ import annotations

import numpy as np
import pytest
from dosplan_dos.calibration import Calibration, Mode

from dosplan.types import RoadUserKind

mapie = pytest.importorskip("mapie.regression", reason="needs mapie")
dummy = pytest.importorskip("sklearn.dummy", reason="needs scikit-learn")


@pytest.mark.parametrize(
    ("n", "level"),
    [
        (n, x)
        for n in (10, 99, 100, 237, 1000)
        for x in (0.5, 0.8, 0.9, 0.95, 0.99)
        if n * (1 - x) >= 1
    ],
)
def test_the_factor_is_the_half_width_of_mapies_interval(n: int, level: float) -> None:
    scores = np.random.default_rng(n).lognormal(size=n)
    place = np.zeros((n, 1))
    zero = dummy.DummyRegressor(strategy="constant", constant=0.0).fit(place, scores)
    regressor = mapie.SplitConformalRegressor(zero, confidence_level=level, prefit=True)
    _, interval = regressor.conformalize(place, scores).predict_interval(place[:1])
    expected = float(interval[0, 1, 0])

    cars = [RoadUserKind.CAR] * n
    speed = np.zeros(n)
    calibration = Calibration.fit(scores[:, None], speed, cars, np.arange(n), Mode.PER_STEP)
    factor = calibration.factors(level, speed[:1], cars[:1])[0, 0]
    assert expected <= factor <= expected * (1 + 1 / 2048)
