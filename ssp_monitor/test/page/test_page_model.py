"""The contents of the page, made of the messages that were heard."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.motion.state import ObjectState
from ssp_core.node_interface import Level
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.arming import (
    ARM_AGAIN_S,
    ARM_FAILED,
    Facts,
    Gate,
    obstacles,
    refusal_text,
)
from ssp_core.safety.body_status import BodyStatus
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.liveness import signs_of_life
from ssp_core.safety.object_rules import ReceivedRules, rules_of
from ssp_core.safety.publishers import LINKS_FRESH_S, MOST_TOLD
from ssp_core.vocabulary import ControlState, ObjectClass, Phase, Role, SessionPhase, Verdict
from ssp_monitor.page.snapshot import (
    COMMANDS,
    MOST_POINTS,
    Pictures,
    Snapshots,
    number,
    site_message,
)
from ssp_monitor.status import health as status_health
from ssp_monitor.status import messages
from ssp_monitor.status.board import (
    MOST_EVENTS,
    MOST_OBJECTS,
    Board,
    Event,
    LatestReport,
    LinkFact,
    ManagerStatus,
    RecorderFact,
    SessionFact,
)
from ssp_monitor.status.health import ClockWatch, health, standing_in_the_way
from tests.support.states import object_state

S = 1_000_000_000
NOT_MEASURED = "clock offset and link delay of ot1 are not measured: no answer to heartbeats"
GONE = BodyStatus("ot1", ("no program listens at udp://10.0.0.21:9001",))
UNPROBED = BodyStatus("ot1", (), ("it has no probe report",), lasting=True)


def state(name: str, role: Role = Role.OT, **changes: Any) -> ObjectState:
    disarmed = {"stamp_ns": 5 * S, "control_state": ControlState.DISARMED}
    return object_state(name, role=role, **disarmed | changes)


@pytest.fixture
def run(run_mapping):
    run_mapping["vut"]["approach"] = {"path": [[0.0, 0.0], [290.0, 0.0]], "cruise_mps": 10.0}
    run_mapping["geofence"] = [[-20.0, -20.0], [300.0, -20.0], [300.0, 20.0], [-20.0, 20.0]]
    for target, x_m in zip(run_mapping["targets"], (30.0, 60.0), strict=True):
        target["start"] = {"x_m": x_m, "y_m": 6.0, "yaw_rad": 0.0}
    return RunSpec.model_validate(run_mapping)


def ready_board(run: RunSpec) -> Board:
    """Everything as it must be to arm, heard at 10 s."""
    board = Board(run)
    at_ns = 10 * S
    board.manager.at_ns = at_ns
    board.camera = LatestReport("", at_ns)
    board.hear_session(SessionFact(5 * S, SessionPhase.CONNECTED), at_ns)
    board.hear_states([state("vut", Role.VUT)], at_ns)
    walker = state("walker", object_class=ObjectClass.PEDESTRIAN, x_m=60.0, y_m=6.0)
    board.hear_states([state("ot1", x_m=30.0, y_m=6.0), walker], at_ns)
    board.hear_links({i: LinkFact(0.0, 0.001, 0.01, 10, 0) for i in ("ot1", "walker")}, at_ns)
    board.hear_recorder(RecorderFact(ready=True), at_ns)
    for target in run.targets:
        board.rules.hear((target.id, rules_of(run, target.id)))
    return board


def set_live(board: Board, status: BodyStatus, at_ns: int) -> None:
    """The run is a live one, and the process of an object says how its body is."""
    assert board.run is not None
    board.run = board.run.model_copy(update={"mode": "live"})
    board.hear_body(status, at_ns)


def other_limits(board: Board, **limits: float) -> None:
    """An object says that it judges by these."""
    run = board.run
    assert run is not None
    theirs = run.model_copy(update={"limits": run.limits.model_copy(update=limits)})
    board.rules.hear(("ot1", rules_of(theirs, "ot1")))


def test_an_objects_own_stricter_limit_is_shown_and_stands_in_nobodys_way(run):
    board = ready_board(run)
    other_limits(board, heartbeat_s=0.25)
    assert standing_in_the_way(board, 10 * S) == []
    shown = [dict(one.values) for one in health(board, ClockWatch(), 10 * S) if one.part == "ot1"]
    assert shown[0]["its own stricter limits"] == "limits.heartbeat_s 0.25 instead of 0.5"


def test_a_heading_that_is_not_known_at_rest_is_shown(run):
    limits = run.limits.model_copy(update={"heading_by_course": ["ot1"]})
    for one, words in ((run, ""), (run.model_copy(update={"limits": limits}), "first metre")):
        parts = health(ready_board(one), ClockWatch(), 10 * S)
        (shown,) = (dict(part.values) for part in parts if part.part == "ot1")
        assert shown["heading at rest"].endswith(words)
        assert bool(shown["heading at rest"]) == bool(words)


def test_nothing_stands_in_the_way_of_what_is_ready(run):
    board = ready_board(run)
    assert standing_in_the_way(board, 10 * S) == []
    assert Snapshots(board).stale(10 * S) == []


def test_what_an_adapter_said_long_ago_stands_in_nobodys_way(run):
    board = ready_board(run)
    board.hear_localisation("fix type", 8 * S - 1)
    assert standing_in_the_way(board, 10 * S) == []
    board.hear_localisation("", 10 * S)
    assert standing_in_the_way(board, 10 * S) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda b: setattr(b, "manager", ManagerStatus()), "the scenario manager is silent"),
        (lambda b: setattr(b, "camera", LatestReport("")), "no camera frame arrives"),
        (
            lambda b: setattr(b, "recorder", LatestReport(b.recorder.value)),
            "the recorder is silent",
        ),
        (
            lambda b: b.hear_recorder(RecorderFact(False, missing=("/ssp/x",)), 10 * S),
            "the recorder is not ready: /ssp/x",
        ),
        (
            lambda b: b.hear_recorder(RecorderFact(True, lost=3), 10 * S),
            "the recorder has lost 3 messages, limit 0",
        ),
        (
            lambda b: b.hear_recorder(RecorderFact(False, failure="disk full"), 10 * S),
            "the recorder is not ready: disk full",
        ),
        (
            lambda b: b.hear_localisation("fix type: FIX, GBAS is asked for", 8 * S),
            "the VUT's GNSS/INS gives no state: fix type: FIX, GBAS is asked for",
        ),
        (lambda b: b.objects.pop("ot1"), "no state of ot1 arrives"),
        (
            lambda b: (b.objects.pop("ot1"), set_live(b, GONE, 8 * S)),
            "no state of ot1 arrives: no program listens at udp://10.0.0.21:9001",
        ),
        (lambda b: set_live(b, UNPROBED, 8 * S), "ot1: it has no probe report"),
        (
            lambda b: other_limits(b, heartbeat_s=60.0),
            "ot1 judges by another limits.heartbeat_s: 60.0 on its host, 0.5 here",
        ),
        (
            lambda b: setattr(b, "rules", ReceivedRules()),
            "ot1 has not said what it judges by",
        ),
        (lambda b: b.links.value.clear(), NOT_MEASURED),
        (
            lambda b: b.hear_links({"ot1": LinkFact(0.2, 0.9)}, 10 * S),
            "the link to ot1 takes 0.900 s there and back, limit 0.5 s",
        ),
        (
            lambda b: b.hear_links({"ot1": LinkFact(0.2, 0.1)}, 10 * S),
            "the clock of ot1 is off by 0.200 s, limit 0.1 s",
        ),
        (
            lambda b: b.hear_states([state("ot1", x_m=33.0, y_m=6.0)], 10 * S),
            "ot1 is 3.00 m from its start, limit 1.5 m",
        ),
        (
            lambda b: b.hear_states([state("vut", Role.VUT, speed_mps=0.2)], 10 * S),
            "vut moves at 0.20 m/s, limit 0.05 m/s",
        ),
        (
            lambda b: b.hear_states([state("vut", Role.VUT, x_m=math.nan)], 10 * S),
            "vut has a state with a value that is no number",
        ),
        (
            lambda b: b.hear_states([state("vut", Role.VUT, position_std_m=0.7)], 10 * S),
            "the position of vut is uncertain by 0.70 m, limit 0.5 m",
        ),
        (
            lambda b: b.hear_session(SessionFact(0, SessionPhase.ARMED), 10 * S),
            "ot1 is DISARMED, not ARMED",
        ),
        (lambda b: b.hear_session(SessionFact(0, SessionPhase.IDLE), 10 * S), "no run is loaded"),
    ],
)
def test_what_stands_in_the_way_is_said(run, change, said):
    board = ready_board(run)
    change(board)
    assert said in standing_in_the_way(board, 10 * S)


def test_an_objects_process_that_fell_silent_is_named_and_not_what_it_said(run):
    board = ready_board(run)
    board.objects.pop("ot1")
    set_live(board, UNPROBED, 8 * S - 1)
    found = standing_in_the_way(board, 10 * S)
    assert "no state of ot1 arrives: its object_target has said nothing for 2 s" in found
    assert not any("probe" in text for text in found)


def test_the_page_asks_for_all_that_the_manager_asks_for(run):
    """The page lists all of it if nothing was heard, and if everything is late."""
    blank = Board(run)
    blank.hear_session(SessionFact(5 * S, SessionPhase.CONNECTED), 10 * S)
    asked = [one.text for one in obstacles(Gate.ARM, run, Facts(), None, {}, 0)]
    told = standing_in_the_way(blank, 10 * S)
    assert sorted(told) == sorted(["the scenario manager is silent", *asked])
    # What concerns the whole session is told before single objects.
    named = [any(who in text for who in run.object_ids) for text in told]
    assert named == sorted(named)
    late = ready_board(run)
    late.manager.at_ns = 11 * S
    late.manager.stamp_ns = 6 * S
    found = " ".join(standing_in_the_way(late, 11 * S))
    # Half of what ends an armed session, of each of its participants.
    for sign in signs_of_life(run):
        if sign.limit_s < 2.0 and sign.code is not SafetyCode.REPLY_MISSING:
            assert f"limit {sign.arming_limit_s:g} s" in found, sign


# Facts that a page doesn't have: each obstacle stands without them too.
NOT_ON_A_PAGE = {
    "unanswered": "in lockstep, names the nodes that the missing state of the VUT waits for",
    "lasting": "tells ssp run that waiting is no use; the refusal itself is shown",
}


REFUSED = SessionFact(
    5 * S, SessionPhase.CONNECTED, ARM_FAILED, refusal_text("ot1", "the key is out")
)


def test_the_page_has_each_fact_that_the_manager_asks_for(run, monkeypatch):
    board = ready_board(run)
    set_live(board, UNPROBED, 10 * S)
    recorder = RecorderFact(True, lost=3, missing=("/ssp/x",), strangers=("/ssp/y has two",))
    board.hear_recorder(recorder, 10 * S)
    board.hear_localisation("fix type", 10 * S)
    board.hear_session(REFUSED, 10 * S)
    given: list[Facts] = []

    def note(gate, spec, facts, *rest):
        given.append(facts)
        return obstacles(gate, spec, facts, *rest)

    monkeypatch.setattr(status_health, "obstacles", note)
    standing_in_the_way(board, 10 * S)
    (facts,), blank = given, Facts()
    without = {
        one.name for one in fields(Facts) if getattr(facts, one.name) == getattr(blank, one.name)
    }
    assert without == set(NOT_ON_A_PAGE)


def test_a_refusal_to_arm_stands_in_the_way_as_long_as_the_manager_counts_it(run):
    board = ready_board(run)
    board.hear_session(REFUSED, 10 * S)
    last_ns = 10 * S + round(ARM_AGAIN_S * S)
    for now_ns, kept in ((10 * S, True), (last_ns, True), (last_ns + 1, False)):
        found = standing_in_the_way(board, now_ns)
        assert ("ot1 has just refused to arm: the key is out" in found) is kept
    # An object that didn't answer may be asked again at once.
    board.hear_session(replace(REFUSED, reason="ot1 didn't answer"), 10 * S)
    assert not any("refused" in one for one in standing_in_the_way(board, 10 * S))


def test_an_object_that_moves_while_it_says_that_it_stands_is_named(run):
    board = ready_board(run)
    for k in range(1, 30):
        moved = state("ot1", x_m=30.0 + 0.02 * k, y_m=6.0, stamp_ns=5 * S + k * S // 10)
        board.hear_states([moved], 10 * S)
    assert "ot1 says that it stands and went" in " ".join(standing_in_the_way(board, 10 * S))


def test_a_stranger_that_the_recorder_names_stands_in_the_way(run):
    board = ready_board(run)
    board.hear_recorder(RecorderFact(True, strangers=("/ssp/ot1/state has two",)), 10 * S)
    found = standing_in_the_way(board, 10 * S)
    assert len(found) == 1
    assert found[0].startswith("1 publishers too many, limit 0: /ssp/ot1/state has two; ")


def test_a_stranger_that_the_manager_finds_stands_in_the_way_while_it_is_heard(run):
    """The graph shows one whose messages the recorder doesn't hear, or before it has sent any."""
    board = ready_board(run)
    board.hear_recorder(RecorderFact(True, strangers=("/ssp/clock has two",)), 10 * S)
    told = SimpleNamespace(strangers=["ot1/reference_ack has /ssp/x", *map(str, range(20))])
    board.hear_links(board.links.value, 10 * S, messages.strangers_of(told))
    found = standing_in_the_way(board, 10 * S)
    assert len(found) == 1
    assert found[0].startswith(f"{MOST_TOLD + 1} publishers too many, limit 0: ot1/reference_ack")
    assert "has /ssp/x; 0; 1" in found[0]
    assert "; /ssp/clock has two; " in found[0]
    board.hear_links(board.links.value, 10 * S)
    assert len(standing_in_the_way(board, 10 * S)) == 1
    board.hear_recorder(RecorderFact(True), 10 * S)
    assert standing_in_the_way(board, 10 * S) == []


