"""Stage 4a: what is in force at each hit of a sentence, worked out in one pass.

A clause ends at a mark or a conjunction; a condition reaches to the end of its sentence or to the
next ``but``.
"""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.scope.flags import Scope
from ssp_eval.extract.rules.scope.thwarted import is_thwarted

REACH = 24  # hits that a backward look covers, so that the whole stays linear


_OPEN = Scope.POSSIBLE | Scope.REJECTED  # one could also honk and keep the speed


class Sentence:
    """One pass over the hits of a sentence, with what is in force at each."""

    __slots__ = (
        "clause",
        "flags",
        "hits",
        "local",
        "predicate",
        "start",
        "stop",
        "verb",
        "wide",
        "words",
    )

    def __init__(
        self, words: list[str], hits: list[Hit], flags: list[int], start: int, stop: int
    ) -> None:
        self.words = words
        self.hits, self.flags, self.start, self.stop = hits, flags, start, stop
        self.clause = start  # first hit of the clause
        self.local = 0  # in force until the clause ends
        self.wide = 0  # in force until the sentence ends or "but"
        self.verb: int | None = None  # the last verb since "but" or the start
        self.predicate = False  # an auxiliary has been seen since the verb

    def run(self) -> None:
        """Sets the flags of the sentence's hits."""
        hits, flags = self.hits, self.flags
        for index in range(self.start, self.stop):
            hit = hits[index]
            kind = hit.kind
            if kind is Kind.MARK:
                self._mark(index, hit.value)
            elif kind is Kind.JOIN:
                self._join(index, hit.value)
            elif kind is Kind.THEN:
                self._and(index)
            elif kind is Kind.VERB:
                flags[index] |= self.local | self.wide
                if is_thwarted(self.words, hit):
                    flags[index] |= Scope.REJECTED
                self.verb, self.predicate = index, False
            elif kind is Kind.OBJECT:
                flags[index] |= self._for_object(index)
            elif kind is Kind.CONDITION:
                self._condition(index, hit.value)
            else:
                flags[index] |= self.local | self.wide
                self._operator(index, hit)

    def _operator(self, index: int, hit: Hit) -> None:
        kind, value = hit.kind, hit.value
        if kind is Kind.NOT:
            if value == "no":
                self._answer_no(index)
            self.local |= Scope.DENIED
            self._deny_subject(index, Scope.DENIED)
        elif kind is Kind.QUOTE and value == "not":
            self.local |= Scope.DENIED
            self._clause_back(index, Scope.REJECTED)
        elif kind is Kind.NO_LONGER:
            self.local |= Scope.GONE
        elif kind is Kind.MODAL:
            if value == "may":
                self.local |= Scope.POSSIBLE
                self._deny_subject(index, Scope.POSSIBLE)
            elif value == "will":
                self.local |= Scope.AHEAD
        elif kind is Kind.AUX:
            self.predicate = True
            if value == "is":
                self.local &= ~Scope.PAST  # the car that cut in earlier is now …
            if value == "past":
                self._clause_back(index, Scope.PAST)
                self.local |= Scope.PAST
        elif kind is Kind.HISTORY:
            self._clause_back(index, Scope.PAST, Kind.RELATIVE)
            self.local |= Scope.PAST
        elif kind is Kind.READY:
            self.local |= Scope.READY
        elif kind is Kind.REJECT:
            if value == "item" and index > self.start and self.hits[index - 1].value == ",":
                self._reject_item(index - 1)
            self.local |= Scope.REJECTED
        elif kind is Kind.REJECTED:
            if index > self.start and self.hits[index - 1].value == ",":
                self._reject_item(index - 1)
            for verb in range(max(self.clause, index - REACH), index):
                if self.hits[verb].kind is Kind.VERB:
                    self.flags[verb] |= Scope.REJECTED
        elif kind is Kind.HYPOTHETICAL:
            self.local |= Scope.POSSIBLE

    def _answer_no(self, index: int) -> None:
        """Vehicle cutting in: no. Cyclists: none."""
        before = self.hits[index - 1] if index > self.start else None
        after = self.hits[index + 1] if index + 1 < self.stop else None
        if before is None or before.value != ":" or (after and after.kind is not Kind.MARK):
            return
        for at in range(index - 2, max(index - REACH, self.start) - 1, -1):
            if self.hits[at].kind is Kind.MARK:
                return
            if self.hits[at].kind in (Kind.VERB, Kind.OBJECT):
                self.flags[at] |= Scope.DENIED

    def _reject_item(self, comma: int) -> None:
        """(ii) lane change to the left, rejected, since …"""
        for at in range(comma - 1, max(self.start, comma - REACH) - 1, -1):
            if self.hits[at].kind is Kind.MARK and self.hits[at].value != ",":
                return
            if self.hits[at].kind is Kind.VERB:
                self.flags[at] |= Scope.REJECTED

    def _deny_subject(self, index: int, flag: int) -> None:
        """Braking is not necessary: the verb is the clause's subject and is what is denied."""
        if self.verb is None or (flag is Scope.DENIED and not self.predicate):
            return
        if self.verb < self.clause or self.hits[self.verb].form not in ("ing", "noun"):
            return
        subjects = (Kind.EGO, Kind.OBJECT, Kind.PRONOUN, Kind.SCENE)
        if not any(
            self.hits[i].kind in subjects
            for i in range(max(self.clause, self.verb - REACH), self.verb)
        ):
            self._clause_back(index, flag)

    def _clause_back(self, index: int, flag: int, until: Kind | None = None) -> None:
        for before in range(index - 1, max(self.clause, index - REACH) - 1, -1):
            if self.hits[before].kind is until:
                return  # the taxi that cut in a moment ago: the taxi is there
            self.flags[before] |= flag

    def _for_object(self, index: int) -> int:
        """Presence: denied by no, imagined by if; not touched by what is done to it."""
        local = self.local & ~(Scope.REJECTED | Scope.READY | Scope.AHEAD)
        if self.hits[index].form == "definite":
            local &= ~Scope.IMAGINED  # until the car has passed: it is there
        if local & (Scope.DENIED | Scope.POSSIBLE | Scope.GONE) and self._known(index):
            local &= ~(Scope.DENIED | Scope.POSSIBLE | Scope.GONE)
        return local | (self.wide & ~Scope.IMAGINED if self._placed(index) else self.wide)

    def _placed(self, index: int) -> bool:
        """if the van on the right cuts in: whom a place points out is there."""
        following = self.hits[index + 1] if index + 1 < self.stop else None
        if self.hits[index].form != "definite" or following is None:
            return False
        beside = following.kind is Kind.PLACE or (
            following.kind is Kind.SIDE and following.form == "at"
        )
        return beside and following.first == self.hits[index].stop

    def _known(self, index: int) -> bool:
        """Whether the object is only what is (not) acted upon: hit the car, affect the bus."""
        for before in range(index - 1, max(self.clause, index - REACH) - 1, -1):
            hit = self.hits[before]
            if hit.kind is Kind.NOT and hit.value == "no":
                return False
            if hit.kind in (Kind.NOT, Kind.HYPOTHETICAL, Kind.MODAL, Kind.NO_LONGER):
                return self.hits[index].form == "definite"
        return True

    def _mark(self, index: int, value: str) -> None:
        if value == "," and self._continues_list(index):
            self.flags[index] = self.local
            return
        denied = index > self.start and self.hits[index - 1].kind is Kind.NOT
        if value == '"' and denied:
            return  # not "slow"
        self.local = 0
        self.clause = index + 1
        self.predicate = False
        if value == ":":
            self.verb = None
        if value == ";" and not self._next_is_otherwise(index):
            self.wide = 0
            self.verb = None

    def _next_is_otherwise(self, index: int) -> bool:
        after = index + 1
        return after < self.stop and self.hits[after].kind is Kind.CONDITION

    def _continues_list(self, index: int) -> bool:
        """no cars, trucks or buses: the comma stands between nouns."""
        if index == self.start or self.hits[index - 1].kind is not Kind.OBJECT:
            return False
        for after in range(index + 1, min(index + 4, self.stop)):
            hit = self.hits[after]
            if hit.kind is Kind.OBJECT:
                return True
            if hit.kind is not Kind.JOIN or hit.value not in ("and", "or"):
                return False
        return False

    def _join(self, index: int, value: str) -> None:
        self.flags[index] |= self.local | self.wide
        if value == "or":
            if index == self.start:
                self.wide |= Scope.POSSIBLE  # Or change to the left queue.
            elif self.verb is not None:  # it would go straight, or turn right
                self.local |= self.flags[self.verb] & (Scope.POSSIBLE | Scope.REJECTED)
            return
        if value == "and":
            self._and(index)
            return
        self.local = 0
        self.clause = index + 1
        self.predicate = False
        if value == "but":
            self.wide = 0
            self.verb = None
        elif value == "so":
            self.verb = None
            self.wide &= ~Scope.IMAGINED  # if it came, we'd be late, so this is a hazard

    def _and(self, index: int) -> None:
        after = index + 1
        if after >= self.stop:
            return
        following = self.hits[after]
        if self.local & Scope.IMAGINED and self._only_noun(index):
            self.local &= ~Scope.IMAGINED
        if following.kind is Kind.VERB and following.form == "base" and self.local & _OPEN:
            return  # one could honk and keep the speed
        if following.kind is Kind.OBJECT and self.hits[index - 1].kind is Kind.OBJECT:
            return
        if following.kind is Kind.VERB and following.form in ("base", "ing"):
            before = next(
                (h for h in self.hits[max(index - 3, self.clause) : index] if h.kind is Kind.VERB),
                None,
            )
            if before is not None and before.form == following.form and not self._do_not():
                return
        self.local = 0
        self.clause = after
        self.predicate = False

    def _only_noun(self, index: int) -> bool:
        """before the van and …: whether what comes before or until is no clause."""
        for at in range(index - 1, max(self.clause, index - REACH) - 1, -1):
            if self.hits[at].kind is Kind.CONDITION:
                return True
            if self.hits[at].kind is Kind.VERB:
                return False
        return False

    def _do_not(self) -> bool:
        """Whether the denial in force is a plain "do not", which ends at "and"."""
        kinds = [hit.kind for hit in self.hits[self.clause : self.clause + 6]]
        return bool(self.local & Scope.DENIED) and Kind.MODAL not in kinds

    def _turned(self, index: int) -> bool:
        """Whether another clause stands between the last verb and a condition behind it."""
        between = self.hits[(self.verb or 0) + 1 : index][-REACH:]
        kinds = [hit.kind for hit in between]
        if any(hit.kind is Kind.JOIN and hit.value == "because" for hit in between):
            return True  # reduce the speed, as he will hit us unless …
        return Kind.EGO in kinds and Kind.JOIN in kinds[: kinds.index(Kind.EGO)]

    def _condition(self, index: int, value: str) -> None:
        previous = self.hits[index - 1] if index > self.start else None
        opens = previous is None or previous.kind in (Kind.MARK, Kind.JOIN)
        near = self.verb is not None and (self.verb >= self.clause or not self.predicate)
        trailing = near and (value == "needed" or not opens)
        following = self.hits[index + 1] if index + 1 < self.stop else None
        if value == "else" or (value == "case" and trailing):  # slow down in case he runs
            self.wide |= Scope.IMAGINED
            return
        if value == "after" and following is not None and following.form == "ing":
            return  # after yielding, merge: a sequence, no condition
        if trailing and value != "until" and self.verb is not None and not self._turned(index):
            self.flags[self.verb] |= Scope.IMAGINED
        if value in ("until", "after"):
            self.local |= Scope.IMAGINED
        elif value != "needed":
            self.wide |= Scope.IMAGINED
