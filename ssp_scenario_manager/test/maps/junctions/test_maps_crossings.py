"""Marked crossings of OpenDRIVE roads: where they lie, and what they cross."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pytest

from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.crossings import Crossing
from ssp_scenario_manager.maps.load import load_library

Made = Any
Words = Any


def zebra(
    s: float,
    t: float = 0.0,
    corners: Sequence[tuple[float, float]] = (),
    *,
    on_road: bool = False,
    more: str = "",
) -> str:
    """A crosswalk; its corners are in its own frame, or along and beside the road."""
    tag, names = ("cornerRoad", "st") if on_road else ("cornerLocal", "uv")
    points = "".join(f'<{tag} {names[0]}="{a}" {names[1]}="{b}"/>' for a, b in corners)
    outline = f"<outlines><outline>{points}</outline></outlines>" if corners else ""
    return f'<object type="crosswalk" id="1" s="{s}" t="{t}" {more}>{outline}</object>'


def box(low: float, high: float, right: float, left: float) -> list[tuple[float, float]]:
    return [(low, right), (high, right), (high, left), (low, left)]


def forward(made: Made, objects: str, **road: Any) -> Block:
    library = load_library(made.road(objects=objects, **road).write())
    return next(block for block in library.blocks if block.block_id.endswith("forward"))


ALL = box(-2, 2, -3, 3)
QUARTER = math.pi / 2


@pytest.mark.parametrize(
    ("objects", "found"),
    [
        (zebra(20), [Crossing(20.0)]),
        (zebra(20, 0, more='length="3" width="7"'), [Crossing(20.0, 1.5)]),
        (zebra(20, 0, more=f'length="7" width="3" hdg="{QUARTER}"'), [Crossing(20.0, 1.5)]),
        (zebra(20, 0, box(38, 42, -3, 3)), [Crossing(60.0)]),
        (zebra(20, -9, box(58, 62, -3, 3), on_road=True), [Crossing(60.0)]),
        (zebra(20, 0, box(-3, 3, -42, -38), more=f'hdg="{QUARTER}"'), [Crossing(60.0)]),
        # Over the sidewalk alone, it crosses no lane; over one lane, not the road.
        (zebra(20, -6, box(-2, 2, -1.5, 1.5)), []),
        (zebra(20, -6, more='length="4" width="3"'), []),
        (zebra(20, -1.75, box(-2, 2, -1.5, 1.5)), [Crossing(20.0, whole=False)]),
        # Two halves with a refuge between them are one.
        (
            zebra(20, 0, box(-2, 2, -3, -1)) + zebra(20.5, 0, box(-2, 2, 1, 3)),
            [Crossing(20.25, 2.25)],
        ),
        # Half a lane farther along, they aren't.
        (
            zebra(20, 0, box(-2, 2, -3, -1)) + zebra(30, 0, box(-2, 2, 1, 3)),
            [Crossing(20.0, whole=False), Crossing(30.0, whole=False)],
        ),
        (zebra(70, 0, ALL) + zebra(20, 0, ALL), [Crossing(20.0), Crossing(70.0)]),
    ],
)
def test_the_outline_of_a_zebra_counts(made: Made, objects: str, found: list[Crossing]) -> None:
    block = forward(made, objects)
    assert len(block.crossings) == len(found)
    for one, wanted in zip(block.crossings, found, strict=True):
        assert (one.s_m, one.half_m) == pytest.approx((wanted.s_m, wanted.half_m))
        assert one.whole == wanted.whole
    marks = sorted(block.crossings_s_m)
    assert marks == pytest.approx([one.s_m for one in found if one.whole])
    areas = {a.start_s_m for a in block.conflict_areas if a.kind == "crossing" and a.end_s_m < 100}
    assert areas == {max(0.0, s - 4.0) for s in marks}
    told = [note for note in block.notes if "some of its lanes only" in note]
    assert len(told) == sum(not one.whole for one in found)


def test_an_outline_on_a_bend_is_placed_by_the_road(made: Made, words: Words) -> None:
    """Half a turn of 50 m radius: what lies 100 m to the left of its start lies at its end."""
    bend = words.at(0, 0, 0, 50 * math.pi, '<arc curvature="0.02"/>')
    corners = [(u, 100.0 + v) for u, v in box(1, 4, -3, 3)]
    block = forward(made, zebra(0, 0, corners), length=50 * math.pi, geometry=bend)
    (found,) = block.crossings
    assert found.s_m == pytest.approx(50 * math.pi - 2.5, abs=0.2)


def test_a_zebra_over_some_lanes_keeps_its_borders_in_either_direction(made: Made) -> None:
    library = load_library(made.road(objects=zebra(20, -1.75, box(-2, 2, -1.5, 1.5))).write())
    found = {b.block_id: b.zebras_m for b in library.blocks}
    assert found["road 1 forward"] == ((20.0, -3.25, -0.25),)
    assert found["road 1 backward"] == ((80.0, 0.25, 3.25),)


def test_the_other_direction_sees_the_same_zebras(made: Made) -> None:
    library = load_library(made.road(objects=zebra(20, 0, ALL) + zebra(70, 0, ALL)).write())
    marks = {b.block_id: [zebra.s_m for zebra in b.crossings] for b in library.blocks}
    assert marks == {"road 1 forward": [20.0, 70.0], "road 1 backward": [30.0, 80.0]}
