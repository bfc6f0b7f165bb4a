"""The body protocol: codec, order, watchdog, and objects that are stepped over it."""

from __future__ import annotations

import math
import socket
import struct
import zlib
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.cdr.steps import Heartbeat
from ssp_core.errors import HostError, InputError
from ssp_core.geometry import Pose2
from ssp_core.leap_seconds import leap_seconds
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.body_status import BodyStatus
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ObjectClass, SessionPhase
from ssp_ot_controller.bodies import simulated
from ssp_ot_controller.bodies.body import BodyReading, MirrorBody
from ssp_ot_controller.bodies.dynamics import LIMITS, BodyState, Command, step_body
from ssp_ot_controller.bodies.protocol import (
    COMMAND_BYTES,
    STATE_BYTES,
    TIMEOUT_MS,
    CommandDatagram,
    Envelope,
    Order,
    Reason,
    UdpBody,
    decode_command,
    decode_state,
    encode_command,
    encode_state,
)
from ssp_ot_controller.bodies.simulated import WATCHDOG_S, BodyServer
from ssp_ot_controller.objects.live import LiveObjects, parse_bodies
from ssp_ot_controller.objects.pool import ObjectPool
from ssp_ot_controller.objects.state_machine import ObjectEvent
from tests.support.processes.waiting import until
from tests.support.runs import small_run

S = 1_000_000_000
MS = 1_000_000
T0 = 1_790_000_000 * S
ENVELOPE = Envelope("ot1", T0, 7, T0 + 123)
READING = BodyReading(T0 + 123, 1.5, -2.5, 0.25, 8.0, -1.0, 0.125, 0.02, True)
COMMAND = CommandDatagram(ENVELOPE, Command(-1.5, 0.01, 3.0, False), 200)

finite = st.floats(-1e300, 1e300)
int64 = st.integers(-(2**63), 2**63 - 1)
envelopes = st.builds(
    Envelope,
    st.from_regex(r"[a-z][a-z0-9_]{0,31}", fullmatch=True),
    int64,
    st.integers(0, 2**64 - 1),
    int64,
)


# -- codec ----------------------------------------------------------------------------------------


@given(envelopes, st.tuples(*[finite] * 6), st.floats(), st.booleans())
def test_a_state_comes_out_as_it_went_in(
    envelope: Envelope, values: tuple[float, ...], std: float, brakes: bool
) -> None:
    reading = BodyReading(envelope.stamp_ns, *values, std, brakes)  # type: ignore[misc]
    data = encode_state(envelope, reading)
    assert len(data) == STATE_BYTES
    found = decode_state(data, envelope.object_id)
    assert not isinstance(found, Reason)
    assert found[0] == envelope
    # As bits: a sigma that is no number must stay none.
    assert encode_state(*found) == data


@given(envelopes, st.tuples(finite, finite, finite), st.booleans(), st.integers(0, 2**32 - 1))
def test_a_command_comes_out_as_it_went_in(
    envelope: Envelope, values: tuple[float, ...], stop: bool, timeout_ms: int
) -> None:
    datagram = CommandDatagram(envelope, Command(*values, stop), timeout_ms)
    data = encode_command(datagram)
    assert len(data) == COMMAND_BYTES
    assert decode_command(data, envelope.object_id) == datagram


@given(st.binary(max_size=200))
def test_no_bytes_make_it_raise(data: bytes) -> None:
    assert isinstance(decode_state(data, "ot1"), Reason)
    assert isinstance(decode_command(data, "ot1"), Reason)


@given(st.integers(0, STATE_BYTES * 8 - 1))
def test_one_wrong_bit_is_noticed(bit: int) -> None:
    data = bytearray(encode_state(ENVELOPE, READING))
    data[bit // 8] ^= 1 << bit % 8
    assert isinstance(decode_state(bytes(data), "ot1"), Reason)


def resealed(data: bytes, at: int, value: bytes) -> bytes:
    """The same with other bytes and a checksum that fits."""
    body = data[:at] + value + data[at + len(value) : -4]
    return body + struct.pack("<I", zlib.crc32(body))


STATE = encode_state(ENVELOPE, READING)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (STATE[:-1], Reason.LENGTH),
        (STATE + b"\0", Reason.LENGTH),
        (b"", Reason.LENGTH),
        (b"X" + STATE[1:], Reason.MAGIC),
        (resealed(STATE, 4, b"\2"), Reason.VERSION),
        (resealed(STATE, 5, b"\2"), Reason.KIND),
        (resealed(STATE, 6, b"\1\0"), Reason.LENGTH),
        (STATE[:70] + b"\x55" + STATE[71:], Reason.CHECKSUM),
        (resealed(STATE, 8, b"ot2"), Reason.OBJECT),
        (resealed(STATE, 64, struct.pack("<d", math.nan)), Reason.NOT_FINITE),
        (resealed(STATE, 64 + 24, struct.pack("<d", math.inf)), Reason.NOT_FINITE),
    ],
)
def test_what_is_wrong_is_said(data: bytes, reason: Reason) -> None:
    assert decode_state(data, "ot1") is reason


