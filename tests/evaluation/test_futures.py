"""Coverage over the futures of one past, against traffic whose law is known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, norm

from dosplan.cli import main as cli
from dosplan.cli.main import main
from dosplan.evaluation.futures import coasting, sample_pasts, summarise_futures
from dosplan.evaluation.samples import PredictionError
from dosplan.plugins.registry import create_predictor
from dosplan.scenario.synthetic import steady_tracks, straight_scenario
from dosplan.simulation.traffic import RoadUsers
from dosplan.types import FloatArray, Scenario, Tracks
from tests.support.runs import write_scenes
from tests.support.traffic import Wandering, WanderingTraffic

TRAFFIC = Path(__file__).parents[1] / "support" / "traffic.py"
HORIZONS = np.array([1.0, 2.0, 3.0, 4.0])
SPREAD = Wandering().spread


def _law(radius: float) -> FloatArray:
    """How often a circle around the mean holds who is off by SPREAD t N(0, 1) along the road."""
    return np.asarray(2.0 * norm.cdf(radius / (SPREAD * HORIZONS)) - 1.0)


def _crowd(users: int) -> Scenario:
    """Cars side by side, each at 10 m/s: none is in the way of another."""
    return straight_scenario(steady_tracks([[40.0, 5.0 * i, 0.0, 10.0] for i in range(users)]))


def _rows(users: int, futures: int, radius: float, level: float) -> list[dict[str, Any]]:
    traffic = [WanderingTraffic(future=k) for k in range(futures)]
    method = ("circle", create_predictor("fixed-circle", 0, {"r": radius}))
    samples = sample_pasts(_crowd(users), [method], traffic)
    assert samples.present.shape == (futures, users, 4)
    rows = summarise_futures([samples], ["circle"], level)
    return [row for row in rows if row["group"] == "all"]


def test_coverage_is_that_of_the_law() -> None:
    rows = _rows(users=4, futures=500, radius=6.0, level=0.9)
    law = _law(6.0)  # 0.95, 0.68, 0.50, 0.38.
    assert [row["horizon_s"] for row in rows] == HORIZONS.tolist()
    error = np.sqrt(law * (1.0 - law) / 2000)
    assert np.all(np.abs([row["cr"] for row in rows] - law) < 4.0 * error)
    assert [(row["pasts"], row["n"]) for row in rows] == [(4, 2000)] * 4
    # With so many futures a past that is covered to 95 % is above 90 %, and the others below.
    assert [row["below"] for row in rows] == [0.0, 1.0, 1.0, 1.0]
    assert rows[0]["below_by_chance"] == pytest.approx(float(binom.cdf(449, 500, 0.9)))


def test_where_every_past_is_at_the_level_those_below_are_what_chance_makes() -> None:
    level = float(_law(6.0)[1])
    row = _rows(users=200, futures=25, radius=6.0, level=level)[1]
    assert 0.3 < row["below_by_chance"] < 0.7
    error = np.sqrt(row["below_by_chance"] * (1.0 - row["below_by_chance"]) / 200)
    assert abs(row["below"] - row["below_by_chance"]) < 4.0 * error


def test_sets_that_are_right_on_average_and_wrong_in_each_past_are_told() -> None:
    """Half of the pasts covered always, half at 80 %: 90 % in all, and half of them below."""
    scenario, futures = _crowd(10), 200

    class Halves(WanderingTraffic):
        name = "halves-v1"
        has_futures = True

        def begin(self, scenario: Scenario, first_step: int) -> Tracks:
            past = super().begin(scenario, first_step)
            random = np.random.default_rng([self.future, 1])
            away = random.random(10) < np.where(np.arange(10) < 5, 0.0, 0.2)
            self.speed = np.where(away, 30.0, 10.0)
            return past

    method = ("circle", create_predictor("fixed-circle", 0, {"r": 1.0}))
    samples = sample_pasts(scenario, [method], [Halves(future=k) for k in range(futures)])
    row = summarise_futures([samples], ["circle"], 0.9)[0]
    assert row["cr"] == pytest.approx(0.9, abs=0.03)
    assert row["below"] == 0.5
    assert row["below_by_chance"] < 0.5


def test_who_is_gone_does_not_count() -> None:
    class Leaving(WanderingTraffic):
        """In every second future they leave after 1.5 s."""

        name = "leaving-v1"
        has_futures = True

        def step(self, step: int, ego: FloatArray) -> RoadUsers:
            users = super().step(step, ego)
            if self.future % 2 and step > 15:
                return RoadUsers(users.ids[:0], (), users.size[:0], users.states[:0])
            return users

    method = ("circle", create_predictor("fixed-circle", 0, {"r": 100.0}))
    samples = sample_pasts(_crowd(2), [method], [Leaving(future=k) for k in range(10)])
    rows = summarise_futures([samples], ["circle"], 0.9)[:4]
    assert [(row["pasts"], row["n"], row["cr"]) for row in rows] == [
        (2, 20, 1.0), (2, 10, 1.0), (2, 10, 1.0), (2, 10, 1.0),
    ]  # fmt: skip


def test_futures_without_one_past_are_refused() -> None:
    class Restless(WanderingTraffic):
        name = "restless-v1"
        has_futures = True

        def begin(self, scenario: Scenario, first_step: int) -> Tracks:
            past = super().begin(scenario, first_step)
            states = np.array(past.states)
            states[..., 0] += self.future
            return Tracks(past.ids, past.kinds, past.size, states, past.valid)

    with pytest.raises(PredictionError, match="restless-v1 do not have one past: future 1"):
        sample_pasts(_crowd(2), [], [Restless(future=k) for k in range(2)])


def test_the_ego_drives_on_along_its_path_and_beyond_it() -> None:
    scenario = straight_scenario(velocity=12.0)
    states = coasting(scenario, 40)
    assert np.array_equal(states[0], scenario.task.start)
    assert states[:, 0] == pytest.approx(1.2 * np.arange(41))
    assert states[:, 1] == pytest.approx(np.zeros(41))
    assert set(states[:, 3]) == {12.0}
    far = coasting(straight_scenario(velocity=50.0), 200)
    assert far[-1, 0] == pytest.approx(1000.0)


def test_the_command_measures_over_futures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes = str(write_scenes(tmp_path / "scenes", 2))
    asked = ["evaluate", scenes, "--predictor", "constant-velocity", "--futures", "5"]
    traffic = ["--traffic", f"{TRAFFIC}:WanderingTraffic", "--workers", "1"]
    figures = tmp_path / "x.json"
    more = ["--json", str(figures), "--markdown", str(tmp_path / "x.md"), "--level", "0.5"]
    assert main([*asked, *traffic, *more]) == cli.OK
    told = capsys.readouterr().out
    assert "2 road users at the start of 2 scenarios" in told
    assert "5 futures of each by the traffic wandering-v1" in told
    assert "covered below 50 %, all" in (tmp_path / "x.md").read_text()
    content = json.loads(figures.read_text())
    assert content.keys() == {"futures", "data"}
    row = content["futures"][0]
    assert row.keys() == {
        "method", "group", "horizon_s", "cr", "cr_se", "below", "below_by_chance", "pasts", "n"
    }  # fmt: skip
    # A point holds nobody whose speed is drawn.
    assert (row["cr"], row["below"], row["pasts"], row["n"]) == (0.0, 1.0, 2, 10)
    assert content["data"]["traffic_settings"] == {"spread": SPREAD}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--futures", "5"], "--futures needs a --traffic"),
        (["--futures", "5", "--traffic", "replay"], "has 1 recorded future, and 5 are asked for"),
        (["--futures", "0", "--traffic", "{traffic}"], "futures is 0"),
        (["--futures", "5", "--traffic", "{traffic}", "--level", "1"], "level is 1.0"),
        (["--futures", "5", "--traffic", "{traffic}", "--every", "5"], "--every does not go with"),
        (["--traffic", "{traffic}"], "--traffic goes with --futures only"),
    ],
)
def test_options_that_do_not_fit_are_one_line(
    tmp_path: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes = str(write_scenes(tmp_path / "scenes", 1))
    told = [option.format(traffic=f"{TRAFFIC}:WanderingTraffic") for option in options]
    assert main(["evaluate", scenes, "--predictor", "constant-velocity", *told]) == cli.BAD_INPUT
    assert message in capsys.readouterr().err


def test_a_scenario_that_the_traffic_refuses_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes = str(write_scenes(tmp_path / "scenes", 1))
    sumo = ["--traffic", "dosplan_sumo.traffic:SumoTraffic", "--futures", "2"]
    asked = ["evaluate", scenes, "--predictor", "constant-velocity", "--workers", "1"]
    assert main([*asked, *sumo]) == cli.BAD_INPUT
    assert "has no files of SUMO beside it" in capsys.readouterr().err


def test_a_predictor_that_is_shown_the_recording_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes = str(write_scenes(tmp_path / "scenes", 1))
    traffic = ["--traffic", f"{TRAFFIC}:WanderingTraffic", "--futures", "2"]
    assert main(["evaluate", scenes, "--predictor", "ground-truth", *traffic]) == cli.BAD_INPUT
    assert "'ground-truth' is shown the recording" in capsys.readouterr().err
