"""The client itself against a service: how much it reads, and when it stops."""

from __future__ import annotations

import gzip
import time
from contextlib import suppress

import pytest

from ssp_core.chat.client import NoAnswer, OpenAIChat, Policy
from ssp_core.chat.transport import FailedRequest, Failure, RawReply, exchange, retry_after_s

MIB = 1 << 20
REQUEST = {"model": "m", "messages": [{"role": "user", "content": [{"type": "text", "text": ""}]}]}

# The first one that is long enough on this machine.
TIMES_S = (0.4, 4.0, 40.0, 400.0)


def ask(service, talk, max_bytes=1000):
    service.queue = [talk]
    return exchange(service.url, "none", REQUEST, 20.0, max_bytes)


def sending(body, status=200, **headers):
    return lambda service, connection: connection.sendall(service.http(body, status, **headers))


def hang(service, connection):
    service.released.wait(600)


def chat(service, **policy):
    return OpenAIChat(service.url, "m", policy=Policy(**policy), sleep=lambda _: None)


@pytest.mark.parametrize("coding", ["", "gzip"])
@pytest.mark.parametrize(("size", "whole"), [(999, True), (1000, True), (1001, False)])
def test_the_limit_is_of_the_uncompressed_answer(service, coding, size, whole):
    body = bytes(size)
    headers = {"Content_Encoding": coding} if coding else {}
    came = ask(service, sending(gzip.compress(body) if coding else body, **headers))
    if whole:
        assert came == RawReply(200, came.headers, body)
    else:
        assert came == FailedRequest(Failure.TOO_LARGE, "the answer is larger than 0 KiB")


@pytest.mark.parametrize("compressed", [False, True])
def test_of_an_error_64_kib_are_read(service, compressed):
    body = b"e" * 5 * MIB
    if compressed:
        came = ask(service, sending(gzip.compress(body), 500, Content_Encoding="gzip"), MIB)
    else:
        came = ask(service, sending(body, 500), MIB)
    assert (came.status, came.body) == (500, b"e" * 65536)


def test_a_bomb_is_never_unpacked(service):
    """64 MiB in 64 KiB: what is unpacked of it is what may be read, and not the rest."""
    import tracemalloc

    bomb = gzip.compress(bytes(64 * MIB), 9)
    tracemalloc.start()
    try:
        came = ask(service, sending(bomb, Content_Encoding="gzip"), MIB)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert came.failure is Failure.TOO_LARGE
    assert peak < 16 * MIB


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("7", 7.0),
        ("0.5", 0.5),
        ("0", 0.0),
        ("-1", None),
        ("inf", None),
        ("nan", None),
        ("Wed, 21 Oct 2026 07:28:00 GMT", None),
        ("", None),
    ],
)
def test_retry_after_is_in_seconds_or_nothing(text, seconds):
    assert retry_after_s({"retry-after": text}) == seconds
    assert retry_after_s({}) is None


@pytest.mark.parametrize(
    ("policy", "request_s"),
    [
        ({"timeout_s": 500.0, "deadline_s": 0.2}, None),
        ({"timeout_s": 500.0}, 0.2),
        ({"timeout_s": 500.0, "deadline_s": 500.0}, 0.2),
        ({"timeout_s": 500.0, "deadline_s": 0.2}, 500.0),
        ({"timeout_s": 0.2, "deadline_s": 500.0}, 500.0),
    ],
)
def test_the_shortest_time_counts(service, policy, request_s):
    service.queue = [hang]
    begun_s = time.monotonic()
    with pytest.raises(NoAnswer, match="no whole answer within"):
        chat(service, **policy).request(REQUEST["messages"], {}, request_s)
    assert time.monotonic() - begun_s < 250.0


def test_all_tries_share_the_deadline(service):
    """Silence that may be asked about again is not, once the time is over."""
    service.queue = [hang] * 3
    with pytest.raises(NoAnswer, match="no whole answer within"):
        chat(service, deadline_s=0.4, retry_lost=True, first_wait_s=0.0).request(
            REQUEST["messages"], {}
        )
    assert len(service.asked) <= 1


@pytest.mark.parametrize("deadline_s", [0.0, -1.0])
def test_nothing_is_asked_once_the_time_is_over(service, deadline_s):
    with pytest.raises(NoAnswer, match="the time for an answer is over"):
        chat(service).request(REQUEST["messages"], {}, deadline_s)
    assert service.asked == []


def test_a_lost_answer_is_asked_for_again_where_that_is_wanted(service):
    for timeout_s in TIMES_S:
        asked = len(service.asked)
        service.queue = [hang]
        # A busy machine's second answer may take longer than the first one is waited for.
        with suppress(NoAnswer):
            reply = chat(service, timeout_s=timeout_s, retry_lost=True).request(
                REQUEST["messages"], {}
            )
            break
    assert reply.tries == 2 == len(service.asked) - asked
    assert f"Answer {len(service.asked)}.".encode() in reply.body
