"""C1: participants, places and motions stand in valid relations."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import get_args

from ssp_core.vocabulary import PHASES, PhaseWord
from ssp_scenario_manager.checks.base import (
    Fail,
    Failure,
    Predicate,
    View,
    has_meaning,
    one_of,
)
from ssp_scenario_manager.event_spec.model import UNRESOLVED, IntentWord, Participant
from ssp_scenario_manager.scenarios.base import Kind

_fail = Fail("C1")

_VUT_CLASSES = frozenset({"car", "truck", "bus"})


def one_vut(view: View) -> Iterator[Failure]:
    """Check that exactly one participant is the VUT."""
    vuts = [who for who, p in view.event.participants.items() if p.role == "VUT"]
    if len(vuts) == 1:
        return
    affected = view.event.interaction.affected
    for who in [who for who in vuts if who != affected] or [affected]:
        yield _fail(
            view,
            "an event has exactly one vehicle under test",
            "give one participant the role VUT and the others OT",
            f"participants.{who}.role",
            evidence=f"VUTs: {', '.join(vuts) or 'none'}",
        )


def same_ids_everywhere(view: View) -> Iterator[Failure]:
    """Check that parts A, M and C speak of the same ids."""
    ids, event = set(view.event.participants), view.event
    for part, by_id in (
        ("motion", set(event.motion)),
        ("constraints.speeds", set(event.constraints.speeds)),
    ):
        for who in sorted(ids ^ by_id):
            yield _fail(
                view,
                "names an id that is no participant" if who in by_id else "lacks a participant",
                "use the participants' own ids in every part",
                f"{part}.{who}",
                evidence=f"participants: {one_of(ids)}; {part}: {one_of(by_id)}",
            )


def every_phase(view: View) -> Iterator[Failure]:
    """Check that parts M and C have each participant in all four phases."""
    motion, speeds = view.event.motion, view.event.constraints.speeds
    phases_by_part = {
        "motion": {who: set(cells) for who, cells in motion.items()},
        "constraints.speeds": {who: set(by_phase) for who, by_phase in speeds.items()},
    }
    for part, by_id in phases_by_part.items():
        for who, phases in sorted(by_id.items()):
            for phase in PHASES:
                if phase not in phases:
                    yield _fail(
                        view,
                        "an id must be the same, and known, in every phase",
                        f"give {who} in all of {', '.join(PHASES)}",
                        f"{part}.{who}.{phase}",
                        evidence=f"{part}.{who} has {one_of(phases) or 'nothing'}",
                    )


def interaction_names_participants(view: View) -> Iterator[Failure]:
    """Check that the initiator, an OT, and the VUT, affected, alone pass the conflict point."""
    interaction = view.event.interaction
    roles = {who: p.role for who, p in view.event.participants.items()}
    for name, role in (("initiator", "OT"), ("affected", "VUT")):
        who = getattr(interaction, name)
        if roles.get(who) != role:
            yield _fail(
                view,
                f"the {name} must be a participant with role {role}",
                f"one of {one_of(k for k, v in roles.items() if v == role) or 'none'}",
                f"interaction.{name}",
                f"participants.{who}.role",
            )
    both = {interaction.initiator, interaction.affected}
    if set(interaction.passing_order) != both or len(both) < 2:
        yield _fail(
            view,
            "initiator and affected, each once, pass the conflict point",
            f"name {one_of(both)}, the first to arrive first",
            "interaction.passing_order",
            "interaction.initiator",
            "interaction.affected",
        )
    yield from _fail.unless(
        view,
        view.event.constraints.trigger.object,
        [interaction.initiator],
        "the trigger is measured to the OT whose manoeuvre it fires",
        "constraints.trigger.object",
        "interaction.initiator",
    )


def classes_fit_roles(view: View) -> Iterator[Failure]:
    """Check that VUT and initiator are of classes that can do what they do."""
    event, kind = view.event, view.kind
    for who, participant in event.participants.items():
        if participant.role == "VUT":
            path, reason = f"participants.{who}.class", "can't be a vehicle under test"
            yield from _fail.unless(view, participant.class_, _VUT_CLASSES, reason, path)
    initiator = event.participants.get(view.initiator)
    if kind and initiator:
        yield from _fail.unless(
            view,
            initiator.class_,
            kind.initiator_classes,
            f"can't be the initiator of {kind.name}",
            f"participants.{view.initiator}.class",
            "interaction.type",
        )


def only_the_vut_has_an_intent(view: View) -> Iterator[Failure]:
    """Check that the VUT states where it means to go, and no other participant does."""
    for who, participant in view.event.participants.items():
        paths = f"participants.{who}.intent", f"participants.{who}.role"
        if participant.role == "VUT" and participant.intent is None:
            reason = "the VUT's intent is missing (METHOD 1)"
            yield _fail(view, reason, one_of(get_args(IntentWord)), *paths)
        if participant.role != "VUT" and participant.intent is not None:
            reason = "the intent is the VUT's; what an OT does stands in part M"
            yield _fail(view, reason, "no intent", *paths)


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
# Where who starts in a place is seen from the VUT: on this side, by `along` in front or behind.
_SIDE_OF = {
    "left_lane": "left",
    "left_kerb": "left",
    "left_road": "left",
    "oncoming_lane": "left",
    "right_lane": "right",
    "right_kerb": "right",
    "right_road": "right",
}
_SEEN = {("vut_lane", "ahead"): "front", ("vut_lane", "behind"): "rear"} | {
    (place, along): seen.format(side)
    for place, side in _SIDE_OF.items()
    for along, seen in (("ahead", "front_{}"), ("beside", "{}"), ("behind", "rear_{}"))
}


def vut_drives_along_the_road(view: View) -> Iterator[Failure]:
    """Check that the VUT starts in its own lane, not seen from itself; OTs are seen from it."""
    for who, participant in view.event.participants.items():
        region, at = participant.region, f"participants.{who}.region"
        is_vut, role = participant.role == "VUT", f"participants.{who}.role"
        astray = is_vut and region.place != "vut_lane"
        if astray or is_vut != (region.along == "at"):
            yield _fail(
                view,
                "the VUT, and no other participant, starts at the VUT's own entry",
                "vut_lane, at" if is_vut else "ahead, beside or behind",
                f"{at}.place" if astray else f"{at}.along",
                evidence=view.evidence(f"{at}.place", f"{at}.along", role),
            )
        gap = view.span(f"{at}.gap")
        if gap and is_vut != (gap.low == gap.high == 0.0):
            remedy = "0 m" if is_vut else "an interval above 0 m"
            reason = "only the VUT has no distance to itself"
            yield _fail(view, reason, remedy, f"{at}.gap", role)
    for who, participant, phase, cell in view.cells():
        is_vut = participant.role == "VUT"
        for name in ("position", "motion"):
            if is_vut != (getattr(cell, name) is None):
                yield _fail(
                    view,
                    "position and motion are those of others, seen from the VUT",
                    "null" if is_vut else "a word of the vocabulary (METHOD 5.1)",
                    f"motion.{who}.{phase}.{name}",
                    f"participants.{who}.role",
                )


def places_exist(view: View) -> Iterator[Failure]:
    """Check that part T's road has the lanes and boundaries that part A puts participants in."""
    topology = view.event.topology
    lanes, opposite = topology.lanes_same_direction.range, topology.lanes_opposite.range
    fewest = math.inf if lanes is None else lanes.min
    least = 3 if "middle" in topology.vut_lane.words else 1
    same, mine = "topology.lanes_same_direction", "topology.vut_lane"
    if fewest < least:
        yield _fail(view, "the VUT's lane isn't there", f"at least {least}", same, mine)
    for who, participant in view.event.participants.items():
        place, path = participant.region.place, f"participants.{who}.region.place"
        if fewest < _NEEDS_LANES.get(place, 0):
            remedy = "another place, or at least 2 lanes in this direction"
            yield _fail(view, "the road need not have such a lane", remedy, path, same)
        if topology.vut_lane.words == _NO_LANE_BESIDE.get(place):
            remedy = "a place on the VUT's other side"
            yield _fail(view, "the VUT has no lane on that side", remedy, path, mine)
        if place == "oncoming_lane" and opposite is not None and opposite.min < 1:
            yield _fail(
                view,
                "the road need not have a lane in the opposite direction",
                "another place, or at least 1 lane in the opposite direction",
                path,
                "topology.lanes_opposite",
            )
        side = _KERBS.get(place)
        words = getattr(topology, side).words if side else ()
        if words and not _WALKABLE & set(words):
            remedy = f"another place, or topology.{side} kerb or sidewalk"
            reason = "there is no place to stand beside this road"
            yield _fail(view, reason, remedy, path, f"topology.{side}")


