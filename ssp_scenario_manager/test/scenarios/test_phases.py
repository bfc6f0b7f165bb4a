"""Phases of events that the test lets happen: their order, and when each begins."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ssp_core.geometry import Polyline, Pose2
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.encounter import Observable
from ssp_core.motion.event import (
    Instant,
    PhaseBegan,
    PhaseWatch,
    find_event,
    next_phase,
)
from ssp_core.motion.passing import passing_of
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import ConflictThresholds
from ssp_core.vocabulary import ObjectClass, Phase

MS = 1_000_000
STEP_NS = 20 * MS
THRESHOLDS = ConflictThresholds(ttc_s=2.5, arrival_gap_s=1.5)
TTC_ALONE = ConflictThresholds(ttc_s=2.5, arrival_gap_s=None)
StateMaker = Callable[..., ObjectState]
Pair = tuple[ObjectState, ObjectState]

FRAMES = [Pose2(0.0, 0.0, 0.0), Pose2(512.0, -240.0, math.radians(37.0))]


def play(
    pairs: list[Pair],
    frame: Pose2,
    kind: Observable = "lateral",
    thresholds: ConflictThresholds = THRESHOLDS,
) -> list[tuple[Phase, int]]:
    """Phases and their stamps in ms; the scene is turned into a frame of the map."""
    path = Polyline([frame.to_parent(-10.0, 0.0), frame.to_parent(400.0, 0.0)])
    watch, begun = PhaseWatch(), []

    def turned(old: ObjectState) -> ObjectState:
        x, y = frame.to_parent(old.x_m, old.y_m)
        return replace(old, x_m=x, y_m=y, yaw_rad=old.yaw_rad + frame.yaw_rad)

    for vut, target in pairs:
        watch, start = next_phase(watch, turned(vut), turned(target), path, thresholds, kind)
        if start is not None:
            assert isinstance(start, PhaseBegan)
            assert ("deceleration" in start.evidence) is (kind == "braking")
            begun.append((start.phase, start.stamp_ns // MS))
    return begun


def drive(
    state: StateMaker,
    seconds: float,
    vut: Callable[[float], tuple[float, float]],
    target: Callable[[float], tuple[float, float, float, float]],
    object_class: ObjectClass = ObjectClass.CAR,
) -> list[Pair]:
    """vut(t) gives x and speed; target(t) gives x, y, speed along x, speed along y."""
    pairs = []
    for k in range(round(seconds * 1000 * MS / STEP_NS)):
        t = k * STEP_NS / 1e9
        x, v = vut(t)
        tx, ty, vx, vy = target(t)
        pairs.append(
            (
                state("vut", stamp_ns=k * STEP_NS, x_m=x, speed_mps=v),
                state(
                    "ot1",
                    object_class,
                    stamp_ns=k * STEP_NS,
                    x_m=tx,
                    y_m=ty,
                    speed_mps=math.hypot(vx, vy),
                    yaw_rad=math.atan2(vy, vx),
                ),
            )
        )
    return pairs


def ramp(t: float, start_s: float, end_s: float, rate: float) -> float:
    """Integral of a rate that holds from start_s to end_s."""
    return rate * min(max(t - start_s, 0.0), end_s - start_s)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(
    ("lead_mps", "offset_m"),
    [(3.0, -0.4), (0.0, 0.5), (3.0, 1.1), pytest.param(0.0, 0.0, id="what a cut-out reveals")],
)
def test_slow_lead(state: StateMaker, frame: Pose2, lead_mps: float, offset_m: float) -> None:
    """The OT is slower than the VUT (10 m/s) and in its way; both keep on until the VUT brakes.

    TTC is 6.01 s at the start: it falls to 4 s at 2.01 s and to 2.5 s at 3.51 s. At 4.0 s the VUT
    takes the OT's speed, so that there is nothing to close in on.
    """
    closing = 10.0 - lead_mps
    ahead_m = 6.01 * closing + 3.6 + 0.9

    def vut(t: float) -> tuple[float, float]:
        return (10.0 * t, 10.0) if t < 4.0 else (40.0 + lead_mps * (t - 4.0), lead_mps)

    def target(t: float) -> tuple[float, float, float, float]:
        return ahead_m + lead_mps * t, offset_m, lead_mps, 0.0

    pairs = drive(state, 9.0, vut, target)
    phases = play(pairs, frame, "closing", TTC_ALONE)
    # Under a threshold is the first step after it.
    assert phases == [(Phase.TRIGGER, 2020), (Phase.CONFLICT, 3520), (Phase.RESOLUTION, 4000)]
    path = Polyline([(0.0, 0.0), (200.0, 0.0)])
    instants = [Instant(own.stamp_ns / 1e9, own, other) for own, other in pairs]
    found = find_event(instants, path, TTC_ALONE, "closing")
    assert found is not None
    starts_s = (found.trigger_s, found.conflict_s, found.resolution_s)
    assert starts_s == pytest.approx((2.02, 3.52, 4.0))


@pytest.mark.parametrize("offset_m", [-2.2, 2.2])
def test_who_is_beside_the_corridor_is_no_slow_lead(state: StateMaker, offset_m: float) -> None:
    pairs = drive(state, 9.0, lambda t: (10.0 * t, 10.0), lambda t: (80.0, offset_m, 0.0, 0.0))
    assert play(pairs, FRAMES[0], "closing", TTC_ALONE) == []


@pytest.mark.parametrize("frame", FRAMES)
def test_cut_in(state: StateMaker, frame: Pose2) -> None:
    """VUT at 10 m/s, OT at 8 m/s in the left lane; from 3.0 s to 6.5 s it moves right at 1 m/s.

    Meanwhile its heading is atan(1/8), which takes its front right corner 0.447 + 0.893 m to the
    right of its reference point: 0.960 m from the VUT's corridor (0.9 + 0.3 m) at 3.0 s. The bumper
    gap is then 14 m less 0.105 m for the turned rear, so the VUT needs (13.9 + 8 * 0.96) / 10 s to
    the zone, which moves on with the OT, 1.2 s more than the OT: in conflict at once.
    In the corridor, from 3.9604 s on, only TTC counts, and that is 12 m / 2 m/s and falls to 4 s at
    8 s, when the VUT slows down to the OT's speed.
    """

    def vut(t: float) -> tuple[float, float]:
        return (10.0 * t, 10.0) if t < 8.0 else (80.0 + 8.0 * (t - 8.0), 8.0)

    def target(t: float) -> tuple[float, float, float, float]:
        y = 3.5 - ramp(t, 3.0, 6.5, 1.0)
        return 24.5 + 8.0 * t, y, 8.0, -1.0 if 3.0 <= t < 6.5 else 0.0

    phases = play(drive(state, 11.0, vut, target), frame)
    assert [p for p, _ in phases] == [Phase.TRIGGER, Phase.CONFLICT, Phase.RESOLUTION]
    stamps = [t for _, t in phases]
    assert stamps[0] == 3000
    assert stamps[1] == 3020  # the first instant after the trigger
    assert stamps[2] == 3980


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_crossing(state: StateMaker, frame: Pose2, side: float) -> None:
    """A walker at x = 60 steps off at 2.0 s from 4 m beside the path, at 1.5 m/s.

    The VUT drives 10 m/s and brakes at 4 m/s^2 from 3.2 s on, to stand with its front at 48.1 m.
    TTC is under 2.5 s when less than 25 m are left to the walker's side at 59.75 m, with the front
    at 34.75 m, from 3.115 s on. The walker is in the corridor (after 2.55 m) from 3.7 s on; until
    then it would arrive 1.9 s before the VUT, which is no conflict. After braking for b seconds TTC
    is (24.15 - 10 b + 2 b^2) / (10 - 4 b), over 2.5 s again from b = 0.652 s on.
    """

    def vut(t: float) -> tuple[float, float]:
        braking = min(max(t - 3.2, 0.0), 2.5)
        return 10.0 * min(t, 3.2) + 10.0 * braking - 2.0 * braking**2, 10.0 - 4.0 * braking

    def target(t: float) -> tuple[float, float, float, float]:
        walked = ramp(t, 2.0, 7.0, 1.5)
        return 60.0, side * (4.0 - walked), 0.0, -side * (1.5 if 2.0 <= t < 7.0 else 0.0)

    pairs = drive(state, 9.0, vut, target, ObjectClass.PEDESTRIAN)
    assert play(pairs, frame) == [
        (Phase.TRIGGER, 2000),
        (Phase.CONFLICT, 3120),
        (Phase.RESOLUTION, 3860),
    ]


@pytest.mark.parametrize("frame", FRAMES)
def test_an_oncoming_one_that_turns_across(state: StateMaker, frame: Pose2) -> None:
    """An OT comes at 4 m/s in the next lane, and turns on a circle of 10 m from x = 80 m at 2.0 s.

    After t s of the turn it has turned by a = 0.4 t, and drives 4 sin a sideways: more than 0.2 m/s
    from 0.125 s on. TTC is (80 - 10.9 sin a - 3.6 cos a - 10 (t + 2) - 3.6) / (10 + 4 cos a), under
    2.5 s from 3.408 s on. The corridor is 1.2 m wide on each side: its first corner is in at
    2.721 s, its last one out, 3.5 - 10 (1 - cos a) + 0.9 sin a + 0.9 cos a under -1.2, at 4.868 s.
    Its own corridor, clipped by the VUT's at every step, lies between 69.50 and 75.74 m.
    """

    def vut(t: float) -> tuple[float, float]:
        return 10.0 * t, 10.0

    def target(t: float) -> tuple[float, float, float, float]:
        a = 0.4 * max(t - 2.0, 0.0)
        x = 80.0 + 4.0 * max(2.0 - t, 0.0) - 10.0 * math.sin(a)
        return x, 3.5 - 10.0 * (1.0 - math.cos(a)), -4.0 * math.cos(a), -4.0 * math.sin(a)

    pairs = drive(state, 9.0, vut, target)
    assert play(pairs, frame, thresholds=TTC_ALONE) == [
        (Phase.TRIGGER, 2140),
        (Phase.CONFLICT, 3420),
        (Phase.RESOLUTION, 4880),
    ]
    instants = [Instant(own.stamp_ns / 1e9, own, other) for own, other in pairs]
    met = passing_of(instants, Corridor.of([own for own, _ in pairs]), None)
    assert (met.relation, met.other_first) == ("crossing", True)
    assert met.other_arrival_s == pytest.approx(2.74)
    assert met.zone is not None
    # The corridor goes on for 500 m behind the VUT's start.
    zone = met.zone.start_m - 500.0, met.zone.end_m - 500.0
    assert zone == pytest.approx((69.50, 75.74), abs=0.02)
    # Recorded up to within the corridor, it is oncoming until it has turned by 45 deg, at 3.96 s.
    corridor = Corridor.of([own for own, _ in pairs])
    for until_s, relation in ((3.9, "oncoming"), (4.1, "crossing")):
        in_it = [now for now in instants if now.t_s < until_s]
        assert passing_of(in_it, corridor, None).relation == relation


@pytest.mark.parametrize("frame", FRAMES)
def test_one_that_comes_around_a_ring(state: StateMaker, frame: Pose2) -> None:
    """An OT on a circle of 16 m, heading across at y = 9 m, goes at 5 m/s from 2.0 s on.

    After t s it has turned left by a = 0.3125 t, and goes on straight from a = 1.2 on. The VUT
    keeps 5 m/s. TTC is (12.2 + 16 (1 - cos a - a) - 0.9 (sin a + cos a)) / (5 - 5 sin a), under
    2 s from 2.887 s to 4.344 s. Its first corner comes into the corridor, 9 - 16 sin a
    - 3.6 cos a - 0.9 sin a under 1.2, at 2.827 s, and its last one leaves it at 4.559 s: it is no
    conflict any more while it is still in it, since it goes along with the VUT.
    """

    def vut(t: float) -> tuple[float, float]:
        return 5.0 * t, 5.0

    def target(t: float) -> tuple[float, float, float, float]:
        driven = 5.0 * max(t - 2.0, 0.0)
        a = min(driven / 16.0, 1.2)
        on, speed = driven - 16.0 * a, 5.0 if t >= 2.0 else 0.0
        x = 25.8 + 16.0 * (1.0 - math.cos(a)) + on * math.sin(a)
        y = 9.0 - 16.0 * math.sin(a) - on * math.cos(a)
        # One that stands heads across.
        return x, y, speed * math.sin(a), -max(speed, 1e-9) * math.cos(a)

    pairs = drive(state, 9.0, vut, target)
    thresholds = ConflictThresholds(ttc_s=2.0, arrival_gap_s=None)
    assert play(pairs, frame, thresholds=thresholds) == [
        (Phase.TRIGGER, 2000),
        (Phase.CONFLICT, 2900),
        (Phase.RESOLUTION, 4360),
    ]
    instants = [Instant(own.stamp_ns / 1e9, own, other) for own, other in pairs]
    met = passing_of(instants, Corridor.of([own for own, _ in pairs]), None)
    # It comes in at 75 deg.
    assert (met.relation, met.other_first) == ("crossing", True)
    assert met.other_arrival_s == pytest.approx(2.84)


@pytest.mark.parametrize(("lateral_mps", "seen"), [(0.19, False), (0.21, True)])
def test_the_trigger_needs_lateral_speed(state: StateMaker, lateral_mps: float, seen: bool) -> None:
    pairs = drive(
        state,
        2.0,
        lambda t: (10.0 * t, 10.0),
        lambda t: (80.0 + 10 * t, 3.5 - lateral_mps * t, 10.0, -lateral_mps),
    )
    assert [p for p, _ in play(pairs, FRAMES[0])] == ([Phase.TRIGGER] if seen else [])


@pytest.mark.parametrize(("twitch_steps", "seen"), [(10, False), (11, True)])
def test_the_trigger_must_stay_for_its_confirmation(
    state: StateMaker, twitch_steps: int, seen: bool
) -> None:
    """0.2 s from the first to the confirming sample: eleven samples of 20 ms."""
    stop_s = 1.0 + twitch_steps * 0.02 - 0.01

    def target(t: float) -> tuple[float, float, float, float]:
        return 80.0 + 10 * t, 3.5, 10.0, -1.0 if 0.999 < t < stop_s else 0.0

    phases = play(drive(state, 3.0, lambda t: (10.0 * t, 10.0), target), FRAMES[0])
    assert phases == ([(Phase.TRIGGER, 1000)] if seen else [])


def test_a_conflict_during_an_unconfirmed_twitch_is_forgotten(state: StateMaker) -> None:
    def target(t: float) -> tuple[float, float, float, float]:
        moving = 0.999 < t < 1.1 or t > 2.999
        return 24.5 + 8.0 * t, 3.5, 8.0, -1.0 if moving else 0.0

    phases = play(drive(state, 3.5, lambda t: (10.0 * t, 10.0), target), FRAMES[0])
    assert phases == [(Phase.TRIGGER, 3000), (Phase.CONFLICT, 3020)]


def test_an_interrupted_resolution_counts_from_its_last_beginning(state: StateMaker) -> None:
    """The conflict is over for 0.9 s, begins again, and then is over for good."""

    def target(t: float) -> tuple[float, float, float, float]:
        lateral = -1.0 if t >= 1.0 else 0.0
        if 2.0 <= t < 2.9 or t >= 3.5:
            lateral = 0.0
        return 22.5 + 8.0 * t, 3.5, 8.0, lateral

    phases = play(drive(state, 6.0, lambda t: (10.0 * t, 10.0), target), FRAMES[0])
    assert phases == [(Phase.TRIGGER, 1000), (Phase.CONFLICT, 1020), (Phase.RESOLUTION, 3500)]


def test_after_resolution_nothing_more_happens(state: StateMaker) -> None:
    watch = PhaseWatch(Phase.RESOLUTION)
    path = Polyline([(0.0, 0.0), (100.0, 0.0)])
    after = next_phase(watch, state("vut"), state("ot1", x_m=6.0), path, THRESHOLDS)
    assert after == (watch, None)


# -- a lead vehicle that brakes -------------------------------------------------------------------


def following(
    state: StateMaker, seconds: float, braking_mps2: Callable[[float], float], lateral_m: float = 0
) -> list[Pair]:
    """Both at 10 m/s with a gap of 20 m; the VUT goes on, the OT has the given acceleration."""
    pairs, speed, x = [], 10.0, 24.5
    for k in range(round(seconds * 50)):
        t = k * 0.02
        a = braking_mps2(t)
        vut = state("vut", stamp_ns=k * STEP_NS, x_m=10.0 * t, speed_mps=10.0)
        ot1 = state("ot1", stamp_ns=k * STEP_NS, x_m=x, y_m=lateral_m, speed_mps=speed)
        pairs.append((vut, replace(ot1, acceleration_mps2=a)))
        x, speed = x + 0.02 * speed, max(0.0, speed + 0.02 * a)
    return pairs


@pytest.mark.parametrize("frame", FRAMES)
def test_a_lead_vehicle_brakes(state: StateMaker, frame: Pose2) -> None:
    """The OT brakes at 4 m/s^2 from 2.0 s on: TTC after b s is (20 - 2 b^2) / (4 b).

    The speed is summed in steps, with which the OT is up to 0.04 b m further on: a step later.
    """
    pairs = following(state, 4.0, lambda t: -4.0 if t >= 1.999 else 0.0)
    phases = play(pairs, frame, "braking", TTC_ALONE)
    assert [p for p, _ in phases] == [Phase.TRIGGER, Phase.CONFLICT]
    assert phases[0][1] == 2000
    assert phases[1][1] == pytest.approx(3540, abs=20)


@pytest.mark.parametrize(("deceleration", "seen"), [(1.0, False), (1.01, True)])
def test_the_trigger_needs_deceleration(state: StateMaker, deceleration: float, seen: bool) -> None:
    pairs = following(state, 2.0, lambda t: -deceleration)
    phases = play(pairs, FRAMES[0], "braking", TTC_ALONE)
    assert [p for p, _ in phases] == ([Phase.TRIGGER] if seen else [])


def test_braking_beside_the_corridor_is_no_trigger(state: StateMaker) -> None:
    pairs = following(state, 2.0, lambda t: -4.0, lateral_m=3.5)
    assert play(pairs, FRAMES[0], "braking", TTC_ALONE) == []


def test_noise_on_acceleration_is_no_trigger(state: StateMaker) -> None:
    """Half of the samples are under the threshold, and never all of them for 0.2 s."""
    noise = np.random.default_rng(5).normal(-0.9, 1.0, 3000)
    pairs = following(state, 10.0, lambda t: float(noise[round(t * 50)]))
    seen = [a.acceleration_mps2 < -1.0 for _, a in pairs]
    assert 0.3 < sum(seen) / len(seen) < 0.6
    assert play(pairs, FRAMES[0], "braking", TTC_ALONE) == []


@pytest.mark.parametrize(
    ("target", "kind"),
    [
        # Two cars that close in on each other in one lane: no manoeuvre, so no event.
        (lambda t: (45.0 + 4 * t, 0.0, 4.0, 0.0), "lateral"),
        (lambda t: (80.0 + 10 * t, 3.5 + t, 10.0, 1.0), "lateral"),  # moves away
        (
            lambda t: (80.0 + 10 * t, 3.5 - t, 10.0, -1.0),
            "braking",
        ),  # moves over, but doesn't brake
    ],
)
def test_another_motion_is_no_trigger(state: StateMaker, target: Any, kind: Observable) -> None:
    pairs = drive(state, 6.0, lambda t: (10.0 * t, 10.0), target)
    assert play(pairs, FRAMES[0], kind) == []
