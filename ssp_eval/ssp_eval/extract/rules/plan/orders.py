"""Stage 5c: when a verb is an order to the ego, is intended by it, or goes on with another."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.plan.steering import fills_cell
from ssp_eval.extract.rules.scope.echoes import opens_item
from ssp_eval.extract.rules.words.ego_verbs import LAT_ACTIONS, LON_ACTIONS, STEERING
from ssp_eval.extract.rules.words.notation import phrases

_LINKS = frozenset({Kind.JOIN, Kind.PURPOSE, Kind.THEN, Kind.CONDITION})
_ORDERS = frozenset({",", ":", ";", "\n", "[", '"', "(", "|"})
_PURPOSES = frozenset(phrases("intent, intention, plan, goal"))
_UNTIL = frozenset(phrases("until, till, to"))
REACH = 5
MAX_LINKS = 8


def is_order(
    words: list[str], hits: list[Hit], index: int, start: int, other: bool, key: str
) -> bool:
    """Whether a verb after somebody else's clause is an order to the ego.

    Args:
        words: words of the text.
        hits: all hits.
        index: the verb's.
        start: first hit of its sentence.
        other: somebody else, or a thing, is the subject.
        key: field of a structured answer in which it stands, "" for none.
    """
    hit = hits[index]
    if key in ("action", "lon_action", "lat_action"):
        return True
    previous = hits[index - 1] if index > start else None
    if previous is None:
        return not other
    if previous.value == ")" and opens_item(words, hits[index].first):
        return hit.form in ("base", "value")  # 3) slow down
    if previous.kind is Kind.READY and words[previous.first] in _PURPOSES:
        return hit.form == "base"  # given the rain the intent is to slow down
    if hit.form == "value":
        if previous.kind is Kind.QUOTE and previous.value == "on":
            return True
        sided = hit.value in ("change_left", "change_right")
        return previous.value in _ORDERS and not sided
    acts = hit.value in LON_ACTIONS or hit.value in LAT_ACTIONS or hit.value in STEERING
    return (
        hit.form == "base"
        and acts
        and (
            previous.value in (",", ":", "\n")
            or previous.kind is Kind.THEN
            or fills_cell(words, hits, index)
        )
    )


def sets_off(words: list[str], hit: Hit) -> bool:
    """The ego pulls away, but not from somebody."""
    after = words[hit.stop : hit.stop + 1]
    return words[hit.first].startswith("pull") and after != ["from"]


def is_intended(hits: list[Hit], index: int, start: int) -> bool:
    """Whether a verb is what its subject intends, and no more than is ready for."""
    for before in range(index - 1, max(index - REACH, start - 1), -1):
        if hits[before].kind is Kind.READY:
            return hits[before].value == "intend"
    return False


def is_linked(words: list[str], hits: list[Hit], before: int, index: int) -> bool:
    """Whether only and, to, then or until stand between an action and the one before it."""
    between = hits[before + 1 : index][:MAX_LINKS]
    joined = any(h.kind in _LINKS and h.value != "or" for h in between)
    listed = any(h.kind is Kind.MARK and h.value in ('"', "[", ";") for h in between)
    if words[hits[index].first] in _UNTIL:
        return True  # hard braking until standstill
    comma = (  # brake firmly, come to a halt
        hits[index].form == hits[before].form == "base"
        and LON_ACTIONS.get(hits[before].value) == "decelerate"
        and any(h.value == "," for h in between)
    )
    return (joined or comma) and not listed
