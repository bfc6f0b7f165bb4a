"""Motions of two participants that are an event, or nearly one, for audits."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from ssp_core.geometry import Pose2
from ssp_core.motion.encounter import Observable
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import ConflictThresholds
from ssp_core.run_file.road import CurvePiece, JunctionRoad, Lane, Road
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.reference_line import ReferenceLine
from ssp_eval.audit.checks import phase_findings, property_findings
from ssp_eval.audit.evidence.evidence import expected_properties, varying_parts
from ssp_eval.audit.evidence.measure import Measurements, RoadFacts, Scene
from ssp_eval.audit.evidence.reasons import explain
from ssp_eval.data.audit import Property
from ssp_eval.recordings.event import NO_RULES
from ssp_ot_controller.camera.actors import curve_pieces
from ssp_ot_controller.camera.ring import BEFORE_ARM, FIRST_ARM, SECOND_ARM, VUT_ARM, Bends, Ring
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event

STEP_S = 0.05
TTC_ONLY = ConflictThresholds(ttc_s=3.0, arrival_gap_s=None)
BOTH = ConflictThresholds(ttc_s=2.5, arrival_gap_s=1.5)
Motion = Callable[[float], tuple[float, float]]


ORIGIN = Pose2(0.0, 0.0, 0.0)


def road(origin: Pose2 = ORIGIN, **more: Any) -> RoadFacts:
    lanes = [
        Lane(y_m=y, width_m=3.5, direction=d)
        for y, d in ((0.0, "forward"), (3.5, "forward"), (7.0, "backward"))
    ]
    start = Start(x_m=origin.x_m, y_m=origin.y_m, yaw_rad=origin.yaw_rad)
    return RoadFacts(Road(**{"origin": start, "length_m": 400.0, "lanes": lanes, **more}))


def moving(name: str, cls: ObjectClass, t_s: float, motion: Motion) -> ObjectState:
    """A state on a path that is given as a function of time; speeds by differences."""
    h = 1e-4
    (x0, y0), (x1, y1) = motion(t_s - h), motion(t_s + h)
    vx, vy = (x1 - x0) / (2 * h), (y1 - y0) / (2 * h)
    speed = math.hypot(vx, vy)
    late = motion(t_s + 2 * h + 1e-2)
    later = motion(t_s + 1e-2)
    faster = math.hypot((late[0] - later[0]) / (2 * h), (late[1] - later[1]) / (2 * h))
    yaw = math.atan2(vy, vx) if speed > 1e-6 else (math.pi / 2 if cls.name == "PEDESTRIAN" else 0.0)
    x, y = motion(t_s)
    role = Role.VUT if name == "vut" else Role.OT
    return ObjectState(
        name,
        cls,
        role,
        round(t_s * 1e9),
        x,
        y,
        yaw,
        speed,
        (faster - speed) / 1e-2,
        0.0,
        DEFAULT_SIZES[cls],
    )


def scene(
    vut: Motion,
    ot1: Motion,
    cls: ObjectClass = ObjectClass.CAR,
    *,
    length_s: float = 14.0,
    thresholds: ConflictThresholds = TTC_ONLY,
    observable: Observable = "lateral",
    **more: Any,
) -> Scene:
    series = []
    for k in range(round(length_s / STEP_S)):
        t_s = k * STEP_S
        objects = [moving("vut", ObjectClass.CAR, t_s, vut), moving("ot1", cls, t_s, ot1)]
        series.append((t_s, {o.object_id: o for o in objects}))
    given = {
        "series": series,
        "vut_id": "vut",
        "target_ids": ("ot1",),
        "road": road(),
        "start_s": 0.0,
        "end_s": series[-1][0],
        "rules": replace(NO_RULES, thresholds=thresholds, observable=observable),
    }
    return Scene(**{**given, **more})


def shift(t_s: float, at_s: float, from_m: float, to_m: float) -> float:
    progress = min(max((t_s - at_s) / 2.5, 0.0), 1.0)
    return from_m + (to_m - from_m) * 0.5 * (1.0 - math.cos(math.pi * progress))


def braking(x_m: float, speed: float, at_s: float, rate: float, to: float = 0.0) -> Motion:
    """Straight on at y = 0, braking from some time on."""

    def motion(t_s: float) -> tuple[float, float]:
        braked_s = min(max(0.0, t_s - at_s), (speed - to) / rate)
        rest_s = max(0.0, t_s - at_s - braked_s)
        x = x_m + speed * min(t_s, at_s) + speed * braked_s - rate * braked_s**2 / 2 + to * rest_s
        return x, 0.0

    return motion


def cut_in(side: float = 1.0, speed: float = 8.5, gap_m: float = 42.0, **more: Any) -> Scene:
    """A slower car 42 m ahead on one side changes lanes at 5 s; the VUT brakes at 6 s."""
    return scene(
        braking(0.0, 13.0, 6.0, 3.0, 6.0),
        lambda t: (gap_m + speed * t, shift(t, 5.0, side * 3.5, 0.0)),
        **more,
    )


def crossing(start_s: float = 4.0, **more: Any) -> Scene:
    """A pedestrian crosses from the right at x = 80 m; the VUT brakes at 5 s, or drives on."""
    vut = more.pop("vut", braking(0.0, 12.0, 5.0, 4.0, 1.5))
    return scene(
        vut,
        lambda t: (80.0, -4.0 + 1.5 * max(0.0, t - start_s)),
        ObjectClass.PEDESTRIAN,
        thresholds=BOTH,
        **more,
    )


def lead() -> Scene:
    return scene(
        braking(0.0, 13.0, 7.0, 4.0, 3.0),
        braking(30.0, 13.0, 5.0, 4.0, 3.0),
        observable="braking",
    )


def slow_lead(speed: float = 3.5, offset_m: float = -0.35, x_m: float = 60.0, **more: Any) -> Scene:
    """A car drives slowly 60 m ahead, a little to the right; the VUT brakes behind it at 4.5 s."""
    vut = more.pop("vut", braking(0.0, 11.0, 4.5, 2.5, 3.0))
    given = {"observable": "closing", "holding_id": "ot1"} | more
    return scene(vut, lambda t: (x_m + speed * t, offset_m), **given)


def braking_lead(x_m: float = 30.0, to: float = 3.0) -> Scene:
    """A car ahead of a slow_lead's VUT brakes with 4 m/s² at 5 s, from 11 m/s; the VUT at 7 s."""
    vut, ot1 = braking(0.0, 11.0, 7.0, 4.0, to), braking(x_m, 11.0, 5.0, 4.0, to)
    return scene(
        vut,
        lambda t: (ot1(t)[0], -0.35),
        observable="closing",
        holding_id="ot1",
    )


