"""The site is whole: every link leads somewhere, and everything that it shows is on it."""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

from dosplan.cli.main import make_parser

pytest.importorskip("mkdocs", reason="the extra docs is not installed")
pytest.importorskip("mkdocstrings", reason="the extra docs is not installed")

from mkdocs.exceptions import PluginError

from docs.notebooks import PAGES as NOTEBOOKS
from docs.site import on_page_markdown

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as `make docs` does; any warning ends that."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr, done.stderr
    return folder


def test_every_page_of_docs_is_reached_from_the_navigation(site: Path) -> None:
    shown = set(re.findall(r'href="([^"#:]+\.html)"', (site / "index.html").read_text("utf-8")))
    pages = {path.relative_to(ROOT / "docs") for path in (ROOT / "docs").rglob("*.md")}
    assert {path.with_suffix(".html").as_posix() for path in pages} <= shown
    for name in NOTEBOOKS:
        assert (site / f"{name}.ipynb").is_file()
        assert f'href="{name}.ipynb"' in (site / f"{name}.html").read_text("utf-8")
    results = {path.parent.name for path in ROOT.glob("results/*/README.md")}
    assert {f"results/{name}/index.html" for name in results} <= shown


def test_nothing_is_fetched_from_elsewhere(site: Path) -> None:
    tag = r'<(?:script|img|iframe|link rel="stylesheet")'
    fetched = re.compile(tag + r'[^>]*(?:src|href)="(?:https?:)?//')
    styled = re.compile(r'(?:@import|url\()\s*["\']?(?:https?:)?//')
    for path in site.rglob("*.html"):
        assert not fetched.search(path.read_text(encoding="utf-8")), path
    for path in site.rglob("*.css"):
        assert not styled.search(path.read_text(encoding="utf-8")), path


def test_every_command_with_every_option_is_on_its_page(site: Path) -> None:
    page = (site / "commands.html").read_text(encoding="utf-8")
    parsers = list(_parsers(make_parser()))
    assert parsers
    for parser in parsers:
        assert f'id="{parser.prog.replace(" ", "-")}"' in page, parser.prog
        for name in parser._option_string_actions:
            assert name in ("-h", "--help") or f"<code>{name}" in page, (parser.prog, name)


@pytest.mark.parametrize(
    "module", ["dosplan", "dosplan.types", "dosplan.vehicle", "dosplan.geometry"]
)
def test_every_public_name_is_in_the_reference(site: Path, module: str) -> None:
    page = (site / "api" / f"{module.rpartition('.')[2]}.html").read_text(encoding="utf-8")
    for name in import_module(module).__all__:
        assert f'id="{module}.{name}"' in page, name


def test_no_mark_of_markdown_is_left_in_a_text(site: Path) -> None:
    # Code hosts take a list without an empty line before it, and the site does not.
    for path in site.rglob("*.html"):
        article = path.read_text(encoding="utf-8").partition("<article")[2]
        article = re.sub(r"<(pre|code)\b.*?</\1>", "", article, flags=re.DOTALL)
        for text in re.findall(r"<p>(.*?)</p>", article, re.DOTALL):
            left = re.search(r"^\s*(?:[-*] |\d+\. |\|)|```|\]\(|\*\*", text, re.MULTILINE)
            assert not left, (path, text)


def test_what_is_for_readers_elsewhere_is_left_out_and_bars_are_bars() -> None:
    page = SimpleNamespace(file=SimpleNamespace(src_uri="loop.md"))
    text = "a\n<!-- elsewhere -->\nb\n<!-- end -->\nc `x\\|y`\n```sh\necho `a \\| b`\n```\n"
    assert on_page_markdown(text, page) == "a\nc `x|y`\n```sh\necho `a \\| b`\n```\n"


def test_a_link_to_nothing_stops_the_build() -> None:
    page = SimpleNamespace(file=SimpleNamespace(src_uri="loop.md"))
    turned = on_page_markdown("[a](traffic.md#futures), [b](../results/loop/)", page)
    assert turned == "[a](traffic.md#futures), [b](results/loop/README.md)"
    with pytest.raises(PluginError, match=r"docs/loop.md: the link gone.md leads to nothing"):
        on_page_markdown("[a](gone.md)", page)


def _parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield command
                yield from _parsers(command)
