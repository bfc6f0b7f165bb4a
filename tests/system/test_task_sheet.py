"""The task sheet in a real browser: on paper and on a phone."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from ssp_core.cli import main
from tests.system.browser import Browser

pytestmark = pytest.mark.programs

MOST_PAGES = 3


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser(dark=False) as one:
        yield one


@pytest.mark.parametrize("event", ["cut_in", "occluded_crossing"])
def test_the_sheet_fits_on_three_pages_and_on_a_phone(
    browser: Browser, tmp_path: Path, event: str
) -> None:
    out = tmp_path / "task"
    assert (
        main(["compile", event, "--target", "track", "--site", "north_track", "--out", str(out)])
        == 0
    )
    browser.go((out / "task.html").as_uri())
    given = {"preferCSSPageSize": True, "printBackground": True}
    printed = base64.b64decode(browser.ask("Page.printToPDF", **given)["data"])
    pages = len(re.findall(rb"/Type\s*/Page\b", printed))
    assert 1 <= pages <= MOST_PAGES
    sizes = re.findall(rb"/MediaBox\s*\[\s*0 0 ([\d.]+) ([\d.]+)", printed)
    assert {tuple(round(float(side)) for side in size) for size in sizes} == {(595, 842)}  # A4
    browser.resize(390, 844, touch=True)
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390
