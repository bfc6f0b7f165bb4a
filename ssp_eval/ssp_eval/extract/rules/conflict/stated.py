"""Stage 5: whether there is a conflict, and with whom."""

from __future__ import annotations

from ssp_eval.extract.rules.actors import identity
from ssp_eval.extract.rules.conflict import possible
from ssp_eval.extract.rules.free_phrases import dangers, settling
from ssp_eval.extract.rules.hits import MARKS, Hit, Kind
from ssp_eval.extract.rules.scope.flags import Scope
from ssp_eval.extract.rules.talk import EGO, SCENE, Talk
from ssp_eval.extract.rules.words.notation import phrases
from ssp_eval.extract.rules.world import Actor, Statement

_ANYMORE = frozenset(phrases("anymore, more, longer"))
_IGNORED = {
    "no_conflict": Scope.AHEAD,
    "resolved": Scope.PAST,
    "potential": Scope.POSSIBLE,
}
_EXISTS = frozenset(phrases("exists, exist, present, there, applies, holds, given"))
_REMAINS = frozenset(phrases("remains, remain, remaining, persists"))
_ITS = frozenset(phrases("it, he, she, they"))
_CRASHING = frozenset(
    phrases(
        """
        hitting, colliding, crashing, being, running, ramming, brushing, touching, scraping,
        clipping, sideswiping, grazing, bumping, getting, losing, closing, rear, striking, knocking,
        overlapping, sliding, falling, contacting
        """
    )
)
_NONE = frozenset(phrases("none, no, nil, zero, negligible"))
_DOUBTFUL = frozenset(phrases("may, might, could"))
_REACT = frozenset(phrases("react, act, respond, reaction, intervene"))
_MUST = frozenset(phrases("must, need, needs, have, required, immediately, requires, now"))
_DENIABLE = Scope.DENIED | Scope.AHEAD | Scope.POSSIBLE
_UNREAL = Scope.QUOTED | Scope.PAST
_SPECIFIC = frozenset(phrases("rear, skidding, aquaplaning"))


def read_risk(talk: Talk, index: int, hit: Hit) -> None:
    flags = talk.flags[index]
    before = talk.words[max(hit.first - 2, 0) : hit.first]
    if {"other", "additional", "that"} & set(before):
        return
    if _tabled(talk, hit):
        return
    if talk.words[hit.stop - 1] != "of" and talk.words[hit.stop : hit.stop + 1] == ["of"]:
        of = talk.words[hit.stop + 1 : hit.stop + 2]
        if of and of[0].endswith("ing") and of[0] not in _CRASHING:
            return  # the danger of frightening the animal
    over = settling.settled(talk.words, hit.stop - 1) if flags == 0 else None
    if over is not None and talk.words[hit.stop - 1] in settling.HEADS:
        named = _about(talk, index, talk.hits[index + 1] if index + 1 < talk.stop else None)
        value = settling.outcome(talk.words, over)
        said = Statement(value, hit.first, over, talk.number)
        (named or talk.conflicted()).conflicts.append(said)
        return
    settle = talk.hits[index + 1 : min(index + 4, talk.stop)]
    if any(one.kind is Kind.CONFLICT for one in settle):
        return
    first = hit.first
    if flags & Scope.GONE and not flags & ~(Scope.GONE | _DENIABLE):
        value = "resolved"
        first = _back_to(talk, index, Kind.NO_LONGER)
    elif not flags and _is_over(talk, index):
        value = "resolved"
    elif not flags and "nothing" in talk.words[max(hit.first - 3, 0) : hit.first]:
        value = "no_conflict"
        first = talk.words.index("nothing", max(hit.first - 3, 0))
    elif flags & Scope.DENIED and not flags & ~_DENIABLE and not _modal(talk, index):
        first = _back_to(talk, index, Kind.NOT)
        value = "resolved" if _any_more(talk, first, hit) else "no_conflict"
        beyond = talk.words[max(hit.first - 3, 0) : hit.stop + 4]
        if value == "no_conflict" and (talk.subject is SCENE or _SPECIFIC & set(beyond)):
            return
    elif flags == Scope.POSSIBLE or (not flags and _stands(talk, hit)):
        value = "potential"
    else:
        return
    following = talk.hits[index + 1] if index + 1 < talk.stop else None
    named = _about(talk, index, following)
    said = Statement(value, first, hit.stop, talk.number)
    (named or talk.conflicted()).conflicts.append(said)


