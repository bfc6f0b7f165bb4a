"""The messages of a control centre to a test object, and the faults that it finds in the object."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pytest

from ssp_core.clock import NS_PER_S, seconds_to_ns
from ssp_core.geodesy import Datum, Place
from ssp_core.motion.reference import Reference, ReferencePoint
from ssp_core.run_file.model import Limits
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState as C
from ssp_core.vocabulary import SessionPhase as P
from ssp_ot_controller.bodies.body import TrajectoryDecision
from ssp_ot_controller.bodies.iso22133.conversation import (
    ARMING_S,
    LAG_S,
    PAUSE_NS,
    Conversation,
    NewestReport,
    Settings,
)
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    Dreq,
    Message,
    ObjectCommand,
    ObjectError,
    Osem,
    Ostm,
    Strt,
    Traj,
    TrajectoryInfo,
    TrajPoint,
    encode,
)
from ssp_ot_controller.bodies.iso22133.units import to_gps
from tests.support.iso22133.messages import message_of

T0 = 1_800_000_000 * NS_PER_S
STEP_NS = 10_000_000
LIMITS = Limits(speed_mps=20.0, acceleration_mps2=4.0)
DATUM = Datum(Place(57.0, 12.0, 200.0))
STAND = TrajPoint(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
STANDS = Traj(1, TrajectoryInfo.RELATIVE_TO_ORIGIN, "stands", (STAND, replace(STAND, t_s=60.0)))


def along_x(reference_id: str, execute_at_ns: int, ends_s: float, x_m: float = 0.0) -> Reference:
    """5 m/s along x, a point every second; the last one stands."""
    points = [
        ReferencePoint(float(t), x_m + 5.0 * t, 0.0, 0.0, 5.0 if t < ends_s else 0.0, 0.0, 0.0)
        for t in range(int(ends_s) + 1)
    ]
    purpose = "approach" if "approach" in reference_id else "manoeuvre"
    return Reference(
        reference_id, "ot1", "v", purpose, 0, execute_at_ns, execute_at_ns + NS_PER_S, points
    )


@dataclass
class Talk:
    """A conversation, its time, and all that was sent."""

    settings: Settings
    now_ns: int = T0
    decided: TrajectoryDecision = field(
        default_factory=lambda: TrajectoryDecision(P.CONNECTED, C.DISARMED)
    )
    reported: NewestReport = field(
        default_factory=lambda: NewestReport(connected=True, number=C.DISARMED, has_report=True)
    )
    sent: list[Message] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.conversation = Conversation(self.settings)
        self.conversation.on_connected(self.now_ns)

    def run(self, seconds: float = 0.0) -> None:
        end_ns = self.now_ns + seconds_to_ns(seconds)
        while True:
            self.conversation.step(self.decided, self.reported, self.now_ns)
            self.sent += self.conversation.due(self.now_ns)
            if self.now_ns >= end_ns:
                return
            self.now_ns += STEP_NS

    def says(self, state: int | None, speed_mps: float = 0.0) -> None:
        self.reported = replace(self.reported, number=state, speed_mps=speed_mps)

    def decides(self, state: C, session: P | None = None, *references: Reference) -> None:
        given = references or self.decided.references
        self.decided = TrajectoryDecision(
            self.decided.session if session is None else session, state, tuple(given)
        )

    def of(self, kind: type) -> list[Message]:
        return [message for message in self.sent if isinstance(message, kind)]

    @property
    def violation(self) -> SafetyCode | None:
        found = self.conversation.check.violation
        return None if found is None else found.code

    @property
    def words(self) -> str:
        found = self.conversation.check.violation
        return "" if found is None else found.words

    @property
    def status(self) -> CentreStatus | None:
        heab = self.conversation.heab(self.now_ns)
        return None if heab is None else CentreStatus(heab.status)


def talk(*, honours_start_time: bool = False, approach: bool = True) -> Talk:
    first = along_x("ot1 approach", 0, 20) if approach else None
    return Talk(Settings(7, DATUM, LIMITS, first, STANDS, honours_start_time))


def armed(**settings: bool) -> Talk:
    t = talk(**settings)
    t.run(1.0)
    t.decides(C.PRE_ARMING)
    t.run(0.1)
    t.says(C.ARMED)
    t.decides(C.ARMED, P.ARMED)
    t.run(0.1)
    return t


def running(speed_mps: float = 5.0, **settings: bool) -> Talk:
    t = armed(**settings)
    t.decides(C.RUNNING, P.RUNNING, along_x("r approach", t.now_ns + NS_PER_S // 2, 20))
    t.run(0.5)
    t.says(C.RUNNING, speed_mps)
    t.run(0.5)
    return t


def test_an_object_gets_its_settings_and_first_trajectory_at_once_and_is_asked_who_it_is() -> None:
    t = talk()
    t.run()
    osem, traj = t.sent
    assert isinstance(osem, Osem)
    assert (osem.device_id, osem.heab_timeout_s, osem.rotation_rad) == (7, 0.5, 0.0)
    assert (osem.latitude_deg, osem.longitude_deg, osem.altitude_m) == (57.0, 12.0, 200.0)
    assert isinstance(traj, Traj)
    assert (traj.points[0].x_m, traj.points[-1].t_s, traj.points[-1].x_m) == (0.0, 20.0, 100.0)
    t.run(PAUSE_NS / NS_PER_S)
    assert isinstance(t.sent[2], Dreq)


def test_deviations_beyond_what_an_osem_can_say_are_sent_as_its_largest() -> None:
    wide = LIMITS.model_copy(update={"error_longitudinal_m": 1000.0, "error_lateral_m": 100.0})
    osem = message_of(encode(Settings(7, DATUM, wide, None, STANDS).osem(T0)))
    assert isinstance(osem, Osem)
    assert (osem.max_way_deviation_m, osem.max_lateral_deviation_m) == (65.534, 65.534)


def test_one_without_an_approach_gets_a_standstill() -> None:
    t = talk(approach=False)
    t.run()
    assert t.sent[1] == STANDS


def test_it_is_armed_once_and_counts_as_armed_when_it_says_so() -> None:
    t = talk()
    t.run(1.0)
    assert t.conversation.check.cannot_arm == ()
    t.decides(C.PRE_ARMING)
    t.run(0.1)
    assert t.of(Ostm) == [Ostm(ObjectCommand.ARM)]
    assert not t.conversation.check.armed
    t.says(C.ARMED)
    t.run(0.1)
    assert t.conversation.check.armed
    t.decides(C.DISARMED)
    t.run(0.1)
    assert t.of(Ostm)[-1] == Ostm(ObjectCommand.DISARM)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"gate": ("no probe report",)}, ["no probe report"]),
        ({"connected": False}, ["its test object isn't connected"]),
        ({"connected": False, "problem": "refused"}, ["its test object isn't connected: refused"]),
        ({"has_report": False}, ["its test object sends no MONR"]),
        ({"number": 5}, ["its test object reports POSTRUN (5), not DISARMED (3)"]),
        ({"number": 77}, ["its test object reports 77 (no known state), not DISARMED (3)"]),
        ({"number": None}, ["its test object reports no state, not DISARMED (3)"]),
        ({"errors": ObjectError.ABORT_REQUEST}, ["its test object requests an abort"]),
        (
            {"errors": ObjectError.OUTSIDE_GEOFENCE},
            ["its test object says that it is outside its geofence"],
        ),
        (
            {"errors": ObjectError.ENGINE_FAULT | ObjectError.BATTERY_FAULT},
            [
                "its test object reports an engine fault",
                "its test object reports a battery fault",
            ],
        ),
        ({"errors": ObjectError.VENDOR | ObjectError.OTHER}, []),
        (
            {"gate": ("no probe report", "another firmware"), "has_report": False},
            ["no probe report", "another firmware", "its test object sends no MONR"],
        ),
    ],
)
def test_all_that_keeps_it_from_being_armed_is_listed(
    changes: dict[str, object], words: list[str]
) -> None:
    t = talk()
    t.reported = replace(t.reported, **changes)  # type: ignore[arg-type]
    t.run()
    assert list(t.conversation.check.cannot_arm) == words


@pytest.mark.parametrize("session", [P.ARMED, P.RUNNING])
def test_an_object_that_its_target_refused_to_arm_contradicts_nothing(session: P) -> None:
    """The session may be armed for others, and its heartbeat before the call to arm."""
    t = talk()
    t.run(10.0)
    t.decides(C.DISARMED, session)
    t.run(5.0)
    assert t.violation is None
    t.says(C.RUNNING)
    t.run(0.1)
    assert t.violation is SafetyCode.OBJECT_CONTRADICTS
    assert t.words == "reports RUNNING (4) 1 s after it was to stand disarmed"


def test_one_that_honours_start_times_is_told_at_once_and_others_at_that_time() -> None:
    for honours in (True, False):
        t = armed(honours_start_time=honours)
        start_ns = t.now_ns + NS_PER_S // 2
        t.decides(C.RUNNING, P.RUNNING, along_x("r approach", start_ns, 20))
        t.run(0.4)
        assert bool(t.of(Strt)) is honours
        t.run(0.1)
        week, time_of_week_ns = to_gps(start_ns)
        assert t.of(Strt) == [Strt(time_of_week_ns, week)]


def test_the_start_is_measured_against_its_time() -> None:
    t = armed(honours_start_time=True)
    t.decides(C.RUNNING, P.RUNNING, along_x("r approach", t.now_ns + NS_PER_S // 2, 20))
    t.run(0.2)
    t.says(C.RUNNING)
    t.run(0.1)
    assert t.conversation.timing.start_error_s == pytest.approx(-0.3, abs=0.011)


def test_an_approach_that_it_was_not_armed_with_is_refused() -> None:
    t = armed()
    t.decides(C.RUNNING, P.RUNNING, along_x("r approach", t.now_ns + NS_PER_S // 2, 19))
    t.run(1.0)
    assert t.violation is SafetyCode.REFERENCE_REFUSED
    assert t.of(Strt) == []


def test_a_manoeuvre_replaces_what_was_to_be_driven_and_stands_to_the_old_end() -> None:
    t = running()
    start_ns = t.decided.references[0].execute_at_ns
    manoeuvre = along_x("turn", start_ns + 3 * NS_PER_S, 4, x_m=15.0)
    t.decides(C.RUNNING, P.RUNNING, t.decided.references[0], manoeuvre)
    t.run(0.1)
    first, second = t.of(Traj)
    assert isinstance(first, Traj)
    assert isinstance(second, Traj)
    assert second.trajectory_id != first.trajectory_id
    times = [round(point.t_s * 1000) for point in second.points]
    assert times[0] == 3000
    # Every time that it had beyond is there again, as a standstill at the new end.
    old = {round(point.t_s * 1000) for point in first.points}
    assert {time for time in old if time >= 3000} <= set(times)
    ends = [point for point in second.points if point.t_s >= 7.0]
    assert {(point.x_m, point.speed_mps) for point in ends} == {(35.0, 0.0)}
    t.run(1.0)
    assert len(t.of(Traj)) == 2


def test_one_without_an_approach_is_started_at_once() -> None:
    t = armed(approach=False)
    t.decides(C.RUNNING, P.RUNNING)
    t.run()
    assert len(t.of(Strt)) == 1


def test_a_heartbeat_says_the_sessions_state_until_the_object_must_stop() -> None:
    t = talk()
    t.decides(C.INIT, P.UNKNOWN)
    t.run()
    assert t.status is CentreStatus.INIT
    t = running()
    assert t.status is CentreStatus.RUNNING
    t.decides(C.POSTRUN)
    t.run()
    assert t.status is CentreStatus.NORMAL_STOP
    t.decides(C.ABORTING)
    t.run()
    assert t.status is CentreStatus.ABORT


def test_a_reference_that_is_over_and_not_obeyed_is_a_normal_stop() -> None:
    t = running()
    t.run(21.0)
    assert t.status is CentreStatus.NORMAL_STOP
    t = running(speed_mps=0.0)
    t.run(21.0)
    assert t.status is CentreStatus.RUNNING
    # At its end an object may leave the run by itself.
    t.says(C.POSTRUN)
    t.run(2.0)
    assert t.violation is None


def test_an_object_that_slows_in_time_is_measured_and_well() -> None:
    t = running()
    t.decides(C.ABORTING)
    t.run(0.4)
    t.says(C.ABORTING, 4.6)
    t.run(3.0)
    assert t.violation is None
    assert t.conversation.timing.stop_s == pytest.approx(0.4, abs=0.011)


def test_one_that_is_deaf_to_the_normal_stop_and_the_abort_hears_nothing_any_more() -> None:
    t = running()
    t.decides(C.POSTRUN, P.STOPPING)
    t.says(C.POSTRUN, 5.0)
    t.run(1.02)
    assert t.violation is SafetyCode.NOT_STOPPING
    assert t.status is CentreStatus.NORMAL_STOP
    t.decides(C.ABORTING)
    t.run(1.0)
    assert t.status is CentreStatus.ABORT
    t.run(0.03)
    assert t.status is None


@pytest.mark.parametrize(
    ("at_first_mps", "then"),
    [
        # It was about to start, and starts.
        (0.25, [(0.5, 2.0), (0.45, 10.0)]),
        # It slows once.
        (5.0, [(0.3, 4.6), (0.2, 5.0), (0.45, 5.0)]),
        # It brakes, and drives on.
        (5.0, [(0.3, 4.0), (2.0, 1.0), (0.02, 1.5)]),
        # It stands, but not for good.
        (5.0, [(0.3, 2.0), (0.3, 0.0), (1.3, 0.0), (0.02, 0.5)]),
    ],
)
def test_one_that_does_not_brake_to_a_standstill_after_an_abort_hears_nothing_any_more(
    at_first_mps: float, then: list[tuple[float, float]]
) -> None:
    t = running(at_first_mps)
    t.decides(C.ABORTING)
    t.says(C.ABORTING, at_first_mps)
    for seconds, speed_mps in then:
        t.run(seconds)
        assert t.status is CentreStatus.ABORT
        t.says(C.ABORTING, speed_mps)
    t.run(0.1)
    assert t.violation is SafetyCode.NOT_STOPPING
    assert t.status is None


def test_an_abort_after_a_normal_stop_must_be_obeyed_too() -> None:
    t = running()
    t.decides(C.POSTRUN, P.STOPPING)
    t.run(0.2)
    t.says(C.POSTRUN, 4.5)
    t.run(1.5)
    assert t.violation is None
    t.decides(C.ABORTING)
    t.run(1.02)
    assert t.violation is SafetyCode.NOT_STOPPING
    assert "to abort" in t.words
    assert t.status is None


def test_noise_of_a_stated_speed_and_a_crew_at_the_wheel_are_no_disobedience() -> None:
    t = running()
    t.decides(C.ABORTING)
    for step in range(400):
        noise_mps = (-0.1, 0.1, 0.0)[step % 3]
        t.says(C.ABORTING, max(5.0 - 0.02 * step, 0.0) + noise_mps)
        t.run(0.01)
    # It has stood for more than a second.
    t.says(C.ABORTING, 3.0)
    t.run(5.0)
    assert t.violation is None
    assert t.status is CentreStatus.ABORT


@pytest.mark.parametrize(
    ("state", "text", "measured"),
    [
        (C.ABORTING, "ABORTING (7)", 7.0),
        (C.INIT, "INIT (1)", 1.0),
        (C.DISARMED, "DISARMED (3)", 3.0),
        (77, "77 (no known state)", 77.0),
        (None, "no state", -1.0),
    ],
)
def test_a_contradiction_while_running_is_told_at_once(
    state: int | None, text: str, measured: float
) -> None:
    t = running()
    t.says(state, 5.0)
    t.run()
    assert t.violation is SafetyCode.OBJECT_CONTRADICTS
    assert t.words == f"reports {text} while it is to run"
    assert t.conversation.check.violation.measured == measured  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("errors", "text"),
    [
        (ObjectError.ABORT_REQUEST, "requests an abort"),
        (ObjectError.OUTSIDE_GEOFENCE, "says that it is outside its geofence"),
    ],
)
def test_an_object_that_must_not_drive_ends_what_its_target_does(
    errors: ObjectError, text: str
) -> None:
    running_talk, armed_talk, arming, stopping = running(), armed(), talk(), running()
    arming.decides(C.PRE_ARMING)
    stopping.decides(C.POSTRUN, P.STOPPING)
    for t in (running_talk, armed_talk, arming, stopping):
        t.reported = replace(t.reported, errors=errors)
        t.run()
        assert t.violation is SafetyCode.OBJECT_CONTRADICTS
        assert t.words == f"{t.reported.text} and {text}"


@pytest.mark.parametrize("state", [C.DISARMED, C.ABORTING])
def test_errors_of_an_object_that_is_not_to_drive_end_nothing(state: C) -> None:
    t = talk()
    t.reported = replace(t.reported, errors=0xFF)
    t.decides(state)
    t.run(5.0)
    assert t.violation is None


@pytest.mark.parametrize("errors", [ObjectError.ENGINE_FAULT, ObjectError.BATTERY_FAULT])
def test_a_fault_of_engine_or_battery_alone_ends_no_run(errors: ObjectError) -> None:
    t = running()
    t.reported = replace(t.reported, errors=errors)
    t.run(1.0)
    assert t.violation is None


def test_an_object_that_does_not_follow_is_waited_for_and_then_told() -> None:
    t = armed()
    t.decides(C.RUNNING, P.RUNNING, along_x("r approach", t.now_ns + NS_PER_S // 2, 20))
    t.run(0.4)
    assert t.conversation.check.missed_start is None
    t.run(0.1 + LAG_S)
    assert t.violation is None
    assert t.conversation.check.missed_start is not None
    assert t.conversation.check.missed_start.words == "reports ARMED (2) 1 s after its start time"
    t.run(0.02)
    assert t.violation is SafetyCode.OBJECT_CONTRADICTS
    assert t.words == "reports ARMED (2) 1 s after it should have started"
    t = talk()
    t.run(1.0)
    t.decides(C.PRE_ARMING)
    t.run(ARMING_S)
    assert t.violation is None
    t.run(0.02)
    assert t.violation is SafetyCode.OBJECT_CONTRADICTS
    assert t.words == "reports DISARMED (3) 3 s after it was asked to arm"


def test_a_lost_connection_counts_where_the_object_may_move() -> None:
    for t, expected in ((running(), SafetyCode.CONNECTION_LOST), (talk(), None)):
        t.reported = replace(t.reported, connected=False, number=None)
        t.run(2.0)
        assert t.violation is expected


def test_an_aborting_object_is_cleared_only_by_a_person() -> None:
    t = talk()
    t.says(C.ABORTING)
    t.run(LAG_S + 0.02)
    assert t.violation is SafetyCode.OBJECT_CONTRADICTS
    t.decides(C.ABORTING, P.ABORTED)
    t.run(1.0)
    t.decides(C.DISARMED)
    t.run(0.1)
    # The heartbeat still says ABORT: an all clear would not last.
    assert t.of(Ostm) == []
    t.decides(C.DISARMED, P.CONNECTED)
    t.run(0.1)
    assert t.of(Ostm) == [Ostm(ObjectCommand.ALL_CLEAR)]
    assert t.violation is None
    t.says(C.DISARMED)
    t.run(2.0)
    assert t.violation is None
