"""The report of a large campaign: what a reader finds in a real browser, and what is beside it."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from evaluation_files import resealed

from ssp_core.hashing import sha256_bytes, sha256_file
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.results import load_cells
from ssp_eval.report.page import write_report
from tests.large_campaign import clone_campaign
from tests.system.browser import Browser

BagMaker = Callable[..., Path]
CELLS = 400


@pytest.fixture(scope="module")
def evaluated(bag_writer: BagMaker, tmp_path_factory: pytest.TempPathFactory) -> Path:
    models = [bridge_spec(name) for name in ("constant_velocity", "perfect")]
    folder = tmp_path_factory.mktemp("evaluated")
    bags = [(bag_writer(folder / "bag"), None)]
    run_campaign(bags, models, InProcessClients(), folder / "out", CellOptions(), True)
    return folder / "out"


@pytest.fixture
def source(evaluated: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(evaluated, tmp_path / "source"))


def rows(page: str) -> dict[str, Any]:
    data: dict[str, Any] = json.loads(page.split('id="rows">')[1].split("</script>")[0])
    return data


def steps(file: Path) -> list[tuple[str, str]]:
    """Return name and hash of each step of the way back from the first record."""
    text = file.read_text()
    html = json.loads("[" + text.removeprefix("sspCell(").removesuffix(");\n") + "]")[1]
    walk = html.split('<details class="walk">')[1].split("</details>")[0]
    return [
        (found[1], found[2])
        for found in re.finditer(r'<b>([^<]+)</b>.*?<code title="([^"]+)"', walk, re.DOTALL)
    ]


def test_each_step_of_the_way_back_has_the_hash_of_what_it_names(source: Path) -> None:
    write_report(source, most=0)
    folder = source / "cells" / "cut_in__simulation__perfect"
    facts = json.loads((folder / "cell.json").read_text())
    found = steps(source / "report" / "cells" / f"{folder.name}.js")
    kinds = [what for what, _ in found if what != "frame sent"]
    assert kinds == ["score", "evidence", "raw output", "request", "recording", "K*"]
    of = dict(found)
    assert of["score"] == sha256_file(folder / "score.json")
    for what, name in (("evidence", "records"), ("raw output", "raw"), ("request", "requests")):
        line = (folder / f"{name}.jsonl").read_text().split("\n")[0]
        assert of[what] == sha256_bytes(line.encode()), what
    assert of["recording"] == facts["hashes"]["bag"]
    assert of["K*"] == facts["event_version"]
    asked = json.loads((folder / "requests.jsonl").read_text().split("\n")[0])
    frames = [digest for what, digest in found if what == "frame sent"]
    assert frames == [frame["sha256"] for frame in asked["frames"]]


def test_links_of_details_lead_to_files(source: Path) -> None:
    write_report(source, most=0)
    for file in (source / "report" / "cells").glob("*.js"):
        for path in re.findall(r'(?:href|data-src)=\\"([^"#]+)\\"', file.read_text()):
            assert (source / path).is_file(), path


def test_rows_hold_what_the_cells_hold(source: Path, tmp_path: Path) -> None:
    out = tmp_path / "campaign"
    clone_campaign(source, out, 110)
    page = write_report(out).read_text()
    data = rows(page)
    cells = {cell.id: cell for cell in load_cells(out)}
    assert len(data["rows"]) == len(cells) == 110
    for ident, scenario, domain, model, status, _, control, stages, scores, _, reason, best in data[
        "rows"
    ]:
        cell = cells[ident]
        assert data["scenario"][scenario] == cell.scenario
        assert data["domain"][domain] == cell.domain
        assert data["model"][model] == cell.model
        assert (status, bool(control)) == (cell.facts.status, cell.is_control)
        assert (scores is None, reason == "") == (cell.score is None, status == "ok")
        # The best blind constant of the recording, also beside a cell without scores.
        assert best is None or 0.0 < best <= 1.0
        assert scores is None or best is not None
        if cell.score is not None:
            assert scores[0] == pytest.approx(cell.score.ivcs, abs=1e-6)
            failing = sum(cell.score.details.first_failures.values())
            assert sum(stage != "-" for stage in stages) == failing
    assert "<dt>refused</dt><dd>1</dd>" in page
    assert "<dt>failed</dt><dd>1</dd>" in page
    # Of the last scenario only a part was asked about.
    assert "Not evaluated: 2 cells are missing" in page


def test_details_of_cells_that_are_gone_go_too(source: Path) -> None:
    write_report(source, most=0)
    (source / "report" / "cells" / "old.js").write_text("sspCell('old', '');")
    write_report(source, most=0)
    left = {file.stem for file in (source / "report" / "cells").glob("*.js")}
    assert left == {file.name for file in (source / "cells").iterdir()}


def test_a_text_can_t_break_the_details(source: Path) -> None:
    file = source / "cells" / "cut_in__simulation__perfect" / "records.jsonl"
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    lines[0]["text"] = "</script><script>alert(1)</script> \u2028 & <img src=x onerror=alert(1)>"
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    write_report(source, most=0)
    text = (source / "report" / "cells" / "cut_in__simulation__perfect.js").read_text()
    assert "<script" not in text
    assert "<img src=x" not in text
    assert "\u2028" not in text


@pytest.mark.programs
def test_in_a_browser(source: Path, tmp_path: Path) -> None:
    out = tmp_path / "campaign"
    clone_campaign(source, out, CELLS)
    page = write_report(out)
    with Browser(dark=False) as browser:
        browser.go(page.as_uri())
        browser.wait("document.querySelectorAll('tr.cell').length === 50")
        # The controls, eleven in sixteen, are shown when they are asked for.
        assert browser.text("#count").startswith("125 of 125 cells")
        choose(browser, "model", "model_03+black")
        assert browser.text("#count").startswith("25 of 400 cells")
        choose(browser, "model", "")
        pick(browser, "#kind", "1")
        assert browser.text("#count").startswith("275 of 275 cells")
        # Five models under two conditions, and the legend.
        assert browser.evaluate("document.querySelectorAll('svg.seeing .own').length") == 11
        pick(browser, "#kind", "")
        assert f"{CELLS} of {CELLS} cells, 4 refused, 4 failed" in browser.text("#count")
        browser.click("#next")
        assert browser.text("#place") == "51 to 100"

        choose(browser, "model", "model_03")
        assert browser.text("#count").startswith("25 of 400 cells")
        choose(browser, "model", "")
        choose(browser, "stage", "0")
        shown = browser.evaluate(
            "[...document.querySelectorAll('tr.cell .strip')].map((s) => s.innerText.includes('1'))"
        )
        assert shown
        assert all(shown)
        browser.click("#reset")
        pick(browser, "#kind", "")
        browser.evaluate("document.getElementById('search').value = 'KILLED by'")
        browser.evaluate("document.getElementById('search').dispatchEvent(new Event('input'))")
        assert browser.text("#count") == "4 of 400 cells, 4 failed"
        browser.click("#reset")
        pick(browser, "#kind", "")

        for order, best in (("descending", max), ("ascending", min)):
            browser.click("button[data-sort=ivcs]")
            assert (
                browser.evaluate(
                    "document.querySelector('button[data-sort=ivcs]').parentElement.ariaSort"
                )
                == order
            )
            first = browser.evaluate("document.querySelector('tr.cell').children[3].innerText")
            scores = [cell.score.ivcs for cell in load_cells(out) if cell.score is not None]
            assert first == f"{best(scores):.3f}"

        browser.click("tr.cell td")
        browser.wait("document.querySelectorAll('details.record').length === 9")
        browser.click("details.record > summary")
        browser.wait(
            "[...document.querySelectorAll('.frame img[src]')].some((i) => i.naturalWidth)"
        )
        browser.click(".walk > summary")
        assert "raw output" in browser.text(".walk")

        # An address that names a record opens its cell and it, wherever the cell stands.
        browser.go(f"{page.as_uri()}#event_005__physical__model_02-3")
        browser.wait("document.getElementById('event_005__physical__model_02-3')?.open")
        browser.resize(400, 800)
        assert browser.evaluate("document.documentElement.scrollWidth") <= 400
        assert browser.console == []
        assert all(url.startswith("file://") for url in browser.requests if url[:5] != "data:")


def choose(browser: Browser, name: str, value: str) -> None:
    pick(browser, f"select[data-filter={name}]", value)


def pick(browser: Browser, selector: str, value: str) -> None:
    browser.evaluate(
        f"(() => {{ const s = document.querySelector('{selector}');"
        f" s.value = '{value}'; s.dispatchEvent(new Event('change')); }})()"
    )


def test_a_reason_can_t_break_the_data(source: Path) -> None:
    reason = "can't be read: <!--[if lt IE 7]> <script> </script>"
    lost = {"status": "failed", "reasons": [reason]}
    resealed(source / "cells" / "cut_in__simulation__perfect", lambda facts: facts.update(lost))
    page = write_report(source, most=0).read_text()
    assert any(reason in row for row in rows(page)["rows"])
    assert "<" not in page.split('id="rows">')[1].split("</script>")[0]


def test_of_a_very_long_answer_the_page_shows_the_beginning(source: Path) -> None:
    folder = source / "cells" / "cut_in__simulation__perfect"
    raw = folder / "raw.jsonl"
    first, *rest = raw.read_text().splitlines()
    raw.write_text("\n".join([json.dumps({**json.loads(first), "text": "z" * 900_000}), *rest]))
    resealed(folder)
    write_report(source, most=0)
    text = (source / "report" / "cells" / f"{folder.name}.js").read_text()
    assert "more characters in the file" in text
    assert text.count("z") < 25_000
