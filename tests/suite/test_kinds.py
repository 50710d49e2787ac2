"""The kinds of scenes say what they are."""

from __future__ import annotations

import csv
import re
from collections import Counter

import pytest

pytest.importorskip("sumo", reason="needs dosplan[suite]")

from kinds import SUITE, with_table
from suitegen.futures.build import places
from suitegen.futures.kinds import KINDS


def test_codes_and_names_are_unique_and_fit_for_ids() -> None:
    assert all(code == kind.code for code, kind in KINDS.items())
    assert len({kind.name for kind in KINDS.values()}) == len(KINDS)
    assert all(re.fullmatch(r"[A-Z][A-Za-z]+", code) for code in KINDS)


def test_each_kind_says_all_of_itself() -> None:
    for kind in KINDS.values():
        texts = (kind.name, kind.description, kind.intentions, kind.interplan, kind.new)
        assert all(text and "\n" not in text and "|" not in text for text in texts), kind.code


def test_the_page_has_the_table_of_kinds() -> None:
    page = (SUITE / "README.md").read_text(encoding="utf-8")
    assert with_table(page) == page, "run: python scenarios/kinds.py"


def test_a_suite_has_ten_of_each_of_at_least_fifteen_kinds() -> None:
    count = Counter(place.kind for place in places("suite", 150, list(KINDS)))
    assert len(count) >= 15
    assert max(count.values()) == 10


def test_no_kind_has_more_in_the_shipped_suite_than_another() -> None:
    with (SUITE / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        count = Counter(row["kind"] for row in csv.DictReader(stream))
    assert set(count) <= {kind.name for kind in KINDS.values()}
    assert len(set(count.values())) == 1
