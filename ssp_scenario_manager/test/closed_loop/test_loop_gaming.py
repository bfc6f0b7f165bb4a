"""Ways to game a driven run, on other events than the cut-in and with latency (METHOD 8)."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache

import pytest

from ssp_core.clock import seconds_to_ns
from ssp_core.errors import PeerError
from ssp_core.motion.trajectory import Trajectory
from ssp_core.run_file.latency import ZERO_LATENCY, Latency
from ssp_core.world.driver import Answer, Question
from ssp_core.world.reference_line import ReferenceLine
from ssp_ot_controller.driving import baselines
from ssp_ot_controller.driving.baselines import lane_plan
from ssp_scenario_manager.closed_loop.campaigns.plan_file import CampaignDriver
from ssp_scenario_manager.closed_loop.campaigns.runs import (
    Job,
    drive_start,
    order_of,
    rows_of,
)
from ssp_scenario_manager.closed_loop.contact import first_contact
from ssp_scenario_manager.closed_loop.outcomes.needless import needless_of
from ssp_scenario_manager.closed_loop.outcomes.outcome import DriverRun, outcome_of
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS
from ssp_scenario_manager.closed_loop.single_run.single import driven_run_summary
from ssp_scenario_manager.closed_loop.starts.start import NoStart, Start, make_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.compile.task import TASK_FOLDER, load_task
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import Record
from tests.support.events.places import site_of

# Seeds from which on the first start with a contact is taken.
EVENTS = {
    "crossing_car": 7,
    "cut_out": 1,
    "lead_braking": 1,
    "merge": 1,
    "oncoming_turn": 2,
    "roundabout": 6,
    "slow_lead": 1,
    "vru_crossing": 2,
    "vut_turn": 3,
}
LATENCY = Latency(0.3)
SCRIPTED = CampaignDriver(driver="scripted")


@pytest.fixture(scope="module")
def start_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Start, Record]]:
    """Makes the start of an event, and the built-in driver's event-free run of it."""

    @cache
    def make(event: str) -> tuple[Start, Record]:
        folder = tmp_path_factory.mktemp("gaming") / event
        run = prepare_run(event, site_of(event), folder, seed=1, mode="lockstep")
        tunings = load_task(folder / TASK_FOLDER).tunings_of(run)
        k_star, seed, start = load_event(event)[0], EVENTS[event], None
        while start is None or start.contact is None:
            with suppress(NoStart):
                start = make_start(run, k_star, seed, latency_max_s=1.0, tunings=tunings)
            seed += 1
            assert seed < EVENTS[event] + 20
        free = drive_start(start, CampaignDriver(driver="built_in"), ZERO_LATENCY, event=False)
        return start, free.record

    return make


@pytest.fixture(scope="module")
def steady_of(start_of: Callable[[str], tuple[Start, Record]]) -> Callable[[str], DriverRun]:
    """Drives the start of an event at constant velocity, once for all tests, which only read it."""
    constant = CampaignDriver(driver="constant_velocity")
    return cache(lambda event: drive_start(start_of(event)[0], constant, LATENCY))


@dataclass(frozen=True)
class Now:
    """One question, with what a cheat knows of the start."""

    question: Question
    start: Start

    @property
    def at_s(self) -> float:
        return self.question.stamp_ns / 1e9

    @property
    def first_mps(self) -> float:
        """Speed of the twin at the hand-over."""
        return self.start.twin[round(self.start.hand_over_s * 1e9)].speed_mps

    @property
    def change(self) -> float:
        """Difference from the first speed that no braking makes needless, m/s."""
        return 1.5 * max(self.at_s + LATENCY.seconds - self.start.hand_over_s, 0.0)


def brake_and_speed_up(now: Now) -> Answer:
    """Brake for 0.8 s at the hand-over, and drive at the first speed again."""
    since_s = now.at_s - now.start.hand_over_s
    return lane_plan(now.question, 5.0 if -0.3 <= since_s < 0.5 else 0.0)


