"""``ssp.graph/1``, the typed interaction graph of a K* (METHOD 1), and differences of two K*."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, Literal

from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.event_spec.fields import ROAD_FIELD, get, granules, has, leaves, owner
from ssp_scenario_manager.event_spec.load import body, canonical, event_version
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Event

SCHEMA = "ssp.graph/1"
NodeType = Literal["road", "lane", "kerb", "VUT", "OT", "conflict_zone", "phase"]
EdgeKind = Literal["spatial", "temporal", "interaction"]


def interaction_graph(event: Event) -> dict[str, Any]:
    """Return the graph of a K* as JSON-like data.

    Returns:
        ``nodes`` and ``edges``, each with the ``fields`` that say it; ``determined`` (P): values
        that are known, quantities with their units; ``uncertain`` (U): intervals and unresolved
        marks, and how every field is known.
    """
    value = body(event)
    nodes, edges = _nodes(event, value), [*_spatial(event), *_temporal(event), *_interaction(event)]
    return {
        "schema": SCHEMA,
        "event": {"name": event.name, "version": event_version(event)},
        "nodes": [
            {"id": name, "type": kind, "fields": _fields_at(value, paths)}
            for name, kind, paths in nodes
        ],
        "edges": [
            {
                "kind": edge.kind,
                "relation": edge.relation,
                "from": edge.source,
                "to": edge.target,
                "fields": _fields_at(value, edge.fields),
            }
            for edge in edges
        ],
        "determined": _determined(value),
        "uncertain": _uncertain(event, value),
    }


@dataclass(frozen=True, slots=True)
class _Edge:
    """An edge, and the paths of what the K* says of it."""

    kind: EdgeKind
    relation: str
    source: str
    target: str
    fields: tuple[str, ...]


def _fields_at(value: dict[str, Any], paths: Iterable[str]) -> dict[str, Any]:
    """Return the fields of the K* by path, a list or a mapping as it stands."""
    return {path: get(value, path) for path in paths}


def _below(value: dict[str, Any], path: str) -> list[str]:
    """Return the paths of everything that the K* says below a path."""
    return [f"{path}.{name}" for name in granules(get(value, path))]


def _places(event: Event) -> list[str]:
    """Return the places that the participants start in, the VUT's lane first."""
    start_places = (who.region.place for who in event.participants.values())
    return list(dict.fromkeys(("vut_lane", *start_places)))


def _nodes(event: Event, value: dict[str, Any]) -> Iterator[tuple[str, NodeType, list[str]]]:
    """Yield id and type of each node, and the paths of what the K* says of it."""
    yield "road", "road", _below(value, "topology")
    for place in _places(event):
        paths = [
            f"participants.{who}.region.place"
            for who, participant in event.participants.items()
            if participant.region.place == place
        ]
        yield place, "kerb" if place.endswith("kerb") else "lane", paths
    for who, participant in event.participants.items():
        yield who, participant.role, _below(value, f"participants.{who}")
    yield "conflict_zone", "conflict_zone", ["interaction.zone", "interaction.relation"]
    for phase in PHASES:
        cells = [f"motion.{who}.{phase}" for who in event.motion if phase in event.motion[who]]
        at = f"events.{phase}"
        yield f"phase:{phase}", "phase", [f"{at}.start", f"{at}.evidence", *cells]


def _spatial(event: Event) -> Iterator[_Edge]:
    vut, interaction = event.vut_id, event.interaction

    def edge(relation: str, source: str, target: str, *fields: str) -> _Edge:
        return _Edge("spatial", relation, source, target, fields)

    for who, participant in event.participants.items():
        at = f"participants.{who}.region.place"
        yield edge("occupies", who, participant.region.place, at)
    for who, participant in event.participants.items():
        at = f"participants.{who}.region"
        if participant.region.along == "ahead":
            yield edge("ahead-of", who, vut, f"{at}.along", f"{at}.gap")
        elif participant.region.along == "behind":
            yield edge("ahead-of", vut, who, f"{at}.along")
    for place in _places(event):
        if place in ("left_lane", "right_lane"):
            fields = "topology.lanes_same_direction", "topology.vut_lane"
            yield edge("adjacent", place, "vut_lane", *fields)
        elif place.endswith("kerb"):
            side = place.removesuffix("_kerb")
            yield edge("adjacent", place, "road", f"topology.{side}_boundary")
        elif place.endswith("_road"):
            yield edge("adjacent", place, "road", "topology.segment")
        elif place == "oncoming_lane":
            yield edge("adjacent", place, "road", "topology.lanes_opposite")
    # Both kinds of zone lie in the VUT's lane (METHOD 1: they are cut out of its swept corridor).
    yield edge("occupies", "conflict_zone", "vut_lane", "interaction.zone")
    fields = "interaction.relation", "interaction.dominant_motion"
    yield edge("path-intersects", interaction.initiator, vut, *fields)


