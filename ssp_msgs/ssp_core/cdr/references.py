"""Reference and ReferenceAck as bytes."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from ssp_core.cdr.codec import (
    ENCAPSULATION,
    align8,
    decoder,
    padded_text,
    read_bool,
    read_count,
    read_header,
    read_stamp,
    read_text,
    stamp_bytes,
    text_bytes,
    u32_bytes,
)
from ssp_core.motion.reference import Points, Reference
from ssp_core.names import MAP_FRAME

_FRAME = padded_text(MAP_FRAME)
_VALUES = 7  # of one point
_POINT_BYTES = 8 * _VALUES
_U16 = struct.Struct("<H")


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """An object target's answer to a reference (ReferenceAck.msg without ROS).

    Args:
        stamp_ns: when the object dealt with it, session time.
        accepted: False: refused.
        error_code: 0, or a REFUSED_* of ReferenceAck.msg.
        error_msg: measured value and limit.
    """

    stamp_ns: int
    reference_id: str
    object_id: str
    accepted: bool
    error_code: int = 0
    error_msg: str = ""


def encode_reference(reference: Reference) -> bytes:
    """Reference.msg, in frame map. Raises ValueError for what its fields can't hold."""
    head = b"".join(
        [
            ENCAPSULATION,
            stamp_bytes(reference.dispatched_ns),
            _FRAME,
            padded_text(reference.reference_id),
            padded_text(reference.object_id),
            padded_text(reference.event_version),
            padded_text(reference.purpose),
            stamp_bytes(reference.execute_at_ns),
            stamp_bytes(reference.expires_at_ns),
            u32_bytes(len(reference.points)),
        ]
    )
    if not len(reference.points):
        return head
    return b"".join([head, bytes(align8(len(head)) - len(head)), reference.row_bytes()])


@decoder
def decode_reference(data: bytes, at: int) -> tuple[Reference, int]:
    """The reference of a Reference.msg, with whatever points it has."""
    dispatched_ns, at = read_header(data, at)
    reference_id, at = read_text(data, at)
    object_id, at = read_text(data, at)
    event_version, at = read_text(data, at)
    purpose, at = read_text(data, at)
    execute_at_ns, at = read_stamp(data, at)
    expires_at_ns, at = read_stamp(data, at)
    count, at = read_count(data, at, _POINT_BYTES)
    columns = np.empty((_VALUES, 0))
    if count:
        at = align8(at)
        if at + count * _POINT_BYTES > len(data):
            raise ValueError(f"{count} points in {len(data) - at} bytes")
        rows = np.frombuffer(data, dtype="<f8", count=count * _VALUES, offset=at)
        columns = rows.reshape(count, _VALUES).T.astype(np.float64, order="C")
        at += count * _POINT_BYTES
    reference = Reference(
        reference_id,
        object_id,
        event_version,
        purpose,
        dispatched_ns,
        execute_at_ns,
        expires_at_ns,
        Points(columns),
    )
    return reference, at


def encode_ack(ack: Acknowledgement) -> bytes:
    """ReferenceAck.msg. Raises ValueError for what its fields can't hold."""
    head = b"".join(
        [
            ENCAPSULATION,
            stamp_bytes(ack.stamp_ns),
            _FRAME,
            padded_text(ack.reference_id),
            text_bytes(ack.object_id),
            b"\1" if ack.accepted else b"\0",
        ]
    )
    head += bytes(-len(head) % 2)
    try:
        head += _U16.pack(ack.error_code)
    except struct.error as error:
        raise ValueError(f"error code {ack.error_code}: {error}") from None
    return head + bytes(-len(head) % 4) + text_bytes(ack.error_msg)


@decoder
def decode_ack(data: bytes, at: int) -> tuple[Acknowledgement, int]:
    """The answer in a ReferenceAck.msg."""
    stamp_ns, at = read_header(data, at)
    reference_id, at = read_text(data, at)
    object_id, at = read_text(data, at)
    accepted, at = read_bool(data, at)
    at += at % 2
    (error_code,) = _U16.unpack_from(data, at)
    error_msg, at = read_text(data, at + _U16.size)
    return Acknowledgement(stamp_ns, reference_id, object_id, accepted, error_code, error_msg), at