def test_what_a_manager_that_is_silent_said_of_strangers_is_not_believed(run):
    board = ready_board(run)
    at_ns = 10 * S - round(LINKS_FRESH_S * S)
    for said_ns, named in ((at_ns, True), (at_ns - 1, False)):
        board.manager.strangers = LatestReport(("ot1/state has two",), said_ns)
        assert any("has two" in one for one in standing_in_the_way(board, 10 * S)) is named


def test_a_session_whose_objects_may_still_refuse_to_arm_is_shown_as_arming(run):
    board = ready_board(run)
    board.hear_session(SessionFact(0, SessionPhase.ARMED), 10 * S)
    armed = {"control_state": ControlState.ARMED}
    for target, shown in ((run.targets[0].id, "ARMING"), (run.targets[1].id, "ARMED")):
        session = Snapshots(board).snapshot(10 * S)["session"]
        assert (session["state"], session["shown"]) == ("ARMED", "ARMING")
        assert session["next"].startswith("wait until every object reports")
        board.hear_states([state(target, **armed)], 10 * S)
        assert Snapshots(board).snapshot(10 * S)["session"]["shown"] == shown


def test_a_session_that_has_started_waits_for_nothing(run):
    board = Board(run)
    board.hear_session(SessionFact(0, SessionPhase.RUNNING), 0)
    assert standing_in_the_way(board, 60 * S) == []


