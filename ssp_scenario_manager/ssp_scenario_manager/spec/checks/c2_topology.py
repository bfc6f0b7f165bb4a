"""C2: the road lets the interaction happen, and the initiator's path meets the VUT's corridor.

That routes are connected on the target's map is for the compiler to check (METHOD 2.2).
"""

from __future__ import annotations

from collections.abc import Iterator

from ssp_scenario_manager.spec.checks.base import Fail, Predicate, View, known, one_of
from ssp_scenario_manager.spec.failure import Failure
from ssp_scenario_manager.topology.bends import STRAIGHT_BELOW_1PM

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
}


def road_has_the_lanes(view: View) -> Iterator[Failure]:
    """The road has the lanes in the VUT's direction that the kind needs."""
    kind, lanes = view.kind, view.event.topology.lanes_same_direction
    if kind and lanes.min < kind.same_direction_lanes:
        yield _fail(
            "topology.lanes_same_direction",
            view.said("topology.lanes_same_direction", "interaction.type"),
            f"{kind.name} needs {kind.same_direction_lanes} lanes in the VUT's direction",
            f"min at least {kind.same_direction_lanes}",
        )


def road_permits_it(view: View) -> Iterator[Failure]:
    """The road permits the manoeuvres that the kind needs; none stands twice."""
    kind, path = view.kind, "topology.permitted_manoeuvres"
    permitted = view.event.topology.permitted_manoeuvres
    missing = kind.manoeuvres(view.event) - set(permitted) if kind else frozenset()
    if kind and missing:
        yield _fail(
            path,
            view.said(path, "interaction.type", "interaction.dominant_motion"),
            f"{kind.name} needs {one_of(missing)}",
            f"add {one_of(missing)}, or take a road that permits it",
        )
    if len(set(permitted)) < len(permitted):
        yield _fail(path, view.said(path), "a word stands twice", "each word once")
    lanes = view.event.topology.lanes_same_direction
    changes = {"lane_change_left", "lane_change_right"} & set(permitted)
    if changes and lanes.max < 2:
        yield _fail(
            path,
            view.said(path, "topology.lanes_same_direction"),
            "there is no lane to change to",
            "no lane change, or at least 2 lanes",
        )


def initiator_comes_from_there(view: View) -> Iterator[Failure]:
    """The initiator starts in the lane or at the kerb that its dominant motion comes from."""
    kind, motion = view.kind, view.event.interaction.dominant_motion
    found = view.event.participants.get(view.initiator)
    if kind is None or found is None or motion not in kind.initiator_places:
        return
    places = kind.initiator_places[motion]
    at = f"participants.{view.initiator}.region"
    if found.region.place not in places:
        yield _fail(
            f"{at}.place",
            view.said(f"{at}.place", "interaction.dominant_motion"),
            "the initiator's path doesn't come from there",
            one_of(places),
        )
    if found.region.along != "ahead":
        yield _fail(
            f"{at}.along",
            view.said(f"{at}.along", "interaction.type"),
            "the VUT would not see the initiator coming",
            "ahead",
        )


def path_meets_the_corridor(view: View) -> Iterator[Failure]:
    """Coming from a side, the initiator is seen there at the trigger and in front in conflict."""
    motion, who = view.event.interaction.dominant_motion, view.initiator
    cells = {phase: view.cell(who, phase) for phase in ("trigger", "conflict", "resolution")}
    trigger, conflict, resolution = cells["trigger"], cells["conflict"], cells["resolution"]
    side = _FROM.get(motion)
    ahead = f"front_{side[0]}" if side else "front"
    if trigger and known(trigger.position) and trigger.position != ahead:
        yield _seen(view, f"motion.{who}.trigger.position", ahead)
    if conflict and known(conflict.position) and conflict.position != "front":
        yield _seen(view, f"motion.{who}.conflict.position", "front")
    if resolution is None or not known(resolution.position):
        return
    crossed = motion.startswith("crossing")
    ends = {"front"} | (_BESIDE[side[1]] if side and crossed else frozenset())
    if resolution.position not in ends:
        yield _seen(view, f"motion.{who}.resolution.position", one_of(ends))


def _seen(view: View, path: str, wanted: str) -> Failure:
    return _fail(
        path,
        view.said(path, "interaction.dominant_motion"),
        "the initiator's path doesn't cross or enter the VUT's corridor like this",
        wanted,
    )


def segment_fits_curvature(view: View) -> Iterator[Failure]:
    """Curvature and segment say the same: a straight has a radius of 1000 m or more."""
    segment, path = view.event.topology.segment, "topology.curvature"
    span = view.span(path)
    if span is None:
        return
    if segment == "straight" and span.high > STRAIGHT_BELOW_1PM + 1e-9:
        yield _fail(
            path,
            view.said(path, "topology.segment"),
            "a straight segment isn't bent that much",
            f"at most {STRAIGHT_BELOW_1PM:g} 1/m, or another segment",
        )
    if segment == "curve" and span.high <= STRAIGHT_BELOW_1PM + 1e-9:
        yield _fail(
            path,
            view.said(path, "topology.segment"),
            "a curve is bent more than that",
            f"more than {STRAIGHT_BELOW_1PM:g} 1/m, or another segment",
        )


def lanes_are_changed_on_open_road(view: View) -> Iterator[Failure]:
    """Cutting in and following take place outside junctions."""
    relation, segment = view.event.interaction.relation, view.event.topology.segment
    if segment == "junction" and relation in ("merge", "following"):
        yield _fail(
            "topology.segment",
            view.said("topology.segment", "interaction.relation"),
            "lanes end and part in a junction",
            "straight or curve",
        )


PREDICATES: tuple[Predicate, ...] = (
    road_has_the_lanes,
    road_permits_it,
    initiator_comes_from_there,
    path_meets_the_corridor,
    segment_fits_curvature,
    lanes_are_changed_on_open_road,
)