def _temporal(event: Event) -> Iterator[_Edge]:
    for before, after in pairwise(PHASES):
        fields = f"events.{before}.start", f"events.{after}.start"
        yield _Edge("temporal", "before", f"phase:{before}", f"phase:{after}", fields)
    first, second = event.interaction.passing_order
    fields = "interaction.passing_order", "constraints.time_gap"
    yield _Edge("temporal", "before", first, second, fields)


def _interaction(event: Event) -> Iterator[_Edge]:
    interaction = event.interaction
    who, vut = interaction.initiator, interaction.affected

    def edge(relation: str, source: str, target: str, part: str, *names: str) -> _Edge:
        fields = tuple(f"{part}.{name}" for name in names)
        return _Edge("interaction", relation, source, target, fields)

    yield edge("triggers", vut, who, "constraints.trigger", "quantity", "object", "below")
    cells = event.motion.get(who, {})
    for before, after in pairwise(PHASES):
        if before in cells and after in cells and cells[before] != cells[after]:
            yield edge("changes-motion", who, f"phase:{after}", f"motion.{who}", before, after)
    exposed = (
        "interaction.type",
        "interaction.relation",
        "constraints.thresholds.ttc",
        "constraints.thresholds.arrival_gap",
    )
    yield _Edge("interaction", "exposes-conflict", who, "conflict_zone", exposed)
    if interaction.occluder is not None:
        yield edge("exposes-conflict", interaction.occluder, who, "interaction", "occluder")
    answers = "longitudinal_responses", "lateral_responses"
    yield edge("responds", vut, who, "interaction", *answers)


def _is_interval(value: Any) -> bool:
    return isinstance(value, dict) and set(value) == {"min", "max", "unit"}


def _is_road(value: Any) -> bool:
    return isinstance(value, dict) and set(value) == ROAD_FIELD


def _determined(value: dict[str, Any]) -> dict[str, Any]:
    """Return P: exact quantities with their units, and all known words, numbers and lists."""
    fields: dict[str, Any] = {}
    for path in granules(value):
        item = get(value, path)
        if _is_road(item):
            item = item["value"]
        if _is_interval(item):
            if item["min"] is not None and item["min"] == item["max"]:
                fields[path] = {"value": item["min"], "unit": item["unit"]}
        elif item is not None and UNRESOLVED not in [leaf for _, leaf in leaves(item)]:
            fields[path] = {"value": item}
    return fields


def _uncertain(event: Event, value: dict[str, Any]) -> dict[str, Any]:
    """Return U: intervals and unresolved marks as they stand, and how each field is known."""
    fields: dict[str, Any] = {}
    for path in granules(value):
        item, entry = get(value, path), owner(path, event.uncertainty)
        doubt = event.uncertainty[entry].model_dump(mode="json") if entry else None
        open_ = UNRESOLVED in [leaf for _, leaf in leaves(item)]
        interval = _is_interval(item) and item["min"] != item["max"]
        interval |= _is_road(item) and item["varies"] is not None
        fields[path] = ({"value": item} if open_ or interval else {}) | {"known": doubt}
    return fields


@dataclass(frozen=True, slots=True)
class Difference:
    """One field that two K* don't share.

    Args:
        old: its value in the first one, None where that has no such field.
        new: as old, in the second one.
        unit: of both values, None where they have none or different ones.
    """

    field: str
    old: Any
    new: Any
    unit: str | None
    where: str

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def differences(first: Event, second: Event) -> list[Difference]:
    """Return every field that differs, in the order of the files; [] for the same version."""
    old, new = canonical(first), canonical(second)
    # Entries of part U have dots in their keys, so that they are compared apart.
    doubts = old.pop("uncertainty"), new.pop("uncertainty")
    changes: list[Difference] = []
    for path in dict.fromkeys((*granules(old), *granules(new))):
        sides = (get(side, path) if has(side, path) else _NOTHING for side in (old, new))
        changes += _split(path, *sides)
    for name in dict.fromkeys((*doubts[0], *doubts[1])):
        changes += _split(f"uncertainty.{name}", *(side.get(name, _NOTHING) for side in doubts))
    return changes


_NOTHING = object()


def _split(path: str, before: Any, after: Any) -> list[Difference]:
    """Return one difference, or one for each field of a cell or entry that both sides have."""
    if before == after:
        return []
    both = isinstance(before, dict) and isinstance(after, dict)
    if both and "unit" not in before:
        parts = (_split(f"{path}.{key}", before[key], after.get(key, _NOTHING)) for key in before)
        return [item for part in parts for item in part]
    units = {
        value["unit"] for value in (before, after) if isinstance(value, dict) and "unit" in value
    }
    return [
        Difference(
            field=path,
            old=None if before is _NOTHING else before,
            new=None if after is _NOTHING else after,
            unit=units.pop() if len(units) == 1 else None,
            where="second" if before is _NOTHING else "first" if after is _NOTHING else "both",
        )
    ]