@pytest.mark.parametrize(
    ("later_s", "late", "stale"),
    [(0.3, False, False), (0.31, True, False), (1.0, True, False), (1.01, True, True)],
)
def test_age_makes_an_object_late_and_then_stale(run, later_s, late, stale):
    board = ready_board(run)
    now_ns = 10 * S + round(later_s * S)
    board.manager.at_ns = now_ns
    snapshot = Snapshots(board).snapshot(now_ns)
    found = {one["id"]: one for one in snapshot["objects"]}["ot1"]
    assert (found["late"], found["stale"]) == (late, stale)
    assert snapshot["blind"] is stale
    assert snapshot["leaderless"] is False
    assert len(snapshot["stale"]) == (3 if stale else 0)


def test_one_silent_object_is_no_blindness(run):
    board = ready_board(run)
    board.manager.at_ns = 13 * S
    board.hear_states([state("vut", Role.VUT), state("walker")], 13 * S)
    snapshot = Snapshots(board).snapshot(13 * S)
    assert snapshot["stale"] == ["ot1 is silent for 3.0 s"]
    assert snapshot["blind"] is False


def test_before_anything_was_heard(run):
    snapshot = Snapshots(Board(run)).snapshot(S)
    assert snapshot["blind"]
    assert snapshot["leaderless"]
    assert snapshot["session"]["state"] == "UNKNOWN"
    assert "vut was never heard" in snapshot["stale"]
    assert json.loads(json.dumps(snapshot, allow_nan=False)) == snapshot


