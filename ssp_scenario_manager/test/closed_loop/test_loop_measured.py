"""Campaigns with a measured latency: what is kept of a model, and that it goes alone."""

from __future__ import annotations

import csv
import json
import os
import shutil
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from ssp_core import names
from ssp_core.bag.reading.reader import BagReader
from ssp_core.errors import HostError, InputError
from ssp_core.host.locks import beside_measuring, measuring_alone
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.latency import Latency, parse_latency
from ssp_core.run_file.model import Camera, RunSpec
from ssp_core.world.driver import driver_options
from ssp_scenario_manager.cli.loop import loop
from ssp_scenario_manager.cli.run import run as run_command
from ssp_scenario_manager.closed_loop.campaigns import plan_file, runs, seal
from ssp_scenario_manager.closed_loop.campaigns.again import run_of_row
from ssp_scenario_manager.closed_loop.campaigns.bags import Bags, bag_rows, write_bags
from ssp_scenario_manager.closed_loop.campaigns.campaign import run_campaign
from ssp_scenario_manager.closed_loop.campaigns.plan_file import CampaignDriver, LoopPlan
from ssp_scenario_manager.closed_loop.campaigns.runs import jobs_of, rows_of
from ssp_scenario_manager.closed_loop.campaigns.seal import sealed_starts
from ssp_scenario_manager.closed_loop.outcomes.outcome import HARNESS, Outcome
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS, rows_there
from ssp_scenario_manager.closed_loop.single_run.single import load_repeated_answers
from ssp_scenario_manager.closed_loop.starts.start import Start, make_start
from tests.support.processes.waiting import DEADLINE_S

SMALL = Camera(width_px=64, height_px=64)
# It never answers alike twice: what comes again was kept.
MODEL = """
import random


def keep(request):
    v = request.history[-1].speed_mps * random.uniform(0.97, 1.0)
    return f"I keep my speed, {random.random()}.", [(0.5 * v * k, 0.0) for k in range(11)]
"""


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a campaign of one start, the oracle and a model that isn't there any more."""
    folder = tmp_path_factory.mktemp("measured") / "campaign"
    models = tmp_path_factory.mktemp("models")
    (models / "model_of_a_day.py").write_text(MODEL)
    with pytest.MonkeyPatch.context() as patch:
        _few(patch)
        run(plan_of(models), folder)
    (models / "model_of_a_day.py").unlink()
    return folder


def _few(patch: pytest.MonkeyPatch) -> None:
    """Leave out most baselines, and most pixels."""

    def small(compiled: RunSpec, *rest: Any) -> Start:
        return make_start(compiled.model_copy(update={"camera": SMALL}), *rest)

    patch.setattr(plan_file, "BASELINES", ("oracle",))
    patch.setattr(seal, "make_start", small)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    _few(monkeypatch)


def plan_of(models: Path) -> LoopPlan:
    function = {"backend": "python", "function": "model_of_a_day:keep", "folder": str(models)}
    driver = {"driver": "mine", "options": driver_options("mine", function)}
    return LoopPlan.model_validate(
        {
            "schema": "ssp.loop/1",
            "events": ["cut_in"],
            "latencies": ["zero", "measured:0.5"],
            "starts": 1,
            "others": 0,
            "drivers": [driver],
        }
    )


def again(folder: Path) -> LoopPlan:
    return LoopPlan.model_validate(json.loads((folder / "plan.json").read_text())["plan"])


def run(plan: LoopPlan, folder: Path, jobs: int = 1) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    run_campaign(plan, folder, jobs, lambda *_: None, lambda _: None)


def rows(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "runs.csv").open()))


