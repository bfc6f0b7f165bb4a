"""The whole chain without ROS: bag, requests, raw answers, adapter, extraction, records, score."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_core.errors import InputError, PeerError
from ssp_core.hashing import sha256_file
from ssp_core.vocabulary import Verdict
from ssp_eval.data.labels import load_labels
from ssp_eval.data.records import load_records
from ssp_eval.demo import imperfect_controls
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients, ModelClient, ModelClients
from ssp_eval.evaluate.clients.model_replies import Loss, ModelReply
from ssp_eval.evaluate.clients.models import ModelSpec, bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.executors import Settings
from ssp_eval.evaluate.run import asking, show
from ssp_eval.evaluate.store.cell_file import CellResult
from ssp_eval.report.page import write_report
from ssp_eval.score.cell import score_cell
from ssp_vla_bridge.backends import phrases
from ssp_vla_bridge.messages import ErrorCode, Request, Response, response_from_json
from tests.support.models.answering import Answering

BagMaker = Callable[..., Path]
ONES = (
    "jovr",
    "sem_cov",
    "sem_acc_cond",
    "sem_acc_eff",
    "sem_acc_soft",
    "cia_eff",
    "act_acc_eff",
    "stfr",
    "tqsr",
    "atc_eff",
    "rsr",
    "ivcs",
)


def evaluate(
    bag: Path, out: Path, *names: str, clients: Any = None, **options: Any
) -> list[CellResult]:
    return run_campaign(
        [(bag, None)],
        [bridge_spec(name) for name in names],
        clients or InProcessClients(),
        out,
        CellOptions(**options),
        propose_labels=True,
    )


def cell_json(result: CellResult) -> dict[str, Any]:
    value = json.loads((result.folder / "cell.json").read_text())
    assert isinstance(value, dict)
    return value


def test_perfect_answers_score_1_in_every_metric(make_bag: BagMaker, tmp_path: Path) -> None:
    (result,) = evaluate(make_bag(), tmp_path / "out", "perfect")
    assert result.status == "ok"
    assert result.score is not None
    assert {key: result.score[key] for key in ONES} == dict.fromkeys(ONES, pytest.approx(1.0))
    assert result.score["n"] == result.score["matched"] == 9
    assert result.score["rl_s"] is not None
    assert result.score["denominators"]["semantic"] == 9 * 4 - 2


def test_a_demonstration_fails_where_perfect_answers_score_below_1(
    make_bag: BagMaker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = make_bag()
    evaluate(bag, tmp_path / "sound", "perfect")
    assert imperfect_controls(tmp_path / "sound") == []
    monkeypatch.setitem(phrases._LON, "decelerate", "I whistle")
    evaluate(bag, tmp_path / "lost", "perfect")
    (line,) = imperfect_controls(tmp_path / "lost")
    assert "perfect answers have act_acc_eff" in line


def test_silence_scores_0_or_null(make_bag: BagMaker, tmp_path: Path) -> None:
    (result,) = evaluate(make_bag(), tmp_path / "out", "silent")
    assert result.status == "ok"
    assert result.score is not None
    zero = [key for key in ONES if key != "sem_acc_cond"]
    assert {key: result.score[key] for key in zero} == dict.fromkeys(zero, 0)
    assert result.score["sem_acc_cond"] is None
    assert result.score["rl_s"] is None


def test_a_cell_s_folder_is_complete(make_bag: BagMaker, tmp_path: Path) -> None:
    out = tmp_path / "out"
    (result,) = evaluate(make_bag(stand_in=True, domain="physical"), out, "perfect")
    assert result.folder == out / "cells" / "cut_in__physical__perfect"
    raw = (result.folder / "raw.jsonl").read_text().splitlines()
    responses = [response_from_json(json.loads(line)) for line in raw]
    assert len(responses) == 9
    labels = load_labels(result.folder / "labels.json")
    records = load_records(result.folder / "records.jsonl")
    assert score_cell(labels, records).to_json() == result.score
    assert json.loads((result.folder / "score.json").read_text()) == result.score
    cell = cell_json(result)
    assert (cell["status"], cell["stand_in"], cell["labels_proposed"]) == ("ok", True, True)
    assert cell["clip"]["ego"] == "measured"
    assert cell["task_version"] is None
    assert cell["hashes"].pop("bag") == sha256_file(next((tmp_path / "bag").glob("*.mcap")))
    assert cell["hashes"].pop("verdict") == sha256_file(tmp_path / "bag" / "verdict.json")
    for name in ("labels.json", "raw.jsonl", "requests.jsonl", "records.jsonl", "score.json"):
        found = cell["hashes"].pop(name.partition(".")[0])
        assert found == sha256_file(result.folder / name), name
    assert set(cell["hashes"]) == {
        "question",
        "preprocessing",
        "decoding",
        "extractor",
        "thresholds",
        "cell",
    }
    asked = [json.loads(line) for line in (result.folder / "requests.jsonl").open()]
    assert [one["request_id"] for one in asked] == [r.request_id for r in responses]
    for one in asked:
        newest = one["frames"][-1]["sha256"].removeprefix("sha256:")[:32]
        assert (out / "frames" / f"{newest}.jpg").is_file()
        assert one["stamp_ns"] <= cell["clip"]["start_ns"] + one["label_t_s"] * 1e9


def test_stored_answers_are_not_asked_again(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(), tmp_path / "out"
    first = Answering()
    (before,) = evaluate(bag, out, "constant_velocity", clients=first)
    assert len(first.requests) == before.sent == 9
    again = Answering()
    (after,) = evaluate(bag, out, "constant_velocity", clients=again)
    assert again.requests == []
    assert (after.sent, after.reused, after.score) == (0, 9, before.score)
    fresh = Answering()
    evaluate(bag, out, "constant_velocity", clients=fresh, fresh=True)
    assert len(fresh.requests) == 9
    other = Answering()
    evaluate(bag, out, "constant_velocity={}", clients=other)
    assert other.requests == []


@pytest.mark.parametrize("answered", [0, 2])
def test_who_interrupts_is_told_what_is_kept(
    answered: int,
    make_bag: BagMaker,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """The same command goes on, and says that it does and how much was stored."""
    bag, out = make_bag(), tmp_path / "out"
    command = ["evaluate", str(bag), "--propose-labels", "--bridge", "silent", "--no-controls"]
    command += ["--out", str(out)]

    def stop(index: int, request: Request) -> ModelReply:
        if index == answered:
            raise KeyboardInterrupt
        return ModelReply(
            Response(request.request_id, request.stamp_ns, "m", "m/1", text=f"{index}")
        )

    def over(clients: ModelClients) -> None:
        def direct(bags: Any, models: Any, settings: Settings, *_: Any, **__: Any) -> Any:
            with asking() as (on_plan, on_record):
                return run_campaign(
                    bags,
                    models,
                    clients,
                    settings.out,
                    settings.options,
                    True,
                    on_plan=on_plan,
                    on_record=on_record,
                )

        monkeypatch.setattr("ssp_eval.evaluate.cli.evaluate_bags", direct)

    over(Answering(stop))
    assert main(command) == 130
    kept = f"the answers so far are in {out}; the same command, given again, goes on"
    printed = capfd.readouterr().err
    assert (kept in printed) is (answered > 0)
    assert "1 cell, 9 questions\n" in printed
    over(InProcessClients())
    assert main(command) == 0
    printed = capfd.readouterr().err
    assert ("not asked again" in printed) is (answered > 0)
    told = f"asked: {9 - answered}; answers that were stored already: {answered}"
    assert (told in printed) is (answered > 0)
    assert main([*command, "--fresh"]) == 0
    assert "stored" not in capfd.readouterr().err


def test_missing_answers_cost_their_records_only(
    make_bag: BagMaker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def some(index: int, request: Request) -> ModelReply:
        if index == 2:
            return ModelReply(None, "no answer within 1 s", Loss.SILENT)
        error = int(ErrorCode.BACKEND) if index == 5 else 0
        return ModelReply(
            Response(
                request.request_id,
                request.stamp_ns,
                "m",
                "m/1",
                "A car is ahead.",
                error_code=error,
                error_msg="out of memory" if error else "",
            )
        )

    out, bag = tmp_path / "out", make_bag()
    (result,) = evaluate(bag, out, "m", clients=Answering(some))
    assert (result.status, result.missing) == ("ok", 2)
    assert result.score is not None
    assert result.score["matched"] == 7
    by_kind = {"bridge answered an error": 1, "no answer in time": 1}
    assert dict(result.losses) == cell_json(result)["answers"]["missing_by_kind"] == by_kind
    missing = cell_json(result)["answers"]["missing"]
    assert [entry["reason"] for entry in missing] == [
        "no answer within 1 s",
        "the bridge answered error 2: out of memory",
    ]
    show([result], out)
    assert "; first: no answer within 1 s (see cell.json)" in capfd.readouterr().err
    # Errors aren't answers: both are asked again.
    again = Answering(some)
    evaluate(bag, out, "m", clients=again)
    assert again.count == 2


def test_nothing_at_all_is_a_failure_of_ours(make_bag: BagMaker, tmp_path: Path) -> None:
    calls: list[str] = []

    class Unreachable:
        def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
            calls.append(model.name)
            raise PeerError("no bridge for m on its topics")

    (result,) = evaluate(make_bag(), tmp_path / "out", "m", clients=Unreachable())
    assert result.status == "failed"
    assert calls == ["m", "m"]  # once more, and no more
    assert result.reasons == ("no bridge for m on its topics",)
    assert result.score is None
    assert not (result.folder / "score.json").exists()


def test_a_bridge_that_comes_up_late_is_asked_once_more(make_bag: BagMaker, tmp_path: Path) -> None:
    """One of 54 that did cost a report."""
    answering = Answering()
    calls: list[str] = []

    class Late:
        def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
            calls.append(model.name)
            if len(calls) == 1:
                raise PeerError("no bridge for m on its topics")
            return answering.client(model, options)

    (result,) = evaluate(make_bag(), tmp_path / "out", "perfect", clients=Late())
    assert result.status == "ok"
    assert result.missing == 0
    assert calls == ["perfect", "perfect"]


def test_an_invalid_run_is_refused_and_never_scored(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(), tmp_path / "out"
    evaluate(bag, out, "perfect")
    labels = bag.parent / "bag.labels.json"
    unsafe = make_bag(
        "unsafe", verdict=Verdict.INVALID_HARNESS, reasons=("the recorder lost 3 messages",)
    )
    (tmp_path / "unsafe.labels.json").write_text(labels.read_text())
    asked = Answering()
    (result,) = evaluate(unsafe, out, "perfect", clients=asked)
    assert result.status == "refused"
    assert "the recorder lost 3 messages" in result.reasons[0]
    assert asked.requests == []
    # The folder is the same; the score of the earlier, valid run must not survive in it.
    assert not (result.folder / "score.json").exists()
    assert cell_json(result)["status"] == "refused"


def test_labels_of_another_clip_are_noticed(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(), tmp_path / "out"
    evaluate(bag, out, "silent")
    path = bag.parent / "bag.labels.json"
    value = json.loads(path.read_text())
    path.write_text(json.dumps({**value, "domain": "physical"}))
    with pytest.raises(InputError, match="is for 'physical'"):
        evaluate(bag, out, "silent")
    path.write_text(json.dumps({**value, "event_version": "sha256:other"}))
    (result,) = evaluate(bag, out, "silent")
    assert result.status == "refused"
    assert "event version" in result.reasons[0]
    assert cell_json(result)["labels_proposed"] is False


def test_no_labels_and_twice_the_same_cell_are_said(make_bag: BagMaker, tmp_path: Path) -> None:
    bag = make_bag()
    models, clients, options = [ModelSpec("silent")], InProcessClients(), CellOptions()
    with pytest.raises(InputError, match="--propose-labels"):
        run_campaign([(bag, None)], models, clients, tmp_path / "out", options)
    twin = make_bag("twin")
    with pytest.raises(InputError, match="and so is"):
        run_campaign([(bag, None), (twin, None)], models, clients, tmp_path / "out", options, True)


def test_a_bridge_that_died_is_seen_in_table_and_report(
    make_bag: BagMaker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def dies(index: int, request: Request) -> ModelReply:
        if index in (3, 4):
            return ModelReply(None, "the bridge died before it answered (killed)", Loss.DIED)
        return ModelReply(
            Response(request.request_id, request.stamp_ns, "m", "m/1", "A car is ahead.")
        )

    out = tmp_path / "out"
    results = evaluate(make_bag(), out, "m", clients=Answering(dies))
    show(results, out)
    shown = capfd.readouterr()
    row = next(line for line in shown.out.splitlines() if " m " in line)
    assert row.split()[3:7] == ["ok", "unaudited", "9", "2"]
    assert "2 answers missing: bridge died" in shown.err
    assert "2 answers missing: bridge died" in write_report(out).read_text()


def test_labels_outside_the_clip_are_refused_before_asking(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    bag, out = make_bag(), tmp_path / "out"
    evaluate(bag, tmp_path / "first", "silent")
    path = bag.parent / "bag.labels.json"
    value = json.loads(path.read_text())
    last = value["labels"][-1]
    # The newest frame stands at 8.9 s; a label up to 0.11 s later can still be answered.
    last["t_s"] = 9.0
    path.write_text(json.dumps(value))
    (result,) = evaluate(bag, out, "silent")
    assert result.missing == 0
    last["t_s"] = 9.1
    path.write_text(json.dumps(value))
    asked = Answering()
    with pytest.raises(InputError, match="outside the clip") as caught:
        evaluate(bag, out, "silent", clients=asked)
    assert caught.value.field == "labels[8].t_s"
    assert "span -0.500 to 8.900 s" in str(caught.value)
    assert asked.requests == []
    # A run that can't be scored anyway is refused as such: it may have ended early.
    short = make_bag("short", duration_s=3.0, verdict=Verdict.ABORTED, reasons=("stopped",))
    (tmp_path / "short.labels.json").write_text(path.read_text())
    (result,) = evaluate(short, out, "silent")
    assert result.status == "refused"


def test_no_score_stays_beside_labels_that_it_isn_t_of(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(), tmp_path / "out"
    evaluate(bag, out, "perfect")
    folder = out / "cells" / "cut_in__simulation__perfect"
    assert (folder / "score.json").exists()

    def stop(index: int, request: Request) -> ModelReply:
        raise KeyboardInterrupt

    labels = bag.parent / f"{bag.name}.labels.json"
    value = json.loads(labels.read_text())
    value["labels"][0]["lat_actions"] = ["left", "straight", "right"]
    labels.write_text(json.dumps(value))
    with pytest.raises(KeyboardInterrupt):
        evaluate(bag, out, "perfect", clients=Answering(stop))
    there = {file.name for file in folder.iterdir()}
    assert there == {"labels.json", "raw.jsonl", "requests.jsonl"}
    (result,) = evaluate(bag, out, "perfect")
    assert (result.status, result.sent) == ("ok", 9)
