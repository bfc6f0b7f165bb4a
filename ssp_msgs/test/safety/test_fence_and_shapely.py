"""Fences, boxes and what boxes sweep, judged by us and by shapely.

Fences have notches and slivers down to a micrometre. Nothing may be judged differently by more than
a touch. SSP_EXPLORE=1 tries a hundred thousand fences instead of a thousand.
"""

from __future__ import annotations

import math
import os

import numpy as np
import pytest
import shapely  # type: ignore[import-untyped]  # no types

from ssp_core.geometry import Box, FloatArray, Point, Pose2, outline_problem
from ssp_core.motion.state import Size
from ssp_core.safety.fence import box_excess_m, way_excess_m

EXPLORES = bool(os.environ.get("SSP_EXPLORE"))
FENCES = 100_000 if EXPLORES else 1000
# Up to an hour where the machine has other work.
pytestmark = pytest.mark.timeout(7200 if EXPLORES else 600)
# Nearer than that is a touch, for a point; the corner of a box may be sqrt(2) times as far.
TOUCH_M = 1e-9
BOXES = 4


def outline(random: np.random.Generator) -> list[Point]:
    """A star or a rectangle, with notches cut into it and slivers added to it; most are legal."""
    if random.random() < 0.4:
        x, y = random.uniform(8.0, 40.0, 2)
        points = [(-x, -y), (x, -y), (x, y), (-x, y)]
    else:
        count = int(random.integers(4, 10))
        angles = 2.0 * math.pi * (np.arange(count) + random.uniform(0.0, 0.9, count)) / count
        reach = random.uniform(8.0, 40.0, count)
        points = list(
            zip((reach * np.cos(angles)).tolist(), (reach * np.sin(angles)).tolist(), strict=True)
        )
    for _ in range(int(random.integers(0, 4))):
        points = indented(points, random)
    turn, (east, north) = (
        random.choice([0.0, 0.5 * math.pi, random.uniform(-3.0, 3.0)]),
        (random.uniform(-500.0, 500.0, 2)),
    )
    c, s = math.cos(turn), math.sin(turn)
    points = [(c * x - s * y + east, s * x + c * y + north) for x, y in points]
    return points[::-1] if random.random() < 0.5 else points


def indented(points: list[Point], random: np.random.Generator) -> list[Point]:
    """Add a notch (or, outwards, a sliver) to one of the edges, at a random place."""
    i = int(random.integers(len(points)))
    (xa, ya), (xb, yb) = points[i - 1], points[i]
    length = math.hypot(xb - xa, yb - ya)
    ex, ey = (xb - xa) / length, (yb - ya) / length
    width = min(10.0 ** random.uniform(-6.0, 0.5), 0.4 * length)
    at, deep = random.uniform(0.3, 0.7) * length, random.uniform(-4.0, 12.0)
    lean = random.uniform(-2.0, 2.0)
    tip = [at + lean] if random.random() < 0.5 else [at + lean - width / 3, at + lean + width / 3]
    places = [(at - width / 2, 0.0), *((t, deep) for t in tip), (at + width / 2, 0.0)]
    new = [(xa + t * ex - d * ey, ya + t * ey + d * ex) for t, d in places]
    return [*points[:i], *new, *points[i:]]


def poses_near(
    fence: list[Point], size: Size, count: int, random: np.random.Generator
) -> FloatArray:
    """Poses about the outline, half of them along an edge, and some of those touching it."""
    found = []
    for _ in range(count):
        i = int(random.integers(len(fence)))
        (xa, ya), (xb, yb) = fence[i - 1], fence[i]
        t, yaw = random.uniform(), random.uniform(-math.pi, math.pi)
        aside = random.normal(0.0, 4.0)
        along = math.atan2(yb - ya, xb - xa)
        if random.random() < 0.5:
            yaw = along
            aside = random.choice([aside, 0.5 * size.width_m, -0.5 * size.width_m])
        x, y = xa + t * (xb - xa), ya + t * (yb - ya)
        found.append((x - aside * math.sin(along), y + aside * math.cos(along), yaw))
    return np.array(found)


def size_of(random: np.random.Generator) -> Size:
    return Size(*random.uniform((0.2, 0.2, 0.3), (9.0, 3.0, 2.6)), 1.5)


def area(pose: FloatArray, size: Size) -> shapely.Polygon:
    pose2 = Pose2(*pose.tolist())
    return shapely.Polygon(Box(pose2, size.front_m, size.rear_m, size.width_m).corners())


def agrees(excess_m: float, fence: shapely.Polygon, swept: shapely.Polygon) -> bool:
    """Alike, or a touch: a little smaller it is surely inside, or a little larger surely not."""
    inside = bool(fence.covers(swept))
    if (excess_m == 0.0) == inside:
        return True
    by_m = 3.0 * TOUCH_M if inside else -3.0 * TOUCH_M
    return bool(fence.covers(swept.buffer(by_m, join_style="mitre"))) != inside


