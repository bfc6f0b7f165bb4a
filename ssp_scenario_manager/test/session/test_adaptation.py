"""Adapting a manoeuvre to a VUT of another speed: when, how far, and when not."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from ssp_core.geometry import Polyline
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.run_file.participants import (
    Adaptation,
    FollowPath,
    LaneChange,
    Motion,
    ParticipantSpec,
)
from ssp_scenario_manager.dispatch.adaptation import AdaptedManoeuvre, Decision
from ssp_scenario_manager.dispatch.planned_motion import (
    PlannedMotion,
    VutTrack,
    arrival_ns,
    as_planned,
    follow_vut,
    foreseen_gap_s,
    planned_motion_of,
    play,
)
from ssp_scenario_manager.dispatch.references import (
    Address,
    approach_reference,
    manoeuvre_reference,
)
from tests.support.runs import cut_in_run
from tests.support.states import object_state

S = 1_000_000_000
PATH = Polyline([(0.0, 0.0), (300.0, 0.0)])
LIMITS = Limits(speed_mps=17.0, acceleration_mps2=4.5)
FENCE = [(-50.0, -40.0), (400.0, -40.0), (400.0, 40.0), (-50.0, 40.0)]


def participant(name: str, cls: str, x: float, y: float, yaw: float = 0.0) -> ParticipantSpec:
    return ParticipantSpec.model_validate(
        {"id": name, "object_class": cls, "start": {"x_m": x, "y_m": y, "yaw_rad": yaw}}
    )


VUT = participant("vut", "car", 0.0, 0.0)
WALKER = participant("ot1", "pedestrian", 100.0, -2.5, np.pi / 2)
CAR = participant("ot1", "car", 40.0, 3.5)
DRIVEN = Motion(path=[(40.0, 3.5), (300.0, 3.5)], cruise_mps=8.5)


def address(execute_s: float, name: str = "r") -> Address:
    return Address(name, "ot1", "v", "manoeuvre", 0, round(execute_s * S))


def crossing(execute_s: float = 10.1) -> PlannedMotion:
    """Return a walk that starts 1.3 m beside the corridor (1.2 m to each side) at 1.5 m/s."""
    walk = FollowPath(
        kind="follow_path",
        motion=Motion(
            path=[(100.0, -2.5), (100.0, 13.0)],
            cruise_mps=1.5,
            acceleration_mps2=1.5,
            deceleration_mps2=1.5,
        ),
    )
    sent = manoeuvre_reference(address(execute_s), walk, vut(0.0), None, None)
    found = planned_motion_of(None, sent, 10 * S, WALKER, VUT, PATH)
    assert found is not None
    return found


def cut_in(execute_s: float = 13.0) -> PlannedMotion:
    change = LaneChange(
        kind="lane_change",
        lateral_shift_m=-3.5,
        duration_s=2.5,
        cruise_mps=5.5,
        deceleration_mps2=2.0,
    )
    approach = approach_reference(address(0.5, "a"), DRIVEN)
    sent = manoeuvre_reference(address(execute_s), change, vut(0.0), approach, DRIVEN)
    found = planned_motion_of(approach, sent, 10 * S, CAR, VUT, PATH)
    assert found is not None
    return found


def vut(
    t_s: float, x_m: float = 0.0, speed_mps: float = 10.0, acceleration_mps2: float = 0.0
) -> ObjectState:
    moving = {"speed_mps": speed_mps, "acceleration_mps2": acceleration_mps2}
    return object_state("vut", x_m=x_m, stamp_ns=round(t_s * S), size=VUT.size, **moving)


def wish(
    gap_s: float, first: Literal["initiator", "vut"] = "initiator", **more: object
) -> Adaptation:
    return Adaptation.model_validate({"first": first, "gap_s": gap_s, **more})


class Drive:
    """A VUT along PATH, and what is decided of it every 20 ms."""

    def __init__(
        self, planned_motion: PlannedMotion, asked: Adaptation, x_m: float, limits: Limits = LIMITS
    ):
        self.adaptation = asked
        who = WALKER if planned_motion.zone.start_m < planned_motion.zone.end_m else CAR
        run = RunSpec.model_validate(cut_in_run())
        run = run.model_copy(update={"limits": limits, "geofence": FENCE, "step_s": 0.02})
        self.manoeuvre = AdaptedManoeuvre(planned_motion, run, who, asked, PATH, 10 * S)
        self.t_s, self.x_m = 10.0, x_m
        self.sent: list[tuple[float, Decision]] = []
        self.notes: list[str] = []
        self.wrong: list[str] = []
        self.arrived_s: float | None = None

    def go(
        self, seconds: float, speed_mps: float, acceleration: float = 0.0, noise: float = 0.0
    ) -> None:
        rng = np.random.default_rng(1)
        for _ in range(round(seconds / 0.02)):
            dx, dv = noise * rng.standard_normal(2)
            seen = vut(self.t_s, self.x_m + dx, speed_mps + dv, acceleration)
            found = self.manoeuvre.judge(seen, round(self.t_s * S))
            if found.pace is not None:
                self.sent.append((self.t_s, found))
            self.notes += [found.note] if found.note else []
            self.wrong += [found.wrong_order] if found.wrong_order else []
            self.t_s += 0.02
            self.x_m += speed_mps * 0.02
            front = self.x_m + VUT.size.front_m
            if self.arrived_s is None and front >= self.manoeuvre.planned_motion.zone.start_m:
                self.arrived_s = (
                    self.t_s - (front - self.manoeuvre.planned_motion.zone.start_m) / speed_mps
                )
            speed_mps = max(speed_mps + acceleration * 0.02, 0.0)

    @property
    def gap_s(self) -> float:
        """The time gap of METHOD 1 at the last pace."""
        planned_motion, first = self.manoeuvre.planned_motion, self.adaptation.first == "initiator"
        own_s = planned_motion.departure_s if first else planned_motion.arrival_s
        decisive_s = self.manoeuvre.played.pace.arrival_ns(own_s) / S
        arrived_s = self.arrived_s
        assert arrived_s is not None
        return arrived_s - decisive_s if first else decisive_s - arrived_s


def placed(planned_motion: PlannedMotion, gap_s: float, speed_mps: float) -> float:
    """Return the VUT's place at 10 s that gives this gap at this speed, if it comes second."""
    seconds = gap_s + planned_motion.departure_s + planned_motion.execute_at_ns / S - 10.0
    return planned_motion.zone.start_m - VUT.size.front_m - speed_mps * seconds


