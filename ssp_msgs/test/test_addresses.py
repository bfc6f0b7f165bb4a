"""Addresses of hosts: what people may write, and the reason why a host has none."""

from __future__ import annotations

import socket

import pytest

from ssp_core.addresses import host_and_port, resolve
from ssp_core.errors import HostError
from ssp_core.names import iso_body, udp_body


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("a.example:9", ("a.example", 9)),
        ("10.0.0.5", ("10.0.0.5", None)),
        ("[fe80::1]:65535", ("fe80::1", 65535)),
        ("[::ffff:10.0.0.5]", ("::ffff:10.0.0.5", None)),
        ("", None),
        (":9", None),
        ("::1", None),
        ("[a.example]", None),
        ("a b:9", None),
        ("a/b", None),
        ("me@a:9", None),
        ("a:b", None),
        ("a:123456", None),
    ],
)
def test_a_host_may_have_a_port(text: str, found: tuple[str, int | None] | None) -> None:
    assert host_and_port(text) == found
    port = None if found is None else found[1]
    # Bodies are addressed by the same rule; one of them has a port of its own.
    assert udp_body(f"udp://{text}") == (found if port is not None else None)
    assert (iso_body(f"iso22133://{text}") or (None,) * 3)[:2] == (found or (None, None))
    assert udp_body(text) is iso_body(text) is None


@pytest.mark.parametrize("host", ["a..b", "x" * 64 + ".example"])
def test_a_name_that_no_host_can_have_is_refused_in_words_for_people(host: str) -> None:
    with pytest.raises(HostError) as caught:
        resolve(host, 9, socket.SOCK_DGRAM)
    assert str(caught.value) == f"{host!r} is no name of a host"


def test_a_host_without_an_address_is_named_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(HostError) as caught:
        resolve("nohost.invalid", 9, socket.SOCK_DGRAM)
    assert str(caught.value) == "'nohost.invalid' has no address: Name or service not known"
