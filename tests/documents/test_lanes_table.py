"""The shipped events on roads of other numbers of lanes, as docs/compile.md tells them.

Each possible cell is compiled, exported and run once. A test run takes the corners of the table;
``SSP_WHOLE_TABLE=1 ./ssp test tests/documents/test_lanes_table.py`` takes all of it.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from ssp_core.errors import InputError
from ssp_core.vocabulary import Verdict
from ssp_eval.recordings.source_clip import board_of
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.compile.targets.folder import write_target
from ssp_scenario_manager.compile.targets.opendrive import opendrive_map
from ssp_scenario_manager.event_spec.load import load_event, seal_event, seals, write_event
from ssp_scenario_manager.event_spec.other_lanes import with_lanes
from ssp_scenario_manager.run.in_process import run_in_process
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from tests.support.events.blocks import block_of

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "compile.md").read_text()
# A straight road with any lanes has no junction.
EVENTS = tuple(sorted(name for name, kind in KINDS.items() if not kind.at_junction))
SAME, OPPOSITE = range(1, 5), range(5)
Cell = tuple[str, int, int]
POSSIBLE: list[Cell] = [
    (name, same, opposite)
    for name in EVENTS
    for same in SAME
    for opposite in OPPOSITE
    if same >= KINDS[name].same_direction_lanes
]
CORNERS: list[Cell] = [
    ("cut_in", 2, 0),
    ("cut_in", 4, 4),
    ("lead_braking", 1, 1),
    ("slow_lead", 1, 0),
    ("cut_out", 2, 0),
    ("vru_crossing", 1, 0),
    ("vru_crossing", 4, 4),
    ("occluded_crossing", 1, 2),
]
LANE_M = 3.5


def told() -> dict[str, list[str]]:
    """The table of the docs: per event its cells for 1 to 4 lanes in the VUT's direction."""
    section = TEXT.split("### Lanes")[1].split("### ")[0]
    rows = re.findall(r"^\| `(\w+)` \|(.*)\|$", section, re.M)
    return {name: [cell.strip() for cell in cells.split("|")] for name, cells in rows}


def test_the_docs_tell_which_cells_are_possible() -> None:
    table = told()
    for name in EVENTS:
        possible = [bool(cell.startswith("0 to 4")) for cell in table[name][: len(SAME)]]
        assert possible == [(name, same, 0) in POSSIBLE for same in SAME]


@pytest.mark.parametrize("opposite", OPPOSITE)
def test_an_event_that_needs_a_lane_beside_is_not_made_without(opposite: int) -> None:
    with pytest.raises(InputError, match=rf"can't be drawn on a road of 1\+{opposite} lanes"):
        board_of(load_event("cut_in")[0], 1, (1, opposite))


@pytest.mark.parametrize(
    ("name", "same", "opposite"), POSSIBLE if os.environ.get("SSP_WHOLE_TABLE") else CORNERS
)
def test_a_possible_cell_compiles_exports_and_runs(
    name: str, same: int, opposite: int, tmp_path: Path
) -> None:
    shipped, _ = load_event(name)
    held = [path for path, seal in seals(shipped).items() if shipped.uncertainty[path].seal == seal]
    event = tmp_path / f"{name}.event.yaml"
    write_event(event, seal_event(with_lanes(shipped, same, opposite), held))
    lanes = [(LANE_M * i, i < same) for i in range(same + opposite)]
    road = tmp_path / "road.xodr"
    road.write_bytes(opendrive_map(block_of(lanes=lanes), "road", {}))
    request = Request(
        event=str(event), target="openscenario", map_path=road, choose="road 1 forward", who="A"
    )
    compiled = compile_task(request)
    (tmp_path / "out").mkdir()
    write_target(compiled, tmp_path / "out")
    result, _ = run_in_process(compiled.task.run.model_copy(update={"camera": None}))
    assert result.verdict is Verdict.VALID
