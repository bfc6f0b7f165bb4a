"""The messages of ISO 22133, wire version 2, as tables: a row has value id, type, scale, None.

Units are SI, with the unit in the name; a value that the wire calls 'unavailable' is None. Numbers
of enumerations stay numbers, since objects send some that aren't in them. Messages whose content
isn't public are ``Opaque``, and so are vendors' own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Annotated, TypeAlias, TypeVar

from ssp_ot_controller.bodies.iso22133.framing import (
    CENTRE_ID,
    Frame,
    Header,
    Item,
    Reason,
    RejectedBytes,
    items_of,
    pack_frame,
    pack_items,
)
from ssp_ot_controller.bodies.iso22133.layout import PER_RAD, Wire, items_to_send, read_items
from ssp_ot_controller.bodies.iso22133.units import QUARTER_MS_NS


class MessageId(IntEnum):
    """Names of the messages; from 0xA100 to 0xBFFF they are vendors' own."""

    TRAJ = 0x01
    OSEM = 0x02
    OSTM = 0x03
    STRT = 0x04
    HEAB = 0x05
    MONR = 0x06
    MONR2 = 0x07
    SOWM = 0x08
    INFO = 0x09
    RCMM = 0x0A
    SYPM = 0x0B
    MTSP = 0x0C
    DREQ = 0x10
    DRES = 0x11
    ACCM = 0x12
    TREO = 0x13
    EXAC = 0x14
    CATA = 0x15
    GREM = 0x18
    RCCM = 0x20
    TRCM = 0x21
    PIME = 0x30
    COSE = 0x31
    MOMA = 0x32
    RCRT = 0x33


VENDORS = range(0xA100, 0xC000)
_KNOWN = frozenset(MessageId)


class TrajectoryInfo(IntEnum):
    RELATIVE_TO_OBJECT = 1
    RELATIVE_TO_ORIGIN = 2
    DELETE = 3


class CoordinateSystem(IntEnum):
    ETRS89 = 0
    NAD83 = 1
    ITRF2000 = 2
    WGS84 = 3
    LOCAL = 4


class OsemTestMode(IntEnum):
    PREPLANNED = 0
    ONLINE = 1
    SCENARIO = 2


class ObjectCommand(IntEnum):
    """The request of an OSTM."""

    ARM = 2
    DISARM = 3
    REMOTE_CONTROL = 6
    ALL_CLEAR = 10


class CentreStatus(IntEnum):
    """The state of the control centre in a HEAB."""

    INIT = 0
    READY = 1
    ABORT = 2
    RUNNING = 3
    TEST_DONE = 4
    NORMAL_STOP = 5


class DriveDirection(IntEnum):
    FORWARD = 0
    BACKWARD = 1


class ReadyToArm(IntEnum):
    NOT_READY = 0
    READY = 1


class ObjectError(IntFlag):
    """Bits of a MONR's error status."""

    VENDOR = 0x01
    SYNC_POINT_ENDED = 0x02
    OTHER = 0x04
    BATTERY_FAULT = 0x08
    ENGINE_FAULT = 0x10
    BAD_POSITIONING_ACCURACY = 0x20
    OUTSIDE_GEOFENCE = 0x40
    ABORT_REQUEST = 0x80


class ResponseCode(IntEnum):
    """The answer of a GREM."""

    OK = 1
    GENERAL_ERROR = 2
    NOT_SUPPORTED = 3
    NO_MEMORY = 4
    INVALID_DATA = 5
    CHUNK_RECEIVED = 6


# A trajectory's line info: it is complete.
END_OF_TRANSMISSION = 4
# Manoeuvre of an RCMM: back to the start.
BACK_TO_START = 3

# -- types of fields, as they recur ---------------------------------------------------------------

_NONE_8 = 0xFF
_NONE_16 = 0xFFFF
_NONE_32 = 0xFFFF_FFFF
_NONE_I16 = -(1 << 15)
_NONE_I32 = -(1 << 31)
_NONE_I48 = -(1 << 47)


def _week(value_id: int) -> Wire:
    return Wire(value_id, "u16", none=_NONE_16)


def _time_of_week(value_id: int) -> Wire:
    return Wire(value_id, "u32", step=QUARTER_MS_NS, none=_NONE_32)


def _id(value_id: int) -> Wire:
    return Wire(value_id, "u16", none=_NONE_16)


def _parameter(value_id: int) -> Wire:
    return Wire(value_id, "u32", none=_NONE_32)


def _position(value_id: int) -> Wire:
    return Wire(value_id, "i32", per_unit=1000.0, none=_NONE_I32)


