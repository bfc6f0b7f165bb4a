"""The questions to a vision model about a clip, and the words in which it may answer.

This is the one definition of the questions; its hash stands in the log with every extraction, and
a changed word here is a changed hash. The order is METHOD 1's: the road, the VUT, each OT, then
interaction and phases; and last what could speak against the clip (the source gate). How each
participant moves is asked after the phases, because part M says it per phase.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal, get_args

from ssp_core.hashing import sha256_json
from ssp_core.vocabulary import LAT_ACTIONS, LON_ACTIONS, MOTIONS, OBJECTS, POSITIONS
from ssp_scenario_manager.event_spec.model import UNRESOLVED, IntentWord, ManoeuvreWord

# word: one word; words: at least one; count: from min to max; frame: number of a frame.
Shape = Literal["word", "words", "count", "frame"]
# Words that are known only when the question is asked.
Live = Literal["kinds", "targets", "targets_or_none", "participants"]

PHASES_ASKED = ("trigger", "conflict", "resolution")
CELL_PHASES = ("approach", "trigger", "conflict", "resolution")
MAX_COUNT = 8
MAX_TARGETS = 4
NONE = "none"

# The gate's reasons (METHOD 1), by the key of the question about each.
GATE_REASONS = {
    "deformation": "material deformation of an object",
    "identity": "identity drift",
    "discontinuity": "discontinuous critical motion",
    "road": "inconsistent road relations",
    "no_conflict": "no identifiable conflict",
}


@dataclass(frozen=True)
class Ask:
    """One field of an answer.

    Args:
        key: in the answer.
        text: what it means, for the model; ``{kinds}`` stands for the known kinds of
            interaction with the first sentence of each one's module.
        shape: of the answer.
        words: the closed vocabulary, empty where it is live or a number of frames.
        live: words that depend on earlier answers; they stand before ``words``.
    """

    key: str
    text: str
    shape: Shape = "word"
    words: tuple[str, ...] = ()
    live: Live | None = None


@dataclass(frozen=True)
class Question:
    """One request to the model.

    Args:
        key: of the question; one about a participant adds its id.
        about: the clip; every OT by itself; VUT and every OT by itself.
        text: the question.
        asks: fields of the answer; for part M fields of a cell, one cell for each phase.
        layout: ``fields``: each field with confidence and evidence; ``list``: a list of objects
            with these fields; ``cells``: one cell per phase, each with confidence and evidence.
    """

    key: str
    about: Literal["clip", "target", "participant"]
    text: str
    asks: tuple[Ask, ...]
    layout: Literal["fields", "list", "cells"] = "fields"


RULES = (
    "You look at frames from the forward camera of a vehicle. That vehicle is called VUT; it is "
    "not visible itself. Other road users that matter are called OT. Frames are numbered from 1 "
    "and come with their time; left and right are the VUT's left and right.\n"
    "Rules:\n"
    "- Answer with one JSON object of the given schema and nothing else.\n"
    "- Use only the words that are listed. Where the frames don't show it, answer 'unresolved' "
    "(for a count, a wide range from min to max); where that isn't listed, give the likeliest word "
    "and a low confidence. Never guess a speed or a distance in numbers.\n"
    "- confidence: how sure you are, from 0 to 1. evidence: numbers of the frames in which it can "
    "be seen, at least one; for 'unresolved' the frames that you looked at."
)

ANNOTATION_TEXT = (
    "An annotation of this video exists. It may be wrong; what you see decides:\n{annotation}"
)
EARLIER_TEXT = "What was found so far: {earlier}"
AGAIN_TEXT = (
    "That answer can't be used: {problems}. Answer again, with one JSON object by the schema."
)
FRAME_TEXT = "Frame {index}, t = {t_s:.3f} s"


def _observable(*words: str) -> tuple[str, ...]:
    return (*words, UNRESOLVED)


_ROAD = Question(
    "road",
    "clip",
    "Describe the road that the VUT drives on, in the VUT's direction of travel.",
    (
        Ask(
            "road_type",
            "urban: streets with buildings, kerbs or pavements; rural: open country; motorway: "
            "grade-separated, no crossings; proving_ground: a test track.",
            words=_observable("urban", "rural", "motorway", "proving_ground"),
        ),
        Ask(
            "segment",
            "Shape of the stretch on which the event happens.",
            words=_observable("straight", "curve", "junction"),
        ),
        Ask("lanes_same_direction", "Lanes in the VUT's direction, the VUT's included.", "count"),
        Ask("lanes_opposite", "Lanes in the opposite direction; 0 on a one-way road.", "count"),
        Ask(
            "left_boundary",
            "What borders the carriageway on its left.",
            words=_observable("kerb", "sidewalk", "shoulder", "verge"),
        ),
        Ask(
            "right_boundary",
            "What borders the carriageway on its right.",
            words=_observable("kerb", "sidewalk", "shoulder", "verge"),
        ),
        Ask(
            "permitted_manoeuvres",
            "What markings, signs and road users show to be permitted here; crossing: of people.",
            "words",
            words=get_args(ManoeuvreWord),
        ),
    ),
)

_VUT = Question(
    "vut",
    "clip",
    "Describe the VUT, which carries the camera.",
    (
        Ask(
            "intent",
            "Where it means to go, judged by what it does before anybody gets in its way.",
            words=_observable(*get_args(IntentWord)),
        ),
        Ask(
            "class",
            "Kind of vehicle, if bonnet, mirrors or height of view show it.",
            words=_observable(*(word for word in OBJECTS if word != "pedestrian")),
        ),
        Ask(
            "vut_lane",
            "Its lane among the lanes in its direction; rightmost where there is just one.",
            words=_observable("rightmost", "middle", "leftmost"),
        ),
    ),
)

_TARGETS = Question(
    "targets",
    "clip",
    "List the OTs: road users that the VUT has to react to, or that hide one of them. Leave out "
    f"all others. At most {MAX_TARGETS}, the one whose manoeuvre makes the critical event first. "
    "An empty list says that there is none. description: how to recognise it, in one sentence.",
    (Ask("class", "Kind of road user.", words=OBJECTS),),
    layout="list",
)

_TARGET = Question(
    "target",
    "target",
    "Describe where {id} ({description}) is when it can first be seen.",
    (
        Ask(
            "place",
            "Lane, kerb or other road of a junction, in the VUT's direction of travel.",
            words=(
                "vut_lane",
                "left_lane",
                "right_lane",
                "left_kerb",
                "right_kerb",
                "oncoming_lane",
                "left_road",
                "right_road",
            ),
        ),
        Ask("along", "Relative to the VUT.", words=("ahead", "beside", "behind")),
    ),
)

_INTERACTION = Question(
    "interaction",
    "clip",
    "Describe the interaction between the VUT and the OTs that is the critical event.",
    (
        Ask(
            "type",
            "{kinds} none: there is no conflict.",
            live="kinds",
            words=(NONE,),
        ),
        Ask("initiator", "The OT whose manoeuvre makes the event.", live="targets"),
        Ask(
            "occluder", "The OT that hides the initiator at first, or none.", live="targets_or_none"
        ),
        Ask(
            "dominant_motion",
            "Motion of the initiator that holds longest during the event, seen from the VUT. "
            "crossing_from_left: it moves from the VUT's left to its right.",
            words=MOTIONS,
        ),
        Ask(
            "first",
            "Who is first at the place where their paths meet.",
            live="participants",
        ),
        Ask(
            "longitudinal_responses",
            "What the VUT may rightly do about it, all that apply.",
            "words",
            words=LON_ACTIONS,
        ),
        Ask(
            "lateral_responses",
            "Where the VUT may rightly steer, all that apply.",
            "words",
            words=LAT_ACTIONS,
        ),
    ),
)

_PHASES = Question(
    "phases",
    "clip",
    "Find where the phases of the event begin. For each, give the number of the first frame in "
    "which it has begun; 1 says that it has begun when the clip begins.",
    (
        Ask(
            "trigger",
            "The initiator's manoeuvre becomes visible: it moves sideways towards the VUT's path, "
            "takes the first step off the kerb, or its brake lights come on and it slows down.",
            "frame",
        ),
        Ask("conflict", "Without a reaction of either they would now meet.", "frame"),
        Ask("resolution", "From here on, and for good, they would no longer meet.", "frame"),
    ),
)

_CELL = (
    Ask(
        "heading",
        "Direction of travel against the VUT's, or in which it looks while it stands.",
        words=_observable("same", "opposite", "leftwards", "rightwards"),
    ),
    Ask(
        "speed_trend",
        "Its speed over the ground.",
        words=_observable("standing", "constant", "increasing", "decreasing"),
    ),
    Ask(
        "longitudinal",
        "Change of the gap between the VUT and it.",
        words=_observable("none", "closing", "opening"),
    ),
    Ask(
        "lateral",
        "Its sideways movement on the road, to the VUT's left or right.",
        words=_observable("none", "left", "right"),
    ),
)

_MOTION_VUT = Question(
    "motion_vut",
    "clip",
    "Describe how the VUT itself moves in each phase: {phases}.",
    tuple(ask for ask in _CELL if ask.key in ("speed_trend", "lateral")),
    layout="cells",
)

_MOTION = Question(
    "motion",
    "target",
    "Describe how {id} ({description}) moves in each phase: {phases}.",
    (
        Ask("position", "Where it is, seen from the VUT.", words=_observable(*POSITIONS)),
        Ask("motion", "How it moves, seen from the VUT.", words=_observable(*MOTIONS)),
        *_CELL,
    ),
    layout="cells",
)

_GATE = Question(
    "gate",
    "clip",
    "Judge whether the clip can stand for a real event. Answer yes where you see the fault.",
    (
        Ask(
            "deformation",
            "An object melts, splits, merges or changes its size or shape.",
            words=_observable("yes", "no"),
        ),
        Ask(
            "identity",
            "An object turns into another: its class, colour or kind changes.",
            words=_observable("yes", "no"),
        ),
        Ask(
            "discontinuity",
            "An object that matters jumps, vanishes or appears from nowhere.",
            words=_observable("yes", "no"),
        ),
        Ask(
            "road",
            "Lanes, markings or kerbs contradict each other or change between frames.",
            words=_observable("yes", "no"),
        ),
        Ask(
            "no_conflict",
            "No conflict between the VUT and anybody can be made out.",
            words=_observable("yes", "no"),
        ),
    ),
)

QUESTIONS: dict[str, Question] = {
    question.key: question
    for question in (
        _ROAD,
        _VUT,
        _TARGETS,
        _TARGET,
        _INTERACTION,
        _PHASES,
        _MOTION_VUT,
        _MOTION,
        _GATE,
    )
}

DEFINITION_SHA256 = sha256_json(
    {
        "rules": RULES,
        "annotation": ANNOTATION_TEXT,
        "earlier": EARLIER_TEXT,
        "again": AGAIN_TEXT,
        "frame": FRAME_TEXT,
        "max_count": MAX_COUNT,
        "max_targets": MAX_TARGETS,
        "questions": [asdict(question) for question in QUESTIONS.values()],
    }
)
