"""Stage 7: drops what a later reader could not verify (METHOD 5.5 c)."""

from __future__ import annotations

from ssp_eval.data.records import VOCABULARIES, Slot
from ssp_eval.extract.asserted.labels import HUMP


def check(text: str, name: str, slot: Slot) -> Slot | None:
    """Return the slot if its label is legal and its spans are whole words of the text, else None.

    Args:
        text: the model's text.
        name: the slot's name.
        slot: a proposal of the rules or of another extractor.
    """
    values = slot.value if isinstance(slot.value, tuple) else (slot.value,)
    if (name == "objects") != isinstance(slot.value, tuple):
        return None
    if any(value not in VOCABULARIES[name] for value in values):
        return None
    if not slot.evidence or not all(_whole(text, *span) for span in slot.evidence):
        return None
    return slot


def _whole(text: str, start: int, end: int) -> bool:
    """Tell whether a span lies in the text, isn't blank and cuts no word."""
    if not 0 <= start < end <= len(text) or not text[start:end].strip():
        return False
    return not (_cuts(text, start) or _cuts(text, end))


def _cuts(text: str, at: int) -> bool:
    """Tell whether a place lies within a word; names like turnLeft are of several."""
    if not 0 < at < len(text) or not (text[at - 1].isalnum() and text[at].isalnum()):
        return False
    return HUMP.match(text, at) is None
