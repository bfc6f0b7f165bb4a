"""The reader's view of a text: its clauses, and the features of each.

A feature is known by its name: ``w:crosses`` says that the clause holds this word, and
``hs:verb:cross+left`` that it holds this verb of the lexicon and this side. Road users and the VUT
are one word each, so that what is learnt of one car holds for all.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from ssp_eval.data.records import SLOT_NAMES
from ssp_eval.extract.decide import critical_of
from ssp_eval.extract.engine import Reading
from ssp_eval.extract.lexicon import lexicon
from ssp_eval.extract.match import Hit
from ssp_eval.extract.scope import Scope
from ssp_eval.extract.world import Actor

_ENDS = frozenset({".", "?", "\n"})
_MARKS = frozenset({",", ";", ":", "|", "{"})
_OPENERS = frozenset({"but", "so", "because", "while", "if", "then", "before"})
_LEAST_WORDS = 3  # of a clause that a mark or a conjunction ends
_SIDES = frozenset({"left", "right"})
_ENDINGS = ("ing", "ed", "es", "s", "e")
_PREFIX = 4  # letters of a word's beginning that count by themselves
_NEAR = 3  # clauses around one in its sentence that are looked at
_OPENING = 12  # words of a clause that are joined with its subject
MAX_CLAUSES = 200  # of a text; in a longer one the reader says nothing


class ClauseSpan(NamedTuple):
    """A piece of a sentence: its words from ``first`` up to ``stop``."""

    first: int
    stop: int
    sentence: int


@dataclass(frozen=True)
class View:
    """A text as the reader sees it.

    Args:
        clauses: in order.
        features: of each clause.
        classes: of road users that are named, with the features of each.
    """

    clauses: list[ClauseSpan]
    features: list[set[str]]
    classes: dict[str, set[str]]


class _ClauseFeatures(NamedTuple):
    """A clause by itself: features, the hits' names, the plain words, the kind of the subject."""

    features: set[str]
    hits: list[str]
    words: list[str]
    subject: str


def clauses_of(reading: Reading) -> list[ClauseSpan]:
    """Return the clauses of a text."""
    words = reading.tokens.words
    openers = {hit.first for hit in reading.hits if hit.kind == "cue" and hit.value in _OPENERS}
    clauses: list[ClauseSpan] = []
    start = sentence = 0

    def close(stop: int) -> None:
        if any(word[0].isalpha() for word in words[start:stop]):  # no numbers alone
            clauses.append(ClauseSpan(start, stop, sentence))

    for at, word in enumerate(words):
        long = at - start >= _LEAST_WORDS
        if word in _ENDS:
            close(at)
            start, sentence = at + 1, sentence + 1
        elif word in _MARKS and long:
            close(at)
            start = at + 1
        elif (at in openers and long) or (word == "and" and at - start > _LEAST_WORDS):
            close(at)
            start = at
    close(len(words))
    return clauses


def view(reading: Reading) -> View:
    """Return the clauses of a text with their features, and its road users with theirs."""
    clauses = clauses_of(reading)
    if len(clauses) > MAX_CLAUSES:
        return View([], [], {})
    words = _normal(reading)
    inside = _hits_inside(reading, clauses)
    critical = critical_of(reading.world)
    mentions = {mention.first for mention in critical.mentions} if critical is not None else set()
    own_features = [
        _own_features(
            words[one.first : one.stop], [(reading.hits[i], reading.flags[i]) for i in at], mentions
        )
        for one, at in zip(clauses, inside, strict=True)
    ]
    rule_values = _rule_values(reading, clauses)
    last = clauses[-1].sentence + 1 if clauses else 1
    users = sum(hit.kind == "user" for hit in reading.hits)
    features = []
    for at, one in enumerate(clauses):
        clause_features = own_features[at].features | rule_values[at]
        clause_features.update(_around(at, clauses, own_features))
        clause_features.add(f"pos:{min(4, 5 * one.sentence // last)}")
        clause_features.add(f"len:{min(last, 6)}")
        clause_features.add(f"users:{min(users, 3)}")
        clause_features.update(
            f"no:{name}" for name in SLOT_NAMES if getattr(reading.slots, name) is None
        )
        features.append(clause_features)
    return View(clauses, features, _classes(reading, inside, features, critical))


