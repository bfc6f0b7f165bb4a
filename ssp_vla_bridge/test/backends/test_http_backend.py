"""A model behind HTTP, against a real socket that does everything a service can do wrong."""

from __future__ import annotations

import gzip
import json
import threading
import time
from dataclasses import replace

import pytest

from ssp_core.errors import InputError
from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.backend import interface_of, make_backend, respond
from ssp_vla_bridge.backends.http import make
from ssp_vla_bridge.messages import ErrorCode
from tests.support.models import scripted_service as wire

KEY = "sk-0123456789abcdef"
# On a busy machine the first time may be over before the service was asked.
TIMES_S = (0.6, 6.0, 60.0)
PATIENT = {"timeout_s": 60.0, "start_s": 60.0}


def response_to(service, request, **options):
    """The response to a request, and the line that it says instead of an answer."""
    with service:
        backend = make({"url": service.url, **PATIENT, **options})
        return respond(backend, "m", request).response


def test_a_good_answer_comes_through_whole(make_request, straight_history):
    seen = []

    def on_answer(exchange):
        seen.append(exchange.request)
        exchange.send(wire.ok(wire.answer(exchange.request, model_id="tested/2")))

    request = make_request(history=straight_history(8.0))
    response = response_to(wire.ScriptedService(on_answer), request)
    assert (response.error_code, response.error_msg) == (0, "")
    assert (response.text, response.model_id) == ("I keep my speed.", "tested/2")
    assert dict(response.decoding) == {"seed": 1}
    assert adapt("waypoints", response).trajectory.x_m == (0.0, 4.0, 8.0)
    assert len(seen) == 1
    assert seen[0]["stamp_ns"] == request.stamp_ns
    assert request.task.instruction in seen[0]["prompt"]
    assert len(seen[0]["history"]) == 21


def drip_head(exchange):
    exchange.drip(b"HTTP/1.1 200 OK\r\nX-Slow: " + b"x" * 100_000)


def drip_body(exchange):
    exchange.send(b"HTTP/1.1 200 OK\r\nContent-Length: 100000\r\n\r\n")
    exchange.drip(b" " * 100_000)


@pytest.mark.parametrize(
    "behave",
    [lambda e: e.ended.wait(600.0), drip_head, drip_body],
    ids=["hangs", "drips its head", "drips its body"],
)
def test_silence_and_drips_end_with_the_deadline(make_request, behave):
    for timeout_s in TIMES_S:
        service = wire.ScriptedService(behave)
        response = response_to(service, make_request(), timeout_s=timeout_s)
        if service.asked:
            break
    assert response.error_code == ErrorCode.TIMEOUT
    assert "no whole answer within" in response.error_msg
    assert service.asked == 1


def body(value, **changes):
    return lambda e: e.send(wire.ok(wire.answer(e.request, **{**value, **changes})))


def raw(status, text, *headers, length=None):
    return lambda e: e.send(wire.http(status, text.encode(), *headers, length=length))


