"""The report of a campaign of 5,000 cells of nine records, in a browser without a window.

Written from cloned cells of a real campaign. What a reader waits for: until the page is painted,
until a filter or a search shows its rows, until a cell's records are there; and the memory that the
page takes. The page is held against times that a person takes for at once. Beside it, all tables
and statistics as files, in a process of their own: its processor time, and the most memory it had.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from measure import LONG, report
from replay import make_bag

from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.report.page import write_report
from tests.large_campaign import clone_campaign
from tests.system.browser import Browser

CELLS = 5000 if LONG else 1000
TABLES_MS_PER_CELL, TABLES_MB = 50.0, 1500.0
PAINT_MS, FILTER_MS, OPEN_MS, HEAP_MB = 3000.0, 200.0, 1000.0, 200.0
PAINT = "performance.getEntriesByType('paint').find((e) => e.name.startsWith('first-c'))?.startTime"
# From the change of a control until the browser has drawn what it does.
TIMED = """new Promise((done) => {{
  const began = performance.now();
  {act};
  const drawn = () => ({ready}) ? requestAnimationFrame(() => setTimeout(
    () => done(performance.now() - began))) : setTimeout(drawn, 1);
  drawn();
}})"""


def write_campaign(folder: Path, cells: int) -> Path:
    """A campaign of so many cells, with its page."""
    make_bag(folder)
    run_campaign(
        [(folder / "bag", folder / "labels.json")],
        [bridge_spec(name) for name in ("constant_velocity", "perfect")],
        InProcessClients(),
        folder / "source",
        CellOptions(),
    )
    clone_campaign(folder / "source", folder / "campaign", cells)
    return folder / "campaign"


def write_tables(campaign: Path, folder: Path) -> tuple[float, float]:
    """Processor time (s) and peak memory (MB) of tables, statistics and page."""
    command = ["report", str(campaign), "--tables", str(folder), "--format", "csv"]
    process = subprocess.Popen(
        [sys.executable, "-m", "ssp_core.cli", *command],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"ssp report --tables ended with status {process.returncode}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3


def choose(name: str, value: str) -> str:
    """Script that sets a filter."""
    return (
        f"const s = document.querySelector('select[data-filter={name}]'); s.value = '{value}'; "
        "s.dispatchEvent(new Event('change'))"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=CELLS)
    parser.add_argument("--shots", type=Path, help="folder for screenshots")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, Browser(dark=False) as browser:
        campaign = write_campaign(Path(name), given.cells)
        began = time.process_time()
        page = write_report(campaign)
        note = f"{given.cells} cells, page of {page.stat().st_size / 1e6:.1f} MB"
        written_s = time.process_time() - began
        report("report: written", written_s, None, "s", note, lower=True, limit=given.cells * 0.04)
        browser.go(page.as_uri())
        painted = browser.wait(PAINT)
        report("report: first paint", painted, None, "ms", note, lower=True, limit=PAINT_MS)
        filtered = browser.evaluate(TIMED.format(act=choose("model", "model_03"), ready="true"))
        report("report: filter", filtered, None, "ms", note, lower=True, limit=FILTER_MS)
        search = "const s = document.getElementById('search'); s.value = 'killed'; " + (
            "s.dispatchEvent(new Event('input'))"
        )
        searched = browser.evaluate(TIMED.format(act=search, ready="true"))
        report("report: search", searched, None, "ms", note, lower=True, limit=FILTER_MS)
        browser.click("#reset")
        order = "document.querySelector('button[data-sort=ivcs]').click()"
        ordered = browser.evaluate(TIMED.format(act=order, ready="true"))
        report("report: sort", ordered, None, "ms", note, lower=True, limit=FILTER_MS)
        if given.shots is not None:
            browser.screenshot(given.shots / "page.png")
        opened = browser.evaluate(
            TIMED.format(
                act="document.querySelector('tr.cell').click()",
                ready="document.querySelector('details.record')",
            )
        )
        report("report: open a cell", opened, None, "ms", note, lower=True, limit=OPEN_MS)
        heap = browser.ask("Runtime.getHeapUsage")["usedSize"] / 1e6
        report(
            "report: memory of the page's script", heap, None, "MB", note, lower=True, limit=HEAP_MB
        )
        tables_s, memory_mb = write_tables(campaign, Path(name) / "tables")
        limit_s = given.cells * TABLES_MS_PER_CELL / 1e3
        report("report: with tables", tables_s, None, "s", note, lower=True, limit=limit_s)
        report("report: their memory", memory_mb, None, "MB", note, lower=True, limit=TABLES_MB)
        if browser.console:
            raise SystemExit(f"the console says: {browser.console}")


if __name__ == "__main__":
    main()