def cut_out(
    x_m: float = 90.0,
    side: float = 0.0,
    speed: float = 0.0,
    *,
    leaves_to_m: float = 3.5,
    leaves_s: float = 2.5,
    **more: Any,
) -> Scene:
    """A car leaves to the left at 2.5 s, before one that stands; the VUT brakes at 5 s."""
    vut = more.pop("vut", braking(0.0, 11.0, 5.0, 3.0))
    given = {"observable": "closing", "target_ids": ("ot1", "ot2"), "leaving_id": "ot2"} | more
    given.setdefault("holding_id", "ot1")
    made = scene(vut, lambda t: (x_m + speed * t, side), **given)

    def way(t_s: float) -> tuple[float, float]:
        return 25.0 + 9.5 * t_s, shift(t_s, leaves_s, 0.0, leaves_to_m)

    series = [
        (t_s, {**states, "ot2": moving("ot2", ObjectClass.CAR, t_s, way)})
        for t_s, states in made.series
    ]
    return replace(made, series=series)


def crossing_road(arm_at_m: float = 80.0) -> RoadFacts:
    """A road of one lane each way, and another one that crosses it."""
    lanes = [
        Lane(y_m=y, width_m=3.5, direction=d) for y, d in ((0.0, "forward"), (3.5, "backward"))
    ]
    across = [
        Lane(y_m=y, width_m=3.5, direction=d) for y, d in ((0.0, "forward"), (3.5, "backward"))
    ]
    arms = [
        JunctionRoad(
            origin=Start(x_m=arm_at_m, y_m=y_m, yaw_rad=math.pi / 2),
            length_m=length_m,
            lanes=across,
            junction_at=end,
        )
        for y_m, length_m, end in ((-66.0, 60.0, "end"), (9.0, 60.0, "start"), (-6.0, 15.0, "both"))
    ]
    return road(lanes=lanes, junction=arms)


def without_arms(facts: RoadFacts) -> RoadFacts:
    """The same road whose junction has its connecting roads alone."""
    junction = [one for one in facts.road.junction if one.junction_at == "both"]
    return replace(facts, road=facts.road.model_copy(update={"junction": junction}))


