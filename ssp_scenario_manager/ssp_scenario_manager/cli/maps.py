"""``ssp maps``: the junctions of a map or site, and the routes through them (METHOD 2.1)."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_scenario_manager.maps.block import Block, Conflict, Library
from ssp_scenario_manager.maps.lane_ends import with_lane_ends
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.routes import routes_of
from ssp_scenario_manager.maps.site import find_shipped

# Parts of a map that can't be used, for people; --json has them all.
_MOST_TOLD = 10
# A route that turns by less goes straight on.
_STRAIGHT_DEG = 30.0


@click.command("maps")
@click.argument("place")
@click.option("--junction", "only", metavar="NAME", help="Show only this junction.")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
def maps(place: str, only: str | None, as_json: bool) -> int:
    """List the junctions of PLACE, with the routes through them and where these conflict.

    PLACE is an OpenDRIVE map (.xodr), a SUMO network (.net.xml), or a site by name or file. Arc
    lengths are along the route; angles are the other route's headings, + to the left.
    """
    library = load_library(place if Path(place).is_file() else find_shipped(place, "site"))
    library = with_lane_ends(library)
    routes, refused = routes_of(library, only)
    if only is not None and not routes:
        raise _no_routes(library, only, refused)
    if as_json:
        click.echo(json.dumps(_as_dict(library, routes, refused)))
        return 0
    junctions = sorted({route.junction or "" for route in routes})
    all_of_them = {block.junction for block in library.blocks} - {None}
    console.out.print(
        f"{library.source}: blocks {len(library.blocks)}, junctions {len(all_of_them)}, "
        f"routes through {only or 'them'} {len(routes)}",
        markup=False,
    )
    for junction in junctions:
        console.out.print(f"\njunction {junction}", markup=False)
        numbers = {route.block_id: i for i, route in enumerate(routes, 1)}
        for route in routes:
            if route.junction == junction:
                _print_route(route, numbers)
    left_out = (*library.faults, *refused, *library.rejected)
    for name, why in left_out[:_MOST_TOLD]:
        console.note(f"{name}: {why}")
    if len(left_out) > _MOST_TOLD:
        console.note(f"and {len(left_out) - _MOST_TOLD} more (--json has all)")
    return 0


def _no_routes(library: Library, junction: str, refused: Sequence[tuple[str, str]]) -> InputError:
    """Return the refusal of a junction that isn't there, or that no route leads through."""
    junctions = sorted({block.junction for block in library.blocks if block.junction is not None})
    problem, remedy = "there is no such junction", f"there are {', '.join(junctions) or 'none'}"
    if junction in junctions:
        reasons = "; ".join(f"{name}: {why}" for name, why in refused)
        problem, remedy = f"no route leads through it: {reasons}", "mend the map, or name another"
    return InputError(
        problem, file=library.source, field="--junction", value=junction, remedy=remedy
    )


def _turn(degrees: float) -> str:
    if abs(degrees) < _STRAIGHT_DEG:
        return "straight on"
    return f"turns {'left' if degrees > 0.0 else 'right'} by {abs(degrees):.0f} deg"


def _print_route(route: Block, numbers: dict[str, int]) -> None:
    if route.passage is None:
        return
    inside, label = route.passage, route.block_id.partition(": ")[2]
    console.out.print(
        f"  {numbers[route.block_id]:3d}  {label}: {_turn(math.degrees(inside.turn_rad))}, length "
        f"{route.length_m:.1f} m, in the junction from {inside.start_s_m:.1f} to "
        f"{inside.end_s_m:.1f} m",
        markup=False,
    )
    for conflict in inside.conflicts:
        console.out.print(f"         {_conflict(conflict, numbers)}", markup=False)


def _conflict(conflict: Conflict, numbers: dict[str, int]) -> str:
    word = "crosses" if conflict.kind == "crossing" else "is joined by"
    return (
        f"{conflict.s_m:6.1f} m {word} {numbers[conflict.route]}, which comes from the "
        f"{conflict.comes_from} at {math.degrees(conflict.angle_rad):.0f} deg, there at "
        f"{conflict.other_s_m:.1f} m; both lanes overlap from {conflict.start_s_m:.1f} to "
        f"{conflict.end_s_m:.1f} m"
    )


def _as_dict(
    library: Library, routes: Sequence[Block], refused: Sequence[tuple[str, str]]
) -> dict[str, Any]:
    return {
        "place": library.source,
        "kind": library.kind,
        "sha256": library.sha256,
        "blocks": len(library.blocks),
        "routes": [_route_dict(route) for route in routes],
        "left_out": [[name, why] for name, why in (*library.faults, *refused, *library.rejected)],
    }


def _route_dict(route: Block) -> dict[str, Any]:
    inside = route.passage
    if inside is None:
        return {}
    return {
        "id": route.block_id,
        "junction": route.junction,
        "from": route.entrances[0],
        "via": list(inside.via),
        "to": route.exits[0],
        "length_m": route.length_m,
        "junction_start_s_m": inside.start_s_m,
        "junction_end_s_m": inside.end_s_m,
        "turn_rad": inside.turn_rad,
        "speed_limit_mps": route.speed_limit_mps,
        "conflicts": [
            {
                "route": one.route,
                "kind": one.kind,
                "s_m": one.s_m,
                "other_s_m": one.other_s_m,
                "at_m": list(route.line.to_map(one.s_m, 0.0)),
                "angle_rad": one.angle_rad,
                "comes_from": one.comes_from,
                "overlap_start_s_m": one.start_s_m,
                "overlap_end_s_m": one.end_s_m,
            }
            for one in inside.conflicts
        ],
    }
