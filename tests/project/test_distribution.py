"""What the package index gets: a description that stands alone, and a release without secrets."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from readme_renderer import markdown

from hatch_build import LongDescription, with_whole_links

ROOT = Path(__file__).parents[2]
PLACE = "https://example.org/it"


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    with (ROOT / "pyproject.toml").open("rb") as stream:
        return tomllib.load(stream)


def test_links_and_pictures_are_whole_and_code_is_left_alone() -> None:
    page = (
        "[a](docs/a.md#part) ![b](results/b.gif) [c](https://c.org) [d](#part) `x[0](y)`\n"
        "```sh\n[e](e.md)\n```\n[f](f.md)"
    )
    assert with_whole_links(page, PLACE) == (
        f"[a]({PLACE}/blob/main/docs/a.md#part) ![b]({PLACE}/raw/main/results/b.gif) "
        f"[c](https://c.org) [d]({PLACE}#part) `x[0]({PLACE}/blob/main/y)`\n"
        f"```sh\n[e](e.md)\n```\n[f]({PLACE}/blob/main/f.md)"
    )


def test_the_long_description_renders_and_every_link_has_its_file(project: dict[str, Any]) -> None:
    metadata = {"urls": project["project"]["urls"]}
    LongDescription(str(ROOT), {}).update(metadata)
    readme: dict[str, str] = metadata["readme"]
    assert readme["content-type"] == "text/markdown"
    shown = markdown.render(readme["text"])
    assert shown is not None
    assert re.search("<h1[^>]*>dosplan<", shown)
    linked = re.findall(r'(?:href|src)="(?!#user-content)([^"]*)"', shown)
    assert all(link.startswith("https://") for link in linked)
    place = f"{project['project']['urls']['Repository']}/"
    inside = [link.removeprefix(place) for link in linked if link.startswith(place)]
    files = [re.sub("^(blob|raw)/main/", "", link).partition("#")[0] for link in inside]
    assert files
    assert [file for file in files if file and not (ROOT / file).exists()] == []


def test_all_that_a_wheel_is_built_from_is_in_the_source_distribution(
    project: dict[str, Any],
) -> None:
    build = project["tool"]["hatch"]["build"]
    assert build["targets"]["sdist"]["include"].count("/hatch_build.py") == 1
    tops = {name.strip("/") for name in build["targets"]["sdist"]["include"]}
    wheel = build["targets"]["wheel"]
    for place in (*wheel["packages"], *wheel["force-include"]):
        assert place.partition("/")[0] in tops
        assert (ROOT / place).exists()


def test_a_release_is_built_checked_installed_and_published_without_a_secret(
    project: dict[str, Any],
) -> None:
    text = (ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8")
    flow = yaml.safe_load(text)
    assert "secrets." not in text
    assert "password" not in text.replace("without a password", "")
    jobs = flow["jobs"]
    assert [jobs[name].get("needs") for name in jobs] == [None, "build", "install"]
    assert any(step.get("run") == "make dist" for step in jobs["build"]["steps"])
    versions = [
        name.rpartition(" ")[2]
        for name in project["project"]["classifiers"]
        if re.search(r":: 3\.\d+$", name)
    ]
    assert jobs["install"]["strategy"]["matrix"]["python"] == versions
    may_write = {name for name, job in jobs.items() if "write" in str(job.get("permissions"))}
    assert may_write == {"publish"}
    assert jobs["publish"]["permissions"] == {"id-token": "write"}
    (address,) = re.findall(r"^Repository = .*$", (ROOT / "pyproject.toml").read_text(), re.M)
    assert re.fullmatch(r'Repository = "https://github\.com/[\w-]+/[\w-]+"', address)
