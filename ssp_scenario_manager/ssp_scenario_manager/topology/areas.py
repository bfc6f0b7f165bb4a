"""Where on a block an interaction could take place: its candidate conflict areas (METHOD 2.1)."""

from __future__ import annotations

from collections.abc import Collection

from ssp_scenario_manager.topology.block import BlockLane, ConflictArea

# A marked crossing is used by people this far to either side of its centre.
CROSSING_HALF_M = 4.0


def conflict_areas(
    length_m: float,
    lanes: Collection[BlockLane],
    permitted: Collection[str],
    crossing_s_m: float | None = None,
) -> tuple[ConflictArea, ...]:
    """The candidates of one block, in order of kind and place.

    Following: all of it, as there is a lane in the direction of travel. Merging: all of it, where
    there are two such lanes and one may be changed for the other. Crossing: at a marked crossing,
    and all of it where people may cross anywhere.
    """
    found = []
    if crossing_s_m is not None:
        low = max(0.0, crossing_s_m - CROSSING_HALF_M)
        high = min(length_m, crossing_s_m + CROSSING_HALF_M)
        if low < high:
            found.append(ConflictArea("crossing", low, high))
    if "crossing" in permitted:
        found.append(ConflictArea("crossing", 0.0, length_m))
    forward = sum(lane.forward for lane in lanes)
    if forward:
        found.append(ConflictArea("following", 0.0, length_m))
    if forward > 1 and {"lane_change_left", "lane_change_right"} & set(permitted):
        found.append(ConflictArea("merge", 0.0, length_m))
    return tuple(sorted(found, key=lambda area: (area.kind, area.start_s_m, area.end_s_m)))
