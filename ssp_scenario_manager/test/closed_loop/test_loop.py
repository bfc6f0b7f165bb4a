"""Campaigns of driven runs: the baselines, the table, and going on after a kill."""

from __future__ import annotations

import csv
import itertools
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from click.testing import CliRunner

from ssp_core.errors import HostError, InputError
from ssp_core.files.folders import make_folder
from ssp_core.hashing import sha256_file
from ssp_core.host.ray_cluster import import_ray
from ssp_core.run_file.model import load_run
from ssp_core.run_file.verdict import RecordedVerdict, read_verdict
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.cli.loop import loop
from ssp_scenario_manager.closed_loop.campaigns import campaign, runs
from ssp_scenario_manager.closed_loop.campaigns.bags import write_bags
from ssp_scenario_manager.closed_loop.campaigns.campaign import run_campaign
from ssp_scenario_manager.closed_loop.campaigns.cards import CARDS_SCHEMA
from ssp_scenario_manager.closed_loop.campaigns.groups import headings_of
from ssp_scenario_manager.closed_loop.campaigns.plan_file import (
    BASELINES,
    ZERO,
    LoopPlan,
)
from ssp_scenario_manager.closed_loop.campaigns.runs import Job, JobRows, jobs_of, rows_of
from ssp_scenario_manager.closed_loop.campaigns.seal import draw_starts
from ssp_scenario_manager.closed_loop.outcomes.rates import rates_of, rising
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS, read_row, rows_there
from ssp_scenario_manager.run.ordered_map import Engine, cluster, ordered_map
from tests.support.processes.killed_campaigns import Moment, RecordedRows, kill_campaign

PLAN = {
    "schema": "ssp.loop/1",
    "events": ["cut_in"],
    "latencies": ["zero", "fixed:1"],
    "starts": 1,
    "others": 0,
}
FILES = ("plan.json", "starts.json", "cards.json", "runs.csv", "table.csv")


def plan_of(**changes: Any) -> LoopPlan:
    return LoopPlan.model_validate({**PLAN, **changes})


def run(plan: LoopPlan, folder: Path, jobs: int = 1, engine: Engine = "processes") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    run_campaign(plan, folder, jobs, lambda *_: None, lambda _: None, engine)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a small campaign of the baselines."""
    folder = tmp_path_factory.mktemp("loop") / "campaign"
    run(plan_of(), folder)
    return folder


def table(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "table.csv").open()))


def rows(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "runs.csv").open()))


def test_the_headlines_of_the_baselines_are_what_they_must_be(done: Path) -> None:
    found = {(one["driver"], one["latency"]): float(one["headline"]) for one in table(done)}
    for driver in ZERO:
        assert (found[driver, "zero"], found[driver, "fixed:1"]) == (0.0, 0.0), driver
    assert found["oracle", "zero"] == 1.0
    for driver in ("oracle", "aeb"):
        assert found[driver, "zero"] >= found[driver, "fixed:1"]
    assert list(dict.fromkeys(driver for driver, _ in found)) == list(BASELINES)


def test_no_response_reproduces_v_r_and_constant_velocity_comes_near_at_each_latency(
    done: Path,
) -> None:
    for one in rows(done):
        if one["driver"] == "no_response":
            assert one["v_i_mps"] == one["v_r_mps"] != ""
        elif one["driver"] == "constant_velocity":
            assert abs(float(one["v_i_mps"]) - float(one["v_r_mps"])) <= 0.05
            assert one["needless"] == ""


def test_over_all_latencies_no_baseline_gains_by_being_slower(tmp_path: Path) -> None:
    """Six latencies, and the two baselines that METHOD 8.10 says it of."""
    latencies = ["zero", *(f"fixed:{s}" for s in ("0.1", "0.2", "0.5", "1", "2"))]
    plan = plan_of(latencies=latencies)
    starts = draw_starts(plan, tmp_path, 1, lambda _: None)
    chosen = ("oracle", "aeb")
    jobs = [job for job in jobs_of(plan, starts) if job.driver.driver in chosen]
    made = [dict(zip(RUN_COLUMNS, row, strict=True)) for job in jobs for row in rows_of(job).rows]
    assert [one["latency"] for one in made] == latencies * len(chosen)
    found = rates_of([read_row(list(one.values())) for one in made])
    assert rising(found, chosen) == []
    headlines = {(one.driver, str(one.latency)): one.headline for one in found}
    assert headlines["oracle", "zero"] == 1.0
    # So slow that even the hardest braking comes too late.
    assert headlines["oracle", "fixed:2"] == 0.0


def test_starts_are_sealed_before_a_driver_runs(done: Path) -> None:
    kept = json.loads((done / "starts.json").read_text())
    (start,) = kept["starts"]
    assert start["kind"] == "critical"
    assert {one["start"] for one in rows(done)} == {start["hash"]}
    assert start["v_r_mps"] is not None


def test_a_campaign_that_was_killed_goes_on_to_the_same_table(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is killed at 15 moments; every second time its newest row is cut off anywhere."""
    for file in ("plan.json", "starts.json"):
        shutil.copy(done / file, tmp_path / file)
    kept = rows_there(done / "runs.csv")
    chosen = random.Random(8)
    moments = [
        Moment(least, chosen.randint(1, 80), k % 2 * chosen.randrange(1, 60))
        for k, least in enumerate(sorted(chosen.choices(range(len(kept) + 1), k=15)))
    ]
    assert kill_campaign(plan_of(), tmp_path, done, moments) == [-signal.SIGKILL] * len(moments)
    monkeypatch.setattr(campaign, "rows_of", RecordedRows(kept))
    run(plan_of(), tmp_path)
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (done / name).read_bytes(), name


