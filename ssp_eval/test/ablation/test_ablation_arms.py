"""The arms of an ablation: what each is given, and that each plays the event at its own place."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ObjectClass, Verdict
from ssp_eval.ablation import source
from ssp_eval.ablation.ground import (
    ArmRun,
    Frame,
    Ground,
    NoRun,
    Trial,
    Trials,
    executed,
    frame_of,
    ground_of,
    run_of,
    session,
    share_of,
    source_ground,
    varied,
)
from ssp_eval.ablation.judge import judge_trial
from ssp_eval.ablation.placing import Body, most_mps2, placements, timed_motion
from ssp_eval.ablation.relations import by_relations, change_of
from ssp_eval.ablation.source import (
    Relations,
    Source,
    Tracks,
    cast_of,
    read_source,
    relations_of,
    tracks_of,
)
from ssp_eval.ablation.structure import by_structure
from ssp_eval.ablation.tracks import by_tracks
from ssp_eval.audit.evidence.measure import RoadFacts
from ssp_ot_controller.camera.storyboards import LANE_M
from ssp_scenario_manager.compile.compiler import checked_event, load_area
from ssp_scenario_manager.compile.place import Order, realise
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.run.feasibility import driven
from tests.support.events.audit_scenes import cut_out, slow_lead
from tests.support.events.several import several

KINDS = ("cut_in", "vru_crossing", "lead_braking", "occluded_crossing")


def load(name: str) -> Event:
    return checked_event(name)[0]


class Denied:
    """An event, or a participant, of which nothing may be read but what is named."""

    def __init__(self, **allowed: Any) -> None:
        self._allowed = allowed

    def __getattr__(self, name: str) -> Any:
        if name not in self.__dict__["_allowed"]:
            raise AssertionError(f"{name} is denied to this arm")
        return self._allowed[name]


def denied(event: Event) -> Any:
    """Return the event with its participants' roles and classes alone."""
    people = {
        name: Denied(role=one.role, class_=one.class_) for name, one in event.participants.items()
    }
    return Denied(participants=people)


class Played(Trials):
    """Trials whose frame the arm can't reach: it is kept in the closure of ``run``."""

    def __init__(self, frame: Frame, ground: Ground, budget: int) -> None:
        super().__init__(Denied(), ground, budget)  # type: ignore[arg-type]  # of which nothing may be read
        self._play = lambda made: session(run_of(frame, ground, made))
        self.played: list[Trial] = []

    def run(self, made: ArmRun) -> Trial:
        if self.left <= 0:
            raise NoRun("its tuning budget is spent")
        self.left -= 1
        self.played.append(self._play(made))
        return self.played[-1]


def test_a_denied_event_raises_for_whatever_an_arm_must_not_read() -> None:
    poisoned = denied(load("cut_in"))
    for name in ("topology", "events", "motion", "interaction", "constraints", "vut_id"):
        with pytest.raises(AssertionError, match="is denied"):
            getattr(poisoned, name)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("arm", ["relations", "tracks"])
def test_an_arm_plays_the_event_at_its_own_place_and_reads_nothing_that_it_is_denied(
    kind: str, arm: str
) -> None:
    event, version, _ = checked_event(kind)
    shown = read_source(event)
    cast = cast_of(denied(event))
    ground = source_ground(shown.road, event)
    trials = Played(frame_of(event, version), ground, budget=1)
    made = (
        by_relations(relations_of(shown, cast), ground, trials)
        if arm == "relations"
        else by_tracks(tracks_of(shown, cast), ground, trials)
    )
    run = run_of(frame_of(event, version), ground, made)
    (trial,) = trials.played
    judged = judge_trial(event, run.road, {}, trial)
    assert judged.kpr == 1.0
    # With one trial a lead vehicle's VUT keeps the headway that is tried first, and slows early.
    assert judged.admitted or kind == "lead_braking"


def test_the_compiler_plays_the_event_at_the_source_place_and_another_event_is_not_admitted() -> (
    None
):
    event, version, _ = checked_event("cut_in")
    run, block = by_structure(event, version, source_ground(read_source(event).road, event))
    assert block == "source"
    trial = session(varied(run, 0))
    judged = judge_trial(event, run.road, {}, trial)
    assert judged.admitted
    assert judged.valid
    assert judged.epd is not None
    assert judged.epd < 0.1
    other = judge_trial(load("lead_braking"), run.road, {}, trial)
    assert not other.admitted
    assert not other.retention["dominant_motion"]
    assert not other.retention["participant_roles"]
    narrow = event.model_dump(mode="json", by_alias=True)
    narrow["constraints"]["time_gap"] = {"min": 5.0, "max": 6.0, "unit": "s"}
    missed = judge_trial(Event.model_validate(narrow), run.road, {}, trial)
    assert missed.off_spec
    assert not missed.valid
    assert not missed.admitted
    assert missed.kpr == 1.0
    assert "time gap" in missed.why


