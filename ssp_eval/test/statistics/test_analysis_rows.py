"""Rows of cells: from a CSV file with strict errors, merged over runs, controls kept out."""

import itertools
import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_eval.statistics.csv_rows import COLUMNS, rows_from_csv
from ssp_eval.statistics.rows import MACRO, entering, merged, repeated
from ssp_eval.statistics.table import to_csv, write_tables
from ssp_eval.statistics.tables.notices import OUTAGE, caption_text, everywhere, notices
from ssp_eval.statistics.tables.scores import all_tables, matrix_table
from tests.support.score_rows import row

HEAD = ",".join(COLUMNS)
OWN = HEAD.replace("risk", "rsr") + ",rl_s"
LINE = "cut_in,physical,a,1,0.8,0.5,0.7,0.6,0.4,S@1.50"


def write(tmp_path, *lines, head=HEAD, encoding="utf-8"):
    path = tmp_path / "cells.csv"
    path.write_bytes("\n".join([head, *lines, ""]).encode(encoding))
    return path


def test_a_line_becomes_a_row_with_ivcs_by_the_method(tmp_path):
    (found,) = rows_from_csv(write(tmp_path, LINE))
    assert found.key == ("cut_in", "physical", "a")
    assert (found.rsr, found.rl_s) == (1, 1.5)
    by_hand = 0.1 * 1 + 0.3 * 0.8 + 0.2 * 0.5 + 0.3 * 0.6 + 0.1 * 1
    assert math.isclose(found.ivcs, by_hand, abs_tol=1e-15)


@pytest.mark.parametrize("null", ["", "–", "  ", "—", "-"])
def test_null_components_count_as_zero_and_are_flagged(tmp_path, null):
    line = f"cut_in,physical,a,1,{null},{null},{null},0.6,{null},F"
    (found,) = rows_from_csv(write(tmp_path, line))
    assert (found.sem_acc_eff, found.cia_eff, found.act_acc_eff, found.rl_s) == (None,) * 4
    assert found.ivcs_nulls == ("sem_acc_eff", "cia_eff")
    assert math.isclose(found.ivcs, 0.1 + 0.18, abs_tol=1e-15)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_columns_stand_in_any_order_and_notes_before_the_header(tmp_path, encoding, end):
    names = (*COLUMNS, "sem_cov", "total_b", "active_b", "architecture", "run", "seed")
    fields = [*LINE.split(","), "0.9", "7", "2.5", '"mixture, sparse"', "first", "3"]
    order = [*reversed(range(len(names)))]
    lines = [["# Table 2"], [names[i] for i in order], [fields[i] for i in order], []]
    path = tmp_path / "cells.csv"
    path.write_bytes(end.join(",".join(line) for line in lines).encode(encoding))
    (found,) = rows_from_csv(path)
    assert found.architecture == "mixture, sparse"
    assert (found.total_b, found.active_b, found.sem_cov) == (7.0, 2.5, 0.9)
    assert (found.run, found.seed) == ("first", 3)


def test_a_published_matrix_says_what_was_left_aside(tmp_path):
    """The file has a column of its own, a macro that was rounded, a response that is missing."""
    told: list[str] = []
    lines = (
        "cut_in,Physical,a,1.00,0.80,0.50,0.70,0.60,0.40,S@1.50,0.72,2024",
        "cut_in,Simulation,a,1.00,0.80,—,0.70,0.60,0.40,F,0.70,2024",
        "cut_in,Synthetic,a,1.00,0.80,0.50,0.70,0.60,0.40,—,0.62,2024",
    )
    rows = rows_from_csv(write(tmp_path, *lines, head=f"{HEAD},ivcs,year"), told.append)
    assert [row.domain for row in rows] == ["physical", "simulation", "synthetic"]
    assert [(row.rsr, row.rl_s) for row in rows] == [(1, 1.5), (0, None), (None, None)]
    assert rows[1].ivcs_nulls == ("cia_eff",)
    assert rows[2].ivcs_nulls == ("rsr",)
    assert len(told) == 2
    assert "columns that are ignored: year. Known are scenario" in told[0]
    assert "another value in 1 of 3 lines, most so in line 3: 0.7 there, 0.5200 computed" in told[1]


