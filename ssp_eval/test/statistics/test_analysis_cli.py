"""``ssp report`` with tables and statistics: from component scores and from campaigns."""

from __future__ import annotations

import csv
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import BEST_CONSTANT, bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.results import load_cells
from ssp_eval.statistics.csv_rows import rows_from_csv
from ssp_eval.statistics.rows import rows_from_campaign
from ssp_eval.statistics.statistics import Options, compute, steps_of

HEAD = "scenario,domain,model,jovr,sem_acc_eff,cia_eff,act_acc_eff,tqsr,atc_eff,risk,active_b"
LINES = [
    f"{s},{d},{m},1,{0.3 + 0.1 * i + 0.02 * j},0.5,0.5,{0.2 + 0.03 * k},0.4,{r},{b}"
    for i, (s, r) in enumerate((("cut_in", "S@1.50"), ("vru", "F")))
    for j, d in enumerate(("synthetic", "simulation", "physical"))
    for k, (m, b) in enumerate((("a", 3), ("b", 7), ("c", "")))
]
FEW = ["--resamples", "200"]


@pytest.fixture
def cells(tmp_path: Path) -> Path:
    path = tmp_path / "cells.csv"
    path.write_text("\n".join([HEAD, *LINES, ""]), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def campaign(bag_writer: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaign")
    bags = [
        bag_writer(folder / "a"),
        bag_writer(folder / "b", domain="physical", stand_in=True),
        bag_writer(folder / "c", scenario="vru_crossing"),
    ]
    models = [bridge_spec(name) for name in ("constant_velocity", "perfect", "silent")]
    out = folder / "out"
    run_campaign(
        [(bag, None) for bag in bags], models, InProcessClients(), out, CellOptions(), True
    )
    return out


def call(*args: object) -> int:
    return main(["report", *map(str, args)])


def table_names(folder: Path) -> set[str]:
    return {path.name.split(".")[0] for path in folder.iterdir()}


def table(file: Path) -> list[dict[str, Any]]:
    with file.open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))