def test_a_killed_command_leaves_what_the_next_one_goes_on_from_to_the_same_files(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One is killed while it draws starts, one while runs are driven."""
    plan, folder = tmp_path / "plan.yaml", tmp_path / "killed"
    plan.write_text(yaml.safe_dump(PLAN))
    command = [sys.executable, "-m", "ssp_core.cli", "loop", str(plan), "--out", str(folder)]
    most = (done / "runs.csv").stat().st_size // 3
    written = folder / "runs.csv"
    for least in (None, random.Random(3).randrange(most)):
        with (tmp_path / "said").open("w+") as said:
            process = subprocess.Popen(
                [*command, "--bags", "none"], stdout=said, stderr=said, start_new_session=True
            )
            while not (
                (folder / "tasks").is_dir()
                if least is None
                else written.is_file() and written.stat().st_size > least
            ):
                assert process.poll() is None, (tmp_path / "said").read_text()
                time.sleep(0.01)
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    # What is left is what the same campaign had without a kill.
    monkeypatch.setattr(campaign, "rows_of", RecordedRows(rows_there(done / "runs.csv")))
    run(plan_of(), folder)
    for name in FILES:
        assert (folder / name).read_bytes() == (done / name).read_bytes(), name


def test_a_driver_is_run_anew_to_the_same_row(done: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(done, tmp_path / "again")
    lines = (done / "runs.csv").read_text().splitlines(keepends=True)
    (folder / "runs.csv").write_text("".join(lines[:-2]))
    run(plan_of(), folder)
    assert (folder / "runs.csv").read_text() == "".join(lines)


def test_another_campaign_does_not_go_on_in_the_folder(done: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(done, tmp_path / "other")
    with pytest.raises(InputError, match="is of another campaign"):
        run(plan_of(latencies=["zero"]), folder)
    text = (folder / "runs.csv").read_text()
    for old, new in (
        ("constant_velocity", "someone"),
        (",fixed:1,0,", ",fixed:2,0,"),
        ("critical", "harmless"),
    ):
        (folder / "runs.csv").write_text(text.replace(old, new))
        with pytest.raises(InputError, match="holds another campaign's run"):
            run(plan_of(), folder)


def test_starts_that_were_changed_after_their_seal_are_refused(done: Path, tmp_path: Path) -> None:
    """A start that a driver lost must not become a harmless one, or vanish."""
    folder = shutil.copytree(done, tmp_path / "changed")
    text = (folder / "starts.json").read_text()
    (folder / "starts.json").write_text(text.replace('"kind": "critical"', '"kind": "harmless"'))
    with pytest.raises(InputError, match="was changed after it was sealed"):
        run(plan_of(), folder)


def test_starts_of_another_schema_are_refused_by_its_name(done: Path, tmp_path: Path) -> None:
    """Their shares of starts weren't kept, and a report of this version shows them."""
    folder = shutil.copytree(done, tmp_path / "older")
    kept = json.loads((folder / "starts.json").read_text())
    assert kept["schema"] == "ssp.loop_starts/6"
    (folder / "starts.json").write_text(json.dumps({**kept, "schema": "ssp.loop_starts/5"}))
    with pytest.raises(InputError, match=r"starts\.json.*must be ssp.loop_starts/6.*starts/5"):
        run(plan_of(), folder)


def test_a_campaign_goes_on_by_the_sources_that_it_began_with_alone(
    done: Path, tmp_path: Path
) -> None:
    """The version alone stays the same over every edit of a working copy."""
    folder = shutil.copytree(done, tmp_path / "edited")
    sealed = json.loads((folder / "plan.json").read_text())
    assert set(sealed["sources"]) >= {"ssp_core", "ssp_ot_controller", "ssp_scenario_manager"}
    sealed["sources"]["ssp_core"] = "sha256:" + 64 * "0"
    (folder / "plan.json").write_text(json.dumps(sealed))
    with pytest.raises(InputError, match="other sources of this software"):
        run(plan_of(), folder)


def test_each_driver_has_a_card_that_binds_it(done: Path, tmp_path: Path) -> None:
    cards = json.loads((done / "cards.json").read_text())["cards"]
    assert [one["driver"] for one in cards] == list(BASELINES)
    oracle = next(one for one in cards if one["driver"] == "oracle")
    assert oracle["d_max_mps2"] == 7.0
    assert oracle["limits"]["plan"]["least_end_s"] == 2.0
    assert [one["p99_s"] for one in oracle["latencies"]] == [0.0, 1.0]
    assert {(one["prompt_sha256"], one["prompt"]) for one in cards} == {
        (None, "asked without words")
    }
    # No baseline is a model; that of R157 isn't asked at all.
    assert {(str(one["cameras"]), one["model"], one["timeout_s"]) for one in cards} == {
        ("[]", None, None)
    }
    for card in cards:
        if card["driver"] in ("no_response", "built_in", "careful"):
            assert [one["p50_s"] for one in card["latencies"]] == [None, None]
    folder = shutil.copytree(done, tmp_path / "cards")
    text = (folder / "cards.json").read_text()
    (folder / "cards.json").write_text(text.replace('"d_max_mps2": 7.0', '"d_max_mps2": 8.0'))
    with pytest.raises(InputError, match="was changed after it was sealed"):
        run(plan_of(), folder)
    # Where latencies are fixed, another machine gives the same bytes; a compiled core always does.
    for one in cards:
        one["hardware"]["cores"] = 4096
        assert one["compiled_core"] is None
        one["compiled_core"] = 64 * "a"
    (folder / "cards.json").write_text(json.dumps({"schema": CARDS_SCHEMA, "cards": cards}))
    run(plan_of(), folder)


def test_the_careful_driver_of_r157_stands_where_it_is_defined(
    done: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = [one for one in rows(done) if one["driver"] == "careful"]
    assert [one["latency"] for one in found] == ["zero", "fixed:1"]
    assert found[0]["outcome"] == found[1]["outcome"] == "avoided"
    # It perceives no earlier than T_obs, and brakes 1.15 s later.
    assert float(found[0]["response_s"]) >= float(found[0]["observable_s"]) + 1.15
    starts = json.loads((done / "starts.json").read_text())["starts"]
    monkeypatch.setattr(runs, "is_defined", lambda _run: False)
    drivers = [job.driver.driver for job in jobs_of(plan_of(), starts)]
    assert "careful" not in drivers
    assert len(drivers) == len(BASELINES) - 1


def test_rows_tell_how_near_a_run_came_to_harm(done: Path) -> None:
    found = {(one["driver"], one["latency"]): one for one in rows(done)}
    hit, missed = found["no_response", "zero"], found["oracle", "zero"]
    assert (hit["distance_m"], hit["needed_mps2"], hit["pet_s"]) == ("0.0", "", "")
    assert float(hit["ttc_s"]) < 0.1
    assert float(missed["distance_m"]) > 5.0
    assert float(missed["ttc_s"]) > 2.0
    assert float(missed["needed_mps2"]) > 0.0
    # A driver that re-plans from where it is changes its mind less the sooner it is heard.
    assert float(missed["replan_m"]) < float(found["oracle", "fixed:1"]["replan_m"])


def test_the_command_prints_the_table_of_what_is_there(done: Path, tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(yaml.safe_dump(PLAN))
    arguments = [str(plan), "--out", str(done), "--bags", "none", "--json"]
    said = CliRunner().invoke(loop, arguments, standalone_mode=False)
    found = json.loads(said.stdout.splitlines()[-1])
    assert [one["driver"] for one in found][::2] == list(BASELINES)
    assert (said.exception, said.return_value) == (None, 0)


def overwrite(path: Path, text: str) -> None:
    path.write_text(text.replace("collision", "avoided").replace("critical", "harmless") + " ")


def overwrite_in_place(path: Path, text: str) -> None:
    """Keep length and stated time of the last write."""
    before = path.stat()
    path.write_text(text.swapcase())
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def cut(path: Path, text: str) -> None:
    os.truncate(path, len(text.encode()) // 2)


def replace_file(path: Path, text: str) -> None:
    other = path.with_name(".other")
    other.write_text(text.swapcase())
    other.replace(path)


@pytest.mark.parametrize("spoil", [overwrite, overwrite_in_place, cut, replace_file, Path.unlink])
@pytest.mark.parametrize("name", ["runs.csv", "plan.json", "starts.json", "cards.json"])
def test_files_that_something_else_changes_while_a_campaign_runs_end_it(
    done: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    spoil: Callable[..., None],
) -> None:
    """A driver that runs as the user who runs the campaign can write into its folder."""
    folder = tmp_path / "campaign"
    shutil.copytree(done, folder)
    rows = (folder / "runs.csv").read_text().splitlines(keepends=True)
    (folder / "runs.csv").write_text("".join(rows[:-4]))

    def spoil_once(count: int, _: int) -> None:
        if count == len(rows) - 3:
            path = folder / name
            spoil(*(path,) if spoil is Path.unlink else (path, path.read_text()))

    monkeypatch.setattr(campaign, "rows_of", RecordedRows(rows_there(done / "runs.csv")))
    with pytest.raises(InputError, match="was changed while the campaign ran") as raised:
        run_campaign(plan_of(), folder, 1, spoil_once, lambda _: None)
    assert raised.value.file == str(folder / name)


def test_the_check_of_a_campaigns_files_reads_each_of_them_twice_however_many_rows_come(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: Counter[str] = Counter()

    def sha256_counted(path: Path) -> str:
        read[path.name] += path.stat().st_size
        return sha256_file(path)

    for file in ("plan.json", "starts.json"):
        shutil.copy(done / file, tmp_path / file)
    monkeypatch.setattr(campaign, "rows_of", RecordedRows(rows_there(done / "runs.csv")))
    monkeypatch.setattr(campaign, "sha256_file", sha256_counted)
    run(plan_of(), tmp_path)
    sizes = {name: (tmp_path / name).stat().st_size for name in FILES if name != "table.csv"}
    sealed = {name: 2 * size for name, size in sizes.items() if name != "runs.csv"}
    assert read == sealed | {"runs.csv": sizes["runs.csv"]}


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"timeout_s": 30.0}, "timeout in s: 30"),
        ({"d_max_mps2": 5.5}, "D_max in m/s²: 5.5"),
        ({"limits": {"plan": {"reach_m": 3}}}, "limits: plan reach_m 3"),
        ({"cameras": [{"width_px": 640}]}, "camera: width_px 640"),
    ],
)
def test_groups_whose_cards_differ_in_one_condition_have_headings_that_name_it(
    done: Path, changed: dict[str, Any], said: str
) -> None:
    cards = json.loads((done / "cards.json").read_text())["cards"]
    first = next(card for card in cards if card["driver"] == "no_response")
    own = {**first, "timeout_s": 60.0, "cameras": [{"width_px": 1280}]}
    heads = headings_of([{**own, "driver": "a"}, {**own, "driver": "b", **changed}])
    assert len(set(heads)) == 2
    assert heads[1].endswith(f", {said}")
    assert headings_of([{**own, "driver": "a"}, {**own, "driver": "b"}]) == [
        "plans tracked, route 80 m ahead, by camera, a question each 0.1 s at most"
    ]


def test_drivers_with_unlike_cards_stand_apart_in_table_and_print(
    done: Path, tmp_path: Path
) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(yaml.safe_dump(PLAN))
    command = [str(plan), "--out", str(done), "--bags", "none"]
    lines = CliRunner().invoke(loop, command, standalone_mode=False).stdout.splitlines()
    heads = [k for k, line in enumerate(lines) if line.startswith("group ")]
    assert [lines[k] for k in heads] == [
        "group 1: plans tracked, route 80 m ahead, no frames, a question each 0.1 s at most",
        "group 2: prescribed motion, outside the plant: no plans, no latency",
    ]
    printed = [lines[a + 1 : b] for a, b in itertools.pairwise([*heads, -1])]
    drivers = [list(dict.fromkeys(line.split()[1] for line in part)) for part in printed]
    assert drivers == [[one for one in BASELINES if one != "careful"], ["careful"]]
    number_of = {one: k for k, group in enumerate(drivers, 1) for one in group}
    assert {one["driver"]: int(one["group"]) for one in table(done)} == number_of
    said = CliRunner().invoke(loop, [*command, "--json"], standalone_mode=False)
    told = json.loads(said.stdout.splitlines()[-1])
    assert {one["driver"]: one["group"] for one in told} == number_of


def test_the_table_is_printed_where_no_bag_can_be_recorded(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise HostError("no space left")

    monkeypatch.setattr(sys.modules["ssp_scenario_manager.cli.loop"], "write_bags", full)
    plan = tmp_path / "plan.yaml"
    plan.write_text(yaml.safe_dump(PLAN))
    said = CliRunner().invoke(loop, [str(plan), "--out", str(done)], standalone_mode=False)
    assert isinstance(said.exception, HostError)
    assert "oracle             L 0        1.00" in said.stdout


def test_one_run_is_driven_again_by_one_command_to_the_same_outcome(
    done: Path, tmp_path: Path
) -> None:
    number, wanted = next(
        (k, one)
        for k, one in enumerate(rows(done), 1)
        if (one["driver"], one["latency"]) == ("aeb", "fixed:1")
    )
    folder = tmp_path / "again"
    said = CliRunner().invoke(loop, [str(done), "--again", str(number), "--out", str(folder)])
    assert said.exception is None, said.output
    told = json.loads((folder / "result.json").read_text())["driven"]
    assert (told["outcome"], told["start"]) == (wanted["outcome"], wanted["start"])
    assert str(told["v_i_mps"]) == wanted["v_i_mps"]
    assert told["latency"] == "fixed:1"
    assert (folder / "bag").is_dir()
    view = ElementTree.fromstring((folder / "top_view.svg").read_text())
    classes = {one.get("class") for one in view.iter()}
    assert {"planned", "effective", "driven", "object", "contact"} <= classes
    shown = [one.text or "" for one in view.iter() if one.tag.endswith("text")]
    assert {"T_obs", "frame", "effective", "outcome"} <= set(shown)
    assert shown[0].startswith("cut_in: aeb, L = 1 s: collision at")
    # The aeb brakes behind the trigger alone, and has the gap of the start there.
    kept = json.loads((done / "starts.json").read_text())["starts"][0]["values"]
    drawn_m = kept["triggers.0.condition.below_m"]
    (words,) = (text for text in shown if text.startswith("gap at the trigger"))
    said_m, interval = re.fullmatch(r"gap at the trigger (\S+) m, (.*)", words).groups()  # type: ignore[union-attr]
    assert float(said_m) == pytest.approx(drawn_m, abs=0.2)
    assert interval == "K* 16 to 20 m"
    assert "gap" in classes


def test_a_run_that_is_another_than_its_row_is_no_valid_result(done: Path, tmp_path: Path) -> None:
    """One row has the hash of other states, and another row has another outcome."""
    folder = shutil.copytree(done, tmp_path / "campaign")
    lines = (folder / "runs.csv").read_text().splitlines(keepends=True)
    number, one = next((k, o) for k, o in enumerate(rows(done), 1) if o["driver"] == "aeb")
    bag, states = number + 1, one["states_sha256"]
    assert states.startswith("sha256:")
    lines[number] = lines[number].replace(states, "sha256:0")
    lines[bag] = lines[bag].replace(",collision,", ",avoided,")
    (folder / "runs.csv").write_text("".join(lines))
    again = tmp_path / "again"
    said = CliRunner().invoke(
        loop, [str(folder), "--again", str(number), "--out", str(again)], standalone_mode=False
    )
    assert (said.exception, said.return_value) == (None, 1)
    told = json.loads((again / "result.json").read_text())
    why = (
        f"it isn't the run of row {number} of {folder / 'runs.csv'}: "
        f"states_sha256 is {states} and was sha256:0"
    )
    assert (told["verdict"], told["reasons"]) == ("invalid_harness", [why])
    assert (told["driven"]["outcome"], told["driven"]["why"]) == ("harness", why)
    assert read_verdict(again / "bag") == RecordedVerdict(Verdict.INVALID_HARNESS, (why,))
    (wrong,) = write_bags(folder, [bag], 1, lambda *_: None)
    place = folder / "bags" / f"{bag:06d}"
    assert wrong.startswith(f"{place}: it isn't the run of row {bag} of")
    assert "outcome is collision and was avoided" in wrong
    assert json.loads((place / "result.json").read_text())["verdict"] == "invalid_harness"


def test_a_run_is_driven_again_by_the_sources_that_drove_it_alone(
    done: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(done, tmp_path / "edited")
    sealed = json.loads((folder / "plan.json").read_text())
    sealed["sources"]["ssp_core"] = "sha256:" + 64 * "0"
    (folder / "plan.json").write_text(json.dumps(sealed))
    out = tmp_path / "again"
    said = CliRunner().invoke(loop, [str(folder), "--again", "1", "--out", str(out)])
    assert isinstance(said.exception, InputError)
    assert "plan.json: sources: is of other sources of this software" in str(said.exception)
    assert not out.exists()


@pytest.mark.parametrize(("driver", "why"), [("careful", "prescribed"), ("", "has 16 runs")])
def test_a_row_that_can_not_be_driven_again_is_refused(
    done: Path, driver: str, why: str, tmp_path: Path
) -> None:
    names = [one["driver"] for one in rows(done)]
    number = names.index(driver) + 1 if driver else len(names) + 1
    said = CliRunner().invoke(loop, [str(done), "--again", str(number), "--out", str(tmp_path)])
    assert isinstance(said.exception, InputError)
    assert why in str(said.exception)


@pytest.mark.parametrize("change", ["a column less", "in another order"])
def test_a_row_that_is_not_of_its_place_in_the_plan_is_not_driven_again(
    done: Path, change: str, tmp_path: Path
) -> None:
    folder = shutil.copytree(done, tmp_path / "edited")
    head, *lines = (folder / "runs.csv").read_text().splitlines()
    if change == "a column less":
        head, *lines = (line.rpartition(",")[0] for line in (head, *lines))
    else:
        lines.reverse()
    (folder / "runs.csv").write_text("\n".join((head, *lines, "")))
    out = tmp_path / "out"
    said = CliRunner().invoke(loop, [str(folder), "--again", "1", "--out", str(out)])
    assert isinstance(said.exception, InputError)
    assert "runs.csv" in str(said.exception)
    assert not out.exists()


def test_a_campaign_tells_of_any_driver_that_gets_better_with_latency(
    done: Path, tmp_path: Path
) -> None:
    folder, told = shutil.copytree(done, tmp_path / "rises"), list[str]()
    driven = rows(folder)
    for one in driven:
        if (one["driver"], one["latency"]) == ("constant_velocity", "fixed:1"):
            one |= {"outcome": "avoided", "needless": ""}
    with (folder / "runs.csv").open("w", newline="") as stream:
        written = csv.DictWriter(stream, list(driven[0]), lineterminator="\n")
        written.writeheader()
        written.writerows(driven)
    run_campaign(plan_of(), folder, 1, lambda *_: None, told.append)
    assert (
        "gets better with latency: constant_velocity on cut_in: 0.00 at L = 0 s, 1.00 at 1 s"
        in told
    )


@pytest.fixture(scope="module")
def two_actors() -> Iterator[None]:
    with cluster("ray", 2):
        yield
    assert not import_ray().is_initialized()


@pytest.mark.programs
@pytest.mark.usefixtures("two_actors")
class TestOnACluster:
    """Work of a campaign on a Ray cluster."""

    def test_a_campaign_that_was_cut_off_has_the_files_of_one_process(
        self, done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Its start is drawn there, and one driver driven; the rows of the others are kept ones."""
        kept = rows_there(done / "runs.csv")

        def rows_on_cluster(job: Job) -> JobRows:
            if job.driver.driver == "no_response":
                return rows_of(job)
            found = [row for row in kept if row[4] == job.driver.display_name]
            return JobRows(found, [() for _ in found])

        def cut_off(count: int, _: int) -> None:
            if count == 4:
                raise KeyboardInterrupt

        monkeypatch.setattr(campaign, "rows_of", rows_on_cluster)
        with pytest.raises(KeyboardInterrupt):
            run_campaign(plan_of(), make_folder(tmp_path), 1, cut_off, lambda _: None, "ray")
        run(plan_of(), tmp_path, 2, "ray")
        for name in FILES:
            assert (tmp_path / name).read_bytes() == (done / name).read_bytes(), name

    def test_the_order_is_kept_and_the_work_is_elsewhere(self) -> None:
        with ordered_map(2, "ray") as run_all:
            assert list(run_all(abs, range(-20, 0))) == list(range(20, 0, -1))
            places = set(run_all(os.path.realpath, ["/proc/self"] * 4))
            assert f"/proc/{os.getpid()}" not in places

    def test_an_error_of_the_work_is_that_of_one_process(self, tmp_path: Path) -> None:
        with (
            pytest.raises(InputError, match=r"nothing\.yaml.*No such file"),
            ordered_map(2, "ray") as run_all,
        ):
            list(run_all(load_run, [tmp_path / "nothing.yaml"]))

    def test_a_machine_with_another_software_is_refused(self) -> None:
        with (
            pytest.raises(HostError, match="another version of this software"),
            ordered_map(1, "ray", os.getpid) as run_all,
        ):
            list(run_all(abs, [1]))
