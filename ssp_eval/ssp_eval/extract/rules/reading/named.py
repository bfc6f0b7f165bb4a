"""Stage 5: nouns and pronouns: who is named, and who is the subject."""

from __future__ import annotations

from ssp_eval.extract.rules.actors import ego, identity, noun_phrases
from ssp_eval.extract.rules.hits import MARKS, Hit, Kind
from ssp_eval.extract.rules.motion import doing
from ssp_eval.extract.rules.scope.flags import Scope
from ssp_eval.extract.rules.talk import EGO, SCENE, Talk
from ssp_eval.extract.rules.world import Actor, Statement

MAX_GROUP = 6
REACH = 12
_OBLIQUE = frozenset({"its", "their", "them", "him", "her", "his", "hers"})
_POSSESSIVE = frozenset({"its", "their", "his"})
_AROUND = frozenset({"behind", "between", "past", "around"})
_SOME = frozenset({"both", "all", "two", "one", "each", "three"})
_BEFORE_NOUN = frozenset(
    {"a", "an", "small", "large", "big", "young", "old", "elderly", "long", "tall", "single", "one"}
)
_ORDINALS = frozenset(
    {"first", "second", "third", "fourth", "firstly", "secondly", "thirdly", "another", "one"}
    | {"other", "finally", "lastly", "besides"}
)
_PEOPLE = frozenset({"pedestrian", "cyclist", "motorcycle"})
_FITTING = {
    "he": frozenset({"pedestrian", "cyclist", "motorcycle"}),
    "rider": frozenset({"cyclist", "motorcycle"}),
}
_MEN = frozenset(
    {"man", "boy", "gentleman", "guy", "dude", "lad", "father", "dad", "grandfather", "schoolboy"}
)
_WOMEN = frozenset(
    {"woman", "girl", "lady", "mother", "mum", "granny", "grandmother", "schoolgirl"}
)
_UNLIKE = {
    **dict.fromkeys(("he", "him", "his"), _WOMEN),
    **dict.fromkeys(("she", "her", "hers"), _MEN),
}
_NONE = frozenset({"none", "nobody", "no", "nil", "zero", "nothing"})


def read_object(talk: Talk, index: int, hit: Hit) -> None:
    flags = talk.flags[index]
    place = noun_phrases.own_place(talk.hits, index, talk.stop)
    if flags & (Scope.DENIED | Scope.GONE) and hit.form != "definite":
        talk.denied.add(hit.value)
        talk.subject = SCENE
        talk.near = None
        return
    if _none(talk, index):
        talk.denied.add(hit.value)
        talk.subject, talk.near = SCENE, None
        return
    role = ego.ego_role(talk, index, hit)
    if role:
        talk.subject, talk.near, talk.busy = role, None, False
        return
    if not flags & ~Scope.READY and _predicate(talk, index, hit):
        _identify(talk, hit)
        return
    lead = noun_phrases.leading(talk.words, hit)
    fresh = (talk.listing or talk.key == "objects") and not hit.form and not talk.named
    actor = identity.resolve(talk.world, talk.words, hit, place, fresh, lead is not None)
    previous = talk.hits[index - 1] if index > talk.start else None
    coordinated = (
        bool(talk.named)
        and previous is not None
        and (previous.kind is Kind.JOIN or previous.value == ",")
        and talk.named[-1][0] >= index - 3
        and talk.near is not None
        and talk.hits[index - 2].kind is Kind.OBJECT
    )
    if _apposition(talk, index, hit) and actor is not talk.near and talk.near is not None:
        if actor is talk.world.actors[-1]:
            talk.world.actors.pop()
        actor = talk.near
        if talk.words[hit.stop - 1] not in ("vehicle", "car"):
            actor.name, actor.noun = hit.value, talk.words[hit.stop - 1]
    talk.group = [*talk.group[-MAX_GROUP:], actor] if coordinated else [actor]
    talk.named.append((index, actor))
    following = talk.hits[index + 1] if index + 1 < talk.stop else None
    doubtful = (  # a car could come over the crest, people may step out: there is none yet
        (hit.form == "indefinite" or (actor.plural and not hit.form and not actor.mentions))
        and following is not None
        and following.kind is Kind.MODAL
        and following.value == "may"
    )
    hiding = talk.revealing and hit.form == "definite" and flags == Scope.POSSIBLE
    if hiding or (not flags and not doubtful):  # somebody may come out from behind the bus
        actor.mentions.append(talk.said(hit.value, hit))
    if talk.key == "objects":
        alone = talk.record is None and len(talk.named) - talk.keyed == 1
        talk.record = actor if alone else None
    listed = talk.under and len(talk.named) == 1 and not _governed(talk, index)
    listed = listed or (talk.counted and len(talk.named) == 1 and _numbered(talk))
    actor.critical = actor.critical or talk.listing or listed or talk.key == "objects"
    actor.matters = actor.matters or talk.revealing
    if talk.reacting:
        if coordinated or not talk.reacted:
            actor.reaction = 2
        talk.reacted = True
    if talk.is_background:
        actor.background = True
    object_of_verb = talk.busy and talk.subject is not None
    if not (_governed(talk, index) or object_of_verb) or coordinated:
        talk.subject = actor
        talk.busy = False
    talk.near = talk.last = actor
    if lead is not None and not flags:
        actor.places.append(Statement("front", lead, hit.stop, talk.number))
    for before in talk.pending:
        talk.put(actor, before, flags)
    for before in talk.adjectives:
        doing.be(talk, actor, before, flags)
    talk.pending, talk.adjectives = [], []
    if talk.asked and not flags:  # What is on the left? A cyclist.
        actor.places.extend(talk.asked)
        talk.asked = []
    if actor.parked and noun_phrases.preposition(talk.words, hit) in _AROUND:
        actor.matters = True  # from behind the parked van


