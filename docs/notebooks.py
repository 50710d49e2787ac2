"""Pages as notebooks: the same text and the same code, to be run piece by piece.

In a page, a piece of Python that begins with the name of a file (``# mine.py``) is that file;
commands are those of a shell; what is marked ``py`` is a fragment and stays text.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Final

PAGES: Final = ("own-planner", "reading-results")
_DOCS: Final = Path(__file__).parent
_PIECE: Final = re.compile(r"^```(python|sh)\n(.*?)^```\n?", re.DOTALL | re.MULTILINE)
_FILE: Final = re.compile(r"# (\w+\.py)\n")
_LINK: Final = re.compile(r"\[([^]]+)\]\((?![a-z]+:)[^)]*\)")


def notebook(page: str) -> str:
    """Writes a page as a notebook.

    Args:
        page: Name of a page of ``docs/``.

    Returns:
        The text of an ``.ipynb`` file, format 4.5, without outputs.
    """
    text = (_DOCS / f"{page}.md").read_text(encoding="utf-8")
    cells: list[dict[str, Any]] = []
    end = 0
    for piece in _PIECE.finditer(text):
        _add(cells, "markdown", _LINK.sub(r"\1", text[end : piece.start()]))
        _add(cells, "code", _code(piece[1], piece[2]))
        end = piece.end()
    _add(cells, "markdown", _LINK.sub(r"\1", text[end:]))
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    content = {
        "cells": cells,
        "metadata": {"kernelspec": kernel},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(content, indent=1) + "\n"


def _code(language: str, piece: str) -> str:
    if language == "sh":
        return "".join(f"!{line}\n" for line in piece.splitlines() if line.strip())
    file = _FILE.match(piece)
    return f"%%writefile {file[1]}\n{piece[file.end() :]}" if file else piece


def _add(cells: list[dict[str, Any]], kind: str, text: str) -> None:
    text = text.strip()
    if not text:
        return
    cell: dict[str, Any] = {"cell_type": kind, "id": f"piece-{len(cells)}", "metadata": {}}
    if kind == "code":
        cell |= {"execution_count": None, "outputs": []}
    cells.append({**cell, "source": text.splitlines(keepends=True)})
