"""Further participants of a synthetic clip, drawn beside those of its storyboard."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ssp_core.errors import InputError
from ssp_core.geometry import Box, Pose2
from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.vocabulary import ObjectClass, Role
from ssp_ot_controller.camera.actors import Actor, Line
from ssp_ot_controller.camera.storyboards import (
    CAR,
    KERB_M,
    LANE_M,
    VUT_START_M,
    LaneCounts,
    Storyboard,
)


@dataclass(frozen=True)
class FurtherActor:
    """A participant that is drawn beside those of a scenario: it stands, or drives at one speed.

    Args:
        object_id: its id.
        object_class: its class.
        place: where it is, by the words of part A.
        ahead_m: from the VUT's front bumper to its nearest point along the road, at the start.
        speed_mps: 0 where it stands.
        facing_rad: its heading.
    """

    object_id: str
    object_class: ObjectClass
    place: str
    ahead_m: float
    speed_mps: float
    facing_rad: float


# Between a road user who stands beside the carriageway and its edge.
_BESIDE_M = 0.75


def with_further(board: Storyboard, further: Sequence[FurtherActor]) -> Storyboard:
    """Return the storyboard with further participants, without traffic in their lanes.

    Raises:
        InputError: the clip's road has no such place.
    """
    lanes = board.road.lanes
    same = sum(lane.direction == "forward" for lane in lanes)
    counts = LaneCounts(same, len(lanes) - same)
    actors = tuple(_further_actor(one, counts) for one in further)
    positions_y_m = {actor.state(0.0).y_m for actor in actors}
    others = [
        actor
        for actor in board.others
        if actor.role is not Role.TRAFFIC or actor.state(0.0).y_m not in positions_y_m
    ]
    return replace(board, others=(*others, *actors))


def _further_actor(one: FurtherActor, lanes: LaneCounts) -> Actor:
    size = DEFAULT_SIZES[one.object_class]
    offsets = {
        "vut_lane": 0.0,
        "left_kerb": (lanes.total - 0.5) * LANE_M + _BESIDE_M + size.width_m / 2,
        "right_kerb": KERB_M - _BESIDE_M - size.width_m / 2,
    }
    if lanes.same > 1:
        offsets["left_lane"] = LANE_M
    if lanes.opposite:
        offsets["oncoming_lane"] = lanes.same * LANE_M
    if one.place not in offsets:
        raise InputError(
            "can't be drawn on the clip's road",
            field=f"participants.{one.object_id}.region.place",
            value=one.place,
            remedy=f"one of {', '.join(sorted(offsets))}",
        )
    corners = Box(Pose2(0.0, 0.0, one.facing_rad), size.front_m, size.rear_m, size.width_m)
    nearest_m = min(x for x, _ in corners.corners())
    start_m = VUT_START_M + CAR.front_m + one.ahead_m - nearest_m
    along = Line(start_m, one.speed_mps * math.cos(one.facing_rad))
    across = Line(offsets[one.place], 0.0)
    return Actor(one.object_id, one.object_class, Role.OT, along, across, one.facing_rad)
