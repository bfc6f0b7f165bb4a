"""The judgement of the LLM's proposals by the text (METHOD 5.5 c).

The rules needn't know the quoted words. What is checked is what holds for any evidence: the quote
stands in the text and cuts no word; it names no other label of its slot, has a word that may mean
its own, and the side that its label has; no negation, condition, possibility or echo is in force
over it; and it is said of the right one, the VUT for an action, and somebody else for a motion.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from ssp_eval.data.records import SLOT_NAMES, Slot, Slots
from ssp_eval.extract.checks import check
from ssp_eval.extract.lexicon import lexicon
from ssp_eval.extract.llm.prompt import NOBODY
from ssp_eval.extract.llm.reply import Proposal
from ssp_eval.extract.llm.support import load_support
from ssp_eval.extract.match import Hit, find, sentences
from ssp_eval.extract.scope import Scope, scopes
from ssp_eval.extract.speaker import US
from ssp_eval.extract.tokens import tokenise

_FAR = 24  # hits that are looked back at for a subject
MAX_PLACES = 8  # of one quote in a text that are looked at
_ACTIONS = ("lon_action", "lat_action")
_KINDS = {"objects": "user", "position": "place", "motion": "state", "conflict": "conflict"}
# Cues within a quote that turn it round, but for the labels that consist in them.
_TURNING = frozenset(
    {
        "not",
        "no",
        "if",
        "needed",
        "else",
        "may",
        "past",
        "ready",
        "reject",
        "rejected",
        "quoted",
        "imaginary",
        "revise",
        "but",
    }
)
_DENIALS = frozenset({"not", "no"})
_CARRIED: Mapping[str, frozenset[str]] = {
    "no_conflict": _DENIALS,
    "resolved": _DENIALS | {"past"},
    "potential": frozenset({"may", "imaginary", "if", "ready", "rejected"}),
    "active": _DENIALS | {"ready", "if", "else", "reject", "rejected"},
    "stationary": _DENIALS,
    "straight": _DENIALS,
    "maintain": _DENIALS,
    NOBODY: _DENIALS | {"may"},
}
_VUT = frozenset({"car", "vehicle"})
_WOULD = frozenset({"would", "i'd"})  # without braking it would hit us: that is a threat
_RISKY = ("risk", "danger", "threat", "hazard", "potential", "possib", "chance", "likel")
# A threat, or that one must react: to stand in the way alone is no active conflict.
_PRESSING = (
    "colli",
    "crash",
    "hit",
    "contact",
    "imminent",
    "immediate",
    "danger",
    "threat",
    "risk",
    "hazard",
    "critical",
    "emergenc",
    "urgent",
    "must",
    "forc",
    "react",
    "avoid",
    "choice",
    "room",
    "active",
)
_PLACED = Scope.REJECTED | Scope.PLANNED | Scope.FUTURE | Scope.LATER | Scope.INTENDED
_COMMITTED = Scope.FUTURE | Scope.INTENDED | Scope.LATER
_SUBJECTS = frozenset({"user", "pronoun", "ego"})
_CONJUNCTIONS = frozenset({"but", "so", "because", "while", "if", "and", "then", "final"})
_SENTENCE = frozenset({".", "?", "\n"})
_LEADING = frozenset({"ticked", ">", ":", ",", "="})  # marks that a quote may begin with


@dataclass(frozen=True)
class Judgement:
    """The proposals that stand.

    Args:
        slots: that were empty and are filled now.
        dropped: proposals that the text doesn't support, as "slot: why".
    """

    slots: Mapping[str, Slot]
    dropped: tuple[str, ...]


def judge(text: str, slots: Slots, proposals: Sequence[Proposal]) -> Judgement:
    """Return the slots that the LLM's proposals fill; one that the rules found stays as it is."""
    bench = TextUnderReview(text)
    filled: dict[str, Slot] = {}
    dropped: list[str] = []
    for name in SLOT_NAMES:
        if getattr(slots, name) is not None:
            continue
        labels: set[str] = set()
        spans: set[tuple[int, int]] = set()
        for proposal in (one for one in proposals if one.slot == name):
            if labels and name != "objects":
                dropped.append(f"{name}: a second answer")
                continue
            place = bench.weigh(proposal)
            if isinstance(place, str):
                dropped.append(f"{name}: {place}")
            else:
                labels.add(proposal.label)
                spans.add(place)
        several = tuple(sorted(labels - {NOBODY}))
        value = several if name == "objects" else several[0] if labels else ""
        slot = check(text, name, Slot(value, tuple(sorted(spans))))
        if slot is not None:
            filled[name] = slot
    return Judgement(filled, tuple(dropped))


