"""Models as points with labels, placed so that none lies on another."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.transforms import Bbox

from ssp_eval.figures.style import (
    COLUMN_IN,
    GREY,
    LINE_IN,
    PAGE_IN,
    Look,
    Sheet,
    fitted,
    legend_height_in,
    mark,
    mark_legend,
    names_in,
    text_width_in,
    widest_in,
)

Point = tuple[float, float]

# Sixteenths of a turn: right, left, above and below first.
_DIRECTIONS = (0, 8, 4, 12, 2, 14, 6, 10, 1, 15, 7, 9, 3, 13, 5, 11)
_DISTANCES_IN = (0.07, 0.11, 0.16, 0.22, 0.3, 0.4, 0.52)
_CLEARANCE_IN = 0.012


def around(centre: Point, width: float, height: float) -> Bbox:
    """Return the rectangle of this size with its middle there."""
    return Bbox.from_bounds(centre[0] - width / 2, centre[1] - height / 2, width, height)


def place_labels(
    points: Sequence[Point],
    sizes: Sequence[Point],
    bounds: Bbox,
    marker_in: float,
    obstacles: Sequence[Bbox] = (),
) -> list[Point] | None:
    """Return label centres beside their points, off all markers and each other, within bounds.

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
        return -sum(1.0 / (0.02 + math.dist(points[index], other)) for other in points)

    placed: dict[int, Point] = {}
    boxes = [*obstacles, *(around(point, marker_in, marker_in) for point in points)]
    for index in sorted(range(len(points)), key=lambda i: (crowd(i), i)):
        free = [
            place
            for place in _places(points[index], sizes[index])
            if _covers(bounds, box := around(place, *sizes[index]))
            and not box.count_overlaps(boxes)
        ]
        if not free:
            return None
        # One that can't be taken for another point's, if there is any.
        clear = (
            place
            for place in free
            if not ambiguous(points[index], points, around(place, *sizes[index]))
        )
        placed[index] = next(clear, free[0])
        width, height = sizes[index]
        boxes.append(around(placed[index], width + 2 * _CLEARANCE_IN, height + 2 * _CLEARANCE_IN))
    return [placed[index] for index in range(len(points))]


def _covers(bounds: Bbox, box: Bbox) -> bool:
    left, bottom, right, top = bounds.extents
    return bool(left <= box.x0 and bottom <= box.y0 and box.x1 <= right and box.y1 <= top)


def _places(point: Point, size: Point) -> Iterator[Point]:
    """Yield the middles of a label about its point, the nearest first."""
    for distance in _DISTANCES_IN:
        for k in _DIRECTIONS:
            angle = 2 * math.pi * k / 16
            dx, dy = math.cos(angle), math.sin(angle)
            # The label's near border, not its middle, is that far from the point.
            yield (
                point[0] + distance * dx + size[0] / 2 * _sign(dx),
                point[1] + distance * dy + size[1] / 2 * _sign(dy),
            )


def _sign(value: float) -> float:
    return 0.0 if abs(value) < 0.2 else math.copysign(1.0, value)


def ambiguous(point: Point, points: Sequence[Point], label: Bbox) -> bool:
    """Return True where a label lies about as near to another point as to its own."""
    own = _apart(point, label)
    return any(other != point and _apart(other, label) < own + 0.06 for other in points)


def _apart(point: Point, box: Bbox) -> float:
    dx = max(box.x0 - point[0], 0.0, point[0] - box.x1)
    dy = max(box.y0 - point[1], 0.0, point[1] - box.y1)
    return math.hypot(dx, dy)


