"""The report of a campaign of driven runs: statistics of METHOD 8.7, tables and page."""

from __future__ import annotations

import csv
import io
import itertools
import json
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_json
from ssp_core.run_file.latency import Latency
from ssp_eval.closed_loop import prediction
from ssp_eval.closed_loop.figures import NEEDLESS, chains_of, counts_of, outcome_plot
from ssp_eval.closed_loop.folder import LoopCampaign, Run, load_loop
from ssp_eval.closed_loop.page import (
    again,
    bag_of,
    card_rows,
    failed_of,
    notices_of,
    planned_of,
    render,
    tables_of,
)
from ssp_eval.closed_loop.prediction import (
    predict,
    scores_by_driver,
)
from ssp_eval.closed_loop.tables import (
    headline_table,
    other_starts_table,
    pair_table,
    severity_table,
    unlike_pair_table,
)
from ssp_eval.closed_loop.words import words_tables
from ssp_eval.report.cli import report
from ssp_eval.statistics.rows import CellRow
from ssp_eval.statistics.table import texts
from ssp_scenario_manager.closed_loop.campaigns.cards import CARDS_SCHEMA
from ssp_scenario_manager.closed_loop.campaigns.plan_file import BASELINES
from ssp_scenario_manager.closed_loop.campaigns.row_bags import bag_folder
from ssp_scenario_manager.closed_loop.campaigns.seal import STARTS_SCHEMA, Draw
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS
from tests.support.loop_runs import LATENCIES, MINE, made_run
from tests.support.runs import START_FACTS, cut_in_run


def test_a_card_has_a_dash_where_nothing_is_asked() -> None:
    latency = {"given": "zero", "p50_s": None, "p99_s": None, "contains": "a constant"}
    unknown = {"given": "measured:2", "p50_s": None, "answers": None, "contains": "encoding"}
    asked_nothing = {**unknown, "answers": 0}
    rows = card_rows({"latencies": [latency, unknown, asked_nothing]})
    assert [words for _, words in rows] == [
        "–, nothing was asked",
        "measured, not known until all runs are done; encoding",
        "–, nothing was asked",
    ]