def crossing_car(start_s: float = 4.0, side: float = -1.0, **more: Any) -> Scene:
    """A car drives off at x = 80 m, 12 m beside the VUT's way, with 2 m/s² up to 7 m/s."""

    def way(t_s: float) -> tuple[float, float]:
        faster_s = min(max(0.0, t_s - start_s), 3.5)
        driven_m = faster_s**2 + 7.0 * max(0.0, t_s - start_s - 3.5)
        return 80.0, side * (12.0 - driven_m)

    vut = more.pop("vut", braking(0.0, 9.0, 6.0, 3.0, 1.5))
    given = {"thresholds": BOTH, "length_s": 18.0, "road": crossing_road()} | more
    return scene(vut, way, **given)


def oncoming_turn(start_s: float = 3.3, side: float = 1.0, **more: Any) -> Scene:
    """A car drives off in the oncoming lane with 2 m/s² up to 4 m/s, and turns across at x = 80 m.

    It turns on a circle of 11.5 m. From the other side it does the same from the VUT's right.
    """

    def way(t_s: float) -> tuple[float, float]:
        faster_s = min(max(0.0, t_s - start_s), 2.0)
        driven_m = faster_s**2 + 4.0 * max(0.0, t_s - start_s - 2.0) - 5.0
        turned = min(max(driven_m, 0.0) / 11.5, math.pi / 2)
        beyond_m = max(0.0, driven_m - 11.5 * math.pi / 2)
        x = 80.0 - min(driven_m, 0.0) - 11.5 * math.sin(turned)
        return x, side * (3.5 - 11.5 * (1.0 - math.cos(turned)) - beyond_m)

    vut = more.pop("vut", braking(0.0, 9.0, 6.3, 4.0, 1.5))
    short = ConflictThresholds(ttc_s=1.6, arrival_gap_s=None)
    given = {"thresholds": short, "length_s": 18.0, "road": crossing_road(70.0)} | more
    return scene(vut, way, **given)


def drift_across(start_s: float = 4.0) -> Scene:
    """An oncoming car drives straight on, aslant over the VUT's lane to the kerb beyond it."""
    aslant = math.radians(15.0)

    def way(t_s: float) -> tuple[float, float]:
        faster_s = min(max(0.0, t_s - start_s), 2.0)
        driven_m = faster_s**2 + 4.0 * max(0.0, t_s - start_s - 2.0)
        return 95.0 - driven_m * math.cos(aslant), 3.5 - driven_m * math.sin(aslant)

    short = ConflictThresholds(ttc_s=1.6, arrival_gap_s=None)
    vut = braking(0.0, 9.0, 6.3, 4.0, 1.5)
    return scene(vut, way, thresholds=short, length_s=18.0, road=crossing_road(70.0))


# A ramp comes from the right at this angle, and joins the road at x in an arc of this radius.
_RAMP_RAD, _JOINS_M, _RADIUS_M = math.radians(20.0), 105.0, 40.0


def ramp_road(joins_m: float = _JOINS_M) -> RoadFacts:
    """A road of one lane each way, and a ramp that joins it from the right."""
    lanes = [
        Lane(y_m=y, width_m=3.5, direction=d) for y, d in ((0.0, "forward"), (3.5, "backward"))
    ]
    x_m, y_m = on_ramp(60.0, joins_m)
    ramp = JunctionRoad(
        origin=Start(
            x_m=x_m - 60.0 * math.cos(_RAMP_RAD),
            y_m=y_m - 60.0 * math.sin(_RAMP_RAD),
            yaw_rad=_RAMP_RAD,
        ),
        length_m=60.0,
        lanes=[Lane(y_m=0.0, width_m=3.5, direction="forward")],
        junction_at="end",
    )
    connecting = ramp.model_copy(
        update={
            "origin": Start(x_m=x_m, y_m=y_m, yaw_rad=_RAMP_RAD),
            "length_m": 8.0 + _RADIUS_M * _RAMP_RAD,
            "pieces": [
                CurvePiece(length_m=8.0),
                CurvePiece(
                    length_m=_RADIUS_M * _RAMP_RAD,
                    start_curvature_1pm=-1.0 / _RADIUS_M,
                    end_curvature_1pm=-1.0 / _RADIUS_M,
                ),
            ],
            "junction_at": "both",
        }
    )
    return road(lanes=lanes, junction=[ramp, connecting])


def on_ramp(driven_m: float, joins_m: float = _JOINS_M) -> tuple[float, float]:
    """A place on its way, which begins 60 m before the junction."""
    arc_m = _RADIUS_M * _RAMP_RAD
    left_m = 68.0 + arc_m - driven_m
    if left_m <= 0.0:
        return joins_m - left_m, 0.0
    turned = min(left_m, arc_m) / _RADIUS_M
    x_m = joins_m - _RADIUS_M * math.sin(turned)
    y_m = -_RADIUS_M * (1.0 - math.cos(turned))
    back_m = max(0.0, left_m - arc_m)
    return x_m - back_m * math.cos(_RAMP_RAD), y_m - back_m * math.sin(_RAMP_RAD)


