"""Questions that hold the model's own last answer, and questions that are asked once more."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ssp_eval.data.records import load_records, record_to_json
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_replies import Loss, ModelReply
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.answer_records import record_of
from ssp_eval.evaluate.store.cell_file import CellResult
from ssp_eval.evaluate.store.requests import answer_sha256, rebuild_request
from ssp_eval.evaluate.store.results import load_cells
from ssp_eval.statistics.rows import rows_from_cells
from ssp_eval.statistics.tables.notices import OUTAGE, notices
from ssp_vla_bridge.messages import ErrorCode, Request, Response, response_from_json
from tests.support.models.answering import Answering

BagMaker = Callable[..., Path]
STATEFUL = ModelSpec("m", backend="openai", interface="openemma", adapter="waypoints")


class Model(Answering):
    """Answers with what its request holds, or as scripted for the n-th request it gets."""

    def __init__(self, script: Mapping[int, Any] | None = None) -> None:
        super().__init__(self.answer)
        self.script = dict(script or {})

    def answer(self, number: int, request: Request) -> ModelReply:
        scripted = self.script.get(number)
        if isinstance(scripted, ModelReply):
            return scripted
        if scripted is KeyboardInterrupt:
            raise KeyboardInterrupt
        blank = Response(request.request_id, request.stamp_ns, "m", "m/1")
        if isinstance(scripted, ErrorCode):
            return ModelReply(replace(blank, error_code=scripted, error_msg="scripted"))
        before = "nothing" if request.previous is None else request.previous.text
        return ModelReply(replace(blank, text=f"({before}) {request.stamp_ns}"))


def evaluate(bag: Path, out: Path, model: Model, spec: ModelSpec = STATEFUL, **options: Any):
    options = {"retry_pause_s": 0.0, **options}
    (result,) = run_campaign([(bag, None)], [spec], model, out, CellOptions(**options), True)
    return result


def lines(result: CellResult, name: str) -> list[dict[str, Any]]:
    """A file of the cell without the part of an id that is drawn anew in each run."""
    found = []
    for line in (result.folder / name).read_text().splitlines():
        value = json.loads(line)
        for part in (value, value.get("previous") or {}):
            if "request_id" in part:
                part["request_id"] = part["request_id"].split("-")[0]
        found.append(value)
    return found


def test_each_request_holds_the_answer_before(make_bag: BagMaker, tmp_path: Path) -> None:
    model = Model()
    result = evaluate(make_bag(), tmp_path / "out", model)
    stamps = [request.stamp_ns for request in model.requests]
    assert stamps == sorted(stamps)
    assert model.requests[0].previous is None
    raw = [response_from_json(json.loads(line)) for line in (result.folder / "raw.jsonl").open()]
    assert [request.previous for request in model.requests[1:]] == raw[:-1]
    asked = [json.loads(line) for line in (result.folder / "requests.jsonl").open()]
    assert asked[0]["previous"] is None
    assert [one["previous"] for one in asked[1:]] == [
        {"request_id": answer.request_id, "sha256": answer_sha256(answer)} for answer in raw[:-1]
    ]
    # An interface without state gets none, of the same clip and the same answers.
    stateless = Model()
    evaluate(
        make_bag("other"), tmp_path / "out2", stateless, replace(STATEFUL, interface="llavida")
    )
    assert [request.previous for request in stateless.requests] == [None] * 9


def test_a_failed_answer_leaves_the_next_request_without_one(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    model = Model({3: ModelReply(None, "no answer within 1 s", Loss.SILENT), 6: ErrorCode.BACKEND})
    result = evaluate(make_bag(), tmp_path / "out", model)
    held = [request.previous is not None for request in model.requests]
    assert held == [False, True, True, True, False, True, True, False, True]
    assert (result.status, result.missing, result.score["n"]) == ("ok", 2, 9)
    records = load_records(result.folder / "records.jsonl")
    notes = [record.adapter["notes"] for record in records if record.adapter is not None]
    said = [[note for note in of if note.startswith("asked without")] for of in notes]
    why = "asked without a previous answer: the one before is missing: {}"
    late, error = why.format(Loss.SILENT), why.format(Loss.ERROR)
    assert said == [[], [], [], [late], [], [error], []]
    asked = [json.loads(line) for line in (result.folder / "requests.jsonl").open()]
    assert [bool(one["no_previous"]) for one in asked] == [k in (4, 7) for k in range(9)]
    assert [one["kind"] for one in asked if one["missing"]] == [
        "no answer in time",
        "bridge answered an error",
    ]


@pytest.mark.parametrize("at", [1, 4, 8])
def test_an_interrupted_run_asks_what_an_uninterrupted_one_asks(
    at: int, make_bag: BagMaker, tmp_path: Path
) -> None:
    bag = make_bag()
    whole = evaluate(bag, tmp_path / "whole", Model())
    with pytest.raises(KeyboardInterrupt):
        evaluate(bag, tmp_path / "cut", Model({at: KeyboardInterrupt}))
    rest = Model()
    resumed = evaluate(bag, tmp_path / "cut", rest)
    assert len(rest.requests) == 9 - at
    for name in ("requests.jsonl", "raw.jsonl", "records.jsonl"):
        assert lines(resumed, name) == lines(whole, name), name
    assert resumed.score == whole.score


def test_an_answer_that_comes_later_renews_those_that_built_on_its_absence(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    bag, out = make_bag(), tmp_path / "out"
    whole = evaluate(bag, tmp_path / "whole", Model())
    evaluate(bag, out, Model({3: ErrorCode.TIMEOUT}))
    again = Model()
    resumed = evaluate(bag, out, again)
    # The third is asked again, and with its answer every later request is another one.
    assert len(again.requests) == 6
    assert lines(resumed, "requests.jsonl") == lines(whole, "requests.jsonl")
    assert lines(resumed, "records.jsonl") == lines(whole, "records.jsonl")


def test_a_changed_adapter_reads_again_and_never_asks_again(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    bag, out = make_bag(), tmp_path / "out"
    before = evaluate(bag, out, Model())
    silent = Model()
    changed = evaluate(bag, out, silent, adapter="waypoints:ego_xy")
    assert silent.requests == []
    assert (changed.sent, changed.reused) == (0, 9)
    assert lines(changed, "raw.jsonl") == lines(before, "raw.jsonl")
    cell = json.loads((changed.folder / "cell.json").read_text())
    assert (cell["adapter"], cell["interface"]) == ("waypoints:ego_xy", "openemma")
    # Whatever an answer depends on does ask again.
    for spec in (
        replace(STATEFUL, preprocessing={"history_s": 1.0}),
        replace(STATEFUL, interface="lightemma"),
        replace(STATEFUL, backend="http"),
        replace(STATEFUL, options={"temperature": 1}),
    ):
        asked = Model()
        evaluate(bag, out, asked, spec)
        assert len(asked.requests) == 9, spec


def test_a_record_can_be_made_again_from_what_is_stored(make_bag: BagMaker, tmp_path: Path) -> None:
    """The adapter needs the question too: it tells an echo of the history by it."""

    class Echoing(Model):
        def ask(self, request: Request) -> ModelReply:
            reply = super().ask(request)
            assert reply.response is not None
            pairs = [f"[{s.speed_mps:.1f}, 0.0]" for s in request.history[:-1]]
            plan = ", ".join(["[9.0, 0.1]"] * 10)
            return ModelReply(replace(reply.response, text=f"History {', '.join(pairs)} so {plan}"))

    spec = ModelSpec("m", backend="openai", interface="openemma")
    result = evaluate(make_bag(), tmp_path / "out", Echoing(), spec)
    cell = json.loads((result.folder / "cell.json").read_text())
    assert cell["adapter"] == "openemma:corrected"
    records = load_records(result.folder / "records.jsonl")
    asked = [json.loads(line) for line in (result.folder / "requests.jsonl").open()]
    raw = {
        one.request_id: one
        for one in (
            response_from_json(json.loads(line)) for line in (result.folder / "raw.jsonl").open()
        )
    }
    for record, question in zip(records, asked, strict=True):
        before = raw.get((question["previous"] or {}).get("request_id"))
        request = rebuild_request(question, before)
        assert len(request.history) == len(question["history"]) > 0
        answer = raw[question["request_id"]]
        again = record_of(record.t_s, answer, cell["adapter"], request, question["no_previous"])
        assert record_to_json(again) == record_to_json(record)
    assert records[-1].trajectory is not None
    # Without the question the echo would have been taken for the answer.
    blind = record_of(records[-1].t_s, answer, cell["adapter"])
    assert record_to_json(blind) != record_to_json(records[-1])


@pytest.mark.parametrize(
    ("failure", "passes"),
    [
        (ErrorCode.TIMEOUT, True),
        (ErrorCode.OVERLOAD, True),
        (ErrorCode.BROKEN_OFF, True),
        (ErrorCode.DECLINED, False),
        (ModelReply(None, "no answer within 1 s", Loss.SILENT), True),
        (ModelReply(None, "the bridge died", Loss.DIED), True),
        (ModelReply(None, "no bridge on its topics", Loss.UNREACHABLE), True),
        (ErrorCode.BACKEND, False),
        (ErrorCode.BAD_REQUEST, False),
        (ModelReply(None, "the answer can't be read", Loss.UNUSABLE), False),
    ],
    ids=lambda value: str(getattr(value, "name", "") or getattr(value, "loss", value)),
)
def test_only_errors_that_may_pass_are_asked_again(
    failure: Any, passes: bool, make_bag: BagMaker, tmp_path: Path
) -> None:
    bag = make_bag()
    model = Model({2: failure})
    result = evaluate(bag, tmp_path / "out", model, retry_errors=2)
    cell = json.loads((result.folder / "cell.json").read_text())
    assert cell["answers"]["asked_again"] == result.again == (1 if passes else 0)
    assert result.missing == (0 if passes else 1)
    assert len(model.requests) == (10 if passes else 9)
    ids = [request.request_id for request in model.requests]
    assert len(set(ids)) == len(ids)
    # Without the option nothing is asked twice.
    once = Model({2: failure})
    assert evaluate(bag, tmp_path / "out2", once).missing == 1
    assert len(once.requests) == 9


def test_repetition_ends_after_as_many_as_were_allowed(make_bag: BagMaker, tmp_path: Path) -> None:
    model = Model(dict.fromkeys(range(2, 6), ErrorCode.OVERLOAD))
    result = evaluate(make_bag(), tmp_path / "out", model, retry_errors=2)
    cell = json.loads((result.folder / "cell.json").read_text())
    # Requests 2, 3 and 4 are one question; the fourth error costs the next one a repetition.
    assert (result.missing, cell["answers"]["asked_again"]) == (1, 3)
    assert cell["answers"]["missing_by_kind"] == {"bridge overloaded": 1}
    assert len((result.folder / "raw.jsonl").read_text().splitlines()) == 9
    # An outage is no finding about a model: the status says so, and so does what shows the cell.
    assert result.is_failure
    cells = load_cells(tmp_path / "out")
    rows = rows_from_cells(cells)
    assert rows[0].reason == "1 answer missing: bridge overloaded"
    assert [notice.about for notice in notices(rows, cells) if notice.kind == OUTAGE] == [
        (f"{cells[0].scenario} / {cells[0].domain} / {cells[0].model}",)
    ]


def test_a_model_that_declines_had_its_say(make_bag: BagMaker, tmp_path: Path) -> None:
    model, bag = Model({2: ErrorCode.DECLINED}), make_bag()
    result = evaluate(bag, tmp_path / "out", model, retry_errors=2)
    assert (result.missing, result.again, result.is_failure) == (1, 0, False)
    assert result.losses == {"the model declined": 1}
    # Nor is it asked again: what was declined stays declined.
    again = Model({})
    assert evaluate(bag, tmp_path / "out", again).losses == {"the model declined": 1}
    assert again.requests == []
