"""The answers that count: the first one to the open request, and no other."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from ssp_core.errors import InputError
from ssp_eval.evaluate.clients.model_replies import MOST_CHARACTERS, MOST_NUMBERS, Loss
from ssp_eval.evaluate.clients.topic_client import RequestTracker
from ssp_eval.evaluate.store.raw_store import RawStore
from ssp_vla_bridge.messages import ErrorCode, Frame, NativeArray, Request, Response

REQUEST = Request("r1", 5_000, (Frame(5_000, b"jpeg"),))
ANSWER = Response("r1", 5_000, "m", "m/1", text="A car is ahead.")


def test_the_first_answer_counts_and_a_second_is_a_duplicate() -> None:
    exchange = RequestTracker()
    exchange.open(REQUEST)
    assert exchange.take() is None
    exchange.offer(ANSWER)
    exchange.offer(replace(ANSWER, text="No, a truck."))
    reply = exchange.take()
    assert reply is not None
    assert reply.response == ANSWER
    assert exchange.take() is None
    assert exchange.ignored.to_json() == {"late": 0, "duplicate": 1, "unknown": 0}


@pytest.mark.parametrize(
    ("decoding", "code"),
    [
        ({"finish_reason": "abort"}, ErrorCode.BROKEN_OFF),
        ({"stages": [{"finish_reason": "stop"}, {"finish_reason": "error"}]}, ErrorCode.BROKEN_OFF),
        ({"finish_reason": "content_filter"}, ErrorCode.DECLINED),
        ({"finish_reason": "length"}, ErrorCode.NONE),
        ({"finish_reason": "stop"}, ErrorCode.NONE),
    ],
)
def test_the_end_that_another_bridge_states_is_read(decoding: dict, code: ErrorCode) -> None:
    exchange = RequestTracker()
    exchange.open(REQUEST)
    exchange.offer(replace(ANSWER, decoding=decoding))
    reply = exchange.take()
    assert reply is not None
    assert reply.response is not None
    assert reply.response.error_code == code
    assert bool(reply.response.text) == (code == ErrorCode.NONE)
    assert ("finish_reason" in reply.response.error_msg) == (code != ErrorCode.NONE)


def test_an_answer_after_the_timeout_is_late_and_hurts_no_later_request() -> None:
    exchange = RequestTracker()
    exchange.open(REQUEST)
    exchange.give_up()
    exchange.open(replace(REQUEST, request_id="r2"))
    exchange.offer(ANSWER)
    assert exchange.take() is None
    exchange.offer(replace(ANSWER, request_id="r2"))
    assert exchange.take() is not None
    exchange.offer(replace(ANSWER, request_id="somebody else's"))
    assert exchange.ignored.to_json() == {"late": 1, "duplicate": 0, "unknown": 1}


def test_another_stamp_and_an_unreadable_answer_cost_their_record() -> None:
    exchange = RequestTracker()
    exchange.open(REQUEST)
    exchange.offer(replace(ANSWER, stamp_ns=6_000))
    reply = exchange.take()
    assert reply is not None
    assert reply.response is None
    assert "stamped 6000 ns" in reply.reason
    exchange.open(replace(REQUEST, request_id="r2"))
    exchange.offer_unreadable("r2", "decoding is no JSON")
    reply = exchange.take()
    assert reply is not None
    assert "decoding is no JSON" in reply.reason


def test_one_request_at_a_time() -> None:
    exchange = RequestTracker()
    exchange.open(REQUEST)
    with pytest.raises(ValueError, match="open still"):
        exchange.open(REQUEST)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (replace(ANSWER, text="x" * (MOST_CHARACTERS + 1)), "has 1048581 characters"),
        (replace(ANSWER, decoding={"top_p": math.nan}), "decoding is no JSON"),
        (replace(ANSWER, decoding={"words": "x" * MOST_CHARACTERS}), "decoding has"),
        (
            replace(ANSWER, arrays=(NativeArray("t", (1,), (0.0,) * MOST_NUMBERS, "", "", 0, 0),)),
            "has 262145 numbers",
        ),
    ],
    ids=["text", "nan", "decoding", "numbers"],
)
def test_an_answer_that_can_t_be_stored_costs_its_record(answer: Response, why: str) -> None:
    exchange = RequestTracker()
    exchange.open(REQUEST)
    exchange.offer(answer)
    reply = exchange.take()
    assert reply is not None
    assert (reply.response, reply.loss) == (None, Loss.UNUSABLE)
    assert why in reply.reason


def test_damage_inside_stored_answers_is_named(tmp_path: Path) -> None:
    store = RawStore(tmp_path)
    store.append(ANSWER)
    raw = tmp_path / "raw.jsonl"
    raw.write_text("{broken\n" + raw.read_text())
    with pytest.raises(InputError, match=r"raw\.jsonl:1"):
        RawStore(tmp_path)


def test_a_store_outlives_two_kills_in_the_middle_of_a_line(tmp_path: Path) -> None:
    raw = tmp_path / "raw.jsonl"
    for number in range(3):
        store = RawStore(tmp_path)
        store.append(replace(ANSWER, request_id=f"key{number}-1"))
        with raw.open("a") as stream:
            stream.write('{"schema": "ssp.resp')
    found = RawStore(tmp_path)
    assert all(found.find(f"key{number}") is not None for number in range(3))
    assert raw.read_text().count("\n") == 3