def half(exchange):
    whole = json.dumps(wire.answer(exchange.request)).encode()
    exchange.send(b"HTTP/1.1 200 OK\r\n\r\n" + whole[: len(whole) // 2])


def two_values(exchange):
    whole = json.dumps(wire.answer(exchange.request)).encode()
    exchange.send(wire.http("200 OK", whole + b"\n" + whole))


def gzip_bomb(exchange):
    bomb = gzip.compress(b" " * (100 << 20))
    exchange.send(wire.http("200 OK", bomb, "Content-Encoding: gzip"))


def nan_fact(exchange):
    exchange.send(
        wire.http(
            "200 OK",
            json.dumps(wire.answer(exchange.request, decoding={"p": float("nan")})).encode(),
        )
    )


FINAL = {
    "closes without an answer": (lambda e: None, "closed the connection without an answer"),
    "closes within its answer": (
        raw("200 OK", '{"schema": "ssp', length=5000),
        "closed the connection within its answer",
    ),
    "closes within an answer of no length": (half, "the answer can't be read: is no JSON"),
    "answers twice in one body": (two_values, "goes on after its JSON value"),
    "answers for another id": (body({"request_id": "r0"}), "for another request ('r0')"),
    "announces 100 MB": (raw("200 OK", "{", length=100 << 20), "larger than 16 MiB"),
    "sends HTML": (
        raw("200 OK", "<html><body>Login</body></html>", "Content-Type: text/html"),
        "can't be read (text/html, begins with '<html><body>Login</body></html>')",
    ),
    "sends nothing": (raw("200 OK", ""), "can't be read (no content type, begins with '')"),
    "sends brackets": (raw("200 OK", "[" * 1_000_000), "is nested too deeply"),
    "sends bytes that are no text": (
        lambda e: e.send(wire.http("200 OK", b'{"a": "\xff"}')),
        "is no JSON: 'utf-8' codec",
    ),
    "sends half a character": (body({"text": "\ud800"}), "half of a surrogate pair"),
    "says a key twice": (
        raw("200 OK", '{"text": "a", "text": "b"}'),
        "key 'text' stands twice",
    ),
    "wants a key": (raw("401 Unauthorized", ""), "asks for a key (401); name the environment"),
    "forbids": (raw("403 Forbidden", ""), "asks for a key (403)"),
    "speaks another schema": (
        body({"schema": "ssp.vla_http/9"}),
        "schema must be 'ssp.vla_http/1'",
    ),
    "forgets a field": (
        lambda e: e.send(wire.ok({"schema": "ssp.vla_http/1"})),
        "arrays is missing",
    ),
    "has a field more": (body({"confidence": 1}), "confidence: Unexpected keyword argument"),
    "has a text that is none": (body({"text": ["a"]}), "text: Input should be a valid string"),
    "has an array that is none": (body({"arrays": [{}]}), "arrays[0].name: Field required"),
    "has a fact that is no number": (nan_fact, "decoding: holds a number that isn't finite"),
    "compresses": (gzip_bomb, "/answer is compressed (gzip), unasked"),
    "fails": (
        raw("500 Internal Server Error", '{"error": "CUDA out of memory"}'),
        "/answer says 500: CUDA out of memory",
    ),
    "is busy and doesn't say how long": (raw("503 Service Unavailable", "no"), "says 503: no"),
    "is busy until a date": (
        raw("503 Service Unavailable", "no", "Retry-After: Wed, 21 Oct 2026 07:28:00 GMT"),
        "says 503: no",
    ),
    "speaks something else": (lambda e: e.send(b"SSH-2.0-OpenSSH_9.6\r\n"), "doesn't speak HTTP"),
    "answers with control characters": (
        raw("500 Oops", "\x1b[31mred\r\n\x00text"),
        "says 500: [31mred text",
    ),
}


@pytest.mark.parametrize("name", FINAL)
def test_what_a_service_does_wrong_is_said_in_one_line_and_asked_once(make_request, name):
    behave, words = FINAL[name]
    service = wire.ScriptedService(behave)
    response = response_to(service, make_request())
    assert response.error_code == ErrorCode.BACKEND
    assert words in response.error_msg
    assert service.url in response.error_msg
    assert "\n" not in response.error_msg
    assert (response.text, response.arrays) == ("", ())
    assert service.asked == 1


def test_an_answer_of_100_mb_is_cut_off(make_request):
    sent = []

    def stream(exchange):
        exchange.send(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n\r\n")
        while len(sent) < 100 and exchange.send(b" " * (1 << 20)):
            sent.append(1)

    response = response_to(wire.ScriptedService(stream), make_request())
    assert "larger than 16 MiB" in response.error_msg
    # What was under way in buffers counts as sent; most of it was not.
    assert len(sent) < 60


def test_a_redirect_is_not_followed(make_request):
    with wire.ScriptedService() as other:
        service = wire.ScriptedService(
            raw("307 Temporary Redirect", "", f"Location: {other.url}/answer")
        )
        response = response_to(service, make_request())
        assert f"redirects /answer to {other.url}/answer (307)" in response.error_msg
        assert (service.asked, other.asked, other.heads) == (1, 0, [])


def test_a_second_answer_is_never_the_answer_to_the_next_request(make_request):
    def twice(exchange):
        first = wire.ok(wire.answer(exchange.request, text="first"))
        exchange.send(first + wire.ok(wire.answer(exchange.request, text="second")))

    with wire.ScriptedService(twice) as service:
        backend = make({"url": service.url, **PATIENT})
        for request_id in ("a", "b"):
            response = respond(backend, "m", make_request(request_id)).response
            assert (response.text, response.request_id) == ("first", request_id)
    assert service.asked == 2


@pytest.mark.parametrize("token", ["NaN", "Infinity", "-Infinity", '"nan"'])
def test_a_number_that_is_none_goes_through_raw_and_the_adapter_says_so(make_request, token):
    def on_answer(exchange):
        text = json.dumps(wire.answer(exchange.request)).replace("4.0", token)
        exchange.send(wire.http("200 OK", text.encode()))

    response = response_to(wire.ScriptedService(on_answer), make_request())
    assert response.error_code == 0
    adapted = adapt("waypoints", response)
    assert (adapted.trajectory, adapted.invalid) == (None, ("non_finite",))


@pytest.mark.parametrize("status", ["503 Service Unavailable", "429 Too Many Requests"])
def test_a_busy_service_that_says_when_is_asked_again(make_request, status):
    busy = [True, True]

    def on_answer(exchange):
        if busy:
            busy.pop()
            exchange.send(wire.http(status, b"", "Retry-After: 0"))
        else:
            exchange.send(wire.ok(wire.answer(exchange.request)))

    service = wire.ScriptedService(on_answer)
    assert response_to(service, make_request()).text == "I keep my speed."
    assert service.asked == 3


def test_tries_have_a_bound(make_request):
    service = wire.ScriptedService(raw("503 Busy", "", "Retry-After: 0"))
    response = response_to(service, make_request(), tries=2)
    assert response.error_code == ErrorCode.OVERLOAD
    assert "the service is busy (503), 2 tries" in response.error_msg
    assert service.asked == 2


def test_a_wait_that_is_longer_than_the_time_left_isnt_begun(make_request):
    service = wire.ScriptedService(raw("429 Too Many", "", "Retry-After: 3600"))
    response = response_to(service, make_request())
    assert response.error_code == ErrorCode.OVERLOAD
    assert "the service is busy (429), 1 tries" in response.error_msg
    assert service.asked == 1


def test_a_service_that_goes_away_is_asked_again_until_it_is_back(make_request):
    with wire.ScriptedService() as first:
        backend = make({"url": first.url, **PATIENT, "tries": 2})
        assert respond(backend, "m", make_request()).response.error_code == 0
    response = respond(backend, "m", make_request()).response
    assert response.error_code == ErrorCode.OVERLOAD
    assert "no program listens there (connection refused), 2 tries" in response.error_msg
    response = respond(backend, "m", make_request()).response
    assert "no program listens there (connection refused)" in response.error_msg


def test_a_service_that_isnt_there_yet_costs_requests_and_not_the_bridge(make_request):
    service = wire.ScriptedService()
    backend = make({"url": service.url, "timeout_s": 20.0, "start_s": 0.3, "tries": 1})
    assert backend.model_id == f"http({service.url})"
    response = respond(backend, "m", make_request()).response
    assert response.error_code == ErrorCode.OVERLOAD
    assert "no program listens there" in response.error_msg
    with service:
        assert respond(backend, "m", make_request()).response.model_id == "tested/1"


def test_the_bridge_waits_for_a_service_that_is_loading(make_request):
    asked = []

    def loading(exchange):
        asked.append(exchange)
        ready = len(asked) > 2
        exchange.send(wire.ok({**wire.HEALTHY, "ready": ready, "detail": "loading"}))

    with wire.ScriptedService(on_health=loading) as service:
        backend = make({"url": service.url, "start_s": 20.0})
        assert len(asked) == 3
        assert backend.model_id == "tested/1"
        assert respond(backend, "m", make_request()).response.error_code == 0
        assert len(asked) == 3


@pytest.mark.parametrize(
    ("health", "words"),
    [
        ({**wire.HEALTHY, "ready": False, "detail": "loading"}, "isn't ready yet (loading)"),
        ({**wire.HEALTHY, "ready": 1}, "ready: Input should be a valid boolean"),
        ({"schema": "ssp.vla_http/1"}, "detail is missing"),
        ([], "/health can't be read (no content type, begins with '[]')"),
    ],
)
def test_a_service_that_isnt_well_isnt_asked(make_request, health, words):
    service = wire.ScriptedService(on_health=lambda e: e.send(wire.ok(health)))
    response = response_to(service, make_request(), start_s=0.1)
    assert words in response.error_msg
    assert service.asked == 0


def test_a_key_goes_to_the_service_and_nowhere_else(make_request, monkeypatch):
    monkeypatch.setenv("TESTED_KEY", KEY)

    def on_answer(exchange):
        if f"Authorization: Bearer {KEY}" not in exchange.head:
            exchange.send(wire.http("401 Unauthorized", b""))
        else:
            exchange.send(wire.ok(wire.answer(exchange.request)))

    service = wire.ScriptedService(on_answer)
    response = response_to(service, make_request(), api_key_env="TESTED_KEY")
    assert response.error_code == 0
    assert KEY not in repr(response)
    assert (
        "asks for a key (401); name the environment"
        in response_to(wire.ScriptedService(on_answer), make_request()).error_msg
    )


@pytest.mark.parametrize(
    "behave",
    [
        raw("401 No", f"bad key {KEY}"),
        raw("500 No", json.dumps({"error": f"{'x' * 190}{KEY}"})),
        raw("500 No", "y" * 795 + KEY),
        raw("302 Found", "", f"Location: http://h/{KEY}"),
        raw("200 OK", f"<html>{KEY}"),
        body({"request_id": KEY}),
        body({"schema": "z" * 100 + KEY}),
        body({"text": f"my key is {KEY}"}),
        body({"model_id": KEY}),
        raw("401 No", f"you sent {KEY[:12]}…"),
        body({"decoding": {"headers": {"auth": KEY}}}),
    ],
)
def test_a_service_that_repeats_the_key_gets_it_into_nothing(make_request, monkeypatch, behave):
    monkeypatch.setenv("TESTED_KEY", KEY)
    response = response_to(wire.ScriptedService(behave), make_request(), api_key_env="TESTED_KEY")
    assert response.error_code == ErrorCode.BACKEND
    for length in (8, len(KEY)):
        assert KEY[:length] not in repr(response)


def test_a_key_that_isnt_accepted_is_named_by_its_variable(make_request, monkeypatch):
    monkeypatch.setenv("TESTED_KEY", KEY)
    service = wire.ScriptedService(raw("403 Forbidden", ""))
    response = response_to(service, make_request(), api_key_env="TESTED_KEY")
    assert "(403); the one in TESTED_KEY isn't accepted" in response.error_msg


def test_proxies_of_the_environment_are_not_used_on_loopback(make_request, monkeypatch):
    with wire.ScriptedService() as proxy:
        for name in ("http_proxy", "HTTP_PROXY", "https_proxy", "ALL_PROXY"):
            monkeypatch.setenv(name, proxy.url)
        monkeypatch.delenv("no_proxy", raising=False)
        monkeypatch.delenv("NO_PROXY", raising=False)
        service = wire.ScriptedService()
        assert response_to(service, make_request()).error_code == 0
        assert (service.asked, proxy.heads) == (1, [])


def test_one_request_at_a_time(make_request):
    second = threading.Event()

    def on_answer(exchange):
        second.wait(0.3)  # long enough for the other one to come if it could
        exchange.send(wire.ok(wire.answer(exchange.request)))

    with wire.ScriptedService(on_answer) as service:
        backend = make({"url": service.url, **PATIENT})
        threads = [
            threading.Thread(target=respond, args=(backend, "m", make_request(name)))
            for name in ("a", "b")
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(600.0)
    assert (service.asked, service.most_at_once) == (2, 1)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "backend_options.url: is missing"),
        ({"url": "ftp://h"}, "is no address of HTTP"),
        ({"url": "http://"}, "is no address of HTTP"),
        ({"url": "http://h:99999"}, "is no address"),
        ({"url": "http://h/?key=1"}, "a query or a fragment"),
        ({"url": "http://h\r\nX: 1"}, "is no address"),
        ({"url": "http://h/\r\nX:"}, "is no address of HTTP"),
        ({"url": "http://h", "timeout_s": 0}, "timeout_s: must lie in"),
        ({"url": "http://h", "timeout_s": float("nan")}, "timeout_s: must lie in"),
        ({"url": "http://h", "tries": 0}, "tries: must lie in"),
        ({"url": "http://h", "max_mb": -1}, "max_mb: must lie in"),
        ({"url": "http://h", "interface": "x"}, "unknown interface"),
        ({"url": "http://h", "api_key_env": "NOT_THERE"}, "the environment has no NOT_THERE"),
        ({"url": "http://h", "colour": 1}, "is no option of http"),
    ],
)
def test_wrong_options_are_named(options, words):
    with pytest.raises(InputError) as caught:
        make(options)
    assert words in str(caught.value)


def test_a_password_in_the_address_is_refused_and_not_shown():
    with pytest.raises(InputError) as caught:
        make({"url": f"http://me:{KEY}@host"})
    assert "api_key_env" in str(caught.value)
    assert KEY not in str(caught.value)


def test_a_key_that_can_be_none_is_refused_and_not_shown(monkeypatch):
    for wrong in ("with space in it", "new\nline-of-a-header"):
        monkeypatch.setenv("TESTED_KEY", wrong)
        with pytest.raises(InputError) as caught:
            make({"url": "http://127.0.0.1:9", "api_key_env": "TESTED_KEY"})
        assert wrong not in str(caught.value)
        assert "TESTED_KEY" in str(caught.value)


@pytest.mark.parametrize("name", ["alpamayo", "llavida"])
def test_systems_are_the_http_backend_with_their_own_interface(make_request, name):
    with wire.ScriptedService() as service:
        backend = make_backend(name, {"url": service.url, "start_s": 5.0})
        assert backend.interface == interface_of(name, {}) == name
        request = replace(make_request(), request_id="x")
        assert respond(backend, "m", request).response.request_id == "x"


def test_the_wait_for_a_service_ends(monkeypatch):
    service = wire.ScriptedService(on_health=lambda e: e.ended.wait(600.0))
    with service:
        started_s = time.monotonic()
        make({"url": service.url, "start_s": 0.4})
        # It hangs in its first question, whose time is what is left of the wait.
        assert time.monotonic() - started_s < 300.0
