"""An event on a road with another number of lanes."""

from __future__ import annotations

from typing import Any

from ssp_scenario_manager.event_spec.model import CountField, Event, Topology

_LANE_CHANGES = ("lane_change_left", "lane_change_right")


def topology_with_lanes(road: Topology, same: int, opposite: int) -> dict[str, Any]:
    """Give part T with other numbers of lanes; a range that doesn't hold them is given up.

    Args:
        road: part T.
        same: lanes in the VUT's direction.
        opposite: oncoming lanes.
    """
    value: dict[str, Any] = road.model_dump(mode="json", by_alias=True)
    for name, count in (("lanes_same_direction", same), ("lanes_opposite", opposite)):
        field = getattr(road, name)
        lane_count = CountField(value=count, identity=True)
        if not field.identity and field.admits(count):
            lane_count = field.model_copy(update={"value": count})
        value[name] = lane_count.model_dump(mode="json")
    permitted = value["permitted_manoeuvres"]
    if same < 2 and isinstance(permitted["value"], list):
        permitted["value"] = [word for word in permitted["value"] if word not in _LANE_CHANGES]
    return value


def with_lanes(event: Event, same: int, opposite: int) -> Event:
    """Give the event on such a road, as ``ssp spec clip --lanes`` makes it but for its clip."""
    road = Topology.model_validate(topology_with_lanes(event.topology, same, opposite))
    return event.model_copy(update={"topology": road})
