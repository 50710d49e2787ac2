"""Weight files: what goes in comes out, and nothing else is taken."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
import torch
from dosplan_dos.training import load_module
from dosplan_net.build import load_network
from dosplan_net.weights import WeightsError, load_weights, save_weights
from safetensors.torch import save_file

from tests.support.models import save_network, save_sets, tiny_network


class Trap:
    """Code in a pickle."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (_sprung.append, ("ran",))


_sprung: list[str] = []


def test_what_is_saved_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "net.safetensors"
    state = {"a": torch.randn(3, 4).T, "b": torch.arange(5)}
    save_weights(path, state, {"model": "this", "list": [1, 2.5, "three"]})
    back, about = load_weights(path, "this")
    assert about == {"model": "this", "list": [1, 2.5, "three"]}
    assert back.keys() == state.keys()
    for name, value in state.items():
        assert torch.equal(back[name], value)


def test_a_network_comes_back_ready(tmp_path: Path) -> None:
    network = load_network(save_network(tmp_path / "net.safetensors", seed=3))
    assert not network.training
    for name, value in tiny_network(3).named_parameters():
        assert torch.equal(network.get_parameter(name), value)
        assert not network.get_parameter(name).requires_grad


def damaged(path: Path, kind: str) -> Path:
    whole = save_network(path).read_bytes()
    match kind:
        case "missing":
            path.unlink()
        case "a folder":
            path.unlink()
            path.mkdir()
        case "empty":
            path.write_bytes(b"")
        case "header cut":
            path.write_bytes(whole[:50])
        case "data cut":
            path.write_bytes(whole[:-10])
        case "text":
            path.write_text("not weights at all, but long enough to hold a header's length\n" * 9)
        case "pickle":
            path.write_bytes(pickle.dumps(Trap()))
        case "torch":
            torch.save({"a": torch.zeros(3)}, path)
        case "nameless":
            save_file({"a": torch.zeros(3)}, path)
        case "broken metadata":
            save_file({"a": torch.zeros(3)}, path, metadata={"about": "{"})
        case "another model":
            save_sets(path)
    return path


@pytest.mark.parametrize(
    ("kind", "complaint"),
    [
        ("missing", "not readable as weights"),
        ("a folder", "not readable as weights"),
        ("empty", "not readable as weights"),
        ("header cut", "not readable as weights"),
        ("data cut", "not readable as weights"),
        ("text", "not readable as weights"),
        ("pickle", "not readable as weights"),
        ("torch", "not readable as weights"),
        ("broken metadata", "not readable as weights"),
        ("nameless", "of 'an unknown model', not of 'trajectory-network'"),
        ("another model", "of 'occupancy-sets', not of 'trajectory-network'"),
    ],
)
def test_what_is_not_such_weights_is_refused_in_one_line(
    tmp_path: Path, kind: str, complaint: str
) -> None:
    path = damaged(tmp_path / "net.safetensors", kind)
    with pytest.raises(WeightsError, match=complaint) as caught:
        load_network(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert _sprung == []


def test_a_network_is_no_module_of_sets(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="not of 'occupancy-sets'"):
        load_module(save_network(tmp_path / "net.safetensors"))


@pytest.mark.parametrize(
    "about", [{}, {"network": {}}, {"network": {"width": 3}}, {"network": {"hidden": 16}}]
)
def test_weights_of_another_shape_are_refused(tmp_path: Path, about: dict[str, object]) -> None:
    path = tmp_path / "net.safetensors"
    save_weights(path, tiny_network().state_dict(), {"model": "trajectory-network", **about})
    with pytest.raises(WeightsError, match="another version"):
        load_network(path)
