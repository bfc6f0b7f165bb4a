"""Messages to the page's values: real ones, and bytes that are none."""

from __future__ import annotations

import math
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.bag.types import typestore
from ssp_core.cdr.states import StateArray, encode_states
from ssp_core.clock import NS_PER_S
from ssp_core.safety.codes import SafetyCode
from ssp_monitor.status import messages
from ssp_monitor.status.board import Newest
from tests.support.bags.messages import picture

JPEG = b"\xff\xd8 and the rest"
types = typestore().types


def image(data: bytes, form: str = "jpeg") -> bytes:
    return picture(data, NS_PER_S + 2, form=form)


def test_the_picture_is_passed_on_as_it_is():
    assert messages.jpeg_of(image(JPEG)) == JPEG


@pytest.mark.parametrize("data", [image(b"png", "png"), image(b""), image(JPEG)[:-6], b"", b"\0\1"])
def test_what_is_no_picture_is_refused(data):
    with pytest.raises(ValueError, match=r"JPEG|few|items|encapsulation"):
        messages.jpeg_of(data)


@given(st.binary(max_size=80))
def test_no_bytes_raise_anything_else(data):
    for decode in (messages.jpeg_of, messages.source_of):
        for start in (b"", b"\0\1\0\0"):
            with suppress(ValueError):
                decode(start + data)


def test_the_source_of_an_array():
    assert messages.source_of(encode_states(StateArray(5, "targets_a", ()))) == "targets_a"


def test_newest_decodes_only_the_last_of_each_source_and_tells_of_bad_ones():
    decoded: list[bytes] = []

    def decode(data: bytes) -> tuple[()]:
        decoded.append(data)
        if data == b"bad":
            raise ValueError("no message")
        return ()

    newest = Newest(decode)
    for k in range(100):
        newest.put("a", b"%d" % k, k)
    newest.put("b", b"bad", 7)
    states, problems = newest.take()
    assert decoded == [b"99", b"bad"]
    assert states == [([], 99)]
    assert problems == ["b: no message"]
    assert newest.take() == ([], [])


def test_what_an_operator_does_has_no_measure():
    kind = types["ssp_msgs/msg/SafetyEvent"]
    stamp = types["builtin_interfaces/msg/Time"](sec=3, nanosec=0)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")

    def event(code: SafetyCode, words: str = "") -> messages.Event:
        return messages.safety_event(
            kind(
                header=header,
                code=int(code),
                limit_name="over_speed",
                source="x",
                object_id="ot1",
                measured=9.0,
                limit=8.0,
                unit="m/s",
                reaction="local_stop",
                words=words,
            )
        )

    assert (event(SafetyCode.OVER_SPEED).measured, event(SafetyCode.OVER_SPEED).limit) == (9.0, 8.0)
    assert event(SafetyCode.OVER_SPEED).title == "over speed"
    assert math.isnan(event(SafetyCode.OPERATOR).measured)
    told = event(SafetyCode.OBJECT_CONTRADICTS, "reports 77 while it is to run")
    assert math.isnan(told.measured)
    assert told.text == "reports 77 while it is to run; seen by x, local stop"
