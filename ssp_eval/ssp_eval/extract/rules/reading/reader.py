"""Stage 5: goes through the hits of each sentence from left to right and binds who does what."""

from __future__ import annotations

from collections.abc import Callable

from ssp_eval.extract.rules.actors import ego
from ssp_eval.extract.rules.conflict import stated
from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.motion import doing, whereabouts
from ssp_eval.extract.rules.reading import named, relevance, whose_verb
from ssp_eval.extract.rules.talk import EGO, Talk
from ssp_eval.extract.rules.world import Actor, Statement, World


def read(
    words: list[str], hits: list[Hit], flags: list[int], ranges: list[tuple[int, int]]
) -> World:
    """What the text says of road users and of the ego's plan.

    Args:
        words: the words of stage 1.
        hits: the phrases of stage 2.
        flags: the scope of each hit.
        ranges: half-open ranges of hits, one per sentence.
    """
    talk = Talk(words, hits, flags)
    for start, stop in ranges:
        talk.number += 1
        if stop - start == 1 and hits[start].kind is Kind.MARK:
            _blank(talk, hits[start])
            continue
        talk.begin(start, stop)
        talk.planner.begin(start, stop)
        for index in range(start, stop):
            hit = hits[index]
            _TABLE[hit.kind](talk, index, hit)
        _end(talk)
    return talk.world


def _end(talk: Talk) -> None:
    """What only the whole sentence shows: whom its plan concerns, and whether nobody is there."""
    planned = talk.planner.end()
    stated.end(talk)
    if planned is not None:
        _react(talk, planned)
    if {"car", "pedestrian", "cyclist"} <= talk.denied:
        first, stop = talk.hits[talk.start].first, talk.hits[talk.stop - 1].stop
        talk.world.nobody = Statement("", first, stop, talk.number)
    if talk.pending and not talk.named and talk.last is not None and _places_only(talk):
        whose = talk.spoken_of()
        for index in talk.pending:  # Child. In front.
            if whose is not None:
                talk.put(whose, index, talk.flags[index])
    last = talk.hits[talk.stop - 1]
    asks = last.value == "?" and not talk.named and talk.subject is not EGO
    talk.asked = [talk.said(talk.hits[at].value, talk.hits[at]) for at in talk.pending if asks]
    before = talk.hits[talk.stop - 2] if talk.stop - 2 >= talk.start else None
    if not (before is not None and before.value == ":" and last.value == "\n"):
        talk.key = ""
    _carry_list(talk, planned is not None or talk.subject is EGO)


def _react(talk: Talk, planned: int) -> None:
    """Who is named first after the plan's verb is what it is about, and who is joined to him."""
    about: int | None = None
    for index, actor in talk.named:
        first = index > planned and about is None
        if first or (about is not None and _joined(talk, about, index)):
            actor.reaction, about = 2, index
        else:
            actor.reaction = max(actor.reaction, 1)


def _joined(talk: Talk, first: int, second: int) -> bool:
    between = talk.hits[first + 1 : second][:4]
    return all(hit.kind is Kind.JOIN or hit.value == "," for hit in between)


def _places_only(talk: Talk) -> bool:
    kinds = (Kind.PLACE, Kind.SIDE, Kind.MARK)
    hits = talk.hits[talk.start : talk.stop]
    spoken = sum(hit.stop - hit.first for hit in hits)
    return all(hit.kind in kinds for hit in hits) and spoken == hits[-1].stop - hits[0].first


def _opens_item(talk: Talk, hit: Hit) -> bool:
    """A line break before a bullet, or the number of an item."""
    words = talk.words
    bullet = words[hit.stop : hit.stop + 1] == [","]
    return bullet or (hit.first > 0 and words[hit.first - 1].isdigit())


def _blank(talk: Talk, hit: Hit) -> None:
    """A mark alone, such as a line break, behind which an item of a list may begin."""
    talk.key = ""
    talk.under = talk.under and hit.value != "\n"
    if hit.value == "\n":
        talk.listing = talk.listing or (talk.listed and _opens_item(talk, hit))
    else:
        talk.listed, talk.listing = talk.listing, False


def _carry_list(talk: Talk, ego: bool) -> None:
    """A list of critical objects goes on over its items and ends with prose or the plan."""
    broken = talk.hits[talk.stop - 1].value == "\n" and talk.stop - talk.start > 3
    talk.under = (talk.under or talk.heading) and not ego and not broken
    talk.listed = talk.listing and not ego
    talk.listing = talk.listed and talk.hits[talk.stop - 1].value == "\n"


def _plan(talk: Talk, index: int, hit: Hit) -> None:
    talk.planner.other(index, hit)


def _join(talk: Talk, index: int, hit: Hit) -> None:
    talk.planner.join(index, hit)
    if hit.value in ("and", "or"):
        _carry(talk, index)
        return
    following = talk.hits[index + 1] if index + 1 < talk.stop else None
    if hit.value == "while" and following is not None and following.form == "ing":
        return
    if hit.value == "now" or (hit.value == "by" and talk.subject is EGO):
        return
    adverb = talk.words[hit.first] in ("therefore", "thus", "hence", "consequently", "however")
    if adverb and index > talk.start and talk.hits[index - 1].kind in (Kind.EGO, Kind.OBJECT):
        return  # the ego therefore slows
    talk.listing = False
    if hit.value == "because" and talk.planner.first is not None:
        talk.reacting = True
    elif hit.value == "but" or hit.value == "so":
        talk.reacting = False
    talk.clear()