def test_layout_is_that_of_the_docs() -> None:
    """The offsets are those in docs/body-protocol.md, from which others build their bodies."""
    assert (STATE_BYTES, COMMAND_BYTES) == (132, 100)
    assert STATE[:8] == b"SSPB\x01\x01" + struct.pack("<H", 132)
    assert STATE[8:40] == b"ot1".ljust(32, b"\0")
    assert struct.unpack_from("<qQq", STATE, 40) == (T0, 7, T0 + 123)
    assert struct.unpack_from("<7d", STATE, 64) == (1.5, -2.5, 0.25, 8.0, -1.0, 0.125, 0.02)
    assert STATE[120] == 1
    data = encode_command(COMMAND)
    assert data[:8] == b"SSPB\x01\x02" + struct.pack("<H", 100)
    assert struct.unpack_from("<3dIB", data, 64) == (-1.5, 0.01, 3.0, 200, 0)


@pytest.mark.parametrize("object_id", ["", "x" * 33, "ötzi"])
def test_ids_that_have_no_room_are_refused(object_id: str) -> None:
    with pytest.raises(ValueError, match=r"1 to 32 bytes|ascii"):
        encode_state(replace(ENVELOPE, object_id=object_id), READING)


def test_a_command_that_is_no_number_is_never_sent() -> None:
    with pytest.raises(ValueError, match="finite"):
        encode_command(replace(COMMAND, command=Command(math.nan, 0.0, 0.0)))


# -- the body's end -------------------------------------------------------------------------------


class Rig:
    """A body and somebody who commands it, in made-up time."""

    def __init__(self, cls: ObjectClass = ObjectClass.CAR) -> None:
        self.now_ns = T0
        self.server = BodyServer("ot1", cls, Pose2(10.0, 2.0, 0.0), T0)
        self.sequence = 0
        self.states: list[BodyReading] = []

    def send(
        self, acceleration_mps2: float, address: str = "us", boot_ns: int = T0, **changes: object
    ) -> None:
        self.sequence += 1
        envelope = Envelope("ot1", boot_ns, self.sequence, self.now_ns)
        datagram = CommandDatagram(envelope, Command(acceleration_mps2, 0.0, 0.0), 200)
        data = encode_command(replace(datagram, **changes))  # type: ignore[arg-type]
        self.server.on_datagram(data, address, self.now_ns)

    def run(self, seconds: float, acceleration_mps2: float | None = None) -> None:
        """Time passes in steps of 20 ms, with commands or without."""
        for _ in range(round(seconds / 0.02)):
            if acceleration_mps2 is not None:
                self.send(acceleration_mps2)
            for _ in range(4):
                self.now_ns += 5 * MS
                data = self.server.state_due(self.now_ns)
                if data is not None:
                    found = decode_state(data, "ot1")
                    assert not isinstance(found, Reason)
                    self.states.append(found[1])


def test_a_body_follows_and_reports_at_its_rate() -> None:
    rig = Rig()
    assert rig.server.state_due(T0 + S) is None  # nobody has asked
    rig.now_ns = T0 + S
    rig.run(2.0, 2.0)
    assert len(rig.states) == pytest.approx(200, abs=2)
    stamps = [s.stamp_ns for s in rig.states]
    assert stamps == sorted(set(stamps))
    assert rig.states[-1].speed_mps == pytest.approx(3.6, abs=0.2)
    assert not any(s.brakes_by_itself for s in rig.states[1:])


