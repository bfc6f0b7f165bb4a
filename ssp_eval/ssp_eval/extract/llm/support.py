"""The words that can support a label (METHOD 5.5 c, synonyms).

A model that understands nothing quotes words that say nothing of the slot. The words of the
development corpus are known: one that its labelled evidence for a label hardly ever holds can't
support that label. A word that the corpus lacks may: what it means is the LLM's to know.

``test/corpus/count_words.py`` counts the words anew.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from textwrap import fill

from ssp_core.files.reading import read_mapping
from ssp_eval.data.records import SLOT_NAMES, VOCABULARIES, Slots
from ssp_eval.extract.llm.prompt import labels_of
from ssp_eval.extract.tokens import tokenise

FILE = Path(__file__).with_suffix(".yaml")
# Of all places of a word, the share within evidence for a label from which on it can support it.
LEAST_SHARE = 0.05
_HEAD = """\
# Words of the development corpus, as support.py counts them: `known` are all of them; under a label
# stand those of which at least {:g} of their places lie in evidence for it.
"""


@dataclass(frozen=True)
class Support:
    """The counted words.

    Args:
        known: all words of the corpus.
        of: the words that can support a label, by slot and label.
    """

    known: frozenset[str]
    of: Mapping[tuple[str, str], frozenset[str]]

    def holds(self, slot: str, label: str, words: Sequence[str]) -> bool:
        """Tell whether one of the words names a label, can support it, or isn't known."""
        fitting = self.of.get((slot, label), frozenset()) | {*label.split("_")}
        return any(word in fitting or (_is_word(word) and word not in self.known) for word in words)


def _is_word(token: str) -> bool:
    return token[0].isalpha()


def count(labelled: Iterable[tuple[str, Slots]]) -> Support:
    """Return the words of texts whose slots and evidence are known."""
    places: Counter[str] = Counter()
    inside: defaultdict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    for text, slots in labelled:
        tokens = tokenise(text)
        places.update(tokens.words)
        for name in SLOT_NAMES:
            slot = getattr(slots, name)
            if slot is None:
                continue
            values = slot.value if name == "objects" else (slot.value,)
            spans = list(zip(tokens.words, tokens.starts, tokens.ends, strict=True))
            evidence = [
                word
                for word, start, end in spans
                if any(a <= start and end <= b for a, b in slot.evidence)
            ]
            for label in values or labels_of(name)[len(VOCABULARIES[name]) :]:
                inside[name, label].update(evidence)
    return Support(
        frozenset(filter(_is_word, places)),
        {
            key: frozenset(
                word
                for word, times in counts.items()
                if _is_word(word) and times >= LEAST_SHARE * places[word]
            )
            for key, counts in inside.items()
        },
    )


def written(support: Support) -> str:
    """Return the words as their file has them."""
    lines = [_HEAD.format(LEAST_SHARE), _entry("known", support.known, "")]
    for name in SLOT_NAMES:
        lines.append(f"{name}:")
        words = [(label, support.of.get((name, label), frozenset())) for label in labels_of(name)]
        lines += [_entry(label, fitting, "  ") for label, fitting in words]
    return "\n".join(lines) + "\n"


def _entry(name: str, words: Iterable[str], indent: str) -> str:
    inner = f"{indent}  "
    text = fill(
        " ".join(sorted(words)),
        100,
        initial_indent=inner,
        subsequent_indent=inner,
        break_on_hyphens=False,
    )
    return f"{indent}{name}: >-\n{text}"


@cache
def load_support() -> Support:
    """Return the words of the file."""
    entries = read_mapping(FILE)
    return Support(
        frozenset(entries["known"].split()),
        {
            (name, label): frozenset(words.split())
            for name in SLOT_NAMES
            for label, words in entries[name].items()
        },
    )
