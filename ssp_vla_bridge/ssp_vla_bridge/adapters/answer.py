"""The list in an answer that is the own plan: not the history, not a draft, not another's.

The rules, in this order:
1. A list that gives back the history, or a run of it, or all of it with fewer decimals, is no
   answer; a list that begins with the whole history is read without it. A history of one repeated
   row looks like a plan that keeps on: a list equal to it is read, and a note says so.
2. A list given twice is one list.
3. A list whose label or sentence says that it is somebody else's, a detection, an alternative,
   rejected or conditional is no answer (plan_label). The last list that is labelled as the own
   plan counts, and if it can't be read, none does. A list without a label counts only if it has
   the rows that the interface defines, or one more from the origin.
4. Where the prompt asks for the bare list, and of lists without a label, the last one counts that
   has the rows asked for, or a later one that is meant to replace it: with half of these rows, and
   a fault or a label of the own plan, or cut off, unless it repeats a whole one. If that can't be
   read, none does. If none has the rows asked for, it is the last list, if the text ends before it
   does, else the longest.
5. A list with a fault, with rows of another width or in columns or units that are unknown has
   the wrong shape. Fewer rows are read as they are, and more, too: whether they suffice is a
   matter of coverage. But a text that was cut off ends no list: one with fewer rows at its end is
   cut off, too. And a whole list with prose behind it, in a text that was cut off, is a draft.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ssp_vla_bridge.adapters.candidates import LabelledList, find_options
from ssp_vla_bridge.adapters.number_lists import CUT, NESTED, UNREAD, NumberList, scan_lists
from ssp_vla_bridge.adapters.plain_rows import with_brackets, with_pairs
from ssp_vla_bridge.adapters.plan_label import Label, Owner, label_of
from ssp_vla_bridge.adapters.stated import ConvertedRows, Meaning, Rows, convert
from ssp_vla_bridge.adapters.stated_beside import read_beside
from ssp_vla_bridge.adapters.stated_times import Beside, Raster
from ssp_vla_bridge.adapters.tables import with_lists_for_tables
from ssp_vla_bridge.adapters.torn_lists import whole_lists
from ssp_vla_bridge.native_history import STEP_S

# "past speeds", but not "past the parked car".
_PAST = re.compile(
    r"histor|\b(?:past|previous|observed|last \d+) (?:ego )?"
    r"(?:speed|velocit|curvature|trajector|position|motion|value|pair|point|waypoint|state|data)"
)
_FUTURE = ("future", "predict", "next", "final", "answer", "output", "plan", "forecast")
# What a list of points is not, where its label says no more.
_QUANTITY = re.compile(
    r"\b(?:velocit\w+|speeds?|accelerations?|controls?|steering|throttle|curvatures?|headings?|yaws?)\b"
)
# So many rows of the history in their order are its echo, fewer may be chance.
_LEAST_ECHO = 3
_EQUAL = 1e-9
# An echo may have fewer decimals than the prompt; whole numbers would be met by chance.
_ECHO_DECIMALS = (1, 2)
# A first row this close to the origin stands for t = 0.
_AT_ORIGIN_M = 1e-6
# A list beside another one in one outer bracket: "[[[5, 0], [9, 0]], [[6, 1], [12, 2]]]".
_LIST_BEHIND = re.compile(r"\s*[\])]\s*,\s*[\[(]\s*[\[(]\s*[-+.\d]")
_LIST_BEFORE = re.compile(r"\d\s*[\])]\s*[\])]\s*,\s*\[?\s*\Z")
_LOOKED_AT = 40
SEVERAL = "it is one of several lists in a list"
# Spaces without width, which stand between digits and brackets of some answers.
_INVISIBLE = re.compile("[\u200b\u200c\u200d\u2060\ufeff]")
_PAST_LABEL = re.compile(
    r"\W*(?:(?:the|my|our|ego|given|input) )*(?:histor|past|previous|observed|last \d)"
)
# In the place of times: the first row is at t = 0, the others follow at the interface's step.
FROM_ORIGIN: tuple[float, ...] = (0.0,)


@dataclass(frozen=True)
class Form:
    """The form of an interface's list.

    Args:
        meaning: of the two columns, unless the answer states otherwise.
        units: that are the interface's own.
        label: the word by which the prompt asks for the list; empty: it asks for the bare list.
        usual: marks that are the interface's own form and no tolerance.
        step_s: between its rows.
    """

    rows: int
    meaning: Meaning
    units: frozenset[str]
    label: str = ""
    usual: frozenset[str] = frozenset()
    step_s: float = STEP_S

    @property
    def raster(self) -> Raster:
        """The times of the rows that are asked for."""
        return Raster(self.rows, self.step_s)


@dataclass(frozen=True)
class Choice:
    """The answer's rows, or why there is none.

    Args:
        rows: two numbers each, in the interface's columns and units; empty when there is a reason.
        times_s: that the answer states, one for each row; empty where it states none.
        reason: of METHOD 5.3, empty when there are rows.
        notes: one clause each.
    """

    rows: Rows
    reason: str
    notes: tuple[str, ...]
    times_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class _Candidate:
    one: NumberList
    label: Label
    read: ConvertedRows


def choose_answer(text: str, form: Form, history: Rows | None, text_is_cut: bool = False) -> Choice:
    """Choose the list of a text that answers, by the rules above, in time linear in its length.

    Args:
        text: the answer's, or its motion stage's.
        form: of the list that the interface asks for.
        history: rows as the prompt printed them, None when the request isn't at hand.
        text_is_cut: whether it is known to end at the limit of tokens.
    """
    notes: list[str] = []
    text = _INVISIBLE.sub("", text)
    if form.label:
        text = with_brackets(text)
    text = with_pairs(text)
    text = with_lists_for_tables(text, "forward" in form.meaning.columns, text_is_cut)
    lists: Sequence[NumberList] = scan_lists(text)
    if text_is_cut:
        lists = _with_cut_end(text, lists, form.rows)
    if form.label:
        lists = [_as_one_of_several(text, one) for one in lists]
    lists = whole_lists(text, lists, form.rows)
    lists = [part for one in lists for part in _parts(one, form.rows, history, notes)]
    lists = [_as_closed(one, form.rows) for one in lists]
    answers: list[_Candidate] = []
    end, others = 0, 0
    for i, one in enumerate(lists):
        label = label_of(text, end, one.start, one.end, bare=not form.label)
        end = one.end
        of_past = _is_of_past(label.text)
        if of_past and one.rows and (form.label or not history):
            notes.append("a list that the text calls past was left out")
        elif _is_echo(one.rows, history or (), of_past, notes):
            continue
        elif label.owner is Owner.OTHER:
            others += 1
        else:
            beside = _beside(text, lists, i, form)
            read = convert(one, label.heading, form.meaning, form.units, form.raster, beside)
            answers.append(_Candidate(one, label, read))
    if others:
        notes.append(f"{others} lists that aren't the own plan were left out")
    answers, left = _without_options(text, answers, notes)
    others += left + len(answers)
    answers = _own(answers, form, notes)
    if not answers:
        what = "no list of numbers"
        if lists:
            what = (
                "no list that is the own plan" if others else "no list but the echo of the history"
            )
        return Choice((), "missing", (*_unique(notes), f"the text holds {what}"))
    candidate = _pick(answers, form, notes)
    if text_is_cut and not candidate.one.fault and _goes_on(text[candidate.one.end :]):
        draft = "a list that prose follows, which the limit of tokens cuts off, is a draft"
        return Choice((), "missing", (*_unique(notes), draft))
    return _read(candidate, form, history, notes)


def _beside(text: str, lists: Sequence[NumberList], i: int, form: Form) -> Beside:
    """Return what stands beside a list, up to the next ones that have several rows."""
    one = lists[i]
    before = next((two.end for two in reversed(lists[:i]) if _is_other(two, one)), 0)
    behind = next((two.start for two in lists[i + 1 :] if _is_other(two, one)), len(text))
    points = "forward" in form.meaning.columns
    place = (before, one.start, one.end, behind)
    return read_beside(text, place, len(one.rows), form.raster, points)


def _is_other(two: NumberList, one: NumberList) -> bool:
    return two.start != one.start and len(two.rows) > 1


def _without_options(
    text: str, answers: list[_Candidate], notes: list[str]
) -> tuple[list[_Candidate], int]:
    """Return the lists without the options that aren't chosen, and how many these are."""
    placed = [LabelledList(one.label.text, one.one.start, one.one.end) for one in answers]
    left, chosen_index = find_options(text, placed)
    if not left:
        return answers, 0
    remark = "none is chosen" if chosen_index is None else "only the chosen one counts"
    notes.append(f"of {len(left) + (chosen_index is not None)} options {remark}")
    candidates = [
        replace(one, label=replace(one.label, owner=Owner.OWN)) if i == chosen_index else one
        for i, one in enumerate(answers)
        if i not in left
    ]
    return candidates, len(left)