def merge(start_s: float = 4.0, side: float = 1.0, **more: Any) -> Scene:
    """A car drives off at the end of the ramp with 2 m/s² up to 6 m/s; the VUT brakes at 7 s."""

    def way(t_s: float) -> tuple[float, float]:
        faster_s = min(max(0.0, t_s - start_s), 3.0)
        x_m, y_m = on_ramp(55.0 + faster_s**2 + 6.0 * max(0.0, t_s - start_s - 3.0))
        return x_m, side * y_m

    vut = more.pop("vut", braking(8.0, 9.8, 7.0, 2.5, 5.0))
    given = {"length_s": 18.0, "road": ramp_road()} | more
    given.setdefault("thresholds", ConflictThresholds(ttc_s=2.0, arrival_gap_s=None))
    return scene(vut, way, **given)


# The VUT's turn to the left: where it begins, and its radius. It leads to the lane at x = 80.
_TURNS_M, _LEFT_M = 68.5, 11.5


def turn_road(*, junction: bool = True) -> RoadFacts:
    """The VUT's route: one lane that turns left; the other arms, one lane each way, beside it."""
    arc_m = _LEFT_M * math.pi / 2
    bend = {"start_curvature_1pm": 1.0 / _LEFT_M, "end_curvature_1pm": 1.0 / _LEFT_M}
    made = crossing_road()
    lanes = made.road.lanes
    along = [
        JunctionRoad(
            origin=Start(x_m=x_m, y_m=0.0, yaw_rad=0.0),
            length_m=length_m,
            lanes=lanes,
            junction_at=end,
        )
        for x_m, length_m, end in (
            (_TURNS_M - 60.0, 60.0, "end"),
            (_TURNS_M, 18.0, "both"),
            (_TURNS_M + 18.0, 60.0, "start"),
        )
    ]
    return road(
        lanes=[Lane(y_m=0.0, width_m=3.5, direction="forward")],
        pieces=[
            CurvePiece(length_m=_TURNS_M),
            CurvePiece(length_m=arc_m, **bend),
            CurvePiece(length_m=100.0),
        ],
        length_m=_TURNS_M + arc_m + 100.0,
        junction=[*along, *made.road.junction] if junction else [],
    )


def turning_left(x_m: float, speed: float, at_s: float, slow: float, until_s: float) -> Motion:
    """The VUT's way around its turn: it brakes by 2 m/s² to a speed, and goes on from a time on."""
    brakes = braking(x_m, speed, at_s, 2.0, slow)

    def motion(t_s: float) -> tuple[float, float]:
        faster_s = min(max(0.0, t_s - until_s), (speed - slow) / 2.0)
        rest_s = max(0.0, t_s - until_s - faster_s)
        driven_m = brakes(t_s)[0] + faster_s**2 + (speed - slow) * rest_s
        turned = min(max(0.0, driven_m - _TURNS_M) / _LEFT_M, math.pi / 2)
        ahead_m = max(0.0, driven_m - _TURNS_M - _LEFT_M * math.pi / 2)
        x = min(driven_m, _TURNS_M) + _LEFT_M * math.sin(turned)
        return x, _LEFT_M * (1.0 - math.cos(turned)) + ahead_m

    return motion


def vut_turn(start_s: float = 3.0, y_m: float = 3.5, **more: Any) -> Scene:
    """A car drives off in the oncoming lane with 2 m/s² up to 6 m/s; the VUT lets it pass first."""

    def way(t_s: float) -> tuple[float, float]:
        faster_s = min(max(0.0, t_s - start_s), 3.0)
        return 98.0 - faster_s**2 - 6.0 * max(0.0, t_s - start_s - 3.0), y_m

    vut = more.pop("vut", turning_left(36.0, 5.0, 5.0, 0.5, 8.0))
    given = {"thresholds": BOTH, "length_s": 16.0, "road": turn_road()} | more
    return as_turn(scene(vut, way, **given))


def crossed_from_the_left() -> Scene:
    """A car comes down the road on the left, beside the VUT's exit, across the VUT's turn."""

    def way(t_s: float) -> tuple[float, float]:
        faster_s = min(max(0.0, t_s - 4.0), 3.0)
        return _TURNS_M + _LEFT_M - 3.5, 30.0 - faster_s**2 - 6.0 * max(0.0, t_s - 7.0)

    vut = turning_left(36.0, 5.0, 5.0, 0.5, 8.0)
    return as_turn(scene(vut, way, thresholds=BOTH, length_s=18.0, road=turn_road()))


