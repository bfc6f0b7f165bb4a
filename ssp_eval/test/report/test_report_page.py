"""The report: one self-contained file that holds what the cells hold."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from evaluation_files import audit_file, resealed
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.files.writing import write_json
from ssp_core.hashing import sha256_file
from ssp_core.vocabulary import Verdict
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.model_replies import Loss, ModelReply
from ssp_eval.evaluate.clients.models import ModelFacts, ModelSpec, bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.results import load_cells, request_lines
from ssp_eval.figures.projection import overlay, project, top_view
from ssp_eval.report.cell_view import segments
from ssp_eval.report.page import write_report
from ssp_eval.report.render import matrix, shade
from ssp_vla_bridge.messages import Request, Response
from ssp_vla_bridge.trajectory import Trajectory
from tests.support.models.answering import Answering
from tests.system.browser import Browser

BagMaker = Callable[..., Path]
MODELS = ("constant_velocity", "perfect")
GEOMETRY = {
    "fx_px": 500.0,
    "fy_px": 500.0,
    "cx_px": 480.0,
    "cy_px": 270.0,
    "width_px": 960,
    "height_px": 540,
    "height_m": 1.4,
    "pitch_down_rad": 0.05,
}


class Collector(HTMLParser):
    """A parser that collects the references of a page, and checks that its tags close."""

    VOID = frozenset({"meta", "link", "img", "input", "br"})

    def __init__(self) -> None:
        super().__init__()
        self.references: list[str] = []
        self.anchors: list[str] = []
        self.ids: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        for key, value in attrs:
            if key == "id" and value:
                self.ids.append(value)
            if key in ("src", "href", "data", "poster") and value:
                (self.anchors if value.startswith("#") else self.references).append(value)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            raise AssertionError(f"</{tag}> closes nothing")


@pytest.fixture(scope="module")
def evaluated(bag_writer: BagMaker, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("evaluated")
    lost = {"verdict": Verdict.FAILED_SAFETY, "reasons": ("<b>fence</b>",)}
    bags = [
        bag_writer(folder / "bag"),
        bag_writer(folder / "track", domain="physical", stand_in=True),
        bag_writer(folder / "lost", scenario="vru_crossing", **lost),
    ]
    models = [bridge_spec(name) for name in MODELS]
    given = [(bag, None) for bag in bags]
    run_campaign(given, models, InProcessClients(), folder / "out", CellOptions(), True)
    return folder / "out"


@pytest.fixture
def campaign(evaluated: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(evaluated, tmp_path / "out"))


def test_the_page_stands_alone(campaign: Path) -> None:
    page = write_report(campaign).read_text()
    collector = Collector()
    collector.feed(page)
    assert collector.open == []
    # Nothing that it shows; what it links to are the files beside it.
    linked = set(collector.references) - {"data:,"}
    assert linked
    assert all((campaign / path).is_file() for path in linked)
    assert not re.search(r'src="(?!data:)', page)
    assert {anchor[1:] for anchor in collector.anchors} <= set(collector.ids)
    assert len(collector.ids) == len(set(collector.ids))
    assert not re.search(r"https?://", page)
    assert "@import" not in page
    pictures = json.loads(page.split('id="pictures">')[1].split("</script>")[0])
    # Nine label times of two admitted clips that show the same frames.
    assert len(pictures) == 9
    assert all(data.startswith("data:image/jpeg;base64,") for data in pictures.values())
    wanted = set(re.findall(r'data-frame="([^"]+)"', page))
    assert wanted == set(pictures)


def test_what_must_be_said_is_said(campaign: Path) -> None:
    page = write_report(campaign).read_text()
    assert "IVCS is no safety certificate" in page
    assert "software stand-in here, not a vehicle" in page
    assert "means and ranks leave it out" in page
    assert "no person has reviewed them" in page
    assert "cut in / physical" in page
    # A refused run with its reason, as text and not as markup.
    assert "failed_safety: &lt;b&gt;fence&lt;/b&gt;" in page
    assert "<b>fence" not in page
    for cell in load_cells(campaign):
        for digest in cell.facts.hashes.values():
            assert digest is None or digest in page
        if cell.score is not None:
            assert f"{cell.score.ivcs:.3f}" in page


def test_controls_and_refused_cells_enter_no_mean(campaign: Path) -> None:
    page = write_report(campaign).read_text()
    means = page.split('<section id="means">')[1].split("</section>")[0]
    assert "Controls left out: best_constant, perfect." in means
    fields = re.findall(r"<td[^>]*>(.*?)</td>", means)
    assert "constant_velocity" in fields
    assert "perfect" not in fields
    assert "vru crossing" not in fields
    assert "refused: " in matrix(load_cells(campaign))
    shown = page.split('<section id="matrix">')[1].split("</section>")[0]
    assert "constant_velocity" in shown
    assert "perfect" not in shown
    controls = page.split('<section id="controls">')[1].split("</section>")[0]
    assert "perfect" in controls


def test_a_score_that_doesn_t_fit_its_records_is_noticed(campaign: Path) -> None:
    cell = next(c for c in load_cells(campaign) if c.score is not None)
    path = cell.folder / "score.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "ivcs": 0.99}))
    resealed(cell.folder)  # as of a version that scored otherwise
    assert "The stored score differs" in write_report(campaign).read_text()


def test_a_model_s_text_can_t_break_the_page(campaign: Path) -> None:
    cell = next(c for c in load_cells(campaign) if c.score is not None)
    path = cell.folder / "records.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    lines[0]["text"] = "</script><script>alert(1)</script> & <img src=x>"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    resealed(cell.folder)
    page = write_report(campaign).read_text()
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)" in page


WRONG: list[tuple[str, object]] = [
    ("schema", "ssp.cell/2"),
    ("admission", 5),
    ("admission.status", "perhaps"),
    ("admission.audit_sha256", 5),
    ("status", 5),
    ("status", "done"),
    ("reasons", "a text"),
    ("stand_in", "false"),
    ("scenario", None),
    ("clip", []),
    ("clip.geometry.fx_px", "wide"),
    ("answers.ignored", {}),
    ("answers.sent", -1),
    ("answers.missing_by_kind", {"late": "two"}),
    ("hashes", {"bag": 5}),
    ("preprocessing.frames", 1.5),
    ("decoding", [1]),
]


def test_a_wrong_field_of_a_cell_is_named(
    campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = campaign / "cells" / "cut_in__simulation__perfect" / "cell.json"
    good = file.read_text()
    for path, value in WRONG:
        facts = json.loads(good)
        node = facts
        *above, last = path.split(".")
        for key in above:
            node = node[key]
        node[last] = value
        file.write_text(json.dumps(facts))
        assert main(["report", str(campaign)]) == 1, path
        error = "".join(capsys.readouterr().err.split())
        assert "Traceback" not in error
        assert "cell.json" in error
        assert path in error


@pytest.mark.parametrize(
    "line",
    [
        "5",
        "{",
        '{"t_s": 1}',
        '{"label_t_s": "x"}',
        '{"label_t_s": 1, "frames": [{}]}',
        '{"label_t_s": 1, "frames": 5}',
        '{"label_t_s": 1, "history": [{"x_m": 1}]}',
        '{"label_t_s": 1, "missing": 5}',
        '{"label_t_s": NaN}',
        "[" * 100000,
    ],
)
def test_a_damaged_request_is_named_by_its_line(line: str, tmp_path: Path) -> None:
    file = tmp_path / "requests.jsonl"
    file.write_text('{"label_t_s": 1.0, "t_s": null, "missing": ""}\n' + line + "\n")
    with pytest.raises(InputError) as caught:
        request_lines(file)
    assert (caught.value.file, caught.value.line) == (str(file), 2)


spans = st.lists(st.tuples(st.integers(-3, 25), st.integers(-3, 25)), max_size=4)


@given(text=st.text(max_size=20), evidence=st.dictionaries(st.sampled_from("abc"), spans))
def test_segments_are_the_text_whatever_the_spans(
    text: str, evidence: dict[str, list[tuple[int, int]]]
) -> None:
    pieces = segments(text, evidence)
    assert "".join(piece.text for piece in pieces) == text
    position = 0
    for piece in pieces:
        for offset in range(len(piece.text)):
            covered = {
                slot
                for slot, found in evidence.items()
                if any(a <= position + offset < b for a, b in found)
            }
            assert set(piece.slots) == covered
        position += len(piece.text)


def test_projection_of_a_pinhole_camera() -> None:
    # The horizon lies tan(pitch) above the middle; a point far away is near it.
    horizon = 270.0 - 500.0 * math.tan(0.05)
    (far,) = project([(1e6, 0.0)], GEOMETRY, 1.8)
    assert far == pytest.approx((480.0, horizon), abs=0.01)
    # Without pitch, 1.4 m below at 10 m: 500 · 1.4 / 10 pixels under the middle.
    level = {**GEOMETRY, "pitch_down_rad": 0.0}
    near, behind = project([(11.8, 2.0), (0.0, 0.0)], level, 1.8)
    assert near == pytest.approx((480.0 - 100.0, 270.0 + 70.0))
    assert behind is None


def test_overlay_needs_a_known_camera_and_something_ahead() -> None:
    ahead = Trajectory((0.0, 0.5, 1.0), (0.0, 5.0, 10.0), (0.0, 0.0, 0.5))
    drawn = overlay(ahead, GEOMETRY, 1.8)
    assert drawn.count("<circle") == 2
    assert "polygon" in drawn
    assert overlay(ahead, None, None) == ""
    assert overlay(ahead, {**GEOMETRY, "height_m": None}, 1.8) == ""
    standing = Trajectory((0.0, 1.0), (0.0, 0.0), (0.0, 0.0))
    assert overlay(standing, GEOMETRY, 1.8) == ""


def test_top_view_shows_that_there_is_nothing() -> None:
    assert "no valid trajectory" in top_view(None, [])
    plan = top_view(Trajectory((0.0, 1.0), (0.0, 10.0), (0.0, 2.0)), [])
    assert plan.count("<circle") == 2


def test_drawings_have_a_name_for_screen_readers_or_are_left_out() -> None:
    plan = Trajectory((0.0, 0.5, 1.0), (0.0, 5.0, 10.0), (0.0, 0.0, -0.5))
    named = 'role="img" aria-label="Plan from above: 10.0 m ahead, 0.5 m to the right at 1 s">'
    assert named in top_view(plan, [])
    assert 'role="img" aria-label="No valid trajectory">' in top_view(None, [])
    assert 'aria-hidden="true"' in overlay(plan, GEOMETRY, 1.8)


def test_shade_goes_from_light_to_dark() -> None:
    assert shade(0.0) == "#d6e4f0"
    assert shade(1.0) == "#084081"
    brightness = [int(shade(v / 10)[1:3], 16) for v in range(11)]
    assert brightness == sorted(brightness, reverse=True)


def test_the_matrix_draws_the_best_constant_and_marks_who_is_below(campaign: Path) -> None:
    cells = [one for one in load_cells(campaign) if one.score is not None]
    given = {(one.scenario, one.domain): 0.999 for one in cells}
    drawn = matrix(cells, given)
    assert drawn.count('class="constant"><title>best blind constant 0.999</title>') == len(cells)
    assert drawn.count('class="constant"/>') == 1  # of the legend
    assert 'class="constant"' not in matrix(cells)
    page = write_report(campaign).read_text()
    shown = page.split('<section id="matrix">')[1].split("</section>")[0]
    assert "<title>best blind constant 0." in shown


def test_the_matrix_does_not_cut_its_last_square(campaign: Path) -> None:
    cell = next(one for one in load_cells(campaign) if one.score is not None)
    given = cell.score.details.judgements
    for labels in (1, 9, 10, 11, 60):
        details = replace(cell.score.details, judgements=tuple((given * labels)[:labels]))
        drawn = matrix([replace(cell, score=replace(cell.score, details=details))])
        rect = r'<rect x="([\d.]+)" [^>]*width="([\d.]+)"[^>]*class="stage '
        squares = re.findall(rect, drawn)
        pushed = re.search(r"translate\(([\d.]+) 0\)", drawn)
        width = re.search(r'viewBox="0 0 ([\d.]+) ', drawn)
        assert len(squares) == labels
        assert pushed is not None
        assert width is not None
        assert max(float(x) + float(w) for x, w in squares) + float(pushed[1]) <= float(width[1])


def test_the_audits_that_cells_go_by_are_linked_where_they_lie(
    campaign: Path, evaluated: Path
) -> None:
    audit = campaign / "audits" / "cut_in"
    bags = [evaluated.parent / "bag", evaluated.parent / "track"]
    digest = sha256_file(audit_file(audit / "audit.json", "admitted", *bags))
    admitted = {"status": "admitted", "audit_sha256": digest, "reasons": []}
    for folder in (campaign / "cells").glob("cut_in__*"):
        resealed(folder, lambda facts: facts.update(admission=admitted))
    assert "audits/cut_in" not in write_report(campaign).read_text()  # there is no page of it
    (audit / "audit.html").write_text("<html></html>")
    page = write_report(campaign).read_text()
    assert '<a href="audits/cut_in/audit.html">cut in</a>.' in page
    assert page.count('<a href="audits/cut_in/audit.html">admitted</a>') == 2 * len(MODELS)
    write_json(audit / "audit.json", {"another": "audit"})
    assert "audits/cut_in/audit.html" not in write_report(campaign).read_text()


def lossy(number: int, request: Request) -> ModelReply:
    """Answers as OpenEMMA does, with a trait to tolerate, and loses some answers."""
    if number == 2:
        return ModelReply(None, "no answer within 1 s", Loss.SILENT)
    pairs = ", ".join(["[9.0, \u22120.1]"] * 10)
    facts = {"temperature": 0, "stages": [{"latency_s": number}]}
    blank = Response(request.request_id, request.stamp_ns, "m", "m/1", pairs, decoding=facts)
    if number == 5:
        return ModelReply(replace(blank, error_code=2, error_msg="stage motion: <b>broken</b>"))
    return ModelReply(blank)


def test_a_cell_says_how_it_was_asked_read_and_what_is_missing(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    spec = ModelSpec(
        "m",
        backend="openai",
        interface="openemma",
        facts=ModelFacts(30.5, 3.3, "moe"),
    )
    run_campaign([(make_bag(), None)], [spec], Answering(lossy), tmp_path, CellOptions(), True)
    page = write_report(tmp_path).read_text()
    cell = page.split('<details class="cell"')[1].split('<details class="record"')[0]
    text = " ".join(re.sub(r"<[^>]+>", "", cell).split())
    assert "Asked by the interface openemma, read by the adapter openemma:corrected." in text
    assert "Decoding: {&#34;temperature&#34;: 0}." in text
    assert "1 missing: bridge answered an error." in text
    assert "1 missing: no answer in time." in text
    assert "The adapter noted:" in text
    assert "minus" in text.lower()
    assert (
        "asked without a previous answer: the one before is missing: no answer in time (1)" in text
    )
    records = " ".join(re.sub(r"<[^>]+>", "", page).split())
    assert "Missing: no answer in time: no answer within 1 s" in records
    assert (
        "Missing: bridge answered an error: the bridge answered error 2: stage motion: " in records
    )
    assert "<b>broken" not in page
    assert "30.5 billion parameters, 3.3 active, moe" in records
    assert "openemma, openemma:corrected" in records


def test_a_control_by_another_name_is_one_still(make_bag: BagMaker, tmp_path: Path) -> None:
    models = [bridge_spec(text) for text in ("constant_velocity", 'best={"backend": "perfect"}')]
    results = run_campaign(
        [(make_bag(), None)], models, InProcessClients(), tmp_path, CellOptions(), True
    )
    assert results[1].score is not None
    assert results[1].score["ivcs"] == pytest.approx(1.0)
    controls = {cell.model for cell in load_cells(tmp_path) if cell.is_control}
    assert controls == {"best"}


@pytest.mark.programs
def test_from_a_score_back_by_clicking(campaign: Path) -> None:
    """Clicks lead from the matrix to cell, label time, evidence and files; on a phone too."""
    page = write_report(campaign)
    cell = "cut_in__simulation__constant_velocity"
    with Browser(dark=False) as browser:
        browser.go(page.as_uri())
        # Nothing of a control is in the matrix of models.
        rows = browser.evaluate("document.querySelectorAll('#matrix .row').length")
        assert rows == sum(not one.is_control for one in load_cells(campaign))
        browser.evaluate(f"document.querySelector('#matrix a[href=\"#{cell}\"]').scrollIntoView()")
        browser.evaluate(
            f"document.querySelector('#matrix a[href=\"#{cell}\"]')"
            ".dispatchEvent(new MouseEvent('click', {bubbles: true, cancelable: true}))"
        )
        browser.wait(f"document.getElementById('{cell}').open")
        browser.click(f"#{cell}-0 > summary")
        browser.wait(f"document.querySelector('#{cell}-0 .frame img').naturalWidth")
        browser.click(f"#{cell}-0 .walk > summary")
        steps = browser.evaluate(
            f"[...document.querySelectorAll('#{cell}-0 .walk b')].map((step) => step.innerText)"
        )
        assert [step for step in steps if step != "frame sent"] == [
            "score",
            "evidence",
            "raw output",
            "request",
            "recording",
            "K*",
        ]
        links = browser.evaluate(
            f"[...document.querySelectorAll('#{cell}-0 .walk a')].map((link) => link.href)"
        )
        # All but what lies in the recording: it, K*, and frames before the newest.
        assert [Path(link).suffix for link in links] == [".json", *3 * [".jsonl"], ".jpg"]
        browser.resize(400, 800)
        assert browser.evaluate("document.documentElement.scrollWidth") <= 400
        assert browser.console == []
        assert all(url.startswith(("file://", "data:")) for url in browser.requests)
        browser.go(links[0])
        assert '"ivcs"' in browser.evaluate("document.body.innerText")
