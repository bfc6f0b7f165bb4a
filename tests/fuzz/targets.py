"""The fuzzed functions: of bytes, and raising nothing but what their reader documents."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import answers
import extraction
import seeds
from rosbags.serde import SerdeError

from ssp_core.bag.reading.mcap_file import DAMAGE
from ssp_core.bag.types import TypeDefinition, definition, store_from, typestore
from ssp_core.cdr.messages import leading_stamp_ns, peek_stamp_ns
from ssp_core.cdr.references import decode_ack, decode_reference
from ssp_core.cdr.states import decode_state, decode_states, find_state
from ssp_core.cdr.steps import (
    decode_command,
    decode_commands,
    decode_done,
    decode_heartbeat,
    decode_tick,
    decode_tick_head,
)
from ssp_core.errors import InputError


@dataclass(frozen=True, slots=True)
class Target:
    """One target.

    Args:
        run: takes the input; an exception is a finding.
        seeds: makes the inputs to begin with.
        most_bytes: of an input.
    """

    run: Callable[[bytes], None]
    seeds: Callable[[], Iterator[bytes]]
    most_bytes: int


DECODERS: tuple[Callable[[bytes], object], ...] = (
    decode_state,
    decode_states,
    decode_tick,
    decode_tick_head,
    decode_command,
    decode_commands,
    decode_done,
    decode_heartbeat,
    decode_reference,
    decode_ack,
    leading_stamp_ns,
    peek_stamp_ns,
    lambda data: find_state(data, "ot1"),
)


def wire(data: bytes) -> None:
    """The hand-written codecs, chosen by the first byte."""
    if not data:
        return
    try:
        DECODERS[data[0] % len(DECODERS)](data[1:])
    except ValueError:
        return


def types(data: bytes) -> None:
    """A definition, and a message of that type out of the same bytes."""
    encoding = "ros2idl" if data[:1] and data[0] & 1 else "ros2msg"
    text = data[1:].decode("utf-8", "replace")
    try:
        store = store_from(TypeDefinition("a/msg/B", encoding, text))
        store.deserialize_cdr(b"\0\1\0\0" + data[:200], "a/msg/B")
    except (InputError, SerdeError, *DAMAGE):
        return


_CDR_TYPES = (
    "ssp_msgs/msg/ObjectStates",
    "ssp_msgs/msg/Reference",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/CompressedImage",
    "diagnostic_msgs/msg/DiagnosticArray",
    "tf2_msgs/msg/TFMessage",
    "std_msgs/msg/Float64MultiArray",
)
_STORES = [store_from(definition(t)) for t in _CDR_TYPES if t in typestore().fielddefs]


def cdr(data: bytes) -> None:
    """Messages of usual types by rosbags, as BagReader.decode asks for it."""
    if not data:
        return
    place = data[0] % len(_STORES)
    try:
        _STORES[place].deserialize_cdr(data[1:], _CDR_TYPES[place])
    except (SerdeError, *DAMAGE):
        return


TARGETS = {
    "wire": Target(wire, seeds.wire_messages, 1024),
    "types": Target(types, seeds.definitions, 4096),
    "cdr": Target(cdr, seeds.wire_messages, 1024),
    "answer": Target(answers.answer, answers.texts, 4096),
    "response": Target(answers.response, answers.stored, 4096),
    "extract": Target(extraction.text, extraction.texts, 2048),
    "reply": Target(extraction.reply, extraction.replies, 2048),
}
