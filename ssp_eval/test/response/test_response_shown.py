"""The places that show responses: terminal, audit page, the campaign's report and tables."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from evaluation_files import audit_file

from ssp_core.files.reading import load_model
from ssp_core.files.writing import write_json
from ssp_eval.audit.cli import response_lines
from ssp_eval.data.audit import Audit, load_audit
from ssp_eval.data.response import CurveEntry
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.admission import load_admissions
from ssp_eval.package.verify import _compare
from ssp_eval.report.page import write_report
from ssp_eval.response.compare import load_limits, respond
from ssp_eval.response.drive import no_drive
from ssp_eval.response.page import curve_plot, section
from ssp_eval.statistics.table import by_column
from ssp_eval.statistics.tables.responses import response_table
from tests.support.braking import drive, pulse

T_S = 0.02 * np.arange(250)
BRAKES = drive(T_S, pulse(T_S, start_s=1.6), gap_m=50.0)
LATE = drive(T_S, 0.7 * pulse(T_S, start_s=1.9), gap_m=50.0)
STANDS = drive(T_S, 0.0 * T_S)
LIMITS = load_limits()
UNLIKE = respond([no_drive(), LATE, BRAKES], LIMITS)
NOBODY = respond([STANDS, STANDS, STANDS], LIMITS)


def curve(values: list[float]) -> CurveEntry:
    return CurveEntry(
        trigger_s=1.0, braking_s=2.0, from_s=-0.2, step_s=0.01, acceleration_mps2=values
    )


def points(svg: str, class_: str) -> np.ndarray:
    """The points of one element of the drawing, shape (n, 2)."""
    found = re.search(rf'points="([^"]*)" class="{class_}"', svg)
    assert found is not None
    return np.array([[float(v) for v in pair.split(",")] for pair in found[1].split()])


def test_the_terminal_says_verdict_reasons_and_causes() -> None:
    lines = response_lines(UNLIKE.pairs[0])
    assert lines[0].startswith("response of simulation against physical: unlike, ISO/TS 18571 0.")
    assert any("simulation responds 0.30 s later" in line for line in lines)
    assert any("0.70 times the deceleration" in line for line in lines)
    assert response_lines(NOBODY.pairs[0]) == [
        "response of simulation against physical: not assessable",
        "  neither brakes: each decelerates by less than 0.5 m/s² over two steps of 0.5 s",
    ]


def test_the_page_draws_both_curves_in_the_corridors_of_the_reference() -> None:
    base = (-5.0 * np.linspace(0.0, 1.0, 221)).tolist()
    svg = curve_plot(("physical", curve(base)), ("simulation", curve([0.5] * 300)))
    reference, comparison = points(svg, "reference"), points(svg, "comparison")
    outer, inner = points(svg, "outer"), points(svg, "inner")
    n = len(reference)
    assert n == len(comparison) == 221
    assert (reference[:, 0] == comparison[:, 0]).all()
    px_per_mps2 = (reference[-1, 1] - reference[0, 1]) / 5.0
    assert np.ptp(comparison[:, 1]) == 0.0
    assert (reference[0, 1] - comparison[0, 1]) / px_per_mps2 == pytest.approx(0.5, abs=0.01)
    # 0.5 and 0.05 of the largest value, 5 m/s².
    for band, half_mps2 in ((outer, 2.5), (inner, 0.25)):
        widths = (band[:n][:, 1] - band[n:][::-1][:, 1]) / px_per_mps2
        assert widths == pytest.approx(-2.0 * half_mps2, abs=0.02)
    assert all(">" + text + "<" in svg for text in ("-4", "0", "1.4", "2"))


def test_the_page_has_a_drawing_for_what_was_rated_and_reasons_for_what_was_not() -> None:
    rated, none = str(section(UNLIKE)), str(section(NOBODY))
    assert rated.count("<svg") == 1
    assert "is below 0.8" in rated
    assert none.count("<svg") == 0
    assert none.count("not assessable") == 3
    assert "neither brakes" in none
    for html in (rated, none):
        assert "No published limit" in html
        assert ">not yet checked<" in html
        assert "nan" not in html


def test_the_table_has_a_row_for_each_pair(tmp_path: Path) -> None:
    old = load_audit(audit_file(tmp_path / "audit.json", "admitted"))
    assert response_table([old]) is None
    new = [old.model_copy(update={"response": found}) for found in (UNLIKE, NOBODY)]
    rows = by_column(response_table([old, *new]))
    assert [row["verdict"] for row in rows] == ["unlike", *["not assessable"] * 3]
    assert rows[0]["delay"] == pytest.approx(0.3)
    assert rows[0]["gain"] == pytest.approx(0.7, abs=0.005)
    assert rows[0]["overall"] == UNLIKE.pairs[0].rating.overall  # type: ignore[union-attr]
    assert (rows[1]["overall"], rows[1]["why"]) == (None, NOBODY.pairs[0].why[0])


def test_the_report_shows_what_the_audit_says_and_scores_the_same(
    make_bag: Callable[..., Path], tmp_path: Path
) -> None:
    bag, scores = make_bag(), []
    for response in (None, UNLIKE):
        out = tmp_path / str(response is None)
        file = audit_file(tmp_path / "audit.json", "admitted", bag)
        if response is not None:
            told = response.model_dump(mode="json", by_alias=True)
            write_json(file, {**json.loads(file.read_text()), "response": told})
        (result,) = run_campaign(
            [(bag, None)],
            [bridge_spec("constant_velocity")],
            InProcessClients(),
            out,
            CellOptions(),
            propose_labels=True,
            admissions=load_admissions([file]),
        )
        assert result.admission == "admitted"
        scores.append(json.loads((result.folder / "score.json").read_text()))
        page = write_report(out).read_text()
        assert ('<section id="responses">' in page) == (response is not None)
        assert ("the TTC at braking differs by" in page) == (response is not None)
    assert scores[0] == scores[1]


def test_an_audit_of_an_earlier_build_is_read_and_verified(tmp_path: Path) -> None:
    file = audit_file(tmp_path / "audit.json", "admitted")
    value = json.loads(file.read_text())
    del value["response"]
    write_json(file, value)
    old = load_model(Audit, file)
    assert old.response is None
    assert list(_compare(old, old.model_copy(update={"response": UNLIKE}))) == []
    new = old.model_copy(update={"response": UNLIKE})
    (first, *_) = _compare(new, old.model_copy(update={"response": NOBODY}))
    assert first[0].startswith("response.")
