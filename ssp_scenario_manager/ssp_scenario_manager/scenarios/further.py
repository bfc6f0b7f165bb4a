"""Further participants of an event: neither VUT nor initiator nor occluder (METHOD 1, part A).

Each has a script of its own: it stands, or it drives along its lane at one speed. It takes part in
the scene, may hide others, and causes no conflict.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from ssp_core.geometry import Box, Pose2, box_distance
from ssp_core.motion.encounter import corridor_half_m
from ssp_core.motion.state import Size
from ssp_scenario_manager.event_spec.model import Event, MotionCell
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.scenarios.base import BlockPoint, CannotPlace, Drive, Setting, Wait
from ssp_scenario_manager.scenarios.block_places import (
    END_MARGIN_M,
    ahead_of,
    end_of,
    left_kerb_m,
    neighbour,
    parked_m,
    right_kerb_m,
    within_block,
)
from ssp_scenario_manager.scenarios.values import (
    Choice,
    approach_acceleration,
    choose,
    size_of,
    vehicle_speed_limit,
)

# Between a pedestrian or cyclist who stands beside the road and the kerb.
_FROM_KERB_M = 0.75
# A further participant starts at least so far from every other.
CLEAR_M = 0.5
_TURNED_RAD = {"same": 0.0, "opposite": math.pi, "leftwards": math.pi / 2} | {
    "rightwards": -math.pi / 2
}
_ON_FOOT = frozenset({"pedestrian", "cyclist"})


def further_ids(event: Event) -> tuple[str, ...]:
    """Return the ids of the OTs that are neither initiator nor occluder, in the file's order."""
    parts = (event.interaction.initiator, event.interaction.occluder)
    return tuple(
        name for name, who in event.participants.items() if who.role == "OT" and name not in parts
    )


def cell_of(event: Event, name: str) -> MotionCell:
    """Return the motion of a participant in its approach."""
    return event.motion[name]["approach"]


def stands(event: Event, name: str) -> bool:
    """Tell whether a further participant stands, or else drives along its lane."""
    return cell_of(event, name).speed_trend == "standing"


def facing_rad(event: Event, name: str) -> float:
    """Return the heading of a further participant relative to the road, + left."""
    return _TURNED_RAD.get(cell_of(event, name).heading, 0.0)


def _fields(name: str) -> tuple[str, str]:
    """Return the paths of its gap and of its speed."""
    return f"participants.{name}.region.gap", f"constraints.speeds.{name}.approach"


def further_choices(setting: Setting) -> dict[str, Choice]:
    """Return gaps and speeds that the further participants may have, by field path.

    Raises:
        CannotPlace: one is unresolved, or outside of what the place allows.
    """
    event, choices = setting.event, dict[str, Choice]()
    fastest = vehicle_speed_limit(event, setting.limits, setting.block)
    for name in further_ids(event):
        gap, speed = _fields(name)
        choices[gap] = choose(event, gap, "m", setting.preferred)
        if not stands(event, name):
            choices[speed] = choose(event, speed, "m/s", setting.preferred, at_most=fastest)
    return choices


def further_motions(
    setting: Setting, vut: Drive, values: Mapping[str, float]
) -> dict[str, Drive | Wait]:
    """Return the motions of the further participants beside a VUT's drive.

    Args:
        setting: event, block and limits.
        vut: the VUT's drive.
        values: of ``further_choices``.

    Raises:
        CannotPlace: the block has no such place, or one of them doesn't fit there.
    """
    return {name: _motion(setting, vut, name, values) for name in further_ids(setting.event)}


