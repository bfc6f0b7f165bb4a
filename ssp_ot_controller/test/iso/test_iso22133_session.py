"""A session with a test object from connection to its end, and each fault with its stopping way.

The same object target judges as with any body; here it leads one that follows trajectories.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from unittest.mock import ANY

import numpy as np
import pytest

import ssp_core
from ssp_core.clock import seconds_to_ns
from ssp_core.motion.reference import Points, sample
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.stopping import stopping_of
from ssp_core.vocabulary import ControlState, ObjectClass, SessionPhase
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    Heab,
    Monr,
    ObjectError,
    Strt,
    encode,
)
from ssp_ot_controller.bodies.iso22133.probe_report import (
    NEEDED,
    STOP_ON_ABORT,
    STOPS,
    TIMES,
    Outcome,
    ProbeReport,
    Row,
    Stage,
    write_report,
)
from ssp_ot_controller.objects.references import RefusalCode
from ssp_ot_controller.objects.state_machine import REFUSED_LASTING, ObjectEvent
from tests.support.iso22133.loop import MS, Loop
from tests.support.iso22133.messages import message_of


def test_a_whole_session() -> None:
    loop = Loop()
    loop.drive(6.5)
    assert loop.stops == []
    assert loop.acks[0].accepted
    assert loop.object.state is ControlState.RUNNING
    loop.forward(2.0)
    assert loop.state is ControlState.RUNNING
    loop.session = SessionPhase.STOPPING
    loop.until(lambda: loop.state is ControlState.DISARMED, 6.0)
    loop.session = SessionPhase.FINISHED
    loop.forward(2.0)
    assert loop.stops == []
    assert loop.object.state is ControlState.DISARMED
    assert loop.object.body.speed_mps == 0.0


def test_a_simulated_object_says_so_before_it_is_armed() -> None:
    """Its DRES says so: the gateway can't otherwise know what is at the other end."""
    loop = Loop()
    assert loop.live.simulated == ()
    loop.session = SessionPhase.CONNECTED
    loop.forward(1.0)
    assert loop.state is not ControlState.ARMED
    assert loop.live.simulated == ("ot1",)


def test_an_object_that_misses_its_start_is_told_so_before_its_place_stands_for_too_long() -> None:
    loop = Loop(frozen_s=0.3)
    loop.arm()

    def no_start(to_object: bool, udp: bool, data: bytes) -> bytes | None:
        return None if to_object and not udp and isinstance(message_of(data), Strt) else data

    loop.way = no_start
    loop.session = SessionPhase.RUNNING
    loop.forward(0.06)
    loop.send(loop.approach())
    loop.until(lambda: bool(loop.stops), 5.0)
    (stop,) = loop.stops
    assert stop.code is SafetyCode.OBJECT_CONTRADICTS
    assert re.fullmatch(r"reports ARMED \(2\) [01]\.\d* s after its start time", stop.words)
    assert loop.object.body.speed_mps == 0.0


def test_an_object_whose_target_refuses_to_arm_it_contradicts_no_session_that_is_armed() -> None:
    """The session may be armed by other objects, or its heartbeat comes before the call to arm."""
    loop = Loop(waive="")
    loop.session = SessionPhase.CONNECTED
    loop.forward(5.0)
    loop.session = SessionPhase.ARMED
    loop.forward(0.5)
    answer = loop.command(ObjectEvent.ARM)
    assert (answer.accepted, answer.error_code) == (False, REFUSED_LASTING)
    assert "no probe report" in answer.error_msg
    loop.forward(10.0)
    assert loop.stops == []
    assert loop.state is ControlState.DISARMED


def probed(folder: Path, slows_s: float) -> Path:
    """A probe report of the object of a loop, which slows so long after an abort."""
    shown = {**dict.fromkeys((*NEEDED, *STOPS, *TIMES), 0.0), STOP_ON_ABORT: slows_s}
    rows = tuple(
        Row(clause=one, stage=Stage.MOVE, title="", verdict=Outcome.PASS, measured=measured)
        for one, measured in shown.items()
    )
    started = datetime(2026, 11, 23, tzinfo=UTC)
    report = ProbeReport(
        host="h",
        port=2,
        firmware=ssp_core.__version__,
        started=started,
        wire_version=2,
        stages=(),
        rows=rows,
    )
    path = folder / "report.json"
    write_report(path, report)
    return path


def test_an_object_that_slows_too_late_for_the_room_of_its_approach_is_not_armed(
    tmp_path: Path,
) -> None:
    """Its stops go past the end of its approach: 30 s at 7 m/s, all of which the site allows."""
    loop = Loop("", probed(tmp_path, 30.0), stop_reaction_s=60.0)
    loop.session = SessionPhase.CONNECTED
    loop.forward(1.0)
    (reported,) = loop.live.statuses(loop.now_ns)
    assert reported.lasting
    (text,) = reported.cannot_arm
    assert re.search(r"shows 30\.000 s .* outside the geofence, limit is 0 m: it needs", text)
    answer = loop.command(ObjectEvent.ARM)
    assert (answer.accepted, answer.error_code) == (False, REFUSED_LASTING)
    assert answer.error_msg == text


