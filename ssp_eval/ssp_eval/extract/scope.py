"""The scope in force at each hit: negation, hypotheticals, the past, echoes, other plans.

The cues, what each makes of the words around it, and how far it reaches stand in ``scope.yaml``. A
clause ends at a mark or a conjunction; a condition reaches to the end of its sentence or to "but".
"""

from __future__ import annotations

from enum import IntFlag

from ssp_eval.extract.lexicon import lexicon
from ssp_eval.extract.match import Hit


class Scope(IntFlag):
    """Reasons why words are no evidence of the present."""

    DENIED = 1
    IMAGINED = 2
    POSSIBLE = 4
    FUTURE = 8
    PAST = 16
    PLANNED = 32
    REJECTED = 64
    QUOTED = 128
    LATER = 256
    INTENDED = 512


_SUBJECTS = frozenset({"user", "pronoun", "ego", "scene"})
_NOT_OF_THINGS = Scope.REJECTED | Scope.PLANNED | Scope.FUTURE | Scope.LATER | Scope.INTENDED
_OPTIONS = frozenset({"options", "alternatives", "candidates", "choices"})
_ITEMS = frozenset({"(", "a", "b", "c", "d", "i", "ii", "iii", "1", "2", "3", "4", ")"})
_WORDS_TOO = frozenset({"a", "i"})  # of these marks
_COUNTS = frozenset({"a", "an", "one", "two", "three", "four", "five", "six", "several", "many"})
_BETWEEN = 2  # words before the next one of several actions
_TO_OR = 6  # words behind it in which "or" stands
_HEADING = 4  # words of a heading
# Words with which a heading says that what is below isn't the decision: "For example:", "Plan B:".
_DISOWNING = frozenset(
    {"example", "examples", "for", "hypothesis", "contingency", "fallback", "plan", "previous"}
    | {"last", "prev", "history", "rejected", "not"}
)
_FRAMES = frozenset({"frame", "frames", "image", "picture"})
_BREAKS = frozenset({".", "?", "\n"})
REACH = 24  # hits that a backward look covers, so that the whole stays linear


def scopes(words: list[str], hits: list[Hit], ranges: list[tuple[int, int]]) -> list[Scope]:
    """Return the flags of every hit."""
    flags = [Scope(0)] * len(hits)
    headings = [_Sentence(words, hits, flags, start, stop).run() for start, stop in ranges]
    _echoes(words, hits, flags, ranges)
    _below_headings(words, hits, flags, ranges, headings)
    return flags


