"""An export shows the session in a player: the gap to the initiator, and the goal lane."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.geometry import Pose2
from ssp_core.run_file.road import CurvePiece
from ssp_scenario_manager.compile.compiler import load_area
from ssp_scenario_manager.compile.place import Order, realise
from ssp_scenario_manager.compile.targets import openscenario
from ssp_scenario_manager.compile.targets.foreseen import foresee, gaps_m
from ssp_scenario_manager.compile.targets.goal_lane import GoalLane, goal_lane, lane_beside
from ssp_scenario_manager.compile.targets.opendrive import opendrive_map
from ssp_scenario_manager.compile.targets.openscenario import MOST_GAP_ERROR_M, export_openscenario
from ssp_scenario_manager.compile.targets.player import play
from ssp_scenario_manager.compile.task import Task, sealed
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.maps.block import Block, BlockLane
from ssp_scenario_manager.run.feasibility import driven

# A bend of 100 m all along, to the left.
BEND = [CurvePiece(length_m=400.0, start_curvature_1pm=0.01, end_curvature_1pm=0.01)]
TURNED = Pose2(512.0, -240.0, math.radians(37.0))


def lanes_of(*placed: tuple[float, float, bool]) -> tuple[BlockLane, ...]:
    """Lanes by (middle, width, forward)."""
    return tuple(BlockLane(y, w, forward, f"lane {i}") for i, (y, w, forward) in enumerate(placed))


@pytest.mark.parametrize(
    ("name", "bent"),
    [("cut_in", True), ("lead_braking", True), ("lead_braking", False), ("vru_crossing", True)],
)
def test_the_gap_is_the_sessions_all_the_time(
    name: str, bent: bool, case_of: Any, block_of: Any, tmp_path: Path
) -> None:
    """The player reads the files as they are, and agrees with esmini (docs/exports.md)."""
    case = case_of(name, block_of(BEND, TURNED) if bent else block_of())
    files = export_openscenario(case.task, case.block, None, tmp_path)
    played = play(files[0].read_bytes(), files[2].read_bytes(), case.block.line)
    run, seen = case.task.run, foresee(case.task.run)
    times = played["vut"][5::5, 0]
    error_m = gaps_m(run, played, times) - gaps_m(run, seen.tracks, times)
    assert abs(error_m).max() <= MOST_GAP_ERROR_M
    assert seen.over_s is not None
    assert times[-1] == pytest.approx(seen.over_s, abs=0.1)


@pytest.mark.parametrize("bent", [False, True])
def test_a_leader_that_leaves_its_lane_is_where_the_session_has_it(
    bent: bool, case_of: Any, block_of: Any, tmp_path: Path
) -> None:
    """It neither begins later nor loses the way by which a sine is longer than the lane."""
    case = case_of("cut_out", block_of(BEND, TURNED) if bent else block_of())
    assert most_apart_m(case.task, case.block, "ot2", tmp_path) < MOST_GAP_ERROR_M


def test_a_walker_is_where_the_session_that_adapts_its_speed_has_it(tmp_path: Path) -> None:
    """The walker is within 0.05 s of its way, so that the time gap is the session's."""
    area = load_area("boulevard", None)[0]
    event, version = load_event("vru_crossing")
    block = area.library.blocks[0]
    task = realise(Order(event, version, area, "openscenario", 1, {}), block).task
    assert task.run.triggers[0].adaptation is not None
    assert most_apart_m(sealed(task), block, "ot1", tmp_path) < 0.05 * 1.5


def most_apart_m(task: Task, block: Block, who: str, folder: Path) -> float:
    """Distances of a player's object from the session's until the scenario's end."""
    files = export_openscenario(task, block, None, folder)
    track = play(files[0].read_bytes(), files[2].read_bytes(), block.line)[who]
    states = driven(task.run)[1].truths(who)
    times = np.array([ns_to_seconds(state.stamp_ns) for state in states])
    x_m, y_m = (np.interp(times, track[:, 0], track[:, i]) for i in (1, 2))
    apart_m = np.hypot(x_m - [s.x_m for s in states], y_m - [s.y_m for s in states])
    return float(apart_m[times <= track[-1, 0]].max())