def test_distances_and_times_to_conflict(run):
    board = ready_board(run)
    vut = state("vut", Role.VUT, speed_mps=10.0)
    # Crosses from the left at 2 m/s, 40 m ahead.
    walker = state("walker", x_m=43.6, y_m=6.0, yaw_rad=-math.pi / 2, speed_mps=2.0)
    board.hear_states([vut, walker], 10 * S)
    found = {one["id"]: one for one in Snapshots(board).snapshot(10 * S)["objects"]}
    assert found["vut"].get("distance") is None
    assert found["walker"]["distance"] == pytest.approx(39.1, abs=0.3)
    assert found["walker"]["meeting"]["vut"] == pytest.approx(3.9, abs=0.2)
    assert found["walker"]["meeting"]["object"] == pytest.approx(0.6, abs=0.2)


def test_a_stale_vut_gives_no_distances(run):
    board = ready_board(run)
    board.hear_states([state("walker")], 12 * S)
    found = {one["id"]: one for one in Snapshots(board).snapshot(12 * S)["objects"]}
    assert "distance" not in found["walker"]


def test_error_is_shown_while_a_reference_is_tracked(run):
    board = ready_board(run)
    lost = state("ot1", reference_id="r1", error_longitudinal_m=0.5, error_lateral_m=-0.9)
    board.hear_states([lost, state("walker")], 10 * S)
    found = {one["id"]: one for one in Snapshots(board).snapshot(10 * S)["objects"]}
    assert found["ot1"]["error"] == [0.5, -0.9]
    assert found["ot1"]["error_over"]
    assert "error" not in found["walker"]


