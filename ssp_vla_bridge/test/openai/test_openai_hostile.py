"""The backend ``openai`` against services that misbehave: one line per case says what comes of it.

outcomes.md beside this file has them as a table.
"""

from __future__ import annotations

import gzip
import json
import re
import socket
from pathlib import Path

import pytest

from ssp_vla_bridge.backend import NoTimeError, NotTakenError, respond
from ssp_vla_bridge.messages import ErrorCode, response_to_json

KEY = "sk-9f8e7d6c5b4a-very-secret"
MIB = 1 << 20


@pytest.fixture(autouse=True)
def _quiet_threads(monkeypatch):
    """Silence the errors of a service's thread whose client leaves: they are expected here."""
    monkeypatch.setattr("socketserver.BaseServer.handle_error", lambda *_: None)


# Times of an answer: on a busy machine the first may be over before the service was asked.
TIMES_S = (0.4, 4.0, 40.0)


def hang(service, connection):
    service.released.wait(600)


def drip_body(service, connection):
    service.drip(connection, b"HTTP/1.1 200 OK\r\nContent-Length: 100000\r\n\r\n")


def drip_headers(service, connection):
    service.drip(connection, b"HTTP/1.1 200 OK\r\nX-Slow: ")


def drip_error(service, connection):
    service.drip(connection, b"HTTP/1.1 500 Oops\r\nContent-Length: 100000\r\n\r\n")


def close_mid_answer(service, connection):
    connection.sendall(b'HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n{"choices": ')
    connection.shutdown(socket.SHUT_RDWR)


def close_before_answer(service, connection):
    connection.shutdown(socket.SHUT_RDWR)


def no_http(service, connection):
    connection.sendall(b"SSH-2.0-OpenSSH_9.6\r\n")


def reply(make, status=200, **headers):
    """Sends what ``make`` makes of the service: bytes, or a value for JSON."""

    def talk(service, connection):
        connection.sendall(service.http(make(service), status, **headers))

    return talk


def raw(data, status=200, **headers):
    return reply(lambda _: data, status, **headers)


def error_status(status, message="trouble", **headers):
    return raw({"error": {"message": message}}, status, **headers)


