"""Stage 5: verbs: whose they are, somebody else's or the ego's."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.motion import doing, whereabouts
from ssp_eval.extract.rules.talk import EGO, SCENE, Talk
from ssp_eval.extract.rules.words.ego_verbs import STEERING
from ssp_eval.extract.rules.words.others_verbs import MOVEMENTS
from ssp_eval.extract.rules.world import Actor

# What the ego's plan has no use for.
_FOREIGN = frozenset({"cross", "step", "cut_in", "pedal", "approach", "wait", "recede", "overtake"})


def read_verb(talk: Talk, index: int, hit: Hit) -> None:
    if hit.form == "value" and whereabouts.read_value(talk, index, hit):
        return
    following = talk.hits[index + 1] if index + 1 < talk.stop else None
    if (
        hit.form in ("ing", "ed")
        and following is not None
        and (
            following.kind is Kind.OBJECT
            and following.first <= hit.stop + 1
            and following.form != "indefinite"
            and not _article_between(talk, hit, following)
            and not talk.planner.steers(hit)
            and talk.subject is not EGO
        )
    ):
        talk.adjectives.append(index)
        return
    if hit.form == "ing" and _inverted(talk, index):
        talk.adjectives.append(index)
        return
    if hit.form == "s" and hit.value in _FOREIGN and _opens(talk, index):
        talk.subject = talk.topic or talk.spoken_of()  # Crosses from right to left.
    other = isinstance(talk.subject, Actor) or talk.subject is SCENE
    if talk.key in ("motion", "position") and talk.near is None:
        doing.move(talk, index, hit)
    elif talk.subject is EGO or (not other and talk.near is None):
        talk.planner.verb(index, hit, talk.subject is EGO)
    elif hit.value == "keep_speed" and hit.form == "noun" and _followed(talk, index):
        talk.planner.verb(index, hit, False)
    elif talk.planner.commands(index, other, talk.key):
        talk.subject = None
        talk.near = None
        talk.planner.verb(index, hit, False)
    elif not other and hit.value in MOVEMENTS and hit.value not in STEERING:
        doing.move(talk, index, hit)
    elif not other and not talk.adjoins(index) and hit.form in ("base", "ing", "noun"):
        if not _others_infinitive(talk, index):
            talk.planner.verb(index, hit, False)
    else:
        doing.move(talk, index, hit)
    talk.busy = True


def _opens(talk: Talk, index: int) -> bool:
    """Whether a verb opens its sentence and nobody has been named in it."""
    if talk.subject is not None or talk.near is not None:
        return False
    hit = talk.hits[index]
    if hit.first and talk.words[hit.first - 1][0].isalnum():
        return False  # an excavator stands there
    return all(one.kind is Kind.MARK for one in talk.hits[talk.start : index])


def _followed(talk: Talk, index: int) -> bool:
    """follow the lorry at constant speed: the pace is the ego's."""
    noun = talk.named[-1][0] if talk.named else talk.start
    reacts = noun > talk.start and talk.hits[noun - 1].kind is Kind.REACT
    near = index == noun + 1 or (index == noun + 2 and talk.hits[noun + 1].value == ",")
    return reacts and (near or not isinstance(talk.subject, Actor))


def _inverted(talk: Talk, index: int) -> bool:
    """Coming towards us is a motorcycle."""
    if talk.subject is not None or talk.near is not None:
        return False
    for after in range(index + 1, min(index + 5, talk.stop - 1)):
        kind = talk.hits[after].kind
        if kind is Kind.AUX:
            return talk.hits[after + 1].kind is Kind.OBJECT
        if kind not in (Kind.SIDE, Kind.PLACE, Kind.EGO, Kind.STATE, Kind.SCENE, Kind.IN_LANE):
            return False
    return False


def _article_between(talk: Talk, hit: Hit, following: Hit) -> bool:
    between = talk.words[hit.stop : following.first]
    return any(word in ("the", "a", "an", "for", "to", "by", "with", "our") for word in between)


def _others_infinitive(talk: Talk, index: int) -> bool:
    """wait for the car to stop."""
    return talk.hits[index - 1].kind is Kind.PURPOSE and talk.adjoins(index - 1)
