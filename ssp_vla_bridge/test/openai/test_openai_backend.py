"""The backend ``openai`` with a service that answers: what it asks, records and refuses."""

from __future__ import annotations

import base64
import gzip
import json
import threading
from dataclasses import replace

import cv2
import numpy as np
import pytest

from ssp_core.errors import InputError, PeerError
from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.backend import interface_of, make_backend, respond
from ssp_vla_bridge.backends.openai_chat import OpenAIBackend, read_options, scaled
from ssp_vla_bridge.messages import response_from_json, response_to_json
from ssp_vla_bridge.native_history import stage_text
from ssp_vla_bridge.prompts import PROMPTS, find_stages
from ssp_vla_bridge.window import find_interface

PAIRS = ", ".join(["[4.0, 0.0]"] * 10)
STAGED = ["A car ahead — “slow”.", "1. The car 😀", "I slow down.", PAIRS]
OPTIONS = {"base_url": "http://127.0.0.1:9/v1", "model": "seer-7b"}


def image(width, height):
    picture = np.full((height, width, 3), 90, np.uint8)
    picture[: height // 2] = 200
    return cv2.imencode(".jpg", picture)[1].tobytes()


def test_four_stages_make_one_answer(service, make_openai, make_request):
    service.answers = STAGED
    answer = make_openai().answer(make_request())
    assert answer.text == "\n\n".join(STAGED)
    assert answer.arrays == ()
    response = respond(make_openai(), "seer", make_request()).response
    names = [stage["name"] for stage in response.decoding["stages"]]
    assert names == ["scene", "objects", "intent", "motion"]
    assert [stage_text(response, name) for name in names] == STAGED
    assert [asked.text for asked in service.asked[:4]] == [
        stage.build(make_request(), dict(zip(names, STAGED, strict=True))).text
        for stage in find_stages("openemma")
    ]
    assert "You drive a vehicle" in service.asked[3].body["messages"][0]["content"]
    assert [message["role"] for message in service.asked[0].body["messages"]] == ["user"]


def test_the_answers_motion_is_what_the_adapter_reads(service, make_openai, make_request):
    service.answers = ["Seen: [9, 9], [8, 8].", "[7, 7]", "Now [6, 6]", PAIRS]
    request = make_request()
    response = respond(make_openai(), "seer", request).response
    adapted = adapt(find_interface("openemma").adapter, response, request)
    assert adapted.invalid == ()
    assert adapted.trajectory.t_s[-1] == pytest.approx(5.0)
    assert adapted.trajectory.x_m[-1] == pytest.approx(40.0)


def test_waypoints_go_from_prompt_to_trajectory(service, make_openai, make_request):
    service.answers = ["I keep my speed.\nTrajectory: [[4, 0], [8, 0], [12, 0.1], [16, 0.2]]"]
    request = make_request()
    response = respond(make_openai(interface="waypoints"), "seer", request).response
    adapted = adapt("waypoints", response, request)
    assert adapted.trajectory.t_s == (0.0, 0.5, 1.0, 1.5, 2.0)
    assert adapted.trajectory.x_m == (0.0, 4.0, 8.0, 12.0, 16.0)
    assert len(service.asked) == 1


def test_frames_are_sent_whole_and_in_their_order(service, make_openai, make_request):
    jpegs = [image(128, 72 + 8 * i) for i in range(3)]
    make_openai().answer(make_request(jpegs=jpegs))
    for asked in service.asked:
        heads, data = zip(*(url.split(",", 1) for url in asked.pictures), strict=True)
        assert set(heads) == {"data:image/jpeg;base64"}
        assert [base64.b64decode(one) for one in data] == jpegs
        kinds = [part["type"] for part in asked.body["messages"][-1]["content"]]
        assert kinds == ["image_url"] * 3 + ["text"]


def test_wide_frames_are_scaled_down_where_that_is_asked(service, make_openai, make_request):
    jpegs = [image(640, 360), image(64, 36)]
    answer = make_openai(image_width=320).answer(make_request(jpegs=jpegs))
    sent = [base64.b64decode(url.split(",", 1)[1]) for url in service.asked[0].pictures]
    sizes = [cv2.imdecode(np.frombuffer(one, np.uint8), 1).shape[:2] for one in sent]
    assert sizes == [(180, 320), (36, 64)]
    assert sent[1] == jpegs[1]
    assert answer.decoding["image_width_px"] == 320
    assert scaled(jpegs[0], 640) is jpegs[0]


def test_every_decoding_parameter_is_sent_and_recorded(service, make_openai, make_request):
    extra = {"chat_template_kwargs": {"enable_thinking": False}, "top_k": 1}
    chosen = {
        "temperature": 0.5,
        "seed": 7,
        "top_p": 0.9,
        "presence_penalty": 0.1,
        "frequency_penalty": -0.1,
        "max_tokens": 99,
    }
    answer = make_openai(**chosen, extra=extra).answer(make_request())
    for asked in service.asked:
        sent = {key: value for key, value in asked.body.items() if key != "messages"}
        assert sent == {"model": "seer-7b", "stream": False, **chosen, **extra}
    for key, value in chosen.items():
        assert answer.decoding[key] == value
    assert answer.decoding["extra"] == extra
    assert answer.decoding["stream"] is False


def test_the_defaults_are_explicit(service, make_openai, make_request):
    make_openai().answer(make_request())
    sent = {key: value for key, value in service.asked[0].body.items() if key != "messages"}
    assert sent == {
        "model": "seer-7b",
        "stream": False,
        "temperature": 0,
        "seed": 0,
        "top_p": 1,
        "presence_penalty": 0,
        "frequency_penalty": 0,
        "max_tokens": 1024,
    }


def test_null_leaves_a_parameter_out(service, make_openai, make_request):
    answer = make_openai(seed=None, max_tokens=None).answer(make_request())
    assert not {"seed", "max_tokens"} & service.asked[0].body.keys()
    assert (answer.decoding["seed"], answer.decoding["max_tokens"]) == (None, None)


def test_the_record_says_how_each_stage_came(service, make_openai, make_request):
    request = make_request()
    answer = make_openai().answer(request)
    decoding = json.loads(json.dumps(answer.decoding, allow_nan=False))
    for stage, said in zip(find_stages("openemma"), decoding["stages"], strict=True):
        texts = {"scene": "Answer 1.", "objects": "Answer 2.", "intent": "Answer 3."}
        assert said["prompt_sha256"] == stage.build(request, texts).sha256
        assert said["model_reported"] == "seer-7b"
        assert said["system_fingerprint"] == "fp_1"
        assert said["finish_reason"] == "stop"
        assert said["usage"] == {
            "prompt_tokens": 900,
            "completion_tokens": 20,
            "total_tokens": 920,
        }
        assert said["latency_s"] >= 0
        assert said["tries"] == 1
    assert decoding["notes"] == []
    response = respond(make_openai(), "seer", request).response
    assert response_from_json(response_to_json(response)) == response


def test_an_answer_depends_on_its_request_only(service, make_openai, make_request):
    service.answers = STAGED
    backend = make_openai()
    first = respond(backend, "m", make_request()).response
    plain = respond(backend, "m", make_request(stamp_ns=11_000_000_000)).response
    carried = replace(make_request(stamp_ns=11_000_000_000), previous=first)
    told = respond(backend, "m", carried).response
    texts = [asked.text for asked in service.asked]
    assert texts[4:8] == texts[0:4]
    assert "1.0 s ago your intent was:\nI slow down.\n" in texts[10]
    assert plain.decoding["previous_intent_sha256"] is None
    assert told.decoding["previous_intent_sha256"].startswith("sha256:")
    hashes = [r.decoding["prompt_sha256"] for r in (first, plain, told)]
    assert hashes[0] == hashes[1] != hashes[2]


def reply(make, **headers):
    def talk(service, connection):
        connection.sendall(service.http(make(service), **headers))

    return talk


@pytest.mark.parametrize(
    ("make", "text", "note"),
    [
        (lambda s: s.completion("It slows", "length"), "It slows", "cut off at the limit of tok"),
        (lambda s: s.completion(""), "", "the text is empty"),
        (
            lambda s: s.completion([{"type": "text", "text": "A"}, {"type": "text", "text": "b"}]),
            "Ab",
            "the text came in 2 parts",
        ),
        (
            lambda s: s.completion("Hi", model="seer-7b-2026-01-01"),
            "Hi",
            "the server names another model than was asked for",
        ),
    ],
)
def test_odd_answers_are_kept_and_noted(service, make_openai, make_request, make, text, note):
    service.queue = [reply(make)]
    answer = make_openai(interface="llavida").answer(make_request())
    assert answer.text == text
    (noted,) = answer.decoding["notes"]
    assert noted.startswith(f"motion: {note}")
    assert answer.decoding["stages"][0]["end"] == len(text)


def test_thoughts_that_are_kept_apart_are_recorded_apart(service, make_openai, make_request):
    service.queue = [reply(lambda s: s.completion("I stop.", message_reasoning_content="Hm."))]
    answer = make_openai(interface="llavida").answer(make_request())
    assert answer.text == "I stop."
    assert answer.decoding["stages"][0]["reasoning"] == "Hm."


def test_what_a_server_reports_wrongly_is_not_recorded(service, make_openai, make_request):
    odd = {"usage": {"total_tokens": "9", "prompt_tokens": True}, "system_fingerprint": 3}
    service.queue = [reply(lambda s: s.completion("Hi", model=["x"], **odd))]
    stage = make_openai(interface="llavida").answer(make_request()).decoding["stages"][0]
    assert (stage["usage"], stage["system_fingerprint"], stage["model_reported"]) == (None,) * 3


def test_a_second_response_answers_no_later_question(service, make_openai, make_request):
    """A service sends one more response than it was asked for, over the same connection."""

    def talk(service, connection):
        one, stray = service.completion("One."), service.completion("Stray.", id="chatcmpl-9")
        connection.sendall(service.http(one) + service.http(stray))

    service.queue = [talk] * 4
    assert make_openai().answer(make_request()).text == "\n\n".join(["One."] * 4)


def test_a_compressed_answer_is_read(service, make_openai, make_request):
    def make(service):
        return gzip.compress(json.dumps(service.completion("Hi")).encode())

    service.queue = [reply(make, Content_Encoding="gzip")]
    assert make_openai(interface="llavida").answer(make_request()).text == "Hi"


def test_a_later_stage_that_fails_fails_the_answer(service, make_openai, make_request):
    ok = reply(lambda s: s.completion("Fine."))
    service.queue = [ok, ok, reply(lambda s: s.completion(None))]
    response = respond(make_openai(), "m", make_request()).response
    assert "stage intent: the answer holds no text" in response.error_msg
    assert (response.text, response.decoding) == ("", {})
    assert len(service.asked) == 3


@pytest.mark.parametrize("reason", ["length", "MAX_TOKENS"])
def test_what_the_limit_ends_before_any_text_is_an_empty_answer(
    service, make_openai, make_request, reason
):
    """It is the model's, and is kept (METHOD 5.4b): asked again, it ends in the same way."""
    service.queue = [reply(lambda s: s.completion(None, reason))]
    response = respond(make_openai(interface="waypoints"), "m", make_request()).response
    assert not response.error_code
    assert response.text == ""
    assert "motion: the text is empty; give a larger max_tokens" in response.decoding["notes"]


def test_one_answer_at_a_time(service, make_openai, make_request):
    """A second thread's answer begins when the first one's is whole."""
    backend = make_openai(interface="llavida")
    begun, go = threading.Event(), threading.Event()

    def slowly(service, connection):
        begun.set()
        go.wait(600)
        connection.sendall(service.http(service.completion("First.")))

    service.queue = [slowly]
    texts = []
    threads = [
        threading.Thread(target=lambda: texts.append(backend.answer(make_request()).text))
        for _ in range(2)
    ]
    threads[0].start()
    assert begun.wait(600)
    threads[1].start()
    threads[1].join(0.2)
    assert len(service.asked) == 1
    go.set()
    for thread in threads:
        thread.join(600)
    assert texts == ["First.", "Answer 2."]


def test_waiting_for_ones_turn_ends_with_ones_time(make_openai, make_request):
    backend = make_openai(timeout_s=0.1)
    with backend._turn, pytest.raises(PeerError, match=r"waited 0\.1 s for the answer before"):
        backend.answer(make_request())


# Options.


@pytest.mark.parametrize("interface", PROMPTS)
def test_the_interface_is_the_backends(interface):
    backend = make_backend("openai", {**OPTIONS, "interface": interface})
    assert isinstance(backend, OpenAIBackend)
    assert backend.interface == interface == interface_of("openai", {"interface": interface})
    assert backend.model_id == "seer-7b"


def test_the_default_interface_is_openemmas():
    assert make_backend("openai", OPTIONS).interface == interface_of("openai", {}) == "openemma"


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"base_url": None}, "base_url: is missing"),
        ({"model": " "}, "model: is missing"),
        ({"model": 7}, "model: must be of type str"),
        ({"modle": "x"}, "modle: is no option of openai"),
        ({"modle": None}, "modle: is no option of openai"),
        ({"interface": "alpamayo"}, "interface: has no prompt"),
        ({"temperature": -0.1}, r"temperature: must lie in \[0, 2\]"),
        ({"temperature": float("nan")}, "temperature: must lie in"),
        ({"temperature": True}, "temperature: must be of type float"),
        ({"seed": 0.5}, "seed: must be of type int"),
        ({"top_p": 1.1}, "top_p: must lie in"),
        ({"max_tokens": 0}, "max_tokens: must lie in"),
        ({"timeout_s": 0}, "timeout_s: must lie in"),
        ({"timeout_s": float("inf")}, "timeout_s: must lie in"),
        ({"tries": 0}, "tries: must lie in"),
        ({"image_width": 4}, "image_width: must lie in"),
        ({"extra": []}, "extra: must be of type dict"),
        ({"extra": {"seed": 1}}, r"extra\.seed: is no extra parameter; it is an option of its own"),
        ({"extra": {"stream": True}}, r"extra\.stream: .*; it is set by the bridge"),
        ({"extra": {"n": 2}}, r"extra\.n: "),
        ({"extra": {"x": float("nan")}}, "extra: is no JSON"),
        ({"base_url": "localhost:8000"}, "base_url: is no address"),
        ({"base_url": "ftp://x/v1"}, "base_url: is no address"),
        ({"base_url": "http://[::1"}, "base_url: is no address"),
        ({"api_key_env": "NO_SUCH_KEY"}, "the environment has no NO_SUCH_KEY"),
    ],
)
def test_wrong_options_are_named(changes, what):
    with pytest.raises(InputError, match=what):
        make_backend("openai", {**OPTIONS, **changes})