def slow_gently(now: Now) -> Answer:
    """Slow by 0.6 m/s² from the first question on, which alone is no needless braking."""
    return lane_plan(now.question, 0.6)


def dither(now: Now) -> Answer:
    """Brake hard in every second plan."""
    return lane_plan(now.question, 7.0 if now.question.number % 2 else 0.0)


def say_nothing(now: Now) -> Answer:
    """Answer nothing from just before T_obs on, so that the fallback brakes."""
    quiet = now.at_s >= now.start.observable_s - LATENCY.seconds
    return Answer(None) if quiet else lane_plan(now.question)


def plan_two_seconds_and_say_nothing(now: Now) -> Answer:
    """Plan exactly 2 s up to just before T_obs: the plan ends when the braking is wanted."""
    plan = lane_plan(now.question).trajectory
    assert plan is not None
    short = Trajectory(plan.t_s[:21], plan.x_m[:21], plan.y_m[:21])
    return Answer(None if now.at_s >= now.start.observable_s - 0.5 else short)


def stop_before_the_event(now: Now) -> Answer:
    """Stand well in front of where the object comes."""
    return lane_plan(now.question, 3.5)


def hang_at_the_right_moment(now: Now) -> Answer:
    """Give no answer once it looks bad: the world holds, and the driver's time runs out."""
    if now.at_s >= now.start.observable_s:
        raise PeerError("no answer within 60 s")
    return lane_plan(now.question)


def drive_a_little_slower(now: Now) -> Answer:
    """Drive 9 % slower than the twin from the first question on, to pass behind the object."""
    return lane_plan(now.question, speed_mps=max(0.91 * now.first_mps, now.first_mps - now.change))


def drive_a_little_faster(now: Now) -> Answer:
    """Drive 9 % faster than the twin from the first question on, to pass before the object."""
    return lane_plan(now.question, speed_mps=min(1.09 * now.first_mps, now.first_mps + now.change))


def dipped(now: Now, since_s: float, by_mps2: float, share: float, for_s: float) -> Answer:
    """Slow to a share of the first speed, and speed up again: the object comes in between."""
    past_s = max(now.at_s + LATENCY.seconds - since_s, 0.0)
    slowed_mps = max(now.first_mps - by_mps2 * past_s, share * now.first_mps)
    risen_mps = slowed_mps + 1.5 * max(past_s - for_s, 0.0)
    return lane_plan(now.question, speed_mps=min(risen_mps, now.first_mps))


def dip_early(now: Now) -> Answer:
    """Slow by 0.35 m/s² from 2 s before T_obs on, for 6 s."""
    return dipped(now, now.start.observable_s - 2.0, 0.35, 0.72, 6.0)


def dip_late(now: Now) -> Answer:
    """Slow by 1.2 m/s² from T_obs on, for 4 s."""
    return dipped(now, now.start.observable_s, 1.2, 0.7, 4.0)


WAYS = (
    ("lead_braking", brake_and_speed_up, "brakes by"),
    ("vru_crossing", brake_and_speed_up, "brakes by"),
    ("lead_braking", slow_gently, ""),
    ("vru_crossing", slow_gently, ""),
    ("vru_crossing", dither, ""),
    ("lead_braking", say_nothing, "falls back"),
    ("vru_crossing", plan_two_seconds_and_say_nothing, "falls back"),
    ("lead_braking", stop_before_the_event, "brakes by"),
    ("slow_lead", stop_before_the_event, "brakes by"),
    ("crossing_car", brake_and_speed_up, "brakes by"),
    ("crossing_car", plan_two_seconds_and_say_nothing, "falls back"),
    ("merge", brake_and_speed_up, "brakes by"),
    ("merge", say_nothing, "falls back"),
    ("roundabout", brake_and_speed_up, "brakes by"),
    ("vru_crossing", hang_at_the_right_moment, ""),
    ("vru_crossing", drive_a_little_slower, ""),
    ("vru_crossing", drive_a_little_faster, ""),
    ("crossing_car", drive_a_little_slower, ""),
    ("crossing_car", drive_a_little_faster, ""),
    ("crossing_car", dip_early, "driven as here"),
    ("crossing_car", dip_late, "driven as here"),
    ("oncoming_turn", drive_a_little_slower, ""),
    ("oncoming_turn", drive_a_little_faster, ""),
)


