"""What the site shows besides ``docs/``: a hook of mkdocs, named in ``mkdocs.yml``.

The same Markdown is read on a code host and on the site. There, links lead to files of the
repository. So pages outside ``docs/`` (the README, results, suites) become pages of the site,
source files that a page links to are shown as code, and other files are copied; every relative link
is turned to where its target is on the site. A link to something that does not exist stops the
build.
"""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from pymdownx.slugs import slugify

from docs.citation import citation_text
from docs.commands import commands_text
from docs.notebooks import PAGES as NOTEBOOKS
from docs.notebooks import notebook

ROOT: Final = Path(__file__).parents[1]
HOME: Final = "README.md"
PAGES: Final = (
    HOME, "CHANGELOG.md", "predictors/MODEL_CARD.md", "scenarios/**/*.md", "results/**/*.md",
    "tests/README.md",
)  # fmt: skip
"""Pages outside ``docs/``, by their paths in the repository."""
_MADE: Final = {"<!-- commands -->": commands_text, "<!-- citation -->": citation_text}
"""What stands in a page's place of a mark, made when the site is built."""
_CODE: Final = {".py": "python", ".yaml": "yaml", ".cff": "yaml", ".yml": "yaml", "": "text"}
"""Kinds of files that are shown as code, by the ends of their names."""
_ELSEWHERE: Final = re.compile(r"<!-- elsewhere -->.*?<!-- end -->\n", re.DOTALL)
"""What is said to readers of a code host alone."""
_SPAN: Final = re.compile(r"`[^`\n]+`")
_LINK: Final = re.compile(r"(?<=\]\()([^)\s]+)(?=\))")
_FENCE: Final = re.compile(r"^(`{3,})[^\n]*\n.*?^\1[ ]*$", re.DOTALL | re.MULTILINE)


def on_config(config: Any) -> Any:
    """Makes anchors as code hosts do, and lists the published runs in the navigation."""
    config["mdx_configs"].setdefault("toc", {})["slugify"] = slugify(case="lower")
    folders = sorted(path.parent.name for path in ROOT.glob("results/*/README.md"))
    for section in config["nav"]:
        section.get("Results", []).extend(f"results/{name}/README.md" for name in folders)
    return config


def on_files(files: Files, config: Any) -> Files:
    """Adds the pages outside ``docs/``, and the files that any page links to."""
    sources = {f"docs/{file.src_uri}": file for file in files.documentation_pages()}
    for path in _outside():
        file = File.generated(config, place(path), content=(ROOT / path).read_text("utf-8"))
        files.append(file)
        sources[path] = file
    for name in NOTEBOOKS:
        files.append(File.generated(config, f"{name}.ipynb", content=notebook(name)))
    linked = {target for path in sources for target in repository_links(path)}
    for path in sorted(linked - sources.keys()):
        if not (ROOT / path).is_file():
            continue  # The link's page tells.
        kind = _CODE.get(Path(path).suffix)
        if kind is None:
            files.append(File.generated(config, place(path), abs_src_path=str(ROOT / path)))
        else:
            code = (ROOT / path).read_text(encoding="utf-8")
            page = f"---\nsearch:\n  exclude: true\n---\n# {path}\n\n````{kind}\n{code}\n````\n"
            files.append(File.generated(config, place(path), content=page))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Turns links to where their targets are on the site, and fills in what is made here."""
    here = page.file.src_uri
    if here.startswith("source/"):
        return markdown
    source = repository_path(here)
    markdown = _ELSEWHERE.sub("", markdown)
    for mark, make in _MADE.items():
        if mark in markdown:
            markdown = markdown.replace(mark, make())

    def change(text: str) -> str:
        # In tables, code hosts want a bar in code escaped, and the site shows the backslash.
        text = _SPAN.sub(lambda m: m[0].replace("\\|", "|"), text)
        return _LINK.sub(lambda m: _turned(m[0], source), text)

    markdown = outside_code(markdown, change)
    name = here.removesuffix(".md")
    if name in NOTEBOOKS:
        title, rest = markdown.split("\n", 1)
        link = f"[This page as a notebook]({name}.ipynb){{ download }}"
        markdown = f"{title}\n\n{link}\n{rest}"
    return markdown


def place(path: str) -> str:
    """Tells where the site has a file of the repository.

    Args:
        path: Its path in the repository.

    Returns:
        Its path among the site's sources.
    """
    if path == HOME:
        return "index.md"
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    if path.endswith(".md"):
        return path
    return f"source/{path}.md" if Path(path).suffix in _CODE else path


def repository_path(uri: str) -> str:
    """Tells which file of the repository a page of the site is made of.

    Args:
        uri: The page's path among the site's sources.

    Returns:
        The file's path in the repository.
    """
    if uri == "index.md":
        return HOME
    return f"docs/{uri}" if (ROOT / "docs" / uri).is_file() else uri


def repository_links(path: str) -> set[str]:
    """Finds the files that a page links to.

    Args:
        path: The page's path in the repository.

    Returns:
        Their paths; of a folder, the README in it.
    """
    found: list[str] = []

    def collect(text: str) -> str:
        found.extend(_LINK.findall(text))
        return text

    outside_code((ROOT / path).read_text(encoding="utf-8"), collect)
    return {_target(link, path)[0] for link in found if _is_relative(link)}


def outside_code(markdown: str, change: Callable[[str], str]) -> str:
    """Changes what stands outside fenced code.

    Args:
        markdown: The text of a page.
        change: Makes one text of another.

    Returns:
        The changed page.
    """
    parts, end = [], 0
    for fence in _FENCE.finditer(markdown):
        parts += [change(markdown[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join([*parts, change(markdown[end:])])


def _outside() -> list[str]:
    found = (path for pattern in PAGES for path in ROOT.glob(pattern))
    return sorted(path.relative_to(ROOT).as_posix() for path in found)


def _is_relative(link: str) -> bool:
    return not re.match(r"[a-z]+:|#", link)


def _target(link: str, source: str) -> tuple[str, str]:
    """The file in the repository that a link of a page leads to, and the anchor in it."""
    path, _, anchor = link.partition("#")
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
    if (ROOT / path).is_dir():
        path = f"{path}/README.md"
    return path, anchor


def _turned(link: str, source: str) -> str:
    if not _is_relative(link):
        return link
    path, anchor = _target(link, source)
    if not (ROOT / path).is_file():
        raise PluginError(f"{source}: the link {link} leads to nothing; mend or remove it")
    here = posixpath.dirname(place(source))
    return os.path.relpath(place(path), here or ".") + (f"#{anchor}" if anchor else "")