def test_a_matrix_of_ours_gives_the_same_rows_again(tmp_path):
    """The rows are controls, lost and unadmitted cells, runs, facts, and names hard to write."""
    rows = [
        row(run="=1+1", seed=10, rsr=1, rl_s=1 / 3, total_b=7.5, active_b=0.1, architecture="a, b"),
        row(run="=1+1", seed=2, value=1 / 3, total_b=7.5, active_b=0.1, architecture="a, b", n=9),
        row(model='a "b", #c;\tй', sem_cov=0.6, stfr=0.7, sem_acc_cond=None, sem_acc_soft=0.7),
        row(model="-x", value=0.1 + 0.2, cia_eff=None, admitted=False, stand_in=True),
        row(model="constant_velocity", control=True),
        row("#1", model="silent", control=True, value=0.0),
        row(
            "#1",
            model="d",
            value=None,
            rsr=None,
            status="failed",
            reason="bridge died; exit 1, “signal”",
        ),
        row("#1", model="b", value=None, rsr=None, status="refused", admitted=False, reason=""),
    ]
    told = []
    path, _ = write_tables(tmp_path, [matrix_table(rows)], ["csv"])

    def key(one):
        return *one.key, one.run, one.seed or 0

    assert sorted(rows_from_csv(path, told.append), key=key) == sorted(rows, key=key)
    assert told == []
    tables = {table.name: table for table in all_tables(rows)}
    assert {table.name: table for table in all_tables(rows_from_csv(path))} == tables


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("Syn", "synthetic"),
        ("sim", "simulation"),
        ("PHY", "physical"),
        ("Physical", "physical"),
        ("SIMULATION", "simulation"),
    ],
)
def test_domains_are_read_by_their_short_names_too(tmp_path, name, word):
    (found,) = rows_from_csv(write(tmp_path, replaced("domain", name)))
    assert found.domain == word


MACRO_HEAD = (
    "model,architecture,total_b,active_b,jovr,sem_acc_eff,cia_eff,act_acc_eff,tqsr,atc_eff,"
)
# A table of foundation models as papers print it: one line each, means over six cells.
PUBLISHED = f"""{MACRO_HEAD}rsr,rl_s,ivcs
A,dense,7,7,1.00,0.60,0.40,0.50,0.70,0.40,0.67,1.25,0.64
B,mixture,30,3,0.95,0.50,0.35,–,0.60,–,0.33,0.80,0.53
C,dense,,,0.90,0.40,0.20,0.30,0.50,0.30,0,,0.40
"""


def test_a_published_table_of_macro_scores_is_read(tmp_path):
    told = []
    path = tmp_path / "macro.csv"
    path.write_text(PUBLISHED, encoding="utf-8")
    rows = rows_from_csv(path, told.append)
    assert [one.key for one in rows] == [(MACRO, MACRO, name) for name in "ABC"]
    assert [(one.rsr, one.rl_s) for one in rows] == [(0.67, 1.25), (0.33, 0.8), (0.0, None)]
    # IVCS of the components of A: 0.1 + 0.18 + 0.08 + 0.21 + 0.067; the table says 0.64.
    assert rows[0].ivcs == 0.64
    assert any("each line is taken for a mean over all of them" in text for text in told)
    tables = {table.name: table for table in all_tables(rows, "C")}
    assert not {"by_domain", "strata", "by_scenario_model", "ranks_domain"} & tables.keys()
    models = tables["foundation_models"]
    by = {
        line[0]: dict(zip([column.key for column in models.columns], line, strict=True))
        for line in models.rows
    }
    assert list(by) == ["A", "B", "C"]
    assert by["B"]["rsr"].value == 0.33
    assert by["A"]["d_ivcs"] == pytest.approx(0.6)
    assert by["A"]["d_rsr"] is None
    assert any("Macro rows: each is a published mean" in text for text in everywhere(notices(rows)))
    # What we write of it gives the same rows again.
    (again, *_) = write_tables(tmp_path, [tables["matrix"]], ["csv"])
    assert rows_from_csv(again) == rows


