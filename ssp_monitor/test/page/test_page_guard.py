"""The admission to the page: hosts, origins, tokens, and the number of clients at once."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_monitor.page.access import (
    AccessRules,
    TokenBucket,
    bearer,
    is_loopback,
    make_token,
    same_token,
)

HERE = AccessRules("127.0.0.1", 8080, "t" * 20)
OPEN = AccessRules("0.0.0.0", 8080, "t" * 20, ("tower", "tower.track.lan"))


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8080", "localhost:8080", "[::1]:8080", "127.1.2.3:8080"]
)
def test_own_names_are_known(host):
    assert HERE.knows_host(host)


@pytest.mark.parametrize(
    "host",
    [
        None,
        "",
        "127.0.0.1",  # port 80
        "127.0.0.1:8081",
        "evil.example:8080",  # a name that was made to point here
        "localhost.evil.example:8080",
        "10.0.0.5:8080",
        "127.0.0.1:8080/x",
        "user@127.0.0.1:8080",
        "127.0.0.1:x",
        "[::1",
        "127.0.0.1:8080#a",
    ],
)
def test_other_hosts_are_not(host):
    assert not HERE.knows_host(host)


def test_a_page_for_others_is_addressed_by_number_or_by_its_own_name():
    assert all(map(OPEN.knows_host, ("10.0.0.5:8080", "tower:8080", "tower.track.lan:8080")))
    assert not any(map(OPEN.knows_host, ("evil.example:8080", "10.0.0.5:9", "tower")))
    assert HERE.open_to_read
    assert not OPEN.open_to_read


@pytest.mark.parametrize(
    ("origin", "site", "known"),
    [
        (None, None, True),  # a program
        ("http://127.0.0.1:8080", "same-origin", True),
        ("http://127.0.0.1:8080", "cross-site", False),
        ("http://127.0.0.1:9090", None, False),
        ("https://127.0.0.1:8080", None, False),
        ("null", None, False),
        ("", None, False),
        (None, "cross-site", False),
        (None, "same-site", False),
        (None, "none", True),
    ],
)
def test_origins(origin, site, known):
    assert HERE.knows_origin(origin, "127.0.0.1:8080", site) is known


@given(st.text(max_size=60))
def test_no_host_makes_it_raise(host):
    HERE.knows_host(host)
    OPEN.knows_host(host)


@given(st.text(max_size=40))
def test_only_the_token_is_the_token(given_token):
    token = make_token()
    assert not same_token(given_token, token)
    assert same_token(token, token)


def test_tokens_differ_and_are_long():
    made = {make_token() for _ in range(100)}
    assert len(made) == 100
    assert all(len(token) >= 32 for token in made)


@pytest.mark.parametrize(
    ("header", "token"),
    [(None, ""), ("", ""), ("Bearer abc", "abc"), ("bearer  abc ", "abc"), ("Basic abc", "")],
)
def test_bearer(header, token):
    assert bearer(header) == token


@pytest.mark.parametrize(
    ("host", "own"),
    [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("::", False)],
)
def test_loopback(host, own):
    assert is_loopback(host) is own


def test_a_bucket_lets_a_burst_pass_and_then_its_rate():
    bucket = TokenBucket(3, 2)
    assert [bucket.take(0) for _ in range(5)] == [True, True, True, False, False]
    assert [bucket.take(500_000_000) for _ in range(2)] == [True, False]
    assert [bucket.take(60_000_000_000) for _ in range(5)] == [True, True, True, False, False]
    assert not bucket.take(0)  # a clock that goes back gives nothing
