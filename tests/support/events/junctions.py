"""Events on routes over a junction, compiled route by route."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ssp_core.geometry import FloatArray
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import FollowPath
from ssp_scenario_manager.compile.area import OperatingArea
from ssp_scenario_manager.compile.compiler import load_area
from ssp_scenario_manager.compile.place import Order, Realisation, realise
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.routes import with_routes
from ssp_scenario_manager.maps.site import find_shipped

# On the shipped sites, from the west.
STRAIGHT = "junction market: west_in > west_east lanes[0] > east_out"
RIGHT_TURN = "junction market: west_in > west_south lanes[0] > south_out"
LEFT_TURN = "junction market: west_in > west_north lanes[0] > north_out"


@cache
def ground(site: str) -> OperatingArea:
    """A shipped site with its routes."""
    area = load_area(site, None)[0]
    return replace(area, library=with_routes(area.library))


def route(area: OperatingArea, name: str = STRAIGHT) -> Block:
    (found,) = (block for block in area.library.blocks if block.block_id == name)
    return found


# By area, route and event. An area that is kept has its number for itself.
_REALISED: dict[tuple[int, str, str], tuple[OperatingArea, Realisation]] = {}


def made(wanted: Event, area: OperatingArea, name: str = STRAIGHT) -> Realisation:
    """The event on a route, realised once for all tests of a process, which only read it.

    Raises:
        CannotPlace: it doesn't fit there.
    """
    key = id(area), name, wanted.model_dump_json(by_alias=True)
    if key not in _REALISED:
        order = Order(wanted, "sha256:test", area, "sumo", 1, {})
        _REALISED[key] = area, realise(order, route(area, name))
    return _REALISED[key][1]


def way_of(run: RunSpec) -> FloatArray:
    """The way that the object drives once the trigger has fired."""
    manoeuvre = run.triggers[0].manoeuvre
    assert isinstance(manoeuvre, FollowPath)
    return np.array(manoeuvre.motion.path)


def site_without_junction(site: str, folder: Path) -> Path:
    """A site file with all of a shipped one but its junction."""
    value: dict[str, Any] = yaml.safe_load(find_shipped(site, "site").read_text())
    kept = [block for block in value["blocks"] if "junction" not in block]
    for block in kept:
        block.pop("leads_to", None)
    path = folder / f"{site}.site.yaml"
    path.write_text(yaml.safe_dump(value | {"blocks": kept}))
    return path
