"""Where labels go so that none lies on another; in inches, without any drawing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

Point = tuple[float, float]

# Sixteenths of a turn: right, left, above and below first.
_DIRECTIONS = (0, 8, 4, 12, 2, 14, 6, 10, 1, 15, 7, 9, 3, 13, 5, 11)
_DISTANCES_IN = (0.07, 0.11, 0.16, 0.22, 0.3, 0.4, 0.52)
_CLEARANCE_IN = 0.012


class Box(NamedTuple):
    """A rectangle; left < right and bottom < top."""

    left: float
    bottom: float
    right: float
    top: float

    def overlaps(self, other: Box) -> bool:
        """True where they share more than a border."""
        return (
            self.left < other.right
            and other.left < self.right
            and self.bottom < other.top
            and other.bottom < self.top
        )

    def inside(self, other: Box) -> bool:
        """True where the other covers it."""
        return (
            other.left <= self.left
            and self.right <= other.right
            and other.bottom <= self.bottom
            and self.top <= other.top
        )


def around(centre: Point, width: float, height: float) -> Box:
    """The rectangle of this size with its middle there."""
    x, y = centre
    return Box(x - width / 2, y - height / 2, x + width / 2, y + height / 2)


def place_labels(
    points: Sequence[Point],
    sizes: Sequence[Point],
    bounds: Box,
    marker_in: float,
    obstacles: Sequence[Box] = (),
) -> list[Point] | None:
    """Middles of labels beside their points: off every marker, off each other, within bounds.

    Those in the thick of it choose first, each the nearest free place.

    Args:
        points: in.
        sizes: width and height of each label, in.
        bounds: that labels must stay in.
        marker_in: diameter of a point's marker.
        obstacles: that labels must not cover either.

    Returns:
        None where not all find a place.
    """

    def crowd(index: int) -> float:
        x, y = points[index]
        return -sum(1.0 / (0.02 + math.hypot(x - u, y - v)) for u, v in points)

    placed: dict[int, Point] = {}
    taken = list(obstacles)
    for index in sorted(range(len(points)), key=lambda i: (crowd(i), i)):
        found = _free(points[index], sizes[index], bounds, points, marker_in, taken)
        if found is None:
            return None
        placed[index] = found
        width, height = sizes[index]
        taken.append(around(found, width + 2 * _CLEARANCE_IN, height + 2 * _CLEARANCE_IN))
    return [placed[index] for index in range(len(points))]


def ambiguous(point: Point, points: Sequence[Point], label: Box) -> bool:
    """True where a label lies about as near to another point as to its own."""
    own = _apart(point, label)
    return any(other != point and _apart(other, label) < own + 0.06 for other in points)


def _apart(point: Point, box: Box) -> float:
    dx = max(box.left - point[0], 0.0, point[0] - box.right)
    dy = max(box.bottom - point[1], 0.0, point[1] - box.top)
    return math.hypot(dx, dy)


def _free(
    point: Point,
    size: Point,
    bounds: Box,
    points: Sequence[Point],
    marker_in: float,
    taken: Sequence[Box],
) -> Point | None:
    """The nearest free place, one that can't be taken for another point's if there is any near."""
    markers = [around(other, marker_in, marker_in) for other in points]
    unclear: Point | None = None
    for distance in _DISTANCES_IN:
        for k in _DIRECTIONS:
            angle = 2 * math.pi * k / 16
            dx, dy = math.cos(angle), math.sin(angle)
            # The label's near border, not its middle, is that far from the point.
            centre = (
                point[0] + distance * dx + size[0] / 2 * _sign(dx),
                point[1] + distance * dy + size[1] / 2 * _sign(dy),
            )
            box = around(centre, *size)
            if not box.inside(bounds) or any(box.overlaps(b) for b in (*markers, *taken)):
                continue
            if not ambiguous(point, points, box):
                return centre
            unclear = unclear or centre
    return unclear


def _sign(value: float) -> float:
    return 0.0 if abs(value) < 0.2 else math.copysign(1.0, value)


def spread(places: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """The places moved apart to at least this gap, as little as that takes, within low and high.

    Args:
        places: any order; the result has the same.
        gap: between neighbours; smaller where there is no room for it.
        low, high: ends.
    """
    if not places:
        return []
    if len(places) > 1:
        gap = min(gap, (high - low) / (len(places) - 1))
    order = sorted(range(len(places)), key=lambda i: (places[i], i))
    # Blocks of touching labels, each about the mean of where its members want to be.
    blocks: list[tuple[float, list[int]]] = []
    for index in order:
        start, members = min(max(places[index], low), high), [index]
        while blocks and blocks[-1][0] + gap * len(blocks[-1][1]) > start:
            before = blocks.pop()[1]
            members = before + members
            wanted = [places[m] - gap * k for k, m in enumerate(members)]
            start = sum(wanted) / len(wanted)
            start = min(max(start, low), high - gap * (len(members) - 1))
        blocks.append((min(start, high - gap * (len(members) - 1)), members))
    result = [0.0] * len(places)
    for start, members in blocks:
        for k, index in enumerate(members):
            result[index] = start + gap * k
    return result
