"""What can become of a file: cut, garbled, of another encoding, with entities, something else."""

from __future__ import annotations

import gzip
import random
from collections.abc import Callable
from pathlib import Path
from typing import Final


def damage_bytes(rng: random.Random, data: bytes, folder: Path) -> tuple[bytes, str]:
    """Damages a text, and says how.

    Args:
        rng: The random numbers.
        data: XML.
        folder: Where a file is that must not be read (``canary``).

    Returns:
        The damaged text, and what was done to it.
    """
    change = rng.choice(_BYTES)
    return change(rng, data, folder), change.__name__.strip("_")


def damage_binary(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    """Cuts a binary file, or changes some of its bytes."""
    change = rng.choice((_cut, _flip, _flip, _garble, _repeat, _append, _nothing, _zero))
    return change(rng, data, Path()), change.__name__.strip("_")


def _cut(rng: random.Random, data: bytes, folder: Path) -> bytes:
    return data[: rng.randint(0, len(data))]


def _nothing(rng: random.Random, data: bytes, folder: Path) -> bytes:
    return rng.choice((b"", b" ", b"\0", b"\xff\xfe"))


def _flip(rng: random.Random, data: bytes, folder: Path) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 20))):
        out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _garble(rng: random.Random, data: bytes, folder: Path) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + rng.randbytes(rng.choice((1, 8, 64))) + data[at + rng.choice((0, 8)) :]


def _zero(rng: random.Random, data: bytes, folder: Path) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + bytes(len(data) - at)


def _repeat(rng: random.Random, data: bytes, folder: Path) -> bytes:
    return data + data


def _append(rng: random.Random, data: bytes, folder: Path) -> bytes:
    return data + rng.choice((b"\0" * 100, b"<a/>", b"&", b"\x1a", rng.randbytes(50)))


def _body(data: bytes) -> bytes:
    """The root element and what follows, without the declaration."""
    return data[data.index(b"<commonRoad") :]


def _recoded(rng: random.Random, data: bytes, folder: Path) -> bytes:
    text = _body(data).decode()
    some = ("utf-8", "utf-16", "utf-32", "utf-7", "latin-1", "cp037")
    told, used = rng.choice((*some, "ascii", "hz", "x")), rng.choice((*some, "utf-8-sig"))
    return f'<?xml version="1.0" encoding="{told}"?>{text}'.encode(used, errors="replace")


def _mistold(rng: random.Random, data: bytes, folder: Path) -> bytes:
    told = rng.choice(("utf-16", "shift_jis", "big5", "rot13", "hex", "zlib", "idna", "\0"))
    version = rng.choice(("1.0", "1.1", "9"))
    return f'<?xml version="{version}" encoding="{told}"?>'.encode() + _body(data)


def _laughs(rng: random.Random, data: bytes, folder: Path) -> bytes:
    rows = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 12))
    return _with_document_type(rng, data, f'<!ENTITY l0 "lol">{rows}', b"&l11;")


def _blow_up(rng: random.Random, data: bytes, folder: Path) -> bytes:
    return _with_document_type(rng, data, f'<!ENTITY l "{"a" * 50_000}">', b"&l;" * 2000)


def _external(rng: random.Random, data: bytes, folder: Path) -> bytes:
    canary = (folder / "canary").as_uri()
    address = rng.choice((canary, canary, "http://127.0.0.1:9/", str(folder / "canary"), "canary"))
    return _with_document_type(rng, data, f'<!ENTITY e SYSTEM "{address}">', b"&e;")


def _parameter(rng: random.Random, data: bytes, folder: Path) -> bytes:
    canary = (folder / "canary").as_uri()
    return _with_document_type(rng, data, f'<!ENTITY % e SYSTEM "{canary}"> %e;', b"")


def _external_type(rng: random.Random, data: bytes, folder: Path) -> bytes:
    canary = (folder / "canary").as_uri()
    return f'<!DOCTYPE commonRoad SYSTEM "{canary}">'.encode() + _body(data)


def _included(rng: random.Random, data: bytes, folder: Path) -> bytes:
    canary = (folder / "canary").as_uri()
    element = (
        f'<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="{canary}" parse="text"/>'
        f'<?xml-stylesheet type="text/xsl" href="{canary}"?><!-- {canary} -->'
    )
    at = data.index(b">", data.index(b"<commonRoad")) + 1
    return data[:at] + element.encode() + data[at:]


def _with_document_type(rng: random.Random, data: bytes, declared: str, used: bytes) -> bytes:
    tail = _body(data)
    tag = rng.choice((b"<x>", b"<velocity>", b"<exact>", b"<author>", b"</commonRoad>"))
    at = max(tail.find(tag), 0) + len(tag)
    return f"<!DOCTYPE commonRoad [{declared}]>".encode() + tail[:at] + used + tail[at:]


def _something_else(rng: random.Random, data: bytes, folder: Path) -> bytes:
    return rng.choice(
        (
            b"<html><body>404</body></html>", b"{}", b"[1, 2]", b"<a/>", b"<commonRoad/>", b"<",
            b"<CommonRoadSolution benchmark_id='x'/>", b"\x89PNG\r\n\x1a\n", b"PK\x03\x04",
            b"<commonRoad xmlns='urn:x' commonRoadVersion='2020a' benchmarkID='a'/>",
            b"<a>" * 100_000, b"<a>" * 20_000 + b"</a>" * 20_000, b"<a" + b" b='c'" * 10_000,
            b"<a " + b" ".join(b"b%d=''" % i for i in range(20_000)) + b"/>",
            gzip.compress(data, mtime=0),
            b"<commonRoad benchmarkID='" + b"x" * 1_000_000 + b"'/>", data.replace(b"\n", b"\r"),
            data.replace(b"commonRoad", b"commonroad"), data.replace(b"<", b"&lt;"),
        )
    )  # fmt: skip


_BYTES: Final[tuple[Callable[[random.Random, bytes, Path], bytes], ...]] = (
    _cut, _cut, _flip, _flip, _garble, _zero, _repeat, _append, _nothing, _recoded, _recoded,
    _mistold, _laughs, _blow_up, _external, _external, _parameter, _external_type, _included,
    _something_else, _something_else,
)  # fmt: skip
