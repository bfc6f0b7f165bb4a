"""Lanes that end beside another one: how a vehicle leaves them, and what is no place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.compile.area import OperatingArea
from ssp_scenario_manager.compile.choose import NoBlockChosen
from ssp_scenario_manager.compile.compiler import Request, compile_task, load_area
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.maps.lane_ends import MOVES_OVER_M, with_lane_ends
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.routes import routes_of, with_routes
from ssp_scenario_manager.run.in_process import run_in_process
from ssp_scenario_manager.scenarios.base import CannotPlace
from tests.support.events.junctions import made as realised
from tests.support.events.junctions import way_of

Made = Any
Words = Any
_LANE_M = 3.5
_TAPER_M = 60.0
END = "end of road 1 [0-{:g} m] forward lane -2"
GOES_ON = (
    "junction end of road 1 [0-200 m] forward lane -2: road 1 [0-200 m] forward [to lane -2's end]"
    " > road 1 [0-200 m] forward beside lane -2's end lane -1 > road 1 [200-500 m] forward"
)


def lane_drop(
    made: Made, words: Words, end_m: float = 200.0, *, ends: bool = True, reopens: bool = False
) -> Path:
    """A road of 500 m with a lane each way, and one more up to where it narrows to nothing."""
    taper = f'<width sOffset="0" a="{_LANE_M}" b="{-_LANE_M / _TAPER_M}"/>'
    own = words.lane(-1)
    second = words.lane(-2) if ends else ""
    sections = words.section(words.lane(1), own + second)
    sections += words.section(words.lane(1), own + (words.lane(-2, taper) if ends else ""), end_m)
    again = words.lane(-2) if reopens else ""
    sections += words.section(words.lane(1), own + again, end_m + _TAPER_M)
    path: Path = made.road("1", 500.0, sections=sections).write()
    return path


def ground(path: Path) -> OperatingArea:
    area = load_area(None, path)[0]
    return replace(area, library=with_routes(area.library))


def test_a_vehicle_leaves_the_lane_that_ends_for_the_vuts(made: Made, words: Words) -> None:
    area = ground(lane_drop(made, words))
    found = realised(load_event("merge")[0], area, GOES_ON)
    run = found.task.run.model_copy(update={"camera": None})
    result, record = run_in_process(run)
    assert result.verdict is Verdict.VALID, result.reasons
    assert (result.passing.relation, result.passing.other_first) == ("merge", True)
    # The road lies along x, its lane -1 in the middle of -1.75 m, the one that ends at -5.25 m.
    track = np.array([(s.x_m, s.y_m) for s in record.truths("ot1")])
    assert track[0, 1] == pytest.approx(-1.5 * _LANE_M, abs=0.01)
    way = way_of(run)
    assert np.abs(way[way[:, 0] > 200.0, 1] + 0.5 * _LANE_M).max() < 0.01
    assert way[-1, 0] > 250.0
    off_m = track[:, 1] - np.interp(track[:, 0], way[:, 0], way[:, 1])
    assert np.abs(off_m).max() < 0.2
    assert track[-1, 1] > -_LANE_M
    # Both arms and the ways between them are drawn, one arm with the lane that ends.
    assert sorted(len(one.lanes) for one in run.road.junction) == [1, 2, 2, 3]
    steady = run.driver.model_copy(update={"reacts": False})
    result, _ = run_in_process(run.model_copy(update={"driver": steady}))
    assert any("collision: ot1" in reason for reason in result.reasons)


def test_both_routes_join_in_the_lane_that_goes_on(made: Made, words: Words) -> None:
    routes, _ = routes_of(with_lane_ends(load_library(lane_drop(made, words))))
    (on,) = (one for one in routes if one.block_id == GOES_ON)
    assert on.passage is not None
    assert on.passage.end_s_m - on.passage.start_s_m == pytest.approx(MOVES_OVER_M, abs=0.01)
    (conflict,) = on.passage.conflicts
    assert (conflict.kind, conflict.comes_from) == ("merge", "right")
    assert on.passage.start_s_m < conflict.s_m < on.passage.end_s_m
    (other,) = (one for one in routes if one.block_id == conflict.route)
    (back,) = (one for one in (other.passage.conflicts if other.passage else ()))
    assert (back.kind, back.comes_from, back.route) == ("merge", "left", GOES_ON)


def test_the_vut_doesnt_come_from_the_lane_that_ends(made: Made, words: Words) -> None:
    shipped = load_event("merge")[0]
    from_left = {"dominant_motion": "cutting_in_from_left"}
    interaction = shipped.interaction.model_copy(update=from_left)
    left = shipped.model_copy(update={"interaction": interaction})
    over = GOES_ON.replace(" beside lane -2's end lane -1", " from lane -2 lane -2")
    said = r"the lane of one bends by 0\.000 1/m, and the VUT's by 0\.009 1/m: .* lane that ends"
    with pytest.raises(CannotPlace, match=said):
        realised(left, ground(lane_drop(made, words)), over)


@pytest.mark.parametrize(
    ("end_m", "reopens", "said"),
    [
        (49.0, False, "its road has 49 m; a vehicle needs 50 m to leave it"),
        (200.0, True, "lane -2 of road 1 [260-500 m] forward begins 60 m on, so that it may go on"),
    ],
)
def test_what_is_no_place_is_left_out_with_its_quantity(
    made: Made, words: Words, end_m: float, reopens: bool, said: str
) -> None:
    library = with_lane_ends(load_library(lane_drop(made, words, end_m, reopens=reopens)))
    reasons = dict(library.rejected)
    assert said in reasons[END.format(end_m)]
    assert not [block for block in library.blocks if block.junction]


def test_a_lane_that_ends_alone_is_no_place(made: Made, words: Words) -> None:
    """The outermost of two lanes that end has only the other one beside it."""
    taper = f'<width sOffset="0" a="{_LANE_M}" b="{-_LANE_M / _TAPER_M}"/>'
    lanes = [
        words.lane(-1) + words.lane(-2, width) + words.lane(-3, width) for width in (3.5, taper)
    ]
    sections = words.section("", lanes[0]) + words.section("", lanes[1], 200.0)
    sections += words.section("", words.lane(-1), 260.0)
    library = with_lane_ends(load_library(made.road("1", 500.0, sections=sections).write()))
    reasons = dict(library.rejected)
    assert reasons["end of road 1 [0-200 m] forward lane -3"] == "no lane beside it goes on"
    assert {b.junction for b in library.blocks if b.junction} == {END.format(200)}


def test_deleting_the_lane_that_ends_refuses_it(made: Made, words: Words) -> None:
    path = lane_drop(made, words, ends=False)
    with pytest.raises(NoBlockChosen, match="segment straight, needs junction"):
        compile_task(Request(event="merge", target="sumo", map_path=path))
