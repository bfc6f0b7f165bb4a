"""Tables of rows: what stands in them, and how they are written in each format."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import fields

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_eval.report.render import MOST_ROWS, statistics_parts
from ssp_eval.score.aggregate import Mean
from ssp_eval.score.metrics import METRIC_NAMES, CellMetrics
from ssp_eval.statistics.csv_rows import rows_from_csv
from ssp_eval.statistics.table import (
    FORMATS,
    Column,
    Outcome,
    Table,
    latex_text,
    texts,
    to_csv,
    to_data,
    to_latex,
    to_notes,
)
from ssp_eval.statistics.tables.scores import all_tables, sd
from tests.support.score_rows import row

THIRD = 1 / 3


ROWS = [
    row("cut_in", "physical", "a", THIRD, rsr=1, rl_s=1.5, total_b=30.0, active_b=3.0),
    row("cut_in", "synthetic", "a", 0.5, cia_eff=None, total_b=30.0, active_b=3.0),
    row("vru", "physical", "a", 0.1, total_b=30.0, active_b=3.0),
    row("cut_in", "physical", "b", 0.2, architecture="dense"),
    row("vru", "physical", "b", 0.6, architecture="dense", admitted=False),
    row("cut_in", "physical", "perfect", 1.0, control=True),
    row("vru", "synthetic", "b", None, rsr=None, status="failed", reason="bridge died"),
]


def tables(rows=ROWS, reference=None):
    return {table.name: table for table in all_tables(rows, reference)}


def records(table):
    keys = [column.key for column in table.columns]
    return [dict(zip(keys, values, strict=True)) for values in table.rows]


def test_the_matrix_shows_every_cell_and_says_what_is_wrong_with_it():
    found = {(r["scenario"], r["domain"], r["model"]): r for r in records(tables()["matrix"])}
    assert len(found) == len(ROWS)
    assert found[("cut_in", "physical", "perfect")]["remark"] == "control"
    lost = found[("vru", "synthetic", "b")]
    assert (lost["ivcs"], lost["remark"]) == (None, "failed: bridge died")
    assert found[("cut_in", "synthetic", "a")]["remark"] == "null: CIA"
    assert found[("vru", "physical", "b")]["remark"] == "not admitted"
    # Domains in their own order, not by name.
    assert [r["domain"] for r in records(tables()["matrix"])[:2]] == ["synthetic", "physical"]


def test_means_have_their_n_and_leave_out_what_must_be():
    found = tables()
    by_model = {r["model"]: r for r in records(found["by_model"])}
    assert set(by_model) == {"a", "b"}
    assert by_model["a"]["jovr"] == Mean(pytest.approx((THIRD + 0.5 + 0.1) / 3), 3)
    assert by_model["a"]["cia_eff"].n == 2
    assert by_model["a"]["rl_s"] == Mean(1.5, 1)
    assert by_model["b"]["n"] == 2
    by_domain = {r["domain"]: r["n"] for r in records(found["by_domain"])}
    # The unadmitted cell is out of domain means, the failed one of all.
    assert by_domain == {"synthetic": 1, "physical": 3}
    notes = " ".join(found["by_domain"].notes)
    assert "1 cell left out: the transfer audit did not admit" in notes
    assert "1 cell without a score left out" in notes
    assert "Controls left out: perfect." in notes


def test_strata_by_hand():
    found = {(r["scenario"], r["domain"]): r for r in records(tables()["strata"])}
    first = found[("cut_in", "physical")]
    a, b = 0.9 * THIRD + 0.1, 0.9 * 0.2
    assert (first["n"], first["best"]) == (2, "a")
    assert first["mean"] == pytest.approx((a + b) / 2)
    assert first["sd"] == pytest.approx(abs(a - b) / 2**0.5)
    assert found[("vru", "physical")]["sd"] is None
    assert sd([0.5]) is None


def test_foundation_models_are_compared_with_the_reference():
    (a, b) = sorted(records(tables(reference="b")["foundation_models"]), key=lambda r: r["model"])
    assert (a["total_b"], a["active_b"], a["architecture"]) == (30.0, 3.0, None)
    base = b["jovr"].value
    assert a["d_jovr"] == (a["jovr"].value - base) / base
    assert b["d_jovr"] == 0.0
    # The reference has no response, so no relative difference to it has a meaning.
    assert a["d_rsr"] is None
    notes = " ".join(tables(reference="b")["foundation_models"].notes)
    assert "not scored on the same cells" in notes
    with pytest.raises(InputError, match=r"no model with a valid cell.*known: a, b"):
        tables(reference="perfect")


def test_changes_of_rank_are_pointed_out():
    found = {r["model"]: r for r in records(tables()["ranks_model"])}
    assert (found["a"]["rank_cut_in"], found["a"]["rank_vru"]) == (1, 2)
    assert found["a"]["changes"] == "1 in cut_in, 2 in vru"
    assert found["b"]["changes"] == "2 in cut_in, 1 in vru"
    assert set(found) == {"a", "b"}


def test_runs_are_averaged_before_cells_are():
    rows = [row("s", "physical", "a", v, seed=k) for k, v in enumerate((0.2, 0.4))]
    rows.append(row("t", "physical", "a", 0.9, seed=0))
    (found,) = records(tables(rows)["by_model"])
    assert found["jovr"] == Mean(pytest.approx((0.3 + 0.9) / 2), 2)
    assert any("mean over its runs" in note for note in tables(rows)["by_model"].notes)
    assert len(tables(rows)["matrix"].rows) == 3


def test_a_lost_run_is_no_lost_cell():
    rows = [
        row("s", "physical", "a", 0.2, seed=0),
        row("s", "physical", "a", None, seed=1, rsr=None, status="failed", reason="died"),
        row("t", "physical", "a", 0.2, cia_eff=None),
    ]
    notes = tables(rows)["by_model"].notes
    assert "1 run without a score left out of cells that have other runs; see the" in (
        " ".join(notes)
    )
    assert not any("1 cell without a score" in note for note in notes)
    assert "In 1 cell a component has no denominator: 0 in IVCS." in notes


def test_no_cell_at_all_gives_empty_tables():
    for table in tables([ROWS[-1]]).values():
        for files in FORMATS.values():
            assert "IVCS is no safety certificate." in files[-1][1](table)


@given(order=st.permutations(ROWS))
def test_the_order_of_rows_changes_nothing(order):
    assert all_tables(order) == all_tables(ROWS)


EVIL = '<script>alert("x")</script> & 50% of $x_1$ {a} \\b ~^ #1 [c]'
SMALL = Table(
    "small",
    EVIL,
    (
        Column("name", "name_of", "text"),
        Column("n", "n", "count"),
        Column("x", "x"),
        Column("d", "Δ x", "change"),
        Column("response", "risk", "response"),
        Column("p", "p", "p"),
    ),
    (
        (EVIL, 3, Mean(THIRD, 3), -0.25, Outcome(1, 1.5), 0.03125),
        ("=1+1", 3, Mean(0.1 + 0.2, 2), None, Outcome(0, None), 0.00001),
        ("–", 0, Mean(None, 0), 0.0, None, None),
    ),
    ("A note: 5 % < 6 %.",),
)


def test_csv_has_all_digits_and_reads_back():
    lines = list(csv.reader(io.StringIO(to_csv(SMALL))))
    assert lines[0] == ["name", "n", "x", "x_n", "d", "rsr", "rl_s", "p"]
    assert lines[1] == [EVIL, "3", repr(THIRD), "3", "-0.25", "1", "1.5", "0.03125"]
    # Text that a spreadsheet would compute is guarded; numbers are not.
    assert lines[2][:4] == ["'=1+1", "3", "0.30000000000000004", "2"]
    assert lines[3][2:7] == ["", "0", "0.0", "", ""]
    assert len(lines) == 4
    told = to_notes(SMALL).split("\n\n")
    assert told == [EVIL, "A note: 5 % < 6 %.", "IVCS is no safety certificate.\n"]


def test_json_is_a_table_schema_with_all_digits():
    """``pandas.read_json(file, orient="table")`` reads it: typed fields and flat rows of them."""
    found = json.loads(json.dumps(to_data(SMALL), allow_nan=False))
    assert [(f["name"], f["type"], f["kind"]) for f in found["schema"]["fields"]] == [
        ("name", "string", "text"),
        ("n", "integer", "count"),
        ("x", "number", "ratio"),
        ("x_n", "integer", "count"),
        ("d", "number", "change"),
        ("rsr", "number", "ratio"),
        ("rl_s", "number", "seconds"),
        ("p", "number", "p"),
    ]
    names = [field["name"] for field in found["schema"]["fields"]]
    assert all(list(row) == names for row in found["data"])
    first, second, last = found["data"]
    assert (first["name"], first["x"], first["x_n"]) == (EVIL, THIRD, 3)
    assert (first["rsr"], first["rl_s"]) == (1, 1.5)
    assert second["name"] == "=1+1"  # no spreadsheet reads it
    assert (last["x"], last["x_n"], last["d"], last["rsr"]) == (None, 0, 0.0, None)
    assert (found["name"], found["title"]) == ("small", EVIL)
    assert found["notes"][-1] == "IVCS is no safety certificate."
    # ``integer`` is an int64 to a reader, which has no null.
    lacking = Table("t", "t", (Column("n", "n", "count"),), ((3,), (None,)))
    assert to_data(lacking)["schema"]["fields"][0]["type"] == "number"


def test_latex_has_three_decimals_and_nothing_that_tex_would_obey():
    text = to_latex(SMALL)
    body = text.split(r"\midrule")[1].split(r"\bottomrule")[0]
    fields = [line.removesuffix(r" \\").split(" & ") for line in body.strip().splitlines()]
    assert [len(f) for f in fields] == [6, 6, 6]
    assert fields[0][1:] == ["3", "0.333", r"$-$25.0\%", "S@1.50", "0.031"]
    assert fields[1][1:] == ["3", "0.300 (n=2)", "--", "F", "1.0e$-$05"]
    assert r"\toprule" in text
    assert "IVCS is no safety certificate." in text
    assert_balanced(text)


def assert_balanced(text: str) -> None:
    """Groups and environments close, and no line ends in a comment of its own."""
    plain = re.sub(r"\\[\\{}$&#%_]", "", re.sub(r"^%.*$", "", text, flags=re.MULTILINE))
    depth = 0
    for character in plain:
        depth += {"{": 1, "}": -1}.get(character, 0)
        assert depth >= 0
    assert depth == 0
    assert plain.count("$") % 2 == 0
    assert not set("%#_~^") & set(plain)
    begun: list[str] = []
    for kind, name in re.findall(r"\\(begin|end)\{(\w+)\}", text):
        if kind == "begin":
            begun.append(name)
        else:
            assert begun.pop() == name
    assert begun == []


@given(text=st.text(alphabet=st.characters(exclude_categories=("Cs",)), max_size=30))
def test_whatever_a_name_holds_latex_stays_balanced(text):
    table = Table("t", text, (Column("a", text, "text"),), ((text,),), (text,))
    assert "\n" not in latex_text(text)
    assert_balanced(to_latex(table))


def test_a_row_that_does_not_fit_is_a_bug():
    with pytest.raises(ValueError, match="a row of 2 values"):
        Table("t", "t", (Column("a", "a"),), ((1.0, 2.0),))


def test_what_rounds_to_0_has_no_sign():
    table = Table("t", "t", (Column("a", "a"), Column("d", "d", "change")), ((-1e-9, -1e-9),))
    assert texts(table, table.rows[0]) == ["0.000", "+0.0%"]
    assert to_data(table)["data"] == [{"a": -1e-9, "d": -1e-9}]


def test_a_page_shows_the_beginning_of_a_long_table_and_says_so():
    rows = tuple((f"row {k}",) for k in range(MOST_ROWS + 1))
    long = Table("intervals_cells", "long", (Column("a", "a", "text"),), rows)
    empty = Table("comparisons", "empty", (Column("a", "a", "text"),), ())
    ((title, (shown,)),) = statistics_parts([empty, long]).items()
    assert (title, shown.title, len(shown.rows)) == ("Intervals", "long", MOST_ROWS)
    assert f"The first {MOST_ROWS} of {MOST_ROWS + 1} rows" in shown.notes[0]
    assert shown.notes[-1] == "IVCS is no safety certificate."


@pytest.mark.parametrize("name", METRIC_NAMES)
def test_a_metric_is_in_scores_rows_files_and_tables_by_its_one_entry(name, tmp_path):
    assert name in {field.name for field in fields(CellMetrics)}
    assert hasattr(row(), name)
    (matrix,) = [table for table in all_tables([row()]) if table.name == "matrix"]
    path = tmp_path / "matrix.csv"
    path.write_text(to_csv(matrix))
    assert name in path.read_text().splitlines()[0].split(",")
    noted = []
    rows_from_csv(path, noted.append)
    assert noted == []
