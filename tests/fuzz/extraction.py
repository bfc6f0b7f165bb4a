"""Texts to the extraction's rules, and answers of an LLM with the text that they are about."""

from __future__ import annotations

import json
from collections.abc import Iterator

from ssp_eval.data.records import SLOT_NAMES, Slots
from ssp_eval.extract import extract
from ssp_eval.extract.checks import check
from ssp_eval.extract.llm.judge import judge
from ssp_eval.extract.llm.reply import read_reply

_TEXTS = (
    "Yield to the cyclist who is crossing from left to right ahead; keep the current lane.",
    "If the car were to cut in, we would brake. It does not. Maintain speed and lane.",
    "<think>Earlier a bus was ahead, now it has passed.</think>\n- **Risk:** none\n- Plan: go on",
    '{"objects": ["truck"], "position": "front_left", "lon": "STOP", "lat": ["LEFT", "STRAIGHT"]}',
    "Frame 1: a pedestrian on the left. Frame 2: nobody. Options: (a) stop (b) accelerate?",
    "No pedestrians, cyclists or vehicles are visible. I’d ease off — don't overtake!",
)


def text(data: bytes) -> None:
    """A text to the rules: every slot passes the checks, and comes out again."""
    given = data.decode("utf-8", "replace")
    found = extract(given)
    _sound(given, found)
    if extract(given) != found:
        raise AssertionError("the same text gave other slots")


def reply(data: bytes) -> None:
    """A text, a zero byte, and what an LLM says of it."""
    first, _, second = data.partition(b"\0")
    given = first.decode("utf-8", "replace")
    proposals = read_reply(second.decode("utf-8", "replace"), SLOT_NAMES)
    if proposals.unreadable and proposals.items:
        raise AssertionError("an unreadable answer proposes")
    found = extract(given)
    judged = judge(given, found, proposals.items)
    _sound(given, Slots(**judged.slots))
    for name, slot in judged.slots.items():
        if getattr(found, name) is not None:
            raise AssertionError(f"{name} was filled by the rules")
        quotes = {item.quote for item in proposals.items if item.slot == name}
        if not all(given[start:end] in quotes for start, end in slot.evidence):
            raise AssertionError(f"{name}: evidence that nobody quoted")


def _sound(given: str, slots: Slots) -> None:
    for name in SLOT_NAMES:
        slot = getattr(slots, name)
        if slot is not None and check(given, name, slot) is None:
            raise AssertionError(f"{name}: {slot} fails the checks")


def texts() -> Iterator[bytes]:
    """Texts as models write them."""
    for one in _TEXTS:
        yield one.encode()


def replies() -> Iterator[bytes]:
    """Texts with answers: good ones, a fenced one, a broken one."""
    first = "A velocipede wobbles along up the road from us. We throttle the pace."
    good = {
        "objects": [{"label": "cyclist", "quote": "velocipede"}],
        "position": {"label": "front", "quote": "up the road from us"},
        "motion": {"label": "same_direction", "quote": "wobbles along"},
        "conflict": None,
        "lon_action": {"label": "decelerate", "quote": "throttle the pace"},
        "lat_action": {"label": "straight", "quote": "throttle"},
    }
    body = json.dumps(good)
    for answer in (body, f"```json\n{body}\n```", body[:60], "[]"):
        yield first.encode() + b"\0" + answer.encode()
    for one in _TEXTS:
        yield one.encode() + b"\0" + body.encode()
