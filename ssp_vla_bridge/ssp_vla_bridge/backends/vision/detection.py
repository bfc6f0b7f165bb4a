"""The way from foreign pixels to objects on the road, with metric position and size."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_vla_bridge.backends.vision.ground import GroundPlane, Mask

_CLOSED_PX = (3, 5)
_MIN_PIXELS = 14
_MIN_HEIGHT_M = 0.7
_MIN_WIDTH_M = 0.2
_MAX_WIDTH_M = 7.0
_JOIN_ASIDE_M = 0.35
_JOIN_ABOVE_M = 0.5
_TALLEST_M = 4.5
_HIDDEN_SHARE = 0.6
_FLANK_STEP_M = 0.2
_FLANK_GAP_M = 0.12
_FLANK_COLUMNS = 3
_INSIDE_COLUMNS = 24
_WIDE_FLANK_COLUMNS = 5
_DIFFERENT_LEVELS = 26.0
_FILLED_SHARE = 0.3
_WIDE_FILLED_SHARE = 0.55
_BREAK_M = 0.25
_WIDE_M = 1.3
_WIDE_BREAK_M = 1.0
_MIN_FILL = 0.15


@dataclass(frozen=True)
class Detection:
    """Something that stands on the ground, as seen in one frame.

    Args:
        x_m: distance of its foot ahead of the camera.
        right_m: lateral position of its right edge, + is left.
        left_m: lateral position of its left edge.
        height_m: of its picture above its foot.
        fill: share of its box below the horizon that is foreign to the ground.
        box: left, top, right, bottom in the image, px, half open.
    """

    x_m: float
    right_m: float
    left_m: float
    height_m: float
    fill: float
    box: tuple[int, int, int, int]

    @property
    def y_m(self) -> float:
        """Lateral position of its centre, + is left."""
        return (self.right_m + self.left_m) / 2.0

    @property
    def width_m(self) -> float:
        return self.left_m - self.right_m


@dataclass(frozen=True)
class _Blob:
    left: int
    top: int
    right: int
    bottom: int
    pixels: int


def detect_objects(ycc: NDArray[np.float32], foreign: Mask, plane: GroundPlane) -> list[Detection]:
    """Return the things that stand on the ground, nearest first."""
    # Above the first foreign pixel, and what closing looks at around it, there is nothing to find.
    first = max(0, int(foreign.any(axis=1).argmax()) - 2 * _CLOSED_PX[1])
    closed = cv2.morphologyEx(
        foreign[first:],
        cv2.MORPH_CLOSE,
        cv2.getStructuringElement(cv2.MORPH_RECT, _CLOSED_PX),
    )
    count, _, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    blobs = [
        _Blob(int(x), first + int(y), int(x + w), first + int(y + h), int(pixels))
        for x, y, w, h, pixels in stats[1:count]
        if pixels >= _MIN_PIXELS
    ]
    blobs.sort(key=lambda blob: (-blob.bottom, blob.left))
    joined: list[_Blob] = []
    for blob in blobs:
        for place, nearer in enumerate(joined):
            if _belongs(blob, nearer, plane):
                joined[place] = _join(nearer, blob)
                break
        else:
            joined.append(blob)
    things = [t for blob in joined if (t := _thing(ycc, blob, plane)) is not None]
    things.sort(key=lambda t: (t.x_m, t.right_m))
    return [t for i, t in enumerate(things) if not any(_hidden(t, near) for near in things[:i])]


def _hidden(thing: Detection, nearer: Detection) -> bool:
    """Tell whether a piece lies in the picture of a nearer thing."""
    a, b = thing.box, nearer.box
    wide = min(a[2], b[2]) - max(a[0], b[0])
    high = min(a[3], b[3]) - max(a[1], b[1])
    area = (a[2] - a[0]) * (a[3] - a[1])
    return wide > 0 and high > 0 and wide * high > _HIDDEN_SHARE * area


def _belongs(blob: _Blob, nearer: _Blob, plane: GroundPlane) -> bool:
    """Tell whether it is a part of the same thing: beside or above it, no wider than a vehicle."""
    scale = plane.row_px_per_m[nearer.bottom - 1]
    aside = max(blob.left - nearer.right, nearer.left - blob.right)
    above = nearer.top - blob.bottom
    width = max(blob.right, nearer.right) - min(blob.left, nearer.left)
    if above > _JOIN_ABOVE_M * scale or width > 3.2 * scale:
        return False
    if aside <= 0:
        return True
    feet = nearer.bottom - blob.bottom
    return bool(aside <= _JOIN_ASIDE_M * scale and feet <= 0.3 * scale)


def _join(a: _Blob, b: _Blob) -> _Blob:
    return _Blob(
        min(a.left, b.left),
        min(a.top, b.top),
        max(a.right, b.right),
        max(a.bottom, b.bottom),
        a.pixels + b.pixels,
    )


def _thing(ycc: NDArray[np.float32], blob: _Blob, plane: GroundPlane) -> Detection | None:
    foot = min(blob.bottom - 1, plane.height_px - 1)
    scale = float(plane.row_px_per_m[foot])
    if scale <= 0.0:
        return None
    width_m = (blob.right - blob.left) / scale
    fill = blob.pixels / ((blob.right - blob.left) * (blob.bottom - blob.top))
    if not _MIN_WIDTH_M <= width_m <= _MAX_WIDTH_M or fill < _MIN_FILL:
        return None
    top = _top_row(ycc, blob, scale)
    height_m = (blob.bottom - top) / scale
    if height_m < _MIN_HEIGHT_M:
        return None
    return Detection(
        x_m=float(plane.row_x_m[foot]),
        right_m=plane.y_m(blob.right - 0.5, foot),
        left_m=plane.y_m(blob.left - 0.5, foot),
        height_m=height_m,
        fill=fill,
        box=(blob.left, top, blob.right, blob.bottom),
    )


def _top_row(ycc: NDArray[np.float32], blob: _Blob, scale: float) -> int:
    """Return the first row of the thing, followed upwards while it differs from its sides."""
    highest = max(0, round(blob.bottom - _TALLEST_M * scale))
    if blob.top <= highest:
        return blob.top
    rows = slice(highest, blob.top)
    # A few dozen columns tell as much as all of them.
    count = min(blob.right - blob.left, _INSIDE_COLUMNS)
    inside = ycc[rows, np.linspace(blob.left, blob.right - 1, count).round().astype(int)]
    wide = blob.right - blob.left > _WIDE_M * scale
    beside = _beside(ycc, blob, scale, _WIDE_FLANK_COLUMNS if wide else _FLANK_COLUMNS)[rows]
    if beside.shape[1] == 0:
        return blob.top
    # The nearest of the colours beside it, so that a busy background explains itself.
    distance = np.full(inside.shape[:2], np.inf, np.float32)
    for column in range(beside.shape[1]):
        difference = np.abs(inside - beside[:, column, None, :]).sum(axis=2)
        np.minimum(distance, difference, out=distance)
    filled = (distance > _DIFFERENT_LEVELS).mean(axis=1) >= (
        _WIDE_FILLED_SHARE if wide else _FILLED_SHARE
    )
    allowed = max(2, round((_WIDE_BREAK_M if wide else _BREAK_M) * scale))
    top, misses = blob.top, 0
    for row in range(len(filled) - 1, -1, -1):
        if filled[row]:
            top, misses = highest + row, 0
        else:
            misses += 1
            if misses > allowed:
                break
    return top


def _beside(ycc: NDArray[np.float32], blob: _Blob, scale: float, count: int) -> NDArray[np.float32]:
    """Return some columns on either side of a blob, blurred along the row, (height, n, 3)."""
    step = max(1, round(_FLANK_STEP_M * scale))
    gap = max(1, round(_FLANK_GAP_M * scale))
    columns = []
    for place in range(count):
        columns += [blob.left - gap - place * step, blob.right - 1 + gap + place * step]
    columns_inside = [column for column in columns if 0 <= column < ycc.shape[1]]
    return ycc[:, columns_inside]
