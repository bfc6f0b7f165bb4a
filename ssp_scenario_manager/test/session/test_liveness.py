"""Silence of a participant and bad links, at, just inside and just outside their limits."""

from __future__ import annotations

import math

import pytest

from ssp_core import names
from ssp_core.run_file.model import Camera, RunSpec
from ssp_core.safety.arming import Gate, obstacles
from ssp_core.safety.body_status import BodyStatus
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.link_quality import Exchange, LinkClocks
from ssp_core.safety.liveness import (
    CAMERA_SILENT_S,
    RECORDER_SILENT_S,
    WORLD_SILENT_LOCKSTEP_S,
    WORLD_SILENT_REALTIME_S,
)
from ssp_core.vocabulary import SessionPhase
from ssp_scenario_manager.session.inputs import StepInputs
from ssp_scenario_manager.session.supervision import LivenessMonitor

EVERYBODY = (names.SIL_WORLD, names.VUT_ID, "ot1", names.MONITOR, names.FRONT_CAMERA)
NOW_NS = 100_000_000_000
MS = 1_000_000
C = SafetyCode
ARMED, RUNNING, STOPPING = SessionPhase.ARMED, SessionPhase.RUNNING, SessionPhase.STOPPING


def with_camera(run: RunSpec, mode: str) -> RunSpec:
    return run.model_copy(update={"camera": Camera(), "mode": mode})


def links(offset_s: float = 0.0, delay_s: float = 0.0, age_s: float = 0.0) -> LinkClocks:
    """A link measured age_s ago."""
    made = LinkClocks()
    sent_ns = 7 * NOW_NS
    arrived_ns = sent_ns + round(delay_s * 1e9)
    there_ns = sent_ns + round(delay_s * 0.5e9) + round(offset_s * 1e9)
    made.on_sent(1, sent_ns)
    exchange = Exchange(sent_ns, there_ns, there_ns, arrived_ns)
    assert made.on_reply(["ot1"], 1, exchange, NOW_NS - round(age_s * 1e9))
    return made


def liveness_at(ages_s: dict[str, float], measured: LinkClocks | None = None) -> LivenessMonitor:
    liveness = LivenessMonitor(measured or links())
    for who in EVERYBODY:
        liveness.hear(who, NOW_NS - round(ages_s.get(who, 0.0) * 1e9))
    return liveness


def codes(
    liveness: LivenessMonitor, spec: RunSpec, phase: SessionPhase = RUNNING
) -> list[SafetyCode]:
    return [v.code for v in liveness.violations(spec, phase, NOW_NS, 7)]


@pytest.mark.parametrize(
    ("who", "limit_s", "code", "mode", "phase"),
    [
        (names.SIL_WORLD, WORLD_SILENT_LOCKSTEP_S, C.WORLD_SILENT, "lockstep", RUNNING),
        (names.SIL_WORLD, WORLD_SILENT_REALTIME_S, C.WORLD_SILENT, "realtime", RUNNING),
        (names.SIL_WORLD, WORLD_SILENT_REALTIME_S, C.WORLD_SILENT, "realtime", ARMED),
        (names.VUT_ID, WORLD_SILENT_LOCKSTEP_S + 0.25, C.VUT_SILENT, "lockstep", STOPPING),
        (names.VUT_ID, WORLD_SILENT_REALTIME_S + 0.25, C.VUT_SILENT, "realtime", RUNNING),
        (names.VUT_ID, WORLD_SILENT_REALTIME_S, C.VUT_SILENT, "live", ARMED),
        ("ot1", WORLD_SILENT_LOCKSTEP_S, C.OBJECT_SILENT, "lockstep", ARMED),
        ("ot1", WORLD_SILENT_REALTIME_S, C.OBJECT_SILENT, "realtime", ARMED),
        ("ot1", WORLD_SILENT_REALTIME_S, C.OBJECT_SILENT, "live", RUNNING),
        (names.MONITOR, RECORDER_SILENT_S, C.RECORDER, "lockstep", RUNNING),
        (names.MONITOR, RECORDER_SILENT_S, C.RECORDER, "live", ARMED),
        (names.FRONT_CAMERA, CAMERA_SILENT_S, C.PARTICIPANT_LOST, "realtime", RUNNING),
        (names.FRONT_CAMERA, WORLD_SILENT_LOCKSTEP_S, C.PARTICIPANT_LOST, "lockstep", RUNNING),
    ],
)
def test_silence_ends_a_session_past_its_limit(
    who: str, limit_s: float, code: SafetyCode, mode: str, phase: SessionPhase, run: RunSpec
) -> None:
    spec = with_camera(run, mode)
    assert codes(liveness_at({who: limit_s - 0.001}), spec, phase) == []
    assert codes(liveness_at({who: limit_s}), spec, phase) == []
    assert codes(liveness_at({who: limit_s + 0.001}), spec, phase) == [code]


