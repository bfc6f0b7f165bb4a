"""C2: the road lets the interaction happen, and the initiator's path meets the VUT's corridor.

That routes are connected on the target's map is for the compiler to check (METHOD 2.2).
"""

from __future__ import annotations

from collections.abc import Iterator

from ssp_scenario_manager.checks.base import (
    Fail,
    Failure,
    Predicate,
    View,
    has_meaning,
    one_of,
)
from ssp_scenario_manager.checks.form import allowed
from ssp_scenario_manager.event_spec.fields import get, owner
from ssp_scenario_manager.event_spec.model import (
    IDENTITY_BY_DEFAULT,
    UNRESOLVED,
    CountField,
    QuantityField,
    WordField,
)
from ssp_scenario_manager.maps.block import STRAIGHT_BELOW_1PM

_fail = Fail("C2")

_BESIDE = {
    "left": frozenset({"front_left", "left", "rear_left"}),
    "right": frozenset({"front_right", "right", "rear_right"}),
}
# Motion class: side that it comes from, side that it moves to.
_FROM = {
    "cutting_in_from_left": ("left", "right"),
    "cutting_in_from_right": ("right", "left"),
    "crossing_from_left": ("left", "right"),
    "crossing_from_right": ("right", "left"),
    "oncoming": ("left", "right"),
}


def fields_say_whether_they_vary(view: View) -> Iterator[Failure]:
    """Check that a field of the road is identity or has a range that holds the source's value."""
    for name, field in view.event.topology.by_name.items():
        path, varies = f"topology.{name}", get(view.value, f"topology.{name}.varies")
        if field.identity == (varies is not None):
            both = "is identity and varies" if field.identity else "says neither"
            yield _fail(
                view,
                f"{both}: every domain has the source's value, or may have another one",
                "either identity: true, or varies: with what a place may have",
                path,
            )
        if varies is None:
            continue
        if isinstance(varies, list) and len(set(varies)) < len(varies):
            yield _fail(view, "a word stands twice", "each word once", f"{path}.varies")
        if isinstance(field, CountField) and varies["min"] > varies["max"]:
            yield _fail(view, "min is above max", "min at most max", f"{path}.varies")
        elif not _holds(view, name):
            yield _fail(
                view,
                "the source's own value is outside the range in which the field may vary",
                "a range that holds it, or the value that the source shows",
                path,
                origin=view.origin(path),
            )


def _holds(view: View, name: str) -> bool:
    """Tell whether a varying field's own value, where it is known, is one that a place may have."""
    field = view.event.topology.by_name[name]
    if isinstance(field, WordField):
        return field.value == UNRESOLVED or field.admits(field.value)
    if isinstance(field, CountField):
        return field.value == UNRESOLVED or field.admits(field.value)
    both = view.spans(f"topology.{name}.value", f"topology.{name}.varies")
    return not isinstance(field, QuantityField) or both is None or both[1].holds(both[0])


def identity_is_known(view: View) -> Iterator[Failure]:
    """Check that an identity field has the value that the source shows (METHOD 4.2)."""
    for name in view.event.topology.identity_fields:
        path = f"topology.{name}"
        if get(view.value, f"{path}.value") == UNRESOLVED:
            yield _fail(
                view,
                "is identity, so that no other domain can be shown to have the same",
                allowed(f"{path}.value"),
                path,
                origin="open decision",
            )


def what_varies_is_justified(view: View) -> Iterator[Failure]:
    """Check that segment, lane counts and the VUT's lane vary only for a reviewed reason."""
    for name in IDENTITY_BY_DEFAULT:
        path, field = f"topology.{name}", view.event.topology.by_name[name]
        if get(view.value, f"{path}.varies") is None:
            continue
        if not (field.why and field.why.strip()):
            reason = "is identity unless somebody says why not (METHOD 4.2)"
            yield _fail(view, reason, "identity: true, or why: with the reason", path)
        entry = owner(path, view.event.uncertainty)
        state = view.event.uncertainty[entry].review if entry else "not there"
        if state not in ("accepted", "edited"):
            yield _fail(
                view,
                "may differ between domains, and no person has reviewed that (METHOD 4.2)",
                "identity: true, or a decision by `ssp spec review FILE`",
                path,
                evidence=f"{view.evidence(path)}; uncertainty.{entry or path}.review = {state}",
            )


def road_has_the_lanes(view: View) -> Iterator[Failure]:
    """Check that the road has the lanes in the VUT's direction that the kind needs."""
    kind, lanes = view.kind, view.event.topology.lanes_same_direction.range
    if kind and lanes and lanes.min < kind.same_direction_lanes:
        reason = f"{kind.name} needs {kind.same_direction_lanes} lanes in the VUT's direction"
        remedy = f"at least {kind.same_direction_lanes}"
        yield _fail(view, reason, remedy, "topology.lanes_same_direction", "interaction.type")


