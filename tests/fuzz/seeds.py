"""Inputs to begin with: messages, and definitions of their types."""

from __future__ import annotations

from collections.abc import Iterator

from ssp_core.bag.types import definition, serialize, typestore
from ssp_core.cdr.references import Acknowledgement, encode_ack
from ssp_core.cdr.states import StateArray, encode_state, encode_states
from ssp_core.cdr.steps import (
    BodyCommand,
    BodyCommands,
    Heartbeat,
    SessionPhase,
    StepDone,
    WorldTick,
    encode_commands,
    encode_done,
    encode_heartbeat,
    encode_tick,
)
from ssp_core.motion.state import ObjectState, Size
from ssp_core.vocabulary import ObjectClass, Role

STATES = "ssp_msgs/msg/ObjectStates"
STRING = "std_msgs/msg/String"
STATE = ObjectState(
    object_id="ot1",
    object_class=ObjectClass(1),
    role=Role(1),
    stamp_ns=5,
    x_m=1.0,
    y_m=2.0,
    yaw_rad=0.5,
    speed_mps=3.0,
    acceleration_mps2=0.0,
    yaw_rate_radps=0.0,
    size=Size(2.0, 2.0, 1.8, 1.5),
)


def text_message(text: str) -> bytes:
    return serialize(typestore().types[STRING](data=text))


def definitions() -> Iterator[bytes]:
    """A byte for the encoding (its low bit: IDL), then the text."""
    for msgtype in (STRING, STATES, "geometry_msgs/msg/TwistWithCovarianceStamped"):
        yield b"\0" + definition(msgtype).text.encode()
    yield b"\0float64 X=1.5\nstring<=5 S='a'\nuint8[<=4] a\nbool[3] b true\n"
    yield (
        b"\1module a { module msg { module B_Constants { const long X = 3; }; typedef double T[3];"
        b'struct B { @verbatim (language="comment", text="x") double x; sequence<octet, 4> y; '
        b"T z; string<3> s; }; }; };"
    )


def wire_messages() -> Iterator[bytes]:
    """A byte for the decoder, then the message; every decoder gets every message."""
    messages = [
        encode_state(STATE),
        encode_states(StateArray(5, "ot", (STATE,))),
        encode_tick(WorldTick(5, 1, True, True, 2, 3, (STATE,))),
        encode_commands(BodyCommands(5, "ot", 1, (BodyCommand("ot1", 1, 0.5, 0.0, 0.1, False),))),
        encode_done(StepDone("ot", 3)),
        encode_heartbeat(Heartbeat(5, "m", 1, 6, SessionPhase(0), {"ot1": 7})),
        encode_ack(Acknowledgement(5, "r1", "ot1", True)),
        text_message("text"),
    ]
    for number in range(16):
        for message in messages:
            yield bytes([number]) + message
