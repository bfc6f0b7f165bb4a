"""A test object as a body: what it says becomes readings, what is decided reaches it."""

from __future__ import annotations

import select
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_ot_controller.bodies.body import TrajectoryDecision
from ssp_ot_controller.bodies.iso22133.framing import StreamDecoder, frames_of
from ssp_ot_controller.bodies.iso22133.gateway import IsoAddress, IsoBody
from ssp_ot_controller.bodies.iso22133.link import Link, Tap
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    DecodedMessage,
    Heab,
    Message,
    Osem,
    Traj,
    decode,
    encode,
)
from ssp_ot_controller.bodies.iso22133.units import to_gps
from ssp_ot_controller.bodies.odometry import LeverArm
from ssp_ot_controller.objects.live import LiveObjects, parse_bodies
from tests.support.iso22133.messages import ObjectSockets, monr
from tests.support.processes.waiting import DEADLINE_S, until
from tests.support.runs import small_run

DATUM = {"latitude_deg": 57.0, "longitude_deg": 12.0}
FAR_LEFT = IsoAddress("10.0.0.5", 9001, Path("a.json"), "Ada", LeverArm(1.5, -0.2))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("iso22133://track-7", IsoAddress("track-7")),
        ("iso22133://[fe80::1]:2", IsoAddress("fe80::1", 2)),
        (
            "iso22133://10.0.0.5:9001?report=a.json&waive=Ada&forward_m=1.5&left_m=-0.2",
            FAR_LEFT,
        ),
        ("iso22133://h?unknown=1", None),
        ("iso22133://h?forward_m=far", None),
        ("iso22133://h?forward_m=nan", None),
        ("iso22133://h:1", None),
        ("iso22133://h:65536", None),
        ("iso22133://", None),
        ("udp://h:9001", None),
    ],
)
def test_addresses(text: str, expected: IsoAddress | None) -> None:
    assert IsoAddress.parse(text) == expected
    if expected is not None:
        assert parse_bodies(f"ot1={text}", ["ot1"]) == {"ot1": expected}
    elif not text.startswith("udp"):
        with pytest.raises(InputError, match="iso22133://"):
            parse_bodies(f"ot1={text}", ["ot1"])


class Peer:
    """An object that receives messages, and sends those that a test chooses."""

    def __init__(self, sockets: ObjectSockets) -> None:
        self._udp = sockets.udp
        self._control, _ = sockets.tcp.accept()
        self._control.settimeout(DEADLINE_S)
        self._decoder = StreamDecoder(1 << 20)
        self._messages: list[Message] = []
        self._address: Any = None

    def hears(self) -> Message:
        """The next control message."""
        while not self._messages:
            for frame in self._decoder.feed(self._control.recv(65536)):
                self._messages.append(_message(frame))
        return self._messages.pop(0)

    def beat(self) -> Message:
        """The next heartbeat."""
        data, self._address = self._udp.recvfrom(4096)
        (frame,) = frames_of(data)
        return _message(frame)

    def says(self, at_ns: int | None = None, **changes: Any) -> None:
        """Report; ``at_ns`` by the clock of this host, None: now."""
        now = to_gps(time.time_ns() if at_ns is None else at_ns)[1]
        data = encode(monr(time_of_week_ns=now, **changes))
        self._udp.sendto(data, self._address)

    def close(self) -> None:
        self._control.close()


def _message(frame: Any) -> Message:
    found = decode(frame)
    assert isinstance(found, DecodedMessage), found
    return found.message


@pytest.fixture
def sockets() -> Iterator[ObjectSockets]:
    with ObjectSockets() as made:
        yield made


@pytest.fixture
def notes() -> list[str]:
    return []


@pytest.fixture
def body(sockets: ObjectSockets, notes: list[str]) -> Iterator[IsoBody]:
    run = RunSpec.model_validate(small_run(mode="live", datum=DATUM))
    address = IsoAddress(sockets.host, sockets.port, waive="Ada")
    made = IsoBody(run, run.targets[0], address, 1, notes.append)
    yield made
    made.close()


def connected(body: IsoBody, sockets: ObjectSockets) -> Peer:
    """The object's end, once settings and first trajectory were sent."""

    def has_attempt() -> bool:
        body.poll(time.time_ns())
        return bool(select.select([sockets.tcp], [], [], 0.0)[0])

    until(has_attempt, "attempt")
    peer = Peer(sockets)

    def follows() -> bool:
        body.poll(time.time_ns())
        body.follow(
            TrajectoryDecision(SessionPhase.CONNECTED, ControlState.DISARMED), time.time_ns()
        )
        return not any("isn't connected" in text for text in body.check.cannot_arm)

    until(follows, "connection")
    return peer