def first_seen_where_they_start(view: View) -> Iterator[Failure]:
    """Require that an OT is first seen where part A puts it, as a class that may be there."""
    for who, participant, phase, cell in view.cells():
        if phase != "approach" or participant.role == "VUT":
            continue
        region, at = participant.region, f"participants.{who}.region"
        start_position = _SEEN.get((region.place, region.along))
        if start_position is None:
            reason, remedy = "no object can be there: the VUT is", "ahead or behind"
            yield _fail(view, reason, remedy, f"{at}.along", f"{at}.place")
        elif has_meaning(cell.position) and cell.position != start_position:
            path, reason = f"motion.{who}.approach.position", "is seen elsewhere than it starts"
            yield _fail(view, reason, start_position, path, f"{at}.place", f"{at}.along")
        if who == view.initiator and view.kind and _is_in_its_lane(view.kind, participant):
            continue
        walker = participant.class_ in ("pedestrian", "cyclist")
        parked = region.place in _KERBS and cell.speed_trend == "standing"
        if (region.place not in _KERBS) == walker and not parked:
            yield _fail(
                view,
                "pedestrians and cyclists start beside the carriageway, moving vehicles on it",
                "a kerb" if walker else "a lane",
                f"{at}.place",
                f"participants.{who}.class",
                f"motion.{who}.approach.speed_trend",
            )