def _is_over(talk: Talk, index: int) -> bool:
    """The hazard no longer exists."""
    after = talk.hits[index + 1] if index + 1 < talk.stop else None
    return (
        after is not None
        and after.kind is Kind.NO_LONGER
        and after.first == talk.hits[index].stop
        and not _EXISTS.isdisjoint(talk.words[after.stop : after.stop + 1])
    )


def _stands(talk: Talk, hit: Hit) -> bool:
    """A risk; a conflict only where it may develop; not risks in general."""
    after = talk.words[hit.stop : hit.stop + 2]
    if hit.value == "alone":
        general = talk.words[hit.stop - 1].endswith("s") and after[:1] in (["must"], ["should"])
        return not general
    return bool(after) and (after[0] in _DOUBTFUL or "possible" in after)


def _tabled(talk: Talk, hit: Hit) -> bool:
    """Risk: none; the field's name where it doesn't open a line, or a cell beside it."""
    after = talk.words[hit.stop : hit.stop + 7]
    for at, word in enumerate(after[:5]):
        if word in (":", "|", "=", "is"):
            value = after[at + 1 : at + 2]
            if not value or value[0] not in _NONE or (word == "is" and value[0] == "no"):
                return False
            gone = bool(
                {"longer", "anymore"} & set(after) or after[at + 2 : at + 4] == ["any", "more"]
            )
            told = "resolved" if gone else "no_conflict"
            said = Statement(told, hit.first, hit.stop + at + 2, talk.number)
            talk.world.loose.conflicts.append(said)
            return True
        if word in (",", ";", ".", "\n"):
            return False
    return False


def _any_more(talk: Talk, first: int, hit: Hit) -> bool:
    """no further risk, no risk any more: there was one before."""
    words = talk.words
    inside = words[first : hit.first]
    ends = words[hit.stop + 1 : hit.stop + 2]
    left = words[hit.stop : hit.stop + 1] == ["left"] and (not ends or ends[0] in MARKS)
    if left or not _REMAINS.isdisjoint(
        (*words[max(first - 1, 0) : first], *words[hit.stop : hit.stop + 1])
    ):
        return True
    if "further" in inside or "more" in inside or "longer" in inside:
        return True
    after = words[hit.stop : hit.stop + 5]
    return "anymore" in after or any(
        after[at] == "any" and after[at + 1] in _ANYMORE for at in range(len(after) - 1)
    )


def _modal(talk: Talk, index: int) -> bool:
    """Whether may or might stands before in the clause: there may be no risk."""
    for before in range(index - 1, max(index - 6, talk.start - 1), -1):
        hit = talk.hits[before]
        if hit.kind in (Kind.MARK, Kind.JOIN):
            return False
        if hit.kind is Kind.MODAL and hit.value == "may" and talk.words[hit.first] != "can":
            return True
    return False


def _back_to(talk: Talk, index: int, kind: Kind) -> int:
    for before in range(index - 1, max(index - 6, talk.start - 1), -1):
        if talk.hits[before].kind is kind:
            return talk.hits[before].first
    return talk.hits[index].first


def _about(talk: Talk, index: int, following: Hit | None) -> Actor | None:
    """risk of collision with the pedestrian."""
    if following is None or following.kind is Kind.MARK:
        return None
    for after in range(index + 1, min(index + 3, talk.stop)):
        hit = talk.hits[after]
        if hit.kind is Kind.OBJECT and talk.flags[after] & Scope.DENIED:
            return None
        if hit.kind is Kind.OBJECT:
            known = identity.resolve(talk.world, talk.words, hit, None)
            return known
    return None


