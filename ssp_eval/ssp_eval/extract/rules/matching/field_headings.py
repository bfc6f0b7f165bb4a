"""Stage 2: the names of fields that stand before a colon, or in brackets at a line's start."""

from __future__ import annotations

from ssp_eval.extract.rules.free_phrases import field_values
from ssp_eval.extract.rules.hits import MARKS, Hit, Kind
from ssp_eval.extract.rules.words.field_names import KEYS

_KEYS = {phrase: slot for slot, listed in KEYS.items() for phrase in listed}


def heads_line(words: list[str], at: int) -> bool:
    """[Intent] at the start of a line: whether a bracket closes there."""
    for first in range(at - 2, max(at - 6, -1), -1):
        if words[first] == "[":
            return first == 0 or words[first - 1] == "\n"
    return False


def field_name(words: list[str], colon: int, hits: list[Hit]) -> str:
    """Turns the words before a colon into a field name, if they are one and stand alone.

    Returns:
        The field: a slot of KEYS, or one of the looser names of field_values; "" if there is none.
    """
    stop = colon
    while stop and words[stop - 1] in ('"', ")", "|"):
        stop -= 1
    if stop > 2 and words[stop - 1].isdigit():
        stop -= 1  # Critical object 1:
    for length in (4, 3, 2, 1):
        first = stop - length
        before = words[first - 1] if first > 0 else "."
        if first < 0 or not (before in MARKS or "0" <= before[0] <= "9"):
            continue
        name = " ".join(words[first:stop])
        slot = _KEYS.get(name)
        if slot:
            while hits and hits[-1].stop > first:
                hits.pop()
            hits.append(Hit(Kind.KEY, slot, "", first, stop))
            return slot
        loose = field_values.FIELDS.get(name)
        if loose:
            while loose == "pace" and hits and hits[-1].stop > first:
                hits.pop()  # Acceleration: negative
            return loose
    return ""
