"""One table, one place: page and files show the same rows, numbers and notices."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from evaluation_files import audit_file, resealed

from ssp_core.cli import main
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conditions.expansion import with_controls
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.admission import load_admissions
from ssp_eval.evaluate.store.results import load_cells
from ssp_eval.report.render import seeing_plot
from ssp_eval.score.aggregate import Mean
from ssp_eval.statistics.constants import constant_rows, constant_table, constants_of_cells
from ssp_eval.statistics.rows import rows_from_campaign
from ssp_eval.statistics.table import MOST_NAMED, Column, Table, some, to_data
from ssp_eval.statistics.tables.controls import AS_MUCH, UNPAIRED, control_tables, seeing_table
from ssp_eval.statistics.tables.grids import common_notes, grid
from ssp_eval.statistics.tables.notices import everywhere, notices
from ssp_eval.statistics.tables.scores import MEAN_TABLES, MOST_PAIRED, all_tables, condition_of
from ssp_eval.statistics.tables.statistics import failures_by_cell
from tests.support.score_rows import row

BagMaker = Callable[..., Path]
PAGE_TABLES = (
    *MEAN_TABLES,
    "strata",
    "domain_differences",
    "domain_differences_model",
    "ranks_model",
    "ranks_domain",
    "seeing",
    "answerers",
    "best_constants",
    "first_failures",
)
DIGITS = {"ratio": 3, "signed": 3, "seconds": 2}


class Tables(HTMLParser):
    """Fields of the tables of a page by name: text and, apart from it, the n of a mean."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: dict[str, list[list[list[str]]]] = {}
        self._name = ""
        self._in_field = self._in_n = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "table":
            self._name = dict(attrs).get("data-table") or ""
        if not self._name:
            return
        if tag == "tr":
            self.tables.setdefault(self._name, []).append([])
        self._in_field |= tag == "td"
        self._in_n |= tag == "small"
        if tag == "td":
            self.tables[self._name][-1].append(["", ""])

    def handle_endtag(self, tag: str) -> None:
        self._in_field &= tag != "td"
        self._in_n &= tag != "small"
        if tag == "table":
            self._name = ""

    def handle_data(self, data: str) -> None:
        if self._name and self._in_field:
            self.tables[self._name][-1][-1][self._in_n] += data


