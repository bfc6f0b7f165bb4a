"""A cell is as expected only if everything is; each thing that isn't is found and named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ssp_core.run_file.model import Fault, RunSpec
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_scenario_manager.faults.evidence import Evidence, FaultNote, RunnerEvent, SafetyNote, Track
from ssp_scenario_manager.faults.judge import judge
from ssp_scenario_manager.faults.matrix import ExpectedOutcome, Within

ABORTED = frozenset({"aborted"})
EXPECTED = ExpectedOutcome(
    ABORTED,
    "as the test says",
    by="the object",
    primary=("object_silent",),
    also=("object_aborted",),
    within=Within(0.06, "state_age_s"),
)
FAULT_S = 3.0
Make = Callable[..., Evidence]
Changes = dict[str, Any]


def track(start_m: float, y_m: float, speed_mps: float, brakes_s: float) -> Track:
    t = np.arange(0.0, 12.0, 0.02)
    speed = np.clip(speed_mps - 4.0 * np.maximum(t - brakes_s, 0.0), 0.0, None)
    x = start_m + np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.02)))
    return Track(t, x, np.full_like(t, y_m), np.zeros_like(t), speed)


@pytest.fixture
def make(run: RunSpec) -> Make:
    """A run in which ot1 falls silent at 3 s and all goes well, but for what is given."""
    spec = run.model_copy(update={"faults": [Fault(kind="link_cut", target="ot1", at_s=FAULT_S)]})

    def made(**given: Any) -> Evidence:
        evidence = Evidence(
            spec=spec,
            verdict="aborted",
            reasons=("object_silent: ot1: 0.32 s, limit 0.3 s at 3.32 s",),
            truth={"ot1": track(40.0, 3.5, 7.0, 3.5), "vut": track(0.0, 0.0, 10.0, 3.4)},
            own_states=((3.4, "ot1", ControlState.ABORTING),),
            session=(
                (0.0, SessionPhase.RUNNING),
                (3.32, SessionPhase.ABORTING),
                (8.0, SessionPhase.ABORTED),
            ),
            triggers=(5.0,),
            safety=(SafetyNote(3.32, "object_silent", "scenario_manager", "ot1"),),
            faults=(FaultNote(FAULT_S, 0, True),),
        )
        return replace(evidence, **given)

    return made


def findings(evidence: Evidence, **expected: Any) -> tuple[str, ...]:
    return judge(replace(EXPECTED, **expected), evidence, 0).findings


def test_all_as_expected(make: Make) -> None:
    judged = judge(EXPECTED, make(), 0)
    assert judged.findings == ()
    assert judged.ok
    assert judged.reaction is not None
    assert judged.reaction.seconds == pytest.approx(0.32)
    assert judged.reaction.bound_s == pytest.approx(0.36)
    assert set(judged.stops) == {"ot1", "vut"}
    assert judged.stops["ot1"].distance_m == pytest.approx(7.0 * 0.5 + 49.0 / 8.0, abs=0.05)


RUNNING = (0.0, SessionPhase.RUNNING)
BY = "scenario_manager"
SILENT: Changes = {"own_states": (), "session": (RUNNING,), "safety": ()}
NEVER = "reaction never, bound 0.360 s (session)"


def moving(**changes: Track) -> Changes:
    """VUT and ot1 as they stop where all goes well, but for what is given."""
    well = {"ot1": track(40.0, 3.5, 7.0, 3.5), "vut": track(0.0, 0.0, 10.0, 3.4)}
    return {"truth": {**well, **changes}}


def silent_at(at_s: float) -> Changes:
    return {**SILENT, "safety": (SafetyNote(at_s, "object_silent", BY, "ot1"),)}


def test_a_thin_wall_that_was_driven_through_is_found(make: Make) -> None:
    evidence = make(**moving())
    for x_m, found in ((46.01, True), (300.0, False)):
        wall = [(x_m + 0.001, 50.0), (x_m + 0.001, -9.0), (x_m, -9.0), (x_m, 50.0)]
        fence = [(-50.0, -50.0), (400.0, -50.0), (400.0, 50.0), *wall, (-50.0, 50.0)]
        spec = evidence.spec.model_copy(update={"geofence": fence})
        told = findings(replace(evidence, spec=spec))
        assert any("ot1 was" in one and "outside the geofence" in one for one in told) == found


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({"verdict": "valid", "reasons": ()}, "verdict valid, not aborted"),
        ({"reasons": ("operator: 0",)}, "first reason is 'operator: 0'"),
        ({"reasons": ()}, "first reason is 'missing'"),
        (
            {"reasons": ("object_silent: ot1", "the world died\nand more")},
            "unexpected reason: the world died",
        ),
        (
            {"safety": (SafetyNote(3.0, "over_speed", "object_target", "ot1"),)},
            "unexpected safety event: over_speed ot1 at 3.00 s, seen by object_target",
        ),
        ({"lost": 3}, "the recorder lost 3 messages"),
        ({"problems": ("the run left no bag",)}, "the run left no bag"),
        (silent_at(3.40), "reaction after 0.400 s, bound 0.360 s (session)"),
        (SILENT, NEVER),
        # What was there before the fault is no answer to it.
        ({**silent_at(2.9), "own_states": ((1.0, "ot1", ControlState.ABORTING),)}, NEVER),
        (moving(ot1=track(40.0, 3.5, 7.0, 4.5)), "ot1 drives 16.63 m from 7.0 m/s, bound 10.97 m"),
        (moving(ot1=track(40.0, 3.5, 7.0, 11.9)), "ot1 doesn't come to a standstill"),
        (moving(ot1=track(40.0, 3.5, 7.0, 11.9)), "ot1 moves at the end, 6.68 m/s"),
        (moving(ot1=track(290.0, 3.5, 7.0, 3.5)), "ot1 was 24.23 m outside the geofence"),
        (moving(ot1=track(20.0, 0.5, 7.0, 3.5)), "ot1 and vut touch"),
    ],
)
def test_what_is_not_as_expected_is_found(make: Make, given: Changes, found: str) -> None:
    assert found in findings(make(**given))


def test_what_outlives_a_run_is_found(make: Make) -> None:
    left = judge(EXPECTED, make(), 0, ["process 7 still runs"])
    assert left.findings == ("process 7 still runs",)


def test_a_consequence_that_is_stated_and_a_reaction_at_its_bound_are_well(make: Make) -> None:
    reasons = ("object_silent: ot1: 0.32 s", "object_aborted: ot1: 1")
    assert findings(make(reasons=reasons, **silent_at(3.36)), stops=False) == ()


def test_a_session_that_must_not_start(make: Make) -> None:
    assert "the session started" in findings(make(), starts=False, within=None, stops=False)
    held = make(session=((0.0, SessionPhase.ARMED),), own_states=(), truth={})
    assert findings(held, starts=False, within=None) == ()


def test_only_the_signs_that_count(make: Make) -> None:
    evidence = make(
        safety=(
            SafetyNote(3.02, "object_aborted", "sil_world", "x"),
            SafetyNote(3.30, "object_silent", "scenario_manager", "ot1"),
        )
    )
    judged = judge(replace(EXPECTED, signs=("object_silent",)), evidence, 0)
    assert judged.reaction is not None
    assert judged.reaction.seconds == pytest.approx(0.30)


def test_counted_from_the_motion_that_shows_it(make: Make) -> None:
    standing = track(40.0, 3.5, 0.0, 0.0)
    moves = np.where((standing.t_s > 3.3) & (standing.t_s < 3.5), 0.4, 0.0)
    truth = {"ot1": replace(standing, speed_mps=moves), "vut": track(0.0, 0.0, 10.0, 3.4)}
    evidence = make(truth=truth, session=((0.0, SessionPhase.RUNNING),), own_states=())
    judged = judge(replace(EXPECTED, since="motion", within=Within(0.1)), evidence, 0)
    assert judged.reaction is not None
    assert judged.reaction.seconds == pytest.approx(0.0, abs=0.021)


def test_counted_from_the_trigger_that_asks_for_it(make: Make) -> None:
    safety = (SafetyNote(5.5, "object_silent", "scenario_manager", "ot1"),)
    evidence = make(safety=safety, session=((0.0, SessionPhase.RUNNING),), own_states=())
    judged = judge(replace(EXPECTED, since="trigger", stops=False), evidence, 0)
    assert judged.reaction is not None
    assert judged.reaction.seconds == pytest.approx(0.5)


def test_counted_from_the_abort_where_the_fault_endangers_nobody(make: Make) -> None:
    judged = judge(replace(EXPECTED, since="abort"), make(), 0)
    # 3.32 s to the standstill, without any blind time.
    assert judged.stops["ot1"].distance_m == pytest.approx(7.0 * 0.18 + 49.0 / 8.0, abs=0.2)
    assert judged.stops["ot1"].bound_m < 10.0


def test_on_the_walls_clock(make: Make) -> None:
    expected = replace(EXPECTED, within=Within(0.75, clock="wall"), stops=False)
    heard = (
        RunnerEvent("session", "ARMED", "", 0.0, 9.0),
        RunnerEvent("safety", "object_silent", "scenario_manager ot1", 3.32, 10.6),
    )
    faults = (FaultNote(FAULT_S, 0, True, 10.0),)
    judged = judge(expected, make(runner_events=heard, faults=faults), 0)
    assert judged.reaction is not None
    assert judged.reaction.seconds == pytest.approx(0.6)
    assert judged.reaction.is_within_bound
    late = (*heard[:1], replace(heard[1], wall_s=10.8))
    assert not judge(expected, make(runner_events=late, faults=faults), 0).ok
    # Told by the node that injects it.
    told = (RunnerEvent("fault", "0 link_cut", "ot1 begins", 3.0, 10.1), *heard)
    judged = judge(expected, make(runner_events=told), 0)
    assert judged.reaction is not None
    assert judged.reaction.seconds == pytest.approx(0.5)


def test_a_run_in_one_process_has_no_wall_clock(make: Make) -> None:
    expected = replace(EXPECTED, within=Within(0.75, clock="wall"), stops=False)
    judged = judge(expected, make(has_wall=False), 0)
    assert judged.reaction is None
    assert judged.ok


def test_a_run_may_be_over_before_a_watch_notices(make: Make) -> None:
    expected = replace(
        EXPECTED, within=Within(2.0, clock="wall"), since="abort", may_end_first=True
    )
    over = make(
        session=((0.0, SessionPhase.RUNNING), (9.0, SessionPhase.FINISHED)),
        own_states=(),
        safety=(),
        faults=(FaultNote(FAULT_S, 0, True, 10.0),),
    )
    assert judge(expected, over, 0).ok
    assert not judge(replace(expected, may_end_first=False), over, 0).ok


def test_lockstep_may_have_a_bound_of_its_own(make: Make) -> None:
    expected = replace(EXPECTED, lockstep=Within(0.01))
    assert findings(make(own_states=()), lockstep=expected.lockstep) != ()
    assert expected.bound("realtime") == EXPECTED.within


@pytest.mark.parametrize(
    ("begun_s", "found"),
    [
        (FAULT_S, "verdict valid, not aborted"),
        (16.48, "not injected: pause came at 16.48 s, the run was complete at 8.00 s"),
        (None, "not injected: pause never came, the run was complete at 8.00 s"),
    ],
)
@pytest.mark.parametrize("by_bag", [True, False])
def test_a_fault_that_came_when_its_run_was_complete_was_not_injected(
    make: Make, by_bag: bool, begun_s: float | None, found: str
) -> None:
    evidence = make(verdict="valid", reasons=())
    fault = Fault(kind="pause", target="sil_world", at_s=FAULT_S, duration_s=1.0)
    late = replace(
        evidence,
        spec=evidence.spec.model_copy(update={"faults": [fault]}),
        session=(RUNNING, *([(8.0, SessionPhase.STOPPING)] if by_bag else [])),
        runner_events=(RunnerEvent("session", "STOPPING", "", 8.0, 12.0),),
        faults=() if begun_s is None else (FaultNote(begun_s, 0, True, 14.0),),
    )
    told = findings(late)
    assert found in told
    assert len(told) == 1 or begun_s == FAULT_S
    # What nodes inject comes at its time: a run that goes on to its end hasn't answered it.
    assert "verdict valid, not aborted" in findings(replace(late, spec=evidence.spec))