@pytest.mark.parametrize("error", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("field", "where", "in_the_table"),
    [
        ("error_longitudinal_m", "ahead", True),
        ("error_lateral_m", "to the left", True),
        ("error_yaw_rad", "of the heading", False),
    ],
)
def test_a_tracking_error_that_is_no_number_is_an_error(run, field, where, in_the_table, error):
    board = ready_board(run)
    board.hear_states([state("ot1", reference_id="r1", **{field: error})], 10 * S)
    (shown,) = (one for one in health(board, ClockWatch(), 10 * S) if one.part == "ot1")
    assert shown.level is Level.ERROR
    assert shown.message == f"tracking error {where} is no number"
    rows = {one["id"]: one for one in Snapshots(board).snapshot(10 * S)["objects"]}
    assert rows["ot1"]["error_over"] is in_the_table
    # Without a reference there is nothing to track.
    board.hear_states([state("ot1", **{field: error})], 10 * S)
    (shown,) = (one for one in health(board, ClockWatch(), 10 * S) if one.part == "ot1")
    assert shown.level is Level.OK


def test_objects_come_in_the_order_that_people_count_in():
    board = Board()
    names = ["ot10", "ot2", "ot1"]
    traffic, vut = state("a", Role.TRAFFIC), state("z", Role.VUT)
    board.hear_states([traffic, vut, *map(state, names)], 0)
    shown = [one["id"] for one in Snapshots(board).snapshot(0)["objects"]]
    assert shown == ["z", "ot1", "ot2", "ot10", "a"]


def test_elapsed_counts_from_the_start_to_the_end():
    board = Board()
    assert board.elapsed_s is None
    board.hear_session(SessionFact(20 * S, SessionPhase.RUNNING), 0)
    assert board.elapsed_s == 0.0
    board.manager.stamp_ns = 23 * S
    assert board.elapsed_s == 3.0
    board.hear_session(SessionFact(25 * S, SessionPhase.FINISHED, verdict=Verdict.VALID), 0)
    board.manager.stamp_ns = 60 * S
    assert board.elapsed_s == 5.0
    board.hear_phase(Phase.CONFLICT, Event("phase", 22 * S, "phase conflict"))
    board.hear_session(SessionFact(61 * S, SessionPhase.LOADED), 0)
    assert board.elapsed_s is None
    assert board.session.phase is Phase.UNKNOWN


