"""What the documentation says of the code is made from the code."""

from __future__ import annotations

from docs.schema import CLASSES, METRICS_PAGE, PAGE, metrics_page, page_with_tables


def test_the_keys_of_a_run_folder_are_those_of_the_dataclasses() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert page == page_with_tables(page), "run: python docs/schema.py"
    for kind in CLASSES:
        assert f"](#{kind.__name__.lower()})" not in page or f'id="{kind.__name__.lower()}"' in page


def test_the_metrics_are_those_of_the_table() -> None:
    assert METRICS_PAGE.read_text(encoding="utf-8") == metrics_page(), "run: python docs/schema.py"
