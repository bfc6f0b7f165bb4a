"""The stretch of a map that the VUT drives on, for a recording's topology (METHOD 4.3)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from ssp_core.errors import InputError
from ssp_core.geometry import FloatArray
from ssp_core.hashing import sha256_bytes
from ssp_core.run_file.road import JunctionRoad
from ssp_eval.data.provenance import ImportedSite
from ssp_eval.importers.tracks import Track
from ssp_scenario_manager.compile.place import road_of
from ssp_scenario_manager.compile.task import SITE_FILE
from ssp_scenario_manager.maps.arms import junction_roads
from ssp_scenario_manager.maps.block import Block, Library
from ssp_scenario_manager.maps.lane_ends import with_lane_ends
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.routes import routes_of
from ssp_scenario_manager.maps.site import find_shipped

# So much of the VUT's way must lie on the block, so that its lane and its lanes' number mean it.
LEAST_SHARE = 0.8
# Blocks whose shares differ by less fit alike.
_ALIKE = 0.01
# Routes over which the VUT keeps to the middle of their lanes alike, to so much.
_ALIKE_M = 0.3
_STEP_M = 0.5
_SHOWN = 6
_MAPS = {"opendrive": "map.xodr", "sumo": "map.net.xml"}


@dataclass(frozen=True)
class RecordingRoad:
    """The road of a recording.

    Args:
        share: of the VUT's way that lies on the block.
        notes: on the block, such as left-hand traffic.
    """

    site: ImportedSite
    data: bytes
    share: float
    notes: tuple[str, ...] = ()


def bind_road(name_or_path: str, block: str | None, vut: Track) -> RecordingRoad:
    """Return the block of a map under the VUT's path, or its route through a junction.

    Args:
        name_or_path: OpenDRIVE map, SUMO network, site file, or the name of a shipped site.
        block: its id, None: the one that fits; of a bent road and its straight parts the whole. A
            route fits where no block holds enough of the way.
        vut: in the map's frame.

    Raises:
        InputError: the file is no map, no block lies under the path, or several do alike.
    """
    path = Path(name_or_path)
    if not path.is_file():
        path = find_shipped(name_or_path, "site")
    library = load_library(path)
    way = Way.of(vut)
    map_block, notes = _block_and_notes(library, path, block, way)
    share = share_on(map_block, way)
    if share < LEAST_SHARE:
        raise InputError(
            f"{100 * share:.0f} % of the VUT's way lie on {map_block.block_id}, in its direction",
            file=path,
            remedy=f"at least {100 * LEAST_SHARE:.0f} % are needed: cut the recording to the event "
            "with --start and --end, or name another block",
        )
    data = path.read_bytes()
    return RecordingRoad(
        ImportedSite(
            name=library.source,
            kind=library.kind,
            attachment=SITE_FILE if library.kind == "site" else _MAPS[library.kind],
            sha256=sha256_bytes(data),
            block=map_block.block_id,
            road=road_of(map_block, None, _junction_of(library, map_block)),
            road_type=_vocabulary_word("road_type", map_block.road_type),
            left_boundary=_vocabulary_word("left_boundary", map_block.left_boundary),
            right_boundary=_vocabulary_word("right_boundary", map_block.right_boundary),
        ),
        data,
        share,
        (*map_block.notes, *notes),
    )


def _vocabulary_word(field: str, word: str) -> str:
    """Return a word of the map, or that it doesn't say."""
    words = get_args(ImportedSite.model_fields[field].annotation)
    return word if word in words else "unresolved"


@dataclass(frozen=True)
class Way:
    """The VUT's way: points at even steps along it, shape (n, 2), and its headings there."""

    points: FloatArray
    headings: FloatArray

    @classmethod
    def of(cls, vut: Track) -> Way:
        """Return the way of a track's middle."""
        size = vut.body.extent
        middle = vut.samples.moved_ahead((size.front_m - size.rear_m) / 2.0)
        x, y = middle["x_m"], middle["y_m"]
        gone = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
        at = np.arange(0.0, gone[-1] + _STEP_M, _STEP_M).clip(max=gone[-1])
        yaw = np.interp(at, gone, np.unwrap(middle["yaw_rad"]))
        return cls(np.column_stack([np.interp(at, gone, x), np.interp(at, gone, y)]), yaw)


def share_on(block: Block, way: Way) -> float:
    """Share of a way that lies on a block's lanes, driven in the block's direction."""
    return float(_inside(block, way)[0].mean())


