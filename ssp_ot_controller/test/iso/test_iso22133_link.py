"""The control centre's connection to an object, over loopback."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress

import pytest

from ssp_core.errors import HostError
from ssp_ot_controller.bodies.iso22133 import link as link_module
from ssp_ot_controller.bodies.iso22133.framing import SYNC, Item, Reason, RejectedBytes, frames_of
from ssp_ot_controller.bodies.iso22133.link import Link, ReceivedMessage
from ssp_ot_controller.bodies.iso22133.messages import (
    DecodedMessage,
    Grem,
    Heab,
    Message,
    MessageId,
    Opaque,
    Ostm,
    encode,
)
from tests.support.iso22133.messages import MONR, ObjectSockets, message_of
from tests.support.processes.waiting import until

ANSWER = Grem(0, 7, 2, 1)
GREM = encode(ANSWER, transmitter_id=5)
ARM = Ostm(2)
S = 1_000_000_000


@pytest.fixture
def peer() -> Iterator[ObjectSockets]:
    with ObjectSockets() as sockets:
        yield sockets


class Time:
    """A clock that is set."""

    now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


@pytest.fixture
def clock() -> Time:
    return Time()


@pytest.fixture
def tapped() -> list[tuple[bool, bytes]]:
    return []


@pytest.fixture
def link(peer: ObjectSockets, clock: Time, tapped: list[tuple[bool, bytes]]) -> Iterator[Link]:
    def tap(sent: bool, stamp_ns: int, data: bytes) -> None:
        assert stamp_ns > 1_700_000_000 * S
        tapped.append((sent, data))

    made = Link(peer.host, peer.port, tap, monotonic_ns=clock)
    yield made
    made.close()


def connected(link: Link, peer: ObjectSockets) -> socket.socket:
    """The object's end of a new connection."""
    link.connect()
    until(lambda: not link.poll() and link.connected, "connection")
    assert link.problem == ""
    end, _ = peer.tcp.accept()
    end.settimeout(60.0)
    return end


def come(link: Link, count: int = 1) -> list[ReceivedMessage]:
    """So many messages that the link gives, and no more."""
    found: list[ReceivedMessage] = []

    def enough() -> bool:
        found.extend(link.poll())
        return len(found) >= count

    until(enough, f"{count} messages")
    assert len(found) == count
    return found


def messages(received: list[ReceivedMessage]) -> list[Message]:
    return [r.outcome.message for r in received if isinstance(r.outcome, DecodedMessage)]