def test_events_are_newest_first_dated_from_the_start_and_bounded():
    board = Board()
    board.hear_session(SessionFact(20 * S, SessionPhase.RUNNING), 0)
    for k in range(MOST_EVENTS + 10):
        board.events.add(Event("safety", (21 + k) * S, f"event {k}", measured=1.0, limit=math.inf))
    events = Snapshots(board).events()["events"]
    assert len(events) == MOST_EVENTS
    assert events[0]["title"] == f"event {MOST_EVENTS + 9}"
    assert events[0]["t"] == MOST_EVENTS + 10.0
    assert events[0]["limit"] is None


def test_a_stray_publisher_fills_no_memory():
    board = Board()
    board.hear_states([state(f"o{k}") for k in range(2 * MOST_OBJECTS)], 0)
    assert len(board.objects) == MOST_OBJECTS


def test_every_state_says_what_comes_next(run):
    board = ready_board(run)
    for state, commands in COMMANDS.items():
        board.hear_session(SessionFact(5 * S, state), 10 * S)
        told = Snapshots(board).snapshot(10 * S)["session"]["next"].lower()
        assert told
        # What a person may press first is named.
        assert not commands or commands[0].replace("_", " ") in told, state
    board.replay = True
    assert Snapshots(board).snapshot(10 * S)["session"]["next"] == ""


def test_every_state_has_its_commands_and_none_has_abort():
    assert set(COMMANDS) == set(SessionPhase)
    # Abort is no matter of state: its button never asks.
    assert all("abort" not in words for words in COMMANDS.values())


values = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=60, deadline=None)
@given(values, values, values, values, values)
def test_no_number_breaks_a_snapshot(x_m, y_m, yaw_rad, speed_mps, error_m):
    board = Board()
    wild = state("ot1", x_m=x_m, y_m=y_m, yaw_rad=yaw_rad, speed_mps=speed_mps)
    wild = replace(wild, reference_id="r", error_lateral_m=error_m)
    board.hear_states([state("vut", Role.VUT), wild], 0)
    json.dumps(Snapshots(board).snapshot(0), allow_nan=False)


def test_numbers():
    assert number(1.23456) == 1.235
    assert number(math.nan) is None
    assert number(-math.inf) is None


def test_the_site_is_drawn_from_the_run(run):
    site = site_message(run)
    assert site["known"]
    assert site["bounds"] == [-20.0, -20.0, 300.0, 20.0]
    assert {one["id"] for one in site["starts"]} == {"vut", "ot1", "walker"}
    assert all(len(line["points"]) <= MOST_POINTS + 1 for line in site["lines"])
    json.dumps(site, allow_nan=False)
    assert site_message(None) == {"known": False}


# -- how old things are ----------------------------------------------------------------------------


def ages_of(board: Board, now_ns: int = 10 * S) -> dict[str, Any]:
    return {one["id"]: one for one in Snapshots(board).snapshot(now_ns)["objects"]}


def test_a_state_that_arrives_late_is_old(run):
    board = ready_board(run)
    board.manager.stamp_ns = round(7.5 * S)  # states are of 5 s
    found = ages_of(board)["ot1"]
    assert (found["age"], found["late"], found["stale"]) == (2.5, True, True)
    snapshot = Snapshots(board).snapshot(10 * S)
    assert snapshot["blind"]
    assert "what ot1 says is 2.5 s old" in snapshot["stale"]
    assert "the state of ot1 is 2.50 s old, limit 0.15 s" in snapshot["standing"]
    # A manager that isn't heard any more tells nothing of the time; nor does one that is behind.
    board.manager.at_ns = 8 * S
    assert ages_of(board)["ot1"]["age"] == 0.01
    board.manager.at_ns, board.manager.stamp_ns = 10 * S, 2 * S
    assert ages_of(board)["ot1"]["age"] == 0.01