def _normal(reading: Reading) -> list[str]:
    """Return the words; a number, road user or the VUT is one word, "" for those it swallows."""
    words = ["#" if word[0].isdigit() else word for word in reading.tokens.words]
    for hit in reading.hits:
        if hit.kind in ("user", "ego"):
            words[hit.first : hit.stop] = [""] * (hit.stop - hit.first)
            people = hit.value == "pedestrian"
            words[hit.stop - 1] = "<E>" if hit.kind == "ego" else "<P>" if people else "<U>"
    return words


def _hits_inside(reading: Reading, clauses: list[ClauseSpan]) -> list[list[int]]:
    """Return the numbers of the hits that begin in each clause."""
    inside: list[list[int]] = [[] for _ in clauses]
    at = 0
    for number, hit in enumerate(reading.hits):
        while at < len(clauses) and hit.first >= clauses[at].stop:
            at += 1
        if at < len(clauses) and hit.first >= clauses[at].first:
            inside[at].append(number)
    return inside


def _own_features(
    words: list[str], hits: list[tuple[Hit, Scope]], mentions: set[int]
) -> _ClauseFeatures:
    """Return a clause by itself."""
    plain = [word for word in words if word and (word[0].isalnum() or word[0] in "<#")]
    hits = [(hit, flags) for hit, flags in hits if hit.kind != "mark"]
    names = [_name(hit) for hit, _ in hits]
    subject = next((_subject(hit) for hit, _ in hits if _subject(hit)), "none")
    features = set(_grams(plain))
    features.add(f"subj:{subject}")
    features.update(f"sw:{subject}+{word}" for word in plain[:_OPENING])
    for name, (hit, flags) in zip(names, hits, strict=True):
        features.update(_of_hit(name, hit, flags))
        features.update(f"hs:{name}+{side}" for side in _SIDES.intersection(plain))
        if hit.kind == "verb":
            features.add(f"sv:{subject}+{name}")
    bounded = ["^", *names, "$"]
    features.update(f"hb:{a} {b}" for a, b in pairwise(bounded))
    users = [hit for hit, _ in hits if hit.kind == "user"]
    features.add(f"nu:{min(len(users), 2)}")
    if users:
        features.add(f"uform:{users[0].form}")
    if any(hit.first in mentions for hit in users):
        features.add("crit")
    return _ClauseFeatures(features, names, plain, subject)


def _grams(words: list[str]) -> Iterator[str]:
    """Words, pairs and triples, whole and by their stems."""
    bounded = ["^", *words, "$"]
    stems = [_stem(word) for word in bounded]
    for word, stem in zip(words, stems[1:-1], strict=True):
        yield f"w:{word}"
        yield f"z:{stem}"
        if word[0].isalpha() and len(word) > _PREFIX:
            yield f"p:{word[:_PREFIX]}"
    for at in range(len(bounded) - 1):
        yield f"b:{bounded[at]} {bounded[at + 1]}"
        yield f"zb:{stems[at]} {stems[at + 1]}"
    for at in range(len(bounded) - 2):
        yield f"t:{bounded[at]} {bounded[at + 1]} {bounded[at + 2]}"
        yield f"g:{bounded[at]} _ {bounded[at + 2]}"
        yield f"zg:{stems[at]} _ {stems[at + 2]}"


def _stem(word: str) -> str:
    for ending in _ENDINGS:
        if word.endswith(ending) and len(word) - len(ending) >= 3:
            word = word[: -len(ending)]
            break
    double = len(word) > 3 and word[-1] == word[-2] != "s"
    return word[:-1] if double else word