@pytest.mark.parametrize("cls", [ObjectClass.CAR, ObjectClass.CYCLIST, ObjectClass.PEDESTRIAN])
def test_a_body_that_hears_nothing_brakes_by_itself(cls: ObjectClass) -> None:
    rig = Rig(cls)
    rig.run(1.2, 2.0)
    x_m, speed = rig.server.body.x_m, rig.server.body.speed_mps
    assert speed > 1.5
    # The last command came one step of 20 ms ago.
    rig.run(WATCHDOG_S - 0.04)
    assert not rig.states[-1].brakes_by_itself
    rig.run(0.04)
    assert rig.states[-1].brakes_by_itself
    rig.run(3.0)
    assert rig.server.body.speed_mps == 0.0
    limits = LIMITS[cls]
    fastest = speed + 2.0 * WATCHDOG_S
    hardest = limits.emergency_deceleration_mps2
    reaction_s = WATCHDOG_S + limits.acceleration_lag_s + hardest / limits.acceleration_rate_mps3
    assert rig.server.body.x_m - x_m <= fastest * reaction_s + fastest**2 / (2.0 * hardest)


def test_a_clock_that_is_set_back_holds_neither_the_body_nor_its_watchdog() -> None:
    rig = Rig()
    rig.run(1.2, 2.0)
    x_m, seen = rig.server.body.x_m, len(rig.states)
    assert rig.server.body.speed_mps > 1.5
    rig.now_ns -= 5 * S
    rig.run(WATCHDOG_S)
    assert rig.server.body.x_m > x_m
    assert rig.states[-1].brakes_by_itself
    rig.run(1.8)
    assert rig.server.body.speed_mps == 0.0
    assert len(rig.states) - seen == pytest.approx(200, abs=2)
    assert rig.states[-1].stamp_ns == pytest.approx(rig.now_ns, abs=20 * MS)


