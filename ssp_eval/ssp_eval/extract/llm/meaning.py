"""What can be wrong with a quote by itself, before its place in the text is looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ssp_eval.extract.llm.prompt import NOBODY
from ssp_eval.extract.llm.reply import Proposal
from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.scope.scopes import SENTENCE_MARKS
from ssp_eval.extract.rules.words.ego_verbs import LAT_ACTIONS, LON_ACTIONS

ACTIONS: Mapping[str, Mapping[str, str]] = {"lon_action": LON_ACTIONS, "lat_action": LAT_ACTIONS}
# Words within a quote that change what it says, but for the labels that consist in that.
_OPERATORS = frozenset(
    {Kind.NOT, Kind.NO_LONGER, Kind.CONDITION, Kind.HISTORY, Kind.READY, Kind.REJECT}
    | {Kind.REJECTED, Kind.QUOTE, Kind.HYPOTHETICAL, Kind.FRAME, Kind.REVISE, Kind.NOBODY}
)
_CARRIED: Mapping[str, frozenset[Kind]] = {
    "no_conflict": frozenset({Kind.NOT}),
    "resolved": frozenset({Kind.NOT, Kind.NO_LONGER}),
    "potential": frozenset({Kind.MODAL, Kind.HYPOTHETICAL, Kind.READY}),
    "active": frozenset({Kind.READY}),
    NOBODY: frozenset({Kind.NOT, Kind.NOBODY}),
}
_POSSIBLE = frozenset({Kind.MODAL, Kind.HYPOTHETICAL, Kind.READY, Kind.RISK})
_RISKY = ("risk", "danger", "threat", "hazard", "potential", "possib", "chance", "likel")


def misquoted(
    proposal: Proposal, hits: Sequence[Hit], words: Sequence[str], first: int, stop: int
) -> str:
    """Why a quote can't support its label; empty where nothing speaks against it.

    Args:
        proposal: label and quote.
        hits: of the whole text.
        words: of the whole text.
        first: index of the quote's first word.
        stop: index after its last word.
    """
    touched = [hit for hit in hits if hit.stop > first and hit.first < stop]
    inside = [hit for hit in touched if hit.first >= first and hit.stop <= stop]
    carried = _CARRIED.get(proposal.label, frozenset())
    if any(_turns(hit) and (hit.kind not in carried or hit not in inside) for hit in touched):
        return "the quote holds a word that turns it round"
    if any(_is_another(proposal, hit) for hit in inside):
        return "the quote means something else"
    if not _names_side(proposal, words, first, stop):
        return "the quote names no such side"
    if proposal.label == "potential" and not (
        any(hit.kind in _POSSIBLE for hit in inside)
        or any(word.startswith(_RISKY) for word in words[first:stop])
    ):
        return "the quote says of nothing that it may happen"
    return ""


def _turns(hit: Hit) -> bool:
    """Whether a word changes what the words around it say."""
    kind, value = hit.kind, hit.value
    return (
        kind in _OPERATORS
        or (kind is Kind.MODAL and value == "may")
        or (kind is Kind.AUX and value == "past")
        or (kind is Kind.JOIN and value in ("or", "but"))
        or (kind is Kind.MARK and value in SENTENCE_MARKS | {";"})
    )


def _is_another(proposal: Proposal, hit: Hit) -> bool:
    """Whether the rules know a word as one for another label of the slot."""
    slot, label = proposal.slot, proposal.label
    if slot == "objects":
        return hit.kind is Kind.OBJECT and hit.value != label
    if slot in ACTIONS:
        return hit.kind is Kind.VERB and ACTIONS[slot].get(hit.value, label) != label
    if slot == "conflict":
        return hit.kind is Kind.CONFLICT and hit.value != label
    if slot == "position" and hit.kind in (Kind.PLACE, Kind.SIDE):
        parts = {*hit.value.split("_"), *label.split("_")}
        return {"left", "right"} <= parts or {"front", "rear"} <= parts
    return False


def _names_side(proposal: Proposal, words: Sequence[str], first: int, stop: int) -> bool:
    """Whether a label that is a side, or says where from, has that side in its words.

    An action's side must be quoted; where somebody comes from may stand in the sentence.
    """
    side = next((one for one in ("left", "right") if proposal.label.endswith(one)), "")
    if not side or proposal.slot == "position":
        return True
    if proposal.slot == "motion":
        while first and words[first - 1] not in SENTENCE_MARKS:
            first -= 1
        while stop < len(words) and words[stop] not in SENTENCE_MARKS:
            stop += 1
    return any(word.startswith(side) for word in words[first:stop])
