"""The findings of ``ssp doctor --session`` about the messages that it heard."""

import math
from dataclasses import replace

import pytest

from ssp_core import names
from ssp_core.cli import main
from ssp_core.clock import seconds_to_ns
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.link_quality import LinkEstimate
from ssp_core.safety.object_rules import RulesCheck
from ssp_core.vocabulary import ControlState, Role, SessionPhase
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.doctor.checks import Status
from ssp_scenario_manager.doctor.session import SessionObservation, Stream, failed, session_findings
from tests.support.states import object_state

NOW_NS = seconds_to_ns(1_800_000_000.0)


@pytest.fixture(scope="module")
def live():
    task = compile_task(Request(event="cut_in", target="track", site="north_track")).task
    return task.run.model_copy(update={"mode": "live", "camera": None})


def stream(hz=50.0, age_s=0.01, count=250, frame_id=names.MAP_FRAME, frames=names.MAP_FRAME):
    """A regular stream that ends at NOW_NS."""
    made = Stream(frame_id)
    for k in range(count):
        arrival_ns = NOW_NS - seconds_to_ns((count - 1 - k) / hz)
        made.hear(arrival_ns, arrival_ns - seconds_to_ns(age_s), frames)
    return made


def state(participant, role, control=ControlState.DISARMED):
    start = participant.start
    return object_state(
        participant.id,
        participant.cls,
        start.x_m,
        start.y_m,
        start.yaw_rad,
        role=role,
        stamp_ns=NOW_NS - seconds_to_ns(0.01),
        size=participant.size,
        control_state=control,
        position_std_m=0.02,
    )


@pytest.fixture
def sound(live):
    target = live.targets[0]
    return SessionObservation(
        streams={live.vut.id: stream(), target.id: stream()},
        states={
            live.vut.id: state(live.vut, Role.VUT, ControlState.OFF),
            target.id: state(target, Role.OT),
        },
        lost={},
        links={target.id: LinkEstimate(0.001, 0.004)},
        managers=frozenset({"scenario_manager"}),
        recorder_ready=True,
        recorder_missing=(),
        rules={target.id: RulesCheck("sha256:a")},
        now_ns=NOW_NS,
    )


def finding(spec, heard, name):
    return next(f for f in session_findings(spec, heard) if f.name == name)


def test_a_sound_session_can_arm(live, sound):
    findings = session_findings(live, sound)
    assert [f.status for f in findings] == [Status.OK] * len(findings)
    assert not failed(findings)
    assert findings[-1].text == "nothing keeps this session from arming"


@pytest.mark.parametrize(
    ("changes", "status", "words"),
    [
        ({"hz": 20.0}, Status.FAIL, "the run wants 50 Hz"),
        ({"age_s": 0.6}, Status.FAIL, "stamps up to 0.600 s old"),
        ({"age_s": -0.2}, Status.FAIL, "0.200 s ahead of this host's clock"),
        ({"frames": "odom"}, Status.FAIL, "frame 'odom', must be 'map'"),
        ({"count": 0}, Status.FAIL, "nothing arrives on /ssp/vut/state"),
    ],
)
def test_what_is_wrong_with_a_stream_is_said(live, sound, changes, status, words):
    heard = replace(sound, streams={**sound.streams, "vut": stream(**changes)})
    found = finding(live, heard, "state of vut")
    assert (found.status, words in found.text) == (status, True)


def test_stamps_that_go_back_and_pauses_are_told(live, sound):
    standing = stream()
    standing.stamps_ns[100] = standing.stamps_ns[98]
    heard = replace(sound, streams={**sound.streams, "vut": standing})
    found = finding(live, heard, "state of vut")
    assert (found.status, "1 stamps before the one before" in found.text) == (Status.FAIL, True)
    paused = stream()
    paused.arrivals_ns[:-1] = [at - seconds_to_ns(0.2) for at in paused.arrivals_ns[:-1]]
    paused.stamps_ns[:-1] = [at - seconds_to_ns(0.2) for at in paused.stamps_ns[:-1]]
    heard = replace(sound, streams={**sound.streams, "vut": paused})
    found = finding(live, heard, "state of vut")
    assert (found.status, "a pause of 0.220 s" in found.text) == (Status.WARN, True)


@pytest.mark.parametrize(
    ("hz", "pause_s", "status", "words"),
    [
        (100.0, 0.0, Status.OK, "100.0 Hz from the object, longest pause 0.010 s"),
        (30.0, 0.0, Status.FAIL, "the run wants 50 Hz"),
        (100.0, 0.6, Status.FAIL, "longest pause 0.610 s; limit 0.3 s"),
        (100.0, 10.0, Status.FAIL, "the run wants 50 Hz"),
    ],
)
def test_the_rate_of_an_iso_22133_objects_reports_is_judged(
    live, sound, hz, pause_s, status, words
):
    frames = stream(hz, 0.0)
    for k in range(100):
        frames.arrivals_ns[k] -= seconds_to_ns(pause_s)
        frames.stamps_ns[k] -= seconds_to_ns(pause_s)
    found = finding(live, replace(sound, frames={"ot1": frames}), "frames of ot1")
    assert (found.status, words in found.text) == (status, True), found