class _Sentence:
    def __init__(
        self, words: list[str], hits: list[Hit], flags: list[Scope], start: int, stop: int
    ) -> None:
        self.words, self.hits, self.flags = words, hits, flags
        self.start, self.stop, self.clause = start, stop, start
        self.local = self.wide = Scope(0)
        self.verb: Hit | None = None
        self.weighed = False  # what is quoted is what one could do, or later does
        self.verb_at = start

    def run(self) -> Scope:
        """Set the flags of the sentence's hits; return those of what it is the heading of."""
        for index in range(self.start, self.stop):
            hit = self.hits[index]
            if hit.kind == "mark":
                self._mark(index, hit.value)
            elif hit.kind == "cue":
                self._cue(index, hit)
            else:
                self.flags[index] |= self._at(index, hit)
                if index > self.start and self._attached(index, hit):
                    self.flags[index] = self.flags[index - 1]
                if hit.kind == "relative" or self._opens_main_clause(hit):
                    self._end(index)
                elif hit.kind in ("verb", "noun", "action"):
                    self.verb, self.verb_at = hit, index
        return self._of_heading()

    def _of_heading(self) -> Scope:
        """Return the flags of the lines below: "For example:", "If the van merges:"."""
        last = self.hits[self.stop - 1]
        if last.value != "\n" or self.words[last.first - 1] != ":" or not self.wide:
            return Scope(0)
        cues = [hit for hit in self.hits[self.start : self.stop] if hit.kind == "cue"]
        if self.wide & Scope.QUOTED:
            quoting = (hit for hit in cues if hit.value in ("quoted", "rejected"))
            disowns = any(self.words[hit.first] in _DISOWNING for hit in quoting)
            return Scope.QUOTED if disowns else Scope(0)
        says_nothing = bool(cues) and cues[-1].stop == last.first - 1  # as you provided:
        return Scope(0) if says_nothing else self.wide & Scope.IMAGINED

    def _opens_main_clause(self, hit: Hit) -> bool:
        """Tell whether the VUT decides behind what it rejects: rather than braking I go on."""
        if hit.kind != "ego" or self.verb is None:
            return False
        gerund = self.local == Scope.IMAGINED and self.verb.form == "ing"  # before turning I stop
        if not self.local & Scope.REJECTED and not gerund:
            return False
        return self.verb_at >= self.clause and self.words[hit.first] in ("i", "we")

    def _attached(self, index: int, hit: Hit) -> bool:
        """Tell whether an attribute stands right behind its noun, and is as true as the noun is."""
        before = self.hits[index - 1]
        if before.kind not in ("user", "place", "from") or hit.first - before.stop > 1:
            return False
        return hit.kind in ("place", "from") or (hit.form == "ing" and hit.kind == "verb")

    def _at(self, index: int, hit: Hit) -> Scope:
        if hit.kind not in ("user", "place", "from"):
            return self.local | self.wide
        local = self.local & ~_NOT_OF_THINGS
        wide = self.wide
        zero = self.words[max(hit.first - 1, 0) : hit.first] == ["0"]
        if hit.kind == "user" and (zero or self.words[hit.stop : hit.stop + 2] == ["x", "0"]):
            return local | wide | Scope.DENIED
        if hit.kind == "user" and hit.form == "the":  # until the car has passed: it is there
            local &= ~(Scope.IMAGINED | Scope.POSSIBLE | Scope.DENIED)
            following = self.hits[index + 1] if index + 1 < self.stop else None
            if following is not None and following.kind == "place":
                wide &= ~Scope.IMAGINED
        elif (
            hit.kind == "user"
            and self.verb is not None
            and self.verb_at >= self.clause
            and self.words[hit.first - 1] not in ("no", "any")
        ):
            local &= ~Scope.DENIED  # doesn't affect a car
        return local | wide

    def _end(self, index: int) -> None:
        self.local = Scope(0)
        self.clause = index + 1

    def _mark(self, index: int, value: str) -> None:
        if value == ":" and self._heads_the_past(index):
            self.wide |= Scope.PAST
        near = self.hits[max(index - 1, self.start) : index + 3]
        if (
            value == ","
            and near[0].kind == "user"
            and any(hit.kind == "user" or hit.value in ("or", "and") for hit in near[2:])
            and not any(self._counted(hit) for hit in near[2:])
        ):
            return  # no cars, trucks or buses; but: no cars, two trucks
        if value == '"' and near[0].kind == "cue" and self.local & Scope.DENIED:
            return  # not "slow"
        if value == "," and self.local & Scope.PLANNED and self._enumerates(index):
            return  # thinking about braking, stopping or a lane change
        self._end(index)
        if value in (";", "|"):
            self.wide &= Scope(0) if value == ";" and self.weighed else Scope.QUOTED

    def _enumerates(self, index: int) -> bool:
        """Tell whether a comma parts actions of one form, the last of them behind "or"."""
        behind = self.hits[index + 1 : min(index + 3, self.stop)]
        following = next((hit for hit in behind if hit.kind in ("verb", "noun")), None)
        if following is None or self.verb is None or self.verb_at < self.clause:
            return False
        first = self.hits[index].stop
        close = following.first - first <= _BETWEEN and following.form == self.verb.form
        return close and "or" in self.words[first : following.stop + _TO_OR]

    def _heads_the_past(self, index: int) -> bool:
        """Tell whether a line's heading says that the rest of it is past: T-3 s: …; Before: …."""
        stop = self.hits[index].first
        first = stop
        while first > 0 and stop - first <= _HEADING and self.words[first - 1] not in _BREAKS:
            first -= 1
        heading = self.words[first:stop]
        past_words = lexicon().sets["words_of_the_past"]
        has_past_word = len(heading) <= 2 and not past_words.isdisjoint(heading[:1])
        is_past = bool(self.local & Scope.PAST) and _FRAMES.isdisjoint(heading)
        return len(heading) <= _HEADING and (has_past_word or is_past)

    def _counted(self, hit: Hit) -> bool:
        """Tell whether a road user has a number or an article, so that it opens a new statement."""
        before = self.words[hit.first - 1] if hit.first else ""
        return hit.kind == "user" and (before in _COUNTS or (before.isdigit() and before != "0"))

    def _cue(self, index: int, hit: Hit) -> None:  # noqa: C901  # a table of cases, one a line
        name = hit.value
        cue = lexicon().cues[name]
        flag, reach = Scope[cue["flag"].upper()] if cue["flag"] else Scope(0), cue["reach"]
        self.flags[index] |= self.local | self.wide
        if name == "ticked":
            self.wide = self.local = Scope(0)
        if name == "no" and self._answers(index):
            for before in range(max(self.start, index - REACH), index):
                if self.hits[before].kind in ("user", "verb", "risk"):
                    self.flags[before] |= Scope.DENIED
        if name == "but" and self._parenthetic(index):
            return
        if self.words[hit.first] == "or" and index + 1 < self.stop:
            both = self.hits[index - 1], self.hits[index + 1]
            if all(one.kind in ("verb", "noun", "action") for one in both):
                self.flags[index - 1] |= Scope.POSSIBLE
        if name in ("but", "so", "because", "while", "final"):
            self._end(index)
            if name == "but":
                self.wide = Scope(0)
            elif name == "so":
                self.wide &= ~Scope.IMAGINED
        elif name == "and":
            self._and(index)
        elif reach == "forward":
            self.local |= flag
            if flag in (Scope.DENIED, Scope.POSSIBLE):
                self._subject(index, flag)
            if name == "then":
                self._end(index)
                self.local |= flag
        elif reach == "condition":
            opens = index == self.start or self.hits[index - 1].kind == "mark"
            if not opens and self.verb is not None and self.verb_at >= self.clause:
                self.flags[self.verb_at] |= flag
            self.wide |= flag
        elif reach == "sentence":
            self.wide |= flag
            self.weighed = self.words[hit.stop - 1] in ("could", "later")
        elif name == "rejected" and index == self.start and self.hits[index + 1 :][:1]:
            self.wide |= Scope.QUOTED  # not recommended: speed up; …
        elif reach in ("back", "clause"):
            for before in range(max(self._back(index), index - REACH), index):
                self.flags[before] |= flag
            if reach == "clause":
                self.local |= flag
        elif name == "is" and self.words[hit.first] != "been":
            self.local &= ~Scope.PAST

    def _answers(self, index: int) -> bool:
        """Tell whether a word answers a field or list: Cyclists: none. | lead vehicle | none |."""
        hit = self.hits[index]
        before = self.words[hit.first - 1] if hit.first else ""
        is_none = self.words[hit.first] == "none"
        ends = is_none or index + 1 == self.stop or self.hits[index + 1].kind == "mark"
        return ends and (before in (":", "|") or (before == "," and is_none))

    def _parenthetic(self, index: int) -> bool:
        """Tell whether a word stands between commas: the SUV, however, is turning."""
        hit = self.hits[index]
        around = self.words[hit.first - 1 : hit.first], self.words[hit.stop : hit.stop + 1]
        return around == ([","], [","])

    def _back(self, index: int) -> int:
        """Find the begin of a clause that is taken back behind a mark: constant speed, rejected."""
        start = self.clause
        if start == index and index > self.start and self.hits[index - 1].value in (",", ":"):
            start = index - 1
            while start > max(self.start, index - REACH) and self.hits[start - 1].kind != "mark":
                start -= 1
        return start

    def _subject(self, index: int, flag: Scope) -> None:
        """Braking is not necessary: a noun of action before the cue is what is denied."""
        if flag is Scope.POSSIBLE:
            for before in range(max(self.clause, index - REACH), index):
                if self.hits[before].kind == "risk":
                    self.flags[before] |= flag
        if self.verb is None or self.verb_at < self.clause:
            return
        if self.verb.form == "ing" or self.verb.kind == "noun":
            between = self.hits[max(self.clause, index - REACH) : index]
            if not any(hit.kind in _SUBJECTS for hit in between):
                self.flags[self.verb_at] |= flag

    def _and(self, index: int) -> None:
        if index + 1 == self.stop:
            return
        if self.words[self.hits[index - 1].first] == "neither":  # I do neither, and keep my speed
            self._end(index)
            return
        following = self.hits[index + 1]
        users = following.kind == "user" and self.hits[index - 1].kind == "user"
        verbs = following.kind == "verb" and self.verb and following.form == self.verb.form
        if not users and not verbs:
            self._end(index)


