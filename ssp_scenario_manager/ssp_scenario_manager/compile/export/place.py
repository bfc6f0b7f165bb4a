"""What an exporter needs of the place: a map file beside the scenario, and lanes to count by."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath

from ssp_core.errors import InputError
from ssp_core.run_file.participants import LaneChange
from ssp_scenario_manager.compile.export.heights import Heights
from ssp_scenario_manager.compile.export.opendrive import opendrive_map
from ssp_scenario_manager.compile.task import Task
from ssp_scenario_manager.topology.block import Block

# A lane change ends within this of a lane's centre, or it isn't one.
_LANE_CENTRE_M = 0.5


@dataclass(frozen=True, slots=True)
class MapFile:
    """The OpenDRIVE map of an export.

    Args:
        name: of the file.
        data: its bytes.
        own: made from the block; else the user's map as it is.
        heights: of its ground.
    """

    name: str
    data: bytes
    own: bool
    heights: Heights


def provenance(task: Task) -> dict[str, str]:
    """What every file of an export says about where it comes from (METHOD 2.5)."""
    return {
        "event": task.event.name,
        "event_version": task.event.version,
        "task_version": task.version,
        "compiler": task.compiler,
        "seed": str(task.seed),
    }


def map_file(task: Task, block: Block, map_text: str | None) -> MapFile:
    """The user's OpenDRIVE map, or one of the block where it was placed on a site or a SUMO net.

    Raises:
        InputError: the block can't be put into OpenDRIVE, or the map's text is missing.
    """
    if task.place.kind == "opendrive":
        if map_text is None:
            raise InputError("needs the map that it was compiled for", field="place.name")
        name = PurePath(task.place.name).name
        return MapFile(name, map_text.encode(), own=False, heights=Heights(map_text))
    name = PurePath(task.place.name).name.split(".")[0]
    data = opendrive_map([block], name, provenance(task))
    return MapFile(f"{name}.xodr", data, own=True, heights=Heights(None))


def lanes_crossed(block: Block, from_l_m: float, change: LaneChange) -> tuple[int, float]:
    """How many lanes to the left a lane change goes, and where beside that lane's centre it ends.

    Args:
        block: where it is driven.
        from_l_m: offset before it, + left of the reference line.
        change: the lane change.

    Returns:
        Lanes, < 0 to the right, and the offset from the target lane's centre in m, + left.

    Raises:
        InputError: it ends in no lane of its direction, or in the one that it started from.
    """
    lanes = block.forward_lanes
    goal = from_l_m + change.lateral_shift_m

    def nearest(offset_m: float) -> int:
        return min(range(len(lanes)), key=lambda i: abs(lanes[i].y_m - offset_m))

    start, end = nearest(from_l_m), nearest(goal)
    beside = goal - lanes[end].y_m
    if start == end or abs(beside) > _LANE_CENTRE_M:
        raise InputError(
            "doesn't end in another lane of its direction",
            field="run.triggers[0].manoeuvre.lateral_shift_m",
            value=change.lateral_shift_m,
        )
    return end - start, beside
