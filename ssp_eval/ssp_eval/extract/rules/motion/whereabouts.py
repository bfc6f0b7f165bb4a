"""Stage 5: where somebody is."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.motion.verb_meaning import FINISHED_STANDING, passes
from ssp_eval.extract.rules.scope.flags import Scope
from ssp_eval.extract.rules.talk import EGO, SCENE, Talk
from ssp_eval.extract.rules.words.notation import phrases
from ssp_eval.extract.rules.world import Actor

# What may stand between the start of a clause and a place without being what the place is of.
_MEASURES = frozenset(
    phrases(
        """
        about, some, roughly, approximately, m, metres, meters, metre, meter, just, slightly, far,
        around, only, now, there, i, we, see, notice, also, a, few, approx, well, immediately,
        directly, is, are, next, to, us, further, and, so, in, the, over, then, however, meanwhile
        """
    )
)
_UNSURE = Scope.POSSIBLE | Scope.AHEAD | Scope.DENIED  # where it may pull out to
_PAVEMENTS = frozenset(
    phrases("pavement, sidewalk, kerb, curb, footpath, island, verge, shoulder, refuge, median")
)
_PASSING = frozenset(phrases("around, round, past, pass, overtake, by"))
_AT = frozenset(phrases("on, in, at, along, inside, within"))
_SPOTS = frozenset(
    phrases(
        """
        path, lane, road, pavement, sidewalk, kerb, curb, side, street, ramp, driveway, shoulder,
        track, verge, exit, row, bay, island, corner, crosswalk, junction, entrance, footpath,
        carriageway, strip, field, slip, alley, arm, stop, line, cycleway, crossing, gutter, yard,
        space, pocket, walkway, refuge, roadside, intersection, lot, gateway, doorway
        """
    )
)
_OURS = frozenset(phrases("our, my, us, ours, ego, me, of"))
_OPENERS = frozenset(
    {
        Kind.MARK,
        Kind.JOIN,
        Kind.AUX,
        Kind.PLACE,
        Kind.SIDE,
        Kind.KEY,
        Kind.THEN,
        Kind.IN_LANE,
        Kind.SCENE,
    }
)


def read_place(talk: Talk, index: int, hit: Hit) -> None:
    if talk.subject is SCENE and talk.near is None:
        return
    if hit.stop - hit.first == 1 and _is_part(talk, index, hit):
        return  # behind the taxi's rear
    if hit.form == "car" and any(actor.name == "car" for actor in talk.world.actors[-12:]):
        return  # in front of the car: of the one that was named before
    actor = talk.near or (talk.subject if isinstance(talk.subject, Actor) else None)
    if talk.key == "position":
        talk.put(talk.record or talk.world.loose, index, talk.flags[index])
    elif actor is None:
        if talk.subject is not EGO and _opens_clause(talk, index, hit):
            talk.pending.append(index)
    elif talk.adjoins(index) or (talk.named and talk.attached(index)):
        noun = talk.named[-1][0] if talk.named else index
        talk.put(actor, index, talk.flags[index] & talk.flags[noun])
    elif not (talk.flags[index] & _UNSURE or _finished(talk, index)):
        together = talk.group if actor in talk.group else [actor]
        for one in together:
            talk.put(one, index, talk.flags[index])


def _is_part(talk: Talk, index: int, hit: Hit) -> bool:
    """Whether front or rear is a part of the noun before it."""
    before = talk.hits[index - 1] if index > talk.start else None
    if before is None or talk.words[hit.first] not in ("rear", "front"):
        return False
    return before.kind is Kind.OBJECT and before.form == "definite" and before.stop == hit.first


def read_side(talk: Talk, index: int, hit: Hit) -> None:
    if hit.form == "from":
        _read_passing(talk, index, hit)
    if _around(talk, index):
        return
    if _arrived(talk, index, hit):
        read_place(talk, index, hit)
        return
    if hit.form in ("from", "into"):
        return
    if talk.planner.takes_side(index):
        return
    if hit.form == "lane":
        following = talk.hits[index + 1] if index + 1 < talk.stop else None
        if following is not None and following.kind is Kind.OBJECT:
            talk.pending.append(index)
        elif talk.key == "position" or (
            talk.near is not None and (_alone(talk, index, hit) or _behind_noun(talk, index, hit))
        ):
            read_place(talk, index, hit)
        return
    if (
        hit.form == "bare"
        and talk.key != "position"
        and not _beside_place(talk, index)
        and not (
            talk.near is not None
            and (
                _alone(talk, index, hit)
                or (_behind_noun(talk, index, hit) and not _goes_on(talk, hit))
            )
        )
    ):
        return
    if hit.form == "to" and _moving_to(talk, index):
        return
    read_place(talk, index, hit)


def _read_passing(talk: Talk, index: int, hit: Hit) -> None:
    """pedestrian ahead, left to right"""
    actor = talk.near
    if actor is None or talk.busy or talk.flags[index] or talk.subject is EGO:
        return
    if passes(talk.words, hit, actor.name):
        actor.motions.append(talk.said(f"crossing_from_{hit.value}", hit))


def read_value(talk: Talk, index: int, hit: Hit) -> bool:
    """A bare left or right among an actor's fragments is a place: motorbike (left, parallel)."""
    if hit.value not in ("change_left", "change_right") or talk.near is None or talk.busy:
        return False
    if talk.key in ("action", "lat_action", "lon_action") or talk.subject is EGO:
        return False
    if index > talk.start and talk.hits[index - 1].value == ":":
        return False
    side = Hit(Kind.SIDE, hit.value.removeprefix("change_"), "at", hit.first, hit.stop)
    if not talk.flags[index]:
        talk.near.places.append(talk.said(side.value, side))
    return True


