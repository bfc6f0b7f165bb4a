"""The task sheet in a real browser: on paper and on a phone."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import pytest

from ssp_core.cli import main
from ssp_core.files.writing import write_text
from ssp_scenario_manager.compile.targets.task_sheet import sheet
from ssp_scenario_manager.compile.task import load_task
from ssp_scenario_manager.event_spec.load import write_event
from ssp_scenario_manager.event_spec.model import Event
from tests.support.events.several import behind_a_parked_truck, several
from tests.system.browser import Browser

pytestmark = pytest.mark.programs

MOST_PAGES = 3


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser(dark=False) as one:
        yield one


def surveyed(fence: Sequence[tuple[float, float]], corners: int) -> list[tuple[float, float]]:
    """A fence of so many corners: each edge of the given one is bowed outwards by 0.6 m."""
    per_edge = corners // len(fence)
    turned = sum(a[0] * b[1] - b[0] * a[1] for a, b in pairwise([*fence, fence[0]]))
    found = []
    for a, b in pairwise([*fence, fence[0]]):
        dx, dy = b[0] - a[0], b[1] - a[1]
        for part in (k / per_edge for k in range(per_edge)):
            out_m = math.copysign(2.4 * part * (1.0 - part), turned) / math.hypot(dx, dy)
            found.append((a[0] + part * dx + out_m * dy, a[1] + part * dy - out_m * dx))
    return found


def compiled(event: str, site: str, folder: Path) -> Path:
    out = folder / "task"
    assert main(["compile", event, "--target", "track", "--site", site, "--out", str(out)]) == 0
    return out


def check(browser: Browser, page: Path) -> None:
    """The sheet has at most three pages of A4, and no scrolling sideways on a phone."""
    browser.go(page.as_uri())
    given = {"preferCSSPageSize": True, "printBackground": True}
    printed = base64.b64decode(browser.ask("Page.printToPDF", **given)["data"])
    pages = len(re.findall(rb"/Type\s*/Page\b", printed))
    assert 1 <= pages <= MOST_PAGES
    sizes = re.findall(rb"/MediaBox\s*\[\s*0 0 ([\d.]+) ([\d.]+)", printed)
    assert {tuple(round(float(side)) for side in size) for size in sizes} == {(595, 842)}  # A4
    browser.resize(390, 844, touch=True)
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("event", ["cut_in", "occluded_crossing"])
def test_the_sheet_fits_on_three_pages_and_on_a_phone(
    browser: Browser, tmp_path: Path, event: str
) -> None:
    check(browser, compiled(event, "north_track", tmp_path) / "task.html")


@pytest.mark.parametrize(
    ("event", "site"),
    [
        ("vut_turn", "tee_track"),
        (several("two_pedestrians_one_hidden"), "north_track"),
        (behind_a_parked_truck(), "cross_track"),
    ],
    ids=["vut_turn", "three_objects", "two_objects"],
)
def test_a_surveyed_fence_and_several_objects_fit_too(
    browser: Browser, tmp_path: Path, event: str | Event, site: str
) -> None:
    if isinstance(event, Event):
        write_event(tmp_path / "event.yaml", event)
        event = str(tmp_path / "event.yaml")
    task = load_task(compiled(event, site, tmp_path))
    task = task.model_copy(update={"geofence": surveyed(task.geofence, 48)})
    assert len(task.geofence) == 48
    page = tmp_path / "surveyed.html"
    write_text(page, sheet(task))
    check(browser, page)
