"""Weights in files: safetensors, which hold numbers and text only and cannot run code."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from dosplan.system.errors import DosplanError
from dosplan.system.files import write_bytes

ModelT = TypeVar("ModelT", bound=nn.Module)


class WeightsError(DosplanError, ValueError):
    """A weight file that cannot be used; the message is one line."""


def save_weights(path: Path, state: Mapping[str, Tensor], about: Mapping[str, Any]) -> None:
    """Writes weights and what belongs to them.

    Args:
        path: The file.
        state: The tensors by name.
        about: Values that JSON can hold: the kind of model and its configuration.
    """
    tensors = {name: tensor.detach().contiguous() for name, tensor in state.items()}
    write_bytes(path, save(tensors, metadata={"about": json.dumps(about, sort_keys=True)}))


def load_weights(path: Path, model: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Reads weights.

    Args:
        path: The file.
        model: The kind of model that is wanted, ``about["model"]``.

    Returns:
        The tensors by name, and what was saved about them.

    Raises:
        WeightsError: The file is missing, broken or another model's.
    """
    try:
        with safe_open(path, framework="pt") as content:
            about: dict[str, Any] = json.loads((content.metadata() or {}).get("about", "{}"))
            state = {name: content.get_tensor(name) for name in content.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError) as error:
        raise WeightsError(
            f"{path}: not readable as weights ({' '.join(str(error).split())}); "
            "fetch the file again or train it with dosplan train"
        ) from None
    if about.get("model") != model:
        raise WeightsError(
            f"{path}: holds weights of {about.get('model', 'an unknown model')!r}, not of {model!r}"
        )
    return state, about


def begin_from(model: nn.Module, path: Path, kind: str) -> None:
    """Gives a model the weights of a trained one.

    Args:
        model: An untrained model.
        path: The weights.
        kind: The kind of model, as for ``load_weights``.

    Raises:
        WeightsError: The file is not such weights, or a model of other sizes has them.
    """
    state, _ = load_weights(path, kind)
    try:
        model.load_state_dict(state)
    except RuntimeError:
        raise WeightsError(
            f"{path}: weights of a {kind!r} of other sizes than the configuration names; "
            "copy the sizes from the configuration that it was trained by"
        ) from None


def load_model(path: Path, model: str, build: Callable[[dict[str, Any]], ModelT]) -> ModelT:
    """Builds a model from its weights.

    Args:
        path: The weights.
        model: The kind of model, as for ``load_weights``.
        build: Makes the model out of what was saved about it.

    Returns:
        The model, ready to be used.

    Raises:
        WeightsError: The file is not such weights.
    """
    state, about = load_weights(path, model)
    try:
        built = build(about)
        built.load_state_dict(state)
    except (KeyError, TypeError, ValueError, RuntimeError):
        raise WeightsError(
            f"{path}: weights of another version of {model!r}; "
            "train them again or install the version that made them"
        ) from None
    return built.eval().requires_grad_(False)