def receive(end: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        part = end.recv(size - len(data))
        assert part, f"closed after {len(data)} of {size} bytes"
        data += part
    return data


def gone(link: Link) -> bool:
    link.poll()
    return not link.connected


# -- what goes out --------------------------------------------------------------------------------


def test_messages_go_their_ways_with_one_counter(link: Link, peer: ObjectSockets) -> None:
    with connected(link, peer) as end:
        link.transmitter_id, link.receiver_id = 3, 5
        headers = [link.send(ARM, acknowledge=True), link.send(Heab(0, 1)), link.send(ARM)]
        assert [(h.counter, h.message_id, h.acknowledge) for h in headers] == [
            (0, 3, True),
            (1, 5, False),
            (2, 3, False),
        ]
        frames = frames_of(receive(end, 2 * len(encode(ARM))))
        assert [f.header for f in frames if not isinstance(f, RejectedBytes)] == headers[::2]
        assert {(h.transmitter_id, h.receiver_id) for h in headers} == {(3, 5)}
        assert message_of(peer.udp.recv(100)) == Heab(0, 1)


def test_messages_are_not_held_back_to_be_sent_together(link: Link, peer: ObjectSockets) -> None:
    with connected(link, peer):
        (tcp, _) = link.sockets
        assert tcp.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_bytes_wait_while_the_object_reads_nothing(link: Link, peer: ObjectSockets) -> None:
    with connected(link, peer) as end:
        # Both ends take little, so that few bytes are more than the sockets hold.
        link.sockets[0].setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        count = 4_000
        for _ in range(count):
            link.send(ARM)
        got = bytearray()
        size = count * len(encode(ARM))
        end.setblocking(False)

        def all_here() -> bool:
            link.poll()
            with suppress(BlockingIOError):
                got.extend(end.recv(1 << 20))
            return len(got) >= size

        assert not all_here(), "the sockets took all of it: nothing waited"
        until(all_here, "bytes")
        frames = [f for f in frames_of(bytes(got)) if not isinstance(f, RejectedBytes)]
        assert [f.header.counter for f in frames] == [n % 256 for n in range(count)]


def test_an_object_that_never_reads_is_given_up(
    link: Link, peer: ObjectSockets, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_module, "QUEUE_BYTES", 1000)
    large = Opaque(MessageId.MOMA, (Item(1, bytes(60_000)),))
    with connected(link, peer):
        for _ in range(1000):
            link.send(large)
        assert not link.connected
        assert link.problem == "takes no bytes, more than 1000 wait"


# -- what comes in --------------------------------------------------------------------------------


def test_a_message_that_comes_byte_by_byte_is_one(link: Link, peer: ObjectSockets) -> None:
    with connected(link, peer) as end:
        end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for at in range(len(GREM)):
            end.sendall(GREM[at : at + 1])
            assert at == len(GREM) - 1 or not link.poll()
        (received,) = come(link)
        assert (received.udp, received.data) == (False, GREM)
        assert messages([received]) == [ANSWER]


def test_after_damage_the_next_message_is_taken(link: Link, peer: ObjectSockets) -> None:
    damaged = GREM[:-1] + bytes([GREM[-1] ^ 1])
    with connected(link, peer) as end:
        end.sendall(damaged + GREM)
        lost, received = come(link, 2)
        assert isinstance(lost.outcome, RejectedBytes)
        assert lost.outcome.reason is Reason.CHECKSUM
        assert lost.data == (damaged + GREM)[: len(lost.data)]
        assert messages([received]) == [ANSWER]


def test_a_damaged_length_holds_messages_up_for_half_a_second(
    link: Link, peer: ObjectSockets, clock: Time
) -> None:
    long = SYNC + (4000).to_bytes(4, "little") + GREM[6:]
    with connected(link, peer) as end:
        end.sendall(long + GREM)
        tcp = link.sockets[0]
        until(lambda: len(tcp.recv(1000, socket.MSG_PEEK)) == len(long + GREM), "bytes")
        assert link.poll() == []
        clock.now_ns += S // 2
        assert link.poll() == []
        clock.now_ns += 1
        lost, received = link.poll()
        assert isinstance(lost.outcome, RejectedBytes)
        assert lost.outcome.reason is Reason.LENGTH
        assert messages([received]) == [ANSWER]


def test_a_message_that_ends_within_half_a_second_is_whole(
    link: Link, peer: ObjectSockets, clock: Time
) -> None:
    with connected(link, peer) as end:
        for piece in (GREM + GREM[:9], GREM[9:] + GREM[:9], GREM[9:]):
            clock.now_ns += S // 2
            end.sendall(piece)
            assert messages(come(link)) == [ANSWER]


def test_datagrams_of_the_object_come_and_those_of_strangers_do_not(
    link: Link, peer: ObjectSockets
) -> None:
    with connected(link, peer), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        link.send(Heab(0, 1))
        _, address = peer.udp.recvfrom(100)
        stranger.sendto(encode(MONR, transmitter_id=9), address)
        peer.udp.sendto(b"noise", address)
        peer.udp.sendto(encode(MONR, transmitter_id=5), address)
        lost, monr = come(link, 2)
        assert (lost.udp, lost.data) == (True, b"noise")
        assert isinstance(monr.outcome, DecodedMessage)
        assert monr.outcome.header.transmitter_id == 5


def test_the_tap_gets_the_bytes_of_both_directions(
    link: Link, peer: ObjectSockets, tapped: list[tuple[bool, bytes]]
) -> None:
    with connected(link, peer) as end:
        link.send(ARM)
        link.send(Heab(0, 1))
        sent = [encode(ARM), encode(Heab(0, 1), counter=1)]
        _, address = peer.udp.recvfrom(100)
        peer.udp.sendto(encode(MONR), address)
        come(link)
        end.sendall(b"noise" + GREM)
        come(link, 2)
        assert tapped == [
            *((True, data) for data in sent),
            (False, encode(MONR)),
            (False, b"noise" + GREM),
        ]


# -- connections ----------------------------------------------------------------------------------


def test_an_object_that_is_gone_is_noticed_and_found_again(link: Link, peer: ObjectSockets) -> None:
    connected(link, peer).close()
    until(lambda: gone(link), "loss")
    assert link.problem == "the object closed the connection"
    assert link.send(ARM).counter == 0
    assert link.poll() == []
    link.send(Heab(0, 2))
    assert message_of(peer.udp.recv(100)) == Heab(0, 2)
    with connected(link, peer) as end:
        link.send(ARM)
        (frame,) = frames_of(receive(end, len(encode(ARM))))
        assert not isinstance(frame, RejectedBytes)
        assert frame.header.counter == 2


def test_half_a_message_of_a_lost_connection_is_forgotten(link: Link, peer: ObjectSockets) -> None:
    with connected(link, peer) as end:
        end.sendall(GREM[:10])
    until(lambda: gone(link), "loss")
    with connected(link, peer) as end:
        end.sendall(GREM)
        assert messages(come(link)) == [ANSWER]


def test_nobody_at_the_port_is_a_problem_and_no_error(link: Link, peer: ObjectSockets) -> None:
    assert (link.connected, link.problem) == (False, "not connected yet")
    peer.tcp.close()
    peer.udp.close()
    link.connect()
    for _ in range(3):
        link.send(Heab(0, 1))
    until(lambda: not link.poll() and link.problem != "still connecting", "refusal")
    assert link.problem == "Connection refused"
    assert not link.connected


def test_an_object_that_does_not_answer_is_given_up_after_two_seconds(
    peer: ObjectSockets, clock: Time
) -> None:
    # A listener whose queue is full answers nobody.
    peer.tcp.listen(0)
    filling = [socket.socket() for _ in range(4)]
    for sock in filling:
        sock.setblocking(False)
        sock.connect_ex((peer.host, peer.port))
    link = Link(peer.host, peer.port, monotonic_ns=clock)
    link.connect()
    clock.now_ns += 2 * S
    assert (link.poll(), link.problem) == ([], "still connecting")
    clock.now_ns += 1
    assert (link.poll(), link.problem) == ([], "no answer within 2 s")
    for sock in filling:
        sock.close()
    link.close()


def test_an_ipv6_address_is_taken() -> None:
    try:
        peer = ObjectSockets("::1")
    except OSError as error:
        pytest.skip(f"no IPv6 here: {error}")
    with peer:
        link = Link("::1", peer.port)
        with connected(link, peer):
            link.send(Heab(0, 1))
            assert message_of(peer.udp.recv(100)) == Heab(0, 1)
        assert link.name == f"[::1]:{peer.port}"
        link.close()
        assert link.sockets == []


@pytest.mark.parametrize(
    ("host", "port", "text"),
    [("127.0.0.1", 1, "from 2 to 65535"), ("no such host", 53241, "no such host:53241")],
)
def test_an_address_that_is_none_is_refused(host: str, port: int, text: str) -> None:
    with pytest.raises(HostError, match=text):
        Link(host, port)
