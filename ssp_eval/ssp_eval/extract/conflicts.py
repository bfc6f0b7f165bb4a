"""Stage 5: whether there is a conflict, and with whom."""

from __future__ import annotations

from ssp_eval.extract import actors
from ssp_eval.extract.hits import Hit, Kind
from ssp_eval.extract.scope import Scope
from ssp_eval.extract.talk import EGO, Talk
from ssp_eval.extract.world import Actor, Statement


def read_risk(talk: Talk, index: int, hit: Hit) -> None:
    flags = talk.flags[index]
    before = talk.words[max(hit.first - 2, 0) : hit.first]
    if {"other", "further", "additional", "that"} & set(before):
        return
    settle = talk.hits[index + 1 : min(index + 4, talk.stop)]
    if any(one.kind is Kind.CONFLICT for one in settle):
        return
    first = hit.first
    if flags & Scope.GONE and not flags & ~(Scope.GONE | Scope.DENIED):
        value = "resolved"
        first = _back_to(talk, index, Kind.NO_LONGER)
    elif flags in (Scope.DENIED, Scope.DENIED | Scope.AHEAD):
        value = "no_conflict"
        first = _back_to(talk, index, Kind.NOT)
    elif flags == Scope.POSSIBLE or (not flags and hit.value == "alone"):
        value = "potential"
    else:
        return
    following = talk.hits[index + 1] if index + 1 < talk.stop else None
    named = _about(talk, index, following)
    said = Statement(value, first, hit.stop, talk.number)
    (named or _conflicted(talk)).conflicts.append(said)


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
        if hit.kind is Kind.OBJECT:
            known = actors.resolve(talk.world, talk.words, hit, None)
            return known
    return None


def _conflicted(talk: Talk) -> Actor:
    if isinstance(talk.subject, Actor):
        return talk.subject
    return talk.near or talk.world.loose


def read_conflict(talk: Talk, index: int, hit: Hit) -> None:
    flags = talk.flags[index] & ~(Scope.AHEAD if hit.value == "no_conflict" else 0)
    if not flags:
        _conflicted(talk).conflicts.append(talk.said(hit.value, hit))


def read_in_lane(talk: Talk, index: int, hit: Hit) -> None:
    if isinstance(talk.subject, Actor):
        if hit.value and not talk.flags[index]:
            talk.in_path = (talk.subject, index)
    else:
        talk.planner.in_lane(index, hit, talk.subject is EGO or talk.subject is None)


def read_modal(talk: Talk, index: int, hit: Hit) -> None:
    if talk.words[hit.first] == "i'd":
        talk.subject, talk.near, talk.busy = EGO, None, False
    if hit.value == "must" and talk.in_path and talk.subject is EGO and not talk.flags[index]:
        actor, where = talk.in_path
        first = talk.hits[where].first
        actor.conflicts.append(Statement("active", first, hit.stop, talk.number))
