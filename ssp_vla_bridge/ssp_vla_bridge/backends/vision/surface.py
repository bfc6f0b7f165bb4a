"""What the ground looks like, strip by strip along the road, and which pixels are not ground.

Roads, markings, pavements and verges run along the direction of travel, so the ground's colour is
mostly a function of the lateral position. It is taken from the near ground of all frames; a pixel
is foreign if its colour differs from every strip near its lateral position. Brighter grey or
yellow is paint, evenly darker is shadow: neither is foreign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_vla_bridge.backends.vision.ground_plane import FARTHEST_M, GroundPlane

STRIP_M = 0.1
HALF_WIDTH_M = 8.0
_LEARN_TO_M = 8.0
_LEARN_PER_ASIDE = 1.25
_MIN_PIXELS = 12
_NEIGHBOUR_STRIPS = (-1, 1, -2, 2)

_CHROMA_LEVELS = 9.0
_CHROMA_SPREADS = 3.0
_DARK_RATIO = 0.36

_NEUTRAL = np.array([0, 128, 128], np.float32)

ByteImage = NDArray[np.uint8]
Mask = NDArray[np.uint8]


@dataclass(frozen=True)
class Surface:
    """Colour of the ground per strip, in Y, Cr − 128, Cb − 128.

    Args:
        colours: shape (strips, 3), median.
        spreads: shape (strips,), spread of the chroma.
        known: shape (strips,), where anything was seen.
    """

    colours: NDArray[np.float32]
    spreads: NDArray[np.float32]
    known: NDArray[np.bool_]


def to_ycc(image: ByteImage) -> NDArray[np.float32]:
    """Y, Cr − 128, Cb − 128 as float32."""
    ycc = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)
    return np.subtract(ycc, _NEUTRAL, dtype=np.float32)


@lru_cache(maxsize=4)
def strip_index(plane: GroundPlane) -> NDArray[np.int32]:
    """Shape (height, width): the strip of each pixel, −1 outside the strips and above ground."""
    ahead = plane.row_x_m[:, None]
    inside = (np.abs(plane.lateral_m) < HALF_WIDTH_M) & (ahead < FARTHEST_M)
    lateral = np.where(inside, plane.lateral_m, 0.0)
    index = np.floor((lateral + HALF_WIDTH_M) / STRIP_M).astype(np.int32)
    return np.asarray(np.where(inside, index, -1))


def learn_surface(frames: Sequence[NDArray[np.float32]], plane: GroundPlane) -> Surface:
    """Medians over the near ground of all frames.

    Args:
        frames: as of to_ycc.
        plane: of the frames.
    """
    count = round(2 * HALF_WIDTH_M / STRIP_M)
    index = strip_index(plane)
    # Only as far as needed to see a strip at all: farther away, something stands on it.
    reach_m = _LEARN_TO_M + _LEARN_PER_ASIDE * np.abs(np.nan_to_num(plane.lateral_m))
    near = (index >= 0) & (plane.row_x_m[:, None] < reach_m)
    # Every third pixel of every third row is plenty; counted from both sides, so that a mirrored
    # picture is learned from the mirrored pixels.
    columns = np.arange(plane.width_px)
    thin = np.zeros_like(near)
    thin[::3] = np.minimum(columns, columns[::-1]) % 3 == 0
    rows, columns = np.nonzero(near & thin)
    strips = index[rows, columns]
    order = np.argsort(strips, kind="stable")
    rows, columns, strips = rows[order], columns[order], strips[order]
    bounds = np.searchsorted(strips, np.arange(count + 1))
    pixels = np.stack([frame[rows, columns] for frame in frames])
    colours = np.zeros((count, 3), np.float32)
    spreads = np.zeros(count, np.float32)
    known = np.zeros(count, bool)
    for strip in range(count):
        start, stop = bounds[strip], bounds[strip + 1]
        if stop - start < _MIN_PIXELS:
            continue
        inside = pixels[:, start:stop].reshape(-1, 3)
        colours[strip] = np.median(inside, axis=0)
        spreads[strip] = np.median(np.abs(inside[:, 1:] - colours[strip, 1:]).sum(axis=1))
        known[strip] = True
    return Surface(_filled(colours, known), _filled(spreads, known), known)


def _filled(values: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Strips that the near ground doesn't show take the nearest one that it does."""
    if not known.any():
        return values
    places = np.flatnonzero(known)
    nearest = places[np.abs(np.arange(len(known))[:, None] - places[None, :]).argmin(axis=1)]
    return np.asarray(values[nearest])


def foreign_pixels(
    frames: Sequence[NDArray[np.float32]], surface: Surface, index: NDArray[np.int32]
) -> list[Mask]:
    """Per frame, 1 where a pixel of the strips looks like none of the strips around it.

    Args:
        frames: as of to_ycc.
        surface: as learned.
        index: as of strip_index, for the frames' size.
    """
    last = len(surface.colours) - 1
    places = np.flatnonzero(index >= 0)
    strips = index.ravel()[places]
    own = _reference(surface, strips)
    masks = []
    for frame in frames:
        pixels = np.take(frame.reshape(-1, 3), places, axis=0)
        # Most pixels match their own strip, so the others are few.
        left = np.flatnonzero(_differs(pixels, own))
        for shift in _NEIGHBOUR_STRIPS:
            neighbours = _reference(surface, np.clip(strips[left] + shift, 0, last))
            left = left[_differs(pixels[left], neighbours)]
        mask = np.zeros(index.size, np.uint8)
        mask[places[left]] = 1
        masks.append(mask.reshape(index.shape))
    return masks


@dataclass(frozen=True)
class _Reference:
    """What ground is expected at some pixels."""

    inverse_luma: NDArray[np.float32]
    cr: NDArray[np.float32]
    cb: NDArray[np.float32]
    limit: NDArray[np.float32]


def _reference(surface: Surface, strips: NDArray[np.int32]) -> _Reference:
    luma, cr, cb = np.ascontiguousarray(surface.colours.T)
    limits = (_CHROMA_LEVELS + _CHROMA_SPREADS * surface.spreads).astype(np.float32)
    inverse = (1.0 / np.maximum(luma, 1.0)).astype(np.float32)
    return _Reference(inverse[strips], cr[strips], cb[strips], limits[strips])


def _differs(pixels: NDArray[np.float32], expected: _Reference) -> NDArray[np.bool_]:
    ratio = pixels[:, 0] * expected.inverse_luma
    weight = np.clip(ratio, 0.3, 1.3)
    chroma = np.abs(pixels[:, 1] - weight * expected.cr)
    chroma += np.abs(pixels[:, 2] - weight * expected.cb)
    # The light's own tint shows more on bright paint.
    return np.asarray((ratio <= _DARK_RATIO) | (chroma >= expected.limit * np.maximum(1.0, ratio)))
