"""Stage 5: what somebody may do to us: a potential conflict, told by may, might, could, maybe."""

from __future__ import annotations

from ssp_eval.extract.rules.actors import identity
from ssp_eval.extract.rules.free_phrases import dangers
from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.scope.flags import Scope
from ssp_eval.extract.rules.talk import EGO, SCENE, Talk
from ssp_eval.extract.rules.words.notation import phrases
from ssp_eval.extract.rules.words.others_verbs import ENDANGERING
from ssp_eval.extract.rules.world import Statement

_DOUBTFUL = frozenset(phrases("may, might, could"))
_SELF = frozenset(phrases("we, i, you, ego, what"))
# One may brake is said of us, one may run of a child.
_RUNNING = frozenset(
    phrases("follow, run, dart, dash, step, jump, cross, emerge, appear, pop, walk, come, rush")
)
# A crash is possible, contact may occur.
_CRASH = frozenset(
    phrases("collision, crash, contact, sideswipe, impact, accident, conflict, scrape, touch")
)
_HAPPEN = frozenset(phrases("occur, happen, arise, develop, result, ensue, follow, take"))
_POSSIBLE = frozenset(phrases("possible, probable, likely, conceivable"))
_MAYBE = frozenset(phrases("maybe, perhaps, possibly, potentially, chance, possibility"))
_BE = frozenset(phrases("is, are, seems, remains, becomes, appears"))
MAX_PARTNER = 9


def possibly(talk: Talk, index: int, hit: Hit) -> None:
    """A possible cut-in, a potential crossing."""
    following = talk.hits[index + 1] if index + 1 < talk.stop else None
    if (
        following is not None
        and not talk.flags[index]
        and talk.words[hit.first] in ("possible", "potential")
        and following.kind is Kind.VERB
        and following.value in ENDANGERING
        and following.first <= hit.stop + 1
    ):
        said = Statement("potential", hit.first, following.stop, talk.number)
        talk.world.loose.conflicts.append(said)


def threaten(talk: Talk, index: int, hit: Hit) -> None:
    """Somebody may, might or could do what endangers us."""
    words = talk.words
    if _crash_possible(talk, index, hit) or _maybe(talk, index, hit):
        return
    if (
        words[hit.first] not in _DOUBTFUL
        or talk.flags[index] & ~Scope.POSSIBLE
        or hit.stop >= len(words)
    ):
        return
    subject = talk.subject
    if is_general(talk, index):
        return
    if subject is EGO and dangers.crashes(words, hit.stop):
        said = Statement("potential", hit.first, hit.stop + 1, talk.number)
        (talk.last or talk.world.loose).conflicts.append(said)
        return
    if subject is EGO or subject is SCENE or (hit.first and words[hit.first - 1] in _SELF):
        return
    if hit.first and words[hit.first - 1] == "one" and words[hit.stop] not in _RUNNING:
        return
    stop = dangers.threat(words, hit.stop)
    if stop is None:
        stop = _might_be(talk, index, hit)
    if stop is None:
        return
    actor = talk.conflicted()
    if not actor.mentions:
        actor = talk.world.loose
    actor.conflicts.append(Statement("potential", hit.first, stop, talk.number))


def _crash_possible(talk: Talk, index: int, hit: Hit) -> bool:
    """A sideswipe is possible; contact might occur."""
    words, first = talk.words, hit.first
    if first < 2:
        return False
    if words[first] in _POSSIBLE:
        noun = first - 2
        while noun > max(first - MAX_PARTNER, 0) and words[noun] not in _CRASH:
            noun -= 1  # a crash with the van on the left is possible
        partner = noun == first - 2 or words[noun + 1] == "with"
        said = words[first - 1] in _BE and words[noun] in _CRASH and partner
    else:
        said = words[first - 1] in _CRASH and not _HAPPEN.isdisjoint(words[hit.stop : hit.stop + 1])
        noun = first - 1
    if not said or talk.flags[index] & ~Scope.POSSIBLE or words[noun - 1] == "no":
        return False
    talk.conflicted().conflicts.append(Statement("potential", noun, hit.stop, talk.number))
    return True


def _maybe(talk: Talk, index: int, hit: Hit) -> bool:
    """Maybe he runs; perhaps the van pulls out; a chance that the man on the left steps out."""
    words = talk.words
    if words[hit.first] not in _MAYBE or talk.flags[index]:
        return False
    noun: Hit | None = None
    for after in range(index + 1, min(index + 5, talk.stop)):
        one = talk.hits[after]
        if one.kind is Kind.VERB:
            ahead = [words[one.first].removesuffix("s"), *words[one.stop : one.stop + 2]]
            late = (noun or one).first - hit.stop > 1
            if one.form != "s" or late or dangers.threat(ahead, 0) is None:
                return False
            actor = talk.conflicted() if noun is None else talk.last
            if noun is not None and noun.kind is Kind.OBJECT:
                actor = identity.resolve(talk.world, words, noun, None)
            actor = actor or talk.world.loose
            actor.conflicts.append(Statement("potential", hit.first, one.stop, talk.number))
            return True
        if one.kind in (Kind.PRONOUN, Kind.OBJECT) and noun is None:
            noun = one
        elif one.kind not in (Kind.PLACE, Kind.SIDE):
            return False
    return False


def is_general(talk: Talk, modal: int) -> bool:
    """Cyclists may swerve: about all of them, not about one that is there."""
    noun = talk.hits[modal - 1] if modal > talk.start else None
    if noun is None or noun.kind is not Kind.OBJECT or noun.form == "definite":
        return False
    other = noun.first > 0 and talk.words[noun.first - 1] == "other"
    word = talk.words[noun.stop - 1]
    return word.endswith("s") and not word.endswith("bus") and (not noun.form or other)


def _might_be(talk: Talk, index: int, hit: Hit) -> int | None:
    """There might be a cut-in."""
    if talk.words[hit.stop - 1 : hit.stop + 1].count("be") != 1:
        return None
    for after in range(index + 1, min(index + 3, talk.stop)):
        one = talk.hits[after]
        if one.kind is Kind.VERB:
            return one.stop if one.value in ENDANGERING and one.form != "ing" else None
        if one.kind is not Kind.AUX:
            return None
    return None