# -- planned motion ----------------------------------------------------------------------


def test_who_crosses_arrives_and_leaves_by_its_box_and_meets_both_corridors() -> None:
    planned_motion = crossing()
    # 1.05 m until its front is in the corridor, 3.95 m until its rear is out of it; the walk
    # begins with 1.5 m/s^2 over 1 s, built up over 0.4 s.
    assert planned_motion.arrival_s == pytest.approx(0.2 + 0.5 + 1.05 / 1.5, abs=0.01)
    assert planned_motion.departure_s == pytest.approx(0.2 + 0.5 + 3.95 / 1.5, abs=0.01)
    assert (planned_motion.zone.start_m, planned_motion.zone.end_m) == pytest.approx(
        (99.45, 100.55)
    )


def test_who_merges_leaves_its_zone_as_it_arrives_and_the_zone_begins_at_its_rear() -> None:
    planned_motion = cut_in()
    assert planned_motion.departure_s == planned_motion.arrival_s
    # A front corner that has turned in comes first.
    assert 0.6 < planned_motion.arrival_s < 1.0
    at_start = float(np.interp(0.0, planned_motion.columns[0], planned_motion.columns[1]))
    driven = (
        float(
            np.interp(
                planned_motion.arrival_s, planned_motion.columns[0], planned_motion.columns[1]
            )
        )
        - at_start
    )
    rear = at_start + driven - CAR.size.rear_m
    assert planned_motion.zone.start_m == pytest.approx(rear, abs=0.3)
    # Before the manoeuvre it drives on along its approach.
    assert planned_motion.columns[0, 0] <= -3.0
    assert planned_motion.columns[4, 1] == pytest.approx(8.5)


