"""An ablation as a campaign: control first, rows that go on after a kill, tables and figure."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from ssp_core.cli import main
from ssp_eval.ablation import campaign
from ssp_eval.ablation.campaign import COLUMNS, Job, Realisation, read_realisation
from ssp_eval.ablation.figure import arms_figure
from ssp_eval.ablation.ground import SOURCE_PLACE
from ssp_eval.ablation.tables import arms_table, fields_table, findings, pairs_of, places_table
from ssp_eval.data.audit import FIELDS
from ssp_eval.figures.style import drawing
from ssp_eval.statistics.table import by_column

Row = list[str]
ARGS = ["ablate", "cut_in", "--sites", "boulevard", "--sites", "south_loop", "--realisations", "4"]


def row(place: str, arm: str, seed: int, *, kpr: float = 1.0, compiled: bool = True) -> Row:
    head = [place, arm, str(seed), "0.01"]
    if not compiled:
        return [*head, "", "false", *[""] * (len(COLUMNS) - 7), "no lane fits"]
    kept = ["true"] * round(5 * kpr) + ["false"] * (5 - round(5 * kpr))
    good = str(kpr == 1.0).lower()
    why = "" if kpr == 1.0 else "motion differs"
    told = ["true", "valid", "true", "false", *kept, "true", f"{kpr:g}", "0.05", "1.2", good, why]
    return [*head, "main", *told]


def played(kpr: Callable[[Job], float], seen: list[Job]) -> Callable[[Job], list[Row]]:
    """Return what stands in for the sessions of a job: rows with a KPR of its own."""

    def rows_of(job: Job) -> list[Row]:
        seen.append(job)
        place = SOURCE_PLACE if job.place is None else str(job.place[0])
        return [row(place, job.arm, seed, kpr=kpr(job)) for seed in job.seeds]

    return rows_of


def tables_in(out: Path) -> set[str]:
    return {path.name for path in out.glob("*.csv")}


def test_no_table_is_printed_where_an_arm_loses_the_event_at_the_source_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[Job] = []
    lost = played(lambda job: 0.8 if job.arm == "tracks" else 1.0, seen)
    monkeypatch.setattr(campaign, "rows_of", lost)
    out = tmp_path / "out"
    assert main([*ARGS, "--out", str(out)]) == 1
    told = capsys.readouterr()
    assert told.out == ""
    assert "KPR 0.9 or more, and be admitted; tracks has KPR 0.80 (motion differs)" in told.err
    assert [job.place for job in seen] == [None] * 3
    assert tables_in(out) == {"realisations.csv"}
    # Nor is it when the same command is given again.
    assert main([*ARGS, "--out", str(out)]) == 1
    assert len(seen) == 3


@pytest.mark.parametrize(
    ("changes", "shown"),
    [
        ({"verdict": "failed_safety", "why": "collision: ot2"}, "verdict failed_safety (collision"),
        ({"verdict": "aborted"}, "verdict aborted"),
        ({"located": "false", "why": "no resolution"}, "a phase that isn't located (no resolution"),
        ({"admitted": "false", "why": "ot1 stands"}, "an event that isn't admitted (ot1 stands"),
    ],
)
def test_an_arm_whose_control_is_unsound_or_not_admitted_cannot_play_the_event(
    changes: dict[str, str], shown: str
) -> None:
    arms = ("structure", "relations", "tracks")
    rows = [row(SOURCE_PLACE, arm, 1) for arm in arms]
    campaign.check_control([read_realisation(one) for one in rows])
    for name, value in changes.items():
        rows[1][COLUMNS.index(name)] = value
    with pytest.raises(campaign.ControlFailed, match=re.escape(f"relations has {shown}")):
        campaign.check_control([read_realisation(one) for one in rows])


def test_an_ablation_goes_on_where_it_stopped_to_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[Job] = []
    monkeypatch.setattr(campaign, "rows_of", played(lambda _job: 1.0, seen))
    out = tmp_path / "out"
    assert main([*ARGS, "--out", str(out), "--json"]) == 0
    tables = json.loads(capsys.readouterr().out)
    assert [one["arm"] for one in tables["arms"]["data"]] == list(campaign.ARMS)
    whole = {path.name: path.read_bytes() for path in out.iterdir()}
    assert {"arms.csv", "pairs.csv", "places.csv", "fields.csv", "arms.svg"} <= set(whole)
    # Drawn in the house's style, in which text stays text.
    assert b">participant roles</text>" in whole["arms.svg"]
    assert [(job.arm, job.seeds) for job in seen[3:]] == [
        (arm, (1, 2)) for _ in range(2) for arm in campaign.ARMS
    ]
    file = out / "realisations.csv"
    lines = file.read_text().splitlines(keepends=True)
    assert len(lines) == 1 + 3 + 12
    # Three of control, two of the first job, one of the second, and half a line.
    file.write_text("".join(lines[:7]) + lines[7][:9])
    seen.clear()
    assert main([*ARGS, "--out", str(out), "--json"]) == 0
    assert [job.arm for job in seen] == ["relations", "tracks", *campaign.ARMS]
    assert {path.name: path.read_bytes() for path in out.iterdir()} == whole


@pytest.mark.parametrize(
    ("args", "what"),
    [
        (["--seed", "9"], "seed differ"),
        (["--maps", "boulevard"], "stands twice: boulevard"),
        (["--source", "nowhere"], "nowhere"),
    ],
)
def test_the_folder_of_another_ablation_or_a_place_named_twice_is_refused(
    args: Sequence[str],
    what: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(campaign, "rows_of", played(lambda _job: 1.0, []))
    out = str(tmp_path / "out")
    assert main([*ARGS, "--out", out]) == 0
    more = ["--sites", "boulevard"] if args[0] == "--maps" else list(args)
    assert main([*ARGS, *more, "--out", out]) == 1
    assert what in capsys.readouterr().err


def test_the_order_of_places_is_part_of_an_ablation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(campaign, "rows_of", played(lambda _job: 1.0, []))
    out = tmp_path / "out"
    assert main([*ARGS, "--out", str(out)]) == 0
    turned = ["ablate", "cut_in", "--sites", "south_loop", "--sites", "boulevard"]
    assert main([*turned, "--realisations", "4", "--out", str(out)]) == 1
    assert "is of another ablation: places differ" in capsys.readouterr().err
    file = out / "realisations.csv"
    file.write_text(file.read_text().replace("boulevard,structure,1", "south_loop,structure,1"))
    assert main([*ARGS, "--out", str(out)]) == 1
    assert "realisations.csv:5: holds another ablation's" in capsys.readouterr().err


@pytest.mark.parametrize(("column", "value"), [("kpr", "high"), ("epd", "nan"), ("valid", "yes")])
def test_a_realisation_that_was_changed_is_refused_with_line_column_and_value(
    column: str,
    value: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(campaign, "rows_of", played(lambda _job: 1.0, []))
    out = tmp_path / "out"
    assert main([*ARGS, "--out", str(out)]) == 0
    file = out / "realisations.csv"
    rows = [line.split(",") for line in file.read_text().splitlines()]
    rows[3][COLUMNS.index(column)] = value
    file.write_text("".join(f"{','.join(row)}\n" for row in rows))
    assert main([*ARGS, "--out", str(out)]) == 1
    assert f"realisations.csv:4: {column}: is not what an ablation writes (got '{value}')" in (
        capsys.readouterr().err
    )


def test_a_source_that_cannot_be_read_leaves_no_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main([*ARGS, "--source", str(tmp_path / "nowhere"), "--out", str(out)]) == 1
    assert not out.exists()


def test_an_event_of_a_junction_is_refused_with_those_that_may_be_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    args = ["ablate", "crossing_car", "--sites", "crossroads", "--out", str(tmp_path / "out")]
    assert main(args) == 1
    told = capsys.readouterr().err
    assert "takes place at a junction" in told
    assert "cut_in" in told


def test_a_folder_with_something_else_and_no_place_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    assert main([*ARGS, "--out", str(tmp_path)]) == 1
    assert "holds something else than an ablation" in capsys.readouterr().err
    assert main(["ablate", "cut_in", "--out", str(tmp_path / "new")]) == 2


def realisations() -> list[Realisation]:
    """Return ten realisations per arm on two places: tracks fails in 6, relations has none on b."""
    rows = []
    for place in ("a", "b"):
        for seed in range(1, 6):
            rows.append(row(place, "structure", seed))
            rows.append(row(place, "relations", seed, compiled=place == "a"))
            rows.append(row(place, "tracks", seed, kpr=0.8 if seed > 2 else 1.0))
    return [read_realisation(one) for one in rows]


def test_the_table_has_shares_of_all_realisations_with_wilsons_interval() -> None:
    arms = {one["arm"]: one for one in by_column(arms_table(realisations()))}
    assert {arm: one["n"] for arm, one in arms.items()} == dict.fromkeys(campaign.ARMS, 10)
    assert [arms[arm]["compiled"] for arm in campaign.ARMS] == [1.0, 0.5, 1.0]
    assert [arms[arm]["admitted"] for arm in campaign.ARMS] == [1.0, 0.5, 0.4]
    # Wilson's interval of 4 of 10.
    assert arms["tracks"]["admitted_low"] == pytest.approx(0.1682, abs=1e-4)
    assert arms["tracks"]["admitted_high"] == pytest.approx(0.6873, abs=1e-4)
    assert arms["tracks"]["kpr"] == pytest.approx(0.88)
    assert (arms["relations"]["kpr"], arms["relations"]["kpr_n"]) == (1.0, 5)


def test_pairs_are_tested_on_the_same_realisations_and_on_places() -> None:
    found = {(one.first, one.second, one.measure): one for one in pairs_of(realisations())}
    admitted = found["structure", "tracks", "admitted"]
    assert admitted.test is not None
    assert (admitted.test.more, admitted.test.fewer) == (6, 0)
    assert admitted.test.p == pytest.approx(2 / 2**6)
    assert admitted.difference == pytest.approx(0.6)
    # Newcombe's interval of 1.0 less 0.4 of ten pairs.
    assert admitted.interval.low is not None
    assert 0.2 < admitted.interval.low < 0.6 < (admitted.interval.high or 0.0)
    assert admitted.by_place.p == pytest.approx(0.5)
    kpr = found["structure", "relations", "kpr"]
    assert kpr.test is not None
    assert (kpr.n, kpr.test.p) == (5, 1.0)
    # An arm makes a run for a place once: its realisations there say nothing of each other.
    compiled = found["relations", "tracks", "compiled"]
    assert compiled.test is None
    assert (compiled.difference, compiled.by_place.fewer, compiled.by_place.p) == (-0.5, 1, 1.0)
    lost = found["structure", "tracks", "lost"]
    assert lost.test is not None
    assert (lost.n, lost.test.fewer) == (10, 6)
    # A field is asked of runs alone, and so on the place on which both arms made one.
    field = found["structure", "relations", "topology"]
    assert (field.n, field.difference) == (5, 0.0)


def test_findings_count_places_and_claim_nothing_that_so_few_cannot_show() -> None:
    told = findings(realisations())
    assert told[0] == "structure less relations: nothing differs on more than one place"
    assert told[1] == "  on a single place: compiled +0.50, valid +0.50, admitted +0.50"
    assert told[2].startswith("structure less tracks: admitted +0.60 on 2 place(s), p 1; event")
    assert told[-1].endswith("before it none can be under 0.5 on so few places")


def test_fields_are_shares_of_the_runs_that_an_arm_made() -> None:
    arms = {one["arm"]: one for one in by_column(fields_table(realisations()))}
    assert (arms["relations"]["n"], arms["relations"]["passing_order"]) == (5, 1.0)
    assert (arms["tracks"]["n"], arms["tracks"]["passing_order"]) == (10, 0.4)
    refused = [read_realisation(row("a", arm, 1, compiled=False)) for arm in campaign.ARMS]
    none = by_column(fields_table(refused))
    assert [one["topology"] for one in none] == [None] * 3


def test_a_refusal_is_told_with_its_place() -> None:
    rows = {(one["place"], one["arm"]): one for one in by_column(places_table(realisations()))}
    assert rows["b", "relations"]["why"] == "no lane fits"
    assert rows["b", "relations"]["compiled"] == 0
    assert rows["a", "tracks"]["admitted"] == 2


def test_the_figure_has_a_mark_for_each_arm_and_part_of_the_event(tmp_path: Path) -> None:
    with drawing():
        made = arms_figure("cut_in", realisations())
    file = tmp_path / "arms.svg"
    made.figure.savefig(file)
    text = file.read_text()
    for arm in campaign.ARMS:
        for field in (*FIELDS, "compiled", "located", "valid", "admitted", "lost"):
            assert f'id="{field}-{arm}"' in text
    assert "on 2 places. Above the line: shares of 10 realisations" in made.caption


def test_a_row_is_read_as_it_was_written(tmp_path: Path) -> None:
    file = tmp_path / "rows.csv"
    with file.open("w", newline="") as stream:
        csv.writer(stream).writerow(row("a", "tracks", 3, kpr=0.8))
    with file.open(newline="") as stream:
        one = read_realisation(next(csv.reader(stream)))
    assert one.judgement is not None
    assert one.judgement.kpr == 0.8
    assert [name for name in FIELDS if not one.judgement.retention[name]] == ["passing_order"]
    assert not one.judgement.admitted