def road_permits_it(view: View) -> Iterator[Failure]:
    """Check that the road permits the manoeuvres that the kind needs."""
    kind, path = view.kind, "topology.permitted_manoeuvres"
    permitted = view.event.topology.permitted_manoeuvres
    missing = kind.manoeuvres(view.event) - permitted.needed if kind else frozenset()
    if kind and missing and permitted.permitted:
        yield _fail(
            view,
            f"{kind.name} needs {one_of(missing)} wherever it takes place",
            f"{one_of(missing)} in value and not in varies",
            path,
            "interaction.type",
            "interaction.dominant_motion",
        )
    lanes = view.event.topology.lanes_same_direction.range
    changes = {"lane_change_left", "lane_change_right"} & permitted.permitted
    if changes and lanes and lanes.max < 2:
        remedy = "no lane change, or at least 2 lanes"
        lane_count = "topology.lanes_same_direction"
        yield _fail(view, "there is no lane to change to", remedy, path, lane_count)


def initiator_comes_from_there(view: View) -> Iterator[Failure]:
    """Check that the initiator starts in the lane or at the kerb that its motion comes from."""
    kind, motion = view.kind, view.event.interaction.dominant_motion
    initiator = view.event.participants.get(view.initiator)
    if kind is None or initiator is None or motion not in kind.initiator_places:
        return
    at, places = f"participants.{view.initiator}.region", kind.initiator_places[motion]
    reason = "the initiator's path doesn't come from there"
    paths = f"{at}.place", "interaction.dominant_motion"
    yield from _fail.unless(view, initiator.region.place, places, reason, *paths)
    reason = "the VUT would not see the initiator coming"
    paths = f"{at}.along", "interaction.type"
    yield from _fail.unless(view, initiator.region.along, ["ahead"], reason, *paths)


def path_meets_the_corridor(view: View) -> Iterator[Failure]:
    """Check that an initiator from a side is seen there at the trigger, and ahead in conflict."""
    motion, who = view.event.interaction.dominant_motion, view.initiator
    side = _FROM.get(motion)
    passes = view.event.interaction.relation == "crossing"
    crossed = _BESIDE[side[1]] if side and passes else frozenset()
    positions_by_phase = {
        "trigger": {f"front_{side[0]}" if side else "front"},
        "conflict": {"front"},
        "resolution": {"front"} | crossed,
    }
    for name, _, phase, cell in view.cells():
        if name == who and phase in positions_by_phase and has_meaning(cell.position):
            yield from _fail.unless(
                view,
                cell.position,
                positions_by_phase[phase],
                "the initiator's path doesn't cross or enter the VUT's corridor like this",
                f"motion.{who}.{phase}.position",
                "interaction.dominant_motion",
            )


def roads_cross_at_a_junction(view: View) -> Iterator[Failure]:
    """Check that a kind which takes place on routes has a junction as its segment, everywhere."""
    words = set(view.event.topology.segment.words)
    if view.kind and view.kind.at_junction and words - {"junction"}:
        reason = f"{view.kind.name} takes place at a junction"
        yield _fail(view, reason, "junction", "topology.segment", "interaction.type")


def segment_fits_curvature(view: View) -> Iterator[Failure]:
    """Check that curvature and segment agree: a straight has a radius of 1000 m or more."""
    segments, path = set(view.event.topology.segment.words), view.road("curvature")
    span, limit = view.span(path), f"{STRAIGHT_BELOW_1PM:g} 1/m, or another segment"
    bent = span is not None and span.high > STRAIGHT_BELOW_1PM + 1e-9
    if span and segments == {"straight"} and bent:
        reason = "a straight segment isn't bent that much"
        yield _fail(view, reason, f"at most {limit}", path, "topology.segment")
    if span and segments == {"curve"} and not bent:
        reason = "a curve is bent more than that"
        yield _fail(view, reason, f"more than {limit}", path, "topology.segment")


def lanes_are_changed_on_open_road(view: View) -> Iterator[Failure]:
    """Check that cutting in and following take place outside junctions."""
    relation, segments = view.event.interaction.relation, view.event.topology.segment.words
    if view.kind and view.kind.at_junction:
        return
    if "junction" in segments and relation in ("merge", "following"):
        paths = "topology.segment", "interaction.relation"
        yield _fail(view, "lanes end and part in a junction", "straight or curve", *paths)


TOPOLOGY_PREDICATES: tuple[Predicate, ...] = (
    fields_say_whether_they_vary,
    identity_is_known,
    what_varies_is_justified,
    road_has_the_lanes,
    road_permits_it,
    initiator_comes_from_there,
    path_meets_the_corridor,
    roads_cross_at_a_junction,
    segment_fits_curvature,
    lanes_are_changed_on_open_road,
)
