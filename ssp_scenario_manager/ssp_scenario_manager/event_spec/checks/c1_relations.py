"""C1: participants, places and motions stand in valid relations."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import get_args

from ssp_core.vocabulary import PHASES, PhaseWord
from ssp_scenario_manager.event_spec.checks.base import (
    Fail,
    Failure,
    Predicate,
    View,
    known,
    one_of,
)
from ssp_scenario_manager.event_spec.model import UNRESOLVED, IntentWord, MotionCell

_fail = Fail("C1")

_VUT_CLASSES = frozenset({"car", "truck", "bus"})


def one_vut(view: View) -> Iterator[Failure]:
    """Exactly one participant is the VUT."""
    vuts = [who for who, p in view.event.participants.items() if p.role == "VUT"]
    if len(vuts) == 1:
        return
    extra = [who for who in vuts if who != view.event.interaction.affected] or [
        view.event.interaction.affected
    ]
    for who in extra:
        yield _fail(
            f"participants.{who}.role",
            f"VUTs: {', '.join(vuts) or 'none'}",
            "an event has exactly one vehicle under test",
            "give one participant the role VUT and the others OT",
        )


def same_ids_everywhere(view: View) -> Iterator[Failure]:
    """Parts A, M and C speak of the same ids."""
    ids = set(view.event.participants)
    parts: dict[str, set[str]] = {
        "motion": set(view.event.motion),
        "constraints.speeds": set(view.event.constraints.speeds),
    }
    for part, found in parts.items():
        for who in sorted(ids ^ found):
            there = who in found
            yield _fail(
                f"{part}.{who}",
                f"participants: {one_of(ids)}; {part}: {one_of(found)}",
                "speaks of somebody who is no participant" if there else "lacks a participant",
                "use the participants' own ids in every part",
            )


def every_phase(view: View) -> Iterator[Failure]:
    """Parts M and C have each participant in all four phases."""
    given: dict[str, dict[str, set[str]]] = {
        "motion": {who: set(cells) for who, cells in view.event.motion.items()},
        "constraints.speeds": {k: set(v) for k, v in view.event.constraints.speeds.items()},
    }
    for part, by_id in given.items():
        for who, phases in sorted(by_id.items()):
            for phase in PHASES:
                if phase not in phases:
                    yield _fail(
                        f"{part}.{who}.{phase}",
                        f"{part}.{who} has {one_of(phases) or 'nothing'}",
                        "an id must be the same, and known, in every phase",
                        f"give {who} in all of {', '.join(PHASES)}",
                    )


def interaction_names_participants(view: View) -> Iterator[Failure]:
    """The initiator is an OT, the affected one the VUT, and they alone pass the conflict point."""
    event = view.event
    interaction = event.interaction
    roles = {who: p.role for who, p in event.participants.items()}
    for name, role in (("initiator", "OT"), ("affected", "VUT")):
        who = getattr(interaction, name)
        if roles.get(who) != role:
            yield _fail(
                f"interaction.{name}",
                view.said(f"interaction.{name}", f"participants.{who}.role"),
                f"the {name} must be a participant with role {role}",
                f"one of {one_of(k for k, v in roles.items() if v == role) or 'none'}",
            )
    both = {interaction.initiator, interaction.affected}
    if set(interaction.passing_order) != both or len(both) < 2:
        yield _fail(
            "interaction.passing_order",
            view.said("interaction.passing_order", "interaction.initiator", "interaction.affected"),
            "initiator and affected, each once, pass the conflict point",
            f"name {one_of(both)}, the first to arrive first",
        )
    if event.constraints.trigger.object != interaction.initiator:
        yield _fail(
            "constraints.trigger.object",
            view.said("constraints.trigger.object", "interaction.initiator"),
            "the trigger is measured to the OT whose manoeuvre it fires",
            interaction.initiator,
        )


def classes_fit_roles(view: View) -> Iterator[Failure]:
    """VUT and initiator are of classes that can do what they do."""
    event, kind = view.event, view.kind
    for who, participant in event.participants.items():
        path = f"participants.{who}.class"
        if participant.role == "VUT" and participant.class_ not in _VUT_CLASSES:
            yield _fail(
                path, view.said(path), "can't be a vehicle under test", one_of(_VUT_CLASSES)
            )
    who = view.initiator
    found = event.participants.get(who)
    if kind and found and found.class_ not in kind.initiator_classes:
        yield _fail(
            f"participants.{who}.class",
            view.said(f"participants.{who}.class", "interaction.type"),
            f"can't be the initiator of {kind.name}",
            one_of(kind.initiator_classes),
        )


def only_the_vut_has_an_intent(view: View) -> Iterator[Failure]:
    """The VUT says where it means to go, and nobody else does."""
    for who, participant in view.event.participants.items():
        is_vut, path = participant.role == "VUT", f"participants.{who}.intent"
        if is_vut == (participant.intent is None):
            yield _fail(
                path,
                view.said(path, f"participants.{who}.role"),
                "nobody says what the VUT is about to do (METHOD 1)"
                if is_vut
                else "the intent is the VUT's; what an OT does stands in part M",
                one_of(get_args(IntentWord)) if is_vut else "no intent",
            )


TYPE_PREDICATES: tuple[Predicate, ...] = (
    one_vut,
    only_the_vut_has_an_intent,
    same_ids_everywhere,
    every_phase,
    interaction_names_participants,
    classes_fit_roles,
)


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


PLACE_PREDICATES: tuple[Predicate, ...] = (
    vut_drives_along_the_road,
    places_exist,
    first_seen_where_they_start,
    occluder_hides,
)


_ANY_LATERAL = frozenset({"none", "left", "right"})
_ANY_HEADING = frozenset({"same", "opposite", "leftwards", "rightwards"})
# Where something that stands is seen as the VUT goes past, by the side that it stands on.
_COURSES = {
    "left": ("front_left", "left", "rear_left"),
    "right": ("front_right", "right", "rear_right"),
}


@dataclass(frozen=True, slots=True)
class _Meaning:
    """What a motion class says about the other words of its cell; an empty set: nothing."""

    heading: frozenset[str]
    lateral: frozenset[str]
    standing: bool = False
    positions: frozenset[str] = frozenset()
    longitudinal: frozenset[str] = frozenset()


def _words(*words: str) -> frozenset[str]:
    return frozenset(words)


_LEFT = _words("front_left", "left", "rear_left", "front")
_RIGHT = _words("front_right", "right", "rear_right", "front")
_MEANING = {
    "stationary": _Meaning(_ANY_HEADING, _words("none"), standing=True),
    "same_direction": _Meaning(_words("same"), _words("none")),
    "oncoming": _Meaning(_words("opposite"), _words("none")),
    "cutting_in_from_left": _Meaning(_words("same"), _words("right"), positions=_LEFT),
    "cutting_in_from_right": _Meaning(_words("same"), _words("left"), positions=_RIGHT),
    "cutting_out": _Meaning(_words("same"), _words("left", "right")),
    "crossing_from_left": _Meaning(_words("rightwards"), _words("right")),
    "crossing_from_right": _Meaning(_words("leftwards"), _words("left")),
    "receding": _Meaning(_words("same"), _ANY_LATERAL, longitudinal=_words("opening")),
}


def motion_fits_words(view: View) -> Iterator[Failure]:
    """Heading, lateral change, speed trend and position are those of the cell's motion class."""
    for who, phase, cell in _others(view):
        meaning = _MEANING.get(cell.motion or "")
        if meaning is None:
            continue
        at = f"motion.{who}.{phase}"
        for name, wanted in (
            ("heading", meaning.heading),
            ("lateral", meaning.lateral),
            ("position", meaning.positions),
            ("longitudinal", meaning.longitudinal),
        ):
            if wanted and known(getattr(cell, name)) and getattr(cell, name) not in wanted:
                yield _fail(
                    f"{at}.{name}",
                    view.said(f"{at}.{name}", f"{at}.motion"),
                    f"{cell.motion} is another motion",
                    one_of(wanted),
                )
        if cell.speed_trend != UNRESOLVED and meaning.standing != (cell.speed_trend == "standing"):
            yield _fail(
                f"{at}.speed_trend",
                view.said(f"{at}.speed_trend", f"{at}.motion"),
                "who stands is stationary, and nobody else",
                "standing" if meaning.standing else "constant, increasing, decreasing or any",
            )


