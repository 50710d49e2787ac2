"""The training loop: it goes on where it stopped, ends in time and keeps the best."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from dosplan_net.training.made_from import MadeFrom, describe_training
from dosplan_net.training.optimise import FitSettings, fit
from dosplan_net.weights import WeightsError
from torch import Tensor, nn

SETTINGS = FitSettings(steps=24, learning_rate=0.05, validate_every=4, patience=100)
FIRST = describe_training(data=["a", "b"], fit={"rate": 0.05, "shape": (1, 2)})


class Noisy(nn.Module):
    """A line with dropout and a buffer that counts its training steps."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.line = nn.Sequential(nn.Linear(2, 16), nn.Dropout(0.3), nn.Linear(16, 1))
        self.register_buffer("seen", torch.zeros(()))

    @property
    def weight(self) -> Tensor:
        """(16, 2) the first layer's weights."""
        return self.get_parameter("line.0.weight").detach()

    def loss(self, step: int) -> Tensor:
        """Squared error on points that are drawn anew at every step."""
        self.get_buffer("seen").add_(1.0)
        points = torch.randn(32, 2) + 0.01 * step
        wanted = points.sum(-1, keepdim=True)
        error: Tensor = (self.line(points) - wanted).square().mean()
        return error


def error_on_a_grid(model: nn.Module) -> Mapping[str, float]:
    points = torch.cartesian_prod(torch.linspace(-1, 1, 5), torch.linspace(-1, 1, 5))
    with torch.no_grad():
        error = model.line(points) - points.sum(-1, keepdim=True)  # type: ignore[operator]
    return {"rms": float(error.square().mean().sqrt()), "largest": float(error.abs().max())}


def trained(
    folder: Path,
    settings: FitSettings = SETTINGS,
    validate: Callable[[nn.Module], Mapping[str, float]] = error_on_a_grid,
    stop_at: int | None = None,
    made_from: MadeFrom = FIRST,
) -> tuple[Noisy, dict[str, float]]:
    model = Noisy()

    def loss_at(step: int) -> Tensor:
        if step == stop_at:
            raise KeyboardInterrupt
        return model.loss(step)

    figures = fit(model, loss_at, validate, settings, folder, made_from, lambda line: None)
    return model, figures


@pytest.mark.parametrize("stops", [(1,), (4,), (11,), (6, 13, 23)])
def test_an_interrupted_training_ends_with_the_same_weights(
    tmp_path: Path, stops: tuple[int, ...]
) -> None:
    whole, expected = trained(tmp_path / "whole")
    for stop in stops:
        with pytest.raises(KeyboardInterrupt):
            trained(tmp_path / "parts", stop_at=stop)
    parts, figures = trained(tmp_path / "parts")
    assert figures == expected
    for name, value in whole.state_dict().items():
        assert torch.equal(parts.state_dict()[name], value), name


def test_a_finished_training_is_not_repeated(tmp_path: Path) -> None:
    first, figures = trained(tmp_path)
    again, same = trained(tmp_path, stop_at=0)
    assert same == figures
    assert torch.equal(again.weight, first.weight)


@pytest.mark.parametrize(
    ("other", "differs"),
    [
        (FIRST | {"data": ["b", "a"]}, "data"),
        (FIRST | {"fit": {"rate": 0.06, "shape": [1, 2]}}, r"fit\.rate"),
        (FIRST | {"fit": {"rate": 0.05, "shape": [1]}, "init": None}, r"fit\.shape, init"),
    ],
)
def test_another_training_does_not_go_on_from_a_checkpoint(
    tmp_path: Path, other: MadeFrom, differs: str
) -> None:
    with pytest.raises(KeyboardInterrupt):
        trained(tmp_path, stop_at=9)
    line = rf"^{tmp_path}/checkpoint\.pt: was trained with other {differs}; .* delete {tmp_path}$"
    with pytest.raises(WeightsError, match=line):
        trained(tmp_path, made_from=other)
    trained(tmp_path, made_from=FIRST)


def test_it_learns_and_the_seed_decides(tmp_path: Path) -> None:
    start = error_on_a_grid(Noisy().eval())["rms"]
    one, figures = trained(tmp_path / "a", replace(SETTINGS, steps=200))
    assert figures["rms"] < 0.3 * start
    other, _ = trained(tmp_path / "b", replace(SETTINGS, steps=200, seed=2))
    assert not torch.equal(one.weight, other.weight)


def scripted(values: list[float]) -> Callable[[nn.Module], Mapping[str, float]]:
    """Validations whose first figure is given; the second tells when the model was seen."""
    left = iter(values)
    return lambda model: {
        "criterion": next(left),
        "weight": float(model.get_parameter("line.0.weight")[0, 0]),
    }


def test_the_best_weights_are_kept(tmp_path: Path) -> None:
    model, figures = trained(tmp_path, validate=scripted([5.0, 3.0, 4.0, 3.5, 3.0, 6.0]))
    assert figures["criterion"] == 3.0
    with (tmp_path / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == [4, 8, 12, 16, 20, 24]
    # The second of them: the first of two that are equally good.
    assert float(model.weight[0, 0]) == float(rows[1]["weight"])
    assert figures["weight"] == float(rows[1]["weight"]) != float(rows[5]["weight"])
    assert not model.training


@pytest.mark.parametrize(("patience", "last"), [(1, 12), (2, 16), (3, 24)])
def test_patience_ends_training(tmp_path: Path, patience: int, last: int) -> None:
    # Two validations without a better one, then a better one, then three without.
    validate = scripted([5.0, 4.0, 4.5, 4.2, 3.9, 4.0])
    trained(tmp_path, replace(SETTINGS, patience=patience), validate)
    with (tmp_path / "log.csv").open() as file:
        assert int(list(csv.DictReader(file))[-1]["step"]) == last


def test_what_is_kept_is_an_average_of_the_weights(tmp_path: Path) -> None:
    """A slow average lags behind: it moves less than a quick one, but for the first steps."""
    start = Noisy().weight
    way = {}
    for average in (0.0, 0.9):
        settings = replace(SETTINGS, average=average, validate_every=24)
        model, _ = trained(tmp_path / str(average), settings)
        way[average] = float((model.weight - start).norm())
    assert 0.0 < way[0.9] < way[0.0]
    # The decay is at most (1 + step) / (10 + step): after the first step nine tenths are new.
    one, _ = trained(tmp_path / "one", replace(SETTINGS, steps=1, average=0.9))
    raw, _ = trained(tmp_path / "raw", replace(SETTINGS, steps=1, average=0.0))
    moved, whole = one.weight - start, raw.weight - start
    torch.testing.assert_close(moved, 0.9 * whole, rtol=1e-4, atol=1e-7)