def _yaw(value_id: int) -> Wire:
    return Wire(value_id, "u16", per_unit=PER_RAD, none=_NONE_16, turns=True)


def _angle(value_id: int) -> Wire:
    return Wire(value_id, "i16", per_unit=PER_RAD, none=_NONE_I16)


def _speed(value_id: int) -> Wire:
    return Wire(value_id, "i16", per_unit=100.0, none=_NONE_I16)


def _acceleration(value_id: int) -> Wire:
    return Wire(value_id, "i16", per_unit=1000.0, none=_NONE_I16)


def _degrees(value_id: int) -> Wire:
    return Wire(value_id, "i48", per_unit=1e10, none=_NONE_I48)


def _largest(value_id: int, per_unit: float) -> Wire:
    return Wire(value_id, "u16", per_unit=per_unit, none=_NONE_16)


def _milliseconds(value_id: int) -> Wire:
    return Wire(value_id, "u32", per_unit=1000.0)


_CLASSES: dict[int, type] = {}
_IDS: dict[type, MessageId] = {}
_M = TypeVar("_M")


def _message(message_id: MessageId) -> Callable[[type[_M]], type[_M]]:
    def enter(cls: type[_M]) -> type[_M]:
        _CLASSES[message_id] = cls
        _IDS[cls] = message_id
        return cls

    return enter


# -- trajectories ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TrajPoint:
    """A point of a trajectory, in the test's coordinate system.

    Args:
        t_s: since the start.
        speed_mps: along the heading; the lateral one is to the left.
        curvature_1pm: 1/m; its sign isn't public, SSP's + turns left.
    """

    t_s: Annotated[float, _milliseconds(0x01)]
    x_m: Annotated[float | None, _position(0x01)]
    y_m: Annotated[float | None, _position(0x01)]
    z_m: Annotated[float | None, _position(0x01)]
    yaw_rad: Annotated[float | None, _yaw(0x01)]
    speed_mps: Annotated[float | None, _speed(0x01)]
    lateral_speed_mps: Annotated[float | None, _speed(0x01)]
    acceleration_mps2: Annotated[float | None, _acceleration(0x01)]
    lateral_acceleration_mps2: Annotated[float | None, _acceleration(0x01)]
    curvature_1pm: Annotated[float | None, Wire(0x01, "f32")]


@_message(MessageId.TRAJ)
@dataclass(frozen=True, slots=True)
class Traj:
    """A trajectory (TCP, to the object)."""

    trajectory_id: Annotated[int, Wire(0x101, "u16")]
    info: Annotated[int, Wire(0x104, "u8")]
    name: Annotated[str, Wire(0x102, "text")]
    points: Annotated[tuple[TrajPoint, ...], Wire(0x01, "points", points=TrajPoint)]
    line_info: Annotated[int | None, Wire(0x53, "u8")] = END_OF_TRANSMISSION


# -- from the control centre ----------------------------------------------------------------------


@_message(MessageId.OSEM)
@dataclass(frozen=True, slots=True)
class Osem:
    """Settings of an object (TCP, to the object)."""

    device_id: Annotated[int, Wire(0x20, "u32")]
    sub_device_id: Annotated[int, Wire(0x20, "u32")]
    control_centre_id: Annotated[int, Wire(0x20, "u32")]
    latitude_deg: Annotated[float | None, _degrees(0x21)]
    longitude_deg: Annotated[float | None, _degrees(0x21)]
    altitude_m: Annotated[float | None, Wire(0x21, "i32", per_unit=100.0, none=_NONE_I32)]
    # Its sense isn't public; SSP sends 0.
    rotation_rad: Annotated[float | None, _yaw(0x21)]
    coordinate_system: Annotated[int | None, Wire(0x21, "u8", none=_NONE_8)]
    # YYYYMMDD as a decimal number.
    date: Annotated[int | None, Wire(0x22, "u32", none=_NONE_32)]
    week: Annotated[int | None, _week(0x22)]
    time_of_week_ns: Annotated[int | None, _time_of_week(0x22)]
    leap_seconds: Annotated[int, Wire(0x22, "u8")]
    max_way_deviation_m: Annotated[float | None, _largest(0x23, 1000.0)]
    max_lateral_deviation_m: Annotated[float | None, _largest(0x23, 1000.0)]
    max_yaw_deviation_rad: Annotated[float | None, _largest(0x23, PER_RAD)]
    max_position_error_m: Annotated[float | None, _largest(0x23, 100.0)]
    heab_timeout_s: Annotated[float, Wire(0x23, "u16", per_unit=100.0)]
    test_mode: Annotated[int | None, Wire(0x23, "u8", none=_NONE_8)]
    # Public objects divide by these rates: 0 ends their process.
    monr_rate_hz: Annotated[int, Wire(0x23, "u8")]
    monr2_rate_hz: Annotated[int, Wire(0x23, "u8")]
    heab_rate_hz: Annotated[int, Wire(0x23, "u8")]
    max_message_bytes: Annotated[int | None, Wire(0x23, "u32", none=_NONE_32)]
    # The order of an address's bytes isn't public.
    time_server_ip: Annotated[int | None, Wire(0x24, "u32")] = None
    time_server_port: Annotated[int | None, Wire(0x24, "u16")] = None


