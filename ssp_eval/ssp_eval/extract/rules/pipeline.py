"""The pipeline of the rules: text in, slots with evidence out. It sees nothing but the text."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from ssp_core.hashing import sha256_bytes, sha256_json
from ssp_eval.data.records import Slot, Slots
from ssp_eval.extract import checks
from ssp_eval.extract.rules.decide import decide
from ssp_eval.extract.rules.matching.find import find
from ssp_eval.extract.rules.reading.reader import read
from ssp_eval.extract.rules.scope.scopes import scopes, sentences
from ssp_eval.extract.rules.tokens import tokenise

RULES_VERSION = "1"


def extract(text: str) -> Slots:
    """What the text asserts about the present, in the closed vocabularies (METHOD 5.5 a, c).

    High precision before recall: where the rules aren't sure a slot is None. Linear in the length
    of the text; raises on no string.

    Args:
        text: a model's text, with nothing else.
    """
    tokens = tokenise(text)
    hits = find(tokens.words)
    ranges = sentences(hits)
    world = read(tokens.words, hits, scopes(tokens.words, hits, ranges), ranges)
    slots: dict[str, Slot] = {}
    for name, (value, support) in decide(world).items():
        spans = sorted({tokens.span(said.first, said.stop) for said in support})
        slot = checks.check(text, name, Slot(value, tuple(spans)))
        if slot is not None:
            slots[name] = slot
    return Slots(**slots)


@cache
def extractor_hash() -> str:
    """Hash of the rules, ``sha256:<hex>``, for the provenance of what they extracted.

    It covers the version and the source of every module of the rules and of their checks, words
    and logic alike, so that no change of what they extract can go unnoticed.
    """
    rules = Path(__file__).parent
    sources = [*rules.rglob("*.py"), Path(checks.__file__)]
    modules = {
        path.relative_to(rules.parent).as_posix(): sha256_bytes(path.read_bytes())
        for path in sources
    }
    return sha256_json({"version": RULES_VERSION, "modules": modules})
