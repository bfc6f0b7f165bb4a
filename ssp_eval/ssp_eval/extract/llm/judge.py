"""What of the LLM's proposals the text supports, by the rules' own reading (METHOD 5.5 c).

A quote is read as if it were the rules' own word for its label: a hit of that kind takes the place
of the quoted words, and scope, binding and decision run as they do for any text. The proposal
stands if the label comes out on the strength of these words, and if nothing that was found before
comes out otherwise. So a quote in a condition, a denial, a prompt or a rejected option, one about
somebody else, or one that a later plan takes back, is dropped by the stage that would drop a phrase
of the tables there.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from ssp_eval.data.records import SLOT_NAMES, Slot, Slots
from ssp_eval.extract.checks import check
from ssp_eval.extract.llm.meaning import ACTIONS, misquoted
from ssp_eval.extract.llm.prompt import NOBODY
from ssp_eval.extract.llm.reply import Proposal
from ssp_eval.extract.rules.decide import Found, decide
from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.matching.find import find
from ssp_eval.extract.rules.reading.reader import read
from ssp_eval.extract.rules.scope.flags import Scope
from ssp_eval.extract.rules.scope.scopes import scopes, sentences
from ssp_eval.extract.rules.tokens import Tokens, tokenise

MAX_PLACES = 8  # of one quote in a text that are looked at
_KINDS = {"position": Kind.PLACE, "motion": Kind.STATE, "conflict": Kind.CONFLICT}
# A quote may begin with its subject, which stays what it is.
_LEADING = frozenset(
    {Kind.EGO, Kind.OBJECT, Kind.PRONOUN, Kind.RELATIVE, Kind.AUX, Kind.KEY, Kind.JOIN}
    | {Kind.THEN, Kind.FINAL, Kind.PURPOSE}
)
_LEADING_MARKS = frozenset({",", ":", '"', "[", "("})
_SUBJECT_GAP = 3  # the small white van
_DEFINITE = frozenset({"the", "this", "that", "these", "those"})
_INDEFINITE = frozenset({"a", "an", "another", "some", "two", "three", "several", "one"})


@dataclass(frozen=True)
class Judged:
    """What stands of the proposals.

    Args:
        slots: that were empty and are filled now.
        dropped: proposals that the text doesn't support, as "slot: why".
    """

    slots: Mapping[str, Slot]
    dropped: tuple[str, ...]


def judge(text: str, found: Slots, proposals: Sequence[Proposal]) -> Judged:
    """The slots that proposals fill, in the order of the slots.

    Args:
        text: the model's text.
        found: what the rules found; a slot that is filled stays as it is.
        proposals: of the LLM.
    """
    desk = _Desk(text, found)
    dropped = []
    for name in SLOT_NAMES:
        if getattr(found, name) is None:
            for proposal in proposals:
                if proposal.slot == name:
                    problem = desk.weigh(proposal)
                    if problem:
                        dropped.append(f"{name}: {problem}")
    return Judged(desk.taken(), tuple(dropped))


class _Desk:
    """A text with the proposals that were taken so far read into it."""

    def __init__(self, text: str, found: Slots) -> None:
        self.text = text
        self.tokens: Tokens = tokenise(text)
        self.hits = find(self.tokens.words)
        given = {name: getattr(found, name) for name in SLOT_NAMES}
        self.values = {name: slot.value for name, slot in given.items() if slot is not None}
        self.spans: dict[str, list[tuple[int, int]]] = {}

    def weigh(self, proposal: Proposal) -> str:
        """Takes a proposal if one of its places supports it; says why not."""
        problem = "the quote isn't in the text"
        if proposal.slot in self.spans and proposal.slot != "objects":
            return "a second answer"
        for start, end in self._places(proposal.quote):
            problem = self._weigh_at(proposal, start, end)
            if not problem:
                self.spans.setdefault(proposal.slot, []).append((start, end))
                return ""
        return problem

    def taken(self) -> dict[str, Slot]:
        """The slots that were filled, after the checks that hold for rules too."""
        filled = {}
        for name, spans in self.spans.items():
            slot = check(self.text, name, Slot(self.values[name], tuple(sorted(set(spans)))))
            if slot is not None:
                filled[name] = slot
        return filled

    def _places(self, quote: str) -> Iterator[tuple[int, int]]:
        at = -1
        for _ in range(MAX_PLACES):
            at = self.text.find(quote, at + 1)
            if at < 0:
                return
            yield at, at + len(quote)

    def _weigh_at(self, proposal: Proposal, start: int, end: int) -> str:
        tokens = self.tokens
        first = bisect_right(tokens.ends, start)
        stop = bisect_left(tokens.starts, end)
        if first >= stop or tokens.starts[first] < start or tokens.ends[stop - 1] > end:
            return "the quote cuts a word"
        problem = misquoted(proposal, self.hits, tokens.words, first, stop)
        if problem:
            return problem
        if proposal.slot != "objects":
            first = self._after_subject(first, stop)
        if first >= stop:
            return "the quote names only who, not what"
        hit = self._as_hit(proposal, first, stop)
        inside = [h for h in self.hits if h.stop <= first or h.first >= stop]
        place = sum(h.stop <= first for h in inside)
        hits = [*inside[:place], hit, *inside[place:]]
        decided, flags = self._decide(hits, place)
        if flags & ~_allowed(proposal, tokens.words[first]):
            return "the text doesn't assert it"
        return self._accept(proposal, decided, hits, first)

    def _accept(
        self, proposal: Proposal, decided: Mapping[str, Found], hits: list[Hit], first: int
    ) -> str:
        value, support = decided.get(proposal.slot, (None, ()))
        wanted = proposal.label
        if isinstance(value, tuple):
            right = wanted in value if wanted != NOBODY else not value
            right = right and set(value) >= set(self.values.get("objects", ()))
        else:
            right = value == wanted
        if value is None or not right or all(said.first != first for said in support):
            return "the text doesn't assert it of the right one"
        before = {name: old for name, old in self.values.items() if name != proposal.slot}
        if any(name not in decided or decided[name][0] != old for name, old in before.items()):
            return "it contradicts what was found before"
        self.values[proposal.slot] = value
        self.hits = hits
        return ""

    def _decide(self, hits: list[Hit], place: int) -> tuple[dict[str, Found], int]:
        ranges = sentences(hits)
        flags = scopes(self.tokens.words, hits, ranges)
        flag = flags[place]
        return decide(read(self.tokens.words, hits, flags, ranges)), flag

    def _after_subject(self, first: int, stop: int) -> int:
        at, gap = first, _SUBJECT_GAP
        for hit in self.hits:
            if hit.first < at:
                continue
            leads = hit.kind in _LEADING or (
                (hit.kind is Kind.MODAL and hit.value != "may")
                or (hit.kind is Kind.MARK and hit.value in _LEADING_MARKS)
            )
            if not leads or hit.first >= stop or hit.first - at > gap:
                break
            at, gap = hit.stop, 0
        return at

    def _as_hit(self, proposal: Proposal, first: int, stop: int) -> Hit:
        slot, label = proposal.slot, proposal.label
        if label == NOBODY:
            return Hit(Kind.NOBODY, "", "", first, stop)
        if slot == "objects":
            return Hit(Kind.OBJECT, label, self._article(first, stop), first, stop)
        if slot in ACTIONS:
            lemma = next(verb for verb, action in ACTIONS[slot].items() if action == label)
            return Hit(Kind.VERB, lemma, self._form(first, stop), first, stop)
        return Hit(_KINDS[slot], label, "", first, stop)

    def _article(self, first: int, stop: int) -> str:
        words = self.tokens.words
        for word in (words[first], *reversed(words[max(first - 3, 0) : first])):
            if word in _DEFINITE:
                return "definite"
            if word in _INDEFINITE:
                return "indefinite"
        return ""

    def _form(self, first: int, stop: int) -> str:
        for hit in self.hits:
            if hit.kind is Kind.VERB and first <= hit.first < stop:
                return hit.form
        words = self.tokens.words[first:stop]
        word = next((word for word in words if not word.endswith("ly")), words[0])
        for ending in ("ing", "ed"):
            if word.endswith(ending):
                return ending
        return "s" if word.endswith("s") and not word.endswith("ss") else "base"


def _allowed(proposal: Proposal, word: str) -> int:
    """The reasons against evidence that leave this proposal standing, as the rules have it."""
    if proposal.slot in ACTIONS:
        return Scope.AHEAD  # we will: a commitment
    if proposal.slot == "motion":  # the van rolling along: true whatever is planned about it
        return Scope.AHEAD | Scope.READY | Scope.REJECTED if word.endswith("ing") else 0
    if proposal.slot == "position":
        return Scope.AHEAD | Scope.READY | Scope.REJECTED
    return Scope.AHEAD if proposal.label == "no_conflict" else 0