def turning(turned_rad: float) -> PlannedMotion | None:
    """Return a turn of a car that comes towards the VUT at 4 m/s, on a circle of 10 m."""
    arc = [(100.0 - 10.0 * np.sin(a), 3.5 - 10.0 * (1.0 - np.cos(a))) for a in _arc(turned_rad)]
    x, y = arc[-1]
    way = (x - 20.0 * np.cos(turned_rad), y - 20.0 * np.sin(turned_rad))
    motion = Motion(path=[(110.0, 3.5), *arc, way], cruise_mps=4.0)
    waits = participant("ot1", "car", 110.0, 3.5, np.pi)
    act = FollowPath(kind="follow_path", motion=motion)
    sent = manoeuvre_reference(address(10.1), act, vut(0.0), None, None)
    return planned_motion_of(None, sent, 10 * S, waits, VUT, PATH)


def _arc(turned_rad: float) -> list[float]:
    return [float(a) for a in np.linspace(0.0, turned_rad, 40)]


def test_an_oncoming_one_that_turns_across_meets_what_its_body_sweeps() -> None:
    found = turning(np.pi / 2)
    assert found is not None
    # As in test_phases.py: from its first corner inside to its last one outside.
    assert found.departure_s - found.arrival_s == pytest.approx(4.868 - 2.721, abs=0.02)
    assert (found.zone.start_m, found.zone.end_m) == pytest.approx((89.50, 95.74), abs=0.1)


def test_an_oncoming_one_that_stays_in_the_corridor_meets_nobody() -> None:
    """It turns towards the VUT's way, and comes to drive along it."""
    assert turning(0.05) is None


def test_who_never_comes_into_the_corridor_meets_nobody() -> None:
    away = LaneChange(
        kind="lane_change",
        lateral_shift_m=3.5,
        duration_s=2.5,
        cruise_mps=8.0,
        deceleration_mps2=2.0,
    )
    approach = approach_reference(address(0.5, "a"), DRIVEN)
    sent = manoeuvre_reference(address(13.0), away, vut(0.0), approach, DRIVEN)
    assert planned_motion_of(approach, sent, 10 * S, CAR, VUT, PATH) is None


# -- the VUT -----------------------------------------------------------------------------------


def test_the_filter_follows_a_steady_acceleration_without_lag_and_averages_noise() -> None:
    rng = np.random.default_rng(3)
    track: VutTrack | None = None
    errors = []
    for i in range(200):
        t = 0.02 * i
        x, v = 10.0 * t + 0.5 * t * t, 10.0 + t
        dx, dv = 0.05 * rng.standard_normal(2)
        track = follow_vut(track, vut(t, x + dx, v + dv, 1.0), PATH)
        errors.append((track.front_m - x - VUT.size.front_m, track.speed_mps - v))
    late = np.array(errors[50:])
    assert np.abs(late.mean(axis=0)).max() < 0.01
    assert late.std(axis=0).max() < 0.02
    assert track is not None
    assert follow_vut(track, vut(3.0, 99.0), PATH) is track  # older than what is known


def test_a_vut_arrives_at_its_present_speed_and_a_standing_one_never() -> None:
    track = VutTrack(2 * S, 50.0, 10.0, 0.0)
    assert arrival_ns(track, 80.0) == pytest.approx(5 * S)
    assert arrival_ns(track, 40.0) == pytest.approx(1 * S)
    assert arrival_ns(replace(track, acceleration_mps2=2.0), 61.0) == pytest.approx(3 * S)
    assert arrival_ns(replace(track, acceleration_mps2=2.0), 85.0) == pytest.approx(5 * S)
    assert arrival_ns(replace(track, speed_mps=0.4), 80.0) == float("inf")
    assert arrival_ns(replace(track, speed_mps=3.0, acceleration_mps2=-3.0), 80.0) == float("inf")


