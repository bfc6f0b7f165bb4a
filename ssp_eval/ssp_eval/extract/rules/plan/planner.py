"""Stage 5c: what the ego commits itself to, in plan units."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.plan.only_named import is_only_named
from ssp_eval.extract.rules.plan.orders import is_intended, is_linked, is_order, sets_off
from ssp_eval.extract.rules.plan.steering import lateral, straight_ahead
from ssp_eval.extract.rules.scope.echoes import opens_item
from ssp_eval.extract.rules.scope.flags import Scope
from ssp_eval.extract.rules.words.ego_verbs import LON_ACTIONS, STEERING
from ssp_eval.extract.rules.words.notation import phrases
from ssp_eval.extract.rules.world import Commitment, World

_ADVISING = frozenset(phrases("recommend, suggest, propose, advise, favour, favor, prefer"))
_FIRST_PERSON = frozenset(phrases("i, i'd"))
_ADVERBIAL = frozenset({Kind.JOIN, Kind.THEN})
_LIGHT = frozenset({Kind.MARK, Kind.PURPOSE})
# Stop for cars or bikes: no choice between actions.
_NOUNS = frozenset({Kind.OBJECT, Kind.PLACE, Kind.PRONOUN, Kind.SCENE})
MAX_WORDS = 6


class Planner:
    """Collects commitments; the reader tells it which verbs are the ego's."""

    __slots__ = (
        "advised",
        "bar",
        "barred",
        "either",
        "final",
        "first",
        "flags",
        "hits",
        "last",
        "later",
        "listed",
        "meta",
        "sides",
        "start",
        "stop",
        "unit",
        "words",
        "world",
    )

    def __init__(self, words: list[str], hits: list[Hit], flags: list[int], world: World) -> None:
        self.words, self.hits, self.flags, self.world = words, hits, flags, world
        self.unit = 0
        self.advised = 0  # the unit in which the first person says what it would do
        self.final = False
        self.start = self.stop = 0
        self.meta = False  # in a list of meta actions, of which the first is the present one
        self.listed: set[str] = set()  # slots that the list has filled
        self.later = False
        self.sides: set[int] = set()  # direction words that belong to a steering verb
        self.first: int | None = None  # first committed verb of the sentence
        self.either = False
        self.last: tuple[int, int, int] | None = None  # hit, first and stop of its commitments

    def begin(self, start: int, stop: int) -> None:
        """A new sentence is a new unit."""
        self.start, self.stop = start, stop
        self.first = None
        if self.listed and not opens_item(self.words, self.hits[start - 1].stop if start else 0):
            self.meta = False
        self._unit()

    def _unit(self) -> None:
        self.unit += 1
        self.later = False
        self.either = False
        self.bar = False  # accelerate | maintain: between alternatives of a form
        self.barred: set[str] = set()
        self.last = None

    def end(self) -> int | None:
        """Index of the first committed verb of the sentence, if any."""
        return self.first

    def key(self, index: int, hit: Hit) -> None:
        """A field of a structured answer: an action field is the final plan."""
        if hit.value in ("action", "lon_action", "lat_action") and not self.flags[index]:
            self.final = True
            self.meta = self.words[hit.first] == "meta"
            self.listed = set()
        self.either = self.bar = False
        self.barred = set()
        self.last = None

    def other(self, index: int, hit: Hit) -> None:
        """Hits that concern only the plan."""
        if hit.kind is Kind.FINAL:
            self.final = True
            self.meta = hit.value == "meta"
            self.listed = set()
        elif hit.kind is Kind.THEN:
            self._then(index, hit)
        elif hit.kind is Kind.REVISE:
            if self.last is None or self.words[hit.first] not in (
                "instead",
                "actually",
            ):
                self._unit()
            self.world.revised.append(self.unit)

    def _then(self, index: int, hit: Hit) -> None:
        """What follows is a later step; "afterwards" at the end of a clause dates what it ends."""
        following = self.hits[index + 1] if index + 1 < self.stop else None
        ends = following is None or (following.kind is Kind.MARK and following.value != ":")
        if not (ends and self.last is not None and hit.first - self.last[2] < MAX_WORDS):
            self.later = True
            return
        kept = self.world.commitments
        for at in range(len(kept) - 1, max(len(kept) - 3, -1), -1):
            if kept[at].first == self.last[1]:
                kept[at] = kept[at]._replace(later=True)

    def join(self, index: int, hit: Hit) -> None:
        """``but`` opens a unit; ``or`` between two actions takes both back."""
        if hit.value == "or":
            after = self.hits[index + 1 : min(index + 2, self.stop)]
            nouns = bool(after) and (
                after[0].kind in _NOUNS or self.words[after[0].first] in ("us", "me")
            )
            self.either = self.last is not None and not nouns
        elif hit.value == "but":
            self._unit()

    def mark(self, index: int, hit: Hit) -> None:
        """A semicolon opens a unit."""
        if hit.value == ";":
            self._unit()
        elif hit.value == "|" and self.last is not None and not self._in_table():
            self.bar = True

    def steers(self, hit: Hit) -> bool:
        """Whether a verb needs a direction to be a lateral action."""
        return hit.value in STEERING

    def takes_side(self, index: int) -> bool:
        """Whether a direction word has been used by a steering verb."""
        return index in self.sides

    def commands(self, index: int, other: bool, key: str) -> bool:
        """Whether a verb after somebody else's clause is an order to the ego."""
        return is_order(self.words, self.hits, index, self.start, other, key)

    def verb(self, index: int, hit: Hit, named: bool) -> None:
        """A verb whose subject is the ego (``named``) or nobody: an order or a heading."""
        sideways = lateral(self.words, self.hits, index, self.stop)
        if sideways is not None and sideways.side is not None:
            self.sides.add(sideways.side)
        longitudinal = LON_ACTIONS.get(hit.value)
        if named and hit.value == "recede" and sets_off(self.words, hit):
            longitudinal = "accelerate"
        if hit.form == "ed" or (hit.form == "s" and not named):
            return
        if sideways is None and longitudinal is None:
            if self.either and hit.value in STEERING:
                self._take_back()  # brake or swerve
            return
        if is_only_named(self.words, self.hits, index, self.start, self.stop):
            return
        flags = self.flags[index] & ~Scope.AHEAD
        if flags:
            if self._would(index, flags) or self._intends(index, flags):
                flags = 0
            elif flags & ~Scope.READY == 0:
                return
        if flags:
            if self.either:
                self._take_back()
            self.last = None
            return
        if self.either:
            self._take_back()
            return
        slot = "lon_action" if longitudinal is not None else "lat_action"
        if self._is_barred(slot):
            return
        before = None if self.last is None else self.last[0]
        linked = before is not None and is_linked(self.words, self.hits, before, index)
        if longitudinal is not None:
            self._commit("lon_action", longitudinal, hit.first, hit.stop, linked)
        if sideways is not None:
            self._commit("lat_action", sideways.value, hit.first, sideways.stop, linked)
        ahead = None if sideways else straight_ahead(self.words, self.hits, index, self.stop)
        if ahead is not None:
            self._commit("lat_action", "straight", ahead.first, ahead.stop, True)
        self.last = (index, hit.first, sideways.stop if sideways else hit.stop)
        if self.first is None:
            self.first = index

    def _intends(self, index: int, flags: int) -> bool:
        """The ego intends to slow down: of the ego an intention is the plan."""
        return flags == Scope.READY and is_intended(self.hits, index, self.start)

    def _would(self, index: int, flags: int) -> bool:
        """I'd brake: what the first person would do is what it advises."""
        hit = self.hits[index]
        if flags != Scope.POSSIBLE or hit.form not in ("base", "ing"):
            return False
        if hit.form == "ing":  # I would recommend slowing down
            advised = self.words[hit.first - 1] in _ADVISING
            return advised and not _FIRST_PERSON.isdisjoint(self.words[hit.first - 4 : hit.first])
        before = index - 1
        while before > self.start and self.hits[before].kind in _ADVERBIAL:
            before -= 1  # I'd therefore brake
        previous = self.hits[before] if index > self.start else None
        if previous is None or previous.kind is not Kind.MODAL:
            goes_on = self.hits[index - 1].value in ("and", ",") and self.last is not None
            return goes_on and self.advised == self.unit
        word = self.words[previous.first]
        if word == "i'd" or (word == "would" and self.words[previous.first - 1] == "i"):
            self.advised = self.unit
            return True
        return False

    def side(self, index: int, hit: Hit) -> bool:
        """A direction that is the value of a lateral field: 0.5 m to the left, slightly left."""
        if self.flags[index] or hit.form not in ("bare", "to", "into") or self.bar:
            return False
        if index == self.start or self.hits[index - 1].value not in (":", "=", '"', "|"):
            return False
        self._commit("lat_action", hit.value, hit.first, hit.stop, False)
        self.last = (index, hit.first, hit.stop)
        return True

    def in_lane(self, index: int, hit: Hit, own: bool) -> None:
        """brake in my lane: the braking is the commitment, the lane rides on it."""
        if not own or hit.value == "path" or self.flags[index] or self.last is None:
            return
        last, first, _ = self.last
        between = self.hits[last + 1 : index]
        near = all(one.kind in _LIGHT for one in between[-2:]) or len(between) < 3
        if len(between) < 5 and near and self.hits[last].value in LON_ACTIONS:
            self._commit("lat_action", "straight", first, hit.stop, True)

    def _commit(self, slot: str, value: str, first: int, stop: int, linked: bool) -> None:
        later = self.later or (self.meta and slot in self.listed)
        self.listed.add(slot)
        self.world.commitments.append(
            Commitment(slot, value, first, stop, self.unit, later, self.final, linked)
        )

    def _in_table(self) -> bool:
        return self.hits[self.start].value == "|"

    def _is_barred(self, slot: str) -> bool:
        """Whether an action is one of several for the same slot between bars."""
        kept = self.world.commitments
        if self.bar and self.last is not None and kept and kept[-1].slot == slot:
            self._take_back()
            self.barred.add(slot)
        self.bar = False
        return slot in self.barred

    def _take_back(self) -> None:
        """brake or change lanes: neither is a commitment."""
        self.either = False
        if self.last is not None:
            first = self.last[1]
            kept = self.world.commitments
            while kept and kept[-1].first >= first:
                kept.pop()
        self.last = None
