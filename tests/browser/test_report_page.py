"""The page in a real browser: no complaint, the filter filters, the player moves.

Needs playwright (``pip install playwright``; its own browsers are not used) and a Chromium.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from dosplan.cli import main as cli
from dosplan.cli.main import main
from tests.support.plugins import PLUGINS
from tests.support.scenes import Goal, Problem, User, driving, rectangle, write_scenario_xml

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
playwright.expect.set_options(timeout=120_000)  # A busy machine is slow to draw.

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "chrome"))), None)
LAPTOP = {"width": 1366, "height": 768}
PHONE = {"width": 390, "height": 844}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine"),
]

# In one go: on a busy machine the short drive would be over before a second key arrives.
_PRESS_SPACE_TWICE = """[1, 2].map(() => {
  document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key: " ", bubbles: true }));
  return document.querySelector(".play").getAttribute("aria-label");
})"""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a free road and of one on which a car stands in the way."""
    folder = tmp_path_factory.mktemp("pages")
    goal = Goal(first_step=0, last_step=20, position=rectangle(6.0, 3.0, 28.0, 0.0))
    for name, user in (
        ("ZAM_Free-1_1_T-1", User(7, driving(60.0, 0.0, 10.0, 40))),
        ("ZAM_Hit-1_1_T-1", User(8, driving(28.0, 0.0, 0.0, 40))),
    ):
        problems = [Problem(goals=(goal,))]
        path = folder / "scenes" / f"{name}.xml"
        path.parent.mkdir(exist_ok=True)
        write_scenario_xml(path, users=[user], problems=problems, benchmark_id=name)
    _drive(folder, "run", f"{PLUGINS}:CoastPlanner")
    return folder / "run" / "report.html"


@pytest.fixture(scope="module")
def of_several(report: Path) -> Path:
    """The page of that run and of one that brakes for the car."""
    folder = report.parent.parent
    _drive(folder, "idm", "idm", "--with-dos")
    page = folder / "several.html"
    runs = [str(folder / name) for name in ("run", "idm")]
    assert main(["report", *runs, "--out", str(page)]) == cli.OK
    return page


def _drive(folder: Path, name: str, planner: str, *more: str) -> None:
    plugins = ["--planner", planner, "--predictor", "growing-circle"]
    out = ["--workers", "1", "--out", str(folder / name)]
    assert main(["run", str(folder / "scenes"), *plugins, *out, *more]) == cli.OK


@contextmanager
def _browser(path: Path, **context: Any) -> Iterator[Any]:
    """A page; whatever the browser complains of fails the test."""
    complaints: list[str] = []
    with playwright.sync_playwright() as driver:
        arguments = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=arguments)
        page = browser.new_page(**{"viewport": LAPTOP, "color_scheme": "light"} | context)
        page.set_default_timeout(120_000)
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: complaints.extend(_outside(request.url)))
        page.goto(path.as_uri())
        yield page
        browser.close()
    assert complaints == []


@pytest.fixture
def opened(report: Path) -> Iterator[Any]:
    """The page of one run."""
    with _browser(report) as page:
        yield page


def _outside(url: str) -> list[str]:
    return [] if url.startswith(("file:", "data:", "blob:")) else [f"asked for {url}"]


def _ids(page: Any) -> list[str]:
    found: list[str] = page.locator("table.cases tbody .open").all_text_contents()
    return found


def _pixels(page: Any) -> str:
    drawn: str = page.evaluate("document.querySelector('.stage > canvas').toDataURL()")
    return drawn


def test_the_filter_filters_and_the_headings_sort(opened: Any) -> None:
    assert _ids(opened) == ["ZAM_Hit-1_1_T-1", "ZAM_Free-1_1_T-1"]
    opened.get_by_role("button", name="Scenario").first.click()
    assert _ids(opened) == ["ZAM_Free-1_1_T-1", "ZAM_Hit-1_1_T-1"]
    opened.fill("input[type=search]", "which stood")
    assert _ids(opened) == ["ZAM_Hit-1_1_T-1"]
    opened.fill("input[type=search]", "")
    opened.select_option("select[name=outcome-1]", "success")
    assert _ids(opened) == ["ZAM_Free-1_1_T-1"]
    opened.click("[data-change='both failed']")  # A way from the result; it clears the rest.
    assert _ids(opened) == ["ZAM_Hit-1_1_T-1"]
    assert opened.text_content(".filters output") == "1 of 2"
    group = opened.locator("[data-text]").first  # A way from a kind of road, likewise.
    group.click()
    assert opened.input_value("input[type=search]") == group.text_content()
    assert opened.text_content(".filters output") == "2 of 2"


