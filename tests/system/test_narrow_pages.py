"""Audit, labels sheet and form of a blind review in a real browser: none scrolls sideways."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ssp_core.cli import main
from ssp_eval.labels.sheet import Picture, Rows, html_sheet
from tests.system.browser import Browser
from tests.system.recordings import Recordings

pytestmark = pytest.mark.programs

# What is wider than the window, or scrolls by itself.
TOO_WIDE = """[...document.querySelectorAll('html, body, body *')].filter(e => {
  const scrolls = ['auto', 'scroll'].includes(getComputedStyle(e).overflowX);
  return e.getBoundingClientRect().right > innerWidth + 1
    || (scrolls && e.clientWidth && e.scrollWidth > e.clientWidth + 1);
}).slice(0, 9).map(e => `${e.tagName} ${e.className.baseVal ?? e.className}`)"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser(dark=False) as one:
        yield one


def assert_fits(browser: Browser, page: Path, width_px: int) -> None:
    browser.resize(width_px, 844, touch=width_px < 600)
    browser.go(page.as_uri())
    assert browser.evaluate("innerWidth") == width_px
    assert browser.evaluate(TOO_WIDE) == []


def test_an_audit_fits_into_a_phone_and_a_window(
    browser: Browser, recordings: Recordings, tmp_path: Path
) -> None:
    given = [str(recordings.get("cut_in", d)) for d in ("synthetic", "simulation", "physical")]
    assert main(["audit", *given, "--out", str(tmp_path)]) == 0
    for width_px in (390, 1280):
        assert_fits(browser, tmp_path / "audit.html", width_px)
        shown = "getComputedStyle(document.querySelector('svg.phases.narrow')).display"
        assert browser.evaluate(shown) == ("block" if width_px == 390 else "none")


def test_the_form_of_a_blind_review_fits_into_a_phone(browser: Browser, tmp_path: Path) -> None:
    path = tmp_path / "texts.jsonl"
    path.write_text(json.dumps({"id": 1, "text": "A cyclist is ahead. " * 40}) + "\n")
    assert main(["extract", str(path), "--review", str(tmp_path / "review"), "--n", "1"]) == 0
    for width_px in (390, 1280):
        assert_fits(browser, tmp_path / "review" / "reviewer_1" / "form.html", width_px)


def test_a_sheet_shows_its_frames_side_by_side(browser: Browser, tmp_path: Path) -> None:
    labels = [{"t_s": 0.5 * k, "objects": ["car"], "lon_actions": ["maintain"]} for k in range(9)]
    rows = Rows.model_validate({"scenario": "cut_in", "domain": "simulation", "labels": labels})
    grey = np.full((540, 960, 3), 128, np.uint8)
    page = tmp_path / "sheet.html"
    page.write_text(html_sheet(rows, [Picture(0.5 * k, grey) for k in range(9)], "bag"))
    columns = "new Set([...document.images].map(i => Math.round(i.getBoundingClientRect().x))).size"
    for width_px, least, most in ((390, 1, 1), (1280, 3, 4)):
        assert_fits(browser, page, width_px)
        assert least <= browser.evaluate(columns) <= most
    # A frame that is pressed fills the window, and goes back.
    width = "document.images[2].getBoundingClientRect().width"
    before = browser.evaluate(width)
    browser.click("#frame-2 a")
    browser.wait("location.hash === '#frame-2'")
    assert browser.evaluate(width) > 2 * before
    browser.click("#frame-2 .close")
    browser.wait("location.hash === '#label-2'")
    assert browser.evaluate(width) == before