@pytest.mark.parametrize(
    ("who", "mode", "phase"),
    [
        # Steps are counted instead, and the world drops who answers none.
        ("ot1", "lockstep", RUNNING),
        ("ot1", "lockstep", STOPPING),
        # There is none.
        (names.SIL_WORLD, "live", RUNNING),
    ],
)
def test_whose_silence_is_not_judged_here(
    who: str, mode: str, phase: SessionPhase, run: RunSpec
) -> None:
    assert codes(liveness_at({who: 99.0}), with_camera(run, mode), phase) == []


def test_a_hold_for_a_driver_is_no_silence_of_the_vut_or_the_camera(run: RunSpec) -> None:
    """A model may take a minute; the world says meanwhile that it holds."""
    spec = with_camera(run, "lockstep")
    liveness = liveness_at({names.VUT_ID: 60.0, names.FRONT_CAMERA: 60.0, names.MONITOR: 60.0})
    assert codes(liveness, spec) == [C.VUT_SILENT, C.RECORDER, C.PARTICIPANT_LOST]
    liveness.hear_hold(NOW_NS)
    # The recorder writes on, and goes on to say so.
    assert codes(liveness, spec) == [C.RECORDER]
    unheard = LivenessMonitor()
    unheard.hear_hold(NOW_NS)
    assert unheard.age_s(names.FRONT_CAMERA, NOW_NS) == math.inf


def test_a_step_is_dealt_with_once_it_was_answered() -> None:
    inputs = StepInputs(())
    inputs.on_tick(7, 0)
    assert not inputs.is_dealt_with(7)
    inputs.done_step = 7
    assert inputs.is_dealt_with(7)
    assert not inputs.is_dealt_with(8)


def test_who_was_never_heard_is_silent_for_ever(run: RunSpec) -> None:
    assert LivenessMonitor().age_s(names.MONITOR, NOW_NS) == math.inf
    assert codes(LivenessMonitor(), with_camera(run, "lockstep")) == [
        C.WORLD_SILENT,
        C.VUT_SILENT,
        C.RECORDER,
        C.PARTICIPANT_LOST,
    ]
    assert codes(LivenessMonitor(), with_camera(run, "live")) == [
        C.VUT_SILENT,
        C.OBJECT_SILENT,
        C.RECORDER,
        C.PARTICIPANT_LOST,
        C.REPLY_MISSING,
    ]


def test_a_run_without_a_camera_misses_none(run: RunSpec) -> None:
    assert codes(liveness_at({names.FRONT_CAMERA: 60.0}), run) == []


@pytest.mark.parametrize("mode", ["realtime", "live"])
@pytest.mark.parametrize("phase", [ARMED, RUNNING, STOPPING])
@pytest.mark.parametrize(
    ("inside", "outside", "code"),
    [
        ({"age_s": 0.5}, {"age_s": 0.501}, C.REPLY_MISSING),
        ({"offset_s": 0.05}, {"offset_s": 0.050001}, C.CLOCK_OFFSET),
        ({"offset_s": -0.05}, {"offset_s": -0.050001}, C.CLOCK_OFFSET),
        # Half of the delay is the least that the offset is uncertain by.
        (
            {"offset_s": 0.15, "delay_s": 0.2},
            {"offset_s": 0.150001, "delay_s": 0.2},
            C.CLOCK_OFFSET,
        ),
        ({"delay_s": 0.5}, {"delay_s": 0.500001}, C.LINK_DELAY),
    ],
)
def test_a_bad_link_ends_a_session(
    run: RunSpec,
    mode: str,
    phase: SessionPhase,
    inside: dict[str, float],
    outside: dict[str, float],
    code: SafetyCode,
) -> None:
    spec = with_camera(run, mode)
    assert codes(liveness_at({}, links(**inside)), spec, phase) == []
    assert codes(liveness_at({}, links(**outside)), spec, phase) == [code]
    # In lockstep what a link does shows in simulated time; answers come by the wall clock.
    assert codes(liveness_at({}, links(**outside)), with_camera(run, "lockstep"), phase) == []


