"""A cell's files are never larger than what their readers take, whatever bridges say."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ssp_core.files.reading import read_mapping
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_replies import MOST_REASON, Loss, ModelReply, unusable
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.cell_file import CellResult, decodings, short_list
from ssp_vla_bridge.messages import Request, Response
from tests.support.models.answering import Answering

BagMaker = Callable[..., Path]
MIB = 1 << 20


def answer(request: Request, **decoding: Any) -> ModelReply:
    text = "A car is ahead."
    return ModelReply(
        Response(request.request_id, request.stamp_ns, "m", "m/1", text, (), decoding)
    )


def evaluate(
    bag: Path, out: Path, reply: Callable[[int, Request], ModelReply], *models: ModelSpec
) -> list[CellResult]:
    clients = Answering(reply)
    return run_campaign(
        [(bag, None)], models or [ModelSpec("m")], clients, out, CellOptions(), True
    )


def test_what_differs_by_answer_is_left_to_the_raw_file(make_bag: BagMaker, tmp_path: Path) -> None:
    def talkative(count: int, request: Request) -> ModelReply:
        return answer(request, seed=1, usage={"tokens": count})

    (result,) = evaluate(make_bag(), tmp_path, talkative)
    assert (result.status, result.missing) == ("ok", 0)
    assert read_mapping(result.folder / "cell.json")["decoding"] == [{"seed": 1}]
    assert '"tokens": 8' in (result.folder / "raw.jsonl").read_text()


def test_reasons_are_cut_in_the_summary_and_whole_where_they_were_asked(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    def dies(count: int, request: Request) -> ModelReply:
        return ModelReply(None, f"{count}: {'y' * MIB}", Loss.DIED)

    (result,) = evaluate(make_bag(), tmp_path, dies)
    cell = read_mapping(result.folder / "cell.json")
    assert {len(one["reason"]) for one in cell["answers"]["missing"]} == {MOST_REASON}
    assert {len(reason) for reason in cell["reasons"]} == {MOST_REASON}
    asked = [json.loads(line) for line in (result.folder / "requests.jsonl").open()]
    assert all(len(one["missing"]) > MIB for one in asked)


@pytest.mark.parametrize("count", [0, 1, 20, 21, 5000])
def test_many_reasons_are_counted(count: int) -> None:
    found = short_list([str(n) for n in range(count)])
    assert found[:20] == [str(n) for n in range(min(count, 20))]
    assert found[20:] == ([] if count <= 20 else [f"and {count - 20} more"])


def test_settings_that_fit_are_all_named() -> None:
    told = [{"seed": 1, "usage": {"tokens": n}} for n in range(3)] + [{"seed": 2}]
    answers = [Response("r", 1, "m", "m/1", "", (), one) for one in told]
    assert decodings(answers) == [{"seed": 1}, {"seed": 2}]
    assert decodings([]) == []
    huge = Response("r", 1, "m", "m/1", "", (), {"all": "x" * (1 << 16)})
    assert "more than 65536" in unusable(huge)


def test_what_a_model_thought_is_no_setting() -> None:
    stages = [{"name": "motion", "reasoning": "x" * 100_000} for _ in range(4)]
    thoughtful = Response("r", 1, "m", "m/1", "I stop.", (), {"seed": 1, "stages": stages})
    assert unusable(thoughtful) == ""
    assert decodings([thoughtful]) == [{"seed": 1}]
    endless = Response("r", 1, "m", "m/1", "", (), {"stages": ["x" * (1 << 20)]})
    assert "more than 1048576" in unusable(endless)
