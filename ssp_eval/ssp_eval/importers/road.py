"""The stretch of a map that the VUT drives on, for a recording's topology (METHOD 4.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np

from ssp_core.errors import InputError
from ssp_core.geometry import FloatArray
from ssp_core.hashing import sha256_bytes
from ssp_eval.data.provenance import ImportedSite
from ssp_eval.importers.tracks import Track
from ssp_scenario_manager.compile.place import road_of
from ssp_scenario_manager.compile.task import SITE_FILE
from ssp_scenario_manager.maps.block import Block, Library
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.site import find_shipped

# So much of the VUT's way must lie on the block, so that its lane and its lanes' number mean it.
LEAST_SHARE = 0.8
# Blocks whose shares differ by less fit alike.
_ALIKE = 0.01
_STEP_M = 0.5
_SHOWN = 6
_MAPS = {"opendrive": "map.xodr", "sumo": "map.net.xml"}


@dataclass(frozen=True)
class BoundRoad:
    """The road of a recording.

    Args:
        share: of the VUT's way that lies on the block.
        notes: on the block, such as left-hand traffic.
    """

    site: ImportedSite
    data: bytes
    share: float
    notes: tuple[str, ...] = ()


def bind_road(name_or_path: str, block: str | None, vut: Track) -> BoundRoad:
    """Return the block of a map under the VUT's path.

    Args:
        name_or_path: OpenDRIVE map, SUMO network, site file, or the name of a shipped site.
        block: its id, None: the one that fits; of a bent road and its straight parts the whole.
        vut: in the map's frame.

    Raises:
        InputError: the file is no map, no block lies under the path, or several do alike.
    """
    path = Path(name_or_path)
    if not path.is_file():
        path = find_shipped(name_or_path, "site")
    library = load_library(path)
    points, headings = _way(vut)
    if block is not None:
        known = {one.block_id: one for one in library.blocks}
        if block not in known:
            raise InputError(
                "is no block of this map",
                file=path,
                field="--block",
                value=block,
                remedy=f"its blocks are {_listed(list(known))}",
            )
        chosen = known[block]
        share = share_on(chosen, points, headings)
    else:
        chosen, share = _best(library, path, points, headings)
    if share < LEAST_SHARE:
        raise InputError(
            f"{100 * share:.0f} % of the VUT's way lie on {chosen.block_id}, in its direction",
            file=path,
            remedy=f"at least {100 * LEAST_SHARE:.0f} % are needed: cut the recording to the event "
            "with --start and --end, or name another block",
        )
    data = path.read_bytes()
    return BoundRoad(
        ImportedSite(
            name=library.source,
            kind=library.kind,
            attachment=SITE_FILE if library.kind == "site" else _MAPS[library.kind],
            sha256=sha256_bytes(data),
            block=chosen.block_id,
            road=road_of(chosen),
            road_type=_known("road_type", chosen.road_type),
            left_boundary=_known("left_boundary", chosen.left_boundary),
            right_boundary=_known("right_boundary", chosen.right_boundary),
        ),
        data,
        share,
        chosen.notes,
    )


def _known(field: str, word: str) -> str:
    """Return a word of the map, or that it doesn't say."""
    words = get_args(ImportedSite.model_fields[field].annotation)
    return word if word in words else "unresolved"


def _way(vut: Track) -> tuple[FloatArray, FloatArray]:
    """Points at even steps along the VUT's way, and its headings there."""
    size = vut.body.extent
    middle = vut.samples.moved_ahead((size.front_m - size.rear_m) / 2.0)
    x, y = middle["x_m"], middle["y_m"]
    gone = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    at = np.arange(0.0, gone[-1] + _STEP_M, _STEP_M).clip(max=gone[-1])
    yaw = np.interp(at, gone, np.unwrap(middle["yaw_rad"]))
    return np.column_stack([np.interp(at, gone, x), np.interp(at, gone, y)]), yaw


def share_on(block: Block, points: FloatArray, headings: FloatArray) -> float:
    """Share of a way that lies on a block's lanes, driven in the block's direction."""
    local = block.line.to_local_many(points)
    s_m, l_m = local[:, 0], local[:, 1]
    with np.errstate(invalid="ignore"):
        inside = (s_m >= -_STEP_M) & (s_m <= block.length_m + _STEP_M)
        inside &= (l_m >= block.right_edge_m) & (l_m <= block.left_edge_m)
    for i in np.flatnonzero(inside):
        along = block.line.pose(float(np.clip(s_m[i], 0.0, block.length_m))).yaw_rad
        inside[i] = math.cos(headings[i] - along) > 0.0
    return float(inside.mean())


def _best(
    library: Library, path: Path, points: FloatArray, headings: FloatArray
) -> tuple[Block, float]:
    shares = {
        block.block_id: share_on(block, points, headings)
        for block in library.blocks
        if _near(block, points)
    }
    best = max(shares.values(), default=0.0)
    if best <= 0.0:
        raise InputError(
            _nowhere(library, points),
            file=path,
            remedy="give the map of the place; where its frame is another one, "
            "--transform all=X,Y,YAW_DEG (or --datum) brings the poses into it",
        )
    alike = [b for b in library.blocks if best - shares.get(b.block_id, 0.0) <= _ALIKE]
    whole = [b for b in alike if not any(_is_part(b, other) for other in alike)]
    if len(whole) > 1:
        raise InputError(
            f"{len(whole)} blocks lie under the VUT's way alike: "
            f"{_listed([b.block_id for b in whole])}",
            file=path,
            remedy="name one with --block",
        )
    return whole[0], best


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
