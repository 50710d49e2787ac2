"""What runs a trained model: torch, or onnxruntime, which is quicker and needs no torch.

Predictors see a model as a ``Function`` of arrays and do not know who computes it.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from dosplan import __version__
from dosplan.system.errors import DosplanError, one_line
from dosplan_net.features import Float32Array

if TYPE_CHECKING:
    from dosplan_net.graphs import Graph

# The key under which a tensor of an ONNX file says which other file holds its data. A file without
# these bytes refers to no other, whatever else is in it; names of our graphs do not contain them.
_EXTERNAL: Final = b"location"


class EngineError(DosplanError, ValueError):
    """An engine that cannot run a model; the message is one line."""


class Engine(StrEnum):
    """What runs a model."""

    TORCH = "torch"
    ONNX = "onnx"

    @classmethod
    def _missing_(cls, value: object) -> None:
        raise EngineError(f"there is no engine {value!r}; choose from {', '.join(cls)}")


class Function(Protocol):
    """A loaded model."""

    def __call__(self, **arrays: npt.NDArray[Any]) -> list[Float32Array]:
        """Runs it.

        Args:
            arrays: The inputs of the model's graph by name, float32 or int64.

        Returns:
            Its outputs, in order.
        """


@dataclass(frozen=True)
class Model:
    """A kind of model that a weight file holds.

    Attributes:
        load: Builds its graph from weights; imports torch.
        suffix: End of an exported file's name, where that of the weights has ``.safetensors``.
        option: The option of ``dosplan export`` that takes its weights.
        beside: End of the name of a file beside the weights that holds its own; None where the
            weights do.
    """

    load: Callable[[Path], Graph]
    suffix: str
    option: str
    beside: str | None = None

    def origin(self, weights: Path) -> dict[str, str]:
        """The metadata that an exported file needs in order to be used.

        Args:
            weights: The weights.

        Returns:
            The digest of those that it is made from, and the version of the code that says what to
            compute with them.

        Raises:
            OSError: The weights cannot be read.
        """
        own = weights if self.beside is None else weights.with_suffix(self.beside)
        return {"weights_sha256": sha256(own.read_bytes()).hexdigest(), "dosplan": __version__}


def open_function(model: Model, weights: Path, engine: Engine, threads: int) -> Function:
    """Loads a model.

    Args:
        model: The kind of model.
        weights: Its weights; the file that was exported from them lies beside them.
        engine: What runs it.
        threads: Threads it may use.

    Returns:
        The model.

    Raises:
        EngineError: onnxruntime or the exported file is missing, or the file is broken or was
            made from other weights or by another version of dosplan.
        WeightsError: The weights cannot be read.
    """
    return _OPENERS[engine](model, weights, threads)


def _open_torch(model: Model, weights: Path, threads: int) -> Function:
    from dosplan_net.graphs import TorchFunction

    return TorchFunction(model.load(weights), threads)


def _open_onnx(model: Model, weights: Path, threads: int) -> Function:
    try:
        import onnxruntime
    except ImportError:
        raise EngineError(
            'engine "onnx" needs onnxruntime: pip install "dosplan[onnx]", or choose engine "torch"'
        ) from None
    path = weights.with_suffix(model.suffix)
    remedy = f"make it with: dosplan export {model.option} {shlex.quote(str(weights))}"
    try:
        content, wanted = path.read_bytes(), model.origin(weights)
    except OSError as error:
        raise EngineError(
            f"{error.filename}: cannot be read ({error.strerror}); {remedy}"
        ) from None
    # An ONNX file cannot run code, but its tensors can name other files, or addresses in memory,
    # to take their data from. Loading from bytes does not prevent that; hence only self-contained
    # files are taken. The runtime's own format, which has other ways to do so, is refused as well.
    if _EXTERNAL in content:
        raise EngineError(f"{path}: not self-contained, it refers to other files; {remedy}")
    settings = onnxruntime.SessionOptions()
    settings.intra_op_num_threads = threads
    settings.inter_op_num_threads = 1
    settings.add_session_config_entry("session.load_model_format", "ONNX")
    try:
        session = onnxruntime.InferenceSession(
            content, settings, providers=["CPUExecutionProvider"]
        )
    except Exception as error:  # The runtime can raise almost anything.
        raise EngineError(f"{path}: not an ONNX model ({one_line(error)}); {remedy}") from None
    found = session.get_modelmeta().custom_metadata_map
    if any(found.get(key) != value for key, value in wanted.items()):
        raise EngineError(
            f"{path}: was not made from these weights by this version of dosplan; {remedy}"
        )
    # An input that a model does not use is not in its file.
    names = [entry.name for entry in session.get_inputs()]

    def run(**arrays: npt.NDArray[Any]) -> list[Float32Array]:
        outputs = session.run(None, {name: arrays[name] for name in names})
        return [np.asarray(array, dtype=np.float32) for array in outputs]

    return run


_OPENERS: Final = {Engine.TORCH: _open_torch, Engine.ONNX: _open_onnx}