def test_an_object_is_led_and_read(body: IsoBody, sockets: ObjectSockets, notes: list[str]) -> None:
    peer = connected(body, sockets)
    osem, traj = peer.hears(), peer.hears()
    assert isinstance(osem, Osem)
    assert osem.latitude_deg == 57.0
    assert isinstance(traj, Traj)
    assert [(p.x_m, p.speed_mps) for p in traj.points] == [(40.0, 0.0), (40.0, 0.0)]
    body.beat(time.time_ns())
    heab = peer.beat()
    assert isinstance(heab, Heab)
    assert heab.status == CentreStatus.READY
    peer.says(x_m=40.5, y_m=0.25, yaw_rad=0.0, speed_mps=1.5, state=ControlState.ARMED.value)
    until(lambda: body.poll(time.time_ns()), "reading")
    reading = body.read()
    assert reading is not None
    assert (reading.x_m, reading.y_m, reading.speed_mps) == (40.5, 0.25, 1.5)
    assert body.read() is None
    body.follow(TrajectoryDecision(SessionPhase.ARMED, ControlState.PRE_ARMING), time.time_ns())
    assert body.check.armed
    # Both directions, byte by byte.
    frames = body.frames()
    names = [_message(f).__class__.__name__ for one in frames for f in frames_of(one.data)]
    assert names[:4] == ["Osem", "Traj", "Heab", "Monr"]
    assert [one.sent for one in frames][:4] == [True, True, True, False]
    assert body.frames() == []
    assert "Ada lets ot1 be armed" in notes[0]
    peer.close()


def test_a_late_report_changes_neither_state_nor_speed(
    body: IsoBody, sockets: ObjectSockets
) -> None:
    """One without a place changes them: it may be the newest."""
    peer = connected(body, sockets)
    body.beat(time.time_ns())
    peer.beat()
    now_ns = time.time_ns()

    def hears(at_ns: int, count: int, **changes: Any) -> None:
        peer.says(at_ns, **changes)

        def came() -> bool:
            body.poll(now_ns)
            return body.statistics.count == count

        until(came, "MONR")
        body.follow(TrajectoryDecision(SessionPhase.CONNECTED, ControlState.DISARMED), now_ns)

    hears(now_ns, 1, state=ControlState.DISARMED.value, speed_mps=0.0)
    for number, at_ns in enumerate((now_ns, now_ns - 20_000_000), start=2):
        hears(at_ns, number, state=ControlState.ARMED.value, speed_mps=5.0, error_status=0x80)
        assert not body.check.armed
        assert body.check.cannot_arm == ()
    assert "older than the newest one" in body.problems()[0]
    hears(now_ns, 4, state=ControlState.ARMED.value, x_m=None)
    assert body.check.armed
    peer.close()


def test_a_lost_object_is_told_and_connected_again(
    body: IsoBody, sockets: ObjectSockets, notes: list[str]
) -> None:
    connected(body, sockets).close()

    def reports_loss() -> bool:
        body.poll(time.time_ns())
        return any("not connected any more" in text for text in notes)

    until(reports_loss, "loss")
    body.follow(TrajectoryDecision(SessionPhase.CONNECTED, ControlState.DISARMED), time.time_ns())
    assert "isn't connected: 127.0.0.1" in body.check.cannot_arm[0]
    again = connected(body, sockets)
    assert isinstance(again.hears(), Osem)
    again.close()


class NobodyThere(Link):
    """Counts the attempts to connect."""

    attempts = 0

    def connect(self) -> None:
        self.attempts += 1


def test_a_connection_is_tried_again_once_a_second_by_a_clock_that_is_set_back_too() -> None:
    run = RunSpec.model_validate(small_run(mode="live", datum=DATUM))
    links: list[NobodyThere] = []

    def make_link(host: str, port: int, tap: Tap) -> Link:
        links.append(NobodyThere(host, port, tap))
        return links[-1]

    address = IsoAddress("127.0.0.1", waive="Ada")
    body = IsoBody(run, run.targets[0], address, 1, print, make_link)
    attempts = []
    for now_s in (100.0, 100.5, 101.0, 50.0, 50.5, 51.0):
        body.poll(round(now_s * 1e9))
        attempts.append(links[0].attempts)
    assert attempts == [1, 1, 2, 3, 3, 4]
    body.close()