def test_a_clock_that_is_set_ahead_by_an_hour_does_not_hold_the_body(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig()
    rig.run(1.2, 2.0)
    steps = []

    def counted(*values: Any) -> BodyState:
        steps.append(values)
        return step_body(*values)

    monkeypatch.setattr(simulated, "step_body", counted)
    rig.now_ns += 3600 * S
    rig.run(0.1)
    assert rig.server.body.speed_mps == 0.0
    assert rig.states[-1].stamp_ns == pytest.approx(rig.now_ns, abs=20 * MS)
    assert len(steps) < 1000


def test_a_command_may_hold_for_a_shorter_time_but_not_for_a_longer_one() -> None:
    rig = Rig()
    rig.run(1.0, 2.0)
    rig.send(2.0, timeout_ms=60)
    rig.run(0.06)
    assert rig.server.brakes_by_itself
    rig.send(2.0, timeout_ms=60_000)
    rig.run(WATCHDOG_S - 0.02)
    assert not rig.server.brakes_by_itself
    rig.run(0.02)
    assert rig.server.brakes_by_itself


def test_old_foreign_and_broken_datagrams_move_nothing() -> None:
    rig = Rig()
    rig.send(0.0)
    before = rig.sequence
    rig.sequence = 0
    rig.send(3.0)  # a copy of the first number
    rig.sequence = before
    rig.send(3.0, address="somebody")
    rig.server.on_datagram(b"SSPB", "us", rig.now_ns)
    rig.server.on_datagram(
        encode_command(replace(COMMAND, envelope=replace(ENVELOPE, object_id="ot2"))),
        "us",
        rig.now_ns,
    )
    rig.run(0.5)
    assert rig.server.body.speed_mps == 0.0
    assert rig.server.strangers == 1
    assert rig.server.rejected == {Reason.ORDER: 1, Reason.LENGTH: 1, Reason.OBJECT: 1}


def test_a_new_commander_takes_over_from_a_silent_one_at_standstill() -> None:
    rig = Rig()
    rig.run(1.0, 2.0)
    rig.run(0.3)
    rig.send(3.0, address="new", boot_ns=T0 - S)
    assert (rig.server.commander, rig.server.strangers) == ("us", 1)  # it still rolls
    rig.run(3.0)
    rig.send(3.0, address="new", boot_ns=T0 - S)
    assert rig.server.commander == "new"
    assert not rig.server.brakes_by_itself


# -- the object's end -----------------------------------------------------------------------------


def test_udp_takes_the_newest_good_state_and_counts_the_others() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as body:
        body.bind(("127.0.0.1", 0))
        body.settimeout(5.0)
        ours = UdpBody("ot1", "127.0.0.1", body.getsockname()[1], T0)
        ours.command(Command(1.0, 0.0, 0.0), T0 + 5)
        data, address = body.recvfrom(200)
        found = decode_command(data, "ot1")
        assert isinstance(found, CommandDatagram)
        assert found.envelope == Envelope("ot1", T0, 1, T0 + 5)
        assert found.timeout_ms == TIMEOUT_MS
        assert ours.read() is None
        for sequence in (1, 3, 2, 3):
            envelope = replace(ENVELOPE, sequence=sequence, stamp_ns=sequence)
            body.sendto(encode_state(envelope, READING), address)
        body.sendto(b"noise", address)
        body.sendto(STATE + b"\0" * 300, address)
        # The loopback delivers in order: once the last one is there, all are.
        newest = None
        while ours.rejected[Reason.LENGTH] < 2:
            newest = ours.read() or newest
        assert newest is not None
        assert newest.stamp_ns == 3
        assert ours.rejected == {Reason.ORDER: 2, Reason.LENGTH: 2}
        ours.close()


def test_why_nothing_of_a_body_is_taken_is_known() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as body:
        body.bind(("127.0.0.1", 0))
        body.settimeout(5.0)
        port = body.getsockname()[1]
        ours = UdpBody("ot1", "127.0.0.1", port, T0)
        at = f"udp://127.0.0.1:{port}"
        assert ours.problems() == (f"nothing comes from {at}",)
        ours.command(Command(1.0, 0.0, 0.0), T0 + 5)
        address = body.recvfrom(200)[1]

        def problem_after(data: bytes) -> str:
            body.sendto(data, address)
            before = sum(ours.rejected.values())
            until(lambda: ours.read() is not None or sum(ours.rejected.values()) > before, "it")
            return "".join(ours.problems())

        assert problem_after(b"noise") == f"what comes from {at} is refused: length (1 times)"
        assert problem_after(STATE) == f"nothing comes from {at}"
        older = replace(ENVELOPE, boot_ns=T0 - 20 * S)
        assert "its clock set back by 20.0 s" in problem_after(encode_state(older, READING))
        anew = replace(ENVELOPE, sequence=1)
        assert "restarted its count" in problem_after(encode_state(anew, READING))

    def refused() -> bool:
        ours.command(Command(1.0, 0.0, 0.0), T0 + 5)
        ours.read()
        return ours.problems() == (f"no program listens at {at}",)

    until(refused, "the port's refusal")
    ours.close()


def test_a_clock_that_is_ahead_or_behind_is_named_and_forgotten_when_it_is_right() -> None:
    run = RunSpec.model_validate(small_run(mode="live"))
    body = StatedBody()
    live = LiveObjects(run, {"ot1": body}, lambda text: None)
    assert live.statuses(T0) == [BodyStatus("ot1", ("its cable is out",))]
    ahead_s = leap_seconds(T0)
    body.stamp_ns = T0 + ahead_s * S
    live.tick(T0)
    (told,) = live.statuses(T0)
    assert told.no_state == (
        f"its body's clock is {ahead_s:.3f} s ahead, limit 0.05 s: its readings aren't taken "
        "(GPS time is so far ahead of UTC)",
    )
    body.stamp_ns = T0 + S
    live.tick(T0 + S)
    assert live.statuses(T0 + S) == [BodyStatus("ot1")]
    assert live.statuses(T0 + 2 * S) == [BodyStatus("ot1", ("its cable is out",))]
    body.stamp_ns = T0 + 3 * S - ahead_s * S
    live.tick(T0 + 3 * S)
    (told,) = live.statuses(T0 + 3 * S)
    assert told.no_state == ()
    assert told.cannot_arm == (
        f"its body's readings are {ahead_s:.3f} s old on arrival, limit 0.3 s: its clock is "
        "behind, or its link is slow (UTC is so far behind GPS time)",
    )


def test_a_body_that_hears_no_command_keeps_its_object_from_being_armed() -> None:
    run = RunSpec.model_validate(small_run(mode="live"))
    body = StatedBody()
    live = LiveObjects(run, {"ot1": body}, lambda text: None)
    for brakes in (True, False):
        body.stamp_ns, body.brakes_by_itself = (T0, True) if brakes else (T0 + S, False)
        live.tick(body.stamp_ns)
        (told,) = live.statuses(body.stamp_ns)
        assert [text.partition(":")[0] for text in told.cannot_arm] == (
            ["its body hears no command and brakes by itself"] if brakes else []
        )


@pytest.mark.parametrize("back_s", [0.005, 0.02, 0.06, 5.0])
@pytest.mark.parametrize("says_more", [True, False], ids=["same clock", "silent"])
def test_an_object_is_judged_at_every_step_of_a_clock_that_was_set_back(
    back_s: float, says_more: bool
) -> None:
    """Its readings are stamped by that clock, or come no more."""
    run = RunSpec.model_validate(small_run(mode="live"))
    body = StatedBody()
    live, pool = LiveObjects(run, {"ot1": body}, print), ObjectPool(run)
    step_ns, back_ns = round(run.step_s * S), round(back_s * S)
    stops: list[tuple[int, SafetyCode]] = []

    def step(steady_ns: int, now_ns: int) -> None:
        tick = live.tick(now_ns)
        assert [state.object_id for state in tick.objects] == ["ot1"]
        pool.take_tick(tick, steady_ns)
        answer = pool.step(steady_ns)
        assert answer is not None
        stops.extend((steady_ns, event.stop.code) for event in answer.events)

    beat = Heartbeat(T0, "manager", 1, T0, SessionPhase.ARMED, {})
    pool.take_heartbeat(beat, 0)
    body.stamp_ns = T0
    step(0, T0)
    assert pool.command("ot1", ObjectEvent.ARM, run.event_version, 0).accepted
    # Nothing is heard of the manager any more.
    for k in range(1, round(run.limits.heartbeat_s * S) // step_ns + 2):
        now_ns = T0 + k * step_ns - back_ns
        body.stamp_ns = now_ns if says_more else T0
        step(k * step_ns, now_ns)
    ((at_ns, code),) = stops
    if says_more:
        assert code is SafetyCode.HEARTBEAT_LOST
        assert at_ns <= run.limits.heartbeat_s * S + step_ns
    elif back_s - run.step_s > run.limits.clock_offset_s:
        assert (at_ns, code) == (step_ns, SafetyCode.CLOCK_OFFSET)
    else:
        assert code is SafetyCode.STATE_STALE


class StatedBody(MirrorBody):
    """Says that it stands, at a given time."""

    def __init__(self) -> None:
        super().__init__(ObjectClass.CAR, Pose2(0.0, 0.0, 0.0))
        self.stamp_ns: int | None = None
        self.brakes_by_itself = False

    def read(self) -> BodyReading | None:
        if self.stamp_ns is None:
            return None
        braked = self.brakes_by_itself
        stands = replace(READING, speed_mps=0.0, acceleration_mps2=0.0)
        return replace(stands, stamp_ns=self.stamp_ns, brakes_by_itself=braked)

    def problems(self) -> tuple[str, ...]:
        return ("its cable is out",)


def test_a_body_that_has_no_address_is_an_error_of_this_machine(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(HostError, match=r"udp://nowhere:9000: .*not known"):
        UdpBody("ot1", "nowhere", 9000, T0)


def test_a_body_where_is_unreachable_is_silent() -> None:
    ours = UdpBody("ot1", "127.0.0.1", 9, T0)
    for _ in range(3):
        ours.command(Command(0.0, 0.0, 0.0), T0)
        assert ours.read() is None
    ours.close()


def test_a_mirror_does_exactly_what_it_is_told() -> None:
    body = MirrorBody(ObjectClass.CAR, Pose2(0.0, 0.0, 0.0), T0)
    assert body.read() == BodyReading(T0, 0.0, 0.0, 0.0, 0.0)
    assert body.read() is None
    for k in range(101):
        body.command(Command(2.0 if k < 50 else -4.0, 0.0, 0.0), T0 + k * 20 * MS)
    reading = body.read()
    assert reading is not None
    assert reading.speed_mps == 0.0
    assert reading.x_m == pytest.approx(1.5, abs=0.05)  # v^2 / 2a of 2 m/s, there and back


# -- parameters -----------------------------------------------------------------------------------


def test_bodies_by_parameter() -> None:
    text = "ot1=udp://10.0.0.5:9001, ot2=mirror,ot3=udp://[fe80::1]:65535"
    assert parse_bodies(text, ["ot1", "ot2", "ot3"]) == {
        "ot1": ("10.0.0.5", 9001),
        "ot2": None,
        "ot3": ("fe80::1", 65535),
    }


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "ot1 has no body"),
        ("ot1", "is no body"),
        ("ot1=10.0.0.5:9001", "is no body"),
        ("ot1=udp://10.0.0.5", "is no body"),
        ("ot1=udp://10.0.0.5:0", "is no body"),
        ("ot1=udp://10.0.0.5:65536", "is no body"),
        ("ot1=mirror,ot1=mirror", "has a body already"),
        ("ot1=mirror,ot9=mirror", "is no object of this process"),
    ],
)
def test_bodies_that_do_not_fit_are_refused(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as error:
        parse_bodies(text, ["ot1"])
    assert "parameter bodies" in str(error.value)


@settings(max_examples=50)
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 20)), max_size=40))
def test_whatever_order_datagrams_come_in_each_counts_once(rows: list[tuple[int, int]]) -> None:
    order, passed = Order(), []
    for boot_ns, sequence in rows:
        if order.is_new(replace(ENVELOPE, boot_ns=boot_ns, sequence=sequence), T0):
            passed.append((boot_ns, sequence))
    assert passed == sorted(set(passed))