def test_a_measured_latency_stands_in_its_row_and_on_its_card(measured: Path) -> None:
    found = {(one["driver"], one["latency"]): one for one in rows(measured)}
    assert set(found) == {(d, s) for d in ("oracle", "mine") for s in ("zero", "measured:0.5")}
    assert found["mine", "zero"]["latency_p50_s"] == ""
    assert float(found["mine", "measured:0.5"]["latency_p50_s"]) > 0.0
    # A baseline computes in no time.
    assert found["oracle", "measured:0.5"]["latency_p99_s"] == "0.0"
    assert found["oracle", "measured:0.5"]["outcome"] == "avoided"
    cards = json.loads((measured / "cards.json").read_text())["cards"]
    (given,) = (one["latencies"][1] for one in cards if one["driver"] == "mine")
    assert given["given"] == "measured:0.5"
    assert 0.0 < given["p50_s"] <= given["p99_s"]
    assert given["contains"].startswith("encoding of pictures")
    kept = json.loads((measured / "answers" / "000004.json").read_text())
    assert given["answers"] == len(kept["event"]) + len(kept["free"])


@pytest.mark.usefixtures("few")
def test_a_campaign_that_was_cut_off_repeats_the_answers_that_were_given(
    measured: Path, tmp_path: Path
) -> None:
    """The model isn't needed: its answers, and the time that they took, lie beside the rows."""
    folder = shutil.copytree(measured, tmp_path / "cut off")
    (folder / "table.csv").unlink()
    text = (folder / "runs.csv").read_text()
    (folder / "runs.csv").write_text(text[: text.rindex("mine,zero")])
    run(again(folder), folder)
    for name in ("runs.csv", "table.csv", "cards.json", "texts/000001.jsonl"):
        assert (folder / name).read_bytes() == (measured / name).read_bytes(), name


@pytest.mark.usefixtures("few")
def test_a_models_run_is_driven_again_by_its_answers(measured: Path, tmp_path: Path) -> None:
    folder, row = tmp_path / "again", 4
    said = CliRunner().invoke(loop, [str(measured), "--again", str(row), "--out", str(folder)])
    assert said.exception is None, said.output
    told = json.loads((folder / "result.json").read_text())["driven"]
    wanted = rows(measured)[row - 1]
    assert (told["outcome"], told["latency"]) == (wanted["outcome"], wanted["latency"])
    assert str(told["outcome_s"]) == wanted["outcome_s"]
    assert str(told["v_i_mps"]) == wanted["v_i_mps"]
    kept = (measured / "answers" / f"{row:06d}.json").read_bytes()
    assert (folder / "answers.json").read_bytes() == kept


@pytest.mark.usefixtures("few")
def test_answers_are_repeated_by_the_run_that_they_are_of_alone(
    measured: Path, tmp_path: Path
) -> None:
    """An edited plan would have another driver's answers in its row; an edited run file, too."""
    folder = shutil.copytree(measured, tmp_path / "campaign")
    text = (folder / "plan.json").read_text()
    assert "model_of_a_day:keep" in text
    (folder / "plan.json").write_text(text.replace("model_of_a_day:keep", "model_of_a_day:other"))
    out = tmp_path / "again"
    said = CliRunner().invoke(loop, [str(folder), "--again", "4", "--out", str(out)])
    why = r"000004\.json: asked\.options: the answers are of another run: .* the campaign be driven"
    with pytest.raises(InputError, match=why):
        raise said.exception or AssertionError(said.output)
    job = list(jobs_of(again(folder), sealed_starts(folder), folder))[-1]
    with pytest.raises(InputError, match=r"000003\.json: asked\.options: .* asked again in row 3"):
        rows_of(job)
    run_file = SimpleNamespace(driven=driven_by_row(measured, 4))
    shutil.copy(measured / "answers" / "000004.json", tmp_path / "answers.json")
    assert load_repeated_answers(run_file, None, tmp_path) is not None  # type: ignore[arg-type]
    others = {"start": "sha256:1", "repeat": 1, "latency": Latency(0.5), "driver": "yours"}
    for name, value in others.items():
        run_file.driven = driven_by_row(measured, 4).model_copy(update={name: value})
        with pytest.raises(InputError, match=rf"answers\.json: asked\.{name}: .*give --drive"):
            load_repeated_answers(run_file, None, tmp_path)  # type: ignore[arg-type]


