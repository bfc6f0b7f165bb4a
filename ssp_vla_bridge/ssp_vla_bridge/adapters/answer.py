"""Which of the lists in a text is the answer: not the history, not a draft, not the first of two.

The rules, in this order:
1. After reasoning that ends with ``</think>``, what follows is the answer, if a list is there.
   Reasoning that begins with ``<think>`` and doesn't end holds no answer.
2. A list that gives back the history, or a run of it, or all of it with fewer decimals, is no
   answer; a list that begins with the whole history is read without it. A history of one repeated
   row can't be told from a plan that keeps on: a list equal to it is read, and a note says so.
3. A list given twice is one list.
4. The last list with the number of rows that the interface defines is the answer. If there is
   none: the last one, if the text ends before it does; else the longest, the last of equals.
5. A list with a fault, with rows of another width or under other names has the wrong shape. Fewer
   rows are read as they are, and more, too: whether they suffice is a matter of coverage. But a
   text that was cut off ends no list: one with fewer rows at its end is cut off, too.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ssp_vla_bridge.adapters.number_lists import CUT, NESTED, NumberList, scan_lists

_THINK_BEGIN, _THINK_END = "<think>", "</think>"
_LABEL_LENGTH = 200
# "past speeds", but not "past the parked car".
_PAST = re.compile(
    r"histor|\b(?:past|previous|observed|last \d+) (?:ego )?"
    r"(?:speed|velocit|curvature|trajector|position|motion|value|pair|point|waypoint|state|data)"
)
_FUTURE = ("future", "predict", "next", "final", "answer", "output", "plan", "forecast")
# So many rows of the history in their order are its echo, fewer may be chance.
_LEAST_ECHO = 3
_EQUAL = 1e-9
# An echo may have fewer decimals than the prompt; whole numbers would be met by chance.
_ECHO_DECIMALS = (1, 2)

Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Form:
    """What an interface's list looks like.

    Args:
        names: per column, the names that a number may be given; no name is always fine.
        label: a word of the line before the list, by which it is preferred; empty for none.
        usual: marks that are the interface's own form and no tolerance.
    """

    rows: int
    names: tuple[frozenset[str], frozenset[str]]
    units: frozenset[str]
    label: str = ""
    usual: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Choice:
    """The answer's rows, or why there is none.

    Args:
        rows: two numbers each; empty when there is a reason.
        reason: of METHOD 5.3, empty when there are rows.
        notes: one clause each.
    """

    rows: Rows
    reason: str
    notes: tuple[str, ...]


def choose_answer(text: str, form: Form, history: Rows | None, text_is_cut: bool = False) -> Choice:
    """The list of a text that answers, by the rules above; takes time linear in its length.

    Args:
        history: as the prompt printed it, None when the request isn't at hand.
        text_is_cut: whether it is known to end at the limit of tokens.
    """
    notes: list[str] = []
    lists: Sequence[NumberList] = scan_lists(text)
    if text_is_cut:
        lists = _with_cut_end(text, lists, form.rows)
    lists = _after_thinking(text, lists, notes)
    lists = [part for one in lists for part in _parts(one, form.rows, history, notes)]
    answers = []
    end = 0
    for one in lists:
        label = _label(text[max(end, one.start - _LABEL_LENGTH) : one.start])
        end = one.end
        of_past = _is_of_past(label)
        if of_past and one.rows and (form.label or not history):
            notes.append("a list that the text calls past was left out")
        elif not _is_echo(one.rows, history or (), of_past, notes):
            answers.append((one, label))
    if not answers:
        what = "no list but the echo of the history" if lists else "no list of numbers"
        return Choice((), "missing", (*_unique(notes), f"the text holds {what}"))
    return _read(*_pick(answers, form, notes), form, history, notes)


def _with_cut_end(text: str, lists: Sequence[NumberList], count: int) -> Sequence[NumberList]:
    """The lists, the last one of them cut where nothing says that it ended."""
    if not lists:
        return lists
    last = lists[-1]
    ended = last.fault or len(last.rows) >= count or not NESTED.isdisjoint(last.marks)
    if ended or any(character.isalnum() for character in text[last.end :]):
        return lists
    return (*lists[:-1], replace(last, cut=True, fault=CUT))


def _label(before: str) -> str:
    """The last line, and of it the last sentence, in front of a list."""
    line = before.rstrip().rpartition("\n")[2]
    return line.rpartition(". ")[2].lower()


def _after_thinking(
    text: str, lists: Sequence[NumberList], notes: list[str]
) -> Sequence[NumberList]:
    end = text.rfind(_THINK_END)
    begin = text.rfind(_THINK_BEGIN)
    if begin > end and any(one.start > begin for one in lists):
        notes.append("the text ends within its reasoning, whose lists were left out")
        lists = [one for one in lists if one.start < begin]
    if end < 0:
        return lists
    after = [one for one in lists if one.start > end]
    notes.append("the text holds reasoning that ends with </think>")
    return after or lists


def _parts(one: NumberList, count: int, history: Rows | None, notes: list[str]) -> list[NumberList]:
    """A list that is longer than asked for, parted where that can be told."""
    if one.fault and one.fault != CUT:
        return [one]
    known = history or ()
    rows = one.rows
    lead = _leading_echo(rows, known, count)
    if lead:
        notes.append("a list begins with the history, which was left out")
        one = replace(one, rows=rows[lead:], loose=tuple(i - lead for i in one.loose if i > lead))
        rows = one.rows
    if len(rows) <= count:
        return [one]
    starts = (0, *one.loose)
    sizes = [after - before for before, after in zip(starts, (*one.loose, len(rows)), strict=True)]
    if len(sizes) > 1 and all(size == count for size in sizes[:-1]) and sizes[-1] <= count:
        return [
            replace(
                one,
                rows=rows[start : start + size],
                loose=(),
                fault=one.fault if start + size == len(rows) else "",
                cut=one.cut and start + size == len(rows),
            )
            for start, size in zip(starts, sizes, strict=True)
        ]
    half = len(rows) // 2
    twice = half * 2 == len(rows) and half <= count and _equal(rows[:half], rows[half:])
    if twice and (half == count or not _constant(rows)):
        notes.append("the list is given twice in one")
        return [replace(one, rows=rows[half:], loose=())]
    return [one]


def _leading_echo(rows: Rows, history: Rows, count: int) -> int:
    """How many rows at the beginning of a list are the history, followed by others."""
    whole = len(history)
    if not history:
        return 0
    # A list that is not too long may begin like the history by chance, if that is short or steady.
    certain = len(rows) > count or (whole >= _LEAST_ECHO and not _constant(history))
    if certain and len(rows) > whole and _equal(rows[:whole], history):
        return whole
    lead = len(rows) - count
    if 0 < lead < whole and _equal(rows[:lead], history[-lead:]) and not _constant(history):
        return lead
    return 0


def _is_of_past(label: str) -> bool:
    return _PAST.search(label) is not None and not any(word in label for word in _FUTURE)


def _is_echo(rows: Rows, history: Rows, of_past: bool, notes: list[str]) -> bool:
    run = len(rows)
    if not min(_LEAST_ECHO, len(history)) <= run <= len(history) or not run:
        return False
    if _constant(rows):
        told = of_past and _equal(rows, history)
        if told:
            notes.append("the echo of the history was left out")
        return told
    if _is_rounded(rows, history):
        notes.append("the echo of the history, rounded, was left out")
        return True
    for start in range(len(history) - run + 1):
        if _equal(rows, history[start : start + run]):
            part = "" if run == len(history) else " of a part"
            notes.append(f"the echo{part} of the history was left out")
            return True
    return False


def _is_rounded(rows: Rows, history: Rows) -> bool:
    """Whether rows are the whole history with fewer decimals, and vary enough to be no chance."""
    if len(rows) != len(history) or len(set(rows)) < _LEAST_ECHO or _equal(rows, history):
        return False
    pairs = [
        (a, b)
        for row, other in zip(rows, history, strict=True)
        for a, b in zip(row, other, strict=False)
    ]
    return len(rows[0]) == len(history[0]) and any(
        all(a == round(a, n) and abs(a - b) <= 0.5 * 10**-n + _EQUAL for a, b in pairs)
        for n in _ECHO_DECIMALS
    )


def _pick(
    answers: list[tuple[NumberList, str]], form: Form, notes: list[str]
) -> tuple[NumberList, str]:
    labelled = [answer for answer in answers if form.label and form.label in answer[1]]
    if form.label and not labelled:
        notes.append(f"no list stands behind {form.label!r}")
    answers = labelled or answers
    complete = [answer for answer in answers if _is_complete(answer[0], form)]
    cut = answers[-1][0].cut
    if complete:
        chosen = complete[-1]
        others = [one for one, _ in complete if not _equal(one.rows, chosen[0].rows)]
        if others:
            notes.append(f"{len(others)} other lists of {form.rows} were passed over for the last")
        elif len(complete) > 1:
            notes.append(f"the list is given {len(complete)} times")
        if cut:
            notes.append("a later list is cut off")
        return chosen
    if cut:
        return answers[-1]
    most = max(len(one.rows) for one, _ in answers)
    if len(answers) > 1:
        notes.append(f"of {len(answers)} lists, none of {form.rows} rows, the longest was taken")
    return [answer for answer in answers if len(answer[0].rows) == most][-1]


def _is_complete(one: NumberList, form: Form) -> bool:
    return not one.fault and len(one.rows) == form.rows and len(one.rows[0]) == len(form.names)


def _read(
    one: NumberList, label: str, form: Form, history: Rows | None, notes: list[str]
) -> Choice:
    problem = _problem(one, form, history)
    if problem:
        return Choice((), "shape", (*_unique(notes), problem))
    if history is None:
        notes.append("the request isn't at hand, so that an echo of its history isn't recognised")
    if history and _equal(one.rows, history):
        notes.append("the list equals the history, whose rows are all the same")
    notes.extend(sorted(one.marks - form.usual))
    if one.units:
        notes.append("units in rows")
    if "*" in label:
        notes.append("a bold label")
    if len(one.rows) != form.rows:
        notes.append(f"{len(one.rows)} rows instead of {form.rows}")
    return Choice(one.rows, "", _unique(notes))


def _problem(one: NumberList, form: Form, history: Rows | None) -> str:
    if one.fault:
        return f"the list can't be read: {one.fault}"
    if any(len(row) != len(form.names) for row in one.rows):
        return f"the list has rows of {len(one.rows[0])} numbers"
    for names, known in zip(one.names, form.names, strict=True):
        if names - known:
            return f"the list names a column {sorted(names - known)[0]!r}"
    if one.units - form.units:
        return f"the list is in {sorted(one.units - form.units)[0]!r}"
    if history is None and len(one.rows) == 2 * form.rows:
        return "the first half of the list may be the history, and the request isn't at hand"
    return ""


def _constant(rows: Rows) -> bool:
    return _equal(rows[1:], rows[:-1])


def _equal(rows: Rows, others: Rows) -> bool:
    return len(rows) == len(others) and all(
        len(row) == len(other)
        and all(abs(a - b) <= _EQUAL for a, b in zip(row, other, strict=True))
        for row, other in zip(rows, others, strict=True)
    )


def _unique(notes: Sequence[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(notes))
