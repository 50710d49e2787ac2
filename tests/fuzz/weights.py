"""Cases of damaged weight files and calibrations: refused in one line when a predictor is built."""

from __future__ import annotations

import json
import random
import shutil
import struct
from typing import Any, Final

import numpy as np
from dosplan_dos.predictor import shipped_sets
from dosplan_net.encoder import shipped_weights

from dosplan.plugins.registry import RegistryError, create_predictor
from tests.fuzz.byte_damage import damage_binary
from tests.fuzz.harness import Case, check_message

_VALUES: Final[tuple[Any, ...]] = (
    None, 0, -1, 1.5, "x", "", [], {}, True, 10**30, "F64", "BOOL", [1], [2**62, 2], [0, 0],
    [10**9, 10**9], [-1], "\ud800", "[" * 100_000, "[]", "null", "1", '{"model": 1}',
)  # fmt: skip


def damaged_weights(case: Case) -> None:
    """Weights of the network or of the sets that are cut, changed or something else."""
    option, shipped = case.random.choice(
        (("network", shipped_weights()), ("sets", shipped_sets("coverage")))
    )
    path = case.folder / "mine.safetensors"
    kind = case.random.randrange(6)
    if kind == 0:
        other = {"network": shipped_sets("free"), "sets": shipped_weights()}[option]
        data, case.about = other.read_bytes(), "weights of something else"
    elif kind == 1:
        data = case.random.choice((b"PK\x03\x04", b"\x80\x04.", b"{}", bytes(8), b"\xff" * 16))
        case.about = f"another kind of file, {data!r}"
    elif kind == 2:  # What is damaged in the figures themselves, nobody can tell.
        whole = shipped.read_bytes()
        data = whole[: case.random.randrange(len(whole))]
        case.about = f"cut at {len(data)}"
    else:
        data, case.about = _with_other_header(case.random, shipped.read_bytes())
    path.write_bytes(data)
    if data != shipped.read_bytes():
        _refused({option: path})


def damaged_calibrations(case: Case) -> None:
    """The figures that the sets are calibrated with."""
    weights = shipped_sets("coverage")
    path = case.folder / "mine.safetensors"
    shutil.copy(weights, path)
    options: dict[str, object] = {"sets": path, "coverage": 0.9}
    calibration = path.with_suffix(".calibration.npz")
    shipped = weights.with_suffix(".calibration.npz")
    if case.random.random() < 0.6:
        whole = shipped.read_bytes()
        data, case.about = damage_binary(case.random, whole)
        calibration.write_bytes(data)
        try:  # What is added behind an archive does not hurt it.
            create_predictor("dos", 0, options)
        except RegistryError as error:
            check_message(str(error))
        return
    with np.load(shipped) as file:
        arrays: dict[str, Any] = dict(file)
    name = case.random.choice(sorted(name for name in arrays if name.startswith("per_step")))
    arrays[name] = case.random.choice(
        (np.zeros(0), np.zeros((1, 1, 1, 1)), np.array("x"), np.full((3, 3), np.nan))
    )
    case.about = f"{name}: {arrays[name]!r}"
    np.savez_compressed(calibration, **arrays)
    _refused(options)


def _refused(options: dict[str, object]) -> None:
    try:
        create_predictor("dos", 0, options)
    except RegistryError as error:
        check_message(str(error))
    else:
        raise AssertionError("was taken")


def _with_other_header(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    """The same figures under another description."""
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    name = rng.choice(("__metadata__", "__metadata__", *header))
    part = header[name]
    if rng.random() < 0.2:
        del header[name]
        about = f"without {name}"
    else:
        key, value = rng.choice(sorted(part)), rng.choice(_VALUES)
        part[key] = value
        about = f"{name}.{key} is {value!r:.50}"
    text = json.dumps(header).encode()
    told = rng.choice((len(text),) * 5 + (0, 2**40, len(text) - 1))
    return struct.pack("<Q", told) + text + data[8 + length :], about
