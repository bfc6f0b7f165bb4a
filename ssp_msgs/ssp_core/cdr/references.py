"""Reference and ReferenceAck as bytes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssp_core.cdr.codec import ENCAPSULATION, align8, decoder, fields_of, read, read_count, write
from ssp_core.motion.reference import Points, Reference

_REFERENCE = "mttttss"
_ACK = "mtt?Ht"
_VALUES = 7  # of one point
_POINT_BYTES = 8 * _VALUES


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
    """Encode a Reference.msg, in frame map; raise ValueError for what its fields can't hold."""
    values = [
        reference.dispatched_ns,
        reference.reference_id,
        reference.object_id,
        reference.event_version,
        reference.purpose,
        reference.execute_at_ns,
        reference.expires_at_ns,
        len(reference.points),
    ]
    head = ENCAPSULATION + write(_REFERENCE + "I", values)
    if not len(reference.points):
        return head
    return b"".join([head, bytes(align8(len(head)) - len(head)), reference.row_bytes()])


@decoder
def decode_reference(data: bytes, at: int) -> tuple[Reference, int]:
    """Return the reference of a Reference.msg, with whatever points it has."""
    (dispatched_ns, *texts, execute_at_ns, expires_at_ns), at = read(_REFERENCE, data, at)
    count, at = read_count(data, at, _POINT_BYTES)
    columns = np.empty((_VALUES, 0))
    if count:
        at = align8(at)
        if at + count * _POINT_BYTES > len(data):
            raise ValueError(f"{count} points in {len(data) - at} bytes")
        rows = np.frombuffer(data, dtype="<f8", count=count * _VALUES, offset=at)
        columns = rows.reshape(count, _VALUES).T.astype(np.float64, order="C")
        at += count * _POINT_BYTES
    times = (dispatched_ns, execute_at_ns, expires_at_ns)
    return Reference(*[*texts, *times, Points(columns)]), at


def encode_ack(ack: Acknowledgement) -> bytes:
    """Encode a ReferenceAck.msg; raise ValueError for what its fields can't hold."""
    return ENCAPSULATION + write(_ACK, fields_of(ack))


@decoder
def decode_ack(data: bytes, at: int) -> tuple[Acknowledgement, int]:
    """Return the answer in a ReferenceAck.msg."""
    values, at = read(_ACK, data, at)
    return Acknowledgement(*values), at
