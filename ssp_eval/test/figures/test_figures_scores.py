"""The layout that figures compute before they draw: fronts, places of labels, names, pages."""

from __future__ import annotations

import itertools
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.transforms import Bbox

from ssp_eval.figures.cloud import around, place_labels, spread
from ssp_eval.figures.scores import pareto_front
from ssp_eval.figures.style import names_in, pages_of, text_width_in
from tests.support.score_rows import MANY

coarse = st.integers(0, 6).map(lambda k: k / 6)


@given(st.lists(st.tuples(coarse, coarse), max_size=12))
def test_the_pareto_front_is_that_of_brute_force(found):
    points = {f"m{k:02d}": point for k, point in enumerate(found)}
    wanted = {
        name
        for name, (x, y) in points.items()
        if not any(u >= x and v >= y and (u, v) != (x, y) for u, v in points.values())
    }
    front = pareto_front(points)
    assert set(front) == wanted
    assert len(front) == len(wanted)
    assert [points[name][0] for name in front] == sorted(points[name][0] for name in front)


def test_a_last_digit_brings_nobody_to_the_front():
    thirds = (1 / 9 + 5 / 9) / 2, (3 / 9 + 3 / 9) / 2
    assert pareto_front({"a": (min(thirds), 0.9), "b": (max(thirds) + 1e-16, 0.1)}) == ["a"]


@given(st.lists(st.floats(0.0, 10.0), min_size=1, max_size=20))
def test_spread_keeps_order_gap_and_ends(places):
    gap = 0.3
    moved = spread(places, gap, 0.0, 10.0)
    order = sorted(range(len(places)), key=lambda i: (places[i], i))
    ordered = [moved[i] for i in order]
    assert all(b - a >= gap - 1e-9 for a, b in itertools.pairwise(ordered))
    assert min(moved) >= -1e-9
    assert max(moved) <= 10.0 + 1e-9


def test_spread_leaves_alone_what_is_far_apart_and_squeezes_what_has_no_room():
    assert spread([3.0, 1.0, 2.0], 0.5, 0.0, 4.0) == [3.0, 1.0, 2.0]
    assert spread([1.0, 1.0], 0.5, 0.0, 4.0) == pytest.approx([0.75, 1.25])
    assert spread([1.0] * 5, 1.0, 0.0, 2.0) == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0])
    assert spread([], 1.0, 0.0, 2.0) == []


@settings(max_examples=60)
@given(st.lists(st.tuples(st.floats(0.1, 2.6), st.floats(0.1, 2.6)), min_size=1, max_size=25))
def test_placed_labels_lie_on_no_marker_and_on_no_other(points):
    bounds, size = Bbox.from_extents(0.0, 0.0, 2.7, 2.7), (0.13, 0.105)
    places = place_labels(points, [size] * len(points), bounds, 0.085)
    if places is None:
        return  # a heap of points; the figure is then left out, and says so
    boxes = [around(place, *size) for place in places]
    assert all((bounds.min <= box.min).all() and (box.max <= bounds.max).all() for box in boxes)
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    assert not any(box.overlaps(around(p, 0.085, 0.085)) for box in boxes for p in points)


def test_labels_find_places_in_a_crowd():
    numbers = random.Random(3)
    points = [(numbers.uniform(0.3, 1.3), numbers.uniform(0.3, 1.3)) for _ in range(30)]
    wide, narrow = (Bbox.from_extents(0, 0, end, end) for end in (2.7, 1.0))
    assert place_labels(points, [(0.13, 0.105)] * 30, wide, 0.085) is not None
    assert place_labels([(0.5, 0.5)] * 2, [(2.0, 0.1)] * 2, narrow, 0.1) is None


@pytest.mark.parametrize("most_in", [0.3, 0.8, 1.6, 4.0])
def test_shortened_names_fit_and_stay_apart(most_in):
    names = [*MANY, "x" * 200, "x" * 199 + "y", "x" * 201]
    shown = names_in(names, most_in)
    assert list(shown) == names
    assert len(set(shown.values())) == len(names)
    if most_in > 0.5:
        assert all(text_width_in(text) <= most_in + 1e-9 for text in shown.values())
    assert all(shown[name] == name for name in names if text_width_in(name) <= most_in)


def test_characters_without_a_glyph_are_shown_as_question_marks_and_stay_apart():
    assert sorted(names_in(["模型", "車両"], 1.0).values()) == ["??", "?? (2)"]
    assert names_in(["a\nb"], 1.0) == {"a\nb": "a?b"}


def test_a_control_keeps_its_condition_where_its_name_is_too_long() -> None:
    names = [f"opencv_baseline+{end}" for end in ("repeat", "twin.control.car", "twin.without.ot1")]
    shown = names_in(names, 1.3)
    assert [shown[name].partition("+")[2] for name in names] == [n.partition("+")[2] for n in names]
    assert all(text_width_in(text) <= 1.3 and text[:3] == "ope" for text in shown.values())
    # Without room for a model's name they are cut as others are, and still told apart.
    assert len(set(names_in(names, 0.6).values())) == 3


@given(st.lists(st.integers(), max_size=30), st.integers(1, 7))
def test_pages_hold_everything_in_order_and_are_of_much_the_same_size(items, most):
    pages = [page for _, page in pages_of("name", items, most)]
    assert [item for page in pages for item in page] == items
    sizes = [len(page) for page in pages]
    assert not sizes or (max(sizes) <= most and max(sizes) - min(sizes) <= 1)