def card(driver: str, **changes: Any) -> dict[str, Any]:
    made = {
        "driver": driver,
        "kind": driver,
        "options": {},
        "privileged": driver in ("aeb", "oracle", "careful", "built_in"),
        "cameras": [],
        "route_m": 80.0,
        "history_s": 1.7,
        "starts": 4,
        "repeats": 1,
        "seed": 1,
        "versions": {},
        "step_s": 0.02,
        "frame_period_s": 0.1,
        "latencies": [
            {"given": "zero", "p50_s": 0.0, "p99_s": 0.0, "contains": "a constant"},
            {"given": "fixed:0.5", "p50_s": 0.5, "p99_s": 0.5, "contains": "a constant"},
        ],
        "timeout_s": None,
        "tracker": None if driver == "careful" else "tracker",
        "d_max_mps2": 7.0,
        "limits": {"outcome": {}, "plan": {}},
        "hardware": {"cores": 2},
        **changes,
    }
    hashed = {k: v for k, v in made.items() if k != "hardware"}
    return {**made, "hash": sha256_json(hashed)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A campaign of four starts, as `ssp loop` leaves it, without a run of a simulation."""
    place = tmp_path / "a campaign"
    place.mkdir()
    plan = {
        "schema": "ssp.loop/1",
        "events": ["cut_in"],
        "latencies": ["zero", "fixed:0.5"],
        "starts": 4,
        "others": 0,
        "drivers": [{"driver": "aeb", "label": MINE}],
    }
    (place / "plan.json").write_text(json.dumps({"version": "0.1", "sources": {}, "plan": plan}))
    starts = [
        {
            **START_FACTS,
            "event": "cut_in",
            "kind": "critical",
            "seed": k,
            "hash": f"s{k}",
            "run": cut_in_run(),
        }
        for k in range(4)
    ]
    drawn = asdict(Draw("cut_in", 0, 4, 2, 1, 1, 0, ["traffic"]))
    kept = {"starts": starts, "drawn": [drawn]}
    sealed = {**kept, "schema": STARTS_SCHEMA, "hash": sha256_json(kept)}
    (place / "starts.json").write_text(json.dumps(sealed))
    cards = [card(name) for name in (*BASELINES, MINE)]
    (place / "cards.json").write_text(json.dumps({"schema": CARDS_SCHEMA, "cards": cards}))
    each = itertools.product(range(4), (*BASELINES, MINE), LATENCIES)
    rows = [_row(k, driver, latency).cells for k, driver, latency in each]
    stream = io.StringIO()
    writer = csv.DictWriter(stream, RUN_COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    (place / "runs.csv").write_text(stream.getvalue())
    return place


def _row(k: int, driver: str, latency: Latency) -> Run:
    failing = driver in ("no_response", "constant_velocity") or (driver == MINE and latency.seconds)
    outcome = "collision" if failing and (driver != MINE or k < 3) else "avoided"
    if driver in ("stop_at_once", "always_brake"):
        outcome = "evaded"
    is_needless = driver == MINE and k == 0 and not latency.seconds
    needless = "brakes <hard> by 3.0 m/s^2" if is_needless else ""
    return made_run(
        start=f"s{k}",
        driver=driver,
        latency=latency,
        outcome=outcome,
        needless=needless,
        seed=str(k),
        why="with ot1, front to rear" if outcome == "collision" else "",
        observable_s="10.0",
        frame_s="10.1",
        asked_s="10.3",
        answered_s=str(10.3 + latency.seconds),
        effective_s=str(10.3 + latency.seconds),
        response_s="" if outcome == "collision" else str(11.0 + latency.seconds),
        v_i_mps="7.0" if outcome == "collision" else "",
        severity="5.0" if outcome == "avoided" else "",
        distance_m="2.0",
    )


@pytest.fixture
def campaign(folder: Path) -> LoopCampaign:
    return load_loop(folder)


def test_the_headline_of_each_latency_stands_with_wilsons_interval(campaign: LoopCampaign) -> None:
    (plain, prescribed) = campaign.groups.values()
    table = headline_table(campaign, "cut_in", plain)
    shown = {row[0]: row[2:] for row in (texts(table, row) for row in table.rows)}
    # 3 of 4, since one is needless; 1 of 4 at 0.5 s.
    assert shown[MINE] == ["0.75 [0.30, 0.95]", "0.25 [0.05, 0.70]"]
    assert prescribed == ["careful"]
    assert "careful" not in shown


def test_unlike_cards_never_share_a_column(folder: Path) -> None:
    cards = [
        card(name, **({"route_m": None} if name == MINE else {})) for name in (*BASELINES, MINE)
    ]
    (folder / "cards.json").write_text(json.dumps({"schema": CARDS_SCHEMA, "cards": cards}))
    groups = list(load_loop(folder).groups.values())
    assert [MINE] in groups
    page = render(load_loop(folder))
    assert "Pairs under unlike conditions, for these events: cut in" in page
    table = unlike_pair_table(load_loop(folder), [MINE], ["constant_velocity"])
    assert [row[:6] for row in table.rows] == [
        (MINE, "constant_velocity", "0", 4, 3, 0),
        (MINE, "constant_velocity", "0.5", 4, 1, 0),
    ]
    assert "cards of the two differ" in table.notes[0]
    assert all(len(one) == 1 or MINE not in one for one in groups)


def test_a_group_keeps_its_number_while_drivers_of_others_have_no_runs(folder: Path) -> None:
    """``table.csv`` numbers the groups of all cards."""
    cards = [
        card(name, **({"route_m": None} if name == MINE else {})) for name in (*BASELINES, MINE)
    ]
    (folder / "cards.json").write_text(json.dumps({"schema": CARDS_SCHEMA, "cards": cards}))
    campaign = load_loop(folder)
    begun = replace(campaign, runs=tuple(r for r in campaign.runs if r.row.driver != MINE))
    assert set(campaign.groups) == {1, 2, 3}
    assert campaign.groups[1] == [MINE]
    assert begun.groups == {k: campaign.groups[k] for k in (2, 3)}
    assert {table.name.rpartition("_")[2] for table in tables_of(begun)} == {"2", "3"}
    assert "Group 3: prescribed motion" in render(begun)


def test_starts_that_are_not_critical_are_reported_apart(folder: Path) -> None:
    rows = (folder / "runs.csv").read_text()
    campaign = load_loop(folder)
    assert other_starts_table(campaign, campaign.drivers).rows == ()
    assert "Other starts" not in render(campaign)
    (folder / "runs.csv").write_text(re.sub(",s3,critical,", ",s3,harmless,", rows))
    campaign = load_loop(folder)
    (plain, _) = campaign.groups.values()
    table = other_starts_table(campaign, plain)
    assert "careful" not in [row[2] for row in table.rows]
    names = [column.key for column in table.columns]
    found = {row[2:4]: dict(zip(names, row, strict=True)) for row in table.rows}
    mine = found[MINE, "0.5"]
    assert (mine["event"], mine["kind"], mine["planned"]) == ("cut_in", "harmless", 1)
    assert (mine["avoided"], mine["collision"], mine["needless"]) == (1, 0, 0)
    assert found["always_brake", "0"]["evaded"] == 1
    assert "Other starts" in render(campaign)
    assert "other_starts_1" in [table.name for table in tables_of(campaign)]


def test_the_page_has_the_shares_of_drawn_starts_and_what_is_left_out(
    campaign: LoopCampaign,
) -> None:
    assert (
        "Starts: 4 critical (50 %), 2 harmless (25 %), 1 unavoidable (12 %), 1 off_spec (12 %), "
        "0 short_run_up (0 %), of 8 drawn by seed from 0 on; without traffic, which no driven "
        "session has."
    ) in render(campaign)


def test_pairs_say_of_which_events_they_are(campaign: LoopCampaign) -> None:
    table = pair_table(campaign, campaign.groups[1])
    assert table.title.endswith("for these events: cut_in")
    found = {tuple(row[:3]): row[3:6] for row in table.rows}
    assert found["constant_velocity", MINE, "0"] == (4, 0, 3)
    beside = pair_table(campaign, campaign.groups[1], [MINE])
    assert {row[1] for row in beside.rows} == {MINE}
    assert len(beside.rows) == 2 * 7


def test_a_measure_without_a_bound_is_shown_by_its_median(campaign: LoopCampaign) -> None:
    runs = [
        replace(one, cells={**one.cells, "ttc_s": "900" if one.cells["seed"] == "0" else "2.5"})
        for one in campaign.runs
    ]
    table = severity_table(replace(campaign, runs=tuple(runs)), "cut_in", [MINE])
    shown = [texts(table, row) for row in table.rows]
    place = [column.key for column in table.columns].index("ttc_s")
    assert [row[place] for row in shown] == ["2.50 (4)", "2.50 (4)"]
    # Of a mean the number of runs that have one stands behind it: at 0.5 s 3 of 4 collide.
    assert shown[1][2] == "7.00 (3)"


def test_an_avoided_run_that_is_needless_is_no_success_of_the_figure(
    campaign: LoopCampaign,
) -> None:
    runs = [one for one in campaign.critical if one.row.driver == MINE]
    counts = counts_of([one for one in runs if one.row.latency == LATENCIES[0]])
    assert (counts["avoided"], counts[NEEDLESS]) == (3, 1)
    rates = [one for one in campaign.rates if one.driver == MINE]
    drawn = outcome_plot(MINE, runs, rates)
    heights = {
        kind: float(height)
        for height, kind in re.findall(r'height="([\d.]+)" class="([a-z-]+)"', drawn)
    }
    assert heights["needless"] == pytest.approx(114 / 4)
    assert heights["collision"] == pytest.approx(3 * 114 / 4)


def test_the_chain_shows_where_the_time_was_lost(campaign: LoopCampaign) -> None:
    found = {(one.driver, one.latency): one for one in chains_of(campaign, "cut_in")}
    slow = found[MINE, LATENCIES[1]]
    assert (slow.wait_s, slow.answer_s) == (pytest.approx(0.1), pytest.approx(0.5))
    assert slow.open_s == pytest.approx(0.2)
    assert slow.response_s == pytest.approx(0.7)
    assert (slow.responded, slow.runs) == (1, 4)


def test_each_failed_run_has_the_command_that_drives_it_again(campaign: LoopCampaign) -> None:
    failed = dict(failed_of(campaign))
    assert next(iter(failed)) == MINE
    assert len(failed[MINE]) == 4
    assert "stop_at_once" not in failed
    first = failed[MINE][0]
    assert campaign.runs[first.number - 1] == first
    assert bag_of(campaign, first) == ""
    (bag_folder(campaign.folder, first.number) / "bag").mkdir(parents=True)
    # One that is being written, or was cut off.
    assert bag_of(campaign, first) == ""
    (bag_folder(campaign.folder, first.number) / "result.json").write_text("{}")
    assert bag_of(campaign, first) == f"bags/{first.number:06d}/bag"
    assert f"<code>bags/{first.number:06d}/bag</code>" in render(campaign)
    assert again(campaign, first) == f"ssp loop '{campaign.folder}' --again {first.number}"
    assert "a prescribed motion, in no session" not in render(campaign)


def test_a_prescribed_motion_has_no_command_that_drives_it_again(folder: Path) -> None:
    rows = (folder / "runs.csv").read_text()
    hit = re.sub(r"(,careful,zero,0),avoided", r"\1,collision", rows, count=1)
    (folder / "runs.csv").write_text(hit)
    campaign = load_loop(folder)
    ((failed,),) = [runs for name, runs in failed_of(campaign) if name == "careful"]
    assert again(campaign, failed) == ""
    assert render(campaign).count("a prescribed motion, in no session") == 1


def test_a_campaign_that_is_refused_or_unfinished_says_so(campaign: LoopCampaign) -> None:
    assert planned_of(campaign) == len(campaign.runs)
    cheats = tuple(
        replace(one, row=replace(one.row, outcome="avoided"))
        if one.row.driver == "stop_at_once"
        else one
        for one in campaign.runs
    )
    told = [text for text, strong in notices_of(replace(campaign, runs=cheats[:-1])) if strong]
    assert any("stop_at_once has a headline of 1.00" in text for text in told)
    assert any(text.startswith("Only 71 of 72 runs are done") for text in told)


def test_a_baseline_that_is_not_as_its_twin_is_named(campaign: LoopCampaign) -> None:
    """METHOD 8.10 bounds what plans may change of the speed of contact, 7 m/s here."""

    def named(v_r_mps: str) -> list[str]:
        runs = [replace(run, cells={**run.cells, "v_r_mps": v_r_mps}) for run in campaign.runs]
        told = notices_of(replace(campaign, runs=tuple(runs)))
        return [text for text, strong in told if strong and "no_response" in text]

    assert named("7.04") == []
    assert named("7.12") == [
        "Differs from no_response: constant_velocity on cut_in: v_i differs from v_r by up to "
        "0.12 m/s, by more than 0.05 m/s in 8 of 8 runs."
    ]


def test_a_vut_that_was_off_its_twin_before_the_event_could_be_answered_is_named(
    campaign: LoopCampaign,
) -> None:
    """The VUT drives a little slower than its twin all the time, which is no outcome."""

    def named(runs: tuple[Run, ...]) -> list[str]:
        return [text for text, _ in notices_of(replace(campaign, runs=runs)) if "twin" in text]

    assert named(campaign.runs) == []
    slow = [run for run in campaign.critical if run.row.driver == MINE and run.row.succeeds]
    early = tuple(
        replace(run, cells={**run.cells, "response_s": "10.02"}) if run == slow[0] else run
        for run in campaign.runs
    )
    (text,) = named(early)
    assert text.startswith(f"{MINE} on cut_in at L = 0 s: in 1 of 3 successes the VUT was off")


def test_a_campaign_that_goes_on_is_reported_as_far_as_it_got(folder: Path) -> None:
    text = (folder / "runs.csv").read_text()
    (folder / "runs.csv").write_text(text[: len(text) // 2])
    campaign = load_loop(folder)
    assert 0 < len(campaign.runs) < 72
    assert "Only " in render(campaign)


# -- words, scores and deeds -----------------------------------------------------------------------


def write_texts(folder: Path, *answers: dict[str, Any]) -> None:
    place = folder / "texts"
    place.mkdir()
    (place / "000008.jsonl").write_text("".join(json.dumps(one) + "\n" for one in answers))


def mine_at(campaign: LoopCampaign, latency: Latency) -> list[int]:
    return [
        run.number for run in campaign.runs if (run.row.driver, run.row.latency) == (MINE, latency)
    ]


BRAKES, KEEPS = "I will slow down for the car ahead.", "I will maintain my current speed."


def test_words_are_held_against_the_plan_of_the_same_answer(
    folder: Path, campaign: LoopCampaign
) -> None:
    one, other, third, fourth = mine_at(campaign, LATENCIES[1])
    write_texts(
        folder,
        {"row": one, "stamp_s": 10.1, "text": BRAKES, "speed_mps": 10.0, "slows_mps": 0.49},
        {"row": one, "stamp_s": 10.2, "text": BRAKES, "speed_mps": 10.0, "slows_mps": 3.0},
        {"row": other, "stamp_s": 10.1, "text": KEEPS, "speed_mps": 10.0, "slows_mps": 0.5},
        {"row": third, "stamp_s": 10.1, "text": BRAKES, "speed_mps": 10.0, "slows_mps": 0.5},
        # It stands, and can't slow; and a text that states no action says nothing.
        {"row": fourth, "stamp_s": 10.1, "text": BRAKES, "speed_mps": 0.4, "slows_mps": 0.4},
        {"row": fourth, "stamp_s": 10.2, "text": "A car.", "speed_mps": 9.0, "slows_mps": 3.0},
    )
    (table,) = words_tables(campaign)
    assert table.rows == ((MINE, "0.5", 3, pytest.approx(1 / 3), pytest.approx(1 / 3)),)


def test_without_texts_there_is_no_table_of_words(campaign: LoopCampaign) -> None:
    assert words_tables(campaign) == []


def test_words_of_drivers_with_unlike_cards_stand_in_tables_of_their_own(folder: Path) -> None:
    cards = [
        card(name, **({"route_m": None} if name == MINE else {})) for name in (*BASELINES, MINE)
    ]
    (folder / "cards.json").write_text(json.dumps({"schema": CARDS_SCHEMA, "cards": cards}))
    campaign = load_loop(folder)
    groups = campaign.groups.values()
    rows = {run.row.driver: run.number for run in campaign.runs}
    kept = {"stamp_s": 10.1, "text": BRAKES, "speed_mps": 10.0, "slows_mps": 3.0}
    write_texts(folder, {"row": rows[MINE], **kept}, {"row": rows["aeb"], **kept})
    found = {table.name: [row[0] for row in table.rows] for table in words_tables(campaign)}
    place = {name: k for k, group in enumerate(groups, 1) for name in group}
    assert found == {f"words_{place[MINE]}": [MINE], f"words_{place['aeb']}": ["aeb"]}


def test_an_answers_file_that_is_none_is_refused_by_file_and_line(
    folder: Path, campaign: LoopCampaign
) -> None:
    write_texts(folder, {"row": 1, "text": BRAKES})
    with pytest.raises(InputError, match=r"000008\.jsonl.*1.*speed_mps"):
        words_tables(campaign)


def test_baselines_controls_and_other_domains_predict_nothing(
    campaign: LoopCampaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [
        score_row(MINE, 0.5),
        replace(score_row(MINE, 1.0), seed=2),
        score_row("aeb", 1.0),
        replace(score_row(MINE, 0.0), domain="physical"),
        replace(score_row(MINE, 0.0), control=True),
        replace(score_row(MINE, 0.0), scenario="vru_crossing"),
    ]
    scores = scores_by_driver(rows, "ivcs", ["cut_in"])
    assert scores == {("cut_in", MINE): pytest.approx(0.75), ("cut_in", "aeb"): 1.0}
    # A baseline is one under whatever label.
    assert predict(campaign, scores, "ivcs") == []
    monkeypatch.setattr(prediction, "BASELINES", frozenset())
    found = predict(campaign, scores, "ivcs")
    assert [(one.latency, one.n, one.rho) for one in found] == [(one, 2, None) for one in LATENCIES]
    starved = replace(campaign, runs=tuple(one_starved(run) for run in campaign.runs))
    assert [one.n for one in predict(starved, scores, "ivcs")] == [1, 1]


def one_starved(run: Run) -> Run:
    return replace(run, row=replace(run.row, starved=run.row.driver == MINE))


def score_row(model: str, value: float) -> CellRow:
    names = ("jovr", "sem_acc_eff", "cia_eff", "tqsr", "rsr")
    return CellRow(
        scenario="cut_in", domain="simulation", model=model, **dict.fromkeys(names, value)
    )


def test_the_page_holds_all_that_it_shows_and_no_markup_of_a_reason(campaign: LoopCampaign) -> None:
    page = render(campaign)
    assert "brakes &lt;hard&gt; by 3.0 m/s^2" in page
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    for part in ("headline", "chain", "severity", "pairs", "failed", "cards"):
        assert f'<section id="{part}">' in page
    assert page.count('<svg class="outcomes"') == len(BASELINES) + 1


def test_the_command_makes_the_page_of_either_kind_of_campaign(
    folder: Path, tmp_path: Path
) -> None:
    tables = tmp_path / "tables"
    said = CliRunner().invoke(report, [str(folder), "--tables", str(tables)])
    assert said.exception is None, said.output
    assert (folder / "index.html").is_file()
    assert (tables / "pairs_1.csv").read_text().startswith("first,second,latency,starts,")
    said = CliRunner().invoke(report, [str(folder), "--figures", str(tmp_path / "f")])
    assert said.exit_code == 2


@pytest.mark.parametrize(
    ("file", "old", "new", "why"),
    [
        ("starts.json", '"seed": 1', '"seed": 7', "was changed after it was sealed"),
        ("cards.json", '"d_max_mps2": 7.0', '"d_max_mps2": 9.0', "was changed after it was"),
        ("runs.csv", "outcome,", "result,", "has other columns"),
        ("runs.csv", ",fixed:0.5,", ",fast,", "is no row of a campaign"),
        ("runs.csv", ",critical,", ",severe,", "kind: is not a known word"),
        ("starts.json", '"hand_over_s": 8.0', '"hand_over_s": NaN', "NaN is no number"),
        ("starts.json", '"hand_over_s"', '"handover_s"', "did you mean hand_over_s"),
        ("starts.json", '"event"', '"events"', "did you mean event"),
        ("cards.json", '"given": "zero"', '"given": 3', r"latencies\[0\].given: is no latency"),
        ("cards.json", '{"cores": 2}', '{"cores": 1e300}', r"\[0\].hardware.cores: "),
        ("cards.json", '{"cores": 2}', '{"core": 2}', r"hardware.core: .* did you mean cores"),
        ("cards.json", '{"cores": 2}', '"2 cores"', r"\[0\].hardware: .*write a mapping"),
        ("cards.json", '{"cores": 2}', f'{{"machine": "{501 * "x"}"}}', r"machine: .*at most 500"),
        ("cards.json", '"hash"', '"compiled_core": "none", "hash"', r"compiled_core: .*64"),
        ("plan.json", '"plan": {', '"plan": "sha256:1", "old": {', "plan.json"),
        ("plan.json", '"version"', "version", "is not valid JSON"),
        ("starts.json", '{"starts"', '[{"starts"', "is not valid JSON"),
    ],
)
def test_a_folder_that_was_changed_is_refused(
    folder: Path, file: str, old: str, new: str, why: str
) -> None:
    text = (folder / file).read_text()
    (folder / file).write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=why):
        load_loop(folder)
