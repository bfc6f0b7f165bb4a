"""Messages of one step as bytes (WorldTick, ActuatorCommands, StepDone, Heartbeat, Clock), and
what the nodes agree on in lockstep.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from functools import lru_cache

from ssp_core.cdr.codec import (
    ENCAPSULATION,
    START,
    align8,
    decoder,
    padded_text,
    raw_text,
    read_bool,
    read_count,
    read_header,
    read_stamp,
    read_text,
    stamp_bytes,
    u32_bytes,
)
from ssp_core.cdr.states import read_states, write_states
from ssp_core.clock import NS_PER_S
from ssp_core.motion.state import ObjectState
from ssp_core.names import MAP_FRAME
from ssp_core.vocabulary import SessionPhase

_FRAME = padded_text(MAP_FRAME)
_TICK = struct.Struct("<Q??6xQQ")
_STEP_COUNT = struct.Struct("<QI")
_DONE = struct.Struct("<QQB7xQQQ")
_COMMAND = struct.Struct("<QdddB")
_LEAST_COMMAND_BYTES = 8 + 4 + 4 + _COMMAND.size
_U64 = struct.Struct("<Q")


@dataclass(frozen=True, slots=True)
class WorldTick:
    """One step of the simulated world; fields as in WorldTick.msg.

    Args:
        objects: ground truth, in the order of the ids; empty where only the head was decoded.
    """

    stamp_ns: int
    step: int
    running: bool
    lockstep: bool
    heartbeat: int
    vut_states_sent: int
    objects: tuple[ObjectState, ...] = ()


@dataclass(frozen=True, slots=True)
class BodyCommand:
    """What one body is to do; fields as in ActuatorCommand.msg, m/s^2, 1/m, rad."""

    object_id: str
    step: int
    acceleration_mps2: float
    curvature_1pm: float
    heading_rad: float
    emergency_stop: bool


@dataclass(frozen=True, slots=True)
class BodyCommands:
    """What an object_target asks of its bodies for one step; fields as in ActuatorCommands.msg."""

    stamp_ns: int
    participant: str
    step: int
    commands: tuple[BodyCommand, ...]


@dataclass(frozen=True, slots=True)
class StepDone:
    """A participant's answer to one tick; fields as in StepDone.msg."""

    participant: str
    step: int
    heartbeat: int = 0
    session_state: SessionPhase = SessionPhase.UNKNOWN
    states_sent: int = 0
    acks_sent: int = 0
    safety_events_sent: int = 0


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """Sign of life of the manager; fields as in Heartbeat.msg.

    Args:
        sent_ns: when it was sent, on the manager's system clock, ns.
        references_sent: by object id.
    """

    stamp_ns: int
    sender: str
    sequence: int
    sent_ns: int
    session_state: SessionPhase
    references_sent: dict[str, int]


def encode_clock(now_ns: int) -> bytes:
    """rosgraph_msgs/Clock."""
    return ENCAPSULATION + stamp_bytes(now_ns)


def encode_tick(tick: WorldTick) -> bytes:
    """WorldTick.msg, in frame map. Raises ValueError for what its fields can't hold."""
    head = ENCAPSULATION + stamp_bytes(tick.stamp_ns) + _FRAME
    head += bytes(align8(len(head)) - len(head))
    try:
        head += _TICK.pack(
            tick.step, tick.running, tick.lockstep, tick.heartbeat, tick.vut_states_sent
        )
    except struct.error as error:
        raise ValueError(f"tick {tick.step}: {error}") from None
    return b"".join([head, *write_states(tick.objects, len(head))])


def _read_tick(data: bytes, at: int) -> tuple[WorldTick, int]:
    """A tick without its objects, and the offset of these."""
    stamp_ns, at = read_header(data, at)
    at = align8(at)
    step, _, _, heartbeat, vut_states_sent = _TICK.unpack_from(data, at)
    running, _ = read_bool(data, at + 8)
    lockstep, _ = read_bool(data, at + 9)
    tick = WorldTick(stamp_ns, step, running, lockstep, heartbeat, vut_states_sent)
    return tick, at + _TICK.size


@decoder
def decode_tick(data: bytes, at: int) -> tuple[WorldTick, int]:
    """A WorldTick.msg with the true states of all objects."""
    tick, at = _read_tick(data, at)
    objects, at = read_states(data, at)
    return replace(tick, objects=objects), at


@decoder
def decode_tick_head(data: bytes, at: int) -> tuple[WorldTick, int]:
    """A WorldTick.msg without its objects, which aren't looked at."""
    tick, _ = _read_tick(data, at)
    return tick, len(data)


@lru_cache(maxsize=256)
def _command_layout(id_size: int, phase: int) -> struct.Struct:
    """Layout of a command that begins ``phase`` bytes past a multiple of 8, from START."""
    begin = START + phase
    text_end = begin + 8 + len(_FRAME) + 4 + id_size
    return struct.Struct(f"<iI{len(_FRAME)}sI{id_size}s{align8(text_end) - text_end}xQddd?")