def test_a_scenario_that_shows_another_gap_is_refused(
    case_of: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(openscenario, "MOST_GAP_ERROR_M", 0.01)
    case = case_of("cut_in")
    with pytest.raises(InputError, match=r"ot1 differs by .* at most 0.01 m.*bends less"):
        export_openscenario(case.task, case.block, None, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_gap_that_the_adaptation_changed_has_that_as_its_remedy(tmp_path: Path) -> None:
    """The VUT is slower than it was planned, and the session slows the object with it."""
    area = load_area("boulevard", None)[0]
    event, version = load_event("cut_in")
    block = area.library.blocks[0]
    task = realise(Order(event, version, area, "openscenario", 1, {}), block).task
    driver = task.run.driver.model_copy(update={"cruise_mps": 0.9 * task.run.driver.cruise_mps})
    slower = task.model_copy(update={"run": task.run.model_copy(update={"driver": driver})})
    with pytest.raises(InputError, match=r"adapts the speed of ot1 to the VUT, by [-+]\d") as said:
        export_openscenario(sealed(slower), block, None, tmp_path)
    assert "bends less" not in str(said.value)


def strips(data: bytes, side: str) -> list[tuple[str, float]]:
    """(type, width) of a map's lanes from the middle outwards."""
    lanes = ET.fromstring(data).findall(f".//{side}/lane")
    ordered = sorted(lanes, key=lambda lane: abs(int(lane.get("id", ""))))
    return [(str(e.get("type")), float(e.find("width").get("a"))) for e in ordered]  # type: ignore[union-attr, arg-type]


@pytest.mark.parametrize("gap_m", [0.0, 0.1, 0.5])
def test_a_narrow_gap_widens_the_lanes_of_a_map(gap_m: float, block_of: Any) -> None:
    step = 3.2 + gap_m
    lanes = lanes_of(*((i * step, 3.2, i < 2) for i in range(4)))
    data = opendrive_map(replace(block_of(), lanes=lanes), "here", {})
    for side in ("left", "right"):
        assert "median" not in [kind for kind, _ in strips(data, side)]
        driving = [width for kind, width in strips(data, side) if kind == "driving"]
        # The outer edge stays where it is.
        assert driving == pytest.approx([3.2 + gap_m, 3.2 + gap_m / 2])


def test_a_wide_gap_stays_a_strip_that_nobody_drives_on(block_of: Any) -> None:
    lanes = lanes_of((0.0, 3.2, True), (3.8, 3.2, True), (7.0, 3.2, False))
    data = opendrive_map(replace(block_of(), lanes=lanes), "here", {})
    kinds = [kind for kind, _ in strips(data, "right")]
    assert kinds[:3] == ["driving", "median", "driving"]
    assert strips(data, "right")[1][1] == pytest.approx(0.6)
    # Players count the strip.
    assert goal_lane(data, Pose2(60.0, 3.8, 0.0), -3.8) == GoalLane(-2, 0.0)


def test_a_goal_beside_the_middle_of_its_lane_says_so(block_of: Any) -> None:
    """A lane with a gap on one side becomes wider there, and its middle moves."""
    lanes = lanes_of((0.0, 3.5, True), (3.8, 3.5, True), (7.3, 3.5, False))
    data = opendrive_map(replace(block_of(), lanes=lanes), "here", {})
    # 0.3 m between both: each has half of it, and the middle moves by a quarter.
    assert goal_lane(data, Pose2(60.0, 3.8, 0.0), -3.8) == GoalLane(-1, pytest.approx(-0.075))
    there = lane_beside(data, Pose2(60.0, 3.8, 0.0), -1)
    assert (there.shift_m, there.along) == (pytest.approx(-3.8 + 0.075), 1)


RIGHT = '<lane id="{}" type="{}"><width sOffset="0" a="{}" b="0" c="0" d="0"/></lane>'
ROAD = (
    '<OpenDRIVE><header revMajor="1" revMinor="7"/><road id="1" length="400" junction="-1">'
    '<planView><geometry s="0" x="0" y="0" hdg="0" length="400"><line/></geometry></planView>'
    "<lanes><laneSection s='0'><left>{}</left><center><lane id='0' type='none'/></center>"
    "<right>{}</right></laneSection></lanes></road></OpenDRIVE>"
)


def road(*right: tuple[str, float]) -> bytes:
    """A map with lanes of (type, width) on the right, outwards, and one on the left."""
    lanes = [RIGHT.format(-i, kind, width) for i, (kind, width) in enumerate(right, 1)]
    return ROAD.format(RIGHT.format(1, "driving", 3.5), "".join(lanes)).encode()


PLAIN = (("driving", 3.5), ("driving", 3.5))


@pytest.mark.parametrize(
    ("right", "shift_m", "ids"),
    [
        (PLAIN, -3.5, -1),
        ((PLAIN[0], ("driving", 0.0), PLAIN[1]), -3.5, -2),
        ((PLAIN[0], ("median", 0.2), ("border", 0.0), PLAIN[1]), -3.7, -3),
    ],
)
def test_lane_ids_are_counted_whatever_lies_between(
    right: Sequence[tuple[str, float]], shift_m: float, ids: int
) -> None:
    data, own = road(*right), Pose2(50.0, -1.75, 0.0)
    assert goal_lane(data, own, shift_m) == GoalLane(ids, 0.0)
    # Who drives the other way sees them on the other side.
    assert goal_lane(data, Pose2(50.0, -1.75, math.pi), -shift_m) == GoalLane(-ids, 0.0)
    assert lane_beside(data, own, ids).shift_m == pytest.approx(shift_m)


def test_lane_0_is_not_counted() -> None:
    data, own = road(*PLAIN), Pose2(50.0, -1.75, 0.0)
    assert goal_lane(data, own, 3.5) == GoalLane(1, 0.0)
    assert lane_beside(data, own, 1).shift_m == pytest.approx(3.5)
    back = Pose2(50.0, 1.75, 0.0)
    assert goal_lane(data, back, -7.0) == GoalLane(-2, 0.0)
    assert lane_beside(data, back, -2).shift_m == pytest.approx(-7.0)


@pytest.mark.parametrize("shift_m", [20.0, -20.0])
def test_no_lane_at_the_goal_is_refused(shift_m: float) -> None:
    with pytest.raises(InputError, match=r"has no lane 20\.00 m beside"):
        goal_lane(road(*PLAIN), Pose2(50.0, -1.75, 0.0), shift_m)
