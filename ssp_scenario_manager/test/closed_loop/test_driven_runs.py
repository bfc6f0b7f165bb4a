"""Driven runs in one process: starts and twins, outcomes, and what a driver can't do (METHOD 8)."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest

from ssp_core.motion.trajectory import Trajectory
from ssp_core.run_file.latency import Latency
from ssp_core.run_file.model import Fault, RunSpec
from ssp_core.world.driver import Answer, GivenAnswer, LatencyParts, Question
from ssp_core.world.plant import StepReport
from ssp_ot_controller.driving import baselines
from ssp_ot_controller.driving.baselines import lane_plan
from ssp_scenario_manager.closed_loop.campaigns.seal import _draw_facts
from ssp_scenario_manager.closed_loop.contact import contact_words, first_contact, until
from ssp_scenario_manager.closed_loop.outcomes.needless import needless_in
from ssp_scenario_manager.closed_loop.outcomes.outcome import (
    Outcome,
    driven_summary,
    figures_of,
    outcome_of,
)
from ssp_scenario_manager.closed_loop.single_run.top_view import top_view
from ssp_scenario_manager.closed_loop.starts.start import ShortRunUp, Start, make_start, twin_of
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.compile.task import EVENT_FILE, TASK_FOLDER
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import (
    InProcessResult,
    Record,
    run_in_process,
)
from ssp_scenario_manager.run.sweep import say_driven

SEED = 1


@pytest.fixture(scope="module")
def compiled_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("driven") / "cut_in"


@pytest.fixture(scope="module")
def compiled(compiled_folder: Path) -> RunSpec:
    return prepare_run("cut_in", "boulevard", compiled_folder, seed=SEED, mode="lockstep")


@pytest.fixture(scope="module")
def start(compiled: RunSpec) -> Start:
    """A critical start of the shipped cut-in."""
    return make_start(compiled, load_event("cut_in")[0], SEED, latency_max_s=2.0)


Driven = tuple[Outcome, InProcessResult, Record]


def driven(
    start: Start, driver: str, latency_s: float = 0.0, *, event: bool = True, **options: Any
) -> Driven:
    run = start.driven_by(driver, options, Latency(latency_s), event=event)
    result, record = run_in_process(run)
    assert run.driven is not None
    return outcome_of(run, run.driven, result, record, start.twin), result, record


@pytest.fixture(scope="module")
def drive_baseline(start: Start) -> Callable[..., Driven]:
    """Drives the start by a baseline, each run once for all tests, which only read it."""
    return cache(partial(driven, start))


@pytest.fixture(scope="module")
def built_in(drive_baseline: Callable[..., Driven]) -> Record:
    """The built-in driver's event-free run."""
    return drive_baseline("built_in", event=False)[2]