class TextUnderReview:
    """A text and the terms that the rules find in it, to hold an LLM's quotes against."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens = tokenise(text)
        self.words = self.tokens.words
        self.hits = find(self.words)

    def weigh(self, proposal: Proposal) -> tuple[int, int] | str:
        """Return the first place that supports a proposal, or the reason for rejecting it."""
        problem = "the quote isn't in the text"
        starts, ends = self.tokens.starts, self.tokens.ends
        start = -1
        for _ in range(MAX_PLACES):
            start = self.text.find(proposal.quote, start + 1)
            if start < 0:
                break
            end = start + len(proposal.quote)
            first, stop = bisect_right(ends, start), bisect_left(starts, end)
            if first >= stop or starts[first] < start or ends[stop - 1] > end:
                problem = "the quote cuts a word"
                continue
            problem = self._misquoted(proposal, first, stop) or self._unasserted(
                proposal, first, stop
            )
            if not problem:
                return start, end
        return problem

    def _misquoted(self, proposal: Proposal, first: int, stop: int) -> str:
        """Say why a quote by itself can't support its label.

        Empty where nothing speaks against it.
        """
        inside = [hit for hit in self.hits if hit.first >= first and hit.stop <= stop]
        carried = _CARRIED.get(proposal.label, frozenset())
        if any(
            hit.first < first < hit.stop and self.words[hit.first] in ("not", "no", "never")
            for hit in self.hits
        ):
            return "the quote leaves out a denial"
        if any(
            (
                hit.kind == "cue"
                and hit.value in _TURNING - carried
                and not (proposal.label == "active" and self.words[hit.first] in _WOULD)
            )
            or (hit.kind == "nobody" and proposal.label != NOBODY)
            or (hit.kind == "mark" and hit.value in _SENTENCE)
            for hit in inside
        ):
            return "the quote holds a word that turns it round"
        if self._means_another(proposal, inside):
            return "the quote means something else"
        if not load_support().holds(proposal.slot, proposal.label, self.words[first:stop]):
            return "no word of the quote is one for the label"
        if not self._names_side(proposal, first, stop):
            return "the quote names no such side"
        if proposal.label == "potential" and not (
            any(hit.kind == "risk" or hit.value in ("may", "imaginary") for hit in inside)
            or any(word.startswith(_RISKY) for word in self.words[first:stop])
        ):
            return "the quote says of nothing that it may happen"
        if proposal.label == "active" and not any(
            word.startswith(_PRESSING) for word in self._around(first, stop)
        ):
            return "no threat is stated, and nothing that forces a reaction"
        return ""

    def _means_another(self, proposal: Proposal, inside: list[Hit]) -> bool:
        """Tell whether the lexicon knows the quote's words for another label of the slot."""
        if proposal.slot == "objects":
            labels = {hit.value for hit in inside if hit.kind == "user"}
            return bool(labels) and proposal.label not in (*labels, NOBODY)
        return any(
            _is_another(proposal, hit)
            for hit in inside
            if hit.value != "rear" or self.words[hit.first] != "behind" or hit.stop - hit.first > 1
        )  # behind the truck: it is in front

    def _names_side(self, proposal: Proposal, first: int, stop: int) -> bool:
        """Tell whether a label with a side has it in its words; for an origin, nearby."""
        side = next((one for one in ("left", "right") if proposal.label.endswith(one)), "")
        if not side or proposal.slot == "position":
            return True
        words = self._around(first, stop) if proposal.slot == "motion" else self.words[first:stop]
        return any(word.startswith(side) or word == side[0] for word in words)

    def _around(self, first: int, stop: int) -> Sequence[str]:
        """Return the words of a quote's sentence and of the one before."""
        for _ in range(2):
            first -= first > 0
            while first and self.words[first - 1] not in _SENTENCE:
                first -= 1
        while stop < len(self.words) and self.words[stop] not in _SENTENCE:
            stop += 1
        return self.words[first:stop]

    def _unasserted(self, proposal: Proposal, first: int, stop: int) -> str:
        """Say why a quote in its place asserts nothing of the present, or of somebody else."""
        while first < stop - 1 and self.words[first] in _LEADING:
            first += 1
        hit = Hit(_kind(proposal), proposal.label, self._form(proposal, first, stop), first, stop)
        others = [one for one in self.hits if one.stop <= first or one.first >= stop]
        place = sum(one.stop <= first for one in others)
        hits = [*others[:place], hit, *others[place:]]
        flags = scopes(self.words, hits, sentences(hits))[place]
        if flags & ~_allowed(proposal, self.words[first]) or self._is_left_open(first, stop):
            return "the text doesn't assert it"
        wrong = (
            "user" if proposal.slot in _ACTIONS else "ego" if proposal.slot == "motion" else None
        )
        if self._subject(place, hits, first, stop) == wrong:
            return "the text doesn't assert it of the right one"
        return ""

    def _is_left_open(self, first: int, stop: int) -> bool:
        """Tell whether the rules see a verb of a quote in a choice that the text doesn't make."""
        return any(
            hit.kind == "verb" and first <= hit.first < stop
            for hit, flags in zip(self.hits, self._scopes, strict=True)
            if flags & Scope.DENIED and flags & Scope.POSSIBLE
        )

    @cached_property
    def _scopes(self) -> Sequence[Scope]:
        return scopes(self.words, self.hits, sentences(self.hits))

    def _subject(self, place: int, hits: list[Hit], first: int, stop: int) -> str:
        """Return the kind of the subject of a quote's clause, or of a quote that starts with it."""
        opening = next((h for h in self.hits if first <= h.first < stop), None)
        if opening is not None and opening.kind in _SUBJECTS and opening.first <= first + 3:
            subject = opening
        elif hits[place].kind == "action" and self._is_of_forecast(stop):
            return "user"
        else:
            subject = None
            finite = any(
                one.kind == "verb" and one.form == "s" and one.first < stop and one.stop > first
                for one in self.hits
            )
            joins = finite and self.words[first] == "and"
            for hit in reversed(hits[max(place - _FAR, 0) : place]):
                if hit.value == "and" and subject is None and finite:
                    joins = True  # the bus follows us and turns: of the bus
                elif hit.kind in ("mark", "field") or hit.value in _CONJUNCTIONS:
                    break
                acts = hit.kind == "verb" and bool(lexicon().verbs[hit.value].ego)
                if acts and subject is None and not (joins and hit.form != "base"):
                    return "ego" if hit.form == "base" else ""  # yield to the jogger crossing
                subject = hit if hit.kind in _SUBJECTS else subject
        if subject is None or hits[place].kind != "action":
            return subject.kind if subject is not None else ""
        return self._antecedent(hits[:place]) if subject.kind == "pronoun" else self._who(subject)

    def _is_of_forecast(self, stop: int) -> bool:
        """Tell whether a quote is the value of what a road user is predicted to do."""
        before = [one for one in self.hits if one.first < stop][-_FAR:]
        ends = (one.kind == "mark" and one.value in _SENTENCE for one in reversed(before))
        sentence = before[
            len(before) - next((i for i, end in enumerate(ends) if end), len(before)) :
        ]
        fields = [one.value for one in sentence if one.kind == "field"]
        return fields[-1:] == ["forecast"]

    def _antecedent(self, hits: list[Hit]) -> str:
        """Return the kind that a pronoun refers to: its sentence's subject, or the last one's."""
        antecedent = ""
        for hit in reversed(hits[-_FAR:]):
            if hit.kind == "mark" and hit.value in _SENTENCE and antecedent:
                break
            antecedent = self._who(hit) if hit.kind in ("user", "ego") else antecedent
        return antecedent

    def _who(self, hit: Hit) -> str:
        """Return the kind of a subject; "the car" is the VUT where the text has no other car.

        Not where the text has an "us" beside it.
        """
        if hit.kind != "user" or hit.form != "the" or self.words[hit.stop - 1] not in _VUT:
            return hit.kind
        if not US.isdisjoint(self.words):
            return "user"
        cars = [one for one in self.hits if one.kind == "user" and one.value == "car"]
        alone = all(one.form == "the" and self.words[one.stop - 1] in _VUT for one in cars)
        return "ego" if alone else "user"

    def _form(self, proposal: Proposal, first: int, stop: int) -> str:
        if proposal.slot == "objects":
            before = {self.words[first], *self.words[max(first - 3, 0) : first]}
            return "the" if before & {"the", "this", "that", "these", "those"} else "a"
        word = next((w for w in self.words[first:stop] if not w.endswith("ly")), "")
        return "ing" if word.endswith("ing") else "s" if word.endswith("s") else "base"


