"""ISO 22133 on the wire: bytes known by hand, round trips, and what can't be sent or taken."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_ot_controller.bodies.iso22133.framing import (
    LONGEST_TRAJECTORY_BYTES,
    NO_ID,
    Frame,
    Header,
    Reason,
    RejectedBytes,
    StreamDecoder,
    frames_of,
    pack_frame,
)
from ssp_ot_controller.bodies.iso22133.layout import MOST_ODD, TURN
from ssp_ot_controller.bodies.iso22133.messages import (
    VENDORS,
    Accm,
    CentreStatus,
    CoordinateSystem,
    DecodedMessage,
    Dreq,
    Dres,
    DriveDirection,
    Exac,
    Grem,
    Heab,
    Message,
    MessageId,
    Monr,
    Mtsp,
    ObjectCommand,
    ObjectError,
    Opaque,
    Osem,
    OsemTestMode,
    Ostm,
    Rcmm,
    ReadyToArm,
    ResponseCode,
    Strt,
    Sypm,
    Traj,
    TrajectoryInfo,
    TrajPoint,
    Trcm,
    Treo,
    decode,
    encode,
)
from ssp_ot_controller.bodies.iso22133.units import QUARTER_MS_NS
from tests.support.iso22133.messages import (
    CLASSES,
    MONR,
    framed,
    message_of,
    messages_of,
    monr,
    opaque,
    osem_at,
    read,
)

ENUMERATIONS = (
    TrajectoryInfo,
    CoordinateSystem,
    OsemTestMode,
    ObjectCommand,
    CentreStatus,
    DriveDirection,
    ReadyToArm,
    ObjectError,
    ResponseCode,
)
headers = st.fixed_dictionaries(
    {
        "transmitter_id": st.integers(0, NO_ID),
        "receiver_id": st.integers(0, NO_ID),
        "counter": st.integers(0, 255),
        "acknowledge": st.booleans(),
    }
)


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__.upper())
@given(data=st.data(), header=headers)
@settings(max_examples=25)
def test_a_message_comes_out_as_it_went_in(
    cls: type, data: st.DataObject, header: dict[str, Any]
) -> None:
    message = data.draw(messages_of(cls))
    sent = encode(message, **header)
    assert read(sent) == DecodedMessage(Header(MessageId[cls.__name__.upper()], **header), message)
    assert encode(message_of(sent), **header) == sent


@given(opaque)
def test_a_message_without_public_content_keeps_its_items(message: Opaque) -> None:
    assert message_of(encode(message)) == message


def test_every_message_has_a_table_or_is_opaque() -> None:
    named = {MessageId[cls.__name__.upper()] for cls in CLASSES}
    assert {i.name for i in set(MessageId) - named} == {
        "MONR2",
        "SOWM",
        "INFO",
        "CATA",
        "RCCM",
        "PIME",
        "COSE",
        "MOMA",
        "RCRT",
    }


# -- known bytes ----------------------------------------------------------------------------------

HEAB_BYTES = bytes.fromhex("7f7e 09000000 02 01000000 02000000 07 0500 9000 0500 78563412 03")


def test_a_heartbeat_byte_by_byte() -> None:
    heab = Heab(0x12345678 * QUARTER_MS_NS, CentreStatus.RUNNING)
    data = encode(heab, transmitter_id=1, receiver_id=2, counter=7)
    assert data[:-2] == HEAB_BYTES
    # CRC-16 with polynomial 0x1021, start 0, not reflected; "123456789" gives 0x31C3.
    crc = 0
    for byte in HEAB_BYTES:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    assert data[-2:] == crc.to_bytes(2, "little")


def test_a_monr_byte_by_byte() -> None:
    payload = encode(MONR)[18:-2].hex(" ")
    assert payload == (
        "80 00 24 00 a0 0f 00 00 e8 03 00 00 30 f8 ff ff 00 00 00 80 28 23 00 00 00 00 "
        "f4 01 00 80 24 fa 00 80 00 04 01 00 34 12"
    )


# Payloads by hand; <63> stands for 63 bytes of zeros. A reference implementation gives the same.
KNOWN: list[tuple[Message, str]] = [
    (
        Traj(7, 2, "a", (TrajPoint(1.5, 1.0, -2.0, 0.25, 1.0, 8.0, -0.5, 2.0, None, 0.125),)),
        "01010200070004010100020201400061<63>01001e00dc050000e803000030f8fffffa0000006216"
        "2003ceffd00700800000003e5300010004",
    ),
    (
        Osem(
            1,
            2,
            3,
            57.5,
            -12.25,
            201.5,
            0.5,
            3,
            20260102,
            2400,
            4000 * QUARTER_MS_NS,
            18,
            0.5,
            0.25,
            0.1,
            0.05,
            0.2,
            1,
            100,
            10,
            50,
            None,
            0x0100007F,
            123,
        ),
        "20000c000100000002000000030000002100130000b6abe0850000576e7ae3ffb64e0000310b0322"
        "000b00062535016009a00f00001223001200f401fa003d020500140001640a32ffffffff24000600"
        "7f0000017b00",
    ),
    (
        Dres("v", "p", "f", "n", 1, 7),
        "9000400076<63>9100400070<63>9200400066<63>930040006e<63>94000100019500040007000000",
    ),
    (
        Ostm(ObjectCommand.ALL_CLEAR),
        "640001000a",
    ),
    (
        Strt(4000 * QUARTER_MS_NS, 2400),
        "02000400a00f0000030002006009",
    ),
    (
        Strt(None, None),
        "02000400ffffffff03000200ffff",
    ),
    (
        Rcmm(1, 3, 0.1, -5, 2.0, 6, 7, 8),
        "010001000101a2010003120002003d0231000200fbff11000200c800320002000600330002000700"
        "340002000800",
    ),
    (
        Sypm(1.5, 70.0),
        "01000400dc0500000200040070110100",
    ),
    (
        Mtsp(4000 * QUARTER_MS_NS),
        "01000400a00f0000",
    ),
    (
        Dreq(),
        "",
    ),
    (
        Trcm(1, 0x10, 0x80, None, 5),
        "010002000100020002001000110004008000000012000400ffffffff1300040005000000",
    ),
    (
        Accm(1, 0x10, None, 4, 5),
        "020002000100030002001000a1000400ffffffffa200040004000000a300040005000000",
    ),
    (
        Treo(1, 4000 * QUARTER_MS_NS),
        "01000200010002000400a00f0000",
    ),
    (
        Exac(1, None),
        "02000200010003000400ffffffff",
    ),
    (
        Grem(9, 8, 3, ResponseCode.CHUNK_RECEIVED, 1, b"x"),
        "0002040009000000010201000802020200030003020100060402020001000502010078",
    ),
]


@pytest.mark.parametrize(("message", "payload"), KNOWN, ids=lambda v: type(v).__name__)
def test_payloads_of_the_other_messages(message: Message, payload: str) -> None:
    data = encode(message)
    assert data[18:-2] == bytes.fromhex(payload.replace("<63>", "00" * 63))
    assert encode(message_of(data)) == data


def test_enumerations_have_the_numbers_of_the_wire() -> None:
    numbers = {kind.__name__: {e.name: e.value for e in kind} for kind in ENUMERATIONS}
    assert numbers == {
        "TrajectoryInfo": {"RELATIVE_TO_OBJECT": 1, "RELATIVE_TO_ORIGIN": 2, "DELETE": 3},
        "CoordinateSystem": {"ETRS89": 0, "NAD83": 1, "ITRF2000": 2, "WGS84": 3, "LOCAL": 4},
        "OsemTestMode": {"PREPLANNED": 0, "ONLINE": 1, "SCENARIO": 2},
        "ObjectCommand": {"ARM": 2, "DISARM": 3, "REMOTE_CONTROL": 6, "ALL_CLEAR": 10},
        "CentreStatus": {
            "INIT": 0,
            "READY": 1,
            "ABORT": 2,
            "RUNNING": 3,
            "TEST_DONE": 4,
            "NORMAL_STOP": 5,
        },
        "DriveDirection": {"FORWARD": 0, "BACKWARD": 1},
        "ReadyToArm": {"NOT_READY": 0, "READY": 1},
        "ObjectError": {
            "VENDOR": 1,
            "SYNC_POINT_ENDED": 2,
            "OTHER": 4,
            "BATTERY_FAULT": 8,
            "ENGINE_FAULT": 16,
            "BAD_POSITIONING_ACCURACY": 32,
            "OUTSIDE_GEOFENCE": 64,
            "ABORT_REQUEST": 128,
        },
        "ResponseCode": {
            "OK": 1,
            "GENERAL_ERROR": 2,
            "NOT_SUPPORTED": 3,
            "NO_MEMORY": 4,
            "INVALID_DATA": 5,
            "CHUNK_RECEIVED": 6,
        },
    }
    messages = "TRAJ OSEM OSTM STRT HEAB MONR MONR2 SOWM INFO RCMM SYPM MTSP"
    assert [MessageId(n).name for n in range(1, 13)] == messages.split()
    rest = {i.name: i.value for i in MessageId if i > 12}
    assert rest == {
        "DREQ": 0x10,
        "DRES": 0x11,
        "ACCM": 0x12,
        "TREO": 0x13,
        "EXAC": 0x14,
        "CATA": 0x15,
        "GREM": 0x18,
        "RCCM": 0x20,
        "TRCM": 0x21,
        "PIME": 0x30,
        "COSE": 0x31,
        "MOMA": 0x32,
        "RCRT": 0x33,
    }


def test_48_bits_hold_a_place_in_the_south_west_to_a_ten_billionth_of_a_degree() -> None:
    osem = osem_at(-33.9249000001, -70.6693)
    back = message_of(encode(osem))
    assert isinstance(back, Osem)
    assert back.latitude_deg == pytest.approx(-33.9249000001, abs=5e-11)
    assert back.longitude_deg == pytest.approx(-70.6693, abs=5e-11)
    # -70.6693 degrees are -706693000000 steps: two's complement in six bytes.
    assert (-706_693_000_000).to_bytes(6, "little", signed=True) in encode(osem)


def test_the_acknowledge_request_is_the_highest_bit_beside_the_version() -> None:
    assert encode(Ostm(ObjectCommand.ARM))[6] == 0x02
    assert encode(Ostm(ObjectCommand.ARM), acknowledge=True)[6] == 0x82


def test_an_angle_just_below_a_full_turn_is_zero_and_negative_ones_wrap() -> None:
    for yaw_rad, wire in [(2 * math.pi - 1e-5, 0), (-math.pi / 2, 27_000), (5 * math.pi, 18_000)]:
        data = encode(monr(yaw_rad=yaw_rad))
        assert int.from_bytes(data[38:40], "little") == wire


# -- what can't be sent ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "message",
    [
        monr(speed_mps=327.68),
        monr(speed_mps=-327.68),  # the wire's number for 'unavailable'
        monr(x_m=math.nan),
        monr(x_m=math.inf),
        monr(yaw_rad=math.inf),
        monr(error_status=None),
        monr(error_code=65536),
        monr(state=-1),
        Heab(-1, 0),
        Dres("v" * 64, "", "", "", 0),
        Dres("a\0b", "", "", "", 0),
        Grem(0, 0, 0, 1, 0, b"x" * 65_536),
        Traj(1, 2, "", (TrajPoint(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, None, None, None, 1e39),)),
        Opaque(0x1_0000, ()),
    ],
)
def test_what_the_wire_cannot_say_is_not_sent(message: Message) -> None:
    wrong = r"is outside|unavailable|is (nan|inf|1e\+39)|needs less than|has 65536 bytes|0x|format"
    with pytest.raises(ValueError, match=wrong):
        encode(message)


def test_ids_and_counters_that_do_not_fit_are_refused() -> None:
    for wrong in ({"transmitter_id": 2**32}, {"receiver_id": -1}, {"counter": 256}):
        with pytest.raises(ValueError, match="Header"):
            encode(Dreq(), **wrong)


# -- what is not taken ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (framed(0x00), Reason.MESSAGE),
        (framed(0x19), Reason.MESSAGE),
        (framed(0x100), Reason.MESSAGE),
        (framed(VENDORS[-1] + 1), Reason.MESSAGE),
        (framed(MessageId.OSTM), Reason.MISSING),
        (framed(MessageId.OSTM, (0x64, b"")), Reason.ITEM),
        (framed(MessageId.OSTM, (0x64, b"\2\2")), Reason.ITEM),
        (framed(MessageId.OSTM, (0x64, b"\2"), (0x64, b"\3")), Reason.ITEM),
        (framed(MessageId.MONR, (0x80, bytes(34))), Reason.ITEM),
        (framed(MessageId.TRAJ, (0x01, bytes(29))), Reason.ITEM),
        (pack_frame(Header(MessageId.OSTM), b"\x64\0\2\0\2"), Reason.ITEM),
        (pack_frame(Header(MessageId.OSTM), b"\x64\0\1"), Reason.ITEM),
    ],
)
def test_a_frame_that_is_no_message_says_why(data: bytes, reason: Reason) -> None:
    found = read(data)
    assert isinstance(found, RejectedBytes)
    assert found.reason is reason


def test_unknown_items_are_left_out_and_told() -> None:
    found = read(framed(MessageId.OSTM, (0x64, b"\2"), (0xA000, b"vendor")))
    assert isinstance(found, DecodedMessage)
    assert found.message == Ostm(ObjectCommand.ARM)
    assert found.odd == ("has item 0xA000, which isn't known",)


def test_a_message_full_of_unknown_items_is_told_of_in_short() -> None:
    found = read(framed(MessageId.DREQ, *[(number, b"") for number in range(1000)]))
    assert isinstance(found, DecodedMessage)
    assert len(found.odd) == MOST_ODD


def test_the_longest_trajectory_is_read_in_good_time() -> None:
    """The work grows with the number of points, not with that of pairs of points."""
    many = (TrajPoint(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, None, None, None, None),) * 30_000
    sent = encode(Traj(1, 2, "", many))
    (frame,) = StreamDecoder(LONGEST_TRAJECTORY_BYTES).feed(sent)
    assert isinstance(frame, Frame)
    found = decode(frame)
    assert isinstance(found, DecodedMessage)
    assert found.message == Traj(1, 2, "", many)


@pytest.mark.parametrize("wire", [0, TURN])
def test_a_full_turn_is_no_turn(wire: int) -> None:
    data = bytearray(encode(MONR))
    data[38:40] = wire.to_bytes(2, "little")
    assert message_of(pack_frame(Header(MessageId.MONR), bytes(data[18:-2]))) == monr(yaw_rad=0.0)


@pytest.mark.parametrize("wire", [TURN + 1, 45_000, 64_963])
def test_a_yaw_outside_of_a_turn_is_none_and_told(wire: int) -> None:
    data = bytearray(encode(MONR))
    data[38:40] = wire.to_bytes(2, "little")
    (frame,) = frames_of(pack_frame(Header(MessageId.MONR), bytes(data[18:-2])))
    assert isinstance(frame, Frame)
    found = decode(frame)
    assert isinstance(found, DecodedMessage)
    assert found.message == monr(yaw_rad=None)
    assert found.odd == (f"yaw_rad states {wire / 100:g} degrees",)


def test_numbers_outside_of_their_enumeration_are_kept_as_they_came() -> None:
    back = message_of(encode(monr(drive_direction=2, ready_to_arm=2, state=42)))
    assert isinstance(back, Monr)
    assert (back.drive_direction, back.ready_to_arm, back.state) == (2, 2, 42)
