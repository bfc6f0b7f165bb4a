"""The run that a scenario is on a site: every place in frame map, every limit named.

METHOD 2.4: p = R p_local + t, with the block's frame as the local one.
"""

from __future__ import annotations

import math
from typing import Literal

from ssp_core.errors import InputError
from ssp_core.geometry import Pose2
from ssp_core.names import VUT_ID
from ssp_core.run_spec import (
    Condition,
    FollowPath,
    LaneChange,
    Manoeuvre,
    Motion,
    ParticipantSpec,
    Point,
    RelativeDistance,
    Road,
    RunSpec,
    Start,
    TimeToArrival,
    TrafficSpec,
    TriggerSpec,
)
from ssp_core.state import DEFAULT_SIZES, Size
from ssp_core.vocab import ObjectClass
from ssp_scenario_manager.scenario import (
    ApproachPlan,
    CrossPlan,
    GapBelow,
    LaneChangePlan,
    Place,
    Scenario,
    Site,
    TargetPlan,
    TrafficPlan,
    VutPlan,
)


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
        if block.lanes[block.vut_lane].direction != "forward":
            raise InputError(
                "the VUT's lane must run forward", field="block.vut_lane", value=block.vut_lane
            )
        self.site = site
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

    def along(self, x_m: float, size: Size, field: str) -> float:
        """A place along the block at which an object that faces along it fits in."""
        length = self.site.block.length_m
        if not size.rear_m <= x_m <= length - size.front_m:
            raise InputError(
                "leaves the block",
                field=field,
                value=x_m,
                remedy=f"from {size.rear_m:g} to {length - size.front_m:g} m fits on the block of "
                f"site {self.site.name}, which is {length:g} m long",
            )
        return x_m

    def allowed(self, value: float, limit: float, unit: str, field: str) -> float:
        """A value that must not exceed a limit of the site."""
        if value > limit:
            raise InputError(
                "is more than the site allows",
                field=field,
                value=value,
                remedy=f"at most {limit:g} {unit} on site {self.site.name}",
            )
        return value

    def speed(self, value: float, field: str) -> float:
        return self.allowed(value, self.site.limits.speed_mps, "m/s", field)

    def acceleration(self, value: float, field: str) -> float:
        return self.allowed(value, self.site.limits.acceleration_mps2, "m/s^2", field)

    def point(self, x_m: float, y_m: float) -> Point:
        return self.origin.to_parent(x_m, y_m)

    def start(self, x_m: float, y_m: float, heading_deg: float = 0.0) -> Start:
        x, y = self.point(x_m, y_m)
        return Start(x_m=x, y_m=y, yaw_rad=self.origin.yaw_rad + math.radians(heading_deg))


def _approach(
    plan: ApproachPlan, start_x_m: float, y_m: float, size: Size, frame: _Frame, field: str
) -> Motion:
    if plan.end_x_m <= start_x_m:
        raise InputError(
            "must be ahead of the start",
            field=f"{field}.end_x_m",
            value=plan.end_x_m,
            remedy=f"more than {start_x_m:g} m",
        )
    frame.along(plan.end_x_m, size, f"{field}.end_x_m")
    return Motion(
        path=[frame.point(start_x_m, y_m), frame.point(plan.end_x_m, y_m)],
        cruise_mps=frame.speed(plan.cruise_mps, f"{field}.cruise_mps"),
        acceleration_mps2=frame.acceleration(plan.acceleration_mps2, f"{field}.acceleration_mps2"),
        deceleration_mps2=frame.acceleration(plan.deceleration_mps2, f"{field}.deceleration_mps2"),
    )


def _lane_change(
    plan: LaneChangePlan, start: Place, y_m: float, frame: _Frame, field: str
) -> LaneChange:
    if start.lane is None:
        raise InputError("needs a start in a lane", field=f"{field}.kind", value=plan.kind)
    return LaneChange(
        kind="lane_change",
        lateral_shift_m=frame.lane_y(start.lane + plan.lanes, f"{field}.lanes") - y_m,
        duration_s=plan.duration_s,
        cruise_mps=frame.speed(plan.cruise_mps, f"{field}.cruise_mps"),
        deceleration_mps2=frame.acceleration(plan.deceleration_mps2, f"{field}.deceleration_mps2"),
    )


