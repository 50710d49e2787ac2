"""Ellipses and their representations, against what geometry says."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from dosplan_dos.grid import GRID, every_step
from dosplan_dos.shapes import (
    LEAST_AXIS,
    LEAST_MOTION,
    MOTION_STEPS,
    Ellipses,
    Unions,
    Variant,
    ellipses,
    grid_seconds,
    grid_steps,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

torch.set_num_threads(1)

G = len(grid_steps())
AXES = st.floats(0.05, 20.0)
ANGLES = st.floats(-10.0, 10.0)


def ellipse(a: float, b: float, angle: float) -> Ellipses:
    double = [math.cos(2 * angle), math.sin(2 * angle)]
    axes = torch.tensor([[[a, b]]], dtype=torch.float64)
    return Ellipses(axes, torch.tensor([[double]], dtype=torch.float64))


def on_boundary(a: float, b: float, angle: float, at: float) -> Tensor:
    """A point of the boundary: a cos(at) along the first axis and b sin(at) along the second."""
    point = np.exp(1j * angle) * complex(a * math.cos(at), b * math.sin(at))
    return torch.tensor([[[point.real, point.imag]]], dtype=torch.float64)


@settings(max_examples=50, deadline=None)
@given(AXES, AXES, ANGLES, ANGLES, st.floats(0.02, 20.0))
def test_distance_is_one_on_the_boundary_and_grows_with_the_way(
    a: float, b: float, angle: float, at: float, scale: float
) -> None:
    sets, point = ellipse(a, b, angle), on_boundary(a, b, angle, at)
    assert float(sets.distance(point)) == pytest.approx(1.0, rel=1e-6)
    assert float(sets.distance(scale * point)) == pytest.approx(scale, rel=1e-6)
    assert float(sets.distance(-point)) == pytest.approx(1.0, rel=1e-6)


@settings(max_examples=50, deadline=None)
@given(AXES, AXES, ANGLES, st.floats(-20.0, 20.0), st.floats(-20.0, 20.0))
def test_swapped_axes_and_a_quarter_turn_are_the_same_ellipse(
    a: float, b: float, angle: float, x: float, y: float
) -> None:
    point = torch.tensor([[[x, y]]], dtype=torch.float64)
    one, other = ellipse(a, b, angle), ellipse(b, a, angle + math.pi / 2)
    torch.testing.assert_close(other.distance(point), one.distance(point), rtol=1e-6, atol=1e-6)
    half_a_turn = ellipse(a, b, angle + math.pi)
    torch.testing.assert_close(
        half_a_turn.distance(point), one.distance(point), rtol=1e-6, atol=1e-6
    )


def test_distance_is_the_quadratic_form_of_the_covariance() -> None:
    random = np.random.default_rng(0)
    for _ in range(50):
        a, b, angle = random.uniform(0.1, 5.0, 3)
        error = random.normal(0.0, 3.0, 2)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        covariance = turn @ np.diag([a**2, b**2]) @ turn.T
        expected = math.sqrt(error @ np.linalg.solve(covariance, error))
        found = ellipse(a, b, angle).distance(torch.from_numpy(error)[None, None])
        assert float(found) == pytest.approx(expected, rel=1e-9)


def test_area() -> None:
    assert float(ellipse(2.0, 0.5, 1.0).area) == pytest.approx(math.pi)


def test_the_grid_is_every_fifth_of_a_second() -> None:
    torch.testing.assert_close(grid_seconds(), 0.2 * torch.arange(1, G + 1))
    assert float(grid_seconds()[-1]) == pytest.approx(4.0)
    assert grid_steps().tolist() == list(range(1, 40, 2))


def history_of(velocity: float, direction: float, known: bool = True) -> Tensor:
    """(1, 31, 6) of a road user that moves in a direction while it looks along x."""
    history = torch.zeros(1, 31, 6)
    back = -0.1 * velocity * torch.arange(30, -1, -1)
    history[0, :, 0] = back * math.cos(direction)
    history[0, :, 1] = back * math.sin(direction)
    history[0, :, 2], history[0, :, 4], history[0, :, 5] = 1.0, velocity, 1.0
    if not known:
        history[0, :-1] = 0.0
    return history


def arc(radius: float, velocity: float) -> tuple[Tensor, Tensor]:
    """(1, G, 2) an arc to the left, at the steps of the grid, and (G,) its headings there."""
    turn = velocity / radius * grid_seconds()
    path = radius * torch.stack([turn.sin(), 1 - turn.cos()], -1)
    return path[None], turn


def angles(sets: Ellipses) -> Tensor:
    """Angles of the first axis, in (-pi / 2, pi / 2], rad."""
    return 0.5 * torch.atan2(sets.double_angle[..., 1], sets.double_angle[..., 0])


@pytest.fixture
def raw() -> Tensor:
    torch.manual_seed(0)
    return 3.0 * torch.randn(1, G, 4)


@pytest.mark.parametrize("variant", list(Variant))
def test_axes_are_positive_and_grow_and_angles_are_unit_vectors(
    variant: Variant, raw: Tensor
) -> None:
    path, _ = arc(20.0, 6.0)
    sets = ellipses(variant, raw, path, history_of(6.0, 0.0))
    assert sets.semi_axes.shape == sets.double_angle.shape == (1, G, 2)
    assert torch.all(sets.semi_axes >= LEAST_AXIS)
    torch.testing.assert_close(sets.double_angle.norm(dim=-1), torch.ones(1, G))
    steady = ellipses(variant, torch.zeros(1, G, 4), path, history_of(6.0, 0.0)).semi_axes
    assert torch.all(steady.diff(dim=1) > 0)
    # softplus(0) = ln 2, times 0.15 + 0.5 t.
    assert float(steady[0, -1, 0]) == pytest.approx(LEAST_AXIS + math.log(2) * 2.15, rel=1e-5)
    assert torch.all(ellipses(variant, raw - 1e4, path, history_of(6.0, 0.0)).semi_axes > 0)


def test_a_circle_is_round(raw: Tensor) -> None:
    path, _ = arc(20.0, 6.0)
    axes = ellipses(Variant.CIRCLE, raw, path, history_of(6.0, 0.0)).semi_axes
    assert torch.equal(axes[..., 0], axes[..., 1])
    others = ellipses(Variant.FREE, raw, path, history_of(6.0, 0.0)).semi_axes
    assert torch.equal(axes[..., 0], others[..., 0])
    assert not torch.equal(others[..., 0], others[..., 1])


@pytest.mark.parametrize(
    ("variant", "angle"), [(Variant.THETA_0, 0.0), (Variant.THETA_45, math.pi / 4)]
)
def test_fixed_angles(variant: Variant, angle: float, raw: Tensor) -> None:
    path, _ = arc(20.0, 6.0)
    found = angles(ellipses(variant, raw, path, history_of(6.0, 0.5)))
    torch.testing.assert_close(found, torch.full((1, G), angle))


@pytest.mark.parametrize("direction", [-1.2, 0.0, 0.3, 1.5])
def test_v1_lies_along_the_present_motion(direction: float, raw: Tensor) -> None:
    path, _ = arc(20.0, 6.0)
    found = angles(ellipses(Variant.V1, raw, path, history_of(6.0, direction)))
    torch.testing.assert_close(found, torch.full((1, G), direction), atol=1e-5, rtol=0.0)


def test_v1_lies_along_the_heading_of_who_stands_or_is_new(raw: Tensor) -> None:
    path, _ = arc(20.0, 6.0)
    slow = LEAST_MOTION / (0.1 * MOTION_STEPS)  # m/s that lead just LEAST_MOTION far.
    for history, angle in (
        (history_of(0.95 * slow, 0.7), 0.0),
        (history_of(1.05 * slow, 0.7), 0.7),
        (history_of(6.0, 0.7, known=False), 0.0),
    ):
        found = angles(ellipses(Variant.V1, raw, path, history))
        torch.testing.assert_close(found, torch.full((1, G), angle), atol=1e-5, rtol=0.0)


def test_v2_lies_along_the_predicted_motion(raw: Tensor) -> None:
    path, heading = arc(20.0, 6.0)
    found = angles(ellipses(Variant.V2, raw, path, history_of(6.0, 0.0)))
    # The chord of an arc has the direction of its middle, a tenth of a second before its end.
    torch.testing.assert_close(found[0], heading - 0.1 * 6.0 / 20.0, atol=1e-4, rtol=0.0)
    still = torch.zeros(1, G, 2)
    found = angles(ellipses(Variant.V2, raw, still, history_of(6.0, 0.7)))
    torch.testing.assert_close(found, torch.zeros(1, G))


def test_a_free_angle_is_the_decoders_and_starts_along_the_heading(raw: Tensor) -> None:
    path, _ = arc(20.0, 6.0)
    start = ellipses(Variant.FREE, torch.zeros(1, G, 4), path, history_of(6.0, 0.7))
    torch.testing.assert_close(angles(start), torch.zeros(1, G))
    wanted = raw.clone()
    wanted[..., 2] = math.cos(2 * 1.1) - 1.0
    wanted[..., 3] = math.sin(2 * 1.1)
    found = angles(ellipses(Variant.FREE, wanted, path, history_of(6.0, 0.7)))
    torch.testing.assert_close(found, torch.full((1, G), 1.1))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 4), st.integers(1, G), st.integers(1, 3))
def test_every_step_keeps_the_grid_and_fills_with_means(rows: int, steps: int, width: int) -> None:
    on_grid = np.random.default_rng(rows).normal(size=(rows, steps, width))
    filled = every_step(on_grid)
    assert filled.shape == (rows, GRID * steps, width)
    np.testing.assert_array_equal(filled[:, GRID - 1 :: GRID], on_grid)
    np.testing.assert_array_equal(filled[:, 0], on_grid[:, 0])
    between = 0.5 * (on_grid[:, 1:] + on_grid[:, :-1])
    np.testing.assert_allclose(filled[:, GRID::GRID], between)


def test_every_step_is_exact_on_a_line() -> None:
    seconds = grid_seconds().numpy()[None, :, None].astype(np.float64)
    np.testing.assert_allclose(every_step(seconds)[0, 1:, 0], 0.1 * np.arange(2, 41), rtol=1e-6)


def union_of(*ellipses: tuple[float, float, float, float, float]) -> Unions:
    """One union at one step, of ellipses x, y, a, b, angle."""
    x, y, a, b, angle = torch.tensor(ellipses).T
    return Unions(
        torch.stack([a, b], -1)[None, :, None],
        torch.stack([torch.cos(2 * angle), torch.sin(2 * angle)], -1)[None, :, None],
        torch.stack([x, y], -1)[None, :, None],
    )


def test_the_area_of_a_union_counts_what_overlaps_once() -> None:
    one = (1.0, -2.0, 3.0, 1.0, 0.4)
    alone = math.pi * 3.0
    assert float(union_of(one).area) == pytest.approx(alone, rel=1e-5)
    # A smooth step stands for "inside", so that the same ellipse twice is a little more than one.
    assert float(union_of(one, one, one).area_by(500)) == pytest.approx(alone, rel=0.15)
    apart = union_of(one, (40.0, 0.0, 1.0, 2.0, 1.0))
    assert float(apart.area_by(500)) == pytest.approx(alone + 2.0 * math.pi, rel=0.01)
    within = union_of((0.0, 0.0, 6.0, 6.0, 0.0), (1.0, 0.0, 1.0, 0.5, 0.3))
    assert float(within.area_by(500)) == pytest.approx(36.0 * math.pi, rel=0.02)
    crossed = union_of((0.0, 0.0, 4.0, 1.0, 0.0), (0.5, 0.0, 4.0, 1.0, 1.2))
    points = (torch.rand(200_000, 2, generator=torch.Generator().manual_seed(0)) - 0.5) * 12.0
    inside = crossed.distances(points.view(-1, 1, 2)).amin(1) <= 1
    assert float(crossed.area_by(500)) == pytest.approx(
        144.0 * float(inside.float().mean()), rel=0.08
    )


def test_a_union_holds_what_any_of_its_ellipses_holds() -> None:
    union = union_of((0.0, 0.0, 2.0, 1.0, 0.0), (10.0, 0.0, 1.0, 1.0, 0.0))
    points = torch.tensor([[1.0, 0.0], [10.5, 0.0], [5.0, 0.0]]).view(3, 1, 2)
    torch.testing.assert_close(union.distance(points)[:, 0], torch.tensor([0.5, 0.5, 2.5]))
    factor = torch.tensor([2.5])
    assert float(union.area_scaled(factor)) > 2.5 * float(union.area)


def test_the_area_of_a_union_has_a_gradient_in_every_ellipse() -> None:
    union = union_of((0.0, 0.0, 2.0, 1.0, 0.0), (1.5, 0.0, 1.0, 2.0, 0.7))
    axes = union.semi_axes.clone().requires_grad_()
    centre = union.centre.clone().requires_grad_()
    Unions(axes, union.double_angle, centre).area.sum().backward()  # type: ignore[no-untyped-call]
    assert axes.grad is not None
    assert centre.grad is not None
    assert (axes.grad > 0).all()
    assert centre.grad[0, 1, 0, 0] > 0  # Further apart, they have less in common.
