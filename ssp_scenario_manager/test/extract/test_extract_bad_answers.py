"""ssp spec extract against a server that answers badly, slowly and not at all."""

from __future__ import annotations

import copy
import json
import socket
from collections.abc import Callable
from typing import Any

import pytest

from tests.support.models.extraction import GOOD, KEYS, Extraction, Reply, field, status

# The server answers badly.


def say(text: str | None, **message: Any) -> Reply:
    return lambda handler, _: handler.answer(text, **message)


def changed(question: str, change: Callable[[Any], Any]) -> str:
    value = copy.deepcopy(GOOD[question])
    return json.dumps(change(value) or value)


def put(*path: Any) -> Callable[[Any], None]:
    """Sets a value; the last of the path is the value."""

    def change(value: Any) -> None:
        for key in path[:-2]:
            value = value[key]
        value[path[-2]] = path[-1]

    return change


BAD_ROADS = {
    "no JSON": ("I see a road.", "no JSON"),
    "cut off": (json.dumps(GOOD["road"])[:-20], "no JSON"),
    "a list": ("[]", "must be a JSON object"),
    "word outside": (changed("road", put("segment", "value", "wiggly")), "segment.value"),
    "wrong case": (changed("road", put("segment", "value", "Straight")), "segment.value"),
    "number as text": (changed("road", put("segment", "confidence", "0.9")), "segment.confidence"),
    "confidence 1.5": (changed("road", put("segment", "confidence", 1.5)), "segment.confidence"),
    "no evidence": (changed("road", put("segment", "evidence", [])), "segment.evidence"),
    "frame 0": (changed("road", put("segment", "evidence", [0])), "segment.evidence[0]"),
    "frame 9": (changed("road", put("segment", "evidence", [9])), "segment.evidence[0]"),
    "true as frame": (changed("road", put("segment", "evidence", [True])), "segment.evidence[0]"),
    "extra key": (changed("road", put("speed_kmh", field(50))), "speed_kmh"),
    "key missing": (changed("road", lambda v: v.pop("segment") and v), "segment"),
    "words empty": (changed("road", put("permitted_manoeuvres", "value", [])), "manoeuvres.value"),
    "count as word": (changed("road", put("lanes_opposite", "value", "two")), "lanes_opposite"),
    "key twice": ('{"segment": 1, "segment": 1}', "stands twice"),
    "NaN": ('{"segment": NaN}', "NaN is no number"),
    "deep": ("[" * 50_000 + "]" * 50_000, "nested too deeply"),
    "huge number": ('{"segment": ' + "9" * 5000 + "}", "no JSON"),
    "empty": ("", "empty"),
    "null": (None, "empty"),
}


@pytest.mark.parametrize("case", BAD_ROADS)
def test_a_bad_answer_is_asked_for_again_with_what_was_wrong(
    extraction: Extraction, case: str
) -> None:
    text, what = BAD_ROADS[case]
    extraction.server.replies = [say(text)]
    assert extraction.run() == 0
    assert extraction.server.names()[:3] == ["road", "road", "vut"]
    again = extraction.server.asked[1]["messages"]
    assert [message["role"] for message in again] == ["system", "user", "assistant", "user"]
    assert what in again[3]["content"]
    index = json.loads((extraction.store / "index.json").read_text())
    road = next(v for k, v in index["questions"].items() if k.startswith("road"))
    assert [bool(answer["problems"]) for answer in road["answers"]] == [True, False]


def test_three_bad_answers_end_it_and_are_kept(extraction: Extraction) -> None:
    text, what = BAD_ROADS["word outside"]
    extraction.server.replies = [say(text)] * 3
    assert extraction.run() == 1
    error = extraction.error()
    assert "question road: seer-7b gave no usable answer in 3 tries" in error
    assert what in error
    kept = sorted((extraction.store / "answers").iterdir())
    assert len(kept) == 3
    said = json.loads(kept[0].read_bytes())["choices"][0]["message"]["content"]
    assert said == text
    assert not extraction.candidate.exists()
    assert not (extraction.out / "merge_clip.log.jsonl").exists()


def test_fences_and_thoughts_around_an_answer_are_taken_off(extraction: Extraction) -> None:
    road = json.dumps(GOOD["road"])
    extraction.server.replies = [say(f"<think>Hm, {{road}}?</think>\n```json\n{road}\n```\n")]
    assert extraction.run() == 0
    assert extraction.server.names() == list(KEYS)


def test_a_server_that_ignores_the_schema_is_held_to_it_all_the_same(
    extraction: Extraction,
) -> None:
    extraction.server.replies = [say('{"segment": "straight"}')]
    assert extraction.run("--no-schema") == 0
    assert all("response_format" not in request for request in extraction.server.asked)
    assert extraction.server.names()[:2] == ["road", "road"]