def test_legal_fences_and_boxes_are_judged_alike() -> None:
    random = np.random.default_rng(26)
    seen = {"legal": 0, "illegal": 0, "inside": 0, "outside": 0, "swept out": 0}
    while seen["legal"] < FENCES:
        points = outline(random)
        fence, legal = shapely.Polygon(points), outline_problem(points) is None
        # Edges that come as near as a touch are edges that touch, for us alone.
        nearly = fence.minimum_clearance <= 2.0 * TOUCH_M
        assert legal == fence.is_valid or (nearly and not legal), points
        seen["legal" if legal else "illegal"] += 1
        if not legal:
            continue
        shapely.prepare(fence)
        size = size_of(random)
        poses = poses_near(points, size, BOXES, random)
        way = np.repeat(poses[:, None], 2, axis=1)
        # Without turning, what is swept is the hull of the boxes at both ends.
        way[:, 1, :2] += random.normal(0.0, random.choice([0.1, 1.0, 10.0]), (BOXES, 2))
        excess = way_excess_m(way[..., 0], way[..., 1], way[..., 2], size, points)
        for pose, end, (alone_m, swept_m) in zip(poses, way[:, 1], excess.tolist(), strict=True):
            box, there = area(pose, size), area(end, size)
            hull = shapely.union(box, there).convex_hull
            told = (points, pose.tolist(), end.tolist(), size, alone_m, swept_m)
            assert agrees(alone_m, fence, box), told
            assert agrees(max(alone_m, swept_m), fence, hull), told
            farthest = max(fence.distance(shapely.points(shapely.get_coordinates(box))))
            assert alone_m >= farthest - TOUCH_M, told
            seen["inside" if alone_m == 0.0 else "outside"] += 1
            seen["swept out"] += alone_m == 0.0 < swept_m
        one = Box(Pose2(*poses[0].tolist()), size.front_m, size.rear_m, size.width_m)
        assert box_excess_m(one, points) == excess[0, 0]
    assert min(seen.values()) > 0.02 * FENCES, seen


def test_a_way_that_turns_is_swept_to_a_few_millimetres() -> None:
    random = np.random.default_rng(7)
    out = 0
    for _ in range(FENCES // 10):
        points = outline(random)
        if outline_problem(points) is not None:
            continue
        fence, size = shapely.Polygon(points), size_of(random)
        (start,) = poses_near(points, size, 1, random)
        end = start + random.normal(0.0, (0.5, 0.5, 0.15))
        x, y, yaw = np.stack((start, end)).T
        excess_m = float(way_excess_m(x, y, yaw, size, points).max())
        between = [area(start + (end - start) * t, size) for t in np.linspace(0.0, 1.0, 300)]
        out += excess_m > 0.0
        if excess_m == 0.0:
            assert all(fence.covers(box.buffer(-0.005)) for box in between), (points, start, end)
        else:
            assert not all(fence.covers(box.buffer(0.005)) for box in between), (points, start, end)
    assert 0 < out < FENCES // 10


ILLEGAL: dict[str, list[Point]] = {
    "a crossing": [(0, 0), (8, 8), (8, 0), (0, 6)],
    "a corner on another edge": [(0, 0), (8, 0), (8, 8), (4, 0), (0, 8)],
    "a corner on another corner's edge": [(0, 0), (8, 0), (8, 8), (4, 4), (0, 8), (0, 4), (4, 4)],
    "a spike outwards": [(0, 0), (8, 0), (12, 0), (8, 0.0), (8, 8), (0, 8)],
    "a spike along an edge": [(0, 0), (8, 0), (8, 8), (4, 8), (6, 8), (0, 8)],
    "a spike inwards": [(0, 0), (4, 0), (4, 6), (4, -0.0), (8, 0), (8, 8), (0, 8)],
    "an end on the edge before": [(0, 0), (8, 0), (4, 0), (4, 8), (0, 8)],
    "overlapping edges": [(0, 0), (8, 0), (8, 4), (6, 4), (6, 0), (4, 0), (2, 0), (2, 4), (0, 4)],
    "nothing inside": [(0, 0), (8, 0), (4, 0)],
}


@pytest.mark.parametrize("name", ILLEGAL)
@pytest.mark.parametrize("backward", [False, True])
def test_illegal_fences_are_refused_by_both(name: str, backward: bool) -> None:
    for turn in range(len(ILLEGAL[name])):
        points = [(float(x), float(y)) for x, y in ILLEGAL[name]]
        points = points[turn:] + points[:turn]
        points = points[::-1] if backward else points
        assert outline_problem(points) is not None
        assert not shapely.Polygon(points).is_valid