@pytest.mark.parametrize("way_s", [(0.0, 0.6), (0.6, 0.0), (0.3, 0.3)])
def test_a_late_link_is_no_wrong_clock(run: RunSpec, way_s: tuple[float, float]) -> None:
    there_s, back_s = way_s
    measured = links(offset_s=0.5 * (there_s - back_s), delay_s=there_s + back_s)
    spec = with_camera(run, "live")
    assert codes(liveness_at({}, measured), spec) == [C.LINK_DELAY]
    # A clock that is wrong by more than the delay can explain is named behind it.
    measured = links(offset_s=0.4, delay_s=0.6)
    assert codes(liveness_at({}, measured), spec) == [C.LINK_DELAY, C.CLOCK_OFFSET]


@pytest.mark.parametrize("mode", ["lockstep", "realtime", "live"])
def test_losses_and_other_managers(run: RunSpec, mode: str) -> None:
    spec = with_camera(run, mode)
    liveness = liveness_at({})
    liveness.hear_recorder(True, (), 1, NOW_NS)
    assert codes(liveness, spec) == [C.RECORDER]
    liveness.hear_recorder(True, (), 0, NOW_NS)
    liveness.foreign = {"session_state": (1, "session_state has /x")}
    assert codes(liveness, spec) == [C.FOREIGN_MANAGER]


def test_each_finding_names_its_object_its_stamp_and_how_it_was_found(run: RunSpec) -> None:
    liveness = liveness_at({}, links(offset_s=0.4, delay_s=0.6))
    liveness.hear_recorder(True, (), 3, NOW_NS)
    liveness.foreign = {"session_state": (2, "session_state has /x and /y")}
    findings = liveness.violations(with_camera(run, "live"), RUNNING, NOW_NS, 7)
    assert [(one.code, one.object_id, one.stamp_ns, one.detail) for one in findings] == [
        (C.RECORDER, "", 7, "messages lost by the recorder"),
        (C.FOREIGN_MANAGER, "", 7, "session_state has /x and /y"),
        (C.LINK_DELAY, "ot1", 7, "measured by heartbeats"),
        (C.CLOCK_OFFSET, "ot1", 7, "measured by heartbeats"),
    ]


def test_strangers_that_have_gone_are_no_reason_any_more(run: RunSpec) -> None:
    liveness = liveness_at({})
    liveness.hear_strangers(["2 publish a: ours, forger", "2 publish b: ours, forger"])
    assert codes(liveness, run) == [C.FOREIGN_MANAGER]
    assert liveness.facts(run, NOW_NS).other_managers == 2
    liveness.hear_strangers([])
    assert codes(liveness, run) == []
    assert liveness.facts(run, NOW_NS).other_managers == 0


def test_who_is_watched_follows_the_phase_and_the_run(run: RunSpec) -> None:
    """The memory between two looks is of that phase and run alone."""
    lockstep, realtime = (with_camera(run, mode) for mode in ("lockstep", "realtime"))
    liveness = liveness_at({"ot1": 99.0})
    assert codes(liveness, lockstep, ARMED) == [C.OBJECT_SILENT]
    assert codes(liveness, lockstep, RUNNING) == []
    assert codes(liveness, realtime, RUNNING) == [C.OBJECT_SILENT]
    assert codes(liveness, lockstep, RUNNING) == []


@pytest.mark.parametrize(("age_s", "known"), [(0.0, True), (2.0, True), (2.001, False)])
def test_an_adapter_that_is_silent_says_nothing_any_more(
    run: RunSpec, age_s: float, known: bool
) -> None:
    liveness = LivenessMonitor()
    liveness.hear_localisation("no fix", NOW_NS - round(age_s * 1e9))
    assert liveness.facts(run, NOW_NS).vut_refused == ("no fix" if known else "")