def test_contradictions_are_left_to_the_person(extraction: Extraction) -> None:
    """A conflict before its trigger, who comes from the left from the right: C1 and C3 say so."""
    extraction.server.answers["phases"]["conflict"] = field(2)
    extraction.server.answers["target_ot1"]["place"] = field("right_lane")
    assert extraction.run("--json") == 0
    failures = json.loads(extraction.told())["failures"]
    fields = {(failure["check"], failure["field"]) for failure in failures}
    assert ("C3", "events.conflict.start") in fields
    assert ("C1", "participants.ot1.region.place") in fields


def test_an_object_that_nobody_listed_cannot_be_the_initiator(extraction: Extraction) -> None:
    extraction.server.answers["interaction"]["initiator"] = field("ot2")
    assert extraction.run() == 1
    assert "initiator.value" in extraction.error()


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ({"refusal": "I can't look at people."}, "I can't look at people."),
        ({"finish_reason": "content_filter"}, "filtered by the server"),
    ],
)
def test_a_refusal_ends_it_at_once(
    extraction: Extraction, message: dict[str, str], said: str
) -> None:
    extraction.server.replies = [say(None, **message)]
    assert extraction.run() == 1
    error = extraction.error()
    assert "question road" in error
    assert f"declines to answer: {said}" in error
    assert len(extraction.server.asked) == 1


def test_an_answer_cut_off_by_its_length_is_said_so(extraction: Extraction) -> None:
    extraction.server.replies = [say('{"road', finish_reason="length")] * 3
    assert extraction.run() == 1
    assert "cut off at the limit of its length" in extraction.error()


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b'{"choices": []}', "it holds no choices"),
        (b'{"error": {"code": 503, "message": "no slot"}}', "it says: no slot"),
    ],
)
def test_a_reply_that_was_broken_off_is_asked_for_again(
    extraction: Extraction, body: bytes, said: str
) -> None:
    extraction.server.replies = [lambda handler, _: handler.body(body)] * 3
    assert extraction.run() == 1
    assert f"the answer can't be used: {said}" in extraction.error()
    assert len(extraction.server.asked) == 3


@pytest.mark.parametrize("body", [b"<html>It works!</html>", b"{}", b"[]", b"\xff\xfe", b""])
def test_another_service_is_recognised(extraction: Extraction, body: bytes) -> None:
    extraction.server.replies = [lambda handler, _: handler.body(body)]
    assert extraction.run() == 1
    assert "no chat completion" in extraction.error()
    (kept,) = (extraction.store / "answers").iterdir()
    assert kept.read_bytes() == body


@pytest.mark.parametrize(
    ("answers", "what"),
    [
        ({"targets": {"items": []}}, "shows no conflict with the VUT"),
        ({"interaction": {**GOOD["interaction"], "type": field("none")}}, "no identifiable"),
    ],
)
def test_a_clip_without_event_gives_no_candidate_but_a_record(
    extraction: Extraction, answers: dict[str, Any], what: str
) -> None:
    extraction.server.answers.update(answers)
    assert extraction.run() == 1
    assert what in extraction.error()
    assert not extraction.candidate.exists()
    record = extraction.log()[1]
    assert what in record.reason
    assert record.details["version"] is None
    assert record.details["gate"]


def test_a_person_may_state_the_kind(extraction: Extraction) -> None:
    extraction.server.answers["interaction"]["type"] = field("none")
    assert extraction.run("--type", "lead_braking") == 0
    event = extraction.event()
    assert event.interaction.type == "lead_braking"
    assert event.uncertainty["interaction.type"].provenance == "person"


# The server has trouble; how the client meets it is tested with the client.


@pytest.mark.parametrize(
    ("reply", "asked", "what"),
    [
        (status(500), 3, "the server says 500: "),
        (status(429, Retry_After="3600"), 1, "429"),
        (status(400), 1, "--no-schema"),
        (status(401), 1, "--api-key-env"),
        (status(404), 1, "--model must be a name that the server serves"),
    ],
)
def test_trouble_that_stays_is_reported(
    extraction: Extraction, waits: list[float], reply: Reply, asked: int, what: str
) -> None:
    extraction.server.replies = [reply] * 3
    assert extraction.run() == 1
    error = extraction.error()
    assert what in error
    assert extraction.server.url in error
    assert len(extraction.server.asked) == asked
    assert not extraction.candidate.exists()


def test_no_server_at_all(extraction: Extraction, waits: list[float]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound and not listening: connections are refused
        url = f"http://127.0.0.1:{taken.getsockname()[1]}/v1"
        assert extraction.run(url=url) == 1
    error = extraction.error()
    assert f"{url}: the server can't be reached" in error
    assert "(3 tries)" in error
    assert "start it" in error


@pytest.mark.parametrize("url", ["localhost:8000", "ftp://x/v1", "http://", "http://[::1", "nope"])
def test_an_address_that_is_none_is_wrong_usage(extraction: Extraction, url: str) -> None:
    assert extraction.run(url=url) == 2