@pytest.mark.parametrize(
    ("scenario", "domain", "kept", "lost"),
    [
        ("cut_in", "macro", {"by_scenario_model", "ranks_model"}, {"by_domain", "ranks_domain"}),
        (
            "Macro",
            "Phy",
            {"by_domain", "by_domain_model", "domain_differences"},
            {"by_scenario_model", "strata"},
        ),
    ],
)
def test_means_over_scenarios_or_domains_alone_keep_the_other(
    tmp_path, scenario, domain, kept, lost
):
    line = f"{scenario},{domain},a,1,0.8,0.5,0.7,0.6,0.4,0.5,"
    rows = rows_from_csv(write(tmp_path, line, head=OWN))
    assert (rows[0].scenario == MACRO, rows[0].domain == MACRO) == (
        scenario == "Macro",
        domain == "macro",
    )
    names = {table.name for table in all_tables(rows)}
    assert kept <= names
    assert not lost & names


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (
            ["macro,macro,a,1,0.8,0.5,0.7,0.6,0.4,0.5,", "cut_in,Sim,a,1,0.8,0.5,0.7,0.6,0.4,0,"],
            "cells.csv:3: is a cell, and the lines before are a mean over domains and scenarios; "
            "analyse them apart",
        ),
        (["macro,macro,a,1,0.8,0.5,0.7,0.6,0.4,67,"], "rsr: Input should be less than or equal"),
        (["macro,macro,a,1,0.8,0.5,0.7,0.6,0.4,0,1.5"], "rl_s is given where no cell has"),
        (["macro,macro,a,1,0.8,0.5,0.7,0.6,0.4,0.5,-1"], "rl_s: Input should be greater"),
        (
            ["cut_in,Sim,a,1,0.8,0.5,0.7,0.6,0.4,0.5,"],
            "rsr is neither 1 nor 0: give each run of a cell a line of its own; of a mean over "
            "cells, write macro as its scenario, domain or both",
        ),
    ],
)
def test_wrong_macro_rows_say_what_is_right(tmp_path, lines, told):
    with pytest.raises(InputError) as caught:
        rows_from_csv(write(tmp_path, *lines, head=OWN))
    assert told in str(caught.value)


def test_a_macro_row_has_no_single_response(tmp_path):
    with pytest.raises(InputError, match=r"risk is the response of a single cell.*rsr, the share"):
        rows_from_csv(write(tmp_path, replaced("domain", "macro")))


def replaced(column, value):
    fields = dict(zip(COLUMNS, LINE.split(","), strict=True)) | {column: value}
    return ",".join(fields[name] for name in COLUMNS)


