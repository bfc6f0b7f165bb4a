"""What an observer is asked, on the page and in a YAML template: nothing of it says an answer."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any, Literal, get_args

from ssp_core.vocabulary import MOTIONS, OBJECTS
from ssp_eval.data.audit import EVENT_PHASES
from ssp_eval.observations.model import MAY_LACK, REASONS, SCHEMA, PlaceWord, RelationWord
from ssp_scenario_manager.event_spec.model import BoundaryWord, RoadTypeWord, SegmentWord

Kind = Literal["choice", "time", "share", "lines"]
MOST_LANES = 8
YES_NO = ((True, "yes"), (False, "no"))

_PLACES = {
    "vut_lane": "in the VUT's lane",
    "left_lane": "one lane to the left",
    "right_lane": "one lane to the right",
    "oncoming_lane": "in an oncoming lane",
    "left_kerb": "beyond the left edge of the road",
    "right_kerb": "beyond the right edge of the road",
    "2_lanes_left": "two lanes to the left",
    "2_lanes_right": "two lanes to the right",
    "3_lanes_left": "three lanes to the left",
    "3_lanes_right": "three lanes to the right",
}
_RELATIONS = {
    "merge": "merge: it comes into the lane of the other",
    "crossing": "crossing: the paths cross",
    "following": "following: one behind the other in a lane",
    "oncoming": "oncoming: towards each other",
    "none": "none: the paths don't meet",
}
_LANES = {
    "rightmost": "the rightmost",
    "middle": "one in the middle",
    "leftmost": "the leftmost",
    "oncoming": "an oncoming one",
    "off the road": "none, it is off the road",
}
_PHASES = {
    "trigger": "The first instant at which the manoeuvre can be noticed: it begins to move "
    "sideways towards the other's lane and goes on doing so, takes the first step off the kerb, or "
    "begins to brake.",
    "conflict": "The first later instant at which the two come dangerously near: they would touch "
    "soon, or reach the place where their paths meet at nearly the same time.",
    "resolution": "The first later instant from which that is over for good.",
}
_GATE = {
    "deformation": "Does an object change its shape or material?",
    "identity": "Does an object turn into another one, vanish, or appear from nowhere?",
    "discontinuity": "Does something jump that matters for the event?",
    "road": "Do lanes, markings or edges of the road contradict each other?",
    "no_conflict": "Is there no conflict that could be named?",
}


@dataclass(frozen=True)
class Ask:
    """One answer.

    Args:
        path: of the value in the file.
        label: the question, "" where the card's title asks it.
        kind: how it is answered.
        words: value and text of each choice.
        optional: may be left open without a word.
        idle_if: path and value that make it needless.
    """

    path: str
    label: str
    kind: Kind = "choice"
    words: tuple[tuple[Any, str], ...] = ()
    optional: bool = False
    idle_if: tuple[str, Any] | None = None


@dataclass(frozen=True)
class Card:
    """Answers that rest on the same frames.

    Args:
        path: of the group in the file; "" where there are no frames to name.
        section: heading above it.
        title: what is asked.
        help: what counts as what.
        asks: its answers.
        key: that sets its time to the frame that is shown; "" for none.
        whole_for: answers that are about the whole recording, so that all its frames are evidence.
    """

    path: str
    section: str
    title: str
    help: str
    asks: tuple[Ask, ...]
    key: str = ""
    whole_for: tuple[Any, ...] = ()


def cards(vut: str, targets: Sequence[str], has_log: bool) -> list[Card]:
    """The questions about a recording.

    Args:
        vut: id of the VUT.
        targets: ids of the OTs.
        has_log: the recording has a log of ours, so that nobody needs to declare anything.
    """
    found = [*_road(), _roles(vut, targets), *_interaction(vut, targets), *_phases(), *_gate()]
    found += _visibility(targets)
    return found if has_log else [*found, _log()]


def blank(vut: str, targets: Sequence[str], has_log: bool) -> dict[str, Any]:
    """The file without any answer."""

    def seen(**answers: Any) -> dict[str, Any]:
        return {**answers, "frames": [], "note": None}

    def one() -> dict[str, Any]:
        return seen(value=None)

    people: dict[str, Any] = {vut: {"role": "VUT", "class": None}}
    people |= {who: {"role": "OT", "class": None, "starts_in": None} for who in targets}
    log = {"safety_abort": None, "identity_switch": None, "site_changes": None}
    return {
        "topology": seen(
            segment=None,
            lanes_same_direction=None,
            lanes_opposite=None,
            vut_lane=None,
            **dict.fromkeys(MAY_LACK),
        ),
        "roles": seen(participants=people, initiator=None, affected=None),
        "dominant_motion": one(),
        "conflict_type": one(),
        "passing_order": one(),
        "phases": {
            "start_s": None,
            "end_s": None,
            **{phase: seen(t_s=None) for phase in EVENT_PHASES},
        },
        "identity_stable": one(),
        "source_gate": {reason: one() for reason in REASONS},
        "visibility": {"participants": {who: one() for who in targets}, "conflict_region": one()},
        **({} if has_log else {"log": log}),
    }


def _road() -> list[Card]:
    edges = _plain(get_args(BoundaryWord))
    counts = tuple((n, str(n)) for n in range(MOST_LANES + 1))
    asks = (
        Ask("topology.segment", "The stretch of road is", words=_plain(get_args(SegmentWord))),
        Ask("topology.lanes_same_direction", "Lanes in the VUT's direction", words=counts[1:]),
        Ask("topology.lanes_opposite", "Oncoming lanes", words=counts),
        Ask(
            "topology.vut_lane",
            "The VUT's lane, where it is longest, is",
            words=tuple(_LANES.items()),
            idle_if=("topology.lanes_same_direction", 1),
        ),
        Ask("topology.road_type", "The road is", words=_plain(get_args(RoadTypeWord))),
        Ask("topology.left_boundary", "At its left edge is a", words=edges),
        Ask("topology.right_boundary", "At its right edge is a", words=edges),
    )
    return [
        Card(
            "topology",
            "Road",
            "The road that the VUT drives on",
            "The VUT is the vehicle that carries the camera. Left and right are its own.",
            asks,
        )
    ]


def _roles(vut: str, targets: Sequence[str]) -> Card:
    asks = [Ask(f"roles.participants.{vut}.class", f"{vut} is a", words=_plain(OBJECTS))]
    places = tuple((word, _PLACES[word]) for word in get_args(PlaceWord))
    for who in targets:
        asks += [
            Ask(f"roles.participants.{who}.class", f"{who} is a", words=_plain(OBJECTS)),
            Ask(f"roles.participants.{who}.starts_in", f"{who} starts", words=places),
        ]
    ids = tuple((who, who) for who in (vut, *targets))
    asks += [
        Ask("roles.initiator", "Whose manoeuvre is the event?", words=ids),
        Ask("roles.affected", "Whom does it affect?", words=ids),
    ]
    return Card(
        "roles",
        "Participants",
        "Who takes part",
        f"{vut} is the vehicle that carries the camera; its class can be told from the bonnet, the "
        "height of the camera, or from who recorded it. Places are those at the clip's beginning, "
        "seen from the VUT's lane.",
        tuple(asks),
    )


def _interaction(vut: str, targets: Sequence[str]) -> list[Card]:
    orders = tuple(
        ([a, b], f"{a} before {b}") for a, b in permutations((vut, *targets), 2) if vut in (a, b)
    )
    return [
        Card(
            "dominant_motion",
            "Interaction",
            "How does the other road user move for most of the time from trigger to resolution?",
            "The one whose event it is with the VUT. Over the ground, in the VUT's frame. Crossing "
            "from the left means that it moves from the VUT's left to its right.",
            (Ask("dominant_motion.value", "", words=_plain(MOTIONS)),),
        ),
        Card(
            "conflict_type",
            "Interaction",
            "How does the path of the one meet that of the other?",
            "",
            (
                Ask(
                    "conflict_type.value",
                    "",
                    words=tuple((word, _RELATIONS[word]) for word in get_args(RelationWord)),
                ),
            ),
        ),
        Card(
            "passing_order",
            "Interaction",
            "Who reaches the region of the conflict first?",
            "The region where their paths meet; for a lane change the part of the lane that is "
            "entered. Who never reaches it is the second.",
            (Ask("passing_order.value", "", words=orders),),
        ),
    ]


def _phases() -> list[Card]:
    found = [
        Card(
            f"phases.{phase}",
            "Phases",
            f"Where does the {phase} begin?",
            _PHASES[phase],
            (Ask(f"phases.{phase}.t_s", "", "time"),),
            key=phase[0],
        )
        for phase in EVENT_PHASES
    ]
    crop = (
        Ask("phases.start_s", "from", "time", optional=True),
        Ask("phases.end_s", "to", "time", optional=True),
    )
    text = "Only where the recording was to be cropped by hand; leave both open as a rule."
    return [*found, Card("", "Phases", "The clip, where it isn't the whole", text, crop)]


def _gate() -> list[Card]:
    stable = Card(
        "identity_stable",
        "Soundness",
        "Does everybody stay who he is, from the beginning to the end?",
        "",
        (Ask("identity_stable.value", "", words=YES_NO),),
        whole_for=(True,),
    )
    return [
        stable,
        *(
            Card(
                f"source_gate.{reason}",
                "Soundness",
                _GATE[reason],
                "",
                (Ask(f"source_gate.{reason}.value", "", words=YES_NO),),
                whole_for=(False,),
            )
            for reason in REASONS
        ),
    ]


def _visibility(targets: Sequence[str]) -> list[Card]:
    whom = [(f"participants.{who}", who) for who in targets]
    whom.append(("conflict_region", "the region of the conflict"))
    return [
        Card(
            f"visibility.{path}",
            "Visibility",
            f"How long can {name} be seen, from trigger to resolution?",
            "As a share of that time.",
            (Ask(f"visibility.{path}.value", "", "share"),),
            whole_for=("throughout", "never"),
        )
        for path, name in whom
    ]


def _log() -> Card:
    return Card(
        "",
        "Declaration",
        "What the recording itself can't show",
        "It has no log of ours. What you don't know of your own knowledge stays open.",
        (
            Ask("log.safety_abort", "Was the run aborted for safety?", words=YES_NO),
            Ask("log.identity_switch", "Did the tracking swap objects?", words=YES_NO),
            Ask(
                "log.site_changes",
                "What was changed on site? One change a line",
                "lines",
            ),
        ),
    )


def _plain(words: Sequence[str]) -> tuple[tuple[str, str], ...]:
    return tuple((word, word.replace("_", " ")) for word in words)


_HEAD = """\
# What you saw in this recording (METHOD 4.3). Look at the recording alone: not at the event's
# specification, and not at somebody else's observation.
#
# null means that you can't tell; the field is then unverified. "frames" are the frames that show
# the answer: numbers from 0 to {last}, or [first, last]. Every answer needs some.
# Frame n lies at about {first_s:.3f} s + n × {period_s:.4f} s. Times are clip times, s.
#
# Then: ssp audit observe {bag} --seal THIS_FILE
"""


def template(
    bag: str,
    about: dict[str, Any],
    vut: str,
    targets: Sequence[str],
    has_log: bool,
    frames_s: Sequence[float],
    period_s: float,
) -> str:
    """The text of the file.

    Args:
        bag: as it is named on the command line.
        about: recording, bag_sha256, scenario and event_version.
        vut: id of the VUT.
        targets: ids of the OTs.
        has_log: see cards.
        frames_s: clip times of the frames.
        period_s: between them.
    """
    questions = cards(vut, targets, has_log)
    groups = {card.path: card for card in questions if card.path}
    asks = {ask.path: (card, ask) for card in questions for ask in card.asks}
    head = _HEAD.format(bag=bag, last=len(frames_s) - 1, first_s=frames_s[0], period_s=period_s)
    lines = [f"schema: {SCHEMA}"]
    lines += [f"{key}: {_scalar(value)}" for key, value in about.items()]
    lines += [
        "who: null  # your name",
        "role: null",
        "when: null  # null: when it is sealed",
        "remark: null",
    ]
    for key, value in blank(vut, targets, has_log).items():
        lines += ["", *_lines(key, value, key, 0, groups, asks)]
    return head + "\n".join(lines) + "\n"


def _lines(
    key: str,
    value: Any,
    path: str,
    depth: int,
    groups: dict[str, Card],
    asks: dict[str, tuple[Card, Ask]],
) -> Iterator[str]:
    pad = "  " * depth
    if path in groups:
        card = groups[path]
        yield from (f"{pad}# {line}" for line in (card.title, card.help) if line)
    if isinstance(value, dict):
        yield f"{pad}{key}:"
        for name, item in value.items():
            yield from _lines(name, item, f"{path}.{name}", depth + 1, groups, asks)
        return
    comment = _comment(asks[path][1]) if path in asks else ""
    yield f"{pad}{key}: {_scalar(value)}" + (f"  # {comment}" if comment else "")


def _comment(ask: Ask) -> str:
    if ask.kind == "share":
        return "throughout | never | a share from 0 to 1"
    if ask.kind == "time":
        return "s"
    if ask.kind == "lines":
        return "a list of texts; [] for nothing"
    return " | ".join(_scalar(value) for value, _ in ask.words)


def _scalar(value: Any) -> str:
    """JSON, but words without quotes."""
    plain = isinstance(value, str) and value.replace("_", "").replace(" ", "").isalnum()
    # A word that begins with a digit stays text where YAML would look for a number.
    if plain and not value[0].isdigit():
        return str(value)
    return json.dumps(value)
