"""Streams of ISO 22133: pieces, damage, other versions, and arbitrary bytes."""

from __future__ import annotations

import random
import sys
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_ot_controller.bodies.iso22133.framing import (
    EVIDENCE_BYTES,
    FRAME_BYTES,
    LONGEST_PAYLOAD_BYTES,
    SYNC,
    Frame,
    Header,
    Item,
    Reason,
    RejectedBytes,
    StreamDecoder,
    frames_of,
    items_of,
    pack_frame,
    pack_items,
)
from ssp_ot_controller.bodies.iso22133.messages import (
    DecodedMessage,
    Dreq,
    Dres,
    Grem,
    Heab,
    Message,
    MessageId,
    Opaque,
    Rcmm,
    Traj,
    TrajPoint,
    decode,
    encode,
)
from tests.support.iso22133.messages import (
    MONR,
    messages,
    osem_at,
)


@pytest.mark.parametrize("version", [v for v in range(128) if v != 2])
def test_every_other_version_is_refused(version: int) -> None:
    for acknowledge in (0, 0x80):
        data = bytearray(encode(MONR))
        data[6] = version | acknowledge
        found = frames_of(bytes(data))
        assert not any(isinstance(one, Frame) for one in found)
        assert isinstance(found[0], RejectedBytes)
        assert found[0].reason is Reason.VERSION
        assert f"version {version}," in found[0].text


@given(messages, st.integers(0), st.integers(1, 255))
def test_one_changed_byte_is_never_taken_for_a_message(
    message: Message, place: int, change: int
) -> None:
    data = bytearray(encode(message))
    at = place % len(data)
    data[at] ^= change
    found = [one for one in frames_of(bytes(data)) if isinstance(one, Frame)]
    # The acknowledge request is no part of the version; the checksum covers it like all others.
    assert found == []


# -- streams --------------------------------------------------------------------------------------


def fed(decoder: StreamDecoder, data: bytes, cuts: list[int]) -> list[Frame | RejectedBytes]:
    found: list[Frame | RejectedBytes] = []
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    for start, end in pairwise(edges):
        found += decoder.feed(data[start:end])
    return found


@given(st.lists(messages, max_size=5), st.lists(st.integers(0), max_size=8))
def test_a_stream_in_pieces_is_the_same_messages(sent: list[Message], cuts: list[int]) -> None:
    decoder = StreamDecoder()
    found = fed(decoder, b"".join(map(encode, sent)), cuts)
    frames = [one for one in found if isinstance(one, Frame)]
    assert [one.data for one in frames] == [encode(message) for message in sent]
    assert found == frames
    assert (decoder.waiting_bytes, decoder.skipped_bytes, decoder.rejected.total()) == (0, 0, 0)


@given(st.lists(st.tuples(st.binary(max_size=60), messages), max_size=4), st.binary(max_size=60))
def test_after_damage_the_stream_goes_on(parts: list[tuple[bytes, Message]], last: bytes) -> None:
    """A header that damage makes up may wait for bytes; when these have come, all is found."""
    decoder = StreamDecoder(longest_payload_bytes=2000)
    end = encode(Dreq())
    data = b"".join(junk + encode(message) for junk, message in parts) + last + end
    found = decoder.feed(data)
    while decoder.waiting_bytes:
        found += decoder.resync()
    frames = [one.data for one in found if isinstance(one, Frame)]
    # Junk may hold a frame only by a checksum that fits by accident; none of these does.
    assert [one for one in frames if one in {encode(m) for _, m in parts} | {end}] == frames
    assert len(frames) == len(parts) + 1
    assert decoder.skipped_bytes + sum(map(len, frames)) == len(data)


def test_a_frame_inside_of_a_damaged_one_is_found() -> None:
    inner = encode(Heab(0, 0))
    outer = bytearray(pack_frame(Header(MessageId.MONR), inner))
    outer[-1] ^= 1
    decoder = StreamDecoder()
    found = decoder.feed(bytes(outer))
    lost, whole = found[:2]
    assert isinstance(lost, RejectedBytes)
    assert lost.reason is Reason.CHECKSUM
    assert lost.evidence == bytes(outer[:EVIDENCE_BYTES])
    assert isinstance(whole, Frame)
    assert whole.data == inner