class Scripted(baselines.ConstantVelocity):
    """A driver that says what a test says."""

    says: Callable[[Question], Answer]

    def answer(self, question: Question) -> Answer:
        return type(self).says(question)


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Makes the driver ``scripted`` say what a function says."""

    def make(says: Callable[[Question], Answer]) -> None:
        kind = type("One", (Scripted,), {"says": staticmethod(says)})
        monkeypatch.setitem(baselines.BASELINES, "scripted", kind)

    return make


# -- starts ----------------------------------------------------------------------------------------


def test_a_start_keeps_the_rules_of_its_hand_over(start: Start) -> None:
    (fires_s,) = (trigger.condition.after_s for trigger in start.run.triggers)  # type: ignore[union-attr]
    assert start.hand_over_s <= fires_s - 0.5 + 0.02
    assert start.hand_over_s >= 1.7 + 2.0 + start.frame_period_s
    assert start.first_request_s == pytest.approx(start.hand_over_s - 2.0 - 0.1)
    assert start.contact is not None
    assert start.end_s == pytest.approx(start.contact.at_s + 5.0)
    assert start.hand_over_s < start.observable_s < start.contact.at_s
    assert not start.run.traffic
    assert start.run.triggers[0].adaptation is None


def test_values_are_drawn_from_the_box_and_a_seed_gives_the_same_start(
    start: Start, compiled: RunSpec
) -> None:
    event = load_event("cut_in")[0]
    again = make_start(compiled, event, SEED, latency_max_s=2.0)
    assert (again.hash, again.facts()) == (start.hash, start.facts())
    assert 12.0 <= start.values["driver.cruise_mps"] <= 14.0
    assert 16.0 <= start.values["triggers.0.condition.below_m"] <= 20.0
    assert 2.0 <= start.values["triggers.0.manoeuvre.duration_s"] <= 3.0
    assert start.run.driver.cruise_mps == start.values["driver.cruise_mps"]


def test_a_seed_whose_first_trigger_leaves_no_time_is_no_start(compiled: RunSpec) -> None:
    with pytest.raises(ShortRunUp, match=r"run-up is too short.*first trigger fires"):
        make_start(compiled, load_event("cut_in")[0], SEED, latency_max_s=9.0)


def test_a_seed_without_time_for_the_hand_over_is_counted_apart_from_another_event(
    compiled_folder: Path, compiled: RunSpec
) -> None:
    """The same seed is critical where the largest latency is smaller."""
    event_file = str(compiled_folder / TASK_FOLDER / EVENT_FILE)
    told = compiled.model_dump_json(by_alias=True)
    assert _draw_facts(told, event_file, (2.0, 0.0), SEED)[0] == "critical"
    kind, facts = _draw_facts(told, event_file, (9.0, 0.0), SEED)
    assert (kind, facts["seed"]) == ("short_run_up", SEED)
    assert facts["why"].startswith("the run-up is too short")


def test_the_twin_at_the_times_of_its_triggers_is_the_twin_to_the_last_bit(start: Start) -> None:
    twin, contact = twin_of(start.driven_by("oracle", {}, Latency(0.5)))
    assert contact == start.contact
    assert list(map(repr, twin.values())) == [repr(start.twin[at_ns]) for at_ns in twin]


# -- what holds of the baselines -------------------------------------------------------------------


def test_no_response_reproduces_the_twin_and_constant_velocity_comes_near(
    start: Start, drive_baseline: Callable[..., Driven]
) -> None:
    assert start.contact is not None
    still, _, _ = drive_baseline("no_response")
    assert (still.kind, still.contact) == ("collision", start.contact)
    for latency_s in ((), (2.0,)):
        steady, _, _ = drive_baseline("constant_velocity", *latency_s)
        assert steady.contact is not None
        assert abs(steady.contact.relative_mps - start.contact.relative_mps) <= 0.05


def test_objects_move_alike_whatever_the_vut_does(
    start: Start, drive_baseline: Callable[..., Driven]
) -> None:
    """Byte by byte, for a VUT that stops at once and one that never brakes."""
    records = [drive_baseline(name)[2] for name in ("stop_at_once", "constant_velocity")]
    rows = [[repr(s) for s in record.truths("ot1")] for record in records]
    arrived = [[repr(s) for s in record.arrived("ot1")] for record in records]
    # The earlier end is that of the run with the contact; objects brake behind it.
    assert start.contact is not None
    steps = round((start.contact.at_s + 0.9) / start.run.step_s)
    assert rows[0][:steps] == rows[1][:steps]
    assert arrived[0][:steps] == arrived[1][:steps]


def test_the_oracle_avoids_and_whoever_brakes_for_nothing_gains_nothing(
    start: Start, built_in: Record, drive_baseline: Callable[..., Driven]
) -> None:
    def headline(driver: str) -> bool:
        event, _, _ = drive_baseline(driver)
        run = start.driven_by(driver, {}, Latency(0.0), event=False)
        alone, _, free = drive_baseline(driver, event=False)
        assert run.driven is not None
        needless = needless_in(run, run.driven, free, built_in, alone)
        return event.kind == "avoided" and not needless

    told = {name: headline(name) for name in ("oracle", "stop_at_once", "always_brake")}
    assert told == {"oracle": True, "stop_at_once": False, "always_brake": False}


def test_the_same_start_and_latency_give_the_same_bytes(start: Start) -> None:
    one, other = (driven(start, "aeb", 0.2)[2] for _ in range(2))
    assert [repr(r.truths) for r in one.reports] == [repr(r.truths) for r in other.reports]


# -- outcomes of drivers that fail or play ---------------------------------------------------------


def turning(question: Question) -> Answer:
    """Leave the lane to the right."""
    t = tuple(0.1 * k for k in range(51))
    v = question.speed_mps
    return Answer(Trajectory(t, tuple(v * s for s in t), tuple(-0.4 * s * s for s in t)))


def oncoming(question: Question) -> Answer:
    """Go over into the lanes of opposite direction, as far as the road goes."""
    t = tuple(0.1 * k for k in range(51))
    v = question.speed_mps
    return Answer(Trajectory(t, tuple(v * s for s in t), tuple(0.5 * s * s for s in t)))


def shifted(question: Question, **changes: Any) -> Answer:
    plan = lane_plan(question).trajectory
    assert plan is not None
    return Answer(replace(plan, **changes))


def raising(question: Question) -> Answer:
    if question.stamp_ns > 11_500_000_000:
        raise MemoryError("1 GB")
    return lane_plan(question)


def far_away(question: Question) -> Answer:
    plan = lane_plan(question).trajectory
    assert plan is not None
    return Answer(replace(plan, x_m=tuple(x + 10_000.0 for x in plan.x_m)))


def silent_behind_its_brake(question: Question) -> Answer:
    """Brake once and say nothing more: the plan goes stale while it brakes."""
    if question.stamp_ns > 11_200_000_000:
        return Answer(None)
    return lane_plan(question, 6.0 if question.stamp_ns > 11_000_000_000 else 0.0)


def short(question: Question) -> Answer:
    """Plan exactly 2 s."""
    plan = lane_plan(question).trajectory
    assert plan is not None
    return Answer(Trajectory(plan.t_s[:21], plan.x_m[:21], plan.y_m[:21]))


@pytest.mark.parametrize(
    ("says", "kind", "why"),
    [
        (turning, "left_road", "beside the carriageway"),
        (oncoming, "left_road", "in a lane of opposite direction|beside the carriageway"),
        (raising, "died", "MemoryError: 1 GB"),
        (lambda q: shifted(q, x_m=(math.nan,) * 51), "evaded|fallback|collision", ""),
        (lambda q: shifted(q, x_m=tuple(-1.0 * k for k in range(51))), "evaded|fallback", ""),
        (far_away, "evaded|fallback", ""),
        (silent_behind_its_brake, "fallback", "no plan of its own|first response"),
        (short, "collision", "ot1"),
    ],
    ids=[
        *("leaves the road", "takes the oncoming lane", "crashes", "no numbers", "backwards"),
        *("10 km away", "empty at the right moment", "plans of 2 s"),
    ],
)
def test_a_driver_that_fails_or_plays_has_its_outcome_and_avoids_nothing(
    start: Start,
    scripted: Callable[..., None],
    says: Callable[[Question], Answer],
    kind: str,
    why: str,
) -> None:
    scripted(says)
    outcome, result, _ = driven(start, "scripted")
    assert outcome.kind in kind.split("|"), outcome
    assert not why or any(part in outcome.why for part in why.split("|")), outcome
    assert result.verdict.name != "NONE"


def brake_and_speed_up(question: Question, begin_s: float) -> Answer:
    """Brake for 0.4 s from the hand-over on."""
    brakes = begin_s <= question.stamp_ns / 1e9 < begin_s + 0.4
    return lane_plan(question, 4.0 if brakes else 0.0)


def slow_gently(question: Question, _: float) -> Answer:
    """Slow by 0.5 m/s², which alone is no needless braking."""
    return lane_plan(question, 0.5)


def be_a_little_slower(question: Question, begin_s: float) -> Answer:
    """Slow by less than a tenth before the event, and keep that."""
    slows = begin_s - 0.15 <= question.stamp_ns / 1e9 < begin_s + 0.6
    return lane_plan(question, 1.9 if slows else 0.0)


def dither(question: Question, _: float) -> Answer:
    """Brake in every second plan."""
    return lane_plan(question, 6.0 if question.number % 2 else 0.0)


@pytest.mark.parametrize("way", [brake_and_speed_up, slow_gently, be_a_little_slower, dither])
def test_a_way_to_game_it_gains_no_headline(
    start: Start,
    scripted: Callable[..., None],
    built_in: Record,
    way: Callable[[Question, float], Answer],
) -> None:
    scripted(lambda question: way(question, start.hand_over_s))
    outcome, _, _ = driven(start, "scripted")
    run = start.driven_by("scripted", {}, Latency(0.0), event=False)
    alone, _, free = driven(start, "scripted", event=False)
    assert run.driven is not None
    needless = needless_in(run, run.driven, free, built_in, alone)
    assert outcome.kind != "avoided" or needless, outcome
    if way is brake_and_speed_up:
        assert needless.startswith("brakes by")


def test_what_the_session_brakes_behind_a_contact_is_not_the_drivers(
    start: Start, built_in: Record, drive_baseline: Callable[..., Driven]
) -> None:
    """A run is judged up to its deciding fact; behind it our session stops the VUT."""
    run = start.driven_by("no_response", {}, Latency(0.0), event=False)
    assert run.driven is not None
    alone, _, free = drive_baseline("no_response", event=False)
    decided_s = run.driven.end_s - 2.0

    def braked(report: StepReport) -> StepReport:
        if report.now_ns <= decided_s * 1e9:
            return report
        slowed = [replace(s, acceleration_mps2=-2.5) for s in report.truths]
        return replace(report, truths=tuple(slowed))

    behind = Record([braked(report) for report in free.reports])
    decided = replace(alone, at_s=decided_s)
    assert needless_in(run, run.driven, behind, built_in, decided) == ""
    assert needless_in(run, run.driven, behind, built_in, alone).startswith("brakes by")


def test_a_vut_that_stands_is_struck_and_one_off_its_twin_is_ours(
    start: Start, drive_baseline: Callable[..., Driven]
) -> None:
    run = start.driven_by("stop_at_once", {}, Latency(0.0))
    assert run.driven is not None
    _, result, record = drive_baseline("stop_at_once")

    def hit(report: StepReport) -> StepReport:
        vut = next(s for s in report.truths if s.object_id == "vut")
        if vut.speed_mps > 0.0 or report.now_ns < 15_000_000_000:
            return report
        behind = replace(vut, object_id="ot1", x_m=vut.x_m - vut.size.length_m + 0.1)
        return replace(report, truths=(replace(behind, speed_mps=4.0), vut))

    moved = Record([hit(report) for report in record.reports])
    outcome = outcome_of(run, run.driven, result, moved, start.twin)
    assert (outcome.kind, outcome.at_s) == ("struck", 15.0)
    assert outcome.contact is not None
    assert (outcome.contact.vut_side, outcome.contact.other_side) == ("rear", "front")
    assert outcome.contact.relative_mps == 4.0
    # The car that cuts in was in the lane beside at the hand-over.
    assert outcome.why == "with ot1, rear to front, 4.00 m/s; ot1 entered the lane of vut"
    off = {at_ns: replace(s, x_m=s.x_m + 0.31) for at_ns, s in start.twin.items()}
    assert outcome_of(run, run.driven, result, record, off).kind == "harness"


def test_a_contact_says_who_entered_whose_lane(
    start: Start, drive_baseline: Callable[..., Driven]
) -> None:
    run = start.driven_by("constant_velocity", {}, Latency(0.0))
    _, _, record = drive_baseline("constant_velocity")
    led = until(record.reports, start.hand_over_s, start.end_s)
    before = {s.object_id: s for s in led[0].truths}
    vut, other = before["vut"], before["ot1"]

    def words(vut_m: float, other_m: float, *, other_was_m: float = other.y_m) -> list[str]:
        """Return what is said of a contact at which both have moved sideways to these places."""
        was = replace(led[0], truths=(vut, replace(other, y_m=other_was_m)))
        now = replace(
            led[1],
            truths=(
                replace(vut, x_m=0.0, y_m=vut_m, stamp_ns=led[1].now_ns),
                replace(other, x_m=0.0, y_m=other_m, stamp_ns=led[1].now_ns),
            ),
        )
        contact = first_contact([now], "vut")
        assert contact is not None
        return contact_words(run, [was, now], contact).split("; ")[1:]

    beside_m = other.y_m - vut.y_m
    assert abs(beside_m) > 3.0
    assert words(vut.y_m, vut.y_m + 0.3 * beside_m) == ["ot1 entered the lane of vut"]
    assert words(vut.y_m + 0.7 * beside_m, other.y_m) == ["vut entered the lane of ot1"]
    both = words(vut.y_m + 0.4 * beside_m, other.y_m - 0.4 * beside_m)
    assert both == ["vut entered the lane of ot1", "ot1 entered the lane of vut"]
    # One that follows the other was in the same lane before.
    assert words(vut.y_m, vut.y_m, other_was_m=vut.y_m) == []


def test_limits_and_the_operator_end_a_driven_run_as_any_other(
    start: Start, scripted: Callable[..., None]
) -> None:
    def faster(question: Question) -> Answer:
        t = tuple(0.1 * k for k in range(51))
        return Answer(Trajectory(t, tuple(17.0 * s for s in t), (0.0,) * 51))

    scripted(faster)
    outcome, result, _ = driven(start, "scripted")
    assert (outcome.kind, result.verdict.name) == ("fence", "FAILED_SAFETY"), outcome
    assert "speed" in outcome.why
    abort = Fault(kind="operator_abort", at_s=11.0)
    aborted = replace(start, run=start.run.model_copy(update={"faults": [abort]}))
    outcome, result, _ = driven(aborted, "constant_velocity")
    assert (outcome.kind, result.verdict.name) == ("fence", "ABORTED")
    assert outcome.at_s == pytest.approx(11.0)


def test_a_driver_that_is_asked_nothing_has_no_latency(
    start: Start, capsys: pytest.CaptureFixture[str]
) -> None:
    run = start.driven_by("no_response", {}, Latency(0.5, measured=True))
    assert run.driven is not None
    result, record = run_in_process(run)
    outcome = outcome_of(run, run.driven, result, record, start.twin)
    told = driven_summary(run.driven, record, outcome, None)
    figures = told["measured"]
    assert (figures["answers"], figures["p50_s"], figures["p99_s"]) == (0, None, None)
    say_driven({**told, "needless": ""})
    assert "L: – (nothing was asked)" in capsys.readouterr().out
    assert "L measured, nothing asked" in top_view(run, record, told, None)
    # One that can't be loaded wasn't asked, and one whose time ran out was.
    lost = GivenAnswer(None, ended="it can't be loaded")
    late = GivenAnswer(None, LatencyParts(2_000_000_000), "gave no answer within 2 s")
    assert figures_of([lost], 0.5) == figures
    assert figures_of([lost, late], 0.5)["p50_s"] == 2.0


def test_what_result_json_says_of_a_driven_run(start: Start) -> None:
    outcome, _, record = driven(start, "oracle", 0.4)
    run = start.driven_by("oracle", {}, Latency(0.4))
    assert run.driven is not None
    told = json.loads(json.dumps(driven_summary(run.driven, record, outcome, start.v_r_mps)))
    assert (told["outcome"], told["severity"], told["frames"]) == ("avoided", 5.0, False)
    chain = told["chain"]
    assert chain["observable_s"] <= chain["frame_s"] < chain["observable_s"] + 0.1
    # A question is open when the frame comes: it is asked about as soon as none is.
    assert chain["frame_s"] < chain["asked_s"] < chain["effective_s"] < chain["response_s"]
    assert chain["asked_s"] <= chain["frame_s"] + 0.3
    assert chain["answered_s"] == pytest.approx(chain["asked_s"] + 0.4)
    assert chain["answered_s"] <= chain["effective_s"] < chain["answered_s"] + start.run.step_s
    assert told["start"] == start.hash


def test_an_operator_does_nothing_in_a_twin(compiled: RunSpec, start: Start) -> None:
    """The start of a run that is to be aborted is that of the same run without it."""
    abort = Fault(kind="operator_abort", at_s=start.hand_over_s + 0.5)
    faulted = compiled.model_copy(update={"faults": [abort]})
    again = make_start(faulted, load_event("cut_in")[0], SEED, latency_max_s=2.0)
    assert (again.contact, again.end_s) == (start.contact, start.end_s)
    assert again.twin == start.twin
    aborted = again.driven_by("oracle", {}, Latency(0.0))
    assert aborted.faults == [abort]
    assert twin_of(aborted)[1] == start.contact
    assert again.driven_by("oracle", {}, Latency(0.0), event=False).faults == []