def from_the_right_arm(radius_m: float = 8.0) -> Scene:
    """A car comes from the road on the right, and turns left across the VUT's turn."""

    def way(t_s: float) -> tuple[float, float]:
        faster_s = min(max(0.0, t_s - 4.0), 3.0)
        driven_m = faster_s**2 + 6.0 * max(0.0, t_s - 7.0) - (17.5 - radius_m)
        turned = min(max(0.0, driven_m) / radius_m, math.pi / 2)
        beyond_m = max(0.0, driven_m - radius_m * math.pi / 2)
        x = _TURNS_M + _LEFT_M - radius_m * (1.0 - math.cos(turned)) - beyond_m
        return x, 3.5 - radius_m * (1.0 - math.sin(turned)) + min(0.0, driven_m)

    vut = turning_left(36.0, 5.0, 5.0, 0.5, 8.0)
    return as_turn(scene(vut, way, thresholds=BOTH, length_s=16.0, road=turn_road()))


def turning_right(x_m: float, speed: float, at_s: float, slow: float, until_s: float) -> Motion:
    """The mirror image of ``turning_left``."""
    left = turning_left(x_m, speed, at_s, slow, until_s)

    def motion(t_s: float) -> tuple[float, float]:
        x, y = left(t_s)
        return x, -y

    return motion


def as_turn(made: Scene) -> Scene:
    """Judged by the rules of an event in which the VUT turns.

    While the object waits it faces where it will drive to, or the VUT if it never does.
    """
    moving_on = (s["ot1"].yaw_rad for _, s in made.series if s["ot1"].speed_mps > 1e-3)
    faces = next(moving_on, math.pi)
    series = [
        (t_s, {**s, "ot1": replace(s["ot1"], yaw_rad=faces)} if s["ot1"].speed_mps <= 1e-3 else s)
        for t_s, s in made.series
    ]
    return replace(made, series=series, rules=replace(made.rules, vut_turn="left"))


_RING = Ring(mouth_m=70.0, lane_m=3.5)
_ROUND = _RING.way(VUT_ARM, SECOND_ARM, 70.0, 60.0)


def ring_road(*, junction: bool = True) -> RoadFacts:
    """The VUT's route into a ring and around it, one lane."""
    return road(
        lanes=[Lane(y_m=0.0, width_m=3.5, direction="forward")],
        pieces=curve_pieces(_ROUND),
        length_m=sum(length_m for length_m, _ in _ROUND),
        junction=_RING.roads(60.0) if junction else [],
    )


def winding(start: Pose2, bends: Bends, driven: Motion) -> Motion:
    """A way along straights and arcs, by the distance that is driven on it."""
    line = ReferenceLine(start, curve_pieces(bends))
    return lambda t_s: line.to_map(driven(t_s)[0], 0.0)


def roundabout(start_s: float = 3.0, leaves: float = FIRST_ARM, **more: Any) -> Scene:
    """A car enters a ring with 2 m/s² up to 5 m/s and passes the VUT's entry; the VUT is slow."""

    def driven(t_s: float) -> tuple[float, float]:
        faster_s = min(max(0.0, t_s - start_s), 2.5)
        return faster_s**2 + 5.0 * max(0.0, t_s - start_s - 2.5), 0.0

    vut = winding(ORIGIN, _ROUND, more.pop("vut", braking(23.0, 5.0, 7.5, 2.0, 0.5)))
    bends = _RING.way(BEFORE_ARM, leaves, 5.0, 60.0)
    given = {"length_s": 20.0, "road": ring_road()} | more
    return scene(vut, winding(_RING.inward(BEFORE_ARM, 5.0), bends, driven), **given)


def fixed(event: Event, properties: Mapping[str, Property]) -> dict[str, Property]:
    """Return the properties of an event without the parts that may vary."""
    return {k: q.without(varying_parts(event)) for k, q in properties.items()}


def codes(name: str, found: Measurements) -> list[str]:
    """Return the codes of what an audit finds different from a shipped event, causes first."""
    event = load_event(name)[0]
    mine, wanted = fixed(event, found.properties), fixed(event, expected_properties(event))
    findings = property_findings(
        mine, wanted, found.phases, found.first_arrival_s
    ) + phase_findings(found.phases, "")
    return [reason.finding.code for reason in explain(findings)]