@_message(MessageId.OSTM)
@dataclass(frozen=True, slots=True)
class Ostm:
    """A wanted change of state, an ObjectCommand (TCP, to the object)."""

    command: Annotated[int, Wire(0x64, "u8")]


@_message(MessageId.STRT)
@dataclass(frozen=True, slots=True)
class Strt:
    """The time to start at; None: at once (TCP, to the object)."""

    time_of_week_ns: Annotated[int | None, _time_of_week(0x02)]
    week: Annotated[int | None, _week(0x03)]


@_message(MessageId.HEAB)
@dataclass(frozen=True, slots=True)
class Heab:
    """Heartbeat of the control centre with its CentreStatus (UDP, to the object)."""

    time_of_week_ns: Annotated[int | None, _time_of_week(0x90)]
    status: Annotated[int, Wire(0x90, "u8")]


@_message(MessageId.RCMM)
@dataclass(frozen=True, slots=True)
class Rcmm:
    """Remote control (UDP, to the object). Percentages are from -100 to 100."""

    status: Annotated[int, Wire(0x01, "u8")]
    manoeuvre: Annotated[int | None, Wire(0xA201, "u8")] = None
    steering_rad: Annotated[float | None, _angle(0x12)] = None
    steering_percent: Annotated[int | None, Wire(0x31, "i16")] = None
    speed_mps: Annotated[float | None, _speed(0x11)] = None
    speed_percent: Annotated[int | None, Wire(0x32, "i16")] = None
    throttle_percent: Annotated[int | None, Wire(0x33, "i16")] = None
    brake_percent: Annotated[int | None, Wire(0x34, "i16")] = None


@_message(MessageId.SYPM)
@dataclass(frozen=True, slots=True)
class Sypm:
    """The point of its trajectory where an object meets another, and the end of its adaptation."""

    sync_point_t_s: Annotated[float, _milliseconds(0x01)]
    freeze_t_s: Annotated[float, _milliseconds(0x02)]


@_message(MessageId.MTSP)
@dataclass(frozen=True, slots=True)
class Mtsp:
    """The time at which the other one is expected at the meeting point."""

    time_of_week_ns: Annotated[int | None, _time_of_week(0x01)]


@_message(MessageId.DREQ)
@dataclass(frozen=True, slots=True)
class Dreq:
    """Asks an object who it is."""


@_message(MessageId.TRCM)
@dataclass(frozen=True, slots=True)
class Trcm:
    """Configures a trigger."""

    trigger_id: Annotated[int | None, _id(0x01)]
    trigger_type: Annotated[int | None, _id(0x02)]
    parameter_1: Annotated[int | None, _parameter(0x11)]
    parameter_2: Annotated[int | None, _parameter(0x12)]
    parameter_3: Annotated[int | None, _parameter(0x13)]


@_message(MessageId.ACCM)
@dataclass(frozen=True, slots=True)
class Accm:
    """Configures an action."""

    action_id: Annotated[int | None, _id(0x02)]
    action_type: Annotated[int | None, _id(0x03)]
    parameter_1: Annotated[int | None, _parameter(0xA1)]
    parameter_2: Annotated[int | None, _parameter(0xA2)]
    parameter_3: Annotated[int | None, _parameter(0xA3)]


@_message(MessageId.EXAC)
@dataclass(frozen=True, slots=True)
class Exac:
    """An action, and when it is to be executed."""

    action_id: Annotated[int | None, _id(0x02)]
    time_of_week_ns: Annotated[int | None, _time_of_week(0x03)]


# -- from the object ------------------------------------------------------------------------------