def encode_commands(message: BodyCommands) -> bytes:
    """ActuatorCommands.msg, in frame map. Raises ValueError for what its fields can't hold."""
    seconds, nanoseconds = divmod(message.stamp_ns, NS_PER_S)
    head = ENCAPSULATION + stamp_bytes(message.stamp_ns) + _FRAME
    head += padded_text(message.participant)
    head += bytes(align8(len(head)) - len(head))
    try:
        parts = [head, _STEP_COUNT.pack(message.step, len(message.commands))]
        at = len(head) + _STEP_COUNT.size
        for command in message.commands:
            filled = -at % 4
            object_id = raw_text(command.object_id)
            part = _command_layout(len(object_id) + 1, (at + filled - START) & 7).pack(
                seconds,
                nanoseconds,
                _FRAME,
                len(object_id) + 1,
                object_id,
                command.step,
                command.acceleration_mps2,
                command.curvature_1pm,
                command.heading_rad,
                command.emergency_stop,
            )
            parts += [bytes(filled), part]
            at += filled + len(part)
    except struct.error as error:
        raise ValueError(f"commands for step {message.step}: {error}") from None
    return b"".join(parts)


def _read_command(data: bytes, at: int) -> tuple[BodyCommand, int]:
    _, at = read_header(data, at)
    object_id, at = read_text(data, at)
    at = align8(at)
    step, acceleration, curvature, heading, _ = _COMMAND.unpack_from(data, at)
    stop, at = read_bool(data, at + _COMMAND.size - 1)
    return BodyCommand(object_id, step, acceleration, curvature, heading, stop), at


# An ActuatorCommand.msg by itself.
decode_command = decoder(_read_command)


@decoder
def decode_commands(data: bytes, at: int) -> tuple[BodyCommands, int]:
    """The commands of an ActuatorCommands.msg."""
    stamp_ns, at = read_header(data, at)
    participant, at = read_text(data, at)
    at = align8(at)
    (step,) = _U64.unpack_from(data, at)
    count, at = read_count(data, at + 8, _LEAST_COMMAND_BYTES)
    commands = []
    for _ in range(count):
        command, at = _read_command(data, at)
        commands.append(command)
    return BodyCommands(stamp_ns, participant, step, tuple(commands)), at


def encode_done(done: StepDone) -> bytes:
    """StepDone.msg. Raises ValueError for what its fields can't hold."""
    head = ENCAPSULATION + padded_text(done.participant)
    head += bytes(align8(len(head)) - len(head))
    try:
        return head + _DONE.pack(
            done.step,
            done.heartbeat,
            done.session_state,
            done.states_sent,
            done.acks_sent,
            done.safety_events_sent,
        )
    except struct.error as error:
        raise ValueError(f"answer to step {done.step}: {error}") from None


@decoder
def decode_done(data: bytes, at: int) -> tuple[StepDone, int]:
    """The answer in a StepDone.msg."""
    participant, at = read_text(data, at)
    at = align8(at)
    step, heartbeat, session_state, states, acks, events = _DONE.unpack_from(data, at)
    session = SessionPhase(session_state)
    return StepDone(participant, step, heartbeat, session, states, acks, events), at + _DONE.size


def encode_heartbeat(beat: Heartbeat) -> bytes:
    """Heartbeat.msg. Raises ValueError for what its fields can't hold."""
    head = ENCAPSULATION + stamp_bytes(beat.stamp_ns) + _FRAME + padded_text(beat.sender)
    head += bytes(align8(len(head)) - len(head))
    count = len(beat.references_sent)
    try:
        parts = [
            head,
            _U64.pack(beat.sequence),
            stamp_bytes(beat.sent_ns),
            struct.pack("<B3xI", beat.session_state, count),
            *(padded_text(object_id) for object_id in beat.references_sent),
            u32_bytes(count),
        ]
        body = b"".join(parts)
        if count:
            # rclpy aligns an array of numbers even when it is empty; rosbags can't read that.
            body += bytes(align8(len(body)) - len(body))
        body += struct.pack(f"<{count}Q", *beat.references_sent.values())
    except struct.error as error:
        raise ValueError(f"heartbeat {beat.sequence}: {error}") from None
    return body


@decoder
def decode_heartbeat(data: bytes, at: int) -> tuple[Heartbeat, int]:
    """The sign of life in a Heartbeat.msg."""
    stamp_ns, at = read_header(data, at)
    sender, at = read_text(data, at)
    at = align8(at)
    (sequence,) = _U64.unpack_from(data, at)
    sent_ns, at = read_stamp(data, at + 8)
    session_state = SessionPhase(data[at])
    count, at = read_count(data, at + 1, 4)
    ids = []
    for _ in range(count):
        object_id, at = read_text(data, at)
        ids.append(object_id)
    count, at = read_count(data, at, 8)
    if count != len(ids):
        raise ValueError(f"{count} counts of references for {len(ids)} objects")
    # The padding before no numbers is there with rclpy, and with others not.
    at = align8(at) if count else min(align8(at), len(data))
    counts = struct.unpack_from(f"<{count}Q", data, at)
    at += 8 * count
    references_sent = dict(zip(ids, counts, strict=True))
    if len(references_sent) != count:
        raise ValueError(f"an object named twice: {', '.join(ids)}")
    return Heartbeat(stamp_ns, sender, sequence, sent_ns, session_state, references_sent), at


# The recorder answers every tick whose number this divides, once it has taken it.
RECORDER_STEPS = 5
# The world waits when the recorder's last answer is older than this.
RECORDER_LAG_STEPS = 20