def vut_keeps_its_lane(view: View) -> Iterator[Failure]:
    """The VUT is the frame: it heads along the road and has no gap to itself."""
    for who, participant in view.event.participants.items():
        if participant.role != "VUT":
            continue
        for phase in PHASES:
            cell = view.cell(who, phase)
            if cell is None:
                continue
            wanted = {"heading": "same", "longitudinal": "none"}
            if phase == "approach":
                wanted["lateral"] = "none"
            for name, word in wanted.items():
                if getattr(cell, name) != word:
                    path = f"motion.{who}.{phase}.{name}"
                    yield _fail(
                        path,
                        view.said(path, f"participants.{who}.role"),
                        "the VUT's own direction of travel is what all is seen from",
                        word,
                    )


def gap_fits_speeds(view: View) -> Iterator[Failure]:
    """Whether the gap closes or opens follows from who is ahead, the headings and the speeds."""
    vut = view.event.vut_id
    for who, phase, cell in _others(view):
        at = f"motion.{who}.{phase}.longitudinal"
        ours = view.span(f"constraints.speeds.{vut}.{phase}")
        theirs = view.span(f"constraints.speeds.{who}.{phase}")
        if not known(cell.longitudinal) or ours is None or theirs is None:
            continue
        if not known(cell.heading) or not known(cell.position):
            continue
        ahead = (cell.position or "").startswith("front")
        along = {"same": 1.0, "opposite": -1.0}.get(cell.heading, 0.0)
        ends = sorted((along * theirs.low, along * theirs.high))
        slowest, fastest = ours.low - ends[1], ours.high - ends[0]
        if not ahead:
            slowest, fastest = -fastest, -slowest
        possible = {"none"} if slowest <= 0.0 <= fastest else set()
        possible |= {"closing"} if fastest > 0.0 else set()
        possible |= {"opening"} if slowest < 0.0 else set()
        if (cell.position or "") in ("left", "right"):
            continue  # beside: there is no gap along the path
        if cell.longitudinal not in possible:
            yield _fail(
                at,
                view.said(
                    at,
                    f"motion.{who}.{phase}.heading",
                    f"motion.{who}.{phase}.position",
                    f"constraints.speeds.{vut}.{phase}",
                    f"constraints.speeds.{who}.{phase}",
                ),
                "the gap can't change like this at these speeds",
                one_of(possible),
            )