def _opens_item(words: list[str], first: int) -> bool:
    """Tell whether an item of a list begins at a word or right before it; "I brake" is none."""
    for at in (first, max(first - 1, 0)):
        if words[at] in _ITEMS:
            return words[at] not in _WORDS_TOO or words[at + 1 : at + 2] in ([")"], ["."], [":"])
    return False


def _below_headings(
    words: list[str],
    hits: list[Hit],
    flags: list[Scope],
    ranges: list[tuple[int, int]],
    headings: list[Scope],
) -> None:
    """Put what is below a heading of a condition or example in its scope.

    That is the line below it, and if it is an item the items that follow.
    """
    below, inside = Scope(0), False
    for (start, stop), heading in zip(ranges, headings, strict=True):
        opens_line = start == 0 or hits[start - 1].value == "\n"
        if opens_line and below and not _is_listed(words, hits[start - 1].stop if start else 0):
            if inside:
                below = Scope(0)
            else:
                inside = True
        elif opens_line:
            inside = inside or bool(below)
        for index in range(start, stop) if below else ():
            flags[index] |= below
        if heading:
            below, inside = heading, False


def _is_listed(words: list[str], first: int) -> bool:
    """Tell whether a line is an item of a list: - brake, 1. brake, a) brake."""
    is_bullet = words[first] == ","
    is_numbered = words[first - 1] == "\n" and first > 1 and words[first - 2].isdigit()
    return is_bullet or is_numbered or _opens_item(words, first)