def _goes_on(rest: str) -> bool:
    """Tell whether prose follows a list."""
    return any(character.isalpha() for character in re.sub(r"```\w*|<[^<>]{1,20}>", "", rest))


def _own(answers: list[_Candidate], form: Form, notes: list[str]) -> list[_Candidate]:
    """Return the lists that count as the own plan, in the text's order (METHOD 5.4b)."""
    if not form.label:
        present = [one for one in answers if not _is_labelled_past(one.label.text)]
        if len(present) < len(answers) and any(_fits_form(one, form) for one in present):
            notes.append("a list that the text calls past was left out")
            return present
        return answers
    labelled = [one for one in answers if one.label.owner is Owner.OWN]
    if labelled:
        return labelled[-1:]
    quantity_lists = [one for one in answers if _is_of_quantity(one.label.text)]
    if quantity_lists:
        notes.append("a list that its label calls no plan was left out")
        answers = [one for one in answers if one not in quantity_lists]
    bare = [one for one in answers if one.one.cut or one.one.fault or _fits_form(one, form)]
    if not bare:  # of as many rows, at times or in columns that aren't known
        bare = [one for one in answers if one.read.problem and len(one.one.rows) == form.rows]
    if bare:
        notes.append(f"no list stands behind {form.label!r}")
    elif answers:
        notes.append(f"a list without a label has other rows than the {form.rows} asked for")
    return bare


