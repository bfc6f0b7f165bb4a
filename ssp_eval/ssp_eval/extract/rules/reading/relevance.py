"""Stage 5: what the text says matters, or doesn't, or that nobody is there."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.scope.flags import Scope
from ssp_eval.extract.rules.talk import EGO, REACH, SCENE, Talk
from ssp_eval.extract.rules.world import Actor, Statement

# What somebody else does with these, in the words of verb_meaning.
_DOES = {"waiting": "stationary", "overtaking": "same_direction", "following": "moving"}
_GONE_ON = frozenset(
    {"back", "into", "to", "through", "on", "onto", "over", "up", "down", "past", "across"}
)
_SEVERAL = frozenset({"two", "three", "four", "several", "both", "following", "users", "objects"})
_HAVE = frozenset({"has", "have", "had", "having"})
_DROPS = frozenset({"ignore", "ignoring", "skip", "disregard"})
# No critical objects: there may be others.
_WEIGHED = frozenset({"critical", "relevant", "notable", "important", "key"})
_CONFLICT_WORDS = {
    "potential": "potential",
    "possible": "potential",
    "active": "active",
    "resolved": "resolved",
    "none": "no_conflict",
    "no": "no_conflict",
    "imminent": "active",
}


def read_critical(talk: Talk, index: int, hit: Hit) -> None:
    if talk.flags[index] & ~(Scope.AHEAD | Scope.READY):
        return
    previous = talk.hits[index - 1] if index > talk.start else None
    if (
        isinstance(talk.subject, Actor)
        and previous is not None
        and (previous.kind in (Kind.AUX, Kind.MODAL) or previous.kind is Kind.OBJECT)
    ):
        talk.subject.critical = True
        return
    talk.listing = True
    talk.counted = talk.counted or _announces(talk)
    after = talk.hits[index + 1] if index + 1 < talk.stop else None
    talk.heading = talk.heading or (after is not None and after.value in (":", "\n", '"', "["))
    if talk.subject is not EGO:
        talk.subject = None


def _announces(talk: Talk) -> bool:
    """Whether the sentence says how many matter: two of them deserve attention."""
    first = talk.hits[talk.start - 1].stop if talk.start else 0
    stop = min(talk.hits[talk.stop - 1].stop, first + 12)
    return not _SEVERAL.isdisjoint(talk.words[first:stop])


def read_react(talk: Talk, index: int, hit: Hit) -> None:
    motion = _DOES.get(talk.words[hit.first])
    if motion and talk.key == "motion" and talk.subject is None and not talk.flags[index]:
        (talk.record or talk.world.loose).motions.append(talk.said(motion, hit))
        return  # Motion: overtaking
    if motion and isinstance(talk.subject, Actor) and not talk.flags[index]:
        previous = talk.hits[index - 1] if index > talk.start else None
        if previous is not None and previous.kind in (Kind.AUX, Kind.NOT, Kind.MARK, Kind.OBJECT):
            talk.subject.motions.append(talk.said(motion, hit))
    if not isinstance(talk.subject, Actor) and talk.subject is not SCENE:
        talk.reacting = True


def read_background(talk: Talk, index: int, hit: Hit) -> None:
    if talk.flags[index] & ~Scope.READY:
        return
    if hit.value == "gone" and _GONE_ON & set(talk.words[hit.stop : hit.stop + 1]):
        return
    if hit.first and talk.words[hit.first - 1] in _HAVE and hit.value == "":
        return  # she has ignored her red light
    if talk.near is not None and talk.words[hit.first - 1] == "(" and hit.value == "":
        beside = talk.subject if isinstance(talk.subject, Actor) else talk.near
        beside.background = True  # a car behind (ignore)
        return
    if talk.words[hit.first] in _DROPS and hit.value == "":
        talk.is_background = True  # ignore the truck
        return
    actor = talk.subject if isinstance(talk.subject, Actor) else talk.near
    if actor is None and talk.named:
        actor = talk.named[-1][1]
    if actor is None and hit.value == "it":
        actor = talk.last
    if actor is not None:
        for one in talk.group if actor in talk.group else [actor]:
            one.background = True
            one.gone = one.gone or hit.value == "gone"
    elif hit.value != "gone":
        talk.is_background = True


def read_matters(talk: Talk, index: int, hit: Hit) -> None:
    if hit.value == "by":
        talk.revealing = True  # hidden behind the van: the van matters
        if isinstance(talk.subject, Actor) and not talk.flags[index]:
            talk.subject.matters = True
        return
    if talk.flags[index]:
        return
    if isinstance(talk.subject, Actor):
        talk.subject.matters = True
        talk.revealing = True
    elif talk.near is not None:
        talk.near.matters = True


def read_nobody(talk: Talk, index: int, hit: Hit) -> None:
    if talk.flags[index] & ~Scope.DENIED:
        return
    for after in range(index + 1, min(index + REACH, talk.stop)):
        kind = talk.hits[after].kind
        if kind is Kind.VERB or (kind is Kind.RELATIVE and after == index + 1):
            return
        if kind in (Kind.MARK, Kind.JOIN):
            break
    weighed = bool(_WEIGHED & set(talk.words[hit.first : hit.stop]))
    talk.world.nobody = talk.said("weighed" if weighed else "", hit)


def read_key(talk: Talk, index: int, hit: Hit) -> None:
    talk.key = hit.value
    talk.subject = None
    talk.near = None
    talk.busy = False
    talk.listing = talk.under = hit.value == "objects"
    if hit.value == "objects":
        talk.record, talk.keyed = None, len(talk.named)
    talk.planner.key(index, hit)
    if hit.value == "conflict":
        for at in range(hit.stop, min(hit.stop + 4, len(talk.words))):
            value = _CONFLICT_WORDS.get(talk.words[at])
            if value is not None and not talk.flags[index]:
                said = Statement(value, hit.first, at + 1, talk.number)
                talk.world.loose.conflicts.append(said)
                break
    if hit.value == "objects" and not talk.flags[index]:
        _empty_list(talk, hit)


def _empty_list(talk: Talk, hit: Hit) -> None:
    """Critical objects: none."""
    for at in range(hit.stop, min(hit.stop + 4, len(talk.words))):
        word = talk.words[at]
        if word == "[":
            inside = talk.words[at + 1] if at + 1 < len(talk.words) else ""
            if inside != '"' and not inside.isalpha():
                talk.world.nobody = Statement("", hit.first, at + 1, talk.number)
            return
        if word.isalpha():
            if word in ("none", "nobody", "nil"):
                talk.world.nobody = Statement("listed", hit.first, at + 1, talk.number)
            return
