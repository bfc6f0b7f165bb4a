"""The road user that is the VUT: "the vehicle" or "the car" of a text that calls itself so."""

from __future__ import annotations

from ssp_eval.extract.lexicon import lexicon
from ssp_eval.extract.match import Hit

_NOUNS = ("vehicle", "car")
_OPENERS = frozenset({"mark", "cue"})
_TOLD = frozenset({"must", "will"})
_SPEEDS = frozenset({"decelerate", "stop", "accelerate", "maintain"})
US = frozenset({"us", "me"})  # who writes so doesn't call the VUT "the car" beside it
_FAR = 4  # words behind the noun: is driving past us
_ENDS = frozenset({".", "?", "!", ";", "\n"})
_STEPS = 3  # hits behind the noun among which its verb stands


def with_own_vehicle(words: list[str], hits: list[Hit]) -> list[Hit]:
    """Return the hits, where the VUT's own noun has become the VUT.

    A text may call the VUT "the vehicle" or "the car". It does so if no other road user has that
    noun, and the noun is the subject of what only the VUT is said to do.

    Args:
        words: the words of the text.
        hits: what was found in them.
    """
    owned = {noun for noun in _NOUNS if _is_own(noun, words, hits)}
    if not owned:
        return hits
    return [
        Hit("ego", "", "", hit.first, hit.stop) if _names(hit, words) in owned else hit
        for hit in hits
    ]


def _names(hit: Hit, words: list[str]) -> str:
    """Return the noun of "the vehicle" or "the car", else nothing."""
    if (
        hit.kind != "user"
        or hit.stop - hit.first != 1
        or words[hit.first - 1 : hit.first] != ["the"]
    ):
        return ""
    return words[hit.first] if words[hit.first] in _NOUNS else ""


def _is_own(noun: str, words: list[str], hits: list[Hit]) -> bool:
    mine = [index for index, hit in enumerate(hits) if _names(hit, words) == noun]
    if not mine:
        return False
    for index, hit in enumerate(hits):
        if hit.kind != "user" or index in mine or hit.value != "car":
            continue
        last = words[hit.stop - 1]
        if last.rstrip("s") == noun and (last == noun or noun == "vehicle"):
            return False  # a vehicle, the lead vehicle, parked vehicles
        if noun == "car" and index < mine[-1] and not last.endswith("s"):
            return False  # a van, and then the car
    if any(has_us(hits[index].stop, words) for index in mine):
        return False
    return any(_acts(index, hits) for index in mine)


def has_us(first: int, words: list[str]) -> bool:
    """Tell whether a sentence says "us" behind the noun: the car drives past us."""
    for word in words[first : first + _FAR]:
        if word in _ENDS:
            return False
        if word in US:
            return True
    return False


def _acts(index: int, hits: list[Hit]) -> bool:
    """Tell whether the noun opens a clause and does what the VUT decides on."""
    before = hits[index - 1].kind if index else "mark"
    if before not in _OPENERS:
        return False
    for hit in hits[index + 1 : index + 1 + _STEPS]:
        if hit.kind == "cue":
            if hit.value in _TOLD:
                return True
            continue
        if hit.kind == "verb":
            action = lexicon().verbs[hit.value].ego
            return action in _SPEEDS if hit.form == "ing" else bool(action) and hit.form != "ed"
        return hit.kind == "noun"
    return False