def test_an_object_that_tells_no_frames_has_no_finding_of_them(live, sound):
    assert not [f for f in session_findings(live, sound) if f.name.startswith("frames")]


def test_an_object_that_has_nothing_new_now_and_then_is_sound(live, sound):
    """Its loop and its body's drift past each other: some states come a second time."""
    target = live.targets[0].id
    drifting = stream()
    for k in range(20, 250, 25):
        drifting.stamps_ns[k] = drifting.stamps_ns[k - 1]
    heard = replace(sound, streams={**sound.streams, target: drifting})
    found = finding(live, heard, f"state of {target}")
    assert (found.status, found.remedy) == (Status.OK, "")
    assert "10 of 250 repeat the previous stamp" in found.text
    assert not failed(session_findings(live, heard))


def frozen(made):
    """New messages to the end, but of one state since the middle."""
    half = len(made.stamps_ns) // 2
    made.stamps_ns[half:] = [made.stamps_ns[half]] * (len(made.stamps_ns) - half)


def doubled(made):
    """Two publishers of the same states."""
    made.stamps_ns[1::2] = made.stamps_ns[::2]


def interleaved(made):
    """Two publishers, one of which is 0.1 s behind."""
    made.stamps_ns[1::2] = [stamp - seconds_to_ns(0.1) for stamp in made.stamps_ns[1::2]]


@pytest.mark.parametrize(
    ("wrong", "hz", "words"),
    [
        (frozen, 50.0, "the run wants 50 Hz"),
        (frozen, 50.0, "s old, limit 0.3 s"),
        (frozen, 50.0, "a pause of 2.4"),
        (doubled, 50.0, "125 of 250 repeat the previous stamp"),
        (doubled, 100.0, "125 of 250 repeat the previous stamp"),
        (interleaved, 100.0, "125 stamps before the one before"),
    ],
)
def test_a_frozen_and_a_doubled_publisher_fail(live, sound, wrong, hz, words):
    made = stream(hz)
    wrong(made)
    found = finding(live, replace(sound, streams={**sound.streams, "vut": made}), "state of vut")
    assert (found.status, words in found.text) == (Status.FAIL, True), found.text
    assert found.remedy


@pytest.mark.parametrize("state", [SessionPhase.ARMED, SessionPhase.RUNNING, SessionPhase.STOPPING])
def test_of_a_session_that_is_armed_already_arming_is_not_asked(live, sound, state):
    """Its objects run, far from their starts: that is no wrong wiring."""
    moved = replace(sound.states["vut"], x_m=sound.states["vut"].x_m + 5.0, speed_mps=9.0)
    heard = replace(sound, states={**sound.states, "vut": moved})
    assert finding(live, heard, "arming").status is Status.FAIL
    found = finding(live, replace(heard, session=state), "arming")
    assert (found.status, state.name in found.text) == (Status.OK, True)


@pytest.mark.parametrize(("late", "status"), [(12, Status.WARN), (13, Status.FAIL)])
def test_a_busy_moment_is_a_warning_and_a_late_link_fails(live, sound, late, status):
    made = stream()
    made.stamps_ns = [
        stamp - seconds_to_ns(0.35 if k < late else 0.0) for k, stamp in enumerate(made.stamps_ns)
    ]
    found = finding(live, replace(sound, streams={**sound.streams, "vut": made}), "state of vut")
    assert (found.status, f"limit 0.3 s ({late} of 250)" in found.text) == (status, True)


def test_lost_states_are_a_warning(live, sound):
    found = finding(live, replace(sound, lost={"vut": 3}), "state of vut")
    assert (found.status, "3 lost on the way" in found.text) == (Status.WARN, True)


@pytest.mark.parametrize(
    ("link", "words"),
    [
        (LinkEstimate(0.2, 0.004), "clock off by +200.0 ms"),
        (LinkEstimate(0.0, 0.9), "900.0 ms there and back"),
        (LinkEstimate(), "heartbeats aren't answered"),
    ],
)
def test_links_are_held_to_the_limits_of_arming(live, sound, link, words):
    target = live.targets[0].id
    heard = replace(sound, links={target: link})
    found = finding(live, heard, f"link to {target}")
    assert (found.status, words in found.text) == (Status.FAIL, True)
    assert finding(live, heard, "arming").status is Status.FAIL