def _kind(proposal: Proposal) -> str:
    if proposal.label == NOBODY:
        return "nobody"
    return "action" if proposal.slot in _ACTIONS else _KINDS[proposal.slot]


def _is_another(proposal: Proposal, hit: Hit) -> bool:
    """Tell whether the lexicon knows a word as one for another label of the slot."""
    slot, label = proposal.slot, proposal.label
    if slot in _ACTIONS:
        action = lexicon().verbs[hit.value].ego if hit.kind == "verb" else hit.value
        actions = lexicon().values[slot].values()
        return hit.kind in ("verb", "noun", "action") and action in actions and action != label
    if slot == "conflict":
        over = hit.kind == "conflict" and hit.value in ("no_conflict", "resolved")
        return over and hit.value != label
    if slot == "position" and hit.kind == "place":
        parts = {*hit.value.split("_"), *label.split("_")}
        return {"left", "right"} <= parts or {"front", "rear"} <= parts
    return False


def _allowed(proposal: Proposal, word: str) -> Scope:
    """Return the scope that may be in force over evidence for a proposal."""
    if proposal.slot in _ACTIONS:
        return _COMMITTED
    if proposal.slot == "motion":
        return _PLACED if word.endswith("ing") else Scope(0)
    if proposal.slot in ("position", "objects"):
        return _PLACED
    if proposal.label == "active":
        return Scope.FUTURE | Scope.IMAGINED
    risk = Scope.POSSIBLE | Scope.IMAGINED | Scope.REJECTED
    return Scope.FUTURE | (risk if proposal.label == "potential" else Scope(0))
