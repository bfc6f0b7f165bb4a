"""Which texts are reviewed: as evenly over what was found and what wasn't as the texts allow."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ssp_core.hashing import sha256_bytes, sha256_json
from ssp_core.vocabulary import OBJECTS
from ssp_eval.data.records import SLOT_NAMES, Slot, Slots
from ssp_eval.extract.review.model import BETWEEN, NOBODY, NONE, Key, KeyItem


@dataclass(frozen=True)
class Candidate:
    """A text that may be reviewed.

    Args:
        source_id: of the text.
        text: that reviewers see.
        slots: that were extracted.
    """

    source_id: str | int
    text: str
    slots: Slots


@dataclass(frozen=True)
class Subset:
    """What reviewers get.

    Args:
        texts: by new id.
        key: stays apart.
    """

    texts: Mapping[str, str]
    key: Key


def choose(candidates: Sequence[Candidate], count: int, seed: int) -> list[Candidate]:
    """Texts in random order that cover every value of every slot, and its absence, evenly.

    Again and again a text is drawn from those that have the value which was drawn least so far.
    So rare values are there, and for each slot also texts in which nothing was found, without which
    nobody would notice what the extractor overlooks. A text that stands there twice is drawn once.

    Args:
        candidates: to choose from.
        count: at most so many.
        seed: of the choice; the same one chooses the same texts.
    """
    rng = random.Random(seed)
    left = {candidate.text: candidate for candidate in reversed(candidates)}
    pool = sorted(left.values(), key=lambda one: sha256_bytes(_bytes(one.text)))
    rng.shuffle(pool)
    members: dict[tuple[str, str], list[int]] = {}
    for index, candidate in enumerate(pool):
        for stratum in strata(candidate.slots):
            members.setdefault(stratum, []).append(index)
    drawn: Counter[tuple[str, str]] = Counter()
    taken: set[int] = set()
    chosen: list[Candidate] = []
    while len(chosen) < min(count, len(pool)):
        for stratum in list(members):
            while members[stratum] and members[stratum][-1] in taken:
                members[stratum].pop()
            if not members[stratum]:
                del members[stratum]
        index = members[min(members, key=lambda one: (drawn[one], one))].pop()
        taken.add(index)
        chosen.append(pool[index])
        drawn.update(strata(pool[index].slots))
    rng.shuffle(chosen)
    return chosen


def strata(slots: Slots) -> list[tuple[str, str]]:
    """Each slot with its value, each class of objects, and each slot that is empty."""
    found = []
    for name in SLOT_NAMES:
        text = as_answer(getattr(slots, name))
        found += [(name, part) for part in text.split(BETWEEN)]
    return found


def as_answer(slot: Slot | None) -> str:
    """What was extracted, as a reviewer would write it."""
    if slot is None:
        return NONE
    if isinstance(slot.value, str):
        return slot.value
    return BETWEEN.join(name for name in OBJECTS if name in slot.value) or NOBODY


def make_subset(
    chosen: Sequence[Candidate], source_sha256: str, extractor: str, seed: int
) -> Subset:
    """Texts under new ids, and the key.

    Args:
        chosen: texts in the order of the new ids.
        source_sha256: of the file of texts.
        extractor: hash of the extractor.
        seed: of the choice.
    """
    width = max(3, len(str(len(chosen))))
    # Ids of two reviews differ, so that answers to one are never taken for answers to another.
    series = sha256_json([sha256_bytes(_bytes(one.text)) for one in chosen])[7:11]
    texts = {
        f"r{series}-{number:0{width}d}": one.text for number, one in enumerate(chosen, start=1)
    }
    items = tuple(
        KeyItem(
            review_id,
            one.source_id,
            sha256_bytes(_bytes(one.text)),
            {name: as_answer(getattr(one.slots, name)) for name in SLOT_NAMES},
        )
        for review_id, one in zip(texts, chosen, strict=True)
    )
    subset = sha256_json({item.review_id: item.text_sha256 for item in items})
    return Subset(texts, Key(subset, source_sha256, extractor, seed, items))


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")
