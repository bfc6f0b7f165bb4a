"""Each later event kind, compiled on a shipped site and exported for a player and for CARLA."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from ssp_core.motion.corridor import Corridor
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.compile.targets.carla import export_carla
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from tests.support.events.places import site_of
from tests.support.events.played import shown

# test_maps_vut_turn.py and test_maps_roundabout.py have the others.
PLAYED = ("crossing_car", "cut_out", "merge", "oncoming_turn", "slow_lead")
# Nothing passes a vehicle that stands in the VUT's lane, so that there is no time gap.
STANDS = frozenset({"cut_out"})
JUNCTIONS = tuple(sorted(name for name, kind in KINDS.items() if kind.at_junction))


@pytest.mark.parametrize("name", PLAYED)
def test_a_player_has_tracks_and_time_gap_of_the_session(name: str, tmp_path: Path) -> None:
    found = compile_task(Request(event=name, target="openscenario", site=site_of(name)))
    export = shown(found.task, found.realisation.block, tmp_path)
    assert export.apart_m() < 0.3
    if name not in STANDS:
        assert export.gap_differs_s(Corridor.of) == pytest.approx(0.0, abs=0.05)


@pytest.mark.carla
@pytest.mark.parametrize("name", JUNCTIONS)
def test_carla_reads_the_roads_of_the_route(name: str, tmp_path: Path) -> None:
    """The check against CARLA's own reading of the map passes, else the export is refused."""
    found = compile_task(Request(event=name, target="carla", site=site_of(name)))
    block, plan = found.realisation.block, found.realisation.plan
    config, drawn = export_carla(found.task, block, plan, None, tmp_path)
    actors = {one["id"]: one for one in json.loads(config.read_text())["actors"]}
    route = [(at["x"], -at["y"]) for at in actors["vut"]["drive"]["route"]]
    assert found.task.run.vut.approach is not None
    assert route[-1] == pytest.approx(found.task.run.vut.approach.path[-1], abs=0.01)
    assert actors[found.task.run.initiator_id]["drive"] is None
    roads = {road.attrib["name"] for road in ET.parse(drawn).iterfind("road")}
    assert found.task.block.id in roads
    assert len(roads) > 2
