"""The end of a driven run, by its driver and by what else ends it (METHOD 8.2)."""

from __future__ import annotations

import math
from unittest.mock import Mock

import pytest

from ssp_core.clock import seconds_to_ns
from ssp_core.motion.trajectory import Trajectory
from ssp_core.run_file.latency import ZERO_LATENCY
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import SessionPhase, Verdict
from ssp_core.world.driver import Answer, Question
from ssp_ot_controller.driving import baselines
from ssp_scenario_manager.closed_loop.outcomes.outcome import Outcome, outcome_of
from ssp_scenario_manager.closed_loop.starts.start import OffSpec, Start, make_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import InProcessResult, run_in_process
from ssp_scenario_manager.session import outbox
from tests.support.events.walls import with_wall

SEED = 1


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> RunSpec:
    folder = tmp_path_factory.mktemp("ends") / "cut_in"
    return prepare_run("cut_in", "boulevard", folder, seed=SEED, mode="lockstep")


@pytest.fixture(scope="module")
def start(compiled: RunSpec) -> Start:
    """A critical start of the shipped cut-in."""
    return make_start(compiled, load_event("cut_in")[0], SEED, latency_max_s=0.5)


Ended = tuple[Outcome, InProcessResult, dict[SessionPhase, int], list[tuple[SafetyCode, str]]]


def ended(run: RunSpec, start: Start) -> Ended:
    """Return what a run came to, when its session changed, and the limits that objects saw."""
    said: list[object] = []
    result, record = run_in_process(run, listener=Mock(sent=said.append))
    changes = {one.state: one.stamp_ns for one in said if isinstance(one, outbox.StateChanged)}
    seen = [(one.code, one.object_id) for report in record.reports for one in report.limits]
    assert run.driven is not None
    return outcome_of(run, run.driven, result, record, start.twin), result, changes, seen


def beside(start: Start, free_m: float) -> RunSpec:
    """A run with a second object, which stands so far beside the way of the first."""
    run = start.driven_by("constant_velocity", {}, ZERO_LATENCY)
    (first,) = run.targets
    y_m = first.start.y_m + first.size.width_m + free_m
    place = first.start.model_copy(update={"x_m": 115.0, "y_m": y_m})
    second = first.model_copy(update={"id": "ot2", "start": place, "approach": None})
    return run.model_copy(update={"targets": [first, second]})


def test_a_run_goes_on_for_a_second_after_its_contact_else_to_t_end(start: Start) -> None:
    steady = ended(start.driven_by("constant_velocity", {}, ZERO_LATENCY), start)
    oracle = ended(start.driven_by("oracle", {}, ZERO_LATENCY), start)
    assert [steady[0].kind, oracle[0].kind] == ["collision", "avoided"]
    assert steady[0].contact is not None
    stops = [changes[SessionPhase.STOPPING] for _, _, changes, _ in (steady, oracle)]
    assert stops == [steady[0].contact.stamp_ns + 1_000_000_000, seconds_to_ns(start.end_s)]


class Leaving(baselines.ConstantVelocity):
    """Moves 1.2 m to the right at its second question, and says nothing more."""

    def answer(self, question: Question) -> Answer:
        if question.number != 2:
            return baselines.lane_plan(question) if question.number == 1 else Answer(None)
        t = [0.1 * k for k in range(51)]
        aside = [0.6 * (math.cos(0.5 * math.pi * min(s, 2.0)) - 1.0) for s in t]
        return Answer(Trajectory(tuple(t), tuple(question.speed_mps * s for s in t), tuple(aside)))


def test_a_run_goes_on_for_a_second_after_its_contact_with_scenery(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(baselines.BASELINES, "leaving", Leaving)
    run = start.driven_by("leaving", {}, ZERO_LATENCY)
    (open_road, _, opened, _), (outcome, result, changes, seen) = (
        ended(one, start) for one in (with_wall(run, wall=False), with_wall(run))
    )
    assert outcome.contact is not None
    assert (outcome.kind, outcome.contact.other) == ("collision", "building road.scenery[0]")
    over_ns = outcome.contact.stamp_ns + 1_000_000_000
    assert changes[SessionPhase.STOPPING] == over_ns < seconds_to_ns(start.end_s)
    assert (result.verdict, seen) == (Verdict.VALID, [])
    # The same drive without the wall touches the object, and later.
    assert open_road.contact is not None
    assert open_road.contact.other == "ot1"
    assert opened[SessionPhase.STOPPING] == open_road.contact.stamp_ns + 1_000_000_000 > over_ns


def test_a_seed_whose_twin_touches_scenery_gives_no_start(compiled: RunSpec, start: Start) -> None:
    """Such a contact ends the twin, and would be every driver's that keeps its lane."""
    assert start.contact is not None
    meant = start.twin[start.contact.stamp_ns]
    at_m = meant.x_m - 5.0
    walled = with_wall(compiled, from_m=at_m, left_m=0.99 * meant.box.corners()[-1][1])
    with pytest.raises(OffSpec, match=r"the VUT touches building road.scenery\[0\] at 1\d\.") as no:
        make_start(walled, load_event("cut_in")[0], SEED, latency_max_s=0.5)
    assert str(no.value).startswith("without a response ")
    behind = with_wall(compiled, from_m=meant.x_m + 10.0)
    make_start(behind, load_event("cut_in")[0], SEED, latency_max_s=0.5)


def test_separation_between_objects_ends_a_driven_run_and_that_to_the_vut_does_not(
    start: Start,
) -> None:
    """Objects watch it as in any run; the VUT's contact in the other run is no limit to anybody."""
    outcome, result, changes, seen = ended(beside(start, 0.3), start)
    assert (outcome.kind, result.verdict) == ("fence", Verdict.FAILED_SAFETY)
    assert outcome.why.startswith("separation: ot1: ")
    assert seen == [(SafetyCode.SEPARATION, "ot1"), (SafetyCode.SEPARATION, "ot2")]
    assert seconds_to_ns(start.hand_over_s) < changes[SessionPhase.ABORTING] == result.aborted_ns
    outcome, result, _, seen = ended(beside(start, 0.6), start)
    assert (outcome.kind, result.verdict, seen) == ("collision", Verdict.VALID, [])
