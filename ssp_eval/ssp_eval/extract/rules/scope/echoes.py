"""Stage 4b: what a text only repeats: questions, prompts, options, and frames that are past."""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Hit, Kind
from ssp_eval.extract.rules.scope.flags import Scope
from ssp_eval.extract.rules.words.notation import phrases

_QUOTED, _PAST = Scope.QUOTED, Scope.PAST
_ANSWERS = frozenset(
    phrases(
        """
        answer, selected, choice, decision, chosen, option, choose, pick, select, plan, final, take,
        action, picked, selection
        """
    )
)
# A question with such an answer says what it asks. Brake? Slightly.
_YES = tuple([word] for word in phrases("yes, yeah, yep, slightly, gently, hard, firmly, strongly"))
_TAKES = frozenset({"with", "for"})
_CLOSERS = frozenset({".", ",", ";", "\n", "[", '"', "|", "?", ")"})
_LABELS = frozenset("abcdefgh12345678")
REACH = 8


def opens_item(words: list[str], first: int) -> bool:
    """Whether a sentence that begins at a word is an item of a list: a bullet, a number, (a)."""
    if first >= len(words):
        return False
    if words[first] in (",", "[", "("):
        return True
    if words[first].isdigit() or (first > 1 and words[first - 2].isdigit()):
        return True
    return words[first] in _LABELS and words[first + 1 : first + 2] in (["["], [")"])


def mark_echoes(
    words: list[str], hits: list[Hit], flags: list[int], ranges: list[tuple[int, int]]
) -> None:
    """Flags questions, prompts and options, and all but the last of several frames."""
    _mark_quotes(words, hits, flags, ranges)
    _mark_frames(hits, flags)


def _mark_quotes(
    words: list[str], hits: list[Hit], flags: list[int], ranges: list[tuple[int, int]]
) -> None:
    quoted = False
    listing = False  # items under a heading such as "Options:"
    listed: tuple[int, int] | None = None  # hits of the options
    any_opener = any(hit.kind is Kind.QUOTE for hit in hits)
    for start, stop in ranges:
        opener: int | None = None
        question = hits[stop - 1].kind is Kind.MARK and hits[stop - 1].value == "?"
        question = question and words[hits[stop - 1].stop : hits[stop - 1].stop + 1] not in _YES
        if not (any_opener or question):
            continue
        first = hits[start - 1].stop if start else 0
        listing = listing and opens_item(words, first) and not _decides(hits, start, stop)
        opened = -1
        off = False  # behind an empty box
        for index in range(start, stop):
            hit = hits[index]
            if hit.kind is Kind.QUOTE:
                opener = index
                off = hit.value == "off" or (off and hit.value != "on")
                if (
                    opened < 0
                    and hit.value in ("options", "not")
                    and _lists(hits, index, start, stop)
                ):
                    opened = index
            elif hit.kind is Kind.MARK and hit.value == '"':
                if quoted:
                    quoted = False
                    opener = None
                elif opener is not None and index - opener <= 4:
                    quoted = True
            elif opened >= 0 and hit.kind in (Kind.FINAL, Kind.KEY):
                opened = -1
            optional = listing or opened >= 0 or off
            if quoted or question or optional or _after_colon(hits, opener, index, start):
                flags[index] |= _QUOTED
        if opened >= 0:
            listing = opened + 3 >= stop or words[hits[stop - 1].first - 1].isdigit()
            listed = (opened, stop)
        elif listing and listed is not None:
            listed = (listed[0], stop)
    if listed is not None:
        _choose(words, hits, flags, *listed)


def _decides(hits: list[Hit], start: int, stop: int) -> bool:
    return any(hit.kind in (Kind.KEY, Kind.FINAL) for hit in hits[start : min(start + 4, stop)])


def _lists(hits: list[Hit], opener: int, start: int, stop: int) -> bool:
    """Options considered were …; Alternatives that were looked at: …"""
    if hits[opener].value == "options" and opener + 2 >= stop:
        return True  # Let me think about two alternatives. (a) …
    if opener > start and hits[opener - 1].kind is not Kind.MARK:
        return False
    for after in range(opener + 1, min(opener + REACH, stop)):
        hit = hits[after]
        if hit.kind is Kind.MARK:
            return hit.value in (":", "\n", "=", '"')
        if hit.kind is Kind.VERB:
            return False
    return False


def _choose(words: list[str], hits: list[Hit], flags: list[int], first: int, stop: int) -> None:
    """Answer: c. The option of that label is the plan after all."""
    end = hits[stop - 1].stop
    label = _answer(words, end)
    if label is None:
        return
    inside = False
    at = hits[first].stop
    for index in range(first + 1, stop):
        hit = hits[index]
        while at < hit.first:
            if words[at] in _LABELS and _labels(words, at):
                inside = words[at] == label
            at += 1
        if inside:
            flags[index] &= ~_QUOTED
        at = max(at, hit.first)
        while at < hit.stop:
            if words[at] in _LABELS and _labels(words, at):
                inside = words[at] == label
            at += 1


def _labels(words: list[str], at: int) -> bool:
    """Whether a letter or figure is an option's label: (a), A:, 1."""
    after = words[at + 1] if at + 1 < len(words) else ""
    return after in ("[", ")", ":", ".", "\n")


def _answer(words: list[str], at: int) -> str | None:
    """The label that a text chooses behind its options."""
    for here in range(at, len(words) - 1):
        if words[here] not in _ANSWERS and words[here] not in _TAKES:
            continue
        for label in range(here + 1, min(here + 5, len(words))):
            word = words[label]
            if word in _LABELS:
                ends = label + 1 >= len(words) or words[label + 1] in _CLOSERS
                if ends:
                    return word
                break
            if word not in (":", "is", "option", "[", "(", '"', "="):
                break
    return None


def _after_colon(hits: list[Hit], opener: int | None, index: int, start: int) -> bool:
    """Whether a hit follows "Prompt:" or "Option A:" in its own sentence."""
    if opener is None or index <= opener:
        return False
    if opener > start and hits[opener - 1].kind not in (Kind.MARK, Kind.QUOTE):
        return False  # Example from the prompt: …
    after = hits[opener + 1]
    return after.kind is Kind.MARK and after.value in (":", ")", '"', "=")


def _mark_frames(hits: list[Hit], flags: list[int]) -> None:
    """Of several numbered frames only the last is the present."""
    frames = [int(hit.value) for hit in hits if hit.kind is Kind.FRAME]
    if not frames:
        return
    newest = max(frames)
    if newest < 10**6 and len(set(frames)) == 1:
        return
    current = newest
    clause = 0
    for index, hit in enumerate(hits):
        if hit.kind is Kind.FRAME:
            current = int(hit.value)
            leads = index == clause
            if leads:
                flags[index] = _dated(flags[index], current, newest)
            else:
                for before in range(clause, index):
                    flags[before] = _dated(flags[before], current, newest)
                current = newest
                clause = index + 1
        elif hit.kind is Kind.MARK and hit.value != ":":
            clause = index + 1
            if hit.value == "\n":
                current = newest
        elif hit.kind is Kind.JOIN or hit.kind is Kind.FINAL:
            clause = index + 1
            if hit.kind is Kind.FINAL or hit.value == "now":
                current = newest
        flags[index] = _dated(flags[index], current, newest)


def _dated(flag: int, frame: int, newest: int) -> int:
    return flag | _PAST if frame < newest else flag
