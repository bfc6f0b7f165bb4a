"""Stage 5: states and verbs of somebody else: what a road user is doing now."""

from __future__ import annotations

from ssp_eval.extract.rules.conflict import possible
from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.motion.verb_meaning import (
    COMES_FROM,
    FINISHED_STANDING,
    INTRUSIONS,
    motion_of,
)
from ssp_eval.extract.rules.scope.flags import Scope
from ssp_eval.extract.rules.talk import CONNECTS, EGO, NOT_NOW, REACH, SCENE, Talk
from ssp_eval.extract.rules.words.notation import phrases
from ssp_eval.extract.rules.words.others_verbs import CLEARING, ENDANGERING
from ssp_eval.extract.rules.world import Actor, Statement

_LINES = frozenset({"line", "lines", "marking", "markings", "dashed", "solid", "boundary"})

_LINKS = frozenset(phrases("to, with, and, or, in, on, at, ahead, is, one, ones"))
_POSSESSIVE = frozenset(phrases("his, her, its, their"))
_TO = frozenset(phrases("to, into, over, towards, toward, out, across, onto, away"))


def read_state(talk: Talk, index: int, hit: Hit) -> None:
    following = talk.hits[index + 1] if index + 1 < talk.stop else None
    before_noun = following is not None and (
        following.kind in (Kind.OBJECT, Kind.PLACE, Kind.SIDE, Kind.STATE)
        and following.first <= hit.stop + 1
    )
    predicate = index > talk.start and talk.hits[index - 1].kind in CONNECTS
    if talk.words[hit.first] == "not" and _TO & set(talk.words[hit.stop : hit.stop + 1]):
        return  # not moving into our lane
    if following is not None and following.kind is Kind.SCENE and following.first <= hit.stop + 1:
        return  # an oncoming tram
    if _describes_thing(talk, hit, following):
        return
    if before_noun and following is not None and following.kind is Kind.OBJECT:
        talk.adjectives.append(index)
    elif hit.value == "receding":
        actor = talk.subject if isinstance(talk.subject, Actor) else talk.near or talk.last
        planned = talk.planner.end() is not None  # slow down so that the gap opens
        if actor is not None and not planned:  # the gap grows: to whom we talk of
            be(talk, actor, index, talk.flags[index])
    elif talk.subject is SCENE and talk.near is None:
        return
    else:
        actor = talk.target(index, hit)
        if actor is not None:
            be(talk, actor, index, talk.flags_at(index))
        elif before_noun and not predicate and talk.subject is not EGO:
            talk.adjectives.append(index)


def _describes_thing(talk: Talk, hit: Hit, following: Hit | None) -> bool:
    """of the opposite direction, the parallel crossing: said of something else."""
    before = talk.words[hit.first - 1] if hit.first else ""
    if before == "the" and hit.first > 1 and talk.words[hit.first - 2] == "of":
        return talk.words[hit.stop - 1] == "direction"
    if before not in ("a", "an", "the") or hit.stop - hit.first > 1:
        return False
    after = talk.words[hit.stop] if hit.stop < len(talk.words) else "."
    known = following is not None and following.first == hit.stop
    return after.isalpha() and not known and after not in _LINKS and not _names(talk, following)


def _names(talk: Talk, following: Hit | None) -> bool:
    """Whether the next phrase is a road user that the words before it describe."""
    return following is not None and following.kind in (Kind.OBJECT, Kind.STATE, Kind.VERB)


def be(talk: Talk, actor: Actor, index: int, flags: int) -> None:
    """A state, or a participle in front of the noun."""
    hit = talk.hits[index]
    value = hit.value
    if hit.kind is Kind.VERB:
        found = motion_of(talk.words, talk.hits, index, talk.start, talk.stop, actor.name)
        if found is None:
            return
        value = found[0]
    if value == "parked":
        actor.parked = True
        value = "stationary"
    if flags & NOT_NOW:
        return
    actor.motions.append(talk.said(value, hit))
    talk.show(actor, index)


