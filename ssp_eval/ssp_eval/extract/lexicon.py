"""The lexicon as a tree of words, in which the longest phrase at a word is found.

The words stand in ``lexicon.yaml`` by meaning, the words of scope in ``scope.yaml``.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import yaml

FOLDER = Path(__file__).parent
FILES = ("lexicon.yaml", "scope.yaml")
NUMBER = "#"
NUMBER_WORDS = frozenset(
    {
        "five",
        "ten",
        "fifteen",
        "twenty",
        "thirty",
        "forty",
        "fifty",
        "sixty",
        "seventy",
        "eighty",
        "ninety",
        "hundred",
    }
)
MAX_FILLERS = 3
FORMS = ("base", "s", "ing", "ed")
_OTHER = {"left": "right", "right": "left"}


class Entry(NamedTuple):
    """The meaning of a phrase.

    Args:
        kind: user, place, verb, conflict … (the sections of the lexicon).
        value: what it says: a class, a position, the name of a verb.
        form: of a verb: base, s, ing, ed or noun.
    """

    kind: str
    value: str
    form: str = ""


class _Node:
    """A place in the automaton of all phrases: which words may follow, and what ends here."""

    __slots__ = ("after", "entry", "order")

    def __init__(self) -> None:
        self.after: dict[str, list[_Node]] = {}
        self.entry: Entry | None = None
        self.order = 0


class _State:
    """The nodes that are reached by the same words; its followers are worked out when needed."""

    __slots__ = ("after", "entry", "nodes")

    def __init__(self, nodes: list[_Node]) -> None:
        self.nodes = nodes
        self.after: dict[str, _State | None] = {}
        ends = [node for node in nodes if node.entry is not None]
        self.entry = min(ends, key=lambda node: node.order).entry if ends else None

    def step(self, word: str) -> _State | None:
        """Return the state after one more word, None if no phrase goes on so."""
        try:
            return self.after[word]
        except KeyError:
            nodes = [after for node in self.nodes for after in node.after.get(word, ())]
            return self.after.setdefault(word, _State(nodes) if nodes else None)


class Verb(NamedTuple):
    """The meaning of a verb: as the VUT's action, and as the movement of somebody else."""

    ego: str
    other: str