def older(order: Order, at_s: float, sequence: int, **options: bool) -> bool:
    """A datagram of a sender that was started 20 s before the one that is obeyed."""
    envelope = replace(ENVELOPE, boot_ns=T0 - 20 * S, sequence=sequence)
    return order.is_new(envelope, T0 + round(at_s * S), **options)


def test_a_sender_that_starts_again_with_its_clock_set_back_is_followed_after_a_second() -> None:
    order = Order()
    assert order.is_new(ENVELOPE, T0)
    taken = [older(order, 0.02 * n, n) for n in range(1, 60)]
    assert taken == [False] * 51 + [True] * 8
    assert order.set_back_s == 0.0
    # Now the one that was obeyed before would have to prove itself.
    assert order.is_new(replace(ENVELOPE, sequence=8), T0 + 2 * S)


def test_a_sender_without_a_clock_that_starts_again_is_followed_after_a_second() -> None:
    """Its boot is the same each time, and its sequence begins anew."""
    order = Order()
    for sequence in range(1, 5001):
        assert order.is_new(replace(ENVELOPE, sequence=sequence), T0)
    again = [replace(ENVELOPE, sequence=n) for n in range(1, 60)]
    taken = [order.is_new(one, T0 + round(0.02 * n * S)) for n, one in enumerate(again, 1)]
    assert taken == [False] * 51 + [True] * 8