def endless(service, connection):
    """100 MB without a length said before."""
    connection.sendall(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n")
    for _ in range(100):
        connection.sendall(b"100000\r\n" + b"x" * MIB + b"\r\n")


def bomb(size_mib=256):
    return gzip.compress(bytes(size_mib * MIB), 9)


def twice(service):
    one = json.dumps(service.completion("Yes.")).encode()
    return one + one


def with_choices(choices):
    return reply(lambda service: {**service.completion(""), "choices": choices})


HTML = b"<!DOCTYPE html><html><body>Sign in</body></html>"
NAN = b'{"choices": [{"message": {"content": "x"}, "logprob": NaN}]}'

# What the service does; what comes of it stands in outcomes.md.
SERVICES = {
    "hangs": hang,
    "drips its body": drip_body,
    "drips its headers": drip_headers,
    "drips an error": drip_error,
    "closes mid-answer": close_mid_answer,
    "closes before": close_before_answer,
    "is no HTTP": no_http,
    "answers twice": reply(twice),
    "gives two choices": with_choices([{}, {}]),
    "sends 100 MB": endless,
    "says 100 MB": raw(b"", Content_Length=str(100 * MIB)),
    "sends a bomb": reply(lambda _: bomb(), Content_Encoding="gzip"),
    "sends no gzip": raw(b"plain", Content_Encoding="gzip"),
    "sends brotli": raw(b"x", Content_Encoding="br"),
    "cuts its gzip": raw(gzip.compress(b"{}" * 999)[:-9], Content_Encoding="gzip"),
    "sends NaN": raw(NAN),
    "sends a key twice": raw(b'{"choices": 1, "choices": 2}'),
    "nests deeply": raw(b"[" * 100000),
    "sends HTML": raw(HTML),
    "sends nothing": raw(b""),
    "sends a list": raw(b"[]"),
    "sends no UTF-8": raw(b'{"choices": "\xff"}'),
    "sends an error with 200": raw({"error": {"message": "no slot"}}),
    "sends an error of its own kind": raw({"object": "error", "message": "no slot", "code": 400}),
    "filters with 200": raw({"error": {"code": "content_filter", "message": "held back"}}),
    "moderates nothing": raw({"error": {"code": 503, "message": "moderation is unavailable"}}),
    "sends no choices": with_choices([]),
    "sends null choices": with_choices(None),
    "sends another object": raw({"object": "list", "data": []}),
    "sends no message": with_choices([{"text": "x"}]),
    "sends null": reply(lambda s: s.completion(None)),
    "sends thoughts": reply(lambda s: s.completion([{"type": "thinking", "thinking": "A bus."}])),
    "sends a number": reply(lambda s: s.completion(7)),
    "sends a picture": reply(lambda s: s.completion([{"type": "image_url"}])),
    "sends half a character": raw(b'{"choices":[{"message":{"content":"\\ud83d"}}]}'),
    "sends a NUL": reply(lambda s: s.completion("It\0stops")),
    "refuses": reply(lambda s: s.completion(None, message_refusal="I can't look at people.")),
    "refuses in a part": reply(lambda s: s.completion([{"type": "refusal", "refusal": "No."}])),
    "filters": reply(lambda s: s.completion("", "content_filter")),
    "is another service": raw(b"404 page not found", 404),
    "knows no seed": error_status(400, "no seed"),
    "takes no pictures": error_status(400, "image input is not supported"),
    "has a short memory": error_status(400, "This model's maximum context length is 4096"),
    "has a short model": error_status(
        400, "The prompt (length 9) is longer than the maximum model length of 8. Images count."
    ),
    "counts tokens": error_status(400, "The input token count (9) exceeds the maximum number"),
    "bounds the input": error_status(400, "Range of input length should be [1, 30720]"),
    "takes plain text": error_status(400, "'messages.0.content' must be a string"),
    "finds no eyes": error_status(404, "No endpoints found that support image input"),
    "serves no such model": error_status(400, "The model `qwen2.5-vision` does not exist"),
    "knows no key": error_status(400, "API key not valid. Please pass a valid API key."),
    "wants turns": error_status(400, "Conversation roles must alternate"),
    "filters the question": error_status(
        400, "The prompt triggered the content management policy."
    ),
    "has no moderation": error_status(403, "moderation quota used up, retry later"),
    "wants a key": error_status(401),
    "forbids": error_status(403),
    "wants smaller frames": raw(HTML, 413),
    "stays busy": error_status(429),
    "wants an hour": error_status(429, Retry_After="3600"),
    "is a gateway": error_status(502),
    "stays broken": error_status(500),
    "sends a huge error": raw(b"e" * 5 * MIB, 500),
    "bombs an error": reply(lambda _: bomb(64), 500, Content_Encoding="gzip"),
    "can't see": error_status(500, "image input is not supported"),
    "runs out of memory": error_status(500, "CUDA out of memory while processing image"),
    "redirects": raw(b"", 307, Location="/v1/elsewhere"),
    "says 204": raw(b"", 204),
}


@pytest.fixture(scope="module")
def outcomes():
    """The table beside this file: case, times asked, line; … stands for any end."""
    text = (Path(__file__).parent / "outcomes.md").read_text()
    rows = re.findall(r"^\| ([^|]+) \| (\d) \| `(.*)` \|$", text, re.M)
    return {case: (line, int(asked)) for case, asked, line in rows}


def test_every_outcome_has_its_row(outcomes):
    assert list(outcomes) == list(SERVICES)


# The last word of a model, and what another try may answer.
EXPECTED = {
    "refuses": ErrorCode.DECLINED,
    "refuses in a part": ErrorCode.DECLINED,
    "filters": ErrorCode.DECLINED,
    "sends an error with 200": ErrorCode.BROKEN_OFF,
    "sends an error of its own kind": ErrorCode.BROKEN_OFF,
    "filters with 200": ErrorCode.DECLINED,
    "moderates nothing": ErrorCode.BROKEN_OFF,
    "has no moderation": ErrorCode.BACKEND,
    "filters the question": ErrorCode.DECLINED,
    "is a gateway": ErrorCode.OVERLOAD,
    "sends no choices": ErrorCode.BROKEN_OFF,
    "sends null choices": ErrorCode.BROKEN_OFF,
    "sends another object": ErrorCode.BACKEND,
    "sends null": ErrorCode.BROKEN_OFF,
    "sends thoughts": ErrorCode.BROKEN_OFF,
    "stays broken": ErrorCode.BROKEN_OFF,
    "sends a huge error": ErrorCode.BROKEN_OFF,
    "can't see": ErrorCode.BACKEND,
    "runs out of memory": ErrorCode.BROKEN_OFF,
}


@pytest.mark.parametrize("case", SERVICES)
def test_what_a_service_does_has_its_line(
    service, make_openai, make_request, waits, outcomes, case
):
    line, asked = outcomes[case]
    for timeout_s in TIMES_S if "no whole answer" in line else (60.0,):
        service.asked.clear()
        service.queue = [SERVICES[case]] * 3
        backend = make_openai(timeout_s=timeout_s)
        response = respond(backend, "m", make_request()).response
        if service.asked:
            break
    late = response.error_code == ErrorCode.TIMEOUT
    assert late or response.error_code == EXPECTED.get(case, response.error_code)
    assert response.error_code in set(ErrorCode) - {ErrorCode.NONE, ErrorCode.BAD_REQUEST}
    assert late == ("no whole answer" in line)
    said = response.error_msg.replace(service.url, "ADDRESS")
    assert said.startswith(line[:-1]) if line.endswith("…") else said == line
    assert response.text == ""
    assert len(service.asked) == asked
    assert waits == [1.0, 2.0][: asked - 1]
    # Once it is well again, the same backend goes on.
    service.queue = []
    assert respond(make_openai(), "m", make_request()).response.error_code == ErrorCode.NONE


def test_the_time_is_for_all_stages(service, make_openai, make_request):
    """Three stages answer, the fourth hangs: the answer ends when the option says."""
    said = reply(lambda s: s.completion("Fine."))
    for timeout_s in TIMES_S:
        service.asked.clear()
        service.queue = [said, said, said, hang]
        with pytest.raises(NoTimeError, match="no whole answer within") as caught:
            make_openai(timeout_s=timeout_s).answer(make_request())
        if len(service.asked) == 4:
            break
    assert "stage motion: " in str(caught.value)


def test_no_wait_outlasts_the_answers_time(service, make_openai, make_request, waits):
    service.queue = [error_status(429, Retry_After="30")] * 3
    with pytest.raises(NotTakenError, match="429"):
        make_openai(timeout_s=20.0).answer(make_request())
    assert (waits, len(service.asked)) == ([], 1)


@pytest.mark.parametrize(
    ("talks", "expected"),
    [
        ([error_status(500), error_status(502)], [1.0, 2.0]),
        ([error_status(429, Retry_After="7")], [7.0]),
        ([error_status(429, Retry_After="0")], [0.0]),
        ([error_status(429, Retry_After="soon")], [1.0]),
        ([error_status(503, Retry_After="-3")], [1.0]),
        ([error_status(503, Retry_After="nan")], [1.0]),
        ([error_status(408)], [1.0]),
        ([error_status(409)], [1.0]),
        ([error_status(425)], [1.0]),
    ],
)
def test_trouble_that_passes_is_waited_for(
    service, make_openai, make_request, waits, talks, expected
):
    service.queue = list(talks)
    answer = make_openai().answer(make_request())
    assert waits == expected
    assert len(service.asked) == len(talks) + 4
    assert answer.decoding["stages"][0]["tries"] == len(talks) + 1


def test_nobody_there_is_no_failure_of_the_model(make_openai, make_request, waits):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound and not listening: connections are refused
        backend = make_openai(base_url=f"http://127.0.0.1:{taken.getsockname()[1]}/v1")
        response = respond(backend, "m", make_request()).response
    assert response.error_code == ErrorCode.OVERLOAD
    assert "the server can't be reached" in response.error_msg
    assert "(3 tries); start the server" in response.error_msg
    assert waits == [1.0, 2.0]


@pytest.mark.parametrize(("status", "code"), [(429, ErrorCode.OVERLOAD), (400, ErrorCode.BACKEND)])
def test_a_busy_service_is_told_from_a_broken_one(service, make_openai, make_request, status, code):
    service.queue = [error_status(status)] * 3
    assert respond(make_openai(), "m", make_request()).response.error_code == code


# The key.


@pytest.fixture
def keyed(make_openai, monkeypatch):
    monkeypatch.setenv("SEER_KEY", KEY)
    return lambda **options: make_openai(api_key_env="SEER_KEY", **options)


def echo(status, shape):
    """Gives the Authorization header back, as careless gateways do."""

    def talk(service, connection):
        sent = service.asked[-1].headers["authorization"]
        connection.sendall(service.http(shape(sent), status))

    return talk


ECHOES = {
    "as JSON": lambda sent: {"error": {"message": f"bad header {sent}"}},
    "as text": lambda sent: f"bad header {sent}".encode(),
    "as a detail": lambda sent: {"detail": sent},
    "as a list": lambda sent: [sent, {"headers": {"Authorization": sent}}],
    "cut": lambda sent: f"bad header {sent[:-4]}…".encode(),
    "late": lambda sent: {"error": {"message": "x" * 283 + sent}},
    "at the end of what is looked at": lambda sent: b"x " * 2040 + sent.encode(),
}


@pytest.mark.parametrize("shape", ECHOES)
@pytest.mark.parametrize("status", [400, 401, 500])
def test_an_echoed_key_stands_in_no_message(service, keyed, make_request, caplog, status, shape):
    caplog.set_level(0)
    service.queue = [echo(status, ECHOES[shape])] * 3
    outcome = respond(keyed(), "m", make_request())
    assert f"the server says {status}" in outcome.response.error_msg
    everything = json.dumps(response_to_json(outcome.response)) + outcome.traceback + caplog.text
    for size in (len(KEY), 8):
        assert not any(KEY[i : i + size] in everything for i in range(len(KEY) - size + 1))


def test_an_answer_with_the_key_in_it_is_not_kept(service, keyed, make_request):
    service.queue = [echo(200, lambda sent: service.completion(f"You sent {sent}."))]
    outcome = respond(keyed(), "m", make_request())
    assert "the answer holds the key" in outcome.response.error_msg
    assert KEY not in json.dumps(response_to_json(outcome.response)) + outcome.traceback


def test_a_redirect_gets_neither_key_nor_frames(service, keyed, make_request):
    """The other address is a second service, which must see nothing."""
    from threading import Thread

    with type(service)() as other:
        Thread(target=other.serve_forever, args=(0.01,), daemon=True).start()
        for status in (301, 302, 307, 308):
            service.queue = [raw(b"", status, Location=f"{other.url}/chat/completions")]
            response = respond(keyed(), "m", make_request()).response
            assert f"the server says {status}: it sends on" in response.error_msg
        other.shutdown()
        assert other.asked == []


def test_the_key_goes_to_the_server_and_nowhere_else(service, keyed, make_request):
    backend = keyed()
    outcome = respond(backend, "m", make_request())
    assert {asked.headers["authorization"] for asked in service.asked} == {f"Bearer {KEY}"}
    assert KEY not in json.dumps(response_to_json(outcome.response))
    assert KEY not in repr(vars(backend)["_options"])
    assert backend.model_id == "seer-7b"


def test_nothing_of_the_environment_is_sent(service, make_openai, make_request):
    """Keys, organisations and projects of another service may be set; none is for this one."""
    make_openai().answer(make_request())
    for asked in service.asked:
        assert asked.headers["authorization"] == "Bearer none"
        assert set(asked.headers) == {
            "accept",
            "accept-encoding",
            "authorization",
            "connection",
            "content-length",
            "content-type",
            "host",
            "user-agent",
        }
        assert "not-for-this-server" not in json.dumps([asked.headers, asked.body])