def cheat(monkeypatch: pytest.MonkeyPatch, start: Start, way: Callable[[Now], Answer]) -> None:
    """Make `scripted` a driver that goes one of the ways."""

    class Cheat(baselines.ConstantVelocity):
        def answer(self, question: Question) -> Answer:
            return way(Now(question, start))

    monkeypatch.setitem(baselines.BASELINES, "scripted", Cheat)


@pytest.mark.parametrize(
    ("event", "way", "needless_for"), WAYS, ids=[f"{e}-{way.__name__}" for e, way, _ in WAYS]
)
def test_no_way_to_game_it_gains_a_headline_on_other_events_or_with_latency(
    event: str,
    way: Callable[[Now], Answer],
    needless_for: str,
    start_of: Callable[[str], tuple[Start, Record]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    start, built_in = start_of(event)
    cheat(monkeypatch, start, way)
    drove = drive_start(start, SCRIPTED, LATENCY)
    free = drive_start(start, SCRIPTED, LATENCY, event=False)
    needless = needless_of(drove, free, built_in, start.contact)
    succeeds = drove.outcome.kind == "avoided" and not needless
    assert not succeeds, (drove.outcome, needless)
    assert needless.startswith(needless_for)
    if way is hang_at_the_right_moment:
        assert drove.outcome.kind == "died"
        assert "no answer within 60 s" in drove.outcome.why


def test_a_dip_is_avoided_and_needless_in_a_campaigns_row_and_in_a_runs_result(
    start_of: Callable[[str], tuple[Start, Record]], monkeypatch: pytest.MonkeyPatch
) -> None:
    start, _ = start_of("crossing_car")
    cheat(monkeypatch, start, dip_late)
    sealed = json.dumps({"event": "crossing_car", "kind": "critical", **start.sealed()})
    (row,) = rows_of(Job(sealed, SCRIPTED, (LATENCY,), repeats=1, seed=1)).rows
    drove = drive_start(start, SCRIPTED, LATENCY)
    told = driven_run_summary(drove.run, drove.result, drove.record)[0]["driven"]
    for said in (dict(zip(RUN_COLUMNS, row, strict=True)), told):
        assert said["outcome"] == "avoided"
        assert said["needless"] == "driven as here, it has no contact in the event either"


def test_the_event_is_laid_over_its_twin_only_where_both_have_a_way_up_to_t_end(
    start_of: Callable[[str], tuple[Start, Record]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A start that meets nothing owes no response; a contact or another outcome cuts a way off."""
    start, built_in = start_of("crossing_car")
    cheat(monkeypatch, start, dip_late)
    drove, free = (drive_start(start, SCRIPTED, LATENCY, event=event) for event in (True, False))
    assert needless_of(drove, free, built_in, start.contact)
    assert not needless_of(drove, free, built_in, None)
    touched = replace(free, outcome=replace(free.outcome, contact=start.contact))
    assert not needless_of(drove, touched, built_in, start.contact)
    evaded = replace(drove, outcome=replace(drove.outcome, kind="evaded"))
    assert not needless_of(evaded, free, built_in, start.contact)


def test_a_run_that_ends_before_t_end_avoids_nothing(
    start_of: Callable[[str], tuple[Start, Record]], steady_of: Callable[[str], DriverRun]
) -> None:
    """A record that is cut half a second before its contact has none, and isn't a success."""
    start, _ = start_of("crossing_car")
    drove = steady_of("crossing_car")
    assert drove.outcome.contact is not None
    last_ns = seconds_to_ns(drove.outcome.contact.at_s - 0.5)
    record = Record([one for one in drove.record.reports if one.now_ns <= last_ns])
    found = outcome_of(drove.run, drove.driven, drove.result, record, start.twin)
    assert (found.kind, found.contact) == ("harness", None)
    assert "before T_end" in found.why


def test_constant_velocity_gains_none_either_and_the_oracle_does(
    start_of: Callable[[str], tuple[Start, Record]], steady_of: Callable[[str], DriverRun]
) -> None:
    """The tests above would pass for a session in which nothing can be avoided."""
    oracle = CampaignDriver(driver="oracle")
    for event in EVENTS:
        start, built_in = start_of(event)
        assert steady_of(event).outcome.kind == "collision", event
        drove, free = (drive_start(start, oracle, LATENCY, event=one) for one in (True, False))
        assert drove.outcome.kind == "avoided", event
        assert not needless_of(drove, free, built_in, start.contact), event


def test_objects_move_alike_on_every_event_and_braking_for_nothing_gains_nothing(
    start_of: Callable[[str], tuple[Start, Record]],
) -> None:
    """Objects, byte by byte from the hand-over to the earlier end, and the baselines of 8.10."""
    for event in EVENTS:
        start, built_in = start_of(event)
        assert start.contact is not None
        # The earlier end is that of the run with the contact; objects brake behind it.
        end_ns = seconds_to_ns(start.contact.at_s + 0.9)
        moved = []
        for name in ("no_response", "always_brake", "stop_at_once"):
            driver = CampaignDriver(driver=name)
            drove = drive_start(start, driver, LATENCY)
            reports = [r for r in drove.record.reports if r.now_ns <= end_ns]
            moved.append(
                [repr([s for s in r.truths if s.object_id != start.run.vut.id]) for r in reports]
            )
            if name == "no_response":
                contact = first_contact(drove.record.reports, start.run.vut.id)
                assert contact is not None
                assert contact.relative_mps == start.v_r_mps, event
                continue
            if drove.outcome.kind == "avoided":
                free = drive_start(start, driver, LATENCY, event=False)
                assert needless_of(drove, free, built_in, start.contact), (event, name)
        assert len(moved[0]) > 100
        assert moved[0] == moved[1] == moved[2], event


def test_constant_velocity_is_asked_first_at_its_twins_speed_and_has_its_speed_of_contact(
    start_of: Callable[[str], tuple[Start, Record]], steady_of: Callable[[str], DriverRun]
) -> None:
    """A hundredth of a metre per second more or less is a later contact, in a bend another v_r."""
    for event in EVENTS:
        start, _ = start_of(event)
        first, handed = (
            start.twin[seconds_to_ns(at_s)].speed_mps
            for at_s in (start.first_request_s, start.hand_over_s)
        )
        assert first == pytest.approx(handed, abs=0.003), event
        contact = first_contact(steady_of(event).record.reports, start.run.vut.id)
        assert contact is not None
        assert contact.relative_mps == pytest.approx(start.v_r_mps, abs=0.05), event


def test_constant_velocity_turns_into_a_ring_alike_at_each_latency(
    start_of: Callable[[str], tuple[Start, Record]],
) -> None:
    """A VUT follows beginnings of plans alone at a small L, and they must bend as its lane does."""
    start, _ = start_of("roundabout")
    assert start.contact is not None
    before_ns = seconds_to_ns(start.contact.at_s - 0.1)
    headings = []
    for latency in (ZERO_LATENCY, Latency(0.1), LATENCY):
        drove = drive_start(start, CampaignDriver(driver="constant_velocity"), latency)
        vut = next(s for s in drove.record.truths(start.run.vut.id) if s.stamp_ns == before_ns)
        headings.append(math.degrees(vut.yaw_rad))
        assert drove.outcome.contact is not None
        assert drove.outcome.contact.relative_mps == pytest.approx(start.v_r_mps, abs=0.05)
    assert max(headings) - min(headings) < 0.2


def test_what_is_an_event_by_being_there_stands_beside_the_road_in_the_event_free_twin(
    start_of: Callable[[str], tuple[Start, Record]],
) -> None:
    start, _ = start_of("slow_lead")
    run = start.driven_by("constant_velocity", {}, LATENCY, event=False)
    (target,), (before,) = run.targets, start.run.targets
    assert target.approach is None
    line = ReferenceLine.of_road(run.road)
    places = [line.to_local(one.start.x_m, one.start.y_m) for one in (target, before)]
    assert places[0][0] == pytest.approx(places[1][0], abs=1e-6)
    edge_m = min(lane.y_m - lane.width_m / 2.0 for lane in run.road.lanes)
    assert places[0][1] + target.size.width_m / 2.0 == pytest.approx(edge_m - 0.15)
    assert start.driven_by("constant_velocity", {}, LATENCY).targets == start.run.targets


def test_a_driver_that_ends_where_no_event_comes_is_needless(
    start_of: Callable[[str], tuple[Start, Record]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It could brake blindly where it expects an event, and leave where none comes."""
    start, built_in = start_of("vru_crossing")

    class Leaves(baselines.ConstantVelocity):
        def answer(self, question: Question) -> Answer:
            if Now(question, start).at_s > start.hand_over_s + 1.0:
                raise SystemExit(0)
            return super().answer(question)

    monkeypatch.setitem(baselines.BASELINES, "scripted", Leaves)
    drove, free = (drive_start(start, SCRIPTED, LATENCY, event=event) for event in (True, False))
    assert free.outcome.kind == "died"
    needless = needless_of(drove, free, built_in, start.contact)
    assert needless == f"ends by died at {free.outcome.at_s:.2f} s"


def test_a_driver_begins_each_run_without_what_it_was_in_the_one_before(
    start_of: Callable[[str], tuple[Start, Record]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that would brake in its second run alone, which it took for the event."""
    start, _ = start_of("vru_crossing")
    made: list[int] = []

    class Remembering(baselines.ConstantVelocity):
        def __init__(self, options: baselines.ConstantVelocity.Options) -> None:
            super().__init__(options)
            self.runs = 0
            made.append(id(self))

        def answer(self, question: Question) -> Answer:
            self.runs += question.number == 1
            return lane_plan(question, 6.0 if self.runs > 1 else 0.0)

    monkeypatch.setitem(baselines.BASELINES, "scripted", Remembering)
    first, second = (drive_start(start, SCRIPTED, LATENCY) for _ in range(2))
    assert (first.outcome.kind, second.outcome.kind) == ("collision", "collision")
    assert [repr(r.truths) for r in first.record.reports] == [
        repr(r.truths) for r in second.record.reports
    ]
    assert len(made) == 2


def test_the_order_of_event_and_twin_is_no_sign_of_which_is_which() -> None:
    names = [f"1 sha256:{k:x} mine 0.3 0" for k in range(400)]
    first = sum(order_of(name)[0] for name in names)
    assert 150 < first < 250
    assert [order_of(name) for name in names] == [order_of(name) for name in names]
    assert all(sorted(order_of(name)) == [False, True] for name in names)


def test_the_run_file_of_the_twin_differs_in_nothing_that_a_driver_gets(
    start_of: Callable[[str], tuple[Start, Record]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The questions to a driver without frames are the same in both, up to the contact."""
    start, _ = start_of("vru_crossing")
    assert start.contact is not None
    contact_ns = start.contact.stamp_ns
    seen: dict[bool, list[str]] = {True: [], False: []}
    asked: list[str] = []

    class Recording(baselines.ConstantVelocity):
        def answer(self, question: Question) -> Answer:
            if question.stamp_ns < contact_ns:
                asked.append(repr(question))
            return super().answer(question)

    monkeypatch.setitem(baselines.BASELINES, "scripted", Recording)
    for event in (True, False):
        asked.clear()
        drive_start(start, SCRIPTED, LATENCY, event=event)
        seen[event] = list(asked)
    assert len(seen[True]) > 10
    assert seen[True] == seen[False]
