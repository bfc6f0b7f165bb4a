"""C1, part M: the words of each cell stand in valid relations, to each other and to the speeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ssp_core.vocabulary import PHASES, PhaseWord
from ssp_scenario_manager.spec.checks.base import Fail, Predicate, View, known, one_of
from ssp_scenario_manager.spec.failure import Failure
from ssp_scenario_manager.spec.model import UNRESOLVED, MotionCell

_fail = Fail("C1")

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


PREDICATES: tuple[Predicate, ...] = (
    motion_fits_words,
    vut_keeps_its_lane,
    gap_fits_speeds,
    who_stands_is_passed,
    nobody_turns_round,
)