def _name(hit: Hit) -> str:
    if hit.kind == "user":
        return "user:P" if hit.value == "pedestrian" else "user:U"
    return f"{hit.kind}:{hit.value}"


def _subject(hit: Hit) -> str:
    """Return the kind of a subject, or the form of a verb that stands without one."""
    if hit.kind in ("user", "ego", "pronoun", "scene"):
        return hit.kind
    return f"verb:{hit.form}" if hit.kind == "verb" else ""


def _of_hit(name: str, hit: Hit, flags: Scope) -> Iterator[str]:
    yield f"h:{name}"
    if hit.form:
        yield f"hf:{name}:{hit.form}"
    if flags:
        yield f"hx:{name}|{int(flags)}"
        yield from (f"x:{flag.name}" for flag in Scope if flags & flag)
    if hit.kind == "verb":
        verb = lexicon().verbs[hit.value]
        yield f"ve:{verb.ego}"
        yield f"vo:{verb.other}"


def _rule_values(reading: Reading, clauses: list[ClauseSpan]) -> list[set[str]]:
    """Return the values that the rules took from each clause."""
    values: list[set[str]] = [set() for _ in clauses]
    bounds = [reading.tokens.span(one.first, one.stop) for one in clauses]
    for name in SLOT_NAMES:
        slot = getattr(reading.slots, name)
        for start, _ in slot.evidence if slot is not None else ():
            for at, (first, stop) in enumerate(bounds):
                if first <= start < stop:
                    values[at].add(f"r:{name}")
                    if name != "objects":
                        values[at].add(f"rv:{name}={slot.value}")
    return values


def _around(
    at: int, clauses: list[ClauseSpan], own_features: list[_ClauseFeatures]
) -> Iterator[str]:
    """Yield the features before and behind a clause."""
    if at:
        before = own_features[at - 1]
        yield from (f"ph:{name}" for name in before.hits)
        yield from (f"pw:{word}" for word in before.words[-3:])
        yield f"psub:{before.subject}>{own_features[at].subject}"
    else:
        yield "first"
    if at + 1 < len(clauses):
        after = own_features[at + 1]
        yield from (f"nh:{name}" for name in after.hits)
        yield from (f"nw:{word}" for word in after.words[:2])
    else:
        yield "last"
    for other in range(max(0, at - _NEAR), min(len(clauses), at + _NEAR + 1)):
        if other != at and clauses[other].sentence == clauses[at].sentence:
            yield from (f"sh:{name}" for name in own_features[other].hits)


def _classes(
    reading: Reading, inside: list[list[int]], features: list[set[str]], critical: Actor | None
) -> dict[str, set[str]]:
    """Return the road users' classes that are named, each with the features of its clauses."""
    classes: dict[str, set[str]] = {}
    for at, numbers in enumerate(inside):
        for hit in (reading.hits[number] for number in numbers):
            if hit.kind == "user":
                classes.setdefault(hit.value, set()).update(features[at])
    slot = reading.slots.objects
    rule_classes = slot.value if slot is not None else ()
    for name, class_features in classes.items():
        class_features.add(f"a:classes={min(len(classes), 4)}")
        class_features.add(f"a:rules={'none' if slot is None else name in rule_classes}")
        for actor in (one for one in reading.world.actors if one.name == name):
            class_features.update(_of_actor(actor))
            if actor is critical:
                class_features.add("a:critical one")
    return classes


def _of_actor(actor: Actor) -> Iterator[str]:
    yield f"a:reaction={actor.reaction}"
    yield f"a:order={min(actor.order, 3)}"
    for trait in ("parked", "critical", "matters", "background", "intruding"):
        if getattr(actor, trait):
            yield f"a:{trait}"
    for kind in ("mentions", "places", "motions", "conflicts"):
        yield f"a:{kind}={min(len(getattr(actor, kind)), 2)}"