@pytest.fixture(scope="module")
def written(bag_writer: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with its controls, its page and its tables."""
    folder = tmp_path_factory.mktemp("tables")
    bags = [
        bag_writer(folder / "a"),
        bag_writer(folder / "b", domain="physical", stand_in=True),
        bag_writer(folder / "c", scenario="vru_crossing"),
    ]
    models = with_controls([bridge_spec("opencv_baseline")])
    out = folder / "out"
    admissions = load_admissions([audit_file(folder / "audit.json", "admitted", *bags[:2])])
    run_campaign(
        [(bag, None) for bag in bags],
        models,
        InProcessClients(),
        out,
        CellOptions(),
        True,
        admissions,
    )
    # One cell of a model under black frames is lost, so that a mean is over fewer recordings.
    lost = {"status": "failed", "reasons": ["bridge died"]}
    resealed(out / "cells/cut_in__physical__opencv_baseline+black", lambda f: f.update(lost))
    args = ["report", out, "--tables", out / "tables", "--resamples", "200"]
    assert main([str(arg) for arg in args]) == 0
    return out


@pytest.fixture(scope="module")
def data(written: Path) -> dict[str, Any]:
    """The same tables with all digits, by name."""
    rows, cells = rows_from_campaign(written), load_cells(written)
    constants = constants_of_cells(rows, cells)
    shown = [*rows, *constant_rows(constants)]
    found = [*all_tables(shown), constant_table(constants), failures_by_cell(cells)]
    listed = json.loads((written / "tables" / "statistics.json").read_text())["tables"]
    return {one["name"]: one for one in (*map(to_data, found), *listed)}


def lines(file: Path) -> list[list[str]]:
    return list(csv.reader(io.StringIO(file.read_text("utf-8"))))


def rounded(kind: str, value: Any) -> str | None:
    """Return a value as a table shows it to people; None for one that isn't a number to round."""
    if value is None:
        return "–"
    if kind in DIGITS:
        sign = "+" if kind == "signed" else ""
        return f"{value:{sign}z.{DIGITS[kind]}f}"
    return str(value) if kind == "count" else None


def columns_of(data: dict[str, Any]) -> list[dict[str, str]]:
    """Columns as people see them: an n stands beside its mean; a cell's response is one column."""
    fields = data["schema"]["fields"]
    names = {field["name"] for field in fields}
    response = data["name"] == "matrix"
    return [
        {**field, "name": "response"} if response and field["name"] == "rsr" else field
        for field in fields
        if field["name"].removesuffix("_n") not in names - {field["name"]}
        and not (response and field["name"] == "rl_s")
    ]


def test_the_page_shows_the_numbers_of_the_tables(written: Path, data: dict[str, Any]) -> None:
    found = Tables()
    found.feed((written / "index.html").read_text("utf-8"))
    assert set(PAGE_TABLES) - {"ranks_model"} <= set(found.tables)  # one model has no ranks
    compared = 0
    for name in PAGE_TABLES:
        shown, rows = found.tables.get(name, []), data[name]["data"]
        columns = [
            column
            for column in columns_of(data[name])
            if column["kind"] != "text" or any(row[column["name"]] for row in rows)
        ]
        if name == "first_failures":  # the page has models and controls apart
            rows = sorted(rows, key=lambda row: row["model"] != "opencv_baseline")
        fields = [row for row in shown if row]
        assert len(fields) == len(rows) or name == "ranks_model", name
        rows = rows[: len(fields)]
        for line, texts in zip(rows, fields, strict=True):
            assert len(texts) == len(columns), name
            for column, (text, n) in zip(columns, texts, strict=True):
                key = column["name"]
                if key == "response":
                    continue
                if f"{key}_n" in line:
                    own = line[f"{key}_n"]
                    assert n == (f"n={own}" if own not in (line.get("n"), 0, None) else "")
                wanted = rounded(column["kind"], line[key])
                if wanted is not None:
                    assert text == ("·" if wanted == "0" and text == "·" else wanted), name
                    compared += 1
    assert compared > 200


def test_the_files_of_a_table_have_the_same_numbers(written: Path, data: dict[str, Any]) -> None:
    for name in PAGE_TABLES:
        file = written / "tables" / f"{name}.csv"
        head, *rest = lines(file)
        latex = file.with_suffix(".tex").read_text()
        assert head == [field["name"] for field in data[name]["schema"]["fields"]]
        for entry, line in zip(data[name]["data"], rest, strict=True):
            of = dict(zip(head, line, strict=True))
            for column in columns_of(data[name]):
                key, kind = column["name"], column["kind"]
                if kind in DIGITS and entry[key] is not None:
                    assert float(of[key]) == entry[key]
                    text = rounded(kind, entry[key])
                    assert text is not None
                    assert text.replace("-", "$-$") in latex


def test_values_have_the_types_that_their_fields_tell(data: dict[str, Any]) -> None:
    types = {"string": (str,), "integer": (int,), "number": (int, float)}
    assert len(data) > 15
    for name, table in data.items():
        for line in table["data"]:
            for field in table["schema"]["fields"]:
                value = line[field["name"]]
                null = value is None and field["type"] != "integer"
                assert null or type(value) in types[field["type"]], (name, field, value)


def test_what_cells_can_t_be_compared_for_stands_under_every_table(written: Path) -> None:
    folder = written / "tables"
    told = json.loads((folder / "statistics.json").read_text())["notices"]
    strong = [one["text"] for one in told if one["everywhere"]]
    assert any("software stand-in" in text for text in strong)
    assert any(text.startswith("Unaudited") for text in strong)
    assert any("cut_in / physical / opencv_baseline+black" in one["text"] for one in told)
    page = (written / "index.html").read_text("utf-8")
    assert [one["text"] for one in told] == [line[1] for line in lines(folder / "notices.csv")[1:]]
    for text in strong:
        assert f'<li class="strong">{text}</li>' in page
    names = [file.stem for file in folder.glob("*.csv")]
    assert len(names) > 15
    for name in names:
        latex = (folder / f"{name}.tex").read_text()
        notes = (folder / f"{name}.notes.txt").read_text().split("\n\n")
        assert notes[1 : 1 + len(strong)] == strong
        assert all(text.replace("_", r"\_") in latex for text in strong)


def test_what_seeing_is_worth_by_hand() -> None:
    rows = [
        row("cut_in", "simulation", "m", 0.8),
        row("cut_in", "physical", "m", 0.4),
        row("cut_in", "simulation", "m+black", 0.5, control=True),
        row("cut_in", "physical", "m+shuffled", 0.4, control=True),
        row("cut_in", "simulation", "gone+black", 0.5, control=True),
        row("cut_in", "simulation", "copy_history", 0.1, control=True),
    ]
    seeing, answerers = control_tables(rows)
    keys = [column.key for column in seeing.columns]
    found = [dict(zip(keys, values, strict=True)) for values in seeing.rows]
    by = {(one["model"], one["condition"]): one for one in found}
    black = by["m", "black"]
    # Only the recording that both were scored on; RSR is 0, so IVCS is 0.9 of the value.
    assert (black["n"], black["tqsr"], black["tqsr_spoilt"]) == (1, Mean(0.8, 1), Mean(0.5, 1))
    assert black["ivcs_difference"] == pytest.approx(0.9 * 0.3)
    assert not black["finding"]
    assert by["m", "shuffled"]["finding"] == AS_MUCH
    assert (by["gone", "black"]["n"], by["gone", "black"]["finding"]) == (0, UNPAIRED)
    assert [r[0] for r in answerers.rows] == ["copy_history"]
    drawn = seeing_plot(seeing, answerers)
    assert "m, black frames: 0.450" in drawn
    assert "copy_history 0.090" in drawn
    assert "gone" not in drawn
    assert seeing_plot(None, answerers) == ""
    assert condition_of("m+grey") == ("m+grey", "")


def test_equal_scores_from_other_components_are_as_much_without_seeing() -> None:
    """IVCS is 0.1 by JOVR alone, and 0.3 · 1/3 by semantics alone, which rounds to less."""
    rows = [
        row("cut_in", "simulation", "m", 0.0, jovr=1.0),
        row("cut_in", "simulation", "m+black", 0.0, sem_acc_eff=1 / 3, control=True),
    ]
    assert rows[0].ivcs > rows[1].ivcs
    (line,) = seeing_table(rows, ["m+black"]).rows
    assert line[-1] == AS_MUCH


def test_cells_without_controls_or_on_different_recordings_say_so() -> None:
    rows = [row("cut_in", "simulation", "a", 0.5), row("cut_in", "simulation", "b", 0.4)]
    assert any("have no controls" in text for text in everywhere(notices(rows)))
    rows.append(row("cut_in", "physical", "b", 0.4))
    found = [notice.text for notice in notices(rows)]
    assert any("(of 2: a 1)" in text for text in found)
    assert any("cut_in / physical / a" in text for text in found)
    rows.append(row("cut_in", "simulation", "a+black", 0.1, control=True))
    told = [notice.text for notice in notices(rows)]
    assert not any("have no controls" in text for text in told)
    assert any("Not asked with black and shuffled frames: a, b." in text for text in told)


def test_many_names_are_counted() -> None:
    assert some(["a", "b"]) == "a, b"
    assert some([str(k) for k in range(MOST_NAMED)]).endswith(f", {MOST_NAMED - 1}")
    assert some([str(k) for k in range(MOST_NAMED + 1)]) == "0, 1, 2, 3, and 5 more"


@pytest.mark.parametrize("scenarios", [MOST_PAIRED, MOST_PAIRED + 1])
def test_ranks_of_many_scenarios_stay_readable(scenarios: int) -> None:
    """Each model leads in every other scenario."""
    rows = [
        row(f"event_{k:02d}", "simulation", model, 0.5 + 0.1 * ((k + j) % 2))
        for k in range(scenarios)
        for j, model in enumerate(("a", "b"))
    ]
    table = next(one for one in all_tables(rows) if one.name == "ranks_model")
    changes = str(table.rows[0][-1])
    pairs = (scenarios // 2) * ((scenarios + 1) // 2)
    if scenarios <= MOST_PAIRED:
        assert changes.count(";") == pairs - 1
    else:
        assert changes.startswith("from 1 in event_0")
        assert changes.endswith(f"2 different ranks in {scenarios} scenarios")


def test_notes_that_all_tables_have_are_told_once() -> None:
    columns = (Column("model", "model", "text"), Column("empty", "empty", "text"))
    one = Table("a", "a", columns, (("m", ""),), ("common", "own"))
    other = Table("b", "b", columns, (("m", ""),), ("other", "common"))
    common, rest = common_notes([grid(one), grid(other)])
    assert common == ("common",)
    assert [table.notes for table in rest] == [("own",), ("other",)]
    # A column of words without any takes only room.
    assert [head.text for head in rest[0].heads] == ["model"]
    assert common_notes([]) == ((), [])