def _echoes(
    words: list[str], hits: list[Hit], flags: list[Scope], ranges: list[tuple[int, int]]
) -> None:
    """Mark questions, quotations and struck out or rejected items."""
    for start, stop in ranges:
        if hits[stop - 1].value == "?":
            for index in range(start, stop):
                flags[index] |= Scope.QUOTED
    listing = False
    for start, stop in ranges:
        options = any(
            hit.kind == "cue" and words[hit.first] in _OPTIONS for hit in hits[start:stop]
        )
        item = _opens_item(words, hits[start].first)
        if listing and item and not options:
            for index in range(start, stop):
                flags[index] |= Scope.QUOTED
        else:
            listing = options
    opened = -1
    for index, hit in enumerate(hits):
        if hit.kind != "mark" or hit.value != '"':
            if hit.value == "\n" and hit.kind == "mark":
                opened = -1
            continue
        if opened < 0:
            opened = index
            continue
        first, last = hits[opened].first, hit.first
        before = words[first - 1] if first else "\n"
        after = words[last + 1] if last + 1 < len(words) else ""
        data = before in "[{,:=|(" or after in ":]},=|"
        spoken = before == "," or before == ":"
        if last - first > 2 and (not data or (spoken and after not in ("}", "]", ":", ","))):
            for inner in range(opened, index):
                flags[inner] |= Scope.QUOTED
        opened = -1