@pytest.mark.parametrize(
    "url", ["http://me:hunter22@x/v1", "http://hunter22@x/v1", "http://x/v1?key=hunter22"]
)
def test_an_address_with_a_secret_is_refused_and_not_shown(url):
    with pytest.raises(InputError, match="api_key_env") as refused:
        read_options({**OPTIONS, "base_url": url})
    assert "hunter22" not in str(refused.value)


@pytest.mark.parametrize("key", ["", "  ", "two words", "line\nbreak", "schlüssel"])
def test_a_key_that_no_header_carries_is_refused_and_not_shown(key, monkeypatch):
    monkeypatch.setenv("SEER_KEY", key)
    with pytest.raises(InputError, match="SEER_KEY") as refused:
        read_options({**OPTIONS, "api_key_env": "SEER_KEY"})
    assert not key.strip() or key.strip() not in str(refused.value)


def test_a_line_break_behind_a_key_is_a_shells_and_no_part_of_it(monkeypatch):
    monkeypatch.setenv("SEER_KEY", "abc-123\n")
    assert read_options({**OPTIONS, "api_key_env": "SEER_KEY"}).key == "abc-123"


@pytest.mark.parametrize("changes", [{"model": "x-hunter22-y"}, {"extra": {"user": "hunter22"}}])
def test_a_key_among_the_recorded_options_is_refused(changes, monkeypatch):
    monkeypatch.setenv("SEER_KEY", "hunter22")
    given = {**OPTIONS, "api_key_env": "SEER_KEY", **changes}
    with pytest.raises(InputError, match="leave the key to the environment") as refused:
        read_options(given)
    assert "hunter22" not in str(refused.value)