def relations(kind: str) -> Relations:
    event = load(kind)
    return relations_of(read_source(event), cast_of(event))


def tracks(kind: str) -> Tracks:
    event = load(kind)
    return tracks_of(read_source(event), cast_of(event))


def test_relations_know_no_frame_of_the_map_and_show_the_change_that_the_source_drew() -> None:
    given = relations("cut_in")
    assert set(vars(given)) == {"times_s", "vut_class", "vut_speed_mps", "courses"}
    (course,) = given.courses
    change = change_of(course, given)
    assert change is not None
    assert change.shift_m == pytest.approx(-LANE_M, abs=0.01)
    # Drawn: a gap of 15 m and a lane change of 2.4 s with another form than the executor's.
    assert change.gap_m == pytest.approx(15.0, abs=0.3)
    assert change.duration_s == pytest.approx(2.25, abs=0.05)
    assert change.to_mps == pytest.approx(float(course.speed_mps[0]), abs=0.05)


def test_one_who_stands_all_the_time_and_one_who_drives_on_have_no_change() -> None:
    hidden = relations("occluded_crossing")
    found = {course.object_id: change_of(course, hidden) for course in hidden.courses}
    assert found["ot2"] is None
    assert found["ot1"] is not None
    slow = relations("slow_lead")
    assert change_of(slow.courses[0], slow) is None


def test_a_source_that_the_generator_did_not_draw_needs_a_recording() -> None:
    event = load("cut_in")
    other = event.model_copy(update={"source": event.source.model_copy(update={"original": "x"})})
    with pytest.raises(InputError, match="--source"):
        read_source(other)


