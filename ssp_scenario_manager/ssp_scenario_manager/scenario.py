"""Scenario and site files, and how a run file is made from one of each.

A scenario is written in the frame of a road block: x along the road, and lateral places as lanes
or distances from a kerb, so that the same scenario fits sites with other lane widths. A site puts
that block somewhere (METHOD 2.4: p = R p_local + t) and says what is allowed there.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ssp_core.errors import InputError
from ssp_core.files import load_model, read_mapping
from ssp_core.geometry import Pose2
from ssp_core.hashing import sha256_json
from ssp_core.run_spec import (
    Camera,
    Condition,
    ConflictThresholds,
    Driver,
    EndCondition,
    Finite,
    FollowPath,
    Lane,
    LaneChange,
    Limits,
    LinkDisturbance,
    Look,
    Manoeuvre,
    Motion,
    NonNegative,
    ObjectId,
    ObjectWord,
    ParticipantSpec,
    Point,
    Positive,
    RelativeDistance,
    Road,
    RunSpec,
    Start,
    Strict,
    TimeToArrival,
    TrafficSpec,
    TriggerSpec,
)

LIBRARY = Path(__file__).resolve().parent / "library"


class Place(Strict):
    """A lateral place: the middle of a lane relative to the VUT's, or a distance from a kerb."""

    x_m: Finite
    lane: int | None = Field(None, description="0 the VUT's lane, 1 the next to its left")
    beyond_right_kerb_m: Finite | None = None
    beyond_left_kerb_m: Finite | None = None


class ApproachPlan(Strict):
    """Straight on along the own lane, until the trigger and, without one, to a standstill."""

    cruise_mps: Positive
    acceleration_mps2: Positive = 2.0
    deceleration_mps2: Positive = 2.0
    end_x_m: Finite


class LaneChangePlan(Strict):
    """To another lane while driving on."""

    kind: Literal["lane_change"]
    lanes: Annotated[int, Field(ge=-3, le=3)] = Field(description="+ is to the left")
    duration_s: Positive
    cruise_mps: Positive
    deceleration_mps2: Positive = 2.0


class CrossPlan(Strict):
    """Straight across to another place."""

    kind: Literal["cross"]
    to: Place
    speed_mps: Positive
    acceleration_mps2: Positive = 1.5


class GapBelow(Strict):
    type: Literal["relative_distance"]
    object_id: ObjectId
    below_m: Positive


class ArrivalBelow(Strict):
    type: Literal["time_to_arrival"]
    anchor_x_m: Finite
    below_s: Positive


class TriggerPlan(Strict):
    id: str
    condition: Annotated[GapBelow | ArrivalBelow, Field(discriminator="type")]
    held_for_s: NonNegative = 0.0
    not_before_s: NonNegative = 0.0
    manoeuvre: Annotated[LaneChangePlan | CrossPlan, Field(discriminator="kind")]
    lead_time_s: NonNegative = 0.1


class VutPlan(Strict):
    object_class: ObjectWord = "car"
    start_x_m: Finite
    end_x_m: Finite
    driver: Driver


class TargetPlan(Strict):
    id: ObjectId
    object_class: ObjectWord
    start: Place
    heading_deg: Finite = Field(0.0, description="relative to the road")
    approach: ApproachPlan | None = None
    trigger: TriggerPlan


class TrafficPlan(Strict):
    id: ObjectId
    object_class: ObjectWord = "car"
    direction: Literal["forward", "backward"]
    lane: Annotated[int, Field(ge=0)] = Field(description="counted from the road's middle")
    x_m: Finite
    speed_mps: NonNegative


class Scenario(Strict):
    """``ssp.scenario/1``: one event in the frame of a block."""

    schema_: Literal["ssp.scenario/1"] = Field(alias="schema")
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
    interaction: Literal["cut_in", "vru_crossing"]
    description: str
    vut: VutPlan
    targets: Annotated[list[TargetPlan], Field(min_length=1)]
    traffic: list[TrafficPlan] = []
    thresholds: ConflictThresholds = ConflictThresholds()
    end: EndCondition = EndCondition()


class Block(Strict):
    """A straight stretch of road and where it lies."""

    origin_x_m: Finite
    origin_y_m: Finite
    heading_deg: Finite
    length_m: Positive
    lanes: Annotated[list[Lane], Field(min_length=1)]
    vut_lane: Annotated[int, Field(ge=0)]
    sidewalk_left_m: NonNegative = 0.0
    sidewalk_right_m: NonNegative = 0.0
    crossing_x_m: Finite | None = None
    fence_margin_m: Positive = Field(description="geofence beyond the sidewalks")
    speed_limit_mps: Positive


class Site(Strict):
    """``ssp.site/1``: a place, what is allowed there, and what it looks like."""

    schema_: Literal["ssp.site/1"] = Field(alias="schema")
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
    description: str
    domain: Literal["simulation", "physical"]
    stand_in: bool
    block: Block
    limits: Limits
    camera: Camera = Camera()
    look: Look = Look()
    disturbance: LinkDisturbance = LinkDisturbance()


