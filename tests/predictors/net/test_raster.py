"""The map as an image: what is drawn where, and that the network reads it."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch
from dosplan_net.build import MODEL, build_network, load_network
from dosplan_net.features import PIECE_ATTRIBUTES, PIECE_POINTS
from dosplan_net.network import DISTANCE_UNIT, MODAL, NetworkConfig
from dosplan_net.raster import CHANNELS, SIDE, PieceKeeper, RasterNetwork, draw
from dosplan_net.training.batches import read_scenes
from dosplan_net.training.cache import WindowCache
from dosplan_net.weights import save_weights
from torch import Tensor

from tests.support.models import TINY

RASTER = replace(TINY, map_encoder="raster")


def straight_piece(length: float) -> Tensor:
    """(1, 35) one straight piece, 4 m wide, for cars, as it is kept."""
    shape = torch.zeros(1, PIECE_POINTS, 3)
    shape[0, :, 0] = torch.linspace(-length / 2, length / 2, PIECE_POINTS)
    shape[0, :, 2] = 2.0
    attributes = torch.zeros(1, PIECE_ATTRIBUTES)
    attributes[0, 1] = 1.0
    kept: Tensor = PieceKeeper()(shape, attributes)
    return kept


def seen_at(x: float, y: float, heading: float) -> Tensor:
    """(1, 1, 5) where a road user sees a piece."""
    turn = torch.tensor(heading)
    return torch.tensor(
        [[[x / DISTANCE_UNIT, y / DISTANCE_UNIT, 0.0, float(turn.cos()), float(turn.sin())]]]
    )


def test_a_line_ahead_is_drawn_without_gaps() -> None:
    # From 11 m to 29 m ahead and 2.5 m to the left. Cells are 1.5 m long from 16 m behind on:
    # 27 / 1.5 = row 18 to 45 / 1.5 = row 30 (the end itself is a hair before or in that cell).
    # They are 1 m wide around the middle column: 32 + 2.
    image = draw(straight_piece(17.8), torch.zeros(1, 1, dtype=torch.int64), seen_at(20, 2.5, 0))
    assert image.shape == (1, CHANNELS, SIDE, SIDE)
    assert image[0, 0].nonzero().tolist() == [[row, 34] for row in range(18, 30)]
    # cos, sin, half width / 2 m, for cars
    torch.testing.assert_close(image[0, :, 20, 34], torch.tensor([1.0, 1.0, 0.0, 1.0, 1.0]))


def test_a_line_across_has_its_heading_turned() -> None:
    # From 9 m right to 9 m left, 4.2 m ahead: row floor(20.2 / 1.5) = 13; columns 32 -+ 9.
    half_turn = torch.pi / 2
    image = draw(
        straight_piece(17.8), torch.zeros(1, 1, dtype=torch.int64), seen_at(4.2, 0, half_turn)
    )
    assert image[0, 0].nonzero().tolist() == [[13, column] for column in range(23, 41)]
    torch.testing.assert_close(image[0, 1:3, 13, 30], torch.tensor([0.0, 1.0]), atol=1e-6, rtol=0.0)


def test_what_is_unknown_or_outside_is_not_drawn() -> None:
    piece = straight_piece(10.0)
    nothing = torch.zeros(1, CHANNELS, SIDE, SIDE)
    for row, relation in (
        (-1, seen_at(10, 0, 0)),
        (0, seen_at(90, 0, 0)),
        (0, seen_at(-30, 0, 0)),
        (0, seen_at(0, 40, 0)),
        (0, seen_at(0, -40, 0)),
    ):
        torch.testing.assert_close(draw(piece, torch.tensor([[row]]), relation), nothing)
    torch.testing.assert_close(draw(piece[:0], torch.tensor([[-1]]), seen_at(0, 0, 0)), nothing)


def test_each_road_user_has_an_image_of_its_own() -> None:
    piece = straight_piece(10.0)
    places = [seen_at(10, 0.5, 0), seen_at(30, -7.5, 1.0)]
    both = draw(piece, torch.zeros(2, 1, dtype=torch.int64), torch.cat(places))
    for image, place in zip(both, places, strict=True):
        torch.testing.assert_close(
            image, draw(piece, torch.zeros(1, 1, dtype=torch.int64), place)[0]
        )


def test_the_network_reads_the_image_and_keeps_its_encoder(
    window_cache: Path, tmp_path: Path
) -> None:
    torch.manual_seed(0)
    network = build_network(RASTER).eval()
    assert isinstance(network, RasterNetwork)
    with torch.no_grad():
        network.get_parameter("decoder.2.weight").mul_(10.0)
    path = tmp_path / "net.safetensors"
    save_weights(path, network.state_dict(), {"model": MODEL, "network": asdict(RASTER)})
    again = load_network(path)
    batch = read_scenes(WindowCache.open(window_cache), [0, 15])
    scene = batch.scene(network.map_encoder, torch.arange(len(batch.pose)))
    with torch.no_grad():
        trajectory = network(scene).trajectory
        torch.testing.assert_close(again(scene)[0], trajectory)
        unseen = torch.full_like(scene.pieces, -1)
        blind = network(replace(scene, pieces=unseen)).trajectory
    assert (trajectory - blind).abs().amax() > 1e-3


def test_another_map_encoder_is_refused() -> None:
    with pytest.raises(ValueError, match="no map encoder 'photo'; choose polylines or raster"):
        NetworkConfig(map_encoder="photo")
    with pytest.raises(ValueError, match="raster' goes with the architecture recurrent only"):
        NetworkConfig(map_encoder="raster", architecture=MODAL)