@pytest.mark.parametrize(
    ("column", "value", "told"),
    [
        ("jovr", "1.01", "less than or equal to 1 (got '1.01'); scores are shares from 0 to 1"),
        ("jovr", "0_1", "is no number (got '0_1'); scores are shares from 0 to 1"),
        ("jovr", "-0.01", "greater than or equal to 0"),
        ("cia_eff", "nan", "less than or equal to 1"),
        ("cia_eff", "1e999", "less than or equal to 1"),
        ("cia_eff", "50%", "valid number"),
        (
            "cia_eff",
            '"0,5"',
            "valid number, unable to parse string as a number (got '0,5'); scores",
        ),
        ("domain", "Phys", "is no domain; known: synthetic"),
        ("model", " ", "Field required"),
    ],
)
def test_wrong_values_name_file_line_column_value_and_remedy(tmp_path, column, value, told):
    other = replaced("model", "b")
    with pytest.raises(InputError) as caught:
        rows_from_csv(write(tmp_path, other, replaced(column, value)))
    message = str(caught.value)
    assert f"cells.csv:3: {column}: " in message
    assert told in message
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("column", "value", "told"),
    [
        *[("risk", text, "risk must be S@1.50") for text in ("S", "S@-1.0", "S@", "f", "S@1,50")],
        *[(name, text, "never null") for name, text in (("jovr", ""), ("tqsr", "–"))],
    ],
)
def test_wrong_lines_say_what_is_right(tmp_path, column, value, told):
    line = replaced(column, f'"{value}"' if "," in value else value)
    with pytest.raises(InputError, match=rf"cells\.csv:2: .*{told}"):
        rows_from_csv(write(tmp_path, line))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "cells.csv:1: is empty"),
        ("\n\n", "is empty"),
        (HEAD, "holds no cells"),
        (HEAD.replace(",risk", ""), "cells.csv:1: misses the column risk"),
        (HEAD.replace("scenario,domain,", ""), "misses the columns scenario, domain"),
        (f"{HEAD},jovr\n{LINE},1", "has a column twice (got 'jovr')"),
        (",".join(map(str, range(1_000_000))), "has 1000000 columns, at most 1000 are read"),
        (f"{HEAD}\n{LINE},1", "cells.csv:2: has 11 fields, the header has 10"),
        (f'{HEAD}\n"{LINE}', "is no CSV"),
        (f"{HEAD}\n{LINE}\n\n{LINE}", "cells.csv:4: cell cut_in / physical / a stands in line 2"),
        (f"{HEAD},total_b,active_b\n{LINE},2,3", "cells.csv:2: active_b is more than total_b"),
        (
            f"{HEAD},total_b\n{LINE},2\n{LINE.replace('physical', 'simulation')},3",
            "cells.csv:3: total_b: differs for a from line 2 (got 3.0)",
        ),
        (f"{HEAD}\n{LINE.replace('0.8', '0,8')}", "write decimals with a point"),
        (f"{HEAD},ivcs\n{LINE},61", "cells.csv:2: ivcs: Input should be less than or equal to 1"),
        (f"{HEAD},admitted\n{LINE},maybe", "admitted: Input should be a valid boolean"),
        (f"{HEAD},status\n{LINE},done", "status: Input should be 'ok', 'refused' or 'failed'"),
        (f"{HEAD},status\n{LINE},refused", "a cell that is refused has no scores"),
        (f"{HEAD},n\n{LINE},0", "n: Input should be greater than or equal to 1"),
        (f"{OWN}\n{LINE.replace('S@1.50', '1')},", "rl_s is missing for a response"),
        (f"{OWN}\n{LINE.replace('S@1.50', '0.5')},", "rsr is neither 1 nor 0"),
        (f"{OWN}\n{LINE.replace('S@1.50', '1')},-1", "rl_s: Input should be greater than or equal"),
        *[
            (f"{HEAD},{name}\n{LINE},1{'0' * 400}", f"cells.csv:2: {name}: Input should be less")
            for name in ("n", "seed", "lost")
        ],
        *[
            (f"{HEAD},rsr,rl_s\n{LINE.replace('S@1.50', said)},{given}", "give one of the two")
            for said, given in (("F", "1,1.5"), ("S@1.50", "0,"), ("S@1.50", ",1.5"))
        ],
        *[
            (f"{OWN}\n{LINE.replace('S@1.50', rsr)},1.5", "rl_s is given where there is no resp")
            for rsr in ("0", "")
        ],
        (f"{HEAD},stfr\n{LINE},0.58", "tqsr is 0.6, more than stfr, 0.58: check the two"),
        (f"{HEAD},sem_cov\n{LINE},0.78", "sem_acc_eff is 0.8, more than sem_cov, 0.78"),
        (f"{HEAD},sem_acc_soft\n{LINE},0.1", "sem_acc_eff is 0.8, more than sem_acc_soft, 0.1"),
        (f"{HEAD},seed\n{LINE},1.5", "seed: Input should be a valid integer"),
        (f"{HEAD},total_b\n{LINE},0", "total_b: Input should be greater than 0"),
    ],
)
def test_wrong_files_say_where(tmp_path, text, told):
    path = tmp_path / "cells.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        rows_from_csv(path)
    assert told in str(caught.value)


def test_a_share_may_exceed_its_whole_by_the_rounding_of_print(tmp_path):
    head = f"{HEAD},stfr,sem_cov,sem_acc_soft,seed"
    (found,) = rows_from_csv(write(tmp_path, f"{LINE},0.59,0.79,0.79,{2**53}", head=head))
    assert (found.stfr, found.tqsr, found.seed) == (0.59, 0.6, 2**53)


def test_a_missing_file_and_latin_1_are_input_errors(tmp_path):
    with pytest.raises(InputError, match="can't be read"):
        rows_from_csv(tmp_path / "none.csv")
    with pytest.raises(InputError, match="is not UTF-8"):
        rows_from_csv(write(tmp_path, LINE.replace("cut_in", "é"), encoding="latin-1"))