def _is_in_its_lane(kind: Kind, initiator: Participant) -> bool:
    """Tell whether the kind wants its initiator, whatever its class, in the VUT's lane."""
    return initiator.class_ in kind.initiator_classes and all(
        places == {initiator.region.place} == {"vut_lane"}
        for places in kind.initiator_places.values()
    )


def occluder_hides(view: View) -> Iterator[Failure]:
    """Check that an occluder is there exactly if needed: large, before the initiator.

    It stands, or leaves its lane in the trigger phase where that is the kind's event.
    """
    event, kind, path = view.event, view.kind, "interaction.occluder"
    who = event.interaction.occluder
    if kind and kind.needs_occluder != (who is not None):
        reason = f"{kind.name} {'needs' if kind.needs_occluder else 'has no'} occluder"
        remedy = "the id of another OT" if kind.needs_occluder else "null"
        yield _fail(view, reason, remedy, path, "interaction.type")
    if who is None:
        return
    hiding, hidden = event.participants.get(who), event.participants.get(view.initiator)
    if hiding is None or hiding.role != "OT" or who == view.initiator:
        reason, remedy = "what hides the initiator is another OT", "the id of another OT"
        yield _fail(view, reason, remedy, path, "interaction.initiator")
        return
    reason, at = "is too small to hide a road user", f"participants.{who}"
    yield from _fail.unless(view, hiding.class_, _HIDING_CLASSES, reason, f"{at}.class", path)
    leaves = kind is not None and kind.occluder_leaves
    for other, _, phase, cell in view.cells():
        if other != who:
            continue
        names = ("speed_trend", "lateral", "motion")
        trend, lateral, motion = (f"motion.{who}.{phase}.{name}" for name in names)
        if not leaves and cell.speed_trend != "standing":
            yield _fail(view, "an occluder stands in every phase", "standing", trend, path)
        if leaves and cell.speed_trend == "standing":
            yield _fail(view, "what leaves the lane drives in every phase", "constant", trend, path)
        if leaves and phase == "trigger":
            reason = "the occluder leaves the lane in the trigger phase"
            if cell.lateral not in ("left", "right"):
                yield _fail(view, reason, "left or right", lateral, path)
            yield from _fail.unless(view, cell.motion, ["cutting_out"], reason, motion, path)
    if hidden is None:
        return
    for name in ("place", "along"):
        yield from _fail.unless(
            view,
            getattr(hiding.region, name),
            [getattr(hidden.region, name)],
            "an occluder stands on the side that the initiator comes from",
            f"{at}.region.{name}",
            f"participants.{view.initiator}.region.{name}",
        )
    gaps = [f"participants.{i}.region.gap" for i in (who, view.initiator)]
    spans = view.spans(*gaps)
    if spans and not (spans[0].low < spans[1].low and spans[0].high < spans[1].high):
        reason = "an occluder stands nearer to the VUT than whom it hides"
        yield _fail(view, reason, f"less than {gaps[1]} at both ends", *gaps)


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
    """The restrictions that a motion class puts on the other words of its cell.

    An empty set: none.
    """

    heading: frozenset[str]
    lateral: frozenset[str]
    standing: bool = False
    position: frozenset[str] = frozenset()
    longitudinal: frozenset[str] = frozenset()