def test_an_object_that_slows_in_time_for_the_room_of_its_approach_drives_it(
    tmp_path: Path,
) -> None:
    loop = Loop("", probed(tmp_path, 0.5))
    loop.drive(6.5)
    assert loop.stops == []


def test_an_object_refuses_a_reference_that_leaves_no_room_for_its_late_stops(
    tmp_path: Path,
) -> None:
    loop = Loop("", probed(tmp_path, 0.5))
    loop.arm()
    loop.body.slows_s = 30.0
    loop.session = SessionPhase.RUNNING
    loop.forward(0.06)
    loop.send(loop.approach())
    loop.until(lambda: bool(loop.stops), 1.0)
    (ack,) = loop.acks
    assert (ack.accepted, ack.error_code) == (False, RefusalCode.FENCE)
    assert [stop.code for stop in loop.stops] == [SafetyCode.REFERENCE_REFUSED]
    assert loop.object.body.speed_mps == 0.0


def test_a_manoeuvre_is_driven_from_its_time_on() -> None:
    loop = Loop()
    loop.drive(6.5)
    assert loop.driven is not None
    there = sample(loop.driven, loop.now_ns + seconds_to_ns(0.3))
    times_s = np.linspace(0.0, there.speed_mps / 1.5, 10)
    columns = np.zeros((7, 10))
    columns[0], columns[2], columns[5] = times_s, 3.5, -1.5
    columns[1] = there.x_m + there.speed_mps * times_s - 0.75 * times_s**2
    columns[4] = there.speed_mps - 1.5 * times_s
    loop.send(loop.reference("manoeuvre", Points(columns), 0.3))
    loop.forward(2.3)
    assert loop.stops == []
    assert [ack.accepted for ack in loop.acks] == [True, True]
    due_m = there.x_m + there.speed_mps * 2.0 - 0.75 * 2.0**2
    assert loop.object.body.x_m == pytest.approx(due_m, abs=0.3)
    # Its last point stands: what was to be driven beyond is overwritten, not driven on.
    loop.forward(6.0)
    assert loop.object.body.speed_mps == 0.0
    assert loop.object.body.x_m == pytest.approx(columns[1, -1], abs=0.5)
    assert loop.driven.points[-1].x_m > columns[1, -1] + 50.0


@dataclass(frozen=True)
class Fault:
    """A fault of a session, the event that it must cause, and the time until the object must brake.

    Args:
        reaction_s: until brakes, at most; the rest of its way is that of the braking.
        code: of the object target's event; None: the target is gone.
    """

    do: Callable[[Loop], None]
    reaction_s: float
    code: SafetyCode | None


def cut(loop: Loop) -> None:
    loop.way = lambda to_object, udp, data: None


def deaf(loop: Loop) -> None:
    """An abort becomes the status before it."""

    def way(to_object: bool, udp: bool, data: bytes) -> bytes | None:
        if to_object and udp and message_of(data) == Heab(ANY, CentreStatus.ABORT):
            return encode(replace(message_of(data), status=CentreStatus.RUNNING))  # type: ignore
        return data

    loop.way = way
    loop.session = SessionPhase.ABORTING


def monr_changed(**changes: object) -> Callable[[Loop], None]:
    def do(loop: Loop) -> None:
        def way(to_object: bool, udp: bool, data: bytes) -> bytes | None:
            if to_object or not udp:
                return data
            message = message_of(data)
            assert isinstance(message, Monr)
            return encode(replace(message, **changes))  # type: ignore[arg-type]

        loop.way = way

    return do


def jump(loop: Loop) -> None:
    def way(to_object: bool, udp: bool, data: bytes) -> bytes | None:
        message = message_of(data)
        if isinstance(message, Monr):
            assert message.x_m is not None
            return encode(replace(message, x_m=message.x_m + 3.0))
        return data

    loop.way = way


def late(loop: Loop) -> None:
    waiting: deque[tuple[int, bytes]] = deque()

    def way(to_object: bool, udp: bool, data: bytes) -> bytes | None:
        if to_object or not udp:
            return data
        waiting.append((loop.now_ns, data))
        if loop.now_ns - waiting[0][0] > 400 * MS:
            return waiting.popleft()[1]
        return None

    loop.way = way


def other_version(loop: Loop) -> None:
    loop.way = lambda to_object, udp, data: data if to_object else data[:6] + b"\x03" + data[7:]


def dies(part: str) -> Callable[[Loop], None]:
    return lambda loop: setattr(loop, part, False)