_PARTS = st.lists(st.sampled_from([*"abS@01.,;\t\n\r\"'–F ", HEAD, LINE, "\n"]), max_size=20)


@settings(max_examples=200, deadline=None)
@given(start=st.sampled_from(["", f"{HEAD}\n", f"{HEAD}\n{LINE}\n"]), parts=_PARTS)
def test_whatever_stands_in_a_file_it_is_read_or_refused(tmp_path_factory, start, parts):
    path = tmp_path_factory.mktemp("any") / "cells.csv"
    path.write_text(start + "".join(parts), encoding="utf-8", newline="")
    refusal = ""
    rows = []
    try:
        rows = rows_from_csv(path)
    except InputError as error:
        refusal = str(error)
    assert bool(rows) == (not refusal)
    assert "cells.csv" in refusal or all(0.0 <= row.ivcs <= 1.0 for row in rows)


def test_runs_of_a_cell_are_told_apart_and_merged(tmp_path):
    lines = [f"{LINE},1", f"{LINE.replace('S@1.50', 'F').replace('0.6', '0.2')},2"]
    rows = rows_from_csv(write(tmp_path, *lines, head=f"{HEAD},seed"))
    assert repeated(rows)
    (one,) = merged(rows)
    assert (one.rsr, one.rl_s, one.tqsr) == (0.5, 1.5, 0.4)
    assert one.ivcs == pytest.approx((rows[0].ivcs + rows[1].ivcs) / 2, abs=1e-15)


@given(order=st.permutations(range(6)))
def test_merging_does_not_depend_on_the_order(order):
    rows = [
        row(scenario=s, value=v, seed=k, rsr=k % 2)
        for k, (s, v) in enumerate(itertools.product("ab", (0.1, 0.3, 0.7)))
    ]
    values = {one.key: (one.ivcs, one.jovr) for one in merged([rows[i] for i in order])}
    assert values == {one.key: (one.ivcs, one.jovr) for one in merged(rows)}


def test_controls_are_known_by_their_names_as_in_a_campaign(tmp_path):
    names = ("perfect", "silent", "recorded", "a+black", "a+shuffled", "a", "b+c")
    lines = [replaced("model", name) for name in names]
    rows = rows_from_csv(write(tmp_path, *lines))
    assert [one.model for one in rows if one.control] == list(names[:5])
    assert [one.model for one in entering(rows)] == ["a", "b+c"]


def test_controls_and_invalid_cells_enter_nothing():
    rows = [
        row(),
        row(model="perfect", control=True),
        row(scenario="t", status="failed", reason="bridge died"),
    ]
    assert [one.key for one in entering(rows)] == [("s", "physical", "m")]
    assert rows[2].ivcs is None
    assert rows[2].ivcs_nulls == ()


def lines_of(*names, key="model"):
    """A line per name, otherwise alike."""
    at = COLUMNS.index(key)
    parts = LINE.split(",")
    return [",".join([*parts[:at], name, *parts[at + 1 :]]) for name in names]


@pytest.mark.parametrize("key", ["model", "scenario"])
@pytest.mark.parametrize(
    "pair",
    [
        ("Qwen2-VL", "qwen2 vl"),
        ("cut_in", "Cut-In"),
        ("A–1", "a1"),
        ("Lynx 7B", "lynx_7b"),
        ("A\u200bB", "ab"),
    ],
)
def test_names_that_differ_in_case_dashes_or_spaces_only_are_told(tmp_path, key, pair):
    told: list[str] = []
    rows = rows_from_csv(write(tmp_path, *lines_of(*pair, "other", key=key)), told.append)
    (text,) = told
    assert f"names of {key}s that differ in case, dashes or spaces only" in text
    assert all(name in text for name in pair)
    assert "other" not in text
    (notice,) = [one for one in notices(rows) if "differ in case" in one.text]
    assert notice.everywhere
    assert {*notice.about} == {*pair}


