"""Draws plan, recorded path and words on a frame: after the fact, never in a model's input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from matplotlib.font_manager import FontProperties, findfont, get_font
from numpy.typing import NDArray

from ssp_eval.figures.moments import Image
from ssp_eval.figures.style import FONT, INK, ORANGE, SKY, drawable
from ssp_eval.report.projection import Ribbon

Color = tuple[int, int, int]

_LINES = 5
# Of the picture's width: height of the font, and from one line of text to the next.
_FONT_SHARE, _LINE_SHARE = 1 / 60, 1 / 42
_SHIFT = 4  # binary digits behind the point in OpenCV's coordinates
_FAR_PX = 20_000.0


@dataclass(frozen=True)
class Annotation:
    """What stands on and below one frame.

    Args:
        plan: the predicted trajectory, None: there is none to draw.
        recorded: the path that was driven, None: not known.
        corner: in the picture's upper left corner.
        lines: below the picture; those past the fifth are left out.
    """

    plan: Ribbon | None
    recorded: Ribbon | None
    corner: str
    lines: tuple[str, ...]


def _bgr(colour: str) -> Color:
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return blue, green, red


def annotated(picture: Image, what: Annotation) -> Image:
    """The picture with what belongs on it, and a strip with text below; the input stays as it is.

    Args:
        picture: BGR, of the size that the ribbons are in.
        what: to draw.
    """
    image = picture.copy()
    width = image.shape[1]
    thick = max(1, round(width / 320))
    if what.plan is not None:
        _surface(image, what.plan, thick)
    if what.recorded is not None:
        _dashes(image, what.recorded.middle, thick)
    if what.plan is not None:
        for spot in what.plan.dots:
            for radius, colour in ((1.6 * thick + 1, _bgr(INK)), (1.6 * thick, (255, 255, 255))):
                centre = _fixed([spot])[0]
                cv2.circle(
                    image, (int(centre[0]), int(centre[1])), round(radius * (1 << _SHIFT)), colour,
                    -1, cv2.LINE_AA, _SHIFT,
                )  # fmt: skip
    font_px, line_px = max(9, round(width * _FONT_SHARE)), max(12, round(width * _LINE_SHARE))
    strip = np.full((line_px * _LINES + line_px // 2, width, 3), 255, np.uint8)
    margin = max(2, width // 120)
    for number, line in enumerate(what.lines[:_LINES]):
        _write(strip, line, (margin, line_px * (number + 1)), font_px, _bgr(INK))
    box = _mask(what.corner, font_px)[0].shape[1] + 2 * margin
    image[: line_px + margin, : min(box, width)] = 255
    _write(image, what.corner, (margin, line_px), font_px, _bgr(INK))
    return np.vstack([image, strip])


def _fixed(points: Sequence[tuple[float, float]]) -> NDArray[np.int32]:
    """Points as OpenCV's whole numbers; what lies far outside is moved nearer."""
    limited = np.clip(np.asarray(points, np.float64), -_FAR_PX, _FAR_PX)
    return np.asarray(np.round(limited * (1 << _SHIFT)), np.int32)


def _surface(image: Image, plan: Ribbon, thick: int) -> None:
    if len(plan.middle) < 2:
        return
    outline = _fixed(plan.outline)
    over = image.copy()
    cv2.fillPoly(over, [outline], _bgr(SKY), cv2.LINE_AA, _SHIFT)
    cv2.addWeighted(over, 0.45, image, 0.55, 0.0, dst=image)
    cv2.polylines(image, [outline], True, (255, 255, 255), max(1, thick // 2), cv2.LINE_AA, _SHIFT)


def _dashes(image: Image, middle: Sequence[tuple[float, float]], thick: int) -> None:
    """A dashed line with a dark border, dashes of equal length in the picture."""
    points = np.clip(np.asarray(middle, np.float64), -_FAR_PX, _FAR_PX)
    if len(points) < 2:
        return
    lengths = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    dash = 5.0 * thick
    for start in np.arange(0.0, lengths[-1], 1.7 * dash):
        along = np.linspace(start, min(start + dash, lengths[-1]), 4)
        piece = np.stack([np.interp(along, lengths, points[:, k]) for k in (0, 1)], axis=1)
        ends = _fixed([(float(x), float(y)) for x, y in piece])
        for colour, width in ((_bgr(INK), thick + 2), (_bgr(ORANGE), thick)):
            cv2.polylines(image, [ends], False, colour, width, cv2.LINE_AA, _SHIFT)


@lru_cache(maxsize=512)
def _mask(text: str, size_px: int) -> tuple[NDArray[np.uint8], int]:
    """A line of text as coverage 0 to 255, and how many of its rows lie below the baseline."""
    font = get_font(findfont(FontProperties(family=FONT), fallback_to_default=False))
    font.clear()
    font.set_size(size_px, 72)
    font.set_text(drawable(text) or " ", 0.0)
    font.draw_glyphs_to_bitmap(antialiased=True)
    return np.array(font.get_image(), np.uint8), round(font.get_descent() / 64)


def _write(image: Image, text: str, baseline: tuple[int, int], size_px: int, colour: Color) -> None:
    """Text on a picture; what doesn't fit is cut off at its border."""
    mask, below = _mask(text, size_px)
    left, top = baseline[0], baseline[1] + below - mask.shape[0]
    first = max(0, -top)
    rows = min(mask.shape[0], image.shape[0] - top)
    columns = min(mask.shape[1], image.shape[1] - left)
    if rows <= first or columns <= 0:
        return
    share = mask[first:rows, :columns, None].astype(np.float64) / 255.0
    part = image[top + first : top + rows, left : left + columns]
    part[:] = np.round(part * (1.0 - share) + np.array(colour) * share).astype(np.uint8)


def wrapped(text: str, width_px: int, lines: int) -> list[str]:
    """Text in lines that fit below a picture of this width; the last one ends in an ellipsis.

    Args:
        text: of a model; line breaks count as spaces.
        width_px: of the picture.
        lines: at most so many.
    """
    size_px = max(9, round(width_px * _FONT_SHARE))
    room = width_px - 2 * max(2, width_px // 120)
    found: list[str] = []
    line = ""
    for word in text.split():
        longer = f"{line} {word}" if line else word
        if line and _mask(longer, size_px)[0].shape[1] > room:
            found.append(line)
            longer = word
        line = longer
        if len(found) == lines:
            break
    if line and len(found) < lines:
        return [*found, line]
    if found and line:
        last = found[-1]
        while last and _mask(f"{last}…", size_px)[0].shape[1] > room:
            last = last[:-1]
        found[-1] = f"{last}…"
    return found