def who_stands_is_passed(view: View) -> Iterator[Failure]:
    """Who stands throughout stays on its side of the VUT's path, and only ever falls behind."""
    for who, participant in view.event.participants.items():
        cells = {phase: view.cell(who, phase) for phase in PHASES}
        if any(cell is None or cell.speed_trend != "standing" for cell in cells.values()):
            continue
        course = _COURSES.get(participant.region.place.partition("_")[0], ())
        reached = 0
        for phase, cell in cells.items():
            word = cell.position if cell else None
            if not known(word) or not course:
                continue
            path = f"motion.{who}.{phase}.position"
            if word not in course[reached:]:
                yield _fail(
                    path,
                    view.said(path, f"participants.{who}.region.place"),
                    "who stands stays on its side, and isn't overtaken backwards",
                    one_of(course[reached:]),
                )
            else:
                reached = course.index(word)


def nobody_turns_round(view: View) -> Iterator[Failure]:
    """Heading stays the same from phase to phase."""
    for who in view.event.participants:
        before: PhaseWord | None = None
        for phase in PHASES:
            cell = view.cell(who, phase)
            if cell is None or not known(cell.heading):
                continue
            last = view.cell(who, before) if before else None
            if before and last and last.heading != cell.heading:
                paths = [f"motion.{who}.{at}.heading" for at in (phase, before)]
                yield _fail(
                    paths[0],
                    view.said(*paths),
                    "nobody turns round within an event",
                    str(last.heading),
                )
            before = phase


def _others(view: View) -> Iterator[tuple[str, PhaseWord, MotionCell]]:
    """Every cell of an OT."""
    for who, participant in view.event.participants.items():
        if participant.role == "OT":
            for phase in PHASES:
                cell = view.cell(who, phase)
                if cell is not None:
                    yield who, phase, cell


MOTION_PREDICATES: tuple[Predicate, ...] = (
    motion_fits_words,
    vut_keeps_its_lane,
    gap_fits_speeds,
    who_stands_is_passed,
    nobody_turns_round,
)