def test_the_facts_that_arming_asks_for(run: RunSpec) -> None:
    liveness = liveness_at({names.VUT_ID: 0.25, "ot1": 0.5}, links(0.01, 0.02, 0.125))
    liveness.hear_recorder(False, ("/ssp/a",), 3, NOW_NS)
    liveness.foreign["clock"] = 1, "clock has /y"
    facts = liveness.facts(run, NOW_NS)
    assert (facts.recorder_ready, facts.recorder_missing, facts.recorder_lost) == (
        False,
        ("/ssp/a",),
        3,
    )
    ages_s = facts.ages_s
    assert (ages_s[names.MONITOR], ages_s[names.VUT_ID], ages_s["ot1"]) == (0.0, 0.25, 0.5)
    link = facts.links["ot1"]
    assert (link.offset_s, link.delay_s, link.age_s) == (0.01, 0.02, 0.125)
    assert (facts.other_managers, facts.foreign) == (1, "clock has /y")
    assert LivenessMonitor().facts(None, NOW_NS).ages_s == {}


def live_obstacles(liveness: LivenessMonitor, run: RunSpec, gate: Gate, at_s: float) -> list[str]:
    """Return the obstacles of a live run whose participants send no states."""
    spec = run.model_copy(update={"mode": "live"})
    facts = liveness.facts(spec, round(at_s * 1e9))
    return [one.text for one in obstacles(gate, spec, facts, None, {}, NOW_NS)]


def test_why_no_state_of_a_live_object_arrives_is_said(run: RunSpec) -> None:
    liveness = LivenessMonitor(links())
    for why, at_s in (
        ("its object_target was never heard: it doesn't run, or can't be reached", 100.0),
        ("no program listens at udp://10.0.0.21:9001", 101.0),
        ("its object_target has said nothing for 19 s", 120.0),
    ):
        if at_s == 101.0:
            told = BodyStatus("ot1", ("no program listens at udp://10.0.0.21:9001",))
            liveness.hear_body(told, round(at_s * 1e9))
        found = live_obstacles(liveness, run, Gate.CONNECT, at_s)
        assert f"no state of ot1 arrives: {why}" in found
    simulated = liveness.facts(run, NOW_NS)
    assert simulated.bodies == {}


def test_all_that_a_live_object_knows_keeps_it_from_arming_and_is_said_once(run: RunSpec) -> None:
    liveness = LivenessMonitor(links())
    gone, gate = "its test object isn't connected: refused", "it has no probe report"
    liveness.hear_body(BodyStatus("ot1", (gone,), (gate, gone), lasting=True), NOW_NS)
    found = live_obstacles(liveness, run, Gate.ARM, 100.0)
    assert [text for text in found if gone in text or gate in text] == [
        f"no state of ot1 arrives: {gone}",
        f"ot1: {gate}",
    ]
    spec = run.model_copy(update={"mode": "live"})
    assert liveness.facts(spec, NOW_NS).is_hopeless


def test_objects_are_not_asked_to_arm_again_within_a_second_of_a_refusal(run: RunSpec) -> None:
    liveness = LivenessMonitor(links())
    liveness.hear_refusal("ot1", "the key is out", False, NOW_NS)
    liveness.hear_refusal("ot2", "no heartbeat", False, NOW_NS + MS)
    for after_s, kept in ((0.0, True), (1.0, True), (1.002, False)):
        found = live_obstacles(liveness, run, Gate.ARM, 100.0 + after_s)
        assert ("ot1 has just refused to arm: the key is out" in found) is kept
        assert ("ot2 has just refused to arm: no heartbeat" in found) is kept
        assert "refused" not in " ".join(live_obstacles(liveness, run, Gate.START, 100.0 + after_s))
    liveness.hear_refusal("ot1", "another K* version", True, NOW_NS)
    assert liveness.facts(run, NOW_NS).is_hopeless
    liveness.begin_arming()
    assert liveness.facts(run, NOW_NS).refusals == {}
    assert not liveness.facts(run, NOW_NS).is_hopeless


def test_a_refusal_that_may_pass_does_not_undo_one_that_lasts(run: RunSpec) -> None:
    liveness = LivenessMonitor(links())
    liveness.hear_refusal("ot1", "another K* version", True, NOW_NS)
    liveness.hear_refusal("ot2", "no heartbeat", False, NOW_NS + MS)
    assert liveness.facts(run, NOW_NS + MS).is_hopeless