def _cross(
    plan: CrossPlan, start_x_m: float, y_m: float, size: Size, frame: _Frame, field: str
) -> FollowPath:
    frame.along(plan.to.x_m, size, f"{field}.to.x_m")
    end_y_m = frame.lateral(plan.to, f"{field}.to")
    if (plan.to.x_m, end_y_m) == (start_x_m, y_m):
        raise InputError("must be another place than the start", field=f"{field}.to")
    acceleration = frame.acceleration(plan.acceleration_mps2, f"{field}.acceleration_mps2")
    return FollowPath(
        kind="follow_path",
        motion=Motion(
            path=[frame.point(start_x_m, y_m), frame.point(plan.to.x_m, end_y_m)],
            cruise_mps=frame.speed(plan.speed_mps, f"{field}.speed_mps"),
            acceleration_mps2=acceleration,
            deceleration_mps2=acceleration,
        ),
    )


def _check_ids(scenario: Scenario) -> None:
    """Every object of a run has an id of its own, and conditions name targets."""
    fields = {VUT_ID: "vut"}
    ids = [(f"targets[{i}].id", target.id) for i, target in enumerate(scenario.targets)]
    ids += [(f"traffic[{i}].id", vehicle.id) for i, vehicle in enumerate(scenario.traffic)]
    for field, object_id in ids:
        if object_id in fields:
            raise InputError(
                f"is the id of {fields[object_id]} already", field=field, value=object_id
            )
        fields[object_id] = field
    targets = [target.id for target in scenario.targets]
    for i, target in enumerate(scenario.targets):
        condition = target.trigger.condition
        if isinstance(condition, GapBelow) and condition.object_id not in targets:
            raise InputError(
                "is no target of this scenario",
                field=f"targets[{i}].trigger.condition.object_id",
                value=condition.object_id,
                remedy=f"its targets are {', '.join(targets)}",
            )


def _target(plan: TargetPlan, frame: _Frame, index: int) -> tuple[ParticipantSpec, TriggerSpec]:
    field = f"targets[{index}]"
    size = DEFAULT_SIZES[ObjectClass.from_word(plan.object_class)]
    frame.along(plan.start.x_m, size, f"{field}.start.x_m")
    y = frame.lateral(plan.start, f"{field}.start")
    approach = None
    if plan.approach is not None:
        approach = _approach(plan.approach, plan.start.x_m, y, size, frame, f"{field}.approach")
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
        manoeuvre = _lane_change(
            trigger.manoeuvre, plan.start, y, frame, f"{field}.trigger.manoeuvre"
        )
    else:
        manoeuvre = _cross(
            trigger.manoeuvre, plan.start.x_m, y, size, frame, f"{field}.trigger.manoeuvre"
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


def _vut_motion(plan: VutPlan, frame: _Frame) -> Motion:
    size = DEFAULT_SIZES[ObjectClass.from_word(plan.object_class)]
    frame.along(plan.start_x_m, size, "vut.start_x_m")
    frame.along(plan.end_x_m, size, "vut.end_x_m")
    if plan.end_x_m <= plan.start_x_m:
        raise InputError(
            "must be ahead of the start",
            field="vut.end_x_m",
            value=plan.end_x_m,
            remedy=f"more than {plan.start_x_m:g} m",
        )
    driver = plan.driver
    return Motion(
        path=[
            frame.point(plan.start_x_m, frame.vut_y_m),
            frame.point(plan.end_x_m, frame.vut_y_m),
        ],
        cruise_mps=frame.speed(driver.cruise_mps, "vut.driver.cruise_mps"),
        acceleration_mps2=driver.acceleration_mps2,
        deceleration_mps2=driver.comfortable_deceleration_mps2,
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
    _check_ids(scenario)
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
            id=VUT_ID,
            object_class=scenario.vut.object_class,
            start=frame.start(scenario.vut.start_x_m, frame.vut_y_m),
            approach=_vut_motion(scenario.vut, frame),
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