def _find(name_or_path: str, kind: str) -> Path:
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml", ".json") or path.is_file():
        return path
    shipped = LIBRARY / f"{kind}s" / f"{name_or_path}.{kind}.yaml"
    if shipped.is_file():
        return shipped
    known = ", ".join(sorted(p.name.split(".")[0] for p in (LIBRARY / f"{kind}s").glob("*.yaml")))
    raise InputError(
        f"no such {kind}", value=name_or_path, remedy=f"name one of {known}, or give a file"
    )


def load_scenario(name_or_path: str) -> tuple[Scenario, str]:
    """A scenario by name or file, and its version: the hash of its content, not of its text."""
    path = _find(name_or_path, "scenario")
    return load_model(Scenario, path), sha256_json(read_mapping(path))


def load_site(name_or_path: str) -> tuple[Site, str]:
    """A site by name or file, and its version."""
    path = _find(name_or_path, "site")
    return load_model(Site, path), sha256_json(read_mapping(path))


class _Frame:
    """Places of a scenario on a site's block, in frame map."""

    def __init__(self, site: Site) -> None:
        block = site.block
        if block.vut_lane >= len(block.lanes):
            raise InputError(
                "there is no such lane",
                field="block.vut_lane",
                value=block.vut_lane,
                remedy=f"the block has lanes 0 to {len(block.lanes) - 1}",
            )
        self.origin = Pose2(block.origin_x_m, block.origin_y_m, math.radians(block.heading_deg))
        self.vut_y_m = block.lanes[block.vut_lane].y_m
        self.forward = sorted(lane.y_m for lane in block.lanes if lane.direction == "forward")
        self.right_kerb_m = min(lane.y_m - lane.width_m / 2 for lane in block.lanes)
        self.left_kerb_m = max(lane.y_m + lane.width_m / 2 for lane in block.lanes)

    def lane_y(self, offset: int, field: str) -> float:
        index = self.forward.index(self.vut_y_m) + offset
        if not 0 <= index < len(self.forward):
            raise InputError(
                f"the site has no lane {offset:+d} from the VUT's in its direction",
                field=field,
                value=offset,
                remedy=f"it has {len(self.forward)} such lane(s); choose another site",
            )
        return self.forward[index]

    def lateral(self, place: Place, field: str) -> float:
        given = [
            v
            for v in (place.lane, place.beyond_right_kerb_m, place.beyond_left_kerb_m)
            if v is not None
        ]
        if len(given) != 1:
            raise InputError(
                "needs exactly one of lane, beyond_right_kerb_m, beyond_left_kerb_m", field=field
            )
        if place.lane is not None:
            return self.lane_y(place.lane, field)
        if place.beyond_right_kerb_m is not None:
            return self.right_kerb_m - place.beyond_right_kerb_m
        return self.left_kerb_m + (place.beyond_left_kerb_m or 0.0)

    def point(self, x_m: float, y_m: float) -> Point:
        return self.origin.to_parent(x_m, y_m)

    def start(self, x_m: float, y_m: float, heading_deg: float = 0.0) -> Start:
        x, y = self.point(x_m, y_m)
        return Start(x_m=x, y_m=y, yaw_rad=self.origin.yaw_rad + math.radians(heading_deg))


def _target(plan: TargetPlan, frame: _Frame, index: int) -> tuple[ParticipantSpec, TriggerSpec]:
    field = f"targets[{index}]"
    y = frame.lateral(plan.start, f"{field}.start")
    approach = None
    if plan.approach is not None:
        approach = Motion(
            path=[frame.point(plan.start.x_m, y), frame.point(plan.approach.end_x_m, y)],
            cruise_mps=plan.approach.cruise_mps,
            acceleration_mps2=plan.approach.acceleration_mps2,
            deceleration_mps2=plan.approach.deceleration_mps2,
        )
    trigger = plan.trigger
    condition: Condition
    if isinstance(trigger.condition, GapBelow):
        condition = RelativeDistance.model_validate(trigger.condition.model_dump())
    else:
        condition = TimeToArrival(
            type="time_to_arrival",
            anchor=frame.point(trigger.condition.anchor_x_m, frame.vut_y_m),
            below_s=trigger.condition.below_s,
        )
    manoeuvre: Manoeuvre
    if isinstance(trigger.manoeuvre, LaneChangePlan):
        target_lane = (plan.start.lane or 0) + trigger.manoeuvre.lanes
        shift = frame.lane_y(target_lane, f"{field}.trigger.manoeuvre.lanes") - y
        manoeuvre = LaneChange(
            kind="lane_change",
            lateral_shift_m=shift,
            duration_s=trigger.manoeuvre.duration_s,
            cruise_mps=trigger.manoeuvre.cruise_mps,
            deceleration_mps2=trigger.manoeuvre.deceleration_mps2,
        )
    else:
        end = trigger.manoeuvre.to
        end_y = frame.lateral(end, f"{field}.trigger.manoeuvre.to")
        manoeuvre = FollowPath(
            kind="follow_path",
            motion=Motion(
                path=[frame.point(plan.start.x_m, y), frame.point(end.x_m, end_y)],
                cruise_mps=trigger.manoeuvre.speed_mps,
                acceleration_mps2=trigger.manoeuvre.acceleration_mps2,
                deceleration_mps2=trigger.manoeuvre.acceleration_mps2,
            ),
        )
    return (
        ParticipantSpec(
            id=plan.id,
            object_class=plan.object_class,
            start=frame.start(plan.start.x_m, y, plan.heading_deg),
            approach=approach,
        ),
        TriggerSpec(
            id=trigger.id,
            condition=condition,
            held_for_s=trigger.held_for_s,
            not_before_s=trigger.not_before_s,
            object_id=plan.id,
            manoeuvre=manoeuvre,
            lead_time_s=trigger.lead_time_s,
        ),
    )