def driven_by_row(folder: Path, row: int) -> Driven:
    driven = run_of_row(folder, row).run.driven
    assert driven is not None
    return driven


@pytest.mark.usefixtures("few")
def test_a_campaign_that_goes_on_gives_a_failing_row_no_more_tries(
    measured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut off in each of its drives; and once behind the last one, before its rows are written."""
    job = list(jobs_of(again(measured), sealed_starts(measured)))[-1]
    real, driven, failures, ends = runs.drive_start, [0], [0], [0]

    def fails(start: Start, driver: CampaignDriver, *rest: Any, **options: Any) -> Any:
        if not driver.is_model:
            return real(start, driver, *rest, **options)
        driven[0] += 1
        if driven[0] == ends[0]:
            raise KeyboardInterrupt
        failures[0] += 1
        outcome = Outcome(
            HARNESS, 1.0 * failures[0], f"failure {failures[0]}", None, None, 0, False
        )
        return SimpleNamespace(outcome=outcome)

    monkeypatch.setattr(runs, "drive_start", fails)
    whole = rows_of(replace(job, folder=tmp_path / "whole")).rows
    assert (driven, failures) == ([6], [6])
    cells = [dict(zip(RUN_COLUMNS, row, strict=True)) for row in whole]
    assert [one["why"] for one in cells] == ["failure 3", "failure 6"]
    assert {one["outcome"] for one in cells} == {HARNESS}
    assert {one[name] for one in cells for name in ("needless", "states_sha256", "ttc_s")} == {""}
    for ends[0] in range(1, 7):
        driven[0] = failures[0] = 0
        own = replace(job, folder=tmp_path / str(ends[0]))
        with pytest.raises(KeyboardInterrupt):
            rows_of(own)
        assert rows_of(own).rows == whole
        assert (driven, failures) == ([7], [6])
    assert rows_of(own).rows == whole
    assert (driven, failures) == ([7], [6])


@pytest.mark.usefixtures("few")
def test_answers_that_were_removed_are_missed(measured: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(measured, tmp_path / "campaign")
    (folder / "answers" / "000004.json").unlink()
    said = CliRunner().invoke(loop, [str(folder), "--again", "4", "--out", str(tmp_path / "a")])
    assert isinstance(said.exception, InputError)
    assert "000004.json: isn't there" in str(said.exception)


@pytest.mark.usefixtures("few")
def test_a_run_of_a_campaign_leaves_the_bag_of_the_run_that_its_row_is_of(
    measured: Path, tmp_path: Path
) -> None:
    """The model isn't needed, and the bag is written once: a second call finds it there."""
    folder = shutil.copytree(measured, tmp_path / "campaign")
    told: list[tuple[int, int]] = []
    for _ in range(2):
        write_bags(folder, [4], 1, lambda *counts: told.append(counts))
    assert told == [(0, 1), (1, 1), (1, 1)]
    left = folder / "bags" / "000004"
    row, driven = rows(folder)[3], json.loads((left / "result.json").read_text())["driven"]
    assert [str(driven[key]) for key in ("outcome", "outcome_s", "v_i_mps", "needless")] == [
        row[key] for key in ("outcome", "outcome_s", "v_i_mps", "needless")
    ]
    assert f"{driven['outcome']} at" in (left / "top_view.svg").read_text()
    answers = folder / "answers" / "000004.json"
    assert (left / "answers.json").read_bytes() == answers.read_bytes()
    kept = json.loads(answers.read_text())["event"]
    with BagReader(left / "bag") as bag:
        counts = Counter(message.topic for message in bag.messages())
        responses = [bag.decode(m) for m in bag.messages(["/ssp/vla/mine/response"])]
        latencies = [bag.decode(m) for m in bag.messages(["/ssp/vla/mine/latency"])]
    assert counts["/ssp/vla/mine/request"] == len(latencies) == len(kept)
    assert [one.text for one in responses] == [
        one["given"]["answer"]["text"] for one in kept[: len(responses)]
    ]
    parts = {one.key: float(one.value) for one in latencies[0].status[0].values}
    assert parts["latency_s"] == kept[0]["given"]["latency"]["total_ns"] / 1e9
    assert counts["/ssp/vut/reference_ack"] == len(responses)
    # A plan that is replaced before the hand-over leads nothing.
    assert len(responses) - 10 < counts["/ssp/vut/reference"] < len(responses)
    assert counts[names.absolute(names.CAMERA_IMAGE)] > len(kept)


@pytest.mark.usefixtures("few")
def test_bags_are_of_all_runs_or_of_failed_ones_and_each_drivers_first(measured: Path) -> None:
    plan, there = again(measured), rows_there(measured / "runs.csv")
    later = [[*row[:2], "another start", *row[3:]] for row in there]

    def rows_with_bags(which: Bags, *kept: list[list[str]]) -> list[int]:
        return list(bag_rows(plan, [row for each in kept for row in each], which))

    assert rows_with_bags("none", there) == []
    assert rows_with_bags("failed", there) == [1, 2, 3, 4]
    # The model hits on its second start, too, and the oracle doesn't.
    assert rows_with_bags("failed", there, later) == [1, 2, 3, 4, 7, 8]
    assert rows_with_bags("all", there, later) == [*range(1, 9)]
    place = RUN_COLUMNS.index("outcome")
    lost = [[*row[:place], "harness", *row[place + 1 :]] for row in later]
    # A model that our side failed has no answers to repeat.
    assert rows_with_bags("all", there, lost) == [1, 2, 3, 4, 5, 6]


def test_runs_with_a_measured_latency_share_no_host(measured: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="goes with one process"):
        run(again(measured), tmp_path / "two", jobs=2)
    assert list((tmp_path / "two").iterdir()) == []


@pytest.fixture
def locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the locks of this test."""
    monkeypatch.setattr("ssp_core.host.locks.LOCKS", tmp_path)
    return tmp_path


def test_two_commands_that_measure_go_one_after_the_other(
    locks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The commands wait for one another even if their folders for temporary files differ."""
    waits, order = threading.Event(), []

    def second() -> None:
        with measuring_alone(lambda text: (order.append(text), waits.set())):  # type: ignore[func-returns-value]
            order.append("second")

    with measuring_alone(order.append):
        monkeypatch.setattr(tempfile, "tempdir", str(locks / "elsewhere"))
        other = threading.Thread(target=second)
        other.start()
        waits.wait()
        order.append("first")
    other.join()
    assert order[0].startswith("another command drives, or measures latencies, on this host")
    assert order[1:] == ["first", "second"]


@pytest.mark.parametrize("first_measures", [True, False])
@pytest.mark.usefixtures("locks")
def test_a_command_that_measures_and_one_that_does_not_go_one_after_the_other(
    first_measures: bool,
) -> None:
    """Kept answers and fixed latencies cost processor time that a measured L would hold."""
    kinds = [measuring_alone, beside_measuring]
    first, then = kinds if first_measures else reversed(kinds)
    waits, order = threading.Event(), []

    def second() -> None:
        with then(lambda text: (order.append(text), waits.set())):  # type: ignore[func-returns-value]
            order.append("second")

    with first(order.append):
        other = threading.Thread(target=second)
        other.start()
        waits.wait()
        order.append("first")
    other.join()
    assert "another command" in order[0]
    assert "measures latenc" in order[0]
    assert order[1:] == ["first", "second"]


@pytest.mark.usefixtures("locks")
def test_commands_that_measure_nothing_do_not_go_before_one_that_waits_to_measure() -> None:
    """A stream of them would keep it waiting for ever."""
    order: list[str] = []

    def begin(kind: Any, name: str) -> threading.Thread:
        waits = threading.Event()

        def hold() -> None:
            with kind(lambda _: waits.set()):
                order.append(name)

        thread = threading.Thread(target=hold)
        thread.start()
        assert waits.wait(DEADLINE_S), f"{name} doesn't wait"
        return thread

    with beside_measuring(order.append):
        threads = [begin(measuring_alone, "measures"), begin(beside_measuring, "drives")]
    for thread in threads:
        thread.join()
    assert order == ["measures", "drives"]


def test_commands_that_measure_nothing_run_side_by_side_and_need_no_lock(locks: Path) -> None:
    said: list[str] = []
    with beside_measuring(said.append), beside_measuring(said.append):
        assert said == []
    shutil.rmtree(locks / "ssp-measuring")
    (locks / "ssp-measuring").write_text("a file")
    with beside_measuring(said.append):
        assert said == []


def test_the_lock_is_for_every_user_whatever_the_umask_is(locks: Path) -> None:
    lock = locks / "ssp-measuring" / "lock"
    before = os.umask(0o077)
    try:
        with measuring_alone(print):
            assert lock.stat().st_mode & 0o777 == 0o644
            assert lock.parent.stat().st_mode & 0o7777 == 0o1777
        lock.chmod(0o600)
        with measuring_alone(print):
            assert lock.stat().st_mode & 0o777 == 0o644
    finally:
        os.umask(before)


def test_a_lock_that_can_not_be_opened_is_told(locks: Path) -> None:
    (locks / "ssp-measuring").write_text("a file")
    with (
        pytest.raises(HostError, match=r"ssp-measuring/lock, the lock.*can't be opened: .*make it"),
        measuring_alone(print),
    ):
        pass


def test_all_that_a_measuring_command_does_is_done_alone(
    measured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Models are loaded and ended, starts are drawn, and bags recorded under the lock, too."""
    order: list[str] = []

    @contextmanager
    def held(name: str, _say: object) -> Iterator[None]:
        order.append(name)
        try:
            yield
        finally:
            order.append("done")

    def step(name: str, result: Any = None) -> Any:
        return lambda *_, **__: order.append(name) or result

    command, driving = (sys.modules[f"ssp_scenario_manager.cli.{k}"] for k in ("loop", "driving"))
    plan = again(measured)
    for module in (command, driving):
        monkeypatch.setattr(module, "measuring_alone", partial(held, "alone"))
        monkeypatch.setattr(module, "beside_measuring", partial(held, "beside"))
    monkeypatch.setattr(command, "load_plan", lambda *_: plan)
    monkeypatch.setattr(plan_file, "try_driver", step("model"))
    monkeypatch.setattr(command, "run_campaign", step("runs", ([], [])))
    monkeypatch.setattr(command, "_say", lambda *_: None)
    monkeypatch.setattr(command, "write_bags", step("bags", []))
    said = CliRunner().invoke(loop, ["plan.yaml", "--out", str(tmp_path / "out"), "--bags", "none"])
    assert said.exit_code == 0, said.output
    assert order == ["alone", "model", "runs", "bags", "done"]
    order.clear()
    monkeypatch.setattr(driving, "try_driver", step("model"))
    monkeypatch.setattr(sys.modules["ssp_scenario_manager.cli.run"], "driven_run", stopped)
    drive = f"mine={json.dumps(plan.drivers[0].options)}"
    for latency, first in (("measured", "alone"), ("zero", "beside")):
        order.clear()
        options = ["--drive", drive, "--latency", latency, "--out", str(tmp_path / "run")]
        said = CliRunner().invoke(run_command, ["cut_in", "--in-process", *options])
        assert isinstance(said.exception, InterruptedError), said.output
        assert order == [first, "model", "done"]


def stopped(*_: object) -> None:
    raise InterruptedError


@pytest.mark.parametrize("text", ["zero", "fixed:0.25", "fixed:1", "measured:0.5", "measured:2"])
def test_a_latency_has_one_text(text: str) -> None:
    assert str(parse_latency(text)) == text
    assert sorted([Latency(0.0, measured=True), Latency(2.0)])[0] == Latency(2.0)