def _words(*words: str) -> frozenset[str]:
    return frozenset(words)


_LEFT = _words("front_left", "left", "rear_left", "front")
_RIGHT = _words("front_right", "right", "rear_right", "front")
_MEANING = {
    "stationary": _Meaning(_ANY_HEADING, _words("none"), standing=True),
    "same_direction": _Meaning(_words("same"), _words("none")),
    "oncoming": _Meaning(_words("opposite"), _words("none")),
    "cutting_in_from_left": _Meaning(_words("same"), _words("right"), position=_LEFT),
    "cutting_in_from_right": _Meaning(_words("same"), _words("left"), position=_RIGHT),
    "cutting_out": _Meaning(_words("same"), _words("left", "right")),
    "crossing_from_left": _Meaning(_words("rightwards"), _words("right")),
    "crossing_from_right": _Meaning(_words("leftwards"), _words("left")),
    "receding": _Meaning(_words("same"), _ANY_LATERAL, longitudinal=_words("opening")),
}


def motion_fits_words(view: View) -> Iterator[Failure]:
    """Check that heading, lateral change, speed trend and position fit the motion class."""
    for who, participant, phase, cell in view.cells():
        meaning, at = _MEANING.get(cell.motion or ""), f"motion.{who}.{phase}"
        if meaning is None or participant.role != "OT":
            continue
        turns = who == view.initiator and view.kind is not None and view.kind.turn is not None
        for name in ("heading", "lateral", "position", "longitudinal"):
            choices, word = getattr(meaning, name), getattr(cell, name)
            if name == "lateral" and turns and cell.motion == "oncoming":
                continue
            if choices and has_meaning(word):
                reason = f"{cell.motion} is another motion"
                yield from _fail.unless(view, word, choices, reason, f"{at}.{name}", f"{at}.motion")
        if cell.speed_trend != UNRESOLVED and meaning.standing != (cell.speed_trend == "standing"):
            yield _fail(
                view,
                "a participant that stands is stationary, and no other is",
                "standing" if meaning.standing else "constant, increasing, decreasing or any",
                f"{at}.speed_trend",
                f"{at}.motion",
            )


def vut_keeps_its_lane(view: View) -> Iterator[Failure]:
    """Check that the VUT is the frame: it heads along the road and has no gap to itself."""
    for who, participant, phase, cell in view.cells():
        if participant.role != "VUT":
            continue
        words_by_name = {"heading": "same", "longitudinal": "none"}
        if phase == "approach":
            words_by_name["lateral"] = "none"
        for name, word in words_by_name.items():
            yield from _fail.unless(
                view,
                getattr(cell, name),
                [word],
                "the VUT's own direction of travel is what all is seen from",
                f"motion.{who}.{phase}.{name}",
                f"participants.{who}.role",
            )


