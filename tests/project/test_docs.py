"""What the documentation says of the code is made from the code."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docs.schema import METRICS_PAGE, PAGE, metrics_page, page_with_tables
from dosplan.plugins.loops import record_loop
from dosplan.simulation.settings import IDEAL, REALISTIC


def test_the_keys_of_a_run_folder_are_those_of_the_dataclasses() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert page == page_with_tables(page), "run: python docs/schema.py"
    links = set(re.findall(r"\]\(#([\w-]+)\)", page))
    assert links <= set(re.findall(r'<a id="([\w-]+)">', page))


def test_the_metrics_are_those_of_the_table() -> None:
    assert METRICS_PAGE.read_text(encoding="utf-8") == metrics_page(), "run: python docs/schema.py"


def test_the_page_of_the_loop_has_every_setting_and_its_realistic_value() -> None:
    page = Path(PAGE).with_name("loop.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w.]+)`: .*\| (\S+) \| (\S+) \|$", page, re.MULTILINE)
    told = {name: (ideal, realistic) for name, ideal, realistic in rows}
    words: dict[Any, str] = {True: "yes", False: "no", None: "all"}
    meant = [
        {
            name: f"{value:g}" if isinstance(value, float) else words[value]
            for name, value in _leaves(record_loop(loop))
        }
        for loop in (IDEAL, REALISTIC)
    ]
    assert told.keys() == meant[0].keys()
    for name, (ideal, realistic) in told.items():
        assert realistic == meant[1][name], name
        assert ideal in ("-", meant[0][name]), name


def _leaves(settings: dict[str, Any], inside: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in settings.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{inside}{name}.")
        else:
            yield f"{inside}{name}", value