class Lexicon:
    """All phrases of the files, and the tables that aren't phrases."""

    def __init__(self, words: dict[str, Any], scope: dict[str, Any]) -> None:
        self._root = _Node()
        self._order = 0
        self.fillers = frozenset(_items(words["fillers"]))
        self.plurals: dict[str, str] = words["plurals"]
        self._irregular: dict[str, str] = words["irregular"]
        self.cues: dict[str, dict[str, str]] = scope["cues"]
        self.verbs: dict[str, Verb] = {}
        self.values: dict[str, dict[str, str]] = {}
        self._classes: dict[str, tuple[str, ...]] = {}
        for name, listed in words["classes"].items():
            phrases = (p for item in _items(listed) for p in self._expand(item))
            self._classes[name] = tuple(dict.fromkeys(phrases))
        self._read(words)
        for name, cue in self.cues.items():
            for one in _items(cue["words"]):
                self._add(one, "cue", name)
        for slot, by_value in words["values"].items():
            self.values[slot] = {
                phrase: value for value, listed in by_value.items() for phrase in _items(listed)
            }
        self.sets = {name: frozenset(_items(one)) for name, one in words["sets"].items()}
        self._start = _State([self._root])
        self.fields = {
            phrase: slot
            for slot, listed in words["fields"].items()
            for item in _items(listed)
            for phrase in self._expand(item)
        }

    def _read(self, words: dict[str, Any]) -> None:
        for one in _items(words["skip"]):
            self._add(one, "skip", "")
        plurals: dict[str, list[str]] = {}
        for plural, singular in self.plurals.items():
            plurals.setdefault(singular, []).append(plural)
        for name, listed in words["road_users"].items():
            for noun in (phrase for item in _items(listed) for phrase in self._expand(item)):
                head, _, last = noun.rpartition(" ")
                for one in (last, last + "s", *plurals.get(last, ()), *plurals.get(noun, ())):
                    self._put(f"{head} {one}".strip(), Entry("user", name))
        for kind in (
            "nobody",
            "ego",
            "relative",
            "scene",
            "riding",
            "from",
            "across",
            "towards",
            "affects",
            "critical",
            "background",
            "risk",
            "matters",
            "reacts",
            "braked_in_lane",
        ):
            for one in _items(words[kind]):
                self._add(one, kind, "{side}" if "{side}" in one else "")
        for kind, section in (
            ("pronoun", "pronoun"),
            ("conflict", "conflicts"),
            ("place", "places"),
            ("state", "states"),
            ("goal", "goals"),
            ("noun", "nouns"),
        ):
            for value, listed in words[section].items():
                for one in _items(listed):
                    self._add(one, kind, value)
        for name, verb in words["verbs"].items():
            ego, other, listed = verb["ego"], verb["other"], verb["words"]
            for side in ("left", "right") if "{side}" in name else ("",):
                action = ego.replace("{side}", side)
                self.verbs[name.replace("{side}", side)] = Verb(
                    "" if ego == "none" else action, other
                )
            for one in _items(listed):
                self._add(one, "verb", name)

    def _add(self, item: str, kind: str, value: str) -> None:
        for side in ("left", "right") if "{side}" in item + value else ("",):
            if kind == "across" and side and "from" not in item:
                self._put(f"{side[0]} {item.split()[1]} {_OTHER[side][0]}", Entry(kind, side))
            phrase = item.replace("{side}", side).replace("{other}", _OTHER.get(side, ""))
            for form in range(4) if "~" in phrase else (-1,):
                name = FORMS[form] if form >= 0 else ""
                self._put(phrase, Entry(kind, value.replace("{side}", side), name), form)

    def _put(self, item: str, entry: Entry, form: int = -1) -> None:
        """Add a path for a notation to the automaton, with shared ends for its alternatives."""
        frontier = [self._root]
        for part in item.split():
            end = _Node()
            for phrase in self._options(part, form):
                *first, last = phrase.split()
                here = frontier
                for word in first:
                    node = _Node()
                    for before in here:
                        before.after.setdefault(word, []).append(node)
                    here = [node]
                for before in here:
                    before.after.setdefault(last, []).append(end)
            frontier = [*frontier, end] if part.startswith("(") else [end]
        self._order += 1
        for node in frontier:
            if node is not self._root and node.entry is None:
                node.entry, node.order = entry, self._order

    def _options(self, part: str, form: int) -> list[str]:
        options: list[str] = []
        for one in part.strip("()").split("|"):
            if one.startswith("$"):
                options += self._classes[one[1:]]
            else:
                options.append(self._inflected(one[1:])[form] if one.startswith("~") else one)
        return options

    def _inflected(self, verb: str) -> tuple[str, str, str, str]:
        if verb in self._irregular:
            third, ing, past = self._irregular[verb].split()
            return verb, third, ing, past
        if verb.endswith("y") and verb[-2] not in "aeiou":
            return verb, verb[:-1] + "ies", verb + "ing", verb[:-1] + "ied"
        stem = verb[:-1] if verb.endswith("e") else verb
        third = verb + ("es" if verb.endswith(("s", "sh", "ch", "x")) else "s")
        return verb, third, stem + "ing", stem + "ed"

    def _expand(self, item: str) -> Iterator[str]:
        """Every phrase that a notation without verbs stands for."""
        parts = [
            [*([""] if part.startswith("(") else []), *self._options(part, 0)]
            for part in item.split()
        ]
        for words in product(*parts):
            yield " ".join(word for word in words if word)

    def longest(self, words: list[str], at: int) -> tuple[Entry | None, int]:
        """Return the longest phrase that begins at a word, and the word after it.

        Fillers inside a phrase are passed over, and ``#`` stands for a number.
        """
        state = self._start.step(words[at])
        if state is None and words[at][0].isdigit():
            state = self._start.step(NUMBER)
        entry, stop = None, at + 1
        here = at + 1
        skipped = 0
        while state is not None:
            if state.entry is not None and not skipped:
                entry, stop = state.entry, here
            if here >= len(words):
                break
            word = words[here]
            after = state.step(word)
            if after is None and (word[0].isdigit() or word in NUMBER_WORDS):
                after = state.step(NUMBER)
            if after is None and word in self.fillers and skipped < MAX_FILLERS:
                skipped += 1
            else:
                state, skipped = after, 0
            here += 1
        return entry, stop


def _items(listed: str | list[str]) -> list[str]:
    text = listed if isinstance(listed, str) else ",".join(listed)
    return [" ".join(item.split()) for item in text.split(",") if item.strip()]


@cache
def lexicon() -> Lexicon:
    """Return the lexicon of this package, read once."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    read = (yaml.load((FOLDER / name).read_text("utf-8"), loader) for name in FILES)
    return Lexicon(*read)
