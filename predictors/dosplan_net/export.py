"""Writes models as ONNX files, which onnxruntime runs without torch; see ``engine``."""

from __future__ import annotations

import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import torch

from dosplan.system.files import write_bytes
from dosplan_net.engine import EngineError, Model

OPSET: Final = 17  # Old enough for every onnxruntime that is allowed.


def export(model: Model, weights: Path, folder: Path) -> Path:
    """Writes a model as an ONNX file that notes which weights it was made from.

    Args:
        model: The kind of model.
        weights: Its weights.
        folder: Where to write.

    Returns:
        The file.

    Raises:
        EngineError: The package onnx is missing.
        FileError: The file cannot be written.
        WeightsError: The weights cannot be read.
    """
    try:
        import onnx
    except ImportError:
        raise EngineError('an export needs onnx: pip install "dosplan[onnx]"') from None
    graph = model.load(weights)
    with TemporaryDirectory() as scratch, warnings.catch_warnings():
        traced = Path(scratch) / "traced.onnx"
        # Tracing warns where a branch depends on a shape. Here that is only so for empty maps, and
        # the encoder never passes one to the network. The newer exporter needs one more package.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            graph,
            graph.example(),
            traced,
            dynamo=False,
            opset_version=OPSET,
            input_names=list(graph.inputs),
            output_names=list(graph.outputs),
            dynamic_axes={name: dict(enumerate(axes)) for name, axes in graph.inputs.items()},
        )
        content = onnx.load(traced)
    onnx.helper.set_model_props(content, model.origin(weights))
    path = folder / weights.with_suffix(model.suffix).name
    write_bytes(path, content.SerializeToString())
    return path
