"""What a training is made from: nothing else goes on from its checkpoint or counts as its result.

A checkpoint and the weights at the end keep it, as a dict that JSON can hold: the settings, digests
of the caches in order, and digests of the weights that it begins from or rests on.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from dosplan_net.weights import WeightsError, load_weights

MADE_FROM: Final = "made_from"
"""Under what name checkpoints and weights keep it."""

MadeFrom = dict[str, Any]


def describe_training(**parts: Any) -> MadeFrom:
    """Describes a training by what decides its result.

    Args:
        parts: Settings and digests by name; values that JSON can hold.

    Returns:
        The parts as they come back from a file: lists in place of tuples, say.
    """
    described: MadeFrom = json.loads(json.dumps(parts))
    return described


def file_digest(path: Path) -> str:
    """Digest of a weight file.

    Args:
        path: The file.

    Returns:
        Its SHA-256.

    Raises:
        WeightsError: It cannot be read.
    """
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise WeightsError(
            f"{path}: not readable as weights ({error.strerror}); "
            "fetch the file again or train it with dosplan train"
        ) from None


def require_same(
    file: Path, kept: Mapping[str, Any], wanted: Mapping[str, Any], remedy: str
) -> None:
    """Refuses a file that was made from anything else than is wanted.

    Args:
        file: A checkpoint or weights.
        kept: What it holds beside the tensors.
        wanted: The parts that have to be the same.
        remedy: What to do, for the message.

    Raises:
        WeightsError: It does not say what it was made from, or a part differs.
    """
    if MADE_FROM not in kept:
        raise WeightsError(f"{file}: does not say what it was trained from; {remedy}")
    there, here = _flat(kept[MADE_FROM]), _flat(wanted)
    differ = [name for name, value in here.items() if name not in there or there[name] != value]
    if differ:
        raise WeightsError(f"{file}: was trained with other {', '.join(differ)}; {remedy}")


def trained_already(
    target: Path, model: str, made_from: MadeFrom, folder: Path
) -> dict[str, float] | None:
    """Looks whether a training is done.

    Args:
        target: The weights that it writes.
        model: The kind of model, as for ``load_weights``.
        made_from: What it is made from.
        folder: Where its checkpoint lies.

    Returns:
        The figures of its best validation; None where there are no weights yet.

    Raises:
        WeightsError: The weights cannot be read, or were made from anything else.
    """
    if not target.is_file():
        return None
    _, about = load_weights(target, model)
    require_same(target, about, made_from, f"name another --out, or delete it and {folder}")
    figures: dict[str, float] = about["validation"]
    return figures


def _flat(parts: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """The parts with those of dicts among them by names such as ``fit.steps``."""
    found: dict[str, Any] = {}
    for name, value in parts.items():
        inner = _flat(value, f"{before}{name}.") if isinstance(value, dict) else None
        found |= {f"{before}{name}": value} if inner is None else inner
    return found