def _traffic(plan: TrafficPlan, site: Site, index: int) -> TrafficSpec:
    # Counted from the middle of the road, which is right of backward and left of forward lanes.
    ordered = sorted(
        (i for i, lane in enumerate(site.block.lanes) if lane.direction == plan.direction),
        key=lambda i: site.block.lanes[i].y_m * (1 if plan.direction == "backward" else -1),
    )
    if plan.lane >= len(ordered):
        raise InputError(
            f"the site has no {plan.direction} lane {plan.lane}",
            field=f"traffic[{index}].lane",
            value=plan.lane,
            remedy=f"it has {len(ordered)} such lane(s)",
        )
    return TrafficSpec(
        id=plan.id,
        object_class=plan.object_class,
        lane=ordered[plan.lane],
        x_m=plan.x_m,
        speed_mps=plan.speed_mps,
    )


def resolve_run(
    scenario: Scenario,
    event_version: str,
    site: Site,
    site_version: str,
    *,
    run_id: str,
    seed: int,
    mode: Literal["lockstep", "realtime"],
) -> RunSpec:
    """The run that a scenario is on a site: every place in frame map, every limit named.

    Raises:
        InputError: the scenario doesn't fit the site; the field says where.
    """
    frame = _Frame(site)
    block = site.block
    if scenario.vut.driver.cruise_mps > site.limits.speed_mps:
        raise InputError(
            "is faster than the site allows",
            field="vut.driver.cruise_mps",
            value=scenario.vut.driver.cruise_mps,
            remedy=f"at most {site.limits.speed_mps:g} m/s on site {site.name}",
        )
    if scenario.vut.end_x_m > block.length_m or scenario.vut.start_x_m < 0.0:
        raise InputError(
            "leaves the block",
            field="vut.end_x_m",
            value=scenario.vut.end_x_m,
            remedy=f"the block of site {site.name} is {block.length_m:g} m long",
        )
    resolved = [_target(plan, frame, i) for i, plan in enumerate(scenario.targets)]
    left = frame.left_kerb_m + block.sidewalk_left_m + block.fence_margin_m
    right = frame.right_kerb_m - block.sidewalk_right_m - block.fence_margin_m
    return RunSpec(
        schema_="ssp.run/1",
        run_id=run_id,
        scenario=scenario.name,
        interaction=scenario.interaction,
        domain=site.domain,
        stand_in=site.stand_in,
        event_version=event_version,
        site=site.name,
        site_version=site_version,
        seed=seed,
        mode=mode,
        road=Road(
            origin=frame.start(0.0, 0.0),
            length_m=block.length_m,
            lanes=block.lanes,
            sidewalk_left_m=block.sidewalk_left_m,
            sidewalk_right_m=block.sidewalk_right_m,
            crossing_x_m=block.crossing_x_m if scenario.interaction == "vru_crossing" else None,
            speed_limit_mps=block.speed_limit_mps,
        ),
        geofence=[
            frame.point(x, y)
            for x, y in ((0.0, right), (block.length_m, right), (block.length_m, left), (0.0, left))
        ],
        vut=ParticipantSpec(
            id="vut",
            object_class=scenario.vut.object_class,
            start=frame.start(scenario.vut.start_x_m, frame.vut_y_m),
            approach=Motion(
                path=[
                    frame.point(scenario.vut.start_x_m, frame.vut_y_m),
                    frame.point(scenario.vut.end_x_m, frame.vut_y_m),
                ],
                cruise_mps=scenario.vut.driver.cruise_mps,
                acceleration_mps2=scenario.vut.driver.acceleration_mps2,
                deceleration_mps2=scenario.vut.driver.comfortable_deceleration_mps2,
            ),
        ),
        driver=scenario.vut.driver,
        targets=[spec for spec, _ in resolved],
        triggers=[trigger for _, trigger in resolved],
        thresholds=scenario.thresholds,
        limits=site.limits,
        disturbance=site.disturbance,
        traffic=[_traffic(plan, site, i) for i, plan in enumerate(scenario.traffic)],
        camera=site.camera,
        look=site.look,
        end=scenario.end,
    )