def test_component_scores_alone_give_all_tables_and_statistics(cells: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert call("--from-cells", cells, "--out", out, "--reference", "b", *FEW) == 0
    names = table_names(out / "tables")
    assert {
        "matrix",
        "by_domain",
        "by_model",
        "by_scenario_domain",
        "by_scenario_model",
        "strata",
        "foundation_models",
        "ranks_model",
        "ranks_domain",
        "comparisons",
        "intervals_over_cells",
        "weights_model_order",
    } <= names
    # Without records there are no intervals over them.
    assert not {"intervals_cells", "intervals_groups", "stability"} & names
    for suffix in (".csv", ".notes.txt", ".tex"):
        assert {path.name.removesuffix(suffix) for path in (out / "tables").glob(f"*{suffix}")} == (
            names
        )
    first = next(one for one in table(out / "tables/matrix.csv") if one["model"] == "a")
    assert float(first["ivcs"]) == pytest.approx(0.1 + 0.3 * 0.3 + 0.2 * 0.5 + 0.3 * 0.2 + 0.1)
    statistics = json.loads((out / "statistics.json").read_text())
    assert statistics["schema"] == "ssp.statistics/2"
    assert statistics["resamples"] == 200
    assert "no safety certificate" in statistics["note"]
    pairs = next(t for t in statistics["tables"] if t["name"] == "comparisons")["data"]
    (tested,) = [p for p in pairs if (p["first"], p["second"], p["metric"]) == ("a", "b", "ivcs")]
    assert tested["n"] == 6
    assert tested["difference"] == pytest.approx(-0.3 * 0.03)
    # All six differences have one sign: 2 of 64 patterns reach it.
    assert tested["p"] == 2 / 64
    assert tested["p_holm"] == 6 / 64


def test_tables_in_csv_are_nothing_but_a_header_and_rows(cells: Path, tmp_path: Path) -> None:
    """Any reader takes them without options; what must be read beside them has its own file."""
    assert call("--from-cells", cells, "--out", tmp_path, *FEW, "--format", "csv") == 0
    files = list((tmp_path / "tables").glob("*.csv"))
    assert len(files) > 12
    for file in files:
        with file.open(encoding="utf-8", newline="") as lines:
            head, *rows = csv.reader(lines)
        assert len(set(head)) == len(head)
        assert {len(row) for row in rows} <= {len(head)}, file.name
        told = file.with_suffix(".notes.txt").read_text("utf-8").split("\n\n")
        assert told[-1] == "IVCS is no safety certificate.\n"
        assert not any(row[0].startswith("#") for row in rows)


def test_domains_stand_beside_each_other_in_relative_terms(cells: Path, tmp_path: Path) -> None:
    """SemAcc of LINES in cut_in, worked out by hand, is 0.3 in synthetic and 0.34 in physical."""
    assert call("--from-cells", cells, "--out", tmp_path, *FEW) == 0
    rows = table(tmp_path / "tables/domain_differences.csv")
    ivcs = [one for one in rows if one["metric"] == "IVCS"]
    assert [(one["domain"], one["reference"]) for one in ivcs[::3]] == [
        ("simulation", "synthetic"),
        ("physical", "synthetic"),
        ("physical", "simulation"),
    ]
    assert [one["scenario"] for one in ivcs[:3]] == ["all", "cut_in", "vru"]
    found = {(one["domain"], one["reference"], one["scenario"], one["metric"]): one for one in rows}
    sem = found["physical", "synthetic", "cut_in", "SemAcc"]
    assert float(sem["difference"]) == pytest.approx(0.04)
    assert float(sem["change"]) == pytest.approx(0.04 / 0.3, abs=1e-15)
    assert sem["finding"] == "one recording each: no interval"
    over_all = found["physical", "synthetic", "all", "SemAcc"]
    assert float(over_all["change"]) == pytest.approx(0.04 / 0.35)
    # Both scenarios have the same difference.
    assert [float(over_all[key]) for key in ("low", "high")] == pytest.approx([0.04, 0.04])
    assert found["physical", "simulation", "vru", "SemAcc"]["n"] == "3"
    # RSR is 0 in every crossing: nothing is relative to it.
    assert found["physical", "simulation", "vru", "RSR"]["change"] == ""
    assert r"+13.3\%" in (tmp_path / "tables/domain_differences.tex").read_text()


def test_the_same_seed_gives_the_same_bytes_whatever_the_order(cells: Path, tmp_path: Path) -> None:
    mixed = tmp_path / "mixed.csv"
    mixed.write_text("\n".join([HEAD, *reversed(LINES), ""]), encoding="utf-8")
    for name, file in (("one", cells), ("two", mixed)):
        assert call("--from-cells", file, "--out", tmp_path / name, *FEW, "--seed", 3) == 0
    assert call("--from-cells", cells, "--out", tmp_path / "other", *FEW, "--seed", 4) == 0
    files = sorted(p.relative_to(tmp_path / "one") for p in (tmp_path / "one").rglob("*.*"))
    assert len(files) > 30
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
    assert (tmp_path / "one/statistics.json").read_bytes() != (
        tmp_path / "other/statistics.json"
    ).read_bytes()


@pytest.mark.parametrize(
    ("args", "status", "told"),
    [
        (("--from-cells", "{cells}"), 2, "--from-cells needs --out DIR"),
        (("{campaign}", "--format", "csv"), 2, "--format needs --tables DIR"),
        (
            ("--from-cells", "{cells}", "--figures", "{out}", "--format", "csv"),
            2,
            "--format needs --tables DIR",
        ),
        (("--from-cells", "{cells}", "--out", "{out}", "--block", "2"), 2, "--block is of labels"),
        (
            ("--from-cells", "{cells}", "--figures", "{out}", "--seed", "2"),
            2,
            "--resamples and --seed need --out DIR",
        ),
        (("{cells}",), 1, "but a file; component scores go with --from-cells"),
        (
            ("--from-cells", "{cells}", "--figures", "{out}", "--expect", "cut_in"),
            2,
            "--expect needs --out",
        ),
        (
            ("--from-cells", "{cells}", "--figures", "{out}", "--tables", "{out}"),
            2,
            "--from-cells needs --out DIR",
        ),
        (("{campaign}", "--from-cells", "{cells}", "--out", "{out}"), 2, "stands alone"),
        ((), 2, "give the folder of a campaign"),
        (("{campaign}", "--out", "{out}"), 2, "--out belongs to --from-cells"),
        (("{campaign}", "--reference", "a"), 2, "need --tables DIR"),
        (("--from-cells", "{cells}", "--out", "{out}", "--format", "csv,pdf"), 2, "is no format"),
        (("--from-cells", "{cells}", "--out", "{out}", "--resamples", "1"), 2, "resamples"),
        (("--from-cells", "{cells}", "--out", "{out}", "--seed", "-1"), 2, "seed"),
        (
            ("--from-cells", "{cells}", "--out", "{out}", "--reference", "z", *FEW),
            1,
            "--reference: is no model with a valid cell (got 'z'); known: a, b, c",
        ),
        (("--from-cells", "{missing}", "--out", "{out}"), 1, "none.csv: can't be read"),
        (("--from-cells", "{cells}", "--out", "{cells}/x", *FEW), 1, "is no folder"),
        (
            ("{campaign}", "--repeat", "{campaign}", "--tables", "{out}"),
            1,
            "is given twice; give each campaign once",
        ),
    ],
)
def test_wrong_options_say_what_is_right_and_write_nothing(
    cells: Path,
    campaign: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    args: tuple[str, ...],
    status: int,
    told: str,
) -> None:
    places = {
        "cells": cells,
        "campaign": campaign,
        "out": tmp_path / "out",
        "missing": tmp_path / "none.csv",
    }
    assert call(*(arg.format(**places) for arg in args)) == status
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_campaign_gives_intervals_over_records_and_the_diagnostic(
    campaign: Path, tmp_path: Path
) -> None:
    assert call(campaign, "--tables", tmp_path, "--format", "csv", *FEW) == 0
    assert (campaign / "index.html").is_file()
    matrix = table(tmp_path / "matrix.csv")
    # With the best blind constant of each recording.
    assert len(matrix) == 12
    cells_of = table(tmp_path / "intervals_cells.csv")
    assert {one["model"] for one in cells_of} == {"constant_velocity"}
    stored = {tuple(p.parent.name.split("__")): p for p in campaign.glob("cells/*/score.json")}
    for one in cells_of:
        path = next(
            p
            for names, p in stored.items()
            if {one["scenario"], one["domain"]} <= set(names) and one["model"] in names
        )
        value = json.loads(path.read_text())[one["metric"]]
        assert one["value"] == "" if value is None else math.isclose(float(one["value"]), value)
        if one["low"]:
            assert float(one["low"]) <= float(one["high"])
    # Every interval says what was drawn.
    assert {one["unit"] for one in cells_of} == {"labels, in blocks of 2"}
    over = table(tmp_path / "intervals_over_cells.csv")
    assert {one["unit"] for one in over} == {"cells", "scenarios"}


def test_the_length_of_a_block_can_be_chosen(campaign: Path, tmp_path: Path) -> None:
    assert call(campaign, "--tables", tmp_path, "--format", "csv", *FEW, "--block", 1) == 0
    assert {one["unit"] for one in table(tmp_path / "intervals_cells.csv")} == {"labels"}
    assert json.loads((tmp_path / "statistics.json").read_text())["block_labels"] == 1
    assert call(campaign, "--tables", tmp_path, "--block", 0) == 2


def test_repeated_campaigns_are_runs_of_the_same_cells(campaign: Path, tmp_path: Path) -> None:
    again = shutil.copytree(campaign, tmp_path / "again")
    args = ("--repeat", again, "--tables", tmp_path / "t", "--format", "csv", *FEW)
    assert call(campaign, *args) == 0
    runs = table(tmp_path / "t/stability.csv")
    assert {one["k"] for one in runs} == {"2"}
    assert {float(one["sd"]) for one in runs} == {0.0}
    matrix = table(tmp_path / "t/matrix.csv")
    assert len(matrix) == 24
    assert {one["run"] for one in matrix} == {"out", "again"}
    # A cell counts once, whatever its runs.
    (model,) = table(tmp_path / "t/by_model.csv")
    assert model["n"] == "3"


def test_the_matrix_of_a_campaign_gives_its_tables_again(campaign: Path, tmp_path: Path) -> None:
    """But for what needs records, and notices of recordings: so figures, which are of the rows."""
    own, again = tmp_path / "own", tmp_path / "again"
    assert call(campaign, "--tables", own, *FEW) == 0
    file = own / "matrix.csv"
    found = {row.key: row for row in rows_from_csv(file) if row.model != BEST_CONSTANT}
    assert found == {row.key: row for row in rows_from_campaign(campaign)}
    assert {row.control for row in found.values()} == {True, False}
    assert call("--from-cells", file, "--out", again, *FEW) == 0
    tables = [path.name for path in (again / "tables").iterdir()]
    needs_records = {
        "intervals_groups",
        "intervals_cells",
        "first_failures",
        "first_failures_model",
        "notices",
        "best_constants",
        "labels",
    }
    assert table_names(own) - needs_records == (
        {*table_names(again / "tables"), "statistics"} - needs_records
    )
    for name in tables:
        if name.split(".")[0] not in needs_records:
            assert unnoticed(own / name) == unnoticed(again / "tables" / name), name
    assert len(tables) > 30


def unnoticed(file: Path) -> Any:
    """A table without its notices: a file of scores doesn't know the recordings behind them."""
    text = file.read_text("utf-8")
    if file.suffix == ".csv":
        return text
    told = {one["text"] for one in table(file.with_name("notices.csv"))}
    if file.suffix == ".txt":
        return [note for note in text.strip().split("\n\n") if note not in told]
    return text.split(r"\end{tabular}")[0]


def test_what_a_file_has_besides_is_told(
    cells: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = cells.read_text("utf-8").splitlines()
    file = tmp_path / "more.csv"
    file.write_text("\n".join([f"{lines[0]},Venue", *(f"{x},ICRA" for x in lines[1:])]), "utf-8")
    assert call("--from-cells", file, "--out", tmp_path / "out", *FEW) == 0
    assert "columns that are ignored: Venue" in " ".join(capsys.readouterr().err.split())


def test_progress_is_told_as_often_as_announced(campaign: Path) -> None:
    rows, data = rows_from_campaign(campaign), load_cells(campaign)
    steps: list[int] = []
    compute(rows, data, Options(100, 1), lambda: steps.append(1))
    assert len(steps) == steps_of(rows, True)
    steps.clear()
    compute(rows, (), Options(100, 1), lambda: steps.append(1))
    assert len(steps) == steps_of(rows, False)


def test_the_page_has_its_statistics_and_no_control_in_them(campaign: Path) -> None:
    assert call(campaign, *FEW) == 0
    page = (campaign / "index.html").read_text("utf-8")
    section = page.split('<section id="statistics">')[1].split("</section>")[0]
    for title in ("Intervals",):
        assert f"<h3>{title}</h3>" in section
    assert "constant_velocity" in section
    assert "perfect" not in section
    assert "silent" not in section
    assert section.count("IVCS is no safety certificate.") == section.count("<details")