def _numbered(talk: Talk) -> bool:
    """First, a bus … The second is a scooter: items of a list in sentences of their own."""
    first = talk.hits[talk.start - 1].stop if talk.start else 0
    return not _ORDINALS.isdisjoint(talk.words[first : first + 2])


def _apposition(talk: Talk, index: int, hit: Hit) -> bool:
    """Whether a noun says again who was just named: the vehicle to our right, a tanker truck."""
    if hit.form == "definite" or index - 2 < talk.start or talk.near is None:
        return False
    named = bool(talk.near.label) or talk.near.noun in ("vehicle", "car")
    labelled = talk.hits[index - 1].value == ":" and named
    if talk.hits[index - 1].value not in (",", "(") and not labelled:
        return False
    after = talk.words[hit.stop : hit.stop + 1]
    if after and after[0].isalnum():
        return False
    known = talk.near
    generic = known.noun in ("vehicle", "car") or talk.words[hit.stop - 1] in ("vehicle", "car")
    before = talk.hits[index - 2]
    beside = before.kind is Kind.OBJECT or (
        before.kind in (Kind.PLACE, Kind.SIDE, Kind.EGO) and talk.adjoins(index - 1)
    )
    return (
        beside
        and len(talk.named) < 2
        and not known.plural
        and (known.name == hit.value or (generic and "car" in (known.name, hit.value)))
    )


def _predicate(talk: Talk, index: int, hit: Hit) -> bool:
    """Whether a noun says what its subject is: it's a bus, she is a child."""
    if hit.form != "indefinite" or not isinstance(talk.subject, Actor) or talk.busy:
        return False
    before = talk.hits[index - 1] if index > talk.start else None
    if before is None or before.kind is not Kind.AUX or before.value != "be":
        return False
    return all(
        word in _BEFORE_NOUN or word in noun_phrases.COLOURS
        for word in talk.words[before.stop : hit.first]
    )


def _identify(talk: Talk, hit: Hit) -> None:
    actor = talk.subject
    if isinstance(actor, Actor):
        if actor.name == "car" and actor.noun in ("car", "vehicle"):
            actor.name, actor.noun = hit.value, talk.words[hit.stop - 1]
            if not talk.flags[talk.start]:
                actor.mentions.insert(0, talk.said(hit.value, hit))
        talk.near = actor