def test_a_recorded_source_is_cut_to_the_clip_of_its_event(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    event = load("cut_in")
    drawn = read_source(event)
    later = [(9.0 + t, states) for t, states in drawn.series if t > 0.0]
    recorded = SimpleNamespace(
        series=[*drawn.series, *later], road=RoadFacts(drawn.road), source="ground truth"
    )
    monkeypatch.setattr(source, "read_recording", lambda _path: recorded)
    found = read_source(event, tmp_path)
    assert found.road == drawn.road
    assert found.series[-1][0] <= 9.0
    ours, theirs = tracks_of(found, cast_of(event)), tracks_of(drawn, cast_of(event))
    assert np.array_equal(ours.others[0].x_m[: len(drawn.series)], theirs.others[0].x_m)
    recorded.road = None
    with pytest.raises(InputError, match="no road is bound to it"):
        read_source(event, tmp_path)


def test_a_source_in_which_the_vut_stands_first_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recording of a whole session can't be a source: its VUT stands at its start."""
    event = load("cut_in")
    drawn = read_source(event)
    first_s, first = drawn.series[0]
    stands = first | {"vut": replace(first["vut"], speed_mps=0.0)}
    recorded = SimpleNamespace(
        series=[(first_s, stands), *drawn.series[1:]], road=RoadFacts(drawn.road), source="truth"
    )
    monkeypatch.setattr(source, "read_recording", lambda _path: recorded)
    with pytest.raises(InputError, match=r"shows the VUT at 0\.00 m/s at its start"):
        read_source(event, tmp_path)


def test_a_source_that_does_not_show_everybody_all_the_time_is_refused() -> None:
    event = load("cut_in")
    drawn = read_source(event)
    series = [(t, {k: s for k, s in now.items() if t < 5 or k != "ot1"}) for t, now in drawn.series]
    with pytest.raises(InputError, match="doesn't show ot1 all the time"):
        tracks_of(Source(series, drawn.road, ""), cast_of(event))


def test_a_track_is_smoothed_as_little_as_its_body_needs_and_one_at_constant_speed_is_kept() -> (
    None
):
    event = load("vru_crossing")
    ground = ground_of("boulevard", None, event)
    given = tracks("vru_crossing")
    block = ground.blocks[0]
    walker = given.others[0]
    places = np.stack((walker.x_m + 100.0, walker.y_m), axis=1)
    _, motion = timed_motion(given.times_s + 5.0, places, walker.object_class, ground, block)
    assert motion is not None
    assert motion.times_s is not None
    at, way = np.array(motion.times_s), np.array(motion.path)
    speed = np.hypot(*np.gradient(way, at, axis=0).T)
    up, down = most_mps2(ObjectClass.PEDESTRIAN, ground.limits)
    change = np.gradient(speed, at)[2:-2]
    assert change.max() <= up + 1e-6
    assert -change.min() <= down + 1e-6
    drawn = np.interp(at + 0.5 - 5.0, given.times_s, places[:, 1])
    seen = at + 0.5 - 5.0 <= given.times_s[-1]
    assert np.abs(way[seen, 1] - drawn[seen]).max() < 0.1


def noisy(given: Tracks, sigma_m: float) -> Tracks:
    """Return tracks whose objects' places have the noise of a receiver."""
    rng = np.random.default_rng(5)
    others = tuple(
        replace(
            one,
            x_m=one.x_m + rng.normal(0.0, sigma_m, len(one.x_m)),
            y_m=one.y_m + rng.normal(0.0, sigma_m, len(one.y_m)),
        )
        for one in given.others
    )
    return replace(given, others=others)


def test_a_body_that_stands_does_so_whatever_its_receivers_noise() -> None:
    event = load("occluded_crossing")
    ground = source_ground(read_source(event).road, event)
    given = noisy(tracks("occluded_crossing"), 0.03)
    truck = next(one for one in given.others if one.object_id == "ot2")
    places = np.stack((truck.x_m, truck.y_m), axis=1)
    block = ground.blocks[0]
    start, motion = timed_motion(given.times_s + 9.0, places, truck.object_class, ground, block)
    assert motion is None
    assert (start.x_m, start.y_m) == pytest.approx(places.mean(axis=0), abs=0.02)


def test_a_body_that_creeps_stands() -> None:
    event = load("cut_in")
    ground = ground_of("boulevard", None, event)
    times = np.arange(0.0, 9.0, 1.0 / 24.0)
    places = np.stack((100.0 + 0.2 * times / 9.0, 0.0 * times), axis=1)
    start, motion = timed_motion(times + 9.0, places, ObjectClass.CAR, ground, ground.blocks[0])
    assert motion is None
    assert start.x_m == pytest.approx(100.1, abs=0.01)


def oncoming(given: Relations) -> Relations:
    """Return relations whose object comes towards the VUT, 60 m further on."""
    (one,) = given.courses
    ahead = 80.0 - 2.0 * given.vut_speed_mps[0] * given.times_s
    turned = replace(one, ahead_m=ahead, heading_rad=one.heading_rad + np.pi)
    return replace(given, courses=(turned,))


def test_an_object_that_comes_towards_the_vut_is_laid_out_against_the_lane() -> None:
    event, version, _ = checked_event("cut_in")
    ground = source_ground(read_source(event).road, event)
    trials = Played(frame_of(event, version), ground, budget=1)
    made = by_relations(oncoming(relations("cut_in")), ground, trials)
    (other,) = made.targets
    assert other.approach is not None
    assert abs(other.start.yaw_rad) == pytest.approx(np.pi)
    assert other.approach.path[-1][0] < other.approach.path[0][0] - 100.0
    # In an oncoming lane, since it heads along none of the VUT's.
    assert other.start.y_m >= 2 * LANE_M - 0.1


def test_a_place_that_carries_less_speed_makes_all_slower_and_no_way_shorter() -> None:
    event, version, _ = checked_event("vru_crossing")
    ground = source_ground(read_source(event).road, event)
    slow = replace(ground, limits=ground.limits.model_copy(update={"speed_mps": 6.0}))
    given, ways, speeds = relations("vru_crossing"), [], []
    for place in (ground, slow):
        trials = Played(frame_of(event, version), place, budget=1)
        made = by_relations(given, place, trials)
        act = made.triggers[0].manoeuvre
        assert act.kind == "follow_path"
        (x0, y0), (x1, y1) = act.motion.path
        ways.append(math.hypot(x1 - x0, y1 - y0))
        speeds.append(act.motion.cruise_mps / made.driver.cruise_mps)
    assert ways[0] == pytest.approx(ways[1])
    assert speeds[0] == pytest.approx(speeds[1])


def test_a_track_that_leaves_the_fence_makes_no_run() -> None:
    event = load("cut_in")
    ground = ground_of("boulevard", None, event)
    given = tracks("cut_in")
    places = np.stack((given.vut.x_m, given.vut.y_m + 500.0), axis=1)
    with pytest.raises(NoRun, match="leaves the fence"):
        timed_motion(given.times_s + 20.0, places, ObjectClass.CAR, ground, ground.blocks[0])


def test_a_place_without_room_is_refused_by_its_length() -> None:
    ground = ground_of("boulevard", None, load("cut_in"))
    with pytest.raises(NoRun, match="no lane is long enough: 900 m are needed, 400 m are there"):
        placements(ground, 900.0, lambda *_: [])


@pytest.mark.parametrize(
    ("object_class", "left_m", "stands"),
    [
        # Beside the rightmost lane; from any other it would stand in a lane.
        (ObjectClass.PEDESTRIAN, -LANE_M / 2 - 0.6, True),
        # In the lane to the left; from the leftmost one it would be an oncoming one.
        (ObjectClass.CAR, LANE_M, False),
    ],
)
def test_a_lane_is_found_by_bodies_that_fit_beside_it_alone(
    object_class: ObjectClass, left_m: float, stands: bool
) -> None:
    event = load("cut_in")
    ground = source_ground(read_source(event).road, event)
    found = placements(
        ground, 150.0, lambda _b, lane, _s: [Body(object_class, lane.y_m + left_m, True, stands)]
    )
    assert [(one.lane.y_m, one.misfit_m) for one in found] == [(0.0, pytest.approx(0.0, abs=0.1))]
    driver = placements(ground, 150.0, lambda *_: [])
    assert [one.lane.y_m for one in driver] == [0.0, LANE_M]


def test_a_spent_budget_ends_the_tuning() -> None:
    event, version, _ = checked_event("cut_in")
    ground = source_ground(read_source(event).road, event)
    with pytest.raises(NoRun):
        by_tracks(tracks("cut_in"), ground, Trials(frame_of(event, version), ground, budget=0))


def test_a_seed_varies_the_vut_alike_in_every_arm_and_nothing_else_is_judged() -> None:
    event, version, _ = checked_event("cut_in")
    run, _ = by_structure(event, version, source_ground(read_source(event).road, event))
    assert share_of(0) == 0.0
    assert {abs(share_of(seed)) <= 0.05 for seed in range(1, 50)} == {True}
    other = varied(run, 7)
    assert other.driver.cruise_mps == pytest.approx(run.driver.cruise_mps * (1 + share_of(7)))
    assert other.vut.approach is not None
    assert other.vut.approach.cruise_mps == other.driver.cruise_mps
    same = other.model_copy(update={"seed": 1, "driver": run.driver, "vut": run.vut})
    assert same == run
    plain = RunSpec.model_validate(run.model_dump(mode="json", by_alias=True))
    assert executed(plain) == run
    assert (run.passing, run.camera, run.traffic) == (None, None, [])


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({}, ""),
        ({"leaves_to_m": 0.0}, "ot2 stays in the VUT's lane"),
        ({"leaves_to_m": -3.5}, "ot2 leaves the VUT's lane to the right, K* has left"),
    ],
)
def test_an_occluder_that_leaves_is_judged_as_the_audit_does(
    changes: dict[str, float], why: str
) -> None:
    scene = cut_out(**changes)
    assert scene.road is not None
    result = SimpleNamespace(verdict=Verdict.VALID, reasons=[])
    trial: Any = SimpleNamespace(result=result, series=scene.series)
    judged = judge_trial(checked_event("cut_out")[0], scene.road.road, {}, trial)
    assert judged.kpr == 1.0
    assert (judged.admitted, judged.why.startswith(why)) == (not why, True), judged.why


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({}, ""),
        ({"offset_m": 0.35}, "ot1 is +0.35"),
        ({"speed": 2.0}, "ot1 drives 2.0"),
    ],
)
def test_an_initiator_that_does_nothing_is_judged_as_the_audit_does(
    changes: dict[str, float], why: str
) -> None:
    scene = slow_lead(**changes)
    assert scene.road is not None
    result = SimpleNamespace(verdict=Verdict.VALID, reasons=[])
    trial: Any = SimpleNamespace(result=result, series=scene.series)
    judged = judge_trial(checked_event("slow_lead")[0], scene.road.road, {}, trial)
    assert judged.kpr == 1.0
    assert (judged.admitted, judged.why.startswith(why)) == (not why, True), judged.why


@pytest.mark.parametrize(("stands", "why"), [(False, ""), (True, "ot2 drives 0.0 to 0.0 m/s")])
def test_a_further_participant_is_judged_as_the_audit_does(stands: bool, why: str) -> None:
    event = several("lead_ahead_of_a_cut_in")
    area, _ = load_area("boulevard", None)
    run = realise(Order(event, "sha256:x", area, "sumo", 1, {}), area.library.blocks[0]).task.run
    _, record = driven(run)
    truths = zip(*(record.truths(name)[::5] for name in run.object_ids), strict=True)
    series = [(ns_to_seconds(now[0].stamp_ns), {s.object_id: s for s in now}) for now in truths]
    if stands:
        ahead = replace(series[0][1]["ot2"], speed_mps=0.0)
        series = [(t, {**now, "ot2": replace(ahead, x_m=ahead.x_m + 80)}) for t, now in series]
    result = SimpleNamespace(verdict=Verdict.VALID, reasons=[])
    trial: Any = SimpleNamespace(result=result, series=series)
    words = {"road_type": "urban", "left_boundary": "sidewalk", "right_boundary": "sidewalk"}
    judged = judge_trial(event, run.road, words, trial)
    assert (judged.admitted, why in judged.why) == (not why, True), judged.why