def test_a_length_beyond_the_limit_is_damage_and_holds_nothing_up() -> None:
    long = bytearray(encode(MONR))
    long[2:6] = (LONGEST_PAYLOAD_BYTES + 1).to_bytes(4, "little")
    decoder = StreamDecoder()
    first, second = decoder.feed(bytes(long) + encode(MONR))
    assert isinstance(first, RejectedBytes)
    assert first.reason is Reason.LENGTH
    assert isinstance(second, Frame)


def test_a_length_within_the_limit_holds_up_until_the_caller_gives_it_up() -> None:
    long = bytearray(encode(MONR))
    long[2:6] = LONGEST_PAYLOAD_BYTES.to_bytes(4, "little")
    decoder = StreamDecoder()
    assert decoder.feed(bytes(long) + encode(MONR)) == []
    lost, found = decoder.resync()
    assert isinstance(lost, RejectedBytes)
    assert isinstance(found, Frame)
    assert decoder.skipped_bytes == len(long)
    assert decoder.resync() == []


def test_a_long_loss_is_told_once_and_counted() -> None:
    decoder = StreamDecoder()
    told = [one for _ in range(100) for one in decoder.feed(SYNC + bytes(50))]
    assert len(told) == 1
    assert decoder.rejected[Reason.VERSION] == 100
    assert decoder.skipped_bytes == 5200


# -- arbitrary bytes ------------------------------------------------------------------------------


def mutated(rng: random.Random, data: bytes) -> bytes:
    """Bytes changed, left out, doubled, cut off; half of them with a checksum that fits."""
    out = bytearray(data)
    for _ in range(rng.randrange(1, 5)):
        at = rng.randrange(len(out) + 1)
        kind = rng.randrange(4)
        if kind == 0 and out:
            out[at % len(out)] = rng.choice([0, 1, 0x7E, 0x7F, 0x80, 0xFF, rng.randrange(256)])
        elif kind == 1:
            del out[at : at + rng.randrange(1, 4)]
        elif kind == 2:
            out[at:at] = out[: rng.randrange(20)]
        else:
            del out[at:]
    if rng.random() < 0.5 and len(out) > FRAME_BYTES:
        header = Header(int.from_bytes(out[16:18], "little"))
        return pack_frame(header, bytes(out[18:-2]))
    return bytes(out)


EXAMPLES = [
    encode(MONR),
    encode(osem_at(57.7, 12.8)),
    encode(Traj(1, 2, "name", (TrajPoint(0, 0, 0, 0, 0, 0, 0, 0, 0, 0.1),) * 3)),
    encode(Grem(1, 2, 3, 1, 4, b"abc")),
    encode(Rcmm(1, 3, 0.1, None, 2.0)),
    encode(Dres("vendor", "product", "1.0", "name", 0, 7)),
    encode(Opaque(0xA100, (Item(1, b"x"),))),
]


def test_no_bytes_raise_or_make_the_decoder_grow() -> None:
    rng = random.Random(22133)
    decoder = StreamDecoder()
    for number in range(6000):
        data = rng.randbytes(rng.randrange(80)) if number % 3 == 0 else rng.choice(EXAMPLES)
        if number % 3:
            data = mutated(rng, data)
        for one in [*decoder.feed(data), *frames_of(data)]:
            if isinstance(one, Frame):
                found = decode(one)
                assert isinstance(found, DecodedMessage | RejectedBytes)
                text = found.text if isinstance(found, RejectedBytes) else "".join(found.odd)
                assert len(text) < 5000
            else:
                assert len(one.evidence) <= EVIDENCE_BYTES
        assert decoder.waiting_bytes <= LONGEST_PAYLOAD_BYTES + FRAME_BYTES
    assert sys.getsizeof(decoder._buffer) < 4 * LONGEST_PAYLOAD_BYTES


@given(st.binary(max_size=200))
def test_items_are_read_back_or_rejected(payload: bytes) -> None:
    found = items_of(payload)
    if not isinstance(found, RejectedBytes):
        assert pack_items(found) == payload