def _around(talk: Talk, index: int) -> bool:
    """go around her on the left: our way, not her place."""
    before = talk.hits[index - 1] if index > talk.start else None
    if before is None or before.kind is not Kind.PRONOUN or before.first == 0:
        return False
    return talk.words[before.first - 1] in _PASSING


def _arrived(talk: Talk, index: int, hit: Hit) -> bool:
    """has reached the left pavement, stepped onto the right kerb"""
    before = talk.hits[index - 1] if index > talk.start else None
    if before is None or before.form not in ("ed", "s"):
        return False
    stepped = before.value == "step" and before.form == "ed" and hit.form == "into"
    if stepped and _PAVEMENTS.isdisjoint(talk.words[hit.first : hit.stop]):
        return False
    if before.value != "reach" and not stepped:
        return False
    near = hit.first - before.stop < 3 and not talk.flags[index - 1]
    return near and not _SPOTS.isdisjoint(talk.words[hit.first : hit.stop])


def _finished(talk: Talk, index: int) -> bool:
    """Whether a place belongs to a movement that is over: crossed well before us."""
    verb = talk.hits[index - 1] if index > talk.start else None
    if verb is None or verb.kind is not Kind.VERB or verb.form != "ed":
        return False
    before = talk.hits[index - 2] if index - 2 >= talk.start else None
    passive = before is not None and before.kind is Kind.AUX and before.value == "be"
    arrived = verb.value == "reach" or _arrived(talk, index, talk.hits[index])
    return verb.value not in FINISHED_STANDING and not arrived and not passive


def _opens_clause(talk: Talk, index: int, hit: Hit) -> bool:
    """Whether a place stands before its noun rather than after one that the rules don't know."""
    before = talk.hits[index - 1] if index > talk.start else None
    if before is not None and before.kind not in _OPENERS:
        return False
    first = before.stop if before is not None else _sentence_start(talk)
    between = talk.words[first : hit.first]
    return all(word in _MEASURES or word[0].isdigit() for word in between)


def _sentence_start(talk: Talk) -> int:
    return talk.hits[talk.start - 1].stop if talk.start else 0


def _alone(talk: Talk, index: int, hit: Hit) -> bool:
    """Whether a side stands between marks, or at the sentence's end."""
    words = talk.words
    after = words[hit.stop] if hit.stop < len(words) else "."
    return not words[hit.first - 1].isalnum() and not after[0].isalnum() and not talk.busy


def _behind_noun(talk: Talk, index: int, hit: Hit) -> bool:
    """ped left kerb waiting; van left, parallel"""
    before = talk.hits[index - 1]
    return before.kind is Kind.OBJECT and before.stop == hit.first and not talk.busy


def _goes_on(talk: Talk, hit: Hit) -> bool:
    """Whether a word follows: the car left the lane."""
    after = talk.words[hit.stop] if hit.stop < len(talk.words) else "."
    return after[0].isalnum()


def _beside_place(talk: Talk, index: int) -> bool:
    near = talk.hits[max(index - 1, talk.start) : index + 2]
    return any(hit.kind is Kind.PLACE for hit in near)


def _in_a_place(words: list[str], at: int) -> bool:
    """Whether the words before a side are a preposition of place and its noun."""
    if words[at - 1] not in _SPOTS:
        return False
    return any(word in _AT for word in words[max(at - 5, 0) : at - 1])


def _moving_to(talk: Talk, index: int) -> bool:
    previous = talk.hits[index - 1] if index > talk.start else None
    hit = talk.hits[index]
    ours = _OURS & set(talk.words[hit.first : hit.stop])
    if "of" in talk.words[hit.first : hit.stop] and _OURS & set(
        talk.words[hit.stop - 2 : hit.stop]
    ):
        return False  # drives to the right of us
    if hit.first > 1 and _in_a_place(talk.words, hit.first):
        return False  # on the cycle path to the right
    if previous is not None and previous.kind is Kind.SCENE and index - 2 >= talk.start:
        return talk.hits[index - 2].kind is Kind.VERB  # runs across the road to the left
    loose = previous is not None and previous.stop < hit.first
    if loose and not ours and previous is not None and previous.kind is not Kind.IN_LANE:
        return True  # behind a verb that the rules don't know: he leaves to the left
    return previous is not None and (
        previous.kind is Kind.VERB or (previous.kind is Kind.SIDE and previous.form == "from")
    )
