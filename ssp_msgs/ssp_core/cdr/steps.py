"""Messages of one step as bytes, and what the nodes agree on in lockstep.

The messages are WorldTick, ActuatorCommands, StepDone, Heartbeat and Clock.
"""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.cdr.codec import (
    ENCAPSULATION,
    align8,
    decoder,
    fields_of,
    read,
    read_count,
    read_text,
    stamp_bytes,
    write,
)
from ssp_core.cdr.states import read_states, write_states
from ssp_core.motion.state import ObjectState
from ssp_core.value_class import value_class
from ssp_core.vocabulary import SessionPhase

_TICK = "mQ??QQ"
_COMMANDS = "mtQ"
_COMMAND = "mtQddd?"
_LEAST_COMMAND_BYTES = 8 + 4 + 4 + 33
_DONE = "tQQBQQQ"
_HEARTBEAT = "mtQsBtt"


@value_class(frozen=True, slots=True)
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
    """The command of one body; fields as in ActuatorCommand.msg, m/s^2, 1/m, rad."""

    object_id: str
    step: int
    acceleration_mps2: float
    curvature_1pm: float
    heading_rad: float
    emergency_stop: bool


@dataclass(frozen=True, slots=True)
class BodyCommands:
    """The commands of an object_target to its bodies for one step.

    Fields as in ActuatorCommands.msg.
    """

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


@value_class(frozen=True, slots=True)
class Heartbeat:
    """Sign of life of the manager; fields as in Heartbeat.msg.

    Args:
        sent_ns: when it was sent, on the manager's system clock, ns.
        references_sent: by object id.
        session_token: of the session that the sender leads; empty: of one without.
        abort_id: names the session's newest abort; empty: it had none.
    """

    stamp_ns: int
    sender: str
    sequence: int
    sent_ns: int
    session_state: SessionPhase
    references_sent: dict[str, int]
    session_token: str = ""
    abort_id: str = ""


def encode_clock(now_ns: int) -> bytes:
    """Encode a rosgraph_msgs/Clock."""
    return ENCAPSULATION + stamp_bytes(now_ns)


def encode_tick(tick: WorldTick) -> bytes:
    """Encode a WorldTick.msg, in frame map; raise ValueError for what its fields can't hold."""
    *head, objects = fields_of(tick)
    data = ENCAPSULATION + write(_TICK, head)
    return b"".join([data, *write_states(objects, len(data))])


@decoder
def decode_tick(data: bytes, at: int) -> tuple[WorldTick, int]:
    """Return a WorldTick.msg with the true states of all objects."""
    head, at = read(_TICK, data, at)
    objects, at = read_states(data, at)
    return WorldTick(*[*head, objects]), at


@decoder
def decode_tick_head(data: bytes, at: int) -> tuple[WorldTick, int]:
    """Return a WorldTick.msg without its objects, which aren't looked at."""
    head, _ = read(_TICK, data, at)
    return WorldTick(*head), len(data)


def encode_commands(message: BodyCommands) -> bytes:
    """Encode an ActuatorCommands.msg, in frame map.

    It raises ValueError for what its fields can't hold.
    """
    *head, commands = fields_of(message)
    out = ENCAPSULATION + write(_COMMANDS + "I", [*head, len(commands)])
    for command in commands:
        out += write(_COMMAND, [message.stamp_ns, *fields_of(command)], len(out))
    return out


def encode_command(stamp_ns: int, command: BodyCommand) -> bytes:
    """Encode an ActuatorCommand.msg; raise ValueError for what its fields can't hold.

    Args:
        stamp_ns: session time of the state that it answers.
        command: of one body.
    """
    return ENCAPSULATION + write(_COMMAND, [stamp_ns, *fields_of(command)])


def _read_command(data: bytes, at: int) -> tuple[BodyCommand, int]:
    (_, *values), at = read(_COMMAND, data, at)
    return BodyCommand(*values), at


# An ActuatorCommand.msg by itself.
decode_command = decoder(_read_command)


@decoder
def decode_commands(data: bytes, at: int) -> tuple[BodyCommands, int]:
    """Return the commands of an ActuatorCommands.msg."""
    head, at = read(_COMMANDS, data, at)
    count, at = read_count(data, at, _LEAST_COMMAND_BYTES)
    commands = []
    for _ in range(count):
        command, at = _read_command(data, at)
        commands.append(command)
    return BodyCommands(*[*head, tuple(commands)]), at


def encode_done(step_done: StepDone) -> bytes:
    """Encode a StepDone.msg; raise ValueError for what its fields can't hold."""
    return ENCAPSULATION + write(_DONE, fields_of(step_done))


@decoder
def decode_done(data: bytes, at: int) -> tuple[StepDone, int]:
    """Return the answer in a StepDone.msg."""
    (participant, step, heartbeat, session_state, *sent), at = read(_DONE, data, at)
    return StepDone(participant, step, heartbeat, SessionPhase(session_state), *sent), at


def encode_heartbeat(beat: Heartbeat) -> bytes:
    """Encode a Heartbeat.msg; raise ValueError for what its fields can't hold."""
    *head, references_sent, token, abort_id = fields_of(beat)
    count = len(references_sent)
    # rclpy aligns an array of numbers even when it is empty; rosbags can't read that.
    layout = _HEARTBEAT + "I" + "t" * count + "I" + "Q" * count
    values = [*head, token, abort_id, count, *references_sent, count, *references_sent.values()]
    return ENCAPSULATION + write(layout, values)


@decoder
def decode_heartbeat(data: bytes, at: int) -> tuple[Heartbeat, int]:
    """Return the sign of life in a Heartbeat.msg."""
    (*head, session_state, token, abort_id), at = read(_HEARTBEAT, data, at)
    count, at = read_count(data, at, 4)
    ids = []
    for _ in range(count):
        object_id, at = read_text(data, at)
        ids.append(object_id)
    count, at = read_count(data, at, 8)
    if count != len(ids):
        raise ValueError(f"{count} counts of references for {len(ids)} objects")
    counts, at = read("Q" * count, data, at)
    if not count:  # the padding before no numbers is there with rclpy, and with others not
        at = min(align8(at), len(data))
    references_sent = dict(zip(ids, counts, strict=True))
    if len(references_sent) != count:
        raise ValueError(f"an object named twice: {', '.join(ids)}")
    return Heartbeat(*[*head, SessionPhase(session_state), references_sent, token, abort_id]), at


# The recorder answers every tick whose number this divides, once it has taken it.
RECORDER_STEPS = 5
# The world waits when the recorder's last answer is older than this.
RECORDER_LAG_STEPS = 20