def test_the_player_moves_and_obeys_the_keyboard(opened: Any) -> None:
    opened.locator(".open", has_text="ZAM_Hit").focus()
    opened.keyboard.press("Enter")
    opened.wait_for_selector("dialog[open]")
    # Not wait_for_function: it evaluates text, which the page's policy forbids.
    playwright.expect(opened.locator(".clock")).not_to_contain_text("0.0 of")
    opened.keyboard.press("Home")
    assert opened.text_content(".clock").startswith("0.0 of 1.")
    assert opened.evaluate(_PRESS_SPACE_TWICE) == ["Pause", "Play"]
    first = _pixels(opened)
    opened.keyboard.press("ArrowRight")
    assert opened.text_content(".clock").startswith("0.1 of 1.")
    assert _pixels(opened) != first
    opened.keyboard.press("End")
    assert "ran into car 8" in opened.text_content(".sides")
    opened.keyboard.press("n")
    playwright.expect(opened.locator("dialog h2")).to_have_text("ZAM_Free-1_1_T-1")
    assert opened.url.endswith("#ZAM_Free-1_1_T-1")
    opened.keyboard.press("Escape")
    assert opened.locator("dialog[open]").count() == 0


def test_layers_are_switched_off_one_by_one(opened: Any) -> None:
    opened.emulate_media(reduced_motion="reduce")  # Opens without playing.
    opened.locator(".open", has_text="ZAM_Hit").click()
    opened.wait_for_selector("dialog[open]")
    before = _pixels(opened)
    for name in ("sets", "plan", "driven path", "without DOS", "with DOS"):
        opened.get_by_label(name, exact=True).uncheck()
        after = _pixels(opened)
        # Both arms drive the same here, so that one may hide the other.
        assert after != before or name == "without DOS"
        before = after


def test_light_and_dark_and_the_width_of_a_laptop(opened: Any) -> None:
    def paper() -> str:
        found: str = opened.evaluate("getComputedStyle(document.body).backgroundColor")
        return found

    light = paper()
    opened.click("#theme")
    dark = paper()
    assert light != dark
    opened.emulate_media(color_scheme="dark")
    assert paper() == dark
    width = opened.evaluate("document.documentElement.scrollWidth")
    assert width <= LAPTOP["width"]


def test_a_link_opens_its_episode(opened: Any, report: Path) -> None:
    opened.goto("about:blank")
    opened.goto(f"{report.as_uri()}#ZAM_Free-1_1_T-1")
    opened.wait_for_selector("dialog[open]")
    assert opened.text_content("dialog h2") == "ZAM_Free-1_1_T-1"


def test_any_two_arms_are_chosen_and_watched_over_each_other(of_several: Path) -> None:
    with _browser(of_several, reduced_motion="reduce") as page:
        headings = page.locator("table.cases thead button").all_text_contents
        answer = page.locator(".answer:visible")
        assert {"run without DOS", "run with DOS"} <= set(headings())
        assert "on run with DOS, in" in answer.text_content()
        page.select_option("select[name=view]", "1-2")
        assert {"run with DOS", "idm with DOS"} <= set(headings())
        assert "run without DOS" not in headings()
        assert "on idm with DOS, in" in answer.text_content()
        assert page.locator(".filters label:visible", has_text="run without DOS").count() == 0
        assert page.text_content(".filters output") == "2 of 2"
        page.locator(".open", has_text="ZAM_Hit").click()
        page.wait_for_selector("dialog[open]")
        assert page.locator(".side:visible b").all_text_contents() == [
            "run with DOS",
            "idm with DOS",
        ]
        page.keyboard.press("End")
        before = _pixels(page)
        page.get_by_label("idm with DOS", exact=True).uncheck()
        assert _pixels(page) != before
        # A third one can be switched on, too.
        page.get_by_label("run without DOS", exact=True).check()
        assert page.locator(".side:visible b").count() == 3


@pytest.mark.parametrize("viewport", [PHONE, {"width": 768, "height": 900}, LAPTOP])
def test_nothing_is_wider_than_the_screen(of_several: Path, viewport: dict[str, int]) -> None:
    with _browser(of_several, viewport=viewport, reduced_motion="reduce") as page:

        def width() -> int:
            found: int = page.evaluate("document.documentElement.scrollWidth")
            return found

        assert width() <= viewport["width"]
        page.locator(".open", has_text="ZAM_Hit").click()
        page.wait_for_selector("dialog[open]")
        assert width() <= viewport["width"]
        canvas = page.locator(".stage > canvas").bounding_box()
        assert canvas["width"] > 0.5 * viewport["width"]
        assert canvas["height"] > 0.3 * viewport["height"]
        controls = page.locator(".controls").bounding_box()
        assert controls["y"] + controls["height"] <= viewport["height"]


def test_what_is_printed_is_dark_on_white_and_whole(of_several: Path) -> None:
    with _browser(of_several, color_scheme="dark") as page:
        page.emulate_media(media="print")
        paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert paper == "rgb(255, 255, 255)"
        assert page.locator(".filters:visible, #theme:visible").count() == 0
        inner, outer = page.evaluate(
            "(({ scrollHeight, clientHeight }) => [scrollHeight, clientHeight])"
            "(document.querySelector('.scroll.cases'))"
        )
        assert inner <= outer