LIMITS = Loop().run.limits
SEEN_S = 0.1
FAULTS = {
    "link cut": Fault(cut, LIMITS.heartbeat_s, SafetyCode.STATE_STALE),
    "MONR silent": Fault(
        lambda loop: setattr(loop, "way", lambda to_object, udp, data: data if to_object else None),
        LIMITS.state_age_s,
        SafetyCode.STATE_STALE,
    ),
    "MONR late": Fault(late, LIMITS.state_age_s, SafetyCode.STATE_STALE),
    "MONR of another version": Fault(other_version, LIMITS.state_age_s, SafetyCode.STATE_STALE),
    "MONR without a place": Fault(
        monr_changed(x_m=None), LIMITS.state_age_s, SafetyCode.STATE_STALE
    ),
    "position bad": Fault(
        monr_changed(error_status=ObjectError.BAD_POSITIONING_ACCURACY.value),
        0.0,
        SafetyCode.LOCALISATION,
    ),
    "position jumps": Fault(jump, 0.0, SafetyCode.POSITION_JUMP),
    "state contradicts": Fault(
        monr_changed(state=ControlState.DISARMED.value), 0.0, SafetyCode.OBJECT_CONTRADICTS
    ),
    "requests an abort": Fault(
        monr_changed(error_status=ObjectError.ABORT_REQUEST.value),
        0.0,
        SafetyCode.OBJECT_CONTRADICTS,
    ),
    "state without a name": Fault(monr_changed(state=77), 0.0, SafetyCode.OBJECT_CONTRADICTS),
    "control connection lost": Fault(
        lambda loop: loop.link.lose(), 0.0, SafetyCode.CONNECTION_LOST
    ),
    "manager dies": Fault(dies("manager_alive"), LIMITS.heartbeat_s, SafetyCode.HEARTBEAT_LOST),
    "gateway dies": Fault(dies("gateway_alive"), LIMITS.heartbeat_s, None),
    "deaf to abort": Fault(
        deaf, LIMITS.stop_reaction_s + LIMITS.heartbeat_s, SafetyCode.NOT_STOPPING
    ),
}


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("speed_mps", [2.0, 6.5])
def test_a_fault_ends_in_a_standstill_within_its_way(name: str, speed_mps: float) -> None:
    fault = FAULTS[name]
    loop = Loop(jump_m=1.0, frozen_s=0.3)
    loop.drive(speed_mps)
    loop.forward(0.2)
    from_x_m, from_mps = loop.object.body.x_m, loop.object.body.speed_mps
    fault.do(loop)
    loop.until(lambda: loop.object.body.speed_mps == 0.0, 8.0)
    loop.forward(2.0)
    way_m = loop.object.body.x_m - from_x_m
    stopping = stopping_of(ObjectClass.CAR, LIMITS, loop.run.step_s)
    # While nobody has noticed it goes on with its approach, and may still speed up.
    assert loop.run.targets[0].approach is not None
    gain_mps2 = loop.run.targets[0].approach.acceleration_mps2
    allowed_m = stopping.distance_m(from_mps, fault.reaction_s + SEEN_S, gain_mps2)
    assert 0.0 < way_m <= allowed_m
    assert loop.object.body.speed_mps == 0.0
    if fault.code is not None:
        assert fault.code in [stop.code for stop in loop.stops]
        assert loop.state is ControlState.ABORTING


@pytest.mark.parametrize("name", [n for n in FAULTS if n != "deaf to abort"])
def test_a_fault_of_an_armed_object_is_not_followed_by_a_start(name: str) -> None:
    loop = Loop(jump_m=1.0, frozen_s=0.3)
    loop.arm()
    FAULTS[name].do(loop)
    loop.forward(1.2)
    loop.session = SessionPhase.RUNNING
    loop.forward(0.1)
    loop.send(loop.approach())
    loop.forward(3.0)
    assert loop.object.body.speed_mps == 0.0


def test_an_abort_of_the_session_stops_it_and_is_latched_until_a_person_clears_it() -> None:
    loop = Loop()
    loop.drive(6.5)
    loop.session = SessionPhase.ABORTING
    assert loop.until(lambda: loop.object.body.speed_mps < 6.0, 1.0) < 0.5
    loop.until(lambda: loop.object.body.speed_mps == 0.0, 4.0)
    assert loop.object.state is ControlState.ABORTING
    loop.session = SessionPhase.ABORTED
    loop.forward(1.0)
    assert loop.command(ObjectEvent.ALL_CLEAR).accepted
    loop.session = SessionPhase.IDLE
    loop.forward(0.3)
    assert loop.object.state is ControlState.DISARMED
    assert loop.state is ControlState.DISARMED
    assert "slowed" in " ".join(loop.told)


def test_one_that_starts_early_is_measured_and_stopped() -> None:
    loop = Loop(error_longitudinal_m=0.2)
    loop.arm()

    def at_once(to_object: bool, udp: bool, data: bytes) -> bytes | None:
        message = message_of(data)
        return encode(Strt(None, None)) if isinstance(message, Strt) else data

    loop.way = at_once
    loop.session = SessionPhase.RUNNING
    loop.forward(0.06)
    loop.send(loop.approach())
    loop.until(lambda: loop.object.body.speed_mps > 1.0, 10.0)
    assert any("RUNNING" in text and "from its start time" in text for text in loop.told)


def test_without_connection_or_approval_nothing_is_armed() -> None:
    loop = Loop()
    loop.may_connect = False
    loop.session = SessionPhase.CONNECTED
    loop.forward(2.0)
    response = loop.command(ObjectEvent.ARM)
    assert not response.accepted
    assert "connect" in response.error_msg or "heartbeat" in response.error_msg