@pytest.mark.parametrize(
    "name",
    [
        "mean",
        "Average",
        "OVERALL",
        "avg",
        "Mean of all models",
        "Gesamt",
        "Weighted average",
        "Model average",
        "Model mean",
        "scenario mean",
        "domain_mean",
        "Average (n=3)",
        "mean3",
        "Mean of 5 models",
        "arithmetic mean",
        "overall performance",
        "overall result",
        "macroaverage",
        "Macro-average",
        "Median",
        "All 5 models",
        "Gesamtmittel",
        "MeanIVCS",
        "AvgScore",
        "Mean of ours",
    ],
)
@pytest.mark.parametrize("key", ["model", "scenario"])
def test_a_row_that_is_called_a_mean_is_told(tmp_path, key, name):
    told: list[str] = []
    rows = rows_from_csv(write(tmp_path, *lines_of("a", "b", name, key=key)), told.append)
    (text,) = told
    assert f"named like a mean, and counted as a {key} like any other: {name}." in text
    assert any("Named like a mean" in one for one in everywhere(notices(rows)))


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("Perfect", "perfect"),
        ("best constant", "best_constant"),
        ("a+Black", "a+black"),
        ("a + shuffled", "a+shuffled"),
        ("A+Twin.without.ot1", "A+twin.without.ot1"),
        ("a+BLIND", "a+blind"),
    ],
)
def test_a_name_that_is_nearly_a_controls_is_told(tmp_path, name, written):
    told: list[str] = []
    rows_from_csv(write(tmp_path, *lines_of("m", name)), told.append)
    (text,) = told
    assert f"but for case, dashes or spaces: {name}. A control is written {written};" in text


def test_what_an_outage_cost_comes_back_from_a_file(tmp_path):
    black = row(model="a+black", control=True, lost=1)
    lost = [black, row(model="b", lost=2), row(model="c")]
    path = tmp_path / "matrix.csv"
    path.write_text(to_csv(matrix_table(lost)))
    rows = rows_from_csv(path)
    assert {one.model: one.lost for one in rows} == {"b": 2, "a+black": 1, "c": 0}
    (notice,) = [one for one in notices(rows) if one.kind == OUTAGE]
    assert notice.everywhere
    assert "no answer at 3 label times" in notice.text
    assert notice.about == ("s / physical / b", "s / physical / a+black")
    assert notice.text in caption_text(rows)
    assert caption_text([one for one in rows if not one.lost]) == ""
    assert merged([row(run="1", lost=2), row(run="2", lost=1)])[0].lost == 3


def test_sound_names_are_told_nothing(tmp_path):
    told: list[str] = []
    names = (
        "MeanFlow",
        "TotalCapture",
        "MeanVC",
        "overtake",
        "all_in_one",
        "model 1",
        "model 2",
        "Alpamayo-R1",
        "OpenEMMA",
        "grand",
        "median_barrier",
        "total-stop-7B",
        "Overallocated",
    )
    rows_from_csv(write(tmp_path, *lines_of(*names)), told.append)
    rows_from_csv(write(tmp_path, *lines_of(*names, key="scenario")), told.append)
    assert told == []


def test_a_controls_name_is_no_models(tmp_path):
    """A file that doesn't mark its controls gets a notice; one that denies them is refused."""
    told: list[str] = []
    lines = lines_of("a", "perfect", "a+black", "constant_velocity", "Silent")
    rows = rows_from_csv(write(tmp_path, *lines), told.append)
    assert [one.model for one in rows if one.control] == ["perfect", "a+black"]
    first, second, third = told
    assert "controls of the harness, which enter no mean: a+black, perfect." in first
    assert "ranked like models: constant_velocity." in second
    assert "but for case, dashes or spaces: Silent. A control is written silent" in third

    told.clear()
    head = f"{HEAD},control"
    said = [f"{line},yes" for line in lines]
    assert all(one.control for one in rows_from_csv(write(tmp_path, *said, head=head), told.append))
    assert told == []
    for name in ("perfect", "a+shuffled"):
        denied = [f"{line},no" for line in lines_of("a", name)]
        with pytest.raises(InputError, match=rf"csv:3: {re.escape(name)} is the name of a control"):
            rows_from_csv(write(tmp_path, *denied, head=head))
    # An answerer that drives as a model is one where somebody says so.
    (found,) = rows_from_csv(
        write(tmp_path, *[f"{x},no" for x in lines_of("constant_velocity")], head=head), told.append
    )
    assert not found.control
    assert told == []