def _is_of_quantity(label: str) -> bool:
    """Tell whether a label names what no list of points is; "I keep my speed." names none."""
    return _QUANTITY.search(label) is not None and not label.rstrip(" *`\n").endswith(".")


def _fits_form(one: _Candidate, form: Form) -> bool:
    rows = one.read.rows
    return len(rows) == form.rows or (len(rows) == form.rows + 1 and _is_origin(rows[0]))


def _is_origin(row: Sequence[float]) -> bool:
    return len(row) == 2 and abs(row[0]) <= _AT_ORIGIN_M and abs(row[1]) <= _AT_ORIGIN_M


def _with_cut_end(text: str, lists: Sequence[NumberList], count: int) -> Sequence[NumberList]:
    """Return the lists, the last one of them cut where the text doesn't show that it ended."""
    if not lists:
        return lists
    last = lists[-1]
    ended = last.fault or len(last.rows) >= count or not NESTED.isdisjoint(last.marks)
    if ended or any(character.isalnum() for character in text[last.end :]):
        return lists
    return (*lists[:-1], replace(last, cut=True, fault=CUT))


def _as_one_of_several(text: str, one: NumberList) -> NumberList:
    """Mark a list that stands beside another in one outer bracket."""
    beside = _LIST_BEHIND.match(text, one.end) or _LIST_BEFORE.search(
        text, max(0, one.start - _LOOKED_AT), one.start
    )
    return replace(one, fault=one.fault or SEVERAL) if beside else one


def _as_closed(one: NumberList, count: int) -> NumberList:
    """Return a cut list as a whole one if all rows that were asked for are closed."""
    required_rows = count + 1 if one.rows and _is_origin(one.rows[0]) else count
    if one.fault != CUT or len(one.rows) < max(1, required_rows):
        return one
    return replace(one, fault="", cut=False, marks=one.marks | {"an outer bracket isn't closed"})


def _parts(one: NumberList, count: int, history: Rows | None, notes: list[str]) -> list[NumberList]:
    """Split a list that is longer than asked for, where the place is known."""
    if one.fault and one.fault != CUT:
        return [one]
    history_rows = history or ()
    rows = one.rows
    lead = _leading_echo(rows, history_rows, count)
    if lead:
        notes.append("a list begins with the history, which was left out")
        loose = tuple(i - lead for i in one.loose if i > lead)
        one = replace(one, rows=rows[lead:], times_s=one.times_s[lead:], loose=loose)
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
                times_s=one.times_s[start : start + size],
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
        return [replace(one, rows=rows[half:], times_s=one.times_s[half:], loose=())]
    return [one]