@_message(MessageId.MONR)
@dataclass(frozen=True, slots=True)
class Monr:
    """An object's report of itself, in the test's coordinate system (UDP)."""

    time_of_week_ns: Annotated[int | None, _time_of_week(0x80)]
    x_m: Annotated[float | None, _position(0x80)]
    y_m: Annotated[float | None, _position(0x80)]
    z_m: Annotated[float | None, _position(0x80)]
    yaw_rad: Annotated[float | None, _yaw(0x80)]
    pitch_rad: Annotated[float | None, _angle(0x80)]
    roll_rad: Annotated[float | None, _angle(0x80)]
    speed_mps: Annotated[float | None, _speed(0x80)]
    lateral_speed_mps: Annotated[float | None, _speed(0x80)]
    acceleration_mps2: Annotated[float | None, _acceleration(0x80)]
    lateral_acceleration_mps2: Annotated[float | None, _acceleration(0x80)]
    drive_direction: Annotated[int | None, Wire(0x80, "u8", none=_NONE_8)]
    # Numbers of ControlState.
    state: Annotated[int | None, Wire(0x80, "u8", none=_NONE_8)]
    ready_to_arm: Annotated[int | None, Wire(0x80, "u8", none=_NONE_8)]
    error_status: Annotated[int, Wire(0x80, "u8")]
    error_code: Annotated[int, Wire(0x80, "u16")]


@_message(MessageId.TREO)
@dataclass(frozen=True, slots=True)
class Treo:
    """A trigger has fired."""

    trigger_id: Annotated[int | None, _id(0x01)]
    time_of_week_ns: Annotated[int | None, _time_of_week(0x02)]


# Vendor and product of the test object that this project simulates.
SIMULATED_OBJECT = "SSP", "ssp iso object"


@_message(MessageId.DRES)
@dataclass(frozen=True, slots=True)
class Dres:
    """The identity of an object."""

    vendor: Annotated[str, Wire(0x90, "text")]
    product: Annotated[str, Wire(0x91, "text")]
    firmware: Annotated[str, Wire(0x92, "text")]
    name: Annotated[str, Wire(0x93, "text")]
    # 0 moveable, 1 stationary.
    kind: Annotated[int, Wire(0x94, "u8")]
    sub_device_id: Annotated[int | None, Wire(0x95, "u32")] = None

    @property
    def is_simulated(self) -> bool:
        """The object says that it is ``ssp iso object``, a model of motion."""
        return (self.vendor, self.product) == SIMULATED_OBJECT


@_message(MessageId.GREM)
@dataclass(frozen=True, slots=True)
class Grem:
    """Answer to a message, named by its transmitter, counter and id, with a ResponseCode."""

    transmitter_id: Annotated[int, Wire(0x200, "u32")]
    counter: Annotated[int, Wire(0x201, "u8")]
    message_id: Annotated[int, Wire(0x202, "u16")]
    response: Annotated[int, Wire(0x203, "u8")]
    payload_bytes: Annotated[int | None, Wire(0x204, "u16")] = None
    payload: Annotated[bytes | None, Wire(0x205, "bytes")] = None


@dataclass(frozen=True, slots=True)
class Opaque:
    """A message whose content isn't public, or a vendor's own."""

    message_id: int
    items: tuple[Item, ...]


Message: TypeAlias = (
    Traj
    | Osem
    | Ostm
    | Strt
    | Heab
    | Monr
    | Rcmm
    | Sypm
    | Mtsp
    | Dreq
    | Dres
    | Accm
    | Treo
    | Exac
    | Grem
    | Trcm
    | Opaque
)


@dataclass(frozen=True, slots=True)
class DecodedMessage:
    """A message.

    Args:
        odd: what it has that the tables don't know, for people.
    """

    header: Header
    message: Message
    odd: tuple[str, ...] = ()


def encode(
    message: Message,
    *,
    transmitter_id: int = CENTRE_ID,
    receiver_id: int = CENTRE_ID,
    counter: int = 0,
    acknowledge: bool = False,
) -> bytes:
    """Return the frame of a message; the other arguments are those of ``Header``.

    Raises:
        ValueError: a value that the wire can't say.
    """
    if isinstance(message, Opaque):
        message_id, items = message.message_id, list(message.items)
    else:
        message_id, items = int(_IDS[type(message)]), items_to_send(message)
    header = Header(message_id, transmitter_id, receiver_id, counter, acknowledge)
    return pack_frame(header, pack_items(items))


def decode(frame: Frame) -> DecodedMessage | RejectedBytes:
    """Return the message of a frame, or why it is none."""
    message_id = frame.header.message_id
    if message_id not in _KNOWN and message_id not in VENDORS:
        return RejectedBytes(Reason.MESSAGE, f"message 0x{message_id:04X} isn't known")
    items = items_of(frame.payload)
    if isinstance(items, RejectedBytes):
        return items
    cls = _CLASSES.get(message_id)
    if cls is None:
        return DecodedMessage(frame.header, Opaque(message_id, items))
    odd: list[str] = []
    message = read_items(cls, items, odd)
    if isinstance(message, RejectedBytes):
        return message
    return DecodedMessage(frame.header, message, tuple(odd))
