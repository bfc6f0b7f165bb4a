"""The maps that come with the project, for trying the compiler on multi-lane roads.

``python -m ssp_scenario_manager.compile.export.maps`` writes them anew; a test compares.
"""

from __future__ import annotations

from collections.abc import Callable

from ssp_core.files import write_bytes
from ssp_core.geometry import Pose2
from ssp_core.run_file.road import CurvePiece
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.compile.export.opendrive import opendrive_map
from ssp_scenario_manager.site import LIBRARY
from ssp_scenario_manager.topology.block import Block, BlockLane

MAP_FOLDER = LIBRARY / "maps"
_BEND_1PM = 1.0 / 250.0


def motorway() -> bytes:
    """800 m of straight motorway, one way: three lanes of 3.75 m and hard shoulders."""
    return opendrive_map(
        [
            Block(
                block_id="motorway",
                line=ReferenceLine(Pose2(0.0, 0.0, 0.0), [CurvePiece(length_m=800.0)]),
                lanes=tuple(
                    BlockLane(-y, 3.75, True, name)
                    for y, name in ((9.375, "right"), (5.625, "middle"), (1.875, "left"))
                ),
                road_type="motorway",
                segment="straight",
                left_boundary="shoulder",
                right_boundary="shoulder",
                sidewalk_left_m=0.0,
                sidewalk_right_m=0.0,
                permitted=frozenset({"keep_lane", "lane_change_left", "lane_change_right"}),
                speed_limit_mps=33.3,
                shoulder_left_m=1.0,
                shoulder_right_m=2.5,
            )
        ],
        "motorway",
        {"origin": "ssp_scenario_manager.compile.export.maps"},
    )


def bend() -> bytes:
    """A town road of two lanes a direction: straight, a bend to the left of 250 m, straight."""
    return opendrive_map(
        [
            Block(
                block_id="bend",
                line=ReferenceLine(
                    Pose2(0.0, 0.0, 0.0),
                    [
                        CurvePiece(length_m=300.0),
                        CurvePiece(length_m=50.0, end_curvature_1pm=_BEND_1PM),
                        CurvePiece(
                            length_m=160.0,
                            start_curvature_1pm=_BEND_1PM,
                            end_curvature_1pm=_BEND_1PM,
                        ),
                        CurvePiece(length_m=50.0, start_curvature_1pm=_BEND_1PM),
                        CurvePiece(length_m=300.0),
                    ],
                ),
                lanes=tuple(
                    BlockLane(y, 3.5, y < 0.0, f"{side} {'forward' if y < 0.0 else 'backward'}")
                    for y, side in (
                        (-5.25, "right"),
                        (-1.75, "left"),
                        (1.75, "left"),
                        (5.25, "right"),
                    )
                ),
                road_type="urban",
                segment="curve",
                left_boundary="kerb",
                right_boundary="kerb",
                sidewalk_left_m=2.5,
                sidewalk_right_m=2.5,
                permitted=frozenset(
                    {"keep_lane", "lane_change_left", "lane_change_right", "crossing", "stop"}
                ),
                speed_limit_mps=13.9,
            )
        ],
        "bend",
        {"origin": "ssp_scenario_manager.compile.export.maps"},
    )


MAPS: dict[str, Callable[[], bytes]] = {"motorway.xodr": motorway, "bend.xodr": bend}


def write_maps() -> None:
    """Writes all maps into the library."""
    for name, make in MAPS.items():
        write_bytes(MAP_FOLDER / name, make())


if __name__ == "__main__":
    write_maps()