def _leading_echo(rows: Rows, history: Rows, count: int) -> int:
    """Count the rows at the beginning of a list that are the history, followed by others."""
    whole = len(history)
    if not history:
        return 0
    # A list that is not too long may begin like the history by chance, if that is short or steady.
    certain = len(rows) > count or (whole >= _LEAST_ECHO and not _constant(history))
    if certain and len(rows) > whole and _equal(rows[:whole], history):
        return whole
    lead = len(rows) - count
    if lead == 1 and _is_origin(rows[0]):  # the present position, which is no echo
        return 0
    if 0 < lead < whole and _equal(rows[:lead], history[-lead:]) and not _constant(history):
        return lead
    return 0


def _is_of_past(label: str) -> bool:
    return _PAST.search(label) is not None and not any(word in label for word in _FUTURE)


def _is_labelled_past(label: str) -> bool:
    return _is_of_past(label) and _PAST_LABEL.match(label) is not None


def _is_echo(rows: Rows, history: Rows, of_past: bool, notes: list[str]) -> bool:
    run = len(rows)
    if not min(_LEAST_ECHO, len(history)) <= run <= len(history) or not run:
        return False
    if _constant(rows):
        is_echo = of_past and _equal(rows, history)
        if is_echo:
            notes.append("the echo of the history was left out")
        return is_echo
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
    """Tell whether rows are the history with fewer decimals, and vary too much for chance."""
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


def _pick(answers: list[_Candidate], form: Form, notes: list[str]) -> _Candidate:
    complete = [one for one in answers if not one.one.fault and _fits_form(one, form)]
    cut = answers[-1].one.cut
    if complete:
        candidate = complete[-1]
        later = answers[answers.index(candidate) + 1 :]
        replacements = [one for one in later if _is_replacement(one, complete, form)]
        if replacements:
            notes.append(f"{len(complete)} lists of {form.rows} were passed over for the last one")
            return replacements[-1]
        others = [one for one in complete[:-1] if not _equal(one.one.rows, candidate.one.rows)]
        if others:
            notes.append(f"{len(others)} other lists of {form.rows} were passed over for the last")
        elif len(complete) > 1:
            notes.append(f"the list is given {len(complete)} times")
        if cut:
            notes.append("a later list is cut off")
        return candidate
    if cut:
        return answers[-1]
    most = max(len(one.one.rows) for one in answers)
    if len(answers) > 1:
        notes.append(f"of {len(answers)} lists, none of {form.rows} rows, the longest was taken")
    return [one for one in answers if len(one.one.rows) == most][-1]


def _is_replacement(one: _Candidate, complete: Sequence[_Candidate], form: Form) -> bool:
    """Tell whether a list behind a complete one is meant to replace it, though it isn't complete.

    It has half of the rows at least and a fault or a label of the own plan, or is cut off and
    doesn't repeat a complete one.
    """
    rows = one.one.rows
    if one.one.cut:
        repeats = any(_equal(rows, whole.one.rows[: len(rows)]) for whole in complete)
        return bool(rows) and not repeats
    labelled = one.label.owner is Owner.OWN and not one.read.problem
    return 2 * len(rows) >= form.rows and (one.one.fault != "" or labelled)


def _read(candidate: _Candidate, form: Form, history: Rows | None, notes: list[str]) -> Choice:
    one, read = candidate.one, candidate.read
    problem = f"the list can't be read: {one.fault}" if one.fault else read.problem
    if not problem and one.unread_after and len(one.rows) < form.rows:
        problem = f"the list can't be read: {UNREAD}"
    if not problem and history is None and len(one.rows) == 2 * form.rows:
        problem = "the first half of the list may be the history, and the request isn't at hand"
    if problem:
        return Choice((), "shape", (*_unique(notes), problem))
    if history is None:
        notes.append("the request isn't at hand, so that an echo of its history isn't recognised")
    if history and _equal(one.rows, history):
        notes.append("the list equals the history, whose rows are all the same")
    notes.extend(sorted(one.marks - form.usual))
    notes.extend(read.notes)
    if one.units:
        notes.append("units in rows")
    if "*" in candidate.label.text:
        notes.append("a bold label")
    rows, times_s = read.rows, read.times_s
    if form.label and not times_s and len(rows) == form.rows + 1 and _is_origin(rows[0]):
        notes.append("its first row is the origin at t = 0")
        return Choice(rows, "", _unique(notes), FROM_ORIGIN)
    if len(rows) != form.rows:
        notes.append(f"{len(rows)} rows instead of {form.rows}")
    return Choice(rows, "", _unique(notes), times_s)


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
