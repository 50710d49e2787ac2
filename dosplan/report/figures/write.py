"""Draws figures and writes them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType

from dosplan.report.figures import FRONTIER, frontier
from dosplan.report.figures.sources import Published
from dosplan.report.figures.style import save, styled
from dosplan.results.table import make_table
from dosplan.results.table_text import cautions
from dosplan.system.provenance import content_digest


def shown_digest(name: str, published: Published) -> str:
    """Fingerprints what a figure shows; the figure's files hold it as their description.

    Args:
        name: One of ``dosplan.report.figures.FIGURES``.
        published: The results that it shows.

    Returns:
        ``content_digest`` of its files.

    Raises:
        RegistryError: The shipped predictor cannot be built.
        ScenarioError: The embedded suite cannot be read.
    """
    return content_digest(_module(name).sources(published))


def write_figure(name: str, published: Published, out: Path) -> tuple[Path, Path]:
    """Draws a figure and writes it as PNG and as PDF, with ``shown_digest`` as its description.

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
    shown = shown_digest(name, published)
    with styled():
        return save(_module(name).draw(published), out, name, shown)


def write_frontier(specs: Sequence[str], out: Path) -> tuple[Path, Path, list[str]]:
    """Draws the frontier of runs and writes it as PNG and as PDF.

    Args:
        specs: Run folders and folders of sweeps, as ``dosplan.results.table`` takes them.
        out: Folder of the files; it is made.

    Returns:
        The PNG, the PDF, and what of the runs is not as it looks, a line each.

    Raises:
        CompareError: The runs are not of one world and the same scenarios, or none is finished.
        FileError: A run cannot be read, or a file cannot be written.
    """
    table = make_table(specs, columns=frontier.COLUMNS)
    with styled():
        return *save(frontier.draw(table), out, FRONTIER), cautions(table)


def _module(name: str) -> ModuleType:
    return import_module(f"dosplan.report.figures.{name.replace('-', '_')}")