def spread(places: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Return the places moved apart to at least this gap, as little as possible, within limits.

    Args:
        places: any order; the result has the same.
        gap: between neighbours; smaller where there is no room for it.
        low: least place of the result.
        high: largest place of the result.
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
            ideal_starts = [places[m] - gap * k for k, m in enumerate(members)]
            start = sum(ideal_starts) / len(ideal_starts)
            start = min(max(start, low), high - gap * (len(members) - 1))
        blocks.append((min(start, high - gap * (len(members) - 1)), members))
    result = [0.0] * len(places)
    for start, members in blocks:
        for k, index in enumerate(members):
            result[index] = start + gap * k
    return result


MOST_POINTS = 60
# With more points than this, a number stands for a name.
_MOST_NAMED = 12
_PLOT_IN, _LEFT_IN, _FOOT_IN = 2.75, 0.5, 0.4
_MARKER_IN, _TEXT_IN, _NOTE_IN = 0.085, 0.105, 0.16
_NAME_IN = 1.25
_FAR_IN = 0.12  # a label farther off than this is led to its point


def cloud(
    points: Mapping[str, Point],
    looks: Mapping[str, Look],
    kinds: Mapping[str, str],
    set_up: Callable[[Axes], Sequence[Point]],
    thick: Collection[str] = (),
    note: str = "",
) -> tuple[Sheet, dict[str, str]] | None:
    """Return a square plot of named points.

    Args:
        points: by model, in the axes' units; numbers follow this order.
        looks: by kind, in the order of the legend; one kind alone needs none.
        kinds: by model, its key in ``looks``.
        set_up: gives the axes limits, names and what lies under the points; returns the corners of
            a line, upright and level in turn, that labels keep off.
        thick: models whose marks get a thick border.
        note: a line at the bottom of the sheet; empty: none.

    Returns:
        The sheet and the models' names as shown; None where labels would lie on one another.
    """
    names = names_in(points, _NAME_IN)
    for numbered in (False, True):
        if not numbered and len(points) > _MOST_NAMED:
            continue
        texts = [str(k) for k in range(1, len(points) + 1)] if numbered else list(names.values())
        sheet, axes = _sheet(names, looks, numbered, note)
        line = [_inches(axes, sheet, corner) for corner in set_up(axes)]
        spots = [_inches(axes, sheet, point) for point in points.values()]
        sizes = [(text_width_in(text) + 0.01, _TEXT_IN) for text in texts]
        bounds = Bbox.from_extents(0.02, 0.02, _PLOT_IN + 0.14, _PLOT_IN)
        places = place_labels(
            spots, sizes, bounds, _MARKER_IN, [_around_line(a, b) for a, b in pairwise(line)]
        )
        if places is None:
            continue
        for model, point in points.items():
            look = looks[kinds[model]]
            border = 1.2 if model in thick else 0.4
            mark(axes, point, look, f"point-{model}", markeredgewidth=border, markersize=5.5)
        page = sheet.page()
        for model, text, spot, place in zip(points, texts, spots, places, strict=True):
            led = ambiguous(spot, spots, around(place, text_width_in(text), _TEXT_IN))
            _label(page, _top_in(axes, sheet), model, text, spot, place, led)
        if numbered:
            _list(page, _top_in(axes, sheet), names)
        return sheet, names
    return None


def _sheet(
    names: Mapping[str, str], looks: Mapping[str, Look], numbered: bool, note: str
) -> tuple[Sheet, Axes]:
    """Return a sheet of one column, or a wider one with room for a list beside the plot."""
    width_in = COLUMN_IN
    if numbered:
        columns = -(-len(names) // _per_column())
        width_in = min(PAGE_IN, COLUMN_IN + 0.1 + columns * _list_column_in(names))
    legend = list(looks) if len(looks) > 1 else []
    head_in = (legend_height_in(legend, width_in) if legend else 0.0) + 0.08
    sheet = Sheet(width_in, head_in + _PLOT_IN + _FOOT_IN + (_NOTE_IN if note else 0.0))
    if note:
        text = fitted(note, width_in - 0.1)
        sheet.page().text(0.05, sheet.height_in - 0.06, text, color=GREY)
    if legend:
        mark_legend(sheet, looks, 0.11)
    return sheet, sheet.axes(_LEFT_IN, head_in, _PLOT_IN, _PLOT_IN)


def _top_in(axes: Axes, sheet: Sheet) -> float:
    """Return where the plot begins below the sheet's upper border."""
    return float(sheet.height_in * (1.0 - axes.get_position().y1))


def _around_line(a: Point, b: Point) -> Bbox:
    return Bbox.from_extents(*map(min, a, b), *map(max, a, b)).padded(0.01)


def _per_column() -> int:
    return int(_PLOT_IN / LINE_IN)


def _list_column_in(names: Mapping[str, str]) -> float:
    return widest_in(names.values()) + text_width_in("00 ") + 0.12


def _inches(axes: Axes, sheet: Sheet, point: Point) -> Point:
    """Return where a point lies within the axes' frame, from its lower left corner."""
    dpi = sheet.figure.dpi
    frame = axes.get_window_extent()
    u, v = axes.transData.transform(point)
    return float(u - frame.x0) / dpi, float(v - frame.y0) / dpi


def _label(
    page: Axes, top_in: float, model: str, text: str, spot: Point, place: Point, led: bool
) -> None:
    def on_page(at: Point) -> Point:
        return _LEFT_IN + at[0], top_in + _PLOT_IN - at[1]

    half = text_width_in(text) / 2
    near = (
        min(max(spot[0], place[0] - half), place[0] + half),
        min(max(spot[1], place[1] - _TEXT_IN / 2), place[1] + _TEXT_IN / 2),
    )
    if led or max(abs(near[0] - spot[0]), abs(near[1] - spot[1])) > _FAR_IN:
        ends = [on_page(spot), on_page(near)]
        page.plot(*zip(*ends, strict=True), color=GREY, linewidth=0.4, zorder=2)
    page.text(*on_page(place), text, ha="center", va="center", gid=f"label-{model}", zorder=4)


def _list(page: Axes, top_in: float, names: Mapping[str, str]) -> None:
    for index, (model, name) in enumerate(names.items()):
        column, row = divmod(index, _per_column())
        x = COLUMN_IN + 0.1 + column * _list_column_in(names) + text_width_in("00")
        y = top_in + (row + 0.5) * LINE_IN
        page.text(x, y, str(index + 1), ha="right", va="center_baseline", color=GREY)
        page.text(x + 0.06, y, name, va="center_baseline", gid=f"name-{model}")


def numbers_used(sheet: Sheet) -> bool:
    """Return True where numbers stand for names, which the caption must say."""
    return sheet.width_in > COLUMN_IN


def share_limits(values: Sequence[float]) -> tuple[float, float]:
    """Return the ends of an axis that shows scores as large as can be, in tenths within 0 to 1."""
    low = max(0.0, math.floor(min(values) * 10 - 0.5) / 10)
    high = min(1.0, math.ceil(max(values) * 10 + 0.5) / 10)
    while high - low < 0.4 - 1e-9:
        low, high = max(0.0, low - 0.1), min(1.0, high + 0.1)
    return round(low, 1), round(high, 1)


def share_axis_near(
    axes: Axes, side: Literal["x", "y"], name: str, values: Sequence[float]
) -> None:
    """Set up an axis of a score, on the part of 0 to 1 where the values lie."""
    low, high = share_limits(values)
    step = 0.1 if high - low <= 0.6 + 1e-9 else 0.2
    ticks = [round(low + step * k, 1) for k in range(int((high - low) / step + 1e-9) + 1)]
    limits = (low - 0.012, high + 0.012)
    if side == "x":
        axes.set_xlim(limits)
    else:
        axes.set_ylim(limits)
    axis = axes.xaxis if side == "x" else axes.yaxis
    axis.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    axis.set_label_text(name)
    axis.labelpad = 2
    axis.grid(True)


def steps_of(front: Sequence[Point], low: Point) -> list[Point]:
    """Return the border of the area without points, right of and above a front.

    Args:
        front: from left to right.
        low: where the border begins at the left and ends at the bottom.
    """
    corners: list[Point] = [(low[0], front[0][1])]
    for before, after in pairwise(front):
        corners += [before, (before[0], after[1])]
    return [*corners, front[-1], (front[-1][0], low[1])]
