"""All phrases of the tables as one tree of words, in which the longest at a word is found."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

from ssp_eval.extract.rules.hits import Kind
from ssp_eval.extract.rules.words import (
    conflict_phrases,
    ego_and_scene,
    ego_verbs,
    grammar,
    inflection,
    lane_phrases,
    others_verbs,
    place_phrases,
    road_users,
    salience,
    skipped,
    state_phrases,
)

Entry = tuple[Kind, str, str]


def entries() -> dict[str, Entry]:
    """Every phrase with what it is.

    Raises:
        ValueError: if two tables have the same phrase and say different things of it.
    """
    table: dict[str, Entry] = {}

    def add(phrase: str, kind: Kind, value: str, form: str = "") -> None:
        entry = (kind, value, form)
        known = table.setdefault(phrase, entry)
        if known != entry:
            raise ValueError(f"{phrase!r} stands for {known} and for {entry}: leave one out")

    for phrase in skipped.SKIPPED:
        add(phrase, Kind.SKIP, "")
    for phrase in ego_and_scene.EGO:
        add(phrase, Kind.EGO, "")
    for name, listed in road_users.OBJECT_NOUNS.items():
        for noun in listed:
            add(noun, Kind.OBJECT, name)
    for value, listed in state_phrases.STATES.items():
        for phrase in listed:
            add(phrase, Kind.STATE, value)
    for value, listed in conflict_phrases.CONFLICTS.items():
        for phrase in listed:
            add(phrase, Kind.CONFLICT, value)
    for phrase in conflict_phrases.AFFECTS:
        add(phrase, Kind.RISK, "")
    for phrase in conflict_phrases.RISK:
        add(phrase, Kind.RISK, "alone" if phrase in conflict_phrases.RISK_ALONE else "")
    for kind, values in (*grammar.KINDS.items(), *salience.KINDS.items()):
        for value, listed in values.items():
            for phrase in listed:
                add(phrase, kind, value)
    for value, listed in place_phrases.PLACES.items():
        for phrase in listed:
            add(phrase, Kind.PLACE, value)
    for lemma, listed in (*ego_verbs.VERBS.items(), *others_verbs.MOVEMENTS.items()):
        for phrase in listed:
            for words, form in inflection.inflect(phrase):
                add(words, Kind.VERB, lemma, form)
    for lemma, forms in ego_verbs.EXTRA_FORMS.items():
        for words, form in forms:
            add(words, Kind.VERB, lemma, form)
    for prep, owner in product(("in", "within", "inside", "on"), lane_phrases.OWN_LANE):
        value = "own" if {"our", "my", "ego"} & set(owner.split()) else ""
        add(f"{prep} {owner} lane".replace("  ", " "), Kind.IN_LANE, value)
    for prep, owner in product(("in", "within", "inside"), ("our", "my", "its", "the ego")):
        add(f"{prep} {owner} path", Kind.IN_LANE, "path")
    for phrase in lane_phrases.IN_PATH:
        add(phrase, Kind.IN_LANE, "path")
    for phrase in lane_phrases.SAME_LANE:
        add(phrase, Kind.IN_LANE, "")
    for scene in ego_and_scene.SCENE:
        add(scene, Kind.SCENE, "")
    return table


ENTRIES = entries()


class Node(NamedTuple):
    """What stands for the words up to here, and which words may go on.

    Args:
        entry: what the phrase that ends here is; None if no phrase does.
        after: the node of each next word.
    """

    entry: Entry | None
    after: dict[str, Node]


def _tree() -> dict[str, Node]:
    root: dict[str, Node] = {}
    for phrase, entry in ENTRIES.items():
        *words, last = phrase.split()
        level = root
        for word in words:
            level = level.setdefault(word, Node(None, {})).after
        known = level.get(last)
        level[last] = Node(entry, known.after if known is not None else {})
    return root


TREE = _tree()


def longest(words: list[str], at: int) -> tuple[Entry | None, int]:
    """The longest phrase that begins at a word, and the word after it."""
    node = TREE.get(words[at])
    if node is None:
        return None, at + 1
    entry, after = node
    here = stop = at + 1
    count = len(words)
    while here < count and after:
        node = after.get(words[here])
        if node is None:
            break
        here += 1
        longer, after = node
        if longer is not None:
            entry, stop = longer, here
    return entry, stop