def _inside(block: Block, way: Way) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return which points of a way lie on a block, driven in its direction, and all offsets."""
    local = block.line.to_local_many(way.points)
    s_m, l_m = local[:, 0], local[:, 1]
    with np.errstate(invalid="ignore"):
        inside = (s_m >= -_STEP_M) & (s_m <= block.length_m + _STEP_M)
        inside &= (l_m >= block.right_edge_m) & (l_m <= block.left_edge_m)
    for i in np.flatnonzero(inside):
        along = block.line.pose(float(np.clip(s_m[i], 0.0, block.length_m))).yaw_rad
        inside[i] = math.cos(way.headings[i] - along) > 0.0
    return inside, l_m


def _block_and_notes(
    library: Library, path: Path, name: str | None, way: Way
) -> tuple[Block, tuple[str, ...]]:
    """Return the block or route that is named, or that fits, and notes on the choice."""
    if name is not None:
        return _block_of_name(library, path, name, way), ()
    shares = _shares(library.blocks, way)
    best = max(shares.values(), default=0.0)
    if best <= 0.0:
        raise InputError(
            _nowhere(library, way.points),
            file=path,
            remedy="give the map of the place; where its frame is another one, "
            "--transform all=X,Y,YAW_DEG (or --datum) brings the poses into it",
        )
    routes = _routes_under(library, way) if best < 1.0 - _ALIKE else []
    over = _shares(routes, way)
    most = max(over.values(), default=0.0)
    if best < LEAST_SHARE <= most:
        alike = [one for one in routes if most - over[one.block_id] <= _ALIKE]
        offsets = {one.block_id: _offset_m(one, way) for one in alike}
        nearest = min(offsets.values())
        return _only([r for r in alike if offsets[r.block_id] - nearest <= _ALIKE_M], path), ()
    alike = [b for b in library.blocks if best - shares.get(b.block_id, 0.0) <= _ALIKE]
    block = _only([b for b in alike if not any(_is_part(b, other) for other in alike)], path)
    further = [r for r in routes if over[r.block_id] - best > _ALIKE]
    if not further:
        return block, ()
    nearest_route = min(further, key=lambda one: (-over[one.block_id], _offset_m(one, way)))
    note = f"{nearest_route.block_id} holds {100 * over[nearest_route.block_id]:.0f} % of the way"
    return block, (f"{note}: where the event is in the junction, name it with --block",)


def _block_of_name(library: Library, path: Path, name: str, way: Way) -> Block:
    blocks_by_id = {one.block_id: one for one in library.blocks}
    if name not in blocks_by_id:
        blocks_by_id |= {one.block_id: one for one in _routes_under(library, way)}
    if name not in blocks_by_id:
        raise InputError(
            "is no block of this map, nor a route under the VUT's way",
            file=path,
            field="--block",
            value=name,
            remedy=f"its blocks are {_listed(list(blocks_by_id))}",
        )
    return blocks_by_id[name]


def _only(blocks: list[Block], path: Path) -> Block:
    if len(blocks) > 1:
        raise InputError(
            f"{len(blocks)} blocks lie under the VUT's way alike: "
            f"{_listed([b.block_id for b in blocks])}",
            file=path,
            remedy="name one with --block",
        )
    return blocks[0]


def _shares(blocks: Iterable[Block], way: Way) -> dict[str, float]:
    return {one.block_id: share_on(one, way) for one in blocks if _near(one, way.points)}


def _offset_m(route: Block, way: Way) -> float:
    """Return how far a way lies beside the middle of a route's own lane, on average."""
    inside, l_m = _inside(route, way)
    return float(np.abs(l_m[inside]).mean())


def _routes_under(library: Library, way: Way) -> list[Block]:
    """Return the routes over junctions that the way leads through, and that it touches."""
    library = with_lane_ends(library)
    inside = [block for block in library.blocks if block.junction is not None]
    names = {one.junction for one in inside if _near(one, way.points) and share_on(one, way) > 0.0}
    routes = [
        route for name in sorted(filter(None, names)) for route in routes_of(library, name)[0]
    ]
    return [route for route in routes if _near(route, way.points)]


def _junction_of(library: Library, block: Block) -> list[JunctionRoad]:
    """Return the roads of the junction that a route leads through; none of another block."""
    if block.passage is None or block.junction is None:
        return []
    return junction_roads(with_lane_ends(library), block.junction)


def _is_part(block: Block, other: Block) -> bool:
    """Tell whether a block is a straight part of a bent one, given beside the whole."""
    return block is not other and block.block_id.startswith(f"{other.block_id} [")


def _near(block: Block, points: FloatArray) -> bool:
    """Tell whether a way can touch a block at all: cheap, before every point is projected."""
    start = block.line.pose(0.0)
    reach = block.length_m + max(abs(block.left_edge_m), abs(block.right_edge_m))
    gaps = np.hypot(points[:, 0] - start.x_m, points[:, 1] - start.y_m)
    return bool(gaps.min() <= reach)


def _nowhere(library: Library, points: FloatArray) -> str:
    """Describe how far the way lies from the map."""
    middle = points[len(points) // 2]
    gaps = {
        block.block_id: min(
            math.hypot(pose.x_m - middle[0], pose.y_m - middle[1])
            for pose in (block.line.pose(block.length_m * k / 8) for k in range(9))
        )
        for block in library.blocks
    }
    text = f"no block lies under the VUT's way, which goes by x {middle[0]:.1f}, y {middle[1]:.1f}"
    if not gaps:
        return f"{text}: the map has no block"
    nearest = min(gaps, key=lambda name: gaps[name])
    return f"{text}; the nearest, {nearest}, is about {gaps[nearest]:.0f} m away"


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more