def _motion(setting: Setting, vut: Drive, name: str, values: Mapping[str, float]) -> Drive | Wait:
    event, block = setting.event, setting.block
    size, cell = size_of(event, name), cell_of(event, name)
    gap, speed = _fields(name)
    l_m = _offset_m(event, block, name, vut.start.l_m)
    s_m = _arc_length_m(event, block, name, vut, values[gap])
    place = BlockPoint(round(s_m, 3), round(l_m, 3))
    if stands(event, name):
        within_block(block, size, place.s_m, name)
        return Wait(place, facing_rad(event, name))
    rate = approach_acceleration(event, name, setting.limits)
    end_s_m = end_of(block, size)
    if cell.heading == "opposite":
        end_s_m = size.front_m + END_MARGIN_M
        backwards = Size(size.rear_m, size.front_m, size.width_m, size.height_m)
        within_block(block, backwards, place.s_m, name)
    else:
        within_block(block, size, place.s_m, name)
    if abs(end_s_m - place.s_m) < size.length_m:
        raise CannotPlace(f"{name} would have no road ahead of it at s = {place.s_m:.1f} m")
    return Drive(place, values[speed], end_s_m, rate)


def _offset_m(event: Event, block: Block, name: str, lane_m: float) -> float:
    """Return the offset of its place.

    Raises:
        CannotPlace: the block has no such place.
    """
    place, size = event.participants[name].region.place, size_of(event, name)
    lanes = block.forward_lanes
    index = min(range(len(lanes)), key=lambda i: abs(lanes[i].y_m - lane_m))
    if place == "vut_lane":
        return lane_m
    if place in ("left_lane", "right_lane"):
        return neighbour(block, index, place == "left_lane").y_m
    if place == "oncoming_lane":
        oncoming = [lane.y_m for lane in block.backward_lanes]
        if not oncoming:
            raise CannotPlace(f"it has no lane in the opposite direction, in which {name} drives")
        return min(oncoming, key=lambda y_m: abs(y_m - lane_m))
    if place not in ("left_kerb", "right_kerb"):
        raise CannotPlace(f"{name} can't come from {place}: further participants keep to the road")
    right = place == "right_kerb"
    if event.participants[name].class_ in _ON_FOOT:
        off = _FROM_KERB_M + size.width_m / 2.0
        return right_kerb_m(block) - off if right else left_kerb_m(block) + off
    corridor = corridor_half_m(size_of(event, event.vut_id).width_m)
    return parked_m(block, size, lane_m, corridor, right=right)


def _arc_length_m(event: Event, block: Block, name: str, vut: Drive, gap_m: float) -> float:
    """Return the arc length of its place, with the bumper gap to the VUT along the VUT's path."""
    own, size = size_of(event, event.vut_id), size_of(event, name)
    rear, front = {
        "same": (size.rear_m, size.front_m),
        "opposite": (size.front_m, size.rear_m),
    }.get(cell_of(event, name).heading, (size.width_m / 2.0, size.width_m / 2.0))
    along = event.participants[name].region.along
    away = {"ahead": own.front_m + gap_m + rear, "behind": -own.rear_m - gap_m - front}
    return ahead_of(block, vut.start.s_m, away.get(along, 0.0), vut.start.l_m)


def starts_apart(event: Event, vut: Drive, targets: Mapping[str, Drive | Wait]) -> Iterator[str]:
    """Yield what is wrong with starts that don't keep clear of a further participant's.

    Args:
        event: K*.
        vut: the VUT's drive.
        targets: of all others, by id.
    """
    further = further_ids(event)
    if not further:
        return
    boxes = {
        name: _box(motion, size_of(event, name))
        for name, motion in {event.vut_id: vut, **targets}.items()
    }
    for name in further:
        for other, box in boxes.items():
            if other == name or (other in further and other < name):
                continue
            apart_m = box_distance(boxes[name], box)
            if apart_m < CLEAR_M:
                yield (
                    f"{name} would start {apart_m:.2f} m from {other}, {CLEAR_M:g} m keep them "
                    "clear of each other"
                )


def _box(motion: Drive | Wait, size: Size) -> Box:
    """Return the outline of a participant at its start, in the block's frame."""
    pose = Pose2(motion.start.s_m, motion.start.l_m, motion.heading_rad)
    return Box(pose, size.front_m, size.rear_m, size.width_m)
