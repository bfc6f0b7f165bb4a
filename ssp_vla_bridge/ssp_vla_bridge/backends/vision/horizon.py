"""The row of the horizon, from where the lines along the road meet."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

_SKY_SHARE = 0.45  # lines of the road lie below this share of the height
_MIN_LENGTH_SHARE = 0.06
_STEEP_RAD = (0.25, 1.35)  # slopes of lines that may run along the road
_LONGEST = 24
_MIN_CROSSINGS = 4
_SPREAD_SHARE = 0.06
_PLAUSIBLE_SHARE = (0.25, 0.75)


def horizon_row(images: Sequence[NDArray[np.uint8]]) -> float | None:
    """Row in which road lines from the left and from the right meet, px; None when unclear.

    Args:
        images: of one camera, each of shape (height, width, 3).
    """
    height = images[0].shape[0]
    low, high = (share * height for share in _PLAUSIBLE_SHARE)
    rows = np.concatenate([_crossing_rows(image) for image in images])
    rows = rows[(rows > low) & (rows < high)]
    if len(rows) < _MIN_CROSSINGS:
        return None
    row = float(np.median(rows))
    spread = float(np.median(np.abs(rows - row)))
    return row if spread < _SPREAD_SHARE * height else None


def _crossing_rows(image: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Rows where each line of the left half-plane meets each of the right one, px."""
    height, width = image.shape[:2]
    top = round(_SKY_SHARE * height)
    edges = cv2.Canny(cv2.cvtColor(image[top:], cv2.COLOR_BGR2GRAY), 50, 120)
    found = cv2.HoughLinesP(
        edges, 1, math.pi / 180, 30, minLineLength=_MIN_LENGTH_SHARE * width, maxLineGap=6
    )
    if found is None:
        return np.zeros(0)
    segments = found.reshape(-1, 4).astype(np.float64)
    run, rise = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    steep = np.arctan2(np.abs(rise), np.abs(run))
    useful = (steep > _STEEP_RAD[0]) & (steep < _STEEP_RAD[1])
    order = np.argsort(-np.hypot(run, rise)[useful], kind="stable")[:_LONGEST]
    kept = segments[useful][order]
    slope = (kept[:, 3] - kept[:, 1]) / (kept[:, 2] - kept[:, 0])
    offset = kept[:, 1] - slope * kept[:, 0]
    # A line on the left of the road rises to the right: its slope in the image is negative.
    left, right = slope < 0, slope > 0
    across = slope[right][None, :] - slope[left][:, None]
    column = (offset[left][:, None] - offset[right][None, :]) / across
    rows = top + slope[left][:, None] * column + offset[left][:, None]
    return np.asarray(rows.ravel())
