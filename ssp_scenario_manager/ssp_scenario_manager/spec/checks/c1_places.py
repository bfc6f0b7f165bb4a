"""C1, part A: participants start where the road has a place for them; an occluder hides."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.spec.checks.base import Fail, Predicate, View, known, one_of
from ssp_scenario_manager.spec.failure import Failure

_fail = Fail("C1")

_HIDING_CLASSES = frozenset({"car", "truck", "bus"})
_NEEDS_LANES = {"left_lane": 2, "right_lane": 2}
# Where a road user stands in a walkable place beside the road: the boundary that this needs.
_KERBS = {"left_kerb": "left_boundary", "right_kerb": "right_boundary"}
_WALKABLE = frozenset({"kerb", "sidewalk"})
_NO_LANE_BESIDE = {"left_lane": ("leftmost",), "right_lane": ("rightmost",)}
# Where who starts in a place is seen from the VUT.
_SEEN = {
    ("vut_lane", "ahead"): "front",
    ("vut_lane", "behind"): "rear",
    ("left_lane", "ahead"): "front_left",
    ("left_lane", "beside"): "left",
    ("left_lane", "behind"): "rear_left",
    ("right_lane", "ahead"): "front_right",
    ("right_lane", "beside"): "right",
    ("right_lane", "behind"): "rear_right",
    ("right_kerb", "ahead"): "front_right",
    ("right_kerb", "beside"): "right",
    ("right_kerb", "behind"): "rear_right",
    ("left_kerb", "ahead"): "front_left",
    ("left_kerb", "beside"): "left",
    ("left_kerb", "behind"): "rear_left",
    ("oncoming_lane", "ahead"): "front_left",
    ("oncoming_lane", "beside"): "left",
    ("oncoming_lane", "behind"): "rear_left",
}


def vut_drives_along_the_road(view: View) -> Iterator[Failure]:
    """The VUT starts in its own lane and is not seen from itself; OTs are seen from it."""
    for who, participant in view.event.participants.items():
        region, at = participant.region, f"participants.{who}.region"
        is_vut = participant.role == "VUT"
        if is_vut != (region.along == "at") or (is_vut and region.place != "vut_lane"):
            yield _fail(
                f"{at}.place" if is_vut and region.place != "vut_lane" else f"{at}.along",
                view.said(f"{at}.place", f"{at}.along", f"participants.{who}.role"),
                "the VUT, and nobody else, starts at the VUT's own entry",
                "vut_lane, at" if is_vut else "ahead, beside or behind",
            )
        gap = view.span(f"{at}.gap")
        if gap and is_vut != (gap.low == gap.high == 0.0):
            yield _fail(
                f"{at}.gap",
                view.said(f"{at}.gap", f"participants.{who}.role"),
                "only the VUT has no distance to itself",
                "0 m" if is_vut else "an interval above 0 m",
            )
        for phase in PHASES:
            cell = view.cell(who, phase)
            if cell is None:
                continue
            for name in ("position", "motion"):
                if is_vut != (getattr(cell, name) is None):
                    path = f"motion.{who}.{phase}.{name}"
                    yield _fail(
                        path,
                        view.said(path, f"participants.{who}.role"),
                        "position and motion are those of others, seen from the VUT",
                        "null" if is_vut else "a word of the vocabulary (METHOD 5.1)",
                    )


def places_exist(view: View) -> Iterator[Failure]:
    """The road of part T has the lanes and boundaries that part A puts participants in."""
    topology = view.event.topology
    lanes, opposite = topology.lanes_same_direction.range, topology.lanes_opposite.range
    fewest = math.inf if lanes is None else lanes.min
    least = 3 if "middle" in topology.vut_lane.words else 1
    if fewest < least:
        yield _fail(
            "topology.lanes_same_direction",
            view.said("topology.lanes_same_direction", "topology.vut_lane"),
            "the VUT's lane isn't there",
            f"at least {least}",
        )
    for who, participant in view.event.participants.items():
        place = participant.region.place
        path = f"participants.{who}.region.place"
        if fewest < _NEEDS_LANES.get(place, 0):
            yield _fail(
                path,
                view.said(path, "topology.lanes_same_direction"),
                "the road need not have such a lane",
                "another place, or at least 2 lanes in this direction",
            )
        if topology.vut_lane.words == _NO_LANE_BESIDE.get(place):
            yield _fail(
                path,
                view.said(path, "topology.vut_lane"),
                "the VUT has no lane on that side",
                "a place on the VUT's other side",
            )
        if place == "oncoming_lane" and opposite is not None and opposite.min < 1:
            yield _fail(
                path,
                view.said(path, "topology.lanes_opposite"),
                "the road need not have a lane in the opposite direction",
                "another place, or at least 1 lane in the opposite direction",
            )
        side = _KERBS.get(place)
        words = getattr(topology, side).words if side else ()
        if words and not _WALKABLE & set(words):
            yield _fail(
                path,
                view.said(path, f"topology.{side}"),
                "there is no place to stand beside this road",
                f"another place, or topology.{side} kerb or sidewalk",
            )


def first_seen_where_they_start(view: View) -> Iterator[Failure]:
    """In the approach, an OT is seen where part A puts it, and is of a class that may be there."""
    for who, participant in view.event.participants.items():
        cell = view.cell(who, "approach")
        if cell is None or participant.role == "VUT":
            continue
        region = participant.region
        wanted = _SEEN.get((region.place, region.along))
        at = f"participants.{who}.region"
        if wanted is None:
            yield _fail(
                f"{at}.along",
                view.said(f"{at}.along", f"{at}.place"),
                "nobody can be there: the VUT is",
                "ahead or behind",
            )
        elif known(cell.position) and cell.position != wanted:
            path = f"motion.{who}.approach.position"
            yield _fail(
                path,
                view.said(path, f"{at}.place", f"{at}.along"),
                "is seen elsewhere than it starts",
                wanted,
            )
        standing = cell.speed_trend == "standing"
        at_kerb = region.place in _KERBS
        walker = participant.class_ in ("pedestrian", "cyclist")
        if (walker and not at_kerb) or (not walker and at_kerb and not standing):
            yield _fail(
                f"{at}.place",
                view.said(
                    f"{at}.place", f"participants.{who}.class", f"motion.{who}.approach.speed_trend"
                ),
                "pedestrians and cyclists start beside the carriageway, moving vehicles on it",
                "a kerb" if walker else "a lane",
            )


def occluder_hides(view: View) -> Iterator[Failure]:
    """An occluder is there exactly if the kind needs one: large, standing, before the initiator."""
    event, kind = view.event, view.kind
    who = event.interaction.occluder
    if kind and kind.needs_occluder != (who is not None):
        yield _fail(
            "interaction.occluder",
            view.said("interaction.occluder", "interaction.type"),
            f"{kind.name} {'needs' if kind.needs_occluder else 'has no'} occluder",
            "the id of a standing OT" if kind.needs_occluder else "null",
        )
    if who is None:
        return
    hiding, hidden = event.participants.get(who), event.participants.get(view.initiator)
    if hiding is None or hiding.role != "OT" or who == view.initiator:
        yield _fail(
            "interaction.occluder",
            view.said("interaction.occluder", "interaction.initiator"),
            "what hides the initiator is another OT",
            "the id of a standing OT",
        )
        return
    if hiding.class_ not in _HIDING_CLASSES:
        yield _fail(
            f"participants.{who}.class",
            view.said(f"participants.{who}.class", "interaction.occluder"),
            "is too small to hide a road user",
            one_of(_HIDING_CLASSES),
        )
    for phase in PHASES:
        cell = view.cell(who, phase)
        if cell and cell.speed_trend != "standing":
            yield _fail(
                f"motion.{who}.{phase}.speed_trend",
                view.said(f"motion.{who}.{phase}.speed_trend", "interaction.occluder"),
                "an occluder stands in every phase",
                "standing",
            )
    if hidden is None:
        return
    for name in ("place", "along"):
        if getattr(hiding.region, name) != getattr(hidden.region, name):
            paths = [f"participants.{i}.region.{name}" for i in (who, view.initiator)]
            yield _fail(
                paths[0],
                view.said(*paths),
                "an occluder stands on the side that the initiator comes from",
                str(getattr(hidden.region, name)),
            )
    paths = [f"participants.{i}.region.gap" for i in (who, view.initiator)]
    near, far = view.span(paths[0]), view.span(paths[1])
    if near and far and not (near.low < far.low and near.high < far.high):
        yield _fail(
            paths[0],
            view.said(*paths),
            "an occluder stands nearer to the VUT than whom it hides",
            f"less than {paths[1]} at both ends",
        )


PREDICATES: tuple[Predicate, ...] = (
    vut_drives_along_the_road,
    places_exist,
    first_seen_where_they_start,
    occluder_hides,
)
