"""Draws figures and writes them."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from dosplan.report.figures.sources import Published
from dosplan.report.figures.style import save, styled


def write_figure(name: str, published: Published, out: Path) -> tuple[Path, Path]:
    """Draws a figure and writes it as PNG and as PDF.

    Args:
        name: One of ``dosplan.report.figures.FIGURES``.
        published: The results that it shows.
        out: Folder of the files; it is made.

    Returns:
        The PNG and the PDF.

    Raises:
        FileError: Results are missing or broken, or a file cannot be written.
        RegistryError: The shipped predictor cannot be built.
        ScenarioError: The embedded suite cannot be read.
    """
    module = import_module(f"dosplan.report.figures.{name.replace('-', '_')}")
    with styled():
        return save(module.draw(published), out, name)
