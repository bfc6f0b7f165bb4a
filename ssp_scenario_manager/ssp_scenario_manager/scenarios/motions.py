"""A plan's motions in frame map, and how far and how long participants travel."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from ssp_core.geometry import wrap_angle
from ssp_core.names import VUT_ID
from ssp_core.run_file.participants import (
    Condition,
    Driver,
    FollowPath,
    Manoeuvre,
    Motion,
    ParticipantSpec,
    RelativeDistance,
    TimeToArrival,
    TriggerSpec,
)
from ssp_core.run_file.values import Point, Start
from ssp_core.vocabulary import ObjectWord
from ssp_core.world.car_following import free_acceleration
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine
from ssp_scenario_manager.dispatch.references import APPROACH_LEAD_S
from ssp_scenario_manager.scenarios.base import (
    BlockPoint,
    CannotPlace,
    Cross,
    Drive,
    Trigger,
    Wait,
)


@dataclass(frozen=True)
class Motions:
    """The motions of VUT and OTs, in frame map.

    Args:
        targets: OTs, in the order of their ids.
    """

    vut: ParticipantSpec
    driver: Driver
    targets: tuple[ParticipantSpec, ...]
    trigger: TriggerSpec
    initiator_id: str

    def target(self, object_id: str) -> ParticipantSpec:
        """Return the target of that id; KeyError without one."""
        return {target.id: target for target in self.targets}[object_id]


def motions(
    line: ReferenceLine,
    classes: Mapping[str, ObjectWord],
    vut_id: str,
    vut: Drive,
    targets: Mapping[str, Drive | Wait],
    trigger: Trigger,
) -> Motions:
    """Return a plan's motions on a reference line.

    Args:
        line: of the block.
        classes: of all participants, by id.
        vut_id: the VUT's id in K*; sessions know it as ``vut``.
        vut: its drive.
        targets: a drive or a wait of each, by id.
        trigger: of the initiator's manoeuvre.

    Raises:
        CannotPlace: a place lies where the block's frame has none (METHOD 2.4).
    """
    try:
        return Motions(
            vut=_participant(line, VUT_ID, classes[vut_id], vut),
            driver=Driver(
                cruise_mps=vut.cruise_mps,
                acceleration_mps2=vut.acceleration_mps2,
                comfortable_deceleration_mps2=vut.deceleration_mps2,
                headway_s=vut.headway_s,
                gives_way=[] if vut.gives_way is None else [vut.gives_way],
            ),
            targets=tuple(
                _participant(line, name, classes[name], targets[name]) for name in sorted(targets)
            ),
            trigger=_trigger(line, trigger, targets[trigger.acting_id]),
            initiator_id=trigger.object_id,
        )
    except NotOneToOne as error:
        raise CannotPlace(f"the block is too tightly curved for it: {error}") from error


def start_pose(line: ReferenceLine, place: BlockPoint, heading_rad: float = 0.0) -> Start:
    """Return the pose of a participant at a place; its heading is relative to the block's."""
    x, y = line.to_map(place.s_m, place.l_m)
    return Start(x_m=x, y_m=y, yaw_rad=wrap_angle(line.pose(place.s_m).yaw_rad + heading_rad))


def _participant(
    line: ReferenceLine, name: str, object_class: ObjectWord, motion: Drive | Wait
) -> ParticipantSpec:
    start = start_pose(line, motion.start, motion.heading_rad)
    if isinstance(motion, Wait):
        return ParticipantSpec(id=name, object_class=object_class, start=start)
    return ParticipantSpec(
        id=name,
        object_class=object_class,
        start=start,
        approach=Motion(
            path=line.path(motion.start.s_m, motion.end_s_m, motion.start.l_m),
            cruise_mps=motion.cruise_mps,
            acceleration_mps2=motion.acceleration_mps2,
            deceleration_mps2=motion.deceleration_mps2,
        ),
    )


def _trigger(line: ReferenceLine, trigger: Trigger, before: Drive | Wait) -> TriggerSpec:
    condition: Condition
    if trigger.anchor is None:
        condition = RelativeDistance(
            type="relative_distance", object_id=trigger.object_id, below_m=trigger.below
        )
    else:
        condition = TimeToArrival(
            type="time_to_arrival",
            anchor=line.to_map(trigger.anchor.s_m, trigger.anchor.l_m),
            below_s=trigger.below,
        )
    return TriggerSpec(
        id=f"{trigger.object_id}_{trigger.quantity}",
        condition=condition,
        not_before_s=trigger.not_before_s,
        object_id=trigger.acting_id,
        manoeuvre=_manoeuvre(line, trigger, before),
        lead_time_s=trigger.lead_time_s,
    )


def _manoeuvre(line: ReferenceLine, trigger: Trigger, before: Drive | Wait) -> Manoeuvre:
    act = trigger.act
    if not isinstance(act, Cross):
        return act
    return FollowPath(
        kind="follow_path",
        motion=Motion(
            path=list(_places(line, (before.start, *act.via, act.goal))),
            cruise_mps=act.speed_mps,
            acceleration_mps2=act.acceleration_mps2,
            deceleration_mps2=act.acceleration_mps2,
        ),
    )


@lru_cache(maxsize=16)
def _places(line: ReferenceLine, points: tuple[BlockPoint, ...]) -> tuple[Point, ...]:
    """Return places in frame map; many plans of one block have the same way."""
    return tuple(line.to_map(point.s_m, point.l_m) for point in points)


STEP_S = 0.05
# A driver comes near its cruise speed only slowly; from this share on it counts as reached.
CRUISE_SHARE = 0.95
# Time for which both are to be seen at cruise speed before the trigger.
HOLD_S = 1.5
LEAST_HOLD_S = 1.0


def driver_travel(cruise_mps: float, acceleration_mps2: float, t_s: float) -> tuple[float, float]:
    """Return a free driver's distance, m, and speed, m/s, at t_s: acceleration a (1 - (v/v0)^4)."""
    driver = Driver(cruise_mps=cruise_mps, acceleration_mps2=acceleration_mps2)
    distance, speed, left = 0.0, 0.0, t_s
    while left > 0.0:
        dt = min(STEP_S, left)
        faster = speed + free_acceleration(speed, driver) * dt
        distance += 0.5 * (speed + faster) * dt
        speed, left = faster, left - dt
    return distance, speed


def cruise_reached_s(cruise_mps: float, acceleration_mps2: float) -> float:
    """Return the time from standstill until a free driver has CRUISE_SHARE of its cruise speed, s.

    With x = v/v0: t = v0/a times the integral of 1 / (1 - x^4).
    """
    x = CRUISE_SHARE
    return cruise_mps / acceleration_mps2 * 0.5 * (math.atanh(x) + math.atan(x))


def reference_travel(cruise_mps: float, acceleration_mps2: float, t_s: float) -> float:
    """Return the distance of an OT's approach at session time t_s, once at cruise speed, m."""
    moving = t_s - APPROACH_LEAD_S - cruise_mps / acceleration_mps2 - 0.2
    return 0.5 * cruise_mps**2 / acceleration_mps2 + cruise_mps * max(moving, 0.0)


def stopping_m(speed_mps: float, deceleration_mps2: float, reaction_s: float = 0.3) -> float:
    """Return the distance to a standstill, m."""
    return speed_mps * reaction_s + speed_mps**2 / (2.0 * deceleration_mps2)