def gap_fits_speeds(view: View) -> Iterator[Failure]:
    """Require that the gap closes or opens as its sides, headings and speeds imply."""
    vut = view.event.vut_id
    for who, participant, phase, cell in view.cells():
        at = f"motion.{who}.{phase}"
        speeds = [f"constraints.speeds.{i}.{phase}" for i in (vut, who)]
        spans, words = view.spans(*speeds), (cell.longitudinal, cell.heading, cell.position)
        if participant.role != "OT" or spans is None or not all(map(has_meaning, words)):
            continue
        if cell.position in ("left", "right"):
            continue  # beside: there is no gap along the path
        ours, theirs = spans
        along = {"same": 1.0, "opposite": -1.0}.get(cell.heading, 0.0)
        ends = sorted((along * theirs.low, along * theirs.high))
        slowest, fastest = ours.low - ends[1], ours.high - ends[0]
        if not (cell.position or "").startswith("front"):
            slowest, fastest = -fastest, -slowest
        possible = {"none"} if slowest <= 0.0 <= fastest else set()
        possible |= {"closing"} if fastest > 0.0 else set()
        possible |= {"opening"} if slowest < 0.0 else set()
        yield from _fail.unless(
            view,
            cell.longitudinal,
            possible,
            "the gap can't change like this at these speeds",
            *(f"{at}.{name}" for name in ("longitudinal", "heading", "position")),
            *speeds,
        )


def who_stands_is_passed(view: View) -> Iterator[Failure]:
    """Require that an object which stands throughout keeps its side and falls behind the VUT."""
    for who, participant in view.event.participants.items():
        cells = {phase: view.cell(who, phase) for phase in PHASES}
        if any(cell is None or cell.speed_trend != "standing" for cell in cells.values()):
            continue
        place = f"participants.{who}.region.place"
        course = _COURSES.get(participant.region.place.partition("_")[0], ())
        reached = 0
        for phase, cell in cells.items():
            word = cell.position if cell else None
            if not has_meaning(word) or not course:
                continue
            reason = "who stands stays on its side, and isn't overtaken backwards"
            path = f"motion.{who}.{phase}.position"
            yield from _fail.unless(view, word, course[reached:], reason, path, place)
            if word in course[reached:]:
                reached = course.index(str(word))


def nobody_turns_round(view: View) -> Iterator[Failure]:
    """Check that the heading stays the same from phase to phase, but for the kind's turn."""
    before: tuple[str, str, str] = ("", "", "")
    for who, _, phase, cell in view.cells():
        if not has_meaning(cell.heading):
            continue
        path = f"motion.{who}.{phase}.heading"
        turn = view.kind.turn if view.kind and who == view.initiator else None
        if before[0] == who and (before[2], cell.heading) != turn:
            reason = "no participant turns round within an event"
            yield from _fail.unless(view, cell.heading, [before[2]], reason, path, before[1])
        before = who, path, cell.heading


_TOWARDS = {"leftwards": "left", "rightwards": "right"}


def initiator_turns(view: View) -> Iterator[Failure]:
    """Check that the initiator of a kind that turns does so, from its trigger on."""
    if view.kind is None or view.kind.turn is None:
        return
    before, after = view.kind.turn
    demanded: tuple[tuple[PhaseWord, str, str], ...] = (
        ("approach", "heading", before),
        ("trigger", "lateral", _TOWARDS[after]),
        ("conflict", "lateral", _TOWARDS[after]),
        ("resolution", "heading", after),
    )
    for phase, name, word in demanded:
        cell = view.cell(view.initiator, phase)
        if cell is not None:
            yield from _fail.unless(
                view,
                getattr(cell, name),
                [word],
                f"the initiator of {view.kind.name} turns, from {before} to {after}",
                f"motion.{view.initiator}.{phase}.{name}",
                "interaction.type",
            )


MOTION_PREDICATES: tuple[Predicate, ...] = (
    motion_fits_words,
    vut_keeps_its_lane,
    gap_fits_speeds,
    who_stands_is_passed,
    nobody_turns_round,
    initiator_turns,
)
