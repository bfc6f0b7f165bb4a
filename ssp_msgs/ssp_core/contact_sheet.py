"""Contact sheets: several frames on one picture, each with a line of text above it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

_MARGIN_PX = 8
_LINE_PX = 22
_BACKGROUND = 250
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True)
class Tile:
    """One frame, BGR, and the lines of text above it (ASCII; other characters become ?)."""

    image: Image
    lines: tuple[str, ...]


def contact_sheet(tiles: Sequence[Tile], columns: int, tile_width_px: int) -> Image:
    """All tiles in rows, scaled to one width with their aspect ratio kept.

    Args:
        tiles: at least one; a row is as high as its highest tile.
        columns: tiles in a row.
        tile_width_px: of each frame.

    Raises:
        ValueError: there is no tile.
    """
    if not tiles:
        raise ValueError("a contact sheet needs a frame")
    drawn = [_draw(tile, tile_width_px) for tile in tiles]
    columns = min(columns, len(drawn))
    rows = [drawn[i : i + columns] for i in range(0, len(drawn), columns)]
    width = columns * (tile_width_px + _MARGIN_PX) + _MARGIN_PX
    height = sum(max(t.shape[0] for t in row) + _MARGIN_PX for row in rows) + _MARGIN_PX
    sheet = np.full((height, width, 3), _BACKGROUND, np.uint8)
    top = _MARGIN_PX
    for row in rows:
        for i, tile in enumerate(row):
            left = _MARGIN_PX + i * (tile_width_px + _MARGIN_PX)
            sheet[top : top + tile.shape[0], left : left + tile_width_px] = tile
        top += max(t.shape[0] for t in row) + _MARGIN_PX
    return sheet


def encode(image: Image, suffix: str, quality: int = 90) -> bytes:
    """A picture as a file's bytes.

    Args:
        image: BGR.
        suffix: ``.png`` or ``.jpg``.
        quality: of a JPEG, 0 to 100.
    """
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if suffix == ".jpg" else []
    encoded, data = cv2.imencode(suffix, image, options)
    if not encoded:
        raise RuntimeError(f"OpenCV could not encode a picture as {suffix}")
    return np.asarray(data, dtype=np.uint8).tobytes()


def _draw(tile: Tile, width_px: int) -> Image:
    height, width = tile.image.shape[:2]
    size = (width_px, max(1, round(height * width_px / width)))
    grows = width_px > width
    how = cv2.INTER_CUBIC if grows else cv2.INTER_AREA
    frame = np.asarray(cv2.resize(tile.image, size, interpolation=how), dtype=np.uint8)
    head = np.full((_LINE_PX * len(tile.lines), width_px, 3), _BACKGROUND, np.uint8)
    for i, line in enumerate(tile.lines):
        text = line.encode("ascii", "replace").decode()
        at = (2, _LINE_PX * i + _LINE_PX - 6)
        cv2.putText(head, text, at, _FONT, _scale(text, width_px), (20, 20, 20), 1, cv2.LINE_AA)
    return np.vstack([head, frame])


def _scale(text: str, width_px: int) -> float:
    """The usual size, or as much smaller as the line needs to fit."""
    (needed, _), _ = cv2.getTextSize(text, _FONT, 0.55, 1)
    return 0.55 if needed <= width_px - 4 else 0.55 * (width_px - 4) / needed
