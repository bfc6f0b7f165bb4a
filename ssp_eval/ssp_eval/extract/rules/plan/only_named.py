"""Stage 5c: actions that a text only names: braking would be wrong, the reason for braking."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.words.ego_verbs import LON_ACTIONS
from ssp_eval.extract.rules.words.notation import phrases

_CLAUSE_ENDS = frozenset(
    {
        Kind.MARK,
        Kind.JOIN,
        Kind.EGO,
        Kind.OBJECT,
        Kind.RELATIVE,
        Kind.CONDITION,
        Kind.THEN,
    }
)
_TOPIC_ENDS = frozenset({Kind.MARK, Kind.JOIN, Kind.CONDITION, Kind.THEN, Kind.EGO})
_AUXILIARIES = frozenset({Kind.MODAL, Kind.AUX})
# Braking is … : the action is chosen after all.
_ADVISED = frozenset(
    phrases(
        """
        needed, required, necessary, right, best, appropriate, advisable, advised, called,
        recommended, safest, wise, only, reasonable, prudent, mandatory, essential, correct,
        chosen, sensible, due, indicated, planned, selected, warranted, do, enough, sufficient,
        suffice
        """
    )
)
# The reason for braking: named, not chosen; but the intention of braking is one.
_ABOUT = frozenset(phrases("for, of, about, from, than, like, between, against"))
_MEANT = frozenset(phrases("intention, plan, decision, favour, favor, purpose, action, goal"))
_KEPT_NOUNS = frozenset(phrases("speed, velocity, pace, lane, steering, wheel"))
REACH = 5


def is_only_named(words: list[str], hits: list[Hit], index: int, start: int, stop: int) -> bool:
    """Whether an action is what its clause speaks of, without choosing it.

    Args:
        words: words of the text.
        hits: all hits.
        index: the action's.
        start: first hit of its sentence.
        stop: hit after the sentence.
    """
    hit = hits[index]
    before = words[hit.first - 1] if hit.first else ""
    if _left_behind(words, hit):
        return True
    if hit.form == "noun" and before in ("the", "this") and not _kept(words, hit):
        described = any(one.kind is Kind.RELATIVE for one in hits[index + 1 : index + 4])
        return described or (hit.value in LON_ACTIONS and hit.value != "keep_speed")
    if hit.form == "ing" and hit.first > 1 and before in _ABOUT:
        return words[hit.first - 2] not in _MEANT
    if hit.form not in ("ing", "noun"):
        return False
    opens = index == start or hits[index - 1].kind in (Kind.MARK, Kind.JOIN, Kind.THEN)
    if not opens:
        return False
    if index == start and hit.form == "ing" and _is_subject(words, hits, index, stop):
        return True
    for after in range(index + 1, min(index + REACH, stop)):
        one = hits[after]
        if one.kind is Kind.NOT:
            return True
        if one.kind in _CLAUSE_ENDS:
            return False
        if one.kind in _AUXILIARIES:
            return not _ADVISED & set(words[one.stop : one.stop + 4])
        if one.kind is Kind.VERB and one.form == "s":
            return True
    return False


def _kept(words: list[str], hit: Hit) -> bool:
    """The speed is held; but not: the lane change."""
    return words[hit.first] in _KEPT_NOUNS and words[hit.stop - 1] != "change"


def _left_behind(words: list[str], hit: Hit) -> bool:
    """A change from "maintain" to "brake": the first is no longer the plan."""
    at = hit.first - 1
    after = hit.stop
    if at > 0 and words[at] == '"':
        at -= 1
        after += 1
    return at > 0 and words[at] == "from" and words[after : after + 1] == ["to"]


def _is_subject(words: list[str], hits: list[Hit], index: int, stop: int) -> bool:
    """Stopping for someone who may be waiting isn't proportionate: up to its own verb."""
    relative = False  # in a clause such as "who may be waiting", before its verb
    for after in range(index + 1, min(index + 2 * REACH, stop)):
        one, before = hits[after], hits[after - 1]
        if one.kind is Kind.RELATIVE:
            relative = True
        elif one.kind in _AUXILIARIES:
            if before.kind in _AUXILIARIES:
                continue
            if not relative:
                return not _ADVISED & set(words[one.stop : one.stop + 4])
            relative = False
        elif one.kind is Kind.VERB:
            relative = relative and one.form not in ("s", "ed", "base")
        elif one.value == "," and after + 1 < stop:
            following = hits[after + 1]
            if following.kind is Kind.MODAL and following.value == "may":
                return True  # Evading to the right, i.e. …, would be wrong
            relative = relative or following.kind in _CLAUSE_ENDS
            if following.kind in (Kind.EGO, Kind.OBJECT, Kind.VERB):
                return False
        elif one.kind in _TOPIC_ENDS and words[one.first] != "for":
            return False
    return False