def test_late_datagrams_of_the_same_boot_are_never_followed() -> None:
    order = Order()
    for n in range(1, 99):
        at_ns = T0 + round(0.04 * n * S)
        assert order.is_new(replace(ENVELOPE, sequence=100 + n), at_ns)
        assert not order.is_new(replace(ENVELOPE, sequence=50 + n), at_ns)
        assert not order.is_new(replace(ENVELOPE, sequence=100 + n), at_ns)


def test_why_datagrams_of_an_older_boot_are_refused_is_known() -> None:
    order = Order()
    order.is_new(ENVELOPE, T0)
    assert not older(order, 0.1, 1)
    assert order.set_back_s == 20.0


def test_late_datagrams_of_an_older_boot_are_never_followed() -> None:
    order = Order()
    order.is_new(ENVELOPE, T0)
    assert not any(older(order, float(n), n) for n in range(1, 9))
    # The same ones again and again.
    assert not any(older(order, 10.0 + 0.02 * n, n % 5) for n in range(99))
    # While the newer one is heard.
    for n in range(1, 99):
        assert not older(order, 20.0 + 0.04 * n, 100 + n)
        assert order.is_new(replace(ENVELOPE, sequence=7 + n), T0 + round((20.02 + 0.04 * n) * S))


def test_a_body_that_moves_does_not_follow_a_commander_of_an_older_boot() -> None:
    order = Order()
    order.is_new(ENVELOPE, T0)
    assert not any(older(order, 0.02 * n, n, may_restart=False) for n in range(1, 99))
    assert older(order, 2.0, 99)