def _not(talk: Talk, index: int, hit: Hit) -> None:
    """A cell of a table that only says no puts its row's road user aside."""
    after = talk.hits[index + 1].value if index + 1 < talk.stop else "\n"
    cell = hit.value == "no" and after in ("|", "\n")
    if cell and talk.named and talk.hits[index - 1].value == "|" and _last_cell(talk, index + 1):
        talk.named[0][1].background = True
    _plan(talk, index, hit)


def _last_cell(talk: Talk, index: int) -> bool:
    """Whether nothing but marks follows in the row."""
    return all(hit.kind is Kind.MARK for hit in talk.hits[index : min(index + 3, talk.stop)])


def _carry(talk: Talk, index: int) -> None:
    """After "and" the subject goes on; a noun for a participle doesn't."""
    following = talk.hits[index + 1] if index + 1 < talk.stop else None
    before = talk.hits[index - 1] if index > talk.start else None
    scene = following is not None and following.kind is Kind.SCENE
    if scene and before is not None and before.kind is Kind.OBJECT:
        return  # a worker and cones on the right
    if scene and _has_clause(talk, index + 1):
        talk.clear()  # the taxi keeps its distance and the lane in front is empty
        return
    if following is None or following.kind is not Kind.OBJECT:
        talk.near = talk.subject if isinstance(talk.subject, Actor) else None
    talk.busy = False


def _has_clause(talk: Talk, index: int) -> bool:
    """Whether a noun that is no road user has a verb of its own."""
    for after in range(index + 1, min(index + 4, talk.stop)):
        hit = talk.hits[after]
        if hit.kind is Kind.AUX:
            return True
        if hit.kind not in (Kind.PLACE, Kind.SIDE, Kind.SCENE):
            return hit.kind is Kind.VERB and hit.form == "s"
    return False


def _side(talk: Talk, index: int, hit: Hit) -> None:
    if talk.key == "lat_action" and talk.planner.side(index, hit):
        return
    whereabouts.read_side(talk, index, hit)


def _mark(talk: Talk, index: int, hit: Hit) -> None:
    talk.planner.mark(index, hit)
    if hit.value == ":" and index > talk.start and talk.hits[index - 1].kind is Kind.EGO:
        talk.busy = False  # Ego: slows down.
    elif hit.value == ":" and _labels(talk, index):
        talk.busy = False  # Truck: at the kerb. Front: a pedestrian.
    elif hit.value in (";", ":", "["):
        talk.clear()
    elif hit.value == ",":
        talk.adjectives = []
        talk.busy = False
        if not isinstance(talk.subject, Actor):
            talk.reacting = talk.reacting and talk.subject is not EGO


def _labels(talk: Talk, index: int) -> bool:
    """Whether a colon follows a road user or a place that what comes next speaks of."""
    before = talk.hits[index - 1] if index > talk.start else None
    if before is None or talk.subject is EGO:
        return False
    if before.kind is Kind.MARK and before.value == '"' and index - 2 >= talk.start:
        before = talk.hits[index - 2]
    if before.kind is Kind.MARK and before.value == ")":
        for opener in range(index - 2, max(index - 10, talk.start), -1):
            if talk.hits[opener].value == "(":
                before = talk.hits[opener - 1]
                break
    return before.kind in (Kind.OBJECT, Kind.PLACE, Kind.SIDE)


_HANDLERS: dict[Kind, Callable[[Talk, int, Hit], None]] = {
    Kind.OBJECT: named.read_object,
    Kind.EGO: ego.read_ego,
    Kind.PRONOUN: named.read_pronoun,
    Kind.RELATIVE: named.read_relative,
    Kind.SCENE: named.read_scene,
    Kind.PLACE: whereabouts.read_place,
    Kind.SIDE: _side,
    Kind.VERB: whose_verb.read_verb,
    Kind.STATE: doing.read_state,
    Kind.RISK: stated.read_risk,
    Kind.CONFLICT: stated.read_conflict,
    Kind.IN_LANE: stated.read_in_lane,
    Kind.MODAL: stated.read_modal,
    Kind.HYPOTHETICAL: stated.read_possible,
    Kind.CRITICAL: relevance.read_critical,
    Kind.REACT: relevance.read_react,
    Kind.REJECT: relevance.read_react,
    Kind.BACKGROUND: relevance.read_background,
    Kind.MATTERS: relevance.read_matters,
    Kind.NOBODY: relevance.read_nobody,
    Kind.KEY: relevance.read_key,
    Kind.NOT: _not,
    Kind.JOIN: _join,
    Kind.MARK: _mark,
}
_TABLE = [_HANDLERS.get(kind, _plan) for kind in Kind]
