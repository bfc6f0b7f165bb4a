"""A run with a wall between two carriageways, which a VUT that leaves its lane touches."""

from __future__ import annotations

from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.road import Building, Lane

_RIGHT_M = -6.2


def with_wall(
    run: RunSpec, *, wall: bool = True, from_m: float = 0.0, left_m: float = -1.8
) -> RunSpec:
    """Return a run on a straight road whose VUT drives along x, with a wall to its right.

    Args:
        run: on a road along x.
        wall: False: the road has the gap alone.
        from_m: where the wall begins.
        left_m: y of its side that faces the VUT's lane, which ends there.
    """
    width_m = min(3.5, -2.0 * left_m)
    lanes = [Lane(y_m=y, width_m=w, direction="forward") for y, w in ((0.0, width_m), (-8.0, 3.5))]
    size = {"length_m": 280.0, "width_m": left_m - _RIGHT_M, "height_m": 3.0}
    place = {"s_m": from_m + 140.0, "l_m": 0.5 * (left_m + _RIGHT_M)}
    scenery = [Building(type="building", **place, **size)] if wall else []
    road = run.road.model_copy(update={"lanes": lanes, "scenery": scenery})
    return run.model_copy(update={"road": road})