def test_the_managers_word_on_a_states_age_counts_while_it_is_new(run):
    board = ready_board(run)
    board.hear_links({"ot1": LinkFact(0.0, 0.001, 0.7)}, 10 * S)
    found = ages_of(board)["ot1"]
    assert (found["age"], found["late"], found["stale"]) == (0.7, True, False)
    board.hear_links({"ot1": LinkFact(0.0, 0.001, math.nan)}, 10 * S)
    assert ages_of(board)["ot1"]["age"] == 0.0


def test_links_are_forgotten_when_the_manager_tells_of_them_no_more(run):
    board = ready_board(run)
    board.hear_states([state("ot1", x_m=30.0, y_m=6.0)], 13 * S)
    assert "link" in ages_of(board, 13 * S)["ot1"]
    assert "link" not in ages_of(board, 13 * S + 1)["ot1"]
    assert NOT_MEASURED in standing_in_the_way(board, 13 * S + 1)


def test_an_overtaken_state_is_dropped_and_a_new_beginning_is_not():
    board = Board()
    board.hear_states([state("a", x_m=1.0)], 1)
    board.hear_states([replace(state("a", x_m=2.0), stamp_ns=5 * S - 1)], 2)
    board.hear_states([replace(state("a", x_m=3.0), stamp_ns=4 * S)], 3)
    assert (board.objects["a"].state.x_m, board.objects["a"].at_ns) == (1.0, 1)
    board.hear_states([replace(state("a", x_m=4.0), stamp_ns=4 * S - 1)], 4)
    assert (board.objects["a"].state.x_m, board.objects["a"].at_ns) == (4.0, 4)


def test_a_command_that_nobody_offers_is_not_to_be_pressed(run):
    board = ready_board(run)
    full = Snapshots(board).snapshot(10 * S)["session"]["commands"]
    assert full
    board.offered = frozenset({full[0], "abort"})
    assert Snapshots(board).snapshot(10 * S)["session"]["commands"] == [full[0]]
    board.offered = frozenset()
    assert Snapshots(board).snapshot(10 * S)["session"]["commands"] == []


def test_whether_abort_would_be_heard_is_known_before_it_is_pressed(run):
    board = ready_board(run)
    for offered, unheard in ((frozenset({"connect"}), True), (frozenset({"abort"}), False)):
        board.offered = offered
        assert Snapshots(board).snapshot(10 * S)["abort_unheard"] is unheard
    board.offered, board.replay = frozenset(), True
    assert not Snapshots(board).snapshot(10 * S)["abort_unheard"]


def test_a_replay_takes_no_commands(run):
    board = ready_board(run)
    assert Snapshots(board).snapshot(10 * S)["session"]["commands"]
    board.replay = True
    snapshot = Snapshots(board).snapshot(10 * S)
    assert snapshot["replay"]
    assert snapshot["session"]["commands"] == []


def picture_message(picture: bytes) -> bytes:
    """A serialised CompressedImage with an empty frame and format."""
    head = b"\x00\x01\x00\x00" + struct.pack("<iI", 1, 0)
    text = struct.pack("<I", 1) + b"\0" + b"\0\0\0"
    return head + text + text + struct.pack("<I", len(picture)) + picture


def test_only_a_picture_that_can_be_shown_makes_the_camera_young():
    board = Board()
    pictures = Pictures(board, S)
    assert pictures.settle() == ""
    pictures.put(picture_message(b"\xff\xd8first"), 3)
    assert pictures.settle() == ""
    assert (board.camera.at_ns, board.camera.value) == (3, "")
    assert pictures.take(S) == b"\xff\xd8first"
    pictures.put(picture_message(b"\x89PNG"), 4)
    assert "is no JPEG" in pictures.settle()
    snapshot = Snapshots(board).snapshot(5)
    assert (board.camera.at_ns, snapshot["camera_fault"]) == (3, "not JPEG")
    assert pictures.take(9 * S) is None
    pictures.put(picture_message(b"\xff\xd8second"), 6)
    pictures.settle()
    assert (board.camera.at_ns, board.camera.value) == (6, "")
    assert pictures.take(2 * S - 1) is None  # not yet due
    assert pictures.take(2 * S) == b"\xff\xd8second"