# -- decisions ---------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [8.0, 9.0, 11.0, 12.0])
@pytest.mark.parametrize("make", [crossing, cut_in])
def test_a_faster_or_slower_vut_is_met_with_the_specified_gap(make: object, speed: float) -> None:
    planned_motion: PlannedMotion = make()  # type: ignore[operator]
    gap = 1.0
    drive = Drive(planned_motion, wish(gap), placed(planned_motion, gap, 10.0))
    drive.go(9.0, speed)
    assert drive.gap_s == pytest.approx(gap, abs=0.15)
    assert drive.sent
    assert drive.notes[-1] == "adaptation ends: the conflict is at hand"
    assert drive.wrong == []


def test_what_comes_as_foreseen_is_let_be_in_spite_of_noise() -> None:
    planned_motion = crossing()
    track = follow_vut(None, vut(10.0, 60.0), PATH)
    gap = foreseen_gap_s(planned_motion, track, VUT.size, initiator_first=True)
    drive = Drive(planned_motion, wish(gap), 60.0)
    drive.go(5.0, 10.0, noise=0.02)
    assert drive.sent == []
    assert drive.wrong == []


def test_a_noisy_vut_is_not_answered_with_chatter() -> None:
    drive = Drive(crossing(), wish(0.8), 62.0)
    drive.go(5.0, 9.0, noise=0.1)
    times = [t for t, _ in drive.sent]
    assert 0 < len(times) < 15
    assert np.diff(times).min() >= 0.1 - 1e-9


def test_it_goes_no_faster_and_brakes_no_harder_than_allowed() -> None:
    planned_motion = cut_in()
    limits = Limits(speed_mps=10.0, acceleration_mps2=3.5)
    drive = Drive(
        planned_motion,
        wish(1.0, acceleration_mps2=2.0, deceleration_mps2=3.0),
        placed(planned_motion, 1.0, 10.0),
        limits,
    )
    drive.go(1.0, 11.0)
    drive.go(3.0, 8.0)

    assert drive.sent
    for _, decision in drive.sent:
        assert decision.pace is not None
        columns = play(planned_motion.columns, decision.pace).columns
        assert columns[4].max() <= 10.0 + 1e-9
        assert columns[5].max() <= 2.0 + 1e-9
        assert columns[5].min() >= -3.0 - 1e-9
        slowest, fastest = 0.6, 1.4
        assert slowest <= decision.pace.target <= fastest


def test_a_gap_that_can_not_be_met_is_approached_and_told_once() -> None:
    drive = Drive(crossing(), wish(0.8), 55.0)
    drive.go(3.5, 13.5)
    assert drive.sent[-1][1].pace is not None
    assert drive.sent[-1][1].pace.target == pytest.approx(1.4)
    told = [note for note in drive.notes if "as much as the limits allow" in note]
    assert len(told) == 1
    assert drive.wrong == []


def test_a_passing_order_that_can_not_be_kept_ends_the_event() -> None:
    drive = Drive(crossing(), wish(0.8), 82.0)
    drive.go(0.15, 16.0)
    assert drive.wrong == []  # it may be noise
    drive.go(0.2, 16.0)
    assert "the VUT would be" in drive.wrong[0]


def test_where_the_vut_comes_first_the_other_waits_for_it() -> None:
    drive = Drive(cut_in(12.0), wish(0.5, "vut"), 0.0)
    zone = drive.manoeuvre.planned_motion.zone
    comes_s = (
        drive.manoeuvre.planned_motion.execute_at_ns / S + drive.manoeuvre.planned_motion.arrival_s
    )
    # At 14 m/s its rear would have left 0.5 s before the other one arrives.
    drive.x_m = zone.end_m + VUT.size.length_m - VUT.size.front_m - 14.0 * (comes_s - 0.5 - 10.0)
    drive.go(1.0, 13.0)
    assert all(d.pace is not None and d.pace.target < 1.0 for _, d in drive.sent)
    assert drive.sent
    drive.go(1.0, 2.0)
    assert "the object target would be" in drive.wrong[0]


