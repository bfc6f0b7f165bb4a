"""ObjectState and ObjectStates as bytes."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import lru_cache

from ssp_core.cdr.codec import (
    ENCAPSULATION,
    START,
    align4,
    align8,
    decoder,
    padded_text,
    raw_text,
    read_count,
    read_header,
    read_text,
    stamp_bytes,
    text_of,
    u32_bytes,
)
from ssp_core.clock import NS_PER_S, time_ns
from ssp_core.motion.state import ObjectState, Size
from ssp_core.names import MAP_FRAME
from ssp_core.vocabulary import ControlState, ObjectClass, Role

_CLASSES, _ROLES, _CONTROL_STATES = tuple(ObjectClass), tuple(Role), tuple(ControlState)
_FRAME = padded_text(MAP_FRAME)
_HEAD = struct.Struct("<iII")  # stamp, length of frame_id
_U32 = struct.Struct("<I")
# sequence, x to yaw_rate, the four extents as they stand, position_std, length of reference_id
_NUMBERS = struct.Struct("<Q6d32sdI")
_SIZE = struct.Struct("<4d")
_ERRORS = struct.Struct("<3d")
_STAMP_BYTES = 8
# Of one object in its life: a thousand a second for 49 days. What is counted of them stays small.
MOST_STATES = 2**32
# A state's fields are put in one by one: its own __init__ takes twice as long, since it is frozen.
_new = object.__new__
_FIELDS = tuple(getattr(ObjectState, field.name).__set__ for field in fields(ObjectState))
# What a state takes at the least.
_LEAST_BYTES = _HEAD.size + 4 + 3 + _NUMBERS.size + _ERRORS.size


@dataclass(frozen=True, slots=True)
class StateArray:
    """States of several objects of one process (ObjectStates.msg without ROS).

    Args:
        stamp_ns: of the newest state, ns.
        source: name of the sending node.
        states: in the order of their ids.
    """

    stamp_ns: int
    source: str
    states: tuple[ObjectState, ...]


@lru_cache(maxsize=512)
def _layout(id_size: int, reference_size: int, phase: int) -> struct.Struct:
    """Return the layout of a state whose texts have these lengths, NUL included.

    Args:
        id_size: bytes of the object's id, NUL included.
        reference_size: bytes of the reference's id, NUL included.
        phase: 0 or 4, the state's distance from START modulo 8.
    """
    codes = START + phase + 8 + len(_FRAME) + 4 + id_size
    numbers = align8(codes + 3)
    reference_end = numbers + _NUMBERS.size + reference_size
    return struct.Struct(
        f"<iI{len(_FRAME)}sI{id_size}sBBB{numbers - codes - 3}xQ11dI{reference_size}s"
        f"{align8(reference_end) - reference_end}x3d"
    )


@lru_cache(maxsize=512)
def _size(extents: bytes) -> Size:
    return Size(*_SIZE.unpack(extents))


def write_state(state: ObjectState, at: int) -> bytes:
    """Return a state as it stands in a message at an offset that is a multiple of 4."""
    object_id, reference_id = raw_text(state.object_id), raw_text(state.reference_id)
    size = state.size
    id_size, reference_size = len(object_id) + 1, len(reference_id) + 1
    try:
        return _layout(id_size, reference_size, (at - START) & 7).pack(
            *divmod(state.stamp_ns, NS_PER_S),
            _FRAME,
            id_size,
            object_id,
            state.object_class,
            state.role,
            state.control_state,
            state.sequence,
            state.x_m,
            state.y_m,
            state.yaw_rad,
            state.speed_mps,
            state.acceleration_mps2,
            state.yaw_rate_radps,
            size.front_m,
            size.rear_m,
            size.width_m,
            size.height_m,
            state.position_std_m,
            reference_size,
            reference_id,
            state.error_longitudinal_m,
            state.error_lateral_m,
            state.error_yaw_rad,
        )
    except struct.error as error:
        raise ValueError(f"state of {state.object_id}: {error}") from None


def read_state(data: bytes, at: int) -> tuple[ObjectState, int]:
    """Return the state at an offset that is a multiple of 4, and the offset behind it."""
    seconds, nanoseconds, frame_size = _HEAD.unpack_from(data, at)
    at = align4(at + _HEAD.size + frame_size)
    object_id, at = text_of(data, at + 4, _U32.unpack_from(data, at)[0])
    classes, role, control_state = data[at], data[at + 1], data[at + 2]
    at = ((at + 6) & ~7) + 4
    numbers = _NUMBERS.unpack_from(data, at)
    sequence, x, y, yaw, speed, acceleration, yaw_rate, extents, std, reference_size = numbers
    if sequence > MOST_STATES:
        raise ValueError(f"state of {object_id}: no object has sent {sequence} states")
    reference_id, at = text_of(data, at + _NUMBERS.size, reference_size)
    at = ((at + 3) & ~7) + 4
    longitudinal, lateral, error_yaw = _ERRORS.unpack_from(data, at)
    try:
        values = (
            object_id,
            _CLASSES[classes],
            _ROLES[role],
            time_ns(seconds, nanoseconds),
            x,
            y,
            yaw,
            speed,
            acceleration,
            yaw_rate,
            _size(extents),
            sequence,
            _CONTROL_STATES[control_state],
            std,
            reference_id,
            longitudinal,
            lateral,
            error_yaw,
        )
    except IndexError:
        raise ValueError(
            f"state of {object_id}: class {classes}, role {role} or control state "
            f"{control_state} is unknown"
        ) from None
    state = _new(ObjectState)
    for setter, value in zip(_FIELDS, values, strict=True):
        setter(state, value)
    return state, at + _ERRORS.size


def encode_state(state: ObjectState) -> bytes:
    """Encode an ObjectState.msg, in frame map.

    Raises:
        ValueError: a number that its field can't hold, or a NUL in a text.
    """
    return ENCAPSULATION + write_state(state, START)


decode_state = decoder(read_state)


def write_states(states: Sequence[ObjectState], at: int) -> list[bytes]:
    """Return an array of states whose length stands at an offset that is a multiple of 4."""
    parts = [u32_bytes(len(states))]
    at += 4
    for state in states:
        part = write_state(state, at)
        at += len(part)
        parts.append(part)
    return parts


def read_states(data: bytes, at: int) -> tuple[tuple[ObjectState, ...], int]:
    """Return an array of states at the next aligned offset, and the offset behind it."""
    count, at = read_count(data, at, _LEAST_BYTES)
    states = []
    for _ in range(count):
        state, at = read_state(data, at)
        states.append(state)
    return tuple(states), at


def find_state(data: bytes, object_id: str) -> ObjectState | None:
    """Return the last state of one object in an ObjectStates.msg; None when it holds none.

    Mostly the others are passed over, which takes a small part of the time of decoding them.

    Raises:
        ValueError: the bytes are no such message, as far as they were looked at.
    """
    id_bytes = raw_text(object_id) + b"\0"
    # In frame map a state's stamp, frame and id stand together, so that its place can be looked up.
    place = data.rfind(_FRAME + _U32.pack(len(id_bytes)) + id_bytes) - _STAMP_BYTES
    # The message's own header looks the same, with the source in the place of the id.
    if place > START and place % 4 == 0:
        with suppress(ValueError, IndexError, struct.error):
            state, _ = read_state(data, place)
            if state.object_id == object_id:
                return state
    states = decode_states(data).states
    return next((state for state in reversed(states) if state.object_id == object_id), None)


def encode_states(array: StateArray) -> bytes:
    """Encode an ObjectStates.msg, in frame map; raise ValueError as encode_state."""
    head = ENCAPSULATION + stamp_bytes(array.stamp_ns) + _FRAME + padded_text(array.source)
    return b"".join([head, *write_states(array.states, len(head))])


@decoder
def decode_states(data: bytes, at: int) -> tuple[StateArray, int]:
    """Return the states of an ObjectStates.msg; one broken state makes all of it invalid."""
    stamp_ns, at = read_header(data, at)
    source, at = read_text(data, at)
    states, at = read_states(data, at)
    return StateArray(stamp_ns, source, states), at
