"""The rules: text in, slots with evidence out. They see nothing but the text (METHOD 5.5 a, c)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from ssp_core.chat.answer_text import plain_width
from ssp_core.hashing import sha256_bytes, sha256_json
from ssp_eval.data.records import SLOT_NAMES, Slot, Slots
from ssp_eval.extract.asserted.blanked import asserted
from ssp_eval.extract.bind import Binder
from ssp_eval.extract.checks import check
from ssp_eval.extract.decide import decide
from ssp_eval.extract.match import Hit, find, sentences
from ssp_eval.extract.scope import Scope, scopes
from ssp_eval.extract.speaker import with_own_vehicle
from ssp_eval.extract.tokens import Tokens, tokenise
from ssp_eval.extract.world import World, share_between_joined

RULES_VERSION = "2"
_SOURCES = (
    "lexicon.yaml",
    "scope.yaml",
    "lexicon.py",
    "tokens.py",
    "match.py",
    "scope.py",
    "world.py",
    "movement.py",
    "clause.py",
    "bind.py",
    "decide.py",
    "engine.py",
    "checks.py",
    "asserted/labels.py",
    "asserted/fields.py",
    "asserted/forms.py",
    "asserted/options.py",
    "asserted/unwanted.py",
    "asserted/blanked.py",
    "speaker.py",
)


@dataclass(frozen=True)
class Reading:
    """The rules' reading of a text, stage by stage.

    Args:
        text: the text, with what it only names blanked.
        tokens: its words.
        hits: the phrases of the lexicon in it.
        flags: what is in force at each hit.
        world: the road users and the plan.
        slots: what follows from these.
    """

    text: str
    tokens: Tokens
    hits: list[Hit]
    flags: list[Scope]
    world: World
    slots: Slots


def extract(text: str) -> Slots:
    """Extract the text's assertions about the present in the closed vocabularies (METHOD 5.5 a, c).

    Precision comes before recall: where the rules aren't sure a slot is None. Linear in the length
    of the text; raises on no string.

    Args:
        text: a model's text, with nothing else.
    """
    return read(text).slots


def read(text: str) -> Reading:
    """Extract with all intermediate results."""
    return _read(asserted(plain_width(text), _values))


def _values(piece: str) -> dict[str, object]:
    """Return the rules' values in a piece of a text, by slot."""
    slots = _read(piece).slots
    return {name: slot.value for name in SLOT_NAMES if (slot := getattr(slots, name)) is not None}


def _read(text: str) -> Reading:
    tokens = tokenise(text)
    hits = with_own_vehicle(tokens.words, find(tokens.words))
    ranges = sentences(hits)
    flags = scopes(tokens.words, hits, ranges)
    world = Binder(tokens.words, hits, flags).run(ranges)
    share_between_joined(world, hits)
    slots: dict[str, Slot] = {}
    for name, (value, support) in decide(world).items():
        spans = sorted({tokens.span(statement.first, statement.stop) for statement in support})
        slot = check(text, name, Slot(value, tuple(spans)))
        if slot is not None:
            slots[name] = slot
    return Reading(text, tokens, hits, flags, world, Slots(**slots))


@cache
def extractor_hash() -> str:
    """Hash of the rules, ``sha256:<hex>``, for the provenance of what they extracted.

    It covers every word of the lexicon and every module that reads it.
    """
    folder = Path(__file__).parent
    modules = {name: sha256_bytes((folder / name).read_bytes()) for name in _SOURCES}
    return sha256_json({"version": RULES_VERSION, "modules": modules})
