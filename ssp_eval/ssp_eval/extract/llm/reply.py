"""The LLM's proposals: its reply is read strictly; an answer in another form proposes nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ssp_core.files.strict_json import parse_strict
from ssp_eval.extract.llm.prompt import MAX_OBJECTS, MAX_QUOTE, labels_of

_FENCE = "```"


@dataclass(frozen=True)
class Proposal:
    """A label for a slot with the words, not yet looked for in the text, that should support it."""

    slot: str
    label: str
    quote: str


@dataclass(frozen=True)
class Proposals:
    """The proposals of a reply.

    Args:
        items: for slots that were asked for, with labels that they have.
        dropped: what else stood there, one reason each.
        unreadable: why nothing could be read; empty: it could.
    """

    items: tuple[Proposal, ...] = ()
    dropped: tuple[str, ...] = ()
    unreadable: str = ""


def read_reply(content: str, slot_names: Sequence[str]) -> Proposals:
    """Read the proposals of a completion for the slots that were asked for; raises on no string.

    A fence of code around the JSON is taken off.
    """
    text = content.strip()
    if text.startswith(_FENCE) and text.endswith(_FENCE) and "\n" in text:
        text = text[text.index("\n") + 1 : -len(_FENCE)]
    try:
        value = parse_strict(text)
    except ValueError:
        return Proposals(unreadable="no JSON")
    if not isinstance(value, dict):
        return Proposals(unreadable="no JSON object")
    items: list[Proposal] = []
    dropped: list[str] = []
    for slot, answer in value.items():
        several = slot == "objects"
        answers = answer if several and isinstance(answer, list) else [answer]
        if slot not in slot_names:
            dropped.append("a slot that was not asked for")
        elif answer is None:
            continue
        elif isinstance(answer, list) != several:
            dropped.append(f"{slot}: {'no list' if several else 'a list'}")
        elif len(answers) > MAX_OBJECTS:
            dropped.append(f"{slot}: {len(answers)} answers")
        else:
            readings = [_read_one(slot, one) for one in answers]
            dropped += [f"{slot}: {one}" for one in readings if isinstance(one, str)]
            items += dict.fromkeys(one for one in readings if isinstance(one, Proposal))
    return Proposals(tuple(items), tuple(dropped))


def _read_one(slot: str, one: Any) -> Proposal | str:
    if not isinstance(one, dict) or set(one) != {"label", "quote"}:
        return "not a label with a quote"
    label, quote = one["label"], one["quote"]
    if not isinstance(label, str) or label not in labels_of(slot):
        return "a label outside the vocabulary"
    if not isinstance(quote, str) or not quote.strip():
        return "no quote"
    if len(quote) > MAX_QUOTE:
        return "a quote longer than a phrase"
    return Proposal(slot, label, quote.strip())
