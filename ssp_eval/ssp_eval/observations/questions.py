"""The questions to an observer, on the page and in a YAML template: none suggests an answer."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import permutations
from pathlib import Path
from typing import Any, Literal, get_args

from ssp_core.files.reading import parse_value
from ssp_core.run_file.values import Strict
from ssp_core.templates import templates
from ssp_core.vocabulary import MOTIONS, OBJECTS
from ssp_eval.observations.files import Footage
from ssp_eval.observations.model import REASONS
from ssp_scenario_manager.event_spec.model import BoundaryWord, RoadTypeWord, SegmentWord

MOST_LANES = 8
_HERE = Path(__file__).parent
_FILE = "questions.yaml.j2"
_GATE = {
    "deformation": "Does an object change its shape or material?",
    "identity": "Does an object turn into another one, vanish, or appear from nowhere?",
    "discontinuity": "Does something jump that matters for the event?",
    "road": "Do lanes, markings or edges of the road contradict each other?",
    "no_conflict": "Is there no conflict that could be named?",
}


class Ask(Strict):
    """One question: the place of its value in the file, its text, and how it is answered.

    The text is "" where the card's title asks it; each choice has a value and a text. A question
    that is ``optional`` may be left open without a word; ``idle_if`` is path and value that make it
    needless.
    """

    path: str
    label: str = ""
    kind: Literal["choice", "time", "share", "lines"] = "choice"
    words: tuple[tuple[Any, str], ...] = ()
    optional: bool = False
    idle_if: tuple[str, Any] | None = None


class Card(Strict):
    """Answers that rest on the same frames.

    ``path`` is that of the group in the file, "" where there are no frames to name; ``key`` sets
    its time to the frame that is shown; for ``whole_for`` all the recording's frames are evidence.
    """

    path: str = ""
    section: str
    title: str
    help: str = ""
    asks: tuple[Ask, ...]
    key: str = ""
    whole_for: tuple[Any, ...] = ()


def cards(vut: str, targets: Sequence[str], has_log: bool) -> list[Card]:
    """Return the questions about a recording, as questions.yaml.j2 has them.

    Args:
        vut: id of the VUT.
        targets: ids of the OTs.
        has_log: the recording has a log of ours, so that no declaration is needed.
    """
    subjects = {f"participants.{who}": who for who in targets}
    subjects["conflict_region"] = "the region of the conflict"
    gate = {reason: _GATE[reason] for reason in REASONS}
    template = templates(_HERE).get_template(_FILE)
    text = template.render(vut=vut, targets=targets, has_log=has_log, gate=gate, seen=subjects)
    vocabularies = _vocabularies(vut, targets)
    entries = parse_value(text, _FILE)
    for card in entries:
        for ask in card["asks"]:
            if isinstance(ask.get("words"), str):
                ask["words"] = vocabularies[ask["words"]]
    return [Card.model_validate(card) for card in entries]


def _vocabularies(vut: str, targets: Sequence[str]) -> dict[str, Sequence[tuple[Any, str]]]:
    """Return value and text of the choices that several questions have, or that others define."""
    lanes = [(n, str(n)) for n in range(MOST_LANES + 1)]
    words = {
        "segment": get_args(SegmentWord),
        "road_type": get_args(RoadTypeWord),
        "boundary": get_args(BoundaryWord),
        "class": OBJECTS,
        "motion": MOTIONS,
    }
    return {
        **{name: [(word, word.replace("_", " ")) for word in of] for name, of in words.items()},
        "lanes": lanes,
        "own_lanes": lanes[1:],
        "yes_no": [(True, "yes"), (False, "no")],
        "id": [(who, who) for who in (vut, *targets)],
        "order": [
            ([a, b], f"{a} before {b}")
            for a, b in permutations((vut, *targets), 2)
            if vut in (a, b)
        ],
    }


def blank(vut: str, targets: Sequence[str], has_log: bool) -> dict[str, Any]:
    """Return the observation file without any answer."""
    people = {vut: {"role": "VUT"}} | {who: {"role": "OT"} for who in targets}
    observation: dict[str, Any] = {"topology": {}, "roles": {"participants": people}}
    for name in ("dominant_motion", "conflict_type", "passing_order"):
        observation[name] = {}
    observation["phases"] = {"start_s": None, "end_s": None}
    for card in cards(vut, targets, has_log):
        for ask in card.asks:
            _set_at(observation, ask.path, None)
        if card.path:
            _set_at(observation, f"{card.path}.frames", [])
            _set_at(observation, f"{card.path}.note", None)
    return observation


def _set_at(node: dict[str, Any], path: str, value: Any) -> None:
    *parents, name = path.split(".")
    for parent in parents:
        node = node.setdefault(parent, {})
    node[name] = value


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


def template(bag: str, draft: dict[str, Any], questions: Sequence[Card], footage: Footage) -> str:
    """Return the text of the file, with what may be answered as comments.

    Args:
        bag: as it is named on the command line.
        draft: the file's content without answers.
        questions: cards whose questions become comments.
        footage: frames of the recording.
    """
    frames_s = footage.frames_s
    head = _HEAD.format(
        bag=bag, last=len(frames_s) - 1, first_s=frames_s[0], period_s=footage.period_s
    )
    comments = {ask.path: _comment(ask) for card in questions for ask in card.asks}
    comments |= {"who": "your name", "when": "null: when it is sealed"}
    groups = {card.path: (card.title, card.help) for card in questions if card.path}
    lines = []
    for key, value in draft.items():
        lines += [""] if isinstance(value, dict) else []
        lines += _lines(key, value, key, comments, groups)
    return head + "\n".join(lines) + "\n"


def _lines(
    key: str,
    value: Any,
    path: str,
    comments: Mapping[str, str],
    groups: Mapping[str, tuple[str, str]],
) -> Iterator[str]:
    """Yield the lines of a field and its content, each with its possible values."""
    pad = "  " * path.count(".")
    yield from (f"{pad}# {line}" for line in groups.get(path, ()) if line)
    if isinstance(value, dict):
        yield f"{pad}{key}:"
        for name, item in value.items():
            yield from _lines(name, item, f"{path}.{name}", comments, groups)
    else:
        comment = f"  # {comments[path]}" if path in comments else ""
        yield f"{pad}{key}: {_scalar(value)}{comment}"


def _comment(ask: Ask) -> str:
    of_kind = {
        "share": "throughout | never | a share from 0 to 1",
        "time": "s",
        "lines": "a list of texts; [] for nothing",
    }
    return of_kind.get(ask.kind, " | ".join(_scalar(value) for value, _ in ask.words))


def _scalar(value: Any) -> str:
    """Return JSON, but words without quotes."""
    plain = isinstance(value, str) and re.fullmatch(r"[\w ./]+", value)
    # A word that begins with a digit stays text where YAML would look for a number.
    return str(value) if plain and not value[0].isdigit() else json.dumps(value)
