"""Messages of ISO 22133: one of each that is asked for, strategies, and an object's sockets."""

from __future__ import annotations

import math
import socket
from dataclasses import fields
from typing import Any, get_type_hints

from hypothesis import strategies as st

from ssp_ot_controller.bodies.iso22133.framing import (
    Header,
    Item,
    RejectedBytes,
    frames_of,
    pack_frame,
    pack_items,
)
from ssp_ot_controller.bodies.iso22133.layout import TURN, Wire
from ssp_ot_controller.bodies.iso22133.messages import (
    VENDORS,
    Accm,
    DecodedMessage,
    Dreq,
    Dres,
    Exac,
    Grem,
    Heab,
    Message,
    MessageId,
    Monr,
    Mtsp,
    Opaque,
    Osem,
    Ostm,
    Rcmm,
    Strt,
    Sypm,
    Traj,
    Trcm,
    Treo,
    decode,
)
from tests.support.processes.waiting import DEADLINE_S

CLASSES: tuple[type, ...] = (
    Traj,
    Osem,
    Ostm,
    Strt,
    Heab,
    Monr,
    Rcmm,
    Sypm,
    Mtsp,
    Dreq,
    Dres,
    Accm,
    Treo,
    Exac,
    Grem,
    Trcm,
)
MONR = Monr(
    time_of_week_ns=1_000_000_000,
    x_m=1.0,
    y_m=-2.0,
    z_m=None,
    yaw_rad=math.pi / 2,
    pitch_rad=0.0,
    roll_rad=0.0,
    speed_mps=5.0,
    lateral_speed_mps=None,
    acceleration_mps2=-1.5,
    lateral_acceleration_mps2=None,
    drive_direction=0,
    state=4,
    ready_to_arm=1,
    error_status=0,
    error_code=0x1234,
)


def monr(**changes: Any) -> Monr:
    return Monr(**{f.name: getattr(MONR, f.name) for f in fields(Monr)} | changes)


def osem_at(latitude_deg: float, longitude_deg: float) -> Osem:
    return Osem(
        1, 0, 0, latitude_deg, longitude_deg, 12.5, 0.0, 3, 20260101, 2400, 0, 18,
        0.5, 0.3, 0.1, 0.05, 0.1, 1, 100, 1, 100, None,
    )  # fmt: skip


def read(data: bytes) -> DecodedMessage | RejectedBytes:
    """The one message of these bytes."""
    (frame,) = frames_of(data)
    return frame if isinstance(frame, RejectedBytes) else decode(frame)


def message_of(data: bytes) -> Message:
    found = read(data)
    assert isinstance(found, DecodedMessage), found
    return found.message


def framed(message_id: int, *items: tuple[int, bytes]) -> bytes:
    return pack_frame(Header(message_id), pack_items(Item(i, c) for i, c in items))


def values_of(wire: Wire) -> st.SearchStrategy[Any]:
    """Values that lie on the wire's grid."""
    if wire.points is not None:
        return st.lists(messages_of(wire.points), max_size=4).map(tuple)
    if wire.code == "text":
        letters = st.characters(codec="utf-8", exclude_characters="\0")
        return st.text(letters, max_size=20).filter(lambda text: len(text.encode()) < 64)
    if wire.code == "bytes":
        return st.none() | st.binary(max_size=40)
    if wire.code == "f32":
        return st.none() | st.floats(width=32, allow_nan=False, allow_infinity=False)
    bits = int(wire.code[1:])
    low = -(1 << bits - 1) if wire.code[0] == "i" else 0
    high = TURN - 1 if wire.turns else low + (1 << bits) - 1
    numbers = st.integers(low, high) | st.sampled_from([low, high])
    steps = numbers.filter(lambda raw: raw != wire.none)
    values = (
        steps.map(lambda raw: raw * wire.step)
        if wire.per_unit is None
        else steps.map(lambda raw: raw / (wire.per_unit or 1.0))
    )
    return values if wire.none is None else st.none() | values


@st.composite
def messages_of(draw: st.DrawFn, cls: type) -> Any:
    hints = get_type_hints(cls, include_extras=True)
    items: dict[int, list[Any]] = {}
    for field in fields(cls):
        wire = hints[field.name].__metadata__[0]
        items.setdefault(wire.value_id, []).append((field, wire))
    values: dict[str, Any] = {}
    for parts in items.values():
        # An optional item is there with all of its values, or isn't.
        absent = all(field.default is None for field, _ in parts) and draw(st.booleans())
        for field, wire in parts:
            values[field.name] = None if absent else draw(values_of(wire))
    return cls(**values)


items_strategy = st.lists(
    st.builds(Item, st.integers(0, 0xFFFF), st.binary(max_size=30)), max_size=5
).map(tuple)
opaque = st.builds(
    Opaque,
    st.sampled_from([MessageId.MONR2.value, MessageId.CATA.value, VENDORS[0], VENDORS[-1]]),
    items_strategy,
)
messages = st.one_of(*(messages_of(cls) for cls in CLASSES), opaque)


class ObjectSockets:
    """The sockets of an object: a TCP port, and the UDP port below it."""

    def __init__(self, host: str = "127.0.0.1") -> None:
        self.host = host
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        for _ in range(100):
            self.udp = socket.socket(family, socket.SOCK_DGRAM)
            self.udp.bind((host, 0))
            self.port = self.udp.getsockname()[1] + 1
            try:
                self.tcp = socket.create_server((host, self.port), family=family)
            except OSError:
                self.udp.close()
            else:
                break
        for sock in (self.tcp, self.udp):
            sock.settimeout(DEADLINE_S)

    def __enter__(self) -> ObjectSockets:
        return self

    def __exit__(self, *_: object) -> None:
        self.tcp.close()
        self.udp.close()