def test_an_abort_is_sent_without_a_control_connection_too(
    body: IsoBody, sockets: ObjectSockets, notes: list[str]
) -> None:
    peer = connected(body, sockets)
    sockets.tcp.close()
    peer.close()

    def reports_loss() -> bool:
        body.poll(time.time_ns())
        return any("not connected any more" in text for text in notes)

    until(reports_loss, "loss")
    for state in (ControlState.RUNNING, ControlState.ABORTING):
        body.follow(TrajectoryDecision(SessionPhase.RUNNING, state), time.time_ns())
        body.beat(time.time_ns())
    heab = peer.beat()
    assert isinstance(heab, Heab)
    assert heab.status == CentreStatus.ABORT


def test_without_a_datum_there_is_no_test_object(sockets: ObjectSockets) -> None:
    run = RunSpec.model_validate(small_run(mode="live"))
    with pytest.raises(InputError, match="datum"):
        IsoBody(run, run.targets[0], IsoAddress(sockets.host, sockets.port), 1, print)


def test_a_timeout_that_the_object_would_read_as_none_is_refused(sockets: ObjectSockets) -> None:
    limits = {"speed_mps": 15.0, "acceleration_mps2": 4.0, "heartbeat_s": 0.009}
    run = RunSpec.model_validate(small_run(mode="live", datum=DATUM, limits=limits))
    with pytest.raises(InputError, match=r"limits\.heartbeat_s: .* 0\.01 s .*0\.009") as caught:
        IsoBody(run, run.targets[0], IsoAddress(sockets.host, sockets.port), 1, print)
    assert caught.value.remedy


def test_without_a_report_or_a_name_it_cannot_be_armed(sockets: ObjectSockets) -> None:
    run = RunSpec.model_validate(small_run(mode="live", datum=DATUM))
    body = IsoBody(run, run.targets[0], IsoAddress(sockets.host, sockets.port), 1, print)
    peer = connected(body, sockets)
    body.beat(time.time_ns())
    peer.beat()
    peer.says(state=ControlState.DISARMED.value)
    until(lambda: body.poll(time.time_ns()), "reading")
    body.follow(TrajectoryDecision(SessionPhase.CONNECTED, ControlState.DISARMED), time.time_ns())
    assert ["probe report" in text for text in body.check.cannot_arm] == [True]
    assert body.check.lasting
    peer.close()
    body.close()


def test_only_objects_that_say_something_new_are_stepped_between_the_steps() -> None:
    given = small_run(mode="live", datum=DATUM)
    given["targets"].append(given["targets"][0] | {"id": "ot2"})
    run = RunSpec.model_validate(given)
    with ObjectSockets() as one, ObjectSockets() as other:
        bodies = {
            spec.id: IsoBody(run, spec, IsoAddress(at.host, at.port, waive="Ada"), 1, print)
            for spec, at in zip(run.targets, (one, other), strict=True)
        }
        peers = [
            connected(body, at) for body, at in zip(bodies.values(), (one, other), strict=True)
        ]
        live = LiveObjects(run, bodies, print)
        live.beat(time.time_ns())
        for peer in peers:
            peer.beat()
            peer.says(state=ControlState.DISARMED.value)

        def stepped(now_ns: int) -> list[str]:
            return [state.object_id for state in live.tick(now_ns, only_new=True).objects]

        def came(count: int) -> bool:
            live.listen(time.time_ns())
            return sum(body.statistics.count for body in bodies.values()) == count

        until(lambda: came(2), "MONR of both")
        now_ns = time.time_ns()
        assert stepped(now_ns) == ["ot1", "ot2"]
        assert not live.listen(now_ns)
        step_ns = round(run.step_s * 1e9)
        assert stepped(now_ns + step_ns) == []
        # Nor with the step itself: their reports are awaited.
        assert live.tick(now_ns + step_ns).objects == ()
        # Of a moment before the step, however long the test was kept waiting.
        peers[1].says(now_ns + step_ns // 4, state=ControlState.DISARMED.value)
        until(lambda: came(3), "another MONR")
        assert stepped(now_ns + step_ns // 2) == []
        assert stepped(now_ns + step_ns) == ["ot2"]
        # One that is silent for longer is stepped all the same.
        assert len(live.tick(now_ns + 2 * step_ns).objects) == 2
        # By a clock that was set back none is left out of a step.
        assert stepped(now_ns - 5 * step_ns) == []
        assert len(live.tick(now_ns - 5 * step_ns).objects) == 2
        for end in (*peers, live):
            end.close()