def _none(talk: Talk, index: int) -> bool:
    """Vehicles ahead: none."""
    for after in range(index + 1, min(index + 4, talk.stop - 1)):
        hit = talk.hits[after]
        if hit.kind is Kind.MARK and hit.value in (":", "=", "|", ","):
            beyond = talk.words[hit.stop : hit.stop + 2]
            if beyond[:1] == ["no"]:  # Truck on the left: no conflict
                return beyond[1:2] == [] or beyond[1] in MARKS
            return bool(_NONE & set(beyond[:1]))
        if hit.kind not in (Kind.PLACE, Kind.SIDE, Kind.STATE):
            return False
    return False


def _governed(talk: Talk, index: int) -> bool:
    return noun_phrases.governed(talk.hits, index, talk.start, talk.stop, talk.words)


def read_pronoun(talk: Talk, index: int, hit: Hit) -> None:
    actor = _referent(talk, hit.value, talk.words[hit.first])
    if hit.value == "it" and ego.after_ego(talk, index) and ego.acts(talk, index):
        talk.subject = EGO  # The ego car slows down. It stays in its lane.
        return
    named = hit.first > 1 and talk.words[hit.first - 1] == "the"  # behind the rider
    governed = hit.first > 0 and talk.words[hit.first - 1 - named] in noun_phrases.PREPOSITIONS
    opens = index == talk.start or (talk.hits[index - 1].value == ";" and not talk.named[1:])
    if talk.words[hit.first] in _POSSESSIVE and opens and actor is not None:
        talk.subject = talk.near = talk.last = actor  # its trailer moves into our lane
        talk.group, talk.busy = [actor], False
        return
    if hit.first > 1 and talk.words[hit.first - 1] == "of":
        governed = talk.words[hit.first - 2] not in _SOME  # both of them are standing
    elif talk.words[hit.first] in _OBLIQUE:
        governed = True
    if governed:
        if talk.reacting and actor is not None and not talk.flags[index]:
            actor.reaction = 2  # go around her, wait for him
        return
    if hit.value == "it" and talk.subject is EGO:
        return
    if actor is None:
        if talk.subject is None:
            talk.subject = EGO if talk.ego_named and hit.value == "it" else SCENE
        return
    talk.subject = talk.near = talk.last = actor
    talk.group = [actor]
    talk.named.append((index, actor))
    talk.busy = False


def _referent(talk: Talk, pronoun: str, word: str) -> Actor | None:
    """Whom a pronoun means: what was talked about before what was only named, and a fit one."""
    fits = _FITTING.get(pronoun)
    unlike = _UNLIKE.get(word, frozenset())
    many = pronoun == "they"
    here = talk.named[-1][1] if talk.named else None
    subject = talk.subject if isinstance(talk.subject, Actor) else None
    for actor in (subject, here, talk.topic, talk.last):
        if actor is None or (many and not (actor.plural or actor.name in _PEOPLE)):
            continue
        if actor.background and talk.world.actors[0] is not actor:
            continue
        if (fits is None or actor.name in fits) and actor.noun not in unlike:
            return actor
    if many:
        return None
    if fits is not None:
        for actor in reversed(talk.world.actors[-REACH:]):
            if actor.name in fits and actor.noun not in unlike:
                return actor
    return None if pronoun == "rider" else talk.spoken_of()


def read_relative(talk: Talk, index: int, hit: Hit) -> None:
    if talk.words[hit.first] == "whose":
        talk.subject, talk.near = SCENE, None  # the cyclist whose way is blocked
        return
    previous = talk.hits[index - 1] if index > talk.start else None
    if (
        talk.near is not None
        and previous is not None
        and (previous.kind in (Kind.OBJECT, Kind.PLACE, Kind.SIDE) or previous.value == ",")
    ):
        talk.subject = talk.near
        talk.busy = False


def read_scene(talk: Talk, index: int, hit: Hit) -> None:
    """A scene noun becomes the subject only where it opens a clause."""
    opens = talk.near is None and not isinstance(talk.subject, Actor) and talk.subject != EGO
    if opens and not talk.busy and not _governed(talk, index):
        talk.subject = SCENE
        talk.pending = []