def test_a_vut_that_responds_is_not_chased() -> None:
    drive = Drive(crossing(), wish(0.5), 62.0)
    drive.go(0.5, 10.0)
    sent = len(drive.sent)
    drive.go(2.0, 10.0, acceleration=-3.0)
    assert any("the VUT responds" in note for note in drive.notes)
    # What it took until the braking could be told from noise.
    assert len(drive.sent) <= sent + 1
    assert drive.wrong == []


def test_a_vut_that_brakes_before_anybody_moves_has_another_reason() -> None:
    drive = Drive(cut_in(14.0), wish(1.0), 10.0)
    drive.go(1.0, 13.0, acceleration=-2.5)
    assert not any("responds" in note for note in drive.notes)
    assert drive.sent


def test_a_vut_that_stops_makes_nobody_creep() -> None:
    planned_motion = crossing()
    drive = Drive(planned_motion, wish(0.5, response_mps2=None), 60.0)
    drive.go(3.0, 10.0, acceleration=-5.0)
    planned_s = (planned_motion.execute_at_ns / S) + planned_motion.columns[0, -1]
    ends_s = drive.manoeuvre.played.pace.arrival_ns(float(planned_motion.columns[0, -1])) / S
    assert ends_s < 10.0 + (planned_s - 10.0) / 0.6


def test_near_its_decisive_instant_nothing_changes_any_more() -> None:
    planned_motion = crossing()
    drive = Drive(planned_motion, wish(0.5, freeze_s=1.0), 60.0)
    drive.go(8.0, 10.0)
    last_s = max((t for t, _ in drive.sent), default=0.0)
    assert (
        last_s
        <= drive.manoeuvre.played.pace.arrival_ns(planned_motion.departure_s) / S - 1.0 + 1e-6
    )
    assert drive.manoeuvre.over == "the conflict is at hand"


def test_every_reference_goes_on_where_the_one_before_has_led() -> None:
    planned_motion = cut_in()
    drive = Drive(planned_motion, wish(1.0), placed(planned_motion, 1.0, 13.0))
    drive.go(0.6, 15.0)
    drive.go(0.6, 11.0)
    drive.go(1.0, 14.0)
    assert len(drive.sent) > 4
    before = as_planned(planned_motion.execute_at_ns)
    for _, decision in drive.sent:
        pace = decision.pace
        assert pace is not None
        assert pace.at(pace.start_ns) == pytest.approx(before.at(pace.start_ns), abs=1e-9)
        before = pace


def test_a_late_reference_is_forgotten_and_the_next_one_gets_more_time() -> None:
    drive = Drive(crossing(), wish(0.8), 62.0)
    drive.go(0.3, 8.5)
    known = drive.manoeuvre
    assert known.played.pace != known.played.taken
    pace = known.played.pace
    known.on_answer(pace, accepted=False)
    played = known.played
    assert (played.pace, played.lead_ns, played.refused) == (played.taken, S // 5, 1)
    for _ in range(2):
        known.on_answer(pace, accepted=False)
    assert (known.played.lead_ns, known.played.refused) == (2 * S // 5, 3)
    known.on_answer(pace, accepted=True)
    assert (known.played.taken, known.played.refused) == (pace, 0)


def test_references_play_as_references() -> None:
    planned_motion = crossing()
    drive = Drive(planned_motion, wish(0.8), 62.0)
    drive.go(1.0, 8.5)
    pace = drive.sent[-1][1].pace
    assert pace is not None
    sent = Reference(
        "x",
        "ot1",
        "v",
        "adapted",
        0,
        pace.start_ns,
        pace.start_ns + S,
        play(planned_motion.columns, pace),
    )
    assert sent.points[-1].speed_mps == 0.0
    assert sent.points[-1].y_m == pytest.approx(13.0)
