"""How dosplan and the paper are cited, made of ``CITATION.cff``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import yaml

CITATION: Final = Path(__file__).parents[1] / "CITATION.cff"


def citation_text() -> str:
    """Writes BibTeX entries of dosplan and of what it reproduces.

    Returns:
        A block of Markdown.
    """
    told = yaml.safe_load(CITATION.read_text(encoding="utf-8"))
    year = str(told["date-released"])[:4]
    software = _entry("software", "dosplan", told, year, version=str(told["version"]))
    papers = [
        _entry("misc", "dos", paper, str(paper.get("year", ""))) for paper in told["references"]
    ]
    return "\n".join(["```bibtex", *software, *(line for paper in papers for line in paper), "```"])


def _entry(kind: str, key: str, told: dict[str, Any], year: str, **others: str) -> list[str]:
    names = [
        "{" + author["name"] + "}"
        if "name" in author
        else ", ".join(filter(None, (author["family-names"], author.get("given-names"))))
        for author in told["authors"]
    ]
    fields = {"title": "{" + told["title"] + "}", "author": " and ".join(names), "year": year}
    lines = [f"  {name} = {{{value}}}," for name, value in {**fields, **others}.items() if value]
    return [f"@{kind}{{{key},", *lines, "}"]
