"""The page in headless Chromium: it draws without an error, asks for nothing, and answers to mouse and keyboard."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.conftest import demo as demo
from tests.integration.conftest import finished_run as finished_run
from tests.integration.test_review import cloud as cloud
from tests.integration.test_review import reviewed as reviewed
from tests.integration.test_review_page import data_of, decided
from tests.integration.test_statement import saved
from tests.tiler.report import results
from tests.waiting import PATIENCE_SECONDS
from tiler.apps.review import write_review_page
from tiler.apps.statement import write_statement
from tiler.report.html import write_report

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = [pytest.mark.slow, pytest.mark.processes]
CHROMIUM = (
    shutil.which("chromium")
    or shutil.which("chromium-browser")
    or shutil.which("google-chrome")
)

FRAMES_OF_A_DRAG = 20
PATIENCE_MS = 1000 * PATIENCE_SECONDS
READY = "html[data-ready=yes]"
SHARE_PAINTED = """() => {
  const canvas = document.getElementById("canvas");
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const pixels = copy.getImageData(0, 0, canvas.width, canvas.height).data;
  let painted = 0;
  for (let i = 3; i < pixels.length; i += 4) painted += pixels[i] > 0;
  return painted / (pixels.length / 4);
}"""


CELLS_CUT_OFF = """() => [...document.querySelectorAll("td")].filter((cell) => {
  const { left, right } = cell.getBoundingClientRect();
  return left < 0 || right > innerWidth || cell.scrollWidth > cell.clientWidth;
}).map((cell) => cell.textContent)"""


SMALLEST_LABEL = """() => Math.min(...[...document.querySelectorAll("svg.section text")].map(
  (label) => parseFloat(getComputedStyle(label).fontSize) * label.getScreenCTM().a
))"""
"""Smallest size of the labels of sections, in pixels of the screen."""


NEXT_FRAMES = (
    "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
)


def painted(page: Any) -> float:
    """Share of the map that is painted, once it has drawn what it was told."""
    page.evaluate(NEXT_FRAMES)
    return float(page.evaluate(SHARE_PAINTED))


def pointed_at(page: Any) -> tuple[float, float]:
    """The coordinates that are told."""
    x, y = page.locator("#told").inner_text().split(" · ")[0].split(", ")
    return float(x), float(y)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    is_root = getattr(os, "geteuid", lambda: None)() == 0
    unprivileged = ["--no-sandbox"] if is_root else []  # Chromium's sandbox refuses root
    with playwright.sync_playwright() as started:
        chromium = started.chromium.launch(
            executable_path=CHROMIUM, args=unprivileged, timeout=PATIENCE_MS
        )
        yield chromium
        chromium.close()


@pytest.fixture
def opened(browser: Any, tmp_path: Path) -> Iterator[Any]:
    """Opens the report of a run.json; in the end nothing may have been asked for, or gone wrong."""
    told: list[str] = []
    page = browser.new_page(viewport={"width": 1200, "height": 900})
    page.set_default_timeout(PATIENCE_MS)
    page.on("console", lambda message: told.append(message.text))
    page.on("pageerror", lambda error: told.append(str(error)))
    page.on("request", lambda request: told.append(request.url))

    def open_report(content: dict[str, Any], **media: str) -> Any:
        path = write_report(results.write(tmp_path / "out", content))
        page.emulate_media(**media)
        page.goto(path.as_uri())
        page.wait_for_selector(READY, state="attached")
        return page

    yield open_report
    page.close()
    assert [
        text for text in told if not text.startswith(("data:image/png;base64,", "file://"))
    ] == []
    assert sum(text.startswith("file://") for text in told) == 1


def run_of_many_tiles(**changes: Any) -> dict[str, Any]:
    tiles = [results.tile(i, 40, 1.5, tries=1 + i % 2) for i in range(1000)]
    tiles[2].update(state="failed", seconds=None)
    failed = [
        {
            "stage": "filter0",
            "key": tiles[2]["key"],
            "error": results.HOSTILE,
            "bounds": tiles[2]["bounds"],
        }
    ]
    outputs = dict.fromkeys(("dtm.tif", "mask.tif", "density.tif"), 1)
    return results.run(
        tiles={"filter0": tiles, "grid-dtm": tiles[:9]},
        failed_tasks=failed,
        outputs=outputs,
        **changes,
    )


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everything_is_drawn(opened: Any, scheme: str) -> None:
    left = [{"path": results.HOSTILE, "error": f"{results.HOSTILE}: cut short"}]
    page = opened(
        run_of_many_tiles(inputs=[results.source(results.HOSTILE)], quarantined=left),
        color_scheme=scheme,
    )
    assert painted(page) > 0.2
    assert page.locator("#state").inner_text() == "Finished, but incomplete"
    for what in ("file left out", "failed task"):
        assert page.get_by_role("cell", name=what).first.is_visible()
    assert page.locator("#legend").inner_text().split("\n")[-1].strip() == "1 tile failed"
    assert page.evaluate("[...document.images].every((i) => i.complete && i.naturalWidth > 0)")
    for name in ("hillshade", "density", "mask", ""):
        page.select_option("#choose-picture", name)
    for name in ("time", "none", "state"):
        page.select_option("#choose-tiles", name)
    page.check("#choose-files")
    page.select_option("#choose-stage", "1")
    assert page.locator("#legend").inner_text().strip().startswith("4 tiles done")
    background = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (background == "rgb(255, 255, 255)") == (scheme == "light")


def test_a_problem_is_shown_on_the_map(opened: Any) -> None:
    page = opened(run_of_many_tiles())
    west, south, east, north = run_of_many_tiles()["failed_tasks"][0]["bounds"]
    page.locator("#problems a[data-place]").click()
    assert page.locator("#told").inner_text().startswith("failed task")
    box = page.locator("#canvas").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert pointed_at(page) == pytest.approx(((west + east) / 2, (south + north) / 2), abs=1)


def test_the_keyboard_goes_everywhere(opened: Any) -> None:
    page = opened(run_of_many_tiles())
    page.focus("#canvas")
    before = painted(page)
    for key in ("+", "+", "+", "ArrowLeft", "ArrowUp"):
        page.keyboard.press(key)
    assert painted(page) > before + 0.1
    page.keyboard.press("0")
    assert painted(page) == pytest.approx(before, abs=0.01)
    page.keyboard.press("n")
    assert (
        page.locator("#told").inner_text().startswith("tile t+000+000, done, 1,000 points, 1 s")
    )
    for _ in range(2):
        page.keyboard.press("n")
    assert "failed" in page.locator("#told").inner_text()
    assert "<img src=x onerror=alert(1)>" in page.locator("#told").inner_text()
    page.keyboard.press("p")
    assert page.locator("#told").inner_text().startswith("tile t+001+000")
    reached = set()
    for _ in range(30):
        page.keyboard.press("Tab")
        reached.add(
            page.evaluate("document.activeElement.id || document.activeElement.tagName")
        )
    assert {"DIV", "A", "SUMMARY"} & reached


def test_the_mouse_moves_zooms_and_asks(opened: Any) -> None:
    page = opened(run_of_many_tiles())
    page.locator("#canvas").scroll_into_view_if_needed()
    box = page.locator("#canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    assert "tile t+020+013, done" in page.locator("#told").inner_text()
    assert pointed_at(page) == pytest.approx((500030.0, 5399980.0), abs=0.5)
    page.mouse.down()
    page.mouse.move(x + 200, y + 100, steps=FRAMES_OF_A_DRAG)
    page.mouse.up()
    page.mouse.move(x, y)
    east, north = pointed_at(page)
    assert east < 500025.0
    assert north > 5399982.0
    page.get_by_label("Zoom in").click()
    page.get_by_label("Show all").click()
    page.mouse.move(x, y)
    assert pointed_at(page) == pytest.approx((500030.0, 5399980.0), abs=0.5)


def test_print_and_small_screens_hold_everything(opened: Any) -> None:
    page = opened(run_of_many_tiles(), media="print")
    assert not page.locator("nav").is_visible()
    assert page.locator("#picture-mask").is_visible()
    page.emulate_media(media="screen")
    for width in (380, 400):
        page.set_viewport_size({"width": width, "height": 700})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(CELLS_CUT_OFF) == []
    cell = page.locator("#inputs td[data-name=CRS]").first
    assert cell.evaluate("(cell) => getComputedStyle(cell, '::before').content") == '"CRS"'


def test_a_run_without_rasters_has_a_map_too(opened: Any) -> None:
    page = opened({**run_of_many_tiles(), "outputs": {}})
    assert painted(page) > 0.1
    assert page.locator("#choose-picture").count() == 0


def test_places_are_decided_by_keyboard_and_saved(
    browser: Any, reviewed: Path, tmp_path: Path
) -> None:
    """What the page saves is what a run reads: outlines as they are, statuses, edits, heights and notes."""
    written = Path(write_review_page(reviewed, page_path=tmp_path / "review.html").page)
    page = browser.new_page(viewport={"width": 400, "height": 900}, accept_downloads=True)
    page.set_default_timeout(PATIENCE_MS)
    told: list[str] = []
    page.on("console", lambda message: told.append(message.text))
    page.on("pageerror", lambda error: told.append(str(error)))
    page.goto(written.as_uri())
    page.wait_for_selector(READY, state="attached")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.evaluate(SMALLEST_LABEL) >= 9
    page.keyboard.press("s")
    assert page.locator("#saved").inner_text() == "No place is decided."
    first = page.locator("#place-1")
    first.locator("select").select_option("flat")
    assert page.locator("#decided").inner_text() == "1 of 2 decided"
    first.locator("input[value=open]").check()
    first.locator("input[name=note]").fill("why")
    page.locator("#save").click()
    assert "Decide, or the note is lost." in page.locator("#saved").inner_text()
    first.locator("input[name=note]").fill("")
    first.locator("h3").click()
    page.evaluate("document.activeElement.blur()")
    for key in "pfNo":
        page.keyboard.press(key)
    assert page.locator("#decided").inner_text() == "2 of 2 decided"
    first.locator("select").select_option("flat")
    page.locator("#save").click()
    assert first.locator("output").inner_text() == "Give the height as a number."
    first.locator("input[name=z]").fill("31,5")
    first.locator("input[name=note]").fill("snof")  # letters of a note are no keys
    with page.expect_download() as saved:
        page.locator("#save").click()
    saved.value.save_as(tmp_path / "saved.geojson")
    content = json.loads((tmp_path / "saved.geojson").read_text())
    expected = json.loads(decided(written, "fixed", "ok").read_text())
    for feature, note, z, action in zip(
        expected["features"], ("snof", ""), (31.5, None), ("flat", "void"), strict=True
    ):
        feature["properties"] |= {"note": note, "z": z, "action": action}
    assert content == expected
    page.close()
    assert told == []


def test_squares_are_answered_by_keyboard_and_saved(
    browser: Any, finished_run: Any, tmp_path: Path
) -> None:
    """What the page saves is what the next statement reads."""
    made = write_statement(finished_run[0], 3, tmp_path / "statement.html")
    page = browser.new_page(viewport={"width": 400, "height": 900}, accept_downloads=True)
    page.set_default_timeout(PATIENCE_MS)
    told: list[str] = []
    page.on("console", lambda message: told.append(message.text))
    page.on("pageerror", lambda error: told.append(str(error)))
    page.goto(Path(made.page).as_uri())
    page.wait_for_selector(READY, state="attached")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.evaluate(SMALLEST_LABEL) >= 9
    page.keyboard.press("s")
    assert page.locator("#saved").inner_text() == "No square is answered."
    for key in "n3n1nup4u":
        page.keyboard.press(key)
    assert page.locator("#decided").inner_text() == "1 of 3 answered"
    page.locator("article").last.locator("input").first.check()
    assert page.locator("#decided").inner_text() == "2 of 3 answered"
    with page.expect_download() as downloaded:
        page.locator("#save").click()
    downloaded.value.save_as(tmp_path / "browser.json")
    answers = saved(Path(made.page), 3)
    expected = json.loads(answers.read_text())
    last = data_of(Path(made.page))["draws"][-1]
    expected["answers"][str(last)] = 0
    assert json.loads((tmp_path / "browser.json").read_text()) == expected
    page.close()
    assert told == []
