"""Change in the pictures where an object should be, against the road beside it.

The earlier picture of a pair is carried over to the later one as if all of it were flat road that
stands still. Where that is so, nothing changes. Where an object stands, something does: it is
higher than the road, and mostly it moves. Only the part of its projected box that lies before the
road is compared, with the same rows of the road beside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.geometry import FloatArray
from ssp_core.motion.state import ObjectState
from ssp_core.world.camera import Intrinsics, Mounting, View, optical_axes, shown_box
from ssp_eval.pictures.footage import Footage, Mask
from ssp_eval.recordings.sight import clear_share

_REACH_M, _HALF_WIDTH_M = 45.0, 8.0
_LEAST_HEIGHT_PX, _LEAST_WIDTH_PX = 12.0, 4.0
_LEAST_INSIDE, _LEAST_OUTSIDE = 12, 30
_GROWN_PX = 6
# Beside the box, in its widths.
_REACH_WIDTHS = 2.0
# Less of it is clear of others: then what changes may be them.
_CLEAR = 0.6
# Of a grey level: noise of both, so that two quiet places differ by nothing.
_QUIET = 1.0


@dataclass(frozen=True)
class Change:
    """Change at one pair of frames, in grey levels.

    Args:
        t_s: clip time of the later frame.
        inside: mean within the object's box.
        outside: mean beside it.
        mirrored: mean where the box would be in a mirrored picture; None: it overlaps the box, or
            lies outside of the picture.
        off_m: how far to the right of the box, at its distance, the change lies; None: unclear.
    """

    t_s: float
    inside: float
    outside: float
    mirrored: float | None
    off_m: float | None = None

    @property
    def factor(self) -> float:
        """Ratio of the change inside the box to that beside it."""
        return (self.inside + _QUIET) / (self.outside + _QUIET)

    @property
    def mirrored_factor(self) -> float | None:
        """The same of the mirrored box."""
        if self.mirrored is None:
            return None
        return (self.mirrored + _QUIET) / (self.outside + _QUIET)


def is_visible(footage: Footage, index: int, object_id: str) -> bool:
    """Tell whether an object is large and clear enough in a frame, by its states, to be judged."""
    states = footage.moments[index].states
    if object_id not in states or footage.vut_id not in states:
        return False
    view = footage.view(index)
    box = shown_box(view, states[object_id])
    if box is None or box[3] - box[1] < _LEAST_HEIGHT_PX or box[2] - box[0] < _LEAST_WIDTH_PX:
        return False
    others = [s for name, s in states.items() if name not in (footage.vut_id, object_id)]
    return clear_share(view.position_m, states[object_id], others) >= _CLEAR


def is_aside(footage: Footage, index: int, object_id: str) -> bool:
    """Tell whether an object that is shown lies wholly in one half of the picture."""
    box = shown_box(footage.view(index), footage.moments[index].states[object_id])
    middle_px = (footage.lens.width_px - 1) / 2.0
    if box is None:
        return False
    return box[2] < middle_px - _GROWN_PX or box[0] > middle_px + _GROWN_PX


def compare_change(
    footage: Footage, pairs: Sequence[tuple[int, int]], object_id: str
) -> list[Change]:
    """Measure change inside and beside an object's box.

    Args:
        footage: pictures and states of the recording.
        pairs: indices of frames with a picture, the earlier one first; the object is shown in the
            later one.
        object_id: id of the object.
    """
    if not pairs:
        return []
    ahead = _road_ahead(footage.lens, footage.optics.mounting)
    changes = (_change(footage, first, second, object_id, ahead) for first, second in pairs)
    return [change for change in changes if change is not None]


def _change(
    footage: Footage, first: int, second: int, object_id: str, ahead: Mask
) -> Change | None:
    old, new = footage.grey[first], footage.grey[second]
    before, after = footage.view(first), footage.view(second)
    height, width = new.shape
    onto = _of_ground(after) @ np.linalg.inv(_of_ground(before))

    def carried(mask: Mask) -> Mask:
        picture = mask.astype(np.uint8)
        warped = cv2.warpPerspective(picture, onto, (width, height), flags=cv2.INTER_NEAREST)
        return np.asarray(warped > 0, np.bool_)

    moved = cv2.warpPerspective(old, onto, (width, height), flags=cv2.INTER_LINEAR)
    changed = cv2.absdiff(
        cv2.GaussianBlur(moved, (3, 3), 0), cv2.GaussianBlur(new, (3, 3), 0)
    ).astype(np.float32)
    road = ahead & carried(np.ones(old.shape, np.bool_))
    for name in footage.moments[second].states:
        if name not in (footage.vut_id, object_id):
            road &= ~_box(footage, second, name, 3)
    for name in footage.moments[first].states:
        if name not in (footage.vut_id, object_id):
            road &= ~carried(_box(footage, first, name, 3))
    box, grown = _box(footage, second, object_id), _box(footage, second, object_id, _GROWN_PX)
    inside = box & road
    if inside.sum() < _LEAST_INSIDE:
        return None
    was = carried(_box(footage, first, object_id, 2))
    rows = np.flatnonzero(inside.any(axis=1))
    beside = road & ~grown & ~was
    beside[: rows[0]] = beside[rows[-1] + 1 :] = False
    if beside.sum() < _LEAST_OUTSIDE:
        return None
    mirror = box[:, ::-1]
    mirrored = None
    place = mirror & road & ~was
    if not (mirror & grown).any() and place.sum() >= _LEAST_INSIDE:
        mirrored = float(changed[place].mean())
    off_px = _off_px(changed, box, road & (box | ~was))
    state = footage.moments[second].states[object_id]
    return Change(
        footage.moments[second].t_s,
        float(changed[inside].mean()),
        float(changed[beside].mean()),
        mirrored,
        None if off_px is None else off_px * _metres_per_px(after, state),
    )


def _metres_per_px(view: View, state: ObjectState) -> float:
    """Return how wide a pixel is at an object's distance."""
    at = np.array([state.x_m, state.y_m, 0.0]) - view.position_m
    return float(at @ view.rotation[2]) / view.intrinsics.fx_px


