"""The choice of texts to review, spread as evenly as they allow over found and missing values."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ssp_core.hashing import sha256_bytes, sha256_json
from ssp_eval.data.records import Slots
from ssp_eval.extract.measure import shown
from ssp_eval.extract.review.answers import BETWEEN, NONE, Key, KeyItem


@dataclass(frozen=True)
class Candidate:
    """A text that may be reviewed, its id, and what was extracted from it."""

    source_id: str | int
    text: str
    slots: Slots

    @property
    def sha256(self) -> str:
        return sha256_bytes(self.text.encode("utf-8", "surrogatepass"))

    @property
    def answers(self) -> dict[str, str]:
        """Return the extracted values as a reviewer would write them."""
        return {name: shown(slot) if slot else NONE for name, slot in vars(self.slots).items()}

    @property
    def strata(self) -> list[tuple[str, str]]:
        """Each slot with its value, each class of objects, and each slot that is empty."""
        return [(name, one) for name, text in self.answers.items() for one in text.split(BETWEEN)]


@dataclass(frozen=True)
class Subset:
    """The texts for reviewers by new id. The key stays apart."""

    texts: Mapping[str, str]
    key: Key


def choose(candidates: Sequence[Candidate], count: int, seed: int) -> list[Candidate]:
    """Texts in random order that cover every value of every slot, and its absence, evenly.

    Again and again a text is drawn from those that have the value which was drawn least so far.
    So rare values are there, and for each slot also texts in which nothing was found, without which
    omissions of the extractor would go unnoticed. A text that stands there twice is drawn once.
    The same seed chooses the same texts, at most so many.
    """
    rng = random.Random(seed)
    left = {candidate.text: candidate for candidate in reversed(candidates)}
    pool = sorted(left.values(), key=lambda one: one.sha256)
    rng.shuffle(pool)
    members: dict[tuple[str, str], list[int]] = {}
    for index, candidate in enumerate(pool):
        for stratum in candidate.strata:
            members.setdefault(stratum, []).append(index)
    draw_counts: Counter[tuple[str, str]] = Counter()
    indices: set[int] = set()
    sample: list[Candidate] = []
    while len(sample) < min(count, len(pool)):
        for stratum in list(members):
            while members[stratum] and members[stratum][-1] in indices:
                members[stratum].pop()
            if not members[stratum]:
                del members[stratum]
        index = members[min(members, key=lambda one: (draw_counts[one], one))].pop()
        indices.add(index)
        sample.append(pool[index])
        draw_counts.update(pool[index].strata)
    rng.shuffle(sample)
    return sample


def make_subset(
    sample: Sequence[Candidate], source_sha256: str, extractor: str, seed: int
) -> Subset:
    """Texts under new ids, in the order of these, and the key.

    Args:
        sample: texts.
        source_sha256: of the file of texts.
        extractor: hash of the extractor.
        seed: of the choice.
    """
    width = max(3, len(str(len(sample))))
    # Ids of two reviews differ, so that answers to one are never taken for answers to another.
    series = sha256_json([one.sha256 for one in sample])[7:11]
    candidates_by_id = {
        f"r{series}-{number:0{width}d}": one for number, one in enumerate(sample, start=1)
    }
    items = tuple(
        KeyItem(
            review_id=review_id,
            source_id=one.source_id,
            text_sha256=one.sha256,
            extracted=one.answers,
        )
        for review_id, one in candidates_by_id.items()
    )
    subset = sha256_json({item.review_id: item.text_sha256 for item in items})
    texts = {review_id: one.text for review_id, one in candidates_by_id.items()}
    return Subset(
        texts,
        Key(
            subset=subset,
            source_sha256=source_sha256,
            extractor=extractor,
            seed=seed,
            items=items,
        ),
    )