def move(talk: Talk, index: int, hit: Hit) -> None:
    """A verb whose subject is a road user: a motion, a possible conflict or its end."""
    actor = talk.target(index, hit)
    if actor is None or _of_his(talk, index, hit):
        return
    flags = talk.flags_at(index) if hit.form == "ing" else talk.flags[index]
    if flags & Scope.DENIED:
        return
    if (
        flags == Scope.POSSIBLE
        and hit.value in ENDANGERING
        and hit.form != "ed"
        and (actor.mentions or actor is talk.world.loose)
    ):
        first = _modal_before(talk, index)
        if first is not None and not _is_general(talk, first):
            said = Statement("potential", first, hit.stop, talk.number)
            actor.conflicts.append(said)
        return
    if flags:
        return
    finished = hit.form == "ed" and _auxiliary(talk, index) == "have"
    line = hit.value == "cross" and not _LINES.isdisjoint(talk.words[hit.stop : hit.stop + 4])
    if finished and hit.value in CLEARING and not line:
        first = _auxiliary_word(talk, index)
        actor.conflicts.append(Statement("resolved", first, hit.stop, talk.number))
        talk.show(actor, index)
        return
    if hit.form == "ed" and hit.value not in FINISHED_STANDING:
        came = motion_of(talk.words, talk.hits, index, talk.start, talk.stop, actor.name)
        if came is not None and came[0].startswith(COMES_FROM):
            actor.motions.append(talk.said(came[0], hit))
        return
    if hit.form == "base" and _intended(talk, index):
        return
    if hit.value == "park":
        actor.parked = True
    found = motion_of(talk.words, talk.hits, index, talk.start, talk.stop, actor.name)
    if found is None:
        return
    value, side = found
    if hit.value == "keep_lane" and not actor.places:
        _put_in_lane(talk, actor, hit)
    if value.startswith(INTRUSIONS):
        actor.intruding = True
    stop = side.stop if side is not None and side.first >= hit.stop else hit.stop
    for one in talk.group if actor in talk.group else [actor]:
        one.motions.append(talk.said(value, hit, stop))
        talk.show(one, index)
    if actor is talk.world.loose:
        actor.motions.append(talk.said(value, hit, stop))


def _of_his(talk: Talk, index: int, hit: Hit) -> bool:
    """where her friends stand: a plural that the rules don't know acts."""
    before = talk.hits[index - 1] if index > talk.start else None
    if before is None or before.kind is not Kind.PRONOUN or hit.form != "base":
        return False
    many = before.stop < hit.first and talk.words[hit.first - 1].endswith("s")
    return many and talk.words[before.first] in _POSSESSIVE


def _put_in_lane(talk: Talk, actor: Actor, hit: Hit) -> None:
    """travels in the left lane: the verb's words say where."""
    for at in range(hit.first + 2, hit.stop):
        if talk.words[at] in ("left", "right") and talk.words[at - 1] == "the":
            lane = Hit(Kind.SIDE, talk.words[at], "at", at - 2, hit.stop)
            actor.places.append(talk.said(lane.value, lane))


def _auxiliary(talk: Talk, index: int) -> str:
    for before in range(index - 1, max(index - 4, talk.start - 1), -1):
        hit = talk.hits[before]
        if hit.kind is Kind.AUX:
            return hit.value
        if hit.kind not in (Kind.JOIN, Kind.NOT):
            return ""
    return ""


def _auxiliary_word(talk: Talk, index: int) -> int:
    for before in range(index - 1, max(index - REACH, talk.start - 1), -1):
        if talk.hits[before].kind is Kind.AUX:
            return talk.hits[before].first
    return talk.hits[index].first


def _is_general(talk: Talk, word: int) -> bool:
    """Whether a modal at a word doubts what is there: cyclists may swerve, it would."""
    if talk.words[word] not in ("may", "might", "could"):
        return True
    hits = range(talk.start, talk.stop)
    return any(talk.hits[at].first == word and possible.is_general(talk, at) for at in hits)


def _modal_before(talk: Talk, index: int) -> int | None:
    for before in range(index - 1, max(index - 4, talk.start - 1), -1):
        if talk.hits[before].kind is Kind.MODAL:
            return talk.hits[before].first
    return None


def _intended(talk: Talk, index: int) -> bool:
    """to + verb is an intention, unless it starts to."""
    if index - 1 < talk.start or talk.hits[index - 1].kind is not Kind.PURPOSE:
        return False
    earlier = talk.hits[index - 2] if index - 2 >= talk.start else None
    return earlier is None or earlier.value != "continue"
