"""A model's own text with one fact turned, to be given back to it before it plans.

A text whose words decide the plan changes it when it is turned; one that explains a plan that was
made otherwise doesn't. The words are those of the driving task's vocabulary in plain English.
"""

from __future__ import annotations

import re

from ssp_core.errors import PeerError
from ssp_vla_bridge.adapters.number_lists import find_rows

OBJECT, SIDE, ACTION, CONTROL = "object", "side", "action", "control"
# CONTROL gives the text back as it was.
FACTS = (OBJECT, SIDE, ACTION, CONTROL)

# The vehicle that the model drives is no object.
_OWN = r"(?<!\bmy )(?<!\byour )(?<!\bour )(?<!\bego )(?<!\bown )(?<!\bego-)"
_DRIVEN = "cars?|vehicles?|trucks?|lorry|lorries|vans?|bus(?:es)?|suvs?|sedans?"
_OTHERS = (
    "pedestrians?|persons?|people|cyclists?|bicyclists?|motorcyclists?|bicycles?|bikes?|"
    "motorcycles?|riders?"
)
_OBJECT = re.compile(rf"{_OWN}\b(?:({_DRIVEN})|({_OTHERS}))\b", re.IGNORECASE)
_SIDE = re.compile(r"\b(left|right)(?! (?:now|away|ahead|behind|before|after|in front))", re.I)
_SLOW = (
    r"slow(?:s|ing)?(?: down)?|brak(?:e|es|ing)(?: hard)?|decelerat(?:e|es|ing)|"
    r"stop(?:s|ping)?|yield(?:s|ing)?"
)
_FAST = (
    r"(?:keep|maintain)(?:s|ing)?(?: (?:my|your|the|its|our))?(?: \w+)? speed|"
    r"accelerat(?:e|es|ing)|speed(?:s|ing)? up"
)
_ACTION = re.compile(rf"\b(?:({_SLOW})|({_FAST}))\b", re.IGNORECASE)
# Sentences about what the model itself does: those of others brake as well.
_OF_ITSELF = re.compile(r"\b(?:i|we|my|our|your|ego|longitudinal|lateral)\b", re.IGNORECASE)
_SENTENCE = re.compile(r"[^.!?\n]*[.!?\n]*")


def turned(text: str, fact: str, is_plan: bool = False) -> str:
    """Return the text with one fact turned wherever it stands, or unchanged if it doesn't say it.

    A vehicle becomes a pedestrian and any other road user a car, left and right change places, and
    slowing down becomes accelerating and the other way round.

    Args:
        text: a stage's.
        fact: one of FACTS.
        is_plan: all of the text is about what the model itself does.
    """
    if fact == OBJECT:
        new_text = _OBJECT.sub(_other_object, text)
        return re.sub(r"\b(a)n(?= (?:pedestrian|car)\b)", r"\1", new_text, flags=re.IGNORECASE)
    if fact == SIDE:
        return _SIDE.sub(lambda m: _as("right" if m[1].lower() == "left" else "left", m[1]), text)
    if fact == ACTION:
        return _SENTENCE.sub(
            lambda m: (
                _ACTION.sub(_other_action, m[0]) if is_plan or _OF_ITSELF.search(m[0]) else m[0]
            ),
            text,
        )
    return text


def _other_object(match: re.Match[str]) -> str:
    word = match[0].lower()
    many = word == "people" or (word.endswith("s") and word != "bus")
    return _as(("pedestrian" if match[1] else "car") + ("s" if many else ""), match[0])


def _other_action(match: re.Match[str]) -> str:
    first = match[0].lower().split()[0]
    slow, fast = ("brake", "accelerate")
    stem = fast if match[1] else slow
    if first.endswith("ing"):
        return _as(stem[:-1] + "ing", match[0])
    return _as(stem + ("s" if first.endswith("s") else ""), match[0])


def _as(word: str, before: str) -> str:
    """Return the word, which may be an abbreviation, beginning as the one that it replaces."""
    return word.capitalize() if before.istitle() or before[:2].istitle() else word


def before_trajectory(text: str) -> str:
    """Return the text before the first row of numbers, the label of that row included.

    Raises:
        PeerError: it gives no numbers, or says nothing before them.
    """
    row = next(iter(find_rows(text)), None)
    preamble = "" if row is None else text[: row.start].rstrip(" \t[({")
    if not re.search(r"\w", preamble):
        raise PeerError("n/a: the answer has no text before a trajectory that could be given back")
    return preamble


def check_continued(completion: str) -> None:
    """Refuse a completion that begins anew instead of with the trajectory that was left open.

    Raises:
        PeerError: saying so.
    """
    row = next(iter(find_rows(completion)), None)
    begun = completion if row is None else completion[: row.start]
    if row is None or len(re.findall(r"[A-Za-z]{2,}", begun)) > 3:
        raise PeerError("n/a: the server doesn't go on with a text that is given, but begins anew")
