"""Which answers count: the first one to the open request, and no other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from ssp_core.errors import InputError
from ssp_eval.evaluate.asker import bridge_spec
from ssp_eval.evaluate.controls import LABELS_FILE
from ssp_eval.evaluate.exchange import Exchange
from ssp_eval.evaluate.store import RawStore, new_request_id, request_key
from ssp_vla_bridge.core.request import EgoSample, Frame, Request
from ssp_vla_bridge.core.response import Response

REQUEST = Request("r1", 5_000, (Frame(5_000, b"jpeg"),))
ANSWER = Response("r1", 5_000, "m", "m/1", text="A car is ahead.")


def test_the_first_answer_counts_and_a_second_is_a_duplicate() -> None:
    exchange = Exchange()
    exchange.open(REQUEST)
    assert exchange.take() is None
    exchange.offer(ANSWER)
    exchange.offer(replace(ANSWER, text="No, a truck."))
    reply = exchange.take()
    assert reply is not None
    assert reply.response == ANSWER
    assert exchange.take() is None
    assert exchange.ignored.to_json() == {"late": 0, "duplicate": 1, "unknown": 0}


def test_an_answer_after_the_timeout_is_late_and_hurts_no_later_request() -> None:
    exchange = Exchange()
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
    exchange = Exchange()
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
    exchange = Exchange()
    exchange.open(REQUEST)
    with pytest.raises(ValueError, match="open still"):
        exchange.open(REQUEST)


def test_the_key_is_what_an_answer_depends_on() -> None:
    key = request_key(REQUEST, "m", {})
    assert key == request_key(replace(REQUEST, request_id="r2"), "m", {})
    others = [
        request_key(replace(REQUEST, stamp_ns=5_001), "m", {}),
        request_key(replace(REQUEST, frames=(Frame(5_000, b"other"),)), "m", {}),
        request_key(replace(REQUEST, history=(EgoSample(0, 0, 0, 0, 1, 0),)), "m", {}),
        request_key(replace(REQUEST, task=replace(REQUEST.task, instruction="?")), "m", {}),
        request_key(REQUEST, "n", {}),
        request_key(REQUEST, "m", {"temperature": 0}),
    ]
    assert len({key, *others}) == 7
    first, second = new_request_id(key), new_request_id(key)
    assert first != second
    assert first.split("-")[0] == second.split("-")[0] == key


def test_damage_inside_stored_answers_is_named(tmp_path: Path) -> None:
    store = RawStore(tmp_path)
    store.append(ANSWER)
    raw = tmp_path / "raw.jsonl"
    raw.write_text("{broken\n" + raw.read_text())
    with pytest.raises(InputError, match=r"raw\.jsonl:1"):
        RawStore(tmp_path)


def test_placeholders_of_a_bridge_s_options() -> None:
    spec = bridge_spec("perfect")
    assert spec.options_for("/labels.json", 7) == {
        "labels_file": "/labels.json",
        "clip_start_ns": 7,
    }
    # The key follows the labels' content, wherever they lie.
    assert spec.key_options("sha256:1")["labels_file"] == "sha256:1"
    assert bridge_spec(f'm={{"a": 1, "b": "{LABELS_FILE}"}}').options["a"] == 1
    with pytest.raises(InputError, match="not valid JSON"):
        bridge_spec("m={")
