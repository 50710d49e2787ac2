"""The model card names every weight file that ships, and what it holds."""

from __future__ import annotations

import re
from hashlib import sha256
from pathlib import Path

PREDICTORS = Path(__file__).parents[2] / "predictors"


def test_the_card_names_every_weight_file_with_its_digest() -> None:
    shipped = {
        path.relative_to(PREDICTORS).as_posix(): sha256(path.read_bytes()).hexdigest()
        for path in PREDICTORS.glob("*/weights/*")
        if path.suffix in (".safetensors", ".npz")
    }
    card = (PREDICTORS / "MODEL_CARD.md").read_text(encoding="utf-8")
    assert dict(re.findall(r"^\| `([^`]+)` \|[^|]*\| `([0-9a-f]{64})` \|$", card, re.M)) == shipped


def test_the_weights_are_small_enough_to_ship() -> None:
    assert sum(path.stat().st_size for path in PREDICTORS.glob("*/weights/*")) < 10_000_000
