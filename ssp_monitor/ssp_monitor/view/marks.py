"""Marks on a map as plain values: what a marker message is made of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from ssp_core.geometry import Pose2
from ssp_core.run_file.values import Point

ORIGIN = Pose2(0.0, 0.0, 0.0)


class Shape(IntEnum):
    """Shapes by the numbers of visualization_msgs/Marker."""

    CUBE = 1
    CYLINDER = 3
    LINE_STRIP = 4
    TEXT = 9


@dataclass(frozen=True, slots=True)
class Colour:
    """Red, green, blue and opacity, 0 to 1."""

    red: float
    green: float
    blue: float
    alpha: float = 1.0


@dataclass(frozen=True, slots=True)
class Mark:
    """One mark in frame map.

    Args:
        space: with ``number`` it names the mark; a later one of that name replaces it.
        shape: what it looks like.
        at: of the middle of a shape; points of a line are in frame map itself.
        z_m: height of that middle, and of a line, over the ground.
        size_m: x, y and z in the mark's own frame; a line's width is the first, a text's height
            the last.
        points: of a line.
        text: of a text.
    """

    space: str
    number: int
    shape: Shape
    colour: Colour
    at: Pose2 = ORIGIN
    z_m: float = 0.0
    size_m: tuple[float, float, float] = (1.0, 1.0, 1.0)
    points: tuple[Point, ...] = ()
    text: str = ""


@dataclass(frozen=True, slots=True)
class Gone:
    """The mark of this name is to disappear."""

    space: str
    number: int


def line(
    space: str,
    number: int,
    points: Sequence[Point],
    colour: Colour,
    width_m: float,
    z_m: float = 0.02,
    *,
    closed: bool = False,
) -> Mark:
    """A line through points, in their order; back to the first one where it is closed."""
    all_points = (*points, points[0]) if closed else tuple(points)
    return Mark(
        space,
        number,
        Shape.LINE_STRIP,
        colour,
        z_m=z_m,
        size_m=(width_m, 0.0, 0.0),
        points=all_points,
    )


def text(space: str, number: int, words: str, at: Point, z_m: float, colour: Colour) -> Mark:
    """A text that faces whoever looks."""
    place = Pose2(at[0], at[1], 0.0)
    return Mark(space, number, Shape.TEXT, colour, place, z_m, (0.0, 0.0, 0.9), text=words)


def circle(centre: Point, radius_m: float, corners: int = 32) -> tuple[Point, ...]:
    """A circle as an outline that isn't closed."""
    angles = [2.0 * math.pi * k / corners for k in range(corners)]
    return tuple(
        (centre[0] + radius_m * math.cos(a), centre[1] + radius_m * math.sin(a)) for a in angles
    )