@pytest.mark.parametrize(
    ("rules", "status", "words"),
    [
        (RulesCheck("d"), Status.OK, "as in this run"),
        (
            RulesCheck("d", "", ("limits.speed_mps 8.0 instead of 14.0",)),
            Status.OK,
            "its own limits",
        ),
        (RulesCheck("d", "judges by another geofence[1]"), Status.FAIL, "another geofence[1]"),
        (RulesCheck("", "has not said what"), Status.FAIL, "has not said what"),
    ],
)
def test_what_an_object_judges_by_is_held_against_the_run(live, sound, rules, status, words):
    target = live.targets[0].id
    heard = replace(sound, rules={target: rules})
    found = finding(live, heard, f"rules of {target}")
    assert (found.status, words in found.text) == (status, True), found
    arming = finding(live, heard, "arming")
    assert (arming.status, rules.problem in arming.text) == (status, True), arming
    assert failed(session_findings(live, heard)) == (status is Status.FAIL)


def test_no_manager_two_managers_and_a_waiting_recorder(live, sound):
    none = replace(sound, managers=frozenset(), links={})
    assert "no heartbeat" in finding(live, none, "scenario_manager").text
    two = replace(sound, managers=frozenset({"a", "b"}))
    assert "2 send heartbeats: a, b" in finding(live, two, "scenario_manager").text
    assert "publishers too many" in finding(live, two, "arming").text
    waiting = replace(sound, recorder_ready=False, recorder_missing=("/ssp/ot1/state",))
    assert finding(live, waiting, "recorder").text == "waits for /ssp/ot1/state"


def test_arming_lists_everything_at_once(live, sound):
    moved = replace(sound.states["vut"], x_m=sound.states["vut"].x_m + 5.0, position_std_m=math.inf)
    heard = replace(sound, states={**sound.states, "vut": moved}, recorder_ready=None)
    text = finding(live, heard, "arming").text
    for words in ("5.00 m from its start", "uncertain", "the recorder is silent"):
        assert words in text


def test_a_camera_needs_frames_and_a_calibration(live, sound):
    spec = live.model_copy(update={"camera": type(live).model_fields["camera"].default})
    streams = {**sound.streams, names.CAMERA_IMAGE: stream(10.0, 0.1, 50, None, "camera")}
    heard = replace(sound, streams={**streams, names.CAMERA_INFO: Stream()})
    assert "no calibration" in finding(spec, heard, "camera").text
    heard = replace(heard, streams={**streams, names.CAMERA_INFO: stream(10.0, 0.1, 50, None, "c")})
    assert finding(spec, heard, "camera").status is Status.OK


def test_only_a_live_session_can_be_listened_to(live, tmp_path, capsys):
    path = tmp_path / "run.yaml"
    path.write_text(live.model_copy(update={"mode": "lockstep"}).model_dump_json(by_alias=True))
    assert main(["doctor", "--session", str(path)]) == 1
    assert "mode" in capsys.readouterr().err


def test_motion_that_contradicts_its_places_fails_and_near_misses_are_counted(live, sound):
    def watched(stated_mps):
        watch = ConsistencyWatch(Bounds())
        for k in range(100):
            watch.take(k * 20_000_000, 0.16 * k, 0.0, 0.0, stated_mps)
        return replace(sound, motion={"vut": watch})

    name = "motion of vut"
    still = replace(sound, motion={"vut": ConsistencyWatch(Bounds())})
    assert finding(live, still, name).text.startswith("it stood: ")
    by_course = live.limits.model_copy(update={"heading_by_course": ["vut"]})
    told = finding(live.model_copy(update={"limits": by_course}), still, name).text
    assert told.endswith("(limits.heading_by_course): judged on its first metre")
    good = finding(live, watched(8.0), name)
    assert (good.status, "agrees with its places in 75 windows" in good.text) == (Status.OK, True)
    near = finding(live, watched(10.4), name)
    assert (near.status, "75 near misses, at most 92%" in near.text) == (Status.WARN, True)
    bad = watched(0.0)
    assert finding(live, bad, name).status is Status.FAIL
    assert "empty twist: 0.00 m/s stated, way of 8.00 m/s" in finding(live, bad, name).text
    assert "the states of vut contradict its places" in session_findings(live, bad)[-1].text


def test_a_stranger_and_lost_messages_keep_the_session_from_arming(live, sound):
    text = "ot1/state has /ssp/object_target and /ssp/intruder"
    heard = replace(sound, strangers={"ot1/state": (1, text)})
    found = finding(live, heard, "publishers")
    assert (found.status, found.text) == (Status.FAIL, text)
    assert found.remedy
    arming = finding(live, heard, "arming")
    waits = "one whose process has ended is forgotten within 20 s"
    assert arming.text == f"1 publishers too many, limit 0: {text}; {waits}"
    lossy = replace(sound, recorder_lost=3)
    assert finding(live, lossy, "recorder").text == "has lost 3 messages"
    assert "the recorder has lost 3 messages, limit 0" in finding(live, lossy, "arming").text