def read_conflict(talk: Talk, index: int, hit: Hit) -> None:
    ignored = _IGNORED.get(hit.value, 0)
    flags = talk.flags[index] & ~ignored
    if hit.value == "no_conflict" and talk.subject is SCENE:
        return
    if flags or (hit.value == "potential" and not _of_conflict(talk, index)):
        return
    value = hit.value
    if value == "no_conflict" and _any_more(talk, hit.first, hit):
        value = "resolved"  # isn't in conflict with us anymore
    talk.conflicted().conflicts.append(talk.said(value, hit))


def _of_conflict(talk: Talk, index: int) -> bool:
    """Whether what can't be excluded is a danger or what somebody does, not ice on the road."""
    if talk.words[talk.hits[index].first] != "not":
        return True
    risked = any(one.kind is Kind.RISK for one in talk.hits[max(talk.start, index - 6) : index])
    return risked or bool(talk.named)


def read_possible(talk: Talk, index: int, hit: Hit) -> None:
    talk.planner.other(index, hit)
    possible.possibly(talk, index, hit)


def read_in_lane(talk: Talk, index: int, hit: Hit) -> None:
    last = talk.planner.last
    rides = last is not None and hit.value != "path" and index - last[0] <= 2
    if isinstance(talk.subject, Actor) and not rides:
        if hit.value and not talk.flags[index]:
            talk.in_path = (talk.subject, index)
    elif (
        hit.value == "path"
        and not talk.flags[index]
        and (
            talk.subject is None
            or not _ITS.isdisjoint(talk.words[max(hit.first - 4, 0) : hit.first])
        )
    ):
        talk.in_path = (talk.world.loose, index)
    else:
        talk.planner.in_lane(index, hit, rides or talk.subject is EGO or talk.subject is None)


def read_modal(talk: Talk, index: int, hit: Hit) -> None:
    if talk.words[hit.first] == "i'd":
        talk.subject, talk.near, talk.busy = EGO, None, False
        return
    if hit.value == "may":
        possible.possibly(talk, index, hit)
        possible.threaten(talk, index, hit)
        return
    if hit.value == "must" and talk.in_path and talk.subject is EGO and not talk.flags[index]:
        actor, where = talk.in_path
        first = talk.hits[where].first
        actor.conflicts.append(Statement("active", first, hit.stop, talk.number))


def end(talk: Talk) -> None:
    """What only the whole sentence says: that we must react, or that only that prevents a crash."""
    if talk.stop - talk.start < 3:
        return
    first, stop = talk.hits[talk.start].first, talk.hits[talk.stop - 1].stop
    words = talk.words[first:stop]
    if dangers.WARD.isdisjoint(words) and not talk.in_path:
        return
    asserted = not any(talk.flags[at] & _UNREAL for at in range(talk.start, talk.stop))
    found = dangers.averted(talk.words, first, stop) if asserted else None
    actor = talk.named[-1][1] if talk.named else talk.world.loose
    if not actor.mentions:
        actor = talk.world.loose
    if found is not None:
        actor.conflicts.append(Statement("active", *found, talk.number))
    elif talk.in_path and _must_react(talk, words):
        actor, where = talk.in_path
        hit = talk.hits[where]
        actor.conflicts.append(Statement("active", hit.first, hit.stop, talk.number))


def _must_react(talk: Talk, words: list[str]) -> bool:
    """in our path now, so brake; it is in our path and we have to react."""
    if talk.in_path is None:
        return False
    hit = talk.hits[talk.in_path[1]]
    braking = hit.value == "path" and talk.planner.first is not None and "now" in words
    if not braking and (_REACT.isdisjoint(words) or _MUST.isdisjoint(words)):
        return False
    return braking or ("not" not in words and "no" not in words)