def _off_px(changed: NDArray[np.float32], box: Mask, road: Mask) -> int | None:
    """Return how far beside the box the change lies that stands out most from both its sides."""
    rows = np.flatnonzero((box & road).any(axis=1))
    columns = np.flatnonzero(box.any(axis=0))
    part, road_part = changed[rows[0] : rows[-1] + 1], road[rows[0] : rows[-1] + 1]
    total = np.concatenate([[0.0], np.cumsum(np.where(road_part, part, 0.0).sum(axis=0))])
    count = np.concatenate([[0.0], np.cumsum(road_part.sum(axis=0))])
    left, right = int(columns[0]), int(columns[-1]) + 1
    width, last = right - left, box.shape[1]
    flank = max(2, width // 2)

    def mean(start: int, end: int) -> float:
        start, end = min(max(start, 0), last), min(max(end, 0), last)
        cells = count[end] - count[start]
        return float((total[end] - total[start]) / cells) if cells >= 4 else math.nan

    best = -math.inf
    offset_px: int | None = None
    reach = round(_REACH_WIDTHS * width)
    for by in sorted(range(-reach, reach + 1), key=abs):
        inside = mean(left + by, right + by)
        sides = [mean(left + by - flank, left + by), mean(right + by, right + by + flank)]
        known_sides = [side for side in sides if math.isfinite(side)]
        if not math.isfinite(inside) or not known_sides:
            continue
        stands_out = inside - sum(known_sides) / len(known_sides)
        if stands_out > best + 1e-9:
            best, offset_px = stands_out, by
    return offset_px


def _of_ground(view: View) -> FloatArray:
    """Return the matrix that turns (x, y, 1) on the map's ground into homogeneous pixels."""
    lens, axes = view.intrinsics, view.rotation
    camera = np.array(lens.k()).reshape(3, 3)
    matrix: FloatArray = camera @ np.column_stack([axes[:, 0], axes[:, 1], -axes @ view.position_m])
    return matrix


def _road_ahead(lens: Intrinsics, mounting: Mounting) -> Mask:
    """Return the pixels that show flat ground near the VUT, ahead."""
    u, v = np.meshgrid(np.arange(lens.width_px), np.arange(lens.height_px))
    right, down = (u - lens.cx_px) / lens.fx_px, (v - lens.cy_px) / lens.fy_px
    axes = optical_axes(mounting.pitch_down_rad, mounting.yaw_left_rad, mounting.roll_right_rad)
    ahead, left, up = (right * axes[0, k] + down * axes[1, k] + axes[2, k] for k in range(3))
    falls = up < -1e-6
    reach = mounting.height_m / np.where(falls, -up, 1.0)
    ahead_m, left_m = reach * ahead, reach * left
    near = (ahead_m > 0.0) & (ahead_m < _REACH_M) & (np.abs(left_m) < _HALF_WIDTH_M)
    return np.asarray(falls & near, np.bool_)


def _box(footage: Footage, index: int, object_id: str, grow_px: int = 0) -> Mask:
    """Return the pixels of an object's projected box, grown on all sides."""
    mask = np.zeros(footage.grey[index].shape, np.bool_)
    state = footage.moments[index].states.get(object_id)
    box = None if state is None else shown_box(footage.view(index), state)
    if box is not None:
        left, top, right, bottom = (round(edge) for edge in box)
        rows = slice(max(0, top - grow_px), bottom + 1 + grow_px)
        mask[rows, max(0, left - grow_px) : right + 1 + grow_px] = True
    return mask
