"""The published pictures: each figure shows the results that are published now."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from PIL import Image

from dosplan.report.figures import FIGURES
from dosplan.report.figures.sources import Published
from dosplan.report.figures.write import shown_digest, write_figure

RESULTS = Path(__file__).parents[2] / "results"
PICTURES = RESULTS / "pictures"
REMAKE = "dosplan figures {} --out results/pictures"


def _held(path: Path) -> str | None:
    with Image.open(path) as picture:
        return picture.info.get("Description")


@pytest.mark.parametrize("path", sorted(PICTURES.glob("*.png")), ids=lambda path: path.stem)
def test_no_figure_is_older_than_the_results_it_shows(path: Path) -> None:
    assert path.stem in FIGURES
    remake = REMAKE.format(path.stem)
    assert _held(path) == shown_digest(path.stem, Published(RESULTS)), f"make it anew: {remake}"


def test_the_pictures_are_those_that_their_page_tells_how_to_make() -> None:
    page = (PICTURES / "README.md").read_text("utf-8")
    (command,) = re.findall(r"`dosplan figures ([^`]*) --out results/pictures`", page)
    assert {f"{name}.png" for name in command.split()} == {
        path.name for path in PICTURES.glob("*.png")
    }


def test_a_figure_of_other_results_is_found_out(tmp_path: Path) -> None:
    shutil.copytree(RESULTS / "prediction", tmp_path / "results" / "prediction")
    published = Published(tmp_path / "results")
    png, pdf = write_figure("upper-limits", published, tmp_path)
    shown = shown_digest("upper-limits", published)
    assert _held(png) == shown
    assert shown.encode() in pdf.read_bytes()
    with published.evaluation_file("prediction").open("a") as file:
        file.write("\n")
    assert _held(png) != shown_digest("upper-limits", published)
