"""When a text counts at all (METHOD 5.3): v_txt and z."""

from __future__ import annotations

from operator import attrgetter

from ssp_eval.records import SLOT_NAMES, BehaviourRecord, Slot

Value = str | tuple[str, ...]

_slots = attrgetter(*SLOT_NAMES)
_NOTHING = (None,) * len(SLOT_NAMES)


def readable_length(record: BehaviourRecord | None) -> int:
    """How many characters can support a slot (METHOD 5.3); 0 says that v_txt = 0.

    That of a blank text is 0, whatever spaces it holds.
    """
    if record is None or not record.text.strip():
        return 0
    return len(record.text)


def answers(record: BehaviourRecord | None, length: int) -> tuple[Value | None, ...]:
    """The values of a record's six slots, None where z = 0 (METHOD 5.3): missing or unsupported.

    Args:
        record: an output, None for a missing one.
        length: see readable_length.
    """
    return _NOTHING if record is None else tuple([_answer(x, length) for x in _slots(record.slots)])


def _answer(slot: Slot | None, length: int) -> Value | None:
    if slot is not None:
        for start, end in slot.evidence:
            if 0 <= start < end <= length:
                return slot.value
    return None
